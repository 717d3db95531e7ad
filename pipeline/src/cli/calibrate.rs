//! `ema calibrate`.

use super::{ActuatorArg, MAPS, MODEL, OUTPUT, say, say_json};
use crate::calibrate::{Effort, calibrate as campaign, setup_of};
use anyhow::Result;
use clap::Args;
use diagnoser::calibration::{COVERAGE, Calibration};
use diagnoser::diagnosis::Diagnoser;
use diagnoser::failure_map::FailureMapSet;
use diagnoser::map_library::{Choice, file_in};
use schemas::error::Error;
use std::path::PathBuf;
use std::process::ExitCode;

#[derive(Args)]
pub struct CalibrateArgs {
    /// Maps: a dataset folder with maps.parquet (ema maps), or the file
    maps: PathBuf,
    /// Spread from unit to unit: none (one actuator, known), fleet (all values assumed), or a TOML file
    #[arg(long, default_value = "none", help_heading = MAPS)]
    spread: String,
    /// Tests that the reach of the intervals comes from
    #[arg(long, default_value_t = 4096, value_parser = clap::value_parser!(u64).range(64..=1_000_000), help_heading = MAPS)]
    runs: u64,
    /// Further tests that the response to the spread comes from
    #[arg(long, default_value_t = 1024, value_parser = clap::value_parser!(u64).range(256..=1_000_000), help_heading = MAPS)]
    surface_runs: u64,
    /// Seed of the random units, faults and sensor noise
    #[arg(long, default_value_t = 0, help_heading = MAPS)]
    seed: u64,
    /// Coverage that is shown; the calibration serves any
    #[arg(long, default_value_t = COVERAGE, help_heading = OUTPUT)]
    coverage: f64,
    /// Sequence of the maps, if it is a TOML file of your own
    #[arg(long, help_heading = MODEL)]
    sequence: Option<String>,
    /// Sensor model of the maps, if it is a TOML file of your own
    #[arg(long, help_heading = MODEL)]
    sensors: Option<String>,
    /// Keys for programs
    #[arg(long, help_heading = OUTPUT)]
    json: bool,
    #[command(flatten)]
    actuator: ActuatorArg,
}

pub fn calibrate(a: &CalibrateArgs) -> Result<ExitCode> {
    let file = file_in(&a.maps);
    let choice = Choice::new(sim_worker::catalogue::spread(&a.spread)?, a.coverage)?;
    let set = FailureMapSet::load(&file)?;
    if crate::map_table::is_of_table(&set.header) {
        let found = "maps of another simulator's table";
        let allowed = "maps of our test bench, whose tests calibrate them; rows off the grid of the table calibrate these (ema maps TABLE)";
        return Err(Error::bad(file.display().to_string(), "maps", found, allowed).into());
    }
    let sequence = sim_worker::catalogue::sequence(a.sequence.as_deref().unwrap_or(&set.header.sequence))?;
    let usual = if set.header.kind.sensors == "none" {
        "none"
    } else {
        "reference"
    };
    let sensors = sim_worker::catalogue::sensors(a.sensors.as_deref().unwrap_or(usual))?;
    let setup = setup_of(&file, &set.header, a.actuator.read()?, sequence, sensors)?;
    let effort = Effort {
        runs: a.runs as usize,
        surface_runs: a.surface_runs as usize,
        seed: a.seed,
    };
    // refused before the work, not after it
    Diagnoser::new(set.clone(), None, a.coverage, &Vec::new())?;
    let made = campaign(&set, &setup, &choice.spread, effort)?.ok_or(crate::Interrupted)?;
    if made.misfits.is_empty() {
        let allowed = "tests that have every feature";
        return Err(Error::bad(file.display().to_string(), "calibration", "none", allowed).into());
    }
    let out = choice.calibration_file(&file);
    made.save(&out)?;
    let diagnoser = Diagnoser::new(set, Some(made.clone()), a.coverage, &Vec::new())?;
    if a.json {
        say_json(to_json(&diagnoser, &made));
    } else {
        say(&to_text(&diagnoser, &made));
        say(&format!("saved {}", out.display()));
    }
    Ok(ExitCode::SUCCESS)
}

/// Pairs at which budgets are shown: the middles of the quadrants.
fn places(d: &Diagnoser) -> [(f64, f64); 4] {
    let m = &d.maps.maps[0];
    let at = |x: &[f64], share: f64| x[0] + share * (x[x.len() - 1] - x[0]);
    [0, 1, 2, 3].map(|q| {
        (
            at(&m.fsj, 0.25 + 0.5 * (q % 2) as f64),
            at(&m.zeta, 0.25 + 0.5 * (q / 2) as f64),
        )
    })
}

fn to_text(d: &Diagnoser, c: &Calibration) -> String {
    let mut out = format!(
        "spread {}: {} tests, {} for the response; {:.1} % of pairs in the intervals\n",
        c.spread,
        c.runs,
        c.surface_runs,
        100.0 * d.coverage()
    );
    out += &format!(
        "{} of {} tests have every feature; unexplained from misfit {:.2} on\n\n",
        c.misfits.len(),
        c.runs,
        c.gate().sqrt()
    );
    out += "reach of the intervals in standard uncertainties, by quadrant\n";
    for (q, (fsj, zeta)) in places(d).into_iter().enumerate() {
        let n = c.scores[q].len();
        out += &format!("  about FSJ {fsj:.1}, zeta {zeta:.3}: {:.2} ({n} tests)\n", d.reach(q));
    }
    let (fsj, zeta) = places(d)[2];
    out += &format!("\nstandard uncertainties at FSJ {fsj:.1}, zeta {zeta:.3}, by what they come from\n");
    for m in d.shown_maps() {
        let parts: Vec<String> = d
            .budget(m.feature, fsj, zeta)
            .iter()
            .map(|(what, u)| format!("{what} {u:.1e}"))
            .collect();
        let all = d.uncertainty(m.feature, fsj, zeta).unwrap_or(f64::NAN);
        let (name, unit) = (m.feature.name(), m.feature.unit());
        out += &format!("  {name:11} {all:.1e} {unit:5} = {}\n", parts.join(", "));
    }
    out
}

fn to_json(d: &Diagnoser, c: &Calibration) -> serde_json::Value {
    let budget = |(fsj, zeta): (f64, f64)| {
        let parts = |m: &diagnoser::failure_map::FailureMap| {
            let list = d.budget(m.feature, fsj, zeta);
            let list: serde_json::Map<String, _> = list.into_iter().map(|(k, v)| (k, v.into())).collect();
            (m.feature.key().to_string(), list.into())
        };
        let all: serde_json::Map<String, serde_json::Value> = d.shown_maps().map(parts).collect();
        serde_json::json!({"fsj": fsj, "zeta": zeta, "standard_uncertainty": all})
    };
    let reach: Vec<f64> = (0..4).map(|q| d.reach(q)).collect();
    let tests: Vec<usize> = c.scores.iter().map(Vec::len).collect();
    let budgets: Vec<serde_json::Value> = places(d).into_iter().map(budget).collect();
    serde_json::json!({
        "spread": c.spread,
        "runs": c.runs,
        "surface_runs": c.surface_runs,
        "seed": c.seed,
        "coverage": d.coverage(),
        "reach": reach,
        "tests": tests,
        "unexplained_from_misfit": c.gate().sqrt(),
        "budgets": budgets,
    })
}
