//! The dataset of a single actuator: a fleet of one.

use super::plan::{DatasetPlan, conditions_toml};
use crate::noise::FEATURE_SEEDS;
use crate::setup::TestSetup;
use schemas::channel::ChannelSet;
use schemas::error::Result;
use schemas::fault::FaultGrid;
use schemas::toml_section::quoted;
use std::path::Path;

/// A grid of one actuator's faults, and what is kept of its runs.
#[derive(Clone, Debug)]
pub struct OneActuator<'a> {
    /// the test; its rest angle is the first
    pub setup: &'a TestSetup,
    /// fault pairs, each at every rest angle
    pub grid: &'a FaultGrid,
    /// further rotor angles at rest [rad], rising
    pub rest_angles_rad: &'a [f64],
    /// of the sensor noise
    pub seed: u64,
    /// channels whose samples are kept, all of them stored; none: features only
    pub telemetry: Option<ChannelSet>,
}

/// A name as folders and tables have it.
fn plain_name(name: &str) -> String {
    let plain = |c: char| if c.is_ascii_alphanumeric() || c == '-' { c } else { '_' };
    let name: String = name.chars().map(plain).collect();
    if super::plan::plain_name(&name) {
        name
    } else {
        format!("actuator-{name}")
    }
}

impl DatasetPlan {
    /// The plan of a fleet of one: its text holds actuator, sequence, grid and sensors in full, and is read as any
    /// other.
    ///
    /// # Errors
    /// What no plan may have, for example a rate below 1000 Hz.
    pub fn of_one(one: &OneActuator<'_>) -> Result<Self> {
        let s = one.setup;
        let mut files = vec![
            ("actuator.toml", s.actuator.to_toml()),
            ("sequence.toml", s.sequence.to_toml()),
            ("grid.toml", one.grid.to_toml()),
        ];
        files.extend(s.sensors.as_ref().map(|m| ("sensors.toml", m.to_toml())));
        let angles = [&[s.rest_angle_rad], one.rest_angles_rad].concat();
        let name = plain_name(&s.actuator.name);
        let mut text = format!(
            "name = \"{name}\"\nseed = {}\nactuator = \"actuator.toml\"\nsequences = [\"sequence.toml\"]\ngrid = \"grid.toml\"\n\
             feature_seeds = {FEATURE_SEEDS}\n{}",
            one.seed,
            conditions_toml(s, &angles),
        );
        text += &format!("\n[[actuators]]\ntail = \"{name}\"\n");
        if let Some(channels) = one.telemetry {
            let names: Vec<&str> = channels.iter().map(|c| c.name()).collect();
            text += &format!("\n[telemetry]\nchannels = {names:?}\nstore = \"all\"\n");
        }
        text += "\n[files]\n";
        for (file, content) in files {
            text += &format!("{} = {}\n", quoted(file), super::plan::several_lines(&content));
        }
        Self::parse("plan of one actuator", &text, Path::new(""))
    }
}
