//! The fault pair that fits best, and the set of those that fit nearly as well.

mod causes;
mod descent;

use crate::calibration::Calibration;
use crate::failure_map::{FailureMap, FailureMapSet};
use crate::paving::{Joint, Lattice, Limits};
use crate::uncertainty::{Factors, Guess, MOST, PreparedSurfaces, ResponseSurfaces, Row, Straight, log_kinetic};
use schemas::feature::{Feature, Features};
use sim_worker::spread::{Cause, Known};

/// Most lattice lines between two lines of the grid: what is bilinear between them departs from the monotone
/// cubic by a sixteenth of what it would on the grid itself.
const BETWEEN: usize = 4;

/// Lines of the lattice along an axis from which on there are fewer between: it should stay in the processor's
/// cache.
const LINES: usize = 140;

/// Share of the range by which maps go on straight beyond their ends: to see on which side faults lie.
const BEYOND: f64 = 0.5;

/// Uncertainty of what a map changes beyond its ends, as a share of the change (assumed).
const GUESSED: f64 = 0.1;

/// Causes before anything is known of them.
const NO_GUESS: Guess = [0.0; Cause::COUNT];

/// Ends of a uniform distribution in its standard deviations: sqrt(3).
const UNIFORM: f64 = 1.732_050_807_568_877_2;

/// Smallest uncertainty as a share of a map's range, so that nothing is divided by zero.
const FLOOR: f64 = 1e-7;

/// The fault pair that fits best.
#[derive(Clone, Debug)]
pub struct Estimate {
    /// may lie a little beyond the maps
    pub fsj: f64,
    /// as FSJ
    pub zeta: f64,
    /// squared residual in standard uncertainties
    pub misfit: f64,
    /// whitening: lower triangle, the inverse of the covariance's Cholesky factor; rows of missing
    /// features are zero
    whitening: [Row; MOST],
    /// what is known of the unit, and the bends of its response, move the features by this
    shift: Row,
    /// where the unknown causes are thought to lie
    guess: Guess,
}

/// A pair from which the search may start.
#[derive(Clone, Debug)]
struct Start {
    fsj: f64,
    zeta: f64,
    value: Row,
    /// one over variances: of the feature, and of what it changes on the way to the next start
    weight: Row,
}

/// Covariance of the joint features at a fault pair, by its parts, in their units.
#[derive(Clone, Debug)]
pub struct CovarianceParts {
    /// variance that a feature shares with no other
    pub own: Row,
    /// causes that are not known: change of each feature for one standard deviation of the cause
    pub common: Vec<(Cause, Row)>,
}

/// Maps and covariances of one actuator, made ready.
#[derive(Clone, Debug)]
pub struct Estimator {
    features: Vec<Feature>,
    lattice: Lattice,
    /// variance of each feature on the lattice's nodes without common causes
    variances: Vec<Row>,
    /// of what features err by, beside common causes
    correlation: [Row; MOST],
    /// response to common causes, known and unknown
    causes: Option<PreparedSurfaces>,
    /// which those are, in the same order
    unknown: Vec<Cause>,
    /// by how much dynamic friction of the unit, at the same FSJ, differs from the model's: what is known of it, and for one
    /// standard deviation of each unknown cause; logarithm of the factor
    kinetic: (f64, Vec<f64>),
    limits: Limits,
    starts: Vec<Start>,
    witnesses: Vec<FailureMap>,
    /// as `causes`, of the witnesses
    witness_causes: Option<PreparedSurfaces>,
    witness_remainder: Row,
    /// variances by which the unit differs from its model beyond any cause: joint features, witnesses
    discrepancy: (Row, Row),
}

impl Estimator {
    /// Makes a lattice of the joint maps, four times as fine as their grid, and the covariances on it.
    pub fn new(set: &FailureMapSet, calibration: Option<&Calibration>, known: &Known) -> Self {
        let factors = calibration.map(|c| Factors::of(&c.spread(), known));
        Self::of(set, set.joint().collect(), calibration, factors.as_ref())
    }

