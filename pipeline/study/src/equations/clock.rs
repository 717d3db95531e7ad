//! What is the same for all runs of a bench: the moment and the corner that its channels are brought to, and which channels the motion
//! is taken from.

use crate::measured::bench::{Bench, BenchChannel, ChannelSpec};
use crate::measured::filter::FilterBank;
use crate::measured::noise::ChannelNoise;
use crate::measured::recording::{self, Run};
use std::collections::BTreeMap;

/// Highest corner of the filters as a share of the sampling rate, and lowest corner [Hz] (assumed).
const HIGHEST: f64 = 1.0 / 16.0;
const LOWEST_HZ: f64 = 0.02;
/// Share of the greatest speed that is never called motion (assumed).
const CREEP: f64 = 1e-3;
/// Least and about greatest standard deviation of the smoother of the motion [samples] (assumed).
const LEAST_SMOOTH: f64 = 1.5;
const MOST_SMOOTH: f64 = 5.0;
/// Greatest delay between channels that is looked for [s].
pub const MOST_DELAY_S: f64 = 5e-3;

/// Most of a run's samples that are left out at either end, as a share (assumed).
const MOST_OF_ENDS: f64 = 0.05;

/// Length of a row of the electrical equation [s], and its fewest samples (assumed): means over it leave little of
/// the noise, and the current's change over it is known by its ends.
const WINDOW_S: f64 = 0.006;
const FEWEST_IN_WINDOW: usize = 8;

/// Noise of each channel.
pub type NoiseTable = BTreeMap<BenchChannel, ChannelNoise>;

/// What is the same for all runs.
#[derive(Clone, Debug)]
pub struct Clock {
    pub rate_hz: f64,
    pub corner_hz: f64,
    /// samples from one row to the next
    pub stride: usize,
    /// whether speed and acceleration come from the position rather than the velocity channel
    pub from_position: bool,
    /// standard deviation of the smoothed speed [rad/s]
    pub speed_noise: f64,
    /// smoothing of the speed [samples]
    pub(super) smooth: f64,
    /// the moment all signals are brought to, before their time stamp [s]
    shift_s: f64,
    /// samples are means at one speed each
    pub steady: bool,
}

impl Clock {
    /// * `runs` all that a study uses, of one rate
    pub fn new(bench: &Bench, runs: &[&Run], noise: &NoiseTable) -> Self {
        let rate_hz = runs[0].rate_hz;
        if runs[0].steady {
            return Self {
                rate_hz,
                corner_hz: rate_hz,
                stride: 1,
                from_position: false,
                speed_noise: 0.0,
                smooth: 0.0,
                shift_s: 0.0,
                steady: true,
            };
        }
        let rig = &bench.rig;
        let get = |c: BenchChannel| noise.get(&c).map_or(0.0, |n| n.rms);
        let has = |c: BenchChannel| runs.iter().all(|r| r.channel(c).is_some());
        let drive = rig.drive_constant.value * get(rig.drive);
        let from_position = if has(BenchChannel::Position) && has(BenchChannel::Velocity) {
            let bank = FilterBank::new(rate_hz * 0.04, rate_hz, 0.0);
            let a = get(BenchChannel::Position) * bank.order[2].noise_gain();
            let b = get(BenchChannel::Velocity) * bank.order[1].noise_gain();
            a <= b
        } else {
            has(BenchChannel::Position)
        };
        // the sensor that the motion is taken from, and which derivative of it the speed is
        let (sensor, order) = match from_position {
            true => (BenchChannel::Position, 1),
            false => (BenchChannel::Velocity, 0),
        };
        // the highest corner at which the acceleration does not drown the drive signal
        let mut corner_hz = HIGHEST * rate_hz;
        while corner_hz > (0.004 * rate_hz).max(LOWEST_HZ) {
            let bank = FilterBank::new(corner_hz, rate_hz, 0.0);
            let a = get(sensor) * bank.order[order + 1].noise_gain();
            if rig.inertia.value * a <= (drive * bank.order[0].noise_gain()).max(1e-300) {
                break;
            }
            corner_hz *= 0.8;
        }
        let smoother = |sigma: f64| FilterBank::smoother(sigma, rate_hz, 0.0).order[order].clone();
        let speed_noise_of = |sigma: f64| get(sensor) * smoother(sigma).noise_gain();
        let of_position = runs
            .iter()
            .filter_map(|r| r.channel(BenchChannel::Position))
            .flat_map(|x| x.windows(11).map(|w| (w[10] - w[0]).abs() * rate_hz * 0.1))
            .fold(0.0, f64::max);
        let of_velocity = runs
            .iter()
            .filter_map(|r| r.channel(BenchChannel::Velocity))
            .flatten()
            .fold(0.0, |a: f64, w| a.max(w.abs()));
        let fastest = if of_position > 0.0 { of_position } else { of_velocity };
        let seen: Vec<&[f64]> = runs.iter().filter_map(|r| r.channel(sensor)).collect();
        // what a smoother takes from the motion itself, rms [rad/s]
        let taken = |sigma: f64| {
            let beyond = smoother(sigma).beyond(&smoother(LEAST_SMOOTH));
            let half = beyond.half();
            let of_run = |x: &[f64]| -> (f64, f64) {
                let each = (half..x.len().saturating_sub(half)).step_by(3);
                each.fold((0.0, 0.0), |(sum, n), k| (sum + beyond.at(x, k).powi(2), n + 1.0))
            };
            let (sum, n) = seen
                .iter()
                .map(|x| of_run(x))
                .fold((0.0, 0.0), |a, b| (a.0 + b.0, a.1 + b.1));
            let of_noise = (get(sensor) * beyond.noise_gain()).powi(2);
            (sum / f64::max(n, 1.0) - of_noise).max(0.0).sqrt()
        };
        let mut smooth = LEAST_SMOOTH;
        while smooth < MOST_SMOOTH && speed_noise_of(smooth) > 2e-4 * fastest {
            let next = smooth * 1.3;
            if taken(next) > speed_noise_of(next) {
                break;
            }
            smooth = next;
        }
        let stride = (rate_hz / (4.0 * corner_hz)).round().max(1.0) as usize;
        let drive_spec = bench.channel(rig.drive).expect("checked when read");
        Self {
            rate_hz,
            corner_hz,
            stride,
            from_position,
            speed_noise: speed_noise_of(smooth).max(CREEP * fastest),
            smooth,
            shift_s: lateness(drive_spec.mean, rate_hz, drive_spec.delay_s),
            steady: false,
        }
    }

