//! The doors that take files, with good inputs to change.

use super::changed;
use crate::second::{self, Class};
use diagnoser::calibration::Calibration;
use diagnoser::diagnosis::Outcome;
use diagnoser::failure_map::FailureMapSet;
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
use sim_worker::spread::Spread;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::Arc;

/// How an input was taken that was not refused.
pub enum Taken {
    Right,
    /// what is wrong with what came of it
    Wrong(String),
}

type Open = Box<dyn Fn(&Path) -> Result<Taken, String> + Sync + Send>;

/// A way into the program.
pub struct Door {
    pub name: &'static str,
    /// how often it is tried, against the others
    pub weight: u64,
    /// folders or files that are good
    seeds: Vec<PathBuf>,
    pub open: Open,
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

fn line<T>(result: Result<T, impl std::fmt::Display>) -> Result<Taken, String> {
    result.map(|_| Taken::Right).map_err(|e| format!("{e:#}"))
}

fn text_of(path: &Path) -> Result<String, String> {
    std::fs::read_to_string(path).map_err(|e| e.to_string())
}

/// Located a full width beside the truth.
fn silent(diagnosis: &diagnoser::diagnosis::Diagnosis, truth: (f64, f64)) -> Option<String> {
    let Outcome::Located(area) = &diagnosis.outcome else {
        return None;
    };
    let beside = |i: schemas::fault::Interval, x: f64| {
        let width = i.hi - i.lo;
        x < i.lo - width || x > i.hi + width
    };
    let wrong = beside(area.fsj, truth.0) || beside(area.zeta, truth.1);
    wrong.then(|| format!("located FSJ {:?}, zeta {:?} for {truth:?}", area.fsj, area.zeta))
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
            Ok(c) => Ok(silent(&c.diagnosis, (3.0, 0.3)).map_or(Taken::Right, Taken::Wrong)),
        })
    };
    let door = |name, weight, seeds: Vec<PathBuf>, open: Open| Door {
        name,
        weight,
        seeds,
        open,
    };
    let fingerprint = FailureMapSet::load(&maps.join("maps.parquet")).unwrap().fingerprint();
    vec![
        door("recording.csv", 40, vec![csv], diagnosed(settings())),
        door("recording.parquet", 40, vec![parquet], diagnosed(settings())),
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
            Box::new(|p| line(FailureMapSet::load(p))),
        ),
        door(
            "calibration.json",
            20,
            calibrations(&maps, dir),
            Box::new(move |p| line(Calibration::load(p, &fingerprint))),
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
        runs: 3,
        surface_runs: 0,
        seed: 1,
        maps: set.fingerprint(),
        commit: String::new(),
        scores: [reach.clone(), reach.clone(), reach.clone(), reach],
        misfits: gate.clone(),
        deviations: gate,
        surfaces: None,
    };
    let path = dir.join("calibration").join("calibration-none.json");
    std::fs::create_dir_all(dir.join("calibration")).unwrap();
    calibration.save(&path).unwrap();
    vec![path]
}
