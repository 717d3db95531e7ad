//! `BENCH.toml`: what was measured, on which rig, and how far each is trusted.

use crate::measured::one_constant::taken_for_one;
use crate::measured::own;
use ema_tables::units::Quantity;
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
    pub back_emf: Known,
    /// both as the bench says them, where they were taken for one constant of a motor
    pub one_constant: Option<(f64, f64)>,
    pub gear_ratio: f64,
    pub pole_pairs: f64,
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

/// A file of runs.
#[derive(Clone, Debug)]
pub struct RunSpec {
    pub file: PathBuf,
    pub role: Role,
    /// the author says that the machine was healthy
    pub healthy: bool,
    pub window_s: Option<(f64, f64)>,
    /// column and values, any of which will do, as text
    pub filter: Vec<(String, Vec<String>)>,
    pub split: Vec<String>,
    /// each run stands at one speed and counts by the means of its pieces: a friction map
    pub steady: bool,
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
}

/// Relative difference up to which a gear ratio is the same one, rounded.
const SAME: f64 = 1e-3;

const NOT_BELOW: &str = "a finite number of at least 0";
const UP: &str = "a finite number above 0";

/// A number, or `{ value, unit, trust }`.
fn known(s: &mut Section, key: &str, q: Quantity, lead: Option<f64>, default: Option<f64>) -> Result<Option<Known>> {
    let Some(v) = s.raw(key) else {
        return Ok(default.map(|value| Known { value, trust: None }));
    };
    let number = |v: &toml::Value| v.as_float().or_else(|| v.as_integer().map(|i| i as f64));
    let (value, unit, trust) = match &v {
        toml::Value::Table(t) => {
            let allowed = ["value", "unit", "trust", "source"];
            if let Some(k) = t.keys().find(|k| !allowed.contains(&k.as_str())) {
                return Err(s.bad(&format!("{key}.{k}"), "an unknown key", allowed.join(", ")));
            }
            let value = t.get("value").and_then(number);
            let unit = t.get("unit").and_then(|u| u.as_str()).unwrap_or(q.si());
            let trust = match t.get("trust") {
                None => None,
                Some(v) => match number(v) {
                    Some(x) if (0.0..=10.0).contains(&x) => Some(x),
                    _ => return Err(s.bad(&format!("{key}.trust"), v, "0 to 10, relative, one sigma")),
                },
            };
            (value, unit.to_string(), trust)
        }
        v => (number(v), q.si().to_string(), None),
    };
    let Some(value) = value.filter(|x| x.is_finite() && *x >= 0.0) else {
        return Err(s.bad(key, v, NOT_BELOW));
    };
    let factor = q.factor(&unit, lead);
    let factor = factor.map_err(|a| s.bad(&format!("{key}.unit"), format!("`{unit}`"), format!("one of {a}")))?;
    Ok(Some(Known {
        value: value * factor,
        trust,
    }))
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
        let rig = rig(&mut rig_section, actuator)?;
        rig_section.finish()?;
        let mut c = s.section("channels")?;
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

fn rig(s: &mut Section, actuator: Option<&ActuatorParameters>) -> Result<Rig> {
    let kind = s.text("kind", "rotary or linear")?;
    let linear = match kind.as_str() {
        "rotary" => false,
        "linear" => true,
        k => return Err(s.bad("kind", format!("`{k}`"), "rotary or linear")),
    };
    let lead = if linear {
        let lead = s.number("lead_m_per_turn", |x| x > 0.0, UP)?;
        Some(lead / std::f64::consts::TAU)
    } else {
        None
    };
    let drive = s.text("drive", "current, voltage, torque, force or command")?;
    let drive = match drive.as_str() {
        "current" | "command" => BenchChannel::Current,
        "voltage" => BenchChannel::Voltage,
        "torque" => BenchChannel::Torque,
        "force" => BenchChannel::Force,
        d => return Err(s.bad("drive", format!("`{d}`"), "current, voltage, torque, force or command")),
    };
    let (mut from_model, mut assumed) = (Vec::new(), Vec::new());
    // of the bench, else of the actuator's file, else a free parameter that begins at `otherwise`
    let mut take = |s: &mut Section,
                    key: &'static str,
                    q: Quantity,
                    of: fn(&ActuatorParameters) -> f64,
                    place: &str,
                    otherwise: f64|
     -> Result<Known> {
        let given = known(s, key, q, lead, None)?;
        let Some(a) = actuator else {
            return Ok(given.unwrap_or_else(|| {
                assumed.push((key, otherwise));
                let trust = None;
                Known {
                    value: otherwise,
                    trust,
                }
            }));
        };
        // what a study has written into the model's file is newer than the bench's data sheet
        if a.identified.iter().any(|k| k == place) {
            let trust = given.and_then(|g| g.trust);
            return Ok(Known { value: of(a), trust });
        }
        Ok(given.unwrap_or_else(|| {
            from_model.push(key);
            let trust = None;
            Known { value: of(a), trust }
        }))
    };
    let direct = matches!(drive, BenchChannel::Torque | BenchChannel::Force);
    let drive_constant = if direct {
        known(s, "drive_constant", Quantity::DriveConstant, lead, Some(1.0))?.expect("it has a default")
    } else {
        // of a current only: an amplifier's constant is not the motor's
        let place = if drive == BenchChannel::Current {
            "motor.back_emf_v_s_per_rad"
        } else {
            ""
        };
        let of = |a: &ActuatorParameters| a.torque_constant_n_m_per_a();
        let k = take(s, "drive_constant", Quantity::DriveConstant, of, place, 0.0)?;
        if k.value <= 0.0 {
            return Err(s.bad("drive_constant", "nothing", "the torque of a drive unit, or --actuator"));
        }
        k
    };
    let inertia = take(
        s,
        "inertia",
        Quantity::Inertia,
        |a| a.inertia_kg_m2,
        "motor.inertia_kg_m2",
        0.0,
    )?;
    let of = |a: &ActuatorParameters| a.viscous_n_m_s_per_rad;
    let viscous = take(s, "viscous", Quantity::Viscous, of, "motor.viscous_n_m_s_per_rad", 0.0)?;
    let of = |a: &ActuatorParameters| a.static_friction_n_m * a.dynamic_friction_ratio;
    let coulomb = take(s, "coulomb", Quantity::Torque, of, "friction.static_n_m", 0.0)?;
    let of = |a: &ActuatorParameters| 2.0 * a.phase_resistance_ohm;
    let resistance = take(
        s,
        "resistance",
        Quantity::Resistance,
        of,
        "motor.phase_resistance_ohm",
        0.0,
    )?;
    let of = |a: &ActuatorParameters| 2.0 * a.phase_inductance_h;
    let inductance = take(
        s,
        "inductance",
        Quantity::Inductance,
        of,
        "motor.phase_inductance_h",
        0.0,
    )?;
    let of = |a: &ActuatorParameters| a.torque_constant_n_m_per_a();
    let ke = if drive == BenchChannel::Current {
        drive_constant.value
    } else {
        0.0
    };
    let back_emf = take(
        s,
        "back_emf_constant",
        Quantity::BackEmf,
        of,
        "motor.back_emf_v_s_per_rad",
        ke,
    )?;
    let offset = match s.raw("offset") {
        None => 0.0,
        Some(v) => {
            let t = v.as_table();
            let number = |v: &toml::Value| v.as_float().or_else(|| v.as_integer().map(|i| i as f64));
            let value = t.map_or(number(&v), |t| t.get("value").and_then(number));
            let unit = t.and_then(|t| t.get("unit")).and_then(|u| u.as_str()).unwrap_or("N m");
            let factor = Quantity::Torque.factor(unit, lead);
            let factor = factor.map_err(|u| s.bad("offset.unit", format!("`{unit}`"), format!("one of {u}")))?;
            let value = value.filter(|x| x.is_finite());
            value.ok_or_else(|| s.bad("offset", &v, "a finite number"))? * factor
        }
    };
    let mut plain = |key: &'static str, q: Quantity, of: Option<f64>, otherwise: f64| {
        let given = known(s, key, q, None, None)?.map(|k| k.value);
        if given.is_none() {
            match of {
                Some(_) => from_model.push(key),
                None => assumed.push((key, otherwise)),
            }
        }
        Ok::<f64, Error>(given.or(of).unwrap_or(otherwise))
    };
    // a lead stands for the gear
    let gear = actuator.map(|a| if linear { 1.0 } else { a.gear_ratio });
    let pairs = actuator.map(|a| f64::from(a.pole_pairs));
    let gear_ratio = plain("gear_ratio", Quantity::None, gear, 1.0)?;
    let pole_pairs = plain("pole_pairs", Quantity::None, pairs, 1.0)?;
    let volts = actuator.map(|a| a.supply_voltage_v);
    let supply_voltage = plain("supply_voltage", Quantity::Voltage, volts, f64::INFINITY)?;
    // another gear or winding is another machine: no study makes one of the other
    for (key, said, of) in [("gear_ratio", gear_ratio, gear), ("pole_pairs", pole_pairs, pairs)] {
        if let Some(of) = of.filter(|of| !linear && (said / of - 1.0).abs() > SAME) {
            let allowed = format!(
                "{of} as the actuator's file says, or a study of another machine: its own file, or no --actuator"
            );
            return Err(s.bad(key, said, allowed));
        }
    }
    if pole_pairs.fract() != 0.0 || !(1.0..=100.0).contains(&pole_pairs) {
        return Err(s.bad("pole_pairs", pole_pairs, "a whole number from 1 to 100"));
    }
    if supply_voltage <= 0.0 || gear_ratio <= 0.0 {
        return Err(s.bad("supply_voltage, gear_ratio", supply_voltage.min(gear_ratio), UP));
    }
    let controller = if s.has("controller") {
        let mut c = s.section("controller")?;
        let law = controller(&mut c, lead)?;
        c.finish()?;
        Some(law)
    } else {
        None
    };
    let (mut drive_constant, mut back_emf) = (drive_constant, back_emf);
    let one_constant = if drive == BenchChannel::Current {
        taken_for_one(&mut drive_constant, &mut back_emf)
    } else {
        None
    };
    Ok(Rig {
        linear,
        lead,
        drive,
        drive_constant,
        inertia,
        viscous,
        coulomb,
        offset,
        resistance,
        inductance,
        back_emf,
        one_constant,
        gear_ratio,
        pole_pairs,
        step_s: actuator.map_or(0.0, |a| a.step_s),
        supply_voltage,
        supply_of_file: None,
        play: actuator.map_or(0.0, |a| a.backlash_half_width_rad * a.gear_ratio),
        controller,
        encoder: (0.0, 0.0),
        encoder_speed: false,
        from_model,
        assumed,
    })
}

