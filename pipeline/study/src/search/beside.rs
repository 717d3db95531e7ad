//! Effects that the equations of torque and voltage cannot show, because measured currents already have them in: what the
//! drive does with its angle, what its sensors add up to, what a strong current gives, and what the
//! constants say together. Of recordings of our own actuator with three phases; each by itself, on the fit runs, proven on
//! the held-out ones.

use crate::equations::nuisances::Nuisance;
use crate::equations::phases::Phases;
use crate::equations::pieces::RigConstants;
use crate::equations::problem::Problem;
use crate::equations::signals::Signals;
use crate::measured::bench::{BenchChannel, Role};
use crate::measured::recording::Run;
use crate::search::fit::{self, Fit, Term};
use crate::search::intervals::intervals;
use crate::search::select::Material;
use sim_worker::effect::{COPPER_PER_K, EffectKind, Equation, Law, NORMAL_95, conducting};

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
/// Least angle of the commutation [electrical rad], offset of a phase over what its sensor is believed to have, and loss of
/// torque at the greatest current that matter (assumed).
const LEAST_ANGLE: f64 = 0.03;
const LEAST_OFFSET: f64 = 5.0;
const LEAST_LOSS: f64 = 0.03;
/// Current over the noise of its sensor from which its pattern counts, and way in a sample up to which it is a pattern
/// [electrical rad] (assumed).
const CLEAR: f64 = 12.0;
const MOST_SWEEP: f64 = 0.4;
/// Share of a sample by which the impulse of a stretch of strong current is off, one sigma (assumed): a current that jumps may do so
/// anywhere within a sample at either end, and points of it do not say where.
const AT_ENDS: f64 = 0.4;
/// Fewest samples of a stretch, three of which are its ends (assumed): what one or two points of a current gave nobody knows.
const LEAST_STRETCH: usize = 6;
/// Share of an impulse by which the strokes of the commutation make it uncertain (assumed).
const ROUGH: f64 = 0.02;

/// One part of an estimate: the least-squares sums of a run.
#[derive(Clone, Copy, Debug, Default)]
struct Sums {
    xx: f64,
    xy: f64,
    yy: f64,
    rows: f64,
}

impl Sums {
    fn plus(self, o: &Self) -> Self {
        Self {
            xx: self.xx + o.xx,
            xy: self.xy + o.xy,
            yy: self.yy + o.yy,
            rows: self.rows + o.rows,
        }
    }

    fn all<'a>(parts: impl IntoIterator<Item = &'a Self>) -> Self {
        parts.into_iter().fold(Self::default(), Self::plus)
    }

    /// rms of what is left with a value.
    fn rms(&self, value: f64) -> f64 {
        ((self.yy - 2.0 * value * self.xy + value * value * self.xx).max(0.0) / self.rows.max(1.0)).sqrt()
    }
}

/// Value and standard deviation (jackknife over runs) of `y = value x`.
fn jackknife(parts: &[Sums]) -> Option<(f64, f64)> {
    let all = Sums::all(parts);
    let used: Vec<&Sums> = parts.iter().filter(|p| p.xx > 1e-4 * all.xx).collect();
    if used.len() < 3 || all.xx <= 0.0 {
        return None;
    }
    let value = all.xy / all.xx;
    let of = |p: &&Sums| (all.xy - p.xy) / (all.xx - p.xx).max(1e-300);
    Some((value, scatter(used.iter().map(of), value)))
}

