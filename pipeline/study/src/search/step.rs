//! One step of a study: the leading candidates are refined beside what is in the model, and the best that is not refused is taken.

use crate::equations::nuisances::Nuisance;
use crate::search::fit::{Fit, MOST_EFFECTS, Term, WORTH};
use crate::search::judge::{LEAST_GAIN, NEGATIVE, OTHERWISE, Step, TWICE, UNHEARD, judged};
use crate::search::needed::penalised;
use crate::search::scan;
use crate::search::select::{Material, Ranked};
use sim_worker::effect::EffectKind;

/// Gain of a candidate that is worth a look at pairs although it is refused alone.
const PAIR_GAIN: f64 = 60.0;
/// Gain beside the greatest from which candidates are compared around their own constants, and the least of that by which these move (assumed).
const CLOSE: f64 = 0.8;
const MOVES: f64 = 500.0;
/// Candidates that are looked at closely, and the gain of these over the best's, least.
const LEADERS: usize = 4;
const LEADING: f64 = 0.3;
/// Candidates that a second one is tried with.
const PAIRS: usize = 4;
/// Share of a spring's gain from which a constant torque does as well (assumed).
const AS_WELL: f64 = 0.95;
/// Rounds in which a candidate's constants are carried into its equations.
const ROUNDS: usize = 3;
/// Width of a tight spot that is begun again, over the one before (assumed).
const WIDER_SPOT: f64 = 1.3;
/// Candidates that are looked at beside the other law of an effect that is there.
const OTHER_LEADERS: usize = 2;
/// Log-likelihood by which a rival must fall behind, and share of the gain where the best leaves a gap (assumed).
const RIVAL: f64 = 5.0;
const RIVAL_SHARE: f64 = 0.02;

/// What is met more often comes first where the data cannot tell, in log-likelihood (assumed).
fn usual(t: &Term) -> f64 {
    match t.kind {
        EffectKind::Cogging | EffectKind::BiasTorque => 1.5,
        // all constants together stand for it
        _ if t.is_gain_of_all() => -30.0,
        EffectKind::CurrentOffset | EffectKind::CurrentGain | EffectKind::TurnShort => -1.5,
        _ => 0.0,
    }
}

/// What a step comes to.
pub(super) struct Tried {
    pub step: Step,
    pub model: Fit,
    /// kinds that may stand for what was taken
    pub rivals: Vec<EffectKind>,
    /// the equations in which it was taken, where they are others
    pub own: Option<Material>,
}

impl Tried {
    fn of(step: Step, model: Fit) -> Self {
        Self {
            step,
            model,
            rivals: Vec::new(),
            own: None,
        }
    }
}

/// The step after a model; `None` where nothing may be added.
///
/// * `first` beliefs around the constants with which the study began
pub(super) fn step(m: &Material, model: &Fit, first: &[Nuisance]) -> Option<Tried> {
    let ranked = m.scan(model, EffectKind::ALL);
    let tried = m.leading(model, &ranked)?;
    let misplaced = match tried.step.why_not {
        NEGATIVE => true,
        UNHEARD => ranked[0].gain > MOVES,
        _ => false,
    };
    let there = misplaced.then(|| m.where_they_belong(model, &ranked, first)).flatten();
    Some(there.unwrap_or(tried))
}

fn leaders(ranked: &[Ranked]) -> impl Iterator<Item = &Ranked> {
    ranked
        .iter()
        .take(LEADERS)
        .filter(|r| r.gain > LEADING * ranked[0].gain)
}

fn last(f: &Fit) -> &Term {
    f.terms.last().expect("one was added")
}

impl Material {
    /// A model with one more term, constants and amplitudes solved again.
    fn with(&self, model: &Fit, term: &Term) -> Fit {
        let mut terms = model.terms.clone();
        terms.push(term.clone());
        self.solve(&terms, model.sigma)
    }

