//! The doors, with good inputs to change.

use super::bridge::Bridge;
use super::truth::{Taken, as_written, line, silent};
use super::{changed, frames};
use crate::second::{self, Class};
use diagnoser::calibration::Calibration;
use diagnoser::failure_map::FailureMapSet;
use diagnoser::live::Known;
use diagnoser::unit::{KindEntry, TestEntry, UnitFile};
use ema_study::measured::bench::Bench;
use ema_study::measured::{check, recording};
use pipeline::case::{self, Settings};
use pipeline::discrepancy::{Request, study_file};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use schemas::sequence::TestSequence;
use schemas::toml_section;
use sim_worker::dataset::plan::DatasetPlan;
use sim_worker::parameters::ActuatorParameters;
use sim_worker::sensor::SensorModel;
use sim_worker::setup::TestSetup;
use sim_worker::spread::Spread;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::Arc;

type Open = Box<dyn Fn(&Path) -> Result<Taken, String> + Sync + Send>;

/// A way into the program.
pub struct Door {
    pub name: &'static str,
    /// how often it is tried, against the others
    pub weight: u64,
    /// files that are good, or once did what none may
    seeds: Vec<PathBuf>,
    pub open: Open,
}

/// Files that once did what none may (`tests/corpus`), of a door.
pub fn corpus(door: &str) -> Vec<PathBuf> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("corpus").join(door);
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
    let mut files: Vec<PathBuf> = entries.map(|e| e.path()).collect();
    files.sort();
    files
}

impl Door {
    /// A changed input in a room of its own: one file of a seed is changed, what lies beside it is there too.
    pub fn input(&self, rng: &mut ChaCha8Rng, room: &Path) -> PathBuf {
        let seed = &self.seeds[rng.random_range(0..self.seeds.len())];
        let folder = seed.parent().expect("files");
        let room = room.join(folder.file_name().unwrap_or_default());
        if !room.exists() {
            std::fs::create_dir_all(&room).unwrap();
        }
        let mut beside: Vec<PathBuf> = std::fs::read_dir(folder).unwrap().flatten().map(|e| e.path()).collect();
        beside.retain(|p| p.is_file());
        beside.sort();
        // mostly the file itself; of a bench its tables too
        let related = |p: &&PathBuf| {
            *p == seed || seed.extension().is_some_and(|e| e == "toml") && p.extension().is_some_and(|e| e == "csv")
        };
        let candidates: Vec<&PathBuf> = beside.iter().filter(related).collect();
        let chosen = candidates[rng.random_range(0..candidates.len())];
        for p in &candidates {
            let to = room.join(p.file_name().expect("a file"));
            let bytes = std::fs::read(p).unwrap();
            let bytes = if *p == chosen { changed(rng, &bytes) } else { bytes };
            std::fs::write(to, bytes).unwrap();
        }
        room.join(seed.file_name().expect("a file"))
    }
}

fn text_of(path: &Path) -> Result<String, String> {
    std::fs::read_to_string(path).map_err(|e| e.to_string())
}

