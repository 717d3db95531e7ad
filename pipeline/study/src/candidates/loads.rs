//! Loads behind a play or a spring, driven by the motor's measured motion or by its torque.

use crate::equations::signals::Signals;
use crate::measured::samples::between;
use nalgebra::{Matrix3, Vector3};

/// A load that the motor pushes through a gap of half-width `half`: its angle and speed. Let go, it is slowed down by its own friction.
///
/// * `slowing` friction of the load over its inertia [rad/s2]; without end it is the play operator
/// * `per_inertia` one over its inertia: how much a load torque accelerates it [1/(kg m2)]
/// * `bounce` share of its speed towards the motor with which it bounces off; 0 is a plastic impact
pub(super) fn loose(s: &Signals, half: f64, slowing: f64, per_inertia: f64, bounce: f64) -> (Vec<f64>, Vec<f64>) {
    let dt = 1.0 / s.rate_hz;
    // where the user's sensor sees it when the run begins, which is a piece of a recording as a rule
    let lag = s.user.as_ref().map_or(0.0, |u| u[0] - s.position[0]).clamp(-half, half);
    let (mut x, mut w) = (s.theta[0] + lag, s.omega[0]);
    let mut speed = Vec::with_capacity(s.n);
    let followed = (0..s.n)
        .map(|k| {
            let before = w;
            let push = -s.load[k] * per_inertia;
            // friction stops it, and holds it while nothing stronger pushes
            w += push * dt;
            let brake = slowing * dt;
            w = if w.abs() <= brake { 0.0 } else { w - brake * w.signum() };
            x += 0.5 * (before + w) * dt;
            let gap = s.theta[k] - x;
            let pushed = gap.abs() >= half;
            if pushed {
                x = s.theta[k] - half * gap.signum();
                // pushed along, unless it runs away by itself
                let along = s.omega[k];
                if (along - w) * gap > 0.0 {
                    w = along + bounce * (along - w);
                }
            }
            speed.push(w);
            x
        })
        .collect();
    (followed, speed)
}

/// How far [rad] and how fast [rad/s] the load is ahead of the motor when a run begins: what fits the user's sensor best while
/// the spring remembers it.
pub(super) fn released(s: &Signals, spring: &Spring<'_>) -> (f64, f64) {
    /// fewest and most samples that are looked at; time constants of the decay
    const FEWEST: usize = 12;
    const MOST: usize = 400;
    const DECAYS: f64 = 4.0;
    let Some(user) = s.user.as_ref() else { return (0.0, 0.0) };
    let decay = 0.5 * spring.damping / spring.inertia.max(1e-12);
    let remembered = (DECAYS * s.rate_hz / decay.max(1e-9)) as usize;
    // while it turns one way, a play before the sensor stays on one side
    let one_way = s.sign.iter().take_while(|x| **x * s.sign[0] > 0.0).count();
    let n = remembered.clamp(FEWEST, MOST).min(one_way.max(FEWEST));
    if s.n < 2 * n {
        return (0.0, 0.0);
    }
    let run = |start| spring.swings(start, &s.load, n).0;
    let still = run((0.0, 0.0));
    let free = [(1e-3, 0.0), (0.0, 1.0)].map(|start| {
        let moved = run(start);
        moved.iter().zip(&still).map(|(m, s)| m - s).collect::<Vec<f64>>()
    });
    // deflection, slip and the sensors' zeros
    let column = |i: usize, k: usize| free.get(i).map_or(1.0, |f| f[k]);
    let sum = |f: &dyn Fn(usize) -> f64| (0..n).map(f).sum::<f64>();
    let gram = Matrix3::from_fn(|i, j| sum(&|k| column(i, k) * column(j, k)));
    let right = Vector3::from_fn(|i, _| sum(&|k| column(i, k) * (user[k] - s.position[k] - still[k])));
    let x = gram.cholesky().map_or_else(Vector3::zeros, |c| c.solve(&right));
    (1e-3 * x[0], x[1])
}

/// Steps in a sample that follow a resonance.
fn substeps(natural_rad_s: f64, rate_hz: f64) -> usize {
    (natural_rad_s / rate_hz * 6.0).ceil().clamp(1.0, 8.0) as usize
}

