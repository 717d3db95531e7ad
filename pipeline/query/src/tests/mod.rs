//! Small datasets whose answers can be worked out by hand.

mod questions;
mod statement;
mod tables;

use polars::prelude::*;
use std::path::Path;

/// Writes a table as one Parquet file; its folder is made.
fn write(path: &Path, mut frame: DataFrame) {
    std::fs::create_dir_all(path.parent().unwrap()).unwrap();
    let file = std::fs::File::create(path).unwrap();
    ParquetWriter::new(file).finish(&mut frame).unwrap();
}

/// Number in row `i`; NaN for null.
fn number(frame: &DataFrame, column: &str, i: usize) -> f64 {
    match frame.column(column).unwrap().get(i).unwrap() {
        AnyValue::Null => f64::NAN,
        v => v.extract::<f64>().unwrap(),
    }
}

fn word(frame: &DataFrame, column: &str, i: usize) -> String {
    frame.column(column).unwrap().str().unwrap().get(i).unwrap().to_string()
}

fn truth(frame: &DataFrame, column: &str, i: usize) -> Option<bool> {
    frame.column(column).unwrap().bool().unwrap().get(i)
}

#[track_caller]
fn near(found: f64, right: f64) {
    assert!(
        (found - right).abs() <= 1e-9 * right.abs().max(1.0),
        "found {found}, right {right}"
    );
}

/// The only row in which the columns have the values.
#[track_caller]
fn row(frame: &DataFrame, words: &[(&str, &str)], numbers: &[(&str, f64)]) -> usize {
    let right = |&i: &usize| {
        words.iter().all(|(c, w)| word(frame, c, i) == *w) && numbers.iter().all(|(c, x)| number(frame, c, i) == *x)
    };
    let rows: Vec<usize> = (0..frame.height()).filter(right).collect();
    assert_eq!(rows.len(), 1, "{words:?} {numbers:?}");
    rows[0]
}
