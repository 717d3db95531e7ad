//! What a fleet's dataset costs beside the bare engine: features, sensors, encoding, bytes, memory.
//!
//! Control of every figure: the same runs through the engine with sinks that throw the samples away, in the
//! same process, alternating. CPU times are those of the thread, so other load does not count.

use parquet::arrow::arrow_reader::ParquetRecordBatchReaderBuilder;
use rayon::prelude::*;
use schemas::channel::ChannelSet;
use schemas::error::Result;
use schemas::run_encoder::TelemetryLayout;
use schemas::telemetry::{Collector, TelemetryHeader, TelemetrySink, TelemetryView};
use sim_worker::dataset::parts::Part;
use sim_worker::dataset::plan::DatasetPlan;
use sim_worker::dataset::shard::Shard;
use sim_worker::dataset::storage::Storage;
use sim_worker::dataset::work::{Bench, work};
use sim_worker::extractor::FeaturePlan;
use sim_worker::noise::Noise;
use sim_worker::progress::Progress;
use sim_worker::simulate::{Experiment, LANES, Run, simulate};
use std::collections::BTreeMap;
use std::path::Path;
use std::time::Instant;

struct Nothing;

impl TelemetrySink for Nothing {
    fn accept(&mut self, _: &TelemetryHeader, view: &TelemetryView<'_>) -> Result<()> {
        std::hint::black_box(view.rows);
        Ok(())
    }
}

fn plan(text: &str) -> DatasetPlan {
    let common = "\n[aircraft]\ntails = { prefix = \"T\", count = 100 }\npositions = [\"left\", \"right\"]\n\
        [spread]\nphase_resistance_ohm = { distribution = \"uniform\", half_width_relative = 0.05 }\n\
        back_emf_v_s_per_rad = { distribution = \"uniform\", half_width_relative = 0.02 }\n\
        inertia_kg_m2 = { distribution = \"normal\", sd_relative = 0.02 }\n";
    DatasetPlan::parse(
        "bench",
        &format!("name = \"bench\"\nseed = 1\n{text}\n{common}"),
        Path::new(""),
    )
    .expect("a valid plan")
}

/// CPU time of this thread [s].
fn cpu_s() -> f64 {
    let t = rustix::time::clock_gettime(rustix::time::ClockId::ThreadCPUTime);
    t.tv_sec as f64 + t.tv_nsec as f64 * 1e-9
}

/// CPU seconds of `f`, the least of `n` tries.
fn least(n: usize, mut f: impl FnMut()) -> f64 {
    (0..n)
        .map(|_| {
            let start = cpu_s();
            f();
            cpu_s() - start
        })
        .fold(f64::INFINITY, f64::min)
}

fn bare(plan: &DatasetPlan, channels: ChannelSet, part: &Part, runs: &[u64]) {
    let step = plan.actuators[0].parameters.step_s;
    let e = Experiment::new(
        plan.sequences[part.sequence].clone(),
        plan.rate_hz,
        channels,
        None,
        step,
    )
    .expect("valid");
    let list: Vec<Run> = runs.iter().map(|&r| plan.run(part, r)).collect();
    let mut sinks: Vec<Nothing> = list.iter().map(|_| Nothing).collect();
    simulate(&e, &list, &mut sinks, || true).expect("simulates");
}

/// Greatest memory of this process so far [MB].
fn peak_mb() -> f64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find(|l| l.starts_with("VmHWM:")).unwrap_or_default();
    line.split_whitespace()
        .nth(1)
        .and_then(|t| t.parse::<f64>().ok())
        .unwrap_or(f64::NAN)
        / 1024.0
}

