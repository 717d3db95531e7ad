//! `ema prognosis`.

use super::{ActuatorArg, OUTPUT, say, say_json};
use crate::Interrupted;
use crate::prognosis::learn::{Ends, Unit, learn, units_of};
use crate::prognosis::live::foresight;
use crate::prognosis::page::scores;
use crate::prognosis::read::{End, Sheet, Test, history_file, truths};
use crate::prognosis::score::{Scored, score, to_json as score_json, to_text as score_text};
use crate::prognosis::wanted::{RISK, Wanted, fleets_of, written};
use crate::prognosis::words::{text, to_json};
use crate::prognosis::{Asked, Clock, Events, Threshold, clock_of, learn as fleet_file, outlooks};
use crate::progress::interrupted;
use anyhow::Result;
use clap::{Args, Subcommand};
use diagnoser::prognosis::Fleet;
use diagnoser::prognosis::fleet::{CALIBRATED, MOST_UNSEEN};
use diagnoser::receive::foresight::Foresight;
use diagnoser::report::versioned;
use schemas::error::Error;
use serde_json::Value;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::Duration;

/// Heading of options on what was diagnosed.
const HISTORY: &str = "History";
/// Heading of options on what is foretold.
const FORECAST: &str = "Forecast";

#[derive(Args)]
#[command(args_conflicts_with_subcommands = true, subcommand_negates_reqs = true)]
pub struct PrognosisCommand {
    #[command(subcommand)]
    command: Option<Sub>,
    #[command(flatten)]
    args: PrognosisArgs,
}

#[derive(Subcommand)]
enum Sub {
    /// What a fleet teaches: prior, lives to compare with, calibration
    #[command(after_help = "Example: ema prognosis learn histories.csv --truth removals.csv --out fleet.json")]
    Learn(LearnArgs),
    /// Replay every past prediction of units whose end is known
    #[command(after_help = "Example: ema prognosis score histories.csv --truth removals.csv --fleet fleet.json")]
    Score(ScoreArgs),
}

#[derive(Args)]
struct PrognosisArgs {
    /// Diagnoses over time: a log of ema live, a dataset, or a table
    ///
    /// A log (.jsonl, .parquet), a dataset that wears and was diagnosed, or a table (.csv, .parquet)
    /// with the columns actuator, time (ISO, or a number) or cycle, outcome, fsj_lo, fsj_hi, fsj_estimate, zeta_lo ..., coverage
    #[arg(required = true)]
    history: Option<PathBuf>,
    #[command(flatten)]
    what: WhatArgs,
    /// What a fleet has taught, a file of ema prognosis learn
    #[arg(long, value_name = "FILE", help_heading = HISTORY)]
    fleet: Option<PathBuf>,
    /// Probability of having passed the threshold that is taken
    #[arg(long, default_value_t = RISK, value_parser = risk, help_heading = FORECAST)]
    risk: f64,
    /// One more time ahead at which the probability of failure is told, beside 10, 20 and 50 [units of the clock]
    #[arg(long, value_parser = positive, help_heading = FORECAST)]
    horizon: Option<f64>,
    /// Folder for trends.parquet, prognoses.parquet, alarms.parquet, figures and report.html
    #[arg(long, value_name = "DIR", help_heading = OUTPUT)]
    out: Option<PathBuf>,
    /// Keys for programs: an object a line, for each actuator and threshold (schemas/json/prognosis.schema.json)
    #[arg(long, help_heading = OUTPUT)]
    json: bool,
    /// Read a growing log again whenever it has grown, and say what is new, until Ctrl-C
    #[arg(long, help_heading = OUTPUT)]
    follow: bool,
}

