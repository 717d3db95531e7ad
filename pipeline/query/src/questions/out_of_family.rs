//! Actuators whose maps lie aside of the fleet's.
//!
//! At each grid point the fleet gives a median and a median absolute deviation (MAD); an actuator's value
//! there becomes the robust score z = (value - median) / (1.4826 MAD), which a few strange actuators cannot
//! move. The scores of one map are no independent trials: a unit that is off is off everywhere. An actuator
//! is therefore judged by the *median of |z|* over its grid points, not by the worst one, of which hundreds
//! of actuators times 187 points would always bring some beyond any limit.
//!
//! Limit 3.5: Iglewicz and Hoaglin, How to Detect and Handle Outliers, ASQC Quality Press 1993. For normal
//! scores, whatever their dependence, median |z| exceeds c with at most twice the probability of a single
//! |z|: half of the points must exceed it. The limit of the whole fleet is that at which this bound, added up
//! over all actuators and features, is 5 %.

use super::{Answer, answer as table, counts, falling, numbers, words};
use crate::fleet::{self, Fleet, texts};
use crate::{Table, stats};
use anyhow::Result;
use polars::prelude::*;
use rayon::prelude::*;
use schemas::feature::Feature;
use std::collections::HashMap;
use std::path::Path;

/// Score from which an actuator is flagged.
const LIMIT: f64 = 3.5;
/// With fewer actuators at a grid point there is no family.
const LEAST: usize = 5;
/// A MAD below this share of the median is rounding, not spread.
const ROUNDING: f64 = 1e-9;

pub fn reads(dir: &Path) -> Result<Vec<LazyFrame>> {
    let names = Table::Actuators
        .scan(dir)?
        .select([col("actuator"), col("tail"), col("position")]);
    Ok(vec![
        fleet::read(dir, &Feature::ALL.map(Feature::key), true, false)?,
        names,
    ])
}

/// An actuator and feature.
struct Row {
    feature: usize,
    actuator: usize,
    median: f64,
    worst: f64,
    /// Point and value where it is worst, and the fleet's median there.
    at: (usize, f64, f64),
    points: usize,
    beyond: usize,
}

/// Scores of one feature, and how many grid points have no scale.
fn scores(fleet: &Fleet, feature: usize, points: &fleet::Groups, actuators: &fleet::Groups) -> (Vec<Row>, usize) {
    let values = &fleet.values[feature];
    let mut grouped = points.gather(values).into_owned();
    // (median, 1 / (1.4826 MAD)) of the fleet; NaN without a scale
    let family: Vec<(f64, f64)> = (0..points.count())
        .map(|g| {
            let values = stats::numbers(&mut grouped[points.of(g)]);
            if values.len() < LEAST {
                return (f64::NAN, f64::NAN);
            }
            let median = stats::median(values);
            values.iter_mut().for_each(|v| *v = (*v - median).abs());
            let mad = stats::median(values);
            if mad <= ROUNDING * median.abs() {
                return (median, f64::NAN);
            }
            (median, 1.0 / (stats::MAD_TO_SIGMA * mad))
        })
        .collect();
    let unscaled = family.iter().filter(|f| f.1.is_nan()).count();
    let (values, point) = (actuators.gather(values), actuators.gather(&fleet.point));
    let mut sizes = Vec::new();
    let mut rows = Vec::new();
    for actuator in 0..actuators.count() {
        let mut worst = (f64::NEG_INFINITY, 0, 0.0);
        let mut beyond = 0;
        sizes.clear();
        for i in actuators.of(actuator) {
            let (median, scale) = family[point[i] as usize];
            let z = (values[i] - median).abs() * scale;
            if z.is_nan() {
                continue;
            }
            sizes.push(z);
            beyond += usize::from(z > LIMIT);
            if z > worst.0 {
                worst = (z, point[i], values[i]);
            }
        }
        if !sizes.is_empty() {
            rows.push(Row {
                feature,
                actuator,
                points: sizes.len(),
                median: stats::median(&mut sizes),
                worst: worst.0,
                at: (worst.1 as usize, worst.2, family[worst.1 as usize].0),
                beyond,
            });
        }
    }
    (rows, unscaled)
}

