//! Effects that only the simulated loop shows. What the equations of torque and voltage cannot see, for want of a channel or under the
//! chatter of a current that is read at points, moves the motor all the same: the numerical test bench under the recorded command
//! comes to another angle than was measured, in the manner of that effect.

use crate::measured::bench::{Bench, BenchChannel, Role};
use crate::measured::sums::scatter;
use crate::search::beside::{Beside, found};
use crate::told::knobs::{self, KNOBS, Knob, MECHANICS, PIECE_S, STEP};
use crate::told::verify::{self, AT_ONCE, OfRuns, Simulated};
use nalgebra::{DMatrix, DVector};
use schemas::error::Result;
use sim_worker::effect::{Effect, EffectKind, Law, SOURCES};
use sim_worker::parameters::ActuatorParameters;
use std::collections::BTreeMap;

/// Time over which the angle's change is one number [s] (assumed): a count of the angle is small beside it.
const MEAN_S: f64 = 4e-3;
/// Share of the squared gap on held-out runs, constants re-tuned, that an effect must take, and how much more of it the next best
/// must leave (assumed).
const LEAST_SHARE: f64 = 0.6;
const NEARLY_ALL: f64 = 0.9;
const APART: f64 = 1.5;
/// How much further constants may be off than they are believed to be (assumed: some were told by noisy equations).
const LOOSE: f64 = 2.0;
/// How often as far as equations with voltages say that constants may be off, and least of it, one sigma relative (assumed): they
/// were told without the effect.
const TOLD: f64 = 3.0;
const LEAST_TOLD: f64 = 3e-3;
/// Standard deviations beyond which no gap turns a constant where equations tell the torque (assumed): a strong effect that shows in
/// a second of a minute would. Beside currents that are read at points what they tell is off by more than it says.
const FURTHEST: f64 = 3.0;
/// Standard deviations from which an effect that proves itself on held-out runs is one (assumed).
const CERTAIN: f64 = 4.0;
/// The same where it takes nearly all of the gap, there, and the loop rests with it: what scatters is how much, not whether (assumed).
const CERTAIN_AT_REST: f64 = 3.0;
/// Gap over [`QUIET`] that no constants explain and no effect, from which something is missing (assumed: without anything missing up to 1.4
/// was left), and the same without the piece in which most is left: a loop that breaks away a moment sooner or later runs apart for
/// that one (assumed: without anything missing up to 0.5 was left).
const STRANGE: f64 = 2.0;
const STRANGE_ELSEWHERE: f64 = 1.5;
/// Voltage of the supply that counts as much as [`QUIET`] [V] (assumed).
const QUIET_SUPPLY_V: f64 = 0.03;
/// Speed of the gap, rms, up to which nothing is looked for (assumed: without anything missing 0.03 to 0.14 was left) [rad/s].
pub const QUIET: f64 = 0.2;
/// Rounds about what was found, longest step of one over the value, and difference by which its slope is taken; kinds that are looked
/// into.
const ROUNDS: usize = 2;
/// Rounds until constants are as near as they come, and times that the best is followed on while it is not at rest.
const UNTIL_CONSTANT: usize = 5;
const FOLLOWED_ON: usize = 3;
const LONGEST: f64 = 0.6;
const NEARBY: f64 = 0.2;
const LOOKED_INTO: usize = 4;
/// Times that gaps are weighted anew.
const REWEIGHTED: usize = 4;

/// What a volt of the supply counts as [rad/V].
const SUPPLY: f64 = QUIET * MEAN_S / QUIET_SUPPLY_V;

fn knobs() -> Vec<&'static Knob> {
    KNOBS.iter().chain(&MECHANICS).collect()
}

/// An effect that is tried, and the size that its slope is taken with.
#[derive(Clone)]
struct Candidate {
    effect: Effect,
    size: f64,
}

impl Candidate {
    fn of(kind: EffectKind, size: f64) -> Self {
        Self {
            effect: Effect::new(kind, &[size]),
            size,
        }
    }

    fn with(&self, value: f64) -> Effect {
        let mut e = self.effect.clone();
        e.values[0] = value;
        e
    }
}

