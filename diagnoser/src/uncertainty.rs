//! How units of one type differ, in the features: the response of every feature to every cause.
//!
//! Around the actuator that the maps are of, a feature changes by `sum over causes of x_c s_c(FSJ, zeta)`,
//! `x_c` the deviation of a cause and `s_c` its slope. Slopes are cubic polynomials of the faults,
//! fitted to simulated units (a response surface; Box and Wilson 1951). What the straight line leaves
//! is an uncertainty of its own.

use nalgebra::{DMatrix, DVector};
use schemas::feature::Feature;
use serde::{Deserialize, Serialize};
use sim_worker::spread::{Cause, Spread};
use std::collections::BTreeMap;

/// Most features that are inverted together.
pub const MOST: usize = 8;

/// One number for each feature that is inverted.
pub type Row = [f64; MOST];

/// Terms of a cubic polynomial of two variables.
const TERMS: usize = 10;

/// Coefficients of a slope over the faults.
type Slope = [f64; TERMS];

/// Terms at scaled faults.
fn terms(u: f64, v: f64) -> Slope {
    [
        1.0,
        u,
        v,
        u * u,
        u * v,
        v * v,
        u * u * u,
        u * u * v,
        u * v * v,
        v * v * v,
    ]
}

/// Faults scaled to -1 to 1 over the range that the maps cover.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Scale {
    pub fsj: (f64, f64),
    pub zeta: (f64, f64),
}

impl Scale {
    fn of(&self, fsj: f64, zeta: f64) -> (f64, f64) {
        let scaled = |x: f64, (lo, hi): (f64, f64)| (2.0 * x - lo - hi) / (hi - lo);
        (scaled(fsj, self.fsj), scaled(zeta, self.zeta))
    }
}

/// Deviations of a unit by what acts by itself: [`Cause::acts_through`].
pub type Deviations = [f64; Cause::COUNT];

/// What the causes of a spread deviate by together, where each lies at `draw` (-1 to 1) of its half-width.
pub fn deviations(spread: &Spread, draw: &[f64; Cause::COUNT]) -> Deviations {
    let mut x = [0.0; Cause::COUNT];
    for (cause, h) in spread.causes() {
        for (through, per_unit) in cause.acts_through() {
            x[through as usize] += draw[cause as usize] * h * per_unit;
        }
    }
    x
}

/// Responses of the features to the causes of a spread.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ResponseSurfaces {
    scale: Scale,
    /// by feature name: slope for each cause, in the feature's unit for a deviation of 1 (relative, rad)
    slopes: BTreeMap<String, [Slope; Cause::COUNT]>,
    /// by feature name: standard uncertainty of what straight lines leave, in the feature's unit
    pub remainder: BTreeMap<String, f64>,
}

/// One simulated unit: its faults, deviations, and its features less the maps'.
pub struct Sample {
    pub fsj: f64,
    pub zeta: f64,
    pub deviations: Deviations,
    /// feature less map, and the uncertainty that the map already states
    pub residual: Vec<(Feature, f64, f64)>,
}

impl ResponseSurfaces {
    /// Least squares over simulated units. Features are those of the first sample; causes that never
    /// deviate have slope 0.
    pub fn fit(scale: Scale, samples: &[Sample]) -> Self {
        let acting: Vec<usize> = (0..Cause::COUNT)
            .filter(|&c| samples.iter().any(|s| s.deviations[c] != 0.0))
            .collect();
        // deviations by their own size, so that the columns are alike
        let size: Vec<f64> = acting
            .iter()
            .map(|&c| samples.iter().map(|s| s.deviations[c].abs()).fold(0.0, f64::max))
            .collect();
        let row = |s: &Sample| {
            let (u, v) = scale.of(s.fsj, s.zeta);
            let terms = terms(u, v);
            let columns = acting.iter().zip(&size);
            let one = |(&c, &size): (&usize, &f64)| terms.map(|t| t * s.deviations[c] / size);
            columns.flat_map(one).collect::<Vec<f64>>()
        };
        let n = acting.len() * TERMS;
        let rows: Vec<Vec<f64>> = samples.iter().map(row).collect();
        let design = DMatrix::from_fn(samples.len(), n, |i, j| rows[i][j]);
        // causes that only act together (temperature alone) share their effect: a touch of ridge
        let mut normal = design.transpose() * &design;
        let ridge = 1e-9 * samples.len() as f64;
        (0..n).for_each(|i| normal[(i, i)] += ridge);
        let solver = normal.cholesky().expect("positive definite by the ridge");
        let mut slopes = BTreeMap::new();
        let mut remainder = BTreeMap::new();
        let features = samples.first().map_or(&[][..], |s| &s.residual);
        for (k, (feature, _, _)) in features.iter().enumerate() {
            let y = DVector::from_iterator(samples.len(), samples.iter().map(|s| s.residual[k].1));
            let x = solver.solve(&(design.transpose() * &y));
            let left = y - &design * &x;
            let mut slope = [[0.0; TERMS]; Cause::COUNT];
            for (a, (&c, &size)) in acting.iter().zip(&size).enumerate() {
                slope[c] = std::array::from_fn(|t| x[a * TERMS + t] / size);
            }
            let stated = samples.iter().map(|s| s.residual[k].2.powi(2)).sum::<f64>();
            let free = (samples.len() as f64 - n as f64).max(1.0);
            let variance = (left.norm_squared() / free - stated / samples.len() as f64).max(0.0);
            slopes.insert(feature.name().to_string(), slope);
            remainder.insert(feature.name().to_string(), variance.sqrt());
        }
        Self {
            scale,
            slopes,
            remainder,
        }
    }

