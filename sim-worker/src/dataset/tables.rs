//! Tables of a dataset as Parquet in memory. `schemas/README.md` is their specification.

use super::parts::Part;
use super::plan::{DatasetPlan, SOURCE};
use crate::noise::FeatureValues;
use crate::parameters::PARAMETERS;
use arrow::array::{Array, ArrayRef, AsArray, Float64Array, RecordBatch, StringArray, UInt64Array};
use arrow::datatypes::{DataType, Field, Float64Type, Schema, UInt64Type};
use bytes::Bytes;
use parquet::arrow::arrow_reader::ParquetRecordBatchReaderBuilder;
use schemas::SCHEMA_VERSION;
use schemas::error::{Error, Result};
use schemas::feature::{Feature, Raw, RawFeatures};
use schemas::fingerprint::checksum;
use schemas::guard::{Ending, guarded};
use schemas::recording::Provenance;
use schemas::table::table_bytes;
use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;

fn torn(path: &str, e: impl std::fmt::Display) -> Error {
    Error::torn(Path::new(path), e)
}

/// A Parquet file by its footer.
///
/// # Errors
/// Bytes that are no whole Parquet file, in words.
pub fn opened(bytes: Bytes) -> std::result::Result<ParquetRecordBatchReaderBuilder<Ending<Bytes>>, String> {
    let open = || ParquetRecordBatchReaderBuilder::try_new(Ending(bytes)).map_err(|e| e.to_string());
    guarded(open).unwrap_or_else(|e| Err(e.into()))
}

/// Metadata that all tables of a dataset have.
fn pairs(plan: &DatasetPlan) -> Vec<(String, String)> {
    [
        ("schema_version", SCHEMA_VERSION.to_string()),
        ("fleet", plan.name.clone()),
        ("plan", plan.fingerprint()),
        ("source", SOURCE.into()),
        ("sensors", plan.sensor_fingerprint()),
        ("rate_hz", plan.rate_hz.to_string()),
        ("load_n_m", plan.load_n_m.to_string()),
        ("seed", plan.seed.to_string()),
        ("model", "ntb".into()),
    ]
    .map(|(k, v)| (format!("ema.{k}"), v))
    .to_vec()
}

/// Metadata of the telemetry of a part: that of any recording, and the plan.
pub fn telemetry_pairs(plan: &DatasetPlan, part: &Part, fingerprint_of_plan: &str) -> Vec<(String, String)> {
    let effects = &plan.actuators[part.actuator].parameters.effects;
    let provenance = Provenance {
        grid: plan.grid.fingerprint(),
        effects: effects.iter().map(|e| e.kind.name()).collect::<Vec<_>>().join(","),
        rate_hz: plan.telemetry.as_ref().map_or(plan.rate_hz, |t| t.rate_hz),
        ..plan
            .setup(part.actuator, part.sequence, part.rest)
            .provenance(plan.seed, &format!("source {SOURCE}"))
    };
    let mut pairs = provenance.pairs();
    pairs.push(("ema.plan".into(), fingerprint_of_plan.into()));
    pairs.push(("ema.part".into(), part.number.to_string()));
    pairs
}

fn raw_fields() -> Vec<Field> {
    let names = RawFeatures::COLUMNS.into_iter().chain(RawFeatures::DEVIATIONS);
    names.map(|n| Field::new(n, DataType::Float64, true)).collect()
}

fn raw_columns(rows: &[FeatureValues]) -> Vec<ArrayRef> {
    let column = |f: &dyn Fn(&FeatureValues) -> Option<f64>| -> ArrayRef {
        Arc::new(rows.iter().map(f).collect::<Float64Array>())
    };
    let means = (0..RawFeatures::COUNT).map(|k| column(&|v| v[k].0));
    let deviations = (0..RawFeatures::COUNT).map(|k| column(&|v| v[k].0.map(|_| v[k].1)));
    means.chain(deviations).collect()
}

