//! How far maps have moved from one dataset to another.

use super::{Answer, answer as table, counts, falling, numbers, words};
use crate::Table;
use crate::fleet::{self, Fleet, Groups};
use crate::stats;
use anyhow::Result;
use polars::prelude::*;
use rayon::prelude::*;
use schemas::feature::Feature;
use std::collections::HashMap;
use std::path::Path;

fn columns() -> Vec<&'static str> {
    Feature::ALL.iter().map(|f| f.key()).collect()
}

pub fn reads(dir: &Path, other: &Path) -> Result<Vec<LazyFrame>> {
    if !Table::Features.there(other) {
        return Err(Table::Features.missing(other).into());
    }
    let read = |dir| fleet::read(dir, &columns(), true, false);
    Ok(vec![read(dir)?, read(other)?])
}

/// One map in both datasets.
struct Row {
    actuator: usize,
    plane: usize,
    feature: usize,
    points: usize,
    range: f64,
    median: f64,
    greatest: f64,
    /// Point of the first dataset where it is greatest, and the signed difference there.
    at: (usize, f64),
}

/// A fleet with its rows by actuator.
struct Side {
    fleet: Fleet,
    groups: Groups,
    /// Points in the order of the groups.
    point: Vec<u32>,
}

impl Side {
    fn new(frame: &DataFrame, dir: &Path) -> Result<Self> {
        let fleet = Fleet::new(frame, &columns(), dir)?;
        let groups = fleet.by_actuator();
        let point = groups.gather(&fleet.point).into_owned();
        Ok(Self { fleet, groups, point })
    }
}

/// Drift of one feature in all maps of the actuators in `both` (number in the first, in the second).
///
/// * `twin` number in the first dataset of each point of the second
fn drift(feature: usize, first: &Side, second: &Side, both: &[(usize, usize)], twin: &[Option<u32>]) -> Vec<Row> {
    let [a, b] = [first, second].map(|s| s.groups.gather(&s.fleet.values[feature]));
    let points = &first.fleet.points;
    let mut plane_of = vec![0; points.len()];
    for (k, range) in first.fleet.planes.iter().enumerate() {
        plane_of[range.clone()].fill(k);
    }
    let mut other = vec![f64::NAN; points.len()];
    let mut per_plane: Vec<Vec<(usize, f64, f64)>> = vec![Vec::new(); first.fleet.planes.len()];
    let mut rows = Vec::new();
    let mut sizes = Vec::new();
    for &(actuator, there) in both {
        other.fill(f64::NAN);
        for i in second.groups.of(there) {
            if let Some(p) = twin[second.point[i] as usize] {
                other[p as usize] = b[i];
            }
        }
        per_plane.iter_mut().for_each(Vec::clear);
        for i in first.groups.of(actuator).filter(|&i| !a[i].is_nan()) {
            let p = first.point[i] as usize;
            per_plane[plane_of[p]].push((p, a[i], other[p] - a[i]));
        }
        for (plane, values) in per_plane.iter().enumerate() {
            let (mut lo, mut hi) = (f64::INFINITY, f64::NEG_INFINITY);
            let mut at = (0, f64::NAN);
            sizes.clear();
            for &(p, value, d) in values {
                (lo, hi) = (lo.min(value), hi.max(value));
                if !d.is_nan() {
                    sizes.push(d.abs());
                    if at.1.is_nan() || d.abs() > f64::abs(at.1) {
                        at = (p, d);
                    }
                }
            }
            if !sizes.is_empty() {
                let range = Some(hi - lo).filter(|&r| r > 0.0).unwrap_or(f64::NAN);
                rows.push(Row {
                    actuator,
                    plane,
                    feature,
                    points: sizes.len(),
                    range,
                    median: stats::median(&mut sizes) / range,
                    greatest: at.1.abs() / range,
                    at,
                });
            }
        }
    }
    rows
}

