//! What the live diagnoser tells people: its counts, and its troubles.

use std::sync::Arc;

/// What has happened.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counts {
    pub frames: u64,
    pub diagnoses: u64,
    pub located: u64,
    pub incomplete: u64,
    pub strays: u64,
    /// frames of the transport that could not be received
    pub failures: u64,
}

/// Where words about trouble go: to the screen, or to standard error.
pub type Complain = Arc<dyn Fn(&str) + Send + Sync>;
