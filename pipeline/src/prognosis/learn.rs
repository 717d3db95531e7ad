//! What a fleet teaches: its prior, its lives, the calibration of its forecasts.

use super::read::{End, Test};
use super::{Clock, Events, Threshold, history_of, of_unit, scale_of};
use crate::Interrupted;
use crate::progress::interrupted;
use anyhow::Result;
use diagnoser::prognosis::fleet::{Gathered, Shot, is_compared, shot, without_fleet};
use diagnoser::prognosis::forecast::quantile;
use diagnoser::prognosis::special::middle;
use diagnoser::prognosis::{Fleet, History, Life, Prior, Scale, Track};
use rayon::prelude::*;
use schemas::error::{Error, write_whole};
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;

/// Past forecasts of each life: at so many tests, evenly over it.
const FORECASTS: usize = 12;

/// Points of a life that a fleet's file keeps.
const POINTS: usize = 60;

/// Finished lives from which shares and calibration are learned at most; the others enter the prior.
const MOST_LIVES: usize = 400;

/// A life whose last level is this share of the threshold's damage, and which is forecast to end within this share of
/// its age, ended there: tests stop before the end that nobody recorded.
const NEARLY: f64 = 0.95;
const AT_ONCE: f64 = 0.02;

/// A unit of the fleet, as far as its end is known.
pub struct Unit {
    /// its tests up to the end
    pub history: History,
    /// scale of its fault
    pub scale: Scale,
    /// when the life ended [units of the clock]
    pub end: Option<f64>,
}

/// How the ends of lives were known.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Ends {
    /// by a file of truths
    pub told: usize,
    /// by a test beyond the threshold
    pub crossed: usize,
    /// extrapolated from the last test
    pub extrapolated: usize,
    /// still alive, or taken out before
    pub alive: usize,
}

/// Units of a fault with their ends.
pub fn units_of(
    all: &[(String, Vec<Test>)],
    events: &Events,
    truths: &BTreeMap<String, Vec<End>>,
    (t, index): (&Threshold, usize),
    clock: Clock,
) -> Vec<Unit> {
    let of = |(name, tests): &(String, Vec<Test>)| {
        let mut history = history_of(name, tests, of_unit(events, name), (&t.fault, index), clock).ok()?;
        let scale = scale_of(&history, t)?;
        let mine = truths.get(name).into_iter().flatten();
        let of_fault =
            |e: &&End| e.event.is_empty() || e.event.to_lowercase().contains(&t.fault) || !e.event.contains('>');
        let end = mine
            .filter(of_fault)
            .filter_map(|e| clock.of(e.moment))
            .reduce(f64::min);
        if let Some(end) = end {
            history.rows.retain(|r| r.at <= end);
        }
        Some(Unit { history, scale, end })
    };
    all.iter()
        .filter_map(of)
        .filter(|u| !u.history.rows.is_empty())
        .collect()
}

