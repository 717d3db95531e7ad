//! `ema completions` and `ema man`.

use super::{command, say};
use anyhow::Result;
use clap::Args;
use clap_complete::Shell;
use schemas::error::Error;
use std::io::Write;
use std::path::PathBuf;
use std::process::ExitCode;

#[derive(Args)]
pub struct CompletionsArgs {
    /// Which shell
    shell: Shell,
}

#[derive(Args)]
pub struct ManArgs {
    /// Folder for the pages, made if it is not there
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
}

pub fn completions(a: &CompletionsArgs) -> Result<ExitCode> {
    let mut script = Vec::new();
    clap_complete::generate(a.shell, &mut command(), "ema", &mut script);
    // a closed pipe is no failure; and a script is not cleaned of control characters, all of it is ours
    let _ = std::io::stdout().write_all(&script);
    Ok(ExitCode::SUCCESS)
}

pub fn man(a: &ManArgs) -> Result<ExitCode> {
    let failed = |what: &'static str, e| Error::io(&a.out, what, e);
    std::fs::create_dir_all(&a.out).map_err(|e| failed("cannot be made", e))?;
    clap_mangen::generate_to(command(), &a.out).map_err(|e| failed("cannot be written", e))?;
    say(&format!(
        "wrote     {}, and a page for every command beside it",
        a.out.join("ema.1").display()
    ));
    Ok(ExitCode::SUCCESS)
}
