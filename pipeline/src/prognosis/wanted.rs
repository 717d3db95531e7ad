//! What is wanted of histories, in the words of the command line, and how it is answered.

use super::margin::{Margin, STALL};
use super::page::report;
use super::read::{Sheet, events, history_file};
use super::{Asked, Clock, Events, Threshold, Told, learn, outlooks, tables};
use crate::dataset::wear::EVENTS;
use crate::progress::note;
use anyhow::Result;
use diagnoser::prognosis::Fleet;
use schemas::error::Error;
use sim_worker::parameters::ActuatorParameters;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Risk that is taken where nobody asks.
pub const RISK: f64 = 0.01;

/// What is wanted of histories.
#[derive(Clone, Debug, Default)]
pub struct Wanted {
    /// `fsj=4`, `zeta=0.4`, `stall=0.4Nm`; those that are usual if empty
    pub threshold: Vec<String>,
    /// for `stall`; the reference if `None`
    pub actuator: Option<Arc<ActuatorParameters>>,
    /// in what time is counted; the clock in which laws fit better if `None`
    pub clock: Option<Clock>,
    /// file of repairs and other interventions; those of a dataset are found
    pub events: Option<PathBuf>,
    /// a health indicator in place of FSJ and zeta
    pub column: Option<String>,
    /// its level in a healthy unit
    pub healthy: Option<f64>,
}

/// Where a load is no longer moved, for people.
fn stall_words(m: &Margin) -> String {
    let at = |fsj: Option<&f64>| fsj.map_or("-".into(), |f| format!("{f:.2}"));
    format!(
        "a load of {} N m at the motor is no longer moved in time from FSJ {} (zeta 0), {} (zeta 0.5) on, by simulation; in time: half of the \
         healthy speed without a load (assumed). Levels: (FSJ - 1) over the way to it",
        m.load_n_m,
        at(m.fsj.first()),
        at(m.fsj.last())
    )
}

impl Wanted {
    fn actuator(&self) -> Arc<ActuatorParameters> {
        let reference = || Arc::new(ActuatorParameters::reference());
        self.actuator.clone().unwrap_or_else(reference)
    }

    /// Thresholds that are named, or those that are usual for the faults that a table has.
    ///
    /// * `from_truth` those that a file of truths names
    ///
    /// # Errors
    /// Refuses a text that names none, and a level that is the healthy one.
    pub fn thresholds(&self, table: &Sheet, from_truth: Vec<Threshold>) -> Result<Vec<Threshold>> {
        let named = self.threshold.iter().map(|text| {
            if let Some((fault, load)) = text.split_once('=')
                && fault.trim().eq_ignore_ascii_case(STALL)
            {
                let margin = Margin::simulate(&self.actuator(), Margin::load(load)?)?;
                note(&stall_words(&margin));
                return Ok(Threshold::stall(margin));
            }
            let (fault, level) = match (text.split_once('='), &self.column) {
                (Some((f, l)), _) => (f.trim().to_ascii_lowercase(), l),
                (None, Some(c)) => (c.to_ascii_lowercase(), text.as_str()),
                (None, None) => (String::new(), text.as_str()),
            };
            let is_known = ["fsj", "zeta"].contains(&fault.as_str())
                || self.column.as_ref().is_some_and(|c| c.eq_ignore_ascii_case(&fault));
            match level.trim().parse::<f64>() {
                Ok(l) if l.is_finite() && is_known => Ok(Threshold::new(&fault, l, self.healthy)),
                _ => {
                    let allowed = "FAULT=LEVEL with fsj, zeta or the column of --column and a number, or stall=LOAD such as stall=0.4Nm";
                    Err(Error::bad("command line", "--threshold", text, allowed).into())
                }
            }
        });
        let named: Vec<Threshold> = named.collect::<Result<_>>()?;
        for t in &named {
            if t.healthy.is_some_and(|h| h == t.level) {
                let allowed = "a level other than the healthy one";
                return Err(Error::bad(
                    "command line",
                    "--threshold",
                    format!("{}={}", t.fault, t.level),
                    allowed,
                )
                .into());
            }
        }
        if !named.is_empty() {
            return Ok(named);
        }
        if !from_truth.is_empty() {
            return Ok(from_truth);
        }
        if self.column.is_some() {
            return Err(Error::bad(
                "command line",
                "--threshold",
                "nothing",
                "a level for the column of --column",
            )
            .into());
        }
        let usual = [("fsj", 4.0), ("zeta", 0.4)].map(|(f, l)| Threshold::new(f, l, None));
        let found: Vec<Threshold> = usual.into_iter().filter(|t| table.has(&t.fault)).collect();
        if found.is_empty() {
            let allowed = "--threshold, with the column that it is for in the table";
            return Err(Error::bad("command line", "--threshold", "nothing", allowed).into());
        }
        let words: Vec<String> = found.iter().map(|t| format!("{}={}", t.fault, t.level)).collect();
        note(&format!("threshold {} (assumed)", words.join(", ")));
        Ok(found)
    }

