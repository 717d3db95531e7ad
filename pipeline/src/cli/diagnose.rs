//! `ema diagnose`.

use super::{ActuatorArg, MAPS, MODEL, OUTPUT, RECORDING, RecordingArgs, say, say_json};
use crate::case::{self, Case, Settings};
use crate::refine::{self, Refined, Start, Test};
use crate::report::{self, Report, Section};
use crate::report_pages;
use anyhow::Result;
use clap::Args;
use diagnoser::diagnosis::{Outcome, parse_known};
use diagnoser::map_library::Choice;
use diagnoser::unit::{BASELINES, UnitFile};
use schemas::error::EXIT_LOSS;
use schemas::fault::Interval;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::Arc;

#[derive(Clone, Copy, PartialEq, clap::ValueEnum)]
enum Method {
    Joint,
    Paper,
}

#[derive(Args)]
pub struct DiagnoseArgs {
    /// Telemetry: a recording, a table of any program, or a dataset
    ///
    /// The project's Parquet; a table with columns t, com, theta_m, omega_m and i_eq or i_a, i_b, i_c in CSV
    /// (any separator, decimal comma, units in the header or below it, gzip, zstd), Parquet or Arrow IPC of any program;
    /// or a dataset (--run chooses the run).
    file: PathBuf,
    /// Folder (or file) of saved maps; those of the actuator, made on first use, if left out
    #[arg(long, value_name = "PATH", help_heading = MAPS)]
    maps: Option<PathBuf>,
    /// Keys for programs (schemas/json/diagnose.schema.json)
    #[arg(long, help_heading = OUTPUT)]
    json: bool,
    /// Run of a file or dataset that holds several
    #[arg(long, value_name = "N", help_heading = RECORDING)]
    run: Option<u64>,
    #[command(flatten)]
    recording: RecordingArgs,
    /// Grid of maps made on first use
    #[arg(long, default_value = "fine", help_heading = MAPS)]
    grid: String,
    /// Spread from unit to unit that the intervals allow for: none, fleet, own, or a TOML file
    ///
    /// none: the recording is of the very actuator of the maps; fleet: all values assumed; own: as well as the actuator's
    /// file says that it was identified by a study, else none.
    #[arg(long, default_value = "own", help_heading = MAPS)]
    spread: String,
    /// What is known of the unit; it narrows a spread
    ///
    /// KEY is one of supply_voltage_v, winding_temperature_degc, phase_resistance_ohm, back_emf_v_s_per_rad,
    /// inertia_kg_m2, dynamic_ratio, rest_angle_rad, phase_inductance_h, viscous_n_m_s_per_rad.
    #[arg(long, value_name = "KEY=NUMBER", value_delimiter = ',', help_heading = MODEL)]
    known: Vec<String>,
    /// File of the unit that was tested (ema unit)
    ///
    /// What its own tests say of its constants; faults are then relative to the healthy unit.
    #[arg(long, value_name = "UNIT", help_heading = MODEL, conflicts_with_all = ["actuator", "maps", "spread", "refine"])]
    unit: Option<PathBuf>,
    /// How maps are inverted
    ///
    /// joint: all of them together, intervals of stated coverage; paper: its own construction with P1, P2 and P3 (5.1),
    /// which states none.
    #[arg(long, value_enum, default_value_t = Method::Joint, help_heading = MAPS)]
    method: Method,
    /// Also fit the faults by running the test bench itself
    ///
    /// The unit's causes too: it takes some seconds, and shows what the maps lose against it.
    #[arg(long, help_heading = MAPS)]
    refine: bool,
    /// Share of tests whose true pair the intervals hold
    #[arg(long, default_value_t = diagnoser::calibration::COVERAGE, help_heading = MAPS)]
    coverage: f64,
    /// Also draw maps, cuts and the located area into this folder
    #[arg(long, value_name = "DIR", help_heading = OUTPUT)]
    plot: Option<PathBuf>,
    #[command(flatten)]
    actuator: ActuatorArg,
}

impl DiagnoseArgs {
    /// The command that makes more of a recording that nothing explains, and what for.
    fn next(&self, unit: Option<&UnitFile>) -> (String, &'static str) {
        if let Some((unit, path)) = unit.zip(self.unit.as_deref()).filter(|(u, _)| u.healthy() < BASELINES) {
            let more = match unit.healthy() {
                0 => "healthy tests of this very unit: what its model is off by is then known",
                _ => "more healthy tests of this very unit: three or more also show what its model is off by",
            };
            return (format!("ema unit update {} RECORDING... --healthy", quoted(path)), more);
        }
        (self.study(unit), "finds what is missing from the model")
    }

    /// The command that studies this recording.
    fn study(&self, unit: Option<&UnitFile>) -> String {
        let of_unit = unit.map(|u| Path::new(&u.source)).filter(|p| p.exists());
        let model = of_unit.or(self.actuator.path());
        let model = model.map_or(crate::discrepancy::REFERENCE.into(), quoted);
        format!(
            "ema discrepancy --actuator {model} --bench {} --out study",
            quoted(&self.file)
        )
    }
}

/// Fits the recording by running the test bench.
fn refine(a: &DiagnoseArgs, settings: &Settings, case: &Case) -> Result<Refined> {
    let header = &case.diagnoser.maps.header;
    let known = parse_known(&a.known, &case.setup.actuator, header.kind.rest_angle_rad)?;
    let test = Test {
        setup: &case.setup,
        nominal: &case.diagnoser.maps.nominal,
        features: &case.diagnosis.features,
        spread: &settings.choice.spread,
        known: &known,
    };
    let start = case.diagnosis.outcome.area().map(Start::of);
    let refined = refine::refine(&test, start, settings.choice.coverage, 0)?;
    refined.ok_or(crate::Interrupted.into())
}

