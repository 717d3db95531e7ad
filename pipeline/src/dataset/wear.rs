//! What is known of the lives of a fleet that wears: events that somebody wrote down, and when lives ended, beside its diagnoses in the
//! form in which `ema prognosis` takes them.

use super::Dataset;
use anyhow::{Context, Result};
use arrow::temporal_conversions::timestamp_us_to_datetime;

/// Where recorded events are.
pub const EVENTS: &str = "wear/events.csv";

/// Where the ends of lives are.
pub const TRUTH: &str = "wear/truth.csv";

/// Microseconds since 1970.
pub fn microseconds(day: f64) -> i64 {
    (day * 86_400e6).round() as i64
}

fn time(day: f64) -> String {
    let t = timestamp_us_to_datetime(microseconds(day)).map(|t| t.format("%Y-%m-%dT%H:%M:%SZ").to_string());
    t.unwrap_or_default()
}

fn csv(header: &[&str], rows: Vec<Vec<String>>) -> Result<Vec<u8>> {
    let mut out = csv::Writer::from_writer(Vec::new());
    out.write_record(header)?;
    for r in rows {
        out.write_record(r)?;
    }
    out.into_inner().context("in memory")
}

/// Writes [`EVENTS`] (replacements that were recorded) and [`TRUTH`] (flight and time at which each fault passed its threshold, and the
/// law by which it grew; replacements that nobody recorded are in its column `unrecorded_replacement`).
///
/// # Errors
/// Storage that refuses.
pub fn write(d: &Dataset) -> Result<()> {
    let (mut events, mut ends) = (Vec::new(), Vec::new());
    for (k, a) in d.plan.actuators.iter().enumerate() {
        let Some(life) = d.plan.life(k) else { return Ok(()) };
        let recorded = life.replaced.filter(|r| r.is_recorded);
        events.extend(recorded.map(|r| {
            let row = [&a.id, &r.flight.to_string(), &time(r.day), "replacement", "", ""];
            row.map(String::from).to_vec()
        }));
        let silent = life.replaced.filter(|r| !r.is_recorded).map(|r| r.flight.to_string());
        for e in &life.ends {
            let Some((flight, day)) = e.at else { continue };
            ends.push(vec![
                a.id.clone(),
                format!("{flight:.3}"),
                time(day),
                format!("{} > {}", e.fault, e.threshold),
                e.law.name().into(),
                silent.clone().unwrap_or_default(),
            ]);
        }
    }
    let header = ["actuator", "cycle", "time", "kind", "fault", "note"];
    d.storage.replace(EVENTS, csv(&header, events)?)?;
    let header = ["actuator", "cycle", "time", "event", "law", "unrecorded_replacement"];
    d.storage.replace(TRUTH, csv(&header, ends)?)?;
    Ok(())
}
