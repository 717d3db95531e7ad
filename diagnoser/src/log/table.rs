//! A Parquet log: new rows go to a journal beside it at once, and from there into the table now and then.
//! Full row groups are copied as they are, so that memory and work do not grow with the rows of years; the
//! table is written under another name and renamed, so that readers see a whole file at all times.

use super::journal::{JOURNAL, Journal};
use super::lock;
use crate::live::StreamId;
use crate::report::{Logged, to_batch};
use arrow::array::{Array, AsArray, RecordBatch};
use arrow::datatypes::{DataType, Field, Schema, UInt64Type};
use parquet::arrow::ArrowWriter;
use parquet::arrow::ProjectionMask;
use parquet::column::writer::ColumnCloseResult;
use parquet::file::metadata::{KeyValue, ParquetMetaData};
use parquet::file::properties::WriterProperties;
use parquet::file::reader::{ChunkReader, FileReader};
use parquet::file::serialized_reader::SerializedFileReader;
use parquet::file::writer::SerializedFileWriter;
use schemas::error::{Error, Result, temporary};
use schemas::guard::guarded;
use schemas::stream::wire::to_text;
use schemas::table::open;
use std::fs::File;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};

/// Rows of a full row group.
const GROUP: usize = if cfg!(test) { 64 } else { 8192 };

/// Rows at the end of the table whose streams are remembered at a start.
const REMEMBERED_ROWS: i64 = 16_384;

/// Least time between two rewritings of the table, and the least time as a multiple of what one takes: the
/// table lags behind by no more, and takes no more than a twentieth of the time of a disk.
const REWRITE: Duration = Duration::from_secs(10);
const REWRITE_SHARE: u32 = 20;

type Parquet<T> = std::result::Result<T, String>;

/// A table and its journal.
pub(super) struct Table {
    path: PathBuf,
    schema: Arc<Schema>,
    journal: Journal,
    /// full row groups at the beginning of the file
    full_groups: usize,
    /// rows after them
    tail: Vec<RecordBatch>,
    /// rows of the journal, which are in the tail too
    waiting: usize,
    rewritten: Option<Instant>,
    cost: Duration,
    _lock: File,
}

/// What a table holds.
struct Found {
    full_groups: usize,
    tail: Vec<RecordBatch>,
    /// the journal whose rows it has taken last
    journal: String,
}

impl Table {
    /// Takes up a table where an earlier process left it, rows of its journal included.
    ///
    /// # Errors
    /// A table of other columns, one that another process writes, a disk that refuses.
    pub fn open(path: &Path) -> Result<Self> {
        let lock_path = beside(path, "lock");
        let lock_file = File::create(&lock_path).map_err(|e| Error::io(path, "cannot be opened", e))?;
        lock(&lock_file, path)?;
        sweep(path);
        let schema = to_batch(&[]).schema();
        // what a process left may be damaged
        let read = || Ok((find(path, &schema)?, Journal::open(path, &schema)?));
        let (found, (journal, left)) = guarded(read).unwrap_or_else(|e| Err(Error::torn(path, e)))?;
        let mut table = Self {
            path: path.into(),
            schema,
            journal,
            full_groups: found.full_groups,
            tail: found.tail,
            waiting: 0,
            rewritten: None,
            cost: Duration::ZERO,
            _lock: lock_file,
        };
        // a process may have died after it had taken the journal's rows, and before it had emptied it
        if left.id.is_empty() || left.id != found.journal {
            table.waiting = left.rows.iter().map(RecordBatch::num_rows).sum();
            table.tail.extend(left.rows);
        }
        if table.waiting > 0 || !path.exists() {
            table.journal.id = left.id;
            table.rewrite()?;
        } else {
            table.journal.renew()?;
        }
        table.rewritten = None;
        Ok(table)
    }

    pub fn file(&self) -> &File {
        self.journal.file()
    }

    pub fn write(&mut self, list: &[Logged]) -> Result<(), String> {
        let rows = to_batch(list);
        self.journal.write(&rows)?;
        self.waiting += list.len();
        self.tail.push(rows);
        Ok(())
    }

    /// When the table is to be rewritten next, if ever.
    pub fn due(&self) -> Option<Instant> {
        let wait = REWRITE.max(self.cost * REWRITE_SHARE);
        let next = self.rewritten.map_or_else(Instant::now, |t| t + wait);
        (self.waiting > 0).then_some(next)
    }

