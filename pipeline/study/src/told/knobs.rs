//! Constants that a simulated loop under the recorded command is turned by, and how much its gaps to what was measured count.

use nalgebra::DVector;
use sim_worker::parameters::ActuatorParameters;

/// Difference by which slopes are taken, relative.
pub(super) const STEP: f64 = 0.01;
/// Gaps beyond so many times their usual size count by their size, not by its square (assumed): rotors that stick a moment
/// longer are no constants that are off.
const USUAL: f64 = 3.0;
/// Pieces of a recording, each of which is left out once [s].
pub(super) const PIECE_S: f64 = 1.0;

/// A constant that the loop tells, how far it may be off in units of one type, one sigma relative (assumed), and what it is of an
/// actuator.
pub(super) struct Knob {
    pub(super) name: &'static str,
    pub(super) sd: f64,
    pub(super) turn: fn(&mut ActuatorParameters, f64),
}

pub(super) const KNOBS: [Knob; 4] = [
    Knob {
        name: "torque_constant",
        sd: 0.02,
        // with all that the current tells by it
        turn: |p, f| {
            p.drive_constant_n_m_per_a = p.drive_constant();
            p.back_emf_v_s_per_rad *= f;
            p.inertia_kg_m2 *= f;
            p.viscous_n_m_s_per_rad *= f;
            p.static_friction_n_m *= f;
        },
    },
    Knob {
        name: "resistance",
        sd: 0.04,
        turn: |p, f| p.phase_resistance_ohm *= f,
    },
    Knob {
        name: "inductance",
        sd: 0.03,
        turn: |p, f| p.phase_inductance_h *= f,
    },
    Knob {
        name: "supply_voltage",
        sd: 0.01,
        turn: |p, f| p.supply_voltage_v *= f,
    },
];

/// Constants that the equations tell, beside those of [`KNOBS`].
pub(super) const MECHANICS: [Knob; 3] = [
    Knob {
        name: "inertia",
        sd: 0.05,
        turn: |p, f| p.inertia_kg_m2 *= f,
    },
    Knob {
        name: "viscous",
        sd: 0.2,
        turn: |p, f| p.viscous_n_m_s_per_rad *= f,
    },
    Knob {
        name: "coulomb",
        sd: 0.1,
        turn: |p, f| p.static_friction_n_m *= f,
    },
];

/// The actuator at `x`, logarithms of the constants over its own, and with each constant a [`STEP`] further.
pub(super) fn about(of: &ActuatorParameters, knobs: &[&Knob], x: &DVector<f64>) -> Vec<ActuatorParameters> {
    let near = |moved: Option<usize>| {
        let mut p = of.clone();
        for (i, k) in knobs.iter().enumerate() {
            let more = if moved == Some(i) { STEP } else { 0.0 };
            (k.turn)(&mut p, (x[i] + more).exp());
        }
        p
    };
    std::iter::once(None)
        .chain((0..knobs.len()).map(Some))
        .map(near)
        .collect()
}

/// What a gap counts.
///
/// * `usual` size of gaps
pub(super) fn weight(gap: f64, usual: f64) -> f64 {
    (USUAL * usual / gap.abs().max(1e-300)).min(1.0)
}

/// Usual size of gaps: standard deviation by their median, whatever the largest are.
pub(super) fn usual(mut sizes: Vec<f64>) -> f64 {
    let middle = sizes.len() / 2;
    match sizes.get(middle) {
        Some(_) => 1.4826 * *sizes.select_nth_unstable_by(middle, f64::total_cmp).1,
        None => 0.0,
    }
}
