//! The functions of FMI 2.0 for co-simulation, and the one by which `ema export fmu` asks for the files of an FMU.
//!
//! A refusal goes through the logger as one line, and nothing unwinds into the master: a panic is an error of that
//! instance. Pointers that the standard lets be null may be; of others null is refused.

use crate::description::{ACTUATOR, CATEGORIES, files, identifier};
use crate::fmi2::{
    Boolean, CO_SIMULATION, Callbacks, Component, LAST_SUCCESSFUL_TIME, Status, TERMINATED, TYPES_PLATFORM, VERSION,
    ValueReference,
};
use crate::instance::{Instance, Moment, Phase};
use schemas::error::{Error, Result};
use sim_worker::parameters::ActuatorParameters;
use std::collections::BTreeMap;
use std::ffi::{CStr, CString, c_char, c_int, c_void};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::PathBuf;

/// What an `fmi2Component` points to.
struct Slave {
    instance: Instance,
    voice: Voice,
    /// states that the master holds, by their address
    kept: BTreeMap<usize, Box<Moment>>,
}

/// The master's logger and the name that it knows the instance by.
struct Voice {
    name: CString,
    callbacks: Callbacks,
}

impl Voice {
    fn say(&self, status: Status, text: &str) {
        let Some(logger) = self.callbacks.logger else { return };
        let category = CATEGORIES[usize::from(status == Status::Warning)].0;
        // the message is a format of printf
        let text = text.replace('%', "%%").replace('\0', " ");
        let (Ok(text), Ok(category)) = (CString::new(text), CString::new(category)) else {
            return;
        };
        // SAFETY: the master's function, with strings that live until it returns
        unsafe {
            logger(
                self.callbacks.environment,
                self.name.as_ptr(),
                status as c_int,
                category.as_ptr(),
                text.as_ptr(),
            );
        }
    }

    /// The status of a result; says why where it is a refusal.
    fn status(&self, result: Result<Status, Refusal>) -> c_int {
        let status = match result {
            Ok(status) => status,
            Err(Refusal(status, text)) => {
                self.say(status, &text);
                status
            }
        };
        status as c_int
    }
}

/// A status other than ok and why.
struct Refusal(Status, String);

impl From<Error> for Refusal {
    fn from(e: Error) -> Self {
        Self(Status::Error, e.to_string())
    }
}

/// What a panic said, as a refusal.
fn words(panic: &(dyn std::any::Any + Send)) -> String {
    format!("internal error: {}", schemas::guard::words(panic))
}

/// Does `work` on an instance; an instance that is not there is an error without words.
fn with(c: Component, work: impl FnOnce(&mut Slave) -> Result<Status, Refusal>) -> c_int {
    if c.is_null() {
        return Status::Error as c_int;
    }
    // SAFETY: not null, so what fmi2Instantiate gave, which nobody else uses meanwhile
    let slave = unsafe { &mut *c.cast::<Slave>() };
    let done = catch_unwind(AssertUnwindSafe(|| work(slave)));
    let result = done.unwrap_or_else(|panic| Err(Refusal(Status::Error, words(&*panic))));
    slave.voice.status(result)
}

fn ok(result: Result<()>) -> Result<Status, Refusal> {
    result.map(|()| Status::Ok).map_err(Refusal::from)
}

/// `n` values behind a pointer, which may be null where there are none.
///
/// # Safety
/// `p` is null or points to `n` values that nobody changes for `'a`.
unsafe fn slice<'a, T>(of: &Instance, what: &str, p: *const T, n: usize) -> Result<&'a [T]> {
    if n == 0 {
        Ok(&[])
    } else if p.is_null() {
        Err(of.bad(what, "a null pointer", format!("{n} values")))
    } else {
        // SAFETY: as the caller promises
        Ok(unsafe { std::slice::from_raw_parts(p, n) })
    }
}

/// As [`slice`], to be written.
///
/// # Safety
/// `p` is null or points to `n` values that nobody else uses for `'a`.
unsafe fn slice_mut<'a, T>(of: &Instance, what: &str, p: *mut T, n: usize) -> Result<&'a mut [T]> {
    if n == 0 {
        Ok(&mut [])
    } else if p.is_null() {
        Err(of.bad(what, "a null pointer", format!("room for {n} values")))
    } else {
        // SAFETY: as the caller promises
        Ok(unsafe { std::slice::from_raw_parts_mut(p, n) })
    }
}

