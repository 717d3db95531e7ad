//! One unit with a history: what its own tests say of its constants, and diagnoses that know it.
//!
//! Units of one type differ ([`sim_worker::spread`]). A diagnosis that knows only the type pays for that with its
//! width; the unit's own healthy tests know better. [`Constants`] is the Gaussian posterior of what is constant in a
//! unit, given its tests; faults are then relative to the healthy unit: FSJ 1 is the friction that its healthy tests
//! had. [`UnitFile`] keeps it, with all tests that went in, and [`UnitCalibration`] says how far areas must reach for
//! a unit of which so many tests are known.

mod baseline;
mod constants;
mod file;
mod healthy;
mod repair;

pub use baseline::{Baseline, Expected};
pub use constants::Constants;
pub use file::{KindEntry, TestEntry, UnitFile};
pub use healthy::{HealthyTests, Learnt};
pub use repair::{Repair, RepairedPart};

use crate::calibration::Calibration;
use crate::diagnosis::{Diagnoser, Known};
use crate::failure_map::FailureMapSet;
use crate::seal;
use crate::uncertainty::{Discrepancy, ResponseSurfaces};
use schemas::error::{Error, Result, write_whole};
use schemas::feature::{Feature, Features};
use serde::{Deserialize, Serialize};
use std::path::Path;

/// Share of simulated units whose healthy tests are refused although nothing is wrong with them.
const REFUSED: f64 = 0.002;

/// Fewest healthy tests that can speak against their model.
pub const BASELINES: usize = 3;

/// Greatest disagreement of healthy tests among each other, over what scatters from test to test (assumed).
const AGREE: f64 = 3.0;

/// Deviation of a feature, in standard deviations of all that is known of a unit, from which on the model is wrong in it.
const BEYOND: f64 = 3.0;

/// Deviation from which on the model misses an effect, which a shift of one feature cannot stand for (assumed: a sagging
/// supply moved the healthy rise time by 40, and located intervals off the truth once the rise time was set aside).
const MISSING: f64 = 10.0;

/// How often what the model may be wrong by is widened.
const WIDENINGS: usize = 8;

/// What is left of the features in which a model is wrong.
fn discrepancy(learnt: &Learnt, wider: &[(Feature, f64)]) -> Vec<Discrepancy> {
    let of = |f: Feature| learnt.left.iter().find(|l| l.0 == f).map_or(0.0, |l| l.1);
    let one = |&(feature, _): &(Feature, f64)| Discrepancy {
        feature,
        shift: of(feature),
        // as much again at other faults (assumed)
        uncertainty: of(feature).abs(),
    };
    wider.iter().map(one).collect()
}

/// Scores of simulated units of which a number of healthy tests is known.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Stratum {
    /// healthy tests of each unit
    pub healthy: usize,
    /// as [`Calibration::scores`]
    pub scores: [Vec<f64>; 4],
    /// as [`Calibration::misfits`]
    pub misfits: Vec<f64>,
    /// as [`Calibration::deviations`]
    pub deviations: Vec<f64>,
    /// misfits of the healthy tests themselves, over the number of their features, rising
    pub healthy_misfits: Vec<f64>,
}

/// What simulated units of one model say: the response of tests to the constants, and how far areas must reach.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct UnitCalibration {
    /// of units of which no test is known
    pub common: Calibration,
    /// what a healthy test gives
    pub baseline: Baseline,
    /// by number of healthy tests, rising
    pub strata: Vec<Stratum>,
    /// of the constants before any test
    pub prior: String,
}

impl UnitCalibration {
    fn stratum(&self, healthy: usize) -> Option<&Stratum> {
        self.strata.iter().rev().find(|s| s.healthy <= healthy)
    }

    /// The calibration for a unit of which so many healthy tests are known.
    pub fn of(&self, healthy: usize) -> Calibration {
        let mut c = self.common.clone();
        if let Some(s) = self.stratum(healthy) {
            c.scores = s.scores.clone();
            c.strips.clear();
            c.misfits = s.misfits.clone();
            c.deviations = s.deviations.clone();
        }
        c
    }

    /// Whether it is of tests that are judged by the same features as these maps: only then it says how far their areas reach.
    pub fn is_of(&self, maps: &FailureMapSet) -> bool {
        self.baseline.features().eq(maps.judged_of_unit().map(|k| k.0))
    }

    /// The same for tests from another rest angle.
    ///
    /// * `surfaces`, `baseline` responses to the constants there; what scatters from test to test is this one's
    pub fn at(&self, maps: &FailureMapSet, surfaces: Option<ResponseSurfaces>, mut baseline: Baseline) -> Self {
        baseline.scatter_as(&self.baseline);
        let common = Calibration {
            maps: maps.fingerprint(),
            surfaces,
            ..self.common.clone()
        };
        Self {
            common,
            baseline,
            ..self.clone()
        }
    }

