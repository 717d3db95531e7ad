//! A dataset in a folder.
use super::{Put, STAGING, TEMPORARIES, unique};
use bytes::Bytes;
use rustix::fs::{CWD, RenameFlags, renameat_with};
use rustix::io::Errno;
use schemas::error::{Error, Result};
use std::fs::{self, File};
use std::io::{self, ErrorKind, Read, Seek, SeekFrom, Write};
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::time::{Duration, SystemTime};

/// How often folders that others remove at the same time are made again.
const TRIES: usize = 1000;

#[derive(Debug, Clone)]
pub(super) struct Folder {
    root: PathBuf,
}

impl Folder {
    pub fn open(path: &str) -> Result<Self> {
        let root = std::path::absolute(path).map_err(|e| Error::io(Path::new(path), "cannot be read", e))?;
        match fs::metadata(&root) {
            Ok(m) if !m.is_dir() => Err(Error::bad(
                root.display().to_string(),
                "place of the dataset",
                "a file",
                "a folder, or nothing yet",
            )),
            Err(e) if e.kind() != ErrorKind::NotFound => Err(Error::io(&root, "cannot be read", e)),
            _ => Ok(Self { root }),
        }
    }

    pub fn root(&self) -> &Path {
        &self.root
    }

    pub fn put(&self, path: &str, bytes: &[u8], over: bool) -> Result<Put> {
        let target = self.root.join(path);
        // nothing to write for what is already there: the shard of an earlier attempt
        if !over && self.head(path)?.is_some() {
            return Ok(Put::Existed);
        }
        let put = self.stage(&target, bytes, over).map_err(|e| refused(&target, e));
        if !path.starts_with(STAGING) {
            self.tidy();
        }
        if put? {
            return Ok(Put::Made);
        }
        match self.head(path)? {
            Some(_) => Ok(Put::Existed),
            None => Err(refused(&target, ErrorKind::IsADirectory.into())),
        }
    }

    /// Writes a temporary file and moves it to `target`; false if something was there.
    fn stage(&self, target: &Path, bytes: &[u8], over: bool) -> io::Result<bool> {
        let folder = self.root.join(TEMPORARIES);
        let tmp = folder.join(unique());
        let mut file = with_folder(&folder, || File::create_new(&tmp))?;
        let write = || -> io::Result<bool> {
            file.write_all(bytes)?;
            // the bytes must be on the disk before the name is
            file.sync_data()?;
            drop(file);
            let parent = target.parent().unwrap_or(&self.root);
            let moved = with_folder(parent, || match over {
                true => fs::rename(&tmp, target).map(|()| true),
                false => move_new(&tmp, target),
            })?;
            // some network file systems cannot sync a folder: the name then lasts as it can
            let _ = File::open(parent).and_then(|f| f.sync_all());
            Ok(moved)
        };
        let moved = write();
        if !matches!(moved, Ok(true)) {
            let _ = fs::remove_file(&tmp);
        }
        moved
    }

    /// Removes the folders of temporary files if nobody uses them.
    pub fn tidy(&self) {
        if fs::remove_dir(self.root.join(TEMPORARIES)).is_ok() {
            let _ = fs::remove_dir(self.root.join(STAGING));
        }
    }

    pub fn get(&self, path: &str) -> Result<Option<Bytes>> {
        let file = self.root.join(path);
        there(fs::read(&file))
            .map(|bytes| bytes.map(Bytes::from))
            .map_err(|e| Error::io(&file, "cannot be read", e))
    }

    pub fn get_range(&self, path: &str, range: Range<u64>) -> Result<Option<Bytes>> {
        let name = self.root.join(path);
        let read = || -> io::Result<Vec<u8>> {
            let mut file = File::open(&name)?;
            let end = range.end.min(file.metadata()?.len());
            let size = end.saturating_sub(range.start);
            let mut bytes = Vec::with_capacity(size as usize);
            file.seek(SeekFrom::Start(range.start))?;
            file.take(size).read_to_end(&mut bytes)?;
            Ok(bytes)
        };
        there(read())
            .map(|bytes| bytes.map(Bytes::from))
            .map_err(|e| Error::io(&name, "cannot be read", e))
    }

    /// Folders are no objects.
    pub fn head(&self, path: &str) -> Result<Option<u64>> {
        let file = self.root.join(path);
        there(fs::metadata(&file))
            .map(|m| m.filter(|m| m.is_file()).map(|m| m.len()))
            .map_err(|e| Error::io(&file, "cannot be read", e))
    }

