//! A grid of faults on all cores.

use crate::actuator::{Actuator, or_reference};
use crate::error::to_py;
use crate::run::{Described, table_of};
use crate::table::Table;
use crate::work::long;
use anyhow::Result;
use arrow::array::{ArrayRef, Float64Array, RecordBatch, UInt64Array};
use arrow::datatypes::{DataType, Field, Schema};
use pipeline::{COMMIT, Interrupted};
use pyo3::prelude::*;
use rayon::prelude::*;
use schemas::channel::ChannelSet;
use schemas::fault::{FaultGrid, FaultState};
use schemas::feature::{Feature, Raw, RawFeatures};
use schemas::recording::{Provenance, telemetry_schema};
use schemas::telemetry::{Collector, TelemetryBuffer, TelemetryHeader, TelemetrySink, TelemetryView};
use schemas::toml_section;
use sim_worker::catalogue;
use sim_worker::dataset::one::OneActuator;
use sim_worker::dataset::plan::DatasetPlan;
use sim_worker::dataset::sink::with_sources;
use sim_worker::extractor::FeaturePlan;
use sim_worker::noise::{FeatureSink, FeatureValues, Noise};
use sim_worker::progress::Progress;
use sim_worker::setup::TestSetup;
use sim_worker::simulate::{LANES, Run, simulate};
use std::collections::HashMap;
use std::sync::Arc;
use std::sync::atomic::Ordering;

/// Samples of one run, as its sensors give them.
struct Kept {
    samples: Collector,
    noise: Option<Noise>,
    measured: TelemetryBuffer,
    gear_ratio: f64,
    channels: ChannelSet,
}

/// Features of one run, and its samples where they are wanted.
struct Sink {
    features: FeatureSink,
    kept: Option<Kept>,
}

impl TelemetrySink for Sink {
    fn accept(&mut self, header: &TelemetryHeader, view: &TelemetryView<'_>) -> schemas::error::Result<()> {
        self.features.push(header, view);
        let Some(k) = &mut self.kept else { return Ok(()) };
        // only what is wanted of what was simulated
        let wanted = TelemetryHeader {
            channels: k.channels,
            ..header.clone()
        };
        match &k.noise {
            None => k.samples.accept(&wanted, view),
            Some(noise) => {
                noise.measure(header, k.gear_ratio, view, &mut k.measured);
                k.samples.accept(&wanted, &k.measured.view())
            }
        }
    }
}

/// What a sweep simulates.
#[derive(Clone, Copy)]
struct Sweep<'a> {
    setup: &'a TestSetup,
    plan: &'a DatasetPlan,
    seed: u64,
    /// channels whose samples are wanted
    kept: Option<ChannelSet>,
}

/// What a run leaves.
struct Left {
    fault: FaultState,
    features: FeatureValues,
    samples: Option<RecordBatch>,
}