    /// The same for a unit, by the maps of units too.
    ///
    /// * `factors` what is known of it; none: nothing differs
    pub fn of_unit(set: &FailureMapSet, calibration: Option<&Calibration>, factors: Option<&Factors>) -> Self {
        Self::of(set, set.joint_of_unit().collect(), calibration, factors)
    }

    fn of(
        set: &FailureMapSet,
        maps: Vec<&FailureMap>,
        calibration: Option<&Calibration>,
        factors: Option<&Factors>,
    ) -> Self {
        let features: Vec<Feature> = maps.iter().map(|m| m.feature).collect();
        let first = maps[0];
        let ends = |x: &[f64]| (x[0], x[x.len() - 1]);
        let limits = Limits {
            f: ends(&first.fsj),
            z: ends(&first.zeta),
        };
        let wide: Vec<FailureMap> = maps.iter().map(|m| m.extended(BEYOND)).collect();
        let (fsj, zeta) = (finer(&wide[0].fsj), finer(&wide[0].zeta));
        let mut nodes = vec![[0.0; MOST]; fsj.len() * zeta.len()];
        let mut variances = vec![[1.0; MOST]; nodes.len()];
        let surfaces: Option<&ResponseSurfaces> = calibration.and_then(|c| c.surfaces.as_ref());
        for (k, m) in wide.iter().enumerate() {
            let (lo, hi) = m.range();
            let left = surfaces
                .and_then(|s| s.remainder.get(m.feature.name()))
                .map_or(0.0, |x| x * x);
            let share = surfaces.map_or(1.0, |s| s.share(m.feature));
            let least = (FLOOR * (hi - lo)).powi(2);
            for (r, &z) in zeta.iter().enumerate() {
                let curve = m.curve(z);
                for (c, &f) in fsj.iter().enumerate() {
                    let i = r * fsj.len() + c;
                    nodes[i][k] = m.on_curve(&curve, f);
                    // how a map goes on beyond its end is a guess
                    let within = |x: f64, (lo, hi): (f64, f64)| x.clamp(lo, hi);
                    let (f_in, z_in) = (within(f, limits.f), within(z, limits.z));
                    let guessed = GUESSED * (nodes[i][k] - m.at(f_in, z_in));
                    let guessed = if (f_in, z_in) == (f, z) { 0.0 } else { guessed * guessed };
                    let scatter = surfaces.and_then(|s| s.scatter(m.feature, f, z));
                    let scatter = scatter.unwrap_or_else(|| (share * m.uncertainty(f, z)).powi(2) + left);
                    variances[i][k] = scatter + least + guessed;
                }
            }
        }
        let mut directions = [(1.0, 1.0); MOST];
        directions.iter_mut().zip(&maps).for_each(|(d, m)| *d = m.direction);
        let lattice = Lattice::new(fsj, zeta, nodes, directions).expect("maps have rising axes and finite values");
        let witnesses = set.witnesses.clone();
        let witness_names: Vec<Feature> = witnesses.iter().map(|w| w.feature).collect();
        let mut witness_remainder = [0.0; MOST];
        for (r, f) in witness_remainder.iter_mut().zip(&witness_names) {
            *r = surfaces.and_then(|s| s.remainder.get(f.name())).copied().unwrap_or(0.0);
        }
        let mut estimator = Self {
            correlation: surfaces.map_or_else(unrelated, |s| s.correlation(&features)),
            features,
            lattice,
            variances,
            causes: None,
            unknown: Vec::new(),
            kinetic: (0.0, Vec::new()),
            limits,
            starts: Vec::new(),
            witnesses,
            witness_causes: None,
            witness_remainder,
            discrepancy: ([0.0; MOST], [0.0; MOST]),
        };
        match factors {
            Some(factors) if surfaces.is_some() => estimator.know(calibration, factors),
            _ => estimator.starts = estimator.make_starts(),
        }
        estimator
    }