    /// The leaders refined together with what is in the model already, and their gains, the greatest first.
    fn refined(&self, model: &Fit, ranked: &[Ranked]) -> Vec<(Fit, f64)> {
        let refined = |model: &Fit, r: &Ranked| self.polish(&self.with(model, &r.term), 1);
        let mut fits: Vec<Fit> = leaders(ranked).map(|r| refined(model, r)).collect();
        let others = [self.of_the_other_voltage(model), self.of_another_iron(model)];
        for other in others.into_iter().flatten() {
            let beside = self.scan(&other, EffectKind::ALL);
            fits.extend(beside.iter().take(OTHER_LEADERS).map(|r| refined(&other, r)));
        }
        let before = penalised(self, model);
        let gain = |m: &Self, fit: &Fit| penalised(m, fit) - before + usual(last(fit));
        let mut tried: Vec<(Fit, f64)> = fits
            .into_iter()
            .map(|fit| {
                let gain = gain(self, &fit);
                (fit, gain)
            })
            .collect();
        tried.sort_by(|a, b| b.1.total_cmp(&a.1));
        let best = tried.first().map_or(0.0, |t| t.1);
        let close = tried.iter().take_while(|t| t.1 > CLOSE * best).count();
        if close > 1 && best > MOVES {
            // each with the constants that it comes to, around which the equations are others
            for (fit, of) in &mut tried[..close] {
                let (around, fit) = self.refitted_alike(fit);
                *of = gain(&around, &fit);
            }
            tried.sort_by(|a, b| b.1.total_cmp(&a.1));
        }
        tried
    }

    /// The best of the leading candidates that is not refused, or the best with why it is.
    fn leading(&self, model: &Fit, ranked: &[Ranked]) -> Option<Tried> {
        let mut tried = self.refined(model, ranked);
        // none where the gains are beyond all numbers
        let gain = tried.first()?.1;
        // where a spring is at ease is a constant torque: where that does as well it comes first, and the spring after it if there is one
        let constant = |f: &Fit| matches!(last(f).kind, EffectKind::BiasTorque | EffectKind::CurrentOffset);
        let spring = |f: &Fit| last(f).kind == EffectKind::SpringLoad;
        let as_well = spring(&tried[0].0) && tried.iter().any(|t| constant(&t.0) && t.1 > AS_WELL * gain);
        if as_well {
            tried.sort_by_key(|t| !constant(&t.0));
        }
        let clean = (0..5).all(|e| tried[0].0.score.energy[e] <= WORTH * self.fit.sensor_energy(e));
        let behind = RIVAL + if clean { 0.0 } else { RIVAL_SHARE * gain };
        let mut out: Option<Step> = None;
        for (i, (next, gain)) in tried.iter().enumerate() {
            let step = judged(self, model, next, *gain, ranked);
            if step.accepted {
                let rivals = tried[i + 1..]
                    .iter()
                    .filter(|t| !(as_well && spring(&t.0)) && gain - t.1 < behind)
                    .filter(|t| judged(self, model, &t.0, t.1, ranked).accepted)
                    .map(|t| last(&t.0).kind)
                    .collect();
                let taken = Tried::of(step, next.clone());
                return Some(Tried { rivals, ..taken });
            }
            let again = (step.why_not == TWICE).then(|| self.elsewhere(model, next, ranked));
            if let Some(instead) = again.flatten().or_else(|| self.in_place(model, next, ranked)) {
                return Some(instead);
            }
            let same_again = [TWICE, OTHERWISE].contains(&step.why_not);
            out.get_or_insert(step);
            if same_again {
                // a shape that the list does not have is no reason for another name
                return Some(Tried::of(out?, next.clone()));
            }
        }
        let pair = self.pair(model, ranked);
        pair.or_else(|| Some(Tried::of(out?, tried[0].0.clone())))
    }

    /// Two effects that may each make it worse without the other.
    fn pair(&self, model: &Fit, ranked: &[Ranked]) -> Option<Tried> {
        let best_gain = ranked[0].gain;
        if best_gain <= PAIR_GAIN || model.terms.len() + 2 > MOST_EFFECTS {
            return None;
        }
        let firsts = ranked.iter().take(PAIRS).filter(|r| r.gain > 0.15 * best_gain);
        let mut pairs: Vec<(Fit, f64)> = firsts
            .filter_map(|first| {
                let alone = self.with(model, &first.term);
                let second = self.scan(&alone, EffectKind::ALL).into_iter().next()?;
                if second.gain <= LEAST_GAIN {
                    return None;
                }
                let pair = self.polish(&self.with(&alone, &second.term), 2);
                let usual: f64 = pair.terms[model.terms.len()..].iter().map(usual).sum();
                let gain = penalised(self, &pair) - penalised(self, model) + usual;
                Some((pair, gain))
            })
            .collect();
        pairs.sort_by(|a, b| b.1.total_cmp(&a.1));
        pairs.into_iter().find_map(|(pair, gain)| {
            let step = judged(self, model, &pair, gain, ranked);
            step.accepted.then(|| Tried::of(step, pair))
        })
    }

