//! `ema prognosis`, as a process: forms, keys, refusals, histories that went wrong.

use crate::common::process::*;
use ema_tests::lives::{Options, files, generate};
use serde_json::Value;
use std::fmt::Write;
use std::path::{Path, PathBuf};

/// A history of one unit: FSJ from 1 by `rate` a flight.
fn history(dir: &Path, name: &str, rows: impl Iterator<Item = String>) -> PathBuf {
    let file = dir.join(name);
    let mut text = "actuator,time,cycle,outcome,fsj_lo,fsj_hi,fsj_estimate,coverage\n".to_string();
    rows.for_each(|r| writeln!(text, "{r}").unwrap());
    std::fs::write(&file, text).unwrap();
    file
}

fn level(i: u32) -> f64 {
    // a small even scatter
    1.0 + 0.01 * f64::from(i) + 0.001 * f64::from((i * 7) % 5) - 0.002
}

fn located(unit: &str, i: u32, x: f64) -> String {
    let (day, hour) = (1 + i / 4, 6 * (i % 4));
    let (month, day) = (1 + day / 28, 1 + day % 28);
    format!(
        "{unit},2025-{month:02}-{day:02}T{hour:02}:00:00Z,{i},located,{:.5},{:.5},{x:.5},0.95",
        x - 0.004,
        x + 0.004
    )
}

fn of(file: &Path, more: &[&str]) -> Value {
    let mut args = vec![
        "prognosis",
        file.to_str().unwrap(),
        "--threshold",
        "fsj=4",
        "--clock",
        "cycle",
        "--json",
    ];
    args.extend(more);
    json(&args)
}

#[test]
fn e2e_a_straight_history_is_foretold_with_all_keys() {
    let dir = tempfile::tempdir().unwrap();
    let file = history(
        dir.path(),
        "straight.csv",
        (1..=150).map(|i| located("N1.aileron", i, level(i))),
    );
    let v = of(&file, &[]);
    assert_eq!(
        (&v["actuator"], &v["fault"], &v["status"], &v["clock"]),
        (&"N1.aileron".into(), &"fsj".into(), &"ok".into(), &"cycle".into()),
        "{v}"
    );
    // 150 flights are left of 300
    let rul = |k: &str| v["rul"][k].as_f64().unwrap();
    assert!(
        (rul("median") - 150.0).abs() < 25.0 && rul("lo") < 150.0 && rul("hi") > 150.0,
        "{}",
        v["rul"]
    );
    assert!(
        (v["rate"]["estimate"].as_f64().unwrap() - 0.01).abs() < 0.002,
        "{}",
        v["rate"]
    );
    assert!((v["level"]["estimate"].as_f64().unwrap() - 2.5).abs() < 0.01);
    let laws: f64 = v["law"]
        .as_object()
        .unwrap()
        .values()
        .map(|m| m.as_f64().unwrap())
        .sum();
    assert!(
        (laws - 1.0).abs() < 1e-9 && v["law"]["linear"].as_f64().unwrap() > 0.3,
        "{}",
        v["law"]
    );
    for key in [
        "tests",
        "used",
        "change",
        "coverage",
        "calibration_lives",
        "p_fail",
        "next_test",
        "next_inspection",
        "risk",
        "alarms",
        "reason",
    ] {
        assert!(v.get(key).is_some(), "{key}");
    }
    assert!(v["p_fail"]["10"].as_f64() <= v["p_fail"]["50"].as_f64());
    let (test, inspection) = (v["next_test"].as_f64().unwrap(), v["next_inspection"].as_f64().unwrap());
    assert!(
        150.0 < test && test < inspection && inspection < 300.0,
        "{test} {inspection}"
    );
    // a horizon of one's own, by days, and for people
    assert!(of(&file, &["--horizon", "200"])["p_fail"]["200"].as_f64().unwrap() > 0.5);
    let text = succeeded(&mut ema(&[
        "prognosis",
        file.to_str().unwrap(),
        "--threshold",
        "fsj=4",
        "--clock",
        "day",
    ]));
    for word in ["FSJ", "rate", "RUL", "advice", "not calibrated", "2025-"] {
        assert!(text.contains(word), "{word} is missing in\n{text}");
    }
}