/// All doors.
///
/// * `ema` the program, which makes the good inputs
/// * `dir` where they are put
pub fn doors(ema: &Path, dir: &Path) -> Vec<Door> {
    let run = |args: &[&str]| {
        let o = Command::new(ema).args(args).output().unwrap();
        assert!(o.status.success(), "{args:?}: {}", String::from_utf8_lossy(&o.stderr));
        String::from_utf8_lossy(&o.stdout).into_owned()
    };
    let file = |folder: &str, name: &str| {
        std::fs::create_dir_all(dir.join(folder)).unwrap();
        dir.join(folder).join(name)
    };
    let written = |folder: &str, name: &str, text: &str| {
        let path = file(folder, name);
        std::fs::write(&path, text).unwrap();
        path
    };
    let (csv, parquet) = (file("recording", "run.csv"), file("recording-parquet", "run.parquet"));
    for out in [&csv, &parquet] {
        let out = out.to_str().expect("plain names");
        run(&[
            "run",
            "--fsj",
            "3",
            "--zeta",
            "0.3",
            "--sensors",
            "reference",
            "--seed",
            "9",
            "--rate",
            "1000",
            "--out",
            out,
        ]);
    }
    let maps = dir.join("maps");
    let dataset = dir.join("dataset");
    let place = dataset.to_str().expect("plain");
    run(&[
        "simulate",
        "--grid",
        "standard",
        "--rate",
        "1000",
        "--sensors",
        "reference",
        "--keep",
        "features",
        "--out",
        place,
    ]);
    run(&["maps", place, "--out", maps.to_str().expect("plain")]);
    let actuator = ActuatorParameters::reference();
    let sequence = sim_worker::catalogue::sequence("preflight").unwrap();
    let sensors = sim_worker::catalogue::sensors("reference").unwrap().expect("a model");
    let shown = include_str!("../../../datasets/fleets/demo.toml");
    let spread = include_str!("../../../datasets/spreads/fleet.toml");
    let bench = dir.join("bench");
    second::make(&bench, &Class::Nothing, 1.0, 41).unwrap();
    let rigs: Vec<PathBuf> = std::fs::read_dir(&bench)
        .unwrap()
        .flatten()
        .map(|e| e.path())
        .filter(|p| p.extension().is_some_and(|x| x == "toml") && p.file_name().is_some_and(|n| n != "key.toml"))
        .collect();
    let settings = || {
        let mut s = Settings::of_actuator(Arc::new(ActuatorParameters::reference())).unwrap();
        // no other: maps of a changed rate are not to be made
        s.maps = Some(maps.clone());
        s
    };
    let diagnosed = |s: Settings| -> Open {
        Box::new(move |path| match case::run(path, &s) {
            Err(e) => Err(format!("{e:#}")),
            Ok(c) => Ok(silent(&c.diagnosis).map_or(Taken::Right, Taken::Wrong)),
        })
    };
    let door = |name: &'static str, weight, good: Vec<PathBuf>, open: Open| Door {
        name,
        weight,
        seeds: [good, corpus(name)].concat(),
        open,
    };
    let set = FailureMapSet::load(&maps.join("maps.parquet")).unwrap();
    let fingerprint = set.fingerprint();
    let calibrations = calibrations(&maps, dir);
    let calibration = Calibration::load(&calibrations[0], &fingerprint).unwrap();
    let unit = unit(&actuator);
    let units = file("unit", "unit.json");
    unit.save(&units).unwrap();
    let known = Known {
        actuators: vec![Arc::new(actuator.clone())],
        sequences: vec![sequence.clone()],
        sensors: vec![(sensors.fingerprint(), sensors.sampling)],
        units: Default::default(),
    };
    let flying = Arc::new(case::run(&csv, &settings()).unwrap().diagnoser);
    let framed = file("frames", "run.frames");
    std::fs::write(&framed, frames::of(&parquet)).unwrap();
    let bridge = Bridge::start(ema, &maps);
    let sent = file("bridge", "run.sent");
    std::fs::write(&sent, bridge.recorded(ema, &parquet)).unwrap();
    vec![
        door("recording.csv", 40, vec![csv], diagnosed(settings())),
        door("recording.parquet", 40, vec![parquet], diagnosed(settings())),
        door(
            "frames",
            60,
            vec![framed],
            Box::new(move |p| frames::diagnose(p, &known, &flying)),
        ),
        door("bridge", 15, vec![sent], Box::new(move |p| bridge.send(p))),
        door(
            "unit.json",
            60,
            vec![units],
            Box::new(move |p| as_written(UnitFile::load(p), &unit)),
        ),
        door(
            "actuator.toml",
            200,
            vec![written("actuator", "actuator.toml", &actuator.to_toml())],
            Box::new(|p| {
                line(text_of(p).and_then(|t| ActuatorParameters::parse("actuator.toml", &t).map_err(|e| e.to_string())))
            }),
        ),
        door(
            "sequence.toml",
            150,
            vec![written("sequence", "sequence.toml", &sequence.to_toml())],
            Box::new(|p| line(toml_section::read(p).and_then(TestSequence::from_section))),
        ),
        door(
            "sensors.toml",
            150,
            vec![written("sensors", "sensors.toml", &sensors.to_toml())],
            Box::new(|p| line(toml_section::read(p).and_then(SensorModel::from_section))),
        ),
        door(
            "spread.toml",
            150,
            vec![written("spread", "spread.toml", spread)],
            Box::new(|p| line(toml_section::read(p).and_then(Spread::from_section))),
        ),
        door(
            "plan.toml",
            150,
            vec![written("plan", "plan.toml", shown)],
            Box::new(|p| line(DatasetPlan::read(p))),
        ),
        door(
            "maps.parquet",
            60,
            vec![maps.join("maps.parquet")],
            Box::new(move |p| as_written(FailureMapSet::load(p), &set)),
        ),
        door(
            "calibration.json",
            20,
            calibrations,
            Box::new(move |p| as_written(Calibration::load(p, &fingerprint), &calibration)),
        ),
        door(
            "bench",
            40,
            rigs.clone(),
            Box::new(|p| {
                let checked = || -> anyhow::Result<()> {
                    let bench = Bench::read(p, None)?;
                    let runs = recording::read_runs(&bench)?;
                    check::check(&bench, &runs)?;
                    Ok(())
                };
                line(checked())
            }),
        ),
        door(
            "study",
            1,
            rigs,
            Box::new(|p| {
                let request = Request {
                    bench: vec![p.to_path_buf()],
                    ..Request::default()
                };
                line(study_file(&request, &|_| ()))
            }),
        ),
    ]
}

