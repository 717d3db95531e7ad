//! The physics of an electromechanical actuator: the numerical test bench, the simplified model,
//! their faults and sensors, the engine that runs them over lanes, the features of a run, and (with
//! the feature `dataset`) the program that works through its share of a dataset.
//!
//! Where to begin: [`ActuatorParameters::reference`], or a TOML file of your own, and a sequence make a [`TestSetup`].
//! Its [`Experiment`] is simulated for up to 16 [`Run`]s at once, each a [`Lane`] with faults of its own;
//! [`simulate::simulate`] pushes their telemetry into sinks. [`FeatureExtractor`] makes features of it. The equations
//! stand in [`control`] and [`plant`], their order in [`lanes`].
//!
//! A step of 20 ms with both faults:
//!
//! ```
//! use schemas::{Channel, ChannelSet, Collector, FaultState, TestSequence, toml_section};
//! use sim_worker::{ActuatorParameters, Lane, Run, TestSetup, simulate::simulate};
//!
//! let text = "name = 'short'\n[[segment]]\ncommand = 'step'\nheight_rad = 0.1\nduration_s = 0.02";
//! let sequence = TestSequence::from_section(toml_section::parse("example", text)?)?;
//! let setup = TestSetup::new(ActuatorParameters::reference().into(), sequence, 10_000.0);
//! let lane = Lane {
//!     actuator: setup.actuator.clone(),
//!     fault: FaultState { fsj: 3.0, zeta: 0.25 },
//!     rest_angle_rad: 0.0,
//!     load_n_m: 0.0,
//! };
//! let run = Run { number: 0, lane, seed: 0 };
//! let mut sinks = [Collector::default()];
//! simulate(&setup.experiment(ChannelSet::basic())?, &[run], &mut sinks, || true)?;
//! let angle = sinks[0].column(Channel::ThetaM).unwrap();
//! println!("sample {}: motor at {:.4} rad", angle.len(), angle[199]);
//! # assert!(angle.len() == 200 && angle[199] > 0.0);
//! # Ok::<(), schemas::error::Error>(())
//! ```

#![warn(missing_docs, clippy::missing_errors_doc)]

pub mod cache;
pub mod catalogue;
pub mod command;
pub mod control;
#[cfg(feature = "dataset")]
pub mod dataset;
pub mod driven;
pub mod effect;
pub mod exponential;
pub mod extractor;
pub mod interrupt;
pub mod lanes;
pub mod monitor;
pub mod noise;
pub mod onset;
pub mod parameters;
pub mod plant;
#[cfg(feature = "dataset")]
pub mod progress;
pub mod quiet;
pub mod reversal;
pub mod sensor;
pub mod setup;
pub mod simulate;
pub mod spread;
pub mod step_witness;
pub mod suspect;
pub mod test_bench;
pub mod trig;
pub mod witness;

#[cfg(feature = "dataset")]
pub use dataset::plan::DatasetPlan;
pub use driven::DrivenBench;
pub use extractor::FeatureExtractor;
pub use parameters::ActuatorParameters;
pub use sensor::SensorModel;
pub use setup::TestSetup;
pub use simulate::{Experiment, Run};
pub use test_bench::Lane;
