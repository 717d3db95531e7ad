pub mod bench;
pub mod check;
pub mod filter;
pub mod own;
pub mod recording;
pub(crate) mod rows;
