//! How units of one type differ: half-widths of uniform distributions around the parameters.

use crate::effect::{COPPER_PER_K, Effect, EffectKind};
use crate::parameters::ActuatorParameters;
use schemas::error::{Error, Result};
use schemas::fingerprint::{exact, fingerprint};
use schemas::toml_section::Section;

/// Temperature coefficient of the flux of NdFeB magnets [1/K] (assumed; data sheets give -0.0009 to
/// -0.0012).
const MAGNET_PER_K: f64 = -0.001_1;

/// Something in which one unit, or one test, differs from another.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[repr(usize)]
pub enum Cause {
    /// R
    Resistance,
    /// ke
    BackEmf,
    /// J
    Inertia,
    /// FDJ/FSJ
    DynamicRatio,
    /// Vs
    Supply,
    /// winding temperature: resistance (copper) and back-EMF (magnets) together
    Temperature,
    /// rotor angle at rest
    RestAngle,
    /// L
    Inductance,
    /// C
    Viscous,
    /// amplitudes of the actuator's effects, all together
    EffectAmplitude,
    /// shapes of the actuator's effects (speeds, phases, orders...), all together
    EffectShape,
    /// static dry friction at the dynamic one that it has: what breaks away
    BreakAway,
    /// dry friction of the healthy unit, static and dynamic together
    HealthyFriction,
    /// share of effects that are levels of friction which grows with the friction fault
    EffectGrowth,
    /// temperature of the whole actuator in the test: winding and magnets, and friction by [`Spread::friction_per_k`]
    TestTemperature,
    /// that slope of friction
    FrictionSlope,
    /// voltage that each conducting leg of the bridge loses (dead time and diodes)
    BridgeDrop,
}

impl Cause {
    /// Number of causes.
    pub const COUNT: usize = 17;
    /// Those that stand in every fingerprint and are drawn first; later ones follow where they have a half-width.
    pub const FIRST: usize = 7;
    /// All, in the order of [`Spread::half_width`].
    pub const ALL: [Cause; Self::COUNT] = [
        Cause::Resistance,
        Cause::BackEmf,
        Cause::Inertia,
        Cause::DynamicRatio,
        Cause::Supply,
        Cause::Temperature,
        Cause::RestAngle,
        Cause::Inductance,
        Cause::Viscous,
        Cause::EffectAmplitude,
        Cause::EffectShape,
        Cause::BreakAway,
        Cause::HealthyFriction,
        Cause::EffectGrowth,
        Cause::TestTemperature,
        Cause::FrictionSlope,
        Cause::BridgeDrop,
    ];

