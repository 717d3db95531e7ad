//! Weighted least squares with priors, and the profile likelihood of candidates over it.

use crate::candidates::columns::{self, Form, RigConstants};
use crate::candidates::shapes;
use crate::equations::problem::{Nuisance, Problem};
use crate::search::spectrum;
use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;
use sim_worker::effect::{Effect, EffectKind, Equation};

/// An effect in the model under study.
#[derive(Clone, Debug)]
pub struct Term {
    /// which effect
    pub kind: EffectKind,
    /// parameters that are not linear
    pub shape: Vec<f64>,
    /// linear parameters, in the order of the effect's columns
    pub amplitudes: Vec<f64>,
}

/// A candidate's columns over the rows of a problem.
#[derive(Clone, Debug)]
pub struct Regressor {
    /// what it adds without an amplitude
    pub fixed: Option<Vec<f64>>,
    pub linear: Vec<Vec<f64>>,
}

impl Regressor {
    pub fn new(p: &Problem, kind: EffectKind, shape: &[f64], c: &RigConstants) -> Self {
        let parts: Vec<_> = p
            .signals
            .iter()
            .map(|s| columns::contribution(kind, shape, s, c))
            .collect();
        let fixed: Vec<_> = parts.iter().map(|x| &x.fixed).collect();
        let fixed = fixed.iter().any(|f| !f.is_empty());
        let count = parts.iter().map(|x| x.linear.len()).max().unwrap_or(0);
        let mut fixed_pieces = Vec::new();
        let mut linear_pieces: Vec<Vec<_>> = (0..count).map(|_| Vec::new()).collect();
        for mut part in parts {
            fixed_pieces.push(std::mem::take(&mut part.fixed));
            part.linear.resize_with(count, Vec::new);
            for (all, one) in linear_pieces.iter_mut().zip(part.linear) {
                all.push(one);
            }
        }
        Self {
            fixed: fixed.then(|| p.column(&fixed_pieces)),
            linear: linear_pieces.iter().map(|c| p.column(c)).collect(),
        }
    }

    pub fn is_empty(&self) -> bool {
        self.fixed.is_none() && self.linear.is_empty()
    }
}

/// Orthonormal basis of what is fitted already, weighted, with the priors as further rows.
pub struct Basis {
    q: Vec<Vec<f64>>,
    weights: Vec<f64>,
    extra: usize,
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    let mut sum = [0.0; 8];
    let (x, y) = (a.chunks_exact(8), b.chunks_exact(8));
    let rest: f64 = x.remainder().iter().zip(y.remainder()).map(|(x, y)| x * y).sum();
    for (x, y) in x.zip(y) {
        for l in 0..8 {
            sum[l] += x[l] * y[l];
        }
    }
    rest + sum.iter().sum::<f64>()
}

impl Basis {
    pub fn new(p: &Problem, weights: &[f64], nuisances: &[Nuisance], further: &[&Vec<f64>]) -> Self {
        let extra = nuisances.len() + p.local.len();
        let mut basis = Self {
            q: Vec::new(),
            weights: weights.to_vec(),
            extra,
        };
        for (j, (column, n)) in p.base.iter().zip(nuisances).enumerate() {
            let mut c = basis.extended(column);
            if let Some(sigma) = n.trust {
                c[p.rows + j] = 1.0 / sigma.max(1e-9);
            }
            basis.push(c);
        }
        for (j, (column, trust)) in p.local.iter().zip(&p.local_trust).enumerate() {
            let mut c = basis.extended(column);
            if let Some(sigma) = trust {
                c[p.rows + nuisances.len() + j] = 1.0 / sigma.max(1e-12);
            }
            basis.push(c);
        }
        for column in further {
            let c = basis.extended(column);
            basis.push(c);
        }
        basis
    }

    /// A column, weighted, with zeros where the priors stand.
    pub fn extended(&self, column: &[f64]) -> Vec<f64> {
        let mut c = Vec::with_capacity(column.len() + self.extra);
        c.extend(column.iter().zip(&self.weights).map(|(x, w)| x * w));
        c.resize(column.len() + self.extra, 0.0);
        c
    }

    fn push(&mut self, mut c: Vec<f64>) {
        let before = dot(&c, &c).sqrt();
        self.project(&mut c);
        self.project(&mut c);
        let norm = dot(&c, &c).sqrt();
        if norm > 1e-7 * before && norm > 0.0 {
            c.iter_mut().for_each(|x| *x /= norm);
            self.q.push(c);
        }
    }

