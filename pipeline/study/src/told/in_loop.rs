//! What only the closed loop shows of an actuator of ours: how late its controller's output is. The equations take the measured
//! current as it came; the numerical test bench under the recorded command, late by one delay or another, says which fits.

use crate::measured::bench::{Bench, BenchChannel, Role};
use crate::measured::sums::scatter;
use crate::search::beside::{Beside, found};
use crate::told::command;
use crate::told::verify::{self, AT_ONCE, OfRuns, Simulated, Verification};
use schemas::error::Result;
use sim_worker::effect::{Effect, EffectKind};
use sim_worker::parameters::ActuatorParameters;

/// Gap of the simulated speed over the noise of its sensor from which on the loop is looked into (assumed: without anything
/// missing it is 0.99 to 1.04).
const SUSPECT: f64 = 1.08;
/// Delays that are tried first [s], and the step between those that are tried around the best of them.
const FIRST: [f64; AT_ONCE] = [0.0, 1e-4, 2e-4, 3e-4, 4e-4, 6e-4, 8e-4, 1.1e-3];
const FINER_S: f64 = 5e-5;
/// Standard deviations from which a delay is one, and share of the speed's excess over its noise that it must take on held-out
/// runs (assumed: two late controllers of another hand took 0.91 and more, a torque that saturates beside points 0.7).
const CERTAIN: f64 = 5.0;
const LEAST_SHARE: f64 = 0.8;
/// Standard deviation of a delay in samples of the command: nobody knows what it does between them. Lines whose slope changed
/// within samples of 0.5 ms made delays of another hand's actuators 14 to 25 us too long.
const BETWEEN_SAMPLES: f64 = 0.05;

/// Squared gaps of the speed by delay, of a piece that finds or of one that proves, and its samples.
struct Piece {
    proves: bool,
    gaps: Vec<f64>,
    samples: usize,
}

/// The delay of the controller's output, where the simulated loop needs one and the recordings prove it.
///
/// * `child` the actuator with what was found, `verified` what the simulator made of it
/// * `noise` of the speed's sensor, rms [rad/s]
///
/// # Errors
/// Refuses files that cannot be read.
pub fn late_control(
    bench: &Bench,
    child: &ActuatorParameters,
    verified: &Verification,
    noise: f64,
) -> Result<Option<Beside>> {
    let speed = verified
        .channels
        .iter()
        .find(|c| c.channel == BenchChannel::Velocity.name());
    let late_already = child.effects.iter().any(|e| e.kind == EffectKind::ControlDelay);
    let quiet = speed.is_none_or(|c| c.child < SUSPECT * noise);
    if !bench.own || late_already || quiet || noise <= 0.0 || !verified.heldout {
        return Ok(None);
    }
    let (all, _) = verify::recordings(bench, &[Role::Fit, Role::Select, Role::HeldOut])?;
    let first = pieces(bench, &all, child, &FIRST);
    let Some(coarse) = least(&FIRST, &first, None).filter(|d| *d > 0.0) else {
        return Ok(None);
    };
    let around: Vec<f64> = (0..AT_ONCE)
        .map(|k| (coarse + FINER_S * (k as f64 - 0.5 * (AT_ONCE - 1) as f64)).max(0.0))
        .collect();
    let finer = pieces(bench, &all, child, &around);
    let Some(value) = least(&around, &finer, None) else {
        return Ok(None);
    };
    let finds: Vec<usize> = (0..finer.len()).filter(|p| !finer[*p].proves).collect();
    let without: Vec<f64> = finds.iter().filter_map(|p| least(&around, &finer, Some(*p))).collect();
    if without.len() < 3 {
        return Ok(None);
    }
    let step = |r: &OfRuns<'_>| r.1.time_s[1] - r.1.time_s[0];
    let between = BETWEEN_SAMPLES * all.iter().map(step).fold(0.0, f64::max);
    let sd = scatter(without.into_iter(), value).hypot(between);
    if value < CERTAIN * sd {
        return Ok(None);
    }
    let held = |pieces: &[Piece]| -> Option<f64> {
        let proving = || pieces.iter().filter(|p| p.proves);
        let samples: usize = proving().map(|p| p.samples).sum();
        (samples > 0).then(|| proving().map(|p| p.gaps[0]).sum::<f64>() / samples as f64)
    };
    let (Some(before), Some(after)) = (held(&first), held(&pieces(bench, &all, child, &[value]))) else {
        return Ok(None);
    };
    let takes = before - after > LEAST_SHARE * (before - noise * noise);
    let seen = ("speed of the simulated loop against the measured one", "rad/s");
    let rms = (before.sqrt(), after.sqrt());
    Ok(takes.then(|| found(EffectKind::ControlDelay, (value, sd), seen, rms)))
}

