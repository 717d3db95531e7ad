//! `ema maps --quality`, `ema calibrate` and what they do to `ema diagnose`, as processes.

use crate::common::process::*;
use serde_json::Value;
use std::path::PathBuf;
use std::process::{Command, Stdio};
use std::sync::OnceLock;
use std::time::Duration;

/// A dataset with maps and both calibrations, and a recording; made once.
fn dataset() -> &'static (PathBuf, PathBuf) {
    static ONCE: OnceLock<(tempfile::TempDir, (PathBuf, PathBuf))> = OnceLock::new();
    &ONCE
        .get_or_init(|| {
            let dir = tempfile::tempdir().unwrap();
            let (data, file) = (dir.path().join("data"), dir.path().join("run.csv"));
            let run = ["run", "--fsj", "3", "--zeta", "0.3", "--sensors", "reference", "--out"];
            ok(&[&run[..], &[text(&file)]].concat());
            let grid = ["--grid", "standard", "--sensors", "reference", "--keep", "features"];
            ok(&[&["simulate", "--out", text(&data)], &grid[..]].concat());
            ok(&["maps", text(&data)]);
            ok(&["calibrate", text(&data), "--runs", "256"]);
            let fleet = ["--spread", "fleet", "--runs", "512", "--surface-runs", "700"];
            let shown = ok(&[&["calibrate", text(&data)], &fleet[..]].concat());
            assert!(
                shown.contains("supply voltage") && shown.contains("one sample"),
                "{shown}"
            );
            (dir, (data, file))
        })
        .1
}

fn width(d: &Value, of: &str) -> f64 {
    d[of]["hi"].as_f64().unwrap() - d[of]["lo"].as_f64().unwrap()
}

#[test]
fn e2e_calibrated_maps_serve_one_unit_and_a_fleet() {
    let (data, file) = dataset();
    let diagnose = |more: &[&str]| {
        let base = ["diagnose", text(file), "--maps", text(data), "--json"];
        json(&[&base[..], more].concat())
    };
    let one = diagnose(&[]);
    let fleet = diagnose(&["--spread", "fleet"]);
    for d in [&one, &fleet] {
        assert_eq!(
            (&d["outcome"], &d["calibrated"]),
            (&"located".into(), &true.into()),
            "{d}"
        );
        let (lo, hi) = (d["area_inner"].as_f64().unwrap(), d["area_outer"].as_f64().unwrap());
        assert!(0.9 * hi < lo && lo <= hi, "{lo} {hi}");
        assert_eq!(d["areas"].as_array().unwrap().len(), 1);
        assert!(d["misfit"]["found"].as_f64().unwrap() < d["misfit"]["allowed"].as_f64().unwrap());
        for (of, truth) in [("fsj", 3.0), ("zeta", 0.3)] {
            let (lo, hi) = (d[of]["lo"].as_f64().unwrap(), d[of]["hi"].as_f64().unwrap());
            assert!(
                lo - 0.5 * (hi - lo) < truth && truth < hi + 0.5 * (hi - lo),
                "{of} {lo} {hi}"
            );
        }
        for key in [
            "speed_loss_rad_per_s",
            "rise_s",
            "current_rms_a",
            "sine_travel_rad",
            "p1_rad_per_s",
        ] {
            assert!(d["features"][key].is_f64(), "{key}");
        }
    }
    assert!(width(&fleet, "fsj") > 2.0 * width(&one, "fsj"));
    let known = diagnose(&[
        "--spread",
        "fleet",
        "--known",
        "supply_voltage_v=48,back_emf_v_s_per_rad=0.0376",
    ]);
    assert!(width(&known, "zeta") < 0.97 * width(&fleet, "zeta"));
    let half = diagnose(&["--coverage", "0.5"]);
    assert!(width(&half, "fsj") < 0.8 * width(&one, "fsj") && half["coverage"] == 0.5);
    // a measured value that differs moves the intervals: 1 % less supply explains part of the speed that is lost
    let low = diagnose(&["--spread", "fleet", "--known", "supply_voltage_v=47.52"]);
    assert_ne!(low["fsj"], known["fsj"]);
    let quality = ok(&["maps", text(data), "--quality", "--spread", "fleet"]);
    for words in [
        "crossing",
        "Can the maps tell FSJ from zeta",
        "What to add next",
        "Most would be gained",
    ] {
        assert!(
            quality.to_lowercase().contains(&words.to_lowercase()),
            "no `{words}` in {quality}"
        );
    }
    let refined = diagnose(&["--refine"]);
    assert!(refined["refined"]["runs"].as_u64().unwrap() >= 64, "{refined}");
    assert!((refined["refined"]["fsj"]["estimate"].as_f64().unwrap() - 3.0).abs() < 0.02);
}