/// What equations of the same recordings tell, so that the loop need not.
#[derive(Clone, Debug, Default)]
pub struct Told {
    /// constants, and their standard deviations, relative
    pub constants: Vec<(String, f64)>,
    /// the torque, and so every effect in it: voltages are measured, and currents are means
    pub torque: bool,
}

/// Effects that are tried, by sizes that are small.
fn candidates(child: &ActuatorParameters, told: &Told) -> Vec<Candidate> {
    use EffectKind as K;
    let mut all = vec![
        Candidate::of(K::Backlash, 0.02),
        Candidate::of(K::DeadTime, 0.2),
        Candidate::of(K::ControlDelay, 1e-4),
        Candidate::of(K::CommutationOffset, 0.03),
        Candidate::of(K::TorqueSaturation, 0.003),
        Candidate::of(K::QuadraticDrag, 5e-9),
        Candidate::of(K::ViscousAsymmetry, 5e-6),
        Candidate::of(K::BiasTorque, 1e-3),
        Candidate::of(K::SpringLoad, 5e-6),
    ];
    all.extend(SOURCES.map(|law| {
        let mut c = Candidate::of(K::SupplySag, 0.1);
        c.effect.law = law;
        c
    }));
    for sensor in 0..3 {
        for (kind, size) in [(K::CurrentGain, 0.02), (K::CurrentOffset, 0.05)] {
            let mut c = Candidate::of(kind, size);
            c.effect.law = Law::Phase(sensor);
            all.push(c);
        }
        all.push(Candidate {
            effect: Effect::new(K::TurnShort, &[0.02, sensor as f64]),
            size: 0.02,
        });
    }
    // a rival only: of its three parameters the loop tells one number
    for hertz in [250.0, 500.0] {
        let inertia = 0.1 * child.inertia_kg_m2;
        let stiffness = inertia * (std::f64::consts::TAU * hertz).powi(2);
        let damping = 0.2 * (inertia * stiffness).sqrt();
        all.push(Candidate {
            effect: Effect::new(K::Compliance, &[stiffness, damping, inertia]),
            size: 1.0,
        });
    }
    let seen_by_none = |k: K| {
        matches!(
            k,
            K::DeadTime | K::ControlDelay | K::SupplySag | K::Backlash | K::Compliance
        )
    };
    all.retain(|c| {
        let kind = c.effect.kind;
        !child.effects.iter().any(|e| e.kind == kind) && (!told.torque || seen_by_none(kind))
    });
    all
}

/// Changes of the angle of a piece of a recording [rad], and its supply as [`SUPPLY`] says, measured and by model.
struct Piece {
    proves: bool,
    /// measured less simulated
    gap: Vec<f64>,
    /// what each other model's differ by from the first's, over the difference in its parameter
    slopes: Vec<Vec<f64>>,
}

/// How far constants may be off: one sigma each, and how many of them at most.
struct Belief {
    sd: Vec<f64>,
    furthest: f64,
}

/// Sizes of constants (logarithms of factors) and of an effect, its standard deviation, and the squared gap that is left on what
/// proves, and that of all of it but the piece in which most is left.
struct Solved {
    x: DVector<f64>,
    sd: f64,
    left: f64,
    elsewhere: f64,
}

/// A candidate, its value with the standard deviation, and the squared gap that is left on what proves.
struct Followed<'a> {
    candidate: &'a Candidate,
    value: f64,
    sd: f64,
    left: f64,
}

/// An effect that the simulated loop shows.
#[derive(Clone, Debug, PartialEq)]
pub struct OfMotion {
    /// the effect
    pub beside: Beside,
    /// the loop with it moves as was measured
    pub settles: bool,
}

/// What a simulated loop says of effects.
#[derive(Clone, Debug, PartialEq)]
pub enum Shown {
    /// nothing that constants do not explain, or nothing to look at
    Nothing,
    /// something without a name: the speed that constants leave, rms [rad/s]
    Stranger(f64),
    Effect(OfMotion),
}