/// The text behind a pointer; none where it is null.
///
/// # Safety
/// `p` is null or points to a string that ends with 0 and lives for the call.
unsafe fn text(p: *const c_char) -> Option<String> {
    // SAFETY: not null, and as the caller promises
    (!p.is_null()).then(|| unsafe { CStr::from_ptr(p) }.to_string_lossy().into_owned())
}

/// The folder of a `file:` URI, or of a plain path.
fn folder(uri: &str) -> Option<PathBuf> {
    let path = match uri.strip_prefix("file:") {
        Some(rest) => {
            let path = rest
                .strip_prefix("//")
                .map_or(rest, |r| r.strip_prefix("localhost").unwrap_or(r));
            let mut bytes = Vec::new();
            let mut left = path.bytes();
            while let Some(b) = left.next() {
                if b == b'%' {
                    let digits = [left.next()?, left.next()?];
                    let digits = std::str::from_utf8(&digits).ok()?.to_string();
                    bytes.push(u8::from_str_radix(&digits, 16).ok()?);
                } else {
                    bytes.push(b);
                }
            }
            String::from_utf8(bytes).ok()?
        }
        None => uri.to_string(),
    };
    path.starts_with('/').then(|| path.into())
}

/// # Safety
/// Pointers as the standard has them for fmi2Instantiate, or null.
unsafe fn instantiate(kind: c_int, guid: *const c_char, resources: *const c_char) -> Result<Instance> {
    if kind != CO_SIMULATION {
        return Err(Error::bad("fmi2Instantiate", "fmuType", kind, "1, co-simulation"));
    }
    // SAFETY: as the caller promises
    let (guid, uri) = unsafe { (text(guid), text(resources)) };
    let guid = guid.ok_or_else(|| {
        Error::bad(
            "fmi2Instantiate",
            "guid",
            "a null pointer",
            "the guid of the description",
        )
    })?;
    let uri = uri.unwrap_or_default();
    let allowed = "the file: URI of the unpacked folder `resources`";
    let dir = folder(&uri).ok_or_else(|| Error::bad("fmi2Instantiate", "fmuResourceLocation", &uri, allowed))?;
    Instance::new(ActuatorParameters::read(&dir.join(ACTUATOR))?, &guid)
}

/// The platform of the types: the standard's own.
#[unsafe(no_mangle)]
pub extern "C" fn fmi2GetTypesPlatform() -> *const c_char {
    TYPES_PLATFORM.as_ptr()
}

/// The version of the standard.
#[unsafe(no_mangle)]
pub extern "C" fn fmi2GetVersion() -> *const c_char {
    VERSION.as_ptr()
}

/// An instance; null where it is refused, after a word to the logger.
///
/// # Safety
/// Strings end with 0 or are null; `callbacks` is null or points to the master's functions, which live as long as the
/// instance.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi2Instantiate(
    name: *const c_char,
    kind: c_int,
    guid: *const c_char,
    resources: *const c_char,
    callbacks: *const Callbacks,
    _visible: Boolean,
    _logging: Boolean,
) -> Component {
    let silent = Callbacks {
        logger: None,
        allocate_memory: std::ptr::null(),
        free_memory: std::ptr::null(),
        step_finished: std::ptr::null(),
        environment: std::ptr::null_mut(),
    };
    let made = catch_unwind(AssertUnwindSafe(|| {
        // SAFETY: as the caller promises
        let (name, callbacks) = unsafe { (text(name), callbacks.as_ref()) };
        let voice = Voice {
            name: CString::new(name.unwrap_or_default()).unwrap_or_default(),
            callbacks: callbacks.copied().unwrap_or(silent),
        };
        // SAFETY: as the caller promises
        let made = catch_unwind(AssertUnwindSafe(|| unsafe { instantiate(kind, guid, resources) }));
        let refusal = match made {
            Ok(Ok(instance)) => {
                let slave = Slave {
                    instance,
                    voice,
                    kept: BTreeMap::new(),
                };
                return Box::into_raw(Box::new(slave)).cast::<c_void>();
            }
            Ok(Err(e)) => e.to_string(),
            Err(panic) => words(&*panic),
        };
        voice.say(Status::Error, &refusal);
        std::ptr::null_mut()
    }));
    made.unwrap_or(std::ptr::null_mut())
}

