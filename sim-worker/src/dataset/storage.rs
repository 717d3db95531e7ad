//! Where a dataset lies: a folder or a prefix of an S3 bucket, behind one blocking interface.
//!
//! Every object appears whole or not at all, under its name only when it is whole. A local put
//! writes below `_staging/tmp/` and then moves the file without overwriting, so that a process
//! killed at any moment leaves nothing that a glob or a dataset reader would find.
mod bucket;
mod folder;

use bucket::Bucket;
use bytes::Bytes;
use folder::Folder;
use schemas::error::{Error, Result};
use std::hash::{BuildHasher, Hasher};
use std::ops::Range;
use std::path::PathBuf;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, SystemTime, UNIX_EPOCH};

/// Folder of everything that is not yet part of the dataset.
pub const STAGING: &str = "_staging";
/// Folder of half-written local files: listed by nothing, emptied by [`Storage::sweep`].
const TEMPORARIES: &str = "_staging/tmp";
const URLS: &str = "a folder, file:///folder or s3://bucket/prefix";

/// What a conditional put found.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Put {
    /// The object was not there; it is now, with these bytes.
    Made,
    /// The object was there before and is as it was.
    Existed,
}

/// A folder or a bucket prefix. Cheap to clone; all calls block and may be made from any thread.
#[derive(Debug, Clone)]
pub struct Storage(Place);

#[derive(Debug, Clone)]
enum Place {
    Folder(Folder),
    Bucket(Bucket),
}

impl Storage {
    /// Opens a folder (relative, absolute, `file:///...`; it need not exist yet) or
    /// `s3://bucket/prefix`, with credentials, region and endpoint from the `AWS_*` environment
    /// variables. A bucket is asked for one page of its list, so that a wrong key, bucket or
    /// endpoint is found here, within about ten seconds, and not after hours of computing.
    ///
    /// # Errors
    /// Another scheme, a path that is a file, settings that the bucket refuses ([`Error::Bad`]);
    /// an endpoint that does not answer ([`Error::Stream`]).
    pub fn open(url: &str) -> Result<Self> {
        let text = |(key, value): (std::ffi::OsString, std::ffi::OsString)| {
            Some((key.into_string().ok()?, value.into_string().ok()?))
        };
        Self::open_with(url, std::env::vars_os().filter_map(text))
    }

    /// As [`Storage::open`], with the variables given instead of taken from the environment.
    ///
    /// # Errors
    /// As [`Storage::open`].
    pub fn open_with(url: &str, settings: impl IntoIterator<Item = (String, String)>) -> Result<Self> {
        let refuse = |found: &str| Err(Error::bad(without_user(url), "place of the dataset", found, URLS));
        if let Some(rest) = url.strip_prefix("s3://").or_else(|| url.strip_prefix("s3a://")) {
            let (bucket, prefix) = rest.split_once('/').unwrap_or((rest, ""));
            let name = |c: char| c.is_ascii_alphanumeric() || ".-_".contains(c);
            if bucket.is_empty() || !bucket.chars().all(name) {
                return refuse("a bucket name that cannot be");
            }
            let prefix = prefix.trim_matches('/');
            if !prefix.is_empty() && !plain(prefix) {
                return refuse("a prefix with characters other than A-Z a-z 0-9 _ . = + @ , -");
            }
            return Bucket::open(url, bucket, prefix, settings).map(|b| Self(Place::Bucket(b)));
        }
        let folder = if let Some(rest) = url.strip_prefix("file://") {
            match rest.strip_prefix("localhost").unwrap_or(rest) {
                path if path.starts_with('/') => match percent_decoded(path) {
                    Some(path) => path,
                    None => return refuse("percent signs that decode to no text"),
                },
                _ => return refuse("a file URL with a host"),
            }
        } else if let Some((scheme, _)) = url.split_once(":/").filter(|(s, _)| is_scheme(s)) {
            return refuse(&format!("scheme {scheme}"));
        } else {
            url.to_owned()
        };
        if folder.is_empty() || folder.contains('\0') {
            return refuse("no path");
        }
        Folder::open(&folder).map(|f| Self(Place::Folder(f)))
    }