/// What the simulated loop shows to be missing: an effect, where one takes most of the gap to the measured angle, and supply, on held-out
/// runs and no other does.
///
/// * `child` the actuator with what was found
/// * `told` what equations tell
///
/// # Errors
/// Refuses files that cannot be read.
pub fn scan(bench: &Bench, child: &ActuatorParameters, told: &Told) -> Result<Shown> {
    if !bench.own || !bench.runs.iter().any(|r| r.role == Role::HeldOut) {
        return Ok(Shown::Nothing);
    }
    let sd: Vec<f64> = knobs()
        .iter()
        .map(|k| {
            let of = told.constants.iter().find(|t| t.0 == k.name);
            of.map_or(LOOSE * k.sd, |t| (TOLD * t.1).clamp(LEAST_TOLD, LOOSE * k.sd))
        })
        .collect();
    let believed = Belief {
        sd,
        furthest: if told.torque { FURTHEST } else { f64::INFINITY },
    };
    let (all, _) = verify::recordings(bench, &[Role::Fit, Role::Select, Role::HeldOut])?;
    let n = knobs().len();
    // as near as constants come
    let mut turned = DVector::zeros(n);
    let mut constants = None;
    for _ in 0..UNTIL_CONSTANT {
        let pieces = compared(bench, &all, child, &turned, &[]);
        if pieces.iter().filter(|p| !p.proves).count() < 3 || !pieces.iter().any(|p| p.proves) {
            return Ok(Shown::Nothing);
        }
        let Some(now) = solved(&pieces, &believed, &turned, None) else {
            return Ok(Shown::Nothing);
        };
        if quiets(now.left) < 1.0 {
            return Ok(Shown::Nothing);
        }
        turned += &now.x;
        constants = Some((now.left, now.elsewhere));
    }
    let Some((constants, elsewhere)) = constants else {
        return Ok(Shown::Nothing);
    };
    let strange = quiets(constants) > STRANGE && quiets(elsewhere) > STRANGE_ELSEWHERE;
    let nameless = if strange {
        Shown::Stranger(constants.sqrt() / MEAN_S)
    } else {
        Shown::Nothing
    };
    let tried = candidates(child, told);
    let pieces = compared(bench, &all, child, &turned, &tried);
    let mut ranked: Vec<(usize, Solved)> = (0..tried.len())
        .filter_map(|c| Some((c, solved(&pieces, &believed, &turned, Some(n + c))?)))
        // what physics does not allow explains nothing
        .filter(|(c, s)| s.x[n] > 0.0 || tried[*c].effect.kind.keys()[0].low < 0.0)
        .collect();
    ranked.sort_by(|a, b| a.1.left.total_cmp(&b.1.left));
    // the best of each kind; each about what it found
    let mut kinds: Vec<Followed> = Vec::new();
    for (c, first) in &ranked {
        let candidate = &tried[*c];
        let kind = candidate.effect.kind;
        if kinds.len() == LOOKED_INTO {
            break;
        }
        if kinds.iter().any(|k| k.candidate.effect.kind == kind) {
            continue;
        }
        kinds.extend(match kind {
            EffectKind::Compliance => Some(Followed {
                candidate,
                value: first.x[n],
                sd: first.sd,
                left: first.left,
            }),
            _ => followed(bench, &all, child, (&believed, &turned), candidate, first.x[n]),
        });
    }
    kinds.sort_by(|a, b| a.left.total_cmp(&b.left));
    let mut kinds = kinds.into_iter();
    let Some(mut best) = kinds.next() else {
        return Ok(nameless);
    };
    // what leaves more than would be strange by itself, and not nearly nothing of a great gap, is the nearest relative of something else
    let nearly_all = |left: f64| left < (1.0 - NEARLY_ALL) * constants;
    let rests = |left: f64| quiets(left) < 2.0 * STRANGE || nearly_all(left);
    for _ in 0..FOLLOWED_ON {
        if rests(best.left) || best.candidate.effect.kind == EffectKind::Compliance {
            break;
        }
        let further = followed(bench, &all, child, (&believed, &turned), best.candidate, best.value);
        let Some(further) = further.filter(|f| f.left < best.left) else {
            break;
        };
        best = further;
    }
    let (effect, left) = (&best.candidate.effect, best.left);
    let kind = effect.kind;
    let apart = kinds.next().is_none_or(|rival| rival.left > APART * left);
    let takes = left < (1.0 - LEAST_SHARE) * constants;
    let settles = quiets(left) < 1.0;
    let is_certain = best.value.abs()
        > if settles && nearly_all(left) {
            CERTAIN_AT_REST
        } else {
            CERTAIN
        } * best.sd;
    if kind == EffectKind::Compliance || !(apart && takes && rests(left) && is_certain) {
        return Ok(nameless);
    }
    let rms = (constants.sqrt() / MEAN_S, left.sqrt() / MEAN_S);
    let seen = (
        "speed of the measured angle, and supply, against the simulated loop's",
        "rad/s",
    );
    // what is left where the loop does not rest is the effect's own law for all that is known
    let of_law = if settles {
        0.0
    } else {
        best.value * (left / constants).sqrt()
    };
    let mut beside = found(kind, (best.value, best.sd.hypot(of_law)), seen, rms);
    beside.law = effect.law;
    beside.second = (kind == EffectKind::TurnShort).then_some(effect.values[1]);
    Ok(Shown::Effect(OfMotion { beside, settles }))
}

