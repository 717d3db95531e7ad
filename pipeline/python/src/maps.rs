//! Failure maps of an actuator.

use crate::actuator::{Actuator, or_reference};
use crate::error::{bad, to_py};
use crate::run::Described;
use crate::sweep::grid_of;
use crate::table::Table;
use crate::work::long;
use anyhow::Result;
use diagnoser::failure_map::FailureMapSet;
use diagnoser::map_library::{Choice, file_for, rounded_rest_angle};
use pipeline::MapRequest;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use sim_worker::catalogue;
use std::path::{Path, PathBuf};

/// Failure maps of one actuator, sequence, rate, sensor model and rest angle, in a file.
#[pyclass(frozen, module = "ema")]
pub struct Maps {
    set: FailureMapSet,
    /// where they lie, with their calibrations beside them
    pub file: PathBuf,
}

/// Calibrations beside a file of maps.
fn calibrations(file: &Path) -> Vec<PathBuf> {
    let entries = file.parent().and_then(|dir| std::fs::read_dir(dir).ok());
    let is_one = |p: &PathBuf| {
        let name = p
            .file_name()
            .map(|n| n.to_string_lossy().into_owned())
            .unwrap_or_default();
        name.starts_with("calibration-") && name.ends_with(".json")
    };
    let mut found: Vec<PathBuf> = entries
        .into_iter()
        .flatten()
        .flatten()
        .map(|e| e.path())
        .filter(is_one)
        .collect();
    found.sort();
    found
}

impl Maps {
    fn load_from(place: PathBuf) -> Result<Self> {
        let file = file_for(&place);
        let set = FailureMapSet::load(&file)?;
        Ok(Self { set, file })
    }

    fn save_to(&self, place: PathBuf) -> Result<()> {
        let file = file_for(&place);
        let dir = file.parent().unwrap_or(Path::new("."));
        let failed = |e| schemas::error::Error::io(&file, "cannot be written", e);
        std::fs::create_dir_all(dir).map_err(failed)?;
        self.set.save(&file)?;
        for c in calibrations(&self.file) {
            if let Some(name) = c.file_name() {
                let bytes = std::fs::read(&c).map_err(|e| schemas::error::Error::io(&c, "cannot be read", e))?;
                schemas::error::write_whole(&dir.join(name), &bytes)?;
            }
        }
        Ok(())
    }
}

#[pymethods]
impl Maps {
    /// Maps that were saved, by this package or by `ema maps`: a folder with maps.parquet, or the file.
    #[staticmethod]
    fn load(py: Python<'_>, path: PathBuf) -> PyResult<Self> {
        py.detach(|| Self::load_from(path)).map_err(|e| to_py(py, e))
    }

    /// Writes maps.parquet into a folder, and the calibrations that belong to it beside it.
    fn save(&self, py: Python<'_>, path: PathBuf) -> PyResult<()> {
        py.detach(|| self.save_to(path)).map_err(|e| to_py(py, e))
    }

    /// The file that they lie in.
    #[getter]
    fn path(&self) -> PathBuf {
        self.file.clone()
    }

    /// Names of the features that have maps to locate by.
    #[getter]
    fn features(&self) -> Vec<&'static str> {
        self.set.maps.iter().map(|m| m.feature.name()).collect()
    }

    /// Features that are not monotone enough for a map, and where.
    #[getter]
    fn left_out(&self) -> Vec<String> {
        self.set.header.left_out.clone()
    }

    /// What they are for.
    #[getter]
    fn header<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let (h, k) = (&self.set.header, &self.set.header.kind);
        let out = PyDict::new(py);
        out.set_item("actuator", &h.actuator)?;
        out.set_item("parameters", &k.parameters)?;
        out.set_item("sequence", &h.sequence)?;
        out.set_item("rate_hz", k.rate_hz)?;
        out.set_item("sensors", &k.sensors)?;
        out.set_item("rest_angle_rad", k.rest_angle_rad)?;
        out.set_item("load_n_m", k.load_n_m)?;
        out.set_item("grid", &h.grid)?;
        out.set_item("seed", h.seed)?;
        Ok(out)
    }

    /// Every point of every map: feature, fsj, zeta, value (freed of scatter, monotone), raw_value (as simulated), as in
    /// maps.parquet.
    fn table(&self) -> PyResult<Table> {
        let rows = self.set.rows();
        Ok(Table::of(rows.map_err(|e| {
            pyo3::exceptions::PyRuntimeError::new_err(e.to_string())
        })?))
    }

    fn __repr__(&self) -> String {
        let h = &self.set.header;
        let features = self.features().join(", ");
        format!("<ema.Maps of {:?}, {}: {features}>", h.actuator, h.sequence)
    }
}

#[pyfunction]
#[pyo3(signature = (actuator, fsj, zeta, sequence, rate_hz, sensors, rest_angle_deg, spread, progress=None))]
#[allow(clippy::too_many_arguments)]
pub fn maps(
    py: Python<'_>,
    actuator: Option<&Bound<'_, Actuator>>,
    fsj: Vec<f64>,
    zeta: Vec<f64>,
    sequence: String,
    rate_hz: f64,
    sensors: String,
    rest_angle_deg: f64,
    spread: String,
    progress: Option<Py<PyAny>>,
) -> PyResult<Maps> {
    let described = Described {
        actuator: or_reference(actuator),
        sequence,
        rate_hz,
        sensors,
        rest_angle_deg,
        load_n_m: 0.0,
    };
    long(py, progress, None, move |_| {
        let mut setup = described.setup()?;
        // as for a recording: maps lie on the counts of a resolver
        setup.rest_angle_rad = rounded_rest_angle(setup.rest_angle_rad);
        let spread = match spread.as_str() {
            "own" => pipeline::case::own_spread(Some(&setup.actuator)),
            name => catalogue::spread(name)?,
        };
        let choice = Choice {
            spread,
            ..Choice::usual()
        };
        let request = MapRequest {
            setup,
            grid: grid_of(&fsj, &zeta)?,
        };
        let set = pipeline::maps::cached(&request, &choice, &Vec::new())?.maps;
        let file = pipeline::maps::cache_file(&request)?;
        Ok(Maps { set, file })
    })
}

/// The file of maps that is given as an object, or as a path.
pub fn place_of(given: Option<&Bound<'_, PyAny>>) -> PyResult<Option<PathBuf>> {
    let Some(given) = given else { return Ok(None) };
    if let Ok(maps) = given.cast::<Maps>() {
        return Ok(Some(maps.get().file.clone()));
    }
    match given.extract::<PathBuf>() {
        Ok(path) => Ok(Some(path)),
        Err(_) => Err(to_py(given.py(), bad("maps", given.get_type(), "ema.Maps, or a path"))),
    }
}
