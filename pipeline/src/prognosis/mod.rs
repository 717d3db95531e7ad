//! Prognosis of a fleet: histories in, outlooks, tables and figures out.

pub mod learn;
pub mod live;
pub mod margin;
pub mod page;
pub mod read;
pub mod score;
pub mod tables;
pub mod wanted;
pub mod words;

use anyhow::Result;
use clap::ValueEnum;
use diagnoser::prognosis::fleet::Left;
use diagnoser::prognosis::outlook::{Question, outlook};
use diagnoser::prognosis::special::middle;
use diagnoser::prognosis::{Ended, Fleet, Happening, History, Outlook, Prior, Row, Scale, Status, Track};
use margin::{Margin, STALL};
use rayon::prelude::*;
use read::{Event, Level, Moment, Sheet, Test, Units};
use schemas::error::Error;
use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;

/// In place of a fault: the first of several thresholds.
const JOINT: &str = "joint";

/// Units by which clocks are compared at most.
const COMPARED: usize = 40;

/// In what time is counted.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Clock {
    /// flights: the column `cycle` or `flight`
    Flight,
    /// cycles: the column `cycle` or `flight`
    Cycle,
    /// hours of the column `time`
    Hour,
    /// days of the column `time`
    Day,
}

impl Clock {
    /// Key of outputs.
    pub fn name(self) -> &'static str {
        match self {
            Self::Flight => "flight",
            Self::Cycle => "cycle",
            Self::Hour => "hour",
            Self::Day => "day",
        }
    }

    /// Whether it counts flights or cycles, and no time of day.
    fn is_counted(self) -> bool {
        matches!(self, Self::Flight | Self::Cycle)
    }

    /// The time of a moment by this clock.
    pub fn of(self, m: Moment) -> Option<f64> {
        match self {
            Self::Flight | Self::Cycle => m.cycle,
            Self::Hour => m.day.map(|d| d * 24.0).or(m.cycle),
            Self::Day => m.day.or(m.cycle),
        }
    }
}

/// A threshold of one fault.
#[derive(Clone, Debug, PartialEq)]
pub struct Threshold {
    /// fault or column
    pub fault: String,
    /// level that ends the life
    pub level: f64,
    /// level of a healthy unit; the first tests' where it is not said
    pub healthy: Option<f64>,
    /// of a threshold of function: how its levels follow from FSJ and zeta
    pub margin: Option<Arc<Margin>>,
}

impl Threshold {
    /// A fault by its name: what is known of it.
    pub fn new(fault: &str, level: f64, healthy: Option<f64>) -> Self {
        let known = match fault {
            "fsj" => Some(1.0),
            "zeta" => Some(0.0),
            _ => None,
        };
        Self {
            fault: fault.into(),
            level,
            healthy: healthy.or(known),
            margin: None,
        }
    }

    /// A load that is no longer moved in time.
    pub fn stall(margin: Margin) -> Self {
        Self {
            fault: STALL.into(),
            level: 1.0,
            healthy: Some(0.0),
            margin: Some(Arc::new(margin)),
        }
    }

    fn range(&self) -> Option<f64> {
        match self.fault.as_str() {
            "fsj" => Some(5.0),
            "zeta" => Some(0.5),
            _ => None,
        }
    }
}

/// What is asked of histories.
#[derive(Clone, Debug)]
pub struct Asked {
    /// thresholds, one a fault
    pub thresholds: Vec<Threshold>,
    /// clock; that of the greater evidence if it is not said
    pub clock: Option<Clock>,
    /// risk that is taken
    pub risk: f64,
    /// times ahead at which the probability of failure is told [units of the clock]
    pub horizons: Vec<f64>,
}

impl Asked {
    /// Faults and columns, in the order of their thresholds.
    pub fn faults(&self) -> Vec<String> {
        self.thresholds.iter().map(|t| t.fault.clone()).collect()
    }

    /// A table with the levels of all that is asked for.
    ///
    /// # Errors
    /// As [`Sheet::read`]; no FSJ and zeta where a margin is asked for.
    pub fn read(&self, path: &Path) -> Result<Sheet> {
        self.prepared(Sheet::read(path)?)
    }

    /// As [`Asked::read`], of a table that was read.
    ///
    /// # Errors
    /// As [`Asked::read`].
    pub fn prepared(&self, mut sheet: Sheet) -> Result<Sheet> {
        for margin in self.thresholds.iter().filter_map(|t| t.margin.as_ref()) {
            sheet.put_margin(margin)?;
        }
        Ok(sheet)
    }
}

