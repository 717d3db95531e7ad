//! Parquet and Arrow IPC of any program.

use crate::header::{Meaning, meaning};
use crate::table::{Column, Places};
use crate::units::{self, Quantity};
use arrow::array::{Array, ArrayRef, AsArray, RecordBatch};
use arrow::compute::{cast, concat};
use arrow::datatypes::{DataType, Float64Type, Int64Type, SchemaRef, TimeUnit};
use arrow::ipc::reader::{FileReader, StreamReader};
use schemas::error::{Error, Result};
use schemas::guard::guarded;
use std::io::Cursor;
use std::path::Path;

/// Columns as they are in a file.
pub(crate) struct Raw {
    pub(crate) names: Vec<String>,
    pub(crate) columns: Vec<Column>,
    /// what a row below the header states
    pub(crate) units: Vec<Option<String>>,
    pub(crate) rows: usize,
    pub(crate) places: Places,
}

pub(crate) fn parquet(path: &Path) -> Result<Raw> {
    let (schema, batches) = schemas::table::read_table(path)?;
    columns(path, &schema, &batches)
}

pub(crate) fn ipc(path: &Path, bytes: &[u8], is_stream: bool) -> Result<Raw> {
    let torn = |e: String| Error::torn(path, format!("not a whole Arrow IPC file ({e})"));
    let read = guarded(|| -> std::result::Result<_, arrow::error::ArrowError> {
        if is_stream {
            let r = StreamReader::try_new(Cursor::new(bytes), None)?;
            Ok((r.schema(), r.collect::<std::result::Result<Vec<_>, _>>()?))
        } else {
            let r = FileReader::try_new(Cursor::new(bytes), None)?;
            Ok((r.schema(), r.collect::<std::result::Result<Vec<_>, _>>()?))
        }
    });
    let (schema, batches) = read
        .map_err(|e| torn(e.to_string()))?
        .map_err(|e| torn(e.to_string()))?;
    columns(path, &schema, &batches)
}

fn columns(path: &Path, schema: &SchemaRef, batches: &[RecordBatch]) -> Result<Raw> {
    let names: Vec<String> = schema.fields().iter().map(|f| f.name().clone()).collect();
    let mut columns = Vec::new();
    for (c, name) in names.iter().enumerate() {
        let parts: Vec<&dyn Array> = batches.iter().map(|b| b.column(c).as_ref()).collect();
        columns.push(if parts.is_empty() {
            Column::Numbers(Vec::new())
        } else {
            let whole = concat(&parts).map_err(|e| Error::torn(path, e))?;
            column(path, name, &whole)?
        });
    }
    Ok(Raw {
        units: vec![None; names.len()],
        names,
        columns,
        rows: batches.iter().map(RecordBatch::num_rows).sum(),
        places: Places::Rows,
    })
}

/// * `name` whose nulls are refused by their row where it is a column of telemetry
fn column(path: &Path, name: &str, values: &ArrayRef) -> Result<Column> {
    let kind = values.data_type().clone();
    let known = meaning(name).map(|m| m.0);
    if known.is_some()
        && let Some(row) = (0..values.len()).find(|&i| values.is_null(i))
    {
        let place = format!("row {}, column `{name}`", row + 1);
        return Err(Error::bad(path.display().to_string(), place, "null", "a number"));
    }
    let other = || Ok(Column::Other(kind.to_string()));
    let as_type = |to: &DataType| cast(values, to).ok();
    match &kind {
        DataType::Timestamp(_, _) | DataType::Date32 | DataType::Date64 => {
            let ns = as_type(&DataType::Timestamp(TimeUnit::Nanosecond, None));
            Ok(Column::Moments(ns.map_or(Vec::new(), |ns| since_first(&ns, 1e-9))))
        }
        DataType::Duration(_) => {
            let ns = as_type(&DataType::Duration(TimeUnit::Nanosecond)).and_then(|d| cast(&d, &DataType::Int64).ok());
            ns.map_or_else(other, |ns| {
                let ns = ns.as_primitive::<Int64Type>();
                Ok(Column::Numbers(ns.values().iter().map(|&x| x as f64 * 1e-9).collect()))
            })
        }
        DataType::Time32(_) | DataType::Time64(_) => {
            let ns = as_type(&DataType::Time64(TimeUnit::Nanosecond)).and_then(|t| cast(&t, &DataType::Int64).ok());
            ns.map_or_else(other, |ns| Ok(Column::Moments(since_first(&ns, 1e-9))))
        }
        // nanoseconds of a calendar are beyond what f64 tells apart
        DataType::Int64 | DataType::UInt64 if known == Some(Meaning::Time) => {
            let whole = as_type(&DataType::Int64);
            let is_far = |w: &ArrayRef| w.as_primitive::<Int64Type>().value(0).unsigned_abs() > 1 << 50;
            match whole.filter(is_far) {
                Some(whole) => {
                    let unit = meaning(name).and_then(|m| m.1);
                    let factor = unit.and_then(|u| units::stated(Quantity::Time, &u).ok());
                    Ok(Column::Moments(since_first(&whole, factor.unwrap_or(1.0))))
                }
                None => numbers(values).map_or_else(other, |v| Ok(Column::Numbers(v))),
            }
        }
        DataType::Utf8 | DataType::LargeUtf8 | DataType::Utf8View | DataType::Dictionary(_, _) => {
            match as_type(&DataType::Utf8) {
                Some(texts) => {
                    let texts = texts.as_string::<i32>();
                    let texts: Vec<String> = (0..texts.len()).map(|i| texts.value(i).to_string()).collect();
                    Ok(crate::dialect::moments(&texts).map_or(Column::Texts(texts), Column::Moments))
                }
                None => other(),
            }
        }
        k if k.is_numeric() || *k == DataType::Boolean => {
            numbers(values).map_or_else(other, |v| Ok(Column::Numbers(v)))
        }
        // lists and the like: a column that nobody can use
        _ => other(),
    }
}

/// Any numbers; a null is NaN.
fn numbers(values: &ArrayRef) -> Option<Vec<f64>> {
    let numbers = cast(values, &DataType::Float64).ok()?;
    Some(
        numbers
            .as_primitive::<Float64Type>()
            .iter()
            .map(|x| x.unwrap_or(f64::NAN))
            .collect(),
    )
}

/// Whole numbers as seconds from the first of them on.
///
/// * `unit_s` what one of them is [s]
fn since_first(whole: &ArrayRef, unit_s: f64) -> Vec<f64> {
    let Ok(whole) = cast(whole, &DataType::Int64) else {
        return Vec::new();
    };
    let whole = whole.as_primitive::<Int64Type>().values();
    let first = whole.first().copied().unwrap_or_default();
    whole.iter().map(|x| x.wrapping_sub(first) as f64 * unit_s).collect()
}
