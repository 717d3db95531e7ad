//! Telemetry in Parquet: [`Recorder`] writes, [`Recording`] reads. `README.md` of this crate is
//! the specification of the table.

use crate::SCHEMA_VERSION;
use crate::channel::{Channel, ChannelSet};
use crate::checksums::{RunDigest, RunSum, pair};
use crate::error::{Error, Result, temporary};
use crate::fault::FaultState;
use crate::table::{Batches, open, pairs, writer_properties};
use crate::telemetry::{TelemetryBuffer, TelemetryHeader, TelemetrySink, TelemetryView};
use arrow::array::{Array, ArrayRef, AsArray, Float32Array, Float64Array, Int64Array, RecordBatch, UInt64Array};
use arrow::datatypes::{DataType, Field, Float32Type, Float64Type, Int64Type, Schema, SchemaRef, UInt64Type};
use parquet::arrow::ArrowWriter;
use parquet::file::metadata::KeyValue;
use std::collections::BTreeMap;
use std::fs::File;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// What made a file; stored in its key-value metadata under `ema.*`.
#[derive(Clone, Debug, PartialEq, Default)]
pub struct Provenance {
    /// name of the actuator
    pub actuator: String,
    /// fingerprint of the parameters
    pub parameters: String,
    /// name of the sequence
    pub sequence: String,
    /// fingerprint of the sequence
    pub sequence_fingerprint: String,
    /// fingerprint of the fault grid, empty for a single run
    pub grid: String,
    /// fingerprint of the sensor model, or `none`
    pub sensors: String,
    /// effects beyond the base model, comma separated
    pub effects: String,
    /// telemetry rate [Hz]
    pub rate_hz: f64,
    /// step of the simulation [s]
    pub step_s: f64,
    /// constant load torque [N m, motor side]
    pub load_n_m: f64,
    /// seed of the sensor noise; in a dataset that of run number 0, each run adds its number
    pub seed: u64,
    /// source revision of the program
    pub commit: String,
    /// `ntb`, `sm`, `measured`, or `stream`: recorded from a stream that named its load
    pub model: String,
}

impl Provenance {
    /// As key-value pairs, schema version first.
    pub fn pairs(&self) -> Vec<(String, String)> {
        let mut v = vec![("ema.schema_version".to_string(), SCHEMA_VERSION.to_string())];
        for (k, x) in [
            ("actuator", self.actuator.clone()),
            ("parameters", self.parameters.clone()),
            ("sequence", self.sequence.clone()),
            ("sequence_fingerprint", self.sequence_fingerprint.clone()),
            ("grid", self.grid.clone()),
            ("sensors", self.sensors.clone()),
            ("effects", self.effects.clone()),
            ("rate_hz", self.rate_hz.to_string()),
            ("step_s", self.step_s.to_string()),
            ("load_n_m", self.load_n_m.to_string()),
            ("seed", self.seed.to_string()),
            ("commit", self.commit.clone()),
            ("model", self.model.clone()),
        ] {
            v.push((format!("ema.{k}"), x));
        }
        v
    }

    /// From key-value pairs; refuses another schema version.
    ///
    /// # Errors
    /// Another schema version or none; a rate, step, load or seed that is no number.
    pub fn from_pairs(path: &Path, pairs: &BTreeMap<String, String>) -> Result<Self> {
        let file = path.display().to_string();
        let get = |k: &str| pairs.get(&format!("ema.{k}")).cloned();
        let version = get("schema_version").unwrap_or_else(|| "none".into());
        if version != SCHEMA_VERSION.to_string() {
            let allowed = format!("schema version {SCHEMA_VERSION}");
            return Err(Error::bad(file, "metadata `ema.schema_version`", version, allowed));
        }
        let number = |k: &str| -> Result<f64> {
            let text = get(k).unwrap_or_default();
            text.parse()
                .map_err(|_| Error::bad(&file, format!("metadata `ema.{k}`"), &text, "a number"))
        };
        Ok(Self {
            actuator: get("actuator").unwrap_or_default(),
            parameters: get("parameters").unwrap_or_default(),
            sequence: get("sequence").unwrap_or_default(),
            sequence_fingerprint: get("sequence_fingerprint").unwrap_or_default(),
            grid: get("grid").unwrap_or_default(),
            sensors: get("sensors").unwrap_or_default(),
            effects: get("effects").unwrap_or_default(),
            rate_hz: number("rate_hz")?,
            step_s: number("step_s")?,
            load_n_m: number("load_n_m")?,
            seed: {
                let text = get("seed").unwrap_or_default();
                text.parse()
                    .map_err(|_| Error::bad(&file, "metadata `ema.seed`", &text, "a whole number"))?
            },
            commit: get("commit").unwrap_or_default(),
            model: get("model").unwrap_or_default(),
        })
    }
}

