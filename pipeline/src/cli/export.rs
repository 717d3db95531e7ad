//! `ema export`.

use super::say;
use crate::export;
use anyhow::Result;
use clap::{Args, Subcommand};
use schemas::error::write_whole;
use sim_worker::parameters::ActuatorParameters;
use std::path::PathBuf;
use std::process::ExitCode;

#[derive(Subcommand)]
pub enum ExportCommand {
    /// An FMU: FMI 2.0, co-simulation, for this platform
    #[command(
        long_about = "An FMU of the numerical test bench: FMI 2.0, co-simulation, for this platform.\n\n\
        It holds modelDescription.xml, the shared library, the resolved parameters (resources/actuator.toml) and a page of \
        documentation.\n\n\
        Inputs: command (user position, rad), load_torque (at the motor, N.m). They are held over a communication step, \
        unless fmi2SetRealInputDerivatives gives a first (and second) derivative; held at 10 kHz a command is half a step \
        late, which a diagnosis notices.\n\
        Outputs: com, theta_u, theta_m, omega_m, i_eq, i_a, i_b, i_c, v_a, v_b, v_c, torque_m, i_q, i_supply, v_dc: positions \
        and speed at the communication point, the others as means over the communication step; true values, no sensors.\n\
        Parameters: fsj (1 to 5) and zeta (0 to 0.5), which may also change on the way; rest_angle; sequence (1 external: \
        the input commands; 2 preflight and the other built-in tests: the FMU commands itself, and gives the samples of \
        ema run bit for bit); all values of the actuator's file but pole pairs, drive constant and step; every effect's \
        values (cogging.amplitude, of a second one cogging_2.amplitude).\n\
        A communication step of any length ends on the nearest step of the simulator. States can be kept, put back and \
        serialized.\n\n\
        Values of the reference actuator are assumed; so are those that its file marks as such.",
        after_help = "Example: ema export fmu actuator.toml --out actuator.fmu    (after cargo build --release -p ema-fmu)"
    )]
    Fmu(FmuArgs),
}

#[derive(Args)]
pub struct FmuArgs {
    /// Actuator parameters, a TOML file; the reference actuator (values assumed) if left out
    actuator: Option<PathBuf>,
    /// The FMU that is written
    #[arg(long)]
    out: PathBuf,
    /// The shared library that goes into it; libema_fmu beside ema if left out (cargo build --release -p ema-fmu)
    #[arg(long)]
    library: Option<PathBuf>,
}

pub fn export(c: &ExportCommand) -> Result<ExitCode> {
    let ExportCommand::Fmu(a) = c;
    let actuator = match &a.actuator {
        Some(path) => ActuatorParameters::read(path)?,
        None => ActuatorParameters::reference(),
    };
    let library = match &a.library {
        Some(path) => path.clone(),
        None => export::find(std::env::current_exe().ok().as_deref())?,
    };
    let bytes = export::fmu(&actuator, &library)?;
    write_whole(&a.out, &bytes)?;
    say(&format!(
        "{}: actuator {}, FMI 2.0 co-simulation, {} kB",
        a.out.display(),
        actuator.name,
        bytes.len().div_ceil(1000)
    ));
    Ok(ExitCode::SUCCESS)
}
