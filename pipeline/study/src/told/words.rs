//! The sentences and lists of a study.

use crate::candidates::springs::is_beyond;
use crate::measured::bench::BenchChannel;
use crate::search::closed_loop::ClosedLoop;
use crate::search::fit::{Fit, Term};
use crate::search::form::Strange;
use crate::search::select::Material;
use crate::search::study::Outcome;
use crate::search::verdict::Verdict;
use crate::told::findings::*;
use sim_worker::effect::{EffectKind, Equation};

pub(super) fn missing(m: &Material) -> Vec<(String, String)> {
    use BenchChannel as C;
    let opens = [
        (C::Velocity, "a second sensor of the motion: encoder eccentricity"),
        (
            C::Voltage,
            "the electrical equation: resistance, heating, dead time, supply sag, and kt apart from friction",
        ),
        (C::UserPosition, "the transmission: backlash, compliance, slip"),
        (C::Command, "the controller's equation (with [rig.controller]): delay"),
        (C::Load, "load-dependent friction, and kt apart from friction"),
        (C::Temperature, "heating of winding and lubricant"),
    ];
    let mut out: Vec<(String, String)> = opens
        .iter()
        // three phases stand for the voltage
        .filter(|(c, _)| !(m.has(*c) || *c == C::Voltage && m.equations.contains(&Equation::Electrical)))
        .map(|(c, t)| (c.name().to_string(), t.to_string()))
        .collect();
    if m.held.is_none() {
        out.push((
            "heldout".into(),
            "a run that is not used to find anything: without it nothing is proven".into(),
        ));
    }
    out
}

/// Why effects that were found are not what is there.
fn strange(s: Strange) -> String {
    match s {
        Strange::Form { of, signed, share } => format!(
            "; beside the closest effects it goes with the {}{} in a form of its own, {:.0} % of what they take",
            of.name(),
            if signed { ", against the motion," } else { "" },
            100.0 * share
        ),
        Strange::Unlisted(u) => format!("; {}: {:.0} % of what is left", u.law.told(), 100.0 * u.of_left),
        Strange::Composed => "; it takes several effects of the rotor's angle or the place to follow it".to_string(),
    }
}

pub(super) fn unnamed(o: &Outcome, regions: &[Region]) -> String {
    let m = &o.material;
    let worst = m
        .equations
        .iter()
        .filter(|e| **e != Equation::Controller)
        .max_by(|a, b| {
            let gap = |e: &Equation| m.held_problem().rms(*e, &o.held_model) / m.held_problem().floor_of(*e);
            gap(a).total_cmp(&gap(b))
        });
    let e = *worst.unwrap_or(&Equation::Torque);
    let place = regions
        .iter()
        .find(|r| r.equation == e.name())
        .map_or(String::new(), |r| format!("; {}", r.text));
    let relatives: Vec<&str> = o
        .steps
        .last()
        .map(|s| s.ranked.iter().take(3).map(|r| r.term.kind.name()).collect())
        .unwrap_or_default();
    let strange = o.strange.map_or(String::new(), strange);
    format!(
        "unnamed {} in the {} equation: {:.3} times the noise is left on held-out data{strange}{place}; closest relatives: {}; a lookup table would take {:.0} % of the rest",
        match e {
            Equation::Torque => "torque",
            Equation::Electrical => "voltage",
            Equation::Transmission => "angle",
            _ => "signal",
        },
        e.name(),
        m.held_problem().rms(e, &o.held_model) / m.held_problem().floor_of(e),
        relatives.join(", "),
        100.0 * o.remainder
    )
}

