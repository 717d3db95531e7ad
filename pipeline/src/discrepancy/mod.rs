//! Where simulation and measurement disagree: the gap is located, the missing effect named, added to
//! the model, and the gap shown to shrink on data that was not used to find it.

pub mod bench;
pub(crate) mod check;
pub(crate) mod closed_loop;
pub(crate) mod columns;
pub(crate) mod compare;
mod compare_motion;
pub(crate) mod filter;
pub mod findings;
pub mod fit;
pub(crate) mod html;
mod html_figures;
pub(crate) mod intervals;
pub(crate) mod next;
mod own;
pub(crate) mod persist;
pub(crate) mod places;
pub(crate) mod problem;
pub mod recording;
pub(crate) mod remainder;
mod run;
pub mod select;
pub(crate) mod shapes;
pub(crate) mod signals;
pub mod study;
pub(crate) mod table;
pub(crate) mod tell;
pub(crate) mod units;

pub use run::{REFERENCE, Written, study_file, study_into};
