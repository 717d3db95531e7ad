//! The sensors of recordings of an actuator of ours: grain, noise, offsets, and what their samples are. Pre-flight tests of the same
//! unit are seen by the same sensors, and maps must know them.

use crate::measured::bench::{Bench, BenchChannel, Role};
use crate::measured::noise as channel_noise;
use crate::told::verify::{self, Recorded, Simulated};
use schemas::error::Result;
use sim_worker::catalogue;
use sim_worker::parameters::ActuatorParameters;
use sim_worker::sensor::{CurrentSampling, Rest, Sampling, SensorModel, SpeedSource};
use std::f64::consts::TAU;

/// Samples of a block whose roughness is one number (assumed).
const BLOCK: usize = 64;
/// Share of the blocks, those about which the simulated currents are smoothest, that tell the noise of a sensor; and fewest of them
/// (assumed).
const SMOOTH: f64 = 0.05;
const FEWEST: usize = 4;
/// How much rougher points must be than means, in the simulation, for the two to be told apart (assumed).
const APART: f64 = 1.3;
/// How near a number of counts a turn must be to a power of two, relative (assumed).
const NEAR: f64 = 0.02;
/// Bits of a sensor whose grain is not seen.
const FINE_BITS: u32 = 24;
/// Chance of offsets beyond the half-width that is told.
const BEYOND: f64 = 0.05;
/// Currents of which the range is so many times the greatest (assumed).
const RANGE: f64 = 1.1;

/// The sensors that recordings are by; `None` where they are the reference's, or where there is nothing to simulate.
///
/// * `child` the actuator with what was found
///
/// # Errors
/// Refuses files that cannot be read.
pub fn seen(bench: &Bench, child: &ActuatorParameters) -> Result<Option<SensorModel>> {
    let has = |c: &BenchChannel| bench.channel(*c).is_some();
    if !bench.own || !has(&BenchChannel::Position) || !BenchChannel::CURRENTS.iter().all(has) {
        return Ok(None);
    }
    let (all, _) = verify::recordings(bench, &[Role::Fit, Role::Select, Role::HeldOut])?;
    let recorded: Vec<&Recorded> = all.iter().map(|r| &r.1).collect();
    if recorded.is_empty() {
        return Ok(None);
    }
    let (means, points): (Vec<Simulated>, Vec<Simulated>) = recorded
        .iter()
        .map(|r| verify::means_and_points(bench, r, child))
        .unzip();
    let signals = |channels: &[BenchChannel]| -> Vec<&[f64]> {
        let mut out = Vec::new();
        for r in &recorded {
            out.extend(channels.iter().filter_map(|c| r.measured.get(c).map(Vec::as_slice)));
        }
        out
    };
    let reference = catalogue::sensors("reference")?;
    let angle = channel_noise::grain(signals(&[BenchChannel::Position]).into_iter());
    let count = channel_noise::grain(signals(&BenchChannel::CURRENTS).into_iter());
    let by_means = rough(&recorded, &means, &BenchChannel::CURRENTS);
    let by_points = rough(&recorded, &points, &BenchChannel::CURRENTS);
    let currents = sampling(&by_means, &by_points, count);
    let (of_currents, simulated) = match currents {
        CurrentSampling::Mean => (by_means, &means),
        CurrentSampling::Point => (by_points, &points),
    };
    let greatest = signals(&BenchChannel::CURRENTS)
        .into_iter()
        .flatten()
        .fold(0.0, |a: f64, x| a.max(x.abs()));
    let (current_range_a, current_bits) = range_of(greatest, count);
    let speed = match bench.made_of_angle {
        Some(_) => SpeedSource::Angle,
        None => SpeedSource::Sensor,
    };
    let model = SensorModel {
        name: "as the study saw them".into(),
        resolver_bits: bits_of(angle),
        speed_noise_rad_per_s: noise(&rough(&recorded, simulated, &[BenchChannel::Velocity]), 0.0),
        current_range_a,
        current_bits,
        current_noise_a: noise(&of_currents, count).min(noise_of_sum(&recorded, count)),
        current_offset_a: offset(&recorded, simulated),
        sampling: Sampling {
            currents,
            speed,
            rest: Rest::WithinCount,
        },
    };
    let usual = reference.is_some_and(|r| {
        (r.sampling.currents, r.sampling.speed) == (currents, speed)
            && r.resolver_bits == model.resolver_bits
            && (r.current_count_a() / count - 1.0).abs() < NEAR
    });
    Ok((!usual).then_some(model))
}

