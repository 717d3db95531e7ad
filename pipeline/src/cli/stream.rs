//! `ema live`, `ema replay`, `ema bench-live`, `ema bridge`.

use super::run::{faults, finite};
use super::{ActuatorArg, MAPS, MODEL, OUTPUT, RecordingArgs, STREAM, say};
use crate::bridge::{Guard, Limits, Secret, TlsFiles};
use crate::case::Settings;
use crate::maps::{self, MapRequest};
use crate::progress::interrupted;
use crate::replay::{Await, Delivered, Replay, Verdict};
use crate::{bench_live, bridge};
use anyhow::Result;
use clap::{Args, Subcommand};
use diagnoser::cli::{DomainArg, LiveArgs};
use diagnoser::live::Known;
use diagnoser::map_library::{Choice, MapKey, MapLibrary};
use diagnoser::receive::maps::{MapSource, no_maps};
use diagnoser::unit::UnitFile;
use rand::{RngExt, SeedableRng};
use schemas::channel::ChannelSet;
use schemas::error::{EXIT_INTERRUPTED, EXIT_LOSS, Error};
use schemas::fault::{FaultGrid, FaultState};
use schemas::foreign;
use sim_worker::quiet;
use sim_worker::sensor::SensorModel;
use sim_worker::setup::TestSetup;
use sim_worker::simulate::{Experiment, Run};
use sim_worker::test_bench::Lane;
use std::collections::BTreeMap;
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::Duration;

/// Heading of options on remaining lives.
const FORESIGHT: &str = "Remaining life";

#[derive(Args)]
pub struct LiveCommand {
    #[command(flatten)]
    live: LiveArgs,
    /// Grid of maps made on first use
    #[arg(long, default_value = "fine", help_heading = MAPS)]
    grid: String,
    /// Make no maps: a test without saved ones is incomplete
    #[arg(long, help_heading = MAPS)]
    no_make: bool,
    /// Unit files (ema unit): a folder, or one; a stream whose actuator has the name of a unit is diagnosed as that unit
    ///
    /// Name and model are those of the file, whatever the frames name; the file itself stays as it is (ema unit update).
    #[arg(long, value_name = "PATH", conflicts_with = "maps", help_heading = MAPS)]
    unit: Option<PathBuf>,
    /// What was diagnosed before, as ema prognosis takes it: the view then shows remaining lives
    ///
    /// An earlier log, a table, or a dataset. The view shows rate and remaining life of each actuator, and goes on from there
    /// with each final diagnosis.
    #[arg(long, value_name = "FILE", help_heading = FORESIGHT)]
    history: Option<PathBuf>,
    /// Fault and the level that ends its life, such as fsj=4; may be repeated [default: fsj=4 and zeta=0.4]
    #[arg(long, value_name = "FAULT=LEVEL", requires = "history", help_heading = FORESIGHT)]
    threshold: Vec<String>,
    /// Repairs, as ema prognosis takes them
    #[arg(long, value_name = "FILE", requires = "history", help_heading = FORESIGHT)]
    events: Option<PathBuf>,
    /// What a fleet has taught, a file of ema prognosis learn
    #[arg(long, value_name = "FILE", requires = "history", help_heading = FORESIGHT)]
    fleet: Option<PathBuf>,
}

pub fn live(a: &LiveCommand) -> Result<ExitCode> {
    let (mut known, models) = a.live.known()?;
    let units = a
        .unit
        .as_deref()
        .map(crate::unit::folder)
        .transpose()?
        .unwrap_or_default();
    let model = |(name, unit): (&String, &Arc<UnitFile>)| (name.clone(), Arc::new(unit.actuator.clone()));
    known.units = units.iter().map(model).collect();
    let grid = sim_worker::catalogue::grid(&a.grid)?;
    let choice = a.live.choice()?;
    let source = if a.live.maps.is_empty() {
        // the live view owns the terminal
        crate::progress::leave_terminal();
        let maker = Maker {
            known: known.clone(),
            models,
            grid,
            choice,
            units,
        };
        maker.source(a.no_make)
    } else {
        let hint = match a.no_make {
            true => "make them with `ema maps`",
            false => "leave out --maps to have them made, or make them with `ema maps`",
        };
        MapSource::saved(MapLibrary::open(&a.live.maps)?, choice, hint)
    };
    let foresight = a.history.as_ref().map(|history| {
        let (events, fleet) = (a.events.clone(), a.fleet.as_deref());
        super::prognosis::foresight_of(history, &a.threshold, events, fleet)
    });
    let stop: Arc<AtomicBool> = crate::progress::interrupt_flag();
    Ok(ExitCode::from(a.live.run(
        known,
        source,
        foresight.transpose()?,
        &stop,
    )?))
}