fn controller(c: &mut Section, lead: Option<f64>) -> Result<ControllerLaw> {
    let mut plain = |key: &str, default: Option<f64>| -> Result<f64> {
        let v = known(c, key, Quantity::None, None, default);
        // units stand there for the reader only
        match v {
            Ok(Some(k)) => Ok(k.value),
            Ok(None) => Err(c.bad(key, "nothing", UP)),
            Err(e) => Err(e),
        }
    };
    let lead = lead.unwrap_or(1.0);
    let position_gain = plain("position_gain", None)?;
    let speed_gain = plain("speed_gain", None)? * lead;
    let integral_gain = plain("integral_gain", Some(0.0))? * lead;
    let speed_limit = plain("speed_limit", Some(f64::MAX))? / lead;
    let drive_limit = plain("drive_limit", Some(f64::MAX))?;
    let current_loop = plain("current_time_constant_s", Some(0.0))?;
    let rate_hz = plain("rate_hz", Some(0.0))?;
    let lag_s = current_loop + if rate_hz > 0.0 { 0.5 / rate_hz } else { 0.0 };
    let velocity = c.text_or("velocity", "measured")?;
    let differenced = match velocity.as_str() {
        "measured" => false,
        "difference" => true,
        v => return Err(c.bad("velocity", format!("`{v}`"), "measured or difference")),
    };
    let feedback = c.text_or("position", "motor")?;
    let on_user = match feedback.as_str() {
        "motor" => false,
        "user" => true,
        v => return Err(c.bad("position", format!("`{v}`"), "motor or user")),
    };
    Ok(ControllerLaw {
        position_gain,
        speed_gain,
        integral_gain,
        speed_limit,
        drive_limit,
        differenced,
        on_user,
        lag_s,
    })
}