/// What a part's telemetry is, as its staged features remember it.
#[derive(Clone, Debug, PartialEq)]
pub struct Receipt {
    /// size of the file [bytes]
    pub bytes: u64,
    /// checksum of the file, 64 hexadecimal digits
    pub blake3: String,
    /// samples
    pub rows: u64,
}

/// Of features to the bit, and of what is said beside them.
pub(super) fn checksum_of<'a>(beside: String, rows: impl IntoIterator<Item = &'a FeatureValues>) -> String {
    let mut bytes = beside.into_bytes();
    for (value, deviation) in rows.into_iter().flatten() {
        bytes.push(u8::from(value.is_some()));
        bytes.extend(value.unwrap_or(0.0).to_bits().to_le_bytes());
        bytes.extend(value.map_or(0.0, |_| *deviation).to_bits().to_le_bytes());
    }
    checksum(&bytes)
}

/// A part's features before the merge.
pub struct Staged {
    /// by run, in order
    pub rows: Vec<FeatureValues>,
    /// none where telemetry is not kept
    pub telemetry: Option<Receipt>,
}

impl Staged {
    /// As a Parquet file, with the checksum of its content among the metadata.
    ///
    /// * `path` for messages
    ///
    /// # Errors
    /// What the Parquet writer refuses.
    pub fn to_bytes(&self, path: &str, plan_fingerprint: &str, part: &Part) -> Result<Vec<u8>> {
        let mut fields = vec![Field::new("run", DataType::UInt64, false)];
        fields.extend(raw_fields());
        let mut columns: Vec<ArrayRef> = vec![Arc::new(UInt64Array::from_iter_values(part.runs.clone()))];
        columns.extend(raw_columns(&self.rows));
        let batch = RecordBatch::try_new(Arc::new(Schema::new(fields)), columns).map_err(|e| torn(path, e))?;
        let mut pairs = vec![
            ("ema.schema_version".to_string(), SCHEMA_VERSION.to_string()),
            ("ema.plan".into(), plan_fingerprint.into()),
            ("ema.part".into(), part.number.to_string()),
        ];
        pairs.push(("ema.checksum".into(), self.checksum()));
        if let Some(t) = &self.telemetry {
            pairs.push(("ema.telemetry_bytes".into(), t.bytes.to_string()));
            pairs.push(("ema.telemetry_blake3".into(), t.blake3.clone()));
            pairs.push(("ema.telemetry_rows".into(), t.rows.to_string()));
        }
        table_bytes(&[batch], pairs)
    }

    /// Of all that the merge takes from it: bits that fall over before the merge must not get into the dataset.
    fn checksum(&self) -> String {
        checksum_of(format!("{:?}", self.telemetry), &self.rows)
    }

    /// Refuses what is not whole, or of another plan or part.
    ///
    /// * `same_program` the part was made by this version of the program, so that it can be compared bit by bit
    ///
    /// # Errors
    /// A torn or changed file; runs, plan, part or telemetry that are not those of `part`.
    pub fn from_bytes(
        path: &str,
        bytes: Bytes,
        plan_fingerprint: &str,
        part: &Part,
        same_program: bool,
    ) -> Result<Self> {
        let table = Table::read(path, bytes.clone())?;
        for (key, wanted) in [
            ("ema.plan", plan_fingerprint.to_string()),
            ("ema.part", part.number.to_string()),
        ] {
            let found = table.pair(key);
            if found != wanted {
                return Err(Error::bad(path, format!("metadata `{key}`"), found, wanted));
            }
        }
        let runs = table.numbers("run")?;
        if !runs.iter().copied().eq(part.runs.clone()) {
            let allowed = format!("runs {} to {}, each once", part.runs.start, part.runs.end - 1);
            return Err(Error::bad(
                path,
                "column `run`",
                format!("{} rows", runs.len()),
                allowed,
            ));
        }
        let number = |key: &str| table.pair(key).parse::<u64>().ok();
        let telemetry = match (number("ema.telemetry_bytes"), number("ema.telemetry_rows")) {
            (Some(bytes), Some(rows)) => Some(Receipt {
                bytes,
                rows,
                blake3: table.pair("ema.telemetry_blake3"),
            }),
            _ => None,
        };
        if telemetry.is_some() != part.telemetry {
            let found = if telemetry.is_some() {
                "telemetry"
            } else {
                "no telemetry"
            };
            return Err(Error::bad(
                path,
                "metadata `ema.telemetry_bytes`",
                found,
                "that of the plan",
            ));
        }
        let staged = Self {
            rows: table.features()?,
            telemetry,
        };
        if table.pair("ema.checksum") != staged.checksum() {
            return Err(torn(path, "changed: another checksum than when it was made"));
        }
        if same_program && staged.to_bytes(path, plan_fingerprint, part)? != bytes {
            return Err(torn(path, "changed: its rows are written in another way"));
        }
        Ok(staged)
    }
}

