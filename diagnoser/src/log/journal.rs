//! The journal of a Parquet log: rows that are not in the table yet, as an Arrow IPC stream, appended.

use super::lines::append;
use super::table::beside;
use arrow::array::RecordBatch;
use arrow::datatypes::Schema;
use arrow::ipc::reader::StreamReader;
use arrow::ipc::writer::StreamWriter;
use schemas::error::{Error, Result};
use std::fs::{File, OpenOptions};
use std::io::Read;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{SystemTime, UNIX_EPOCH};

/// Metadata key, in the journal and in the table that its rows have been taken into.
pub(super) const JOURNAL: &str = "ema.journal";

/// Rows on their way into the table.
pub(super) struct Journal {
    file: File,
    path: PathBuf,
    schema: Arc<Schema>,
    writer: StreamWriter<Vec<u8>>,
    /// another for every journal
    pub id: String,
}

/// What an earlier process left: its journal's number, and its rows up to the first one that is torn.
pub(super) struct Left {
    pub id: String,
    pub rows: Vec<RecordBatch>,
}

/// A stream into memory; its first bytes say which journal it is.
fn begin(schema: &Schema) -> (String, StreamWriter<Vec<u8>>) {
    let now = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    let id = format!("{:x}-{:x}", now.as_nanos(), std::process::id());
    let marked = schema.clone().with_metadata([(JOURNAL.to_string(), id.clone())]);
    let writer = StreamWriter::try_new(Vec::new(), &marked).expect("a stream in memory");
    (id, writer)
}

impl Journal {
    /// Opens the journal beside `table`, which another process may have left with rows.
    ///
    /// # Errors
    /// A file that cannot be opened or read; rows of another table.
    pub fn open(table: &Path, schema: &Arc<Schema>) -> Result<(Self, Left)> {
        let path = beside(table, "journal");
        let options = OpenOptions::new().read(true).append(true).create(true).clone();
        let mut file = options
            .open(&path)
            .map_err(|e| Error::io(&path, "cannot be opened", e))?;
        let mut bytes = Vec::new();
        file.read_to_end(&mut bytes)
            .map_err(|e| Error::io(&path, "cannot be read", e))?;
        let left = read(&path, &bytes, schema)?;
        let (id, writer) = begin(schema);
        let journal = Self {
            file,
            path,
            schema: schema.clone(),
            writer,
            id,
        };
        Ok((journal, left))
    }

    pub fn file(&self) -> &File {
        &self.file
    }

    /// Empties it: what it held is in the table.
    ///
    /// # Errors
    /// What the disk refuses.
    pub fn renew(&mut self) -> Result<()> {
        self.file
            .set_len(0)
            .map_err(|e| Error::io(&self.path, "cannot be written", e))?;
        (self.id, self.writer) = begin(&self.schema);
        Ok(())
    }

    /// Appends rows, all or none.
    pub fn write(&mut self, rows: &RecordBatch) -> Result<(), String> {
        // the stream's beginning, where it is not written yet, stays in the buffer until a write succeeds
        let before = self.writer.get_ref().len();
        let done = self.writer.write(rows).map_err(|e| e.to_string());
        let done = done.and_then(|()| append(&mut self.file, self.writer.get_ref()));
        let buffer = self.writer.get_mut();
        buffer.truncate(if done.is_ok() { 0 } else { before });
        done
    }
}

/// The rows of a journal; the end may be torn.
fn read(path: &Path, bytes: &[u8], schema: &Arc<Schema>) -> Result<Left> {
    let Ok(stream) = StreamReader::try_new(bytes, None) else {
        // nothing, or a beginning that was not finished
        return Ok(Left {
            id: String::new(),
            rows: Vec::new(),
        });
    };
    if stream.schema().fields() != schema.fields() {
        let names: Vec<String> = stream.schema().fields().iter().map(|f| f.name().clone()).collect();
        let file = path.display().to_string();
        return Err(Error::bad(
            file,
            "columns",
            names.join(","),
            "those of a log of diagnoses",
        ));
    }
    let id = stream.schema().metadata().get(JOURNAL).cloned().unwrap_or_default();
    let whole = stream.map_while(|batch| batch.ok());
    let rows = whole.map(|b| RecordBatch::try_new(schema.clone(), b.columns().to_vec()).expect("of the same columns"));
    Ok(Left {
        id,
        rows: rows.collect(),
    })
}
