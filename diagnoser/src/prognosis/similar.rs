//! Lives that went before: how long those lasted that were alike (residual similarity).

use super::special::{evenly, normal_quantile};
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

/// How one of the finished lives compares with a unit's.
#[derive(Clone, Copy, Debug)]
pub struct Likeness {
    /// time that was left of it, at the unit's pace
    left: f64,
    /// what they are told apart by
    by: By,
}

#[derive(Clone, Copy, Debug)]
enum By {
    /// damage at the same age [widths]
    Level(f64),
    /// logarithm of its speed over the unit's, mean and variance along the life
    Speed(f64, f64),
}

impl Likeness {
    /// Of all finished `lives` with the unit's.
    pub fn of<'a>(own: &Life, lives: impl Iterator<Item = &'a Life>) -> Vec<Self> {
        let (Some(&now), Some(&x)) = (own.t.last(), own.x.last()) else {
            return Vec::new();
        };
        let compared = |l: &Life| {
            let end = l.end?;
            if x < EARLY {
                let by = By::Level((l.at(now) - x) / (0.5 * EARLY + 0.4 * x));
                return (end > now).then_some(Self { left: end - now, by });
            }
            let t = l.when(x)?;
            let floor = 0.02 * now.max(t).max(1e-300);
            let pairs = LEVELS
                .iter()
                .filter_map(|f| Some((now - own.when(f * x)?, t - l.when(f * x)?)));
            // level by level, and by the age
            let ratios: Vec<f64> = pairs
                .chain([(now, t)])
                .map(|(a, b)| ((a + floor) / (b + floor)).ln())
                .collect();
            let n = ratios.len() as f64;
            let mean = ratios.iter().sum::<f64>() / n;
            let scatter = ratios.iter().map(|r| (r - mean).powi(2)).sum::<f64>() / n;
            let left = (end - t).max(1e-3 * end) * mean.exp();
            let by = By::Speed(mean, scatter);
            Some(Self { left, by })
        };
        lives.filter_map(compared).collect()
    }

    fn weight(&self, kernel: Kernel) -> f64 {
        match self.by {
            By::Level(d) => (-0.5 * d * d).exp() + 1e-6,
            By::Speed(mean, scatter) => {
                (-0.5 * ((mean / kernel.speed).powi(2) + scatter / (kernel.shape * kernel.shape))).exp() + 1e-9
            }
        }
    }
}

/// Time left of the lives that were alike, as `samples` ascending times; none where none could be compared.
pub fn similar(lives: &[Likeness], kernel: Kernel, samples: usize) -> Vec<f64> {
    let mut points: Vec<(f64, f64)> = lives.iter().map(|l| (l.left, l.weight(kernel))).collect();
    points.sort_by(|a, b| a.0.total_cmp(&b.0));
    let total: f64 = points.iter().map(|p| p.1).sum();
    let chosen = evenly(points.iter().map(|p| p.1 / total), samples);
    // golden steps through the kernel
    let z = |k: usize| normal_quantile((k as f64 * 0.618_033_988_749_895).fract().clamp(0.001, 0.999));
    let mut out: Vec<f64> = chosen
        .iter()
        .enumerate()
        .map(|(k, i)| points[*i].0 * (kernel.left * z(k)).exp())
        .collect();
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
        let own = straight(0.01, 0.5);
        let left = similar(&Likeness::of(&own, lives.iter()), Kernel::BROAD, 101);
        assert!((left[50] - 50.0).abs() < 5.0, "{}", left[50]);
        assert!(similar(&Likeness::of(&own, [].iter()), Kernel::NARROW, 10).is_empty());
        assert!(lives[0].is_sound() && lives[0].thinned(10).is_sound() && lives[0].thinned(10).t.len() == 10);
    }
}
