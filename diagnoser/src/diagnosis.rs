//! From features to fault intervals: the set of fault pairs that all maps agree on.
//!
//! Every map states by how much a feature may differ from it: a standard uncertainty from a budget
//! ([`crate::failure_map::MapBudget`]), and, where units differ, what all features share of a common
//! cause ([`crate::uncertainty`]). The misfit of a fault pair is `Q = r^T C^-1 r`, r the measured
//! features less the maps', C their covariance. The pairs with `Q <= Q_min + reach^2` are enclosed from
//! within and from without ([`crate::paving`]); the reach is calibrated ([`crate::calibration`]).
//! All of them lie inside every single map's band of half-width `sqrt(Q_min + reach^2)` standard
//! uncertainties: these bands are the paper's (5.1).

mod outcome;
mod why;

pub use crate::calibration::COVERAGE;
use crate::calibration::{Calibration, WITNESS_GATE, uncalibrated};
use crate::curves::Cut;
use crate::estimate::{CovarianceParts, Estimate, Estimator};
use crate::failure_map::{FailureMap, FailureMapSet};
use crate::map_library::checked_coverage;
use crate::paving::{Goal, Paver};
use crate::uncertainty::{Factors, MOST, Row};
use nalgebra::{DMatrix, DVector};
pub use outcome::{Area, Diagnosis, Kinetic, Outcome};
use schemas::error::{Error, Result};
use schemas::fault::Interval;
use schemas::feature::{Feature, Features};
use sim_worker::spread::of_uniform;
pub use sim_worker::spread::{Known, parse_known};

/// How a test of known faults came out.
#[derive(Clone, Copy, Debug)]
pub struct Score {
    /// how far its area must reach so that the intervals hold the true pair, in standard uncertainties
    pub reach: f64,
    /// `Q` of the best pair
    pub misfit: f64,
    /// greatest deviation of a witness, in standard uncertainties
    pub deviation: f64,
    /// quadrant of the fault range that the estimate lies in
    pub quadrant: usize,
    /// of the estimate
    pub fsj: f64,
}

/// One actuator's maps made ready to diagnose: prepared once, then a diagnosis takes microseconds.
#[derive(Clone, Debug)]
pub struct Diagnoser {
    /// what it diagnoses by
    pub maps: FailureMapSet,
    /// how far its areas reach, and what units differ by; none: one known unit, an assumed reach
    pub calibration: Option<Calibration>,
    coverage: f64,
    estimator: Estimator,
    /// by quadrant
    reach: [f64; 4],
    /// upper end of each strip of FSJ and the reach there, where there are strips
    reaches: Vec<(f64, f64)>,
    gate: f64,
    witness_gate: f64,
    /// how far the interval of the kinetic factor reaches, where units differ in it
    kinetic_reach: Option<f64>,
    /// why nothing that the maps agree on is to be believed of the unit
    distrust: Option<String>,
}

impl Diagnoser {
    /// Maps made ready, for a coverage.
    ///
    /// * `coverage` wanted, above 0 and below 1
    /// * `known` of the unit: refused where the calibration has no response to that cause
    ///
    /// # Errors
    /// Refuses a coverage outside 0 to 1, a set with too many maps, and a known cause without response.
    pub fn new(maps: FailureMapSet, calibration: Option<Calibration>, coverage: f64, known: &Known) -> Result<Self> {
        checked_coverage(coverage)?;
        maps.check("maps")?;
        let surfaces = calibration.as_ref().and_then(|c| c.surfaces.as_ref());
        if let Some((cause, _)) = known.iter().find(|(c, _)| !surfaces.is_some_and(|s| s.knows(*c))) {
            let allowed = format!(
                "a calibration with a spread that has `{}` (ema calibrate --spread)",
                cause.key()
            );
            return Err(Error::bad("command line", "--known", cause.known_key(), allowed));
        }
        let estimator = Estimator::new(&maps, calibration.as_ref(), known);
        Ok(Self::of(maps, calibration, coverage, estimator))
    }

