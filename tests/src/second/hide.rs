//! The hidden effects: their parameters, drawn to the rig's measure.

use super::dice::Dice;
use super::laws::{Bristle, Laws, TwoMass, Wave};
use super::rig::{Mode, Rig};
use std::f64::consts::TAU;

/// Draws the parameters of hidden laws for one rig.
pub struct Picker<'a> {
    /// The rig.
    pub rig: &'a Rig,
    /// Strength.
    pub s: f64,
    /// Draws.
    pub d: Dice,
    /// Range of the motor's angle that all runs share.
    pub travel: (f64, f64),
    /// Width of the widest run.
    pub widest: f64,
    /// Departures from the table, in words.
    pub shape: &'a mut String,
}

impl Picker<'_> {
    fn other(&mut self, text: &str) -> bool {
        if self.rig.other {
            if !self.shape.is_empty() {
                self.shape.push_str(", ");
            }
            self.shape.push_str(text);
        }
        self.rig.other
    }

    /// An order that the sampling resolves and that the travel covers several times.
    fn order(&mut self, most: f64) -> f64 {
        let cap = if self.rig.mode == Mode::Ideal {
            (self.rig.rate / 10.0).min(60.0)
        } else {
            20.0
        };
        let most = (TAU * cap / (0.4 * self.rig.w_max)).min(most);
        let least = 4.0 * TAU / (self.travel.1 - self.travel.0);
        let whole: Vec<f64> = [1.0, 2.0, 3.0, 4.0, 6.0, 7.0, 8.0, 12.0, 14.0, 18.0, 24.0, 36.0]
            .into_iter()
            .filter(|&n| n <= most && n >= least)
            .collect();
        if whole.is_empty() || self.d.chance(0.35) {
            // a tooth count behind a gear
            let gear = if self.rig.gear > 1.0 {
                self.rig.gear
            } else {
                self.d.pick(&[2.7, 3.7, 5.2, 6.25])
            };
            let n = self.d.logu(least.min(most), most.max(least));
            (n * gear).round().max(1.0) / gear
        } else {
            self.d.pick(&whole)
        }
    }

    fn wave(&mut self, a: f64, n: f64, second: f64) -> Wave {
        Wave {
            a,
            phi: self.d.phase(),
            n,
            second,
        }
    }

    /// Puts an effect into the laws and returns its parameters.
    pub fn hide(&mut self, name: &str, laws: &mut Laws) -> Vec<(&'static str, f64)> {
        let (rig, s) = (self.rig, self.s);
        let w = rig.w_max;
        let tf = rig.tc + 0.5 * rig.c * w;
        let mut amp = s * self.d.uni(0.25, 0.5) * tf.max(0.25 * rig.t_ref);
        if rig.mode == Mode::Spin {
            amp = amp.min(0.6 * tf);
        }
        let width = self.travel.1 - self.travel.0;
        match name {
            "stribeck" => {
                let mut p = [
                    s * self.d.uni(0.35, 0.9) * rig.tc,
                    w * self.d.logu(0.05, 0.25),
                    self.d.uni(1.0, 2.0),
                ];
                if rig.other && self.d.chance(0.5) {
                    self.other("Stribeck exponent 0.8");
                    p[2] = 0.8;
                } else {
                    laws.rational = self.other("rational Stribeck law");
                }
                laws.strib = p;
                vec![("torque", p[0]), ("speed", p[1]), ("exponent", p[2])]
            }
            "lubricated_rise" => {
                laws.rational = self.other("rational rise");
                laws.rise = [s * self.d.uni(0.4, 1.0) * rig.tc, w * self.d.logu(0.05, 0.3)];
                vec![("torque", laws.rise[0]), ("speed", laws.rise[1])]
            }
            "quadratic_drag" => {
                let power = if self.other("drag with exponent 1.8") { 1.8 } else { 2.0 };
                laws.quad = [1.3 * amp / (w * w), power, w];
                vec![("coefficient", laws.quad[0])]
            }
            "viscous_asymmetry" => {
                laws.asym = s * self.d.sign() * self.d.uni(0.35, 0.8) * rig.c;
                vec![("coefficient", laws.asym)]
            }
            "bias_torque" => {
                laws.bias = self.d.sign() * amp;
                vec![("torque", laws.bias)]
            }
            "load_dependent_friction" => {
                let power = if self.other("load to the power 0.85") {
                    0.85
                } else {
                    1.0
                };
                laws.mu = [s * self.d.uni(0.1, 0.3), power, rig.t_ref];
                vec![("coefficient", laws.mu[0])]
            }
            "temperature_dependent_friction" => {
                laws.alpha = (
                    -(s * self.d.uni(0.006, 0.013)).min(0.02),
                    self.other("exponential in temperature"),
                );
                vec![("coefficient", laws.alpha.0)]
            }
            "periodic_friction" => {
                let n = self.order(8.0);
                let second = if self.other("second harmonic") { 0.2 } else { 0.0 };
                let a = (s * self.d.uni(0.3, 0.6)).min(0.8) * rig.tc;
                laws.periodic = self.wave(a, n, second);
                vec![("amplitude", a), ("phase", laws.periodic.phi), ("order", n)]
            }
            "tight_spot" => {
                let centre = self.travel.0 + width * self.d.uni(0.3, 0.7);
                let p = [s * self.d.uni(0.8, 2.0) * rig.tc, centre, width * self.d.uni(0.03, 0.1)];
                laws.spot = (p, self.other("rational bump"));
                vec![("torque", p[0]), ("centre", p[1]), ("width", p[2])]
            }
            "presliding" => {
                let slip = (s * self.d.uni(0.015, 0.05) * width)
                    .max(s * 25.0 * rig.encoder)
                    .max(1e-9);
                let s0 = rig.tc / slip;
                let s1 = self.d.uni(0.05, 0.3) * 2.0 * (s0 * rig.j).sqrt();
                laws.bristle = Bristle {
                    s0,
                    s1,
                    lugre: self.other("LuGre with a mild Stribeck level"),
                };
                if laws.bristle.lugre {
                    laws.strib = [0.15 * rig.tc, 0.05 * w, 1.0];
                }
                vec![("stiffness", s0), ("damping", s1)]
            }
            "cogging" => {
                let second = if self.other("second harmonic") { 0.15 } else { 0.0 };
                let n = self.order(40.0);
                laws.cogging.push(self.wave(amp, n, second));
                let mut out = vec![("amplitude", amp), ("phase", laws.cogging[0].phi), ("order", n)];
                if self.d.chance(0.35) {
                    let m = self.order(40.0);
                    if (m - n).abs() > 0.3 * n.min(1.0) && (m - 2.0 * n).abs() > 0.3 {
                        let a = 0.6 * amp;
                        laws.cogging.push(self.wave(a, m, 0.0));
                        out.extend([("amplitude_2", a), ("phase_2", laws.cogging[1].phi), ("order_2", m)]);
                    }
                }
                out
            }
            "torque_ripple" => {
                let second = if self.other("second harmonic") { 0.2 } else { 0.0 };
                let (z, n) = (s * self.d.uni(0.06, 0.14), self.order(24.0));
                laws.ripple = self.wave(z, n, second);
                vec![("fraction", z), ("phase", laws.ripple.phi), ("order", n)]
            }
            "torque_saturation" => {
                laws.beta = (
                    s * self.d.uni(0.08, 0.16) / (1.3 * rig.i_ref()),
                    self.other("hyperbolic saturation"),
                );
                vec![("coefficient", laws.beta.0)]
            }
            "spring_load" => {
                let width = self.widest;
                let k = 2.4 * amp / width;
                laws.spring = [
                    k,
                    if self.other("hardening spring") {
                        0.25 / (0.25 * width * width)
                    } else {
                        0.0
                    },
                ];
                vec![("stiffness", k)]
            }
            _ => self.hide_more(name, laws, amp),
        }
    }

    fn hide_more(&mut self, name: &str, laws: &mut Laws, amp: f64) -> Vec<(&'static str, f64)> {
        let (rig, s) = (self.rig, self.s);
        let width = self.travel.1 - self.travel.0;
        let (i_ref, v_ref) = (rig.i_ref(), rig.v0 / 1.8);
        match name {
            "compliance" => {
                let jl = rig.j * self.d.uni(0.3, 0.7);
                let om = TAU * self.d.uni(8.0, 20.0) / s.sqrt().max(0.1);
                let (k, d) = (jl * om * om, 2.0 * self.d.uni(0.03, 0.12) * jl * om);
                let twist = jl * rig.a_max / k;
                let mut two = TwoMass {
                    k,
                    d,
                    jl,
                    cl: 0.5 * rig.c,
                    eps: 0.01 * rig.w_max,
                    ..TwoMass::default()
                };
                if self.other("hardening shaft, friction behind it") {
                    two.hardening = 0.15 / (twist * twist);
                    two.tcl = 0.3 * rig.tc;
                }
                laws.two = two;
                vec![("stiffness", k), ("damping", d), ("inertia", jl)]
            }
            "backlash" => {
                let jl = rig.j * self.d.uni(0.3, 0.6);
                let om = TAU * self.d.uni(90.0, 130.0);
                let least = (12.0 * rig.a_max / (om * om)).max(12.0 * rig.user_res.max(rig.encoder));
                let gap = s * least.max(width * self.d.uni(0.02, 0.08));
                laws.two = TwoMass {
                    k: jl * om * om,
                    d: 0.6 * jl * om,
                    jl,
                    gap: gap.max(1e-9),
                    rounding: if self.other("rounded edges of the play") {
                        0.06 * gap
                    } else {
                        0.0
                    },
                    tcl: rig.tc * self.d.uni(0.3, 0.5),
                    cl: 0.5 * rig.c,
                    eps: 0.01 * rig.w_max,
                    ..TwoMass::default()
                };
                vec![("gap", gap)]
            }
            "winding_heating" => {
                laws.heat = [s * self.d.uni(40.0, 80.0), rig.span * self.d.uni(0.3, 1.0)];
                laws.joule = self.other("heated by the losses, largest rise given");
                vec![("delta_t", laws.heat[0])]
            }
            "supply_sag" => {
                laws.sag = s * self.d.uni(0.08, 0.16) * rig.v0 / i_ref;
                vec![("resistance", laws.sag)]
            }
            "dead_time" => {
                let soft = if self.other("dead time smoothed widely") {
                    0.12
                } else {
                    0.02
                };
                laws.dead = [s * self.d.uni(0.04, 0.1) * v_ref, soft * i_ref];
                vec![("voltage", laws.dead[0])]
            }
            "encoder_eccentricity" => {
                let a = s * self.d.uni(0.012, 0.05);
                laws.ecc = Wave {
                    a,
                    phi: self.d.phase(),
                    n: 1.0,
                    second: 0.0,
                };
                vec![("amplitude", a), ("phase", laws.ecc.phi)]
            }
            "current_offset" => {
                laws.i_offset = s * self.d.sign() * self.d.uni(0.05, 0.12) * i_ref;
                vec![("current", laws.i_offset)]
            }
            "current_gain" => {
                laws.i_gain = s * self.d.sign() * self.d.uni(0.06, 0.15);
                vec![("gain", laws.i_gain)]
            }
            "control_delay" => {
                let step = 1.0 / (rig.rate * rig.fine as f64);
                laws.delay = (s * self.d.uni(0.15, 0.35) / rig.control.band / step).round() * step;
                vec![("delay", laws.delay)]
            }
            "dead_band_detent" => {
                laws.detent = [1.4 * amp, (0.5 * self.order(12.0)).max(0.5), self.d.phase()];
                vec![("amplitude", laws.detent[0]), ("order", 2.0 * laws.detent[1])]
            }
            "aging_friction" => {
                laws.age = s * self.d.uni(0.4, 0.8) * rig.tc / rig.span.sqrt();
                vec![("coefficient", laws.age)]
            }
            "hysteretic_spring" => {
                let k = 2.0 * amp / width;
                laws.sliders = vec![[2.5 * k, 0.08 * width], [1.5 * k, 0.2 * width], [0.8 * k, 0.45 * width]];
                vec![("stiffness", k)]
            }
            "position_current_squared" => {
                let p = s * self.d.sign() * self.d.uni(0.08, 0.13) * rig.kt / (i_ref * 0.5 * width);
                laws.posi2 = [p, 0.5 * width];
                vec![("coefficient", p)]
            }
            "toothed_friction" => {
                let n = 5 + (self.d.u() * 8.0) as usize;
                let high = s * self.d.uni(0.6, 1.0) * rig.tc;
                laws.teeth = (0..n)
                    .map(|k| if k == 0 || self.d.chance(0.4) { high } else { 0.0 })
                    .collect();
                vec![("torque", high), ("teeth", n as f64)]
            }
            "random_walk_load" => {
                laws.walk = 0.8 * amp;
                vec![("rms", laws.walk)]
            }
            "intermittent_drag" => {
                laws.intermittent = s * self.d.uni(0.4, 0.8) * rig.tc;
                vec![("torque", laws.intermittent)]
            }
            _ => vec![],
        }
    }
}
