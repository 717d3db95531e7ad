//! `ema query` beside DuckDB.
use crate::common::process::{ema, refused, run, text};
use std::path::Path;
use std::process::Command;

const ROOT: &str = env!("CARGO_MANIFEST_DIR");

#[test]
fn e2e_queries_are_answered_as_duckdb_answers_them() {
    let python = std::env::var("EMA_PYTHON").unwrap_or_else(|_| "python3".into());
    let has_duckdb = Command::new(&python).args(["-c", "import duckdb"]).output();
    if !has_duckdb.is_ok_and(|o| o.status.success()) {
        println!("skipped: no Python with duckdb (EMA_PYTHON names the interpreter)");
        return;
    }
    // the program as the tests see it, with `ema-query` beside it
    let program = ema(&[]).get_program().to_owned();
    let done = Command::new(python)
        .env("PYTHONDONTWRITEBYTECODE", "1")
        .arg(Path::new(ROOT).join("python/sql_answers.py"))
        .arg(Path::new(ROOT).join("../pipeline/query/src/tests/sql"))
        .arg(program)
        .output()
        .unwrap();
    let said = String::from_utf8_lossy(&done.stdout);
    assert!(done.status.success(), "{said}{}", String::from_utf8_lossy(&done.stderr));
    assert!(said.contains(" 0 answered otherwise"), "{said}");
}

#[test]
fn refuse_statements_that_are_no_queries() {
    let dir = tempfile::tempdir().unwrap();
    std::fs::create_dir(dir.path().join("features")).unwrap();
    let ask = |sql: &str| {
        vec![
            "query".to_string(),
            sql.into(),
            "--data".into(),
            text(dir.path()).into(),
        ]
    };
    for sql in [
        "DROP TABLE features",
        "DELETE FROM features",
        "CREATE TABLE t AS SELECT 1",
        "TRUNCATE features",
        "SELECT 1; SELECT 2",
    ] {
        let args = ask(sql);
        let args: Vec<&str> = args.iter().map(String::as_str).collect();
        refused(&args, &["query: SQL: found ", "allowed: one query"]);
        assert!(run(&args).stdout.is_empty());
    }
    let args = ask("SELECT * FROM read_csv('/etc/hosts')");
    let args: Vec<&str> = args.iter().map(String::as_str).collect();
    refused(&args, &["read_csv('/etc/hosts')", "the tables runs, features"]);
}
