pub mod bench;
pub mod check;
pub mod filter;
pub mod filtered;
pub mod jumps;
pub mod noise;
mod one_constant;
pub mod own;
mod points;
#[cfg(test)]
pub(crate) mod prescribed;
pub mod recording;
pub(crate) mod rows;
pub mod samples;
pub mod sums;
pub mod winding;
