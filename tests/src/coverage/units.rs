//! Units with a history: after an acceptance test and a number of later ones, and over a life.

use super::record::{self, Pair};
use super::{Case, FSJ, ZETA, maps_of, other_hand, percent, quantile};
use crate::independent::Command;
use anyhow::{Context, Result, anyhow};
use diagnoser::diagnosis::{COVERAGE, Outcome};
use diagnoser::failure_map::FailureMapSet;
use diagnoser::unit::{Constants, UnitCalibration, UnitFile, after_healthy};
use pipeline::calibrate::{Unit, measure};
use pipeline::unit::{UnitEffort, draw_test};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use schemas::fault::FaultState;
use schemas::feature::{Features, RawFeatures};
use sim_worker::parameters::ActuatorParameters;
use sim_worker::setup::TestSetup;
use sim_worker::spread::{Cause, Spread};
use std::path::Path;
use std::sync::Arc;

/// Later tests that units have, beside the one of acceptance.
const HISTORIES: [usize; 3] = [0, 10, 30];

/// Tests of a whole life, and by how much FSJ jumps in its middle.
const LIFE: usize = 300;
const STEP: f64 = 0.7;

/// Tests of one unit whose diagnoses are timed.
const TIMED: usize = 200;

/// Of so many units one lives through it.
const LIVES_OF: usize = 5;

const THIRDS: usize = 3;

const HEAD: &str = "| test | history | truth inside % | not located | width FSJ %, median (95th) | width zeta | error FSJ %, median (95th) |\n\
                    |---|---|---|---|---|---|---|\n";

fn drawn(spread: &Spread, rng: &mut ChaCha8Rng) -> [f64; Cause::COUNT] {
    std::array::from_fn(|c| {
        let x = rng.random_range(-1.0..1.0);
        if spread.half_width[c] > 0.0 { x } else { 0.0 }
    })
}

/// Faults anywhere in their range.
fn anywhere(rng: &mut ChaCha8Rng) -> FaultState {
    FaultState {
        fsj: rng.random_range(FSJ.0..FSJ.1),
        zeta: rng.random_range(ZETA.0..ZETA.1),
    }
}

fn row(title: &str, all: &[Case]) -> String {
    let inside = all.iter().filter(|c| c.inside).count();
    let refused = all.iter().filter(|c| c.outcome != "located").count();
    let of = |q, f: fn(&Case, Pair, Pair) -> f64| quantile(record::located(all).map(|(c, w, e)| f(c, w, e)), q);
    let width = |q| of(q, |c, w, _| 100.0 * w.0 / c.fsj);
    let error = |q| of(q, |c, _, e| 100.0 * (e.0 / c.fsj).abs());
    format!(
        "| {title} | {} | {refused} | {:.2} ({:.2}) | {:.4} | {:.2} ({:.2}) |\n",
        percent(inside, all.len()),
        width(0.5),
        width(0.95),
        of(0.5, |_, w, _| w.1),
        error(0.5),
        error(0.95)
    )
}

/// Maps of a sequence, and units of a spread calibrated on them.
pub fn ready(
    cache: &Path,
    sequence: &str,
    grid: &str,
    spread: &Spread,
) -> Result<(FailureMapSet, TestSetup, Constants, UnitCalibration)> {
    let (set, setup) = maps_of(&cache.join(sequence), sequence, grid, 0.0)?;
    let unit = UnitFile::new(
        "bench".into(),
        "-".into(),
        ActuatorParameters::reference(),
        spread.clone(),
    );
    let prior = unit.prior();
    let setup = TestSetup {
        actuator: Arc::new(unit.actuator.clone()),
        ..setup
    };
    let calibration = pipeline::unit::calibrate(&set, &setup, &prior, UnitEffort::QUICK)?.context("interrupted")?;
    Ok((set, setup, prior, calibration))
}

/// The other simulator's command for a sequence.
pub fn command_of(sequence: &str) -> Command {
    match sequence {
        "preflight" => Command::Preflight,
        _ => Command::Preflight2,
    }
}

