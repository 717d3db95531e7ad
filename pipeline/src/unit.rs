//! Units with a history: the campaign of simulated units behind their intervals, and what a recording adds.

use crate::COMMIT;
use crate::calibrate::{Unit, draw_units, measure, range, score_all, scores, surfaces};
use crate::case::{self, Settings};
use crate::input;
use crate::maps::{self, MapRequest};
use crate::progress::note;
use anyhow::Result;
use diagnoser::calibration::{COVERAGE, Calibration, uncalibrated};
use diagnoser::diagnosis::{Diagnoser, Known, Outcome};
use diagnoser::failure_map::FailureMapSet;
use diagnoser::map_library::rounded_rest_angle;
use diagnoser::uncertainty::{Deviations, deviations};
use diagnoser::unit::{BASELINES, Baseline, Constants, KindEntry, Stratum, TestEntry, UnitCalibration, UnitFile};
use nalgebra::DMatrix;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use schemas::error::Error;
use schemas::fault::FaultState;
use schemas::feature::{Feature, Features};
use sim_worker::parameters::ActuatorParameters;
use sim_worker::setup::TestSetup;
use sim_worker::spread::{Cause, Spread};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// What a campaign of simulated units costs.
#[derive(Clone, Copy, Debug)]
pub struct UnitEffort {
    /// tests at random faults that the response to the constants comes from
    pub surface: usize,
    /// healthy tests that the baseline comes from
    pub baseline: usize,
    /// units that are given a history
    pub units: usize,
    /// tests at random faults of each
    pub tests: usize,
    /// of the draws
    pub seed: u64,
}

impl UnitEffort {
    /// What units are calibrated with on first use.
    pub const QUICK: Self = Self {
        surface: 1024,
        baseline: 320,
        units: 160,
        tests: 13,
        seed: 0,
    };
}

/// Numbers of healthy tests that simulated units have.
const HISTORIES: [usize; 2] = [1, 3];

/// Maps for a test of a unit and what simulated units say of them, from the cache or made on first use.
///
/// # Errors
/// As [`maps::made`]; making them may be interrupted ([`crate::Interrupted`]).
pub fn ready(request: &MapRequest, unit: &UnitFile) -> Result<(FailureMapSet, UnitCalibration)> {
    let dir = maps::cached_in(request)?;
    let set = maps::made(&dir, request)?;
    let prior = unit.prior();
    let (file, kept) = kept(&dir, &set, &prior);
    if let Some(c) = kept {
        return Ok((set, c));
    }
    let effort = UnitEffort::QUICK;
    let runs = effort.surface + effort.baseline + effort.units * (effort.tests + HISTORIES[HISTORIES.len() - 1]);
    note(&format!("simulating units like this one ({runs} runs, once)"));
    let made = calibrate(&set, &request.setup, &prior, effort)?.ok_or(crate::Interrupted)?;
    made.save(&file)?;
    Ok((set, made))
}

/// File beside maps for what simulated units of a prior say of them, and what it holds, if it can be used.
fn kept(dir: &Path, set: &FailureMapSet, prior: &Constants) -> (PathBuf, Option<UnitCalibration>) {
    let own = prior.fingerprint();
    let file = dir.join(format!("unit-{own}.json"));
    let kept = UnitCalibration::load(&file, &set.fingerprint(), &own).ok();
    (file, kept)
}

/// The same from the cache; `None` where either is not there.
///
/// # Errors
/// Refuses a grid that makes no maps, and what [`UnitCalibration::diagnoser`] refuses.
pub fn found(request: &MapRequest, unit: &UnitFile, coverage: f64) -> Result<Option<Diagnoser>> {
    let dir = maps::cached_in(request)?;
    let Ok(set) = FailureMapSet::load(&maps::cache_file(request)?) else {
        return Ok(None);
    };
    let ready = |c: UnitCalibration| c.diagnoser(set.clone(), &unit.constants, unit.healthy(), coverage, &Vec::new());
    Ok(kept(&dir, &set, &unit.prior()).1.map(ready).transpose()?)
}

