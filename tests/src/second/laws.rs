//! The physical laws of a drive, its hidden effects among them. Everything on the motor's side.

/// Amplitude, phase and order of a law A cos(n theta + phi).
#[derive(Clone, Copy, Debug, Default)]
pub struct Wave {
    /// Amplitude.
    pub a: f64,
    /// Phase.
    pub phi: f64,
    /// Order per revolution of the motor.
    pub n: f64,
    /// Share of the second harmonic, where the law is not a pure cosine.
    pub second: f64,
}

impl Wave {
    /// Value at an angle.
    pub fn at(&self, th: f64) -> f64 {
        if self.a == 0.0 {
            return 0.0;
        }
        let x = self.n * th + self.phi;
        self.a
            * (x.cos()
                + if self.second != 0.0 {
                    self.second * (2.0 * x + 0.7).cos()
                } else {
                    0.0
                })
    }
}

/// Two masses: the part of the inertia behind a spring or a gap.
#[derive(Clone, Copy, Debug, Default)]
pub struct TwoMass {
    /// Stiffness.
    pub k: f64,
    /// Damping.
    pub d: f64,
    /// Inertia behind it; 0: no second mass.
    pub jl: f64,
    /// Total play; 0: none.
    pub gap: f64,
    /// Cubic hardening: k (1 + h delta^2).
    pub hardening: f64,
    /// Width over which the edges of the play are rounded.
    pub rounding: f64,
    /// Coulomb friction and viscous friction behind it.
    pub tcl: f64,
    /// Viscous friction behind it.
    pub cl: f64,
    /// Speed within which the friction behind it is smoothed.
    pub eps: f64,
}

impl TwoMass {
    /// Torque through the shaft from the motor to the load for twist `x` and rate of twist `dx`.
    pub fn torque(&self, x: f64, dx: f64) -> f64 {
        if self.gap > 0.0 {
            let half = 0.5 * self.gap;
            if self.rounding > 0.0 {
                // smooth dead zone; the damping fades in with the contact
                let soft = |y: f64| {
                    let z = y / self.rounding;
                    if z > 30.0 { y } else { self.rounding * z.exp().ln_1p() }
                };
                let e = soft(x - half) - soft(-x - half);
                let grip = (e.abs() / self.rounding).min(1.0);
                let t = self.k * e + self.d * grip * dx;
                return if t * e > 0.0 { t } else { 0.0 };
            }
            if x > half {
                (self.k * (x - half) + self.d * dx).max(0.0)
            } else if x < -half {
                (self.k * (x + half) + self.d * dx).min(0.0)
            } else {
                0.0
            }
        } else {
            self.k * x * (1.0 + self.hardening * x * x) + self.d * dx
        }
    }
}

/// Dahl or LuGre bristles in place of the sign of the speed.
#[derive(Clone, Copy, Debug, Default)]
pub struct Bristle {
    /// Stiffness; 0: none.
    pub s0: f64,
    /// Damping.
    pub s1: f64,
    /// The deflection follows the momentary level of friction (LuGre) instead of Coulomb's (Dahl).
    pub lugre: bool,
}

/// All laws of one rig; zero means absent.
#[derive(Clone, Debug, Default)]
pub struct Laws {
    /// Total inertia.
    pub j: f64,
    /// Viscous friction.
    pub c: f64,
    /// Coulomb friction.
    pub tc: f64,
    /// Torque per drive unit.
    pub kt: f64,
    /// Resistance.
    pub r: f64,
    /// Inductance.
    pub l: f64,
    /// Back-EMF constant.
    pub ke: f64,
    /// Nominal supply.
    pub v0: f64,
    /// Stribeck: torque, speed, exponent.
    pub strib: [f64; 3],
    /// Stribeck and lubricated rise as rational laws.
    pub rational: bool,
    /// Lubricated rise: torque, speed.
    pub rise: [f64; 2],
    /// Quadratic drag and its exponent (2: the table's) with a reference speed.
    pub quad: [f64; 3],
    /// Viscous asymmetry.
    pub asym: f64,
    /// Constant torque.
    pub bias: f64,
    /// Friction by load and the exponent of the load with its reference.
    pub mu: [f64; 3],
    /// Friction by temperature; `true`: exponential.
    pub alpha: (f64, bool),
    /// Periodic friction.
    pub periodic: Wave,
    /// Tight spot: torque, centre, width; `true`: a rational bump.
    pub spot: ([f64; 3], bool),
    /// Presliding.
    pub bristle: Bristle,
    /// Cogging.
    pub cogging: Vec<Wave>,
    /// Torque ripple.
    pub ripple: Wave,
    /// Saturation; `true`: kt i / (1 + beta |i|).
    pub beta: (f64, bool),
    /// Spring, and its cubic share.
    pub spring: [f64; 2],
    /// Compliance or backlash.
    pub two: TwoMass,
    /// Rise of the winding's temperature, its time constant.
    pub heat: [f64; 2],
    /// The winding is heated by its losses instead of by a plain exponential.
    pub joule: bool,
    /// Source resistance.
    pub sag: f64,
    /// Dead-time voltage and current over which it is smoothed.
    pub dead: [f64; 2],
    /// Encoder eccentricity.
    pub ecc: Wave,
    /// Offset of the current sensor.
    pub i_offset: f64,
    /// Gain error of the current sensor.
    pub i_gain: f64,
    /// Delay of the controller's output.
    pub delay: f64,
    /// Outside: detent with a dead band, amplitude, order, phase.
    pub detent: [f64; 3],
    /// Outside: friction per square root of time.
    pub age: f64,
    /// Outside: hysteretic spring, stiffness of each of its sliders and their yield angles.
    pub sliders: Vec<[f64; 2]>,
    /// Outside: torque per angle and current squared, and the angle where it stops growing.
    pub posi2: [f64; 2],
    /// Outside: friction per tooth.
    pub teeth: Vec<f64>,
    /// Outside: scale of a load that walks at random.
    pub walk: f64,
    /// Outside: friction that comes and goes.
    pub intermittent: f64,
}