    /// The question, with the usual times ahead.
    ///
    /// * `horizon` one more time ahead [units of the clock]
    pub fn asked(&self, thresholds: Vec<Threshold>, risk: f64, horizon: Option<f64>) -> Asked {
        let mut horizons = vec![10.0, 20.0, 50.0];
        horizons.extend(horizon.filter(|h| !horizons.contains(h)));
        Asked {
            thresholds,
            clock: self.clock,
            risk,
            horizons,
        }
    }

    /// What is recorded: the file that is named, or what lies in the datasets that histories are of.
    ///
    /// # Errors
    /// As [`events`].
    pub fn events(&self, histories: &[PathBuf]) -> Result<Events> {
        if let Some(named) = &self.events {
            return events(named);
        }
        let mut all = Events::new();
        for file in histories.iter().map(|h| h.join(EVENTS)).filter(|f| f.exists()) {
            for (unit, list) in events(&file)? {
                all.entry(unit).or_default().extend(list);
            }
        }
        Ok(all)
    }
}

/// What fleets have taught, of a file of `ema prognosis learn`; nothing without one.
///
/// # Errors
/// As [`learn::read`].
pub fn fleets_of(path: Option<&Path>) -> Result<Vec<Fleet>> {
    path.map_or_else(|| Ok(Vec::new()), learn::read)
}

/// What `ema prognosis` tells of a history, once.
///
/// * `place` file or dataset of diagnoses
/// * `risk` of having passed the threshold that is taken
/// * `horizon` one more time ahead at which the probability of failure is told [units of the clock]
///
/// # Errors
/// Refuses what [`Sheet::read`], [`Wanted::thresholds`] and [`outlooks`] refuse.
pub fn foretell(place: &Path, wanted: &Wanted, fleets: &[Fleet], risk: f64, horizon: Option<f64>) -> Result<Vec<Told>> {
    let file = history_file(place)?;
    let table = Sheet::read(&file)?;
    let asked = wanted.asked(wanted.thresholds(&table, Vec::new())?, risk, horizon);
    let units = asked.prepared(table)?.history(&asked.faults())?;
    let events = wanted.events(&[place.to_path_buf()])?;
    outlooks(&file.display().to_string(), &units, &events, &asked, fleets)
}

/// Writes tables, figures and the page of what was told; gives the pages, the one to be read last.
///
/// # Errors
/// A folder that cannot be made or written.
pub fn written(dir: &Path, told: &[Told], fleets: &[Fleet]) -> Result<Vec<PathBuf>> {
    std::fs::create_dir_all(dir).map_err(|e| Error::io(dir, "cannot be made", e))?;
    tables::write(dir, told)?;
    crate::report::write(&report(told, fleets), dir, "report.html")
}
