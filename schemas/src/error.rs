//! One error for everything that comes from outside.

use std::path::Path;

/// Bad input or a failed file operation, in one line: which file, which place, what is there,
/// what is allowed.
#[derive(Debug, Clone, thiserror::Error)]
pub enum Error {
    /// A value that the format or physics forbids.
    #[error("{file}: {place}: found {found}; allowed: {allowed}")]
    Bad {
        file: String,
        place: String,
        found: String,
        allowed: String,
    },
    /// The operating system refused.
    #[error("{file}: {what}: {why}")]
    Io {
        file: String,
        what: &'static str,
        why: String,
    },
    /// Shared memory or a network refused.
    #[error("{service}: {why}")]
    Stream { service: String, why: String },
    /// A file that is not what its name says.
    #[error("{file}: {why}")]
    Torn { file: String, why: String },
}

/// Exit code: finished, but something is missing (an incomplete diagnosis, lost frames).
pub const EXIT_LOSS: u8 = 3;
/// Exit code: a file or value that is not allowed.
pub const EXIT_BAD_INPUT: u8 = 4;
/// Exit code: stopped by Ctrl-C or SIGTERM.
pub const EXIT_INTERRUPTED: u8 = 130;

impl Error {
    /// The exit code that stands for the error.
    pub fn exit_code(&self) -> u8 {
        match self {
            Self::Bad { .. } | Self::Torn { .. } => EXIT_BAD_INPUT,
            Self::Io {
                what: "cannot be read" | "is in use",
                ..
            } => EXIT_BAD_INPUT,
            _ => 1,
        }
    }

    pub fn bad(
        file: impl Into<String>,
        place: impl Into<String>,
        found: impl std::fmt::Display,
        allowed: impl Into<String>,
    ) -> Self {
        Self::Bad {
            file: file.into(),
            place: place.into(),
            found: found.to_string(),
            allowed: allowed.into(),
        }
    }

    pub fn io(file: &Path, what: &'static str, why: std::io::Error) -> Self {
        Self::Io {
            file: file.display().to_string(),
            what,
            why: why.to_string(),
        }
    }

    pub fn torn(file: &Path, why: impl std::fmt::Display) -> Self {
        Self::Torn {
            file: file.display().to_string(),
            why: why.to_string(),
        }
    }
}

pub type Result<T, E = Error> = std::result::Result<T, E>;

/// Writes `bytes` under a temporary name beside `path` and renames it: a reader sees the whole
/// file or none.
pub fn write_whole(path: &Path, bytes: &[u8]) -> Result<()> {
    use std::io::Write;
    let tmp = temporary(path);
    let write = || -> std::io::Result<()> {
        let mut f = std::fs::File::create(&tmp)?;
        f.write_all(bytes)?;
        f.sync_all()?;
        std::fs::rename(&tmp, path)
    };
    write().map_err(|e| {
        let _ = std::fs::remove_file(&tmp);
        Error::io(path, "cannot be written", e)
    })
}

/// Temporary name of `path`: hidden, in the same folder, of this process.
pub fn temporary(path: &Path) -> std::path::PathBuf {
    let name = path
        .file_name()
        .map(|n| n.to_string_lossy().into_owned())
        .unwrap_or_default();
    path.with_file_name(format!(".{name}.tmp-{}", std::process::id()))
}
