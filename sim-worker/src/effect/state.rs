//! Effects with a state of their own: the same small machines stand in the test bench, in the
//! simplified model and, driven by a measured motion, in the discrepancy study.

use super::{Constants, Effect, Law};
use crate::exponential::exp;
use crate::plant::backlash;

/// Speed below which bristles that break away at the static friction slide at it, too [rad/s] (assumed; that of LuGre's
/// `exp(-(w/speed)^2)`).
pub const BREAK_AWAY_RAD_S: f64 = 2.0;

/// Friction of bristles that bend before they slide: Dahl, A solid friction model, Aerospace
/// Corporation TOR-0158 (1968), exponent 1, with the damping of Canudas de Wit, Olsson, Astrom and
/// Lischinsky, IEEE Trans. Automatic Control 40 (1995):
///
/// `dz/dt = w (1 - sgn(w) z/z_max)`, `z_max = level/stiffness`, `F = stiffness z + damping dz/dt`.
///
/// The bend keeps within plus and minus `z_max`; the damping comes on top of it, so that after a
/// reversal of soft bristles the friction may exceed `level`, as the sources have it.
#[derive(Clone, Debug)]
pub struct Dahl {
    /// [N m/rad]
    pub stiffness: f64,
    /// [N m s/rad]
    pub damping: f64,
    /// friction of full sliding [N m], at least 0; may change from step to step
    pub level: f64,
    /// bend of the bristles [rad]
    pub z: f64,
    /// static over dynamic friction; 1 where they slide at the dynamic one at every speed
    pub break_away: f64,
}

impl Dahl {
    /// Bristles that are not bent.
    pub fn new(stiffness: f64, damping: f64, level: f64) -> Self {
        Self {
            stiffness,
            damping,
            level,
            z: 0.0,
            break_away: 1.0,
        }
    }

    /// Dynamic friction that bristles slide at, over that of fast motion, at the speed `omega` [rad/s].
    pub fn rise(break_away: f64, omega: f64) -> f64 {
        if break_away == 1.0 {
            return 1.0;
        }
        let of_speed = omega / BREAK_AWAY_RAD_S;
        let square = of_speed * of_speed;
        // exp(-40) is nothing beside 1
        if square > 40.0 {
            return 1.0;
        }
        1.0 + (break_away - 1.0) * exp(-square)
    }

    /// Another level: of the dynamic friction and of what effects add to it [N m], at the speed `omega` [rad/s].
    pub fn slide_at(&mut self, dynamic: f64, further: f64, omega: f64) {
        self.level = (dynamic * Self::rise(self.break_away, omega) + further).max(0.0);
    }

    /// The bend within what the present level allows.
    fn bend(&self) -> f64 {
        let most = self.level / self.stiffness;
        self.z.clamp(-most, most)
    }

    /// Friction torque [N m] after `dt` [s] at the constant speed `omega` [rad/s], for which the
    /// step is exact: the bend nears plus or minus `z_max` exponentially.
    pub fn step(&mut self, omega: f64, dt: f64) -> f64 {
        let most = self.level / self.stiffness;
        let z = self.bend();
        if most == 0.0 || omega == 0.0 {
            self.z = z;
            return self.stiffness * z;
        }
        let end = most.copysign(omega);
        // -expm1 keeps the small bends of small steps
        self.z = z + (end - z) * -(-(omega * dt).abs() / most).exp_m1();
        let rate = omega * (1.0 - self.z / end);
        self.stiffness * self.z + self.damping * rate
    }

    /// Friction at rest [N m] and its slope [N m s/rad] over a speed of the sign of `direction`
    /// that lasts for `dt`: what an implicit step needs.
    pub fn linear(&self, direction: f64, dt: f64) -> (f64, f64) {
        let z = self.bend();
        if self.level == 0.0 {
            return (0.0, 0.0);
        }
        let left = 1.0 - z * self.stiffness / self.level.copysign(direction);
        (self.stiffness * z, (self.stiffness * dt + self.damping) * left)
    }
}

impl Effect {
    /// Bristles of `presliding`, not bent, on the dry friction of an actuator.
    pub fn bristles(&self, c: &Constants) -> Dahl {
        Dahl {
            break_away: if self.law == Law::BreakAway { c.break_away } else { 1.0 },
            ..Dahl::new(self.values[0], self.values[1], c.coulomb)
        }
    }
}

/// Play between motor and user.
#[derive(Clone, Debug)]
pub struct Play {
    /// half of the gap [rad]
    pub half: f64,
    /// angle behind the play [rad]
    pub angle: f64,
}

