//! The simplified model (paper 3.2): one equivalent phase, sign control, the same mechanics,
//! nominal condition only.
//!
//! The set-valued signs of Eq. 9 (voltage) and of dry friction are discretised implicitly (Acary
//! and Brogliato, Numerical Methods for Nonsmooth Dynamical Systems, 2008): the voltage of a step
//! is the one that brings the current onto its reference at the step's end, or the nearest
//! supply voltage; the friction torque is the one that brings the speed to zero, or the nearest
//! of plus and minus FD. Sliding is then exact and without chatter, and the step may be far
//! longer than a switching period.

mod with_effects;

use crate::command::CommandTrack;
use crate::control;
use crate::effect::{Effect, EffectKind};
use crate::parameters::ActuatorParameters;
use crate::plant::{backlash, end_stop};
use schemas::sequence::TestSequence;
use with_effects::Effects;

/// Longest step of the model [s].
pub const STEP_S: f64 = 100e-6;

fn limit(x: f64, low: f64, high: f64) -> f64 {
    control::limit::<false>(x, low, high)
}

/// The simplified model as a state machine; everything that does not change is worked out once.
#[derive(Clone, Debug)]
pub struct MonitorModel {
    dt: f64,
    gap: f64,
    w_max: f64,
    /// `Kp / kt`
    kp_kt: f64,
    i_max: f64,
    t_max: f64,
    kt: f64,
    /// `J/dt`, `1/(J/dt + C)`, `1/(1 + (Kp/kt) kt/(J/dt + C))`
    j_dt: f64,
    inv_inertia: f64,
    inv_loop: f64,
    /// `(L/dt)/(L/dt + R)`, `kt/(L/dt + R)`, `Vs/(L/dt + R)`
    keep: f64,
    emf: f64,
    reach: f64,
    fs: f64,
    fd: f64,
    n: f64,
    stop: f64,
    b: f64,
    effects: Option<Box<Effects>>,
    /// motor current [A], as measured where effects tell the two apart
    pub i: f64,
    /// motor speed [rad/s]
    pub w: f64,
    /// motor angle from rest [rad]
    pub th: f64,
    /// user angle times the gear ratio [rad]
    th_u: f64,
    /// motor torque [N m]
    pub torque: f64,
}

impl MonitorModel {
    /// * `dt` step [s]
    pub fn new(p: &ActuatorParameters, dt: f64) -> Self {
        let kt = p.torque_constant_n_m_per_a();
        let kp_kt = p.speed_proportional_n_m_s_per_rad / p.drive_constant();
        let j_dt = p.inertia_kg_m2 / dt;
        let inv_inertia = 1.0 / (j_dt + p.viscous_n_m_s_per_rad);
        // two phases in series
        let l_dt = 2.0 * p.phase_inductance_h / dt;
        // the effects that are constants; multiplying by 1 and adding 0 changes no bit
        let present = || p.effects.iter().filter(|e| e.is_present());
        let heat: f64 = present().map(Effect::resistance_factor).product();
        let gaps = present().filter(|e| e.kind == EffectKind::Backlash);
        let impedance = l_dt + 2.0 * p.phase_resistance_ohm * heat;
        Self {
            dt,
            gap: p.position_gain_per_s / p.gear_ratio,
            w_max: p.speed_reference_limit_rad_per_s,
            kp_kt,
            i_max: p.current_limit_a,
            t_max: p.torque_limit_n_m,
            kt,
            j_dt,
            inv_inertia,
            inv_loop: 1.0 / (1.0 + kp_kt * kt * inv_inertia),
            keep: l_dt / impedance,
            emf: kt / impedance,
            reach: p.supply_voltage_v / impedance,
            fs: p.static_friction_n_m,
            fd: p.static_friction_n_m * p.dynamic_friction_ratio,
            n: p.gear_ratio,
            stop: p.end_stop_rad * p.gear_ratio,
            b: gaps.fold(p.backlash_half_width_rad * p.gear_ratio, |b, e| b + 0.5 * e.values[0]),
            effects: Effects::new(p, dt, impedance).map(Box::new),
            i: 0.0,
            w: 0.0,
            th: 0.0,
            th_u: 0.0,
            torque: 0.0,
        }
    }

    /// The same with the rotor at rest at the angle `rest` [rad], which only effects feel.
    pub fn at_rest_angle(mut self, rest: f64) -> Self {
        if let Some(e) = &mut self.effects {
            e.rest_at(rest);
        }
        self
    }

    /// Measured motor angle from rest [rad].
    pub fn motor_angle_rad(&self) -> f64 {
        self.effects
            .as_ref()
            .map_or(self.th, |e| self.th + e.angle_error(self.th))
    }

    /// User angle [rad].
    pub fn user_angle_rad(&self) -> f64 {
        self.th_u / self.n
    }

