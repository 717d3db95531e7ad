//! `BENCH.toml`: what was measured, on which rig, and how far each is trusted.

mod read;

use crate::measured::filtered::LowPass;
use crate::measured::jumps::Jumps;
use crate::measured::own;
use crate::measured::winding::Winding;
use ema_tables::units::Quantity;
use read::{channel_spec, rig, run_spec};
use schemas::error::{Error, Result};
use schemas::toml_section::{self, Section};
use sim_worker::effect::{self, Effect};
use sim_worker::parameters::ActuatorParameters;
use std::path::{Path, PathBuf};

/// A channel that a bench may have.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum BenchChannel {
    Time,
    Command,
    Position,
    Velocity,
    UserPosition,
    Current,
    CurrentAbs,
    Voltage,
    Torque,
    Force,
    Load,
    Temperature,
    VDc,
    /// currents of the phases
    CurrentA,
    CurrentB,
    CurrentC,
    /// voltages of the phases against the star point
    VoltageA,
    VoltageB,
    VoltageC,
}

impl BenchChannel {
    /// The currents of the phases.
    pub const CURRENTS: [Self; 3] = [Self::CurrentA, Self::CurrentB, Self::CurrentC];
    /// The voltages of the phases.
    pub const VOLTAGES: [Self; 3] = [Self::VoltageA, Self::VoltageB, Self::VoltageC];
    pub const ALL: [Self; 19] = [
        Self::Time,
        Self::Command,
        Self::Position,
        Self::Velocity,
        Self::UserPosition,
        Self::Current,
        Self::CurrentAbs,
        Self::Voltage,
        Self::Torque,
        Self::Force,
        Self::Load,
        Self::Temperature,
        Self::VDc,
        Self::CurrentA,
        Self::CurrentB,
        Self::CurrentC,
        Self::VoltageA,
        Self::VoltageB,
        Self::VoltageC,
    ];

    pub fn name(self) -> &'static str {
        match self {
            Self::Time => "time",
            Self::Command => "command",
            Self::Position => "position",
            Self::Velocity => "velocity",
            Self::UserPosition => "user_position",
            Self::Current => "current",
            Self::CurrentAbs => "current_abs",
            Self::Voltage => "voltage",
            Self::Torque => "torque",
            Self::Force => "force",
            Self::Load => "load",
            Self::Temperature => "temperature",
            Self::VDc => "v_dc",
            Self::CurrentA => "i_a",
            Self::CurrentB => "i_b",
            Self::CurrentC => "i_c",
            Self::VoltageA => "v_a",
            Self::VoltageB => "v_b",
            Self::VoltageC => "v_c",
        }
    }

    pub fn quantity(self) -> Quantity {
        match self {
            Self::Time => Quantity::Time,
            Self::Command | Self::Position | Self::UserPosition => Quantity::Angle,
            Self::Velocity => Quantity::Speed,
            Self::Current | Self::CurrentAbs | Self::CurrentA | Self::CurrentB | Self::CurrentC => Quantity::Current,
            Self::Voltage | Self::VDc | Self::VoltageA | Self::VoltageB | Self::VoltageC => Quantity::Voltage,
            Self::Torque | Self::Force | Self::Load => Quantity::Torque,
            Self::Temperature => Quantity::Temperature,
        }
    }
}

/// Where the noise of a channel is known from.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Noise {
    /// rms of one sample, SI at the motor
    Known(f64),
    /// from runs with the role `repeat`
    Repeats,
    /// estimated from the highest frequencies of the data
    Estimated,
}

/// How a channel stands in the files.
#[derive(Clone, Debug)]
pub struct ChannelSpec {
    pub channel: BenchChannel,
    pub column: String,
    /// a column to be taken off it
    pub minus: Option<String>,
    /// to SI at the motor
    pub factor: f64,
    /// the part of that which is the unit's
    pub unit_factor: f64,
    /// unit of the column, where the bench says it
    pub unit: Option<String>,
    /// metres in a radian of the motor, of a linear rig
    pub lead: Option<f64>,
    /// mean over the sample that ends at the time stamp, rather than the value at it
    pub mean: bool,
    /// recorded as values at the stamps, also where several of them were taken together since
    pub of_points: bool,
    /// further delay [s]
    pub delay_s: f64,
    /// SI at the motor, 0 where it is not known
    pub resolution: f64,
    pub noise: Noise,
    /// one sigma of an offset that is not known, SI at the motor; `None` where the bench says nothing
    pub offset: Option<f64>,
}

