//! Histories of diagnoses: logs of `ema live` (JSON lines, Parquet), CSV and Parquet tables; events and truths in CSV.

use anyhow::Result;
use arrow::array::{Array, AsArray, RecordBatch};
use arrow::compute::cast;
use arrow::compute::kernels::cast_utils::string_to_timestamp_nanos;
use arrow::datatypes::{DataType, Float64Type, TimeUnit};
use csv::StringRecord;
use diagnoser::prognosis::{Ended, Happening};
use schemas::error::Error;
use schemas::recording::read_table;
use serde_json::Value;
use std::collections::BTreeMap;
use std::path::Path;

/// Seconds of a day.
const DAY_S: f64 = 86_400.0;

/// One cell of a table, whatever kind of file it comes from.
#[derive(Clone, Debug, PartialEq)]
enum Cell {
    Nothing,
    Number(f64),
    Text(String),
}

/// A table by its columns' names; `place` says where a row is, for people.
struct Sheet {
    file: String,
    names: Vec<String>,
    rows: Vec<Vec<Cell>>,
    place: fn(usize) -> String,
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
    fn read(path: &Path) -> Result<Self> {
        let ending = path
            .extension()
            .and_then(|e| e.to_str())
            .unwrap_or_default()
            .to_ascii_lowercase();
        match ending.as_str() {
            "csv" => Self::csv(path),
            "jsonl" | "json" | "ndjson" => Self::json_lines(path),
            "parquet" => Self::parquet(path),
            _ => {
                let allowed = "a table of diagnoses in .csv, .jsonl or .parquet";
                Err(Error::bad(
                    path.display().to_string(),
                    "file",
                    format!("ending `{ending}`"),
                    allowed,
                )
                .into())
            }
        }
    }

    fn csv(path: &Path) -> Result<Self> {
        let file = path.display().to_string();
        let text = std::fs::File::open(path).map_err(|e| Error::io(path, "cannot be read", e))?;
        let mut reader = csv::ReaderBuilder::new().trim(csv::Trim::All).from_reader(text);
        let head = reader.headers().map_err(|e| Error::torn(path, e))?.clone();
        let names: Vec<String> = head
            .iter()
            .map(|n| n.trim_start_matches('\u{feff}').to_ascii_lowercase())
            .collect();
        let mut rows = Vec::new();
        let mut record = StringRecord::new();
        loop {
            let place = format!("line {}", rows.len() + 2);
            match reader.read_record(&mut record) {
                Ok(false) => break,
                Ok(true) => rows.push(record.iter().map(cell).collect()),
                Err(e) => return Err(Error::bad(file, place, e, format!("{} columns", names.len())).into()),
            }
        }
        Ok(Self {
            file,
            names,
            rows,
            place: |i| format!("line {}", i + 2),
        })
    }

    fn json_lines(path: &Path) -> Result<Self> {
        let text = std::fs::read_to_string(path).map_err(|e| Error::io(path, "cannot be read", e))?;
        let mut sheet = Self {
            file: path.display().to_string(),
            names: Vec::new(),
            rows: Vec::new(),
            place: |i| format!("line {}", i + 1),
        };
        for (i, line) in text.lines().enumerate() {
            let value: Value = if line.trim().is_empty() {
                Value::Null
            } else {
                let bad = |e| Error::bad(&sheet.file, format!("line {}", i + 1), e, "a JSON object");
                serde_json::from_str(line).map_err(bad)?
            };
            let mut row = vec![Cell::Nothing; sheet.names.len()];
            let fields = value.as_object().into_iter().flatten();
            for (name, v) in fields {
                // {"fsj": {"lo": ...}} is fsj_lo
                let parts: Vec<(String, &Value)> = match v {
                    Value::Object(o) => o.iter().map(|(k, v)| (format!("{name}_{k}"), v)).collect(),
                    v => vec![(name.clone(), v)],
                };
                for (name, v) in parts {
                    let at = sheet.names.iter().position(|n| *n == name).unwrap_or_else(|| {
                        sheet.names.push(name.clone());
                        row.push(Cell::Nothing);
                        sheet.names.len() - 1
                    });
                    row[at] = match v {
                        Value::Number(n) => n.as_f64().map_or(Cell::Nothing, Cell::Number),
                        Value::String(s) => Cell::Text(s.clone()),
                        Value::Bool(b) => Cell::Text(b.to_string()),
                        _ => Cell::Nothing,
                    };
                }
            }
            sheet.rows.push(row);
        }
        Ok(sheet)
    }