pub(super) fn facts(o: &Outcome, closed: &[ClosedLoop]) -> Vec<(String, String)> {
    let m = &o.material;
    let runs: Vec<String> = m
        .runs
        .iter()
        .map(|r| format!("{} ({}, {:.2} s)", r.name, r.role.name(), r.duration_s()))
        .collect();
    let shown = if runs.len() > 8 {
        format!("{} runs", runs.len())
    } else {
        runs.join("; ")
    };
    let masked: usize = m.fit.blocks_of(Equation::Torque).map(|b| b.masked).sum();
    let rows = m.fit.rows_of(Equation::Torque);
    let p = m.held_problem();
    // in rows, as the gap is
    let count = p.rows_of(Equation::Torque) as f64;
    let kt = m.bench.rig.drive_constant.value;
    let drive = (p.energy(&p.drive)[Equation::Torque.index()] / count.max(1.0)).sqrt() / kt;
    let e = Equation::Torque.index();
    let relative = |energy: &[f64; 5], kt: f64| {
        format!(
            "{:.3} %",
            100.0 * (energy[e] / f64::max(count, 1.0)).sqrt() * kt / drive
        )
    };
    let kt = 1.0 / kt;
    let (nominal, retuned, last) = (
        relative(&o.held_nominal, o.nominal_to_channel),
        relative(&o.held_retuned, kt),
        relative(&o.held_model, kt),
    );
    let mut out = vec![
        (
            "relative error of the drive signal".into(),
            format!("nominal {nominal}, re-tuned {retuned}, final {last}"),
        ),
        ("runs".into(), shown),
        (
            "sampling".into(),
            format!("{:.4} Hz; filters to {:.3} Hz", m.clock.rate_hz, m.clock.corner_hz),
        ),
        (
            "equations".into(),
            m.equations.iter().map(|e| e.name()).collect::<Vec<_>>().join(", "),
        ),
        (
            "speed and acceleration from".into(),
            if m.clock.from_position {
                "position".into()
            } else {
                "velocity".into()
            },
        ),
        (
            "left out of the torque equation".into(),
            format!("{masked} of {} rows, at rest or turning round", rows + masked),
        ),
    ];
    let mut shown: Vec<&ClosedLoop> = closed.iter().filter(|c| c.heldout).collect();
    if shown.is_empty() {
        shown = closed.iter().collect();
    }
    if !shown.is_empty() {
        let rms = |f: fn(&ClosedLoop) -> f64| {
            100.0 * (shown.iter().map(|c| f(c).powi(2)).sum::<f64>() / shown.len() as f64).sqrt()
        };
        let data = if shown[0].heldout { "held-out" } else { "fit" };
        out.push((
            "relative error of the drive signal in closed loop".into(),
            format!(
                "nominal {:.3} %, final {:.3} % ({data} runs)",
                rms(|c| c.nominal),
                rms(|c| c.last)
            ),
        ));
    }
    out
}

/// Share of the inductance that sampling leaves open from which it is said (assumed).
const MUCH_BETWEEN: f64 = 0.1;

pub(super) fn assumptions(m: &Material, model: &Fit) -> Vec<String> {
    let mut out = vec![
        "sensors: gain 0.6 %, offset of the drive 0.2 % of its range, clocks 15 % of a sample apart, those of current and voltage 3 % (one sigma)".to_string(),
        "an effect is taken for a gain of 12 in log-likelihood beyond what its parameters cost, data that did not fix its amplitudes and get better in 97.5 % of block draws, and 30 % of what is left explained; held-out data, seen once, prove it".to_string(),
    ];
    let between = m
        .nuisances
        .iter()
        .find(|n| n.name == "between_samples")
        .and_then(|n| n.trust);
    if m.bench.rig.inductance_by_points.is_some() {
        out.push(
            "the phase currents are read at points: the inductance is from what they change by from point to point (sensors' gains 1 %, one sigma)"
                .into(),
        );
    } else if let Some(t) = between.filter(|t| *t > MUCH_BETWEEN) {
        out.push(format!(
            "what current and voltage do between their samples leaves the inductance open by {:.0} % (one sigma): a voltage recorded as means would say more",
            100.0 * t
        ));
    }
    let beyond = |t: &Term| t.kind == EffectKind::Compliance && is_beyond(&t.shape);
    if m.fit.rows_of(Equation::Transmission) > 0 && model.terms.iter().any(beyond) {
        out.push(
            "the load on its spring lies beyond the user's sensor, which turns with the motor as far as its noise lets see".into(),
        );
    }
    let of_day = m.bench.rig.friction_of_day;
    if of_day > 0.0 {
        out.push(format!(
            "dry and viscous friction are another one in each file, as on another day: of each file its own, {:.0} % around the machine's (one sigma)",
            100.0 * of_day
        ));
    }
    if let Some(f) = m.bench.made_of_angle {
        out.push(format!(
            "the recorded speed is no sensor of its own but the angle's slope through {} of the first order at {:.0} Hz: it was left out",
            if f.order == 1 { "a low pass" } else { "two low passes" },
            f.corner_hz
        ));
    }
    if !m.bench.rig.from_model.is_empty() {
        out.push(format!(
            "from the model's file, as the bench file does not say: {}",
            m.bench.rig.from_model.join(", ")
        ));
    }
    let rig = &m.bench.rig;
    let known: Vec<String> = rig
        .assumed
        .iter()
        .filter(|(key, _)| {
            m.equations.contains(&Equation::Electrical)
                || !matches!(
                    *key,
                    "resistance" | "inductance" | "back_emf_constant" | "supply_voltage"
                )
        })
        .map(|(key, x)| match *x {
            0.0 => format!("{key} (from the data)"),
            x if x.is_infinite() => format!("{key} (no limit)"),
            x => told(key, x, "-"),
        })
        .collect();
    if !known.is_empty() {
        out.push(format!(
            "not said by the bench, and no --actuator: {}",
            known.join(", ")
        ));
    }
    if let (Some((torque, voltage)), true) = (rig.one_constant, m.equations.contains(&Equation::Electrical)) {
        out.push(format!(
            "drive_constant ({torque:.4e}) and back_emf_constant ({voltage:.4e}) are one constant of a motor: their mean by what they are trusted"
        ));
    }
    if let Some(w) = &rig.winding {
        out.push(format!(
            "voltage at the motor's terminals, no current: the drive's constant is drive_constant / resistance, {:.4e} N m/V, late by inductance / resistance, {:.4} ms; `viscous` includes what the back-EMF brakes, {:.4e} N m s/rad",
            w.gain().value,
            1e3 * w.lag_s(),
            w.braking()
        ));
    }
    for (c, late) in m.found_delays() {
        out.push(format!(
            "channel `{}`: {:.4} ms later than the bench says, found from the data",
            c.name(),
            1e3 * late
        ));
    }
    for r in m.runs.iter().filter(|r| r.clock.is_some()) {
        let (shortest, longest, gaps) = r.clock.expect("filtered");
        out.push(format!(
            "{}: an uneven clock (steps of {:.4} to {:.4} ms, {gaps} gaps), brought to even times by cubic interpolation",
            r.name,
            1e3 * shortest,
            1e3 * longest
        ));
    }
    out
}

