//! From the filter's state to the distribution of the time left: samples run forward.

use super::filter::{Component, Filter};
use super::law::Family;
use super::prior::{Prior, Wear};
use super::special::{evenly, normal_quantile};

/// A small generator with a seed: SplitMix64 (Steele, Lea and Flood 2014).
#[derive(Clone, Debug)]
pub(super) struct Random(u64);

impl Random {
    pub fn new(seed: u64) -> Self {
        Self(seed)
    }

    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    /// Uniform within 0 and 1, neither included.
    fn uniform(&mut self) -> f64 {
        ((self.next() >> 12) as f64 + 0.5) / (1u64 << 52) as f64
    }

    fn normal(&mut self) -> f64 {
        normal_quantile(self.uniform())
    }

    /// Gamma variable of unit scale (Marsaglia and Tsang 2000; normal above a shape of 30).
    fn gamma(&mut self, shape: f64) -> f64 {
        if shape > 30.0 {
            return (shape + shape.sqrt() * self.normal()).max(0.0);
        }
        if shape < 1.0 {
            let u = self.uniform();
            return self.gamma(shape + 1.0) * u.powf(1.0 / shape.max(1e-3));
        }
        let d = shape - 1.0 / 3.0;
        let c = 1.0 / (9.0 * d).sqrt();
        loop {
            let z = self.normal();
            let v = (1.0 + c * z).powi(3);
            if v > 0.0 && self.uniform().ln() < 0.5 * z * z + d - d * v + d * v.ln() {
                return d * v;
            }
        }
    }

    fn exponential(&mut self) -> f64 {
        -self.uniform().ln()
    }
}

/// Share of the life left that one piece of a forecast takes at most; pieces at most; share of the life from new that is
/// gone in one go at the end.
const PIECE: f64 = 0.07;
const PIECES: usize = 600;
const LAST: f64 = 0.004;

/// Growth of the logarithm of the rate that a change of regime brings at least.
const FASTER: f64 = 0.3;

/// Changes of regime in a usual life: by family of laws, in proportion to the damage that is still to come, and under wear by
/// jumps whatever the law. Laws that speed up leave less to be explained by changes.
#[derive(Clone, Copy, Debug)]
pub struct Changes {
    by_law: [f64; Family::ALL.len()],
    jumps: f64,
}

impl Changes {
    /// Where no fleet is known (assumed).
    pub const UNKNOWN: Self = Self {
        by_law: [1.0, 4.0, 0.7, 0.7, 1.0],
        jumps: 2.5,
    };

    /// The same whatever the law.
    pub const fn even(n: f64) -> Self {
        Self {
            by_law: [n; Family::ALL.len()],
            jumps: n,
        }
    }

    fn of(&self, law: Family, wear: Wear, x: f64) -> f64 {
        match wear {
            Wear::Jumps(_) => self.jumps,
            _ => self.by_law[law as usize] * (1.0 - x).clamp(0.05, 1.0),
        }
    }
}

/// What a forecast looks at.
#[derive(Clone, Copy, Debug)]
pub struct Horizon {
    /// how many samples
    pub samples: usize,
    /// how far ahead [units of the clock]
    pub most: f64,
    /// standard deviation of the unit's own error of the threshold [share of U]
    pub common: f64,
    /// changes of regime that are reckoned with
    pub ahead: Changes,
    /// seed of the samples
    pub seed: u64,
}

/// Times until the threshold [units of the clock], ascending; infinite where it is not reached within the horizon.
pub fn forecast(filter: &Filter, h: &Horizon) -> Vec<f64> {
    let mut random = Random::new(h.seed);
    let parts = &filter.components;
    let chosen = evenly(parts.iter().map(|c| c.weight), h.samples).into_iter();
    let mut out: Vec<f64> = chosen
        .map(|i| {
            let threshold = 1.0 + h.common * random.normal();
            run(&parts[i], filter, threshold, h, &mut random)
        })
        .collect();
    out.sort_by(f64::total_cmp);
    out
}

