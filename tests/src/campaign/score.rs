//! Right, wrong or missed.

use super::truth::{Hidden, Said};
use crate::blind::Class;

/// Largest ambiguity set that counts, with its separating command, as an answer.
const LARGEST_SET: usize = 3;

/// How a case ended. A case that is neither right nor wrong was missed.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Score {
    pub right: bool,
    /// misnamed; with nothing hidden, a false alarm
    pub wrong: bool,
    /// right through an ambiguity set only
    pub by_set: bool,
    /// of two hidden effects one was found, and no other name
    pub part: bool,
    /// a name that is not hidden stands beside those that are
    pub further: bool,
}

/// Names of the list that a law from outside may be taken for, with a remainder.
pub fn family(outside: &str) -> &'static [&'static str] {
    match outside {
        "end_stop_rub" => &["tight_spot"],
        "slipping_coupling" => &["backlash", "compliance"],
        "speed_current_product" => &["torque_saturation", "quadratic_drag", "viscous_asymmetry"],
        "acceleration_friction" => &["presliding", "load_dependent_friction"],
        "reversal_friction" => &["presliding", "stribeck"],
        _ => &[],
    }
}

/// The name is in the set of the first effect, which is small and comes with a command.
pub fn in_set(said: &Said, name: &str) -> bool {
    let Some(first) = said.effects.first() else {
        return false;
    };
    let small = first.ambiguous_with.len() < LARGEST_SET;
    small && said.has_command && (first.name == name || first.ambiguous_with.iter().any(|a| a == name))
}

/// Compares a verdict with what was hidden.
pub fn score(class: Class, said: &Said, hidden: &[Hidden]) -> Score {
    let named = said.names_something();
    let found = |name: &str| said.effects.iter().any(|e| e.name == name);
    let is_hidden = |name: &str| hidden.iter().any(|h| h.name == name);
    let strange = said.effects.iter().any(|e| !is_hidden(&e.name));
    match class {
        Class::Nothing => Score {
            right: ["none", "retune"].contains(&said.verdict.as_str()),
            wrong: named,
            ..Score::default()
        },
        Class::One => {
            let name = hidden.first().map_or("", |h| &h.name);
            let first = said.effects.first().is_some_and(|e| e.name == name);
            let by_set = named && !first && in_set(said, name);
            let right = named && first || by_set;
            Score {
                right,
                wrong: named && !right,
                by_set,
                further: right && said.effects.iter().skip(1).any(|e| e.name != name),
                ..Score::default()
            }
        }
        Class::Two => {
            let right = named && !hidden.is_empty() && hidden.iter().all(|h| found(&h.name));
            Score {
                right,
                wrong: named && !right && strange,
                part: named && !right && !strange,
                further: right && strange,
                ..Score::default()
            }
        }
        Class::Outside => {
            let relatives = hidden.first().map_or(&[][..], |h| family(&h.name));
            let related = !said.effects.is_empty() && said.effects.iter().all(|e| relatives.contains(&e.name.as_str()));
            let right = said.verdict == "unknown" || (said.verdict == "named_with_remainder" && related);
            Score {
                right,
                wrong: named && !right,
                ..Score::default()
            }
        }
    }
}

pub use ema_query::stats::wilson;

#[cfg(test)]
mod tests {
    use super::super::truth::Found;
    use super::*;

    fn said(verdict: &str, names: &[&str], set: &[&str], has_command: bool) -> Said {
        let mut effects: Vec<Found> = names
            .iter()
            .map(|n| Found {
                name: n.to_string(),
                ..Found::default()
            })
            .collect();
        if let Some(e) = effects.first_mut() {
            e.ambiguous_with = set.iter().map(|s| s.to_string()).collect();
        }
        Said {
            verdict: verdict.into(),
            effects,
            has_command,
            ..Said::default()
        }
    }

    fn hidden(names: &[&str]) -> Vec<Hidden> {
        let one = |n: &&str| Hidden {
            name: n.to_string(),
            ..Hidden::default()
        };
        names.iter().map(one).collect()
    }

    fn ends(class: Class, truth: &[&str], s: Said) -> (bool, bool) {
        let s = score(class, &s, &hidden(truth));
        (s.right, s.wrong)
    }

    const RIGHT: (bool, bool) = (true, false);
    const WRONG: (bool, bool) = (false, true);
    const MISSED: (bool, bool) = (false, false);

