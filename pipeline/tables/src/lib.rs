//! Measured tables as people keep them: CSV in the dialects of its writers, Parquet and Arrow IPC of any program, read into
//! columns of numbers in SI units. One reader for diagnoses, replays and the discrepancy study.
//!
//! [`Table::read`] takes a file as it is and knows the [columns of telemetry](telemetry) by their names, however they are
//! spelt, and the [units](units) that a header states. [`Table::telemetry`] takes one run of it out. A [`ChannelMap`] names
//! columns that are called otherwise. What cannot be read honestly is refused with its cause.

#![warn(missing_docs, clippy::missing_errors_doc)]

mod channel_map;
mod columnar;
mod container;
mod dialect;
mod header;
mod table;
pub mod telemetry;
pub mod units;

pub use channel_map::ChannelMap;
pub use table::{Column, Table, UnitFrom};
pub use telemetry::Telemetry;