fn run(c: &Component, filter: &Filter, threshold: f64, h: &Horizon, random: &mut Random) -> f64 {
    let prior: &Prior = filter.prior();
    let law = filter.laws().of(c.model);
    let (mean, sd) = prior.rho(c.model);
    let usual = mean.exp();
    let sx = c.pxx.max(0.0).sqrt();
    let (z1, z2) = (random.normal(), random.normal());
    let along = if sx > 0.0 { c.pxr / sx } else { 0.0 };
    let mut x = c.x + sx * z1;
    let mut rho = c.rho + along * z1 + (c.prr - along * along).max(0.0).sqrt() * z2;
    // of jumps, how many come is known apart from how large they are
    let size = match c.model.wear() {
        Wear::Jumps(of) => {
            let (a, b) = of.scale(c.jumps, c.jumped);
            let size = f64::from(of.shape) * b / random.gamma(a);
            rho += (size / of.mean(c.jumps, c.jumped)).ln();
            size
        }
        _ => 0.0,
    };
    let mut t = 0.0;
    let end = law.spent(threshold);
    let first = if c.born == 0 { 1.0 } else { prior.later };
    let ahead = h.ahead.of(law.family(), c.model.wear(), c.x);
    // usual lives until the regime changes
    let mut regime = random.exponential() / (first * ahead).max(1e-9);
    for _ in 0..PIECES {
        if x >= threshold {
            return t;
        }
        if t >= h.most {
            return f64::INFINITY;
        }
        let rate = rho.clamp(-60.0, 30.0).exp();
        // the same in lives at this rate
        let quiet = regime * (rate / rate.max(usual)) + 1e-6;
        let s = match c.model.wear() {
            Wear::Jumps(of) => {
                // until the next jump, or a piece of the way
                let wait = random.exponential() * size / law.rate(x);
                let piece = wait.min(0.1).min(quiet);
                if wait <= piece {
                    x += size * random.gamma(f64::from(of.shape)) / f64::from(of.shape);
                }
                piece
            }
            wear => {
                let left = (end - law.spent(x)).max(0.0);
                if left < LAST && left < quiet {
                    return t + left / rate;
                }
                let s = (PIECE * left).max(0.5 * LAST).min(quiet);
                let grown = law.grow(x, s).0 - x;
                let shape = match wear {
                    Wear::Gamma(cv) => s / rate / (prior.interval * cv * cv),
                    Wear::Smooth(kappa) => grown / kappa,
                    Wear::Jumps(_) => 0.0,
                };
                x += if shape > 1e-9 {
                    grown * random.gamma(shape) / shape
                } else {
                    0.0
                };
                s
            }
        };
        t += s / rate;
        rho += c.model.volatility() * s.sqrt() * random.normal();
        regime -= s * (rate.max(usual) / rate);
        if regime <= 0.0 {
            rho = (mean + sd * random.normal()).max(rho + FASTER);
            regime = random.exponential() / (prior.later * ahead).max(1e-9);
        }
    }
    if x >= threshold { t } else { f64::INFINITY }
}

/// The quantile `p` of ascending times; infinite where there are none.
pub fn quantile(times: &[f64], p: f64) -> f64 {
    let n = times.len();
    if n == 0 {
        return f64::INFINITY;
    }
    let at = (p * n as f64 - 0.5).clamp(0.0, (n - 1) as f64);
    let (i, f) = (at.floor() as usize, at.fract());
    let (a, b) = (times[i], times[(i + 1).min(n - 1)]);
    match b.is_finite() {
        _ if f == 0.0 || a == b => a,
        true => a + f * (b - a),
        // the nearer one
        false if f < 0.5 => a,
        false => b,
    }
}

/// Continuous ranked probability score of ascending samples, those beyond `most` taken as `most` [units of the clock].
pub fn crps(times: &[f64], truth: f64, most: f64) -> f64 {
    let n = times.len() as f64;
    let (mut off, mut apart) = (0.0, 0.0);
    for (i, t) in times.iter().enumerate() {
        let t = t.min(most);
        off += (t - truth).abs();
        apart += t * (2.0 * i as f64 + 1.0 - n);
    }
    off / n - apart / (n * n)
}