/// Steps of a mass on its spring by the implicit midpoint rule: no damping but the spring's own.
#[derive(Clone, Copy)]
struct Midpoint {
    dt: f64,
    /// half a step over the mass
    half: f64,
    /// of the speed in the middle, for what spring and damping of its own add to it
    less: f64,
}

impl Midpoint {
    fn new(stiffness: f64, damping: f64, inertia: f64, dt: f64) -> Self {
        let half = 0.5 * dt / inertia;
        Self {
            dt,
            half,
            less: 1.0 / (1.0 + half * (0.5 * dt * stiffness + damping)),
        }
    }

    /// * `push` on it at the step's beginning, but for the damping of its own speed
    fn step(&self, (x, w): (f64, f64), push: f64) -> (f64, f64) {
        let middle = (w + self.half * push) * self.less;
        (x + middle * self.dt, 2.0 * middle - w)
    }
}

/// A load mass on its spring, driven by the motor's measured motion.
pub(super) struct Spring<'a> {
    /// [N m/rad]
    pub(super) stiffness: f64,
    /// [N m s/rad]
    pub(super) damping: f64,
    /// of the load [kg m2]
    pub(super) inertia: f64,
    pub(super) rate_hz: f64,
    /// angle [rad] and speed [rad/s] of the motor
    pub(super) motion: &'a [f64],
    pub(super) speed: &'a [f64],
}

impl Spring<'_> {
    /// Angle [rad] and speed [rad/s] of the load less the motor's over the first `n` samples.
    ///
    /// * `x0`, `w0` the same at the start
    /// * `load` torque against the load [N m]
    pub(super) fn swings(&self, (x0, w0): (f64, f64), load: &[f64], n: usize) -> (Vec<f64>, Vec<f64>) {
        let (motion, speed) = (self.motion, self.speed);
        let substeps = substeps((self.stiffness / self.inertia.max(1e-12)).sqrt(), self.rate_hz);
        let dt = 1.0 / (self.rate_hz * substeps as f64);
        let mass = Midpoint::new(self.stiffness, self.damping, self.inertia, dt);
        let (mut x, mut w) = (motion[0] + x0, speed[0] + w0);
        let (mut deflection, mut slip) = (Vec::with_capacity(n), Vec::with_capacity(n));
        for k in 0..n {
            let next = (k + 1).min(motion.len() - 1);
            deflection.push(x - motion[k]);
            slip.push(w - speed[k]);
            for j in 0..substeps {
                let share = (j as f64 + 0.5) / substeps as f64;
                let (theta, omega) = (between(motion, k, share), between(speed, k, share));
                let load = load[k] + share * (load[next] - load[k]);
                let push = self.stiffness * (theta - x) + self.damping * omega - load;
                (x, w) = mass.step((x, w), push);
            }
        }
        (deflection, slip)
    }
}

/// A load mass on its spring behind a motor that is driven by a known torque. Where no second sensor sees the load, the motor's measured
/// motion would bring its noise with it: a load that swings freely makes less torque of it, which looks like an effect. The torque's
/// noise comes out greater.
pub(super) struct Shaken<'a> {
    /// [N m/rad]
    pub(super) stiffness: f64,
    /// [N m s/rad]
    pub(super) damping: f64,
    /// of the load and of the motor [kg m2]
    pub(super) inertia: f64,
    pub(super) motor: f64,
    pub(super) rate_hz: f64,
    /// torque on the motor beside the spring's [N m]
    pub(super) torque: &'a [f64],
    /// acceleration of the motor [rad/s2], where it is at rest or turns round: what dry friction does there nobody knows
    pub(super) accel: &'a [f64],
    pub(super) resting: &'a [bool],
    /// whether the torque is a mean over each sample, whatever it does within, and the motion was there before the run began
    pub(super) means: bool,
}

