//! CSV in the dialects of its writers: separator, decimal mark, comments, quotes, units in the header or below it.

use crate::columnar::Raw;
use crate::header::{meaning, split};
use crate::table::{Column, Places};
use crate::units;
use arrow::compute::kernels::cast_utils::string_to_timestamp_nanos;
use schemas::error::{Error, Result};
use std::collections::HashSet;
use std::path::Path;

/// Marks that begin a comment before the header; after it, `#` alone.
const COMMENTS: [&str; 4] = ["#", "%", "//", "!"];

/// Separators, the likelier first; blanks where there is none of them.
const SEPARATORS: [u8; 4] = [b';', b'\t', b',', b'|'];

/// What an empty cell is read as: NaN, but not the one that the word is.
pub(crate) const EMPTY: f64 = -f64::NAN;

/// Where the table is in a text.
struct Layout<'a> {
    header: &'a str,
    /// line of the header
    line: u64,
    /// what comes behind it
    rest: &'a str,
    /// `None`: blanks, any number of them
    separator: Option<u8>,
}

/// Reads a text.
///
/// # Errors
/// No header, a header without rows' number of columns, a column twice, marks of thousands.
pub(crate) fn read(path: &Path, text: &str) -> Result<Raw> {
    let file = path.display().to_string();
    let layout = layout(path, text)?;
    let names = cells(layout.header, layout.separator);
    let mut names: Vec<String> = names.iter().map(|n| n.trim().to_string()).collect();
    // a separator at the end of the line
    let trailing = names.len() > 1 && names.last().is_some_and(String::is_empty);
    if trailing {
        names.pop();
    }
    let mut seen = HashSet::new();
    if let Some((i, n)) = names.iter().enumerate().find(|(_, n)| !seen.insert(n.as_str())) {
        let place = format!("header, column {}", i + 1);
        return Err(Error::bad(file, place, format!("`{n}` again"), "each column once"));
    }
    let blanks;
    let body = match layout.separator {
        Some(_) => layout.rest,
        None => {
            let joined = |l: &str| l.split_whitespace().collect::<Vec<_>>().join("\t");
            blanks = layout.rest.lines().map(joined).collect::<Vec<_>>().join("\n");
            &blanks
        }
    };
    let mut reader = csv::ReaderBuilder::new()
        .trim(csv::Trim::All)
        .has_headers(false)
        .flexible(true)
        .comment(Some(b'#'))
        .delimiter(layout.separator.unwrap_or(b'\t'))
        .from_reader(body.as_bytes());
    let mut units: Vec<Option<String>> = vec![None; names.len()];
    let mut columns: Vec<Cells> = vec![Cells::default(); names.len()];
    let mut marks = Marks::default();
    let mut lines = Vec::new();
    let mut record = csv::StringRecord::new();
    loop {
        let line = layout.line + reader.position().line();
        let more = reader.read_record(&mut record);
        if !more.map_err(|e| Error::bad(&file, format!("line {line}"), one_line(&e.to_string()), "CSV"))? {
            break;
        }
        let line = record.position().map_or(line, |p| layout.line + p.line());
        let spare = record.len() == names.len() + 1 && record.get(names.len()) == Some("");
        if record.len() != names.len() && !spare {
            let why = format!("{} values", record.len());
            let commas = layout.separator == Some(b',') && record.len() > names.len();
            let hint = if commas {
                "; decimal commas need another separator than the comma, or quotes"
            } else {
                ""
            };
            let allowed = format!("{} columns as in the header{hint}", names.len());
            return Err(Error::bad(&file, format!("line {line}"), why, allowed));
        }
        if lines.is_empty()
            && let Some(stated) = units_row(&names, &record)
            && units.iter().all(Option::is_none)
        {
            units = stated;
            continue;
        }
        for (c, column) in columns.iter_mut().enumerate() {
            let place = || format!("line {line}, column `{}`", names[c]);
            column.push(&record[c], &mut marks, &file, place)?;
        }
        lines.push(line);
    }
    Ok(Raw {
        rows: lines.len(),
        columns: columns.into_iter().map(Cells::finish).collect(),
        names,
        units,
        places: Places::Lines(lines),
    })
}

