//! Maps from any simulator, or any rig: rows of faults with features or recordings become failure maps, and the rows off
//! the grid of faults calibrate them.

use crate::calibrate::of_tests;
use crate::case::{self, Settings};
use crate::input;
use crate::maps::{GridFeatures, of_grid};
use anyhow::Result;
use diagnoser::calibration::Calibration;
use diagnoser::diagnosis::{Diagnoser, Diagnosis};
use diagnoser::failure_map::{FailureMapSet, MapSetHeader};
use ema_tables::Table;
use rayon::prelude::*;
use schemas::error::Error;
use schemas::fault::FaultState;
use schemas::feature::RawFeatures;
use schemas::fingerprint::fingerprint;
use sim_worker::setup::TestSetup;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// How the header of maps that a table made begins what made them: our own test bench cannot calibrate these.
pub const MADE_BY: &str = "table ";

/// Fewest rows off the grid that calibrate maps (assumed): below, a share of 95 % is one row or none.
pub const FEWEST_TESTS: usize = 40;

/// A line of the grid is met by at least so many lines of the other fault.
const FEWEST_LINES: usize = 3;

/// What rows of features do not say of themselves.
#[derive(Clone, Debug)]
pub struct FeatureKind {
    /// of the telemetry that the features are of [Hz]
    pub rate_hz: f64,
    /// of the rotor [rad]
    pub rest_angle_rad: f64,
}

/// One row: the faults, and what was measured of them.
#[derive(Clone, Debug)]
struct Row {
    fault: FaultState,
    raw: RawFeatures,
    /// standard deviation of each, where it is said
    sd: RawFeatures,
}

/// Maps made of a table.
pub struct MapTable {
    /// the maps
    pub set: FailureMapSet,
    /// by the rows off the grid; `None` where they are too few
    pub calibration: Option<Calibration>,
    /// rows on the grid, and off it
    pub rows: (usize, usize),
    /// whether points of the grid were measured more than once, or their scatter is said
    pub has_noise: bool,
}

/// Rows as features by their columns; `None` where a cell is empty.
fn features(table: &Table) -> Result<Vec<(RawFeatures, RawFeatures)>> {
    let column = |name: &str| {
        table
            .names
            .iter()
            .any(|n| n == name)
            .then(|| table.numbers(name))
            .transpose()
    };
    let columns = |names: &[&str]| names.iter().map(|c| column(c)).collect::<Result<Vec<_>, _>>();
    let values = columns(&RawFeatures::COLUMNS)?;
    if values.iter().all(Option::is_none) {
        let allowed = format!(
            "a column `file` of recordings, or of {}",
            RawFeatures::COLUMNS.join(", ")
        );
        return Err(Error::bad(&table.file, "columns", table.names.join(","), allowed).into());
    }
    let deviations = columns(&RawFeatures::DEVIATIONS)?;
    let at = |all: &[Option<&[f64]>], row: usize| {
        let mut cells = [None; RawFeatures::COUNT];
        for (cell, column) in cells.iter_mut().zip(all) {
            *cell = column.map(|c| c[row]).filter(|x| x.is_finite());
        }
        RawFeatures::from_values(cells, None)
    };
    let rows = (0..table.rows).map(|i| (at(&values, i), at(&deviations, i)));
    Ok(rows.collect())
}

/// The recordings that the rows name, beside the table.
fn files(path: &Path, table: &Table) -> Result<Vec<PathBuf>> {
    let folder = path.parent().unwrap_or(Path::new(""));
    Ok(table.texts("file")?.iter().map(|f| folder.join(f)).collect())
}

/// Features of recordings, and the test that all of them are.
fn of_recordings(table: &Table, files: &[PathBuf], settings: &Settings) -> Result<(Vec<RawFeatures>, TestSetup)> {
    let one = |file: &PathBuf| -> Result<(RawFeatures, TestSetup)> {
        if crate::progress::interrupted() {
            return Err(crate::Interrupted.into());
        }
        let test = case::test_of(file, &input::open(file, settings.how())?, settings)?;
        if let Some(missing) = test.missing.first() {
            let allowed = "a recording of the whole test";
            return Err(Error::bad(file.display().to_string(), "recording", missing, allowed).into());
        }
        Ok((test.raw, test.setup))
    };
    let all = files.par_iter().map(one).collect::<Result<Vec<_>>>()?;
    let first = all[0].1.clone();
    for (i, (_, setup)) in all.iter().enumerate() {
        if let Some(d) = setup.kind().difference(&first.kind()) {
            let place = format!("{}, {}", table.place(i, "file"), d.place);
            let allowed = format!("{} as in the first row", d.allowed);
            return Err(Error::bad(&table.file, place, d.found, allowed).into());
        }
    }
    Ok((all.into_iter().map(|x| x.0).collect(), first))
}

