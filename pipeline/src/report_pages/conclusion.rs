//! The conclusion of a diagnosis in words: what was found, how sure that is, what to do next.

use crate::case::{Case, grounds, three};
use crate::digits;
use crate::report::{Lead, Point, Tone};
use diagnoser::diagnosis::{Area, Outcome};
use schemas::feature::{Feature, Role};

/// What the conclusion has to know beside the case.
pub(crate) struct Around {
    /// the recording as a shell takes it
    pub recording: String,
    /// the command that makes more of a recording that nothing explains, and what for
    pub next: Option<(String, String)>,
    /// the unit's file as a shell takes it, where one was given
    pub unit: Option<OfUnit>,
}

/// The unit that was tested.
pub(crate) struct OfUnit {
    /// its file as a shell takes it
    pub file: String,
    /// whether healthy tests of it are known, so that faults are relative to it
    pub relative: bool,
}

/// The faults of an area as they are told.
pub(crate) struct Told {
    /// estimate and ends of FSJ
    pub fsj: [String; 3],
    /// the same of zeta
    pub zeta: [String; 3],
}

impl Told {
    /// To as many digits as the intervals warrant.
    pub fn of(a: &Area) -> Self {
        Self {
            fsj: three(a.centroid.0, a.fsj),
            zeta: three(a.centroid.1, a.zeta),
        }
    }

    /// Both in a sentence.
    pub fn sentence(&self) -> String {
        let ([f, f0, f1], [z, z0, z1]) = (&self.fsj, &self.zeta);
        format!("FSJ is {f}, between {f0} and {f1}; zeta is {z}, between {z0} and {z1}.")
    }
}

/// A reason as a sentence of its own.
fn sentence(reason: &str) -> String {
    let mut letters = reason.trim_end_matches('.').chars();
    let first = letters.next().map(|c| c.to_uppercase().to_string());
    format!("{}{}.", first.unwrap_or_default(), letters.as_str())
}

fn point(label: &str, text: String) -> Point {
    Point {
        label: label.into(),
        text,
        command: None,
    }
}

/// What FSJ and zeta are, with the range of the maps.
pub(crate) fn terms(case: &Case, unit: Option<&OfUnit>) -> Vec<(String, String)> {
    let m = &case.diagnoser.maps.maps[0];
    let (f1, z1) = (m.fsj[m.fsj.len() - 1], m.zeta[m.zeta.len() - 1]);
    let healthy = match unit {
        Some(u) if u.relative => "1 is this unit when it was healthy",
        _ => "1 is healthy",
    };
    vec![
        (
            "FSJ".into(),
            format!("is the factor of dry friction in the transmission: {healthy}, the maps end at {f1}."),
        ),
        (
            "zeta".into(),
            format!(
                "(\u{3b6}) is the static eccentricity of the rotor as a share of the air gap: 0 is centred, the maps end \
                 at {z1}."
            ),
        ),
    ]
}

/// The conclusion, without its figure.
pub(crate) fn of_case(case: &Case, around: &Around) -> Lead {
    let mut lead = match &case.diagnosis.outcome {
        Outcome::Located(a) => located(case, a, around),
        Outcome::OutOfRange { reason } => out_of_range(reason, around),
        Outcome::Unexplained { contradicting, reason } => unexplained(case, contradicting, reason, around),
        Outcome::Incomplete { reason, area } => incomplete(case, reason, area.as_ref(), around),
    };
    lead.terms = terms(case, around.unit.as_ref());
    lead
}

/// Dry friction as a factor in words of everyday precision: at most two decimal places.
fn times(a: &Area) -> String {
    format!("{:.*}", digits::places(0.5 * a.fsj.width()).min(2), a.centroid.0)
}

/// An eccentricity as percentage, at most one decimal place.
fn percent(a: &Area) -> String {
    let places = digits::places(50.0 * a.zeta.width()).min(1);
    format!("{:.places$} %", 100.0 * a.centroid.1)
}

/// Whether the interval holds the healthy value of FSJ, and of zeta.
fn healthy(a: &Area) -> (bool, bool) {
    (a.fsj.contains(1.0), a.zeta.contains(0.0))
}

