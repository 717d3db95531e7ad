//! Failure maps of every actuator of a fleet.

use super::{Dataset, grids};
use crate::maps::{GridFeatures, of_grid};
use anyhow::Result;
use arrow::array::{ArrayRef, Float64Array, RecordBatch, StringArray};
use arrow::datatypes::{DataType, Field, Schema};
use diagnoser::failure_map::{FailureMapSet, MapSetHeader};
use schemas::error::Error;
use schemas::feature::RawFeatures;
use schemas::recording::table_bytes;
use sim_worker::dataset::plan::SOURCE;
use sim_worker::noise::FeatureValues;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// The table of all actuators' maps.
pub const MAPS: &str = "maps/part-0000.parquet";

/// The maps of one actuator, sequence and rest angle, from the features of its grid points.
pub fn maps_of(
    d: &Dataset,
    actuator: usize,
    sequence: usize,
    rest: usize,
    values: &[FeatureValues],
) -> Result<FailureMapSet> {
    let plan = &d.plan;
    let (a, q) = (&plan.actuators[actuator], &plan.sequences[sequence]);
    let header = MapSetHeader {
        actuator: a.id.clone(),
        parameters: a.parameters.fingerprint(),
        sequence: q.name.clone(),
        sequence_fingerprint: q.fingerprint(),
        rate_hz: plan.rate_hz,
        sensors: plan.sensor_fingerprint(),
        rest_angle_rad: plan.rest_angles_rad[rest],
        equivalent_current: false,
        grid: plan.grid.fingerprint(),
        load_n_m: plan.load_n_m,
        step_s: a.parameters.step_s,
        seed: plan.seed,
        commit: format!("source {SOURCE}"),
        left_out: Vec::new(),
    };
    let angle = Some(plan.rest_angles_rad[rest]);
    let raw = |f: &dyn Fn(&FeatureValues) -> [Option<f64>; RawFeatures::COUNT]| -> Vec<RawFeatures> {
        values.iter().map(|v| RawFeatures::from_values(f(v), angle)).collect()
    };
    let grid = GridFeatures {
        fsj: plan.grid.fsj.clone(),
        zeta: plan.grid.zeta.clone(),
        measured: raw(&|v| v.map(|x| x.0)),
        deviations: raw(&|v| v.map(|x| x.0.map(|_| x.1))),
    };
    of_grid(&format!("{}: {}", d.storage.describe(), a.id), header, q, &grid, true)
}

#[derive(Default)]
struct Columns {
    texts: [Vec<String>; 5],
    numbers: [Vec<f64>; 5],
}

impl Columns {
    fn add(&mut self, d: &Dataset, actuator: usize, set: &FailureMapSet) {
        let a = &d.plan.actuators[actuator];
        for m in set.maps.iter().chain(&set.witnesses) {
            for i in 0..m.value.len() {
                let texts = [
                    &a.id,
                    &a.tail,
                    &a.position,
                    &set.header.sequence,
                    &m.feature.name().to_string(),
                ];
                for (column, text) in self.texts.iter_mut().zip(texts) {
                    column.push(text.clone());
                }
                let (fsj, zeta) = (m.fsj[i % m.fsj.len()], m.zeta[i / m.fsj.len()]);
                let numbers = [set.header.rest_angle_rad, fsj, zeta, m.value[i], m.raw[i]];
                for (column, x) in self.numbers.iter_mut().zip(numbers) {
                    column.push(x);
                }
            }
        }
    }

    fn batch(self) -> Result<RecordBatch> {
        const TEXTS: [&str; 5] = ["actuator", "tail", "position", "sequence", "feature"];
        const NUMBERS: [&str; 5] = ["rest_angle_rad", "fsj", "zeta", "value", "raw_value"];
        let texts = TEXTS.iter().map(|n| Field::new(*n, DataType::Utf8, false));
        let fields = texts.chain(NUMBERS.iter().map(|n| Field::new(*n, DataType::Float64, false)));
        let mut columns: Vec<ArrayRef> = Vec::new();
        columns.extend(self.texts.map(|t| -> ArrayRef { Arc::new(StringArray::from(t)) }));
        columns.extend(self.numbers.map(|x| -> ArrayRef { Arc::new(Float64Array::from(x)) }));
        Ok(RecordBatch::try_new(
            Arc::new(Schema::new(fields.collect::<Vec<_>>())),
            columns,
        )?)
    }
}

