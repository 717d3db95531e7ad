//! Live diagnosis with real processes: what is sent live, replayed, bridged or read from a file gives
//! the same bits, in Rust and in Python.

mod common;

use common::*;
use ema_tests::stream::{EXAMPLE_RUN, Program, TestDomain};
use schemas::feature::Feature;
use schemas::stream::diagnosis::DiagnosisSubscriber;
use serde_json::Value;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

#[test]
fn e2e_live_replay_and_offline_give_the_same_bits() {
    let (file, offline) = recording();
    let domain = TestDomain::default();
    let dir = tempfile::tempdir().unwrap();
    let rec = dir.path().join("rec");
    let log = dir.path().join("log.parquet");
    let args = [
        "--exit-after",
        "2",
        "--record",
        rec.to_str().unwrap(),
        "--log",
        log.to_str().unwrap(),
    ];
    let mut live = live(&domain, &args);
    // a third process listens all the while: a subscriber meets a publisher only while both live
    let over = Arc::new(AtomicBool::new(false));
    let third = {
        let (over, shared) = (over.clone(), domain.open());
        std::thread::spawn(move || {
            let mut third = DiagnosisSubscriber::open(&shared, 0).unwrap();
            let mut finals = Vec::new();
            loop {
                let last = over.load(Ordering::Relaxed);
                while let Some(m) = third.next(Duration::from_millis(20)).unwrap() {
                    finals.extend((m.is_final == 1).then_some(m));
                }
                if last {
                    return finals;
                }
            }
        })
    };
    // replayed
    let said = ok(
        &domain,
        &["replay", file.to_str().unwrap(), "--speed", "max", "--frame-ms", "7"],
    );
    assert!(said.contains("30000 samples"), "{said}");
    // live: the same actuator, faults and seed in real time
    ok(&domain, &["bench-live", "--fsj", "3", "--zeta", "0.3"]);
    assert_eq!(live.code(), Some(0), "{}", live.errors());
    let finals = finals(&live);
    assert_eq!(finals.len(), 2, "{finals:?}");
    same(offline, &finals[0]);
    same(offline, &finals[1]);
    // the third process has received the same
    over.store(true, Ordering::Relaxed);
    let received = third.join().unwrap();
    assert_eq!(received.len(), 2);
    for m in received {
        assert_eq!(m.outcome, 1);
        assert_eq!(m.fsj_lo, offline["fsj"]["lo"].as_f64().unwrap());
        assert_eq!(m.zeta_hi, offline["zeta"]["hi"].as_f64().unwrap());
        for f in Feature::TOLD {
            assert_eq!(m.feature(f), offline["features"][f.key()].as_f64(), "{}", f.key());
        }
    }
    // and the recordings made meanwhile are the recording
    let files: Vec<PathBuf> = std::fs::read_dir(&rec).unwrap().flatten().map(|e| e.path()).collect();
    assert_eq!(files.len(), 2, "{files:?}");
    let original = pipeline::input::open(file, Default::default()).unwrap();
    for f in &files {
        let copy = pipeline::input::open(f, Default::default()).unwrap();
        for c in original.telemetry.header.as_ref().unwrap().channels.iter() {
            assert_eq!(original.telemetry.column(c), copy.telemetry.column(c), "{}", c.name());
        }
        let again = ok(&domain, &["diagnose", f.to_str().unwrap(), "--json"]);
        same(offline, &serde_json::from_str(&again).unwrap());
    }
    let rows = schemas::table::metadata(&log).unwrap();
    assert_eq!(rows["ema.schema_version"], "1");
}

#[test]
fn e2e_small_program_with_saved_maps_says_the_same() {
    let (file, offline) = recording();
    let domain = TestDomain::default();
    let maps = stream_cache().join("maps");
    let mut c = Command::new(env!("CARGO_BIN_EXE_diagnoser-under-test"));
    c.env("EMA_DOMAIN", &domain.name)
        .args(["--json", "--exit-after", "1", "--maps", maps.to_str().unwrap()]);
    let mut p = Program::start(c);
    ok(&domain, &["replay", file.to_str().unwrap(), "--speed", "max"]);
    assert_eq!(p.code(), Some(0), "{}", p.errors());
    same(offline, &finals(&p)[0]);
}

