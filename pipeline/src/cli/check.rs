//! `ema check`.

use super::{say, say_json};
use crate::check::{Checked, check, setup_of};
use anyhow::Result;
use clap::Args;
use schemas::error::EXIT_LOSS;
use sim_worker::parameters::ActuatorParameters;
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::Arc;

#[derive(Args)]
pub struct CheckArgs {
    /// The actuator, a TOML file, or `reference`
    actuator: PathBuf,
    /// The test, by name or TOML file
    #[arg(long, default_value = "preflight")]
    sequence: String,
    /// Sensor model of the maps: none, reference, or a TOML file
    #[arg(long, default_value = "reference")]
    sensors: String,
    /// Faults at which maps are made
    #[arg(long, default_value = "coarse")]
    grid: String,
    /// Keys for programs
    #[arg(long)]
    json: bool,
}

pub fn run(a: &CheckArgs) -> Result<ExitCode> {
    let actuator = Arc::new(ActuatorParameters::read(&a.actuator)?);
    let name = actuator.name.clone();
    let setup = setup_of(actuator, sim_worker::catalogue::sequence(&a.sequence)?);
    let sensors = sim_worker::catalogue::sensors(&a.sensors)?;
    let checked = check(&setup, sensors, &sim_worker::catalogue::grid(&a.grid)?)?;
    if a.json {
        say_json(json(&name, &checked));
    } else {
        say(&text(&name, &checked));
    }
    Ok(if checked.ok() {
        ExitCode::SUCCESS
    } else {
        ExitCode::from(EXIT_LOSS)
    })
}

fn json(name: &str, c: &Checked) -> serde_json::Value {
    let one = |f: &crate::check::Finding| serde_json::json!({"check": f.check, "ok": f.ok, "found": f.found, "allowed": f.allowed, "advice": f.advice});
    serde_json::json!({
        "actuator": name,
        "ok": c.ok(),
        "checks": c.findings.iter().map(one).collect::<Vec<_>>(),
        "step": c.step.map(|(height, time)| serde_json::json!({"height_rad": height, "duration_s": time})),
    })
}

fn text(name: &str, c: &Checked) -> String {
    let mut out = format!("actuator  {name}\n");
    for f in &c.findings {
        let (mark, more) = if f.ok {
            ("ok", String::new())
        } else {
            ("BAD", format!("; allowed: {}", f.allowed))
        };
        out += &format!("{mark:<9} {:17} {}{more}\n", f.check, f.found);
        if !f.advice.is_empty() {
            out += &format!("          {:17} -> {}\n", "", f.advice);
        }
    }
    out += match c.ok() {
        true => "nothing stands against a diagnosis by this test (limits assumed)\n",
        false => "a diagnosis by this test would be refused or say less than it should (limits assumed)\n",
    };
    out
}
