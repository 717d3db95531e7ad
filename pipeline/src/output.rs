//! Telemetry as CSV or Parquet.

use schemas::channel::{Channel, ChannelSet};
use schemas::error::{Error, Result, temporary};
use schemas::recording::{Provenance, Recorder};
use schemas::telemetry::{TelemetryHeader, TelemetrySink, TelemetryView};
use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};

/// Writes `t` and the header's channels, 12 digits; the file gets its name at the end.
pub struct CsvWriter {
    path: PathBuf,
    tmp: PathBuf,
    out: Option<BufWriter<File>>,
    begun: bool,
}

impl CsvWriter {
    pub fn create(path: &Path) -> Result<Self> {
        let tmp = temporary(path);
        let file = File::create(&tmp).map_err(|e| Error::io(&tmp, "cannot be created", e))?;
        Ok(Self {
            path: path.into(),
            tmp,
            out: Some(BufWriter::new(file)),
            begun: false,
        })
    }

    pub fn finish(mut self) -> Result<()> {
        let out = self.out.take().expect("finish is called once");
        let io = |e| Error::io(&self.path, "cannot be written", e);
        let file = out.into_inner().map_err(|e| io(e.into_error()))?;
        file.sync_all().map_err(io)?;
        std::fs::rename(&self.tmp, &self.path).map_err(io)
    }
}

impl Drop for CsvWriter {
    fn drop(&mut self) {
        if self.out.take().is_some() {
            let _ = std::fs::remove_file(&self.tmp);
        }
    }
}

impl TelemetrySink for CsvWriter {
    fn accept(&mut self, header: &TelemetryHeader, view: &TelemetryView<'_>) -> Result<()> {
        let path = self.path.clone();
        let out = self.out.as_mut().expect("not finished");
        let channels: Vec<Channel> = header.channels.iter().collect();
        let mut write = || -> std::io::Result<()> {
            if !self.begun {
                self.begun = true;
                let names: Vec<&str> = channels.iter().map(|c| c.name()).collect();
                writeln!(out, "t,{}", names.join(","))?;
            }
            for i in 0..view.rows {
                let t = (view.first + i as u64) as f64 / header.rate_hz;
                write!(out, "{}", digits(t))?;
                for &c in &channels {
                    write!(out, ",{}", digits(view.column(c).map_or(f64::NAN, |v| v[i])))?;
                }
                writeln!(out)?;
            }
            Ok(())
        };
        write().map_err(|e| Error::io(&path, "cannot be written", e))
    }
}

/// A recording in the format that its file's name asks for.
pub enum Writer {
    Csv(CsvWriter),
    Parquet(Box<Recorder>),
}

impl Writer {
    /// * `single` samples as f32 (Parquet): where they come out of a sensor model
    ///
    /// # Errors
    /// A name that ends in neither .csv nor .parquet.
    pub fn create(path: &Path, provenance: &Provenance, channels: ChannelSet, single: bool) -> Result<Self> {
        match path.extension().and_then(|x| x.to_str()) {
            Some("csv") => Ok(Self::Csv(CsvWriter::create(path)?)),
            Some("parquet") => {
                let recorder = Recorder::create(path, provenance, channels, single)?;
                Ok(Self::Parquet(Box::new(recorder)))
            }
            _ => {
                let allowed = "a file name ending in .csv or .parquet";
                Err(Error::bad("command line", "--out", path.display(), allowed))
            }
        }
    }

    /// Ends the file and gives it its name.
    pub fn finish(self) -> Result<()> {
        match self {
            Self::Csv(w) => w.finish(),
            Self::Parquet(w) => w.finish(),
        }
    }
}

impl TelemetrySink for Writer {
    fn accept(&mut self, header: &TelemetryHeader, view: &TelemetryView<'_>) -> Result<()> {
        match self {
            Self::Csv(w) => w.accept(header, view),
            Self::Parquet(w) => w.accept(header, view),
        }
    }
}

/// 12 significant digits, as short as they allow; whole numbers with a point, or readers that guess types from the first
/// rows take a column for one of integers.
pub fn digits(x: f64) -> String {
    let rounded: f64 = format!("{x:.11e}").parse().unwrap_or(x);
    if rounded != 0.0 && (rounded.abs() < 1e-4 || rounded.abs() >= 1e12) {
        format!("{rounded:e}")
    } else {
        let text = format!("{rounded}");
        if text.contains('.') { text } else { text + ".0" }
    }
}
