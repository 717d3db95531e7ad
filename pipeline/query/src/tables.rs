//! The tables of a dataset folder, and of a prognosis' folder.

use anyhow::Result;
use polars::prelude::*;
use schemas::error::Error;
use schemas::table::check_footer;
use std::path::Path;
use std::sync::Arc;

/// A table that SQL and questions can name.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Table {
    /// Telemetry, one row a sample.
    Runs,
    /// One row a run.
    Features,
    /// Drawn parameters, one row an actuator.
    Actuators,
    /// One row a grid point and feature.
    Maps,
    /// One row a diagnosed test.
    Diagnoses,
    /// A view of `diagnoses`: one row a diagnosis and fault.
    Intervals,
    /// Of a prognosis: one row a test and fault.
    Trends,
    /// One row an actuator and fault.
    Prognoses,
    /// One row an alarm.
    Alarms,
}

impl Table {
    /// All, in the order of the help.
    pub const ALL: [Self; 9] = [
        Self::Runs,
        Self::Features,
        Self::Actuators,
        Self::Maps,
        Self::Diagnoses,
        Self::Intervals,
        Self::Trends,
        Self::Prognoses,
        Self::Alarms,
    ];

    /// Name in SQL.
    pub fn name(self) -> &'static str {
        match self {
            Self::Runs => "runs",
            Self::Features => "features",
            Self::Actuators => "actuators",
            Self::Maps => "maps",
            Self::Diagnoses => "diagnoses",
            Self::Intervals => "intervals",
            Self::Trends => "trends",
            Self::Prognoses => "prognoses",
            Self::Alarms => "alarms",
        }
    }

    /// What a row is.
    pub fn meaning(self) -> &'static str {
        match self {
            Self::Runs => "telemetry, one row a sample",
            Self::Features => "one row a run: what was measured, and what is formed of it over the healthy run",
            Self::Actuators => "drawn parameters, one row an actuator",
            Self::Maps => "failure maps, one row a grid point and feature",
            Self::Diagnoses => "one row a diagnosed test",
            Self::Intervals => "one row a diagnosis and fault",
            Self::Trends => "of a prognosis: level and rate, one row a test and fault",
            Self::Prognoses => "of a prognosis: remaining life, one row an actuator and fault",
            Self::Alarms => "of a prognosis: one row an alarm",
        }
    }

    /// The command that makes it.
    fn maker(self) -> &'static str {
        match self {
            Self::Runs => "made by ema simulate or ema dataset make, with telemetry kept",
            Self::Features | Self::Actuators => "made by ema simulate or ema dataset make",
            Self::Maps => "made by ema maps",
            Self::Diagnoses | Self::Intervals => "made by ema dataset diagnose",
            Self::Trends | Self::Prognoses | Self::Alarms => "made by ema prognosis HISTORY --out FOLDER",
        }
    }

    /// Where its files lie in a dataset folder.
    fn files(self) -> &'static str {
        match self {
            Self::Runs => "telemetry/**/*.parquet",
            Self::Features => "features/*.parquet",
            Self::Actuators => "actuators/*.parquet",
            Self::Maps => "maps/*.parquet",
            Self::Diagnoses | Self::Intervals => "diagnoses/*.parquet",
            Self::Trends => "trends.parquet",
            Self::Prognoses => "prognoses.parquet",
            Self::Alarms => "alarms.parquet",
        }
    }

    /// Whether the folder has it.
    pub fn there(self, dir: &Path) -> bool {
        let folder = self.files().split('/').next().unwrap_or_default();
        dir.join(folder).exists()
    }

    /// One line: what is missing, and which command makes it.
    pub fn missing(self, dir: &Path) -> Error {
        let place = format!("table `{}`", self.name());
        Error::bad(
            dir.display().to_string(),
            place,
            "nothing",
            format!("{}, {}", self.files(), self.maker()),
        )
    }

    /// The table, lazily: nothing but a schema is read here.
    ///
    /// # Errors
    /// The folder has no such table, or a file that is not Parquet.
    pub fn scan(self, dir: &Path) -> Result<LazyFrame> {
        if !self.there(dir) {
            return Err(self.missing(dir).into());
        }
        let pattern = dir.join(self.files());
        if self != Self::Runs {
            check_footers(pattern.parent().unwrap_or(dir))?;
        }
        match self {
            Self::Runs => runs(&pattern),
            Self::Intervals => intervals(scan(&pattern, ScanArgsParquet::default())?),
            Self::Features
            | Self::Actuators
            | Self::Maps
            | Self::Diagnoses
            | Self::Trends
            | Self::Prognoses
            | Self::Alarms => scan(&pattern, ScanArgsParquet::default()),
        }
    }
}

