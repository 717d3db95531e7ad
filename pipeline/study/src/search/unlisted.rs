//! Laws that the list does not have and that any machine may: a constant that is another one at another time or place, an inertia that
//! goes with the turn, a friction that remembers a reversal, a torque that keeps its own time.

use crate::equations::problem::Problem;
use crate::equations::signals::Signals;
use crate::measured::sums::dot;
use crate::search::fit::{Fit, WORTH};
use crate::search::memory;
use crate::search::remainder::{Regressor, bin, edges};
use crate::search::select::Material;
use crate::search::spectrum::{LONGEST, over_time};
use crate::search::trial::{CLEAR, Columns, MOST, Side, Trial, torque_column};
use crate::search::verdict::BEYOND;
use sim_worker::effect::Equation;
use std::collections::BTreeMap;
use std::f64::consts::FRAC_PI_2;

/// Share of what is left that a law takes from which it is there, on the runs that find and on those that prove (assumed: rigs of
/// another hand in which nothing is hidden left up to 0.07).
const SEEN: f64 = 0.1;
/// The same of a constant that is another one at other times: what the neighbouring times say of noise is as often wrong as right
/// (assumed: the same rigs left up to 0.002).
const SEEN_IN_TIME: f64 = 0.04;
/// The same beside effects that were found, and what it takes of what they explain (assumed: rigs of another hand with one effect left up
/// to 0.23 and 0.001).
const SEEN_BESIDE: f64 = 0.3;
const LITTLE: f64 = 0.04;
/// Time over which a constant is one [s] (assumed).
const WHILE_S: f64 = 0.25;
/// Whiles on either side that say what it is, and the least energy that such a one has, over what is usual (assumed).
const NEAR: usize = 2;
const TELLS: f64 = 0.1;
/// How far from what it is for all time a constant is believed to go (assumed).
const BELIEF: f64 = 0.3;
/// Frequencies of a torque that keeps its own time [Hz] (assumed): below, a friction does; above, a converter.
const TONES_HZ: (f64, f64) = (0.5, 100.0);
/// Power of a tone over the median of its neighbours' (assumed: without one up to 15), on either side of so much [Hz].
const STANDS_OUT: f64 = 30.0;
const NEIGHBOURS_HZ: f64 = 3.0;
/// Frequencies on either side that a median takes at least.
const LEAST_NEIGHBOURS: usize = 8;
/// Power of a tone over that of the drive's torque at its frequency from which it is no part of it (assumed: a loop that holds a tone down
/// drives with 0.5 to 2 times its torque, what an equation has wrong of a command's line is a few hundredths of it).
const OF_DRIVE: f64 = 0.1;
/// Pieces of the travel in which a constant is one.
const PLACES: usize = 8;
/// Orders of the turn with which an inertia may go.
const ORDERS: [f64; 2] = [1.0, 2.0];

/// What a constant multiplies in the torque.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Constant {
    Inertia,
    Viscous,
    DryFriction,
    Gain,
    Offset,
}

impl Constant {
    const ALL: [Self; 5] = [
        Self::Inertia,
        Self::Viscous,
        Self::DryFriction,
        Self::Gain,
        Self::Offset,
    ];

    pub fn name(self) -> &'static str {
        match self {
            Self::Inertia => "inertia",
            Self::Viscous => "viscous friction",
            Self::DryFriction => "dry friction",
            Self::Gain => "gain of the drive",
            Self::Offset => "constant torque",
        }
    }

    /// Torque for a value of the constant of about 1, or of the rig's. Of an inertia it is what drive and friction leave to it: an
    /// acceleration has the noise of the angle's sensor, which stands in the residual too.
    fn torque(self, m: &Material, s: &Signals, k: usize) -> f64 {
        let rig = &m.bench.rig;
        let push = rig.drive_constant.value * s.drive[k];
        match self {
            Self::Inertia => {
                let braked = rig.viscous.value * s.omega[k] + rig.coulomb.value * s.sign[k];
                push - s.load[k] - braked - rig.offset
            }
            Self::Viscous => s.omega[k],
            Self::DryFriction => s.sign[k],
            Self::Gain => push,
            Self::Offset => 1.0,
        }
    }
}

