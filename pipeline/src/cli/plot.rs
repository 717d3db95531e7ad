//! `ema plot`.

use super::say;
use crate::report::{Figure, svg};
use crate::report_pages;
use anyhow::Result;
use clap::{Args, Subcommand};
use diagnoser::failure_map::FailureMapSet;
use diagnoser::map_library::file_in;
use schemas::channel::Channel;
use schemas::error::{Error, write_whole};
use std::path::PathBuf;
use std::process::ExitCode;

#[derive(Args)]
pub struct PlotArgs {
    #[command(subcommand)]
    what: What,
}

#[derive(Subcommand)]
enum What {
    /// The failure maps of a dataset or maps file
    Maps {
        /// Folder with maps.parquet, or the file
        maps: PathBuf,
        /// Folder for the SVG files
        #[arg(long, default_value = ".")]
        out: PathBuf,
    },
    /// Channels of recordings against time
    Telemetry {
        /// Recordings, drawn together
        #[arg(required = true)]
        files: Vec<PathBuf>,
        /// Channels, one figure each
        #[arg(long, value_delimiter = ',', default_value = "theta_u,omega_m,i_eq")]
        channels: Vec<String>,
        /// Folder for the SVG files
        #[arg(long, default_value = ".")]
        out: PathBuf,
    },
}

pub fn plot(a: &PlotArgs) -> Result<ExitCode> {
    let mut figures: Vec<(String, Figure)> = Vec::new();
    let dir = match &a.what {
        What::Maps { maps, out } => {
            let file = file_in(maps);
            for m in &FailureMapSet::load(&file)?.maps {
                let plot = report_pages::map_plot(m, None);
                figures.push((format!("map_{}", m.feature.name()), Figure::Map(plot)));
            }
            out
        }
        What::Telemetry { files, channels, out } => {
            let mut runs = Vec::new();
            for f in files {
                let m = crate::input::open(f, crate::input::How::default())?;
                let name = f
                    .file_stem()
                    .map(|s| s.to_string_lossy().into_owned())
                    .unwrap_or_default();
                runs.push((name, m));
            }
            for n in channels {
                let c = Channel::from_name(n).ok_or_else(|| {
                    let all: Vec<&str> = Channel::ALL.iter().map(|c| c.name()).collect();
                    Error::bad("command line", "--channels", n, all.join(", "))
                })?;
                let mut plot = report_pages::traces(c.meaning(), c.name(), &[], 1.0, c);
                for (name, m) in &runs {
                    let one = report_pages::traces("", "", &[(name.as_str(), &m.telemetry)], m.rate_hz, c);
                    plot.series.extend(one.series);
                }
                figures.push((format!("telemetry_{}", c.name()), Figure::Trace(plot)));
            }
            out
        }
    };
    std::fs::create_dir_all(dir).map_err(|e| Error::io(dir, "cannot be made", e))?;
    for (stem, figure) in &figures {
        let path = dir.join(format!("{stem}.svg"));
        write_whole(&path, svg(figure)?.as_bytes())?;
        say(&format!("{}", path.display()));
    }
    Ok(ExitCode::SUCCESS)
}
