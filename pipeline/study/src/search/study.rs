//! The study: re-tune, rank, add, prove on held-out data, stop, and say how it ended.

use crate::candidates::springs::is_seen;
use crate::equations::nuisances::Nuisance;
use crate::equations::problem::Problem;
use crate::search::beside::{self, Beside};
use crate::search::days::by_days;
use crate::search::fit::{self, Fit, MOST_EFFECTS, Term};
use crate::search::form::{self, Strange};
use crate::search::instead::in_place;
use crate::search::judge::{SLOW_EXCESS, SLOWEST, Step};
use crate::search::needed::{needed, vague};
use crate::search::remainder;
use crate::search::scan;
use crate::search::select::Material;
use crate::search::step::step;
use crate::search::trial::Trial;
use crate::search::unlisted::unlisted;
use crate::search::verdict::{SLOW_S, Verdict, conclude};
use sim_worker::effect::{EffectKind, Equation, Law};

/// Most rounds in which constants are carried into the equations beside a new effect, and at the end.
const MOST_ROUNDS: usize = 4;
/// Change of dry friction from which another round is due beside bristles, of inertia, and of inertia at the end (assumed).
const STILL_MOVES: f64 = 2e-3;
const INERTIA_MOVES: f64 = 0.02;
const AT_LAST: f64 = 5e-4;

fn moved(model: &Fit, constant: Option<usize>) -> f64 {
    constant.map_or(0.0, |i| model.nuisance[i].abs())
}

/// Whether what bristles are in place of is the dry friction that the equations have, and the inertia theirs: torques of effects are
/// over that.
fn settled(m: &Material, model: &Fit) -> bool {
    let bristles = model.has(EffectKind::Presliding);
    (!bristles || moved(model, m.fit.dry_friction) < STILL_MOVES) && moved(model, m.fit.inertia) < INERTIA_MOVES
}

/// Torque over the rms of the fit runs beyond which held-out data are beyond what was excited.
const EXCITED: f64 = 3.0;
/// Energy of the voltage over that of the noise up to which nothing else is in it (assumed).
const QUIET: f64 = 1.35;
/// An effect, and the rms of its equation's rows on the held-out runs without it and with all.
pub type Proof = (EffectKind, f64, f64);

/// A constant by the simulated loop.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OfLoop {
    /// as constants are called
    pub name: &'static str,
    /// over that of the model whose loop was simulated
    pub factor: f64,
    /// standard deviation of its logarithm
    pub sd: f64,
}

/// The source of an actuator as the simulated loop says it is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Source {
    /// what its voltage goes by
    pub draw: Law,
    /// resistance [ohm]
    pub ohm: f64,
    /// its standard deviation [ohm]
    pub sd: f64,
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
    pub proofs: Vec<Proof>,
    /// effects that were found beside the equations
    pub beside: Vec<Beside>,
    /// why effects that were found are not what is there
    pub strange: Option<Strange>,
    /// the source by the simulated loop
    pub source: Option<Source>,
    /// constants that only the simulated loop tells
    pub by_loop: Vec<OfLoop>,
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

impl Outcome {
    /// A phase that lost turns for one whose sensor says too much, or back: in the torque by measured currents the two are one and the
    /// same. Nothing, and false, where voltages tell them apart or there is neither.
    pub fn exchange_short_and_gain(&mut self) -> bool {
        use EffectKind::{CurrentGain, TurnShort};
        let p = &self.material.fit;
        let alike = |t: &Term| matches!(t.kind, CurrentGain | TurnShort) && t.shape.len() == 1 && t.amplitudes[0] > 0.0;
        if p.rows_of(Equation::Electrical) > 0 || self.model.terms.iter().filter(|t| alike(t)).count() != 1 {
            return false;
        }
        let other = |kind: &mut EffectKind| match kind {
            TurnShort => *kind = CurrentGain,
            CurrentGain => *kind = TurnShort,
            _ => (),
        };
        let of_terms = self.model.terms.iter_mut().map(|t| &mut t.kind);
        let of_steps = self.steps.iter_mut().flat_map(|s| &mut s.taken);
        let of_proofs = self.proofs.iter_mut().map(|p| &mut p.0);
        let of_others = self.ambiguous.iter_mut().map(|a| &mut a.0);
        of_terms
            .chain(of_steps)
            .chain(of_proofs)
            .chain(of_others)
            .for_each(other);
        true
    }

    /// The steps' candidates as the exchanged effect has them: its own are those that the other led with.
    pub fn rank_exchanged(&mut self) {
        use EffectKind::{CurrentGain, TurnShort};
        for s in self.steps.iter_mut().filter(|s| s.accepted) {
            let Some(taken) = s.taken.iter().copied().find(|k| matches!(k, CurrentGain | TurnShort)) else {
                continue;
            };
            let led = if taken == CurrentGain { TurnShort } else { CurrentGain };
            if s.ranked.iter().any(|r| r.term.kind == led) {
                s.ranked.retain(|r| r.term.kind != taken);
            }
            let of_other = s.ranked.iter_mut().filter(|r| r.term.kind == led);
            of_other.for_each(|r| r.term.kind = taken);
        }
    }
}

