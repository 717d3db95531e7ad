//! Works through a plan of runs on all cores, block by block, and can be interrupted at any
//! moment: a block's files appear whole or not at all, and a second start does what is missing.

use crate::simulate::{Experiment, LANES, Run, simulate};
use rayon::prelude::*;
use schemas::error::{Error, Result, write_whole};
use schemas::telemetry::TelemetrySink;
use std::fs::File;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

/// Runs that are simulated side by side and stored together.
#[derive(Clone, Debug)]
pub struct Block {
    pub number: usize,
    pub runs: Vec<Run>,
}

/// Cuts a plan's runs into blocks.
pub fn blocks(runs: Vec<Run>) -> Vec<Block> {
    runs.chunks(LANES)
        .enumerate()
        .map(|(number, runs)| Block {
            number,
            runs: runs.to_vec(),
        })
        .collect()
}

/// Where the results of blocks go.
pub trait Store: Sync {
    type Sink: TelemetrySink + Send;
    /// Whether the block's files are there and whole.
    fn is_done(&self, block: &Block) -> bool;
    /// A sink for each run.
    fn open(&self, block: &Block) -> Result<Vec<Self::Sink>>;
    /// Gives the block's files their names.
    fn commit(&self, block: &Block, sinks: Vec<Self::Sink>) -> Result<()>;
}

/// What has been done so far, for a progress display in another thread.
#[derive(Debug, Default)]
pub struct Progress {
    /// runs done, earlier starts included
    pub runs: AtomicU64,
    /// steps made by this start
    pub steps: AtomicU64,
    /// set it to stop
    pub stop: AtomicBool,
}

/// A dataset folder, held by this process alone.
pub struct Folder {
    pub path: PathBuf,
    _lock: File,
}

impl Folder {
    /// Opens or makes a folder for the plan with this fingerprint.
    ///
    /// Refuses a folder that holds another plan, or that another process is writing to. Removes
    /// what an interrupted process left under temporary names.
    pub fn open(path: &Path, plan: &str, description: &str) -> Result<Self> {
        std::fs::create_dir_all(path).map_err(|e| Error::io(path, "cannot be made", e))?;
        let lock_path = path.join(".lock");
        let lock = File::options()
            .create(true)
            .truncate(false)
            .write(true)
            .open(&lock_path)
            .map_err(|e| Error::io(&lock_path, "cannot be opened", e))?;
        lock.try_lock().map_err(|_| Error::Io {
            file: path.display().to_string(),
            what: "is in use",
            why: "another process is writing to this folder".into(),
        })?;
        let plan_path = path.join("plan.txt");
        let first = format!("plan {plan}");
        match std::fs::read_to_string(&plan_path) {
            Ok(text) => {
                let found = text.lines().next().unwrap_or("");
                if found != first {
                    let place = "plan of the folder";
                    return Err(Error::bad(
                        plan_path.display().to_string(),
                        place,
                        found,
                        format!("{first}, or an empty folder"),
                    ));
                }
            }
            Err(e) if e.kind() == std::io::ErrorKind::NotFound => {
                let list = std::fs::read_dir(path).map_err(|e| Error::io(path, "cannot be listed", e))?;
                let other = list
                    .flatten()
                    .find(|e| !e.file_name().to_string_lossy().starts_with('.'));
                if let Some(e) = other {
                    let found = format!("{} and no plan.txt", e.file_name().to_string_lossy());
                    return Err(Error::bad(
                        path.display().to_string(),
                        "folder",
                        found,
                        "an empty folder, or one of this plan",
                    ));
                }
                write_whole(&plan_path, format!("{first}\n{description}\n").as_bytes())?;
            }
            Err(e) => return Err(Error::io(&plan_path, "cannot be read", e)),
        }
        let folder = Self {
            path: path.into(),
            _lock: lock,
        };
        folder.sweep(path)?;
        Ok(folder)
    }

    /// A subfolder, made where it is missing and swept.
    pub fn part(&self, name: &str) -> Result<PathBuf> {
        let path = self.path.join(name);
        std::fs::create_dir_all(&path).map_err(|e| Error::io(&path, "cannot be made", e))?;
        self.sweep(&path)?;
        Ok(path)
    }

    fn sweep(&self, path: &Path) -> Result<()> {
        let list = std::fs::read_dir(path).map_err(|e| Error::io(path, "cannot be listed", e))?;
        for entry in list.flatten() {
            let name = entry.file_name().to_string_lossy().into_owned();
            if name.starts_with('.') && name.contains(".tmp-") {
                let _ = std::fs::remove_file(entry.path());
            }
        }
        Ok(())
    }
}

/// Works through the blocks that are not done. `Ok(false)` where it was stopped.
pub fn work<S: Store>(experiment: &Experiment, blocks: &[Block], store: &S, progress: &Progress) -> Result<bool> {
    blocks.par_iter().try_for_each(|block| -> Result<()> {
        let runs = block.runs.len() as u64;
        if progress.stop.load(Ordering::Relaxed) {
            return Ok(());
        }
        if !store.is_done(block) {
            let mut sinks = store.open(block)?;
            let go_on = || !progress.stop.load(Ordering::Relaxed);
            let Some(steps) = simulate(experiment, &block.runs, &mut sinks, go_on)? else {
                return Ok(());
            };
            store.commit(block, sinks)?;
            progress.steps.fetch_add(steps, Ordering::Relaxed);
        }
        progress.runs.fetch_add(runs, Ordering::Relaxed);
        Ok(())
    })?;
    Ok(!progress.stop.load(Ordering::Relaxed))
}