#[test]
fn refuse_calibrations_and_spreads_that_do_not_fit() {
    let (data, file) = dataset();
    let dir = tempfile::tempdir().unwrap();
    let base = ["diagnose", text(file), "--maps", text(data)];
    let with = |more: &[&str], words: &[&str]| refused(&[&base[..], more].concat(), words);
    with(&["--known", "mass=3"], &["--known", "mass=3", "supply_voltage_v"]);
    with(
        &["--known", "supply_voltage_v=much"],
        &["supply_voltage_v=much", "KEY=NUMBER"],
    );
    with(
        &["--known", "supply_voltage_v=47"],
        &["supply_voltage_v", "ema calibrate --spread"],
    );
    with(&["--coverage", "1.5"], &["coverage", "1.5", "below 1"]);
    with(&["--spread", "wide"], &["spread", "wide", "fleet"]);
    let spread = |name: &str, line: &str| {
        let p = dir.path().join(format!("{name}.toml"));
        std::fs::write(&p, format!("name = \"{name}\"\n{line}\n")).unwrap();
        p
    };
    let p = spread("own", "inertia_relative = 0.9");
    with(
        &["--spread", text(&p)],
        &["own.toml", "inertia_relative", "0.9", "0 to 0.5"],
    );
    let p = spread("own", "mass_relative = 0.1");
    with(&["--spread", text(&p)], &["own.toml", "mass_relative"]);
    // of a name for which there is no calibration, and of one with other half-widths
    let p = spread("own", "inertia_relative = 0.1");
    with(&["--spread", text(&p)], &["calibration-own.json", "ema calibrate"]);
    let p = spread("fleet", "inertia_relative = 0.1");
    with(&["--spread", text(&p)], &["half-widths of spread `fleet`"]);
    // a name that is no part of a file's name
    let p = dir.path().join("name.toml");
    std::fs::write(&p, "name = \"../up\"\n").unwrap();
    with(&["--spread", text(&p)], &["name", "../up"]);

    // another grid's maps with this calibration, and a torn one
    let other = dir.path().join("other");
    let grid = ["--grid", "coarse", "--sensors", "reference", "--keep", "features"];
    ok(&[&["simulate", "--out", text(&other)], &grid[..]].concat());
    ok(&["maps", text(&other), "--lenient"]);
    let copy = other.join("calibration-none.json");
    std::fs::copy(data.join("calibration-none.json"), &copy).unwrap();
    let at_other = ["diagnose", text(file), "--maps", text(&other)];
    refused(&at_other, &["calibration-none.json", "fingerprint of the maps"]);
    let bytes = std::fs::read(&copy).unwrap();
    std::fs::write(&copy, &bytes[..bytes.len() / 2]).unwrap();
    refused(&at_other, &["calibration-none.json"]);
    std::fs::remove_file(&copy).unwrap();
    assert!(ok(&at_other).contains("not calibrated"));
    refused(&["calibrate", text(&dir.path().join("none"))], &["none"]);
    let actuator = dir.path().join("a.toml");
    let parameters =
        sim_worker::parameters::ActuatorParameters::reference_text().replace("value = 48.0", "value = 50.0");
    std::fs::write(&actuator, parameters).unwrap();
    refused(
        &["calibrate", text(data), "--actuator", text(&actuator)],
        &["parameter fingerprint", "--actuator"],
    );
}

#[test]
fn e2e_an_interrupted_calibration_leaves_nothing() {
    let (data, _) = dataset();
    let dir = tempfile::tempdir().unwrap();
    std::fs::copy(data.join("maps.parquet"), dir.path().join("maps.parquet")).unwrap();
    let mut child = ema(&["calibrate", text(dir.path()), "--runs", "100000"])
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    std::thread::sleep(Duration::from_millis(1500));
    let pid = child.id().to_string();
    assert!(Command::new("kill").args(["-INT", &pid]).status().unwrap().success());
    assert_eq!(child.wait().unwrap().code(), Some(130));
    let left: Vec<_> = std::fs::read_dir(dir.path())
        .unwrap()
        .flatten()
        .map(|e| e.file_name())
        .collect();
    assert_eq!(left, ["maps.parquet"]);
}

#[test]
fn e2e_a_calibration_is_the_same_every_time() {
    let (data, _) = dataset();
    let calibrated = |seed: &str| {
        let dir = tempfile::tempdir().unwrap();
        std::fs::copy(data.join("maps.parquet"), dir.path().join("maps.parquet")).unwrap();
        ok(&["calibrate", text(dir.path()), "--runs", "64", "--seed", seed]);
        std::fs::read(dir.path().join("calibration-none.json")).unwrap()
    };
    assert_eq!(calibrated("1"), calibrated("1"));
    assert_ne!(calibrated("1"), calibrated("2"));
}
