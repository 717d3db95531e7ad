//! How units of one type differ, in the features: the response of every feature to every cause.
//!
//! Around the actuator that the maps are of, a feature changes by `sum over causes of x_c s_c(FSJ, zeta)`,
//! `x_c` the deviation of a cause and `s_c` its slope, and by `sum over pairs x_c x_d q_cd(FSJ, zeta)`, the
//! bend. Slopes are cubic, bends quadratic polynomials of the faults, fitted to simulated units (a response
//! surface; Box and Wilson 1951). What that leaves is an uncertainty of its own.

mod factors;

pub(crate) use factors::FRICTION;
pub use factors::{Deviations, Discrepancy, Factors, deviations, log_kinetic};

use nalgebra::{Cholesky, DMatrix, DVector, Dyn};
use schemas::feature::Feature;
use serde::de::Error as _;
use serde::{Deserialize, Deserializer, Serialize};
use sim_worker::spread::{Cause, Spread};
use std::collections::BTreeMap;

/// Most features that are inverted together.
pub const MOST: usize = 12;

/// One number for each feature that is inverted.
pub type Row = [f64; MOST];

/// Terms of a cubic polynomial of two variables.
const TERMS: usize = 10;

/// Coefficients of a slope over the faults.
type Slope = [f64; TERMS];

/// Terms of a quadratic polynomial of two variables: the first of [`terms`].
const BEND_TERMS: usize = 6;

/// Coefficients of a bend over the faults.
type Bend = [f64; BEND_TERMS];

/// Samples for each coefficient, at least; with fewer no bends are fitted.
const SAMPLES_EACH: usize = 4;

/// Causes that act by themselves, at most.
const ACTING: usize = Cause::COUNT - 1;

/// Pairs of them, each with itself included.
const PAIRS: usize = ACTING * (ACTING + 1) / 2;

/// One number for each cause, from a file that may be of a version with fewer causes.
pub(crate) fn padded<'de, D: Deserializer<'de>>(d: D) -> Result<Deviations, D::Error> {
    let found = Vec::<f64>::deserialize(d)?;
    each_cause(&found).ok_or_else(|| D::Error::invalid_length(found.len(), &"one number for each cause"))
}

/// The same of slopes.
fn padded_slopes<'de, D: Deserializer<'de>>(d: D) -> Result<BTreeMap<String, [Slope; Cause::COUNT]>, D::Error> {
    let found = BTreeMap::<String, Vec<Slope>>::deserialize(d)?;
    let one = |(name, slopes): (String, Vec<Slope>)| {
        let n = slopes.len();
        let all = each_cause(&slopes).ok_or_else(|| D::Error::invalid_length(n, &"one slope for each cause"))?;
        Ok((name, all))
    };
    found.into_iter().map(one).collect()
}

/// What there is of the first causes, and nothing of those that came later.
fn each_cause<T: Copy + Default>(found: &[T]) -> Option<[T; Cause::COUNT]> {
    let mut all = [T::default(); Cause::COUNT];
    all.get_mut(..found.len())?.copy_from_slice(found);
    Some(all)
}

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
    /// ends of the range
    pub fsj: (f64, f64),
    /// ends of the range
    pub zeta: (f64, f64),
}

impl Scale {
    /// The same with the logarithm of FSJ: what errors are like changes most where friction is low.
    fn of_log(&self, fsj: f64, zeta: f64) -> (f64, f64) {
        const LEAST: f64 = 0.1;
        let log = |x: f64| x.max(LEAST).ln();
        let (lo, hi) = (log(self.fsj.0), log(self.fsj.1));
        ((2.0 * log(fsj) - lo - hi) / (hi - lo), self.of(fsj, zeta).1)
    }

    fn of(&self, fsj: f64, zeta: f64) -> (f64, f64) {
        let scaled = |x: f64, (lo, hi): (f64, f64)| (2.0 * x - lo - hi) / (hi - lo);
        (scaled(fsj, self.fsj), scaled(zeta, self.zeta))
    }
}

