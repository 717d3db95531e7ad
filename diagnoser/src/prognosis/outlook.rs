//! What is told of a unit: level, rate, law, change, the time left, and when to look again; or why not.

use super::fleet::{COVERAGE, Fleet, Left, without_fleet};
use super::forecast::quantile;
use super::history::{Ends, History, Scale};
use super::law::Family;
use super::prior::Prior;
use super::track::{Alarm, Change, Kind, Track};
use std::sync::Arc;

/// Located tests below which nothing is foretold.
pub const LEAST_TESTS: usize = 5;

/// Share of wrong tests of late above which the rows are not one unit's (assumed).
const SWINGS: f64 = 0.35;

/// A level that may well be passed.
const PASSED_SD: f64 = 1.0;

/// How much the outlook is worth.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Status {
    /// as promised
    Ok,
    /// with a reason to doubt
    Doubtful,
    /// too few tests
    TooEarly,
    /// the threshold is passed
    Passed,
    /// not told, for a reason
    Refused,
}

impl Status {
    /// Key of outputs.
    pub fn name(self) -> &'static str {
        match self {
            Self::Ok => "ok",
            Self::Doubtful => "doubtful",
            Self::TooEarly => "too_early",
            Self::Passed => "passed",
            Self::Refused => "refused",
        }
    }
}

/// What is asked.
#[derive(Clone, Debug)]
pub struct Question {
    /// scale of the fault
    pub scale: Scale,
    /// probability of passing the threshold that the user takes
    pub risk: f64,
    /// times ahead at which that probability is told [units of the clock]
    pub horizons: Vec<f64>,
}

/// The outlook of one unit and fault after its last test.
#[derive(Clone, Debug)]
pub struct Outlook {
    /// the unit
    pub actuator: String,
    /// how much it is worth
    pub status: Status,
    /// why it is doubtful or not told; empty where it is
    pub reason: String,
    /// rows of its history
    pub tests: usize,
    /// those that were read
    pub used: usize,
    /// last test [units of the clock]
    pub at: f64,
    /// level [unit of the fault], 95 %
    pub level: Option<Ends>,
    /// its growth [unit of the fault / unit of the clock], 95 %
    pub rate: Option<Ends>,
    /// mass by family of laws
    pub laws: Vec<(Family, f64)>,
    /// last change of the rate
    pub change: Option<Change>,
    /// time left [units of the clock]
    pub left: Option<Left>,
    /// probabilities of passing within the horizons
    pub p_fail: Vec<(f64, f64)>,
    /// probability that the threshold is not passed within what was looked at
    pub p_never: Option<f64>,
    /// look again by [units of the clock]
    pub next_test: Option<f64>,
    /// probability of having passed reaches the risk [units of the clock]
    pub next_inspection: Option<f64>,
    /// the risk
    pub risk: f64,
    /// all alarms
    pub alarms: Vec<Alarm>,
    /// repairs that were recorded or found
    pub repairs: u32,
}

impl Outlook {
    /// Nothing is told, for a reason that stands before any filter.
    pub fn refused(actuator: &str, tests: usize, risk: f64, reason: String) -> Self {
        Self {
            actuator: actuator.into(),
            status: Status::Refused,
            reason,
            tests,
            used: 0,
            at: f64::NAN,
            level: None,
            rate: None,
            laws: Vec::new(),
            change: None,
            left: None,
            p_fail: Vec::new(),
            p_never: None,
            next_test: None,
            next_inspection: None,
            risk,
            alarms: Vec::new(),
            repairs: 0,
        }
    }