/// Events by unit.
pub type Events = BTreeMap<String, Vec<Event>>;

/// What happened to one unit.
fn of_unit<'a>(events: &'a Events, name: &str) -> &'a [Event] {
    events.get(name).map_or(&[], Vec::as_slice)
}

/// One unit and threshold, and what is told of it.
pub struct Told {
    /// the threshold
    pub threshold: Threshold,
    /// how level and damage belong together; none where no healthy level is known
    pub scale: Option<Scale>,
    /// clock of its times
    pub clock: Clock,
    /// days in a unit of the clock of late, where both are recorded
    pub days: Option<f64>,
    /// what is told
    pub outlook: Outlook,
    /// its tests, and what was made of them one by one; none where it was refused before
    pub track: Option<(History, Track)>,
    /// what happened to it
    pub events: Vec<(f64, String)>,
}

/// The tests of a unit and fault by one clock.
///
/// # Errors
/// The reason, in words, where they cannot be read so.
pub fn history_of(
    actuator: &str,
    tests: &[Test],
    events: &[Event],
    (fault, index): (&str, usize),
    clock: Clock,
) -> std::result::Result<History, String> {
    let mut rows = Vec::with_capacity(tests.len());
    for t in tests {
        let Some(at) = clock.of(t.moment) else {
            return Err(format!("a test without {}", clock.name()));
        };
        let Level { lo, hi, estimate } = t.levels[index];
        rows.push(Row {
            at,
            ended: t.ended,
            lo,
            hi,
            estimate,
            coverage: t.coverage,
        });
    }
    if disagree(tests) {
        return Err("clocks that disagree: cycles fall where times rise".into());
    }
    let of_fault = |e: &&Event| e.fault.is_empty() || e.fault == fault || e.what != Happening::Repair;
    let mut happened = Vec::new();
    for e in events.iter().filter(of_fault) {
        let Some(at) = clock.of(e.moment) else {
            return Err(format!("an event without {}", clock.name()));
        };
        happened.push((at, e.what));
    }
    with_widths(&mut rows);
    Ok(History::new(actuator.into(), rows, happened))
}

/// Whether cycles fall in the order of times, beyond what two tests at one moment may.
fn disagree(tests: &[Test]) -> bool {
    let mut both: Vec<(f64, f64)> = tests
        .iter()
        .filter_map(|t| Some((t.moment.day?, t.moment.cycle?)))
        .collect();
    both.sort_by(|a, b| a.0.total_cmp(&b.0));
    both.windows(2).any(|w| w[0].0 < w[1].0 && w[1].1 < w[0].1)
}

/// Where a table has levels without intervals, their scatter stands for those: by the differences of neighbours, which
/// even growth leaves out.
fn with_widths(rows: &mut [Row]) {
    let is_bare = |r: &Row| r.estimate.is_some() && (r.lo.is_none() || r.hi.is_none()) && r.ended == Ended::Located;
    if !rows.iter().any(is_bare) {
        return;
    }
    let mut ordered: Vec<(f64, f64)> = rows.iter().filter_map(|r| Some((r.at, r.estimate?))).collect();
    ordered.sort_by(|a, b| a.0.total_cmp(&b.0));
    let seconds = ordered.windows(3).map(|w| (w[0].1 - 2.0 * w[1].1 + w[2].1).abs());
    let span = ordered
        .iter()
        .fold((f64::INFINITY, f64::NEG_INFINITY), |a, v| (a.0.min(v.1), a.1.max(v.1)));
    // median of second differences of white noise: 0.6745 sqrt(6) sd
    let scatter = middle(seconds.collect()).map_or(0.0, |m| m / (0.6745 * 6f64.sqrt()));
    let sd = scatter.max(1e-4 * (span.1 - span.0).max(0.0));
    for r in rows.iter_mut().filter(|r| is_bare(r)) {
        let e = r.estimate.unwrap_or(0.0);
        (r.lo, r.hi, r.coverage) = (Some(e - 1.96 * sd), Some(e + 1.96 * sd), 0.95);
    }
}