#[derive(Args)]
struct WhatArgs {
    /// Fault and the level that ends its life, such as fsj=4; may be repeated
    ///
    /// fsj=4, zeta=0.4; or stall=LOAD, a load torque at the motor such as 0.4Nm that is no longer moved in time, by
    /// simulation. Left out: fsj=4 and zeta=0.4 where the table has them (assumed).
    #[arg(long, value_name = "FAULT=LEVEL", help_heading = FORECAST)]
    threshold: Vec<String>,
    /// For stall=LOAD
    #[command(flatten)]
    actuator: ActuatorArg,
    /// In what time is counted; the clock in which laws fit better where a table has two
    #[arg(long, help_heading = HISTORY)]
    clock: Option<Clock>,
    /// Repairs and other interventions, a CSV file; those of a dataset are found
    ///
    /// Columns: actuator, time or cycle, kind (repair, replacement, lubrication, configuration, sensor, loss), fault, note.
    #[arg(long, value_name = "FILE", help_heading = HISTORY)]
    events: Option<PathBuf>,
    /// Any bounded health indicator in place of FSJ and zeta: NAME, and NAME_lo, NAME_hi where they are known
    #[arg(long, value_name = "NAME", help_heading = HISTORY)]
    column: Option<String>,
    /// Its level in a healthy unit; the median of a unit's first five tests where it is left out (assumed)
    #[arg(long, help_heading = HISTORY)]
    healthy: Option<f64>,
}

#[derive(Args)]
struct LearnArgs {
    /// Histories of the fleet
    #[arg(required = true)]
    history: Vec<PathBuf>,
    #[command(flatten)]
    what: WhatArgs,
    /// Ends of lives, a CSV file with the columns actuator, time or cycle, event; without it lives end where tests have
    /// passed the threshold, or are about to
    #[arg(long, value_name = "FILE", help_heading = HISTORY)]
    truth: Option<PathBuf>,
    /// File to be written
    #[arg(long, value_name = "FILE", help_heading = OUTPUT)]
    out: PathBuf,
}

#[derive(Args)]
struct ScoreArgs {
    /// Histories
    #[arg(required = true)]
    history: Vec<PathBuf>,
    #[command(flatten)]
    what: WhatArgs,
    /// Ends of lives, a CSV file with the columns actuator, time or cycle, event
    #[arg(long, value_name = "FILE", help_heading = HISTORY)]
    truth: PathBuf,
    /// What a fleet of other units has taught
    #[arg(long, value_name = "FILE", help_heading = HISTORY)]
    fleet: Option<PathBuf>,
    /// Folder for scores.csv, a row a forecast, and report.html with the reliability diagram
    #[arg(long, value_name = "DIR", help_heading = OUTPUT)]
    out: Option<PathBuf>,
    /// Keys for programs
    #[arg(long, help_heading = OUTPUT)]
    json: bool,
}

impl WhatArgs {
    fn wanted(&self) -> Result<Wanted> {
        Ok(Wanted {
            threshold: self.threshold.clone(),
            actuator: self.actuator.named()?,
            clock: self.clock,
            events: self.events.clone(),
            column: self.column.clone(),
            healthy: self.healthy,
        })
    }
}

fn risk(text: &str) -> std::result::Result<f64, String> {
    let allowed = "a probability from 0.0001 to 0.5".to_string();
    text.parse().ok().filter(|x| (1e-4..=0.5).contains(x)).ok_or(allowed)
}

fn positive(text: &str) -> std::result::Result<f64, String> {
    text.parse()
        .ok()
        .filter(|x: &f64| x.is_finite() && *x > 0.0)
        .ok_or("a number above 0".into())
}

pub fn prognosis(c: &PrognosisCommand) -> Result<ExitCode> {
    match &c.command {
        Some(Sub::Learn(a)) => learned(a),
        Some(Sub::Score(a)) => scored(a),
        None => foretold(&c.args),
    }
}

/// What the live view foretells from a history, in the usual way.
///
/// # Errors
/// As `ema prognosis` with the same history.
pub(super) fn foresight_of(
    history: &Path,
    threshold: &[String],
    events: Option<PathBuf>,
    fleet: Option<&Path>,
) -> Result<Foresight> {
    let w = Wanted {
        threshold: threshold.to_vec(),
        events,
        ..Wanted::default()
    };
    let table = Sheet::read(&history_file(history)?)?;
    let asked = w.asked(w.thresholds(&table, Vec::new())?, RISK, None);
    let table = asked.prepared(table)?;
    let events = w.events(&[history.to_path_buf()])?;
    foresight(&table, events, asked, fleets_of(fleet)?)
}

