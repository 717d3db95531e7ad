//! How far each feature moves with each fault, by region of the fault plane.

use super::{Answer, answer as table, counts, numbers, region, words};
use crate::fleet::{self, Fleet, Groups};
use crate::stats;
use anyhow::Result;
use polars::prelude::*;
use rayon::prelude::*;
use schemas::feature::Feature;
use std::path::Path;

/// Columns beside the seven features: what their standard deviations are formed from.
const MORE: [&str; 7] = [
    "p3_rad",
    "mean_speed_sd_rad_per_s",
    "ripple_sd_rad_per_s",
    "p2_sd_a",
    "p3_sd_rad",
    "rise_sd_s",
    "current_rms_sd_a",
];

/// Width of the fault plane along FSJ and zeta, by which both effects are compared.
const WIDTH: [f64; 2] = [4.0, 0.5];

fn columns() -> Vec<&'static str> {
    Feature::ALL.iter().map(|f| f.key()).chain(MORE).collect()
}

pub fn reads(dir: &Path) -> Result<Vec<LazyFrame>> {
    Ok(vec![fleet::read(dir, &columns(), true, false)?])
}

/// Measured standard deviation of a feature in row `i` of the columns that [`reads`] names.
fn deviation(columns: &[Vec<f64>], feature: Feature, i: usize) -> f64 {
    let value = |f: Feature| columns[f as usize][i];
    let more = |k: usize| columns[Feature::ALL.len() + k][i];
    match feature {
        // P1^2 = speed loss^2 + ripple^2
        Feature::P1 => {
            let squares = (value(Feature::Ripple) * more(2)).hypot(value(Feature::SpeedLoss) * more(1));
            squares / value(Feature::P1).abs().max(1e-12)
        }
        Feature::P2 => more(3),
        // P3 is p3_rad over that of the healthy run
        Feature::P3 => more(4) * value(Feature::P3) / more(0),
        Feature::Ripple => more(2),
        Feature::SpeedLoss => more(1),
        Feature::Rise => more(5),
        Feature::CurrentRms => more(6),
        _ => f64::NAN,
    }
}

/// Two neighbouring grid points.
struct Step {
    from: usize,
    to: usize,
    /// 1 / difference of the fault.
    per: f64,
    /// 0: along FSJ, 1: along zeta.
    fault: usize,
    /// Plane and region of the middle.
    cell: usize,
}

fn cell(plane: usize, region: usize) -> usize {
    plane * region::COUNT + region
}

/// All steps of all planes.
fn steps(fleet: &Fleet) -> Vec<Step> {
    let mut steps = Vec::new();
    for (plane, range) in fleet.planes.iter().enumerate() {
        let at = |i: usize| (fleet.points[i].fsj, fleet.points[i].zeta);
        for fault in 0..2 {
            // lines along the fault: sorted by the other one, then by this one
            let key = |i: usize| if fault == 0 { (at(i).1, at(i).0) } else { at(i) };
            let mut line: Vec<usize> = range.clone().collect();
            line.sort_by(|&a, &b| key(a).0.total_cmp(&key(b).0).then(key(a).1.total_cmp(&key(b).1)));
            for pair in line.windows(2) {
                let (from, to) = (pair[0], pair[1]);
                let (a, b) = (at(from), at(to));
                let width = key(to).1 - key(from).1;
                let middle = region::of(0.5 * (a.0 + b.0), 0.5 * (a.1 + b.1));
                if let Some(region) = middle.filter(|_| key(from).0 == key(to).0 && width > 0.0) {
                    steps.push(Step {
                        from,
                        to,
                        per: 1.0 / width,
                        fault,
                        cell: cell(plane, region),
                    });
                }
            }
        }
    }
    steps
}

/// Mean slope of every actuator, and the pooled standard deviation, in every cell.
struct Cells {
    /// Per cell and fault: one mean slope an actuator.
    slopes: Vec<[Vec<f64>; 2]>,
    /// Per cell: sum of squares and number of the standard deviations.
    squares: Vec<(f64, usize)>,
}

