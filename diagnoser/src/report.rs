//! Diagnoses as JSON, as a table and as messages: the same keys everywhere.

use crate::diagnosis::{Area, Diagnosis, Outcome};
use crate::live::Report;
use crate::paving::Part;
use arrow::array::{ArrayRef, BooleanArray, Float64Array, Int64Array, RecordBatch, StringArray, UInt64Array};
use arrow::datatypes::{DataType, Field, Schema};
use schemas::fault::Interval;
use schemas::feature::Feature;
use schemas::stream::diagnosis::DiagnosisMessage;
use schemas::stream::wire::{to_number, to_text};
use serde_json::{Value, json};
use std::sync::Arc;

/// The diagnosis as JSON, keys of the interface.
pub fn to_json(d: &Diagnosis) -> Value {
    let interval = |lo: Option<f64>, hi: Option<f64>, e: Option<f64>| json!({"lo": lo, "hi": hi, "estimate": e});
    let area = d.outcome.area();
    let told = Feature::TOLD.into_iter().map(|f| (f, json!(d.features.get(f))));
    // those of certain sequences stand where there is one
    let more = Feature::FINER
        .into_iter()
        .chain(Feature::CAUSES)
        .chain(Feature::WATCHES);
    let more = more.filter_map(|f| Some((f, json!(d.features.get(f)?))));
    let features = told.chain(more).map(|(f, v)| (f.key().to_string(), v));
    let mut object = json!({
        "outcome": d.outcome.name(),
        "fsj": interval(area.map(|a| a.fsj.lo), area.map(|a| a.fsj.hi), area.map(|a| a.centroid.0)),
        "zeta": interval(area.map(|a| a.zeta.lo), area.map(|a| a.zeta.hi), area.map(|a| a.centroid.1)),
        "area": area.map(|a| a.size),
        "area_inner": area.map(|a| a.inner),
        "area_outer": area.map(|a| a.outer),
        "areas": area.map_or(Vec::new(), |a| a.parts.iter().map(part).collect()),
        "misfit": d.misfit.map(|(q, gate)| json!({"found": q.sqrt(), "allowed": gate.sqrt()})),
        "coverage": d.coverage,
        "calibrated": d.calibrated,
        "features": serde_json::Map::from_iter(features),
        "contradicting": contradicting(&d.outcome).iter().map(|f| f.name()).collect::<Vec<_>>(),
        "reason": d.outcome.reason(),
    });
    if let Some(k) = &d.kinetic {
        object["kinetic_factor"] = interval(Some(k.interval.lo), Some(k.interval.hi), Some(k.estimate));
    }
    object
}

/// The object with the version of its keys, as programs get it on standard output. Nested objects and the rows of logs
/// have none of their own.
///
/// # Panics
/// Where it is no object.
pub fn versioned(mut object: Value) -> Value {
    object["schema_version"] = schemas::SCHEMA_VERSION.into();
    object
}

/// One of several separated parts of an area.
fn part(p: &Part) -> Value {
    let interval = |i: Interval, e: f64| json!({"lo": i.lo, "hi": i.hi, "estimate": e});
    json!({
        "fsj": interval(p.fsj, p.centroid.0),
        "zeta": interval(p.zeta, p.centroid.1),
        "area_inner": p.inner,
        "area_outer": p.outer,
    })
}

fn contradicting(outcome: &Outcome) -> &[Feature] {
    match outcome {
        Outcome::Unexplained { contradicting, .. } => contradicting,
        _ => &[],
    }
}

/// A diagnosis of a stream, with what is to be known of the stream.
#[derive(Clone, Debug)]
pub struct Logged {
    /// the diagnosis and its stream
    pub report: Report,
    /// wall clock [ns since 1970, UTC]
    pub time_ns: i64,
    /// when it was published [ns, CLOCK_MONOTONIC]
    pub publish_ns: u64,
}

impl Logged {
    /// One line of a JSON-lines log.
    pub fn to_json(&self) -> Value {
        let r = &self.report;
        let mut v = to_json(&r.diagnosis);
        let more = json!({
            "time_ns": self.time_ns,
            "actuator": r.run.actuator,
            "parameters": r.run.parameters,
            "sequence": r.run.sequence,
            "run": r.run.run,
            "stream": format!("{:016x}", r.stream),
            "final": r.is_final,
            "samples_received": r.samples_received,
            "samples_lost": r.samples_lost,
            "telemetry_ns": r.telemetry_ns,
            "publish_ns": self.publish_ns,
        });
        if let (Value::Object(v), Value::Object(more)) = (&mut v, more) {
            v.extend(more);
        }
        v
    }

    /// One line for a person.
    pub fn to_line(&self) -> String {
        let r = &self.report;
        let d = &r.diagnosis;
        let mut line = format!("{} run {}: ", r.run.actuator, r.run.run);
        line += &match r.is_final {
            true => d.outcome.name().replace('_', " "),
            false => "so far".into(),
        };
        if let Some(a) = d.outcome.area() {
            line += &format!(
                " FSJ {:.4} ({:.4} .. {:.4}), zeta {:.5} ({:.5} .. {:.5})",
                a.centroid.0, a.fsj.lo, a.fsj.hi, a.centroid.1, a.zeta.lo, a.zeta.hi
            );
        }
        if !d.outcome.reason().is_empty() && r.is_final {
            line += &format!(": {}", d.outcome.reason());
        }
        if r.is_final {
            let us = self.publish_ns.saturating_sub(r.telemetry_ns) as f64 * 1e-3;
            line += &format!(" [{us:.0} us after the frame]");
        }
        line
    }
}

