//! What a healthy test of a unit gives, over the unit's constants: a quadratic response surface at the healthy point
//! (Box and Wilson 1951), fitted to simulated units.

use crate::uncertainty::{Deviations, Regression, all_pairs};
use schemas::feature::Feature;
use serde::{Deserialize, Serialize};

/// Samples for each coefficient, at least; with fewer no bends are fitted.
const SAMPLES_EACH: usize = 3;

/// Share of a feature that tests do not resolve (assumed).
const RESOLVED: f64 = 1e-5;

/// Share of a feature to which a model is an actuator, at best (assumed): what is the same in all healthy tests of a unit may
/// be off by as much and say nothing of its constants. A motor's travel of 1 rad, in steps of a sensor of 1e-4 rad, was 1.5 steps
/// less in all tests of a unit of another hand's simulator: taken for an inductance 6 % too great, it put zeta 1 % too high.
const EXACT: f64 = 2e-4;

/// Features of healthy tests as a function of the unit's deviations.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Baseline {
    /// names of the features, in the order of all that follows
    names: Vec<String>,
    /// numbers of the causes that act, and their size
    acting: Vec<(usize, f64)>,
    /// pairs of places in `acting` whose product counts
    pairs: Vec<(usize, usize)>,
    /// of each feature: value of the actuator itself, slope of each cause, bend of each pair
    coefficients: Vec<Vec<f64>>,
    /// of each feature: standard deviation of what the fit leaves, sensors included
    left: Vec<f64>,
    /// of each feature: standard deviation from test to test of one unit
    noise: Vec<f64>,
}

/// One feature of a healthy test.
#[derive(Clone, Debug, PartialEq)]
pub struct Expected {
    /// which
    pub feature: Feature,
    /// in its unit
    pub value: f64,
    /// change for a deviation of 1 of each cause
    pub slopes: Deviations,
    /// standard deviation of what is the same in all healthy tests of a unit
    pub systematic: f64,
    /// standard deviation from test to test
    pub noise: f64,
}

impl Baseline {
    /// Least squares over healthy tests of simulated units.
    ///
    /// * `features` with the standard deviation that the sensors give to each; [`Baseline::scatter`] sees the rest of what
    ///   changes from test to test
    /// * `samples` deviations of the unit, and the features in the same order
    pub fn fit(features: &[(Feature, f64)], samples: &[(Deviations, Vec<f64>)]) -> Self {
        let size = |c: usize| samples.iter().map(|s| s.0[c].abs()).fold(0.0, f64::max);
        let acting: Vec<(usize, f64)> = (0..samples.first().map_or(0, |s| s.0.len()))
            .map(|c| (c, size(c)))
            .filter(|(_, s)| *s > 0.0)
            .collect();
        let n = acting.len();
        let mut pairs: Vec<(usize, usize)> = all_pairs(n).collect();
        if samples.len() < SAMPLES_EACH * (1 + n + pairs.len()) {
            pairs.clear();
        }
        let row = |x: &Deviations| {
            let x: Vec<f64> = acting.iter().map(|&(c, size)| x[c] / size).collect();
            let products = pairs.iter().map(|&(i, j)| x[i] * x[j]);
            std::iter::once(1.0)
                .chain(x.iter().copied())
                .chain(products)
                .collect::<Vec<f64>>()
        };
        let rows: Vec<Vec<f64>> = samples.iter().map(|s| row(&s.0)).collect();
        let regression = Regression::new(&rows);
        let free = (samples.len() as f64 - (1 + n + pairs.len()) as f64).max(1.0);
        let (mut coefficients, mut left) = (Vec::new(), Vec::new());
        for k in 0..features.len() {
            let (x, rest) = regression.fit(samples.iter().map(|s| s.1[k]));
            left.push((rest.norm_squared() / free).sqrt());
            coefficients.push(x.iter().copied().collect());
        }
        Self {
            names: features.iter().map(|(f, _)| f.name().to_string()).collect(),
            acting,
            pairs,
            coefficients,
            left,
            noise: features.iter().map(|(_, n)| *n).collect(),
        }
    }

    /// What scatters from test to test in units with several healthy tests each: by feature the sum of squares about each
    /// unit's mean, and their degrees of freedom.
    ///
    /// * `units` of each unit the tests: deviations, and the features in the order of [`Baseline::fit`]
    pub fn about_units(&self, units: &[Vec<(Deviations, Vec<f64>)>]) -> (Vec<f64>, f64) {
        let kinds = self.names.len();
        let (mut sum, mut free) = (vec![0.0; kinds], 0.0);
        for tests in units.iter().filter(|t| t.len() > 1) {
            let left: Vec<Vec<f64>> = tests
                .iter()
                .map(|(x, y)| self.at(x).iter().zip(y).map(|(e, y)| y - e.value).collect())
                .collect();
            let n = left.len() as f64;
            free += n - 1.0;
            for (k, sum) in sum.iter_mut().enumerate() {
                let mean = left.iter().map(|l| l[k]).sum::<f64>() / n;
                *sum += left.iter().map(|l| (l[k] - mean).powi(2)).sum::<f64>();
            }
        }
        (sum, free)
    }

