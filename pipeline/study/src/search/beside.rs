//! Effects that the equations of torque and voltage cannot show, because measured currents already have them in: what the
//! drive does with its angle, what its sensors add up to, what a strong current gives, and what the
//! constants say together. Of recordings of our own actuator with three phases; each by itself, on the fit runs, proven on
//! the held-out ones.

mod one_cause;
mod strong;

use crate::equations::nuisances::Nuisance;
use crate::equations::phases::Phases;
use crate::equations::pieces::RigConstants;
use crate::equations::problem::Problem;
use crate::equations::signals::Signals;
use crate::measured::bench::{BenchChannel, Role};
use crate::measured::recording::Run;
use crate::measured::sums::{Sums, jackknife, scatter};
use crate::search::fit::{self, Fit, Term};
use crate::search::select::Material;
use sim_worker::effect::{EffectKind, Equation, Law, NORMAL_95, conducting};

pub use one_cause::together;
use strong::{MOST_LEFT, saturation, strong_currents};

/// An effect that was found beside the equations.
#[derive(Clone, Debug, PartialEq)]
pub struct Beside {
    /// which effect
    pub kind: EffectKind,
    /// its one parameter, SI as in the list of effects
    pub value: f64,
    /// half-width of its 95 % interval
    pub half: f64,
    /// which law of its kind it follows
    pub law: Law,
    /// its second parameter, where it has one
    pub second: Option<f64>,
    /// what it is seen in
    pub seen_in: &'static str,
    /// of `before` and `after`
    pub unit: &'static str,
    /// rms of what is seen without it and with it, on the runs that prove
    pub before: f64,
    pub after: f64,
    /// kinds that the data cannot tell from it
    pub ambiguous: Vec<EffectKind>,
    /// names of constants, and what each is to be multiplied with where the effect stands beside it
    pub factors: Vec<(&'static str, f64)>,
}

/// Standard deviations from which an estimate is an effect, and share of the squared gap that it must take on the runs
/// that prove (assumed).
const CERTAIN: f64 = 5.0;
const LEAST_SHARE: f64 = 0.1;
/// Least angle of the commutation [electrical rad], and offset of a phase over what its sensor is believed to have, that matter
/// (assumed).
const LEAST_ANGLE: f64 = 0.03;
const LEAST_OFFSET: f64 = 5.0;
/// Current over the noise of its sensor from which its pattern counts, and way in a sample up to which it is a pattern
/// [electrical rad] (assumed).
const CLEAR: f64 = 12.0;
const MOST_SWEEP: f64 = 0.4;
/// Runs of a problem with their signals.
fn runs<'a>(m: &'a Material, p: &'a Problem, held: bool) -> Vec<(&'a Run, &'a Signals)> {
    let of = |r: &&Run| {
        if held {
            r.role == Role::HeldOut
        } else {
            matches!(r.role, Role::Fit | Role::Select)
        }
    };
    m.runs.iter().filter(of).zip(&p.signals).collect()
}

/// What is found beside the equations: of an actuator of ours with phases, and what the constants of a rig say together. And
/// whether strong currents do what nothing of it explains: a load that comes loose, say, which only a sensor of its own shows.
///
/// * `first` the nuisance parameters around the model's own constants
pub fn beside(m: &Material, model: &Fit, first: &[Nuisance]) -> (Vec<Beside>, bool) {
    let apart = |b: &Beside| !model.has(b.kind);
    let phases = m.bench.has_phases();
    if !phases && m.equations.contains(&Equation::Electrical) {
        return (together(m, model, first).into_iter().filter(apart).collect(), false);
    }
    if !(m.bench.own && phases) {
        return (Vec::new(), false);
    }
    let find = runs(m, &m.fit, false);
    let prove = m.held.as_ref().map_or_else(|| find.clone(), |h| runs(m, h, true));
    let both = [&find[..], &prove[..]];
    let strong = strong_currents(m, model, both);
    let loss = strong.as_ref().and_then(saturation);
    let stranger = loss.is_none() && strong.is_some_and(|s| s.rms.0.min(s.rms.1) > MOST_LEFT);
    let all = [commutation(m, both), offset(m, model, both), loss]
        .into_iter()
        .flatten()
        .chain(together(m, model, first))
        // what the equations have told already is not told twice
        .filter(apart)
        .collect();
    (all, stranger)
}

type Both<'a> = [&'a [(&'a Run, &'a Signals)]; 2];

/// Most that a cogging may be over the torque that an offset of a phase seems to give, to be nothing but that (assumed).
const AS_OF_OFFSET: f64 = 1.6;

