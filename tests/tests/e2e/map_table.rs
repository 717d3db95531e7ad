//! Maps from the runs of any simulator: a table of faults with recordings or features. Our own test bench stands for the other
//! simulator here (its family: the figures are of the path, not of a rig).
use crate::common::process::{json, ok, refused, text};
use arrow::array::AsArray;
use arrow::datatypes::Float64Type;
use rayon::prelude::*;
use std::fmt::Write;
use std::path::Path;

const FSJ: [f64; 5] = [1.0, 2.0, 3.0, 4.0, 5.0];
const ZETA: [f64; 5] = [0.0, 0.125, 0.25, 0.375, 0.5];

/// Fault pairs off the grid, spread evenly.
fn off_grid(n: usize, from: usize) -> Vec<(f64, f64)> {
    let part = |i: usize, step: f64| (i as f64 * step).fract();
    let pair = |i| (1.0 + 4.0 * part(i, 0.754_877_666), 0.5 * part(i, 0.569_840_291));
    (from..from + n).map(pair).collect()
}

fn recorded(dir: &Path, name: &str, fsj: f64, zeta: f64, seed: usize) -> String {
    let file = dir.join(format!("{name}.parquet"));
    let (fsj, zeta, seed) = (fsj.to_string(), zeta.to_string(), seed.to_string());
    ok(&[
        "run",
        "--fsj",
        &fsj,
        "--zeta",
        &zeta,
        "--seed",
        &seed,
        "--rate",
        "1000",
        "--sensors",
        "reference",
        "--out",
        text(&file),
    ]);
    format!("{name}.parquet")
}

#[test]
fn e2e_recordings_of_another_simulator_become_calibrated_maps() {
    let dir = tempfile::tempdir().unwrap();
    let mut rows: Vec<(f64, f64)> = ZETA.iter().flat_map(|z| FSJ.map(|f| (f, *z))).collect();
    // twice each, with other noise: the scatter is the sensors'
    rows = [rows.clone(), rows, off_grid(60, 1)].concat();
    let files: Vec<String> = (0..rows.len())
        .into_par_iter()
        .map(|i| recorded(dir.path(), &format!("r{i}"), rows[i].0, rows[i].1, i))
        .collect();
    let mut table = "fsj;zeta;file\n".to_string();
    for ((f, z), file) in rows.iter().zip(&files) {
        writeln!(table, "{f};{z};{file}").unwrap();
    }
    let list = dir.path().join("runs.csv");
    std::fs::write(&list, &table).unwrap();
    let maps = dir.path().join("maps");
    let said = ok(&["maps", text(&list), "--out", text(&maps)]);
    assert!(
        said.contains("50 rows on the grid, 60 off it") && said.contains("calibrated on 60"),
        "{said}"
    );

    let tests = off_grid(20, 1000);
    let inside = tests.par_iter().enumerate().filter(|(i, (f, z))| {
        let file = recorded(dir.path(), &format!("t{i}"), *f, *z, 9000 + i);
        let d = json(&[
            "diagnose",
            text(&dir.path().join(file)),
            "--maps",
            text(&maps),
            "--json",
        ]);
        assert_eq!(d["calibrated"], true, "{d}");
        let holds = |fault: &str, x: f64| {
            let end = |key: &str| d[fault][key].as_f64();
            end("lo").is_some_and(|lo| lo <= x) && end("hi").is_some_and(|hi| x <= hi)
        };
        holds("fsj", *f) && holds("zeta", *z)
    });
    // 95 % are promised: fewer than 15 of 20 is one chance in 2500
    let inside = inside.count();
    assert!(inside >= 15, "{inside} of 20");

    // the maps are not our test bench's to calibrate
    refused(
        &["calibrate", text(&maps)],
        &["maps.parquet", "another simulator's table", "ema maps TABLE"],
    );
    // without rows off the grid they are not called calibrated
    let few: String = table.lines().take(51).map(|l| format!("{l}\n")).collect();
    std::fs::write(&list, &few).unwrap();
    let said = ok(&["maps", text(&list), "--out", text(&maps)]);
    assert!(said.contains("not calibrated"), "{said}");
    assert!(!maps.join("calibration-none.json").exists());
    let d = json(&[
        "diagnose",
        text(&dir.path().join("t0.parquet")),
        "--maps",
        text(&maps),
        "--json",
    ]);
    assert_eq!(d["calibrated"], false, "{d}");

    for (from, to, says) in [
        ("3;0.25;", "3.1;0.25;", &["runs.csv", "no row of fsj 3, zeta 0.25"][..]),
        (
            "r7.parquet",
            "nobody.parquet",
            &["nobody.parquet", "cannot be read"][..],
        ),
        ("4;0.125;", "-4;0.125;", &["runs.csv", "column `fsj`", "-4"][..]),
        ("5;0.5;", "5;1.5;", &["runs.csv", "column `zeta`", "1.5"][..]),
        ("fsj;", "friction;", &["runs.csv", "fsj"][..]),
    ] {
        std::fs::write(&list, few.replace(from, to)).unwrap();
        refused(&["maps", text(&list), "--out", text(&maps)], says);
    }
    std::fs::write(&list, "fsj,zeta,file\n1,0,r0.parquet\n5,0.5,r24.parquet\n").unwrap();
    refused(
        &["maps", text(&list), "--out", text(&maps)],
        &["runs.csv", "a full grid of fault pairs"],
    );
}

