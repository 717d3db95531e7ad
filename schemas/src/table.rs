//! Tables in Parquet files, whatever their columns: how they are written, and read by a guard that knows what a file of
//! its size can hold.

use crate::checksums::Compared;
use crate::error::{Error, Result};
use crate::guard::{Ending, guarded};
use arrow::array::RecordBatch;
use arrow::datatypes::{DataType, Schema, SchemaRef};
use parquet::arrow::arrow_reader::{ParquetRecordBatchReader, ParquetRecordBatchReaderBuilder};
use parquet::arrow::{ArrowWriter, ProjectionMask};
use parquet::basic::{Compression, Encoding, ZstdLevel};
use parquet::file::metadata::KeyValue;
use parquet::file::properties::{EnabledStatistics, WriterProperties};
use parquet::schema::types::ColumnPath;
use std::collections::BTreeMap;
use std::fs::File;
use std::path::{Path, PathBuf};

/// Writer settings shared by all tables: zstd level 1, no dictionary, byte-stream-split for
/// floats, delta for time, dictionary for the columns that are constant over a run.
pub fn writer_properties(schema: &Schema, pairs: Vec<(String, String)>) -> WriterProperties {
    let mut b = WriterProperties::builder()
        .set_compression(Compression::ZSTD(ZstdLevel::try_new(1).expect("1 is a level")))
        .set_dictionary_enabled(false)
        .set_statistics_enabled(EnabledStatistics::Page)
        .set_data_page_row_count_limit(usize::MAX)
        .set_key_value_metadata(Some(pairs.into_iter().map(|(k, v)| KeyValue::new(k, v)).collect()));
    for f in schema.fields() {
        let column = ColumnPath::from(f.name().as_str());
        b = match (f.name().as_str(), f.data_type()) {
            ("run" | "fsj" | "zeta" | "rest_angle_rad", _) => b.set_column_dictionary_enabled(column, true),
            (_, DataType::Float32 | DataType::Float64) => b.set_column_encoding(column, Encoding::BYTE_STREAM_SPLIT),
            (_, DataType::Int64) => b.set_column_encoding(column, Encoding::DELTA_BINARY_PACKED),
            _ => b,
        };
    }
    b.build()
}

/// Writer settings of a fleet's tables, which are small and asked often: dictionaries for texts and for what
/// repeats, zstd level 1 for these; measured values plain and uncompressed. (Byte-stream-split would take a
/// fifth less room, and readers several times as long.)
pub fn query_properties(schema: &Schema, pairs: Vec<(String, String)>) -> WriterProperties {
    let mut b = writer_properties(schema, pairs)
        .into_builder()
        .set_statistics_enabled(EnabledStatistics::Chunk);
    for f in schema.fields() {
        let column = ColumnPath::from(f.name().as_str());
        let repeats = matches!(f.name().as_str(), "fsj" | "zeta" | "rest_angle_rad");
        b = match f.data_type() {
            DataType::Utf8 => b.set_column_dictionary_enabled(column, true),
            DataType::Float64 if repeats => b,
            DataType::Float64 => b
                .set_column_encoding(column.clone(), Encoding::PLAIN)
                .set_column_compression(column, Compression::UNCOMPRESSED),
            DataType::UInt64 => b
                .set_column_dictionary_enabled(column.clone(), false)
                .set_column_encoding(column, Encoding::DELTA_BINARY_PACKED),
            _ => b,
        };
    }
    b.build()
}

/// Writes a whole table under a temporary name and renames it: it is visible complete or not at all.
///
/// # Errors
/// What the disk refuses.
pub fn write_table(path: &Path, batch: &RecordBatch, pairs: Vec<(String, String)>) -> Result<()> {
    let properties = writer_properties(&batch.schema(), pairs);
    let bytes = in_memory(std::slice::from_ref(batch), properties).map_err(|e| Error::torn(path, e))?;
    crate::error::write_whole(path, &bytes)
}

/// A table of a fleet as the bytes of a Parquet file, a row group a batch; settings as [`query_properties`].
///
/// # Errors
/// What the Parquet writer refuses: batches of different columns.
///
/// # Panics
/// Without a batch.
pub fn table_bytes(batches: &[RecordBatch], pairs: Vec<(String, String)>) -> Result<Vec<u8>> {
    let properties = query_properties(&batches[0].schema(), pairs);
    in_memory(batches, properties).map_err(|e| Error::torn(Path::new("table in memory"), e))
}

fn in_memory(batches: &[RecordBatch], properties: WriterProperties) -> parquet::errors::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    let mut w = ArrowWriter::try_new(&mut bytes, batches[0].schema(), Some(properties))?;
    for b in batches {
        w.write(b)?;
        w.flush()?;
    }
    w.close()?;
    Ok(bytes)
}

/// A Parquet file by its footer, which declares no more than the file can hold.
///
/// # Errors
/// A file that is not there, is empty, is not whole, or whose footer contradicts itself.
pub fn open(path: &Path) -> Result<ParquetRecordBatchReaderBuilder<Ending<File>>> {
    let file = File::open(path).map_err(|e| Error::io(path, "cannot be read", e))?;
    let size = file.metadata().map_err(|e| Error::io(path, "cannot be read", e))?.len();
    if size == 0 {
        return Err(Error::torn(
            path,
            "empty file (0 bytes); allowed: a Parquet or CSV telemetry file",
        ));
    }
    let whole = |e: String| Error::torn(path, format!("not a whole Parquet file of {size} bytes ({e})"));
    let builder = guarded(|| ParquetRecordBatchReaderBuilder::try_new(Ending(file)))
        .map_err(|e| whole(e.to_string()))?
        .map_err(|e| whole(e.to_string()))?;
    crate::declared::check(path, builder.metadata(), size)?;
    Ok(builder)
}