#[test]
fn refuse_bad_options_of_the_stream() {
    let domain = TestDomain::default();
    let refused = |args: &[&str], words: &[&str]| {
        let o = ema(&domain, args).stdin(Stdio::null()).output().unwrap();
        let err = String::from_utf8_lossy(&o.stderr).into_owned();
        assert_eq!(o.status.code(), Some(4), "{args:?}: {err}");
        assert_eq!(err.trim_end().lines().count(), 1, "{err}");
        for w in words {
            assert!(err.contains(w), "no `{w}` in {err}");
        }
    };
    refused(&["live", "--domain", "a/b"], &["domain", "a/b", "letters"]);
    refused(&["live", "--log", "x.csv"], &["--log", "x.csv", ".jsonl"]);
    refused(&["live", "--timeout=-1"], &["--timeout", "-1"]);
    refused(&["live", "--maps", "/nowhere"], &["/nowhere", "maps"]);
    refused(&["replay", "/nowhere.parquet"], &["/nowhere.parquet", "cannot be read"]);
    refused(&["replay", "x.csv", "--speed", "fast"], &["--speed", "fast", "max"]);
    refused(&["bench-live", "--frame-ms", "0"], &["--frame-ms", "0"]);
    refused(&["bench-live", "--id", ""], &["--id", "1 to 32"]);
    refused(
        &["bench-live", "--frame-ms", "900"],
        &["--frame-ms", "900", "at most 819.2 ms"],
    );
    refused(&["live", "--exit-after", "0"], &["--exit-after", "at least 1"]);
    refused(&["live", "--timeout", "inf"], &["--timeout", "inf", "at most 1000000"]);
    refused(&["replay", "x.csv", "--speed", "1e-9"], &["--speed", "1e-9", "0.001"]);
    refused(
        &["replay", "x.csv", "--diagnosis-wait", "0"],
        &["--diagnosis-wait", "above 0"],
    );
    for coverage in ["2", "1", "0", "-0.5", "NaN"] {
        let option = format!("--coverage={coverage}");
        for command in [&["live"][..], &["diagnose", "x.csv"], &["calibrate", "/nowhere"]] {
            let words = ["--coverage", coverage, "above 0 and below 1"];
            refused(&[command, &[&option]].concat(), &words);
        }
    }
}

/// Replays in one domain, diagnoses in another, with a bridge between; `prefix` is put before the
/// programs of the far side.
fn bridged(listen: &str, prefix: &[&str]) {
    let (file, offline) = recording();
    let (near, far) = (TestDomain::default(), TestDomain::default());
    let away = |args: &[&str]| {
        let mut all: Vec<String> = prefix.iter().map(|s| s.to_string()).collect();
        all.push(env!("CARGO_BIN_EXE_ema-under-test").into());
        all.extend(args.iter().map(|s| s.to_string()));
        let mut c = Command::new(&all[0]);
        c.args(&all[1..])
            .env("EMA_DOMAIN", &far.name)
            .env("EMA_CACHE_DIR", stream_cache());
        Program::start(c)
    };
    let mut receiver = away(&["bridge", "receive", "--listen", listen]);
    let to = &receiver.address(LIMIT);
    let mut sender = Program::start(ema(&near, &["bridge", "send", "--to", to]));
    sender.until("connection", LIMIT, |p| p.errors().contains("connected"));
    // nobody is there yet: the far diagnoser's answer is waited for
    let args = ["replay", file.to_str().unwrap(), "--speed", "max"];
    let mut replay = Program::start(ema(&near, &args));
    std::thread::sleep(Duration::from_millis(200));
    let mut live = away(&["live", "--json", "--exit-after", "1"]);
    assert_eq!(live.code(), Some(0), "{} {}", live.errors(), receiver.errors());
    same(offline, &finals(&live)[0]);
    assert_eq!(replay.code(), Some(0), "{}", replay.errors());
    assert!(replay.lines()[0].contains("received by 1"), "{:?}", replay.lines());
    // the receiving end dies and comes again: the run is sent again until it has arrived whole
    let mut replay = Program::start(ema(&near, &["replay", args[1], "--speed", "3"]));
    let mut live = away(&["live", "--json", "--exit-after", "3"]);
    live.until("something so far", LIMIT, |p| !p.json().is_empty());
    receiver.kill();
    let mut receiver = away(&["bridge", "receive", "--listen", to]);
    receiver.address(LIMIT);
    assert_eq!(live.code(), Some(3), "{} {}", live.errors(), receiver.errors());
    assert_eq!(replay.code(), Some(0), "{} {}", replay.errors(), sender.errors());
    incomplete(&finals(&live)[0], &["died after sample"]);
    incomplete(&finals(&live)[1], &["sample 1 is missing"]);
    same(offline, &finals(&live)[2]);
    sender.interrupt();
    receiver.interrupt();
    assert_eq!((sender.code(), receiver.code()), (Some(130), Some(130)));
    assert_eq!((near.segments(), far.segments()), (Vec::new(), Vec::new()));
}

