//! The command line of `ema`.

mod calibrate;
mod check;
mod dataset;
mod demo;
pub(crate) mod diagnose;
mod discrepancy;
mod export;
mod maps;
mod plot;
mod prognosis;
mod query;
mod run;
mod shell;
mod simulate;
mod stream;
mod unit;

use crate::Interrupted;
use anyhow::Result;
use clap::{Args, CommandFactory, Parser, Subcommand};
use diagnoser::report::versioned;
use ema_tables::ChannelMap;
use schemas::error::{EXIT_INTERRUPTED, Error};
use schemas::foreign;
use sim_worker::parameters::ActuatorParameters;
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::Arc;

/// Version and source revision.
const VERSION: &str = concat!(env!("CARGO_PKG_VERSION"), " (", env!("EMA_COMMIT"), ")");

const EXIT_CODES: &str = "Exit codes: 0 done (a diagnosis that finds no fault pair is a finding, not an error) \
    | 1 unforeseen failure, for example a full disk | 2 wrong command line \
    | 3 finished with loss: the diagnosis is incomplete, or a replay was not received or not diagnosed | 4 bad input: one line says file, place, value found and what \
    is allowed | 130 interrupted; what is done is kept";

const SHORT: &str =
    "ema COMMAND -h lists the options of a command, --help says all of them; ema --help has the exit codes";

const ABOUT: &str = "Prognostics of electromechanical actuators with failure maps";

#[derive(Parser)]
#[command(name = "ema", version = VERSION, about = ABOUT, after_help = SHORT, after_long_help = EXIT_CODES)]
struct Cli {
    /// No progress and no notes on standard error; results and errors stay
    #[arg(long, global = true, display_order = 900)]
    quiet: bool,
    #[command(subcommand)]
    command: Commands,
}

