//! `preflight2` from end to end: simulated, diagnosed from files and streams, with the supply recorded and without, in a
//! spread where units differ.

use crate::common::*;
use ema_tests::stream::TestDomain;
use serde_json::Value;
use std::path::Path;

const FINER: [&str; 4] = ["slow_break_away_a", "slow_kinetic_a", "slow_lag_s", "leg_current_a"];

fn run(domain: &TestDomain, dir: &Path, name: &str, more: &[&str]) -> String {
    let path = dir.join(name).display().to_string();
    let of = [
        "run",
        "--sequence",
        "preflight2",
        "--fsj",
        "3",
        "--zeta",
        "0.3",
        "--seed",
        "4",
    ];
    let kept = ["--sensors", "reference", "--rate", "10000", "--out", &path];
    ok(domain, &[&of[..], more, &kept[..]].concat());
    path
}

fn diagnosed(domain: &TestDomain, file: &str, more: &[&str]) -> Value {
    let args = [&["diagnose", file, "--grid", "coarse", "--json"][..], more].concat();
    serde_json::from_str(&ok(domain, &args)).unwrap()
}

fn holds(v: &Value, truth: f64) {
    let (lo, hi) = (v["lo"].as_f64().unwrap(), v["hi"].as_f64().unwrap());
    let middle = v["estimate"].as_f64().unwrap();
    assert!(lo < hi && lo <= middle && middle <= hi, "{v}");
    // some widths to either side: that intervals hold as often as they say is measured elsewhere
    assert!((middle - truth).abs() < 2.0 * (hi - lo), "{v}: {truth}");
}

#[test]
fn e2e_preflight2_is_diagnosed_by_what_it_has_more() {
    let (domain, dir) = (TestDomain::default(), tempfile::tempdir().unwrap());
    let plain = run(&domain, dir.path(), "plain.parquet", &[]);
    let supplied = run(&domain, dir.path(), "supplied.parquet", &["--channels", "v_dc"]);
    let text = ok(
        &domain,
        &["diagnose", &supplied, "--grid", "coarse", "--spread", "field"],
    );
    assert!(
        text.contains("kinetic ") && text.contains("supply ") && text.contains("slow_lag"),
        "{text}"
    );
    // one known actuator
    let exact = diagnosed(&domain, &plain, &[]);
    assert_eq!(exact["outcome"], "located", "{exact}");
    holds(&exact["fsj"], 3.0);
    assert!(FINER.iter().all(|f| exact["features"][f].is_f64()), "{exact}");
    assert!(exact.get("kinetic_factor").is_none() && exact["features"].get("supply_v").is_none());
    // units differ: the kinetic factor is known better, and the supply makes it better still
    let [without, with] = [&plain, &supplied].map(|f| diagnosed(&domain, f, &["--spread", "field"]));
    let width = |v: &Value| v["hi"].as_f64().unwrap() - v["lo"].as_f64().unwrap();
    for d in [&without, &with] {
        assert_eq!(d["outcome"], "located", "{d}");
        holds(&d["fsj"], 3.0);
        holds(&d["zeta"], 0.3);
        holds(&d["kinetic_factor"], 3.0);
        assert!(width(&d["kinetic_factor"]) < width(&d["fsj"]), "{d}");
    }
    assert!(
        (with["features"]["supply_v"].as_f64().unwrap() - 48.0).abs() < 1e-3,
        "{with}"
    );
    assert!(
        width(&with["kinetic_factor"]) < 0.5 * width(&without["kinetic_factor"]),
        "{with} {without}"
    );
    assert!(width(&with["fsj"]) < width(&without["fsj"]), "{with} {without}");
    // a supply that no spread has
    let (named, file) = (["--known", "supply_voltage_v=47.5"], plain.as_str());
    let known = diagnosed(&domain, file, &[&["--spread", "field"][..], &named].concat());
    assert!(
        width(&known["kinetic_factor"]) < width(&without["kinetic_factor"]),
        "{known}"
    );
}

#[test]
fn e2e_preflight2_live_and_replayed_gives_the_bits_of_the_file() {
    let (domain, dir) = (TestDomain::default(), tempfile::tempdir().unwrap());
    let file = run(&domain, dir.path(), "test.parquet", &["--channels", "v_dc"]);
    let offline: Value = serde_json::from_str(&ok(&domain, &["diagnose", &file, "--json"])).unwrap();
    assert_eq!(offline["outcome"], "located", "{offline}");
    let mut live = live(&domain, &["--exit-after", "1"]);
    ok(&domain, &["replay", &file, "--speed", "max", "--frame-ms", "7"]);
    assert_eq!(live.code(), Some(0), "{}", live.errors());
    let finals = finals(&live);
    assert_eq!(finals.len(), 1);
    same(&offline, &finals[0]);
}
