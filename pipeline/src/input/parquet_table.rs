//! A recording in Parquet that another program wrote: read as one in CSV is, since it says no more of itself.

use super::Measured;
use super::plain::{NEEDED, Plain, listed};
use anyhow::Result;
use arrow::array::{Array, ArrayRef, AsArray, RecordBatch};
use arrow::compute::cast;
use arrow::datatypes::{DataType, Float64Type, UInt64Type};
use schemas::channel::{Channel, ChannelSet};
use schemas::error::{self, Error};
use schemas::recording::{columns, metadata, read_columns};
use std::path::Path;

/// Columns of the time, and their unit [s]: the first that is there counts.
const TIMES: [(&str, f64); 2] = [("t", 1.0), ("t_ns", 1e-9)];

/// Whether a Parquet file says nothing of what made it: its metadata have no schema version.
///
/// # Errors
/// No whole Parquet file.
pub(super) fn is_plain(path: &Path) -> Result<bool> {
    Ok(!metadata(path)?.contains_key("ema.schema_version"))
}

/// The numbers in the column `run`; `None` for a table without.
///
/// # Errors
/// As [`open`].
pub(super) fn runs(path: &Path) -> Result<Vec<Option<u64>>> {
    let table = Table::of(path)?;
    if !table.has_run {
        return Ok(vec![None]);
    }
    let mut seen = Vec::new();
    read_columns(
        path,
        |n| n == "run",
        |batch| {
            for run in table.runs(batch, 0)? {
                if seen.last() != Some(&Some(run)) {
                    seen.push(Some(run));
                }
            }
            Ok(())
        },
    )?;
    Ok(seen)
}

/// Reads a table; `run` chooses one of several.
///
/// # Errors
/// Missing columns, columns that are no numbers, nulls, several runs without a choice, and what a CSV file is refused
/// for.
pub(super) fn open(path: &Path, run: Option<u64>) -> Result<Measured> {
    let table = Table::of(path)?;
    let plain = Plain::new(path, |i| format!("row {}", i + 1), table.channels);
    let mut reading = Reading {
        table: &table,
        wanted: run,
        seen: Vec::new(),
        rows: 0,
        plain,
    };
    read_columns(path, |n| table.reads(n), |batch| reading.push(batch))?;
    reading.measured()
}

/// What is read of a table.
struct Table<'a> {
    path: &'a Path,
    time: (&'static str, f64),
    channels: ChannelSet,
    has_run: bool,
}

impl<'a> Table<'a> {
    fn of(path: &'a Path) -> Result<Self> {
        let schema = columns(path)?;
        let names: Vec<&str> = schema.fields().iter().map(|f| f.name().as_str()).collect();
        let time = TIMES.into_iter().find(|(n, _)| names.contains(n));
        let absent: Vec<&str> = NEEDED.into_iter().filter(|n| !names.contains(n)).collect();
        let Some(time) = time.filter(|_| absent.is_empty()) else {
            let allowed = format!(
                "columns t or t_ns, {}, or metadata `ema.schema_version`",
                NEEDED.join(", ")
            );
            return Err(Error::bad(path.display().to_string(), "columns", listed(&names), allowed).into());
        };
        Ok(Self {
            path,
            time,
            channels: ChannelSet::of(names.iter().filter_map(|n| Channel::from_name(n))),
            has_run: names.contains(&"run"),
        })
    }

    fn reads(&self, name: &str) -> bool {
        name == "run" || name == self.time.0 || Channel::from_name(name).is_some()
    }

    /// A column of a block as another type, without nulls.
    ///
    /// * `before` rows of the file before the block
    fn column(&self, batch: &RecordBatch, name: &str, to: &DataType, before: usize) -> error::Result<ArrayRef> {
        let file = self.path.display().to_string();
        let column = batch.column_by_name(name).expect("one of those read");
        let place = format!("column `{name}`");
        if !column.data_type().is_numeric() {
            return Err(Error::bad(file, place, column.data_type(), "numbers"));
        }
        let numbers = cast(column, to).map_err(|e| Error::bad(&file, &place, e, format!("{to}")))?;
        match (0..numbers.len()).find(|&i| numbers.is_null(i)) {
            Some(i) => {
                let place = format!("row {}, column `{name}`", before + i + 1);
                Err(Error::bad(file, place, "null", "a number"))
            }
            None => Ok(numbers),
        }
    }

    fn runs(&self, batch: &RecordBatch, before: usize) -> error::Result<Vec<u64>> {
        let numbers = self.column(batch, "run", &DataType::UInt64, before)?;
        Ok(numbers.as_primitive::<UInt64Type>().values().to_vec())
    }

    fn numbers(&self, batch: &RecordBatch, name: &str, before: usize) -> error::Result<Vec<f64>> {
        let numbers = self.column(batch, name, &DataType::Float64, before)?;
        Ok(numbers.as_primitive::<Float64Type>().values().to_vec())
    }
}

/// A table on its way in.
struct Reading<'a> {
    table: &'a Table<'a>,
    wanted: Option<u64>,
    seen: Vec<u64>,
    /// of the file so far
    rows: usize,
    plain: Plain,
}

impl Reading<'_> {
    fn push(&mut self, batch: &RecordBatch) -> error::Result<()> {
        let before = self.rows;
        self.rows += batch.num_rows();
        let taken = self.taken(batch, before)?;
        let (time, unit_s) = self.table.time;
        let times = self.table.numbers(batch, time, before)?;
        for &i in &taken {
            let place = || format!("row {}, column `{time}`", before + i + 1);
            self.plain.push_time(times[i] * unit_s, place)?;
        }
        for c in self.table.channels.iter() {
            let values = self.table.numbers(batch, c.name(), before)?;
            taken.iter().for_each(|&i| self.plain.push(c, values[i]));
        }
        Ok(())
    }

    /// The rows of a block that are of the run wanted, or of the first.
    fn taken(&mut self, batch: &RecordBatch, before: usize) -> error::Result<Vec<usize>> {
        if !self.table.has_run {
            return Ok((0..batch.num_rows()).collect());
        }
        let runs = self.table.runs(batch, before)?;
        for &run in &runs {
            if self.seen.last() != Some(&run) {
                self.seen.push(run);
            }
        }
        let wanted = self.wanted.or(self.seen.first().copied());
        self.plain.set_run(wanted.unwrap_or_default());
        Ok((0..runs.len()).filter(|&i| Some(runs[i]) == wanted).collect())
    }

    fn measured(self) -> Result<Measured> {
        let file = self.table.path.display().to_string();
        match self.wanted {
            None if self.seen.len() > 1 => {
                let found = format!("{} runs", self.seen.len());
                Err(Error::bad(file, "file", found, "one run, or --run NUMBER to choose one").into())
            }
            Some(run) if self.table.has_run && !self.seen.contains(&run) => {
                let allowed = format!("one of the runs {:?}", self.seen);
                Err(Error::bad(file, "file", format!("no run {run}"), allowed).into())
            }
            _ => self.plain.measured(),
        }
    }
}
