//! The study: where simulation and measurement disagree. The gap is located, the missing effect named, added to
//! the model, and the gap shown to shrink on data that was not used to find it.
//!
//! Floors, each importing only those below it: [`told`] (findings, words, files), [`search`] (fit, selection,
//! proof, intervals), [`candidates`] (effects driven by what was measured), [`equations`] (what the channels
//! must satisfy), [`measured`] (bench files, recordings, their clocks, noise and filters).

pub mod candidates;
pub mod equations;
pub mod measured;
pub mod search;
pub mod told;

/// Stands for the reference actuator in place of a file.
pub const REFERENCE: &str = sim_worker::parameters::ActuatorParameters::BUILT_IN;
