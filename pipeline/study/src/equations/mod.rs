pub mod floors;
pub mod mechanics;
pub mod nuisances;
pub mod pieces;
pub mod problem;
mod residuals;
pub mod samples;
pub mod signals;
pub mod whitener;