fn channel_spec(t: &mut Section, channel: BenchChannel, rig: &Rig) -> Result<ChannelSpec> {
    let column = t.text("column", "the name of a column")?;
    let q = channel.quantity();
    let said = if t.may_have("unit") {
        Some(t.text_or("unit", q.si())?)
    } else {
        None
    };
    let unit = said.clone().unwrap_or(q.si().into());
    let unit_factor = q.factor(&unit, rig.lead);
    let unit_factor = unit_factor.map_err(|a| t.bad("unit", format!("`{unit}`"), format!("one of {a}")))?;
    let scale = t.number_or("scale", 1.0, |x| x != 0.0, "a finite number other than 0")?;
    // command and user position are the user's: brought to the motor
    let gear = match channel {
        BenchChannel::Command | BenchChannel::UserPosition if !rig.linear => rig.gear_ratio,
        _ => 1.0,
    };
    let factor = unit_factor * scale * gear;
    let drive = matches!(
        channel,
        BenchChannel::Current
            | BenchChannel::CurrentAbs
            | BenchChannel::Voltage
            | BenchChannel::Torque
            | BenchChannel::VDc
    ) || BenchChannel::CURRENTS.contains(&channel)
        || BenchChannel::VOLTAGES.contains(&channel);
    let sampling = t.text_or("sampling", if drive { "mean" } else { "point" })?;
    let mean = match sampling.as_str() {
        "mean" => true,
        "point" => false,
        v => return Err(t.bad("sampling", format!("`{v}`"), "point or mean")),
    };
    let delay_s = t.number_or("delay_s", 0.0, |x| x.abs() < 1.0, "a number within 1 s")?;
    let size = factor.abs();
    let minus = if t.may_have("minus") {
        Some(t.text("minus", "the name of a column")?)
    } else {
        None
    };
    let resolution = t.number_or("resolution", 0.0, |x| x >= 0.0, NOT_BELOW)? * size;
    let noise = match t.raw("noise") {
        None if resolution > 0.0 => Noise::Known(0.0),
        None => Noise::Estimated,
        Some(toml::Value::String(s)) if s == "from repeats" => Noise::Repeats,
        Some(v) => match v.as_float().or_else(|| v.as_integer().map(|i| i as f64)) {
            Some(x) if x >= 0.0 && x.is_finite() => Noise::Known(x * size),
            _ => return Err(t.bad("noise", &v, "rms in the channel's unit, or \"from repeats\"")),
        },
    };
    let offset = if t.may_have("offset") {
        Some(t.number("offset", |x| x >= 0.0, NOT_BELOW)? * size)
    } else {
        None
    };
    Ok(ChannelSpec {
        offset,
        channel,
        column,
        minus,
        factor,
        unit_factor,
        unit: said,
        lead: rig.lead,
        mean,
        delay_s,
        resolution,
        noise,
    })
}