/// What threads that make maps are nice by: diagnoses go first, on one core too.
const NICE: i32 = 10;

/// Threads for what may take its time; none where the system gives none.
fn background() -> Option<rayon::ThreadPool> {
    // SAFETY: takes a number, and on Linux concerns the calling thread alone
    let nice = |_| {
        unsafe { libc::nice(NICE) };
    };
    rayon::ThreadPoolBuilder::new().start_handler(nice).build().ok()
}

/// Finds maps in the cache, and makes them.
#[derive(Clone)]
struct Maker {
    known: Known,
    models: Vec<SensorModel>,
    grid: FaultGrid,
    choice: Choice,
    units: BTreeMap<String, Arc<UnitFile>>,
}

impl Maker {
    fn source(self, no_make: bool) -> MapSource {
        let maker = self.clone();
        let find = move |key: &MapKey| {
            let found = maker.request(key).and_then(|r| match maker.unit(key) {
                Some(unit) => told(crate::unit::found(&r, unit, maker.choice.coverage)),
                None => told(maps::found(&r, &maker.choice)),
            });
            found.transpose()
        };
        let background = background();
        let make = move |key: &MapKey| {
            let request = self.request(key)?;
            let make = || match self.unit(key) {
                Some(unit) => told(crate::unit::made(&request, unit, self.choice.coverage, &Vec::new())),
                None => told(maps::cached(&request, &self.choice, &Vec::new())),
            };
            match &background {
                Some(pool) => pool.install(make),
                None => make(),
            }
        };
        let forbidden = "making is switched off (--no-make); make them with `ema maps` and name them with --maps";
        MapSource {
            find: Box::new(find),
            make: if no_make {
                Err(forbidden.into())
            } else {
                Ok(Box::new(make))
            },
        }
    }

    /// The unit that maps are for.
    fn unit(&self, key: &MapKey) -> Option<&UnitFile> {
        self.units.get(key.unit()?).map(Arc::as_ref)
    }

    /// The maps of a test, as they are named in the cache.
    fn request(&self, key: &MapKey) -> Result<MapRequest, String> {
        let kind = key.kind();
        let of_unit = key.unit().and_then(|name| self.known.units.get(name));
        let by_name = || self.known.actuators.iter().find(|a| a.fingerprint() == kind.parameters);
        let actuator = of_unit.or_else(by_name);
        let sequence = self.known.sequences.iter().find(|s| s.fingerprint() == kind.sequence);
        let (Some(actuator), Some(sequence)) = (actuator, sequence) else {
            return Err(no_maps(key, "actuator or sequence is unknown"));
        };
        let sensors = self.models.iter().find(|m| m.fingerprint() == kind.sensors).cloned();
        let setup = TestSetup::of(kind, actuator.clone(), sequence.clone(), sensors);
        let grid = self.grid.clone();
        Ok(MapRequest { setup, grid })
    }
}

/// An error as one line of text.
fn told<T>(result: Result<T>) -> Result<T, String> {
    result.map_err(|e| format!("{e:#}"))
}

