//! Maps of rows of features, wherever these come from.

use crate::error::{bad, to_py};
use crate::work::long;
use anyhow::Result;
use diagnoser::calibration::COVERAGE;
use diagnoser::diagnosis::Diagnoser;
use diagnoser::failure_map::{FailureMapSet, MapSetHeader};
use diagnoser::map_library::checked_coverage;
use pipeline::calibrate::of_tests;
use pipeline::maps::{GridFeatures, of_grid};
use pyo3::prelude::*;
use rayon::prelude::*;
use schemas::fault::FaultState;
use schemas::feature::RawFeatures;
use schemas::test_kind::TestKind;
use sim_worker::catalogue;
use std::sync::Mutex;

/// How maps of rows are called in messages.
const ROWS: &str = "X";

/// Failure maps of the rows of a grid, ready to diagnose other rows.
#[pyclass(frozen, module = "ema._ema")]
pub struct FittedMaps {
    names: Vec<String>,
    set: FailureMapSet,
    diagnoser: Mutex<Diagnoser>,
}

/// Lower end, upper end and estimate of FSJ, then of zeta.
type Found = (f64, f64, f64, f64, f64, f64);

/// Outcome, what was found where there is something, and why not in words.
type Told = (String, Option<Found>, String);

/// Raw features of a row; a name that is none was refused before.
fn raw(names: &[String], row: &[f64]) -> RawFeatures {
    let mut values = [None; RawFeatures::COUNT];
    for (name, x) in names.iter().zip(row) {
        if let Some(k) = RawFeatures::COLUMNS.iter().position(|c| c == name) {
            values[k] = Some(*x).filter(|x| x.is_finite());
        }
    }
    RawFeatures::from_values(values, Some(0.0))
}

/// What is fitted.
struct Training {
    fsj: Vec<f64>,
    zeta: Vec<f64>,
    names: Vec<String>,
    rows: Vec<Vec<f64>>,
    deviations: Option<Vec<Vec<f64>>>,
    sequence: String,
    rate_hz: f64,
}

impl Training {
    fn fit(self) -> Result<FittedMaps> {
        let known = RawFeatures::COLUMNS;
        if let Some(n) = self.names.iter().find(|n| !known.contains(&n.as_str())) {
            return Err(bad("features", n, known.join(", ")));
        }
        if self.fsj.len() < 2 || self.zeta.len() < 2 {
            let found = format!("{} x {} fault pairs", self.fsj.len(), self.zeta.len());
            return Err(bad("y", found, "two FSJ and two zeta, or more"));
        }
        let sequence = catalogue::sequence(&self.sequence)?;
        let all = |rows: &[Vec<f64>]| rows.iter().map(|r| raw(&self.names, r)).collect::<Vec<_>>();
        let measured = all(&self.rows);
        let deviations = match &self.deviations {
            Some(rows) => all(rows),
            None => vec![RawFeatures::default(); measured.len()],
        };
        let header = MapSetHeader {
            actuator: "rows".into(),
            sequence: sequence.name.clone(),
            kind: TestKind {
                sequence: sequence.fingerprint(),
                rate_hz: self.rate_hz,
                ..TestKind::default()
            },
            grid: format!("{} x {}", self.fsj.len(), self.zeta.len()),
            step_s: 0.0,
            seed: 0,
            commit: pipeline::COMMIT.into(),
            left_out: Vec::new(),
        };
        let grid = GridFeatures {
            fsj: self.fsj,
            zeta: self.zeta,
            measured,
            deviations,
        };
        let set = of_grid(ROWS, header, &sequence, &grid, true)?;
        Ok(FittedMaps {
            names: self.names,
            diagnoser: Mutex::new(Diagnoser::uncalibrated(set.clone())),
            set,
        })
    }
}

impl FittedMaps {
    fn ready(&self) -> Diagnoser {
        self.diagnoser.lock().unwrap_or_else(|e| e.into_inner()).clone()
    }
}

#[pymethods]
impl FittedMaps {
    /// Maps of rows, zeta outer, FSJ inner.
    #[new]
    #[allow(clippy::too_many_arguments)]
    fn new(
        py: Python<'_>,
        fsj: Vec<f64>,
        zeta: Vec<f64>,
        names: Vec<String>,
        rows: Vec<Vec<f64>>,
        deviations: Option<Vec<Vec<f64>>>,
        sequence: String,
        rate_hz: f64,
    ) -> PyResult<Self> {
        let training = Training {
            fsj,
            zeta,
            names,
            rows,
            deviations,
            sequence,
            rate_hz,
        };
        long(py, None, None, move |_| training.fit())
    }

    /// Names of the features that have maps to locate by.
    #[getter]
    fn features(&self) -> Vec<&'static str> {
        self.set.maps.iter().map(|m| m.feature.name()).collect()
    }

    /// Fixes how far intervals reach by rows of known faults that the maps are not made of.
    fn calibrate(&self, py: Python<'_>, rows: Vec<Vec<f64>>, fsj: Vec<f64>, zeta: Vec<f64>) -> PyResult<()> {
        let (set, names) = (self.set.clone(), self.names.clone());
        let made = long(py, None, None, move |_| {
            let faults = fsj.iter().zip(&zeta).map(|(&fsj, &zeta)| FaultState { fsj, zeta });
            let calibration = of_tests(&set, faults.zip(rows.iter().map(|r| raw(&names, r))))?;
            if calibration.runs == 0 {
                return Err(bad(
                    "X",
                    "no row with every feature",
                    "rows with every feature of the maps",
                ));
            }
            Ok(Diagnoser::new(set, Some(calibration), COVERAGE, &Vec::new())?)
        })?;
        *self.diagnoser.lock().unwrap_or_else(|e| e.into_inner()) = made;
        Ok(())
    }

    /// Diagnoses rows.
    fn diagnose(&self, py: Python<'_>, rows: Vec<Vec<f64>>, coverage: f64) -> PyResult<Vec<Told>> {
        checked_coverage(coverage).map_err(|e| to_py(py, e.into()))?;
        let (ready, names) = (self.ready(), self.names.clone());
        long(py, None, None, move |_| {
            let d = Diagnoser::new(ready.maps, ready.calibration, coverage, &Vec::new())?;
            let one = |row: &Vec<f64>| -> Told {
                let found = d.diagnose(&d.maps.features(&raw(&names, row)), &[]).outcome;
                let area = found.area().map(|a| {
                    let (fsj, zeta) = a.centroid;
                    (a.fsj.lo, a.fsj.hi, fsj, a.zeta.lo, a.zeta.hi, zeta)
                });
                (found.name().into(), area, found.reason().into())
            };
            Ok(rows.par_iter().map(one).collect())
        })
    }
}