/// Refuses a folder of version 0.1, when datasets of one actuator had a layout of their own.
///
/// # Errors
/// Says which command makes a dataset.
pub fn refuse_old(dir: &Path) -> Result<()> {
    if !dir.join("plan.txt").exists() || dir.join("plan.toml").exists() {
        return Ok(());
    }
    let allowed = "a dataset with plan.toml; `ema simulate --out NEW` makes one";
    Err(Error::bad(
        dir.display().to_string(),
        "dataset",
        "plan.txt, a dataset of version 0.1",
        allowed,
    )
    .into())
}

/// Refuses files that declare more than they hold, before polars takes memory for it. Telemetry is left out: of its
/// many files only those are opened that a query needs.
fn check_footers(folder: &Path) -> Result<()> {
    let entries = std::fs::read_dir(folder).map_err(|e| Error::io(folder, "cannot be read", e))?;
    let mut files: Vec<_> = entries.flatten().map(|e| e.path()).collect();
    files.retain(|f| f.extension().is_some_and(|e| e == "parquet"));
    files.sort();
    files.iter().try_for_each(|f| Ok(check_footer(f)?))
}

/// A table of files, lazily.
///
/// * `pattern` that polars takes as one
fn scan(pattern: &Path, args: ScanArgsParquet) -> Result<LazyFrame> {
    let path = PlRefPath::new(pattern.to_string_lossy());
    LazyFrame::scan_parquet(path, args).map_err(|e| Error::torn(pattern, super::one_line(&e)).into())
}

/// Names of the columns of a lazy table.
fn names(frame: &mut LazyFrame, file: &Path) -> Result<Vec<String>> {
    let schema = super::guarded(|| frame.collect_schema()).map_err(|e| Error::torn(file, e))?;
    Ok(schema.iter_names().map(|n| n.to_string()).collect())
}

/// Telemetry, with the columns `sequence` and `actuator` from the folders' names. The equivalent current [A] is
/// formed from the phase currents where it is not stored.
fn runs(pattern: &Path) -> Result<LazyFrame> {
    // names of actuators may look like numbers or dates
    let text = [("sequence", DataType::String), ("actuator", DataType::String)];
    let schema = Schema::from_iter(text.map(|(n, t)| Field::new(n.into(), t)));
    let args = ScanArgsParquet {
        hive_options: HiveOptions {
            schema: Some(Arc::new(schema)),
            ..HiveOptions::new_enabled()
        },
        ..ScanArgsParquet::default()
    };
    let mut frame = scan(pattern, args)?;
    let names = names(&mut frame, pattern)?;
    let has = |n: &str| names.iter().any(|x| x == n);
    if has("i_eq") || !["i_a", "i_b", "i_c"].into_iter().all(has) {
        return Ok(frame);
    }
    let size = |n: &str| col(n).abs();
    let half = (size("i_a") + size("i_b") + size("i_c")) / lit(2);
    Ok(frame.with_column(half.alias("i_eq")))
}

/// Diagnoses by fault: one row a diagnosis and fault, all FSJ rows first.
///
/// Columns `run actuator tail position sequence maps fault exact lo hi estimate width error inside coverage`.
/// `error` is estimate - exact. Without an interval everything that follows from it is null.
fn intervals(diagnoses: LazyFrame) -> Result<LazyFrame> {
    let of = |fault: &str| {
        let c = |part: &str| col(format!("{fault}_{part}"));
        let (exact, lo, hi) = (col(fault), c("lo"), c("hi"));
        diagnoses.clone().select([
            col("run"),
            col("actuator"),
            col("tail"),
            col("position"),
            col("sequence"),
            col("maps"),
            lit(fault.to_string()).alias("fault"),
            exact.clone().alias("exact"),
            lo.clone().alias("lo"),
            hi.clone().alias("hi"),
            c("estimate").alias("estimate"),
            (hi.clone() - lo.clone()).alias("width"),
            (c("estimate") - exact.clone()).alias("error"),
            (exact.clone().gt_eq(lo).and(exact.lt_eq(hi))).alias("inside"),
            col("coverage"),
        ])
    };
    // put together now: counting the rows of a lazy union panics in this version of polars
    let both = concat([of("fsj"), of("zeta")], UnionArgs::default()).and_then(LazyFrame::collect);
    Ok(both
        .map_err(|e| Error::bad("intervals", "view", super::one_line(&e), "diagnoses"))?
        .lazy())
}
