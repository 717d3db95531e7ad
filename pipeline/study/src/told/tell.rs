//! From a study's numbers to what is said of them.

use crate::equations::problem::Problem;
use crate::measured::bench::{BenchChannel, Role};
use crate::search::beside::Beside;
use crate::search::closed_loop::closed_loop;
use crate::search::excitation;
use crate::search::fit::{self, Fit};
use crate::search::intervals::{self, Intervals};
use crate::search::select::Material;
use crate::search::study::Outcome;
use crate::search::verdict::{Verdict, shares};
use crate::told::findings::*;
use crate::told::places;
use crate::told::scale;
use crate::told::words::{assumptions, facts, missing, sentence, told, unnamed};
use nalgebra::{DMatrix, DVector};
use sim_worker::effect::{EffectKind, Equation, Law, NORMAL_95};

/// The channel that an equation predicts.
pub(super) fn channel(m: &Material, e: Equation) -> (&'static str, &'static str) {
    let drive = m.bench.rig.drive;
    match e {
        Equation::Torque => match drive {
            BenchChannel::Current => ("current", "A"),
            BenchChannel::Voltage => ("voltage", "V"),
            _ => (drive.name(), "N m"),
        },
        Equation::Electrical => ("voltage", "V"),
        Equation::Transmission => ("user_position", "rad"),
        Equation::Kinematic => ("velocity", "rad/s"),
        Equation::Controller => ("command", "drive unit/s"),
    }
}

/// From the equation's unit to the channel's.
pub(super) fn to_channel(m: &Material, e: Equation) -> f64 {
    match e {
        Equation::Torque => 1.0 / m.bench.rig.drive_constant.value,
        _ => 1.0,
    }
}

/// Everything that a study has to say, but for what is written into the model.
pub fn findings(o: &Outcome, model_file: &str) -> Findings {
    let m = &o.material;
    let intervals = intervals::intervals(m, &o.model);
    let (retuned, correlation) = scaled(o, constants(o, &intervals), correlation(o, &intervals));
    let (retuned, correlation) = looped(o, retuned, correlation);
    let effects = effects(o, &intervals);
    let by_channel = gaps(o);
    let gap = by_channel.first().cloned();
    let unnamed_share = match o.verdict {
        Verdict::None | Verdict::Retune => 0.0,
        // what was found beside the equations leaves nothing in them to be named
        Verdict::Named if o.model.terms.is_empty() => 0.0,
        Verdict::Unknown => 1.0 - o.explained,
        _ => (1.0 - o.explained).max(0.0),
    };
    let regions = places::regions(m, &o.retuned);
    let unnamed = matches!(o.verdict, Verdict::Unknown | Verdict::NamedWithRemainder).then(|| unnamed(o, &regions));
    let closed = closed_loop(o);
    let mut f = Findings {
        model: model_file.to_string(),
        bench: m.bench.file.clone(),
        verdict: o.verdict.name().to_string(),
        effects,
        retuned,
        correlation,
        gap,
        by_channel,
        regions,
        leaders: leaders(o),
        not_excited: excitation::not_excited(m),
        missing: missing(m),
        unnamed_share,
        unnamed,
        profiles: places::profiles(o),
        traces: places::traces(o),
        facts: facts(o, &closed),
        closed_loop: closed,
        assumptions: assumptions(m, &o.model),
        ..Findings::default()
    };
    let used = m
        .runs
        .iter()
        .filter(|r| matches!(r.role, Role::Fit | Role::Select | Role::HeldOut));
    f.health = if used.clone().all(|r| r.healthy) {
        "healthy"
    } else {
        "unknown"
    }
    .to_string();
    if f.health == "unknown" {
        f.findings = findings_of(&f);
    }
    f.sentence = sentence(o, &f);
    f
}

fn constants(o: &Outcome, i: &Intervals) -> Vec<Identified> {
    let m = &o.material;
    let mut out = Vec::new();
    for (n, n0) in m
        .nuisances
        .iter()
        .zip(&o.first_nuisances)
        .enumerate()
        .map(|(k, (n, n0))| ((k, n), n0))
    {
        let ((k, n), n0) = (n, n0);
        if !n.of_machine || n.nominal == 0.0 {
            continue;
        }
        let factor = o.beside.iter().flat_map(|b| &b.factors).filter(|f| f.0 == n.name);
        let factor: f64 = factor.map(|f| f.1).product();
        let value = factor * n.nominal * (1.0 + o.model.nuisance[k]);
        let half = factor * n.nominal.abs() * i.nuisance[k];
        out.push(Identified::about(n.name, value, half, n.unit, Some(n0.nominal)));
    }
    // after all that stand in the correlations
    if let Some((nominal, sd)) = m.bench.rig.supply_of_file {
        let (value, half) = (m.bench.rig.supply_voltage, NORMAL_95 * sd);
        out.push(Identified::about("supply_voltage", value, half, "V", Some(nominal)));
    }
    out
}

