//! What a recording adds to a unit.

use super::{ready, request};
use crate::COMMIT;
use crate::case::{self, Settings};
use crate::input;
use crate::maps::MapRequest;
use anyhow::Result;
use diagnoser::calibration::COVERAGE;
use diagnoser::diagnosis::Outcome;
use diagnoser::failure_map::FailureMapSet;
use diagnoser::unit::{BASELINES, Constants, KindEntry, TestEntry, UnitCalibration, UnitFile, after_healthy};
use schemas::error::Error;
use schemas::feature::Features;
use std::path::Path;
use std::sync::Arc;

/// What became of a recording that a unit was shown.
#[derive(Clone, Debug, PartialEq)]
pub enum Shown {
    /// it went in
    Taken,
    /// it went in before
    Again,
    /// it is kept in the file and changes nothing, for this reason
    Refused(String),
}

/// Kinds of tests whose maps are in use, so that they are read once.
#[derive(Default)]
pub struct Kinds(Vec<(String, FailureMapSet, UnitCalibration)>);

impl Kinds {
    fn of(&mut self, request: &MapRequest, unit: &UnitFile) -> Result<usize> {
        let kind = KindEntry::fingerprint_of(&request.setup);
        if let Some(k) = self.0.iter().position(|k| k.0 == kind) {
            return Ok(k);
        }
        let (set, calibration) = ready(request, unit)?;
        self.0.push((kind, set, calibration));
        Ok(self.0.len() - 1)
    }

    /// Healthy tests of a unit that differ from a kind in the rest angle alone, by place of their maps.
    fn healthy(&self, unit: &UnitFile, kind: &str, counts: impl Fn(&TestEntry) -> bool) -> Vec<(usize, Vec<Features>)> {
        let mut all = Vec::new();
        for k in unit.alike(kind) {
            let of_kind = unit
                .tests
                .iter()
                .filter(|t| t.healthy && t.kind == k && unit.is_present(t) && counts(t));
            let features: Vec<Features> = of_kind.map(TestEntry::features).collect();
            let place = self.0.iter().position(|own| own.0 == k);
            all.extend(place.filter(|_| !features.is_empty()).map(|p| (p, features)));
        }
        all
    }

    /// Adds a test to those of its maps.
    fn with(all: &mut Vec<(usize, Vec<Features>)>, place: usize, features: &Features) {
        match all.iter_mut().find(|a| a.0 == place) {
            Some(a) => a.1.push(*features),
            None => all.push((place, vec![*features])),
        }
    }

    /// As [`after_healthy`].
    fn learnt(&self, prior: &Constants, tests: &[(usize, Vec<Features>)]) -> Result<Constants, (f64, f64)> {
        let of_maps: Vec<_> = tests
            .iter()
            .map(|(place, f)| (&self.0[*place].2, f.as_slice()))
            .collect();
        after_healthy(prior, &of_maps)
    }

    /// Those of all tests that a unit knows.
    fn all(&mut self, unit: &UnitFile, settings: &Settings) -> Result<()> {
        let counts = |k: &&KindEntry| unit.tests.iter().any(|t| t.kind == k.kind && unit.is_present(t));
        for kind in unit.kinds.iter().filter(counts) {
            let setup = kind.setup("unit file", Arc::new(unit.actuator.clone()))?;
            self.of(&request(&setup, settings.grid.clone()), unit)?;
        }
        Ok(())
    }
}

