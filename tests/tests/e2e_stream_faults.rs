//! Live diagnosis with real processes: whatever happens to the plumbing is named.

mod common;

use common::process::cache;
use common::*;
use ema_tests::stream::Program;
use ema_tests::stream::TestDomain;
use schemas::stream::frame::{FrameHeader, RunDescription};
use schemas::stream::publisher::{FrameMut, Pass};
use serde_json::Value;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Duration;

#[test]
fn e2e_faults_of_frames_are_named() {
    let (_, offline) = recording();
    // untouched
    same(offline, &diagnosed(plain));
    // repeated: says nothing new
    let v = diagnosed(|k, p, pass, frame| {
        let again = (k == 70).then(|| {
            let mut f = p.loan(pass, k * ROWS as u64 + 1, ROWS).unwrap();
            f.view_mut()
                .column_mut(schemas::channel::Channel::ThetaM)
                .unwrap()
                .fill(1.0);
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
    incomplete(
        &v,
        &["20 frames lost before the last one", "2000 samples lost (28001..30000)"],
    );
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
    ok(
        &domain,
        &["replay", file.to_str().unwrap(), "--speed", "max", "--run", "2"],
    );
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
    ok(
        &domain,
        &["replay", file.to_str().unwrap(), "--speed", "max", "--run", "3"],
    );
    assert_eq!(second.code(), Some(0), "{}", second.errors());
    let all = lines();
    assert_eq!(all.len(), 3);
    assert_eq!([&all[0]["run"], &all[1]["run"], &all[2]["run"]], [1, 2, 3]);
    same(offline, &all[2]);
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
