//! 95 % intervals that hold although residuals are correlated and the shape of an effect is only
//! nearly right: sandwich covariance over blocks of time, and over whole runs (the held-out ones
//! too), the wider of the two.

use crate::candidates::columns;
use crate::candidates::laws;
use crate::candidates::shapes;
use crate::equations::problem::Problem;
use crate::measured::sums::{add, dot};
use crate::search::fit::{self, Fit, Noise, Term};
use crate::search::select::Material;
use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;
use sim_worker::effect::{Effect, EffectKind, Equation, NORMAL_95};
use std::borrow::Cow;

/// Length of a block [s] (assumed: longer than any memory of residuals seen).
const BLOCK_S: f64 = 0.5;
/// Share of the priors' width that enters.
const BELIEF: f64 = 1.0;
/// Runs from which their scatter counts, and most that the blocks' scatter may be over that of white noise (assumed).
const MANY_RUNS: f64 = 6.0;
const MOST_WIDER: f64 = 6.0;
/// A play is known no better than this share of it, one sigma (assumed: of ten of another hand it was off by 0.35 % at most, rms 0.11 %, with
/// what the rows say of 0.003 to 0.04 %).
const LEAST_PLAY: f64 = 1e-3;
/// Of a rig every size of an effect no better than this share, one sigma (assumed: what filters, interpolation and means over samples leave; of
/// 94 of a tenth hand's 17 % had been off by more than their interval, seven of these by less than 0.5 %).
const LEAST_KNOWN: f64 = 3e-3;
/// What the noise in a constant's own column makes of the constants, of which so much is uncertain where it was taken out of the
/// solution, and where there was too much of it for that (assumed: it shrinks them, one way, so that 95 % of it is a little more than it
/// all); the rest of the column is a signal at least.
const TAKEN_OUT: f64 = 0.15;
const LEFT_IN: f64 = 0.6;
const LEAST_SIGNAL: f64 = 0.2;
/// Widening for the few blocks and the shapes chosen by the same data (assumed).
const WIDER: f64 = 1.15;

/// Half-widths of 95 % intervals.
pub struct Intervals {
    /// of the nuisance parameters' relative deviations
    pub nuisance: Vec<f64>,
    /// of each term's canonical parameters
    pub terms: Vec<Vec<f64>>,
    /// correlations of each term's canonical parameters, row by row
    pub term_correlation: Vec<Vec<f64>>,
    /// correlations of the nuisance parameters, row by row
    pub correlation: Vec<f64>,
}

/// Derivative columns of the prediction by every parameter: nuisance, amplitudes, shapes.
fn jacobian(m: &Material, p: &Problem, fit: &Fit) -> Vec<Vec<f64>> {
    let regs = fit::regressors(p, &fit.terms, &m.constants);
    let base = fit::base(p, &m.constants, &fit.terms, &regs);
    let mut j: Vec<Vec<f64>> = base.into_iter().map(Cow::into_owned).collect();
    // torques of effects are among those that accelerate: all of them scale together
    if let Some(inertia) = p.inertia {
        let torques = fit.terms.iter().zip(&regs).filter(|(t, _)| is_torque(t.kind, 0));
        for (a, c) in torques.flat_map(|(t, r)| t.amplitudes.iter().zip(&r.linear)) {
            for block in p.blocks_of(Equation::Torque).chain(p.blocks_of(Equation::Kinematic)) {
                add(&mut j[inertia][block.rows.clone()], -a, &c[block.rows.clone()]);
            }
        }
    }
    for r in &regs {
        j.extend(r.linear.iter().cloned());
    }
    let shapes: Vec<(usize, usize)> = free_shapes(&fit.terms);
    let moved: Vec<Vec<f64>> = shapes
        .par_iter()
        .map(|&(t, i)| {
            let at = |d: f64| -> Vec<f64> {
                let mut term = fit.terms[t].clone();
                term.shape[i] += d;
                contribution(p, m, &term)
            };
            let d = step(&fit.terms[t], i);
            let (a, b) = (at(d), at(-d));
            a.iter().zip(&b).map(|(a, b)| (a - b) / (2.0 * d)).collect()
        })
        .collect();
    j.extend(moved);
    // what belongs to single runs is fitted along
    j.extend(p.local.iter().cloned());
    j
}