/// A Parquet file that was read whole.
pub struct Table {
    path: String,
    pairs: BTreeMap<String, String>,
    batches: Vec<RecordBatch>,
}

impl Table {
    ///
    /// * `path` for messages
    ///
    /// # Errors
    /// Bytes that are no whole Parquet file.
    pub fn read(path: &str, bytes: Bytes) -> Result<Self> {
        let size = bytes.len();
        guarded(|| Self::read_trusting(path, bytes))
            .unwrap_or_else(|e| Err(torn(path, format!("not a whole Parquet file of {size} bytes ({e})"))))
    }

    fn read_trusting(path: &str, bytes: Bytes) -> Result<Self> {
        let size = bytes.len();
        let broken = |e: &dyn std::fmt::Display| torn(path, format!("not a whole Parquet file of {size} bytes ({e})"));
        let builder = ParquetRecordBatchReaderBuilder::try_new(Ending(bytes)).map_err(|e| broken(&e))?;
        let list = builder.metadata().file_metadata().key_value_metadata();
        let pairs = list
            .into_iter()
            .flatten()
            .filter_map(|kv| Some((kv.key.clone(), kv.value.clone()?)))
            .collect();
        let reader = builder.with_batch_size(1 << 16).build().map_err(|e| broken(&e))?;
        let batches = reader.map(|b| b.map_err(|e| broken(&e))).collect::<Result<_>>()?;
        Ok(Self {
            path: path.into(),
            pairs,
            batches,
        })
    }

    /// Number of rows, by the footer alone.
    ///
    /// # Errors
    /// Bytes that are no whole Parquet file.
    pub fn rows_of(path: &str, bytes: Bytes) -> Result<u64> {
        let builder = opened(bytes).map_err(|e| torn(path, e))?;
        Ok(builder.metadata().file_metadata().num_rows() as u64)
    }

    /// The metadata `key`, by the footer alone.
    ///
    /// # Errors
    /// Bytes that are no whole Parquet file.
    pub fn pair_of(path: &str, bytes: Bytes, key: &str) -> Result<Option<String>> {
        let builder = opened(bytes).map_err(|e| torn(path, e))?;
        let list = builder.metadata().file_metadata().key_value_metadata();
        let found = list.into_iter().flatten().find(|kv| kv.key == key);
        Ok(found.and_then(|kv| kv.value.clone()))
    }

    /// The metadata `key`; `nothing` where there is none.
    pub fn pair(&self, key: &str) -> String {
        self.pairs.get(key).cloned().unwrap_or_else(|| "nothing".into())
    }

    /// Rows of all row groups.
    pub fn rows(&self) -> usize {
        self.batches.iter().map(RecordBatch::num_rows).sum()
    }

    /// Names and types, as in `other`?
    pub fn schema(&self) -> Option<Arc<Schema>> {
        self.batches.first().map(RecordBatch::schema)
    }

    fn columns(&self, name: &str) -> Result<Vec<&ArrayRef>> {
        let missing = || {
            Error::bad(
                &self.path,
                "columns",
                format!("no `{name}`"),
                "those of schemas/README.md",
            )
        };
        let get = |b: &'_ RecordBatch| b.schema().index_of(name).map_err(|_| missing());
        self.batches.iter().map(|b| Ok(b.column(get(b)?))).collect()
    }

