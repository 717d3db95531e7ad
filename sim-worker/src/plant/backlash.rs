//! Backlash as a play operator on the user shaft (paper 3.1.3, "hysteresis band acting on the user shaft position").

use crate::control::limit;

/// User angle after the play [rad]: it follows the shaft angle `u` once the gap of half-width `b` is taken up.
#[inline(always)]
pub fn play<const ONE: bool>(th_u: f64, u: f64, b: f64) -> f64 {
    let low = u - b;
    let high = u + b;
    if ONE {
        return limit::<ONE>(th_u, low, high);
    }
    let y = if low > th_u { low } else { th_u };
    if high < y { high } else { y }
}