    /// Takes something else for known of the causes.
    pub fn know(&mut self, calibration: Option<&Calibration>, factors: &Factors) {
        let surfaces = calibration.and_then(|c| c.surfaces.as_ref());
        let names: Vec<Feature> = self.witnesses.iter().map(|w| w.feature).collect();
        self.causes = surfaces.map(|s| s.prepared_factors(&self.features, factors));
        self.witness_causes = surfaces.map(|s| s.prepared_factors(&names, factors));
        self.unknown = factors.each.iter().map(|(c, _)| *c).collect();
        let each = factors.each.iter().map(|(_, x)| log_kinetic(x)).collect();
        self.kinetic = (log_kinetic(&factors.middle), each);
        self.discrepancy = (factors.discrepancies(&self.features).1, factors.discrepancies(&names).1);
        self.starts = self.make_starts();
    }

    /// The joint features, in the order of every [`Row`].
    pub fn features(&self) -> &[Feature] {
        &self.features
    }

    /// The joint maps between their grid points; places beyond the last feature are empty.
    pub fn lattice(&self) -> &Lattice {
        &self.lattice
    }

    /// The fault range of the maps.
    pub fn limits(&self) -> Limits {
        self.limits
    }

    /// FSJ above the middle + 2 x zeta above the middle.
    pub fn quadrant(&self, fsj: f64, zeta: f64) -> usize {
        let upper = |x: f64, (lo, hi): (f64, f64)| usize::from(x > 0.5 * (lo + hi));
        upper(fsj, self.limits.f) + 2 * upper(zeta, self.limits.z)
    }

    fn variance(&self, fsj: f64, zeta: f64) -> Row {
        let mut own = self.lattice.blend(&self.variances, fsj, zeta);
        own.iter_mut().zip(self.discrepancy.0).for_each(|(o, d)| *o += d);
        own
    }

    /// Response to the common causes, about a guess of them.
    fn straight(&self, fsj: f64, zeta: f64, guess: &Guess) -> Option<Straight> {
        Some(self.causes.as_ref()?.at(fsj, zeta, guess))
    }

    /// Standard uncertainty of a feature at a fault pair, common causes included.
    pub fn uncertainty(&self, feature: Feature, fsj: f64, zeta: f64) -> Option<f64> {
        let k = self.features.iter().position(|&f| f == feature)?;
        let common = common_variance(&self.straight(fsj, zeta, &NO_GUESS), k);
        Some((self.variance(fsj, zeta)[k] + common).sqrt())
    }

    /// What the covariance at a fault pair is made of: `C = diag(own) + sum of common common^T`.
    pub fn covariance_parts(&self, fsj: f64, zeta: f64) -> CovarianceParts {
        let straight = self.straight(fsj, zeta, &NO_GUESS);
        let rows = straight.iter().flat_map(|s| s.slopes[..s.causes].to_vec());
        CovarianceParts {
            own: self.variance(fsj, zeta),
            common: self.unknown.iter().copied().zip(rows).collect(),
        }
    }

    /// The inverse of the Cholesky factor of the covariance at a fault pair, of the features that are
    /// there.
    fn whitening(&self, values: &Row, fsj: f64, zeta: f64, common: &Option<Straight>) -> [Row; MOST] {
        let n = self.features.len();
        let mut c = [[0.0; MOST]; MOST];
        let variance = self.variance(fsj, zeta);
        let sd = variance.map(f64::sqrt);
        for i in 0..n {
            (0..i).for_each(|j| c[i][j] = self.correlation[i][j] * sd[i] * sd[j]);
            c[i][i] = variance[i];
        }
        for s in common.iter().flat_map(|s| &s.slopes[..s.causes]) {
            for i in 0..n {
                for j in 0..=i {
                    c[i][j] += s[i] * s[j];
                }
            }
        }
        let mut w = [[0.0; MOST]; MOST];
        // factor and its inverse row by row, passing over what is missing
        let mut l = [[0.0; MOST]; MOST];
        for i in (0..n).filter(|&i| values[i].is_finite()) {
            for j in (0..=i).filter(|&j| values[j].is_finite()) {
                let mut sum = c[i][j];
                for k in 0..j {
                    sum -= l[i][k] * l[j][k];
                }
                // the variances on the diagonal are there to keep it positive
                l[i][j] = if i == j { sum.max(1e-300).sqrt() } else { sum / l[j][j] };
            }
            w[i][i] = 1.0 / l[i][i];
            for j in 0..i {
                let mut sum = 0.0;
                for k in j..i {
                    sum -= l[i][k] * w[k][j];
                }
                w[i][j] = sum * w[i][i];
            }
        }
        w
    }

