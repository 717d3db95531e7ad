//! Telemetry of many runs in one Parquet file that is put together in memory: runs that are simulated
//! side by side are encoded side by side, and become row groups of the file in any order wanted.
//! `README.md` of this crate is the specification of the table; [`crate::recording::Recording`] reads it.

use crate::channel::{Channel, ChannelSet};
use crate::error::{Error, Result};
use crate::recording::{telemetry_schema, writer_properties};
use crate::telemetry::TelemetryView;
use arrow::array::{ArrayRef, Float32Array, Float64Array, Int64Array, UInt64Array};
use arrow::datatypes::Schema;
use parquet::arrow::ArrowSchemaConverter;
use parquet::arrow::arrow_writer::{ArrowColumnChunk, ArrowColumnWriter, ArrowRowGroupWriterFactory, compute_leaves};
use parquet::errors::ParquetError;
use parquet::file::properties::{WriterProperties, WriterPropertiesPtr};
use parquet::file::writer::SerializedFileWriter;
use parquet::schema::types::SchemaDescriptor;
use std::path::Path;
use std::sync::Arc;

/// Samples that are handed to the encoders at once.
const ROWS: usize = 4096;

fn unforeseen(e: ParquetError) -> Error {
    Error::torn(Path::new("telemetry in memory"), e)
}

/// Columns and encodings that all files of one kind share.
pub struct TelemetryLayout {
    schema: Arc<Schema>,
    parquet: SchemaDescriptor,
    factory: ArrowRowGroupWriterFactory,
    channels: Vec<Channel>,
    single: bool,
    rate_hz: f64,
}

impl TelemetryLayout {
    /// * `channels` columns of the files
    /// * `single` samples as f32: right where they come out of a sensor model, which has rounded
    ///   them to f32 already
    /// * `rate_hz` samples a second
    pub fn new(channels: ChannelSet, single: bool, rate_hz: f64) -> Result<Self> {
        let schema = Arc::new(telemetry_schema(channels, single));
        let parquet = ArrowSchemaConverter::new().convert(&schema).map_err(unforeseen)?;
        let properties: WriterPropertiesPtr = Arc::new(Self::properties(&schema, Vec::new()));
        let nowhere = SerializedFileWriter::new(std::io::sink(), parquet.root_schema_ptr(), properties);
        let factory = ArrowRowGroupWriterFactory::new(&nowhere.map_err(unforeseen)?, schema.clone());
        Ok(Self {
            schema,
            parquet,
            factory,
            channels: channels.iter().collect(),
            single,
            rate_hz,
        })
    }

    fn properties(schema: &Schema, pairs: Vec<(String, String)>) -> WriterProperties {
        writer_properties(schema, pairs)
    }

    /// Bytes of a sample before they are encoded.
    pub fn row_bytes(&self) -> usize {
        self.channels.len() * if self.single { 4 } else { 8 }
    }

    /// An encoder for one run.
    ///
    /// * `constants` FSJ, zeta, rest angle [rad]
    pub fn encoder(&self, run: u64, constants: [f64; 3]) -> Result<RunEncoder> {
        Ok(RunEncoder {
            run,
            constants,
            schema: self.schema.clone(),
            columns: self.factory.create_column_writers(0).map_err(unforeseen)?,
            channels: self.channels.clone(),
            rate_hz: self.rate_hz,
            waiting: if self.single {
                Waiting::Single(vec![Vec::with_capacity(ROWS); self.channels.len()])
            } else {
                Waiting::Double(vec![Vec::with_capacity(ROWS); self.channels.len()])
            },
            time: Vec::with_capacity(ROWS),
            rows: 0,
        })
    }

    /// The file of runs in the given order, with `pairs` as its metadata.
    pub fn file(&self, runs: Vec<RunChunk>, pairs: Vec<(String, String)>) -> Result<Vec<u8>> {
        let properties = Arc::new(Self::properties(&self.schema, pairs));
        let mut bytes = Vec::new();
        let mut file =
            SerializedFileWriter::new(&mut bytes, self.parquet.root_schema_ptr(), properties).map_err(unforeseen)?;
        for run in runs {
            let mut group = file.next_row_group().map_err(unforeseen)?;
            for chunk in run.columns {
                chunk.append_to_row_group(&mut group).map_err(unforeseen)?;
            }
            group.close().map_err(unforeseen)?;
        }
        file.close().map_err(unforeseen)?;
        Ok(bytes)
    }
}

enum Waiting {
    Single(Vec<Vec<f32>>),
    Double(Vec<Vec<f64>>),
}

/// Encodes one run as it comes.
pub struct RunEncoder {
    run: u64,
    constants: [f64; 3],
    schema: Arc<Schema>,
    columns: Vec<ArrowColumnWriter>,
    channels: Vec<Channel>,
    rate_hz: f64,
    waiting: Waiting,
    time: Vec<i64>,
    rows: u64,
}

/// An encoded run: a row group to be.
pub struct RunChunk {
    pub run: u64,
    pub rows: u64,
    columns: Vec<ArrowColumnChunk>,
}

impl RunEncoder {
    /// Takes the next samples.
    ///
    /// # Errors
    /// A view without one of the channels.
    pub fn push(&mut self, view: &TelemetryView<'_>) -> Result<()> {
        for (k, &c) in self.channels.iter().enumerate() {
            let values = view.column(c).ok_or_else(|| {
                let why = format!("a block without channel {}", c.name());
                Error::torn(Path::new("telemetry in memory"), why)
            })?;
            match &mut self.waiting {
                Waiting::Single(w) => w[k].extend(values.iter().map(|&x| x as f32)),
                Waiting::Double(w) => w[k].extend_from_slice(values),
            }
        }
        let end = |i: usize| ((view.first + i as u64) as f64 / self.rate_hz * 1e9).round() as i64;
        self.time.extend((0..view.rows).map(end));
        self.rows += view.rows as u64;
        if self.time.len() >= ROWS { self.flush() } else { Ok(()) }
    }

    fn flush(&mut self) -> Result<()> {
        let n = self.time.len();
        if n == 0 {
            return Ok(());
        }
        let time = std::mem::replace(&mut self.time, Vec::with_capacity(ROWS));
        let mut arrays: Vec<ArrayRef> = vec![Arc::new(UInt64Array::from(vec![self.run; n]))];
        for x in self.constants {
            arrays.push(Arc::new(Float64Array::from(vec![x; n])));
        }
        arrays.push(Arc::new(Int64Array::from(time)));
        match &mut self.waiting {
            Waiting::Single(w) => {
                arrays.extend(w.iter_mut().map(|v| -> ArrayRef {
                    Arc::new(Float32Array::from(std::mem::replace(v, Vec::with_capacity(ROWS))))
                }))
            }
            Waiting::Double(w) => {
                arrays.extend(w.iter_mut().map(|v| -> ArrayRef {
                    Arc::new(Float64Array::from(std::mem::replace(v, Vec::with_capacity(ROWS))))
                }))
            }
        }
        for ((field, array), column) in self.schema.fields().iter().zip(&arrays).zip(&mut self.columns) {
            for leaf in compute_leaves(field, array).map_err(unforeseen)? {
                column.write(&leaf).map_err(unforeseen)?;
            }
        }
        Ok(())
    }

    /// Ends the run.
    pub fn finish(mut self) -> Result<RunChunk> {
        self.flush()?;
        let close = |c: ArrowColumnWriter| c.close().map_err(unforeseen);
        Ok(RunChunk {
            run: self.run,
            rows: self.rows,
            columns: self.columns.into_iter().map(close).collect::<Result<_>>()?,
        })
    }
}
