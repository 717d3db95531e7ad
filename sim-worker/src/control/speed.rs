//! Speed loop: proportional and integral, saturated, with conditional integration (paper 3.1.1).

use super::{limit, pick};

/// Constants of the loop, divided through by the torque constant kt so that everything is a current.
pub struct Gains {
    /// `Kp / kt` [A per unit of speed]
    pub kp: f64,
    /// `Ki dt / kt` [A per unit of speed and step]
    pub ki_dt: f64,
    /// current limits `-Imax`, `Imax` [A]
    /// lower current limit `-Imax` [A]
    pub i_min: f64,
    /// upper current limit `Imax` [A]
    pub i_max: f64,
    /// integrator limits `-Tint/kt`, `Tint/kt` [A]
    /// lower integrator limit `-Tint/kt` [A]
    pub x_min: f64,
    /// upper integrator limit `Tint/kt` [A]
    pub x_max: f64,
}

/// One step of the PI loop. Returns `(I_ref, x)`: the saturated current reference `TMref / kt`
/// and the new integrator [A].
///
/// * `e` speed error
/// * `x` integrator `I / kt` [A]
///
/// The integrator stands still while the reference is saturated and the error would drive it
/// further (`|T/kt| > Imax` and `T e >= 0`).
#[inline(always)]
pub fn current_reference<const ONE: bool>(g: &Gains, e: f64, x: f64) -> (f64, f64) {
    let raw = g.kp * e + x;
    let reference = limit::<ONE>(raw, g.i_min, g.i_max);
    if ONE && raw == reference {
        return (reference, limit::<ONE>(x + g.ki_dt * e, g.x_min, g.x_max));
    }
    let hold = (raw != reference) & (raw * e >= 0.0);
    let moved = limit::<ONE>(x + g.ki_dt * e, g.x_min, g.x_max);
    (reference, pick(hold, x, moved))
}