    /// Maps made ready for a unit of which more is known than how units differ.
    ///
    /// * `calibration` of units of which as much is known
    /// * `factors` what is known
    ///
    /// # Errors
    /// Refuses a coverage outside 0 to 1, and a set with too many maps.
    pub fn with_factors(
        maps: FailureMapSet,
        calibration: Calibration,
        coverage: f64,
        factors: &Factors,
    ) -> Result<Self> {
        checked_coverage(coverage)?;
        maps.check("maps")?;
        let estimator = Estimator::of_unit(&maps, Some(&calibration), Some(factors));
        Ok(Self::of(maps, Some(calibration), coverage, estimator))
    }

    /// The same maps and calibration, where something else is known of the unit.
    #[must_use]
    pub fn again_with(&self, factors: &Factors) -> Self {
        let mut other = self.clone();
        other.estimator.know(self.calibration.as_ref(), factors);
        other
    }

    fn of(maps: FailureMapSet, calibration: Option<Calibration>, coverage: f64, estimator: Estimator) -> Self {
        let (reach, gate) = match &calibration {
            Some(c) => (std::array::from_fn(|q| c.reach(coverage, q)), c.gate()),
            None => {
                let (reach, gate) = uncalibrated(coverage);
                ([reach; 4], gate)
            }
        };
        let kinetic_reach = calibration.as_ref().and_then(|c| c.kinetic_reach(coverage));
        let reaches = calibration.as_ref().map_or(Vec::new(), |c| c.reaches(coverage));
        let witness_gate = calibration.as_ref().map_or(WITNESS_GATE, Calibration::witness_gate);
        Self {
            maps,
            calibration,
            coverage,
            estimator,
            reach,
            reaches,
            gate,
            witness_gate,
            kinetic_reach,
            distrust: None,
        }
    }

    /// The same for a unit that its model is known not to describe: it locates nothing, and says why.
    #[must_use]
    pub fn distrusted(self, distrust: Option<String>) -> Self {
        Self { distrust, ..self }
    }

    /// Whether nothing that its maps agree on is to be believed.
    pub fn is_distrusted(&self) -> bool {
        self.distrust.is_some()
    }

    /// Uncalibrated, for 95 %.
    ///
    /// # Panics
    /// A set that [`FailureMapSet::check`] refuses, which is neither made nor loaded.
    pub fn uncalibrated(maps: FailureMapSet) -> Self {
        Self::new(maps, None, COVERAGE, &Vec::new()).expect("no more maps than can be inverted")
    }

    /// Uncalibrated, by the maps of units too.
    ///
    /// # Panics
    /// As [`Diagnoser::uncalibrated`].
    pub fn bare_of_unit(maps: FailureMapSet) -> Self {
        maps.check("maps").expect("no more maps than can be inverted");
        let estimator = Estimator::of_unit(&maps, None, None);
        Self::of(maps, None, COVERAGE, estimator)
    }

    /// Features that are inverted together: [`FailureMapSet::joint`].
    pub fn joint_features(&self) -> &[Feature] {
        self.estimator.features()
    }

    /// The maps that have a say in its diagnoses, and those that these make up: those of units where a unit is known.
    pub fn shown_maps(&self) -> impl Iterator<Item = &FailureMap> {
        let joint = self.estimator.features();
        let of_others = move |m: &&FailureMap| !Feature::OF_UNITS.contains(&m.feature) || joint.contains(&m.feature);
        self.maps.maps.iter().filter(of_others)
    }

    /// Standard uncertainty of a feature at a fault pair, the unit's spread included.
    pub fn uncertainty(&self, feature: Feature, fsj: f64, zeta: f64) -> Option<f64> {
        let map = self.maps.map(feature)?;
        let own = |f: Feature| self.estimator.uncertainty(f, fsj, zeta);
        let of_parts = || {
            let [a, b] = feature.parts()?;
            Some(own(a)?.hypot(own(b)?))
        };
        let joint = own(feature).or_else(of_parts);
        Some(joint.unwrap_or_else(|| map.uncertainty(fsj, zeta)))
    }

