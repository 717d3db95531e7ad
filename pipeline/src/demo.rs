//! `ema demo`: grid, maps, and the four cases of the paper's Table I.

use crate::case::{self, Case, Settings};
use crate::dataset::{self, Dataset};
use crate::{COMMIT, maps};
use anyhow::Result;
use diagnoser::diagnosis::{Diagnoser, Diagnosis, Outcome};
use diagnoser::map_library::Choice;
use diagnoser::sensitivity::noise_sigma;
use rayon::prelude::*;
use schemas::channel::{Channel, ChannelSet};
use schemas::fault::{FaultGrid, FaultState};
use schemas::recording::Recorder;
use schemas::telemetry::{Collector, TelemetryBuffer, TelemetryHeader, TelemetrySink};
use sim_worker::dataset::one::OneActuator;
use sim_worker::dataset::plan::DatasetPlan;
use sim_worker::dataset::storage::Storage;
use sim_worker::extractor::{FeatureExtractor, FeaturePlan};
use sim_worker::parameters::ActuatorParameters;
use sim_worker::sensor::{SensorModel, SensorNoise, Sensors};
use sim_worker::setup::TestSetup;
use sim_worker::simulate::{Run, simulate};
use sim_worker::test_bench::Lane;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Instant;

/// Table I of the paper: zeta, FSJ, and the paper's errors in percent of each.
pub const TABLE_I: [(f64, f64, f64, f64); 4] = [
    (0.30, 2.0, 0.0, 3.0350),
    (0.17, 1.2, 11.7647, 5.4333),
    (0.15, 3.5, 0.0, 0.1829),
    (0.27, 2.2, 0.0, 1.2500),
];

/// Statistics of one case over noise seeds.
#[derive(Clone, Debug)]
pub struct CaseStatistics {
    /// the exact pair
    pub truth: FaultState,
    /// noise seeds diagnosed, 0 upwards
    pub seeds: u64,
    /// share of seeds that are located with the truth inside
    pub inside: f64,
    /// errors in percent, sorted: zeta, FSJ (not located counts as infinite)
    pub zeta_error: Vec<f64>,
    /// in percent, as `zeta_error`
    pub fsj_error: Vec<f64>,
    /// median errors in percent by the paper's own method with these maps: zeta, FSJ
    pub by_paper: (f64, f64),
    /// median widths of the intervals: FSJ, zeta
    pub fsj_width: f64,
    /// of zeta
    pub zeta_width: f64,
}

/// Quantile of a sorted list.
pub fn quantile(sorted: &[f64], q: f64) -> f64 {
    sorted[((sorted.len() - 1) as f64 * q).round() as usize]
}

/// Diagnoses one simulated run under many noise seeds.
pub fn statistics(
    run: &Collector,
    truth: FaultState,
    diagnoser: &Diagnoser,
    plan: &Arc<FeaturePlan>,
    sensors: &SensorModel,
    seeds: u64,
) -> CaseStatistics {
    let set = &diagnoser.maps;
    let rest_angle_rad = set.header.kind.rest_angle_rad;
    let percent = |exact: f64, found: f64| 100.0 * (exact - found).abs() / exact;
    let errors = |d: &Diagnosis| {
        let found = d.outcome.area().map(|a| a.centroid);
        found.map_or((f64::INFINITY, f64::INFINITY), |(fsj, zeta)| {
            (percent(truth.zeta, zeta), percent(truth.fsj, fsj))
        })
    };
    type One = (f64, f64, bool, f64, f64, (f64, f64));
    let results: Vec<One> = (0..seeds)
        .into_par_iter()
        .map(|seed| {
            let noise = SensorNoise::new(seed, run.rows());
            let s = Sensors {
                model: sensors,
                noise: &noise,
                gear_ratio: plan.gear_ratio,
                rest_angle_rad,
            };
            let mut out = TelemetryBuffer::new(ChannelSet::basic(), run.rows());
            s.measure(&run.view(), &mut out);
            let mut x = FeatureExtractor::new(plan.clone());
            x.push(&out.view());
            let features = set.features(&x.features());
            let d = diagnoser.diagnose(&features, &x.missing());
            let by_paper = errors(&diagnoser::paper::diagnose(diagnoser, &features, &x.missing()));
            match &d.outcome {
                Outcome::Located(a) => {
                    let inside = a.fsj.contains(truth.fsj) && a.zeta.contains(truth.zeta);
                    (
                        percent(truth.zeta, a.centroid.1),
                        percent(truth.fsj, a.centroid.0),
                        inside,
                        a.fsj.width(),
                        a.zeta.width(),
                        by_paper,
                    )
                }
                _ => (
                    f64::INFINITY,
                    f64::INFINITY,
                    false,
                    f64::INFINITY,
                    f64::INFINITY,
                    by_paper,
                ),
            }
        })
        .collect();
    let sorted = |f: fn(&One) -> f64| {
        let mut v: Vec<f64> = results.iter().map(f).collect();
        v.sort_by(f64::total_cmp);
        v
    };
    CaseStatistics {
        truth,
        seeds,
        inside: results.iter().filter(|r| r.2).count() as f64 / seeds as f64,
        by_paper: (quantile(&sorted(|r| r.5.0), 0.5), quantile(&sorted(|r| r.5.1), 0.5)),
        zeta_error: sorted(|r| r.0),
        fsj_error: sorted(|r| r.1),
        fsj_width: quantile(&sorted(|r| r.3), 0.5),
        zeta_width: quantile(&sorted(|r| r.4), 0.5),
    }
}

