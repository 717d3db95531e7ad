//! Features of a fault grid become failure maps; maps made on first use are kept.

use crate::calibrate::{Effort, calibrate};
use crate::dataset::{self, Dataset};
use crate::progress::note;
use anyhow::Result;
use diagnoser::diagnosis::{Diagnoser, Known};
use diagnoser::failure_map::{FailureMap, FailureMapSet, MapSetHeader};
use diagnoser::map_library::{Choice, FILE};
use schemas::error::Error;
use schemas::fault::FaultGrid;
use schemas::feature::{Feature, Raw, RawFeatures};
use schemas::fingerprint::fingerprint;
use schemas::sequence::{Command, TestSequence};
use sim_worker::cache::cache_dir;
use sim_worker::dataset::one::OneActuator;
use sim_worker::dataset::plan::DatasetPlan;
use sim_worker::dataset::storage::Storage;
use sim_worker::setup::TestSetup;
use std::path::{Path, PathBuf};

/// Hash of the sources that saved maps depend on beyond the features that they are made of.
const SOURCE: &str = env!("EMA_SOURCE");

/// What maps are made for.
#[derive(Clone, Debug)]
pub struct MapRequest {
    /// the tests
    pub setup: TestSetup,
    /// fault pairs that are simulated
    pub grid: FaultGrid,
}

impl MapRequest {
    fn plan(&self) -> Result<DatasetPlan> {
        Ok(DatasetPlan::of_one(&OneActuator {
            setup: &self.setup,
            grid: &self.grid,
            rest_angles_rad: &[],
            seed: 0,
            telemetry: None,
        })?)
    }
}

/// Folder of the cache that maps for a request are kept in.
pub(crate) fn cached_in(request: &MapRequest) -> Result<PathBuf> {
    let key = fingerprint(&format!("{};{SOURCE}", request.plan()?.fingerprint()));
    Ok(cache_dir().join("maps").join(key))
}

/// File that maps for a request are kept in.
///
/// # Errors
/// Refuses a grid that makes no maps.
pub fn cache_file(request: &MapRequest) -> Result<PathBuf> {
    Ok(cached_in(request)?.join(FILE))
}

/// Maps for a request from the cache, with their calibration; `None` where either is not there.
///
/// # Errors
/// Refuses a grid that makes no maps, and what [`Choice::ready`] refuses.
pub fn found(request: &MapRequest, choice: &Choice) -> Result<Option<Diagnoser>> {
    let file = cached_in(request)?.join(FILE);
    let Ok(set) = FailureMapSet::load(&file) else {
        return Ok(None);
    };
    match choice.calibration(&file, &set) {
        Ok(Some(_)) => Ok(Some(choice.ready(&file, set, &Vec::new())?)),
        _ => Ok(None),
    }
}

/// Maps for a request from the cache, made and calibrated on first use.
///
/// * `known` of the unit, as on the command line
///
/// # Errors
/// As [`made`] and [`calibrated`].
pub fn cached(request: &MapRequest, choice: &Choice, known: &Known) -> Result<Diagnoser> {
    let dir = cached_in(request)?;
    let set = made(&dir, request)?;
    calibrated(&dir.join(FILE), set, &request.setup, choice, known)
}

/// Saved maps made ready, calibrated quickly where there is no calibration beside them that can be used.
///
/// # Errors
/// Refuses what [`Choice::ready`] refuses; fails where the calibration cannot be written, or is interrupted
/// ([`crate::Interrupted`]).
pub fn calibrated(
    file: &Path,
    set: FailureMapSet,
    setup: &TestSetup,
    choice: &Choice,
    known: &Known,
) -> Result<Diagnoser> {
    if !matches!(choice.calibration(file, &set), Ok(Some(_))) {
        let n = Effort::QUICK.runs
            + if choice.spread.is_none() {
                0
            } else {
                Effort::QUICK.surface_runs
            };
        note(&format!(
            "calibrating the maps ({n} runs, spread {})",
            choice.spread.name
        ));
        let made = calibrate(&set, setup, &choice.spread, Effort::QUICK)?.ok_or(crate::Interrupted)?;
        made.save(&choice.calibration_file(file))?;
    }
    Ok(choice.ready(file, set, known)?)
}

/// Maps for a request from a folder, made there on first use: beside the dataset that they come from.
///
/// # Errors
/// Refuses a grid that makes no maps; fails where the folder cannot be written, or the simulation is
/// interrupted ([`crate::Interrupted`]).
pub fn made(dir: &Path, request: &MapRequest) -> Result<FailureMapSet> {
    let file = dir.join(FILE);
    if let Ok(set) = FailureMapSet::load(&file) {
        return Ok(set);
    }
    let plan = request.plan()?;
    note(&format!(
        "making failure maps ({} runs, kept in {})",
        plan.runs(),
        dir.display()
    ));
    let storage = Storage::open(&dir.display().to_string())?;
    dataset::make(&plan, &storage, "maps")?.ok_or(crate::Interrupted)?;
    let set = dataset::maps::of_one(&Dataset::of(storage)?, true)?;
    for l in &set.header.left_out {
        note(&format!("left out: {l}"));
    }
    set.save(&file)?;
    Ok(set)
}

