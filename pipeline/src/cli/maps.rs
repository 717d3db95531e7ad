//! `ema maps`, which is `ema dataset maps`.

use super::{say, say_json};
use crate::dataset::Dataset;
use crate::dataset::maps::{Chosen, MAPS, files, table};
use anyhow::Result;
use clap::Args;
use diagnoser::calibration::COVERAGE;
use diagnoser::failure_map::FailureMapSet;
use diagnoser::map_library::Choice;
use diagnoser::quality::MapQuality;
use schemas::error::{EXIT_LOSS, Error};
use std::path::{Path, PathBuf};
use std::process::ExitCode;

#[derive(Args)]
pub struct MapsArgs {
    /// Dataset (ema simulate, ema dataset make): a folder, or s3://BUCKET/PREFIX
    dataset: String,
    /// Only the maps of this actuator of a fleet, as files into --out
    // a file of parameters is called `--actuator` everywhere else
    #[arg(long, value_name = "ID", alias = "actuator")]
    id: Option<String>,
    /// Folder (or .parquet file) for the maps of one actuator; the dataset's own if left out and there is one
    #[arg(long)]
    out: Option<PathBuf>,
    /// Which of the dataset's rest angles [deg]
    #[arg(long, allow_negative_numbers = true)]
    rest_angle_deg: Option<f64>,
    /// Leave out a feature whose surface is not monotone enough instead of refusing (a fleet's are always left out)
    #[arg(long)]
    lenient: bool,
    /// Report on the maps: shape, sensitivity, whether they tell FSJ from zeta cell by cell, convergence of the grid,
    /// and what to add next
    #[arg(long)]
    quality: bool,
    /// Spread that the report allows for: none, fleet, or a TOML file; needs its calibration (ema calibrate)
    #[arg(long, default_value = "none", requires = "quality")]
    spread: String,
    /// The report with keys for programs, every cell included
    #[arg(long, requires = "quality")]
    json: bool,
}

pub fn maps(a: &MapsArgs) -> Result<ExitCode> {
    let d = Dataset::open(&a.dataset)?;
    let alone = d.plan.actuators.len() == 1;
    if !alone && a.id.is_none() {
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
        actuator: a.id.as_deref(),
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
