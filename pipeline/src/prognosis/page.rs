//! The page of a prognosis: the fleet by risk; trend, time left, its distribution and the laws of the worst units.

use super::score::{At, Reliability, Scored, over_all, replayed};
use super::tables::by_risk;
use super::words::{moment, short, text};
use super::{Clock, Told};
use crate::COMMIT;
use crate::report::{Figure, Report, Section, Table, TableRow, TracePlot};
use diagnoser::prognosis::fleet::{COVERAGE, Fleet, without_fleet};
use diagnoser::prognosis::forecast::quantile;
use diagnoser::prognosis::history::Ends;
use diagnoser::prognosis::law::Family;
use diagnoser::prognosis::outlook::{LEAST_TESTS, promise};
use diagnoser::prognosis::track::Used;
use diagnoser::prognosis::{History, Scale, Status, Track};
use std::sync::Arc;

/// Units with figures of their own, worst first.
const SHOWN: usize = 6;

/// Past forecasts in a figure.
const PAST: usize = 24;

/// Forecasts of a band of probabilities below which a point says nothing.
const FEWEST_FORECASTS: usize = 10;

/// The report.
pub fn report(told: &[Told], fleets: &[Fleet]) -> Report {
    let sorted = by_risk(told);
    let clock = told.first().map_or(Clock::Cycle, |t| t.clock);
    let mut sections = vec![fleet_section(&sorted, clock)];
    for t in sorted
        .iter()
        .filter(|t| t.track.is_some() && t.outlook.used > 0)
        .take(SHOWN)
    {
        let fleet = fleets.iter().find(|f| f.fault == t.threshold.fault);
        sections.push(unit_section(t, sections.len(), fleet));
    }
    let doubtful = told.iter().filter(|t| t.outlook.status != Status::Ok).count();
    let summary = format!(
        "{} outlooks; {} of them are not plain (doubtful, too early, passed or refused: the reasons stand in the table). Intervals: {}.",
        told.len(),
        doubtful,
        told.iter()
            .find_map(|t| t.outlook.left.as_ref())
            .map_or("none".into(), promise),
    );
    Report {
        title: "Prognosis".into(),
        lead: None,
        summary,
        facts: vec![
            ("clock".into(), clock.name().into()),
            ("coverage of intervals".into(), format!("{:.0} %", 100.0 * COVERAGE)),
            program(),
        ],
        sections,
    }
}

fn program() -> (String, String) {
    (
        "program".into(),
        format!("ema {} ({COMMIT})", env!("CARGO_PKG_VERSION")),
    )
}

fn fleet_section(sorted: &[&Told], clock: Clock) -> Section {
    let row = |t: &&Told| {
        let o = &t.outlook;
        let rul = o.rul();
        let cells = vec![
            o.actuator.clone(),
            t.threshold.fault.clone(),
            o.status.name().replace('_', " "),
            o.level.map_or("-".into(), |l| short(l.2)),
            rul.map_or("-".into(), |r| short(r.2)),
            rul.map_or("-".into(), |r| format!("{} .. {}", short(r.0), short(r.1))),
            o.p_fail.get(1).map_or("-".into(), |p| format!("{:.3}", p.1)),
            o.next_test.map_or("-".into(), |x| moment(clock, x)),
            o.next_inspection.map_or("-".into(), |x| moment(clock, x)),
            if o.reason.is_empty() {
                o.alarms.last().map_or(String::new(), |a| {
                    format!("{}: {}", a.kind.name().replace('_', " "), a.text)
                })
            } else {
                o.reason.clone()
            },
        ];
        TableRow {
            cells,
            emphasis: o.status == Status::Passed,
        }
    };
    let ahead = sorted
        .iter()
        .find_map(|t| t.outlook.p_fail.get(1))
        .map_or(20.0, |p| p.0);
    let header = [
        "actuator".into(),
        "fault".into(),
        "status".into(),
        "level".into(),
        format!("left, median [{}s]", clock.name()),
        format!("left, 90 % [{}s]", clock.name()),
        format!("P(fail within {ahead})"),
        "test by".into(),
        "inspect by".into(),
        "reason, last alarm".into(),
    ];
    Section {
        title: "The fleet, by risk".into(),
        text: "Worst first, by the lower end of the time left. Inspect by: when the probability of having passed the threshold reaches \
               the risk. \"never\" is within the interval where some futures do not reach the threshold within ten usual lives."
            .into(),
        tables: vec![Table {
            caption: "Outlooks".into(),
            header: header.into(),
            rows: sorted.iter().map(row).collect(),
            note: String::new(),
        }],
        ..Section::default()
    }
}

