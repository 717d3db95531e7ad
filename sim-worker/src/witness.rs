//! Witnesses: what the faults hardly change, and other defects do. They locate nothing; where one differs
//! from what it should be at the located pair, the test is not explained by these faults.

use crate::plant::back_emf::{coefficient, fold};
use schemas::channel::Channel;
use schemas::telemetry::TelemetryView;
use std::f64::consts::PI;
use std::ops::Range;

/// Parts of the sine's travel in which currents forth and back are compared (assumed).
const BINS: usize = 24;

/// Travel that the bins cover, as a share of the commanded one, each way.
const REACH: f64 = 1.25;

/// Share of the sine's greatest speed below which the direction is left open: reversal (assumed).
const SLOWEST: f64 = 0.1;

/// Fewest samples of a bin, each way.
const FEWEST: u32 = 8;

/// Torque-giving current: half the sum of the phase currents times their normalised back-EMF shapes [A].
pub(crate) fn torque_current(pole_pairs: f64, theta_m_rad: f64, phases: [f64; 3]) -> f64 {
    // electrical angle less 90 degrees in units of 30 degrees, wrapped to -6..6
    let r = (pole_pairs * theta_m_rad * (6.0 / PI) - 3.0 + 6.0).rem_euclid(12.0) - 6.0;
    let shapes = fold(r).map(|f| coefficient::<true>(f, 1.0));
    0.5 * (shapes[0] * phases[0] + shapes[1] * phases[1] + shapes[2] * phases[2])
}

/// What the sine is expected to be like.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SineShape {
    /// P, as a number to calculate with
    pub pole_pairs: f64,
    /// amplitude at the motor [rad]
    pub amplitude_rad: f64,
    /// greatest speed of the motor [rad/s]
    pub speed_rad_per_s: f64,
}

/// Accumulates over the sine.
#[derive(Clone, Debug)]
pub struct SineWitness {
    /// motor angle where the sine begins [rad]
    start: Option<f64>,
    travel: (f64, f64),
    current_sum: f64,
    seen: u64,
    /// sums and numbers of the torque-giving current by place, back and forth
    bins: [[(f64, u32); BINS]; 2],
}

impl Default for SineWitness {
    fn default() -> Self {
        Self {
            start: None,
            travel: (f64::INFINITY, f64::NEG_INFINITY),
            current_sum: 0.0,
            seen: 0,
            bins: [[(0.0, 0); BINS]; 2],
        }
    }
}

impl SineWitness {
    /// Takes samples of the sine.
    pub fn push(&mut self, shape: &SineShape, view: &TelemetryView<'_>, rows: Range<usize>) {
        let column = |c| view.column(c);
        let Some(theta) = column(Channel::ThetaM).map(|t| &t[rows.clone()]) else {
            return;
        };
        let Some(&first) = theta.first() else { return };
        let start = *self.start.get_or_insert(first);
        for &x in theta {
            self.travel = (self.travel.0.min(x), self.travel.1.max(x));
        }
        let (Some(omega), Some(a), Some(b), Some(c)) = (
            column(Channel::OmegaM),
            column(Channel::IA),
            column(Channel::IB),
            column(Channel::IC),
        ) else {
            return;
        };
        let per_bin = BINS as f64 / (2.0 * REACH * shape.amplitude_rad);
        let least = SLOWEST * shape.speed_rad_per_s;
        for (i, &x) in rows.zip(theta) {
            self.current_sum += a[i] + b[i] + c[i];
            self.seen += 1;
            let place = (x - start) * per_bin + 0.5 * BINS as f64;
            if omega[i].abs() > least && place >= 0.0 && place < BINS as f64 {
                let bin = &mut self.bins[usize::from(omega[i] > 0.0)][place as usize];
                bin.0 += torque_current(shape.pole_pairs, x, [a[i], b[i], c[i]]);
                bin.1 += 1;
            }
        }
    }

    /// From one turning point to the other at the motor [rad]: what backlash adds to.
    pub fn travel_rad(&self) -> Option<f64> {
        (self.travel.0 <= self.travel.1).then_some(self.travel.1 - self.travel.0)
    }

    /// Mean of the sum of the phase currents [A]: nothing but offsets of the sensors, as the star point has
    /// no way out.
    pub fn current_sum_a(&self) -> Option<f64> {
        (self.seen > 0).then(|| self.current_sum / self.seen as f64)
    }

