//! What a column's header says: name and unit, in the ways that people write them.

use crate::units::{self, Quantity};
use schemas::channel::Channel;

/// A column of telemetry.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Meaning {
    Time,
    Run,
    Channel(Channel),
}

impl Meaning {
    /// The name that the tables of this project give it; times in seconds.
    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::Time => "t",
            Self::Run => "run",
            Self::Channel(c) => c.name(),
        }
    }

    pub(crate) fn quantity(self) -> Quantity {
        match self {
            Self::Time => Quantity::Time,
            Self::Run => Quantity::None,
            Self::Channel(c) => quantity(c),
        }
    }
}

/// What a channel measures.
pub fn quantity(c: Channel) -> Quantity {
    match c {
        Channel::Com | Channel::ThetaU | Channel::ThetaM => Quantity::Angle,
        Channel::OmegaM => Quantity::Speed,
        Channel::IEq | Channel::IA | Channel::IB | Channel::IC | Channel::IQ | Channel::ISupply => Quantity::Current,
        Channel::VA | Channel::VB | Channel::VC | Channel::VDc => Quantity::Voltage,
        Channel::TorqueM => Quantity::Torque,
        Channel::Temperature => Quantity::Temperature,
    }
}

/// Names of the time, the surest first.
const TIMES: [&str; 4] = ["t", "time", "timestamp", "time_stamp"];

/// By how much another case makes a name of the time less sure: more than any other spelling.
const SHOUTED: usize = 2 * TIMES.len() + 2;

/// Name and unit of a header: `omega_m [rpm]`, `omega_m (rpm)`, `omega_m / rpm`, `omega_m in rpm`.
pub(crate) fn split(header: &str) -> (&str, Option<&str>) {
    let header = header.trim();
    for (open, close) in [('[', ']'), ('(', ')'), ('{', '}'), ('<', '>')] {
        if let Some(inner) = header.strip_suffix(close)
            && let Some(at) = inner.rfind(open)
            && at > 0
        {
            return (inner[..at].trim_end(), Some(inner[at + 1..].trim()));
        }
    }
    for mark in [" / ", " in "] {
        if let Some((name, unit)) = header.rsplit_once(mark) {
            return (name.trim_end(), Some(unit.trim()));
        }
    }
    // `omega_m/rpm`, but not `a/b` of which nobody knows the unit
    if let Some((name, unit)) = header.split_once('/')
        && units::is_known(unit)
    {
        return (name.trim_end(), Some(unit.trim()));
    }
    (header, None)
}

/// Lower case, words joined by `_`.
pub(crate) fn plain(name: &str) -> String {
    let joined = |c: char| {
        if c == ' ' || c == '-' || c == '.' {
            '_'
        } else {
            c.to_ascii_lowercase()
        }
    };
    name.trim().chars().map(joined).collect()
}

/// A header as a column of telemetry, the unit that it states, and how far its spelling is from ours (0: the very name).
pub(crate) fn meaning(header: &str) -> Option<(Meaning, Option<String>, usize)> {
    let (name, unit) = split(header);
    let unit = unit.map(str::to_string);
    let far = usize::from(name != header);
    if name == "run" {
        return Some((Meaning::Run, None, far));
    }
    if let Some(c) = Channel::from_name(name) {
        return Some((Meaning::Channel(c), unit, far));
    }
    let written = name;
    let name = plain(name);
    if let Some(n) = TIMES.iter().position(|t| *t == name) {
        // `T` beside `time` or `t` is a temperature or a torque
        let shouted = written != name;
        let measures_time = unit.as_ref().is_none_or(|u| units::stated(Quantity::Time, u).is_ok());
        return (measures_time || !shouted).then_some((
            Meaning::Time,
            unit,
            2 * n + far + SHOUTED * usize::from(shouted),
        ));
    }
    if let Some(c) = Channel::from_name(&name) {
        return Some((Meaning::Channel(c), unit, 1 + far));
    }
    // the unit as the end of the name: `t_ms`, `omega_m_rpm`, `omega_m_rad_per_s`
    let ends = |m: Meaning, stem: &str| -> Option<String> {
        let rest = name.strip_prefix(stem)?.strip_prefix('_')?;
        let spelt = |u: &str| {
            let u = plain(u);
            u == rest || u.replace('/', "_per_") == rest || u.replace('/', "_") == rest
        };
        units::names(m.quantity()).find(|u| spelt(u)).map(str::to_string)
    };
    if unit.is_some() {
        return None;
    }
    for (n, t) in TIMES.iter().enumerate() {
        if let Some(unit) = ends(Meaning::Time, t) {
            return Some((Meaning::Time, Some(unit), 2 * n + 1));
        }
    }
    Channel::ALL.iter().find_map(|&c| {
        let unit = ends(Meaning::Channel(c), c.name())?;
        Some((Meaning::Channel(c), Some(unit), 2))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn prop_names_and_units_are_known_as_people_write_them() {
        let known = |h: &str| meaning(h).map(|(m, u, _)| (m.name(), u.unwrap_or_default()));
        for (header, name, unit) in [
            ("t", "t", ""),
            ("t [ms]", "t", "ms"),
            ("Time (s)", "t", "s"),
            ("timestamp", "t", ""),
            ("t_ns", "t", "ns"),
            ("t_ms", "t", "ms"),
            ("time / s", "t", "s"),
            ("omega_m (rpm)", "omega_m", "rpm"),
            ("OMEGA_M[rad/s]", "omega_m", "rad/s"),
            ("omega_m_rad_per_s", "omega_m", "rad/s"),
            ("omega_m_rad_s", "omega_m", "rad/s"),
            ("Omega M in rpm", "omega_m", "rpm"),
            ("omega_m/rpm", "omega_m", "rpm"),
            ("i_a", "i_a", ""),
            ("I_A_mA", "i_a", "ma"),
            ("i_a_A", "i_a", "a"),
            ("theta_m {deg}", "theta_m", "deg"),
            ("run", "run", ""),
        ] {
            let found = known(header).map(|(n, u)| (n, u.to_lowercase()));
            assert_eq!(found, Some((name, unit.to_string())), "{header}");
        }
        for other in [
            "",
            "speed",
            "theta",
            "Torque (measured)",
            "t0",
            "i_abc",
            "omega_m_mean",
            "run (s)x",
        ] {
            assert_eq!(known(other), None, "{other}");
        }
    }

    #[test]
    fn prop_a_temperature_beside_the_time_is_no_second_time() {
        let far = |h: &str| meaning(h).map(|(_, _, far)| far);
        for time in ["t", "t_ms", "t [ms]", "time", "timestamp (s)", "time_stamp"] {
            assert!(far(time) < far("T"), "{time}");
        }
        assert_eq!(far("T [degC]"), None);
        assert_eq!(far("T (N m)"), None);
        assert!(far("T [s]").is_some());
    }
}