/// Ends an instance, and with it the states that the master still holds; null is let pass.
///
/// # Safety
/// `c` is null or comes from [`fmi2Instantiate`] and is not used any more.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi2FreeInstance(c: Component) {
    if !c.is_null() {
        // SAFETY: as the caller promises
        let slave = unsafe { Box::from_raw(c.cast::<Slave>()) };
        let _ = catch_unwind(AssertUnwindSafe(|| drop(slave)));
    }
}

/// Checks the categories; refusals and warnings are said whatever is asked, and there is nothing else to say.
///
/// # Safety
/// `categories` is null or points to `n` strings.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi2SetDebugLogging(
    c: Component,
    _on: Boolean,
    n: usize,
    categories: *const *const c_char,
) -> c_int {
    with(c, |s| {
        // SAFETY: as the caller promises
        for p in unsafe { slice(&s.instance, "categories", categories, n) }? {
            // SAFETY: as the caller promises
            let name = unsafe { text(*p) }.unwrap_or_default();
            if !CATEGORIES.iter().any(|(known, _)| *known == name) {
                let all: Vec<&str> = CATEGORIES.iter().map(|(known, _)| *known).collect();
                return Err(s.instance.bad("category of messages", name, all.join(", ")).into());
            }
        }
        Ok(Status::Ok)
    })
}

/// Start and end of the simulation; there is no tolerance to keep.
#[unsafe(no_mangle)]
pub extern "C" fn fmi2SetupExperiment(
    c: Component,
    _has_tolerance: Boolean,
    _tolerance: f64,
    start_s: f64,
    has_stop: Boolean,
    stop_s: f64,
) -> c_int {
    with(c, |s| ok(s.instance.setup(start_s, (has_stop != 0).then_some(stop_s))))
}

/// See [`Instance::enter_initialization`].
#[unsafe(no_mangle)]
pub extern "C" fn fmi2EnterInitializationMode(c: Component) -> c_int {
    with(c, |s| ok(s.instance.enter_initialization()))
}

/// See [`Instance::exit_initialization`].
#[unsafe(no_mangle)]
pub extern "C" fn fmi2ExitInitializationMode(c: Component) -> c_int {
    with(c, |s| ok(s.instance.exit_initialization()))
}

/// See [`Instance::terminate`].
#[unsafe(no_mangle)]
pub extern "C" fn fmi2Terminate(c: Component) -> c_int {
    with(c, |s| ok(s.instance.terminate()))
}

/// See [`Instance::reset`].
#[unsafe(no_mangle)]
pub extern "C" fn fmi2Reset(c: Component) -> c_int {
    with(c, |s| {
        s.instance.reset();
        Ok(Status::Ok)
    })
}

