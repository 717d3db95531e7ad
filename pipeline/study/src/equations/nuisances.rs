//! What is fitted along with every model: constants of the machine and imperfections of its sensors, with what is
//! believed of each; and which equations the channels open.

use crate::equations::blur;
use crate::equations::clock::{Clock, NoiseTable};
use crate::equations::pieces::{RigConstants, wide};
use crate::measured::bench::{Bench, BenchChannel, Known};
use crate::measured::recording::{Run, range};
use sim_worker::effect::{Constants, Equation};

/// Uncertainty of what is never perfect in sensors, one sigma (assumed): gain, offset over noise,
/// clock between channels over the sample.
const SENSOR_GAIN: f64 = 0.006;
const SENSOR_OFFSET: f64 = 0.1;
/// Offset of a sensor of current or voltage over the range it saw, one sigma (assumed).
pub const SENSOR_OFFSET_OF_RANGE: f64 = 0.002;
const SENSOR_CLOCK: f64 = 0.15;
/// Same of current and voltage, which one drive takes at once (assumed): to the inductance a voltage that is late is the same.
const VOLTAGE_CLOCK: f64 = 0.03;
/// Most that a constant may be off, natural logarithm.
const MOST_LOG: f64 = 20.0;
/// Least offset of a voltage over its noise, one sigma (assumed): amplifiers drift more than current sensors.
const VOLTAGE_OFFSET: f64 = 0.4;
/// A nuisance parameter of the whole study.
#[derive(Clone, Debug, PartialEq)]
pub struct Nuisance {
    pub name: &'static str,
    /// one sigma of its relative deviation; `None` = free
    pub trust: Option<f64>,
    /// where the prior has its middle: 0, or elsewhere once the equations stand around a better value
    pub centre: f64,
    /// value that the deviation is relative to, SI at the motor
    pub nominal: f64,
    pub unit: &'static str,
    /// a property of the machine rather than of its sensors
    pub of_machine: bool,
}

impl Nuisance {
    /// With what was told of it apart from the equations.
    fn beside(mut self, told: Option<Known>) -> Self {
        if let Some(Known { value, trust: Some(sd) }) = told.filter(|_| self.nominal > 0.0) {
            let weight = |trust: Option<f64>| trust.map_or(0.0, |t| t.powi(-2));
            let sd = sd * value / self.nominal;
            let (before, now) = (weight(self.trust), weight(Some(sd)));
            self.centre = (self.centre * before + (value / self.nominal - 1.0) * now) / (before + now);
            self.trust = Some((before + now).sqrt().recip());
        }
        self
    }

    /// A deviation over what it may be at most. Upwards a constant's counts by its logarithm: of one that was said to be 40 % of what it
    /// is 60 % were missing, not 150 % too many.
    ///
    /// * `most` from the middle of what is believed
    pub fn strain(&self, x: f64, most: f64) -> f64 {
        let (off, middle) = (x - self.centre, 1.0 + self.centre);
        if self.of_machine && off > 0.0 && middle > 0.0 {
            return off / (middle * (most / middle).min(MOST_LOG).exp_m1());
        }
        off.abs() / most
    }
}

/// The rig's constants as the equations use them.
pub fn constants(bench: &Bench, clock: &Clock) -> RigConstants {
    let rig = &bench.rig;
    RigConstants {
        effect: Constants {
            torque_constant: rig.drive_constant.value,
            coulomb: rig.coulomb.value,
            break_away: rig.break_away,
            viscous: rig.viscous.value,
            resistance: rig.resistance.value,
            inductance: rig.inductance.value,
            pole_pairs: rig.pole_pairs,
        },
        inertia: rig.inertia.value,
        back_emf: rig.back_emf.value,
        supply_voltage: rig.supply_voltage,
        measured_current: rig.drive == BenchChannel::Current,
        motor: matches!(rig.drive, BenchChannel::Current | BenchChannel::Voltage),
        from_position: clock.from_position,
        encoder: rig.encoder,
        drive_error: rig.drive_error,
        offset: rig.offset != 0.0,
        play: rig.play,
        speed_gain: rig.controller.as_ref().map_or(0.0, |l| l.speed_gain),
    }
}

