//! The maps held against the slow estimator that runs the simulator.

use super::quantile;
use anyhow::{Context, Result};
use diagnoser::diagnosis::Diagnoser;
use pipeline::calibrate::Unit;
use pipeline::refine::{Start, Test, refine};
use schemas::feature::{Feature, RawFeatures};
use sim_worker::setup::TestSetup;
use sim_worker::spread::Spread;
use std::fmt::Write;

/// Intervals of (FSJ, zeta): half-widths, and how far the truth lies from their middles.
#[derive(Clone, Copy)]
struct Sides {
    half: (f64, f64),
    off: (f64, f64),
}

/// One test by both.
struct Pair {
    fsj: f64,
    maps: Sides,
    refined: Sides,
    settled: bool,
}

type Of = fn(&Pair) -> Sides;

/// By how much intervals must be stretched about their middles to hold the truth of a share of the tests.
fn stretch(pairs: &[Pair], of: Of, share: f64) -> f64 {
    let needed = pairs.iter().map(|p| {
        let Sides { half, off } = of(p);
        (off.0 / half.0).max(off.1 / half.1)
    });
    quantile(needed, share)
}

/// Table of widths at equal coverage.
///
/// * `left_out` features that the tests are taken to lack
pub fn compare(
    diagnoser: &Diagnoser,
    setup: &TestSetup,
    spread: &Spread,
    units: &[Unit],
    measured: &[RawFeatures],
    left_out: &[Feature],
) -> Result<String> {
    let mut pairs = Vec::new();
    for (u, raw) in units.iter().zip(measured) {
        let all = diagnoser.maps.features(raw);
        let features = left_out.iter().fold(all, |features, &f| features.with(f, None));
        let d = diagnoser.diagnose(&features, &[]);
        let Some(area) = d.outcome.area() else { continue };
        let test = Test {
            setup,
            nominal: &diagnoser.maps.nominal,
            features: &features,
            spread,
            known: &Vec::new(),
        };
        let r = refine(&test, Some(Start::of(area)), 0.95, u.seed)?.context("interrupted")?;
        let (fsj, zeta) = (u.fault.fsj, u.fault.zeta);
        let side = |lo: f64, hi: f64, x: f64| (0.5 * (hi - lo), (x - 0.5 * (lo + hi)).abs());
        let (mf, mz) = (
            side(area.fsj.lo, area.fsj.hi, fsj),
            side(area.zeta.lo, area.zeta.hi, zeta),
        );
        let (rf, rz) = (side(r.fsj.lo, r.fsj.hi, fsj), side(r.zeta.lo, r.zeta.hi, zeta));
        let sides = |f: (f64, f64), z: (f64, f64)| Sides {
            half: (f.0, z.0),
            off: (f.1, z.1),
        };
        pairs.push(Pair {
            fsj,
            maps: sides(mf, mz),
            refined: sides(rf, rz),
            settled: r.converged,
        });
    }
    let coverage = |of: Of| {
        let inside = |p: &&Pair| {
            let Sides { half, off } = of(p);
            off.0 <= half.0 && off.1 <= half.1
        };
        pairs.iter().filter(inside).count()
    };
    let n = pairs.len();
    let mut out = String::new();
    let settled = pairs.iter().filter(|p| p.settled).count();
    let _ = writeln!(
        out,
        "{n} of the tests; the slow estimator settled in {settled}. Widths are medians; at equal coverage both are stretched \
         about their middles until they hold 95 % of these tests.\n\n| | truth inside % | width FSJ | width zeta | stretch to 95 % \
         |\n|---|---|---|---|---|"
    );
    let rows: [(&str, Of); 2] = [("maps", |p| p.maps), ("by running the simulator", |p| p.refined)];
    let mut at_equal = Vec::new();
    for (title, of) in rows {
        let k = stretch(&pairs, of, 0.95);
        let fsj = quantile(pairs.iter().map(|p| 200.0 * of(p).half.0 / p.fsj), 0.5);
        let zeta = quantile(pairs.iter().map(|p| 2.0 * of(p).half.1), 0.5);
        let inside = super::percent(coverage(of), n);
        let _ = writeln!(out, "| {title} | {inside} | {fsj:.3} % | {zeta:.5} | {k:.2} |");
        at_equal.push((k * fsj, k * zeta));
    }
    let ratio = |f: fn(&(f64, f64)) -> f64| f(&at_equal[0]) / f(&at_equal[1]);
    let raw = |f: fn(Sides) -> f64| quantile(pairs.iter().map(|p| f(p.maps) / f(p.refined)), 0.5);
    let _ = writeln!(
        out,
        "\n- maps over simulator at equal coverage: FSJ {:.2}, zeta {:.2}\n- median of the ratios as reported: FSJ {:.2}, zeta \
         {:.2}\n",
        ratio(|w| w.0),
        ratio(|w| w.1),
        raw(|w| w.half.0),
        raw(|w| w.half.1)
    );
    Ok(out)
}