#[test]
fn e2e_tables_and_a_page_are_written_and_two_faults_have_a_joint_life() {
    let dir = tempfile::tempdir().unwrap();
    let options = Options {
        units: 3,
        seed: 5,
        two_faults: true,
        ..Options::default()
    };
    files::write(dir.path(), &options, &generate(&options)).unwrap();
    let (file, out) = (dir.path().join("history.csv"), dir.path().join("out"));
    let args = [
        "prognosis",
        file.to_str().unwrap(),
        "--threshold",
        "fsj=4",
        "--threshold",
        "zeta=0.4",
        "--clock",
        "flight",
        "--json",
        "--out",
        out.to_str().unwrap(),
    ];
    let text = succeeded(&mut ema(&args));
    let told: Vec<Value> = text.lines().map(|l| serde_json::from_str(l).unwrap()).collect();
    assert_eq!(told.len(), 9, "{text}");
    for unit in told.chunks(3) {
        assert_eq!(
            unit.iter().map(|v| v["fault"].as_str().unwrap()).collect::<Vec<_>>(),
            ["fsj", "zeta", "joint"]
        );
        if unit[2]["status"] == "passed" {
            assert!(unit[..2].iter().any(|v| v["status"] == "passed"), "{unit:?}");
            continue;
        }
        let median = |v: &Value| v["rul"]["median"].as_f64().unwrap_or(f64::INFINITY);
        assert!(median(&unit[2]) <= median(&unit[0]).min(median(&unit[1])), "{unit:?}");
    }
    for name in [
        "trends.parquet",
        "prognoses.parquet",
        "alarms.parquet",
        "report.html",
        "unit1_trend.svg",
        "unit1_left.svg",
    ] {
        assert!(out.join(name).metadata().is_ok_and(|m| m.len() > 500), "{name}");
    }
    let rows = schemas::table::read_batches(&out.join("prognoses.parquet")).unwrap();
    assert_eq!(rows.iter().map(|b| b.num_rows()).sum::<usize>(), 9);
}

#[test]
fn e2e_a_fleet_teaches_and_is_scored() {
    let dir = tempfile::tempdir().unwrap();
    let path = |name: &str| dir.path().join(name).to_str().unwrap().to_string();
    let options = Options {
        units: 30,
        seed: 6,
        ..Options::default()
    };
    files::write(dir.path(), &options, &generate(&options)).unwrap();
    let learn = [
        "prognosis",
        "learn",
        &path("history.csv"),
        "--events",
        &path("events.csv"),
        "--truth",
        &path("truth.csv"),
        "--clock",
        "cycle",
        "--out",
        &path("fleet.json"),
    ];
    assert!(succeeded(&mut ema(&learn)).contains("calibrated"));
    let score = [
        "prognosis",
        "score",
        &path("history.csv"),
        "--events",
        &path("events.csv"),
        "--truth",
        &path("truth.csv"),
        "--fleet",
        &path("fleet.json"),
        "--json",
    ];
    let v = json(&score);
    assert_eq!(
        (&v["fault"], v["at"].as_array().unwrap().len()),
        (&"fsj".into(), 3),
        "{v}"
    );
    assert!(v["coverage"].as_f64().unwrap() > 0.7 && v["units"].as_u64().unwrap() >= 28);
    let told = succeeded(&mut ema(&[
        "prognosis",
        &path("history.csv"),
        "--threshold",
        "fsj=4",
        "--fleet",
        &path("fleet.json"),
        "--json",
    ]));
    let first: Value = serde_json::from_str(told.lines().next().unwrap()).unwrap();
    assert!(
        told.lines().count() == 30 && first["calibration_lives"].as_u64().unwrap() >= 20,
        "{first}"
    );
    // a fleet for another threshold, and one that is none
    let o = run(&[
        "prognosis",
        &path("history.csv"),
        "--threshold",
        "fsj=3",
        "--fleet",
        &path("fleet.json"),
    ]);
    assert_eq!(o.status.code(), Some(4));
    assert!(String::from_utf8_lossy(&o.stderr).contains("for which the fleet was learned"));
    std::fs::write(
        dir.path().join("fleet.json"),
        "{\"what\":\"ema fleet\",\"schema_version\":1,\"fleets\":[]}",
    )
    .unwrap();
    let o = run(&[
        "prognosis",
        &path("history.csv"),
        "--threshold",
        "fsj=4",
        "--fleet",
        &path("fleet.json"),
    ]);
    assert_eq!(o.status.code(), Some(4));
}

