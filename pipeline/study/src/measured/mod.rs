pub mod bench;
pub mod check;
pub mod filter;
pub mod filtered;
pub mod jumps;
mod one_constant;
pub mod own;
pub mod recording;
pub(crate) mod rows;