/// A law that the list does not have.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Law {
    /// a constant that is another one at other times
    InTime(Constant),
    /// a constant that moves with the time of a run
    WithTime(Constant),
    /// a viscous friction that is another one at other places
    OfPlace,
    /// an inertia that goes with the turn
    OfTurn,
    /// a torque that is a smooth curve of the place
    Curve,
    /// a dry friction that is another one so far after a reversal
    AfterReversal,
    /// a torque that acts in one direction only
    OneWay,
    /// a torque of one frequency, whatever the motion [Hz]
    Tone(f64),
}

impl Law {
    /// As a sentence says it.
    pub fn told(self) -> String {
        match self {
            Self::InTime(c) => format!("the {} is another one at other times", c.name()),
            Self::WithTime(c) => format!("the {} moves with the time of a run", c.name()),
            Self::OfPlace => "the viscous friction is another one at other places".to_string(),
            Self::OfTurn => "the inertia goes with the angle within a turn".to_string(),
            Self::Curve => "the torque is a smooth curve of the place, and not seen to repeat".to_string(),
            Self::OneWay => "a torque acts while it moves in one direction, and not in the other".to_string(),
            Self::AfterReversal => "the dry friction goes with the distance since the motion turned round".to_string(),
            Self::Tone(hz) => format!("a torque of {hz:.2} Hz keeps its own time, whatever the motion"),
        }
    }
}

/// A law, and what it takes on the held-out runs.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Unlisted {
    pub law: Law,
    /// of the energy that a model leaves without it
    pub of_left: f64,
}

/// What a model leaves of the judged rows of the torque, 0 elsewhere.
pub(super) struct Left<'a> {
    p: &'a Problem,
    residual: Vec<f64>,
    rows: f64,
}

impl<'a> Left<'a> {
    pub(super) fn new(side: &Side<'a>) -> Self {
        let mut residual = vec![0.0; side.residual.len()];
        side.rows.iter().for_each(|r| residual[*r] = side.residual[*r]);
        Self {
            p: side.p,
            residual,
            rows: side.rows.len().max(1) as f64,
        }
    }

    fn energy(&self) -> f64 {
        dot(&self.residual, &self.residual)
    }
}

/// Energy that a constant takes from the rows which is learnt from the neighbouring times that tell it, each while from the others, beyond
/// what the same takes that is learnt from all other times.
fn taken_in_time(side: &Left, column: &[f64], trust: f64) -> f64 {
    let rate = side.p.clock.rate_hz;
    let mut taken = 0.0;
    for b in side.p.blocks_of(Equation::Torque) {
        let mut whiles = BTreeMap::<usize, (f64, f64)>::new();
        for (row, &k) in b.rows.clone().zip(&b.samples) {
            let s = whiles.entry((k as f64 / rate / WHILE_S) as usize).or_default();
            *s = (s.0 + column[row].powi(2), s.1 + column[row] * side.residual[row]);
        }
        let add = |a: (f64, f64), s: &(f64, f64)| (a.0 + s.0, a.1 + s.1);
        let all = whiles.values().fold((0.0, 0.0), add);
        let (mut near, mut whole) = (0.0, 0.0);
        // an inertia is heard when the speed changes: what lies between says nothing of it
        let usual = all.0 / whiles.len().max(1) as f64;
        let tells: BTreeMap<usize, (f64, f64)> = whiles
            .iter()
            .filter(|w| w.1.0 > TELLS * usual)
            .map(|w| (*w.0, *w.1))
            .collect();
        for (i, s) in &whiles {
            let before = tells.range(..*i).rev().take(NEAR);
            let around = before.chain(tells.range(i + 1..).take(NEAR));
            let learnt = around.map(|n| n.1).fold((0.0, 0.0), add);
            let of = |(xx, xy): (f64, f64)| {
                let x = xy / (xx + trust);
                2.0 * x * s.1 - x * x * s.0
            };
            near += of(learnt);
            whole += of((all.0 - s.0, all.1 - s.1));
        }
        taken += near - f64::max(whole, 0.0);
    }
    taken
}

/// Share of what is left that a constant takes which is another one at other times.
fn in_time(m: &Material, side: &Left, constant: Constant) -> f64 {
    let c = torque_column(side.p, |s, k| constant.torque(m, s, k));
    let (left, rows) = (side.energy(), side.rows);
    // so many rows' noise is as much as what is believed; of what the rig's own torque is not the scale of, four mean rows
    let trust = match constant {
        Constant::Inertia | Constant::Gain => left / rows / BELIEF.powi(2),
        _ => 4.0 * dot(&c, &c) / rows,
    };
    taken_in_time(side, &c, trust) / left.max(1e-300)
}

