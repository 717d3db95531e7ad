//! Datasets: runs of a plan as telemetry and features in Parquet.

use arrow::array::{ArrayRef, Float64Array, RecordBatch, UInt64Array};
use arrow::datatypes::{DataType, Field, Schema};
use schemas::error::{Error, Result};
use schemas::fault::FaultGrid;
use schemas::feature::RawFeatures;
use schemas::fingerprint::{exact, fingerprint};
use schemas::recording::{Provenance, Recorder, Recording, metadata, write_table};
use schemas::telemetry::{TelemetryBuffer, TelemetryHeader, TelemetrySink, TelemetryView};
use sim_worker::extractor::FeaturePlan;
use sim_worker::noise::{FEATURE_SEEDS, FeatureSink, FeatureValues, Noise};
use sim_worker::parameters::ActuatorParameters;
use sim_worker::simulate::{Experiment, Run};
use sim_worker::test_bench::Lane;
use sim_worker::worker::{Block, Folder, Progress, Store, blocks, work};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Source revision of this program, for people.
pub const COMMIT: &str = env!("EMA_COMMIT");

/// Hash of the sources that results depend on: results of other sources are never mixed with
/// those of this program.
pub const SOURCE: &str = env!("EMA_SOURCE");

/// A grid of runs and what to keep of them.
#[derive(Clone, Debug)]
pub struct Plan {
    pub actuator: Arc<ActuatorParameters>,
    pub grid: FaultGrid,
    pub rest_angles_rad: Vec<f64>,
    pub load_n_m: f64,
    /// sequence, rate, channels and sensors
    pub experiment: Experiment,
    pub seed: u64,
    pub keep_telemetry: bool,
    pub keep_features: bool,
    /// P2 from i_eq
    pub equivalent_current: bool,
}

impl Plan {
    /// All runs in order: rest angle outermost, then zeta, then FSJ.
    pub fn runs(&self) -> Vec<Run> {
        let mut runs = Vec::new();
        for &rest_angle_rad in &self.rest_angles_rad {
            for fault in self.grid.points() {
                let number = runs.len() as u64;
                let lane = Lane {
                    actuator: self.actuator.clone(),
                    fault,
                    rest_angle_rad,
                    load_n_m: self.load_n_m,
                };
                runs.push(Run {
                    number,
                    lane,
                    seed: self.seed.wrapping_add(number),
                });
            }
        }
        runs
    }

    /// Of everything that the results depend on.
    pub fn fingerprint(&self) -> String {
        let list = |v: &[f64]| v.iter().map(|&x| exact(x)).collect::<Vec<_>>().join(",");
        fingerprint(&format!(
            "plan;{SOURCE};{};{};{};{};{};{};{};{};{};{};{:x};{}{}{}",
            self.actuator.fingerprint(),
            self.experiment.sequence.fingerprint(),
            list(&self.grid.fsj),
            list(&self.grid.zeta),
            list(&self.rest_angles_rad),
            exact(self.load_n_m),
            exact(self.experiment.rate_hz),
            self.experiment.sensor_fingerprint(),
            self.seed,
            FEATURE_SEEDS,
            self.experiment.channels.0,
            self.keep_telemetry,
            self.keep_features,
            self.equivalent_current,
        ))
    }

    pub fn provenance(&self) -> Provenance {
        Provenance {
            actuator: self.actuator.name.clone(),
            parameters: self.actuator.fingerprint(),
            sequence: self.experiment.sequence.name.clone(),
            sequence_fingerprint: self.experiment.sequence.fingerprint(),
            grid: self.grid.fingerprint(),
            sensors: self.experiment.sensor_fingerprint(),
            effects: String::new(),
            rate_hz: self.experiment.rate_hz,
            step_s: self.actuator.step_s,
            load_n_m: self.load_n_m,
            seed: self.seed,
            commit: COMMIT.into(),
            model: "ntb".into(),
        }
    }

    fn description(&self) -> String {
        format!(
            "actuator {} ({})\nsequence {} at {} Hz\ngrid {}: {} FSJ x {} zeta x {} rest angles\nsensors {}\nseed {}",
            self.actuator.name,
            self.actuator.fingerprint(),
            self.experiment.sequence.name,
            self.experiment.rate_hz,
            self.grid.name,
            self.grid.fsj.len(),
            self.grid.zeta.len(),
            self.rest_angles_rad.len(),
            self.experiment.sensors.as_ref().map_or("none", |s| &s.name),
            self.seed,
        )
    }
}

/// Sink of one run: recorder, features, or both.
pub struct RunSink {
    recorder: Option<Recorder>,
    /// of the recording
    noise: Option<Noise>,
    measured: TelemetryBuffer,
    features: Option<FeatureSink>,
    gear_ratio: f64,
}

impl TelemetrySink for RunSink {
    fn accept(&mut self, header: &TelemetryHeader, view: &TelemetryView<'_>) -> Result<()> {
        if let Some(f) = &mut self.features {
            f.push(header, view);
        }
        if let Some(r) = &mut self.recorder {
            if let Some(noise) = &self.noise {
                noise.measure(header, self.gear_ratio, view, &mut self.measured);
                r.accept(header, &self.measured.view())?;
            } else {
                r.accept(header, view)?;
            }
        }
        Ok(())
    }
}

struct DatasetStore<'a> {
    plan: &'a Plan,
    runs: PathBuf,
    features: PathBuf,
    feature_plan: Arc<FeaturePlan>,
    noise: Option<Arc<Noise>>,
    rows: u64,
}