fn refined_json(r: &Refined) -> serde_json::Value {
    let interval =
        |i: Interval, e: f64, sigma: f64| serde_json::json!({"lo": i.lo, "hi": i.hi, "estimate": e, "sigma": sigma});
    let cause = |c: &refine::FittedCause| serde_json::json!({"cause": c.cause.key(), "share_of_half_width": c.share, "sigma": c.sigma});
    serde_json::json!({
        "fsj": interval(r.fsj, r.estimate.0, r.sigma.0),
        "zeta": interval(r.zeta, r.estimate.1, r.sigma.1),
        "correlation": r.correlation,
        "misfit": r.misfit,
        "runs": r.runs,
        "converged": r.converged,
        "causes": r.causes.iter().map(cause).collect::<Vec<_>>(),
    })
}

fn refined_text(r: &Refined, case: &Case) -> String {
    let mut out = format!(
        "refined   FSJ {:.4} in {:.4} .. {:.4}, zeta {:.5} in {:.5} .. {:.5}\n          by {} runs of the test bench{}, misfit {:.1} \
         (about {} is usual)\n",
        r.estimate.0,
        r.fsj.lo,
        r.fsj.hi,
        r.estimate.1,
        r.zeta.lo,
        r.zeta.hi,
        r.runs,
        if r.converged { "" } else { ", not settled" },
        r.misfit,
        r.features.len().saturating_sub(2)
    );
    if let Some(a) = case.diagnosis.outcome.area() {
        out += &format!(
            "          the maps' intervals are {:.2} (FSJ) and {:.2} (zeta) times as wide\n",
            a.fsj.width() / r.fsj.width(),
            a.zeta.width() / r.zeta.width()
        );
    }
    for c in &r.causes {
        out += &format!(
            "          {}: {:+.2} +- {:.2} of its half-width\n",
            c.cause.title(),
            c.share,
            c.sigma
        );
    }
    out
}

/// What the diagnosis knows of the unit.
fn of_unit(unit: &UnitFile) -> String {
    let (taken, healthy) = (unit.taken(), unit.healthy());
    let relative = match unit.reference() {
        "unit" => "faults are relative to the healthy unit",
        _ => "no healthy test of it: faults are relative to its type (ema unit update UNIT RECORDING --healthy)",
    };
    format!(
        "unit      {}, {taken} test(s) known, {healthy} of them healthy; {relative}",
        unit.name
    )
}

/// A path as a shell takes it.
pub(super) fn quoted(path: &std::path::Path) -> String {
    let text = path.display().to_string();
    let plain = |c: char| c.is_ascii_alphanumeric() || "/._-+=:,".contains(c);
    if text.chars().all(plain) {
        text
    } else {
        format!("'{}'", text.replace('\'', "'\\''"))
    }
}

pub fn diagnose(a: &DiagnoseArgs) -> Result<ExitCode> {
    let actuator = a.actuator.named()?;
    let spread = if a.spread == "own" {
        case::own_spread(actuator.as_deref())
    } else {
        sim_worker::catalogue::spread(&a.spread)?
    };
    let choice = Choice::new(spread, a.coverage)?;
    let settings = Settings {
        actuator,
        maps: a.maps.clone(),
        run: a.run,
        sequence: a.recording.sequence.clone(),
        sensors: a.recording.sensors.clone(),
        channels: a.recording.channel_map()?,
        grid: sim_worker::catalogue::grid(&a.grid)?,
        choice,
        known: a.known.clone(),
        unit: a.unit.as_deref().map(UnitFile::load).transpose()?.map(Arc::new),
    };
    let mut case = case::run(&a.file, &settings)?;
    if a.method == Method::Paper {
        case.by_paper();
    }
    let refined = if a.refine {
        Some(refine(a, &settings, &case)?)
    } else {
        None
    };
    // what no pair of faults explains is something that the model does not have
    let unexplained = matches!(case.diagnosis.outcome, Outcome::Unexplained { .. });
    let next = unexplained.then(|| a.next(settings.unit.as_deref()));
    if a.json {
        let mut json = diagnoser::report::to_json(&case.diagnosis);
        if a.method == Method::Paper {
            json["method"] = "paper".into();
        }
        if let Some(r) = &refined {
            json["refined"] = refined_json(r);
        }
        if let Some(unit) = &settings.unit {
            json["unit"] = serde_json::json!({
                "name": unit.name, "tests": unit.taken(), "healthy_tests": unit.healthy(), "reference": unit.reference(),
            });
        }
        if !case.measured.said.is_empty() {
            json["read"] = case.measured.said.clone().into();
        }
        if let Some(next) = &next {
            json["next_command"] = next.0.clone().into();
        }
        say_json(json);
    } else {
        say(&case::to_text(&case));
        for (i, said) in case.measured.said.iter().enumerate() {
            say(&format!(
                "{:<9} {}",
                if i == 0 { "read" } else { "" },
                schemas::foreign::line(said)
            ));
        }
        if let Some(unit) = &settings.unit {
            say(&of_unit(unit));
        }
        if let Some(r) = &refined {
            say(&refined_text(r, &case));
        }
        if let Some(next) = &next {
            say(&format!("next      {}\n          ({})", next.0, next.1));
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
