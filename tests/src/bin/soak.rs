//! `cargo run --release -p ema-tests --bin soak -- 1000`: kills diagnoser, publishers, bridge and subscribers so many times, half with a
//! log of lines and half with a table, then says what it has seen; exit code 1 if anything is not as it should be. A second number
//! is the seed.

use ema_tests::soak::{LISTENER, Soak, listen, soak};
use ema_tests::stream::EXAMPLE_RUN;
use std::process::{Command, ExitCode};

fn main() -> ExitCode {
    if std::env::args().nth(1).is_some_and(|a| a == LISTENER) {
        listen();
    }
    let arguments: Vec<u64> = std::env::args().skip(1).filter_map(|a| a.parse().ok()).collect();
    let kills = arguments.first().copied().unwrap_or(1000);
    let seed = arguments.get(1).copied().unwrap_or(1);
    let listener = std::env::current_exe().expect("a path");
    let ema = listener.with_file_name("ema-under-test");
    let dir = tempfile::tempdir().expect("a temporary folder");
    let file = dir.path().join("run.parquet");
    let run = |args: &[&str]| {
        let c = Command::new(&ema).args(args).env("EMA_CACHE_DIR", dir.path()).output();
        c.expect("the program is built with this one").stdout
    };
    let path = file.to_str().expect("a plain path");
    run(&[&EXAMPLE_RUN[..], &[path]].concat());
    let offline = serde_json::from_slice(&run(&["diagnose", path, "--json"])).expect("a diagnosis");
    let mut code = 0;
    for (share, name) in [(kills.div_ceil(2), "log.jsonl"), (kills / 2, "log.parquet")] {
        let log = dir.path().join(name.replace('.', "-")).join(name);
        std::fs::create_dir_all(log.parent().expect("a folder")).expect("a temporary folder");
        let setting = Soak {
            ema: &ema,
            listener: &listener,
            cache: dir.path(),
            log: &log,
            file: &file,
            offline: &offline,
        };
        let start = std::time::Instant::now();
        let mut next = 50;
        let seen = soak(&setting, share, seed, |s| {
            if s.kills() >= next {
                let t = start.elapsed().as_secs_f64();
                let left = t / s.kills() as f64 * share.saturating_sub(s.kills()) as f64;
                eprintln!("{} kills in {t:.0} s, {left:.0} s left; {} runs", s.kills(), s.runs);
                next += 50;
            }
        });
        println!("{name}: {seen:#?}");
        println!("{} kills in {:.0} s", seen.kills(), start.elapsed().as_secs_f64());
        for f in seen.faults() {
            println!("FAULT {f}");
            code = 1;
        }
    }
    ExitCode::from(code)
}
