//! The tables of a dataset folder, of `ema simulate` (one actuator) and of `ema dataset` (a fleet).

use crate::maps::scan;
use anyhow::Result;
use polars::prelude::*;
use schemas::error::Error;
use schemas::feature::{Feature, Form, Raw};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// A table that SQL and questions can name.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Table {
    Runs,
    Features,
    Actuators,
    Maps,
    Diagnoses,
    Intervals,
}

impl Table {
    pub const ALL: [Self; 6] = [
        Self::Runs,
        Self::Features,
        Self::Actuators,
        Self::Maps,
        Self::Diagnoses,
        Self::Intervals,
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
        }
    }

    /// The command that makes it.
    fn maker(self) -> &'static str {
        match self {
            Self::Runs => "made by ema simulate, or ema dataset make with telemetry kept",
            Self::Features => "made by ema simulate or ema dataset make",
            Self::Actuators => "made by ema dataset make",
            Self::Maps => "made by ema maps or ema dataset maps",
            Self::Diagnoses | Self::Intervals => "made by ema dataset diagnose",
        }
    }

    /// Where its files may lie in a dataset folder; the first that is there counts.
    fn places(self) -> &'static [(&'static str, &'static str)] {
        match self {
            Self::Runs => &[("runs", "runs/*.parquet"), ("telemetry", "telemetry/**/*.parquet")],
            Self::Features => &[("features", "features/*.parquet")],
            Self::Actuators => &[("actuators", "actuators/*.parquet")],
            Self::Maps => &[("maps.parquet", "maps.parquet"), ("maps", "maps/*.parquet")],
            Self::Diagnoses | Self::Intervals => &[("diagnoses", "diagnoses/*.parquet")],
        }
    }

    fn pattern(self, dir: &Path) -> Option<PathBuf> {
        let place = self.places().iter().find(|(there, _)| dir.join(there).exists());
        place.map(|(_, pattern)| dir.join(pattern))
    }

    /// Whether the folder has it.
    pub fn there(self, dir: &Path) -> bool {
        self.pattern(dir).is_some()
    }

    /// One line: what is missing, and which command makes it.
    pub fn missing(self, dir: &Path) -> Error {
        let files = self.places().iter().map(|(_, p)| *p).collect::<Vec<_>>().join(" or ");
        let place = format!("table `{}`", self.name());
        Error::bad(
            dir.display().to_string(),
            place,
            "nothing",
            format!("{files}, {}", self.maker()),
        )
    }

    /// The table, lazily: nothing but a schema is read here.
    ///
    /// # Errors
    /// The folder has no such table, or a file that is not Parquet.
    pub fn scan(self, dir: &Path) -> Result<LazyFrame> {
        let pattern = self.pattern(dir).ok_or_else(|| self.missing(dir))?;
        match self {
            Self::Runs => runs(&pattern),
            Self::Features => features(&pattern),
            Self::Intervals => intervals(scan(&pattern)?),
            Self::Actuators | Self::Maps | Self::Diagnoses => scan(&pattern),
        }
    }
}

/// Names of the columns of a lazy table.
fn names(frame: &mut LazyFrame, file: &Path) -> Result<Vec<String>> {
    let schema = super::guarded(|| frame.collect_schema()).map_err(|e| Error::torn(file, e))?;
    Ok(schema.iter_names().map(|n| n.to_string()).collect())
}

/// Telemetry; of a fleet with the columns `sequence` and `actuator` from the folders' names. The equivalent
/// current [A] is formed from the phase currents where it is not stored.
fn runs(pattern: &Path) -> Result<LazyFrame> {
    let mut frame = if pattern.to_string_lossy().contains("**") {
        // names of actuators may look like numbers or dates
        let text = [("sequence", DataType::String), ("actuator", DataType::String)];
        let schema = Schema::from_iter(text.map(|(n, t)| Field::new(n.into(), t)));
        let hive_options = HiveOptions {
            schema: Some(Arc::new(schema)),
            ..HiveOptions::new_enabled()
        };
        let args = ScanArgsParquet {
            hive_options,
            ..ScanArgsParquet::default()
        };
        let path = PlRefPath::new(pattern.to_string_lossy());
        LazyFrame::scan_parquet(path, args).map_err(|e| Error::torn(pattern, super::one_line(&e)))?
    } else {
        return scan(pattern);
    };
    let names = names(&mut frame, pattern)?;
    let has = |n: &str| names.iter().any(|x| x == n);
    if has("i_eq") || !["i_a", "i_b", "i_c"].into_iter().all(has) {
        return Ok(frame);
    }
    let size = |n: &str| col(n).abs();
    let half = (size("i_a") + size("i_b") + size("i_c")) / lit(2);
    Ok(frame.with_column(half.alias("i_eq")))
}

/// Features as stored by a fleet; of one actuator's dataset with those over the healthy run of the same
/// rest angle, which are formed here.
fn features(pattern: &Path) -> Result<LazyFrame> {
    let mut raw = scan(pattern)?;
    if names(&mut raw, pattern)?.iter().any(|n| n == "actuator") {
        return Ok(raw);
    }
    let is_needed = |r: &Raw| Feature::over_nominal().any(|f| f.form().raws().any(|x| x == *r));
    let needed: Vec<Raw> = Raw::ALL.into_iter().filter(is_needed).collect();
    let of = |r: Raw| col(r.column());
    let name = |r: Raw| format!("{}_0", r.column());
    let kept = std::iter::once(col("rest_angle_rad")).chain(needed.iter().map(|&r| of(r).alias(name(r))));
    let healthy = raw
        .clone()
        .filter(col("fsj").eq(lit(1.0)).and(col("zeta").eq(lit(0.0))))
        .select(kept.collect::<Vec<_>>());
    let on = [col("rest_angle_rad")];
    let nominal = |r: Raw| col(name(r));
    let over = |f: Feature| {
        let formed = match f.form() {
            Form::Same(r) => of(r),
            Form::Ratio(r) => of(r) / nominal(r),
            Form::Loss(r) => nominal(r) - of(r),
            Form::Length(mean, deviation) => {
                let (r, d) = (of(deviation), of(mean) - nominal(mean));
                (r.clone() * r + d.clone() * d).sqrt()
            }
        };
        formed.alias(f.key())
    };
    Ok(raw
        .join(healthy, on.clone(), on, JoinArgs::new(JoinType::Left))
        .with_columns(Feature::over_nominal().map(over).collect::<Vec<_>>())
        .drop(cols(needed.into_iter().map(name))))
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
