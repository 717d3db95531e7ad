//! The spectrum of a residual: over the rotor's angle, which orders of the turn stand out; over time.

use crate::equations::problem::Problem;
use crate::equations::signals::Signals;
use sim_worker::effect::Equation;
use std::f64::consts::TAU;

/// Share of a turn from which what repeats over the turn may repeat within the travel (assumed).
pub const LEAST_OF_TURN: f64 = 0.25;
/// Bins in a turn, so orders up to half of it.
const BINS: f64 = 128.0;
/// Highest order that is looked for.
const HIGHEST: f64 = 48.0;
/// Longest transform.
pub const LONGEST: usize = 1 << 17;
/// Orders that are given on.
const PEAKS: usize = 4;

/// What a residual is multiplied by at a sample.
pub type Factor = fn(&Signals, usize) -> f64;

/// Orders at which the residual of the torque's rows, times `factor`, stands out of its spectrum, the strongest first;
/// none where the motor turns by less than a quarter of a turn.
pub fn orders(p: &Problem, residual: &[f64], factor: Factor) -> Vec<f64> {
    let (low, high) = p.travel();
    let turns = (high - low) / TAU;
    if turns.is_nan() || turns < LEAST_OF_TURN {
        return Vec::new();
    }
    // a peak is not missed if the transform is as long as twice the stroke
    let length = (2.0 * turns * BINS).ceil() as usize;
    let (length, bins) = if length.next_power_of_two() <= LONGEST {
        (length.next_power_of_two(), BINS)
    } else {
        (LONGEST, LONGEST as f64 / (2.0 * turns))
    };
    let (mut re, mut im) = (vec![0.0; length], vec![0.0; length]);
    for b in p.blocks_of(Equation::Torque) {
        let s = &p.signals[b.run];
        for (row, &k) in b.rows.clone().zip(&b.samples) {
            let at = ((s.theta[k] - low) / TAU * bins) as usize;
            re[at.min(length - 1)] += residual[row] * factor(s, k);
        }
    }
    transform(&mut re, &mut im);
    let order = |i: usize| i as f64 * bins / length as f64;
    let power: Vec<f64> = (0..length / 2)
        .take_while(|i| order(*i) < HIGHEST.min(0.4 * bins))
        .map(|i| re[i].powi(2) + im[i].powi(2))
        .collect();
    let mut peaks: Vec<usize> = (1..power.len().saturating_sub(1))
        .filter(|&i| power[i] >= power[i - 1] && power[i] > power[i + 1] && order(i) * turns > 1.2)
        .collect();
    peaks.sort_by(|a, b| power[*b].total_cmp(&power[*a]));
    peaks.iter().take(PEAKS).map(|&i| order(i)).collect()
}

/// Energy of each frequency in the residual of the torque's rows, each run with a phase of its own.
///
/// * `length` of the transform, a power of two: of two entries there is one frequency
/// * `every` samples in an entry
pub fn over_time(p: &Problem, residual: &[f64], length: usize, every: usize) -> Vec<f64> {
    let mut power = vec![0.0; length / 2];
    for b in p.blocks_of(Equation::Torque) {
        let (mut re, mut im) = (vec![0.0; length], vec![0.0; length]);
        for (row, &k) in b.rows.clone().zip(&b.samples) {
            re[(k / every).min(length - 1)] += residual[row];
        }
        transform(&mut re, &mut im);
        let n = b.rows.len().max(1) as f64;
        let of = re.iter().zip(&im).map(|(x, y)| 2.0 * (x * x + y * y) / n);
        power.iter_mut().zip(of).for_each(|(p, x)| *p += x);
    }
    power
}

/// Discrete Fourier transform in place (Cooley and Tukey 1965); the length is a power of two.
fn transform(re: &mut [f64], im: &mut [f64]) {
    let n = re.len();
    let bits = n.trailing_zeros();
    for i in 0..n {
        let j = i.reverse_bits() >> (usize::BITS - bits);
        if j > i {
            re.swap(i, j);
            im.swap(i, j);
        }
    }
    let mut half = 1;
    while half < n {
        let turn: Vec<(f64, f64)> = (0..half)
            .map(|k| (-std::f64::consts::PI * k as f64 / half as f64).sin_cos())
            .collect();
        for start in (0..n).step_by(2 * half) {
            for k in 0..half {
                let (a, b) = (start + k, start + k + half);
                let (sin, cos) = turn[k];
                let (x, y) = (re[b] * cos - im[b] * sin, re[b] * sin + im[b] * cos);
                (re[b], im[b]) = (re[a] - x, im[a] - y);
                (re[a], im[a]) = (re[a] + x, im[a] + y);
            }
        }
        half *= 2;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_sine_is_one_line() {
        let n = 256;
        let mut re: Vec<f64> = (0..n).map(|k| (TAU * 19.0 * k as f64 / n as f64).cos()).collect();
        let mut im = vec![0.0; n];
        transform(&mut re, &mut im);
        for k in 0..n {
            let size = re[k].hypot(im[k]);
            let expected = if k == 19 || k == n - 19 { 0.5 * n as f64 } else { 0.0 };
            assert!((size - expected).abs() < 1e-9, "{k}: {size}");
        }
    }
}