    /// A candidate in the place of an effect of the model whose sign is not physical any more beside it, where that tells more than the
    /// model and is not refused.
    fn in_place(&self, model: &Fit, next: &Fit, ranked: &[Ranked]) -> Option<Tried> {
        let mut old = next.terms[..model.terms.len()].iter();
        let at = old.position(|t| !scan::admissible(t.kind, &t.amplitudes))?;
        let less = self.dropped(model, at);
        let mut terms = less.terms.clone();
        terms.extend_from_slice(&next.terms[model.terms.len()..]);
        let instead = self.polish(&self.solve(&terms, next.sigma), 1);
        self.better(model, &less, instead, 0.0, ranked)
    }

    /// What stands in the place of a term of the model, where it tells more than that by so much and is not refused.
    ///
    /// * `less` the model without the term
    fn better(&self, model: &Fit, less: &Fit, instead: Fit, by: f64, ranked: &[Ranked]) -> Option<Tried> {
        let told = penalised(self, &instead);
        if told <= penalised(self, model) + by {
            return None;
        }
        let step = judged(self, less, &instead, told - penalised(self, less), ranked);
        step.accepted.then(|| Tried::of(step, instead))
    }

    /// A tight spot of the model begun again where the new one beside it is, and between both, where one of these tells more than the model:
    /// one that was found while something else was missing may have settled beside where it is.
    fn elsewhere(&self, model: &Fit, next: &Fit, ranked: &[Ranked]) -> Option<Tried> {
        let spot = |t: &Term| t.kind == EffectKind::TightSpot;
        let new = Some(last(next)).filter(|t| spot(t))?;
        let at = model.terms.iter().position(spot)?;
        let less = self.dropped(model, at);
        let (there, width) = (model.terms[at].shape[0], model.terms[at].shape[1]);
        let starts = [new.shape[0], 0.5 * (there + new.shape[0])];
        let tries = starts.iter().flat_map(|c| [width, WIDER_SPOT * width].map(|w| [*c, w]));
        let fits = tries.map(|shape| {
            let mut term = model.terms[at].clone();
            term.shape[..2].copy_from_slice(&shape);
            let mut terms = less.terms.clone();
            terms.push(term);
            self.polish(&self.solve(&terms, model.sigma), 2)
        });
        let best = fits
            .map(|f| (penalised(self, &f), f))
            .max_by(|a, b| a.0.total_cmp(&b.0));
        self.better(model, &less, best?.1, LEAST_GAIN, ranked)
    }

    /// The best of the leading candidates, each around the constants that it comes to: those of the model may be far from there, friction
    /// may be one of which nothing is believed any more, and the filter took what is missing for noise. `None` where all are refused there
    /// too.
    fn where_they_belong(&self, model: &Fit, ranked: &[Ranked], first: &[Nuisance]) -> Option<Tried> {
        let believing = self.believing(first);
        let from = believing.as_ref().unwrap_or(self);
        let taken = leaders(ranked).filter_map(|r| {
            let (mut own, mut fit) = from.refitted(&self.with(model, &r.term));
            for _ in 1..ROUNDS {
                (own, fit) = own.refitted(&fit);
            }
            let without = own.polish(&own.solve(&model.terms, model.sigma), 1);
            let told = penalised(&own, &fit);
            let step = judged(&own, &without, &fit, told - penalised(&own, &without), ranked);
            step.accepted.then(|| (told, own, Tried::of(step, fit)))
        });
        let (_, own, tried) = taken.max_by(|a, b| a.0.total_cmp(&b.0))?;
        Some(Tried {
            own: Some(own),
            ..tried
        })
    }
}

#[cfg(test)]
mod tests {
    use crate::measured::prescribed::{INERTIA, Sensor, axis, under_load};
    use crate::search::select::Material;
    use crate::search::study::{of_rig, study};
    use crate::search::verdict::Verdict;
    use sim_worker::effect::EffectKind;
    use std::cell::RefCell;
    use std::f64::consts::TAU;

