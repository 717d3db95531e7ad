//! Prognosis: from diagnoses over time to the time that is left before a threshold.
//!
//! A [`History`] of one unit and fault is read by a [`Track`], test by test. Its [`Filter`] averages over laws of growth
//! ([`law`]), kinds of wear, volatility and scatter ([`Prior`]); from its state the time left is forecast ([`fleet`]), with
//! what other units taught where a [`Fleet`] is known. An [`Outlook`] is what is told of it.
//!
//! Damage is `x = (level - healthy) / (threshold - healthy)`, "share of U"; times are in units of one clock.

pub mod filter;
pub mod fleet;
pub mod forecast;
pub mod history;
pub mod law;
pub mod outlook;
pub mod past;
pub mod prior;
#[cfg(test)]
mod referees;
pub mod similar;
pub mod special;
pub mod track;
mod update;

pub use filter::Filter;
pub use fleet::{Fleet, Left};
pub use history::{Ended, Happening, History, Row, Scale};
pub use outlook::{Outlook, Status};
pub use prior::Prior;
pub use similar::Life;
pub use track::Track;
