pub mod filter;
pub mod problem;
pub mod signals;
pub mod whitener;
