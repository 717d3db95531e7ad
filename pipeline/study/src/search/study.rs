//! The study: re-tune, rank, add, prove on held-out data, stop, and say how it ended.

use crate::candidates::columns::{self, Form};
use crate::equations::problem::{Nuisance, Problem};
use crate::measured::bench::Noise;
use crate::search::fit::{self, Fit, Term};
use crate::search::intervals;
use crate::search::remainder;
use crate::search::select::{Material, Ranked};
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
/// Energy over that of the noise from which an equation has an excess that is worth a share.
const WORTH: f64 = 1.1;
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
/// An effect is named when it and those before it explain this share of the excess energy.
pub const NAMED_SHARE: f64 = 0.70;
/// Where every equation has this share of its excess explained, nothing remains to be named.
pub const CLEAN_SHARE: f64 = 0.85;
/// Gap over the noise in the transmission beyond which a slow one is no spring and no play (assumed).
const FAR: f64 = 3.5;
/// Energy over that of the noise that cannot be the noise's, with nothing found (assumed).
const BEYOND: f64 = 1.35;
/// Time over which a torque or voltage that is missing keeps its sign at least (assumed) [s].
const SLOW_S: f64 = 0.02;
/// Energy over that of the noise of means over this time that is no noise, with nothing found (assumed); of two
/// sensors of one motion, whose own errors are many, more.
const SLOWLY: f64 = 2.0;
const SENSORS_APART: f64 = 12.0;
/// A table that takes more than this share of an equation's energy has found something (assumed).
pub const UNKNOWN_SHARE: f64 = 0.10;
/// Log-likelihood by which a rival must fall behind, and share of the gain where the best leaves a gap (assumed).
const RIVAL: f64 = 5.0;
const RIVAL_SHARE: f64 = 0.02;
/// Most that the noise seen from row to row may be over that of the sensors (assumed).
const ROUGH: f64 = 2.0;
/// A block of held-out data whose gap stays beyond this energy, whatever the model, was disturbed (assumed).
const DISTURBED: f64 = 6.0;

/// How a study ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Verdict {
    None,
    Retune,
    Named,
    NamedWithRemainder,
    Ambiguous,
    Unknown,
    /// effects were found, and no data are left to prove them
    Candidate,
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
            Self::Candidate => "candidate",
        }
    }
}

/// One accepted or refused effect.
#[derive(Clone, Debug)]
pub struct Step {
    /// candidates, the best first
    pub ranked: Vec<Ranked>,
    /// energies by equation on the fit runs, before
    pub before: [f64; 5],
    /// same on the held-out runs, before and after
    pub held_before: [f64; 5],
    pub held_after: [f64; 5],
    pub accepted: bool,
    /// what was added: one effect, or two that only go together
    pub taken: Vec<EffectKind>,
    pub why_not: &'static str,
}

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
    /// of each effect: rms of its equation's rows on the held-out runs without it and with all
    pub proofs: Vec<(EffectKind, f64, f64)>,
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

/// By equation: share of the held-out excess over the noise that was explained; `None` where there
/// was none worth the name.
pub fn shares(p: &Problem, before: &[f64; 5], after: &[f64; 5], residual: Option<&[f64]>) -> [Option<f64>; 5] {
    let noise: [f64; 5] = std::array::from_fn(|e| residual.map_or(0.0, |r| rough_energy(p, r, e)));
    std::array::from_fn(|e| {
        let n = p.rows_of(Equation::ALL[e]) as f64;
        let floor = n * p.sensor_floor[e].powi(2);
        // the controller's own equation has no floor that is known
        let floor = if Equation::ALL[e] == Equation::Controller {
            after[e].min(before[e])
        } else {
            floor.max(noise[e])
        };
        (n > 0.0 && before[e] > WORTH * floor).then(|| 1.0 - (after[e] - floor).max(0.0) / (before[e] - floor))
    })
}

