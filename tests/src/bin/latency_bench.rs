//! `cargo run --release -p ema-tests --bin latency-bench -- --runs 400`: from the publication of the last needed sample to the
//! diagnosis, at peace and under load: while maps are being made, with 200 hostile connections at a bridge of the same domain, and with a
//! full disk for the log. Blocks of peace and load take turns. `taskset -c 0` before it puts everything on one core. Exit code 1
//! where p99 under load is 5 ms or more, or anything was not located.

use anyhow::{Context, Result, ensure};
use ema_tests::arguments::number;
use ema_tests::stream::{EXAMPLE_RUN, Program, TestDomain, announced};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use schemas::stream::diagnosis::DiagnosisSubscriber;
use schemas::stream::frame::RunDescription;
use schemas::stream::now_ns;
use schemas::stream::publisher::{Delivery, Publisher};
use schemas::telemetry::Collector;
use std::collections::HashMap;
use std::io::{Read, Write};
use std::net::TcpStream;
use std::path::Path;
use std::process::{Command, ExitCode};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Duration;

const LIMIT: Duration = Duration::from_secs(60);

/// Hostile connections at once.
const HOSTILE: usize = 200;

/// Rows of a frame, and the pause after each: 3 s of test in a tenth of that.
const ROWS: usize = 300;
const PAUSE: Duration = Duration::from_millis(3);

/// Tests of a block.
const BLOCK: usize = 25;

/// p50, p99 and the greatest [ms].
fn quantiles(mut ns: Vec<u64>) -> [f64; 3] {
    ns.sort_unstable();
    [0.5, 0.99, 1.0].map(|q| ns[((ns.len() - 1) as f64 * q).ceil() as usize] as f64 * 1e-6)
}

fn start(ema: &Path, domain: &TestDomain, cache: &Path, args: &[&str]) -> Program {
    let mut c = Command::new(ema);
    c.env("EMA_CACHE_DIR", cache).env("EMA_DOMAIN", &domain.name).args(args);
    Program::start(c)
}

/// A connection that does harm of some kind until it is closed, or for `patience`.
fn attack(to: &str, rng: &mut ChaCha8Rng, patience: Duration) {
    let Ok(mut s) = TcpStream::connect(to) else { return };
    let _ = s.set_read_timeout(Some(patience));
    let random: [u8; 256] = std::array::from_fn(|_| rng.random());
    let mut hello = b"ema-brg1".to_vec();
    hello.extend(0u32.to_le_bytes());
    hello.extend(10_000u32.to_le_bytes());
    hello.extend(&random[..48]);
    match rng.random_range(0..6) {
        0 => drop(s.write_all(&random)),
        // half a greeting
        1 => drop(s.write_all(&hello[..40])),
        // no secret where one is asked for
        2 => drop(s.write_all(&hello)),
        // another secret
        3 => {
            hello[8] = 1;
            drop(s.write_all(&hello).and_then(|()| s.write_all(&random[..32])));
        }
        // an Arrow message of 2 GB instead of a greeting
        4 => drop(s.write_all(&[0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0x7f])),
        // says nothing
        _ => {}
    }
    let _ = s.read(&mut [0; 256]);
}

/// Hostile connections, as many at once, while `is_on`; how many there have been.
fn hostile(to: &str, is_on: &Arc<AtomicBool>, over: &Arc<AtomicBool>) -> Arc<AtomicU64> {
    let count = Arc::<AtomicU64>::default();
    for k in 0..HOSTILE {
        let (to, is_on, over, count) = (to.to_string(), is_on.clone(), over.clone(), count.clone());
        std::thread::spawn(move || {
            let mut rng = ChaCha8Rng::seed_from_u64(k as u64);
            while !over.load(Ordering::Relaxed) {
                if is_on.load(Ordering::Relaxed) {
                    attack(&to, &mut rng, Duration::from_millis(2000));
                    count.fetch_add(1, Ordering::Relaxed);
                }
                // a refused one comes back
                std::thread::sleep(Duration::from_millis(rng.random_range(200..1000)));
            }
        });
    }
    count
}

fn send(p: &mut Publisher, telemetry: &Collector, about: &RunDescription, pause: Duration) -> Result<()> {
    let view = telemetry.view();
    let pass = p.begin(about, LIMIT, &|| true)?;
    let mut pass = pass.context("nobody wants the stream")?;
    for k in 0..view.rows / ROWS {
        std::thread::sleep(pause);
        let block = view.slice(k * ROWS, (k + 1) * ROWS);
        let mut frame = p.loan(&pass, block.first, block.rows)?;
        frame.view_mut().copy_from(&block);
        p.publish(&mut pass, frame)?;
    }
    p.end(&pass, LIMIT, &|| true)?;
    Ok(())
}

/// Final diagnoses that were heard, by run: outcome, from the last sample's publication to the diagnosis's, and to its arrival [ns].
type Heard = Arc<Mutex<HashMap<u64, (u32, u64, u64)>>>;

fn hearing(domain: &TestDomain, over: &Arc<AtomicBool>) -> Heard {
    let (heard, over) = (Heard::default(), over.clone());
    let (to, of) = (heard.clone(), domain.open());
    std::thread::spawn(move || {
        let mut diagnoses = DiagnosisSubscriber::open(&of, 0).unwrap();
        while !over.load(Ordering::Relaxed) {
            if let Ok(Some(m)) = diagnoses.next(Duration::from_millis(100))
                && m.is_final == 1
            {
                let times = (m.outcome, m.publish_ns - m.telemetry_ns, now_ns() - m.telemetry_ns);
                to.lock().unwrap().insert(m.run, times);
            }
        }
    });
    heard
}

