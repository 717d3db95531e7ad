//! The Python package `ema`, its compiled half: the project's own crates behind plain functions. Defaults, words and
//! types for users stand in `python/ema`.
//!
//! Without the feature `python` the crate is empty, so that the workspace is built and tested without Python.

#![cfg(feature = "python")]
#![warn(missing_docs)]

mod actuator;
mod diagnose;
mod discrepancy;
mod error;
mod fitted;
mod json;
mod maps;
mod prognosis;
mod run;
mod source;
mod sweep;
mod table;
mod unit;
mod work;

use pyo3::prelude::*;

/// The compiled half of the package `ema`.
#[pymodule]
fn _ema(m: &Bound<'_, PyModule>) -> PyResult<()> {
    // bars and notes on standard error are the program's; the package has `progress`
    sim_worker::quiet::be_quiet();
    m.add("__version__", env!("CARGO_PKG_VERSION"))?;
    m.add("COMMIT", pipeline::COMMIT)?;
    m.add("InputError", m.py().get_type::<error::InputError>())?;
    m.add_class::<actuator::Actuator>()?;
    m.add_class::<table::Table>()?;
    m.add_class::<table::Column>()?;
    m.add_class::<maps::Maps>()?;
    m.add_class::<fitted::FittedMaps>()?;
    m.add_function(wrap_pyfunction!(run::run, m)?)?;
    m.add_function(wrap_pyfunction!(sweep::sweep, m)?)?;
    m.add_function(wrap_pyfunction!(sweep::grid, m)?)?;
    m.add_function(wrap_pyfunction!(maps::maps, m)?)?;
    m.add_function(wrap_pyfunction!(diagnose::diagnose, m)?)?;
    m.add_function(wrap_pyfunction!(discrepancy::discrepancy, m)?)?;
    m.add_function(wrap_pyfunction!(unit::unit_new, m)?)?;
    m.add_function(wrap_pyfunction!(unit::unit_update, m)?)?;
    m.add_function(wrap_pyfunction!(unit::unit_show, m)?)?;
    m.add_function(wrap_pyfunction!(prognosis::prognosis, m)?)?;
    Ok(())
}
