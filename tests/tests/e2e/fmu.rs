//! The FMU of an actuator: as a master in C sees it, and driven by a master in Python (FMPy).
use crate::common::process::{json, ok, refused, text};
use ema_tests::reference_run;
use schemas::channel::Channel;
use serde_json::Value;
use sim_worker::command::CommandTrack;
use std::ffi::{CStr, CString, c_char, c_int, c_void};
use std::path::{Path, PathBuf};
use std::process::Command;
use std::ptr::{null, null_mut};
use std::sync::OnceLock;

/// The shared library of this build.
fn library() -> PathBuf {
    let here = std::env::current_exe().unwrap();
    here.with_file_name(libloading::library_filename("ema_fmu"))
}

/// The FMU of the reference actuator, made once, and where it is unpacked.
fn fmu() -> &'static (PathBuf, PathBuf) {
    static ONCE: OnceLock<(PathBuf, PathBuf)> = OnceLock::new();
    ONCE.get_or_init(|| {
        let root = Path::new(env!("CARGO_TARGET_TMPDIR"));
        let (file, dir) = (root.join("reference.fmu"), root.join("reference.fmu.d"));
        let own = library();
        let args = ["export", "fmu", "--library", text(&own), "--out", text(&file)];
        assert!(ok(&args).contains("actuator reference, FMI 2.0 co-simulation"));
        let bytes = std::fs::read(&file).unwrap();
        ok(&args);
        assert!(bytes == std::fs::read(&file).unwrap(), "other bytes the second time");
        let _ = std::fs::remove_dir_all(&dir);
        zip::ZipArchive::new(std::fs::File::open(&file).unwrap())
            .unwrap()
            .extract(&dir)
            .unwrap();
        (file, dir)
    })
}

/// `fmi2CallbackFunctions`
#[repr(C)]
struct Callbacks {
    logger: unsafe extern "C" fn(*mut c_void, *const c_char, c_int, *const c_char, *const c_char),
    rest: [*const c_void; 3],
    environment: *mut c_void,
}

unsafe extern "C" fn hear(to: *mut c_void, _: *const c_char, _: c_int, _: *const c_char, text: *const c_char) {
    let said = unsafe { &mut *to.cast::<Vec<String>>() };
    said.push(unsafe { CStr::from_ptr(text) }.to_string_lossy().into_owned());
}

/// A master in the C of the standard, with one instance.
struct Master {
    library: libloading::Library,
    instance: *mut c_void,
    // the library keeps its address
    #[allow(clippy::box_collection)]
    said: Box<Vec<String>>,
    _callbacks: Box<Callbacks>,
    names: Vec<String>,
}

macro_rules! call {
    ($master:expr, $name:literal ($($type:ty),*), $($x:expr),*) => {{
        type Function = unsafe extern "C" fn(*mut c_void, $($type),*) -> c_int;
        let m = &$master;
        unsafe { m.library.get::<Function>(concat!($name, "\0").as_bytes()).unwrap()(m.instance, $($x),*) }
    }};
}