/// A constant and how far it is trusted.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Known {
    /// SI at the motor
    pub value: f64,
    /// relative, one sigma; 0 = fixed, `None` = free
    pub trust: Option<f64>,
}

/// The controller's law: `w_ref = position_gain (command - position)`, limited;
/// `u = speed_gain (w_ref - w) + integral_gain int (w_ref - w) dt`, limited.
#[derive(Clone, Debug, PartialEq)]
pub struct ControllerLaw {
    /// [1/s]
    pub position_gain: f64,
    /// [drive unit per rad/s]
    pub speed_gain: f64,
    /// [drive unit per rad]
    pub integral_gain: f64,
    /// [rad/s]
    pub speed_limit: f64,
    /// [drive unit]
    pub drive_limit: f64,
    /// the speed is the difference of the mean of the last two positions
    pub differenced: bool,
    /// compares with the user's position rather than the motor's
    pub on_user: bool,
    /// known lag from the signals to the drive: half a period of the controller and the time
    /// constant of the current loop [s]
    pub lag_s: f64,
}

/// The machine on the bench; SI, motor side.
#[derive(Clone, Debug)]
pub struct Rig {
    pub linear: bool,
    /// metres in a radian of the motor
    pub lead: Option<f64>,
    /// the channel that is fed in
    pub drive: BenchChannel,
    /// torque of one unit of the drive channel
    pub drive_constant: Known,
    pub inertia: Known,
    pub viscous: Known,
    pub coulomb: Known,
    /// torque that is there at rest, positive against positive motion
    pub offset: f64,
    pub resistance: Known,
    pub inductance: Known,
    /// of this motor, where phase currents that are read at points tell it from point to point
    pub inductance_by_points: Option<Known>,
    pub back_emf: Known,
    /// both as the bench says them, where they were taken for one constant of a motor
    pub one_constant: Option<(f64, f64)>,
    /// what lies between a voltage that is fed in and the torque, where no current is recorded
    pub winding: Option<Winding>,
    pub gear_ratio: f64,
    pub pole_pairs: f64,
    /// static over dynamic friction of an actuator of ours; 1 without one
    pub break_away: f64,
    /// step of the test bench whose constants are looked for [s]; 0 without one
    pub step_s: f64,
    pub supply_voltage: f64,
    /// what the actuator's file has for it and the standard deviation, where the supply was measured to be another [V]
    pub supply_of_file: Option<(f64, f64)>,
    /// half-width of the known play, at the motor [rad]
    pub play: f64,
    pub controller: Option<ControllerLaw>,
    /// error of the angle sensor as far as a study has found it: amplitudes of sine and cosine [rad]
    pub encoder: (f64, f64),
    /// whether the measured speed is that of the same angle
    pub encoder_speed: bool,
    /// by how much the drive's sensor is off as far as a study has found it [drive unit], and how many samples it is late
    pub drive_error: (f64, f64),
    /// standard deviation of the dry and viscous friction of a file, as a share of the machine's; 0 where all files have the same
    pub friction_of_day: f64,
    /// what the bench file does not say and the model's file did
    pub from_model: Vec<&'static str>,
    /// what neither says, and where it begins: keys and values in SI
    pub assumed: Vec<(&'static str, f64)>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Role {
    /// effects are looked for in it
    Fit,
    /// candidates are judged by it, beside the folds of the fit runs
    Select,
    /// proves what was found; used once, at the end
    HeldOut,
    Baseline,
    Repeat,
    /// the drive is disabled: offsets of the sensors
    Off,
}

impl Rig {
    /// Unit of the drive constant.
    pub fn constant_unit(&self) -> &'static str {
        match self.drive {
            BenchChannel::Current => "N m/A",
            BenchChannel::Voltage => "N m/V",
            _ => "-",
        }
    }
}

