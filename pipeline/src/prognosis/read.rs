//! Histories of diagnoses: logs of `ema live` (JSON lines, Parquet), CSV and Parquet tables; events and truths in CSV.

use super::margin::{Margin, STALL};
use anyhow::Result;
use arrow::array::{Array, AsArray, RecordBatch};
use arrow::compute::cast;
use arrow::compute::kernels::cast_utils::string_to_timestamp_nanos;
use arrow::datatypes::{DataType, Float64Type, TimeUnit};
use csv::StringRecord;
use diagnoser::prognosis::{Ended, Happening};
use schemas::error::Error;
use schemas::table::read_table;
use serde_json::Value;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Seconds of a day.
const DAY_S: f64 = 86_400.0;

/// One cell of a table, whatever kind of file it comes from.
#[derive(Clone, Debug, PartialEq)]
enum Cell {
    Nothing,
    Number(f64),
    Text(String),
}

/// A table by its columns' names, whatever kind of file it comes from.
pub struct Sheet {
    file: String,
    /// what units are called that the table has no column for
    stem: String,
    names: Vec<String>,
    rows: Vec<Vec<Cell>>,
    /// where a row is, for people: its number, and what is counted
    places: Vec<u64>,
    counted: &'static str,
}

/// A moment of a row.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Moment {
    /// days since 1970, of a time of day
    pub day: Option<f64>,
    /// count of a clock: flights, cycles, or whatever numbers the column `time` has
    pub cycle: Option<f64>,
}

/// A level of a row, as it stands there.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Level {
    /// lower end
    pub lo: Option<f64>,
    /// upper end
    pub hi: Option<f64>,
    /// estimate
    pub estimate: Option<f64>,
}

/// One test of one unit, all faults that were asked for.
#[derive(Clone, Debug)]
pub struct Test {
    /// when
    pub moment: Moment,
    /// how it ended
    pub ended: Ended,
    /// stated coverage
    pub coverage: f64,
    /// levels by fault, in the order asked
    pub levels: Vec<Level>,
}

/// Tests by unit, in the order of the file.
pub type Units = BTreeMap<String, Vec<Test>>;

/// What happened to a unit, and to which fault (none: to all).
#[derive(Clone, Debug)]
pub struct Event {
    /// when
    pub moment: Moment,
    /// what
    pub what: Happening,
    /// the word of the file
    pub kind: String,
    /// fault, or empty
    pub fault: String,
}

/// The end of a life.
#[derive(Clone, Debug)]
pub struct End {
    /// when
    pub moment: Moment,
    /// what the file calls it
    pub event: String,
}

impl Sheet {
    /// Reads a file.
    ///
    /// # Errors
    /// A file that cannot be read, or is no table; another ending than .csv, .jsonl, .json, .ndjson or .parquet.
    pub fn read(path: &Path) -> Result<Self> {
        let ending = path
            .extension()
            .and_then(|e| e.to_str())
            .unwrap_or_default()
            .to_ascii_lowercase();
        let stem = path.file_stem().map(|s| s.to_string_lossy().into_owned());
        let mut sheet = Self::empty(path.display().to_string(), stem.unwrap_or_else(|| "unit".into()));
        match ending.as_str() {
            "csv" => sheet.csv(path)?,
            "jsonl" | "json" | "ndjson" => {
                let text = std::fs::read_to_string(path).map_err(|e| Error::io(path, "cannot be read", e))?;
                sheet.json_lines(&text)?;
            }
            "parquet" => sheet.parquet(path)?,
            _ => {
                let allowed = "a table of diagnoses in .csv, .jsonl or .parquet";
                return Err(Error::bad(sheet.file, "file", format!("ending `{ending}`"), allowed).into());
            }
        }
        Ok(sheet)
    }

