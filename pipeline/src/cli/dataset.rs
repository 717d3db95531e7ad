//! `ema plan` and `ema dataset`.

use super::{list, say, say_json};
use crate::dataset::diagnose::{Diagnosed, Grounds, by_own_maps, by_type, by_units};
use crate::dataset::estimate::{estimate, to_json, to_text};
use crate::dataset::{Dataset, export};
use anyhow::Result;
use clap::{Args, Subcommand};
use diagnoser::calibration::COVERAGE;
use diagnoser::failure_map::FailureMapSet;
use diagnoser::map_library::{Choice, file_in};
use schemas::error::{EXIT_LOSS, Error};
use serde_json::json;
use sim_worker::dataset::copy::copy;
use sim_worker::dataset::merge::{Merged, merge};
use sim_worker::dataset::plan::DatasetPlan;
use sim_worker::dataset::program::{end_when_interrupted, missing, missing_of, summary, work_shown};
use sim_worker::dataset::shard::Shard;
use sim_worker::dataset::storage::Storage;
use sim_worker::dataset::verify::{discard, verify};
use std::path::PathBuf;
use std::process::ExitCode;
use std::time::Instant;

#[derive(Args)]
pub struct PlanArgs {
    /// Fleet plan, a TOML file (datasets/fleets)
    plan: PathBuf,
    /// Keys for programs
    #[arg(long)]
    json: bool,
}

pub fn plan(a: &PlanArgs) -> Result<ExitCode> {
    let plan = DatasetPlan::read(&a.plan)?;
    let e = estimate(&plan)?;
    if a.json {
        say_json(to_json(&plan, &e));
    } else {
        say(&to_text(&plan, &e));
    }
    Ok(ExitCode::SUCCESS)
}

#[derive(Subcommand)]
pub enum DatasetCommand {
    /// Simulate a whole fleet plan on this machine and put the dataset together; resumes where it was interrupted
    Make(MakeArgs),
    /// Put together what the shards of a plan have stored
    Merge(MakeArgs),
    /// Check a dataset: every run once, checksums, fingerprints, schema, value ranges; says which shards to run again
    Verify(VerifyArgs),
    /// Build the failure maps of every actuator, or those of one into a folder for ema diagnose --maps; also: ema maps
    Maps(super::maps::MapsArgs),
    /// Diagnose the random tests of every actuator, by its own maps, by those of its type, or by its unit file
    Diagnose(DiagnoseArgs),
    /// Write the telemetry of one run as a recording, channels that were not stored included
    Export(ExportArgs),
    /// Copy a finished dataset, for example from S3 to a folder; resumes
    Copy(CopyArgs),
}

#[derive(Args)]
pub struct MakeArgs {
    /// Fleet plan, a TOML file
    plan: PathBuf,
    /// A folder, or s3://BUCKET/PREFIX; the plan's `out` if left out
    #[arg(long, env = "EMA_DATASET", value_name = "URL")]
    out: Option<String>,
    /// Threads; all cores if left out
    #[arg(long)]
    jobs: Option<usize>,
}

#[derive(Args)]
pub struct VerifyArgs {
    /// Dataset: a folder, or s3://BUCKET/PREFIX
    dataset: String,
    /// Name shards of this many; parts (the smallest shards) if left out
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..))]
    shards: Option<u64>,
    /// Remove what is damaged, so that the shards named can be run again and merged
    #[arg(long)]
    discard: bool,
    /// Keys for programs
    #[arg(long)]
    json: bool,
}

#[derive(Args)]
pub struct DiagnoseArgs {
    /// Dataset: a folder, or s3://BUCKET/PREFIX
    dataset: String,
    /// Maps of the type, a file of ema maps, instead of each actuator's own
    #[arg(long)]
    maps: Option<PathBuf>,
    /// Spread that the maps of the type are calibrated for (ema calibrate)
    #[arg(long, default_value = "fleet", requires = "maps")]
    spread: String,
    /// Unit files (ema unit): a folder, or one; each actuator by the file of its name, relative to the healthy unit
    ///
    /// A name is TAIL.POSITION, or TAIL. Features are formed with the constants of the unit's model: from the telemetry of the
    /// tests, which the plan must keep ([telemetry] with of = "test") unless they are those that the dataset was made with.
    /// Actuators without a file are named and left out.
    #[arg(long, value_name = "FILE_OR_FOLDER", conflicts_with = "maps")]
    unit: Option<PathBuf>,
    /// Fault grid of maps that are made on first use for a unit: name or file
    #[arg(long, default_value = "fine", requires = "unit")]
    grid: String,
}

#[derive(Args)]
pub struct ExportArgs {
    /// Dataset: a folder, or s3://BUCKET/PREFIX
    dataset: String,
    /// Number of the run
    #[arg(long)]
    run: u64,
    /// Recording, .parquet or .csv
    #[arg(long)]
    out: PathBuf,
}

#[derive(Args)]
pub struct CopyArgs {
    /// Dataset: a folder, or s3://BUCKET/PREFIX
    from: String,
    to: String,
}

pub fn dataset(command: &DatasetCommand) -> Result<ExitCode> {
    end_when_interrupted("ema");
    match command {
        DatasetCommand::Make(a) => make(a, true),
        DatasetCommand::Merge(a) => make(a, false),
        DatasetCommand::Verify(a) => check(a),
        DatasetCommand::Maps(a) => super::maps::maps(a),
        DatasetCommand::Diagnose(a) => diagnose(a),
        DatasetCommand::Export(a) => {
            export::export(&Dataset::open(&a.dataset)?, a.run, &a.out)?;
            Ok(ExitCode::SUCCESS)
        }
        DatasetCommand::Copy(a) => {
            let c = copy(&Storage::open(&a.from)?, &Storage::open(&a.to)?)?.ok_or(crate::Interrupted)?;
            let there = if c.there > 0 {
                format!(", {} were there", c.there)
            } else {
                String::new()
            };
            say(&format!(
                "{} files, {:.1} MB copied{there}",
                c.files,
                c.bytes as f64 / 1e6
            ));
            Ok(ExitCode::SUCCESS)
        }
    }
}

