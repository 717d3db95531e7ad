//! The study: re-tune, rank, add, prove on held-out data, stop, and say how it ended.

use crate::candidates::columns::{self, Form};
use crate::equations::nuisances::Nuisance;
use crate::equations::problem::Problem;
use crate::search::fit::{self, Fit, Term};
use crate::search::intervals;
use crate::search::remainder;
use crate::search::scan;
use crate::search::select::{Material, Ranked};
use crate::search::verdict::{SLOW_S, SLOWLY, Verdict, WORTH, conclude, rough_energy};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use sim_worker::effect::{EffectKind, Equation};

/// Most effects that one study adds.
pub const MOST_EFFECTS: usize = 4;
/// Smallest gain in log-likelihood of an effect, after what its parameters cost: about one false alarm in a
/// thousand studies over the whole list if residuals were as the noise says (assumed; the benchmark holds the
/// true rate).
const LEAST_GAIN: f64 = 12.0;
/// Smallest share of the excess over the noise of some equation that an effect must explain: one that explains
/// less is the nearest relative of something else (assumed).
const LEAST_PART: f64 = 0.30;
/// Torque of an effect over the drive's, both rms, from which it matters (assumed).
const LEAST_TORQUE: f64 = 2e-3;
/// Gain of a candidate that is worth a look at pairs although it is refused alone.
const PAIR_GAIN: f64 = 60.0;
/// Torque over the rms of the fit runs beyond which held-out data are beyond what was excited.
const EXCITED: f64 = 3.0;
/// Half-width of an amplitude's 95 % interval over the amplitude from which it may as well be nothing.
const VAGUE: f64 = 0.7;
/// Gain of an effect that is there whatever its interval says.
const CERTAIN: f64 = 60.0;
/// Candidates that a second one is tried with.
const PAIRS: usize = 4;
/// Length of the blocks of the bootstrap [s].
const BLOCK_S: f64 = 0.4;
const DRAWS: usize = 400;
/// Parts of the fit runs, each judged by what the others say.
const FOLDS: usize = 5;
/// Log-likelihood by which a rival must fall behind, and share of the gain where the best leaves a gap (assumed).
const RIVAL: f64 = 5.0;
const RIVAL_SHARE: f64 = 0.02;
/// A block of held-out data whose gap stays beyond this energy, whatever the model, was disturbed (assumed).
const DISTURBED: f64 = 6.0;
/// Length of the pieces in which a disturbance shows by itself [s] (assumed).
const DISTURBED_S: f64 = 0.05;

/// One accepted or refused effect.
#[derive(Clone, Debug)]
pub struct Step {
    /// candidates, the best first
    pub ranked: Vec<Ranked>,
    /// energies by equation on the fit runs, before and after
    pub before: [f64; 5],
    pub after: [f64; 5],
    pub accepted: bool,
    /// what was added: one effect, or two that only go together
    pub taken: Vec<EffectKind>,
    pub why_not: &'static str,
}

/// An effect, and the rms of its equation's rows on the held-out runs without it and with all.
pub type Proof = (EffectKind, f64, f64);

/// What a study comes to: verdict, models before and after, and the steps between.
pub struct Outcome {
    pub verdict: Verdict,
    pub material: Material,
    pub nominal: Fit,
    pub retuned: Fit,
    /// constants re-tuned, with the effects that were accepted
    pub model: Fit,
    /// in their order; the last one may have been refused
    pub steps: Vec<Step>,
    /// by equation: share of the excess that the effects explain, and that a table would still gain
    pub explained: f64,
    pub remainder: f64,
    /// effects, and the kinds that cannot be told from each
    pub ambiguous: Vec<(EffectKind, Vec<EffectKind>)>,
    pub proofs: Vec<Proof>,
    /// nuisance parameters around the model's own constants
    pub first_nuisances: Vec<Nuisance>,
    /// held-out energies by equation: nominal, re-tuned, with the effects
    pub held_nominal: [f64; 5],
    pub held_retuned: [f64; 5],
    pub held_model: [f64; 5],
    /// energies on the fit runs, only re-tuned
    pub retuned_fit: [f64; 5],
    /// residual rows on the held-out runs: re-tuned, with the effects; nominal, and its factor to the drive channel
    pub held_residuals: (Vec<f64>, Vec<f64>),
    pub held_nominal_residual: Vec<f64>,
    pub nominal_to_channel: f64,
}

