//! `ema` as a process: datasets that survive kills, diagnoses, refusals.

mod common;

use common::process::*;
use ema_tests::programs;
use serde_json::Value;
use std::collections::BTreeMap;
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::Duration;

/// Of a diagnosis, which may be incomplete.
fn json(args: &[&str]) -> Value {
    let o = run(args);
    assert!(
        matches!(o.status.code(), Some(0 | 3)),
        "{args:?}: {}",
        String::from_utf8_lossy(&o.stderr)
    );
    serde_json::from_slice(&o.stdout).unwrap()
}

/// Names and contents of all visible files below a folder.
fn contents(dir: &Path) -> BTreeMap<String, Vec<u8>> {
    let mut all = BTreeMap::new();
    let mut stack = vec![dir.to_path_buf()];
    while let Some(d) = stack.pop() {
        for e in std::fs::read_dir(d).unwrap().flatten() {
            let p = e.path();
            if p.is_dir() {
                stack.push(p);
            } else {
                all.insert(
                    p.strip_prefix(dir).unwrap().display().to_string(),
                    std::fs::read(&p).unwrap(),
                );
            }
        }
    }
    all
}

#[test]
fn e2e_a_killed_simulation_resumes_to_the_same_bytes() {
    let dir = tempfile::tempdir().unwrap();
    let (whole, killed) = (dir.path().join("whole"), dir.path().join("killed"));
    let args = |out: &Path| -> Vec<String> {
        [
            "simulate",
            "--grid",
            "standard",
            "--rate",
            "1000",
            "--sensors",
            "reference",
            "--out",
            text(out),
        ]
        .map(String::from)
        .to_vec()
    };
    let o = ema(&[]).args(args(&whole)).output().unwrap();
    assert!(o.status.success(), "{}", String::from_utf8_lossy(&o.stderr));
    let mut kills = 0;
    for wait in [150, 320, 240, 410, 90, 350, 280, 500] {
        // one thread: slow enough to be killed on any machine
        let mut child = ema(&[])
            .args(args(&killed))
            .args(["--jobs", "1"])
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        std::thread::sleep(Duration::from_millis(wait));
        if child.try_wait().unwrap().is_none() {
            kills += 1;
        }
        let _ = child.kill();
        child.wait().unwrap();
        // whatever is visible is whole
        for (name, bytes) in contents(&killed) {
            if name.ends_with(".parquet") && !name.contains("/tmp/") {
                let end = &bytes[bytes.len().saturating_sub(4)..];
                assert!(end == b"PAR1", "{name}");
            }
        }
    }
    println!("{kills} kills");
    assert!(kills >= 1);
    let o = ema(&[]).args(args(&killed)).output().unwrap();
    assert!(o.status.success(), "{}", String::from_utf8_lossy(&o.stderr));
    let (a, b) = (contents(&whole), contents(&killed));
    assert_eq!(a.keys().collect::<Vec<_>>(), b.keys().collect::<Vec<_>>());
    // plan, manifest, actuators, features, and the telemetry of three parts of 64 runs
    assert_eq!(a.len(), 1 + 1 + 1 + 1 + 3);
    assert!(a == b, "the same bytes");
    // another plan is refused, and nothing is touched
    refused(
        &["simulate", "--grid", "coarse", "--rate", "1000", "--out", text(&killed)],
        &["fingerprint of the plan", "another place for the dataset"],
    );
    assert!(contents(&killed) == b);
    let whole = ok(&["dataset", "verify", text(&killed)]);
    assert!(whole.contains("187 runs") && whole.contains("whole"), "{whole}");
    // maps and queries on it; `ema dataset maps` is the same command
    let maps = ok(&["maps", text(&killed)]);
    assert!(maps.contains("ripple"), "{maps}");
    assert_eq!(ok(&["dataset", "maps", text(&killed)]), maps);
    let n = ok(&[
        "query",
        "SELECT COUNT(*) AS n FROM runs",
        "--data",
        text(&killed),
        "--format",
        "csv",
    ]);
    assert_eq!(n.trim(), format!("n\n{}", 187 * 3000));
    let first = ok(&[
        "query",
        "SELECT p1_rad_per_s, p3 FROM features WHERE fsj = 1 AND zeta = 0",
        "--data",
        text(&killed),
        "--format",
        "json",
    ]);
    let first: Value = serde_json::from_str(&first).unwrap();
    assert_eq!(first[0]["p3"], 1.0);
    let n = ok(&[
        "query",
        "SELECT COUNT(*) AS n FROM maps WHERE feature = 'p1'",
        "--data",
        text(&killed),
        "--format",
        "csv",
    ]);
    assert_eq!(n.trim(), "n\n187");
    // ready questions are for one actuator too
    let levels = ok(&["query", "fault-levels", "--data", text(&killed), "--format", "csv"]);
    assert!(levels.lines().count() == 1 + 4 * 187, "{levels}");
    // a run of the dataset is located by the dataset's maps: from the dataset, from the file of its part, exported
    let file = killed.join("telemetry/sequence=preflight/actuator=reference/part-0001.parquet");
    let one = dir.path().join("one.parquet");
    ok(&["dataset", "export", text(&killed), "--run", "93", "--out", text(&one)]);
    let of = |args: &[&str]| {
        let maps = ["--maps", text(&killed), "--json"];
        json(&[&["diagnose"], args, &maps].concat())
    };
    let d = of(&[text(&killed), "--run", "93"]);
    assert_eq!(d["outcome"], "located", "{d}");
    assert_eq!(of(&[text(&file), "--run", "93"]), d);
    assert_eq!(of(&[text(&one)]), d);
    let truth = (1.0 + 0.25 * f64::from(93 % 17), 0.05 * f64::from(93 / 17));
    assert!((d["fsj"]["estimate"].as_f64().unwrap() - truth.0).abs() < 0.2, "{d}");
    assert!((d["zeta"]["estimate"].as_f64().unwrap() - truth.1).abs() < 0.05, "{d}");
    refused(&["diagnose", text(&killed)], &["187 runs", "--run NUMBER"]);
    refused(&["diagnose", text(&killed), "--run", "187"], &["187", "0 to 186"]);
    // a torn file is refused, not read halfway
    let bytes = std::fs::read(&one).unwrap();
    let torn = dir.path().join("torn.parquet");
    std::fs::write(&torn, &bytes[..bytes.len() / 2]).unwrap();
    refused(
        &["diagnose", text(&torn)],
        &[
            "torn.parquet",
            "not a whole Parquet file",
            &(bytes.len() / 2).to_string(),
        ],
    );
    // two writers at once come to the same bytes
    let both = dir.path().join("both");
    let writers = [(); 2].map(|()| ema(&[]).args(args(&both)).stdout(Stdio::null()).spawn().unwrap());
    for mut w in writers {
        assert!(w.wait().unwrap().success());
    }
    assert!(contents(&both) == a, "the same bytes");
    // a folder of version 0.1 is refused, and what makes a new one is named
    let old = dir.path().join("old");
    std::fs::create_dir_all(old.join("features")).unwrap();
    std::fs::write(old.join("plan.txt"), "plan 0123456789abcdef\n").unwrap();
    let o = text(&old);
    for command in [
        &["maps", o][..],
        &["query", "SELECT 1 FROM features", "--data", o],
        &["dataset", "verify", o],
        &["simulate", "--grid", "coarse", "--out", o],
        &["diagnose", o, "--run", "3"],
    ] {
        refused(
            command,
            &["plan.txt, a dataset of version 0.1", "ema simulate --out NEW"],
        );
    }
    assert_eq!(contents(&old).len(), 1);
}