fn make(a: &MakeArgs, work: bool) -> Result<ExitCode> {
    let plan = DatasetPlan::read(&a.plan)?;
    if let Some(n) = a.jobs {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(n).build_global();
        pool.map_err(|e| Error::bad("command line", "--jobs", n, e.to_string()))?;
    }
    let storage = Storage::open(a.out.as_deref().unwrap_or(&plan.out))?;
    if work {
        let start = Instant::now();
        let done = work_shown(&plan, &storage, Shard::WHOLE, "dataset")?.ok_or(crate::Interrupted)?;
        say(&summary(&done, start.elapsed().as_secs_f64()));
    }
    match merge(&plan, &storage, |_, _| ())? {
        Merged::Whole(m) => {
            let bytes: u64 = m.files.iter().map(|f| f.bytes).sum();
            say(&format!(
                "{}: {} runs of {} actuators in {} files, {:.1} MB",
                storage.describe(),
                m.runs,
                m.actuators,
                m.files.len(),
                bytes as f64 / 1e6
            ));
            Ok(ExitCode::SUCCESS)
        }
        Merged::Missing(parts) => {
            eprintln!("ema: {}: {}", storage.describe(), missing(&plan, &parts));
            Ok(ExitCode::from(EXIT_LOSS))
        }
    }
}

fn check(a: &VerifyArgs) -> Result<ExitCode> {
    let storage = Storage::open(&a.dataset)?;
    let start = Instant::now();
    let r = verify(&storage, |_, _| ())?;
    let parts = r.parts();
    let shards = (!parts.is_empty()).then(|| missing_of(r.plan.parts, &parts, a.shards.map(|n| n as usize)));
    if a.discard {
        discard(&storage, &r)?;
    }
    if a.json {
        let findings: Vec<_> = r
            .findings
            .iter()
            .map(|f| json!({ "path": f.path, "what": f.what, "parts": f.parts, "damaged": f.damaged }))
            .collect();
        let v = json!({
            "whole": r.finished && r.findings.is_empty(),
            "finished": r.finished,
            "runs": r.plan.runs,
            "parts": r.plan.parts,
            "files": r.files,
            "bytes": r.bytes,
            "findings": findings,
            "run_again": shards,
            "notes": r.notes,
        });
        say_json(v);
    } else {
        for n in &r.notes {
            say(&format!("note: {n}"));
        }
        for f in r.findings.iter().take(50) {
            say(&format!("{}: {}", f.path, f.what));
        }
        if r.findings.len() > 50 {
            say(&format!(
                "and {} findings more (--json lists all)",
                r.findings.len() - 50
            ));
        }
        let state = match (r.finished, r.findings.is_empty()) {
            (true, true) => "whole",
            (true, false) => "damaged",
            (false, true) => "not put together yet: sim-worker --merge or ema dataset merge",
            (false, false) => "not finished",
        };
        say(&format!(
            "{}: {} actuators, {} runs; {} files, {:.1} MB read in {:.1} s: {state}",
            storage.describe(),
            r.plan.actuators,
            r.plan.runs,
            r.files,
            r.bytes as f64 / 1e6,
            start.elapsed().as_secs_f64()
        ));
        if let Some(text) = &shards {
            say(text);
        }
        if a.discard && r.findings.iter().any(|f| f.damaged) {
            say("what was damaged has been removed");
        } else if r.findings.iter().any(|f| f.damaged) {
            say("damaged files must go first: ema dataset verify --discard");
        }
    }
    let whole = r.finished && r.findings.is_empty();
    Ok(if whole {
        ExitCode::SUCCESS
    } else {
        ExitCode::from(EXIT_LOSS)
    })
}

fn diagnose(a: &DiagnoseArgs) -> Result<ExitCode> {
    let d = Dataset::open(&a.dataset)?;
    let done: Diagnosed = match (&a.maps, &a.unit) {
        (None, None) => by_own_maps(&d)?,
        (None, Some(place)) => {
            let units = crate::unit::folder(place)?;
            by_units(&d, &units, &sim_worker::catalogue::grid(&a.grid)?)?
        }
        (Some(file), _) => {
            let choice = Choice {
                spread: sim_worker::catalogue::spread(&a.spread)?,
                coverage: COVERAGE,
            };
            let file = file_in(file);
            by_type(&d, &choice.ready(&file, FailureMapSet::load(&file)?, &Vec::new())?)?
        }
    };
    list("not diagnosed:", &done.refused);
    match done.grounds {
        Grounds::Halves(n) => say(&format!("calibrated with {n} tests of the other half each")),
        Grounds::Simulated(n) => say(&format!(
            "too few tests to calibrate by: calibrated with {n} simulated tests of the same actuators"
        )),
        Grounds::OfMaps => {}
        Grounds::OfUnits => say("calibrated with simulated units like each"),
        Grounds::Design => say("the maps have no calibration: intervals reach as far as designed"),
    }
    say(&format!(
        "{} tests: {} located, of these {} with the exact pair in both intervals; {}",
        done.tests,
        done.located,
        done.inside,
        d.storage.url(&done.path)
    ));
    Ok(ExitCode::SUCCESS)
}
