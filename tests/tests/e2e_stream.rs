//! Live diagnosis with real processes: what is sent live, replayed and read from a file gives the
//! same bits, and whatever happens to the plumbing is named.

use ema_tests::stream::{Program, TestDomain};
use schemas::stream::diagnosis::DiagnosisSubscriber;
use schemas::stream::frame::{FrameHeader, RunDescription};
use schemas::stream::publisher::{Delivery, FrameMut, Pass, Publisher};
use schemas::telemetry::Collector;
use serde_json::Value;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::OnceLock;
use std::time::Duration;

const LIMIT: Duration = Duration::from_secs(60);

fn cache() -> PathBuf {
    Path::new(env!("CARGO_TARGET_TMPDIR")).join("ema-cache")
}

fn ema(domain: &TestDomain, args: &[&str]) -> Command {
    let mut c = Command::new(env!("CARGO_BIN_EXE_ema-under-test"));
    c.env("EMA_CACHE_DIR", cache())
        .env("EMA_DOMAIN", &domain.name)
        .args(args);
    c
}

fn ok(domain: &TestDomain, args: &[&str]) -> String {
    let o = ema(domain, args).stdin(Stdio::null()).output().unwrap();
    let err = String::from_utf8_lossy(&o.stderr).into_owned();
    assert!(o.status.success(), "{args:?}: {err}");
    String::from_utf8(o.stdout).unwrap()
}

/// A recording with sensors and its offline diagnosis; made once, and with it the maps.
fn recording() -> &'static (PathBuf, Value) {
    static ONCE: OnceLock<(PathBuf, Value)> = OnceLock::new();
    ONCE.get_or_init(|| {
        let domain = TestDomain::default();
        let file = Path::new(env!("CARGO_TARGET_TMPDIR")).join("stream.parquet");
        let path = file.to_str().unwrap();
        let run = [
            "run", "--fsj", "3", "--zeta", "0.3", "--sensors", "reference", "--out", path,
        ];
        ok(&domain, &run);
        let offline = serde_json::from_str(&ok(&domain, &["diagnose", path, "--json"])).unwrap();
        (file, offline)
    })
}

fn live(domain: &TestDomain, args: &[&str]) -> Program {
    recording();
    let mut all = vec!["live", "--json"];
    all.extend(args);
    let mut p = Program::start(ema(domain, &all));
    let name = domain.name.clone();
    p.until("live starts", LIMIT, |_| TestDomain { name: name.clone() }.has_subscriber());
    p
}

trait HasSubscriber {
    fn has_subscriber(self) -> bool;
}
impl HasSubscriber for TestDomain {
    /// Whether somebody listens to the telemetry.
    fn has_subscriber(self) -> bool {
        let domain = self.open();
        // not ours to clean away
        std::mem::forget(self);
        let Ok(p) = Publisher::open(&domain, Delivery::RealTime, 1, 1) else {
            return false;
        };
        p.subscribers() > 0
    }
}

fn finals(p: &Program) -> Vec<Value> {
    p.json().into_iter().filter(|v| v["final"] == true).collect()
}

/// What must agree between offline and live.
fn same(offline: &Value, live: &Value) {
    for key in ["outcome", "fsj", "zeta", "area", "features", "contradicting", "reason"] {
        assert_eq!(offline[key], live[key], "{key}");
    }
}

/// The recording in memory, and how it is announced.
fn take() -> (Collector, RunDescription) {
    let (file, _) = recording();
    let m = pipeline::input::open(file, None).unwrap();
    let header = m.telemetry.header.clone().unwrap();
    let about = RunDescription {
        actuator: "rig".into(),
        parameters: m.parameters.clone(),
        sensors: m.sensors.clone(),
        sequence: m.sequence_fingerprint.clone(),
        run: 5,
        rate_hz: m.rate_hz,
        channels: header.channels,
        total_rows: m.telemetry.rows() as u64,
        load_n_m: 0.0,
    };
    (m.telemetry, about)
}