#[derive(Args)]
pub struct ReplayArgs {
    /// Recordings: the project's Parquet (all runs of it) or CSV
    #[arg(required = true)]
    files: Vec<PathBuf>,
    /// Times real time, or max
    #[arg(long, default_value = "1", help_heading = STREAM)]
    speed: String,
    /// Duration of a frame [ms]
    #[arg(long, default_value_t = 10.0, help_heading = STREAM)]
    frame_ms: f64,
    /// How long to wait for a subscriber [s]
    #[arg(long, default_value_t = 30.0, help_heading = WAITING)]
    wait: f64,
    /// Wait for the final diagnosis of every run that has been received
    ///
    /// Without one, or with an incomplete one, the exit code is 3. auto: where a diagnoser is in the domain.
    #[arg(long, value_enum, default_value_t = Await::Auto, help_heading = WAITING)]
    diagnosis: Await,
    /// How long to wait for the diagnosis [s]
    #[arg(long, default_value_t = 120.0, value_name = "S", help_heading = WAITING)]
    diagnosis_wait: f64,
    /// Name of the actuator in the frames, instead of the recording's
    #[arg(long, help_heading = STREAM)]
    id: Option<String>,
    /// Number of the first run in the frames, instead of the recording's
    #[arg(long, help_heading = STREAM)]
    run: Option<u64>,
    #[command(flatten)]
    recording: RecordingArgs,
    #[command(flatten)]
    domain: DomainArg,
    #[command(flatten)]
    actuator: ActuatorArg,
}

/// Heading of options on patience.
const WAITING: &str = "Waiting";

fn positive(what: &str, x: f64, most: f64) -> Result<f64> {
    if x.is_finite() && x > 0.0 && x <= most {
        Ok(x)
    } else {
        Err(Error::bad("command line", what, x, format!("a number above 0, at most {most}")).into())
    }
}

/// A name that fits into a frame.
fn actuator_id(name: &str) -> Result<()> {
    if (1..=32).contains(&name.len()) && name.chars().all(foreign::is_plain) {
        return Ok(());
    }
    let allowed = "1 to 32 bytes without control and format characters";
    Err(Error::bad("command line", "--id", name, allowed).into())
}

pub fn replay(a: &ReplayArgs) -> Result<ExitCode> {
    let speed = match a.speed.as_str() {
        "max" => None,
        text => {
            let x: f64 = text.parse().unwrap_or(f64::NAN);
            if !(1e-3..=1e6).contains(&x) {
                let allowed = "a number from 0.001 to 1000000, or max";
                return Err(Error::bad("command line", "--speed", text, allowed).into());
            }
            Some(x)
        }
    };
    if let Some(id) = &a.id {
        actuator_id(id)?;
    }
    let replay = Replay {
        domain: a.domain.open()?,
        settings: Settings {
            actuator: a.actuator.named()?,
            maps: None,
            run: None,
            sequence: a.recording.sequence.clone(),
            sensors: a.recording.sensors.clone(),
            channels: a.recording.channel_map()?,
            grid: sim_worker::catalogue::grid("fine")?,
            choice: Choice::usual(),
            known: Vec::new(),
            unit: None,
        },
        id: a.id.clone(),
        first_run: a.run,
        speed,
        frame_s: positive("--frame-ms", a.frame_ms, 1000.0)? * 1e-3,
        patience: Duration::from_secs_f64(positive("--wait", a.wait, 1e6)?),
        diagnosis: a.diagnosis,
        diagnosis_patience: Duration::from_secs_f64(positive("--diagnosis-wait", a.diagnosis_wait, 1e6)?),
    };
    let all = replay.files(&a.files, &|| !interrupted(), tell)?;
    Ok(if all {
        ExitCode::SUCCESS
    } else {
        ExitCode::from(EXIT_LOSS)
    })
}

