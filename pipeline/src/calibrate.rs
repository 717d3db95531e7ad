//! The campaign behind calibrated bands: simulated tests of random units with random faults, none of
//! which the maps are made of.

use crate::COMMIT;
use anyhow::Result;
use diagnoser::calibration::{COVERAGE, Calibration, REFUSED_SCORE, uncalibrated};
use diagnoser::diagnosis::{Diagnoser, Known, Score};
use diagnoser::failure_map::{FailureMapSet, MapSetHeader};
use diagnoser::uncertainty::{Factors, ResponseSurfaces, Sample, Scale, deviations, log_kinetic};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use schemas::error::Error;
use schemas::fault::FaultState;
use schemas::feature::RawFeatures;
use schemas::sequence::TestSequence;
use sim_worker::extractor::{FeatureExtractor, FeaturePlan};
use sim_worker::parameters::ActuatorParameters;
use sim_worker::progress::Progress;
use sim_worker::sensor::SensorModel;
use sim_worker::setup::TestSetup;
use sim_worker::simulate::{LANES, Run, simulate};
use sim_worker::spread::{Cause, Spread};
use sim_worker::test_bench::Lane;
use std::borrow::Cow;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::Ordering;

/// What a campaign costs.
#[derive(Clone, Copy, Debug)]
pub struct Effort {
    /// runs that the reach comes from
    pub runs: usize,
    /// further runs that the response to the unit's causes comes from; none without spread
    pub surface_runs: usize,
    /// of the draws; noise seeds follow from it
    pub seed: u64,
}

impl Effort {
    /// What maps that are made on first use are calibrated with.
    pub const QUICK: Self = Self {
        runs: 512,
        surface_runs: 1024,
        seed: 0,
    };
}

/// The tests that maps are for, ready to be simulated. Refuses actuator, sequence or sensors that are not theirs.
///
/// * `file` of the maps, for messages
pub(crate) fn setup_of(
    file: &Path,
    header: &MapSetHeader,
    actuator: Arc<ActuatorParameters>,
    sequence: TestSequence,
    sensors: Option<SensorModel>,
) -> Result<TestSetup> {
    let setup = TestSetup::of(&header.kind, actuator, sequence, sensors);
    match setup.kind().difference(&header.kind) {
        None => Ok(setup),
        Some(d) => {
            let option = match d.place {
                "parameter fingerprint" => "--actuator",
                "sequence fingerprint" => "--sequence",
                _ => "--sensors",
            };
            let allowed = format!("{}; choose with {option}", d.found);
            Err(Error::bad(file.display().to_string(), d.place, d.allowed, allowed).into())
        }
    }
}

/// A simulated test of one unit.
#[derive(Clone, Debug)]
pub struct Unit {
    /// of the test
    pub fault: FaultState,
    /// by [`Cause`], -1 to 1: share of the spread's half-width
    pub draw: [f64; Cause::COUNT],
    /// of the sensor noise
    pub seed: u64,
}

/// Dynamic friction of a unit's test over that of the healthy model: the kinetic factor, FSJ where units do not differ in it.
pub fn kinetic_factor(spread: &Spread, unit: &Unit) -> f64 {
    unit.fault.fsj * log_kinetic(&deviations(spread, &unit.draw)).exp()
}

/// Random units over a fault range.
///
/// * `seed` of the draws; noise seeds follow from it
pub fn draw_units(fsj: (f64, f64), zeta: (f64, f64), spread: &Spread, n: usize, seed: u64) -> Vec<Unit> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    // of their own, so that a cause that is added draws nobody else anew
    let mut later = ChaCha8Rng::seed_from_u64(seed);
    later.set_stream(1);
    let unit = |_| {
        let fault = FaultState {
            fsj: rng.random_range(fsj.0..fsj.1),
            zeta: rng.random_range(zeta.0..zeta.1),
        };
        let draw = std::array::from_fn(|c| {
            let from = if c < Cause::FIRST { &mut rng } else { &mut later };
            let x = from.random_range(-1.0..1.0);
            if spread.half_width[c] > 0.0 { x } else { 0.0 }
        });
        let seed = rng.random();
        Unit { fault, draw, seed }
    };
    (0..n).map(unit).collect()
}

