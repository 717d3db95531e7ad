//! The programs as their users start them. One test program for all: linking one takes as long as running most of them.

#[path = "../common/mod.rs"]
mod common;

mod book;
mod calibrate;
mod check;
mod codecs;
mod dialects;
mod ema;
mod fleet_damage;
mod fleet_ema;
mod fleet_plans;
mod fmu;
mod habits;
mod map_table;
mod preflight2;
mod prognosis;
mod query;
mod readme;
mod refusals;
mod report;
mod unit;
mod unit_live;
