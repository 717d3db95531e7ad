//! Lives that went before: how long those lasted that were alike (residual similarity).

use super::special::normal_quantile;
use serde::{Deserialize, Serialize};

/// Damage over time since new or since the last repair.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Life {
    /// times since then [units of the clock], ascending
    pub t: Vec<f64>,
    /// damage [share of U], never falling
    pub x: Vec<f64>,
    /// when the threshold was reached, if it was
    pub end: Option<f64>,
}

/// Damage below which age tells more than shape does [share of U] (assumed).
const EARLY: f64 = 0.04;

/// Widths by which lives are alike.
#[derive(Clone, Copy, Debug)]
pub struct Kernel {
    /// of the logarithm of their speed
    speed: f64,
    /// of the scatter of that along the life
    shape: f64,
    /// of the kernel around the logarithm of each life's own time left
    left: f64,
}

impl Kernel {
    /// For fleets whose lives are of many kinds (assumed).
    pub const BROAD: Self = Self {
        speed: 0.6,
        shape: 0.25,
        left: 0.15,
    };
    /// For fleets whose lives are much alike (assumed).
    pub const NARROW: Self = Self {
        speed: 0.15,
        shape: 0.1,
        left: 0.05,
    };
}

/// Shares of the present damage at which shapes are compared.
const LEVELS: [f64; 6] = [0.15, 0.3, 0.45, 0.6, 0.75, 0.9];

impl Life {
    /// One more level; a fall within the noise counts as none.
    pub fn push(&mut self, t: f64, x: f64) {
        let last = self.x.last().copied().unwrap_or(0.0);
        self.t.push(t);
        self.x.push(x.max(last).max(0.0));
    }

    /// Takes back levels above `x` that were believed and were wrong.
    pub fn forget_above(&mut self, x: f64) {
        let keep = self.x.partition_point(|v| *v <= x);
        self.x.truncate(keep);
        self.t.truncate(keep);
    }

    /// The same life by at most `n` points.
    pub fn thinned(&self, n: usize) -> Self {
        let len = self.t.len();
        if len <= n {
            return self.clone();
        }
        let at = |i: usize| i * (len - 1) / (n - 1);
        Self {
            t: (0..n).map(|i| self.t[at(i)]).collect(),
            x: (0..n).map(|i| self.x[at(i)]).collect(),
            end: self.end,
        }
    }

    /// Whether times and levels ascend and are finite.
    pub fn is_sound(&self) -> bool {
        let ascends = |v: &[f64]| v.iter().all(|x| x.is_finite()) && v.windows(2).all(|w| w[0] <= w[1]);
        !self.t.is_empty()
            && self.t.len() == self.x.len()
            && ascends(&self.t)
            && ascends(&self.x)
            && self
                .end
                .is_none_or(|e| e.is_finite() && self.t.last().is_some_and(|t| e >= *t))
    }

    /// When damage first was `x`, by straight lines.
    fn when(&self, x: f64) -> Option<f64> {
        let i = self.x.partition_point(|v| *v < x);
        if i == 0 {
            return self.t.first().copied();
        }
        if i == self.x.len() {
            // between the last test and the end
            let (t0, x0) = (*self.t.last()?, *self.x.last()?);
            return (x < 1.0 && x0 < 1.0).then_some(t0 + (self.end? - t0) * (x - x0) / (1.0 - x0));
        }
        let (x0, x1) = (self.x[i - 1], self.x[i]);
        Some(self.t[i - 1] + (self.t[i] - self.t[i - 1]) * (x - x0) / (x1 - x0))
    }

    /// Damage at a time.
    fn at(&self, t: f64) -> f64 {
        let i = self.t.partition_point(|v| *v < t);
        if i == 0 || i == self.t.len() {
            let end = if i == 0 { self.x.first() } else { self.x.last() };
            return end.copied().unwrap_or(0.0);
        }
        let f = (t - self.t[i - 1]) / (self.t[i] - self.t[i - 1]).max(1e-300);
        self.x[i - 1] + f * (self.x[i] - self.x[i - 1])
    }
}

/// Time left of the finished `lives` that were alike, as `samples` ascending times; none where none can be compared.
pub fn similar<'a>(own: &Life, lives: impl Iterator<Item = &'a Life>, kernel: Kernel, samples: usize) -> Vec<f64> {
    let (Some(&now), Some(&x)) = (own.t.last(), own.x.last()) else {
        return Vec::new();
    };
    // time left and weight
    let mut points: Vec<(f64, f64)> = Vec::new();
    for l in lives {
        let Some(end) = l.end else { continue };
        if x < EARLY {
            if end > now {
                let d = (l.at(now) - x) / (0.5 * EARLY + 0.4 * x);
                points.push((end - now, (-0.5 * d * d).exp() + 1e-6));
            }
            continue;
        }
        let Some(t) = l.when(x) else { continue };
        let floor = 0.02 * now.max(t).max(1e-300);
        let pairs = LEVELS
            .iter()
            .filter_map(|f| Some((now - own.when(f * x)?, t - l.when(f * x)?)));
        // how much faster the other one was, level by level, and by its age
        let ratios: Vec<f64> = pairs
            .chain([(now, t)])
            .map(|(a, b)| ((a + floor) / (b + floor)).ln())
            .collect();
        let n = ratios.len() as f64;
        let mean = ratios.iter().sum::<f64>() / n;
        let scatter = ratios.iter().map(|r| (r - mean).powi(2)).sum::<f64>() / n;
        let weight = (-0.5 * ((mean / kernel.speed).powi(2) + scatter / (kernel.shape * kernel.shape))).exp() + 1e-9;
        points.push(((end - t).max(1e-3 * end) * mean.exp(), weight));
    }
    points.sort_by(|a, b| a.0.total_cmp(&b.0));
    let total: f64 = points.iter().map(|p| p.1).sum();
    let Some(first) = points.first() else { return Vec::new() };
    let (mut i, mut cumulated) = (0, first.1 / total);
    let mut out = Vec::with_capacity(samples);
    for k in 0..samples {
        let u = (k as f64 + 0.5) / samples as f64;
        while u > cumulated && i + 1 < points.len() {
            i += 1;
            cumulated += points[i].1 / total;
        }
        // golden steps through the kernel
        let z = normal_quantile((k as f64 * 0.618_033_988_749_895).fract().clamp(0.001, 0.999));
        out.push(points[i].0 * (kernel.left * z).exp());
    }
    out.sort_by(f64::total_cmp);
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_life_like_earlier_ones_has_their_time_left() {
        let straight = |speed: f64, until: f64| {
            let mut l = Life::default();
            let n = (until / speed) as usize;
            (0..=n).for_each(|i| l.push(i as f64, speed * i as f64));
            l
        };
        let lives: Vec<Life> = [0.008, 0.01, 0.012]
            .map(|s| Life {
                end: Some(1.0 / s),
                ..straight(s, 0.99)
            })
            .into();
        let left = similar(&straight(0.01, 0.5), lives.iter(), Kernel::BROAD, 101);
        assert!((left[50] - 50.0).abs() < 5.0, "{}", left[50]);
        assert!(similar(&straight(0.01, 0.5), [].iter(), Kernel::NARROW, 10).is_empty());
        assert!(lives[0].is_sound() && lives[0].thinned(10).is_sound() && lives[0].thinned(10).t.len() == 10);
    }
}
