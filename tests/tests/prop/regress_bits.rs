//! The same bits as version 0.1: maps, features and diagnoses of fixed inputs, against what that program made of
//! them (`fixtures/bits_0.1.json`: hashes of all values, and whole diagnoses). The fleet's diagnoses are those of the
//! version with the later witnesses: they and what tells them decide which tests are unexplained.

use crate::common::process::{json, ok, text};
use diagnoser::failure_map::{FailureMap, FailureMapSet};
use ema_tests::folder;
use schemas::feature::{Feature, Raw};
use serde_json::Value;
use sim_worker::dataset::storage::Storage;
use sim_worker::dataset::tables::Table;
use std::path::Path;

/// Raw features that version 0.1 did not have.
const NEW: usize = 13;

fn fixture() -> Value {
    let file = concat!(env!("CARGO_MANIFEST_DIR"), "/fixtures/bits_0.1.json");
    serde_json::from_str(&std::fs::read_to_string(file).unwrap()).unwrap()
}

/// FNV-1a of the bytes of all values, as the fixture has it.
fn hash(values: impl IntoIterator<Item = f64>) -> String {
    let bytes = values.into_iter().flat_map(f64::to_le_bytes);
    let fold = |h: u64, b: u8| (h ^ u64::from(b)).wrapping_mul(0x0100_0000_01b3);
    format!("{:016x}", bytes.fold(0xcbf2_9ce4_8422_2325, fold))
}

fn same(what: &str, found: String, wanted: &Value) {
    assert_eq!(Some(found.as_str()), wanted.as_str(), "{what}");
}

/// Hashes of columns of a dataset's tables, against those of the fixture below `key`.
fn tables(dir: &Path, files: &[&str], wanted: &Value) {
    let storage = Storage::open(text(dir)).unwrap();
    for file in files {
        let table = Table::read(file, storage.get(file).unwrap().unwrap()).unwrap();
        // rows of features that later versions added
        let is_later = |name: &String| Feature::WATCHES.iter().any(|f| f.name() == name);
        let later: Vec<bool> = match table.texts("feature") {
            Ok(names) => names.iter().map(is_later).collect(),
            Err(_) => vec![false; table.rows()],
        };
        for (column, wanted) in wanted[file].as_object().unwrap() {
            let values = table.values(column).unwrap().into_iter().zip(&later);
            let old = values.filter(|(_, later)| !**later).map(|(x, _)| x.unwrap_or(f64::NAN));
            same(&format!("{file}: {column}"), hash(old), wanted);
        }
    }
}

#[test]
fn regress_features_and_maps_of_one_actuator() {
    let (dir, fixture) = (tempfile::tempdir().unwrap(), fixture());
    let data = dir.path().join("d");
    let grid = ["--grid", "standard", "--rate", "1000", "--keep", "features"];
    ok(&[&["simulate", "--sensors", "reference", "--out", text(&data)], &grid[..]].concat());
    ok(&["maps", text(&data), "--lenient"]);
    tables(&data, &["features/part-0000.parquet"], &fixture["one"]);
    assert_eq!(
        fixture["one"]["features/part-0000.parquet"].as_object().unwrap().len(),
        3 + 2 * (Raw::ALL.len() - NEW)
    );
    let set = FailureMapSet::load(&data.join("maps.parquet")).unwrap();
    let old = |m: &&FailureMap| {
        let later = Feature::OF_UNITS.into_iter().chain(Feature::WATCHES);
        later.into_iter().all(|f| f != m.feature)
    };
    let maps: Vec<_> = set.maps.iter().chain(&set.witnesses).filter(old).collect();
    let wanted = fixture["maps"].as_object().unwrap();
    assert_eq!(maps.len(), wanted.len());
    for m in maps {
        let name = m.feature.name();
        same(name, hash(m.raw.iter().copied()), &wanted[name]["raw_value"]);
        same(name, hash(m.value.iter().copied()), &wanted[name]["value"]);
    }
}

/// Of a recording, without the version of its keys and what later versions add: the recorded bits are older.
fn diagnosis(file: &Path) -> Value {
    let mut d = json(&["diagnose", text(file), "--json"]);
    assert_eq!(d.as_object_mut().unwrap().remove("schema_version"), Some(1.into()));
    d.as_object_mut().unwrap().remove("reads_as_fsj");
    let features = d["features"].as_object_mut().unwrap();
    Feature::WATCHES
        .iter()
        .for_each(|f| assert!(features.remove(f.key()).is_some()));
    d
}

#[test]
fn regress_diagnoses_of_random_recordings() {
    let dir = tempfile::tempdir().unwrap();
    let fixture = fixture();
    for d in fixture["diagnoses"].as_array().unwrap() {
        let option = |key: &str| d[key].to_string();
        let file = dir.path().join(format!("r.{}", d["form"].as_str().unwrap()));
        let (fsj, zeta, seed) = (option("fsj"), option("zeta"), option("seed"));
        let faults = ["run", "--fsj", &fsj, "--zeta", &zeta, "--seed", &seed];
        ok(&[&faults[..], &["--sensors", "reference", "--out", text(&file)]].concat());
        assert_eq!(diagnosis(&file), d["diagnosis"], "{faults:?}");
    }
}

#[test]
fn regress_diagnoses_of_the_independent_recordings() {
    let Some(dir) = folder("EMA_REFERENCE_DIR") else { return };
    for (name, wanted) in fixture()["references"].as_object().unwrap() {
        assert_eq!(diagnosis(&dir.join(name)), *wanted, "{name}");
    }
}

#[test]
fn regress_features_maps_and_diagnoses_of_a_fleet() {
    let dir = tempfile::tempdir().unwrap();
    let data = dir.path().join("fleet");
    let plan = concat!(env!("CARGO_MANIFEST_DIR"), "/../datasets/fleets/demo.toml");
    ok(&["dataset", "make", plan, "--out", text(&data)]);
    ok(&["dataset", "maps", text(&data)]);
    ok(&["dataset", "diagnose", text(&data)]);
    let files = [
        "features/part-0000.parquet",
        "maps/part-0000.parquet",
        "diagnoses/part-own.parquet",
    ];
    tables(&data, &files, &fixture()["fleet"]);
}
