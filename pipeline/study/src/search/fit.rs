//! Weighted least squares with priors: a model with given shapes, solved, crossed and predicted.

use crate::candidates::columns;
use crate::equations::nuisances::Nuisance;
use crate::equations::pieces::{RigConstants, wide};
use crate::equations::problem::Problem;
use crate::measured::sums::{add, dot};
use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;
use sim_worker::effect::{Effect, EffectKind, Equation};
use std::borrow::Cow;

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

impl Term {
    /// The equation that it is first seen in: an error that angle and speed have alike parts no two sensors.
    pub fn equation(&self) -> Equation {
        let alike = self.kind == EffectKind::EncoderEccentricity && self.shape.first().is_some_and(|both| *both > 0.5);
        if alike { Equation::Torque } else { self.kind.equation() }
    }

    /// Whether it is a gain of all current sensors together, not of one phase's.
    pub fn is_gain_of_all(&self) -> bool {
        self.kind == EffectKind::CurrentGain && self.shape.is_empty()
    }
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
        if fixed {
            linear_pieces.push(fixed_pieces);
        }
        let mut linear = p.columns(&linear_pieces);
        Self {
            fixed: if fixed { linear.pop() } else { None },
            linear,
        }
    }

    pub fn is_empty(&self) -> bool {
        self.fixed.is_none() && self.linear.is_empty()
    }
}

/// How well a model does.
#[derive(Clone, Debug)]
pub struct Score {
    pub log_likelihood: f64,
    pub energy: [f64; 5],
    pub amplitudes: Vec<f64>,
}

/// Log-likelihood of residual energies with unknown standard deviations, none below the floor.
pub fn log_likelihood(p: &Problem, energy: &[f64; 5], count: &[f64; 5], prior: f64) -> f64 {
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

/// Energy over that of the noise from which an equation has an excess that is worth a share.
pub const WORTH: f64 = 1.1;

/// Most effects that one study adds.
pub const MOST_EFFECTS: usize = 4;

/// A fitted model.
#[derive(Clone, Debug)]
pub struct Fit {
    /// the effects in it
    pub terms: Vec<Term>,
    /// relative deviations of the nuisance parameters
    pub nuisance: Vec<f64>,
    /// what was believed of them in the end: what went further than it may is held
    pub believed: Vec<Nuisance>,
    pub score: Score,
    /// unweighted residual rows
    pub residual: Vec<f64>,
    /// covariance of nuisance parameters and amplitudes, in this order, for independent noise of `sigma`
    pub sigma: [f64; 5],
}

impl Fit {
    /// Whether an effect is in it.
    pub fn has(&self, kind: EffectKind) -> bool {
        self.terms.iter().any(|t| t.kind == kind)
    }

    /// Kinds of its effects, in the order of the list.
    pub fn kinds(&self) -> Vec<EffectKind> {
        let mut all: Vec<EffectKind> = self.terms.iter().map(|t| t.kind).collect();
        all.sort_unstable();
        all
    }
}

/// A nuisance parameter by its name, and its relative deviation in a fit.
pub fn deviation<'a>(nuisances: &'a [Nuisance], fit: &Fit, name: &str) -> Option<(&'a Nuisance, f64)> {
    let mut all = nuisances.iter().zip(&fit.nuisance);
    all.find(|(n, _)| n.name == name).map(|(n, x)| (n, *x))
}

/// A constant of the machine as a fit has it, 0 where there is none.
pub fn constant(nuisances: &[Nuisance], fit: &Fit, name: &str) -> f64 {
    deviation(nuisances, fit, name).map_or(0.0, |(n, x)| n.nominal * (1.0 + x))
}

/// The model's regressors on a problem.
pub fn regressors(p: &Problem, terms: &[Term], c: &RigConstants) -> Vec<Regressor> {
    terms
        .par_iter()
        .map(|t| Regressor::new(p, t.kind, &t.shape, c))
        .collect()
}

