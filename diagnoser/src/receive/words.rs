//! What the live diagnoser tells people: its counts, and its troubles.

use crate::diagnosis::Outcome;
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
    /// of these, that no fault pair explains
    pub unexplained: u64,
    /// of these, with faults beyond the maps
    pub out_of_range: u64,
    /// frames that were refused because no stream could be found for them
    pub strays: u64,
    /// frames of the transport that could not be received
    pub failures: u64,
}

impl Counts {
    /// A final diagnosis.
    pub fn concluded(&mut self, outcome: &Outcome) {
        let of_outcome = match outcome {
            Outcome::Located(_) => &mut self.located,
            Outcome::Unexplained { .. } => &mut self.unexplained,
            Outcome::OutOfRange { .. } => &mut self.out_of_range,
            Outcome::Incomplete { .. } => &mut self.incomplete,
        };
        for count in [of_outcome, &mut self.diagnoses] {
            *count = count.saturating_add(1);
        }
    }
}

/// Where words about trouble go: to the screen, or to standard error.
pub type Complain = Arc<dyn Fn(&str) + Send + Sync>;
