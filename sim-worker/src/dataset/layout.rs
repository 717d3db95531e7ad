//! Names of a dataset's objects, the same whoever writes them.

use super::parts::Part;
use super::plan::DatasetPlan;

/// The plan, first of all objects.
pub const PLAN: &str = "plan.toml";

/// What the dataset consists of, last of all objects: without it the dataset is not finished.
pub const MANIFEST: &str = "manifest.json";

/// Parts before the merge.
pub const STAGED: &str = "_staging/parts";

/// One row an actuator.
pub const ACTUATORS: &str = "actuators/part-0000.parquet";

/// Rows of a file of features, about.
const FILE_ROWS: u64 = 1 << 17;

/// Rows of a row group of features, about.
const GROUP_ROWS: u64 = 1 << 15;

/// A part's features before the merge; it is put last, so it stands for the whole part.
pub fn staged(part: usize) -> String {
    format!("{STAGED}/part-{part:06}.parquet")
}

/// Number of the part that an object below [`STAGED`] is of.
pub fn staged_part(path: &str) -> Option<usize> {
    let name = path.strip_prefix(STAGED)?.strip_prefix("/part-")?;
    name.strip_suffix(".parquet")?.parse().ok()
}

/// A file of features.
pub fn features(file: usize) -> String {
    format!("features/part-{file:04}.parquet")
}

impl DatasetPlan {
    /// The telemetry of a part.
    pub fn telemetry_path(&self, part: &Part) -> String {
        format!(
            "telemetry/sequence={}/actuator={}/part-{:04}.parquet",
            self.sequences[part.sequence].name, self.actuators[part.actuator].id, part.file
        )
    }

    fn per(&self, rows: u64) -> usize {
        (rows / self.runs_per_actuator()).max(1) as usize
    }

    /// Actuators of each file of features.
    pub fn actuators_per_file(&self) -> usize {
        let group = self.actuators_per_row_group();
        (self.per(FILE_ROWS) / group).max(1) * group
    }

    /// Actuators of each row group of features.
    pub fn actuators_per_row_group(&self) -> usize {
        self.per(GROUP_ROWS)
    }

    /// The file of features that an actuator is in.
    pub fn features_file(&self, actuator: usize) -> usize {
        actuator / self.actuators_per_file()
    }
}
