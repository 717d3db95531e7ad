//! Commands at the user shaft: the built-in sequences, and drawn excitations.

use std::f64::consts::TAU;

use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use super::plant::DT;

/// Steps between two exact evaluations of a drawn sine; between them it is rotated step by step.
const ANCHOR: u64 = 1000;
/// Time over which drawn sines fade in [s].
const FADE: f64 = 0.8;
/// Gear ratio that the drawn excitations assume when they keep the motor's speed in its range.
const GEAR: f64 = 500.0;

/// One sine of a drawn excitation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sine {
    /// Amplitude at the user shaft [rad].
    pub amplitude: f64,
    /// Frequency [Hz].
    pub frequency: f64,
    /// Phase at t = 0 [rad].
    pub phase: f64,
}

/// One tread of a drawn staircase of speeds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Segment {
    /// Length, in steps of [`DT`].
    pub steps: u64,
    /// Speed at the user shaft [rad/s].
    pub speed: f64,
}

/// A command over time.
#[derive(Clone, Debug, PartialEq)]
pub enum Command {
    /// Pre-flight test of 3 s: ramp, rest, sine, rest, step.
    Preflight,
    /// Pre-flight test of 3 s with turning points of a slow cosine and a leg at low speed.
    Preflight2,
    /// 0.001 rad/s from rest.
    Ramp,
    /// 0.001 rad at 5 Hz.
    Sine,
    /// 1 rad.
    Step,
    /// Swept sine.
    Chirp {
        /// Amplitude [rad].
        amplitude: f64,
        /// First frequency [Hz].
        f0: f64,
        /// Frequency at `duration` [Hz].
        f1: f64,
        /// Length of the sweep [s].
        duration: f64,
    },
    /// Sum over n = 1..5 of `amplitude / n sin(2 pi n f t + n^2)`.
    Multisine {
        /// Amplitude of the first sine [rad].
        amplitude: f64,
        /// Frequency of the first sine [Hz].
        frequency: f64,
    },
    /// Drawn excitation: sines that fade in, plus a staircase of constant speeds and rests.
    Drawn {
        /// The sines.
        sines: Vec<Sine>,
        /// The staircase; the last level is held.
        segments: Vec<Segment>,
    },
}

impl Command {
    /// A sum of 3 to 5 sines between 0.1 and 2 Hz, whose speeds add up to 140 to 290 rad/s at the motor.
    pub fn drawn_sines(rng: &mut ChaCha8Rng) -> Command {
        let peak = rng.random_range(140.0..290.0);
        Command::Drawn {
            sines: sines(rng, peak),
            segments: Vec::new(),
        }
    }

    /// A staircase of speeds, 2 to 300 rad/s at the motor in both directions, with rests between.
    pub fn drawn_staircase(rng: &mut ChaCha8Rng, seconds: f64) -> Command {
        Command::Drawn {
            sines: Vec::new(),
            segments: staircase(rng, seconds, 300.0),
        }
    }

    /// A staircase with sines on top, together within 300 rad/s at the motor.
    pub fn drawn_mixture(rng: &mut ChaCha8Rng, seconds: f64) -> Command {
        let peak = rng.random_range(30.0..90.0);
        Command::Drawn {
            sines: sines(rng, peak),
            segments: staircase(rng, seconds, 200.0),
        }
    }

    /// The command step by step from step 0.
    pub fn steps(&self) -> Steps<'_> {
        let turning = match self {
            Command::Drawn { sines, .. } => sines.iter().map(|s| Turning::new(*s)).collect(),
            _ => Vec::new(),
        };
        Steps {
            command: self,
            k: 0,
            turning,
            fade: 0.0,
            segment: 0,
            into: 0,
            level: 0.0,
        }
    }
}

/// Sines with a given sum of speed amplitudes at the motor, within the stroke.
fn sines(rng: &mut ChaCha8Rng, peak: f64) -> Vec<Sine> {
    let count = rng.random_range(3..=5usize);
    // One frequency from each equal part of the logarithmic range keeps them apart.
    let width = (2.0f64 / 0.1).ln() / count as f64;
    let mut sines: Vec<Sine> = (0..count)
        .map(|n| {
            let frequency = 0.1 * ((n as f64 + rng.random_range(0.1..0.9)) * width).exp();
            let share: f64 = rng.random_range(0.3..1.0);
            Sine {
                amplitude: share,
                frequency,
                phase: rng.random_range(0.0..TAU),
            }
        })
        .collect();
    let total: f64 = sines.iter().map(|s| s.amplitude).sum();
    for s in &mut sines {
        s.amplitude *= peak / (total * GEAR * TAU * s.frequency);
    }
    let reach: f64 = sines.iter().map(|s| s.amplitude).sum();
    if reach > 0.9 {
        sines.iter_mut().for_each(|s| s.amplitude *= 0.9 / reach);
    }
    sines
}