    /// Key of its half-width in a spread's file.
    pub fn key(self) -> &'static str {
        match self {
            Cause::Resistance => "phase_resistance_relative",
            Cause::BackEmf => "back_emf_relative",
            Cause::Inertia => "inertia_relative",
            Cause::DynamicRatio => "dynamic_ratio_relative",
            Cause::Supply => "supply_voltage_relative",
            Cause::Temperature => "winding_temperature_k",
            Cause::RestAngle => "rest_angle_rad",
            Cause::Inductance => "phase_inductance_relative",
            Cause::Viscous => "viscous_relative",
            Cause::EffectAmplitude => "effect_amplitude_sigmas",
            Cause::EffectShape => "effect_shape_sigmas",
            Cause::BreakAway => "break_away_relative",
            Cause::HealthyFriction => "healthy_friction_relative",
            Cause::EffectGrowth => "effect_growth",
            Cause::TestTemperature => "test_temperature_k",
            Cause::FrictionSlope => "friction_slope_relative",
            Cause::BridgeDrop => "bridge_drop_v",
        }
    }

    /// Key by which a value of it that is known is given, in SI units.
    pub fn known_key(self) -> &'static str {
        match self {
            Cause::Resistance => "phase_resistance_ohm",
            Cause::BackEmf => "back_emf_v_s_per_rad",
            Cause::Inertia => "inertia_kg_m2",
            Cause::DynamicRatio => "dynamic_ratio",
            Cause::Supply => "supply_voltage_v",
            Cause::Temperature => "winding_temperature_degc",
            Cause::RestAngle => "rest_angle_rad",
            Cause::Inductance => "phase_inductance_h",
            Cause::Viscous => "viscous_n_m_s_per_rad",
            Cause::EffectAmplitude => "effect_amplitude_sigmas",
            Cause::EffectShape => "effect_shape_sigmas",
            Cause::BreakAway => "static_n_m",
            Cause::HealthyFriction => "healthy_friction_n_m",
            Cause::EffectGrowth => "effect_growth",
            Cause::TestTemperature => "temperature_degc",
            Cause::FrictionSlope => "friction_slope_relative",
            Cause::BridgeDrop => "bridge_drop_v",
        }
    }

    /// In reports.
    pub fn title(self) -> &'static str {
        match self {
            Cause::Resistance => "phase resistance",
            Cause::BackEmf => "back-EMF coefficient",
            Cause::Inertia => "inertia",
            Cause::DynamicRatio => "dynamic over static friction",
            Cause::Supply => "supply voltage",
            Cause::Temperature => "winding temperature",
            Cause::RestAngle => "rotor angle at rest",
            Cause::Inductance => "phase inductance",
            Cause::Viscous => "viscous friction",
            Cause::EffectAmplitude => "amplitudes of the effects",
            Cause::EffectShape => "shapes of the effects",
            Cause::BreakAway => "static friction",
            Cause::HealthyFriction => "healthy friction",
            Cause::EffectGrowth => "growth of effects of friction with FSJ",
            Cause::TestTemperature => "temperature of the actuator",
            Cause::FrictionSlope => "slope of friction over temperature",
            Cause::BridgeDrop => "voltage that the bridge loses",
        }
    }

    /// How far a known value lies from the actuator's (and the maps' rest angle), in the unit of the
    /// half-width: relative, K or rad.
    pub fn deviation(self, actuator: &ActuatorParameters, rest_angle_rad: f64, known: f64) -> f64 {
        let relative = |nominal: f64| known / nominal - 1.0;
        match self {
            Cause::Resistance => relative(actuator.phase_resistance_ohm),
            Cause::BackEmf => relative(actuator.back_emf_v_s_per_rad),
            Cause::Inertia => relative(actuator.inertia_kg_m2),
            Cause::DynamicRatio => relative(actuator.dynamic_friction_ratio),
            Cause::Supply => relative(actuator.supply_voltage_v),
            Cause::Inductance => relative(actuator.phase_inductance_h),
            Cause::Viscous => relative(actuator.viscous_n_m_s_per_rad),
            Cause::EffectAmplitude | Cause::EffectShape | Cause::FrictionSlope => known,
            Cause::EffectGrowth => known - actuator.effects.iter().map(|e| e.grows).fold(0.0, f64::max),
            Cause::BreakAway | Cause::HealthyFriction => relative(actuator.static_friction_n_m),
            Cause::Temperature | Cause::TestTemperature => known - actuator.temperature_degc,
            Cause::BridgeDrop => known - 0.5 * lost_by_two_legs(actuator),
            Cause::RestAngle => {
                let turn = std::f64::consts::TAU;
                (known - rest_angle_rad + 0.5 * turn).rem_euclid(turn) - 0.5 * turn
            }
        }
    }

    /// Whether a value is multiplied by what it deviates by: its deviation is relative.
    pub fn is_relative(self) -> bool {
        !matches!(
            self,
            Cause::Temperature
                | Cause::RestAngle
                | Cause::EffectAmplitude
                | Cause::EffectShape
                | Cause::EffectGrowth
                | Cause::TestTemperature
                | Cause::FrictionSlope
                | Cause::BridgeDrop
        )
    }

    /// A deviation as responses count it: of what is multiplied the logarithm of the factor, so that products of causes
    /// (friction, its ratio, one over the flux) add and what only their product shows stays a straight line.
    pub fn counted(self, deviation: f64) -> f64 {
        if self.is_relative() {
            deviation.ln_1p()
        } else {
            deviation
        }
    }

    /// The deviation that is counted so.
    pub fn of_counted(self, counted: f64) -> f64 {
        if self.is_relative() { counted.exp_m1() } else { counted }
    }

    /// What it acts through: deviations of other causes for a deviation of one unit of this one. The slope of friction acts
    /// at other temperatures only ([`Spread::friction_at`]).
    ///
    /// * `friction_per_k` as [`Spread::friction_per_k`]
    pub fn acts_through(self, friction_per_k: f64) -> Vec<(Cause, f64)> {
        match self {
            Cause::Temperature => vec![(Cause::Resistance, COPPER_PER_K), (Cause::BackEmf, MAGNET_PER_K)],
            Cause::TestTemperature => vec![
                (Cause::Resistance, COPPER_PER_K),
                (Cause::BackEmf, MAGNET_PER_K),
                (Cause::HealthyFriction, friction_per_k),
                (Cause::Viscous, friction_per_k),
            ],
            Cause::FrictionSlope => Vec::new(),
            cause => vec![(cause, 1.0)],
        }
    }
}