impl Material {
    /// Gain of one model over another, by their residuals, that holds in 97.5 % of draws of blocks of time.
    /// Blocks that are disturbed whatever the model do not count, as long as they are the fewer.
    fn lasting_gain(&self, p: &Problem, before: &[f64], after: &[f64], sigma: &[f64; 5]) -> f64 {
        let length = self.clock.block(BLOCK_S);
        let mut blocks: std::collections::BTreeMap<(usize, usize), [f64; 4]> = Default::default();
        for b in &p.blocks {
            let e = b.equation.index();
            for (row, &k) in b.rows.clone().zip(&b.samples) {
                let (x, y) = (before[row].powi(2), after[row].powi(2));
                let sum = blocks.entry((b.run, k / length)).or_default();
                sum[0] += (x - y) / sigma[e].powi(2);
                sum[1] += 1.0;
                sum[2] += x / p.sensor_floor[e].powi(2);
                sum[3] += y / p.sensor_floor[e].powi(2);
            }
        }
        let disturbed = |b: &[f64; 4]| b[3] > DISTURBED * b[1] && (b[2] - b[3]).abs() < 0.1 * b[2];
        let quiet: Vec<f64> = blocks.values().filter(|b| !disturbed(b)).map(|b| b[0]).collect();
        let values: Vec<f64> = if 2 * quiet.len() >= blocks.len() {
            quiet
        } else {
            blocks.values().map(|b| b[0]).collect()
        };
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

    /// By equation, the excess energy of the fit runs' blocks that are far beyond the noise and that a model leaves as
    /// they were.
    fn disturbed_energy(&self, before: &[f64], after: &[f64]) -> [f64; 5] {
        let p = &self.fit;
        let length = self.clock.block(DISTURBED_S);
        let mut blocks: std::collections::BTreeMap<(usize, usize, usize), [f64; 3]> = Default::default();
        for b in &p.blocks {
            for (row, &k) in b.rows.clone().zip(&b.samples) {
                let sum = blocks.entry((b.equation.index(), b.run, k / length)).or_default();
                sum[0] += before[row].powi(2);
                sum[1] += after[row].powi(2);
                sum[2] += p.sensor_floor[b.equation.index()].powi(2);
            }
        }
        let mut out = [0.0; 5];
        for ((e, _, _), [before, after, floor]) in blocks {
            if after > DISTURBED * floor && (before - after).abs() < 0.1 * before {
                out[e] += before - floor;
            }
        }
        out
    }

    /// A model without one of its terms, constants and amplitudes solved again.
    fn without(&self, model: &Fit, term: usize) -> Fit {
        let mut terms = model.terms.clone();
        terms.remove(term);
        self.solve(&terms, model.sigma)
    }

    /// As [`Material::without`], the other shapes refined again.
    fn dropped(&self, model: &Fit, term: usize) -> Fit {
        self.polish(&self.without(model, term), 1)
    }

    /// Residual of a model on the fit runs, each fold of blocks by the constants and amplitudes that the other
    /// folds say.
    fn crossed(&self, fit: &Fit) -> Vec<f64> {
        let length = self.clock.block(BLOCK_S);
        let mut fold = vec![0; self.fit.rows];
        for b in &self.fit.blocks {
            for (row, &k) in b.rows.clone().zip(&b.samples) {
                fold[row] = (k / length + b.run) % FOLDS;
            }
        }
        fit::crossed(&self.fit, &self.constants, &self.nuisances, fit, &fold, FOLDS)
    }

    /// Residual of a model on the held-out runs (on the fit runs where there are none).
    pub fn held_residual(&self, fit: &Fit) -> Vec<f64> {
        match &self.held {
            Some(h) => fit::predicted(h, &self.constants, fit),
            None => fit.residual.clone(),
        }
    }

    /// As [`Material::held_residual`], without the rows whose torque goes far beyond that of the fit
    /// runs: there a per cent of error in a constant is more than any effect.
    pub fn judged_residual(&self, fit: &Fit) -> Vec<f64> {
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

    pub fn held_problem(&self) -> &Problem {
        self.held.as_ref().unwrap_or(&self.fit)
    }

    /// Energy that a table would still take from the held-out residual of each equation.
    pub fn unnamed(&self, fit: &Fit) -> [f64; 5] {
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

/// The model with nothing re-tuned and nothing added; only the sensors' imperfections are allowed for. On the same
/// filter and rows as the model that was found.
fn untouched(m: &Material, first: &[Nuisance]) -> Fit {
    let mut fixed = m.nuisances.clone();
    for (n, n0) in fixed.iter_mut().zip(first) {
        if n.of_machine {
            n.centre = if n.nominal != 0.0 {
                n0.nominal / n.nominal - 1.0
            } else {
                0.0
            };
            n.trust = Some(1e-9);
        }
    }
    fit::solve(&m.fit, &m.constants, &fixed, &[], m.first_sigma())
}

/// Runs the whole study; `tell` hears what is being done.
pub fn study(material: Material, tell: &dyn Fn(&str)) -> Outcome {
    tell("re-tuning");
    let first_nuisances = material.nuisances.clone();
    let mut m = material;
    // the equations around the re-tuned constants, so that second order does not look like an effect
    let mut model = m.solve(&[], m.first_sigma());
    for _ in 0..2 {
        m = m.around(&model);
        model = m.solve(&[], m.first_sigma());
    }
    let mut steps: Vec<Step> = Vec::new();
    let mut ambiguous: Vec<(EffectKind, Vec<EffectKind>)> = Vec::new();
    while model.terms.len() < MOST_EFFECTS {
        tell(&format!("looking for effect {}", model.terms.len() + 1));
        if within_noise(&m, &model) {
            break;
        }
        let ranked = m.scan(&model, EffectKind::ALL);
        let Some((step, next, rivals)) = try_next(&m, &model, ranked) else {
            break;
        };
        let accepted = step.accepted;
        if accepted {
            ambiguous.extend(step.taken.iter().map(|k| (*k, rivals.clone())));
        }
        steps.push(step);
        if !accepted {
            break;
        }
        model = next;
        for round in 0..2 {
            m = m.around(&model);
            if round == 0 {
                m = m.on_time(&model.terms);
            }
            model = m.polish(&m.solve(&model.terms, model.sigma), 1);
        }
        model = needed(&m, model);
    }
    // an amplitude of the wrong sign, or one that may as well be nothing, is no effect
    while let Some(wrong) = model
        .terms
        .iter()
        .position(|t| !scan::admissible(t.kind, &t.amplitudes))
    {
        model = m.dropped(&model, wrong);
    }
    while let Some(vague) = vague(&m, &model) {
        model = m.dropped(&model, vague);
        m = m.around(&model);
        model = m.polish(&m.solve(&model.terms, model.sigma), 1);
    }
    tell("proof on held-out data");
    let (unproven, proofs) = prove(&m, &mut model);
    for s in &mut steps {
        if s.accepted && s.taken.iter().any(|k| unproven.contains(k)) {
            s.accepted = false;
            s.why_not = "the held-out data do not get better";
        }
    }
    ambiguous.retain(|(k, _)| model.terms.iter().any(|t| t.kind == *k));
    // one filter and one set of rows for all three
    let retuned = m.solve(&[], m.first_sigma());
    let nominal = untouched(&m, &first_nuisances);
    let held_nominal_residual = m.held_residual(&nominal);
    let held_nominal = m.held_problem().energy(&held_nominal_residual);
    let nominal_to_channel = 1.0 / m.bench.rig.drive_constant.value;
    let (mut verdict, explained, remainder) = conclude(&m, &nominal, &retuned, &model, &ambiguous);
    if m.held.is_none() && !model.terms.is_empty() {
        verdict = Verdict::Candidate;
    }
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
        ambiguous,
        proofs,
    }
}

/// Whether no equation has more energy on the fit runs than the sensors' noise.
fn within_noise(m: &Material, model: &Fit) -> bool {
    // of the controller's own equation no floor is known
    let noise = |e: &Equation| model.score.energy[e.index()] <= m.fit.sensor_energy(e.index());
    m.equations.iter().all(|e| *e != Equation::Controller && noise(e))
}

/// Log-likelihood less what the parameters of the terms cost (Schwarz).
fn penalised(m: &Material, fit: &Fit) -> f64 {
    let rows: f64 = Equation::ALL
        .iter()
        .map(|e| m.fit.rows_of(*e) as f64 * m.fit.independent[e.index()])
        .sum();
    // the place where a spring is at ease is one more
    let of = |t: &Term| t.kind.keys().len() + usize::from(t.kind == EffectKind::SpringLoad);
    let count: usize = fit.terms.iter().map(of).sum();
    fit.score.log_likelihood - 0.5 * count as f64 * rows.max(1.0).ln()
}

/// Without the terms that are no longer needed.
fn needed(m: &Material, mut model: Fit) -> Fit {
    let mut at = 0;
    while model.terms.len() > 1 && at < model.terms.len() {
        let without = m.without(&model, at);
        if penalised(m, &model) - penalised(m, &without) < LEAST_GAIN {
            model = m.polish(&without, 1);
        } else {
            at += 1;
        }
    }
    model
}

/// Takes out the terms without which held-out data, seen here for the first time, are told as well: their kinds, and what
/// each of the others does.
fn prove(m: &Material, model: &mut Fit) -> (Vec<EffectKind>, Vec<Proof>) {
    let mut unproven = Vec::new();
    let Some(held) = &m.held else {
        return (unproven, Vec::new());
    };
    loop {
        let after = m.judged_residual(model);
        let without: Vec<Fit> = (0..model.terms.len()).map(|t| m.without(model, t)).collect();
        let gain = |w: &Fit| m.lasting_gain(held, &m.judged_residual(w), &after, &model.sigma);
        let gains: Vec<f64> = without.iter().map(gain).collect();
        let worst = (0..gains.len()).min_by(|a, b| gains[*a].total_cmp(&gains[*b]));
        if let Some(t) = worst.filter(|t| gains[*t] <= 0.0) {
            unproven.push(model.terms[t].kind);
            *model = m.polish(&without[t], 1);
            continue;
        }
        let energy = |fit: &Fit| held.energy(&m.held_residual(fit));
        let all = energy(model);
        let proof = |(t, w): (&Term, &Fit)| {
            let e = m.seen_in(t.kind);
            (t.kind, held.rms(e, &energy(w)), held.rms(e, &all))
        };
        let proofs = model.terms.iter().zip(&without).map(proof).collect();
        return (unproven, proofs);
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
        // all constants together stand for a gain: their beliefs decide
        let gain = e.kind == EffectKind::CurrentGain;
        let needed = || !gain && penalised(m, model) - penalised(m, &m.without(model, t)) > CERTAIN;
        linear && intervals.terms[t][0] > VAGUE * e.values[0].abs() && !needed()
    })
}

/// What is met more often comes first where the data cannot tell, in log-likelihood (assumed).
fn usual(kind: EffectKind) -> f64 {
    match kind {
        EffectKind::Cogging | EffectKind::BiasTorque => 1.5,
        EffectKind::CurrentOffset | EffectKind::TurnShort => -1.5,
        // all constants together stand for it
        EffectKind::CurrentGain => -30.0,
        _ => 0.0,
    }
}

type Tried = (Step, Fit, Vec<EffectKind>);

fn try_next(m: &Material, model: &Fit, ranked: Vec<Ranked>) -> Option<Tried> {
    let first = ranked.first()?;
    let best_gain = first.gain;
    // the leaders are refined together with what is in the model already
    let mut tried: Vec<(Fit, f64)> = Vec::new();
    for r in ranked.iter().take(4).filter(|r| r.gain > 0.3 * best_gain) {
        let mut terms: Vec<Term> = model.terms.clone();
        terms.push(r.term.clone());
        let fit = m.polish(&m.solve(&terms, model.sigma), 1);
        let gain = penalised(m, &fit) - penalised(m, model) + usual(r.term.kind);
        tried.push((fit, gain));
    }
    tried.sort_by(|a, b| b.1.total_cmp(&a.1));
    let gain = tried[0].1;
    let kind_of = |f: &Fit| f.terms.last().expect("one was added").kind;
    let before = m.crossed(model);
    let clean = (0..5).all(|e| tried[0].0.score.energy[e] <= WORTH * m.fit.sensor_energy(e));
    let behind = RIVAL + if clean { 0.0 } else { RIVAL_SHARE * gain };
    let mut out: Option<Step> = None;
    for (i, (next, gain)) in tried.iter().enumerate() {
        let step = judged(m, model, next, *gain, &ranked, &before);
        if step.accepted {
            let rivals = tried[i + 1..]
                .iter()
                .filter(|t| gain - t.1 < behind && judged(m, model, &t.0, t.1, &ranked, &before).accepted)
                .map(|t| kind_of(&t.0))
                .collect();
            return Some((step, next.clone(), rivals));
        }
        let same_again = step.why_not == TWICE;
        out.get_or_insert(step);
        if same_again {
            // a shape that the list does not have is no reason for another name
            return Some((out?, next.clone(), Vec::new()));
        }
    }
    // two effects may each make it worse without the other
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
            let gain = penalised(m, &pair) - penalised(m, model);
            pairs.push((pair, gain));
        }
        pairs.sort_by(|a, b| b.1.total_cmp(&a.1));
        for (pair, gain) in pairs {
            let step = judged(m, model, &pair, gain, &ranked, &before);
            if step.accepted {
                return Some((step, pair, Vec::new()));
            }
        }
    }
    Some((out?, tried[0].0.clone(), Vec::new()))
}