fn run() -> Result<bool> {
    let runs = number("--runs", 400)? as usize;
    let ema = std::env::current_exe()?.with_file_name("ema-under-test");
    ensure!(
        ema.exists(),
        "{}: build it first: cargo build --release -p ema-tests --bins",
        ema.display()
    );
    let dir = tempfile::tempdir()?;
    let domain = TestDomain::default();
    let text = |p: &Path| p.to_str().expect("a plain path").to_string();
    let (file, secret, log) = (
        dir.path().join("run.parquet"),
        dir.path().join("secret"),
        dir.path().join("full.jsonl"),
    );
    std::fs::write(&secret, "correct horse battery staple")?;
    std::os::unix::fs::symlink("/dev/full", &log)?;
    for args in [
        &[&EXAMPLE_RUN[..], &[&text(&file)]].concat()[..],
        &["diagnose", &text(&file)],
    ] {
        let mut p = start(&ema, &domain, dir.path(), args);
        let ended = p.ends_within(Duration::from_secs(600));
        ensure!(ended.is_some_and(|s| s.success()), "{args:?}: {}", p.errors());
    }
    let m = pipeline::input::open(&file, Default::default())?;
    let about = |run: u64| announced(&m, run);
    let over = Arc::<AtomicBool>::default();
    let heard = hearing(&domain, &over);
    let secret = text(&secret);
    let listen = ["bridge", "receive", "--listen", "127.0.0.1:0", "--secret-file", &secret];
    let mut bridge = start(&ema, &domain, dir.path(), &listen);
    let to = bridge.address(LIMIT);
    let under_attack = Arc::<AtomicBool>::default();
    let attacks = hostile(&to, &under_attack, &over);
    let mut publisher = Publisher::open(&domain.open(), Delivery::Lossless, ROWS, 8)?;
    // odd rates, each of which maps are made for
    let mut odd = Publisher::open(&domain.open(), Delivery::Lossless, ROWS, 8)?;
    let mut times: [Vec<(u64, u64)>; 2] = Default::default();
    let (mut number, mut making, mut amiss) = (0, 0u64, Vec::new());
    while times[1].len() < runs {
        for (is_load, list) in times.iter_mut().enumerate() {
            let is_load = is_load == 1;
            let log = text(&log);
            let args = if is_load {
                &["live", "--json", "--log", &log][..]
            } else {
                &["live", "--json"]
            };
            let mut live = start(&ema, &domain, dir.path(), args);
            under_attack.store(is_load, Ordering::Relaxed);
            // the first test waits for its maps to be read
            for k in 0..=BLOCK {
                if is_load && k % 8 == 0 {
                    making += 1;
                    let rate_hz = m.rate_hz - 500.25 - making as f64;
                    let more = RunDescription {
                        actuator: format!("odd-{making}"),
                        rate_hz,
                        ..about(1_000_000 + making)
                    };
                    send(&mut odd, &m.telemetry, &more, Duration::ZERO)?;
                }
                number += 1;
                send(&mut publisher, &m.telemetry, &about(number), PAUSE)?;
                let start = std::time::Instant::now();
                let found = loop {
                    if let Some(f) = heard.lock().unwrap().remove(&number) {
                        break Some(f);
                    }
                    if start.elapsed() > LIMIT {
                        break None;
                    }
                    std::thread::sleep(Duration::from_millis(1));
                };
                match found {
                    Some((1, ..)) if k == 0 => {}
                    Some((1, published, arrived)) => list.push((published, arrived)),
                    other => amiss.push(format!("test {number}: {other:?}")),
                }
            }
            under_attack.store(false, Ordering::Relaxed);
            ensure!(live.has_ended().is_none(), "the diagnoser has ended: {}", live.errors());
            live.kill();
        }
        eprintln!("{} of {runs}", times[1].len());
    }
    over.store(true, Ordering::Relaxed);
    ensure!(
        bridge.has_ended().is_none(),
        "the bridge has ended: {}",
        bridge.errors()
    );
    println!(
        "| | tests | published p50 [ms] | p99 | greatest | received p50 [ms] | p99 | greatest |\n|---|---|---|---|---|---|---|---|"
    );
    let mut p99 = 0.0;
    for (what, list) in ["at peace", "under load"].iter().zip(&times) {
        let n = list.len();
        let (p, r) = (
            quantiles(list.iter().map(|t| t.0).collect()),
            quantiles(list.iter().map(|t| t.1).collect()),
        );
        p99 = p[1];
        println!(
            "| {what} | {n} | {:.2} | {:.2} | {:.2} | {:.2} | {:.2} | {:.2} |",
            p[0], p[1], p[2], r[0], r[1], r[2]
        );
    }
    let attacks = attacks.load(Ordering::Relaxed);
    println!("\n{attacks} hostile connections, {HOSTILE} at once; {making} map sets asked for");
    amiss.iter().for_each(|a| println!("{a}"));
    Ok(p99 < 5.0 && amiss.is_empty())
}

fn main() -> ExitCode {
    match run() {
        Ok(true) => ExitCode::SUCCESS,
        Ok(false) => ExitCode::FAILURE,
        Err(e) => {
            eprintln!("latency-bench: {e:#}");
            ExitCode::from(2)
        }
    }
}
