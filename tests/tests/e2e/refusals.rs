//! `ema` as a process: what it refuses, in one line.

use crate::common::process::*;

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
    let d = diagnosed(&["diagnose", text(&p), "--json", "--grid", "standard"]);
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