impl Role {
    pub fn name(self) -> &'static str {
        match self {
            Self::Fit => "fit",
            Self::Select => "select",
            Self::Off => "off",
            Self::HeldOut => "heldout",
            Self::Baseline => "baseline",
            Self::Repeat => "repeat",
        }
    }
}

/// Columns and values of which any will do, as text.
pub type Filter = Vec<(String, Vec<String>)>;

/// A file of runs.
#[derive(Clone, Debug)]
pub struct RunSpec {
    pub file: PathBuf,
    pub role: Role,
    /// the author says that the machine was healthy
    pub healthy: bool,
    pub window_s: Option<(f64, f64)>,
    /// column and values, any of which will do, as text
    pub filter: Filter,
    pub split: Vec<String>,
    /// each run stands at one speed and counts by the means of its pieces: a friction map
    pub steady: bool,
}

impl RunSpec {
    /// Whether a moment of its file is its own.
    pub fn has(&self, time_s: f64) -> bool {
        self.window_s.is_none_or(|(from, to)| time_s >= from && time_s <= to)
    }
}

/// A bench file.
#[derive(Clone, Debug)]
pub struct Bench {
    pub file: String,
    pub rig: Rig,
    pub channels: Vec<ChannelSpec>,
    pub runs: Vec<RunSpec>,
    /// what the rig is known to have, of an earlier study
    pub effects: Vec<Effect>,
    /// recordings of the project's own telemetry, whose drive commutates in six steps
    pub own: bool,
    /// a speed that was left out, as it is the angle's
    pub made_of_angle: Option<LowPass>,
    /// its channel, where a known controller acts on it
    pub law_speed: Option<ChannelSpec>,
    /// of recordings, by file and rows: where their commands jump between samples, once that is known
    pub jumps: Vec<(PathBuf, Filter, Jumps)>,
}

/// Whether a file is a recording of telemetry rather than a bench file, by its name.
pub fn is_recording(path: &Path) -> bool {
    path.extension().is_some_and(|e| !e.eq_ignore_ascii_case("toml"))
}

impl Bench {
    /// A bench file, or recordings of the project's own, which are a bench by themselves. Without an actuator, a bench
    /// file speaks for itself; recordings of our own telemetry are taken for the reference actuator's.
    ///
    /// * `channels` file whose section `[channels]` says which column of the recordings is what, where they are not
    ///   called as ours
    /// * `healthy` whether all that is recorded is of a healthy machine, whatever a bench file says
    ///
    /// # Errors
    /// As [`Bench::read`]; refuses recordings that cannot be read or do not have the same columns, and bench files
    /// beside others or with channels from elsewhere.
    pub fn open(
        paths: &[PathBuf],
        actuator: Option<&ActuatorParameters>,
        channels: Option<&Path>,
        healthy: bool,
    ) -> Result<Self> {
        let mut bench = match paths {
            [] => {
                return Err(Error::bad(
                    "command line",
                    "--bench",
                    "nothing",
                    "a bench file, or recordings",
                ));
            }
            [one] if !is_recording(one) => {
                if let Some(channels) = channels {
                    let allowed = "recordings (.csv, .parquet); a bench file has its own [channels]";
                    let found = format!("{} beside {}", channels.display(), one.display());
                    return Err(Error::bad("command line", "--channels", found, allowed));
                }
                Self::read(one, actuator)?
            }
            all => {
                if let Some(other) = all.iter().find(|p| !is_recording(p)) {
                    let found = other.display().to_string();
                    let allowed = "one bench file alone, or recordings (.csv, .parquet)";
                    return Err(Error::bad("command line", "--bench", found, allowed));
                }
                let reference = ActuatorParameters::reference();
                let actuator = actuator.unwrap_or(&reference);
                let mut bench = Self::from_section(own::bench(all, actuator, channels)?, &all[0], Some(actuator))?;
                bench.own = true;
                bench
            }
        };
        for r in &mut bench.runs {
            r.healthy |= healthy;
        }
        Ok(bench)
    }

