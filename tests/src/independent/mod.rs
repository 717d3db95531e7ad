//! An independent simulator of one electromechanical actuator, and a generator of recordings with one hidden effect.
//!
//! This module judges the program around it and therefore shares no code with it: it uses `std`, `rand` and
//! `rand_chacha` only, and was written from three pages alone, the model of the actuator and its bench, the table of
//! effects, and the list of interface names. It is checked against the numbers printed at the end of the model's page
//! and against the equations themselves (see `tests`), never against an estimator.
//!
//! Assumed where those pages leave something open:
//! * **Signs.** Mechanical effects are load torques: `J w' = TM - C w - FF - M`. A positive `bias_torque`, `cogging` or
//!   `spring_load` value opposes positive motion. Friction-like effects raise the level of the friction law instead.
//! * **Angles.** Orders and phases count the rotor angle `theta_m` (not the electrical angle), cosines throughout;
//!   `encoder_eccentricity` is a sine, measured minus true.
//! * **Static friction** follows a raised dynamic level: it is never below the dynamic level at standstill.
//! * **FSJ** scales the unit's own `FS0` (and with it the dynamic level), not the hidden effect.
//! * **Currents.** `current_gain` is a factor of all three sensors, `current_offset` sits in the sensor of phase a. The
//!   drive closes its loop on the same sensors.
//! * **Sensors.** The stated noise applies to every telemetry sample whatever its rate. Voltages are free of noise.
//! * **User position.** From the resolver through the gear; a unit with `compliance` or `backlash` has its own sensor at
//!   the load, of the same resolution.
//! * **Compliance** adds its inertia to the rotor's. **Backlash** is the play of the model's page, `gap` its full width
//!   at the motor side (the type's own is 0.02 rad).
//! * **Dahl friction** replaces the friction law of the page and has no static level above the dynamic one.
//! * **Phase voltages** are ideal leg voltage minus the true star point. **Dead time** takes its voltage from each leg
//!   behind that point of measurement, linear within +-0.05 A.
//! * **Supply sag** is the resistance times the magnitude of the present current of the legs that are switched up; the
//!   supply has neither capacitor nor delay.
//! * **Turn short** scales a phase's `k`, `R` and `L` alike; the star point then follows from the currents' zero sum.
//! * **Angles of the drive.** Its electrical angle is the measured one plus `commutation_offset`; an eccentric encoder
//!   falsifies the recorded angle and the commutation, not the measured speed.
//! * **Control delay** delays the current demand, the output of the speed loop.
//! * **Winding heating** is constant over a run, above 20 deg C; half of these units record a column `temperature`.
//! * No external load `TR`, hence no `load_dependent_friction`, and no `temperature_dependent_friction`.

mod cases;
mod commands;
mod draw;
mod effects;
mod plant;
mod shapes;
mod telemetry;
#[cfg(test)]
mod tests;
#[cfg(test)]
mod tests_effects;

pub use cases::{Key, UnitKey, keys_json, make, make_unit};
pub use commands::{Command, Segment, Sine};
pub use effects::{EFFECTS, Effect};
pub use plant::{DT, Plant};
pub use telemetry::{Telemetry, record};

/// Parameters of one actuator with its drive, and what is hidden in it. SI, motor side unless said.
#[derive(Clone, Debug, PartialEq)]
pub struct Unit {
    /// Supply voltage [V].
    pub vs: f64,
    /// Phase resistance [ohm].
    pub r: f64,
    /// Phase inductance [H].
    pub l: f64,
    /// Phase back-EMF coefficient [V s/rad].
    pub ke: f64,
    /// The drive's torque constant [N m/A]: nominal, whatever the flux.
    pub ktc: f64,
    /// Pole pairs.
    pub pole_pairs: u32,
    /// Half-band of the current relays [A].
    pub hb: f64,
    /// Inertia [kg m2].
    pub j: f64,
    /// Viscous coefficient [N m s/rad].
    pub c: f64,
    /// Static friction torque of the healthy unit [N m].
    pub fs0: f64,
    /// Dynamic over static friction.
    pub fd_ratio: f64,
    /// Gear ratio, motor over user.
    pub gear: f64,
    /// Position gain [(rad/s motor) / (rad user)].
    pub gap_gain: f64,
    /// Limit of the speed reference [rad/s].
    pub wmax: f64,
    /// Proportional gain of the speed loop [N m s/rad].
    pub kp: f64,
    /// Integral gain of the speed loop [N m/rad].
    pub ki: f64,
    /// Limit of the current reference [A].
    pub imax: f64,
    /// Torque saturation [N m].
    pub tmax: f64,
    /// Limit of the integrator [N m].
    pub tint: f64,
    /// Half-width of the play at the user shaft [rad].
    pub b: f64,
    /// End stops at the user shaft, plus and minus [rad].
    pub stop: f64,
    /// Rotor angle at rest [rad].
    pub th0: f64,
    /// Whether recordings carry a column `temperature` (only drawn together with `winding_heating`).
    pub thermometer: bool,
    /// Hidden effects.
    pub effects: Vec<Effect>,
}

impl Default for Unit {
    /// The nominal actuator, nothing hidden.
    fn default() -> Self {
        Unit {
            vs: 48.0,
            r: 1.065,
            l: 360e-6,
            ke: 0.0376,
            ktc: 0.0752,
            pole_pairs: 2,
            hb: 0.1,
            j: 2.5e-5,
            c: 3e-5,
            fs0: 0.03,
            fd_ratio: 0.7,
            gear: 500.0,
            gap_gain: 1e5,
            wmax: 838.0,
            kp: 0.05,
            ki: 0.5,
            imax: 22.5,
            tmax: 1.7,
            tint: 1.7,
            b: 2e-5,
            stop: 1.2,
            th0: 0.0,
            thermometer: false,
            effects: Vec::new(),
        }
    }
}
