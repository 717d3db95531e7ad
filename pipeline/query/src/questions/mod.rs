//! Ready questions: what is asked of a fleet again and again, by name.

mod diagnoses;
mod fault_levels;
mod map_drift;
mod out_of_family;
mod outlooks;
mod parameters;
mod region;
mod sensitivity;

use super::{Answer, Table, run};
use anyhow::Result;
use polars::prelude::*;
use schemas::error::Error;
use std::path::Path;

/// A ready question.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Question {
    /// Mean, standard deviation and quantiles of P1, P2, P3 and ripple over the fleet, at each fault pair.
    FaultLevels,
    /// Actuators whose maps lie aside of the fleet's, the farthest first.
    OutOfFamily,
    /// How far each feature moves with FSJ and zeta, by region of the fault plane.
    Sensitivity,
    /// Correlation, slope and elasticity of each healthy feature over each drawn parameter.
    ParameterSensitivity,
    /// How often the intervals hold the true pair, by tail number.
    Coverage,
    /// Outcomes of the diagnoses, by region of the fault plane.
    Outcomes,
    /// How far maps have moved between two datasets, the farthest first.
    MapDrift,
    /// Actuators by what a prognosis says of them, the worst first.
    AtRisk,
    /// Alarms of a prognosis, the latest first.
    WhatChanged,
    /// Rates of growth over their median, the greatest first.
    Growth,
}

impl Question {
    /// All, in the order of the help.
    pub const ALL: [Self; 10] = [
        Self::FaultLevels,
        Self::OutOfFamily,
        Self::Sensitivity,
        Self::ParameterSensitivity,
        Self::Coverage,
        Self::Outcomes,
        Self::MapDrift,
        Self::AtRisk,
        Self::WhatChanged,
        Self::Growth,
    ];

