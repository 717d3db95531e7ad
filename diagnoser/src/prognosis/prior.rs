//! What is believed before a unit has been tested: over laws of growth, kinds of wear, volatility of the rate, scatter.

use super::law::Law;
use serde::{Deserialize, Serialize};

/// How damage comes about beside its mean rate.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Wear {
    /// many small increments: variance over mean of the growth [share of U]
    Smooth(f64),
    /// gamma process: coefficient of variation of the growth between two tests
    Gamma(f64),
    /// compound Poisson jumps of gamma sizes, whose scale is learned
    Jumps(Jumps),
}

/// Jumps of one kind: gamma sizes of a shape that is a whole number, and what is known of their scale at first.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Jumps {
    /// shape of the sizes; 1: exponential
    pub shape: u8,
    /// usual mean size [share of U]
    pub size: f64,
}

/// Shape of the inverse gamma distribution of the scale of jumps at first (assumed): known to a factor of two or so.
const SCALE_SHAPE: f64 = 3.0;

impl Jumps {
    /// What is known of the scale of a unit's jumps: shape and scale of an inverse gamma distribution, conjugate to the sizes.
    /// * `seen`, `grown` number of jumps that were seen, and the damage that they were together
    pub fn scale(&self, seen: f64, grown: f64) -> (f64, f64) {
        let shape = f64::from(self.shape);
        (
            SCALE_SHAPE + shape * seen,
            (SCALE_SHAPE - 1.0) * self.size / shape + grown,
        )
    }

    /// Mean size of a unit's jumps [share of U].
    pub fn mean(&self, seen: f64, grown: f64) -> f64 {
        let (a, b) = self.scale(seen, grown);
        f64::from(self.shape) * b / (a - 1.0)
    }

    /// Variance of its logarithm (trigamma function, by three terms of its series).
    pub fn log_variance(&self, seen: f64, grown: f64) -> f64 {
        let r = 1.0 / self.scale(seen, grown).0;
        r * (1.0 + r * (0.5 + r / 6.0))
    }
}

/// What scatter diagnoses have beside what they state.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Noise {
    /// share of the stated standard uncertainty that scatters from test to test; the rest is the unit's own, common to
    /// all its tests
    pub of_stated: f64,
    /// scatter beside it [share of the level]
    pub of_level: f64,
}

/// Exponents (twice) and starts of growth [share of U] of the laws; all assumed.
const LAWS: [(i32, f64); 10] = [
    (-2, 0.05),
    (0, 1.0),
    (1, 0.02),
    (1, 0.15),
    (2, 0.03),
    (2, 0.1),
    (2, 0.4),
    (3, 0.03),
    (3, 0.1),
    (4, 0.06),
];
const LAW_MASS: [f64; 10] = [0.13, 0.45, 0.05, 0.06, 0.04, 0.07, 0.04, 0.05, 0.06, 0.05];

const WEARS: [Wear; 6] = [
    Wear::Smooth(2e-4),
    Wear::Gamma(0.35),
    Wear::Gamma(0.75),
    Wear::Gamma(1.4),
    Wear::Jumps(Jumps { shape: 1, size: 0.045 }),
    Wear::Jumps(Jumps { shape: 3, size: 0.045 }),
];
const WEAR_MASS: [f64; 6] = [0.3, 0.15, 0.12, 0.1, 0.18, 0.15];

/// Standard deviation that the logarithm of the rate gathers in a life.
const VOLATILITIES: [f64; 2] = [0.1, 0.35];
const VOLATILITY_MASS: [f64; 2] = [0.5, 0.5];

const NOISES: [Noise; 3] = [
    Noise {
        of_stated: 0.3,
        of_level: 0.0,
    },
    Noise {
        of_stated: 1.0,
        of_level: 0.0,
    },
    Noise {
        of_stated: 1.0,
        of_level: 0.02,
    },
];
const NOISE_MASS: [f64; 3] = [0.4, 0.5, 0.1];

/// Combinations of the four axes.
pub const MODELS: usize = LAWS.len() * WEARS.len() * VOLATILITIES.len() * NOISES.len();

/// A life of so many tests is the guess where no fleet says better (assumed).
const TESTS_OF_A_LIFE: f64 = 200.0;

/// Masses of all combinations, and what is known of the rate.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Prior {
    /// mass of every combination, in the order law, wear, volatility, noise ([`MODELS`] values that add up to 1)
    pub joint: Vec<f64>,
    /// mean of rho by law: minus the logarithm of the life from new [units of the clock]
    pub rho_mean: Vec<f64>,
    /// its standard deviation by law
    pub rho_sd: Vec<f64>,
    /// changes of regime in a usual life, as the filter looks for them
    pub hazard: f64,
    /// hazard of a later change over that of the first
    pub later: f64,
    /// usual time between two tests [units of the clock]
    pub interval: f64,
}

