//! What one run gives to the comparison of states: its steady stretches and their features.

use crate::measured::bench::{BenchChannel, Role};
use crate::measured::recording::Run;
use nalgebra::{DMatrix, DVector};
use std::f64::consts::TAU;
use std::ops::Range;

/// Shares of the greatest speed: steady motion above, standstill below (assumed, as all that follow).
const STEADY: f64 = 0.8;
const STANDING: f64 = 0.05;
const SHORTEST_S: f64 = 0.4;
/// Shares of a steady stretch: where it has settled, and where it starts; of a standstill: where the stop shows.
pub(super) const SETTLED: (f64, f64) = (0.4, 0.95);
const START: (f64, f64) = (0.0, 0.2);
const STOP: (f64, f64) = (0.1, 0.5);
/// Labels of repeats, which are averaged, and of runs; all others are conditions.
const REPEAT: &str = "rep";
const RUN: &str = "run";
pub(super) const FEATURES: [&str; 9] = [
    "mean current",
    "greatest current at the start over the mean",
    "greatest current after the stop",
    "current without mean, slope and ripple, rms",
    "current ripple once a turn",
    "current ripple twice a turn",
    "mean current at standstill",
    "greatest position error at the start",
    "greatest position error after the stop",
];
pub(super) const MEAN: usize = 0;
pub(super) const STANDSTILL: usize = 6;
pub(super) type Values = [f64; FEATURES.len()];

/// One run, as far as the comparison needs it; angles at the motor [rad].
pub(super) struct Record<'a> {
    pub(super) condition: String,
    /// what counts as one
    pub(super) unit: String,
    pub(super) healthy: bool,
    pub(super) rate_hz: f64,
    pub(super) current: &'a [f64],
    pub(super) command: Option<&'a [f64]>,
    pub(super) position: Option<&'a [f64]>,
}

pub(super) fn record(run: &Run) -> Option<Record<'_>> {
    let pick = |wanted: &dyn Fn(&str) -> bool| {
        let some = run
            .labels
            .iter()
            .filter(|(k, _)| wanted(k))
            .map(|(k, v)| format!("{k} {v}"));
        some.collect::<Vec<_>>().join(", ")
    };
    let unit = pick(&|k| k == RUN);
    Some(Record {
        condition: pick(&|k| k != RUN && k != REPEAT),
        unit: if unit.is_empty() {
            run.name.clone()
        } else {
            format!("{unit} {}", run.hash)
        },
        healthy: run.role == Role::Baseline,
        rate_hz: run.rate_hz,
        current: run.channel(BenchChannel::CurrentAbs)?,
        command: run.channel(BenchChannel::Command),
        position: run.channel(BenchChannel::Position),
    })
}

/// Steady motion, and the standstill after it.
pub(super) struct Stretch {
    pub(super) positive: bool,
    pub(super) all: Range<usize>,
    pub(super) stop: Range<usize>,
    /// [rad/s]
    pub(super) speed: f64,
}

pub(super) fn part(at: &Range<usize>, (from, to): (f64, f64)) -> Range<usize> {
    let place = |share: f64| at.start + (share * at.len() as f64).round() as usize;
    place(from)..place(to)
}

pub(super) fn stretches(r: &Record) -> Vec<Stretch> {
    // the command has no noise
    let Some(x) = r.command.or(r.position) else {
        return Vec::new();
    };
    let half_s = if r.command.is_some() { 0.04 } else { 0.2 };
    let half = ((half_s * r.rate_hz).round() as usize).max(1);
    let speed = |k: usize| {
        let (a, b) = (k.saturating_sub(half), (k + half).min(x.len() - 1));
        (x[b] - x[a]) * r.rate_hz / (b - a).max(1) as f64
    };
    let speeds: Vec<f64> = (0..x.len()).map(speed).collect();
    // the greatest, but for overshoot: the median of the faster half
    let peak = largest(&speeds);
    let mut fast: Vec<f64> = speeds.iter().map(|v| v.abs()).filter(|v| *v > 0.5 * peak).collect();
    fast.sort_by(f64::total_cmp);
    let Some(&greatest) = fast.get(fast.len() / 2) else {
        return Vec::new();
    };
    let class = |k: &usize| match speeds[*k].abs() / greatest {
        s if s >= STEADY => speeds[*k].signum(),
        s if s < STANDING => 0.0,
        _ => 2.0,
    };
    let mut out: Vec<Stretch> = Vec::new();
    for all in (0..x.len()).collect::<Vec<_>>().chunk_by(|a, b| class(a) == class(b)) {
        let (what, middle, all) = (class(&all[0]), all[all.len() / 2], all[0]..all[0] + all.len());
        if (all.len() as f64) < SHORTEST_S * r.rate_hz || what == 2.0 {
            continue;
        }
        if what != 0.0 {
            let (positive, speed) = (what > 0.0, speeds[middle].abs());
            out.push(Stretch {
                positive,
                all,
                stop: 0..0,
                speed,
            });
        } else if let Some(last) = out.last_mut().filter(|s| s.stop.is_empty()) {
            last.stop = all;
        }
    }
    out
}

