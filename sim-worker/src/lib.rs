//! The physics of an electromechanical actuator: the numerical test bench, the simplified model,
//! their faults and sensors, the engine that runs them over lanes, the features of a run, and (with
//! the feature `dataset`) the program that works through its share of a dataset.
pub mod cache;
pub mod catalogue;
pub mod command;
pub mod control;
#[cfg(feature = "dataset")]
pub mod dataset;
pub mod effect;
pub mod extractor;
pub mod interrupt;
pub mod lanes;
pub mod monitor;
pub mod noise;
pub mod parameters;
pub mod plant;
#[cfg(feature = "dataset")]
pub mod progress;
pub mod sensor;
pub mod setup;
pub mod simulate;
pub mod spread;
pub mod test_bench;
pub mod trig;
pub mod witness;
