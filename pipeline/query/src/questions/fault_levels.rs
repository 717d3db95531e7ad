//! Spread of the paper's features over the fleet, by fault pair.

use super::{Answer, answer as table, counts, numbers, words};
use crate::fleet::{self, Fleet};
use crate::stats;
use anyhow::Result;
use polars::prelude::*;
use rayon::prelude::*;
use schemas::feature::Feature;
use std::path::Path;

const FEATURES: [Feature; 4] = [Feature::P1, Feature::P2, Feature::P3, Feature::Ripple];

pub fn reads(dir: &Path) -> Result<Vec<LazyFrame>> {
    Ok(vec![fleet::read(dir, &FEATURES.map(Feature::key), false, false)?])
}

/// One row a feature, sequence, rest angle and fault pair: `n`, then `mean`, `sd`, `p05`, `median`, `p95` in
/// the unit of the column `unit`.
pub fn answer(dir: &Path, frames: &[DataFrame]) -> Result<Answer> {
    let fleet = Fleet::new(&frames[0], &FEATURES.map(Feature::key), dir)?;
    let groups = fleet.by_point();
    let rows: Vec<[f64; 6]> = FEATURES
        .par_iter()
        .enumerate()
        .flat_map_iter(|(k, _)| {
            let mut values = groups.gather(&fleet.values[k]).into_owned();
            let spread = |g| {
                let values = stats::numbers(&mut values[groups.of(g)]);
                values.sort_unstable_by(f64::total_cmp);
                let (mean, sd) = stats::mean_sd(values);
                let [low, middle, high] = [0.05, 0.5, 0.95].map(|q| stats::quantile(values, q));
                [values.len() as f64, mean, sd, low, middle, high]
            };
            (0..groups.count()).map(spread).collect::<Vec<_>>()
        })
        .collect();
    let point = |i: usize| &fleet.points[i % fleet.points.len()];
    let feature = |i: usize| FEATURES[i / fleet.points.len()];
    let all = || 0..rows.len();
    let column = |name, k: usize| numbers(name, rows.iter().map(|r| r[k]));
    table(
        vec![
            words("feature", all().map(|i| feature(i).name())),
            words("unit", all().map(|i| feature(i).unit())),
            words("sequence", all().map(|i| point(i).sequence.as_str())),
            numbers("rest_angle_rad", all().map(|i| point(i).rest_angle_rad)),
            numbers("fsj", all().map(|i| point(i).fsj)),
            numbers("zeta", all().map(|i| point(i).zeta)),
            counts("n", rows.iter().map(|r| r[0] as usize)),
            column("mean", 1),
            column("sd", 2),
            column("p05", 3),
            column("median", 4),
            column("p95", 5),
        ],
        Vec::new(),
    )
}
