//! Inertia (paper Eq. 8), semi-implicit Euler.

use crate::control::pick;
use std::hint::cold_path;

/// New speed `w + dt/J T`; a speed that would change sign within the step is 0, so that friction
/// can hold the rotor (paper ref. [24]).
///
/// * `w` motor speed, `gain` net torque times dt/J, in the unit of the speed
#[inline(always)]
pub fn speed<const ONE: bool>(w: f64, gain: f64) -> f64 {
    let wn = w + gain;
    if ONE {
        if w * wn < 0.0 {
            cold_path();
            return 0.0;
        }
        return wn;
    }
    pick(w * wn < 0.0, 0.0, wn)
}
