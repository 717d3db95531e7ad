//! Arguments of the live diagnoser, for the programs `diagnoser` and `ema live`.

use crate::live::Known;
use crate::map_library::{Choice, MapLibrary};
use crate::receive::foresight::Foresight;
use crate::receive::maps::MapSource;
use crate::receive::words::Counts;
use crate::receive::{Options, Show, receive};
use clap::{Args, Parser};
use schemas::error::{EXIT_INTERRUPTED, EXIT_LOSS, Error, Result};
use schemas::stream::{Domain, domain};
use sim_worker::catalogue;
use sim_worker::parameters::ActuatorParameters;
use sim_worker::quiet;
use std::io::IsTerminal;
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

/// Longest silence of a stream that is waited for [s].
const LONGEST_TIMEOUT_S: f64 = 1e6;

// headings of options; the first, third and fourth are those of `ema`, too
const STREAM: &str = "Stream";
const NAMED: &str = "What frames may name";
const MAPS: &str = "Maps and intervals";
const OUTPUT: &str = "Output";

/// Which shared memory.
#[derive(Args, Clone, Debug)]
pub struct DomainArg {
    /// Domain: only processes of one domain see each other; letters, digits and -
    #[arg(long, env = domain::VARIABLE, default_value = "", hide_default_value = true, help_heading = STREAM)]
    domain: String,
}

impl DomainArg {
    /// The domain of the shared memory.
    ///
    /// # Errors
    /// Refuses a name with other characters than letters, digits and -.
    pub fn open(&self) -> Result<Domain> {
        Domain::new(&self.domain)
    }
}

/// Arguments of the live diagnoser, the same in both programs.
#[derive(Args, Clone, Debug)]
pub struct LiveArgs {
    #[command(flatten)]
    domain: DomainArg,
    /// Actuator parameters that frames may name, TOML files; besides the reference actuator
    #[arg(long, value_name = "FILE", help_heading = NAMED)]
    actuator: Vec<PathBuf>,
    /// Sequences that frames may name, TOML files; besides the built-in ones
    #[arg(long, value_name = "FILE", help_heading = NAMED)]
    sequence: Vec<PathBuf>,
    /// Sensor models that frames may name, TOML files; besides none and the reference
    #[arg(long, value_name = "FILE", help_heading = NAMED)]
    sensors: Vec<PathBuf>,
    /// Saved maps: file, folder with maps.parquet, or folder of such folders
    #[arg(long, value_name = "PATH", help_heading = MAPS)]
    pub maps: Vec<PathBuf>,
    /// Spread from unit to unit that intervals allow for: none, fleet, or a TOML file
    #[arg(long, default_value = "none", help_heading = MAPS)]
    spread: String,
    /// Share of tests whose true pair the intervals hold
    #[arg(long, default_value_t = crate::calibration::COVERAGE, help_heading = MAPS)]
    coverage: f64,
    /// Append final diagnoses to FILE.jsonl or FILE.parquet; streams that have one in it get no other one
    #[arg(long, value_name = "FILE", help_heading = OUTPUT)]
    log: Option<PathBuf>,
    /// Record every stream into this folder as Parquet, while diagnosing
    #[arg(long, value_name = "DIR", help_heading = OUTPUT)]
    record: Option<PathBuf>,
    /// Poll instead of sleeping until something comes: quicker, and a processor core is always busy
    #[arg(long, help_heading = STREAM)]
    busy: bool,
    /// Lines instead of the live view
    #[arg(long, help_heading = OUTPUT)]
    plain: bool,
    /// A JSON object for each diagnosis, those so far included (schemas/json/live.schema.json)
    #[arg(long, conflicts_with = "plain", help_heading = OUTPUT)]
    json: bool,
    /// End after so many final diagnoses
    #[arg(long, value_name = "N", help_heading = STREAM)]
    exit_after: Option<u64>,
    /// A stream without a frame for so long is over [s]
    #[arg(long, default_value_t = 10.0, value_name = "S", help_heading = STREAM)]
    timeout: f64,
    /// Write numbers for monitoring to this file every five seconds, in the text format of Prometheus
    #[arg(long, value_name = "FILE", help_heading = OUTPUT)]
    metrics: Option<PathBuf>,
}

