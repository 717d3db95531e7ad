//! The tables of the record.

use super::{Case, percent, quadrant, quantile};
use diagnoser::diagnosis::Diagnoser;
use pipeline::calibrate::Unit;
use schemas::feature::RawFeatures;
use sim_worker::spread::Spread;
use std::fmt::Write;
use std::time::Instant;

/// Of FSJ and zeta.
pub type Pair = (f64, f64);

/// Located ones with their widths and errors.
pub fn located(cases: &[Case]) -> impl Iterator<Item = (&Case, Pair, Pair)> {
    cases.iter().filter_map(|c| c.found.map(|(w, e)| (c, w, e)))
}

/// Coverage, widths and errors of one set of tests.
pub fn coverage(title: &str, cases: &[Case]) -> String {
    let mut out = String::new();
    let n = cases.len();
    let inside = cases.iter().filter(|c| c.inside).count();
    let _ = writeln!(out, "### {title} ({n} tests)\n");
    let _ = writeln!(out, "- true pair in both intervals: {} %", percent(inside, n));
    for (q, name) in [
        "FSJ low, zeta low",
        "FSJ high, zeta low",
        "FSJ low, zeta high",
        "FSJ high, zeta high",
    ]
    .into_iter()
    .enumerate()
    {
        let of: Vec<&Case> = cases.iter().filter(|c| quadrant(c) == q).collect();
        let inside = of.iter().filter(|c| c.inside).count();
        let _ = writeln!(out, "  - {name}: {} %", percent(inside, of.len()));
    }
    for name in ["located", "unexplained", "out_of_range", "incomplete"] {
        let k = cases.iter().filter(|c| c.outcome == name).count();
        let _ = writeln!(out, "- {name}: {k}");
    }
    let several = cases.iter().filter(|c| c.parts > 1).count();
    let _ = writeln!(out, "- areas of several parts: {several}");
    let w = |q, f: fn(&Case, (f64, f64)) -> f64| quantile(located(cases).map(|(c, w, _)| f(c, w)), q);
    let _ = writeln!(
        out,
        "- width, median (95th percentile): FSJ {:.3} % ({:.3} %), zeta {:.5} ({:.5})",
        w(0.5, |c, w| 100.0 * w.0 / c.fsj),
        w(0.95, |c, w| 100.0 * w.0 / c.fsj),
        w(0.5, |_, w| w.1),
        w(0.95, |_, w| w.1)
    );
    let kinetic: Vec<(f64, bool)> = cases.iter().filter_map(|c| c.kinetic).collect();
    if !kinetic.is_empty() {
        let inside = kinetic.iter().filter(|k| k.1).count();
        let width = |q| 100.0 * quantile(kinetic.iter().map(|k| k.0), q);
        let _ = writeln!(
            out,
            "- kinetic factor: true one in its interval {} %, width, median (95th percentile): {:.3} % ({:.3} %)",
            percent(inside, kinetic.len()),
            width(0.5),
            width(0.95)
        );
    }
    for (name, least) in [("all", 0.0), ("zeta > 0.03", 0.03)] {
        let e = |q, f: fn(&Case, (f64, f64)) -> f64| {
            quantile(
                located(cases).filter(|(c, ..)| c.zeta > least).map(|(c, _, e)| f(c, e)),
                q,
            )
        };
        let _ = writeln!(
            out,
            "- |error| of the centroid, {name}, median (95th percentile): FSJ {:.3} % ({:.3} %), zeta {:.5} ({:.5})",
            e(0.5, |c, e| 100.0 * (e.0 / c.fsj).abs()),
            e(0.95, |c, e| 100.0 * (e.0 / c.fsj).abs()),
            e(0.5, |_, e| e.1.abs()),
            e(0.95, |_, e| e.1.abs())
        );
    }
    out.push('\n');
    out
}

