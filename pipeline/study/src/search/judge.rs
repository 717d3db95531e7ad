//! Whether a candidate is taken, by the fit runs alone, and whether what one model gains over another lasts.

use crate::candidates::shapes;
use crate::candidates::springs;
use crate::equations::nuisances::Nuisance;
use crate::equations::problem::Problem;
use crate::measured::bench::BenchChannel;
use crate::search::fit::{self, Fit, Term, WORTH};
use crate::search::intervals;
use crate::search::scan;
use crate::search::select::{Material, Ranked};
use crate::search::verdict::{SLOW_S, rough_energy};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use sim_worker::effect::{EffectKind, Equation};
use std::collections::BTreeMap;

/// Smallest gain in log-likelihood of an effect, after what its parameters cost: about one false alarm in a
/// thousand studies over the whole list if residuals were as the noise says (assumed; the benchmark holds the
/// true rate).
pub(super) const LEAST_GAIN: f64 = 12.0;
/// Smallest share of the excess over the noise of some equation that an effect must explain: one that explains
/// less is the nearest relative of something else (assumed).
const LEAST_PART: f64 = 0.30;
/// Doublings of the shortest time over which what is slow is looked for, and energy of its means over that of their noise from which
/// there is something to be explained (assumed).
pub(super) const SLOWEST: i32 = 4;
pub(super) const SLOW_EXCESS: f64 = 1.5;
/// Least share of it over longer times than the shortest (assumed).
const SLOWER_PART: f64 = 0.8;
/// Smallest share of the transmission's excess that a spring in it must explain; of the torque's, where that is on time (assumed).
const LEAST_BENT: f64 = 0.5;
/// Least share of the rig's inertia behind a spring (assumed).
const LEAST_LOAD: f64 = 2e-3;
/// Most damping ratio of its resonance, of a rig (assumed); the search goes a little further.
const MOST_DAMPED_SHAFT: f64 = 0.2;
/// Gap of the transmission over its noise from which a load is not where it is thought to be (assumed).
const FAR_LOOSE: f64 = 5.0;
/// Torque over the drive's that an angle sensor's error makes at most, over the error, and orders of the turn that it makes
/// (assumed: a slope of the error in a torque that goes with the speed, and as much in its product with the angle).
const ECHO: f64 = 2.0;
const MOST_ECHOED: f64 = 2.5;
/// Torque over the drive's, both rms, that dead time may make at the orders of the commutation: which phase conducts for how long
/// around it is known less well then (assumed; up to 0.015 seen).
const COMMUTATED: f64 = 0.03;
/// Torque of an effect over the drive's, both rms, from which it matters (assumed).
const LEAST_TORQUE: f64 = 2e-3;
/// Length of the pieces in which a disturbance shows by itself [s] (assumed).
const DISTURBED_S: f64 = 0.05;
/// Length of the blocks of the bootstrap [s].
const BLOCK_S: f64 = 0.4;
const DRAWS: usize = 400;
/// Gain of few blocks that is believed whatever others say (of a healthy actuator no candidate had more than 24), and what
/// the others may lose of it (both assumed).
const FEW_BLOCKS_GAIN: f64 = 100.0;
const FEW_BLOCKS_REST: f64 = 0.1;
/// Parts of the fit runs, each judged by what the others say.
const FOLDS: usize = 5;
/// A block of held-out data whose gap stays beyond this energy, whatever the model, was disturbed (assumed).
const DISTURBED: f64 = 6.0;

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

/// Whether the energy of a piece is far beyond that of the noise, and a model leaves it as it was.
fn stays_disturbed(before: f64, after: f64, noise: f64) -> bool {
    after > DISTURBED * noise && (before - after).abs() < 0.1 * before
}