/// Columns of a telemetry table: run and faults, time, channels as f32 (`single`) or f64.
pub fn telemetry_schema(channels: ChannelSet, single: bool) -> Schema {
    let mut fields = vec![
        Field::new("run", DataType::UInt64, false),
        Field::new("fsj", DataType::Float64, true),
        Field::new("zeta", DataType::Float64, true),
        Field::new("rest_angle_rad", DataType::Float64, true),
        Field::new("t_ns", DataType::Int64, false),
    ];
    let kind = if single { DataType::Float32 } else { DataType::Float64 };
    for c in channels.iter() {
        let unit: std::collections::HashMap<String, String> = [("unit".to_string(), c.unit().to_string())].into();
        fields.push(Field::new(c.name(), kind.clone(), false).with_metadata(unit));
    }
    Schema::new(fields)
}

/// A block of samples as rows of a telemetry table.
///
/// * `schema` of [`telemetry_schema`]
/// * `rate_hz` telemetry rate [Hz]
///
/// # Errors
/// A block that lacks a channel of the schema, in words.
///
/// # Panics
/// If the schema is another one.
pub fn telemetry_batch(
    schema: &SchemaRef,
    rate_hz: f64,
    header: &TelemetryHeader,
    view: &TelemetryView<'_>,
) -> std::result::Result<RecordBatch, String> {
    let n = view.rows;
    let constant = |x: Option<f64>| -> ArrayRef { Arc::new(Float64Array::from(vec![x; n])) };
    let time = |i: usize| ((view.first + i as u64) as f64 / rate_hz * 1e9).round() as i64;
    let mut columns: Vec<ArrayRef> = vec![
        Arc::new(UInt64Array::from(vec![header.run; n])),
        constant(header.fault.map(|f| f.fsj)),
        constant(header.fault.map(|f| f.zeta)),
        constant(header.rest_angle_rad),
        Arc::new(Int64Array::from_iter_values((0..n).map(time))),
    ];
    for f in &schema.fields()[5..] {
        let c = Channel::from_name(f.name()).expect("the schema was made of channels");
        let values = view
            .column(c)
            .ok_or_else(|| format!("a block without channel {}", c.name()))?;
        columns.push(if *f.data_type() == DataType::Float32 {
            Arc::new(Float32Array::from_iter_values(values.iter().map(|&x| x as f32)))
        } else {
            Arc::new(Float64Array::from_iter_values(values.iter().copied()))
        });
    }
    RecordBatch::try_new(schema.clone(), columns).map_err(|e| e.to_string())
}

/// A failure of the disk, as the Parquet writer reports it.
fn unwritten(path: &Path, why: impl std::fmt::Display) -> Error {
    Error::io(path, "cannot be written", std::io::Error::other(why.to_string()))
}

/// Writes runs into one Parquet file, a row group a run. The file appears under its name only
/// when [`Recorder::finish`] has written all of it.
pub struct Recorder {
    path: PathBuf,
    tmp: PathBuf,
    schema: Arc<Schema>,
    rate_hz: f64,
    writer: Option<ArrowWriter<File>>,
    pairs: Vec<(String, String)>,
    /// The run that is being written.
    run: Option<(u64, RunSum)>,
    /// Runs that were written.
    runs: Vec<(u64, RunDigest)>,
}