/// A model's equations.
pub struct Assembled<'a> {
    /// left-hand side less the fixed parts
    pub y: Vec<f64>,
    /// columns of the constants
    pub base: Vec<Cow<'a, Vec<f64>>>,
    /// columns of the amplitudes
    pub further: Vec<&'a Vec<f64>>,
}

/// * `regs` of the terms, in their order
pub fn assembled<'a>(p: &'a Problem, c: &RigConstants, terms: &[Term], regs: &'a [Regressor]) -> Assembled<'a> {
    let mut y = p.y.clone();
    for f in regs.iter().filter_map(|r| r.fixed.as_ref()) {
        add(&mut y, -1.0, f);
    }
    Assembled {
        y,
        base: base(p, c, terms, regs),
        further: regs.iter().flat_map(|r| &r.linear).collect(),
    }
}

/// Columns of the constants beside effects: with bristles in place of dry friction, more of it is more of theirs, and the torque
/// that is left for the inertia is less by theirs. Then torques and inertia that are all as much greater stay the same motion, and
/// their scale is what the machine's constants say, not what stands between two ways of turning round.
pub fn base<'a>(p: &'a Problem, c: &RigConstants, terms: &[Term], regs: &[Regressor]) -> Vec<Cow<'a, Vec<f64>>> {
    let mut base: Vec<_> = p.base.iter().map(Cow::Borrowed).collect();
    let bristles = terms.iter().position(|t| t.kind == EffectKind::Presliding);
    let instead = bristles.and_then(|i| regs[i].fixed.as_ref());
    if let (Some(at), Some(instead)) = (p.dry_friction, instead) {
        let friction = c.effect.coulomb;
        if friction > 0.0 {
            let by = wide(friction) / friction;
            add(base[at].to_mut(), by, instead);
        }
        if let Some(at) = p.inertia {
            add(base[at].to_mut(), -1.0, instead);
        }
    }
    base
}

/// Solves for nuisance parameters and amplitudes of terms whose shapes are given; the standard
/// deviations of the equations are those of the residuals, in three rounds.
pub fn solve(p: &Problem, c: &RigConstants, nuisances: &[Nuisance], terms: &[Term], sigma0: [f64; 5]) -> Fit {
    let beside = beside(nuisances, terms.iter().map(|t| t.kind));
    let nuisances = beside.as_deref().unwrap_or(nuisances);
    let mut fit = solve_freely(p, c, nuisances, terms, sigma0);
    // a sensor is as good as it is, a constant about what it is said to be: what goes further is not their error
    let mut held = nuisances.to_vec();
    let mut ever = false;
    for _ in 0..MOST_HELD {
        let over = |i: usize| -> f64 {
            let (n, n0) = (&held[i], &nuisances[i]);
            let most = match n.name {
                "coulomb" | "viscous" | "offset" | "play" => return 0.0,
                _ if n.of_machine => MOST_BELIEF,
                _ => MOST_SIGMAS,
            };
            match n0.trust {
                Some(t) if t > 1e-8 && n.trust == n0.trust => n0.strain(fit.nuisance[i], most * t),
                _ => 0.0,
            }
        };
        // one at a time: along directions that no data fix several run away together, and come back together
        let Some(i) = (0..held.len())
            .max_by(|a, b| over(*a).total_cmp(&over(*b)))
            .filter(|i| over(*i) > 1.0)
        else {
            break;
        };
        let (n0, x) = (&nuisances[i], fit.nuisance[i] - nuisances[i].centre);
        let t = n0.trust.expect("it has a belief");
        held[i].centre = n0.centre + x / over(i);
        held[i].trust = Some(1e-6 * t);
        ever = true;
        fit = solve_freely(p, c, &held, terms, sigma0);
    }
    if ever {
        // judged by the priors as they are
        fit.score.log_likelihood += 0.5 * (disbelief(&held, &fit.nuisance) - disbelief(nuisances, &fit.nuisance));
    }
    fit
}

