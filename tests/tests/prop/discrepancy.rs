//! The discrepancy study on data of the blind generator: names, silence, closed loop, and the measured
//! pitfalls of the method.

use crate::common::process::run;
use ema_study::REFERENCE;
use ema_study::measured::bench::Bench;
use ema_study::measured::check::check;
use ema_study::measured::recording::read_runs;
use ema_study::search::fit::Term;
use ema_study::search::scan::admissible;
use ema_study::search::select::Material;
use ema_study::search::study::{Outcome, study};
use ema_study::told::findings::Findings;
use ema_tests::blind::{self, Class, Forced, Setting, Spec};
use pipeline::discrepancy::{Request, study_file, study_into};
use sim_worker::effect::EffectKind;
use sim_worker::parameters::ActuatorParameters;
use std::path::{Path, PathBuf};

/// A case of the servo in a folder: its bench file.
fn hidden(dir: &Path, seed: u64, class: Class, forced: Vec<Forced>) -> PathBuf {
    let spec = Spec {
        class,
        setting: Setting::Matched,
        severity: 1.0,
        forced,
        ..Spec::default()
    };
    let case = blind::case(seed, &spec);
    let (data, keys) = (dir.join(format!("data-{seed}")), dir.join("keys"));
    std::fs::create_dir_all(&data).unwrap();
    std::fs::create_dir_all(&keys).unwrap();
    case.write(&data, &keys).unwrap();
    let direct = data.join("BENCH.toml");
    if direct.exists() {
        return direct;
    }
    let folders = std::fs::read_dir(&data).unwrap().flatten();
    folders
        .map(|e| e.path().join("BENCH.toml"))
        .find(|p| p.exists())
        .unwrap()
}

fn found(bench: &Path) -> Findings {
    study_file(&Request::of(Path::new(REFERENCE), bench), &|_| {}).unwrap()
}

fn outcome(bench: &Path) -> Outcome {
    let bench = Bench::read(bench, Some(&ActuatorParameters::reference())).unwrap();
    let runs = read_runs(&bench).unwrap();
    study(Material::new(bench, runs, &[]), &|_| {})
}

/// Text of a file with a change, written beside it.
fn changed(bench: &Path, from: &str, to: &str) -> PathBuf {
    let text = std::fs::read_to_string(bench).unwrap();
    assert!(text.contains(from), "{from} not in {text}");
    let out = bench.with_file_name("CHANGED.toml");
    std::fs::write(&out, text.replacen(from, to, 1)).unwrap();
    out
}

#[test]
fn prop_a_hidden_effect_is_named_with_its_parameters() {
    let dir = tempfile::tempdir().unwrap();
    let cogging = Forced::new("cogging", &[("amplitude", 0.006), ("order", 6.0), ("phase", 0.7)]).unwrap();
    let f = found(&hidden(dir.path(), 1, Class::One, vec![cogging]));
    assert_eq!(f.verdict, "named", "{}", f.sentence);
    assert_eq!(f.effects[0].name, "cogging");
    for (name, truth) in [("amplitude", 0.006), ("phase", 0.7), ("order", 6.0)] {
        let p = f.effects[0].parameters.iter().find(|p| p.name == name).unwrap();
        assert!((p.value - truth).abs() < 0.02 * truth, "{p:?}");
        assert!(p.lo <= p.value && p.value <= p.hi, "{p:?}");
    }
    let held = f.gap.unwrap().heldout.unwrap();
    // a gap that is down to the floor is explained, whatever the step said that chose the effect
    assert!(f.effects[0].explained_share > 0.95, "{}", f.effects[0].explained_share);
    assert!(
        held.last < 1.1 * held.floor && held.retuned > 2.0 * held.floor,
        "{held:?}"
    );
}

#[test]
fn prop_nothing_hidden_is_nothing_named() {
    let dir = tempfile::tempdir().unwrap();
    for seed in 1..4 {
        let f = found(&hidden(dir.path(), seed, Class::Nothing, vec![]));
        assert!(["none", "retune"].contains(&f.verdict.as_str()), "{}", f.sentence);
        assert!(f.effects.is_empty());
    }
}