fn unit_section(t: &Told, number: usize, fleet: Option<&Fleet>) -> Section {
    let o = &t.outlook;
    let stem = |what: &str| format!("unit{number}_{what}");
    let mut figures = Vec::new();
    if let (Some((history, track)), Some(scale)) = (&t.track, t.scale) {
        figures.push((stem("trend"), Figure::Trace(trend(t, track, scale))));
        let (left, laws) = past(t, track, history, fleet);
        figures.push((stem("left"), Figure::Trace(left)));
        figures.push((stem("laws"), Figure::Trace(laws)));
        if o.left.is_some() {
            figures.push((stem("cdf"), Figure::Trace(distribution(t))));
        }
    }
    let text = text(t);
    let lines: Vec<String> = text.lines().map(|l| format!("- {l}")).collect();
    Section {
        title: format!("{}, {}", o.actuator, t.threshold.fault),
        text: lines.join("\n"),
        figures,
        ..Section::default()
    }
}

fn trend(t: &Told, track: &Track, scale: Scale) -> TracePlot {
    let o = &t.outlook;
    let level = |pick: fn(Ends) -> f64| -> Vec<(f64, f64)> {
        let used = track.trends.iter().filter(|r| r.used != Used::Nothing);
        used.map(|r| (r.at, pick(scale.level_of(r.damage)))).collect()
    };
    let first = track.trends.first().map_or(0.0, |r| r.at);
    let mut series = vec![
        ("level".to_string(), level(|e| e.2)),
        ("95 %".into(), level(|e| e.1)),
        ("95 % ".into(), level(|e| e.0)),
    ];
    let mut end = o.at;
    if let (Some(l), Some(now)) = (&o.left, o.level) {
        for (name, time) in [
            ("left, 90 %", l.interval.0),
            ("left, median", quantile(&l.times, 0.5)),
            ("left, 90 % ", l.interval.1),
        ] {
            let time = time.min(3.0 * (o.at - first).max(l.interval.0));
            end = end.max(o.at + time);
            series.push((name.into(), vec![(o.at, now.2), (o.at + time, scale.threshold)]));
        }
    }
    series.push((
        "threshold".into(),
        vec![(first, scale.threshold), (end, scale.threshold)],
    ));
    let span = (scale.healthy, scale.threshold);
    for (at, kind) in t.events.iter().take(6) {
        series.push((kind.clone(), vec![(*at, span.0), (*at, span.1)]));
    }
    if let Some(c) = o.change {
        series.push(("change of rate".into(), vec![(c.at, span.0), (c.at, span.1)]));
    }
    TracePlot {
        title: format!("{}: {}, and the way to the threshold", o.actuator, t.threshold.fault),
        x_label: format!("time [{}s]", t.clock.name()),
        y_label: t.threshold.fault.clone(),
        series,
    }
}

/// Time left as it was told over time with the cone of what was left if it is the median of today; and the laws.
fn past(t: &Told, whole: &Track, history: &History, fleet: Option<&Fleet>) -> (TracePlot, TracePlot) {
    let prior = Arc::new(whole.filter.prior().clone());
    let mut track = Track::new(prior, whole.scale);
    let n = history.rows.len();
    let step = n.div_ceil(PAST).max(1);
    let [mut lo, mut median, mut hi] = [const { Vec::new() }; 3];
    let mut laws: Vec<Vec<(f64, f64)>> = vec![Vec::new(); Family::ALL.len()];
    for i in 0..n {
        track.read(history, i);
        if (i + 1) % step != 0 && i + 1 != n || track.since_repair < LEAST_TESTS {
            continue;
        }
        let left = fleet.map_or_else(|| without_fleet(&track), |f| f.left(&track));
        let told = |x: f64| if x.is_finite() { x } else { f64::NAN };
        lo.push((track.at, told(left.interval.0)));
        median.push((track.at, told(quantile(&left.times, 0.5))));
        hi.push((track.at, told(left.interval.1)));
        let mut sum = 0.0;
        for (l, f) in laws.iter_mut().zip(track.filter.families()) {
            sum += f;
            l.push((track.at, sum));
        }
    }
    let clock = format!("time [{}s]", t.clock.name());
    let mut series = vec![
        ("90 %".to_string(), lo),
        ("median".into(), median.clone()),
        ("90 % ".into(), hi),
    ];
    if let (Some(first), Some(r)) = (median.first(), t.outlook.rul())
        && r.2.is_finite()
    {
        let end = t.outlook.at + r.2;
        for (name, share) in [
            ("end as the last median has it", 1.0),
            ("20 % more", 1.2),
            ("20 % less", 0.8),
        ] {
            series.push((name.into(), vec![(first.0, share * (end - first.0)), (end, 0.0)]));
        }
    }
    let left = TracePlot {
        title: format!("{}: time left as told over time", t.outlook.actuator),
        x_label: clock.clone(),
        y_label: format!("time left [{}s]", t.clock.name()),
        series,
    };
    let named = Family::ALL
        .into_iter()
        .zip(laws)
        .map(|(f, l)| (format!("up to {}", f.name().replace('_', " ")), l));
    let laws = TracePlot {
        title: format!("{}: laws of growth, cumulated probability", t.outlook.actuator),
        x_label: clock,
        y_label: "probability".into(),
        series: named.collect(),
    };
    (left, laws)
}

