//! `ema maps`, which is `ema dataset maps`.

use super::{RecordingArgs, say, say_json};
use crate::case::Settings;
use crate::dataset::Dataset;
use crate::dataset::maps::{Chosen, MAPS, files, table};
use crate::map_table::{self, FeatureKind};
use anyhow::Result;
use clap::Args;
use diagnoser::calibration::COVERAGE;
use diagnoser::failure_map::FailureMapSet;
use diagnoser::map_library::{Choice, file_for};
use diagnoser::quality::MapQuality;
use schemas::error::{EXIT_LOSS, Error};
use sim_worker::parameters::ActuatorParameters;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::Arc;

/// Heading of options on which maps.
const WHICH: &str = "Which maps";
/// Heading of options on a table of another simulator.
const TABLE: &str = "Table of another simulator";
/// Heading of options on what maps are worth.
const REPORT: &str = "Report on the maps";

#[derive(Args)]
pub struct MapsArgs {
    /// Dataset: a folder, or s3://BUCKET/PREFIX; or a table of any simulator's runs
    ///
    /// A dataset is of ema simulate or ema dataset make. A table (CSV, Parquet, Arrow IPC) of any simulator or rig has columns
    /// fsj, zeta and file (a recording each) or features (schemas/README.md): its full grid of faults makes the maps,
    /// repeats there their noise, and rows off the grid, 40 or more, calibrate them.
    dataset: String,
    /// Only the maps of this actuator of a fleet, as files into --out
    #[arg(long, value_name = "ID", help_heading = WHICH)]
    id: Option<String>,
    /// Of a table: actuator parameters, a TOML file; the reference actuator (values assumed) if left out
    ///
    /// Features are formed with its constants. (Of a fleet's dataset, what --id is.)
    #[arg(long, value_name = "FILE", help_heading = TABLE)]
    actuator: Option<String>,
    /// Folder (or .parquet file) for the maps of one actuator; the dataset's own if left out and there is one
    #[arg(long, help_heading = WHICH)]
    out: Option<PathBuf>,
    /// Rate of the telemetry that a table's features are of [Hz]; recordings say their own
    #[arg(long, default_value_t = 10_000.0, help_heading = TABLE)]
    rate: f64,
    #[command(flatten)]
    recording: RecordingArgs,
    /// Which of the dataset's rest angles [deg]; that of a table's features
    #[arg(long, allow_negative_numbers = true, help_heading = WHICH)]
    rest_angle_deg: Option<f64>,
    /// Leave out a feature whose surface is not monotone enough instead of refusing (a fleet's are always left out)
    #[arg(long, help_heading = WHICH)]
    lenient: bool,
    /// Report on the maps, and what to add next
    ///
    /// Their shape, sensitivity, whether they tell FSJ from zeta cell by cell, convergence of the grid.
    #[arg(long, help_heading = REPORT)]
    quality: bool,
    /// Spread that the report allows for: none, fleet, or a TOML file; needs its calibration (ema calibrate)
    #[arg(long, default_value = "none", requires = "quality", help_heading = REPORT)]
    spread: String,
    /// The report with keys for programs, every cell included
    #[arg(long, requires = "quality", help_heading = REPORT)]
    json: bool,
}

/// Maps of a table, and their calibration.
fn of_table(a: &MapsArgs) -> Result<ExitCode> {
    let path = Path::new(&a.dataset);
    let out = a.out.clone().ok_or_else(|| {
        let allowed = "a folder for the maps of a table";
        Error::bad("command line", "--out", "nothing", allowed)
    })?;
    let actuator = match &a.actuator {
        Some(file) => ActuatorParameters::read(Path::new(file))?,
        None => ActuatorParameters::reference(),
    };
    let settings = Settings {
        sequence: a.recording.sequence.clone(),
        sensors: a.recording.sensors.clone(),
        channels: a.recording.channel_map()?,
        ..Settings::of_actuator(Arc::new(actuator))?
    };
    let kind = FeatureKind {
        rate_hz: a.rate,
        rest_angle_rad: a.rest_angle_deg.unwrap_or(0.0).to_radians(),
    };
    let made = map_table::make(path, &settings, &kind, a.lenient)?;
    let file = file_for(&out);
    let dir = file.parent().unwrap_or(Path::new(""));
    std::fs::create_dir_all(dir).map_err(|e| Error::io(dir, "cannot be made", e))?;
    made.set.save(&file)?;
    let calibration = Choice::usual().calibration_file(&file);
    match &made.calibration {
        Some(c) => c.save(&calibration)?,
        // what stands there belongs to other maps
        None if calibration.exists() => {
            std::fs::remove_file(&calibration).map_err(|e| Error::io(&calibration, "cannot be removed", e))?;
        }
        None => {}
    }
    say(&summary(&made.set));
    say(&format!("{} rows on the grid, {} off it", made.rows.0, made.rows.1));
    match &made.calibration {
        Some(c) => say(&format!("calibrated on {} of the rows off the grid", c.runs)),
        None => say(&format!(
            "not calibrated: intervals are a design figure; {} rows with all features off the grid calibrate them",
            map_table::FEWEST_TESTS
        )),
    }
    if !made.has_noise {
        say("no repeats and no standard deviations: the maps know no noise of sensors; only the calibration does");
    }
    say(&format!("saved {}", file.display()));
    Ok(ExitCode::SUCCESS)
}