/// The message of a report, yet without number and time.
pub fn to_message(r: &Report) -> DiagnosisMessage {
    let d = &r.diagnosis;
    let known = |x: Option<f64>| x.unwrap_or(f64::NAN);
    let of = |f: fn(&Area) -> f64| known(d.outcome.area().map(f));
    let outcome = match d.outcome {
        Outcome::Located(_) => 1,
        Outcome::Unexplained { .. } => 2,
        Outcome::OutOfRange { .. } => 3,
        Outcome::Incomplete { .. } => 4,
    };
    let mut m = DiagnosisMessage {
        outcome,
        is_final: u32::from(r.is_final),
        contradicting: contradicting(&d.outcome)
            .iter()
            .fold(0, |bits, f| bits | 1 << *f as u32),
        actuator: to_text(&r.run.actuator),
        parameters: to_number(&r.run.parameters),
        sequence: to_number(&r.run.sequence),
        run: r.run.run,
        stream: r.stream,
        fsj_lo: of(|a| a.fsj.lo),
        fsj_hi: of(|a| a.fsj.hi),
        fsj_estimate: of(|a| a.centroid.0),
        zeta_lo: of(|a| a.zeta.lo),
        zeta_hi: of(|a| a.zeta.hi),
        zeta_estimate: of(|a| a.centroid.1),
        area: of(|a| a.size),
        coverage: d.coverage,
        features: Feature::TOLD.map(|f| known(d.features.get(f))),
        samples_received: r.samples_received,
        samples_lost: r.samples_lost,
        telemetry_ns: r.telemetry_ns,
        ..DiagnosisMessage::default()
    };
    m.set_reason(d.outcome.reason());
    m
}

/// Reports as a table, one row each.
pub fn to_batch(rows: &[Logged]) -> RecordBatch {
    let mut fields = Vec::new();
    let mut columns: Vec<ArrayRef> = Vec::new();
    let mut add = |name: &str, kind: DataType, nullable: bool, column: ArrayRef| {
        fields.push(Field::new(name, kind, nullable));
        columns.push(column);
    };
    let text =
        |f: &dyn Fn(&Logged) -> String| -> ArrayRef { Arc::new(StringArray::from_iter_values(rows.iter().map(f))) };
    let count = |f: fn(&Logged) -> u64| -> ArrayRef { Arc::new(UInt64Array::from_iter_values(rows.iter().map(f))) };
    let number =
        |f: &dyn Fn(&Logged) -> Option<f64>| -> ArrayRef { Arc::new(Float64Array::from_iter(rows.iter().map(f))) };
    let time = Int64Array::from_iter_values(rows.iter().map(|r| r.time_ns));
    add("time_ns", DataType::Int64, false, Arc::new(time));
    add(
        "actuator",
        DataType::Utf8,
        false,
        text(&|r| r.report.run.actuator.clone()),
    );
    add(
        "parameters",
        DataType::Utf8,
        false,
        text(&|r| r.report.run.parameters.clone()),
    );
    add(
        "sequence",
        DataType::Utf8,
        false,
        text(&|r| r.report.run.sequence.clone()),
    );
    add("run", DataType::UInt64, false, count(|r| r.report.run.run));
    add("stream", DataType::UInt64, false, count(|r| r.report.stream));
    let last = BooleanArray::from_iter(rows.iter().map(|r| Some(r.report.is_final)));
    add("final", DataType::Boolean, false, Arc::new(last));
    add(
        "outcome",
        DataType::Utf8,
        false,
        text(&|r| r.report.diagnosis.outcome.name().into()),
    );
    type OfArea = fn(&Area) -> f64;
    let of_area: [(&str, OfArea); 7] = [
        ("fsj_lo", |a| a.fsj.lo),
        ("fsj_hi", |a| a.fsj.hi),
        ("fsj_estimate", |a| a.centroid.0),
        ("zeta_lo", |a| a.zeta.lo),
        ("zeta_hi", |a| a.zeta.hi),
        ("zeta_estimate", |a| a.centroid.1),
        ("area", |a| a.size),
    ];
    for (name, f) in of_area {
        let column = number(&|r| r.report.diagnosis.outcome.area().map(f));
        add(name, DataType::Float64, true, column);
    }
    add(
        "coverage",
        DataType::Float64,
        false,
        number(&|r| Some(r.report.diagnosis.coverage)),
    );
    for f in Feature::TOLD {
        let column = number(&|r| r.report.diagnosis.features.get(f));
        add(f.key(), DataType::Float64, true, column);
    }
    let names = |r: &Logged| {
        let list: Vec<&str> = contradicting(&r.report.diagnosis.outcome)
            .iter()
            .map(|f| f.name())
            .collect();
        list.join(",")
    };
    add("contradicting", DataType::Utf8, false, text(&names));
    add(
        "reason",
        DataType::Utf8,
        false,
        text(&|r| r.report.diagnosis.outcome.reason().into()),
    );
    add(
        "samples_received",
        DataType::UInt64,
        false,
        count(|r| r.report.samples_received),
    );
    add(
        "samples_lost",
        DataType::UInt64,
        false,
        count(|r| r.report.samples_lost),
    );
    add(
        "telemetry_ns",
        DataType::UInt64,
        false,
        count(|r| r.report.telemetry_ns),
    );
    add("publish_ns", DataType::UInt64, false, count(|r| r.publish_ns));
    RecordBatch::try_new(Arc::new(Schema::new(fields)), columns).expect("columns of one length")
}
