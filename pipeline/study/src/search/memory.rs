//! A friction that remembers how far it is since the motion turned round.

use crate::equations::problem::Problem;
use crate::equations::signals::Signals;
use crate::search::trial::torque_columns;
use sim_worker::effect::Equation;

/// Triangles over the logarithm of the distance.
const HATS: usize = 6;
/// Share of the rows that are nearer to a reversal than the first one's middle, and nearer than the last one's (assumed).
const NEAREST: f64 = 0.02;
const FARTHEST: f64 = 0.9;

/// Logarithm of the distance since the motion last turned round [ln rad], at each sample; before the first turn, since the run began.
fn since(s: &Signals) -> Vec<f64> {
    let (mut last, mut far) = (0.0, 0.0);
    let mut at = |k: usize| {
        if s.sign[k] * last < 0.0 {
            far = 0.0;
        }
        if s.sign[k] != 0.0 {
            last = s.sign[k];
        }
        far += s.omega[k].abs() / s.rate_hz;
        f64::max(far, 1e-12).ln()
    };
    (0..s.n).map(&mut at).collect()
}

/// The `j`-th of the triangles whose sum is 1, in equal steps over a range.
fn hat(j: usize, x: f64, (low, high): (f64, f64)) -> f64 {
    let last = (HATS - 1) as f64;
    let at = ((x - low) / (high - low).max(1e-300) * last).clamp(0.0, last);
    (1.0 - (at - j as f64).abs()).max(0.0)
}

/// Logarithms of the distances between which a friction is tried out.
pub fn distances(p: &Problem) -> (f64, f64) {
    let of_runs: Vec<Vec<f64>> = p.signals.iter().map(since).collect();
    let rows = p.blocks_of(Equation::Torque);
    let mut all: Vec<f64> = rows
        .flat_map(|b| b.samples.iter().map(|k| of_runs[b.run][*k]))
        .collect();
    all.sort_by(f64::total_cmp);
    let at = |share: f64| all.get((share * all.len() as f64) as usize).copied().unwrap_or(0.0);
    (at(NEAREST), at(FARTHEST))
}

/// Columns of a dry friction that is another one so far after a reversal.
pub fn after_reversal(p: &Problem, distances: (f64, f64)) -> Vec<Vec<f64>> {
    torque_columns(p, |s| {
        let far = since(s);
        let of = |j: usize, k: usize| s.sign[k] * hat(j, far[k], distances);
        (0..HATS).map(|j| (0..s.n).map(|k| of(j, k)).collect()).collect()
    })
}
