//! What the end-to-end and validation tests share.
//!
//! - [`arguments`]: of the benchmarks
//! - [`blind`]: "measured" data with a hidden effect, made by equations of its own
//! - [`campaign`]: blind cases by the hundred, studied, scored and reported
//! - [`coverage`]: what share of fresh simulated tests lies in its intervals
//! - [`second`], [`independent`]: rigs and actuators of other hands: generators that know nothing of the study, written
//!   from the words of its interface alone and kept as they were before their keys were opened
//! - [`fleet`]: datasets made by workers that are killed, stopped and started again
//! - [`mutation`]: inputs changed at random, through every door that takes something from outside
//! - [`s3`], [`slurm`]: a server and a cluster of our own, gone with the test
//! - [`stream`]: processes on a stream of their own
//! - [`soak`]: a stream whose processes are killed at random moments
//! - here: runs of the reference actuator, and columns of a CSV file
//!
//! Next to it stand the programs under test (`main.rs`, `diagnoser.rs`, `query.rs`, `sim_worker.rs`) and the benches of
//! diagnosis, discrepancy, latency and changed inputs (`bin`). What tests of programs share besides is in `tests/common`.

pub mod arguments;
pub mod blind;
pub mod campaign;
pub mod coverage;
pub mod fleet;
pub mod independent;
pub mod lives;
pub mod mutation;
pub mod s3;
pub mod second;
pub mod slurm;
pub mod soak;
pub mod stream;

use schemas::channel::Channel;
use schemas::fault::FaultState;
use schemas::telemetry::Collector;
use sim_worker::extractor::FeaturePlan;
use sim_worker::parameters::ActuatorParameters;
use sim_worker::simulate::{Experiment, Run, simulate};
use sim_worker::test_bench::Lane;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// The folder named by an environment variable, or `None` after saying that the test is skipped.
pub fn folder(variable: &str) -> Option<PathBuf> {
    match std::env::var_os(variable) {
        Some(v) if !v.is_empty() => Some(PathBuf::from(v)),
        _ => {
            println!("skipped: {variable} not set");
            None
        }
    }
}

/// A folder or file within the folder of an environment variable, or `None` after saying that the test is skipped.
pub fn folder_in(variable: &str, name: &str) -> Option<PathBuf> {
    let inner = folder(variable)?.join(name);
    if !inner.exists() {
        println!("skipped: no {name} in {variable}");
        return None;
    }
    Some(inner)
}

/// Programs under test in one folder by the names that users call them: `ema` looks for `ema-query` beside itself.
///
/// * `dir` made if it is not there; on the file system of the programs, which are linked
/// * `programs` name, and what is linked
pub fn programs(dir: &Path, programs: &[(&str, &str)]) {
    std::fs::create_dir_all(dir).unwrap();
    for (name, program) in programs {
        let to = dir.join(format!("{name}{}", std::env::consts::EXE_SUFFIX));
        // under the name at once: other test programs do the same
        let new = dir.join(format!(".{name}.new-{}", std::process::id()));
        let _ = std::fs::remove_file(&new);
        std::fs::hard_link(program, &new).unwrap();
        std::fs::rename(&new, &to).unwrap();
        // a rename onto the same file leaves both names
        let _ = std::fs::remove_file(&new);
    }
}

/// One run of the reference actuator, noise free, basic channels and those that features of the sequence come from.
pub fn reference_run(fsj: f64, zeta: f64, sequence: &str, rate_hz: f64) -> Collector {
    reference_runs(&[(fsj, zeta)], sequence, rate_hz).remove(0)
}

/// Runs of the reference actuator side by side.
pub fn reference_runs(faults: &[(f64, f64)], sequence: &str, rate_hz: f64) -> Vec<Collector> {
    let actuator = Arc::new(ActuatorParameters::reference());
    let sequence = sim_worker::catalogue::sequence(sequence).unwrap();
    let wanted = FeaturePlan::wanted_of(&sequence, false);
    let channels = wanted
        .iter()
        .fold(schemas::channel::ChannelSet::basic(), |all, c| all.with(c));
    let e = Experiment::new(sequence, rate_hz, channels, None, actuator.step_s).unwrap();
    let runs: Vec<Run> = faults
        .iter()
        .enumerate()
        .map(|(i, &(fsj, zeta))| Run {
            number: i as u64,
            lane: Lane {
                actuator: actuator.clone(),
                fault: FaultState { fsj, zeta },
                rest_angle_rad: 0.0,
                load_n_m: 0.0,
            },
            seed: 0,
        })
        .collect();
    let mut all = Vec::new();
    for group in runs.chunks(sim_worker::simulate::LANES) {
        let mut sinks = vec![Collector::default(); group.len()];
        simulate(&e, group, &mut sinks, || true).unwrap();
        all.extend(sinks);
    }
    all
}

/// Root mean square of the difference over that of `truth`.
pub fn relative_rms(truth: &[f64], other: &[f64]) -> f64 {
    assert_eq!(truth.len(), other.len());
    let d: f64 = truth.iter().zip(other).map(|(a, b)| (a - b) * (a - b)).sum();
    let s: f64 = truth.iter().map(|a| a * a).sum();
    (d / s).sqrt()
}

/// A telemetry CSV as columns in the order of the basic channels, after the time.
pub fn read_csv(path: &Path) -> Vec<Vec<f64>> {
    let text = std::fs::read_to_string(path).unwrap();
    let mut columns = vec![Vec::new(); 9];
    for line in text.lines().skip(1) {
        for (c, x) in columns.iter_mut().zip(line.split(',')) {
            c.push(x.parse().unwrap());
        }
    }
    columns
}

/// The channels of [`read_csv`]'s columns 1 to 8.
pub const CSV_CHANNELS: [Channel; 8] = [
    Channel::Com,
    Channel::ThetaU,
    Channel::ThetaM,
    Channel::OmegaM,
    Channel::IEq,
    Channel::IA,
    Channel::IB,
    Channel::IC,
];
