//! `ema unit` and `ema diagnose --unit`, as processes: a unit that differs from its type, and its history.

use crate::common::process::*;
use diagnoser::unit::{TestEntry, UnitFile};
use serde_json::Value;
use std::path::{Path, PathBuf};

/// Recordings of one unit: friction 12 % above the type's, inertia 6 % below it, flux 1 % and resistance 3 % off; its
/// drive reckons with the type's torque constant.
struct Recordings {
    dir: tempfile::TempDir,
}

impl Recordings {
    fn new() -> Self {
        let dir = tempfile::tempdir().unwrap();
        let reference = include_str!("../../../datasets/parameters/reference.toml");
        let swapped = |from: &str, to: &str, text: &str| {
            let at = text.find(&format!("\n{from} ")).unwrap_or_else(|| panic!("{from}")) + 1;
            let end = at + text[at..].find('\n').unwrap();
            format!("{}{from} = {to}{}", &text[..at], &text[end..])
        };
        let mut unit = reference.to_string();
        for (key, value) in [
            ("static_n_m", "0.0336"),
            ("inertia_kg_m2", "2.35e-5"),
            ("back_emf_v_s_per_rad", "0.037976"),
            ("phase_resistance_ohm", "1.097"),
        ] {
            unit = swapped(key, value, &unit);
        }
        unit = unit.replace("[controller]\n", "[controller]\ndrive_constant_n_m_per_a = 0.0752\n");
        std::fs::write(dir.path().join("truth.toml"), &unit).unwrap();
        std::fs::write(dir.path().join("other.toml"), swapped("static_n_m", "0.0255", &unit)).unwrap();
        Self { dir }
    }

    fn path(&self, name: &str) -> PathBuf {
        self.dir.path().join(name)
    }

    fn record(&self, of: &str, name: &str, fsj: &str, zeta: &str, seed: &str) -> PathBuf {
        let (file, truth) = (self.path(name), self.path(of));
        let run = [
            "run",
            "--rate",
            "2000",
            "--sensors",
            "reference",
            "--actuator",
            text(&truth),
        ];
        ok(&[
            &run[..],
            &["--fsj", fsj, "--zeta", zeta, "--seed", seed, "--out", text(&file)],
        ]
        .concat());
        file
    }
}

fn inside(d: &Value, of: &str, truth: f64) -> bool {
    d[of]["lo"].as_f64().unwrap() <= truth && truth <= d[of]["hi"].as_f64().unwrap()
}

fn width(d: &Value, of: &str) -> f64 {
    d[of]["hi"].as_f64().unwrap() - d[of]["lo"].as_f64().unwrap()
}