/// The nuisance parameters of a bench: the machine's, then the sensors'.
pub fn nuisances(bench: &Bench, runs: &[Run], noise: &NoiseTable, equations: &[Equation]) -> Vec<Nuisance> {
    let rig = &bench.rig;
    let machine = |name, k: &Known, unit| Nuisance {
        name,
        trust: k.trust,
        centre: 0.0,
        nominal: k.value,
        unit,
        of_machine: true,
    };
    let sensor = |name, sigma: f64, unit| Nuisance {
        name,
        trust: Some(sigma),
        centre: 0.0,
        nominal: 1.0,
        unit,
        of_machine: false,
    };
    let noise_of = |c: BenchChannel| noise.get(&c).map_or(0.0, |n| n.rms);
    let has = |e: Equation| equations.contains(&e);
    // where a measured load says what a torque is, the drive's gain is no longer a matter of scale alone
    let mut drive_constant = rig.drive_constant;
    if bench.channel(BenchChannel::Load).is_some() {
        drive_constant.trust = drive_constant.trust.map(|t| t.hypot(SENSOR_GAIN));
    }
    let mut out = vec![
        machine("inertia", &rig.inertia, "kg m2"),
        machine("viscous", &rig.viscous, "N m s/rad"),
        machine("coulomb", &rig.coulomb, "N m"),
        machine("torque_constant", &drive_constant, rig.constant_unit()),
    ];
    if rig.offset != 0.0 {
        let offset = Known {
            value: rig.offset,
            trust: None,
        };
        out.push(machine("offset", &offset, "N m"));
    }
    // a command that its drive follows late has an effect of its own for it, where the law is known
    if rig.drive == BenchChannel::Current || rig.controller.is_none() {
        out.push(sensor("drive_clock", SENSOR_CLOCK, "sample"));
    }
    let all: Vec<&Run> = runs.iter().collect();
    let spec = bench.channel(rig.drive);
    let offset = spec.and_then(|s| s.offset).unwrap_or_else(|| {
        let of_range = SENSOR_OFFSET_OF_RANGE * range(&all, rig.drive);
        (SENSOR_OFFSET * noise_of(rig.drive)).max(of_range)
    });
    if offset > 0.0 && !runs.iter().any(|r| r.steady) {
        out.push(sensor("drive_offset", offset, rig.drive.quantity().si()));
    }
    if has(Equation::Electrical) {
        out.push(machine("resistance", &rig.resistance, "ohm"));
        out.push(machine("inductance", &rig.inductance, "H").beside(rig.inductance_by_points));
        // gains of six sensors are as good as none: scale is what the machine's own constants say
        let gain = if bench.has_phases() { 1e-4 } else { SENSOR_GAIN };
        out.push(sensor("drive_gain", gain, "-"));
        let said = bench.channel(BenchChannel::Voltage).and_then(|s| s.offset);
        let of_range = SENSOR_OFFSET_OF_RANGE * range(&all, BenchChannel::Voltage);
        let offset = (VOLTAGE_OFFSET * noise_of(BenchChannel::Voltage)).max(of_range);
        out.push(sensor("voltage_offset", said.unwrap_or(offset), "V"));
        out.push(sensor("voltage_gain", gain, "-"));
        out.push(sensor("voltage_clock", VOLTAGE_CLOCK, "sample"));
        out.push(sensor("motion_clock", SENSOR_CLOCK, "sample"));
        let blur = blur::of_inductance(bench, &all, noise);
        if blur > 0.0 {
            // to the rows an inductance of its own
            out.push(sensor("between_samples", blur / wide(rig.inductance.value), "-"));
        }
    }
    if has(Equation::Transmission) && rig.play > 0.0 {
        let play = Known {
            value: rig.play,
            trust: Some(1.0),
        };
        out.push(machine("play", &play, "rad"));
    }
    if has(Equation::Transmission) {
        out.push(sensor("user_clock", SENSOR_CLOCK, "sample"));
    }
    if has(Equation::Kinematic) {
        out.push(sensor("velocity_gain", SENSOR_GAIN, "-"));
        out.push(sensor("velocity_offset", noise_of(BenchChannel::Velocity), "rad/s"));
        out.push(sensor("velocity_clock", SENSOR_CLOCK, "sample"));
    }
    if has(Equation::Controller) {
        out.push(sensor("law_gain", 0.05, "-"));
        out.push(sensor("law_clock", 0.1, "sample"));
    }
    out
}

/// Which equations the channels of all runs open.
pub fn equations(bench: &Bench, runs: &[&Run]) -> Vec<Equation> {
    let has = |c: BenchChannel| runs.iter().all(|r| r.channel(c).is_some());
    let current = bench.rig.drive == BenchChannel::Current;
    let mut out = vec![Equation::Torque];
    let phases = bench.has_phases() && BenchChannel::VOLTAGES.iter().all(|c| has(*c));
    // three currents need three voltages
    if current && (phases || has(BenchChannel::Voltage) && !bench.has_phases()) {
        out.push(Equation::Electrical);
    }
    if has(BenchChannel::Position) && has(BenchChannel::UserPosition) {
        out.push(Equation::Transmission);
    }
    if has(BenchChannel::Position) && has(BenchChannel::Velocity) {
        out.push(Equation::Kinematic);
    }
    if bench.rig.controller.is_some() && has(BenchChannel::Command) && current {
        out.push(Equation::Controller);
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_was_said_far_too_low_is_as_far_off_as_what_was_said_far_too_high() {
        let n = |of_machine: bool, centre: f64| Nuisance {
            name: "inertia",
            trust: Some(0.3),
            centre,
            nominal: 1.0,
            unit: "kg m2",
            of_machine,
        };
        // 40 % of what it is, at four times 30 %
        assert!((n(true, 0.0).strain(1.5, 1.2) - 1.5 / 1.2f64.exp_m1()).abs() < 1e-12);
        assert!(n(true, 0.0).strain(1.5, 1.2) < 1.0 && n(false, 0.0).strain(1.5, 1.2) > 1.0);
        assert_eq!(n(true, 0.0).strain(-0.6, 1.2), 0.5);
        // around another value: what is believed moves along
        let moved = n(true, 0.25).strain(1.25, 1.0);
        assert!((moved - 1.0 / (1.25 * 0.8f64.exp_m1())).abs() < 1e-12, "{moved}");
    }
}
