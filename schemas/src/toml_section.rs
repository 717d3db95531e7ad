//! Reads TOML tables so that every refusal names file, key, value and what is allowed.

use crate::error::{Error, Result};
use std::path::Path;
use toml::{Table, Value};

/// One table of a file, emptied key by key; what is left at the end is unknown.
pub struct Section {
    file: String,
    path: String,
    table: Table,
    known: Vec<String>,
}

/// Parses a file's text.
///
/// * `file` for messages
///
/// # Errors
/// A text that is no TOML, with its line.
pub fn parse(file: &str, text: &str) -> Result<Section> {
    let table: Table = text.parse().map_err(|e: toml::de::Error| {
        let line = e
            .span()
            .map_or(1, |s| text[..s.start.min(text.len())].matches('\n').count() + 1);
        Error::bad(file, format!("line {line}"), e.message().replace('\n', " "), "TOML")
    })?;
    Ok(Section {
        file: file.into(),
        path: String::new(),
        table,
        known: Vec::new(),
    })
}

/// Reads and parses a file.
///
/// # Errors
/// A file that cannot be read, or is no TOML.
pub fn read(path: &Path) -> Result<Section> {
    let text = std::fs::read_to_string(path).map_err(|e| Error::io(path, "cannot be read", e))?;
    parse(&path.display().to_string(), &text)
}

/// A text as TOML writes it, on one line; also a key.
pub fn quoted(text: &str) -> String {
    let mut out = String::from("\"");
    for c in text.chars() {
        match c {
            '"' | '\\' => out.extend(['\\', c]),
            c if c.is_control() => out += &format!("\\u{:04X}", c as u32),
            c => out.push(c),
        }
    }
    out + "\""
}

/// On one line.
fn show(v: &Value) -> String {
    let s: String = v
        .to_string()
        .chars()
        .map(|c| if c.is_control() { ' ' } else { c })
        .collect();
    if s.len() > 60 {
        format!("{}...", s.chars().take(57).collect::<String>())
    } else {
        s
    }
}

impl Section {
    /// Name of the file, as messages have it.
    pub fn file(&self) -> &str {
        &self.file
    }

    fn place(&self, key: &str) -> String {
        if self.path.is_empty() {
            format!("key `{key}`")
        } else {
            format!("key `{}.{key}`", self.path)
        }
    }

    /// The error for a value of this table.
    pub fn bad(&self, key: &str, found: impl std::fmt::Display, allowed: impl Into<String>) -> Error {
        Error::bad(&self.file, self.place(key), found, allowed)
    }

    fn take(&mut self, key: &str) -> Option<Value> {
        self.known.push(key.into());
        self.table.remove(key)
    }

    /// A value as it stands in the file.
    pub fn raw(&mut self, key: &str) -> Option<Value> {
        self.take(key)
    }

    /// A value as it stands in the file, which is still to be read.
    pub fn peek(&self, key: &str) -> Option<&Value> {
        self.table.get(key)
    }

    /// Whether a key is there that was not read yet.
    pub fn has(&self, key: &str) -> bool {
        self.table.contains_key(key)
    }

    /// As [`Section::has`], for a key that need not be there and is listed as known.
    pub fn may_have(&mut self, key: &str) -> bool {
        self.known.push(key.into());
        self.has(key)
    }

    /// A number, or a table `{ value, source, unit }`; also its source.
    ///
    /// # Errors
    /// No such key, no finite number, one that `ok` refuses, or another key in the table.
    pub fn sourced(&mut self, key: &str, ok: impl Fn(f64) -> bool, allowed: &str) -> Result<(f64, Option<String>)> {
        let Some(v) = self.take(key) else {
            return Err(self.bad(key, "nothing", allowed));
        };
        let number = |v: &Value| v.as_float().or_else(|| v.as_integer().map(|i| i as f64));
        let (x, source) = match &v {
            Value::Table(t) => {
                if let Some(k) = t.keys().find(|k| !["value", "source", "unit"].contains(&k.as_str())) {
                    return Err(self.bad(&format!("{key}.{k}"), "an unknown key", "value, source, unit"));
                }
                (
                    t.get("value").and_then(number),
                    t.get("source").and_then(|s| s.as_str()).map(str::to_string),
                )
            }
            v => (number(v), None),
        };
        match x {
            Some(x) if x.is_finite() && ok(x) => Ok((x, source)),
            Some(x) => Err(self.bad(key, x, allowed)),
            None => Err(self.bad(key, show(&v), allowed)),
        }
    }

    /// A number, or the value of a table `{ value, source, unit }`.
    ///
    /// * `ok` whether it is allowed; `allowed` the same in words, for the refusal
    ///
    /// # Errors
    /// As [`Section::sourced`].
    pub fn number(&mut self, key: &str, ok: impl Fn(f64) -> bool, allowed: &str) -> Result<f64> {
        self.sourced(key, ok, allowed).map(|(x, _)| x)
    }