#[derive(Subcommand)]
enum Commands {
    /// Simulate one run and write its telemetry
    #[command(after_help = "Example: ema run --fsj 3 --zeta 0.3 --sequence preflight --rate 10000 --out run.csv")]
    Run(run::RunArgs),
    /// Simulate a grid of faults into a dataset; resumes where it was interrupted
    #[command(after_help = "Example: ema simulate --grid standard --sensors reference --out dataset")]
    Simulate(simulate::SimulateArgs),
    /// Build the failure maps of a dataset
    #[command(after_help = "Example: ema maps dataset    (writes dataset/maps.parquet)")]
    Maps(maps::MapsArgs),
    /// Calibrate the bands of maps: how far intervals must reach to hold the stated share of true pairs
    #[command(
        after_help = "Example: ema calibrate dataset --spread fleet    (writes dataset/calibration-fleet.json; then\n         \
        ema diagnose run.csv --maps dataset --spread fleet)"
    )]
    Calibrate(calibrate::CalibrateArgs),
    /// Diagnose a recorded test: intervals of both faults
    #[command(
        after_help = "Examples: ema diagnose run.csv --json    (maps of the reference actuator, made on first use)\n          \
        ema diagnose run.csv --plot page    (then open page/diagnosis.html: what was found, how sure, what to do next)"
    )]
    Diagnose(diagnose::DiagnoseArgs),
    /// Diagnose telemetry in shared memory while the test runs
    #[command(
        after_help = "Example: ema live --log diagnoses.jsonl    (then, elsewhere: ema bench-live --fsj 3 --zeta 0.3)"
    )]
    Live(stream::LiveCommand),
    /// Play recordings back into shared memory, without loss
    #[command(after_help = "Example: ema replay run.parquet --speed max")]
    Replay(stream::ReplayArgs),
    /// Run the numerical test bench in real time as device under test
    #[command(after_help = "Example: ema bench-live --fsj 3 --zeta 0.3 --tests 5")]
    BenchLive(stream::BenchLiveArgs),
    /// Carry the stream between computers, as Arrow IPC over TCP
    #[command(
        after_help = "Example: on one computer  ema bridge receive --listen 0.0.0.0:7745\n         \
    on the other     ema bridge send --to HOST:7745",
        after_long_help = "Example: on one computer  ema bridge receive --listen 0.0.0.0:7745\n         \
    on the other     ema bridge send --to HOST:7745\n--secret-file on both ends, or \
    --tls-cert, --tls-key and --tls-ca, keep strangers out; without them use it on a network that you trust."
    )]
    Bridge(stream::BridgeArgs),
    /// Draw maps, diagnoses and telemetry as SVG
    #[command(after_help = "Example: ema plot maps dataset --out plots")]
    Plot(plot::PlotArgs),
    /// Measure this machine's speed
    #[command(after_help = "Example: ema bench --json")]
    Bench(BenchArgs),
    /// Grid, maps, the paper's four cases and a report, in one go
    #[command(after_help = "Example: ema demo --out demo run.csv    (then open demo/report.html)")]
    Demo(demo::DemoArgs),
    /// Find where simulation and measurement disagree, name the missing effect, add it to the model
    #[command(
        after_help = "Example: ema discrepancy --actuator reference --bench run1.csv run2.csv --healthy --out study",
        after_long_help = "Example: ema discrepancy --actuator reference --bench run1.csv run2.csv --healthy --out study\n\
        (then open study/report.html; study/actuator.toml is the model with what was found)\n\
        Verdicts: none, retune, named, named_with_remainder, ambiguous, unknown, candidate (nothing was held out to \
        prove it). Without --healthy, or health = \"healthy\" in the bench file, no model is written: friction and \
        eccentricity are then told as findings of a unit. How a bench file is written: \
        datasets/benches/README.md."
    )]
    Discrepancy(discrepancy::DiscrepancyArgs),
    /// Whether an actuator can be diagnosed by a test: does it move, settle, saturate, hit its stops; are its maps flat
    #[command(after_help = "Example: ema check actuator.toml    (exit 3 where something stands against a diagnosis)")]
    Check(check::CheckArgs),
    /// The file of one unit: what its own tests say of its constants, for narrower diagnoses
    #[command(
        subcommand,
        after_help = "Example: ema unit new tail7.json --actuator study/actuator.toml && ema unit update tail7.json acceptance.csv \
        --healthy && ema diagnose today.csv --unit tail7.json && ema unit update tail7.json today.csv"
    )]
    Unit(unit::UnitCommand),
    /// From diagnoses over time to the time that is left: trend, rate, law, remaining life, when to look again
    #[command(
        after_help = "Example: ema prognosis diagnoses.jsonl --threshold fsj=4 --out prognosis    (a log of ema live --log)",
        after_long_help = "Example: ema prognosis diagnoses.jsonl --threshold fsj=4 --out prognosis    (a log of ema live --log)\n\
        Status: ok, doubtful, too_early (fewer than 5 tests with an interval), passed, refused; the reason says why.\n\
        RUL is the shortest interval of 90 %; without --fleet, or below 20 finished lives, it is a design figure. \
        Probabilities, priors and limits are assumed where no fleet has taught them."
    )]
    Prognosis(prognosis::PrognosisCommand),
    /// What a fleet plan comes to: runs, bytes and time, measured before anything starts
    #[command(after_help = "Example: ema plan datasets/fleets/demo.toml")]
    Plan(dataset::PlanArgs),
    /// Datasets of whole fleets: make, merge, verify, maps, diagnose, export, copy
    #[command(
        subcommand,
        after_help = "Example: ema dataset make datasets/fleets/demo.toml --out fleet && ema dataset maps fleet && ema dataset \
        diagnose fleet && ema query --list\nMany machines: sim-worker --help, sim-worker/deploy. A dataset is a folder or \
        s3://BUCKET/PREFIX (credentials from AWS_* environment variables)."
    )]
    Dataset(dataset::DatasetCommand),
    /// The actuator for other programs: an FMU
    #[command(
        subcommand,
        after_help = "Example: ema export fmu actuator.toml --out actuator.fmu    (ema export fmu --help says what is in it)"
    )]
    Export(export::ExportCommand),
    /// SQL and ready questions over a dataset
    // whose options are the other program's: it has the help, too
    #[command(disable_help_flag = true)]
    Query(query::QueryArgs),
    /// Completions of this command line for a shell, on standard output
    #[command(after_help = "Example: ema completions bash > ~/.local/share/bash-completion/completions/ema")]
    Completions(shell::CompletionsArgs),
    /// Manual pages, one for each command
    #[command(after_help = "Example: ema man --out ~/.local/share/man/man1    (then: man ema-diagnose)")]
    Man(shell::ManArgs),
}

#[derive(Args)]
struct BenchArgs {
    /// Keys for programs
    #[arg(long)]
    json: bool,
}

/// Which actuator.
#[derive(Args, Default)]
pub struct ActuatorArg {
    /// Actuator parameters, a TOML file; `reference`, or nothing, is the reference actuator (values assumed)
    #[arg(long, value_name = "FILE", help_heading = MODEL)]
    actuator: Option<PathBuf>,
}

impl ActuatorArg {
    fn path(&self) -> Option<&std::path::Path> {
        self.actuator.as_deref()
    }

    /// The one that was named.
    fn named(&self) -> Result<Option<Arc<ActuatorParameters>>> {
        Ok(self.path().map(ActuatorParameters::read).transpose()?.map(Arc::new))
    }

    fn read(&self) -> Result<Arc<ActuatorParameters>> {
        Ok(self
            .named()?
            .unwrap_or_else(|| Arc::new(ActuatorParameters::reference())))
    }
}

/// Heading of options that say how a recording is to be read.
const RECORDING: &str = "Recording";
/// Heading of options that choose the model.
const MODEL: &str = "Actuator and test";
/// Heading of options on maps and how far intervals reach.
const MAPS: &str = "Maps and intervals";
/// Heading of options that say what comes out, and where it goes.
const OUTPUT: &str = "Output";
/// Heading of options on time and shared memory.
const STREAM: &str = "Stream";

