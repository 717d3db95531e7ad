//! Reference currents by rotor position (paper 3.1.2, "reference current calculator").

use super::pick;

/// Reference of one phase: `rect(P theta - 2 pi q/3) I_ref`, rect = +1 on `[30, 150)` degrees,
/// -1 on `[210, 330)`, else 0.
///
/// * `fold` the phase's folded electrical angle (see [`crate::plant::back_emf::fold`]): the flat
///   tops of the trapezoid are where it is beyond 1
/// * `i_ref` current reference
///
/// `ONE`: see [`super::limit`]. The half-open ends differ from the closed ones here at single angles only.
#[inline(always)]
pub fn phase_reference<const ONE: bool>(fold: f64, i_ref: f64) -> f64 {
    if ONE {
        return if fold <= -1.0 {
            -i_ref
        } else if fold >= 1.0 {
            i_ref
        } else {
            0.0
        };
    }
    pick(fold <= -1.0, -i_ref, pick(fold >= 1.0, i_ref, 0.0))
}
