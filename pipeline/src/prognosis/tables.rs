//! Tables of outlooks: `trends`, `prognoses`, `alarms`.

use super::Told;
use anyhow::Result;
use arrow::array::{ArrayRef, Float64Array, RecordBatch, StringArray, UInt32Array};
use arrow::datatypes::{Field, Schema};
use diagnoser::prognosis::fleet::COVERAGE;
use diagnoser::prognosis::forecast::quantile;
use diagnoser::prognosis::history::Ends;
use diagnoser::prognosis::law::Family;
use diagnoser::prognosis::{Outlook, Status};
use schemas::table::write_table;
use std::path::Path;
use std::sync::Arc;

/// Quantiles that a prognosis keeps.
const QUANTILES: [(&str, f64); 5] = [
    ("rul_p05", 0.05),
    ("rul_p25", 0.25),
    ("rul_p50", 0.5),
    ("rul_p75", 0.75),
    ("rul_p95", 0.95),
];

/// Columns in the making.
#[derive(Default)]
struct Columns(Vec<(String, ArrayRef)>);

impl Columns {
    fn text(&mut self, name: &str, values: impl Iterator<Item = String>) {
        self.0
            .push((name.into(), Arc::new(StringArray::from_iter_values(values))));
    }

    fn number(&mut self, name: &str, values: impl Iterator<Item = Option<f64>>) {
        // infinite is never, and never is nothing
        let finite = values.map(|v| v.filter(|x| x.is_finite()));
        self.0.push((name.into(), Arc::new(finite.collect::<Float64Array>())));
    }

    /// Three columns: lower end, upper end, estimate.
    fn ends<I: Iterator<Item = Option<f64>>>(&mut self, name: &str, of: impl Fn(fn(Ends) -> f64) -> I) {
        self.number(&format!("{name}_lo"), of(|e| e.0));
        self.number(&format!("{name}_hi"), of(|e| e.1));
        self.number(name, of(|e| e.2));
    }

    fn count(&mut self, name: &str, values: impl Iterator<Item = u32>) {
        self.0
            .push((name.into(), Arc::new(UInt32Array::from_iter_values(values))));
    }

    fn write(self, path: &Path) -> Result<()> {
        let fields: Vec<Field> = self
            .0
            .iter()
            .map(|(n, a)| {
                Field::new(
                    n,
                    a.data_type().clone(),
                    matches!(a.data_type(), arrow::datatypes::DataType::Float64),
                )
            })
            .collect();
        let batch = RecordBatch::try_new(Arc::new(Schema::new(fields)), self.0.into_iter().map(|c| c.1).collect())?;
        write_table(
            path,
            &batch,
            vec![("ema.schema_version".into(), schemas::SCHEMA_VERSION.to_string())],
        )?;
        Ok(())
    }
}

/// Writes the three tables into a folder.
///
/// # Errors
/// What the disk refuses.
pub fn write(dir: &Path, told: &[Told]) -> Result<()> {
    trends(told).write(&dir.join("trends.parquet"))?;
    prognoses(told).write(&dir.join("prognoses.parquet"))?;
    alarms(told).write(&dir.join("alarms.parquet"))
}

fn trends(told: &[Told]) -> Columns {
    let rows = || {
        told.iter()
            .filter_map(|t| Some((t, t.scale?, &t.track.as_ref()?.1)))
            .flat_map(|(t, scale, track)| track.trends.iter().map(move |r| (t, scale, r)))
    };
    let mut c = Columns::default();
    c.text("actuator", rows().map(|r| r.0.outlook.actuator.clone()));
    c.text("fault", rows().map(|r| r.0.threshold.fault.clone()));
    c.text("clock", rows().map(|r| r.0.clock.name().into()));
    c.number("at", rows().map(|r| Some(r.2.at)));
    c.text("outcome", rows().map(|r| r.2.ended.name().into()));
    c.text("used", rows().map(|r| r.2.used.name().into()));
    let level = |pick: fn(Ends) -> f64| rows().map(move |(_, s, r)| Some(pick(s.level_of(r.damage))));
    c.ends("level", level);
    let rate = |pick: fn(Ends) -> f64| rows().map(move |(_, s, r)| Some(pick(s.rate_of(r.log_rate))));
    c.ends("rate", rate);
    c.number("innovation", rows().map(|r| Some(r.2.innovation)));
    c.number("p_change", rows().map(|r| Some(r.2.changed)));
    c.text("law", rows().map(|r| r.2.law.name().into()));
    c.count("segment", rows().map(|r| r.2.segment));
    c
}

