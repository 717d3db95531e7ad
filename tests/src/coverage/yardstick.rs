//! The maps held against the slow estimator that runs the simulator.

use super::quantile;
use anyhow::{Context, Result};
use diagnoser::diagnosis::Diagnoser;
use pipeline::calibrate::{TestKind, Unit};
use pipeline::refine::{Start, Test, refine};
use schemas::feature::RawFeatures;
use sim_worker::spread::Spread;
use std::fmt::Write;

/// One test by both: (FSJ, zeta) half-widths and how far the truth lies from the middle.
struct Pair {
    fsj: f64,
    maps: ((f64, f64), (f64, f64)),
    refined: ((f64, f64), (f64, f64)),
    settled: bool,
}

/// By how much intervals must be stretched about their middles to hold the truth of a share of the tests.
fn stretch(pairs: &[Pair], of: fn(&Pair) -> ((f64, f64), (f64, f64)), share: f64) -> f64 {
    let needed = pairs.iter().map(|p| {
        let (half, off) = of(p);
        (off.0 / half.0).max(off.1 / half.1)
    });
    quantile(needed, share)
}

/// Table of widths at equal coverage.
pub fn compare(
    diagnoser: &Diagnoser,
    kind: &TestKind,
    spread: &Spread,
    units: &[Unit],
    measured: &[RawFeatures],
) -> Result<String> {
    let mut pairs = Vec::new();
    for (u, raw) in units.iter().zip(measured) {
        let features = diagnoser.maps.features(raw);
        let d = diagnoser.diagnose(&features, &[]);
        let Some(area) = d.outcome.area() else { continue };
        let test = Test {
            kind,
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
        pairs.push(Pair {
            fsj,
            maps: ((mf.0, mz.0), (mf.1, mz.1)),
            refined: ((rf.0, rz.0), (rf.1, rz.1)),
            settled: r.converged,
        });
    }
    let coverage = |of: fn(&Pair) -> ((f64, f64), (f64, f64))| {
        let inside = |p: &&Pair| {
            let (half, off) = of(p);
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
    type Of = fn(&Pair) -> ((f64, f64), (f64, f64));
    let rows: [(&str, Of); 2] = [("maps", |p| p.maps), ("by running the simulator", |p| p.refined)];
    let mut at_equal = Vec::new();
    for (title, of) in rows {
        let k = stretch(&pairs, of, 0.95);
        let fsj = quantile(pairs.iter().map(|p| 200.0 * of(p).0.0 / p.fsj), 0.5);
        let zeta = quantile(pairs.iter().map(|p| 2.0 * of(p).0.1), 0.5);
        let inside = super::percent(coverage(of), n);
        let _ = writeln!(out, "| {title} | {inside} | {fsj:.3} % | {zeta:.5} | {k:.2} |");
        at_equal.push((k * fsj, k * zeta));
    }
    let ratio = |f: fn(&(f64, f64)) -> f64| f(&at_equal[0]) / f(&at_equal[1]);
    let raw = |f: fn(((f64, f64), (f64, f64))) -> f64| quantile(pairs.iter().map(|p| f(p.maps) / f(p.refined)), 0.5);
    let _ = writeln!(
        out,
        "\n- maps over simulator at equal coverage: FSJ {:.2}, zeta {:.2}\n- median of the ratios as reported: FSJ {:.2}, zeta \
         {:.2}\n",
        ratio(|w| w.0),
        ratio(|w| w.1),
        raw(|w| w.0.0),
        raw(|w| w.0.1)
    );
    Ok(out)
}