/// Whether data that did not fix its amplitudes get better, on the fit runs alone.
///
/// * `before` residual of the model, crossed
fn judged(m: &Material, model: &Fit, next: &Fit, gain: f64, ranked: &[Ranked], before: &[f64]) -> Step {
    let lasts = || m.lasting_gain(&m.fit, before, &m.crossed(next), &next.sigma) > 0.0;
    // a mass, a friction below zero is no machine; the first nominal value is what the prior's middle says
    let below = |n: &Nuisance, x: f64| {
        matches!(
            n.name,
            "inertia" | "viscous" | "coulomb" | "torque_constant" | "resistance"
        ) && 1.0 + x <= 0.02 * (1.0 + n.centre)
            || n.name == "play" && x < -1.1
    };
    // what is believed of a constant is not given up for an effect
    let strained = |n: &Nuisance, x: f64| {
        let counts = matches!(n.name, "inertia" | "torque_constant" | "resistance");
        let was = m
            .nuisances
            .iter()
            .zip(&model.nuisance)
            .find(|(b, _)| b.name == n.name)
            .map_or(0.0, |(_, x)| *x);
        let more = |t: f64| (x - n.centre).abs() > (was - n.centre).abs() + t;
        counts
            && n.trust
                .is_some_and(|t| t > 0.0 && (x - n.centre).abs() > 0.999 * fit::MOST_BELIEF * t && more(t))
    };
    let any = |f: &dyn Fn(&Nuisance, f64) -> bool| m.nuisances.iter().zip(&next.nuisance).any(|(n, x)| f(n, *x));
    // a load that comes loose takes its part of friction and drag with it
    let loose = next
        .terms
        .iter()
        .any(|t| matches!(t.kind, EffectKind::Backlash | EffectKind::Compliance));
    let signs = next.terms.iter().all(|t| scan::admissible(t.kind, &t.amplitudes));
    let why_not = if !signs {
        "its sign is not physical"
    } else if !loose && any(&below) {
        "a constant of the machine would have to be negative"
    } else if any(&strained) {
        "a constant would have to be other than it is believed to be"
    } else if gain < LEAST_GAIN {
        "no more than chance gives"
    } else if small(m, model, next) {
        "too small to matter"
    } else if twice(m, model, next) {
        TWICE
    } else if part(m, model, next) < LEAST_PART {
        "it explains little of what is left"
    } else if !lasts() {
        "data that did not fix its amplitudes do not get better"
    } else {
        ""
    };
    Step {
        before: model.score.energy,
        after: next.score.energy,
        accepted: why_not.is_empty(),
        taken: next.terms[model.terms.len()..].iter().map(|t| t.kind).collect(),
        why_not,
        ranked: ranked.to_vec(),
    }
}

