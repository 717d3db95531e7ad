//! Laws that the list does not have in the place of effects that were found, where they leave less.

use crate::candidates::shapes::has_order;
use crate::equations::problem::Problem;
use crate::equations::signals::Signals;
use crate::search::fit::{Fit, Term};
use crate::search::trial::{CLEAR, Trial, torque_column};
use crate::search::unlisted::{Law, Left, Unlisted, tone, turned};
use sim_worker::effect::{EffectKind, Equation};
use std::f64::consts::{FRAC_PI_2, TAU};

/// Share of what an effect leaves below which a law in its place must come (assumed: in the place of true ones 1.03 and more, of others up
/// to 0.93).
const INSTEAD: f64 = 0.97;
/// What position and velocity are apart without an effect, over what they are with it, squared, from which the motion shows it (assumed).
const PARTED: f64 = 2.0;
/// Share of what is left without a spring below which one tone brings it that does not stop (assumed: springs have none that stands out).
const RINGS: f64 = 0.5;
/// Share of what two effects explain that a torque of one direction may leave which is both, with half of their parameters (assumed).
const AS_LITTLE: f64 = 0.01;
/// Periods over the travel from which what repeats is no smooth curve of the place, and degree of such a curve (assumed: a spring and a
/// cogging have as many parameters).
const FEW_PERIODS: f64 = 3.0;
const DEGREE: i32 = 5;

/// A law in the place of an effect of the model; `None` where none leaves less.
pub fn in_place(trial: &Trial) -> Option<Unlisted> {
    let of = |t: usize| {
        instead(trial, t)
            .or_else(|| smooth(trial, t))
            .or_else(|| halves(trial, t))
    };
    let leaves = trial.left() > 0.0;
    leaves.then(|| (0..trial.model.terms.len()).find_map(of)).flatten()
}

/// Columns of a torque that is a smooth curve of the place.
///
/// * `travel` from where to where [rad]
fn curved(p: &Problem, (low, high): (f64, f64)) -> Vec<Vec<f64>> {
    let place = |s: &Signals, k: usize| (2.0 * s.theta[k] - low - high) / (high - low);
    let of = |n: i32| torque_column(p, |s, k| place(s, k).powi(n));
    (1..=DEGREE).map(of).collect()
}

/// A smooth curve that leaves less than a cogging that is hardly seen to repeat does, with a spring beside it where there is one.
fn smooth(trial: &Trial, term: usize) -> Option<Unlisted> {
    let (m, model) = (trial.m, trial.model);
    let (low, high) = m.fit.travel();
    let cogging = &model.terms[term];
    if cogging.kind != EffectKind::Cogging || cogging.shape[0] * (high - low) > FEW_PERIODS * TAU {
        return None;
    }
    let mut less = m.without(model, term);
    if let Some(spring) = less.terms.iter().position(|t| t.kind == EffectKind::SpringLoad) {
        less = m.without(&less, spring);
    }
    let (left_of, trial) = (trial.left(), trial.of(&less));
    let (all, rest) = (trial.left(), trial.left_with(&|p| curved(p, (low, high)))?);
    (rest < left_of).then(|| Unlisted {
        law: Law::Curve,
        of_left: (all - rest) / all,
    })
}