    /// As [`Section::number`]; `default` where the key is absent.
    ///
    /// # Errors
    /// As [`Section::sourced`].
    pub fn number_or(&mut self, key: &str, default: f64, ok: impl Fn(f64) -> bool, allowed: &str) -> Result<f64> {
        if self.has(key) {
            self.number(key, ok, allowed)
        } else {
            self.known.push(key.into());
            Ok(default)
        }
    }

    /// A text.
    ///
    /// * `allowed` what it may be, for the refusal
    ///
    /// # Errors
    /// No such key, or no text.
    pub fn text(&mut self, key: &str, allowed: &str) -> Result<String> {
        match self.take(key) {
            Some(Value::String(s)) => Ok(s),
            Some(v) => Err(self.bad(key, show(&v), allowed)),
            None => Err(self.bad(key, "nothing", allowed)),
        }
    }

    /// A number, or a table `{ value, lo, hi, unit, source }`, whose unit must be `unit` where it is
    /// given; also the interval from `lo` to `hi`.
    ///
    /// # Errors
    /// As [`Section::number`]; another unit; bounds that the value lies outside of.
    pub fn estimate(
        &mut self,
        key: &str,
        unit: &str,
        ok: impl Fn(f64) -> bool,
        allowed: &str,
    ) -> Result<(f64, Option<(f64, f64)>)> {
        let Some(Value::Table(t)) = self.table.get(key) else {
            return self.number(key, ok, allowed).map(|x| (x, None));
        };
        let mut t = Section {
            file: self.file.clone(),
            path: self.place(key).trim_start_matches("key `").trim_end_matches('`').into(),
            table: t.clone(),
            known: Vec::new(),
        };
        self.take(key);
        let x = t.number("value", ok, allowed)?;
        let interval = if t.has("lo") || t.has("hi") {
            let lo = t.number("lo", |y| y <= x, &format!("a finite number of at most the value {x}"))?;
            let hi = t.number("hi", |y| y >= x, &format!("a finite number of at least the value {x}"))?;
            Some((lo, hi))
        } else {
            t.known.extend(["lo".into(), "hi".into()]);
            None
        };
        let found = t.text_or("unit", unit)?;
        if found != unit {
            return Err(t.bad("unit", found, unit));
        }
        t.text_or("source", "")?;
        t.finish()?;
        Ok((x, interval))
    }

    /// Puts a number in the place of the value of `key` in the table `table`; unit and source stay.
    ///
    /// # Errors
    /// Where `table` is there and no table.
    pub fn put(&mut self, table: &str, key: &str, value: f64) -> Result<()> {
        let entry = self.table.entry(table).or_insert_with(|| Value::Table(Table::new()));
        let Value::Table(t) = entry else {
            let found = show(entry);
            return Err(self.bad(table, found, "a table"));
        };
        match t.get_mut(key) {
            Some(Value::Table(old)) => old.insert("value".into(), Value::Float(value)),
            _ => t.insert(key.into(), Value::Float(value)),
        };
        Ok(())
    }

    /// Puts a text in the place of the value of `key`.
    pub fn put_text(&mut self, key: &str, value: &str) {
        self.table.insert(key.into(), Value::String(value.into()));
    }

    /// The table as TOML; comments are not kept.
    pub fn to_toml(&self) -> String {
        self.table.to_string()
    }

    /// A list of texts.
    ///
    /// # Errors
    /// No such key, or no list of texts.
    pub fn texts(&mut self, key: &str, allowed: &str) -> Result<Vec<String>> {
        let Some(v) = self.take(key) else {
            return Err(self.bad(key, "nothing", allowed));
        };
        let list = v.as_array().and_then(|a| {
            let texts = a.iter().map(|x| x.as_str().map(str::to_string));
            texts.collect::<Option<Vec<String>>>()
        });
        list.ok_or_else(|| self.bad(key, show(&v), allowed))
    }

    /// A list of `n` numbers of a range.
    ///
    /// # Errors
    /// No such key, another number of numbers, one outside.
    pub fn numbers(&mut self, key: &str, range: std::ops::RangeInclusive<f64>, n: usize) -> Result<Vec<f64>> {
        let v = self.take(key);
        let number = |v: &Value| v.as_float().or(v.as_integer().map(|i| i as f64));
        let list = v.as_ref().and_then(Value::as_array);
        let all = list.and_then(|a| a.iter().map(number).collect::<Option<Vec<f64>>>());
        match all {
            Some(all) if all.len() == n && all.iter().all(|x| range.contains(x)) => Ok(all),
            _ => {
                let found = v.map_or("nothing".into(), |v| v.to_string());
                let (least, most) = (range.start(), range.end());
                let allowed = format!(
                    "{n} {} from {least} to {most}",
                    if n == 1 { "number" } else { "numbers" }
                );
                Err(self.bad(key, found, allowed))
            }
        }
    }