/// Unit files of a folder by the names of their actuators, or one file.
///
/// # Errors
/// Refuses a folder without any, a file in it that ends in `.json` and is none, and two of one actuator.
pub fn folder(path: &Path) -> Result<BTreeMap<String, Arc<UnitFile>>> {
    let mut files = vec![path.to_path_buf()];
    if path.is_dir() {
        let list = std::fs::read_dir(path).map_err(|e| Error::io(path, "cannot be read", e))?;
        files = list.filter_map(|e| Some(e.ok()?.path())).collect();
        files.retain(|f| f.extension().is_some_and(|e| e == "json"));
        files.sort();
    }
    let mut units: BTreeMap<String, (PathBuf, Arc<UnitFile>)> = BTreeMap::new();
    for file in files {
        let unit = UnitFile::load(&file)?;
        if let Some((other, _)) = units.get(&unit.name) {
            let allowed = format!("one file an actuator: {} is of it too", other.display());
            return Err(Error::bad(file.display().to_string(), "name", unit.name, allowed).into());
        }
        units.insert(unit.name.clone(), (file, Arc::new(unit)));
    }
    if units.is_empty() {
        let allowed = "unit files (ema unit new), called .json";
        return Err(Error::bad(path.display().to_string(), "folder", "none", allowed).into());
    }
    Ok(units.into_iter().map(|(name, (_, unit))| (name, unit)).collect())
}

/// A unit of the prior, as shares of the half-widths of its spread.
///
/// * `root` of the prior: [`Constants::root`]
fn draw_unit(
    prior: &Constants,
    root: &DMatrix<f64>,
    half_width: &[f64; Cause::COUNT],
    rng: &mut ChaCha8Rng,
) -> [f64; Cause::COUNT] {
    let end = 3f64.sqrt();
    let t: Vec<f64> = prior.causes.iter().map(|_| rng.random_range(-end..end)).collect();
    let mut draw = [0.0; Cause::COUNT];
    for (i, c) in prior.causes.iter().enumerate() {
        let x: f64 = (0..=i).map(|k| root[(i, k)] * t[k]).sum();
        let h = half_width[*c as usize];
        draw[*c as usize] = if h > 0.0 {
            (c.of_counted(x) / h).clamp(-1.0, 1.0)
        } else {
            0.0
        };
    }
    draw
}

/// A test of a unit: what is of a test is another one in each.
///
/// * `own` constants of the unit, as shares of the half-widths of its spread
/// * `fault` drawn after what is of the test
pub fn draw_test(
    prior: &Constants,
    own: [f64; Cause::COUNT],
    rng: &mut ChaCha8Rng,
    fault: impl FnOnce(&mut ChaCha8Rng) -> FaultState,
) -> Unit {
    let mut draw = own;
    for (c, _) in &prior.of_test {
        draw[*c as usize] = rng.random_range(-1.0..1.0);
    }
    Unit {
        fault: fault(rng),
        draw,
        seed: rng.random(),
    }
}