/// Squares of the roughness of blocks, measured and simulated; first those about which the simulation is smooth.
fn rough(recorded: &[&Recorded], simulated: &[Simulated], channels: &[BenchChannel]) -> Vec<(f64, f64)> {
    let mut out = Vec::new();
    for (r, s) in recorded.iter().zip(simulated) {
        for c in channels {
            let (Some(x), Some(y)) = (r.measured.get(c), s.get(c)) else {
                continue;
            };
            let all: Vec<(f64, f64)> = x
                .chunks_exact(BLOCK)
                .zip(y.chunks_exact(BLOCK))
                .map(|(x, y)| (roughness(x), roughness(y)))
                .collect();
            // by what is simulated before and after: by its own, the smoothest would be smoother than what is measured in them
            out.extend(all.windows(3).map(|w| (w[0].1 + w[2].1, w[1])));
        }
    }
    out.sort_by(|a, b| a.0.total_cmp(&b.0));
    out.into_iter().map(|b| b.1).collect()
}

/// What is measured beyond what is simulated where that is smooth, rms.
///
/// * `grain` whose share is told apart
fn noise(blocks: &[(f64, f64)], grain: f64) -> f64 {
    let n = ((SMOOTH * blocks.len() as f64) as usize).max(FEWEST).min(blocks.len());
    let mut beyond: Vec<f64> = blocks[..n].iter().map(|(x, y)| x - y).collect();
    beyond.sort_by(f64::total_cmp);
    // the simulated relays may stand still where the measured ones do not
    let beyond = beyond.get(n / 2).copied().unwrap_or(0.0);
    (beyond - grain * grain / 12.0).max(0.0).sqrt()
}

/// What the sum of the phases has of noise, as much in each of them, rms: the windings meet in a star, chatter and all else of the
/// currents adds up to nothing.
///
/// * `grain` whose share is told apart
fn noise_of_sum(recorded: &[&Recorded], grain: f64) -> f64 {
    let mut squares = Vec::new();
    for r in recorded {
        let [Some(a), Some(b), Some(c)] = BenchChannel::CURRENTS.map(|c| r.measured.get(&c)) else {
            return f64::INFINITY;
        };
        let sum: Vec<f64> = a.iter().zip(b).zip(c).map(|((a, b), c)| a + b + c).collect();
        squares.extend(sum.chunks_exact(BLOCK).map(|x| roughness(x) / 3.0));
    }
    squares.sort_by(f64::total_cmp);
    let middle = squares.get(squares.len() / 2).copied().unwrap_or(f64::INFINITY);
    (middle - grain * grain / 12.0).max(0.0).sqrt()
}

/// Variance of the white noise that is as rough.
fn roughness(x: &[f64]) -> f64 {
    let all = channel_noise::fourth_differences(x).map(|d| d.powi(2));
    all.sum::<f64>() / (70.0 * (x.len() - 4) as f64)
}

