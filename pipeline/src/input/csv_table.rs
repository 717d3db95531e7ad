//! A recording in CSV.

use super::Measured;
use super::plain::{NEEDED, Plain, listed};
use anyhow::Result;
use csv::StringRecord;
use schemas::channel::{Channel, ChannelSet};
use schemas::error::Error;
use std::collections::HashSet;
use std::fs::File;
use std::path::Path;

/// Where the columns of the header are.
struct Header {
    names: Vec<String>,
    time: usize,
    channels: Vec<(usize, Channel)>,
}

/// Reads a CSV file.
///
/// # Errors
/// What `schemas/README.md` says is refused, with line and column.
pub(super) fn open(path: &Path) -> Result<Measured> {
    let mut reader = csv::ReaderBuilder::new()
        .trim(csv::Trim::All)
        .from_path(path)
        .map_err(|e| Error::torn(path, e))?;
    let head = reader.headers().map_err(|e| Error::torn(path, e))?;
    let header = Header::of(path, head)?;
    let channels = ChannelSet::of(header.channels.iter().map(|(_, c)| *c));
    let mut table = Plain::new(path, |i| format!("line {}, column `t`", i + 2), channels);
    let mut record = StringRecord::new();
    while let Some(line) = next(path, &mut reader, &mut record, &header)? {
        header.push(path, line, &record, &mut table)?;
    }
    table.measured()
}

/// Reads a row, and gives its line; nothing at the end.
fn next(
    path: &Path,
    reader: &mut csv::Reader<File>,
    record: &mut StringRecord,
    header: &Header,
) -> Result<Option<u64>> {
    let line = reader.position().line();
    match reader.read_record(record) {
        Ok(true) => Ok(Some(record.position().map_or(line, |p| p.line()))),
        Ok(false) => Ok(None),
        Err(e) => {
            let allowed = format!("{} columns", header.names.len());
            Err(Error::bad(path.display().to_string(), format!("line {line}"), e, allowed).into())
        }
    }
}

impl Header {
    fn of(path: &Path, head: &StringRecord) -> Result<Self> {
        let file = path.display().to_string();
        let names: Vec<&str> = head.iter().map(|h| h.trim_start_matches('\u{feff}')).collect();
        let mut seen = HashSet::new();
        if let Some((i, n)) = names.iter().enumerate().find(|(_, n)| !seen.insert(**n)) {
            let place = format!("header, column {}", i + 1);
            return Err(Error::bad(file, place, format!("`{n}` again"), "each column once").into());
        }
        let needed: Vec<&str> = std::iter::once("t").chain(NEEDED).collect();
        let absent: Vec<&str> = needed.iter().copied().filter(|n| !seen.contains(n)).collect();
        if !absent.is_empty() {
            let allowed = format!("columns {} (missing: {})", needed.join(","), absent.join(","));
            return Err(Error::bad(file, "header", listed(&names), allowed).into());
        }
        let channel = |(i, n): (usize, &&str)| Channel::from_name(n).map(|c| (i, c));
        Ok(Self {
            time: names.iter().position(|n| *n == "t").expect("checked"),
            channels: names.iter().enumerate().filter_map(channel).collect(),
            names: names.into_iter().map(String::from).collect(),
        })
    }

    /// Adds a row to the table.
    fn push(&self, path: &Path, line: u64, record: &StringRecord, table: &mut Plain) -> Result<()> {
        let place = |i: usize| format!("line {line}, column `{}`", self.names[i]);
        let number = |i: usize| -> Result<f64> {
            let text = &record[i];
            match text.parse::<f64>() {
                Ok(x) if x.is_finite() => Ok(x),
                _ => {
                    let found = if text.is_empty() { "nothing" } else { text };
                    Err(Error::bad(path.display().to_string(), place(i), found, "a finite number").into())
                }
            }
        };
        table.push_time(number(self.time)?, || place(self.time))?;
        for &(i, c) in &self.channels {
            table.push(c, number(i)?);
        }
        Ok(())
    }
}
