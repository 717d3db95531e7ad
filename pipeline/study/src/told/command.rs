//! The recorded command between its samples: straight, but where it jumps. When it jumps within a sample no command says; the motion
//! after it does.

use crate::measured::bench::BenchChannel;
use crate::measured::jumps::{Jumps, USUAL};
use crate::told::verify::{Recorded, Simulated};

/// How long the motion after a jump tells when it was [s] (assumed: loops have settled then).
const TELLS_S: f64 = 0.03;

/// The shares that the measured angle tells.
///
/// * `early`, `late` simulated with all jumps at the begin of their samples, and at the end
pub(super) fn shares(r: &Recorded, early: &Simulated, late: &Simulated) -> Vec<f64> {
    let angle = BenchChannel::Position;
    let (jumps, x, a, b) = (&r.jumps.0, &r.measured[&angle], &early[&angle], &late[&angle]);
    let one = |i: usize| {
        let (k, usual) = jumps[i];
        let end = jumps.get(i + 1).map_or(x.len(), |next| next.0 + 1);
        let (mut xx, mut xy) = (0.0, 0.0);
        for j in (k + 1..end).take_while(|j| r.time_s[*j] < r.time_s[k] + TELLS_S) {
            let after = |y: &[f64]| y[j] - y[k];
            let sooner = after(a) - after(b);
            xx += sooner * sooner;
            xy += sooner * (after(x) - after(b));
        }
        if xx > 0.0 {
            1.0 - (xy / xx).clamp(0.0, 1.0)
        } else {
            usual
        }
    };
    (0..jumps.len()).map(one).collect()
}

/// A simulated channel with jumps at these shares, of those with all jumps early and late.
pub(super) fn blend(jumps: &Jumps, shares: &[f64], early: &[f64], late: &[f64]) -> Vec<f64> {
    let mut next = jumps.0.iter().zip(shares).peekable();
    let mut share = USUAL;
    let mut at = |k: usize| {
        while let Some((_, s)) = next.next_if(|(j, _)| j.0 < k) {
            share = *s;
        }
        late[k] + (1.0 - share) * (early[k] - late[k])
    };
    (0..late.len()).map(&mut at).collect()
}

/// The recorded command at any time.
pub struct CommandBetween<'a> {
    /// of its samples, rising [s]
    pub time_s: &'a [f64],
    /// at those times
    pub value: &'a [f64],
    /// where it jumps
    pub jumps: &'a Jumps,
}

impl CommandBetween<'_> {
    /// * `k` the sample before `t`
    fn at(&self, k: usize, t: f64) -> f64 {
        let n = self.value.len();
        if k + 1 >= n {
            return self.value[n - 1];
        }
        let share = (t - self.time_s[k]) / (self.time_s[k + 1] - self.time_s[k]);
        match self.jumps.after(k) {
            Some(jumps) if share < jumps => self.value[k],
            Some(_) => self.value[k + 1],
            None => self.value[k] + share * (self.value[k + 1] - self.value[k]),
        }
    }

    /// Commands of the steps after sample `k - 1` up to sample `k`, of length `dt`.
    ///
    /// * `first` number of the first of them, counted from time 0
    pub fn fill(&self, k: usize, first: u64, dt: f64, out: &mut [f64]) {
        for (j, o) in out.iter_mut().enumerate() {
            let t = (first + j as u64) as f64 * dt;
            *o = if k == 0 { self.value[0] } else { self.at(k - 1, t) };
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_jump_is_held_and_a_slope_is_straight() {
        let time_s = [0.0, 1.0, 2.0, 3.0, 4.0, 5.0];
        let value = [0.0, 0.1, 0.2, 5.0, 5.0, 5.0];
        for (share, after) in [(1.0, 0.2), (0.5, 5.0)] {
            let jumps = Jumps::of(&value).all_at(share);
            let c = CommandBetween {
                time_s: &time_s,
                value: &value,
                jumps: &jumps,
            };
            assert!((c.at(0, 0.5) - 0.05).abs() < 1e-12);
            assert_eq!(c.at(2, 2.4), 0.2);
            assert_eq!(c.at(2, 2.9), after);
            assert_eq!(c.at(3, 3.1), 5.0);
        }
    }

    #[test]
    fn simulations_are_blended_jump_by_jump() {
        let jumps = Jumps(vec![(1, USUAL), (3, USUAL)]);
        let (early, late) = ([0.0, 0.0, 1.0, 1.0, 3.0, 4.0], [0.0, 0.0, 0.0, 1.0, 2.0, 4.0]);
        assert_eq!(
            blend(&jumps, &[0.25, 1.0], &early, &late),
            [0.0, 0.0, 0.75, 1.0, 2.0, 4.0]
        );
    }
}
