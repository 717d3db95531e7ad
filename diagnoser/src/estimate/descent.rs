//! The pair that fits best, from many starts.

use super::{Estimate, Estimator, NO_GUESS, Start, UNIFORM, apply, common_variance};
use crate::paving::Limits;
use crate::uncertainty::{Guess, MOST, Row};

/// Pairs along each axis from which the best one is looked for.
const STARTS: usize = 13;

/// Further starts where the best one ends in a misfit.
const AGAIN: usize = 6;

const MOST_STEPS: usize = 30;

/// First steps of a descent after which the covariance is made anew; later ones are short.
const COVARIANCES: usize = 2;

impl Estimator {
    pub(super) fn make_starts(&self) -> Vec<Start> {
        let Limits { f, z } = self.limits;
        let along = |(lo, hi): (f64, f64), k: usize| lo + (hi - lo) * k as f64 / (STARTS - 1) as f64;
        let (df, dz) = (along(f, 1) - f.0, along(z, 1) - z.0);
        let start = |i: usize| {
            let (fsj, zeta) = (along(f, i % STARTS), along(z, i / STARTS));
            let (mut value, by_f, by_z) = self.lattice.with_slopes(fsj, zeta);
            let variance = self.variance(fsj, zeta);
            let common = self.straight(fsj, zeta, &NO_GUESS);
            if let Some(s) = &common {
                value.iter_mut().zip(s.shift).for_each(|(v, s)| *v += s);
            }
            let mut weight = [0.0; MOST];
            for k in 0..self.features.len() {
                let way = (0.5 * df * by_f[k]).powi(2) + (0.5 * dz * by_z[k]).powi(2);
                weight[k] = 1.0 / (variance[k] + common_variance(&common, k) + way);
            }
            Start {
                fsj,
                zeta,
                value,
                weight,
            }
        };
        (0..STARTS * STARTS).map(start).collect()
    }

    /// The pair with the smallest misfit, over the maps and a little beyond. The misfit of the pair
    /// returned may not be the smallest of all where it is below `good` already.
    pub fn best(&self, values: &Row, good: f64) -> Option<Estimate> {
        let here = values.iter().filter(|v| v.is_finite()).count();
        if here < 2 {
            return None;
        }
        let distance = |s: &Start| {
            let terms = values.iter().zip(&s.value).zip(&s.weight);
            terms
                .map(|((v, m), w)| if v.is_finite() { (v - m) * (v - m) * w } else { 0.0 })
                .sum::<f64>()
        };
        let mut left: Vec<(f64, usize)> = self.starts.iter().map(distance).zip(0..).collect();
        let mut best: Option<Estimate> = None;
        for _ in 0..AGAIN {
            let Some((k, &(_, start))) = left.iter().enumerate().min_by(|a, b| a.1.0.total_cmp(&b.1.0)) else {
                break;
            };
            left.swap_remove(k);
            let start = &self.starts[start];
            let found = self.descend(values, start.fsj, start.zeta);
            if best.as_ref().is_none_or(|b| found.misfit < b.misfit) {
                best = Some(found);
            }
            if best.as_ref().is_some_and(|b| b.misfit <= good) {
                break;
            }
            // the next one from elsewhere
            let near = |s: &Start| {
                let step = |(lo, hi): (f64, f64)| 2.5 * (hi - lo) / (STARTS - 1) as f64;
                (s.fsj - start.fsj).abs() < step(self.limits.f) && (s.zeta - start.zeta).abs() < step(self.limits.z)
            };
            left.retain(|&(_, k)| !near(&self.starts[k]));
        }
        best
    }

    /// Gauss-Newton steps from a pair, the covariance following for the first few.
    fn descend(&self, values: &Row, mut fsj: f64, mut zeta: f64) -> Estimate {
        let (f_range, z_range) = self.lattice.range();
        let mut e = self.at(values, fsj, zeta, &NO_GUESS);
        let mut damping = 0.0;
        for step in 0..MOST_STEPS {
            let (_, by_f, by_z) = self.lattice.with_slopes(fsj, zeta);
            let z = self.residual(values, &e, fsj, zeta);
            let (a, b) = (apply(&e.whitening, &by_f), apply(&e.whitening, &by_z));
            let dot = |x: &Row, y: &Row| x.iter().zip(y).map(|(x, y)| x * y).sum::<f64>();
            let (aa, ab, bb) = (dot(&a, &a), dot(&a, &b), dot(&b, &b));
            let (ga, gb) = (dot(&a, &z), dot(&b, &z));
            let (haa, hbb) = (aa * (1.0 + damping) + 1e-12, bb * (1.0 + damping) + 1e-12);
            let det = haa * hbb - ab * ab;
            if det.is_nan() || det <= 0.0 {
                break;
            }
            let (mut df, mut dz) = ((hbb * ga - ab * gb) / det, (haa * gb - ab * ga) / det);
            // at an edge the other fault moves alone
            if (fsj + df).clamp(f_range.0, f_range.1) == fsj {
                (df, dz) = (0.0, gb / hbb);
            } else if (zeta + dz).clamp(z_range.0, z_range.1) == zeta {
                (df, dz) = (ga / haa, 0.0);
            }
            let to = (
                (fsj + df).clamp(f_range.0, f_range.1),
                (zeta + dz).clamp(z_range.0, z_range.1),
            );
            let moved =
                ((to.0 - fsj) / (f_range.1 - f_range.0)).abs() + ((to.1 - zeta) / (z_range.1 - z_range.0)).abs();
            let z_new = self.residual(values, &e, to.0, to.1);
            let new = dot(&z_new, &z_new);
            if new <= e.misfit {
                (fsj, zeta) = to;
                damping *= 0.2;
                if step < COVARIANCES && moved > 1e-4 {
                    e = self.at(values, fsj, zeta, &e.guess);
                } else {
                    (e.fsj, e.zeta, e.misfit) = (fsj, zeta, new);
                }
                if moved < 1e-8 {
                    break;
                }
            } else {
                if moved < 1e-8 {
                    break;
                }
                damping = (4.0 * damping).max(0.1);
            }
        }
        // the covariance of the place that was found, and what it thinks of it
        self.at(values, fsj, zeta, &e.guess)
    }

    /// A pair with its covariance, the response to the causes made straight about where they are thought to lie:
    /// about `guess` first, then about what the features make of it there.
    fn at(&self, values: &Row, fsj: f64, zeta: f64, guess: &Guess) -> Estimate {
        let mut guess = *guess;
        let mut e;
        let mut passes = if self.causes.is_some() { 2 } else { 1 };
        loop {
            let common = self.straight(fsj, zeta, &guess);
            e = Estimate {
                fsj,
                zeta,
                misfit: 0.0,
                whitening: self.whitening(values, fsj, zeta, &common),
                shift: common.map_or([0.0; MOST], |s| s.shift),
                guess,
            };
            let z = self.residual(values, &e, fsj, zeta);
            e.misfit = z.iter().map(|z| z * z).sum();
            passes -= 1;
            let Some(s) = common.filter(|_| passes > 0) else { break };
            // the most probable causes: S^T C^-1 r, none beyond the ends of its uniform distribution
            for (g, slope) in guess.iter_mut().zip(&s.slopes[..s.causes]) {
                let w = apply(&e.whitening, slope);
                *g = w.iter().zip(&z).map(|(w, z)| w * z).sum::<f64>();
                *g = g.clamp(-UNIFORM, UNIFORM);
            }
        }
        e
    }
}
