//! A file as columns, whoever wrote it.

use crate::container::{Content, content};
use crate::header::{self, Meaning, meaning};
use crate::units;
use crate::{columnar, dialect};
use schemas::error::{Error, Result};
use std::path::Path;

/// Cells of one column.
#[derive(Clone, Debug, PartialEq)]
pub enum Column {
    /// what is not there is NaN
    Numbers(Vec<f64>),
    /// words
    Texts(Vec<String>),
    /// moments [s], from the first of them on
    Moments(Vec<f64>),
    /// of a type that is neither, by its name
    Other(String),
}

/// Where a row of the file is.
#[derive(Clone, Debug)]
pub(crate) enum Places {
    /// lines of the rows
    Lines(Vec<u64>),
    /// rows from 1
    Rows,
}

/// A column that was not in the file under this name and unit.
#[derive(Clone, Debug)]
struct Made {
    name: &'static str,
    /// header of the column that it was made of
    from: String,
    /// unit that the file stated for that
    unit: Option<String>,
    factor: f64,
}

/// Who says in which unit a column is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum UnitFrom<'a> {
    /// the file: the column has been brought to SI
    File,
    /// the bench file
    Bench,
    /// the header, of a column that is none of telemetry
    Header(&'a str),
    /// nobody
    Nobody,
}

/// A file in memory. Columns of telemetry stand there under our names and in SI units beside those of the file.
#[derive(Clone, Debug)]
pub struct Table {
    /// path, as given
    pub file: String,
    /// headers as they are in the file, then the columns that were made
    pub names: Vec<String>,
    /// by header
    pub columns: Vec<Column>,
    /// of each column
    pub rows: usize,
    /// hash of the file's bytes
    pub hash: String,
    pub(crate) places: Places,
    made: Vec<Made>,
}

impl Table {
    /// Reads a file: CSV in any dialect, Parquet, Arrow IPC.
    ///
    /// # Errors
    /// What is none of these, is not whole, has no header, names a column twice, or states a unit that the channel cannot
    /// have.
    pub fn read(path: &Path) -> Result<Self> {
        let bytes = std::fs::read(path).map_err(|e| Error::io(path, "cannot be read", e))?;
        let raw = match content(path, &bytes)? {
            Content::Parquet => columnar::parquet(path)?,
            Content::Arrow { is_stream } => columnar::ipc(path, &bytes, is_stream)?,
            Content::Text(text) => dialect::read(path, &text)?,
        };
        let mut table = Self {
            file: path.display().to_string(),
            names: raw.names,
            columns: raw.columns,
            rows: raw.rows,
            hash: schemas::fingerprint::fingerprint_bytes(&bytes),
            places: raw.places,
            made: Vec::new(),
        };
        table.make_telemetry(&raw.units)?;
        Ok(table)
    }

    /// As [`Table::read`], of a table that has rows.
    ///
    /// # Errors
    /// As [`Table::read`]; no rows.
    pub fn filled(path: &Path) -> Result<Self> {
        let table = Self::read(path)?;
        if table.rows == 0 {
            let why = "no rows of data; allowed: a header and at least one row";
            return Err(Error::torn(path, why));
        }
        Ok(table)
    }

    /// Adds the columns of telemetry under our names and in SI units, where they are called or measured otherwise.
    ///
    /// * `units` what a row below the header states
    fn make_telemetry(&mut self, below: &[Option<String>]) -> Result<()> {
        let mut known: Vec<(Meaning, Option<String>, usize, usize)> = Vec::new();
        for (i, name) in self.names.iter().enumerate() {
            let Some((m, unit, far)) = meaning(name) else { continue };
            let unit = unit.or_else(|| below.get(i).cloned().flatten());
            match known.iter_mut().find(|k| k.0 == m) {
                None => known.push((m, unit, far, i)),
                Some(k) if far < k.2 => *k = (m, unit, far, i),
                Some(k) if far == k.2 => {
                    let found = format!("`{}` beside `{name}`", self.names[k.3]);
                    return Err(Error::bad(
                        &self.file,
                        "header",
                        found,
                        format!("one column {}", m.name()),
                    ));
                }
                Some(_) => {}
            }
        }
        for (m, unit, _, i) in known {
            let is_moment = matches!(self.columns[i], Column::Moments(_));
            let factor = match &unit {
                // moments are seconds whatever a header says
                Some(unit) if !is_moment => units::stated(m.quantity(), unit).map_err(|allowed| {
                    let place = format!("header, column `{}`", self.names[i]);
                    Error::bad(&self.file, place, format!("unit `{unit}`"), format!("one of {allowed}"))
                })?,
                _ => 1.0,
            };
            if self.names[i] == m.name() && factor == 1.0 {
                continue;
            }
            let column = match &self.columns[i] {
                Column::Numbers(v) if factor != 1.0 => Column::Numbers(v.iter().map(|x| x * factor).collect()),
                other => other.clone(),
            };
            let from = self.names[i].clone();
            let made = Made {
                name: m.name(),
                from,
                unit,
                factor,
            };
            if self.names[i] == m.name() {
                self.columns[i] = column;
            } else {
                self.names.push(m.name().into());
                self.columns.push(column);
            }
            self.made.push(made);
        }
        Ok(())
    }

