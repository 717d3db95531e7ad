//! Refusals as exceptions of Python.

use pipeline::Interrupted;
use pyo3::create_exception;
use pyo3::exceptions::{PyFileNotFoundError, PyKeyboardInterrupt, PyOSError, PyRuntimeError, PyValueError};
use pyo3::prelude::*;
use schemas::error::Error;
use schemas::foreign;
use std::path::Path;

create_exception!(
    ema,
    InputError,
    PyValueError,
    "Something from outside is not allowed.\n\nAttributes: `file` (file, object or `arguments`), `place` (key, column, line or argument), `found` and \
     `allowed`, all texts."
);

/// In place of the command line, which Python has none of.
const ARGUMENTS: &str = "arguments";

/// An option of the command line as the argument that it is in Python.
fn argument(place: &str) -> String {
    match place.strip_prefix("--") {
        Some(option) => option.replace('-', "_"),
        None => place.into(),
    }
}

fn refused(py: Python<'_>, file: &str, place: &str, found: &str, allowed: &str, words: String) -> PyErr {
    let e = InputError::new_err(words);
    let value = e.value(py);
    for (name, text) in [("file", file), ("place", place), ("found", found), ("allowed", allowed)] {
        if let Err(e) = value.setattr(name, text) {
            return e;
        }
    }
    e
}

/// A refusal of something that has no file: the arguments of a call.
pub fn bad(place: &str, found: impl std::fmt::Display, allowed: impl Into<String>) -> anyhow::Error {
    Error::bad(ARGUMENTS, place, found, allowed).into()
}

/// The exception that stands for an error.
pub fn to_py(py: Python<'_>, e: anyhow::Error) -> PyErr {
    if e.is::<Interrupted>() {
        return PyKeyboardInterrupt::new_err(());
    }
    match e.downcast_ref::<Error>() {
        Some(Error::Bad {
            file,
            place,
            found,
            allowed,
        }) => {
            let outside = file == "command line";
            let (file, place) = match outside {
                true => (ARGUMENTS.to_string(), argument(place)),
                false => (file.clone(), place.clone()),
            };
            let words = Error::bad(&file, &place, found, allowed).to_string();
            refused(py, &file, &place, found, allowed, words)
        }
        Some(e @ Error::Torn { file, why }) => refused(py, file, "file", why, "a whole file", e.to_string()),
        Some(e @ Error::Io { file, .. }) if !Path::new(file).exists() => PyFileNotFoundError::new_err(e.to_string()),
        Some(e) => PyOSError::new_err(e.to_string()),
        None => PyRuntimeError::new_err(foreign::line(&format!("{e:#}")).to_string()),
    }
}