/// Treads of constant speed; the position stays within 0.75 rad.
fn staircase(rng: &mut ChaCha8Rng, seconds: f64, fastest: f64) -> Vec<Segment> {
    let mut segments = Vec::new();
    let first = if rng.random::<bool>() { 1.0 } else { -1.0 };
    let (mut time, mut position, mut direction) = (0.0, 0.0f64, first);
    while time < seconds {
        // The second and the fourth tread are fast and opposite, so that every staircase shows high speeds both ways.
        let fast = matches!(segments.len(), 1 | 3);
        let rest = !fast && rng.random_bool(0.15);
        let duration: f64 = if rest {
            rng.random_range(0.1..0.3)
        } else {
            rng.random_range(0.25..0.8)
        };
        let slowest: f64 = if fast { 0.6 * fastest } else { 2.0 };
        let magnitude = rng.random_range(slowest.ln()..fastest.ln()).exp() / GEAR;
        direction = match segments.len() {
            1 => first,
            3 => -first,
            _ if rng.random_bool(0.6) => -direction,
            _ => direction,
        };
        if (position + direction * magnitude * duration).abs() > 0.75 {
            direction = -position.signum();
        }
        let speed = if rest { 0.0 } else { direction * magnitude };
        let steps = (duration / DT).round() as u64;
        segments.push(Segment { steps, speed });
        position += speed * steps as f64 * DT;
        time += duration;
    }
    segments
}

/// A sine that is turned step by step.
#[derive(Clone, Debug)]
struct Turning {
    sine: Sine,
    sin: f64,
    cos: f64,
    step_sin: f64,
    step_cos: f64,
}

impl Turning {
    fn new(sine: Sine) -> Turning {
        let (step_sin, step_cos) = (TAU * sine.frequency * DT).sin_cos();
        Turning {
            sine,
            sin: 0.0,
            cos: 1.0,
            step_sin,
            step_cos,
        }
    }

    fn anchor(&mut self, t: f64) {
        (self.sin, self.cos) = (TAU * self.sine.frequency * t + self.sine.phase).sin_cos();
    }

    #[inline]
    fn turn(&mut self) {
        let sin = self.sin * self.step_cos + self.cos * self.step_sin;
        self.cos = self.cos * self.step_cos - self.sin * self.step_sin;
        self.sin = sin;
    }
}

/// Successive values of a [`Command`], one a step.
#[derive(Clone, Debug)]
pub struct Steps<'a> {
    command: &'a Command,
    k: u64,
    turning: Vec<Turning>,
    fade: f64,
    segment: usize,
    into: u64,
    level: f64,
}

impl Steps<'_> {
    /// The command of the next step.
    #[inline]
    pub fn next_value(&mut self) -> f64 {
        let k = self.k;
        let t = k as f64 * DT;
        let command = self.command;
        let value = match command {
            Command::Preflight => preflight(k),
            Command::Preflight2 => preflight2(k),
            Command::Ramp => 0.001 * t,
            Command::Sine => 0.001 * (TAU * 5.0 * t).sin(),
            Command::Step => 1.0,
            Command::Chirp {
                amplitude,
                f0,
                f1,
                duration,
            } => amplitude * (TAU * (f0 * t + (f1 - f0) * t * t / (2.0 * duration))).sin(),
            Command::Multisine { amplitude, frequency } => (1..=5)
                .map(f64::from)
                .map(|n| amplitude / n * (TAU * frequency * n * t + n * n).sin())
                .sum(),
            Command::Drawn { segments, .. } => self.drawn(k, t, segments),
        };
        self.k += 1;
        value
    }

    #[inline]
    fn drawn(&mut self, k: u64, t: f64, segments: &[Segment]) -> f64 {
        let mut value = self.level;
        if let Some(segment) = segments.get(self.segment) {
            value += segment.speed * self.into as f64 * DT;
            self.into += 1;
            if self.into == segment.steps {
                self.level += segment.speed * segment.steps as f64 * DT;
                (self.segment, self.into) = (self.segment + 1, 0);
            }
        }
        if self.turning.is_empty() {
            return value;
        }
        if self.fade < 1.0 {
            let x = (t / FADE).min(1.0);
            self.fade = x * x * (3.0 - 2.0 * x);
        }
        let anchor = k.is_multiple_of(ANCHOR);
        let mut sum = 0.0;
        for turning in &mut self.turning {
            if anchor {
                turning.anchor(t);
            } else {
                turning.turn();
            }
            sum += turning.sine.amplitude * turning.sin;
        }
        value + self.fade * sum
    }
}

/// The pre-flight test; a segment owns its first step.
/// Ramp, slow cosine, sine, a leg there and back, rest, step.
fn preflight2(k: u64) -> f64 {
    let t = k as f64 * DT;
    match k {
        0..100_000 => 0.001 * t,
        100_000..850_000 => 1e-4 * (TAU * 5.0 * (t - 0.1)).cos(),
        850_000..1_850_000 => 0.001 * (TAU * 5.0 * (t - 0.85)).sin(),
        1_850_000..2_000_000 => 0.2 * (t - 1.85),
        2_000_000..2_150_000 => 0.2 * (2.15 - t),
        2_150_000..2_200_000 => 0.0,
        _ => 1.0,
    }
}

fn preflight(k: u64) -> f64 {
    let t = k as f64 * DT;
    match k {
        0..500_000 => 0.001 * t,
        850_000..1_850_000 => 0.001 * (TAU * 5.0 * (t - 0.85)).sin(),
        2_200_000.. => 1.0,
        _ => 0.0,
    }
}
