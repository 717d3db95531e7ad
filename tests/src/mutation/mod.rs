//! Inputs changed at random, through every door that takes something from outside: each must be taken or refused in one line, never
//! panic, never hang, and never locate what is not there. So must what comes through shared memory and over the bridge.

mod bridge;
mod change;
mod doors;
mod frames;
mod truth;

pub use change::changed;
pub use doors::{Door, corpus, doors};
pub use truth::Taken;

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::collections::BTreeMap;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

/// From which on an input counts as one that hangs.
pub const SLOW: Duration = Duration::from_secs(10);

/// What inputs of one door have come to.
#[derive(Clone, Debug, Default)]
pub struct Tally {
    pub inputs: u64,
    pub refused: u64,
    /// inputs that were as good as they were
    pub taken: u64,
    /// panics, hangs, refusals of several lines, wrong results: what, and the file that does it
    pub faults: Vec<(String, PathBuf)>,
    /// the longest
    pub longest: Duration,
}

impl Tally {
    fn add(&mut self, other: Tally) {
        self.inputs += other.inputs;
        self.refused += other.refused;
        self.taken += other.taken;
        self.faults.extend(other.faults);
        self.longest = self.longest.max(other.longest);
    }
}

/// Where and why the last panic was, whatever its thread.
static PANIC: Mutex<Option<String>> = Mutex::new(None);

/// Where and why, without a word on standard error.
fn quiet_panics() {
    std::panic::set_hook(Box::new(|info| {
        let place = info.location().map(|l| format!("{}:{}", l.file(), l.line()));
        let what = format!("{} ({info})", place.unwrap_or_default()).replace('\n', " ");
        *PANIC.lock().unwrap_or_else(PoisonError::into_inner) = Some(what);
    }));
}

/// What one input came to, and how long it took.
fn judged(door: &Door, path: &Path) -> (Tally, Duration) {
    let start = Instant::now();
    let result = catch_unwind(AssertUnwindSafe(|| (door.open)(path)));
    let took = start.elapsed();
    let mut tally = Tally {
        inputs: 1,
        longest: took,
        ..Tally::default()
    };
    let fault = match result {
        Err(_) => {
            let mut said = PANIC.lock().unwrap_or_else(PoisonError::into_inner);
            Some(format!("panic {}", said.take().unwrap_or_default()))
        }
        Ok(Ok(Taken::Right)) => {
            tally.taken = 1;
            None
        }
        Ok(Ok(Taken::Wrong(what))) => Some(format!("wrong: {what}")),
        Ok(Err(line)) => {
            tally.refused = 1;
            let one = !line.trim().is_empty() && !line.contains('\n');
            (!one).then(|| format!("not one line: {line:?}"))
        }
    };
    let fault = fault.or((took > SLOW).then(|| format!("took {:.1} s", took.as_secs_f64())));
    tally.faults.extend(fault.map(|f| (f, PathBuf::new())));
    (tally, took)
}

/// How long a campaign goes on: so many inputs, or so long, whatever comes first.
#[derive(Clone, Copy, Debug)]
pub struct Effort {
    /// number of the first one: with the seed it names an input
    pub first: u64,
    pub inputs: u64,
    pub time: Duration,
}

impl Effort {
    pub fn inputs(inputs: u64) -> Self {
        Self {
            first: 0,
            inputs,
            time: Duration::MAX,
        }
    }
}

/// The corpus as it is, then inputs through the doors in turn; what fails is kept in `dir/faults`.
///
/// * `seed` of the changes: the same seed gives the same inputs
/// * `said` is told how many are done
pub fn campaign(
    doors: &[Door],
    effort: Effort,
    seed: u64,
    dir: &Path,
    said: impl Fn(u64) + Sync,
) -> BTreeMap<&'static str, Tally> {
    quiet_panics();
    let kept = dir.join("faults");
    std::fs::create_dir_all(&kept).unwrap();
    let total: u64 = doors.iter().map(|d| d.weight).sum();
    let all: Mutex<BTreeMap<&'static str, Tally>> = Mutex::default();
    let (begun, done, start) = (AtomicU64::new(effort.first), AtomicU64::new(0), Instant::now());
    let one = |i: u64, thread: usize| {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        rng.set_stream(i);
        let mut ticket = rng.random_range(0..total);
        let door = doors.iter().find(|d| match ticket.checked_sub(d.weight) {
            Some(rest) => {
                ticket = rest;
                false
            }
            None => true,
        });
        let door = door.expect("a ticket below the sum of weights");
        let room = dir.join(format!("{}-{thread}", door.name));
        let input = door.input(&mut rng, &room);
        let (mut tally, _) = judged(door, &input);
        for (k, (_, path)) in tally.faults.iter_mut().enumerate() {
            let extension = input.extension().unwrap_or_default().to_string_lossy().into_owned();
            *path = kept.join(format!("{}-{i}-{k}.{extension}", door.name));
            let _ = std::fs::copy(&input, path);
        }
        all.lock().expect("no panics").entry(door.name).or_default().add(tally);
        said(done.fetch_add(1, Ordering::Relaxed) + 1);
    };
    for door in doors {
        for file in corpus(door.name) {
            let (mut tally, _) = judged(door, &file);
            tally.faults.iter_mut().for_each(|(_, path)| path.clone_from(&file));
            all.lock().expect("no panics").entry(door.name).or_default().add(tally);
        }
    }
    // threads of their own: some doors wait for work of the pool's
    std::thread::scope(|scope| {
        for thread in 0..std::thread::available_parallelism().map_or(1, usize::from) {
            let (one, begun) = (&one, &begun);
            scope.spawn(move || {
                while start.elapsed() < effort.time {
                    match begun.fetch_add(1, Ordering::Relaxed) {
                        i if i - effort.first < effort.inputs => one(i, thread),
                        _ => return,
                    }
                }
            });
        }
    });
    let _ = std::panic::take_hook();
    all.into_inner().expect("no panics")
}