/// Shows a recording to a unit. What it says goes into the constants; a test that contradicts the unit changes nothing.
///
/// * `healthy` the unit was healthy in it
///
/// # Errors
/// As [`case::run`], and refuses a recording that lacks features where it is to be healthy.
pub fn show(unit: &mut UnitFile, path: &Path, healthy: bool, settings: &Settings, kinds: &mut Kinds) -> Result<Shown> {
    let bytes = std::fs::read(path).map_err(|e| Error::io(path, "cannot be read", e))?;
    let checksum = blake3::hash(&bytes).to_hex().to_string();
    if unit.tests.iter().any(|t| t.checksum == checksum && t.is_taken()) {
        return Ok(Shown::Again);
    }
    unit.tests.retain(|t| t.checksum != checksum);
    let measured = input::open(path, settings.how())?;
    let settings = Settings {
        unit: Some(Arc::new(unit.clone())),
        ..settings.clone()
    };
    let test = case::test_of(path, &measured, &settings)?;
    if !test.begins || !test.missing.is_empty() {
        let found = if test.begins {
            test.missing.join("; ")
        } else {
            "the first sample is missing".into()
        };
        return Err(Error::bad(
            path.display().to_string(),
            "recording",
            found,
            "a whole test: a unit learns from no other",
        )
        .into());
    }
    let request = request(&test.setup, settings.grid.clone());
    let place = kinds.of(&request, unit)?;
    let own = KindEntry::of(&request.setup);
    let kind = own.kind.clone();
    let (set, calibration) = (&kinds.0[place].1, &kinds.0[place].2);
    let features = set.features(&test.raw);
    let mut entry = TestEntry {
        file: path
            .file_name()
            .map_or_else(String::new, |n| n.to_string_lossy().into_owned()),
        checksum,
        healthy,
        outcome: "baseline".into(),
        reason: String::new(),
        kind: kind.clone(),
        fsj: None,
        zeta: None,
        features: TestEntry::named(&features),
        commit: COMMIT.into(),
        repairs: unit.repairs.len(),
    };
    if !unit.kinds.iter().any(|k| k.kind == kind) {
        unit.kinds.push(own);
    }
    if healthy {
        // with those that are known already, from whatever rest angle; the constants are made anew from all
        kinds.all(unit, &settings)?;
        let with_this = |counts: fn(&TestEntry) -> bool| {
            let mut all = kinds.healthy(unit, &kind, counts);
            Kinds::with(&mut all, place, &features);
            kinds.learnt(&unit.prior(), &all)
        };
        // refused ones may agree with this one, and speak against the model together
        let judged = with_this(TestEntry::is_taken).map(|_| false);
        let judged = judged.or_else(|e| with_this(|_| true).map(|_| true).map_err(|_| e));
        match judged {
            Ok(false) => {}
            Ok(true) => {
                let alike = unit.alike(&kind);
                let repairs = unit.repairs.len();
                let refused =
                    |t: &&mut TestEntry| t.healthy && !t.is_taken() && t.repairs == repairs && alike.contains(&t.kind);
                for t in unit.tests.iter_mut().filter(refused) {
                    (t.outcome, t.reason) = ("baseline".into(), String::new());
                }
            }
            Err((found, allowed)) => {
                entry.outcome = "unexplained".into();
                entry.reason = format!(
                    "as a healthy test it contradicts the unit (misfit {found:.1}, at most {allowed:.1}); the \
                     model may miss an effect (ema discrepancy), or, where {BASELINES} healthy tests agree with each other, be a \
                     little off"
                );
            }
        }
        let refused = entry.reason.clone();
        unit.tests.push(entry);
        if !refused.is_empty() {
            return Ok(Shown::Refused(refused));
        }
        relearn(unit, kinds)?;
        return Ok(Shown::Taken);
    }
    let d = calibration.of_file(set.clone(), unit, settings.choice.coverage, &Vec::new())?;
    let diagnosis = d.diagnose(&features, &[]);
    entry.outcome = diagnosis.outcome.name().into();
    entry.reason = diagnosis.outcome.reason().into();
    if let Outcome::Located(a) = &diagnosis.outcome {
        entry.fsj = Some((a.fsj.lo, a.centroid.0, a.fsj.hi));
        entry.zeta = Some((a.zeta.lo, a.centroid.1, a.zeta.hi));
        if unit.constants.learn_when_worn(unit.healthy())
            && let Some(c) = unit.constants.after_test(&d, &features, 1 + unit.worn().count())
        {
            unit.constants = c;
        }
    }
    let refused = entry.reason.clone();
    unit.tests.push(entry);
    Ok(if refused.is_empty() {
        Shown::Taken
    } else {
        Shown::Refused(refused)
    })
}

/// The constants anew, from all tests: healthy ones first, then the others in their order.
fn relearn(unit: &mut UnitFile, kinds: &Kinds) -> Result<()> {
    let mut constants = unit.prior();
    let mut seen: Vec<String> = Vec::new();
    let healthy = |t: &&TestEntry| t.healthy && t.is_taken() && unit.is_present(t);
    for t in unit.tests.iter().filter(healthy) {
        if seen.contains(&t.kind) {
            continue;
        }
        seen.extend(unit.alike(&t.kind));
        let tests = kinds.healthy(unit, &t.kind, TestEntry::is_taken);
        // of another test than those before, and at odds with them: the first counts
        match kinds.learnt(&constants, &tests) {
            Ok(c) => constants = c,
            // taken one angle at a time, by a version before: so they are learnt from
            Err(_) if tests.len() > 1 => {
                for of_angle in tests {
                    constants = kinds.learnt(&constants, &[of_angle]).unwrap_or(constants);
                }
            }
            Err(_) => {}
        }
    }
    if constants.learn_when_worn(unit.healthy()) {
        for (before, t) in unit.worn().enumerate() {
            let Some((_, set, calibration)) = kinds.0.iter().find(|k| k.0 == t.kind) else {
                continue;
            };
            let d = calibration.diagnoser(set.clone(), &constants, unit.healthy(), COVERAGE, &Vec::new())?;
            if let Some(c) = constants.after_test(&d, &t.features(), 1 + before) {
                constants = c;
            }
        }
    }
    unit.constants = constants;
    Ok(())
}
