//! Where things are kept that can be made or fetched again.

use std::path::PathBuf;

/// Folder of maps made on first use and of tables fetched for queries: `EMA_CACHE_DIR`, else
/// `XDG_CACHE_HOME/ema`, else `~/.cache/ema`.
pub fn cache_dir() -> PathBuf {
    let var = |k: &str| std::env::var_os(k).filter(|v| !v.is_empty()).map(PathBuf::from);
    var("EMA_CACHE_DIR")
        .or_else(|| var("XDG_CACHE_HOME").map(|p| p.join("ema")))
        .or_else(|| var("HOME").map(|p| p.join(".cache/ema")))
        .unwrap_or_else(|| std::env::temp_dir().join("ema-cache"))
}
