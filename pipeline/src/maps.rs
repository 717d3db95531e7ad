//! The map builder: features of a dataset, read with polars, become failure maps.

use crate::calibrate::{Effort, TestKind, calibrate};
use crate::generate::{Plan, generate};
use crate::progress::note;
use anyhow::Result;
use diagnoser::diagnosis::{Diagnoser, Known};
use diagnoser::failure_map::{FailureMap, FailureMapSet, MapSetHeader};
use diagnoser::map_library::{Choice, REST_ANGLE_TOLERANCE_RAD};
use polars::prelude::*;
use schemas::channel::ChannelSet;
use schemas::error::Error;
use schemas::fault::FaultGrid;
use schemas::feature::{Feature, Raw, RawFeatures};
use schemas::recording::{Provenance, metadata};
use schemas::sequence::{Command, TestSequence};
use sim_worker::parameters::ActuatorParameters;
use sim_worker::sensor::SensorModel;
use sim_worker::simulate::Experiment;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// What maps are made for.
#[derive(Clone, Debug)]
pub struct MapRequest {
    pub actuator: Arc<ActuatorParameters>,
    pub sequence: TestSequence,
    pub rate_hz: f64,
    pub sensors: Option<SensorModel>,
    pub rest_angle_rad: f64,
    pub equivalent_current: bool,
    pub grid: FaultGrid,
}

impl MapRequest {
    /// The kind of tests that the maps are for.
    pub fn kind(&self) -> TestKind {
        TestKind {
            actuator: self.actuator.clone(),
            sequence: self.sequence.clone(),
            sensors: self.sensors.clone(),
            rate_hz: self.rate_hz,
            rest_angle_rad: self.rest_angle_rad,
            load_n_m: 0.0,
            equivalent_current: self.equivalent_current,
        }
    }

    fn plan(&self) -> Result<Plan> {
        let step = self.actuator.step_s;
        let channels = ChannelSet::basic();
        let experiment = Experiment::new(
            self.sequence.clone(),
            self.rate_hz,
            channels,
            self.sensors.clone(),
            step,
        )?;
        Ok(Plan {
            actuator: self.actuator.clone(),
            grid: self.grid.clone(),
            rest_angles_rad: vec![self.rest_angle_rad],
            load_n_m: 0.0,
            experiment,
            seed: 0,
            keep_telemetry: false,
            keep_features: true,
            equivalent_current: self.equivalent_current,
        })
    }
}

/// Folder of cached maps: `EMA_CACHE_DIR`, else `XDG_CACHE_HOME/ema`, else `~/.cache/ema`.
pub fn cache_dir() -> PathBuf {
    let var = |k: &str| std::env::var_os(k).filter(|v| !v.is_empty()).map(PathBuf::from);
    var("EMA_CACHE_DIR")
        .or_else(|| var("XDG_CACHE_HOME").map(|p| p.join("ema")))
        .or_else(|| var("HOME").map(|p| p.join(".cache/ema")))
        .unwrap_or_else(|| std::env::temp_dir().join("ema-cache"))
}

/// Maps for a request from the cache, made and calibrated on first use.
///
/// * `known` of the unit, as on the command line
pub fn cached(request: &MapRequest, choice: &Choice, known: &Known) -> Result<Diagnoser> {
    let dir = cache_dir().join("maps").join(request.plan()?.fingerprint());
    let set = made(&dir, request)?;
    calibrated(&dir.join("maps.parquet"), set, &request.kind(), choice, known)
}

/// Saved maps made ready, calibrated quickly where there is no calibration beside them that can be used.
pub fn calibrated(
    file: &Path,
    set: FailureMapSet,
    kind: &TestKind,
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
        let made = calibrate(&set, kind, &choice.spread, Effort::QUICK)?.ok_or(crate::Interrupted)?;
        made.save(&choice.calibration_file(file))?;
    }
    Ok(choice.ready(file, set, known)?)
}