impl DatasetStore<'_> {
    fn run_path(&self, run: &Run) -> PathBuf {
        self.runs.join(format!("run-{:06}.parquet", run.number))
    }
    fn feature_path(&self, block: &Block) -> PathBuf {
        self.features.join(format!("block-{:05}.parquet", block.number))
    }
}

impl Store for DatasetStore<'_> {
    type Sink = RunSink;

    fn is_done(&self, block: &Block) -> bool {
        let telemetry = |r: &Run| Recording::open(&self.run_path(r)).is_ok_and(|f| f.rows == self.rows);
        (!self.plan.keep_telemetry || block.runs.iter().all(telemetry))
            && (!self.plan.keep_features || metadata(&self.feature_path(block)).is_ok())
    }

    fn open(&self, block: &Block) -> Result<Vec<RunSink>> {
        let channels = self.plan.experiment.channels;
        let gear_ratio = self.plan.actuator.gear_ratio;
        let sink = |run: &Run| {
            Ok(RunSink {
                recorder: if self.plan.keep_telemetry {
                    let single = self.plan.experiment.sensors.is_some();
                    Some(Recorder::create(
                        &self.run_path(run),
                        &self.plan.provenance(),
                        channels,
                        single,
                    )?)
                } else {
                    None
                },
                noise: match &self.plan.experiment.sensors {
                    Some(model) if self.plan.keep_telemetry => Some(Noise::of_run(model, run.seed, self.rows)),
                    _ => None,
                },
                measured: TelemetryBuffer::new(channels, 512),
                features: self
                    .plan
                    .keep_features
                    .then(|| FeatureSink::new(self.feature_plan.clone(), self.noise.clone())),
                gear_ratio,
            })
        };
        block.runs.iter().map(sink).collect()
    }

    fn commit(&self, block: &Block, sinks: Vec<RunSink>) -> Result<()> {
        let mut rows = Vec::new();
        for (run, sink) in block.runs.iter().zip(sinks) {
            if let Some(r) = sink.recorder {
                r.finish()?;
            }
            if let Some(f) = sink.features {
                rows.push((run, f.result()));
            }
        }
        if self.plan.keep_features {
            write_features(&self.feature_path(block), &self.plan.provenance(), &rows)?;
        }
        Ok(())
    }
}

/// A run, and mean and standard deviation of each of [`RawFeatures::COLUMNS`].
type FeatureRow<'a> = (&'a Run, FeatureValues);

/// Features table of one block.
fn write_features(path: &Path, provenance: &Provenance, rows: &[FeatureRow<'_>]) -> Result<()> {
    let mut fields = vec![Field::new("run", DataType::UInt64, false)];
    let features = RawFeatures::COLUMNS.into_iter().chain(RawFeatures::DEVIATIONS);
    for name in ["fsj", "zeta", "rest_angle_rad"].into_iter().chain(features) {
        fields.push(Field::new(name, DataType::Float64, true));
    }
    let schema = Arc::new(Schema::new(fields));
    let numbers = |f: &dyn Fn(&FeatureRow<'_>) -> Option<f64>| -> ArrayRef {
        Arc::new(rows.iter().map(f).collect::<Float64Array>())
    };
    let mut columns: Vec<ArrayRef> = vec![
        Arc::new(UInt64Array::from_iter_values(rows.iter().map(|(r, _)| r.number))),
        numbers(&|(r, _)| Some(r.lane.fault.fsj)),
        numbers(&|(r, _)| Some(r.lane.fault.zeta)),
        numbers(&|(r, _)| Some(r.lane.rest_angle_rad)),
    ];
    for k in 0..RawFeatures::COUNT {
        columns.push(numbers(&|(_, f)| f[k].0));
    }
    for k in 0..RawFeatures::COUNT {
        columns.push(numbers(&|(_, f)| f[k].0.map(|_| f[k].1)));
    }
    let batch = RecordBatch::try_new(schema, columns).map_err(|e| Error::torn(path, e))?;
    write_table(path, &batch, provenance.pairs())
}

/// Works through a plan into `dir`. `Ok(None)` where it was interrupted; the steps made otherwise.
pub fn generate(plan: &Plan, dir: &Path, title: &str) -> Result<Option<u64>> {
    let folder = Folder::open(dir, &plan.fingerprint(), &plan.description())?;
    let e = &plan.experiment;
    let rows = e.rows();
    let seeds = if plan.keep_features { FEATURE_SEEDS } else { 0 };
    let noise = e
        .sensors
        .as_ref()
        .map(|model| Arc::new(Noise::common(model, seeds, rows)));
    let store = DatasetStore {
        plan,
        runs: if plan.keep_telemetry {
            folder.part("runs")?
        } else {
            PathBuf::new()
        },
        features: if plan.keep_features {
            folder.part("features")?
        } else {
            PathBuf::new()
        },
        feature_plan: Arc::new(FeaturePlan::new(
            &plan.actuator,
            &e.sequence,
            e.rate_hz,
            plan.equivalent_current,
        )),
        noise,
        rows,
    };
    let list = blocks(plan.runs());
    let total = list.iter().map(|b| b.runs.len() as u64).sum();
    let progress = Arc::new(Progress::default());
    // sensors are applied by the sinks, each with its own seeds
    let bare = e.bare(if plan.keep_telemetry {
        e.channels
    } else {
        store.feature_plan.channels()
    });
    let whole = crate::progress::with_bar(title, total, &progress, || work(&bare, &list, &store, &progress))?;
    Ok(whole.then(|| progress.steps.load(std::sync::atomic::Ordering::Relaxed)))
}