    #[test]
    fn wilson_bounds() {
        let near = |(a, b): (f64, f64), (c, d): (f64, f64)| (a - c).abs() < 5e-4 && (b - d).abs() < 5e-4;
        // Brown, Cai and DasGupta's interval, by hand
        assert!(near(wilson(50, 100), (0.4038, 0.5962)));
        assert!(near(wilson(0, 100), (0.0, 0.0370)));
        assert!(near(wilson(100, 100), (0.9630, 1.0)));
        assert!(near(wilson(97, 100), (0.9155, 0.9897)));
        assert_eq!(wilson(0, 0), (0.0, 1.0));
        for n in 1..60 {
            for k in 0..=n {
                let (lo, hi) = wilson(k, n);
                let p = k as f64 / n as f64;
                assert!(0.0 <= lo && lo <= p && p <= hi + 1e-12 && hi <= 1.0);
                let (a, b) = wilson(n - k, n);
                assert!((a - (1.0 - hi)).abs() < 1e-12 && (b - (1.0 - lo)).abs() < 1e-12);
            }
        }
    }

    #[test]
    fn nothing_hidden() {
        for (verdict, end) in [
            ("none", RIGHT),
            ("retune", RIGHT),
            ("named", WRONG),
            ("ambiguous", WRONG),
            ("named_with_remainder", WRONG),
            ("unknown", MISSED),
            ("error", MISSED),
        ] {
            assert_eq!(
                ends(Class::Nothing, &[], said(verdict, &["cogging"], &[], true)),
                end,
                "{verdict}"
            );
        }
    }

    #[test]
    fn one_hidden() {
        let one = |s| ends(Class::One, &["backlash"], s);
        assert_eq!(one(said("named", &["backlash"], &[], false)), RIGHT);
        assert_eq!(
            one(said("named_with_remainder", &["backlash", "cogging"], &[], false)),
            RIGHT
        );
        assert_eq!(one(said("named", &["cogging", "backlash"], &[], false)), WRONG);
        assert_eq!(one(said("ambiguous", &["compliance"], &["backlash"], true)), RIGHT);
        assert_eq!(one(said("ambiguous", &["compliance"], &["backlash"], false)), WRONG);
        assert_eq!(one(said("ambiguous", &["a"], &["b", "backlash"], true)), RIGHT);
        assert_eq!(one(said("ambiguous", &["a"], &["b", "c", "backlash"], true)), WRONG);
        for verdict in ["none", "retune", "unknown", "error"] {
            assert_eq!(one(said(verdict, &["backlash"], &[], true)), MISSED, "{verdict}");
        }
        let s = said("ambiguous", &["compliance"], &["backlash"], true);
        assert!(score(Class::One, &s, &hidden(&["backlash"])).by_set);
        let s = said("named", &["backlash", "cogging"], &[], true);
        assert!(score(Class::One, &s, &hidden(&["backlash"])).further);
    }

    #[test]
    fn two_hidden() {
        let two = |s| ends(Class::Two, &["backlash", "cogging"], s);
        assert_eq!(two(said("named", &["cogging", "backlash"], &[], false)), RIGHT);
        assert_eq!(
            two(said("named", &["stribeck", "cogging", "backlash"], &[], false)),
            RIGHT
        );
        assert_eq!(two(said("named", &["cogging"], &[], false)), MISSED);
        assert_eq!(two(said("named", &["cogging", "stribeck"], &[], false)), WRONG);
        assert_eq!(two(said("unknown", &["cogging", "backlash"], &[], false)), MISSED);
        assert_eq!(two(said("retune", &[], &[], false)), MISSED);
        let s = said("named", &["cogging"], &[], false);
        assert!(score(Class::Two, &s, &hidden(&["backlash", "cogging"])).part);
    }

    #[test]
    fn outside_the_list() {
        let outside = |truth, s| ends(Class::Outside, &[truth], s);
        assert_eq!(outside("end_stop_rub", said("unknown", &[], &[], false)), RIGHT);
        assert_eq!(
            outside("end_stop_rub", said("unknown", &["cogging"], &[], false)),
            RIGHT
        );
        let rest = "named_with_remainder";
        assert_eq!(outside("end_stop_rub", said(rest, &["tight_spot"], &[], false)), RIGHT);
        assert_eq!(outside("end_stop_rub", said(rest, &["cogging"], &[], false)), WRONG);
        assert_eq!(
            outside("end_stop_rub", said(rest, &["tight_spot", "cogging"], &[], false)),
            WRONG
        );
        assert_eq!(
            outside("end_stop_rub", said("named", &["tight_spot"], &[], false)),
            WRONG
        );
        assert_eq!(
            outside("slipping_coupling", said(rest, &["compliance"], &[], false)),
            RIGHT
        );
        assert_eq!(
            outside("speed_dependent_inertia", said(rest, &["stribeck"], &[], false)),
            WRONG
        );
        assert_eq!(
            outside("reversal_friction", said("ambiguous", &["stribeck"], &[], true)),
            WRONG
        );
        assert_eq!(outside("reversal_friction", said("retune", &[], &[], false)), MISSED);
    }

    #[test]
    fn families_are_of_names_that_exist() {
        use crate::blind::Kind;
        for kind in Kind::OUTSIDE {
            for name in family(kind.name()) {
                let known = Kind::from_name(name).unwrap();
                assert!(Kind::LIST.contains(&known));
            }
        }
    }
}