#[test]
fn e2e_features_of_another_simulator_become_maps_and_are_diagnosed() {
    let dir = tempfile::tempdir().unwrap();
    let grid = dir.path().join("grid");
    let sim = ["simulate", "--rate", "1000", "--sensors", "reference", "--grid"];
    let toml = dir.path().join("grid.toml");
    std::fs::write(
        &toml,
        "name = \"coarse\"\nfsj = [1.0, 2.0, 3.0, 4.0, 5.0]\nzeta = [0.0, 0.125, 0.25, 0.375, 0.5]\n",
    )
    .unwrap();
    ok(&[&sim[..], &[text(&toml), "--out", text(&grid)]].concat());
    ok(&["maps", text(&grid)]);
    // its features as a table of somebody else
    let mut csv = String::new();
    let mut parts: Vec<_> = std::fs::read_dir(grid.join("features"))
        .unwrap()
        .map(|e| e.unwrap().path())
        .collect();
    parts.retain(|p| p.extension().is_some_and(|x| x == "parquet"));
    parts.sort();
    for part in parts {
        let (schema, batches) = schemas::table::read_table(&part).unwrap();
        let wanted: Vec<usize> = (0..schema.fields().len())
            .filter(|&i| *schema.field(i).data_type() == arrow::datatypes::DataType::Float64)
            .collect();
        if csv.is_empty() {
            let names: Vec<&str> = wanted.iter().map(|&i| schema.field(i).name().as_str()).collect();
            writeln!(csv, "{}", names.join(",")).unwrap();
        }
        for b in &batches {
            for row in 0..b.num_rows() {
                let cell = |&i: &usize| b.column(i).as_primitive::<Float64Type>().value(row).to_string();
                writeln!(csv, "{}", wanted.iter().map(cell).collect::<Vec<_>>().join(",")).unwrap();
            }
        }
    }
    let table = dir.path().join("features.csv");
    std::fs::write(&table, &csv).unwrap();
    let maps = dir.path().join("maps");
    let from_table = [
        "maps",
        text(&table),
        "--rate",
        "1000",
        "--sensors",
        "reference",
        "--out",
        text(&maps),
    ];
    let said = ok(&from_table);
    assert!(said.contains("25 rows on the grid, 0 off it"), "{said}");
    // to the bit the maps that our own dataset makes
    let file = dir.path().join("run.csv");
    ok(&[
        "run",
        "--fsj",
        "3.3",
        "--zeta",
        "0.21",
        "--rate",
        "1000",
        "--sensors",
        "reference",
        "--out",
        text(&file),
    ]);
    let diagnosed = |maps: &Path| json(&["diagnose", text(&file), "--maps", text(maps), "--json"]);
    let (theirs, ours) = (diagnosed(&maps), diagnosed(&grid));
    assert_eq!((&theirs["fsj"], &theirs["zeta"]), (&ours["fsj"], &ours["zeta"]));
    // rows of features, one each
    let rows = ok(&["diagnose", text(&table), "--features", "--maps", text(&maps), "--json"]);
    let mut n = 0;
    for line in rows.lines() {
        let d: serde_json::Value = serde_json::from_str(line).unwrap();
        if d["outcome"] == "located" {
            n += 1;
            for f in ["fsj", "zeta"] {
                let at = |key: &str| d[f][key].as_f64().unwrap();
                let truth = d["truth"][f].as_f64().unwrap();
                assert!(at("lo") <= truth && truth <= at("hi"), "{d}");
            }
        }
    }
    assert_eq!(rows.lines().count(), 25);
    assert!(n >= 15, "{n}");
    // a recording is no table of features
    let wrong = ["diagnose", text(&file), "--features", "--maps", text(&maps)];
    refused(&wrong, &["run.csv", "columns", "mean_speed_rad_per_s"]);
}
