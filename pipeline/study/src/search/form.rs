//! Whether what effects leave has a form of its own: a law of a signal that the list does not have.

use crate::candidates::shapes::has_order;
use crate::equations::problem::{Block, Problem};
use crate::equations::signals::Signals;
use crate::measured::recording::extent;
use crate::search::fit::{Fit, MOST_EFFECTS, Term};
use crate::search::remainder::{Regressor, edges};
use crate::search::trial::{CLEAR, MOST, Trial, hat, torque_column};
use crate::search::unlisted::Unlisted;
use crate::search::verdict::BEYOND;
use sim_worker::effect::{EffectKind, Equation};

/// Pieces of a form, as many samples in each.
const PIECES: usize = 12;

/// Why what was found is not what is there.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Strange {
    /// held-out data have a form beside the effects
    Form {
        /// of which signal
        of: Regressor,
        /// it turns over with the motion, as friction does
        signed: bool,
        /// energy that it takes, over that which the effects explain
        share: f64,
    },
    /// a law of a constant or of the time
    Unlisted(Unlisted),
    /// several effects stand for one law: of the same order of the rotor's turn, of the place, or of orders without an end
    Composed,
}

/// Torque by a signal, straight from knot to knot.
struct Hats {
    of: Regressor,
    signed: bool,
    knots: Vec<f64>,
}

impl Hats {
    fn new(p: &Problem, of: Regressor, signed: bool) -> Option<Self> {
        let samples = |b: &Block| -> Vec<f64> { b.samples.iter().map(|&k| of.value(&p.signals[b.run], k)).collect() };
        let (low, high) = extent(p.blocks_of(Equation::Torque).flat_map(samples));
        let mut knots = vec![low];
        knots.extend(edges(p, Equation::Torque, of, PIECES));
        knots.push(high);
        knots.dedup();
        (knots.len() > 3).then_some(Self { of, signed, knots })
    }

    fn columns(&self, p: &Problem) -> Vec<Vec<f64>> {
        let signed = |s: &Signals, k: usize| if self.signed { s.sign[k] } else { 1.0 };
        let of_knot = |i: usize| torque_column(p, |s, k| hat(&self.knots, i, self.of.value(s, k)) * signed(s, k));
        (0..self.knots.len()).map(of_knot).collect()
    }
}

/// What the list does not have, though effects of it were found.
///
/// * `retuned` the model without effects
pub fn strange(trial: &Trial, retuned: &Fit) -> Option<Strange> {
    let m = trial.m;
    if composed(&trial.model.terms) {
        return Some(Strange::Composed);
    }
    let left_of = trial.left();
    let explained = trial.prove.energy(&m.held_residual(retuned)) - left_of;
    let clear = CLEAR * left_of / trial.prove.rows.len().max(1) as f64;
    // what is within the noise has no form but that of a noise that stands in the regressors too
    if explained < clear || left_of < BEYOND * trial.noise() {
        return None;
    }
    let alone = trial.left_alone()?;
    let laws = [
        (Regressor::Speed, false),
        (Regressor::Position, false),
        (Regressor::Position, true),
        (Regressor::Drive, false),
    ];
    // the chatter of phases stands in their current and in what is left alike
    let told = |of: Regressor| of != Regressor::Drive || !m.bench.has_phases();
    let forms = laws.into_iter().filter(|l| told(l.0)).filter_map(|(of, signed)| {
        let hats = Hats::new(&m.fit, of, signed)?;
        let taken = alone - trial.left_with(&|p| hats.columns(p))?;
        let share = taken / explained;
        (taken > clear && share > MOST).then_some((share, Strange::Form { of, signed, share }))
    });
    forms.max_by(|a, b| a.0.total_cmp(&b.0)).map(|f| f.1)
}

/// Orders that are one (assumed).
const SAME_ORDER: f64 = 0.02;
/// So many effects are one law that the list does not have (assumed).
const COMPOSED: usize = 3;

fn composed(terms: &[Term]) -> bool {
    let of_kind = |kind: EffectKind| terms.iter().filter(|t| t.kind == kind).count();
    let frictions = of_kind(EffectKind::PeriodicFriction) + of_kind(EffectKind::TightSpot);
    // magnets are one law, however many orders they have
    let of_place = frictions + of_kind(EffectKind::SpringLoad) + of_kind(EffectKind::Cogging).min(1);
    let of_order = terms.iter().filter(|t| has_order(t.kind));
    let orders: Vec<f64> = of_order.map(|t| t.shape[0]).collect();
    let alike = |a: f64| orders.iter().filter(|b| (a - **b).abs() < SAME_ORDER * a).count();
    orders.iter().any(|a| alike(*a) >= COMPOSED) || of_place >= COMPOSED || orders.len() == MOST_EFFECTS
}

#[cfg(test)]
mod tests {
    use super::*;
    use sim_worker::effect::EffectKind::*;

    #[test]
    fn three_of_one_order_or_of_the_place_stand_for_one_law() {
        let terms = |all: &[(EffectKind, f64)]| -> Vec<Term> {
            let term = |&(kind, first): &(EffectKind, f64)| Term {
                kind,
                shape: vec![first],
                amplitudes: vec![1.0],
            };
            all.iter().map(term).collect()
        };
        assert!(composed(&terms(&[
            (Cogging, 3.0),
            (TorqueRipple, 3.01),
            (PeriodicFriction, 2.99)
        ])));
        assert!(composed(&terms(&[
            (TightSpot, 1.0),
            (PeriodicFriction, 0.4),
            (TightSpot, 9.0)
        ])));
        assert!(composed(&terms(&[(TightSpot, 1.0), (SpringLoad, 0.0), (Cogging, 0.7)])));
        // a saw and a row of teeth have as many orders as are looked for
        assert!(composed(&terms(&[
            (Cogging, 2.0),
            (Cogging, 4.0),
            (Cogging, 6.0),
            (Cogging, 8.0)
        ])));
        // magnets have several orders, and an offset of a current makes a cogging of its ripple
        assert!(!composed(&terms(&[(Cogging, 6.0), (Cogging, 12.0), (Cogging, 18.0)])));
        assert!(!composed(&terms(&[
            (Cogging, 4.0),
            (TorqueRipple, 4.0),
            (TightSpot, 4.0)
        ])));
        assert!(!composed(&terms(&[(Cogging, 4.0), (Cogging, 8.0), (SpringLoad, 0.0)])));
        assert!(!composed(&[]));
    }
}
