//! Which column of a table is which channel: the section `[channels]` of a bench file, as a diagnosis reads it.

use crate::table::{Table, UnitFrom};
use crate::telemetry::quantity;
use crate::units::{self, Quantity};
use schemas::channel::Channel;
use schemas::error::{Error, Result};
use schemas::toml_section::{self, Section};
use std::path::Path;

/// Names of a bench file, beside those of the telemetry itself.
const BENCH: [(&str, Channel); 8] = [
    ("command", Channel::Com),
    ("position", Channel::ThetaM),
    ("velocity", Channel::OmegaM),
    ("user_position", Channel::ThetaU),
    ("current", Channel::IQ),
    ("current_abs", Channel::IEq),
    ("torque", Channel::TorqueM),
    ("supply_current", Channel::ISupply),
];

/// One column of a table.
#[derive(Clone, Debug)]
pub(crate) struct Spec {
    pub(crate) column: String,
    /// column to be taken off
    pub(crate) minus: Option<String>,
    unit: Option<String>,
    scale: f64,
    quantity: Quantity,
    /// where it was read
    place: String,
}

impl Spec {
    /// Factor from the column to SI, and what was taken for it, in words.
    ///
    /// * `name` of the channel
    pub(crate) fn factor(&self, table: &Table, name: &str) -> Result<(f64, String)> {
        let si = self.quantity.si();
        let (unit, who) = match table.unit_from(&self.column, self.unit.as_deref(), si)? {
            UnitFrom::File => (si, ", to which the file's own unit was brought"),
            UnitFrom::Nobody => (si, " (assumed: neither file nor channels say a unit)"),
            UnitFrom::Bench => (self.unit.as_deref().unwrap_or(si), ""),
            UnitFrom::Header(unit) => (unit, ", as the header says"),
        };
        let factor = units::stated(self.quantity, unit).map_err(|a| self.bad(unit, &a))?;
        let scale = match self.scale {
            1.0 => String::new(),
            x => format!(" times {x}"),
        };
        let less = self.minus.as_ref().map_or(String::new(), |m| format!(" less `{m}`"));
        let said = format!("{name} from `{}`{less} in {unit}{who}{scale}", self.column);
        Ok((factor * self.scale, said))
    }

    fn bad(&self, found: &str, allowed: &str) -> Error {
        let place = format!("column `{}`, unit", self.column);
        Error::bad(&self.place, place, format!("`{found}`"), format!("one of {allowed}"))
    }
}

/// The columns that a file of channels names.
#[derive(Clone, Debug, Default)]
pub struct ChannelMap {
    time: Option<Spec>,
    channels: Vec<(Channel, Spec)>,
}

impl ChannelMap {
    /// Reads the section `[channels]` of a bench file; the rest of it is the study's.
    ///
    /// # Errors
    /// A file that cannot be read, no such section, a channel or key that is not known, a delay (a diagnosis cannot take
    /// one out).
    pub fn read(path: &Path) -> Result<Self> {
        let text = std::fs::read_to_string(path).map_err(|e| Error::io(path, "cannot be read", e))?;
        let mut file = toml_section::parse(&path.display().to_string(), &text)?;
        Self::of(&path.display().to_string(), &mut file.section("channels")?)
    }

    fn of(file: &str, section: &mut Section) -> Result<Self> {
        let mut map = Self::default();
        for key in section.keys() {
            let channel = BENCH.iter().find(|(n, _)| *n == key).map(|b| b.1);
            let channel = channel.or_else(|| Channel::from_name(&key));
            let is_time = key == "time";
            // what only a study asks for
            if !is_time && channel.is_none() {
                if ["force", "load", "voltage"].contains(&key.as_str()) {
                    section.section(&key)?;
                    continue;
                }
                let names = BENCH.iter().map(|b| b.0).collect::<Vec<_>>().join(", ");
                let allowed = format!("time, {names}, or a channel of the telemetry");
                return Err(section.bad(&key, format!("`{key}`"), allowed));
            }
            let quantity = channel.map_or(Quantity::Time, quantity);
            let mut t = section.section(&key)?;
            let column = t.text("column", "the name of a column")?;
            let optional = |t: &mut Section, key: &str| -> Result<Option<String>> {
                if t.may_have(key) {
                    t.text(key, "text").map(Some)
                } else {
                    Ok(None)
                }
            };
            let unit = optional(&mut t, "unit")?;
            let minus = optional(&mut t, "minus")?;
            let scale = t.number_or("scale", 1.0, |x| x != 0.0, "a finite number other than 0")?;
            let delay_s = t.number_or("delay_s", 0.0, |x| x.abs() < 1.0, "a number within 1 s")?;
            if delay_s != 0.0 {
                return Err(t.bad("delay_s", delay_s, "0: a diagnosis takes no delay out"));
            }
            for of_a_study in ["sampling", "resolution", "noise", "offset"] {
                t.raw(of_a_study);
            }
            t.finish()?;
            let spec = Spec {
                column,
                minus,
                unit,
                scale,
                quantity,
                place: format!("{file}, channels.{key}"),
            };
            match channel {
                None => map.time = Some(spec),
                Some(c) => map.channels.push((c, spec)),
            }
        }
        Ok(map)
    }

    pub(crate) fn time(&self) -> Option<&Spec> {
        self.time.as_ref()
    }

    /// The column of the time, and its factor to seconds.
    ///
    /// # Errors
    /// A unit that is none of time.
    pub fn time_of(&self, table: &Table) -> Result<(String, f64)> {
        match &self.time {
            Some(spec) if table.is_moments(&spec.column) => Ok((spec.column.clone(), 1.0)),
            Some(spec) => Ok((spec.column.clone(), spec.factor(table, "t")?.0)),
            None => Ok(("t".into(), 1.0)),
        }
    }

    /// The column that is named for a channel.
    pub fn column(&self, c: Channel) -> Option<&str> {
        self.of_channel(c).map(|s| s.column.as_str())
    }

    pub(crate) fn of_channel(&self, c: Channel) -> Option<&Spec> {
        self.channels.iter().find(|(d, _)| *d == c).map(|(_, s)| s)
    }
}