fn located(case: &Case, a: &Area, around: &Around) -> Lead {
    let told = Told::of(a);
    let mut found = told.sentence();
    if let Some(k) = &case.diagnosis.kinetic {
        let [k, k0, k1] = three(k.estimate, k.interval);
        found += &format!(" Dynamic friction by itself is {k} times that of the healthy model, between {k0} and {k1}.");
    }
    if a.parts.len() > 1 {
        found += &format!(
            " {} separate areas fit the test as well as each other; the intervals span all of them.",
            a.parts.len()
        );
    }
    let (f, z) = healthy(a);
    let (kind, finding, tone) = match (f, z) {
        (true, true) => (
            "Located: healthy",
            "No fault found: friction and rotor are as in a healthy actuator.".into(),
            Tone::Good,
        ),
        (true, false) => (
            "Located: eccentricity",
            format!(
                "The rotor stands off centre by {} of the air gap; friction is healthy.",
                percent(a)
            ),
            Tone::Fault,
        ),
        (false, true) => (
            "Located: friction",
            format!(
                "The transmission has {} times its healthy dry friction; the rotor is centred.",
                times(a)
            ),
            Tone::Fault,
        ),
        (false, false) => (
            "Located: friction and eccentricity",
            format!(
                "The transmission has {} times its healthy dry friction, and the rotor stands off centre by {} of the air gap.",
                times(a),
                percent(a)
            ),
            Tone::Fault,
        ),
    };
    let mut points = vec![point("Found", found)];
    let means = match (f, z) {
        (true, true) => format!(
            "Both intervals hold the healthy values. A fault smaller than their ends (FSJ {}, zeta {}) would not be seen.",
            told.fsj[2], told.zeta[2]
        ),
        (true, false) => ECCENTRICITY.into(),
        (false, true) => FRICTION.into(),
        (false, false) => format!("{FRICTION} {ECCENTRICITY}"),
    };
    points.push(point("What it means", means));
    points.push(point("How sure", sure(case)));
    points.push(if f && z { keep(around) } else { follow(around) });
    Lead {
        tone,
        kind: kind.into(),
        finding,
        points,
        ..Lead::default()
    }
}

const FRICTION: &str = "More dry friction leaves less torque for the load and delays every start from rest; wear and failing \
                        lubrication of gears, screw or bearings cause it.";
const ECCENTRICITY: &str = "An eccentric rotor draws more current and turns unevenly; worn bearings or a fault of manufacture \
                            cause it.";

/// What the intervals promise, on what grounds, and what they do not promise.
pub(crate) fn sure(case: &Case) -> String {
    let d = &case.diagnosis;
    let percent = 100.0 * d.coverage;
    if percent.is_nan() {
        return "The paper's own method states no probability; its bands are those of the maps (assumed).".into();
    }
    let promise = match grounds(case) {
        Some(tests) => {
            format!("Such intervals hold the true pair in {percent:.0} % of tests, calibrated on {tests}.")
        }
        None => format!(
            "The intervals are designed to hold the true pair in {percent:.0} % of tests; nothing has calibrated that."
        ),
    };
    let fit = d
        .misfit
        .filter(|m| m.0.is_finite() && m.1.is_finite())
        .map(|(q, most)| {
            format!(
                " All maps agree (misfit {:.1}, unexplained from {:.1} on).",
                q.max(0.0).sqrt(),
                most.max(0.0).sqrt()
            )
        });
    format!(
        "{promise}{} That holds for a real actuator as far as the model does.",
        fit.unwrap_or_default()
    )
}

/// After a healthy test.
fn keep(around: &Around) -> Point {
    let (text, command) = match &around.unit {
        Some(u) => (
            "Nothing to mend. Keep the test in the unit's history.",
            format!("ema unit update {} {}", u.file, around.recording),
        ),
        None => (
            "Nothing to mend; test again when the next check is due. If you are sure that the unit is healthy, this test \
             can make later ones relative to this very unit:",
            format!(
                "ema unit new unit.json && ema unit update unit.json {} --healthy",
                around.recording
            ),
        ),
    };
    Point {
        label: "What next".into(),
        text: text.into(),
        command: Some(command),
    }
}

/// After a test that located a fault.
fn follow(around: &Around) -> Point {
    let (text, command) = match &around.unit {
        Some(u) => (
            "Test again: the intervals of a second recording must overlap with these. Whether the actuator may stay in service is \
             for the limits of its maintenance to say; ema knows none. Keep both tests in the unit's history; over several of \
             them ema prognosis tells how much life is left.",
            format!("ema unit update {} {}", u.file, around.recording),
        ),
        None => (
            "Test again: the intervals of a second recording must overlap with these. Whether the actuator may stay in service is \
             for the limits of its maintenance to say; ema knows none. From the diagnoses of five tests or more (a log of ema \
             live, or a table) a prognosis tells the life that is left before a limit that you set:",
            "ema prognosis diagnoses.jsonl --threshold fsj=4 --threshold zeta=0.4".into(),
        ),
    };
    Point {
        label: "What next".into(),
        text: text.into(),
        command: Some(command),
    }
}

