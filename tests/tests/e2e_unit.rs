//! `ema unit` and `ema diagnose --unit`, as processes: a unit that differs from its type, and its history.

mod common;

use common::process::*;
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
        let reference = include_str!("../../datasets/parameters/reference.toml");
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

    refused(&["diagnose", text(&worn), "--unit", "none.json"], &["none.json"]);
    refused(&["unit", "show", text(&worn)], &["a unit file (ema unit new)"]);
    refused(
        &["unit", "new", "x.json", "--study", text(r.dir.path())],
        &["a study that wrote a model"],
    );
    let both = run(&["diagnose", text(&worn), "--unit", text(&a), "--spread", "fleet"]);
    assert_eq!(both.status.code(), Some(2));
}
