//! Simulated units like one unit: how features answer to the constants at each rest angle, and how far areas must reach.

use crate::calibrate::{Effort, Unit, draw_units, measure, range, score_all, scores, surfaces, unscored};
use crate::case::Settings;
use crate::maps::{self, MapRequest};
use crate::progress::note;
use anyhow::Result;
use diagnoser::calibration::{COVERAGE, Calibration};
use diagnoser::diagnosis::{Diagnoser, Known, Score};
use diagnoser::failure_map::FailureMapSet;
use diagnoser::map_library::rounded_rest_angle;
use diagnoser::uncertainty::{Deviations, ResponseSurfaces, deviations};
use diagnoser::unit::{Baseline, Constants, HealthyTests, Stratum, UnitCalibration, UnitFile};
use nalgebra::DMatrix;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use schemas::fault::{FaultGrid, FaultState};
use schemas::feature::{Features, RawFeatures};
use sim_worker::setup::TestSetup;
use sim_worker::spread::{Cause, Spread};
use std::path::{Path, PathBuf};

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
        let each = self.tests + HEALTHY;
        (self.surface_of(prior) + self.baseline, self.units * each)
    }
}

/// Numbers of healthy tests that simulated units have.
const HISTORIES: [usize; 2] = [1, HEALTHY];

/// Healthy tests of each simulated unit.
const HEALTHY: usize = 3;

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
    let made = match reach {
        Some(reach) => {
            note(&format!("responses at this rest angle ({} runs, kept)", runs.0));
            let own = respond(&set, &request.setup, &prior, effort)?.ok_or(crate::Interrupted)?;
            reach.at(&set, own.surfaces, own.baseline)
        }
        // another choice of features than elsewhere: what is known of it is known here alone
        None => {
            note(&format!(
                "simulating units like this one ({} runs, once)",
                runs.0 + runs.1
            ));
            calibrate(&set, &request.setup, &prior, effort)?.ok_or(crate::Interrupted)?
        }
    };
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
    let mut sets = vec![first];
    for r in &requests[1..] {
        sets.push(maps::made(&maps::cached_in(r)?, r)?);
    }
    let features = |set: &FailureMapSet| set.judged_of_unit().map(|k| k.0).collect::<Vec<_>>();
    if sets.iter().any(|set| features(set) != features(&sets[0])) {
        return Ok(None);
    }
    let places: Vec<_> = sets.iter().zip(requests.iter().map(|r| &r.setup)).collect();
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
    let ready = |c: UnitCalibration| c.of_file(set.clone(), unit, coverage, &Vec::new());
    Ok(kept(&dir, &set, &unit.prior(), "unit").1.map(ready).transpose()?)
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

/// Deviations of a simulated unit, and the features of its test; `None` where it lacks one.
fn sample(set: &FailureMapSet, spread: &Spread, u: &Unit, raw: &RawFeatures) -> Option<(Deviations, Vec<f64>)> {
    let features = set.features(raw);
    let values = set
        .judged_of_unit()
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
        baseline: Baseline::fit(&set.judged_of_unit().collect::<Vec<_>>(), &samples),
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
    calibrate_at(&[(set, setup)], prior, effort)
}

/// Units of a prior with a history, healthy tests first: the tests of each.
fn histories(set: &FailureMapSet, prior: &Constants, effort: UnitEffort) -> Vec<Vec<Unit>> {
    let (fsj, zeta) = range(set);
    let spread = prior.spread();
    let mut rng = ChaCha8Rng::seed_from_u64(seeds(effort)[2]);
    let root = prior.root();
    let one = |_| {
        let own = draw_unit(prior, &root, &spread.half_width, &mut rng);
        let test = |k: usize| {
            let anywhere = |rng: &mut ChaCha8Rng| {
                let (f, z) = (rng.random_range(fsj.0..fsj.1), rng.random_range(zeta.0..zeta.1));
                if k < HEALTHY {
                    FaultState::NOMINAL
                } else {
                    FaultState { fsj: f, zeta: z }
                }
            };
            draw_test(prior, own, &mut rng, anywhere)
        };
        (0..HEALTHY + effort.tests).map(test).collect()
    };
    (0..effort.units).map(one).collect()
}

/// Units with a history that are tested from one rest angle.
struct Angle<'a> {
    set: &'a FailureMapSet,
    own: Responses,
    /// tests of each unit, healthy ones first
    units: Vec<Vec<Unit>>,
    /// features of each test
    raw: Vec<Vec<RawFeatures>>,
}