#[test]
fn e2e_a_unit_with_a_healthy_test_is_diagnosed_relative_to_itself() {
    let r = Recordings::new();
    let (h0, h1) = (
        r.record("truth.toml", "h0.csv", "1", "0", "1"),
        r.record("truth.toml", "h1.csv", "1", "0", "2"),
    );
    let worn = r.record("truth.toml", "worn.csv", "2.6", "0.21", "3");
    let odd = r.record("other.toml", "odd.csv", "1", "0", "4");
    let (a, b) = (r.path("a.json"), r.path("b.json"));
    let grid = ["--grid", "standard"];

    ok(&["unit", "new", text(&a)]);
    // nothing is written over
    refused(&["unit", "new", text(&a)], &["a.json", "not there yet"]);
    // without a test of its own: the width says that the healthy friction is not known
    let diagnose =
        |unit: &Path| json(&[&["diagnose", text(&worn), "--unit", text(unit), "--json"], &grid[..]].concat());
    let before = diagnose(&a);
    assert_eq!(before["unit"]["reference"], "type");
    assert_eq!(
        (&before["unit"]["name"], &before["unit"]["tests"]),
        (&"a".into(), &0.into())
    );

    // one call, two calls: the same bytes
    let update = |unit: &Path, files: &[&Path]| {
        let files: Vec<&str> = files.iter().map(|f| text(f)).collect();
        ok(&[&["unit", "update", text(unit)], &files[..], &["--healthy"], &grid[..]].concat())
    };
    update(&a, &[&h0, &h1]);
    ok(&["unit", "new", text(&b), "--name", "a", "--actuator", "reference"]);
    update(&b, &[&h0]);
    update(&b, &[&h1]);
    let bytes = |f: &Path| std::fs::read(f).unwrap();
    assert!(bytes(&a) == bytes(&b));
    // the same recording again
    assert!(update(&b, &[&h0]).contains("known already"));
    assert!(bytes(&a) == bytes(&b));

    let after = diagnose(&a);
    assert_eq!(after["outcome"], "located", "{after}");
    assert_eq!(
        (&after["unit"]["reference"], &after["unit"]["tests"]),
        (&"unit".into(), &2.into())
    );
    assert!(inside(&after, "fsj", 2.6) && inside(&after, "zeta", 0.21), "{after}");
    assert!(4.0 * width(&after, "fsj") < width(&before, "fsj"), "{before} {after}");
    let shown = json(&["unit", "show", text(&a), "--json"]);
    let friction = shown["constants"]
        .as_array()
        .unwrap()
        .iter()
        .find(|c| c["cause"] == "healthy_friction_relative");
    let friction = friction.unwrap();
    let (x, s) = (
        friction["deviation"].as_f64().unwrap(),
        friction["sigma"].as_f64().unwrap(),
    );
    assert!(
        (x - 0.12).abs() < 4.0 * s && s < 0.5 * friction["sigma_before"].as_f64().unwrap(),
        "{friction}"
    );

    // a healthy test of another unit changes nothing but its place in the history
    let out = ema(&[&["unit", "update", text(&a), text(&odd), "--healthy"], &grid[..]].concat())
        .output()
        .unwrap();
    assert_eq!(out.status.code(), Some(3));
    let told = String::from_utf8(out.stdout).unwrap();
    assert!(
        told.contains("changes nothing") && told.contains("contradicts the unit"),
        "{told}"
    );
    let again = json(&["unit", "show", text(&a), "--json"]);
    assert_eq!((&again["constants"], &again["tests"]), (&shown["constants"], &2.into()));
    assert_eq!(again["history"][2]["outcome"], "unexplained");

    // a worn test is kept as the present level
    let told = ok(&[&["unit", "update", text(&a), text(&worn)], &grid[..]].concat());
    assert!(told.contains("taken, FSJ 2."), "{told}");
    let shown = json(&["unit", "show", text(&a), "--json"]);
    assert_eq!((&shown["tests"], &shown["healthy_tests"]), (&3.into(), &2.into()));
    assert!(inside(&shown["present"], "fsj", 2.6), "{shown}");
    // and the unit still holds
    let later = diagnose(&a);
    assert!(inside(&later, "fsj", 2.6) && inside(&later, "zeta", 0.21), "{later}");

    // one whose healthy tests speak against it more often than for it locates nothing
    let mut doubted = UnitFile::load(&a).unwrap();
    let odd_one = doubted.tests[2].clone();
    for k in 0..2 {
        doubted.tests.push(TestEntry {
            checksum: format!("{k}"),
            ..odd_one.clone()
        });
    }
    let c = r.path("doubted.json");
    doubted.save(&c).unwrap();
    let silent = diagnose(&c);
    assert_eq!(silent["outcome"], "unexplained", "{silent}");
    assert!(
        silent["reason"]
            .as_str()
            .unwrap()
            .starts_with("3 of the unit's 5 healthy tests"),
        "{silent}"
    );
    let next = silent["next_command"].as_str().unwrap();
    assert!(
        next.starts_with("ema discrepancy ") && next.contains("--healthy"),
        "{next}"
    );

    // a part is renewed: the tests stay in the history and no longer count
    std::fs::copy(&a, r.path("repaired.json")).unwrap();
    let repaired = r.path("repaired.json");
    let repair = ["unit", "repair", text(&repaired), "--part"];
    let now = json(&[&repair[..], &["transmission", "--note", "new ball screw", "--json"]].concat());
    assert_eq!((&now["tests"], &now["healthy_tests"]), (&0.into(), &0.into()));
    assert_eq!((&now["reference"], &now["present"]), (&"type".into(), &Value::Null));
    assert_eq!(now["history"].as_array().unwrap().len(), 4);
    assert_eq!(now["repairs"][0]["note"], "new ball screw");
    let told = ok(&["unit", "show", text(&repaired)]);
    assert!(
        told.contains("repair    transmission, new ball screw: tests before it no longer count"),
        "{told}"
    );
    // the new friction is learnt as the first was
    ok(&[&["unit", "update", text(&repaired), text(&odd), "--healthy"], &grid[..]].concat());
    let now = json(&["unit", "show", text(&repaired), "--json"]);
    assert_eq!(
        (&now["healthy_tests"], &now["history"][3]["repairs_before"]),
        (&1.into(), &1.into())
    );
    assert_eq!(run(&[&repair[..], &["gears"]].concat()).status.code(), Some(2));

    refused(&["diagnose", text(&worn), "--unit", "none.json"], &["none.json"]);
    refused(&["unit", "show", text(&worn)], &["a unit file (ema unit new)"]);
    refused(
        &["unit", "new", "x.json", "--study", text(r.dir.path())],
        &["a study that wrote a model"],
    );
    let both = run(&["diagnose", text(&worn), "--unit", text(&a), "--spread", "fleet"]);
    assert_eq!(both.status.code(), Some(2));
}

