//! Commands and loads of the three runs, as tables at the controller's rate, at the motor side.

use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use std::f64::consts::{PI, TAU};

/// Rate of controller and command, 1/s.
pub const RATE: f64 = 1e4;

/// One run's command (motor angle, rad) and load torque (N m at the motor, positive against positive motion).
pub struct Command {
    pub com: Vec<f64>,
    pub load: Vec<f64>,
}

fn span(rng: &mut ChaCha8Rng, lo: f64, hi: f64) -> f64 {
    lo + (hi - lo) * rng.random::<f64>()
}

/// Angle from a table of speeds.
fn integrate(speed: &[f64]) -> Vec<f64> {
    let mut q = 0.0;
    speed
        .iter()
        .map(|w| {
            q += w / RATE;
            q
        })
        .collect()
}

/// Appends a speed trapezoid: up to `w` at 6000 rad/s2, back to 0, over `seconds`.
fn plateau(out: &mut Vec<f64>, w: f64, seconds: f64) {
    let n = (seconds * RATE) as usize;
    let ramp = (w.abs() / 6000.0).clamp(1.0 / RATE, seconds / 2.0);
    for k in 0..n {
        let t = k as f64 / RATE;
        out.push(w * (t.min(seconds - t) / ramp).clamp(0.0, 1.0));
    }
}

/// Appends a chirp in speed, f0 to f1 Hz (logarithmic), amplitude w0 to w1, eased in and out over 0.1 s.
fn chirp(out: &mut Vec<f64>, (f0, f1): (f64, f64), (w0, w1): (f64, f64), seconds: f64) {
    let n = (seconds * RATE) as usize;
    let mut phase = 0.0;
    for k in 0..n {
        let x = k as f64 / n as f64;
        phase += TAU * f0 * (f1 / f0).powf(x) / RATE;
        let ease = (x.min(1.0 - x) * seconds / 0.1).min(1.0);
        out.push(ease * (w0 + (w1 - w0) * x) * phase.cos());
    }
}

/// Appends a sum of sines in speed, eased in and out over 0.25 s, largest speed `peak`.
fn multisine(out: &mut Vec<f64>, freqs: &[f64], peak: f64, seconds: f64, rng: &mut ChaCha8Rng) {
    let n = (seconds * RATE) as usize;
    let phases: Vec<f64> = freqs.iter().map(|_| span(rng, 0.0, TAU)).collect();
    let mut w: Vec<f64> = (0..n)
        .map(|k| {
            let t = k as f64 / RATE;
            let ease = (t.min(seconds - t) / 0.25).min(1.0);
            ease * freqs
                .iter()
                .zip(&phases)
                .map(|(f, p)| f.powf(-0.4) * (TAU * f * t + p).sin())
                .sum::<f64>()
        })
        .collect();
    // the same way in both directions, so that no line drives the stroke away
    let mean = w.iter().sum::<f64>() / n as f64;
    let weight = |k: usize| (PI * k as f64 / n as f64).sin() * PI / 2.0;
    w.iter_mut().enumerate().for_each(|(k, x)| *x -= mean * weight(k));
    let top = w.iter().fold(1e-9f64, |m, x| m.max(x.abs()));
    w.iter_mut().for_each(|x| *x *= peak / top);
    out.extend(w);
}

/// Load steps: 0.25 to 0.8 s each, a quarter of them zero, else 0.01 to 0.04 N m of either sign.
fn loads(n: usize, rng: &mut ChaCha8Rng) -> Vec<f64> {
    let mut out = Vec::with_capacity(n);
    while out.len() < n {
        let held = (span(rng, 0.25, 0.8) * RATE) as usize;
        let sign = if rng.random::<f64>() < 0.5 { -1.0 } else { 1.0 };
        let value = if rng.random::<f64>() < 0.25 {
            0.0
        } else {
            sign * span(rng, 0.01, 0.04)
        };
        out.extend(std::iter::repeat_n(value, held.min(n - out.len())));
    }
    out
}

/// First fit run, 8 s: staircase of five speeds in both directions with dwells, chirp, steps of three levels; no load.
pub fn staircase(rng: &mut ChaCha8Rng) -> Command {
    let mut w = Vec::new();
    for base in [20.0, 50.0, 120.0, 260.0, 480.0] {
        let v = base * span(rng, 0.9, 1.1);
        for sign in [1.0, -1.0] {
            plateau(&mut w, sign * v, 0.3);
            plateau(&mut w, 0.0, 0.06);
        }
    }
    let top = span(rng, 5.0, 7.0);
    chirp(
        &mut w,
        (0.6, top),
        (span(rng, 150.0, 200.0), span(rng, 50.0, 80.0)),
        2.4,
    );
    for (level, seconds) in [(10.0, 0.14), (40.0, 0.2), (80.0, 0.34)] {
        let level = level * span(rng, 0.9, 1.1);
        for sign in [1.0, -1.0] {
            let n = (seconds * RATE) as usize;
            w.extend((0..n).map(|k| sign * level / seconds * (1.0 - (TAU * k as f64 / n as f64).cos())));
            plateau(&mut w, 0.0, 0.1);
        }
    }
    w.resize((8.0 * RATE) as usize, 0.0);
    Command {
        load: vec![0.0; w.len()],
        com: integrate(&w),
    }
}

/// Second fit run, 8 s: sum of six sines with load steps.
pub fn sines(rng: &mut ChaCha8Rng) -> Command {
    let freqs: Vec<f64> = [0.3, 0.55, 1.0, 1.7, 2.7, 4.2]
        .iter()
        .map(|f| f * span(rng, 0.85, 1.15))
        .collect();
    let mut w = Vec::new();
    let peak = span(rng, 400.0, 520.0);
    multisine(&mut w, &freqs, peak, 8.0, rng);
    Command {
        load: loads(w.len(), rng),
        com: integrate(&w),
    }
}

/// Held-out run, 7 s: other sines, then a falling chirp, with other load steps.
pub fn heldout(rng: &mut ChaCha8Rng) -> Command {
    let freqs: Vec<f64> = [0.4, 0.8, 1.35, 2.2, 3.4]
        .iter()
        .map(|f| f * span(rng, 0.85, 1.15))
        .collect();
    let mut w = Vec::new();
    let peak = span(rng, 400.0, 520.0);
    multisine(&mut w, &freqs, peak, 3.6, rng);
    let top = span(rng, 4.0, 6.0);
    chirp(
        &mut w,
        (top, 0.5),
        (span(rng, 60.0, 90.0), span(rng, 180.0, 300.0)),
        3.4,
    );
    Command {
        load: loads(w.len(), rng),
        com: integrate(&w),
    }
}
