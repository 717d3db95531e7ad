//! What a finished dataset consists of.

use super::layout::MANIFEST;
use super::storage::Storage;
use schemas::SCHEMA_VERSION;
use schemas::error::{Error, Result};
use serde::{Deserialize, Serialize};
use std::path::Path;

/// The object that is committed last.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Manifest {
    /// [`SCHEMA_VERSION`] of the writer
    pub schema_version: u32,
    /// name of the plan
    pub name: String,
    /// fingerprint of the plan
    pub plan: String,
    /// hash of the program's sources
    pub source: String,
    /// actuators of the plan
    pub actuators: u64,
    /// runs of all actuators
    pub runs: u64,
    /// parts of the plan
    pub parts: u64,
    /// in the order of their names
    pub files: Vec<File>,
}

/// One file of a dataset.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct File {
    /// in the dataset, with `/`
    pub path: String,
    /// size [bytes]
    pub bytes: u64,
    /// checksum, 64 hexadecimal digits
    pub blake3: String,
    /// rows of the table
    pub rows: u64,
    /// number of its first run; none for a table without runs
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub first_run: Option<u64>,
    /// how many runs; none for a table without runs
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub runs: Option<u64>,
}

impl Manifest {
    /// The dataset's manifest; `None` where it is not finished.
    ///
    /// # Errors
    /// Storage that refuses, a text that is no manifest, another schema version.
    pub fn read(storage: &Storage) -> Result<Option<Self>> {
        let Some(bytes) = storage.get(MANIFEST)? else {
            return Ok(None);
        };
        let file = format!("{}/{MANIFEST}", storage.describe());
        let m: Self = serde_json::from_slice(&bytes).map_err(|e| Error::torn(Path::new(&file), e))?;
        if m.schema_version != SCHEMA_VERSION {
            return Err(Error::bad(
                file,
                "schema_version",
                m.schema_version,
                SCHEMA_VERSION.to_string(),
            ));
        }
        Ok(Some(m))
    }

    /// As JSON, a line a value.
    pub fn to_bytes(&self) -> Vec<u8> {
        let mut text = serde_json::to_string_pretty(self).expect("plain data");
        text.push('\n');
        text.into_bytes()
    }
}