/// Shares of one block's CPU time.
fn shares() {
    println!(
        "CPU time of 16 runs of the pre-flight test side by side, one thread [ms a run, share of the bare engine]"
    );
    for (title, text) in [
        ("features, no sensors", ""),
        (
            "features, sensors, 16 noise seeds",
            "sensors = \"reference\"\nfeature_seeds = 16",
        ),
        (
            "features, sensors, 4 noise seeds",
            "sensors = \"reference\"\nfeature_seeds = 4",
        ),
        ("telemetry at 10 kHz, no sensors", "[telemetry]"),
        (
            "telemetry at 10 kHz, sensors, 1 seed",
            "sensors = \"reference\"\nfeature_seeds = 1\n[telemetry]",
        ),
    ] {
        let plan = plan(text);
        let part = &plan.parts()[0];
        let runs: Vec<u64> = (20..20 + LANES as u64).collect();
        let bench = Bench::new(&plan).expect("valid");
        let progress = Progress::default();
        let channels = FeaturePlan::channels_of(false);
        let mut all = f64::INFINITY;
        let mut engine = f64::INFINITY;
        for _ in 0..3 {
            engine = engine.min(least(1, || bare(&plan, channels, part, &runs)));
            all = all.min(least(1, || {
                let list = bench
                    .block(part, &runs, &progress)
                    .expect("simulates")
                    .expect("not stopped");
                std::hint::black_box(list.len());
            }));
        }
        let per = 1e3 / LANES as f64;
        println!(
            "  {title:40} bare {:6.2}  with {:6.2}  {:.3}",
            engine * per,
            all * per,
            all / engine
        );
    }
    // the samples of one block, measured and encoded apart
    let plan = plan("sensors = \"reference\"\n[telemetry]");
    let part = &plan.parts()[0];
    let runs: Vec<Run> = (20..20 + LANES as u64).map(|r| plan.run(part, r)).collect();
    let kept = plan.telemetry.as_ref().expect("kept");
    let step = plan.actuators[0].parameters.step_s;
    let e = Experiment::new(plan.sequences[0].clone(), plan.rate_hz, kept.stored, None, step).expect("valid");
    let mut sinks = vec![Collector::default(); LANES];
    simulate(&e, &runs, &mut sinks, || true).expect("simulates");
    let model = plan.sensors.as_ref().expect("a model");
    let per = 1e3 / LANES as f64;
    let mut noise = Vec::new();
    let made = least(3, || {
        noise = runs.iter().map(|r| Noise::of_run(model, r.seed, e.rows())).collect()
    });
    let mut measured: Vec<schemas::telemetry::TelemetryBuffer> =
        vec![schemas::telemetry::TelemetryBuffer::new(kept.stored, e.rows() as usize); LANES];
    let sensed = least(3, || {
        for ((n, s), m) in noise.iter().zip(&sinks).zip(&mut measured) {
            n.measure(s.header.as_ref().expect("a header"), 500.0, &s.view(), m);
        }
    });
    let layout = TelemetryLayout::new(kept.stored, true, plan.rate_hz).expect("valid");
    let mut bytes = 0;
    let encoded = least(3, || {
        let mut chunks = Vec::new();
        for (run, m) in runs.iter().zip(&measured) {
            let mut encoder = layout.encoder(run.number, [1.0, 0.0, 0.0]).expect("valid");
            let view = m.view();
            for from in (0..view.rows).step_by(128) {
                encoder
                    .push(&view.slice(from, (from + 128).min(view.rows)))
                    .expect("pushes");
            }
            chunks.push(encoder.finish().expect("finishes"));
        }
        bytes = layout.file(chunks, Vec::new()).expect("a file").len();
    });
    println!(
        "  apart: making noise {:.2} ms, measuring {:.2} ms, encoding {:.2} ms a run; {:.0} kB a run",
        made * per,
        sensed * per,
        encoded * per,
        bytes as f64 / LANES as f64 / 1e3
    );
}

