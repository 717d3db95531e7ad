//! A load mass behind a spring as a candidate: its columns, found by the torque or driven by the measured motion, and its resonance.

use crate::candidates::columns::{Contribution, drive};
use crate::candidates::loads::{Shaken, Spring, released};
use crate::equations::pieces::{Column, Piece, RigConstants, wide};
use crate::equations::problem::Problem;
use crate::equations::signals::Signals;
use crate::measured::samples::sharpened;
use sim_worker::effect::Equation;

/// Fourth shape parameter of a spring that the torque drives, not the measured motion.
pub const BY_TORQUE: f64 = 1.0;
/// The same of a slow one that the measured motion drives, which is looked for without a sensor that sees it.
const SLOW: f64 = 0.5;
/// Fifth shape parameter of a spring beyond the user's sensor, which turns with the motor.
const BEYOND: f64 = 1.0;

/// Whether a second sensor sees a load on its spring.
pub fn is_seen(p: &Problem, shape: &[f64]) -> bool {
    p.rows_of(Equation::Transmission) > 0 && !is_beyond(shape)
}

/// Whether a load on its spring lies beyond the user's sensor, or there is none.
pub fn is_beyond(shape: &[f64]) -> bool {
    shape.get(4) == Some(&BEYOND)
}

/// The shape of a spring that only the torque shows.
pub(super) fn by_torque([stiffness, damping, inertia]: [f64; 3]) -> Vec<f64> {
    vec![stiffness, damping, inertia, BY_TORQUE, BEYOND]
}

/// The same where the measured motion drives it, and it is slow.
pub(super) fn by_motion([stiffness, damping, inertia]: [f64; 3]) -> Vec<f64> {
    vec![stiffness, damping, inertia, SLOW, BEYOND]
}

/// Whether it is one of these.
pub fn is_slow(shape: &[f64]) -> bool {
    shape.get(3) == Some(&SLOW)
}

/// Angle [rad] and speed [rad/s] of the load less the motor's.
type Swings = (Vec<f64>, Vec<f64>);

/// Free resonance of a motor and a load on its spring [rad/s], and its damping ratio.
///
/// * `shape` of a compliance: stiffness, damping, inertia of the load; `inertia` of both [kg m2]
pub fn resonance(shape: &[f64], inertia: f64) -> (f64, f64) {
    let both = 1.0 / shape[2] + 1.0 / (inertia - shape[2]).max(1e-15);
    let swing = (shape[0] * both).sqrt();
    (swing, 0.5 * shape[1] * both / swing)
}

/// What a load on its spring would add.
///
/// * `shape` stiffness, damping, inertia of the load, [`BY_TORQUE`] where the torque drives it, and whether it [`is_beyond`]
pub(super) fn contribution(shape: &[f64], s: &Signals, c: &RigConstants) -> Contribution {
    let (stiffness, damping, inertia, rate_hz) = (shape[0], shape[1], shape[2], s.rate_hz);
    if shape.get(3) == Some(&BY_TORQUE) {
        let motor = c.inertia - inertia;
        if motor <= 0.0 {
            return Contribution::default();
        }
        let friction = |k: usize| [c.effect.viscous * s.omega[k], c.effect.coulomb * s.sign[k]];
        let torque: Vec<f64> = (0..s.n)
            .map(|k| c.effect.torque_constant * drive(s, c, k) - friction(k).iter().sum::<f64>())
            .collect();
        // what the phases carry while it steps is their mean all the same
        let means = s.on_time();
        let resting: Vec<bool> = s
            .resting
            .iter()
            .zip(&s.stepping)
            .map(|(r, s)| *r && !(means && *s))
            .collect();
        let spring = Shaken {
            stiffness,
            damping,
            inertia,
            motor,
            rate_hz,
            torque: &torque,
            accel: &s.accel,
            resting: &resting,
            means,
        };
        // what is no friction of the motor is left to its torque
        return columns(shape, s, c, |load, moved| spring.swings(load, moved));
    }
    let (motion, speed) = (sharpened(&s.theta, s.smooth), sharpened(&s.omega, s.smooth));
    let spring = Spring {
        stiffness,
        damping,
        inertia,
        rate_hz,
        motion: &motion,
        speed: &speed,
    };
    let start = if is_beyond(shape) {
        (0.0, 0.0)
    } else {
        released(s, &spring)
    };
    columns(shape, s, c, |load, _| spring.swings(start, load, s.n))
}

/// The columns of a load on its spring.
///
/// * `swings` under a torque against the load, given with what of it was friction of the motor [N m]
fn columns(shape: &[f64], s: &Signals, c: &RigConstants, swings: impl Fn(&[f64], &[f64]) -> Swings) -> Contribution {
    let mut out = Contribution::default();
    let seen = !is_beyond(shape);
    // torque drives the common centre of both masses, from which the motor is off by the load's share of the inertia
    let behind = -shape[2] / c.inertia.max(1e-15);
    let pieces = |(deflection, slip): Swings| -> Column {
        let share = |x: &[f64]| x.iter().map(|x| behind * x).collect();
        let mut all = vec![
            Piece::of(Equation::Kinematic, 0, share(&deflection)),
            Piece::of(Equation::Kinematic, 1, share(&slip)),
        ];
        if seen {
            all.push(Piece::of(Equation::Transmission, 0, deflection));
        }
        all
    };
    let base = swings(&s.load, &vec![0.0; s.n]);
    // drag and dry friction behind the spring, as a share of what there is in all; and of the load what acts on the motor instead
    let times = |x: &[f64], by: f64| -> Vec<f64> { x.iter().map(|x| by * x).collect() };
    let mut elsewhere = vec![
        times(&s.omega, wide(c.effect.viscous)),
        times(&s.sign, wide(c.effect.coulomb)),
    ];
    if s.has_load {
        elsewhere.push(times(&s.load, -1.0));
    }
    for moved in elsewhere {
        let both: Vec<f64> = s.load.iter().zip(&moved).map(|(l, t)| l + t).collect();
        let (mut x, mut w) = swings(&both, &moved);
        x.iter_mut().zip(&base.0).for_each(|(x, b)| *x -= b);
        w.iter_mut().zip(&base.1).for_each(|(w, b)| *w -= b);
        out.linear.push(pieces((x, w)));
    }
    // the play follows the load, not the motor
    if c.play > 0.0 && seen {
        let load: Vec<f64> = s.theta.iter().zip(&base.0).map(|(t, d)| t + d).collect();
        let (with, without) = (s.played(&load, c.play), s.played(&s.theta, c.play));
        let lags = with.iter().zip(&load).zip(without.iter().zip(&s.theta));
        let more = lags.map(|((f, x), (f0, t))| (f - x) - (f0 - t)).collect();
        out.fixed.push(Piece::of(Equation::Transmission, 0, more));
    }
    out.fixed.extend(pieces(base));
    out
}