pub(super) fn mean(x: impl Iterator<Item = f64>) -> f64 {
    let (n, sum) = x.filter(|x| !x.is_nan()).fold((0, 0.0), |(n, s), x| (n + 1, s + x));
    if n == 0 { f64::NAN } else { sum / n as f64 }
}

/// Standard deviation and count.
pub(super) fn scatter(x: impl Iterator<Item = f64> + Clone) -> (f64, f64) {
    let m = mean(x.clone());
    let n = x.clone().filter(|x| !x.is_nan()).count() as f64;
    ((mean(x.map(|x| (x - m).powi(2))) * n / (n - 1.0)).sqrt(), n)
}

pub(super) fn rms(x: &[f64]) -> f64 {
    mean(x.iter().map(|x| x * x)).sqrt()
}

pub(super) fn largest(d: &[f64]) -> f64 {
    d.iter().fold(0.0, |m, d| m.max(d.abs()))
}

/// Greatest mean of three samples.
fn greatest(x: &[f64]) -> f64 {
    x.windows(3)
        .map(|w| (w[0] + w[1] + w[2]) / 3.0)
        .fold(f64::NAN, f64::max)
}

/// Difference of two means and its 95 % interval: Welch's, with the fewer degrees of freedom.
pub(super) fn difference(
    a: impl Iterator<Item = f64> + Clone,
    b: impl Iterator<Item = f64> + Clone,
) -> (f64, f64, f64) {
    let value = mean(b.clone()) - mean(a.clone());
    let ((sa, na), (sb, nb)) = (scatter(a), scatter(b));
    let (sb, few) = if nb > 1.0 { (sb, na.min(nb)) } else { (sa, na) };
    let f = few - 1.0;
    // Student's t
    let t = 1.96 + 2.37 / f + 2.82 / (f * f) + 3.0 / f.powi(3);
    let half = t * (sa * sa / na + sb * sb / nb).sqrt();
    (value, value - half, value + half)
}

/// Rms left of the current, and its ripple at orders 1 and 2 of the turn where the clock is fast enough.
fn ripple(current: &[f64], angle: &[f64], speed: f64, rate_hz: f64) -> [f64; 3] {
    let orders = [1.0, 2.0].iter().filter(|o| *o * speed / TAU < 0.45 * rate_hz).count();
    let a = DMatrix::from_fn(current.len(), 2 + 2 * orders, |i, j| {
        match (j, (j / 2) as f64 * angle[i]) {
            (0, _) => 1.0,
            (1, _) => angle[i] - angle[0],
            (j, x) => {
                if j % 2 == 0 {
                    x.cos()
                } else {
                    x.sin()
                }
            }
        }
    });
    let b = DVector::from_column_slice(current);
    if a.nrows() < 3 * a.ncols() {
        return [f64::NAN; 3];
    }
    let Ok(q) = a.clone().svd(true, true).solve(&b, 1e-9) else {
        return [f64::NAN; 3];
    };
    let amplitude = |k: usize| {
        if k <= orders {
            q[2 * k].hypot(q[2 * k + 1])
        } else {
            f64::NAN
        }
    };
    [rms((b - a * &q).as_slice()), amplitude(1), amplitude(2)]
}

/// NaN for what cannot be had.
pub(super) fn features(r: &Record, s: &Stretch) -> Values {
    let (settled, start, stop) = (part(&s.all, SETTLED), part(&s.all, START), part(&s.stop, STOP));
    let angle = r.position.or(r.command).expect("there is a stretch");
    let current = &r.current[settled.clone()];
    let [left, first, second] = ripple(current, &angle[settled], s.speed, r.rate_hz);
    let error = |at: Range<usize>| {
        let (c, p) = r.command.zip(r.position).unwrap_or_default();
        let e: Vec<f64> = at.filter(|&k| k < p.len()).map(|k| c[k] - p[k]).collect();
        let below: Vec<f64> = e.iter().map(|e| -e).collect();
        greatest(&e).max(greatest(&below))
    };
    let level = mean(current.iter().copied());
    [
        level,
        greatest(&r.current[start.clone()]) - level,
        greatest(&r.current[stop.clone()]),
        left,
        first,
        second,
        mean(r.current[part(&s.stop, (STOP.1, 1.0))].iter().copied()),
        error(start),
        error(stop),
    ]
}