#[test]
fn e2e_poisoned_histories_get_a_right_answer_or_one_line() {
    let dir = tempfile::tempdir().unwrap();
    let d = dir.path();
    let straight = || (1..=150).map(|i| located("N1", i, level(i)));
    let clean = of(&history(d, "clean.csv", straight()), &[]);
    let near = |v: &Value| {
        let m = |v: &Value| v["rul"]["median"].as_f64().unwrap();
        assert!(
            (m(v) - m(&clean)).abs() < 0.25 * m(&clean),
            "{} {}",
            v["rul"],
            clean["rul"]
        );
    };
    // every row twice, and in no order: the same bits
    let twice: Vec<String> = straight().flat_map(|r| [r.clone(), r]).collect();
    let doubled = of(&history(d, "twice.csv", twice.into_iter()), &[]);
    let mut shuffled: Vec<String> = straight().collect();
    shuffled.sort_by_key(|r| r.len() * 31 + r.bytes().map(usize::from).sum::<usize>() % 97);
    let disordered = of(&history(d, "disorder.csv", shuffled.into_iter()), &[]);
    for key in ["rul", "level", "rate", "law"] {
        assert_eq!(doubled[key], clean[key]);
        assert_eq!(disordered[key], clean[key]);
    }
    // intervals of other coverages
    let mixed = straight()
        .enumerate()
        .map(|(i, r)| if i % 2 == 0 { r.replace(",0.95", ",0.5") } else { r });
    near(&of(&history(d, "mixed.csv", mixed), &[]));
    // forty unexplained in a row
    let blind = |i: u32| {
        format!("N1,2025-03-01T00:00:00Z,{i},unexplained,,,,0.95")
            .replace("2025-03-01T00:00:00Z", &located("N1", i, 1.0)[3..23])
    };
    let unexplained = (1..=150).map(|i| if i > 110 { blind(i) } else { located("N1", i, level(i)) });
    let v = of(&history(d, "unexplained.csv", unexplained), &[]);
    assert_eq!(v["status"], "doubtful", "{v}");
    assert!(
        v["alarms"]
            .as_array()
            .unwrap()
            .iter()
            .any(|a| a["kind"] == "unexplained_run")
    );
    // three tests; one; the threshold is passed; out of range
    assert_eq!(
        of(&history(d, "three.csv", straight().take(3)), &[])["status"],
        "too_early"
    );
    assert_eq!(
        of(&history(d, "one.csv", straight().take(1)), &[])["rul"]["median"],
        Value::Null
    );
    let passed = (1..=330).map(|i| located("N1", i, level(i)));
    assert_eq!(of(&history(d, "passed.csv", passed), &[])["status"], "passed");
    let beyond = (1..=340).map(|i| {
        if i > 300 {
            blind(i).replace("unexplained", "out_of_range")
        } else {
            located("N1", i, level(i))
        }
    });
    assert_eq!(of(&history(d, "beyond.csv", beyond), &[])["status"], "passed");
    // two units under one name; clocks that disagree
    let two = (1..=150).map(|i| located("N1", i, if i % 2 == 0 { level(i) } else { 1.02 }));
    let v = of(&history(d, "two.csv", two), &[]);
    assert_eq!(v["status"], "refused", "{}", v["reason"]);
    let turned = (1..=150).map(|i| located("N1", i, level(i)).replace(&format!(",{i},"), &format!(",{},", 151 - i)));
    let v = of(&history(d, "turned.csv", turned), &[]);
    assert!(
        v["status"] == "refused" && v["reason"].as_str().unwrap().contains("clocks"),
        "{v}"
    );
    // fifty thousand tests
    let many = (1..=50_000).map(|i| {
        let x = 1.0 + 2.0 * f64::from(i) / 50_000.0 + 1e-3 * f64::from((i * 7) % 5);
        format!("N1,,{i},located,{:.5},{:.5},{x:.5},0.95", x - 0.004, x + 0.004)
    });
    assert_eq!(of(&history(d, "many.csv", many), &[])["status"], "ok");
    // one line each
    let bad = |name: &str, from: &str, to: &str, place: &str| {
        let rows: Vec<String> = straight()
            .enumerate()
            .map(|(i, r)| if i == 9 { r.replace(from, to) } else { r })
            .collect();
        let file = history(d, name, rows.into_iter());
        let o = run(&[
            "prognosis",
            file.to_str().unwrap(),
            "--threshold",
            "fsj=4",
            "--clock",
            "cycle",
        ]);
        let said = String::from_utf8_lossy(&o.stderr);
        assert_eq!(o.status.code(), Some(4), "{name}: {said}");
        assert!(
            said.lines().count() == 1 && said.contains(name) && said.contains(place),
            "{name}: {said}"
        );
    };
    let row = located("N1", 10, level(10));
    let cells: Vec<&str> = row.split(',').collect();
    bad("nan.csv", cells[4], "NaN", "line 11, column `fsj_lo`");
    bad("inf.csv", cells[6], "inf", "line 11, column `fsj_estimate`");
    bad("turned_ends.csv", cells[4], "9.5", "line 11, column `fsj_lo`");
    bad("coverage.csv", ",0.95", ",95", "line 11, column `coverage`");
    bad("outcome.csv", "located", "lost", "line 11, column `outcome`");
    bad("time.csv", cells[1], "soon", "line 11, column `time`");
    bad("name.csv", "N1,", ",", "line 11, column `actuator`");
    for (args, allowed) in [
        (&["--threshold", "fsj"][..], "FAULT=LEVEL"),
        (&["--threshold", "stall=heavy"], "a load torque at the motor above 0"),
        (
            &["--threshold", "stall=5Nm"],
            "does not move in time when it is healthy",
        ),
        (
            &["--threshold", "stall=0.7Nm"],
            "lo, hi and estimate of fsj and of zeta",
        ),
        (&["--threshold", "fsj=1"], "a level other than the healthy one"),
    ] {
        let file = d.join("clean.csv");
        let o = run(&[&["prognosis", file.to_str().unwrap()], args].concat());
        assert_eq!(o.status.code(), Some(4));
        assert!(String::from_utf8_lossy(&o.stderr).contains(allowed));
    }
}

