//! What the tests of the programs share: `ema` as a process; for streams, a recording and its offline diagnosis.
#![allow(dead_code)]

pub mod process;

use ema_tests::stream::{EXAMPLE_RUN, Program, TestDomain, announced};
use schemas::stream::frame::RunDescription;
use schemas::stream::publisher::{Delivery, FrameMut, Pass, Publisher};
use schemas::telemetry::Collector;
use serde_json::Value;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::OnceLock;
use std::time::Duration;

pub const LIMIT: Duration = Duration::from_secs(60);

pub fn ema(domain: &TestDomain, args: &[&str]) -> Command {
    let mut c = process::ema(args);
    c.env("EMA_DOMAIN", &domain.name).env("EMA_CACHE_DIR", stream_cache());
    c
}

/// The cache of maps of tests of streams, of one grid: among several that serve, the latest is taken.
pub fn stream_cache() -> PathBuf {
    process::cache().join("streams")
}

pub fn ok(domain: &TestDomain, args: &[&str]) -> String {
    process::succeeded(&mut ema(domain, args))
}

/// A recording with sensors and its offline diagnosis; made once, and with it the maps.
pub fn recording() -> &'static (PathBuf, Value) {
    static ONCE: OnceLock<(PathBuf, Value)> = OnceLock::new();
    ONCE.get_or_init(|| {
        let domain = TestDomain::default();
        let file = Path::new(env!("CARGO_TARGET_TMPDIR")).join("stream.parquet");
        let path = file.to_str().unwrap();
        ok(&domain, &[&EXAMPLE_RUN[..], &[path]].concat());
        let offline = serde_json::from_str(&ok(&domain, &["diagnose", path, "--json"])).unwrap();
        (file, offline)
    })
}

pub fn live(domain: &TestDomain, args: &[&str]) -> Program {
    recording();
    let mut all = vec!["live", "--json"];
    all.extend(args);
    let mut p = Program::start(ema(domain, &all));
    let name = domain.name.clone();
    p.until("live starts", LIMIT, |_| {
        TestDomain { name: name.clone() }.has_subscriber()
    });
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

pub fn finals(p: &Program) -> Vec<Value> {
    p.json().into_iter().filter(|v| v["final"] == true).collect()
}

/// What must agree between offline and live.
pub fn same(offline: &Value, live: &Value) {
    for key in ["outcome", "fsj", "zeta", "area", "contradicting", "reason", "features"] {
        assert_eq!(offline[key], live[key], "{key}");
    }
}

/// The recording in memory, and how it is announced.
pub fn take() -> (Collector, RunDescription) {
    let (file, _) = recording();
    let m = pipeline::input::open(file, Default::default()).unwrap();
    let about = announced(&m, 5);
    (m.telemetry, about)
}

pub const ROWS: usize = 100;

/// Sends the recording frame by frame; `each` may change, drop or double frames.
pub fn send(
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

pub fn plain(_: u64, publisher: &mut Publisher, pass: &mut Pass, frame: FrameMut) -> bool {
    publisher.publish(pass, frame).unwrap();
    true
}

pub fn publisher(domain: &TestDomain) -> Publisher {
    Publisher::open(&domain.open(), Delivery::Lossless, ROWS, 8).unwrap()
}

/// Sends with `each` to a live diagnoser and returns its final diagnosis.
pub fn diagnosed(each: impl FnMut(u64, &mut Publisher, &mut Pass, FrameMut) -> bool) -> Value {
    let domain = TestDomain::default();
    let mut live = live(&domain, &["--exit-after", "1"]);
    let (telemetry, about) = take();
    send(&mut publisher(&domain), &telemetry, &about, each);
    live.until("diagnosis", LIMIT, |p| !finals(p).is_empty());
    finals(&live).remove(0)
}

pub fn incomplete(v: &Value, words: &[&str]) {
    assert_eq!(v["outcome"], "incomplete", "{v}");
    for w in words {
        assert!(v["reason"].as_str().unwrap().contains(w), "no `{w}` in {v}");
    }
}
