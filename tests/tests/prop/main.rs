//! What holds for random inputs, and bits that must stay as they were.

#[path = "../common/mod.rs"]
mod common;

mod discrepancy;
mod extractor;
mod motor_rig;
mod mutations;
mod own_recordings;
mod physics;
mod regress_bits;
mod regress_fixture;
mod stream;
mod terminals;