    /// Takes the basis out of a weighted column.
    pub fn project(&self, c: &mut [f64]) {
        for q in &self.q {
            let s = dot(q, c);
            c.iter_mut().zip(q).for_each(|(c, q)| *c -= s * q);
        }
    }
}

/// How well a model does.
#[derive(Clone, Debug)]
pub struct Score {
    pub log_likelihood: f64,
    pub energy: [f64; 5],
    pub amplitudes: Vec<f64>,
}

/// What candidates are measured against.
pub struct Scan<'a> {
    pub problem: &'a Problem,
    pub constants: &'a RigConstants,
    pub basis: Basis,
    /// weighted left-hand side less everything fitted
    residual: Vec<f64>,
    /// weighted drive torque
    drive: Vec<f64>,
    /// standard deviation used for each equation
    sigma: [f64; 5],
    count: [f64; 5],
    /// without a further effect
    pub none: Score,
    /// orders of the rotor turn that stand out of the residual, by the kind that would make them
    orders: std::collections::BTreeMap<EffectKind, Vec<f64>>,
}

/// Log-likelihood of residual energies with unknown standard deviations, none below the floor.
fn log_likelihood(p: &Problem, energy: &[f64; 5], count: &[f64; 5], prior: f64) -> f64 {
    let mut ll = -0.5 * prior;
    for e in 0..5 {
        if count[e] > 0.0 {
            let (mean, floor) = (energy[e] / count[e], p.floor[e].powi(2).max(1e-300));
            // the noise is known: below it, less is not better than the noise allows
            let deviance = if mean > floor {
                (mean / floor).ln() + 1.0
            } else {
                mean / floor
            };
            ll -= 0.5 * count[e] * p.independent[e] * deviance;
        }
    }
    ll
}

impl<'a> Scan<'a> {
    /// * `y` left-hand side less the fixed parts of the effects in the model, whose columns are `further`
    pub fn new(
        p: &'a Problem,
        constants: &'a RigConstants,
        nuisances: &[Nuisance],
        y: &[f64],
        further: &[&Vec<f64>],
        sigma: [f64; 5],
    ) -> Self {
        let basis = Basis::new(p, &p.weights(&sigma), nuisances, further);
        let mut residual = basis.extended(y);
        for (j, n) in nuisances.iter().enumerate() {
            if let Some(sigma) = n.trust {
                residual[p.rows + j] = n.centre / sigma.max(1e-9);
            }
        }
        basis.project(&mut residual);
        let count = Equation::ALL.map(|e| p.rows_of(e) as f64);
        let drive = basis.extended(&p.drive);
        let mut scan = Self {
            problem: p,
            constants,
            basis,
            residual: Vec::new(),
            drive,
            sigma,
            count,
            none: Score {
                log_likelihood: 0.0,
                energy: [0.0; 5],
                amplitudes: Vec::new(),
            },
            orders: Default::default(),
        };
        scan.none = scan.scored(&residual, Vec::new());
        scan.residual = residual;
        scan
    }

    /// Looks for orders that are no whole numbers, too: the spectrum of the residual torque over the angle, as it
    /// is, with the sign of the motion, and with the drive.
    pub fn with_orders(mut self) -> Self {
        let p = self.problem;
        let unweighted: Vec<f64> = self.residual[..p.rows]
            .iter()
            .zip(&self.basis.weights)
            .map(|(r, w)| r / w)
            .collect();
        let kinds: [(EffectKind, spectrum::Factor); 3] = [
            (EffectKind::Cogging, |_, _| 1.0),
            (EffectKind::PeriodicFriction, |s, k| s.sign[k]),
            (EffectKind::TorqueRipple, |s, k| s.drive[k]),
        ];
        for (kind, factor) in kinds {
            self.orders.insert(kind, spectrum::orders(p, &unweighted, factor));
        }
        self
    }

    fn scored(&self, weighted: &[f64], amplitudes: Vec<f64>) -> Score {
        let p = self.problem;
        let mut energy = p.energy(&weighted[..p.rows]);
        for e in 0..5 {
            energy[e] *= self.sigma[e].powi(2);
        }
        let prior = dot(&weighted[p.rows..], &weighted[p.rows..]);
        Score {
            log_likelihood: log_likelihood(p, &energy, &self.count, prior),
            energy,
            amplitudes,
        }
    }

