//! `ema diagnose`.

use super::{ActuatorArg, RecordingArgs, say};
use crate::case::{self, Settings};
use crate::report::{self, Report, Section};
use crate::report_pages;
use anyhow::Result;
use clap::Args;
use diagnoser::diagnosis::Outcome;
use diagnoser::map_library::Choice;
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
    /// Spread from unit to unit that the intervals allow for: none (the recording is of the very actuator
    /// of the maps), fleet (all values assumed), or a TOML file
    #[arg(long, default_value = "none")]
    spread: String,
    /// What is known of the unit, KEY=NUMBER, of supply_voltage_v, winding_temperature_degc,
    /// phase_resistance_ohm, back_emf_v_s_per_rad, inertia_kg_m2, dynamic_ratio, rest_angle_rad; it narrows a spread
    #[arg(long, value_name = "KEY=NUMBER", value_delimiter = ',')]
    known: Vec<String>,
    /// Share of tests whose true pair the intervals hold
    #[arg(long, default_value_t = diagnoser::calibration::COVERAGE)]
    coverage: f64,
    /// Also draw maps, cuts and the located area into this folder
    #[arg(long)]
    plot: Option<PathBuf>,
    #[command(flatten)]
    actuator: ActuatorArg,
}

impl DiagnoseArgs {
    /// The command that studies this recording.
    fn study(&self) -> String {
        let model = self
            .actuator
            .path()
            .map_or(crate::discrepancy::REFERENCE.into(), quoted);
        format!(
            "ema discrepancy --model {model} --bench {} --out study",
            quoted(&self.file)
        )
    }
}

/// A path as a shell takes it.
fn quoted(path: &std::path::Path) -> String {
    let text = path.display().to_string();
    let plain = |c: char| c.is_ascii_alphanumeric() || "/._-+=:,".contains(c);
    if text.chars().all(plain) {
        text
    } else {
        format!("'{}'", text.replace('\'', "'\\''"))
    }
}

pub fn diagnose(a: &DiagnoseArgs) -> Result<ExitCode> {
    let settings = Settings {
        actuator: a.actuator.read()?,
        maps: a.maps.clone(),
        run: a.run,
        sequence: a.recording.sequence.clone(),
        sensors: a.recording.sensors.clone(),
        grid: sim_worker::datasets::grid(&a.grid)?,
        choice: Choice {
            spread: sim_worker::datasets::spread(&a.spread)?,
            coverage: a.coverage,
        },
        known: a.known.clone(),
    };
    let case = case::run(&a.file, &settings)?;
    // what no pair of faults explains is something that the model does not have
    let next = matches!(case.diagnosis.outcome, Outcome::Unexplained { .. }).then(|| a.study());
    if a.json {
        let mut json = diagnoser::report::to_json(&case.diagnosis);
        if let Some(next) = &next {
            json["next_command"] = next.clone().into();
        }
        say(&json.to_string());
    } else {
        say(&case::to_text(&case));
        if let Some(next) = &next {
            say(&format!(
                "next      {next}\n          (finds what is missing from the model)"
            ));
        }
    }
    if let Some(dir) = &a.plot {
        let d = &case.diagnosis;
        let figures = report_pages::case_figures("diagnosis", &case.diagnoser, d, None);
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