pub fn maps(a: &MapsArgs) -> Result<ExitCode> {
    if Path::new(&a.dataset).is_file() {
        return of_table(a);
    }
    let d = Dataset::open(&a.dataset)?;
    let alone = d.plan.actuators.len() == 1;
    // a file of parameters is called `--actuator` everywhere else
    let id = a.id.as_deref().or(a.actuator.as_deref());
    if !alone && id.is_none() {
        let one = [
            ("--out", a.out.is_some()),
            ("--rest-angle-deg", a.rest_angle_deg.is_some()),
            ("--quality", a.quality),
        ];
        if let Some((option, _)) = one.iter().find(|(_, given)| *given) {
            let found = format!("a dataset of {} actuators", d.plan.actuators.len());
            return Err(Error::bad(
                "command line",
                *option,
                found,
                "with --id ID: it is for the maps of one",
            )
            .into());
        }
        return of_fleet(&d);
    }
    let chosen = Chosen {
        actuator: id,
        rest_angle_rad: a.rest_angle_deg.map(f64::to_radians),
        lenient: a.lenient,
    };
    let own = d.storage.local_path().filter(|_| alone);
    let out = a.out.clone().or(own).ok_or_else(|| {
        let allowed = "a folder for the maps of one actuator";
        Error::bad("command line", "--out", "nothing", allowed)
    })?;
    if alone {
        // for queries
        table(&d)?;
    }
    for (file, set) in files(&d, &chosen, &out)? {
        if a.quality {
            quality(a, &file, set)?;
            continue;
        }
        say(&summary(&set));
        say(&format!("saved {}", file.display()));
    }
    Ok(ExitCode::SUCCESS)
}

/// The maps of all actuators into the dataset.
fn of_fleet(d: &Dataset) -> Result<ExitCode> {
    let made = table(d)?;
    super::list("left out", &made.left_out);
    super::list("no maps:", &made.refused);
    say(&format!("{} sets of maps in {}", made.sets, d.storage.url(MAPS)));
    Ok(if made.refused.is_empty() {
        ExitCode::SUCCESS
    } else {
        ExitCode::from(EXIT_LOSS)
    })
}

fn quality(a: &MapsArgs, file: &Path, set: FailureMapSet) -> Result<()> {
    let choice = Choice {
        spread: sim_worker::catalogue::spread(&a.spread)?,
        coverage: COVERAGE,
    };
    let quality = MapQuality::of(&choice.ready(file, set, &Vec::new())?);
    if a.json {
        say_json(quality.to_json());
    } else {
        say(&quality.to_text());
    }
    Ok(())
}

/// Range and uncertainties of every map, a line each, and what was left out.
fn summary(set: &FailureMapSet) -> String {
    let mut out = String::new();
    for m in &set.maps {
        let (lo, hi) = m.range();
        let b = &m.budget;
        let residual = m.residual.iter().fold(0.0_f64, |a, &b| a.max(b));
        out += &format!(
            "{:11} {lo:.4e} .. {hi:.4e} {:5}  standard uncertainties: sensors {:.1e}, interpolation {:.1e}, one sample {:.1e}, projection up \
             to {residual:.1e}\n",
            m.feature.name(),
            m.feature.unit(),
            b.noise,
            b.interpolation,
            b.sample / 3f64.sqrt()
        );
    }
    for l in &set.header.left_out {
        out += &format!("left out {l}\n");
    }
    out
}
