//! The ground side: datasets, maps, diagnoses of recordings, reports, and the program `ema`.
//!
//! What `ema` does can be had without it. [`case::run`] diagnoses a recorded file as `ema diagnose` does: [`Settings`]
//! in, [`Case`] out, maps made on first use. [`maps::made`] simulates a fault grid into a [`Dataset`] and makes its
//! maps, [`maps::of_grid`] makes them of features that stand ready ([`GridFeatures`]), [`calibrate::calibrate`] fixes
//! how far their intervals reach. [`input::open`] reads recordings of others ([`Measured`]), [`refine::refine`] fits
//! one of them by simulation, and [`discrepancy::study_file`] finds what a model misses against measured data
//! ([`Findings`]).
//!
//! Begin with [`case`] for recordings and with [`maps`] for maps. Simulator and features are in the crate
//! `sim-worker`, the inversion is in `diagnoser`, the query engine in `ema-query`.
//!
//! # Maps from rows of features
//!
//! The features may come from any table; here they are made up.
//!
//! ```
//! use diagnoser::{Diagnoser, MapSetHeader};
//! use pipeline::{GridFeatures, maps::of_grid};
//! use schemas::{feature::{Raw, RawFeatures}, test_kind::TestKind};
//!
//! let row = |fsj: f64, zeta: f64| {
//!     let mut raw = RawFeatures::default();
//!     raw[Raw::P2] = Some(0.05 * fsj + 2.0 * zeta); // current error [A]
//!     raw[Raw::P3] = Some(0.01 * fsj + 0.002 * zeta); // command at break-away [rad]
//!     raw
//! };
//! let (fsj, zeta) = (vec![1.0, 2.0, 3.0, 4.0, 5.0], vec![0.0, 0.1, 0.2, 0.3, 0.4]);
//! // zeta outer, FSJ inner
//! let measured: Vec<RawFeatures> = zeta.iter().flat_map(|&z| fsj.iter().map(move |&f| row(f, z))).collect();
//! let mut noise = RawFeatures::default();
//! (noise[Raw::P2], noise[Raw::P3]) = (Some(2e-3), Some(1e-5));
//! let deviations = vec![noise; measured.len()];
//!
//! let header = MapSetHeader {
//!     actuator: "made up".into(), sequence: "preflight".into(), grid: "5 x 5".into(),
//!     kind: TestKind { rate_hz: 1e4, ..TestKind::default() },
//!     step_s: 1e-6, seed: 0, commit: String::new(), left_out: Vec::new(),
//! };
//! let sequence = sim_worker::catalogue::sequence("preflight")?;
//! let grid = GridFeatures { fsj, zeta, measured, deviations };
//! let set = of_grid("made up", header, &sequence, &grid, false)?;
//!
//! let diagnoser = Diagnoser::uncalibrated(set);
//! let diagnosis = diagnoser.diagnose(&diagnoser.maps.features(&row(2.5, 0.2)), &[]);
//! let area = diagnosis.outcome.area().expect("the maps agree");
//! assert!(area.fsj.contains(2.5) && area.zeta.contains(0.2));
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
#![warn(missing_docs, clippy::missing_errors_doc)]

pub(crate) mod bench_live;
pub(crate) mod bridge;
pub mod calibrate;
pub mod case;
pub mod check;
pub mod cli;
pub mod dataset;
pub mod demo;
pub(crate) mod digits;
pub mod discrepancy;
pub mod export;
pub mod input;
pub mod interruptible;
pub mod map_table;
pub mod maps;
pub mod one_run;
pub(crate) mod output;
pub mod prognosis;
pub mod refine;
pub(crate) mod replay;
pub(crate) mod report;
pub(crate) mod report_pages;
pub mod speed;
pub mod unit;

pub use calibrate::Effort;
pub use case::{Case, Settings};
pub use dataset::Dataset;
pub use ema_study::told::findings::Findings;
pub use input::Measured;
pub use maps::{GridFeatures, MapRequest};
pub use sim_worker::progress;

/// Source revision of this program, for people.
pub const COMMIT: &str = env!("EMA_COMMIT");

/// Long work was stopped by Ctrl-C; what is done is kept.
#[derive(Debug, thiserror::Error)]
#[error("interrupted; what is done is kept, the same command goes on from there")]
pub struct Interrupted;