/// What is believed of nuisances beside effects, where it is another: beside a drive that is late the law's clock would be the
/// same delay once more; a play is the whole of it, that of the type included; whether what is said of the inertia is with a
/// load on its spring or without it, nobody knows.
pub fn beside(nuisances: &[Nuisance], kinds: impl IntoIterator<Item = EffectKind>) -> Option<Vec<Nuisance>> {
    let mut all: Option<Vec<Nuisance>> = None;
    for kind in kinds {
        let name = match kind {
            EffectKind::ControlDelay => "law_clock",
            EffectKind::Compliance => "inertia",
            EffectKind::Backlash => "play",
            _ => continue,
        };
        let named = all.get_or_insert_with(|| nuisances.to_vec()).iter_mut();
        for n in named.filter(|n| n.name == name) {
            match kind {
                EffectKind::Compliance => n.trust = n.trust.map(|t| t.max(1.0)),
                EffectKind::Backlash => (n.trust, n.centre) = (Some(1e-9), -1.0),
                _ => n.trust = Some(1e-9),
            }
        }
    }
    all
}

/// Most of a column's energy that may be noise for its share to be taken out of the solution (assumed).
const MOST_SHARED: f64 = 0.1;
/// Most parameters that are held at the end of their belief.
const MOST_HELD: usize = 8;
/// Most standard deviations that a sensor's imperfection may be off.
const MOST_SIGMAS: f64 = 3.0;
/// Same of a constant of the machine that a bench trusts; friction may be anything.
pub const MOST_BELIEF: f64 = 4.0;

/// What is believed of each amplitude of the terms.
fn trusts(terms: &[Term], regs: &[Regressor]) -> Vec<Option<f64>> {
    let each = terms.iter().zip(regs);
    each.flat_map(|(t, r)| r.linear.iter().map(|_| columns::trust(t.kind)))
        .collect()
}

fn solve_freely(p: &Problem, c: &RigConstants, nuisances: &[Nuisance], terms: &[Term], sigma0: [f64; 5]) -> Fit {
    let regs = regressors(p, terms, c);
    let Assembled { y, base, further } = assembled(p, c, terms, &regs);
    let columns: Vec<&Vec<f64>> = base.iter().map(AsRef::as_ref).chain(&p.local).chain(further).collect();
    // columns of the measured current beside the resistance's
    let first = p.base.len() + p.local.len();
    let trusts = trusts(terms, &regs);
    let each = terms
        .iter()
        .zip(&regs)
        .flat_map(|(t, r)| r.linear.iter().map(move |_| t));
    let places: Vec<(usize, &Term)> = each.enumerate().map(|(i, t)| (first + i, t)).collect();
    let at = |of: &dyn Fn(&Term) -> bool| -> Vec<usize> {
        let those = places.iter().filter(|x| of(x.1));
        those.map(|x| x.0).collect()
    };
    let gains = at(&Term::is_gain_of_all);
    let noisy = at(&|t| {
        let of_current = matches!(
            t.kind,
            EffectKind::CurrentGain | EffectKind::WindingHeating | EffectKind::SupplySag
        );
        of_current && !t.is_gain_of_all()
    });
    let (mut sigma, mut fit) = (sigma0, None);
    for _ in 0..3 {
        let (x, residual) = weighted(p, (nuisances, &trusts), &columns, &y, &sigma, (&noisy, &gains));
        let energy = p.energy(&residual);
        let amplitudes = trusts.iter().zip(&x[first..]);
        let of_amplitudes: f64 = amplitudes.filter_map(|(t, x)| Some((x / (*t)?).powi(2))).sum();
        let prior = disbelief(nuisances, &x) + of_amplitudes;
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
            believed: nuisances.to_vec(),
            score,
            residual,
            sigma: used,
        });
    }
    fit.expect("three rounds")
}

