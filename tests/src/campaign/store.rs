//! Results on disk: a line per case, written at once, so that a campaign goes on where it was stopped.

use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::fs::{File, OpenOptions};
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::sync::Mutex;

/// Results of one class. The first line says which program made them, from which seed.
pub struct Store {
    file: Mutex<File>,
}

/// What a file of results holds.
#[derive(Debug, Default, PartialEq)]
pub struct Stored {
    pub fingerprint: String,
    pub seed: u64,
    /// last line of each case
    pub cases: BTreeMap<u64, Value>,
    /// bytes up to the end of the last whole line
    whole: u64,
}

/// What is in a file; empty where there is none. A torn last line, or one that cannot be read, is left out.
pub fn read(path: &Path) -> io::Result<Stored> {
    let bytes = match std::fs::read(path) {
        Err(e) if e.kind() == io::ErrorKind::NotFound => return Ok(Stored::default()),
        other => other?,
    };
    let mut out = Stored::default();
    for line in bytes.split_inclusive(|b| *b == b'\n') {
        if line.last() != Some(&b'\n') {
            break;
        }
        out.whole += line.len() as u64;
        let Ok(value) = serde_json::from_slice::<Value>(line) else {
            continue;
        };
        if let Some(f) = value["fingerprint"].as_str() {
            out.fingerprint = f.to_string();
            out.seed = value["seed"].as_u64().unwrap_or(0);
        } else if let Some(n) = value["case"].as_u64() {
            out.cases.insert(n, value);
        }
    }
    Ok(out)
}

/// A store to write to, and what it holds already.
pub struct Opened {
    pub store: Store,
    pub stored: Stored,
    /// where results of another program or seed went
    pub replaced: Option<PathBuf>,
}

impl Store {
    /// Opens the results of a class; those of another program or seed are moved away.
    pub fn open(path: &Path, fingerprint: &str, seed: u64) -> io::Result<Opened> {
        if let Some(dir) = path.parent() {
            std::fs::create_dir_all(dir)?;
        }
        let mut stored = read(path)?;
        let mut replaced = None;
        if stored.whole > 0 && (stored.fingerprint != fingerprint || stored.seed != seed) {
            let old = path.with_extension("jsonl.old");
            std::fs::rename(path, &old)?;
            replaced = Some(old);
            stored = Stored::default();
        }
        let file = OpenOptions::new().create(true).append(true).open(path)?;
        file.set_len(stored.whole)?;
        let store = Self { file: Mutex::new(file) };
        if stored.whole == 0 {
            store.append(&json!({ "fingerprint": fingerprint, "seed": seed }))?;
            (stored.fingerprint, stored.seed) = (fingerprint.to_string(), seed);
        }
        Ok(Opened {
            store,
            stored,
            replaced,
        })
    }

    /// Adds a line, in one piece.
    pub fn append(&self, line: &Value) -> io::Result<()> {
        let mut file = self.file.lock().unwrap_or_else(|e| e.into_inner());
        file.write_all(format!("{line}\n").as_bytes())?;
        file.flush()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn open(path: &Path, fingerprint: &str) -> (Store, Vec<u64>, bool) {
        let o = Store::open(path, fingerprint, 1).unwrap();
        (o.store, o.stored.cases.into_keys().collect(), o.replaced.is_some())
    }

    #[test]
    fn a_campaign_goes_on_where_it_was_stopped() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("deep/one.jsonl");
        let (store, cases, _) = open(&path, "a");
        assert!(cases.is_empty());
        for n in [0, 2, 1] {
            store.append(&json!({ "case": n, "verdict": "none" })).unwrap();
        }
        drop(store);
        // killed in the middle of a line
        let mut file = OpenOptions::new().append(true).open(&path).unwrap();
        file.write_all(b"{\"case\": 3, \"verd").unwrap();
        let (store, cases, replaced) = open(&path, "a");
        assert_eq!((cases, replaced), (vec![0, 1, 2], false));
        store.append(&json!({ "case": 3, "verdict": "named" })).unwrap();
        drop(store);
        let stored = read(&path).unwrap();
        assert_eq!(stored.cases.len(), 4);
        assert_eq!(stored.cases[&3]["verdict"], "named");
        assert_eq!(stored.whole, std::fs::metadata(&path).unwrap().len());
    }

    #[test]
    fn another_program_or_seed_starts_anew() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("one.jsonl");
        let (store, ..) = open(&path, "a");
        store.append(&json!({ "case": 0 })).unwrap();
        drop(store);
        let (_, cases, replaced) = open(&path, "b");
        assert_eq!((cases, replaced), (vec![], true));
        assert_eq!(read(&dir.path().join("one.jsonl.old")).unwrap().cases.len(), 1);
        let other = Store::open(&path, "b", 2).unwrap();
        assert!(other.replaced.is_some() && other.stored.cases.is_empty());
        // killed before the first line was whole
        std::fs::write(&path, "{\"finger").unwrap();
        let (_, cases, replaced) = open(&path, "b");
        assert_eq!((cases, replaced), (vec![], false));
        assert_eq!(read(&path).unwrap().fingerprint, "b");
    }
}