macro_rules! get {
    ($($(#[$doc:meta])* $name:ident $type:ty, $one:ident;)+) => {
        $($(#[$doc])*
        ///
        /// # Safety
        /// `references` and `values` are null or point to `n` of their type.
        #[unsafe(no_mangle)]
        pub unsafe extern "C" fn $name(
            c: Component,
            references: *const ValueReference,
            n: usize,
            values: *mut $type,
        ) -> c_int {
            with(c, |s| {
                let i = &s.instance;
                // SAFETY: as the caller promises
                let (from, to) = unsafe { (slice(i, "value references", references, n)?, slice_mut(i, "values", values, n)?) };
                for (r, x) in from.iter().zip(to) {
                    *x = $one(i, *r)?;
                }
                Ok(Status::Ok)
            })
        })+
    };
}

macro_rules! set {
    ($($(#[$doc:meta])* $name:ident $type:ty, $all:expr;)+) => {
        $($(#[$doc])*
        ///
        /// # Safety
        /// `references` and `values` are null or point to `n` of their type.
        #[unsafe(no_mangle)]
        pub unsafe extern "C" fn $name(
            c: Component,
            references: *const ValueReference,
            n: usize,
            values: *const $type,
        ) -> c_int {
            with(c, |s| {
                let i = &mut s.instance;
                // SAFETY: as the caller promises
                let (to, from) = unsafe { (slice(i, "value references", references, n)?, slice(i, "values", values, n)?) };
                let set: fn(&mut Instance, &[ValueReference], &[$type]) -> Result<()> = $all;
                ok(set(i, to, from))
            })
        })+
    };
}

fn real(i: &Instance, r: ValueReference) -> Result<f64> {
    i.real(r)
}

fn integer(i: &Instance, r: ValueReference) -> Result<c_int> {
    i.integer(r)
}

fn no_type<T>(i: &Instance, r: ValueReference) -> Result<T> {
    Err(i.bad("value reference", r, "none: no variable is a Boolean or a String"))
}

fn set_no_type<T>(i: &mut Instance, r: &[ValueReference], _: &[T]) -> Result<()> {
    r.first().map_or(Ok(()), |r| no_type(i, *r))
}

get! {
    /// See [`Instance::real`].
    fmi2GetReal f64, real;
    /// See [`Instance::integer`].
    fmi2GetInteger c_int, integer;
    /// No variable is a Boolean.
    fmi2GetBoolean Boolean, no_type;
    /// No variable is a String.
    fmi2GetString *const c_char, no_type;
}

set! {
    /// See [`Instance::set_reals`].
    fmi2SetReal f64, Instance::set_reals;
    /// See [`Instance::set_integers`].
    fmi2SetInteger c_int, Instance::set_integers;
    /// No variable is a Boolean.
    fmi2SetBoolean Boolean, set_no_type;
    /// No variable is a String.
    fmi2SetString *const c_char, set_no_type;
}

/// The state behind a handle of the master.
fn kept<'a>(s: &'a Slave, state: *mut c_void, call: &str) -> Result<&'a Moment> {
    let found = if state.is_null() {
        "a null pointer"
    } else {
        "another pointer"
    };
    let known = s.kept.get(&(state as usize));
    known.map(|m| &**m).ok_or_else(|| {
        s.instance.bad(
            call,
            found,
            "a state that fmi2GetFMUstate or fmi2DeSerializeFMUstate gave",
        )
    })
}

/// Puts a moment behind `*state`: into the state that is there, or a new one where that is null.
///
/// # Safety
/// `state` is null or points to a handle.
unsafe fn keep(s: &mut Slave, state: *mut *mut c_void, moment: Moment, call: &str) -> Result<Status, Refusal> {
    if state.is_null() {
        return Err(s
            .instance
            .bad(call, "a null pointer", "where the handle is to be put")
            .into());
    }
    // SAFETY: as the caller promises
    let handle = unsafe { &mut *state };
    if handle.is_null() {
        let moment = Box::new(moment);
        let address = std::ptr::from_ref(&*moment) as usize;
        *handle = address as *mut c_void;
        s.kept.insert(address, moment);
    } else {
        kept(s, *handle, call)?;
        if let Some(old) = s.kept.get_mut(&(*handle as usize)) {
            **old = moment;
        }
    }
    Ok(Status::Ok)
}

/// Copies the state.
///
/// # Safety
/// `state` is null or points to a handle.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi2GetFMUstate(c: Component, state: *mut *mut c_void) -> c_int {
    with(c, |s| {
        let moment = s.instance.moment().clone();
        // SAFETY: as the caller promises
        unsafe { keep(s, state, moment, "fmi2GetFMUstate") }
    })
}

/// Goes back to a state.
#[unsafe(no_mangle)]
pub extern "C" fn fmi2SetFMUstate(c: Component, state: *mut c_void) -> c_int {
    with(c, |s| {
        let moment = kept(s, state, "fmi2SetFMUstate")?.clone();
        s.instance.go_to(&moment);
        Ok(Status::Ok)
    })
}

/// Frees a state; null and a handle of null are let pass.
///
/// # Safety
/// `state` is null or points to a handle.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi2FreeFMUstate(c: Component, state: *mut *mut c_void) -> c_int {
    with(c, |s| {
        // SAFETY: as the caller promises
        let Some(handle) = (unsafe { state.as_mut() }).filter(|h| !h.is_null()) else {
            return Ok(Status::Ok);
        };
        kept(s, *handle, "fmi2FreeFMUstate")?;
        s.kept.remove(&(*handle as usize));
        *handle = std::ptr::null_mut();
        Ok(Status::Ok)
    })
}

/// Bytes that [`fmi2SerializeFMUstate`] needs.
///
/// # Safety
/// `size` is null or points to a number.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi2SerializedFMUstateSize(c: Component, state: *mut c_void, size: *mut usize) -> c_int {
    with(c, |s| {
        let call = "fmi2SerializedFMUstateSize";
        // SAFETY: as the caller promises
        let room = unsafe { slice_mut(&s.instance, call, size, 1) }?;
        room[0] = s.instance.bytes(kept(s, state, call)?).len();
        Ok(Status::Ok)
    })
}

/// A state in bytes.
///
/// # Safety
/// `bytes` is null or points to `size` bytes.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi2SerializeFMUstate(
    c: Component,
    state: *mut c_void,
    bytes: *mut c_char,
    size: usize,
) -> c_int {
    with(c, |s| {
        let call = "fmi2SerializeFMUstate";
        let own = s.instance.bytes(kept(s, state, call)?);
        if size < own.len() {
            let allowed = format!("at least {} bytes", own.len());
            return Err(s.instance.bad(call, format!("{size} bytes"), allowed).into());
        }
        // SAFETY: as the caller promises
        let room = unsafe { slice_mut(&s.instance, call, bytes.cast::<u8>(), own.len()) }?;
        room.copy_from_slice(&own);
        Ok(Status::Ok)
    })
}

