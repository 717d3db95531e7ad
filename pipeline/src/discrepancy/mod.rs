//! Where simulation and measurement disagree: the gap is located, the missing effect named, added to
//! the model, and the gap shown to shrink on data that was not used to find it.

pub mod bench;
pub mod check;
pub mod closed_loop;
pub mod columns;
pub mod compare;
mod compare_motion;
pub mod filter;
pub mod findings;
pub mod fit;
pub mod html;
mod html_figures;
pub mod intervals;
pub mod next;
mod own;
pub mod persist;
pub mod places;
pub mod problem;
pub mod recording;
pub mod remainder;
mod run;
pub mod select;
pub mod shapes;
pub mod signals;
pub mod study;
pub mod table;
pub mod tell;
pub mod units;

pub use run::{REFERENCE, Written, study_file, study_into};