    /// Score with one more effect of this shape, or `None` where it cannot act or its sign is not physical.
    pub fn score(&self, kind: EffectKind, shape: &[f64]) -> Option<Score> {
        let r = Regressor::new(self.problem, kind, shape, self.constants);
        self.score_of(kind, &r)
    }

    fn score_of(&self, kind: EffectKind, r: &Regressor) -> Option<Score> {
        if r.is_empty() {
            return None;
        }
        let mut rest = self.residual.clone();
        if let Some(fixed) = &r.fixed {
            let mut f = self.basis.extended(fixed);
            self.basis.project(&mut f);
            rest.iter_mut().zip(&f).for_each(|(r, f)| *r -= f);
        }
        let mut free: Vec<Vec<f64>> = Vec::new();
        for c in &r.linear {
            let mut c = self.basis.extended(c);
            let before = dot(&c, &c);
            if !self.constants.measured_current && self.is_regressand(kind, &c, before) {
                return None;
            }
            self.basis.project(&mut c);
            let after = dot(&c, &c);
            // hardly anything of its own: not excited, or the regressand in disguise
            if !(after > 1e-6 * before && after > 1e-12) {
                return None;
            }
            free.push(c);
        }
        let m = free.len();
        let mut amplitudes = Vec::new();
        if m > 0 {
            let gram = DMatrix::from_fn(m, m, |i, j| dot(&free[i], &free[j]));
            let right = DVector::from_fn(m, |i, _| dot(&free[i], &rest));
            amplitudes = gram.cholesky()?.solve(&right).iter().copied().collect();
            if !admissible(kind, &amplitudes) {
                return None;
            }
            for (a, c) in amplitudes.iter().zip(&free) {
                rest.iter_mut().zip(c).for_each(|(r, c)| *r -= a * c);
            }
        }
        Some(self.scored(&rest, amplitudes))
    }

    /// Whether a column of an effect in the drive signal is the drive signal itself, which would explain
    /// itself: more than 98 % of it.
    fn is_regressand(&self, kind: EffectKind, column: &[f64], energy: f64) -> bool {
        let of_drive = matches!(
            kind,
            EffectKind::TorqueSaturation | EffectKind::DeadTime | EffectKind::CurrentGain
        );
        let s = dot(column, &self.drive);
        of_drive && s * s > 0.9 * energy * dot(&self.drive, &self.drive)
    }

    /// The best shape of a kind: over its grid, then refined.
    pub fn best(&self, kind: EffectKind) -> Option<(Term, Score)> {
        let mut shapes = shapes::grid(kind, &self.problem.signals, self.constants);
        if let Some(orders) = &self.orders.get(&kind) {
            shapes.extend(orders.iter().map(|n| vec![*n]));
        }
        let scored: Vec<(Vec<f64>, Score)> = shapes
            .into_par_iter()
            .filter(|s| self.inside(kind, s))
            .filter_map(|s| self.score(kind, &s).map(|x| (s, x)))
            .collect();
        let better = |a: &&(Vec<f64>, Score), b: &&(Vec<f64>, Score)| a.1.log_likelihood.total_cmp(&b.1.log_likelihood);
        let (shape, score) = scored.iter().max_by(better)?;
        Some(self.refined(kind, shape, score, 40))
    }