/// One row an actuator, sequence, rest angle and feature, the greatest drift first; then one row an actuator
/// that only one of the datasets has.
///
/// `median_drift` and `greatest_drift` are |second - first| over `range`, the greatest less the least value of
/// that map in the first dataset. `points` are those that both datasets have.
pub fn answer(dir: &Path, other: &Path, frames: &[DataFrame]) -> Result<Answer> {
    let (first, second) = rayon::join(|| Side::new(&frames[0], dir), || Side::new(&frames[1], other));
    let (first, second) = (first?, second?);
    let names = |s: &Side| -> HashMap<String, usize> {
        s.fleet
            .actuators
            .iter()
            .cloned()
            .enumerate()
            .map(|(i, n)| (n, i))
            .collect()
    };
    let (in_first, in_second) = (names(&first), names(&second));
    let find = |(i, n): (usize, &String)| Some((i, *in_second.get(n)?));
    let both: Vec<(usize, usize)> = first.fleet.actuators.iter().enumerate().filter_map(find).collect();
    let only = |s: &Side, there: &HashMap<String, usize>| -> Vec<String> {
        let mut names: Vec<String> = s
            .fleet
            .actuators
            .iter()
            .filter(|n| !there.contains_key(*n))
            .cloned()
            .collect();
        names.sort();
        names
    };
    let (only_first, only_second) = (only(&first, &in_second), only(&second, &in_first));
    let key = |p: &fleet::Point| (p.sequence.clone(), [p.rest_angle_rad, p.fsj, p.zeta].map(f64::to_bits));
    let place: HashMap<_, u32> = first
        .fleet
        .points
        .iter()
        .enumerate()
        .map(|(i, p)| (key(p), i as u32))
        .collect();
    let twin: Vec<Option<u32>> = second
        .fleet
        .points
        .iter()
        .map(|p| place.get(&key(p)).copied())
        .collect();
    let shared = twin.iter().flatten().count();
    let mut notes = vec![format!(
        "{} actuators in both datasets, {} only in the first, {} only in the second",
        both.len(),
        only_first.len(),
        only_second.len()
    )];
    if (shared, shared) != (first.fleet.points.len(), second.fleet.points.len()) {
        notes.push(format!(
            "{shared} grid points in both datasets, {} only in the first, {} only in the second",
            first.fleet.points.len() - shared,
            second.fleet.points.len() - shared
        ));
    }
    let mut rows: Vec<Row> = (0..Feature::ALL.len())
        .into_par_iter()
        .flat_map_iter(|f| drift(f, &first, &second, &both, &twin))
        .collect();
    rows.sort_by(|a, b| falling(a.greatest, b.greatest).then(falling(a.median, b.median)));
    let tail: Vec<(&str, &str)> = only_first
        .iter()
        .map(|n| (n.as_str(), "first only"))
        .chain(only_second.iter().map(|n| (n.as_str(), "second only")))
        .collect();
    let point = |r: &Row| &first.fleet.points[r.at.0];
    let plane = |r: &Row| &first.fleet.points[first.fleet.planes[r.plane].start];
    let none = || tail.iter().map(|_| f64::NAN);
    let blank = || tail.iter().map(|_| "");
    let column = |name, f: &dyn Fn(&Row) -> f64| numbers(name, rows.iter().map(f).chain(none()));
    let feature = |r: &Row| Feature::ALL[r.feature];
    let actuator = |r: &Row| first.fleet.actuators[r.actuator].as_str();
    table(
        vec![
            words("actuator", rows.iter().map(actuator).chain(tail.iter().map(|t| t.0))),
            words("datasets", rows.iter().map(|_| "both").chain(tail.iter().map(|t| t.1))),
            words(
                "sequence",
                rows.iter().map(|r| plane(r).sequence.as_str()).chain(blank()),
            ),
            column("rest_angle_rad", &|r| plane(r).rest_angle_rad),
            words("feature", rows.iter().map(|r| feature(r).name()).chain(blank())),
            counts("points", rows.iter().map(|r| r.points).chain(tail.iter().map(|_| 0))),
            column("median_drift", &|r| r.median),
            column("greatest_drift", &|r| r.greatest),
            column("greatest_fsj", &|r| point(r).fsj),
            column("greatest_zeta", &|r| point(r).zeta),
            column("difference_there", &|r| r.at.1),
            column("range", &|r| r.range),
            words("unit", rows.iter().map(|r| feature(r).unit()).chain(blank())),
        ],
        notes,
    )
}