/// The shares as one: weighted by the logarithm of how far each equation was off.
pub fn overall(p: &Problem, before: &[f64; 5], shares: &[Option<f64>; 5]) -> f64 {
    let (mut sum, mut weights) = (0.0, 0.0);
    for e in 0..5 {
        if let Some(share) = shares[e] {
            let n = p.rows_of(Equation::ALL[e]) as f64;
            let weight = n * (before[e] / (n * p.sensor_floor[e].powi(2))).ln().max(0.1);
            sum += weight * share;
            weights += weight;
        }
    }
    if weights > 0.0 { sum / weights } else { 1.0 }
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
    while let Some(wrong) = model.terms.iter().position(|t| !fit::admissible(t.kind, &t.amplitudes)) {
        model.terms.remove(wrong);
        model = m.polish(&m.solve(&model.terms, model.sigma), 1);
    }
    while let Some(vague) = vague(&m, &model) {
        model.terms.remove(vague);
        model = m.polish(&m.solve(&model.terms, model.sigma), 1);
    }
    tell("proof on held-out data");
    let unproven = prove(&m, &mut model);
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
    let proofs = proofs(&m, &model);
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

/// What each effect does for the held-out runs.
fn proofs(m: &Material, model: &Fit) -> Vec<(EffectKind, f64, f64)> {
    let Some(held) = &m.held else {
        return Vec::new();
    };
    let rms = |fit: &Fit, e: Equation| {
        let energy = held.energy(&m.held_residual(fit))[e.index()];
        (energy / held.rows_of(e).max(1) as f64).sqrt()
    };
    (0..model.terms.len())
        .map(|t| {
            let kind = model.terms[t].kind;
            let e = kind.equation();
            let e = if held.rows_of(e) > 0 { e } else { Equation::Torque };
            let mut terms = model.terms.clone();
            terms.remove(t);
            let without = m.solve(&terms, model.sigma);
            (kind, rms(&without, e), rms(model, e))
        })
        .collect()
}

/// Whether no equation has more energy on the fit runs than the sensors' noise.
fn within_noise(m: &Material, model: &Fit) -> bool {
    let p = &m.fit;
    Equation::ALL.iter().all(|e| {
        let n = p.rows_of(*e) as f64;
        *e == Equation::Controller || n == 0.0 || model.score.energy[e.index()] <= n * p.sensor_floor[e.index()].powi(2)
    }) && !m.equations.contains(&Equation::Controller)
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
        let mut terms = model.terms.clone();
        terms.remove(at);
        let without = m.solve(&terms, model.sigma);
        if penalised(m, &model) - penalised(m, &without) < LEAST_GAIN {
            model = m.polish(&without, 1);
        } else {
            at += 1;
        }
    }
    model
}

