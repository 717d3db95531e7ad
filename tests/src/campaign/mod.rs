//! The campaign of the blind test bed: cases by the hundred, studied through files only, their keys opened
//! after the verdicts, and what came of it as a report.

pub mod hands;
pub mod options;
pub mod parameters;
pub mod plan;
pub mod report;
pub mod run;
pub mod score;
pub mod store;
mod tables;
pub mod truth;