const ROWS: usize = 100;

/// Sends the recording frame by frame; `each` may change, drop or double frames.
fn send(
    publisher: &mut Publisher,
    telemetry: &Collector,
    about: &RunDescription,
    mut each: impl FnMut(u64, &mut Publisher, &mut Pass, FrameMut) -> bool,
) -> Option<schemas::stream::publisher::Ending> {
    let view = telemetry.view();
    let mut pass = publisher.begin(about, LIMIT, &|| true).unwrap().unwrap();
    for k in 0..(view.rows / ROWS) as u64 {
        let block = view.slice(k as usize * ROWS, (k as usize + 1) * ROWS);
        let mut frame = publisher.loan(&pass, block.first, block.rows).unwrap();
        frame.view_mut().copy_from(&block);
        if !each(k, publisher, &mut pass, frame) {
            return None;
        }
    }
    Some(publisher.end(&pass, LIMIT, &|| true).unwrap())
}

fn plain(_: u64, publisher: &mut Publisher, pass: &mut Pass, frame: FrameMut) -> bool {
    publisher.publish(pass, frame).unwrap();
    true
}

fn publisher(domain: &TestDomain) -> Publisher {
    Publisher::open(&domain.open(), Delivery::Lossless, ROWS, 8).unwrap()
}

/// Sends with `each` to a live diagnoser and returns its final diagnosis.
fn diagnosed(each: impl FnMut(u64, &mut Publisher, &mut Pass, FrameMut) -> bool) -> Value {
    let domain = TestDomain::default();
    let mut live = live(&domain, &["--exit-after", "1"]);
    let (telemetry, about) = take();
    send(&mut publisher(&domain), &telemetry, &about, each);
    live.until("diagnosis", LIMIT, |p| !finals(p).is_empty());
    finals(&live).remove(0)
}

fn incomplete(v: &Value, words: &[&str]) {
    assert_eq!(v["outcome"], "incomplete", "{v}");
    for w in words {
        assert!(v["reason"].as_str().unwrap().contains(w), "no `{w}` in {v}");
    }
}

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
    let mut third = DiagnosisSubscriber::open(&domain.open(), 0).unwrap();
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
    let mut received = 0;
    while let Some(m) = third.next(Duration::from_millis(100)).unwrap() {
        if m.is_final == 1 {
            assert_eq!(m.outcome, 1);
            assert_eq!(m.fsj_lo, offline["fsj"]["lo"].as_f64().unwrap());
            assert_eq!(m.zeta_hi, offline["zeta"]["hi"].as_f64().unwrap());
            assert_eq!(m.p2_a, offline["features"]["p2_a"].as_f64().unwrap());
            received += 1;
        }
    }
    assert_eq!(received, 2);
    // and the recordings made meanwhile are the recording
    let files: Vec<PathBuf> = std::fs::read_dir(&rec).unwrap().flatten().map(|e| e.path()).collect();
    assert_eq!(files.len(), 2, "{files:?}");
    let original = pipeline::input::open(file, None).unwrap();
    for f in &files {
        let copy = pipeline::input::open(f, None).unwrap();
        for c in original.telemetry.header.as_ref().unwrap().channels.iter() {
            assert_eq!(original.telemetry.column(c), copy.telemetry.column(c), "{}", c.name());
        }
        let again = ok(&domain, &["diagnose", f.to_str().unwrap(), "--json"]);
        same(offline, &serde_json::from_str(&again).unwrap());
    }
    let rows = schemas::recording::metadata(&log).unwrap();
    assert_eq!(rows["ema.schema_version"], "1");
}