/// Simulates units of a prior and their tests. `Ok(None)` where it was interrupted.
///
/// # Errors
/// As [`measure`], and refuses maps that a diagnoser refuses.
pub fn calibrate(
    set: &FailureMapSet,
    setup: &TestSetup,
    prior: &Constants,
    effort: UnitEffort,
) -> Result<Option<UnitCalibration>> {
    let spread = prior.spread();
    let (fsj, zeta) = range(set);
    // draws of the parts never meet, nor those of other campaigns
    let seeds = [0x51u64, 0x52, 0x53].map(|kind| effort.seed.wrapping_mul(2).wrapping_add(kind << 48));
    let surface = draw_units(fsj, zeta, &spread, effort.surface, seeds[0]);
    let Some(surface_raw) = measure(setup, &spread, &surface, "response to the constants")? else {
        return Ok(None);
    };
    let mut healthy = draw_units(fsj, zeta, &spread, effort.baseline, seeds[1]);
    healthy.iter_mut().for_each(|u| u.fault = FaultState::NOMINAL);
    let Some(healthy_raw) = measure(setup, &spread, &healthy, "healthy units")? else {
        return Ok(None);
    };
    // units with a history: healthy tests first
    let first = HISTORIES[HISTORIES.len() - 1];
    let each = first + effort.tests;
    let mut rng = ChaCha8Rng::seed_from_u64(seeds[2]);
    let root = prior.root();
    let mut tests: Vec<Unit> = Vec::with_capacity(effort.units * each);
    for _ in 0..effort.units {
        let own = draw_unit(prior, &root, &spread.half_width, &mut rng);
        for k in 0..each {
            let anywhere = |rng: &mut ChaCha8Rng| {
                let (f, z) = (rng.random_range(fsj.0..fsj.1), rng.random_range(zeta.0..zeta.1));
                if k < first {
                    FaultState::NOMINAL
                } else {
                    FaultState { fsj: f, zeta: z }
                }
            };
            tests.push(draw_test(prior, own, &mut rng, anywhere));
        }
    }
    let Some(raw) = measure(setup, &spread, &tests, "units with a history")? else {
        return Ok(None);
    };

    let kinds: Vec<(Feature, f64)> = set
        .joint_of_unit()
        // break-away comes in whole samples, also where all simulated units have the same
        .map(|m| (m.feature, m.budget.measurement()))
        .chain(set.witnesses.iter().map(|w| (w.feature, w.budget.noise)))
        .collect();
    let sample = |(u, raw): (&Unit, _)| -> Option<(Deviations, Vec<f64>)> {
        let features = set.features(raw);
        let values = kinds.iter().map(|(f, _)| features.get(*f).filter(|x| x.is_finite()));
        Some((deviations(&spread, &u.draw), values.collect::<Option<Vec<f64>>>()?))
    };
    let samples: Vec<_> = healthy.iter().zip(&healthy_raw).filter_map(sample).collect();
    let mut common = Calibration {
        spread: spread.name.clone(),
        half_width: spread.half_width,
        friction_per_k: spread.friction_per_k,
        runs: effort.units * effort.tests,
        surface_runs: effort.surface,
        seed: effort.seed,
        maps: set.fingerprint(),
        commit: COMMIT.into(),
        scores: Default::default(),
        misfits: vec![uncalibrated(COVERAGE).1],
        deviations: Vec::new(),
        strips: Vec::new(),
        kinetic: Vec::new(),
        surfaces: surfaces(&Diagnoser::bare_of_unit(set.clone()), &spread, &surface, &surface_raw),
    };
    let mut baseline = Baseline::fit(&kinds, &samples);
    let of_unit = |k: usize| (&tests[k * each..(k + 1) * each], &raw[k * each..(k + 1) * each]);
    let healthy_of = |k: usize| {
        of_unit(k).0[..first]
            .iter()
            .zip(&of_unit(k).1[..first])
            .filter_map(sample)
    };
    baseline.scatter(&(0..effort.units).map(|k| healthy_of(k).collect()).collect::<Vec<_>>());
    let diagnoser = Diagnoser::with_factors(set.clone(), common.clone(), COVERAGE, &prior.factors(&Vec::new()))?;
    let features = |k: usize, n: usize| {
        of_unit(k).1[..n]
            .iter()
            .map(|r| set.features(r))
            .collect::<Vec<Features>>()
    };
    let histories: Vec<usize> = std::iter::once(0).chain(HISTORIES).collect();
    let mut strata = Vec::new();
    for h in histories {
        let one = |k: usize| {
            let learnt = (h > 0).then(|| prior.after_healthy(&baseline, &features(k, h), &[]));
            let constants = learnt.as_ref().map_or(prior, |l| &l.constants);
            let d = diagnoser.again_with(&constants.factors(&Vec::new()));
            let (units, raw) = of_unit(k);
            (scores(&d, &units[first..], &raw[first..]), learnt.map(|l| l.misfit))
        };
        let all: Vec<_> = (0..effort.units).into_par_iter().map(one).collect();
        let mut healthy_misfits: Vec<f64> = all.iter().filter_map(|a| a.1).collect();
        healthy_misfits.sort_by(f64::total_cmp);
        let mut of = common.clone();
        let flat: Vec<_> = all.into_iter().flat_map(|a| a.0).collect();
        score_all(&mut of, &flat);
        if h == 0 {
            common = of;
        } else {
            strata.push(Stratum {
                healthy: h,
                scores: of.scores,
                misfits: of.misfits,
                deviations: of.deviations,
                healthy_misfits,
            });
        }
    }
    Ok(Some(UnitCalibration {
        common,
        baseline,
        strata,
        prior: prior.fingerprint(),
    }))
}