/// What is known of the unit and the test: a cause and by how much it deviates from the actuator of the maps (relative,
/// K or rad).
pub type Known = Vec<(Cause, f64)>;

/// Known values in words (`supply_voltage_v=47.5`) for one actuator.
///
/// # Errors
/// A text that is no `KEY=NUMBER`, or an unknown key.
pub fn parse_known(text: &[String], actuator: &ActuatorParameters, rest_angle_rad: f64) -> Result<Known> {
    let keys = || Cause::ALL.map(Cause::known_key).join(", ");
    let one = |t: &String| {
        let bad = |found: &str| {
            Error::bad(
                "command line",
                "--known",
                found,
                format!("KEY=NUMBER, KEY one of {}", keys()),
            )
        };
        let (key, value) = t.split_once('=').ok_or_else(|| bad(t))?;
        let cause = Cause::ALL.into_iter().find(|c| c.known_key() == key.trim());
        let value = value.trim().parse::<f64>().ok().filter(|x| x.is_finite());
        let (Some(cause), Some(value)) = (cause, value) else {
            return Err(bad(t));
        };
        Ok((cause, cause.deviation(actuator, rest_angle_rad, value)))
    };
    text.iter().map(one).collect()
}

/// Standard deviation of a uniform distribution.
pub fn of_uniform(half_width: f64) -> f64 {
    half_width / 3f64.sqrt()
}

/// Half-widths of the uniform distributions of all causes.
#[derive(Clone, Debug, PartialEq)]
pub struct Spread {
    /// letters, digits, - and _: files of its calibrations are called by it
    pub name: String,
    /// by [`Cause`]: relative, K or rad
    pub half_width: [f64; Cause::COUNT],
    /// by how much dry and viscous friction change with the actuator's temperature, relative to that at the actuator's own
    /// [1/K]
    pub friction_per_k: f64,
}

/// Friction at a temperature over that at the actuator's own, at least (assumed): lubricants do not vanish.
const LEAST_FRICTION: f64 = 0.05;

/// Half-width of the static friction of an actuator that was studied in motion, relative (assumed): nobody has seen it
/// break away. Where friction rises towards standstill beside the step of dry friction, it is between the greater of the
/// two and their sum.
fn break_away(a: &ActuatorParameters) -> f64 {
    const UNSEEN: f64 = 0.05;
    let rising = |e: &&Effect| e.is_present() && e.kind == EffectKind::Stribeck;
    let rise: f64 = a.effects.iter().filter(rising).map(|e| e.values[0]).sum();
    let fixed = a.static_friction_n_m;
    let least = fixed.max(fixed * a.dynamic_friction_ratio + rise);
    ((fixed + rise - least) / fixed).clamp(UNSEEN, 0.5)
}

/// Voltage that two conducting legs of the bridge lose, by the actuator's effects [V].
fn lost_by_two_legs(a: &ActuatorParameters) -> f64 {
    a.effects
        .iter()
        .filter(|e| e.kind == EffectKind::DeadTime)
        .map(|e| e.values[0])
        .sum()
}

/// Adds to it. Less than nothing is a drive that makes up for more than its bridge loses.
fn lose_more(a: &mut ActuatorParameters, volts: f64) {
    match a.effects.iter_mut().find(|e| e.kind == EffectKind::DeadTime) {
        Some(e) => e.values[0] += volts,
        None if volts != 0.0 => a.effects.push(Effect::new(EffectKind::DeadTime, &[volts])),
        None => {}
    }
}

impl Spread {
    /// Nothing differs.
    pub fn none() -> Self {
        Self {
            name: "none".into(),
            half_width: [0.0; Cause::COUNT],
            friction_per_k: 0.0,
        }
    }

