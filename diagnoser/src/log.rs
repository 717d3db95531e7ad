//! The log of diagnoses, written by a thread of its own: a slow or full disk never delays a
//! diagnosis for long. What cannot be written is kept, up to a bound, and tried again; what a process that died
//! left torn is mended at the next start.

mod journal;
mod lines;
mod table;
#[cfg(test)]
mod tests;

use crate::live::StreamId;
use crate::receive::words::Complain;
use crate::report::Logged;
use lines::Lines;
use schemas::error::{Error, Result};
use std::fs::File;
use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::sync::{Arc, Condvar, Mutex};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};
use table::Table;

/// Between two tries to write what could not be written.
const RETRY: Duration = Duration::from_secs(1);

/// Diagnoses that are kept while the log cannot be written; those that come after them are dropped and counted.
pub const MOST_KEPT: usize = if cfg!(test) { 50 } else { 10_000 };

/// How long a diagnosis waits to be in its log before it is reported. A log that takes longer is not waited for until
/// it has caught up.
const PATIENCE: Duration = Duration::from_millis(20);

/// What is read from the end of an earlier log of lines [bytes], about ten thousand diagnoses.
const MOST_READ: u64 = 16 << 20;

/// A log that is being written.
pub struct Log {
    sender: Sender<Logged>,
    thread: JoinHandle<Result<()>>,
    syncing: JoinHandle<()>,
    backlog: Arc<Backlog>,
    complain: Complain,
    path: PathBuf,
    concluded: Vec<StreamId>,
}

/// Diagnoses on their way into the log.
#[derive(Debug, Default)]
struct Backlog {
    state: Mutex<State>,
    changed: Condvar,
}

#[derive(Clone, Copy, Debug, Default)]
struct State {
    /// handed over and neither written nor dropped
    kept: usize,
    dropped: u64,
    /// not waited for until nothing is kept any more
    is_behind: bool,
}

impl Backlog {
    fn state(&self) -> std::sync::MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(std::sync::PoisonError::into_inner)
    }

    fn update(&self, change: impl FnOnce(&mut State)) {
        change(&mut self.state());
        self.changed.notify_all();
    }

    /// Waits until all is written, but not for a log that is behind.
    fn wait(&self) {
        let busy = |s: &mut State| s.kept > 0 && !s.is_behind;
        let waited = self.changed.wait_timeout_while(self.state(), PATIENCE, busy);
        let (mut state, result) = waited.unwrap_or_else(std::sync::PoisonError::into_inner);
        state.is_behind |= result.timed_out();
    }
}

enum Writer {
    /// one JSON object a line
    Lines(Lines),
    /// Parquet
    Table(Box<Table>),
}

fn lock(file: &File, path: &Path) -> Result<()> {
    file.try_lock().map_err(|_| {
        let why = std::io::Error::other("another process writes it");
        Error::io(path, "is in use", why)
    })
}

impl Writer {
    fn open(path: &Path) -> Result<Self> {
        match path.extension().and_then(|x| x.to_str()) {
            Some("jsonl") => Ok(Self::Lines(Lines::open(path)?)),
            Some("parquet") => Ok(Self::Table(Box::new(Table::open(path)?))),
            _ => {
                let allowed = "a file name ending in .jsonl or .parquet";
                Err(Error::bad("command line", "--log", path.display(), allowed))
            }
        }
    }

    fn concluded(&mut self) -> Vec<StreamId> {
        match self {
            Self::Lines(lines) => lines.concluded(),
            Self::Table(table) => table.concluded(),
        }
    }

    /// The file that rows go to at once.
    fn file(&self) -> &File {
        match self {
            Self::Lines(lines) => lines.file(),
            Self::Table(table) => table.file(),
        }
    }

    /// Hands all of `list` to the system, or nothing.
    fn write(&mut self, list: &[Logged]) -> Result<(), String> {
        match self {
            Self::Lines(lines) => lines.write(list),
            Self::Table(table) => table.write(list),
        }
    }

    /// When the table of a Parquet log is to be rewritten.
    fn due(&self) -> Option<Instant> {
        match self {
            Self::Lines(_) => None,
            Self::Table(table) => table.due(),
        }
    }

    fn rewrite(&mut self) -> Result<()> {
        match self {
            Self::Lines(_) => Ok(()),
            Self::Table(table) => table.rewrite(),
        }
    }
}

impl Log {
    /// Appends to `path` (`.jsonl` or `.parquet`), which is made if it is not there.
    ///
    /// # Errors
    /// Refuses another ending, a log that another process writes, and a table with other columns.
    pub fn open(path: &Path, complain: Complain) -> Result<Self> {
        let mut writer = Writer::open(path)?;
        let concluded = writer.concluded();
        let (sync, syncing) = syncing(writer.file(), path, &complain)?;
        let (sender, receiver) = channel();
        let backlog = Arc::new(Backlog::default());
        let writing = Writing {
            writer,
            path: path.into(),
            sync,
            backlog: backlog.clone(),
            complain: complain.clone(),
            pending: Vec::new(),
            failing: String::new(),
        };
        let thread = std::thread::spawn(move || writing.run(&receiver));
        Ok(Self {
            sender,
            thread,
            syncing,
            backlog,
            complain,
            path: path.into(),
            concluded,
        })
    }

