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

pub use baseline::{Baseline, Expected};
pub use constants::{Constants, Learnt};
pub use file::{KindEntry, TestEntry, UnitFile};

use crate::calibration::Calibration;
use crate::diagnosis::{Diagnoser, Known};
use crate::failure_map::FailureMapSet;
use schemas::error::{Error, Result, write_whole};
use schemas::feature::Features;
use serde::{Deserialize, Serialize};
use std::path::Path;

/// Share of simulated units whose healthy tests are refused although nothing is wrong with them.
const REFUSED: f64 = 0.002;

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
            c.misfits = s.misfits.clone();
            c.deviations = s.deviations.clone();
        }
        c
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

    /// Constants after healthy tests.
    ///
    /// # Errors
    /// The misfit over the number of features, and the greatest that is allowed, where the tests contradict the
    /// constants.
    pub fn healthy(&self, prior: &Constants, tests: &[Features]) -> std::result::Result<Learnt, (f64, f64)> {
        let learnt = prior.after_healthy(&self.baseline, tests);
        let gate = self.healthy_gate(tests.len());
        if learnt.misfit > gate {
            return Err((learnt.misfit, gate));
        }
        Ok(learnt)
    }

    /// Writes it as one JSON object, whole or not at all.
    ///
    /// # Errors
    /// Fails where the file cannot be written.
    pub fn save(&self, path: &Path) -> Result<()> {
        write_whole(path, serde_json::to_string(self).expect("plain data").as_bytes())
    }

    /// Reads a saved one.
    ///
    /// * `maps` fingerprint of the maps that it must belong to
    /// * `prior` fingerprint of the constants
    ///
    /// # Errors
    /// Refuses what cannot be read, is torn, or belongs to other maps or constants.
    pub fn load(path: &Path, maps: &str, prior: &str) -> Result<Self> {
        let text = std::fs::read_to_string(path).map_err(|e| Error::io(path, "cannot be read", e))?;
        let c: Self = serde_json::from_str(&text).map_err(|e| Error::torn(path, e))?;
        if c.common.maps != maps || c.prior != prior {
            let found = format!("{} {}", c.common.maps, c.prior);
            let allowed = format!("{maps} {prior}");
            return Err(Error::bad(path.display().to_string(), "fingerprints", found, allowed));
        }
        Ok(c)
    }
}