/// Torques of an actuator of ours that voltages scale, none of which is better known than this, one sigma relative (assumed: of eight
/// plain benches of another hand the torque constant was off by 0.064 % rms where its rows said 0.02 to 0.05 %).
const SCALE_SD: f64 = 7e-4;
const SCALED: [&str; 4] = ["torque_constant", "inertia", "viscous", "coulomb"];

/// Covariance of the constants, relative.
fn covariance(all: &[Identified], correlation: &[f64]) -> DMatrix<f64> {
    let sd = |c: &Identified| (0.5 * (c.hi - c.lo) / NORMAL_95 / c.value.abs().max(1e-300)).max(1e-12);
    let sds: Vec<f64> = all.iter().map(sd).collect();
    let n = all.len();
    DMatrix::from_fn(n, n, |a, b| correlation[a * n + b] * sds[a] * sds[b])
}

/// The correlation of two constants.
fn correlated(of: &DMatrix<f64>, a: usize, b: usize) -> f64 {
    let sd = |k: usize| of[(k, k)].max(1e-300).sqrt();
    if a == b {
        return 1.0;
    }
    (of[(a, b)] / (sd(a) * sd(b))).clamp(-1.0, 1.0)
}

/// Intervals as a relative covariance says.
fn with_covariance(all: &mut [Identified], of: &DMatrix<f64>) {
    for (k, c) in all.iter_mut().enumerate() {
        let half = NORMAL_95 * of[(k, k)].max(0.0).sqrt() * c.value.abs();
        (c.lo, c.hi) = (c.value - half, c.value + half);
    }
}

/// The constants with what the scale of all torques is uncertain by, beyond what the rows say.
fn scaled(o: &Outcome, mut all: Vec<Identified>, correlation: Vec<f64>) -> (Vec<Identified>, Vec<f64>) {
    let bench = &o.material.bench;
    if !bench.own || !scale::told_by_voltages(bench) {
        return (all, correlation);
    }
    let n = all.len();
    let of_scale = |c: &Identified| f64::from(u8::from(SCALED.contains(&c.name.as_str()))) * SCALE_SD;
    let all_at_once = DVector::from_iterator(n, all.iter().map(of_scale));
    let of = covariance(&all, &correlation) + &all_at_once * all_at_once.transpose();
    with_covariance(&mut all, &of);
    let correlation = (0..n * n).map(|k| correlated(&of, k / n, k % n)).collect();
    (all, correlation)
}

/// The constants with what only the simulated loop tells: one that stands among them is measured by it, and all that hang on it go with
/// it; the others come after them.
fn looped(o: &Outcome, mut all: Vec<Identified>, correlation: Vec<f64>) -> (Vec<Identified>, Vec<f64>) {
    if o.by_loop.is_empty() {
        return (all, correlation);
    }
    let n = all.len();
    let mut of = covariance(&all, &correlation);
    let (mut among, mut alone) = (Vec::new(), Vec::new());
    for l in &o.by_loop {
        match all.iter().position(|c| c.name == l.name) {
            Some(k) => among.push((k, l.factor.ln(), l.sd)),
            None => alone.push(l),
        }
    }
    let moved = measured_too(&mut of, &among);
    for (c, by) in all.iter_mut().zip(moved.iter()) {
        c.value *= by.exp();
    }
    with_covariance(&mut all, &of);
    let rig = &o.material.bench.rig;
    for l in alone {
        let (nominal, unit) = match l.name {
            "resistance" => (rig.resistance.value, "ohm"),
            "inductance" => (rig.inductance.value, "H"),
            "supply_voltage" => (rig.supply_voltage, "V"),
            _ => continue,
        };
        let value = nominal * l.factor;
        all.push(Identified::about(
            l.name,
            value,
            NORMAL_95 * l.sd * value,
            unit,
            Some(nominal),
        ));
    }
    let m = all.len();
    let told = |a: usize, b: usize| match (a < n, b < n) {
        (true, true) => correlated(&of, a, b),
        _ => f64::from(u8::from(a == b)),
    };
    let correlation = (0..m * m).map(|k| told(k / m, k % m)).collect();
    (all, correlation)
}