/// Coverage and width in each third of each cause of a spread.
pub fn thirds(spread: &Spread, units: &[Unit], cases: &[Case]) -> String {
    let mut out =
        String::from("| cause | low third % | middle % | high third % | widths FSJ |\n|---|---|---|---|---|\n");
    for (cause, _) in spread.causes() {
        let third = |u: &Unit| (((u.draw[cause as usize] + 1.0) * 1.5) as usize).min(2);
        let mut widths = Vec::new();
        let _ = write!(out, "| {} |", cause.title());
        for k in 0..3 {
            let of: Vec<&Case> = units
                .iter()
                .zip(cases)
                .filter(|(u, _)| third(u) == k)
                .map(|(_, c)| c)
                .collect();
            let inside = of.iter().filter(|c| c.inside).count();
            let _ = write!(out, " {} |", percent(inside, of.len()));
            let width = quantile(of.iter().filter_map(|c| Some(100.0 * c.found?.0.0 / c.fsj)), 0.5);
            widths.push(format!("{width:.2}"));
        }
        let _ = writeln!(out, " {} |", widths.join(", "));
    }
    out + "\n"
}

/// Coverage, width and error in each fifth of the range of FSJ.
pub fn fifths(cases: &[Case]) -> String {
    let mut out = String::from(
        "| FSJ | truth inside % | width FSJ, median | twice the error of 95 % | width zeta | twice its error of 95 % |\n|---|---|---|---|---|---|\n",
    );
    let fifth = |c: &Case| (((c.fsj - 1.0) / 0.8) as usize).min(4);
    for k in 0..5 {
        let of: Vec<Case> = cases.iter().filter(|c| fifth(c) == k).cloned().collect();
        let inside = of.iter().filter(|c| c.inside).count();
        let q = |q: f64, f: fn(&Case, Pair, Pair) -> f64| quantile(located(&of).map(|(c, w, e)| f(c, w, e)), q);
        let _ = writeln!(
            out,
            "| {:.1} to {:.1} | {} | {:.2} % | {:.2} % | {:.5} | {:.5} |",
            1.0 + 0.8 * k as f64,
            1.8 + 0.8 * k as f64,
            percent(inside, of.len()),
            q(0.5, |c, w, _| 100.0 * w.0 / c.fsj),
            q(0.95, |c, _, e| 200.0 * (e.0 / c.fsj).abs()),
            q(0.5, |_, w, _| w.1),
            q(0.95, |_, _, e| 2.0 * e.1.abs()),
        );
    }
    out + "\n"
}

/// One row of a table of map sets.
pub fn maps_row(title: &str, cases: &[Case]) -> String {
    let n = cases.len();
    let inside = cases.iter().filter(|c| c.inside).count();
    let q = |f: fn(&Case, (f64, f64)) -> f64| quantile(located(cases).map(|(c, w, _)| f(c, w)), 0.5);
    let e = |f: fn(&Case, (f64, f64)) -> f64| quantile(located(cases).map(|(c, _, e)| f(c, e)), 0.5);
    format!(
        "| {title} | {} | {:.3} % | {:.5} | {:.3} % | {:.5} |\n",
        percent(inside, n),
        q(|c, w| 100.0 * w.0 / c.fsj),
        q(|_, w| w.1),
        e(|c, e| 100.0 * (e.0 / c.fsj).abs()),
        e(|_, e| e.1.abs())
    )
}

/// Microseconds of a diagnosis from features, one thread: median and 95th percentile.
pub fn time_us(diagnoser: &Diagnoser, units: &[Unit], measured: &[RawFeatures]) -> (f64, f64) {
    let mut times = Vec::new();
    for _ in 0..3 {
        for (_, raw) in units.iter().zip(measured) {
            let features = diagnoser.maps.features(raw);
            let begin = Instant::now();
            let d = diagnoser.diagnose(&features, &[]);
            times.push(begin.elapsed().as_secs_f64() * 1e6);
            std::hint::black_box(d);
        }
    }
    (
        quantile(times.iter().copied(), 0.5),
        quantile(times.iter().copied(), 0.95),
    )
}