/// Whether what was found beside the equations makes the term, which then is no effect of its own.
pub fn makes(found: &Beside, t: &Term, c: &RigConstants) -> bool {
    match (found.kind, t.kind) {
        // a bridge that commutates too late one way does so too early the other way: its torque looks like a friction that goes by
        // direction
        (EffectKind::CommutationOffset, EffectKind::ViscousAsymmetry) => true,
        // a phase whose sensor says too much seems to give torque with its own shape, once a period of the current
        (EffectKind::CurrentOffset, EffectKind::Cogging) => {
            let torque = 0.5 * c.effect.torque_constant * found.value;
            let once = (t.shape[0] / c.effect.pole_pairs - 1.0).abs() < 0.01;
            once && t.amplitudes[0].hypot(t.amplitudes[1]) < AS_OF_OFFSET * torque.abs()
        }
        _ => false,
    }
}

fn noise_of(m: &Material, c: BenchChannel) -> f64 {
    m.noise.get(&c).map_or(0.0, |n| n.rms)
}

/// Nothing that cannot be told from it, in no sensor.
///
/// * `seen_in` with the unit of `rms`, which is without it and with it
pub fn found(
    kind: EffectKind,
    (value, sd): (f64, f64),
    seen_in: (&'static str, &'static str),
    rms: (f64, f64),
) -> Beside {
    Beside {
        kind,
        value,
        half: NORMAL_95 * sd,
        law: Law::First,
        second: None,
        seen_in: seen_in.0,
        unit: seen_in.1,
        before: rms.0,
        after: rms.1,
        ambiguous: Vec::new(),
        factors: Vec::new(),
    }
}

/// Whether it is far from nothing, and takes its share of the gap on the runs that prove.
fn holds(value: f64, sd: f64, least: f64, before: f64, after: f64) -> bool {
    value.abs() > CERTAIN * sd && value.abs() > least && after * after < (1.0 - LEAST_SHARE) * before * before
}

/// A run's samples that show which phase conducts: currents clear of their noise and hardly changing, a short way.
fn clear<'a>(m: &Material, s: &'a Signals) -> Option<(&'a Signals, &'a Phases, Vec<usize>)> {
    let p = s.phases.as_ref()?;
    let least = CLEAR * noise_of(m, BenchChannel::CurrentA).max(1e-9);
    let shows = |k: &usize| {
        let (k, size) = (*k, p.size(*k));
        let steady = (p.size(k + 1) - p.size(k - 1)).abs() < 0.4 * size;
        let sweep = s.omega[k] / s.rate_hz * p.pole_pairs;
        size >= least && steady && sweep.abs() <= MOST_SWEEP && !s.stepping[k]
    };
    let all = (1..s.n.saturating_sub(1)).step_by(3);
    Some((s, p, all.filter(shows).collect()))
}

/// Squared gap of the phase currents to the pattern that a commutation off by `angle` asks for, over that of the currents
/// themselves, so that all speeds count alike; summed over the samples of a run.
fn pattern_gap((s, p, samples): &(&Signals, &Phases, Vec<usize>), angle: f64) -> f64 {
    let of = |k: &usize| {
        let i: [f64; 3] = std::array::from_fn(|q| p.current[q][*k]);
        let sweep = s.omega[*k] / s.rate_hz;
        let mut shape = [0.0; 3];
        for j in 0..6 {
            let theta = s.theta[*k] + sweep * ((j as f64 + 0.5) / 6.0 - 0.5) + angle / p.pole_pairs;
            let on = conducting(theta, p.pole_pairs);
            (0..3).for_each(|q| shape[q] += on[q] / 6.0);
        }
        let dot = |a: &[f64; 3], b: &[f64; 3]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
        let (ii, ir, rr) = (dot(&i, &i), dot(&i, &shape), dot(&shape, &shape));
        (ii - ir * ir / rr.max(1e-12)).max(0.0) / ii
    };
    samples.iter().map(of).sum()
}