    /// Keys that were not read yet, in the order of the alphabet.
    pub fn keys(&self) -> Vec<String> {
        self.table.keys().cloned().collect()
    }

    /// Whether a key is there and a list.
    pub fn is_list(&self, key: &str) -> bool {
        self.table.get(key).is_some_and(Value::is_array)
    }

    /// Whether a key that is there is a section.
    pub fn is_section(&self, key: &str) -> bool {
        matches!(self.table.get(key), Some(Value::Table(_)))
    }

    /// Whether a key is there and a text.
    pub fn is_text(&self, key: &str) -> bool {
        self.table.get(key).is_some_and(Value::is_str)
    }

    /// A text that `of` knows, `allowed` in words.
    ///
    /// # Errors
    /// No such key, another value.
    pub fn one_of<T>(&mut self, key: &str, allowed: &str, of: impl Fn(&str) -> Option<T>) -> Result<T> {
        let name = self.text(key, allowed)?;
        of(&name).ok_or_else(|| self.bad(key, &name, allowed))
    }

    /// As [`Section::text`]; `default` where the key is absent.
    ///
    /// # Errors
    /// A value that is no text.
    pub fn text_or(&mut self, key: &str, default: &str) -> Result<String> {
        if self.has(key) {
            self.text(key, "a text")
        } else {
            self.known.push(key.into());
            Ok(default.into())
        }
    }

    /// A list of numbers, or a range `{ from, to, points }`.
    ///
    /// # Errors
    /// No such key, an empty list, values that `ok` refuses or that do not rise strictly.
    pub fn axis(&mut self, key: &str, ok: impl Fn(f64) -> bool, allowed: &str) -> Result<Vec<f64>> {
        let Some(v) = self.take(key) else {
            return Err(self.bad(key, "nothing", allowed));
        };
        let number = |v: &Value| v.as_float().or_else(|| v.as_integer().map(|i| i as f64));
        let values: Option<Vec<f64>> = match &v {
            Value::Array(a) => a.iter().map(number).collect(),
            Value::Table(t) if t.keys().all(|k| ["from", "to", "points"].contains(&k.as_str())) => {
                match (
                    t.get("from").and_then(number),
                    t.get("to").and_then(number),
                    t.get("points").and_then(|p| p.as_integer()),
                ) {
                    (Some(a), Some(b), Some(n)) if (2..=10_000).contains(&n) => {
                        Some(crate::fault::FaultGrid::axis(a, b, n as usize))
                    }
                    _ => None,
                }
            }
            _ => None,
        };
        let Some(values) = values else {
            return Err(self.bad(key, show(&v), allowed));
        };
        if values.is_empty() {
            return Err(self.bad(key, "an empty list", allowed));
        }
        for (i, &x) in values.iter().enumerate() {
            if !(x.is_finite() && ok(x)) {
                return Err(self.bad(&format!("{key}[{i}]"), x, allowed));
            }
            if i > 0 && x <= values[i - 1] {
                return Err(self.bad(
                    &format!("{key}[{i}]"),
                    x,
                    format!("strictly rising values, after {}", values[i - 1]),
                ));
            }
        }
        Ok(values)
    }

    /// A table of its own.
    ///
    /// # Errors
    /// No such key, or no table.
    pub fn section(&mut self, key: &str) -> Result<Section> {
        match self.take(key) {
            Some(Value::Table(table)) => {
                let path = if self.path.is_empty() {
                    key.to_string()
                } else {
                    format!("{}.{key}", self.path)
                };
                Ok(Section {
                    file: self.file.clone(),
                    path,
                    table,
                    known: Vec::new(),
                })
            }
            Some(v) => Err(self.bad(key, show(&v), "a table")),
            None => Err(self.bad(key, "nothing", "a table")),
        }
    }

    /// An array of tables; empty where the key is absent.
    ///
    /// # Errors
    /// A value that is no array of tables.
    pub fn sections(&mut self, key: &str) -> Result<Vec<Section>> {
        let items = match self.take(key) {
            Some(Value::Array(a)) => a,
            Some(v) => return Err(self.bad(key, show(&v), "an array of tables")),
            None => Vec::new(),
        };
        items
            .into_iter()
            .enumerate()
            .map(|(i, v)| match v {
                Value::Table(table) => Ok(Section {
                    file: self.file.clone(),
                    path: format!("{key}[{i}]"),
                    table,
                    known: Vec::new(),
                }),
                v => Err(self.bad(&format!("{key}[{i}]"), show(&v), "a table")),
            })
            .collect()
    }

    /// Refuses what was not asked for.
    ///
    /// # Errors
    /// A key that was not read, with those that were.
    pub fn finish(mut self) -> Result<()> {
        let mut seen = std::collections::BTreeSet::new();
        self.known.retain(|k| seen.insert(k.clone()));
        match self.table.keys().next() {
            Some(k) => Err(self.bad(k, "an unknown key", self.known.join(", "))),
            None => Ok(()),
        }
    }
}