    /// Reads a bench file; what it does not say of the rig is taken from the actuator.
    ///
    /// # Errors
    /// Refuses keys that are not known, units and values that are not allowed, and a bench without run, time or
    /// drive signal.
    pub fn read(path: &Path, actuator: Option<&ActuatorParameters>) -> Result<Self> {
        Self::from_section(toml_section::read(path)?, path, actuator)
    }

    fn from_section(mut s: Section, path: &Path, actuator: Option<&ActuatorParameters>) -> Result<Self> {
        let mut rig_section = s.section("rig")?;
        let mut c = s.section("channels")?;
        let rig = rig(&mut rig_section, actuator, c.has(BenchChannel::Current.name()))?;
        rig_section.finish()?;
        let mut channels = Vec::new();
        for channel in BenchChannel::ALL {
            if c.has(channel.name()) {
                let mut t = c.section(channel.name())?;
                channels.push(channel_spec(&mut t, channel, &rig)?);
                t.finish()?;
            }
        }
        c.finish().map_err(|e| match e {
            Error::Bad { file, place, found, .. } => {
                let all: Vec<&str> = BenchChannel::ALL.iter().map(|c| c.name()).collect();
                Error::bad(file, place, found, all.join(", "))
            }
            e => e,
        })?;
        let dir = path.parent().unwrap_or(Path::new("."));
        let mut runs = Vec::new();
        for mut t in s.sections("run")? {
            runs.push(run_spec(&mut t, dir)?);
            t.finish()?;
        }
        if runs.is_empty() {
            return Err(s.bad("run", "nothing", "at least one [[run]] with file and role"));
        }
        if s.has("effect") && actuator.is_some() {
            let allowed = "none where --actuator is given: they stand in its file";
            return Err(s.bad("effect", "[[effect]]", allowed));
        }
        let effects = effect::read(&mut s, f64::INFINITY)?;
        let mut bench = Self {
            file: path.display().to_string(),
            rig,
            channels,
            runs,
            effects,
            own: false,
            made_of_angle: None,
            law_speed: None,
            jumps: Vec::new(),
        };
        bench.add_q_current();
        for needed in [BenchChannel::Time, bench.rig.drive] {
            if bench.channel(needed).is_none() && !bench.is_comparison() {
                let found = format!("no channel `{}`", needed.name());
                return Err(Error::bad(
                    &bench.file,
                    "key `channels`",
                    found,
                    "time, position and the drive signal",
                ));
            }
        }
        s.finish()?;
        Ok(bench)
    }

    /// Whether the currents of three phases stand for the current.
    pub fn has_phases(&self) -> bool {
        BenchChannel::CURRENTS.iter().all(|c| self.channel(*c).is_some())
    }

    /// The torque-making current of three phases, as a channel of its own where the bench names none: half their sum,
    /// each times its back-EMF's shape, of which two conduct at a time.
    fn add_q_current(&mut self) {
        if !self.has_phases() || self.rig.drive != BenchChannel::Current {
            return;
        }
        self.channels.retain(|c| c.channel != BenchChannel::Current);
        let a = self.channel(BenchChannel::CurrentA).expect("there").clone();
        let share = 0.5f64.sqrt();
        let noise = match a.noise {
            Noise::Known(x) => Noise::Known(share * x),
            n => n,
        };
        self.channels.push(ChannelSpec {
            channel: BenchChannel::Current,
            resolution: share * a.resolution,
            noise,
            // the phases' own offsets stand for it
            offset: Some(0.0),
            ..a
        });
    }

    pub fn channel(&self, c: BenchChannel) -> Option<&ChannelSpec> {
        self.channels.iter().find(|s| s.channel == c)
    }

    /// Only an unsigned current: states can be compared, no equation can be set up.
    pub fn is_comparison(&self) -> bool {
        self.channel(self.rig.drive).is_none() && self.channel(BenchChannel::CurrentAbs).is_some()
    }
}
