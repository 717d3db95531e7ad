//! Streams that have had their final diagnosis: nothing more is said of them, whatever still comes.

use std::collections::{HashSet, VecDeque};

/// A stream: name of its actuator as in the frames, number of the pass.
pub type StreamId = ([u8; 32], u64);

/// Streams remembered; a number of a stream never comes again once its run is over.
pub const REMEMBERED: usize = 65_536;

/// The last [`REMEMBERED`] concluded streams, with room for all of them from the start.
#[derive(Debug)]
pub(super) struct Concluded {
    known: HashSet<StreamId>,
    oldest_first: VecDeque<StreamId>,
}

impl Default for Concluded {
    fn default() -> Self {
        Self {
            known: HashSet::with_capacity(REMEMBERED + 1),
            oldest_first: VecDeque::with_capacity(REMEMBERED + 1),
        }
    }
}

impl Concluded {
    pub fn insert(&mut self, stream: StreamId) {
        if !self.known.insert(stream) {
            return;
        }
        self.oldest_first.push_back(stream);
        if self.oldest_first.len() > REMEMBERED
            && let Some(oldest) = self.oldest_first.pop_front()
        {
            self.known.remove(&oldest);
        }
    }

    pub fn contains(&self, stream: &StreamId) -> bool {
        self.known.contains(stream)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn prop_the_oldest_are_forgotten_first_and_no_more_than_needed() {
        let mut c = Concluded::default();
        for n in 0..REMEMBERED as u64 + 2 {
            c.insert(([1; 32], n));
            c.insert(([1; 32], n));
        }
        assert_eq!((c.known.len(), c.oldest_first.len()), (REMEMBERED, REMEMBERED));
        assert!(!c.contains(&([1; 32], 1)) && c.contains(&([1; 32], 2)));
        assert!(!c.contains(&([2; 32], 2)));
    }
}
