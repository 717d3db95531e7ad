//! Types and numbers of FMI 2.0.4, `fmi2TypesPlatform.h` and `fmi2FunctionTypes.h`.

use std::ffi::{c_char, c_int, c_uint, c_void};

/// `fmi2TypesPlatform`
pub const TYPES_PLATFORM: &std::ffi::CStr = c"default";
/// `fmi2Version`
pub const VERSION: &std::ffi::CStr = c"2.0";

/// `fmi2ValueReference`
pub type ValueReference = c_uint;
/// `fmi2Boolean`
pub type Boolean = c_int;
/// `fmi2Component`: an instance
pub type Component = *mut c_void;

/// `fmi2Status`
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(i32)]
pub enum Status {
    /// all well
    Ok = 0,
    /// done, but something is worth a word
    Warning = 1,
    /// not done; the instance goes on as before
    Discard = 2,
    /// not done
    Error = 3,
}

/// `fmi2CoSimulation` of `fmi2Type`
pub const CO_SIMULATION: c_int = 1;
/// `fmi2LastSuccessfulTime` of `fmi2StatusKind`
pub const LAST_SUCCESSFUL_TIME: c_int = 2;
/// `fmi2Terminated` of `fmi2StatusKind`
pub const TERMINATED: c_int = 3;

/// `fmi2CallbackLogger`: environment, name of the instance, status, category, message as a format of `printf`
pub type Logger = unsafe extern "C" fn(*mut c_void, *const c_char, c_int, *const c_char, *const c_char, ...);

/// `fmi2CallbackFunctions`; memory is this library's own affair
#[derive(Clone, Copy)]
#[repr(C)]
pub struct Callbacks {
    /// hears of refusals; may be absent
    pub logger: Option<Logger>,
    /// not used
    pub allocate_memory: *const c_void,
    /// not used
    pub free_memory: *const c_void,
    /// not used
    pub step_finished: *const c_void,
    /// handed to the logger
    pub environment: *mut c_void,
}