    fn csv(&mut self, path: &Path) -> Result<()> {
        let text = std::fs::File::open(path).map_err(|e| Error::io(path, "cannot be read", e))?;
        let mut reader = csv::ReaderBuilder::new().trim(csv::Trim::All).from_reader(text);
        let head = reader.headers().map_err(|e| Error::torn(path, e))?.clone();
        let plain = |n: &str| n.trim_start_matches('\u{feff}').to_ascii_lowercase();
        self.names = head.iter().map(plain).collect();
        let mut record = StringRecord::new();
        loop {
            let line = reader.position().line();
            match reader.read_record(&mut record) {
                Ok(false) => return Ok(()),
                Ok(true) => {
                    self.places.push(record.position().map_or(line, |p| p.line()));
                    self.rows.push(record.iter().map(cell).collect());
                }
                Err(e) => {
                    let allowed = format!("{} columns", self.names.len());
                    return Err(Error::bad(&self.file, format!("line {line}"), e, allowed).into());
                }
            }
        }
    }

    /// Lines of a log.
    ///
    /// * `file` for messages
    ///
    /// # Errors
    /// A line that is no JSON object.
    pub fn of_lines(file: &str, text: &str) -> Result<Self> {
        let mut sheet = Self::empty(file.into(), "unit".into());
        sheet.json_lines(text)?;
        Ok(sheet)
    }

    fn empty(file: String, stem: String) -> Self {
        Self {
            file,
            stem,
            names: Vec::new(),
            rows: Vec::new(),
            places: Vec::new(),
            counted: "line",
        }
    }

    fn json_lines(&mut self, text: &str) -> Result<()> {
        for (line, text) in (1..).zip(text.lines()).filter(|l| !l.1.trim().is_empty()) {
            let bad = |e| Error::bad(&self.file, format!("line {line}"), e, "a JSON object");
            let value: Value = serde_json::from_str(text).map_err(bad)?;
            let mut row = vec![Cell::Nothing; self.names.len()];
            for (name, v) in value.as_object().into_iter().flatten() {
                match v {
                    // {"fsj": {"lo": ...}} is fsj_lo
                    Value::Object(parts) => {
                        let named = parts.iter().map(|(k, v)| (format!("{name}_{k}"), v));
                        named.for_each(|(name, v)| self.put(&mut row, &name, v));
                    }
                    v => self.put(&mut row, name, v),
                }
            }
            self.places.push(line);
            self.rows.push(row);
        }
        Ok(())
    }

    /// A value of a row, in a column of its name.
    fn put(&mut self, row: &mut Vec<Cell>, name: &str, value: &Value) {
        let at = self.column(name).unwrap_or_else(|| {
            self.names.push(name.into());
            row.push(Cell::Nothing);
            self.names.len() - 1
        });
        row[at] = match value {
            Value::Number(n) => n.as_f64().map_or(Cell::Nothing, Cell::Number),
            Value::String(s) => Cell::Text(s.clone()),
            Value::Bool(b) => Cell::Text(b.to_string()),
            _ => Cell::Nothing,
        };
    }

    fn parquet(&mut self, path: &Path) -> Result<()> {
        let (schema, batches) = read_table(path)?;
        self.names = schema.fields().iter().map(|f| f.name().to_ascii_lowercase()).collect();
        for b in &batches {
            let columns: Vec<Vec<Cell>> = (0..b.num_columns()).map(|i| cells(path, b, i)).collect::<Result<_>>()?;
            let row = |r: usize| columns.iter().map(|c| c[r].clone()).collect();
            self.rows.extend((0..b.num_rows()).map(row));
        }
        self.places = (1..=self.rows.len() as u64).collect();
        self.counted = "row";
        Ok(())
    }

    /// The file that it was read of.
    pub fn file(&self) -> &str {
        &self.file
    }

    /// Where a row is, for people.
    fn place(&self, row: usize) -> String {
        format!("{} {}", self.counted, self.places[row])
    }

    /// Columns of a fault: lower end, upper end, estimate.
    fn columns_of(&self, fault: &str) -> [Option<usize>; 3] {
        let fault = fault.to_ascii_lowercase();
        let column = |end: &str| self.column(&format!("{fault}_{end}"));
        let estimate = column("estimate").or_else(|| self.column(&fault));
        [column("lo"), column("hi"), estimate]
    }