impl LiveArgs {
    /// What frames may name.
    ///
    /// # Errors
    /// Refuses a file that cannot be read or holds a value that is not allowed.
    pub fn known(&self) -> Result<(Known, Vec<sim_worker::sensor::SensorModel>)> {
        let mut actuators = vec![Arc::new(ActuatorParameters::reference())];
        for path in &self.actuator {
            actuators.push(Arc::new(ActuatorParameters::read(path)?));
        }
        let mut sequences = Vec::new();
        for name in catalogue::sequence_names() {
            sequences.push(catalogue::sequence(name)?);
        }
        for path in &self.sequence {
            sequences.push(catalogue::sequence(&path.to_string_lossy())?);
        }
        let mut models = Vec::new();
        models.extend(catalogue::sensors("reference")?);
        for path in &self.sensors {
            models.extend(catalogue::sensors(&path.to_string_lossy())?);
        }
        let mut sensors = vec![("none".to_string(), Default::default())];
        sensors.extend(models.iter().map(|m| (m.fingerprint(), m.sampling)));
        let known = Known {
            actuators,
            sequences,
            sensors,
            units: Default::default(),
        };
        Ok((known, models))
    }

    /// What intervals are to be made for.
    ///
    /// # Errors
    /// Refuses a spread that is neither built in nor a valid TOML file, and a coverage that is not above 0 and below 1.
    pub fn choice(&self) -> Result<Choice> {
        Choice::new(catalogue::spread(&self.spread)?, self.coverage)
    }

    fn check(&self) -> Result<()> {
        if !(self.timeout > 0.0 && self.timeout <= LONGEST_TIMEOUT_S) {
            let allowed = format!("a number of seconds above 0, at most {LONGEST_TIMEOUT_S}");
            return Err(Error::bad("command line", "--timeout", self.timeout, allowed));
        }
        if self.exit_after == Some(0) {
            return Err(Error::bad("command line", "--exit-after", 0, "at least 1"));
        }
        Ok(())
    }

    /// Runs until Ctrl-C (`stop`) or until enough diagnoses have come; returns the exit code.
    ///
    /// # Errors
    /// Refuses a timeout of no length, and what [`receive`] refuses.
    pub fn run(
        &self,
        known: Known,
        maps: MapSource,
        foresight: Option<Foresight>,
        stop: &Arc<AtomicBool>,
    ) -> Result<u8> {
        self.check()?;
        let show = if self.json {
            Show::Json
        } else if self.plain || !std::io::stdout().is_terminal() {
            Show::Lines
        } else {
            Show::Screen
        };
        let options = Options {
            domain: self.domain.open()?,
            known,
            log: self.log.clone(),
            record: self.record.clone(),
            busy: self.busy,
            show,
            exit_after: self.exit_after,
            timeout: Duration::from_secs_f64(self.timeout),
            metrics: self.metrics.clone(),
            // nobody else would see it
            foresight: foresight.filter(|_| show == Show::Screen),
        };
        let counts: Counts = receive(options, maps, stop)?;
        let Counts {
            frames,
            diagnoses,
            located,
            unexplained,
            out_of_range,
            incomplete,
            strays,
            ..
        } = counts;
        quiet::note(&format!(
            "{frames} frames, {diagnoses} diagnoses: {located} located, {unexplained} unexplained, {out_of_range} out of \
             range, {incomplete} incomplete; {strays} frames refused"
        ));
        Ok(if stop.load(Ordering::Relaxed) {
            EXIT_INTERRUPTED
        } else if incomplete > 0 {
            EXIT_LOSS
        } else {
            0
        })
    }
}

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
    /// No notes on standard error; diagnoses and errors stay
    #[arg(long)]
    quiet: bool,
}

fn run(program: &Program, stop: &Arc<AtomicBool>) -> Result<u8> {
    let library = MapLibrary::open(&program.live.maps)?;
    let (known, _) = program.live.known()?;
    let hint = "make them with `ema maps`, name them with --maps";
    let source = MapSource::saved(library, program.live.choice()?, hint);
    program.live.run(known, source, None, stop)
}

/// The program `diagnoser`.
pub fn main() -> ExitCode {
    let program = Program::parse();
    if program.quiet {
        quiet::be_quiet();
    }
    let stop = Arc::new(AtomicBool::new(false));
    sim_worker::interrupt::catch(stop.clone());
    match run(&program, &stop) {
        Ok(code) => ExitCode::from(code),
        Err(e) => {
            eprintln!("diagnoser: {e}");
            ExitCode::from(e.exit_code())
        }
    }
}
