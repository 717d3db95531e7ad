//! `ema check`, maps that are flat, and `ema diagnose --method paper`, as processes.

use crate::common::process::*;

const REFERENCE: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../datasets/parameters/reference.toml");

#[test]
fn e2e_an_actuator_that_a_test_cannot_diagnose_is_told_so() {
    let good = json(&["check", REFERENCE, "--json"]);
    assert_eq!(
        (&good["ok"], &good["actuator"]),
        (&true.into(), &"reference".into()),
        "{good}"
    );
    let names: Vec<&str> = good["checks"]
        .as_array()
        .unwrap()
        .iter()
        .map(|c| c["check"].as_str().unwrap())
        .collect();
    for name in [
        "moves",
        "follows",
        "saturates",
        "regime",
        "stops",
        "map p1",
        "map p2",
        "map p3",
    ] {
        assert!(names.contains(&name), "{names:?}");
    }
    let step = good["step"]["height_rad"].as_f64().unwrap();
    assert!((0.7..1.0).contains(&step), "{step}");

    // on its end stop from the start; a step that ends within P1's window
    let dir = tempfile::tempdir().unwrap();
    let text_of = std::fs::read_to_string(REFERENCE).unwrap();
    let stuck = dir.path().join("stuck.toml");
    std::fs::write(
        &stuck,
        text_of.replace("end_stop_rad = { value = 1.2", "end_stop_rad = { value = 1e-6"),
    )
    .unwrap();
    let small = dir.path().join("small.toml");
    let preflight = include_str!("../../../datasets/sequences/preflight.toml");
    std::fs::write(&small, preflight.replace("height_rad = 1.0", "height_rad = 0.2")).unwrap();
    let checked = |args: &[&str]| {
        let o = run(&[&["check"], args, &["--json"]].concat());
        assert_eq!(o.status.code(), Some(3), "{}", String::from_utf8_lossy(&o.stderr));
        let v: serde_json::Value = serde_json::from_slice(&o.stdout).unwrap();
        let bad = v["checks"]
            .as_array()
            .unwrap()
            .iter()
            .filter(|c| c["ok"] == false)
            .cloned()
            .collect::<Vec<_>>();
        assert_eq!(v["ok"], false);
        assert!(
            bad.iter().all(|c| c["advice"].as_str().is_some_and(|a| !a.is_empty())),
            "{bad:?}"
        );
        bad
    };
    let has = |bad: &[serde_json::Value], name: &str| bad.iter().any(|c| c["check"] == name);
    let bad = checked(&[text(&stuck)]);
    assert!(
        has(&bad, "moves") && has(&bad, "stops") && has(&bad, "map p1") && !has(&bad, "map p3"),
        "{bad:?}"
    );
    let bad = checked(&[REFERENCE, "--sequence", text(&small)]);
    assert!(
        has(&bad, "regime") && !has(&bad, "moves") && !has(&bad, "stops"),
        "{bad:?}"
    );
    let regime = bad.iter().find(|c| c["check"] == "regime").unwrap();
    assert!(
        regime["advice"].as_str().unwrap().contains("a step of at least 0.8"),
        "{regime}"
    );

    // maps of the stuck one are refused, and a diagnosis by what is left of them locates nothing
    let data = dir.path().join("data");
    let grid = ["--grid", "coarse", "--sensors", "reference", "--keep", "features"];
    ok(&[
        &["simulate", "--actuator", text(&stuck), "--out", text(&data)],
        &grid[..],
    ]
    .concat());
    refused(
        &["maps", text(&data)],
        &["range of p", "a feature that changes with the faults"],
    );
    let file = dir.path().join("stuck.csv");
    ok(&[
        "run",
        "--actuator",
        text(&stuck),
        "--sensors",
        "reference",
        "--rate",
        "1000",
        "--out",
        text(&file),
    ]);
    let o = run(&[
        "diagnose",
        text(&file),
        "--actuator",
        text(&stuck),
        "--grid",
        "coarse",
        "--json",
    ]);
    assert!(!String::from_utf8_lossy(&o.stdout).contains("\"located\""), "{o:?}");
    refused(&["check", "none.toml"], &["none.toml"]);
}

#[test]
fn e2e_the_papers_method_reads_the_case_off_a_curve() {
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("run.csv");
    ok(&[
        "run",
        "--fsj",
        "2",
        "--zeta",
        "0.3",
        "--sensors",
        "reference",
        "--out",
        text(&file),
    ]);
    let d = json(&["diagnose", text(&file), "--method", "paper", "--json"]);
    assert_eq!(
        (&d["outcome"], &d["method"], &d["calibrated"]),
        (&"located".into(), &"paper".into(), &false.into())
    );
    assert!(d["coverage"].is_null() && d["misfit"].is_null());
    assert_eq!(d["zeta"]["estimate"], 0.3);
    let fsj = d["fsj"]["estimate"].as_f64().unwrap();
    assert!((fsj - 2.0).abs() < 0.02, "{fsj}");
    let told = ok(&["diagnose", text(&file), "--method", "paper"]);
    assert!(told.contains("coverage  none"), "{told}");
}
