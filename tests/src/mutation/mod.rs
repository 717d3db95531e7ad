//! Inputs changed at random, through every door that takes a file: each must be taken or refused in one line, never
//! panic, never hang, and never locate what is not there.

mod change;
mod doors;

pub use change::changed;
pub use doors::{Door, Taken, doors};

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use std::cell::RefCell;
use std::collections::BTreeMap;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::sync::Mutex;
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

thread_local! {
    static PANIC: RefCell<Option<String>> = const { RefCell::new(None) };
}

/// Where and why, without a word on standard error.
fn quiet_panics() {
    std::panic::set_hook(Box::new(|info| {
        let place = info.location().map(|l| format!("{}:{}", l.file(), l.line()));
        PANIC.set(Some(
            format!("{} ({info})", place.unwrap_or_default()).replace('\n', " "),
        ));
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
        Err(_) => Some(format!("panic {}", PANIC.take().unwrap_or_default())),
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

/// `inputs` through the doors in turn; what fails is kept in `dir/faults`.
///
/// * `seed` of the changes: the same seed gives the same inputs
/// * `said` is told how many are done
pub fn campaign(
    doors: &[Door],
    inputs: u64,
    seed: u64,
    dir: &Path,
    said: impl Fn(u64) + Sync,
) -> BTreeMap<&'static str, Tally> {
    quiet_panics();
    let kept = dir.join("faults");
    std::fs::create_dir_all(&kept).unwrap();
    let total: u64 = doors.iter().map(|d| d.weight).sum();
    let all: Mutex<BTreeMap<&'static str, Tally>> = Mutex::default();
    let done = std::sync::atomic::AtomicU64::new(0);
    (0..inputs).into_par_iter().for_each(|i| {
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
        let thread = rayon::current_thread_index().unwrap_or(0);
        let room = dir.join(format!("{}-{thread}", door.name));
        let input = door.input(&mut rng, &room);
        let (mut tally, _) = judged(door, &input);
        for (k, (_, path)) in tally.faults.iter_mut().enumerate() {
            let extension = input.extension().unwrap_or_default().to_string_lossy().into_owned();
            *path = kept.join(format!("{}-{i}-{k}.{extension}", door.name));
            let _ = std::fs::copy(&input, path);
        }
        all.lock().expect("no panics").entry(door.name).or_default().add(tally);
        said(done.fetch_add(1, std::sync::atomic::Ordering::Relaxed) + 1);
    });
    let _ = std::panic::take_hook();
    all.into_inner().expect("no panics")
}