#[test]
fn prop_with_the_written_model_a_fresh_study_says_none() {
    let dir = tempfile::tempdir().unwrap();
    // the same machine (forced effect, same true constants by the seed), studied twice
    let stribeck = || Forced::new("stribeck", &[("torque", 0.012), ("speed", 25.0), ("exponent", 1.5)]).unwrap();
    let bench = hidden(dir.path(), 5, Class::One, vec![stribeck()]);
    let out = dir.path().join("study");
    let healthy = |model: &Path, bench: &Path| Request {
        healthy: true,
        ..Request::of(model, bench)
    };
    let w = study_into(&healthy(Path::new(REFERENCE), &bench), &out, &|_| {}).unwrap();
    assert_eq!(w.findings.verdict, "named", "{}", w.findings.sentence);
    let model = w.model.unwrap();
    let a = ActuatorParameters::read(&model).unwrap();
    assert_eq!(a.effects.len(), 1);
    assert_eq!(a.effects[0].kind, EffectKind::Stribeck);
    assert!(!a.effects[0].provenance.is_empty() && a.effects[0].parent.is_some());
    // runs that the study did not use to fit: the held-out run finds, the first proves
    let text = std::fs::read_to_string(&bench).unwrap();
    let swapped =
        text.replace("role = \"heldout\"", "role = \"x\"")
            .replacen("role = \"fit\"", "role = \"heldout\"", 1);
    let swapped = swapped.replace("role = \"x\"", "role = \"fit\"");
    let fresh = bench.with_file_name("FRESH.toml");
    std::fs::write(&fresh, swapped).unwrap();
    let f = study_file(&healthy(&model, &fresh), &|_| {}).unwrap();
    assert_eq!(
        f.verdict, "none",
        "{} {:?} {:?}",
        f.sentence, f.retuned, w.findings.retuned
    );
    for file in ["report.html", "report.json", "actuator.toml"] {
        assert!(out.join(file).exists());
    }
    let html = std::fs::read_to_string(out.join("report.html")).unwrap();
    assert!(html.contains("stribeck") && html.contains("<svg"));
}

#[test]
fn prop_bad_benches_are_told_in_one_line_with_the_likely_cause() {
    let dir = tempfile::tempdir().unwrap();
    let bench = hidden(dir.path(), 3, Class::Nothing, vec![]);
    let csv = bench.with_file_name("fit1.csv");
    let data = std::fs::read_to_string(&csv).unwrap();
    let position = "position = { column = \"theta_m\", unit = \"rad\"";
    let cases = [
        (position, "position = { column = \"theta_m\", unit = \"mrad\"", "1000"),
        (position, "position = { column = \"theta_m\", unit = \"turn\"", "2 pi"),
        (
            "column = \"omega_m\", unit = \"rad/s\"",
            "column = \"omega_m\", unit = \"rpm\"",
            "60/(2 pi)",
        ),
        (
            "column = \"i_q\", unit = \"A\"",
            "column = \"i_q\", unit = \"mA\"",
            "1000",
        ),
        (
            "column = \"i_q\", unit = \"A\"",
            "column = \"i_q\", unit = \"A\", scale = -1",
            "reversed sign",
        ),
        ("column = \"omega_m\"", "column = \"temperature\"", "swapped columns"),
        ("unit = \"N m/A\"", "unit = \"mN m/A\"", "1000"),
    ];
    for (from, to, cause) in cases {
        let said = refused(&changed(&bench, from, to));
        assert!(said.contains(cause), "{to}: {said}");
    }
    // the data themselves
    let broken = |edit: &dyn Fn(usize, &str) -> Option<String>| {
        let lines: Vec<String> = data.lines().enumerate().filter_map(|(i, l)| edit(i, l)).collect();
        std::fs::write(&csv, lines.join("\n")).unwrap();
        let said = refused(&bench);
        std::fs::write(&csv, &data).unwrap();
        said
    };
    let nan = broken(&|i, l| {
        Some(if i == 100 {
            l.replacen(',', ",NaN,", 1)
        } else {
            l.into()
        })
    });
    assert!(nan.contains("fit1.csv"), "{nan}");
    let jump = broken(&|i, l| (i < 200 || i % 400 < 100).then(|| l.to_string()));
    assert!(jump.contains("gaps that add up") && jump.contains("clock"), "{jump}");
    let still = broken(&|i, l| {
        let mut cells: Vec<&str> = l.split(',').collect();
        if i > 0 {
            cells[2] = "1.5";
        }
        Some(cells.join(","))
    });
    assert!(
        still.contains("never moves") || still.contains("speed of the position"),
        "{still}"
    );
}