    /// Adds the levels of a margin, which follow from those of FSJ and zeta.
    ///
    /// # Errors
    /// A table without both, or with what is no number there.
    pub fn put_margin(&mut self, margin: &Margin) -> Result<()> {
        let faults = ["fsj", "zeta"].map(|f| self.columns_of(f));
        if faults.iter().flatten().any(Option::is_none) {
            let allowed = "lo, hi and estimate of fsj and of zeta, which --threshold stall needs";
            return Err(Error::bad(&self.file, "header", self.names.join(","), allowed).into());
        }
        let first = self.names.len();
        self.names
            .extend(["lo", "hi", "estimate"].map(|end| format!("{STALL}_{end}")));
        for r in 0..self.rows.len() {
            let mut levels = [None; 6];
            for (to, column) in levels.iter_mut().zip(faults.iter().flatten()) {
                *to = self.number(r, *column)?;
            }
            self.rows[r].resize(first, Cell::Nothing);
            let [lo, hi, fsj, zeta_lo, zeta_hi, zeta] = levels;
            let ends = || Some(margin.over((lo?, hi?), (zeta_lo?, zeta_hi?)));
            let way = || Some(margin.at(fsj?, zeta?));
            let new = [ends().map(|e| e.0), ends().map(|e| e.1), way()];
            self.rows[r].extend(new.map(|x| x.map_or(Cell::Nothing, Cell::Number)));
        }
        Ok(())
    }

    /// Whether a fault has a lower end anywhere.
    pub fn has(&self, fault: &str) -> bool {
        let [lo, hi, estimate] = self.columns_of(fault);
        let is_there = |c: usize| self.rows.iter().any(|r| matches!(r.get(c), Some(Cell::Number(_))));
        hi.or(estimate).is_some() && lo.is_some_and(is_there)
    }

    fn column(&self, name: &str) -> Option<usize> {
        self.names.iter().position(|n| n == name)
    }

    fn bad(&self, row: usize, column: usize, allowed: &str) -> anyhow::Error {
        let found = match self.rows[row].get(column) {
            Some(Cell::Number(x)) => x.to_string(),
            Some(Cell::Text(t)) => t.clone(),
            Some(Cell::Nothing) | None => "nothing".into(),
        };
        let place = format!("{}, column `{}`", self.place(row), self.names[column]);
        Error::bad(&self.file, place, found, allowed).into()
    }

    /// A number, or none; refuses what is neither.
    fn number(&self, row: usize, column: Option<usize>) -> Result<Option<f64>> {
        let Some(c) = column else { return Ok(None) };
        match self.rows[row].get(c) {
            None | Some(Cell::Nothing) => Ok(None),
            Some(Cell::Number(x)) if x.is_finite() => Ok(Some(*x)),
            Some(Cell::Number(_) | Cell::Text(_)) => Err(self.bad(row, c, "a finite number, or nothing")),
        }
    }

    fn text(&self, row: usize, column: Option<usize>) -> String {
        match column.and_then(|c| self.rows[row].get(c)) {
            Some(Cell::Text(t)) => t.clone(),
            Some(Cell::Number(x)) => x.to_string(),
            _ => String::new(),
        }
    }

    /// When a row was, by whichever of `cycle`, `flight`, `time`, `date`, `time_ns` there is.
    fn moment(&self, row: usize) -> Result<Moment> {
        let mut m = Moment::default();
        for name in ["cycle", "flight"] {
            m.cycle = m.cycle.or(self.number(row, self.column(name))?);
        }
        if let Some(ns) = self.number(row, self.column("time_ns"))? {
            m.day = Some(ns * 1e-9 / DAY_S);
        }
        for c in ["time", "date"].iter().filter_map(|n| self.column(n)) {
            match &self.rows[row].get(c) {
                None | Some(Cell::Nothing) => {}
                Some(Cell::Number(x)) if x.is_finite() => m.cycle = m.cycle.or(Some(*x)),
                Some(Cell::Number(_)) => return Err(self.bad(row, c, "a finite number, or an ISO time")),
                Some(Cell::Text(t)) => {
                    let t = t.trim_end_matches('Z');
                    let ns =
                        string_to_timestamp_nanos(t).or_else(|_| string_to_timestamp_nanos(&format!("{t}T00:00:00")));
                    let allowed = "a number, or an ISO time such as 2025-01-31T06:00:00Z";
                    m.day = Some(ns.map_err(|_| self.bad(row, c, allowed))? as f64 * 1e-9 / DAY_S);
                }
            }
        }
        if m == Moment::default() {
            let allowed = "a column `time`, `cycle`, `flight` or `time_ns` with a value in every row";
            return Err(Error::bad(&self.file, self.place(row), "no time", allowed).into());
        }
        Ok(m)
    }