    /// Whether there is a slope for this cause, or for what it acts through.
    pub fn knows(&self, cause: Cause) -> bool {
        let acts = |c: Cause| self.slopes.values().any(|s| s[c as usize].iter().any(|x| *x != 0.0));
        cause.acts_through().into_iter().all(|(c, _)| acts(c))
    }

    /// Slopes of the features for a cause at a fault pair, in their units for a deviation of 1.
    pub fn slope(&self, features: &[Feature], cause: Cause, fsj: f64, zeta: f64) -> Row {
        let (u, v) = self.scale.of(fsj, zeta);
        let terms = terms(u, v);
        let at = |slope: &Slope| slope.iter().zip(&terms).map(|(a, b)| a * b).sum::<f64>();
        let mut out = [0.0; MOST];
        for (o, f) in out.iter_mut().zip(features) {
            if let Some(slopes) = self.slopes.get(f.name()) {
                *o = through(cause, |c| at(&slopes[c as usize]));
            }
        }
        out
    }

    /// Prepared for quick evaluation: slopes of `features` for a half-width of each of `causes`.
    pub fn prepared(&self, features: &[Feature], causes: &[(Cause, f64)]) -> PreparedSurfaces {
        let columns = causes.iter().map(|&(cause, amount)| {
            let mut rows = [[0.0; MOST]; TERMS];
            for (k, f) in features.iter().enumerate() {
                if let Some(slopes) = self.slopes.get(f.name()) {
                    for (t, row) in rows.iter_mut().enumerate() {
                        row[k] = amount * through(cause, |c| slopes[c as usize][t]);
                    }
                }
            }
            rows
        });
        PreparedSurfaces {
            scale: self.scale,
            columns: columns.collect(),
        }
    }
}

/// Sum over what a cause acts through.
fn through(cause: Cause, of: impl Fn(Cause) -> f64) -> f64 {
    cause.acts_through().into_iter().map(|(c, x)| x * of(c)).sum()
}

/// Response surfaces with the features side by side.
#[derive(Clone, Debug)]
pub struct PreparedSurfaces {
    scale: Scale,
    columns: Vec<[Row; TERMS]>,
}

impl PreparedSurfaces {
    /// Change of the features for each cause at a fault pair.
    pub fn at(&self, fsj: f64, zeta: f64) -> impl Iterator<Item = Row> {
        let (u, v) = self.scale.of(fsj, zeta);
        let terms = terms(u, v);
        self.columns.iter().map(move |rows| {
            let mut out = [0.0; MOST];
            for (row, t) in rows.iter().zip(terms) {
                for (o, x) in out.iter_mut().zip(row) {
                    *o += t * x;
                }
            }
            out
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn prop_surfaces_find_the_slopes_that_made_the_data() {
        let scale = Scale {
            fsj: (1.0, 5.0),
            zeta: (0.0, 0.5),
        };
        let slope = |f: f64, z: f64| 0.3 + 0.1 * f - 0.7 * z * f;
        // 0 to 1 (Steele et al. 2014, SplitMix)
        let number = |i: usize, k: usize| {
            let mut x = ((8 * i + k) as u64).wrapping_mul(0x9E37_79B9_7F4A_7C15);
            x = (x ^ (x >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
            x = (x ^ (x >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
            ((x ^ (x >> 31)) >> 11) as f64 / (1u64 << 53) as f64
        };
        let samples: Vec<Sample> = (0..400)
            .map(|i| {
                let (fsj, zeta) = (1.0 + 4.0 * number(i, 1), 0.5 * number(i, 2));
                let mut deviations = [0.0; Cause::COUNT];
                deviations[Cause::Resistance as usize] = 0.1 * number(i, 3) - 0.05;
                deviations[Cause::Supply as usize] = 0.04 * number(i, 4) - 0.02;
                let y = slope(fsj, zeta) * deviations[Cause::Resistance as usize]
                    - 2.0 * deviations[Cause::Supply as usize];
                Sample {
                    fsj,
                    zeta,
                    deviations,
                    residual: vec![(Feature::P2, y, 0.0)],
                }
            })
            .collect();
        let s = ResponseSurfaces::fit(scale, &samples);
        for (f, z) in [(1.2, 0.1), (3.0, 0.4), (4.9, 0.02)] {
            let at = |c| s.slope(&[Feature::P2], c, f, z)[0];
            assert!((at(Cause::Resistance) - slope(f, z)).abs() < 1e-4, "{f} {z}");
            assert!((at(Cause::Supply) + 2.0).abs() < 1e-4);
            assert_eq!(at(Cause::Inertia), 0.0);
            let prepared = s.prepared(&[Feature::P2], &[(Cause::Resistance, 0.05)]);
            let column = prepared.at(f, z).next().unwrap();
            assert!((column[0] - 0.05 * at(Cause::Resistance)).abs() < 1e-12);
        }
        assert!(s.knows(Cause::Resistance) && !s.knows(Cause::Inertia) && !s.knows(Cause::Temperature));
        assert!(s.remainder["p2"] < 1e-5, "{:?}", s.remainder);
    }
}