impl Sweep<'_> {
    /// All runs of the grid, in its order. `Ok(None)` where it was stopped.
    fn simulate(&self, state: &Progress) -> Result<Option<Vec<Left>>> {
        let plan = self.plan;
        let features = Arc::new(self.setup.feature_plan());
        let rows = plan.rows(0);
        let common = |model| Arc::new(Noise::common(model, plan.feature_seeds, rows));
        let noise = self.setup.sensors.as_ref().map(common);
        let mut channels = FeaturePlan::wanted_of(&self.setup.sequence, self.setup.equivalent_current);
        if let Some(kept) = self.kept {
            channels = ChannelSet(channels.0 | with_sources(kept, self.setup.sensors.is_some()).0);
        }
        // the sensors come after: features are averaged over seeds of their noise
        let experiment = TestSetup {
            sensors: None,
            ..self.setup.clone()
        }
        .experiment(channels)?;
        let parts = plan.parts();
        let runs: Vec<Run> = parts
            .iter()
            .flat_map(|p| p.runs.clone().map(|r| plan.run(p, r)))
            .collect();
        let go_on = || !state.stop.load(Ordering::Relaxed);
        let block = |runs: &[Run]| -> Result<Option<Vec<Left>>> {
            let sink = |run: &Run| Sink {
                features: FeatureSink::new(features.clone(), noise.clone()),
                kept: self.kept.map(|channels| Kept {
                    samples: Collector::default(),
                    noise: self
                        .setup
                        .sensors
                        .as_ref()
                        .map(|model| Noise::of_run(model, run.seed, rows)),
                    measured: TelemetryBuffer::new(with_sources(channels, true), 128),
                    gear_ratio: run.lane.actuator.gear_ratio,
                    channels,
                }),
            };
            let mut sinks: Vec<Sink> = runs.iter().map(sink).collect();
            if !go_on() || simulate(&experiment, runs, &mut sinks, go_on)?.is_none() {
                return Ok(None);
            }
            state.runs.fetch_add(runs.len() as u64, Ordering::Relaxed);
            let left = |(run, sink): (&Run, Sink)| self.left(run, sink);
            runs.iter().zip(sinks).map(left).collect::<Result<Vec<_>>>().map(Some)
        };
        let blocks: Vec<Option<Vec<Left>>> = runs.par_chunks(LANES).map(block).collect::<Result<_>>()?;
        Ok(blocks
            .into_iter()
            .collect::<Option<Vec<_>>>()
            .map(|b| b.into_iter().flatten().collect()))
    }

    fn left(&self, run: &Run, sink: Sink) -> Result<Left> {
        let single = self.setup.sensors.is_some();
        let samples = sink
            .kept
            .map(|k| table_of(&k.samples, k.channels, single, self.setup.rate_hz, &self.about()));
        Ok(Left {
            fault: run.lane.fault,
            features: sink.features.result(),
            samples: samples.transpose()?,
        })
    }

    fn about(&self) -> Provenance {
        Provenance {
            grid: self.plan.grid.fingerprint(),
            ..self.setup.provenance(self.seed, COMMIT)
        }
    }

    /// The table of features: faults, what is formed over the healthy run, what was measured, its standard deviation
    /// over the seeds of the noise.
    fn table(&self, runs: &[Left], nominal: &RawFeatures) -> Result<RecordBatch> {
        let number = |n: &str| Field::new(n, DataType::Float64, true);
        let with =
            |n: &str, unit: &str| number(n).with_metadata(HashMap::from([("unit".to_string(), unit.to_string())]));
        let column =
            |f: &dyn Fn(&Left) -> Option<f64>| -> ArrayRef { Arc::new(runs.iter().map(f).collect::<Float64Array>()) };
        let mut fields = vec![Field::new("run", DataType::UInt64, false)];
        let mut columns: Vec<ArrayRef> = vec![Arc::new(UInt64Array::from_iter_values(0..runs.len() as u64))];
        let mut add = |field: Field, values: ArrayRef| {
            fields.push(field);
            columns.push(values);
        };
        add(with("fsj", "-"), column(&|l| Some(l.fault.fsj)));
        add(with("zeta", "-"), column(&|l| Some(l.fault.zeta)));
        let rest = self.setup.rest_angle_rad;
        add(with("rest_angle_rad", "rad"), column(&|_| Some(rest)));
        for f in Feature::over_nominal() {
            let of = |l: &Left| f.value(&raw(l), nominal);
            add(with(f.key(), f.unit()), column(&of));
        }
        for (k, name) in RawFeatures::COLUMNS.into_iter().enumerate() {
            add(with(name, unit_of(k)), column(&|l| l.features[k].0));
        }
        for (k, name) in RawFeatures::DEVIATIONS.into_iter().enumerate() {
            let of = |l: &Left| l.features[k].0.map(|_| l.features[k].1);
            add(with(name, unit_of(k)), column(&of));
        }
        let schema = Schema::new(fields).with_metadata(self.about().pairs().into_iter().collect::<HashMap<_, _>>());
        Ok(RecordBatch::try_new(Arc::new(schema), columns)?)
    }
}