    /// Puts an object that must not be there yet. Of any number of processes that put the same
    /// name at the same time exactly one is told [`Put::Made`], also where answers of the network
    /// are lost and the request is repeated.
    ///
    /// # Errors
    /// A path that no object may have; what the file system or the network refuses. After an
    /// error the object may be there, but only whole.
    pub fn put_new(&self, path: &str, bytes: impl Into<Bytes>) -> Result<Put> {
        self.new_name(path)?;
        match &self.0 {
            Place::Folder(f) => f.put(path, &bytes.into(), false),
            Place::Bucket(b) => b.put_new(path, bytes.into()),
        }
    }

    /// Puts an object in place of one that may be there; a reader sees the old one or the new one.
    ///
    /// # Errors
    /// As [`Storage::put_new`]; after an error the old object may still be there.
    pub fn replace(&self, path: &str, bytes: impl Into<Bytes>) -> Result<()> {
        self.new_name(path)?;
        match &self.0 {
            Place::Folder(f) => f.put(path, &bytes.into(), true).map(|_| ()),
            Place::Bucket(b) => b.replace(path, bytes.into()),
        }
    }

    /// The whole object, or nothing if there is none.
    ///
    /// # Errors
    /// What the file system or the network refuses.
    pub fn get(&self, path: &str) -> Result<Option<Bytes>> {
        self.name(path)?;
        match &self.0 {
            Place::Folder(f) => f.get(path),
            Place::Bucket(b) => b.get(path),
        }
    }

    /// The bytes `range` of an object, or nothing if there is no object.
    ///
    /// # Errors
    /// An object shorter than the range ([`Error::Torn`]); what the file system or the network
    /// refuses.
    pub fn get_range(&self, path: &str, range: Range<u64>) -> Result<Option<Bytes>> {
        self.name(path)?;
        if range.start >= range.end {
            return Ok(self.head(path)?.map(|_| Bytes::new()));
        }
        let part = match &self.0 {
            Place::Folder(f) => f.get_range(path, range.clone()),
            Place::Bucket(b) => b.get_range(path, range.clone()),
        }?;
        match part {
            Some(part) if part.len() as u64 != range.end - range.start => Err(Error::Torn {
                file: self.url(path),
                why: format!("ends before byte {}", range.end),
            }),
            part => Ok(part),
        }
    }

    /// The size of an object in bytes, or nothing if there is none.
    ///
    /// # Errors
    /// What the file system or the network refuses.
    pub fn head(&self, path: &str) -> Result<Option<u64>> {
        self.name(path)?;
        match &self.0 {
            Place::Folder(f) => f.head(path),
            Place::Bucket(b) => b.head(path),
        }
    }

    /// All objects below the folder `prefix` (empty: all), with their sizes, sorted by path.
    /// Temporary files of puts are no objects.
    ///
    /// # Errors
    /// What the file system or the network refuses.
    pub fn list(&self, prefix: &str) -> Result<Vec<(String, u64)>> {
        if !prefix.is_empty() {
            self.name(prefix)?;
        }
        let mut found = match &self.0 {
            Place::Folder(f) => f.list(prefix),
            Place::Bucket(b) => b.list(prefix),
        }?;
        found.sort();
        Ok(found)
    }

    /// Removes an object; one that is not there is no error.
    ///
    /// # Errors
    /// What the file system or the network refuses.
    pub fn delete(&self, path: &str) -> Result<()> {
        self.name(path)?;
        match &self.0 {
            Place::Folder(f) => f.delete(path),
            Place::Bucket(b) => b.delete(vec![path.to_owned()]),
        }
    }

    /// Removes the folder `prefix` and all below it, and says how many objects those were.
    ///
    /// # Errors
    /// An empty prefix; what the file system or the network refuses.
    pub fn delete_prefix(&self, prefix: &str) -> Result<usize> {
        self.name(prefix)?;
        let objects = self.list(prefix)?;
        let count = objects.len();
        match &self.0 {
            Place::Folder(f) => f.delete_all(prefix)?,
            Place::Bucket(b) => b.delete(objects.into_iter().map(|(path, _)| path).collect())?,
        }
        Ok(count)
    }

