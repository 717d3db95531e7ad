//! JSON files that carry a checksum of themselves: a changed digit must not become another diagnosis without a word.

use schemas::error::{Error, Result};
use schemas::fingerprint::checksum;
use serde_json::Value;
use std::path::Path;

/// Key of the checksum.
const KEY: &str = "checksum";
/// Key that says that there is one, so that a file that lost it is not taken for one of an earlier version.
const MARK: &str = "sealed";

/// Of keys and values, however they are laid out.
fn sum(value: &Value) -> String {
    checksum(value.to_string().as_bytes())
}

/// A JSON object with its checksum as last key.
pub(crate) fn sealed(object: &str) -> String {
    let value: Value = serde_json::from_str(object).expect("just written");
    let body = object.trim_end().strip_suffix('}').expect("an object").trim_end();
    format!("{body},\n\"{MARK}\": true,\n\"{KEY}\": \"{}\"}}\n", sum(&value))
}

/// Checks the checksum of a JSON object.
///
/// * `maker` the command that writes such a file
///
/// # Errors
/// Refuses what is no JSON, and another checksum than that of the rest, or none.
pub(crate) fn check(path: &Path, object: &str, maker: &str) -> Result<()> {
    let mut value: Value = serde_json::from_str(object).map_err(|e| Error::torn(path, e))?;
    let mut take = |key: &str| value.as_object_mut().and_then(|o| o.remove(key)).unwrap_or_default();
    let (_, found) = (take(MARK), take(KEY));
    let allowed = sum(&value);
    if found.as_str() == Some(&allowed) {
        return Ok(());
    }
    let found = found.as_str().unwrap_or("none").to_string();
    let file = path.display().to_string();
    Err(Error::bad(
        file,
        KEY,
        found,
        format!("that of a file as {maker} wrote it"),
    ))
}

/// As [`check`], but a file of an earlier version, which had no checksum, passes.
///
/// # Errors
/// As [`check`].
pub(crate) fn check_if_sealed(path: &Path, object: &str, maker: &str) -> Result<()> {
    let value: Value = serde_json::from_str(object).map_err(|e| Error::torn(path, e))?;
    match value.get(MARK).is_none() && value.get(KEY).is_none() {
        true => Ok(()),
        false => check(path, object, maker),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn prop_a_changed_value_is_refused_and_a_changed_layout_is_not() {
        let text = sealed("{\"b\": [1.5, 0.1], \"a\": {\"x\": 1e-9}}");
        let path = Path::new("some.json");
        check(path, &text, "ema some").unwrap();
        check(
            path,
            &text.replace(", ", ",\n\t").replace("1e-9", "0.000000001"),
            "ema some",
        )
        .unwrap();
        for (from, to) in [
            ("1.5", "1.4"),
            ("0.1", "0.2"),
            ("\"x\"", "\"y\""),
            ("checksum", "check_sum"),
        ] {
            let e = check(path, &text.replace(from, to), "ema some")
                .unwrap_err()
                .to_string();
            assert!(
                e.contains("some.json: checksum: found") && e.contains("ema some"),
                "{e}"
            );
        }
        // only what has neither key is of an earlier version
        check_if_sealed(path, "{\"a\": 1}", "ema some").unwrap();
        check_if_sealed(path, &text, "ema some").unwrap();
        for from in ["checksum", "sealed", "0.1"] {
            assert!(
                check_if_sealed(path, &text.replace(from, "1.1"), "ema some").is_err(),
                "{from}"
            );
        }
        assert!(check(path, "[]", "ema some").is_err() && check(path, "{", "ema some").is_err());
    }
}