/// Runs of a shard of the fleet of 200 actuators, stored in a folder, beside the same runs through the bare
/// engine; all threads. Returns seconds a run of both.
fn share_of_fleet(plan: &DatasetPlan, shard: Shard) -> (f64, f64) {
    let folder = tempfile::tempdir().expect("a folder");
    let storage = Storage::open(&folder.path().display().to_string()).expect("a folder");
    let start = Instant::now();
    let done = work(plan, &storage, shard, &Progress::default())
        .expect("works")
        .expect("not stopped");
    let all = start.elapsed().as_secs_f64() / done.runs as f64;
    let parts = plan.parts();
    let channels = FeaturePlan::channels_of(false);
    let mut blocks: Vec<(&Part, Vec<u64>)> = Vec::new();
    for part in &parts[shard.range(parts.len())] {
        let runs: Vec<u64> = part.runs.clone().collect();
        blocks.extend(runs.chunks(LANES).map(|c| (part, c.to_vec())));
    }
    let start = Instant::now();
    blocks
        .par_iter()
        .for_each(|(part, runs)| bare(plan, channels, part, runs));
    (all, start.elapsed().as_secs_f64() / done.runs as f64)
}

fn fleet() {
    let threads = rayon::current_num_threads();
    println!(
        "\nfeatures of 200 actuators x 187 grid points, 37 400 runs, on {threads} threads [s a run; control: bare engine]"
    );
    for (title, text) in [
        ("no sensors", ""),
        ("sensors, 4 noise seeds", "sensors = \"reference\""),
    ] {
        let plan = plan(text);
        assert_eq!(plan.runs(), 37_400);
        let mut totals = Vec::new();
        for index in [0, 21] {
            let shard = Shard { index, count: 40 };
            let (all, engine) = share_of_fleet(&plan, shard);
            totals.push(all * plan.runs() as f64);
            println!(
                "  {title:24} shard {shard}: {:.3} ms  bare {:.3} ms  ratio {:.3}  whole fleet {:.0} s",
                all * 1e3,
                engine * 1e3,
                all / engine,
                all * plan.runs() as f64
            );
        }
        println!(
            "  {title:24} projection of the first fraction over what the second took: {:.3}",
            totals[0] / totals[1]
        );
    }
    println!("  greatest memory of this process so far {:.0} MB", peak_mb());
}

/// Bytes of each column over all telemetry files below `dir`, and values.
fn columns(dir: &Path, into: &mut BTreeMap<String, (u64, u64)>) {
    for entry in std::fs::read_dir(dir).expect("a folder").flatten() {
        let path = entry.path();
        if path.is_dir() {
            columns(&path, into);
            continue;
        }
        let file = std::fs::File::open(&path).expect("a file");
        let meta = ParquetRecordBatchReaderBuilder::try_new(file)
            .expect("whole")
            .metadata()
            .clone();
        for group in meta.row_groups() {
            for c in group.columns() {
                let sum = into.entry(c.column_path().string()).or_default();
                sum.0 += c.compressed_size() as u64;
                sum.1 += c.num_values() as u64;
            }
        }
    }
}

fn telemetry() {
    let text = "sensors = \"reference\"\nfeature_seeds = 4\n[telemetry]";
    let plan = plan(text);
    // eleven actuators: 2 057 runs
    let shard = Shard { index: 0, count: 18 };
    let folder = tempfile::tempdir().expect("a folder");
    let storage = Storage::open(&folder.path().display().to_string()).expect("a folder");
    let start = Instant::now();
    let done = work(&plan, &storage, shard, &Progress::default())
        .expect("works")
        .expect("not stopped");
    let seconds = start.elapsed().as_secs_f64();
    println!(
        "\ntelemetry at 10 kHz of {} runs with sensors: {:.1} s, {:.1} MB stored, {:.1} MB/s, {:.2} ms a run",
        done.runs,
        seconds,
        done.bytes as f64 / 1e6,
        done.bytes as f64 / 1e6 / seconds,
        seconds * 1e3 / done.runs as f64
    );
    let mut sums = BTreeMap::new();
    columns(&folder.path().join("telemetry"), &mut sums);
    println!(
        "  bytes a value in the files (f32, byte-stream-split, zstd 1; run, faults and time as schemas/README.md says)"
    );
    for (name, (bytes, values)) in sums {
        println!("  {name:16} {:.4}", bytes as f64 / values as f64);
    }
    println!("  greatest memory of this process so far {:.0} MB", peak_mb());
}

fn main() {
    shares();
    fleet();
    telemetry();
}
