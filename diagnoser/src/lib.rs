//! What flies: failure maps of features, and their inversion to fault intervals, live
//! or of a recording.
//!
//! A [`FailureMap`] holds one feature over the fault grid: transmission friction (FSJ) and static rotor eccentricity
//! (zeta). A [`FailureMapSet`] holds the maps of one actuator and kind of test. A [`Diagnoser`] is a set made ready;
//! it takes features and gives a [`Diagnosis`], whose [`Outcome`] is the area of possible fault pairs or the reason
//! why there is none. Features come from telemetry through a [`FeatureExtractor`], which works by a [`FeaturePlan`].
//!
//! Begin with [`Diagnoser::diagnose`]; [`diagnosis`] says what an interval means, [`failure_map`] what a map is.
//! [`map_library`] finds saved maps and the calibration beside them, [`live`] is the same for frames as they come,
//! and [`receive`] the process around it. Maps are made in the crate `pipeline`, or by `ema maps`.
//!
//! # A recording
//!
//! ```no_run
//! use diagnoser::{Diagnoser, FailureMapSet, FeatureExtractor, FeaturePlan, Recording};
//! use sim_worker::{catalogue, parameters::ActuatorParameters};
//! use std::{path::Path, sync::Arc};
//!
//! # fn main() -> schemas::error::Result<()> {
//! let recording = Recording::open(Path::new("run.parquet"))?;
//! let (actuator, sequence) = (ActuatorParameters::reference(), catalogue::sequence("preflight")?);
//! let plan = FeaturePlan::new(&actuator, &sequence, recording.provenance.rate_hz, false, Default::default());
//! let mut extractor = FeatureExtractor::new(Arc::new(plan));
//! recording.replay(8192, &mut extractor)?;
//! // it must be a test of the kind that the maps are for: `header.kind`
//! let diagnoser = Diagnoser::uncalibrated(FailureMapSet::load(Path::new("dataset/maps.parquet"))?);
//! let features = diagnoser.maps.features(&extractor.features());
//! let diagnosis = diagnoser.diagnose(&features, &extractor.missing());
//! match diagnosis.outcome.area() {
//!     Some(a) => println!("FSJ {:.3} .. {:.3}, zeta {:.4} .. {:.4}", a.fsj.lo, a.fsj.hi, a.zeta.lo, a.zeta.hi),
//!     None => println!("{}: {}", diagnosis.outcome.name(), diagnosis.outcome.reason()),
//! }
//! # Ok(())
//! # }
//! ```
//!
//! # Plain numbers
//!
//! Two made-up features over a small grid, and a test at FSJ 2.5, zeta 0.2:
//!
//! ```
//! use diagnoser::{Diagnoser, FailureMap, FailureMapSet, MapSetHeader, Outcome};
//! use schemas::{feature::{Feature, Features, RawFeatures}, test_kind::TestKind};
//!
//! let (fsj, zeta) = (vec![1.0, 2.0, 3.0, 4.0, 5.0], vec![0.0, 0.1, 0.2, 0.3, 0.4]);
//! // current error [A] and rise time [s]: one tells more of zeta, the other of FSJ
//! let current = |f: f64, z: f64| 0.05 * f + 2.0 * z;
//! let rise = |f: f64, z: f64| 7e-3 + 3e-4 * f + 1e-4 * z;
//! let map = |feature: Feature, of: &dyn Fn(f64, f64) -> f64, noise: f64| {
//!     // zeta outer, FSJ inner
//!     let values = zeta.iter().flat_map(|&z| fsj.iter().map(move |&f| of(f, z))).collect();
//!     FailureMap::build("made up", feature, feature.direction(), &fsj, &zeta, values, noise, 0.0)
//! };
//! let set = FailureMapSet {
//!     header: MapSetHeader {
//!         actuator: "made up".into(), sequence: "none".into(), kind: TestKind::default(), grid: String::new(),
//!         step_s: 1e-6, seed: 0, commit: String::new(), left_out: Vec::new(),
//!     },
//!     nominal: RawFeatures::default(),
//!     maps: vec![map(Feature::P2, &current, 2e-3)?, map(Feature::Rise, &rise, 3e-6)?],
//!     witnesses: Vec::new(),
//! };
//! let measured = Features::default()
//!     .with(Feature::P2, Some(current(2.5, 0.2)))
//!     .with(Feature::Rise, Some(rise(2.5, 0.2)));
//! let diagnosis = Diagnoser::uncalibrated(set).diagnose(&measured, &[]);
//! let Outcome::Located(area) = diagnosis.outcome else { panic!("{:?}", diagnosis.outcome) };
//! assert!(area.fsj.contains(2.5) && area.zeta.contains(0.2));
//! assert!(area.fsj.width() < 0.1 && area.zeta.width() < 0.02);
//! # Ok::<(), schemas::error::Error>(())
//! ```
#![warn(missing_docs, clippy::missing_errors_doc)]

pub mod calibration;
pub mod cli;
pub mod curves;
pub mod diagnosis;
pub mod estimate;
pub mod failure_map;
pub mod isotonic;
pub mod live;
pub mod log;
pub mod map_library;
pub mod monotone;
pub mod paper;
pub mod paving;
pub mod prognosis;
pub mod quality;
pub mod receive;
pub mod record;
pub mod report;
mod seal;
pub mod sensitivity;
pub mod smooth;
pub mod uncertainty;
pub mod unit;
pub mod view;

pub use diagnosis::{Diagnoser, Diagnosis, Outcome};
pub use failure_map::{FailureMap, FailureMapSet, MapSetHeader};
pub use schemas::recording::Recording;
pub use sim_worker::extractor::{FeatureExtractor, FeaturePlan};
