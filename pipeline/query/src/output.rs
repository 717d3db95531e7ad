//! Tables as text, CSV, JSON and Parquet.

use anyhow::{Context, Result};
use polars::prelude::*;
use std::path::Path;

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

fn rows(frame: &DataFrame) -> impl Iterator<Item = Vec<AnyValue<'_>>> {
    let columns = frame.columns();
    (0..frame.height()).map(|i| columns.iter().map(|c| c.get(i).unwrap_or(AnyValue::Null)).collect())
}

/// Five significant digits; powers of ten only for numbers far from 1.
fn short(x: f64) -> String {
    if !x.is_finite() {
        return x.to_string();
    }
    // + 0 takes the sign off a zero
    let rounded = format!("{x:.4e}").parse().unwrap_or(x) + 0.0;
    if rounded != 0.0 && !(1e-4..1e9).contains(&rounded.abs()) {
        format!("{rounded:e}")
    } else {
        rounded.to_string()
    }
}

/// For reading: aligned columns, floats with five digits, at most `most` rows (0: all), and then a line that says
/// how many more there are.
pub fn to_table(frame: &DataFrame, most: usize) -> String {
    let shown = if most == 0 {
        frame.height()
    } else {
        most.min(frame.height())
    };
    let cell = |v: &AnyValue<'_>| match v {
        AnyValue::Null => "-".to_string(),
        AnyValue::Float64(x) => short(*x),
        AnyValue::Float32(x) => short(*x as f64),
        v => text(v).replace(['\n', '\r', '\t'], " "),
    };
    let mut lines: Vec<Vec<String>> = vec![frame.get_column_names().iter().map(|n| n.to_string()).collect()];
    lines.extend(rows(frame).take(shown).map(|r| r.iter().map(cell).collect()));
    let right: Vec<bool> = frame
        .columns()
        .iter()
        .map(|c| c.dtype().is_primitive_numeric())
        .collect();
    let width = |k: usize| lines.iter().map(|l| l[k].chars().count()).max().unwrap_or(0);
    let widths: Vec<usize> = (0..frame.width()).map(width).collect();
    let mut out = String::new();
    for line in &lines {
        let pad = |(k, s): (usize, &String)| {
            let w = widths[k];
            if right[k] {
                format!("{s:>w$}")
            } else {
                format!("{s:<w$}")
            }
        };
        let cells: Vec<String> = line.iter().enumerate().map(pad).collect();
        out += cells.join("  ").trim_end();
        out += "\n";
    }
    if shown < frame.height() {
        let more = frame.height() - shown;
        out += &format!("{more} more rows (--rows 0 shows all, --format csv writes all)\n");
    }
    out
}

/// As CSV.
///
/// # Errors
/// None that input could cause.
pub fn to_csv(frame: &DataFrame) -> Result<String> {
    let mut w = csv::Writer::from_writer(Vec::new());
    w.write_record(frame.get_column_names().iter().map(|n| n.as_str()))?;
    for row in rows(frame) {
        w.write_record(row.iter().map(text))?;
    }
    Ok(String::from_utf8(w.into_inner().context("in memory")?)?)
}

/// As JSON, an array of objects.
///
/// # Errors
/// None that input could cause.
pub fn to_json(frame: &DataFrame) -> Result<String> {
    let names: Vec<String> = frame.get_column_names().iter().map(|n| n.to_string()).collect();
    let value = |v: &AnyValue<'_>| match v {
        AnyValue::Null => serde_json::Value::Null,
        AnyValue::Boolean(b) => (*b).into(),
        AnyValue::UInt64(n) => (*n).into(),
        v if v.is_float() => v.extract::<f64>().map_or(serde_json::Value::Null, Into::into),
        v if v.is_integer() => v.extract::<i64>().map_or(serde_json::Value::Null, Into::into),
        v => text(v).into(),
    };
    let rows: Vec<serde_json::Value> = rows(frame)
        .map(|row| {
            let cells = names.iter().cloned().zip(row.iter().map(value));
            cells.collect::<serde_json::Map<_, _>>().into()
        })
        .collect();
    Ok(serde_json::to_string_pretty(&rows)?)
}

/// As Parquet.
///
/// # Errors
/// The file cannot be written.
pub fn write_parquet(frame: &mut DataFrame, path: &Path) -> Result<()> {
    let mut bytes = Vec::new();
    ParquetWriter::new(&mut bytes).finish(frame)?;
    schemas::error::write_whole(path, &bytes)?;
    Ok(())
}