/// A calibration as `ema calibrate` writes it, with as few tests as it allows.
fn calibrations(maps: &Path, dir: &Path) -> Vec<PathBuf> {
    let set = FailureMapSet::load(&maps.join("maps.parquet")).unwrap();
    let (gate, reach) = (vec![1.0, 2.0, 3.0], vec![0.5, 1.0, 2.5]);
    let calibration = Calibration {
        spread: "none".into(),
        half_width: Spread::none().half_width,
        friction_per_k: 0.0,
        runs: 3,
        surface_runs: 0,
        seed: 1,
        maps: set.fingerprint(),
        commit: String::new(),
        scores: [reach.clone(), reach.clone(), reach.clone(), reach],
        misfits: gate.clone(),
        deviations: gate,
        strips: Vec::new(),
        kinetic: Vec::new(),
        surfaces: None,
    };
    let path = dir.join("calibration").join("calibration-none.json");
    std::fs::create_dir_all(dir.join("calibration")).unwrap();
    calibration.save(&path).unwrap();
    vec![path]
}

/// A unit that was shown a healthy and a worn test.
fn unit(actuator: &ActuatorParameters) -> UnitFile {
    let spread = sim_worker::catalogue::spread("unit").unwrap();
    let mut unit = UnitFile::new("tail 7".into(), "reference".into(), actuator.clone(), spread);
    let sequence = sim_worker::catalogue::sequence("preflight").unwrap();
    let setup = TestSetup::new(Arc::new(unit.actuator.clone()), sequence, 1000.0);
    unit.kinds.push(KindEntry::of(&setup));
    for (healthy, outcome) in [(true, "baseline"), (false, "located")] {
        unit.tests.push(TestEntry {
            file: format!("{outcome}.csv"),
            checksum: "00".into(),
            healthy,
            outcome: outcome.into(),
            reason: String::new(),
            kind: unit.kinds[0].kind.clone(),
            fsj: (!healthy).then_some((2.9, 3.0, 3.1)),
            zeta: (!healthy).then_some((0.29, 0.3, 0.31)),
            features: vec![("p2".into(), 0.125), ("p3".into(), 0.0625)],
            commit: String::new(),
            repairs: 0,
        });
    }
    unit.constants.mean[0] = 0.0123;
    unit
}
