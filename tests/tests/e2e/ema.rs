//! `ema` as a process: datasets that survive kills, diagnoses, queries.

use crate::common::process::*;
use ema_tests::programs;
use serde_json::Value;
use std::collections::BTreeMap;
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::Duration;

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
        diagnosed(&[&["diagnose"], args, &maps].concat())
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
        let d = diagnosed(&["diagnose", text(&dir.join(name)), "--json"]);
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
    let d = diagnosed(&["diagnose", text(&p), "--json"]);
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
    let d = diagnosed(&["diagnose", text(&c), "--json", "--grid", "standard"]);
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
    let d = diagnosed(&["diagnose", text(&narrow), "--json", "--grid", "standard"]);
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
    let d = diagnosed(&["diagnose", text(&far), "--json"]);
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
    let d = diagnosed(&["diagnose", text(&alien), "--json"]);
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
fn e2e_one_bad_sample_is_named_and_what_it_enters_is_left_out() {
    let Some(file) = ema_tests::folder_in("EMA_REFERENCE_DIR", "damaged/one-sample-spike.csv") else {
        return;
    };
    let d = diagnosed(&["diagnose", text(&file), "--grid", "standard", "--json"]);
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