#[test]
fn e2e_small_program_with_saved_maps_says_the_same() {
    let (file, offline) = recording();
    let domain = TestDomain::default();
    let maps = cache().join("maps");
    let mut c = Command::new(env!("CARGO_BIN_EXE_diagnoser-under-test"));
    c.env("EMA_DOMAIN", &domain.name)
        .args(["--json", "--exit-after", "1", "--maps", maps.to_str().unwrap()]);
    let mut p = Program::start(c);
    ok(&domain, &["replay", file.to_str().unwrap(), "--speed", "max"]);
    assert_eq!(p.code(), Some(0), "{}", p.errors());
    same(offline, &finals(&p)[0]);
}

#[test]
fn e2e_faults_of_frames_are_named() {
    let (_, offline) = recording();
    // untouched
    same(offline, &diagnosed(plain));
    // repeated: says nothing new
    let v = diagnosed(|k, p, pass, frame| {
        let again = (k == 70).then(|| {
            let mut f = p.loan(pass, k * ROWS as u64 + 1, ROWS).unwrap();
            f.view_mut().column_mut(schemas::channel::Channel::ThetaM).unwrap().fill(1.0);
            (f, pass.clone())
        });
        p.publish(pass, frame).unwrap();
        if let Some((f, mut old)) = again {
            p.publish(&mut old, f).unwrap();
        }
        true
    });
    same(offline, &v);
    // out of order: two frames change places
    let mut kept: Option<(FrameMut, Pass)> = None;
    let v = diagnosed(|k, p, pass, frame| {
        if k == 50 {
            kept = Some((frame, pass.clone()));
            // as if it had been sent
            let f = p.loan(pass, 1, 1).unwrap();
            drop(f);
            skip(pass);
            return true;
        }
        p.publish(pass, frame).unwrap();
        if let Some((f, mut old)) = kept.take() {
            p.publish(&mut old, f).unwrap();
        }
        true
    });
    incomplete(&v, &["frame 51 out of order", "100 samples lost (5001..5100)"]);
    // left out
    let v = diagnosed(|k, p, pass, frame| {
        if k == 60 || k == 61 {
            skip(pass);
            return true;
        }
        p.publish(pass, frame).unwrap();
        true
    });
    incomplete(&v, &["200 samples lost (6001..6200)"]);
    assert_eq!(v["samples_lost"], 200);
    // the last ones left out
    let v = diagnosed(|k, p, pass, frame| {
        if k >= 280 {
            skip(pass);
            return true;
        }
        p.publish(pass, frame).unwrap();
        true
    });
    incomplete(&v, &["20 frames lost before the last one", "2000 samples lost (28001..30000)"]);
    // truncated: the header promises more than there is
    let v = diagnosed(|k, p, pass, mut frame| {
        if k == 30 {
            frame.header_mut().stride = 800;
        }
        p.publish(pass, frame).unwrap();
        true
    });
    incomplete(&v, &["frame 31: truncated: 832 values; needed: 6400", "3001..3100"]);
    // not a number
    let v = diagnosed(|k, p, pass, mut frame| {
        if k == 90 {
            frame.view_mut().column_mut(schemas::channel::Channel::IB).unwrap()[7] = f64::NAN;
        }
        p.publish(pass, frame).unwrap();
        true
    });
    incomplete(&v, &["`i_b` is NaN at sample 9008", "9001..9100"]);
}

/// Numbers a frame that is not sent.
fn skip(pass: &mut Pass) {
    pass.skip_frame();
}