/// Gap in units of [`QUIET`], from the squared gap as [`solved`] leaves it.
fn quiets(left: f64) -> f64 {
    left.sqrt() / (QUIET * MEAN_S)
}

/// A candidate after some rounds about what it found.
///
/// * `believed`, `turned` how far constants may be off, and where they are
fn followed<'a>(
    bench: &Bench,
    all: &[OfRuns<'_>],
    child: &ActuatorParameters,
    (believed, turned): (&Belief, &DVector<f64>),
    candidate: &'a Candidate,
    first: f64,
) -> Option<Followed<'a>> {
    let n = turned.len();
    let key = &candidate.effect.kind.keys()[0];
    let (mut turned, mut value) = (turned.clone(), first.clamp(key.low, key.high));
    let mut last = None;
    for _ in 0..=ROUNDS {
        let mut with = child.clone();
        with.effects.push(candidate.with(value));
        let more = NEARBY * value;
        let moved = [Candidate {
            effect: candidate.with(value + more),
            size: more,
        }];
        let now = solved(
            &compared(bench, all, &with, &turned, &moved),
            believed,
            &turned,
            Some(n),
        )?;
        turned += now.x.rows(0, n);
        // a long step goes by slopes that no longer hold
        let step = now.x[n].clamp(-LONGEST * value.abs(), LONGEST * value.abs());
        value = (value + step).clamp(key.low, key.high);
        last = Some(Followed {
            candidate,
            value,
            sd: now.sd,
            left: now.left,
        });
    }
    last
}

