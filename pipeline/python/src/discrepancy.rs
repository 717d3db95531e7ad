//! What a model misses against measured data.

use crate::actuator::Actuator;
use crate::json;
use crate::source::Scratch;
use crate::work::long;
use pipeline::discrepancy::{self as study, Request};
use pyo3::prelude::*;
use std::path::PathBuf;

#[pyfunction]
#[pyo3(signature = (bench, model, healthy, verify, out, diagnose, progress=None))]
#[allow(clippy::too_many_arguments)]
pub fn discrepancy<'py>(
    py: Python<'py>,
    bench: Vec<PathBuf>,
    model: Option<&Bound<'py, PyAny>>,
    healthy: bool,
    verify: bool,
    out: Option<PathBuf>,
    diagnose: Vec<PathBuf>,
    progress: Option<Py<PyAny>>,
) -> PyResult<Bound<'py, PyAny>> {
    // an actuator without a file gets one for the time of the study
    let mut text = None;
    let model = match model {
        None => None,
        Some(m) => match m.cast::<Actuator>() {
            Ok(a) => a.get().path.clone().or_else(|| {
                text = Some(a.get().parameters.to_toml());
                None
            }),
            Err(_) => Some(m.extract::<PathBuf>()?),
        },
    };
    let told = long(py, progress, None, move |_| {
        let scratch = text.map(|t| Scratch::with(".toml", t.as_bytes())).transpose()?;
        let request = Request {
            model: model.or_else(|| scratch.as_ref().map(|s| s.path().into())),
            bench,
            healthy,
            verify,
            channels: None,
        };
        let written = study::study(&request, out.as_deref(), &|_| ())?;
        let mut cases = Vec::new();
        for test in &diagnose {
            let case = study::diagnose(&written, test)?;
            cases.extend(case.map(|c| (test.as_path(), c)));
        }
        let cases = (!diagnose.is_empty()).then_some(cases.as_slice());
        Ok(study::to_json(&written.findings, cases))
    })?;
    json::printed(py, told)
}
