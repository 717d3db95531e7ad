//! The table on the wire: a row a frame, and what a row from outside may hold.

use super::MOST_ROWS;
use anyhow::{Result, bail};
use arrow::array::{
    Array, ArrayRef, AsArray, Float64Array, ListArray, RecordBatch, StringArray, UInt32Array, UInt64Array,
};
use arrow::buffer::OffsetBuffer;
use arrow::datatypes::{DataType, Field, Float64Type, Schema, SchemaRef, UInt32Type, UInt64Type};
use schemas::SCHEMA_VERSION;
use schemas::channel::{Channel, ChannelSet};
use schemas::foreign;
use schemas::stream::frame::{BEGIN, END, FrameHeader, NAMES, RunDescription, SAMPLES};
use std::collections::HashMap;
use std::sync::{Arc, LazyLock};

/// Metadata key of the schema version in the IPC stream.
const VERSION: &str = "ema.schema_version";

/// Greatest number of a frame or a sample that is believed.
pub(super) const MOST: u64 = 1 << 53;

/// The schema of the table.
pub(super) fn schema() -> SchemaRef {
    static SCHEMA: LazyLock<SchemaRef> = LazyLock::new(make_schema);
    SCHEMA.clone()
}

fn make_schema() -> SchemaRef {
    let mut fields = Vec::new();
    for name in ["kind", "rows"] {
        fields.push(Field::new(name, DataType::UInt32, false));
    }
    for name in ["run", "stream", "frame", "first", "total_rows", "publish_ns"] {
        fields.push(Field::new(name, DataType::UInt64, false));
    }
    for name in ["actuator", "parameters", "sensors", "sequence"] {
        fields.push(Field::new(name, DataType::Utf8, false));
    }
    for name in ["rate_hz", "load_n_m"] {
        fields.push(Field::new(name, DataType::Float64, false));
    }
    for c in Channel::ALL {
        let unit = HashMap::from([("unit".to_string(), c.unit().to_string())]);
        fields
            .push(Field::new_list(c.name(), Field::new_list_field(DataType::Float64, false), true).with_metadata(unit));
    }
    let version = HashMap::from([(VERSION.to_string(), SCHEMA_VERSION.to_string())]);
    Arc::new(Schema::new(fields).with_metadata(version))
}

/// Refuses another table.
///
/// # Errors
/// Another schema version, or other columns.
pub(super) fn check(found: &Schema) -> Result<()> {
    let version = found.metadata().get(VERSION).map_or("", String::as_str);
    if version != SCHEMA_VERSION.to_string() {
        let version = foreign::value(version);
        bail!("schema version `{version}`; allowed: {SCHEMA_VERSION}");
    }
    if found.fields() != schema().fields() {
        bail!("other columns than those of schema version {SCHEMA_VERSION}");
    }
    Ok(())
}

/// A frame, or a part of one, as one row.
///
/// * `frame` its number on the wire
/// * `samples` the columns, and which rows of them
///
/// # Errors
/// What Arrow refuses.
pub(super) fn to_row(
    h: &FrameHeader,
    frame: u64,
    samples: Option<(&RecordBatch, usize, usize)>,
) -> Result<RecordBatch> {
    let run = h.description();
    let u32s = |x: u32| -> ArrayRef { Arc::new(UInt32Array::from(vec![x])) };
    let u64s = |x: u64| -> ArrayRef { Arc::new(UInt64Array::from(vec![x])) };
    let text = |x: &str| -> ArrayRef { Arc::new(StringArray::from(vec![x])) };
    let number = |x: f64| -> ArrayRef { Arc::new(Float64Array::from(vec![x])) };
    let (from, rows) = samples.map_or((0, 0), |(_, from, rows)| (from, rows));
    let mut columns = vec![
        u32s(h.kind),
        u32s(rows as u32),
        u64s(h.run),
        u64s(h.stream),
        u64s(frame),
        u64s(h.first.saturating_add(from as u64)),
        u64s(h.total_rows),
        u64s(h.publish_ns),
        text(&run.actuator),
        text(&run.parameters),
        text(&run.sensors),
        text(&run.sequence),
        number(h.rate_hz),
        number(h.load_n_m),
    ];
    for c in Channel::ALL {
        let item = Arc::new(Field::new_list_field(DataType::Float64, false));
        let list = |values: ArrayRef| -> ArrayRef {
            let offsets = OffsetBuffer::from_lengths([values.len()]);
            Arc::new(ListArray::new(item.clone(), offsets, values, None))
        };
        let values = samples.and_then(|(b, from, rows)| Some(b.column_by_name(c.name())?.slice(from, rows)));
        columns.push(match values {
            Some(values) => list(values),
            // what a frame has no samples of: empty where the run has the channel, null where not
            None if run.channels.contains(*c) => list(Arc::new(Float64Array::from(Vec::<f64>::new()))),
            None => Arc::new(ListArray::new_null(item, 1)),
        });
    }
    Ok(RecordBatch::try_new(schema(), columns)?)
}