/// Runs, sends Ctrl-C after a while, and expects to hear of it.
#[cfg(unix)]
fn interrupted(args: &[&str], after: Duration) {
    let mut program = ema(&[]);
    let child = program
        .args(args)
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    std::thread::sleep(after);
    let pid = child.id().to_string();
    assert!(Command::new("kill").args(["-INT", &pid]).status().unwrap().success());
    let o = child.wait_with_output().unwrap();
    assert_eq!(o.status.code(), Some(130), "{}", String::from_utf8_lossy(&o.stderr));
    assert!(String::from_utf8_lossy(&o.stderr).contains("interrupted"));
}

#[cfg(unix)]
#[test]
fn e2e_ctrl_c_leaves_things_clean() {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("d");
    let simulate = [
        "simulate",
        "--grid",
        "fine",
        "--keep",
        "features",
        "--jobs",
        "1",
        "--out",
        text(&out),
    ];
    interrupted(&simulate, Duration::from_millis(700));
    assert!(contents(&out).keys().all(|k| !k.contains(".tmp-")));
}

#[cfg(unix)]
#[test]
fn e2e_a_study_gives_up_at_ctrl_c_and_writes_nothing() {
    let dir = tempfile::tempdir().unwrap();
    let (recording, out) = (dir.path().join("run.parquet"), dir.path().join("found"));
    let faulty = ["--fsj", "3", "--zeta", "0.3", "--sensors", "reference"];
    ok(&[
        &["run"],
        &faulty[..],
        &["--sequence", "multisine", "--out", text(&recording)],
    ]
    .concat());
    let study = ["discrepancy", "--bench", text(&recording), "--out", text(&out)];
    interrupted(&study, Duration::from_millis(150));
    assert!(!out.exists() || contents(&out).is_empty());
}

