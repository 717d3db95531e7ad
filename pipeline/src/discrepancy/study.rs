//! The study: re-tune, rank, add, prove on held-out data, stop, and say how it ended.

use super::fit::{self, Fit, Term};
use super::problem::Problem;
use super::remainder;
use super::select::{Material, Ranked};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use sim_worker::effect::{EffectKind, Equation};

/// Most effects that one study adds.
pub const MOST_EFFECTS: usize = 4;
/// Smallest gain in log-likelihood of an effect: about one false alarm in a thousand studies over
/// the whole list if residuals were as the noise says (assumed; the benchmark holds the true rate).
const LEAST_GAIN: f64 = 15.0;
/// Smallest share of the held-out energy of an equation that an effect must take away.
const LEAST_SHARE: f64 = 0.01;
/// Length of the blocks of the bootstrap [s].
const BLOCK_S: f64 = 0.4;
const DRAWS: usize = 400;
/// An effect is named when it and those before it explain this share of the excess energy.
pub const NAMED_SHARE: f64 = 0.70;
/// With a leftover below this share of the excess, nothing remains to be named.
pub const CLEAN_SHARE: f64 = 0.06;
/// A table that takes more than this share of an equation's energy has found something (assumed).
pub const UNKNOWN_SHARE: f64 = 0.05;

/// How a study ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Verdict {
    None,
    Retune,
    Named,
    NamedWithRemainder,
    Ambiguous,
    Unknown,
}

impl Verdict {
    pub fn name(self) -> &'static str {
        match self {
            Self::None => "none",
            Self::Retune => "retune",
            Self::Named => "named",
            Self::NamedWithRemainder => "named_with_remainder",
            Self::Ambiguous => "ambiguous",
            Self::Unknown => "unknown",
        }
    }
}

/// One accepted or refused effect.
#[derive(Clone, Debug)]
pub struct Step {
    pub ranked: Vec<Ranked>,
    /// energies by equation on the fit runs, before and after
    pub before: [f64; 5],
    pub after: [f64; 5],
    /// same on the held-out runs
    pub held_before: [f64; 5],
    pub held_after: [f64; 5],
    /// 2.5 % quantile of the held-out gain over its mean
    pub held_low: f64,
    pub accepted: bool,
    pub why_not: &'static str,
}

pub struct Outcome {
    pub verdict: Verdict,
    pub material: Material,
    pub nominal: Fit,
    pub retuned: Fit,
    pub model: Fit,
    pub steps: Vec<Step>,
    /// by equation: share of the excess that the effects explain, and that a table would still gain
    pub explained: f64,
    pub remainder: f64,
    /// kinds that cannot be told from the last one
    pub ambiguous_with: Vec<EffectKind>,
}

/// Share of the excess that was explained: by equation the energies gained and left, weighted by how
/// much there was to explain.
fn share(p: &Problem, before: &[f64; 5], after: &[f64; 5], left: &[f64; 5]) -> f64 {
    let (mut sum, mut weights) = (0.0, 0.0);
    for e in 0..5 {
        let n = p.rows_of(Equation::ALL[e]) as f64;
        if n == 0.0 || Equation::ALL[e] == Equation::Controller && before[e] < 1.5 * after[e] {
            continue;
        }
        let gained = (before[e] - after[e]).max(0.0);
        let excess = gained + left[e];
        let weight = n * (1.0 + excess / (after[e] - left[e]).max(0.3 * n * p.floor[e].powi(2))).ln();
        if excess > 0.0 && weight > 10.0 {
            sum += weight * gained / excess;
            weights += weight;
        }
    }
    if weights > 0.0 { sum / weights } else { 1.0 }
}