/// A simulated grid and its maps, ready to diagnose.
pub(crate) struct Grid {
    pub setup: TestSetup,
    pub faults: FaultGrid,
    pub runs: u64,
    /// made now; the others were there
    pub steps: u64,
    pub seconds: f64,
    pub diagnoser: Diagnoser,
}

impl Grid {
    fn sensors(&self) -> &SensorModel {
        self.setup.sensors.as_ref().expect("the demo has sensors")
    }
}

/// Simulates the grid called `name` into `dataset`, builds and calibrates its maps.
fn grid(name: &str, dataset: &Path, choice: &Choice) -> Result<Grid> {
    let begin = Instant::now();
    let actuator = Arc::new(ActuatorParameters::reference());
    let setup = TestSetup {
        sensors: sim_worker::catalogue::sensors("reference")?,
        ..TestSetup::new(actuator, sim_worker::catalogue::sequence("preflight")?, 10_000.0)
    };
    let faults = sim_worker::catalogue::grid(name)?;
    let plan = DatasetPlan::of_one(&OneActuator {
        setup: &setup,
        grid: &faults,
        rest_angles_rad: &[],
        seed: 0,
        telemetry: None,
    })?;
    let storage = Storage::open(&dataset.display().to_string())?;
    let (done, _) = dataset::make(&plan, &storage, "grid")?.ok_or(crate::Interrupted)?;
    let seconds = begin.elapsed().as_secs_f64();
    let set = dataset::maps::of_one(&Dataset::of(storage)?, false)?;
    let maps_file = dataset.join(diagnoser::map_library::FILE);
    set.save(&maps_file)?;
    Ok(Grid {
        diagnoser: maps::calibrated(&maps_file, set, &setup, choice, &Vec::new())?,
        setup,
        faults,
        runs: plan.runs(),
        steps: done.steps,
        seconds,
    })
}

/// A case of the paper's Table I.
pub(crate) struct TableCase {
    /// the paper's errors in percent: zeta, FSJ
    pub paper: (f64, f64),
    /// one noise seed, recorded and diagnosed from the file
    pub case: Case,
    pub statistics: CaseStatistics,
    /// standard deviations that noise alone makes: FSJ, zeta
    pub noise: Option<(f64, f64)>,
    /// noise free
    pub run: Collector,
}

impl TableCase {
    pub fn truth(&self) -> FaultState {
        self.statistics.truth
    }

    /// What stands in the table, as pairs of zeta and FSJ with `and` between them: exact, detected, error in percent,
    /// median and 95th percentile of the seeds' errors; and the share of seeds with the truth inside.
    pub fn words(&self, and: &str) -> [String; 6] {
        let (t, s) = (self.truth(), &self.statistics);
        let found = self.case.diagnosis.outcome.area();
        let (fsj, zeta) = found.map_or((f64::NAN, f64::NAN), |a| a.centroid);
        let percent = |exact: f64, x: f64| 100.0 * (exact - x).abs() / exact;
        let pair = |zeta: f64, fsj: f64| format!("{zeta:.2}{and}{fsj:.2}");
        let of_seeds = |q: f64| pair(quantile(&s.zeta_error, q), quantile(&s.fsj_error, q));
        [
            format!("{:.2}{and}{:.1}", t.zeta, t.fsj),
            format!("{zeta:.4}{and}{fsj:.4}"),
            pair(percent(t.zeta, zeta), percent(t.fsj, fsj)),
            of_seeds(0.5),
            of_seeds(0.95),
            format!("{:.0} %", 100.0 * s.inside),
        ]
    }
}

