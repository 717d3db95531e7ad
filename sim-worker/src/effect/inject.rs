//! The effects of an actuator, sorted by where they act, for test bench and simplified model.

use super::equations::REFERENCE_TEMPERATURE_DEGC;
use super::{Constants, Dahl, DelayLine, Effect, EffectKind, Law, Signals, TwoMass, commutation_share};
use crate::parameters::ActuatorParameters;

/// Effects of one actuator; those without amplitude are left out. Winding heating and backlash
/// are constants of the models, eccentricity is one of the test bench: they are not here or only
/// for the simplified model.
#[derive(Clone, Debug)]
pub struct Injection {
    /// what the equations refer to
    pub constants: Constants,
    /// load, temperature and rest angle; the rest is filled in step by step
    pub signals: Signals,
    pub(super) friction: Vec<Effect>,
    pub(super) torque: Vec<Effect>,
    pub(super) ripple: Vec<Effect>,
    eccentricity: Vec<Effect>,
    short: Vec<Effect>,
    pub(super) dead_time: Vec<Effect>,
    pub(super) saturation: Vec<Effect>,
    pub(super) encoder: Vec<Effect>,
    /// share of the turns of each phase that is left
    pub turns: [f64; 3],
    /// electrical angle of the commutation less the measured one [rad]
    pub commutation: f64,
    /// resistance of the source [ohm]
    pub source: f64,
    /// what its voltage goes by
    pub draw: Law,
    /// gain of the measured current `gain i + offset`
    pub gain: f64,
    /// gain of each phase's sensor
    pub gains: [f64; 3],
    /// offset of the measured current, in the phases that conduct, by their signs [A]
    pub offset: f64,
    /// offset of each phase's sensor [A]: the relays of the other two hold the current, so that the motor hardly feels that of
    /// one, and the simplified model knows nothing of it
    pub sensors: [f64; 3],
    /// delay of the controller's output; none without
    pub delay: Option<DelayLine>,
    /// bristles in place of dry friction; none without
    pub bristles: Option<Dahl>,
    /// mass behind a compliance; none without
    pub behind: Option<TwoMass>,
}

/// Turns that are left of a phase however many are shorted: without any it would have no
/// inductance, and its current no equation.
const FEWEST_TURNS: f64 = 1e-3;
/// Inertia behind a spring, at most this share of the whole.
const MOST_BEHIND: f64 = 0.999;

impl Injection {
    /// None where the actuator has no effect that changes anything.
    ///
    /// * `rest` rotor angle at rest [rad], `load` torque [N m], `dt` step [s]
    pub fn new(p: &ActuatorParameters, fsj: f64, rest: f64, load: f64, dt: f64) -> Option<Self> {
        let mut all = Self {
            constants: Constants::of(p, fsj),
            signals: Signals {
                rest,
                load,
                temperature: p.temperature_degc,
                ..Signals::default()
            },
            friction: Vec::new(),
            torque: Vec::new(),
            ripple: Vec::new(),
            eccentricity: Vec::new(),
            short: Vec::new(),
            dead_time: Vec::new(),
            saturation: Vec::new(),
            encoder: Vec::new(),
            turns: [1.0; 3],
            commutation: 0.0,
            source: 0.0,
            draw: Law::First,
            gain: 1.0,
            gains: [1.0; 3],
            offset: 0.0,
            sensors: [0.0; 3],
            delay: None,
            bristles: None,
            behind: None,
        };
        let mut any = false;
        for e in p.effects.iter().filter(|e| e.is_present()) {
            any = true;
            let [a, b, d] = e.values;
            match e.kind {
                EffectKind::Stribeck
                | EffectKind::LubricatedRise
                | EffectKind::LoadDependentFriction
                | EffectKind::TemperatureDependentFriction
                | EffectKind::PeriodicFriction
                | EffectKind::TightSpot => all.friction.push(e.worn(fsj)),
                EffectKind::QuadraticDrag
                | EffectKind::ViscousAsymmetry
                | EffectKind::BiasTorque
                | EffectKind::Cogging
                | EffectKind::SpringLoad => all.torque.push(e.clone()),
                EffectKind::TorqueRipple => all.ripple.push(e.clone()),
                EffectKind::Eccentricity => all.eccentricity.push(e.clone()),
                EffectKind::TorqueSaturation => all.saturation.push(e.clone()),
                EffectKind::Presliding => all.bristles = Some(e.bristles(&all.constants)),
                EffectKind::Compliance => {
                    all.behind = Some(TwoMass::new(a, b, d.min(MOST_BEHIND * p.inertia_kg_m2), 0.0));
                }
                EffectKind::Backlash | EffectKind::WindingHeating => {}
                EffectKind::SupplySag => {
                    all.source += a;
                    if e.law != Law::First {
                        all.draw = e.law;
                    }
                }
                EffectKind::DeadTime => all.dead_time.push(e.clone()),
                EffectKind::TurnShort => {
                    let turns = &mut all.turns[(b as usize).min(2)];
                    *turns = (*turns * (1.0 - a)).max(FEWEST_TURNS);
                    all.short.push(e.clone());
                }
                EffectKind::CommutationOffset => all.commutation += a,
                EffectKind::EncoderEccentricity => all.encoder.push(e.clone()),
                EffectKind::CurrentOffset => match e.sensor() {
                    Some(q) => all.sensors[q] += a,
                    None => all.offset += a,
                },
                EffectKind::CurrentGain => match e.sensor() {
                    Some(q) => {
                        all.gains[q] *= 1.0 + a;
                        // the relay that sees the greatest current holds it, in two sixths of a turn of three
                        all.gain *= 1.0 + 2.0 / 3.0 * a.max(0.0);
                    }
                    None => {
                        all.gains = all.gains.map(|g| g * (1.0 + a));
                        all.gain *= 1.0 + a;
                    }
                },
                EffectKind::ControlDelay => all.delay = Some(DelayLine::new(a, dt)),
            }
        }
        any.then_some(all)
    }

