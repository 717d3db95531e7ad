//! Recordings and histories from Python: paths, or tables.

use crate::table::{Table, from_any};
use pyo3::prelude::*;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};

/// How a table without a file is called in messages.
const TABLE: &str = "table";

/// A file that ends with its value.
pub struct Scratch(PathBuf);

impl Scratch {
    /// * `ending` with its point
    fn new(ending: &str) -> Self {
        static COUNT: AtomicU64 = AtomicU64::new(0);
        let n = COUNT.fetch_add(1, Ordering::Relaxed);
        let name = format!("ema-{}-{n}{ending}", std::process::id());
        Self(std::env::temp_dir().join(name))
    }

    /// A file with these bytes.
    pub fn with(ending: &str, bytes: &[u8]) -> anyhow::Result<Self> {
        let new = Self::new(ending);
        std::fs::write(&new.0, bytes).map_err(|e| schemas::error::Error::io(&new.0, "cannot be written", e))?;
        Ok(new)
    }

    pub fn path(&self) -> &Path {
        &self.0
    }
}

impl Drop for Scratch {
    fn drop(&mut self) {
        let _ = std::fs::remove_file(&self.0);
    }
}

/// A file, or a table that becomes one for the time of a call: it goes through the same reader and the same checks.
pub enum Source {
    File(PathBuf),
    Table(Table),
}

/// A source that lies in a file.
pub struct Placed {
    path: PathBuf,
    scratch: Option<Scratch>,
}

impl Source {
    pub fn of(given: &Bound<'_, PyAny>) -> PyResult<Self> {
        match given.extract::<PathBuf>() {
            Ok(path) => Ok(Self::File(path)),
            Err(_) => Ok(Self::Table(from_any(given)?)),
        }
    }

    pub fn place(self) -> anyhow::Result<Placed> {
        Ok(match self {
            Self::File(path) => Placed { path, scratch: None },
            Self::Table(t) => {
                let scratch = Scratch::with(".parquet", &t.bytes()?)?;
                Placed {
                    path: scratch.path().into(),
                    scratch: Some(scratch),
                }
            }
        })
    }
}

impl Placed {
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// A text without the name of a file that is there for a call only.
    pub fn named(&self, text: &str) -> String {
        match &self.scratch {
            Some(s) => text.replace(&s.path().display().to_string(), TABLE),
            None => text.into(),
        }
    }

    /// An error of the project in which the file of a call is called a table.
    pub fn renamed(&self, e: anyhow::Error) -> anyhow::Error {
        use schemas::error::Error;
        if self.scratch.is_none() {
            return e;
        }
        let name = |t: &str| self.named(t);
        match e.downcast::<Error>() {
            Ok(Error::Bad {
                file,
                place,
                found,
                allowed,
            }) => Error::bad(name(&file), name(&place), name(&found), name(&allowed)).into(),
            Ok(Error::Torn { file, why }) => Error::Torn {
                file: name(&file),
                why: name(&why),
            }
            .into(),
            Ok(other) => other.into(),
            Err(e) => e,
        }
    }
}