/// Maps for a request from a folder, made there on first use.
pub fn made(dir: &Path, request: &MapRequest) -> Result<FailureMapSet> {
    let plan = request.plan()?;
    let file = dir.join("maps.parquet");
    if let Ok(set) = FailureMapSet::load(&file) {
        return Ok(set);
    }
    let n = plan.runs().len();
    note(&format!("making failure maps ({n} runs, kept in {})", dir.display()));
    loop {
        match generate(&plan, dir, "maps") {
            Ok(Some(_)) => break,
            Ok(None) => return Err(crate::Interrupted.into()),
            // somebody else is making the same maps: wait for them
            Err(Error::Io { what: "is in use", .. }) if !crate::progress::interrupted() => {
                std::thread::sleep(std::time::Duration::from_millis(200));
                if let Ok(set) = FailureMapSet::load(&file) {
                    return Ok(set);
                }
            }
            Err(e) => return Err(e.into()),
        }
    }
    let set = build(
        dir,
        &request.sequence,
        &request.actuator,
        request.equivalent_current,
        None,
        true,
    )?;
    for l in &set.header.left_out {
        note(&format!("left out: {l}"));
    }
    set.save(&file)?;
    Ok(set)
}

/// A path that polars takes as a pattern only where it is meant as one.
pub fn scan(pattern: &Path) -> Result<LazyFrame> {
    let path = PlRefPath::new(pattern.to_string_lossy());
    LazyFrame::scan_parquet(path, ScanArgsParquet::default()).map_err(|e| Error::torn(pattern, e).into())
}

