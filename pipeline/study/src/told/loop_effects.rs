//! Effects that only the simulated loop shows. What the equations of torque and voltage cannot see, for want of a channel or under the
//! chatter of a current that is read at points, moves the motor all the same: the numerical test bench under the recorded command
//! comes to another angle than was measured, in the manner of that effect.

use crate::measured::bench::{Bench, BenchChannel, Role};
use crate::search::beside::{Beside, found, scatter};
use crate::told::scale::{KNOBS, Knob};
use crate::told::verify::{self, AT_ONCE, OfRuns, Simulated};
use nalgebra::{DMatrix, DVector};
use schemas::error::Result;
use sim_worker::effect::{Draw, Effect, EffectKind};
use sim_worker::parameters::ActuatorParameters;

/// Time over which the angle's change is one number [s] (assumed): a count of the angle is small beside it.
const MEAN_S: f64 = 4e-3;
/// Difference by which slopes of constants are taken, relative.
const STEP: f64 = 0.01;
/// Gaps beyond so many times their usual size count by their size, not by its square (assumed).
const USUAL: f64 = 3.0;
/// Pieces of a recording, each of which is left out once [s].
const PIECE_S: f64 = 1.0;
/// Share of the squared gap on held-out runs, constants re-tuned, that an effect must take, and how much more of it the next best
/// must leave (assumed).
const LEAST_SHARE: f64 = 0.6;
const APART: f64 = 1.5;
/// How much further constants may be off than they are believed to be (assumed: some were told by noisy equations).
const LOOSE: f64 = 2.0;
/// Standard deviations from which an effect is one (assumed).
const CERTAIN: f64 = 5.0;
/// Speed of the gap, rms, up to which nothing is looked for (assumed: without anything missing 0.03 to 0.14 was left) [rad/s].
const QUIET: f64 = 0.2;
/// Rounds about what was found, longest step of one over the value, and difference by which its slope is taken; kinds that are looked
/// into.
const ROUNDS: usize = 2;
const LONGEST: f64 = 0.6;
const NEARBY: f64 = 0.2;
const LOOKED_INTO: usize = 4;

/// Constants that the equations tell, beside those of [`KNOBS`].
const MECHANICS: [Knob; 3] = [
    Knob {
        name: "inertia",
        sd: 0.05,
        turn: |p, f| p.inertia_kg_m2 *= f,
    },
    Knob {
        name: "viscous",
        sd: 0.2,
        turn: |p, f| p.viscous_n_m_s_per_rad *= f,
    },
    Knob {
        name: "coulomb",
        sd: 0.1,
        turn: |p, f| p.static_friction_n_m *= f,
    },
];

fn knobs() -> impl Iterator<Item = &'static Knob> {
    KNOBS.iter().chain(&MECHANICS)
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