/// Features of each unit's test, as its sensors give them. `Ok(None)` where it was interrupted.
///
/// # Errors
/// As [`simulate_features`].
pub fn measure(setup: &TestSetup, spread: &Spread, units: &[Unit], title: &str) -> Result<Option<Vec<RawFeatures>>> {
    let lanes = units.iter().map(|u| {
        let (actuator, rest_angle_rad) = spread.unit(&setup.actuator, setup.rest_angle_rad, &u.draw);
        let actuator = if spread.is_none() {
            setup.actuator.clone()
        } else {
            Arc::new(actuator)
        };
        let lane = Lane {
            actuator,
            fault: u.fault,
            rest_angle_rad,
            load_n_m: setup.load_n_m,
        };
        (lane, u.seed)
    });
    simulate_features(setup, lanes.collect(), title)
}

/// Features of tests in the given lanes with the given noise seeds. `Ok(None)` where it was
/// interrupted.
///
/// # Errors
/// Refuses a setup that [`TestSetup::experiment`] refuses.
pub fn simulate_features(setup: &TestSetup, lanes: Vec<(Lane, u64)>, title: &str) -> Result<Option<Vec<RawFeatures>>> {
    let plan = Arc::new(setup.feature_plan());
    let experiment = setup.experiment(FeaturePlan::wanted_of(&setup.sequence, setup.equivalent_current))?;
    let runs: Vec<Run> = lanes
        .into_iter()
        .zip(0..)
        .map(|((lane, seed), number)| Run { number, lane, seed })
        .collect();
    let progress = Arc::new(Progress::default());
    let total = runs.len() as u64;
    let block = |runs: &[Run]| -> Result<Option<Vec<RawFeatures>>> {
        let mut sinks = vec![FeatureExtractor::new(plan.clone()); runs.len()];
        let go_on = || !progress.stop.load(Ordering::Relaxed);
        if !go_on() || simulate(&experiment, runs, &mut sinks, go_on)?.is_none() {
            return Ok(None);
        }
        progress.runs.fetch_add(runs.len() as u64, Ordering::Relaxed);
        Ok(Some(sinks.iter().map(FeatureExtractor::features).collect()))
    };
    let work = || runs.par_chunks(LANES).map(block).collect::<Result<Vec<_>>>();
    let blocks = crate::progress::with_bar(title, total, &progress, work)?;
    Ok(blocks.into_iter().collect::<Option<Vec<_>>>().map(|b| b.concat()))
}

/// Simulated tests of random units, from which maps can be calibrated.
#[derive(Clone, Debug)]
pub struct Campaign {
    /// how units differ
    pub spread: Spread,
    /// what it cost
    pub effort: Effort,
    /// tests that the response surfaces come from, and those that the reach comes from
    pub surface: (Vec<Unit>, Vec<RawFeatures>),
    /// these give the reach
    pub scores: (Vec<Unit>, Vec<RawFeatures>),
}

impl Campaign {
    /// Simulates it. `Ok(None)` where it was interrupted.
    ///
    /// * `fsj`, `zeta` range of the maps
    ///
    /// # Errors
    /// As [`simulate_features`].
    pub fn run(
        setup: &TestSetup,
        spread: &Spread,
        effort: Effort,
        fsj: (f64, f64),
        zeta: (f64, f64),
    ) -> Result<Option<Self>> {
        // draws of the surfaces, of the scores and of tests by others never meet
        let seeds = [0x5u64, 0xCu64].map(|kind| effort.seed.wrapping_mul(2).wrapping_add(kind << 56));
        let n = if spread.is_none() { 0 } else { effort.surface_runs };
        let mut parts = Vec::new();
        for (n, seed, title) in [
            (n, seeds[0], "response to the spread"),
            (effort.runs, seeds[1], "calibration"),
        ] {
            let units = draw_units(fsj, zeta, spread, n, seed);
            let Some(measured) = measure(setup, spread, &units, title)? else {
                return Ok(None);
            };
            parts.push((units, measured));
        }
        let scores = parts.pop().expect("two parts");
        Ok(Some(Self {
            spread: spread.clone(),
            effort,
            surface: parts.pop().expect("two parts"),
            scores,
        }))
    }

