//! Failure maps of the actuators of a dataset.

use super::{Dataset, grids};
use crate::maps::{GridFeatures, of_grid};
use anyhow::Result;
use arrow::array::{ArrayRef, Float64Array, RecordBatch, StringArray};
use arrow::datatypes::{DataType, Field, Schema};
use diagnoser::failure_map::{FailureMap, FailureMapSet, MapSetHeader};
use diagnoser::map_library::{FILE, file_for};
use schemas::error::Error;
use schemas::feature::{Feature, RawFeatures};
use schemas::table::table_bytes;
use schemas::test_kind::REST_ANGLE_TOLERANCE_RAD;
use sim_worker::dataset::plan::SOURCE;
use sim_worker::noise::FeatureValues;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// The table of all actuators' maps.
pub(crate) const MAPS: &str = "maps/part-0000.parquet";

/// The maps of one actuator, sequence and rest angle, from the features of its grid points.
///
/// * `lenient` as in [`of_grid`]
///
/// # Errors
/// As [`of_grid`].
pub fn maps_of(
    d: &Dataset,
    actuator: usize,
    sequence: usize,
    rest: usize,
    values: &[FeatureValues],
    lenient: bool,
) -> Result<FailureMapSet> {
    let plan = &d.plan;
    let (a, q) = (&plan.actuators[actuator], &plan.sequences[sequence]);
    let header = MapSetHeader {
        actuator: a.id.clone(),
        sequence: q.name.clone(),
        kind: d.plan.setup(actuator, sequence, rest).kind(),
        grid: plan.grid.fingerprint(),
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
    of_grid(
        &format!("{}: {}", d.storage.describe(), a.id),
        header,
        q,
        &grid,
        lenient,
    )
}

#[derive(Default)]
struct Columns {
    texts: [Vec<String>; 5],
    numbers: [Vec<f64>; 5],
}

impl Columns {
    fn add(&mut self, d: &Dataset, actuator: usize, set: &FailureMapSet) {
        let a = &d.plan.actuators[actuator];
        let of_unit = |m: &&FailureMap| Feature::OF_UNITS.contains(&m.feature);
        for m in set.maps.iter().filter(|m| !of_unit(m)).chain(&set.witnesses) {
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
                let numbers = [set.header.kind.rest_angle_rad, fsj, zeta, m.value[i], m.raw[i]];
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
pub(crate) struct Made {
    pub sets: usize,
    /// maps that were left out because they are not monotone enough, by actuator
    pub left_out: Vec<String>,
    /// actuators whose features make no maps at all, and why
    pub refused: Vec<String>,
}

/// Which maps of a dataset.
#[derive(Clone, Copy, Debug, Default)]
pub struct Chosen<'a> {
    /// of this actuator only
    pub actuator: Option<&'a str>,
    /// from this rest angle only [rad]
    pub rest_angle_rad: Option<f64>,
    /// as in [`of_grid`]
    pub lenient: bool,
}

impl Chosen<'_> {
    /// Places of the actuator and of the rest angle in the plan, where one is chosen.
    fn places(&self, d: &Dataset) -> Result<(Option<usize>, Option<usize>)> {
        let ids = || d.plan.actuators.iter().map(|a| a.id.as_str());
        let angles = &d.plan.rest_angles_rad;
        let near = |&x: &f64| {
            self.rest_angle_rad
                .is_some_and(|a| (x - a).abs() < 0.5 * REST_ANGLE_TOLERANCE_RAD)
        };
        let actuator = self.actuator.map(|id| {
            let some: Vec<&str> = ids().take(8).collect();
            let allowed = format!(
                "an actuator of the dataset, which knows its parameters: {}",
                some.join(", ")
            );
            ids()
                .position(|x| x == id)
                .ok_or_else(|| Error::bad("command line", "--id", id, allowed))
        });
        let rest = self.rest_angle_rad.map(|a| {
            let list: Vec<String> = angles.iter().map(|a| format!("{:.1}", a.to_degrees())).collect();
            let (found, allowed) = (format!("{:.1}", a.to_degrees()), list.join(", "));
            angles
                .iter()
                .position(near)
                .ok_or_else(|| Error::bad(d.storage.describe(), "rest angle [deg]", found, allowed))
        });
        Ok((actuator.transpose()?, rest.transpose()?))
    }
}

/// Builds the chosen maps, one actuator after another.
fn each_set(
    d: &Dataset,
    chosen: &Chosen<'_>,
    mut take: impl FnMut(usize, Result<FailureMapSet>) -> Result<()>,
) -> Result<()> {
    let (only, angle) = chosen.places(d)?;
    d.each_actuator(|actuator, rows| {
        if only.is_some_and(|wanted| wanted != actuator) {
            return Ok(());
        }
        for (sequence, rest, values) in grids(rows) {
            if angle.is_none_or(|wanted| wanted == rest) {
                take(actuator, maps_of(d, actuator, sequence, rest, &values, chosen.lenient))?;
            }
        }
        Ok(())
    })
}

/// The maps of a dataset of one actuator, sequence and rest angle.
///
/// # Errors
/// Refuses a dataset without grid, features that are not those of the plan, and what [`of_grid`] refuses.
pub fn of_one(d: &Dataset, lenient: bool) -> Result<FailureMapSet> {
    let mut found = None;
    let chosen = Chosen {
        lenient,
        ..Chosen::default()
    };
    each_set(d, &chosen, |_, set| {
        found.get_or_insert(set?);
        Ok(())
    })?;
    found.ok_or_else(|| {
        Error::bad(
            d.storage.describe(),
            "runs",
            "no grid points",
            "runs on a grid of faults",
        )
        .into()
    })
}

/// Builds the maps of all actuators into the dataset.
pub(crate) fn table(d: &Dataset) -> Result<Made> {
    let mut made = Made {
        sets: 0,
        left_out: Vec::new(),
        refused: Vec::new(),
    };
    let mut columns = Columns::default();
    let chosen = Chosen {
        lenient: true,
        ..Chosen::default()
    };
    each_set(d, &chosen, |actuator, set| {
        let id = &d.plan.actuators[actuator].id;
        match set {
            Ok(set) => {
                made.sets += 1;
                let left_out = set.header.left_out.iter().map(|l| format!("{id}: {l}"));
                made.left_out.extend(left_out);
                columns.add(d, actuator, &set);
            }
            Err(e) => made.refused.push(e.to_string()),
        }
        Ok(())
    })?;
    if made.sets > 0 {
        let bytes = table_bytes(&[columns.batch()?], pairs(d))?;
        d.storage.replace(MAPS, bytes)?;
    }
    Ok(made)
}

/// Builds the maps of one actuator into files, for `ema diagnose --maps` and the live diagnoser, and writes the
/// actuator's parameters beside them.
///
/// * `out` folder, or the file where there is one set
///
/// # Errors
/// Refuses an actuator or rest angle that is not in the plan, several sets for one file, and what [`of_grid`]
/// refuses; fails where a file cannot be written.
pub fn files(d: &Dataset, chosen: &Chosen<'_>, out: &Path) -> Result<Vec<(PathBuf, FailureMapSet)>> {
    let mut sets = Vec::new();
    let mut owner = 0;
    each_set(d, chosen, |actuator, set| {
        owner = actuator;
        sets.push(set?);
        Ok(())
    })?;
    let several = sets.len() > 1;
    let is_file = out.extension().is_some_and(|x| x == "parquet");
    if several && is_file {
        let found = format!("{} sets of maps", sets.len());
        return Err(Error::bad(out.display().to_string(), "maps", found, "one, or a folder for them").into());
    }
    let mut files = Vec::new();
    for set in sets {
        let file = if several {
            let h = &set.header;
            out.join(format!("{}-{:.1}deg", h.sequence, h.kind.rest_angle_rad.to_degrees()))
                .join(FILE)
        } else {
            file_for(out)
        };
        let dir = file.parent().unwrap_or(Path::new(""));
        std::fs::create_dir_all(dir).map_err(|e| Error::io(dir, "cannot be made", e))?;
        set.save(&file)?;
        files.push((file, set));
    }
    if !is_file {
        let text = d.plan.actuator_toml(owner)?;
        schemas::error::write_whole(&out.join("actuator.toml"), text.as_bytes())?;
    }
    Ok(files)
}

/// Metadata of tables that are made from a dataset.
pub(crate) fn pairs(d: &Dataset) -> Vec<(String, String)> {
    [
        ("schema_version", schemas::SCHEMA_VERSION.to_string()),
        ("fleet", d.plan.name.clone()),
        ("plan", d.manifest.plan.clone()),
        ("sensors", d.plan.sensor_fingerprint()),
        ("commit", crate::COMMIT.into()),
    ]
    .map(|(k, v)| (format!("ema.{k}"), v))
    .to_vec()
}