/// The frequency that stands out of what is left of the runs that find, and its share of what is left of those that prove.
pub(super) fn tone(m: &Material, find: &Left, prove: &Left) -> Option<(f64, f64)> {
    let every = find.p.group().max(1);
    let blocks = [find, prove].into_iter().flat_map(|s| s.p.blocks_of(Equation::Torque));
    let longest = blocks.filter_map(|b| b.samples.last()).max()? / every + 1;
    let length = (4 * longest).next_power_of_two().min(LONGEST);
    let powers = [find, prove].map(|s| (over_time(s.p, &s.residual, length, every), s.energy()));
    let hz = find.p.clock.rate_hz / every as f64 / length as f64;
    let first = (TONES_HZ.0 / hz).ceil() as usize;
    let last = ((TONES_HZ.1 / hz) as usize).min((length / 2).saturating_sub(4));
    let at = (first..last).max_by(|a, b| powers[0].0[*a].total_cmp(&powers[0].0[*b]))?;
    // a run's own line is as wide as it is short
    let near = at.saturating_sub(2)..=at + 2;
    let stands = powers.each_ref().map(|(power, left)| {
        let wide = ((NEIGHBOURS_HZ / hz) as usize).max(LEAST_NEIGHBOURS);
        let mut around = power[at.saturating_sub(wide).max(1)..(at + wide).min(power.len())].to_vec();
        around.sort_by(f64::total_cmp);
        let highest = power[near.clone()].iter().fold(0.0, |a: f64, b| a.max(*b));
        let out = highest > STANDS_OUT * around[around.len() / 2];
        (out, highest / left.max(1e-300))
    });
    let of = |power: &[f64]| -> f64 { power[near.clone()].iter().sum() };
    let own = || {
        [find, prove].iter().zip(&powers).all(|(s, (power, _))| {
            let push = torque_column(s.p, |s, k| Constant::Gain.torque(m, s, k));
            of(power) > OF_DRIVE * of(&over_time(s.p, &push, length, every))
        })
    };
    let share = stands[0].1.min(stands[1].1);
    (stands[0].0 && stands[1].0 && own()).then_some((at as f64 * hz, share))
}

/// Columns of a constant that moves with the time of a run.
fn moving(m: &Material, p: &Problem, constant: Constant) -> Vec<Vec<f64>> {
    vec![torque_column(p, |s, k| constant.torque(m, s, k) * k as f64 / s.rate_hz)]
}

/// Columns of a viscous friction by the place. An inertia by the place would do too well: the torque that is left to it has the noise of
/// the drive, which it could take out as a whole.
fn placed(p: &Problem, borders: &[f64]) -> Vec<Vec<f64>> {
    let of = |i: usize| torque_column(p, |s, k| if bin(borders, s.theta[k]) == i { s.omega[k] } else { 0.0 });
    (0..=borders.len()).map(of).collect()
}

/// Columns of an inertia of the turn: d/dt (J w) - w^2/2 dJ/d(theta) with J = J0 (1 + a cos + b sin). The acceleration's noise has no sine
/// of the turn.
pub(super) fn turned(m: &Material, p: &Problem) -> Vec<Vec<f64>> {
    let j = m.bench.rig.inertia.value;
    let of = |n: f64| {
        let cosine = |s: &Signals, k: usize, angle: f64| {
            let (sin, cos) = angle.sin_cos();
            j * (cos * s.accel[k] - 0.5 * n * sin * s.omega[k].powi(2))
        };
        // the sine is a cosine of a quarter of a turn less
        [0.0, FRAC_PI_2].map(|late| torque_column(p, |s, k| cosine(s, k, n * s.theta[k] - late)))
    };
    ORDERS.into_iter().flat_map(of).collect()
}

