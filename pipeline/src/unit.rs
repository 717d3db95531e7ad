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
use diagnoser::uncertainty::{Deviations, ResponseSurfaces, deviations};
use diagnoser::unit::{
    BASELINES, Baseline, Constants, HealthyTests, KindEntry, Stratum, TestEntry, UnitCalibration, UnitFile,
    after_healthy,
};
use nalgebra::DMatrix;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use schemas::error::Error;
use schemas::fault::{FaultGrid, FaultState};
use schemas::feature::{Feature, Features, RawFeatures};
use sim_worker::parameters::ActuatorParameters;
use sim_worker::setup::TestSetup;
use sim_worker::spread::{Cause, Spread};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// What a campaign of simulated units costs.
#[derive(Clone, Copy, Debug)]
pub struct UnitEffort {
    /// tests at random faults that the response to the constants comes from, at each rest angle; half of them where they
    /// would not do for its bends
    pub surface: usize,
    /// healthy tests that the baseline comes from, at each rest angle
    pub baseline: usize,
    /// units that are given a history, of all rest angles together
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
        baseline: 192,
        units: 160,
        tests: 13,
        seed: 0,
    };

    /// Tests that the response to the constants comes from.
    fn surface_of(&self, prior: &Constants) -> usize {
        let acting = prior.spread().causes().count();
        if ResponseSurfaces::samples_of_bends(acting) <= self.surface {
            self.surface
        } else {
            self.surface / 2
        }
    }

    /// Runs at a rest angle, and those of the units with a history.
    fn runs(&self, prior: &Constants) -> (usize, usize) {
        let each = self.tests + HISTORIES[HISTORIES.len() - 1];
        (self.surface_of(prior) + self.baseline, self.units * each)
    }
}

/// Numbers of healthy tests that simulated units have.
const HISTORIES: [usize; 2] = [1, 3];

/// Rest angles from which units with a history are simulated [rad] (assumed): how far areas must reach, in standard deviations,
/// is the same from all.
const ANGLES_RAD: [f64; 3] = [0.35, 2.6, 4.5];

/// Maps for a test of a unit and what simulated units say of them, from the cache or made on first use. How far areas must
/// reach is made once a unit, for all rest angles; maps and responses are each angle's own.
///
/// # Errors
/// As [`maps::made`]; making them may be interrupted ([`crate::Interrupted`]).
pub fn ready(request: &MapRequest, unit: &UnitFile) -> Result<(FailureMapSet, UnitCalibration)> {
    let dir = maps::cached_in(request)?;
    let set = maps::made(&dir, request)?;
    let prior = unit.prior();
    let (file, kept) = kept(&dir, &set, &prior, "unit");
    if let Some(c) = kept {
        return Ok((set, c));
    }
    let effort = UnitEffort::QUICK;
    let runs = effort.runs(&prior);
    let reach = reach(request, &prior, effort)?.filter(|r| r.is_of(&set));
    let Some(reach) = reach else {
        // another choice of features than elsewhere: what is known of it is known here alone
        note(&format!(
            "simulating units like this one ({} runs, once)",
            runs.0 + runs.1
        ));
        let made = calibrate(&set, &request.setup, &prior, effort)?.ok_or(crate::Interrupted)?;
        made.save(&file)?;
        return Ok((set, made));
    };
    note(&format!("responses at this rest angle ({} runs, kept)", runs.0));
    let own = respond(&set, &request.setup, &prior, effort)?.ok_or(crate::Interrupted)?;
    let made = reach.at(&set, own.surfaces, own.baseline);
    made.save(&file)?;
    Ok((set, made))
}

/// How far areas of a unit must reach, from the cache or made on first use; `None` where the maps are not of the same features
/// at all angles of [`ANGLES_RAD`].
fn reach(request: &MapRequest, prior: &Constants, effort: UnitEffort) -> Result<Option<UnitCalibration>> {
    let at = |angle: f64| MapRequest {
        setup: TestSetup {
            rest_angle_rad: rounded_rest_angle(angle),
            ..request.setup.clone()
        },
        grid: request.grid.clone(),
    };
    let requests = ANGLES_RAD.map(at);
    let dir = maps::cached_in(&requests[0])?;
    let first = maps::made(&dir, &requests[0])?;
    let (file, kept) = kept(&dir, &first, prior, "reach");
    if let Some(c) = kept {
        return Ok(Some(c));
    }
    let mut places = vec![(first, &requests[0].setup)];
    for r in &requests[1..] {
        places.push((maps::made(&maps::cached_in(r)?, r)?, &r.setup));
    }
    let features = |set: &FailureMapSet| kinds(set).into_iter().map(|k| k.0).collect::<Vec<_>>();
    if places.iter().any(|(set, _)| features(set) != features(&places[0].0)) {
        return Ok(None);
    }
    let (each, all) = effort.runs(prior);
    note(&format!(
        "simulating units like this one ({} runs, once for all rest angles)",
        each * places.len() + all
    ));
    let made = calibrate_at(&places, prior, effort)?.ok_or(crate::Interrupted)?;
    made.save(&file)?;
    Ok(Some(made))
}