/// What the demonstration found.
pub(crate) struct DemoResult {
    pub grid: Grid,
    pub seeds: u64,
    pub table: Vec<TableCase>,
    pub own: Option<(PathBuf, Case)>,
    /// a run without faults, noise free
    pub healthy: Collector,
}

/// Simulates the grid into `out`, builds the maps, diagnoses the paper's cases (and `file`).
pub(crate) fn run(out: &Path, grid_name: &str, seeds: u64, file: Option<&Path>) -> Result<DemoResult> {
    let (dataset, cases) = (out.join("dataset"), out.join("cases"));
    let choice = Choice::usual();
    let grid = grid(grid_name, &dataset, &choice)?;
    let mut runs = bare_runs(&grid)?;
    let healthy = runs.pop().expect("the last one has no faults");
    let plan = Arc::new(grid.setup.feature_plan());
    let settings = Settings {
        actuator: Some(grid.setup.actuator.clone()),
        maps: Some(dataset),
        run: None,
        sequence: None,
        channels: None,
        sensors: "auto".into(),
        grid: grid.faults.clone(),
        choice,
        known: Vec::new(),
        unit: None,
    };
    std::fs::create_dir_all(&cases)?;
    let mut table = Vec::new();
    for (i, (run, (zeta, fsj, paper_zeta, paper_fsj))) in runs.into_iter().zip(TABLE_I).enumerate() {
        let path = cases.join(format!("case_{}.parquet", i + 1));
        record(&path, &grid, &run, 1000 + i as u64)?;
        let truth = FaultState { fsj, zeta };
        table.push(TableCase {
            paper: (paper_zeta, paper_fsj),
            case: case::run(&path, &settings)?,
            statistics: statistics(&run, truth, &grid.diagnoser, &plan, grid.sensors(), seeds),
            noise: noise_sigma(&grid.diagnoser.maps, fsj, zeta),
            run,
        });
    }
    let own = |path: &Path| -> Result<_> {
        let settings = Settings { maps: None, ..settings };
        Ok((path.to_path_buf(), case::run(path, &settings)?))
    };
    Ok(DemoResult {
        own: file.map(own).transpose()?,
        grid,
        seeds,
        table,
        healthy,
    })
}

/// The cases of Table I and the healthy actuator, noise free.
fn bare_runs(grid: &Grid) -> Result<Vec<Collector>> {
    let channels = ChannelSet::basic();
    let bare = grid.setup.experiment(channels)?.bare(channels.with(Channel::TorqueM));
    let faults = TABLE_I.map(|(zeta, fsj, ..)| FaultState { fsj, zeta });
    let run = |(i, fault): (usize, FaultState)| Run {
        number: i as u64,
        lane: Lane {
            actuator: grid.setup.actuator.clone(),
            fault,
            rest_angle_rad: 0.0,
            load_n_m: 0.0,
        },
        seed: i as u64,
    };
    let lanes: Vec<Run> = faults
        .into_iter()
        .chain([FaultState::NOMINAL])
        .enumerate()
        .map(run)
        .collect();
    let mut collected = vec![Collector::default(); lanes.len()];
    simulate(&bare, &lanes, &mut collected, || !crate::progress::interrupted())?.ok_or(crate::Interrupted)?;
    Ok(collected)
}

/// Writes a simulated run through the sensors as a recording.
fn record(path: &Path, grid: &Grid, run: &Collector, seed: u64) -> Result<()> {
    let sensors = grid.sensors();
    let noise = SensorNoise::new(seed, run.rows());
    let s = Sensors {
        model: sensors,
        noise: &noise,
        gear_ratio: grid.setup.actuator.gear_ratio,
        rest_angle_rad: 0.0,
    };
    let channels = ChannelSet::basic();
    let mut out = TelemetryBuffer::new(channels, run.rows());
    s.measure(&run.view(), &mut out);
    let mut recorder = Recorder::create(path, &grid.setup.provenance(seed, COMMIT), channels, true)?;
    let header = run.header.clone().expect("a run that was collected");
    let header = TelemetryHeader {
        channels,
        sensors: sensors.fingerprint(),
        ..header
    };
    recorder.accept(&header, &out.view())?;
    recorder.finish()?;
    Ok(())
}