fn prognoses(told: &[Told]) -> Columns {
    let mut c = Columns::default();
    let o = || told.iter().map(|t| &t.outlook);
    c.text("actuator", o().map(|o| o.actuator.clone()));
    c.text("fault", told.iter().map(|t| t.threshold.fault.clone()));
    c.number("threshold", told.iter().map(|t| Some(t.threshold.level)));
    c.text("clock", told.iter().map(|t| t.clock.name().into()));
    c.number("at", o().map(|o| Some(o.at)));
    c.text("status", o().map(|o| o.status.name().into()));
    c.text("reason", o().map(|o| o.reason.clone()));
    c.count("tests", o().map(|o| o.tests as u32));
    c.count("used", o().map(|o| o.used as u32));
    c.ends("level", |pick| o().map(move |o| o.level.map(pick)));
    c.ends("rate", |pick| o().map(move |o| o.rate.map(pick)));
    for (name, p) in QUANTILES {
        c.number(name, o().map(move |o| o.left.as_ref().map(|l| quantile(&l.times, p))));
    }
    c.number("rul_lo", o().map(|o| o.rul().map(|r| r.0)));
    c.number("rul_hi", o().map(|o| o.rul().map(|r| r.1)));
    // null: not calibrated
    let calibrated = |o: &Outlook| o.left.as_ref().and_then(|l| l.calibrated);
    c.number("coverage", o().map(|o| calibrated(o).map(|_| COVERAGE)));
    c.number("calibration_lives", o().map(|o| calibrated(o).map(|n| n as f64)));
    let horizons: Vec<f64> = o()
        .find(|o| !o.p_fail.is_empty())
        .map_or(Vec::new(), |o| o.p_fail.iter().map(|p| p.0).collect());
    for (k, h) in horizons.iter().enumerate() {
        c.number(&format!("p_{h}"), o().map(move |o| o.p_fail.get(k).map(|p| p.1)));
    }
    c.number("p_never", o().map(|o| o.p_never));
    for (k, f) in Family::ALL.into_iter().enumerate() {
        c.number(
            &format!("law_{}", f.name()),
            o().map(move |o| o.laws.get(k).map(|l| l.1)),
        );
    }
    c.number("change_at", o().map(|o| o.change.map(|c| c.at)));
    c.number("change_factor", o().map(|o| o.change.map(|c| c.factor)));
    c.number("next_test", o().map(|o| o.next_test));
    c.number("next_inspection", o().map(|o| o.next_inspection));
    c.number("risk", o().map(|o| Some(o.risk)));
    c
}

fn alarms(told: &[Told]) -> Columns {
    let rows = || told.iter().flat_map(|t| t.outlook.alarms.iter().map(move |a| (t, a)));
    let mut c = Columns::default();
    c.text("actuator", rows().map(|r| r.0.outlook.actuator.clone()));
    c.text("fault", rows().map(|r| r.0.threshold.fault.clone()));
    c.text("clock", rows().map(|r| r.0.clock.name().into()));
    c.number("at", rows().map(|r| Some(r.1.at)));
    c.text("kind", rows().map(|r| r.1.kind.name().into()));
    c.number("probability", rows().map(|r| Some(r.1.probability)));
    c.number("since_lo", rows().map(|r| Some(r.1.since.0)));
    c.number("since_hi", rows().map(|r| Some(r.1.since.1)));
    c.text("text", rows().map(|r| r.1.text.clone()));
    c
}

/// Worst first: what is passed or refused, then by the probability of failure and the time left.
pub fn by_risk(told: &[Told]) -> Vec<&Told> {
    let mut out: Vec<&Told> = told.iter().collect();
    let key = |t: &Told| {
        let o = &t.outlook;
        let rank = match o.status {
            Status::Passed => 0,
            Status::Ok | Status::Doubtful => 1,
            Status::Refused => 2,
            Status::TooEarly => 3,
        };
        (
            rank,
            o.rul().map_or(f64::INFINITY, |r| r.0),
            o.rul().map_or(f64::INFINITY, |r| r.2),
        )
    };
    out.sort_by(|a, b| {
        let (a, b) = (key(a), key(b));
        a.0.cmp(&b.0).then(a.1.total_cmp(&b.1)).then(a.2.total_cmp(&b.2))
    });
    out
}
