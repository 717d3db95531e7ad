//! What the live diagnoser tells people: its counts, and its troubles.

use std::sync::Arc;

/// What has happened.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counts {
    /// frames received
    pub frames: u64,
    /// final ones
    pub diagnoses: u64,
    /// of these, with an area by all maps
    pub located: u64,
    /// of these, with something missing
    pub incomplete: u64,
    /// frames that were refused because no stream could be found for them
    pub strays: u64,
    /// frames of the transport that could not be received
    pub failures: u64,
}

/// Where words about trouble go: to the screen, or to standard error.
pub type Complain = Arc<dyn Fn(&str) + Send + Sync>;
