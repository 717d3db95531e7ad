//! All maps together: can they tell FSJ from zeta, and what would help.
//!
//! Fisher information of Gaussian features, `I = J^T C^-1 J` with J their slopes and C their covariance
//! (Kay, Fundamentals of Statistical Signal Processing, 1993, ch. 3; how C itself changes with the faults is
//! left out). Its inverse is the least covariance of an unbiased estimate of (FSJ, zeta) (Cramer and
//! Rao), and `pi k^2 sqrt(det I^-1)` with `k^2 = -2 ln 0.05` the area of the 95 % ellipse. What is
//! a feature's own (noise, interpolation) is taken to be independent of the other features'. It holds near
//! one fault pair: where an ellipse is as large as the range, it says that there is little information, not
//! how the area looks.

use super::MOST_CORRELATION;
use super::shape::interpolation_variance;
use crate::calibration::COVERAGE;
use crate::diagnosis::Diagnoser;
use crate::failure_map::{FailureMap, smoothness};
use crate::uncertainty::Row;
use nalgebra::{DMatrix, DVector};
use schemas::feature::Feature;
use sim_worker::spread::Cause;
use std::f64::consts::PI;

/// `1 - correlation^2` below which the information counts as singular: round-off of the slopes.
const SINGULAR: f64 = 1e-12;

/// What the features of one test say of the faults.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ellipse {
    /// standard deviations
    pub sigma_fsj: f64,
    /// of zeta
    pub sigma_zeta: f64,
    /// of FSJ and zeta, -1 to 1
    pub correlation: f64,
    /// of the 95 % ellipse, FSJ times zeta
    pub area: f64,
}

/// A cell of the grid.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cell {
    /// its ends
    pub fsj: (f64, f64),
    /// along zeta
    pub zeta: (f64, f64),
    /// `None` where the information is singular
    pub ellipse: Option<Ellipse>,
}

impl Cell {
    /// (FSJ, zeta)
    pub fn centre(&self) -> (f64, f64) {
        (0.5 * (self.fsj.0 + self.fsj.1), 0.5 * (self.zeta.0 + self.zeta.1))
    }

    /// In percent of the FSJ at the centre; infinite where singular.
    pub fn sigma_fsj_percent(&self) -> f64 {
        let sigma = self.ellipse.map_or(f64::INFINITY, |e| e.sigma_fsj);
        100.0 * sigma / self.centre().0
    }

    /// Infinite where singular.
    pub fn sigma_zeta(&self) -> f64 {
        self.ellipse.map_or(f64::INFINITY, |e| e.sigma_zeta)
    }

    /// Of the 95 % ellipse; infinite where singular.
    pub fn area(&self) -> f64 {
        self.ellipse.map_or(f64::INFINITY, |e| e.area)
    }

    /// The faults can be told apart: |correlation| is at most [`MOST_CORRELATION`].
    pub fn isolates(&self) -> bool {
        self.ellipse.is_some_and(|e| e.correlation.abs() <= MOST_CORRELATION)
    }
}

/// An improvement.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Remedy {
    /// a second, independent measurement of a feature, read on the same map: the variances of its noise
    /// and sample halve
    Again(Feature),
    /// a second feature of the same kind with a map of its own: that of the interpolation halves as well,
    /// since what scatters in one map (switching, break-away) is not the same in the other
    Another(Feature),
    /// a cause of the spread is known exactly
    Known(Cause),
    /// a grid twice as fine: interpolation errors shrink as leave-one-out on every second line suggests, to
    /// a quarter at best
    FinerGrid,
    /// standard deviations of the sensors halve
    BetterSensors,
}

impl Remedy {
    /// In words.
    pub fn title(self) -> String {
        match self {
            Remedy::Again(f) => format!("{} measured twice, same map", f.name()),
            Remedy::Another(Feature::P3) => "a second p3 with its own map (another rest angle)".into(),
            Remedy::Another(f) => format!("a second {} with its own map", f.name()),
            Remedy::Known(c) => format!("the {} known exactly", c.title()),
            Remedy::FinerGrid => "a grid twice as fine".into(),
            Remedy::BetterSensors => "sensors with half the noise".into(),
        }
    }

    /// All that could be done.
    pub(super) fn all(joint: &[Feature], locals: &[Local]) -> Vec<Self> {
        let causes = locals.first().into_iter().flat_map(|l| &l.common);
        let again = joint.iter().flat_map(|f| [Remedy::Again(*f), Remedy::Another(*f)]);
        let known = causes.map(|(c, _)| Remedy::Known(*c));
        again
            .chain(known)
            .chain([Remedy::FinerGrid, Remedy::BetterSensors])
            .collect()
    }
}

/// What is different from today.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Change {
    Nothing,
    /// the joint feature of this place left out
    Without(usize),
    Made(Remedy),
}

/// Variances of a feature that it shares with no other.
#[derive(Clone, Copy, Debug)]
struct Own {
    noise: f64,
    sample: f64,
    interpolation: f64,
    /// of the interpolation, on a grid twice as fine
    finer: f64,
    /// projection, bend of the responses
    rest: f64,
}

/// A cell with what its information is made of.
#[derive(Clone, Debug)]
pub(super) struct Local {
    fsj: (f64, f64),
    zeta: (f64, f64),
    features: Vec<Feature>,
    /// mean slopes over the cell
    by_fsj: Vec<f64>,
    by_zeta: Vec<f64>,
    own: Vec<Own>,
    pub(super) common: Vec<(Cause, Row)>,
}