#[test]
fn e2e_reference_recording_is_located_within_bounds() {
    let Some(dir) = ema_tests::folder("EMA_REFERENCE_DIR") else {
        return;
    };
    for (name, fsj, zeta) in [
        ("preflight_fsj3_zeta0.3_10kHz.csv", 3.0, 0.3),
        ("preflight_fsj3_zeta0.3.csv", 3.0, 0.3),
        ("preflight_fsj1_zeta0.csv", 1.0, 0.0),
    ] {
        let d = json(&["diagnose", text(&dir.join(name)), "--json"]);
        let get = |a: &str, b: &str| d[a][b].as_f64().unwrap();
        println!("{name}: {d}");
        assert_eq!(d["outcome"], "located");
        assert!(get("fsj", "lo") <= fsj && fsj <= get("fsj", "hi"));
        assert!(get("zeta", "lo") <= zeta && zeta <= get("zeta", "hi"));
        assert!(get("fsj", "hi") - get("fsj", "lo") < 0.2);
        assert!(get("zeta", "hi") - get("zeta", "lo") < 0.03);
    }
}

#[test]
fn e2e_outcomes() {
    let dir = tempfile::tempdir().unwrap();
    let file = |n: &str| dir.path().join(n);
    // located, from Parquet through the sensors and from CSV, at an odd rate and rest angle
    let p = file("a.parquet");
    ok(&[
        "run",
        "--fsj",
        "2.6",
        "--zeta",
        "0.33",
        "--sensors",
        "reference",
        "--seed",
        "3",
        "--out",
        text(&p),
    ]);
    let d = json(&["diagnose", text(&p), "--json"]);
    assert_eq!(d["outcome"], "located", "{d}");
    assert!((d["fsj"]["estimate"].as_f64().unwrap() - 2.6).abs() < 0.02);
    let c = file("b.csv");
    ok(&[
        "run",
        "--fsj",
        "1.7",
        "--zeta",
        "0.12",
        "--rate",
        "2500",
        "--rest-angle-deg",
        "40",
        "--out",
        text(&c),
    ]);
    let d = json(&["diagnose", text(&c), "--json", "--grid", "standard"]);
    assert_eq!(d["outcome"], "located", "{d}");
    assert!((d["zeta"]["estimate"].as_f64().unwrap() - 0.12).abs() < 0.01, "{d}");
    // without phase currents, through maps made from i_eq
    let table = std::fs::read_to_string(&c).unwrap();
    let narrow = file("narrow.csv");
    let lines: Vec<String> = table
        .lines()
        .map(|l| l.split(',').take(6).collect::<Vec<_>>().join(","))
        .collect();
    std::fs::write(&narrow, lines.join("\n")).unwrap();
    let d = json(&["diagnose", text(&narrow), "--json", "--grid", "standard"]);
    assert_eq!(d["outcome"], "located", "{d}");
    // beyond the maps
    let far = file("far.parquet");
    ok(&[
        "run",
        "--fsj",
        "6.5",
        "--zeta",
        "0.1",
        "--sensors",
        "reference",
        "--out",
        text(&far),
    ]);
    let d = json(&["diagnose", text(&far), "--json"]);
    assert_eq!(d["outcome"], "out_of_range", "{d}");
    assert!(d["fsj"]["estimate"].is_null());
    // cut off before the step
    let short = file("short.csv");
    let rows: Vec<&str> = table.lines().take(1 + 2500 * 2).collect();
    std::fs::write(&short, rows.join("\n")).unwrap();
    let o = run(&["diagnose", text(&short), "--json", "--grid", "standard"]);
    assert_eq!(o.status.code(), Some(3));
    let d: Value = serde_json::from_slice(&o.stdout).unwrap();
    assert_eq!(d["outcome"], "incomplete");
    assert!(d["reason"].as_str().unwrap().contains("step window"), "{d}");
    // another actuator's recording passed off as the reference's: a third more inertia and supply
    let toml = std::fs::read_to_string(concat!(
        env!("CARGO_MANIFEST_DIR"),
        "/../datasets/parameters/reference.toml"
    ))
    .unwrap();
    let other = file("other.toml");
    std::fs::write(
        &other,
        toml.replace("value = 0.0376", "value = 0.0395")
            .replace("\"reference\"", "\"other\""),
    )
    .unwrap();
    let alien = file("alien.csv");
    ok(&[
        "run",
        "--actuator",
        text(&other),
        "--fsj",
        "2",
        "--zeta",
        "0.2",
        "--out",
        text(&alien),
    ]);
    let d = json(&["diagnose", text(&alien), "--json"]);
    assert!(d["outcome"] == "unexplained" || d["outcome"] == "out_of_range", "{d}");
    assert!(!d["reason"].as_str().unwrap().is_empty());
}

