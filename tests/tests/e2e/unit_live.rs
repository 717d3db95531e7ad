//! `ema live --unit`: streams of units that are known, by the names of their actuators.

use crate::common::*;
use ema_tests::stream::TestDomain;
use serde_json::Value;
use std::path::Path;

fn run(domain: &TestDomain, dir: &Path, name: &str, (fsj, zeta): (&str, &str), more: &[&str]) -> String {
    let path = dir.join(name).display().to_string();
    let of = [
        "run",
        "--fsj",
        fsj,
        "--zeta",
        zeta,
        "--rate",
        "2000",
        "--sensors",
        "reference",
    ];
    ok(domain, &[&of[..], more, &["--out", &path]].concat());
    path
}

#[test]
fn e2e_a_stream_with_the_name_of_a_unit_is_diagnosed_as_that_unit() {
    let (domain, dir) = (TestDomain::default(), tempfile::tempdir().unwrap());
    let (healthy, worn) = (
        run(&domain, dir.path(), "healthy.parquet", ("1", "0"), &["--seed", "1"]),
        run(&domain, dir.path(), "worn.parquet", ("2.6", "0.21"), &["--seed", "2"]),
    );
    let units = dir.path().join("units");
    std::fs::create_dir(&units).unwrap();
    let file = units.join("tail7.json").display().to_string();
    let grid = ["--grid", "coarse"];
    ok(&domain, &["unit", "new", &file]);
    ok(
        &domain,
        &[&["unit", "update", &file, &healthy, "--healthy"], &grid[..]].concat(),
    );
    let of = |more: &[&str]| -> Value {
        serde_json::from_str(&ok(
            &domain,
            &[&["diagnose", &worn, "--json"], &grid[..], more].concat(),
        ))
        .unwrap()
    };
    let offline = of(&["--unit", &file]);
    assert_eq!(offline["unit"]["reference"], "unit");

    let folder = units.display().to_string();
    let mut one = live(
        &domain,
        &[&["--unit", &folder, "--exit-after", "2"], &grid[..]].concat(),
    );
    for id in ["tail7", "another"] {
        ok(&domain, &["replay", &worn, "--id", id, "--speed", "max"]);
    }
    assert_eq!(one.code(), Some(0), "{}", one.errors());
    let told = finals(&one);
    let named = |id: &str| {
        told.iter()
            .find(|d| d["actuator"] == id)
            .unwrap_or_else(|| panic!("{id} in {told:?}"))
    };
    same(&offline, named("tail7"));
    // and nobody else
    same(&of(&[]), named("another"));
    assert_ne!(named("tail7")["fsj"], named("another")["fsj"]);

    // two files of one actuator
    std::fs::copy(&file, units.join("copy.json")).unwrap();
    let refused = ema(&domain, &["live", "--unit", &folder]).output().unwrap();
    assert_eq!(refused.status.code(), Some(4));
    let said = String::from_utf8(refused.stderr).unwrap();
    assert!(
        said.contains("tail7.json") && said.contains("copy.json") && said.lines().count() == 1,
        "{said}"
    );
    let empty = dir.path().join("none");
    std::fs::create_dir(&empty).unwrap();
    let refused = ema(&domain, &["live", "--unit", &empty.display().to_string()])
        .output()
        .unwrap();
    assert_eq!(refused.status.code(), Some(4));
}

#[test]
fn e2e_a_recorded_temperature_is_known() {
    let (domain, dir) = (TestDomain::default(), tempfile::tempdir().unwrap());
    // friction 24 % up at -40 deg C, as the spread's slope says, and a winding and magnets as cold
    let reference = include_str!("../../../datasets/parameters/reference.toml");
    let changed = |text: &str, key: &str, value: f64| {
        let at = text.find(&format!("\n{key} ")).unwrap_or_else(|| panic!("{key}")) + 1;
        let end = at + text[at..].find('\n').unwrap();
        format!("{}{key} = {value}{}", &text[..at], &text[end..])
    };
    let mut cold = reference.replace("[controller]\n", "[controller]\ndrive_constant_n_m_per_a = 0.0752\n");
    for (key, value) in [
        ("static_n_m", 0.03 * 1.24),
        ("viscous_n_m_s_per_rad", 3e-5 * 1.24),
        ("phase_resistance_ohm", 1.065 * (1.0 - 0.00393 * 60.0)),
        ("back_emf_v_s_per_rad", 0.0376 * (1.0 + 0.0011 * 60.0)),
    ] {
        cold = changed(&cold, key, value);
    }
    let model = dir.path().join("cold.toml").display().to_string();
    std::fs::write(&model, cold).unwrap();
    let file = run(&domain, dir.path(), "cold.csv", ("2.5", "0.2"), &["--actuator", &model]);
    let told = dir.path().join("told.csv").display().to_string();
    let rows = std::fs::read_to_string(&file).unwrap();
    let with = |degc: &str| {
        let line = |(k, l): (usize, &str)| match k {
            0 => format!("{l},temperature\n"),
            _ => format!("{l},{degc}\n"),
        };
        rows.lines().enumerate().map(line).collect::<String>()
    };
    std::fs::write(&told, with("-40")).unwrap();
    let of = |file: &str, more: &[&str]| -> Value {
        let args = ["diagnose", file, "--spread", "service", "--grid", "coarse", "--json"];
        serde_json::from_str(&ok(&domain, &[&args[..], more].concat())).unwrap()
    };
    let (recorded, known, unknown) = (
        of(&told, &[]),
        of(&file, &["--known", "temperature_degc=-40"]),
        of(&file, &[]),
    );
    assert_eq!(recorded["fsj"], known["fsj"]);
    let width = |d: &Value| d["fsj"]["hi"].as_f64().unwrap() - d["fsj"]["lo"].as_f64().unwrap();
    assert!(width(&recorded) < 0.8 * width(&unknown), "{recorded} {unknown}");
    let near = recorded["fsj"]["estimate"].as_f64().unwrap();
    assert!((near - 2.5).abs() < width(&recorded), "{recorded}");
    let alike = |d: &Value, name: &str| d["reads_as_fsj"].as_array().unwrap().iter().any(|x| x == name);
    assert!(!alike(&recorded, "friction_temperature") && alike(&recorded, "healthy_friction"));
    // a sensor that is none
    std::fs::write(&told, with("-300")).unwrap();
    let refused = ema(&domain, &["diagnose", &told, "--spread", "service", "--grid", "coarse"])
        .output()
        .unwrap();
    assert_eq!(refused.status.code(), Some(4));
    let said = String::from_utf8(refused.stderr).unwrap();
    assert!(said.contains("temperature") && said.contains("-300"), "{said}");
}
