//! The hidden effects: their parameters, and one flat record of all of them for the stepper.

/// Names of all effects that can be drawn.
pub const EFFECTS: &[&str] = &[
    "cogging",
    "stribeck",
    "quadratic_drag",
    "bias_torque",
    "supply_sag",
    "eccentricity",
    "lubricated_rise",
    "viscous_asymmetry",
    "periodic_friction",
    "tight_spot",
    "presliding",
    "torque_ripple",
    "torque_saturation",
    "spring_load",
    "compliance",
    "backlash",
    "winding_heating",
    "dead_time",
    "turn_short",
    "commutation_offset",
    "encoder_eccentricity",
    "current_offset",
    "current_gain",
    "control_delay",
];

/// One hidden effect: its name and its parameters by key.
#[derive(Clone, Debug, PartialEq)]
pub struct Effect {
    /// Canonical name, one of [`EFFECTS`].
    pub name: &'static str,
    /// Parameters, SI, motor side.
    pub parameters: Vec<(&'static str, f64)>,
}

impl Effect {
    /// An effect by its name; `None` if there is no such effect.
    pub fn new(name: &str, parameters: &[(&'static str, f64)]) -> Option<Effect> {
        let name = EFFECTS.iter().copied().find(|n| *n == name)?;
        Some(Effect {
            name,
            parameters: parameters.to_vec(),
        })
    }

    /// The value of a parameter, 0 where it is absent.
    pub fn get(&self, key: &str) -> f64 {
        self.parameters.iter().find(|(k, _)| *k == key).map_or(0.0, |(_, v)| *v)
    }
}

/// A term `amplitude cos(order theta + phase)`.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Wave {
    pub amplitude: f64,
    pub order: f64,
    pub phase: f64,
}

impl Wave {
    fn of(effect: &Effect, amplitude: &str) -> Wave {
        Wave {
            amplitude: effect.get(amplitude),
            order: effect.get("order"),
            phase: effect.get("phase"),
        }
    }

    #[inline]
    pub fn at(&self, theta: f64) -> f64 {
        self.amplitude * (self.order * theta + self.phase).cos()
    }
}

/// Load inertia behind a spring.
#[derive(Clone, Copy, Debug)]
pub(super) struct Spring {
    pub stiffness: f64,
    pub damping: f64,
    pub inertia: f64,
}

/// Friction bristle of Dahl.
#[derive(Clone, Copy, Debug)]
pub(super) struct Bristle {
    pub stiffness: f64,
    pub damping: f64,
}

/// All effects of a unit, flat; the defaults change nothing.
#[derive(Clone, Debug)]
pub(super) struct Hidden {
    /// Torque, speed, exponent.
    pub stribeck: Option<(f64, f64, f64)>,
    /// Torque, speed.
    pub lubricated: Option<(f64, f64)>,
    pub quadratic: f64,
    pub asymmetry: f64,
    pub bias: f64,
    pub periodic: Vec<Wave>,
    /// Torque, centre, width.
    pub tight: Option<(f64, f64, f64)>,
    pub presliding: Option<Bristle>,
    pub cogging: Vec<Wave>,
    pub ripple: Vec<Wave>,
    /// Eccentricity as `x cos theta - y sin theta` for phase a.
    pub ecc: (f64, f64),
    pub saturation: f64,
    pub spring: f64,
    pub compliance: Option<Spring>,
    /// Full width of the play at the motor side [rad].
    pub gap: Option<f64>,
    pub delta_t: f64,
    pub source: f64,
    pub dead: f64,
    /// Remaining share of the turns of each phase.
    pub turns: [f64; 3],
    pub commutation: f64,
    /// Amplitude, phase.
    pub encoder: (f64, f64),
    pub current_offset: [f64; 3],
    pub current_gain: f64,
    pub delay: f64,
}

impl Hidden {
    /// The flat record; effects of one kind add up where that makes sense, otherwise the last one counts.
    pub fn of(effects: &[Effect]) -> Hidden {
        let mut h = Hidden {
            stribeck: None,
            lubricated: None,
            quadratic: 0.0,
            asymmetry: 0.0,
            bias: 0.0,
            periodic: Vec::new(),
            tight: None,
            presliding: None,
            cogging: Vec::new(),
            ripple: Vec::new(),
            ecc: (0.0, 0.0),
            saturation: 0.0,
            spring: 0.0,
            compliance: None,
            gap: None,
            delta_t: 0.0,
            source: 0.0,
            dead: 0.0,
            turns: [1.0; 3],
            commutation: 0.0,
            encoder: (0.0, 0.0),
            current_offset: [0.0; 3],
            current_gain: 1.0,
            delay: 0.0,
        };
        effects.iter().for_each(|e| h.add(e));
        h
    }

    fn add(&mut self, e: &Effect) {
        match e.name {
            "stribeck" => self.stribeck = Some((e.get("torque"), e.get("speed"), e.get("exponent"))),
            "lubricated_rise" => self.lubricated = Some((e.get("torque"), e.get("speed"))),
            "quadratic_drag" => self.quadratic += e.get("coefficient"),
            "viscous_asymmetry" => self.asymmetry += e.get("coefficient"),
            "bias_torque" => self.bias += e.get("torque"),
            "periodic_friction" => self.periodic.push(Wave::of(e, "amplitude")),
            "tight_spot" => self.tight = Some((e.get("torque"), e.get("centre"), e.get("width"))),
            "presliding" => {
                self.presliding = Some(Bristle {
                    stiffness: e.get("stiffness"),
                    damping: e.get("damping"),
                })
            }
            "cogging" => self.cogging.push(Wave::of(e, "amplitude")),
            "torque_ripple" => self.ripple.push(Wave::of(e, "fraction")),
            "eccentricity" => {
                self.ecc.0 += e.get("zeta") * e.get("phase").cos();
                self.ecc.1 += e.get("zeta") * e.get("phase").sin();
            }
            "torque_saturation" => self.saturation += e.get("coefficient"),
            "spring_load" => self.spring += e.get("stiffness"),
            "compliance" => {
                self.compliance = Some(Spring {
                    stiffness: e.get("stiffness"),
                    damping: e.get("damping"),
                    inertia: e.get("inertia"),
                })
            }
            "backlash" => self.gap = Some(e.get("gap")),
            "winding_heating" => self.delta_t += e.get("delta_t"),
            "supply_sag" => self.source += e.get("resistance"),
            "dead_time" => self.dead += e.get("voltage"),
            "turn_short" => self.turns[(e.get("phase") as usize).min(2)] *= 1.0 - e.get("fraction"),
            "commutation_offset" => self.commutation += e.get("angle"),
            "encoder_eccentricity" => self.encoder = (e.get("amplitude"), e.get("phase")),
            "current_offset" => self.current_offset[0] += e.get("current"),
            "current_gain" => self.current_gain *= e.get("gain"),
            "control_delay" => self.delay += e.get("delay"),
            _ => unreachable!("names come from EFFECTS"),
        }
    }
}