/// Maps made ready for a test of a unit.
///
/// * `known` of the test, given the rest angle of the maps
///
/// # Errors
/// As [`ready`].
pub fn diagnoser(setup: &TestSetup, settings: &Settings, unit: &UnitFile, known: &Known) -> Result<Diagnoser> {
    made(&request(setup, settings), unit, settings.choice.coverage, known)
}

/// The same from a request.
///
/// # Errors
/// As [`ready`].
pub fn made(request: &MapRequest, unit: &UnitFile, coverage: f64, known: &Known) -> Result<Diagnoser> {
    let (set, calibration) = ready(request, unit)?;
    Ok(calibration.diagnoser(set, &unit.constants, unit.healthy(), coverage, known)?)
}

fn request(setup: &TestSetup, settings: &Settings) -> MapRequest {
    MapRequest {
        setup: TestSetup {
            rest_angle_rad: rounded_rest_angle(setup.rest_angle_rad),
            load_n_m: 0.0,
            ..setup.clone()
        },
        grid: settings.grid.clone(),
    }
}

/// What a unit is of, where no file says it.
pub(crate) const REFERENCE: &str = "the reference actuator (values assumed)";

/// What a unit begins with.
pub struct Beginning {
    /// its type, and where that is from; the reference if `None`
    pub actuator: Option<(ActuatorParameters, String)>,
    /// folder of a study of this unit: the model is the one that it wrote
    pub study: Option<PathBuf>,
    /// how units of the type and their tests differ where no study says it
    pub spread: Spread,
    /// what it is called; the name of its file if `None`
    pub name: Option<String>,
}

/// Writes the file of a new unit.
///
/// # Errors
/// Refuses a file that is there already, a study that wrote no model or is of another machine than the one that is named.
pub fn begin(file: &Path, with: Beginning) -> Result<UnitFile> {
    if file.exists() {
        let file = file.display().to_string();
        return Err(Error::bad(file, "file", "there already", "a file that is not there yet").into());
    }
    let (actuator, source) = match &with.study {
        Some(dir) => {
            let model = dir.join("actuator.toml");
            if !model.exists() {
                let allowed =
                    "a study that wrote a model (ema discrepancy --healthy --out); without one leave --study out";
                return Err(Error::bad(model.display().to_string(), "file", "nothing", allowed).into());
            }
            let studied = ActuatorParameters::read(&model)?;
            same_machine(&model, &studied, with.actuator.as_ref().map(|a| &a.0))?;
            (studied, model.display().to_string())
        }
        None => with
            .actuator
            .unwrap_or_else(|| (ActuatorParameters::reference(), REFERENCE.into())),
    };
    let stem = || {
        file.file_stem()
            .map_or_else(|| "unit".into(), |s| s.to_string_lossy().into_owned())
    };
    let unit = UnitFile::new(with.name.unwrap_or_else(stem), source, actuator, with.spread);
    unit.save(file)?;
    Ok(unit)
}

/// Refuses a study of another machine than the one that was named: what no study changes is the same in both.
fn same_machine(file: &Path, studied: &ActuatorParameters, named: Option<&ActuatorParameters>) -> Result<()> {
    let Some(named) = named else { return Ok(()) };
    let fixed = |a: &ActuatorParameters| [f64::from(a.pole_pairs), a.gear_ratio];
    for (place, (found, allowed)) in ["pole pairs", "gear ratio"]
        .into_iter()
        .zip(fixed(studied).into_iter().zip(fixed(named)))
    {
        if found != allowed {
            let allowed = format!("{allowed}, of the actuator that --actuator names");
            return Err(Error::bad(file.display().to_string(), place, found, allowed).into());
        }
    }
    Ok(())
}

/// Constants: cause, deviation and standard deviation now, standard deviation before any test.
pub(crate) fn constants(unit: &UnitFile) -> Vec<(Cause, f64, f64, f64)> {
    let prior = unit.prior();
    let one = |c: &Cause| {
        let (mean, sd) = unit.constants.of(*c)?;
        Some((*c, c.of_counted(mean), sd, prior.of(*c)?.1))
    };
    unit.constants.causes.iter().filter_map(one).collect()
}