fn step(term: &Term, i: usize) -> f64 {
    match shapes::scales(term.kind, term.shape.len())[i] {
        Some(true) => 0.01 * term.shape[i].abs().max(1e-12),
        _ if term.kind == EffectKind::TightSpot => 0.05 * term.shape[1],
        _ if term.kind == EffectKind::Backlash => 0.01 * term.shape[i].abs().max(1.0),
        _ if columns::form(term.kind) == columns::Form::Periodic => 1e-6,
        _ => 0.01,
    }
}

/// Terms and places of the shape parameters that were refined.
fn free_shapes(terms: &[Term]) -> Vec<(usize, usize)> {
    let mut out = Vec::new();
    for (t, term) in terms.iter().enumerate() {
        for (i, scale) in shapes::scales(term.kind, term.shape.len()).iter().enumerate() {
            if scale.is_some() {
                out.push((t, i));
            }
        }
    }
    out
}

/// What a term adds to the prediction.
pub fn contribution(p: &Problem, m: &Material, term: &Term) -> Vec<f64> {
    let r = fit::Regressor::new(p, term.kind, &term.shape, &m.constants);
    let mut out = r.fixed.unwrap_or_else(|| vec![0.0; p.rows]);
    for (a, c) in term.amplitudes.iter().zip(&r.linear) {
        add(&mut out, *a, c);
    }
    out
}

/// Sums of `J^T W r` by block of time and by run.
fn scores(
    p: &Problem,
    j: &[Vec<f64>],
    residual: &[f64],
    sigma: &[f64; 5],
    n: usize,
) -> (Vec<DVector<f64>>, Vec<DVector<f64>>) {
    let length = p.clock.block(BLOCK_S);
    let mut blocks = std::collections::BTreeMap::<(usize, usize), DVector<f64>>::new();
    let mut runs = std::collections::BTreeMap::<usize, DVector<f64>>::new();
    for b in &p.blocks {
        let e = b.equation.index();
        let w = 1.0 / sigma[e].powi(2);
        for (row, &k) in b.rows.clone().zip(&b.samples) {
            let r = residual[row] * w;
            let block = blocks.entry((b.run, k / length)).or_insert_with(|| DVector::zeros(n));
            let run = runs.entry(b.run).or_insert_with(|| DVector::zeros(n));
            for i in 0..n {
                let x = j[i][row] * r;
                block[i] += x;
                run[i] += x;
            }
        }
    }
    (blocks.into_values().collect(), runs.into_values().collect())
}

/// What other laws of the terms would add to the rows beyond their own, each; but for one term.
fn otherwise(p: &Problem, m: &Material, fit: &Fit, but: Option<usize>) -> Vec<Vec<f64>> {
    let of = |t: &Term| laws::otherwise(t.kind, &t.shape, &t.amplitudes, &p.signals, &m.constants);
    let terms = fit.terms.iter().enumerate().filter(|(t, _)| Some(*t) != but);
    terms.filter_map(|(_, t)| Some(p.column(&of(t)?))).collect()
}

/// What the noise in each constant's own column makes of all parameters, as far as it is left there; no farther than what is believed of
/// the constant.
///
/// * `inverse` of the normal equations, whose columns are divided by `norm`
fn shrunk(m: &Material, fit: &Fit, inverse: &DMatrix<f64>, norm: &[f64]) -> Vec<DVector<f64>> {
    let of = |noise: &Noise| {
        let left = if noise.is_taken_out(norm) { TAKEN_OUT } else { LEFT_IN };
        let mut right = DVector::zeros(norm.len());
        for (i, x) in &noise.of {
            right[*i] = x / norm[*i];
        }
        let x = inverse * right * (left / (1.0 - noise.share(norm)).max(LEAST_SIGNAL));
        let x = DVector::from_fn(norm.len(), |i, _| x[i] / norm[i]);
        let (n, at) = (&m.nuisances[noise.owner], fit.nuisance[noise.owner]);
        let most = n.trust.map_or(f64::INFINITY, |t| t + (at - n.centre).abs() / NORMAL_95);
        let far = x[noise.owner].abs();
        x * (most / far.max(1e-300)).min(1.0)
    };
    fit::noises(&m.fit, &m.nuisances, &fit.sigma).iter().map(of).collect()
}

