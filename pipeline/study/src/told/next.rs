//! What to do next: the command that tells apart what could not be told apart, or the one that uses
//! the new model.

use crate::told::findings::Findings;
use std::path::{Path, PathBuf};

/// Quantity in which effects differ, and the command that brings it out.
struct Experiment {
    name: &'static str,
    why: &'static str,
    /// segments of a test sequence
    segments: &'static str,
}

/// The dictionary of commands (assumed amplitudes: within a stroke of 1 rad at the user).
const STAIRCASE: Experiment = Experiment {
    name: "staircase",
    why: "slow motion at several speeds in both directions with rests: friction against speed, bias against friction, play and presliding at the reversals",
    segments: "[[segment]]\ncommand = \"ramp\"\nslope_rad_per_s = 0.05\nduration_s = 2.0\n\n\
        [[segment]]\ncommand = \"hold\"\nvalue_rad = 0.1\nduration_s = 0.5\n\n\
        [[segment]]\ncommand = \"ramp\"\nslope_rad_per_s = 0.4\nduration_s = 1.0\n\n\
        [[segment]]\ncommand = \"hold\"\nvalue_rad = 0.4\nduration_s = 0.5\n\n\
        [[segment]]\ncommand = \"step\"\nheight_rad = 0.0\nduration_s = 1.5\n\n\
        [[segment]]\ncommand = \"ramp\"\nslope_rad_per_s = -0.05\nduration_s = 2.0\n\n\
        [[segment]]\ncommand = \"ramp\"\nslope_rad_per_s = -0.4\nduration_s = 1.0\n\n\
        [[segment]]\ncommand = \"hold\"\nvalue_rad = -0.4\nduration_s = 0.5\n",
};
const CHIRP: Experiment = Experiment {
    name: "chirp",
    why: "rising frequency: inertia, spring and gap differ where a resonance would be, and in how the gap depends on amplitude",
    segments: "[[segment]]\ncommand = \"chirp\"\namplitude_rad = 0.02\nfrom_hz = 0.5\nto_hz = 25.0\nduration_s = 6.0\n\n\
        [[segment]]\ncommand = \"hold\"\nvalue_rad = 0.0\nduration_s = 0.5\n\n\
        [[segment]]\ncommand = \"chirp\"\namplitude_rad = 0.002\nfrom_hz = 0.5\nto_hz = 25.0\nduration_s = 6.0\n",
};
const STEPS: Experiment = Experiment {
    name: "steps",
    why: "steps of three heights: what goes with current, with speed and with its square separates",
    segments: "[[segment]]\ncommand = \"step\"\nheight_rad = 0.2\nduration_s = 1.0\n\n\
        [[segment]]\ncommand = \"step\"\nheight_rad = -0.2\nduration_s = 1.0\n\n\
        [[segment]]\ncommand = \"step\"\nheight_rad = 0.5\nduration_s = 1.2\n\n\
        [[segment]]\ncommand = \"step\"\nheight_rad = -0.5\nduration_s = 1.5\n\n\
        [[segment]]\ncommand = \"step\"\nheight_rad = 0.05\nduration_s = 1.0\n",
};
const LOADS: Experiment = Experiment {
    name: "multisine_with_load_steps",
    why: "a multisine while the load steps between two levels of either sign, once holding still under load: what goes with load, current and friction separates, and a sensor's offset shows where no torque is asked for",
    segments: "[[segment]]\ncommand = \"multisine\"\namplitude_rad = 0.05\nfrequency_hz = 0.5\nduration_s = 8.0\n\n\
        [[segment]]\ncommand = \"hold\"\nvalue_rad = 0.0\nduration_s = 2.0\n",
};

/// The command under which two effects differ most, by what their equations depend on.
fn separating(a: &str, b: &str) -> &'static Experiment {
    let is = |names: &[&str]| names.contains(&a) || names.contains(&b);
    if is(&["compliance", "backlash", "presliding", "encoder_eccentricity"]) && !is(&["stribeck", "lubricated_rise"]) {
        &CHIRP
    } else if is(&[
        "current_offset",
        "current_gain",
        "load_dependent_friction",
        "dead_time",
        "winding_heating",
        "supply_sag",
    ]) {
        &LOADS
    } else if is(&[
        "quadratic_drag",
        "torque_saturation",
        "viscous_asymmetry",
        "control_delay",
    ]) {
        &STEPS
    } else {
        &STAIRCASE
    }
}

/// What a study was asked for and what it has written.
#[derive(Clone, Copy)]
pub struct Around<'a> {
    /// the command of the study, but for its folder
    pub command: &'a str,
    /// folder of what is written
    pub out: Option<&'a Path>,
    /// the actuator's file with what was found
    pub model: Option<&'a Path>,
    /// file of a rig that is no actuator of ours, with what was found
    pub rig: Option<&'a Path>,
    /// why neither was written, or why an actuator that was written cannot be diagnosed
    pub against: Option<&'a str>,
}

