//! The effect enters the actuator's file: constants and `[[effect]]` tables with intervals and
//! provenance. What a study did not touch stays as it was, comments too.

use crate::measured::bench::{Bench, Known};
use crate::told::findings::{FoundEffect, Identified};
use schemas::error::{Error, Result};
use schemas::toml_section;
use sim_worker::effect::{Effect, EffectKind, NORMAL_95, Note};
use sim_worker::parameters::{ActuatorParameters, Uncertainty};
use std::collections::BTreeMap;

/// Relative standard deviation that no constant is known better than (assumed): the equations are not the machine.
const LEAST_DEVIATION: f64 = 5e-4;

/// A constant as it stands in the actuator's file.
pub struct Replaced {
    /// relative standard deviation, and the place among the constants that were identified
    pub deviation: f64,
    pub place: usize,
    pub section: &'static str,
    pub key: &'static str,
    pub unit: &'static str,
    pub value: f64,
}

fn relative_deviation(r: &Identified) -> f64 {
    (0.5 * (r.hi - r.lo) / NORMAL_95 / r.value.abs().max(1e-300)).clamp(LEAST_DEVIATION, 10.0)
}

/// Where the constants of a study stand in the file, and what is written there.
///
/// * `with_current` the drive channel is the motor's current, so that its constant is kt
pub fn replaced(retuned: &[Identified], a: &ActuatorParameters, with_current: bool) -> Vec<Replaced> {
    let mut out = Vec::new();
    for (place, r) in retuned.iter().enumerate() {
        let deviation = relative_deviation(r);
        let (section, key, unit, value) = match r.name.as_str() {
            "inertia" => ("motor", "inertia_kg_m2", "kg m2", r.value),
            "viscous" => ("motor", "viscous_n_m_s_per_rad", "N m s/rad", r.value),
            "coulomb" if a.dynamic_friction_ratio > 0.0 => {
                ("friction", "static_n_m", "N m", r.value / a.dynamic_friction_ratio)
            }
            "torque_constant" if with_current => ("motor", "back_emf_v_s_per_rad", "V s/rad", 0.5 * r.value),
            "resistance" => ("motor", "phase_resistance_ohm", "ohm", 0.5 * r.value),
            "inductance" => ("motor", "phase_inductance_h", "H", 0.5 * r.value),
            "supply_voltage" => ("supply", "voltage_v", "V", r.value),
            "play" => (
                "transmission",
                "backlash_half_width_rad",
                "rad",
                r.value.max(0.0) / a.gear_ratio,
            ),
            _ => continue,
        };
        // what cannot be told from the file's value stays as it is
        let near = |n: f64| (n - r.value).abs() < 0.35 * (r.hi - r.lo);
        let kept = r.name == "play" && r.nominal.is_some_and(near);
        if kept {
            continue;
        }
        out.push(Replaced {
            deviation,
            place,
            section,
            key,
            unit,
            value,
        });
    }
    out
}

/// How well the constants of a file are known, but for the supply: it is measured, and what a sensor's scale does to it, it does to
/// the constants that follow from voltages.
///
/// * `correlation` of all constants that were identified, row by row
pub fn uncertainty(constants: &[Replaced], correlation: &[f64]) -> Uncertainty {
    let n = (correlation.len() as f64).sqrt() as usize;
    let of = |a: usize, b: usize| correlation.get(a * n + b).copied().unwrap_or(f64::from(a == b));
    let constants: Vec<&Replaced> = constants.iter().filter(|c| c.section != "supply").collect();
    let constants = &constants;
    Uncertainty {
        parameters: constants.iter().map(|c| format!("{}.{}", c.section, c.key)).collect(),
        deviation: constants.iter().map(|c| c.deviation).collect(),
        correlation: constants
            .iter()
            .flat_map(|a| constants.iter().map(move |b| of(a.place, b.place)))
            .collect(),
    }
}

