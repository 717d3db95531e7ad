//! The command line of `ema query`.

use crate::tables::refuse_old;
use crate::{Answer, Question, Table, explain, output, query as sql};
use anyhow::Result;
use clap::{Parser, ValueEnum};
use schemas::error::Error;
use sim_worker::cache::cache_dir;
use sim_worker::dataset::copy::mirror;
use sim_worker::dataset::storage::Storage;
use sim_worker::progress::{catch_interrupts, note};
use std::path::{Path, PathBuf};
use std::process::ExitCode;

#[derive(Clone, Copy, ValueEnum)]
enum Format {
    Table,
    Csv,
    Json,
    Parquet,
}

// a part of `ema` to its users: usage and refusals say so
#[derive(Parser)]
#[command(
    name = "ema-query",
    bin_name = "ema query",
    version,
    about = "SQL and ready questions over a dataset",
    after_help = "Tables: runs (telemetry), features (one row a run), maps (one row a grid point and feature), actuators,\n\
    diagnoses, intervals; of ema prognosis --out: trends, prognoses, alarms. Ready questions: ema query --list\n\
    Example: ema query \"SELECT zeta, AVG(p2_a) AS p2 FROM features GROUP BY zeta ORDER BY zeta\" --data dataset\n\
    Example: ema query out-of-family --data fleet\n\
    Example: ema query at-risk --data outlook"
)]
struct QueryArgs {
    /// One SQL query (SELECT, WITH, UNION ..., EXPLAIN of one, SHOW TABLES), or the name of a ready question
    #[arg(required_unless_present = "list")]
    ask: Option<String>,
    /// The ready questions and the tables
    #[arg(long)]
    list: bool,
    /// Dataset: a folder, or s3://BUCKET/PREFIX (its tables are fetched into the cache; telemetry is not)
    #[arg(long, default_value = ".")]
    data: PathBuf,
    /// Second dataset, for questions that compare
    #[arg(long)]
    with: Option<PathBuf>,
    #[arg(long, value_enum, default_value_t = Format::Table)]
    format: Format,
    /// Rows that a table shows, 0 for all
    #[arg(long, default_value_t = 200)]
    rows: usize,
    /// File instead of standard output; needed for Parquet
    #[arg(long)]
    out: Option<PathBuf>,
    /// Print the optimised plan, what is read from which files, instead of an answer
    #[arg(long)]
    explain: bool,
    /// No notes beside the answer
    #[arg(long)]
    quiet: bool,
}

/// The folder that a query reads: a dataset in a bucket is mirrored first.
fn folder(place: &Path) -> Result<PathBuf> {
    match place.to_str().filter(|t| t.contains("://")) {
        Some(url) => Ok(mirror(&Storage::open(url)?, &cache_dir())?),
        None => {
            refuse_old(place)?;
            Ok(place.to_path_buf())
        }
    }
}

/// Parses the command line, answers, and says how it ended.
pub fn main() -> ExitCode {
    let a = QueryArgs::parse();
    if a.quiet {
        sim_worker::quiet::be_quiet();
    }
    catch_interrupts();
    query(&a).unwrap_or_else(|e| {
        eprintln!("ema: {}", format!("{e:#}").replace('\n', " "));
        ExitCode::from(e.downcast_ref::<Error>().map_or(1, Error::exit_code))
    })
}

/// Prints, and does not mind when nobody reads on.
fn say(text: &str) {
    use std::io::Write;
    let _ = writeln!(std::io::stdout(), "{}", text.trim_end());
}

fn query(a: &QueryArgs) -> Result<ExitCode> {
    if a.list {
        say(&list());
        return Ok(ExitCode::SUCCESS);
    }
    let data = folder(&a.data)?;
    let with = a.with.as_deref().map(folder).transpose()?;
    let ask = a.ask.as_deref().unwrap_or_default();
    let question = Question::from_text(ask)?;
    if let (None, Some(with)) = (question, &with) {
        let allowed = "only with a ready question that compares";
        return Err(Error::bad("command line", "--with", with.display(), allowed).into());
    }
    if a.explain {
        say(&match question {
            Some(q) => q.explain(&data, with.as_deref())?,
            None => explain(&data, ask)?,
        });
        return Ok(ExitCode::SUCCESS);
    }
    let mut answer = match question {
        Some(q) => q.ask(&data, with.as_deref())?,
        None => Answer {
            frame: sql(&data, ask)?,
            notes: Vec::new(),
        },
    };
    let text = match a.format {
        Format::Table => output::to_table(&answer.frame, a.rows),
        Format::Csv => output::to_csv(&answer.frame)?,
        Format::Json => output::to_json(&answer.frame)?,
        Format::Parquet => {
            let allowed = "--out FILE.parquet";
            let out = a
                .out
                .as_ref()
                .ok_or_else(|| Error::bad("command line", "--out", "nothing", allowed))?;
            output::write_parquet(&mut answer.frame, out)?;
            String::new()
        }
    };
    match &a.out {
        _ if matches!(a.format, Format::Parquet) => {}
        Some(path) => schemas::error::write_whole(path, format!("{}\n", text.trim_end()).as_bytes())?,
        None => say(&text),
    }
    // beside the answer, so that a file or pipe holds the table only
    for n in &answer.notes {
        note(&format!("note: {n}"));
    }
    Ok(ExitCode::SUCCESS)
}

/// Name, meaning and tables of every question, and what the tables are.
fn list() -> String {
    let mut out = String::new();
    for q in Question::ALL {
        let tables: Vec<&str> = q.needs().iter().map(|t| t.name()).collect();
        out += &format!("{:22} {} [{}]\n", q.name(), q.meaning(), tables.join(", "));
    }
    out += "\ntables for SQL:\n";
    for t in Table::ALL {
        out += &format!("{:22} {}\n", t.name(), t.meaning());
    }
    out
}
