//! The columns of the live view: what they say of an actuator, and which of them a terminal has room for. A column
//! is shown whole or not at all, so that an interval never loses a bound; only names and reasons are cut.

use crate::diagnosis::Outcome;
use crate::live::{Foretold, Status};
use schemas::fault::Interval;
use schemas::feature::{Feature, Raw};

/// A column.
#[derive(Clone, Copy)]
pub(super) struct Column {
    pub name: &'static str,
    /// those with the least number are kept longest
    rank: u8,
    pub text: fn(&Status) -> String,
}

/// Least and greatest width of the names.
const NAME: (usize, usize) = (10, 32);
/// A reason of less is worth nothing.
const LEAST_REASON: usize = 12;

pub(super) const ACTUATOR: &str = "actuator";
pub(super) const OUTCOME: &str = "outcome";
const REASON: &str = "reason";
/// Shown where anything is foretold of anybody.
const LEFT: &str = "life left";
const RATE: &str = "rate";

/// In the order in which they are shown.
const COLUMNS: [Column; 15] = [
    column(ACTUATOR, 0, |s| s.actuator.clone()),
    column("run", 5, |s| s.run.to_string()),
    column("phase", 7, |s| s.phase.clone()),
    column("test", 3, |s| bar(s.sample, s.samples, 6)),
    column("lost", 4, |s| s.lost.to_string()),
    // before there are maps only what needs no nominal run is known
    column("P1 rad/s", 8, |s| number(s.features.get(Feature::P1), 5)),
    column("P2 A", 9, |s| number(s.features.get(Feature::P2).or(s.raw[Raw::P2]), 4)),
    column("P3 -", 10, |s| number(s.features.get(Feature::P3), 3)),
    column("ripple", 11, |s| {
        number(s.features.get(Feature::Ripple).or(s.raw[Raw::Ripple]), 6)
    }),
    column("FSJ", 1, |s| {
        intervals(s).map_or("-".into(), |(fsj, _)| interval(fsj, 3))
    }),
    column("zeta", 2, |s| {
        intervals(s).map_or("-".into(), |(_, zeta)| interval(zeta, 4))
    }),
    column(LEFT, 2, left),
    column(RATE, 4, rate),
    column(OUTCOME, 0, outcome),
    column(REASON, 6, |s| reason(s).to_string()),
];

const fn column(name: &'static str, rank: u8, text: fn(&Status) -> String) -> Column {
    Column { name, rank, text }
}

fn number(x: Option<f64>, digits: usize) -> String {
    x.map_or("-".into(), |x| format!("{x:.digits$}"))
}

fn interval(i: Interval, digits: usize) -> String {
    format!("{:.digits$} .. {:.digits$}", i.lo, i.hi)
}

/// Both intervals, where there is an area.
fn intervals(s: &Status) -> Option<(Interval, Interval)> {
    let area = s.outcome.as_ref()?.area()?;
    Some((area.fsj, area.zeta))
}

/// The outcome in words.
pub(super) fn outcome(s: &Status) -> String {
    match (&s.outcome, s.is_final) {
        (Some(o), true) => o.name().replace('_', " "),
        (Some(_), false) => "forming".into(),
        // an earlier process has given it
        (None, true) => "in the log".into(),
        (None, false) => "-".into(),
    }
}

/// The interval of the remaining life, of the fault whose life ends first.
fn left(s: &Status) -> String {
    let Some(f) = &s.foretold else { return String::new() };
    let Some((lo, hi, _)) = f.left else {
        return format!("{} {}", f.fault, f.status);
    };
    let end = |x: f64| {
        if x.is_finite() {
            format!("{x:.0}")
        } else {
            "never".into()
        }
    };
    let unit = if hi.is_finite() {
        format!(" {}s", f.clock)
    } else {
        String::new()
    };
    format!("{} {} .. {}{unit}", f.fault, end(lo), end(hi))
}

