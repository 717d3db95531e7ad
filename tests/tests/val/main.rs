//! Compared with something that is not ours: equations of others, measured data, stated coverage.

#[path = "../common/mod.rs"]
mod common;

mod coverage;
mod models;
mod other_hands;
mod prognosis;
mod reference;
mod table;
