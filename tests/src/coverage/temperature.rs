//! Tests at any temperature: friction, winding and magnets are what they are there.

use super::units::command_of;
use super::{Case, FSJ, ZETA, calibrated, maps_of, other_hand, percent, quantile, record};
use anyhow::{Context, Result};
use diagnoser::diagnosis::Diagnoser;
use pipeline::calibrate::{Campaign, Effort, Unit, draw_units, knowing, measure};
use rayon::prelude::*;
use schemas::fault::FaultState;
use schemas::feature::RawFeatures;
use sim_worker::spread::{Cause, Spread};
use std::path::Path;

/// Coldest and warmest [deg C], at actuators whose model is of 20.
const RANGE_DEGC: (f64, f64) = (-40.0, 60.0);
const MODEL_DEGC: f64 = 20.0;

/// Lower end of the FSJ interval above which a healthy unit is called worn.
const FALSELY: f64 = 1.3;

/// Both pre-flight tests, by our simulator and by the other hand's, the temperature recorded and not.
pub fn bench(cache: &Path, grid: &str, spread: &str, effort: Effort, (n, seed): (usize, u64)) -> Result<String> {
    let spread = sim_worker::catalogue::spread(spread)?;
    let mut out = format!(
        "## Tests at {} to {} deg C, spread {}\n\nFriction over temperature {} a kelvin, known to {} %. {n} tests each of our \
         simulator, a quarter of that of another hand's, and as many of healthy units. 95 % Wilson bounds.\n\n| test | simulator | \
         temperature | truth inside % | refused | width FSJ %, median | zeta | by temperature: cold, middle, warm third % | healthy called \
         above FSJ {FALSELY} % |\n|---|---|---|---|---|---|---|---|---|\n",
        RANGE_DEGC.0,
        RANGE_DEGC.1,
        spread.name,
        spread.friction_per_k,
        100.0 * spread.half_width[Cause::FrictionSlope as usize],
    );
    for sequence in ["preflight", "preflight2"] {
        let (set, setup) = maps_of(&cache.join(sequence), sequence, grid, 0.0)?;
        let campaign = Campaign::run(&setup, &spread, effort, FSJ, ZETA)?.context("interrupted")?;
        let diagnoser = calibrated(&set, &campaign)?;
        for other in [false, true] {
            let n = if other { n / 4 } else { n };
            let simulate = |units: &[Unit]| -> Result<Vec<RawFeatures>> {
                if other {
                    return Ok(other_hand::measure(&setup, &spread, units, &command_of(sequence)));
                }
                measure(&setup, &spread, units, "tests at temperatures")?.context("interrupted")
            };
            let units = within(&spread, n, seed);
            let raw = simulate(&units)?;
            let mut healthy = within(&spread, n, seed ^ (1 << 40));
            healthy.iter_mut().for_each(|u| u.fault = FaultState::NOMINAL);
            let healthy_raw = simulate(&healthy)?;
            for recorded in [true, false] {
                let judged = |units: &[Unit], raw: &[RawFeatures]| judged(&diagnoser, &spread, recorded, units, raw);
                let (all, healthy_all) = (judged(&units, &raw), judged(&healthy, &healthy_raw));
                let title = format!(
                    "{sequence} | {} | {}",
                    if other { "another hand's" } else { "ours" },
                    if recorded { "recorded" } else { "unknown" }
                );
                out += &row(&title, &units, &all, &healthy_all);
            }
        }
    }
    Ok(out)
}

/// Units of which each is tested at a temperature of the range.
fn within(spread: &Spread, n: usize, seed: u64) -> Vec<Unit> {
    let mut units = draw_units(FSJ, ZETA, spread, n, 0x7E39_0000_0000_0000 ^ seed);
    let cause = Cause::TestTemperature;
    let half = spread.half_width[cause as usize];
    for u in &mut units {
        let share = 0.5 * (u.draw[cause as usize] + 1.0);
        let degc = RANGE_DEGC.0 + share * (RANGE_DEGC.1 - RANGE_DEGC.0);
        u.draw[cause as usize] = (degc - MODEL_DEGC) / half;
    }
    units
}

/// * `recorded` whether the tests say their temperature
fn judged(diagnoser: &Diagnoser, spread: &Spread, recorded: bool, units: &[Unit], raw: &[RawFeatures]) -> Vec<Case> {
    let one = |(u, raw): (&Unit, &RawFeatures)| {
        let features = diagnoser.maps.features(raw);
        let d = if recorded {
            knowing(diagnoser, spread, u).diagnose(&features, &[])
        } else {
            diagnoser.diagnose(&features, &[])
        };
        Case::of(spread, u, d)
    };
    units.par_iter().zip(raw).map(one).collect()
}

fn row(title: &str, units: &[Unit], all: &[Case], healthy: &[Case]) -> String {
    let inside = |of: &[&Case]| percent(of.iter().filter(|c| c.inside).count(), of.len());
    let draws: Vec<f64> = units.iter().map(|u| u.draw[Cause::TestTemperature as usize]).collect();
    let (lo, hi) = (
        quantile(draws.iter().copied(), 1.0 / 3.0),
        quantile(draws.iter().copied(), 2.0 / 3.0),
    );
    let third = |k: usize| {
        let of = |x: f64| usize::from(x > lo) + usize::from(x > hi);
        let of: Vec<&Case> = draws
            .iter()
            .zip(all)
            .filter(|(x, _)| of(**x) == k)
            .map(|x| x.1)
            .collect();
        inside(&of)
    };
    let width = |f: fn(&Case, (f64, f64)) -> f64| quantile(record::located(all).map(|(c, w, _)| f(c, w)), 0.5);
    let falsely = healthy
        .iter()
        .filter(|c| c.found.is_some_and(|((w, _), (e, _))| lower(c, w, e) > FALSELY));
    format!(
        "| {title} | {} | {} | {:.2} | {:.4} | {}, {}, {} | {} |\n",
        inside(&all.iter().collect::<Vec<_>>()),
        all.iter().filter(|c| c.outcome != "located").count(),
        width(|c, w| 100.0 * w.0 / c.fsj),
        width(|_, w| w.1),
        third(0),
        third(1),
        third(2),
        percent(falsely.count(), healthy.len())
    )
}

/// Lower end of the FSJ interval, about its centroid.
fn lower(c: &Case, width: f64, error: f64) -> f64 {
    c.fsj + error - 0.5 * width
}
