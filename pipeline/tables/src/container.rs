//! What a file is, by its first bytes: compressed text is opened, text of any encoding decoded, and what is no table is
//! called by its name.

use schemas::error::{Error, Result};
use std::borrow::Cow;
use std::io::Read;
use std::path::Path;

/// Most that a compressed file may come to [bytes] (assumed): a day of telemetry at 10 kHz.
const LARGEST: u64 = 4 << 30;

/// What is read, in words.
const READ: &str = "CSV (also gzip or zstd), Parquet or Arrow IPC";

/// A file by its kind.
pub(crate) enum Content {
    Parquet,
    /// the file format, or the stream format
    Arrow {
        is_stream: bool,
    },
    Text(String),
}

/// Formats that are known, but not read, and what helps.
const OTHERS: [(&[u8], &str); 9] = [
    (
        b"PK\x03\x04",
        "an Excel workbook or another zip archive; save the sheet as CSV",
    ),
    (
        b"\xd0\xcf\x11\xe0",
        "an Excel workbook of the old format; save the sheet as CSV",
    ),
    (
        b"MATLAB 5.0",
        "a MATLAB file; writetable or parquetwrite makes one that is read",
    ),
    (b"\x89HDF", "HDF5 or MATLAB 7.3; export the columns as CSV or Parquet"),
    (b"MDF     ", "an MDF file; asammdf exports Parquet or CSV"),
    (b"TDSm", "a TDMS file; npTDMS exports Parquet or CSV"),
    (b"BZh", "bzip2; unpack it first, or use gzip"),
    (b"\xfd7zXZ", "xz; unpack it first, or use gzip"),
    (b"SQLite", "an SQLite database; export the table as CSV or Parquet"),
];

/// Opens `bytes`.
///
/// # Errors
/// An empty file, a format that is not read, compressed content that is torn or too large, text that is none.
pub(crate) fn content(path: &Path, bytes: &[u8]) -> Result<Content> {
    if bytes.is_empty() {
        return Err(Error::torn(path, format!("empty file (0 bytes); allowed: {READ}")));
    }
    if bytes.starts_with(b"PAR1") {
        return Ok(Content::Parquet);
    }
    if bytes.starts_with(b"ARROW1") {
        return Ok(Content::Arrow { is_stream: false });
    }
    if bytes.starts_with(&[0xff; 4]) {
        return Ok(Content::Arrow { is_stream: true });
    }
    let opened: Cow<[u8]> = if bytes.starts_with(&[0x1f, 0x8b]) {
        unpacked(path, "gzip", flate2::read::MultiGzDecoder::new(bytes))?.into()
    } else if bytes.starts_with(&[0x28, 0xb5, 0x2f, 0xfd]) {
        let decoder = zstd::Decoder::new(bytes).map_err(|e| Error::torn(path, format!("zstd: {e}")))?;
        unpacked(path, "zstd", decoder)?.into()
    } else {
        bytes.into()
    };
    if let Some((_, what)) = OTHERS.iter().find(|(magic, _)| opened.starts_with(magic)) {
        let file = path.display().to_string();
        return Err(Error::bad(file, "file", what, READ));
    }
    text(path, &opened).map(Content::Text)
}

fn unpacked(path: &Path, how: &str, packed: impl Read) -> Result<Vec<u8>> {
    let mut bytes = Vec::new();
    let read = packed.take(LARGEST + 1).read_to_end(&mut bytes);
    read.map_err(|e| Error::torn(path, format!("not whole, or no {how}: {e}")))?;
    if bytes.len() as u64 > LARGEST {
        let allowed = format!("at most {LARGEST} bytes unpacked");
        return Err(Error::bad(path.display().to_string(), "file", "more", allowed));
    }
    Ok(bytes)
}

/// UTF-8, UTF-16 (by its mark, or by its zeros), else the bytes as Latin-1: units and names are plain in all of them.
fn text(path: &Path, bytes: &[u8]) -> Result<String> {
    let wide = |bytes: &[u8], join: fn([u8; 2]) -> u16| {
        let units = bytes.chunks_exact(2).map(|b| join([b[0], b[1]]));
        char::decode_utf16(units)
            .map(|c| c.unwrap_or(char::REPLACEMENT_CHARACTER))
            .collect::<String>()
    };
    let zeros = |odd: usize| {
        let n = bytes.len().min(256) / 2;
        n > 1 && (0..n).filter(|i| bytes[2 * i + odd] == 0).count() * 10 > 9 * n
    };
    Ok(match bytes {
        [0xef, 0xbb, 0xbf, rest @ ..] => return text(path, rest),
        [0xff, 0xfe, rest @ ..] => wide(rest, u16::from_le_bytes),
        [0xfe, 0xff, rest @ ..] => wide(rest, u16::from_be_bytes),
        _ if zeros(1) => wide(bytes, u16::from_le_bytes),
        _ if zeros(0) => wide(bytes, u16::from_be_bytes),
        _ if bytes.iter().take(4096).any(|&b| b == 0) => {
            return Err(Error::bad(
                path.display().to_string(),
                "file",
                "bytes that are no text",
                READ,
            ));
        }
        _ => match std::str::from_utf8(bytes) {
            Ok(text) => text.to_string(),
            Err(_) => bytes.iter().map(|&b| char::from(b)).collect(),
        },
    })
}