    /// Adds a column.
    pub fn push(&mut self, name: &str, values: Vec<f64>) {
        self.names.push(name.into());
        self.columns.push(Column::Numbers(values));
    }

    fn position(&self, name: &str) -> Option<usize> {
        // what was made stands behind what it may be called like
        let exact = self.names.iter().rposition(|n| n == name);
        let alike = || {
            let wanted = header::plain(name);
            let spelt = |n: &String| header::plain(n) == wanted || header::plain(header::split(n).0) == wanted;
            let mut all = (0..self.names.len()).filter(|&i| spelt(&self.names[i]));
            all.next().filter(|_| all.next().is_none())
        };
        exact.or_else(alike)
    }

    /// Whether there is a column of this name.
    pub fn has(&self, name: &str) -> bool {
        self.position(name).is_some()
    }

    /// Where a cell is, in words.
    pub fn place(&self, row: usize, column: &str) -> String {
        match &self.places {
            Places::Lines(lines) => format!("line {}, column `{column}`", lines[row]),
            Places::Rows => format!("row {}, column `{column}`", row + 1),
        }
    }

    fn column(&self, name: &str) -> Result<&Column> {
        self.position(name).map(|c| &self.columns[c]).ok_or_else(|| {
            let allowed = format!("one of {}", listed(&self.names));
            Error::bad(&self.file, "header", format!("no column `{name}`"), allowed)
        })
    }

    /// A column of numbers; moments are seconds from the first row on.
    ///
    /// # Errors
    /// No such column, one of words (with the place of the first), one of another type.
    pub fn numbers(&self, name: &str) -> Result<&[f64]> {
        match self.column(name)? {
            Column::Numbers(v) | Column::Moments(v) => Ok(v),
            Column::Texts(v) => {
                let row = v.iter().position(|t| t.parse::<f64>().is_err()).unwrap_or(0);
                let found = format!("`{}`", v[row]);
                Err(Error::bad(&self.file, self.place(row, name), found, "a number"))
            }
            Column::Other(kind) => {
                let place = format!("column `{name}`");
                Err(Error::bad(&self.file, place, kind, "numbers"))
            }
        }
    }

    /// Whether a column holds moments of a calendar or of a day, which say nothing of when the test began.
    pub fn is_moments(&self, name: &str) -> bool {
        matches!(self.column(name), Ok(Column::Moments(_)))
    }

    /// Who says in which unit a column is: the file, whose word has been obeyed, a bench file, or the column's header.
    ///
    /// * `said` in the bench file
    /// * `si` unit of the quantity
    ///
    /// # Errors
    /// A unit that is against what the file states. (A column that was made of one of another name is in SI units:
    /// saying so is no contradiction.)
    pub fn unit_from(&self, name: &str, said: Option<&str>, si: &str) -> Result<UnitFrom<'_>> {
        let made = self.made.iter().find(|m| m.name == name);
        match (made.and_then(|m| Some((m, m.unit.as_deref()?))), said) {
            (Some((made, stated)), Some(unit)) if stated != unit && !(made.from != made.name && unit == si) => {
                let place = format!("column `{name}`, unit of the bench file");
                let allowed = format!("`{stated}`, as the file itself says, or nothing");
                Err(Error::bad(&self.file, place, format!("`{unit}`"), allowed))
            }
            (Some(_), _) => Ok(UnitFrom::File),
            (None, Some(_)) => Ok(UnitFrom::Bench),
            (None, None) => {
                let header = self.position(name).map(|c| self.names[c].as_str());
                Ok(header
                    .and_then(|h| header::split(h).1)
                    .map_or(UnitFrom::Nobody, UnitFrom::Header))
            }
        }
    }

    /// What was brought from other names and units, in words; not what is merely spelt otherwise.
    pub fn said(&self) -> Vec<String> {
        let words = |m: &Made| {
            let is_converted = m.factor != 1.0;
            let is_renamed = header::plain(header::split(&m.from).0) != m.name;
            let unit = m.unit.as_ref().filter(|_| is_converted);
            let unit = unit.map_or(String::new(), |u| format!(" in {u}"));
            // as our own files have it
            let is_usual = m.from == "t_ns";
            (!is_usual && (is_converted || is_renamed)).then(|| format!("{} from `{}`{unit}", m.name, m.from))
        };
        self.made.iter().filter_map(words).collect()
    }

    /// The cells of a column as texts.
    ///
    /// # Errors
    /// No such column, or one of another type.
    pub fn texts(&self, name: &str) -> Result<Vec<String>> {
        Ok(match self.column(name)? {
            Column::Texts(v) => v.clone(),
            _ => self.numbers(name)?.iter().map(|x| x.to_string()).collect(),
        })
    }
}

/// Names of columns for an error: at most twenty.
pub(crate) fn listed(names: &[String]) -> String {
    const MOST: usize = 20;
    match names.get(..MOST) {
        Some(first) if names.len() > MOST => format!("{} ... ({} columns)", first.join(","), names.len()),
        _ => names.join(","),
    }
}