    /// Removes temporary files that killed processes left and that are older than `age`, and says
    /// how many. A bucket has none: there an object is one request.
    ///
    /// # Errors
    /// What the file system refuses.
    pub fn sweep(&self, age: Duration) -> Result<usize> {
        match &self.0 {
            Place::Folder(f) => f.sweep(age),
            Place::Bucket(_) => Ok(0),
        }
    }

    /// Puts and removes an empty object below `_staging/`: finds before the work begins that
    /// nothing may be written here.
    ///
    /// # Errors
    /// As [`Storage::put_new`].
    pub fn try_write(&self) -> Result<()> {
        let path = format!("{TEMPORARIES}/try-{}", unique());
        self.put_new(&path, Bytes::new())?;
        self.delete(&path)?;
        if let Place::Folder(f) = &self.0 {
            f.tidy();
        }
        Ok(())
    }

    /// The place in words, for messages: the folder, or the prefix with its endpoint.
    pub fn describe(&self) -> String {
        match &self.0 {
            Place::Folder(f) => f.root().display().to_string(),
            Place::Bucket(b) => b.describe(""),
        }
    }

    /// The object as a path or URL that other programs understand.
    pub fn url(&self, path: &str) -> String {
        match &self.0 {
            Place::Folder(f) => f.root().join(path).display().to_string(),
            Place::Bucket(b) => b.url(path),
        }
    }

    /// The folder, if the dataset lies in one.
    pub fn local_path(&self) -> Option<PathBuf> {
        match &self.0 {
            Place::Folder(f) => Some(f.root().to_owned()),
            Place::Bucket(_) => None,
        }
    }

    /// Refuses what would lead out of the dataset.
    fn name(&self, path: &str) -> Result<()> {
        let part = |p: &str| !p.is_empty() && p != "." && p != ".." && !p.contains(['\\', '\0']);
        if path.split('/').all(part) {
            return Ok(());
        }
        Err(self.refused_name(path, "names joined by /, none empty, . or .."))
    }

    /// Refuses names that do not mean the same in a folder, a bucket and a URL.
    fn new_name(&self, path: &str) -> Result<()> {
        self.name(path)?;
        if plain(path) {
            return Ok(());
        }
        Err(self.refused_name(path, "A-Z a-z 0-9 _ . = + @ , - and /"))
    }

    fn refused_name(&self, path: &str, allowed: &str) -> Error {
        Error::bad(self.describe(), "object name", format!("{path:?}"), allowed)
    }
}

/// Whether every part of the path is made of characters that need no escape anywhere.
fn plain(path: &str) -> bool {
    let sign = |c: char| c.is_ascii_alphanumeric() || "_.=+@,-".contains(c);
    path.split('/')
        .all(|p| !p.is_empty() && p != "." && p != ".." && p.chars().all(sign))
}

fn is_scheme(text: &str) -> bool {
    text.len() > 1 && text.chars().all(|c| c.is_ascii_alphanumeric() || "+.-".contains(c))
}

fn percent_decoded(text: &str) -> Option<String> {
    let mut bytes = Vec::with_capacity(text.len());
    let mut rest = text.as_bytes();
    while let Some((&first, tail)) = rest.split_first() {
        rest = tail;
        if first == b'%' {
            let digits = std::str::from_utf8(tail.get(..2)?).ok()?;
            bytes.push(u8::from_str_radix(digits, 16).ok()?);
            rest = &tail[2..];
        } else {
            bytes.push(first);
        }
    }
    String::from_utf8(bytes).ok()
}

/// The URL without `user:password@`.
fn without_user(url: &str) -> String {
    let Some((scheme, rest)) = url.split_once("://") else {
        return url.to_owned();
    };
    let authority = rest.find('/').unwrap_or(rest.len());
    match rest[..authority].rfind('@') {
        Some(at) => format!("{scheme}://{}", &rest[at + 1..]),
        None => url.to_owned(),
    }
}

/// A name that no other call, thread, process or machine makes.
fn unique() -> String {
    static COUNT: AtomicU64 = AtomicU64::new(0);
    let count = COUNT.fetch_add(1, Ordering::Relaxed);
    let now = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    // keys from the operating system's random source
    let mut hash = std::collections::hash_map::RandomState::new().build_hasher();
    hash.write_u128(now.as_nanos());
    hash.write_u64(count);
    format!("{}-{count}-{:016x}", std::process::id(), hash.finish())
}
