//! `ema run`.

use super::{ActuatorArg, MODEL, OUTPUT};
use crate::one_run::{Model, OneRun};
use crate::output::Writer;
use anyhow::Result;
use clap::Args;
use schemas::channel::Channel;
use schemas::error::Error;
use schemas::fault::FaultState;
use sim_worker::setup::TestSetup;
use std::path::PathBuf;
use std::process::ExitCode;

#[derive(Args)]
pub struct RunArgs {
    /// Friction factor FSJ (1 = healthy)
    #[arg(long, default_value_t = 1.0, help_heading = MODEL)]
    fsj: f64,
    /// Static eccentricity zeta (0 = healthy)
    #[arg(long, default_value_t = 0.0, help_heading = MODEL)]
    zeta: f64,
    #[arg(long, default_value = "preflight", help = sequences(), help_heading = MODEL)]
    sequence: String,
    /// Telemetry rate [Hz]
    #[arg(long, default_value_t = 10_000.0, help_heading = OUTPUT)]
    rate: f64,
    #[arg(long, value_enum, default_value_t = Model::Ntb, help_heading = MODEL)]
    model: Model,
    /// FILE.csv or FILE.parquet
    #[arg(long, value_name = "FILE", help_heading = OUTPUT)]
    out: PathBuf,
    /// Rotor angle at rest [deg]
    #[arg(long, default_value_t = 0.0, allow_negative_numbers = true, help_heading = MODEL)]
    rest_angle_deg: f64,
    /// Constant load torque at the motor [N m]
    #[arg(long, default_value_t = 0.0, allow_negative_numbers = true, help_heading = MODEL)]
    load_n_m: f64,
    /// Sensors: none, reference, or a TOML file
    #[arg(long, default_value = "none", help_heading = OUTPUT)]
    sensors: String,
    /// Seed of the sensor noise
    #[arg(long, default_value_t = 0, help_heading = OUTPUT)]
    seed: u64,
    #[arg(long, value_delimiter = ',', help = additional_channels(), help_heading = OUTPUT)]
    channels: Vec<String>,
    #[command(flatten)]
    actuator: ActuatorArg,
}

/// A finite number from the command line.
pub fn finite(what: &str, x: f64) -> Result<f64> {
    if x.is_finite() {
        Ok(x)
    } else {
        Err(Error::bad("command line", what, x, "a finite number").into())
    }
}

/// Faults from the command line.
pub fn faults(fsj: f64, zeta: f64) -> Result<FaultState> {
    FaultState::new(fsj, zeta).map_err(|(place, x, allowed)| Error::bad("command line", place, x, allowed).into())
}

/// Help of `--channels`.
pub fn additional_channels() -> String {
    let names: Vec<&str> = sim_worker::catalogue::simulated()
        .filter(|c| !c.is_basic())
        .map(Channel::name)
        .collect();
    format!("Additional channels: {} or all", names.join(","))
}

/// Help of `--sequence`.
pub fn sequences() -> String {
    let names: Vec<&str> = sim_worker::catalogue::sequence_names().collect();
    format!("Sequence: {}, or a TOML file", names.join(", "))
}

pub fn run(a: &RunArgs) -> Result<ExitCode> {
    let actuator = a.actuator.read()?;
    let fault = faults(a.fsj, a.zeta)?;
    let setup = TestSetup {
        sensors: sim_worker::catalogue::sensors(&a.sensors)?,
        rest_angle_rad: finite("--rest-angle-deg", a.rest_angle_deg)?.to_radians(),
        load_n_m: finite("--load-n-m", a.load_n_m)?,
        ..TestSetup::new(actuator, sim_worker::catalogue::sequence(&a.sequence)?, a.rate)
    };
    let run = OneRun::new(setup, fault, a.model, a.seed, &a.channels)?;
    let mut writer = Writer::create(&a.out, &run.provenance(), run.channels, run.is_sensed())?;
    run.simulate_into(&mut writer, || !crate::progress::interrupted())?;
    writer.finish()?;
    Ok(ExitCode::SUCCESS)
}