    /// Samples in a block that is as good as independent of the next.
    pub fn block(&self, seconds: f64) -> usize {
        if self.steady {
            recording::PIECES
        } else {
            ((seconds * self.rate_hz) as usize).max(1)
        }
    }

    /// The filters for a channel.
    pub fn bank(&self, bench: &Bench, c: BenchChannel) -> FilterBank {
        if self.steady {
            return self.common();
        }
        FilterBank::new(self.corner_hz, self.rate_hz, self.shift(bench, c))
    }

    /// The filters for signals that are on the common clock already.
    pub fn common(&self) -> FilterBank {
        if self.steady {
            return FilterBank::identity();
        }
        FilterBank::new(self.corner_hz, self.rate_hz, 0.0)
    }

    /// For the mechanics' filter, whose samples end half a sample after the common moment: whole samples by
    /// which a channel is late, and how long before a sample's end its value was true after that [s].
    pub fn lateness(&self, bench: &Bench, c: BenchChannel) -> (i64, f64) {
        let late = self.shift(bench, c) + 0.5 / self.rate_hz;
        let whole = (late * self.rate_hz + 1e-9).floor();
        (whole as i64, late - whole / self.rate_hz)
    }

    /// Samples at the beginning and at the end of a run of which the moment may not have been recorded in every channel: of one that
    /// is late its last are missing, of one that is early its first. As many for every delay that is looked for, so that one row
    /// more or less does not decide between delays. Pieces of our own telemetry go on in the next piece.
    pub(super) fn ends(&self, bench: &Bench, run: &Run) -> (usize, usize) {
        if bench.own {
            return (0, 0);
        }
        let least = (MOST_DELAY_S * self.rate_hz)
            .ceil()
            .min(MOST_OF_ENDS * run.samples as f64) as i64;
        let channels = bench.channels.iter().map(|c| c.channel);
        let whole = channels
            .filter(|c| run.channel(*c).is_some())
            .map(|c| self.lateness(bench, c).0);
        let (first, last) = whole.fold((least, least), |(first, last), w| {
            (i64::max(first, -w), i64::max(last, w))
        });
        let samples = |x: i64| (x as usize).min(run.samples);
        (samples(first), samples(last))
    }

    /// How much later than the common moment a channel's value is written down [s].
    pub(super) fn shift(&self, bench: &Bench, c: BenchChannel) -> f64 {
        self.shift_of(bench.channel(c).expect("only asked for channels that are there"))
    }

    pub(super) fn shift_of(&self, spec: &ChannelSpec) -> f64 {
        lateness(spec.mean, self.rate_hz, spec.delay_s) - self.shift_s
    }
}

fn lateness(mean: bool, rate_hz: f64, delay_s: f64) -> f64 {
    delay_s + if mean { 0.5 / rate_hz } else { 0.0 }
}

/// Samples in a row of the electrical equation.
pub fn window(rate_hz: f64) -> usize {
    ((WINDOW_S * rate_hz).round() as usize).max(FEWEST_IN_WINDOW)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::equations::signals::{Signals, noise_table};
    use crate::measured::prescribed::{Sensor, axis};

    #[test]
    fn a_smoother_takes_no_more_of_the_motion_than_of_the_noise() {
        let of = |rate_hz: f64| {
            let (bench, runs) = axis(rate_hz, Sensor::Speed(0.3), false);
            let all: Vec<&Run> = runs.iter().collect();
            let clock = Clock::new(&bench, &all, &noise_table(&bench, &runs));
            let s = Signals::new(&bench, all[0], &clock);
            (clock.smooth, s)
        };
        // 0.1 s from rest to 140 rad/s
        let (few, s) = of(200.0);
        assert_eq!(few, LEAST_SMOOTH);
        assert!(of(4000.0).0 > 4.0);
        // the first move ends at 0.35 s: nothing is known of the friction before the smoothed speed has come to rest
        assert!(s.resting[68..100].iter().all(|r| *r));
        assert!(!s.resting[30..64].iter().any(|r| *r));
    }
}
