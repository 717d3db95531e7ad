//! Text from outside (names in frames, values in files, words of libraries about them), made fit to be printed:
//! control and format characters would move the cursor, clear the screen or turn the line round.

use std::fmt::{Display, Formatter, Write};

/// Longest value from outside that an error shows whole [characters].
pub const LONGEST: usize = 300;

/// Whether a character stands on a terminal as itself: neither control (ESC, line ends, C1) nor format character
/// (zero width, direction of writing, line and paragraph separators, tags).
pub fn is_plain(c: char) -> bool {
    let is_format = matches!(c, '\u{ad}' | '\u{61c}' | '\u{180e}' | '\u{200b}'..='\u{200f}' | '\u{2028}'..='\u{202e}'
        | '\u{2060}'..='\u{206f}' | '\u{feff}' | '\u{fff9}'..='\u{fffb}' | '\u{e0000}'..='\u{e007f}');
    !c.is_control() && !is_format
}

/// What becomes of line ends and tabulators.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum White {
    /// written as escapes, as every control character
    Escaped,
    /// a space each: the text becomes one line
    Spaced,
    /// kept
    Kept,
}

/// A text that shows itself without control and format characters, see [`value`], [`line`] and [`lines`].
#[derive(Clone, Copy, Debug)]
pub struct Foreign<'a> {
    text: &'a str,
    most: usize,
    white: White,
}

/// A value that is quoted: everything not plain as an escape (`\n`, `\u{1b}`), cut at [`LONGEST`] characters.
pub fn value(text: &str) -> Foreign<'_> {
    let (most, white) = (LONGEST, White::Escaped);
    Foreign { text, most, white }
}

/// Words that may quote something: as [`value`], but whole, and line ends are spaces.
pub fn line(text: &str) -> Foreign<'_> {
    let (most, white) = (usize::MAX, White::Spaced);
    Foreign { text, most, white }
}

/// Output of several lines: as [`line`], but line ends and tabulators stay.
pub fn lines(text: &str) -> Foreign<'_> {
    let (most, white) = (usize::MAX, White::Kept);
    Foreign { text, most, white }
}

impl Display for Foreign<'_> {
    fn fmt(&self, f: &mut Formatter<'_>) -> std::fmt::Result {
        for (n, c) in self.text.chars().enumerate() {
            if n == self.most {
                return write!(f, "... ({} bytes)", self.text.len());
            }
            match (c, self.white) {
                ('\n' | '\t', White::Kept) => f.write_char(c)?,
                ('\n' | '\t' | '\r', White::Spaced) => f.write_char(' ')?,
                ('\n' | '\t' | '\r', White::Escaped) => write!(f, "{}", c.escape_default())?,
                _ if is_plain(c) => f.write_char(c)?,
                _ => write!(f, "{}", c.escape_unicode())?,
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn prop_nothing_that_a_terminal_obeys_passes() {
        let hostile = "a\x1b[2J\u{9b}1m\u{202e}b\r\n\tc\u{7}";
        assert_eq!(value(hostile).to_string(), r"a\u{1b}[2J\u{9b}1m\u{202e}b\r\n\tc\u{7}");
        assert_eq!(line(hostile).to_string(), r"a\u{1b}[2J\u{9b}1m\u{202e}b   c\u{7}");
        assert_eq!(lines("a\n\tb\x1b").to_string(), "a\n\tb\\u{1b}");
        for c in (0..=0x10_ffff).filter_map(char::from_u32) {
            let shown = value(&c.to_string()).to_string();
            assert!(shown.chars().all(is_plain), "{shown}");
            assert_eq!(shown == c.to_string(), is_plain(c));
        }
    }

    #[test]
    fn prop_ordinary_names_stay_and_long_values_are_cut() {
        for name in ["Querruder links", "e\u{301}levon", "左副翼", "EMA-1.left"] {
            assert_eq!(value(name).to_string(), name);
        }
        let long = value(&"x".repeat(100_000)).to_string();
        assert_eq!(long, "x".repeat(LONGEST) + "... (100000 bytes)");
    }
}
