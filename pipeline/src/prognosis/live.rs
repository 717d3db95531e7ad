//! What a live view foretells: outlooks of a history, carried on by the diagnoses that come.

use super::read::{Sheet, Test, Units};
use super::{Asked, Clock, Events, JOINT, Told, clock_of, outlooks};
use anyhow::Result;
use diagnoser::live::Foretold;
use diagnoser::prognosis::special::middle;
use diagnoser::prognosis::{Fleet, Status};
use diagnoser::receive::foresight::Foresight;
use std::collections::BTreeMap;

/// A history as it grows.
struct Growing {
    units: Units,
    events: Events,
    asked: Asked,
    fleets: Vec<Fleet>,
    clock: Clock,
}

/// Foretells from a history.
///
/// # Errors
/// As [`Sheet::history`] and [`outlooks`].
pub fn foresight(sheet: &Sheet, events: Events, mut asked: Asked, fleets: Vec<Fleet>) -> Result<Foresight> {
    let units = sheet.history(&asked.faults())?;
    let all: Vec<(&String, &Vec<Test>)> = units.iter().collect();
    let clock = clock_of(sheet.file(), &all, &events, &asked, fleets.first())?;
    asked.clock = Some(clock);
    let told = outlooks(sheet.file(), &units, &events, &asked, &fleets)?;
    let mut first: BTreeMap<String, Foretold> = BTreeMap::new();
    for one in told.chunk_by(|a, b| a.outlook.actuator == b.outlook.actuator) {
        first.extend(soonest(one));
    }
    let mut growing = Growing {
        units,
        events,
        asked,
        fleets,
        clock,
    };
    Ok(Foresight::new(first, move |logged| {
        // as the log has it: read by the reader of logs
        growing.add(&logged.to_json().to_string()).ok().flatten()
    }))
}

impl Growing {
    /// A line of a log: what is foretold with it; none where it is of a test that is in the history.
    fn add(&mut self, line: &str) -> Result<Option<(String, Foretold)>> {
        let new = self.asked.prepared(Sheet::of_lines("live", line)?)?;
        let new = new.history(&self.asked.faults())?;
        let Some((name, mut tests)) = new.into_iter().next() else {
            return Ok(None);
        };
        let known = self.units.entry(name.clone()).or_default();
        let Some(mut test) = tests.pop() else { return Ok(None) };
        if known
            .iter()
            .any(|t| t.moment.day.is_some() && t.moment.day == test.moment.day)
        {
            return Ok(None);
        }
        if self.clock.of(test.moment).is_none() {
            // a stream counts no flights: as many as between the tests before (assumed)
            let counts: Vec<f64> = known.iter().filter_map(|t| t.moment.cycle).collect();
            let apart = middle(counts.windows(2).map(|w| w[1] - w[0]).filter(|d| *d > 0.0).collect());
            let last = counts.iter().copied().fold(0.0, f64::max);
            test.moment.cycle = Some(last + apart.unwrap_or(1.0));
        }
        known.push(test);
        let one = Units::from([(name.clone(), known.clone())]);
        Ok(soonest(&outlooks(
            "live",
            &one,
            &self.events,
            &self.asked,
            &self.fleets,
        )?))
    }
}

/// Of one actuator's faults that whose life ends first: passed, then by the lower end.
fn soonest(told: &[Told]) -> Option<(String, Foretold)> {
    let single = told.iter().filter(|t| t.threshold.fault != JOINT);
    let key = |t: &&Told| {
        let left = t.outlook.rul().map_or(f64::INFINITY, |r| r.0);
        if t.outlook.status == Status::Passed { -1.0 } else { left }
    };
    let t = single.min_by(|a, b| key(a).total_cmp(&key(b)))?;
    let o = &t.outlook;
    let foretold = Foretold {
        fault: t.threshold.fault.clone(),
        rate: o.rate.map(|r| r.2),
        left: o.rul(),
        clock: t.clock.name(),
        status: o.status.name().replace('_', " "),
    };
    Some((o.actuator.clone(), foretold))
}