/// Responses of the features to the causes of a spread.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ResponseSurfaces {
    scale: Scale,
    /// by feature name: slope for each cause, in the feature's unit for a deviation of 1 (relative, rad)
    #[serde(deserialize_with = "padded_slopes")]
    slopes: BTreeMap<String, [Slope; Cause::COUNT]>,
    /// pairs of causes (numbers of [`Cause`]) whose product counts
    pairs: Vec<(usize, usize)>,
    /// by feature name: bend for each pair, in the feature's unit for deviations of 1
    bends: BTreeMap<String, Vec<Bend>>,
    /// by feature name: standard uncertainty of what slopes and bends leave, in the feature's unit
    pub remainder: BTreeMap<String, f64>,
    /// by feature name: share of the uncertainty that the map states which the units show; 1 where they show more
    #[serde(default)]
    shares: BTreeMap<String, f64>,
    /// by feature name: coefficients over the faults of the logarithm of the variance that the units show about slopes and
    /// bends, in the feature's unit; files of earlier versions have none
    #[serde(default)]
    scatter: BTreeMap<String, Slope>,
    /// correlation of that scatter for each two features, names in the order of `scatter`
    #[serde(default)]
    correlation: Vec<Vec<f64>>,
}

/// Mean of the logarithm of a chi-squared variable of one degree of freedom.
const LOG_CHI: f64 = -1.270_362_845_461_478;

/// Standard deviations beyond which a residual counts as so many (assumed).
const CLIPPED: f64 = 3.0;

/// Greatest factor by which scatter that is not normal may differ from what its logarithm says (assumed).
const UNLIKE: f64 = 30.0;

/// One simulated unit: its faults, deviations, and its features less the maps'.
pub struct Sample {
    /// of the unit
    pub fsj: f64,
    /// of the unit
    pub zeta: f64,
    /// of the unit, by cause
    pub deviations: Deviations,
    /// feature less map, and the uncertainty that the map already states
    pub residual: Vec<(Feature, f64, f64)>,
}

/// Pairs of 0 to n - 1, each with itself included.
pub(crate) fn all_pairs(n: usize) -> impl Iterator<Item = (usize, usize)> {
    (0..n).flat_map(move |i| (i..n).map(move |j| (i, j)))
}

/// Least squares of several features by the same rows.
pub(crate) struct Regression {
    design: DMatrix<f64>,
    solver: Cholesky<f64, Dyn>,
}

impl Regression {
    /// * `rows` one a sample, of equal length
    pub fn new(rows: &[Vec<f64>]) -> Self {
        let n = rows.first().map_or(0, Vec::len);
        let design = DMatrix::from_fn(rows.len(), n, |i, j| rows[i][j]);
        // causes that only act together (temperature alone) share their effect: a touch of ridge
        let mut normal = design.transpose() * &design;
        let ridge = 1e-9 * rows.len() as f64;
        (0..n).for_each(|i| normal[(i, i)] += ridge);
        let solver = normal.cholesky().expect("positive definite by the ridge");
        Self { design, solver }
    }

    /// Coefficients of a feature, and what they leave of it.
    ///
    /// * `values` one a sample
    pub fn fit(&self, values: impl Iterator<Item = f64>) -> (DVector<f64>, DVector<f64>) {
        let y = DVector::from_iterator(self.design.nrows(), values);
        let x = self.solver.solve(&(self.design.transpose() * &y));
        let left = y - &self.design * &x;
        (x, left)
    }
}

/// Value of a logarithm's coefficients at scaled faults, within the range that was fitted.
fn log_surface(log: &Slope, (w, v): (f64, f64)) -> f64 {
    let terms = terms(w.clamp(-1.0, 1.0), v.clamp(-1.0, 1.0));
    log.iter().zip(&terms).map(|(a, t)| a * t).sum()
}

/// Correlation of each two of series of equal length with mean 0; shrunk by what chance makes of so many.
fn correlations(series: &[Vec<f64>]) -> Vec<Vec<f64>> {
    let product = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
    let of = |(i, a): (usize, &Vec<f64>), (j, b): (usize, &Vec<f64>)| {
        let all = (product(a, a) * product(b, b)).sqrt().max(f64::MIN_POSITIVE);
        let shrunk = 1.0 - 1.0 / (a.len() as f64).max(2.0);
        if i == j { 1.0 } else { shrunk * product(a, b) / all }
    };
    let row = |a| series.iter().enumerate().map(|b| of(a, b)).collect();
    series.iter().enumerate().map(row).collect()
}

