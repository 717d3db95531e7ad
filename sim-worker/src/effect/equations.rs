//! The equations of the effects that depend on the signals of one moment. Torques are signed as
//! `kt i = J dw/dt + C w + friction + load + sum of effects`, voltages as
//! `v = R i + L di/dt + ke w + sum of effects`.

use super::{Effect, EffectKind, Law};
use crate::exponential::{exp, power, tanh};
use crate::parameters::ActuatorParameters;
use crate::trig;
use std::f64::consts::{FRAC_PI_6, PI, TAU};

/// Temperature at which friction and resistance are the nominal ones [degC] (assumed).
pub const REFERENCE_TEMPERATURE_DEGC: f64 = 20.0;
/// Temperature coefficient of copper's resistance at 20 degC [1/K], of every winding here: annealed copper by
/// IEC 60028 (International standard of resistance for copper).
pub const COPPER_PER_K: f64 = 0.003_93;
/// Current over which the dead-time voltage changes sign [A] (assumed).
const DEAD_TIME_A: f64 = 0.05;

/// Signals of one moment; SI, motor side.
#[derive(Clone, Copy, Debug, Default)]
pub struct Signals {
    /// rotor angle [rad]
    pub theta: f64,
    /// rotor angle at rest [rad]
    pub rest: f64,
    /// rotor speed [rad/s]
    pub omega: f64,
    /// sign of the motion, or of the impending motion of a standing rotor
    pub sign: f64,
    /// signed motor current [A]
    pub current: f64,
    /// its derivative [A/s]
    pub current_rate: f64,
    /// load torque [N m]
    pub load: f64,
    /// [degC]
    pub temperature: f64,
    /// commanded voltage over the supply's
    pub duty: f64,
}

/// Constants of the actuator that effects refer to; two phases in series, motor side.
#[derive(Clone, Copy, Debug)]
pub struct Constants {
    /// kt = 2 ke [N m/A]
    pub torque_constant: f64,
    /// dynamic dry friction FD [N m]
    pub coulomb: f64,
    /// FS over FD, as [`ActuatorParameters::break_away_ratio`]
    pub break_away: f64,
    /// C [N m s/rad]
    pub viscous: f64,
    /// 2 R [ohm]
    pub resistance: f64,
    /// 2 L [H]
    pub inductance: f64,
    /// P, as a number to calculate with
    pub pole_pairs: f64,
}

impl Constants {
    /// Of an actuator whose dry friction is `fsj` times the nominal.
    pub fn of(p: &ActuatorParameters, fsj: f64) -> Self {
        Self {
            torque_constant: p.torque_constant_n_m_per_a(),
            coulomb: fsj * p.static_friction_n_m * p.dynamic_friction_ratio,
            break_away: p.break_away_ratio(),
            viscous: p.viscous_n_m_s_per_rad,
            resistance: 2.0 * p.phase_resistance_ohm,
            inductance: 2.0 * p.phase_inductance_h,
            pole_pairs: p.pole_pairs as f64,
        }
    }
}

/// The same bits on every machine, see [`trig`].
#[inline(always)]
fn cos(x: f64) -> f64 {
    trig::sin_cos(x).1
}

/// Stribeck's part of friction [N m] at the speed `omega`.
#[inline(always)]
pub(super) fn stribeck([torque, speed, exponent]: [f64; 3], omega: f64) -> f64 {
    torque * exp(-power(omega.abs() / speed, exponent))
}

/// Rise of lubricated friction [N m].
#[inline(always)]
pub(super) fn lubricated([torque, speed, _]: [f64; 3], omega: f64) -> f64 {
    torque * (1.0 - exp(-omega.abs() / speed))
}

/// `amplitude cos(order theta + phase)`.
#[inline(always)]
pub(super) fn wave([amplitude, phase, order]: [f64; 3], theta: f64) -> f64 {
    amplitude * cos(order * theta + phase)
}

/// A bell around an angle [N m].
#[inline(always)]
pub(super) fn bell([torque, centre, width]: [f64; 3], theta: f64) -> f64 {
    let x = (theta - centre) / width;
    torque * exp(-(x * x))
}

/// Share of the torque of a phase current [A] that a saturated iron leaves.
#[inline(always)]
pub(super) fn saturation(coefficient: f64, i: f64) -> f64 {
    (1.0 - coefficient * i.abs()).max(0.0)
}