    /// What a unit is called.
    fn actuator(&self, row: usize) -> Result<String> {
        let Some(c) = self.column("actuator") else {
            return Ok(self.stem.clone());
        };
        match self.text(row, Some(c)) {
            name if name.is_empty() => Err(self.bad(row, c, "the name of an actuator")),
            name => Ok(name),
        }
    }

    /// The levels of `faults` by unit.
    ///
    /// # Errors
    /// Rows without a time; numbers that are none, ends of an interval the wrong way round, a coverage that is none, an
    /// outcome that no diagnosis has; a fault that has no column.
    pub fn history(&self, faults: &[String]) -> Result<Units> {
        let mut columns = Vec::new();
        for f in faults {
            let found @ [lo, hi, estimate] = self.columns_of(f);
            if estimate.is_none() && (lo.is_none() || hi.is_none()) {
                let allowed = format!("columns {f}_lo, {f}_hi and {f}_estimate, or {f}");
                return Err(Error::bad(&self.file, "header", self.names.join(","), allowed).into());
            }
            columns.push(found);
        }
        let (outcome, coverage, is_final) = (self.column("outcome"), self.column("coverage"), self.column("final"));
        let mut units = Units::new();
        for r in 0..self.rows.len() {
            if self.rows[r].iter().all(|c| *c == Cell::Nothing) || self.text(r, is_final) == "false" {
                continue;
            }
            let word = self.text(r, outcome);
            let ended = match Ended::ALL.into_iter().find(|e| e.name() == word) {
                Some(e) => e,
                None if word.is_empty() => Ended::Located,
                None => {
                    let allowed = Ended::ALL.map(Ended::name).join(", ");
                    return Err(self.bad(r, outcome.unwrap_or(0), &allowed));
                }
            };
            let stated = self.number(r, coverage)?.unwrap_or(0.95);
            if !(0.01..1.0).contains(&stated) {
                return Err(self.bad(r, coverage.unwrap_or(0), "a coverage from 0.01 to below 1"));
            }
            let mut levels = Vec::new();
            for [lo, hi, estimate] in &columns {
                let level = Level {
                    lo: self.number(r, *lo)?,
                    hi: self.number(r, *hi)?,
                    estimate: self.number(r, *estimate)?,
                };
                if let (Some(a), Some(b), Some(column)) = (level.lo, level.hi, *lo)
                    && a > b
                {
                    return Err(self.bad(r, column, &format!("a lower end not above the upper one ({b})")));
                }
                levels.push(level);
            }
            let test = Test {
                moment: self.moment(r)?,
                ended,
                coverage: stated,
                levels,
            };
            units.entry(self.actuator(r)?).or_default().push(test);
        }
        if units.is_empty() {
            return Err(Error::bad(&self.file, "rows", "none", "a row for each test").into());
        }
        Ok(units)
    }
}

fn cell(text: &str) -> Cell {
    if text.is_empty() || text.eq_ignore_ascii_case("null") {
        return Cell::Nothing;
    }
    text.parse().map_or_else(|_| Cell::Text(text.into()), Cell::Number)
}