impl Shaken<'_> {
    /// Angle [rad] and speed [rad/s] of the load less the motor's in the middle of each sample; the spring is at ease in the beginning, or
    /// bent by the first torque where these are means.
    ///
    /// * `load` torque against the load [N m]
    /// * `more` torque on the motor beside [`Shaken::torque`] [N m]
    pub(super) fn swings(&self, load: &[f64], more: &[f64]) -> (Vec<f64>, Vec<f64>) {
        let n = self.torque.len();
        let load_share = 1.0 / self.inertia.max(1e-12);
        let both = load_share + 1.0 / self.motor.max(1e-12);
        let substeps = substeps((self.stiffness * both).sqrt(), self.rate_hz);
        // the middle of a sample is between two of them
        let substeps = if self.means {
            substeps.next_multiple_of(2)
        } else {
            substeps
        };
        let dt = 1.0 / (self.rate_hz * substeps as f64);
        // acceleration of the load less the motor's, but for the spring's
        let pushes: Vec<f64> = (0..n)
            .map(|k| {
                let of_motor = if self.resting[k] {
                    self.accel[k]
                } else {
                    (self.torque[k] + more[k]) / self.motor.max(1e-12)
                };
                -of_motor - load[k] * load_share
            })
            .collect();
        // of the motor held, and of both masses
        let swings = [load_share, both].map(|share| {
            let (stiffness, damping) = (self.stiffness * share, self.damping * share);
            (stiffness, Midpoint::new(stiffness, damping, 1.0, dt))
        });
        let swing = |k: usize| swings[usize::from(!self.resting[k])];
        let first = if self.means { pushes[0] / swing(0).0 } else { 0.0 };
        let (mut x, mut w) = (first, 0.0);
        let (mut deflection, mut slip) = (Vec::with_capacity(n), Vec::with_capacity(n));
        for k in 0..n {
            let (stiffness, mass) = swing(k);
            // means hold from half a sample before to half a sample after the middle
            let middle = if self.means { substeps / 2 } else { 0 };
            for j in 0..substeps {
                if j == middle {
                    deflection.push(x);
                    slip.push(w);
                }
                let push = if self.means {
                    pushes[k]
                } else {
                    between(&pushes, k, (j as f64 + 0.5) / substeps as f64)
                };
                (x, w) = mass.step((x, w), push - stiffness * x);
            }
        }
        (deflection, slip)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two masses under a torque that steps within samples, integrated in fine steps from motion at one acceleration: from the mean torques
    /// alone the deflection comes out to a percent. With the torque between two samples a cubic it would be off by five.
    #[test]
    fn mean_torques_bend_a_spring_as_the_torque_itself_does() {
        let (stiffness, damping, inertia, motor, rate_hz) = (11.4, 5.2e-3, 8.7e-6, 1.75e-5, 2000.0);
        let n = 400;
        let torque = |t: f64| 0.2 - 0.5 * f64::from(t > 0.0501) + 0.6 * f64::from(t > 0.1203);
        let (fine, dt) = (200, 1.0 / (rate_hz * 200.0));
        let mut x: f64 = -0.2 * inertia / (stiffness * (motor + inertia));
        let (mut w, mut means, mut true_x) = (0.0, Vec::new(), Vec::new());
        for k in 0..n {
            let mut sum = 0.0;
            for j in 0..fine {
                if j == fine / 2 {
                    true_x.push(x);
                }
                let tau = torque((k * fine + j) as f64 * dt);
                sum += tau / fine as f64;
                let spring = -stiffness * x - damping * w;
                w += dt * (spring / inertia - (tau - spring) / motor);
                x += dt * w;
            }
            means.push(sum);
        }
        let none = vec![0.0; n];
        let run = |means_hold| {
            let spring = Shaken {
                stiffness,
                damping,
                inertia,
                motor,
                rate_hz,
                torque: &means,
                accel: &none,
                resting: &vec![false; n],
                means: means_hold,
            };
            let found = spring.swings(&none, &none).0;
            let squares = |f: &dyn Fn(usize) -> f64| (0..n).map(|k| f(k).powi(2)).sum::<f64>().sqrt();
            squares(&|k| found[k] - true_x[k]) / squares(&|k| true_x[k])
        };
        let (by_means, by_cubic) = (run(true), run(false));
        println!("off by {by_means:.4}, by a cubic from rest {by_cubic:.4}");
        assert!(by_means < 0.03 && by_means < 0.5 * by_cubic, "{by_means} {by_cubic}");
    }
}
