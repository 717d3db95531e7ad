//! Where simulation and measurement disagree: the gap is located, the missing effect named, added to
//! the model, and the gap shown to shrink on data that was not used to find it.

pub mod bench;
pub mod columns;
pub mod filter;
pub mod fit;
pub mod problem;
pub mod recording;
pub mod remainder;
pub mod select;
pub mod signals;
pub mod study;
pub mod table;
pub mod units;