    /// Streams of the last rows.
    pub fn concluded(&self) -> Vec<StreamId> {
        guarded(|| streams(&self.path)).map_or(Vec::new(), Result::unwrap_or_default)
    }

    /// Takes the rows of the journal into the table. On a failure they stay in the journal.
    ///
    /// # Errors
    /// What the disk refuses.
    pub fn rewrite(&mut self) -> Result<()> {
        let start = Instant::now();
        let failed = |why: String| Error::io(&self.path, "cannot be written", std::io::Error::other(why));
        self.rewritten = Some(start);
        let all = arrow::compute::concat_batches(&self.schema, &self.tail).map_err(|e| failed(e.to_string()))?;
        let tmp = temporary(&self.path);
        let written = self.write_whole(&tmp, &all);
        if let Err(why) = written {
            let _ = std::fs::remove_file(&tmp);
            return Err(failed(why));
        }
        let full = all.num_rows() / GROUP;
        self.full_groups += full;
        self.tail = vec![all.slice(full * GROUP, all.num_rows() - full * GROUP)];
        self.waiting = 0;
        self.journal.renew()?;
        self.cost = start.elapsed();
        Ok(())
    }

    fn write_whole(&self, tmp: &Path, tail: &RecordBatch) -> Parquet<()> {
        let memory = bytes::Bytes::from(in_memory(tail, &self.journal.id).map_err(|e| e.to_string())?);
        let new = SerializedFileReader::new(memory.clone()).map_err(|e| e.to_string())?;
        let file = File::create(tmp).map_err(|e| e.to_string())?;
        let m = new.metadata().file_metadata();
        let properties = WriterProperties::builder().set_key_value_metadata(m.key_value_metadata().cloned());
        let root = m.schema_descr().root_schema_ptr();
        let mut out = SerializedFileWriter::new(file, root, Arc::new(properties.build())).map_err(|e| e.to_string())?;
        if self.full_groups > 0 {
            let old = File::open(&self.path).map_err(|e| e.to_string())?;
            let reader = SerializedFileReader::new(old.try_clone().map_err(|e| e.to_string())?);
            let reader = reader.map_err(|e| e.to_string())?;
            copy_groups(&mut out, &old, reader.metadata(), self.full_groups)?;
        }
        copy_groups(&mut out, &memory, new.metadata(), usize::MAX)?;
        let file = out.into_inner().map_err(|e| e.to_string())?;
        file.sync_all().map_err(|e| e.to_string())?;
        std::fs::rename(tmp, &self.path).map_err(|e| e.to_string())
    }
}

/// Copies the first row groups of a file as they are.
fn copy_groups<W: Write + Send>(
    out: &mut SerializedFileWriter<W>,
    from: &impl ChunkReader,
    metadata: &ParquetMetaData,
    groups: usize,
) -> Parquet<()> {
    for group in metadata.row_groups().iter().take(groups) {
        let mut to = out.next_row_group().map_err(|e| e.to_string())?;
        for column in group.columns() {
            let whole = ColumnCloseResult {
                bytes_written: column.compressed_size() as u64,
                rows_written: group.num_rows() as u64,
                metadata: column.clone(),
                bloom_filter: None,
                column_index: None,
                offset_index: None,
            };
            to.append_column(from, whole).map_err(|e| e.to_string())?;
        }
        to.close().map_err(|e| e.to_string())?;
    }
    Ok(())
}

/// Rows as a Parquet file, a row group for every [`GROUP`] of them.
fn in_memory(rows: &RecordBatch, journal: &str) -> parquet::errors::Result<Vec<u8>> {
    let version = ("ema.schema_version".to_string(), schemas::SCHEMA_VERSION.to_string());
    let pairs = vec![version, (JOURNAL.to_string(), journal.to_string())];
    let properties = schemas::table::writer_properties(&rows.schema(), pairs);
    let mut bytes = Vec::new();
    let mut writer = ArrowWriter::try_new(&mut bytes, rows.schema(), Some(properties))?;
    for from in (0..rows.num_rows()).step_by(GROUP) {
        writer.write(&rows.slice(from, GROUP.min(rows.num_rows() - from)))?;
        writer.flush()?;
    }
    writer.close()?;
    Ok(bytes)
}

/// A hidden file beside a table.
pub(super) fn beside(table: &Path, what: &str) -> PathBuf {
    let name = table.file_name().unwrap_or_default().to_string_lossy();
    table.with_file_name(format!(".{name}.{what}"))
}

