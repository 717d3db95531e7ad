//! Copies a finished dataset from one place to another, checking what is read; resumes. And mirrors the tables of
//! one in a bucket, for queries.

use super::layout::{MANIFEST, PLAN};
use super::manifest::{File, Manifest};
use super::storage::{Put, Storage};
use crate::progress::interrupted;
use bytes::Bytes;
use rayon::prelude::*;
use schemas::error::{Error, Result};
use schemas::fingerprint::{checksum, fingerprint_bytes};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};

/// Files and bytes that were copied, and files that were there.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Copied {
    /// files copied
    pub files: u64,
    /// bytes copied
    pub bytes: u64,
    /// files that were there with the same size, and were left
    pub there: u64,
}

/// Copies the files of the manifest, tables made later (maps, diagnoses), and the manifest last. `None` when
/// interrupted: what was copied is kept.
///
/// # Errors
/// A dataset that is not finished, a file whose checksum is not that of the manifest, another dataset at the
/// place where it should go.
pub fn copy(from: &Storage, to: &Storage) -> Result<Option<Copied>> {
    let allowed = "a finished dataset (ema dataset merge)";
    let unfinished = || Error::bad(from.describe(), MANIFEST, "nothing", allowed);
    let manifest = Manifest::read(from)?.ok_or_else(unfinished)?;
    let plan = get(from, PLAN)?;
    if to.put_new(PLAN, plan.clone())? == Put::Existed && to.get(PLAN)? != Some(plan) {
        let allowed = "nothing, or the same dataset";
        return Err(Error::bad(to.describe(), PLAN, "another plan", allowed));
    }
    let (bytes, files, there) = (AtomicU64::new(0), AtomicU64::new(0), AtomicU64::new(0));
    let count = |size: usize| {
        files.fetch_add(1, Ordering::Relaxed);
        bytes.fetch_add(size as u64, Ordering::Relaxed);
    };
    manifest.files.par_iter().try_for_each(|f| -> Result<()> {
        if interrupted() {
            return Ok(());
        }
        if to.head(&f.path)? == Some(f.bytes) {
            there.fetch_add(1, Ordering::Relaxed);
            return Ok(());
        }
        let content = checked(from, f)?;
        count(content.len());
        to.put_new(&f.path, content)?;
        Ok(())
    })?;
    if interrupted() {
        return Ok(None);
    }
    for (path, _) in from.list("maps")?.into_iter().chain(from.list("diagnoses")?) {
        let content = get(from, &path)?;
        count(content.len());
        to.replace(&path, content)?;
    }
    to.put_new(MANIFEST, manifest.to_bytes())?;
    Ok(Some(Copied {
        files: files.into_inner(),
        bytes: bytes.into_inner(),
        there: there.into_inner(),
    }))
}

/// The tables of a dataset in a bucket as a folder that queries read, telemetry left out. What the manifest
/// names is fetched once; maps and diagnoses, which may be made anew, each time.
///
/// * `cache` folder for such copies
///
/// # Errors
/// A dataset that is not finished; storage that refuses.
pub fn mirror(from: &Storage, cache: &Path) -> Result<PathBuf> {
    let allowed = "a finished dataset (ema dataset merge)";
    let unfinished = || Error::bad(from.describe(), MANIFEST, "nothing", allowed);
    let manifest = Manifest::read(from)?.ok_or_else(unfinished)?;
    let key = fingerprint_bytes(&[from.describe().as_bytes(), &manifest.to_bytes()].concat());
    let dir = cache.join("datasets").join(key);
    let to = Storage::open(&dir.display().to_string())?;
    for f in manifest.files.iter().filter(|f| !f.path.starts_with("telemetry/")) {
        if to.head(&f.path)? != Some(f.bytes) {
            to.replace(&f.path, checked(from, f)?)?;
        }
    }
    for (path, _) in from.list("maps")?.into_iter().chain(from.list("diagnoses")?) {
        to.replace(&path, get(from, &path)?)?;
    }
    Ok(dir)
}

fn get(from: &Storage, path: &str) -> Result<Bytes> {
    let missing = || Error::bad(from.url(path), "file", "nothing", "that of the manifest");
    from.get(path)?.ok_or_else(missing)
}

/// A file of the manifest, with the checksum that it says.
fn checked(from: &Storage, file: &File) -> Result<Bytes> {
    let content = get(from, &file.path)?;
    if checksum(&content) != file.blake3 {
        let allowed = "that of the manifest (ema dataset verify)";
        return Err(Error::bad(from.url(&file.path), "checksum", "another one", allowed));
    }
    Ok(content)
}