/// A column of a batch.
fn cells(path: &Path, b: &RecordBatch, i: usize) -> Result<Vec<Cell>> {
    let schema = b.schema();
    let name = schema.field(i).name();
    let column = b.column(i);
    let to = match column.data_type() {
        DataType::Timestamp(..) | DataType::Date32 | DataType::Date64 => {
            DataType::Timestamp(TimeUnit::Nanosecond, None)
        }
        t if t.is_numeric() => DataType::Float64,
        DataType::Utf8 | DataType::LargeUtf8 | DataType::Utf8View | DataType::Boolean | DataType::Dictionary(..) => {
            DataType::Utf8
        }
        // lists and the like say nothing here
        _ => return Ok(vec![Cell::Nothing; column.len()]),
    };
    let bad = |e| {
        Error::bad(
            path.display().to_string(),
            format!("column `{name}`"),
            e,
            "numbers, text or times",
        )
    };
    let column = cast(column, &to).map_err(bad)?;
    let of = |r: usize| match &to {
        _ if column.is_null(r) => Cell::Nothing,
        DataType::Float64 => Cell::Number(column.as_primitive::<Float64Type>().value(r)),
        DataType::Utf8 => Cell::Text(column.as_string::<i32>().value(r).into()),
        _ => {
            let ns = column
                .as_primitive::<arrow::datatypes::TimestampNanosecondType>()
                .value(r);
            Cell::Text(
                arrow::temporal_conversions::timestamp_ns_to_datetime(ns)
                    .map_or_else(String::new, |t| t.format("%Y-%m-%dT%H:%M:%S%.9f").to_string()),
            )
        }
    };
    Ok((0..column.len()).map(of).collect())
}

/// The file in which histories are: a dataset has them in its diagnoses, by each actuator's own maps before those by unit files and by maps of the type.
///
/// # Errors
/// A folder without any.
pub fn history_file(path: &Path) -> Result<PathBuf> {
    if !path.is_dir() {
        return Ok(path.into());
    }
    let files = ["own", "unit", "type"].map(|by| path.join(format!("diagnoses/part-{by}.parquet")));
    let [own, ..] = &files;
    let missing = || {
        Error::bad(
            path.display().to_string(),
            "folder",
            "no diagnoses",
            format!("{} (ema dataset diagnose)", own.display()),
        )
    };
    Ok(files.iter().find(|f| f.exists()).ok_or_else(missing)?.clone())
}

/// Reads a history: the levels of `faults` by unit.
///
/// # Errors
/// As [`Sheet::read`] and [`Sheet::history`].
pub fn history(path: &Path, faults: &[String]) -> Result<Units> {
    Sheet::read(path)?.history(faults)
}

/// Reads an events file: `actuator`, `time` or `cycle`, `kind`, `fault`, `note`.
///
/// # Errors
/// As [`history`]; a kind that is none.
pub fn events(path: &Path) -> Result<BTreeMap<String, Vec<Event>>> {
    let sheet = Sheet::read(path)?;
    let kind = sheet.column("kind").ok_or_else(|| missing(&sheet, "kind"))?;
    let mut out: BTreeMap<String, Vec<Event>> = BTreeMap::new();
    for r in 0..sheet.rows.len() {
        let word = sheet.text(r, Some(kind));
        let what = match word.as_str() {
            "repair" | "replacement" => Happening::Repair,
            "lubrication" | "configuration" | "sensor" => Happening::Change,
            "loss" => Happening::Loss,
            _ => {
                let allowed = "repair, replacement, lubrication, configuration, sensor or loss";
                return Err(sheet.bad(r, kind, allowed));
            }
        };
        let fault = sheet.text(r, sheet.column("fault")).to_ascii_lowercase();
        let event = Event {
            moment: sheet.moment(r)?,
            what,
            kind: word,
            fault,
        };
        out.entry(sheet.actuator(r)?).or_default().push(event);
    }
    Ok(out)
}

/// Reads when lives ended: `actuator`, `time` or `cycle`, `event`.
///
/// # Errors
/// As [`history`].
pub fn truths(path: &Path) -> Result<BTreeMap<String, Vec<End>>> {
    let sheet = Sheet::read(path)?;
    let mut out: BTreeMap<String, Vec<End>> = BTreeMap::new();
    for r in 0..sheet.rows.len() {
        let event = sheet.text(r, sheet.column("event"));
        out.entry(sheet.actuator(r)?).or_default().push(End {
            moment: sheet.moment(r)?,
            event,
        });
    }
    Ok(out)
}

fn missing(sheet: &Sheet, column: &str) -> Error {
    Error::bad(
        &sheet.file,
        "header",
        sheet.names.join(","),
        format!("a column `{column}`"),
    )
}
