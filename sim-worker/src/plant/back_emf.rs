//! Back-EMF coefficients with static eccentricity (paper Eq. 5 and 6).

use crate::control::pick;
use std::hint::cold_path;

/// Electrical angles of the three phases folded to triangles, in units of 30 electrical degrees:
/// 0 at 0 degrees, 3 at 90, -3 at 270.
///
/// * `r` electrical angle less 90 degrees, within 180 degrees of zero less a few [30 degrees]
///
/// Clipped at 1 the triangle is the paper's trapezoid: 0 to 1 over 0..30 degrees, 1 to 150, to
/// -1 at 210, -1 to 330, back to 0 at 360.
#[inline(always)]
pub fn fold(r: f64) -> [f64; 3] {
    let triangle = |x: f64| (x.abs() - 6.0).abs() - 3.0;
    [triangle(r), triangle(r - 4.0), triangle(r + 4.0)]
}

/// Coefficient of one phase `k_q = ke trap(P theta - 2 pi q/3) (1 + [P>1] zeta cos(theta + 2 pi q/3))`
/// (Eq. 5; the back-EMF itself is `k_q w`, Eq. 6), in the unit of `gain`.
///
/// * `fold` folded angle of the phase [30 degrees]
/// * `gain` `ke (1 + zeta cos(theta + 2 pi q/3))`
///
/// Eq. 5 takes the rotor's mechanical angle in each phase; the maps follow it.
#[inline(always)]
pub fn coefficient<const ONE: bool>(fold: f64, gain: f64) -> f64 {
    if ONE {
        if fold <= -1.0 {
            return -gain;
        }
        if fold >= 1.0 {
            return gain;
        }
        cold_path();
        return fold * gain;
    }
    pick(fold <= -1.0, -gain, pick(fold >= 1.0, gain, fold * gain))
}

/// The three gains `ke (1 + zeta cos(theta + 2 pi q/3))` from the eccentricity vector
/// `c = ke zeta cos(theta)/2`, `b = ke zeta sin(theta) sqrt(3)/2`.
#[inline(always)]
pub fn gains(ke: f64, c: f64, b: f64) -> [f64; 3] {
    let a = ke - c;
    [(ke + c) + c, a - b, a + b]
}

const SQRT3: f64 = 1.732_050_807_568_877_2;

/// The eccentricity vector `(c, b)` of [`gains`] at a rotor angle, from its sine and cosine.
#[inline(always)]
pub fn eccentricity_vector(ke_zeta: f64, sin: f64, cos: f64) -> (f64, f64) {
    (ke_zeta * (0.5 * cos), ke_zeta * (sin * (0.5 * SQRT3)))
}

/// Turns the eccentricity vector by the small angle `d` [rad], exact to 1e-17 for `|d| < 1e-3`:
/// sine and versed sine by their series, the different scales of `c` and `b` taken into the sine.
#[inline(always)]
pub fn rotate(c: f64, b: f64, d: f64) -> (f64, f64) {
    let d2 = d * d;
    let versed = d2 * (0.5 - d2 * (1.0 / 24.0));
    let sine_c = d * (1.0 / SQRT3 - d2 * (1.0 / 6.0 / SQRT3));
    let sine_b = 3.0 * sine_c;
    (c - (sine_c * b + versed * c), b + (sine_b * c - versed * b))
}
