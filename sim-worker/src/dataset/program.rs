//! The program `sim-worker`: one share of a fleet plan, or the merge of all.

use super::merge::{Merged, merge};
use super::plan::DatasetPlan;
use super::shard::{SHARDS, Shard};
use super::storage::Storage;
use super::work::{Done, work};
use crate::progress::{Progress, catch_interrupts, interrupted, with_bar};
use clap::Parser;
use clap::builder::RangedU64ValueParser;
use schemas::error::{EXIT_INTERRUPTED, EXIT_LOSS, Error, Result};
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::Arc;
use std::time::{Duration, Instant};

const AFTER: &str = "\
One process on one machine:   sim-worker --plan fleet.toml --out fleet && sim-worker --plan fleet.toml --out fleet --merge
Eight shards by hand:         sim-worker --plan fleet.toml --out s3://bucket/fleet --shard 0/8   (to 7/8, anywhere, in any order)
Slurm, Kubernetes:            sim-worker/deploy/; the number of the task or pod and EMA_SHARDS say which shard it is

A dataset goes to a folder or an S3 bucket. Credentials, region and endpoint of S3 come from the environment: \
AWS_ACCESS_KEY_ID, AWS_SECRET_ACCESS_KEY, AWS_REGION, AWS_ENDPOINT_URL, AWS_ALLOW_HTTP.
A worker may be killed, started twice or late: parts that are there are not made again.

Exit codes: 0 done | 1 unforeseen failure, for example a full disk or a network that is down | 2 wrong command line \
| 3 not finished: parts are missing, which shards to run is said | 4 bad input: one line says file, place, value found and what is allowed \
| 130 interrupted (Ctrl-C, SIGTERM); what is done is kept";

const INTERRUPTED: &str = "interrupted; what is done is kept, the same command goes on from there";

/// More threads than this are a slip of the hand, and would bring the machine down.
const MOST_JOBS: u64 = 4096;

/// How long a program that was asked to stop may take to do so by itself.
const GRACE: Duration = Duration::from_secs(1);

/// Simulate one share of a fleet plan, or put all shares together.
#[derive(Parser)]
#[command(name = "sim-worker", version, after_help = AFTER)]
struct Program {
    /// Fleet plan, a TOML file (datasets/fleets)
    #[arg(long, value_name = "FILE")]
    plan: PathBuf,
    /// Share I of N, I from 0 to N - 1; from the environment of a job array or indexed job if left out, else all
    #[arg(long, value_name = "I/N", conflicts_with = "merge")]
    shard: Option<String>,
    /// Put the shares together: when all are done
    #[arg(long)]
    merge: bool,
    /// Where the dataset goes: a folder, or s3://BUCKET/PREFIX; the plan's `out` if left out
    #[arg(long, env = "EMA_DATASET", value_name = "URL")]
    out: Option<String>,
    /// Threads; SLURM_CPUS_PER_TASK or all cores if left out
    #[arg(long, env = "SLURM_CPUS_PER_TASK", hide_env = true, value_name = "N",
        value_parser = RangedU64ValueParser::<usize>::new().range(1..=MOST_JOBS))]
    jobs: Option<usize>,
    /// No progress on standard error; results and errors stay
    #[arg(long)]
    quiet: bool,
}

/// Works through a share with a progress display. `Ok(None)` where it was interrupted.
///
/// # Errors
/// As [`work`].
pub fn work_shown(plan: &DatasetPlan, storage: &Storage, shard: Shard, title: &str) -> Result<Option<Done>> {
    let progress = Arc::new(Progress::default());
    let parts = plan.parts();
    let total = parts[shard.range(parts.len())]
        .iter()
        .map(|p| p.runs.end - p.runs.start)
        .sum();
    with_bar(title, total, &progress, || work(plan, storage, shard, &progress))
}