impl Material {
    /// A model without one of its terms, constants and amplitudes solved again.
    pub fn without(&self, model: &Fit, term: usize) -> Fit {
        let mut terms = model.terms.clone();
        terms.remove(term);
        self.solve(&terms, model.sigma)
    }

    /// As [`Material::without`], the other shapes refined again.
    pub(super) fn dropped(&self, model: &Fit, term: usize) -> Fit {
        self.polish(&self.without(model, term), 1)
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

/// Runs the whole study; `tell` hears what is being done. Where what it leaves differs from file to file as frictions do, once more with
/// frictions of each file's own.
pub fn study(material: Material, tell: &dyn Fn(&str)) -> Outcome {
    if !material.has_days() {
        return studied(material, tell);
    }
    let (bench, nuisances, excess) = (material.bench.clone(), material.nuisances.clone(), material.excess);
    let alike = studied(material, tell);
    if !alike.material.days_apart(&alike.model) {
        return alike;
    }
    tell("once more, with frictions of each file's own");
    let apart = studied(alike.material.again(by_days(bench, true), nuisances, excess), tell);
    // what an effect makes is no friction of a day, and what was well without days needs nothing with them but what the fit runs had
    // already asked for, where that then is all
    let asked: Vec<EffectKind> = alike.steps.iter().flat_map(|s| s.taken.iter().copied()).collect();
    let new = apart.model.terms.iter().any(|t| !asked.contains(&t.kind));
    let added = apart.model.terms.len() > alike.model.terms.len();
    let more = added && (new || apart.verdict == Verdict::Unknown) && alike.verdict != Verdict::Unknown;
    if !more && apart.material.days_apart(&apart.model) {
        apart
    } else {
        alike
    }
}

fn studied(material: Material, tell: &dyn Fn(&str)) -> Outcome {
    tell("re-tuning");
    let first_nuisances = material.nuisances.clone();
    let mut m = material;
    // the equations around the re-tuned constants, so that second order does not look like an effect
    let mut model = m.solve(&[], m.first_sigma());
    for _ in 0..2 {
        m = m.around(&model);
        model = m.solve(&[], m.first_sigma());
    }
    // constants that are off together, and nothing else of the voltage: no effect is to stand for them
    let quiet = |(m, fit): &(Material, Fit)| {
        let e = Equation::Electrical.index();
        fit.score.energy[e] < QUIET * m.fit.sensor_energy(e)
    };
    if let Some(loose) = one_cause(&m, &model, &first_nuisances).filter(quiet) {
        (m, model) = loose;
    }
    let mut steps: Vec<Step> = Vec::new();
    let mut ambiguous: Vec<(EffectKind, Vec<EffectKind>)> = Vec::new();
    // what one step adds and the next takes out again is not looked for once more
    let mut before: Vec<Vec<EffectKind>> = vec![model.kinds()];
    while model.terms.len() < MOST_EFFECTS {
        tell(&format!("looking for effect {}", model.terms.len() + 1));
        if within_noise(&m, &model) {
            break;
        }
        let Some(tried) = step(&m, &model, &first_nuisances) else {
            break;
        };
        m = tried.own.unwrap_or(m);
        let accepted = tried.step.accepted;
        if accepted {
            ambiguous.extend(tried.step.taken.iter().map(|k| (*k, tried.rivals.clone())));
        }
        steps.push(tried.step);
        if !accepted {
            break;
        }
        model = m.by_other_laws(m.anew(tried.model));
        for round in 0..MOST_ROUNDS {
            let terms;
            (m, terms) = m.carried(&model);
            if round == 0 {
                m = m.on_time(&model.terms);
            }
            model = m.polish(&m.solve(&terms, model.sigma), 1);
            if round > 0 && settled(&m, &model) {
                break;
            }
        }
        (m, model) = m.needed_delays(model);
        let with = model.terms.len();
        model = needed(&m, m.at_ease(model));
        if model.terms.len() < with {
            (m, model) = m.afresh(&model);
        }
        if before.contains(&model.kinds()) {
            break;
        }
        before.push(model.kinds());
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
        (m, model) = m.refitted(&m.dropped(&model, vague));
    }
    // constants that nothing of the list explains may have one cause together
    let told = |t: &Term| matches!(t.kind, EffectKind::CurrentGain | EffectKind::WindingHeating);
    if let Some(loose) = one_cause(&m, &model, &first_nuisances).filter(|_| !model.terms.iter().any(told)) {
        (m, model) = loose;
    }
    for _ in 0..MOST_ROUNDS {
        if model.terms.is_empty() || moved(&model, m.fit.inertia) < AT_LAST {
            break;
        }
        (m, model) = m.refitted(&model);
    }
    tell("proof on held-out data");
    let (unproven, mut proofs) = prove(&m, &mut model);
    for s in &mut steps {
        if s.accepted && s.taken.iter().any(|k| unproven.contains(k)) {
            s.accepted = false;
            s.why_not = "the held-out data do not get better";
        }
    }
    let (mut beside, mut stranger) = beside::beside(&m, &model, &first_nuisances);
    let makes = |found: &[Beside], t: &Term| found.iter().any(|b| beside::makes(b, t, &m.constants));
    while let Some(at) = model.terms.iter().position(|t| makes(&beside, t)) {
        let (without, made) = (m.dropped(&model, at), &model.terms[at]);
        let again = beside::beside(&m, &without, &first_nuisances);
        if !makes(&again.0, made) {
            break;
        }
        proofs.retain(|p| p.0 != made.kind);
        model = without;
        (beside, stranger) = again;
    }
    ambiguous.retain(|(k, _)| model.has(*k));
    // one filter and one set of rows for all three
    let retuned = m.solve(&[], m.first_sigma());
    let nominal = untouched(&m, &first_nuisances);
    let held_nominal_residual = m.held_residual(&nominal);
    let held_nominal = m.held_problem().energy(&held_nominal_residual);
    let nominal_to_channel = 1.0 / m.bench.rig.drive_constant.value;
    let (verdict, explained, remainder) = conclude(&m, &nominal, &retuned, &model, &ambiguous, !beside.is_empty());
    let mut verdict = verdict.beside(&beside);
    if stranger && matches!(verdict, Verdict::None | Verdict::Retune) {
        verdict = Verdict::Unknown;
    }
    let told = matches!(
        verdict,
        Verdict::Named | Verdict::NamedWithRemainder | Verdict::Ambiguous
    );
    let strange = Trial::new(&m, &model).and_then(|trial| {
        let law = || {
            in_place(&trial)
                .or_else(|| unlisted(&trial, &retuned))
                .map(Strange::Unlisted)
        };
        match (told, model.terms.is_empty()) {
            (true, false) => form::strange(&trial, &retuned).or_else(law),
            // found beside the equations
            (true, true) => None,
            (false, _) => law(),
        }
    });
    if strange.is_some() {
        verdict = Verdict::Unknown;
    }
    if m.held.is_none() && !(model.terms.is_empty() && beside.is_empty()) {
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
        beside,
        strange,
        source: None,
        by_loop: Vec::new(),
    }
}

/// A model whose resistance and inertia are no longer held at the end of their belief, where one cause explains all constants.
fn one_cause(m: &Material, model: &Fit, first: &[Nuisance]) -> Option<(Material, Fit)> {
    let free = |names: &[&str]| {
        let loose = m.let_go(model, names)?;
        let (loose, terms) = loose.carried(&loose.solve(&model.terms, model.sigma));
        let fit = loose.polish(&loose.solve(&terms, model.sigma), 1);
        let cause = beside::together(&loose, &fit, first)?;
        Some((loose, fit, cause.kind))
    };
    // what is warm says nothing of the inertia
    let warm = free(&["resistance"]).filter(|w| w.2 == EffectKind::WindingHeating);
    let (loose, fit, _) = warm.or_else(|| free(&["resistance", "inertia"]))?;
    Some((loose, fit))
}

/// Whether no equation has more energy on the fit runs than the sensors' noise, nor in means over the longest times.
fn within_noise(m: &Material, model: &Fit) -> bool {
    let slow = |e: Equation| {
        let over = |k: i32| m.fit.slow_energy(&model.residual, e, SLOW_S * f64::from(1 << k));
        over(SLOWEST - 1).min(over(SLOWEST))
    };
    // of the controller's own equation no floor is known
    let noise = |e: &Equation| {
        model.score.energy[e.index()] <= m.fit.quiet_energy(&model.residual, *e) && slow(*e) < SLOW_EXCESS
    };
    m.equations.iter().all(|e| *e != Equation::Controller && noise(e))
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
        let energy = |fit: &Fit| held.energy(&m.held_residual(fit));
        let all = energy(model);
        // a spring that only the torque shows makes the strongest torques no worse, though these are not what proves it
        let spoils = |t: &Term, w: &Fit| {
            let e = Equation::Torque.index();
            t.kind == EffectKind::Compliance && !is_seen(held, &t.shape) && all[e] > energy(w)[e]
        };
        let each = model.terms.iter().zip(&without);
        let gains: Vec<f64> = each.map(|(t, w)| if spoils(t, w) { 0.0 } else { gain(w) }).collect();
        let worst = (0..gains.len()).min_by(|a, b| gains[*a].total_cmp(&gains[*b]));
        if let Some(t) = worst.filter(|t| gains[*t] <= 0.0) {
            unproven.push(model.terms[t].kind);
            *model = m.polish(&without[t], 1);
            continue;
        }
        let proof = |(t, w): (&Term, &Fit)| {
            let e = m.seen_in(t);
            (t.kind, held.rms(e, &energy(w)), held.rms(e, &all))
        };
        let proofs = model.terms.iter().zip(&without).map(proof).collect();
        return (unproven, proofs);
    }
}

/// Study of a rig that has something besides, for tests.
#[cfg(test)]
pub(super) fn of_rig(besides: impl Fn(usize, [f64; 5]) -> f64) -> Outcome {
    let (bench, runs) = crate::measured::prescribed::rig(besides);
    study(Material::new(bench, runs, &[]), &|_| {})
}
