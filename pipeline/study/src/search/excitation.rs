//! Which effects the data cannot show, so that they are neither looked for nor ruled out.

use crate::equations::signals::Signals;
use crate::measured::bench::BenchChannel;
use crate::measured::recording::extent;
use crate::search::select::Material;
use crate::search::spectrum::LEAST_OF_TURN;
use sim_worker::effect::{EffectKind, Equation};

/// Effects that the data cannot show, and why.
pub fn not_excited(m: &Material) -> Vec<(String, String)> {
    use EffectKind as K;
    let has = |c: BenchChannel| m.has(c);
    let span = |f: &dyn Fn(&Signals) -> Vec<f64>| -> f64 {
        let (low, high) = extent(m.fit.signals.iter().flat_map(f));
        high - low
    };
    let stroke = span(&|s| s.theta.clone());
    let warm = has(BenchChannel::Temperature).then(|| span(&|s| s.temperature.clone().unwrap_or_default()));
    let loads = span(&|s| s.load_level.clone());
    let mut drive: Vec<f64> = m.fit.signals.iter().flat_map(|s| &s.drive).map(|u| u.abs()).collect();
    drive.sort_by(f64::total_cmp);
    let kt = m.bench.rig.drive_constant.value;
    let torque = drive.last().copied().unwrap_or(0.0) * kt;
    // of all but the transients
    let usual = drive.get(drive.len() * 19 / 20).copied().unwrap_or(0.0) * kt;
    let electrical = m.equations.contains(&Equation::Electrical);
    let fastest = m
        .fit
        .signals
        .iter()
        .flat_map(|s| &s.omega)
        .fold(0.0, |a: f64, w| a.max(w.abs()));
    // with a nominal drag of a twentieth of the torque, a change of it shows
    let slow = m.constants.effect.viscous * fastest < 0.005 * usual && stroke > 0.0;
    let why = |k: K| -> Option<&'static str> {
        match k {
            K::LoadDependentFriction if !has(BenchChannel::Load) => Some("no channel `load`"),
            K::LoadDependentFriction if loads < 0.02 * torque => Some("the load hardly changes"),
            K::TemperatureDependentFriction if warm.is_none() => Some("no channel `temperature`"),
            K::WindingHeating if !electrical => Some("no voltage beside a measured current"),
            K::TemperatureDependentFriction if warm.is_some_and(|w| w < 3.0) => {
                Some("the temperature changes by less than 3 K")
            }
            K::SupplySag | K::DeadTime if !electrical => Some("no voltage beside a measured current"),
            // of one phase it makes the torque ripple
            K::CurrentGain if !electrical && !m.bench.has_phases() => Some("no voltage beside a measured current"),
            K::Backlash if !has(BenchChannel::UserPosition) => Some("no channel `user_position`"),
            // where there is no other sensor, the torque that a motion takes shows what its angle has too much
            K::EncoderEccentricity if stroke < std::f64::consts::TAU => Some("the motor turns by less than one turn"),
            K::ControlDelay if m.bench.own => {
                Some("the band of the drive's current control hides it, and no simulated loop was there to show it")
            }
            K::ControlDelay if m.bench.rig.controller.is_none() || !m.has(BenchChannel::Command) => {
                Some("no command, or no law in [rig.controller]")
            }
            K::Eccentricity if stroke < 0.5 => Some("the motor turns by less than half a radian"),
            K::CommutationOffset | K::TurnShort if stroke < std::f64::consts::TAU => {
                Some("the motor turns by less than one turn")
            }
            // several periods of a high order are in a part of a turn
            K::PeriodicFriction | K::Cogging | K::TorqueRipple if stroke < LEAST_OF_TURN * std::f64::consts::TAU => {
                Some("the motor turns by less than a quarter of a turn")
            }
            K::QuadraticDrag | K::ViscousAsymmetry if slow => Some("too slow for drag to show"),
            _ => None,
        }
    };
    K::ALL
        .iter()
        .filter_map(|k| why(*k).map(|w| (k.name().to_string(), w.to_string())))
        .collect()
}