    fn wrong(&self, name: &str, found: &DataType) -> Error {
        Error::bad(
            &self.path,
            format!("column `{name}`"),
            found,
            "the type of schemas/README.md",
        )
    }

    /// A column of UInt64.
    ///
    /// # Errors
    /// No such column, or another type.
    pub fn numbers(&self, name: &str) -> Result<Vec<u64>> {
        let mut all = Vec::new();
        for c in self.columns(name)? {
            let a = c
                .as_primitive_opt::<UInt64Type>()
                .ok_or_else(|| self.wrong(name, c.data_type()))?;
            all.extend_from_slice(a.values());
        }
        Ok(all)
    }

    /// A column of Float64; none for null.
    ///
    /// # Errors
    /// No such column, or another type.
    pub fn values(&self, name: &str) -> Result<Vec<Option<f64>>> {
        let mut all = Vec::new();
        for c in self.columns(name)? {
            let a = c
                .as_primitive_opt::<Float64Type>()
                .ok_or_else(|| self.wrong(name, c.data_type()))?;
            all.extend(a.iter());
        }
        Ok(all)
    }

    /// A column of texts; empty for null.
    ///
    /// # Errors
    /// No such column, or another type.
    pub fn texts(&self, name: &str) -> Result<Vec<String>> {
        let mut all = Vec::new();
        for c in self.columns(name)? {
            let a = c
                .as_string_opt::<i32>()
                .ok_or_else(|| self.wrong(name, c.data_type()))?;
            all.extend(a.iter().map(|x| x.unwrap_or_default().to_string()));
        }
        Ok(all)
    }

    /// The raw features of all rows; those of units are none in a dataset of a program that did not know them.
    ///
    /// # Errors
    /// A missing column, or one of another type.
    pub fn features(&self) -> Result<Vec<FeatureValues>> {
        let of_unit = |raw: Raw| Feature::OF_UNITS.iter().any(|f| f.form().raws().any(|r| r == raw));
        let values = |raw: Raw, name: &str| match self.values(name) {
            Err(_) if of_unit(raw) => Ok(vec![None; self.rows()]),
            found => found,
        };
        let column = |of: fn(Raw) -> &'static str| {
            let all = Raw::ALL.into_iter().map(|raw| values(raw, of(raw)));
            all.collect::<Result<Vec<_>>>()
        };
        let (means, sds) = (column(Raw::column)?, column(Raw::deviation)?);
        let row = |i: usize| std::array::from_fn(|k| (means[k][i], sds[k][i].unwrap_or(0.0)));
        Ok((0..self.rows()).map(row).collect())
    }
}

/// The features of some runs of one actuator.
pub struct PartRows<'a> {
    /// which runs
    pub part: &'a Part,
    /// by run, in order
    pub rows: Vec<FeatureValues>,
}

/// Columns of `features` before the raw ones.
const KEYS: [&str; 6] = ["actuator", "tail", "position", "sequence", "kind", "run"];

/// The schema of `features`.
pub fn features_schema() -> Schema {
    let text = |n: &str| Field::new(n, DataType::Utf8, false);
    let number = |n: &str| Field::new(n, DataType::Float64, true);
    let mut fields = vec![Field::new(KEYS[5], DataType::UInt64, false)];
    fields.extend(KEYS[..5].iter().map(|n| text(n)));
    fields.extend(["fsj", "zeta", "rest_angle_rad"].map(number));
    fields.extend(Feature::over_nominal().map(Feature::key).map(number));
    fields.extend(raw_fields());
    Schema::new(fields)
}

