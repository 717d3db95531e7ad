//! The physics of an electromechanical actuator: the numerical test bench, the simplified model,
//! their faults and sensors, and the engine that runs them over lanes.
pub mod command;
pub mod control;
pub mod datasets;
pub mod effect;
pub mod lanes;
pub mod monitor;
pub mod parameters;
pub mod plant;
pub mod sensor;
pub mod simulate;
pub mod spread;
pub mod test_bench;
pub mod trig;
pub mod worker;
