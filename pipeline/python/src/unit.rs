//! The file of one unit.

use crate::actuator::Actuator;
use crate::error::bad;
use crate::json;
use crate::work::long;
use anyhow::Result;
use diagnoser::unit::UnitFile;
use pipeline::case::Settings;
use pipeline::unit::{Beginning, Kinds, begin, show, to_json};
use pyo3::prelude::*;
use sim_worker::catalogue;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::Ordering;

#[pyfunction]
pub fn unit_new<'py>(
    py: Python<'py>,
    unit: PathBuf,
    actuator: Option<&Bound<'_, Actuator>>,
    study: Option<PathBuf>,
    spread: String,
    name: Option<String>,
) -> PyResult<Bound<'py, PyAny>> {
    let actuator = actuator.map(|a| (a.get().parameters.as_ref().clone(), a.get().source()));
    let told = long(py, None, None, move |_| {
        let beginning = Beginning {
            actuator,
            study,
            spread: catalogue::spread(&spread)?,
            name,
        };
        Ok(to_json(&begin(&unit, beginning)?))
    })?;
    json::printed(py, told)
}

#[pyfunction]
#[pyo3(signature = (unit, recordings, healthy, sequence, sensors, grid, progress=None))]
#[allow(clippy::too_many_arguments)]
pub fn unit_update<'py>(
    py: Python<'py>,
    unit: PathBuf,
    recordings: Vec<PathBuf>,
    healthy: bool,
    sequence: Option<String>,
    sensors: String,
    grid: String,
    progress: Option<Py<PyAny>>,
) -> PyResult<Bound<'py, PyAny>> {
    let total = recordings.len() as u64;
    let told = long(py, progress, Some(total), move |state| -> Result<_> {
        if recordings.is_empty() {
            return Err(bad("recordings", "none", "at least one path"));
        }
        let mut of = UnitFile::load(&unit)?;
        let settings = Settings {
            sequence,
            sensors,
            grid: catalogue::grid(&grid)?,
            ..Settings::of_actuator(Arc::new(of.actuator.clone()))?
        };
        let mut kinds = Kinds::default();
        for path in &recordings {
            show(&mut of, path, healthy, &settings, &mut kinds)?;
            // each as it comes: what is done is kept
            of.save(&unit)?;
            state.runs.fetch_add(1, Ordering::Relaxed);
        }
        Ok(to_json(&of))
    })?;
    json::printed(py, told)
}

#[pyfunction]
pub fn unit_show(py: Python<'_>, unit: PathBuf) -> PyResult<Bound<'_, PyAny>> {
    let told = long(py, None, None, move |_| Ok(to_json(&UnitFile::load(&unit)?)))?;
    json::printed(py, told)
}
