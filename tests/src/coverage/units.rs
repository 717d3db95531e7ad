//! Units with a history: after an acceptance test and a number of later ones, and over a life.

use super::other_hand;
use super::{FSJ, ZETA, maps_of, percent, quantile};
use crate::independent::Command;
use anyhow::{Context, Result};
use diagnoser::diagnosis::{COVERAGE, Diagnoser, Outcome};
use diagnoser::failure_map::FailureMapSet;
use diagnoser::unit::{Constants, UnitCalibration, UnitFile};
use pipeline::calibrate::{Unit, measure};
use pipeline::unit::UnitEffort;
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

/// Of so many units one lives through it.
const LIVES_OF: usize = 5;

const THIRDS: usize = 3;

const HEAD: &str = "| test | history | truth inside % | not located | width FSJ %, median (95th) | width zeta | error FSJ %, median (95th) |\n\
                    |---|---|---|---|---|---|---|\n";

/// One simulated unit: faults of its tests, in order.
struct Life {
    own: [f64; Cause::COUNT],
    faults: Vec<(f64, f64)>,
}

fn drawn(spread: &Spread, rng: &mut ChaCha8Rng) -> [f64; Cause::COUNT] {
    std::array::from_fn(|c| {
        let x = rng.random_range(-1.0..1.0);
        if spread.half_width[c] > 0.0 { x } else { 0.0 }
    })
}

/// The tests of all units; what is of a test is another one in each.
fn tests_of(lives: &[Life], prior: &Constants, rng: &mut ChaCha8Rng) -> Vec<Unit> {
    let mut tests = Vec::new();
    for life in lives {
        for &(fsj, zeta) in &life.faults {
            let mut draw = life.own;
            for (c, _) in &prior.of_test {
                draw[*c as usize] = rng.random_range(-1.0..1.0);
            }
            tests.push(Unit {
                fault: FaultState { fsj, zeta },
                draw,
                seed: rng.random(),
            });
        }
    }
    tests
}

/// What became of a test.
#[derive(Clone, Debug)]
struct Seen {
    fault: (f64, f64),
    outcome: &'static str,
    /// both true faults in their intervals
    inside: bool,
    /// of FSJ, relative, and of zeta
    width: Option<(f64, f64)>,
    /// of FSJ, relative
    error: Option<f64>,
}

impl Seen {
    fn of(d: &Outcome, fault: (f64, f64)) -> Self {
        let area = d.area();
        Self {
            fault,
            outcome: d.name(),
            inside: area.is_some_and(|a| a.fsj.contains(fault.0) && a.zeta.contains(fault.1)),
            width: area.map(|a| (a.fsj.width() / fault.0, a.zeta.width())),
            error: area.map(|a| a.centroid.0 / fault.0 - 1.0),
        }
    }
}

fn row(title: &str, all: &[Seen]) -> String {
    let inside = all.iter().filter(|s| s.inside).count();
    let refused = all.iter().filter(|s| s.outcome != "located").count();
    let w = |q, f: fn((f64, f64)) -> f64| quantile(all.iter().filter_map(|s| s.width.map(f)), q);
    let e = |q| quantile(all.iter().filter_map(|s| s.error).map(|e| 100.0 * e.abs()), q);
    format!(
        "| {title} | {} | {refused} | {:.2} ({:.2}) | {:.4} | {:.2} ({:.2}) |\n",
        percent(inside, all.len()),
        100.0 * w(0.5, |w| w.0),
        100.0 * w(0.95, |w| w.0),
        w(0.5, |w| w.1),
        e(0.5),
        e(0.95)
    )
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
    for sequence in ["preflight", "preflight2"] {
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
        let command = match sequence {
            "preflight" => Command::Preflight,
            _ => Command::Preflight2,
        };
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
            let all: Vec<Seen> = units.into_par_iter().filter_map(|mut tests| tests.pop()).collect();
            out += &row(&format!("{sequence} | 1 + {history}"), &all);
            for k in 0..4 {
                let within = |s: &&Seen| (s.fault.0 - 1.0).floor() as usize == k;
                let of: Vec<Seen> = all.iter().filter(within).cloned().collect();
                out += &row(&format!("{sequence} | 1 + {history}, FSJ {} to {}", k + 1, k + 2), &of);
            }
            if history == 0 {
                let theirs = |units: &[Unit]| Ok(other_hand::measure(&setup, &kind.prior.spread(), units, &command));
                let units = kind.units(n, &mut rng, grown, theirs)?;
                let all: Vec<Seen> = units.into_iter().flatten().collect();
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
        for part in 0..THIRDS {
            let of = |t: &Vec<Seen>| t[part * t.len() / THIRDS..(part + 1) * t.len() / THIRDS].to_vec();
            let all: Vec<Seen> = units.iter().flat_map(of).collect();
            lives += &row(&format!("{sequence} | third {}", part + 1), &all);
        }
        let after: Vec<Seen> = units.iter().map(|t| t[LIFE / 2].clone()).collect();
        lives += &row(&format!("{sequence} | first after the step"), &after);
    }
    Ok(out + &lives)
}

/// A kind of test, and what is known of units before theirs.
struct Kind<'a> {
    set: &'a FailureMapSet,
    calibration: &'a UnitCalibration,
    prior: &'a Constants,
}

impl Kind<'_> {
    /// Units and what their tests said, all but the acceptance test.
    ///
    /// * `measure` simulates tests
    fn units(
        &self,
        n: usize,
        rng: &mut ChaCha8Rng,
        faults: impl Fn(&mut ChaCha8Rng) -> Vec<(f64, f64)>,
        measure: impl Fn(&[Unit]) -> Result<Vec<RawFeatures>>,
    ) -> Result<Vec<Vec<Seen>>> {
        let spread = self.prior.spread();
        let lives: Vec<Life> = (0..n)
            .map(|_| Life {
                own: drawn(&spread, rng),
                faults: faults(rng),
            })
            .collect();
        let tests = tests_of(&lives, self.prior, rng);
        let raw = measure(&tests)?;
        let each = lives.first().map_or(1, |l| l.faults.len());
        let of = |(life, raw): (&Life, &[RawFeatures])| self.followed(&life.faults, raw);
        lives.par_iter().zip(raw.par_chunks(each)).map(of).collect()
    }

    /// What each test says before it goes in; the first is the acceptance test.
    fn followed(&self, faults: &[(f64, f64)], raw: &[RawFeatures]) -> Result<Vec<Seen>> {
        let features: Vec<Features> = raw.iter().map(|r| self.set.features(r)).collect();
        let mut constants = self
            .calibration
            .healthy(self.prior, &features[..1])
            .unwrap_or_else(|_| self.prior.clone());
        let none = Vec::new();
        let base: Diagnoser = self
            .calibration
            .diagnoser(self.set.clone(), &constants, 1, COVERAGE, &none)?;
        let mut seen = Vec::new();
        let mut taken = 0;
        for (features, fault) in features.iter().zip(faults).skip(1) {
            let d = base.again_with(&constants.factors(&none));
            let outcome = d.diagnose(features, &[]).outcome;
            if matches!(outcome, Outcome::Located(_)) && constants.learn_when_worn(1) {
                taken += 1;
                constants = constants.after_test(&d, features, taken).unwrap_or(constants);
            }
            seen.push(Seen::of(&outcome, *fault));
        }
        Ok(seen)
    }
}
