//! One unit and fault, test by test: repairs, changes, alarms, and the trend that tables show.

use super::filter::{Filter, OLD, Reading};
use super::history::{Ended, Happening, History, Row, Scale};
use super::law::Family;
use super::prior::Prior;
use super::similar::Life;
use super::special::{greatest, middle};
use std::sync::Arc;

/// A fall of the level that is a repair: standard deviations, and share of the damage, in two tests (assumed).
const FALL_SD: f64 = 8.0;
const FALL_SHARE: f64 = 0.1;

/// Damage below which there is nothing to repair: a fall from there is two wrong tests, however rare they are (assumed)
/// [share of U].
const WORN: f64 = 0.05;

/// Spread of the damage where nothing is known of it: of a unit that comes new, and after a repair [share of U].
const UNKNOWN: f64 = 0.3;

/// A unit whose first damage is below this is taken for new [share of U].
const NEW: f64 = 0.1;

/// Tests whose median damage is where the unit began.
const FIRST: usize = 5;

/// Growth that counts as onset, at least [share of U], and in standard deviations of a test.
const ONSET: f64 = 0.02;
const ONSET_SD: f64 = 8.0;

/// A change of the rate: by this factor, with this probability, and after a growth of so much [share of U; standard
/// deviations of a test].
const CHANGED: f64 = 1.5;
const CERTAIN: f64 = 0.9;
const CHANGED_GROWTH: f64 = 0.01;
const CHANGED_SD: f64 = 6.0;

/// Unexplained tests of the last 20 that are an alarm: more than so many, a fifth.
const OFTEN: usize = 4;

/// A jump of otherwise even wear [share of U].
const JUMP: f64 = 0.05;

/// What is alarming.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// wear has begun
    Onset,
    /// the rate has changed
    RateChange,
    /// wear has jumped
    Jump,
    /// the level has fallen, and nobody told why
    UnrecordedRepair,
    /// other defects, again and again
    UnexplainedRun,
    /// the threshold is passed
    ThresholdPassed,
    /// the threshold may be passed before the next test
    Risk,
}

impl Kind {
    /// Key of outputs.
    pub fn name(self) -> &'static str {
        match self {
            Self::Onset => "onset",
            Self::RateChange => "rate_change",
            Self::Jump => "jump",
            Self::UnrecordedRepair => "unrecorded_repair",
            Self::UnexplainedRun => "unexplained_run",
            Self::ThresholdPassed => "threshold_passed",
            Self::Risk => "risk",
        }
    }
}

/// One alarm.
#[derive(Clone, Debug, PartialEq)]
pub struct Alarm {
    /// what
    pub kind: Kind,
    /// test that raised it [units of the clock]
    pub at: f64,
    /// how probable it is
    pub probability: f64,
    /// since when: earliest and latest [units of the clock]
    pub since: (f64, f64),
    /// in words
    pub text: String,
}

/// What became of a test.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Used {
    /// it was read
    Update,
    /// it was read as a bound
    Censored,
    /// it was read, and is most probably wrong
    Outlier,
    /// it says nothing of this fault
    Nothing,
}

impl Used {
    /// Key of outputs.
    pub fn name(self) -> &'static str {
        match self {
            Self::Update => "update",
            Self::Censored => "censored",
            Self::Outlier => "outlier",
            Self::Nothing => "none",
        }
    }
}

/// What is believed after one test.
#[derive(Clone, Copy, Debug)]
pub struct Trend {
    /// when [units of the clock]
    pub at: f64,
    /// how the test ended
    pub ended: Ended,
    /// what became of it
    pub used: Used,
    /// damage: mean and standard deviation [share of U]
    pub damage: (f64, f64),
    /// logarithm of its growth: mean and standard deviation [1 / unit of the clock]
    pub log_rate: (f64, f64),
    /// innovation [standard deviations]
    pub innovation: f64,
    /// probability that the regime has changed of late
    pub changed: f64,
    /// most probable family of laws
    pub law: Family,
    /// how many repairs there were before
    pub segment: u32,
}

/// A change of the rate.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Change {
    /// when, most probably [units of the clock]
    pub at: f64,
    /// earliest and latest
    pub since: (f64, f64),
    /// how probable
    pub probability: f64,
    /// new rate over old one
    pub factor: f64,
}