impl ResponseSurfaces {
    /// Fewest simulated units from which bends are fitted.
    ///
    /// * `causes` that act by themselves
    pub fn samples_of_bends(causes: usize) -> usize {
        SAMPLES_EACH * (causes * TERMS + all_pairs(causes).count() * BEND_TERMS)
    }

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
        let mut pairs: Vec<(usize, usize)> = all_pairs(acting.len()).collect();
        let straight = acting.len() * TERMS;
        if samples.len() < Self::samples_of_bends(acting.len()) {
            pairs.clear();
        }
        let row = |s: &Sample| {
            let (u, v) = scale.of(s.fsj, s.zeta);
            let terms = terms(u, v);
            let x: Vec<f64> = acting
                .iter()
                .zip(&size)
                .map(|(&c, size)| s.deviations[c] / size)
                .collect();
            let slopes = x.iter().flat_map(|x| terms.map(|t| t * x));
            let products = pairs.iter().map(|&(i, j)| x[i] * x[j]);
            let bends = products.flat_map(|xx| terms[..BEND_TERMS].iter().map(move |t| t * xx).collect::<Vec<_>>());
            slopes.chain(bends).collect::<Vec<f64>>()
        };
        let n = straight + pairs.len() * BEND_TERMS;
        let rows: Vec<Vec<f64>> = samples.iter().map(row).collect();
        let regression = Regression::new(&rows);
        let (mut slopes, mut bends) = (BTreeMap::new(), BTreeMap::new());
        let (mut remainder, mut shares) = (BTreeMap::new(), BTreeMap::new());
        let features = samples.first().map_or(&[][..], |s| &s.residual);
        let places: Vec<(f64, f64)> = samples.iter().map(|s| scale.of_log(s.fsj, s.zeta)).collect();
        let plain = |&(w, v): &(f64, f64)| terms(w, v).to_vec();
        let over_faults = Regression::new(&places.iter().map(plain).collect::<Vec<_>>());
        let (mut scatter, mut scaled) = (BTreeMap::new(), BTreeMap::new());
        for (k, (feature, _, _)) in features.iter().enumerate() {
            let (x, left) = regression.fit(samples.iter().map(|s| s.residual[k].1));
            let mut slope = [[0.0; TERMS]; Cause::COUNT];
            for (a, (&c, &size)) in acting.iter().zip(&size).enumerate() {
                slope[c] = std::array::from_fn(|t| x[a * TERMS + t] / size);
            }
            let bend = |(k, &(i, j)): (usize, &(usize, usize))| -> Bend {
                std::array::from_fn(|t| x[straight + k * BEND_TERMS + t] / (size[i] * size[j]))
            };
            bends.insert(feature.name().to_string(), pairs.iter().enumerate().map(bend).collect());
            let stated = samples.iter().map(|s| s.residual[k].2.powi(2)).sum::<f64>();
            let free = (samples.len() as f64 - n as f64).max(1.0);
            let (shown, stated) = (left.norm_squared() / free, stated / samples.len() as f64);
            let share = if stated > 0.0 {
                (shown / stated).min(1.0).sqrt()
            } else {
                1.0
            };
            shares.insert(feature.name().to_string(), share);
            let variance = (shown - stated).max(0.0);
            // few coefficients follow nothing of the scatter, many some of it
            let lost = samples.len() as f64 / free;
            let size = |left: f64| (lost * left * left).max(1e-12 * shown).max(f64::MIN_POSITIVE);
            let (log, _) = over_faults.fit(left.iter().map(|l| size(*l).ln() - LOG_CHI));
            let log: Slope = std::array::from_fn(|t| log[t]);
            // what the logarithm's mean makes of scatter that is not normal
            let part = |(l, place): (&f64, &(f64, f64))| lost * l * l / log_surface(&log, *place).exp();
            let whole = left.iter().zip(&places).map(part).sum::<f64>() / samples.len() as f64;
            let mut log = log;
            log[0] += whole.clamp(1.0 / UNLIKE, UNLIKE).ln();
            let one = |(l, place): (&f64, &(f64, f64))| {
                let sd = (0.5 * log_surface(&log, *place)).exp();
                (l / sd).clamp(-CLIPPED, CLIPPED)
            };
            // maps that state nothing were not measured: what they say stands
            if stated > 0.0 {
                let name = feature.name().to_string();
                scaled.insert(name.clone(), left.iter().zip(&places).map(one).collect::<Vec<f64>>());
                scatter.insert(name, log);
            }
            slopes.insert(feature.name().to_string(), slope);
            remainder.insert(feature.name().to_string(), variance.sqrt());
        }
        Self {
            scale,
            slopes,
            pairs: pairs.iter().map(|&(i, j)| (acting[i], acting[j])).collect(),
            bends,
            remainder,
            shares,
            scatter,
            correlation: correlations(&scaled.into_values().collect::<Vec<_>>()),
        }
    }

    /// Variance of a feature of units about slopes and bends at a fault pair, maps and sensors included [square of its
    /// unit]; `None` where it was not fitted.
    pub fn scatter(&self, feature: Feature, fsj: f64, zeta: f64) -> Option<f64> {
        let log = self.scatter.get(feature.name())?;
        Some(log_surface(log, self.scale.of_log(fsj, zeta)).exp())
    }

    /// Correlation of that scatter between features, 1 of each with itself and 0 where it was not fitted.
    pub fn correlation(&self, features: &[Feature]) -> [Row; MOST] {
        let place = |f: &Feature| self.scatter.keys().position(|name| name == f.name());
        let mut out = [[0.0; MOST]; MOST];
        for (i, a) in features.iter().enumerate().take(MOST) {
            for (j, b) in features.iter().enumerate().take(MOST) {
                let both = place(a).zip(place(b)).filter(|_| i != j);
                let found = both.and_then(|(a, b)| self.correlation.get(a)?.get(b).copied());
                out[i][j] = if i == j { 1.0 } else { found.unwrap_or(0.0) };
            }
        }
        out
    }

    /// Share of the uncertainty that the map of a feature states which simulated units show: leave-one-out
    /// errors overstate it where one point scatters as much as the next.
    pub fn share(&self, feature: Feature) -> f64 {
        self.shares.get(feature.name()).copied().unwrap_or(1.0)
    }

    /// Whether there is a slope for this cause, or for what it acts through.
    pub fn knows(&self, cause: Cause) -> bool {
        let acts = |c: Cause| self.slopes.values().any(|s| s[c as usize].iter().any(|x| *x != 0.0));
        cause.acts_through(0.0).into_iter().all(|(c, x)| x == 0.0 || acts(c))
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

    /// Prepared for quick evaluation.
    ///
    /// * `unknown` causes and their standard deviations
    /// * `known` causes and their deviations
    pub fn prepared(&self, features: &[Feature], unknown: &[(Cause, f64)], known: &[(Cause, f64)]) -> PreparedSurfaces {
        self.prepared_factors(features, &Factors::independent(&Spread::none(), unknown, known))
    }

    /// Prepared for quick evaluation, where what is not known of the causes goes together.
    pub fn prepared_factors(&self, features: &[Feature], factors: &Factors) -> PreparedSurfaces {
        let acting: Vec<usize> = (0..Cause::COUNT)
            .filter(|&c| self.slopes.values().any(|s| s[c].iter().any(|x| *x != 0.0)))
            .take(ACTING)
            .collect();
        let place = |c: usize| acting.iter().position(|&a| a == c);
        let of_acting = |x: &Deviations| {
            let mut row = [0.0; ACTING];
            row.iter_mut().zip(&acting).for_each(|(r, &c)| *r = x[c]);
            row
        };
        let mut slopes = vec![[[0.0; MOST]; TERMS]; acting.len()];
        let mut bends = vec![(0, 0, [[0.0; MOST]; BEND_TERMS]); self.pairs.len()];
        for (k, f) in features.iter().enumerate() {
            if let Some(s) = self.slopes.get(f.name()) {
                for (rows, &c) in slopes.iter_mut().zip(&acting) {
                    rows.iter_mut().zip(s[c]).for_each(|(row, x)| row[k] = x);
                }
            }
            if let Some(b) = self.bends.get(f.name()) {
                for ((i, j, rows), (pair, bend)) in bends.iter_mut().zip(self.pairs.iter().zip(b)) {
                    (*i, *j) = (place(pair.0).unwrap_or(0), place(pair.1).unwrap_or(0));
                    rows.iter_mut().zip(bend).for_each(|(row, x)| row[k] = *x);
                }
            }
        }
        bends.truncate(PAIRS);
        PreparedSurfaces {
            scale: self.scale,
            slopes,
            bends,
            unknown: factors.each.iter().map(|(_, x)| of_acting(x)).collect(),
            known: of_acting(&factors.middle),
            offset: factors.discrepancies(features).0,
        }
    }
}

