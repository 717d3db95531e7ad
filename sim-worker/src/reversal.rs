//! Turning points of a small slow cosine: the motor sticks at each of them and breaks away anew, so that a test of a
//! second has several break-aways, of both directions, at a current that rises slowly.

use crate::extractor::Window;

/// Resolver counts from the turning point within which the motor stands.
const STANDS_COUNTS: f64 = 1.5;

/// Resolver counts from the turning point at which the motor has left it: far enough for the current's ripple not to decide
/// when (assumed; of 1.5 to 50 counts the one that depends least on all but friction).
const LEFT_COUNTS: f64 = 25.0;

/// From so long after the end of the stand to so long, the current is that of dynamic friction [s] (assumed).
const KINETIC_S: (f64, f64) = (20e-3, 35e-3);

/// From so long before the end of the stand to so long after it the greatest current is looked for, of means over the third
/// [s] (assumed).
const PEAK_S: (f64, f64, f64) = (6e-3, 1.6e-3, 2e-3);

/// Samples of a half period, at least.
const FEWEST_OF_HALF: f64 = 20.0;

/// Samples of a cosine, at most: as many are kept.
const LONGEST: u64 = 1 << 20;

/// Most turning points of one direction that count.
const MOST_TURNS: usize = 32;

/// The cosine that turning points are looked for in.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ReversalPlan {
    /// its samples
    pub window: Window,
    /// f [Hz]
    pub frequency_hz: f64,
    /// telemetry rate [Hz]
    pub rate_hz: f64,
    /// 1 where the command begins at its greatest value, -1 at its least
    pub sign: f64,
    /// of the position sensor [rad]
    pub count_rad: f64,
}

impl ReversalPlan {
    /// Whether turning points can be told apart, and the cosine be kept: of another one nothing is taken.
    pub fn serves(&self) -> bool {
        let half = 0.5 * self.rate_hz / self.frequency_hz;
        half >= FEWEST_OF_HALF && self.window.len() <= LONGEST
    }
}

/// What the turning points say, mean of both directions.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Reversals {
    /// greatest current about the begin of the motion [A]
    pub break_away_a: f64,
    /// current after it [A]
    pub kinetic_a: f64,
    /// from the command's turning point to the begin of the motion [s]
    pub lag_s: f64,
}

impl Reversals {
    fn values(self) -> [f64; 3] {
        [self.break_away_a, self.kinetic_a, self.lag_s]
    }
}

/// Collects motor angle and torque-giving current over the cosine.
#[derive(Clone, Debug)]
pub struct ReversalTrack {
    plan: ReversalPlan,
    theta_rad: Vec<f64>,
    current_a: Vec<f64>,
    found: Option<Reversals>,
}

impl ReversalTrack {
    /// Nothing seen yet; room for the whole cosine.
    pub fn new(plan: ReversalPlan) -> Self {
        let rows = plan.window.len() as usize;
        Self {
            plan,
            theta_rad: Vec::with_capacity(rows),
            current_a: Vec::with_capacity(rows),
            found: None,
        }
    }

    /// The samples that it takes.
    pub fn window(&self) -> Window {
        self.plan.window
    }

    /// Samples seen without a gap.
    pub fn seen(&self) -> u64 {
        self.theta_rad.len() as u64
    }

    /// Takes the next sample of the window: motor angle [rad], torque-giving current [A].
    pub fn push(&mut self, theta_rad: f64, current_a: f64) {
        if self.seen() == self.plan.window.len() {
            return;
        }
        self.theta_rad.push(theta_rad);
        self.current_a.push(current_a);
        if self.seen() == self.plan.window.len() {
            self.found = self.evaluate();
        }
    }

    /// Once the whole window has come.
    pub fn found(&self) -> Option<Reversals> {
        self.found
    }

    fn evaluate(&self) -> Option<Reversals> {
        let half = 0.5 * self.plan.rate_hz / self.plan.frequency_hz;
        let (mut seen, mut found) = ([0; 2], [[[0.0; MOST_TURNS]; 3]; 2]);
        // the first turning point comes from the ramp: it is unlike the others
        let whole = (self.theta_rad.len() as f64 / half - 0.5 + 1e-6).floor() as usize;
        for m in 1..=whole {
            let upper = (m % 2 == 0) == (self.plan.sign > 0.0);
            let rows = ((m as f64 - 0.5) * half) as usize..((m as f64 + 0.5) * half) as usize;
            let (n, rows_of) = (&mut seen[usize::from(upper)], &mut found[usize::from(upper)]);
            if let Some(turn) = self.turn(m as f64 * half, rows, upper).filter(|_| *n < MOST_TURNS) {
                rows_of.iter_mut().zip(turn.values()).for_each(|(row, x)| row[*n] = x);
                *n += 1;
            }
        }
        let [[a, b, c], [d, e, f]] = found;
        let [m, n] = seen;
        (m > 0 && n > 0).then(|| Reversals {
            break_away_a: 0.5 * (median(a, m) + median(d, n)),
            kinetic_a: 0.5 * (median(b, m) + median(e, n)),
            lag_s: 0.5 * (median(c, m) + median(f, n)),
        })
    }