/// A unit and fault up to some test.
#[derive(Clone, Debug)]
pub struct Track {
    /// the filter after the last test
    pub filter: Filter,
    /// scale of the fault
    pub scale: Scale,
    /// when the last test was [units of the clock]
    pub at: f64,
    /// a row a test
    pub trends: Vec<Trend>,
    /// all alarms so far
    pub alarms: Vec<Alarm>,
    /// the last change of the rate
    pub change: Option<Change>,
    /// damage since new or since the last repair
    pub life: Life,
    /// tests that were read, since the beginning
    pub used: usize,
    /// tests that were read since the last repair
    pub since_repair: usize,
    /// mean of the stated standard uncertainty of late [share of U]
    pub stated: f64,
    begun: f64,
    /// time, damage and logarithm of the rate after each update
    updates: Vec<(f64, f64, f64)>,
    first: Vec<f64>,
    /// damage at the beginning of the life, once enough tests have seen it
    start: Option<f64>,
    onset: bool,
    /// a fall that one test has seen: when, the damage then, the bound that it fell below, the damage before
    suspect: Option<(f64, f64, f64, f64)>,
    segment: u32,
    wrong: f64,
    next_event: usize,
    told: Option<Told>,
}

/// What the events told last, and how the unit stood before.
#[derive(Clone, Copy, Debug)]
struct Told {
    at: f64,
    /// logarithm of the rate
    rate: f64,
    /// damage
    x: f64,
}

impl Track {
    /// A unit before its first test.
    pub fn new(prior: Arc<Prior>, scale: Scale) -> Self {
        Self {
            filter: Filter::new(prior, 0.0, UNKNOWN),
            scale,
            at: f64::NAN,
            trends: Vec::new(),
            alarms: Vec::new(),
            change: None,
            life: Life::default(),
            used: 0,
            since_repair: 0,
            stated: 0.0,
            begun: 0.0,
            updates: Vec::new(),
            first: Vec::new(),
            start: None,
            onset: false,
            suspect: None,
            segment: 0,
            wrong: 0.0,
            next_event: 0,
            told: None,
        }
    }

    /// Reads the row `i` of a history, and what happened before it.
    pub fn read(&mut self, history: &History, i: usize) {
        let row = &history.rows[i];
        while let Some(&(at, what)) = history.events.get(self.next_event)
            && at <= row.at
        {
            self.next_event += 1;
            if what != Happening::Repair && !self.at.is_nan() {
                let (rate, x) = (self.filter.log_rate().0, self.filter.damage().0);
                self.told = Some(Told { at, rate, x });
            }
            match what {
                _ if self.at.is_nan() => {}
                Happening::Repair => {
                    self.filter.repaired(0.0, UNKNOWN);
                    self.filter.rebirth(0.3);
                    self.restart(at);
                }
                Happening::Change => self.filter.told(),
                Happening::Loss => self.filter.lost(),
            }
        }
        self.test(row);
    }

    /// All rows of a history.
    pub fn read_all(&mut self, history: &History) {
        for i in 0..history.rows.len() {
            self.read(history, i);
        }
    }

    /// Share of the tests of late that were most probably wrong: two units under one name swing between two levels.
    pub fn wrong_share(&self) -> f64 {
        self.wrong
    }

    /// Where too many tests of late have found another defect: that, in words.
    pub fn another_defect(&self) -> Option<String> {
        let found = |t: &&Trend| t.ended == Ended::Unexplained;
        let late = self.trends.iter().rev().take(20).filter(found).count();
        let three = self.trends.iter().rev().take(3).filter(found).count() == 3;
        (three || late > OFTEN).then(|| format!("{late} of the last 20 tests are unexplained: another defect may grow"))
    }

    /// The group of wears that a fleet's lessons go by.
    pub fn group(&self) -> usize {
        greatest(&self.filter.groups())
    }

    /// Whether the unit was new, or had just been repaired, when its life began to be seen.
    pub fn is_from_new(&self) -> bool {
        self.life.x.first().is_some_and(|x| *x < NEW)
    }

    /// When the present life began [units of the clock].
    pub fn begun(&self) -> f64 {
        self.begun
    }

    fn restart(&mut self, at: f64) {
        self.begun = at;
        self.life = Life::default();
        self.first.clear();
        self.start = None;
        self.onset = false;
        self.told = None;
        self.change = None;
        self.since_repair = 0;
        self.segment += 1;
    }