    pub fn list(&self, prefix: &str) -> Result<Vec<(String, u64)>> {
        let mut found = Vec::new();
        let mut folders = vec![prefix.to_owned()];
        while let Some(folder) = folders.pop() {
            let place = self.root.join(&folder);
            let failed = |e| Error::io(&place, "cannot be listed", e);
            let Some(entries) = there(fs::read_dir(&place)).map_err(failed)? else {
                continue;
            };
            for entry in entries {
                let entry = entry.map_err(failed)?;
                // a name that is no text is not ours
                let Ok(name) = entry.file_name().into_string() else {
                    continue;
                };
                let path = match folder.as_str() {
                    "" => name,
                    _ => format!("{folder}/{name}"),
                };
                // gone meanwhile, or a link to nowhere
                let Some(meta) = there(fs::metadata(entry.path())).map_err(failed)? else {
                    continue;
                };
                if meta.is_file() {
                    found.push((path, meta.len()));
                } else if meta.is_dir() && path != TEMPORARIES {
                    folders.push(path);
                }
            }
        }
        Ok(found)
    }

    pub fn delete(&self, path: &str) -> Result<()> {
        let file = self.root.join(path);
        there(fs::remove_file(&file))
            .map(|_| ())
            .map_err(|e| Error::io(&file, "cannot be deleted", e))
    }

    pub fn delete_all(&self, prefix: &str) -> Result<()> {
        let folder = self.root.join(prefix);
        for _ in 0..TRIES {
            match fs::remove_dir_all(&folder) {
                // another process put a file there at this moment
                Err(e) if e.kind() == ErrorKind::DirectoryNotEmpty => continue,
                gone => {
                    return there(gone)
                        .map(|_| ())
                        .map_err(|e| Error::io(&folder, "cannot be deleted", e));
                }
            }
        }
        Err(Error::io(
            &folder,
            "cannot be deleted",
            ErrorKind::DirectoryNotEmpty.into(),
        ))
    }

    pub fn sweep(&self, age: Duration) -> Result<usize> {
        let folder = self.root.join(TEMPORARIES);
        let failed = |e| Error::io(&folder, "cannot be swept", e);
        let mut count = 0;
        for entry in there(fs::read_dir(&folder)).map_err(failed)?.into_iter().flatten() {
            let entry = entry.map_err(failed)?;
            let Some(meta) = there(entry.metadata()).map_err(failed)? else {
                continue;
            };
            let written = meta.modified().map_err(failed)?;
            // a file from the future (another machine's clock) is young
            let old = SystemTime::now().duration_since(written).is_ok_and(|a| a >= age);
            if meta.is_file() && old {
                there(fs::remove_file(entry.path())).map_err(failed)?;
                count += 1;
            }
        }
        self.tidy();
        Ok(count)
    }
}

fn refused(target: &Path, e: io::Error) -> Error {
    Error::io(target, "cannot be written", e)
}

/// Nothing there is an answer, no error: no such name, or a file where a folder should be.
fn there<T>(answer: io::Result<T>) -> io::Result<Option<T>> {
    match answer {
        Ok(value) => Ok(Some(value)),
        Err(e) if matches!(e.kind(), ErrorKind::NotFound | ErrorKind::NotADirectory) => Ok(None),
        Err(e) => Err(e),
    }
}

/// Does what needs a folder; makes the folder when it is missing, again if others remove it.
fn with_folder<T>(folder: &Path, mut act: impl FnMut() -> io::Result<T>) -> io::Result<T> {
    let mut last = ErrorKind::NotFound.into();
    for _ in 0..TRIES {
        match act() {
            Err(e) if e.kind() == ErrorKind::NotFound => last = e,
            done => return done,
        }
        match fs::create_dir_all(folder) {
            // a folder that others remove at this moment is seen to exist, and then is none
            Err(e) if matches!(e.kind(), ErrorKind::NotFound | ErrorKind::AlreadyExists) => last = e,
            made => made?,
        }
    }
    Err(last)
}

/// Moves a file to a name that must be free; false if it is not. Network file systems that cannot
/// rename so have hard links.
fn move_new(from: &Path, to: &Path) -> io::Result<bool> {
    match renameat_with(CWD, from, CWD, to, RenameFlags::NOREPLACE) {
        Err(Errno::INVAL | Errno::NOSYS | Errno::OPNOTSUPP) => {}
        Err(Errno::EXIST) => return Ok(false),
        moved => return moved.map(|()| true).map_err(io::Error::from),
    }
    link_new(from, to)
}

fn link_new(from: &Path, to: &Path) -> io::Result<bool> {
    match fs::hard_link(from, to) {
        Ok(()) => fs::remove_file(from).map(|()| true),
        Err(e) if e.kind() == ErrorKind::AlreadyExists => Ok(false),
        Err(e) => Err(e),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn prop_neither_way_of_moving_overwrites() {
        let folder = std::env::temp_dir().join(unique());
        fs::create_dir(&folder).unwrap();
        for (moves, to) in [(move_new as fn(&Path, &Path) -> _, "moved"), (link_new, "linked")] {
            let (a, b, to) = (folder.join("a"), folder.join("b"), folder.join(to));
            fs::write(&a, "a").unwrap();
            fs::write(&b, "b").unwrap();
            assert!(moves(&a, &to).unwrap());
            assert!(!moves(&b, &to).unwrap());
            assert_eq!(fs::read(&to).unwrap(), b"a");
            assert!(!a.exists() && b.exists());
        }
        fs::remove_dir_all(&folder).unwrap();
    }
}
