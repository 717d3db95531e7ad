//! `cargo run --release -p ema-tests --bin mutation-bench -- --inputs 100000 --seed 1`: inputs changed at random, through
//! every door; says how many were refused and taken, and which failed how. `--seconds 120` ends it earlier, `--door bridge` (part of a
//! name) tries some doors alone; `--first 154338 --inputs 1` tries one input again (the file of a fault has its number in its name). Exit code 1 if any input did what none may, or the memory was above 1 GB.

use anyhow::{Result, ensure};
use ema_tests::arguments::{number, text};
use ema_tests::mutation::{Effort, Tally, campaign, doors};
use std::alloc::{GlobalAlloc, Layout, System};
use std::collections::BTreeMap;
use std::fmt::Write;
use std::process::ExitCode;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::{Duration, Instant};

static HELD: AtomicUsize = AtomicUsize::new(0);
static MOST: AtomicUsize = AtomicUsize::new(0);

struct Counting;

// SAFETY: passes everything on to the system's allocator
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        let held = HELD.fetch_add(layout.size(), Ordering::Relaxed) + layout.size();
        MOST.fetch_max(held, Ordering::Relaxed);
        unsafe { System.alloc(layout) }
    }
    unsafe fn dealloc(&self, p: *mut u8, layout: Layout) {
        HELD.fetch_sub(layout.size(), Ordering::Relaxed);
        unsafe { System.dealloc(p, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// Most memory that all inputs together may take [bytes].
const ROOM: usize = 1_000_000_000;

fn table(tallies: &BTreeMap<&'static str, Tally>) -> String {
    let mut out = "| door | inputs | refused | taken | longest [s] | failed |\n|---|---|---|---|---|---|\n".to_string();
    for (name, t) in tallies {
        let (longest, failed) = (t.longest.as_secs_f64(), t.faults.len());
        let _ = writeln!(
            out,
            "| {name} | {} | {} | {} | {longest:.2} | {failed} |",
            t.inputs, t.refused, t.taken
        );
    }
    let most = MOST.load(Ordering::Relaxed) as f64 / 1e6;
    let _ = writeln!(out, "\ngreatest memory of all threads together: {most:.0} MB");
    for (what, file) in tallies.values().flat_map(|t| &t.faults) {
        let _ = writeln!(out, "{}: {what}", file.display());
    }
    out
}

fn run() -> Result<bool> {
    let seed = number("--seed", 1)?;
    let effort = Effort {
        first: number("--first", 0)?,
        inputs: number(
            "--inputs",
            if text("--seconds")?.is_some() {
                u64::MAX
            } else {
                100_000
            },
        )?,
        time: text("--seconds")?.map_or(Ok(Duration::MAX), |_| number("--seconds", 0).map(Duration::from_secs))?,
    };
    let programs = std::env::current_exe()?;
    let ema = programs.with_file_name(format!("ema-under-test{}", std::env::consts::EXE_SUFFIX));
    ensure!(
        ema.exists(),
        "{}: build it first: cargo build --release -p ema-tests --bins",
        ema.display()
    );
    let dir = tempfile::tempdir()?.keep();
    let mut doors = doors(&ema, &dir);
    if let Some(part) = text("--door")? {
        doors.retain(|d| d.name.contains(&part));
        ensure!(!doors.is_empty(), "--door {part}: no such door");
    }
    let start = Instant::now();
    let tallies = campaign(&doors, effort, seed, &dir, |n| {
        if n % 10_000 == 0 {
            eprintln!("{n} in {:.0} s", start.elapsed().as_secs_f64());
        }
    });
    println!(
        "seed {seed}, {:.0} s\n\n{}",
        start.elapsed().as_secs_f64(),
        table(&tallies)
    );
    let whole = tallies.values().all(|t| t.faults.is_empty()) && MOST.load(Ordering::Relaxed) < ROOM;
    drop(doors);
    if whole {
        std::fs::remove_dir_all(&dir)?;
    }
    Ok(whole)
}

fn main() -> ExitCode {
    match run() {
        Ok(true) => ExitCode::SUCCESS,
        Ok(false) => ExitCode::FAILURE,
        Err(e) => {
            eprintln!("mutation-bench: {e:#}");
            ExitCode::from(2)
        }
    }
}