    /// The calibration of maps from it.
    ///
    /// # Errors
    /// Refuses maps that [`Diagnoser::new`] refuses.
    pub fn calibrate(&self, set: &FailureMapSet) -> Result<Calibration> {
        let effort = Effort {
            runs: self.scores.0.len(),
            surface_runs: self.surface.0.len(),
            ..self.effort
        };
        let mut calibration = unscored(&self.spread, effort, set.fingerprint(), self.surfaces(set));
        let diagnoser = Diagnoser::new(set.clone(), Some(calibration.clone()), COVERAGE, &Vec::new())?;
        let one = |(u, raw): (&Unit, &RawFeatures)| {
            let (features, own) = (set.features(raw), knowing(&diagnoser, &self.spread, u));
            let kinetic = own.kinetic_score(&features, kinetic_factor(&self.spread, u));
            (own.score(&features, u.fault.fsj, u.fault.zeta), kinetic)
        };
        let tests: Vec<_> = self.scores.0.par_iter().zip(&self.scores.1).map(one).collect();
        let scores: Vec<Score> = tests.iter().filter_map(|t| t.0).collect();
        score_all(&mut calibration, &scores);
        calibration.kinetic = tests.iter().filter_map(|t| t.1).collect();
        calibration.kinetic.sort_by(f64::total_cmp);
        Ok(calibration)
    }

    fn surfaces(&self, set: &FailureMapSet) -> Option<ResponseSurfaces> {
        let bare = Diagnoser::uncalibrated(set.clone());
        surfaces(&bare, &self.spread, &self.surface.0, &self.surface.1)
    }
}

/// The calibration of maps, for the very actuator that they are of, from tests of known faults that the maps are not made
/// of. Tests without every feature of the maps count for nothing: `runs` are those that are left.
///
/// # Errors
/// As [`Campaign::calibrate`].
pub fn of_tests(
    set: &FailureMapSet,
    tests: impl IntoIterator<Item = (FaultState, RawFeatures)>,
) -> Result<Calibration> {
    let unit = |fault| Unit {
        fault,
        draw: [0.0; Cause::COUNT],
        seed: 0,
    };
    let scores: (Vec<Unit>, Vec<RawFeatures>) = tests.into_iter().map(|(fault, raw)| (unit(fault), raw)).unzip();
    let campaign = Campaign {
        spread: Spread::none(),
        effort: Effort {
            runs: scores.0.len(),
            surface_runs: 0,
            seed: 0,
        },
        surface: (Vec::new(), Vec::new()),
        scores,
    };
    let mut calibration = campaign.calibrate(set)?;
    calibration.runs = calibration.misfits.len();
    Ok(calibration)
}

/// Response surfaces of simulated units; none without units.
///
/// * `bare` the maps, without any
pub(crate) fn surfaces(
    bare: &Diagnoser,
    spread: &Spread,
    units: &[Unit],
    measured: &[RawFeatures],
) -> Option<ResponseSurfaces> {
    let set = &bare.maps;
    let sample = |(u, raw): (&Unit, &RawFeatures)| {
        let features = set.features(raw);
        let expected = bare.predicted(u.fault.fsj, u.fault.zeta).into_iter();
        let residual = expected.map(|(f, map, own)| features.get(f).map(|x| (f, x - map, own)));
        Some(Sample {
            fsj: u.fault.fsj,
            zeta: u.fault.zeta,
            deviations: deviations(spread, &u.draw),
            residual: residual.collect::<Option<Vec<_>>>()?,
        })
    };
    let (fsj, zeta) = range(set);
    let samples: Vec<Sample> = units.iter().zip(measured).filter_map(sample).collect();
    (!samples.is_empty()).then(|| ResponseSurfaces::fit(Scale { fsj, zeta }, &samples))
}

