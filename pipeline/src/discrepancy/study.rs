//! The study: re-tune, rank, add, prove on held-out data, stop, and say how it ended.

use super::bench::Noise;
use super::columns::{self, Form};
use super::fit::{self, Fit, Term};
use super::intervals;
use super::problem::{Nuisance, Problem};
use super::remainder;
use super::select::{Material, Ranked};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use sim_worker::effect::{EffectKind, Equation};

/// Most effects that one study adds.
pub(crate) const MOST_EFFECTS: usize = 4;
/// Smallest gain in log-likelihood of an effect: about one false alarm in a thousand studies over
/// the whole list if residuals were as the noise says (assumed; the benchmark holds the true rate).
const LEAST_GAIN: f64 = 15.0;
/// Smallest share of the held-out energy of an equation that an effect must take away.
const LEAST_SHARE: f64 = 0.01;
/// Smallest share of what is left of the excess of some equation that an effect must explain: one
/// that explains less is the nearest relative of something else (assumed).
const LEAST_PART: f64 = 0.30;
/// Gain of a candidate that is worth a look at pairs although the held-out data refuse it alone.
const PAIR_GAIN: f64 = 60.0;
/// Energy over that of the noise from which an equation has an excess.
const WORTH: f64 = 1.25;
/// Torque over the rms of the fit runs beyond which held-out data are beyond what was excited.
const EXCITED: f64 = 3.0;
/// Half-width of an amplitude's 95 % interval over the amplitude from which it may as well be nothing.
const VAGUE: f64 = 0.7;
/// Candidates that a second one is tried with.
const PAIRS: usize = 4;
/// Length of the blocks of the bootstrap [s].
const BLOCK_S: f64 = 0.4;
const DRAWS: usize = 400;
/// An effect is named when it and those before it explain this share of the excess energy.
pub(crate) const NAMED_SHARE: f64 = 0.70;
/// Where every equation has this share of its excess explained, nothing remains to be named.
pub(crate) const CLEAN_SHARE: f64 = 0.85;
/// Gap over the noise in torque or voltage beyond which nothing that was found is the cause (assumed).
const FAR: f64 = 3.5;
/// Energy over that of the noise that cannot be the noise's, with nothing found (assumed).
const BEYOND: f64 = 2.5;
/// A table that takes more than this share of an equation's energy has found something (assumed).
pub(crate) const UNKNOWN_SHARE: f64 = 0.10;

/// How a study ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Verdict {
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
    /// candidates, the best first
    pub ranked: Vec<Ranked>,
    /// energies by equation on the fit runs, before
    pub(crate) before: [f64; 5],
    /// same on the held-out runs, before and after
    pub(crate) held_before: [f64; 5],
    pub(crate) held_after: [f64; 5],
    pub(crate) accepted: bool,
    /// what was added: one effect, or two that only go together
    pub(crate) taken: Vec<EffectKind>,
    pub(crate) why_not: &'static str,
}

/// What a study comes to: verdict, models before and after, and the steps between.
pub struct Outcome {
    pub(crate) verdict: Verdict,
    pub(crate) material: Material,
    pub(crate) nominal: Fit,
    pub(crate) retuned: Fit,
    /// constants re-tuned, with the effects that were accepted
    pub model: Fit,
    /// in their order; the last one may have been refused
    pub steps: Vec<Step>,
    /// by equation: share of the excess that the effects explain, and that a table would still gain
    pub(crate) explained: f64,
    pub(crate) remainder: f64,
    /// kinds that cannot be told from the last one
    pub(crate) ambiguous_with: Vec<EffectKind>,
    /// nuisance parameters around the model's own constants
    pub(crate) first_nuisances: Vec<Nuisance>,
    /// held-out energies by equation: nominal, re-tuned, with the effects
    pub(crate) held_nominal: [f64; 5],
    pub(crate) held_retuned: [f64; 5],
    pub(crate) held_model: [f64; 5],
    /// energies on the fit runs, only re-tuned
    pub(crate) retuned_fit: [f64; 5],
    /// residual rows on the held-out runs: re-tuned, with the effects; nominal, and its factor to the drive channel
    pub(crate) held_residuals: (Vec<f64>, Vec<f64>),
    pub(crate) held_nominal_residual: Vec<f64>,
    pub(crate) nominal_to_channel: f64,
}

/// By equation: share of the held-out excess over the noise that was explained; `None` where there
/// was none worth the name.
pub(crate) fn shares(p: &Problem, before: &[f64; 5], after: &[f64; 5]) -> [Option<f64>; 5] {
    std::array::from_fn(|e| {
        let n = p.rows_of(Equation::ALL[e]) as f64;
        let floor = n * p.floor[e].powi(2);
        // the controller's own equation has no floor that is known
        let floor = if Equation::ALL[e] == Equation::Controller {
            after[e].min(before[e])
        } else {
            floor
        };
        (n > 0.0 && before[e] > WORTH * floor).then(|| 1.0 - (after[e] - floor).max(0.0) / (before[e] - floor))
    })
}

