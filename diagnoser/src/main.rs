//! The live diagnoser as a small program of its own, for a flight or test-bench computer: it does
//! not make maps, it is given them.

use clap::Parser;
use diagnoser::cli::LiveArgs;
use diagnoser::map_library::MapLibrary;
use diagnoser::receive::no_maps;
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

const AFTER: &str = "Maps are made by `ema maps` or `ema live`; name them with --maps.\n\
    Example: diagnoser --maps maps --log diagnoses.jsonl\n\
    Exit codes: 0 done | 1 unforeseen failure, for example a full disk | 2 wrong command line | 3 a diagnosis was \
    incomplete | 4 bad input: one line says place, value found and what is allowed | 130 interrupted";

#[derive(Parser)]
#[command(
    name = "diagnoser",
    version,
    about = "Diagnoses telemetry in shared memory while the test runs",
    after_help = AFTER
)]
struct Program {
    #[command(flatten)]
    live: LiveArgs,
}

fn run(program: &Program, stop: &Arc<AtomicBool>) -> schemas::error::Result<u8> {
    let library = MapLibrary::open(&program.live.maps)?;
    let (known, _) = program.live.known()?;
    let hint = "make them with `ema maps`, name them with --maps";
    let source = move |key: &_| library.find(key).ok_or_else(|| no_maps(key, hint));
    program.live.run(known, Box::new(source), stop)
}

fn main() -> ExitCode {
    let program = Program::parse();
    let stop = Arc::new(AtomicBool::new(false));
    let flag = stop.clone();
    let _ = ctrlc::set_handler(move || {
        if flag.swap(true, Ordering::SeqCst) {
            std::process::exit(i32::from(schemas::error::EXIT_INTERRUPTED));
        }
    });
    match run(&program, &stop) {
        Ok(code) => ExitCode::from(code),
        Err(e) => {
            eprintln!("diagnoser: {e}");
            ExitCode::from(e.exit_code())
        }
    }
}