#[test]
fn e2e_a_query_passes_its_exit_code_and_output_through() {
    // ema alone in its folder, and the other program in PATH
    let dir = tempfile::tempdir_in(env!("CARGO_TARGET_TMPDIR")).unwrap();
    let [here, there] = ["here", "there"].map(|n| dir.path().join(n));
    programs(&here, &[("ema", EMA)]);
    programs(&there, &[("ema-query", QUERY)]);
    let ask = |args: &[&str]| {
        let o = Command::new(here.join("ema"))
            .env("PATH", &there)
            .arg("query")
            .args(args)
            .stdin(Stdio::null())
            .output()
            .unwrap();
        let [out, err] = [o.stdout, o.stderr].map(|b| String::from_utf8(b).unwrap());
        (o.status.code(), out, err)
    };
    let (code, out, err) = ask(&["--list"]);
    assert_eq!((code, err.as_str()), (Some(0), ""));
    assert!(out.contains("tables for SQL:"), "{out}");
    let (code, out, _) = ask(&["--help"]);
    assert_eq!(code, Some(0));
    assert!(
        out.contains("Usage: ema query") && out.contains("Ready questions:"),
        "{out}"
    );
    let (code, out, err) = ask(&[]);
    assert_eq!((code, out.as_str()), (Some(2), ""));
    assert!(err.contains("Usage: ema query"), "{err}");
    // what follows -- is no option, there either
    for args in [&["no-question"][..], &["--", "--no-question"]] {
        let (code, out, err) = ask(args);
        assert_eq!((code, out.as_str()), (Some(4), ""), "{err}");
        assert!(err.starts_with("ema: "), "{err}");
        assert_eq!(err.lines().count(), 1, "{err}");
    }
}

