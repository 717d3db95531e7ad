//! SQL and ready questions over a dataset folder.
//!
//! Tables are lazy scans of Parquet files: filters and column choices of a statement reach the files, so
//! that only the folders, row groups and columns that are needed are read. Questions read their columns
//! the same way and do their statistics here, on dense group numbers: medians over a fleet need grouped
//! values more than they need a query engine.
//!
//! A package and a program of its own: who simulates, builds maps and diagnoses compiles no query engine.
//!
//! Where to begin: [`query`] takes any SQL over the tables of [`Table`], [`Question::ask`] has what is asked again and
//! again. [`output`] turns a frame into text, CSV, JSON and Parquet. The columns are specified in `schemas/README.md`.
//!
//! A dataset is a folder of folders with Parquet files; here it has one table of three runs:
//!
//! ```
//! use polars::prelude::*;
//!
//! let dataset = tempfile::tempdir()?;
//! std::fs::create_dir(dataset.path().join("features"))?;
//! let file = std::fs::File::create(dataset.path().join("features/part-0000.parquet"))?;
//! let mut runs = df!("run" => [0u64, 1, 2], "fsj" => [1.0, 2.0, 3.0], "p2_a" => [0.25, 0.5, 0.75])?;
//! ParquetWriter::new(file).finish(&mut runs)?;
//!
//! let answer = ema_query::query(dataset.path(), "SELECT max(p2_a) AS most FROM features WHERE fsj < 2.5")?;
//! println!("{}", ema_query::to_table(&answer, 0));
//! # assert_eq!(answer.column("most")?.f64()?.get(0), Some(0.5));
//! # Ok::<(), anyhow::Error>(())
//! ```

#![warn(missing_docs, clippy::missing_errors_doc)]

pub mod cli;
pub mod fleet;
pub mod output;
pub mod questions;
mod statement;
pub mod stats;
pub mod tables;
#[cfg(test)]
mod tests;

pub use fleet::Fleet;
pub use output::to_table;
pub use questions::Question;
pub use tables::Table;

use anyhow::Result;
use polars::prelude::*;
use polars::sql::SQLContext;
use schemas::error::Error;
use statement::Asked;
use std::path::Path;

/// A table, and what to know beside it.
#[derive(Debug)]
pub struct Answer {
    /// The table, its columns in the order in which they are shown.
    pub frame: DataFrame,
    /// One line each: what was left out, and which limits hold.
    pub notes: Vec<String>,
}

/// The statement as a lazy table.
fn plan(dir: &Path, sql: &str) -> Result<LazyFrame> {
    let there: Vec<Table> = Table::ALL.into_iter().filter(|t| t.there(dir)).collect();
    if there.is_empty() {
        let allowed = "a dataset folder (ema simulate, ema dataset make)";
        return Err(Error::bad(dir.display().to_string(), "folder", "none of its tables", allowed).into());
    }
    let (sql, named) = match statement::read(sql)? {
        Asked::Tables => return Ok(names(&there)?.lazy()),
        Asked::Query { sql, tables } => (sql, tables),
    };
    let mut context = SQLContext::new();
    // a table that the statement does not name costs nothing
    for table in named.iter().filter(|t| there.contains(t)) {
        context.register(table.name(), table.scan(dir)?);
    }
    let planned = guarded(|| context.execute(&sql));
    Ok(planned.map_err(|why| {
        let quoted = |t: &&Table| !there.contains(t) && why.contains(&format!("'{}'", t.name()));
        match named.iter().find(quoted) {
            Some(table) => table.missing(dir),
            None => bad_sql(why),
        }
    })?)
}

/// The names of tables, in alphabetical order.
fn names(tables: &[Table]) -> Result<DataFrame> {
    let mut names: Vec<&str> = tables.iter().map(|t| t.name()).collect();
    names.sort_unstable();
    Ok(df!("name" => names)?)
}

/// Runs one SQL query over the dataset in `dir`: SELECT, or SHOW TABLES, or EXPLAIN of one.
///
/// # Errors
/// No tables in the folder, a table or column that is not there, SQL that is none or no query, a table function, a torn
/// file.
pub fn query(dir: &Path, sql: &str) -> Result<DataFrame> {
    let frame = plan(dir, sql)?;
    run(frame).map_err(|why| bad_sql(why).into())
}

/// The plan of a statement after optimisation: what is read from which files.
///
/// # Errors
/// As [`query`], but for what is torn behind a file's footer: that is not read here.
pub fn explain(dir: &Path, sql: &str) -> Result<String> {
    let frame = plan(dir, sql)?;
    Ok(guarded(|| frame.explain(true)).map_err(bad_sql)?)
}

fn bad_sql(why: String) -> Error {
    Error::bad("query", "SQL", why, "see ema query --help")
}

/// Runs a lazy table through the streaming engine. The error is one line.
pub(crate) fn run(frame: LazyFrame) -> Result<DataFrame, String> {
    guarded(|| frame.collect_with_engine(Engine::Streaming).map(|f| f.unwrap_single()))
}

/// Some broken Parquet files make the reader panic instead of saying so.
fn guarded<T>(work: impl FnOnce() -> PolarsResult<T>) -> Result<T, String> {
    match schemas::guard::guarded(work) {
        Ok(result) => result.map_err(|e| one_line(&e)),
        Err(_) => Err("a file that cannot be read, or a query that polars cannot carry out".into()),
    }
}

pub(crate) fn one_line(e: &PolarsError) -> String {
    e.to_string().lines().next().unwrap_or_default().to_string()
}
