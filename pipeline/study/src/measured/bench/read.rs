//! A bench file's tables, key by key.

use super::{BenchChannel, ChannelSpec, ControllerLaw, Known, Noise, Rig, Role, RunSpec};
use crate::measured::one_constant::taken_for_one;
use crate::measured::winding::Winding;
use ema_tables::units::Quantity;
use schemas::error::{Error, Result};
use schemas::toml_section::Section;
use sim_worker::parameters::ActuatorParameters;
use std::path::{Path, PathBuf};

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

/// Whether a constant's unit is a torque or a force by the ampere.
fn per_ampere(constant: &toml::Value) -> bool {
    let unit = constant.get("unit").and_then(toml::Value::as_str);
    unit.is_some_and(|u| u.ends_with("/A"))
}

/// Gain of a sensor of torque or force of which nothing is said, one sigma relative (assumed): were it free, no torque would be known.
const TORQUE_GAIN: f64 = 0.01;

/// * `with_current` a signed current is recorded
pub(super) fn rig(s: &mut Section, actuator: Option<&ActuatorParameters>, with_current: bool) -> Result<Rig> {
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
    // a constant of the motor, not of an amplifier: the voltage is that at the motor's terminals
    let terminals = drive == BenchChannel::Voltage && s.peek("drive_constant").is_some_and(per_ampere);
    let drive = if terminals && with_current {
        BenchChannel::Current
    } else {
        drive
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
        let said = known(s, "drive_constant", Quantity::DriveConstant, lead, None)?;
        said.unwrap_or(Known {
            value: 1.0,
            trust: Some(TORQUE_GAIN),
        })
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
    let inductance_by_points = known(s, "inductance_by_points", Quantity::Inductance, lead, None)?;
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
    let (mut drive_constant, mut back_emf, mut viscous) = (drive_constant, back_emf, viscous);
    let one_constant = if drive == BenchChannel::Current || terminals && back_emf.value > 0.0 {
        taken_for_one(&mut drive_constant, &mut back_emf)
    } else {
        None
    };
    let winding = if terminals && !with_current {
        if resistance.value <= 0.0 {
            let allowed = "the winding's resistance beside a drive_constant by the ampere, or a channel `current`";
            return Err(s.bad("resistance", "nothing", allowed));
        }
        let winding = Winding::new(drive_constant, back_emf, resistance, inductance.value);
        (drive_constant, viscous) = (winding.gain(), winding.braked(viscous));
        Some(winding)
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
        inductance_by_points,
        back_emf,
        one_constant,
        winding,
        gear_ratio,
        pole_pairs,
        break_away: actuator.map_or(1.0, ActuatorParameters::break_away_ratio),
        step_s: actuator.map_or(0.0, |a| a.step_s),
        supply_voltage,
        supply_of_file: None,
        play: actuator.map_or(0.0, |a| a.backlash_half_width_rad * a.gear_ratio),
        controller,
        encoder: (0.0, 0.0),
        encoder_speed: false,
        drive_error: (0.0, 0.0),
        friction_of_day: 0.0,
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

pub(super) fn channel_spec(t: &mut Section, channel: BenchChannel, rig: &Rig) -> Result<ChannelSpec> {
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
        // an encoder's count is all of its noise; a converter's step is the least of a drive signal's
        None if resolution > 0.0 && !drive => Noise::Known(0.0),
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
        of_points: !mean,
        delay_s,
        resolution,
        noise,
    })
}

pub(super) fn run_spec(t: &mut Section, dir: &Path) -> Result<RunSpec> {
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