    /// Whether the steps of the test bench know of it; else its constants say all.
    pub(super) fn needs_kernel(p: &ActuatorParameters) -> bool {
        let constant = [
            EffectKind::Backlash,
            EffectKind::WindingHeating,
            EffectKind::Eccentricity,
        ];
        p.effects.iter().any(|e| e.is_present() && !constant.contains(&e.kind))
    }

    /// Friction level to be added [N m], below 0 where it is taken away.
    #[inline]
    pub fn friction(&self, s: &Signals) -> f64 {
        self.friction.iter().map(|e| e.friction(s, &self.constants)).sum()
    }

    /// Shorted turns that brake.
    pub(super) fn bridged(&self) -> impl Iterator<Item = &Effect> + Clone {
        self.short.iter().filter(|e| e.law == Law::Bridged)
    }

    /// Torque against the motor [N m], but for friction and what acts on the torque constant.
    #[inline]
    pub fn torque(&self, s: &Signals) -> f64 {
        let brakes: f64 = self.bridged().map(|e| e.brake_torque(s, &self.constants)).sum();
        self.torque.iter().map(|e| e.torque(s, &self.constants)).sum::<f64>() + brakes
    }

    /// Values of an effect with what does not change during a test worked in.
    pub(super) fn prepared(&self, e: &Effect) -> [f64; 3] {
        let a = e.values[0];
        match e.kind {
            EffectKind::LoadDependentFriction => [a * self.signals.load.abs(), 1.0, 1.0],
            EffectKind::TemperatureDependentFriction => {
                let warm = a * (self.signals.temperature - REFERENCE_TEMPERATURE_DEGC);
                [warm, self.constants.coulomb, self.constants.viscous]
            }
            EffectKind::EncoderEccentricity => {
                let of_speed = f64::from(u8::from(e.law == Law::AngleAndSpeed));
                [a, e.values[1], of_speed]
            }
            EffectKind::TurnShort => e.bridge(&self.constants).unwrap_or_default(),
            EffectKind::TorqueSaturation => {
                let is = |law| f64::from(u8::from(e.law == law));
                [a, is(Law::Flux), is(Law::Square)]
            }
            _ => e.values,
        }
    }

    /// What is left of the torque of a phase current [A].
    pub fn saturation(&self, i: f64) -> f64 {
        self.saturation.iter().map(|e| e.saturation(i)).product()
    }

    /// What is left of the back-EMF at the equivalent current [A].
    pub fn flux(&self, i: f64) -> f64 {
        self.saturation.iter().map(|e| e.flux(i)).product()
    }

    /// Measured angle less the true one [rad].
    pub fn angle_error(&self, theta: f64) -> f64 {
        self.encoder.iter().map(|e| e.angle_error(theta)).sum()
    }

    /// Measured speed over the true one.
    pub fn seen_speed(&self, theta: f64) -> f64 {
        1.0 + self.encoder.iter().map(|e| e.speed_error(theta)).sum::<f64>()
    }

    /// Electrical angle of the commutation less the true one [rad].
    pub fn electrical_error(&self, theta: f64) -> f64 {
        self.constants.pole_pairs * self.angle_error(theta) + self.commutation
    }

    /// One equivalent phase: share of the torque constant that is lost (negative) or won.
    pub fn constant_share(&self, s: &Signals) -> f64 {
        let groups = [&self.ripple, &self.eccentricity, &self.short];
        let each = groups.into_iter().flatten();
        let share: f64 = each.map(|e| e.constant_share(s, &self.constants)).sum();
        let error = self.electrical_error(s.theta);
        if error == 0.0 {
            share
        } else {
            share + commutation_share(s.theta, error, self.constants.pole_pairs)
        }
    }

    /// One equivalent phase: voltage that the source must give in addition [V], but for the
    /// back-EMF of [`Injection::constant_share`].
    pub fn voltage(&self, s: &Signals) -> f64 {
        let dead: f64 = self.dead_time.iter().map(|e| e.voltage(s, &self.constants)).sum();
        let emf = Signals { omega: 0.0, ..*s };
        let short: f64 = self.short.iter().map(|e| e.voltage(&emf, &self.constants)).sum();
        dead + short
    }
}
