//! A log of JSON lines: one object a diagnosis, appended.

use super::{MOST_READ, lock};
use crate::live::StreamId;
use crate::report::Logged;
use schemas::error::{Error, Result};
use schemas::stream::wire::to_text;
use serde_json::Value;
use std::fs::{File, OpenOptions};
use std::io::{Read, Seek, SeekFrom, Write};
use std::path::Path;

/// Appends lines; a failed write leaves no part of a line.
pub(super) struct Lines {
    file: File,
}

impl Lines {
    pub fn open(path: &Path) -> Result<Self> {
        let options = OpenOptions::new().read(true).append(true).create(true).clone();
        let mut file = options.open(path).map_err(|e| Error::io(path, "cannot be opened", e))?;
        lock(&file, path)?;
        mend(&mut file).map_err(|e| Error::io(path, "cannot be mended", e))?;
        Ok(Self { file })
    }

    pub fn file(&self) -> &File {
        &self.file
    }

    pub fn write(&mut self, list: &[Logged]) -> Result<(), String> {
        let mut text = String::new();
        for l in list {
            text += &l.to_json().to_string();
            text.push('\n');
        }
        append(&mut self.file, text.as_bytes())
    }

    /// Streams of the last lines.
    pub fn concluded(&mut self) -> Vec<StreamId> {
        let text = last_bytes(&mut self.file, MOST_READ).unwrap_or_default();
        let lines = text.split(|b| *b == b'\n');
        lines.filter_map(stream_of).collect()
    }
}

/// The stream of a line, if it is a final diagnosis.
fn stream_of(line: &[u8]) -> Option<StreamId> {
    let v: Value = serde_json::from_slice(line).ok()?;
    let stream = u64::from_str_radix(v["stream"].as_str()?, 16).ok()?;
    let is_final = v["final"].as_bool()?;
    is_final.then_some((to_text(v["actuator"].as_str()?), stream))
}

/// Appends all of `bytes` or nothing.
pub(super) fn append(file: &mut File, bytes: &[u8]) -> Result<(), String> {
    let before = file.metadata().map_err(|e| e.to_string())?.len();
    file.write_all(bytes).map_err(|e| {
        let _ = file.set_len(before);
        e.to_string()
    })
}

/// At most `most` bytes from the end of a file.
fn last_bytes(file: &mut File, most: u64) -> std::io::Result<Vec<u8>> {
    let len = file.seek(SeekFrom::End(0))?;
    let from = len.saturating_sub(most);
    file.seek(SeekFrom::Start(from))?;
    let mut bytes = Vec::new();
    Read::take(&mut *file, len - from).read_to_end(&mut bytes)?;
    Ok(bytes)
}

/// Cuts off a line that a process did not finish.
fn mend(file: &mut File) -> std::io::Result<()> {
    const LONGEST: u64 = 1 << 16;
    let bytes = last_bytes(file, LONGEST)?;
    if bytes.last().is_some_and(|b| *b != b'\n') {
        let from = file.metadata()?.len().saturating_sub(LONGEST);
        let end = bytes.iter().rposition(|b| *b == b'\n').map_or(0, |i| i + 1);
        if serde_json::from_slice::<Value>(&bytes[end..]).is_ok() {
            // whole, but for its end
            file.write_all(b"\n")?;
        } else {
            file.set_len(from + end as u64)?;
        }
    }
    Ok(())
}
