//! The log of diagnoses, written by a thread of its own: a slow or full disk never delays a
//! diagnosis. What cannot be written is kept and tried again; what a process that died left torn
//! is mended at the next start.

use crate::receive::words::Complain;
use crate::report::{Logged, to_batch};
use arrow::array::RecordBatch;
use schemas::error::{Error, Result};
use std::fs::{File, OpenOptions};
use std::io::{Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::thread::JoinHandle;
use std::time::Duration;

/// Between two tries to write what could not be written.
const RETRY: Duration = Duration::from_secs(1);

/// A log that is being written.
pub struct Log {
    sender: Sender<Logged>,
    thread: JoinHandle<Result<()>>,
}

enum Writer {
    /// one JSON object a line
    Lines(File),
    /// rewritten whole: readers see all rows up to some diagnosis, never half a file
    Table {
        path: PathBuf,
        rows: Vec<RecordBatch>,
        _lock: File,
    },
}

fn lock(file: &File, path: &Path) -> Result<()> {
    file.try_lock().map_err(|_| {
        let why = std::io::Error::other("another process writes it");
        Error::io(path, "is in use", why)
    })
}

impl Writer {
    fn open(path: &Path) -> Result<Self> {
        let cannot = |e| Error::io(path, "cannot be opened", e);
        match path.extension().and_then(|x| x.to_str()) {
            Some("jsonl") => {
                let options = OpenOptions::new().read(true).append(true).create(true).clone();
                let mut file = options.open(path).map_err(cannot)?;
                lock(&file, path)?;
                mend(&mut file).map_err(|e| Error::io(path, "cannot be mended", e))?;
                Ok(Self::Lines(file))
            }
            Some("parquet") => {
                let name = path.file_name().unwrap_or_default().to_string_lossy();
                let beside = path.with_file_name(format!(".{name}.lock"));
                let lock_file = File::create(&beside).map_err(cannot)?;
                lock(&lock_file, path)?;
                let rows = if path.exists() { read(path)? } else { Vec::new() };
                Ok(Self::Table {
                    path: path.into(),
                    rows,
                    _lock: lock_file,
                })
            }
            _ => {
                let allowed = "a file name ending in .jsonl or .parquet";
                Err(Error::bad("command line", "--log", path.display(), allowed))
            }
        }
    }

    /// Writes all of `list` or nothing.
    fn write(&mut self, list: &[Logged]) -> Result<(), String> {
        match self {
            Self::Lines(file) => {
                let mut text = String::new();
                for l in list {
                    text += &l.to_json().to_string();
                    text.push('\n');
                }
                let before = file.metadata().map_err(|e| e.to_string())?.len();
                let result = file.write_all(text.as_bytes()).and_then(|()| file.sync_data());
                result.map_err(|e| {
                    let _ = file.set_len(before);
                    e.to_string()
                })
            }
            Self::Table { path, rows, .. } => {
                rows.push(to_batch(list));
                let schema = rows[0].schema();
                let all = arrow::compute::concat_batches(&schema, rows.iter()).map_err(|e| e.to_string());
                let version = schemas::SCHEMA_VERSION.to_string();
                let pairs = vec![("ema.schema_version".to_string(), version)];
                let written =
                    all.and_then(|all| schemas::recording::write_table(path, &all, pairs).map_err(|e| e.to_string()));
                if written.is_err() {
                    rows.pop();
                }
                written
            }
        }
    }
}

/// Cuts off a line that a process did not finish.
fn mend(file: &mut File) -> std::io::Result<()> {
    let mut bytes = Vec::new();
    let len = file.seek(SeekFrom::End(0))?;
    let from = len.saturating_sub(1 << 16);
    file.seek(SeekFrom::Start(from))?;
    Read::take(&mut *file, len - from).read_to_end(&mut bytes)?;
    if bytes.last().is_some_and(|b| *b != b'\n') {
        let end = bytes.iter().rposition(|b| *b == b'\n').map_or(0, |i| i + 1);
        if serde_json::from_slice::<serde_json::Value>(&bytes[end..]).is_ok() {
            // whole, but for its end
            file.write_all(b"\n")?;
        } else {
            file.set_len(from + end as u64)?;
        }
    }
    Ok(())
}

/// Rows of an earlier log; refuses other tables.
fn read(path: &Path) -> Result<Vec<RecordBatch>> {
    let (found, batches) = schemas::recording::read_table(path)?;
    let schema = to_batch(&[]).schema();
    let names = |s: &arrow::datatypes::Schema| s.fields().iter().map(|f| f.name().clone()).collect::<Vec<_>>();
    if names(&found) != names(&schema) {
        let file = path.display().to_string();
        let allowed = "those of a log of diagnoses";
        return Err(Error::bad(file, "columns", names(&found).join(","), allowed));
    }
    let typed = |b: &RecordBatch| RecordBatch::try_new(schema.clone(), b.columns().to_vec());
    batches
        .iter()
        .map(|b| typed(b).map_err(|e| Error::torn(path, e)))
        .collect()
}

impl Log {
    /// Appends to `path` (`.jsonl` or `.parquet`), which is made if it is not there.
    ///
    /// # Errors
    /// Refuses another ending, a log that another process writes, and a table with other columns.
    pub fn open(path: &Path, complain: Complain) -> Result<Self> {
        let writer = Writer::open(path)?;
        let (sender, receiver) = channel();
        let path = path.to_path_buf();
        let thread = std::thread::spawn(move || write_all(writer, &path, &receiver, &complain));
        Ok(Self { sender, thread })
    }

    /// Hands a diagnosis over and returns at once.
    pub fn append(&self, logged: Logged) {
        let _ = self.sender.send(logged);
    }

    /// Writes what is left. An error says how many diagnoses are not in the log.
    ///
    /// # Errors
    /// Fails where the rest cannot be written; it is printed to standard error.
    pub fn close(self) -> Result<()> {
        drop(self.sender);
        self.thread.join().expect("the log's thread does not panic")
    }
}

fn write_all(mut writer: Writer, path: &Path, receiver: &Receiver<Logged>, complain: &Complain) -> Result<()> {
    let mut pending: Vec<Logged> = Vec::new();
    let mut failing = false;
    loop {
        let first = receiver.recv_timeout(if pending.is_empty() { Duration::MAX } else { RETRY });
        let over = matches!(first, Err(RecvTimeoutError::Disconnected));
        pending.extend(first);
        pending.extend(receiver.try_iter());
        let result = if pending.is_empty() {
            Ok(())
        } else {
            writer.write(&pending)
        };
        match result {
            Ok(()) => {
                if failing {
                    complain(&format!("{}: written again, nothing lost", path.display()));
                }
                failing = false;
                pending.clear();
            }
            Err(why) => {
                if !failing {
                    let p = path.display();
                    complain(&format!(
                        "{p}: cannot be written ({why}); diagnoses are kept and tried again every second"
                    ));
                }
                failing = true;
                if over {
                    for l in &pending {
                        eprintln!("not in the log: {}", l.to_json());
                    }
                    let why = format!("{} diagnoses are not in it: {why}", pending.len());
                    return Err(Error::io(path, "cannot be written", std::io::Error::other(why)));
                }
            }
        }
        if over {
            return Ok(());
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::diagnosis::{Diagnosis, Outcome};
    use crate::live::Report;
    use schemas::channel::ChannelSet;
    use schemas::feature::{Feature, Features};
    use schemas::stream::frame::RunDescription;
    use std::sync::Arc;

    fn logged(run: u64) -> Logged {
        let outcome = Outcome::OutOfRange {
            reason: "FSJ above 5".into(),
        };
        Logged {
            report: Report {
                run: RunDescription {
                    actuator: "rig".into(),
                    parameters: "fd2267d8e432540d".into(),
                    sensors: "none".into(),
                    sequence: "516bc48aa11e0fd0".into(),
                    run,
                    rate_hz: 1e4,
                    channels: ChannelSet::basic(),
                    total_rows: 30_000,
                    load_n_m: 0.0,
                },
                stream: u64::MAX - run,
                is_final: true,
                diagnosis: Diagnosis::without_maps(outcome, Features::default().with(Feature::P2, Some(0.5))),
                samples_received: 30_000,
                samples_lost: 0,
                telemetry_ns: 1,
            },
            time_ns: 2,
            publish_ns: 3,
        }
    }

    fn write(path: &Path, runs: std::ops::Range<u64>) {
        let log = Log::open(path, Arc::new(|text: &str| panic!("{text}"))).unwrap();
        runs.for_each(|r| log.append(logged(r)));
        log.close().unwrap();
    }

    #[test]
    fn prop_a_log_goes_on_where_it_ended() {
        let dir = std::env::temp_dir().join(format!("ema-log-{}", std::process::id()));
        std::fs::create_dir_all(&dir).unwrap();
        let table = dir.join("log.parquet");
        write(&table, 0..2);
        write(&table, 2..5);
        let rows = arrow::compute::concat_batches(&to_batch(&[]).schema(), &read(&table).unwrap()).unwrap();
        let expected: Vec<Logged> = (0..5).map(logged).collect();
        assert_eq!(rows, to_batch(&expected));
        let lines = dir.join("log.jsonl");
        write(&lines, 0..2);
        // a process died in the middle of a line
        let mut torn = OpenOptions::new().append(true).open(&lines).unwrap();
        torn.write_all(b"{\"run\":").unwrap();
        drop(torn);
        write(&lines, 2..3);
        let text = std::fs::read_to_string(&lines).unwrap();
        let runs: Vec<u64> = text
            .lines()
            .map(|l| {
                serde_json::from_str::<serde_json::Value>(l).unwrap()["run"]
                    .as_u64()
                    .unwrap()
            })
            .collect();
        assert_eq!(runs, [0, 1, 2]);
        // another table is refused, and stays as it is
        let other = dir.join("other.parquet");
        std::fs::write(&other, b"PAR1 not a table").unwrap();
        assert!(Log::open(&other, Arc::new(|_: &str| ())).is_err());
        assert_eq!(std::fs::read(&other).unwrap(), b"PAR1 not a table");
        // also one without rows
        let field = arrow::datatypes::Field::new("x", arrow::datatypes::DataType::Float64, false);
        let empty = RecordBatch::new_empty(Arc::new(arrow::datatypes::Schema::new(vec![field])));
        let bytes = schemas::recording::table_bytes(&[empty], Vec::new()).unwrap();
        std::fs::write(&other, &bytes).unwrap();
        assert!(Log::open(&other, Arc::new(|_: &str| ())).is_err());
        assert_eq!(std::fs::read(&other).unwrap(), bytes);
        std::fs::remove_dir_all(&dir).unwrap();
    }
}