    /// Refines the shape parameters by a simplex search on the profile likelihood.
    pub fn refined(&self, kind: EffectKind, shape: &[f64], score: &Score, steps: usize) -> (Term, Score) {
        let scales = shapes::scales(kind);
        let free: Vec<usize> = (0..scales.len()).filter(|i| scales[*i].is_some()).collect();
        let limits = shapes::limits(kind, &self.problem.signals);
        let plain = |x: &[f64]| -> Vec<f64> {
            let mut s = shape.to_vec();
            for (j, &i) in free.iter().enumerate() {
                s[i] = if scales[i] == Some(true) { x[j].exp() } else { x[j] };
                s[i] = s[i].clamp(limits[i].0, limits[i].1);
            }
            s
        };
        let mut best = (shape.to_vec(), score.clone());
        if !free.is_empty() {
            let start: Vec<f64> = free
                .iter()
                .map(|&i| {
                    if scales[i] == Some(true) {
                        shape[i].ln()
                    } else {
                        shape[i]
                    }
                })
                .collect();
            let step: Vec<f64> = free
                .iter()
                .map(|&i| match (kind, scales[i]) {
                    (EffectKind::TightSpot, Some(false)) => 0.5 * shape[1],
                    (EffectKind::PeriodicFriction | EffectKind::Cogging | EffectKind::TorqueRipple, _) => {
                        self.order_step()
                    }
                    (EffectKind::Stribeck, Some(false)) => 0.3,
                    (EffectKind::Backlash, Some(false)) => 0.3 * shape[i].max(1e3),
                    (_, Some(true)) => 0.35,
                    _ => 0.08,
                })
                .collect();
            simplex(&start, &step, steps, |x| {
                let s = plain(x);
                match self.score(kind, &s).filter(|_| self.inside(kind, &s)) {
                    Some(score) => {
                        let value = -score.log_likelihood;
                        if score.log_likelihood > best.1.log_likelihood {
                            best = (s, score);
                        }
                        value
                    }
                    None => f64::MAX,
                }
            });
        }
        let term = Term {
            kind,
            shape: best.0,
            amplitudes: best.1.amplitudes.clone(),
        };
        (term, best.1)
    }

    /// Whether a tight spot lies within the travel, so far that friction is seen to fall again on both
    /// sides: else it may as well be the end of the stroke.
    fn inside(&self, kind: EffectKind, shape: &[f64]) -> bool {
        if kind != EffectKind::TightSpot {
            return true;
        }
        let all = self.problem.signals.iter().flat_map(|s| &s.theta);
        let (low, high) = all.fold((f64::MAX, f64::MIN), |(a, b), x| (a.min(*x), b.max(*x)));
        shape[0] - 2.0 * shape[1] > low && shape[0] + 2.0 * shape[1] < high
    }

    /// A tenth of the order that a whole turn more over the stroke makes.
    fn order_step(&self) -> f64 {
        let all = self.problem.signals.iter().flat_map(|s| &s.theta);
        let (low, high) = all.fold((f64::MAX, f64::MIN), |(a, b), x| (a.min(*x), b.max(*x)));
        0.1 * std::f64::consts::TAU / (high - low).max(1e-9)
    }
}

/// Whether amplitudes have the sign that physics allows.
pub fn admissible(kind: EffectKind, amplitudes: &[f64]) -> bool {
    match columns::form(kind) {
        Form::Amplitude => {
            let key = &kind.keys()[0];
            amplitudes[0] >= key.low.min(0.0) && amplitudes[0] <= key.high.max(0.0) && amplitudes[0] != 0.0
        }
        // a little negative damping is noise
        Form::Presliding | Form::Heating => amplitudes[0] > 0.0,
        _ => true,
    }
}

/// Nelder and Mead's simplex; `f` keeps its best itself.
pub fn simplex(start: &[f64], step: &[f64], calls: usize, mut f: impl FnMut(&[f64]) -> f64) {
    let n = start.len();
    let mut points: Vec<(Vec<f64>, f64)> = vec![(start.to_vec(), f(start))];
    for i in 0..n {
        let mut x = start.to_vec();
        x[i] += step[i];
        let y = f(&x);
        points.push((x, y));
    }
    let mut used = n + 1;
    while used < calls {
        points.sort_by(|a, b| a.1.total_cmp(&b.1));
        let spread = points[n].1 - points[0].1;
        if spread.abs() < 1e-3 {
            break;
        }
        let centre: Vec<f64> = (0..n)
            .map(|i| points[..n].iter().map(|p| p.0[i]).sum::<f64>() / n as f64)
            .collect();
        let at = |t: f64| -> Vec<f64> { (0..n).map(|i| centre[i] + t * (points[n].0[i] - centre[i])).collect() };
        let mut call = |x: Vec<f64>| {
            used += 1;
            let y = f(&x);
            (x, y)
        };
        let reflected = call(at(-1.0));
        if reflected.1 < points[0].1 {
            let expanded = call(at(-2.0));
            points[n] = if expanded.1 < reflected.1 { expanded } else { reflected };
        } else if reflected.1 < points[n - 1].1 {
            points[n] = reflected;
        } else {
            let contracted = if reflected.1 < points[n].1 {
                call(at(-0.5))
            } else {
                call(at(0.5))
            };
            if contracted.1 < points[n].1.min(reflected.1) {
                points[n] = contracted;
            } else {
                for i in 1..=n {
                    let x: Vec<f64> = (0..n).map(|j| 0.5 * (points[0].0[j] + points[i].0[j])).collect();
                    points[i] = call(x);
                }
            }
        }
    }
}

