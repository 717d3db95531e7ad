//! Noise of channels: what a bench says, what runs that were meant to be alike say, or what stands in the recordings themselves.

use crate::measured::bench::{BenchChannel, ChannelSpec, Noise, Role};
use crate::measured::recording::{Run, range};

/// Steps of a signal that tell its grain: most grains of one, most of the least one, how far off a whole number, fewest (assumed).
const MOST_GRAINS: f64 = 64.0;
const MOST_PARTS: usize = 32;
const OFF_GRAIN: f64 = 0.05;
const FEWEST_STEPS: usize = 60;
/// Noise by the fourth differences, whose median is whole grains, over that of the grain alone up to which there is no other (assumed).
const GRAIN_ALONE: f64 = 2.0;

/// Noise of a channel.
#[derive(Clone, Copy, Debug, Default)]
pub struct ChannelNoise {
    /// of one sample, SI at the motor
    pub rms: f64,
    /// correlation from sample to sample (first-order, 0 = white)
    pub colour: f64,
    /// what its values are whole numbers of, as the bench says or as is seen; 0 where neither
    pub grain: f64,
}

impl ChannelNoise {
    /// rms of white noise that is as strong at low frequencies
    pub fn slow_rms(&self) -> f64 {
        let c = self.colour.clamp(0.0, 0.9);
        self.rms * ((1.0 + c) / (1.0 - c)).sqrt()
    }
}

/// Noise of a channel, resolution included; SI at the motor.
pub fn noise(spec: &ChannelSpec, runs: &[Run]) -> ChannelNoise {
    let spreads: Vec<f64> = runs
        .iter()
        .filter_map(|r| r.spread.get(&spec.channel))
        .copied()
        .collect();
    if !spreads.is_empty() {
        let mean = spreads.iter().map(|s| s * s).sum::<f64>() / spreads.len() as f64;
        return ChannelNoise {
            rms: mean.sqrt(),
            colour: 0.0,
            grain: spec.resolution,
        };
    }
    let grain = spec.resolution / 12f64.sqrt();
    let white = match spec.noise {
        Noise::Known(x) => x,
        Noise::Repeats => from_repeats(spec.channel, runs)
            .unwrap_or_else(|| within_range(estimated(spec.channel, runs), spec.channel, runs)),
        Noise::Estimated => {
            let grain = grain_of(spec.channel, runs).max(spec.resolution);
            let of_grain = grain / 12f64.sqrt();
            let all = estimated(spec.channel, runs);
            let rms = if of_grain == 0.0 {
                within_range(all, spec.channel, runs)
            } else if all < GRAIN_ALONE * of_grain {
                of_grain
            } else {
                all
            };
            return ChannelNoise {
                rms,
                colour: 0.0,
                grain,
            };
        }
    };
    let colour = if white > 2.0 * grain {
        colour(spec.channel, white, runs)
    } else {
        0.0
    };
    ChannelNoise {
        rms: white.hypot(grain),
        colour,
        grain: spec.resolution,
    }
}

/// Correlation from sample to sample of the noise of a channel whose rms is known: from the energy
/// of its fourth differences, in which a smooth signal leaves little. Stretches in which they are
/// large hold signal, so the quieter ones count.
fn colour(channel: BenchChannel, rms: f64, runs: &[Run]) -> f64 {
    let mut blocks: Vec<f64> = Vec::new();
    for x in runs.iter().filter_map(|r| r.channel(channel)) {
        let d: Vec<f64> = fourth_differences(x).collect();
        blocks.extend(
            d.chunks_exact(128)
                .map(|b| b.iter().map(|x| x * x).sum::<f64>() / 128.0),
        );
    }
    if blocks.is_empty() {
        return 0.0;
    }
    blocks.sort_by(f64::total_cmp);
    let energy = blocks[blocks.len() / 3] / (rms * rms);
    // of noise of rms 1: 70 + 2 (-56 r + 28 r^2 - 8 r^3 + r^4)
    let expected = |r: f64| 70.0 + 2.0 * (-56.0 * r + 28.0 * r * r - 8.0 * r.powi(3) + r.powi(4));
    if energy > 0.9 * expected(0.0) {
        return 0.0;
    }
    let (mut low, mut high) = (0.0, 0.99);
    for _ in 0..40 {
        let middle = 0.5 * (low + high);
        if expected(middle) > energy {
            low = middle
        } else {
            high = middle
        }
    }
    0.5 * (low + high)
}