    /// Takes that scatter where it is more than that of the sensors: relays chatter differently at another supply, and
    /// break-away comes in whole samples.
    ///
    /// * `sum`, `free` of [`Baseline::about_units`], of one rest angle or several
    pub fn scatter(&mut self, sum: &[f64], free: f64) {
        if free > 0.0 {
            for (noise, sum) in self.noise.iter_mut().zip(sum) {
                *noise = noise.max((sum / free).sqrt());
            }
        }
    }

    /// Takes the scatter from test to test of the same features from another rest angle, where it is more.
    pub(super) fn scatter_as(&mut self, other: &Self) {
        self.noise
            .iter_mut()
            .zip(&other.noise)
            .for_each(|(n, o)| *n = n.max(*o));
    }

    /// Features of the tests, in the order of [`Baseline::fit`].
    pub fn features(&self) -> impl Iterator<Item = Feature> {
        self.names.iter().filter_map(|n| Feature::from_name(n))
    }

    /// What a unit's healthy tests should give.
    pub fn at(&self, deviations: &Deviations) -> Vec<Expected> {
        let x: Vec<f64> = self.acting.iter().map(|&(c, size)| deviations[c] / size).collect();
        let one = |(k, name): (usize, &String)| {
            let feature = Feature::from_name(name)?;
            let a = self.coefficients.get(k)?;
            let mut value = *a.first()?;
            let mut by = vec![0.0; x.len()];
            for ((b, x), a) in by.iter_mut().zip(&x).zip(&a[1..]) {
                *b += a;
                value += a * x;
            }
            for (&(i, j), a) in self.pairs.iter().zip(&a[1 + x.len()..]) {
                value += a * x[i] * x[j];
                by[i] += a * x[j];
                by[j] += a * x[i];
            }
            let mut slopes = Deviations::default();
            for (&(c, size), b) in self.acting.iter().zip(by) {
                slopes[c] = b / size;
            }
            // nothing is measured better than this (assumed)
            let noise = self.noise[k].max(RESOLVED * value.abs());
            let left = self.left[k].max(EXACT * value.abs());
            // tests that are alike in all, supply too, scatter less than those of the campaign: half of what is left is
            // the same in all of them, at least (assumed)
            let systematic = (left * left - noise * noise).max(0.5 * left * left).sqrt();
            Some(Expected {
                feature,
                value,
                slopes,
                systematic,
                noise,
            })
        };
        self.names.iter().enumerate().filter_map(one).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn prop_a_bent_response_is_found_again() {
        let mut samples = Vec::new();
        for i in 0..200 {
            let mut x = Deviations::default();
            // evenly spread, and not alike
            x[0] = 0.1 * ((i * 37 % 200) as f64 / 100.0 - 1.0);
            x[4] = 0.02 * ((i * 91 % 200) as f64 / 100.0 - 1.0);
            samples.push((x, vec![3.0 + 2.0 * x[0] - 5.0 * x[4] + 40.0 * x[0] * x[4]]));
        }
        let b = Baseline::fit(&[(Feature::P2, 0.0)], &samples);
        let mut x = Deviations::default();
        (x[0], x[4]) = (0.05, -0.01);
        let e = &b.at(&x)[0];
        assert!((e.value - (3.0 + 0.1 + 0.05 - 0.02)).abs() < 1e-6, "{e:?}");
        assert!(
            (e.slopes[0] - (2.0 - 0.4)).abs() < 1e-5 && (e.slopes[4] - (-5.0 + 2.0)).abs() < 1e-4,
            "{e:?}"
        );
        // as exact as a model is, and no more
        assert!((e.systematic / e.value - EXACT).abs() < 0.01 * EXACT, "{e:?}");
        // what differs from test to test is noise
        let mut b = b;
        let (sum, free) = b.about_units(&[
            vec![(x, vec![3.0]), (x, vec![3.2])],
            vec![(x, vec![5.0]), (x, vec![5.2])],
        ]);
        b.scatter(&sum, free);
        assert!((b.at(&x)[0].noise - 0.2 / 2f64.sqrt()).abs() < 1e-9);
    }
}