/// A fitted model.
#[derive(Clone, Debug)]
pub struct Fit {
    /// the effects in it
    pub terms: Vec<Term>,
    /// relative deviations of the nuisance parameters
    pub nuisance: Vec<f64>,
    pub score: Score,
    /// unweighted residual rows
    pub residual: Vec<f64>,
    /// covariance of nuisance parameters and amplitudes, in this order, for independent noise of `sigma`
    pub sigma: [f64; 5],
}

/// The model's regressors on a problem.
pub fn regressors(p: &Problem, terms: &[Term], c: &RigConstants) -> Vec<Regressor> {
    terms
        .par_iter()
        .map(|t| Regressor::new(p, t.kind, &t.shape, c))
        .collect()
}

/// Left-hand side less the fixed parts, and the columns of the amplitudes.
pub fn assembled<'a>(p: &Problem, regressors: &'a [Regressor]) -> (Vec<f64>, Vec<&'a Vec<f64>>) {
    let mut y = p.y.clone();
    for f in regressors.iter().filter_map(|r| r.fixed.as_ref()) {
        y.iter_mut().zip(f).for_each(|(y, f)| *y -= f);
    }
    (y, regressors.iter().flat_map(|r| &r.linear).collect())
}

/// Solves for nuisance parameters and amplitudes of terms whose shapes are given; the standard
/// deviations of the equations are those of the residuals, in three rounds.
pub fn solve(p: &Problem, c: &RigConstants, nuisances: &[Nuisance], terms: &[Term], sigma0: [f64; 5]) -> Fit {
    let mut fit = solve_freely(p, c, nuisances, terms, sigma0);
    // a sensor is as good as it is, a constant about what it is said to be: what goes further is not their error
    let mut held = nuisances.to_vec();
    let mut ever = false;
    for _ in 0..4 {
        let mut clamped = false;
        for ((n, n0), x) in held.iter_mut().zip(nuisances).zip(&fit.nuisance) {
            let most = match n.name {
                "coulomb" | "viscous" | "offset" | "play" => continue,
                _ if n.of_machine => MOST_BELIEF,
                _ => MOST_SIGMAS,
            };
            if let Some(t) = n0.trust
                && n.trust == n0.trust
                && t > 1e-8
                && (x - n0.centre).abs() > most * t
            {
                n.centre = n0.centre + most * t * (x - n0.centre).signum();
                n.trust = Some(1e-6 * t);
                clamped = true;
            }
        }
        if !clamped {
            break;
        }
        ever = true;
        fit = solve_freely(p, c, &held, terms, fit.sigma);
    }
    if ever {
        // judged by the priors as they are
        let prior = |n: &[Nuisance], x: &[f64]| -> f64 {
            n.iter()
                .zip(x)
                .filter_map(|(n, x)| n.trust.map(|t| ((x - n.centre) / t.max(1e-9)).powi(2)))
                .sum()
        };
        fit.score.log_likelihood += 0.5 * (prior(&held, &fit.nuisance) - prior(nuisances, &fit.nuisance));
    }
    fit
}

/// Most of a column's energy that may be noise for its share to be taken out of the solution (assumed).
const MOST_SHARED: f64 = 0.1;
/// Most standard deviations that a sensor's imperfection may be off.
const MOST_SIGMAS: f64 = 3.0;
/// Same of a constant of the machine that a bench trusts; friction may be anything.
pub const MOST_BELIEF: f64 = 4.0;

