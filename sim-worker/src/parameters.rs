//! Actuator parameters: TOML in, checked values out.

use crate::effect::{self, Effect, REFERENCE_TEMPERATURE_DEGC};
use schemas::error::Result;
use schemas::fingerprint::{exact, fingerprint};
use schemas::toml_section::{self, Section};
use std::path::Path;

const REFERENCE: &str = include_str!("../../datasets/parameters/reference.toml");

/// Parameters of one actuator; SI units, motor side unless said.
#[derive(Clone, Debug, PartialEq)]
pub struct ActuatorParameters {
    pub name: String,
    /// Vs
    pub supply_voltage_v: f64,
    /// R of one phase of the star
    pub phase_resistance_ohm: f64,
    /// L of one phase of the star
    pub phase_inductance_h: f64,
    /// ke of one phase; two phases in series give kt = 2 ke
    pub back_emf_v_s_per_rad: f64,
    /// P
    pub pole_pairs: u32,
    /// J
    pub inertia_kg_m2: f64,
    /// C
    pub viscous_n_m_s_per_rad: f64,
    /// Tmax
    pub torque_limit_n_m: f64,
    /// FSJ0
    pub static_friction_n_m: f64,
    /// FDJ/FSJ
    pub dynamic_friction_ratio: f64,
    /// N, motor to user
    pub gear_ratio: f64,
    /// b, at the user shaft
    pub backlash_half_width_rad: f64,
    /// end stops at plus and minus this, at the user shaft
    pub end_stop_rad: f64,
    /// eta_o of the transmission where the load opposes the motion; 1 = no loss
    pub opposing_efficiency: f64,
    /// eta_a where the load aids it; 1 = no loss
    pub aiding_efficiency: f64,
    /// GAP [(rad/s motor)/(rad user)]
    pub position_gain_per_s: f64,
    /// Wmax
    pub speed_reference_limit_rad_per_s: f64,
    /// Kp
    pub speed_proportional_n_m_s_per_rad: f64,
    /// Ki
    pub speed_integral_n_m_per_rad: f64,
    /// Tint
    pub integrator_limit_n_m: f64,
    /// Imax
    pub current_limit_a: f64,
    /// HB
    pub hysteresis_half_band_a: f64,
    /// dt of the numerical test bench
    pub step_s: f64,
    /// of friction and surroundings [degC]
    pub temperature_degc: f64,
    /// physical effects beyond the paper's, at most [`effect::MOST`]
    pub effects: Vec<Effect>,
    /// keys whose value is assumed rather than sourced
    pub assumed: Vec<String>,
    /// keys whose value was identified from measurements
    pub identified: Vec<String>,
}

/// Physical parameters that may differ from one actuator of a fleet to another: name, and table and key
/// of the actuator's file. The name is that of the field, and of the column in `actuators`.
pub const PARAMETERS: [(&str, &str, &str); 22] = [
    ("supply_voltage_v", "supply", "voltage_v"),
    ("phase_resistance_ohm", "motor", "phase_resistance_ohm"),
    ("phase_inductance_h", "motor", "phase_inductance_h"),
    ("back_emf_v_s_per_rad", "motor", "back_emf_v_s_per_rad"),
    ("inertia_kg_m2", "motor", "inertia_kg_m2"),
    ("viscous_n_m_s_per_rad", "motor", "viscous_n_m_s_per_rad"),
    ("torque_limit_n_m", "motor", "torque_limit_n_m"),
    ("static_friction_n_m", "friction", "static_n_m"),
    ("dynamic_friction_ratio", "friction", "dynamic_ratio"),
    ("gear_ratio", "transmission", "gear_ratio"),
    ("backlash_half_width_rad", "transmission", "backlash_half_width_rad"),
    ("end_stop_rad", "transmission", "end_stop_rad"),
    ("opposing_efficiency", "transmission", "opposing_efficiency"),
    ("aiding_efficiency", "transmission", "aiding_efficiency"),
    ("position_gain_per_s", "controller", "position_gain_per_s"),
    (
        "speed_reference_limit_rad_per_s",
        "controller",
        "speed_reference_limit_rad_per_s",
    ),
    (
        "speed_proportional_n_m_s_per_rad",
        "controller",
        "speed_proportional_n_m_s_per_rad",
    ),
    ("speed_integral_n_m_per_rad", "controller", "speed_integral_n_m_per_rad"),
    ("integrator_limit_n_m", "controller", "integrator_limit_n_m"),
    ("current_limit_a", "controller", "current_limit_a"),
    ("hysteresis_half_band_a", "controller", "hysteresis_half_band_a"),
    ("temperature_degc", "environment", "temperature_degc"),
];

