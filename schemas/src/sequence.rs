//! Command sequences: what the actuator is told to do.

use crate::error::Result;
use crate::fingerprint::{exact, fingerprint};
use crate::toml_section::{Section, quoted};

/// What a number of a command may be.
#[derive(Clone, Copy)]
enum Bound {
    Any,
    AtLeastZero,
    AboveZero,
}

impl Bound {
    fn allows(self, x: f64) -> bool {
        match self {
            Self::Any => true,
            Self::AtLeastZero => x >= 0.0,
            Self::AboveZero => x > 0.0,
        }
    }

    fn allowed(self) -> &'static str {
        match self {
            Self::Any => "a finite number",
            Self::AtLeastZero => "a number of at least 0",
            Self::AboveZero => "a number above 0",
        }
    }
}

macro_rules! commands {
    ($($(#[$doc:meta])* $variant:ident $name:literal { $($key:ident $bound:ident $meaning:literal),+ })+) => {
        /// Command of one segment, as a function of the time `t` since the segment's start.
        #[derive(Clone, Copy, Debug, PartialEq)]
        pub enum Command { $($(#[$doc])* $variant { $(#[doc = $meaning] $key: f64),+ }),+ }

        impl Command {
            /// Names in files.
            pub const NAMES: &'static [&'static str] = &[$($name),+];

            /// Name in files.
            pub fn name(&self) -> &'static str {
                match self { $(Self::$variant { .. } => $name),+ }
            }

            /// Keys and values.
            pub fn values(&self) -> Vec<(&'static str, f64)> {
                match *self { $(Self::$variant { $($key),+ } => vec![$((stringify!($key), $key)),+]),+ }
            }

            /// The command `name`, if there is one, with its values from a segment's table.
            fn from_section(name: &str, s: &mut Section) -> Option<Result<Self>> {
                let mut value = |key: &str, bound: Bound| s.number(key, |x| bound.allows(x), bound.allowed());
                match name {
                    $($name => Some((|| Ok(Self::$variant { $($key: value(stringify!($key), Bound::$bound)?),+ }))()),)+
                    _ => None,
                }
            }
        }
    };
}

commands! {
    /// `slope t` [rad]
    Ramp "ramp" { slope_rad_per_s Any "slope of the user position [rad/s]" }
    /// constant [rad]
    Hold "hold" { value_rad Any "user position [rad]" }
    /// `amplitude sin(2 pi f t)` [rad]
    Sine "sine" { amplitude_rad Any "amplitude of the user position [rad]", frequency_hz AboveZero "f [Hz]" }
    /// constant from the segment's start [rad]
    Step "step" { height_rad Any "user position [rad]" }
    /// `A sin(2 pi (f0 t + (f1 - f0) t^2/(2 T)))`, T the segment's duration [rad]
    Chirp "chirp" { amplitude_rad Any "A [rad]", from_hz AtLeastZero "f0 [Hz]", to_hz AboveZero "f1 [Hz]" }
    /// `sum over n = 1..5 of A/n sin(2 pi f n t + n^2)` [rad]
    Multisine "multisine" { amplitude_rad Any "A, of the fundamental [rad]", frequency_hz AboveZero "f, of the fundamental [Hz]" }
    /// `amplitude cos(2 pi f t)` [rad]: where it is small and slow, the motor comes to rest at every turning point
    Cosine "cosine" { amplitude_rad Any "amplitude of the user position [rad]", frequency_hz AboveZero "f [Hz]" }
    /// `from + slope t` [rad]
    Line "line" { from_rad Any "user position at the segment's start [rad]", slope_rad_per_s Any "slope [rad/s]" }
}

/// A command and how long it lasts.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Segment {
    /// what is commanded
    pub command: Command,
    /// start from the sequence's start [s]
    pub start_s: f64,
    /// length [s], above 0 and at most 3600
    pub duration_s: f64,
}

/// A named sequence of segments.
#[derive(Clone, Debug, PartialEq)]
pub struct TestSequence {
    /// for messages and files; does not enter the fingerprint
    pub name: String,
    /// one after the other, without gaps; at least one
    pub segments: Vec<Segment>,
}

impl TestSequence {
    /// From a TOML file's table: `name`, then `[[segment]]` with `command`, `duration_s` and the
    /// command's own keys.
    ///
    /// # Errors
    /// A command, key or value that is not allowed; no segment.
    pub fn from_section(mut s: Section) -> Result<Self> {
        let names = || {
            let (last, others) = Command::NAMES.split_last().expect("there are commands");
            format!("{} or {last}", others.join(", "))
        };
        let name = s.text("name", "a text")?;
        let mut segments = Vec::new();
        let mut start_s = 0.0;
        let parts = s.sections("segment")?;
        if parts.is_empty() {
            return Err(s.bad("segment", "no segment", "at least one [[segment]]"));
        }
        for mut p in parts {
            let kind = p.text("command", &names())?;
            let duration_s = p.number("duration_s", |x| x > 0.0 && x <= 3600.0, "0 < duration_s <= 3600")?;
            let command = match Command::from_section(&kind, &mut p) {
                Some(command) => command?,
                None => return Err(p.bad("command", kind, names())),
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

    /// A file that reads back as this sequence, bit for bit.
    pub fn to_toml(&self) -> String {
        let mut out = format!("name = {}\n", quoted(&self.name));
        for s in &self.segments {
            out += &format!("\n[[segment]]\ncommand = \"{}\"\n", s.command.name());
            for (key, x) in s.command.values() {
                out += &format!("{key} = {x:?}\n");
            }
            out += &format!("duration_s = {:?}\n", s.duration_s);
        }
        out
    }

    /// Length [s].
    pub fn duration_s(&self) -> f64 {
        self.segments.last().map_or(0.0, |s| s.start_s + s.duration_s)
    }

    /// The first segment whose command satisfies `is`.
    pub fn segment(&self, is: impl Fn(&Command) -> bool) -> Option<&Segment> {
        self.segments.iter().find(|s| is(&s.command))
    }

    /// Of commands, starts and lengths, not of the name.
    pub fn fingerprint(&self) -> String {
        let mut text = String::from("sequence");
        for s in &self.segments {
            text += &format!(";{}@{}+{}", s.command.name(), exact(s.start_s), exact(s.duration_s));
            for (_, x) in s.command.values() {
                text += &format!(",{}", exact(x));
            }
        }
        fingerprint(&text)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::toml_section::parse;

    #[test]
    fn prop_a_sequence_written_and_read_is_the_same() {
        let text = "name = \"all \\\"six\\\"\"\n\
            [[segment]]\ncommand = \"ramp\"\nslope_rad_per_s = -0.1\nduration_s = 0.5\n\
            [[segment]]\ncommand = \"hold\"\nvalue_rad = 3\nduration_s = 0.35\n\
            [[segment]]\ncommand = \"sine\"\namplitude_rad = 1e-3\nfrequency_hz = 20.0\nduration_s = 0.1\n\
            [[segment]]\ncommand = \"step\"\nheight_rad = 0.3333333333333333\nduration_s = 0.7\n\
            [[segment]]\ncommand = \"chirp\"\namplitude_rad = 0.1\nfrom_hz = 0\nto_hz = 1e-7\nduration_s = 2\n\
            [[segment]]\ncommand = \"multisine\"\namplitude_rad = 0.2\nfrequency_hz = 0.3\nduration_s = 1e-3\n\
            [[segment]]\ncommand = \"cosine\"\namplitude_rad = 1e-4\nfrequency_hz = 5\nduration_s = 0.75\n\
            [[segment]]\ncommand = \"line\"\nfrom_rad = 0.03\nslope_rad_per_s = -0.2\nduration_s = 0.15\n";
        let s = TestSequence::from_section(parse("a.toml", text).unwrap()).unwrap();
        let names: Vec<&str> = s.segments.iter().map(|s| s.command.name()).collect();
        assert_eq!(names, Command::NAMES);
        let again = TestSequence::from_section(parse("b.toml", &s.to_toml()).unwrap()).unwrap();
        assert_eq!(again, s);
        assert_eq!(again.fingerprint(), s.fingerprint());
    }
}
