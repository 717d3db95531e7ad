//! Which effects a model needs, and which may as well be none.

use crate::candidates::bristles::breaks_away;
use crate::candidates::columns::{self, Form};
use crate::candidates::springs::is_seen;
use crate::measured::bench::BenchChannel;
use crate::search::fit::{self, Fit, Term};
use crate::search::intervals;
use crate::search::judge::LEAST_GAIN;
use crate::search::select::Material;
use sim_worker::effect::{EffectKind, Equation};

/// Half-width of an amplitude's 95 % interval over the amplitude from which it may as well be nothing.
const VAGUE: f64 = 0.7;
/// The same of the stiffness of a spring that only the torque shows (assumed).
const VAGUE_SPRING: f64 = 0.4;
/// The same from which the interval holds nothing: such an effect is none, whatever the fit gains by it.
const NOTHING: f64 = 1.0;
/// Gain of what is there though its interval is wide.
pub(super) const CERTAIN: f64 = 60.0;
/// Share of the dry friction that a friction of the speed has at least beside bristles (assumed).
const LEAST_BESIDE_BRISTLES: f64 = 0.02;

/// Log-likelihood less what the parameters of the terms cost (Schwarz).
pub(super) fn penalised(m: &Material, fit: &Fit) -> f64 {
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
pub(super) fn needed(m: &Material, mut model: Fit) -> Fit {
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

/// The last term whose amplitude's interval reaches nothing.
pub(super) fn vague(m: &Material, model: &Fit) -> Option<usize> {
    if model.terms.is_empty() {
        return None;
    }
    let all = intervals::intervals(m, model);
    let static_too = |t: &Term| t.kind == EffectKind::Presliding && breaks_away(&t.shape);
    let static_too = model.terms.iter().any(static_too);
    let bristles = model.has(EffectKind::Presliding);
    (0..model.terms.len()).rev().find(|&t| {
        let e = fit::effect_of(&model.terms[t], &m.constants, &m.fit);
        let linear = !matches!(columns::form(e.kind), Form::Shape | Form::Presliding);
        // all constants together stand for a gain: their beliefs decide, where no load is measured
        let gain = model.terms[t].is_gain_of_all();
        let most = if gain && m.has(BenchChannel::Load) { 1.0 } else { VAGUE };
        // bristles that break away at the static friction have what slow motion has more of it, up to a speed that is assumed
        let same = e.kind == EffectKind::Stribeck && static_too;
        let needed = || !gain && !same && penalised(m, model) - penalised(m, &m.without(model, t)) > CERTAIN;
        let size = e.values[0].abs();
        let mut half = all.terms[t][0] / size;
        if half > most {
            half = intervals::intervals_by_law(m, model, Some(t)).terms[t][0] / size;
        }
        // how bristles turn round between two samples is known no better
        let of_speed = matches!(e.kind, EffectKind::LubricatedRise | EffectKind::Stribeck);
        let turning = bristles && of_speed && size < LEAST_BESIDE_BRISTLES * m.constants.effect.coulomb;
        // a spring that only the torque shows is there if it is known how stiff it is
        let unseen = e.kind == EffectKind::Compliance && m.fit.on_time() && !is_seen(&m.fit, &model.terms[t].shape);
        turning || linear && (half > NOTHING || half > most && !needed()) || unseen && half > VAGUE_SPRING
    })
}
