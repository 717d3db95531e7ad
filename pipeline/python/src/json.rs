//! JSON as objects of Python.

use diagnoser::report::versioned;
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyList};
use serde_json::Value;

/// What a command of the program prints: an object, or a list of them, with the version of their keys.
pub fn printed<'py>(py: Python<'py>, value: Value) -> PyResult<Bound<'py, PyAny>> {
    let value = match value {
        Value::Array(all) => all.into_iter().map(versioned).collect(),
        one => versioned(one),
    };
    to_py(py, &value)
}

/// The object that `json.loads` makes of the same text.
pub fn to_py<'py>(py: Python<'py>, value: &Value) -> PyResult<Bound<'py, PyAny>> {
    Ok(match value {
        Value::Null => py.None().into_bound(py),
        Value::Bool(b) => b.into_pyobject(py)?.to_owned().into_any(),
        Value::Number(n) => match (n.as_i64(), n.as_u64()) {
            (Some(i), _) => i.into_pyobject(py)?.into_any(),
            (_, Some(u)) => u.into_pyobject(py)?.into_any(),
            _ => n.as_f64().unwrap_or(f64::NAN).into_pyobject(py)?.into_any(),
        },
        Value::String(s) => s.into_pyobject(py)?.into_any(),
        Value::Array(list) => {
            let out = PyList::empty(py);
            for v in list {
                out.append(to_py(py, v)?)?;
            }
            out.into_any()
        }
        Value::Object(map) => {
            let out = PyDict::new(py);
            for (k, v) in map {
                out.set_item(k, to_py(py, v)?)?;
            }
            out.into_any()
        }
    })
}
