//! The tutorials of the book run, print what they show, and are the notebooks beside them.

use crate::common::process::*;
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
    let fails = "```bash\nfalse\necho FSJ\n```\n\n```text\nFSJ\n```\n";
    for (text, code) in [(fails.replace("false\n", ""), 0), (fails.into(), 1)] {
        std::fs::write(&file, &text).unwrap();
        let o = runner("").unwrap().arg(&file).output().unwrap();
        assert_eq!(
            o.status.code(),
            Some(code),
            "{text}{}",
            String::from_utf8_lossy(&o.stdout)
        );
    }
}

/// What `site_links.py` says of a site; whether all its links lead somewhere.
fn links(site: &Path) -> Option<(bool, String)> {
    let python = std::env::var("EMA_PYTHON").unwrap_or_else(|_| "python3".into());
    let program = root().join("tests/python/site_links.py");
    let Ok(o) = Command::new(&python).arg(program).arg(site).output() else {
        println!("skipped: no {python} (EMA_PYTHON names the interpreter)");
        return None;
    };
    let said = format!(
        "{}{}",
        String::from_utf8_lossy(&o.stdout),
        String::from_utf8_lossy(&o.stderr)
    );
    assert!(said.contains("lead nowhere"), "{said}");
    Some((o.status.success(), said))
}

#[test]
fn a_link_that_leads_nowhere_is_seen() {
    let dir = tempfile::tempdir().unwrap();
    let page = |name: &str, text: &str| std::fs::write(dir.path().join(name), text).unwrap();
    page(
        "a.html",
        "<h1 id=\"here\"><a href=\"#here\"></a><a href=\"b.html#there\"></a>",
    );
    for (other, leads) in [
        ("<p id=\"there\">", true),
        ("<p id=\"elsewhere\">", false),
        ("<p id=\"there\"><a href=\"c.html\"></a>", false),
        ("<p id=\"there\"><a href=\"..\"></a>", false),
    ] {
        page("b.html", other);
        let Some((found, said)) = links(dir.path()) else { return };
        assert_eq!(found, leads, "{other}: {said}");
    }
}

#[test]
fn the_site_is_built_without_a_warning_and_its_links_lead_somewhere() {
    let mdbook = std::env::var("EMA_MDBOOK").unwrap_or_else(|_| "mdbook".into());
    let site = tempfile::tempdir().unwrap();
    let mut c = Command::new(&mdbook);
    c.args(["build", "--dest-dir"])
        .arg(site.path())
        .arg(root().join("pipeline/book"));
    let Ok(o) = c.output() else {
        println!("skipped: no {mdbook} (cargo install mdbook; EMA_MDBOOK names the program)");
        return;
    };
    let said = format!(
        "{}{}",
        String::from_utf8_lossy(&o.stdout),
        String::from_utf8_lossy(&o.stderr)
    );
    assert!(o.status.success(), "{said}");
    assert!(!said.contains("WARN") && !said.contains("ERROR"), "{said}");
    let Some((leads, said)) = links(site.path()) else {
        return;
    };
    assert!(leads, "{said}");
}
