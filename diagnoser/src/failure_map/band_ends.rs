//! The zetas between which a band is met at all: what inverting a map begins with.

use super::{BandKnots, FailureMap};
use crate::monotone;
use schemas::fault::Interval;

/// Lines of each grid row on which a band is looked for.
const LINES_A_ROW: usize = 4;

/// Accuracy of the zetas between which a band is met.
const TOLERANCE: f64 = 1e-11;

/// The ends of a band on one line of constant zeta, without the part of the half-width that holds
/// everywhere.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct BandEnds {
    zeta: f64,
    /// lower limit at the lower end of FSJ
    low: f64,
    /// upper limit at the upper end of FSJ
    high: f64,
}

impl FailureMap {
    /// The ends of the band on the grid's lines and between them, to be kept with the map.
    pub(super) fn ends_of_lines(&self) -> Vec<BandEnds> {
        let rows = self.zeta.windows(2).flat_map(|w| {
            let step = (w[1] - w[0]) / LINES_A_ROW as f64;
            (0..LINES_A_ROW).map(move |k| w[0] + k as f64 * step)
        });
        let mut knots = BandKnots::default();
        rows.chain(self.zeta.last().copied())
            .map(|zeta| self.ends_at(zeta, &mut knots))
            .collect()
    }

    fn ends_at(&self, zeta: f64, knots: &mut BandKnots) -> BandEnds {
        let (line, base) = (self.band_line(zeta, knots), self.base());
        BandEnds {
            zeta,
            low: line.low(0) + base,
            high: line.high(self.fsj.len() - 1) - base,
        }
    }

    /// By how much a value lies beyond the band of a line because its zeta is too low, and because
    /// it is too high (0 or less: it does not).
    fn beyond(&self, ends: &BandEnds, value: f64) -> (f64, f64) {
        let (v, base) = (self.direction.0 * value, self.base());
        let (above, below) = (v - base - ends.high, ends.low - base - v);
        if self.direction.0 * self.direction.1 > 0.0 {
            (above, below)
        } else {
            (below, above)
        }
    }

    /// The zetas whose bands hold `value` at some FSJ; `None` if there are none. Looked for on the
    /// grid's lines and between them; `knots` are to work with.
    pub fn zetas(&self, value: f64, knots: &mut BandKnots) -> Option<Interval> {
        let lines = &self.ends;
        let too_low = |e: &BandEnds| self.beyond(e, value).0;
        let too_high = |e: &BandEnds| self.beyond(e, value).1;
        let meets = |e: &BandEnds| too_low(e) <= 0.0 && too_high(e) <= 0.0;
        let (first, last) = match (lines.iter().position(meets), lines.iter().rposition(meets)) {
            (Some(first), Some(last)) => (first, last),
            // the band may lie between two lines: above the one and below the other
            _ => {
                let apart = |w: &[BandEnds]| too_low(&w[0]) > 0.0 && too_high(&w[1]) > 0.0;
                let k = lines.windows(2).position(apart)?;
                (k + 1, k)
            }
        };
        // from a line on this side of a limit towards its neighbour beyond
        let mut limit = |within: usize, beyond: usize, miss: &dyn Fn(&BandEnds) -> f64| {
            let [a, b] = [within, beyond].map(|k| (lines[k].zeta, miss(&lines[k])));
            let at = |zeta: f64| miss(&self.ends_at(zeta, knots));
            if b.1 > 0.0 {
                monotone::last_within(at, a, b, TOLERANCE)
            } else {
                b.0
            }
        };
        let lo = match first {
            0 => lines[0].zeta,
            k => limit(k, k - 1, &too_low),
        };
        let hi = match last + 1 {
            k if k == lines.len() => lines[last].zeta,
            k => limit(last, k, &too_high),
        };
        (lo <= hi).then_some(Interval { lo, hi })
    }
}