impl Material {
    /// Gain of one model over another, by their residuals, that holds in 97.5 % of draws of blocks of time.
    /// Blocks that are disturbed whatever the model do not count, as long as they are the fewer. What few blocks show, as
    /// a reversal shows how friction sets in, many draws miss: there the gain counts that brings them down to the noise.
    pub(super) fn lasting_gain(&self, p: &Problem, before: &[f64], after: &[f64], sigma: &[f64; 5]) -> f64 {
        let mut blocks: BTreeMap<(usize, usize), [f64; 4]> = BTreeMap::new();
        for (block, e, row) in p.in_pieces(BLOCK_S) {
            let (x, y) = (before[row].powi(2), after[row].powi(2));
            let sum = blocks.entry(block).or_default();
            sum[0] += (x - y) / sigma[e].powi(2);
            sum[1] += 1.0;
            sum[2] += x / p.sensor_floor[e].powi(2);
            sum[3] += y / p.sensor_floor[e].powi(2);
        }
        let disturbed = |b: &[f64; 4]| stays_disturbed(b[2], b[3], b[1]);
        let quiet: Vec<f64> = blocks.values().filter(|b| !disturbed(b)).map(|b| b[0]).collect();
        let values: Vec<f64> = if 2 * quiet.len() >= blocks.len() {
            quiet
        } else {
            blocks.values().map(|b| b[0]).collect()
        };
        let (mut all, mut lost, mut settled) = (0.0, 0.0, 0.0);
        for [gain, rows, _, after] in blocks.values() {
            all += gain;
            if *gain < 0.0 {
                lost -= gain;
            } else if after < rows {
                settled += gain;
            }
        }
        if all > FEW_BLOCKS_GAIN && lost < FEW_BLOCKS_REST * all && settled > (1.0 - FEW_BLOCKS_REST) * all {
            return all;
        }
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

    /// Fold of each row of the fit runs, blocks of time as a whole. The blocks that tell most of some terms are in folds of their own, so
    /// that of an effect that few blocks show no fold has all: where one had, the others would say nothing of its amplitudes.
    fn folds(&self, terms: &[Term], sigma: &[f64; 5]) -> Vec<usize> {
        let p = &self.fit;
        let weights = p.weights(sigma);
        let told = fit::regressors(p, terms, &self.constants);
        let columns: Vec<&Vec<f64>> = told.iter().flat_map(|r| r.linear.iter().chain(&r.fixed)).collect();
        let mut blocks: BTreeMap<(usize, usize), (f64, Vec<usize>)> = BTreeMap::new();
        for (block, _, row) in p.in_pieces(BLOCK_S) {
            let (energy, rows) = blocks.entry(block).or_default();
            *energy += columns.iter().map(|c| (c[row] * weights[row]).powi(2)).sum::<f64>();
            rows.push(row);
        }
        let mut by_weight: Vec<&(f64, Vec<usize>)> = blocks.values().collect();
        by_weight.sort_by(|a, b| b.0.total_cmp(&a.0));
        let mut fold = vec![0; p.rows];
        for (i, (_, rows)) in by_weight.into_iter().enumerate() {
            rows.iter().for_each(|&row| fold[row] = i % FOLDS);
        }
        fold
    }

    /// Whether a model with more terms than another tells the fit runs better, each fold of blocks by the constants and amplitudes
    /// that the other folds say.
    fn lasts(&self, model: &Fit, next: &Fit) -> bool {
        let fold = self.folds(&next.terms[model.terms.len()..], &next.sigma);
        let [before, after] = [model, next].map(|f| fit::crossed(&self.fit, &self.constants, f, &fold, FOLDS));
        self.lasting_gain(&self.fit, &before, &after, &next.sigma) > 0.0
    }
}

/// Whether data that did not fix its amplitudes get better, on the fit runs alone.
pub(super) fn judged(m: &Material, model: &Fit, next: &Fit, gain: f64, ranked: &[Ranked]) -> Step {
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
                .is_some_and(|t| t > 0.0 && n.strain(x, fit::MOST_BELIEF * t) > 0.999 && more(t))
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
        NEGATIVE
    } else if !loose && any(&strained) {
        "a constant would have to be other than it is believed to be"
    } else if gain < LEAST_GAIN {
        "no more than chance gives"
    } else if small(m, model, next) {
        "too small to matter"
    } else if twice(m, model, next) {
        TWICE
    } else if unbent(m, model, next) {
        "the user's side does not bend as it asks"
    } else if weightless(m, model, next) {
        "its load has next to no inertia"
    } else if unheard(m, model, next) {
        UNHEARD
    } else if otherwise_loose(m, model, next) {
        OTHERWISE
    } else if echoed(m, model, next) {
        "the error of the angle sensor makes as much of other torques"
    } else if commutated(m, model, next) {
        "dead time makes as much of the torque at each commutation"
    } else if unshown(m, model, next) {
        "the voltage does not show it"
    } else if part(m, model, next) < LEAST_PART {
        "it explains little of what is left"
    } else if !m.lasts(model, next) {
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

pub(super) const NEGATIVE: &str = "a constant of the machine would have to be negative";
pub(super) const UNHEARD: &str = "the torque hardly shows it, and no second sensor does";
pub(super) const TWICE: &str = "another of its kind is there already, of a shape that the list does not have";

/// Whether a new term repeats one of its kind that is in the model: a spot within the other's width, a line of the angle's
/// spectrum that the travel cannot tell from the other.
fn twice(m: &Material, model: &Fit, next: &Fit) -> bool {
    let (low, high) = m.fit.travel();
    let turns = (high - low) / std::f64::consts::TAU;
    let same = |a: &Term, b: &Term| {
        a.kind == b.kind
            && match a.kind {
                EffectKind::TightSpot => (a.shape[0] - b.shape[0]).abs() < a.shape[1] + b.shape[1],
                k if shapes::has_order(k) => (a.shape[0] - b.shape[0]).abs() * turns < 1.0,
                _ => false,
            }
    };
    let n = model.terms.len();
    (n..next.terms.len()).any(|i| (0..i).any(|j| same(&next.terms[i], &next.terms[j])))
}

/// Whether a new spring in the transmission leaves most of what is off there: what it adds to the torque alone may be
/// another inertia, another friction.
fn unbent(m: &Material, model: &Fit, next: &Fit) -> bool {
    if !sprung(m, model, next, true) {
        return false;
    }
    let e = Equation::Transmission.index();
    let (before, after, noise) = (model.score.energy[e], next.score.energy[e], m.fit.sensor_energy(e));
    before < WORTH * noise || before - after < LEAST_BENT * (before - noise)
}

/// Whether a new spring has a load that a user's sensor alone would notice: nothing bends a spring with nothing behind it.
fn weightless(m: &Material, model: &Fit, next: &Fit) -> bool {
    let mut new = next.terms[model.terms.len()..].iter();
    new.any(|t| t.kind == EffectKind::Compliance && t.shape[2] < LEAST_LOAD * m.constants.inertia)
}

/// Whether a new spring that no second sensor sees is hardly heard in the torque.
fn unheard(m: &Material, model: &Fit, next: &Fit) -> bool {
    if !sprung(m, model, next, false) {
        return false;
    }
    let e = Equation::Torque;
    let (before, after) = (model.score.energy[e.index()], next.score.energy[e.index()]);
    if m.fit.on_time() {
        return before - after < LEAST_BENT * (before - m.fit.quiet_energy(&model.residual, e));
    }
    // what would be damped more than any shaft, if it might, is a torque that is late
    let dull = |t: &Term| {
        t.kind == EffectKind::Compliance && springs::resonance(&t.shape, m.constants.inertia).1 > MOST_DAMPED_SHAFT
    };
    after > (1.0 - scan::LEAST_HEARD) * before || next.terms.iter().any(dull)
}

/// Whether a spring is new in a model, with its load seen by a second sensor or not.
fn sprung(m: &Material, model: &Fit, next: &Fit, seen: bool) -> bool {
    let mut new = next.terms[model.terms.len()..].iter();
    new.any(|t| t.kind == EffectKind::Compliance && springs::is_seen(&m.fit, &t.shape) == seen)
}

pub(super) const OTHERWISE: &str = "the load behind spring or play does something that the list does not have";

/// Whether a load that came loose is still far from where its sensor sees it: what it does to the torque then is no other
/// effect. A spring beside a play, or a play beside a spring, may be.
fn otherwise_loose(m: &Material, model: &Fit, next: &Fit) -> bool {
    let loose = |t: &Term| matches!(t.kind, EffectKind::Backlash | EffectKind::Compliance);
    let e = Equation::Transmission.index();
    let far = model.score.energy[e] > FAR_LOOSE * FAR_LOOSE * m.fit.sensor_energy(e);
    far && model.terms.iter().any(loose) && !next.terms[model.terms.len()..].iter().all(loose)
}

/// Whether the torque of a term is below a share of the drive's, both rms.
fn slight(m: &Material, term: &Term, share: f64) -> bool {
    let (p, e) = (&m.fit, Equation::Torque.index());
    p.energy(&intervals::contribution(p, m, term))[e] < share.powi(2) * p.energy(&p.drive)[e]
}

/// Whether a new torque repeats with the commutation of three phases beside a dead time, and is small.
fn commutated(m: &Material, model: &Fit, next: &Fit) -> bool {
    if !m.bench.has_phases() || !next.has(EffectKind::DeadTime) {
        return false;
    }
    let with_it = |t: &&Term| {
        let order = t.shape[0] / (6.0 * m.constants.effect.pole_pairs);
        order.round() >= 1.0 && (order - order.round()).abs() < 0.02
    };
    next.terms[model.terms.len()..]
        .iter()
        .filter(|t| shapes::has_order(t.kind))
        .filter(with_it)
        .any(|t| slight(m, t, COMMUTATED))
}

/// Whether a new torque repeats once or twice a turn beside an angle sensor that is out of centre, and is no more than its error
/// makes of the torques that are there.
fn echoed(m: &Material, model: &Fit, next: &Fit) -> bool {
    let sensor = |t: &&Term| t.kind == EffectKind::EncoderEccentricity;
    let Some(error) = model
        .terms
        .iter()
        .find(sensor)
        .map(|t| t.amplitudes[0].hypot(t.amplitudes[1]))
    else {
        return false;
    };
    next.terms[model.terms.len()..]
        .iter()
        .filter(|t| shapes::has_order(t.kind) && t.shape[0] < MOST_ECHOED)
        .any(|t| slight(m, t, ECHO * error))
}

/// Whether a gain of the current is new that leaves the voltage as it was: without a load that is measured it is nothing in the
/// torque but another inertia and another friction.
fn unshown(m: &Material, model: &Fit, next: &Fit) -> bool {
    let new = &next.terms[model.terms.len()..];
    let e = Equation::Electrical.index();
    let excess = model.score.energy[e] - m.fit.sensor_energy(e);
    new.iter().any(Term::is_gain_of_all)
        && !m.has(BenchChannel::Load)
        && (excess <= 0.0 || model.score.energy[e] - next.score.energy[e] < LEAST_PART * excess)
}

/// Least energy of a play in the sensor behind it, over that of the sensor's noise (assumed).
const LEAST_PLAY: f64 = 0.25;

/// Whether all that the new terms add to the torque is next to nothing beside the drive's, and to no other equation
/// anything.
fn small(m: &Material, model: &Fit, next: &Fit) -> bool {
    let p = &m.fit;
    let new = &next.terms[model.terms.len()..];
    let (mut all, mut touched) = (vec![0.0; p.rows], false);
    for t in new {
        let c = intervals::contribution(p, m, t);
        all.iter_mut().zip(&c).for_each(|(a, c)| *a += c);
        touched |= !matches!(t.kind.equation(), Equation::Torque);
    }
    let (e, user) = (Equation::Torque.index(), Equation::Transmission.index());
    let energy = p.energy(&all);
    // a spring bends before the user's sensor, whatever its torque
    touched |= energy[user] > p.sensor_energy(user);
    // a play that is within the noise of the very sensor behind it is made of what the torque does as it turns round
    let play = next.terms[model.terms.len()..]
        .iter()
        .any(|t| t.kind == EffectKind::Backlash);
    if play && p.rows_of(Equation::Transmission) > 0 && energy[user] < LEAST_PLAY * p.sensor_energy(user) {
        return true;
    }
    !touched && energy[e] < LEAST_TORQUE.powi(2) * p.energy(&p.drive)[e]
}

/// By equation, the excess energy of the fit runs' blocks that are far beyond the noise and that a model leaves as
/// they were.
fn disturbed_energy(m: &Material, before: &[f64], after: &[f64]) -> [f64; 5] {
    let p = &m.fit;
    let mut blocks: BTreeMap<(usize, (usize, usize)), [f64; 3]> = BTreeMap::new();
    for (piece, e, row) in p.in_pieces(DISTURBED_S) {
        let sum = blocks.entry((e, piece)).or_default();
        sum[0] += before[row].powi(2);
        sum[1] += after[row].powi(2);
        sum[2] += p.sensor_floor[e].powi(2);
    }
    let mut out = [0.0; 5];
    for ((e, _), [before, after, floor]) in blocks {
        if stays_disturbed(before, after, floor) {
            out[e] += before - floor;
        }
    }
    out
}

/// Greatest share of the excess over the noise that any equation loses on the fit runs, but for what is disturbed and
/// stays so: that is another story.
fn part(m: &Material, model: &Fit, next: &Fit) -> f64 {
    let (before, after) = (model.score.energy, next.score.energy);
    let disturbed = disturbed_energy(m, &model.residual, &next.residual);
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
/// is nothing beside the noise of single rows. How slow, the command decides: it is looked for over times of all sizes, and must show
/// over two that follow each other.
fn slow_part(m: &Material, model: &Fit, next: &Fit, e: Equation) -> f64 {
    if m.fit.rows_of(e) == 0 || e == Equation::Controller {
        return 0.0;
    }
    let of = |seconds: f64| {
        let noise = m.fit.unrest(&next.residual, e, seconds);
        let before = m.fit.slow_energy(&model.residual, e, seconds);
        if before < SLOW_EXCESS * noise {
            return 0.0;
        }
        (before - m.fit.slow_energy(&next.residual, e, seconds)) / (before - noise)
    };
    let all: Vec<f64> = (0..=SLOWEST).map(|k| of(SLOW_S * f64::from(1 << k))).collect();
    let shares: Vec<f64> = all.windows(2).map(|w| w[0].min(w[1])).collect();
    // over long times many things look alike: only what explains nearly all of it is it
    let slower = shares[1..].iter().copied().filter(|s| *s > SLOWER_PART);
    slower.fold(shares[0], f64::max)
}

/// Energy of an equation's noise: the sensors' as they are said to be, or what the model leaves from row to row where
/// that is more, but not much; that of the quieter half where that is less.
fn noise_energy(m: &Material, model: &Fit, e: usize) -> f64 {
    let quiet = m.fit.quiet_energy(&model.residual, Equation::ALL[e]);
    let sensors = m.fit.sensor_energy(e);
    // the controller's own equation has no floor that is known but that of the sensors
    if quiet < sensors || Equation::ALL[e] == Equation::Controller {
        quiet.min(sensors)
    } else {
        rough_energy(&m.fit, &model.residual, e)
    }
}
