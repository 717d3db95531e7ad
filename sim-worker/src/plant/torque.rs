//! Motor torque with saturation (paper Eq. 7).

use crate::control::limit;

/// `TM = sat(sum k_q i_q)` in the unit of `k` times A, limits `t_min`, `t_max`; the third
/// current is minus the sum of the other two.
#[inline(always)]
pub fn motor<const ONE: bool>(k: [f64; 3], i: [f64; 2], t_min: f64, t_max: f64) -> f64 {
    limit::<ONE>((k[0] - k[2]) * i[0] + (k[1] - k[2]) * i[1], t_min, t_max)
}