fn solve_freely(p: &Problem, c: &RigConstants, nuisances: &[Nuisance], terms: &[Term], sigma0: [f64; 5]) -> Fit {
    let regs = regressors(p, terms, c);
    let (y, further) = assembled(p, &regs);
    let columns: Vec<&Vec<f64>> = p.base.iter().chain(&p.local).chain(further.iter().copied()).collect();
    let (mut sigma, mut fit) = (sigma0, None);
    for _ in 0..3 {
        let (x, residual) = weighted(p, nuisances, &columns, &y, &sigma);
        let energy = p.energy(&residual);
        let prior: f64 = nuisances
            .iter()
            .zip(&x)
            .filter_map(|(n, x)| n.trust.map(|t| ((x - n.centre) / t.max(1e-9)).powi(2)))
            .sum();
        let count = Equation::ALL.map(|e| p.rows_of(e) as f64);
        let mut terms = terms.to_vec();
        let mut at = p.base.len() + p.local.len();
        for (t, r) in terms.iter_mut().zip(&regs) {
            t.amplitudes = x[at..at + r.linear.len()].to_vec();
            at += r.linear.len();
        }
        let amplitudes = Vec::new();
        let score = Score {
            log_likelihood: log_likelihood(p, &energy, &count, prior),
            energy,
            amplitudes,
        };
        let used = sigma;
        for e in 0..5 {
            if count[e] > 0.0 {
                sigma[e] = (energy[e] / count[e]).sqrt().max(0.3 * p.floor[e]);
            }
        }
        fit = Some(Fit {
            terms,
            nuisance: x[..p.base.len()].to_vec(),
            score,
            residual,
            sigma: used,
        });
    }
    fit.expect("three rounds")
}

/// One weighted solution: coefficients and unweighted residual.
fn weighted(
    p: &Problem,
    nuisances: &[Nuisance],
    columns: &[&Vec<f64>],
    y: &[f64],
    sigma: &[f64; 5],
) -> (Vec<f64>, Vec<f64>) {
    let w = p.weights(sigma);
    let scaled: Vec<Vec<f64>> = columns
        .par_iter()
        .map(|c| c.iter().zip(&w).map(|(x, w)| x * w).collect())
        .collect();
    let yw: Vec<f64> = y.iter().zip(&w).map(|(y, w)| y * w).collect();
    let n = scaled.len();
    let norms: Vec<f64> = scaled.iter().map(|c| dot(c, c).sqrt().max(1e-150)).collect();
    let rows: Vec<Vec<f64>> = (0..n)
        .into_par_iter()
        .map(|i| {
            (0..=i)
                .map(|j| dot(&scaled[i], &scaled[j]) / (norms[i] * norms[j]))
                .collect()
        })
        .collect();
    let mut gram = DMatrix::from_fn(n, n, |i, j| if j <= i { rows[i][j] } else { rows[j][i] });
    for (j, nuisance) in nuisances.iter().enumerate() {
        if let Some(t) = nuisance.trust {
            gram[(j, j)] += (1.0 / t.max(1e-9) / norms[j]).powi(2);
        }
    }
    for (j, trust) in p.local_trust.iter().enumerate() {
        let j = j + nuisances.len();
        if let (Some(t), true) = (trust, j < n) {
            gram[(j, j)] += (1.0 / t.max(1e-12) / norms[j]).powi(2);
        }
    }
    for i in 0..n {
        gram[(i, i)] += 1e-12;
    }
    let mut right = DVector::from_fn(n, |i, _| dot(&scaled[i], &yw) / norms[i]);
    for (j, nuisance) in nuisances.iter().enumerate() {
        if let Some(t) = nuisance.trust {
            right[j] += nuisance.centre / t.max(1e-9).powi(2) / norms[j];
        }
    }
    // noise that stands in the left-hand side and in a column
    for (j, nuisance) in nuisances.iter().enumerate() {
        let noise: f64 = (0..5)
            .filter(|e| p.rows_of(Equation::ALL[*e]) > 0)
            .map(|e| p.rows_of(Equation::ALL[e]) as f64 * p.shared_noise(nuisance.name, e) / sigma[e].powi(2))
            .sum();
        // where the noise is most of what is seen, there is nothing to be corrected
        if noise.abs() < MOST_SHARED * norms[j] * norms[j] {
            right[j] -= noise / norms[j];
        }
    }
    let x = gram.cholesky().map_or_else(|| DVector::zeros(n), |c| c.solve(&right));
    let x: Vec<f64> = (0..n).map(|i| x[i] / norms[i]).collect();
    let mut residual = y.to_vec();
    for (x, c) in x.iter().zip(columns) {
        residual.iter_mut().zip(c.iter()).for_each(|(r, c)| *r -= x * c);
    }
    (x, residual)
}