    /// Streams of the last diagnoses that were in the log when it was opened.
    pub fn concluded(&self) -> Vec<StreamId> {
        self.concluded.clone()
    }

    /// Hands a diagnosis over, and returns when it is written, but for a disk that does not answer.
    pub fn append(&self, logged: Logged) {
        {
            let mut state = self.backlog.state();
            if state.kept >= MOST_KEPT {
                if state.dropped == 0 {
                    let p = self.path.display();
                    (self.complain)(&format!("{p}: {MOST_KEPT} diagnoses are kept; later ones are dropped"));
                }
                state.dropped = state.dropped.saturating_add(1);
                return;
            }
            state.kept += 1;
        }
        let _ = self.sender.send(logged);
        self.backlog.wait();
    }

    /// Diagnoses that are kept until they can be written, and those that were dropped.
    pub fn backlog(&self) -> (usize, u64) {
        let state = self.backlog.state();
        (state.kept, state.dropped)
    }

    /// Writes what is left. An error says how many diagnoses are not in the log.
    ///
    /// # Errors
    /// Fails where the rest cannot be written; it is printed to standard error.
    pub fn close(self) -> Result<()> {
        drop(self.sender);
        let result = self.thread.join().expect("the log's thread does not panic");
        // it holds the file, and with it the lock
        let _ = self.syncing.join();
        result
    }
}

/// A thread that makes the disk keep what the system has taken: a failure of the power loses no more than the
/// last moment. A kill loses nothing that the system has taken.
fn syncing(file: &File, path: &Path, complain: &Complain) -> Result<(Sender<()>, JoinHandle<()>)> {
    let file = file.try_clone().map_err(|e| Error::io(path, "cannot be opened", e))?;
    let (path, complain) = (path.to_path_buf(), complain.clone());
    let (sender, receiver) = channel::<()>();
    let thread = std::thread::spawn(move || {
        let mut is_told = false;
        while receiver.recv().is_ok() {
            receiver.try_iter().for_each(drop);
            match file.sync_data() {
                Err(e) if !is_told => {
                    is_told = true;
                    let p = path.display();
                    complain(&format!("{p}: a power failure would lose the last diagnoses ({e})"));
                }
                _ => {}
            }
        }
    });
    Ok((sender, thread))
}

/// The log's thread.
struct Writing {
    writer: Writer,
    path: PathBuf,
    sync: Sender<()>,
    backlog: Arc<Backlog>,
    complain: Complain,
    pending: Vec<Logged>,
    /// why the last write failed; empty where it did not
    failing: String,
}

impl Writing {
    fn run(mut self, receiver: &Receiver<Logged>) -> Result<()> {
        loop {
            let first = receiver.recv_timeout(self.rest());
            let over = matches!(first, Err(RecvTimeoutError::Disconnected));
            self.pending.extend(first);
            self.pending.extend(receiver.try_iter());
            self.write();
            if over {
                return self.end();
            }
            if self.writer.due().is_some_and(|t| t <= Instant::now()) {
                let done = self.writer.rewrite();
                self.say(done.map_err(|e| e.to_string()).err());
            }
        }
    }

    /// How long there is nothing to do.
    fn rest(&self) -> Duration {
        let rewrite = self.writer.due().map(|t| t.saturating_duration_since(Instant::now()));
        let retry = (!self.pending.is_empty()).then_some(RETRY);
        // a failed rewriting waits its turn too
        [rewrite, retry].into_iter().flatten().min().unwrap_or(Duration::MAX)
    }

    fn write(&mut self) {
        if self.pending.is_empty() {
            return;
        }
        let result = self.writer.write(&self.pending);
        let written = if result.is_ok() { self.pending.len() } else { 0 };
        self.pending.drain(..written);
        self.backlog.update(|s| {
            s.kept = s.kept.saturating_sub(written);
            s.is_behind = result.is_err() || (s.is_behind && s.kept > 0);
        });
        let _ = self.sync.send(());
        self.say(result.err());
    }

    /// Says once that it fails, and once that it does no longer.
    fn say(&mut self, failure: Option<String>) {
        let p = self.path.display();
        match failure {
            Some(why) if self.failing.is_empty() => {
                (self.complain)(&format!(
                    "{p}: cannot be written ({why}); diagnoses are kept, up to {MOST_KEPT}, and tried again every second"
                ));
                self.failing = why;
            }
            Some(why) => self.failing = why,
            None if !self.failing.is_empty() && self.pending.is_empty() => {
                let lost = match self.backlog.state().dropped {
                    0 => "nothing lost".to_string(),
                    n => format!("{n} diagnoses were dropped"),
                };
                (self.complain)(&format!("{p}: written again, {lost}"));
                self.failing.clear();
            }
            None => {}
        }
    }

    fn end(mut self) -> Result<()> {
        let dropped = self.backlog.state().dropped;
        if !self.pending.is_empty() || dropped > 0 {
            for l in &self.pending {
                eprintln!("not in the log: {}", l.to_json());
            }
            let n = dropped.saturating_add(self.pending.len() as u64);
            let why = format!("{n} diagnoses are not in it: {}", self.failing);
            return Err(Error::io(&self.path, "cannot be written", std::io::Error::other(why)));
        }
        if self.writer.due().is_some() {
            self.writer.rewrite()?;
        }
        let file = self.writer.file();
        file.sync_data()
            .map_err(|e| Error::io(&self.path, "cannot be written", e))
    }
}