/// The same by the square of the current.
#[inline(always)]
pub(super) fn square_saturation(coefficient: f64, i: f64) -> f64 {
    let x = coefficient * i;
    (1.0 - x * x).max(0.0)
}

/// Share of torque and back-EMF that a saturated flux leaves at the equivalent current [A].
#[inline(always)]
pub fn flux_left(coefficient: f64, i: f64) -> f64 {
    let x = coefficient * i;
    1.0 / (1.0 + x * x).sqrt()
}

/// Voltage that a conducting leg of a current [A] loses to dead time [V].
#[inline(always)]
pub(super) fn dead_time(volts: f64, i: f64) -> f64 {
    0.5 * volts * tanh(i / DEAD_TIME_A)
}

/// Angle of a sensor out of centre less the true one [rad], and the speed that it shows over the true one, less 1.
#[inline(always)]
pub(super) fn off_centre([amplitude, phase, _]: [f64; 3], theta: f64) -> (f64, f64) {
    let (sin, cos) = trig::sin_cos(theta + phase);
    (amplitude * sin, amplitude * cos)
}

/// An angle within `[0, 2 pi)` [rad]: the bits of `rem_euclid(TAU)`, without its loop of divisions.
pub fn within_a_turn(angle: f64) -> f64 {
    // 2 pi in two parts, so short that each times a number of turns below `MOST` is exact; so are both differences
    const HIGH: f64 = f64::from_bits(TAU.to_bits() & !0xF_FFFF);
    const LOW: f64 = TAU - HIGH;
    const MOST: f64 = (1 << 20) as f64;
    let (size, turns) = (angle.abs(), angle.abs() / TAU);
    if turns.is_nan() || turns >= MOST {
        return angle.rem_euclid(TAU);
    }
    let turns = (turns as i32) as f64;
    let rest = (size - turns * HIGH) - turns * LOW;
    // the quotient was rounded up to a whole number
    let rest = if rest < 0.0 { rest + TAU } else { rest };
    match (angle.is_sign_negative(), rest > 0.0) {
        (false, _) => rest,
        (true, true) => TAU - rest,
        (true, false) => -rest,
    }
}

/// `trap` of the paper: 0 to 1 over 0..30 electrical degrees, 1 to 150, to -1 at 210, -1 to 330,
/// back to 0 at 360.
pub fn shape(electrical: f64) -> f64 {
    let x = within_a_turn(electrical) / FRAC_PI_6;
    let triangle = if x < 3.0 {
        x
    } else if x < 9.0 {
        6.0 - x
    } else {
        x - 12.0
    };
    triangle.clamp(-1.0, 1.0)
}

/// Torque against the rotor [N m] of bridged turns of a phase, by the coefficient `values[0]` [N m s/rad], the angle of the phase
/// `values[1]` [electrical rad] and pole pairs `values[2]`: their back-EMF is the phase's shape, and so is the torque of the current
/// that it drives.
pub(super) fn brake(values: [f64; 3], theta: f64, omega: f64) -> f64 {
    let [coefficient, phase, pole_pairs] = values;
    let at = shape(pole_pairs * theta - phase);
    coefficient * at * at * omega
}

/// Integral of [`shape`] over the electrical angle, from 0: the flux that it is the derivative of.
pub fn flux(electrical: f64) -> f64 {
    // in flanks of 30 degrees, mirrored at 180
    let x = within_a_turn(electrical) / FRAC_PI_6;
    let x = if x > 6.0 { 12.0 - x } else { x };
    let sum = if x < 1.0 {
        0.5 * x * x
    } else if x < 5.0 {
        x - 0.5
    } else {
        5.0 - 0.5 * (6.0 - x) * (6.0 - x)
    };
    FRAC_PI_6 * sum
}

/// `rect` of the paper for the three phases: +1 on [30, 150), -1 on [210, 330) electrical degrees
/// of `P theta - 2 pi q/3`, else 0.
pub fn conducting(theta: f64, pole_pairs: f64) -> [f64; 3] {
    std::array::from_fn(|q| {
        let x = within_a_turn(pole_pairs * theta - TAU / 3.0 * q as f64) / FRAC_PI_6;
        if (1.0..5.0).contains(&x) {
            1.0
        } else if (7.0..11.0).contains(&x) {
            -1.0
        } else {
            0.0
        }
    })
}