/// How far logarithms of constants move where some of them are measured once more.
///
/// * `of` their covariance, that of the equations before, with the measurements after
/// * `measured` place, how far it is measured to be from what the equations say, standard deviation
fn measured_too(of: &mut DMatrix<f64>, measured: &[(usize, f64, f64)]) -> DVector<f64> {
    let mut moved = DVector::zeros(of.nrows());
    for &(k, off, sd) in measured {
        let by = of.column(k) / of[(k, k)];
        let known = sd.powi(2).min(of[(k, k)]);
        // by what is left of it after those before
        let left = off - moved[k];
        moved += &by * left;
        *of -= &by * by.transpose() * (of[(k, k)] - known);
    }
    moved
}

/// Correlations of the constants that are told.
fn correlation(o: &Outcome, i: &Intervals) -> Vec<f64> {
    let all = &o.material.nuisances;
    let told: Vec<usize> = (0..all.len())
        .filter(|k| all[*k].of_machine && all[*k].nominal != 0.0)
        .collect();
    let alone = usize::from(o.material.bench.rig.supply_of_file.is_some());
    let n = told.len() + alone;
    let of = |a: usize, b: usize| match (told.get(a), told.get(b)) {
        (Some(a), Some(b)) => i.correlation[a * all.len() + b],
        _ => f64::from(u8::from(a == b)),
    };
    (0..n * n).map(|k| of(k / n, k % n)).collect()
}

fn term_text(kind: EffectKind, law: Law) -> &'static str {
    match kind {
        EffectKind::Stribeck => "torque exp(-(|w|/speed)^exponent) sgn w",
        EffectKind::LubricatedRise => "torque (1 - exp(-|w|/speed)) sgn w",
        EffectKind::QuadraticDrag => "coefficient w |w|",
        EffectKind::ViscousAsymmetry => "coefficient |w|",
        EffectKind::BiasTorque => "torque",
        EffectKind::LoadDependentFriction => "coefficient |load| sgn w",
        EffectKind::TemperatureDependentFriction => "coefficient (T - 20 degC) (friction)",
        EffectKind::PeriodicFriction => "amplitude cos(order theta + phase) sgn w",
        EffectKind::TightSpot => "torque exp(-((theta - centre)/width)^2) sgn w",
        EffectKind::Presliding if law == Law::BreakAway => {
            "LuGre friction of this stiffness and damping in place of dry friction"
        }
        EffectKind::Presliding => "Dahl friction of this stiffness and damping in place of dry friction",
        EffectKind::Cogging => "amplitude cos(order theta + phase)",
        EffectKind::TorqueRipple => "kt, ke (1 + fraction cos(order theta + phase))",
        EffectKind::Eccentricity => "Eq. 5 of the paper: k_q (1 + zeta cos(theta + phase + 2 pi q/3))",
        EffectKind::TorqueSaturation if law == Law::Flux => "kt, ke/sqrt(1 + (coefficient i)^2)",
        EffectKind::TorqueSaturation if law == Law::Square => "kt i (1 - (coefficient i)^2)",
        EffectKind::TorqueSaturation => "kt i (1 - coefficient |i|)",
        EffectKind::SpringLoad => "stiffness theta",
        EffectKind::Compliance => "load mass of this inertia on a spring and damper",
        EffectKind::Backlash => "load pushed through a gap",
        EffectKind::WindingHeating => "R (1 + 0.00393/K delta_t): winding warmer by delta_t",
        EffectKind::SupplySag => "source of this resistance",
        EffectKind::DeadTime => "voltage tanh(i/0.05 A)",
        EffectKind::TurnShort => "fraction of one phase's turns shorted",
        EffectKind::CommutationOffset => "electrical angle of the commutation off by angle",
        EffectKind::EncoderEccentricity => "measured angle = theta + amplitude sin(theta + phase)",
        EffectKind::CurrentOffset => "measured current = i + current",
        EffectKind::CurrentGain => "measured current = (1 + gain) i",
        EffectKind::ControlDelay => "the drive follows the controller's law after delay",
    }
}

