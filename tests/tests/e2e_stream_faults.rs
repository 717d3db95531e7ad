//! Live diagnosis with real processes: whatever happens to the plumbing is named.

mod common;

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
            // it is heard, and refused: received, but without a diagnosis of its own
            assert_eq!(s.code(), Some(3), "{}", s.errors());
            assert!(s.errors().contains("is incomplete: two publishers"), "{}", s.errors());
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
    let dir = tempfile::tempdir().unwrap();
    for (name, kills) in [("log.jsonl", 8), ("log.parquet", 6)] {
        let log = dir.path().join(format!("of-{name}")).join(name);
        std::fs::create_dir_all(log.parent().unwrap()).unwrap();
        let soak = ema_tests::soak::Soak {
            ema: Path::new(env!("CARGO_BIN_EXE_ema-under-test")),
            listener: Path::new(env!("CARGO_BIN_EXE_soak")),
            cache: &stream_cache(),
            log: &log,
            file,
            offline,
        };
        let seen = ema_tests::soak::soak(&soak, kills, 7, |_| ());
        println!("{seen:?}");
        assert_eq!(seen.faults(), Vec::<String>::new());
    }
}

/// When a mute diagnoser is there.
#[derive(Clone, Copy, PartialEq)]
enum Mute {
    /// killed after its last answer: the frames are read, the diagnosis never comes
    UntilEnd,
    Always,
    /// a subscriber like others while the run begins, a diagnoser from its first samples on
    FromSamples,
}

/// A subscriber that answers everything, and calls itself a diagnoser without ever giving a diagnosis.
fn mute_diagnoser(domain: &TestDomain, mute: Mute) -> std::thread::JoinHandle<()> {
    use schemas::stream::diagnosis::DiagnosisPublisher;
    use schemas::stream::frame::{END, SAMPLES};
    use schemas::stream::subscriber::Subscriber;
    let domain = domain.open();
    let subscriber = Subscriber::open(&domain).unwrap();
    let diagnoser = move |s: &Subscriber| DiagnosisPublisher::open(&domain, s.node()).unwrap();
    let mut diagnoses = (mute != Mute::FromSamples).then(|| diagnoser(&subscriber));
    std::thread::spawn(move || {
        let (start, mut frames) = (std::time::Instant::now(), 0);
        while start.elapsed() < LIMIT {
            while let Some(f) = subscriber.receive().unwrap() {
                let h = *f.header();
                match h.kind {
                    SAMPLES => {
                        frames += 1;
                        diagnoses.get_or_insert_with(|| diagnoser(&subscriber));
                    }
                    _ => subscriber.answer(&h, frames).unwrap(),
                }
                if h.kind == END && mute == Mute::UntilEnd {
                    std::thread::sleep(Duration::from_millis(300));
                    drop(diagnoses);
                    return;
                }
                if h.kind == END {
                    std::thread::sleep(Duration::from_secs(3));
                    return;
                }
            }
            subscriber.wait(Duration::from_millis(20)).unwrap();
        }
    })
}

#[test]
fn e2e_received_is_not_diagnosed() {
    let file = recording().0.to_str().unwrap().to_string();
    let replayed = |domain: &TestDomain, more: &[&str]| {
        let mut p = Program::start(ema(domain, &[&["replay", &file, "--speed", "max"], more].concat()));
        let code = p.code();
        (code, p.errors(), p.lines())
    };
    // the diagnoser goes after the last answer
    let domain = TestDomain::default();
    let mute = mute_diagnoser(&domain, Mute::UntilEnd);
    let (code, errors, _) = replayed(&domain, &[]);
    assert_eq!(code, Some(3), "{errors}");
    assert!(
        errors.contains("received by 1, but not diagnosed: the diagnoser has gone"),
        "{errors}"
    );
    assert_eq!(errors.lines().count(), 1, "{errors}");
    mute.join().unwrap();
    // it stays, and says nothing
    let mute = mute_diagnoser(&domain, Mute::Always);
    let (code, errors, _) = replayed(&domain, &["--diagnosis-wait", "0.5"]);
    assert_eq!(code, Some(3), "{errors}");
    assert!(errors.contains("no final diagnosis within 0.5 s"), "{errors}");
    mute.join().unwrap();
    // it comes when another subscriber has let the run begin: it is not waited for as one that knows of it
    let mute = mute_diagnoser(&domain, Mute::FromSamples);
    let (code, errors, _) = replayed(&domain, &[]);
    assert_eq!(code, Some(3), "{errors}");
    assert!(errors.contains("the diagnoser came when the run had begun"), "{errors}");
    mute.join().unwrap();
    // nobody asked
    let mute = mute_diagnoser(&domain, Mute::Always);
    let (code, errors, lines) = replayed(&domain, &["--diagnosis", "off"]);
    assert_eq!(code, Some(0), "{errors}");
    assert!(lines[0].ends_with("received by 1"), "{lines:?}");
    mute.join().unwrap();
    // and with a diagnoser that does its work
    let mut live = live(&domain, &["--exit-after", "1"]);
    let (code, errors, lines) = replayed(&domain, &["--diagnosis", "required"]);
    assert_eq!(code, Some(0), "{errors}");
    assert!(lines[0].ends_with("received by 1; located"), "{lines:?}");
    assert_eq!(live.code(), Some(0), "{}", live.errors());
}