#[test]
fn refuse_query_without_its_program_names_the_command_that_builds_it() {
    let dir = tempfile::tempdir_in(env!("CARGO_TARGET_TMPDIR")).unwrap();
    programs(dir.path(), &[("ema", EMA)]);
    let ema = || Command::new(dir.path().join("ema"));
    for args in [&["query", "--list"][..], &["query", "--help"], &["query"]] {
        let o = ema().env("PATH", dir.path()).args(args).output().unwrap();
        let err = String::from_utf8(o.stderr).unwrap();
        assert_eq!(o.status.code(), Some(4), "{err}");
        assert_eq!(o.stdout, b"");
        assert_eq!(err.lines().count(), 1, "{err}");
        for word in ["ema: ", "`ema-query`", "cargo build --release -p ema-query"] {
            assert!(err.contains(word), "no `{word}` in {err}");
        }
    }
    // it is a command of ema all the same
    let o = ema().arg("--help").output().unwrap();
    let help = String::from_utf8(o.stdout).unwrap();
    assert!(help.contains("SQL and ready questions over a dataset"), "{help}");
}

#[test]
fn refuse_bad_telemetry() {
    let dir = tempfile::tempdir().unwrap();
    let good = dir.path().join("good.csv");
    ok(&["run", "--rate", "1000", "--out", text(&good)]);
    let table = std::fs::read_to_string(&good).unwrap();
    let bad = |name: &str, content: String| {
        let p = dir.path().join(name);
        std::fs::write(&p, content).unwrap();
        p
    };
    let edit = |row: usize, column: usize, value: &str| {
        let mut lines: Vec<String> = table.lines().map(String::from).collect();
        let mut cells: Vec<&str> = lines[row].split(',').collect();
        cells[column] = value;
        lines[row] = cells.join(",");
        lines.join("\n")
    };
    let p = bad("column.csv", table.replacen("theta_m", "angle", 1));
    refused(
        &["diagnose", text(&p)],
        &["column.csv", "header", "angle", "missing: theta_m"],
    );
    let p = bad("nan.csv", edit(1200, 4, "NaN"));
    refused(
        &["diagnose", text(&p)],
        &["nan.csv", "line 1201", "omega_m", "NaN", "finite"],
    );
    let p = bad("word.csv", edit(17, 2, "abc"));
    refused(&["diagnose", text(&p)], &["line 18", "theta_u", "abc"]);
    let p = bad("back.csv", edit(500, 0, "0.4"));
    refused(&["diagnose", text(&p)], &["back.csv", "line 501", "0.4", "after 0.499"]);
    let p = bad("jump.csv", edit(500, 0, "0.5004"));
    refused(
        &["diagnose", text(&p)],
        &["jump.csv", "line 501", "0.5004", "steady 1000 Hz"],
    );
    let p = bad("empty.csv", String::new());
    refused(&["diagnose", text(&p)], &["empty.csv", "0 bytes"]);
    let p = bad("head.csv", table.lines().next().unwrap().to_string());
    refused(&["diagnose", text(&p)], &["head.csv", "0 rows", "at least 2"]);
    let p = bad("ragged.csv", table.replacen("\n0.002,", "\n0.002,7,", 1));
    refused(&["diagnose", text(&p)], &["ragged.csv", "line 3"]);
    let slow: Vec<&str> = table
        .lines()
        .enumerate()
        .filter(|(i, _)| *i == 0 || i % 2 == 0)
        .map(|(_, l)| l)
        .collect();
    let p = bad("slow.csv", slow.join("\n"));
    refused(&["diagnose", text(&p)], &["slow.csv", "500", "at least 1000 Hz"]);
    let shifted = |l: &str| {
        let mut cells: Vec<&str> = l.split(',').collect();
        cells[1] = if cells[1] == "com" { "com" } else { "0.5" };
        cells.join(",")
    };
    let p = bad("other.csv", table.lines().map(shifted).collect::<Vec<_>>().join("\n"));
    refused(
        &["diagnose", text(&p)],
        &["other.csv", "com", "no known sequence follows"],
    );
    let p = bad("twice.csv", table.replacen("i_b", "i_a", 1));
    refused(
        &["diagnose", text(&p)],
        &["twice.csv", "`i_a` again", "each column once"],
    );
    let late: Vec<&str> = table
        .lines()
        .enumerate()
        .filter(|(i, _)| *i == 0 || *i > 900)
        .map(|(_, l)| l)
        .collect();
    let p = bad("late.csv", late.join("\n"));
    let d = json(&["diagnose", text(&p), "--json", "--grid", "standard"]);
    assert_eq!(d["outcome"], "incomplete", "{d}");
    assert!(d["reason"].as_str().unwrap().contains("rest is unknown"), "{d}");
    let loaded = dir.path().join("loaded.parquet");
    ok(&["run", "--rate", "1000", "--load-n-m", "0.05", "--out", text(&loaded)]);
    refused(
        &["diagnose", text(&loaded), "--grid", "standard"],
        &["load torque", "0.05"],
    );
    let p = bad("noise.parquet", "PAR1 but no more".into());
    refused(&["diagnose", text(&p)], &["noise.parquet", "not a whole Parquet file"]);
    refused(
        &["diagnose", text(&dir.path().join("none.csv"))],
        &["none.csv", "cannot be read"],
    );
    // another actuator's file, another schema version
    let toml = std::fs::read_to_string(concat!(
        env!("CARGO_MANIFEST_DIR"),
        "/../datasets/parameters/reference.toml"
    ))
    .unwrap();
    let other = bad("other.toml", toml.replace("value = 48.0", "value = 50.0"));
    let alien = dir.path().join("alien.parquet");
    ok(&[
        "run",
        "--actuator",
        text(&other),
        "--rate",
        "1000",
        "--sequence",
        "sine",
        "--out",
        text(&alien),
    ]);
    refused(
        &["diagnose", text(&alien)],
        &["alien.parquet", "parameter fingerprint", "--actuator"],
    );
    let bytes = std::fs::read(&alien).unwrap();
    let key = b"ema.schema_version";
    let at = bytes.windows(key.len()).rposition(|w| w == key).unwrap() + key.len();
    let digit = (at..at + 8).find(|&i| bytes[i] == b'1').unwrap();
    let mut changed = bytes.clone();
    changed[digit] = b'9';
    let old = dir.path().join("old.parquet");
    std::fs::write(&old, changed).unwrap();
    refused(
        &["diagnose", text(&old)],
        &["old.parquet", "schema_version", "found 9", "schema version 1"],
    );
    // nothing half written
    refused(
        &["run", "--out", text(&dir.path().join("x.csv")), "--zeta", "1.5"],
        &["zeta", "1.5", "zeta < 1"],
    );
    refused(
        &["run", "--out", text(&dir.path().join("x.txt"))],
        &["x.txt", ".csv or .parquet"],
    );
    assert!(!dir.path().join("x.csv").exists());
    assert!(
        std::fs::read_dir(dir.path())
            .unwrap()
            .flatten()
            .all(|e| !e.file_name().to_string_lossy().contains(".tmp-"))
    );
}

