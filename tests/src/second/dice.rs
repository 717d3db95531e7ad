//! Random draws from one ChaCha8 stream. Only raw 64-bit words are taken from the crate, so that a seed means the
//! same data whatever happens to the distributions of `rand`.

use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};

/// A seeded source of draws.
#[derive(Clone, Debug)]
pub struct Dice(ChaCha8Rng);

impl Dice {
    /// The stream that belongs to a seed.
    pub fn new(seed: u64) -> Self {
        Dice(ChaCha8Rng::seed_from_u64(seed))
    }

    /// A stream of its own for a part of the work, so that one part's draws do not shift another's.
    pub fn fork(&mut self) -> Dice {
        Dice::new(self.0.next_u64())
    }

    /// Uniform in [0, 1).
    pub fn u(&mut self) -> f64 {
        (self.0.next_u64() >> 11) as f64 / (1u64 << 53) as f64
    }

    /// Uniform between a and b.
    pub fn uni(&mut self, a: f64, b: f64) -> f64 {
        a + (b - a) * self.u()
    }

    /// Uniform in the logarithm between a and b.
    pub fn logu(&mut self, a: f64, b: f64) -> f64 {
        (a.ln() + (b / a).ln() * self.u()).exp()
    }

    /// True with probability p.
    pub fn chance(&mut self, p: f64) -> bool {
        self.u() < p
    }

    /// Plus or minus one.
    pub fn sign(&mut self) -> f64 {
        if self.chance(0.5) { 1.0 } else { -1.0 }
    }

    /// An angle between -pi and pi.
    pub fn phase(&mut self) -> f64 {
        self.uni(-std::f64::consts::PI, std::f64::consts::PI)
    }

    /// One of a list.
    pub fn pick<T: Copy>(&mut self, from: &[T]) -> T {
        from[((self.u() * from.len() as f64) as usize).min(from.len() - 1)]
    }

    /// Index drawn with the given weights.
    pub fn weighted(&mut self, weights: &[f64]) -> usize {
        let mut x = self.u() * weights.iter().sum::<f64>();
        for (k, w) in weights.iter().enumerate() {
            x -= w;
            if x < 0.0 {
                return k;
            }
        }
        weights.len() - 1
    }

    /// Standard normal (Box and Muller).
    pub fn normal(&mut self) -> f64 {
        let r = (-2.0 * (1.0 - self.u()).ln()).sqrt();
        r * (std::f64::consts::TAU * self.u()).cos()
    }
}
