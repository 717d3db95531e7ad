//! `cargo run --release -p ema-tests --bin discrepancy-bench`: the blind test bed of the discrepancy study.
//! Stopped and started again it goes on where it was; the report comes at the end.

use anyhow::{Context, Result};
use ema_tests::campaign::options::{HELP, Options};
use ema_tests::campaign::{hands, plan, report, run};
use std::io::Write;
use std::process::ExitCode;

fn campaign(options: &Options) -> Result<()> {
    if options.bed.is_some() {
        let text = hands::bench(options)?;
        return told(options, &text);
    }
    let plans = plan::chosen(&options.only).map_err(anyhow::Error::msg)?;
    if !options.report_only {
        run::run(options, &plans)?;
    }
    told(options, &report::report(&report::judged(&options.out, &plans)?))
}

/// To the record, where one is asked for, and to standard output.
fn told(options: &Options, text: &str) -> Result<()> {
    if let Some(path) = &options.record {
        std::fs::write(path, text).with_context(|| path.display().to_string())?;
    }
    // a reader that has seen enough is no error
    let _ = std::io::stdout().write_all(text.as_bytes());
    Ok(())
}

fn main() -> ExitCode {
    let end = match Options::parse(std::env::args().skip(1)) {
        Ok(Some(options)) => campaign(&options),
        Ok(None) => {
            let classes: String = plan::ALL.iter().map(|p| format!("  {}\n", p.label())).collect();
            print!("{HELP}\n{classes}");
            return ExitCode::SUCCESS;
        }
        Err(e) => Err(anyhow::Error::msg(e)),
    };
    match end {
        Ok(()) => ExitCode::SUCCESS,
        Err(e) => {
            eprintln!("discrepancy-bench: {e:#}");
            ExitCode::FAILURE
        }
    }
}