/// Says what has become of a run: a line, on standard error where something is missing.
fn tell(d: &Delivered) {
    let Delivered {
        actuator,
        run,
        samples,
        frames,
        whole,
        attempts,
        verdict,
    } = d;
    let again = if *attempts > 1 {
        format!(", at the {attempts}. attempt")
    } else {
        String::new()
    };
    let name = format!("{actuator} run {run}");
    let received = format!("{name}: {samples} samples in {frames} frames received by {whole}{again}");
    match verdict {
        Verdict::Diagnosed(outcome) if *whole == 0 => {
            say(&format!("{name}: {outcome}; its end was received by nobody{again}"));
        }
        _ if *whole == 0 => eprintln!("{name}: not received: nobody has answered{again}"),
        Verdict::NotAwaited => say(&received),
        Verdict::NobodyThere => say(&format!(
            "{received}; whether it is diagnosed is not known: no diagnoser here"
        )),
        Verdict::Diagnosed(outcome) => say(&format!("{received}; {outcome}")),
        Verdict::Incomplete(why) => eprintln!("{received}, but its diagnosis is incomplete: {why}"),
        Verdict::Missing(why) => eprintln!("{received}, but not diagnosed: {why}"),
    }
}

#[derive(Args)]
pub struct BenchLiveArgs {
    /// Friction factor FSJ (1 = healthy)
    #[arg(long, default_value_t = 1.0, help_heading = MODEL)]
    fsj: f64,
    /// Static eccentricity zeta (0 = healthy)
    #[arg(long, default_value_t = 0.0, help_heading = MODEL)]
    zeta: f64,
    /// Draw the faults of every actuator and test from FSJ 1..5, zeta 0..0.5 with this seed
    #[arg(long, conflicts_with_all = ["fsj", "zeta"], help_heading = MODEL)]
    random_faults: Option<u64>,
    /// Actuators tested side by side
    #[arg(long, default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=1000), help_heading = STREAM)]
    actuators: u32,
    /// Name of the actuator; of several, what their names begin with
    #[arg(long, default_value = "bench", help_heading = STREAM)]
    id: String,
    /// Tests one after the other; 0: until Ctrl-C
    #[arg(long, default_value_t = 1, help_heading = STREAM)]
    tests: u64,
    #[arg(long, default_value = "preflight", help = super::run::sequences(), help_heading = MODEL)]
    sequence: String,
    /// Telemetry rate [Hz]
    #[arg(long, default_value_t = 10_000.0, help_heading = OUTPUT)]
    rate: f64,
    /// Duration of a frame [ms]
    #[arg(long, default_value_t = 10.0, help_heading = STREAM)]
    frame_ms: f64,
    /// Sensors: none, reference, or a TOML file
    #[arg(long, default_value = "reference", help_heading = OUTPUT)]
    sensors: String,
    /// Seed of the sensor noise
    #[arg(long, default_value_t = 0, help_heading = OUTPUT)]
    seed: u64,
    /// Rotor angle at rest [deg]
    #[arg(long, default_value_t = 0.0, allow_negative_numbers = true, help_heading = MODEL)]
    rest_angle_deg: f64,
    /// Constant load torque at the motor [N m]
    #[arg(long, default_value_t = 0.0, allow_negative_numbers = true, help_heading = MODEL)]
    load_n_m: f64,
    #[command(flatten)]
    domain: DomainArg,
    #[command(flatten)]
    actuator: ActuatorArg,
}

