//! Statements: which are let through, and what they answer.

use super::write;
use crate::{Question, query, to_table};
use polars::prelude::*;
use schemas::error::{EXIT_BAD_INPUT, Error};
use std::path::Path;
use tempfile::{TempDir, tempdir};

const ANSWERS: &str = include_str!("sql/answers.txt");
const FEATURES: &str = include_str!("sql/features.csv");
const ACTUATORS: &str = include_str!("sql/actuators.csv");

/// The cells of a CSV.
fn cells(text: &str) -> Vec<Vec<String>> {
    let mut reader = csv::ReaderBuilder::new()
        .has_headers(false)
        .from_reader(text.as_bytes());
    let row = |r: Result<csv::StringRecord, csv::Error>| r.unwrap().iter().map(String::from).collect();
    reader.records().map(row).collect()
}

/// A CSV as a table: columns whose cells are all numbers or empty are numbers.
fn table(text: &str) -> DataFrame {
    let rows = cells(text);
    let column = |k: usize| -> Column {
        let words: Vec<&str> = rows[1..].iter().map(|r| r[k].as_str()).collect();
        let whole: Result<Vec<i64>, _> = words.iter().map(|w| w.parse()).collect();
        let number = |w: &&str| w.is_empty() || w.parse::<f64>().is_ok();
        let name = PlSmallStr::from(rows[0][k].as_str());
        match whole {
            Ok(whole) => Column::new(name, whole),
            Err(_) if words.iter().all(number) => {
                Column::new(name, words.iter().map(|w| w.parse().ok()).collect::<Vec<Option<f64>>>())
            }
            Err(_) => Column::new(name, words),
        }
    };
    DataFrame::new_infer_height((0..rows[0].len()).map(column).collect()).unwrap()
}

fn dataset() -> TempDir {
    let dir = tempdir().unwrap();
    write(&dir.path().join("features/part-0000.parquet"), table(FEATURES));
    write(&dir.path().join("actuators/part-0000.parquet"), table(ACTUATORS));
    dir
}

/// Each statement and its answer, as DuckDB gives it (`tests/python/sql_answers.py` writes them).
fn answers() -> Vec<(&'static str, Vec<Vec<String>>)> {
    let blocks = ANSWERS.strip_prefix("> ").unwrap().split("\n> ");
    let split = |b: &'static str| b.split_once('\n').unwrap();
    blocks.map(split).map(|(sql, csv)| (sql, cells(csv))).collect()
}

fn same_cell(a: &str, b: &str) -> bool {
    match (a.parse::<f64>(), b.parse::<f64>()) {
        (Ok(a), Ok(b)) => (a - b).abs() <= 1e-9 * b.abs().max(1e-3),
        _ => a == b,
    }
}

fn same(a: &[Vec<String>], b: &[Vec<String>]) -> bool {
    let rows =
        |(a, b): (&Vec<String>, &Vec<String>)| a.len() == b.len() && a.iter().zip(b).all(|(a, b)| same_cell(a, b));
    a.len() == b.len() && a.iter().zip(b).all(rows)
}

#[test]
fn queries_are_answered_as_duckdb_answers_them() {
    let dir = dataset();
    let mut wrong = Vec::new();
    for (sql, right) in answers() {
        let found = match query(dir.path(), sql) {
            Ok(frame) => cells(&crate::output::to_csv(&frame).unwrap()),
            Err(e) => vec![vec![format!("{e:#}")]],
        };
        // CSV has no rows of one empty cell: no statement here has such an answer
        if !same(&found, &right) {
            wrong.push(format!("{sql}\n  {right:?}\n  {found:?}"));
        }
    }
    assert!(answers().len() > 150);
    assert!(wrong.is_empty(), "{}:\n{}", wrong.len(), wrong.join("\n"));
}

#[track_caller]
fn refused(dir: &Path, sql: &str, words: &[&str]) {
    let e = query(dir, sql).expect_err(sql);
    let code = e.downcast_ref::<Error>().map(Error::exit_code);
    let line = format!("{e:#}");
    assert_eq!(code, Some(EXIT_BAD_INPUT), "{sql}: {line}");
    assert!(!line.contains('\n') && line.len() < 300, "{sql}: {line}");
    for w in words {
        assert!(line.contains(w), "{sql}: no `{w}` in {line}");
    }
}