    /// Beside a friction that is there the rest of it is three times what it is without: a first order around that ends at a drag below 0.
    #[test]
    fn a_friction_that_rises_to_three_times_as_much_is_found() {
        let (torque, speed) = (0.45, 2.0);
        let o = of_rig(|_, [_, _, w, ..]| torque * (1.0 - (-w.abs() / speed).exp()) * w.signum());
        assert_eq!(
            (o.verdict, o.model.kinds()),
            (Verdict::Named, vec![EffectKind::LubricatedRise])
        );
        let found = o.model.terms[0].amplitudes[0];
        assert!((found / torque - 1.0).abs() < 0.1, "{found}");
    }

    /// Twenty samples of a move in which it stops from 5 rad/s: smoothed, it moves while it rests, with no friction.
    #[test]
    fn an_axis_that_stops_between_few_samples_is_plain() {
        let (bench, runs) = axis(200.0, Sensor::Speed(0.3), false);
        let o = study(Material::new(bench, runs, &[]), &|_| {});
        assert_eq!((o.verdict, o.model.kinds()), (Verdict::Retune, vec![]));
    }

    /// The current of a warm winding is no gain of its sensor, which would take the torque's noise with it.
    #[test]
    fn a_warm_winding_is_no_gain_of_the_current() {
        let (bench, runs) = axis(2000.0, Sensor::Angle(1e-4), true);
        let o = study(Material::new(bench, runs, &[]), &|_| {});
        assert_eq!(
            (o.verdict, o.model.kinds()),
            (Verdict::Named, vec![EffectKind::WindingHeating])
        );
        let kelvin = o.model.terms[0].amplitudes[0];
        assert!((kelvin - 0.2 / 0.00393).abs() < 3.0, "{kelvin}");
    }

    /// A cogging goes with the acceleration: without it half of the inertia is seen, around which its torque is half.
    #[test]
    fn a_torque_is_over_the_inertia_that_is_there() {
        let torque = 0.2;
        let o = of_rig(|_, [_, x, ..]| torque * (2.0 * x - 1.5).cos());
        assert_eq!(
            (o.verdict, o.model.kinds()),
            (Verdict::Named, vec![EffectKind::Cogging])
        );
        let found = o.model.terms[0].amplitudes[0].hypot(o.model.terms[0].amplitudes[1]);
        assert!((found / torque - 1.0).abs() < 0.01, "{found}");
    }

    /// Stiffness of a load that swings at 3.5 Hz, and what it adds to the torque of a rig whose motor alone is moved.
    fn slow_spring() -> (f64, impl Fn(usize, [f64; 5]) -> f64) {
        let load = 0.6 * INERTIA;
        let (stiffness, damping) = (load * (TAU * 3.5).powi(2), 0.1 * load * TAU * 3.5);
        let state = RefCell::new((0.0, 0.0));
        let adds = move |_: usize, [t, x, w, a, _]: [f64; 5]| {
            let (mut angle, mut speed) = if t == 0.0 { (x, w) } else { *state.borrow() };
            let steps = 20;
            let dt = 1e-3 / f64::from(steps);
            let torque = |angle: f64, speed: f64, x: f64, w: f64| stiffness * (x - angle) + damping * (w - speed);
            let now = torque(angle, speed, x, w);
            for k in 0..steps {
                let h = f64::from(k) * dt;
                speed += torque(angle, speed, x + w * h, w + a * h) / load * dt;
                angle += speed * dt;
            }
            state.replace((angle, speed));
            now - load * a
        };
        (stiffness, adds)
    }

    /// Of a load that swings at 3.5 Hz a torque that is not known whole says nothing: the motion says it, and it does not matter on
    /// which side of the spring a recorded torque acts.
    #[test]
    fn a_load_on_a_slow_spring_is_found_by_the_motion() {
        let steps = |t: f64| if (1.3 * t).fract() < 0.5 { 0.3 } else { -0.1 };
        for load in [None, Some(&steps as &dyn Fn(f64) -> f64)] {
            let (stiffness, adds) = slow_spring();
            let (bench, runs) = under_load(adds, load);
            let o = study(Material::new(bench, runs, &[]), &|_| {});
            assert_eq!(
                (o.verdict, o.model.kinds()),
                (Verdict::Named, vec![EffectKind::Compliance])
            );
            let found = o.model.terms[0].shape[0];
            assert!((found / stiffness - 1.0).abs() < 0.05, "{found} {stiffness}");
        }
    }
}