/// The scale of a unit: its healthy level is the one that is said, or the median of its first five tests.
pub fn scale_of(h: &History, t: &Threshold) -> Option<Scale> {
    let healthy = t.healthy.or_else(|| {
        let levels = h.rows.iter().filter_map(|r| r.middle()).map(|m| m.0);
        middle(levels.take(5).collect())
    })?;
    let apart = (t.level - healthy).abs() > 1e-9 * t.level.abs().max(healthy.abs());
    apart.then_some(Scale {
        healthy,
        threshold: t.level,
        range: t.range(),
    })
}

/// Units with their tests.
pub type Tests<'a> = [(&'a String, &'a Vec<Test>)];

/// The clock that is asked for, or that of the fleet, or the one in which laws fit better where there are two.
///
/// # Errors
/// A clock that the table does not have, or in which the fleet was not learned.
pub fn clock_of(file: &str, units: &Tests<'_>, events: &Events, asked: &Asked, fleet: Option<&Fleet>) -> Result<Clock> {
    let moments = || units.iter().flat_map(|u| u.1).map(|t| t.moment);
    let has = |c: Clock| moments().all(|m| c.of(m).is_some());
    let learned = fleet.and_then(|f| Clock::value_variants().iter().find(|c| c.name() == f.clock));
    if let (Some(c), Some(l)) = (asked.clock, learned)
        && c.is_counted() != l.is_counted()
    {
        let allowed = format!("{}, in which the fleet was learned", l.name());
        return Err(Error::bad("command line", "--clock", c.name(), allowed).into());
    }
    if let Some(c) = asked.clock.or(learned.copied()) {
        if !has(c) {
            let allowed = "a value in every row";
            return Err(Error::bad(file, format!("clock `{}`", c.name()), "rows without it", allowed).into());
        }
        return Ok(c);
    }
    let dated = moments().all(|m| m.day.is_some());
    match (has(Clock::Cycle), dated) {
        (true, false) => Ok(Clock::Cycle),
        (false, true) => Ok(Clock::Day),
        (true, true) => {
            // densities of the same levels: they can be compared
            let t = &asked.thresholds[0];
            let of = |name: &str, tests: &[Test], c: Clock| {
                let h = history_of(name, tests, of_unit(events, name), (&t.fault, 0), c).ok()?;
                let mut track = Track::new(Arc::new(Prior::shipped(h.interval()?)), scale_of(&h, t)?);
                track.read_all(&h);
                Some(track.filter.evidence)
            };
            let some = &units[..units.len().min(COMPARED)];
            let evidence = |c: Clock| -> f64 { some.par_iter().filter_map(|(name, tests)| of(name, tests, c)).sum() };
            Ok(match evidence(Clock::Day) > evidence(Clock::Cycle) {
                true => Clock::Day,
                false => Clock::Cycle,
            })
        }
        (false, false) => {
            let allowed = "one clock that every row has: cycle, flight, time or time_ns";
            Err(Error::bad(file, "clock", "rows with one and rows with another", allowed).into())
        }
    }
}

/// Outlooks of all units and thresholds; where there are several thresholds, also the joint one of each unit.
///
/// # Errors
/// A clock that the table does not have; a fleet of another threshold or clock.
pub fn outlooks(file: &str, units: &Units, events: &Events, asked: &Asked, fleets: &[Fleet]) -> Result<Vec<Told>> {
    for t in &asked.thresholds {
        fits(t, fleets)?;
    }
    let all: Vec<(&String, &Vec<Test>)> = units.iter().collect();
    let clock = clock_of(file, &all, events, asked, fleets.first())?;
    let told = all.into_par_iter().map(|(name, tests)| {
        let events = of_unit(events, name);
        let mut out: Vec<Told> = asked
            .thresholds
            .iter()
            .enumerate()
            .map(|(i, t)| {
                let fleet = fleets.iter().find(|f| f.fault == t.fault);
                told_of(name, tests, events, (t, i), clock, asked, fleet)
            })
            .collect();
        if out.len() > 1
            && let Some(joint) = joint(&out)
        {
            out.push(joint);
        }
        out
    });
    Ok(told.collect::<Vec<_>>().into_iter().flatten().collect())
}

/// Whether a fleet of the fault was learned for this threshold.
fn fits(t: &Threshold, fleets: &[Fleet]) -> Result<()> {
    let Some(f) = fleets.iter().find(|f| f.fault == t.fault) else {
        return Ok(());
    };
    let same = |a: f64, b: f64| (a - b).abs() <= 1e-9 * b.abs().max(1.0);
    if !same(f.threshold, t.level) {
        let allowed = format!("{}, for which the fleet was learned", f.threshold);
        return Err(Error::bad("command line", format!("--threshold {}", t.fault), t.level, allowed).into());
    }
    Ok(())
}