/// Both pre-flight tests: units after an acceptance test and some later ones, then over a life.
///
/// * `n` units of each history
pub fn bench(cache: &Path, grid: &str, spread: &str, n: usize, seed: u64) -> Result<String> {
    let spread = sim_worker::catalogue::spread(spread)?;
    let mut out = format!(
        "## Units with a history, spread {}\n\nReference actuator and sensors (all values assumed), maps on the grid `{grid}`, {n} units of each \
         history: one acceptance test, later tests while both faults grow, all shown to the unit, and the test that is judged. 95 % Wilson \
         bounds. FSJ of the unit.\n\n{HEAD}",
        spread.name
    );
    let mut lives = format!(
        "\n### A life of {LIFE} tests: FSJ from 1 to 4, a step of {STEP} in the middle, zeta from 0 to 0.3\n\n{} units, every test judged before it is \
         shown to the unit.\n\n{HEAD}",
        n.div_ceil(LIVES_OF)
    );
    let mut times = String::from("\n### A diagnosis of a unit from features, one thread\n\n");
    for sequence in ["preflight", "preflight2"] {
        let (set, setup, prior, calibration) = ready(cache, sequence, grid, &spread)?;
        let command = command_of(sequence);
        let kind = Kind {
            set: &set,
            calibration: &calibration,
            prior: &prior,
        };
        for history in HISTORIES {
            let mut rng = ChaCha8Rng::seed_from_u64(0xF4E5_8000_0000_0000 ^ seed ^ ((history as u64) << 40));
            let grown = |rng: &mut ChaCha8Rng| {
                let end = (rng.random_range(FSJ.0..FSJ.1), rng.random_range(ZETA.0..ZETA.1));
                let along = |k: usize| {
                    let s = k as f64 / (history + 1) as f64;
                    (1.0 + s * (end.0 - 1.0), s * end.1)
                };
                (0..=history + 1).map(along).collect()
            };
            let ours = |units: &[Unit]| measure(&setup, &kind.prior.spread(), units, "units")?.context("interrupted");
            let units = kind.units(n, &mut rng, grown, ours)?;
            let all: Vec<Case> = units.into_iter().filter_map(|mut tests| tests.pop()).collect();
            out += &row(&format!("{sequence} | 1 + {history}"), &all);
            for k in 0..4 {
                let within = |c: &&Case| (c.fsj - 1.0).floor() as usize == k;
                let of: Vec<Case> = all.iter().filter(within).cloned().collect();
                out += &row(&format!("{sequence} | 1 + {history}, FSJ {} to {}", k + 1, k + 2), &of);
            }
            if history == 0 {
                let theirs = |units: &[Unit]| Ok(other_hand::measure(&setup, &kind.prior.spread(), units, &command));
                let units = kind.units(n, &mut rng, grown, theirs)?;
                let all: Vec<Case> = units.into_iter().flatten().collect();
                out += &row(&format!("{sequence}, simulated by another hand | 1 + {history}"), &all);
            }
        }
        let mut rng = ChaCha8Rng::seed_from_u64(0xF4E5_9000_0000_0000 ^ seed);
        let life = |_: &mut ChaCha8Rng| {
            let at = |k: usize| {
                let s = k as f64 / LIFE as f64;
                let step = if 2 * k > LIFE { STEP } else { 0.0 };
                (1.0 + s * (3.0 - STEP) + step, 0.3 * s)
            };
            (0..=LIFE).map(at).collect()
        };
        let ours = |units: &[Unit]| measure(&setup, &kind.prior.spread(), units, "lives")?.context("interrupted");
        let units = kind.units(n.div_ceil(LIVES_OF), &mut rng, life, ours)?;
        let (us, us_95) = kind.time_us(&mut rng, ours)?;
        times += &format!("- {sequence}: {us:.0} us median, {us_95:.0} us at the 95th percentile\n");
        for part in 0..THIRDS {
            let of = |t: &Vec<Case>| t[part * t.len() / THIRDS..(part + 1) * t.len() / THIRDS].to_vec();
            let all: Vec<Case> = units.iter().flat_map(of).collect();
            lives += &row(&format!("{sequence} | third {}", part + 1), &all);
        }
        let after: Vec<Case> = units.iter().map(|t| t[LIFE / 2].clone()).collect();
        lives += &row(&format!("{sequence} | first after the step"), &after);
    }
    Ok(out + &lives + &times)
}

