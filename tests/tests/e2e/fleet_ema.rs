//! Fleet datasets with the program `ema`: plan, make, verify, maps, diagnose, export, copy, query; and how Python reads
//! them.

use crate::common::process::*;
use ema_tests::fleet::{files, same};
use ema_tests::s3::S3Server;
use serde_json::Value;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};
use std::sync::OnceLock;

/// Two aircraft of two actuators, the coarse grid, sensors, tests with telemetry; `seed` of the draws.
fn plan(seed: u64) -> String {
    format!(
        "name = \"small\"\nseed = {seed}\ngrid = \"coarse\"\nsensors = \"reference\"\n\
        [aircraft]\ntails = [\"AB\", \"CD\"]\npositions = [\"left\", \"right\"]\n\
        [spread]\nphase_resistance_ohm = {{ distribution = \"uniform\", half_width_relative = 0.05, source = \"assumed\" }}\n\
        back_emf_v_s_per_rad = {{ distribution = \"uniform\", half_width_relative = 0.02, source = \"assumed\" }}\n\
        [[actuators]]\ntail = \"CD\"\nposition = \"right\"\nphase_resistance_ohm = 1.6\n\
        [tests]\nper_actuator = 3\n[telemetry]\nof = \"test\"\n"
    )
}

struct Made {
    _dir: tempfile::TempDir,
    plan: PathBuf,
    data: PathBuf,
}

/// A dataset with maps and diagnoses; made once.
fn dataset() -> &'static Made {
    static ONCE: OnceLock<Made> = OnceLock::new();
    ONCE.get_or_init(|| {
        let dir = tempfile::tempdir().unwrap();
        let (file, data) = (dir.path().join("plan.toml"), dir.path().join("data"));
        std::fs::write(&file, plan(1)).unwrap();
        ok(&["dataset", "make", text(&file), "--out", text(&data)]);
        let made = ok(&["dataset", "maps", text(&data)]);
        assert!(made.contains("4 sets of maps"), "{made}");
        let done = ok(&["dataset", "diagnose", text(&data)]);
        assert!(done.contains("12 tests"), "{done}");
        // twelve are too few to calibrate by
        assert!(done.contains("simulated tests of the same actuators"), "{done}");
        Made {
            _dir: dir,
            plan: file,
            data,
        }
    })
}

/// Without what was made later.
fn stored(dir: &Path) -> ema_tests::fleet::Files {
    let mut all = files(dir);
    all.retain(|path, _| !path.starts_with("maps/") && !path.starts_with("diagnoses/"));
    all
}

#[test]
fn e2e_one_machine_and_shards_make_the_same_dataset() {
    let made = dataset();
    let dir = tempfile::tempdir().unwrap();
    for shard in ["2/3", "0/3", "1/3"] {
        let mut c = Command::new(env!("CARGO_BIN_EXE_sim-worker-under-test"));
        c.args(["--plan", text(&made.plan), "--out", text(dir.path()), "--shard", shard]);
        assert!(c.output().unwrap().status.success());
    }
    ok(&["dataset", "merge", text(&made.plan), "--out", text(dir.path())]);
    same(&stored(dir.path()), &stored(&made.data));
    let checked = json(&["dataset", "verify", text(&made.data), "--json"]);
    assert_eq!(
        (&checked["whole"], &checked["runs"]),
        (&true.into(), &72.into()),
        "{checked}"
    );
}

#[test]
fn e2e_a_plan_says_what_it_comes_to_before_anything_starts() {
    let made = dataset();
    let said = json(&["plan", text(&made.plan), "--json"]);
    assert_eq!(said["runs"], 72);
    assert_eq!((&said["map_runs"], &said["telemetry_runs"]), (&60.into(), &12.into()));
    // within a third of what came of it
    let bytes: u64 = files(&made.data.join("telemetry"))
        .values()
        .map(|b| b.len() as u64)
        .sum();
    let expected = said["expected_bytes"].as_f64().unwrap();
    assert!((expected / bytes as f64 - 1.0).abs() < 0.33, "{expected} {bytes}");
    assert!(said["expected_s"].as_f64().unwrap() > 0.0);
    let shown = ok(&["plan", text(&made.plan)]);
    for word in ["com, theta_u, i_eq: not stored", "phase_resistance_ohm", "72"] {
        assert!(shown.contains(word), "no `{word}` in {shown}");
    }
    assert!(!made.plan.with_file_name("small").exists(), "a plan makes nothing");
}

#[test]
fn e2e_an_exported_run_has_the_features_of_the_dataset_to_the_bit() {
    let made = dataset();
    let dir = tempfile::tempdir().unwrap();
    let maps = dir.path().join("maps");
    ok(&[
        "dataset",
        "maps",
        text(&made.data),
        "--actuator",
        "AB.right",
        "--out",
        text(&maps),
    ]);
    let rows = json(&[
        "query",
        "SELECT run, p1_rad_per_s, p2_a, p3, ripple_rad_per_s FROM features WHERE actuator = 'AB.right' AND kind = 'test'",
        "--data",
        text(&made.data),
        "--format",
        "json",
    ]);
    let rows = rows.as_array().unwrap();
    assert_eq!(rows.len(), 3);
    for row in rows {
        let file = dir.path().join("run.parquet");
        let run = row["run"].to_string();
        ok(&[
            "dataset",
            "export",
            text(&made.data),
            "--run",
            &run,
            "--out",
            text(&file),
        ]);
        let actuator = maps.join("actuator.toml");
        let d = json(&[
            "diagnose",
            text(&file),
            "--maps",
            text(&maps),
            "--actuator",
            text(&actuator),
            "--json",
        ]);
        for key in ["p1_rad_per_s", "p2_a", "p3", "ripple_rad_per_s"] {
            assert_eq!(d["features"][key], row[key], "{key} of run {run}");
        }
    }
    let none = run_code(&[
        "dataset",
        "export",
        text(&made.data),
        "--run",
        "0",
        "--out",
        text(&dir.path().join("x.csv")),
    ]);
    assert!(none.1.contains("features only"), "{}", none.1);
    assert_eq!(none.0, Some(4));
}