/// One row an actuator and feature, the greatest `median_abs_z` first.
pub fn answer(dir: &Path, frames: &[DataFrame]) -> Result<Answer> {
    let fleet = Fleet::new(&frames[0], &Feature::ALL.map(Feature::key), dir)?;
    let (points, actuators) = (fleet.by_point(), fleet.by_actuator());
    let found: Vec<(Vec<Row>, usize)> = (0..Feature::ALL.len())
        .into_par_iter()
        .map(|k| scores(&fleet, k, &points, &actuators))
        .collect();
    let mut notes = Vec::new();
    for (feature, (_, unscaled)) in Feature::ALL.iter().zip(&found) {
        if *unscaled > 0 {
            notes.push(format!(
                "{}: {unscaled} of {} grid points left out: fewer than {LEAST} actuators, or more than half of them \
                 agree to the last digits",
                feature.name(),
                fleet.points.len()
            ));
        }
    }
    let mut rows: Vec<Row> = found.into_iter().flat_map(|f| f.0).collect();
    rows.sort_by(|a, b| falling(a.median, b.median).then(falling(a.worst, b.worst)));
    let limit = stats::normal_beyond(0.05 / (4.0 * rows.len().max(1) as f64)).max(LIMIT);
    notes.push(format!(
        "flagged: median_abs_z > {LIMIT}; flagged_in_fleet: > {limit:.2}, which {} actuators and features of one \
         family exceed anywhere with less than 5 % probability",
        rows.len()
    ));
    let [tails, positions] = labels(dir, &frames[1], &fleet.actuators)?;
    let point = |r: &Row| &fleet.points[r.at.0];
    let column = |name, f: fn(&Row) -> f64| numbers(name, rows.iter().map(f));
    let flag = |name: &str, limit: f64| {
        let flags: Vec<bool> = rows.iter().map(|r| r.median > limit).collect();
        Column::new(name.into(), flags)
    };
    table(
        vec![
            words("actuator", rows.iter().map(|r| fleet.actuators[r.actuator].as_str())),
            words("tail", rows.iter().map(|r| tails[r.actuator].as_str())),
            words("position", rows.iter().map(|r| positions[r.actuator].as_str())),
            words("feature", rows.iter().map(|r| Feature::ALL[r.feature].name())),
            column("median_abs_z", |r| r.median),
            flag("flagged", LIMIT),
            flag("flagged_in_fleet", limit),
            counts("points", rows.iter().map(|r| r.points)),
            column("share_beyond", |r| r.beyond as f64 / r.points as f64),
            column("worst_abs_z", |r| r.worst),
            words("worst_sequence", rows.iter().map(|r| point(r).sequence.as_str())),
            numbers("worst_rest_angle_rad", rows.iter().map(|r| point(r).rest_angle_rad)),
            numbers("worst_fsj", rows.iter().map(|r| point(r).fsj)),
            numbers("worst_zeta", rows.iter().map(|r| point(r).zeta)),
            column("value_there", |r| r.at.1),
            column("fleet_median_there", |r| r.at.2),
            words("unit", rows.iter().map(|r| Feature::ALL[r.feature].unit())),
        ],
        notes,
    )
}

/// Tails and positions of the actuators from the table of actuators; empty where it lacks one.
fn labels(dir: &Path, frame: &DataFrame, actuators: &[String]) -> Result<[Vec<String>; 2]> {
    let (names, name) = texts(frame, "actuator", dir)?;
    let row: HashMap<&str, usize> = name
        .iter()
        .enumerate()
        .map(|(i, &n)| (names[n as usize].as_str(), i))
        .collect();
    let of = |column: &str| -> Result<Vec<String>> {
        let (words, word) = texts(frame, column, dir)?;
        let find = |a: &String| row.get(a.as_str()).map(|&i| words[word[i] as usize].clone());
        Ok(actuators.iter().map(|a| find(a).unwrap_or_default()).collect())
    };
    Ok([of("tail")?, of("position")?])
}
