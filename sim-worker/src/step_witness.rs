//! Witnesses from the step: how the speed turns with the rotor, how the current goes on while it is steady, and what it
//! takes to get there.

use crate::trig::sin_cos;
use crate::witness::torque_current;
use std::f64::consts::TAU;

/// Parts of two turns of the rotor in which the speed is averaged (assumed): orders up to 6 a turn.
const BINS: usize = 48;

/// Order of the speed's ripple that static eccentricity makes: three phases in each of which it acts once a turn.
const ECCENTRICITY: usize = 3;

/// Twice the orders that neither eccentricity nor six-step commutation makes.
const OTHERS: [usize; 7] = [1, 2, 3, 4, 5, 8, 10];

/// Speed by the rotor's angle over two turns.
#[derive(Clone, Debug)]
pub struct TurnSpectrum {
    /// what is taken off every speed [rad/s]
    shift: Option<f64>,
    /// sum and number of the speeds in each part
    bins: [(f64, u32); BINS],
}

impl Default for TurnSpectrum {
    fn default() -> Self {
        Self {
            shift: None,
            bins: [(0.0, 0); BINS],
        }
    }
}

/// How the speed turns with the rotor [rad/s at the motor].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Turning {
    /// amplitude with the cosine of three times the angle
    pub third_cosine: f64,
    /// with the sine
    pub third_sine: f64,
    /// root mean square of all orders up to 5 a turn, halves included, but the third
    pub others: f64,
}

impl TurnSpectrum {
    /// Takes a sample.
    pub fn push(&mut self, theta_rad: f64, omega_rad_per_s: f64) {
        let shift = *self.shift.get_or_insert(omega_rad_per_s);
        let turns = theta_rad * (0.5 / TAU);
        let place = ((turns - turns.floor()) * BINS as f64) as usize;
        let bin = &mut self.bins[place.min(BINS - 1)];
        bin.0 += omega_rad_per_s - shift;
        bin.1 += 1;
    }

    /// Once the rotor has been seen all round.
    pub fn turning(&self) -> Option<Turning> {
        if self.bins.iter().any(|b| b.1 == 0) {
            return None;
        }
        // fixed in size: asked for with every frame, which must not allocate
        let mean = self.bins.map(|(sum, n)| sum / f64::from(n));
        let amplitude = |twice: usize| {
            let (mut c, mut s) = (0.0, 0.0);
            for (k, x) in mean.iter().enumerate() {
                let (sin, cos) = sin_cos(TAU * twice as f64 * (k as f64 + 0.5) / BINS as f64);
                c += x * cos;
                s += x * sin;
            }
            (2.0 * c / BINS as f64, 2.0 * s / BINS as f64)
        };
        let (third_cosine, third_sine) = amplitude(2 * ECCENTRICITY);
        let others = OTHERS.iter().map(|&twice| {
            let (c, s) = amplitude(twice);
            0.5 * (c * c + s * s)
        });
        Some(Turning {
            third_cosine,
            third_sine,
            others: others.sum::<f64>().sqrt(),
        })
    }
}

/// A sample of the step.
#[derive(Clone, Copy, Debug)]
pub struct Sample {
    /// motor angle
    pub theta_rad: f64,
    /// motor speed
    pub omega_rad_per_s: f64,
    /// of the phases
    pub phases_a: [f64; 3],
}

/// Accumulates over the step.
#[derive(Clone, Debug, Default)]
pub struct StepWitness {
    turns: TurnSpectrum,
    /// sums and numbers of the torque-giving current in the first and the second half of the regime window
    halves: [(f64, u64); 2],
    /// sum and number of the torque-giving current from the step on
    run_up: (f64, u64),
    /// speed of the last sample [rad/s]
    speed: f64,
    /// one sample has reached the speed that ends the run-up, the next one confirms it: mean current up to there [A]
    pending: Option<f64>,
    run_up_a: Option<f64>,
}

impl StepWitness {
    /// Takes a sample of the regime window.
    ///
    /// * `second` whether it lies in the window's second half
    /// * `sign` of the step
    pub fn push_regime(&mut self, sample: Sample, pole_pairs: f64, sign: f64, second: bool) {
        self.turns.push(sample.theta_rad, sample.omega_rad_per_s);
        let half = &mut self.halves[usize::from(second)];
        half.0 += sign * torque_current(pole_pairs, sample.theta_rad, sample.phases_a);
        half.1 += 1;
    }

    /// Samples of the run-up that were taken.
    pub fn run_up_seen(&self) -> u64 {
        self.run_up.1
    }

    /// Whether the run-up is over.
    pub fn has_run_up(&self) -> bool {
        self.run_up_a.is_some()
    }