fn run_spec(t: &mut Section, dir: &Path) -> Result<RunSpec> {
    let file = dir.join(expanded(t, "file")?);
    const ROLES: &str = "fit, select, heldout, baseline, repeat or off";
    let role = t.text("role", ROLES)?;
    let role = match role.as_str() {
        "fit" => Role::Fit,
        "select" => Role::Select,
        "off" => Role::Off,
        "heldout" => Role::HeldOut,
        "baseline" => Role::Baseline,
        "repeat" => Role::Repeat,
        r => return Err(t.bad("role", format!("`{r}`"), ROLES)),
    };
    let health = t.text_or("health", "unknown")?;
    let healthy = match health.as_str() {
        "healthy" => true,
        "unknown" => false,
        h => return Err(t.bad("health", format!("`{h}`"), "healthy or unknown")),
    };
    let number = |v: &toml::Value| v.as_float().or_else(|| v.as_integer().map(|i| i as f64));
    let window_s = match t.raw("window_s") {
        None => None,
        Some(v) => {
            let pair: Vec<f64> = v
                .as_array()
                .map(|a| a.iter().filter_map(number).collect())
                .unwrap_or_default();
            match pair[..] {
                [a, b] if a < b => Some((a, b)),
                _ => return Err(t.bad("window_s", &v, "[from, to] in s, from before to")),
            }
        }
    };
    let filter = match t.raw("where") {
        None => Vec::new(),
        Some(toml::Value::Table(w)) => w
            .iter()
            .map(|(k, v)| {
                let text = |v: &toml::Value| {
                    let number = || number(v).map_or_else(|| v.to_string(), |x| x.to_string());
                    v.as_str().map_or_else(number, str::to_string)
                };
                let values = v
                    .as_array()
                    .map_or_else(|| vec![text(v)], |a| a.iter().map(text).collect());
                (k.clone(), values)
            })
            .collect(),
        Some(v) => return Err(t.bad("where", &v, "a table of columns and values")),
    };
    let split = match t.raw("split") {
        None => Vec::new(),
        Some(toml::Value::Array(a)) => a.iter().filter_map(|v| v.as_str().map(str::to_string)).collect(),
        Some(v) => return Err(t.bad("split", &v, "a list of columns")),
    };
    let steady = match t.raw("steady") {
        None => false,
        Some(toml::Value::Boolean(b)) => b,
        Some(v) => return Err(t.bad("steady", &v, "true or false")),
    };
    Ok(RunSpec {
        file,
        role,
        healthy,
        window_s,
        filter,
        split,
        steady,
    })
}

/// A path in which `$NAME` at the start stands for a variable of the environment.
fn expanded(t: &mut Section, key: &str) -> Result<PathBuf> {
    let text = t.text(key, "a path")?;
    let Some(rest) = text.strip_prefix('$') else {
        return Ok(text.into());
    };
    let (name, rest) = rest.split_once('/').unwrap_or((rest, ""));
    match std::env::var(name) {
        Ok(dir) => Ok(Path::new(&dir).join(rest)),
        Err(_) => Err(t.bad(
            key,
            format!("${name}, which is not set"),
            "a path, or a variable that is set",
        )),
    }
}
