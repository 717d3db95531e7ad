//! Writes a simulated fleet into files.

use std::path::PathBuf;
use std::process::ExitCode;

use ema_tests::lives::diagnosis::Noise;
use ema_tests::lives::{Bed, Options, files, generate};

const USAGE: &str = "\
usage: lives [options] --out DIR
  --units N              number of units (200)
  --seed S               seed of all random numbers (1)
  --noise bench|fleet    how good the diagnoses are (bench)
  --healthy N            N units without wear instead
  --tests T              flights of each healthy unit (300)
  --ar1 PHI              correlation of the errors from test to test (0)
  --triple               linear wear whose rate triples, no repairs
  --repairs-unrecorded   every unit repaired once without a record
  --two-faults           zeta wears too
  --out DIR              folder for history.csv, events.csv, truth.csv, key.json";

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    if arguments.iter().any(|a| a == "--help" || a == "-h") {
        println!("{USAGE}");
        return ExitCode::SUCCESS;
    }
    match run(&arguments) {
        Ok(()) => ExitCode::SUCCESS,
        Err(message) => {
            eprintln!("lives: {message}\n{USAGE}");
            ExitCode::from(2)
        }
    }
}

fn run(arguments: &[String]) -> Result<(), String> {
    let (options, out) = parse(arguments)?;
    let units = generate(&options);
    files::write(&out, &options, &units).map_err(|e| format!("{}: {e}", out.display()))
}

fn parse(arguments: &[String]) -> Result<(Options, PathBuf), String> {
    let mut options = Options::default();
    let mut out = None;
    let mut tests = None;
    let mut beds = Vec::new();
    let mut rest = arguments.iter();
    while let Some(name) = rest.next() {
        let mut value = || rest.next().ok_or(format!("{name} needs a value"));
        match name.as_str() {
            "--units" => options.units = parsed(name, value()?)?,
            "--seed" => options.seed = parsed(name, value()?)?,
            "--noise" => {
                options.noise = match value()?.as_str() {
                    "bench" => Noise::Bench,
                    "fleet" => Noise::Fleet,
                    other => return Err(format!("no such noise: {other}")),
                }
            }
            "--healthy" => {
                options.units = parsed(name, value()?)?;
                beds.push(Bed::Healthy { tests: 300 });
            }
            "--tests" => tests = Some(parsed(name, value()?)?),
            "--ar1" => options.ar1 = parsed(name, value()?)?,
            "--triple" => beds.push(Bed::Triple),
            "--repairs-unrecorded" => beds.push(Bed::RepairsUnrecorded),
            "--two-faults" => options.two_faults = true,
            "--out" => out = Some(PathBuf::from(value()?)),
            other => return Err(format!("unknown option {other}")),
        }
    }
    if beds.len() > 1 {
        return Err("only one of --healthy, --triple and --repairs-unrecorded".to_string());
    }
    if let Some(&bed) = beds.first() {
        options.bed = bed;
    }
    match (options.bed, tests) {
        (Bed::Healthy { .. }, Some(tests)) => options.bed = Bed::Healthy { tests },
        (_, Some(_)) => return Err("--tests goes with --healthy".to_string()),
        _ => {}
    }
    if !(0.0..1.0).contains(&options.ar1) {
        return Err("--ar1 must be from 0 to under 1".to_string());
    }
    let out = out.ok_or("--out is needed")?;
    Ok((options, out))
}

fn parsed<T: std::str::FromStr>(name: &str, value: &str) -> Result<T, String> {
    value.parse().map_err(|_| format!("{name}: {value} does not fit"))
}