#[test]
fn e2e_a_log_of_live_diagnoses_is_read_as_it_is() {
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("diagnoses.jsonl");
    let mut text = String::new();
    for i in 1..=60_u32 {
        let x = level(2 * i);
        let v = serde_json::json!({
            "time_ns": 1_750_000_000_000_000_000_u64 + u64::from(i) * 21_600_000_000_000, "actuator": "N2", "final": i % 9 != 0,
            "outcome": "located", "coverage": 0.95, "fsj": {"lo": x - 0.004, "hi": x + 0.004, "estimate": x},
            "zeta": {"lo": 0.1, "hi": 0.11, "estimate": 0.105},
        });
        writeln!(text, "{v}").unwrap();
    }
    std::fs::write(&file, text).unwrap();
    let v = json(&["prognosis", file.to_str().unwrap(), "--threshold", "fsj=4", "--json"]);
    assert_eq!(
        (&v["clock"], &v["tests"], &v["status"]),
        (&"day".into(), &54.into(), &"ok".into()),
        "{v}"
    );
    // 0.08 a day from 2.2
    assert!(
        (v["rul"]["median"].as_f64().unwrap() - 22.0).abs() < 6.0,
        "{}",
        v["rul"]
    );
}

/// A fleet that wears: lives, simulated tests, diagnoses, prognoses, questions.
#[test]
fn e2e_a_fleet_that_wears_is_made_diagnosed_and_foretold() {
    let dir = tempfile::tempdir().unwrap();
    let path = |name: &str| dir.path().join(name).to_str().unwrap().to_string();
    let plan = r#"name = "worn"
seed = 4
grid = "coarse"
sensors = "reference"
rate_hz = 5000.0
[aircraft]
tails = { prefix = "T-", from = 1, count = 6 }
positions = ["aileron"]
[tests]
per_actuator = 24
[wear]
flights = 240
flights_per_day = { from = 2, to = 5 }
missed = 0.1
replaced = { share = 0.6, recorded = 1 }
temperature = { yearly_k = 10, daily_k = 2 }
[wear.fsj]
life_flights = { from = 150, to = 500 }
"#;
    std::fs::write(path("plan.toml"), plan).unwrap();
    let (fleet, outlook) = (path("fleet"), path("outlook"));
    ok(&["dataset", "make", &path("plan.toml"), "--out", &fleet]);
    ok(&["dataset", "verify", &fleet]);
    refused(&["prognosis", &fleet], &["no diagnoses", "ema dataset diagnose"]);
    ok(&["dataset", "diagnose", &fleet]);
    ok(&["dataset", "verify", &fleet]);
    // the same plan again: what the diagnosis added is no stranger
    ok(&["dataset", "make", &path("plan.toml"), "--out", &fleet]);
    let sql = "SELECT actuator, cycle, fsj, fsj_lo, fsj_hi, zeta, winding_temperature_degc AS warm FROM diagnoses ORDER BY run";
    let rows: Value = serde_json::from_str(&ok(&[
        "query", sql, "--data", &fleet, "--format", "json", "--rows", "0",
    ]))
    .unwrap();
    let rows = rows.as_array().unwrap();
    assert_eq!(rows.len(), 6 * 24);
    let number = |r: &Value, k: &str| r[k].as_f64();
    let held = rows
        .iter()
        .filter(|r| match (number(r, "fsj_lo"), number(r, "fsj_hi")) {
            (Some(lo), Some(hi)) => (lo..=hi).contains(&number(r, "fsj").unwrap()),
            _ => false,
        });
    assert!(held.count() > 115, "{rows:?}");
    assert!(rows.iter().all(|r| number(r, "zeta") == Some(0.0)));
    let warm: Vec<f64> = rows.iter().filter_map(|r| number(r, "warm")).collect();
    assert!(
        warm.iter().any(|k| *k < 15.0) && warm.iter().all(|k| (-10.0..50.0).contains(k)),
        "{warm:?}"
    );
    // FSJ falls only where an actuator was replaced, which is on record
    let events = std::fs::read_to_string(path("fleet/wear/events.csv")).unwrap();
    let replaced: Vec<&str> = events.lines().skip(1).map(|l| l.split(',').next().unwrap()).collect();
    assert!(!replaced.is_empty() && replaced.len() < 6, "{events}");
    for pair in rows.windows(2).filter(|w| w[0]["actuator"] == w[1]["actuator"]) {
        let fell = number(&pair[1], "fsj") < number(&pair[0], "fsj");
        assert!(
            !fell || replaced.contains(&pair[0]["actuator"].as_str().unwrap()),
            "{pair:?}"
        );
    }
    // read as it is; repairs of record are taken from it
    ok(&[
        "prognosis",
        &fleet,
        "--threshold",
        "fsj=4",
        "--clock",
        "cycle",
        "--out",
        &outlook,
    ]);
    let ask = |question: &str| -> Vec<Value> {
        let text = ok(&["query", question, "--data", &outlook, "--format", "json", "--rows", "0"]);
        serde_json::from_str::<Value>(&text)
            .unwrap()
            .as_array()
            .unwrap()
            .clone()
    };
    let at_risk = ask("at-risk");
    assert_eq!(at_risk.len(), 6, "{at_risk:?}");
    let lo: Vec<f64> = at_risk
        .iter()
        .filter(|r| r["status"] != "passed")
        .filter_map(|r| number(r, "rul_lo"))
        .collect();
    assert!(lo.is_sorted(), "{at_risk:?}");
    let growth = ask("growth");
    assert_eq!(growth.len(), 6, "{growth:?}");
    let last: f64 = growth.iter().map(|r| number(r, "tests").unwrap()).sum();
    assert!(
        last < 6.0 * 24.0,
        "tests before a replacement count no more: {growth:?}"
    );
    ask("what-changed");
    let changed = ask("SELECT actuator FROM trends WHERE segment = 1 GROUP BY actuator");
    assert!(!changed.is_empty(), "{events}");
    let score = json(&[
        "prognosis",
        "score",
        &fleet,
        "--truth",
        &path("fleet/wear/truth.csv"),
        "--threshold",
        "fsj=4",
        "--clock",
        "cycle",
        "--json",
    ]);
    assert!(score["units"].as_u64().unwrap() >= 3, "{score}");
}