/// The state of bytes.
///
/// # Safety
/// `bytes` is null or points to `size` bytes, `state` is null or points to a handle.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi2DeSerializeFMUstate(
    c: Component,
    bytes: *const c_char,
    size: usize,
    state: *mut *mut c_void,
) -> c_int {
    with(c, |s| {
        let call = "fmi2DeSerializeFMUstate";
        // SAFETY: as the caller promises
        let bytes = unsafe { slice(&s.instance, call, bytes.cast::<u8>(), size) }?;
        let moment = s.instance.moment_of(bytes)?;
        // SAFETY: as the caller promises
        unsafe { keep(s, state, moment, call) }
    })
}

fn unsupported(c: Component, call: &str, why: &str) -> c_int {
    with(c, |s| {
        Err(s.instance.bad(call, "a call", format!("none: {why}")).into())
    })
}

/// Refused: relays and dry friction have no derivative.
#[unsafe(no_mangle)]
pub extern "C" fn fmi2GetDirectionalDerivative(
    c: Component,
    _unknown: *const ValueReference,
    _unknowns: usize,
    _known: *const ValueReference,
    _knowns: usize,
    _of_known: *const f64,
    _of_unknown: *mut f64,
) -> c_int {
    unsupported(
        c,
        "fmi2GetDirectionalDerivative",
        "providesDirectionalDerivative is false, relays and dry friction have none",
    )
}

/// See [`Instance::set_derivatives`].
///
/// # Safety
/// `references`, `orders` and `values` are null or point to `n` of their type.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi2SetRealInputDerivatives(
    c: Component,
    references: *const ValueReference,
    n: usize,
    orders: *const c_int,
    values: *const f64,
) -> c_int {
    with(c, |s| {
        let i = &mut s.instance;
        // SAFETY: as the caller promises
        let (references, orders, values) = unsafe {
            (
                slice(i, "value references", references, n)?,
                slice(i, "orders", orders, n)?,
                slice(i, "values", values, n)?,
            )
        };
        ok(i.set_derivatives(references, orders, values))
    })
}

/// Refused: `maxOutputDerivativeOrder` is 0.
#[unsafe(no_mangle)]
pub extern "C" fn fmi2GetRealOutputDerivatives(
    c: Component,
    _references: *const ValueReference,
    _n: usize,
    _orders: *const c_int,
    _values: *mut f64,
) -> c_int {
    unsupported(c, "fmi2GetRealOutputDerivatives", "maxOutputDerivativeOrder is 0")
}

/// See [`Instance::step`].
#[unsafe(no_mangle)]
pub extern "C" fn fmi2DoStep(c: Component, at_s: f64, length_s: f64, _no_way_back: Boolean) -> c_int {
    with(c, |s| {
        if s.instance.step(at_s, length_s)? {
            let text = format!(
                "fmi2DoStep: the communication step of {length_s:e} s ends between two steps of the simulator, of {:e} s; the \
                 nearest is taken, here and in all further steps",
                s.instance.step_s()
            );
            return Err(Refusal(Status::Warning, text));
        }
        Ok(Status::Ok)
    })
}

/// Refused: steps are done when [`fmi2DoStep`] returns.
#[unsafe(no_mangle)]
pub extern "C" fn fmi2CancelStep(c: Component) -> c_int {
    unsupported(c, "fmi2CancelStep", "a step is done when fmi2DoStep returns")
}