#[test]
fn e2e_a_fleet_is_diagnosed_by_unit_files_as_each_recording_is() {
    let dir = tempfile::tempdir().unwrap();
    let path = |name: &str| dir.path().join(name);
    // of the three one has no file, and of one the features were formed with another inertia than its file has
    let plan = "name = \"known\"\nseed = 5\ngrid = \"coarse\"\nsensors = \"reference\"\nrate_hz = 2000.0\n\
        [aircraft]\ntails = [\"AB\", \"CD\", \"EF\"]\npositions = [\"left\"]\n\
        [[actuators]]\ntail = \"CD\"\nposition = \"left\"\ninertia_kg_m2 = 2.6e-5\n\
        [tests]\nper_actuator = 2\n[telemetry]\nof = \"test\"\n";
    std::fs::write(path("plan.toml"), plan).unwrap();
    let data = path("data");
    ok(&["dataset", "make", text(&path("plan.toml")), "--out", text(&data)]);
    std::fs::create_dir(path("units")).unwrap();
    for tail in ["AB.left", "CD.left"] {
        let file = path("units").join(format!("{tail}.json"));
        ok(&["unit", "new", text(&file), "--name", tail]);
    }
    let units = path("units");
    let diagnose = [
        "dataset",
        "diagnose",
        text(&data),
        "--unit",
        text(&units),
        "--grid",
        "standard",
    ];
    let done = ok(&diagnose);
    assert!(done.contains("4 tests"), "{done}");
    let told = run(&diagnose);
    let told = String::from_utf8_lossy(&[told.stdout, told.stderr].concat()).into_owned();
    assert!(told.contains("EF.left: no unit file of this name"), "{told}");
    let ask = "SELECT run, actuator, outcome, fsj_lo, fsj_hi, zeta_lo, zeta_hi FROM diagnoses ORDER BY run";
    let rows = json(&["query", ask, "--data", text(&data), "--format", "json"]);
    let rows = rows.as_array().unwrap();
    assert_eq!(rows.len(), 4);
    for row in rows {
        let tail = row["actuator"].as_str().unwrap();
        let file = units.join(format!("{tail}.json"));
        let number = row["run"].to_string();
        let alone = json(&[
            "diagnose",
            text(&data),
            "--run",
            &number,
            "--unit",
            text(&file),
            "--grid",
            "standard",
            "--json",
        ]);
        assert_eq!(alone["outcome"], row["outcome"], "{row} {alone}");
        for fault in ["fsj", "zeta"] {
            for end in ["lo", "hi"] {
                let of_fleet = &row[format!("{fault}_{end}")];
                assert_eq!(alone[fault][end].as_f64(), of_fleet.as_f64(), "{row} {alone}");
            }
        }
    }
    refused(
        &["dataset", "diagnose", text(&data), "--unit", text(&path("nothing"))],
        &["nothing"],
    );
}

