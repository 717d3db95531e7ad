//! The actuator and its drive, one micro-second a step, in the order of the model's page.

use super::Unit;
use super::effects::Hidden;
use super::shapes::{rect, trap, twelfths};

/// Step of the bench [s]; part of the model.
pub const DT: f64 = 1e-6;
/// Rise of the copper's resistance [1/K].
const COPPER: f64 = 0.00393;
/// Half-width of the smoothed sign of `dead_time` [A].
const DEAD_SMOOTH: f64 = 0.05;
const SIN60: f64 = 0.866_025_403_784_438_6;

/// `x` within plus and minus `limit`. A branch, unlike `clamp`, stays off the step's chain of dependent operations.
#[inline]
fn limited(x: f64, limit: f64) -> f64 {
    if x.abs() <= limit { x } else { beyond(x, limit) }
}

#[cold]
#[inline(never)]
fn beyond(x: f64, limit: f64) -> f64 {
    limit.copysign(x)
}

/// State and constants of one run. The public fields are what a sensor could see, before any noise.
#[derive(Clone, Debug)]
pub struct Plant {
    /// Phase currents [A].
    pub i: [f64; 3],
    /// Phase currents as the drive's sensors give them [A].
    pub i_measured: [f64; 3],
    /// Motor speed [rad/s].
    pub w: f64,
    /// Motor angle [rad].
    pub th: f64,
    /// User angle [rad].
    pub thu: f64,
    /// Phase voltages of the last step [V]: ideal leg voltage minus star point.
    pub v: [f64; 3],
    /// Supply voltage of the last step [V].
    pub v_dc: f64,
    /// Motor torque of the last step [N m].
    pub torque: f64,
    /// Friction torque of the last step [N m].
    pub friction: f64,
    /// Load's speed and angle behind the spring (equal to the motor's without `compliance`).
    pub load: (f64, f64),
    pub(super) s: [f64; 3],
    pub(super) integrator: f64,
    pub(super) bristle: f64,
    queue: Vec<f64>,
    at: usize,
    hidden: Hidden,
    unit: Unit,
    // Derived constants.
    r: [f64; 3],
    inv_l: [f64; 3],
    same_l: bool,
    k0: [f64; 3],
    level: [f64; 2],
    play: f64,
    ecc: Option<(f64, f64)>,
    second_angle: bool,
    torque_terms: bool,
    level_terms: bool,
    inv_ktc: f64,
    inv_gear: f64,
    inv_j: f64,
}

impl Plant {
    /// A unit at rest, with friction multiplier `fsj` and static eccentricity `zeta`.
    pub fn new(unit: &Unit, (fsj, zeta): (f64, f64)) -> Plant {
        let hidden = Hidden::of(&unit.effects);
        let heat = 1.0 + COPPER * hidden.delta_t;
        let fs = fsj * unit.fs0;
        let ecc = (zeta + hidden.ecc.0, hidden.ecc.1);
        let delay = (hidden.delay / DT).round() as usize;
        Plant {
            i: [0.0; 3],
            i_measured: hidden.current_offset,
            w: 0.0,
            th: unit.th0,
            thu: 0.0,
            v: [0.0; 3],
            v_dc: unit.vs,
            torque: 0.0,
            friction: 0.0,
            load: (0.0, unit.th0),
            s: [1.0; 3],
            integrator: 0.0,
            bristle: 0.0,
            queue: vec![0.0; delay],
            at: 0,
            r: hidden.turns.map(|x| x * heat * unit.r),
            inv_l: hidden.turns.map(|x| 1.0 / (x * unit.l)),
            same_l: hidden.turns == [1.0; 3],
            k0: hidden.turns.map(|x| x * unit.ke),
            level: [fs, unit.fd_ratio * fs],
            play: hidden.gap.map_or(unit.b, |gap| 0.5 * gap / unit.gear),
            ecc: (unit.pole_pairs > 1 && ecc != (0.0, 0.0)).then_some(ecc),
            second_angle: hidden.commutation != 0.0 || hidden.encoder.0 != 0.0,
            torque_terms: hidden.quadratic != 0.0
                || hidden.asymmetry != 0.0
                || hidden.bias != 0.0
                || hidden.spring != 0.0
                || !hidden.cogging.is_empty(),
            level_terms: hidden.stribeck.is_some()
                || hidden.lubricated.is_some()
                || hidden.tight.is_some()
                || !hidden.periodic.is_empty(),
            inv_ktc: 1.0 / unit.ktc,
            inv_gear: 1.0 / unit.gear,
            inv_j: 1.0 / unit.j,
            hidden,
            unit: unit.clone(),
        }
    }