/// What a recording does not say of itself.
#[derive(Args)]
pub struct RecordingArgs {
    /// Sequence by name or TOML file; recognised from the command if left out
    #[arg(long, help_heading = RECORDING)]
    sequence: Option<String>,
    /// Sensor model: auto, none, reference, or a TOML file
    #[arg(long, default_value = "auto", help_heading = RECORDING)]
    sensors: String,
    /// Which column of a table is which channel, and in what unit: the section [channels] of a bench file
    #[arg(long, value_name = "BENCH.toml", help_heading = RECORDING)]
    channels: Option<PathBuf>,
}

impl RecordingArgs {
    fn channel_map(&self) -> Result<Option<Arc<ChannelMap>>> {
        let map = self.channels.as_deref().map(ChannelMap::read).transpose()?;
        Ok(map.map(Arc::new))
    }
}

/// The command line as it is described to its users: options, help, commands below commands.
pub fn command() -> clap::Command {
    Cli::command()
}

/// Parses the command line, works, and says how it ended.
pub fn main() -> ExitCode {
    let cli = Cli::parse();
    if cli.quiet {
        sim_worker::quiet::be_quiet();
    }
    crate::progress::catch_interrupts();
    let result = match cli.command {
        Commands::Run(a) => run::run(&a),
        Commands::Simulate(a) => simulate::simulate(&a),
        Commands::Maps(a) => maps::maps(&a),
        Commands::Calibrate(a) => calibrate::calibrate(&a),
        Commands::Diagnose(a) => diagnose::diagnose(&a),
        Commands::Live(a) => stream::live(&a),
        Commands::Replay(a) => stream::replay(&a),
        Commands::BenchLive(a) => stream::bench_live(&a),
        Commands::Bridge(a) => stream::bridge(&a),
        Commands::Plot(a) => plot::plot(&a),
        Commands::Bench(a) => bench(&a),
        Commands::Demo(a) => demo::demo(&a),
        Commands::Discrepancy(a) => discrepancy::discrepancy(&a),
        Commands::Check(a) => check::run(&a),
        Commands::Unit(a) => unit::unit(&a),
        Commands::Prognosis(a) => prognosis::prognosis(&a),
        Commands::Plan(a) => dataset::plan(&a),
        Commands::Dataset(a) => dataset::dataset(&a),
        Commands::Export(a) => export::export(&a),
        Commands::Query(_) => query::query(cli.quiet),
        Commands::Completions(a) => shell::completions(&a),
        Commands::Man(a) => shell::man(&a),
    };
    result.unwrap_or_else(|e| {
        // a closed pipe (ema ... | head) is not worth a word
        eprintln!("ema: {}", foreign::line(&format!("{e:#}")));
        if e.is::<Interrupted>() {
            ExitCode::from(EXIT_INTERRUPTED)
        } else {
            ExitCode::from(e.downcast_ref::<Error>().map_or(1, Error::exit_code))
        }
    })
}

/// Prints without control characters (names of files and frames come from outside), and does not mind when nobody
/// reads on.
pub fn say(text: &str) {
    use std::io::Write;
    let _ = writeln!(std::io::stdout(), "{}", foreign::lines(text.trim_end()));
}

/// Prints an object for programs, with the version of its keys.
fn say_json(object: serde_json::Value) {
    say(&versioned(object).to_string());
}

/// The first lines of a list.
fn list(title: &str, lines: &[String]) {
    for l in lines.iter().take(10) {
        say(&format!("{title} {l}"));
    }
    if lines.len() > 10 {
        say(&format!("{title} {} more", lines.len() - 10));
    }
}

fn bench(a: &BenchArgs) -> Result<ExitCode> {
    let s = crate::speed::measure();
    if a.json {
        let v = serde_json::json!({
            "scalar_ns_per_step": s.scalar_ns_per_step,
            "lanes_ns_per_step_per_run": s.lanes_ns_per_step_per_run,
            "lanes": s.lanes,
            "standstill_lanes_ns_per_step_per_run": s.standstill_lanes_ns_per_step_per_run,
            "sm_ns_per_simulated_us": s.sm_ns_per_simulated_us,
            "instruction_set": s.instruction_set,
        });
        say_json(v);
    } else {
        say(&format!(
            "instruction set    {}\none run            {:.2} ns/step\n{} lanes           {:.2} ns/step/run\n\
             standing still     {:.2} ns/step/run\nsimplified model   {:.3} ns/us simulated (1/{:.0} of one run)",
            s.instruction_set,
            s.scalar_ns_per_step,
            s.lanes,
            s.lanes_ns_per_step_per_run,
            s.standstill_lanes_ns_per_step_per_run,
            s.sm_ns_per_simulated_us,
            s.scalar_ns_per_step / s.sm_ns_per_simulated_us,
        ));
    }
    Ok(ExitCode::SUCCESS)
}