/// Learns one fault of a fleet.
///
/// # Errors
/// Interrupted.
pub fn learn(units: &[Unit], t: &Threshold, clock: Clock) -> Result<(Fleet, Ends)> {
    let intervals = units.iter().filter_map(|u| u.history.interval()).collect();
    let shipped = Prior::shipped(middle(intervals).unwrap_or(1.0));
    let first = Arc::new(shipped.clone());
    let tracks: Vec<Track> = units
        .par_iter()
        .map(|u| {
            let mut track = Track::new(first.clone(), u.scale);
            (!interrupted()).then(|| track.read_all(&u.history));
            track
        })
        .collect();
    let mut gathered = Gathered::new(&shipped);
    let (mut ends, mut lives, mut ages) = (Ends::default(), Vec::new(), Vec::new());
    for (i, (u, track)) in units.iter().zip(&tracks).enumerate() {
        gathered.add(&track.filter);
        let (end, how) = end_of(u, track);
        *match how {
            How::Told => &mut ends.told,
            How::Crossed => &mut ends.crossed,
            How::Extrapolated => &mut ends.extrapolated,
            How::Alive => &mut ends.alive,
        } += 1;
        if track.is_from_new() {
            // an end that is extrapolated was not seen
            let seen = end.filter(|_| !matches!(how, How::Extrapolated));
            ages.push((seen.unwrap_or(track.at) - track.begun(), seen.is_some()));
        }
        // a life that began before it was seen says nothing of how long lives are
        if let (Some(end), true) = (end, track.is_from_new()) {
            let life = track.life.thinned(POINTS);
            let last = life.t.last().copied().unwrap_or(0.0);
            lives.push((
                i,
                end,
                Life {
                    end: Some((end - track.begun()).max(last)),
                    ..life
                },
            ));
        }
    }
    if interrupted() {
        return Err(Interrupted.into());
    }
    let finished: Vec<(usize, f64, Life)> = thinned(lives);
    let prior = Arc::new(gathered.prior(&shipped));
    let unseen = unseen(ages);
    // past forecasts weigh the comparison with lives
    let replayed = if is_compared(finished.len(), unseen) {
        &finished[..]
    } else {
        &[]
    };
    let shots: Vec<Shot> = replayed
        .par_iter()
        .flat_map_iter(|(i, end, _)| {
            let others = || finished.iter().filter(move |o| o.0 != *i).map(|o| &o.2);
            past(&units[*i], *i, *end, &prior, &tracks[*i], others)
        })
        .collect();
    if interrupted() {
        return Err(Interrupted.into());
    }
    let censored = units.len() - finished.len();
    let lives = finished.into_iter().map(|f| f.2).collect();
    let prior = prior.as_ref().clone();
    let f = Fleet::learned(
        &t.fault,
        t.healthy,
        t.level,
        clock.name(),
        prior,
        (lives, censored, unseen),
        &shots,
    );
    Ok((f, ends))
}

/// Least share of the units that is still tested where an end counts (assumed): the last few decide nothing.
const AT_RISK: f64 = 0.05;

/// Share of lives that is longer than any that ended, by the product limit of Kaplan and Meier (1958).
///
/// * `ages` at the end, or at the last test; whether the end was seen
fn unseen(mut ages: Vec<(f64, bool)>) -> f64 {
    // an end comes before the last test of another at the same age
    ages.sort_by(|a, b| a.0.total_cmp(&b.0).then(b.1.cmp(&a.1)));
    let n = ages.len();
    let at_risk = |i: usize| (n - i) as f64;
    let few = if ages.iter().all(|a| a.1) {
        0.0
    } else {
        AT_RISK * n as f64
    };
    let ended = ages.iter().enumerate().filter(|(i, a)| a.1 && at_risk(*i) >= few);
    ended.fold(1.0, |s, (i, _)| s * (1.0 - 1.0 / at_risk(i)))
}

/// At most [`MOST_LIVES`] of the lives, evenly.
fn thinned(lives: Vec<(usize, f64, Life)>) -> Vec<(usize, f64, Life)> {
    let step = lives.len().div_ceil(MOST_LIVES).max(1);
    lives.into_iter().step_by(step).collect()
}

/// Forecasts that would have been made of a unit over its last life.
fn past<'a, I: Iterator<Item = &'a Life>>(
    u: &Unit,
    unit: usize,
    end: f64,
    prior: &Arc<Prior>,
    whole: &Track,
    others: impl Fn() -> I,
) -> Vec<Shot> {
    let begun = whole.begun();
    let mut track = Track::new(prior.clone(), u.scale);
    let mut out = Vec::new();
    let mut next = 0;
    for i in 0..u.history.rows.len() {
        if interrupted() {
            break;
        }
        let at = u.history.rows[i].at;
        let share = |k: usize| begun + (k as f64 + 0.5) / FORECASTS as f64 * (end - begun);
        // the last test before each of the moments
        while next < FORECASTS && at > share(next) {
            if i > 0 && track.since_repair > 0 && track.at >= begun {
                out.push(shot(unit, &track, others(), end - track.at));
            }
            next += 1;
        }
        track.read(&u.history, i);
    }
    if next < FORECASTS {
        out.push(shot(unit, &track, others(), (end - track.at).max(1e-9)));
    }
    out
}

enum How {
    Told,
    Crossed,
    Extrapolated,
    Alive,
}