/// The first features file of a dataset.
pub fn first_file(dir: &Path) -> Result<PathBuf> {
    let features = dir.join("features");
    let list = std::fs::read_dir(&features).map_err(|e| Error::io(&features, "cannot be read", e))?;
    let mut files: Vec<PathBuf> = list
        .flatten()
        .map(|e| e.path())
        .filter(|p| p.extension().is_some_and(|x| x == "parquet"))
        .collect();
    files.sort();
    let allowed = "a dataset with features (ema simulate)";
    files
        .into_iter()
        .next()
        .ok_or_else(|| Error::bad(features.display().to_string(), "folder", "no Parquet files", allowed).into())
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

/// Builds the maps of a dataset.
///
/// * `dir` dataset folder with `features/`
/// * `rest_angle_rad` which of the dataset's rest angles; the only one if `None`
/// * `lenient` leave out a feature whose surface is not monotone enough (the set then says so)
///   instead of refusing: at some rest angles P2 or P3 do not rise everywhere
pub fn build(
    dir: &Path,
    sequence: &TestSequence,
    actuator: &ActuatorParameters,
    equivalent_current: bool,
    rest_angle_rad: Option<f64>,
    lenient: bool,
) -> Result<FailureMapSet> {
    let first = first_file(dir)?;
    let provenance = Provenance::from_pairs(&first, &metadata(&first)?)?;
    let file = dir.display().to_string();
    if provenance.parameters != actuator.fingerprint() {
        let (found, allowed) = (provenance.parameters, actuator.fingerprint());
        return Err(Error::bad(
            file,
            "parameter fingerprint",
            found,
            format!("{allowed} ({})", actuator.name),
        )
        .into());
    }
    if provenance.sequence_fingerprint != sequence.fingerprint() {
        let (found, allowed) = (provenance.sequence_fingerprint, sequence.fingerprint());
        return Err(Error::bad(
            file,
            "sequence fingerprint",
            found,
            format!("{allowed} ({})", sequence.name),
        )
        .into());
    }
    let table = scan(&dir.join("features/*.parquet"))?
        .sort(["rest_angle_rad", "zeta", "fsj"], SortMultipleOptions::default())
        .collect()
        .map_err(|e| Error::torn(dir, e))?;
    let column = |name: &str| -> Result<Vec<Option<f64>>> {
        let c = table.column(name).map_err(|e| Error::torn(dir, e))?;
        Ok(c.as_materialized_series()
            .f64()
            .map_err(|e| Error::torn(dir, e))?
            .iter()
            .collect())
    };
    let whole = |name: &str| -> Result<Vec<f64>> {
        let values: Option<Vec<f64>> = column(name)?.into_iter().collect();
        values.ok_or_else(|| Error::bad(&file, format!("column `{name}`"), "null", "a number in every row").into())
    };
    let (fsj_all, zeta_all, rest_all) = (whole("fsj")?, whole("zeta")?, whole("rest_angle_rad")?);
    let distinct = |v: &[f64]| {
        let mut v = v.to_vec();
        v.sort_by(f64::total_cmp);
        v.dedup();
        v
    };
    let angles = distinct(&rest_all);
    let rest = match rest_angle_rad {
        Some(a) => *angles
            .iter()
            .find(|&&x| (x - a).abs() < 0.5 * REST_ANGLE_TOLERANCE_RAD)
            .ok_or_else(|| {
                let list: Vec<String> = angles.iter().map(|a| format!("{:.1}", a.to_degrees())).collect();
                Error::bad(
                    &file,
                    "rest angle [deg]",
                    format!("{:.1}", a.to_degrees()),
                    list.join(", "),
                )
            })?,
        None if angles.len() == 1 => angles[0],
        None => {
            let found = format!("{} rest angles", angles.len());
            return Err(Error::bad(file, "dataset", found, "one, or a rest angle to choose").into());
        }
    };
    let rows: Vec<usize> = (0..rest_all.len()).filter(|&i| rest_all[i] == rest).collect();
    let pick = |v: &[f64]| -> Vec<f64> { rows.iter().map(|&i| v[i]).collect() };
    let (fsj, zeta) = (distinct(&pick(&fsj_all)), distinct(&pick(&zeta_all)));
    for (k, &i) in rows.iter().enumerate() {
        let (f, z) = (fsj[k % fsj.len()], zeta.get(k / fsj.len()).copied().unwrap_or(f64::NAN));
        if (fsj_all[i], zeta_all[i]) != (f, z) {
            let found = format!("(FSJ {}, zeta {})", fsj_all[i], zeta_all[i]);
            return Err(Error::bad(file, format!("grid point {k}"), found, format!("(FSJ {f}, zeta {z})")).into());
        }
    }
    if rows.len() != fsj.len() * zeta.len() {
        let found = format!("{} runs", rows.len());
        let allowed = format!("{} x {} grid points, each once", fsj.len(), zeta.len());
        return Err(Error::bad(file, "dataset", found, allowed).into());
    }
    let get = |name: &str| -> Result<Vec<Option<f64>>> {
        let all = column(name)?;
        Ok(rows.iter().map(|&i| all[i]).collect())
    };
    let columns = |names: [&str; RawFeatures::COUNT]| -> Result<Vec<RawFeatures>> {
        let columns = names.map(get).into_iter().collect::<Result<Vec<_>>>()?;
        let row = |i| RawFeatures::from_values(std::array::from_fn(|k| columns[k][i]), Some(rest));
        Ok((0..rows.len()).map(row).collect())
    };
    let grid = GridFeatures {
        measured: columns(RawFeatures::COLUMNS)?,
        deviations: columns(RawFeatures::DEVIATIONS)?,
        fsj,
        zeta,
    };
    let header = MapSetHeader {
        actuator: provenance.actuator,
        parameters: provenance.parameters,
        sequence: provenance.sequence,
        sequence_fingerprint: provenance.sequence_fingerprint,
        rate_hz: provenance.rate_hz,
        sensors: provenance.sensors,
        rest_angle_rad: rest,
        equivalent_current,
        grid: provenance.grid,
        load_n_m: provenance.load_n_m,
        step_s: provenance.step_s,
        seed: provenance.seed,
        commit: provenance.commit,
        left_out: Vec::new(),
    };
    of_grid(&file, header, sequence, &grid, lenient)
}

/// Raw features of every point of a fault grid, and their standard deviations over noise seeds; zeta
/// outer, FSJ inner.
#[derive(Clone, Debug)]
pub struct GridFeatures {
    pub fsj: Vec<f64>,
    pub zeta: Vec<f64>,
    pub measured: Vec<RawFeatures>,
    pub deviations: Vec<RawFeatures>,
}

/// The maps of a grid.
///
/// * `file` for messages
/// * `header` what the maps are for; what is left out is added
/// * `lenient` as in [`build`]
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
            (Feature::P3, Some(a), Some(p0)) => a / header.rate_hz / p0,
            _ => 0.0,
        };
        if Feature::WITNESSES.contains(&feature) {
            witnesses.extend(FailureMap::of_witness(feature, fsj, zeta, raw, noise));
            continue;
        }
        match declared(file, feature, fsj, zeta, &raw, noise, sample) {
            Ok(m) => maps.push(m),
            Err(Error::Bad {
                place, found, allowed, ..
            }) if lenient => {
                left_out.push(format!("{}: {place}: {found}; allowed: {allowed}", feature.name()));
            }
            Err(e) => return Err(e.into()),
        }
    }
    if maps.is_empty() {
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