    /// The part of the torque-giving current that turns round with the motion, against the place, its mean [A]: what
    /// dynamic friction takes. Inertia takes the same forth and back, and so does a bias.
    pub fn kinetic_current_a(&self) -> Option<f64> {
        let (mut sum, mut count) = (0.0, 0);
        for (_, back, forth) in self.both_ways() {
            sum += 0.5 * (forth - back);
            count += 1;
        }
        (count >= BINS / 3).then(|| sum / count as f64)
    }

    /// How that part differs from place to place: its slope and its bend over the place, places in amplitudes of the sine
    /// [A]. Friction that differs by place tilts it, friction that differs by speed bends it: turning points are slow.
    pub fn kinetic_shape_a(&self) -> Option<(f64, f64)> {
        let place = |k: usize| ((k as f64 + 0.5) * 2.0 / BINS as f64 - 1.0) * REACH;
        let (mut n, mut x1, mut x2, mut y1) = (0.0, 0.0, 0.0, 0.0);
        for (k, back, forth) in self.both_ways() {
            let x = place(k);
            n += 1.0;
            x1 += x;
            x2 += x * x;
            y1 += 0.5 * (forth - back);
        }
        if n < (BINS / 3) as f64 {
            return None;
        }
        let (mx, mxx, my) = (x1 / n, x2 / n, y1 / n);
        let (mut xx, mut xy, mut qq, mut qy) = (0.0, 0.0, 0.0, 0.0);
        for (k, back, forth) in self.both_ways() {
            let (x, y) = (place(k) - mx, 0.5 * (forth - back) - my);
            let q = place(k).powi(2) - mxx;
            xx += x * x;
            xy += x * y;
            qq += q * q;
            qy += q * y;
        }
        Some((xy / xx, qy / qq))
    }

    /// Places that were passed often enough both ways: number, mean torque-giving current back and forth [A].
    fn both_ways(&self) -> impl Iterator<Item = (usize, f64, f64)> {
        let mean = |(sum, n): (f64, u32)| sum / f64::from(n);
        let places = self.bins[0].iter().zip(&self.bins[1]).enumerate();
        let seen = places.filter(|(_, (back, forth))| back.1 >= FEWEST && forth.1 >= FEWEST);
        seen.map(move |(k, (back, forth))| (k, mean(*back), mean(*forth)))
    }

    /// The part of the torque-giving current that does not turn round with the motion, against the place: its
    /// mean (a bias torque), and the root mean square of what a straight line leaves (cogging, a tight
    /// spot; the straight line is the inertia's) [A].
    pub fn even_current_a(&self) -> Option<(f64, f64)> {
        // fixed in size: asked for with every frame, which must not allocate
        let (mut x, mut y, mut count) = ([0.0; BINS], [0.0; BINS], 0);
        for (k, back, forth) in self.both_ways() {
            (x[count], y[count]) = (k as f64, 0.5 * (back + forth));
            count += 1;
        }
        if count < BINS / 3 {
            return None;
        }
        let (x, y, n) = (&x[..count], &y[..count], count as f64);
        let (mx, my) = (x.iter().sum::<f64>() / n, y.iter().sum::<f64>() / n);
        let (mut xx, mut xy) = (0.0, 0.0);
        for (x, y) in x.iter().zip(y) {
            xx += (x - mx) * (x - mx);
            xy += (x - mx) * (y - my);
        }
        let slope = xy / xx;
        let left = x.iter().zip(y).map(|(x, y)| (y - my - slope * (x - mx)).powi(2));
        Some((my, (left.sum::<f64>() / n).sqrt()))
    }
}