/// Keys of `ema unit show --json`.
pub fn to_json(unit: &UnitFile) -> serde_json::Value {
    let constant = |(c, mean, sd, before): (Cause, f64, f64, f64)| serde_json::json!({"cause": c.key(), "deviation": mean, "sigma": sd, "sigma_before": before});
    let test = |t: &diagnoser::unit::TestEntry| {
        let interval =
            |i: Option<(f64, f64, f64)>| i.map(|(lo, e, hi)| serde_json::json!({"lo": lo, "estimate": e, "hi": hi}));
        serde_json::json!({
            "file": t.file, "healthy": t.healthy, "taken": t.is_taken(), "outcome": t.outcome, "reason": t.reason,
            "fsj": interval(t.fsj), "zeta": interval(t.zeta), "checksum": t.checksum, "commit": t.commit,
        })
    };
    let last = unit.tests.iter().rev().find(|t| t.fsj.is_some());
    serde_json::json!({
        "name": unit.name,
        "model": unit.source,
        "tests": unit.taken(),
        "healthy_tests": unit.healthy(),
        "reference": unit.reference(),
        "constants": constants(unit).into_iter().map(constant).collect::<Vec<_>>(),
        "present": last.map(test),
        "history": unit.tests.iter().map(test).collect::<Vec<_>>(),
    })
}

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

    /// Those of all tests that a unit knows.
    fn all(&mut self, unit: &UnitFile, settings: &Settings) -> Result<()> {
        for kind in &unit.kinds {
            let setup = kind.setup("unit file", Arc::new(unit.actuator.clone()))?;
            self.of(&request(&setup, settings), unit)?;
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
        actuator: Some(Arc::new(unit.actuator.clone())),
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
    let request = request(&test.setup, &settings);
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
    };
    if !unit.kinds.iter().any(|k| k.kind == kind) {
        unit.kinds.push(own);
    }
    if healthy {
        // with those of its kind that are known already; the constants are made anew from all
        let mut all: Vec<Features> = healthy_of(unit, &kind);
        all.push(features);
        let judged = calibration.healthy(&unit.prior(), &all).map(|_| false);
        // refused ones that agree with this one, and speak against the model together
        let refused = |t: &TestEntry| t.healthy && !t.is_taken() && t.kind == kind;
        let judged = judged.or_else(|e| {
            all.extend(unit.tests.iter().filter(|t| refused(t)).map(TestEntry::features));
            calibration.healthy(&unit.prior(), &all).map(|_| true).map_err(|_| e)
        });
        match judged {
            Ok(false) => {}
            Ok(true) => {
                for t in unit.tests.iter_mut().filter(|t| refused(t)) {
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
        kinds.all(unit, &settings)?;
        relearn(unit, kinds)?;
        return Ok(Shown::Taken);
    }
    let d = calibration.diagnoser(
        set.clone(),
        &unit.constants,
        unit.healthy(),
        settings.choice.coverage,
        &Vec::new(),
    )?;
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

fn healthy_of(unit: &UnitFile, kind: &str) -> Vec<Features> {
    let of_kind = unit
        .tests
        .iter()
        .filter(|t| t.healthy && t.is_taken() && t.kind == kind);
    of_kind.map(TestEntry::features).collect()
}

/// The constants anew, from all tests: healthy ones first, then the others in their order.
fn relearn(unit: &mut UnitFile, kinds: &mut Kinds) -> Result<()> {
    let mut constants = unit.prior();
    let mut seen: Vec<&str> = Vec::new();
    for t in unit.tests.iter().filter(|t| t.healthy && t.is_taken()) {
        if seen.contains(&t.kind.as_str()) {
            continue;
        }
        seen.push(&t.kind);
        let Some((_, _, calibration)) = kinds.0.iter().find(|k| k.0 == t.kind) else {
            continue;
        };
        // of another kind than those before, and at odds with them: the first kind counts
        if let Ok(c) = calibration.healthy(&constants, &healthy_of(unit, &t.kind)) {
            constants = c;
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