impl Recorder {
    /// * `channels` columns of the file
    /// * `single` samples as f32: right where they come out of a sensor model, which has rounded
    ///   them to f32 already
    ///
    /// # Errors
    /// A file that cannot be created beside `path`.
    pub fn create(path: &Path, provenance: &Provenance, channels: ChannelSet, single: bool) -> Result<Self> {
        let schema = Arc::new(telemetry_schema(channels, single));
        let properties = writer_properties(&schema, provenance.pairs());
        let tmp = temporary(path);
        let file = File::create(&tmp).map_err(|e| Error::io(&tmp, "cannot be created", e))?;
        let writer = ArrowWriter::try_new(file, schema.clone(), Some(properties)).map_err(|e| unwritten(path, e))?;
        Ok(Self {
            path: path.into(),
            tmp,
            schema,
            rate_hz: provenance.rate_hz,
            writer: Some(writer),
            pairs: provenance.pairs(),
            run: None,
            runs: Vec::new(),
        })
    }

    fn end_run(&mut self) {
        self.runs.extend(self.run.take().map(|(run, sum)| (run, sum.finish())));
    }

    /// Ends the file and gives it its name.
    ///
    /// # Errors
    /// What the disk refuses; what stood under the name before then stays.
    pub fn finish(mut self) -> Result<()> {
        let mut writer = self.writer.take().expect("finish is called once");
        self.end_run();
        let (key, checksums) = pair(self.pairs.drain(..), self.runs.iter().map(|(run, d)| (*run, d)));
        writer.append_key_value_metadata(KeyValue::new(key, checksums));
        let result = writer
            .into_inner()
            .map_err(|e| unwritten(&self.path, e))
            .and_then(|file| {
                file.sync_all()
                    .map_err(|e| Error::io(&self.path, "cannot be written", e))
            })
            .and_then(|()| {
                std::fs::rename(&self.tmp, &self.path).map_err(|e| Error::io(&self.path, "cannot be renamed", e))
            });
        if result.is_err() {
            let _ = std::fs::remove_file(&self.tmp);
        }
        result
    }
}

impl Drop for Recorder {
    fn drop(&mut self) {
        if self.writer.take().is_some() {
            let _ = std::fs::remove_file(&self.tmp);
        }
    }
}

impl TelemetrySink for Recorder {
    fn accept(&mut self, header: &TelemetryHeader, view: &TelemetryView<'_>) -> Result<()> {
        let writer = self.writer.as_mut().expect("not finished");
        if self.run.as_ref().is_some_and(|(run, _)| *run != header.run) {
            writer.flush().map_err(|e| unwritten(&self.path, e))?;
            self.end_run();
        }
        let batch =
            telemetry_batch(&self.schema, self.rate_hz, header, view).map_err(|e| Error::torn(&self.path, e))?;
        let (_, sum) = self.run.get_or_insert_with(|| (header.run, RunSum::default()));
        sum.take(self.schema.fields(), batch.columns());
        let writer = self.writer.as_mut().expect("not finished");
        writer.write(&batch).map_err(|e| unwritten(&self.path, e))
    }
}

/// A telemetry file opened for reading.
pub struct Recording {
    path: PathBuf,
    /// what made it, from the metadata
    pub provenance: Provenance,
    /// channels that it has columns of; unknown columns are ignored
    pub channels: ChannelSet,
    /// samples of all runs
    pub rows: u64,
}

impl Recording {
    /// Opens a telemetry file and checks its schema version and columns.
    ///
    /// # Errors
    /// No whole Parquet file, another schema version, no column `run` or `t_ns`.
    pub fn open(path: &Path) -> Result<Self> {
        let builder = open(path)?;
        let provenance = Provenance::from_pairs(path, &pairs(&builder))?;
        let names: Vec<&str> = builder.schema().fields().iter().map(|f| f.name().as_str()).collect();
        for needed in ["run", "t_ns"] {
            if !names.contains(&needed) {
                let allowed = format!("column `{needed}`");
                return Err(Error::bad(
                    path.display().to_string(),
                    "columns",
                    names.join(","),
                    allowed,
                ));
            }
        }
        let channels = ChannelSet::of(names.iter().filter_map(|n| Channel::from_name(n)));
        let rows = builder.metadata().file_metadata().num_rows() as u64;
        Ok(Self {
            path: path.into(),
            provenance,
            channels,
            rows,
        })
    }