/// Takes out the terms without which held-out data, seen here for the first time, are told as well.
fn prove(m: &Material, model: &mut Fit) -> Vec<EffectKind> {
    let mut unproven = Vec::new();
    let Some(held) = &m.held else {
        return unproven;
    };
    loop {
        let after = m.judged_residual(model);
        let gains: Vec<f64> = (0..model.terms.len())
            .map(|t| {
                let mut terms = model.terms.clone();
                terms.remove(t);
                let without = m.solve(&terms, model.sigma);
                m.lasting_gain(held, &m.judged_residual(&without), &after, &model.sigma)
            })
            .collect();
        let worst = (0..gains.len()).min_by(|a, b| gains[*a].total_cmp(&gains[*b]));
        match worst.filter(|t| gains[*t] <= 0.0) {
            Some(t) => {
                unproven.push(model.terms.remove(t).kind);
                *model = m.polish(&m.solve(&model.terms, model.sigma), 1);
            }
            None => return unproven,
        }
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
        let mut terms = model.terms.clone();
        terms.remove(t);
        let needed = || penalised(m, model) - penalised(m, &m.solve(&terms, model.sigma)) > CERTAIN;
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
        out.get_or_insert(step);
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
    let after = m.crossed(next);
    let low = m.lasting_gain(&m.fit, before, &after, &next.sigma);
    let (held_before, held_after) = (model.score.energy, next.score.energy);
    // a mass, a friction below zero is no machine
    let below = |n: &Nuisance, x: f64| {
        matches!(
            n.name,
            "inertia" | "viscous" | "coulomb" | "torque_constant" | "resistance"
        ) && x <= -0.98
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
    let signs = next.terms.iter().all(|t| fit::admissible(t.kind, &t.amplitudes));
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
    } else if part(m, &held_before, next) < LEAST_PART {
        "it explains little of what is left"
    } else if low <= 0.0 {
        "data that did not fix its amplitudes do not get better"
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

/// Greatest share of the excess over the noise that any equation loses on the fit runs.
fn part(m: &Material, before: &[f64; 5], next: &Fit) -> f64 {
    let after = next.score.energy;
    let of = |e: usize| {
        let excess = before[e] - noise_energy(m, next, e);
        if excess > 0.0 {
            (before[e] - after[e]) / excess
        } else {
            0.0
        }
    };
    (0..5).map(of).fold(0.0, f64::max)
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

fn rough_energy(p: &Problem, residual: &[f64], e: usize) -> f64 {
    let rough = p.by_differences(residual, Equation::ALL[e]);
    let sensors = p.sensor_floor[e];
    p.rows_of(Equation::ALL[e]) as f64 * sensors.max(rough.min(ROUGH * sensors)).powi(2)
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

fn conclude(
    m: &Material,
    nominal: &Fit,
    retuned: &Fit,
    model: &Fit,
    ambiguous: &[(EffectKind, Vec<EffectKind>)],
) -> (Verdict, f64, f64) {
    let unnamed = m.unnamed(model);
    let held = m.held_problem();
    let before = held.energy(&m.judged_residual(retuned));
    let after = held.energy(&m.judged_residual(model));
    let by_equation = shares(held, &before, &after, Some(&m.judged_residual(model)));
    let explained = overall(held, &before, &by_equation);
    // an equation that was off before, or that an effect has touched
    let counts = |e: usize| {
        let floor = held.rows_of(Equation::ALL[e]) as f64 * held.sensor_floor[e].powi(2);
        before[e] > BEYOND * floor || (before[e] - after[e]).abs() > 0.05 * before[e]
    };
    let counted = (0..5).filter(|e| counts(*e)).filter_map(|e| by_equation[e]);
    let worst = counted.fold(1.0, |a: f64, b| a.min(b));
    // an effect is not that which leaves its own equation unexplained
    let own = |t: &Term| by_equation[t.kind.equation().index()];
    let stranger = model.terms.iter().filter_map(own).any(|s| s < NAMED_SHARE);
    // what else is off in equations that no effect of these touches is a remainder
    let touched = |e: usize| model.terms.iter().any(|t| t.kind.equation().index() == e);
    let explained = if model.terms.is_empty() {
        explained
    } else {
        let all: Vec<f64> = (0..5).filter(|e| touched(*e)).filter_map(|e| by_equation[e]).collect();
        if all.is_empty() {
            explained
        } else {
            all.iter().sum::<f64>() / all.len() as f64
        }
    };
    let gaps = m.over_floor(held, &after);
    // only what the sensors are known to add can be held against a name
    let drive = m.bench.channel(m.bench.rig.drive);
    let stated = drive.is_some_and(|d| matches!(d.noise, Noise::Known(_)));
    let far = drifting(held, &m.held_residual(model), gaps[2]);
    let judged = m.judged_residual(model);
    let slow = Equation::ALL.map(|e| held.slow_energy(&judged, e, SLOW_S));
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
                    && slow[e]
                        > if Equation::ALL[e] == Equation::Kinematic {
                            SENSORS_APART
                        } else {
                            SLOWLY
                        }
                    && after[e] > BEYOND * held.rows_of(Equation::ALL[e]) as f64 * held.sensor_floor[e].powi(2)
            });
        let over = (0..4).any(|e| by_equation[e].is_some());
        if remainder > if stated { UNKNOWN_SHARE } else { 2.5 * UNKNOWN_SHARE } && over || beyond {
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
    } else if ambiguous.iter().any(|a| !a.1.is_empty()) {
        Verdict::Ambiguous
    } else {
        Verdict::Named
    };
    (verdict, explained, remainder)
}