#[test]
fn refuse_maps_of_another_actuator_rate_or_rest_angle() {
    let dir = tempfile::tempdir().unwrap();
    let data = dir.path().join("d");
    ok(&[
        "simulate",
        "--grid",
        "coarse",
        "--rate",
        "1000",
        "--keep",
        "features",
        "--out",
        text(&data),
    ]);
    let o = run(&["maps", text(&data)]);
    // so coarse a grid may be refused as not monotone, but never silently
    assert!(
        o.status.success() || o.status.code() == Some(4),
        "{}",
        String::from_utf8_lossy(&o.stderr)
    );
    ok(&["maps", text(&data), "--lenient"]);
    let r = dir.path().join("r.csv");
    ok(&["run", "--rate", "2000", "--out", text(&r)]);
    refused(
        &["diagnose", text(&r), "--maps", text(&data)],
        &["rate", "2000", "1000", "maps.parquet"],
    );
    ok(&["run", "--rate", "1000", "--rest-angle-deg", "10", "--out", text(&r)]);
    refused(
        &["diagnose", text(&r), "--maps", text(&data)],
        &["rest", "10.00", "0.00"],
    );
    let toml = std::fs::read_to_string(concat!(
        env!("CARGO_MANIFEST_DIR"),
        "/../datasets/parameters/reference.toml"
    ))
    .unwrap();
    let other = dir.path().join("other.toml");
    std::fs::write(&other, toml.replace("value = 48.0", "value = 50.0")).unwrap();
    ok(&["run", "--rate", "1000", "--actuator", text(&other), "--out", text(&r)]);
    refused(
        &["diagnose", text(&r), "--actuator", text(&other), "--maps", text(&data)],
        &["parameters of actuator"],
    );
    refused(
        &["maps", text(&data), "--id", text(&other)],
        &["--id", "an actuator of the dataset", "reference"],
    );
    // a torn maps file
    let file = data.join("maps.parquet");
    let bytes = std::fs::read(&file).unwrap();
    std::fs::write(&file, &bytes[..bytes.len() - 100]).unwrap();
    ok(&["run", "--rate", "1000", "--out", text(&r)]);
    refused(
        &["diagnose", text(&r), "--maps", text(&data)],
        &["maps.parquet", "not a whole Parquet file"],
    );
}