fn distribution(t: &Told) -> TracePlot {
    let mut series = Vec::new();
    if let Some(l) = &t.outlook.left {
        let n = l.times.len() as f64;
        let finite = l.times.iter().take_while(|x| x.is_finite());
        series.push((
            "P(failed by then)".to_string(),
            finite.enumerate().map(|(i, x)| (*x, (i as f64 + 0.5) / n)).collect(),
        ));
        for (name, x) in [("90 %", l.interval.0), ("90 % ", l.interval.1)] {
            if x.is_finite() {
                series.push((name.into(), vec![(x, 0.0), (x, 1.0)]));
            }
        }
    }
    TracePlot {
        title: format!("{}: distribution of the time left", t.outlook.actuator),
        x_label: format!("time left [{}s]", t.clock.name()),
        y_label: "probability".into(),
        series,
    }
}

/// The page of a replay: how reliable probabilities of failure were, and whole distributions.
///
/// * `scored` fault, threshold, what was seen
pub fn scores(scored: &[(String, f64, Scored)]) -> Report {
    let section = |(fault, level, s): &(String, f64, Scored)| Section {
        title: format!("{fault} to {level}"),
        text: format!("{}; {}.", replayed(s), over_all(s)),
        tables: vec![by_share(s), by_band(s)],
        figures: vec![
            (format!("{fault}_reliability"), Figure::Trace(reliability(s))),
            (format!("{fault}_distribution"), Figure::Trace(places(s))),
        ],
        ..Section::default()
    };
    Report {
        title: "Prognoses replayed".into(),
        lead: None,
        summary: "Every forecast that would have been made of units whose end is known, against what came. On the diagonal a \
                forecast is neither too sure nor too careful."
            .into(),
        facts: vec![program()],
        sections: scored.iter().map(section).collect(),
    }
}

fn table(caption: &str, header: &[&str], rows: impl Iterator<Item = Vec<String>>, note: &str) -> Table {
    Table {
        caption: caption.into(),
        header: header.iter().map(|h| h.to_string()).collect(),
        rows: rows.map(|cells| TableRow { cells, emphasis: false }).collect(),
        note: note.into(),
    }
}

/// At a quarter, half and three quarters of the life.
fn by_share(s: &Scored) -> Table {
    let header = [
        "share of life",
        "units",
        "coverage",
        "median within 20 %",
        "half of mass within 20 %",
        "width / time left, mean (median)",
        "CRPS / time left, mean (median)",
    ];
    let row = |a: &At| {
        let both = |x: (f64, f64)| format!("{:.2} ({:.2})", x.0, x.1);
        let share = |x: f64| format!("{x:.2}");
        vec![
            share(a.lambda),
            a.units.to_string(),
            share(a.coverage),
            share(a.alpha_lambda),
            share(a.strict),
            both(a.width),
            both(a.crps),
        ]
    };
    table("By share of the life", &header, s.at.iter().map(row), "")
}

/// P(failure) by bands.
fn by_band(s: &Scored) -> Table {
    let header = [
        "within",
        "Brier score",
        "said, mean of the band",
        "happened",
        "forecasts",
    ];
    let bands = s.brier.iter().flat_map(|(ahead, brier, bins)| {
        let told = bins.iter().filter(|b| b.2 > 0);
        told.map(move |(said, was, n)| {
            let share = |x: &f64| format!("{x:.3}");
            vec![
                ahead.to_string(),
                format!("{brier:.4}"),
                share(said),
                share(was),
                n.to_string(),
            ]
        })
    });
    let note = "Forecasts of one unit are not independent of each other.";
    table("Probability of failure", &header, bands, note)
}

/// What happened over what was said, by time ahead.
fn reliability(s: &Scored) -> TracePlot {
    let of = |(ahead, _, bins): &Reliability| {
        let points = bins.iter().filter(|b| b.2 >= FEWEST_FORECASTS);
        (format!("within {ahead}"), points.map(|b| (b.0, b.1)).collect())
    };
    let mut series: Vec<(String, Vec<(f64, f64)>)> = s.brier.iter().map(of).collect();
    series.push(("as said".into(), vec![(0.0, 0.0), (1.0, 1.0)]));
    TracePlot {
        title: format!("Reliability of P(failure), bands of {FEWEST_FORECASTS} forecasts and more"),
        x_label: "said, mean of the band".into(),
        y_label: "happened".into(),
        series,
    }
}

/// Share of truths below each quantile that was told.
fn places(s: &Scored) -> TracePlot {
    let mut places: Vec<f64> = s.forecasts.iter().map(|f| f.place).collect();
    places.sort_by(f64::total_cmp);
    let n = places.len().max(1) as f64;
    let curve = (0..=50).map(|k| {
        let p = f64::from(k) / 50.0;
        (p, places.partition_point(|x| *x <= p) as f64 / n)
    });
    TracePlot {
        title: "Remaining life: share of truths below each quantile".into(),
        x_label: "quantile that was told".into(),
        y_label: "share of truths below".into(),
        series: vec![
            ("seen".into(), curve.collect()),
            ("as told".into(), vec![(0.0, 0.0), (1.0, 1.0)]),
        ],
    }
}