/// Mean and standard deviation of each feature over repeats.
fn averaged(rows: &[&Row]) -> (RawFeatures, RawFeatures) {
    let n = rows.len() as f64;
    let (mut means, mut sds) = ([None; RawFeatures::COUNT], [None; RawFeatures::COUNT]);
    for k in 0..RawFeatures::COUNT {
        let values: Option<Vec<f64>> = rows.iter().map(|r| r.raw.values()[k]).collect();
        let Some(values) = values else { continue };
        let mean = values.iter().sum::<f64>() / n;
        let said = rows
            .iter()
            .filter_map(|r| r.sd.values()[k])
            .fold(None, |a: Option<f64>, x| Some(a.unwrap_or(0.0).max(x)));
        let scatter = (values.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / (n - 1.0)).sqrt();
        means[k] = Some(mean);
        sds[k] = said.or((rows.len() > 1).then_some(scatter));
    }
    (
        RawFeatures::from_values(means, None),
        RawFeatures::from_values(sds, None),
    )
}

/// A value as a key: to the last bit, and one zero.
fn key(x: f64) -> u64 {
    (x + 0.0).to_bits()
}

/// Lines of the grid among values that may be off it.
fn lines(of: &BTreeMap<u64, Vec<u64>>) -> Vec<f64> {
    let met = |others: &Vec<u64>| {
        let mut others = others.clone();
        others.sort_unstable();
        others.dedup();
        others.len() >= FEWEST_LINES
    };
    let mut lines: Vec<f64> = of
        .iter()
        .filter(|(_, o)| met(o))
        .map(|(x, _)| f64::from_bits(*x))
        .collect();
    lines.sort_by(f64::total_cmp);
    lines
}

/// Splits rows into those of the grid, by point, and the others.
fn grid(table: &Table, rows: &[Row]) -> Result<(GridFeatures, bool, Vec<usize>)> {
    let (mut by_fsj, mut by_zeta) = (BTreeMap::<u64, Vec<u64>>::new(), BTreeMap::<u64, Vec<u64>>::new());
    for r in rows {
        let (f, z) = (key(r.fault.fsj), key(r.fault.zeta));
        by_fsj.entry(f).or_default().push(z);
        by_zeta.entry(z).or_default().push(f);
    }
    let (fsj, zeta) = (lines(&by_fsj), lines(&by_zeta));
    if fsj.len() < FEWEST_LINES || zeta.len() < FEWEST_LINES {
        let found = format!(
            "{} values of fsj and {} of zeta that are met by {FEWEST_LINES} of the other",
            fsj.len(),
            zeta.len()
        );
        let allowed = "a full grid of fault pairs, and any rows beside it";
        return Err(Error::bad(&table.file, "columns fsj, zeta", found, allowed).into());
    }
    let mut used = vec![false; rows.len()];
    let (mut measured, mut deviations, mut has_noise) = (Vec::new(), Vec::new(), false);
    for &z in &zeta {
        for &f in &fsj {
            let here = |i: &usize| key(rows[*i].fault.fsj) == key(f) && key(rows[*i].fault.zeta) == key(z);
            let at: Vec<usize> = (0..rows.len()).filter(here).collect();
            if at.is_empty() {
                let found = format!("no row of fsj {f}, zeta {z}");
                let allowed = format!("every pair of fsj {fsj:?} and zeta {zeta:?}");
                return Err(Error::bad(&table.file, "columns fsj, zeta", found, allowed).into());
            }
            at.iter().for_each(|&i| used[i] = true);
            let repeats: Vec<&Row> = at.iter().map(|&i| &rows[i]).collect();
            let (mean, sd) = averaged(&repeats);
            has_noise |= sd.values().iter().any(Option::is_some);
            measured.push(mean);
            deviations.push(sd);
        }
    }
    let others = (0..rows.len()).filter(|&i| !used[i]).collect();
    let grid = GridFeatures {
        fsj,
        zeta,
        measured,
        deviations,
    };
    Ok((grid, has_noise, others))
}

/// The faults of the rows.
fn faults(table: &Table) -> Result<Vec<FaultState>> {
    let (fsj, zeta) = (table.numbers("fsj")?, table.numbers("zeta")?);
    let fault = |i: usize| -> Result<FaultState> {
        let bad = |column: &str, x: f64, allowed: &str| Error::bad(&table.file, table.place(i, column), x, allowed);
        if !(fsj[i].is_finite() && fsj[i] > 0.0) {
            return Err(bad("fsj", fsj[i], "a number above 0: 1 is the healthy friction").into());
        }
        if !(0.0..1.0).contains(&zeta[i]) {
            return Err(bad("zeta", zeta[i], "a number from 0 to below 1").into());
        }
        Ok(FaultState {
            fsj: fsj[i],
            zeta: zeta[i],
        })
    };
    (0..table.rows).map(fault).collect()
}