/// Whether the footer of a Parquet file can be read, and declares no more than the file can hold.
///
/// # Errors
/// A file that is not there, is empty, is not whole, or whose footer contradicts itself.
pub fn check_footer(path: &Path) -> Result<()> {
    open(path).map(|_| ())
}

/// The batches of a file; what its decoder cannot stand is a torn file.
pub(crate) struct Batches {
    reader: Option<ParquetRecordBatchReader>,
    path: PathBuf,
    /// Rows that the footer declares and that did not come yet.
    due: u64,
    /// Of a whole table with checksums of its runs.
    checksums: Option<Compared>,
}

impl Batches {
    pub(crate) fn of(path: &Path, builder: ParquetRecordBatchReaderBuilder<Ending<File>>) -> Result<Self> {
        // checked when opened
        let due = builder.metadata().file_metadata().num_rows() as u64;
        let reader = guarded(|| builder.build()).map_err(|e| Error::torn(path, e))?;
        Ok(Self {
            reader: Some(reader.map_err(|e| Error::torn(path, e))?),
            path: path.into(),
            due,
            checksums: None,
        })
    }

    /// All columns, compared with the checksums of the file where it has some.
    pub(crate) fn whole(path: &Path, builder: ParquetRecordBatchReaderBuilder<Ending<File>>) -> Result<Self> {
        let checksums = Compared::of(path, &pairs(&builder));
        Ok(Self {
            checksums,
            ..Self::of(path, builder)?
        })
    }

    /// Counts and compares the rows of a block; at the end, all that the footer declares must have come.
    fn counted(&mut self, batch: Option<RecordBatch>) -> Option<Result<RecordBatch>> {
        match batch {
            Some(b) => {
                self.due = self.due.saturating_sub(b.num_rows() as u64);
                let compared = self.checksums.as_mut().map_or(Ok(()), |c| c.take(&b));
                if compared.is_err() {
                    self.reader = None;
                }
                Some(compared.map(|()| b))
            }
            None if self.due > 0 => {
                let why = format!("not whole: {} rows fewer than its footer declares", self.due);
                self.reader = None;
                Some(Err(Error::torn(&self.path, why)))
            }
            None => {
                self.reader = None;
                let whole = self.checksums.take().map_or(Ok(()), |c| c.end());
                whole.err().map(Err)
            }
        }
    }
}

impl Iterator for Batches {
    type Item = Result<RecordBatch>;

    fn next(&mut self) -> Option<Self::Item> {
        let reader = self.reader.as_mut()?;
        match guarded(|| reader.next()) {
            Ok(batch) => match batch.transpose() {
                Ok(batch) => self.counted(batch),
                Err(e) => Some(Err(Error::torn(&self.path, e))),
            },
            Err(e) => {
                self.reader = None;
                Some(Err(Error::torn(&self.path, e)))
            }
        }
    }
}

/// All rows of any Parquet file.
///
/// # Errors
/// A file that is not there, is empty, or is not whole.
pub fn read_batches(path: &Path) -> Result<Vec<RecordBatch>> {
    Ok(read_table(path)?.1)
}

/// The columns of any Parquet file, rows or none, and all its rows.
///
/// # Errors
/// As [`read_batches`].
pub fn read_table(path: &Path) -> Result<(SchemaRef, Vec<RecordBatch>)> {
    let builder = open(path)?;
    let schema = builder.schema().clone();
    Ok((schema, Batches::whole(path, builder)?.collect::<Result<_>>()?))
}

/// The rows of some columns of a Parquet file, in blocks: those whose name `wanted` takes.
///
/// # Errors
/// As [`read_batches`], in turn; what `sink` refuses.
pub fn read_columns(
    path: &Path,
    wanted: impl Fn(&str) -> bool,
    mut sink: impl FnMut(&RecordBatch) -> Result<()>,
) -> Result<()> {
    let builder = open(path)?;
    let fields = builder.schema().fields();
    let columns: Vec<usize> = (0..fields.len()).filter(|&i| wanted(fields[i].name())).collect();
    let mask = ProjectionMask::roots(builder.parquet_schema(), columns);
    for batch in Batches::of(path, builder.with_projection(mask).with_batch_size(8192))? {
        sink(&batch?)?;
    }
    Ok(())
}

/// The columns of a Parquet file; nothing of its rows is read.
///
/// # Errors
/// As [`check_footer`].
pub fn columns(path: &Path) -> Result<SchemaRef> {
    Ok(open(path)?.schema().clone())
}

/// Key-value metadata of a Parquet file.
///
/// # Errors
/// A file that is not there, is empty, or is not whole.
pub fn metadata(path: &Path) -> Result<BTreeMap<String, String>> {
    Ok(pairs(&open(path)?))
}

pub(crate) fn pairs(builder: &ParquetRecordBatchReaderBuilder<Ending<File>>) -> BTreeMap<String, String> {
    let list = builder.metadata().file_metadata().key_value_metadata();
    list.into_iter()
        .flatten()
        .filter_map(|kv| Some((kv.key.clone(), kv.value.clone()?)))
        .collect()
}