#[test]
fn e2e_unknown_actuator_and_foreign_frames_are_refused() {
    let domain = TestDomain::default();
    let mut live = live(&domain, &["--exit-after", "2"]);
    let (telemetry, about) = take();
    let mut p = publisher(&domain);
    let unknown = RunDescription {
        parameters: "00000000000000aa".into(),
        ..about.clone()
    };
    send(&mut p, &telemetry, &unknown, plain);
    live.until("refusal", LIMIT, |l| !finals(l).is_empty());
    incomplete(
        &finals(&live)[0],
        &["unknown actuator: parameters 00000000000000aa", "(reference)"],
    );
    // a frame of a future version in between: named on standard error, harms nobody
    send(&mut p, &telemetry, &about, |k, p, pass, mut frame| {
        if k == 10 {
            let mut odd = p.loan(pass, 1, ROWS).unwrap();
            *odd.header_mut() = FrameHeader {
                schema_version: 99,
                ..*odd.header_mut()
            };
            let mut other = pass.clone();
            p.publish(&mut other, odd).unwrap();
        }
        frame.header_mut().first_ns = 0;
        p.publish(pass, frame).unwrap();
        true
    });
    assert_eq!(live.code(), Some(3), "{}", live.errors());
    same(&recording().1, &finals(&live)[1]);
    assert!(
        live.errors().contains("schema version 99; allowed: 1"),
        "{}",
        live.errors()
    );
}

#[test]
fn e2e_two_publishers_for_one_actuator() {
    let domain = TestDomain::default();
    let mut live = live(&domain, &["--exit-after", "2"]);
    let (telemetry, about) = take();
    let mut second = None;
    let mut first = publisher(&domain);
    send(&mut first, &telemetry, &about, |k, p, pass, frame| {
        if k == 100 {
            let file = recording().0.to_str().unwrap().to_string();
            let args = ["replay", &file, "--speed", "max", "--id", "rig", "--run", "77"];
            second = Some(Program::start(ema(&domain, &args)));
        }
        if k == 200 {
            let s = second.as_mut().unwrap();
            // it is heard, and refused
            assert_eq!(s.code(), Some(0), "{}", s.errors());
        }
        p.publish(pass, frame).unwrap();
        true
    });
    assert_eq!(live.code(), Some(3), "{}", live.errors());
    let finals = finals(&live);
    let of = |run: u64| finals.iter().find(|v| v["run"] == run).unwrap();
    incomplete(of(77), &["two publishers for actuator `rig`", "is refused"]);
    same(&recording().1, of(5));
}

#[test]
fn e2e_killed_publisher_is_named_and_the_next_one_is_diagnosed() {
    let (file, offline) = recording();
    let domain = TestDomain::default();
    let mut live = live(&domain, &["--exit-after", "2"]);
    let args = ["replay", file.to_str().unwrap(), "--speed", "1"];
    let mut victim = Program::start(ema(&domain, &args));
    live.until("something so far", LIMIT, |p| !p.json().is_empty());
    victim.kill();
    live.until("verdict on the dead one", LIMIT, |p| !finals(p).is_empty());
    let process = format!("the publisher (process {}) died after sample", victim.id());
    incomplete(&finals(&live)[0], &[&process]);
    ok(&domain, &["replay", file.to_str().unwrap(), "--speed", "max"]);
    assert_eq!(live.code(), Some(3), "{}", live.errors());
    same(offline, &finals(&live)[1]);
    assert_eq!(domain.segments(), Vec::<PathBuf>::new());
}

#[test]
fn e2e_killed_diagnoser_costs_a_lossless_publisher_nothing() {
    let (file, offline) = recording();
    let domain = TestDomain::default();
    let mut first = live(&domain, &[]);
    let args = ["replay", file.to_str().unwrap(), "--speed", "2"];
    let mut replay = Program::start(ema(&domain, &args));
    first.until("something so far", LIMIT, |p| !p.json().is_empty());
    first.kill();
    let mut second = live(&domain, &[]);
    assert_eq!(replay.code(), Some(0), "{}", replay.errors());
    assert!(
        replay.lines()[0].contains("2. attempt"),
        "{:?} {}",
        replay.lines(),
        replay.errors()
    );
    // the second one met the end of the first attempt, and then the whole run
    let whole = |p: &Program| finals(p).iter().any(|v| v["outcome"] == "located");
    second.until("diagnosis", LIMIT, whole);
    let finals = finals(&second);
    same(offline, finals.last().unwrap());
    for v in &finals[..finals.len() - 1] {
        incomplete(v, &["sample 1 is missing"]);
    }
    second.interrupt();
    assert_eq!(second.code(), Some(130));
    assert_eq!(domain.segments(), Vec::<PathBuf>::new());
}