#[test]
fn what_is_no_query_is_refused() {
    let dir = dataset();
    for sql in [
        "DROP TABLE features",
        "DROP TABLE IF EXISTS nothing",
        "DELETE FROM features",
        "DELETE FROM features WHERE run = 1",
        "CREATE TABLE copy AS SELECT * FROM features",
        "CREATE VIEW v AS SELECT * FROM features",
        "TRUNCATE features",
        "TRUNCATE TABLE features",
        "INSERT INTO features VALUES (1)",
        "UPDATE features SET run = 1",
        "ALTER TABLE features ADD x INT",
        "COPY features TO 'copy.csv'",
        "SET x = 1",
        "DESCRIBE features",
        "EXPLAIN DROP TABLE features",
        "EXPLAIN ANALYZE SELECT 1",
        "SHOW TABLES LIKE 'f'",
        "SELECT * INTO copy FROM features",
        "WITH d AS (DELETE FROM features) SELECT 1",
        "WITH d AS (INSERT INTO features VALUES (1) RETURNING *) SELECT * FROM d",
        "",
        ";",
        "SELECT 1; SELECT 2",
        "SELECT 1; DROP TABLE features",
    ] {
        refused(dir.path(), sql, &["query: SQL: found ", "allowed: one query (SELECT"]);
    }
    refused(dir.path(), "SELEC 1", &["SELEC"]);
    // `;` at the end is no second statement
    assert_eq!(
        query(dir.path(), "SELECT COUNT(*) AS n FROM features;")
            .unwrap()
            .height(),
        1
    );
}

#[test]
fn readers_of_files_are_no_tables() {
    let dir = dataset();
    let file = dir.path().join("features/part-0000.parquet");
    let file = file.display();
    for reader in [
        "read_parquet",
        "read_csv",
        "read_ipc",
        "read_json",
        "Read_Parquet",
        "scan_parquet",
    ] {
        let call = format!("{reader}('{file}')");
        for sql in [
            format!("SELECT * FROM {call}"),
            format!("SELECT COUNT(*) FROM features f JOIN {call} AS r ON f.run = r.run"),
            format!("SELECT COUNT(*) FROM features, {call}"),
            format!("SELECT * FROM (SELECT run FROM {call}) AS r"),
            format!("WITH r AS (SELECT * FROM {call}) SELECT * FROM r"),
            format!("SELECT run FROM features WHERE run IN (SELECT run FROM {call})"),
            format!("SELECT run FROM features UNION ALL SELECT run FROM {call}"),
            format!("SELECT run, (SELECT MAX(run) FROM {call}) AS m FROM features"),
            format!("EXPLAIN SELECT * FROM {call}"),
            format!("SELECT * FROM TABLE({call})"),
        ] {
            refused(
                dir.path(),
                &sql,
                &["allowed: the tables runs, features, actuators, maps, diagnoses, intervals"],
            );
        }
    }
    for sql in [
        format!("SELECT * FROM '{file}'"),
        format!("SELECT * FROM \"{file}\""),
        "SELECT * FROM main.features".into(),
    ] {
        refused(dir.path(), &sql, &["allowed: the tables runs"]);
    }
}

#[test]
fn nothing_else_has_the_name_of_a_table() {
    let dir = dataset();
    for sql in [
        "WITH features AS (SELECT * FROM actuators) SELECT COUNT(*) AS n FROM features",
        "WITH Features AS (SELECT * FROM features WHERE run < 3) SELECT COUNT(*) AS n FROM Features",
        "SELECT COUNT(*) FROM features AS actuators JOIN actuators AS a ON a.actuator = actuators.actuator",
        "SELECT COUNT(*) FROM (SELECT 1 AS x) AS runs",
    ] {
        refused(dir.path(), sql, &["the alias ", "a name other than the tables"]);
    }
}

#[test]
fn tables_are_shown_whatever_the_statement_names() {
    let dir = dataset();
    let names = |sql: &str| cells(&crate::output::to_csv(&query(dir.path(), sql).unwrap()).unwrap()).concat();
    assert_eq!(names("SHOW TABLES"), ["name", "actuators", "features"]);
    assert_eq!(names("show tables;"), ["name", "actuators", "features"]);
    let plan = query(dir.path(), "EXPLAIN SELECT run FROM features").unwrap();
    assert!(to_table(&plan, 0).contains("PROJECT"), "{plan}");
    // in whatever case
    let n = query(dir.path(), "SELECT COUNT(*) AS n FROM Features").unwrap();
    assert_eq!(super::number(&n, "n", 0), 30.0);
    // a question is none of it
    assert!(Question::from_text("SHOW TABLES").unwrap().is_none());
}
