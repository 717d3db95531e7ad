//! Drawing of units: constants off nominal, and the parameters of one hidden effect.

use std::f64::consts::TAU;

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::{Effect, Unit};

/// A random stream of its own for each purpose, so that one draw does not shift another.
pub(super) fn stream(seed: u64, purpose: u64) -> ChaCha8Rng {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    rng.set_stream(purpose);
    rng
}

impl Unit {
    /// A unit off nominal by uniformly up to 10 % (`j`), 20 % (`c`), 10 % (`fs0`), 1.5 % (`ke`), 4 % (`r`), with one
    /// hidden effect or none. `strength` 1 is clearly relevant; 0.1 a tenth of that. The constants depend on `seed`
    /// alone, not on the effect.
    ///
    /// # Errors
    /// The name, if there is no such effect.
    pub fn drawn(seed: u64, effect: Option<&str>, strength: f64) -> Result<Unit, String> {
        let mut rng = stream(seed, 1);
        let mut off = |share: f64| 1.0 + rng.random_range(-share..=share);
        let mut unit = Unit::default();
        unit.j *= off(0.10);
        unit.c *= off(0.20);
        unit.fs0 *= off(0.10);
        unit.ke *= off(0.015);
        unit.r *= off(0.04);
        if let Some(name) = effect {
            let mut rng = stream(seed, 2);
            let effect = Effect::drawn(name, strength, &unit, &mut rng)?;
            unit.thermometer = name == "winding_heating" && rng.random::<bool>();
            unit.effects.push(effect);
        }
        Ok(unit)
    }
}

impl Effect {
    /// An effect of a strength, its other parameters by `rng`.
    ///
    /// # Errors
    /// The name, if there is no such effect.
    pub fn drawn(name: &str, strength: f64, unit: &Unit, rng: &mut ChaCha8Rng) -> Result<Effect, String> {
        Effect::new(name, &parameters(name, strength, unit, rng)).ok_or_else(|| format!("no effect {name}"))
    }
}

/// Parameters of one effect. Its weight is proportional to `strength`; scales of speed, angle and order are not.
fn parameters(name: &str, strength: f64, unit: &Unit, rng: &mut ChaCha8Rng) -> Vec<(&'static str, f64)> {
    let sign = if rng.random::<bool>() { strength } else { -strength };
    let phase = rng.random_range(0.0..TAU);
    let pick = rng.random_range(0..60_usize);
    let mut between = |lo: f64, hi: f64| rng.random_range(lo..hi);
    let order = |orders: &[f64]| orders[pick % orders.len()];
    match name {
        "stribeck" => vec![
            ("torque", strength * between(0.008, 0.018)),
            ("speed", between(6.0, 30.0)),
            ("exponent", between(1.0, 2.0)),
        ],
        "lubricated_rise" => vec![
            ("torque", strength * between(0.01, 0.02)),
            ("speed", between(20.0, 80.0)),
        ],
        "quadratic_drag" => vec![("coefficient", strength * between(2.5e-7, 6e-7))],
        "viscous_asymmetry" => vec![("coefficient", sign * between(3e-5, 7e-5))],
        "bias_torque" => vec![("torque", sign * between(0.005, 0.012))],
        "periodic_friction" => vec![
            ("amplitude", strength * between(0.006, 0.012)),
            ("phase", phase),
            ("order", order(&[0.5, 1.0, 2.0, 3.0])),
        ],
        "tight_spot" => vec![
            ("torque", strength * between(0.02, 0.05)),
            ("centre", between(-12.0, 12.0)),
            ("width", between(3.0, 8.0)),
        ],
        "presliding" => {
            // The way over which the bristle builds up, then a damping of its own swing about 0.3 of critical.
            let stiffness = unit.fd_ratio * unit.fs0 / (strength.max(1e-6) * between(0.3, 1.0));
            let damping = between(0.4, 0.8) * (stiffness * unit.j).sqrt();
            vec![("stiffness", stiffness), ("damping", damping)]
        }
        "cogging" => vec![
            ("amplitude", strength * between(0.006, 0.015)),
            ("phase", phase),
            ("order", order(&[4.0, 6.0, 8.0, 12.0, 18.0, 24.0])),
        ],
        "torque_ripple" => vec![
            ("fraction", strength * between(0.1, 0.25)),
            ("phase", phase),
            ("order", order(&[1.0, 2.0, 4.0, 6.0, 12.0])),
        ],
        "eccentricity" => vec![("zeta", strength * between(0.12, 0.3)), ("phase", phase)],
        "torque_saturation" => vec![("coefficient", strength * between(0.01, 0.02))],
        "spring_load" => vec![("stiffness", strength * between(1.5e-4, 4e-4))],
        "compliance" => {
            let inertia = unit.j * between(0.5, 1.0);
            let (frequency, damping) = (between(600.0, 1200.0), between(0.25, 0.4));
            vec![
                ("stiffness", inertia * frequency * frequency),
                ("damping", 2.0 * damping * inertia * frequency),
                ("inertia", strength * inertia),
            ]
        }
        // Full width at the motor; the type's own is 0.02 rad, and `strength` scales what is above it.
        "backlash" => vec![("gap", 2.0 * unit.b * unit.gear + strength * between(0.1, 0.4))],
        "winding_heating" => vec![("delta_t", strength * between(35.0, 80.0))],
        "supply_sag" => vec![("resistance", strength * between(0.3, 1.0))],
        "dead_time" => vec![("voltage", strength * between(0.5, 1.5))],
        "turn_short" => vec![
            ("fraction", strength * between(0.1, 0.25)),
            ("phase", (pick % 3) as f64),
        ],
        "commutation_offset" => vec![("angle", sign * between(0.2, 0.45))],
        "encoder_eccentricity" => vec![("amplitude", strength * between(0.02, 0.06)), ("phase", phase)],
        "current_offset" => vec![("current", sign * between(0.15, 0.4))],
        "current_gain" => vec![("gain", 1.0 + sign * between(0.08, 0.2))],
        "control_delay" => vec![("delay", strength * between(2.5e-4, 4.5e-4))],
        _ => Vec::new(),
    }
}