/// The one line with which a bench is refused.
fn refused(bench: &Path) -> String {
    let out = run(&[
        "discrepancy",
        "--actuator",
        "reference",
        "--bench",
        bench.to_str().unwrap(),
    ]);
    let said = String::from_utf8_lossy(&out.stderr).into_owned();
    assert_eq!(out.status.code(), Some(4), "{said}");
    assert_eq!(said.trim().lines().count(), 1, "{said}");
    said
}

#[test]
fn prop_pitfall_an_amplitude_of_the_wrong_sign_is_no_effect() {
    assert!(!admissible(EffectKind::Stribeck, &[-0.01]));
    assert!(!admissible(EffectKind::TemperatureDependentFriction, &[0.01]));
    assert!(admissible(EffectKind::ViscousAsymmetry, &[-1e-6]));
    // friction that rises with speed is a Stribeck curve of negative amplitude: its own name is found
    let dir = tempfile::tempdir().unwrap();
    let rise = Forced::new("lubricated_rise", &[("torque", 0.01), ("speed", 30.0)]).unwrap();
    let o = outcome(&hidden(dir.path(), 8, Class::One, vec![rise]));
    assert_eq!(o.model.terms[0].kind, EffectKind::LubricatedRise);
    let signs = |t: &Term| admissible(t.kind, &t.amplitudes);
    assert!(o.steps.iter().flat_map(|s| &s.ranked).all(|r| signs(&r.term)));
}

#[test]
fn prop_pitfall_orders_between_whole_ones_are_refined() {
    let dir = tempfile::tempdir().unwrap();
    let cogging = Forced::new("cogging", &[("amplitude", 0.006), ("order", 3.4), ("phase", 0.2)]).unwrap();
    let f = found(&hidden(dir.path(), 9, Class::One, vec![cogging]));
    // 3.4 is on no grid: whatever is said of cogging, no whole order is made of it
    let orders = f
        .effects
        .iter()
        .filter(|e| e.name == "cogging")
        .map(|e| e.parameters[2].value);
    assert!(
        orders
            .into_iter()
            .all(|o| (o - o.round()).abs() > 0.02 || f.verdict == "unknown"),
        "{}",
        f.sentence
    );
}

#[test]
fn prop_pitfall_point_sampled_against_mean_is_a_clock_and_no_effect() {
    let dir = tempfile::tempdir().unwrap();
    let bench = hidden(dir.path(), 4, Class::Nothing, vec![]);
    // half a sample of misalignment that the bench file does not know of
    let wrong = changed(
        &bench,
        "position = { column = \"theta_m\", unit = \"rad\", sampling = \"mean\"",
        "position = { column = \"theta_m\", unit = \"rad\", delay_s = 0.0003, sampling = \"mean\"",
    );
    let f = found(&wrong);
    let shapes = ["torque_saturation", "quadratic_drag", "spring_load"];
    assert!(
        f.effects.iter().all(|e| !shapes.contains(&e.name.as_str())),
        "{}",
        f.sentence
    );
}

#[test]
fn prop_pitfall_kt_is_not_known_from_torque_alone() {
    let dir = tempfile::tempdir().unwrap();
    let bench = hidden(dir.path(), 6, Class::Nothing, vec![]);
    let text = std::fs::read_to_string(&bench).unwrap();
    let blind: String = text
        .lines()
        .filter(|l| !l.starts_with("voltage") && !l.starts_with("load"))
        .map(|l| format!("{l}\n"))
        .collect();
    let path = bench.with_file_name("BLIND.toml");
    std::fs::write(&path, blind).unwrap();
    let width = |f: &Findings| {
        let kt = f.retuned.iter().find(|r| r.name == "torque_constant").unwrap();
        (kt.hi - kt.lo) / kt.value
    };
    let (with, without) = (width(&found(&bench)), width(&found(&path)));
    assert!(without > 3.0 * with, "{with} {without}");
    let f = found(&path);
    assert!(f.missing.iter().any(|m| m.0 == "voltage") && f.missing.iter().any(|m| m.0 == "load"));
}

/// The folder of measured data, or a word that it is not there.
fn measured() -> Option<String> {
    let dir = std::env::var("EMA_BENCH_DIR").ok();
    if dir.is_none() {
        println!("skipped: EMA_BENCH_DIR not set");
    }
    dir
}