fn effects(o: &Outcome, i: &Intervals) -> Vec<FoundEffect> {
    let m = &o.material;
    if matches!(o.verdict, Verdict::None | Verdict::Retune) {
        return Vec::new();
    }
    let beside = o.beside.iter().map(|b| found_beside(m, b));
    let scale = torque_scale(m, &o.model);
    let accepted: Vec<_> = o.steps.iter().filter(|s| s.accepted).collect();
    o.model
        .terms
        .iter()
        .enumerate()
        .map(|(t, term)| {
            let e = fit::effect_of(term, &m.constants, &m.fit);
            let source = o.source.filter(|_| term.kind == EffectKind::SupplySag);
            let parameters = e
                .parameters()
                .enumerate()
                .map(|(k, (key, v))| {
                    let s = if intervals::is_torque(term.kind, k) { scale } else { 1.0 };
                    let (mut v, mut half) = (v * s, i.terms[t][k] * s);
                    // the simulated loop knows how much of the time the legs draw
                    if let Some(s) = source {
                        (v, half) = (s.ohm, (half * s.ohm / v).hypot(NORMAL_95 * s.sd));
                    }
                    Identified {
                        name: key.name.to_string(),
                        value: v,
                        lo: (v - half).max(key.low),
                        hi: (v + half).min(key.high),
                        unit: key.unit.to_string(),
                        nominal: None,
                    }
                })
                .collect();
            let step = accepted.iter().find(|s| s.taken.contains(&term.kind));
            let runner_up = step.and_then(|s| s.ranked.iter().map(|r| r.term.kind).find(|k| *k != term.kind));
            // of the last fit: what was said when it was chosen was said beside other constants
            let (before, after) = (m.without(&o.model, t).score.energy, o.model.score.energy);
            let own = term.kind.equation().index();
            let by = shares(&m.fit, &before, &after, None);
            let share = by[own]
                .or(by.into_iter().flatten().next())
                .unwrap_or_else(|| 1.0 - after[own] / before[own].max(1e-300));
            FoundEffect {
                name: term.kind.name().to_string(),
                equation: term.kind.equation().name().to_string(),
                term: term_text(term.kind, e.law).to_string(),
                parameters,
                correlation: i.term_correlation[t].clone(),
                explained_share: share.clamp(0.0, 1.0),
                runner_up: runner_up.map(|k| k.name().to_string()),
                ambiguous_with: o
                    .ambiguous
                    .iter()
                    .filter(|a| a.0 == term.kind)
                    .flat_map(|a| a.1.iter().map(|k| k.name().to_string()))
                    .collect(),
                channel: channel(m, m.seen_in(term)).0.to_string(),
                heldout: o.proofs.iter().find(|p| p.0 == term.kind).map(|p| {
                    let c = to_channel(m, m.seen_in(term));
                    (c * p.1, c * p.2)
                }),
                law: match m.bench.made_of_angle {
                    // a recorded speed that is made of the angle has its error, and is what the loop acts on (assumed)
                    Some(_) if term.kind == EffectKind::EncoderEccentricity => Law::AngleAndSpeed,
                    _ => source.map_or(e.law, |s| s.draw),
                },
                alias: (term.kind == EffectKind::BiasTorque).then(|| "coulomb_asymmetry".to_string()),
            }
        })
        .chain(beside)
        .collect()
}

/// An effect that was found beside the equations.
fn found_beside(m: &Material, b: &Beside) -> FoundEffect {
    let key = &b.kind.keys()[0];
    let second = b.kind.keys().get(1).zip(b.second);
    let second = second.map(|(key, value)| Identified::about(key.name, value, 0.0, key.unit, None));
    FoundEffect {
        name: b.kind.name().to_string(),
        equation: b.kind.equation().name().to_string(),
        term: term_text(b.kind, b.law).to_string(),
        parameters: std::iter::once(Identified {
            name: key.name.to_string(),
            value: b.value,
            lo: (b.value - b.half).max(key.low),
            hi: (b.value + b.half).min(key.high),
            unit: key.unit.to_string(),
            nominal: None,
        })
        .chain(second)
        .collect(),
        correlation: Vec::new(),
        explained_share: (1.0 - (b.after / b.before.max(1e-300)).powi(2)).clamp(0.0, 1.0),
        runner_up: None,
        ambiguous_with: b.ambiguous.iter().map(|k| k.name().to_string()).collect(),
        alias: None,
        law: b.law,
        channel: b.seen_in.to_string(),
        heldout: m.held.is_some().then_some((b.before, b.after)),
    }
}