    /// Whitened residual at a pair with the covariance of an estimate.
    fn residual(&self, values: &Row, e: &Estimate, fsj: f64, zeta: f64) -> Row {
        self.whitened(values, e, &self.lattice.at(fsj, zeta))
    }

    fn whitened(&self, values: &Row, e: &Estimate, maps: &Row) -> Row {
        let mut r = [0.0; MOST];
        for k in 0..self.features.len() {
            if values[k].is_finite() {
                r[k] = values[k] - e.shift[k] - maps[k];
            }
        }
        apply(&e.whitening, &r)
    }

    /// How far each witness that is there lies from what it should be at the best pair, in standard
    /// uncertainties: sensors, the surface between its grid points, what the pair itself is uncertain by, and what the
    /// joint features leave open of the unit's spread. With what it is and what it should be.
    ///
    /// * `values` joint features that the pair is of
    pub fn witnesses(&self, values: &Row, features: &Features, best: &Estimate) -> Vec<(Feature, f64, f64, f64)> {
        let (fsj, zeta) = (best.fsj, best.zeta);
        let (_, by_f, by_z) = self.lattice.with_slopes(fsj, zeta);
        let (a, b) = (apply(&best.whitening, &by_f), apply(&best.whitening, &by_z));
        let dot = |x: &Row, y: &Row| x.iter().zip(y).map(|(x, y)| x * y).sum::<f64>();
        let (aa, ab, bb) = (dot(&a, &a), dot(&a, &b), dot(&b, &b));
        let det = (aa * bb - ab * ab).max(1e-300);
        // what the joint features say of the causes at this pair: S^T C^-1 r, and 1 - S^T C^-1 S is left
        let z = self.residual(values, best, fsj, zeta);
        let joint = self.straight(fsj, zeta, &best.guess);
        let mut said = [[0.0; MOST]; Cause::COUNT];
        if let Some(s) = &joint {
            for (g, slope) in said.iter_mut().zip(&s.slopes[..s.causes]) {
                *g = apply(&best.whitening, slope);
            }
        }
        let common = self.witness_causes.as_ref().map(|c| c.at(fsj, zeta, &best.guess));
        let one = |(k, w): (usize, &FailureMap)| {
            let found = features.get(w.feature).filter(|v| v.is_finite())?;
            let mut through = [0.0; MOST];
            for (g, s) in said.iter().zip(common.iter().flat_map(|s| &s.slopes[..s.causes])) {
                through.iter_mut().zip(g).for_each(|(t, g)| *t += s[k] * g);
            }
            let expected = w.witness_at(fsj, zeta) + common.map_or(0.0, |s| s.shift[k]) + dot(&through, &z);
            let (df, dz) = (
                1e-2 * (self.limits.f.1 - self.limits.f.0),
                1e-2 * (self.limits.z.1 - self.limits.z.0),
            );
            let slope_f =
                (w.witness_at(fsj + df, zeta) - w.witness_at(fsj - df, zeta)) / (2.0 * df) - dot(&through, &a);
            let slope_z =
                (w.witness_at(fsj, zeta + dz) - w.witness_at(fsj, zeta - dz)) / (2.0 * dz) - dot(&through, &b);
            let of_pair = (bb * slope_f * slope_f - 2.0 * ab * slope_f * slope_z + aa * slope_z * slope_z) / det;
            let of_causes = common_variance(&common, k) - dot(&through, &through);
            let own = w.uncertainty(fsj, zeta).powi(2) + self.witness_remainder[k].powi(2) + self.discrepancy.1[k];
            let least = least_uncertainty(w.feature);
            let u = (own + of_causes.max(0.0) + of_pair.max(0.0) + least * least).sqrt();
            Some((w.feature, found, expected, (found - expected) / u))
        };
        self.witnesses.iter().enumerate().filter_map(one).collect()
    }

