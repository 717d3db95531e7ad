//! Random numbers and the distributions the simulation draws from.

use std::f64::consts::{PI, SQRT_2};

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// A source of random numbers, a ChaCha8 generator of its own for each use.
#[derive(Debug, Clone)]
pub struct Random {
    rng: ChaCha8Rng,
    spare: Option<f64>,
}

impl Random {
    /// The generator of one unit: the same (seed, unit, stream) gives the same
    /// numbers bit for bit, and different streams of a unit are independent,
    /// so that the way a unit is observed does not change the way it wears.
    pub fn new(seed: u64, unit: u64, stream: u64) -> Self {
        let mut key = [0u8; 32];
        key[0..8].copy_from_slice(&seed.to_le_bytes());
        key[8..16].copy_from_slice(&unit.to_le_bytes());
        key[16..24].copy_from_slice(&stream.to_le_bytes());
        key[24..32].copy_from_slice(b"lives v1");
        Self {
            rng: ChaCha8Rng::from_seed(key),
            spare: None,
        }
    }

    /// Uniform in [0, 1).
    pub fn unit(&mut self) -> f64 {
        (self.rng.next_u64() >> 11) as f64 / (1u64 << 53) as f64
    }

    /// Uniform in (0, 1], safe to take the logarithm of.
    pub fn unit_open(&mut self) -> f64 {
        1.0 - self.unit()
    }

    /// Uniform in [`low`, `high`).
    pub fn uniform(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.unit()
    }

    /// Uniform in the logarithm between `low` and `high`, both positive.
    pub fn log_uniform(&mut self, low: f64, high: f64) -> f64 {
        self.uniform(low.ln(), high.ln()).exp()
    }

    /// A whole number from `low` to `high`, both included.
    pub fn whole(&mut self, low: u32, high: u32) -> u32 {
        low + (self.unit() * f64::from(high - low + 1)) as u32
    }

    /// True with probability `p`.
    pub fn chance(&mut self, p: f64) -> bool {
        self.unit() < p
    }

    /// Standard normal, by Box and Muller.
    pub fn normal(&mut self) -> f64 {
        if let Some(z) = self.spare.take() {
            return z;
        }
        let radius = (-2.0 * self.unit_open().ln()).sqrt();
        let angle = 2.0 * PI * self.unit();
        self.spare = Some(radius * angle.sin());
        radius * angle.cos()
    }

    /// Exponential of mean `mean`.
    pub fn exponential(&mut self, mean: f64) -> f64 {
        -mean * self.unit_open().ln()
    }

    /// Gamma of the given shape and scale (mean shape x scale), by Marsaglia
    /// and Tsang; shapes under one by the usual power of a uniform number.
    pub fn gamma(&mut self, shape: f64, scale: f64) -> f64 {
        if shape < 1.0 {
            let boost = self.unit_open().powf(1.0 / shape);
            return self.gamma(shape + 1.0, scale) * boost;
        }
        let d = shape - 1.0 / 3.0;
        let c = 1.0 / (9.0 * d).sqrt();
        loop {
            let x = self.normal();
            let v = (1.0 + c * x).powi(3);
            if v <= 0.0 {
                continue;
            }
            if self.unit_open().ln() < 0.5 * x * x + d * (1.0 - v + v.ln()) {
                return d * v * scale;
            }
        }
    }
}

/// Complementary error function, relative error under 1.2e-7.
fn erfc(x: f64) -> f64 {
    let z = x.abs();
    let t = 1.0 / (1.0 + 0.5 * z);
    let polynomial = [
        -1.265_512_23,
        1.000_023_68,
        0.374_091_96,
        0.096_784_18,
        -0.186_288_06,
        0.278_868_07,
        -1.135_203_98,
        1.488_515_87,
        -0.822_152_23,
        0.170_872_77,
    ]
    .iter()
    .rev()
    .fold(0.0, |sum, c| sum * t + c);
    let tail = t * (-z * z + polynomial).exp();
    if x >= 0.0 { tail } else { 2.0 - tail }
}

/// Standard deviation of Student's t with five degrees of freedom.
const T5_SD: f64 = 1.290_994_448_735_805_6;

