//! The maps of one actuator, saved and loaded together.

use super::{FailureMap, MapBudget};
use crate::uncertainty::MOST;
use arrow::array::{Array, ArrayRef, AsArray, Float64Array, RecordBatch, StringArray};
use arrow::datatypes::{DataType, Field, Float64Type, Schema};
use arrow::error::ArrowError;
use schemas::error::{Error, Result};
use schemas::feature::{Feature, Features, RawFeatures};
use schemas::fingerprint::{checksum, exact, fingerprint};
use schemas::recording::Provenance;
use schemas::table::write_table;
use schemas::test_kind::TestKind;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;

/// What a map set was made for; a diagnosis must match it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct MapSetHeader {
    /// name of the actuator
    pub actuator: String,
    /// name of the sequence
    pub sequence: String,
    /// the tests that they are for
    #[serde(flatten)]
    pub kind: TestKind,
    /// fingerprint of the fault grid
    pub grid: String,
    /// of the numerical test bench [s]
    pub step_s: f64,
    /// of the sensor noise in the grid's runs
    pub seed: u64,
    /// source revision or hash of the program that made them
    pub commit: String,
    /// features whose surface is not monotone enough for a map, and why
    #[serde(default)]
    pub left_out: Vec<String>,
}

/// The maps of one actuator, sequence, rate, sensor model and rest angle.
#[derive(Clone, Debug, PartialEq)]
pub struct FailureMapSet {
    /// what the maps are for
    pub header: MapSetHeader,
    /// the nominal run through the same sensors
    pub nominal: RawFeatures,
    /// by which faults are located, at most one a feature
    pub maps: Vec<FailureMap>,
    /// what the witnesses should be
    pub witnesses: Vec<FailureMap>,
}

#[derive(Serialize, Deserialize)]
struct Stored {
    header: MapSetHeader,
    /// in the order of [`RawFeatures::COLUMNS`]; what is missing at the end is not known
    nominal: Vec<Option<f64>>,
    budgets: BTreeMap<String, MapBudget>,
    /// direction along (FSJ, zeta) of each map; the usual one where there is none
    #[serde(default)]
    directions: BTreeMap<String, (f64, f64)>,
    /// there is a checksum; files of earlier versions had none
    #[serde(default)]
    sealed: bool,
}

/// Metadata key of the checksum.
const CHECKSUM: &str = "ema.maps_checksum";

/// The columns of a table of maps.
struct Columns<'a> {
    names: &'a StringArray,
    /// fsj, zeta, value, raw_value
    numbers: [&'a Float64Array; 4],
}

impl<'a> Columns<'a> {
    /// # Errors
    /// The name of a column that is missing or of another type.
    fn of(batch: &'a RecordBatch) -> std::result::Result<Self, &'static str> {
        let names = batch.column_by_name("feature").and_then(|c| c.as_string_opt());
        let names = names.filter(|n| n.null_count() == 0).ok_or("feature")?;
        let number = |n: &'static str| {
            let column = batch
                .column_by_name(n)
                .and_then(|c| c.as_primitive_opt::<Float64Type>());
            column.filter(|c| c.null_count() == 0).ok_or(n)
        };
        let numbers = [number("fsj")?, number("zeta")?, number("value")?, number("raw_value")?];
        Ok(Self { names, numbers })
    }

    fn row(&self, i: usize) -> [f64; 4] {
        self.numbers.map(|c| c.value(i))
    }
}

/// Of what is said of the maps, and of every bit of their rows.
fn checksum_of<'a>(text: &str, tables: impl IntoIterator<Item = &'a Columns<'a>>) -> String {
    let mut bytes = text.as_bytes().to_vec();
    for t in tables {
        for i in 0..t.names.len() {
            bytes.extend(t.names.value(i).as_bytes());
            bytes.extend(t.row(i).iter().flat_map(|x| x.to_bits().to_le_bytes()));
        }
    }
    checksum(&bytes)
}

impl FailureMapSet {
    /// Features of a run over this set's nominal run.
    pub fn features(&self, raw: &RawFeatures) -> Features {
        Features::over(raw, &self.nominal)
    }

    /// Of what the maps are for and of every value.
    pub fn fingerprint(&self) -> String {
        let header = serde_json::to_string(&self.header).expect("plain data");
        let values = self.all().flat_map(|m| &m.raw).map(|x| exact(*x));
        fingerprint(&format!("maps;{header};{}", values.collect::<Vec<_>>().join(",")))
    }

    /// The map of a feature, if there is one; witnesses are not looked at.
    pub fn map(&self, feature: Feature) -> Option<&FailureMap> {
        self.maps.iter().find(|m| m.feature == feature)
    }