#[test]
fn refuse_what_physics_forbids() {
    let dir = tempfile::tempdir().unwrap();
    let toml = std::fs::read_to_string(concat!(
        env!("CARGO_MANIFEST_DIR"),
        "/../datasets/parameters/reference.toml"
    ))
    .unwrap();
    let file = dir.path().join("actuator.toml");
    let out = dir.path().join("x.csv");
    for (from, to, words) in [
        (
            "value = 1.065",
            "value = -1.0",
            ["motor.phase_resistance_ohm", "-1", "above 0"],
        ),
        (
            "value = 1.065",
            "value = nan",
            ["motor.phase_resistance_ohm", "NaN", "above 0"],
        ),
        (
            "value = 2,",
            "value = 2.5,",
            ["motor.pole_pairs", "2.5", "whole number"],
        ),
        ("voltage_v", "volts", ["supply.voltage_v", "nothing", "above 0"]),
        (
            "[numerics]",
            "[numerics]\nextra = 1",
            ["numerics.extra", "unknown key", "step_s"],
        ),
        (
            "value = 0.7",
            "value = 1.7",
            ["friction.dynamic_ratio", "1.7", "0 to 1"],
        ),
        ("value = 1e-6", "value = 1e-3", ["numerics.step_s", "0.001", "L/R"]),
        ("[supply]", "[supply", ["line", "TOML", "actuator.toml"]),
    ] {
        assert!(toml.contains(from), "{from}");
        std::fs::write(&file, toml.replacen(from, to, 1)).unwrap();
        let mut all = words.to_vec();
        all.push("actuator.toml");
        refused(&["run", "--actuator", text(&file), "--out", text(&out)], &all);
    }
    let seq = dir.path().join("s.toml");
    std::fs::write(
        &seq,
        "name = \"s\"\n[[segment]]\ncommand = \"sine\"\namplitude_rad = 1e-3\nfrequency_hz = -5\nduration_s = 1\n",
    )
    .unwrap();
    refused(
        &["run", "--sequence", text(&seq), "--out", text(&out)],
        &["s.toml", "segment[0].frequency_hz", "-5"],
    );
    let grid = dir.path().join("g.toml");
    std::fs::write(&grid, "name = \"g\"\nfsj = [1, 2]\nzeta = [0.0, 1.0]\n").unwrap();
    refused(
        &["simulate", "--grid", text(&grid), "--out", text(dir.path())],
        &["g.toml", "zeta[1]", "zeta < 1"],
    );
    std::fs::write(&grid, "name = \"g\"\nfsj = [2, 1]\nzeta = [0.0, 0.1]\n").unwrap();
    refused(
        &["simulate", "--grid", text(&grid), "--out", text(dir.path())],
        &["g.toml", "fsj[1]", "strictly rising"],
    );
    refused(
        &["run", "--sequence", "nope", "--out", text(&out)],
        &["sequences", "nope", "preflight"],
    );
    refused(&["run", "--rate", "2e6", "--out", text(&out)], &["rate", "2000000"]);
    assert!(!out.exists());
}