/// What is believed of nuisances and of the columns of single runs, added to normal equations whose columns are divided by
/// `norms`: nuisances first, then the columns of single runs, then others.
///
/// * `trusts` of those others, where there is a belief
fn believe(
    gram: &mut DMatrix<f64>,
    right: &mut DVector<f64>,
    p: &Problem,
    (nuisances, trusts): (&[Nuisance], &[Option<f64>]),
    norms: &[f64],
) {
    for (j, nuisance) in nuisances.iter().enumerate() {
        if let Some(t) = nuisance.trust {
            let t = t.max(1e-9);
            gram[(j, j)] += (1.0 / t / norms[j]).powi(2);
            right[j] += nuisance.centre / t.powi(2) / norms[j];
        }
    }
    for (j, trust) in p.local_trust.iter().chain(trusts).enumerate() {
        if let Some(t) = trust {
            let j = j + nuisances.len();
            gram[(j, j)] += (1.0 / t.max(1e-12) / norms[j]).powi(2);
        }
    }
    for i in 0..norms.len() {
        gram[(i, i)] += 1e-12;
    }
}

/// Energy of deviations against what is believed of them.
fn disbelief(nuisances: &[Nuisance], x: &[f64]) -> f64 {
    nuisances
        .iter()
        .zip(x)
        .filter_map(|(n, x)| n.trust.map(|t| ((x - n.centre) / t.max(1e-9)).powi(2)))
        .sum()
}

/// What noise alone makes of a nuisance's column times the left-hand side, weighted, by the constant in whose column it stands.
/// A residual below the floor says that the noise is less than it is taken for.
fn shared(p: &Problem, name: &str, sigma: &[f64; 5]) -> Vec<(&'static str, f64)> {
    let of = |e: usize| {
        let rows = p.rows_of(Equation::ALL[e]) as f64;
        let known = sigma[e].max(p.floor[e]).powi(2);
        p.shared_noise(name, e)
            .map(|(owner, noise)| (owner, if rows > 0.0 { rows * noise / known } else { 0.0 }))
    };
    (0..5).flat_map(of).filter(|x| x.1 != 0.0).collect()
}

/// Noise that stands in the column of a constant, and in others that hold the same signal.
pub struct Noise {
    /// place of the constant
    pub owner: usize,
    /// place of each column that it stands in, and its product with the left-hand side, weighted
    pub of: Vec<(usize, f64)>,
}

impl Noise {
    /// Share of the energy of the constant's own column.
    ///
    /// * `norms` of all columns
    pub fn share(&self, norms: &[f64]) -> f64 {
        let own = self.of.iter().find(|o| o.0 == self.owner).map_or(0.0, |o| o.1);
        own.abs() / norms[self.owner].powi(2)
    }

    /// Whether it is taken out of a solution: where noise is much of what is seen, there is nothing to be corrected, in any column that
    /// holds it.
    pub fn is_taken_out(&self, norms: &[f64]) -> bool {
        self.share(norms) < MOST_SHARED
    }
}

/// The noise of each constant's column.
pub fn noises(p: &Problem, nuisances: &[Nuisance], sigma: &[f64; 5]) -> Vec<Noise> {
    let parts: Vec<Vec<(&str, f64)>> = nuisances.iter().map(|n| shared(p, n.name, sigma)).collect();
    let of_owner = |(owner, n): (usize, &Nuisance)| {
        let of = |(i, parts): (usize, &Vec<(&str, f64)>)| {
            let sum: f64 = parts.iter().filter(|x| x.0 == n.name).map(|x| x.1).sum();
            (sum != 0.0).then_some((i, sum))
        };
        let of: Vec<(usize, f64)> = parts.iter().enumerate().filter_map(of).collect();
        (!of.is_empty()).then_some(Noise { owner, of })
    };
    nuisances.iter().enumerate().filter_map(of_owner).collect()
}

