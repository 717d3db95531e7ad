//! Motions that an ideal servo follows, commands for a closed loop, and drive steps for free spins.

use super::dice::Dice;
use std::f64::consts::{PI, TAU};

/// A prescribed speed with its derivative in closed form.
#[derive(Clone, Debug)]
pub enum Motion {
    /// A constant plus sines: (amplitude, angular frequency, phase).
    Sines { mean: f64, parts: Vec<(f64, f64, f64)> },
    /// One sine whose frequency goes linearly from f0 to f1 within T.
    Chirp {
        amplitude: f64,
        f0: f64,
        f1: f64,
        span: f64,
        mean: f64,
    },
    /// Levels of speed with cosine-shaped ramps: (start of the ramp, level) and the ramp's length.
    Stairs { steps: Vec<(f64, f64)>, ramp: f64 },
}

impl Motion {
    /// Draws a motion of up to `w_max` with frequencies between `f.0` and `f.1`; `one_way` never reverses.
    pub fn draw(kind: usize, w_max: f64, f: (f64, f64), span: f64, one_way: bool, d: &mut Dice) -> Motion {
        let mean = if one_way { 0.55 * w_max } else { 0.0 };
        let room = if one_way { 0.45 * w_max } else { w_max };
        match kind {
            0 => {
                let count = 3 + (d.u() * 4.0) as usize;
                let mut parts: Vec<(f64, f64, f64)> = (0..count)
                    .map(|k| {
                        let x = (k as f64 + d.uni(-0.3, 0.3)) / (count - 1) as f64;
                        let hz = f.0 * (f.1 / f.0).powf(x);
                        (d.uni(0.4, 1.0) * (f.0 / hz).powf(0.35), TAU * hz, d.phase())
                    })
                    .collect();
                let peak = (0..4000)
                    .map(|k| {
                        let t = span * k as f64 / 4000.0;
                        parts.iter().map(|p| p.0 * (p.1 * t + p.2).cos()).sum::<f64>().abs()
                    })
                    .fold(0.0, f64::max);
                parts.iter_mut().for_each(|p| p.0 *= room / peak);
                Motion::Sines { mean, parts }
            }
            1 => Motion::Chirp {
                amplitude: room,
                f0: f.0,
                f1: f.1,
                span,
                mean,
            },
            _ => {
                // pairs of equal and opposite levels keep the travel bounded
                let ramp = d.uni(0.1, 0.25) / f.0.max(0.3) * 0.5;
                let hold = d.uni(0.5, 1.0) / f.0;
                let (mut t, mut steps) = (0.0, vec![]);
                while t < span {
                    let level = w_max * d.pick(&[0.1, 0.2, 0.35, 0.5, 0.7, 0.85, 1.0]);
                    let dwell = ramp + hold * d.uni(0.4, 0.8) * 0.6;
                    if one_way {
                        steps.push((t, level.max(0.12 * w_max)));
                        t += dwell;
                    } else {
                        let s = d.sign();
                        steps.push((t, s * level));
                        steps.push((t + dwell, -s * level));
                        t += 2.0 * dwell;
                    }
                }
                Motion::Stairs { steps, ramp }
            }
        }
    }

    /// Speed and acceleration at a time.
    pub fn at(&self, t: f64) -> (f64, f64) {
        match self {
            Motion::Sines { mean, parts } => parts.iter().fold((*mean, 0.0), |(w, a), &(amp, om, ph)| {
                let (s, c) = (om * t + ph).sin_cos();
                (w + amp * c, a - amp * om * s)
            }),
            Motion::Chirp {
                amplitude,
                f0,
                f1,
                span,
                mean,
            } => {
                let rate = (f1 - f0) / span;
                let (s, c) = (TAU * (f0 * t + 0.5 * rate * t * t)).sin_cos();
                (mean + amplitude * c, -amplitude * TAU * (f0 + rate * t) * s)
            }
            Motion::Stairs { steps, ramp } => {
                let k = steps.partition_point(|s| s.0 <= t);
                if k == 0 {
                    return (0.0, 0.0);
                }
                let from = if k >= 2 { steps[k - 2].1 } else { steps[0].1 };
                let (start, to) = steps[k - 1];
                let x = ((t - start) / ramp).min(1.0);
                let w = from + (to - from) * 0.5 * (1.0 - (PI * x).cos());
                let a = if x < 1.0 {
                    (to - from) * 0.5 * PI / ramp * (PI * x).sin()
                } else {
                    0.0
                };
                (w, a)
            }
        }
    }

    /// Angle on a grid of n points with step dt, by Simpson's rule, starting so that its middle is near zero.
    pub fn angles(&self, dt: f64, n: usize, centred: bool) -> Vec<f64> {
        let mut out = Vec::with_capacity(n);
        let (mut th, mut w0) = (0.0, self.at(0.0).0);
        for k in 0..n {
            out.push(th);
            let t = k as f64 * dt;
            let (wm, w1) = (self.at(t + 0.5 * dt).0, self.at(t + dt).0);
            th += dt / 6.0 * (w0 + 4.0 * wm + w1);
            w0 = w1;
        }
        if centred {
            let (lo, hi) = range(&out);
            let mid = 0.5 * (lo + hi);
            out.iter_mut().for_each(|x| *x -= mid);
        }
        out
    }

    /// A short name.
    pub fn name(&self) -> &'static str {
        match self {
            Motion::Sines { .. } => "multisine",
            Motion::Chirp { .. } => "chirp",
            Motion::Stairs { .. } => "staircase",
        }
    }
}

/// Smallest and largest of a list.
pub fn range(x: &[f64]) -> (f64, f64) {
    x.iter()
        .fold((f64::MAX, f64::MIN), |(lo, hi), &v| (lo.min(v), hi.max(v)))
}

/// Values held over time: (start, value).
#[derive(Clone, Debug)]
pub struct Steps(pub Vec<(f64, f64)>);

impl Steps {
    /// The value that holds at t.
    pub fn at(&self, t: f64) -> f64 {
        let k = self.0.partition_point(|s| s.0 <= t);
        if k == 0 { 0.0 } else { self.0[k - 1].1 }
    }

    /// Random values between lo and hi, held between `hold.0` and `hold.1` seconds.
    pub fn draw(lo: f64, hi: f64, hold: (f64, f64), span: f64, d: &mut Dice) -> Steps {
        let (mut t, mut out) = (0.0, vec![]);
        while t < span {
            out.push((t, d.uni(lo, hi)));
            t += d.uni(hold.0, hold.1);
        }
        Steps(out)
    }
}

/// What drives a run.
#[derive(Clone, Debug)]
pub enum Command {
    /// Ideal servo: the motor follows the motion exactly.
    Ideal(Motion),
    /// Closed loop that follows a motion's angle.
    Track(Motion),
    /// Closed loop with steps of the commanded angle.
    Jumps(Steps),
    /// No position loop: steps of the drive, the motor turns freely in one direction.
    Spin(Steps),
}

impl Command {
    /// A short name.
    pub fn name(&self) -> String {
        match self {
            Command::Ideal(m) => format!("ideal {}", m.name()),
            Command::Track(m) => format!("loop {}", m.name()),
            Command::Jumps(_) => "loop steps".into(),
            Command::Spin(_) => "spin with drive steps".into(),
        }
    }
}