/// The drive's angle: which phase conducts where.
fn commutation(m: &Material, [find, prove]: Both) -> Option<Beside> {
    const STEP: f64 = 0.05;
    let grid: Vec<f64> = (-20..=20).map(|j| STEP * f64::from(j)).collect();
    let [find, prove] = [find, prove].map(|runs| runs.iter().filter_map(|(_, s)| clear(m, s)).collect::<Vec<_>>());
    let costs: Vec<Vec<f64>> = find
        .iter()
        .map(|run| grid.iter().map(|a| pattern_gap(run, *a)).collect())
        .collect();
    // the least of a parabola through the least and its neighbours
    let least = |without: Option<usize>| -> Option<f64> {
        let of = |j: usize| {
            costs
                .iter()
                .enumerate()
                .filter(|(r, _)| Some(*r) != without)
                .map(|(_, c)| c[j])
                .sum()
        };
        let all: Vec<f64> = (0..grid.len()).map(of).collect();
        let j = (1..grid.len() - 1).min_by(|a, b| all[*a].total_cmp(&all[*b]))?;
        let (a, b, c) = (all[j - 1], all[j], all[j + 1]);
        let bend = a - 2.0 * b + c;
        (bend > 0.0).then(|| grid[j] + (0.5 * STEP * (a - c) / bend).clamp(-STEP, STEP))
    };
    let value = least(None)?;
    let without: Vec<f64> = (0..costs.len()).filter_map(|r| least(Some(r))).collect();
    if without.len() < 3 {
        return None;
    }
    // the pattern's edges are known to a part of the way in a sample
    let sd = scatter(without.into_iter(), value).max(LEAST_ANGLE / CERTAIN / 2.0);
    let count = prove.iter().map(|run| run.2.len()).sum::<usize>().max(1) as f64;
    let rms = |angle: f64| (prove.iter().map(|run| pattern_gap(run, angle)).sum::<f64>() / count).sqrt();
    let (before, after) = (rms(0.0), rms(value));
    let seen = (
        "phase currents against the pattern of their angle, over the current",
        "-",
    );
    holds(value, sd, LEAST_ANGLE, before, after)
        .then(|| found(EffectKind::CommutationOffset, (value, sd), seen, (before, after)))
}

/// What the phase currents add up to, which is nothing but the offsets of their sensors.
fn offset(m: &Material, model: &Fit, [find, prove]: Both) -> Option<Beside> {
    let spec = m.bench.channel(BenchChannel::CurrentA)?;
    let of_one = spec.offset.unwrap_or(noise_of(m, BenchChannel::CurrentA));
    let sums = |s: &Signals| -> Sums {
        let Some(p) = &s.phases else { return Sums::default() };
        // means over stretches, whose noise is small
        (0..s.n / 50).fold(Sums::default(), |all, block| {
            let mean = (50 * block..50 * (block + 1))
                .map(|k| (0..3).map(|q| p.current[q][k]).sum::<f64>())
                .sum::<f64>()
                / 50.0;
            all.plus(&Sums {
                xx: 1.0,
                xy: mean,
                yy: mean * mean,
                rows: 1.0,
            })
        })
    };
    let of = |runs: &[(&Run, &Signals)]| -> Vec<Sums> { runs.iter().map(|(_, s)| sums(s)).collect() };
    let (value, sd) = jackknife(&of(find))?;
    let proof = Sums::all(&of(prove));
    let (before, after) = (proof.rms(0.0), proof.rms(value));
    // the sensors' usual ones are a part of the sum; what stands in one sensor alone is held against what one has
    let stands = |usual: f64| holds(value, sd.hypot(usual), LEAST_OFFSET * usual, before, after);
    let of_all = of_one * 3f64.sqrt();
    if !stands(of_one) {
        return None;
    }
    let sensor = sensor_of(m, model, find, value);
    let seen = ("sum of the phase currents", "A");
    (sensor.is_some() || stands(of_all)).then(|| Beside {
        law: sensor.map_or(Law::First, Law::Phase),
        ..found(
            EffectKind::CurrentOffset,
            (value, sd.hypot(of_all)),
            seen,
            (before, after),
        )
    })
}

/// Share of an offset by which its phase stands out, and which no other phase may reach (assumed).
const STANDS_OUT: f64 = 2.0 / 3.0;

/// The phase whose sensor has an offset: its voltage drives less than it shows through the resistance, or more. `None` where
/// voltages are not measured or more than one sensor has its part.
fn sensor_of(m: &Material, model: &Fit, find: &[(&Run, &Signals)], offset: f64) -> Option<usize> {
    let (r, ke) = (
        0.5 * fit::constant(&m.nuisances, model, "resistance"),
        0.5 * fit::constant(&m.nuisances, model, "torque_constant"),
    );
    let (mut sums, mut count) = ([0.0; 3], 0.0);
    for (_, s) in find {
        let p = s.phases.as_ref()?;
        let v = p.voltage.as_ref()?;
        for (q, sum) in sums.iter_mut().enumerate() {
            // what the inductance takes is nothing in the mean
            let emf = p.back_emf(s, q);
            *sum += (0..s.n)
                .map(|k| p.current[q][k] - (v[q][k] - ke * emf[k]) / r)
                .sum::<f64>();
        }
        count += s.n as f64;
    }
    let share = sums.map(|sum| sum / count / offset);
    let most = (0..3).max_by(|a, b| share[*a].total_cmp(&share[*b]))?;
    let alone = (0..3).all(|q| q == most || share[q].abs() < 1.0 - STANDS_OUT);
    (share[most] > STANDS_OUT && alone).then_some(most)
}