/// Makes maps of a table with columns `fsj`, `zeta`, and `file` (a recording each) or features by their columns.
///
/// * `settings` actuator whose constants features are formed with, sequence and sensors; for maps of recordings, how to
///   read them
/// * `kind` of rows of features
/// * `lenient` as in [`of_grid`]
///
/// # Errors
/// A table that cannot be read, faults that are none, no full grid of them, recordings of different tests, and what
/// [`of_grid`] refuses.
pub fn make(path: &Path, settings: &Settings, kind: &FeatureKind, lenient: bool) -> Result<MapTable> {
    let table = Table::filled(path)?;
    let faults = faults(&table)?;
    let (measured, setup) = if table.names.iter().any(|n| n == "file") {
        let (raw, setup) = of_recordings(&table, &files(path, &table)?, settings)?;
        (raw.into_iter().map(|r| (r, RawFeatures::default())).collect(), setup)
    } else {
        (features(&table)?, of_features(settings, kind)?)
    };
    let rows: Vec<Row> = faults
        .into_iter()
        .zip(measured)
        .map(|(fault, (raw, sd))| Row { fault, raw, sd })
        .collect();
    let (grid, has_noise, others) = grid(&table, &rows)?;
    let header = MapSetHeader {
        actuator: setup.actuator.name.clone(),
        sequence: setup.sequence.name.clone(),
        kind: setup.kind(),
        grid: fingerprint(&format!("{:?} {:?}", grid.fsj, grid.zeta)),
        step_s: setup.actuator.step_s,
        seed: 0,
        commit: format!("{MADE_BY}{}", table.hash),
        left_out: Vec::new(),
    };
    let set = of_grid(&table.file, header, &setup.sequence, &grid, lenient)?;
    let tests = others.iter().map(|&i| (rows[i].fault, rows[i].raw));
    let calibration = Some(of_tests(&set, tests)?).filter(|c| c.runs >= FEWEST_TESTS);
    Ok(MapTable {
        calibration,
        rows: (rows.len() - others.len(), others.len()),
        set,
        has_noise,
    })
}

/// The test that features are of.
fn of_features(settings: &Settings, kind: &FeatureKind) -> Result<TestSetup> {
    let name = settings.sequence.as_deref().unwrap_or("preflight");
    let sensors = match settings.sensors.as_str() {
        "auto" => None,
        name => sim_worker::catalogue::sensors(name)?,
    };
    let reference = || std::sync::Arc::new(sim_worker::parameters::ActuatorParameters::reference());
    Ok(TestSetup {
        actuator: settings.actuator.clone().unwrap_or_else(reference),
        sequence: sim_worker::catalogue::sequence(name)?,
        sensors,
        rate_hz: kind.rate_hz,
        rest_angle_rad: kind.rest_angle_rad,
        load_n_m: 0.0,
        equivalent_current: false,
    })
}

/// A diagnosed row of features.
pub struct DiagnosedRow {
    /// where it is in the file
    pub place: String,
    /// what the row says of it, if anything
    pub fault: Option<FaultState>,
    /// what was found
    pub diagnosis: Diagnosis,
}

/// Diagnoses rows of features by maps.
///
/// # Errors
/// A table that cannot be read, or without any column of a feature.
pub fn diagnose(path: &Path, diagnoser: &Diagnoser) -> Result<Vec<DiagnosedRow>> {
    let table = Table::filled(path)?;
    let has_faults = ["fsj", "zeta"].iter().all(|f| table.names.iter().any(|n| n == f));
    let faults = has_faults.then(|| faults(&table)).transpose()?;
    let rows = features(&table)?.into_iter().enumerate();
    let row = |(i, (raw, _)): (usize, (RawFeatures, RawFeatures))| DiagnosedRow {
        place: table.place(i, "").split(',').next().unwrap_or_default().to_string(),
        fault: faults.as_ref().map(|f| f[i]),
        diagnosis: diagnoser.diagnose(&diagnoser.maps.features(&raw), &[]),
    };
    Ok(rows.map(row).collect())
}

/// Whether maps are of a table rather than of our own test bench.
pub fn is_of_table(header: &MapSetHeader) -> bool {
    header.commit.starts_with(MADE_BY)
}
