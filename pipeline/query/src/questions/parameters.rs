//! How the features of the healthy actuator follow its drawn parameters.

use super::{Answer, answer as table, counts, falling, numbers, words};
use crate::fleet::{self, Fleet, floats, texts};
use crate::{Table, stats};
use anyhow::Result;
use polars::prelude::*;
use schemas::feature::Raw;
use std::collections::HashMap;
use std::path::Path;

/// Raw features without the witnesses: over the healthy run P3 is 1 and the speed loss 0 in every actuator.
fn columns() -> Vec<&'static str> {
    Raw::locating().map(Raw::column).collect()
}

pub fn reads(dir: &Path) -> Result<Vec<LazyFrame>> {
    Ok(vec![
        fleet::read(dir, &columns(), true, true)?,
        Table::Actuators.scan(dir)?,
    ])
}

/// One row a feature and parameter that varies: `correlation`, `slope` in units of the feature per unit of the
/// parameter, `elasticity` (percent per percent, at the means), `share` of the variance that a straight line
/// explains. The strongest first.
pub fn answer(dir: &Path, frames: &[DataFrame]) -> Result<Answer> {
    let columns = columns();
    let fleet = Fleet::new(&frames[0], &columns, dir)?;
    let drawn = &frames[1];
    let (names, name) = texts(drawn, "actuator", dir)?;
    let row: HashMap<&str, usize> = name
        .iter()
        .enumerate()
        .map(|(i, &n)| (names[n as usize].as_str(), i))
        .collect();
    let place: Vec<Option<usize>> = fleet.actuators.iter().map(|a| row.get(a.as_str()).copied()).collect();
    let mut notes = Vec::new();
    let unknown = place.iter().filter(|p| p.is_none()).count();
    if unknown > 0 {
        notes.push(format!(
            "{unknown} actuators of the features are not in the table of actuators"
        ));
    }
    let numeric = |c: &&Column| c.dtype() == &DataType::Float64;
    let parameters: Vec<&str> = drawn
        .columns()
        .iter()
        .filter(numeric)
        .map(|c| c.name().as_str())
        .collect();
    let mut rows: Vec<(usize, usize, usize, [f64; 5])> = Vec::new();
    let mut constant = Vec::new();
    for (p, parameter) in parameters.iter().enumerate() {
        let values = floats(drawn, parameter, dir)?;
        let value = |row: &u32| place[*row as usize].map_or(f64::NAN, |i| values[i]);
        let x: Vec<f64> = fleet.actuator.iter().map(value).collect();
        let mean = |v: &[f64]| stats::mean_sd(v);
        let mut known: Vec<f64> = x.iter().copied().filter(|x| !x.is_nan()).collect();
        let (middle, spread) = mean(stats::numbers(&mut known));
        // NaN: fewer than two actuators
        if spread.is_nan() || spread <= 1e-12 * middle.abs() {
            constant.push(*parameter);
            continue;
        }
        for (plane, range) in fleet.planes.iter().enumerate() {
            let here: Vec<usize> = (0..x.len())
                .filter(|&i| range.contains(&(fleet.point[i] as usize)))
                .collect();
            let px: Vec<f64> = here.iter().map(|&i| x[i]).collect();
            for (f, values) in fleet.values.iter().enumerate() {
                let y: Vec<f64> = here.iter().map(|&i| values[i]).collect();
                let (n, r, slope) = stats::correlation(&px, &y);
                let mut y: Vec<f64> = y.into_iter().filter(|v| !v.is_nan()).collect();
                let elasticity = slope * middle / mean(stats::numbers(&mut y)).0;
                rows.push((plane, f, p, [n as f64, r, slope, elasticity, r * r]));
            }
        }
    }
    if !constant.is_empty() {
        notes.push(format!("the same in all actuators: {}", constant.join(", ")));
    }
    rows.sort_by(|a, b| (a.0, a.1).cmp(&(b.0, b.1)).then(falling(a.3[4], b.3[4])));
    let column = |name, k: usize| numbers(name, rows.iter().map(|r| r.3[k]));
    let point = |plane: usize| &fleet.points[fleet.planes[plane].start];
    table(
        vec![
            words("feature", rows.iter().map(|r| columns[r.1])),
            words("sequence", rows.iter().map(|r| point(r.0).sequence.as_str())),
            numbers("rest_angle_rad", rows.iter().map(|r| point(r.0).rest_angle_rad)),
            words("parameter", rows.iter().map(|r| parameters[r.2])),
            counts("n", rows.iter().map(|r| r.3[0] as usize)),
            column("correlation", 1),
            column("share", 4),
            column("slope", 2),
            column("elasticity", 3),
        ],
        notes,
    )
}