#[test]
fn e2e_bridge_between_two_processes() {
    bridged("127.0.0.1:0", &[]);
}

#[test]
fn e2e_bridge_between_two_network_namespaces() {
    let name = format!("ema{}", std::process::id());
    let ip = |args: &str| {
        let args: Vec<&str> = args.split(' ').collect();
        let status = Command::new("ip").args(args).stderr(Stdio::null()).status();
        status.is_ok_and(|s| s.success())
    };
    struct Namespace(String);
    impl Drop for Namespace {
        fn drop(&mut self) {
            let _ = Command::new("ip").args(["netns", "del", &self.0]).status();
        }
    }
    if !ip(&format!("netns add {name}")) {
        println!("skipped: no network namespace can be made here");
        return;
    }
    let _namespace = Namespace(name.clone());
    let (a, b) = (format!("{name}a"), format!("{name}b"));
    let steps = [
        format!("link add {a} type veth peer name {b} netns {name}"),
        format!("addr add 10.77.0.1/24 dev {a}"),
        format!("link set {a} up"),
        format!("-n {name} addr add 10.77.0.2/24 dev {b}"),
        format!("-n {name} link set {b} up"),
    ];
    if !steps.iter().all(|s| ip(s)) {
        println!("skipped: no pair of virtual links can be made here");
        return;
    }
    bridged("10.77.0.2:7745", &["ip", "netns", "exec", &name]);
}

/// The Python interpreter of `EMA_PYTHON` (else `python3`), if it has the public bindings.
fn python() -> Option<String> {
    let python = std::env::var("EMA_PYTHON").unwrap_or_else(|_| "python3".into());
    let check = ["-c", "import iceoryx2"];
    let found = Command::new(&python).args(check).stderr(Stdio::null()).status();
    if found.is_ok_and(|s| s.success()) {
        return Some(python);
    }
    println!("skipped: no Python with iceoryx2 (pip install iceoryx2==0.10.0, EMA_PYTHON names the interpreter)");
    None
}

#[test]
fn e2e_python_publishes_and_subscribes() {
    let Some(python) = python() else { return };
    let (file, offline) = recording();
    let domain = TestDomain::default();
    let examples = Path::new(env!("CARGO_MANIFEST_DIR")).join("../schemas/examples/python");
    let example = |name: &str, args: &[&str]| {
        let mut c = Command::new(&python);
        c.env("EMA_DOMAIN", &domain.name)
            .env("PYTHONUNBUFFERED", "1")
            .env("PYTHONDONTWRITEBYTECODE", "1")
            .arg(examples.join(name))
            .args(args);
        Program::start(c)
    };
    // Python comes first, and makes the services
    let mut diagnoses = example("watch_diagnoses.py", &["--json", "--count", "2", "--timeout", "60"]);
    let mut telemetry = example("watch_telemetry.py", &["--count", "2", "--timeout", "60"]);
    std::thread::sleep(Duration::from_millis(700));
    let mut live = live(&domain, &["--exit-after", "2"]);
    ok(&domain, &["replay", file.to_str().unwrap(), "--speed", "max"]);
    // a Python program as acquisition
    let dir = tempfile::tempdir().unwrap();
    let csv = dir.path().join("run.csv");
    let csv = csv.to_str().unwrap();
    ok(&domain, &[&EXAMPLE_RUN[..], &[csv]].concat());
    let mut acquisition = example("publish_telemetry.py", &[csv, "--speed", "max"]);
    assert_eq!(acquisition.code(), Some(0), "{}", acquisition.errors());
    assert_eq!(live.code(), Some(0), "{}", live.errors());
    assert_eq!(telemetry.code(), Some(0), "{}", telemetry.errors());
    assert_eq!(diagnoses.code(), Some(0), "{}", diagnoses.errors());
    // a CSV file has 12 digits: its own diagnosis is the one to compare with
    let of_csv: Value = serde_json::from_str(&ok(&domain, &["diagnose", csv, "--json"])).unwrap();
    let (sent, received) = (finals(&live), diagnoses.json());
    assert_eq!((sent.len(), received.len()), (2, 2));
    for (offline, (sent, received)) in [offline, &of_csv].iter().zip(sent.iter().zip(&received)) {
        same(offline, sent);
        // messages do not tell the later witnesses
        let mut told = (*offline).clone();
        let in_messages = |key: &str| Feature::TOLD.iter().any(|f| f.key() == key);
        told["features"]
            .as_object_mut()
            .unwrap()
            .retain(|key, _| in_messages(key));
        same(&told, received);
    }
    let said = telemetry.lines().join(" ");
    assert_eq!(said.matches("30000").count(), 2, "{said}");
}