/// Removes what processes that died left half written; called by who holds the lock of the table.
fn sweep(table: &Path) {
    let begin = beside(table, "tmp-");
    let begin = begin.file_name().unwrap_or_default().to_string_lossy().into_owned();
    let folder = table.parent().filter(|p| !p.as_os_str().is_empty());
    let entries = std::fs::read_dir(folder.unwrap_or(Path::new(".")))
        .into_iter()
        .flatten()
        .flatten();
    for e in entries.filter(|e| e.file_name().to_string_lossy().starts_with(&begin)) {
        let _ = std::fs::remove_file(e.path());
    }
}

/// What stands in a table; refuses other tables.
fn find(path: &Path, schema: &Arc<Schema>) -> Result<Found> {
    if !path.exists() {
        return Ok(Found {
            full_groups: 0,
            tail: Vec::new(),
            journal: String::new(),
        });
    }
    let builder = open(path)?;
    same_columns(path, builder.schema(), schema)?;
    let file = builder.metadata().file_metadata();
    let pairs = file.key_value_metadata().into_iter().flatten();
    let journal = pairs
        .filter(|p| p.key == JOURNAL)
        .find_map(|p: &KeyValue| p.value.clone());
    // written by this program, or by another one, whose columns cannot be copied as they are
    let empty = in_memory(&RecordBatch::new_empty(schema.clone()), "").map_err(|e| Error::torn(path, e))?;
    let ours = SerializedFileReader::new(bytes::Bytes::from(empty)).map_err(|e| Error::torn(path, e))?;
    let same = ours.metadata().file_metadata().schema_descr().root_schema() == file.schema_descr().root_schema();
    let groups = builder.metadata().row_groups();
    let is_full = |n: i64| n >= GROUP as i64;
    let full_groups = groups.iter().take_while(|g| same && is_full(g.num_rows())).count();
    let rest: Vec<usize> = (full_groups..groups.len()).collect();
    let reader = builder
        .with_row_groups(rest)
        .build()
        .map_err(|e| Error::torn(path, e))?;
    let mut tail = Vec::new();
    for batch in reader {
        let columns = batch.map_err(|e| Error::torn(path, e))?.columns().to_vec();
        tail.push(RecordBatch::try_new(schema.clone(), columns).map_err(|e| Error::torn(path, e))?);
    }
    Ok(Found {
        full_groups,
        tail,
        journal: journal.unwrap_or_default(),
    })
}

fn same_columns(path: &Path, found: &Schema, schema: &Schema) -> Result<()> {
    let names = |s: &Schema| {
        s.fields()
            .iter()
            .map(|f: &Arc<Field>| f.name().clone())
            .collect::<Vec<_>>()
    };
    if names(found) == names(schema) {
        return Ok(());
    }
    let file = path.display().to_string();
    let allowed = "those of a log of diagnoses";
    Err(Error::bad(file, "columns", names(found).join(","), allowed))
}

/// Streams of the last rows of a table.
fn streams(path: &Path) -> Result<Vec<StreamId>> {
    let builder = open(path)?;
    let groups = builder.metadata().row_groups();
    let mut rows = 0;
    let wanted = groups.iter().rev().take_while(|g| {
        let more = rows < REMEMBERED_ROWS;
        rows += g.num_rows();
        more
    });
    let from = groups.len() - wanted.count();
    let (last, parquet) = ((from..groups.len()).collect(), builder.parquet_schema());
    let columns = ProjectionMask::columns(parquet, ["actuator", "stream"]);
    let reader = builder.with_row_groups(last).with_projection(columns).build();
    let mut found = Vec::new();
    for batch in reader.map_err(|e| Error::torn(path, e))? {
        let batch = batch.map_err(|e| Error::torn(path, e))?;
        found.extend(ids(&batch));
    }
    Ok(found)
}

/// Streams of rows, where the columns have the usual types.
fn ids(batch: &RecordBatch) -> Vec<StreamId> {
    let (Some(names), Some(streams)) = (batch.column_by_name("actuator"), batch.column_by_name("stream")) else {
        return Vec::new();
    };
    let (DataType::Utf8, DataType::UInt64) = (names.data_type(), streams.data_type()) else {
        return Vec::new();
    };
    let names = names.as_string::<i32>().iter();
    let streams = streams.as_primitive::<UInt64Type>().values().iter();
    names
        .zip(streams)
        .filter_map(|(n, s)| Some((to_text(n?), *s)))
        .collect()
}