impl ActuatorParameters {
    /// Values in the order of [`PARAMETERS`].
    pub fn values(&self) -> [f64; PARAMETERS.len()] {
        [
            self.supply_voltage_v,
            self.phase_resistance_ohm,
            self.phase_inductance_h,
            self.back_emf_v_s_per_rad,
            self.inertia_kg_m2,
            self.viscous_n_m_s_per_rad,
            self.torque_limit_n_m,
            self.static_friction_n_m,
            self.dynamic_friction_ratio,
            self.gear_ratio,
            self.backlash_half_width_rad,
            self.end_stop_rad,
            self.opposing_efficiency,
            self.aiding_efficiency,
            self.position_gain_per_s,
            self.speed_reference_limit_rad_per_s,
            self.speed_proportional_n_m_s_per_rad,
            self.speed_integral_n_m_per_rad,
            self.integrator_limit_n_m,
            self.current_limit_a,
            self.hysteresis_half_band_a,
            self.temperature_degc,
        ]
    }

    /// Parses the text of a file, with other values of some of [`PARAMETERS`] (by their place there).
    ///
    /// # Errors
    /// Those of the file, and values that physics forbids.
    pub fn parse_with(file: &str, text: &str, values: &[(usize, f64)]) -> Result<Self> {
        let mut s = toml_section::parse(file, text)?;
        for &(k, x) in values {
            s.put(PARAMETERS[k].1, PARAMETERS[k].2, x)?;
        }
        Self::from_section(s)
    }

    /// The reference actuator of `datasets/parameters/reference.toml`.
    pub fn reference() -> Self {
        Self::parse("datasets/parameters/reference.toml", REFERENCE).expect("the built-in parameters are valid")
    }