fn cells(fleet: &Fleet, feature: Feature, steps: &[Step], actuators: &Groups) -> Cells {
    let count = fleet.planes.len() * region::COUNT;
    let mut out = Cells {
        slopes: vec![Default::default(); count],
        squares: vec![(0.0, 0); count],
    };
    let mut home = vec![None; fleet.points.len()];
    for (plane, range) in fleet.planes.iter().enumerate() {
        for i in range.clone() {
            home[i] = region::of(fleet.points[i].fsj, fleet.points[i].zeta).map(|r| cell(plane, r));
        }
    }
    for (i, &p) in fleet.point.iter().enumerate() {
        let sd = deviation(&fleet.values, feature, i);
        if let (Some(cell), false) = (home[p as usize], sd.is_nan()) {
            out.squares[cell].0 += sd * sd;
            out.squares[cell].1 += 1;
        }
    }
    let values = actuators.gather(&fleet.values[feature as usize]);
    let points = actuators.gather(&fleet.point);
    let mut map = vec![f64::NAN; fleet.points.len()];
    let mut sums = vec![[(0.0, 0u32); 2]; count];
    for actuator in 0..actuators.count() {
        map.fill(f64::NAN);
        for i in actuators.of(actuator) {
            map[points[i] as usize] = values[i];
        }
        sums.fill([(0.0, 0); 2]);
        for s in steps {
            let slope = (map[s.to] - map[s.from]) * s.per;
            if !slope.is_nan() {
                let sum = &mut sums[s.cell][s.fault];
                *sum = (sum.0 + slope, sum.1 + 1);
            }
        }
        for (slopes, sums) in out.slopes.iter_mut().zip(&sums) {
            for fault in 0..2 {
                if sums[fault].1 > 0 {
                    slopes[fault].push(sums[fault].0 / sums[fault].1 as f64);
                }
            }
        }
    }
    out
}

/// One row a feature, sequence, rest angle and region. `unit` is that of the feature; the slopes are per 1 of
/// FSJ and per 1 of zeta. `_sd` of a slope is its spread over the actuators; `_in_noise` is the slope over the
/// measured standard deviation `noise` of the feature. `fsj_share` is 1 where the feature tells friction only
/// and 0 where it tells eccentricity only, both faults taken over their whole width.
pub fn answer(dir: &Path, frames: &[DataFrame]) -> Result<Answer> {
    let fleet = Fleet::new(&frames[0], &columns(), dir)?;
    let steps = steps(&fleet);
    let actuators = fleet.by_actuator();
    let all: Vec<Cells> = Feature::ALL
        .par_iter()
        .map(|&f| cells(&fleet, f, &steps, &actuators))
        .collect();
    let mut rows: Vec<(Feature, usize, [f64; 9])> = Vec::new();
    let mut regions: Vec<usize> = Vec::new();
    for (&feature, cells) in Feature::ALL.iter().zip(&all) {
        for (c, slopes) in cells.slopes.iter().enumerate() {
            let [(f, f_sd), (z, z_sd)] = [0, 1].map(|k| stats::mean_sd(&slopes[k]));
            let n = slopes[0].len().max(slopes[1].len());
            if n == 0 {
                continue;
            }
            let (squares, measured) = cells.squares[c];
            // without sensor noise there is none to compare with
            let noise = Some((squares / measured as f64).sqrt())
                .filter(|&sd| sd > 0.0)
                .unwrap_or(f64::NAN);
            let (across_f, across_z) = (f.abs() * WIDTH[0], z.abs() * WIDTH[1]);
            let share = across_f / (across_f + across_z);
            rows.push((
                feature,
                c / region::COUNT,
                [n as f64, f, f_sd, z, z_sd, noise, f / noise, z / noise, share],
            ));
            regions.push(c % region::COUNT);
        }
    }
    let column = |name, k: usize| numbers(name, rows.iter().map(|r| r.2[k]));
    let point = |plane: usize| &fleet.points[fleet.planes[plane].start];
    let mut out = vec![
        words("feature", rows.iter().map(|r| r.0.name())),
        words("unit", rows.iter().map(|r| r.0.unit())),
        words("sequence", rows.iter().map(|r| point(r.1).sequence.as_str())),
        numbers("rest_angle_rad", rows.iter().map(|r| point(r.1).rest_angle_rad)),
    ];
    out.extend(region::columns(&regions));
    out.extend([
        counts("actuators", rows.iter().map(|r| r.2[0] as usize)),
        column("per_fsj", 1),
        column("per_fsj_sd", 2),
        column("per_zeta", 3),
        column("per_zeta_sd", 4),
        column("noise", 5),
        column("per_fsj_in_noise", 6),
        column("per_zeta_in_noise", 7),
        column("fsj_share", 8),
    ]);
    table(out, Vec::new())
}