/// Files that once were read as values, brought the program down, or never ended.
#[test]
fn refuse_damaged_files_in_one_line() {
    let Some(damaged) = ema_tests::folder_in("EMA_REFERENCE_DIR", "damaged") else {
        return;
    };
    let dir = tempfile::tempdir().unwrap();
    let refused = |args: &[&str], wanted: &[&str]| {
        let o = run(args);
        let said = String::from_utf8_lossy(&o.stderr).into_owned();
        assert!(!matches!(o.status.code(), None | Some(0 | 101)), "{args:?}: {o:?}");
        assert_eq!(said.lines().count(), 1, "{args:?}: {said}");
        assert!(
            said.starts_with("ema: ") && wanted.iter().all(|w| said.contains(w)),
            "{args:?}: {said}"
        );
    };
    let of = |name: &str| damaged.join(name).display().to_string();
    refused(
        &["diagnose", &of("null-30-ia.parquet")],
        &["row ", "column `i_a`", "null"],
    );
    refused(
        &["diagnose", &of("null-100-omega.parquet")],
        &["row ", "column `omega_m`", "null"],
    );
    for file in ["panic-byte-range.parquet", "panic-byte-stream-split.parquet"] {
        refused(&["diagnose", &of(file)], &[file]);
        refused(&["discrepancy", "--bench", &of(file)], &[file]);
    }
    let out = dir.path().join("run.csv");
    for file in ["step-1e-12.toml", "step-1e-308.toml"] {
        let actuator = of(file);
        refused(
            &["run", "--actuator", &actuator, "--out", text(&out)],
            &["step_s", "1e-8"],
        );
        assert!(!out.exists());
    }
}

#[test]
fn e2e_one_bad_sample_is_named_and_what_it_enters_is_left_out() {
    let Some(file) = ema_tests::folder_in("EMA_REFERENCE_DIR", "damaged/one-sample-spike.csv") else {
        return;
    };
    let d = json(&["diagnose", text(&file), "--grid", "standard", "--json"]);
    assert_eq!(d["outcome"], "incomplete", "{d}");
    let reason = d["reason"].as_str().unwrap();
    assert!(
        reason.contains("the phase currents sum to") && reason.contains("sample "),
        "{reason}"
    );
    // what is left still holds the truth
    for (key, truth) in [("fsj", 3.0), ("zeta", 0.3)] {
        let (lo, hi) = (d[key]["lo"].as_f64().unwrap(), d[key]["hi"].as_f64().unwrap());
        assert!(lo <= truth && truth <= hi, "{d}");
    }
}