    /// Name on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::FaultLevels => "fault-levels",
            Self::OutOfFamily => "out-of-family",
            Self::Sensitivity => "sensitivity",
            Self::ParameterSensitivity => "parameter-sensitivity",
            Self::Coverage => "coverage",
            Self::Outcomes => "outcomes",
            Self::MapDrift => "map-drift",
            Self::AtRisk => "at-risk",
            Self::WhatChanged => "what-changed",
            Self::Growth => "growth",
        }
    }

    /// One line.
    pub fn meaning(self) -> &'static str {
        match self {
            Self::FaultLevels => "how P1, P2, P3 and ripple spread over the fleet at each fault pair",
            Self::OutOfFamily => "actuators whose maps lie aside of the fleet's, the farthest first",
            Self::Sensitivity => "how far each feature moves with FSJ and zeta, by region of the fault plane",
            Self::ParameterSensitivity => "how each feature of the healthy actuator follows each drawn parameter",
            Self::Coverage => "how often the intervals hold the true pair, by tail number",
            Self::Outcomes => "outcomes of the diagnoses by region of the fault plane",
            Self::MapDrift => "how far maps have moved between two datasets (--with OTHER), the farthest first",
            Self::AtRisk => "actuators by what ema prognosis --out says of their remaining life, the worst first",
            Self::WhatChanged => {
                "alarms of ema prognosis --out: changes of rate, repairs, thresholds, the latest first"
            }
            Self::Growth => "whose fault grows faster than it did: the last rate over the median, the greatest first",
        }
    }

    /// Tables that it reads.
    pub fn needs(self) -> &'static [Table] {
        match self {
            Self::FaultLevels | Self::Sensitivity | Self::MapDrift => &[Table::Features],
            Self::OutOfFamily | Self::ParameterSensitivity => &[Table::Features, Table::Actuators],
            Self::Coverage | Self::Outcomes => &[Table::Diagnoses],
            Self::AtRisk => &[Table::Prognoses],
            Self::WhatChanged => &[Table::Alarms],
            Self::Growth => &[Table::Trends],
        }
    }

    /// Whether it compares with a second dataset.
    pub fn compares(self) -> bool {
        self == Self::MapDrift
    }

    /// A question from the command line: `None` where the text is SQL, which is more than one word.
    ///
    /// # Errors
    /// A single word that is no question's name.
    pub fn from_text(text: &str) -> Result<Option<Self>, Error> {
        let word = text.trim();
        if word.contains(char::is_whitespace) {
            return Ok(None);
        }
        let question = Self::ALL.into_iter().find(|q| q.name() == word);
        let names = || Self::ALL.map(Self::name).join(", ");
        let bad = || Error::bad("query", "question", word, format!("{}, or an SQL statement", names()));
        question.ok_or_else(bad).map(Some)
    }

    /// What is read, lazily, in the order in which the answer takes it.
    ///
    /// # Errors
    /// As [`Question::ask`].
    pub fn reads(self, dir: &Path, other: Option<&Path>) -> Result<Vec<LazyFrame>> {
        if let Some(table) = self.needs().iter().find(|t| !t.there(dir)) {
            return Err(table.missing(dir).into());
        }
        match (self.compares(), other) {
            (true, Some(_)) | (false, None) => {}
            (true, None) => {
                return Err(Error::bad("command line", "--with", "nothing", "the dataset to compare with").into());
            }
            (false, Some(path)) => {
                let allowed = format!("only for {}", Self::MapDrift.name());
                return Err(Error::bad("command line", "--with", path.display(), allowed).into());
            }
        }
        match self {
            Self::FaultLevels => fault_levels::reads(dir),
            Self::OutOfFamily => out_of_family::reads(dir),
            Self::Sensitivity => sensitivity::reads(dir),
            Self::ParameterSensitivity => parameters::reads(dir),
            Self::Coverage | Self::Outcomes => diagnoses::reads(dir),
            Self::MapDrift => map_drift::reads(dir, other.unwrap_or(dir)),
            Self::AtRisk => outlooks::at_risk(dir),
            Self::WhatChanged => outlooks::what_changed(dir),
            Self::Growth => outlooks::growth(dir),
        }
    }

    /// Answers from the dataset in `dir`.
    ///
    /// * `other` the second dataset, for a question that compares
    ///
    /// # Errors
    /// A table that is not there (the error says which command makes it), columns of another kind of
    /// dataset, a torn file.
    pub fn ask(self, dir: &Path, other: Option<&Path>) -> Result<Answer> {
        let read = |frame| run(frame).map_err(|why| Error::torn(dir, why));
        let frames: Vec<DataFrame> = self
            .reads(dir, other)?
            .into_iter()
            .map(read)
            .collect::<Result<_, _>>()?;
        match self {
            Self::FaultLevels => fault_levels::answer(dir, &frames),
            Self::OutOfFamily => out_of_family::answer(dir, &frames),
            Self::Sensitivity => sensitivity::answer(dir, &frames),
            Self::ParameterSensitivity => parameters::answer(dir, &frames),
            Self::Coverage => diagnoses::coverage(dir, &frames),
            Self::Outcomes => diagnoses::outcomes(dir, &frames),
            Self::MapDrift => map_drift::answer(dir, other.unwrap_or(dir), &frames),
            Self::AtRisk | Self::WhatChanged | Self::Growth => outlooks::answer(&frames),
        }
    }

    /// What a question reads, after optimisation.
    ///
    /// # Errors
    /// As [`Question::ask`].
    pub fn explain(self, dir: &Path, other: Option<&Path>) -> Result<String> {
        let mut out = String::new();
        for frame in self.reads(dir, other)? {
            let plan = super::guarded(|| frame.explain(true)).map_err(|why| Error::torn(dir, why))?;
            out += &plan;
            out += "\n";
        }
        Ok(out)
    }
}

/// A column of numbers; NaN becomes null.
fn numbers(name: &str, values: impl IntoIterator<Item = f64>) -> Column {
    let values: Vec<Option<f64>> = values.into_iter().map(|x| Some(x).filter(|x| !x.is_nan())).collect();
    Column::new(name.into(), values)
}

fn counts(name: &str, values: impl IntoIterator<Item = usize>) -> Column {
    let values: Vec<u64> = values.into_iter().map(|n| n as u64).collect();
    Column::new(name.into(), values)
}

fn words<'a>(name: &str, values: impl IntoIterator<Item = &'a str>) -> Column {
    let values: Vec<&str> = values.into_iter().collect();
    Column::new(name.into(), values)
}

fn answer(columns: Vec<Column>, notes: Vec<String>) -> Result<Answer> {
    let height = columns.first().map_or(0, Column::len);
    let frame = DataFrame::new(height, columns)?;
    Ok(Answer { frame, notes })
}

/// Greater first, NaN last.
fn falling(a: f64, b: f64) -> std::cmp::Ordering {
    a.is_nan().cmp(&b.is_nan()).then(b.total_cmp(&a))
}