    /// The maps that are inverted together: all but those whose parts have maps too, and those of units.
    pub fn joint(&self) -> impl Iterator<Item = &FailureMap> {
        self.joint_of_unit().filter(|m| !Feature::OF_UNITS.contains(&m.feature))
    }

    /// The maps that are inverted together where the unit is known.
    pub fn joint_of_unit(&self) -> impl Iterator<Item = &FailureMap> {
        let has = |parts: [Feature; 2]| parts.into_iter().all(|f| self.map(f).is_some());
        self.maps.iter().filter(move |m| !m.feature.parts().is_some_and(has))
    }

    /// Features that a unit's tests are judged by, and the scatter of each that the sensors make.
    pub fn judged_of_unit(&self) -> impl Iterator<Item = (Feature, f64)> + '_ {
        // break-away comes in whole samples, also where all simulated units have the same
        let maps = self.joint_of_unit().map(|m| (m.feature, m.budget.measurement()));
        maps.chain(self.witnesses.iter().map(|w| (w.feature, w.budget.noise)))
    }

    /// Whether all maps can be inverted together, and all witnesses compared.
    ///
    /// # Errors
    /// Refuses more than [`MOST`] of either, naming the first too many.
    pub fn check(&self, file: &str) -> Result<()> {
        match self.joint_of_unit().nth(MOST).or(self.witnesses.get(MOST)) {
            Some(m) => {
                let place = format!("map {}", m.feature.name());
                Err(Error::bad(file, place, "one too many", format!("{MOST} at most")))
            }
            None => Ok(()),
        }
    }

    fn all(&self) -> impl Iterator<Item = &FailureMap> {
        self.maps.iter().chain(&self.witnesses)
    }

    /// Every point of every map, witnesses too: feature, fsj, zeta, value, raw_value.
    ///
    /// # Errors
    /// What Arrow refuses; of maps that were built it refuses nothing.
    pub fn rows(&self) -> std::result::Result<RecordBatch, ArrowError> {
        let column = |f: fn(&FailureMap, usize) -> f64| -> ArrayRef {
            let v = self.all().flat_map(|m| (0..m.value.len()).map(move |i| f(m, i)));
            Arc::new(Float64Array::from_iter_values(v))
        };
        let names = self.all().flat_map(|m| m.value.iter().map(|_| m.feature.name()));
        let field = |n: &str, t: DataType| Field::new(n, t, false);
        let schema = Arc::new(Schema::new(vec![
            field("feature", DataType::Utf8),
            field("fsj", DataType::Float64),
            field("zeta", DataType::Float64),
            field("value", DataType::Float64),
            field("raw_value", DataType::Float64),
        ]));
        let columns: Vec<ArrayRef> = vec![
            Arc::new(StringArray::from_iter_values(names)),
            column(|m, i| m.fsj[i % m.fsj.len()]),
            column(|m, i| m.zeta[i / m.fsj.len()]),
            column(|m, i| m.value[i]),
            column(|m, i| m.raw[i]),
        ];
        RecordBatch::try_new(schema, columns)
    }

    /// Saves the maps as one Parquet table: [`FailureMapSet::rows`].
    ///
    /// # Errors
    /// Fails where the file cannot be written.
    pub fn save(&self, path: &Path) -> Result<()> {
        let h = &self.header;
        let provenance = Provenance {
            actuator: h.actuator.clone(),
            parameters: h.kind.parameters.clone(),
            sequence: h.sequence.clone(),
            sequence_fingerprint: h.kind.sequence.clone(),
            grid: h.grid.clone(),
            sensors: h.kind.sensors.clone(),
            rate_hz: h.kind.rate_hz,
            step_s: h.step_s,
            seed: h.seed,
            load_n_m: h.kind.load_n_m.unwrap_or(0.0),
            effects: String::new(),
            commit: h.commit.clone(),
            model: "ntb".into(),
        };
        let stored = Stored {
            header: h.clone(),
            nominal: self.nominal.values().to_vec(),
            budgets: self
                .all()
                .map(|m| (m.feature.name().to_string(), m.budget.clone()))
                .collect(),
            directions: self
                .maps
                .iter()
                .map(|m| (m.feature.name().to_string(), m.direction))
                .collect(),
            sealed: true,
        };
        let mut pairs = provenance.pairs();
        let text = serde_json::to_string(&stored).expect("plain data");
        let batch = self.rows().map_err(|e| Error::torn(path, e))?;
        let table = Columns::of(&batch).expect("as they were just made");
        pairs.push((CHECKSUM.into(), checksum_of(&text, [&table])));
        pairs.push(("ema.maps".into(), text));
        write_table(path, &batch, pairs)
    }

    /// Loads a saved set; what the maps become is worked out anew from the simulated values.
    ///
    /// # Errors
    /// Refuses another schema version, torn and changed files, incomplete grids, fewer than two maps, and what
    /// [`FailureMap::build`] or [`FailureMapSet::check`] refuses.
    pub fn load(path: &Path) -> Result<Self> {
        let pairs = schemas::table::metadata(path)?;
        Provenance::from_pairs(path, &pairs)?;
        let file = path.display().to_string();
        let text = pairs
            .get("ema.maps")
            .ok_or_else(|| Error::bad(&file, "metadata `ema.maps`", "nothing", "a file written by `ema maps`"))?;
        let stored: Stored = serde_json::from_str(text).map_err(|e| Error::torn(path, e))?;
        let mut rows: BTreeMap<Feature, Vec<[f64; 4]>> = BTreeMap::new();
        let batches = schemas::table::read_batches(path)?;
        let missing = |n| {
            let allowed = "those of schemas/README.md";
            Error::bad(&file, "columns", format!("no `{n}` of its type"), allowed)
        };
        let tables = batches.iter().map(|b| Columns::of(b).map_err(missing));
        let tables = tables.collect::<Result<Vec<_>>>()?;
        for table in &tables {
            for i in 0..table.names.len() {
                let name = table.names.value(i);
                let feature = Feature::from_name(name)
                    .ok_or_else(|| Error::bad(&file, format!("row {i}"), name, names_of_all()))?;
                rows.entry(feature).or_default().push(table.row(i));
            }
        }
        // what a flipped bit makes of a map is a map too
        let found = pairs.get(CHECKSUM);
        if (stored.sealed || found.is_some()) && found != Some(&checksum_of(text, &tables)) {
            let allowed = "that of a file as `ema maps` wrote it";
            return Err(Error::bad(&file, "checksum", found.map_or("none", |f| f), allowed));
        }
        let (mut maps, mut witnesses) = (Vec::new(), Vec::new());
        for (feature, rows) in rows {
            let axis = |k: usize| {
                let mut v: Vec<f64> = rows.iter().map(|r| r[k]).collect();
                v.sort_by(f64::total_cmp);
                v.dedup();
                v
            };
            let (fsj, zeta) = (axis(0), axis(1));
            let whole = rows.len() == fsj.len() * zeta.len()
                && fsj.len() >= 2
                && zeta.len() >= 2
                && rows
                    .iter()
                    .enumerate()
                    .all(|(i, r)| r[0] == fsj[i % fsj.len()] && r[1] == zeta[i / fsj.len()]);
            if !whole {
                let found = format!("{} rows", rows.len());
                let allowed = format!("every point of the {} x {} grid once, in order", fsj.len(), zeta.len());
                return Err(Error::bad(&file, format!("map {}", feature.name()), found, allowed));
            }
            let budget = stored.budgets.get(feature.name()).cloned();
            let budget = budget.ok_or_else(|| Error::bad(&file, "budgets", "nothing", feature.name()))?;
            let raw: Vec<f64> = rows.iter().map(|r| r[3]).collect();
            if feature.is_witness() {
                let place = format!("witness {}", feature.name());
                let map = FailureMap::of_witness(feature, &fsj, &zeta, raw, budget.noise);
                witnesses.push(map.ok_or_else(|| Error::bad(&file, place, "not a number", "numbers"))?);
                continue;
            }
            if Feature::CAUSES.contains(&feature) {
                let place = format!("map {}", feature.name());
                let map = FailureMap::of_cause(feature, &fsj, &zeta, raw, budget.noise);
                maps.push(map.ok_or_else(|| Error::bad(&file, place, "not a number", "numbers"))?);
                continue;
            }
            let direction = stored.directions.get(feature.name()).copied();
            let direction = direction.unwrap_or(feature.direction());
            let mut map = FailureMap::build(&file, feature, direction, &fsj, &zeta, raw, budget.noise, budget.sample)?;
            map.budget = budget;
            maps.push(map);
        }
        if maps.len() < 2 {
            return Err(Error::bad(&file, "maps", maps.len(), "at least two maps"));
        }
        let nominal = std::array::from_fn(|k| stored.nominal.get(k).copied().flatten());
        let nominal = RawFeatures::from_values(nominal, Some(stored.header.kind.rest_angle_rad));
        let set = Self {
            header: stored.header,
            nominal,
            maps,
            witnesses,
        };
        set.check(&file)?;
        Ok(set)
    }
}

fn names_of_all() -> String {
    Feature::every().map(Feature::name).collect::<Vec<_>>().join(", ")
}