/// The grain of a channel whose values stand on a grid; 0 where they do not.
fn grain_of(channel: BenchChannel, runs: &[Run]) -> f64 {
    grain(runs.iter().filter_map(|r| r.channel(channel)))
}

/// As [`grain_of`], of signals. Where they run fast few steps are of one grain: the grain is the greatest part of a small step that
/// small steps are whole numbers of.
pub fn grain<'a>(signals: impl Iterator<Item = &'a [f64]>) -> f64 {
    let mut steps: Vec<f64> = signals
        .flat_map(|x| x.windows(2).take(20_000).map(|w| (w[1] - w[0]).abs()))
        .collect();
    let most = steps.iter().fold(0.0, |a: f64, b| a.max(*b));
    steps.retain(|s| *s > 1e-7 * most);
    steps.sort_by(f64::total_cmp);
    // the least step that is not a freak
    let Some(&least) = steps.get(steps.len() / 200) else {
        return 0.0;
    };
    let of = |parts: usize| {
        let mut grain = least / parts as f64;
        for few in [true, false] {
            // the smallest ones, and with what they say of it those again: a step is written with few digits
            let mut count = steps.partition_point(|s| *s < MOST_GRAINS * grain);
            if few {
                count = count.min(steps.len() / 200 + 2 * FEWEST_STEPS);
            }
            let small = &steps[..count];
            let on: Vec<(f64, f64)> = small
                .iter()
                .map(|s| (*s, (s / grain).round()))
                .filter(|(s, n)| *n > 0.0 && (s / grain - n).abs() < OFF_GRAIN)
                .collect();
            let is_grain = small.len() >= FEWEST_STEPS && on.len() * 20 > 19 * small.len();
            if !is_grain {
                return None;
            }
            let (sn, nn) = on.iter().fold((0.0, 0.0), |(a, b), (s, n)| (a + s * n, b + n * n));
            grain = sn / nn;
        }
        Some(grain)
    };
    let found = (1..=MOST_PARTS).find_map(of).unwrap_or(0.0);
    if most > 1.5 * found { found } else { 0.0 }
}

/// Fourth differences of neighbours, in which a smooth signal leaves little.
pub fn fourth_differences(x: &[f64]) -> impl Iterator<Item = f64> + '_ {
    x.windows(5).map(|w| w[0] - 4.0 * w[1] + 6.0 * w[2] - 4.0 * w[3] + w[4])
}

/// rms of white noise whose fourth differences have the median that those of the signals have; `None` where there are
/// none.
pub fn roughness<'a>(signals: impl Iterator<Item = &'a [f64]>) -> Option<f64> {
    let mut all: Vec<f64> = signals.flat_map(|x| fourth_differences(x).map(f64::abs)).collect();
    if all.is_empty() {
        return None;
    }
    let middle = all.len() / 2;
    let median = *all.select_nth_unstable_by(middle, f64::total_cmp).1;
    Some(median / 0.6745 / 70f64.sqrt())
}

/// From the fourth differences, in which a smooth signal leaves little: their median, so that jumps do not count; 0 where there
/// are none.
fn estimated(channel: BenchChannel, runs: &[Run]) -> f64 {
    roughness(runs.iter().filter_map(|r| r.channel(channel))).unwrap_or(0.0)
}

/// Noise that is estimated, but no less than a millionth of the channel's range: only a sensor that counts over many turns is better.
fn within_range(estimated: f64, channel: BenchChannel, runs: &[Run]) -> f64 {
    let all: Vec<&Run> = runs.iter().collect();
    estimated.max(1e-6 * range(&all, channel))
}

