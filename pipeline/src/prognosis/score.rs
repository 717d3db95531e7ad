//! How good past forecasts were: every life that has ended is replayed.

use super::learn::Unit;
use crate::Interrupted;
use crate::progress::interrupted;
use anyhow::Result;
use diagnoser::prognosis::fleet::{COVERAGE, Left, without_fleet};
use diagnoser::prognosis::forecast::{crps, quantile};
use diagnoser::prognosis::outlook::LEAST_TESTS;
use diagnoser::prognosis::special::middle;
use diagnoser::prognosis::{Fleet, Prior, Track};
use rayon::prelude::*;
use serde_json::{Value, json};
use std::sync::Arc;

/// Forecasts of each life: evenly over it.
const FORECASTS: usize = 40;

/// Shares of the life at which the field asks (Saxena et al. 2010), and the accuracy that it asks for.
pub const LAMBDAS: [f64; 3] = [0.25, 0.5, 0.75];
/// Accuracy that is asked for, as a share of the time left.
pub const ALPHA: f64 = 0.2;
/// Mass within the accuracy that the strict form asks for.
const BETA: f64 = 0.5;
/// Accuracy of the prognostic horizon, as a share of the whole life.
const HORIZON: f64 = 0.1;

/// Tests that may be left out before a unit counts as no longer tested, in usual intervals (assumed).
const ASKED_FOR: f64 = 3.0;

/// Bands of the probability of failure.
pub const BINS: [(f64, f64); 6] = [(0.0, 0.02), (0.02, 0.1), (0.1, 0.3), (0.3, 0.7), (0.7, 0.9), (0.9, 1.0)];

/// One forecast and what came of it.
#[derive(Clone, Debug)]
pub struct Forecast {
    /// unit
    pub unit: usize,
    /// share of the life that was over
    pub lambda: f64,
    /// time left in truth [units of the clock]
    pub truth: f64,
    /// median and interval
    pub median: f64,
    /// lower end
    pub lo: f64,
    /// upper end
    pub hi: f64,
    /// score [units of the clock]
    pub crps: f64,
    /// mass within [`ALPHA`] of the truth
    pub within: f64,
    /// place of the truth in the distribution
    pub place: f64,
    /// probability of failure within each of the times ahead
    pub p_fail: Vec<f64>,
    /// how far ahead was looked
    pub horizon: f64,
}

/// At one share of the life.
#[derive(Clone, Copy, Debug, Default)]
pub struct At {
    /// share of the life
    pub lambda: f64,
    /// units
    pub units: usize,
    /// share of truths in the interval
    pub coverage: f64,
    /// share of medians within [`ALPHA`] of the truth
    pub alpha_lambda: f64,
    /// share of units with [`BETA`] of the mass within [`ALPHA`]
    pub strict: f64,
    /// mean and median width over the truth
    pub width: (f64, f64),
    /// mean and median score over the truth
    pub crps: (f64, f64),
}

/// A time ahead, the Brier score of P(failure within it), and said, happened and count of each band.
pub type Reliability = (f64, f64, Vec<(f64, f64, usize)>);

/// What was seen.
#[derive(Clone, Debug)]
pub struct Scored {
    /// units that were scored, and those that were not: no end is known, or too few tests
    pub units: usize,
    /// left out
    pub left_out: usize,
    /// by share of the life
    pub at: Vec<At>,
    /// coverage over the mix of times
    pub coverage: f64,
    /// prognostic horizon: from when on medians stay within a tenth of the life, as a share of the life left; median of units
    pub prognostic_horizon: f64,
    /// cumulative relative accuracy, mean of units
    pub accuracy: f64,
    /// times ahead, Brier scores, and said, happened, count of each band
    pub brier: Vec<Reliability>,
    /// all forecasts
    pub forecasts: Vec<Forecast>,
}

