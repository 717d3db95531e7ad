//! Turning points of a small slow cosine: the motor sticks at each of them and breaks away anew, so that a test of a
//! second has several break-aways, of both directions, at a current that rises slowly.

use crate::extractor::Window;
/// Resolver counts about the turning point within which the motor stands.
const STANDS_COUNTS: f64 = 1.5;

/// Time after the first sample off the stand through which the motor's way is followed back to its begin [s] (assumed).
const FOLLOWED_S: f64 = 1.2e-3;

/// Between these times after break-away the current is that of dynamic friction [s] (assumed).
const KINETIC_S: (f64, f64) = (15e-3, 40e-3);

/// Before and after the begin of the motion the greatest current is looked for, of means over so long [s] (assumed).
const PEAK_S: (f64, f64, f64) = (4e-3, 1.2e-3, 0.3e-3);

/// Fewest samples of a line, of a way and of a mean.
const FEWEST: usize = 3;

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
        let mut sums = [([0.0; 3], 0.0_f64); 2];
        // the first turning point comes from the ramp: it is unlike the others
        let whole = (self.theta_rad.len() as f64 / half - 0.5 + 1e-6).floor() as usize;
        for m in 1..=whole {
            let upper = (m % 2 == 0) == (self.plan.sign > 0.0);
            let rows = ((m as f64 - 0.5) * half) as usize..((m as f64 + 0.5) * half) as usize;
            if let Some(found) = self.turn(m as f64 * half, rows, upper) {
                let (sum, count) = &mut sums[usize::from(upper)];
                sum.iter_mut().zip(found.values()).for_each(|(s, x)| *s += x);
                *count += 1.0;
            }
        }
        let [(a, m), (b, n)] = sums;
        let mean = |k: usize| 0.5 * (a[k] / m + b[k] / n);
        (m > 0.0 && n > 0.0).then(|| Reversals {
            break_away_a: mean(0),
            kinetic_a: mean(1),
            lag_s: mean(2),
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
        let stands = |k: usize| (x[k] - x[end]).abs() <= STANDS_COUNTS * self.plan.count_rad;
        let first = (rows.start..=end).rev().take_while(|&k| stands(k)).last()?;
        let last = (end..rows.end).take_while(|&k| stands(k)).last()?;
        // from rest at constant acceleration the root of the way rises straight
        let follow = ((FOLLOWED_S * self.plan.rate_hz) as usize).max(FEWEST);
        let way = last + 1..last + 1 + follow;
        if way.end > rows.end || last + 1 - first < FEWEST {
            return None;
        }
        let roots = way.map(|k| (k as f64, (sign * (x[k] - x[end])).max(0.0).sqrt()));
        let (at, slope) = line(roots).filter(|(_, slope)| *slope > 0.0)?;
        let begin = (at.0 - at.1 / slope).clamp(first as f64, (last + 1) as f64);
        let after = |s: f64| (begin + s * self.plan.rate_hz).round().max(0.0) as usize;
        let mean = |part: &[f64]| sign * part.iter().sum::<f64>() / part.len() as f64;
        let (before, behind, long) = PEAK_S;
        let peak = i.get(after(-before)..after(behind).max(after(-before) + FEWEST))?;
        let long = ((long * self.plan.rate_hz).round() as usize).max(1);
        let peaks = peak.windows(long).map(mean);
        let kinetic = i.get(after(KINETIC_S.0)..after(KINETIC_S.1).max(after(KINETIC_S.0) + FEWEST))?;
        Some(Reversals {
            break_away_a: peaks.fold(f64::NEG_INFINITY, f64::max),
            kinetic_a: mean(kinetic),
            lag_s: (begin - turns) / self.plan.rate_hz,
        })
    }
}

/// Middle and slope of the straight line through points; none through fewer than [`FEWEST`].
fn line(points: impl Iterator<Item = (f64, f64)> + Clone) -> Option<((f64, f64), f64)> {
    let (mut n, mut sx, mut sy) = (0.0, 0.0, 0.0);
    for (x, y) in points.clone() {
        (n, sx, sy) = (n + 1.0, sx + x, sy + y);
    }
    let (mx, my) = (sx / n, sy / n);
    let (mut xx, mut xy) = (0.0, 0.0);
    for (x, y) in points {
        xx += (x - mx) * (x - mx);
        xy += (x - mx) * (y - my);
    }
    (n >= FEWEST as f64).then(|| ((mx, my), xy / xx))
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
            assert!((found.break_away_a - 1.2).abs() < 0.03, "{found:?}");
            assert!((found.kinetic_a - 0.8).abs() < 1e-9, "{found:?}");
            assert!((found.lag_s - 0.015).abs() < 1e-3, "{found:?}");
        }
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