impl Material {
    /// Held-out gain of one model over another: whether it holds in 97.5 % of block draws.
    fn held_gain(&self, before: &[f64], after: &[f64], sigma: &[f64; 5]) -> (f64, f64) {
        let held = self.held.as_ref().unwrap_or(&self.fit);
        let length = (BLOCK_S * self.clock.rate_hz) as usize;
        let mut blocks: std::collections::BTreeMap<(usize, usize), f64> = Default::default();
        for b in &held.blocks {
            let e = Equation::ALL.iter().position(|x| *x == b.equation).expect("one of all");
            for (row, &k) in b.rows.clone().zip(&b.samples) {
                let d = (before[row].powi(2) - after[row].powi(2)) / sigma[e].powi(2);
                *blocks.entry((b.run, k / length)).or_default() += d;
            }
        }
        let values: Vec<f64> = blocks.into_values().collect();
        let mean = values.iter().sum::<f64>();
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let mut draws: Vec<f64> =
            (0..DRAWS).map(|_| (0..values.len()).map(|_| values[rng.random_range(0..values.len())]).sum()).collect();
        draws.sort_by(f64::total_cmp);
        (mean, draws[DRAWS / 40])
    }

    /// Residual of a model on the held-out runs (on the fit runs where there are none).
    pub fn held_residual(&self, fit: &Fit) -> Vec<f64> {
        match &self.held {
            Some(h) => fit::predicted(h, &self.constants, fit),
            None => fit.residual.clone(),
        }
    }

    pub fn held_problem(&self) -> &Problem {
        self.held.as_ref().unwrap_or(&self.fit)
    }

    /// Energy that a table would still take from the held-out residual of each equation.
    fn unnamed(&self, fit: &Fit) -> [f64; 5] {
        let held = self.held_residual(fit);
        Equation::ALL.map(|e| {
            if self.fit.rows_of(e) == 0 || e == Equation::Controller {
                return 0.0;
            }
            remainder::gained(&self.fit, &fit.residual, self.held_problem(), &held, e).max(0.0)
        })
    }
}

/// The model with nothing re-tuned and nothing added.
fn untouched(m: &Material) -> Fit {
    let p = &m.fit;
    let zero = Fit {
        terms: Vec::new(),
        nuisance: vec![0.0; m.nuisances.len()],
        score: fit::Score {
            log_likelihood: 0.0,
            energy: [0.0; 5],
            amplitudes: Vec::new(),
        },
        residual: Vec::new(),
        sigma: p.floor.map(|f| f.max(1e-300)),
    };
    let residual = fit::predicted(p, &m.constants, &zero);
    let energy = p.energy(&residual);
    Fit {
        residual,
        score: fit::Score {
            energy,
            ..zero.score.clone()
        },
        ..zero
    }
}

/// Runs the whole study; `tell` hears what is being done.
pub fn study(material: Material, tell: &dyn Fn(&str)) -> Outcome {
    tell("re-tuning");
    let nominal = untouched(&material);
    let mut m = material;
    let retuned0 = m.solve(&[], m.first_sigma());
    // the equations around the re-tuned constants, so that second order does not look like an effect
    m = m.around(&retuned0);
    let retuned = m.solve(&[], m.first_sigma());
    let mut model = retuned.clone();
    let mut steps: Vec<Step> = Vec::new();
    let mut ambiguous_with = Vec::new();
    while model.terms.len() < MOST_EFFECTS {
        tell(&format!("looking for effect {}", model.terms.len() + 1));
        let ranked = m.scan(&model, EffectKind::ALL);
        let Some(step) = try_next(&m, &model, ranked) else { break };
        let (step, next, ambiguous) = step;
        let accepted = step.accepted;
        steps.push(step);
        if !accepted {
            break;
        }
        ambiguous_with = ambiguous;
        model = next;
        m = m.around(&model);
        model = m.polish(&m.solve(&model.terms, model.sigma), 1);
    }
    let (verdict, explained, remainder) = conclude(&m, &nominal, &retuned, &mut model, &steps, &ambiguous_with);
    Outcome {
        verdict,
        material: m,
        nominal,
        retuned,
        model,
        steps,
        explained,
        remainder,
        ambiguous_with,
    }
}

type Tried = (Step, Fit, Vec<EffectKind>);