/// Replays lives whose end is known.
///
/// # Errors
/// Interrupted.
pub fn score(units: &[Unit], fleet: Option<&Fleet>, horizons: &[f64]) -> Result<Scored> {
    let replayed: Vec<(Vec<Forecast>, Vec<Forecast>)> = units
        .par_iter()
        .enumerate()
        .map(|(i, u)| {
            if interrupted() {
                Default::default()
            } else {
                replay(i, u, fleet, horizons)
            }
        })
        .collect();
    if interrupted() {
        return Err(Interrupted.into());
    }
    let scored: Vec<&(Vec<Forecast>, Vec<Forecast>)> = replayed.iter().filter(|r| !r.0.is_empty()).collect();
    let n = scored.len().max(1) as f64;
    let at = (0..LAMBDAS.len()).map(|k| {
        at(
            LAMBDAS[k],
            scored
                .iter()
                .filter_map(|r| r.1.iter().find(|f| f.lambda == LAMBDAS[k]))
                .collect(),
        )
    });
    // a unit counts once, whatever the number of its forecasts
    let share = |of: &[Forecast], f: &dyn Fn(&Forecast) -> f64| of.iter().map(f).sum::<f64>() / of.len() as f64;
    let mean = |f: &dyn Fn(&Forecast) -> f64| scored.iter().map(|r| share(&r.0, f)).sum::<f64>() / n;
    let all = || scored.iter().flat_map(|r| &r.0);
    let brier = horizons.iter().enumerate().map(|(k, h)| {
        let pairs: Vec<(f64, f64)> = all()
            .map(|f| (f.p_fail[k], f64::from(u8::from(f.truth <= *h))))
            .collect();
        let b = pairs.iter().map(|(p, y)| (p - y).powi(2)).sum::<f64>() / pairs.len().max(1) as f64;
        let bins = BINS.iter().map(|(lo, hi)| {
            let of: Vec<&(f64, f64)> = pairs
                .iter()
                .filter(|p| p.0 >= *lo && (p.0 < *hi || *hi == 1.0))
                .collect();
            let n = of.len().max(1) as f64;
            (
                of.iter().map(|p| p.0).sum::<f64>() / n,
                of.iter().map(|p| p.1).sum::<f64>() / n,
                of.len(),
            )
        });
        (*h, b, bins.collect())
    });
    let horizons_of = scored.iter().map(|r| horizon_of(&r.0)).collect();
    let accuracy = |f: &Forecast| 1.0 - ((f.median.min(f.horizon) - f.truth).abs() / f.truth.max(1e-9)).min(10.0);
    Ok(Scored {
        units: scored.len(),
        left_out: units.len() - scored.len(),
        at: at.collect(),
        coverage: mean(&|f| f64::from(u8::from(f.lo <= f.truth && f.truth <= f.hi))),
        prognostic_horizon: middle(horizons_of).unwrap_or(0.0),
        accuracy: mean(&accuracy),
        brier: brier.collect(),
        forecasts: all().cloned().collect(),
    })
}

fn at(lambda: f64, of: Vec<&Forecast>) -> At {
    let n = of.len().max(1) as f64;
    let share = |f: &dyn Fn(&Forecast) -> bool| of.iter().filter(|x| f(x)).count() as f64 / n;
    let both = |f: &dyn Fn(&Forecast) -> f64| {
        let v: Vec<f64> = of.iter().map(|x| f(x)).collect();
        (v.iter().sum::<f64>() / n, middle(v).unwrap_or(f64::NAN))
    };
    At {
        lambda,
        units: of.len(),
        coverage: share(&|f| f.lo <= f.truth && f.truth <= f.hi),
        alpha_lambda: share(&|f| (f.median - f.truth).abs() <= ALPHA * f.truth),
        strict: share(&|f| f.within >= BETA),
        width: both(&|f| (f.hi.min(f.horizon) - f.lo) / f.truth),
        crps: both(&|f| f.crps / f.truth),
    }
}

/// From when on all medians are within a tenth of the life, as a share of it that is left then.
fn horizon_of(of: &[Forecast]) -> f64 {
    let good = |f: &&Forecast| {
        let life = f.truth / (1.0 - f.lambda).max(1e-9);
        (f.median.min(f.horizon) - f.truth).abs() <= HORIZON * life
    };
    of.iter().rev().take_while(good).last().map_or(0.0, |f| 1.0 - f.lambda)
}

/// Forecasts of a unit over its last life: evenly, and at the shares that the field asks for.
fn replay(unit: usize, u: &Unit, fleet: Option<&Fleet>, horizons: &[f64]) -> (Vec<Forecast>, Vec<Forecast>) {
    let Some(end) = u.end else { return Default::default() };
    let prior = fleet.map_or_else(
        || Prior::shipped(u.history.interval().unwrap_or(1.0)),
        |f| f.prior.clone(),
    );
    let prior = Arc::new(prior);
    // where the life began is known at its end only
    let mut whole = Track::new(prior.clone(), u.scale);
    whole.read_all(&u.history);
    let begun = whole.begun();
    let mut moments: Vec<(f64, bool)> = (0..FORECASTS)
        .map(|k| ((k as f64 + 0.5) / FORECASTS as f64, false))
        .collect();
    moments.extend(LAMBDAS.map(|l| (l, true)));
    moments.sort_by(|a, b| a.0.total_cmp(&b.0));
    let mut track = Track::new(prior, u.scale);
    let (mut even, mut asked) = (Vec::new(), Vec::new());
    let mut i = 0;
    let apart = u.history.interval().unwrap_or(f64::INFINITY);
    for (lambda, is_asked) in moments {
        let at = begun + lambda * (end - begun);
        while i < u.history.rows.len() && u.history.rows[i].at <= at {
            track.read(&u.history, i);
            i += 1;
        }
        // after its last test nobody asks any more: such a unit was not scored to its end
        let is_over = i == u.history.rows.len() && at - track.at > ASKED_FOR * apart;
        if i == 0 || track.used < LEAST_TESTS || track.at < begun || is_over {
            continue;
        }
        let left = fleet.map_or_else(|| without_fleet(&track), |f| f.left(&track));
        let f = forecast(unit, lambda, &left, (end - at, at - track.at), horizons);
        if is_asked { &mut asked } else { &mut even }.push(f);
    }
    (even, asked)
}