    /// The set of pairs whose misfit is at most `reach^2` above that of the best pair, within the maps.
    pub fn confidence_set(&self, values: &Row, best: &Estimate, reach: f64) -> (Joint, Limits) {
        let threshold = best.misfit + reach * reach;
        let offset = self.whitened(values, best, &[0.0; MOST]);
        let joint = Joint {
            w: best.whitening,
            offset,
            threshold,
        };
        (joint, self.limits)
    }

    /// The smallest misfit, with the covariance of `best`, on the line of one fault through a pair and on
    /// that of the other; the greater of the two.
    pub fn profile(&self, values: &Row, best: &Estimate, fsj: f64, zeta: f64) -> f64 {
        let Limits { f, z } = self.limits;
        let along = |lines: &[f64], (lo, hi): (f64, f64), pair: &dyn Fn(f64) -> (f64, f64)| {
            let inner = lines.iter().copied().filter(|x| lo < *x && *x < hi);
            let stops = std::iter::once(lo).chain(inner).chain(std::iter::once(hi));
            let residuals = stops.map(|x| {
                let (f, z) = pair(x);
                self.residual(values, best, f, z)
            });
            let mut least = f64::INFINITY;
            let mut last: Option<Row> = None;
            for b in residuals {
                if let Some(a) = last {
                    least = least.min(nearest(&a, &b));
                }
                last = Some(b);
            }
            least
        };
        // between two lines of the lattice the residual changes straight
        let at_fsj = along(&self.lattice.zeta, z, &|x| (fsj, x));
        let at_zeta = along(&self.lattice.fsj, f, &|x| (x, zeta));
        at_fsj.max(at_zeta)
    }
}

/// Uncertainty that a witness has at least, whatever the sensors: below what files and sensors resolve. Recordings
/// without sensor noise would otherwise be refused for the rounding of their digits (all values assumed).
fn least_uncertainty(witness: Feature) -> f64 {
    match witness.unit() {
        // a count of a 16 bit resolver
        "rad" => 1e-4,
        // a milliampere; a thousandth of the current
        _ => 1e-3,
    }
}

/// No feature's error says anything of another's.
fn unrelated() -> [Row; MOST] {
    std::array::from_fn(|i| std::array::from_fn(|j| if i == j { 1.0 } else { 0.0 }))
}

/// Variance of feature `k` by common causes.
fn common_variance(common: &Option<Straight>, k: usize) -> f64 {
    let slopes = common.iter().flat_map(|s| &s.slopes[..s.causes]);
    slopes.map(|s| s[k] * s[k]).sum()
}

/// Smallest square of what lies straight between two vectors.
fn nearest(a: &Row, b: &Row) -> f64 {
    let (mut aa, mut ad, mut dd) = (0.0, 0.0, 0.0);
    for (a, b) in a.iter().zip(b) {
        let d = b - a;
        aa += a * a;
        ad += a * d;
        dd += d * d;
    }
    let t = if dd > 0.0 { (-ad / dd).clamp(0.0, 1.0) } else { 0.0 };
    aa + t * (2.0 * ad + t * dd)
}

/// Lower triangle times vector.
fn apply(w: &[Row; MOST], r: &Row) -> Row {
    let mut out = [0.0; MOST];
    for (o, row) in out.iter_mut().zip(w) {
        *o = row.iter().zip(r).map(|(w, r)| w * r).sum();
    }
    out
}

/// Lines of an axis and some between each two of them.
fn finer(axis: &[f64]) -> Vec<f64> {
    let n = (LINES / axis.len()).clamp(1, BETWEEN);
    let between = |w: &[f64]| {
        let (a, b) = (w[0], w[1]);
        (0..n).map(move |k| a + (b - a) * k as f64 / n as f64)
    };
    let mut lines: Vec<f64> = axis.windows(2).flat_map(between).collect();
    lines.extend(axis.last());
    lines
}
