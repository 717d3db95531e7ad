//! Bristles in place of dry friction, driven by the measured motion.

use crate::equations::signals::Signals;
use sim_worker::effect::Dahl;

/// Second shape of bristles that break away at the static friction.
pub const STATIC: f64 = 1.0;

/// Whether bristles of a shape break away at the static friction.
pub fn breaks_away(shape: &[f64]) -> bool {
    shape.get(1) == Some(&STATIC)
}

/// Dahl's bristle deflection over that of fast sliding, driven by the measured motion.
///
/// * `distance` the motor angle over which friction turns round [rad]
/// * `break_away` static over dynamic friction, as [`Dahl::rise`] has it
pub fn dahl(s: &Signals, distance: f64, break_away: f64) -> Vec<f64> {
    let mut z: f64 = 0.0;
    let most = |omega: f64| Dahl::rise(break_away, omega);
    // what is a piece of a recording begins with the bristles as the pieces before it left them
    for w in s.before.windows(2) {
        let way = w[1] - w[0];
        let most = most(way * s.rate_hz);
        let end = most * way.signum();
        z = end + (z - end) * (-way.abs() / (distance * most)).exp();
    }
    let dt = 1.0 / s.rate_hz;
    s.omega
        .iter()
        .map(|w| {
            let most = most(*w);
            let end = most * w.signum();
            let before = z;
            let x = w.abs() * dt / (distance * most);
            // exact for a constant speed over the sample; the mean over it
            z = end + (z - end) * (-x).exp();
            if x > 1e-9 {
                end + (before - end) * -(-x).exp_m1() / x
            } else {
                z
            }
        })
        .collect()
}
