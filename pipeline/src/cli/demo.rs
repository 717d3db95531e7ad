//! `ema demo`.

use super::say;
use crate::case;
use crate::demo::{DemoResult, TableCase, run};
use crate::{report, report_pages};
use anyhow::Result;
use clap::Args;
use std::path::PathBuf;
use std::process::ExitCode;
use std::time::Instant;

#[derive(Args)]
pub struct DemoArgs {
    /// Folder of the report and its data
    #[arg(long, default_value = "ema-demo")]
    out: PathBuf,
    /// Grid by name or TOML file
    #[arg(long, default_value = "fine")]
    grid: String,
    /// Noise seeds of each case
    #[arg(long, default_value_t = 100, value_parser = clap::value_parser!(u64).range(1..=100_000))]
    seeds: u64,
    /// A recording to diagnose along with the paper's cases
    file: Option<PathBuf>,
}

pub fn demo(a: &DemoArgs) -> Result<ExitCode> {
    let begin = Instant::now();
    let r = run(&a.out, &a.grid, a.seeds, a.file.as_deref())?;
    if let Some((_, c)) = &r.own {
        say(&case::to_text(c, None));
    }
    report::write(&report_pages::demo::report(&r), &a.out, "report.html")?;
    say(&table_i(&r));
    say(&format!(
        "\n{} runs, maps, diagnoses and report in {:.1} s: {}",
        r.grid.runs,
        begin.elapsed().as_secs_f64(),
        a.out.join("report.html").display()
    ));
    Ok(ExitCode::SUCCESS)
}

fn table_i(r: &DemoResult) -> String {
    let line = |c: [&str; 6]| {
        let [exact, detected, error, median, high, inside] = c;
        format!("{exact:>14}  {detected:>16}  {error:>17}  {median:>17}  {high:>17}  {inside:>6}")
    };
    let row = |c: &TableCase| {
        let [exact, detected, error, median, high, inside] = c.words(" ");
        let error = format!("{error} ({:.1} {:.1})", c.paper.0, c.paper.1);
        line([&exact, &detected, &error, &median, &high, &inside])
    };
    let head = line([
        "exact",
        "detected",
        "error % (paper)",
        "median % of seeds",
        "95th % of seeds",
        "inside",
    ]);
    let rows: Vec<String> = [head].into_iter().chain(r.table.iter().map(row)).collect();
    let seeds = r.seeds;
    format!(
        "zeta FSJ of the paper's Table I, {seeds} noise seeds each\n{}",
        rows.join("\n")
    )
}