pub fn bench_live(a: &BenchLiveArgs) -> Result<ExitCode> {
    let actuator = a.actuator.read()?;
    let given = faults(a.fsj, a.zeta)?;
    let rest_angle_rad = finite("--rest-angle-deg", a.rest_angle_deg)?.to_radians();
    let load_n_m = finite("--load-n-m", a.load_n_m)?;
    let sequence = sim_worker::catalogue::sequence(&a.sequence)?;
    let sensors = sim_worker::catalogue::sensors(&a.sensors)?;
    let experiment = Experiment::new(sequence, a.rate, ChannelSet::basic(), sensors, actuator.step_s)?;
    let rows = crate::replay::frame_rows(positive("--frame-ms", a.frame_ms, 1000.0)? * 1e-3, a.rate)?;
    let names: Vec<String> = match a.actuators {
        1 => vec![a.id.clone()],
        n => (1..=n).map(|i| format!("{}-{i:03}", a.id)).collect(),
    };
    actuator_id(&names[names.len() - 1])?;
    let mut publisher = bench_live::publisher(&a.domain.open()?, &experiment, rows)?;
    let mut rng = a.random_faults.map(rand_chacha::ChaCha8Rng::seed_from_u64);
    let mut complete = true;
    let mut number = 0;
    while a.tests == 0 || number < a.tests {
        let runs: Vec<Run> = (0..names.len() as u64)
            .map(|i| Run {
                number,
                lane: Lane {
                    actuator: actuator.clone(),
                    fault: rng.as_mut().map_or(given, |r| FaultState {
                        fsj: r.random_range(1.0..5.0),
                        zeta: r.random_range(0.0..0.5),
                    }),
                    rest_angle_rad,
                    load_n_m,
                },
                seed: a
                    .seed
                    .wrapping_add(number.wrapping_mul(names.len() as u64))
                    .wrapping_add(i),
            })
            .collect();
        let go_on = || !interrupted();
        let Some(o) = bench_live::test(&mut publisher, &experiment, &runs, &names, rows, &go_on)? else {
            return Err(crate::Interrupted.into());
        };
        for (run, name) in runs.iter().zip(&names) {
            let f = run.lane.fault;
            say(&format!("{name} run {number}: FSJ {:.4}, zeta {:.5}", f.fsj, f.zeta));
        }
        let lost: u64 = o.lost.iter().map(|(_, n)| n).sum();
        let line = format!(
            "test {number}: {} frames, {lost} lost, {} with nobody there, {} of {} actuators answered; \
             {} frames late, by {:.1} ms at most",
            o.frames,
            o.unheard,
            o.answered,
            names.len(),
            o.late,
            o.worst_delay_s * 1e3
        );
        // a loss is no note
        match lost + o.unheard {
            0 => quiet::note(&line),
            _ => eprintln!("{line}"),
        }
        for (name, n) in o.lost.iter().take(10) {
            eprintln!("lost: {n} frames of {name}");
        }
        complete &= lost == 0 && o.unheard == 0;
        number += 1;
    }
    Ok(if complete {
        ExitCode::SUCCESS
    } else {
        ExitCode::from(EXIT_LOSS)
    })
}

/// Heading of options on what a peer can make a bridge do.
const BOUNDS: &str = "Bounds";
/// Heading of options that keep strangers out.
const TRUST: &str = "Secret and certificates";

#[derive(Args)]
pub struct BridgeArgs {
    #[command(subcommand)]
    direction: Direction,
}

#[derive(Subcommand)]
enum Direction {
    /// Send the telemetry of this computer's domain to another computer
    Send {
        /// HOST:PORT of the receiving bridge
        #[arg(long, default_value = "127.0.0.1:7745", help_heading = STREAM)]
        to: String,
        /// Name in the receiving bridge's certificate, instead of HOST
        #[arg(long, requires = "tls_cert", help_heading = TRUST)]
        tls_name: Option<String>,
        #[command(flatten)]
        common: BridgeCommon,
    },
    /// Publish in this computer's domain what another computer sends
    Receive {
        /// ADDRESS:PORT to listen on; port 0 takes a free one
        #[arg(long, default_value = "127.0.0.1:7745", help_heading = STREAM)]
        listen: String,
        /// Senders connected at once; each takes one of the domain's 64 publishers
        #[arg(long, default_value_t = 32, value_parser = clap::value_parser!(u32).range(1..=60), help_heading = BOUNDS)]
        most_connections: u32,
        /// Longest message from a sender [kB]; a frame of all channels takes 128
        #[arg(long, default_value_t = 1024, value_parser = clap::value_parser!(u32).range(256..=65_536), help_heading = BOUNDS)]
        most_message_kb: u32,
        /// Streams (actuators under test) of a sender at once
        #[arg(long, default_value_t = 1024, value_parser = clap::value_parser!(u32).range(1..=65_536), help_heading = BOUNDS)]
        most_streams: u32,
        #[command(flatten)]
        common: BridgeCommon,
    },
}