impl Master {
    /// Instantiates; the instance is null where that is refused.
    fn new(guid: Option<&str>) -> Self {
        let (_, dir) = fmu();
        let xml = std::fs::read_to_string(dir.join("modelDescription.xml")).unwrap();
        let attribute = |text: &str, name: &str| {
            let from = text.split(&format!(" {name}=\"")).nth(1).unwrap();
            from.split('"').next().unwrap().to_string()
        };
        let of_xml = attribute(&xml, "guid");
        let names = xml
            .split("<ScalarVariable")
            .skip(1)
            .map(|v| attribute(v, "name"))
            .collect();
        let id = attribute(&xml, "modelIdentifier");
        let file = dir.join(format!("binaries/linux64/{id}.so"));
        let mut said = Box::new(Vec::<String>::new());
        let callbacks = Box::new(Callbacks {
            logger: hear,
            rest: [null(); 3],
            environment: std::ptr::from_mut(&mut *said).cast(),
        });
        let library = unsafe { libloading::Library::new(file).unwrap() };
        let guid = CString::new(guid.unwrap_or(&of_xml)).unwrap();
        let uri = CString::new(format!("file://{}", dir.join("resources").display())).unwrap();
        type Instantiate = unsafe extern "C" fn(
            *const c_char,
            c_int,
            *const c_char,
            *const c_char,
            *const Callbacks,
            c_int,
            c_int,
        ) -> *mut c_void;
        let instance = unsafe {
            let make = library.get::<Instantiate>(b"fmi2Instantiate\0").unwrap();
            make(c"unit 1".as_ptr(), 1, guid.as_ptr(), uri.as_ptr(), &*callbacks, 0, 1)
        };
        Self {
            library,
            instance,
            said,
            _callbacks: callbacks,
            names,
        }
    }

    fn reference(&self, name: &str) -> u32 {
        self.names.iter().position(|n| n == name).unwrap() as u32
    }

    fn set(&self, name: &str, x: f64) -> c_int {
        let r = self.reference(name);
        call!(*self, "fmi2SetReal" (*const u32, usize, *const f64), &r, 1, &x)
    }

    fn sequence(&self, n: c_int) -> c_int {
        let r = self.reference("sequence");
        call!(*self, "fmi2SetInteger" (*const u32, usize, *const c_int), &r, 1, &n)
    }

    fn get(&self, name: &str) -> f64 {
        let (r, mut x) = (self.reference(name), f64::NAN);
        assert_eq!(
            call!(*self, "fmi2GetReal" (*const u32, usize, *mut f64), &r, 1, &mut x),
            0
        );
        x
    }

    fn start(&self) {
        assert_eq!(self.set("fsj", 3.0) + self.set("zeta", 0.3), 0);
        assert_eq!(call!(*self, "fmi2EnterInitializationMode"(),), 0);
        assert_eq!(call!(*self, "fmi2ExitInitializationMode"(),), 0);
    }

    fn step(&self, at: f64, length: f64) -> c_int {
        call!(*self, "fmi2DoStep"(f64, f64, c_int), at, length, 0)
    }

    fn refused(&mut self, status: c_int, words: &[&str]) {
        let said = self.said.pop().unwrap_or_default();
        assert_eq!(status, 3, "{said}");
        for w in words {
            assert!(said.contains(w), "no `{w}` in: {said}");
        }
        assert_eq!(said.lines().count(), 1);
    }
}

impl Drop for Master {
    fn drop(&mut self) {
        type Free = unsafe extern "C" fn(*mut c_void);
        unsafe { self.library.get::<Free>(b"fmi2FreeInstance\0").unwrap()(self.instance) };
    }
}

