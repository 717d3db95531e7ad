//! `ema run`.

use super::{ActuatorArg, MODEL, OUTPUT};
use crate::COMMIT;
use crate::output::Writer;
use anyhow::Result;
use clap::{Args, ValueEnum};
use schemas::channel::{Channel, ChannelSet};
use schemas::error::Error;
use schemas::fault::FaultState;
use schemas::recording::Provenance;
use schemas::telemetry::{TelemetryHeader, TelemetrySink, TelemetryView};
use sim_worker::monitor::MonitorTrack;
use sim_worker::setup::TestSetup;
use sim_worker::simulate::{Run, simulate};
use sim_worker::test_bench::Lane;
use std::path::PathBuf;
use std::process::ExitCode;

#[derive(Clone, Copy, PartialEq, ValueEnum)]
enum Model {
    /// numerical test bench
    Ntb,
    /// simplified model, healthy actuator only
    Sm,
}

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
    let (actuator, rest_angle_rad, load_n_m) = (setup.actuator.clone(), setup.rest_angle_rad, setup.load_n_m);
    let mut channels = sim_worker::catalogue::channels(&a.channels)?;
    let e = setup.experiment(channels)?;
    if a.model == Model::Sm {
        if fault != FaultState::NOMINAL || load_n_m != 0.0 || e.sensors.is_some() {
            let found = format!(
                "fsj {}, zeta {}, load {}, sensors {}",
                a.fsj, a.zeta, load_n_m, a.sensors
            );
            let allowed = "fsj 1, zeta 0, load 0, sensors none: the simplified model knows the healthy actuator only";
            return Err(Error::bad("command line", "--model sm", found, allowed).into());
        }
        use Channel::*;
        channels = ChannelSet::of([Com, ThetaU, ThetaM, OmegaM, IEq, TorqueM]);
    }
    let provenance = Provenance {
        model: if a.model == Model::Ntb { "ntb" } else { "sm" }.into(),
        ..setup.provenance(a.seed, COMMIT)
    };
    let mut writer = Writer::create(&a.out, &provenance, channels, e.sensors.is_some())?;
    match a.model {
        Model::Ntb => {
            let lane = Lane {
                actuator,
                fault,
                rest_angle_rad,
                load_n_m,
            };
            let run = Run {
                number: 0,
                lane,
                seed: a.seed,
            };
            let go_on = || !crate::progress::interrupted();
            if simulate(&e, &[run], std::slice::from_mut(&mut writer), go_on)?.is_none() {
                return Err(crate::Interrupted.into());
            }
        }
        Model::Sm => {
            let track = MonitorTrack::run(&actuator, &e.sequence, e.rate_hz);
            let theta_m: Vec<f64> = track.theta_m_rad.iter().map(|x| x + rest_angle_rad).collect();
            let view = TelemetryView::new(1, track.com_rad.len())
                .with(Channel::Com, &track.com_rad)
                .with(Channel::ThetaU, &track.theta_u_rad)
                .with(Channel::ThetaM, &theta_m)
                .with(Channel::OmegaM, &track.omega_rad_per_s)
                .with(Channel::IEq, &track.abs_current_a)
                .with(Channel::TorqueM, &track.torque_n_m);
            let header = TelemetryHeader {
                run: 0,
                actuator: provenance.actuator.clone(),
                parameters: provenance.parameters.clone(),
                sensors: "none".into(),
                sequence: provenance.sequence.clone(),
                rate_hz: e.rate_hz,
                channels,
                fault: Some(fault),
                rest_angle_rad: Some(rest_angle_rad),
            };
            writer.accept(&header, &view)?;
        }
    }
    writer.finish()?;
    Ok(ExitCode::SUCCESS)
}