/// Distribution function of Student's t with five degrees of freedom, scaled
/// to unit variance.
pub fn heavy_cdf(x: f64) -> f64 {
    let theta = (x * T5_SD / 5f64.sqrt()).atan();
    let cos = theta.cos();
    0.5 + (theta + theta.sin() * cos * (1.0 + 2.0 / 3.0 * cos * cos)) / PI
}

/// Turns a standard normal number into one of Student's t with five degrees of
/// freedom and unit variance, of the same rank.
pub fn heavy_from_normal(z: f64) -> f64 {
    let tail = 0.5 * erfc(z.abs() / SQRT_2);
    // The tail beyond sqrt(5) / tan(phi), phi from 0 (far) to pi/2 (centre).
    let (mut low, mut high) = (0.0f64, PI / 2.0);
    for _ in 0..50 {
        let phi = 0.5 * (low + high);
        let sin = phi.sin();
        let beyond = (phi - sin * phi.cos() * (1.0 + 2.0 / 3.0 * sin * sin)) / PI;
        if beyond < tail {
            low = phi;
        } else {
            high = phi;
        }
    }
    let t = 5f64.sqrt() / (0.5 * (low + high)).tan() / T5_SD;
    t.copysign(z)
}

/// Median magnitude of sqrt(`common`) A + sqrt(1 - `common`) B, where A and B
/// are independent, t-distributed with five degrees of freedom, of unit
/// variance; `common` in 0 .. 1 (one excluded).
pub fn heavy_sum_median(common: f64) -> f64 {
    let (a, b) = (common.sqrt(), (1.0 - common).sqrt());
    let within = |x: f64| {
        let points = 1000;
        let step = PI / f64::from(points);
        (0..points)
            .map(|i| {
                let theta = -PI / 2.0 + (f64::from(i) + 0.5) * step;
                let first = 5f64.sqrt() * theta.tan() / T5_SD;
                let density = 8.0 / (3.0 * PI) * theta.cos().powi(4);
                let inner = heavy_cdf((x - a * first) / b) - heavy_cdf((-x - a * first) / b);
                density * inner * step
            })
            .sum::<f64>()
    };
    let (mut low, mut high) = (0.0, 2.0);
    for _ in 0..50 {
        let middle = 0.5 * (low + high);
        if within(middle) < 0.5 {
            low = middle;
        } else {
            high = middle;
        }
    }
    0.5 * (low + high)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn moments() {
        let mut random = Random::new(1, 2, 3);
        let n = 200_000;
        for (shape, scale) in [(0.1, 2.0), (0.8, 1.0), (4.0, 0.5)] {
            let draws: Vec<f64> = (0..n).map(|_| random.gamma(shape, scale)).collect();
            let mean = draws.iter().sum::<f64>() / f64::from(n);
            let variance = draws.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / f64::from(n);
            assert!((mean / (shape * scale) - 1.0).abs() < 0.03);
            assert!((variance / (shape * scale * scale) - 1.0).abs() < 0.05);
        }
        let mean = (0..n).map(|_| random.exponential(3.0)).sum::<f64>() / f64::from(n);
        assert!((mean - 3.0).abs() < 0.05);
        let square = (0..n).map(|_| heavy_from_normal(random.normal()).powi(2)).sum::<f64>();
        assert!((square / f64::from(n) - 1.0).abs() < 0.05);
    }

    #[test]
    fn heavy_tails() {
        // Upper quartile 0.7267 and 97.5 % point 2.5706 of t with 5 degrees.
        assert!((heavy_cdf(0.726_687 / T5_SD) - 0.75).abs() < 1e-5);
        assert!((heavy_cdf(2.570_582 / T5_SD) - 0.975).abs() < 1e-6);
        assert!((heavy_from_normal(1.959_964) - 2.570_582 / T5_SD).abs() < 1e-5);
        assert!((heavy_from_normal(-0.674_490) + 0.726_687 / T5_SD).abs() < 1e-5);
        assert!((heavy_sum_median(0.0) - 0.726_687 / T5_SD).abs() < 1e-5);
    }
}