/// The recordings piece by piece, with slopes of all constants and of the candidates.
///
/// * `turned` logarithms of the constants' factors
fn compared(
    bench: &Bench,
    all: &[OfRuns<'_>],
    child: &ActuatorParameters,
    turned: &DVector<f64>,
    tried: &[Candidate],
) -> Vec<Piece> {
    let turned = knobs::about(child, &knobs(), turned);
    let base = turned[0].clone();
    let mut over = vec![1.0];
    over.resize(turned.len(), STEP);
    over.extend(tried.iter().map(|c| c.size));
    let mut models = turned;
    models.extend(tried.iter().map(|c| {
        let mut p = base.clone();
        p.effects.retain(|e| e.kind != c.effect.kind);
        p.effects.push(c.effect.clone());
        p
    }));
    let mut out = Vec::new();
    for (runs, recorded) in all {
        let simulated: Vec<Simulated> = models
            .chunks(AT_ONCE)
            .flat_map(|some| verify::driven::<AT_ONCE>(bench, recorded, some))
            .collect();
        let angle = BenchChannel::Position;
        let has_supply = recorded.measured.contains_key(&BenchChannel::VDc);
        let step = ((MEAN_S / (recorded.time_s[1] - recorded.time_s[0])).round() as usize).max(1);
        for run in runs {
            for part in recorded.parts(&recorded.samples_of(run), PIECE_S) {
                let of = |x: &[f64]| -> Vec<f64> { part.iter().step_by(step).map(|&k| x[k]).collect() };
                let changes = |x: &[f64]| -> Vec<f64> { of(x).windows(2).map(|w| w[1] - w[0]).collect() };
                let means = |x: &[f64]| -> Vec<f64> {
                    let mean = |p: &[usize]| p.iter().map(|&k| x[k]).sum::<f64>() / p.len() as f64;
                    part.chunks_exact(step).map(|p| SUPPLY * mean(p)).collect()
                };
                // changes of the angle, and the supply where it is recorded
                let seen = |of: &BTreeMap<BenchChannel, Vec<f64>>| -> Vec<f64> {
                    let mut out = changes(&of[&angle]);
                    if let (Some(x), true) = (of.get(&BenchChannel::VDc), has_supply) {
                        out.extend(means(x));
                    }
                    out
                };
                let base = seen(&simulated[0]);
                let less = |y: Vec<f64>, over: f64| y.iter().zip(&base).map(|(y, b)| (y - b) / over).collect();
                out.push(Piece {
                    proves: run.role == Role::HeldOut,
                    gap: less(seen(&recorded.measured), 1.0),
                    slopes: (1..models.len()).map(|m| less(seen(&simulated[m]), over[m])).collect(),
                });
            }
        }
    }
    out
}

/// Constants, and one candidate if any, that fit the pieces that find.
///
/// * `believed` how far constants may be off 0; `turned` where they are
/// * `with` place of the candidate's slopes
fn solved(pieces: &[Piece], believed: &Belief, turned: &DVector<f64>, with: Option<usize>) -> Option<Solved> {
    let columns: Vec<usize> = (0..believed.sd.len()).chain(with).collect();
    let finds: Vec<&Piece> = pieces.iter().filter(|p| !p.proves).collect();
    let m = columns.len();
    let left_of = |p: &Piece, x: &DVector<f64>, t: usize| {
        p.gap[t]
            - columns
                .iter()
                .enumerate()
                .map(|(i, c)| x[i] * p.slopes[*c][t])
                .sum::<f64>()
    };
    // normal equations of each piece, about what is left of it
    let about = |x: &DVector<f64>| -> Vec<(DMatrix<f64>, DVector<f64>)> {
        let left = |p: &&Piece| -> Vec<f64> { (0..p.gap.len()).map(|t| left_of(p, x, t)).collect() };
        let left: Vec<Vec<f64>> = finds.iter().map(left).collect();
        let usual = knobs::usual(left.iter().flatten().map(|g| g.abs()).collect()).max(1e-300);
        let of = |(p, left): (&&Piece, &Vec<f64>)| {
            let (mut gram, mut right) = (DMatrix::zeros(m, m), DVector::zeros(m));
            for (t, left) in left.iter().enumerate() {
                let w = knobs::weight(*left, usual) / (usual * usual);
                let row = DVector::from_iterator(m, columns.iter().map(|c| p.slopes[*c][t]));
                gram += w * &row * row.transpose();
                right += w * p.gap[t] * row;
            }
            (gram, right)
        };
        finds.iter().zip(&left).map(of).collect()
    };
    let step = |sums: &[(DMatrix<f64>, DVector<f64>)], out: Option<usize>| {
        let kept = || sums.iter().enumerate().filter(|(k, _)| Some(*k) != out);
        let mut gram: DMatrix<f64> = kept().map(|s| &s.1.0).sum();
        let mut right: DVector<f64> = kept().map(|s| &s.1.1).sum();
        for (i, sd) in believed.sd.iter().enumerate() {
            let belief = sd.powi(-2);
            gram[(i, i)] += belief;
            right[i] -= turned[i] * belief;
        }
        within(&gram, &right, believed, turned)
    };
    let (mut x, mut sums) = (DVector::zeros(m), Vec::new());
    for _ in 0..REWEIGHTED {
        sums = about(&x);
        x = step(&sums, None)?;
    }
    let without = with.map_or(Vec::new(), |_| {
        (0..finds.len())
            .filter_map(|k| Some(step(&sums, Some(k))?[m - 1]))
            .collect()
    });
    let sd = scatter(without.into_iter(), x[m - 1]);
    let square = |p: &Piece| (0..p.gap.len()).map(|t| left_of(p, &x, t).powi(2)).sum::<f64>();
    let mut proves: Vec<(f64, usize)> = pieces
        .iter()
        .filter(|p| p.proves)
        .map(|p| (square(p), p.gap.len()))
        .collect();
    proves.sort_by(|a, b| b.0.total_cmp(&a.0));
    let mean = |p: &[(f64, usize)]| {
        let (square, count) = p.iter().fold((0.0, 0), |(s, n), p| (s + p.0, n + p.1));
        square / count.max(1) as f64
    };
    let others = if proves.len() > 1 { &proves[1..] } else { &proves };
    Some(Solved {
        x,
        sd,
        left: mean(&proves),
        elsewhere: mean(others),
    })
}

/// Solution of normal equations whose constants stay within what is believed: where one would go beyond, it stands there.
fn within(gram: &DMatrix<f64>, right: &DVector<f64>, believed: &Belief, turned: &DVector<f64>) -> Option<DVector<f64>> {
    let (mut gram, mut right) = (gram.clone(), right.clone());
    let mut held = vec![false; believed.sd.len()];
    loop {
        let x = gram.clone().cholesky()?.solve(&right);
        let beyond = |i: usize| (turned[i] + x[i]).abs() / believed.sd[i];
        let furthest = (0..believed.sd.len()).filter(|i| !held[*i] && beyond(*i) > believed.furthest);
        let Some(i) = furthest.max_by(|a, b| beyond(*a).total_cmp(&beyond(*b))) else {
            return Some(x);
        };
        let at = believed.furthest * believed.sd[i] * (turned[i] + x[i]).signum() - turned[i];
        right -= at * gram.column(i);
        gram.row_mut(i).fill(0.0);
        gram.column_mut(i).fill(0.0);
        (gram[(i, i)], right[i], held[i]) = (1.0, at, true);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_piece_that_runs_apart_is_not_the_whole() {
        let n = knobs().len();
        let piece = |proves: bool, gap: f64| Piece {
            proves,
            gap: vec![gap; 4],
            slopes: vec![vec![0.0; 4]; n],
        };
        let believed = Belief {
            sd: vec![1.0; n],
            furthest: f64::INFINITY,
        };
        let finds = (0..3).map(|_| piece(false, 1.0));
        let all: Vec<Piece> = finds.chain([0.5, 10.0, 0.5].map(|g| piece(true, g))).collect();
        let s = solved(&all, &believed, &DVector::zeros(n), None).unwrap();
        assert!((s.elsewhere - 0.25).abs() < 1e-12 && (s.left - 100.5 / 3.0).abs() < 1e-9);
        // of a single one there is no elsewhere
        let s = solved(&all[..4], &believed, &DVector::zeros(n), None).unwrap();
        assert_eq!((s.left, s.elsewhere), (0.25, 0.25));
    }

    #[test]
    fn a_strong_gap_turns_no_constant_beyond_belief_and_the_effect_takes_the_rest() {
        // a constant and an effect that are nearly alike, of which the gap is 50 standard deviations of the constant
        let rows = [(1.0, 1.0, 0.5), (1.0, 0.8, 0.4), (0.1, 0.3, 0.15)];
        let (mut gram, mut right) = (DMatrix::zeros(2, 2), DVector::zeros(2));
        for (a, b, y) in rows {
            let row = DVector::from_vec(vec![a, b]);
            gram += &row * row.transpose() * 1e8;
            right += row * y * 1e8;
        }
        let sd = 0.01;
        let of = |furthest| Belief { sd: vec![sd], furthest };
        gram[(0, 0)] += 1.0 / (sd * sd);
        // wherever it stands, and whichever way it is drawn
        for (turned, drawn) in [(0.0, 0.0), (0.02, 1e8), (-0.02, -1e8)] {
            let mut right = right.clone();
            right[0] += drawn;
            let x = within(&gram, &right, &of(FURTHEST), &DVector::from_element(1, turned)).unwrap();
            assert!((turned + x[0]).abs() <= FURTHEST * sd * (1.0 + 1e-9), "{turned} {x}");
            // the effect is what fits with the constant where it stands
            let fits = (right[1] - gram[(1, 0)] * x[0]) / gram[(1, 1)];
            assert!((x[1] - fits).abs() < 1e-9, "{x} {fits}");
        }
        let free = gram.clone().cholesky().unwrap().solve(&right);
        let same = within(&gram, &right, &of(f64::INFINITY), &DVector::zeros(1)).unwrap();
        assert!((free - same).norm() < 1e-12);
    }
}
