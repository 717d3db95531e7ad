//! What candidates and equations pass to each other: signals for the rows of an equation, and the constants they refer to.

use sim_worker::effect::{Constants, Equation};

/// A signal in an equation, to be filtered (0), or filtered and differentiated once or twice. Of the kinematic
/// equation, 0 is what stands in the measured angle, 1 what stands in the measured speed.
#[derive(Clone)]
pub struct Piece {
    pub equation: Equation,
    pub order: usize,
    pub signal: Vec<f64>,
    /// of a phase alone, where the electrical equation is one of each phase
    pub phase: Option<usize>,
}

impl Piece {
    /// Of no phase alone.
    pub fn of(equation: Equation, order: usize, signal: Vec<f64>) -> Self {
        Self {
            equation,
            order,
            signal,
            phase: None,
        }
    }
}

/// What one amplitude multiplies.
pub type Column = Vec<Piece>;

/// What a column is a share of: a constant, or 1 in its unit where there is none.
pub fn wide(x: f64) -> f64 {
    if x > 0.0 { x } else { 1.0 }
}

/// Constants of the rig that the candidates refer to.
#[derive(Clone, Copy, Debug)]
pub struct RigConstants {
    pub effect: Constants,
    pub inertia: f64,
    pub back_emf: f64,
    pub supply_voltage: f64,
    /// the drive channel is a measured current
    pub measured_current: bool,
    /// the drive channel goes through a motor, rather than being torque or force itself
    pub motor: bool,
    /// speed and acceleration come from the position
    pub from_position: bool,
    /// error of the angle sensor as far as it is known: amplitudes of sine and cosine [rad]
    pub encoder: (f64, f64),
    /// by how much the drive's sensor is off as far as it is known [drive unit], and how many samples it is late
    pub drive_error: (f64, f64),
    /// a constant torque is among the constants
    pub offset: bool,
    /// half-width of the play before the user [rad]
    pub play: f64,
    /// of the controller's law [drive unit per rad/s]
    pub speed_gain: f64,
}

impl RigConstants {
    /// The true angle behind a measured one.
    pub fn true_angle(&self, measured: f64) -> f64 {
        true_angle(self.encoder, measured)
    }
}

/// The angle behind a measured one, by fixed-point iteration.
///
/// * `a`, `b` amplitudes of sine and cosine of the sensor's error [rad]
pub fn true_angle((a, b): (f64, f64), measured: f64) -> f64 {
    let mut t = measured;
    if a != 0.0 || b != 0.0 {
        for _ in 0..4 {
            t = measured - (a * t.sin() + b * t.cos());
        }
    }
    t
}
