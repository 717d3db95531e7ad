//! Parameters of an actuator.

use crate::error::to_py;
use pyo3::exceptions::PyAttributeError;
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyTuple};
use sim_worker::parameters::ActuatorParameters;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Parameters of one actuator; SI units, motor side unless a name says otherwise. It does not change: `with_` makes
/// another one.
#[pyclass(frozen, module = "ema")]
pub struct Actuator {
    pub parameters: Arc<ActuatorParameters>,
    /// the file that it is from
    pub path: Option<PathBuf>,
}

impl Actuator {
    /// Where it is from, in words.
    pub fn source(&self) -> String {
        let name = || format!("actuator `{}`", self.parameters.name);
        self.path.as_ref().map_or_else(name, |p| p.display().to_string())
    }
}

/// The one that is given, or the reference.
pub fn or_reference(given: Option<&Bound<'_, Actuator>>) -> Arc<ActuatorParameters> {
    let reference = || Arc::new(ActuatorParameters::reference());
    given.map_or_else(reference, |a| a.get().parameters.clone())
}

#[pymethods]
impl Actuator {
    /// The reference actuator; all its values are assumed.
    #[new]
    fn new() -> Self {
        Self {
            parameters: Arc::new(ActuatorParameters::reference()),
            path: None,
        }
    }

    /// An actuator from a TOML file, or from the text of one (which has more than one line).
    #[staticmethod]
    fn from_toml(py: Python<'_>, path_or_text: &Bound<'_, PyAny>) -> PyResult<Self> {
        let text: Option<String> = path_or_text.extract().ok();
        let (read, path) = match text.filter(|t| t.contains('\n')) {
            Some(text) => (ActuatorParameters::parse("text", &text), None),
            None => {
                let path: PathBuf = path_or_text.extract()?;
                (ActuatorParameters::read(Path::new(&path)), Some(path))
            }
        };
        let parameters = read.map_err(|e| to_py(py, e.into()))?;
        Ok(Self {
            parameters: Arc::new(parameters),
            path,
        })
    }

    /// A file that reads back as this actuator, bit for bit; comments are not kept.
    fn to_toml(&self) -> String {
        self.parameters.to_toml()
    }

    /// For messages and files.
    #[getter]
    fn name(&self) -> &str {
        &self.parameters.name
    }

    /// Of every value, not of the name: 16 hexadecimal digits.
    #[getter]
    fn fingerprint(&self) -> String {
        self.parameters.fingerprint()
    }

    /// All parameters by name, as numbers. Each is an attribute, too.
    #[getter]
    fn parameters<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let out = PyDict::new(py);
        for (name, _, x) in self.parameters.parameters() {
            out.set_item(name, x)?;
        }
        Ok(out)
    }

    /// Units of all parameters by name; `-` for a ratio.
    #[getter]
    fn units<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let out = PyDict::new(py);
        for (name, unit, _) in self.parameters.parameters() {
            out.set_item(name, unit)?;
        }
        Ok(out)
    }

    /// Names of the physical effects beyond the paper's that it has.
    #[getter]
    fn effects(&self) -> Vec<&'static str> {
        self.parameters.effects.iter().map(|e| e.kind.name()).collect()
    }

    /// The same with other values: `name`, and parameters by name.
    #[pyo3(signature = (**changes))]
    fn with_(&self, py: Python<'_>, changes: Option<&Bound<'_, PyDict>>) -> PyResult<Self> {
        let (mut name, mut numbers) = (None, Vec::new());
        for (key, value) in changes.into_iter().flat_map(|c| c.iter()) {
            let key: String = key.extract()?;
            if key == "name" {
                name = Some(value.extract::<String>()?);
            } else {
                numbers.push((key, value.extract::<f64>()?));
            }
        }
        let list: Vec<(&str, f64)> = numbers.iter().map(|(k, x)| (k.as_str(), *x)).collect();
        let mut parameters = self.parameters.with(&list).map_err(|e| to_py(py, e.into()))?;
        if let Some(name) = name {
            parameters.name = name;
        }
        Ok(Self {
            parameters: Arc::new(parameters),
            path: None,
        })
    }

    fn __getattr__(&self, name: &str) -> PyResult<f64> {
        let found = self.parameters.parameters().find(|p| p.0 == name).map(|p| p.2);
        found.ok_or_else(|| PyAttributeError::new_err(format!("an actuator has no parameter `{name}`")))
    }

    fn __dir__(&self) -> Vec<&'static str> {
        let own = [
            "effects",
            "fingerprint",
            "from_toml",
            "name",
            "parameters",
            "to_toml",
            "units",
            "with_",
        ];
        own.into_iter()
            .chain(self.parameters.parameters().map(|p| p.0))
            .collect()
    }

    fn __repr__(&self) -> String {
        format!(
            "<ema.Actuator {:?} {}>",
            self.parameters.name,
            self.parameters.fingerprint()
        )
    }

    fn __eq__(&self, other: &Bound<'_, PyAny>) -> bool {
        other
            .cast::<Actuator>()
            .is_ok_and(|o| *o.get().parameters == *self.parameters)
    }

    fn __hash__(&self) -> u64 {
        u64::from_str_radix(&self.parameters.fingerprint(), 16).unwrap_or(0)
    }

    /// For processes of their own.
    fn __reduce__<'py>(slf: &Bound<'py, Self>) -> PyResult<(Bound<'py, PyAny>, Bound<'py, PyTuple>)> {
        let py = slf.py();
        let make = py.get_type::<Actuator>().getattr("from_toml")?;
        Ok((make, PyTuple::new(py, [slf.get().to_toml()])?))
    }
}