    /// Several faults of one unit: what is left before the first of their thresholds.
    /// * `like` one of them, whose times ahead and last test it takes
    pub fn joint<'a>(of: impl Iterator<Item = &'a Outlook>, left: Left, like: &Outlook, reason: &str) -> Self {
        let mut out = Self::refused(&like.actuator, like.tests, like.risk, reason.into());
        let parts: Vec<&Outlook> = of.collect();
        let doubtful = parts.iter().any(|o| o.status != Status::Ok) || !reason.is_empty();
        out.status = if doubtful { Status::Doubtful } else { Status::Ok };
        if let Some(o) = parts.iter().find(|o| !o.reason.is_empty()) {
            out.reason = o.reason.clone();
        }
        (out.used, out.at) = (like.used, like.at);
        let horizons: Vec<f64> = like.p_fail.iter().map(|p| p.0).collect();
        let interval = like.next_test.map_or(1.0, |t| t - like.at);
        out.leave(left, &horizons, interval);
        out
    }

    /// Takes what is left, and what follows from it.
    /// * `interval` usual time between two tests
    fn leave(&mut self, left: Left, horizons: &[f64], interval: f64) {
        self.p_fail = horizons.iter().map(|h| (*h, left.within(*h))).collect();
        self.p_never = Some(left.within(f64::INFINITY) - left.within(f64::MAX));
        let safe = quantile(&left.times, self.risk).min(left.horizon);
        self.next_inspection = Some(self.at + safe);
        self.next_test = Some(self.at + (safe / 3.0).max(interval.min(safe)));
        self.left = Some(left);
    }

    /// Median and interval of the time left; infinite where it is never.
    pub fn rul(&self) -> Option<Ends> {
        let l = self.left.as_ref()?;
        Some((l.interval.0, l.interval.1, quantile(&l.times, 0.5)))
    }
}

/// Reads a whole history, and tells what is left; the track is what tables and figures are made of.
pub fn outlook(history: &History, question: &Question, fleet: Option<&Fleet>) -> (Outlook, Track) {
    let prior = match fleet {
        Some(f) => f.prior.clone(),
        None => Prior::shipped(history.interval().unwrap_or(1.0)),
    };
    let mut track = Track::new(Arc::new(prior), question.scale);
    track.read_all(history);
    (told(history, question, fleet, &mut track), track)
}

/// What is told of a track after its last test. An alarm of the risk is added to it.
pub fn told(history: &History, question: &Question, fleet: Option<&Fleet>, track: &mut Track) -> Outlook {
    let (status, reason) = judged(history, track);
    let mut out = Outlook {
        status,
        used: track.used,
        at: track.at,
        change: track.change,
        repairs: track.trends.last().map_or(0, |t| t.segment),
        ..Outlook::refused(&history.actuator, track.trends.len(), question.risk, reason)
    };
    if let (Some(now), true) = (track.trends.last(), status != Status::Refused && track.used > 0) {
        out.level = Some(question.scale.level_of(now.damage));
        out.rate = Some(question.scale.rate_of(now.log_rate));
        out.laws = Family::ALL.into_iter().zip(track.filter.families()).collect();
    }
    if matches!(status, Status::Ok | Status::Doubtful) {
        let left = fleet.map_or_else(|| without_fleet(track), |f| f.left(track));
        let interval = track.filter.prior().interval;
        let soon = left.within(interval);
        if soon > question.risk {
            let text = format!("P(threshold within {interval:.3}, the usual time to the next test) is {soon:.3}");
            track.alarms.push(Alarm {
                kind: Kind::Risk,
                at: track.at,
                probability: soon,
                since: (track.at, track.at),
                text,
            });
        }
        out.leave(left, &question.horizons, interval);
    }
    out.alarms.clone_from(&track.alarms);
    out
}

/// Whether anything can be told, and why not.
fn judged(history: &History, track: &Track) -> (Status, String) {
    if history.conflicting >= 2 {
        let n = history.conflicting;
        let why = format!("{n} pairs of tests at the same time contradict each other: two units under one name?");
        return (Status::Refused, why);
    }
    if track.wrong_share() > SWINGS && track.used >= LEAST_TESTS {
        return (
            Status::Refused,
            "the level swings between tests: two units under one name?".into(),
        );
    }
    if track.used < LEAST_TESTS {
        return (
            Status::TooEarly,
            format!("{} tests with an interval; allowed: at least {LEAST_TESTS}", track.used),
        );
    }
    let (x, sd) = track.filter.damage();
    if x > 1.0 - PASSED_SD * sd {
        return (Status::Passed, "the threshold is passed".into());
    }
    if track.since_repair < LEAST_TESTS {
        let n = track.since_repair;
        return (
            Status::TooEarly,
            format!("{n} tests with an interval since the last repair; allowed: at least {LEAST_TESTS}"),
        );
    }
    if let Some(why) = track.another_defect() {
        return (Status::Doubtful, why);
    }
    (Status::Ok, String::new())
}

/// What the interval of the time left promises.
pub fn promise(left: &Left) -> String {
    let percent = 100.0 * COVERAGE;
    match left.calibrated {
        Some(lives) => format!(
            "{percent:.0} %, calibrated on {lives} lives: 9 of 10 units, over the mix of times at which it is asked"
        ),
        None => format!("{percent:.0} %, design figure, not calibrated"),
    }
}
