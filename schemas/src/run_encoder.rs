//! Telemetry of many runs in one Parquet file that is put together in memory: runs that are simulated
//! side by side are encoded side by side, and become row groups of the file in any order wanted.
//! `README.md` of this crate is the specification of the table; [`crate::recording::Recording`] reads it.

use crate::channel::{Channel, ChannelSet};
use crate::checksums::{RunDigest, RunSum, pair};
use crate::error::{Error, Result};
use crate::recording::telemetry_schema;
use crate::table::writer_properties;
use crate::telemetry::TelemetryView;
use arrow::array::{ArrayRef, Float32Array, Float64Array, Int64Array, UInt64Array};
use arrow::datatypes::{Field, Schema};
use parquet::arrow::ArrowSchemaConverter;
use parquet::arrow::arrow_writer::{ArrowColumnChunk, ArrowColumnWriter, ArrowRowGroupWriterFactory, compute_leaves};
use parquet::basic::{Compression, Encoding};
use parquet::errors::ParquetError;
use parquet::file::properties::{EnabledStatistics, WriterProperties, WriterPropertiesPtr};
use parquet::file::writer::SerializedFileWriter;
use parquet::schema::types::{ColumnPath, SchemaDescriptor};
use std::path::Path;
use std::sync::Arc;

/// Samples that are handed to the encoders at once.
const ROWS: usize = 16_384;

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
    ///
    /// # Errors
    /// What the Parquet writer refuses; with the columns of the channel table it does not.
    pub fn new(channels: ChannelSet, single: bool, rate_hz: f64) -> Result<Self> {
        // every run has its faults: nothing is null
        let fields = telemetry_schema(channels, single).fields;
        let fields = fields.iter().map(|f| f.as_ref().clone().with_nullable(false));
        let schema = Arc::new(Schema::new(fields.collect::<Vec<Field>>()));
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

    /// As other tables, but for what a run has in common: a dictionary would look up every row of it.
    fn properties(schema: &Schema, pairs: Vec<(String, String)>) -> WriterProperties {
        let mut b = writer_properties(schema, pairs)
            .into_builder()
            .set_statistics_enabled(EnabledStatistics::Chunk);
        for name in ["run", "fsj", "zeta", "rest_angle_rad"] {
            let plain = if name == "run" {
                Encoding::DELTA_BINARY_PACKED
            } else {
                Encoding::PLAIN
            };
            let column = ColumnPath::from(name);
            b = b
                .set_column_dictionary_enabled(column.clone(), false)
                .set_column_encoding(column, plain);
        }
        // nobody looks for it by range
        b = b.set_column_statistics_enabled(ColumnPath::from("rest_angle_rad"), EnabledStatistics::None);
        // differences that are all the same need no further compression
        for name in ["run", "t_ns"] {
            b = b.set_column_compression(ColumnPath::from(name), Compression::UNCOMPRESSED);
        }
        b.build()
    }

    /// Bytes of a sample before they are encoded.
    pub fn row_bytes(&self) -> usize {
        self.channels.len() * if self.single { 4 } else { 8 }
    }

    /// An encoder for one run.
    ///
    /// * `constants` FSJ, zeta, rest angle [rad]
    ///
    /// # Errors
    /// As [`TelemetryLayout::new`].
    pub fn encoder(&self, run: u64, constants: [f64; 3]) -> Result<RunEncoder> {
        let mut arrays: Vec<ArrayRef> = vec![Arc::new(UInt64Array::from(vec![run; ROWS]))];
        arrays.extend(constants.map(|x| -> ArrayRef { Arc::new(Float64Array::from(vec![x; ROWS])) }));
        Ok(RunEncoder {
            run,
            constants: arrays,
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
            sum: RunSum::default(),
        })
    }

    /// The file of runs in the given order, with `pairs` as its metadata.
    ///
    /// # Errors
    /// Runs of another layout.
    pub fn file(&self, runs: Vec<RunChunk>, mut pairs: Vec<(String, String)>) -> Result<Vec<u8>> {
        pairs.push(pair(pairs.clone(), runs.iter().map(|r| (r.run, &r.digest))));
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
    /// run, FSJ, zeta, rest angle, [`ROWS`] times
    constants: Vec<ArrayRef>,
    schema: Arc<Schema>,
    columns: Vec<ArrowColumnWriter>,
    channels: Vec<Channel>,
    rate_hz: f64,
    waiting: Waiting,
    time: Vec<i64>,
    rows: u64,
    sum: RunSum,
}

/// An encoded run: a row group to be.
pub struct RunChunk {
    /// number of the run in its plan
    pub run: u64,
    /// samples
    pub rows: u64,
    columns: Vec<ArrowColumnChunk>,
    digest: RunDigest,
}

impl RunEncoder {
    /// Takes the next samples.
    ///
    /// # Errors
    /// A view without one of the channels.
    pub fn push(&mut self, view: &TelemetryView<'_>) -> Result<()> {
        let room = ROWS - self.time.len();
        if view.rows > room {
            self.push(&view.slice(0, room))?;
            return self.push(&view.slice(room, view.rows));
        }
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
        let numbers = view.first..view.first + view.rows as u64;
        let interval_ns = 1e9 / self.rate_hz;
        if interval_ns.fract() == 0.0 {
            self.time.extend(numbers.map(|n| n as i64 * interval_ns as i64));
        } else {
            let end = |n: u64| (n as f64 / self.rate_hz * 1e9).round() as i64;
            self.time.extend(numbers.map(end));
        }
        self.rows += view.rows as u64;
        if self.time.len() >= ROWS { self.flush() } else { Ok(()) }
    }

    fn flush(&mut self) -> Result<()> {
        let n = self.time.len();
        if n == 0 {
            return Ok(());
        }
        let time = std::mem::replace(&mut self.time, Vec::with_capacity(ROWS));
        let mut arrays: Vec<ArrayRef> = self.constants.iter().map(|a| a.slice(0, n)).collect();
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
        self.sum.take(self.schema.fields(), &arrays);
        for ((field, array), column) in self.schema.fields().iter().zip(&arrays).zip(&mut self.columns) {
            for leaf in compute_leaves(field, array).map_err(unforeseen)? {
                column.write(&leaf).map_err(unforeseen)?;
            }
        }
        Ok(())
    }

    /// Ends the run.
    ///
    /// # Errors
    /// As [`TelemetryLayout::new`].
    pub fn finish(mut self) -> Result<RunChunk> {
        self.flush()?;
        let close = |c: ArrowColumnWriter| c.close().map_err(unforeseen);
        Ok(RunChunk {
            run: self.run,
            rows: self.rows,
            digest: self.sum.finish(),
            columns: self.columns.into_iter().map(close).collect::<Result<_>>()?,
        })
    }
}