#[test]
fn e2e_an_fmu_gives_the_preflight_test_to_the_bit_and_again_from_a_kept_state() {
    let own = reference_run(3.0, 0.3, "preflight", 10_000.0);
    let channels: Vec<(&str, &[f64])> = own
        .header
        .as_ref()
        .unwrap()
        .channels
        .iter()
        .map(|c| (c.name(), own.column(c).unwrap()))
        .collect();
    let m = Master::new(None);
    assert_eq!(m.sequence(2), 0);
    m.start();
    let mut state = null_mut::<c_void>();
    let go = |m: &Master, rows: std::ops::Range<usize>| {
        for k in rows {
            assert_eq!(m.step(k as f64 * 1e-4, 1e-4), 0, "{:?}", m.said);
            for (name, column) in &channels {
                assert_eq!(m.get(name).to_bits(), column[k].to_bits(), "{name} {k}");
            }
        }
    };
    go(&m, 0..12_345);
    let (mut size, mut back) = (0usize, null_mut::<c_void>());
    assert_eq!(call!(m, "fmi2GetFMUstate" (*mut *mut c_void), &mut state), 0);
    assert_eq!(
        call!(m, "fmi2SerializedFMUstateSize" (*mut c_void, *mut usize), state, &mut size),
        0
    );
    let mut bytes = vec![0u8; size];
    assert_eq!(
        call!(m, "fmi2SerializeFMUstate" (*mut c_void, *mut u8, usize), state, bytes.as_mut_ptr(), size),
        0
    );
    go(&m, 12_345..30_000);
    assert_eq!(call!(m, "fmi2SetFMUstate" (*mut c_void), state), 0);
    go(&m, 12_345..15_000);
    // in another instance, from the bytes
    let other = Master::new(None);
    let from = (bytes.as_ptr(), &mut back as *mut _);
    assert_eq!(
        call!(other, "fmi2DeSerializeFMUstate" (*const u8, usize, *mut *mut c_void), from.0, size, from.1),
        0
    );
    assert_eq!(call!(other, "fmi2SetFMUstate" (*mut c_void), back), 0);
    go(&other, 12_345..15_000);
    assert_eq!(call!(m, "fmi2FreeFMUstate" (*mut *mut c_void), &mut state), 0);
    assert_eq!(m.said.len() + other.said.len(), 0);
}

#[test]
fn e2e_an_fmu_follows_a_command_that_is_interpolated() {
    let own = reference_run(3.0, 0.3, "preflight", 10_000.0);
    let angle = own.column(Channel::ThetaM).unwrap();
    let sequence = sim_worker::catalogue::sequence("preflight").unwrap();
    let mut com = vec![0.0; 3_000_000];
    CommandTrack::new(&sequence, 1e-6).fill(0, &mut com);
    let m = Master::new(None);
    m.start();
    let command = [m.reference("command"); 2];
    let mut worst = 0f64;
    for (k, step) in com.chunks(100).enumerate() {
        // of the parabola through three of its values
        let (x, [a, b, c]) = (49e-6, [step[0], step[49], step[98]]);
        let derivatives = [(4.0 * b - 3.0 * a - c) / (2.0 * x), (a - 2.0 * b + c) / (x * x)];
        assert_eq!(m.set("command", a), 0);
        let (references, orders) = (command.as_ptr(), [1, 2].as_ptr());
        let set = call!(m, "fmi2SetRealInputDerivatives" (*const u32, usize, *const c_int, *const f64),
            references, 2, orders, derivatives.as_ptr());
        assert_eq!(set + m.step(k as f64 * 1e-4, 1e-4), 0);
        worst = worst.max((m.get("theta_m") - angle[k]).abs());
    }
    println!("theta_m within {worst:.1e} rad");
    assert!(worst < 1e-6, "{worst}");
}

#[test]
fn refuse_what_an_fmu_cannot_do() {
    let mut m = Master::new(Some("{another}"));
    assert!(m.instance.is_null());
    m.refused(3, &["guid", "{another}"]);
    let mut m = Master::new(None);
    let s = m.set("fsj", 9.0);
    m.refused(s, &["fsj", "found 9", "1 to 5"]);
    let s = m.set("zeta", f64::NAN);
    m.refused(s, &["zeta", "NaN"]);
    let s = m.sequence(99);
    m.refused(s, &["sequence", "99", "2 preflight"]);
    let mut x = 0.0;
    let s = call!(m, "fmi2GetReal" (*const u32, usize, *mut f64), &4711, 1, &mut x);
    m.refused(s, &["value reference", "4711"]);
    let s = call!(m, "fmi2GetReal" (*const u32, usize, *mut f64), null(), 1, null_mut());
    m.refused(s, &["null pointer"]);
    let s = m.step(0.0, 1e-4);
    m.refused(s, &["instantiated"]);
    m.start();
    let s = m.step(0.0, 1e-9);
    m.refused(s, &["communicationStepSize", "1e-6 s"]);
    let s = m.step(0.5, 1e-4);
    m.refused(s, &["currentCommunicationPoint", "0.5"]);

    let dir = tempfile::tempdir().unwrap();
    let path = |name: &str| dir.path().join(name);
    let (out, toml) = (path("x.fmu"), path("bad.toml"));
    let export = |args: &[&str], words: &[&str]| {
        refused(&[&["export", "fmu", "--out", text(&out)], args].concat(), words);
        assert!(!out.exists());
    };
    // beside the program under test there is none
    export(&[], &["libema_fmu.so", "cargo build --release -p ema-fmu"]);
    let own = library();
    let known = ["--library", text(&own)];
    export(&["--library", text(&toml)], &["bad.toml"]);
    export(&[&[text(&toml)], &known[..]].concat(), &["bad.toml", "cannot be read"]);
    std::fs::write(&toml, "name = 'x'").unwrap();
    export(&[&[text(&toml)], &known[..]].concat(), &["bad.toml", "supply"]);
}