const TWICE: &str = "another of its kind is there already, of a shape that the list does not have";

/// Whether a new term repeats one of its kind that is in the model: a spot within the other's width, a line of the angle's
/// spectrum that the travel cannot tell from the other.
fn twice(m: &Material, model: &Fit, next: &Fit) -> bool {
    let (low, high) = m.fit.travel();
    let turns = (high - low) / std::f64::consts::TAU;
    let same = |a: &Term, b: &Term| {
        a.kind == b.kind
            && match a.kind {
                EffectKind::TightSpot => (a.shape[0] - b.shape[0]).abs() < a.shape[1] + b.shape[1],
                EffectKind::PeriodicFriction | EffectKind::Cogging | EffectKind::TorqueRipple => {
                    (a.shape[0] - b.shape[0]).abs() * turns < 1.0
                }
                _ => false,
            }
    };
    let n = model.terms.len();
    (n..next.terms.len()).any(|i| (0..i).any(|j| same(&next.terms[i], &next.terms[j])))
}

/// Whether all that the new terms add to the torque is next to nothing beside the drive's, and to no other equation
/// anything.
fn small(m: &Material, model: &Fit, next: &Fit) -> bool {
    let p = &m.fit;
    let (mut all, mut touched) = (vec![0.0; p.rows], false);
    for t in &next.terms[model.terms.len()..] {
        let c = intervals::contribution(p, m, t);
        all.iter_mut().zip(&c).for_each(|(a, c)| *a += c);
        touched |= !matches!(t.kind.equation(), Equation::Torque);
    }
    let e = Equation::Torque.index();
    !touched && p.energy(&all)[e] < LEAST_TORQUE.powi(2) * p.energy(&p.drive)[e]
}

