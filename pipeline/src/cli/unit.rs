//! `ema unit`.

use super::{ActuatorArg, RecordingArgs, say, say_json};
use crate::case::{Settings, quoted};
use crate::unit::{Beginning, Kinds, REFERENCE, Shown, begin, constants, show, to_json};
use anyhow::Result;
use clap::{Args, Subcommand};
use diagnoser::unit::{RepairedPart, TestEntry, UnitFile};
use schemas::error::EXIT_LOSS;
use sim_worker::parameters::ActuatorParameters;
use sim_worker::sensor::{CurrentSampling, SensorModel, SpeedSource};
use sim_worker::spread::Cause;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::Arc;

#[derive(Subcommand)]
pub enum UnitCommand {
    /// Begin a unit: a model, and how well its constants are known
    New(NewArgs),
    /// Show recordings of pre-flight tests to a unit
    Update(UpdateArgs),
    /// Record that a part of a unit was renewed: its faults, and what its tests said, are forgotten
    Repair(RepairArgs),
    /// What is known of a unit, and by which tests
    Show(ShowArgs),
}

#[derive(Args)]
pub struct NewArgs {
    /// File to be written
    unit: PathBuf,
    #[command(flatten)]
    actuator: ActuatorArg,
    /// Folder of a study of this unit (ema discrepancy --out): the model is the one that it wrote, with how well it knows
    /// the constants, and tests are read by the sensors that it saw
    #[arg(long, value_name = "STUDY_DIR")]
    study: Option<PathBuf>,
    /// How units of the type and their tests differ where no study says it: unit (all values assumed) or a TOML file
    #[arg(long, default_value = "unit")]
    spread: String,
    /// What the unit is called; the name of the file if left out
    #[arg(long)]
    name: Option<String>,
}

#[derive(Args)]
pub struct UpdateArgs {
    /// File of the unit
    unit: PathBuf,
    /// Recordings of whole pre-flight tests of this unit, in order
    #[arg(required = true, value_name = "RECORDING")]
    recordings: Vec<PathBuf>,
    /// The unit was healthy in them: faults are relative to what it was then
    #[arg(long)]
    healthy: bool,
    #[command(flatten)]
    recording: RecordingArgs,
    /// Grid of maps made on first use
    #[arg(long, default_value = "fine")]
    grid: String,
    /// Keys for programs
    #[arg(long)]
    json: bool,
}

#[derive(Args)]
pub struct RepairArgs {
    /// File of the unit
    unit: PathBuf,
    /// What was renewed: transmission (gears, ball screw), motor (winding, magnets, rotor, bearings) or all
    ///
    /// Its constants may be anything that units of the type have, until healthy tests of the repaired unit say more; faults are
    /// relative to the type until then. Effects of the unit's model stay: where they may have changed, study the unit anew.
    #[arg(long, value_parser = RepairedPart::ALL.map(|p| p.0))]
    part: String,
    /// What was done, in words, for the history
    #[arg(long, default_value = "")]
    note: String,
    /// Keys for programs
    #[arg(long)]
    json: bool,
}

#[derive(Args)]
pub struct ShowArgs {
    /// File of the unit
    unit: PathBuf,
    /// Keys for programs
    #[arg(long)]
    json: bool,
}

pub fn unit(c: &UnitCommand) -> Result<ExitCode> {
    match c {
        UnitCommand::New(a) => new(a),
        UnitCommand::Update(a) => update(a),
        UnitCommand::Repair(a) => {
            let mut unit = UnitFile::load(&a.unit)?;
            let part = RepairedPart::ALL.into_iter().find(|p| p.0 == a.part);
            unit.repair(part.expect("checked by the command line").1, a.note.clone());
            unit.save(&a.unit)?;
            told(&unit, a.json);
            Ok(ExitCode::SUCCESS)
        }
        UnitCommand::Show(a) => {
            let unit = UnitFile::load(&a.unit)?;
            told(&unit, a.json);
            Ok(ExitCode::SUCCESS)
        }
    }
}

fn told(unit: &UnitFile, as_json: bool) {
    if as_json {
        say_json(to_json(unit));
    } else {
        say(&text(unit));
    }
}

fn new(a: &NewArgs) -> Result<ExitCode> {
    let file = a
        .actuator
        .path()
        .filter(|p| *p != Path::new(ActuatorParameters::BUILT_IN));
    let source = file.map_or(REFERENCE.into(), |p| p.display().to_string());
    let beginning = Beginning {
        actuator: a.actuator.named()?.map(|named| (named.as_ref().clone(), source)),
        study: a.study.clone(),
        spread: sim_worker::catalogue::spread(&a.spread)?,
        name: a.name.clone(),
    };
    let unit = begin(&a.unit, beginning)?;
    say(&text(&unit));
    say(&format!(
        "next      ema unit update {} RECORDING... --healthy",
        quoted(&a.unit)
    ));
    Ok(ExitCode::SUCCESS)
}