/// The shares as one: weighted by the logarithm of how far each equation was off.
pub(crate) fn overall(p: &Problem, before: &[f64; 5], shares: &[Option<f64>; 5]) -> f64 {
    let (mut sum, mut weights) = (0.0, 0.0);
    for e in 0..5 {
        if let Some(share) = shares[e] {
            let n = p.rows_of(Equation::ALL[e]) as f64;
            let weight = n * (before[e] / (n * p.floor[e].powi(2))).ln().max(0.1);
            sum += weight * share;
            weights += weight;
        }
    }
    if weights > 0.0 { sum / weights } else { 1.0 }
}

impl Material {
    /// Held-out gain of one model over another that holds in 97.5 % of block draws.
    fn held_gain(&self, before: &[f64], after: &[f64], sigma: &[f64; 5]) -> f64 {
        let held = self.held.as_ref().unwrap_or(&self.fit);
        let length = self.clock.block(BLOCK_S);
        let mut blocks: std::collections::BTreeMap<(usize, usize), f64> = Default::default();
        for b in &held.blocks {
            let e = b.equation.index();
            for (row, &k) in b.rows.clone().zip(&b.samples) {
                let d = (before[row].powi(2) - after[row].powi(2)) / sigma[e].powi(2);
                *blocks.entry((b.run, k / length)).or_default() += d;
            }
        }
        let values: Vec<f64> = blocks.into_values().collect();
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let mut draws: Vec<f64> = (0..DRAWS)
            .map(|_| {
                (0..values.len())
                    .map(|_| values[rng.random_range(0..values.len())])
                    .sum()
            })
            .collect();
        draws.sort_by(f64::total_cmp);
        draws[DRAWS / 40]
    }

    /// Residual of a model on the held-out runs (on the fit runs where there are none).
    pub(crate) fn held_residual(&self, fit: &Fit) -> Vec<f64> {
        match &self.held {
            Some(h) => fit::predicted(h, &self.constants, fit),
            None => fit.residual.clone(),
        }
    }

    /// As [`Material::held_residual`], without the rows whose torque goes far beyond that of the fit
    /// runs: there a per cent of error in a constant is more than any effect.
    fn judged_residual(&self, fit: &Fit) -> Vec<f64> {
        let mut r = self.held_residual(fit);
        let rows = self.fit.rows_of(Equation::Torque).max(1) as f64;
        let usual = EXCITED * (self.fit.drive.iter().map(|x| x * x).sum::<f64>() / rows).sqrt();
        for (r, u) in r.iter_mut().zip(&self.held_problem().drive) {
            if u.abs() > usual {
                *r = 0.0;
            }
        }
        r
    }

    pub(crate) fn held_problem(&self) -> &Problem {
        self.held.as_ref().unwrap_or(&self.fit)
    }

    /// Energy that a table would still take from the held-out residual of each equation.
    fn unnamed(&self, fit: &Fit) -> [f64; 5] {
        let held = self.held_residual(fit);
        Equation::ALL.map(|e| {
            if self.fit.rows_of(e) == 0 || e == Equation::Controller {
                return 0.0;
            }
            remainder::gained(
                &self.fit,
                &fit.residual,
                self.held_problem(),
                &held,
                e,
                self.constants.measured_current,
            )
            .max(0.0)
        })
    }
}

/// The model with nothing re-tuned and nothing added; only the sensors' imperfections are allowed for.
fn untouched(m: &Material) -> Fit {
    let mut fixed = m.nuisances.clone();
    fixed
        .iter_mut()
        .filter(|n| n.of_machine)
        .for_each(|n| n.trust = Some(1e-9));
    fit::solve(&m.fit, &m.constants, &fixed, &[], m.first_sigma())
}

