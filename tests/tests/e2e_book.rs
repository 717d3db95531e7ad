//! The tutorials of the book run, print what they show, and are the notebooks beside them.

mod common;

use common::process::*;
use std::path::{Path, PathBuf};
use std::process::Command;

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).parent().unwrap().to_path_buf()
}

/// The runner of chapters, where Python has what it and `chapters` need.
fn runner(needs: &str) -> Option<Command> {
    let python = std::env::var("EMA_PYTHON").unwrap_or_else(|_| "python3".into());
    let needs = format!("import nbclient, nbformat, ipykernel{needs}");
    let has = Command::new(&python).args(["-c", &needs]).output();
    if !has.is_ok_and(|o| o.status.success()) {
        println!("skipped: {needs}: not in {python} (EMA_PYTHON names the interpreter)");
        return None;
    }
    // programs that chapters start are found as users find them
    let mut c = shell(&format!(
        "exec \"$PYTHON\" '{}' \"$@\"",
        root().join("tests/python/book.py").display()
    ));
    c.arg("book").env("PYTHON", python);
    Some(c)
}

fn chapter(name: &str, needs: &str) {
    let Some(mut c) = runner(needs) else { return };
    let book = root().join("pipeline/book");
    c.arg(book.join(format!("src/tutorials/{name}.md")));
    c.arg("--examples").arg(root().join("schemas/examples/python"));
    c.arg("--notebooks").arg(book.join("notebooks"));
    let o = c.output().unwrap();
    assert!(
        o.status.success(),
        "{}{}",
        String::from_utf8_lossy(&o.stdout),
        String::from_utf8_lossy(&o.stderr)
    );
}

#[test]
fn a_recording_of_your_own() {
    chapter("own-recording", ", polars, matplotlib");
}

#[test]
fn a_rig_of_your_own() {
    chapter("own-rig", ", numpy");
}

#[test]
fn a_fleet() {
    chapter("fleet", ", polars, duckdb, matplotlib");
}

#[test]
fn live_from_python() {
    chapter("live", ", iceoryx2");
}

#[test]
fn prognosis() {
    chapter("prognosis", ", polars, matplotlib");
}

#[test]
fn a_changed_number_is_seen() {
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("chapter.md");
    let passes = |expected: &str| {
        let text = format!(
            "# A chapter\n\n```python\nprint(\"FSJ\", 2.9981)\nprint(\"zeta\", 0.3)\n```\n\n```text\n{expected}```\n"
        );
        std::fs::write(&file, text).unwrap();
        let mut c = runner("")?;
        Some(c.arg(&file).output().unwrap().status.code().unwrap())
    };
    let Some(as_printed) = passes("FSJ 2.9981\nzeta 0.3\n") else {
        return;
    };
    assert_eq!(as_printed, 0);
    for holds in ["FSJ 2.99...\nzeta 0.3\n", "...\nzeta 0.3\n", "...\n"] {
        assert_eq!(passes(holds), Some(0), "{holds}");
    }
    for fails in [
        "FSJ 2.9982\nzeta 0.3\n",
        "FSJ 2.98...\nzeta 0.3\n",
        "FSJ 2.9981\n",
        "...\nzeta 0.4\n",
        "",
    ] {
        assert_eq!(passes(fails), Some(1), "{fails}");
    }
}
