//! The simplified model (paper 3.2): one equivalent phase, sign control, the same mechanics,
//! nominal condition only.
//!
//! The set-valued signs of Eq. 9 (voltage) and of dry friction are discretised implicitly (Acary
//! and Brogliato, Numerical Methods for Nonsmooth Dynamical Systems, 2008): the voltage of a step
//! is the one that brings the current onto its reference at the step's end, or the nearest
//! supply voltage; the friction torque is the one that brings the speed to zero, or the nearest
//! of plus and minus FD. Sliding is then exact and without chatter, and the step may be far
//! longer than a switching period.

use crate::command::CommandTrack;
use crate::parameters::ActuatorParameters;
use crate::plant::backlash;
use schemas::sequence::TestSequence;

/// Longest step of the model [s].
pub const STEP_S: f64 = 50e-6;

/// The simplified model as a state machine.
#[derive(Clone, Debug)]
pub struct MonitorModel {
    dt: f64,
    gap: f64,
    w_max: f64,
    kp_kt: f64,
    i_max: f64,
    t_max: f64,
    kt: f64,
    r: f64,
    l: f64,
    vs: f64,
    j: f64,
    c: f64,
    fs: f64,
    fd: f64,
    inv_n: f64,
    stop: f64,
    b: f64,
    /// motor current [A]
    pub i: f64,
    /// motor speed [rad/s]
    pub w: f64,
    /// motor angle from rest [rad]
    pub th: f64,
    /// user angle [rad]
    pub th_u: f64,
    /// motor torque [N m]
    pub torque: f64,
}

impl MonitorModel {
    /// * `dt` step [s]
    pub fn new(p: &ActuatorParameters, dt: f64) -> Self {
        let kt = p.torque_constant_n_m_per_a();
        Self {
            dt,
            gap: p.position_gain_per_s,
            w_max: p.speed_reference_limit_rad_per_s,
            kp_kt: p.speed_proportional_n_m_s_per_rad / kt,
            i_max: p.current_limit_a,
            t_max: p.torque_limit_n_m,
            kt,
            r: 2.0 * p.phase_resistance_ohm,
            l: 2.0 * p.phase_inductance_h,
            vs: p.supply_voltage_v,
            j: p.inertia_kg_m2,
            c: p.viscous_n_m_s_per_rad,
            fs: p.static_friction_n_m,
            fd: p.static_friction_n_m * p.dynamic_friction_ratio,
            inv_n: 1.0 / p.gear_ratio,
            stop: p.end_stop_rad * p.gear_ratio,
            b: p.backlash_half_width_rad,
            i: 0.0,
            w: 0.0,
            th: 0.0,
            th_u: 0.0,
            torque: 0.0,
        }
    }

    /// One step under the command `com` [rad].
    #[inline]
    pub fn step(&mut self, com: f64) {
        let dt = self.dt;
        let w_ref = (self.gap * (com - self.th_u)).clamp(-self.w_max, self.w_max);
        // speed at the step's end as a function of the current at the step's end, friction apart:
        // (J/dt + C) w' = J/dt w + kt i'
        let inertia = self.j / dt + self.c;
        let momentum = self.j / dt * self.w;
        // current at the step's end within reach of +-Vs (Eq. 9, 10, back-EMF of the step's start)
        let impedance = self.l / dt + self.r;
        let free = self.l / dt * self.i - self.kt * self.w;
        let (i_lo, i_hi) = ((free - self.vs) / impedance, (free + self.vs) / impedance);
        // reference at the step's end: i = Kp/kt (w_ref - w'), both unknown; friction as found below
        let solve = |friction: f64| {
            let i = self.kp_kt * (w_ref * inertia - momentum + friction) / (inertia + self.kp_kt * self.kt);
            let i = i.clamp(-self.i_max, self.i_max);
            let i = i.clamp(i_lo, i_hi);
            let torque = (self.kt * i).clamp(-self.t_max, self.t_max);
            (i, torque, (momentum + torque - friction) / inertia)
        };
        let (mut i, mut torque, mut w) = (0.0, 0.0, 0.0);
        let direction = if self.w != 0.0 {
            self.w.signum()
        } else {
            // the current that holds the standing rotor
            let hold = (self.kp_kt * w_ref).clamp(-self.i_max, self.i_max).clamp(i_lo, i_hi);
            torque = (self.kt * hold).clamp(-self.t_max, self.t_max);
            i = hold;
            if torque.abs() <= self.fs { 0.0 } else { torque.signum() }
        };
        if direction != 0.0 {
            (i, torque, w) = solve(self.fd * direction);
            if w * direction < 0.0 {
                // friction takes up the rest of the momentum and no more
                w = 0.0;
                i = (self.kp_kt * w_ref).clamp(-self.i_max, self.i_max).clamp(i_lo, i_hi);
                torque = (self.kt * i).clamp(-self.t_max, self.t_max);
            }
        }
        self.i = i;
        self.torque = torque;
        self.w = w;
        self.th += w * dt;
        if self.th.abs() > self.stop {
            self.th = self.stop.copysign(self.th);
            if self.w * self.th > 0.0 {
                self.w = 0.0;
            }
        }
        self.th_u = backlash::play::<false>(self.th_u, self.th * self.inv_n, self.b);
    }
}

/// The simplified model's answer to a sequence, sampled like telemetry: positions, speed at the
/// interval's end, |current| and torque as means over the interval.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct MonitorTrack {
    pub com_rad: Vec<f64>,
    pub theta_u_rad: Vec<f64>,
    /// from rest
    pub theta_m_rad: Vec<f64>,
    pub omega_rad_per_s: Vec<f64>,
    pub abs_current_a: Vec<f64>,
    pub torque_n_m: Vec<f64>,
}

impl MonitorTrack {
    /// * `rate_hz` telemetry rate; the model makes a whole number of steps of at most [`STEP_S`]
    ///   in each interval
    pub fn run(p: &ActuatorParameters, sequence: &TestSequence, rate_hz: f64) -> Self {
        let rows = (sequence.duration_s() * rate_hz + 1e-6).floor() as usize;
        let steps = (1.0 / (rate_hz * STEP_S) - 1e-9).ceil().max(1.0) as usize;
        let dt = 1.0 / (rate_hz * steps as f64);
        let track = CommandTrack::new(sequence, dt);
        let mut com = vec![0.0; rows * steps];
        track.fill(0, &mut com);
        let mut m = MonitorModel::new(p, dt);
        let mut out = Self::default();
        for interval in com.chunks(steps) {
            let (mut abs, mut torque) = (0.0, 0.0);
            for &c in interval {
                m.step(c);
                abs += m.i.abs();
                torque += m.torque;
            }
            out.com_rad.push(interval[steps - 1]);
            out.theta_u_rad.push(m.th_u);
            out.theta_m_rad.push(m.th);
            out.omega_rad_per_s.push(m.w);
            out.abs_current_a.push(abs / steps as f64);
            out.torque_n_m.push(torque / steps as f64);
        }
        out
    }
}