/// One row of a received batch.
#[derive(Clone, Copy)]
pub(super) struct Row<'a> {
    pub batch: &'a RecordBatch,
    pub i: usize,
}

impl Row<'_> {
    pub fn u64(&self, name: &str) -> u64 {
        self.batch[name].as_primitive::<UInt64Type>().value(self.i)
    }
    pub fn u32(&self, name: &str) -> u32 {
        self.batch[name].as_primitive::<UInt32Type>().value(self.i)
    }
    fn number(&self, name: &str) -> f64 {
        self.batch[name].as_primitive::<Float64Type>().value(self.i)
    }
    pub fn text(&self, name: &str) -> &str {
        self.batch[name].as_string::<i32>().value(self.i)
    }
    /// The samples of a channel, if the run has it.
    pub fn column(&self, c: Channel) -> Option<ArrayRef> {
        let list = self.batch[c.name()].as_list::<i32>();
        list.is_valid(self.i).then(|| list.value(self.i))
    }
    pub fn description(&self) -> RunDescription {
        let present = Channel::ALL.iter().copied().filter(|c| self.column(*c).is_some());
        RunDescription {
            actuator: self.text("actuator").into(),
            parameters: self.text("parameters").into(),
            sensors: self.text("sensors").into(),
            sequence: self.text("sequence").into(),
            run: self.u64("run"),
            rate_hz: self.number("rate_hz"),
            channels: ChannelSet::of(present),
            total_rows: self.u64("total_rows"),
            load_n_m: self.number("load_n_m"),
        }
    }

    /// What a frame may be, before anything is done with it.
    ///
    /// # Errors
    /// The first thing that is not allowed, in one line.
    pub fn check(&self) -> Result<(), String> {
        let (kind, rows) = (self.u32("kind"), self.u32("rows") as usize);
        let actuator = self.text("actuator");
        if actuator.len() > 32 || !actuator.chars().all(foreign::is_plain) {
            return Err(format!(
                "actuator name `{}`; allowed: {NAMES}",
                foreign::value(actuator)
            ));
        }
        for (name, least) in [("frame", 0), ("first", u64::from(kind == SAMPLES))] {
            let found = self.u64(name);
            if !(least..=MOST).contains(&found) {
                return Err(format!("{name} {found}; allowed: {least} to 2^53"));
            }
        }
        let rate = self.number("rate_hz");
        if !(rate.is_finite() && rate > 0.0) {
            return Err(format!("rate {rate} Hz; allowed: a finite rate above 0"));
        }
        match kind {
            BEGIN | END => return Ok(()),
            SAMPLES if (1..=MOST_ROWS).contains(&rows) => {}
            SAMPLES => return Err(format!("{rows} rows; allowed: 1 to {MOST_ROWS}")),
            _ => {
                return Err(format!(
                    "kind {kind}; allowed: {BEGIN} begin, {SAMPLES} samples, {END} end"
                ));
            }
        }
        for c in Channel::ALL {
            if let Some(values) = self.column(*c).filter(|v| v.len() != rows) {
                let found = values.len();
                return Err(format!("column `{}` has {found} values; allowed: {rows}", c.name()));
            }
        }
        Ok(())
    }
}