impl Local {
    /// One for each cell of the grid, zeta outer, FSJ inner.
    pub(super) fn all(diagnoser: &Diagnoser) -> Vec<Self> {
        let features = diagnoser.joint_features().to_vec();
        let maps: Vec<&FailureMap> = features.iter().filter_map(|f| diagnoser.maps.map(*f)).collect();
        let grid = maps[0];
        let n = grid.fsj.len();
        // all maps on the grid of the first, which is that of the diagnosis
        let on_grid = |m: &&FailureMap| -> Vec<f64> {
            let row = |z: &f64| {
                let curve = m.curve(*z);
                grid.fsj.iter().map(move |f| m.on_curve(&curve, *f)).collect::<Vec<_>>()
            };
            grid.zeta.iter().flat_map(row).collect()
        };
        let tables: Vec<Vec<f64>> = maps.iter().map(on_grid).collect();
        let halved: Vec<f64> = maps
            .iter()
            .map(|m| smoothness(&m.leave_one_out(1), &m.leave_one_out(2)))
            .collect();
        let one = |i: usize| {
            let (r, c) = (i / (n - 1), i % (n - 1));
            let (fsj, zeta) = ((grid.fsj[c], grid.fsj[c + 1]), (grid.zeta[r], grid.zeta[r + 1]));
            let (f, z) = (0.5 * (fsj.0 + fsj.1), 0.5 * (zeta.0 + zeta.1));
            let corners = |t: &Vec<f64>| [0, 1, n, n + 1].map(|k| t[r * n + c + k]);
            let along_fsj = |t| {
                let [a, b, d, e] = corners(t);
                0.5 * (b - a + e - d) / (fsj.1 - fsj.0)
            };
            let along_zeta = |t| {
                let [a, b, d, e] = corners(t);
                0.5 * (d - a + e - b) / (zeta.1 - zeta.0)
            };
            let parts = diagnoser.covariance_parts(f, z);
            let own = |(k, m): (usize, &&FailureMap)| Own::of(m, parts.own[k], halved[k], f, z);
            Self {
                fsj,
                zeta,
                features: features.clone(),
                by_fsj: tables.iter().map(along_fsj).collect(),
                by_zeta: tables.iter().map(along_zeta).collect(),
                own: maps.iter().enumerate().map(own).collect(),
                common: parts.common,
            }
        };
        (0..(n - 1) * (grid.zeta.len() - 1)).map(one).collect()
    }

    pub(super) fn cell(&self, change: Change) -> Cell {
        Cell {
            fsj: self.fsj,
            zeta: self.zeta,
            ellipse: self.ellipse(change),
        }
    }

    /// Covariance of the features in `used`.
    pub(super) fn covariance(&self, change: Change, used: &[usize]) -> DMatrix<f64> {
        let known = |c: Cause| change == Change::Made(Remedy::Known(c));
        let mut c = DMatrix::zeros(used.len(), used.len());
        for (i, &k) in used.iter().enumerate() {
            c[(i, i)] = self.own[k].variance(self.features[k], change);
            for (_, s) in self.common.iter().filter(|(c, _)| !known(*c)) {
                for (j, &l) in used.iter().enumerate() {
                    c[(i, j)] += s[k] * s[l];
                }
            }
        }
        c
    }

    fn ellipse(&self, change: Change) -> Option<Ellipse> {
        let used: Vec<usize> = (0..self.own.len()).filter(|&k| change != Change::Without(k)).collect();
        let cholesky = self.covariance(change, &used).cholesky()?;
        let slopes = |v: &[f64]| {
            let v = DVector::from_iterator(used.len(), used.iter().map(|&k| v[k]));
            cholesky.l_dirty().solve_lower_triangular(&v)
        };
        let (a, b) = (slopes(&self.by_fsj)?, slopes(&self.by_zeta)?);
        let (ff, fz, zz) = (a.dot(&a), a.dot(&b), b.dot(&b));
        let det = ff * zz - fz * fz;
        // no slope at all counts as well
        if det.is_nan() || det <= SINGULAR * ff * zz {
            return None;
        }
        let reach_2 = -2.0 * (1.0 - COVERAGE).ln();
        Some(Ellipse {
            sigma_fsj: (zz / det).sqrt(),
            sigma_zeta: (ff / det).sqrt(),
            correlation: -fz / (ff * zz).sqrt(),
            area: PI * reach_2 / det.sqrt(),
        })
    }
}

impl Own {
    /// Takes a variance of the diagnosis apart.
    ///
    /// * `whole` variance at the fault pair without common causes
    /// * `halved` what halving the spacing leaves of the interpolation's standard uncertainty
    fn of(map: &FailureMap, whole: f64, halved: f64, fsj: f64, zeta: f64) -> Self {
        let (noise, sample) = (map.budget.noise.powi(2), map.budget.sample.powi(2) / 3.0);
        let error = map.error_at(fsj, zeta);
        let interpolation = interpolation_variance(error, map.residual_at(fsj, zeta));
        let rest = (whole - noise - sample - interpolation).max(0.0);
        Self {
            noise,
            sample,
            interpolation,
            finer: interpolation * halved * halved,
            rest,
        }
    }

    fn variance(&self, feature: Feature, change: Change) -> f64 {
        let Own {
            mut noise,
            mut sample,
            mut interpolation,
            finer,
            rest,
        } = *self;
        match change {
            Change::Made(Remedy::Again(f)) if f == feature => {
                noise *= 0.5;
                sample *= 0.5;
            }
            Change::Made(Remedy::Another(f)) if f == feature => {
                noise *= 0.5;
                sample *= 0.5;
                interpolation *= 0.5;
            }
            Change::Made(Remedy::FinerGrid) => interpolation = finer,
            Change::Made(Remedy::BetterSensors) => noise *= 0.25,
            _ => {}
        }
        noise + sample + interpolation + rest
    }
}
