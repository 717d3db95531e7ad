//! The mechanics of a bench as a filter: what noise its torque and its sensors have, and the rows that follow.

use crate::equations::clock::{Clock, NoiseTable};
use crate::equations::signals::Signals;
use crate::equations::whitener::{Design, Rows, Set, Whitener};
use crate::measured::bench::{Bench, BenchChannel};
use crate::measured::recording::{Run, range};

/// How the rows of the torque equation are made.
pub enum Mechanics {
    /// samples are means at one speed each
    Steady,
    Moving(Box<Whitener>),
}

impl Mechanics {
    /// Rows of several sets of signals.
    pub fn rows(&self, all: &[Set], s: &Signals) -> Vec<Rows> {
        match self {
            Self::Steady => {
                let torques = all.iter().map(|[torque, ..]| *torque);
                let still = || vec![0.0; s.n];
                torques
                    .map(|t| [t.map_or_else(still, <[f64]>::to_vec), still()])
                    .collect()
            }
            Self::Moving(w) => w.rows(all, &s.resting),
        }
    }

    pub fn samples(&self, s: &Signals) -> Vec<usize> {
        match self {
            Self::Steady => (0..s.n).collect(),
            Self::Moving(w) => w.samples(&s.resting),
        }
    }

    /// By how many samples the moments at which angle and speed are measured are later than the common one.
    pub fn ahead(&self) -> [f64; 2] {
        match self {
            Self::Steady => [0.0; 2],
            Self::Moving(w) => w.ahead(),
        }
    }

    pub fn group(&self) -> usize {
        match self {
            Self::Steady => 1,
            Self::Moving(w) => w.group(),
        }
    }
}

/// Rows of all runs together beyond which samples are taken together.
const MOST_ROWS: usize = 16_000;
/// Share of the way that the torque makes in a sample by which the angle at its end is off (assumed).
const UNEVEN: f64 = 0.02;
/// Most samples in a grain of an angle sensor that count.
const LONGEST_GRAIN: f64 = 30.0;
/// No torque is known better than this share of its rms (assumed).
const BEST_TORQUE: f64 = 2e-4;

/// The filter of the mechanics, and the share of its torque noise that is the sensor's.
///
/// * `excess` torque that the model does not have, noise to what is still looked for; `between` what the drive does
///   between its samples, rms [N m]
pub fn mechanics(
    bench: &Bench,
    runs: &[&Run],
    clock: &Clock,
    noise: &NoiseTable,
    (excess, between): (f64, f64),
) -> (Mechanics, f64) {
    use BenchChannel as C;
    if clock.steady {
        return (Mechanics::Steady, 0.0);
    }
    let rig = &bench.rig;
    let has = |c: C| runs.iter().all(|r| r.channel(c).is_some());
    // while an angle sensor stays within a grain its error is one error, not many
    let held = |c: C| -> f64 {
        let (Some(spec), false) = (bench.channel(c), has(C::Velocity) && c != C::Position) else {
            return 1.0;
        };
        let white = noise.get(&c).map_or(0.0, |n| n.rms);
        if spec.resolution <= 0.0 || white > 0.6 * spec.resolution {
            return 1.0;
        }
        let (mut sum, mut count) = (0.0, 0.0);
        for x in runs.iter().filter_map(|r| r.channel(c)) {
            for w in x.windows(17).step_by(8) {
                let step = (w[16] - w[0]).abs() / 16.0;
                if step > 0.0 {
                    sum += (spec.resolution / step).clamp(1.0, LONGEST_GRAIN);
                    count += 1.0;
                }
            }
        }
        f64::sqrt(sum / f64::max(count, 1.0)).max(1.0)
    };
    let of = |c: C| {
        let (rms, range) = (noise.get(&c).map_or(0.0, |n| n.slow_rms()), range(runs, c));
        ((rms * held(c)).max(1e-7 * range).max(1e-15), clock.lateness(bench, c).1)
    };
    let sensor = rig.drive_constant.value.abs() * noise.get(&rig.drive).map_or(0.0, |n| n.slow_rms());
    let load = noise.get(&C::Load).map_or(0.0, |n| n.slow_rms());
    let (mut sum, mut count) = (0.0, 0.0);
    for x in runs.iter().filter_map(|r| r.channel(rig.drive)) {
        sum += x.iter().map(|u| u * u).sum::<f64>();
        count += x.len() as f64;
    }
    let usual = rig.drive_constant.value.abs() * (sum / f64::max(count, 1.0)).sqrt();
    let least = BEST_TORQUE * usual;
    let total = (sensor * sensor + between * between + load * load + least * least + excess * excess)
        .sqrt()
        .max(1e-300);
    let samples: usize = runs.iter().map(|r| r.samples).sum();
    let dt = 1.0 / clock.rate_hz;
    // within a sample the torque is not even: the angle at its end is known less well than its sensor is
    let uneven = UNEVEN * dt * dt * usual / rig.inertia.value.max(1e-15);
    let position = has(C::Position).then(|| {
        let (rms, late) = of(C::Position);
        (rms.hypot(uneven), late)
    });
    let design = Design {
        dt,
        inertia: rig.inertia.value.max(1e-15),
        torque_noise: total,
        lost_torque: usual,
        position,
        velocity: has(C::Velocity).then(|| of(C::Velocity)),
        group: samples.div_ceil(MOST_ROWS),
    };
    (
        Mechanics::Moving(Box::new(Whitener::new(design))),
        (sensor / total).powi(2),
    )
}