/// The simulated speed against the measured one, piece by piece, with each of at most [`AT_ONCE`] delays. A command that jumps within a
/// sample may do so at any moment of it, whatever the delay.
fn pieces(bench: &Bench, all: &[OfRuns<'_>], child: &ActuatorParameters, delays: &[f64]) -> Vec<Piece> {
    let late: Vec<ActuatorParameters> = delays
        .iter()
        .map(|d| {
            let mut p = child.clone();
            p.effects
                .extend((*d > 0.0).then(|| Effect::new(EffectKind::ControlDelay, &[*d])));
            p
        })
        .collect();
    let mut out = Vec::new();
    for (runs, recorded) in all {
        let Some(measured) = recorded.measured.get(&BenchChannel::Velocity) else {
            continue;
        };
        let simulated: Vec<Vec<f64>> = if recorded.jumps.is_empty() {
            let speed = |mut s: Simulated| s.remove(&BenchChannel::Velocity).unwrap_or_default();
            let all = verify::driven::<AT_ONCE>(bench, recorded, &late);
            all.into_iter().map(speed).collect()
        } else {
            let (early, late) = verify::either::<AT_ONCE>(bench, recorded, &late);
            let one = |(early, late): (&Simulated, &Simulated)| {
                let shares = command::shares(recorded, early, late);
                let speed = BenchChannel::Velocity;
                command::blend(&recorded.jumps, &shares, &early[&speed], &late[&speed])
            };
            early.iter().zip(&late).map(one).collect()
        };
        for run in runs {
            let of = recorded.samples_of(run);
            let gap = |speed: &Vec<f64>| -> f64 { of.iter().map(|&k| (measured[k] - speed[k]).powi(2)).sum() };
            out.push(Piece {
                proves: run.role == Role::HeldOut,
                gaps: simulated.iter().map(gap).collect(),
                samples: of.len(),
            });
        }
    }
    out
}

/// Delay of the least gap over the pieces that find, all but one: of a parabola through the least and its neighbours. `None`
/// at either end.
fn least(delays: &[f64], pieces: &[Piece], without: Option<usize>) -> Option<f64> {
    let of = |d: usize| -> f64 {
        let finds = pieces
            .iter()
            .enumerate()
            .filter(|(p, x)| !x.proves && Some(*p) != without);
        finds.map(|(_, x)| x.gaps[d]).sum()
    };
    let gaps: Vec<f64> = (0..delays.len()).map(of).collect();
    let k = (0..gaps.len()).min_by(|a, b| gaps[*a].total_cmp(&gaps[*b]))?;
    if k == 0 || k + 1 == gaps.len() {
        return None;
    }
    let (a, b) = (delays[k] - delays[k - 1], delays[k + 1] - delays[k]);
    let (fall, rise) = ((gaps[k - 1] - gaps[k]) / a, (gaps[k + 1] - gaps[k]) / b);
    Some(delays[k] + 0.5 * (a * b * (fall / a - rise / b) / (fall + rise).max(1e-300)).clamp(-a, b))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_least_of_a_parabola_is_found_between_uneven_delays() {
        let delays = [0.0, 1.0, 2.0, 4.0, 8.0];
        for wanted in [0.7, 1.6, 2.3, 3.5] {
            let of = |proves: bool, at: f64| Piece {
                proves,
                gaps: delays.iter().map(|d| (d - at).powi(2)).collect(),
                samples: 1,
            };
            let pieces = [of(false, wanted - 0.1), of(false, wanted + 0.1), of(true, 0.0)];
            let found = least(&delays, &pieces, None).unwrap();
            assert!((found - wanted).abs() < 1e-9, "{found} {wanted}");
            let one = least(&delays, &pieces, Some(0)).unwrap();
            assert!((one - wanted - 0.1).abs() < 1e-9, "{one}");
        }
        let rising = [Piece {
            proves: false,
            gaps: delays.to_vec(),
            samples: 1,
        }];
        assert_eq!(least(&delays, &rising, None), None);
    }
}
