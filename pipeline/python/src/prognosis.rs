//! From diagnoses over time to the time that is left.

use crate::actuator::Actuator;
use crate::error::bad;
use crate::json;
use crate::source::Source;
use crate::work::long;
use anyhow::Result;
use pipeline::prognosis::wanted::{Wanted, fleets_of, foretell, written};
use pipeline::prognosis::words::to_json;
use pipeline::prognosis::{Clock, Told};
use pyo3::prelude::*;
use serde_json::Value;
use std::path::PathBuf;

fn clock_of(name: Option<&str>) -> Result<Option<Clock>> {
    let all = [Clock::Flight, Clock::Cycle, Clock::Hour, Clock::Day];
    let Some(name) = name else { return Ok(None) };
    let found = all.into_iter().find(|c| c.name() == name);
    let allowed = || all.map(Clock::name).join(", ");
    found.map(Some).ok_or_else(|| bad("clock", name, allowed()))
}

#[pyfunction]
#[pyo3(signature = (history, thresholds, actuator, fleet, risk, horizon, clock, events, column, healthy, out, samples, progress=None))]
#[allow(clippy::too_many_arguments)]
pub fn prognosis<'py>(
    py: Python<'py>,
    history: &Bound<'py, PyAny>,
    thresholds: Vec<String>,
    actuator: Option<&Bound<'_, Actuator>>,
    fleet: Option<PathBuf>,
    risk: f64,
    horizon: Option<f64>,
    clock: Option<String>,
    events: Option<PathBuf>,
    column: Option<String>,
    healthy: Option<f64>,
    out: Option<PathBuf>,
    samples: bool,
    progress: Option<Py<PyAny>>,
) -> PyResult<Bound<'py, PyAny>> {
    let source = Source::of(history)?;
    let actuator = actuator.map(|a| a.get().parameters.clone());
    let told = long(py, progress, None, move |_| {
        // what the command line checks by itself
        if !(1e-4..=0.5).contains(&risk) {
            return Err(bad("risk", risk, "a probability from 0.0001 to 0.5"));
        }
        if let Some(h) = horizon.filter(|h| !(h.is_finite() && *h > 0.0)) {
            return Err(bad("horizon", h, "a number above 0"));
        }
        let wanted = Wanted {
            threshold: thresholds,
            actuator,
            clock: clock_of(clock.as_deref())?,
            events,
            column,
            healthy,
        };
        let fleets = fleets_of(fleet.as_deref())?;
        let placed = source.place()?;
        let told = foretell(placed.path(), &wanted, &fleets, risk, horizon).map_err(|e| placed.renamed(e))?;
        if let Some(dir) = &out {
            written(dir, &told, &fleets)?;
        }
        let one = |t: &Told| {
            let mut json = to_json(t);
            if samples {
                // beyond the horizon: null, since JSON has no infinity
                let times = t.outlook.left.as_ref().map_or(&[][..], |l| &l.times);
                json["samples"] = times.iter().map(|x| x.is_finite().then_some(*x)).collect();
            }
            json
        };
        Ok(Value::Array(told.iter().map(one).collect()))
    })?;
    json::printed(py, told)
}