#[test]
fn e2e_fmpy_validates_the_fmu_and_a_test_that_it_drives_is_diagnosed() {
    let python = std::env::var("EMA_PYTHON").unwrap_or_else(|_| "python3".into());
    let has = Command::new(&python).args(["-c", "import fmpy, numpy"]).output();
    if !has.is_ok_and(|o| o.status.success()) {
        println!("skipped: no Python with fmpy, numpy (EMA_PYTHON names the interpreter)");
        return;
    }
    let dir = tempfile::tempdir().unwrap();
    let own = dir.path().join("own.csv");
    ok(&["run", "--fsj", "3", "--zeta", "0.3", "--out", text(&own)]);
    // with effects, and names that want care in XML
    let toml = dir.path().join("effects.toml");
    let parameters =
        sim_worker::ActuatorParameters::reference_text().replace("name = \"reference\"", "name = \"<a & b>\"");
    let effect = "\n[[effect]]\nname = \"cogging\"\namplitude = 0.001\nphase = 0.3\norder = 12\n";
    std::fs::write(&toml, format!("{parameters}{effect}{effect}")).unwrap();
    let other = dir.path().join("effects.fmu");
    ok(&[
        "export",
        "fmu",
        text(&toml),
        "--library",
        text(&library()),
        "--out",
        text(&other),
    ]);
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("python/drive_fmu.py");
    let done = Command::new(python)
        .env("PYTHONDONTWRITEBYTECODE", "1")
        .arg(script)
        .args([&fmu().0, &own, dir.path(), &other])
        .output()
        .unwrap();
    assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
    let found: Value = serde_json::from_slice(&done.stdout).unwrap();
    println!("{found}");
    assert_eq!(found["problems"], serde_json::json!([]));
    let difference = |key: &str| found[key].as_f64().unwrap();
    // the CSV has 12 digits
    assert!(difference("internal") < 1e-9, "{found}");
    assert!(difference("curved") < 1e-6, "{found}");
    // straight between the points a command is 1e-9 rad off, some relay then switches a step later: 30 us of the last step
    assert!(difference("interpolated") < 0.05, "{found}");
    assert!(
        difference("restored") == 0.0 && difference("deserialized") == 0.0,
        "{found}"
    );
    assert!(difference("millisecond") < 1e-9, "{found}");
    for name in ["internal", "curved", "interpolated", "simulated"] {
        let file = dir.path().join(format!("{name}.csv"));
        let d = json(&["diagnose", text(&file), "--json"]);
        assert_eq!(d["outcome"], "located", "{name}: {d}");
        for (fault, truth) in [("fsj", 3.0), ("zeta", 0.3)] {
            let end = |k: &str| d[fault][k].as_f64().unwrap();
            println!("{name} {fault} {} .. {}", end("lo"), end("hi"));
            assert!(end("lo") <= truth && truth <= end("hi"), "{name}: {d}");
        }
    }
}