/// The rows of one row group of `features`; all parts of an actuator are among `parts`.
fn features_batch(plan: &DatasetPlan, parts: &[PartRows<'_>]) -> Result<RecordBatch> {
    // the healthy run of an actuator, sequence and rest angle
    let mut healthy: BTreeMap<(usize, usize, usize), RawFeatures> = BTreeMap::new();
    let raw = |v: &FeatureValues| RawFeatures::from_values(v.map(|x| x.0), None);
    let key = |p: &Part| (p.actuator, p.sequence, p.rest);
    for p in parts.iter().filter(|p| p.part.kind == super::parts::Kind::Map) {
        for (run, v) in p.part.runs.clone().zip(&p.rows) {
            if plan.fault(p.part, run) == schemas::fault::FaultState::NOMINAL {
                healthy.insert(key(p.part), raw(v));
            }
        }
    }
    let mut texts: [Vec<&str>; 5] = Default::default();
    let mut runs = Vec::new();
    let mut numbers = vec![Vec::new(); 3 + Feature::over_nominal().count()];
    let mut rows = Vec::new();
    for p in parts {
        let a = &plan.actuators[p.part.actuator];
        let nominal = healthy.get(&key(p.part));
        let sequence = &plan.sequences[p.part.sequence].name;
        for (run, v) in p.part.runs.clone().zip(&p.rows) {
            let keys = [a.id.as_str(), &a.tail, &a.position, sequence, p.part.kind.name()];
            for (column, text) in texts.iter_mut().zip(keys) {
                column.push(text);
            }
            runs.push(run);
            let fault = plan.fault(p.part, run);
            let place = [fault.fsj, fault.zeta, plan.rest_angles_rad[p.part.rest]].map(Some);
            let over = Feature::over_nominal().map(|f| f.value(&raw(v), nominal?));
            for (column, x) in numbers.iter_mut().zip(place.into_iter().chain(over)) {
                column.push(x);
            }
            rows.push(*v);
        }
    }
    let mut columns: Vec<ArrayRef> = vec![Arc::new(UInt64Array::from(runs))];
    columns.extend(
        texts
            .into_iter()
            .map(|t| -> ArrayRef { Arc::new(StringArray::from(t)) }),
    );
    columns.extend(
        numbers
            .into_iter()
            .map(|x| -> ArrayRef { Arc::new(Float64Array::from(x)) }),
    );
    columns.extend(raw_columns(&rows));
    RecordBatch::try_new(Arc::new(features_schema()), columns).map_err(|e| torn("features", e))
}

/// A file of `features`: a row group for each of `groups`.
///
/// * `more` metadata, beside those that all tables have
///
/// # Errors
/// What the Parquet writer refuses.
pub fn features_file(plan: &DatasetPlan, groups: &[Vec<PartRows<'_>>], more: Vec<(String, String)>) -> Result<Vec<u8>> {
    let batches: Vec<RecordBatch> = groups.iter().map(|g| features_batch(plan, g)).collect::<Result<_>>()?;
    let mut pairs = pairs(plan);
    pairs.extend(more);
    table_bytes(&batches, pairs)
}

/// The table `actuators`.
///
/// * `path` for messages
///
/// # Errors
/// What the Parquet writer refuses.
pub fn actuators_file(plan: &DatasetPlan, path: &str) -> Result<Vec<u8>> {
    let mut fields: Vec<Field> = ["actuator", "tail", "position", "parameters"]
        .map(|n| Field::new(n, DataType::Utf8, false))
        .to_vec();
    fields.extend(PARAMETERS.map(|p| Field::new(p.0, DataType::Float64, false)));
    let text = |f: &dyn Fn(&super::plan::PlannedActuator) -> String| -> ArrayRef {
        Arc::new(StringArray::from_iter_values(plan.actuators.iter().map(f)))
    };
    let mut columns = vec![
        text(&|a| a.id.clone()),
        text(&|a| a.tail.clone()),
        text(&|a| a.position.clone()),
        text(&|a| a.parameters.fingerprint()),
    ];
    for k in 0..PARAMETERS.len() {
        let values = plan.actuators.iter().map(|a| a.parameters.values()[k]);
        columns.push(Arc::new(Float64Array::from_iter_values(values)));
    }
    let batch = RecordBatch::try_new(Arc::new(Schema::new(fields)), columns).map_err(|e| torn(path, e))?;
    table_bytes(&[batch], pairs(plan))
}