    /// Text of the reference actuator's file.
    pub fn reference_text() -> &'static str {
        REFERENCE
    }

    pub fn read(path: &Path) -> Result<Self> {
        Self::from_section(toml_section::read(path)?)
    }

    /// Parses the text of a file.
    pub fn parse(file: &str, text: &str) -> Result<Self> {
        Self::parse_with(file, text, &[])
    }

    fn from_section(mut s: Section) -> Result<Self> {
        const UP: &str = "a finite number above 0";
        const NOT_BELOW: &str = "a finite number of at least 0";
        const UNIT: &str = "a number above 0 and at most 1";
        let up = |x: f64| x > 0.0;
        let not_below = |x: f64| x >= 0.0;
        let mut assumed = Vec::new();
        let mut identified = Vec::new();
        let mut get =
            |t: &mut Section, path: &str, key: &str, ok: &dyn Fn(f64) -> bool, allowed: &str| -> Result<f64> {
                let (x, source) = t.sourced(key, ok, allowed)?;
                if source.as_deref() == Some("assumed") {
                    assumed.push(format!("{path}.{key}"));
                } else if source.is_some_and(|s| s.starts_with("identified")) {
                    identified.push(format!("{path}.{key}"));
                }
                Ok(x)
            };
        let name = s.text("name", "a text")?;

        let mut t = s.section("supply")?;
        let supply_voltage_v = get(&mut t, "supply", "voltage_v", &up, UP)?;
        t.finish()?;

        let mut t = s.section("motor")?;
        let whole = |x: f64| x.fract() == 0.0 && (1.0..=100.0).contains(&x);
        let phase_resistance_ohm = get(&mut t, "motor", "phase_resistance_ohm", &up, UP)?;
        let phase_inductance_h = get(&mut t, "motor", "phase_inductance_h", &up, UP)?;
        let back_emf_v_s_per_rad = get(&mut t, "motor", "back_emf_v_s_per_rad", &up, UP)?;
        let pole_pairs = get(&mut t, "motor", "pole_pairs", &whole, "a whole number from 1 to 100")? as u32;
        let inertia_kg_m2 = get(&mut t, "motor", "inertia_kg_m2", &up, UP)?;
        let viscous_n_m_s_per_rad = get(&mut t, "motor", "viscous_n_m_s_per_rad", &not_below, NOT_BELOW)?;
        let torque_limit_n_m = get(&mut t, "motor", "torque_limit_n_m", &up, UP)?;
        t.finish()?;

        let mut t = s.section("friction")?;
        let static_friction_n_m = get(&mut t, "friction", "static_n_m", &not_below, NOT_BELOW)?;
        let ratio = |x: f64| (0.0..=1.0).contains(&x);
        let dynamic_friction_ratio = get(&mut t, "friction", "dynamic_ratio", &ratio, "0 to 1")?;
        t.finish()?;

        let mut t = s.section("transmission")?;
        let gear_ratio = get(&mut t, "transmission", "gear_ratio", &up, UP)?;
        let backlash_half_width_rad = get(&mut t, "transmission", "backlash_half_width_rad", &not_below, NOT_BELOW)?;
        let end_stop_rad = get(&mut t, "transmission", "end_stop_rad", &up, UP)?;
        let efficiency = |x: f64| x > 0.0 && x <= 1.0;
        let opposing_efficiency = t.number_or("opposing_efficiency", 1.0, efficiency, UNIT)?;
        let aiding_efficiency = t.number_or("aiding_efficiency", 1.0, efficiency, UNIT)?;
        t.finish()?;

        let mut t = s.section("controller")?;
        let c = "controller";
        let position_gain_per_s = get(&mut t, c, "position_gain_per_s", &up, UP)?;
        let speed_reference_limit_rad_per_s = get(&mut t, c, "speed_reference_limit_rad_per_s", &up, UP)?;
        let speed_proportional_n_m_s_per_rad = get(&mut t, c, "speed_proportional_n_m_s_per_rad", &up, UP)?;
        let speed_integral_n_m_per_rad = get(&mut t, c, "speed_integral_n_m_per_rad", &not_below, NOT_BELOW)?;
        let integrator_limit_n_m = get(&mut t, c, "integrator_limit_n_m", &not_below, NOT_BELOW)?;
        let current_limit_a = get(&mut t, c, "current_limit_a", &up, UP)?;
        let hysteresis_half_band_a = get(&mut t, c, "hysteresis_half_band_a", &up, UP)?;
        t.finish()?;

        let mut t = s.section("numerics")?;
        let electrical = phase_inductance_h / phase_resistance_ohm;
        let allowed = format!("above 0, at most a tenth of L/R = {electrical:.3e} s and at most 1e-4 s");
        let step_s = t.number("step_s", |x| x > 0.0 && x <= 0.1 * electrical && x <= 1e-4, &allowed)?;
        t.finish()?;

        let temperature_degc = if s.may_have("environment") {
            let mut t = s.section("environment")?;
            let air = |x: f64| (-100.0..=300.0).contains(&x);
            let x = t.number_or("temperature_degc", REFERENCE_TEMPERATURE_DEGC, air, "-100 to 300 degC")?;
            t.finish()?;
            x
        } else {
            REFERENCE_TEMPERATURE_DEGC
        };
        let effects = effect::read(&mut s, inertia_kg_m2)?;
        s.finish()?;
        Ok(Self {
            name,
            supply_voltage_v,
            phase_resistance_ohm,
            phase_inductance_h,
            back_emf_v_s_per_rad,
            pole_pairs,
            inertia_kg_m2,
            viscous_n_m_s_per_rad,
            torque_limit_n_m,
            static_friction_n_m,
            dynamic_friction_ratio,
            gear_ratio,
            backlash_half_width_rad,
            end_stop_rad,
            opposing_efficiency,
            aiding_efficiency,
            position_gain_per_s,
            speed_reference_limit_rad_per_s,
            speed_proportional_n_m_s_per_rad,
            speed_integral_n_m_per_rad,
            integrator_limit_n_m,
            current_limit_a,
            hysteresis_half_band_a,
            step_s,
            temperature_degc,
            effects,
            assumed,
            identified,
        })
    }

    /// kt of two phases in series [N m/A].
    pub fn torque_constant_n_m_per_a(&self) -> f64 {
        2.0 * self.back_emf_v_s_per_rad
    }

    /// Of every value, not of the name; an actuator without effects has the one that it had before
    /// effects were known.
    pub fn fingerprint(&self) -> String {
        let all = self.values();
        // pole pairs after ke, the step at the end; the temperature only where effects know it
        let (motor, rest) = all[..PARAMETERS.len() - 1].split_at(4);
        let values = [motor, &[f64::from(self.pole_pairs)], rest, &[self.step_s]].concat();
        let mut text = format!(
            "actuator;{}",
            values.into_iter().map(exact).collect::<Vec<_>>().join(",")
        );
        if !self.effects.is_empty() {
            text += &format!(";temperature,{}", exact(self.temperature_degc));
        }
        for e in &self.effects {
            let values: Vec<String> = e.parameters().map(|(_, x)| exact(x)).collect();
            text += &format!(";{},{}", e.kind.name(), values.join(","));
        }
        fingerprint(&text)
    }
}