/// A rig that is no actuator of ours, with what was found: `[rig]` and `[[effect]]` as they may stand in a bench file.
/// SI at the motor; the trust of what was identified is its relative standard deviation.
///
/// * `bench` as it was read, before anything was found
/// * `source` provenance in words
pub fn rig(bench: &Bench, retuned: &[Identified], effects: &[Effect], source: &str) -> String {
    let rig = &bench.rig;
    let mut out = format!(
        "# What a study found of the rig of {}. SI at the motor; trust: relative, one sigma, of each constant alone.\n\
         # [rig] and [[effect]] may stand in a bench file as they are; a controller's law is not repeated here.\n\
         [rig]\nkind = \"{}\"\ndrive = \"{}\"\n",
        toml_section::quoted(&bench.file),
        if rig.linear { "linear" } else { "rotary" },
        rig.drive.name()
    );
    if let Some(lead) = rig.lead {
        out += &format!("lead_m_per_turn = {:?}\n", lead * std::f64::consts::TAU);
    }
    let plain = |value: f64| Known { value, trust: None };
    let identified = |name: &str| {
        let found = retuned.iter().find(|r| r.name == name)?;
        Some(Known {
            value: found.value.max(0.0),
            trust: Some(relative_deviation(found)),
        })
    };
    // as it was said: of the motor, with what lies before it
    let behind = rig.winding.map(|w| {
        let gain = identified("torque_constant").unwrap_or(rig.drive_constant);
        let viscous = identified("viscous").unwrap_or(rig.viscous);
        ["drive_constant", "resistance", "inductance", "viscous"]
            .into_iter()
            .zip(w.behind(gain, viscous))
    });
    let motors: BTreeMap<&str, Known> = behind.into_iter().flatten().collect();
    let of_drive = if motors.is_empty() {
        rig.constant_unit()
    } else {
        "N m/A"
    };
    let constants = [
        ("drive_constant", "torque_constant", rig.drive_constant, of_drive),
        ("inertia", "inertia", rig.inertia, "kg m2"),
        ("viscous", "viscous", rig.viscous, "N m s/rad"),
        ("coulomb", "coulomb", rig.coulomb, "N m"),
        ("resistance", "resistance", rig.resistance, "ohm"),
        ("inductance", "inductance", rig.inductance, "H"),
        ("back_emf_constant", "", rig.back_emf, "V s/rad"),
        ("gear_ratio", "", plain(rig.gear_ratio), "-"),
        ("pole_pairs", "", plain(rig.pole_pairs), "-"),
        ("supply_voltage", "", plain(rig.supply_voltage), "V"),
    ];
    for (key, name, given, unit) in constants {
        let assumed = rig.assumed.iter().any(|a| a.0 == key);
        let (known, source) = match motors.get(key).copied().or_else(|| identified(name)) {
            Some(known) if motors.contains_key(key) => {
                let what = "drive_constant / resistance and viscous with the braking of the back-EMF";
                (known, format!("identified, {what}: {source}"))
            }
            Some(known) => (known, format!("identified: {source}")),
            // the winding's is the drive constant
            None if !motors.is_empty() && key == "back_emf_constant" => continue,
            // its own value is that of the drive constant
            None if assumed && (key == "back_emf_constant" || !(given.value > 0.0 && given.value.is_finite())) => {
                out += &format!("# {key}: neither said nor seen\n");
                continue;
            }
            None if assumed => (given, "assumed: the bench does not say it".to_string()),
            None => (given, "as the bench says".to_string()),
        };
        let trust = known.trust.map_or(String::new(), |t| format!(", trust = {t:?}"));
        let (value, source) = (known.value, toml_section::quoted(&source));
        out += &format!("{key} = {{ value = {value:?}, unit = \"{unit}\"{trust}, source = {source} }}\n");
    }
    let offset = retuned.iter().find(|r| r.name == "offset");
    let offset = offset.map_or(rig.offset, |r| r.value);
    if offset != 0.0 {
        out += &format!("offset = {{ value = {offset:?}, unit = \"N m\" }}\n");
    }
    for e in effects {
        out += &format!("\n{}", e.to_toml());
    }
    out
}

/// The actuator's file with constants replaced and effects appended; checked by reading it again.
///
/// * `source` provenance in words
pub fn written(
    file: &str,
    text: &str,
    constants: &[Replaced],
    correlation: &[f64],
    effects: &[Effect],
    source: &str,
) -> Result<String> {
    let before = ActuatorParameters::parse(file, text)?;
    let mut lines: Vec<String> = text.lines().map(str::to_string).collect();
    for c in constants {
        let line = format!(
            "{} = {{ value = {:?}, unit = \"{}\", source = \"identified: {source}\" }}",
            c.key, c.value, c.unit
        );
        let header = format!("[{}]", c.section);
        let start = lines.iter().position(|l| l.trim() == header);
        let start =
            start.ok_or_else(|| Error::bad(file, format!("section {header}"), "nothing", "a section of its own"))?;
        let end = lines[start + 1..]
            .iter()
            .position(|l| l.trim_start().starts_with('['))
            .map_or(lines.len(), |e| start + 1 + e);
        let is = |l: &String| l.split('=').next().is_some_and(|k| k.trim() == c.key);
        match lines[start + 1..end].iter().position(is) {
            Some(at) => lines[start + 1 + at] = line,
            None => lines.insert(start + 1, line),
        }
    }
    let known = |c: &Replaced| c.section == "motor" && c.key == "back_emf_v_s_per_rad";
    if constants.iter().any(known) && before.drive_constant_n_m_per_a == 0.0 {
        // the drive goes on to reckon with its type's
        let line = format!(
            "drive_constant_n_m_per_a = {{ value = {:?}, unit = \"N m/A\", source = \"of the type\" }}",
            before.drive_constant()
        );
        if let Some(at) = lines.iter().position(|l| l.trim() == "[controller]") {
            lines.insert(at + 1, line);
        }
    }
    // what an earlier study knew of it is no longer so
    if let Some(at) = lines.iter().position(|l| l.trim() == "[uncertainty]") {
        let end = lines[at + 1..]
            .iter()
            .position(|l| l.trim_start().starts_with('[') && l.contains("]]"));
        let end = end.map_or(lines.len(), |e| at + 1 + e);
        lines.drain(at..end);
    }
    let table = uncertainty(constants, correlation).to_toml();
    // before the tables of effects, which are the end of a file
    let at = lines
        .iter()
        .position(|l| l.trim() == "[[effect]]")
        .unwrap_or(lines.len());
    lines.splice(at..at, table.lines().map(str::to_string));
    let mut out = lines.join("\n").trim_end().to_string() + "\n";
    for e in effects {
        out += "\n";
        out += &e.to_toml();
    }
    ActuatorParameters::parse(file, &out)?;
    Ok(out)
}