/// Standard deviation by estimates that each leave one part out.
pub fn scatter(without: impl ExactSizeIterator<Item = f64>, value: f64) -> f64 {
    let n = without.len() as f64;
    ((n - 1.0) / n * without.map(|x| (x - value).powi(2)).sum::<f64>()).sqrt()
}

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
    let apart = |b: &Beside| !model.terms.iter().any(|t| t.kind == b.kind);
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
    let believed = spec.offset.unwrap_or(noise_of(m, BenchChannel::CurrentA)) * 3f64.sqrt();
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
    // of which the sensors' usual ones are a part
    let sd = sd.hypot(believed);
    let seen = ("sum of the phase currents", "A");
    holds(value, sd, LEAST_OFFSET * believed, before, after).then(|| Beside {
        law: sensor_of(m, model, find, value).map_or(Law::First, Law::Phase),
        ..found(EffectKind::CurrentOffset, (value, sd), seen, (before, after))
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

/// Stretches of strong current: what they give to the motion beside what the flux makes of them. `y = x - coefficient z`,
/// impulses over the stretch, each over its own uncertainty. And the greatest current.
fn strong(m: &Material, model: &Fit, run: &Run, s: &Signals) -> (Vec<Sums>, f64) {
    let constant = |name: &str| fit::constant(&m.nuisances, model, name);
    let (Some(p), Some(w)) = (&s.phases, run.channel(BenchChannel::Velocity)) else {
        return (Vec::new(), 0.0);
    };
    let (j, c, f, ke) = (
        constant("inertia"),
        constant("viscous"),
        constant("coulomb"),
        0.5 * constant("torque_constant"),
    );
    let dt = 1.0 / s.rate_hz;
    let shapes: [Vec<f64>; 3] = std::array::from_fn(|q| p.mean_over_support(s, q, |_, trap| trap));
    let mut out = Vec::new();
    let mut greatest: f64 = 0.0;
    let mut k = 2;
    while k + 3 < s.n {
        if !s.stepping[k] {
            k += 1;
            continue;
        }
        let from = k;
        while k + 3 < s.n && s.stepping[k] {
            k += 1;
        }
        let (mut given, mut lost, mut taken) = (0.0, 0.0, 0.0);
        for k in from..k {
            for q in 0..3 {
                let t = ke * p.current[q][k] * shapes[q][k] * dt;
                given += t;
                lost += t * p.current[q][k].abs();
            }
            let speed = 0.5 * (w[k] + w[k - 1]);
            taken += dt * (c * speed + f * speed.signum());
            greatest = greatest.max(p.size(k));
        }
        taken += j * (w[k - 1] - w[from - 1]);
        // where it turns round friction is not known
        let turns = (from..k).any(|k| w[k] * w[k - 1] <= 0.0);
        let noise = 2.0 * j * noise_of(m, BenchChannel::Velocity);
        if given.abs() < 10.0 * noise || turns || k - from < LEAST_STRETCH {
            continue;
        }
        let at_ends = AT_ENDS * given / (k - from) as f64;
        let size = (ROUGH * given).hypot(noise).hypot(at_ends);
        let (y, x) = ((given - taken) / size, lost / size);
        out.push(Sums {
            xx: x * x,
            xy: x * y,
            yy: y * y,
            rows: 1.0,
        });
    }
    (out, greatest)
}

/// What strong currents do against what the flux makes of them.
struct Strong {
    /// loss of torque a unit of current [1/A] and its standard deviation
    loss: (f64, f64),
    /// greatest current [A]
    greatest: f64,
    /// root mean square of the impulses over their uncertainty, without the loss and with it
    rms: (f64, f64),
}

/// No equation has the stretches of strong currents, so they are shared out by themselves: every third of them proves what the
/// others find. Only where the equations found nothing.
fn strong_currents(m: &Material, model: &Fit, [find, prove]: Both) -> Option<Strong> {
    if !model.terms.is_empty() || m.held.is_none() {
        return None;
    }
    let mut runs: Vec<&(&Run, &Signals)> = find.iter().chain(prove).collect();
    runs.sort_by(|a, b| a.1.start_s.total_cmp(&b.1.start_s).then(a.0.name.cmp(&b.0.name)));
    let all: Vec<(Vec<Sums>, f64)> = runs.iter().map(|(r, s)| strong(m, model, r, s)).collect();
    let greatest = all.iter().fold(0.0, |a: f64, b| a.max(b.1));
    let mut stretches: Vec<Sums> = all.into_iter().flat_map(|a| a.0).collect();
    // the strongest among those that prove as among those that find
    stretches.sort_by(|a, b| b.xx.total_cmp(&a.xx));
    let proves = |i: usize| i % 3 == 1;
    let of = |wanted: bool| -> Vec<Sums> {
        let all = stretches.iter().enumerate().filter(|(i, _)| proves(*i) == wanted);
        all.map(|(_, s)| *s).collect()
    };
    let loss = jackknife(&of(false))?;
    let proof = Sums::all(&of(true));
    Some(Strong {
        loss,
        greatest,
        rms: (proof.rms(0.0), proof.rms(loss.0)),
    })
}

/// Torque that strong currents do not give.
fn saturation(strong: &Strong) -> Option<Beside> {
    let ((value, sd), (before, after)) = (strong.loss, strong.rms);
    let seen = (
        "impulses of strong currents against what the flux makes of them, over their uncertainty",
        "-",
    );
    // what something else makes of strong currents is only a little less by it
    (value > 0.0
        && strong.greatest > 0.0
        && after < MOST_LEFT
        && holds(value, sd, LEAST_LOSS / strong.greatest, before, after))
    .then(|| found(EffectKind::TorqueSaturation, (value, sd), seen, (before, after)))
}

/// Most that a loss of torque leaves of the impulses of strong currents, over their uncertainty (assumed).
const MOST_LEFT: f64 = 4.0;

/// How far constants of units of one type differ, one sigma relative: resistance at 20 degC, inductance, inertia
/// (assumed); and squared standard deviations that an explanation must take.
const OF_UNITS: [(&str, f64); 3] = [("resistance", 0.04), ("inductance", 0.03), ("inertia", 0.08)];
const TOGETHER: f64 = 9.0;
/// Same of a rig, whose constants are trusted as its bench says: it knows no other unit of its type (assumed).
const TOGETHER_OF_RIG: f64 = 16.0;
/// Constants that a rig's gain of the current changes; its inductance is known too roughly.
const OF_RIG: [&str; 4] = ["resistance", "inertia", "coulomb", "viscous"];
/// Squared standard deviations by which another explanation must be worse.
const APART: f64 = 4.0;

/// What stands behind constants that are off together.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Behind {
    /// logarithm of the factor of the resistance
    Warm(f64),
    /// logarithm of the factor of the measured current
    Gain(f64),
}

/// A constant over what was believed of it, logarithm, and how far it may be off, one sigma.
#[derive(Clone, Copy, Debug)]
struct Off {
    name: &'static str,
    x: f64,
    sd: f64,
}

impl Off {
    /// Power of a current's gain that the constant shows: what is divided by a current that is too great is too small.
    fn by(&self) -> f64 {
        if matches!(self.name, "resistance" | "inductance") {
            -1.0
        } else {
            1.0
        }
    }
}

/// A warm winding raises the resistance alone; a sensor that shows too much current lowers resistance and inductance and
/// raises what has to be moved, all by one factor. What explains them with its standard deviation, whether the other does as
/// well, and squared standard deviations from what was believed without it and with it.
///
/// * `least` squared standard deviations that an explanation must take
fn explained(all: &[Off], least: f64) -> Option<(Behind, f64, bool, f64, f64)> {
    let of = |left: &dyn Fn(&Off) -> f64| -> f64 { all.iter().map(|o| (left(o) / o.sd).powi(2)).sum() };
    let weight = |o: &Off| o.sd.powi(-2);
    let weights = all.iter().map(weight).sum::<f64>();
    let g = all.iter().map(|o| weight(o) * o.by() * o.x).sum::<f64>() / weights;
    let resistance = all.iter().find(|o| o.name == "resistance")?;
    let left = |o: &Off| o.x - o.by() * g;
    let (plain, gain) = (of(&|o| o.x), of(&left));
    let warm = of(&|o| if o.name == "resistance" { 0.0 } else { o.x });
    let is_warm = resistance.x > 0.0 && plain - warm > least;
    let is_gain = plain - gain > least && all.iter().all(|o| left(o).abs() <= o.x.abs().max(2.0 * o.sd));
    let (behind, sd, after, other, is_other) = if is_gain && (!is_warm || gain < warm) {
        (Behind::Gain(g), weights.sqrt().recip(), gain, warm, is_warm)
    } else if is_warm {
        (Behind::Warm(resistance.x), resistance.sd, warm, gain, is_gain)
    } else {
        return None;
    };
    Some((behind, sd, is_other && other - after < APART, plain, after))
}

/// What the constants say together.
pub(super) fn together(m: &Material, model: &Fit, first: &[Nuisance]) -> Option<Beside> {
    // effects that a resistance or an inertia gives way to
    let disturbing = |t: &Term| {
        matches!(
            t.kind,
            EffectKind::DeadTime | EffectKind::TurnShort | EffectKind::Compliance | EffectKind::Backlash
        )
    };
    if m.held.is_none() || model.terms.iter().any(disturbing) {
        return None;
    }
    let off = |name: &'static str, sd: Option<f64>| -> Option<Off> {
        let believed = first.iter().find(|n| n.name == name)?;
        let sd = sd.or(believed.trust).filter(|t| *t > 0.0)?;
        let x = (fit::constant(&m.nuisances, model, name) / believed.nominal).ln();
        x.is_finite().then_some(Off { name, x, sd })
    };
    let (all, least, seen) = if m.bench.has_phases() {
        let all: Option<Vec<Off>> = OF_UNITS.iter().map(|c| off(c.0, Some(c.1))).collect();
        (
            all?,
            TOGETHER,
            "constants against those of the type, in their standard deviations",
        )
    } else {
        // what is fixed or free says nothing
        let all = OF_RIG.iter().filter_map(|name| off(name, None)).collect();
        (
            all,
            TOGETHER_OF_RIG,
            "constants against what they were trusted, in standard deviations",
        )
    };
    explained(&all, least)?;
    // what they are known to by themselves counts too; it takes longer to work out than to see that nothing is to be explained
    let known = intervals(m, model).nuisance;
    let of = |o: Off| {
        let k = m.nuisances.iter().position(|n| n.name == o.name);
        let own = k.map_or(0.0, |k| known[k] / NORMAL_95);
        Off {
            sd: o.sd.hypot(own),
            ..o
        }
    };
    let all: Vec<Off> = all.into_iter().map(of).collect();
    let (behind, sd, either, before, after) = explained(&all, least)?;
    let rms = (before.sqrt(), after.sqrt());
    let (kind, other, value, sd, factors) = match behind {
        Behind::Gain(g) => (
            EffectKind::CurrentGain,
            EffectKind::WindingHeating,
            g.exp_m1(),
            g.exp() * sd,
            [
                ("resistance", g),
                ("inductance", g),
                ("inertia", -g),
                ("coulomb", -g),
                ("viscous", -g),
            ]
            .map(|(name, g)| (name, g.exp()))
            .to_vec(),
        ),
        Behind::Warm(x) => (
            EffectKind::WindingHeating,
            EffectKind::CurrentGain,
            x.exp_m1() / COPPER_PER_K,
            sd * x.exp() / COPPER_PER_K,
            vec![("resistance", (-x).exp())],
        ),
    };
    Some(Beside {
        ambiguous: if either { vec![other] } else { Vec::new() },
        factors,
        ..found(kind, (value, sd), (seen, "-"), rms)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_jackknife_knows_the_scatter_of_its_parts() {
        let part = |x: f64, y: f64| Sums {
            xx: x * x,
            xy: x * y,
            yy: y * y,
            rows: 1.0,
        };
        let parts = [part(1.0, 2.1), part(2.0, 4.0), part(1.0, 1.9), part(2.0, 4.0)];
        let (value, sd) = jackknife(&parts).unwrap();
        assert!((value - 2.0).abs() < 1e-12 && sd > 0.005 && sd < 0.05, "{value} {sd}");
        assert!(jackknife(&parts[..2]).is_none());
        let all = Sums::all(&parts);
        assert!(all.rms(2.0) < 0.08 && all.rms(0.0) > 3.0);
    }

    #[test]
    fn constants_that_are_off_together_have_one_cause() {
        let explained = |x: [f64; 3]| {
            let of = |(c, x): (&(&'static str, f64), f64)| Off { name: c.0, x, sd: c.1 };
            super::explained(&OF_UNITS.iter().zip(x).map(of).collect::<Vec<_>>(), TOGETHER)
        };
        assert!(explained([0.0, 0.0, 0.0]).is_none());
        // within what units of a type differ
        assert!(explained([0.04, -0.02, 0.08]).is_none());
        // a winding 50 K warmer
        let warm = (50.0 * COPPER_PER_K).ln_1p();
        let (behind, _, either, _, after) = explained([warm, 0.01, -0.03]).unwrap();
        assert_eq!((behind, either), (Behind::Warm(warm), false));
        assert!(after < 0.5);
        // currents 12 % too great
        let g = 0.12_f64.ln_1p();
        let (behind, _, _, before, after) = explained([-g, -g, g]).unwrap();
        assert!(matches!(behind, Behind::Gain(x) if (x - g).abs() < 1e-12), "{behind:?}");
        assert!(before > 20.0 && after < 1e-9);
        // 10 % too small looks like a warm winding with another inductance
        let (behind, ..) = explained([-(0.9_f64.ln()), -(0.9_f64.ln()), 0.9_f64.ln()]).unwrap();
        assert!(matches!(behind, Behind::Gain(x) if x < 0.0), "{behind:?}");
    }
}
