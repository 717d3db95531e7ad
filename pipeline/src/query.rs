//! SQL over a dataset with polars: tables `runs`, `features` and `maps`, lazy and streaming.

use crate::maps::scan;
use anyhow::{Context, Result};
use polars::prelude::*;
use polars::sql::SQLContext;
use schemas::error::Error;
use std::path::Path;

/// Tables that a dataset folder offers, with what they hold.
pub const TABLES: [(&str, &str); 3] = [
    ("runs", "telemetry, one row a sample (runs/*.parquet)"),
    (
        "features",
        "one row a run, p1_rad_per_s and p3 over the healthy run (features/*.parquet)",
    ),
    ("maps", "failure maps, one row a grid point and feature (maps.parquet)"),
];

/// Features with P1 and P3 over the healthy run of the same rest angle.
fn features(dir: &Path) -> Result<LazyFrame> {
    let raw = scan(&dir.join("features/*.parquet"))?;
    let healthy = raw
        .clone()
        .filter(col("fsj").eq(lit(1.0)).and(col("zeta").eq(lit(0.0))))
        .select([
            col("rest_angle_rad"),
            col("mean_speed_rad_per_s").alias("mean_0"),
            col("p3_rad").alias("p3_0"),
        ]);
    let on = [col("rest_angle_rad")];
    let d = col("mean_speed_rad_per_s") - col("mean_0");
    let r = col("ripple_rad_per_s");
    Ok(raw
        .join(healthy, on.clone(), on, JoinArgs::new(JoinType::Left))
        .with_columns([
            (r.clone() * r + d.clone() * d.clone()).sqrt().alias("p1_rad_per_s"),
            (lit(0.0) - d).alias("speed_loss_rad_per_s"),
            (col("p3_rad") / col("p3_0")).alias("p3"),
        ])
        .drop(cols(["mean_0", "p3_0"])))
}

/// Runs one SQL statement over the dataset in `dir`.
pub fn query(dir: &Path, sql: &str) -> Result<DataFrame> {
    let mut context = SQLContext::new();
    let mut found = 0;
    if dir.join("runs").is_dir() {
        context.register("runs", scan(&dir.join("runs/*.parquet"))?);
        found += 1;
    }
    if dir.join("features").is_dir() {
        context.register("features", features(dir)?);
        found += 1;
    }
    if dir.join("maps.parquet").is_file() {
        context.register("maps", scan(&dir.join("maps.parquet"))?);
        found += 1;
    }
    if found == 0 {
        let allowed = "a dataset folder with runs/, features/ or maps.parquet";
        return Err(Error::bad(dir.display().to_string(), "folder", "none of its tables", allowed).into());
    }
    let frame = context
        .execute(sql)
        .map_err(|e| Error::bad("query", "SQL", one_line(&e), "see ema query --help"))?;
    let frame = frame.collect_with_engine(Engine::Streaming);
    let frame = frame.map_err(|e| Error::bad("query", "SQL", one_line(&e), "see ema query --help"))?;
    Ok(frame.unwrap_single())
}

fn one_line(e: &PolarsError) -> String {
    e.to_string().lines().next().unwrap_or_default().to_string()
}

/// The text of a value, empty for null.
fn text(v: &AnyValue<'_>) -> String {
    match v {
        AnyValue::Null => String::new(),
        AnyValue::String(s) => s.to_string(),
        AnyValue::StringOwned(s) => s.to_string(),
        AnyValue::Float64(x) => x.to_string(),
        AnyValue::Float32(x) => x.to_string(),
        v => v.to_string(),
    }
}

fn cells(frame: &DataFrame) -> Vec<Vec<AnyValue<'_>>> {
    let columns = frame.columns();
    (0..frame.height())
        .map(|i| columns.iter().map(|c| c.get(i).unwrap_or(AnyValue::Null)).collect())
        .collect()
}

/// As CSV.
pub fn to_csv(frame: &DataFrame) -> Result<String> {
    let mut w = csv::Writer::from_writer(Vec::new());
    w.write_record(frame.get_column_names().iter().map(|n| n.as_str()))?;
    for row in cells(frame) {
        w.write_record(row.iter().map(text))?;
    }
    Ok(String::from_utf8(w.into_inner().context("in memory")?)?)
}

/// As JSON, an array of objects.
pub fn to_json(frame: &DataFrame) -> Result<String> {
    let names: Vec<String> = frame.get_column_names().iter().map(|n| n.to_string()).collect();
    let value = |v: &AnyValue<'_>| match v {
        AnyValue::Null => serde_json::Value::Null,
        AnyValue::Boolean(b) => (*b).into(),
        v if v.is_float() => v.extract::<f64>().map_or(serde_json::Value::Null, Into::into),
        v if v.is_integer() => v.extract::<i64>().map_or(serde_json::Value::Null, Into::into),
        v => text(v).into(),
    };
    let rows: Vec<serde_json::Value> = cells(frame)
        .iter()
        .map(|row| {
            names
                .iter()
                .cloned()
                .zip(row.iter().map(value))
                .collect::<serde_json::Map<_, _>>()
                .into()
        })
        .collect();
    Ok(serde_json::to_string_pretty(&rows)?)
}

/// As Parquet.
pub fn write_parquet(frame: &mut DataFrame, path: &Path) -> Result<()> {
    let mut bytes = Vec::new();
    ParquetWriter::new(&mut bytes).finish(frame)?;
    schemas::error::write_whole(path, &bytes)?;
    Ok(())
}