fn out_of_range(reason: &str, around: &Around) -> Lead {
    let below = reason.contains("below") && !reason.contains("above");
    let (finding, means, next) = if below {
        (
            "The actuator moves more easily than the healthy one of the maps.",
            "Less friction than healthy is no wear: the maps are most likely of another actuator, or of another unit of its \
             type.",
            "Name the actuator that was tested, or allow for units that differ:",
        )
    } else {
        (
            "At least one fault is greater than the maps reach.",
            "The fault is worse than the worst that the maps know, or the maps are of another actuator; there is no interval.",
            "Inspect the actuator before it is used again. Then make sure that the maps are of this actuator; if units differ, \
             say so:",
        )
    };
    Lead {
        tone: if below { Tone::Open } else { Tone::Fault },
        kind: "Out of range".into(),
        finding: finding.into(),
        points: vec![
            point("Found", sentence(reason)),
            point("What it means", means.into()),
            point(
                "How sure",
                "On which side is sure as far as the model is; how far beyond is an extrapolation of the maps.".into(),
            ),
            Point {
                label: "What next".into(),
                text: next.into(),
                command: Some(format!(
                    "ema diagnose {} --actuator ACTUATOR.toml --spread fleet",
                    around.recording
                )),
            },
        ],
        ..Lead::default()
    }
}

fn unexplained(case: &Case, contradicting: &[Feature], reason: &str, around: &Around) -> Lead {
    let mut found = sentence(reason);
    if !contradicting.is_empty() {
        let names = contradicting.iter().map(|f| format!("{} is {}", f.name(), f.title()));
        found += &format!(" Here {}.", names.collect::<Vec<_>>().join("; "));
        let maps = case.diagnoser.maps.maps.iter().map(|m| m.feature);
        let others = maps.filter(|f| f.role() == Role::Locates && !contradicting.contains(f));
        let others: Vec<&str> = others.map(Feature::name).collect();
        if reason.contains("the others") && !others.is_empty() {
            found += &format!(
                " The others are {}; the figure shows P1, P2 and P3 only.",
                others.join(", ")
            );
        }
    }
    let (command, why) = match &around.next {
        Some((command, why)) => (Some(command.clone()), format!(" The next command {why}:")),
        None => (None, String::new()),
    };
    // what speaks is the test, or the unit's own history
    let (finding, sure, again) = if contradicting.is_empty() && case.diagnoser.is_distrusted() {
        (
            "The model does not describe this unit: nothing is located with it.",
            "That the model misses something of the unit is what its own healthy tests say; what, a study of the unit may tell.",
            "Study the unit from recordings in which it was healthy.",
        )
    } else {
        (
            "No pair of friction and eccentricity explains this test.",
            "That the maps contradict each other is sure by far more than sensor noise; why is not known yet.",
            "Test again, to rule out a disturbed recording.",
        )
    };
    Lead {
        tone: Tone::Open,
        kind: "Unexplained".into(),
        finding: finding.into(),
        points: vec![
            point("Found", found),
            point(
                "What it means",
                "Something else is at work: another defect, a unit that differs from the model, a sensor, or a disturbance of \
                 the recording. No fault is located, and none is excluded."
                    .into(),
            ),
            point("How sure", sure.into()),
            Point {
                label: "What next".into(),
                text: format!("{again}{why}"),
                command,
            },
        ],
        ..Lead::default()
    }
}

fn incomplete(case: &Case, reason: &str, area: Option<&Area>, around: &Around) -> Lead {
    let missing = if case.missing.is_empty() {
        reason.to_string()
    } else {
        case.missing.join("; ")
    };
    let mut points = vec![point("What is missing", format!("{}.", missing.trim_end_matches('.')))];
    let finding = match area {
        Some(a) => {
            let told = Told::of(a).sentence();
            points.push(point("Found by the rest", told));
            points.push(point("How sure", sure(case)));
            "The recording is incomplete; what it holds allows an area of faults, which the rest could narrow."
        }
        None => {
            points.push(point(
                "How sure",
                "There is no finding: the actuator is neither healthy nor faulty by this test.".into(),
            ));
            "The recording is incomplete: it tells nothing about friction and eccentricity."
        }
    };
    points.push(Point {
        label: "What next".into(),
        text: "Record the whole test again, from before its first command to its end, with all channels; then the same command:"
            .into(),
        command: Some(match &around.unit {
            Some(u) => format!("ema diagnose {} --unit {}", around.recording, u.file),
            None => format!("ema diagnose {}", around.recording),
        }),
    });
    Lead {
        tone: Tone::Open,
        kind: "Incomplete".into(),
        finding: finding.into(),
        points,
        ..Lead::default()
    }
}