#[derive(Args)]
struct BridgeCommon {
    /// How long to wait for the other bridge, or for a subscriber [s]
    #[arg(long, default_value_t = 30.0, help_heading = WAITING)]
    wait: f64,
    /// How long the other bridge may say nothing before it is given up [s]; each says that it is alive four times as often
    #[arg(long, default_value_t = 10.0, help_heading = WAITING)]
    idle: f64,
    /// File with a secret of at least 16 bytes, the same on both sides; it never goes over the network
    #[arg(long, value_name = "FILE", help_heading = TRUST)]
    secret_file: Option<PathBuf>,
    /// This side's certificate (PEM): both sides encrypt, and show each other certificates (TLS 1.3)
    #[arg(long, value_name = "FILE", requires_all = ["tls_key", "tls_ca"], help_heading = TRUST)]
    tls_cert: Option<PathBuf>,
    /// Private key of --tls-cert (PEM)
    #[arg(long, value_name = "FILE", requires = "tls_cert", help_heading = TRUST)]
    tls_key: Option<PathBuf>,
    /// Authorities that the other side's certificate may be of (PEM)
    #[arg(long, value_name = "FILE", requires = "tls_cert", help_heading = TRUST)]
    tls_ca: Option<PathBuf>,
    #[command(flatten)]
    domain: DomainArg,
}

impl BridgeCommon {
    fn files(&self) -> Option<TlsFiles> {
        let (Some(cert), Some(key), Some(ca)) = (&self.tls_cert, &self.tls_key, &self.tls_ca) else {
            return None;
        };
        let [cert, key, ca] = [cert, key, ca].map(PathBuf::clone);
        Some(TlsFiles { cert, key, ca })
    }

    fn guard<T>(&self, tls: impl FnOnce(&TlsFiles) -> Result<T>) -> Result<Guard<T>> {
        Ok(Guard {
            secret: self.secret_file.as_deref().map(Secret::read).transpose()?,
            tls: self.files().as_ref().map(tls).transpose()?.map(Arc::new),
            idle: Duration::from_secs_f64(at_least("--idle", self.idle, 0.5, 86_400.0)?),
        })
    }

    fn patience(&self) -> Result<Duration> {
        Ok(Duration::from_secs_f64(positive("--wait", self.wait, 1e6)?))
    }
}

fn at_least(what: &str, x: f64, least: f64, most: f64) -> Result<f64> {
    if (least..=most).contains(&x) {
        return Ok(x);
    }
    Err(Error::bad("command line", what, x, format!("{least} to {most}")).into())
}

/// HOST of HOST:PORT, without the brackets of an IPv6 address.
fn host(to: &str) -> &str {
    let host = to.rsplit_once(':').map_or(to, |(host, _)| host);
    host.trim_start_matches('[').trim_end_matches(']')
}

pub fn bridge(a: &BridgeArgs) -> Result<ExitCode> {
    let go_on = || !interrupted();
    let tell = |text: &str| eprintln!("{}", foreign::line(text));
    let t = match &a.direction {
        Direction::Send { to, tls_name, common } => {
            let name = tls_name.as_deref().unwrap_or_else(|| host(to));
            let guard = common.guard(|files| bridge::client(files, name))?;
            bridge::send(&common.domain.open()?, to, &guard, common.patience()?, &go_on, &tell)?
        }
        Direction::Receive {
            listen,
            most_connections,
            most_message_kb,
            most_streams,
            common,
        } => {
            let limits = Limits {
                most_connections: *most_connections as usize,
                most_message: *most_message_kb as usize * 1024,
                most_streams: *most_streams as usize,
                patience: common.patience()?,
            };
            let guard = common.guard(bridge::server)?;
            bridge::receive(&common.domain.open()?, listen, &guard, limits, &go_on, &tell)?
        }
    };
    quiet::note(&format!(
        "{} frames of {} streams over {} connections",
        t.frames, t.streams, t.connections
    ));
    Ok(ExitCode::from(EXIT_INTERRUPTED))
}
