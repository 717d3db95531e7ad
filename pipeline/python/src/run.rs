//! One run of the test bench.

use crate::actuator::{Actuator, or_reference};
use crate::error::{bad, to_py};
use crate::table::Table;
use crate::work::long;
use anyhow::Result;
use arrow::array::RecordBatch;
use pipeline::one_run::{Model, OneRun};
use pyo3::prelude::*;
use schemas::channel::ChannelSet;
use schemas::fault::FaultState;
use schemas::recording::{Provenance, telemetry_batch, telemetry_schema};
use schemas::telemetry::Collector;
use sim_worker::catalogue;
use sim_worker::parameters::ActuatorParameters;
use sim_worker::setup::TestSetup;
use std::collections::HashMap;
use std::sync::Arc;
use std::sync::atomic::Ordering;

/// A finite number among the arguments.
fn finite(what: &str, x: f64) -> Result<f64> {
    if x.is_finite() {
        Ok(x)
    } else {
        Err(bad(what, x, "a finite number"))
    }
}

/// The test that arguments describe.
pub struct Described {
    pub actuator: Arc<ActuatorParameters>,
    pub sequence: String,
    pub rate_hz: f64,
    pub sensors: String,
    pub rest_angle_deg: f64,
    pub load_n_m: f64,
}

impl Described {
    pub fn setup(self) -> Result<TestSetup> {
        Ok(TestSetup {
            sensors: catalogue::sensors(&self.sensors)?,
            rest_angle_rad: finite("rest_angle_deg", self.rest_angle_deg)?.to_radians(),
            load_n_m: finite("load_n_m", self.load_n_m)?,
            ..TestSetup::new(self.actuator, catalogue::sequence(&self.sequence)?, self.rate_hz)
        })
    }
}

/// Samples of a run as a table of telemetry.
pub fn table_of(
    samples: &Collector,
    channels: ChannelSet,
    single: bool,
    rate_hz: f64,
    about: &Provenance,
) -> Result<RecordBatch> {
    let schema = telemetry_schema(channels, single).with_metadata(about.pairs().into_iter().collect::<HashMap<_, _>>());
    let header = samples
        .header
        .as_ref()
        .ok_or_else(|| bad("sequence", "no sample", "one sample or more"))?;
    let batch = telemetry_batch(&Arc::new(schema), rate_hz, header, &samples.view());
    batch.map_err(anyhow::Error::msg)
}

#[pyfunction]
#[pyo3(signature = (actuator, fsj, zeta, sequence, rate_hz, sensors, rest_angle_deg, load_n_m, seed, channels, model, progress=None))]
#[allow(clippy::too_many_arguments)]
pub fn run(
    py: Python<'_>,
    actuator: Option<&Bound<'_, Actuator>>,
    fsj: f64,
    zeta: f64,
    sequence: String,
    rate_hz: f64,
    sensors: String,
    rest_angle_deg: f64,
    load_n_m: f64,
    seed: u64,
    channels: Vec<String>,
    model: String,
    progress: Option<Py<PyAny>>,
) -> PyResult<Table> {
    let described = Described {
        actuator: or_reference(actuator),
        sequence,
        rate_hz,
        sensors,
        rest_angle_deg,
        load_n_m,
    };
    let fault = FaultState::new(fsj, zeta).map_err(|(place, x, allowed)| to_py(py, bad(place, x, allowed)))?;
    let table = long(py, progress, Some(1), move |state| {
        let run = OneRun::new(described.setup()?, fault, Model::named(&model)?, seed, &channels)?;
        let mut samples = Collector::default();
        run.simulate_into(&mut samples, || !state.stop.load(Ordering::Relaxed))?;
        state.runs.store(1, Ordering::Relaxed);
        table_of(&samples, run.channels, run.is_sensed(), rate_hz, &run.provenance())
    })?;
    Ok(Table::of(table))
}
