//! What a plan will cost, from a block of it that is run now.

use anyhow::Result;
use rayon::prelude::*;
use schemas::channel::Channel;
use serde_json::json;
use sim_worker::dataset::parts::{Kind, Part};
use sim_worker::dataset::plan::DatasetPlan;
use sim_worker::dataset::work::Bench;
use sim_worker::progress::Progress;
use std::time::Instant;

/// What a plan comes to.
#[derive(Clone, Debug)]
pub struct Estimate {
    pub actuators: usize,
    pub runs: u64,
    /// of these, grid points and tests
    pub map_runs: u64,
    pub test_runs: u64,
    /// of these, with telemetry
    pub telemetry_runs: u64,
    pub parts: usize,
    pub steps: f64,
    pub threads: usize,
    /// runs and seconds of the measurement
    pub measured_runs: usize,
    pub measured_s: f64,
    /// on all threads
    pub seconds: f64,
    pub bytes: f64,
    pub bytes_per_telemetry_run: f64,
}

/// Runs a block of each kind on every thread, and projects.
pub fn estimate(plan: &DatasetPlan) -> Result<Estimate> {
    let parts = plan.parts();
    let bench = Bench::new(plan)?;
    let threads = rayon::current_num_threads();
    // one part of each sequence and kind stands for all of them
    let mut kinds: Vec<(&Part, u64, usize)> = Vec::new();
    for p in &parts {
        let runs = p.runs.end - p.runs.start;
        let same = |q: &Part| (q.sequence, q.kind, q.telemetry) == (p.sequence, p.kind, p.telemetry);
        match kinds.iter_mut().find(|(q, ..)| same(q)) {
            Some((_, n, count)) => {
                *n += runs;
                *count += 1;
            }
            None => kinds.push((p, runs, 1)),
        }
    }
    let mut e = Estimate {
        actuators: plan.actuators.len(),
        runs: plan.runs(),
        map_runs: 0,
        test_runs: 0,
        telemetry_runs: 0,
        parts: parts.len(),
        steps: 0.0,
        threads,
        measured_runs: 0,
        measured_s: 0.0,
        seconds: 0.0,
        bytes: 0.0,
        bytes_per_telemetry_run: 0.0,
    };
    for (part, runs, count) in kinds {
        let lanes = plan.lanes(part) as u64;
        let block: Vec<u64> = part.runs.clone().take(lanes as usize).collect();
        let start = Instant::now();
        let made = (0..threads)
            .into_par_iter()
            .map(|_| {
                let list = bench.block(part, &block, &Progress::default())?.unwrap_or_default();
                let telemetry = list.first().is_some_and(|r| r.telemetry.is_some());
                Ok(if telemetry {
                    bench.telemetry_bytes(part, list)?
                } else {
                    0
                })
            })
            .collect::<Result<Vec<usize>, schemas::error::Error>>()?;
        let seconds = start.elapsed().as_secs_f64();
        e.measured_runs += block.len() * threads;
        e.measured_s += seconds;
        // blocks that are not full cost as much as full ones of their number of lanes
        let per_part = (runs as f64 / count as f64 / lanes as f64).ceil().max(1.0);
        e.seconds += seconds * per_part * count as f64 / threads as f64;
        let per_run = made[0] as f64 / block.len() as f64;
        e.bytes += per_run * runs as f64 + ROW_BYTES * runs as f64;
        if part.telemetry {
            e.telemetry_runs += runs;
            e.bytes_per_telemetry_run = per_run;
        }
        match part.kind {
            Kind::Map => e.map_runs += runs,
            Kind::Test => e.test_runs += runs,
        }
        let step_s = plan.actuators[part.actuator].parameters.step_s;
        e.steps += runs as f64 * plan.sequences[part.sequence].duration_s() / step_s;
    }
    Ok(e)
}

/// Bytes of a row of `features`: its floats hardly compress.
const ROW_BYTES: f64 = 200.0;

fn time(seconds: f64) -> String {
    match seconds {
        s if s < 120.0 => format!("{s:.0} s"),
        s if s < 7200.0 => format!("{:.0} min", s / 60.0),
        s if s < 172_800.0 => format!("{:.1} h", s / 3600.0),
        s => format!("{:.1} days", s / 86_400.0),
    }
}