/// Share of the torque constant that is lost where the drive takes the electrical angle for
/// `P theta + error`: it feeds the phases of that angle, the back-EMF shapes are those of the true one.
pub fn commutation_share(theta: f64, error: f64, pole_pairs: f64) -> f64 {
    let on = conducting(theta + error / pole_pairs, pole_pairs);
    let at = |q: usize| on[q] * shape(pole_pairs * theta - TAU / 3.0 * q as f64);
    0.5 * (at(0) + at(1) + at(2)) - 1.0
}

impl Effect {
    /// Friction level [N m] that it adds to the dry friction; times `sgn w` it is a torque.
    #[inline]
    pub fn friction(&self, s: &Signals, c: &Constants) -> f64 {
        let a = self.values[0];
        match self.kind {
            EffectKind::Stribeck => stribeck(self.values, s.omega),
            EffectKind::LubricatedRise => lubricated(self.values, s.omega),
            EffectKind::LoadDependentFriction => a * s.load.abs(),
            EffectKind::TemperatureDependentFriction => {
                a * (s.temperature - REFERENCE_TEMPERATURE_DEGC) * (c.coulomb + c.viscous * s.omega.abs())
            }
            EffectKind::PeriodicFriction => wave(self.values, s.theta),
            EffectKind::TightSpot => bell(self.values, s.theta),
            _ => 0.0,
        }
    }

    /// Share of the torque constant (and of the back-EMF's) that it takes away (negative) or adds.
    pub fn constant_share(&self, s: &Signals, c: &Constants) -> f64 {
        let [a, b, _] = self.values;
        match self.kind {
            EffectKind::TorqueRipple => wave(self.values, s.theta),
            EffectKind::Eccentricity => {
                let on = conducting(s.theta, c.pole_pairs);
                let mean = |q: usize| 0.5 * on[q].abs() * cos(s.theta + b + TAU / 3.0 * q as f64);
                a * (mean(0) + mean(1) + mean(2))
            }
            EffectKind::TurnShort => -0.5 * a * conducting(s.theta, c.pole_pairs)[(b as usize).min(2)].abs(),
            EffectKind::CommutationOffset => commutation_share(s.theta, a, c.pole_pairs),
            _ => 0.0,
        }
    }

    /// Torque that the motor must give in addition [N m]; effects with a state of their own
    /// (presliding, compliance, backlash) are not here.
    #[inline]
    pub fn torque(&self, s: &Signals, c: &Constants) -> f64 {
        let a = self.values[0];
        match self.kind {
            EffectKind::QuadraticDrag => a * s.omega * s.omega.abs(),
            EffectKind::ViscousAsymmetry => a * s.omega.abs(),
            EffectKind::BiasTorque => a,
            EffectKind::Cogging => wave(self.values, s.theta),
            EffectKind::TorqueSaturation => c.torque_constant * s.current * (1.0 - self.saturation(s.current)),
            EffectKind::SpringLoad => a * (s.theta - s.rest),
            EffectKind::TorqueRipple
            | EffectKind::Eccentricity
            | EffectKind::TurnShort
            | EffectKind::CommutationOffset => self.shared(s, c, self.constant_share(s, c)).0 + self.brake_torque(s, c),
            EffectKind::CurrentOffset => self.current_offset(s, c) * c.torque_constant,
            EffectKind::CurrentGain => c.torque_constant * self.current_gain(s, c),
            _ => self.friction(s, c) * s.sign,
        }
    }

    /// What bridged turns need to brake, as [`brake`] has it: of the phase's `R` and `ke` the fraction `f` is in the bridged turns,
    /// `(f ke w)^2 / (f R)` is what they turn into heat. A contact of resistance `Rc` makes of a fraction `f` what
    /// `f / (1 + Rc/(f R))` makes without: in the phase, and here. That the bridged current fades within `L/R` and is coupled to the
    /// rest of the phase is left out.
    pub(super) fn bridge(&self, c: &Constants) -> Option<[f64; 3]> {
        let of_phase = 0.5 * c.torque_constant * c.torque_constant / c.resistance;
        (self.law == Law::Bridged).then(|| {
            let phase = TAU / 3.0 * self.values[1];
            [self.values[0] * of_phase, phase, c.pole_pairs]
        })
    }

    /// Torque with which bridged turns brake [N m]; 0 for all else.
    pub(super) fn brake_torque(&self, s: &Signals, c: &Constants) -> f64 {
        self.bridge(c).map_or(0.0, |b| brake(b, s.theta, s.omega))
    }