/// * `truth`, `since` time left, and time since the last test: the forecast is that much older
fn forecast(unit: usize, lambda: f64, left: &Left, (truth, since): (f64, f64), horizons: &[f64]) -> Forecast {
    let times: Vec<f64> = left.times.iter().map(|t| (t - since).max(0.0)).collect();
    let n = times.len().max(1) as f64;
    let share = |a: f64, b: f64| times.iter().filter(|t| (a..=b).contains(*t)).count() as f64 / n;
    Forecast {
        unit,
        lambda,
        truth,
        median: quantile(&times, 0.5),
        lo: (left.interval.0 - since).max(0.0),
        hi: (left.interval.1 - since).max(0.0),
        crps: crps(&times, truth, left.horizon),
        within: share((1.0 - ALPHA) * truth, (1.0 + ALPHA) * truth),
        place: share(0.0, truth),
        p_fail: horizons.iter().map(|h| share(0.0, *h)).collect(),
        horizon: left.horizon,
    }
}

/// Keys for programs.
pub fn to_json(s: &Scored, fault: &str, threshold: f64, lives: Option<usize>) -> Value {
    let at = |a: &At| {
        json!({
            "lambda": a.lambda, "units": a.units, "coverage": a.coverage, "alpha_lambda": a.alpha_lambda,
            "alpha_lambda_strict": a.strict, "width_over_rul": {"mean": a.width.0, "median": a.width.1},
            "crps_over_rul": {"mean": a.crps.0, "median": a.crps.1},
        })
    };
    let brier = |(h, b, bins): &Reliability| {
        let bin = |(said, was, n): &(f64, f64, usize)| json!({"said": said, "happened": was, "forecasts": n});
        json!({"within": h, "brier": b, "reliability": bins.iter().map(bin).collect::<Vec<_>>()})
    };
    json!({
        "fault": fault, "threshold": threshold, "units": s.units, "left_out": s.left_out, "calibration_lives": lives,
        "at": s.at.iter().map(at).collect::<Vec<_>>(),
        "coverage": s.coverage, "prognostic_horizon": s.prognostic_horizon,
        "cumulative_relative_accuracy": s.accuracy, "p_fail": s.brier.iter().map(brier).collect::<Vec<_>>(),
    })
}

/// How many lives, in words.
pub fn replayed(s: &Scored) -> String {
    format!(
        "{} lives replayed, {} left out (no end known, or fewer than {LEAST_TESTS} tests)",
        s.units, s.left_out
    )
}

/// What was seen over all times, in words.
pub fn over_all(s: &Scored) -> String {
    format!(
        "over all times: coverage {:.3} (stated {COVERAGE}), cumulative relative accuracy {:.2}, prognostic horizon {:.2} of the life",
        s.coverage, s.accuracy, s.prognostic_horizon
    )
}

/// For people.
pub fn to_text(s: &Scored, fault: &str, threshold: f64) -> String {
    let mut out = format!("{fault} {threshold}: {}\n", replayed(s));
    out += "share of life  coverage  median within 20 %  half of mass within 20 %  width / RUL        CRPS / RUL\n";
    for a in &s.at {
        out += &format!(
            "{:<13}  {:<8.3}  {:<18.2}  {:<24.2}  {:.2} (median {:.2})  {:.3} (median {:.3})\n",
            a.lambda, a.coverage, a.alpha_lambda, a.strict, a.width.0, a.width.1, a.crps.0, a.crps.1
        );
    }
    out += &format!("{}\n", over_all(s));
    for (h, b, bins) in &s.brier {
        let bins: Vec<String> = bins
            .iter()
            .filter(|b| b.2 > 0)
            .map(|(p, y, n)| format!("{p:.3}: {y:.3} of {n}"))
            .collect();
        out += &format!(
            "P(fail within {h}): Brier {b:.4}; said: happened  {}\n",
            bins.join("  ")
        );
    }
    out
}
