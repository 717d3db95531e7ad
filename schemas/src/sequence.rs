//! Command sequences: what the actuator is told to do.

use crate::error::Result;
use crate::fingerprint::{exact, fingerprint};
use crate::toml_section::Section;

/// Command of one segment, as a function of the time `t` since the segment's start.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Command {
    /// `slope t` [rad]
    Ramp { slope_rad_per_s: f64 },
    /// constant [rad]
    Hold { value_rad: f64 },
    /// `amplitude sin(2 pi f t)` [rad]
    Sine { amplitude_rad: f64, frequency_hz: f64 },
    /// constant from the segment's start [rad]
    Step { height_rad: f64 },
    /// `A sin(2 pi (f0 t + (f1 - f0) t^2/(2 T)))`, T the segment's duration [rad]
    Chirp {
        amplitude_rad: f64,
        from_hz: f64,
        to_hz: f64,
    },
    /// `sum over n = 1..5 of A/n sin(2 pi f n t + n^2)` [rad]
    Multisine { amplitude_rad: f64, frequency_hz: f64 },
}

/// A command and how long it lasts.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Segment {
    pub command: Command,
    /// start from the sequence's start [s]
    pub start_s: f64,
    pub duration_s: f64,
}

/// A named sequence of segments.
#[derive(Clone, Debug, PartialEq)]
pub struct TestSequence {
    pub name: String,
    pub segments: Vec<Segment>,
}

const NUMBER: &str = "a finite number";
const POSITIVE: &str = "a number above 0";

impl TestSequence {
    /// From a TOML file's table: `name`, then `[[segment]]` with `command`, `duration_s` and the
    /// command's own keys.
    pub fn from_section(mut s: Section) -> Result<Self> {
        let name = s.text("name", "a text")?;
        let mut segments = Vec::new();
        let mut start_s = 0.0;
        let parts = s.sections("segment")?;
        if parts.is_empty() {
            return Err(s.bad("segment", "no segment", "at least one [[segment]]"));
        }
        for mut p in parts {
            let kind = p.text("command", "ramp, hold, sine, step, chirp or multisine")?;
            let duration_s = p.number("duration_s", |x| x > 0.0 && x <= 3600.0, "0 < duration_s <= 3600")?;
            let any = |_: f64| true;
            let up = |x: f64| x > 0.0;
            let command = match kind.as_str() {
                "ramp" => Command::Ramp {
                    slope_rad_per_s: p.number("slope_rad_per_s", any, NUMBER)?,
                },
                "hold" => Command::Hold {
                    value_rad: p.number("value_rad", any, NUMBER)?,
                },
                "sine" => Command::Sine {
                    amplitude_rad: p.number("amplitude_rad", any, NUMBER)?,
                    frequency_hz: p.number("frequency_hz", up, POSITIVE)?,
                },
                "step" => Command::Step {
                    height_rad: p.number("height_rad", any, NUMBER)?,
                },
                "chirp" => Command::Chirp {
                    amplitude_rad: p.number("amplitude_rad", any, NUMBER)?,
                    from_hz: p.number("from_hz", |x| x >= 0.0, "a number of at least 0")?,
                    to_hz: p.number("to_hz", up, POSITIVE)?,
                },
                "multisine" => Command::Multisine {
                    amplitude_rad: p.number("amplitude_rad", any, NUMBER)?,
                    frequency_hz: p.number("frequency_hz", up, POSITIVE)?,
                },
                other => return Err(p.bad("command", other, "ramp, hold, sine, step, chirp or multisine")),
            };
            p.finish()?;
            segments.push(Segment {
                command,
                start_s,
                duration_s,
            });
            // sums such as 0.5 + 0.35 are meant as decimals
            start_s = ((start_s + duration_s) * 1e9).round() / 1e9;
        }
        s.finish()?;
        Ok(Self { name, segments })
    }

    /// Length [s].
    pub fn duration_s(&self) -> f64 {
        self.segments.last().map_or(0.0, |s| s.start_s + s.duration_s)
    }

    /// The first segment whose command satisfies `is`.
    pub fn segment(&self, is: impl Fn(&Command) -> bool) -> Option<&Segment> {
        self.segments.iter().find(|s| is(&s.command))
    }

    pub fn fingerprint(&self) -> String {
        let mut text = String::from("sequence");
        for s in &self.segments {
            let (tag, v): (&str, Vec<f64>) = match s.command {
                Command::Ramp { slope_rad_per_s } => ("ramp", vec![slope_rad_per_s]),
                Command::Hold { value_rad } => ("hold", vec![value_rad]),
                Command::Sine {
                    amplitude_rad,
                    frequency_hz,
                } => ("sine", vec![amplitude_rad, frequency_hz]),
                Command::Step { height_rad } => ("step", vec![height_rad]),
                Command::Chirp {
                    amplitude_rad,
                    from_hz,
                    to_hz,
                } => ("chirp", vec![amplitude_rad, from_hz, to_hz]),
                Command::Multisine {
                    amplitude_rad,
                    frequency_hz,
                } => ("multisine", vec![amplitude_rad, frequency_hz]),
            };
            text += &format!(";{tag}@{}+{}", exact(s.start_s), exact(s.duration_s));
            for x in v {
                text += &format!(",{}", exact(x));
            }
        }
        fingerprint(&text)
    }
}