fn discard(c: Component, call: &str) -> c_int {
    with(c, |s| {
        let allowed = "fmi2LastSuccessfulTime of fmi2GetRealStatus, fmi2Terminated of fmi2GetBooleanStatus: a step is done when \
                       fmi2DoStep returns";
        let text = s.instance.bad(call, "another kind of status", allowed).to_string();
        Err(Refusal(Status::Discard, text))
    })
}

/// Discarded: no step is ever pending.
#[unsafe(no_mangle)]
pub extern "C" fn fmi2GetStatus(c: Component, _kind: c_int, _value: *mut c_int) -> c_int {
    discard(c, "fmi2GetStatus")
}

/// The one status of a type that there is; others are discarded.
///
/// # Safety
/// `value` is null or points to a value.
unsafe fn status<T>(
    c: Component,
    call: &str,
    (kind, only): (c_int, c_int),
    value: *mut T,
    of: impl FnOnce(&Instance) -> T,
) -> c_int {
    if kind != only {
        return discard(c, call);
    }
    with(c, |s| {
        // SAFETY: as the caller promises
        let room = unsafe { slice_mut(&s.instance, call, value, 1) }?;
        room[0] = of(&s.instance);
        Ok(Status::Ok)
    })
}

/// The end of the last step [s].
///
/// # Safety
/// `value` is null or points to a number.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi2GetRealStatus(c: Component, kind: c_int, value: *mut f64) -> c_int {
    let kinds = (kind, LAST_SUCCESSFUL_TIME);
    // SAFETY: as the caller promises
    unsafe { status(c, "fmi2GetRealStatus", kinds, value, Instance::time_s) }
}

/// Discarded: there is no such status.
#[unsafe(no_mangle)]
pub extern "C" fn fmi2GetIntegerStatus(c: Component, _kind: c_int, _value: *mut c_int) -> c_int {
    discard(c, "fmi2GetIntegerStatus")
}

/// Whether it wants no further steps: where it has failed or was terminated.
///
/// # Safety
/// `value` is null or points to a number.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi2GetBooleanStatus(c: Component, kind: c_int, value: *mut Boolean) -> c_int {
    let is_over = |i: &Instance| Boolean::from(matches!(i.phase(), Phase::Failed | Phase::Terminated));
    // SAFETY: as the caller promises
    unsafe { status(c, "fmi2GetBooleanStatus", (kind, TERMINATED), value, is_over) }
}

/// Discarded: no step is ever pending.
#[unsafe(no_mangle)]
pub extern "C" fn fmi2GetStringStatus(c: Component, _kind: c_int, _value: *mut *const c_char) -> c_int {
    discard(c, "fmi2GetStringStatus")
}

/// Takes what [`ema_fmu_files`] gives: name and bytes of a file, or what [`ema_fmu_files`] says of them.
pub type Take = unsafe extern "C" fn(to: *mut c_void, name: *const u8, name_len: usize, bytes: *const u8, len: usize);

/// The files of the FMU of an actuator, one call of `take` each; the first has no name and is the identifier, by which the
/// library is named in the FMU. Not part of FMI. 0 where all went well; else 1, and `take` had the reason without a name.
///
/// * `toml` text of the actuator's file, `len` bytes
///
/// # Safety
/// `toml` points to `len` bytes, and `take` may be called with `to`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn ema_fmu_files(toml: *const u8, len: usize, take: Take, to: *mut c_void) -> c_int {
    let give = |name: &str, bytes: &[u8]| {
        // SAFETY: as the caller promises
        unsafe { take(to, name.as_ptr(), name.len(), bytes.as_ptr(), bytes.len()) };
    };
    let made = catch_unwind(|| {
        // SAFETY: as the caller promises
        let toml = String::from_utf8_lossy(unsafe { std::slice::from_raw_parts(toml, len) });
        let actuator = ActuatorParameters::parse("actuator", &toml).map_err(|e| e.to_string())?;
        Ok((identifier(&actuator), files(&actuator)))
    });
    match made.unwrap_or_else(|panic| Err(words(&*panic))) {
        Ok((name, files)) => {
            give("", name.as_bytes());
            files.iter().for_each(|(path, bytes)| give(path, bytes));
            0
        }
        Err(why) => {
            give("", why.as_bytes());
            1
        }
    }
}

#[cfg(test)]
mod tests;