/// Half the variance of the difference of runs that were meant to be alike.
fn from_repeats(channel: BenchChannel, runs: &[Run]) -> Option<f64> {
    let repeats: Vec<&[f64]> = runs
        .iter()
        .filter(|r| r.role == Role::Repeat)
        .filter_map(|r| r.channel(channel))
        .collect();
    let (first, others) = repeats.split_first()?;
    let mut sum = 0.0;
    let mut count = 0;
    for other in others {
        let n = first.len().min(other.len());
        let mean = (0..n).map(|k| first[k] - other[k]).sum::<f64>() / n as f64;
        sum += (0..n).map(|k| (first[k] - other[k] - mean).powi(2)).sum::<f64>();
        count += n;
    }
    (count > 0).then(|| (0.5 * sum / count as f64).sqrt())
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;
    use std::collections::BTreeMap;
    use std::f64::consts::TAU;

    /// A motor that swings over many turns, at no moment slow for long, in counts, written with six decimals.
    fn angle(counts: f64) -> Vec<f64> {
        let count = TAU / counts;
        let at = |k: usize| 300.0 * (3e-4 * k as f64).sin() + 20.0 * (5e-3 * k as f64).sin();
        let written = |x: f64| ((x / count).round() * count * 1e6).round() / 1e6;
        (0..8000).map(|k| written(at(k))).collect()
    }

    fn run(x: Vec<f64>) -> Run {
        Run {
            name: "swing".into(),
            role: Role::Fit,
            rate_hz: 2000.0,
            start_s: 0.0,
            samples: x.len(),
            channels: BTreeMap::from([(BenchChannel::Position, x)]),
            hash: String::new(),
            rows: Vec::new(),
            labels: Vec::new(),
            lost: Vec::new(),
            clock: None,
            healthy: true,
            steady: false,
            spread: BTreeMap::new(),
            law_speed: None,
        }
    }

    #[test]
    fn prop_a_grain_is_found_where_a_signal_runs_fast() {
        for counts in [16384.0, 65536.0] {
            let x = angle(counts);
            let found = grain(std::iter::once(&x[..]));
            assert!(
                (found * counts / TAU - 1.0).abs() < 1e-3,
                "{counts}: {}",
                found * counts / TAU
            );
        }
        let smooth: Vec<f64> = (0..8000).map(|k| (1e-3 * f64::from(k)).sin()).collect();
        assert_eq!(grain(std::iter::once(&smooth[..])), 0.0);
    }

    #[test]
    fn an_angle_is_known_to_its_count_and_a_current_to_no_less_than_its_noise() {
        let spec = ChannelSpec {
            channel: BenchChannel::Position,
            column: "theta".into(),
            minus: None,
            factor: 1.0,
            unit_factor: 1.0,
            unit: None,
            lead: None,
            mean: false,
            of_points: true,
            delay_s: 0.0,
            resolution: 0.0,
            noise: Noise::Estimated,
            offset: None,
        };
        // a converter's step is the least that a current has
        let of_current = ChannelSpec {
            channel: BenchChannel::Current,
            resolution: 0.01,
            ..spec.clone()
        };
        let mut rng = ChaCha8Rng::seed_from_u64(5);
        let mut drawn = || rng.random::<f64>() - 0.5;
        for (rms, expected) in [(0.03, 0.03), (0.0, 0.01 / 12f64.sqrt())] {
            let at = |k: usize| (2e-3 * k as f64).sin() + rms * 12f64.sqrt() * drawn();
            let x = (0..8000).map(at).map(|x: f64| (x / 0.01).round() * 0.01).collect();
            let mut current = run(Vec::new());
            current.channels = BTreeMap::from([(BenchChannel::Current, x)]);
            let found = noise(&of_current, &[current]).rms;
            assert!((found / expected - 1.0).abs() < 0.1, "{found} {expected}");
        }
        for counts in [16384.0, 65536.0] {
            let found = noise(&spec, &[run(angle(counts))]);
            let of_count = TAU / counts / 12f64.sqrt();
            assert!(
                (found.rms / of_count - 1.0).abs() < 1e-3,
                "{counts}: {} {of_count}",
                found.rms
            );
            // no bench says it, and a standing angle keeps it all the same
            assert!(
                (found.grain * counts / TAU - 1.0).abs() < 1e-3,
                "{counts}: {}",
                found.grain
            );
        }
    }
}
