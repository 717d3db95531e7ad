//! The discrepancy study on recordings of the test bench: faults, units of unknown health, bristles.

use crate::common::process::{json, ok, text};
use ema_study::REFERENCE;
use pipeline::discrepancy::{Request, study_file};
use sim_worker::effect::{Effect, EffectKind, Law};
use sim_worker::parameters::ActuatorParameters;
use std::path::Path;

/// A multisine as the segment of a sequence.
fn multisine(amplitude_rad: f64, frequency_hz: f64, duration_s: f64) -> String {
    format!(
        "[[segment]]\ncommand = \"multisine\"\namplitude_rad = {amplitude_rad:?}\nfrequency_hz = {frequency_hz:?}\n\
         duration_s = {duration_s:?}\n"
    )
}

/// Records the reference actuator with FSJ 3 and zeta 0.3 under the segments of a sequence.
fn worn(out: &Path, segments: &str, options: &[&str]) {
    recorded(out, segments, &[&["--fsj", "3", "--zeta", "0.3"], options].concat());
}

/// Records an actuator under the segments of a sequence.
fn recorded(out: &Path, segments: &str, options: &[&str]) {
    let sequence = out.with_extension("toml");
    std::fs::write(&sequence, format!("name = \"long\"\n{segments}")).unwrap();
    let mut words = vec!["run", "--channels", "all", "--sequence"];
    words.extend([text(&sequence), "--out", text(out)]);
    words.extend(options);
    ok(&words);
}

#[test]
fn prop_faults_of_the_test_bench_come_out_as_what_they_are() {
    let dir = tempfile::tempdir().unwrap();
    let step = |h: f64| format!("[[segment]]\ncommand = \"step\"\nheight_rad = {h:?}\nduration_s = 1.0\n");
    for (name, f, h) in [("a.parquet", 0.4, 0.4), ("b.parquet", 0.55, -0.3)] {
        let segments = format!("{}{}", multisine(0.2, f, 6.0), step(h));
        worn(&dir.path().join(name), &segments, &["--rate", "1000"]);
    }
    let bench = dir.path().join("BENCH.toml");
    let rig = r#"[rig]
kind = "rotary"
drive = "current"
drive_constant = { value = 0.0752, unit = "N m/A", trust = 0.02 }
inertia = { value = 2.5e-5, unit = "kg m2", trust = 0.10 }
viscous = { value = 3e-5, unit = "N m s/rad", trust = 0.3 }
coulomb = { value = 0.021, unit = "N m", trust = 0.3 }
[channels]
time = { column = "t", unit = "s" }
position = { column = "theta_m", unit = "rad" }
velocity = { column = "omega_m", unit = "rad/s" }
i_a = { column = "i_a", unit = "A" }
i_b = { column = "i_b", unit = "A" }
i_c = { column = "i_c", unit = "A" }
[[run]]
file = "a.parquet"
role = "fit"
[[run]]
file = "b.parquet"
role = "heldout"
"#;
    std::fs::write(&bench, rig).unwrap();
    let f = study_file(&Request::of(Path::new(REFERENCE), &bench), &|_| {}).unwrap();
    let coulomb = f.retuned.iter().find(|r| r.name == "coulomb").unwrap();
    let factor = coulomb.value / coulomb.nominal.unwrap();
    assert!((factor - 3.0).abs() < 0.1, "{factor}");
    let e = f.effects.iter().find(|e| e.name == "eccentricity").expect(&f.sentence);
    assert!((e.parameters[0].value - 0.3).abs() < 0.015, "{e:?}");
}

/// The report of a study of the reference actuator with one effect, recorded by its sensors, and the model that the study wrote.
fn studied(hidden: Effect, segments: &str, rate_hz: &str) -> (serde_json::Value, String) {
    let (report, written) = studied_of(hidden, segments, &["--rate", rate_hz]);
    (report, written.expect("a model is written"))
}

/// The same with further words of the recording; no model is written where something else is missing too.
fn studied_of(hidden: Effect, segments: &str, words: &[&str]) -> (serde_json::Value, Option<String>) {
    let dir = tempfile::tempdir().unwrap();
    let mut actuator = ActuatorParameters::reference();
    actuator.effects.push(hidden);
    let (model, out, study) = (
        dir.path().join("hidden.toml"),
        dir.path().join("r.parquet"),
        dir.path().join("study"),
    );
    std::fs::write(&model, actuator.to_toml()).unwrap();
    let seen = ["--sensors", "reference", "--actuator", text(&model)];
    recorded(&out, segments, &[&seen, words].concat());
    let said = [
        "discrepancy",
        "--bench",
        text(&out),
        "--healthy",
        "--json",
        "--out",
        text(&study),
    ];
    let report = json(&said);
    assert_eq!(report["effects"].as_array().unwrap().len(), 1, "{report}");
    (report, std::fs::read_to_string(study.join("actuator.toml")).ok())
}