fn told_of(
    name: &str,
    tests: &[Test],
    events: &[Event],
    (t, index): (&Threshold, usize),
    clock: Clock,
    asked: &Asked,
    fleet: Option<&Fleet>,
) -> Told {
    let history = history_of(name, tests, events, (&t.fault, index), clock);
    let happened = events
        .iter()
        .filter_map(|e| Some((clock.of(e.moment)?, e.kind.clone())))
        .collect();
    let days = days_of(tests, clock);
    let base = |scale, outlook, track| Told {
        threshold: t.clone(),
        scale,
        clock,
        days,
        outlook,
        track,
        events: happened,
    };
    let history = match history {
        Ok(h) => h,
        Err(why) => return base(None, Outlook::refused(name, tests.len(), asked.risk, why), None),
    };
    let Some(scale) = scale_of(&history, t) else {
        let why = match history.rows.iter().any(|r| r.middle().is_some()) {
            true => "the unit's first level is its threshold already: no healthy level",
            false => "no test with an interval: no healthy level",
        };
        return base(None, Outlook::refused(name, tests.len(), asked.risk, why.into()), None);
    };
    let question = Question {
        scale,
        risk: asked.risk,
        horizons: asked.horizons.clone(),
    };
    let (outlook, track) = outlook(&history, &question, fleet);
    base(Some(scale), outlook, Some((history, track)))
}

/// Days in a unit of the clock over the last twenty tests, where rows have both.
fn days_of(tests: &[Test], clock: Clock) -> Option<f64> {
    let both: Vec<(f64, f64)> = tests
        .iter()
        .rev()
        .take(20)
        .filter_map(|t| Some((t.moment.day?, clock.of(t.moment)?)))
        .collect();
    let (last, first) = (both.first()?, both.last()?);
    let (days, units) = (last.0 - first.0, last.1 - first.1);
    (days > 0.0 && units > 0.0 && clock != Clock::Day).then(|| days / units)
}

/// The first of several thresholds of a unit: samples of each, taken for independent.
fn joint(of: &[Told]) -> Option<Told> {
    if let Some(passed) = of.iter().find(|t| t.outlook.status == Status::Passed) {
        let o = &passed.outlook;
        let mut outlook = Outlook::refused(
            &o.actuator,
            o.tests,
            o.risk,
            format!("{}: {}", passed.threshold.fault, o.reason),
        );
        (outlook.status, outlook.at, outlook.used) = (Status::Passed, o.at, o.used);
        return Some(together(outlook, passed));
    }
    let told: Vec<(&Told, &Left)> = of.iter().filter_map(|t| Some((t, t.outlook.left.as_ref()?))).collect();
    if told.len() < 2 {
        return None;
    }
    let n = told.iter().map(|t| t.1.times.len()).min()?;
    // pairs by a fixed stride: every quantile of one meets all of the other
    let stride = |i: usize, k: usize| if k == 0 { i } else { (i * 149 + 37 * k) % n };
    let mut times: Vec<f64> = (0..n)
        .map(|i| {
            told.iter()
                .enumerate()
                .map(|(k, t)| t.1.times[stride(i, k)])
                .fold(f64::INFINITY, f64::min)
        })
        .collect();
    times.sort_by(f64::total_cmp);
    let first = told[0].0;
    let calibrated = told.iter().map(|t| t.1.calibrated).min().flatten();
    let rising = told.iter().all(|t| t.0.outlook.change.is_some());
    let reason = if rising {
        "the rates of all faults have changed: their lives are hardly independent"
    } else {
        ""
    };
    let horizon = told.iter().map(|t| t.1.horizon).fold(f64::INFINITY, f64::min);
    let left = Left::of(times, calibrated, horizon);
    let outlook = Outlook::joint(of.iter().map(|t| &t.outlook), left, &first.outlook, reason);
    Some(together(outlook, first))
}

/// What is told of all faults together; clock and events as of one of them.
fn together(outlook: Outlook, like: &Told) -> Told {
    Told {
        threshold: Threshold {
            fault: JOINT.into(),
            level: f64::NAN,
            healthy: None,
            margin: None,
        },
        scale: None,
        clock: like.clock,
        days: like.days,
        outlook,
        track: None,
        events: like.events.clone(),
    }
}