fn datasets(path: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../datasets").join(path)
}

#[test]
fn val_emps_two_effects_and_more_are_named() {
    if measured().is_none() {
        return;
    }
    let request = Request::of(&datasets("parameters/emps.toml"), &datasets("benches/emps.toml"));
    let f = study_file(&request, &|_| {}).unwrap();
    let names = f.names();
    assert!(names.len() >= 2, "{}", f.sentence);
    for wanted in ["viscous_asymmetry", "lubricated_rise", "control_delay"] {
        assert!(names.contains(&wanted), "{names:?}");
    }
    let told = &f.facts.iter().find(|x| x.0.starts_with("relative error")).unwrap().1;
    let last: f64 = told
        .rsplit("final ")
        .next()
        .unwrap()
        .trim_end_matches(" %")
        .parse()
        .unwrap();
    assert!(last <= 2.6, "{told}");
    let closed = f.closed_loop.iter().find(|c| c.heldout).unwrap();
    assert!(closed.last < 0.033 && closed.last < 0.7 * closed.nominal, "{closed:?}");
}

#[test]
fn val_cranfield_health_is_none_and_dry_screws_are_friction() {
    if measured().is_none() {
        return;
    }
    let verdict = |state: &str| {
        let bench = datasets(&format!("benches/cranfield_{state}.toml"));
        study_file(&Request::of(&datasets("parameters/screw_drive.toml"), &bench), &|_| {}).unwrap()
    };
    assert_eq!(verdict("normal").verdict, "none");
    let dry = verdict("lack_lubrication1");
    assert_eq!(dry.verdict, "retune");
    assert!(
        dry.retuned.iter().any(|r| r.name == "coulomb" && r.lo > 0.05),
        "{:?}",
        dry.retuned
    );
    assert_eq!(verdict("backlash1").verdict, "unknown");
}

#[test]
fn prop_of_a_channel_that_is_late_the_last_moments_are_missing() {
    const LATE: usize = 8;
    const MOTION: [&str; 3] = ["theta_m", "omega_m", "theta_u"];
    let dir = tempfile::tempdir().unwrap();
    let bench = hidden(dir.path(), 4, Class::Nothing, vec![]);
    let text = std::fs::read_to_string(&bench).unwrap();
    let files: Vec<&str> = text
        .lines()
        .filter_map(|l| l.strip_prefix("file = \"")?.strip_suffix('"'))
        .collect();
    let mut step_s = 0.0;
    for file in files {
        let csv = bench.with_file_name(file);
        let data = std::fs::read_to_string(&csv).unwrap();
        let rows: Vec<Vec<&str>> = data.lines().map(|l| l.split(',').collect()).collect();
        let late = |name: &str| MOTION.contains(&name);
        let time = rows[0].iter().position(|n| *n == "t").unwrap();
        let at = |k: usize| rows[k][time].parse::<f64>().unwrap();
        step_s = (at(101) - at(1)) / 100.0;
        // to the middle of a motion
        let line = |k: usize| {
            let of = |(i, name): (usize, &&str)| rows[if late(name) && k > 0 { k - LATE } else { k }][i];
            rows[0].iter().enumerate().map(of).collect::<Vec<_>>().join(",")
        };
        let lines: Vec<String> = [0].into_iter().chain(LATE + 1..rows.len() - 150).map(line).collect();
        std::fs::write(&csv, lines.join("\n")).unwrap();
    }
    let delayed = |text: String, name: &&str| {
        let from = format!("column = \"{name}\"");
        text.replacen(&from, &format!("{from}, delay_s = {}", LATE as f64 * step_s), 1)
    };
    std::fs::write(&bench, MOTION.iter().fold(text.clone(), delayed)).unwrap();
    let f = found(&bench);
    for c in &f.by_channel {
        let gap = c.heldout.as_ref().unwrap_or(&c.fit);
        assert!(
            gap.last < 1.4 * gap.floor,
            "{}: {} beside {}",
            c.channel,
            gap.last,
            gap.floor
        );
    }
    assert!(["none", "retune"].contains(&f.verdict.as_str()), "{}", f.sentence);
}

