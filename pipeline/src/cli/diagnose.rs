//! `ema diagnose`.

use super::{ActuatorArg, RecordingArgs, say};
use crate::case::{self, Case, Settings};
use crate::map_table;
use crate::refine::{self, Refined};
use crate::report::{self, Report, Section};
use crate::report_pages;
use anyhow::Result;
use clap::Args;
use diagnoser::diagnosis::{Outcome, parse_known};
use diagnoser::failure_map::FailureMapSet;
use diagnoser::map_library::Choice;
use diagnoser::unit::UnitFile;
use schemas::error::EXIT_LOSS;
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
    /// Telemetry: the project's Parquet; a table with columns t, com, theta_m, omega_m and i_eq or i_a, i_b, i_c in CSV
    /// (any separator, decimal comma, units in the header or below it, gzip, zstd), Parquet or Arrow IPC of any program;
    /// or a dataset (--run chooses the run)
    file: PathBuf,
    /// Folder (or file) of saved maps; those of the actuator, made on first use, if left out
    #[arg(long)]
    maps: Option<PathBuf>,
    /// FILE holds features, a row each test, in the columns of schemas/README.md; a diagnosis each
    #[arg(long, requires = "maps", conflicts_with_all = ["refine", "unit", "plot", "run"])]
    features: bool,
    /// Keys for programs
    #[arg(long)]
    json: bool,
    /// Run of a file or dataset that holds several
    #[arg(long)]
    run: Option<u64>,
    #[command(flatten)]
    recording: RecordingArgs,
    /// Grid of maps made on first use
    #[arg(long, default_value = "fine")]
    grid: String,
    /// Spread from unit to unit that the intervals allow for: none (the recording is of the very actuator
    /// of the maps), fleet (all values assumed), a TOML file, or own: as well as the actuator's file says that it was
    /// identified by a study, else none
    #[arg(long, default_value = "own")]
    spread: String,
    /// What is known of the unit, KEY=NUMBER, of supply_voltage_v, winding_temperature_degc,
    /// phase_resistance_ohm, back_emf_v_s_per_rad, inertia_kg_m2, dynamic_ratio, rest_angle_rad, phase_inductance_h,
    /// viscous_n_m_s_per_rad; it narrows a spread
    #[arg(long, value_name = "KEY=NUMBER", value_delimiter = ',')]
    known: Vec<String>,
    /// File of the unit that was tested (ema unit): what its own tests say of its constants; faults are then relative to
    /// the healthy unit
    #[arg(long, value_name = "UNIT", conflicts_with_all = ["actuator", "maps", "spread", "refine"])]
    unit: Option<PathBuf>,
    /// How maps are inverted: joint (all of them together, intervals of stated coverage), or the paper's own construction
    /// with P1, P2 and P3 (5.1), which states none
    #[arg(long, value_enum, default_value_t = Method::Joint)]
    method: Method,
    /// Also fit the faults, and the unit's causes, by running the test bench itself: some seconds, and what the maps
    /// lose against it
    #[arg(long)]
    refine: bool,
    /// Share of tests whose true pair the intervals hold
    #[arg(long, default_value_t = diagnoser::calibration::COVERAGE)]
    coverage: f64,
    /// Also draw maps, cuts and the located area into this folder
    #[arg(long)]
    plot: Option<PathBuf>,
    #[command(flatten)]
    actuator: ActuatorArg,
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

/// Diagnoses a table of features, a line a row.
fn of_features(a: &DiagnoseArgs, choice: &Choice) -> Result<ExitCode> {
    let maps = a.maps.as_deref().unwrap_or(Path::new("."));
    let file = if maps.is_dir() {
        maps.join("maps.parquet")
    } else {
        maps.into()
    };
    let set = FailureMapSet::load(&file)?;
    let actuator = a.actuator.read()?;
    let known = parse_known(&a.known, &actuator, set.header.kind.rest_angle_rad)?;
    let diagnoser = choice.ready(&file, set, &known)?;
    let mut all = true;
    for row in map_table::diagnose(&a.file, &diagnoser)? {
        let d = match a.method {
            Method::Joint => row.diagnosis,
            Method::Paper => diagnoser::paper::diagnose(&diagnoser, &row.diagnosis.features, &[]),
        };
        all &= !matches!(d.outcome, Outcome::Incomplete { .. });
        if a.json {
            let mut json = diagnoser::report::to_json(&d);
            json["row"] = row.place.into();
            json["truth"] = row
                .fault
                .map(|f| serde_json::json!({"fsj": f.fsj, "zeta": f.zeta}))
                .into();
            say(&json.to_string());
            continue;
        }
        let area = d.outcome.area().map(|x| {
            format!(
                "  FSJ {:.4} .. {:.4}  zeta {:.5} .. {:.5}",
                x.fsj.lo, x.fsj.hi, x.zeta.lo, x.zeta.hi
            )
        });
        let truth = row.fault.map(|f| format!("  (said: {}, {})", f.fsj, f.zeta));
        let (area, truth) = (area.unwrap_or_default(), truth.unwrap_or_default());
        say(&format!("{:<9} {:<12}{area}{truth}", row.place, d.outcome.name()));
    }
    Ok(if all {
        ExitCode::SUCCESS
    } else {
        ExitCode::from(EXIT_LOSS)
    })
}

pub fn diagnose(a: &DiagnoseArgs) -> Result<ExitCode> {
    let actuator = a.actuator.named()?;
    let spread = if a.spread == "own" {
        case::own_spread(actuator.as_deref())
    } else {
        sim_worker::catalogue::spread(&a.spread)?
    };
    let choice = Choice::new(spread, a.coverage)?;
    if a.features {
        return of_features(a, &choice);
    }
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
        Some(refine::of_case(&case, &settings)?)
    } else {
        None
    };
    // what no pair of faults explains is something that the model does not have
    let unexplained = matches!(case.diagnosis.outcome, Outcome::Unexplained { .. });
    let next = unexplained.then(|| {
        let unit = settings.unit.as_deref().zip(a.unit.as_deref());
        case::next_command(&a.file, unit, a.actuator.path())
    });
    if a.json {
        let next = next.as_ref().map(|n| n.0.as_str());
        let json = case::to_json(&case, settings.unit.as_deref(), refined.as_ref(), next);
        say(&json.to_string());
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