    fn test(&mut self, row: &Row) {
        let reading = self.scale.reading(row);
        let dt = if self.at.is_nan() {
            self.begun = row.at;
            0.0
        } else {
            (row.at - self.at).max(0.0)
        };
        self.at = row.at;
        let used = match reading {
            None => {
                self.filter.step(dt, None);
                Used::Nothing
            }
            Some(Reading::Above(_)) => {
                self.filter.step(dt, reading);
                Used::Censored
            }
            Some(Reading::Damage { y, sd, .. }) => {
                self.stated += (sd - self.stated) / (self.used as f64 + 1.0).min(20.0);
                self.damage(row, dt, y, sd, reading)
            }
        };
        let (damage, log_rate) = (self.filter.damage(), self.filter.log_rate());
        if used != Used::Nothing && !(used == Used::Outlier && self.suspect.is_some()) {
            self.used += 1;
            self.since_repair += 1;
            self.noted(damage.0, log_rate.0);
        }
        self.trends.push(Trend {
            at: row.at,
            ended: row.ended,
            used,
            damage,
            log_rate,
            innovation: if used == Used::Update {
                self.filter.innovation
            } else {
                f64::NAN
            },
            changed: self.young().0,
            law: Family::ALL[greatest(&self.filter.families())],
            segment: self.segment,
        });
        self.alarmed(row, reading);
    }

    /// A level: a fall in two tests is a repair, in one a wrong diagnosis.
    fn damage(&mut self, row: &Row, dt: f64, y: f64, sd: f64, reading: Option<Reading>) -> Used {
        let (x, px) = self.filter.damage();
        let bound = x - (FALL_SD * px.hypot(sd)).max(FALL_SHARE * x);
        // the second test of a fall is held against what was before it
        let is_worn = self.suspect.map_or(x, |s| s.3) > WORN;
        if self.since_repair >= 3 && is_worn && y < self.suspect.map_or(bound, |s| s.2) {
            self.wrong += (1.0 - self.wrong) * 0.1;
            let Some((at, level, _, x)) = self.suspect.take() else {
                self.suspect = Some((row.at, y, bound, x));
                self.filter.step(dt, None);
                return Used::Outlier;
            };
            let before = self.updates.last().map_or(at, |u| u.0);
            self.filter.repaired(level, UNKNOWN.min(10.0 * sd.max(0.002)));
            // back to where it was before a test that was wrong, and was believed
            let back = |u: &(f64, f64, f64)| (u.1 - y).abs() < 0.25 * (x - y);
            if self.updates.iter().rev().skip(1).take(2).any(back) {
                self.filter.step(row.at - at, reading);
                self.life.forget_above(y);
                return Used::Update;
            }
            self.filter.rebirth(0.3);
            self.filter.step(row.at - at, reading);
            self.restart(before.max(at - self.filter.prior().interval));
            let text = format!(
                "the level fell from {:.4} to {:.4}, and no event says why",
                self.scale.level(x),
                self.scale.level(y)
            );
            self.alarm(Kind::UnrecordedRepair, 0.99, (before, at), text);
            return Used::Update;
        }
        self.suspect = None;
        self.filter.step(dt, reading);
        self.wrong += (self.filter.wrong - self.wrong) * 0.1;
        if self.filter.wrong > 0.5 {
            Used::Outlier
        } else {
            Used::Update
        }
    }

    fn noted(&mut self, x: f64, log_rate: f64) {
        self.life.push(self.at - self.begun, x);
        self.updates.push((self.at, x, log_rate));
        if self.first.len() < FIRST {
            self.first.push(x);
            if self.first.len() == FIRST {
                self.start = middle(self.first.clone());
            }
        }
    }

    /// Mass of regimes that began of late, and when they did: mean, earliest, latest update.
    fn young(&self) -> (f64, f64, u32, u32) {
        let now = self.filter.updates;
        let is_young = |b: u32| b > 0 && now - b <= OLD;
        let (mut mass, mut at, mut lo, mut hi) = (0.0, 0.0, u32::MAX, 0);
        for c in self.filter.components.iter().filter(|c| is_young(c.born)) {
            mass += c.weight;
            at += c.weight * f64::from(c.born);
            if c.weight > 0.02 {
                (lo, hi) = (lo.min(c.born), hi.max(c.born));
            }
        }
        (mass, if mass > 0.0 { at / mass } else { 0.0 }, lo.min(now), hi)
    }