    /// Dry and viscous friction at a temperature over that at the actuator's own.
    ///
    /// * `kelvin` warmer than that
    /// * `slope` by how much the slope deviates, relative
    pub fn friction_at(&self, kelvin: f64, slope: f64) -> f64 {
        (1.0 + self.friction_per_k * (1.0 + slope) * kelvin).max(LEAST_FRICTION)
    }

    /// How far an actuator may be from what a study says of it: uniform distributions of the standard deviations that
    /// stand in its file. `None` where it has none. What a test reads off friction goes with the dynamic level that
    /// was identified.
    pub fn identified(actuator: &ActuatorParameters) -> Option<Self> {
        let of = |key: &str| actuator.uncertainty.of(key).map_or(0.0, |x| (3f64.sqrt() * x).min(0.5));
        if actuator.uncertainty.parameters.is_empty() {
            return None;
        }
        let mut spread = Self::none();
        spread.name = "identified".into();
        spread.half_width[Cause::Resistance as usize] = of("motor.phase_resistance_ohm");
        spread.half_width[Cause::BackEmf as usize] = of("motor.back_emf_v_s_per_rad");
        spread.half_width[Cause::Inertia as usize] = of("motor.inertia_kg_m2");
        spread.half_width[Cause::DynamicRatio as usize] = of("friction.static_n_m");
        spread.half_width[Cause::Inductance as usize] = of("motor.phase_inductance_h");
        spread.half_width[Cause::Viscous as usize] = of("motor.viscous_n_m_s_per_rad");
        spread.half_width[Cause::BreakAway as usize] = break_away(actuator);
        if actuator.effects.iter().any(|e| e.is_present() && e.intervals.is_some()) {
            spread.half_width[Cause::EffectAmplitude as usize] = 3f64.sqrt();
            spread.half_width[Cause::EffectShape as usize] = 3f64.sqrt();
        }
        Some(spread)
    }

    /// From a TOML file's table.
    ///
    /// # Errors
    /// A name with other characters, a half-width outside its range, an unknown key.
    pub fn from_section(mut s: Section) -> Result<Self> {
        // files of its calibrations are called by it
        let allowed = "letters, digits, - and _";
        let name = s.text("name", allowed)?;
        let plain = |c: char| c.is_ascii_alphanumeric() || c == '-' || c == '_';
        if name.is_empty() || !name.chars().all(plain) {
            return Err(s.bad("name", &name, allowed));
        }
        let mut half_width = [0.0; Cause::COUNT];
        for (cause, h) in Cause::ALL.into_iter().zip(&mut half_width) {
            *h = match cause {
                Cause::Temperature | Cause::TestTemperature => {
                    s.number_or(cause.key(), 0.0, |x| (0.0..=150.0).contains(&x), "0 to 150 K")?
                }
                Cause::RestAngle => s.number_or(cause.key(), 0.0, |x| (0.0..=0.1).contains(&x), "0 to 0.1 rad")?,
                Cause::EffectAmplitude | Cause::EffectShape => s.number_or(
                    cause.key(),
                    0.0,
                    |x| (0.0..=5.0).contains(&x),
                    "0 to 5 standard deviations",
                )?,
                Cause::BridgeDrop => s.number_or(cause.key(), 0.0, |x| (0.0..=5.0).contains(&x), "0 to 5 V")?,
                _ => s.number_or(cause.key(), 0.0, |x| (0.0..=0.5).contains(&x), "0 to 0.5")?,
            };
        }
        let slopes = "-0.02 to 0.02 1/K";
        let friction_per_k = s.number_or("friction_per_k", 0.0, |x| (-0.02..=0.02).contains(&x), slopes)?;
        s.finish()?;
        Ok(Self {
            name,
            half_width,
            friction_per_k,
        })
    }

    /// Whether nothing differs.
    pub fn is_none(&self) -> bool {
        self.half_width.iter().all(|&h| h == 0.0)
    }

    /// Causes that have a half-width.
    pub fn causes(&self) -> impl Iterator<Item = (Cause, f64)> {
        let pairs = Cause::ALL.into_iter().zip(self.half_width);
        pairs.filter(|(_, h)| *h > 0.0)
    }