#[test]
fn prop_an_interrupted_clock_is_used_as_it_is_and_said() {
    let dir = tempfile::tempdir().unwrap();
    let bench = hidden(dir.path(), 3, Class::Nothing, vec![]);
    let csv = bench.with_file_name("fit1.csv");
    let data = std::fs::read_to_string(&csv).unwrap();
    let kept: Vec<&str> = data
        .lines()
        .enumerate()
        .filter(|(i, _)| !(600..900).contains(i))
        .map(|x| x.1)
        .collect();
    std::fs::write(&csv, kept.join("\n")).unwrap();
    let f = found(&bench);
    assert!(
        ["none", "retune"].contains(&f.verdict.as_str()),
        "{} {:#?}",
        f.sentence,
        f.by_channel
    );
    assert!(
        f.assumptions.iter().any(|a| a.contains("1 gaps")),
        "{:?}",
        f.assumptions
    );
}

#[test]
fn prop_the_list_of_effects_in_words_is_whole() {
    let text = include_str!("../../../datasets/benches/README.md");
    for kind in EffectKind::ALL {
        let name = kind.name();
        let row = text.lines().find(|l| l.starts_with(&format!("| `{name}` |")));
        let row = row.unwrap_or_else(|| panic!("{name} is not in the list"));
        let keys: Vec<String> = kind.keys().iter().map(|k| format!("{} [{}]", k.name, k.unit)).collect();
        assert!(row.ends_with(&format!("| {} |", keys.join(", "))), "{row}");
    }
}

#[test]
fn prop_the_worked_example_is_a_bench() {
    let text = include_str!("../../../datasets/benches/README.md");
    let example = text.split("# rig.toml\n").nth(1).unwrap().split("```").next().unwrap();
    let dir = tempfile::tempdir().unwrap();
    let bench = dir.path().join("rig.toml");
    std::fs::write(&bench, example).unwrap();
    for (file, hz) in [("monday.csv", 0.5), ("tuesday.csv", 0.8)] {
        let mut csv = String::from("time_s,pos_deg,speed_rpm,current_A\n");
        for k in 0..12_000 {
            let t = k as f64 * 1e-3;
            let phase = std::f64::consts::TAU * hz * t;
            // 8e-5 kg m2 and 0.02 N m of friction, 30 rad/s at most, with a little noise of the sensors
            let noise =
                |n: u64| ((k as u64 * 2 + n).wrapping_mul(0x9E37_79B9_7F4A_7C15) >> 40) as f64 / (1 << 23) as f64 - 1.0;
            let (w, a) = (30.0 * phase.sin(), 30.0 * std::f64::consts::TAU * hz * phase.cos());
            let theta = 30.0 * (1.0 - phase.cos()) / (std::f64::consts::TAU * hz);
            let i = (8e-5 * a + 0.02 * w.signum() + 2e-4 * w) / 0.11 + 0.002 * noise(0);
            csv += &format!(
                "{t},{},{},{i}\n",
                theta.to_degrees(),
                (w + 0.05 * noise(1)) * 30.0 / std::f64::consts::PI
            );
        }
        std::fs::write(dir.path().join(file), csv).unwrap();
    }
    let request = Request {
        bench: vec![bench],
        ..Request::default()
    };
    let f = study_file(&request, &|_| {}).unwrap();
    assert!(["none", "retune"].contains(&f.verdict.as_str()), "{}", f.sentence);
    let inertia = f.retuned.iter().find(|c| c.name == "inertia").unwrap().value;
    assert!((inertia / 8e-5 - 1.0).abs() < 0.1, "{inertia}");
}