/// Two recordings of a bench whose currents are read at points, and pre-flight tests by the same sensors: the study says what the
/// sensors are, the unit remembers it, and its tests are read so.
#[test]
fn e2e_a_study_says_what_the_sensors_are_and_tests_are_read_by_them() {
    let r = Recordings::new();
    let (sensors, moves) = (r.path("points.toml"), r.path("moves.toml"));
    let of_bench = "name = \"bench\"\nresolver_bits = 14\nspeed_noise_rad_per_s = 0.3\ncurrent_range_a = 25.0\n\
                    current_bits = 13\ncurrent_noise_a = 0.03\ncurrent_offset_a = 0.02\ncurrent_sampling = \"point\"\n";
    std::fs::write(&sensors, of_bench).unwrap();
    let line = |from: f64, slope: f64, duration: f64| {
        format!(
            "[[segment]]\ncommand = \"line\"\nfrom_rad = {from:?}\nslope_rad_per_s = {slope:?}\nduration_s = {duration:?}\n"
        )
    };
    let mut sequence =
        String::from("name = \"moves\"\n[[segment]]\ncommand = \"hold\"\nvalue_rad = 0.0\nduration_s = 0.6\n");
    let mut at = 0.0;
    for (slope, duration) in [
        (0.5, 0.8),
        (-0.3, 0.8),
        (0.06, 0.8),
        (-0.8, 0.7),
        (0.15, 0.8),
        (1.0, 0.6),
        (-0.5, 0.9),
        (0.02, 0.6),
    ] {
        sequence += &line(at, slope, duration);
        at += slope * duration;
    }
    sequence += "[[segment]]\ncommand = \"multisine\"\namplitude_rad = 0.004\nfrequency_hz = 1.0\nduration_s = 3.0\n";
    std::fs::write(&moves, sequence).unwrap();
    let truth = r.path("truth.toml");
    let record = |name: &str, sequence: &str, more: &[&str]| {
        let file = r.path(name);
        let run = [
            "run",
            "--rate",
            "2000",
            "--sensors",
            text(&sensors),
            "--actuator",
            text(&truth),
            "--sequence",
            sequence,
            "--out",
            text(&file),
        ];
        ok(&[&run[..], more].concat());
        // as a bench writes it: nothing but numbers
        let plain: Vec<String> = std::fs::read_to_string(&file)
            .unwrap()
            .lines()
            .filter(|l| !l.starts_with('#'))
            .map(str::to_string)
            .collect();
        std::fs::write(&file, plain.join("\n") + "\n").unwrap();
        let said = file.with_extension("json");
        if said.exists() {
            std::fs::remove_file(said).unwrap();
        }
        file
    };
    let long = ["1", "2"].map(|seed| record(&format!("long_{seed}.csv"), text(&moves), &["--seed", seed]));
    let study = r.path("study");
    ok(&[
        "discrepancy",
        "--bench",
        text(&long[0]),
        text(&long[1]),
        "--healthy",
        "--out",
        text(&study),
    ]);
    let seen = std::fs::read_to_string(study.join("sensors.toml")).unwrap();
    let has = |line: &str| assert!(seen.contains(line), "no `{line}` in {seen}");
    has("resolver_bits = 14.0");
    has("current_sampling = \"point\"");
    assert!(!seen.contains("speed_source"), "{seen}");
    let number = |key: &str| -> f64 {
        let line = seen.lines().find(|l| l.starts_with(key)).unwrap();
        line.split('=').nth(1).unwrap().trim().parse().unwrap()
    };
    assert!((number("current_noise_a") / 0.03 - 1.0).abs() < 0.3, "{seen}");
    assert!((number("speed_noise_rad_per_s") / 0.3 - 1.0).abs() < 0.2, "{seen}");

    let unit = r.path("unit.json");
    ok(&["unit", "new", text(&unit), "--study", text(&study)]);
    let healthy = record("healthy.csv", "preflight", &["--seed", "3"]);
    let said = ok(&["unit", "update", text(&unit), text(&healthy), "--healthy"]);
    assert!(said.contains("taken") && said.contains("currents points"), "{said}");
    let test = record(
        "test.csv",
        "preflight",
        &["--fsj", "2.3", "--zeta", "0.2", "--seed", "4"],
    );
    let d: Value = serde_json::from_str(&ok(&["diagnose", text(&test), "--unit", text(&unit), "--json"])).unwrap();
    assert_eq!(d["outcome"], "located", "{d}");
    let within = |fault: &str, truth: f64| {
        let (lo, hi) = (d[fault]["lo"].as_f64().unwrap(), d[fault]["hi"].as_f64().unwrap());
        assert!(lo <= truth && truth <= hi && hi - lo < 0.1 * truth, "{fault} {lo} {hi}");
    };
    within("fsj", 2.3);
    within("zeta", 0.2);
}