/// The law that the list does not have and that takes most of what a model leaves. `None` where none takes enough.
///
/// * `retuned` the model without effects
pub fn unlisted(trial: &Trial, retuned: &Fit) -> Option<Unlisted> {
    let (m, model) = (trial.m, trial.model);
    let left_of = trial.left();
    if left_of <= 0.0 {
        return None;
    }
    let beside = !model.terms.is_empty();
    // what is within the noise may keep a time of its own, or have whatever form a noise has
    if left_of < if beside { BEYOND } else { WORTH } * trial.noise() {
        return None;
    }
    let (found, proven) = (Left::new(&trial.find), Left::new(&trial.prove));
    let mut seen: Vec<Unlisted> = Vec::new();
    let mut see = |law: Law, of_left: f64| seen.push(Unlisted { law, of_left });
    for c in Constant::ALL {
        let share = in_time(m, &found, c);
        if share > SEEN_IN_TIME {
            see(Law::InTime(c), share.min(in_time(m, &proven, c)));
        }
    }
    if let Some((hz, share)) = tone(m, &found, &proven) {
        see(Law::Tone(hz), share);
    }
    // constants that are learnt once more beside a law may leave more than the model does, or less
    let alone = trial.left_alone()?.min(left_of);
    let mut try_out = |law: Law, columns: &Columns| {
        if let Some(with) = trial.left_with(columns) {
            see(law, (alone - with) / left_of);
        }
    };
    for c in [Constant::Gain, Constant::DryFriction, Constant::Offset] {
        try_out(Law::WithTime(c), &|p| moving(m, p, c));
    }
    let borders = edges(&m.fit, Equation::Torque, Regressor::Position, PLACES);
    try_out(Law::OfPlace, &|p| placed(p, &borders));
    try_out(Law::OfTurn, &|p| turned(m, p));
    let distances = memory::distances(&m.fit);
    try_out(Law::AfterReversal, &|p| memory::after_reversal(p, &distances));
    let explained = (trial.prove.energy(&m.held_residual(retuned)) - left_of).max(0.0);
    let there = |u: &Unlisted| {
        let (least, of_explained) = match u.law {
            Law::InTime(_) if !beside => (SEEN_IN_TIME, 0.0),
            _ if !beside => (SEEN, 0.0),
            // a friction whose law is a little another is another one at other times too
            Law::InTime(_) | Law::WithTime(_) => (SEEN_BESIDE, MOST),
            _ => (SEEN_BESIDE, LITTLE),
        };
        let clear = u.of_left * proven.rows > CLEAR;
        u.of_left > least && clear && (!beside || u.of_left * left_of > of_explained * explained)
    };
    let all = seen.into_iter().filter(there);
    all.max_by(|a, b| a.of_left.total_cmp(&b.of_left))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::measured::prescribed::{INERTIA, rig};
    use crate::search::form::Strange;
    use crate::search::study::{Outcome, of_rig, study};
    use crate::search::verdict::Verdict;
    use sim_worker::effect::EffectKind;
    use std::cell::Cell;
    use std::f64::consts::TAU;

    fn law(o: &Outcome) -> Option<Law> {
        let names: Vec<_> = o.model.terms.iter().map(|t| t.kind).collect();
        assert_eq!(o.verdict, Verdict::Unknown, "{names:?} {:?}", o.strange);
        match o.strange {
            Some(Strange::Unlisted(u)) => Some(u.law),
            _ => None,
        }
    }

    #[test]
    fn nothing_is_missing_where_nothing_is() {
        let o = of_rig(|_, _| 0.0);
        assert!(matches!(o.verdict, Verdict::None | Verdict::Retune), "{:?}", o.verdict);
    }

    #[test]
    fn a_curve_of_the_place_is_no_spring_beside_a_cogging() {
        let cable = of_rig(|_, [_, x, ..]| 0.01 * x.powi(3));
        assert_eq!(law(&cable), Some(Law::Curve), "{:?}", cable.strange);
        // of magnets under a slide two and a half periods are seen
        let magnets = of_rig(|_, [_, x, ..]| 0.05 * x + 0.08 * (3.0 * x).sin());
        let mut names: Vec<_> = magnets.model.terms.iter().map(|t| t.kind.name()).collect();
        names.sort_unstable();
        assert_eq!((names, magnets.strange), (vec!["cogging", "spring_load"], None));
    }

    #[test]
    fn a_friction_that_peaks_after_each_reversal_is_one() {
        // distance since the motion turned round, its sense, and the run
        let since = Cell::new((0.0, 0.0, 0));
        let o = of_rig(|run, [_, _, w, ..]| {
            let (far, sense, before) = since.get();
            let goes_on = sense == w.signum() && run == before;
            since.set((if goes_on { far + w.abs() * 1e-3 } else { 0.0 }, w.signum(), run));
            0.08 * (-since.get().0 / 0.6).exp() * w.signum()
        });
        assert_eq!(law(&o), Some(Law::AfterReversal), "{:?}", o.strange);
    }

    #[test]
    fn a_flywheel_behind_a_one_way_clutch_is_none_of_the_list() {
        let o = of_rig(|_, [_, _, w, a, _]| if w > 0.0 && a > 0.0 { 6.0 * INERTIA * a } else { 0.0 });
        assert_eq!(o.verdict, Verdict::Unknown, "{:?}", o.strange);
    }

    #[test]
    fn a_spring_is_found_beside_a_weight_that_is_stated() {
        let (mut bench, runs) = rig(|_, [_, x, ..]| 0.05 + 0.03 * (x - 0.4));
        bench.rig.offset = 0.048;
        let o = study(Material::new(bench, runs, &[]), &|_| {});
        let names: Vec<_> = o.model.terms.iter().map(|t| t.kind.name()).collect();
        assert_eq!((names, o.verdict), (vec!["spring_load"], Verdict::Named));
    }

    #[test]
    fn a_strong_spring_hides_no_friction_that_falls_with_the_speed() {
        let o = of_rig(|_, [_, x, w, ..]| 2.0 * x + 0.09 * (-w.abs() / 0.6).exp() * w.signum());
        let mut names: Vec<_> = o.model.terms.iter().map(|t| t.kind.name()).collect();
        names.sort_unstable();
        assert_eq!((names, o.verdict), (vec!["spring_load", "stribeck"], Verdict::Named));
    }

    #[test]
    fn a_fit_afresh_is_the_same_whatever_was_taken_for_noise_before() {
        let (bench, runs) = rig(|_, [_, x, w, ..]| 8.0 * x + 0.5 * (-w.abs()).exp() * w.signum());
        let mut spring = study(Material::new(bench.clone(), runs.clone(), &[]), &|_| {})
            .model
            .terms;
        spring.retain(|t| t.kind == EffectKind::SpringLoad);
        let m = Material::new(bench, runs, &[]);
        let off = |fit: &Fit| (fit.terms[0].amplitudes[0] / 8.0 - 1.0).abs();
        let [little, much] = [0.1, 3.0].map(|noise| {
            let loud = m.again(m.bench.clone(), m.nuisances.clone(), (noise, 0.0));
            let fit = loud.solve(&spring, loud.first_sigma());
            // the friction that falls with the speed is not in it: carried on, the spring has its part
            assert!(off(&loud.refitted(&fit).1) > 0.25);
            loud.afresh(&fit).1
        });
        assert!(off(&little) < 0.05, "{}", off(&little));
        assert_eq!(little.terms[0].amplitudes, much.terms[0].amplitudes);
    }

    #[test]
    fn laws_that_the_list_does_not_have_are_told() {
        let tone = of_rig(|run, [t, ..]| 0.03 * (TAU * 7.3 * t + run as f64).sin());
        assert!(
            matches!(law(&tone), Some(Law::Tone(hz)) if (hz - 7.3).abs() < 0.1),
            "{:?}",
            tone.strange
        );
        let drift = of_rig(|_, [t, _, _, _, torque]| torque * 0.04 * t);
        assert!(
            matches!(
                law(&drift),
                Some(Law::WithTime(Constant::Gain) | Law::InTime(Constant::Gain))
            ),
            "{:?}",
            drift.strange
        );
        // taken up and put down, each run at moments of its own
        let payload = of_rig(|run, [t, _, _, a, _]| {
            let held = (2.0 + 0.3 * run as f64..5.0 + 0.4 * run as f64).contains(&t);
            if held { 0.6 * INERTIA * a } else { 0.0 }
        });
        assert_eq!(
            law(&payload),
            Some(Law::InTime(Constant::Inertia)),
            "{:?}",
            payload.strange
        );
        let linkage = of_rig(|_, [_, x, w, a, _]| 0.4 * INERTIA * (x.cos() * a - 0.5 * x.sin() * w * w));
        assert!(
            matches!(law(&linkage), Some(Law::OfTurn)),
            "{:?} {:?}",
            linkage.verdict,
            linkage.strange
        );
    }
}