/// Effects that are tried, by sizes that are small.
fn candidates(child: &ActuatorParameters) -> Vec<Candidate> {
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
    all.extend(Draw::ALL.map(|draw| {
        let mut c = Candidate::of(K::SupplySag, 0.1);
        c.effect.draw = draw;
        c
    }));
    for sensor in 0..3 {
        for (kind, size) in [(K::CurrentGain, 0.02), (K::CurrentOffset, 0.05)] {
            let mut c = Candidate::of(kind, size);
            c.effect.sensor = Some(sensor);
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
    all.retain(|c| !child.effects.iter().any(|e| e.kind == c.effect.kind));
    all
}

/// Changes of the angle of a piece of a recording, measured and by model [rad].
struct Piece {
    proves: bool,
    /// measured less simulated
    gap: Vec<f64>,
    /// what each other model's differ by from the first's, over the difference in its parameter
    slopes: Vec<Vec<f64>>,
}

/// Sizes of constants (logarithms of factors) and of an effect, its standard deviation, and the squared gap that is left on what
/// proves.
struct Solved {
    x: DVector<f64>,
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

/// What the simulated loop shows to be missing, where one effect takes most of the gap to the measured angle on held-out runs and no
/// other does.
///
/// * `child` the actuator with what was found
///
/// # Errors
/// Refuses files that cannot be read.
pub fn scan(bench: &Bench, child: &ActuatorParameters) -> Result<Option<OfMotion>> {
    if !bench.own || !bench.runs.iter().any(|r| r.role == Role::HeldOut) {
        return Ok(None);
    }
    let (all, _) = verify::recordings(bench, &[Role::Fit, Role::Select, Role::HeldOut])?;
    let n = knobs().count();
    // as near as constants come
    let mut turned = DVector::zeros(n);
    let mut constants = None;
    for _ in 0..ROUNDS {
        let pieces = compared(bench, &all, child, &turned, &[]);
        if pieces.iter().filter(|p| !p.proves).count() < 3 || !pieces.iter().any(|p| p.proves) {
            return Ok(None);
        }
        let Some(now) = solved(&pieces, &turned, None) else {
            return Ok(None);
        };
        if now.left.sqrt() < QUIET * MEAN_S {
            return Ok(None);
        }
        turned += &now.x;
        constants = Some(now.left);
    }
    let Some(constants) = constants else { return Ok(None) };
    let tried = candidates(child);
    let pieces = compared(bench, &all, child, &turned, &tried);
    let mut ranked: Vec<(usize, Solved)> = (0..tried.len())
        .filter_map(|c| Some((c, solved(&pieces, &turned, Some(n + c))?)))
        // what physics does not allow explains nothing
        .filter(|(c, s)| s.x[n] > 0.0 || tried[*c].effect.kind.keys()[0].low < 0.0)
        .collect();
    ranked.sort_by(|a, b| a.1.left.total_cmp(&b.1.left));
    // the best of each kind; each about what it found
    let mut kinds: Vec<(usize, f64, f64, f64)> = Vec::new();
    for (c, first) in &ranked {
        let kind = tried[*c].effect.kind;
        if kinds.len() == LOOKED_INTO {
            break;
        }
        if kinds.iter().any(|k| tried[k.0].effect.kind == kind) {
            continue;
        }
        let (value, sd, left) = match kind {
            EffectKind::Compliance => (first.x[n], first.sd, first.left),
            _ => match about(bench, &all, child, &turned, &tried[*c], first.x[n]) {
                Some(found) => found,
                None => continue,
            },
        };
        kinds.push((*c, value, sd, left));
    }
    kinds.sort_by(|a, b| a.3.total_cmp(&b.3));
    let Some(&(best, value, sd, left)) = kinds.first() else {
        return Ok(None);
    };
    let candidate = &tried[best];
    let kind = candidate.effect.kind;
    let apart = kinds.get(1).is_none_or(|rival| rival.3 > APART * left);
    let takes = left < (1.0 - LEAST_SHARE) * constants;
    if kind == EffectKind::Compliance || !apart || !takes || value.abs() < CERTAIN * sd {
        return Ok(None);
    }
    let rms = (constants.sqrt() / MEAN_S, left.sqrt() / MEAN_S);
    let seen = ("speed of the measured angle against the simulated loop's", "rad/s");
    let mut beside = found(kind, (value, sd), seen, rms);
    beside.sensor = candidate.effect.sensor;
    beside.draw = candidate.effect.draw;
    beside.second = (kind == EffectKind::TurnShort).then(|| candidate.effect.values[1]);
    let settles = left.sqrt() < QUIET * MEAN_S;
    Ok(Some(OfMotion { beside, settles }))
}

/// Value, standard deviation and squared gap left on what proves, of one candidate after some rounds about what it found.
fn about(
    bench: &Bench,
    all: &[OfRuns<'_>],
    child: &ActuatorParameters,
    turned: &DVector<f64>,
    candidate: &Candidate,
    first: f64,
) -> Option<(f64, f64, f64)> {
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
        let now = solved(&compared(bench, all, &with, &turned, &moved), &turned, Some(n))?;
        turned += now.x.rows(0, n);
        // a long step goes by slopes that no longer hold
        let step = now.x[n].clamp(-LONGEST * value.abs(), LONGEST * value.abs());
        value = (value + step).clamp(key.low, key.high);
        last = Some((value, now.sd, now.left));
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
    let near = |moved: Option<usize>| {
        let mut p = child.clone();
        for (i, k) in knobs().enumerate() {
            let more = if moved == Some(i) { STEP } else { 0.0 };
            (k.turn)(&mut p, (turned[i] + more).exp());
        }
        p
    };
    let n = knobs().count();
    let mut models = vec![(near(None), 1.0)];
    models.extend((0..n).map(|k| (near(Some(k)), STEP)));
    models.extend(tried.iter().map(|c| {
        let mut p = near(None);
        p.effects.retain(|e| e.kind != c.effect.kind);
        p.effects.push(c.effect.clone());
        (p, c.size)
    }));
    let mut out = Vec::new();
    for (runs, recorded) in all {
        let simulated: Vec<Simulated> = models
            .chunks(AT_ONCE)
            .flat_map(|some| {
                let some: Vec<ActuatorParameters> = some.iter().map(|m| m.0.clone()).collect();
                verify::driven::<AT_ONCE>(bench, recorded, &some)
            })
            .collect();
        let angle = BenchChannel::Position;
        let measured = &recorded.measured[&angle];
        let step = ((MEAN_S / (recorded.time_s[1] - recorded.time_s[0])).round() as usize).max(1);
        for run in runs {
            for part in recorded.parts(&recorded.samples_of(run), PIECE_S) {
                let of = |x: &[f64]| -> Vec<f64> { part.iter().step_by(step).map(|&k| x[k]).collect() };
                let changes = |x: &[f64]| -> Vec<f64> { of(x).windows(2).map(|w| w[1] - w[0]).collect() };
                let base = changes(&simulated[0][&angle]);
                let less = |y: Vec<f64>, over: f64| y.iter().zip(&base).map(|(y, b)| (y - b) / over).collect();
                out.push(Piece {
                    proves: run.role == Role::HeldOut,
                    gap: less(changes(measured), 1.0),
                    slopes: (1..models.len())
                        .map(|m| less(changes(&simulated[m][&angle]), models[m].1))
                        .collect(),
                });
            }
        }
    }
    out
}

/// Constants, and one candidate if any, that fit the pieces that find.
///
/// * `turned` where the constants are: they are believed to be near 0
/// * `with` place of the candidate's slopes
fn solved(pieces: &[Piece], turned: &DVector<f64>, with: Option<usize>) -> Option<Solved> {
    let n = knobs().count();
    let columns: Vec<usize> = (0..n).chain(with).collect();
    let finds: Vec<&Piece> = pieces.iter().filter(|p| !p.proves).collect();
    let m = columns.len();
    let mut x = DVector::zeros(m);
    let left_of = |p: &Piece, x: &DVector<f64>, t: usize| {
        p.gap[t]
            - columns
                .iter()
                .enumerate()
                .map(|(i, c)| x[i] * p.slopes[*c][t])
                .sum::<f64>()
    };
    let sizes = |x: &DVector<f64>, of: &[&Piece]| -> f64 {
        let mut all: Vec<f64> = of
            .iter()
            .flat_map(|p| (0..p.gap.len()).map(|t| left_of(p, x, t).abs()))
            .collect();
        let middle = all.len() / 2;
        match all.get(middle) {
            Some(_) => 1.4826 * *all.select_nth_unstable_by(middle, f64::total_cmp).1,
            None => 0.0,
        }
    };
    let mut sd = 0.0;
    for _ in 0..4 {
        let usual = sizes(&x, &finds).max(1e-300);
        let weight = |gap: f64| (USUAL * usual / gap.abs().max(1e-300)).min(1.0);
        let sums: Vec<(DMatrix<f64>, DVector<f64>)> = finds
            .iter()
            .map(|p| {
                let (mut gram, mut right) = (DMatrix::zeros(m, m), DVector::zeros(m));
                for t in 0..p.gap.len() {
                    let w = weight(left_of(p, &x, t)) / (usual * usual);
                    let row = DVector::from_iterator(m, columns.iter().map(|c| p.slopes[*c][t]));
                    gram += w * &row * row.transpose();
                    right += w * p.gap[t] * row;
                }
                (gram, right)
            })
            .collect();
        let step = |out: Option<usize>| {
            let kept = || sums.iter().enumerate().filter(|(k, _)| Some(*k) != out);
            let mut gram: DMatrix<f64> = kept().map(|s| &s.1.0).sum();
            let mut right: DVector<f64> = kept().map(|s| &s.1.1).sum();
            for (i, k) in knobs().enumerate() {
                let belief = (LOOSE * k.sd).powi(-2);
                gram[(i, i)] += belief;
                right[i] -= turned[i] * belief;
            }
            gram.cholesky().map(|g| g.solve(&right))
        };
        x = step(None)?;
        if with.is_some() {
            let without = (0..finds.len()).filter_map(|k| Some(step(Some(k))?[m - 1]));
            let without: Vec<f64> = without.collect();
            sd = scatter(without.into_iter(), x[m - 1]);
        }
    }
    let proves = || pieces.iter().filter(|p| p.proves);
    let count: usize = proves().map(|p| p.gap.len()).sum();
    let left = proves()
        .map(|p| (0..p.gap.len()).map(|t| left_of(p, &x, t).powi(2)).sum::<f64>())
        .sum::<f64>()
        / count.max(1) as f64;
    Some(Solved { x, sd, left })
}