fn update(a: &UpdateArgs) -> Result<ExitCode> {
    let mut unit = UnitFile::load(&a.unit)?;
    let settings = Settings {
        sequence: a.recording.sequence.clone(),
        sensors: a.recording.sensors.clone(),
        channels: a.recording.channel_map()?,
        grid: sim_worker::catalogue::grid(&a.grid)?,
        ..Settings::of_actuator(Arc::new(unit.actuator.clone()))?
    };
    let mut kinds = Kinds::default();
    let mut shown = Vec::new();
    for path in &a.recordings {
        let what = show(&mut unit, path, a.healthy, &settings, &mut kinds)?;
        // each as it comes: what is done is kept
        unit.save(&a.unit)?;
        if !a.json {
            let words = match &what {
                Shown::Taken => "taken".to_string(),
                Shown::Again => "known already".into(),
                Shown::Refused(reason) => format!("changes nothing: {reason}"),
            };
            let last = unit.tests.last().filter(|_| what == Shown::Taken);
            let faults = last.map_or(String::new(), located);
            say(&format!("{}: {words}{faults}", path.display()));
        }
        shown.push(what);
    }
    told(&unit, a.json);
    let refused = shown.iter().any(|s| matches!(s, Shown::Refused(_)));
    Ok(if refused {
        ExitCode::from(EXIT_LOSS)
    } else {
        ExitCode::SUCCESS
    })
}

fn text(unit: &UnitFile) -> String {
    let mut out = format!("unit      {}\nmodel     {}\n", unit.name, unit.source);
    out += &format!(
        "tests     {} known, {} of them healthy; faults are relative to the {}\n",
        unit.taken(),
        unit.healthy(),
        unit.reference()
    );
    if let Some(s) = &unit.sensors {
        out += &format!("sensors   {}\n", sensors_in_words(s));
    }
    for (c, mean, sd, before) in constants(unit) {
        let sigmas = matches!(c, Cause::EffectAmplitude | Cause::EffectShape);
        let (scale, of) = if sigmas {
            (1.0, "standard deviations of its study")
        } else {
            (100.0, "% of the model's")
        };
        out += &format!(
            "constant  {}: {:+.2} +- {:.2} {of} (+- {:.2} before any test)\n",
            c.title(),
            scale * mean,
            scale * sd,
            scale * before
        );
    }
    for before in 0..=unit.repairs.len() {
        let tests = unit.tests.iter().filter(|t| t.repairs == before);
        out.extend(tests.map(line));
        if let Some(r) = unit.repairs.get(before) {
            let note = if r.note.is_empty() {
                String::new()
            } else {
                format!(", {}", r.note)
            };
            out += &format!("repair    {}{note}: tests before it no longer count\n", r.part.name());
        }
    }
    out
}

fn sensors_in_words(s: &SensorModel) -> String {
    let currents = match s.sampling.currents {
        CurrentSampling::Mean => "means over a sample",
        CurrentSampling::Point => "points",
    };
    let speed = match s.sampling.speed {
        SpeedSource::Sensor => format!("speed noise {:.3} rad/s", s.speed_noise_rad_per_s),
        SpeedSource::Angle => "speed of the angle's changes".into(),
    };
    format!(
        "{}: angle {} bit, {speed}, currents {currents} in steps of {:.4} A, noise {:.4} A, offsets up to {:.3} A",
        s.name,
        s.resolver_bits,
        s.current_count_a(),
        s.current_noise_a,
        s.current_offset_a
    )
}

/// The faults of a test that was located.
fn located(t: &TestEntry) -> String {
    match (t.fsj, t.zeta) {
        (Some(f), Some(z)) => format!(
            ", FSJ {:.3} in {:.3} .. {:.3}, zeta {:.4} in {:.4} .. {:.4}",
            f.1, f.0, f.2, z.1, z.0, z.2
        ),
        _ => String::new(),
    }
}

/// A test of the history.
fn line(t: &TestEntry) -> String {
    let found = located(t);
    let kept = if t.is_taken() {
        String::new()
    } else {
        format!(" (not taken: {})", t.reason)
    };
    let healthy = if t.healthy { "healthy, " } else { "" };
    format!(
        "test      {}: {healthy}{}{found}{kept}\n",
        t.file,
        t.outcome.replace('_', " ")
    )
}
