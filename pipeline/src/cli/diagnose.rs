//! `ema diagnose`.

use super::{ActuatorArg, RecordingArgs, say};
use crate::case::{self, Settings};
use crate::report::{self, Report, Section};
use crate::report_pages;
use anyhow::Result;
use clap::Args;
use diagnoser::diagnosis::Outcome;
use schemas::error::EXIT_LOSS;
use std::path::PathBuf;
use std::process::ExitCode;

#[derive(Args)]
pub struct DiagnoseArgs {
    /// Telemetry: the project's Parquet, or CSV with columns t,com,theta_u,theta_m,omega_m,i_eq[,i_a,i_b,i_c]
    file: PathBuf,
    /// Folder (or file) of saved maps; those of the actuator, made on first use, if left out
    #[arg(long)]
    maps: Option<PathBuf>,
    /// Keys for programs
    #[arg(long)]
    json: bool,
    /// Run of a file that holds several
    #[arg(long)]
    run: Option<u64>,
    #[command(flatten)]
    recording: RecordingArgs,
    /// Grid of maps made on first use
    #[arg(long, default_value = "fine")]
    grid: String,
    /// Also draw maps, cuts and the located area into this folder
    #[arg(long)]
    plot: Option<PathBuf>,
    #[command(flatten)]
    actuator: ActuatorArg,
}

pub fn diagnose(a: &DiagnoseArgs) -> Result<ExitCode> {
    let settings = Settings {
        actuator: a.actuator.read()?,
        maps: a.maps.clone(),
        run: a.run,
        sequence: a.recording.sequence.clone(),
        sensors: a.recording.sensors.clone(),
        grid: sim_worker::datasets::grid(&a.grid)?,
    };
    let case = case::run(&a.file, &settings)?;
    if a.json {
        say(&diagnoser::report::to_json(&case.diagnosis).to_string());
    } else {
        say(&case::to_text(&case));
    }
    if let Some(dir) = &a.plot {
        let d = &case.diagnosis;
        let figures = report_pages::case_figures("diagnosis", &case.maps, d, None);
        let section = Section {
            title: "Diagnosis".into(),
            text: case::to_text(&case),
            tables: Vec::new(),
            figures,
        };
        let report = Report {
            title: format!("Diagnosis of {}", a.file.display()),
            summary: format!("Outcome: {}.", d.outcome.name().replace('_', " ")),
            facts: Vec::new(),
            sections: vec![section],
        };
        report::write(&report, dir, "diagnosis.html")?;
    }
    Ok(match case.diagnosis.outcome {
        Outcome::Incomplete { .. } => ExitCode::from(EXIT_LOSS),
        _ => ExitCode::SUCCESS,
    })
}