/// Difference of the greatest and the smallest phase current over their mean [-], root mean squares: a
/// phase that is unlike the others.
///
/// * `sums` of squares of the phases over the same samples [A^2]
pub fn imbalance(sums: [f64; 3]) -> Option<f64> {
    let rms = sums.map(f64::sqrt);
    let (lo, hi) = rms
        .iter()
        .fold((f64::INFINITY, 0.0_f64), |(a, b), &x| (a.min(x), b.max(x)));
    let mean = (rms[0] + rms[1] + rms[2]) / 3.0;
    (mean > 0.0).then(|| (hi - lo) / mean)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn prop_torque_current_is_that_of_two_phases_in_series() {
        // in the middle of a sector one phase carries the current, another brings it back
        let theta = (90.0_f64 - 30.0).to_radians() / 2.0;
        let phases = [1.5, -1.5, 0.0];
        assert!((torque_current(2.0, theta, phases) - 1.5).abs() < 1e-12);
        assert!((torque_current(2.0, theta + 2.0 * PI, phases) - 1.5).abs() < 1e-9);
        assert!((torque_current(2.0, theta - 4.0 * PI, phases) - 1.5).abs() < 1e-9);
    }

    /// A sine of 0.5 rad at the motor with dry friction, inertia, a bias and cogging.
    fn witness(bias: f64, cogging: f64) -> SineWitness {
        let shape = SineShape {
            pole_pairs: 2.0,
            amplitude_rad: 0.5,
            speed_rad_per_s: 15.7,
        };
        let n = 10_000;
        let w = 2.0 * PI * 5.0 / n as f64;
        let mut columns = vec![vec![0.0; n]; 5];
        for i in 0..n {
            let (s, c) = (w * i as f64).sin_cos();
            let theta = 0.5 * s;
            let current = 0.3 * c.signum() - 0.16 * s + bias + cogging * (12.0 * theta).sin();
            // of the phase pair that carries it here: shapes by the module's own convention
            let unit = [[1.0, -1.0, 0.0], [1.0, 0.0, -1.0], [0.0, 1.0, -1.0]]
                .into_iter()
                .max_by(|a, b| {
                    torque_current(2.0, theta, *a)
                        .abs()
                        .total_cmp(&torque_current(2.0, theta, *b).abs())
                })
                .unwrap();
            let per = torque_current(2.0, theta, unit);
            columns[0][i] = theta;
            columns[1][i] = 15.7 * c;
            (0..3).for_each(|q| columns[2 + q][i] = unit[q] * current / per);
        }
        let view = TelemetryView::new(1, n)
            .with(Channel::ThetaM, &columns[0])
            .with(Channel::OmegaM, &columns[1])
            .with(Channel::IA, &columns[2])
            .with(Channel::IB, &columns[3])
            .with(Channel::IC, &columns[4]);
        let mut whole = SineWitness::default();
        whole.push(&shape, &view, 0..n);
        // in pieces the same
        let mut pieces = SineWitness::default();
        for k in 0..10 {
            pieces.push(&shape, &view, k * n / 10..(k + 1) * n / 10);
        }
        assert_eq!(pieces.even_current_a(), whole.even_current_a());
        whole
    }

    #[test]
    fn prop_even_current_shows_bias_and_cogging_but_not_friction_and_inertia() {
        let (bias, even) = witness(0.0, 0.0).even_current_a().unwrap();
        assert!(bias.abs() < 2e-3 && even < 2e-3, "{bias} {even}");
        let (bias, even) = witness(0.05, 0.0).even_current_a().unwrap();
        assert!((bias - 0.05).abs() < 2e-3 && even < 2e-3, "{bias} {even}");
        let (_, even) = witness(0.0, 0.04).even_current_a().unwrap();
        assert!((even - 0.04 / 2f64.sqrt()).abs() < 4e-3, "{even}");
        assert!((witness(0.0, 0.0).travel_rad().unwrap() - 1.0).abs() < 1e-6);
        // friction that is the same everywhere is flat
        let (tilt, bend) = witness(0.0, 0.0).kinetic_shape_a().unwrap();
        assert!(tilt.abs() < 2e-3 && bend.abs() < 2e-3, "{tilt} {bend}");
        // friction alone, whatever is added that does not turn round
        for (bias, cogging) in [(0.0, 0.0), (0.05, 0.0), (0.0, 0.04)] {
            let kinetic = witness(bias, cogging).kinetic_current_a().unwrap();
            assert!((kinetic - 0.3).abs() < 2e-3, "{kinetic}");
        }
    }

    #[test]
    fn prop_imbalance_is_relative() {
        assert_eq!(imbalance([4.0, 4.0, 4.0]), Some(0.0));
        let one = imbalance([4.0, 4.0, 4.41]).unwrap();
        assert!((one - 0.1 / (6.1 / 3.0)).abs() < 1e-12);
        assert_eq!(imbalance([0.0; 3]), None);
    }
}