/// Unit of a raw feature: that of the feature which is it.
fn unit_of(k: usize) -> &'static str {
    let same = |f: &Feature| f.form() == schemas::feature::Form::Same(Raw::ALL[k]);
    // the mean speed is told as its loss alone
    Feature::TABLE.into_iter().find(same).map_or("rad/s", Feature::unit)
}

fn raw(l: &Left) -> RawFeatures {
    RawFeatures::from_values(l.features.map(|x| x.0), None)
}

/// A grid of faults from its lines.
pub fn grid_of(fsj: &[f64], zeta: &[f64]) -> Result<FaultGrid> {
    let text = format!("name = \"arguments\"\nfsj = {fsj:?}\nzeta = {zeta:?}\n");
    Ok(catalogue::grid_from(toml_section::parse("arguments", &text)?)?)
}

/// The lines of a built-in grid, or of one in a TOML file.
#[pyfunction]
pub fn grid(py: Python<'_>, name: &str) -> PyResult<(Vec<f64>, Vec<f64>)> {
    let grid = catalogue::grid(name).map_err(|e| to_py(py, e.into()))?;
    Ok((grid.fsj, grid.zeta))
}

#[pyfunction]
#[pyo3(signature = (actuator, fsj, zeta, sequence, rate_hz, sensors, rest_angle_deg, load_n_m, seed, telemetry, progress=None))]
#[allow(clippy::too_many_arguments)]
pub fn sweep(
    py: Python<'_>,
    actuator: Option<&Bound<'_, Actuator>>,
    fsj: Vec<f64>,
    zeta: Vec<f64>,
    sequence: String,
    rate_hz: f64,
    sensors: String,
    rest_angle_deg: f64,
    load_n_m: f64,
    seed: u64,
    telemetry: Option<Vec<String>>,
    progress: Option<Py<PyAny>>,
) -> PyResult<(Table, Option<Table>)> {
    let described = Described {
        actuator: or_reference(actuator),
        sequence,
        rate_hz,
        sensors,
        rest_angle_deg,
        load_n_m,
    };
    let total = (fsj.len() * zeta.len()) as u64;
    long(py, progress, Some(total), move |state| {
        let setup = described.setup()?;
        let grid = grid_of(&fsj, &zeta)?;
        let kept = telemetry.map(|names| catalogue::channels(&names)).transpose()?;
        // refuses a rate that no step serves
        setup.experiment(ChannelSet::basic())?;
        let plan_of = |grid: &FaultGrid| {
            DatasetPlan::of_one(&OneActuator {
                setup: &setup,
                grid,
                rest_angles_rad: &[],
                seed,
                telemetry: None,
            })
        };
        let plan = plan_of(&grid)?;
        let sweep = Sweep {
            setup: &setup,
            plan: &plan,
            seed,
            kept,
        };
        let mut runs = sweep.simulate(state)?.ok_or(Interrupted)?;
        let nominal = match runs.iter().find(|l| l.fault == FaultState::NOMINAL) {
            Some(healthy) => raw(healthy),
            None => {
                // beside the grid: features are formed over it
                let plan = plan_of(&grid_of(&[1.0], &[0.0])?)?;
                let alone = Sweep {
                    plan: &plan,
                    kept: None,
                    ..sweep
                };
                raw(&alone.simulate(&Progress::default())?.ok_or(Interrupted)?[0])
            }
        };
        let features = Table::of(sweep.table(&runs, &nominal)?);
        let samples = kept.map(|channels| {
            let about: HashMap<_, _> = sweep.about().pairs().into_iter().collect();
            let schema = telemetry_schema(channels, setup.sensors.is_some()).with_metadata(about);
            let batches = runs.iter_mut().filter_map(|l| l.samples.take()).collect();
            Table::new(Arc::new(schema), batches)
        });
        Ok((features, samples))
    })
}