/// One weighted solution: coefficients and unweighted residual.
///
/// * `noisy` columns beyond the nuisances' that hold the measured current as the resistance's does
/// * `gains` and those that are all of the measured current, with the other sign
fn weighted(
    p: &Problem,
    (nuisances, trusts): (&[Nuisance], &[Option<f64>]),
    columns: &[&Vec<f64>],
    y: &[f64],
    sigma: &[f64; 5],
    (noisy, gains): (&[usize], &[usize]),
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
    let mut right = DVector::from_fn(n, |i, _| dot(&scaled[i], &yw) / norms[i]);
    believe(&mut gram, &mut right, p, (nuisances, trusts), &norms);
    // noise that stands in the left-hand side and in a column
    let mut taken_out = noises(p, nuisances, sigma);
    taken_out.retain(|noise| noise.is_taken_out(&norms));
    let mut of_columns = vec![0.0; nuisances.len()];
    for (j, x) in taken_out.iter().flat_map(|noise| &noise.of) {
        of_columns[*j] += x;
    }
    for (j, x) in of_columns.iter().enumerate() {
        right[j] -= x / norms[j];
    }
    let of_owner = |owner: &str| taken_out.iter().find(|noise| nuisances[noise.owner].name == owner);
    let of_current: f64 = ["drive_gain", "between_samples"]
        .map(|n| {
            let parts = shared(p, n, sigma).into_iter();
            parts.filter(|x| of_owner(x.0).is_some()).map(|x| x.1).sum::<f64>()
        })
        .iter()
        .sum();
    for &j in gains {
        right[j] += of_current / norms[j];
    }
    if let Some(r) = of_owner("resistance").map(|noise| noise.owner) {
        for &j in noisy {
            // by as much as it is the resistance's column once more
            right[j] -= of_columns[r] * gram[(j, r)] / norms[r];
        }
    }
    let x = gram.cholesky().map_or_else(|| DVector::zeros(n), |c| c.solve(&right));
    let x: Vec<f64> = (0..n).map(|i| x[i] / norms[i]).collect();
    let mut residual = y.to_vec();
    for (x, c) in x.iter().zip(columns) {
        add(&mut residual, -x, c);
    }
    (x, residual)
}

/// Residual of a model, each fold of rows by the constants and amplitudes that the other folds say; shapes stay.
///
/// * `fold` of each row, below `folds`
pub fn crossed(p: &Problem, c: &RigConstants, fit: &Fit, fold: &[usize], folds: usize) -> Vec<f64> {
    // a belief that holds a parameter of the fit holds it here
    let nuisances = &fit.believed;
    let regs = regressors(p, &fit.terms, c);
    let Assembled { y, base, further } = assembled(p, c, &fit.terms, &regs);
    let trusts = trusts(&fit.terms, &regs);
    let columns: Vec<&Vec<f64>> = base.iter().map(AsRef::as_ref).chain(&p.local).chain(further).collect();
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
            believe(&mut g, &mut b, p, (nuisances, &trusts), &norms);
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
    let Assembled {
        y: mut r,
        base,
        further,
    } = assembled(p, c, &fit.terms, &regs);
    let amplitudes = fit.terms.iter().flat_map(|t| &t.amplitudes);
    let base = base.iter().map(AsRef::as_ref);
    for (x, col) in fit.nuisance.iter().zip(base).chain(amplitudes.zip(further)) {
        add(&mut r, -x, col);
    }
    without_local(p, r, &fit.sigma)
}

/// Takes the columns of single runs out of a residual.
pub fn without_local(p: &Problem, r: Vec<f64>, sigma: &[f64; 5]) -> Vec<f64> {
    if p.local.is_empty() {
        return r;
    }
    let columns: Vec<&Vec<f64>> = p.local.iter().collect();
    weighted(p, (&[], &[]), &columns, &r, sigma, (&[], &[])).1
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