#[test]
fn e2e_any_order_of_starting_and_stale_memory() {
    let (file, offline) = recording();
    let domain = TestDomain::default();
    // both die: their memory stays
    let mut a = live(&domain, &[]);
    let args = ["replay", file.to_str().unwrap(), "--speed", "1"];
    let mut b = Program::start(ema(&domain, &args));
    a.until("something so far", LIMIT, |p| !p.json().is_empty());
    a.kill();
    b.kill();
    assert!(!domain.segments().is_empty());
    // the publisher first, and it waits; the next start cleans up without a person
    let mut b = Program::start(ema(&domain, &["replay", file.to_str().unwrap(), "--speed", "max"]));
    std::thread::sleep(Duration::from_millis(300));
    let mut a = live(&domain, &["--exit-after", "1"]);
    assert_eq!(b.code(), Some(0), "{}", b.errors());
    assert_eq!(a.code(), Some(0), "{}", a.errors());
    same(offline, &finals(&a)[0]);
    assert_eq!(domain.segments(), Vec::<PathBuf>::new());
}

#[test]
fn e2e_late_subscriber_does_not_stop_the_bench() {
    recording();
    let domain = TestDomain::default();
    let mut bench = Program::start(ema(&domain, &["bench-live", "--fsj", "2"]));
    std::thread::sleep(Duration::from_millis(800));
    let mut live = live(&domain, &["--exit-after", "1"]);
    assert_eq!(bench.code(), Some(3), "{}", bench.errors());
    assert!(bench.errors().contains("with nobody there"), "{}", bench.errors());
    assert_eq!(live.code(), Some(3), "{}", live.errors());
    incomplete(&finals(&live)[0], &["sample 1 is missing", "samples lost (1.."]);
}

#[test]
fn e2e_stopped_diagnoser_loses_frames_of_the_bench_and_says_so() {
    recording();
    let domain = TestDomain::default();
    let mut live = live(&domain, &["--exit-after", "1"]);
    // 1 ms frames fill the queue in half a second
    let mut bench = Program::start(ema(&domain, &["bench-live", "--frame-ms", "1", "--fsj", "2"]));
    let signal = |s: &str| {
        let _ = Command::new("kill").args([s, &live.id().to_string()]).status();
    };
    std::thread::sleep(Duration::from_millis(400));
    signal("-STOP");
    std::thread::sleep(Duration::from_millis(1200));
    signal("-CONT");
    assert_eq!(bench.code(), Some(3), "{}", bench.errors());
    assert!(bench.errors().contains("frames of bench"), "{}", bench.errors());
    assert_eq!(live.code(), Some(3), "{}", live.errors());
    incomplete(&finals(&live)[0], &["samples lost ("]);
}

#[test]
fn e2e_full_disk_for_the_log() {
    let (file, offline) = recording();
    let domain = TestDomain::default();
    let dir = tempfile::tempdir().unwrap();
    let log = dir.path().join("log.jsonl");
    std::os::unix::fs::symlink("/dev/full", &log).unwrap();
    let mut live = live(&domain, &["--exit-after", "1", "--log", log.to_str().unwrap()]);
    ok(&domain, &["replay", file.to_str().unwrap(), "--speed", "max"]);
    // diagnosed all the same; the loss is said, and the line is not gone
    assert_eq!(live.code(), Some(1), "{}", live.errors());
    same(offline, &finals(&live)[0]);
    let err = live.errors();
    assert!(err.contains("log.jsonl: cannot be written"), "{err}");
    assert!(
        err.contains("not in the log: {") && err.contains("1 diagnoses are not in it"),
        "{err}"
    );
}

