//! The step of the simplified model with effects. Friction levels and torques are those of the
//! step's start; what answers to the speed itself (bristles, a mass behind a spring) enters the
//! implicit step by its slope.

use super::{MonitorModel, limit};
use crate::effect::{Injection, Law, Signals};
use crate::parameters::ActuatorParameters;
use crate::plant::{backlash, end_stop};

#[derive(Clone, Debug)]
pub(super) struct Effects {
    injection: Injection,
    supply_voltage_v: f64,
    viscous: f64,
    /// `(J - J behind the spring)/dt`
    j_dt: f64,
    /// `L/dt + R` and `L/dt` of two phases in series
    impedance: f64,
    l_dt: f64,
    /// true motor current [A], its derivative [A/s]
    i: f64,
    rate: f64,
    /// supply current of the last step [A]
    supply: f64,
}

impl Effects {
    pub(super) fn new(p: &ActuatorParameters, dt: f64, impedance: f64) -> Option<Self> {
        let injection = Injection::new(p, 1.0, 0.0, 0.0, dt)?;
        let behind = injection.behind.as_ref().map_or(0.0, |b| b.inertia);
        Some(Self {
            supply_voltage_v: p.supply_voltage_v,
            viscous: p.viscous_n_m_s_per_rad,
            j_dt: (p.inertia_kg_m2 - behind) / dt,
            impedance,
            l_dt: 2.0 * p.phase_inductance_h / dt,
            i: 0.0,
            rate: 0.0,
            supply: 0.0,
            injection,
        })
    }

    pub(super) fn rest_at(&mut self, rest: f64) {
        self.injection.signals.rest = rest;
    }

    /// Measured less true angle [rad] at `th` from rest.
    pub(super) fn angle_error(&self, th: f64) -> f64 {
        self.injection.angle_error(self.injection.signals.rest + th)
    }
}

impl MonitorModel {
    /// [`MonitorModel::step`] where there are effects.
    #[cold]
    #[inline(never)]
    pub(super) fn step_with_effects(&mut self, com: f64) {
        let Some(x) = &mut self.effects else { return };
        let e = &mut x.injection;
        let dt = self.dt;
        let s = Signals {
            theta: e.signals.rest + self.th,
            omega: self.w,
            current: x.i,
            current_rate: x.rate,
            ..e.signals
        };
        let w_ref = limit(self.gap * (com * self.n - self.th_u), -self.w_max, self.w_max);
        // voltage
        let share = 1.0 + e.constant_share(&s);
        let emf = self.kt * share * e.flux(x.i) * self.w + e.voltage(&s);
        let volts = (x.supply_voltage_v - e.source * x.supply).max(0.0);
        let free = (x.l_dt * x.i - emf) / x.impedance;
        let (low, high) = (free - volts / x.impedance, free + volts / x.impedance);
        let (gain, offset, i_max) = (e.gain, e.offset, self.i_max);
        let reachable = |measured: f64| limit((limit(measured, -i_max, i_max) - offset) / gain, low, high);
        // what the loop takes for the speed, over the speed
        let seen = e.seen_speed(s.theta);
        let late = e
            .delay
            .as_mut()
            .map(|line| line.step(self.kp_kt * (w_ref - seen * self.w)));
        // torque
        let kt = self.kt * share * e.saturation(x.i);
        let t_max = self.t_max;
        let saturated = |i: f64| limit(kt * i, -t_max, t_max);
        let friction = e.friction(&s);
        let (fs, fd) = ((self.fs + friction).max(0.0), (self.fd + friction).max(0.0));
        let mut against = e.torque(&s);
        let mut slope = 0.0;
        if let Some(b) = &e.behind {
            against += b.torque(self.th, 0.0, dt);
            slope += b.slope(dt);
        }
        let standing = reachable(late.unwrap_or(self.kp_kt * w_ref));
        let push = saturated(standing) - against;
        let dry = e.bristles.is_none();
        let direction = if self.w != 0.0 {
            1f64.copysign(self.w)
        } else if dry && push.abs() <= fs {
            0.0
        } else {
            1f64.copysign(push)
        };
        if let Some(b) = &mut e.bristles {
            b.slide_at(self.fd, friction, self.w);
            let (at_rest, more) = b.linear(direction, dt);
            against += at_rest;
            slope += more;
        } else {
            against += fd * direction;
        }
        let mut w = 0.0;
        let mut i = standing;
        if direction != 0.0 {
            // as without effects, with what is measured in place of the current
            let inverse = 1.0 / (x.j_dt + x.viscous + slope);
            let driven = x.j_dt * self.w - against;
            let inv_loop = 1.0 / (1.0 + self.kp_kt * seen * kt * inverse / gain);
            let at_once = self.kp_kt * (w_ref - seen * (driven - kt * offset / gain) * inverse) * inv_loop;
            i = reachable(late.unwrap_or(at_once));
            w = (driven + saturated(i)) * inverse;
            if dry && w * direction < 0.0 {
                w = 0.0;
                i = standing;
            }
        }
        if let Some(b) = &mut e.bristles {
            b.step(w, dt);
        }
        // what the source gave: by the share of the time that the legs push, or all the time by the size
        let v = x.impedance * i - x.l_dt * x.i + emf;
        x.supply = match e.draw {
            _ if volts <= 0.0 => 0.0,
            Law::Legs => i.abs(),
            _ => v / volts * i,
        };
        x.rate = (i - x.i) / dt;
        x.i = i;
        self.i = gain * i + offset;
        self.torque = saturated(i);
        let before = self.th;
        self.th += w * dt;
        (self.th, self.w) = end_stop::stop(self.th, w, self.stop);
        let user = match &mut e.behind {
            Some(b) => b.step(before, (self.th - before) / dt, dt).1,
            None => self.th,
        };
        self.th_u = backlash::play::<false>(self.th_u, user, self.b);
    }
}