    /// What the standard uncertainty of a feature is made of at a fault pair: its parts, in words and the
    /// feature's unit. They add in squares, except that causes of a length add as those of its parts.
    pub fn budget(&self, feature: Feature, fsj: f64, zeta: f64) -> Vec<(String, f64)> {
        let Some(map) = self.maps.map(feature) else {
            return Vec::new();
        };
        let b = &map.budget;
        let surfaces = self.calibration.as_ref().and_then(|c| c.surfaces.as_ref());
        // what simulated units show of it
        let share = surfaces.map_or(1.0, |s| s.share(feature));
        let mut parts: Vec<(String, f64)> = vec![
            ("sensors".into(), share * b.noise),
            ("one sample".into(), of_uniform(share * b.sample)),
            ("interpolation and projection".into(), share * map.error_at(fsj, zeta)),
        ];
        if let Some((c, s)) = self.calibration.as_ref().and_then(|c| Some((c, c.surfaces.as_ref()?))) {
            for (cause, half) in c.spread().causes() {
                let at = |f: Feature| of_uniform(half) * s.slope(&[f], cause, fsj, zeta)[0].abs();
                let u = match feature.parts() {
                    Some([a, b]) => at(a).hypot(at(b)),
                    None => at(feature),
                };
                parts.push((cause.title().into(), u));
            }
            let left = s.remainder.get(feature.name()).copied().unwrap_or(0.0);
            parts.push(("bend of the response".into(), left));
            // as the units show at these faults; what it is made of, as on the whole
            if let Some(scatter) = s.scatter(feature, fsj, zeta) {
                let last = parts.len() - 1;
                let own = |k: &usize| *k < 3 || *k == last;
                let stated: f64 = (0..=last).filter(own).map(|k| parts[k].1.powi(2)).sum();
                let factor = (scatter / stated.max(f64::MIN_POSITIVE)).sqrt();
                (0..=last).filter(own).for_each(|k| parts[k].1 *= factor);
            }
        }
        parts.retain(|(_, u)| *u > 0.0);
        parts
    }

    /// What a test at faults that nobody knows says of the factors of the causes ([`Factors`]): their mean and
    /// covariance after it, where they had mean 0 and standard deviation 1 before. `None` where a feature is missing.
    ///
    /// * `wider` factor on the variances of what maps and sensors err by
    pub fn factors_given(&self, features: &Features, wider: f64) -> Option<(DVector<f64>, DMatrix<f64>)> {
        let values = self.whole(features)?;
        let best = self.estimator.best(&values, self.gate)?;
        Some(self.estimator.factors_given(&values, &best, wider))
    }

    /// The joint features of a test that lacks none but what says a cause.
    fn whole(&self, features: &Features) -> Option<Row> {
        let values = self.row(features);
        let there = |(f, v): (&Feature, &f64)| v.is_finite() || Feature::CAUSES.contains(f);
        self.estimator
            .features()
            .iter()
            .zip(&values)
            .all(there)
            .then_some(values)
    }

    /// Covariance of the joint features at a fault pair, by its parts.
    pub fn covariance_parts(&self, fsj: f64, zeta: f64) -> CovarianceParts {
        self.estimator.covariance_parts(fsj, zeta)
    }

    /// Share of tests whose true pair the intervals are to hold.
    pub fn coverage(&self) -> f64 {
        self.coverage
    }

    /// How far areas reach, in standard uncertainties, where the estimate is in the middle of a quadrant.
    pub fn reach(&self, quadrant: usize) -> f64 {
        let limits = self.estimator.limits();
        let middle = |(lo, hi): (f64, f64), upper: usize| lo + (0.25 + 0.5 * upper as f64) * (hi - lo);
        self.reach_at(middle(limits.f, quadrant % 2), middle(limits.z, quadrant / 2))
    }