    /// Hands all rows to `sink`, run after run, in blocks of at most `block` rows.
    ///
    /// # Errors
    /// A torn file, a column of another type, a gap within a run; what `sink` refuses.
    pub fn replay(&self, block: usize, sink: &mut dyn TelemetrySink) -> Result<()> {
        let mut seen = 0;
        let mut buffer = TelemetryBuffer::new(self.channels, block);
        let mut next = (u64::MAX, 0);
        for batch in Batches::whole(&self.path, open(&self.path)?.with_batch_size(block))? {
            let batch = batch?;
            let needed = ["run", "t_ns"]
                .into_iter()
                .chain(self.channels.iter().map(Channel::name));
            for name in needed {
                let nulls = batch.column_by_name(name).and_then(|c| c.nulls());
                if let Some(i) = nulls.and_then(|n| (0..n.len()).find(|&i| n.is_null(i))) {
                    let place = format!("row {}, column `{name}`", seen + i + 1);
                    let file = self.path.display().to_string();
                    return Err(Error::bad(file, place, "null", "a number"));
                }
            }
            seen += batch.num_rows();
            let column = |name: &str| batch.column_by_name(name).expect("checked when opened");
            let wrong = |name: &str, t: &DataType| {
                Error::bad(
                    self.path.display().to_string(),
                    format!("column `{name}`"),
                    t,
                    "the type of schemas/README.md",
                )
            };
            let run = column("run");
            let run = run
                .as_primitive_opt::<UInt64Type>()
                .ok_or_else(|| wrong("run", run.data_type()))?;
            let t_ns = column("t_ns");
            let t_ns = t_ns
                .as_primitive_opt::<Int64Type>()
                .ok_or_else(|| wrong("t_ns", t_ns.data_type()))?;
            let optional = |name: &str, i: usize| -> Option<f64> {
                let c = batch.column_by_name(name)?.as_primitive_opt::<Float64Type>()?;
                (!c.is_null(i)).then(|| c.value(i))
            };
            let mut from = 0;
            while from < batch.num_rows() {
                let id = run.value(from);
                let to = (from..batch.num_rows())
                    .find(|&i| run.value(i) != id)
                    .unwrap_or(batch.num_rows());
                let first = (t_ns.value(from) as f64 * 1e-9 * self.provenance.rate_hz).round() as u64;
                if next.0 == id && next.1 != first {
                    let place = format!("run {id}, t_ns {}", t_ns.value(from));
                    let allowed = format!("sample {} without a gap", next.1);
                    return Err(Error::bad(
                        self.path.display().to_string(),
                        place,
                        format!("sample {first}"),
                        allowed,
                    ));
                }
                next = (id, first + (to - from) as u64);
                for c in self.channels.iter() {
                    let values = column(c.name());
                    let out = buffer.column_mut(c).expect("made with these channels");
                    out.clear();
                    if let Some(v) = values.as_primitive_opt::<Float64Type>() {
                        out.extend_from_slice(&v.values()[from..to]);
                    } else if let Some(v) = values.as_primitive_opt::<Float32Type>() {
                        out.extend(v.values()[from..to].iter().map(|&x| x as f64));
                    } else {
                        return Err(wrong(c.name(), values.data_type()));
                    }
                }
                buffer.first = first;
                buffer.set_rows(to - from);
                let header = TelemetryHeader {
                    run: id,
                    actuator: self.provenance.actuator.clone(),
                    parameters: self.provenance.parameters.clone(),
                    sensors: self.provenance.sensors.clone(),
                    sequence: self.provenance.sequence.clone(),
                    rate_hz: self.provenance.rate_hz,
                    channels: self.channels,
                    fault: match (optional("fsj", from), optional("zeta", from)) {
                        (Some(fsj), Some(zeta)) => Some(FaultState { fsj, zeta }),
                        _ => None,
                    },
                    rest_angle_rad: optional("rest_angle_rad", from),
                };
                sink.accept(&header, &buffer.view())?;
                from = to;
            }
        }
        Ok(())
    }
}