#[test]
fn prop_without_held_out_data_there_are_candidates_and_nothing_is_written() {
    let dir = tempfile::tempdir().unwrap();
    let cogging = Forced::new("cogging", &[("amplitude", 0.006), ("order", 6.0), ("phase", 0.7)]).unwrap();
    let bench = hidden(dir.path(), 1, Class::One, vec![cogging]);
    let text = std::fs::read_to_string(&bench).unwrap();
    std::fs::write(&bench, text.replace("role = \"heldout\"", "role = \"select\"")).unwrap();
    let out = dir.path().join("study");
    let request = Request {
        healthy: true,
        ..Request::of(Path::new(REFERENCE), &bench)
    };
    let w = study_into(&request, &out, &|_| {}).unwrap();
    assert_eq!(w.findings.verdict, "candidate", "{}", w.findings.sentence);
    assert!(w.model.is_none() && !out.join("actuator.toml").exists());
    // the same rows cannot find and prove
    let both =
        text.replacen("role = \"heldout\"", "role = \"fit\"", 1) + "[[run]]\nfile = \"fit1.csv\"\nrole = \"heldout\"\n";
    std::fs::write(&bench, both).unwrap();
    assert!(refused(&bench).contains("do not overlap"));
    // nor can a few; windows that meet have one in common
    let runs = text.find("[[run]]").unwrap();
    let windows = |from: f64| {
        let run = |role: &str, from: f64, to: f64| {
            format!("[[run]]\nfile = \"fit1.csv\"\nrole = \"{role}\"\nwindow_s = [{from:?}, {to:?}]\n")
        };
        let all = text[..runs].to_string() + &run("fit", 0.0, 2.0) + &run("heldout", from, 4.0);
        std::fs::write(&bench, all).unwrap();
        let bench = Bench::read(&bench, Some(&ActuatorParameters::reference())).unwrap();
        check(&bench, &read_runs(&bench).unwrap()).map_err(|e| e.to_string())
    };
    let said = windows(1.99).unwrap_err();
    assert!(said.contains("rows (") && said.contains("role heldout"), "{said}");
    windows(2.0).unwrap();
}

#[test]
fn prop_a_rig_without_an_actuators_file_gets_a_model_that_a_study_takes() {
    let dir = tempfile::tempdir().unwrap();
    let cogging = Forced::new("cogging", &[("amplitude", 0.006), ("order", 6.0), ("phase", 0.7)]).unwrap();
    let bench = hidden(dir.path(), 1, Class::One, vec![cogging]);
    let request = |bench: &Path, healthy: bool| Request {
        bench: vec![bench.to_path_buf()],
        healthy,
        ..Request::default()
    };
    // nobody says that it is healthy: what is to be said, and nothing written
    let out = dir.path().join("study");
    let w = study_into(&request(&bench, false), &out, &|_| {}).unwrap();
    assert!(w.rig.is_none() && !out.join("model.toml").exists());
    assert!(w.findings.next_command.unwrap().contains(" --healthy --out "));
    let w = study_into(&request(&bench, true), &out, &|_| {}).unwrap();
    assert_eq!(w.findings.verdict, "named", "{}", w.findings.sentence);
    assert_eq!(w.findings.next_command, None);
    assert!(
        w.findings.next_reason.contains("model.toml"),
        "{}",
        w.findings.next_reason
    );
    // with it, the held-out runs find nothing more
    let model = std::fs::read_to_string(w.rig.unwrap()).unwrap();
    let text = std::fs::read_to_string(&bench).unwrap();
    let fresh = bench.with_file_name("FRESH.toml");
    std::fs::write(&fresh, model.clone() + &text[text.find("[channels]").unwrap()..]).unwrap();
    let read = Bench::read(&fresh, None).unwrap();
    assert_eq!(read.effects[0].kind, EffectKind::Cogging);
    let inertia = w.findings.retuned.iter().find(|r| r.name == "inertia").unwrap();
    let sigma = 0.5 * (inertia.hi - inertia.lo) / 1.96 / inertia.value;
    assert!((read.rig.inertia.value / inertia.value - 1.0).abs() < 1e-12);
    assert!((read.rig.inertia.trust.unwrap() / sigma - 1.0).abs() < 1e-6, "{model}");
    let f = study_file(&request(&fresh, true), &|_| {}).unwrap();
    assert!(
        ["none", "retune"].contains(&f.verdict.as_str()) && f.effects.is_empty(),
        "{}",
        f.sentence
    );
    // another gear is another machine
    let other = changed(&bench, "gear_ratio = { value = 500", "gear_ratio = { value = 1");
    assert!(refused(&other).contains("rig.gear_ratio"));
}

#[test]
fn prop_what_is_not_simulated_is_said() {
    let dir = tempfile::tempdir().unwrap();
    let bench = hidden(dir.path(), 3, Class::Nothing, vec![]);
    let text = std::fs::read_to_string(&bench).unwrap();
    let line = text.lines().find(|l| l.starts_with("command = ")).unwrap();
    let bench = changed(&bench, line, "");
    let out = run(&[
        "discrepancy",
        "--actuator",
        "reference",
        "--bench",
        bench.to_str().unwrap(),
        "--verify",
    ]);
    let said = String::from_utf8_lossy(&out.stdout).into_owned();
    assert!(
        said.contains("not simulated") && said.contains("no channel `command`"),
        "{said}"
    );
}
