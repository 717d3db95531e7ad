//! The ground side: datasets, maps, diagnoses of recordings, reports, and the program `ema`.
pub mod bench_live;
pub mod bridge;
pub mod calibrate;
pub mod case;
pub mod cli;
pub mod dataset;
pub mod demo;
pub mod discrepancy;
pub mod input;
pub mod maps;
pub mod output;
pub mod refine;
pub mod replay;
pub mod report;
pub mod report_pages;
pub mod speed;

pub use sim_worker::progress;

/// Source revision of this program, for people.
pub const COMMIT: &str = env!("EMA_COMMIT");

/// Long work was stopped by Ctrl-C; what is done is kept.
#[derive(Debug, thiserror::Error)]
#[error("interrupted; what is done is kept, the same command goes on from there")]
pub struct Interrupted;