    /// The motor angle as the resolver sees it, before quantisation.
    #[inline]
    pub fn measured_angle(&self) -> f64 {
        let (amplitude, phase) = self.hidden.encoder;
        if amplitude == 0.0 {
            self.th
        } else {
            self.th + amplitude * (self.th + phase).sin()
        }
    }

    /// Whether the user position has a sensor of its own at the load.
    pub fn has_user_sensor(&self) -> bool {
        self.hidden.compliance.is_some() || self.hidden.gap.is_some()
    }

    /// Temperature of the winding [deg C].
    pub fn temperature(&self) -> f64 {
        20.0 + self.hidden.delta_t
    }

    /// One step under the command `com`.
    #[inline]
    pub fn step(&mut self, com: f64) {
        let demand = self.current_demand(com);
        let p = f64::from(self.unit.pole_pairs);
        let x = twelfths(p * self.th);
        let k = self.back_emf(x);
        let y = if self.second_angle {
            twelfths(p * self.measured_angle() + self.hidden.commutation)
        } else {
            x
        };
        for (q, y) in y.into_iter().enumerate() {
            let error = rect(y) * demand - self.i_measured[q];
            // Written as a selection: the relays' decisions are too irregular to be predicted as branches.
            let sign = 1.0f64.copysign(error);
            self.s[q] = if error.abs() > self.unit.hb { sign } else { self.s[q] };
        }
        self.windings(k);
        let mut share = [k[0] * self.i[0], k[1] * self.i[1], k[2] * self.i[2]];
        if self.hidden.saturation != 0.0 {
            for (t, i) in share.iter_mut().zip(self.i) {
                *t *= (1.0 - self.hidden.saturation * i.abs()).max(0.0);
            }
        }
        let torque = share[0] + share[1] + share[2];
        self.torque = limited(torque, self.unit.tmax);
        self.mechanics();
        self.user_shaft();
    }

    /// Steps 2 and 3: position and speed loop, up to the current demand that reaches the relays.
    #[inline]
    fn current_demand(&mut self, com: f64) -> f64 {
        let u = &self.unit;
        let reference = limited(u.gap_gain * (com - self.thu), u.wmax);
        let e = reference - self.w;
        let torque = u.kp * e + self.integrator;
        let current = torque * self.inv_ktc;
        if !(current.abs() > u.imax && torque * e >= 0.0) {
            self.integrator = limited(self.integrator + u.ki * e * DT, u.tint);
        }
        let demand = limited(current, u.imax);
        if self.queue.is_empty() {
            return demand;
        }
        let late = std::mem::replace(&mut self.queue[self.at], demand);
        self.at = if self.at + 1 == self.queue.len() {
            0
        } else {
            self.at + 1
        };
        late
    }

    /// Step 4: back-EMF coefficient of each phase.
    #[inline]
    fn back_emf(&self, x: [f64; 3]) -> [f64; 3] {
        let mut k = [0, 1, 2].map(|q| self.k0[q] * trap(x[q]));
        if let Some((ex, ey)) = self.ecc {
            let (sin, cos) = self.th.sin_cos();
            // zeta cos(th + 2 pi q/3 + phase) of the three phases by the addition theorem.
            let (a, b) = (ex * cos - ey * sin, ex * sin + ey * cos);
            k[0] *= 1.0 + a;
            k[1] *= 1.0 - 0.5 * a - SIN60 * b;
            k[2] *= 1.0 - 0.5 * a + SIN60 * b;
        }
        for wave in &self.hidden.ripple {
            let factor = 1.0 + wave.at(self.th);
            k.iter_mut().for_each(|k| *k *= factor);
        }
        k
    }

    /// Step 6: legs, star point, currents.
    #[inline]
    fn windings(&mut self, k: [f64; 3]) {
        let h = &self.hidden;
        self.v_dc = self.unit.vs;
        if h.source != 0.0 {
            // The legs that are switched up draw the supply's current.
            let dc: f64 = (0..3).map(|q| if self.s[q] > 0.0 { self.i[q] } else { 0.0 }).sum();
            self.v_dc = (self.unit.vs - h.source * dc.abs()).max(0.0);
        }
        let half = 0.5 * self.v_dc;
        let leg = self.s.map(|s| s * half);
        let drop = [0, 1, 2].map(|q| {
            let ohmic = k[q] * self.w + self.r[q] * self.i[q];
            if h.dead == 0.0 {
                ohmic
            } else {
                ohmic + h.dead * (self.i[q] / DEAD_SMOOTH).clamp(-1.0, 1.0)
            }
        });
        let net = [leg[0] - drop[0], leg[1] - drop[1], leg[2] - drop[2]];
        let star = if self.same_l {
            (net[0] + net[1] + net[2]) * (1.0 / 3.0)
        } else {
            // The currents must go on adding up to zero.
            let l = self.inv_l;
            (net[0] * l[0] + net[1] * l[1] + net[2] * l[2]) / (l[0] + l[1] + l[2])
        };
        for q in 0..3 {
            self.i[q] += DT * self.inv_l[q] * (net[q] - star);
            self.i_measured[q] = h.current_gain * self.i[q] + h.current_offset[q];
            self.v[q] = leg[q] - star;
        }
    }