#[test]
fn e2e_log_survives_kills_and_torn_lines() {
    let (file, offline) = recording();
    let domain = TestDomain::default();
    let dir = tempfile::tempdir().unwrap();
    let log = dir.path().join("log.jsonl");
    std::fs::write(&log, "{\"run\":1}\n{\"torn\":").unwrap();
    let args = ["--log", log.to_str().unwrap()];
    let mut first = live(&domain, &args);
    ok(&domain, &["replay", file.to_str().unwrap(), "--speed", "max", "--run", "2"]);
    let lines = || -> Vec<Value> {
        let text = std::fs::read_to_string(&log).unwrap();
        text.lines().map(|l| serde_json::from_str(l).unwrap()).collect()
    };
    first.until("logged", LIMIT, |_| {
        std::fs::read_to_string(&log).unwrap().lines().count() == 2
    });
    // a second writer of the same log is refused in one line
    let mut other = Program::start(ema(&domain, &["live", "--log", log.to_str().unwrap()]));
    assert_eq!(other.code(), Some(4), "{}", other.errors());
    assert!(other.errors().contains("is in use"), "{}", other.errors());
    first.kill();
    let mut second = live(&domain, &[&args[..], &["--exit-after", "1"]].concat());
    ok(&domain, &["replay", file.to_str().unwrap(), "--speed", "max", "--run", "3"]);
    assert_eq!(second.code(), Some(0), "{}", second.errors());
    let all = lines();
    assert_eq!(all.len(), 3);
    assert_eq!([&all[0]["run"], &all[1]["run"], &all[2]["run"]], [1, 2, 3]);
    same(offline, &all[2]);
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
        c.args(&all[1..]).env("EMA_DOMAIN", &far.name).env("EMA_CACHE_DIR", cache());
        Program::start(c)
    };
    let mut receiver = away(&["bridge", "receive", "--listen", listen]);
    receiver.until("listening", LIMIT, |p| p.errors().contains("listening on"));
    let said = receiver.errors();
    let to = said.lines().last().unwrap().rsplit(' ').next().unwrap();
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
    receiver.until("listening", LIMIT, |p| p.errors().contains("listening on"));
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
    let args = ["run", "--fsj", "3", "--zeta", "0.3", "--sensors", "reference", "--out", csv];
    ok(&domain, &args);
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
        same(offline, received);
    }
    let said = telemetry.lines().join(" ");
    assert_eq!(said.matches("30000").count(), 2, "{said}");
}

/// Killed while it makes the services, which iceoryx2 by itself does not recover from.
#[test]
fn e2e_killed_while_starting_leaves_nothing_in_the_way() {
    let (file, offline) = recording();
    let domain = TestDomain::default();
    for k in 0..40 {
        let mut p = Program::start(ema(&domain, &["live", "--plain"]));
        std::thread::sleep(Duration::from_micros(2000 + 500 * k));
        p.kill();
    }
    let mut live = live(&domain, &["--exit-after", "1"]);
    ok(&domain, &["replay", file.to_str().unwrap(), "--speed", "max"]);
    assert_eq!(live.code(), Some(0), "{}", live.errors());
    same(offline, &finals(&live)[0]);
    assert_eq!(domain.segments(), Vec::<PathBuf>::new());
}

/// Ten minutes of it are `cargo run --release -p ema-tests --bin soak`; this is a taste.
#[test]
fn e2e_soak_of_a_few_kills() {
    let (file, offline) = recording();
    let soak = ema_tests::soak::Soak {
        ema: Path::new(env!("CARGO_BIN_EXE_ema-under-test")),
        cache: &cache(),
        file,
        offline,
    };
    let seen = ema_tests::soak::soak(&soak, 12, 7, |_| ());
    println!("{seen:?}");
    assert_eq!(seen.faults(), Vec::<String>::new());
}
