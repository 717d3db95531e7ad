//! Any CSV or Parquet file as columns.

use arrow::array::{Array, AsArray};
use arrow::datatypes::{DataType, Float64Type};
use schemas::error::{Error, Result};
use std::path::Path;

/// Cells of one column.
#[derive(Clone, Debug)]
pub enum Column {
    /// an empty cell is NaN
    Numbers(Vec<f64>),
    Texts(Vec<String>),
}

/// A file in memory.
#[derive(Clone, Debug)]
pub struct Table {
    pub file: String,
    pub names: Vec<String>,
    pub columns: Vec<Column>,
    pub rows: usize,
    /// hash of the file's bytes
    pub hash: String,
}

impl Table {
    pub fn read(path: &Path) -> Result<Self> {
        let bytes = std::fs::read(path).map_err(|e| Error::io(path, "cannot be read", e))?;
        let hash = schemas::fingerprint::fingerprint_bytes(&bytes);
        let mut table = if bytes.starts_with(b"PAR1") {
            Self::parquet(path)?
        } else {
            Self::csv(path, &bytes)?
        };
        table.hash = hash;
        if table.rows == 0 {
            return Err(Error::torn(
                path,
                "no rows of data; allowed: a header and at least one row",
            ));
        }
        Ok(table)
    }

    fn csv(path: &Path, bytes: &[u8]) -> Result<Self> {
        let file = path.display().to_string();
        let mut reader = csv::ReaderBuilder::new().trim(csv::Trim::All).from_reader(bytes);
        let torn = |e: csv::Error| {
            let line = e.position().map_or(1, |p| p.line());
            Error::bad(
                &file,
                format!("line {line}"),
                e.to_string().replace('\n', " "),
                "CSV with one header",
            )
        };
        let names: Vec<String> = reader.headers().map_err(torn)?.iter().map(str::to_string).collect();
        if let Some(name) = names.iter().enumerate().find(|(i, n)| names[..*i].contains(n)) {
            return Err(Error::bad(
                &file,
                "line 1",
                format!("column `{}` twice", name.1),
                "each column once",
            ));
        }
        let mut texts: Vec<Option<Vec<String>>> = vec![None; names.len()];
        let mut numbers: Vec<Vec<f64>> = vec![Vec::new(); names.len()];
        let mut record = csv::StringRecord::new();
        let mut rows = 0;
        while reader.read_record(&mut record).map_err(torn)? {
            for (c, cell) in record.iter().enumerate() {
                if let Some(t) = &mut texts[c] {
                    t.push(cell.to_string());
                } else if cell.is_empty() {
                    numbers[c].push(f64::NAN);
                } else if let Ok(x) = cell.parse::<f64>() {
                    numbers[c].push(x);
                } else {
                    // a column of words: what came before is told again as text
                    let before = numbers[c].iter().map(|x| x.to_string());
                    texts[c] = Some(before.chain([cell.to_string()]).collect());
                }
            }
            rows += 1;
        }
        let columns = texts.into_iter().zip(numbers);
        let columns = columns
            .map(|(t, n)| t.map_or(Column::Numbers(n), Column::Texts))
            .collect();
        Ok(Self {
            file,
            names,
            columns,
            rows,
            hash: String::new(),
        })
    }

    fn parquet(path: &Path) -> Result<Self> {
        let batches = schemas::recording::read_batches(path)?;
        let mut names = Vec::new();
        let mut columns: Vec<Column> = Vec::new();
        let mut rows = 0;
        for batch in &batches {
            rows += batch.num_rows();
            for (c, field) in batch.schema().fields().iter().enumerate() {
                let array = batch.column(c);
                let text = matches!(
                    field.data_type(),
                    DataType::Utf8 | DataType::LargeUtf8 | DataType::Utf8View
                );
                if names.len() <= c {
                    names.push(field.name().clone());
                    columns.push(if text {
                        Column::Texts(Vec::new())
                    } else {
                        Column::Numbers(Vec::new())
                    });
                }
                let wanted = if text { DataType::Utf8 } else { DataType::Float64 };
                let Ok(array) = arrow::compute::cast(array, &wanted) else {
                    // lists and the like: a column that nobody can use
                    if let Column::Numbers(v) = &mut columns[c] {
                        v.extend(std::iter::repeat_n(f64::NAN, batch.num_rows()));
                    }
                    continue;
                };
                match &mut columns[c] {
                    Column::Texts(v) => {
                        let array = array.as_string::<i32>();
                        v.extend((0..array.len()).map(|i| array.value(i).to_string()));
                    }
                    Column::Numbers(v) => {
                        let array = array.as_primitive::<Float64Type>();
                        v.extend(array.iter().map(|x| x.unwrap_or(f64::NAN)));
                    }
                }
            }
        }
        Ok(Self {
            file: path.display().to_string(),
            names,
            columns,
            rows,
            hash: String::new(),
        })
    }

    fn bad(&self, found: String, allowed: String) -> Error {
        Error::bad(&self.file, "header", found, allowed)
    }

    fn column(&self, name: &str) -> Result<&Column> {
        let c = self.names.iter().position(|n| n == name);
        c.map(|c| &self.columns[c]).ok_or_else(|| {
            self.bad(
                format!("no column `{name}`"),
                format!("one of {}", self.names.join(", ")),
            )
        })
    }

    /// A column of numbers.
    pub fn numbers(&self, name: &str) -> Result<&[f64]> {
        match self.column(name)? {
            Column::Numbers(v) => Ok(v),
            Column::Texts(v) => {
                let row = v.iter().position(|t| t.parse::<f64>().is_err()).unwrap_or(0);
                let place = format!("column `{name}`, row {}", row + 1);
                Err(Error::bad(&self.file, place, format!("`{}`", v[row]), "a number"))
            }
        }
    }

    /// The cells of a column as texts.
    pub fn texts(&self, name: &str) -> Result<Vec<String>> {
        Ok(match self.column(name)? {
            Column::Numbers(v) => v.iter().map(|x| x.to_string()).collect(),
            Column::Texts(v) => v.clone(),
        })
    }
}