    /// One turning point, currents in the direction of the motion that follows.
    ///
    /// * `turns` sample of the command's turning point
    fn turn(&self, turns: f64, rows: std::ops::Range<usize>, upper: bool) -> Option<Reversals> {
        let (x, i) = (&self.theta_rad, &self.current_a);
        let sign = if upper { -1.0 } else { 1.0 };
        let rows = rows.start..rows.end.min(x.len());
        let end = rows.clone().min_by(|&a, &b| (sign * x[a]).total_cmp(&(sign * x[b])))?;
        let way = |k: usize| sign * (x[k] - x[end]) / self.plan.count_rad;
        let last = (end..rows.end).take_while(|&k| way(k) <= STANDS_COUNTS).last()?;
        let left = (last + 1..rows.end).find(|&k| way(k) > LEFT_COUNTS)?;
        let share = (LEFT_COUNTS - way(left - 1)) / (way(left) - way(left - 1));
        let after = |s: f64| (last as f64 + 1.0 + s * self.plan.rate_hz).round().max(0.0) as usize;
        let mean = |part: &[f64]| sign * part.iter().sum::<f64>() / part.len() as f64;
        let (before, behind, long) = PEAK_S;
        let long = ((long * self.plan.rate_hz).round() as usize).max(1);
        let peaks = i.get(after(-before)..after(behind))?.windows(long).map(mean);
        let kinetic = i
            .get(after(KINETIC_S.0)..after(KINETIC_S.1))
            .filter(|k| !k.is_empty())?;
        Some(Reversals {
            break_away_a: peaks.reduce(f64::max)?,
            kinetic_a: mean(kinetic),
            lag_s: (left as f64 - 1.0 + share - turns) / self.plan.rate_hz,
        })
    }
}

/// The middle of the first `n` values, or the mean of the two in the middle.
fn median(mut values: [f64; MOST_TURNS], n: usize) -> f64 {
    values[..n].sort_by(f64::total_cmp);
    0.5 * (values[(n - 1) / 2] + values[n / 2])
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::TAU;

    /// Stick and slip at 10 kHz: the motor stands for 15 ms at every turning point while the current rises to 1.2 A.
    fn track(break_away: f64, kinetic: f64, offset: f64) -> ReversalTrack {
        let plan = ReversalPlan {
            window: Window { from: 1, to: 7500 },
            frequency_hz: 5.0,
            rate_hz: 1e4,
            sign: 1.0,
            count_rad: TAU / 65536.0,
        };
        let mut t = ReversalTrack::new(plan);
        for k in 0..7500 {
            // 150 samples of stand, then on with the cosine of the rest of the half period
            let (m, j) = (k / 1000, k % 1000);
            let sign = if m % 2 == 0 { -1.0 } else { 1.0 };
            let turn = -sign;
            if j < 150 {
                let share = j as f64 / 150.0;
                t.push(0.05 * turn, offset + sign * (2.0 * share - 1.0) * break_away);
            } else {
                let angle = std::f64::consts::PI * (j - 150) as f64 / 850.0;
                t.push(0.05 * turn * angle.cos(), offset + sign * kinetic);
            }
        }
        t
    }

    #[test]
    fn prop_break_away_and_kinetic_current_are_found_whatever_the_offset() {
        for offset in [0.0, 0.03] {
            let found = track(1.2, 0.8, offset).found().unwrap();
            // of the last 2 ms, through which it rises by 0.32 A
            assert!((found.break_away_a - 1.04).abs() < 0.02, "{found:?}");
            assert!((found.kinetic_a - 0.8).abs() < 1e-9, "{found:?}");
            assert!((found.lag_s - 0.0235).abs() < 1e-3, "{found:?}");
        }
    }

    #[test]
    fn prop_a_cosine_too_quick_or_too_long_is_left_alone() {
        let plan = track(1.2, 0.8, 0.0).plan;
        assert!(plan.serves());
        let quick = ReversalPlan {
            frequency_hz: 1e300,
            ..plan
        };
        let long = ReversalPlan {
            window: Window { from: 1, to: 1 << 40 },
            ..plan
        };
        assert!(!quick.serves() && !long.serves());
    }

    #[test]
    fn prop_a_copy_finds_the_same() {
        let t = track(1.2, 0.8, 0.0);
        let mut copy = ReversalTrack::new(t.plan).clone();
        let samples = t.theta_rad.iter().zip(&t.current_a);
        samples.for_each(|(theta, current)| copy.push(*theta, *current));
        assert_eq!(copy.found(), t.found());
    }

    #[test]
    fn prop_nothing_is_said_before_the_window_is_whole_or_where_nothing_turns() {
        let mut t = track(1.2, 0.8, 0.0);
        t = ReversalTrack::new(t.plan);
        (0..7499).for_each(|_| t.push(0.0, 1.0));
        assert_eq!(t.found(), None);
        t.push(0.0, 1.0);
        assert_eq!((t.seen(), t.found()), (7500, None));
    }
}