fn try_next(m: &Material, model: &Fit, ranked: Vec<Ranked>) -> Option<Tried> {
    let first = ranked.first()?;
    let best_gain = first.gain;
    // the leaders are refined together with what is in the model already
    let mut tried: Vec<(Fit, f64)> = Vec::new();
    for r in ranked.iter().take(3).filter(|r| r.gain > 0.3 * best_gain) {
        let mut terms: Vec<Term> = model.terms.clone();
        terms.push(r.term.clone());
        let fit = m.polish(&m.solve(&terms, model.sigma), 1);
        let gain = fit.score.log_likelihood - model.score.log_likelihood;
        tried.push((fit, gain));
    }
    tried.sort_by(|a, b| b.1.total_cmp(&a.1));
    let gain = tried[0].1;
    let kind_of = |f: &Fit| f.terms.last().expect("one was added").kind;
    let ambiguous = tried[1..]
        .iter()
        .filter(|t| gain - t.1 < 6.0 + 0.02 * gain)
        .map(|t| kind_of(&t.0))
        .collect();
    let mut out: Option<Step> = None;
    for (next, gain) in &tried {
        let step = judged(m, model, next, *gain, &ranked);
        if step.accepted {
            return Some((step, next.clone(), if out.is_none() { ambiguous } else { Vec::new() }));
        }
        out.get_or_insert(step);
    }
    Some((out?, tried[0].0.clone(), Vec::new()))
}

/// Whether the held-out data get better.
fn judged(m: &Material, model: &Fit, next: &Fit, gain: f64, ranked: &[Ranked]) -> Step {
    let held = m.held_problem();
    let (before, after) = (m.held_residual(model), m.held_residual(next));
    let (mean, low) = m.held_gain(&before, &after, &next.sigma);
    let (held_before, held_after) = (held.energy(&before), held.energy(&after));
    let worth = share_of_equations(&held_before, &held_after);
    let why_not = if gain < LEAST_GAIN {
        "no more than chance gives"
    } else if low <= 0.0 {
        "the held-out data do not get better"
    } else if worth < LEAST_SHARE {
        "too small to matter"
    } else {
        ""
    };
    Step {
        before: model.score.energy,
        after: next.score.energy,
        held_before,
        held_after,
        held_low: low / mean.abs().max(1e-300),
        accepted: why_not.is_empty(),
        why_not,
        ranked: ranked.to_vec(),
    }
}

/// Greatest share that any equation loses.
fn share_of_equations(before: &[f64; 5], after: &[f64; 5]) -> f64 {
    (0..5).filter(|e| before[*e] > 0.0).map(|e| 1.0 - after[e] / before[e]).fold(0.0, f64::max)
}

fn conclude(
    m: &Material,
    nominal: &Fit,
    retuned: &Fit,
    model: &mut Fit,
    steps: &[Step],
    ambiguous: &[EffectKind],
) -> (Verdict, f64, f64) {
    let unnamed = m.unnamed(model);
    let held = m.held_problem();
    let before = held.energy(&m.held_residual(retuned));
    let after = held.energy(&m.held_residual(model));
    let explained = share(held, &before, &after, &unnamed);
    // greatest share of an equation's energy that a table still takes
    let remainder = (0..5).filter(|e| after[*e] > 0.0).map(|e| unnamed[e] / after[e]).fold(0.0, f64::max);
    if model.terms.is_empty() {
        // a table that finds much is an effect that the list does not have
        if remainder > UNKNOWN_SHARE {
            return (Verdict::Unknown, 0.0, remainder);
        }
        let worse = (0..5).any(|e| nominal.score.energy[e] > 1.1 * retuned.score.energy[e]);
        let verdict = if worse { Verdict::Retune } else { Verdict::None };
        return (verdict, 0.0, remainder);
    }
    let _ = steps;
    let verdict = if explained < NAMED_SHARE {
        Verdict::Unknown
    } else if 1.0 - explained > CLEAN_SHARE && remainder > UNKNOWN_SHARE {
        Verdict::NamedWithRemainder
    } else if !ambiguous.is_empty() {
        Verdict::Ambiguous
    } else {
        Verdict::Named
    };
    (verdict, explained, remainder)
}