/// Sum over what a cause acts through.
fn through(cause: Cause, of: impl Fn(Cause) -> f64) -> f64 {
    cause.acts_through(0.0).into_iter().map(|(c, x)| x * of(c)).sum()
}

/// Where the unknown causes are thought to lie, in their standard deviations.
pub type Guess = [f64; Cause::COUNT];

/// Response surfaces with the features side by side.
#[derive(Clone, Debug)]
pub struct PreparedSurfaces {
    scale: Scale,
    /// of what acts by itself
    slopes: Vec<[Row; TERMS]>,
    bends: Vec<(usize, usize, [Row; BEND_TERMS])>,
    /// what one standard deviation of each unknown cause makes of that
    unknown: Vec<[f64; ACTING]>,
    /// what the known ones make of it
    known: [f64; ACTING],
    /// what is added whatever the causes
    offset: Row,
}

/// Response surfaces at one fault pair, made straight about a guess of the causes.
#[derive(Clone, Copy, Debug)]
pub struct Straight {
    /// change of the features for one standard deviation of each unknown cause
    pub slopes: [Row; Cause::COUNT],
    /// how many of `slopes` count
    pub causes: usize,
    /// what is to be added to that: what is known, and the bends
    pub shift: Row,
}

impl PreparedSurfaces {
    /// At a fault pair, about a guess.
    pub fn at(&self, fsj: f64, zeta: f64, guess: &Guess) -> Straight {
        let (u, v) = self.scale.of(fsj, zeta);
        let terms = terms(u, v);
        let mut x = self.known;
        for (row, t) in self.unknown.iter().zip(guess) {
            x.iter_mut().zip(row).for_each(|(x, a)| *x += a * t);
        }
        let add = |to: &mut Row, factor: f64, row: &Row| to.iter_mut().zip(row).for_each(|(o, r)| *o += factor * r);
        let mut value = self.offset;
        let mut by = [[0.0; MOST]; ACTING];
        for (k, rows) in self.slopes.iter().enumerate() {
            for (row, t) in rows.iter().zip(terms) {
                add(&mut by[k], t, row);
            }
            let straight = by[k];
            add(&mut value, x[k], &straight);
        }
        for (i, j, rows) in &self.bends {
            let mut bend = [0.0; MOST];
            for (row, t) in rows.iter().zip(terms) {
                add(&mut bend, t, row);
            }
            add(&mut value, x[*i] * x[*j], &bend);
            add(&mut by[*i], x[*j], &bend);
            add(&mut by[*j], x[*i], &bend);
        }
        let mut out = Straight {
            slopes: [[0.0; MOST]; Cause::COUNT],
            causes: self.unknown.len(),
            shift: value,
        };
        for ((slope, row), t) in out.slopes.iter_mut().zip(&self.unknown).zip(guess) {
            for (a, by) in row.iter().zip(&by) {
                add(slope, *a, by);
            }
            let whole = *slope;
            add(&mut out.shift, -t, &whole);
        }
        out
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
                let (r, v) = (
                    deviations[Cause::Resistance as usize],
                    deviations[Cause::Supply as usize],
                );
                let y = slope(fsj, zeta) * r + 30.0 * r * r - 2.0 * v;
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
            let prepared = s.prepared(&[Feature::P2], &[(Cause::Resistance, 0.05)], &[]);
            let straight = prepared.at(f, z, &[0.0; Cause::COUNT]);
            assert!((straight.slopes[0][0] - 0.05 * at(Cause::Resistance)).abs() < 1e-12);
            assert_eq!((straight.causes, straight.shift[0]), (1, 0.0));
            // about any guess the straight line touches the bent surface: 30 x^2 here
            let mut guess = [0.0; Cause::COUNT];
            guess[0] = 0.4;
            let x = 0.4 * 0.05;
            let about = prepared.at(f, z, &guess);
            let touched = about.shift[0] + 0.4 * about.slopes[0][0];
            assert!((touched - (slope(f, z) * x + 30.0 * x * x)).abs() < 1e-4, "{touched}");
            assert!((about.slopes[0][0] - 0.05 * (slope(f, z) + 60.0 * x)).abs() < 1e-4);
            let known = s.prepared(&[Feature::P2], &[], &[(Cause::Supply, 0.01)]);
            let shift = known.at(f, z, &[0.0; Cause::COUNT]).shift[0];
            assert!((shift + 0.02).abs() < 1e-4, "{shift}");
        }
        assert!(s.knows(Cause::Resistance) && !s.knows(Cause::Inertia) && !s.knows(Cause::Temperature));
        assert!(s.remainder["p2"] < 1e-5, "{:?}", s.remainder);
    }
}