    /// One step under the command `com` [rad].
    #[inline]
    pub fn step(&mut self, com: f64) {
        if self.effects.is_some() {
            self.step_with_effects(com);
        } else {
            self.step_without_effects(com);
        }
    }

    /// Steps through `com`; sums of |current| and torque. The choice stands outside of the loop,
    /// so that a model without effects lives in registers.
    fn steps(&mut self, com: &[f64]) -> (f64, f64) {
        let mut sums = (0.0, 0.0);
        let mut add = |m: &Self| sums = (sums.0 + m.i.abs(), sums.1 + m.torque);
        if self.effects.is_some() {
            for &c in com {
                self.step_with_effects(c);
                add(self);
            }
        } else {
            for &c in com {
                self.step_without_effects(c);
                add(self);
            }
        }
        sums
    }

    #[inline(always)]
    fn step_without_effects(&mut self, com: f64) {
        let w_ref = limit(self.gap * (com * self.n - self.th_u), -self.w_max, self.w_max);
        // currents at the step's end within reach of +-Vs (Eq. 9, 10; back-EMF of the step's start)
        let free = self.keep * self.i - self.emf * self.w;
        let low = free - self.reach;
        let high = free + self.reach;
        let reachable = |i: f64| limit(limit(i, -self.i_max, self.i_max), low, high);
        let saturated = |i: f64| limit(self.kt * i, -self.t_max, self.t_max);
        let direction = if self.w != 0.0 {
            1f64.copysign(self.w)
        } else {
            // what the standing rotor feels
            let torque = saturated(reachable(self.kp_kt * w_ref));
            if torque.abs() <= self.fs {
                0.0
            } else {
                1f64.copysign(torque)
            }
        };
        let mut w = 0.0;
        let mut i = 0.0;
        if direction != 0.0 {
            // (J/dt + C) w' = J/dt w + kt i' - FD sign, i' = Kp/kt (w_ref - w') where it is free
            let driven = self.j_dt * self.w - self.fd * direction;
            i = reachable(self.kp_kt * (w_ref - driven * self.inv_inertia) * self.inv_loop);
            w = (driven + saturated(i)) * self.inv_inertia;
        }
        if direction == 0.0 || w * direction < 0.0 {
            // friction holds the rotor: it takes up the rest of the momentum and no more
            w = 0.0;
            i = reachable(self.kp_kt * w_ref);
        }
        self.i = i;
        self.torque = saturated(i);
        self.th += w * self.dt;
        (self.th, self.w) = end_stop::stop(self.th, w, self.stop);
        self.th_u = backlash::play::<false>(self.th_u, self.th, self.b);
    }
}

/// The simplified model's answer to a sequence, sampled like telemetry: positions, speed at the
/// interval's end, |current| and torque as means over the interval.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct MonitorTrack {
    /// commanded user position [rad]
    pub com_rad: Vec<f64>,
    /// user position behind the backlash [rad]
    pub theta_u_rad: Vec<f64>,
    /// motor angle from rest [rad]
    pub theta_m_rad: Vec<f64>,
    /// motor speed [rad/s]
    pub omega_rad_per_s: Vec<f64>,
    /// mean of |Im| [A]
    pub abs_current_a: Vec<f64>,
    /// mean of the motor torque [N m]
    pub torque_n_m: Vec<f64>,
}

impl MonitorTrack {
    /// * `rate_hz` telemetry rate; the model makes a whole number of steps of at most [`STEP_S`]
    ///   in each interval
    pub fn run(p: &ActuatorParameters, sequence: &TestSequence, rate_hz: f64) -> Self {
        Self::run_at(p, sequence, rate_hz, 0.0)
    }

    /// As [`MonitorTrack::run`] with the rotor at rest at the angle `rest` [rad].
    pub fn run_at(p: &ActuatorParameters, sequence: &TestSequence, rate_hz: f64, rest: f64) -> Self {
        let rows = (sequence.duration_s() * rate_hz + 1e-6).floor() as usize;
        let steps = (1.0 / (rate_hz * STEP_S) - 1e-9).ceil().max(1.0) as usize;
        let dt = 1.0 / (rate_hz * steps as f64);
        let track = CommandTrack::new(sequence, dt);
        let mut com = vec![0.0; rows * steps];
        track.fill(0, &mut com);
        let mut m = MonitorModel::new(p, dt).at_rest_angle(rest);
        let mut out = Self::default();
        for interval in com.chunks(steps) {
            let (abs, torque) = m.steps(interval);
            out.com_rad.push(interval[steps - 1]);
            out.theta_u_rad.push(m.user_angle_rad());
            out.theta_m_rad.push(m.motor_angle_rad());
            out.omega_rad_per_s.push(m.w);
            out.abs_current_a.push(abs / steps as f64);
            out.torque_n_m.push(torque / steps as f64);
        }
        out
    }
}