/// File beside maps for what simulated units of a prior say of them, and what it holds, if it can be used.
///
/// * `what` it is called after
fn kept(dir: &Path, set: &FailureMapSet, prior: &Constants, what: &str) -> (PathBuf, Option<UnitCalibration>) {
    let own = prior.fingerprint();
    let file = dir.join(format!("{what}-{own}.json"));
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
    Ok(kept(&dir, &set, &unit.prior(), "unit").1.map(ready).transpose()?)
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

/// What simulated units of a prior say of maps: how features answer to the constants.
struct Responses {
    /// anywhere on the maps
    surfaces: Option<ResponseSurfaces>,
    /// of healthy units
    baseline: Baseline,
}

/// Features that a unit's tests are judged by, and the scatter of each that the sensors make.
fn kinds(set: &FailureMapSet) -> Vec<(Feature, f64)> {
    // break-away comes in whole samples, also where all simulated units have the same
    let maps = set.joint_of_unit().map(|m| (m.feature, m.budget.measurement()));
    maps.chain(set.witnesses.iter().map(|w| (w.feature, w.budget.noise)))
        .collect()
}

/// Deviations of a simulated unit, and the features of its test; `None` where it lacks one.
fn sample(set: &FailureMapSet, spread: &Spread, u: &Unit, raw: &RawFeatures) -> Option<(Deviations, Vec<f64>)> {
    let features = set.features(raw);
    let values = kinds(set)
        .into_iter()
        .map(|(f, _)| features.get(f).filter(|x| x.is_finite()));
    Some((deviations(spread, &u.draw), values.collect::<Option<Vec<f64>>>()?))
}

/// Draws of the parts of a campaign never meet, nor those of other campaigns.
fn seeds(effort: UnitEffort) -> [u64; 3] {
    [0x51u64, 0x52, 0x53].map(|kind| effort.seed.wrapping_mul(2).wrapping_add(kind << 48))
}

/// Simulates what depends on the rest angle. `Ok(None)` where it was interrupted.
fn respond(set: &FailureMapSet, setup: &TestSetup, prior: &Constants, effort: UnitEffort) -> Result<Option<Responses>> {
    let spread = prior.spread();
    let (fsj, zeta) = range(set);
    let seeds = seeds(effort);
    let surface = draw_units(fsj, zeta, &spread, effort.surface_of(prior), seeds[0]);
    let Some(surface_raw) = measure(setup, &spread, &surface, "response to the constants")? else {
        return Ok(None);
    };
    let mut healthy = draw_units(fsj, zeta, &spread, effort.baseline, seeds[1]);
    healthy.iter_mut().for_each(|u| u.fault = FaultState::NOMINAL);
    let Some(healthy_raw) = measure(setup, &spread, &healthy, "healthy units")? else {
        return Ok(None);
    };
    let samples: Vec<_> = healthy
        .iter()
        .zip(&healthy_raw)
        .filter_map(|(u, raw)| sample(set, &spread, u, raw))
        .collect();
    Ok(Some(Responses {
        surfaces: surfaces(&Diagnoser::bare_of_unit(set.clone()), &spread, &surface, &surface_raw),
        baseline: Baseline::fit(&kinds(set), &samples),
    }))
}

/// Simulates units of a prior and their tests, from the rest angle of the maps. `Ok(None)` where it was interrupted.
///
/// # Errors
/// As [`measure`], and refuses maps that a diagnoser refuses.
pub fn calibrate(
    set: &FailureMapSet,
    setup: &TestSetup,
    prior: &Constants,
    effort: UnitEffort,
) -> Result<Option<UnitCalibration>> {
    calibrate_at(&[(set.clone(), setup)], prior, effort)
}

/// Units of a prior with a history, healthy tests first: the tests of each.
fn histories(set: &FailureMapSet, prior: &Constants, effort: UnitEffort) -> Vec<Vec<Unit>> {
    let (fsj, zeta) = range(set);
    let spread = prior.spread();
    let first = HISTORIES[HISTORIES.len() - 1];
    let mut rng = ChaCha8Rng::seed_from_u64(seeds(effort)[2]);
    let root = prior.root();
    let one = |_| {
        let own = draw_unit(prior, &root, &spread.half_width, &mut rng);
        let test = |k: usize| {
            let anywhere = |rng: &mut ChaCha8Rng| {
                let (f, z) = (rng.random_range(fsj.0..fsj.1), rng.random_range(zeta.0..zeta.1));
                if k < first {
                    FaultState::NOMINAL
                } else {
                    FaultState { fsj: f, zeta: z }
                }
            };
            draw_test(prior, own, &mut rng, anywhere)
        };
        (0..first + effort.tests).map(test).collect()
    };
    (0..effort.units).map(one).collect()
}

/// The same from several rest angles: the units are shared out among them, and what they say of the reach goes together.
/// Surfaces and baseline are those of the first.
///
/// * `places` maps of the same features, and their tests
fn calibrate_at(
    places: &[(FailureMapSet, &TestSetup)],
    prior: &Constants,
    effort: UnitEffort,
) -> Result<Option<UnitCalibration>> {
    let spread = prior.spread();
    let first = HISTORIES[HISTORIES.len() - 1];
    let units = histories(&places[0].0, prior, effort);
    let mut common = Calibration {
        spread: spread.name.clone(),
        half_width: spread.half_width,
        friction_per_k: spread.friction_per_k,
        runs: effort.units * effort.tests,
        surface_runs: effort.surface_of(prior),
        seed: effort.seed,
        maps: places[0].0.fingerprint(),
        commit: COMMIT.into(),
        scores: Default::default(),
        misfits: vec![uncalibrated(COVERAGE).1],
        deviations: Vec::new(),
        strips: Vec::new(),
        kinetic: Vec::new(),
        surfaces: None,
    };
    // of each angle: responses, its units, and the features of their tests
    let mut all = Vec::new();
    let (mut sum, mut free) = (Vec::new(), 0.0);
    for (p, (set, setup)) in places.iter().enumerate() {
        let Some(own) = respond(set, setup, prior, effort)? else {
            return Ok(None);
        };
        let units: Vec<&Vec<Unit>> = units.iter().skip(p).step_by(places.len()).collect();
        let tests: Vec<Unit> = units.iter().flat_map(|u| u.iter().cloned()).collect();
        let Some(raw) = measure(setup, &spread, &tests, "units with a history")? else {
            return Ok(None);
        };
        let raw: Vec<Vec<RawFeatures>> = raw.chunks(first + effort.tests).map(<[_]>::to_vec).collect();
        let healthy = |(tests, raw): (&&Vec<Unit>, &Vec<RawFeatures>)| {
            let each = tests[..first].iter().zip(raw);
            each.filter_map(|(u, r)| sample(set, &spread, u, r)).collect()
        };
        let (s, f) = own
            .baseline
            .about_units(&units.iter().zip(&raw).map(healthy).collect::<Vec<_>>());
        sum.resize(s.len(), 0.0);
        sum.iter_mut().zip(s).for_each(|(a, b): (&mut f64, f64)| *a += b);
        free += f;
        all.push((own, units, raw));
    }
    let mut angles = Vec::new();
    for ((set, _), (own, units, raw)) in places.iter().zip(&mut all) {
        own.baseline.scatter(&sum, free);
        let local = Calibration {
            surfaces: own.surfaces.clone(),
            maps: set.fingerprint(),
            ..common.clone()
        };
        let diagnoser = Diagnoser::with_factors(set.clone(), local, COVERAGE, &prior.factors(&Vec::new()))?;
        angles.push((set, &*own, diagnoser, &*units, &*raw));
    }
    let mut strata = Vec::new();
    for h in std::iter::once(0).chain(HISTORIES) {
        let mut scored = Vec::new();
        for (set, own, diagnoser, units, raw) in &angles {
            let one = |k: usize| {
                let (tests, raw) = (&units[k], &raw[k]);
                let features = || raw[..h].iter().map(|r| set.features(r)).collect();
                let healthy = || HealthyTests {
                    baseline: &own.baseline,
                    features: features(),
                };
                let learnt = (h > 0).then(|| prior.after_healthy(&[healthy()], &[]));
                let constants = learnt.as_ref().map_or(prior, |l| &l.constants);
                let d = diagnoser.again_with(&constants.factors(&Vec::new()));
                (scores(&d, &tests[first..], &raw[first..]), learnt.map(|l| l.misfit))
            };
            scored.extend((0..units.len()).into_par_iter().map(one).collect::<Vec<_>>());
        }
        let mut healthy_misfits: Vec<f64> = scored.iter().filter_map(|a| a.1).collect();
        healthy_misfits.sort_by(f64::total_cmp);
        let mut of = common.clone();
        let flat: Vec<_> = scored.into_iter().flat_map(|a| a.0).collect();
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
    let Responses { surfaces, baseline } = all.swap_remove(0).0;
    common.surfaces = surfaces;
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
    made(
        &request(setup, settings.grid.clone()),
        unit,
        settings.choice.coverage,
        known,
    )
}

/// The same from a request.
///
/// # Errors
/// As [`ready`].
pub fn made(request: &MapRequest, unit: &UnitFile, coverage: f64, known: &Known) -> Result<Diagnoser> {
    let (set, calibration) = ready(request, unit)?;
    Ok(calibration.diagnoser(set, &unit.constants, unit.healthy(), coverage, known)?)
}

/// What maps of a unit's test are made for.
///
/// * `setup` of the unit's own model
pub fn request(setup: &TestSetup, grid: FaultGrid) -> MapRequest {
    MapRequest {
        setup: TestSetup {
            rest_angle_rad: rounded_rest_angle(setup.rest_angle_rad),
            load_n_m: 0.0,
            ..setup.clone()
        },
        grid,
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
            "repairs_before": t.repairs,
        })
    };
    let last = unit.tests.iter().rev().find(|t| t.fsj.is_some() && unit.is_present(t));
    serde_json::json!({
        "name": unit.name,
        "model": unit.source,
        "tests": unit.taken(),
        "healthy_tests": unit.healthy(),
        "reference": unit.reference(),
        "constants": constants(unit).into_iter().map(constant).collect::<Vec<_>>(),
        "present": last.map(test),
        "repairs": unit.repairs.iter().map(|r| serde_json::json!({"part": r.part.name(), "note": r.note})).collect::<Vec<_>>(),
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

    /// The kinds of a unit's tests that differ from one of them in the rest angle alone, itself included.
    fn alike(&self, unit: &UnitFile, kind: &str) -> Vec<String> {
        let of = |k: &str| unit.kinds.iter().find(|e| e.kind == k);
        let own = of(kind);
        let alike = unit.kinds.iter().filter(|e| own.is_some_and(|o| o.but_for_angle(e)));
        alike.map(|e| e.kind.clone()).collect()
    }

    /// Healthy tests of a unit that differ from a kind in the rest angle alone, by place of their maps.
    fn healthy(&self, unit: &UnitFile, kind: &str, counts: impl Fn(&TestEntry) -> bool) -> Vec<(usize, Vec<Features>)> {
        let mut all = Vec::new();
        for k in self.alike(unit, kind) {
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
        let of = |(place, features): &(usize, Vec<Features>)| (&self.0[*place].2, features.clone());
        after_healthy(prior, &tests.iter().map(of).collect::<Vec<_>>())
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
        let mut all = kinds.healthy(unit, &kind, TestEntry::is_taken);
        Kinds::with(&mut all, place, &features);
        let judged = kinds.learnt(&unit.prior(), &all).map(|_| false);
        // refused ones that agree with this one, and speak against the model together
        let judged = judged.or_else(|e| {
            let mut all = kinds.healthy(unit, &kind, |_| true);
            Kinds::with(&mut all, place, &features);
            kinds.learnt(&unit.prior(), &all).map(|_| true).map_err(|_| e)
        });
        match judged {
            Ok(false) => {}
            Ok(true) => {
                let alike = kinds.alike(unit, &kind);
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

/// The constants anew, from all tests: healthy ones first, then the others in their order.
fn relearn(unit: &mut UnitFile, kinds: &Kinds) -> Result<()> {
    let mut constants = unit.prior();
    let mut seen: Vec<String> = Vec::new();
    let healthy = |t: &&TestEntry| t.healthy && t.is_taken() && unit.is_present(t);
    for t in unit.tests.iter().filter(healthy) {
        if seen.contains(&t.kind) {
            continue;
        }
        seen.extend(kinds.alike(unit, &t.kind));
        // of another test than those before, and at odds with them: the first counts
        if let Ok(c) = kinds.learnt(&constants, &kinds.healthy(unit, &t.kind, TestEntry::is_taken)) {
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
