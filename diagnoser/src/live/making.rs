//! Which maps are worth making: only for tests of which enough has come, and only so many at once.

use super::{Live, Maps, StreamId, Track};
use crate::map_library::MapKey;

/// Map sets that are being made or wait for it at once; further tests end without maps.
pub const MOST_MAKING: usize = 4;

/// Share of a whole test of the sequence that must have come before maps are made for it.
pub const SHARE_FOR_MAKING: f64 = 0.5;

/// Samples that must have come of a test of `whole` samples.
fn needed(whole: u64) -> u64 {
    (whole as f64 * SHARE_FOR_MAKING).ceil().max(1.0) as u64
}

/// Why no maps are made for a stream that is over.
pub(super) fn why_not_made(track: &Track, key: &MapKey) -> String {
    let (received, whole) = track.progress();
    let maps = key.describe();
    if received < needed(whole) {
        let n = needed(whole);
        return format!("no maps for {maps}; none are made for {received} samples, needed: {n} of {whole}");
    }
    format!("no maps for {maps}; {MOST_MAKING} other map sets are being made, no more are taken at once")
}

impl Live {
    /// No saved maps serve; they may be made once enough of a test has come ([`Live::to_make`]).
    pub fn no_saved_maps(&mut self, key: &MapKey) {
        if let Some(m @ Maps::Wanted) = self.maps.get_mut(key) {
            *m = Maps::Absent;
            self.go_on_with(key);
        }
    }

    /// Maps to be made since the last call; the answer is [`Live::maps`].
    pub fn to_make(&mut self) -> std::vec::Drain<'_, MapKey> {
        self.to_make.drain(..)
    }

    /// Map sets that are being made, or wait for it.
    pub fn making(&self) -> usize {
        self.maps.values().filter(|m| matches!(m, Maps::Making)).count()
    }

    /// Map sets in memory.
    pub fn ready_maps(&self) -> usize {
        self.maps.values().filter(|m| matches!(m, Maps::Ready(_))).count()
    }

    /// Asks for a stream's maps to be made, where there are no saved ones, enough of the test has come, and not
    /// too many are being made already.
    pub(super) fn make_if_worth_it(&mut self, stream: StreamId) {
        let Some(track) = self.tracks.get(&stream) else { return };
        let Some(key) = track.maps() else { return };
        let (received, whole) = track.progress();
        if !matches!(self.maps.get(key), Some(Maps::Absent)) || received < needed(whole) {
            return;
        }
        if self.making() < MOST_MAKING {
            let key = key.clone();
            self.maps.insert(key.clone(), Maps::Making);
            self.to_make.push(key);
        }
    }
}