/// Growth of that fault.
fn rate(s: &Status) -> String {
    let of = |f: &Foretold| Some(format!("{:.2e}/{}", f.rate?, f.clock));
    s.foretold.as_ref().and_then(of).unwrap_or_default()
}

/// Why there is no area, or none by all maps.
pub(super) fn reason(s: &Status) -> &str {
    let last = s.outcome.as_ref().filter(|_| s.is_final);
    last.map_or("", Outcome::reason)
}

/// Outcome and intervals in words.
pub(super) fn verdict(s: &Status) -> String {
    let so_far = if s.is_final { "" } else { " (so far)" };
    let Some(area) = s.outcome.as_ref().and_then(Outcome::area) else {
        return format!("{}{so_far} {}", outcome(s), reason(s)).trim_end().to_string();
    };
    let (fsj, zeta) = (interval(area.fsj, 3), interval(area.zeta, 4));
    let (f, z) = area.centroid;
    let name = outcome(s);
    let text = format!("{name}{so_far} FSJ {f:.3} ({fsj}) zeta {z:.4} ({zeta}) {}", reason(s));
    text.trim_end().to_string()
}

/// A bar of `width` characters.
pub(super) fn bar(done: u64, of: u64, width: u64) -> String {
    let share = done.min(of) as f64 / of.max(1) as f64;
    let filled = (share * width as f64) as usize;
    "█".repeat(filled) + &"·".repeat(width as usize - filled)
}

/// A text of at most `width` characters, cut in the middle: names often differ at their ends.
pub(super) fn cut(text: &str, width: usize) -> String {
    let letters: Vec<char> = text.chars().collect();
    if letters.len() <= width {
        return text.into();
    }
    let tail = width.saturating_sub(1) / 2;
    let head = width.saturating_sub(1 + tail);
    let (begin, end) = (&letters[..head], &letters[letters.len() - tail..]);
    begin.iter().chain(&['…']).chain(end).take(width).collect()
}

/// The columns that `width` has room for, and their widths.
pub(super) fn fitting(rows: &[&Status], width: usize) -> Vec<(Column, usize)> {
    let natural = |c: &Column| {
        let cells = rows.iter().map(|s| (c.text)(s).chars().count());
        let widest = cells.chain([c.name.chars().count()]).max().unwrap_or(0);
        match c.name {
            ACTUATOR => widest.min(NAME.0),
            REASON => LEAST_REASON,
            _ => widest,
        }
    };
    let is_told = rows.iter().any(|s| s.foretold.is_some());
    let mut by_rank: Vec<usize> = (0..COLUMNS.len()).collect();
    by_rank.retain(|i| is_told || ![LEFT, RATE].contains(&COLUMNS[*i].name));
    by_rank.sort_by_key(|i| COLUMNS[*i].rank);
    let mut taken: Vec<(usize, usize)> = Vec::new();
    let mut left = width;
    for i in by_rank {
        let w = natural(&COLUMNS[i]);
        let gap = usize::from(!taken.is_empty());
        if w + gap > left {
            break;
        }
        left -= w + gap;
        taken.push((i, w));
    }
    taken.sort_unstable();
    let mut fitting: Vec<(Column, usize)> = taken.into_iter().map(|(i, w)| (COLUMNS[i], w)).collect();
    grow(&mut fitting, rows, left);
    fitting
}

/// Gives the room that is left to the names, then to the reasons.
fn grow(fitting: &mut [(Column, usize)], rows: &[&Status], mut left: usize) {
    let longest = rows.iter().map(|s| s.actuator.chars().count()).max().unwrap_or(0);
    for (column, width) in fitting {
        let wanted = match column.name {
            ACTUATOR => longest.min(NAME.1).saturating_sub(*width),
            REASON => left,
            _ => 0,
        };
        let more = wanted.min(left);
        *width += more;
        left -= more;
    }
}