/// Killed after its final diagnosis, and started again before the stream has ended.
#[test]
fn e2e_a_restart_gives_no_second_diagnosis_of_a_stream() {
    let (_, offline) = recording();
    let domain = TestDomain::default();
    let dir = tempfile::tempdir().unwrap();
    for name in ["log.parquet", "log.jsonl"] {
        let log = dir.path().join(name);
        let args = ["--log", log.to_str().unwrap()];
        let mut first = live(&domain, &args);
        let mut second = None;
        let (telemetry, about) = take();
        let mut p = publisher(&domain);
        send(&mut p, &telemetry, &about, |k, p, pass, frame| {
            if k == 295 {
                // what was shown is in the log, whatever happens now
                first.until("final", LIMIT, |l| !finals(l).is_empty());
                first.kill();
                second = Some(live(&domain, &[&args[..], &["--exit-after", "1"]].concat()));
            }
            p.publish(pass, frame).unwrap();
            true
        });
        let again = RunDescription { run: 6, ..about };
        send(&mut p, &telemetry, &again, plain);
        let mut second = second.unwrap();
        assert_eq!(second.code(), Some(0), "{}", second.errors());
        let finals = finals(&second);
        assert_eq!(finals.len(), 1, "{finals:?}");
        assert_eq!(finals[0]["run"], 6);
        same(offline, &finals[0]);
        assert_eq!(logged_runs(&log), [5, 6]);
    }
}

/// Numbers of the runs in a log.
fn logged_runs(log: &Path) -> Vec<u64> {
    if log.extension().is_some_and(|x| x == "jsonl") {
        let text = std::fs::read_to_string(log).unwrap();
        let runs = text
            .lines()
            .map(|l| serde_json::from_str::<Value>(l).unwrap()["run"].as_u64().unwrap());
        return runs.collect();
    }
    let mut runs = Vec::new();
    for batch in schemas::table::read_batches(log).unwrap() {
        let column = batch.column_by_name("run").unwrap();
        let column = column.as_any().downcast_ref::<arrow::array::UInt64Array>().unwrap();
        runs.extend(column.values());
    }
    runs
}

fn copy(from: &Path, to: &Path) {
    std::fs::create_dir_all(to).unwrap();
    for e in std::fs::read_dir(from).unwrap().flatten() {
        let target = to.join(e.file_name());
        match e.file_type().unwrap().is_dir() {
            true => copy(&e.path(), &target),
            false => drop(std::fs::copy(e.path(), target).unwrap()),
        }
    }
}

#[test]
fn e2e_making_maps_holds_nobody_up() {
    let (_, offline) = recording();
    let domain = TestDomain::default();
    let dir = tempfile::tempdir().unwrap();
    // the maps of the honest run, and no others
    copy(&stream_cache().join("maps"), &dir.path().join("maps"));
    let started = |args: &[&str]| {
        let mut c = ema(&domain, &[&["live", "--json"], args].concat());
        c.env("EMA_CACHE_DIR", dir.path());
        Program::start(c)
    };
    let (telemetry, about) = take();
    let odd = |k: u64| RunDescription {
        actuator: format!("odd-{k}"),
        run: 100 + k,
        rate_hz: 9000.25 + k as f64,
        ..about.clone()
    };
    let mut p = publisher(&domain);
    let mut live = started(&[]);
    for k in 0..6 {
        // eight samples, and the end
        let mut pass = p.begin(&odd(k), LIMIT, &|| true).unwrap().unwrap();
        let block = telemetry.view().slice(0, 8);
        let mut frame = p.loan(&pass, block.first, block.rows).unwrap();
        frame.view_mut().copy_from(&block);
        p.publish(&mut pass, frame).unwrap();
        p.end(&pass, LIMIT, &|| true).unwrap();
    }
    // a whole test that maps have to be made for, then one whose maps are there
    send(&mut p, &telemetry, &odd(6), plain);
    send(&mut p, &telemetry, &about, plain);
    live.until("honest diagnosis", LIMIT, |l| finals(l).iter().any(|v| v["run"] == 5));
    let said = finals(&live);
    let of = |run: u64| said.iter().find(|v| v["run"] == run);
    same(offline, of(5).unwrap());
    for k in 0..6 {
        incomplete(of(100 + k).unwrap(), &["none are made for 8 samples"]);
    }
    // they are being made still
    assert!(of(106).is_none(), "{said:?}");
    live.kill();
    // and are not made where that is switched off
    let mut live = started(&["--no-make", "--exit-after", "1"]);
    send(&mut p, &telemetry, &odd(6), plain);
    assert_eq!(live.code(), Some(3), "{}", live.errors());
    incomplete(&finals(&live)[0], &["no maps for", "--no-make"]);
}