    fn alarm(&mut self, kind: Kind, probability: f64, since: (f64, f64), text: String) {
        self.alarms.push(Alarm {
            kind,
            at: self.at,
            probability,
            since,
            text,
        });
    }

    fn alarmed(&mut self, row: &Row, reading: Option<Reading>) {
        if row.ended == Ended::Unexplained {
            let again = self.alarms.iter().rev().find(|a| a.kind == Kind::UnexplainedRun);
            let quiet = again.is_none_or(|a| self.trends.iter().rev().take(20).all(|t| t.at > a.at));
            if let (true, Some(text)) = (quiet, self.another_defect()) {
                self.alarm(Kind::UnexplainedRun, 1.0, (row.at, row.at), text);
            }
            return;
        }
        let (Some(&(_, x, rate)), Some(start)) = (self.updates.last(), self.start) else {
            return;
        };
        if self.suspect.is_some() {
            return;
        }
        self.changed_as_told(x);
        let noise = self.stated;
        let bound = ONSET.max(ONSET_SD * noise);
        let before = self.updates.iter().rev().nth(1).map_or(x, |u| u.1);
        // seen by this test as well as believed: a wrong one before it raises what is believed
        let seen = !matches!(reading, Some(Reading::Damage { y, .. }) if y - start <= bound);
        if !self.onset && seen && x - start > bound && before - start > bound {
            self.onset = true;
            if start < NEW {
                // the last test at which nothing had grown yet
                let quiet = self
                    .updates
                    .iter()
                    .rev()
                    .find(|u| u.1 - start < 0.3 * bound)
                    .map_or(row.at, |u| u.0);
                let text = format!(
                    "{:.4} at first, {:.4} now",
                    self.scale.level(start),
                    self.scale.level(x)
                );
                self.alarm(Kind::Onset, 0.99, (quiet, row.at), text);
            }
            return;
        }
        if self.onset {
            self.changed(x, rate, noise);
            self.jumped(x, noise);
        }
        if x > 1.0 && before > 1.0 && !self.alarms.iter().any(|a| a.kind == Kind::ThresholdPassed) {
            let text = format!("{:.4}, the threshold is {}", self.scale.level(x), self.scale.threshold);
            self.alarm(Kind::ThresholdPassed, 0.99, (row.at, row.at), text);
        }
    }

    fn changed(&mut self, x: f64, rate: f64, noise: f64) {
        let (mass, born, lo, hi) = self.young();
        if mass < CERTAIN {
            return;
        }
        let offset = self.filter.updates as usize - self.updates.len().min(self.filter.updates as usize);
        let at = |u: f64| self.updates.get((u as usize).saturating_sub(offset + 1)).copied();
        let Some((t, x0, before)) = at(born) else { return };
        if self
            .change
            .is_some_and(|c| t - c.at < 0.5 * f64::from(OLD) * self.filter.prior().interval)
        {
            return;
        }
        let factor = (rate - before).exp();
        let grown = x - x0 > CHANGED_GROWTH.max(CHANGED_SD * noise);
        let is_worn = x0 > ONSET.max(3.0 * noise);
        if grown && is_worn && !(1.0 / CHANGED..=CHANGED).contains(&factor) {
            let since = (
                at(f64::from(lo)).map_or(t, |u| u.0),
                at(f64::from(hi)).map_or(t, |u| u.0),
            );
            self.change = Some(Change {
                at: t,
                since,
                probability: mass,
                factor,
            });
            let text = format!("at {}, rate x {factor:.1}", (t * 1e3).round() / 1e3);
            self.alarm(Kind::RateChange, mass, since, text);
        }
    }

    /// Where the events say that something was done, less growth is enough: tests of it, standard deviations of a test.
    fn changed_as_told(&mut self, x: f64) {
        const TESTS: usize = 3;
        const SD: f64 = 3.0;
        let Some(t) = self.told else { return };
        let since = self.updates.iter().filter(|u| u.0 >= t.at).count();
        let bound = t.rate + CHANGED.ln();
        let faster = self.filter.above_log_rate(bound);
        if since < TESTS || x - t.x < SD * self.stated || faster < CERTAIN {
            return;
        }
        self.told = None;
        let factor = (self.filter.log_rate().0 - t.rate).exp();
        let since = (t.at, t.at);
        self.change = Some(Change {
            at: t.at,
            since,
            probability: faster,
            factor,
        });
        let text = format!(
            "at {}, as the events told, rate x {factor:.1}",
            (t.at * 1e3).round() / 1e3
        );
        self.alarm(Kind::RateChange, faster, since, text);
    }