    /// What an offset of current sensors adds to the measured current that gives torque [A]; that of one phase of three counts
    /// by its shape.
    fn current_offset(&self, s: &Signals, c: &Constants) -> f64 {
        let a = self.values[0];
        let of = |q: usize| 0.5 * shape(c.pole_pairs * s.theta - TAU / 3.0 * q as f64);
        self.sensor().map_or(a, |q| a * of(q))
    }

    /// What a gain of current sensors adds to the measured current that gives torque [A]; that of one phase of three counts
    /// where the phase conducts, by its shape.
    fn current_gain(&self, s: &Signals, c: &Constants) -> f64 {
        let part = s.current * self.values[0] / (1.0 + self.values[0]);
        self.sensor().map_or(part, |q| {
            let on = conducting(s.theta, c.pole_pairs)[q];
            0.5 * part * on * shape(c.pole_pairs * s.theta - TAU / 3.0 * q as f64)
        })
    }

    /// Voltage that the source must give in addition [V].
    pub fn voltage(&self, s: &Signals, c: &Constants) -> f64 {
        let a = self.values[0];
        match self.kind {
            EffectKind::WindingHeating => c.resistance * (self.resistance_factor() - 1.0) * s.current,
            EffectKind::SupplySag => match self.law {
                // legs of a pair that are never up together, with the current or against it
                Law::Bridge => a * s.current,
                Law::Legs => a * s.duty * s.current.abs(),
                _ => a * s.duty * s.duty * s.current,
            },
            EffectKind::DeadTime => 2.0 * self.leg_drop(s.current),
            EffectKind::CurrentOffset => -self.current_offset(s, c) * c.resistance,
            EffectKind::CurrentGain => -c.resistance * self.current_gain(s, c),
            EffectKind::TurnShort
            | EffectKind::TorqueRipple
            | EffectKind::Eccentricity
            | EffectKind::CommutationOffset => self.shared(s, c, self.constant_share(s, c)).1,
            EffectKind::TorqueSaturation => -c.torque_constant * s.omega * (1.0 - self.flux(s.current)),
            _ => 0.0,
        }
    }

    /// Torque [N m] and voltage [V] of an effect that changes the torque constant by a share.
    pub fn shared(&self, s: &Signals, c: &Constants, share: f64) -> (f64, f64) {
        let mut voltage = c.torque_constant * s.omega;
        if self.kind == EffectKind::TurnShort {
            // so are resistance and inductance
            voltage += c.resistance * s.current + c.inductance * s.current_rate;
        }
        (-c.torque_constant * s.current * share, share * voltage)
    }

    /// What is left of a phase's torque at its current `i` [A]; it does not turn its sign.
    pub fn saturation(&self, i: f64) -> f64 {
        match (self.kind, self.law) {
            (EffectKind::TorqueSaturation, Law::Flux) => self.flux(i),
            (EffectKind::TorqueSaturation, Law::Square) => square_saturation(self.values[0], i),
            (EffectKind::TorqueSaturation, _) => saturation(self.values[0], i),
            _ => 1.0,
        }
    }

    /// What is left of the back-EMF at the equivalent current `i` [A].
    pub fn flux(&self, i: f64) -> f64 {
        match self.law {
            Law::Flux => flux_left(self.values[0], i),
            _ => 1.0,
        }
    }

    /// Resistance over the nominal one.
    pub fn resistance_factor(&self) -> f64 {
        match self.kind {
            EffectKind::WindingHeating => 1.0 + COPPER_PER_K * self.values[0],
            _ => 1.0,
        }
    }

    /// Voltage that a conducting leg of the bridge loses at the current `i` [A] into its phase [V];
    /// two legs conduct at a time.
    pub fn leg_drop(&self, i: f64) -> f64 {
        match self.kind {
            EffectKind::DeadTime => dead_time(self.values[0], i),
            _ => 0.0,
        }
    }

    /// Measured angle less the true one [rad].
    pub fn angle_error(&self, theta: f64) -> f64 {
        match self.kind {
            EffectKind::EncoderEccentricity => off_centre(self.values, theta).0,
            _ => 0.0,
        }
    }

    /// Measured speed over the true one, less 1, where the speed is that of the angle's sensor.
    pub fn speed_error(&self, theta: f64) -> f64 {
        match self.law {
            Law::AngleAndSpeed => off_centre(self.values, theta).1,
            _ => 0.0,
        }
    }

    /// Phase within half a turn of zero.
    pub fn wrapped(mut self) -> Self {
        if self.kind.is_periodic() {
            self.values[1] = (self.values[1] + PI).rem_euclid(TAU) - PI;
        }
        self
    }
}