/// What a worker has done, in words.
pub fn summary(done: &Done, seconds: f64) -> String {
    let mut text = format!("{} parts, {} runs", done.parts, done.runs);
    if done.before > 0 {
        text += &format!("; {} parts were there before", done.before);
    }
    if done.twice > 0 {
        text += &format!("; {} parts were made by another worker meanwhile", done.twice);
    }
    if done.steps > 0 {
        text += &format!(
            "; {:.3e} steps in {seconds:.1} s, {:.1} MB stored",
            done.steps as f64,
            done.bytes as f64 / 1e6
        );
    }
    text
}

/// What is missing, in words: which shards to run.
pub fn missing(plan: &DatasetPlan, parts: &[usize]) -> String {
    missing_of(plan.parts().len(), parts, None)
}

/// As [`missing`], of `total` parts, by the names of `count` shards: as many as `EMA_SHARDS` says if not
/// given, else a shard a part.
pub fn missing_of(total: usize, parts: &[usize], count: Option<usize>) -> String {
    let set = || std::env::var(SHARDS).ok().and_then(|t| t.parse().ok());
    let count = count.or_else(set).filter(|&n| n > 0).unwrap_or(total);
    let mut shards: Vec<String> = parts.iter().map(|&p| Shard::of(p, total, count).to_string()).collect();
    shards.dedup();
    let more = shards.len().saturating_sub(20);
    shards.truncate(20);
    let more = if more > 0 {
        format!(" and {more} more")
    } else {
        String::new()
    };
    format!(
        "{} of {total} parts are missing; run sim-worker with --shard {}{more}",
        parts.len(),
        shards.join(", ")
    )
}

fn run(p: &Program) -> Result<ExitCode> {
    let plan = DatasetPlan::read(&p.plan)?;
    if let Some(n) = p.jobs {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(n).build_global();
        pool.map_err(|e| Error::bad("command line", "--jobs", n, e.to_string()))?;
    }
    let storage = Storage::open(p.out.as_deref().unwrap_or(&plan.out))?;
    let start = Instant::now();
    if p.merge {
        return Ok(match merge(&plan, &storage, |_, _| ())? {
            Merged::Whole(m) => {
                println!(
                    "{}: {} runs of {} actuators in {} files",
                    storage.describe(),
                    m.runs,
                    m.actuators,
                    m.files.len()
                );
                ExitCode::SUCCESS
            }
            Merged::Missing(parts) => {
                eprintln!("sim-worker: {}: {}", storage.describe(), missing(&plan, &parts));
                ExitCode::from(EXIT_LOSS)
            }
        });
    }
    let shard = match &p.shard {
        Some(text) => Shard::parse(text)?,
        None => Shard::from_environment(|name| std::env::var(name).ok())?.unwrap_or(Shard::WHOLE),
    };
    match work_shown(&plan, &storage, shard, &format!("shard {shard}"))? {
        Some(done) => {
            println!(
                "shard {shard} of {}: {}",
                storage.describe(),
                summary(&done, start.elapsed().as_secs_f64())
            );
            Ok(ExitCode::SUCCESS)
        }
        None => {
            eprintln!("sim-worker: {INTERRUPTED}");
            Ok(ExitCode::from(EXIT_INTERRUPTED))
        }
    }
}

/// Ends a program that was asked to stop and does not, as it waits for a network or puts a dataset together.
/// That does no harm: it might as well have been killed.
///
/// * `program` its name, for the message
pub fn end_when_interrupted(program: &'static str) {
    std::thread::spawn(move || {
        while !interrupted() {
            std::thread::sleep(Duration::from_millis(50));
        }
        std::thread::sleep(GRACE);
        eprintln!("{program}: {INTERRUPTED}");
        std::process::exit(i32::from(EXIT_INTERRUPTED));
    });
}

/// The program `sim-worker`.
pub fn main() -> ExitCode {
    let program = Program::parse();
    if program.quiet {
        crate::quiet::be_quiet();
    }
    catch_interrupts();
    end_when_interrupted("sim-worker");
    run(&program).unwrap_or_else(|e| {
        eprintln!("sim-worker: {}", e.to_string().replace('\n', " "));
        ExitCode::from(e.exit_code())
    })
}