/// Moves one number of a term.
type Change = Box<dyn Fn(&mut Term, f64)>;

/// Intervals of a fitted model.
pub fn intervals(m: &Material, fit: &Fit) -> Intervals {
    intervals_by_law(m, fit, None)
}

/// As [`intervals`], by the law that term `of` has: what it would be by another says nothing about whether it is there.
pub fn intervals_by_law(m: &Material, fit: &Fit, of: Option<usize>) -> Intervals {
    let p = &m.fit;
    let j = jacobian(m, p, fit);
    let count = j.len();
    let kept = count - p.local.len();
    let w = p.weights(&fit.sigma);
    let scaled: Vec<Vec<f64>> = j
        .par_iter()
        .map(|c| c.iter().zip(&w).map(|(x, w)| x * w).collect())
        .collect();
    let norm: Vec<f64> = scaled
        .iter()
        .map(|c| c.iter().map(|x| x * x).sum::<f64>().sqrt().max(1e-150))
        .collect();
    let rows: Vec<Vec<f64>> = (0..count)
        .into_par_iter()
        .map(|a| {
            let of = |b: usize| dot(&scaled[a], &scaled[b]) / (norm[a] * norm[b]);
            (0..=a).map(of).collect()
        })
        .collect();
    let mut h = DMatrix::from_fn(count, count, |a, b| if b <= a { rows[a][b] } else { rows[b][a] });
    // one over what is believed of nuisances and amplitudes, in the columns' own scale
    let nuisances = m.nuisances.iter().map(|n| n.trust);
    let amplitudes = fit
        .terms
        .iter()
        .flat_map(|t| t.amplitudes.iter().map(|_| columns::trust(t.kind)));
    let of_single_runs = p.local_trust.iter().enumerate().map(|(i, t)| (kept + i, *t));
    let beliefs: Vec<(usize, f64)> = nuisances
        .chain(amplitudes)
        .enumerate()
        .chain(of_single_runs)
        .filter_map(|(i, t)| Some((i, 1.0 / t?.max(1e-12) / norm[i])))
        .collect();
    for (i, b) in &beliefs {
        h[(*i, *i)] += b * b;
    }
    for i in 0..count {
        h[(i, i)] += 1e-9;
    }
    let Some(inverse) = h.cholesky().map(|c| c.inverse()) else {
        let wide = |t: &Term| vec![f64::INFINITY; t.kind.keys().len()];
        return Intervals {
            nuisance: vec![f64::INFINITY; m.nuisances.len()],
            terms: fit.terms.iter().map(wide).collect(),
            term_correlation: fit.terms.iter().map(|t| identity(t.kind.keys().len())).collect(),
            correlation: identity(m.nuisances.len()),
        };
    };
    let (blocks, mut by_run) = scores(p, &j, &fit.residual, &fit.sigma, count);
    // held-out runs say how far another command would move the parameters
    if let Some(held) = &m.held {
        let jh = jacobian(m, held, fit);
        let nh = jh.len().min(count);
        let (_, runs) = scores(
            held,
            &jh[..kept.min(nh)],
            &m.held_residual(fit),
            &fit.sigma,
            kept.min(nh),
        );
        by_run.extend(
            runs.into_iter()
                .map(|r| DVector::from_fn(count, |i, _| if i < r.len() { r[i] } else { 0.0 })),
        );
    }
    let spread = |groups: &[DVector<f64>], factor: f64| -> DMatrix<f64> {
        let mut meat = DMatrix::zeros(count, count);
        for g in groups {
            let g = DVector::from_fn(count, |i, _| g[i] / norm[i]);
            let x = &inverse * g;
            meat += &x * x.transpose();
        }
        meat * factor
    };
    let n = blocks.len() as f64;
    let mut a = spread(&blocks, n / (n - 1.0).max(1.0));
    // what only a belief says is as uncertain as the belief
    for (i, b) in &beliefs {
        let x = inverse.column(*i) * (BELIEF * b);
        a += &x * x.transpose();
    }
    // how far another law of each effect would move all, as much of it as the data allow, and what noise does
    let moved: Vec<DVector<f64>> = otherwise(p, m, fit, of)
        .iter()
        .map(|d| {
            let weighted: Vec<f64> = d.iter().zip(&w).map(|(d, w)| d * w).collect();
            let x = &inverse * DVector::from_fn(count, |a, _| dot(&scaled[a], &weighted) / norm[a]);
            let x = DVector::from_fn(count, |a, _| x[a] / norm[a]);
            let mut alone = d.clone();
            for (a, c) in j.iter().enumerate() {
                add(&mut alone, -x[a], c);
            }
            let size: f64 = alone.iter().zip(&w).map(|(o, w)| (o * w).powi(2)).sum();
            let (by_block, _) = scores(p, &[alone], &fit.residual, &fit.sigma, 1);
            let along: f64 = by_block.iter().map(|b| b[0]).sum();
            let scatter: f64 = by_block.iter().map(|b| b[0] * b[0]).sum();
            let share = (along * along + scatter.max(size)).sqrt() / size.max(1e-300);
            x * share.min(1.0)
        })
        .chain(shrunk(m, fit, &inverse, &norm))
        .collect();
    let by_law = |i: usize, k: usize| -> f64 { moved.iter().map(|x| x[i] * x[k]).sum() };
    let runs = by_run.len() as f64;
    let fitted = m.fit.signals.len() as f64;
    let b = spread(&by_run, fitted / runs);
    // where there are runs enough to say how far another command would move the parameters
    let of_runs = if runs >= MANY_RUNS { 0.5 } else { 0.0 };
    let by_noise = |i: usize| -> f64 {
        let blocks = a[(i, i)].max(of_runs * b[(i, i)]);
        // no better than the noise allows, and no worse than a few times that: blocks are few
        blocks
            .clamp(inverse[(i, i)], MOST_WIDER * MOST_WIDER * inverse[(i, i)].max(1e-300))
            .sqrt()
            / norm[i]
            * WIDER
    };
    let sd = |i: usize| -> f64 { by_noise(i).hypot(by_law(i, i).sqrt()) };
    let cov = |i: usize, k: usize| -> f64 {
        // the correlation of the blocks with the standard deviations of whichever is wider
        let r = a[(i, k)] / (a[(i, i)] * a[(k, k)]).sqrt().max(1e-300);
        r * by_noise(i) * by_noise(k) + by_law(i, k)
    };
    let nuisance = (0..m.nuisances.len()).map(|i| NORMAL_95 * sd(i)).collect();
    let n = m.nuisances.len();
    let mut correlation = identity(n);
    for i in 0..n {
        for k in (0..n).filter(|k| *k != i) {
            let r = cov(i, k) / (sd(i) * sd(k)).max(1e-300);
            correlation[i * n + k] = if r.is_finite() { r.clamp(-1.0, 1.0) } else { 0.0 };
        }
    }
    // canonical parameters by the delta method
    let shapes = free_shapes(&fit.terms);
    let amplitudes_at = m.nuisances.len();
    let shapes_at = amplitudes_at + fit.terms.iter().map(|t| t.amplitudes.len()).sum::<usize>();
    let place = |name: &str| m.nuisances.iter().position(|n| n.name == name);
    let (friction, inertia) = (place("coulomb"), place("inertia"));
    let (mut terms, mut term_correlation) = (Vec::new(), Vec::new());
    let mut first = amplitudes_at;
    for (t, term) in fit.terms.iter().enumerate() {
        let mut vary: Vec<(usize, Change, f64)> = Vec::new();
        for i in 0..term.amplitudes.len() {
            let d = 1e-4 * term.amplitudes.iter().fold(1e-12, |m: f64, a| m.max(a.abs()));
            vary.push((first + i, Box::new(move |x: &mut Term, d: f64| x.amplitudes[i] += d), d));
        }
        for (s, &(_, i)) in shapes.iter().enumerate().filter(|(_, x)| x.0 == t) {
            let d = 0.01 * step(term, i);
            vary.push((shapes_at + s, Box::new(move |x: &mut Term, d: f64| x.shape[i] += d), d));
        }
        let value = |x: &Term| -> Effect { fit::effect_of(x, &m.constants, p) };
        let middle = value(term);
        let keys = term.kind.keys().len();
        let slopes_of = |key: usize| -> Vec<(usize, f64)> {
            // stiffness is the dry friction over a distance
            let share = friction.filter(|_| term.kind == EffectKind::Presliding && key == 0);
            let of_friction = share.map(|i| (i, middle.values[key]));
            vary.iter()
                .map(|(i, change, d)| {
                    let (mut up, mut down) = (term.clone(), term.clone());
                    change(&mut up, *d);
                    change(&mut down, -*d);
                    let mut difference = value(&up).values[key] - value(&down).values[key];
                    if term.kind.is_periodic() && key == 1 {
                        difference = (difference + std::f64::consts::PI).rem_euclid(std::f64::consts::TAU)
                            - std::f64::consts::PI;
                    }
                    (*i, difference / (2.0 * d))
                })
                .chain(of_friction)
                .collect()
        };
        let slopes: Vec<_> = (0..keys).map(slopes_of).collect();
        let shared = |a: usize, b: usize| -> f64 {
            let each = slopes[a].iter().flat_map(|x| slopes[b].iter().map(move |y| (x, y)));
            each.map(|((i, x), (k, y))| x * y * cov(*i, *k)).sum()
        };
        // a load on its spring is as uncertain as the inertia that it is a share of
        let whole = inertia.filter(|_| term.kind == EffectKind::Compliance);
        let of_constant = |key: usize| whole.map_or(0.0, |c| middle.values[key] * sd(c));
        let least = |key: usize| match term.kind.keys()[key].name {
            "phase" | "order" | "centre" => 0.0,
            _ if term.kind == EffectKind::Backlash => LEAST_PLAY * middle.values[key],
            _ if m.bench.own => 0.0,
            _ => LEAST_KNOWN * middle.values[key],
        };
        let own = |a: usize, b: usize| if a == b { least(a).powi(2) } else { 0.0 };
        let alone = |a: usize, b: usize| of_constant(a) * of_constant(b) + own(a, b);
        let covariance = |a: usize, b: usize| shared(a, b) + alone(a, b);
        let deviation = |key: usize| covariance(key, key).max(0.0).sqrt();
        let half = (0..keys).map(|key| NORMAL_95 * deviation(key)).collect();
        let both = |k: usize| -> f64 {
            let (a, b) = (k / keys, k % keys);
            let r = covariance(a, b) / (deviation(a) * deviation(b)).max(1e-300);
            if a == b { 1.0 } else { r.clamp(-1.0, 1.0) }
        };
        term_correlation.push((0..keys * keys).map(both).collect());
        terms.push(half);
        first += term.amplitudes.len();
    }
    Intervals {
        nuisance,
        terms,
        term_correlation,
        correlation,
    }
}

fn identity(n: usize) -> Vec<f64> {
    (0..n * n).map(|i| f64::from(i / n == i % n)).collect()
}

/// Whether a parameter scales with the torque constant.
///
/// * `key` its place among those of the kind
pub fn is_torque(kind: EffectKind, key: usize) -> bool {
    let unit = kind.keys()[key].unit;
    unit.starts_with("N m") || unit == "kg m2" || kind == EffectKind::LoadDependentFriction
}
