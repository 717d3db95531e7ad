//! Null pointers, strange handles, and what comes out of the library.

use super::*;
use crate::variables::guid;
use std::ptr::{null, null_mut};
use std::sync::Mutex;

static SAID: Mutex<Vec<(usize, String)>> = Mutex::new(Vec::new());

#[test]
fn prop_uris_of_folders() {
    for uri in ["file:///a%20b/c", "file:/a%20b/c", "file://localhost/a%20b/c", "/a b/c"] {
        assert_eq!(folder(uri).unwrap(), PathBuf::from("/a b/c"), "{uri}");
    }
    for uri in ["", "http://x/y", "file:///a%2", "file:///a%zz", "a/b", "file://host"] {
        assert_eq!(folder(uri), None, "{uri}");
    }
}

/// A logger with the five arguments that it needs; what is varied is never there.
unsafe extern "C" fn hear(to: *mut c_void, _: *const c_char, status: c_int, _: *const c_char, text: *const c_char) {
    let text = unsafe { CStr::from_ptr(text) }.to_str().unwrap();
    SAID.lock().unwrap().push((to as usize, format!("{status} {text}")));
}

#[test]
fn refuse_null_pointers_and_strange_handles() {
    let dir = tempfile::tempdir().unwrap();
    let actuator = ActuatorParameters::reference();
    std::fs::write(dir.path().join(ACTUATOR), actuator.to_toml()).unwrap();
    let uri = CString::new(format!("file://{}", dir.path().display())).unwrap();
    let guid = CString::new(guid(&actuator)).unwrap();
    let me = 77 as *mut c_void;
    let callbacks = Callbacks {
        // SAFETY: the same but for arguments that nobody gives
        logger: Some(unsafe {
            std::mem::transmute::<
                unsafe extern "C" fn(*mut c_void, *const c_char, c_int, *const c_char, *const c_char),
                crate::fmi2::Logger,
            >(hear)
        }),
        allocate_memory: null(),
        free_memory: null(),
        step_finished: null(),
        environment: me,
    };
    let last = || {
        let said = SAID.lock().unwrap();
        said.iter()
            .rev()
            .find(|(to, _)| *to == 77)
            .map_or(String::new(), |(_, text)| text.clone())
    };
    let refused = |status: c_int, expect: c_int, words: &str| {
        let said = last();
        assert_eq!(status, expect, "{said}");
        assert!(
            said.starts_with(&expect.to_string()) && said.contains(words),
            "no `{words}` in {said}"
        );
    };
    unsafe {
        let new = |guid: *const c_char, uri: *const c_char, callbacks: *const Callbacks| {
            fmi2Instantiate(c"one".as_ptr(), CO_SIMULATION, guid, uri, callbacks, 0, 0)
        };
        assert!(new(null(), uri.as_ptr(), &callbacks).is_null());
        refused(3, 3, "guid");
        assert!(new(c"{other}".as_ptr(), uri.as_ptr(), &callbacks).is_null());
        refused(3, 3, "{other}");
        assert!(new(guid.as_ptr(), null(), &callbacks).is_null());
        refused(3, 3, "fmuResourceLocation");
        assert!(new(guid.as_ptr(), c"file:///nowhere%25".as_ptr(), &callbacks).is_null());
        refused(3, 3, "/nowhere%%/actuator.toml: cannot be read");
        assert!(new(guid.as_ptr(), null(), null()).is_null());
        assert!(fmi2Instantiate(null(), 0, guid.as_ptr(), uri.as_ptr(), &callbacks, 0, 0).is_null());
        refused(3, 3, "fmuType");

        let c = new(guid.as_ptr(), uri.as_ptr(), &callbacks);
        assert!(!c.is_null());
        assert_eq!(fmi2GetReal(c, null(), 0, null_mut()), 0);
        refused(fmi2GetReal(c, null(), 1, null_mut()), 3, "null pointer");
        refused(fmi2GetReal(c, [0].as_ptr(), 1, null_mut()), 3, "room for 1");
        refused(fmi2SetReal(c, [17].as_ptr(), 1, [0.0].as_ptr()), 3, "sequence");
        refused(
            fmi2GetString(c, [0].as_ptr(), 1, [null()].as_mut_ptr()),
            3,
            "no variable",
        );
        assert_eq!(fmi2SetBoolean(c, null(), 0, null()), 0);
        refused(fmi2SetBoolean(c, [3].as_ptr(), 1, [1].as_ptr()), 3, "no variable");
        assert_eq!(fmi2SetDebugLogging(c, 1, 0, null()), 0);
        assert_eq!(fmi2SetDebugLogging(c, 1, 1, [c"logStatusError".as_ptr()].as_ptr()), 0);
        refused(
            fmi2SetDebugLogging(c, 1, 1, [c"all".as_ptr()].as_ptr()),
            3,
            "logStatusError, logStatusWarning",
        );
        assert_eq!(fmi2SetupExperiment(c, 0, f64::NAN, 0.0, 0, f64::NAN), 0);
        refused(fmi2DoStep(c, 0.0, 1e-4, 0), 3, "fmi2DoStep");
        assert_eq!(fmi2EnterInitializationMode(c), 0);
        assert_eq!(fmi2ExitInitializationMode(c), 0);
        assert_eq!(fmi2DoStep(c, 0.0, 1e-4, 0), 0);
        refused(fmi2DoStep(c, 1e-4, 1.5e-6, 0), 1, "nearest");
        assert_eq!(fmi2DoStep(c, 1.015e-4, 1.5e-6, 0), 0);
        let mut time = 0.0;
        assert_eq!(fmi2GetRealStatus(c, LAST_SUCCESSFUL_TIME, &mut time), 0);
        assert!((time - 1.03e-4).abs() < 1e-12);
        let mut ended = 7;
        assert_eq!(fmi2GetBooleanStatus(c, TERMINATED, &mut ended), 0);
        assert_eq!(ended, 0);
        refused(fmi2GetStatus(c, 0, null_mut()), 2, "fmi2GetStatus");
        refused(fmi2GetRealStatus(c, LAST_SUCCESSFUL_TIME, null_mut()), 3, "null");
        refused(fmi2CancelStep(c), 3, "fmi2CancelStep");
        refused(
            fmi2GetRealOutputDerivatives(c, null(), 0, null(), null_mut()),
            3,
            "is 0",
        );
        refused(
            fmi2GetDirectionalDerivative(c, null(), 0, null(), 0, null(), null_mut()),
            3,
            "no",
        );

        let mut state = null_mut();
        refused(fmi2GetFMUstate(c, null_mut()), 3, "null");
        assert_eq!(fmi2FreeFMUstate(c, null_mut()), 0);
        assert_eq!(fmi2FreeFMUstate(c, &mut state), 0);
        refused(fmi2SetFMUstate(c, null_mut()), 3, "null");
        refused(fmi2SetFMUstate(c, me), 3, "another pointer");
        assert_eq!(fmi2GetFMUstate(c, &mut state), 0);
        let first = state;
        assert_eq!(fmi2GetFMUstate(c, &mut state), 0);
        assert_eq!(first, state);
        let mut size = 0;
        assert_eq!(fmi2SerializedFMUstateSize(c, state, &mut size), 0);
        let mut bytes = vec![0 as c_char; size];
        refused(
            fmi2SerializeFMUstate(c, state, bytes.as_mut_ptr(), size - 1),
            3,
            "at least",
        );
        assert_eq!(fmi2SerializeFMUstate(c, state, bytes.as_mut_ptr(), size), 0);
        let mut again = null_mut();
        refused(
            fmi2DeSerializeFMUstate(c, bytes.as_ptr(), size - 1, &mut again),
            3,
            "state",
        );
        assert_eq!(fmi2DeSerializeFMUstate(c, bytes.as_ptr(), size, &mut again), 0);
        assert!(!again.is_null() && again != state);
        assert_eq!(fmi2SetFMUstate(c, again), 0);
        assert_eq!(fmi2FreeFMUstate(c, &mut again), 0);
        assert!(again.is_null());
        let mut gone = first;
        assert_eq!(fmi2FreeFMUstate(c, &mut state), 0);
        refused(fmi2FreeFMUstate(c, &mut gone), 3, "another pointer");
        // one is still held at the end
        assert_eq!(fmi2GetFMUstate(c, &mut state), 0);
        assert_eq!(fmi2Terminate(c), 0);
        assert_eq!(fmi2Reset(c), 0);
        fmi2FreeInstance(c);
        fmi2FreeInstance(null_mut());
        assert_eq!(fmi2DoStep(null_mut(), 0.0, 1e-4, 0), 3);
    }
}

#[test]
fn prop_the_files_come_out_of_the_library() {
    unsafe extern "C" fn take(to: *mut c_void, name: *const u8, n: usize, bytes: *const u8, len: usize) {
        let all = unsafe { &mut *to.cast::<Vec<(String, usize)>>() };
        let name = unsafe { std::slice::from_raw_parts(name, n) };
        let _ = bytes;
        all.push((String::from_utf8(name.to_vec()).unwrap(), len));
    }
    let mut all: Vec<(String, usize)> = Vec::new();
    let ask = |text: &str, all: &mut Vec<(String, usize)>| unsafe {
        ema_fmu_files(text.as_ptr(), text.len(), take, std::ptr::from_mut(all).cast())
    };
    assert_eq!(ask(ActuatorParameters::reference_text(), &mut all), 0);
    let names: Vec<&str> = all.iter().map(|(n, _)| n.as_str()).collect();
    assert_eq!(names[..2], ["", "modelDescription.xml"]);
    assert!(names.contains(&"resources/actuator.toml"));
    assert!(all.iter().all(|(_, len)| *len > 0));
    all.clear();
    assert_eq!(ask("name = 3", &mut all), 1);
    assert_eq!(all.len(), 1);
}
