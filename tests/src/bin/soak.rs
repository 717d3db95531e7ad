//! `cargo run --release -p ema-tests --bin soak -- 1000`: kills diagnoser and publishers so many
//! times, then says what it has seen; exit code 1 if anything is not as it should be.

use ema_tests::soak::{Soak, soak};
use ema_tests::stream::EXAMPLE_RUN;
use std::process::{Command, ExitCode};

fn main() -> ExitCode {
    let arguments: Vec<u64> = std::env::args().skip(1).filter_map(|a| a.parse().ok()).collect();
    let kills = arguments.first().copied().unwrap_or(1000);
    let seed = arguments.get(1).copied().unwrap_or(1);
    let ema = std::env::current_exe()
        .expect("a path")
        .with_file_name("ema-under-test");
    let dir = std::env::temp_dir().join("ema-soak");
    std::fs::create_dir_all(&dir).expect("a temporary folder");
    let file = dir.join("run.parquet");
    let run = |args: &[&str]| {
        let c = Command::new(&ema).args(args).env("EMA_CACHE_DIR", &dir).output();
        c.expect("the program is built with this one").stdout
    };
    let path = file.to_str().expect("a plain path");
    run(&[&EXAMPLE_RUN[..], &[path]].concat());
    let offline = serde_json::from_slice(&run(&["diagnose", path, "--json"])).expect("a diagnosis");
    let setting = Soak {
        ema: &ema,
        cache: &dir,
        file: &file,
        offline: &offline,
    };
    let start = std::time::Instant::now();
    let mut next = 50;
    let seen = soak(&setting, kills, seed, |s| {
        if s.kills() >= next {
            let t = start.elapsed().as_secs_f64();
            let left = t / s.kills() as f64 * kills.saturating_sub(s.kills()) as f64;
            eprintln!("{} kills in {t:.0} s, {left:.0} s left; {} runs", s.kills(), s.runs);
            next += 50;
        }
    });
    let _ = std::fs::remove_dir_all(&dir);
    println!("{seen:#?}");
    println!("{} kills in {:.0} s", seen.kills(), start.elapsed().as_secs_f64());
    let faults = seen.faults();
    for f in &faults {
        println!("FAULT {f}");
    }
    ExitCode::from(u8::from(!faults.is_empty()))
}