impl<'a> Angle<'a> {
    /// `Ok(None)` where it was interrupted.
    fn simulate(
        set: &'a FailureMapSet,
        setup: &TestSetup,
        prior: &Constants,
        effort: UnitEffort,
        units: Vec<Vec<Unit>>,
    ) -> Result<Option<Self>> {
        let Some(own) = respond(set, setup, prior, effort)? else {
            return Ok(None);
        };
        let Some(raw) = measure(setup, &prior.spread(), &units.concat(), "units with a history")? else {
            return Ok(None);
        };
        let mut rest = &raw[..];
        let of_unit = |tests: &Vec<Unit>| {
            let (own, others) = rest.split_at(tests.len());
            rest = others;
            own.to_vec()
        };
        Ok(Some(Self {
            set,
            own,
            raw: units.iter().map(of_unit).collect(),
            units,
        }))
    }

    /// What scatters from test to test of the healthy units: [`Baseline::about_units`].
    fn about_units(&self, spread: &Spread) -> (Vec<f64>, f64) {
        let healthy = |(tests, raw): (&Vec<Unit>, &Vec<RawFeatures>)| {
            let each = tests[..HEALTHY].iter().zip(raw);
            each.filter_map(|(u, r)| sample(self.set, spread, u, r)).collect()
        };
        let units: Vec<_> = self.units.iter().zip(&self.raw).map(healthy).collect();
        self.own.baseline.about_units(&units)
    }

    fn diagnoser(&self, common: &Calibration, prior: &Constants) -> Result<Diagnoser> {
        let local = Calibration {
            surfaces: self.own.surfaces.clone(),
            maps: self.set.fingerprint(),
            ..common.clone()
        };
        let factors = prior.factors(&Vec::new());
        Ok(Diagnoser::with_factors(self.set.clone(), local, COVERAGE, &factors)?)
    }

    /// Scores of each unit's tests at random faults after so many healthy ones, and the misfit of those, where there are any.
    fn scored(&self, diagnoser: &Diagnoser, prior: &Constants, healthy: usize) -> Vec<(Vec<Score>, Option<f64>)> {
        let one = |(tests, raw): (&Vec<Unit>, &Vec<RawFeatures>)| {
            let features: Vec<Features> = raw[..healthy].iter().map(|r| self.set.features(r)).collect();
            let before = HealthyTests {
                baseline: &self.own.baseline,
                features: &features,
            };
            let learnt = (healthy > 0).then(|| prior.after_healthy(&[before], &[]));
            let constants = learnt.as_ref().map_or(prior, |l| &l.constants);
            let d = diagnoser.again_with(&constants.factors(&Vec::new()));
            let scores = scores(&d, &tests[HEALTHY..], &raw[HEALTHY..]);
            (scores, learnt.map(|l| l.misfit))
        };
        self.units.par_iter().zip(&self.raw).map(one).collect()
    }
}

/// The same from several rest angles: the units are shared out among them, and what they say of the reach goes together.
/// Surfaces and baseline are those of the first.
///
/// * `places` maps of the same features, and their tests
fn calibrate_at(
    places: &[(&FailureMapSet, &TestSetup)],
    prior: &Constants,
    effort: UnitEffort,
) -> Result<Option<UnitCalibration>> {
    let spread = prior.spread();
    let units = histories(places[0].0, prior, effort);
    let own = Effort {
        runs: effort.units * effort.tests,
        surface_runs: effort.surface_of(prior),
        seed: effort.seed,
    };
    let mut common = unscored(&spread, own, places[0].0.fingerprint(), None);
    let mut angles = Vec::new();
    let (mut sum, mut free) = (Vec::new(), 0.0);
    for (p, (set, setup)) in places.iter().enumerate() {
        let own = units.iter().skip(p).step_by(places.len());
        let Some(angle) = Angle::simulate(set, setup, prior, effort, own.cloned().collect())? else {
            return Ok(None);
        };
        let (s, f) = angle.about_units(&spread);
        sum.resize(s.len(), 0.0);
        sum.iter_mut().zip(s).for_each(|(a, b): (&mut f64, f64)| *a += b);
        free += f;
        angles.push(angle);
    }
    let mut scored = Vec::new();
    for angle in &mut angles {
        angle.own.baseline.scatter(&sum, free);
        scored.push((&*angle, angle.diagnoser(&common, prior)?));
    }
    let mut strata = Vec::new();
    for h in std::iter::once(0).chain(HISTORIES) {
        let each: Vec<_> = scored.iter().flat_map(|(angle, d)| angle.scored(d, prior, h)).collect();
        let mut healthy_misfits: Vec<f64> = each.iter().filter_map(|a| a.1).collect();
        healthy_misfits.sort_by(f64::total_cmp);
        let mut of = common.clone();
        score_all(&mut of, &each.into_iter().flat_map(|a| a.0).collect::<Vec<_>>());
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
    let Responses { surfaces, baseline } = angles.swap_remove(0).own;
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
    Ok(calibration.of_file(set, unit, coverage, known)?)
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