/// The map of a feature with the direction that it usually has, or else with another one: at some rest
/// angles rise time and currents fall with the eccentricity. The error is that of the usual direction.
fn declared(
    file: &str,
    feature: Feature,
    fsj: &[f64],
    zeta: &[f64],
    raw: &[f64],
    noise: f64,
    sample: f64,
) -> Result<FailureMap, Error> {
    let build = |direction| FailureMap::build(file, feature, direction, fsj, zeta, raw.to_vec(), noise, sample);
    let (along, across) = feature.direction();
    let others = [(along, -across), (-along, across), (-along, -across)];
    build((along, across)).or_else(|e| others.into_iter().find_map(|d| build(d).ok()).ok_or(e))
}

/// Raw features of every point of a fault grid, and their standard deviations over noise seeds; zeta
/// outer, FSJ inner.
#[derive(Clone, Debug)]
pub struct GridFeatures {
    /// lines of the grid, rising
    pub fsj: Vec<f64>,
    /// lines of the grid, rising
    pub zeta: Vec<f64>,
    /// one a point, zeta outer, FSJ inner
    pub measured: Vec<RawFeatures>,
    /// in the same order; what is missing counts as 0
    pub deviations: Vec<RawFeatures>,
}

/// The maps of a grid.
///
/// * `file` for messages
/// * `header` what the maps are for; what is left out is added
/// * `lenient` leave out a feature whose surface is not monotone enough (the set then says so)
///   instead of refusing: at some rest angles P2 or P3 do not rise everywhere
///
/// # Errors
/// Refuses a grid without healthy point (FSJ 1, zeta 0) or without any map, more maps than can be inverted
/// together, and, unless `lenient`, a surface that is not monotone enough.
pub fn of_grid(
    file: &str,
    mut header: MapSetHeader,
    sequence: &TestSequence,
    grid: &GridFeatures,
    lenient: bool,
) -> Result<FailureMapSet> {
    let GridFeatures {
        fsj,
        zeta,
        measured,
        deviations,
    } = grid;
    let n = fsj.len();
    let rows = measured.len();
    let healthy = (0..rows).find(|i| fsj[i % n] == 1.0 && zeta[i / n] == 0.0);
    let healthy = healthy.ok_or_else(|| Error::bad(file, "grid", "no healthy point", "FSJ 1, zeta 0 on the grid"))?;
    let nominal = measured[healthy];
    let slope = sequence.segments.iter().find_map(|s| match s.command {
        Command::Ramp { slope_rad_per_s } => Some(slope_rad_per_s.abs()),
        _ => None,
    });
    let (mut maps, mut witnesses) = (Vec::new(), Vec::new());
    let mut left_out = Vec::new();
    for feature in Feature::every() {
        let value = |i: usize| feature.value(&measured[i], &nominal);
        let raw: Vec<Option<f64>> = (0..rows).map(value).collect();
        if raw.iter().all(Option::is_none) {
            continue;
        }
        let raw: Vec<f64> = raw.into_iter().map(|v| v.unwrap_or(f64::NAN)).collect();
        let sd = |i: usize| feature.deviation(&measured[i], &deviations[i], &nominal);
        let mut noise: Vec<f64> = (0..rows).map(sd).collect();
        noise.sort_by(f64::total_cmp);
        let noise = noise[(noise.len() - 1) * 19 / 20];
        let sample = match (feature, slope, nominal[Raw::P3]) {
            (Feature::P3, Some(a), Some(p0)) => a / header.kind.rate_hz / p0,
            _ => 0.0,
        };
        if feature.is_witness() {
            witnesses.extend(FailureMap::of_witness(feature, fsj, zeta, raw, noise));
            continue;
        }
        if Feature::CAUSES.contains(&feature) {
            maps.extend(FailureMap::of_cause(feature, fsj, zeta, raw, noise));
            continue;
        }
        let built = declared(file, feature, fsj, zeta, &raw, noise, sample);
        if Feature::OF_UNITS.contains(&feature) {
            // beside the others, where it serves
            maps.extend(built.ok());
            continue;
        }
        match built {
            Ok(m) => maps.push(m),
            Err(Error::Bad {
                place, found, allowed, ..
            }) if lenient || Feature::FINER.contains(&feature) => {
                left_out.push(format!("{}: {place}: {found}; allowed: {allowed}", feature.name()));
            }
            Err(e) => return Err(e.into()),
        }
    }
    if !maps.iter().any(|m| Feature::ALL.contains(&m.feature)) {
        return Err(Error::bad(
            file,
            "features",
            "none",
            format!("at least one map from `{}`", sequence.name),
        )
        .into());
    }
    header.left_out = left_out;
    let set = FailureMapSet {
        header,
        nominal,
        maps,
        witnesses,
    };
    set.check(file)?;
    Ok(set)
}
