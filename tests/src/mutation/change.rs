//! Changes of bytes and of texts.

use rand::RngExt;
use rand_chacha::ChaCha8Rng;

/// What stands for a number in a changed text.
const NUMBERS: [&str; 24] = [
    "nan",
    "inf",
    "-inf",
    "0",
    "-0.0",
    "-1",
    "1",
    "1e308",
    "-1e308",
    "1e-308",
    "5e-324",
    "1e999",
    "9223372036854775807",
    "18446744073709551616",
    "-9223372036854775809",
    "0.5",
    "1e12",
    "1e-12",
    "",
    "true",
    "\"1\"",
    "1e6",
    "2",
    "[1]",
];

fn place(rng: &mut ChaCha8Rng, len: usize) -> usize {
    if len == 0 { 0 } else { rng.random_range(0..len) }
}

fn span(rng: &mut ChaCha8Rng, len: usize) -> std::ops::Range<usize> {
    let from = place(rng, len);
    let most = (len - from).min(1 << rng.random_range(0..12u32));
    from..from + if most == 0 { 0 } else { rng.random_range(0..=most) }
}

fn change_bytes(rng: &mut ChaCha8Rng, b: &mut Vec<u8>) {
    let at = place(rng, b.len());
    match rng.random_range(0..9) {
        0 | 1 if !b.is_empty() => b[at] ^= 1 << rng.random_range(0..8),
        2 if !b.is_empty() => b[at] = [0, 0xff, 0x7f, 0x80, b',', b'\n', b'"'][rng.random_range(0..7)],
        3 => b.truncate(at),
        4 => {
            let r = span(rng, b.len());
            b.drain(r);
        }
        5 => {
            let copy = b[span(rng, b.len())].to_vec();
            b.splice(at..at, copy);
        }
        6 => {
            let n = rng.random_range(0..40);
            let noise: Vec<u8> = (0..n).map(|_| rng.random()).collect();
            b.splice(at..at, noise);
        }
        7 => {
            // lengths and offsets of binary formats
            let big: u64 = [u64::MAX, u64::from(u32::MAX), 1 << 31, 1 << 40, 0][rng.random_range(0..5)];
            for (to, from) in b[at..].iter_mut().zip(big.to_le_bytes()) {
                *to = from;
            }
        }
        _ => {
            for i in span(rng, b.len()) {
                b[i] = rng.random();
            }
        }
    }
}

/// Places of numbers in a text.
fn numbers(text: &str) -> Vec<std::ops::Range<usize>> {
    let mut found = Vec::new();
    let mut from = None;
    for (i, c) in text.char_indices().chain([(text.len(), ' ')]) {
        let part = c.is_ascii_digit() || (from.is_some() && matches!(c, '.' | 'e' | '-' | '+'));
        match (part, from) {
            (true, None) => from = Some(i),
            (false, Some(f)) => {
                found.push(f..i);
                from = None;
            }
            _ => {}
        }
    }
    found
}

fn change_text(rng: &mut ChaCha8Rng, text: &mut String) {
    let kind = rng.random_range(0..6);
    if kind < 3 {
        let all = numbers(text);
        if let Some(range) = all.get(place(rng, all.len())) {
            text.replace_range(range.clone(), NUMBERS[place(rng, NUMBERS.len())]);
        }
        return;
    }
    let mut lines: Vec<&str> = text.lines().collect();
    let (a, b) = (place(rng, lines.len()), place(rng, lines.len()));
    match kind {
        3 if !lines.is_empty() => {
            lines.remove(a);
        }
        4 if !lines.is_empty() => lines.insert(a, lines[b]),
        5 if !lines.is_empty() => lines.swap(a, b),
        _ => {}
    }
    *text = lines.join("\n");
}

/// An input with one to four changes; a text is mostly changed as a text.
pub fn changed(rng: &mut ChaCha8Rng, seed: &[u8]) -> Vec<u8> {
    let mut bytes = seed.to_vec();
    for _ in 0..rng.random_range(1..=4) {
        match String::from_utf8(bytes.clone()) {
            Ok(mut text) if rng.random_bool(0.7) => {
                change_text(rng, &mut text);
                bytes = text.into_bytes();
            }
            _ => change_bytes(rng, &mut bytes),
        }
    }
    bytes
}