/// Residual of a model, each fold of rows by the constants and amplitudes that the other folds say; shapes stay.
///
/// * `fold` of each row, below `folds`
pub fn crossed(
    p: &Problem,
    c: &RigConstants,
    nuisances: &[Nuisance],
    fit: &Fit,
    fold: &[usize],
    folds: usize,
) -> Vec<f64> {
    let regs = regressors(p, &fit.terms, c);
    let (y, further) = assembled(p, &regs);
    let columns: Vec<&Vec<f64>> = p.base.iter().chain(&p.local).chain(further.iter().copied()).collect();
    let n = columns.len();
    let weights = p.weights(&fit.sigma);
    let norms: Vec<f64> = columns
        .iter()
        .map(|x| {
            x.iter()
                .zip(&weights)
                .map(|(x, w)| (x * w).powi(2))
                .sum::<f64>()
                .sqrt()
                .max(1e-150)
        })
        .collect();
    let mut grams = vec![DMatrix::<f64>::zeros(n, n); folds];
    let mut rights = vec![DVector::<f64>::zeros(n); folds];
    let mut row = vec![0.0; n];
    for r in 0..p.rows {
        let w = weights[r];
        for i in 0..n {
            row[i] = columns[i][r] * w / norms[i];
        }
        let (g, b) = (&mut grams[fold[r]], &mut rights[fold[r]]);
        for i in 0..n {
            b[i] += row[i] * y[r] * w;
            for j in 0..=i {
                g[(i, j)] += row[i] * row[j];
            }
        }
    }
    let (all, right) = (grams.iter().sum::<DMatrix<f64>>(), rights.iter().sum::<DVector<f64>>());
    let solutions: Vec<DVector<f64>> = (0..folds)
        .map(|f| {
            let lower = &all - &grams[f];
            let mut g = DMatrix::from_fn(n, n, |i, j| if j <= i { lower[(i, j)] } else { lower[(j, i)] });
            let mut b = &right - &rights[f];
            for (j, nuisance) in nuisances.iter().enumerate() {
                if let Some(t) = nuisance.trust {
                    g[(j, j)] += (1.0 / t.max(1e-9) / norms[j]).powi(2);
                    b[j] += nuisance.centre / t.max(1e-9).powi(2) / norms[j];
                }
            }
            for (j, trust) in p.local_trust.iter().enumerate() {
                if let Some(t) = trust {
                    let j = j + nuisances.len();
                    g[(j, j)] += (1.0 / t.max(1e-12) / norms[j]).powi(2);
                }
            }
            for i in 0..n {
                g[(i, i)] += 1e-12;
            }
            g.cholesky().map_or_else(|| DVector::zeros(n), |c| c.solve(&b))
        })
        .collect();
    (0..p.rows)
        .map(|r| {
            let x = &solutions[fold[r]];
            y[r] - (0..n).map(|i| x[i] * columns[i][r] / norms[i]).sum::<f64>()
        })
        .collect()
}

/// Residual of a fitted model on other runs; only what belongs to single runs is fitted there.
pub fn predicted(p: &Problem, c: &RigConstants, fit: &Fit) -> Vec<f64> {
    let regs = regressors(p, &fit.terms, c);
    let (mut r, further) = assembled(p, &regs);
    let amplitudes = fit.terms.iter().flat_map(|t| &t.amplitudes);
    for (x, col) in fit.nuisance.iter().zip(&p.base).chain(amplitudes.zip(further)) {
        r.iter_mut().zip(col.iter()).for_each(|(r, c)| *r -= x * c);
    }
    without_local(p, r, &fit.sigma)
}

/// Takes the columns of single runs out of a residual.
pub fn without_local(p: &Problem, r: Vec<f64>, sigma: &[f64; 5]) -> Vec<f64> {
    if p.local.is_empty() {
        return r;
    }
    let columns: Vec<&Vec<f64>> = p.local.iter().collect();
    weighted(p, &[], &columns, &r, sigma).1
}

/// The effect of a term, in its canonical parameters.
pub fn effect_of(t: &Term, c: &RigConstants, p: &Problem) -> Effect {
    columns::effect(t.kind, &t.shape, &t.amplitudes, c.effect.coulomb, hottest(p))
}

/// Greatest measured rise over 20 degC [K].
pub fn hottest(p: &Problem) -> f64 {
    let all = p.signals.iter().filter_map(|s| s.temperature.as_ref()).flatten();
    all.fold(0.0, |a: f64, t| {
        a.max(t - sim_worker::effect::REFERENCE_TEMPERATURE_DEGC)
    })
}
