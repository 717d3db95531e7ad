//! `ema simulate` and `ema maps`.

use super::{ActuatorArg, say};
use crate::generate::{Plan, generate};
use anyhow::Result;
use clap::{Args, ValueEnum};
use diagnoser::calibration::COVERAGE;
use diagnoser::map_library::Choice;
use diagnoser::quality::MapQuality;
use schemas::error::Error;
use schemas::recording::{Provenance, metadata};
use sim_worker::simulate::Experiment;
use std::path::PathBuf;
use std::process::ExitCode;

#[derive(Clone, Copy, PartialEq, ValueEnum)]
enum Keep {
    Both,
    Telemetry,
    Features,
}

#[derive(Args)]
pub struct SimulateArgs {
    /// standard (17 x 11), fine (33 x 21), coarse (5 x 3), or a TOML file
    #[arg(long, default_value = "standard")]
    grid: String,
    /// Dataset folder
    #[arg(long)]
    out: PathBuf,
    /// preflight, ramp, sine, step, chirp, multisine, or a TOML file
    #[arg(long, default_value = "preflight")]
    sequence: String,
    /// Telemetry rate [Hz]
    #[arg(long, default_value_t = 10_000.0)]
    rate: f64,
    /// none, reference, or a TOML file
    #[arg(long, default_value = "none")]
    sensors: String,
    /// Seed of the sensor noise; each run adds its number
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// What to store of each run
    #[arg(long, value_enum, default_value_t = Keep::Both)]
    keep: Keep,
    /// Rotor angles at rest [deg]
    #[arg(long, value_delimiter = ',', default_value = "0", allow_negative_numbers = true)]
    rest_angle_deg: Vec<f64>,
    /// Constant load torque at the motor [N m]
    #[arg(long, default_value_t = 0.0, allow_negative_numbers = true)]
    load_n_m: f64,
    /// Additional channels: v_a,v_b,v_c,torque_m,i_q,i_supply,v_dc or all
    #[arg(long, value_delimiter = ',')]
    channels: Vec<String>,
    /// Threads; all cores if left out
    #[arg(long)]
    jobs: Option<usize>,
    #[command(flatten)]
    actuator: ActuatorArg,
}

pub fn simulate(a: &SimulateArgs) -> Result<ExitCode> {
    let actuator = a.actuator.read()?;
    let sequence = sim_worker::catalogue::sequence(&a.sequence)?;
    let sensors = sim_worker::catalogue::sensors(&a.sensors)?;
    let channels = super::run::channel_set(&a.channels)?;
    let experiment = Experiment::new(sequence, a.rate, channels, sensors, actuator.step_s)?;
    let mut rest_angles_rad = Vec::new();
    for &x in &a.rest_angle_deg {
        rest_angles_rad.push(super::run::finite("--rest-angle-deg", x)?.to_radians());
    }
    if let Some(n) = a.jobs {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(n).build_global();
        pool.map_err(|e| Error::bad("command line", "--jobs", n, e.to_string()))?;
    }
    let plan = Plan {
        actuator,
        grid: sim_worker::catalogue::grid(&a.grid)?,
        rest_angles_rad,
        load_n_m: super::run::finite("--load-n-m", a.load_n_m)?,
        experiment,
        seed: a.seed,
        keep_telemetry: a.keep != Keep::Features,
        keep_features: a.keep != Keep::Telemetry,
        equivalent_current: false,
    };
    let runs = plan.runs().len();
    match generate(&plan, &a.out, "simulate")? {
        Some(steps) => {
            say(&format!("{runs} runs in {}, {steps} steps made now", a.out.display()));
            Ok(ExitCode::SUCCESS)
        }
        None => Err(crate::Interrupted.into()),
    }
}

#[derive(Args)]
pub struct MapsArgs {
    /// Dataset folder with features (ema simulate)
    dataset: PathBuf,
    /// Where to save; DATASET/maps.parquet if left out
    #[arg(long)]
    out: Option<PathBuf>,
    /// Which of the dataset's rest angles [deg]
    #[arg(long, allow_negative_numbers = true)]
    rest_angle_deg: Option<f64>,
    /// Leave out a feature whose surface is not monotone enough instead of refusing
    #[arg(long)]
    lenient: bool,
    /// Sequence of the dataset, if it is a TOML file of your own
    #[arg(long)]
    sequence: Option<String>,
    /// Report on the maps: shape, sensitivity, whether they tell FSJ from zeta cell by cell, convergence of the grid,
    /// and what to add next
    #[arg(long)]
    quality: bool,
    /// Spread that the report allows for: none, fleet, or a TOML file; needs its calibration (ema calibrate)
    #[arg(long, default_value = "none", requires = "quality")]
    spread: String,
    /// The report with keys for programs, every cell included
    #[arg(long, requires = "quality")]
    json: bool,
    #[command(flatten)]
    actuator: ActuatorArg,
}

pub fn maps(a: &MapsArgs) -> Result<ExitCode> {
    let actuator = a.actuator.read()?;
    let name = match &a.sequence {
        Some(s) => s.clone(),
        None => {
            let block = crate::maps::first_file(&a.dataset)?;
            Provenance::from_pairs(&block, &metadata(&block)?)?.sequence
        }
    };
    let sequence = sim_worker::catalogue::sequence(&name)?;
    let rest = a.rest_angle_deg.map(f64::to_radians);
    let set = crate::maps::build(&a.dataset, &sequence, &actuator, false, rest, a.lenient)?;
    let out = a.out.clone().unwrap_or_else(|| a.dataset.join("maps.parquet"));
    set.save(&out)?;
    if a.quality {
        let choice = Choice {
            spread: sim_worker::catalogue::spread(&a.spread)?,
            coverage: COVERAGE,
        };
        let quality = MapQuality::of(&choice.ready(&out, set, &Vec::new())?);
        if a.json {
            say(&quality.to_json().to_string());
        } else {
            say(&quality.to_text());
        }
        return Ok(ExitCode::SUCCESS);
    }
    for m in &set.maps {
        let (lo, hi) = m.range();
        let b = &m.budget;
        let residual = m.residual.iter().fold(0.0_f64, |a, &b| a.max(b));
        say(&format!(
            "{:11} {lo:.4e} .. {hi:.4e} {:5}  standard uncertainties: sensors {:.1e}, interpolation {:.1e}, one sample {:.1e}, projection up \
             to {residual:.1e}",
            m.feature.name(),
            m.feature.unit(),
            b.noise,
            b.interpolation,
            b.sample / 3f64.sqrt()
        ));
    }
    for l in &set.header.left_out {
        say(&format!("left out {l}"));
    }
    say(&format!("saved {}", out.display()));
    Ok(ExitCode::SUCCESS)
}
