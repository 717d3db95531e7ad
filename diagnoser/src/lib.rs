//! What flies: features from telemetry, failure maps, and their inversion to fault intervals.
pub mod diagnosis;
pub mod extractor;
pub mod failure_map;
pub mod isotonic;
pub mod monotone;
pub mod sensitivity;