/// What tests of a spread say of themselves: their temperature, where units are tested at several.
pub fn known_of(spread: &Spread, unit: &Unit) -> Known {
    let cause = Cause::TestTemperature;
    let half = spread.half_width[cause as usize];
    if half > 0.0 {
        vec![(cause, half * unit.draw[cause as usize])]
    } else {
        Vec::new()
    }
}

/// A diagnoser that knows what a test says of itself; the very one where tests say nothing.
pub fn knowing<'a>(diagnoser: &'a Diagnoser, spread: &Spread, unit: &Unit) -> Cow<'a, Diagnoser> {
    let known = known_of(spread, unit);
    if known.is_empty() {
        Cow::Borrowed(diagnoser)
    } else {
        Cow::Owned(diagnoser.again_with(&Factors::of(spread, &known)))
    }
}

/// Scores of simulated tests; those that no diagnosis can be made of have none.
pub(crate) fn scores(diagnoser: &Diagnoser, units: &[Unit], measured: &[RawFeatures]) -> Vec<Score> {
    let score = |(u, raw): (&Unit, &RawFeatures)| {
        let features = diagnoser.maps.features(raw);
        diagnoser.score(&features, u.fault.fsj, u.fault.zeta)
    };
    units.iter().zip(measured).filter_map(score).collect()
}

/// A calibration that has no scores yet.
///
/// * `maps` fingerprint of its maps
pub(crate) fn unscored(
    spread: &Spread,
    effort: Effort,
    maps: String,
    surfaces: Option<ResponseSurfaces>,
) -> Calibration {
    Calibration {
        spread: spread.name.clone(),
        half_width: spread.half_width,
        friction_per_k: spread.friction_per_k,
        runs: effort.runs,
        surface_runs: effort.surface_runs,
        seed: effort.seed,
        maps,
        commit: COMMIT.into(),
        scores: Default::default(),
        misfits: vec![uncalibrated(COVERAGE).1],
        deviations: Vec::new(),
        strips: Vec::new(),
        kinetic: Vec::new(),
        surfaces,
    }
}

/// Fills a calibration with the scores of tests, whatever it had.
pub(crate) fn score_all(calibration: &mut Calibration, scores: &[Score]) {
    let sorted = |f: fn(&Score) -> f64| {
        let mut v: Vec<f64> = scores.iter().map(f).collect();
        v.sort_by(f64::total_cmp);
        v
    };
    calibration.misfits = sorted(|s| s.misfit);
    calibration.deviations = sorted(|s| s.deviation);
    let (gate, witness_gate) = (calibration.gate(), calibration.witness_gate());
    calibration.scores.iter_mut().for_each(Vec::clear);
    let mut strips = Vec::with_capacity(scores.len());
    for s in scores {
        let refused = s.misfit > gate || s.deviation > witness_gate;
        let score = if refused { REFUSED_SCORE } else { s.reach };
        calibration.scores[s.quadrant].push(score);
        strips.push((s.fsj, score));
    }
    calibration.scores.iter_mut().for_each(|s| s.sort_by(f64::total_cmp));
    calibration.in_strips(strips);
}

/// FSJ and zeta that maps reach over.
pub fn range(set: &FailureMapSet) -> ((f64, f64), (f64, f64)) {
    let ends = |x: &[f64]| (x[0], x[x.len() - 1]);
    let first = &set.maps[0];
    (ends(&first.fsj), ends(&first.zeta))
}

/// Calibrates maps for a spread. `Ok(None)` where it was interrupted.
///
/// # Errors
/// As [`Campaign::run`] and [`Campaign::calibrate`].
pub fn calibrate(
    set: &FailureMapSet,
    setup: &TestSetup,
    spread: &Spread,
    effort: Effort,
) -> Result<Option<Calibration>> {
    let (fsj, zeta) = range(set);
    let campaign = Campaign::run(setup, spread, effort, fsj, zeta)?;
    campaign.map(|c| c.calibrate(set)).transpose()
}