/// What friction and eccentricity say of a unit of unknown health, against what the model's file calls healthy.
fn findings_of(f: &Findings) -> Vec<Finding> {
    let mut out = Vec::new();
    // where a law of friction was found beside it, the dry one alone says nothing
    let shared = [
        "stribeck",
        "lubricated_rise",
        "load_dependent_friction",
        "temperature_dependent_friction",
    ];
    if let Some(c) = f.retuned.iter().find(|r| r.name == "coulomb")
        && !f.effects.iter().any(|e| shared.contains(&e.name.as_str()))
        && let Some(nominal) = c.nominal.filter(|n| *n > 0.0)
    {
        let (value, lo, hi) = (c.value / nominal, c.lo / nominal, c.hi / nominal);
        let meaning = if lo > 1.0 {
            format!(
                "dry friction {value:.2} times what the type's file calls healthy: worn, dry or tight, unless this unit was always so"
            )
        } else {
            "dry friction as the type's file has it".to_string()
        };
        out.push(Finding {
            name: "fsj".into(),
            value,
            lo,
            hi,
            unit: "-".into(),
            meaning,
        });
    }
    for e in &f.effects {
        let Some(p) = e.parameters.first() else { continue };
        let (name, meaning) = match e.name.as_str() {
            "eccentricity" => (
                "zeta",
                format!("the rotor runs {:.0} % of its air gap out of centre", 100.0 * p.value),
            ),
            name => (
                name,
                format!(
                    "{name}: {} {:.4} {}, on a unit that nobody calls healthy",
                    p.name, p.value, p.unit
                ),
            ),
        };
        out.push(Finding {
            name: name.into(),
            value: p.value,
            lo: p.lo,
            hi: p.hi,
            unit: p.unit.clone(),
            meaning,
        });
    }
    out
}

/// kt of the fit over the kt that the equations stand around.
fn torque_scale(m: &Material, fit: &Fit) -> f64 {
    fit::deviation(&m.nuisances, fit, "torque_constant").map_or(1.0, |(_, x)| 1.0 + x)
}

fn gaps(o: &Outcome) -> Vec<ChannelGap> {
    let m = &o.material;
    let held = m.held.as_ref();
    m.equations
        .iter()
        .map(|&e| {
            let c = to_channel(m, e);
            let (name, unit) = channel(m, e);
            let line = |p: &Problem, nominal: &[f64; 5], retuned: &[f64; 5], last: &[f64; 5]| GapLine {
                nominal: c * p.rms(e, nominal),
                retuned: c * p.rms(e, retuned),
                last: c * p.rms(e, last),
                floor: c * p.floor_of(e),
            };
            ChannelGap {
                channel: name.to_string(),
                equation: e.name().to_string(),
                unit: unit.to_string(),
                fit: line(&m.fit, &o.nominal.score.energy, &o.retuned_fit, &o.model.score.energy),
                heldout: held.map(|p| line(p, &o.held_nominal, &o.held_retuned, &o.held_model)),
            }
        })
        .collect()
}

fn leaders(o: &Outcome) -> Vec<Leader> {
    let m = &o.material;
    let mut out = Vec::new();
    for (i, s) in o.steps.iter().enumerate() {
        for (j, r) in s.ranked.iter().take(7).enumerate() {
            let e = fit::effect_of(&r.term, &m.constants, &m.fit);
            let parameters: Vec<String> = e.parameters().map(|(k, v)| told(k.name, v, k.unit)).collect();
            let by = shares(&m.fit, &s.before, &r.score.energy, None);
            let own = by[r.term.kind.equation().index()]
                .or(by.into_iter().flatten().next())
                .unwrap_or(0.0);
            let taken = s.accepted && s.taken.contains(&r.term.kind);
            let note = match (j, taken) {
                (_, true) if s.taken.len() > 1 => "taken, only together",
                (_, true) => "taken",
                (0, false) if s.accepted => "another does better once refined",
                (0, false) => s.why_not,
                _ => "",
            };
            out.push(Leader {
                step: i + 1,
                name: r.term.kind.name().to_string(),
                gain: r.gain,
                explained_share: own.clamp(0.0, 1.0),
                parameters: parameters.join(", "),
                note: note.to_string(),
            });
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn prop_what_is_measured_too_comes_out_as_it_was_measured() {
        // the first two go together, the third hangs on the first
        let covariance = [[4.0, 3.6, 2.0], [3.6, 4.0, 1.8], [2.0, 1.8, 2.0]];
        let mut of = DMatrix::from_fn(3, 3, |a, b| 1e-4 * covariance[a][b]);
        let moved = measured_too(&mut of, &[(0, 0.05, 1e-5), (1, -0.04, 1e-5)]);
        assert!(
            (moved[0] - 0.05).abs() < 1e-4 && (moved[1] + 0.04).abs() < 1e-9,
            "{moved}"
        );
        assert!((moved[2] - 0.025).abs() < 1e-3, "{moved}");
        assert!(of[(0, 0)].sqrt() < 2e-5 && of[(1, 1)].sqrt() < 2e-5, "{of}");
        assert!(of[(2, 2)] < 1.05e-4 && of[(2, 2)] > 0.9e-4, "{of}");
    }
}
