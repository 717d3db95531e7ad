//! A friction that remembers how far it is since the motion turned round.

use crate::equations::problem::Problem;
use crate::equations::signals::Signals;
use crate::search::trial::{hat, torque_columns};
use sim_worker::effect::Equation;

/// Knots over the logarithm of the distance.
const KNOTS: usize = 6;
/// Share of the rows that are nearer to a reversal than the first knot, and nearer than the last (assumed).
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

/// Logarithms of the distances between which a friction is tried out, in equal steps.
pub fn distances(p: &Problem) -> Vec<f64> {
    let of_runs: Vec<Vec<f64>> = p.signals.iter().map(since).collect();
    let rows = p.blocks_of(Equation::Torque);
    let mut all: Vec<f64> = rows
        .flat_map(|b| b.samples.iter().map(|k| of_runs[b.run][*k]))
        .collect();
    all.sort_by(f64::total_cmp);
    let at = |share: f64| all.get((share * all.len() as f64) as usize).copied().unwrap_or(0.0);
    let (low, high) = (at(NEAREST), at(FARTHEST).max(at(NEAREST) + 1e-9));
    let step = (high - low) / (KNOTS - 1) as f64;
    (0..KNOTS).map(|i| low + i as f64 * step).collect()
}

/// Columns of a dry friction that is another one so far after a reversal.
///
/// * `distances` by which it goes straight [ln rad]
pub fn after_reversal(p: &Problem, distances: &[f64]) -> Vec<Vec<f64>> {
    torque_columns(p, |s| {
        let far = since(s);
        let of = |i: usize, k: usize| s.sign[k] * hat(distances, i, far[k]);
        (0..distances.len())
            .map(|i| (0..s.n).map(|k| of(i, k)).collect())
            .collect()
    })
}
