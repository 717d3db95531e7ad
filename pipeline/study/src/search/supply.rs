//! The voltage of an actuator's supply, where it is measured.

use crate::equations::phases::size_of;
use crate::measured::bench::{Bench, BenchChannel};
use crate::measured::recording::Run;
use crate::measured::sums::scatter;
use nalgebra::{Matrix3, Vector3};

/// What a sensor of the supply's voltage is good for, at best (assumed).
const KNOWN: f64 = 1e-4;

/// Voltage with nothing drawn, and its standard deviation [V]: what a plane through the measured voltage, over the power and the
/// size of the currents, begins with. `None` where it is not measured or the bench says it, or where it cannot be told from what
/// the actuator's file has.
pub fn at_rest(bench: &Bench, runs: &[&Run]) -> Option<(f64, f64)> {
    let rig = &bench.rig;
    if !bench.has_phases() || !rig.from_model.contains(&"supply_voltage") {
        return None;
    }
    // sums of the pieces, each of which is left out once: what that changes says how well it is known
    let mut sums: Vec<(Matrix3<f64>, Vector3<f64>)> = Vec::new();
    for run in runs {
        let three = |c: [BenchChannel; 3]| c.iter().map(|c| run.channel(*c)).collect::<Option<Vec<_>>>();
        let (volts, currents) = (three(BenchChannel::VOLTAGES), three(BenchChannel::CURRENTS)?);
        let angle = run.channel(BenchChannel::Position);
        let power = |k: usize| match (&volts, angle) {
            (Some(v), _) => (0..3).map(|q| v[q][k] * currents[q][k]).sum(),
            // what turns the motor and what warms it
            (None, Some(x)) => {
                let (size, before) = (size_of(&currents, k), k.saturating_sub(1));
                let speed = (x[k] - x[before]) * run.rate_hz;
                (rig.drive_constant.value * speed.abs() + rig.resistance.value * size) * size
            }
            (None, None) => 0.0,
        };
        let dc = run.channel(BenchChannel::VDc)?;
        // of half a second or so
        let pieces = ((2.0 * dc.len() as f64 / run.rate_hz) as usize).max(1);
        for piece in 0..pieces {
            let (mut gram, mut right) = (Matrix3::zeros(), Vector3::zeros());
            for k in piece * dc.len() / pieces..(piece + 1) * dc.len() / pieces {
                let power: f64 = power(k);
                let x = Vector3::new(1.0, power / dc[k].max(1.0), size_of(&currents, k));
                gram += x * x.transpose();
                right += (dc[k] - rig.supply_voltage) * x;
            }
            sums.push((gram, right));
        }
    }
    if sums.len() < 3 {
        return None;
    }
    let without = |out: Option<usize>| {
        let kept = || sums.iter().enumerate().filter(|(p, _)| Some(*p) != out).map(|(_, s)| s);
        let gram: Matrix3<f64> = kept().map(|s| s.0).sum();
        let right: Vector3<f64> = kept().map(|s| s.1).sum();
        Some(rig.supply_voltage + gram.cholesky()?.solve(&right)[0])
    };
    let volts = without(None)?;
    let each = (0..sums.len())
        .map(|p| without(Some(p)))
        .collect::<Option<Vec<f64>>>()?;
    let sd = scatter(each.into_iter(), volts).max(KNOWN * volts);
    let is_other = (volts - rig.supply_voltage).abs() > 3.0 * sd;
    (volts.is_finite() && volts > 0.0 && is_other).then_some((volts, sd))
}