    /// Mechanical effects that act as a load [N m].
    #[inline]
    fn load_torque(&self) -> f64 {
        let h = &self.hidden;
        let w = self.w;
        let mut m = h.bias + h.quadratic * w * w.abs() + h.asymmetry * w.abs();
        m += h.spring * (self.th - self.unit.th0);
        for wave in &h.cogging {
            m += wave.at(self.th);
        }
        m
    }

    /// Static and dynamic friction level at the present speed and angle [N m].
    #[inline]
    fn friction_levels(&self) -> [f64; 2] {
        let h = &self.hidden;
        let speed = self.w.abs();
        let [mut fs, mut fd] = self.level;
        if let Some((torque, ws, exponent)) = h.stribeck {
            let ratio = speed / ws;
            // Beyond 30 the exponential is below 1e-13 of the torque; the power is skipped where it must be larger.
            if ratio < 30.0 {
                fd += torque * (-(exponent * ratio.ln()).exp()).exp();
            }
        }
        if let Some((torque, w0)) = h.lubricated {
            fd += torque * (1.0 - (-speed / w0).exp());
        }
        let mut both = 0.0;
        if let Some((torque, centre, width)) = h.tight {
            let d = (self.th - centre) / width;
            both += torque * (-d * d).exp();
        }
        for wave in &h.periodic {
            both += wave.at(self.th);
        }
        fd = (fd + both).max(0.0);
        fs = (fs + both).max(0.0);
        [if speed == 0.0 { fs.max(fd) } else { fs }, fd]
    }

    /// Step 8: friction and the motor's motion, and the load's where it has its own.
    #[inline]
    fn mechanics(&mut self) {
        let w = self.w;
        let mut a = self.torque - self.unit.c * w;
        if self.torque_terms {
            a -= self.load_torque();
        }
        if let Some(spring) = self.hidden.compliance {
            let t = spring.stiffness * (self.th - self.load.1) + spring.damping * (w - self.load.0);
            a -= t;
            self.load.0 += DT / spring.inertia * t;
            self.load.1 += self.load.0 * DT;
        }
        let [fs, fd] = if self.level_terms {
            self.friction_levels()
        } else {
            self.level
        };
        if let Some(bristle) = self.hidden.presliding {
            // Dahl: the bristle's torque tends to the dynamic level; there is no standstill by decree.
            let rate = w - w.abs() * bristle.stiffness * self.bristle / fd.max(1e-9);
            self.friction = bristle.stiffness * self.bristle + bristle.damping * rate;
            self.bristle += rate * DT;
            self.w = w + DT * self.inv_j * (a - self.friction);
        } else {
            self.friction = if w != 0.0 {
                fd.copysign(w)
            } else if a.abs() <= fs {
                a
            } else {
                fd.copysign(a)
            };
            let next = w + DT * self.inv_j * (a - self.friction);
            self.w = if w * next < 0.0 { 0.0 } else { next };
        }
        self.th += self.w * DT;
        if self.hidden.compliance.is_none() {
            self.load = (self.w, self.th);
        }
    }

    /// Step 9: end stops and play.
    #[inline]
    fn user_shaft(&mut self) {
        let stop = self.unit.stop;
        let mut u = (self.load.1 - self.unit.th0) * self.inv_gear;
        if u.abs() > stop {
            u = stop.copysign(u);
            self.load.1 = u * self.unit.gear + self.unit.th0;
            if self.load.0 * u > 0.0 {
                self.load.0 = 0.0;
            }
            if self.hidden.compliance.is_none() {
                (self.w, self.th) = self.load;
            }
        }
        if u - self.thu > self.play {
            self.thu = u - self.play;
        } else if u - self.thu < -self.play {
            self.thu = u + self.play;
        }
    }
}

#[cfg(test)]
impl Plant {
    /// Puts the plant into a state, for tests.
    pub(super) fn set(&mut self, i: [f64; 3], w: f64, th: f64) {
        (self.i, self.i_measured, self.w, self.th, self.load) = (i, i, w, th, (w, th));
    }

    /// Resistance, inductance and back-EMF coefficients at the present angle, for tests.
    pub(super) fn winding(&self) -> ([f64; 3], [f64; 3], [f64; 3]) {
        let k = self.back_emf(twelfths(f64::from(self.unit.pole_pairs) * self.th));
        (self.r, self.inv_l.map(|x| 1.0 / x), k)
    }
}
