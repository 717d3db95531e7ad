//! One error for everything that comes from outside. What it shows holds no control characters, wherever it is
//! printed.

use crate::foreign::{line, value};
use std::path::Path;

/// Bad input or a failed file operation, in one line: which file, which place, what is there,
/// what is allowed.
#[derive(Debug, Clone, thiserror::Error)]
pub enum Error {
    /// A value that the format or physics forbids.
    #[error(
        "{}: {}: found {}; allowed: {}",
        line(file),
        line(place),
        value(found),
        line(allowed)
    )]
    Bad {
        /// file, object or source (`command line`, `environment`)
        file: String,
        /// key, column, line or place in it
        place: String,
        /// what is there
        found: String,
        /// what may be there, in words
        allowed: String,
    },
    /// The operating system refused.
    #[error("{}: {what}: {}", line(file), line(why))]
    Io {
        /// file that the operation was on
        file: String,
        /// what failed, in words: `cannot be read`, `cannot be written` ...
        what: &'static str,
        /// the system's reason
        why: String,
    },
    /// Shared memory or a network refused.
    #[error("{}: {}", line(service), line(why))]
    Stream {
        /// service of shared memory, or address
        service: String,
        /// what failed and why, in one line
        why: String,
    },
    /// A file that is not what its name says.
    #[error("{}: {}", line(file), line(why))]
    Torn {
        /// file or object
        file: String,
        /// what is wrong with it, in one line
        why: String,
    },
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

    /// A value that is not allowed, see [`Error::Bad`].
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

    /// A refusal of the operating system, see [`Error::Io`].
    ///
    /// * `what` failed; `cannot be read` and `is in use` are bad input to [`Error::exit_code`]
    pub fn io(file: &Path, what: &'static str, why: std::io::Error) -> Self {
        Self::Io {
            file: file.display().to_string(),
            what,
            why: why.to_string(),
        }
    }

    /// A file that is not what its name says, see [`Error::Torn`].
    pub fn torn(file: &Path, why: impl std::fmt::Display) -> Self {
        Self::Torn {
            file: file.display().to_string(),
            why: why.to_string(),
        }
    }
}

/// What everything that reads, writes or checks gives.
pub type Result<T, E = Error> = std::result::Result<T, E>;

/// Writes `bytes` under a temporary name beside `path` and renames it: a reader sees the whole
/// file or none.
///
/// # Errors
/// What the disk refuses; the file under `path` is then the old one, or none.
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn refuse_control_characters_in_every_error() {
        let hostile = "x\x1b]0;gone\x07\n\u{9b}";
        let path = Path::new(hostile);
        let errors = [
            Error::bad(hostile, hostile, hostile, hostile),
            Error::io(path, "cannot be read", std::io::Error::other(hostile)),
            Error::torn(path, hostile),
            Error::Stream {
                service: hostile.into(),
                why: hostile.into(),
            },
        ];
        for e in errors {
            let text = e.to_string();
            assert!(text.chars().all(crate::foreign::is_plain), "{text:?}");
            assert!(text.contains("x\\u{1b}]0;gone"), "{text}");
        }
        let long = Error::bad("file", "place", "9".repeat(1 << 20), "1").to_string();
        assert!(long.len() < 400, "{}", long.len());
    }
}