/// Reference temperature of the friction, degC.
pub const T_REF: f64 = 20.0;

/// What acts on the rig from outside at one moment.
#[derive(Clone, Copy, Debug, Default)]
pub struct Around {
    /// Time since the run's start.
    pub t: f64,
    /// Known load.
    pub load: f64,
    /// Temperature.
    pub temp: f64,
    /// Torque that walks at random, unit scale.
    pub walk: f64,
    /// Whether the intermittent drag is on.
    pub on: f64,
}

impl Laws {
    fn warm(&self, temp: f64) -> f64 {
        let x = self.alpha.0 * (temp - T_REF);
        if self.alpha.1 { x.exp() } else { 1.0 + x }
    }

    /// Level of the dry friction, which the sign of the speed (or the bristles) multiplies.
    pub fn level(&self, w: f64, th: f64, e: &Around) -> f64 {
        let v = w.abs();
        let mut f = self.tc - self.two.tcl;
        if self.strib[0] != 0.0 {
            let x = v / self.strib[1];
            f += self.strib[0]
                * if self.rational {
                    1.0 / (1.0 + x * x)
                } else {
                    (-x.powf(self.strib[2])).exp()
                };
        }
        if self.rise[0] != 0.0 {
            f += self.rise[0]
                * if self.rational {
                    v / (v + self.rise[1])
                } else {
                    1.0 - (-v / self.rise[1]).exp()
                };
        }
        if self.mu[0] != 0.0 {
            f += self.mu[0] * e.load.abs() * (e.load.abs() / self.mu[2]).max(1e-9).powf(self.mu[1] - 1.0);
        }
        f += self.periodic.at(th);
        if self.spot.0[0] != 0.0 {
            let x = (th - self.spot.0[1]) / self.spot.0[2];
            f += self.spot.0[0]
                * if self.spot.1 {
                    1.0 / (1.0 + x * x).powi(2)
                } else {
                    (-x * x).exp()
                };
        }
        if !self.teeth.is_empty() {
            let n = self.teeth.len() as f64;
            let turn = (th / std::f64::consts::TAU).rem_euclid(1.0);
            f += self.teeth[((turn * n) as usize).min(self.teeth.len() - 1)];
        }
        f += self.age * e.t.max(0.0).sqrt() + self.intermittent * e.on;
        (f * if self.alpha.0 != 0.0 { self.warm(e.temp) } else { 1.0 }).max(0.0)
    }

    /// All torque against positive motion that is neither dry friction, inertia, shaft nor load.
    pub fn drag(&self, w: f64, th: f64, e: &Around) -> f64 {
        let mut t = (self.c - self.two.cl) * w * if self.alpha.0 != 0.0 { self.warm(e.temp) } else { 1.0 };
        if self.quad[0] != 0.0 {
            t += self.quad[0] * w * w.abs() * (w.abs() / self.quad[2]).max(1e-9).powf(self.quad[1] - 2.0);
        }
        t += self.asym * w.abs() + self.bias + self.spring[0] * th * (1.0 + self.spring[1] * th * th);
        for wave in &self.cogging {
            t += wave.at(th);
        }
        if self.detent[0] != 0.0 {
            let s = (self.detent[1] * th + self.detent[2]).sin();
            t += self.detent[0] * s.signum() * (s.abs() - 0.6).max(0.0) / 0.4;
        }
        t + self.walk * e.walk
    }

    /// Motor torque of a drive signal.
    pub fn torque(&self, i: f64, th: f64) -> f64 {
        let bent = if self.beta.1 {
            i / (1.0 + self.beta.0 * i.abs())
        } else {
            i * (1.0 - self.beta.0 * i.abs())
        };
        self.kt * bent * (1.0 + self.ripple.at(th)) - self.posi2[0] * th.clamp(-self.posi2[1], self.posi2[1]) * i * i
    }

    /// Drive signal that gives a motor torque.
    pub fn drive(&self, torque: f64, th: f64) -> f64 {
        let rip = 1.0 + self.ripple.at(th);
        if self.posi2[0] != 0.0 {
            // torque = kt i - p i^2, the root next to torque / kt
            let p = self.posi2[0] * th.clamp(-self.posi2[1], self.posi2[1]);
            let root = (self.kt * self.kt - 4.0 * p * torque).max(0.0).sqrt();
            return 2.0 * torque / (self.kt + root);
        }
        let x = torque / (self.kt * rip);
        if self.beta.0 == 0.0 {
            x
        } else if self.beta.1 {
            x / (1.0 - self.beta.0 * x.abs()).max(0.05)
        } else {
            // |x| = y - beta y^2
            let root = (1.0 - 4.0 * self.beta.0 * x.abs()).max(0.0).sqrt();
            2.0 * x / (1.0 + root)
        }
    }

    /// Deflection at which the bristles slide.
    pub fn slip(&self, level: f64) -> f64 {
        (if self.bristle.lugre { level } else { self.tc }) / self.bristle.s0
    }
}