impl Play {
    /// * `gap` full width [rad]
    /// * `angle` behind the play at the start [rad]
    pub fn new(gap: f64, angle: f64) -> Self {
        Self { half: 0.5 * gap, angle }
    }

    /// Angle behind the play [rad] when the one before it is `theta`.
    pub fn step(&mut self, theta: f64) -> f64 {
        self.angle = backlash::play::<false>(self.angle, theta, self.half);
        self.angle
    }
}

/// A mass behind a spring and a damper:
/// `inertia dw/dt = stiffness (theta_m - theta) + damping (w_m - w)`.
#[derive(Clone, Debug)]
pub struct TwoMass {
    /// [N m/rad]
    pub stiffness: f64,
    /// [N m s/rad]
    pub damping: f64,
    /// of the mass behind the spring [kg m2]
    pub inertia: f64,
    /// its angle [rad]
    pub angle: f64,
    /// its speed [rad/s]
    pub speed: f64,
}

impl TwoMass {
    /// At rest at the angle `angle`.
    pub fn new(stiffness: f64, damping: f64, inertia: f64, angle: f64) -> Self {
        Self {
            stiffness,
            damping,
            inertia,
            angle,
            speed: 0.0,
        }
    }

    /// Change of speed in a step by the midpoint rule: stable for every step, and a spring without
    /// damper keeps its energy.
    fn change(&self, theta_m: f64, omega_m: f64, dt: f64) -> f64 {
        let stretch = theta_m - self.angle + 0.5 * dt * (omega_m - self.speed);
        (self.stiffness * stretch + self.damping * (omega_m - self.speed)) / self.impedance(dt)
    }

    fn impedance(&self, dt: f64) -> f64 {
        self.inertia / dt + 0.25 * self.stiffness * dt + 0.5 * self.damping
    }

    /// Mean torque on the shaft [N m] over a step which begins at the motor angle `theta_m` [rad]
    /// with the constant speed `omega_m` [rad/s]; the state stays.
    pub fn torque(&self, theta_m: f64, omega_m: f64, dt: f64) -> f64 {
        self.inertia / dt * self.change(theta_m, omega_m, dt)
    }

    /// Slope of [`TwoMass::torque`] over the motor's speed [N m s/rad].
    pub fn slope(&self, dt: f64) -> f64 {
        self.inertia / dt * (0.5 * self.stiffness * dt + self.damping) / self.impedance(dt)
    }

    /// Makes that step; returns the mean torque on the shaft [N m], angle [rad] and speed [rad/s]
    /// of the mass at its end.
    pub fn step(&mut self, theta_m: f64, omega_m: f64, dt: f64) -> (f64, f64, f64) {
        let change = self.change(theta_m, omega_m, dt);
        self.angle += dt * (self.speed + 0.5 * change);
        self.speed += change;
        (self.inertia / dt * change, self.angle, self.speed)
    }
}

/// What went in comes out `delay` later; before that 0.
#[derive(Clone, Debug)]
pub struct DelayLine {
    ring: Vec<f64>,
    at: usize,
    /// share of the older of the two values between which the delay falls
    share: f64,
}

impl DelayLine {
    /// * `delay` and `dt` [s]
    pub fn new(delay: f64, dt: f64) -> Self {
        let steps = delay / dt;
        let nearest = steps.round();
        // a whole number of steps but for rounding
        let steps = if (steps - nearest).abs() < 1e-6 { nearest } else { steps };
        Self {
            ring: vec![0.0; steps.floor() as usize + 2],
            at: 0,
            share: steps.fract(),
        }
    }

    /// Shows every number that the line remembers to `see`, which may change it.
    pub fn each(&mut self, see: &mut dyn FnMut(&mut f64)) {
        self.ring.iter_mut().for_each(&mut *see);
        let mut at = self.at as f64;
        see(&mut at);
        self.at = (at as usize).min(self.ring.len() - 1);
    }

    /// Takes the value of this step, gives the delayed one.
    #[inline]
    pub fn step(&mut self, x: f64) -> f64 {
        self.ring[self.at] = x;
        self.at = if self.at + 1 == self.ring.len() { 0 } else { self.at + 1 };
        // `at` is now the oldest, the next one younger by a step
        let older = self.ring[self.at];
        let younger = self.ring[if self.at + 1 == self.ring.len() { 0 } else { self.at + 1 }];
        if self.share == 0.0 {
            younger
        } else {
            younger + self.share * (older - younger)
        }
    }
}