impl Prior {
    /// Where no fleet is known: all values assumed.
    /// * `interval` usual time between two tests [units of the clock], above 0
    pub fn shipped(interval: f64) -> Self {
        let mut joint = Vec::with_capacity(MODELS);
        for l in LAW_MASS {
            for w in WEAR_MASS {
                for v in VOLATILITY_MASS {
                    joint.extend(NOISE_MASS.map(|n| l * w * v * n));
                }
            }
        }
        let life = TESTS_OF_A_LIFE * interval;
        Self {
            joint,
            rho_mean: vec![-life.ln(); LAWS.len()],
            rho_sd: vec![1.0; LAWS.len()],
            hazard: 0.5,
            later: 0.6,
            interval,
        }
    }

    /// Whether masses and rates are those of this program's axes, finite and in range.
    pub fn is_sound(&self) -> bool {
        let good = |v: &[f64], n: usize| v.len() == n && v.iter().all(|x| x.is_finite());
        good(&self.joint, MODELS)
            && self.joint.iter().all(|m| (0.0..=1.0).contains(m))
            && good(&self.rho_mean, LAWS.len())
            && good(&self.rho_sd, LAWS.len())
            && self.rho_sd.iter().all(|s| *s > 0.0)
            && [self.hazard, self.later, self.interval]
                .iter()
                .all(|x| x.is_finite() && *x >= 0.0)
            && self.interval > 0.0
    }

    /// Mass of one combination.
    pub fn mass(&self, m: Model) -> f64 {
        self.joint[m.index()]
    }

    /// The usual life from new [units of the clock]: the geometric mean over laws.
    pub fn usual_life(&self) -> f64 {
        (-self.rho_mean.iter().sum::<f64>() / self.rho_mean.len() as f64).exp()
    }

    /// Mean and standard deviation of rho under a combination's law.
    pub fn rho(&self, m: Model) -> (f64, f64) {
        (self.rho_mean[m.law as usize], self.rho_sd[m.law as usize])
    }
}

/// One combination: indices into the axes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Model {
    law: u8,
    wear: u8,
    volatility: u8,
    noise: u8,
}

/// The laws, made once.
#[derive(Clone, Debug)]
pub struct Laws([Law; LAWS.len()]);

impl Laws {
    /// All of them.
    pub fn new() -> Self {
        Self(LAWS.map(|(twice_m, eps)| Law::new(twice_m, eps)))
    }

    /// That of a combination.
    pub fn of(&self, m: Model) -> &Law {
        &self.0[m.law as usize]
    }
}

impl Default for Laws {
    fn default() -> Self {
        Self::new()
    }
}

impl Model {
    /// All combinations, in the order of [`Model::index`].
    pub fn all() -> impl Iterator<Item = Model> {
        let of = |n: usize| 0..n as u8;
        of(LAWS.len()).flat_map(move |law| {
            of(WEARS.len()).flat_map(move |wear| {
                of(VOLATILITIES.len()).flat_map(move |volatility| {
                    of(NOISES.len()).map(move |noise| Model {
                        law,
                        wear,
                        volatility,
                        noise,
                    })
                })
            })
        })
    }

    /// Place among all.
    pub fn index(self) -> usize {
        ((self.law as usize * WEARS.len() + self.wear as usize) * VOLATILITIES.len() + self.volatility as usize)
            * NOISES.len()
            + self.noise as usize
    }

    /// Index of the law.
    pub fn law(self) -> usize {
        self.law as usize
    }

    /// Its kind of wear.
    pub fn wear(self) -> Wear {
        WEARS[self.wear as usize]
    }

    /// Its volatility.
    pub fn volatility(self) -> f64 {
        VOLATILITIES[self.volatility as usize]
    }

    /// Its scatter.
    pub fn noise(self) -> Noise {
        NOISES[self.noise as usize]
    }

    /// The group of wears that it belongs to, for what a fleet teaches: smooth, fine, ragged, jumps.
    pub fn group(self) -> usize {
        match self.wear() {
            Wear::Smooth(_) => 0,
            Wear::Gamma(cv) if cv < 0.5 => 1,
            Wear::Gamma(_) => 2,
            Wear::Jumps(_) => 3,
        }
    }

    /// What the group is called.
    pub const GROUPS: [&'static str; 4] = ["smooth", "fine", "ragged", "jumps"];
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn combinations_have_their_places_and_masses_add_up() {
        assert!(Model::all().enumerate().all(|(i, m)| m.index() == i));
        assert_eq!(Model::all().count(), MODELS);
        let p = Prior::shipped(1.0);
        assert!(p.is_sound() && (p.joint.iter().sum::<f64>() - 1.0).abs() < 1e-12);
        assert!(!Prior { joint: vec![1.0], ..p }.is_sound());
    }
}