/// Fills in what comes next; returns the file of a test sequence to be written.
pub fn next(f: &mut Findings, around: &Around<'_>) -> Option<(PathBuf, String)> {
    let shown = |p: &Path| p.display().to_string();
    let pair = f
        .effects
        .iter()
        .find_map(|e| e.ambiguous_with.first().map(|o| (e.name.clone(), o.clone())))
        .filter(|_| f.verdict == "ambiguous" || f.effects.iter().any(|e| !e.ambiguous_with.is_empty()));
    let experiment = match (&pair, f.verdict.as_str()) {
        (Some((a, b)), _) => {
            let why = format!("{a} and {b} cannot be told apart: drive the rig with this sequence");
            Some((separating(a, b), format!("Tells {a} from {b}"), why))
        }
        (None, "unknown") => {
            let why = "what is missing has no name: a recording under this sequence shows it alone".to_string();
            Some((&STAIRCASE, "For a gap without a name".to_string(), why))
        }
        _ => None,
    };
    let folder = around.out.map_or("study".into(), shown);
    let study = |more: &str| format!("{}{more} --out {folder}", around.command);
    if let Some((e, title, why)) = experiment {
        f.next_reason = format!("{why} ({}), and study its recording along", e.why);
        let Some(out) = around.out else {
            f.next_command = Some(study(""));
            f.next_reason += "; with --out the sequence is written";
            return None;
        };
        let file = out.join("next_sequence.toml");
        f.next_command = Some(format!("ema run --sequence {} --out next.csv", shown(&file)));
        let text = format!(
            "# {title}: {}. Amplitudes are assumed.\nname = \"{}\"\n\n{}",
            e.why, e.name, e.segments
        );
        return Some((file, text));
    }
    let settled = matches!(f.verdict.as_str(), "named" | "named_with_remainder" | "retune");
    if !settled && f.verdict != "candidate" {
        f.next_reason = "nothing".into();
        return None;
    }
    let (command, reason) = match (f.health.as_str(), around.model, around.rig) {
        (_, None, None) if f.verdict == "candidate" => (
            None,
            "nothing is written: a run with the role heldout, or another recording, is to prove what was found"
                .to_string(),
        ),
        // a fault must not become what healthy means
        ("unknown", ..) if f.model.is_empty() => (
            Some(study(" --healthy")),
            "no model is written, as nobody says that these runs are of a healthy machine: this writes it, where that \
             is known (or health = \"healthy\" in the bench file)"
                .into(),
        ),
        ("unknown", ..) => {
            let of = if f.model == "reference" {
                String::new()
            } else {
                format!(" --actuator {}", f.model)
            };
            (
                Some(format!("ema diagnose RECORDING{of}")),
                "the unit against its type as it is: nothing is written into the model, as nobody says that these \
                 runs are of a healthy machine (--healthy, or health = \"healthy\" in the bench file, where it is known)"
                    .into(),
            )
        }
        (_, Some(model), _) => match around.against {
            Some(why) => (
                Some(format!("ema check {}", shown(model))),
                format!("what was found is in this file, but no pre-flight test of it can be diagnosed yet: {why}"),
            ),
            None => (
                Some(format!("ema diagnose RECORDING --actuator {}", shown(model))),
                "simulator, simplified model, maps and diagnosis use what was found from this file".into(),
            ),
        },
        (_, None, Some(rig)) => (
            None,
            format!(
                "[rig] and [[effect]] of {} may stand in the bench file of the next recordings; to simulate and diagnose, \
                 --actuator with a file of the whole actuator (controller, gear, supply) is needed",
                shown(rig)
            ),
        ),
        (_, None, None) => match (around.out, around.against) {
            (None, _) => (Some(study("")), "writes the model with what was found".into()),
            (_, why) => (
                None,
                format!("no model is written: {}", why.unwrap_or("nothing was proven")),
            ),
        },
    };
    (f.next_command, f.next_reason) = (command, reason);
    None
}

#[cfg(test)]
mod tests {
    use super::*;
    use schemas::sequence::TestSequence;

    #[test]
    fn a_diagnosis_is_offered_where_nothing_stands_against_it_and_no_command_repeats_the_study() {
        let found = |model: &str| Findings {
            model: model.into(),
            verdict: "named".into(),
            health: "healthy".into(),
            ..Findings::default()
        };
        let (out, model) = (Path::new("study"), Path::new("study/actuator.toml"));
        let around = Around {
            command: "ema discrepancy --bench b.toml --healthy",
            out: Some(out),
            model: Some(model),
            rig: None,
            against: None,
        };
        let command = |f: &mut Findings, around: &Around<'_>| {
            next(f, around);
            f.next_command.clone()
        };
        let f = &mut found("a.toml");
        assert!(command(f, &around).unwrap().starts_with("ema diagnose"));
        let against = Some("the speed changes");
        assert_eq!(
            command(f, &Around { against, ..around }).as_deref(),
            Some("ema check study/actuator.toml")
        );
        assert!(f.next_reason.contains("the speed changes"), "{}", f.next_reason);
        let bare = Around { model: None, ..around };
        assert_eq!(command(&mut found(""), &bare), None);
        let unwritten = Around { out: None, ..bare };
        let again = command(&mut found(""), &unwritten).unwrap();
        assert_eq!(again, "ema discrepancy --bench b.toml --healthy --out study");
    }

    #[test]
    fn every_experiment_is_a_sequence() {
        for e in [&STAIRCASE, &CHIRP, &STEPS, &LOADS] {
            let text = format!("name = \"{}\"\n\n{}", e.name, e.segments);
            let section = schemas::toml_section::parse(e.name, &text).unwrap();
            assert!(TestSequence::from_section(section).unwrap().duration_s() > 4.0);
        }
    }
}