    fn parquet(path: &Path) -> Result<Self> {
        let (schema, batches) = read_table(path)?;
        let names = schema.fields().iter().map(|f| f.name().to_ascii_lowercase()).collect();
        let mut rows = Vec::new();
        for b in &batches {
            let columns: Vec<Vec<Cell>> = (0..b.num_columns()).map(|i| cells(path, b, i)).collect::<Result<_>>()?;
            rows.extend((0..b.num_rows()).map(|r| columns.iter().map(|c| c[r].clone()).collect()));
        }
        Ok(Self {
            file: path.display().to_string(),
            names,
            rows,
            place: |i| format!("row {}", i + 1),
        })
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
        let place = format!("{}, column `{}`", (self.place)(row), self.names[column]);
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
            return Err(Error::bad(&self.file, (self.place)(row), "no time", allowed).into());
        }
        Ok(m)
    }

    /// What a unit is called; the file's name where it has no such column.
    fn actuator(&self, row: usize, path: &Path) -> Result<String> {
        let Some(c) = self.column("actuator") else {
            return Ok(path
                .file_stem()
                .map_or_else(|| "unit".into(), |s| s.to_string_lossy().into_owned()));
        };
        match self.text(row, Some(c)) {
            name if name.is_empty() => Err(self.bad(row, c, "the name of an actuator")),
            name => Ok(name),
        }
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

/// Reads a history: the levels of `faults` by unit.
///
/// # Errors
/// A file that cannot be read; rows without a time; numbers that are none, ends of an interval the wrong way round, a
/// coverage that is none, an outcome that no diagnosis has; a fault that has no column.
pub fn history(path: &Path, faults: &[String]) -> Result<Units> {
    let sheet = Sheet::read(path)?;
    let column = |fault: &str, end: &str| sheet.column(&format!("{}_{end}", fault.to_ascii_lowercase()));
    let mut columns = Vec::new();
    for f in faults {
        let estimate = column(f, "estimate").or_else(|| sheet.column(&f.to_ascii_lowercase()));
        let (lo, hi) = (column(f, "lo"), column(f, "hi"));
        if estimate.is_none() && (lo.is_none() || hi.is_none()) {
            let allowed = format!("columns {f}_lo, {f}_hi and {f}_estimate, or {f}");
            return Err(Error::bad(&sheet.file, "header", sheet.names.join(","), allowed).into());
        }
        columns.push((lo, hi, estimate));
    }
    let (outcome, coverage, is_final) = (sheet.column("outcome"), sheet.column("coverage"), sheet.column("final"));
    let mut units = Units::new();
    for r in 0..sheet.rows.len() {
        if sheet.rows[r].iter().all(|c| *c == Cell::Nothing) || sheet.text(r, is_final) == "false" {
            continue;
        }
        let word = sheet.text(r, outcome);
        let ended = match Ended::ALL.into_iter().find(|e| e.name() == word) {
            Some(e) => e,
            None if word.is_empty() => Ended::Located,
            None => {
                let allowed = Ended::ALL.map(Ended::name).join(", ");
                return Err(sheet.bad(r, outcome.unwrap_or(0), &allowed));
            }
        };
        let stated = sheet.number(r, coverage)?.unwrap_or(0.95);
        if !(0.01..1.0).contains(&stated) {
            return Err(sheet.bad(r, coverage.unwrap_or(0), "a coverage from 0.01 to below 1"));
        }
        let mut levels = Vec::new();
        for (lo, hi, estimate) in &columns {
            let level = Level {
                lo: sheet.number(r, *lo)?,
                hi: sheet.number(r, *hi)?,
                estimate: sheet.number(r, *estimate)?,
            };
            if let (Some(a), Some(b), Some(column)) = (level.lo, level.hi, *lo)
                && a > b
            {
                return Err(sheet.bad(r, column, &format!("a lower end not above the upper one ({b})")));
            }
            levels.push(level);
        }
        let test = Test {
            moment: sheet.moment(r)?,
            ended,
            coverage: stated,
            levels,
        };
        units.entry(sheet.actuator(r, path)?).or_default().push(test);
    }
    if units.is_empty() {
        return Err(Error::bad(&sheet.file, "rows", "none", "a row for each test").into());
    }
    Ok(units)
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
            _ => return Err(sheet.bad(r, kind, "repair, replacement, lubrication, configuration or sensor")),
        };
        let fault = sheet.text(r, sheet.column("fault")).to_ascii_lowercase();
        let event = Event {
            moment: sheet.moment(r)?,
            what,
            kind: word,
            fault,
        };
        out.entry(sheet.actuator(r, path)?).or_default().push(event);
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
        out.entry(sheet.actuator(r, path)?).or_default().push(End {
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