    /// How far areas reach, in standard uncertainties, where the estimate is at a fault pair.
    pub fn reach_at(&self, fsj: f64, zeta: f64) -> f64 {
        let strip = self.reaches.iter().find(|(end, _)| fsj <= *end).or(self.reaches.last());
        strip.map_or_else(|| self.reach[self.estimator.quadrant(fsj, zeta)], |(_, reach)| *reach)
    }

    /// The paper's cut of a map: half-widths of `band` standard uncertainties.
    pub fn cut<'a>(&self, map: &'a FailureMap, value: f64, band: f64) -> Cut<'a> {
        let points = map.zeta.iter().flat_map(|&z| map.fsj.iter().map(move |&f| (f, z)));
        let half = |(f, z)| band * self.uncertainty(map.feature, f, z).expect("a map of this set");
        Cut {
            map,
            value,
            half_width: points.map(half).collect(),
        }
    }

    /// Half-width of bands, in standard uncertainties, where nothing was located.
    pub fn usual_band(&self) -> f64 {
        let strips = self.reaches.iter().map(|r| r.1);
        let all: &[f64] = if self.reaches.is_empty() { &self.reach } else { &[] };
        strips.chain(all.iter().copied()).fold(0.0, f64::max)
    }

    /// The fault pairs that the features allow.
    ///
    /// * `features` measured, over the maps' nominal run
    /// * `missing` what the telemetry lacks, in words; empty if nothing
    pub fn diagnose(&self, features: &Features, missing: &[String]) -> Diagnosis {
        let (mut misfit, mut kinetic) = (None, None);
        let outcome = self.outcome(features, missing, &mut misfit, &mut kinetic);
        let outcome = self.doubted(outcome, &mut kinetic);
        Diagnosis {
            outcome,
            kinetic,
            features: *features,
            coverage: self.coverage,
            calibrated: self.calibration.is_some(),
            misfit: misfit.map(|q| (q, self.gate)),
        }
    }

    fn kinetic(&self, values: &Row, best: &Estimate) -> Option<Kinetic> {
        let reach = self.kinetic_reach?;
        let (estimate, sd) = self.estimator.kinetic(values, best)?;
        let interval = Interval {
            lo: estimate - reach * sd,
            hi: estimate + reach * sd,
        };
        Some(Kinetic { interval, estimate })
    }

    /// How far the kinetic factor of a test lies from its estimate, in standard uncertainties; `None` where units do not
    /// differ in it.
    pub fn kinetic_score(&self, features: &Features, truth: f64) -> Option<f64> {
        let values = self.whole(features)?;
        let best = self.estimator.best(&values, self.gate)?;
        let (estimate, sd) = self.estimator.kinetic(&values, &best)?;
        Some((truth - estimate).abs() / sd)
    }

    /// The joint features of a test; not a number where one is missing.
    fn row(&self, features: &Features) -> Row {
        let mut values: Row = [f64::NAN; MOST];
        for (v, f) in values.iter_mut().zip(self.estimator.features()) {
            *v = features.get(*f).unwrap_or(f64::NAN);
        }
        values
    }

    fn outcome(
        &self,
        features: &Features,
        missing: &[String],
        misfit: &mut Option<f64>,
        kinetic: &mut Option<Kinetic>,
    ) -> Outcome {
        let joint = self.estimator.features();
        let values = self.row(features);
        let known = values.iter().filter(|v| v.is_finite()).count();
        // a test may lack what says a cause: then it is as unknown as without
        let unsaid = |(f, v): (&Feature, &f64)| Feature::CAUSES.contains(f) && v.is_nan();
        let unsaid = joint.iter().zip(&values).filter(|x| unsaid(*x)).count();
        let whole = known + unsaid == joint.len() && missing.is_empty();
        if !whole || known < 2 {
            let mut lacking: Vec<String> = missing.to_vec();
            let maps = self.shown_maps().map(|m| m.feature);
            let (mut absent, mut odd) = (Vec::new(), Vec::new());
            for f in maps {
                match features.get(f) {
                    None if Feature::CAUSES.contains(&f) => {}
                    None => absent.push(f.name()),
                    Some(v) if !v.is_finite() => odd.push(format!("{} is {v}", f.name())),
                    _ => {}
                }
            }
            lacking.extend(odd);
            if lacking.is_empty() && !absent.is_empty() {
                lacking.push(format!("no value of {}", absent.join(", ")));
            }
            if lacking.is_empty() {
                lacking.push(format!("{known} map(s); a diagnosis needs at least two"));
            }
            let reason = lacking.join("; ");
            let area = (known >= 2).then(|| self.area(&values, misfit)).flatten();
            return Outcome::Incomplete { reason, area };
        }
        let gate = if unsaid == 0 { self.gate } else { self.gate_of(&values) };
        let best = self.estimator.best(&values, gate);
        *misfit = best.as_ref().map(|b| b.misfit);
        if let Some(best) = best.filter(|b| b.misfit <= gate) {
            if let Some(outcome) = self.overruled(&values, features, &best) {
                return outcome;
            }
            return match self.area_about(&values, &best) {
                Some(area) => {
                    *kinetic = self.kinetic(&values, &best);
                    Outcome::Located(area)
                }
                None => self.outside(&best),
            };
        }
        self.nowhere(&values, *misfit)
    }

    /// The area of the pairs that fit, within the maps; `None` if there is none.
    fn area(&self, values: &Row, misfit: &mut Option<f64>) -> Option<Area> {
        let best = self.estimator.best(values, self.gate)?;
        *misfit = Some(best.misfit);
        if best.misfit > self.gate_of(values) {
            return None;
        }
        self.area_about(values, &best)
    }

    fn area_about(&self, values: &Row, best: &Estimate) -> Option<Area> {
        let reach = self.reach_at(best.fsj, best.zeta);
        let (joint, limits) = self.estimator.confidence_set(values, best, reach);
        let any = [(f64::NEG_INFINITY, f64::INFINITY); MOST];
        let paving = Paver::new().pave(self.estimator.lattice(), &joint, &any, &limits, &Goal::default())?;
        Some(Area::of(paving, (best.misfit + reach * reach).sqrt()))
    }

    /// The gate for the features that are there: with fewer, less misfit is to be expected.
    fn gate_of(&self, values: &Row) -> f64 {
        let all = self.estimator.features().len();
        let here = values.iter().filter(|v| v.is_finite()).count();
        // of as many squares as there are features beyond the two faults, at least one
        self.gate * (here.max(3) - 2) as f64 / (all.max(3) - 2) as f64
    }

    /// What calibration needs of a test whose true pair is known. `None` where a feature is missing.
    pub fn score(&self, features: &Features, fsj: f64, zeta: f64) -> Option<Score> {
        let values = self.whole(features)?;
        let best = self.estimator.best(&values, self.gate)?;
        let profile = self.estimator.profile(&values, &best, fsj, zeta);
        let witnesses = self.estimator.witnesses(&values, features, &best);
        Some(Score {
            reach: (profile - best.misfit).max(0.0).sqrt(),
            misfit: best.misfit,
            deviation: witnesses.iter().fold(0.0, |a, w| a.max(w.3.abs())),
            quadrant: self.estimator.quadrant(best.fsj, best.zeta),
            fsj: best.fsj,
        })
    }

    /// Features that the maps predict at a pair, the joint ones and the witnesses: feature, value, stated
    /// uncertainty.
    pub fn predicted(&self, fsj: f64, zeta: f64) -> Vec<(Feature, f64, f64)> {
        let at = self.estimator.lattice().at(fsj, zeta);
        let own = |f: &Feature| self.maps.map(*f).expect("of this set").uncertainty(fsj, zeta);
        let features = self.estimator.features().iter();
        let witness = |w: &FailureMap| (w.feature, w.witness_at(fsj, zeta), w.uncertainty(fsj, zeta));
        features
            .zip(at)
            .map(|(f, m)| (*f, m, own(f)))
            .chain(self.maps.witnesses.iter().map(witness))
            .collect()
    }
}