fn one_line(text: &str) -> String {
    text.replace(['\n', '\r'], " ")
}

/// The first line and what is behind it.
fn next_line(text: &str) -> (&str, &str) {
    match text.find(['\n', '\r']) {
        None => (text, ""),
        Some(at) => {
            let end = if text[at..].starts_with("\r\n") { 2 } else { 1 };
            (&text[..at], &text[at + end..])
        }
    }
}

fn layout<'a>(path: &Path, text: &'a str) -> Result<Layout<'a>> {
    let (mut rest, mut line) = (text, 0);
    let mut said: Option<u8> = None;
    let mut comment: Option<(&str, u64)> = None;
    while !rest.is_empty() {
        let (this, behind) = next_line(rest);
        line += 1;
        let content = this.trim();
        let mark = COMMENTS.iter().find(|m| content.starts_with(**m));
        if let Some(sep) = content.strip_prefix("sep=").filter(|s| s.len() == 1) {
            said = Some(sep.as_bytes()[0]);
        } else if let Some(mark) = mark {
            comment = Some((content.trim_start_matches(*mark).trim_start(), line))
                .filter(|c| !c.0.is_empty())
                .or(comment);
        } else if !content.is_empty() {
            let separator = said.map(Some).unwrap_or_else(|| separator(this));
            let first = cells(this, separator);
            let is_data = first.iter().all(|c| c.trim().is_empty() || number(c.trim()).is_some());
            if !is_data {
                return Ok(Layout {
                    header: this,
                    line,
                    rest: behind,
                    separator,
                });
            }
            // numpy's savetxt writes the header as a comment
            if let Some((header, at)) = comment
                && at + 1 == line
                && let Some(separator) = [separator, crate::dialect::separator(header)]
                    .into_iter()
                    .find(|s| cells(header, *s).len() == cells(this, *s).len())
            {
                return Ok(Layout {
                    header,
                    line: at,
                    rest,
                    separator,
                });
            }
            let found = one_line(&this.chars().take(60).collect::<String>());
            let allowed = "a header with the names of the columns above the numbers";
            return Err(Error::bad(
                path.display().to_string(),
                format!("line {line}"),
                found,
                allowed,
            ));
        }
        rest = behind;
    }
    Err(Error::torn(
        path,
        "no rows of data; allowed: a header and at least one row",
    ))
}

/// The separator of a header: the one that is there most often, outside quotes and brackets.
fn separator(header: &str) -> Option<u8> {
    let mut counts = [0; SEPARATORS.len()];
    let (mut quoted, mut depth) = (false, 0_i32);
    for b in header.bytes() {
        match b {
            b'"' => quoted = !quoted,
            b'[' | b'(' | b'{' => depth += 1,
            b']' | b')' | b'}' => depth -= 1,
            _ if !quoted && depth <= 0 => {
                if let Some(i) = SEPARATORS.iter().position(|s| *s == b) {
                    counts[i] += 1;
                }
            }
            _ => {}
        }
    }
    let most = *counts.iter().max().expect("some");
    let first = counts.iter().position(|c| *c == most).expect("the greatest");
    match most {
        0 if header.split_whitespace().count() > 1 => None,
        0 => Some(b','),
        _ => Some(SEPARATORS[first]),
    }
}

/// Cells of one line.
fn cells(line: &str, separator: Option<u8>) -> Vec<String> {
    let Some(separator) = separator else {
        // `t [ms]` is one of them
        let mut all: Vec<String> = Vec::new();
        for token in line.split_whitespace() {
            match all.last_mut() {
                Some(last) if token.starts_with(['[', '(', '{']) => *last += &format!(" {token}"),
                _ => all.push(token.into()),
            }
        }
        return all;
    };
    let mut reader = csv::ReaderBuilder::new()
        .has_headers(false)
        .delimiter(separator)
        .from_reader(line.as_bytes());
    let mut record = csv::StringRecord::new();
    match reader.read_record(&mut record) {
        Ok(true) => record.iter().map(str::to_string).collect(),
        _ => vec![line.to_string()],
    }
}

