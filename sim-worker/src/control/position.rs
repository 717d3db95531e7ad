//! Position loop: proportional, with a saturated speed reference (paper 3.1.1).

use super::limit;

/// Speed reference `Wref = sat(GAP (Com - ThU))` [rad/step].
///
/// * `gap` position gain GAP for positions in motor rad
/// * `com` commanded user position times the gear ratio [rad]
/// * `th_u` user position behind the backlash times the gear ratio [rad]
/// * `w_max` limit of the reference, `w_min = -w_max` [rad/step]
///
/// The paper's text forms the error with "ThM"; its block diagram and `Err Pos` use the user
/// angle ThU, as here.
#[inline(always)]
pub fn speed_reference<const ONE: bool>(gap: f64, com: f64, th_u: f64, w_min: f64, w_max: f64) -> f64 {
    limit::<ONE>(gap * (com - th_u), w_min, w_max)
}