    /// Greatest misfit of healthy tests, over the number of their features, that they are taken with.
    pub fn healthy_gate(&self, healthy: usize) -> f64 {
        let Some(s) = self.stratum(healthy.max(1)).filter(|s| !s.healthy_misfits.is_empty()) else {
            return f64::INFINITY;
        };
        let n = s.healthy_misfits.len();
        // beyond what was simulated by half: a model is not the machine (assumed)
        1.5 * s.healthy_misfits[((1.0 - REFUSED) * (n - 1) as f64).ceil() as usize]
    }

    /// Maps made ready for a unit.
    ///
    /// * `known` of the test
    ///
    /// # Errors
    /// As [`Diagnoser::new`].
    pub fn diagnoser(
        &self,
        maps: FailureMapSet,
        constants: &Constants,
        healthy: usize,
        coverage: f64,
        known: &Known,
    ) -> Result<Diagnoser> {
        let factors = constants.factors(known);
        Diagnoser::with_factors(maps, self.of(healthy), coverage, &factors)
    }

    /// Maps made ready for a unit as its file knows it: of one that its own healthy tests contradict they locate nothing.
    ///
    /// # Errors
    /// As [`Diagnoser::new`].
    pub fn of_file(&self, maps: FailureMapSet, unit: &UnitFile, coverage: f64, known: &Known) -> Result<Diagnoser> {
        let d = self.diagnoser(maps, &unit.constants, unit.healthy(), coverage, known)?;
        Ok(d.distrusted(unit.contradicted()))
    }

    /// Writes it as one JSON object, whole or not at all.
    ///
    /// # Errors
    /// Fails where the file cannot be written.
    pub fn save(&self, path: &Path) -> Result<()> {
        let text = serde_json::to_string(self).expect("plain data");
        write_whole(path, seal::sealed(&text).as_bytes())
    }

    /// Reads a saved one.
    ///
    /// * `maps` fingerprint of the maps that it must belong to
    /// * `prior` fingerprint of the constants
    ///
    /// # Errors
    /// Refuses what cannot be read, is torn or changed, or belongs to other maps or constants.
    pub fn load(path: &Path, maps: &str, prior: &str) -> Result<Self> {
        let text = std::fs::read_to_string(path).map_err(|e| Error::io(path, "cannot be read", e))?;
        let c: Self = serde_json::from_str(&text).map_err(|e| Error::torn(path, e))?;
        if c.common.maps != maps || c.prior != prior {
            let found = format!("{} {}", c.common.maps, c.prior);
            let allowed = format!("{maps} {prior}");
            return Err(Error::bad(path.display().to_string(), "fingerprints", found, allowed));
        }
        seal::check(path, &text, "ema diagnose --unit")?;
        Ok(c)
    }
}

/// Constants of a unit after healthy tests, from one rest angle or several. Where they contradict the model, but not each
/// other, and there are at least [`BASELINES`] of them, the model is taken to be wrong in what is left of their features, if
/// that is not much.
///
/// * `tests` of each rest angle, with what simulated units of it say
///
/// # Errors
/// The misfit over the number of features, and the greatest that is allowed, where the tests contradict the constants.
pub fn after_healthy(
    prior: &Constants,
    tests: &[(&UnitCalibration, &[Features])],
) -> std::result::Result<Constants, (f64, f64)> {
    let groups: Vec<HealthyTests> = tests
        .iter()
        .map(|(c, features)| HealthyTests {
            baseline: &c.baseline,
            features,
        })
        .collect();
    let count = tests.iter().map(|t| t.1.len()).sum();
    let gate = tests.iter().map(|(c, _)| c.healthy_gate(count)).fold(0.0, f64::max);
    let mut learnt = prior.after_healthy(&groups, &[]);
    let refused = (learnt.misfit, gate);
    if learnt.misfit <= gate {
        return Ok(learnt.constants);
    }
    if count < BASELINES || healthy::disagreement(&groups) > AGREE {
        return Err(refused);
    }
    // the features that nothing known of the unit explains; then those that stand out, until the rest agree
    let mut wider = prior.beyond(&groups, BEYOND);
    if !prior.beyond(&groups, MISSING).is_empty() {
        // an effect is missing: what it does at other faults nobody knows
        return Err(refused);
    }
    if !wider.is_empty() {
        learnt = prior.after_healthy(&groups, &wider);
    }
    for _ in 0..WIDENINGS {
        if learnt.misfit <= gate {
            learnt.constants.discrepancy = discrepancy(&learnt, &wider);
            return Ok(learnt.constants);
        }
        let worst = learnt.left.iter().map(|l| l.2.abs()).fold(0.0, f64::max);
        for &(feature, value, sigmas) in learnt.left.iter().filter(|l| l.2.abs() >= 0.7 * worst) {
            let own = 2.0 * value.abs().max((value / sigmas).abs());
            match wider.iter_mut().find(|w| w.0 == feature) {
                Some(w) => w.1 = w.1.max(own),
                None => wider.push((feature, own)),
            }
        }
        learnt = prior.after_healthy(&groups, &wider);
    }
    Err(refused)
}