    /// Of the half-widths, not of the name.
    pub fn fingerprint(&self) -> String {
        let (first, later) = self.half_width.split_at(Cause::FIRST);
        let mut text = format!(
            "spread;{}",
            first.iter().map(|h| exact(*h)).collect::<Vec<_>>().join(",")
        );
        for (cause, h) in Cause::ALL[Cause::FIRST..].iter().zip(later).filter(|(_, h)| **h > 0.0) {
            text += &format!(";{},{}", cause.key(), exact(*h));
        }
        if self.friction_per_k != 0.0 {
            text += &format!(";friction_per_k,{}", exact(self.friction_per_k));
        }
        fingerprint(&text)
    }

    /// A unit, and the rest angle of its test.
    ///
    /// * `draw` by [`Cause`], -1 to 1: share of the half-width
    pub fn unit(
        &self,
        actuator: &ActuatorParameters,
        rest_angle_rad: f64,
        draw: &[f64; Cause::COUNT],
    ) -> (ActuatorParameters, f64) {
        let mut a = actuator.clone();
        // the drive divides by its own constant, whatever the unit's flux is
        let moves_flux = |(c, _): (Cause, f64)| c.acts_through(0.0).iter().any(|(c, _)| *c == Cause::BackEmf);
        if self.causes().any(moves_flux) {
            a.drive_constant_n_m_per_a = actuator.drive_constant();
        }
        let mut rest = rest_angle_rad;
        let of = |c: Cause| draw[c as usize] * self.half_width[c as usize];
        let friction = self.friction_at(of(Cause::TestTemperature), of(Cause::FrictionSlope));
        a.static_friction_n_m *= friction;
        a.viscous_n_m_s_per_rad *= friction;
        for (cause, h) in self.causes() {
            // friction by temperature stands above
            for (through, per_unit) in cause.acts_through(0.0) {
                let x = draw[cause as usize] * h * per_unit;
                match through {
                    Cause::Resistance => a.phase_resistance_ohm *= 1.0 + x,
                    Cause::BackEmf => a.back_emf_v_s_per_rad *= 1.0 + x,
                    Cause::Inertia => a.inertia_kg_m2 *= 1.0 + x,
                    Cause::DynamicRatio => a.dynamic_friction_ratio = (a.dynamic_friction_ratio * (1.0 + x)).min(1.0),
                    Cause::Supply => a.supply_voltage_v *= 1.0 + x,
                    Cause::Inductance => a.phase_inductance_h *= 1.0 + x,
                    Cause::Viscous => a.viscous_n_m_s_per_rad *= 1.0 + x,
                    Cause::RestAngle => rest += x,
                    Cause::BreakAway => {
                        let dynamic = a.static_friction_n_m * a.dynamic_friction_ratio;
                        a.static_friction_n_m = (a.static_friction_n_m * (1.0 + x)).max(dynamic);
                        a.dynamic_friction_ratio = dynamic / a.static_friction_n_m;
                    }
                    Cause::HealthyFriction => a.static_friction_n_m *= 1.0 + x,
                    Cause::EffectGrowth => {
                        let friction = a.effects.iter_mut().filter(|e| e.kind.is_friction());
                        friction.for_each(|e| e.grows = (e.grows + x).clamp(0.0, 1.0));
                    }
                    Cause::EffectAmplitude | Cause::EffectShape => {
                        let amplitude = through == Cause::EffectAmplitude;
                        a.effects.iter_mut().for_each(|e| e.deviate(amplitude, x));
                    }
                    Cause::BridgeDrop => lose_more(&mut a, 2.0 * x),
                    Cause::Temperature | Cause::TestTemperature | Cause::FrictionSlope => {
                        unreachable!("acts through others")
                    }
                }
            }
        }
        (a, rest)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn prop_units_keep_to_their_half_widths() {
        let a = ActuatorParameters::reference();
        let fleet = crate::catalogue::spread("fleet").unwrap();
        let (unit, rest) = fleet.unit(
            &a,
            0.5,
            &[
                1.0, -1.0, 1.0, -1.0, 0.5, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0,
            ],
        );
        let near = |x: f64, y: f64| assert!((x / y - 1.0).abs() < 1e-12, "{x} {y}");
        near(unit.phase_resistance_ohm, 1.05 * a.phase_resistance_ohm);
        near(unit.back_emf_v_s_per_rad, 0.98 * a.back_emf_v_s_per_rad);
        near(unit.inertia_kg_m2, 1.05 * a.inertia_kg_m2);
        near(unit.dynamic_friction_ratio, 0.9 * a.dynamic_friction_ratio);
        near(unit.supply_voltage_v, 1.01 * a.supply_voltage_v);
        assert_eq!(rest, 0.5);
        assert_eq!(Spread::none().unit(&a, 0.5, &[1.0; Cause::COUNT]), (a.clone(), 0.5));
        // what is known of a unit is found again
        let found = Cause::Resistance.deviation(&a, 0.0, unit.phase_resistance_ohm);
        assert!((found - 0.05).abs() < 1e-12, "{found}");
    }

    #[test]
    fn prop_only_what_was_studied_is_uncertain() {
        let mut a = ActuatorParameters::reference();
        assert_eq!(Spread::identified(&a), None);
        a.uncertainty.parameters = vec!["motor.inertia_kg_m2".into()];
        a.uncertainty.deviation = vec![0.01];
        a.uncertainty.correlation = vec![1.0];
        let spread = Spread::identified(&a).unwrap();
        assert!((spread.half_width[Cause::Inertia as usize] - 0.01 * 3f64.sqrt()).abs() < 1e-12);
        assert_eq!(spread.half_width[Cause::BreakAway as usize], 0.05);
    }

    #[test]
    fn prop_what_the_bridge_loses_is_added_to_what_the_actuator_has() {
        let mut a = ActuatorParameters::reference();
        let bridge = crate::catalogue::spread("bridge").unwrap();
        let at = |a: &ActuatorParameters, share: f64| bridge.unit(a, 0.0, &[share; Cause::COUNT]).0;
        assert_eq!(at(&a, 0.0).effects, []);
        assert!((lost_by_two_legs(&at(&a, 1.0)) - 0.2).abs() < 1e-12);
        a.effects.push(Effect::new(EffectKind::DeadTime, &[0.7]));
        let less = at(&a, -1.0);
        assert!((lost_by_two_legs(&less) - 0.5).abs() < 1e-12);
        // what is known of a unit is found again, of each leg
        let found = Cause::BridgeDrop.deviation(&a, 0.0, 0.5 * lost_by_two_legs(&less));
        assert!((found + 0.1).abs() < 1e-12, "{found}");
    }

    #[test]
    fn prop_a_warm_winding_has_more_resistance_and_less_flux() {
        let a = ActuatorParameters::reference();
        let mut warm = Spread::none();
        warm.half_width[Cause::Temperature as usize] = 40.0;
        let (unit, _) = warm.unit(&a, 0.0, &[1.0; Cause::COUNT]);
        assert!((unit.phase_resistance_ohm / a.phase_resistance_ohm - 1.1572).abs() < 1e-12);
        assert!((unit.back_emf_v_s_per_rad / a.back_emf_v_s_per_rad - 0.956).abs() < 1e-12);
    }

    #[test]
    fn prop_a_cold_actuator_has_more_friction_of_both_kinds() {
        let a = ActuatorParameters::reference();
        let mut cold = Spread::none();
        cold.half_width[Cause::TestTemperature as usize] = 60.0;
        cold.half_width[Cause::FrictionSlope as usize] = 0.2;
        cold.friction_per_k = -0.004;
        let mut draw = [0.0; Cause::COUNT];
        draw[Cause::TestTemperature as usize] = -1.0;
        draw[Cause::FrictionSlope as usize] = 0.5;
        let (unit, _) = cold.unit(&a, 0.0, &draw);
        for (x, y) in [
            (unit.static_friction_n_m, a.static_friction_n_m),
            (unit.viscous_n_m_s_per_rad, a.viscous_n_m_s_per_rad),
        ] {
            assert!((x / y - (1.0 + 0.0044 * 60.0)).abs() < 1e-12, "{x} {y}");
        }
        assert!((unit.phase_resistance_ohm / a.phase_resistance_ohm - (1.0 - 60.0 * COPPER_PER_K)).abs() < 1e-12);
        assert_ne!(
            cold.fingerprint(),
            Spread {
                friction_per_k: -0.005,
                ..cold.clone()
            }
            .fingerprint()
        );
    }
}