/// What `ema dataset maps` has made.
pub struct Made {
    pub sets: usize,
    /// maps that were left out because they are not monotone enough, by actuator
    pub left_out: Vec<String>,
    /// actuators whose features make no maps at all, and why
    pub refused: Vec<String>,
}

/// Builds the maps of all actuators into the dataset; or, with `only`, those of one of them into a folder as
/// `ema maps` does, for `ema diagnose --maps` and the live diagnoser.
pub fn build(d: &Dataset, only: Option<(&str, &Path)>) -> Result<Made> {
    let mut made = Made {
        sets: 0,
        left_out: Vec::new(),
        refused: Vec::new(),
    };
    let ids = || d.plan.actuators.iter().map(|a| a.id.as_str());
    if let Some((id, _)) = only.filter(|(id, _)| !ids().any(|x| x == *id)) {
        let some: Vec<&str> = ids().take(8).collect();
        return Err(Error::bad(
            "command line",
            "--actuator",
            id,
            format!("an actuator of the fleet: {}, ...", some.join(", ")),
        )
        .into());
    }
    let mut columns = Columns::default();
    d.each_actuator(|actuator, rows| {
        let id = &d.plan.actuators[actuator].id;
        if only.is_some_and(|(wanted, _)| wanted != id) {
            return Ok(());
        }
        for (sequence, rest, values) in grids(rows) {
            match maps_of(d, actuator, sequence, rest, &values) {
                Ok(set) => {
                    made.sets += 1;
                    made.left_out
                        .extend(set.header.left_out.iter().map(|l| format!("{id}: {l}")));
                    match only {
                        Some((_, dir)) => {
                            let file = file_of(d, dir, &set.header)?;
                            set.save(&file)?;
                        }
                        None => columns.add(d, actuator, &set),
                    }
                }
                Err(e) => made.refused.push(e.to_string()),
            }
        }
        Ok(())
    })?;
    if let Some((id, dir)) = only {
        let actuator = ids().position(|x| x == id).expect("looked for above");
        let text = d.plan.actuator_toml(actuator)?;
        schemas::error::write_whole(&dir.join("actuator.toml"), text.as_bytes())?;
    }
    if only.is_none() && made.sets > 0 {
        let bytes = table_bytes(&[columns.batch()?], pairs(d))?;
        d.storage.replace(MAPS, bytes)?;
    }
    Ok(made)
}

/// `maps.parquet`, in a folder of its own where there are several.
fn file_of(d: &Dataset, dir: &Path, header: &MapSetHeader) -> Result<PathBuf> {
    let mut dir = dir.to_path_buf();
    if d.plan.sequences.len() * d.plan.rest_angles_rad.len() > 1 {
        dir.push(format!(
            "{}-{:.1}deg",
            header.sequence,
            header.rest_angle_rad.to_degrees()
        ));
        std::fs::create_dir_all(&dir).map_err(|e| Error::io(&dir, "cannot be made", e))?;
    }
    Ok(dir.join("maps.parquet"))
}

/// Metadata of tables that are made from a dataset.
pub fn pairs(d: &Dataset) -> Vec<(String, String)> {
    [
        ("schema_version", schemas::SCHEMA_VERSION.to_string()),
        ("fleet", d.plan.name.clone()),
        ("plan", d.manifest.plan.clone()),
        ("sensors", d.plan.sensor_fingerprint()),
        ("commit", crate::generate::COMMIT.into()),
    ]
    .map(|(k, v)| (format!("ema.{k}"), v))
    .to_vec()
}
