//! `ema diagnose`.

use super::{ActuatorArg, MAPS, MODEL, OUTPUT, RECORDING, RecordingArgs, say, say_json};
use crate::case::{self, Case, Settings, quoted};
use crate::map_table;
use crate::refine::{self, Refined};
use crate::report::{self, Report};
use crate::report_pages::{
    self,
    conclusion::{Around, OfUnit},
};
use anyhow::Result;
use clap::Args;
use diagnoser::diagnosis::{Outcome, parse_known};
use diagnoser::failure_map::FailureMapSet;
use diagnoser::map_library::{Choice, file_in};
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
    /// Telemetry: a recording, a table of any program, or a dataset
    ///
    /// The project's Parquet; a table with columns t, com, theta_m, omega_m and i_eq or i_a, i_b, i_c in CSV
    /// (any separator, decimal comma, units in the header or below it, gzip, zstd), Parquet or Arrow IPC of any program;
    /// or a dataset (--run chooses the run).
    file: PathBuf,
    /// Folder (or file) of saved maps; those of the actuator, made on first use, if left out
    #[arg(long, value_name = "PATH", help_heading = MAPS)]
    maps: Option<PathBuf>,
    /// FILE holds features, a row each test, in the columns of schemas/README.md; a diagnosis each
    #[arg(long, help_heading = RECORDING, requires = "maps", conflicts_with_all = ["refine", "unit", "plot", "run"])]
    features: bool,
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
    /// Spread from unit to unit that the intervals allow for: none, fleet, field, bridge, service, own, or a TOML file
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
    /// The unit's causes too, by some hundred runs of the test bench: half a minute. Where units differ, intervals of FSJ are 0.4
    /// (supply recorded) to 0.7 times as wide.
    #[arg(long, help_heading = MAPS)]
    refine: bool,
    /// Share of tests whose true pair the intervals hold
    #[arg(long, default_value_t = diagnoser::calibration::COVERAGE, help_heading = MAPS)]
    coverage: f64,
    /// Also write the page diagnosis.html and its figures into this folder
    ///
    /// What was found, how sure, what to do next, the located area, maps and cuts; each figure as SVG too.
    #[arg(long, value_name = "DIR", help_heading = OUTPUT)]
    plot: Option<PathBuf>,
    #[command(flatten)]
    actuator: ActuatorArg,
}

fn refined_text(r: &Refined, case: &Case) -> String {
    let [f, f0, f1] = case::three(r.estimate.0, r.fsj);
    let [z, z0, z1] = case::three(r.estimate.1, r.zeta);
    let mut out = format!(
        "refined   FSJ {f} in {f0} .. {f1}, zeta {z} in {z0} .. {z1}\n          by {} runs of the test bench{}, misfit {:.1} \
         (about {} is usual)\n",
        r.runs,
        if r.converged { "" } else { ", not settled" },
        r.misfit,
        r.features.len().saturating_sub(2)
    );
    if !r.fits() {
        out += &format!(
            "          no unit of the spread makes such a test (misfit of 999 in 1000: at most {:.0}): these intervals hold nothing\n",
            r.greatest_misfit()
        );
    } else if let Some(a) = case.diagnosis.outcome.area() {
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
        _ if unit.contradicted().is_some() => "its own healthy tests contradict its model (ema unit show UNIT)",
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
    let file = file_in(maps);
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
            say_json(json);
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

/// Name of the page.
const PAGE: &str = "diagnosis.html";

/// The page of what was found.
fn page(
    a: &DiagnoseArgs,
    case: &Case,
    unit: Option<&UnitFile>,
    next: Option<&(Option<String>, &'static str)>,
    refined: Option<&Refined>,
) -> Report {
    let around = Around {
        recording: quoted(&a.file),
        next: next.and_then(|(command, why)| Some((command.clone()?, why.to_string()))),
        unit: unit.zip(a.unit.as_deref()).map(|(u, path)| OfUnit {
            file: quoted(path),
            relative: u.reference() == "unit",
        }),
    };
    // lines of the console as paragraphs
    let paragraphs = |text: String| text.lines().map(str::trim).collect::<Vec<_>>().join("\n\n");
    let mut more = Vec::new();
    if let Some(unit) = unit {
        more.push(("The unit".to_string(), of_unit(unit).replacen("unit ", "", 1)));
    }
    if let Some(alike) = case::alike_text(case, unit) {
        let (first, rest) = alike.split_at(1);
        let text = format!("{}{rest}.", first.to_uppercase());
        more.push(("What reads as friction".to_string(), text));
    }
    if let Some(r) = refined {
        let text = refined_text(r, case).replacen("refined ", "", 1);
        more.push(("Fitted by the test bench itself".to_string(), paragraphs(text)));
    }
    report_pages::diagnosis::report(&a.file, case, &around, more)
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
        case::next_command(&a.file, &case, unit, a.actuator.path(), a.recording.channels.as_deref())
    });
    let page = match &a.plot {
        Some(dir) => {
            let report = page(a, &case, settings.unit.as_deref(), next.as_ref(), refined.as_ref());
            report::write(&report, dir, PAGE)?;
            Some(dir.join(PAGE))
        }
        None => None,
    };
    if a.json {
        let command = next.as_ref().and_then(|n| n.0.as_deref());
        let mut json = case::to_json(&case, settings.unit.as_deref(), refined.as_ref(), command);
        if let Some(page) = &page {
            json["page"] = page.display().to_string().into();
        }
        say_json(json);
    } else {
        say(&case::to_text(&case, settings.unit.as_deref()));
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
        // nobody says that the unit is the very actuator of the maps
        if case.measured.is_foreign()
            && a.spread == "own"
            && settings.choice.spread.is_none()
            && settings.unit.is_none()
        {
            say(
                "advice    the intervals are for the very actuator of the maps, of a real unit they are too narrow: --spread fleet, or \
                 --unit with a file of the unit (ema unit new)",
            );
        }
        match &next {
            Some((Some(command), why)) => say(&format!("next      {command}\n          ({why})")),
            Some((None, why)) => say(&format!("next      {why}")),
            None => {}
        }
        if let Some(page) = &page {
            say(&format!("page      {}", page.display()));
        }
    }
    Ok(match case.diagnosis.outcome {
        Outcome::Incomplete { .. } => ExitCode::from(EXIT_LOSS),
        _ => ExitCode::SUCCESS,
    })
}
