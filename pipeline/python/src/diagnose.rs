//! Diagnosis of one recording.

use crate::actuator::Actuator;
use crate::json;
use crate::maps::place_of;
use crate::source::Source;
use crate::work::long;
use anyhow::Result;
use diagnoser::diagnosis::Outcome;
use diagnoser::map_library::Choice;
use diagnoser::unit::UnitFile;
use pipeline::case::{self, Settings};
use pipeline::refine;
use pyo3::prelude::*;
use serde_json::Value;
use sim_worker::catalogue;
use std::path::PathBuf;
use std::sync::Arc;

/// How a recording is diagnosed, as arguments have it.
struct Asked {
    spread: String,
    coverage: f64,
    method: String,
    refine: bool,
    unit: Option<PathBuf>,
    /// file of the actuator
    actuator: Option<PathBuf>,
}

fn work(source: Source, mut settings: Settings, asked: &Asked) -> Result<Value> {
    let spread = match asked.spread.as_str() {
        "own" => case::own_spread(settings.actuator.as_deref()),
        name => catalogue::spread(name)?,
    };
    settings.choice = Choice::new(spread, asked.coverage)?;
    settings.unit = asked.unit.as_deref().map(UnitFile::load).transpose()?.map(Arc::new);
    let placed = source.place()?;
    let mut case = case::run(placed.path(), &settings).map_err(|e| placed.renamed(e))?;
    if asked.method == "paper" {
        case.by_paper();
    }
    let refined = match asked.refine {
        true => Some(refine::of_case(&case, &settings)?),
        false => None,
    };
    let unexplained = matches!(case.diagnosis.outcome, Outcome::Unexplained { .. });
    let next = unexplained.then(|| {
        let unit = settings.unit.as_deref().zip(asked.unit.as_deref());
        let (command, _) = case::next_command(placed.path(), &case, unit, asked.actuator.as_deref(), None);
        command.map(|c| placed.named(&c))
    });
    let next = next.flatten();
    Ok(case::to_json(
        &case,
        settings.unit.as_deref(),
        refined.as_ref(),
        next.as_deref(),
    ))
}

#[pyfunction]
#[pyo3(signature = (recording, actuator, maps, unit, coverage, spread, known, run, sequence, sensors, grid, method, refine, progress=None))]
#[allow(clippy::too_many_arguments)]
pub fn diagnose<'py>(
    py: Python<'py>,
    recording: &Bound<'py, PyAny>,
    actuator: Option<&Bound<'_, Actuator>>,
    maps: Option<&Bound<'_, PyAny>>,
    unit: Option<PathBuf>,
    coverage: f64,
    spread: String,
    known: Vec<String>,
    run: Option<u64>,
    sequence: Option<String>,
    sensors: String,
    grid: String,
    method: String,
    refine: bool,
    progress: Option<Py<PyAny>>,
) -> PyResult<Bound<'py, PyAny>> {
    let source = Source::of(recording)?;
    let maps = place_of(maps)?;
    let parameters = actuator.map(|a| a.get().parameters.clone());
    let asked = Asked {
        spread,
        coverage,
        method,
        refine,
        unit,
        actuator: actuator.and_then(|a| a.get().path.clone()),
    };
    let told = long(py, progress, None, move |_| {
        let settings = Settings {
            actuator: parameters,
            maps,
            run,
            sequence,
            channels: None,
            sensors,
            grid: catalogue::grid(&grid)?,
            choice: Choice::usual(),
            known,
            unit: None,
        };
        work(source, settings, &asked)
    })?;
    json::printed(py, told)
}