/// When the last life of a unit ended, and how that is known.
fn end_of(u: &Unit, track: &Track) -> (Option<f64>, How) {
    if u.end.is_some() {
        return (u.end, How::Told);
    }
    // two tests beyond the threshold in a row, or the last one
    let levels: Vec<(f64, f64)> = u
        .history
        .rows
        .iter()
        .filter(|r| r.at >= track.begun())
        .filter_map(|r| Some((r.at, u.scale.damage(r.middle()?.0))))
        .collect();
    let beyond = |i: usize| levels[i].1 >= 1.0 && levels.get(i + 1).is_none_or(|l| l.1 >= 1.0);
    if let Some(i) = (1..levels.len()).find(|i| beyond(*i)) {
        let ((t0, x0), (t1, x1)) = (levels[i - 1], levels[i]);
        let f = if x1 > x0 {
            ((1.0 - x0) / (x1 - x0)).clamp(0.0, 1.0)
        } else {
            1.0
        };
        return (Some(t0 + f * (t1 - t0)), How::Crossed);
    }
    let x = track.filter.damage().0;
    if x > NEARLY {
        let left = without_fleet(track);
        let median = quantile(&left.times, 0.5);
        if median <= (AT_ONCE * (track.at - track.begun())).max(2.0 * track.filter.prior().interval) {
            return (Some(track.at + median), How::Extrapolated);
        }
    }
    (None, How::Alive)
}

/// The file of a fleet.
///
/// # Errors
/// What the disk refuses.
pub fn write(path: &Path, fleets: &[Fleet], units: usize) -> Result<()> {
    let lives: usize = fleets.iter().map(|f| f.lives.len()).max().unwrap_or(0);
    let v = json!({
        "schema_version": schemas::SCHEMA_VERSION,
        "what": "ema fleet",
        "units": units,
        "lives": lives,
        "fleets": fleets,
    });
    write_whole(path, format!("{v}\n").as_bytes())?;
    Ok(())
}

/// Reads what [`write()`] wrote.
///
/// # Errors
/// A file that is none, or of another version, or that holds what no fleet can.
pub fn read(path: &Path) -> Result<Vec<Fleet>> {
    let file = path.display().to_string();
    let text = std::fs::read_to_string(path).map_err(|e| Error::io(path, "cannot be read", e))?;
    let allowed = "a file of `ema prognosis learn` of this version";
    let v: Value = serde_json::from_str(&text).map_err(|e| Error::bad(&file, "file", e, allowed))?;
    if v["what"] != "ema fleet" || v["schema_version"] != schemas::SCHEMA_VERSION {
        let found = format!("{} {}", v["what"], v["schema_version"]);
        return Err(Error::bad(file, "what, schema_version", found, allowed).into());
    }
    let fleets: Vec<Fleet> =
        serde_json::from_value(v["fleets"].clone()).map_err(|e| Error::bad(&file, "fleets", e, allowed))?;
    if fleets.is_empty() || !fleets.iter().all(Fleet::is_sound) {
        return Err(Error::bad(file, "fleets", "masses or lives that no fleet has", allowed).into());
    }
    Ok(fleets)
}

#[cfg(test)]
mod tests {
    use super::unseen;

    #[test]
    fn prop_what_no_end_was_seen_of_is_counted() {
        let of = |ages: &[(f64, bool)]| unseen(ages.to_vec());
        assert_eq!(of(&[]), 1.0);
        // all ended; young ones that live on take nothing away
        assert_eq!(of(&[(3.0, true), (1.0, true), (2.0, true)]), 0.0);
        assert_eq!(of(&[(0.1, false), (3.0, true), (0.2, false), (1.0, true)]), 0.0);
        // half of them live on, older than all that ended
        assert!((of(&[(1.0, true), (2.0, true), (5.0, false), (5.0, false)]) - 0.5).abs() < 1e-12);
        // one dropped out between: its share falls to the others
        let s = of(&[(1.0, true), (1.5, false), (2.0, true), (5.0, false)]);
        assert!((s - 0.75 * 0.5).abs() < 1e-12, "{s}");
        // fifty live on; one of those that were tested longest has ended
        let mut many = vec![(9.0, false); 50];
        many.push((9.5, true));
        assert_eq!(of(&many), 1.0);
    }
}