/// A kind of test, and what is known of units before theirs.
pub struct Kind<'a> {
    /// maps
    pub set: &'a FailureMapSet,
    /// simulated units
    pub calibration: &'a UnitCalibration,
    /// constants before any test
    pub prior: &'a Constants,
}

impl Kind<'_> {
    /// Units and what their tests said, all but the acceptance test.
    ///
    /// * `faults` of a unit's tests, in order
    /// * `measure` simulates tests
    fn units(
        &self,
        n: usize,
        rng: &mut ChaCha8Rng,
        faults: impl Fn(&mut ChaCha8Rng) -> Vec<Pair>,
        measure: impl Fn(&[Unit]) -> Result<Vec<RawFeatures>>,
    ) -> Result<Vec<Vec<Case>>> {
        let spread = self.prior.spread();
        let lives: Vec<_> = (0..n).map(|_| (drawn(&spread, rng), faults(rng))).collect();
        let mut tests = Vec::new();
        for (own, faults) in &lives {
            for &(fsj, zeta) in faults {
                tests.push(draw_test(self.prior, *own, rng, |_| FaultState { fsj, zeta }));
            }
        }
        let raw = measure(&tests)?;
        let each = lives.first().map_or(1, |l| l.1.len());
        let of = |(tests, raw): (&[Unit], &[RawFeatures])| self.followed(&spread, tests, raw);
        tests.par_chunks(each).zip(raw.par_chunks(each)).map(of).collect()
    }

    /// Microseconds of a diagnosis of one unit from features: median and 95th percentile.
    fn time_us(
        &self,
        rng: &mut ChaCha8Rng,
        measure: impl Fn(&[Unit]) -> Result<Vec<RawFeatures>>,
    ) -> Result<(f64, f64)> {
        let own = drawn(&self.prior.spread(), rng);
        let mut tests = vec![draw_test(self.prior, own, rng, |_| FaultState::NOMINAL)];
        tests.extend((0..TIMED).map(|_| draw_test(self.prior, own, rng, anywhere)));
        let raw = measure(&tests)?;
        let learnt = after_healthy(self.prior, &[(self.calibration, &[self.set.features(&raw[0])])]);
        let constants = learnt.map_err(|(found, allowed)| anyhow!("a healthy unit is refused: {found} > {allowed}"))?;
        let diagnoser = self
            .calibration
            .diagnoser(self.set.clone(), &constants, 1, COVERAGE, &Vec::new())?;
        Ok(record::time_us(&diagnoser, &tests[1..], &raw[1..]))
    }

    /// An acceptance test and one at random faults of each of some units.
    pub(super) fn draw_accepted(&self, n: usize, seed: u64) -> (Vec<Unit>, Vec<Unit>) {
        let spread = self.prior.spread();
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let one = |_| {
            let own = drawn(&spread, &mut rng);
            let healthy = draw_test(self.prior, own, &mut rng, |_| FaultState::NOMINAL);
            (healthy, draw_test(self.prior, own, &mut rng, anywhere))
        };
        (0..n).map(one).unzip()
    }

    /// What each test of a unit says before it goes in; the first is the acceptance test.
    pub(super) fn followed(&self, spread: &Spread, tests: &[Unit], raw: &[RawFeatures]) -> Result<Vec<Case>> {
        let features: Vec<Features> = raw.iter().map(|r| self.set.features(r)).collect();
        let learnt = after_healthy(self.prior, &[(self.calibration, &features[..1])]);
        let healthy = usize::from(learnt.is_ok());
        let mut constants = learnt.unwrap_or_else(|_| self.prior.clone());
        let mut diagnoser = self
            .calibration
            .diagnoser(self.set.clone(), &constants, healthy, COVERAGE, &Vec::new())?;
        let mut cases = Vec::new();
        let mut worn = 0;
        for (features, test) in features.iter().zip(tests).skip(1) {
            let d = diagnoser.diagnose(features, &[]);
            if matches!(d.outcome, Outcome::Located(_)) && constants.learn_when_worn(healthy) {
                worn += 1;
                constants = constants.after_test(&diagnoser, features, worn).unwrap_or(constants);
                diagnoser = diagnoser.again_with(&constants.factors(&Vec::new()));
            }
            cases.push(Case::of(spread, test, d));
        }
        Ok(cases)
    }
}
