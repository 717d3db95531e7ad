//! What each hidden law needs of a rig so that it can be seen at all.

/// Effects that this generator can hide.
pub const EFFECTS: &[&str] = &[
    "stribeck",
    "lubricated_rise",
    "quadratic_drag",
    "viscous_asymmetry",
    "bias_torque",
    "load_dependent_friction",
    "temperature_dependent_friction",
    "periodic_friction",
    "tight_spot",
    "presliding",
    "cogging",
    "torque_ripple",
    "torque_saturation",
    "spring_load",
    "compliance",
    "backlash",
    "winding_heating",
    "supply_sag",
    "dead_time",
    "encoder_eccentricity",
    "current_offset",
    "current_gain",
    "control_delay",
];

/// Laws that are in no list of candidates.
pub const OUTSIDE: &[&str] = &[
    "dead_band_detent",
    "aging_friction",
    "hysteretic_spring",
    "position_current_squared",
    "toothed_friction",
    "random_walk_load",
    "intermittent_drag",
];

/// Demands on a rig; the demands of two effects add up.
#[derive(Clone, Copy, Debug, Default)]
pub struct Needs {
    /// The angle is measured.
    pub angle: bool,
    /// Several revolutions at moderate speed.
    pub revolutions: bool,
    /// The motion goes both ways.
    pub both_ways: bool,
    /// The travel stays bounded and is passed over many times.
    pub bounded: bool,
    /// The terminal voltage of a DC motor is measured.
    pub voltage: bool,
    /// The drive signal is not the torque itself.
    pub not_torque: bool,
    /// A varying load is measured.
    pub load: bool,
    /// A varying temperature is measured.
    pub temperature: bool,
    /// The user's side has a sensor of its own.
    pub user: bool,
    /// The controller is known and logged.
    pub controller: bool,
    /// Friction is no small part of the torque.
    pub friction: bool,
    /// Slow parts of the motion matter.
    pub slow: bool,
}

impl Needs {
    /// The demands of all that is hidden.
    pub fn of(names: &[&str]) -> Needs {
        let mut n = Needs::default();
        for name in names {
            match *name {
                "stribeck" => (n.friction, n.both_ways, n.slow) = (true, true, true),
                "lubricated_rise" => (n.friction, n.both_ways) = (true, true),
                "viscous_asymmetry" | "bias_torque" => n.both_ways = true,
                "load_dependent_friction" => (n.load, n.both_ways, n.friction) = (true, true, true),
                "temperature_dependent_friction" => (n.temperature, n.friction) = (true, true),
                "periodic_friction" | "toothed_friction" => {
                    (n.angle, n.revolutions, n.both_ways, n.friction) = (true, true, true, true)
                }
                "tight_spot" => (n.angle, n.bounded, n.both_ways, n.friction) = (true, true, true, true),
                "presliding" => (n.angle, n.bounded, n.both_ways, n.friction, n.slow) = (true, true, true, true, true),
                "cogging" | "dead_band_detent" => (n.angle, n.revolutions) = (true, true),
                "torque_ripple" => (n.angle, n.revolutions, n.not_torque) = (true, true, true),
                "torque_saturation" => n.not_torque = true,
                "spring_load" => (n.angle, n.bounded, n.both_ways) = (true, true, true),
                "hysteretic_spring" => (n.angle, n.bounded, n.both_ways, n.friction) = (true, true, true, true),
                "position_current_squared" => {
                    (n.angle, n.bounded, n.both_ways, n.not_torque) = (true, true, true, true)
                }
                "compliance" => (n.angle, n.user, n.both_ways) = (true, true, true),
                "backlash" => (n.angle, n.user, n.both_ways, n.bounded) = (true, true, true, true),
                "winding_heating" | "supply_sag" => (n.voltage, n.not_torque) = (true, true),
                "dead_time" | "current_offset" => (n.voltage, n.not_torque, n.both_ways) = (true, true, true),
                "current_gain" => (n.voltage, n.not_torque) = (true, true),
                "encoder_eccentricity" => (n.angle, n.revolutions) = (true, true),
                "control_delay" => (n.angle, n.controller, n.both_ways) = (true, true, true),
                "aging_friction" | "intermittent_drag" => n.friction = true,
                _ => {}
            }
        }
        n
    }
}

/// True where two effects can be hidden in one rig and told apart in principle.
pub fn compatible(a: &str, b: &str) -> bool {
    const CLASH: &[(&str, &str)] = &[
        ("compliance", "backlash"),
        ("stribeck", "lubricated_rise"),
        ("stribeck", "presliding"),
        ("lubricated_rise", "presliding"),
        ("tight_spot", "presliding"),
        ("periodic_friction", "presliding"),
        ("encoder_eccentricity", "presliding"),
        ("encoder_eccentricity", "compliance"),
        ("encoder_eccentricity", "backlash"),
        ("encoder_eccentricity", "control_delay"),
        ("quadratic_drag", "torque_saturation"),
        ("current_gain", "torque_saturation"),
        ("current_gain", "winding_heating"),
        ("temperature_dependent_friction", "winding_heating"),
        ("winding_heating", "supply_sag"),
        ("current_gain", "supply_sag"),
        ("compliance", "presliding"),
        ("backlash", "presliding"),
    ];
    a != b && !CLASH.iter().any(|&(x, y)| (x, y) == (a, b) || (x, y) == (b, a))
}