    fn jumped(&mut self, x: f64, noise: f64) {
        let groups = self.filter.groups();
        let n = self.updates.len();
        if n < 12 || groups[0] + groups[1] < 0.8 {
            return;
        }
        // over the last two tests, beside what ten tests before them took
        let (now, before, old) = (self.updates[n - 1], self.updates[n - 3], self.updates[n - 12]);
        let usual = (before.1 - old.1).max(0.0) / (before.0 - old.0).max(1e-12) * (now.0 - before.0);
        // both tests have seen it
        let jump = x.min(self.updates[n - 2].1) - before.1 - usual;
        let last = self
            .alarms
            .iter()
            .rev()
            .find(|a| a.kind == Kind::Jump)
            .map_or(f64::NEG_INFINITY, |a| a.at);
        if jump > JUMP.max(8.0 * noise).max(6.0 * usual) && last < before.0 {
            let text = format!(
                "from {:.4} to {:.4} within two tests",
                self.scale.level(before.1),
                self.scale.level(x)
            );
            self.alarm(Kind::Jump, 0.95, (before.0, now.0), text);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(levels: &[(f64, f64)], sd: f64, events: Vec<(f64, Happening)>) -> Track {
        let row = |&(at, x): &(f64, f64)| Row {
            at,
            ended: Ended::Located,
            lo: Some(x - 1.96 * sd),
            hi: Some(x + 1.96 * sd),
            estimate: Some(x),
            coverage: 0.95,
        };
        let history = History::new("a".into(), levels.iter().map(row).collect(), events);
        let scale = Scale {
            healthy: 0.0,
            threshold: 1.0,
            range: None,
        };
        let mut track = Track::new(Arc::new(Prior::shipped(1.0)), scale);
        track.read_all(&history);
        track
    }

    /// Noise of one standard deviation or so, the same everywhere.
    fn noise(i: usize) -> f64 {
        ((i as f64 * 12.9898).sin() * 43_758.545_3).rem_euclid(1.0) * 3.4 - 1.7
    }

    #[test]
    fn what_is_not_worn_is_not_repaired() {
        let healthy = |i: usize| (i as f64, 0.01 + 0.001 * noise(i));
        let mut levels: Vec<_> = (0..120).map(healthy).collect();
        (levels[60].1, levels[61].1) = (-0.09, -0.09);
        let track = read(&levels, 0.001, vec![]);
        assert!(track.alarms.is_empty(), "{:?}", track.alarms);
        // a worn one is
        let worn = |i: usize| (i as f64, 0.005 * (i % 80) as f64 + 0.001 * noise(i));
        let track = read(&(0..120).map(worn).collect::<Vec<_>>(), 0.001, vec![]);
        assert!(
            track
                .alarms
                .iter()
                .any(|a| a.kind == Kind::UnrecordedRepair && a.at <= 82.0)
        );
    }

    /// Coarse tests, and few of them after a lubricant was lost: what grew before anybody could say is believed sooner where the
    /// events tell of it.
    #[test]
    fn a_loss_that_is_told_is_followed_sooner() {
        let level = |i: usize| {
            let after = (i as f64 - 40.0).max(0.0);
            (i as f64, 0.03 * after + 0.03 * noise(i))
        };
        let levels: Vec<_> = (0..46).map(level).collect();
        let told = read(&levels, 0.03, vec![(40.0, Happening::Loss)]);
        let silent = read(&levels, 0.03, vec![]);
        let alarm = told.alarms.iter().find(|a| a.kind == Kind::RateChange);
        assert!(
            alarm.is_some_and(|a| a.at <= 45.0 && a.probability > 0.9),
            "{:?}",
            told.alarms
        );
        assert!(!silent.alarms.iter().any(|a| a.kind == Kind::RateChange));
        assert!(told.filter.log_rate().0 > silent.filter.log_rate().0);
    }
}