fn foretold(a: &PrognosisArgs) -> Result<ExitCode> {
    let place = a.history.clone().unwrap_or_default();
    let file = history_file(&place)?;
    let mut size = std::fs::metadata(&file).map_or(0, |m| m.len());
    let table = Sheet::read(&file)?;
    let wanted = a.what.wanted()?;
    let asked = wanted.asked(wanted.thresholds(&table, Vec::new())?, a.risk, a.horizon);
    let mut table = asked.prepared(table)?;
    let fleets = fleets_of(a.fleet.as_deref())?;
    let mut said: BTreeMap<(String, String), usize> = BTreeMap::new();
    loop {
        let units = table.history(&asked.faults())?;
        let told = outlooks(
            &file.display().to_string(),
            &units,
            &wanted.events(std::slice::from_ref(&place))?,
            &asked,
            &fleets,
        )?;
        let new = told.iter().filter(|t| {
            let key = (t.outlook.actuator.clone(), t.threshold.fault.clone());
            said.insert(key, t.outlook.tests) != Some(t.outlook.tests)
        });
        for t in new {
            if a.json {
                say_json(to_json(t));
            } else {
                say(&(text(t) + "\n"));
            }
        }
        if let Some(dir) = &a.out {
            let pages = written(dir, &told, &fleets)?;
            if !a.json {
                say_written(&pages, "trends, prognoses, alarms (.parquet)");
            }
        }
        if !a.follow {
            return Ok(ExitCode::SUCCESS);
        }
        let grown = |size: &mut u64| {
            let now = std::fs::metadata(&file).map_or(0, |m| m.len());
            std::mem::replace(size, now) != now
        };
        while !grown(&mut size) {
            std::thread::sleep(Duration::from_millis(300));
            if interrupted() {
                return Err(Interrupted.into());
            }
        }
        table = asked.read(&file)?;
    }
}

/// * `pages` that were written, the one to be read last
fn say_written(pages: &[PathBuf], beside: &str) {
    let page = pages.last().map_or_else(String::new, |p| p.display().to_string());
    say(&format!("wrote     {page}, {beside} beside it"));
}

/// All files of a command.
fn tables_of(files: &[PathBuf]) -> Result<Vec<Sheet>> {
    files.iter().map(|f| Sheet::read(&history_file(f)?)).collect()
}

/// Whether intervals are calibrated, and why not.
fn calibration_of(fleet: &Fleet) -> String {
    if fleet.is_calibrated() {
        "intervals are calibrated".into()
    } else if fleet.unseen > MOST_UNSEEN {
        let percent = 100.0 * fleet.unseen;
        format!(
            "{percent:.0} % of lives are longer than any that ended: it teaches its prior alone, intervals stay a design figure"
        )
    } else {
        format!("too few lives ({CALIBRATED}) to calibrate: intervals stay a design figure")
    }
}

fn prepared(files: Vec<Sheet>, asked: &Asked) -> Result<Vec<Sheet>> {
    files.into_iter().map(|f| asked.prepared(f)).collect()
}

fn learned(a: &LearnArgs) -> Result<ExitCode> {
    let truth = a.truth.as_deref().map(truths).transpose()?.unwrap_or_default();
    let files = tables_of(&a.history)?;
    let wanted = a.what.wanted()?;
    let asked = wanted.asked(wanted.thresholds(&files[0], Vec::new())?, RISK, None);
    let files = prepared(files, &asked)?;
    let events = wanted.events(&a.history)?;
    let (units, clock) = units_by_fault(&files, &events, &asked, None, &truth)?;
    let mut fleets = Vec::new();
    let mut n = 0;
    for (t, units) in asked.thresholds.iter().zip(&units) {
        n = n.max(units.len());
        let (fleet, ends): (Fleet, Ends) = learn(units, t, clock)?;
        say(&format!(
            "{} {}: {} units, {} lives to the end ({} told, {} past the threshold, {} extrapolated), {} alive; {}",
            t.fault,
            t.level,
            units.len(),
            fleet.lives.len(),
            ends.told,
            ends.crossed,
            ends.extrapolated,
            ends.alive,
            calibration_of(&fleet),
        ));
        fleets.push(fleet);
    }
    fleet_file::write(&a.out, &fleets, n)?;
    say(&format!("wrote     {}", a.out.display()));
    Ok(ExitCode::SUCCESS)
}