/// Runs the whole study; `tell` hears what is being done.
pub fn study(material: Material, tell: &dyn Fn(&str)) -> Outcome {
    tell("re-tuning");
    let nominal = untouched(&material);
    let held_nominal_residual = material.held_residual(&nominal);
    let held_nominal = material.held_problem().energy(&held_nominal_residual);
    let nominal_to_channel = 1.0 / material.bench.rig.drive_constant.value;
    let first_nuisances = material.nuisances.clone();
    let mut m = material;
    let retuned0 = m.solve(&[], m.first_sigma());
    // the equations around the re-tuned constants, so that second order does not look like an effect
    m = m.around(&retuned0);
    let mut retuned = m.solve(&[], m.first_sigma());
    let mut model = retuned.clone();
    let mut steps: Vec<Step> = Vec::new();
    let mut ambiguous_with = Vec::new();
    while model.terms.len() < MOST_EFFECTS {
        tell(&format!("looking for effect {}", model.terms.len() + 1));
        let ranked = m.scan(&model, EffectKind::ALL);
        let Some(step) = try_next(&m, &model, ranked) else {
            break;
        };
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
        retuned = m.solve(&[], m.first_sigma());
    }
    // an amplitude that may as well be nothing is no effect
    while let Some(vague) = vague(&m, &model) {
        model.terms.remove(vague);
        model = m.polish(&m.solve(&model.terms, model.sigma), 1);
        ambiguous_with.clear();
    }
    let (verdict, explained, remainder) = conclude(&m, &nominal, &retuned, &model, &ambiguous_with);
    let held_residuals = (m.held_residual(&retuned), m.held_residual(&model));
    let held = m.held_problem();
    Outcome {
        verdict,
        first_nuisances,
        held_nominal,
        held_retuned: held.energy(&held_residuals.0),
        held_model: held.energy(&held_residuals.1),
        retuned_fit: retuned.score.energy,
        held_residuals,
        held_nominal_residual,
        nominal_to_channel,
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

/// The last term whose amplitude's interval reaches nothing.
fn vague(m: &Material, model: &Fit) -> Option<usize> {
    if model.terms.is_empty() {
        return None;
    }
    let intervals = intervals::intervals(m, model);
    (0..model.terms.len()).rev().find(|&t| {
        let e = fit::effect_of(&model.terms[t], &m.constants, &m.fit);
        let linear = !matches!(columns::form(e.kind), Form::Shape | Form::Presliding);
        linear && intervals.terms[t][0] > VAGUE * e.values[0].abs()
    })
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
    // two effects may each make the held-out data worse without the other
    if best_gain > PAIR_GAIN && model.terms.len() + 2 <= MOST_EFFECTS {
        let mut pairs: Vec<(Fit, f64)> = Vec::new();
        for first in ranked.iter().take(PAIRS).filter(|r| r.gain > 0.15 * best_gain) {
            let mut terms = model.terms.clone();
            terms.push(first.term.clone());
            let alone = m.solve(&terms, model.sigma);
            let Some(second) = m
                .scan(&alone, EffectKind::ALL)
                .into_iter()
                .next()
                .filter(|r| r.gain > LEAST_GAIN)
            else {
                continue;
            };
            terms.push(second.term);
            let pair = m.polish(&m.solve(&terms, alone.sigma), 2);
            let gain = pair.score.log_likelihood - model.score.log_likelihood;
            pairs.push((pair, gain));
        }
        pairs.sort_by(|a, b| b.1.total_cmp(&a.1));
        for (pair, gain) in pairs {
            let step = judged(m, model, &pair, gain, &ranked);
            if step.accepted {
                return Some((step, pair, Vec::new()));
            }
        }
    }
    Some((out?, tried[0].0.clone(), Vec::new()))
}

/// Whether the held-out data get better.
fn judged(m: &Material, model: &Fit, next: &Fit, gain: f64, ranked: &[Ranked]) -> Step {
    let held = m.held_problem();
    let (before, after) = (m.judged_residual(model), m.judged_residual(next));
    let low = m.held_gain(&before, &after, &next.sigma);
    let (held_before, held_after) = (held.energy(&before), held.energy(&after));
    let worth = share_of_equations(&held_before, &held_after);
    // a mass, a friction below zero is no machine
    let below = |name: &str| {
        m.nuisances
            .iter()
            .zip(&next.nuisance)
            .any(|(n, x)| n.name == name && n.nominal > 0.0 && *x <= -1.0)
    };
    let impossible = ["inertia", "viscous", "coulomb", "resistance"].into_iter().any(below)
        || m.nuisances
            .iter()
            .zip(&next.nuisance)
            .any(|(n, x)| n.name == "play" && *x < -1.1);
    let why_not = if impossible {
        "a constant of the machine would have to be negative"
    } else if gain < LEAST_GAIN {
        "no more than chance gives"
    } else if low <= 0.0 {
        "the held-out data do not get better"
    } else if worth < LEAST_SHARE {
        "too small to matter"
    } else if part(m, &held_before, &held_after) < LEAST_PART {
        "it explains little of what is left"
    } else {
        ""
    };
    Step {
        before: model.score.energy,
        held_before,
        held_after,
        accepted: why_not.is_empty(),
        taken: next.terms[model.terms.len()..].iter().map(|t| t.kind).collect(),
        why_not,
        ranked: ranked.to_vec(),
    }
}

/// Greatest share of the excess over the noise that any equation loses on the held-out runs.
fn part(m: &Material, before: &[f64; 5], after: &[f64; 5]) -> f64 {
    let held = m.held_problem();
    let of = |e: usize| {
        let floor = held.rows_of(Equation::ALL[e]) as f64 * held.floor[e].powi(2);
        let excess = before[e] - floor.min(after[e]);
        if excess > 0.0 && before[e] - after[e] > LEAST_SHARE * before[e] {
            (before[e] - after[e]) / excess
        } else {
            0.0
        }
    };
    (0..5).map(of).fold(0.0, f64::max)
}

/// Greatest share that any equation loses.
fn share_of_equations(before: &[f64; 5], after: &[f64; 5]) -> f64 {
    (0..5)
        .filter(|e| before[*e] > 0.0)
        .map(|e| 1.0 - after[e] / before[e])
        .fold(0.0, f64::max)
}

/// Whether what is left of the transmission's gap is slow: user and motor part company, which no
/// spring and no play does.
fn drifting(p: &Problem, residual: &[f64], gap: f64) -> bool {
    let length = p.clock.block(1.0);
    let (mut slow, mut all) = (0.0, 0.0);
    for b in p.blocks.iter().filter(|b| b.equation == Equation::Transmission) {
        let mut seconds = std::collections::BTreeMap::<usize, (f64, f64)>::new();
        for (row, &k) in b.rows.clone().zip(&b.samples) {
            let s = seconds.entry(k / length).or_default();
            *s = (s.0 + 1.0, s.1 + residual[row]);
            all += residual[row].powi(2);
        }
        slow += seconds.values().map(|s| s.1 * s.1 / s.0).sum::<f64>();
    }
    gap > FAR * FAR && slow > 0.5 * all
}

fn conclude(m: &Material, nominal: &Fit, retuned: &Fit, model: &Fit, ambiguous: &[EffectKind]) -> (Verdict, f64, f64) {
    let unnamed = m.unnamed(model);
    let held = m.held_problem();
    let before = held.energy(&m.judged_residual(retuned));
    let after = held.energy(&m.judged_residual(model));
    let by_equation = shares(held, &before, &after);
    let explained = overall(held, &before, &by_equation);
    // an equation that was off before, or that an effect has touched
    let counts = |e: usize| {
        let floor = held.rows_of(Equation::ALL[e]) as f64 * held.floor[e].powi(2);
        before[e] > BEYOND * floor || (before[e] - after[e]).abs() > 0.05 * before[e]
    };
    let counted = (0..5).filter(|e| counts(*e)).filter_map(|e| by_equation[e]);
    let worst = counted.fold(1.0, |a: f64, b| a.min(b));
    // an effect is not that which leaves its own equation unexplained
    let own = |t: &Term| by_equation[t.kind.equation().index()];
    let stranger = model.terms.iter().filter_map(own).any(|s| s < NAMED_SHARE);
    let gaps = m.over_floor(held, &after);
    // only what the sensors are known to add can be held against a name
    let drive = m.bench.channel(m.bench.rig.drive);
    let stated = drive.is_some_and(|d| matches!(d.noise, Noise::Known(_)));
    // a spring or a gap that is right in the transmission leaves impacts in the torque
    let transmission = model
        .terms
        .iter()
        .any(|t| matches!(t.kind, EffectKind::Compliance | EffectKind::Backlash))
        && by_equation[2].is_some_and(|s| s > CLEAN_SHARE);
    let far = |e: usize| gaps[e] > if transmission && e == 0 { 2.0 * FAR } else { FAR };
    let far = stated && (far(0) || far(1)) || drifting(held, &m.held_residual(model), gaps[2]);
    // greatest share of an equation's energy that a table still takes
    let remainder = (0..5)
        .filter(|e| after[*e] > 0.0)
        .map(|e| unnamed[e] / after[e])
        .fold(0.0, f64::max);
    if model.terms.is_empty() {
        // what a table finds, or what is far beyond the noise, is an effect that the list does not have
        let beyond = stated
            && (0..4).any(|e| {
                by_equation[e].is_some()
                    && after[e] > BEYOND * held.rows_of(Equation::ALL[e]) as f64 * held.floor[e].powi(2)
            });
        let over = (0..4).any(|e| by_equation[e].is_some());
        if remainder > UNKNOWN_SHARE && over || beyond {
            return (Verdict::Unknown, 0.0, remainder);
        }
        let worse = (0..5).any(|e| nominal.score.energy[e] > 1.1 * retuned.score.energy[e]);
        let verdict = if worse { Verdict::Retune } else { Verdict::None };
        return (verdict, 0.0, remainder);
    }
    let verdict = if explained < NAMED_SHARE || stranger || far {
        Verdict::Unknown
    } else if worst < CLEAN_SHARE {
        Verdict::NamedWithRemainder
    } else if !ambiguous.is_empty() {
        Verdict::Ambiguous
    } else {
        Verdict::Named
    };
    (verdict, explained, remainder)
}