/// An effect as it is written: value, interval, source and provenance.
///
/// * `parent` fingerprint of the actuator that it is added to, if it is one
pub fn effect(found: &FoundEffect, parent: Option<&str>, source: &str, notes: Vec<(String, Note)>) -> Option<Effect> {
    let kind = EffectKind::from_name(&found.name)?;
    let mut values = [0.0; 3];
    let mut intervals = [(0.0, 0.0); 3];
    for (i, key) in kind.keys().iter().enumerate() {
        let p = found.parameters.iter().find(|p| p.name == key.name)?;
        values[i] = p.value.clamp(key.low, key.high);
        intervals[i] = (p.lo.max(key.low).min(values[i]), p.hi.min(key.high).max(values[i]));
    }
    let mut e = Effect::new(kind, &values[..kind.keys().len()]);
    e.intervals = Some(intervals);
    e.law = found.law;
    let n = kind.keys().len();
    if n > 1 && found.correlation.len() == n * n {
        let above = (0..n).flat_map(|i| (i + 1..n).map(move |k| i * n + k));
        let mut pairs = [0.0; 3];
        pairs
            .iter_mut()
            .zip(above)
            .for_each(|(r, at)| *r = found.correlation[at]);
        e.correlation = Some(pairs);
    }
    e.source = format!("identified: {source}");
    e.parent = parent.map(str::to_string);
    e.provenance = notes;
    e.provenance.sort_by(|a, b| a.0.cmp(&b.0));
    Some(e)
}

/// Line by line: what both have, what only the old has (`-`), what only the new has (`+`), with a few
/// lines of context.
pub fn diff(old: &str, new: &str) -> Vec<String> {
    let (a, b): (Vec<&str>, Vec<&str>) = (old.lines().collect(), new.lines().collect());
    // the longest common subsequence; the files are short
    let mut common = vec![vec![0_u32; b.len() + 1]; a.len() + 1];
    for i in (0..a.len()).rev() {
        for j in (0..b.len()).rev() {
            common[i][j] = if a[i] == b[j] {
                common[i + 1][j + 1] + 1
            } else {
                common[i + 1][j].max(common[i][j + 1])
            };
        }
    }
    let (mut i, mut j) = (0, 0);
    let mut all = Vec::new();
    while i < a.len() || j < b.len() {
        if i < a.len() && j < b.len() && a[i] == b[j] {
            all.push(format!(" {}", a[i]));
            i += 1;
            j += 1;
        } else if j >= b.len() || i < a.len() && common[i + 1][j] >= common[i][j + 1] {
            all.push(format!("-{}", a[i]));
            i += 1;
        } else {
            all.push(format!("+{}", b[j]));
            j += 1;
        }
    }
    let near = |k: usize| {
        all[k.saturating_sub(2)..(k + 3).min(all.len())]
            .iter()
            .any(|l| !l.starts_with(' '))
    };
    (0..all.len()).filter(|&k| near(k)).map(|k| all[k].clone()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn constants_and_effects_read_back_and_the_rest_stays() {
        let text = include_str!("../../../../datasets/parameters/reference.toml");
        let a = ActuatorParameters::reference();
        let retuned = [Identified {
            name: "coulomb".into(),
            value: 0.063,
            lo: 0.06,
            hi: 0.066,
            unit: "N m".into(),
            nominal: Some(0.021),
        }];
        let mut cogging = Effect::new(EffectKind::Cogging, &[0.003, 0.5, 12.0]);
        cogging.source = "identified: here".into();
        let new = written(
            "new.toml",
            text,
            &replaced(&retuned, &a, true),
            &[1.0],
            &[cogging.clone()],
            "bench \"x\"".replace('"', "'").as_str(),
        )
        .unwrap();
        let b = ActuatorParameters::parse("new.toml", &new).unwrap();
        assert!((b.static_friction_n_m - 0.09).abs() < 1e-12);
        assert_eq!(b.identified, ["friction.static_n_m"]);
        assert_eq!(b.effects[0].values, cogging.values);
        assert_ne!(a.fingerprint(), b.fingerprint());
        let d = diff(text, &new);
        assert_eq!(d.iter().filter(|l| l.starts_with('-')).count(), 1, "{d:?}");
        assert!(new.contains("# Reference actuator"));
    }
}
