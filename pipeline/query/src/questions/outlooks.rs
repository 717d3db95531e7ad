//! What a prognosis leaves: who is at risk, what changed, and whose fault grows faster than it did.

use super::Answer;
use crate::Table;
use anyhow::Result;
use polars::prelude::*;
use std::path::Path;

/// Order of the rows by all keys: nulls last, a tie as in the file.
fn order(is_falling: bool) -> SortMultipleOptions {
    let order = SortMultipleOptions::default().with_order_descending(is_falling);
    order.with_nulls_last(true).with_maintain_order(true)
}

/// Worst first: passed, then by the lower end of the remaining life; without a prognosis last.
pub fn at_risk(dir: &Path) -> Result<Vec<LazyFrame>> {
    let passed = col("status").neq(lit("passed"));
    let none = col("rul_lo").is_null();
    let by = [passed, none, col("rul_lo"), col("rul_p50")];
    let columns = [
        "actuator",
        "fault",
        "clock",
        "at",
        "status",
        "level",
        "threshold",
        "rul_lo",
        "rul_p50",
        "rul_hi",
        "coverage",
        "p_never",
        "next_test",
        "next_inspection",
        "reason",
    ];
    let sorted = Table::Prognoses.scan(dir)?.sort_by_exprs(by, order(false));
    Ok(vec![sorted.select(columns.map(col))])
}

/// The latest first.
pub fn what_changed(dir: &Path) -> Result<Vec<LazyFrame>> {
    let columns = [
        "actuator",
        "fault",
        "clock",
        "at",
        "kind",
        "probability",
        "since_lo",
        "since_hi",
        "text",
    ];
    let sorted = Table::Alarms.scan(dir)?.sort_by_exprs([col("at")], order(true));
    Ok(vec![sorted.select(columns.map(col))])
}

/// The greatest acceleration first: the last rate over the median of the rates since the last repair.
pub fn growth(dir: &Path) -> Result<Vec<LazyFrame>> {
    let trends = Table::Trends.scan(dir)?;
    let newest = col("segment").max().over([col("actuator"), col("fault")])?;
    let newest = col("segment").eq(newest);
    let grouped = trends
        .filter(newest)
        .group_by_stable([col("actuator"), col("fault"), col("clock")])
        .agg([
            len().alias("tests"),
            col("at").last(),
            col("level").last(),
            col("rate").last(),
            col("rate_lo").last(),
            col("rate_hi").last(),
            (col("rate").last() / col("rate").median()).alias("rate_over_median"),
            col("law").last(),
        ]);
    Ok(vec![grouped.sort_by_exprs([col("rate_over_median")], order(true))])
}

/// The table as it was read.
pub fn answer(frames: &[DataFrame]) -> Result<Answer> {
    Ok(Answer {
        frame: frames[0].clone(),
        notes: Vec::new(),
    })
}
