//! Units with a history: their files, and what is known of them.

mod campaign;
mod history;

pub use campaign::{UnitEffort, calibrate, diagnoser, draw_test, found, made, ready, request};
pub use history::{Kinds, Shown, show};

use anyhow::Result;
use diagnoser::unit::UnitFile;
use schemas::error::Error;
use sim_worker::parameters::ActuatorParameters;
use sim_worker::spread::{Cause, Spread};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Unit files of a folder by the names of their actuators, or one file.
///
/// # Errors
/// Refuses a folder without any, a file in it that ends in `.json` and is none, and two of one actuator.
pub fn folder(path: &Path) -> Result<BTreeMap<String, Arc<UnitFile>>> {
    let mut files = vec![path.to_path_buf()];
    if path.is_dir() {
        let list = std::fs::read_dir(path).map_err(|e| Error::io(path, "cannot be read", e))?;
        files = list.filter_map(|e| Some(e.ok()?.path())).collect();
        files.retain(|f| f.extension().is_some_and(|e| e == "json"));
        files.sort();
    }
    let mut units: BTreeMap<String, (PathBuf, Arc<UnitFile>)> = BTreeMap::new();
    for file in files {
        let unit = UnitFile::load(&file)?;
        if let Some((other, _)) = units.get(&unit.name) {
            let allowed = format!("one file an actuator: {} is of it too", other.display());
            return Err(Error::bad(file.display().to_string(), "name", unit.name, allowed).into());
        }
        units.insert(unit.name.clone(), (file, Arc::new(unit)));
    }
    if units.is_empty() {
        let allowed = "unit files (ema unit new), called .json";
        return Err(Error::bad(path.display().to_string(), "folder", "none", allowed).into());
    }
    Ok(units.into_iter().map(|(name, (_, unit))| (name, unit)).collect())
}

/// What a unit is of, where no file says it.
pub(crate) const REFERENCE: &str = "the reference actuator (values assumed)";

/// File of the sensors that a study saw, in its folder.
pub(crate) const SENSORS: &str = "sensors.toml";

/// What a unit begins with.
pub struct Beginning {
    /// its type, and where that is from; the reference if `None`
    pub actuator: Option<(ActuatorParameters, String)>,
    /// folder of a study of this unit: the model is the one that it wrote
    pub study: Option<PathBuf>,
    /// how units of the type and their tests differ where no study says it
    pub spread: Spread,
    /// what it is called; the name of its file if `None`
    pub name: Option<String>,
}

/// Writes the file of a new unit.
///
/// # Errors
/// Refuses a file that is there already, a study that wrote no model or is of another machine than the one that is named.
pub fn begin(file: &Path, with: Beginning) -> Result<UnitFile> {
    if file.exists() {
        let file = file.display().to_string();
        return Err(Error::bad(file, "file", "there already", "a file that is not there yet").into());
    }
    let (actuator, source) = match &with.study {
        Some(dir) => {
            let model = dir.join("actuator.toml");
            if !model.exists() {
                let allowed =
                    "a study that wrote a model (ema discrepancy --healthy --out); without one leave --study out";
                return Err(Error::bad(model.display().to_string(), "file", "nothing", allowed).into());
            }
            let studied = ActuatorParameters::read(&model)?;
            same_machine(&model, &studied, with.actuator.as_ref().map(|a| &a.0))?;
            (studied, model.display().to_string())
        }
        None => with
            .actuator
            .unwrap_or_else(|| (ActuatorParameters::reference(), REFERENCE.into())),
    };
    let stem = || {
        file.file_stem()
            .map_or_else(|| "unit".into(), |s| s.to_string_lossy().into_owned())
    };
    let mut unit = UnitFile::new(with.name.unwrap_or_else(stem), source, actuator, with.spread);
    let sensors = with.study.as_ref().map(|dir| dir.join(SENSORS)).filter(|f| f.exists());
    if let Some(file) = sensors {
        unit.sensors = sim_worker::catalogue::sensors(&file.to_string_lossy())?;
    }
    unit.save(file)?;
    Ok(unit)
}

/// Refuses a study of another machine than the one that was named: what no study changes is the same in both.
fn same_machine(file: &Path, studied: &ActuatorParameters, named: Option<&ActuatorParameters>) -> Result<()> {
    let Some(named) = named else { return Ok(()) };
    let fixed = |a: &ActuatorParameters| [f64::from(a.pole_pairs), a.gear_ratio];
    for (place, (found, allowed)) in ["pole pairs", "gear ratio"]
        .into_iter()
        .zip(fixed(studied).into_iter().zip(fixed(named)))
    {
        if found != allowed {
            let allowed = format!("{allowed}, of the actuator that --actuator names");
            return Err(Error::bad(file.display().to_string(), place, found, allowed).into());
        }
    }
    Ok(())
}

/// Constants: cause, deviation and standard deviation now, standard deviation before any test.
pub(crate) fn constants(unit: &UnitFile) -> Vec<(Cause, f64, f64, f64)> {
    let prior = unit.prior();
    let one = |c: &Cause| {
        let (mean, sd) = unit.constants.of(*c)?;
        Some((*c, c.of_counted(mean), sd, prior.of(*c)?.1))
    };
    unit.constants.causes.iter().filter_map(one).collect()
}

/// Keys of `ema unit show --json`.
pub fn to_json(unit: &UnitFile) -> serde_json::Value {
    let constant = |(c, mean, sd, before): (Cause, f64, f64, f64)| serde_json::json!({"cause": c.key(), "deviation": mean, "sigma": sd, "sigma_before": before});
    let test = |t: &diagnoser::unit::TestEntry| {
        let interval =
            |i: Option<(f64, f64, f64)>| i.map(|(lo, e, hi)| serde_json::json!({"lo": lo, "estimate": e, "hi": hi}));
        serde_json::json!({
            "file": t.file, "healthy": t.healthy, "taken": t.is_taken(), "outcome": t.outcome, "reason": t.reason,
            "fsj": interval(t.fsj), "zeta": interval(t.zeta), "checksum": t.checksum, "commit": t.commit,
            "repairs_before": t.repairs,
        })
    };
    let last = unit.tests.iter().rev().find(|t| t.fsj.is_some() && unit.is_present(t));
    serde_json::json!({
        "name": unit.name,
        "model": unit.source,
        "tests": unit.taken(),
        "healthy_tests": unit.healthy(),
        "reference": unit.reference(),
        "sensors": unit.sensors.as_ref().map(|s| &s.name),
        "constants": constants(unit).into_iter().map(constant).collect::<Vec<_>>(),
        "present": last.map(test),
        "repairs": unit.repairs.iter().map(|r| serde_json::json!({"part": r.part.name(), "note": r.note})).collect::<Vec<_>>(),
        "history": unit.tests.iter().map(test).collect::<Vec<_>>(),
    })
}
