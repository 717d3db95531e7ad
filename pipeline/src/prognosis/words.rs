//! What is told of an outlook, in words and as JSON.

use super::{Clock, Told};
use crate::digits::fixed;
use arrow::temporal_conversions::timestamp_ns_to_datetime;
use diagnoser::prognosis::fleet::COVERAGE;
use diagnoser::prognosis::outlook::promise;
use diagnoser::prognosis::track::Alarm;
use diagnoser::prognosis::{Ended, Status};
use serde_json::{Value, json};

/// A number by four digits, or as many as stand before its point.
pub fn short(x: f64) -> String {
    match x.abs() {
        _ if x.is_infinite() => "never".into(),
        _ if x.is_nan() => "-".into(),
        a if a >= 1000.0 => format!("{x:.0}"),
        _ => format!("{x:.3e}")
            .parse::<f64>()
            .map_or_else(|_| "-".into(), |v| v.to_string()),
    }
}

/// A moment of a clock: days since 1970 as a date.
pub fn moment(clock: Clock, x: f64) -> String {
    let to_ns = 86_400e9 / if clock == Clock::Hour { 24.0 } else { 1.0 };
    // numbers of a clock that begins elsewhere are no dates
    let is_date = matches!(clock, Clock::Day | Clock::Hour) && x * to_ns > 315_360_000e9 && x * to_ns < 9e18;
    let date = is_date.then(|| timestamp_ns_to_datetime((x * to_ns) as i64)).flatten();
    date.map_or_else(
        || format!("{} {}", clock.name(), short(x)),
        |d| d.format("%Y-%m-%d").to_string(),
    )
}

/// A finite number, or null.
fn number(x: f64) -> Value {
    if x.is_finite() { json!(x) } else { Value::Null }
}

/// Keys of the interface.
pub fn to_json(t: &Told) -> Value {
    let o = &t.outlook;
    let ends = |e: Option<(f64, f64, f64)>| match e {
        Some((lo, hi, estimate)) => json!({"lo": number(lo), "hi": number(hi), "estimate": number(estimate)}),
        None => json!({"lo": null, "hi": null, "estimate": null}),
    };
    let laws = o.laws.iter().map(|(f, m)| (f.name().to_string(), json!(m)));
    let p_fail = o.p_fail.iter().map(|(h, p)| (h.to_string(), json!(p)));
    let alarm =
        |a: &Alarm| json!({"kind": a.kind.name(), "at": number(a.at), "probability": a.probability, "text": a.text});
    let rul = o.rul();
    let of = |f: fn((f64, f64, f64)) -> f64| rul.map_or(Value::Null, |r| number(f(r)));
    json!({
        "actuator": o.actuator,
        "fault": t.threshold.fault,
        "threshold": number(t.threshold.level),
        "clock": t.clock.name(),
        "tests": o.tests,
        "used": o.used,
        "at": number(o.at),
        "level": ends(o.level),
        "rate": ends(o.rate),
        "law": serde_json::Map::from_iter(laws),
        "change": o.change.map(|c| json!({"at": c.at, "probability": c.probability, "factor": c.factor})),
        "rul": {"median": of(|r| r.2), "lo": of(|r| r.0), "hi": of(|r| r.1)},
        "rul_days": t.days.and_then(|d| rul.map(|r| json!({"median": number(d * r.2), "lo": number(d * r.0), "hi": number(d * r.1)}))),
        "coverage": COVERAGE,
        "calibration_lives": o.left.as_ref().and_then(|l| l.calibrated),
        "p_fail": serde_json::Map::from_iter(p_fail),
        "p_never": o.p_never,
        "next_test": o.next_test.map(number),
        "next_inspection": o.next_inspection.map(number),
        "risk": o.risk,
        "status": o.status.name(),
        "alarms": o.alarms.iter().map(alarm).collect::<Vec<_>>(),
        "reason": o.reason,
    })
}

/// For people: as many lines as there is something to say.
pub fn text(t: &Told) -> String {
    let o = &t.outlook;
    let clock = t.clock.name();
    let mut out = format!("actuator  {}   {} tests, {} used", o.actuator, o.tests, o.used);
    if let Some((history, _)) = &t.track {
        for ended in [Ended::Unexplained, Ended::OutOfRange, Ended::Incomplete] {
            let n = history.rows.iter().filter(|r| r.ended == ended).count();
            if n > 0 {
                out += &format!(", {n} {}", ended.name().replace('_', " "));
            }
        }
    }
    if o.repairs > 0 {
        out += &format!("; {} repairs", o.repairs);
    }
    let title = match t.threshold.fault.as_str() {
        "fsj" => "FSJ".to_string(),
        name => name.into(),
    };
    if let Some((lo, hi, e)) = o.level {
        let half = 0.5 * (hi - lo);
        out += &format!(
            "\n{title:<9} {} in {} .. {} (95 %)",
            fixed(e, half),
            fixed(lo, half),
            fixed(hi, half)
        );
    }
    if let Some((lo, hi, e)) = o.rate {
        let mut laws: Vec<_> = o.laws.iter().filter(|l| l.1 >= 0.05).collect();
        laws.sort_by(|a, b| b.1.total_cmp(&a.1));
        let laws: Vec<String> = laws
            .iter()
            .map(|(f, m)| format!("{} {m:.2}", f.name().replace('_', " ")))
            .collect();
        out += &format!(
            "\nrate      {} a {clock} in {} .. {};  law: {}",
            short(e),
            short(lo),
            short(hi),
            laws.join(", ")
        );
    }
    if let Some(c) = o.change {
        out += &format!(
            "\nchange    {} ({} .. {}), rate x {:.1}, probability {:.2}",
            moment(t.clock, c.at),
            short(c.since.0),
            short(c.since.1),
            c.factor,
            c.probability
        );
    }
    if let (Some((lo, hi, median)), Some(left)) = (o.rul(), &o.left) {
        out += &format!(
            "\nRUL       {} {clock}s in {} .. {} ({})",
            short(median),
            short(lo),
            short(hi),
            promise(left)
        );
        if let Some(d) = t.days {
            out += &format!(";  {} d .. {} d at the pace of late", short(d * lo), short(d * hi));
        }
        let p: Vec<String> = o
            .p_fail
            .iter()
            .map(|p| {
                if p.1 < 0.001 {
                    "< 0.001".into()
                } else {
                    format!("{:.3}", p.1)
                }
            })
            .collect();
        let h: Vec<String> = o.p_fail.iter().map(|p| short(p.0)).collect();
        out += &format!(
            "\nP(beyond {}) within {} {clock}s: {}",
            if t.threshold.level.is_nan() {
                "a threshold".into()
            } else {
                short(t.threshold.level)
            },
            h.join(", "),
            p.join(", ")
        );
        if let (Some(a), Some(b)) = (o.next_test, o.next_inspection) {
            out += &format!(
                "\nadvice    next test by {}, inspection by {} (risk {} %)",
                moment(t.clock, a),
                moment(t.clock, b),
                short(100.0 * o.risk)
            );
        }
    }
    if o.status != Status::Ok {
        out += &format!("\n{:<9} {}", o.status.name().replace('_', " ").to_uppercase(), o.reason);
    }
    for a in o.alarms.iter().rev().take(3) {
        out += &format!(
            "\nalarm     {} at {}: {}",
            a.kind.name().replace('_', " "),
            moment(t.clock, a.at),
            a.text
        );
    }
    out
}