/// A law that leaves less than one of the effects does, in its place.
fn instead(trial: &Trial, term: usize) -> Option<Unlisted> {
    let (m, left_of) = (trial.m, trial.left());
    let kind = trial.model.terms[term].kind;
    // a load that swings for long on its spring is a tone; an angle's sensor off its centre seems to speed up and slow down within a turn
    let swings = kind == EffectKind::Compliance;
    // a square of the speed in one direction only is a drag and half of another that does not change its sign
    let drags = kind == EffectKind::ViscousAsymmetry;
    if !(swings || drags || has_order(kind) || kind == EffectKind::EncoderEccentricity) {
        return None;
    }
    let less = m.without(trial.model, term);
    // two sensors of the motion that part without it: no torque does that
    let parted = |f: &Fit| f.score.energy[Equation::Kinematic.index()];
    if kind == EffectKind::EncoderEccentricity && parted(&less) > PARTED * parted(trial.model) {
        return None;
    }
    let trial = trial.of(&less);
    let all = trial.left();
    let (law, rest) = if swings {
        let (hz, share) = tone(m, &Left::new(&trial.find), &Left::new(&trial.prove))?;
        (Law::Tone(hz), all * (1.0 - share))
    } else if drags {
        let squared = |p: &Problem| vec![torque_column(p, |s, k| s.omega[k].powi(2))];
        (Law::OneWay, trial.left_with(&squared)?)
    } else {
        (Law::OfTurn, trial.left_with(&|p| turned(m, p))?)
    };
    let better = rest < INSTEAD * left_of && (left_of - rest) * trial.prove.rows.len() as f64 > CLEAR * left_of;
    // beside constants that were fitted with another law, and with rows left out, a line is not all of its tone
    let rings = swings && rest < RINGS * all;
    (better || rings).then(|| Unlisted {
        law,
        of_left: (all - rest) / all,
    })
}

/// A cogging in one direction only in place of one and a friction of its order: half of the parameters that leave as little.
fn halves(trial: &Trial, term: usize) -> Option<Unlisted> {
    let (m, model) = (trial.m, trial.model);
    let cogging = &model.terms[term];
    if cogging.kind != EffectKind::Cogging {
        return None;
    }
    let (low, high) = m.fit.travel();
    let same = |t: &Term| (t.shape[0] - cogging.shape[0]).abs() * (high - low) < TAU;
    let is_half = |t: &Term| t.kind == EffectKind::PeriodicFriction && same(t);
    let half = model.terms.iter().position(is_half)?;
    let mut less = m.without(&m.without(model, term.max(half)), term.min(half));
    // what is left without them is no noise: by that both would leave as little
    less.sigma = model.sigma;
    let (left_of, trial) = (trial.left(), trial.of(&less));
    let order = cogging.shape[0];
    let of = |p: &Problem, way: f64| -> Vec<Vec<f64>> {
        let wave = |s: &Signals, k: usize, late: f64| (1.0 + way * s.sign[k]) * (order * s.theta[k] - late).cos();
        [0.0, FRAC_PI_2]
            .map(|late| torque_column(p, |s, k| wave(s, k, late)))
            .to_vec()
    };
    let all = trial.left();
    let ways = [1.0, -1.0].into_iter();
    let rest = ways
        .filter_map(|way| trial.left_with(&|p| of(p, way)))
        .fold(all, f64::min);
    (rest - left_of < AS_LITTLE * (all - left_of)).then(|| Unlisted {
        law: Law::OneWay,
        of_left: (all - rest) / all,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::search::form::Strange;
    use crate::search::study::of_rig;
    use crate::search::verdict::Verdict;

    fn law(besides: impl Fn([f64; 5]) -> f64) -> Option<Law> {
        let o = of_rig(|_, at| besides(at));
        let names: Vec<_> = o.model.terms.iter().map(|t| t.kind.name()).collect();
        match o.strange {
            Some(Strange::Unlisted(u)) => {
                assert_eq!(o.verdict, Verdict::Unknown, "{names:?}");
                Some(u.law)
            }
            _ => {
                assert_eq!(o.verdict, Verdict::Named, "{names:?}");
                None
            }
        }
    }

    #[test]
    fn what_acts_in_one_direction_only_is_none_of_the_list() {
        let pawl = law(|[_, x, w, ..]| if w > 0.0 { 0.06 * (1.0 + (3.0 * x).cos()) } else { 0.0 });
        assert_eq!(pawl, Some(Law::OneWay));
        let valve = law(|[_, _, w, ..]| if w > 0.0 { 2e-3 * w * w } else { 0.0 });
        assert_eq!(valve, Some(Law::OneWay));
        // a cogging and a friction of its order, each with a phase of its own
        let both = law(|[_, x, w, ..]| 0.06 * (3.0 * x).cos() + 0.06 * (3.0 * x + 0.8).cos() * w.signum());
        assert_eq!(both, None);
        // a drag that is another one in each direction
        let drags = law(|[_, _, w, ..]| 6e-3 * w.abs());
        assert_eq!(drags, None);
    }
}
