//! Arguments of the benchmarks: `--name VALUE`.

use anyhow::{Context, Result};

/// The value after `name`, where it is given.
///
/// # Errors
/// No value after it.
pub fn text(name: &str) -> Result<Option<String>> {
    let arguments: Vec<String> = std::env::args().collect();
    let Some(i) = arguments.iter().position(|a| a == name) else {
        return Ok(None);
    };
    let value = arguments.get(i + 1).with_context(|| format!("{name} needs a value"))?;
    Ok(Some(value.clone()))
}

/// The whole number after `name`, or `default`.
///
/// # Errors
/// Not a whole number.
pub fn number(name: &str, default: u64) -> Result<u64> {
    let Some(text) = text(name)? else { return Ok(default) };
    text.parse()
        .with_context(|| format!("{name} {text}: allowed: a whole number"))
}