fn run_code(args: &[&str]) -> (Option<i32>, String) {
    let o = run(args);
    (o.status.code(), String::from_utf8_lossy(&o.stderr).into_owned())
}

#[test]
fn e2e_questions_find_the_actuator_that_was_set_apart() {
    let made = dataset();
    let ask = |q: &str| json(&["query", q, "--data", text(&made.data), "--format", "json"]);
    let rows = ask("parameter-sensitivity");
    let found = |r: &Value| r["feature"] == "p2_a" && r["parameter"] == "phase_resistance_ohm";
    assert!(rows.as_array().unwrap().iter().any(found), "{rows}");
    let coverage = ask("coverage");
    let total = coverage.as_array().unwrap().last().unwrap().clone();
    assert_eq!(total["tests"], 12, "{coverage}");
    let apart = ask("SELECT actuator FROM actuators ORDER BY phase_resistance_ohm DESC LIMIT 1");
    assert_eq!(apart[0]["actuator"], "CD.right");
    let stated = ask("SELECT DISTINCT coverage FROM diagnoses");
    assert_eq!(stated, serde_json::json!([{ "coverage": 0.95 }]));
    let intervals = ask("SELECT COUNT(*) AS n FROM intervals");
    assert_eq!(intervals[0]["n"], 24);
    // another seed draws other actuators: their maps have moved
    let dir = tempfile::tempdir().unwrap();
    let (file, other) = (dir.path().join("plan.toml"), dir.path().join("other"));
    std::fs::write(&file, plan(2)).unwrap();
    ok(&["dataset", "make", text(&file), "--out", text(&other)]);
    let drift = json(&[
        "query",
        "map-drift",
        "--data",
        text(&made.data),
        "--with",
        text(&other),
        "--format",
        "json",
    ]);
    assert_eq!(
        drift
            .as_array()
            .unwrap()
            .iter()
            .filter(|r| r["feature"] == "p2")
            .count(),
        4,
        "{drift}"
    );
    let itself = json(&[
        "query",
        "map-drift",
        "--data",
        text(&made.data),
        "--with",
        text(&made.data),
        "--format",
        "json",
    ]);
    let moved = itself
        .as_array()
        .unwrap()
        .iter()
        .filter_map(|r| r["greatest_share"].as_f64());
    assert_eq!(moved.fold(0.0, f64::max), 0.0, "{itself}");
}

#[test]
fn e2e_a_dataset_is_copied_to_s3_and_checked_there() {
    let made = dataset();
    let server = S3Server::start();
    let url = server.url("copy");
    let there = |args: &[&str]| succeeded(ema(args).envs(server.env()));
    there(&["dataset", "copy", text(&made.data), &url]);
    assert!(there(&["dataset", "verify", &url]).contains("whole"));
    let asked = |place: &str| there(&["query", "coverage", "--data", place, "--format", "csv"]);
    assert_eq!(asked(&url), asked(text(&made.data)));
    let back = tempfile::tempdir().unwrap();
    there(&["dataset", "copy", &url, text(back.path())]);
    same(&files(back.path()), &files(&made.data));
}

/// The Python interpreter of `EMA_PYTHON` (else `python3`), if it has these packages.
fn python(packages: &str) -> Option<String> {
    let python = std::env::var("EMA_PYTHON").unwrap_or_else(|_| "python3".into());
    let check = format!("import {packages}");
    let found = Command::new(&python)
        .args(["-c", &check])
        .stderr(Stdio::null())
        .status();
    if found.is_ok_and(|s| s.success()) {
        return Some(python);
    }
    println!("skipped: no Python with {packages} (EMA_PYTHON names the interpreter)");
    None
}

fn script(python: &str, script: &str, args: &[&str]) -> Output {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    let mut c = Command::new(python);
    c.env("PYTHONDONTWRITEBYTECODE", "1").arg(root.join(script)).args(args);
    let o = c.output().unwrap();
    assert!(o.status.success(), "{script}: {}", String::from_utf8_lossy(&o.stderr));
    o
}

#[test]
fn e2e_polars_pandas_and_duckdb_read_the_dataset_alike() {
    let Some(python) = python("numpy, polars, pandas, pyarrow, duckdb") else {
        return;
    };
    let made = dataset();
    let expect = r#"{"tables": {"features": {"rows": 72, "runs": 72}, "actuators": {"rows": 4},
        "telemetry": {"rows": 360000, "runs": 12}, "diagnoses": {"rows": 12}}}"#;
    let args = [text(&made.data), "--require", "all", "--expect", expect];
    script(&python, "tests/python/read_fleet.py", &args);
}

#[test]
fn e2e_python_draws_a_map_from_the_parquet_alone() {
    let Some(python) = python("polars, matplotlib") else {
        return;
    };
    let made = dataset();
    let dir = tempfile::tempdir().unwrap();
    let picture = dir.path().join("map.png");
    script(
        &python,
        "schemas/examples/python/fleet_map.py",
        &[text(&made.data), "--out", text(&picture)],
    );
    assert!(std::fs::metadata(&picture).unwrap().len() > 10_000);
}