fn size(bytes: f64) -> String {
    match bytes {
        b if b < 1e6 => format!("{:.0} kB", b / 1e3),
        b if b < 1e9 => format!("{:.1} MB", b / 1e6),
        b if b < 1e12 => format!("{:.2} GB", b / 1e9),
        b => format!("{:.2} TB", b / 1e12),
    }
}

fn names<'a>(list: impl Iterator<Item = &'a str>) -> String {
    list.collect::<Vec<_>>().join(", ")
}

/// For people.
pub fn to_text(plan: &DatasetPlan, e: &Estimate) -> String {
    let mut lines: Vec<(&str, String)> = Vec::new();
    let some = names(plan.actuators.iter().take(3).map(|a| a.id.as_str()));
    let more = if e.actuators > 3 { ", ..." } else { "" };
    lines.push((
        "fleet",
        format!("{}: {} actuators ({some}{more})", plan.name, e.actuators),
    ));
    let angles = plan
        .rest_angles_rad
        .iter()
        .map(|a| format!("{:.0}", a.to_degrees()))
        .collect::<Vec<_>>();
    lines.push((
        "tests",
        format!(
            "{} from rest angles {} deg",
            names(plan.sequences.iter().map(|s| s.name.as_str())),
            angles.join(", ")
        ),
    ));
    lines.push((
        "runs",
        format!(
            "{}: {} of the grid {} ({} FSJ x {} zeta), {} random tests; {:.2e} steps",
            e.runs,
            e.map_runs,
            plan.grid.name,
            plan.grid.fsj.len(),
            plan.grid.zeta.len(),
            e.test_runs,
            e.steps
        ),
    ));
    let sensors = plan.sensors.as_ref().map_or("none: true values".to_string(), |s| {
        format!(
            "{}, features of the grid averaged over {} noise seeds",
            s.name, plan.feature_seeds
        )
    });
    lines.push(("sensors", sensors));
    if !plan.assumed.is_empty() {
        let list = plan.assumed.iter().map(|a| a.trim_start_matches("spread."));
        lines.push(("assumed", format!("the spreads of {}", names(list))));
    }
    let mut kept = "features of every run".to_string();
    if let Some(t) = &plan.telemetry {
        kept += &format!(
            "; telemetry of {} runs at {} Hz: {}",
            e.telemetry_runs,
            t.rate_hz,
            names(t.stored.iter().map(Channel::name))
        );
    }
    lines.push(("kept", kept));
    if let Some(t) = &plan.telemetry {
        let derived = t.wanted.iter().filter(|&c| !t.stored.contains(c)).map(Channel::name);
        let derived = names(derived);
        if !derived.is_empty() {
            lines.push((
                "derived",
                format!("{derived}: not stored, ema dataset export works them out"),
            ));
        }
    }
    lines.push((
        "measured",
        format!(
            "{} runs on {} threads in {:.2} s: {:.2} ms a run",
            e.measured_runs,
            e.threads,
            e.measured_s,
            e.measured_s * 1e3 * e.threads as f64 / e.measured_runs as f64
        ),
    ));
    lines.push((
        "expected",
        format!(
            "{} on these {} threads ({:.2} core hours), {} stored",
            time(e.seconds),
            e.threads,
            e.seconds * e.threads as f64 / 3600.0,
            size(e.bytes)
        ),
    ));
    lines.push(("shards", format!("up to {} (parts)", e.parts)));
    lines.push(("goes to", plan.out.clone()));
    lines.iter().map(|(k, v)| format!("{k:10}{v}\n")).collect()
}

/// For programs.
pub fn to_json(plan: &DatasetPlan, e: &Estimate) -> serde_json::Value {
    json!({
        "name": plan.name,
        "plan": plan.fingerprint(),
        "actuators": e.actuators,
        "runs": e.runs,
        "map_runs": e.map_runs,
        "test_runs": e.test_runs,
        "telemetry_runs": e.telemetry_runs,
        "parts": e.parts,
        "steps": e.steps,
        "threads": e.threads,
        "measured_runs": e.measured_runs,
        "measured_s": e.measured_s,
        "expected_s": e.seconds,
        "expected_bytes": e.bytes,
        "bytes_per_telemetry_run": e.bytes_per_telemetry_run,
        "assumed": plan.assumed,
        "out": plan.out,
    })
}