/// Units with their ends, those of different files apart, by threshold.
fn units_by_fault(
    files: &[Sheet],
    events: &Events,
    asked: &Asked,
    fleet: Option<&Fleet>,
    truth: &BTreeMap<String, Vec<End>>,
) -> Result<(Vec<Vec<Unit>>, Clock)> {
    let mut all: Vec<(String, Vec<Test>)> = Vec::new();
    for f in files {
        all.extend(f.history(&asked.faults())?);
    }
    let tests: Vec<(&String, &Vec<Test>)> = all.iter().map(|(name, tests)| (name, tests)).collect();
    let clock = clock_of(files[0].file(), &tests, events, asked, fleet)?;
    let of = |(i, t): (usize, &Threshold)| units_of(&all, events, truth, (t, i), clock);
    Ok((asked.thresholds.iter().enumerate().map(of).collect(), clock))
}

/// Thresholds as a file of truths names them: `fsj>4`.
fn named_in(truth: &BTreeMap<String, Vec<End>>) -> Vec<Threshold> {
    let mut found: Vec<(String, String)> = truth
        .values()
        .flatten()
        .filter_map(|e| {
            e.event
                .split_once('>')
                .map(|(f, l)| (f.trim().to_ascii_lowercase(), l.trim().to_string()))
        })
        .collect();
    found.sort();
    found.dedup();
    let known = found.into_iter().filter(|(f, _)| f == "fsj" || f == "zeta");
    known
        .filter_map(|(f, l)| Some(Threshold::new(&f, l.parse().ok()?, None)))
        .collect()
}

fn scored(a: &ScoreArgs) -> Result<ExitCode> {
    let truth = truths(&a.truth)?;
    let files = tables_of(&a.history)?;
    let fleets = fleets_of(a.fleet.as_deref())?;
    let wanted = a.what.wanted()?;
    let asked = wanted.asked(wanted.thresholds(&files[0], named_in(&truth))?, RISK, None);
    let files = prepared(files, &asked)?;
    let events = wanted.events(&a.history)?;
    let (units, _) = units_by_fault(&files, &events, &asked, fleets.first(), &truth)?;
    let mut rows = String::from("fault,unit,lambda,truth,median,lo,hi,crps\n");
    let (mut objects, mut replayed) = (Vec::new(), Vec::new());
    for (t, units) in asked.thresholds.iter().zip(&units) {
        let fleet = fleets.iter().find(|f| f.fault == t.fault);
        let s: Scored = score(units, fleet, &asked.horizons)?;
        if s.units == 0 {
            let file = a.truth.display().to_string();
            let allowed = format!("the end of at least one unit of the history, for {}", t.fault);
            return Err(Error::bad(file, "rows", "none that fits", allowed).into());
        }
        let lives = fleet.filter(|f| f.is_calibrated()).map(|f| f.lives.len());
        if a.json {
            objects.push(versioned(score_json(&s, &t.fault, t.level, lives)));
        } else {
            say(&score_text(&s, &t.fault, t.level));
        }
        for f in &s.forecasts {
            let name = &units[f.unit].history.actuator;
            rows += &format!(
                "{},{name},{:.4},{:.6},{:.6},{:.6},{:.6},{:.6}\n",
                t.fault, f.lambda, f.truth, f.median, f.lo, f.hi, f.crps
            );
        }
        replayed.push((t.fault.clone(), t.level, s));
    }
    if a.json {
        let whole = if objects.len() == 1 {
            objects.remove(0)
        } else {
            Value::Array(objects)
        };
        say(&whole.to_string());
    }
    if let Some(dir) = &a.out {
        std::fs::create_dir_all(dir).map_err(|e| Error::io(dir, "cannot be made", e))?;
        schemas::error::write_whole(&dir.join("scores.csv"), rows.as_bytes())?;
        let pages = crate::report::write(&scores(&replayed), dir, "report.html")?;
        if !a.json {
            say_written(&pages, "scores.csv");
        }
    }
    Ok(ExitCode::SUCCESS)
}