/// Whether measured currents are as rough as simulated points, or as means, where the two differ.
fn sampling(means: &[(f64, f64)], points: &[(f64, f64)], grain: f64) -> CurrentSampling {
    let middle = |blocks: &[(f64, f64)], of: fn(&(f64, f64)) -> f64| {
        let rough = &blocks[blocks.len() / 2..];
        let mut all: Vec<f64> = rough.iter().map(of).collect();
        all.sort_by(f64::total_cmp);
        all.get(all.len() / 2).copied().unwrap_or(0.0)
    };
    // chatter that means do not have would count as noise of the sensor
    let of_sensor = noise(means, grain).min(noise(points, grain)).powi(2) + grain * grain / 12.0;
    let told = |blocks: &[(f64, f64)]| (middle(blocks, |b| b.1) + of_sensor).sqrt();
    let (mean, point) = (told(means), told(points));
    let measured = middle(points, |b| b.0).sqrt();
    if point > APART * mean && measured > (mean * point).sqrt() {
        CurrentSampling::Point
    } else {
        CurrentSampling::Mean
    }
}

/// Bits of a resolver of this grain [rad].
fn bits_of(grain: f64) -> u32 {
    let bits = (TAU / grain).log2();
    let near = grain > 0.0 && (bits - bits.round()).abs() < NEAR && (1.0..f64::from(FINE_BITS)).contains(&bits);
    if near { bits.round() as u32 } else { FINE_BITS }
}

/// A range that holds the greatest current, and bits, that make steps of this grain [A].
fn range_of(greatest: f64, grain: f64) -> (f64, u32) {
    let least = RANGE * greatest.max(1e-3);
    if grain <= 0.0 {
        return (least, FINE_BITS);
    }
    let bits = ((2.0 * least / grain).log2().ceil() as u32).clamp(1, FINE_BITS);
    (0.5 * grain * (1u64 << bits) as f64, bits)
}

/// Half-width of uniform offsets that is not greater in 95 % of what may have made the greatest of those that were seen [A] (of a
/// half-width of which nothing is known but its size: (greatest / half-width)^n is left beyond it).
fn offset(recorded: &[&Recorded], simulated: &[Simulated]) -> f64 {
    let (mut most, mut seen) = (0.0, 0.0);
    for (r, s) in recorded.iter().zip(simulated) {
        for c in BenchChannel::CURRENTS {
            let (Some(x), Some(y)) = (r.measured.get(&c), s.get(&c)) else {
                continue;
            };
            let mean = x.iter().zip(y).map(|(x, y)| x - y).sum::<f64>() / x.len().max(1) as f64;
            most = f64::max(most, mean.abs());
            seen += 1.0;
        }
    }
    most * BEYOND.powf(-1.0 / f64::max(seen, 1.0))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bits_and_ranges_are_of_the_grain() {
        assert_eq!(bits_of(TAU / 16384.0), 14);
        assert_eq!(bits_of(0.001), FINE_BITS);
        assert_eq!(bits_of(0.0), FINE_BITS);
        let (range, bits) = range_of(20.0, 50.0 / 4096.0);
        assert_eq!((range, bits), (25.0, 12));
        assert_eq!(range_of(20.0, 0.0).1, FINE_BITS);
    }

    #[test]
    fn noise_is_told_where_the_simulation_is_smooth() {
        let mut blocks = vec![(4e-4 + 1e-4, 1e-4); 20];
        blocks.extend(vec![(1.0, 0.5); 80]);
        assert!((noise(&blocks, 0.0) - 0.02).abs() < 1e-12);
        assert_eq!(noise(&[(1.0, 2.0)], 0.0), 0.0);
    }

    #[test]
    fn points_are_as_rough_as_points() {
        // one in five is smooth, and shows the sensor's noise
        let blocks = |measured: f64, simulated: f64| {
            let mut all = vec![(1e-3, 0.0); 10];
            all.extend(vec![(measured, simulated); 40]);
            all
        };
        for (measured, wanted) in [(1.0, CurrentSampling::Point), (0.1, CurrentSampling::Mean)] {
            assert_eq!(sampling(&blocks(measured, 0.1), &blocks(measured, 1.0), 0.0), wanted);
        }
        // at a rate at which the two are alike nothing is said
        assert_eq!(
            sampling(&blocks(1.0, 0.9), &blocks(1.0, 1.0), 0.0),
            CurrentSampling::Mean
        );
    }
}
