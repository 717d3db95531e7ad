//! Diagnoses of a fleet's tests: by each actuator's own maps, by those of the type, or by its unit file.

use super::maps::{maps_of, pairs};
use super::{Dataset, Rows, grids, wear};
use crate::calibrate::{Effort, draw_units, measure, range, score_all, scores, unscored};
use anyhow::Result;
use arrow::array::{Array, ArrayRef, Float64Array, RecordBatch, StringArray, TimestampMicrosecondArray, UInt64Array};
use arrow::datatypes::{DataType, Field, Schema};
use diagnoser::calibration::{COVERAGE, Calibration};
use diagnoser::diagnosis::{Diagnoser, Diagnosis, Outcome, Score};
use diagnoser::failure_map::FailureMapSet;
use diagnoser::unit::UnitFile;
use schemas::error::Error;
use schemas::fault::{FaultGrid, FaultState, Interval};
use schemas::feature::{Features, RawFeatures};
use schemas::table::table_bytes;
use sim_worker::dataset::parts::{Kind, Part};
use sim_worker::dataset::wear::WornTest;
use sim_worker::noise::FeatureValues;
use sim_worker::setup::TestSetup;
use sim_worker::spread::Spread;
use std::collections::BTreeMap;
use std::sync::Arc;

/// Fewest tests of the fleet that a calibration is made from; with fewer, tests are simulated for it.
const FEWEST: usize = 50;

/// A test of one actuator.
struct Test {
    run: u64,
    /// place in the life of an actuator that wears
    worn: Option<WornTest>,
    actuator: usize,
    sequence: usize,
    fault: FaultState,
    features: Features,
}

/// What the reach of the intervals comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Grounds {
    /// tests of the fleet, this many for each half: odd ones are calibrated by even ones and the other way round
    Halves(usize),
    /// this many tests of the same actuators at random faults, simulated for the purpose
    Simulated(usize),
    /// the calibration that the maps of the type bring
    OfMaps,
    /// simulated units like each of the units
    OfUnits,
    /// nothing: intervals reach as far as designed
    Design,
}

/// What was diagnosed.
#[derive(Clone, Debug)]
pub struct Diagnosed {
    pub tests: usize,
    pub located: usize,
    /// located tests whose exact pair lies in both intervals
    pub inside: usize,
    /// what the reach of the intervals comes from
    pub grounds: Grounds,
    /// actuators without maps, and why
    pub refused: Vec<String>,
    pub path: String,
}