/// A row below the header that is nothing but units.
fn units_row(names: &[String], record: &csv::StringRecord) -> Option<Vec<Option<String>>> {
    let bare = |cell: &str| cell.trim_matches(['[', ']', '(', ')', '{', '}']).trim().to_string();
    let mut units = Vec::new();
    for (name, cell) in names.iter().zip(record) {
        let unit = bare(cell);
        if number(cell).is_some() {
            return None;
        }
        // of our own columns any word is one: what it cannot be is refused by its name
        let is_ours = meaning(name).is_some() && split(name).1.is_none();
        if !unit.is_empty() && unit != "-" && !is_ours && !units::is_known(&unit) {
            return None;
        }
        units.push(Some(unit).filter(|u| !u.is_empty() && u != "-"));
    }
    let any = units.iter().flatten().any(|u| units::is_known(u));
    any.then_some(units)
}

/// Decimal marks seen so far.
#[derive(Clone, Copy, Default)]
struct Marks {
    point: bool,
    comma: bool,
}

fn number(cell: &str) -> Option<f64> {
    cell.parse().ok().or_else(|| with_comma(cell))
}

/// A number with a decimal comma.
fn with_comma(cell: &str) -> Option<f64> {
    let one = cell.matches(',').count() == 1 && !cell.contains('.');
    one.then(|| cell.replace(',', ".").parse().ok()).flatten()
}

/// A column on its way.
#[derive(Clone, Default)]
struct Cells {
    numbers: Vec<f64>,
    texts: Option<Vec<String>>,
}

impl Cells {
    fn push(&mut self, cell: &str, marks: &mut Marks, file: &str, place: impl Fn() -> String) -> Result<()> {
        if let Some(t) = &mut self.texts {
            t.push(cell.to_string());
            return Ok(());
        }
        if cell.is_empty() {
            self.numbers.push(EMPTY);
            return Ok(());
        }
        let plain = cell.parse::<f64>().ok();
        let value = plain.or_else(|| with_comma(cell));
        marks.point |= plain.is_some() && cell.contains('.');
        marks.comma |= plain.is_none() && value.is_some();
        let digits = |c: char| c.is_ascii_digit() || ",.'+-eE ".contains(c);
        let thousands = value.is_none() && cell.contains(',') && cell.contains('.') && cell.chars().all(digits);
        if thousands || marks.point && marks.comma {
            let allowed = "numbers with one decimal mark, point or comma, and none of thousands";
            return Err(Error::bad(file, place(), format!("`{cell}`"), allowed));
        }
        match value {
            Some(x) => self.numbers.push(x),
            None => {
                // a column of words: what came before is told again as text
                let text = |x: &f64| if x.is_nan() { String::new() } else { x.to_string() };
                let before = self.numbers.iter().map(text);
                self.texts = Some(before.chain([cell.to_string()]).collect());
            }
        }
        Ok(())
    }

    fn finish(self) -> Column {
        match self.texts {
            None => Column::Numbers(self.numbers),
            Some(texts) => moments(&texts).map_or(Column::Texts(texts), Column::Moments),
        }
    }
}

/// Texts that are moments of a calendar (ISO 8601, a blank in place of T, with or without zone) or of a day, as seconds
/// from the first on.
pub(crate) fn moments(texts: &[String]) -> Option<Vec<f64>> {
    let nanos = |t: &String| -> Option<i64> {
        let t = t.replace(',', ".");
        let of_day = t.len() >= 8 && t.as_bytes()[2] == b':';
        let t = if of_day { format!("1970-01-01T{t}") } else { t };
        if !t.contains(':') {
            return None;
        }
        string_to_timestamp_nanos(&t).ok()
    };
    let first = nanos(texts.first()?)?;
    texts
        .iter()
        .map(|t| Some(nanos(t)?.checked_sub(first)? as f64 * 1e-9))
        .collect()
}
