//! What the sensors make of a run.

use super::effects::{Effect, Kind};
use super::{Row, Run, Setting};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use std::f64::consts::TAU;

/// Channel noise, rms per 1 kHz sample: speed rad/s, current A, voltage V, temperature K, load N m.
pub const NOISE: [f64; 5] = [0.2, 0.02, 0.05, 0.1, 0.001];
/// Columns of [`Row`] that [`NOISE`] belongs to.
const NOISY: [usize; 5] = [2, 3, 4, 6, 7];
/// Motor resolver, 16 bits a turn.
pub const MOTOR_STEP: f64 = TAU / 65536.0;
/// User encoder, rad (assumed high resolution: 7.5e-5 rad at the motor).
pub const USER_STEP: f64 = 1.5e-7;

/// The sensors of one rig: the same in all its runs.
#[derive(Clone, Debug)]
pub struct Sensors {
    /// Factor and offset on speed, current, voltage.
    pub gain: [f64; 3],
    pub offset: [f64; 3],
    /// Correlation of the noise from sample to sample.
    pub correlation: f64,
    /// Amplitude of the 50 Hz hum on current and voltage over the noise rms.
    pub hum: f64,
}

fn normal(rng: &mut ChaCha8Rng) -> f64 {
    (-2.0 * (1.0 - rng.random::<f64>()).ln()).sqrt() * (TAU * rng.random::<f64>()).cos()
}

impl Sensors {
    pub(super) fn draw(setting: Setting, rng: &mut ChaCha8Rng) -> Sensors {
        let mut both = |x: f64| x * (2.0 * rng.random::<f64>() - 1.0);
        match setting {
            Setting::Matched => Sensors {
                gain: [1.0; 3],
                offset: [0.0; 3],
                correlation: 0.0,
                hum: 0.0,
            },
            Setting::Other => Sensors {
                gain: [1.0 + both(0.01), 1.0 + both(0.01), 1.0 + both(0.01)],
                offset: [0.0, both(0.005), both(0.05)],
                correlation: 0.75 + both(0.15),
                hum: 1.5,
            },
        }
    }

    /// Makes measurements of the true sample means.
    pub(super) fn measure(&self, run: &Run, effects: &[Effect], rng: &mut ChaCha8Rng) -> Vec<Row> {
        let amp = |kind| effects.iter().find(|e| e.kind == kind).map_or(0.0, |e| e.amp);
        let (gain, offset) = (1.0 + amp(Kind::CurrentGain), amp(Kind::CurrentOffset));
        let fresh = (1.0 - self.correlation * self.correlation).sqrt();
        let phases = [TAU * rng.random::<f64>(), TAU * rng.random::<f64>()];
        let mut coloured: [f64; 5] = std::array::from_fn(|_| normal(rng));
        let mut out = Vec::with_capacity(run.rows.len());
        for (k, row) in run.rows.iter().enumerate() {
            let mut m = *row;
            m[3] = m[3] * gain + offset;
            for n in 0..3 {
                m[2 + n] = m[2 + n] * self.gain[n] + self.offset[n];
            }
            for n in 0..5 {
                coloured[n] = self.correlation * coloured[n] + fresh * normal(rng);
                m[NOISY[n]] += NOISE[n] * coloured[n];
            }
            for n in 0..2 {
                m[3 + n] += self.hum * NOISE[1 + n] * (TAU * 50.0 * k as f64 / 1000.0 + phases[n]).sin();
            }
            m[1] = (m[1] / MOTOR_STEP).round() * MOTOR_STEP;
            m[5] = (m[5] / USER_STEP).round() * USER_STEP;
            out.push(m);
        }
        out
    }
}
