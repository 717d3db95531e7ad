//! Datasets: runs of one actuator, or of a fleet of actuators each a little different, simulated by one worker or
//! many into one layout. A single actuator is a fleet of one ([`one`]).
//!
//! A [`plan::DatasetPlan`] is cut into [`parts::Part`]s, whose results depend on the plan alone. Workers put parts
//! under fixed names, each once ([`work`]); [`merge`] compacts them and commits the [`manifest`] last;
//! [`verify`] reads everything again.

pub mod compacted;
pub mod copy;
pub mod draw;
pub mod layout;
pub mod manifest;
pub mod merge;
pub mod one;
pub mod parts;
pub mod plan;
pub mod program;
pub mod ranges;
pub mod shard;
pub mod sink;
pub mod storage;
pub mod tables;
pub mod verify;
pub mod wear;
pub mod work;
