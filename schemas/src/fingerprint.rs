//! Fingerprints: who made this, and with what.

/// 16 hexadecimal digits of the BLAKE3 hash of `text`.
pub fn fingerprint(text: &str) -> String {
    blake3::hash(text.as_bytes()).to_hex()[..16].to_string()
}

/// A value in a text to be fingerprinted: every bit of it.
pub fn exact(x: f64) -> String {
    format!("{:016x}", x.to_bits())
}

/// As [`fingerprint`], of a file's bytes.
pub fn fingerprint_bytes(bytes: &[u8]) -> String {
    blake3::hash(bytes).to_hex()[..16].to_string()
}

/// BLAKE3 of a file's bytes, 64 hexadecimal digits.
pub fn checksum(bytes: &[u8]) -> String {
    blake3::hash(bytes).to_hex().to_string()
}