/// A parameter in a few digits.
pub(super) fn told(name: &str, x: f64, unit: &str) -> String {
    let digits = if x != 0.0 && (x.abs() < 1e-3 || x.abs() >= 1e5) {
        format!("{x:.3e}")
    } else {
        format!("{x:.4}")
    };
    if unit == "-" {
        format!("{name} {digits}")
    } else {
        format!("{name} {digits} {unit}")
    }
}

pub(super) fn sentence(o: &Outcome, f: &Findings) -> String {
    let held = if o.material.held.is_some() {
        "held-out"
    } else {
        "fit (there are no held-out)"
    };
    let of_gap = |g: &ChannelGap| {
        let l = g.heldout.unwrap_or(g.fit);
        format!(
            "the gap in {} on {held} data went from {} (nominal) over {} (re-tuned) to {}, with a noise floor of {}",
            g.channel,
            told("", l.nominal, &g.unit).trim(),
            told("", l.retuned, &g.unit).trim(),
            told("", l.last, &g.unit).trim(),
            told("", l.floor, &g.unit).trim()
        )
    };
    // of the channels in which the effects live; without any, of the drive's
    let lives = |g: &&ChannelGap| {
        let mut terms = o.model.terms.iter();
        terms.any(|t| o.material.seen_in(t).name() == g.equation)
    };
    let mut gaps: Vec<String> = f.by_channel.iter().filter(lives).map(of_gap).collect();
    if gaps.is_empty() {
        gaps.extend(f.gap.as_ref().map(of_gap));
    }
    let gap = gaps.join("; ");
    let beside: Vec<String> = o
        .beside
        .iter()
        .map(|b| {
            let of = |x: f64| told("", x, b.unit).trim().to_string();
            format!("{} went from {} to {}", b.seen_in, of(b.before), of(b.after))
        })
        .collect();
    let gap = if beside.is_empty() {
        gap
    } else {
        format!("{} on {held} data; {gap}", beside.join("; "))
    };
    let names: Vec<String> = f
        .effects
        .iter()
        .map(|e| {
            let values: Vec<String> = e.parameters.iter().map(|p| told(&p.name, p.value, &p.unit)).collect();
            format!("{} ({})", e.name, values.join(", "))
        })
        .collect();
    let names = names.join(" and ");
    match o.verdict {
        Verdict::None => format!("Nothing is missing: {gap}."),
        Verdict::Retune => format!("Only constants are off: {gap}."),
        Verdict::Named => format!("Missing from the model: {names}; {gap}."),
        Verdict::NamedWithRemainder => {
            format!("Missing from the model: {names}, and something that has no name yet; {gap}.")
        }
        Verdict::Ambiguous => {
            let beside = o.beside.iter().flat_map(|b| &b.ambiguous);
            let others = o.ambiguous.iter().flat_map(|a| &a.1).chain(beside);
            let others: Vec<&str> = others.map(|k| k.name()).collect();
            format!(
                "Missing from the model: {names}, or {}, which these data cannot tell apart; {gap}.",
                others.join(" or ")
            )
        }
        Verdict::Candidate => format!(
            "Perhaps missing from the model: {names}; nothing was held out to prove it, and nothing is written; {gap}."
        ),
        Verdict::Unknown => format!("Something is missing, and it is none of the effects that are known here: {gap}."),
    }
}