/// Greatest share of the excess over the noise that any equation loses on the fit runs, but for what is disturbed and
/// stays so: that is another story.
fn part(m: &Material, model: &Fit, next: &Fit) -> f64 {
    let (before, after) = (model.score.energy, next.score.energy);
    let disturbed = m.disturbed_energy(&model.residual, &next.residual);
    let of = |e: usize| {
        let excess = before[e] - noise_energy(m, next, e) - disturbed[e];
        if excess > 0.0 {
            (before[e] - after[e]) / excess
        } else {
            0.0
        }
    };
    (0..5)
        .map(|e| of(e).max(slow_part(m, model, next, Equation::ALL[e])))
        .fold(0.0, f64::max)
}

/// As [`part`], of what lasts: means over some time, whose noise is that from one mean to the next. What is slow and small
/// is nothing beside the noise of single rows.
fn slow_part(m: &Material, model: &Fit, next: &Fit, e: Equation) -> f64 {
    if m.fit.rows_of(e) == 0 || e == Equation::Controller {
        return 0.0;
    }
    let of = |seconds: f64| {
        let noise = m.fit.unrest(&next.residual, e, seconds);
        let before = m.fit.slow_energy(&model.residual, e, seconds);
        if before < SLOWLY * noise {
            return 0.0;
        }
        (before - m.fit.slow_energy(&next.residual, e, seconds)) / (before - noise)
    };
    of(SLOW_S).min(of(2.0 * SLOW_S))
}

/// Energy of an equation's noise: the sensors' as they are said to be, or what the model leaves from row to row where
/// that is more, but not much.
fn noise_energy(m: &Material, model: &Fit, e: usize) -> f64 {
    // the controller's own equation has no floor that is known
    if Equation::ALL[e] == Equation::Controller {
        return 0.0;
    }
    rough_energy(&m.fit, &model.residual, e)
}