/// Bristles of an actuator of ours are told from the few reversals of one recording, and by their law.
#[test]
fn prop_bristles_break_away_at_the_static_friction_where_the_actuator_has_them() {
    let bristles = Effect::new(EffectKind::Presliding, &[2.02, 4.34e-3]).by(Law::BreakAway);
    let segments = [(0.0012, 3.0, 2.0), (0.02, 0.8, 2.0), (0.3, 0.25, 4.0)].map(|(a, f, t)| multisine(a, f, t));
    let (report, written) = studied(bristles, &segments.concat(), "10000");
    let effect = &report["effects"][0];
    assert_eq!(
        (&effect["name"], &effect["breaks_away"]),
        (&"presliding".into(), &"static".into())
    );
    let stiffness = effect["parameters"]["stiffness"]["value"].as_f64().unwrap();
    assert!((stiffness / 2.02 - 1.0).abs() < 0.15, "{stiffness}");
    assert!(written.contains("breaks_away = \"static\""), "{written}");
}

#[test]
fn prop_a_soft_shaft_that_only_the_torque_shows_is_named_with_its_values() {
    let truth = [20.0, 6e-3, 1e-5];
    let steps: String = [0.05, -0.1, 0.1, -0.05, 0.2, -0.2]
        .map(|h| format!("[[segment]]\ncommand = \"step\"\nheight_rad = {h:?}\nduration_s = 0.5\n"))
        .concat();
    let segments = format!("{}{steps}{}", multisine(0.02, 0.8, 2.0), multisine(0.1, 0.5, 3.0));
    let (report, _) = studied(Effect::new(EffectKind::Compliance, &truth), &segments, "2000");
    let effect = &report["effects"][0];
    assert_eq!(effect["name"], "compliance", "{report}");
    for (key, truth) in ["stiffness", "damping", "inertia"].into_iter().zip(truth) {
        let value = effect["parameters"][key]["value"].as_f64().unwrap();
        println!("{key}: {value:.4e} for {truth:.4e}");
        assert!((value / truth - 1.0).abs() < 0.2, "{key} {value}");
    }
}

/// An offset of one phase's sensor, four times the most that a usual one has: the sum of three usual ones comes near it, one alone does not.
#[test]
fn prop_an_offset_of_one_sensor_is_beside_what_one_has() {
    let segments = format!("{}{}", multisine(0.2, 0.45, 7.0), multisine(0.1, 0.5, 3.0));
    let hidden = Effect {
        law: Law::Phase(0),
        ..Effect::new(EffectKind::CurrentOffset, &[0.09])
    };
    let (report, _) = studied_of(hidden, &segments, &["--rate", "2000", "--seed", "8"]);
    let effect = &report["effects"][0];
    assert_eq!(effect["name"], "current_offset", "{report}");
    assert_eq!(effect["sensor"], "a", "{report}");
    let [lo, hi] = ["lo", "hi"].map(|k| effect["parameters"]["current"][k].as_f64().unwrap());
    assert!(lo < 0.09 && 0.09 < hi && hi - lo < 0.1, "{lo} {hi}");
}

#[test]
fn prop_a_unit_of_unknown_health_is_told_in_fault_terms_and_never_becomes_the_type() {
    let dir = tempfile::tempdir().unwrap();
    let csv = dir.path().join("unit.csv");
    worn(
        &csv,
        &multisine(0.2, 0.45, 7.0),
        &["--rate", "2000", "--sensors", "reference"],
    );
    let out = dir.path().join("study");
    let f = json(&["discrepancy", "--bench", text(&csv), "--out", text(&out), "--json"]);
    assert_eq!(f["health"], "unknown");
    assert!(!out.join("actuator.toml").exists(), "a fault was written into the type");
    let of = |name: &str| {
        let all = f["findings"].as_array().unwrap();
        all.iter()
            .find(|x| x["name"] == name)
            .unwrap_or_else(|| panic!("{name}: {f:#}"))["value"]
            .as_f64()
            .unwrap()
    };
    assert!((of("fsj") - 3.0).abs() < 0.1, "{}", of("fsj"));
    assert!((of("zeta") - 0.3).abs() < 0.01, "{}", of("zeta"));
    // what it says is next does not end in health
    let next = f["next_command"].as_str().unwrap();
    assert!(next.starts_with("ema diagnose") && !next.contains("study"), "{next}");
}
