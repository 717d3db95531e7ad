//! How far identified parameters are from the true ones.

use super::truth::{Found, Hidden, Parameter, Said};
use std::f64::consts::{PI, TAU};

/// An identified parameter beside the true one.
#[derive(Clone, Debug, PartialEq)]
pub struct Deviation {
    pub effect: String,
    pub parameter: String,
    /// relative; of a phase in rad; of a place over the width of what is there
    pub error: f64,
    pub inside: bool,
    /// a whole number (the number of a phase, an order that was not refined): right or wrong, without an interval
    pub discrete: bool,
}

/// Whole numbers that are chosen, not measured.
fn is_discrete(effect: &str, p: &Parameter) -> bool {
    (p.name == "order" && p.lo == p.hi) || (effect == "turn_short" && p.name == "phase")
}

/// True value as the study means it.
fn meant(effect: &str, parameter: &str, key: f64) -> f64 {
    match (effect, parameter) {
        // a factor in the key
        ("current_gain", "gain") => key - 1.0,
        _ => key,
    }
}

fn compare(hidden: &Hidden, found: &Parameter, key: f64) -> Deviation {
    let name = found.name.as_str();
    let mut truth = meant(&hidden.name, name, key);
    let Parameter { value, lo, hi, .. } = found.clone();
    let discrete = is_discrete(&hidden.name, found);
    let relative = |truth: f64| ((value - truth) / truth).abs();
    let error = match (hidden.name.as_str(), name) {
        _ if discrete => f64::from(u8::from((value - truth).abs() > 0.01)),
        (_, "phase") => {
            // the turn in which the identified one is
            truth = value + (truth - value + PI).rem_euclid(TAU) - PI;
            (value - truth).abs()
        }
        ("commutation_offset", "angle") => {
            // one direction looks like the other: by magnitude
            truth = truth.abs().copysign(value);
            relative(truth)
        }
        (_, "centre") => {
            let width = hidden.parameters.iter().find(|(k, _)| k == "width");
            (value - truth).abs() / width.map_or(truth.abs(), |(_, w)| w.abs())
        }
        _ => relative(truth),
    };
    Deviation {
        effect: hidden.name.clone(),
        parameter: found.name.clone(),
        error,
        inside: lo <= truth && truth <= hi,
        discrete,
    }
}

/// The found effect of the hidden one's name; of several, the one of its order.
fn counterpart<'a>(said: &'a Said, hidden: &Hidden) -> Option<&'a Found> {
    let of_name = || said.effects.iter().filter(|e| e.name == hidden.name);
    let order = hidden.parameters.iter().find(|(k, _)| k == "order").map(|(_, v)| *v);
    let same = |e: &&Found| {
        let own = e.parameters.iter().find(|p| p.name == "order").map(|p| p.value);
        own.zip(order).is_some_and(|(a, b)| (a - b).abs() < 0.01)
    };
    of_name().find(same).or_else(|| of_name().next())
}

/// Every parameter of a named effect that is hidden, where the law is the list's.
pub fn deviations(said: &Said, hidden: &[Hidden]) -> Vec<Deviation> {
    if !said.names_something() {
        return Vec::new();
    }
    let mut out = Vec::new();
    for h in hidden.iter().filter(|h| h.comparable) {
        let Some(found) = counterpart(said, h) else { continue };
        for p in &found.parameters {
            if let Some((_, key)) = h.parameters.iter().find(|(k, _)| *k == p.name) {
                out.push(compare(h, p, *key));
            }
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    fn check(effect: &str, key: &[(&str, f64)], name: &str, value: f64, half: f64) -> Deviation {
        let hidden = Hidden {
            name: effect.into(),
            parameters: key.iter().map(|(k, v)| (k.to_string(), *v)).collect(),
            comparable: true,
        };
        let parameter = Parameter {
            name: name.into(),
            value,
            lo: value - half,
            hi: value + half,
        };
        let said = Said {
            verdict: "named".into(),
            effects: vec![Found {
                name: effect.into(),
                parameters: vec![parameter],
                ..Found::default()
            }],
            ..Said::default()
        };
        deviations(&said, &[hidden]).remove(0)
    }

    #[test]
    fn errors_are_relative() {
        let d = check("backlash", &[("gap", 0.2), ("inertia", 1e-5)], "gap", 0.21, 0.02);
        assert!((d.error - 0.05).abs() < 1e-12 && d.inside && !d.discrete);
        assert!(!check("backlash", &[("gap", 0.2)], "gap", 0.21, 0.005).inside);
    }

    #[test]
    fn phases_turn() {
        let d = check("cogging", &[("phase", 3.1)], "phase", -3.1, 0.1);
        assert!((d.error - (TAU - 6.2)).abs() < 1e-12 && d.inside);
        assert!(!check("cogging", &[("phase", 3.1)], "phase", -3.1, 0.01).inside);
    }

    #[test]
    fn special_parameters() {
        let d = check("current_gain", &[("gain", 0.9)], "gain", -0.1, 0.01);
        assert!(d.error < 1e-9 && d.inside);
        let d = check("commutation_offset", &[("angle", -0.3)], "angle", 0.303, 0.01);
        assert!((d.error - 0.01).abs() < 1e-9 && d.inside);
        let d = check("tight_spot", &[("centre", 0.01), ("width", 10.0)], "centre", 0.51, 0.1);
        assert!((d.error - 0.05).abs() < 1e-9 && !d.inside);
        let d = check("turn_short", &[("phase", 2.0)], "phase", 1.0, 0.0);
        assert!(d.discrete && d.error == 1.0);
        let d = check("cogging", &[("order", 6.0)], "order", 6.0, 0.0);
        assert!(d.discrete && d.error == 0.0);
        let d = check("cogging", &[("order", 6.0)], "order", 6.003, 0.001);
        assert!(!d.discrete && !d.inside && (d.error - 5e-4).abs() < 1e-9);
    }

    #[test]
    fn nothing_is_compared_that_means_something_else() {
        let hidden = Hidden {
            name: "compliance".into(),
            parameters: vec![("stiffness".into(), 1.0)],
            comparable: false,
        };
        let found = Found {
            name: "compliance".into(),
            parameters: vec![Parameter {
                name: "stiffness".into(),
                value: 1.0,
                lo: 0.0,
                hi: 2.0,
            }],
            ..Found::default()
        };
        let mut said = Said {
            verdict: "named".into(),
            effects: vec![found],
            ..Said::default()
        };
        assert!(deviations(&said, std::slice::from_ref(&hidden)).is_empty());
        let comparable = Hidden {
            comparable: true,
            ..hidden
        };
        assert_eq!(deviations(&said, std::slice::from_ref(&comparable)).len(), 1);
        said.verdict = "unknown".into();
        assert!(deviations(&said, &[comparable]).is_empty());
    }
}
