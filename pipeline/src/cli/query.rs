//! `ema query` is another program, `ema-query`: polars is much of what there is to compile.

use anyhow::Result;
use clap::Args;
use schemas::error::Error;
use std::ffi::{OsStr, OsString};
use std::path::{Path, PathBuf};
use std::process::{Command, ExitCode};

#[derive(Args)]
pub struct QueryArgs {
    /// What the program `ema-query` is started with; ema query --help says more
    #[arg(trailing_var_arg = true, allow_hyphen_values = true)]
    args: Vec<OsString>,
}

/// Hands over to `ema-query`: its streams, its exit code.
///
/// * `quiet` whether `--quiet` was said before or after `query`
pub fn query(quiet: bool) -> Result<ExitCode> {
    let here = std::env::current_exe().ok();
    let path = std::env::var_os("PATH").unwrap_or_default();
    let program = find(here.as_deref(), &path).ok_or_else(|| {
        let allowed = "it beside ema or in PATH (cargo build --release -p ema-query)";
        Error::bad("ema query", "program `ema-query`", "nothing", allowed)
    })?;
    let mut command = Command::new(&program);
    // as they are: clap has taken the first `--` for itself
    let mut all = std::env::args_os().skip(1);
    let before = all.by_ref().take_while(|a| a != "query").any(|a| a == "--quiet");
    let after: Vec<OsString> = all.collect();
    if quiet && before && !after.iter().any(|a| a == "--quiet") {
        command.arg("--quiet");
    }
    command.args(after);
    let failed = |e| Error::io(&program, "cannot be started", e).into();
    become_it(&mut command).map_err(failed)
}

/// The program beside `here`, that of the same build, or else the first in `path`.
fn find(here: Option<&Path>, path: &OsStr) -> Option<PathBuf> {
    let name = format!("ema-query{}", std::env::consts::EXE_SUFFIX);
    let beside = here.and_then(Path::parent).map(Path::to_path_buf);
    // an empty folder would be the current one
    let folders = beside.into_iter().chain(std::env::split_paths(path));
    let named = folders.filter(|f| !f.as_os_str().is_empty());
    named.map(|f| f.join(&name)).find(|p| p.is_file())
}

#[cfg(unix)]
fn become_it(command: &mut Command) -> std::io::Result<ExitCode> {
    use std::os::unix::process::CommandExt;
    Err(command.exec())
}

#[cfg(not(unix))]
fn become_it(command: &mut Command) -> std::io::Result<ExitCode> {
    let code = command.status()?.code().and_then(|c| u8::try_from(c).ok());
    Ok(ExitCode::from(code.unwrap_or(1)))
}

#[cfg(test)]
mod tests {
    use super::super::Cli;
    use super::*;
    use clap::Parser;

    #[test]
    fn the_program_beside_comes_before_those_in_path() {
        let dir = tempfile::tempdir().unwrap();
        let name = format!("ema-query{}", std::env::consts::EXE_SUFFIX);
        let [here, first, second] = ["here", "first", "second"].map(|n| dir.path().join(n));
        for folder in [&here, &first, &second] {
            std::fs::create_dir(folder).unwrap();
        }
        let ema = here.join("ema");
        let path = std::env::join_paths([Path::new(""), &first, &second]).unwrap();
        let found = || find(Some(&ema), &path);
        assert_eq!(found(), None);
        for folder in [&second, &first, &here] {
            std::fs::write(folder.join(&name), "").unwrap();
            assert_eq!(found(), Some(folder.join(&name)));
        }
        assert_eq!(find(None, OsStr::new("")), None);
    }

    #[test]
    fn whatever_is_asked_is_left_to_the_other_program() {
        for args in [
            &[][..],
            &["--help"],
            &["-h"],
            &["--list"],
            &["SELECT 1", "--data", "d"],
            &["--", "--", "-1"],
        ] {
            let all = ["ema", "query"].iter().chain(args);
            assert!(Cli::try_parse_from(all).is_ok(), "{args:?}");
        }
    }
}
