//! `ema` as a process.

use ema_tests::programs;
use serde_json::Value;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};
use std::sync::OnceLock;

pub const EMA: &str = env!("CARGO_BIN_EXE_ema-under-test");
pub const QUERY: &str = env!("CARGO_BIN_EXE_query-under-test");

/// `ema`, with `ema-query` beside it.
fn program() -> &'static Path {
    static ONCE: OnceLock<PathBuf> = OnceLock::new();
    ONCE.get_or_init(|| {
        let dir = Path::new(env!("CARGO_TARGET_TMPDIR")).join("programs");
        programs(&dir, &[("ema", EMA), ("ema-query", QUERY)]);
        dir.join("ema")
    })
}

/// One cache of maps for all tests: made once.
pub fn cache() -> PathBuf {
    Path::new(env!("CARGO_TARGET_TMPDIR")).join("ema-cache")
}

pub fn ema(args: &[&str]) -> Command {
    let mut c = Command::new(program());
    c.env("EMA_CACHE_DIR", cache()).stdin(Stdio::null()).args(args);
    c
}

/// A script for `bash` that finds `ema` in `PATH`.
pub fn shell(script: &str) -> Command {
    let mut c = Command::new("bash");
    let path = format!(
        "{}:{}",
        program().parent().unwrap().display(),
        std::env::var("PATH").unwrap()
    );
    c.env("EMA_CACHE_DIR", cache()).env("PATH", path).stdin(Stdio::null());
    c.args(["-e", "-c", script]);
    c
}

pub fn run(args: &[&str]) -> Output {
    ema(args).output().unwrap()
}

pub fn ok(args: &[&str]) -> String {
    succeeded(&mut ema(args))
}

/// Standard output of a command that must succeed.
pub fn succeeded(command: &mut Command) -> String {
    let o = command.output().unwrap();
    assert!(
        o.status.success(),
        "{command:?}: {}",
        String::from_utf8_lossy(&o.stderr)
    );
    String::from_utf8(o.stdout).unwrap()
}

pub fn json(args: &[&str]) -> Value {
    serde_json::from_str(&ok(args)).unwrap()
}

/// JSON of a diagnosis, which may be incomplete.
pub fn diagnosed(args: &[&str]) -> Value {
    let o = run(args);
    assert!(
        matches!(o.status.code(), Some(0 | 3)),
        "{args:?}: {}",
        String::from_utf8_lossy(&o.stderr)
    );
    serde_json::from_slice(&o.stdout).unwrap()
}

/// Runs, expects a refusal with exit code 4 in one line that holds all of `words`.
pub fn refused(args: &[&str], words: &[&str]) {
    let o = run(args);
    let err = String::from_utf8_lossy(&o.stderr).into_owned();
    let line = err.trim_end().lines().last().unwrap_or("").to_string();
    assert_eq!(o.status.code(), Some(4), "{args:?}: {err}");
    assert!(!err.contains("panicked"), "{err}");
    assert!(line.starts_with("ema: "), "{err}");
    for w in words {
        assert!(line.contains(w), "no `{w}` in: {line}");
    }
}

pub fn text(p: &Path) -> &str {
    p.to_str().unwrap()
}
