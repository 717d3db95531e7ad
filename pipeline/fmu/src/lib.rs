//! The numerical test bench as an FMU (FMI 2.0, co-simulation): the shared library that stands in it, and what is
//! written into it besides.
//!
//! * [`variables`]: inputs, outputs and parameters of an actuator, once
//! * [`description`]: `modelDescription.xml`, documentation and resources, of these variables
//! * [`instance`]: one instance without any C, [`ffi`]: the functions of the standard, which call it
//!
//! The description comes out of the very library that goes into the FMU ([`ffi::ema_fmu_files`], called by
//! `ema export fmu`), so that they cannot differ.

#![warn(missing_docs, clippy::missing_errors_doc)]

pub mod description;
pub mod ffi;
pub mod fmi2;
pub mod instance;
pub mod unit;
pub mod variables;
