//! The classes of the campaign and the seeds of their cases.

use crate::blind::{Class, Rig, Setting, Spec};

/// A class of cases.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Plan {
    pub rig: Rig,
    pub class: Class,
    pub setting: Setting,
    pub severity: f64,
}

const fn servo(class: Class, setting: Setting, severity: f64) -> Plan {
    Plan {
        rig: Rig::Servo,
        class,
        setting,
        severity,
    }
}

/// Every class.
pub const ALL: [Plan; 10] = [
    servo(Class::Nothing, Setting::Matched, 1.0),
    servo(Class::Nothing, Setting::Other, 1.0),
    servo(Class::One, Setting::Matched, 1.0),
    servo(Class::One, Setting::Other, 1.0),
    servo(Class::One, Setting::Matched, 0.1),
    servo(Class::Two, Setting::Matched, 1.0),
    servo(Class::Two, Setting::Other, 1.0),
    servo(Class::Outside, Setting::Matched, 1.0),
    servo(Class::Outside, Setting::Other, 1.0),
    Plan {
        rig: Rig::ThreePhase,
        class: Class::One,
        setting: Setting::Matched,
        severity: 1.0,
    },
];

impl Plan {
    /// As in `--only`.
    pub fn label(&self) -> String {
        let rig = if self.rig == Rig::ThreePhase {
            "three_phase/"
        } else {
            ""
        };
        let end = match self.class {
            Class::Nothing => String::new(),
            _ => format!("/{}", self.severity),
        };
        format!("{rig}{}/{}{end}", self.class.name(), self.setting.name())
    }

    /// Name of its files.
    pub fn slug(&self) -> String {
        self.label().replace('/', "-")
    }

    /// How many cases of `cases` asked for.
    pub fn count(&self, cases: u64) -> u64 {
        match self.rig {
            Rig::Servo => cases,
            Rig::ThreePhase => (2 * cases).div_ceil(5),
        }
    }

    /// What the generator makes.
    pub fn spec(&self) -> Spec {
        Spec {
            class: self.class,
            setting: self.setting,
            severity: self.severity,
            rig: self.rig,
            ..Spec::default()
        }
    }

    /// Seed of a case: the same in every campaign with the same seed.
    pub fn seed(&self, campaign: u64, case: u64) -> u64 {
        let mut text = self.label().into_bytes();
        text.extend(campaign.to_le_bytes());
        text.extend(case.to_le_bytes());
        // FNV-1a
        text.iter().fold(0xcbf2_9ce4_8422_2325, |h, b| {
            (h ^ u64::from(*b)).wrapping_mul(0x0100_0000_01b3)
        })
    }

    /// Whether `only` is its label or the beginning of it, severities as numbers.
    fn is_meant_by(&self, only: &str) -> bool {
        let label = self.label();
        let (mut wanted, mut own) = (only.split('/'), label.split('/'));
        let number = |s: &str| s.parse::<f64>().ok();
        wanted.all(|w| match own.next() {
            Some(o) => w == o || (number(w).is_some() && number(w) == number(o)),
            // nothing hidden has no severity
            None => number(w).is_some() && self.class == Class::Nothing,
        })
    }
}

/// The classes asked for, all where nothing is said.
pub fn chosen(only: &[String]) -> Result<Vec<Plan>, String> {
    for o in only {
        if !ALL.iter().any(|p| p.is_meant_by(o)) {
            let labels = ALL.map(|p| p.label());
            return Err(format!("no class is called {o}; there are {}", labels.join(", ")));
        }
    }
    let wanted = |p: &Plan| only.is_empty() || only.iter().any(|o| p.is_meant_by(o));
    Ok(ALL.into_iter().filter(wanted).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn labels(only: &[&str]) -> Vec<String> {
        let only: Vec<String> = only.iter().map(|s| s.to_string()).collect();
        chosen(&only).unwrap().iter().map(Plan::label).collect()
    }

    #[test]
    fn classes_are_chosen_by_the_beginning_of_their_label() {
        assert_eq!(labels(&[]).len(), ALL.len());
        assert_eq!(labels(&["one"]), ["one/matched/1", "one/other/1", "one/matched/0.1"]);
        assert_eq!(labels(&["one/matched/0.1"]), ["one/matched/0.1"]);
        assert_eq!(labels(&["one/matched/1.0"]), ["one/matched/1"]);
        assert_eq!(labels(&["nothing/other/1.0"]), ["nothing/other"]);
        assert_eq!(
            labels(&["three_phase", "two/other"]),
            ["two/other/1", "three_phase/one/matched/1"]
        );
        assert!(chosen(&["one/matched/0.5".into()]).is_err());
        assert!(chosen(&["thr".into()]).is_err());
    }

    #[test]
    fn seeds_differ_by_class_case_and_campaign() {
        let mut seeds: Vec<u64> = ALL
            .iter()
            .flat_map(|p| (0..100).flat_map(move |n| [p.seed(1, n), p.seed(2, n)]))
            .collect();
        let all = seeds.len();
        seeds.sort_unstable();
        seeds.dedup();
        assert_eq!(seeds.len(), all);
        assert_eq!(ALL[0].seed(1, 0), ALL[0].seed(1, 0));
    }
}