fn tests<'a>(d: &'a Dataset, set: &'a FailureMapSet, rows: &'a [Rows<'a>]) -> impl Iterator<Item = Test> + 'a {
    let parts = rows.iter().filter(|r| r.part.kind == Kind::Test);
    parts.flat_map(move |r| {
        let rest = Some(set.header.kind.rest_angle_rad);
        let stored = move |v: &FeatureValues| RawFeatures::from_values(v.map(|x| x.0), rest);
        let runs = r.part.runs.clone().zip(r.values.iter().map(stored));
        runs.map(move |(run, raw)| test(d, set, r.part, run, &raw))
    })
}

fn test(d: &Dataset, set: &FailureMapSet, part: &Part, run: u64, raw: &RawFeatures) -> Test {
    Test {
        run,
        worn: d.plan.worn(part, run).copied(),
        actuator: part.actuator,
        sequence: part.sequence,
        fault: d.plan.fault(part, run),
        features: set.features(raw),
    }
}

/// An actuator with its maps.
struct Own {
    actuator: usize,
    sequence: usize,
    rest: usize,
    maps: FailureMapSet,
}

/// A calibration from the scores of tests.
fn calibration(scores: &[Score]) -> Calibration {
    let effort = Effort {
        runs: scores.len(),
        surface_runs: 0,
        seed: 0,
    };
    let mut c = unscored(&Spread::none(), effort, String::new(), None);
    score_all(&mut c, scores);
    c
}

/// Scores of simulated tests: each actuator's at random faults, through the sensors of the dataset. As many in all as
/// maps that are made on first use are calibrated with.
fn simulated(d: &Dataset, sets: &[Own]) -> Result<Vec<Score>> {
    let each = Effort::QUICK.runs.div_ceil(sets.len().max(1));
    let mut all = Vec::new();
    for (own, k) in sets.iter().zip(0u64..) {
        let (fsj, zeta) = range(&own.maps);
        // apart from the seeds of the plan's own runs
        let seed = d
            .plan
            .seed
            .wrapping_mul(2)
            .wrapping_add(0xD << 56)
            .wrapping_add(k << 32);
        let units = draw_units(fsj, zeta, &Spread::none(), each, seed);
        let setup = d.plan.setup(own.actuator, own.sequence, own.rest);
        let title = format!("calibration {}", d.plan.actuators[own.actuator].id);
        let measured = measure(&setup, &Spread::none(), &units, &title)?.ok_or(crate::Interrupted)?;
        all.extend(scores(&Diagnoser::uncalibrated(own.maps.clone()), &units, &measured));
    }
    Ok(all)
}

/// Each actuator's tests by its own maps. The reach of the intervals comes from tests of the whole fleet: odd
/// tests are calibrated by even ones and the other way round, so that none is calibrated by itself. Where they are
/// too few, it comes from tests that are simulated for it.
///
/// # Errors
/// Refuses a plan without tests and a dataset that cannot be read; may be interrupted ([`crate::Interrupted`]).
pub fn by_own_maps(d: &Dataset) -> Result<Diagnosed> {
    refuse_without_tests(d)?;
    let mut all: Vec<(usize, Test)> = Vec::new();
    let mut sets: Vec<Own> = Vec::new();
    let mut refused = Vec::new();
    d.each_actuator(|actuator, rows| {
        // tests are of the first sequence, from the first rest angle
        let Some((sequence, rest, values)) = grids(rows).into_iter().next() else {
            return Ok(());
        };
        match maps_of(d, actuator, sequence, rest, &values, true) {
            Ok(maps) => {
                all.extend(tests(d, &maps, rows).map(|t| (sets.len(), t)));
                sets.push(Own {
                    actuator,
                    sequence,
                    rest,
                    maps,
                });
            }
            Err(e) => refused.push(e.to_string()),
        }
        Ok(())
    })?;
    let mut halves: [Vec<Score>; 2] = Default::default();
    for (k, own) in sets.iter().enumerate() {
        let bare = Diagnoser::uncalibrated(own.maps.clone());
        let tests = all.iter().filter(|(s, _)| *s == k).enumerate();
        for (i, (_, t)) in tests {
            halves[i % 2].extend(bare.score(&t.features, t.fault.fsj, t.fault.zeta));
        }
    }
    let fewest = halves[0].len().min(halves[1].len());
    let (grounds, calibrations) = if fewest >= FEWEST {
        (Grounds::Halves(fewest), halves.each_ref().map(|s| calibration(s)))
    } else {
        let c = calibration(&simulated(d, &sets)?);
        (Grounds::Simulated(c.runs), [c.clone(), c])
    };
    let mut results = Vec::new();
    for (k, own) in sets.into_iter().enumerate() {
        let by = |half: usize| {
            let c = Some(calibrations[1 - half].clone());
            Diagnoser::new(own.maps.clone(), c, COVERAGE, &Vec::new())
        };
        let diagnosers = [by(0)?, by(1)?];
        let tests = all.iter().filter(|(s, _)| *s == k).enumerate();
        results.extend(tests.map(|(i, (_, t))| (t, diagnosers[i % 2].diagnose(&t.features, &[]))));
    }
    write(d, "own", &results, grounds, refused)
}

/// All tests by the maps of the type, which bring their own calibration.
pub fn by_type(d: &Dataset, diagnoser: &Diagnoser) -> Result<Diagnosed> {
    let mut all = Vec::new();
    d.each_actuator(|_, rows| {
        all.extend(tests(d, &diagnoser.maps, rows));
        Ok(())
    })?;
    let results: Vec<(&Test, Diagnosis)> = all.iter().map(|t| (t, diagnoser.diagnose(&t.features, &[]))).collect();
    let grounds = match diagnoser.calibration {
        Some(_) => Grounds::OfMaps,
        None => Grounds::Design,
    };
    write(d, "type", &results, grounds, Vec::new())
}

/// Tests of actuators that are known, each by its own unit file. Features are formed with the constants of its model: from the
/// telemetry, unless the dataset's were formed with the same. Actuators without a file are not diagnosed, and named.
///
/// * `units` by the names of their actuators
/// * `grid` of maps that are made on first use
///
/// # Errors
/// Refuses a plan without tests, one with a load, and a dataset that cannot be read; may be interrupted
/// ([`crate::Interrupted`]).
pub fn by_units(d: &Dataset, units: &BTreeMap<String, Arc<UnitFile>>, grid: &FaultGrid) -> Result<Diagnosed> {
    refuse_without_tests(d)?;
    if d.plan.load_n_m != 0.0 {
        let allowed = "0: units know tests without a load";
        return Err(Error::bad(d.storage.describe(), "load_n_m", d.plan.load_n_m, allowed).into());
    }
    let (mut all, mut diagnoses) = (Vec::new(), Vec::new());
    let mut refused = Vec::new();
    d.each_actuator(|actuator, rows| {
        let of_tests: Vec<&Rows> = rows.iter().filter(|r| r.part.kind == Kind::Test).collect();
        let Some(first) = of_tests.first().map(|r| r.part) else {
            return Ok(());
        };
        let id = &d.plan.actuators[actuator].id;
        let Some(unit) = units.get(id) else {
            refused.push(format!("{id}: no unit file of this name"));
            return Ok(());
        };
        let stored = d.plan.setup(actuator, first.sequence, first.rest);
        let setup = TestSetup {
            actuator: Arc::new(unit.actuator.clone()),
            ..stored.clone()
        };
        let request = crate::unit::request(&setup, grid.clone());
        let diagnoser = crate::unit::made(&request, unit, COVERAGE, &Vec::new())?;
        let plan = Arc::new(setup.feature_plan());
        let maps = &diagnoser.maps;
        let of_unit: Vec<Test> = if *plan == stored.feature_plan() {
            tests(d, maps, rows).collect()
        } else if of_tests.iter().all(|r| r.part.telemetry) {
            let of_part = |r: &&Rows| -> Result<Vec<Test>> {
                let runs = r.part.runs.clone().zip(super::export::features(d, r.part, &plan)?);
                Ok(runs.map(|(run, raw)| test(d, maps, r.part, run, &raw)).collect())
            };
            of_tests
                .iter()
                .map(of_part)
                .collect::<Result<Vec<_>>>()?
                .into_iter()
                .flatten()
                .collect()
        } else {
            refused.push(format!(
                "{id}: its features were formed with other constants than its unit file's, and no telemetry was kept \
                 ([telemetry] with of = \"test\" in the plan)"
            ));
            return Ok(());
        };
        diagnoses.extend(of_unit.iter().map(|t| diagnoser.diagnose(&t.features, &[])));
        all.extend(of_unit);
        Ok(())
    })?;
    let results: Vec<(&Test, Diagnosis)> = all.iter().zip(diagnoses).collect();
    write(d, "unit", &results, Grounds::OfUnits, refused)
}

fn refuse_without_tests(d: &Dataset) -> Result<()> {
    if d.plan.tests_per_actuator > 0 {
        return Ok(());
    }
    let allowed = "[tests] per_actuator of at least 1 in the plan";
    Err(Error::bad(d.storage.describe(), "runs", "no tests", allowed).into())
}

fn write(
    d: &Dataset,
    maps: &str,
    results: &[(&Test, Diagnosis)],
    grounds: Grounds,
    refused: Vec<String>,
) -> Result<Diagnosed> {
    let text = |f: &dyn Fn(&Test, &Diagnosis) -> String| -> ArrayRef {
        Arc::new(StringArray::from_iter_values(results.iter().map(|(t, r)| f(t, r))))
    };
    let number = |f: &dyn Fn(&Test, &Diagnosis) -> Option<f64>| -> ArrayRef {
        Arc::new(results.iter().map(|(t, r)| f(t, r)).collect::<Float64Array>())
    };
    let hull = |f: &dyn Fn(&diagnoser::diagnosis::Area) -> f64| number(&|_, r| r.outcome.area().map(f));
    let contradicting = |r: &Diagnosis| match &r.outcome {
        Outcome::Unexplained { contradicting, .. } => {
            contradicting.iter().map(|f| f.name()).collect::<Vec<_>>().join(",")
        }
        _ => String::new(),
    };
    let actuator = |t: &Test| &d.plan.actuators[t.actuator];
    let mut list: Vec<(&str, DataType, bool, ArrayRef)> = vec![
        (
            "run",
            DataType::UInt64,
            false,
            Arc::new(UInt64Array::from_iter_values(results.iter().map(|(t, _)| t.run))),
        ),
        ("actuator", DataType::Utf8, false, text(&|t, _| actuator(t).id.clone())),
        ("tail", DataType::Utf8, false, text(&|t, _| actuator(t).tail.clone())),
        (
            "position",
            DataType::Utf8,
            false,
            text(&|t, _| actuator(t).position.clone()),
        ),
        (
            "sequence",
            DataType::Utf8,
            false,
            text(&|t, _| d.plan.sequences[t.sequence].name.clone()),
        ),
        ("fsj", DataType::Float64, true, number(&|t, _| Some(t.fault.fsj))),
        ("zeta", DataType::Float64, true, number(&|t, _| Some(t.fault.zeta))),
        ("outcome", DataType::Utf8, false, text(&|_, r| r.outcome.name().into())),
        ("fsj_lo", DataType::Float64, true, hull(&|a| a.fsj.lo)),
        ("fsj_hi", DataType::Float64, true, hull(&|a| a.fsj.hi)),
        ("fsj_estimate", DataType::Float64, true, hull(&|a| a.centroid.0)),
        ("zeta_lo", DataType::Float64, true, hull(&|a| a.zeta.lo)),
        ("zeta_hi", DataType::Float64, true, hull(&|a| a.zeta.hi)),
        ("zeta_estimate", DataType::Float64, true, hull(&|a| a.centroid.1)),
        ("area", DataType::Float64, true, hull(&|a| a.size)),
        (
            "coverage",
            DataType::Float64,
            true,
            number(&|_, r| (grounds != Grounds::Design).then_some(r.coverage)),
        ),
        ("contradicting", DataType::Utf8, false, text(&|_, r| contradicting(r))),
        ("reason", DataType::Utf8, false, text(&|_, r| r.outcome.reason().into())),
        ("maps", DataType::Utf8, false, text(&|_, _| maps.into())),
    ];
    if d.plan.life(0).is_some() {
        // a test of a life has its place in it
        let worn = |f: fn(&WornTest) -> f64| number(&|t, _| t.worn.as_ref().map(f));
        let time = results.iter().map(|(t, _)| t.worn.map(|w| wear::microseconds(w.day)));
        let time = TimestampMicrosecondArray::from_iter(time).with_timezone("UTC");
        let base = |t: &Test| actuator(t).parameters.temperature_degc;
        let warm = number(&|t, _| t.worn.map(|w| base(t) + w.warmer_k));
        list.extend([
            ("cycle", DataType::Float64, true, worn(|w| w.flight as f64)),
            ("time", time.data_type().clone(), true, Arc::new(time) as ArrayRef),
            ("winding_temperature_degc", DataType::Float64, true, warm),
        ]);
        wear::write(d)?;
    }
    let fields: Vec<Field> = list
        .iter()
        .map(|(n, t, null, _)| Field::new(*n, t.clone(), *null))
        .collect();
    let columns = list.into_iter().map(|c| c.3).collect();
    let batch = RecordBatch::try_new(Arc::new(Schema::new(fields)), columns)?;
    let path = format!("diagnoses/part-{maps}.parquet");
    d.storage.replace(&path, table_bytes(&[batch], pairs(d))?)?;
    let located = results.iter().filter(|(_, r)| matches!(r.outcome, Outcome::Located(_)));
    let holds = |t: &Test, fsj: Interval, zeta: Interval| fsj.contains(t.fault.fsj) && zeta.contains(t.fault.zeta);
    let inside = located
        .clone()
        .filter(|(t, r)| r.outcome.area().is_some_and(|a| holds(t, a.fsj, a.zeta)));
    Ok(Diagnosed {
        tests: results.len(),
        located: located.clone().count(),
        inside: inside.count(),
        grounds,
        refused,
        path,
    })
}
