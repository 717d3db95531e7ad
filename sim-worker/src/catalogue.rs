//! Sequences, grids and sensors by name (built in) or by file.

use crate::sensor::SensorModel;
use crate::spread::Spread;
use schemas::channel::{Channel, ChannelSet};
use schemas::error::{Error, Result};
use schemas::fault::FaultGrid;
use schemas::sequence::TestSequence;
use schemas::toml_section::{self, Section};
use std::path::Path;

macro_rules! built_in {
    ($kind:literal: $($name:literal),+) => {
        &[$(($name, include_str!(concat!("../../datasets/", $kind, "/", $name, ".toml")))),+]
    };
}

const SEQUENCES: &[(&str, &str)] =
    built_in!("sequences": "preflight", "ramp", "sine", "step", "chirp", "multisine", "preflight2");
const GRIDS: &[(&str, &str)] = built_in!("grids": "standard", "fine", "coarse");
const SPREADS: &[(&str, &str)] = built_in!("spreads": "fleet", "field", "bridge", "unit", "service");
const SENSORS: &[(&str, &str)] = built_in!("sensors": "reference");

fn section(kind: &str, known: &[(&str, &str)], name: &str) -> Result<Section> {
    if let Some((n, text)) = known.iter().find(|(n, _)| *n == name) {
        return toml_section::parse(&format!("datasets/{kind}/{n}.toml"), text);
    }
    if name.ends_with(".toml") {
        return toml_section::read(Path::new(name));
    }
    let names: Vec<&str> = known.iter().map(|(n, _)| *n).collect();
    Err(Error::bad(
        "command line",
        format!("name of {kind}"),
        name,
        format!("{} or a .toml file", names.join(", ")),
    ))
}

/// Names of the built-in sequences.
pub fn sequence_names() -> impl Iterator<Item = &'static str> {
    SEQUENCES.iter().map(|(n, _)| *n)
}

/// A built-in sequence, or one from a `.toml` file.
///
/// # Errors
/// A name that is neither built in nor a `.toml` file; a file that is not allowed.
pub fn sequence(name: &str) -> Result<TestSequence> {
    TestSequence::from_section(section("sequences", SEQUENCES, name)?)
}

/// A built-in grid, or one from a `.toml` file with `name`, `fsj`, `zeta`.
///
/// # Errors
/// As [`sequence`].
pub fn grid(name: &str) -> Result<FaultGrid> {
    grid_from(section("grids", GRIDS, name)?)
}

/// A grid from its file's section.
///
/// # Errors
/// Axes that do not rise strictly, FSJ outside 0 to 100, zeta outside 0 to 1.
pub fn grid_from(mut s: Section) -> Result<FaultGrid> {
    let name = s.text("name", "a text")?;
    let fsj = s.axis(
        "fsj",
        |x| (0.0..=100.0).contains(&x),
        "strictly rising friction factors from 0 to 100",
    )?;
    let zeta = s.axis(
        "zeta",
        |x| (0.0..1.0).contains(&x),
        "strictly rising eccentricities, 0 <= zeta < 1",
    )?;
    s.finish()?;
    Ok(FaultGrid { name, fsj, zeta })
}

/// A built-in sensor model, one from a `.toml` file, or `none`.
///
/// # Errors
/// As [`sequence`].
pub fn sensors(name: &str) -> Result<Option<SensorModel>> {
    if name == "none" {
        return Ok(None);
    }
    SensorModel::from_section(section("sensors", SENSORS, name)?).map(Some)
}

/// Channels that the test bench gives.
pub fn simulated() -> impl Iterator<Item = Channel> {
    Channel::ALL.iter().copied().filter(|c| *c != Channel::Temperature)
}

/// The basic channels and what else is named; `all` is all that the test bench gives.
///
/// # Errors
/// A name that is no channel of the test bench.
pub fn channels(names: &[String]) -> Result<ChannelSet> {
    let mut set = ChannelSet::basic();
    for n in names {
        if n == "all" {
            set = ChannelSet::of(simulated());
            continue;
        }
        let c = simulated().find(|c| c.name() == n).ok_or_else(|| {
            let all: Vec<&str> = simulated().map(Channel::name).collect();
            Error::bad("command line", "--channels", n, format!("all, {}", all.join(", ")))
        })?;
        set = set.with(c);
    }
    Ok(set)
}

/// A built-in spread, one from a `.toml` file, or `none`.
///
/// # Errors
/// As [`sequence`].
pub fn spread(name: &str) -> Result<Spread> {
    if name == "none" {
        return Ok(Spread::none());
    }
    Spread::from_section(section("spreads", SPREADS, name)?)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn prop_a_grid_written_and_read_is_the_same() {
        for name in ["standard", "fine", "coarse"] {
            let mut g = grid(name).unwrap();
            g.zeta[0] = 1e-9 / 3.0;
            let again = grid_from(toml_section::parse("a.toml", &g.to_toml()).unwrap()).unwrap();
            assert_eq!(again, g);
        }
    }
}