    /// Takes the next sample of the step.
    ///
    /// * `end_rad_per_s` speed that ends the run-up
    pub fn push_run_up(&mut self, sample: Sample, pole_pairs: f64, sign: f64, end_rad_per_s: f64) {
        if self.has_run_up() {
            return;
        }
        let (before, now) = (self.speed, sign * sample.omega_rad_per_s);
        let current = sign * torque_current(pole_pairs, sample.theta_rad, sample.phases_a);
        let reached = now >= end_rad_per_s;
        if reached && self.pending.is_some() {
            self.run_up_a = self.pending;
            return;
        }
        // straight between the sample that reaches it and the one before
        let share = (end_rad_per_s - before) / (now - before);
        self.pending = reached.then(|| (self.run_up.0 + share * current) / (self.run_up.1 as f64 + share));
        self.speed = now;
        self.run_up.0 += current;
        self.run_up.1 += 1;
    }

    /// How the speed turns with the rotor in the regime window.
    pub fn turning(&self) -> Option<Turning> {
        self.turns.turning()
    }

    /// By how much the torque-giving current rises from the first to the second half of the regime window [A]: what
    /// resists more the farther it has come.
    pub fn current_trend_a(&self) -> Option<f64> {
        let [(a, n), (b, m)] = self.halves;
        (n > 0 && m > 0).then(|| b / m as f64 - a / n as f64)
    }

    /// Mean torque-giving current until half the no-load speed is reached [A]. With the rise time it is what the inertia
    /// takes, by the current sensors.
    pub fn run_up_current_a(&self) -> Option<f64> {
        self.run_up_a
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// 0.45 s at 600 rad/s with ripple of two orders, at a rate [Hz].
    fn spectrum(rate: f64, third: (f64, f64), one: f64) -> Turning {
        let mut s = TurnSpectrum::default();
        for k in 0..(0.45 * rate) as usize {
            let theta = 600.3 / rate * k as f64 - 7.0;
            let ripple = third.0 * (3.0 * theta).cos() + third.1 * (3.0 * theta).sin() + one * (theta + 0.4).cos();
            s.push(theta, 600.3 + ripple);
        }
        s.turning().unwrap()
    }

    #[test]
    fn prop_orders_of_the_speed_are_told_apart_at_any_rate() {
        for rate in [2000.0, 10_000.0, 20_000.0] {
            let t = spectrum(rate, (1.0, -2.0), 0.0);
            // averaging over a part takes 0.6 % of the third order, at few samples a turn more
            assert!(
                (t.third_cosine - 1.0).abs() < 0.06 && (t.third_sine + 2.0).abs() < 0.06,
                "{rate} {t:?}"
            );
            assert!(t.others < 0.03, "{rate} {t:?}");
            let t = spectrum(rate, (0.0, 0.0), 0.5);
            assert!((t.others - 0.5 / 2f64.sqrt()).abs() < 0.02, "{rate} {t:?}");
            assert!(t.third_cosine.abs() < 0.01 && t.third_sine.abs() < 0.01, "{rate} {t:?}");
        }
        assert_eq!(TurnSpectrum::default().turning(), None);
    }

    #[test]
    fn prop_the_run_up_ends_where_the_speed_is_reached_twice() {
        let mut w = StepWitness::default();
        let sample = |omega_rad_per_s| Sample {
            theta_rad: (90.0_f64 - 30.0).to_radians() / 2.0,
            omega_rad_per_s,
            phases_a: [-2.0, 2.0, 0.0],
        };
        for omega in [-1.0, -9.0, -3.0] {
            w.push_run_up(sample(omega), 2.0, -1.0, 8.0);
            assert_eq!(w.run_up_current_a(), None);
        }
        for omega in [-9.0, -9.5, -10.0] {
            w.push_run_up(sample(omega), 2.0, -1.0, 8.0);
        }
        assert!(w.has_run_up() && w.run_up_seen() == 4);
        assert!((w.run_up_current_a().unwrap() - 2.0).abs() < 1e-12);
    }

    #[test]
    fn prop_current_that_rises_with_the_way_has_a_trend() {
        let mut w = StepWitness::default();
        for k in 0..100 {
            let sample = Sample {
                theta_rad: (90.0_f64 - 30.0).to_radians() / 2.0,
                omega_rad_per_s: 600.0,
                phases_a: [1.0 + 0.01 * k as f64, -1.0 - 0.01 * k as f64, 0.0],
            };
            w.push_regime(sample, 2.0, 1.0, k >= 50);
        }
        assert!((w.current_trend_a().unwrap() - 0.5).abs() < 1e-12);
        assert_eq!(StepWitness::default().current_trend_a(), None);
    }
}
