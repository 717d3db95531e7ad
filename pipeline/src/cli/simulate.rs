//! `ema simulate`.

use super::{ActuatorArg, MODEL, OUTPUT, say};
use crate::dataset;
use anyhow::Result;
use clap::{Args, ValueEnum};
use schemas::error::Error;
use sim_worker::catalogue;
use sim_worker::dataset::one::OneActuator;
use sim_worker::dataset::plan::DatasetPlan;
use sim_worker::dataset::program::end_when_interrupted;
use sim_worker::dataset::storage::Storage;
use sim_worker::setup::TestSetup;
use std::process::ExitCode;

#[derive(Clone, Copy, PartialEq, ValueEnum)]
enum Keep {
    /// features and telemetry
    Both,
    Features,
}

#[derive(Args)]
pub struct SimulateArgs {
    /// Faults: standard (17 x 11), fine (33 x 21), coarse (5 x 3), or a TOML file
    #[arg(long, default_value = "standard", help_heading = MODEL)]
    grid: String,
    /// Dataset: a folder, or s3://BUCKET/PREFIX
    #[arg(long, value_name = "URL", help_heading = OUTPUT)]
    out: String,
    #[arg(long, default_value = "preflight", help = super::run::sequences(), help_heading = MODEL)]
    sequence: String,
    /// Telemetry rate [Hz]
    #[arg(long, default_value_t = 10_000.0, help_heading = OUTPUT)]
    rate: f64,
    /// Sensors: none, reference, or a TOML file
    #[arg(long, default_value = "none", help_heading = OUTPUT)]
    sensors: String,
    /// Seed of the sensor noise of all runs
    #[arg(long, default_value_t = 0, help_heading = OUTPUT)]
    seed: u64,
    /// What to store of each run
    #[arg(long, value_enum, default_value_t = Keep::Both, help_heading = OUTPUT)]
    keep: Keep,
    /// Rotor angles at rest [deg]
    #[arg(long, value_delimiter = ',', default_value = "0", allow_negative_numbers = true, help_heading = MODEL)]
    rest_angle_deg: Vec<f64>,
    /// Constant load torque at the motor [N m]
    #[arg(long, default_value_t = 0.0, allow_negative_numbers = true, help_heading = MODEL)]
    load_n_m: f64,
    #[arg(long, value_delimiter = ',', help = super::run::additional_channels(), help_heading = OUTPUT)]
    channels: Vec<String>,
    /// Threads; all cores if left out
    #[arg(long, value_name = "N", help_heading = OUTPUT)]
    jobs: Option<usize>,
    #[command(flatten)]
    actuator: ActuatorArg,
}

pub fn simulate(a: &SimulateArgs) -> Result<ExitCode> {
    end_when_interrupted("ema");
    let mut angles = Vec::new();
    for &x in &a.rest_angle_deg {
        angles.push(super::run::finite("--rest-angle-deg", x)?.to_radians());
    }
    angles.sort_by(f64::total_cmp);
    let (first, further) = angles.split_first().expect("clap gives at least one");
    let setup = TestSetup {
        sensors: catalogue::sensors(&a.sensors)?,
        rest_angle_rad: *first,
        load_n_m: super::run::finite("--load-n-m", a.load_n_m)?,
        ..TestSetup::new(a.actuator.read()?, catalogue::sequence(&a.sequence)?, a.rate)
    };
    let channels = catalogue::channels(&a.channels)?;
    // refuses a rate that no step serves
    setup.experiment(channels)?;
    if let Some(n) = a.jobs {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(n).build_global();
        pool.map_err(|e| Error::bad("command line", "--jobs", n, e.to_string()))?;
    }
    let plan = DatasetPlan::of_one(&OneActuator {
        setup: &setup,
        grid: &catalogue::grid(&a.grid)?,
        rest_angles_rad: further,
        seed: a.seed,
        telemetry: (a.keep == Keep::Both).then_some(channels),
    })?;
    let storage = Storage::open(&a.out)?;
    let (done, _) = dataset::make(&plan, &storage, "simulate")?.ok_or(crate::Interrupted)?;
    let place = storage.describe();
    say(&format!(
        "{} runs in {place}, {} steps made now",
        plan.runs(),
        done.steps
    ));
    Ok(ExitCode::SUCCESS)
}
