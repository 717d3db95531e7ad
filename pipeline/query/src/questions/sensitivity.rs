//! How far each feature moves with each fault, by region of the fault plane.

use super::{Answer, answer as table, counts, numbers, region, words};
use crate::fleet::{self, Fleet, Groups};
use crate::stats;
use anyhow::Result;
use polars::prelude::*;
use rayon::prelude::*;
use schemas::feature::{Feature, Form, Raw, RawFeatures};
use std::path::Path;

/// Width of the fault plane along FSJ and zeta, by which both effects are compared.
const WIDTH: [f64; 2] = [4.0, 0.5];

/// The features, and what their standard deviations are formed from.
fn columns() -> Vec<&'static str> {
    let mut names = Feature::ALL.map(Feature::key).to_vec();
    let more = Raw::locating().flat_map(|r| [r.column(), r.deviation()]);
    // some features are raw ones
    names.extend(more.filter(|n| !Feature::ALL.iter().any(|f| f.key() == *n)));
    names
}

pub fn reads(dir: &Path) -> Result<Vec<LazyFrame>> {
    Ok(vec![fleet::read(dir, &columns(), true, false)?])
}

/// Measured standard deviation of a feature by row of the columns that [`reads`] names; NaN where it is not known.
fn deviation(feature: Feature, columns: &[Vec<f64>]) -> impl FnMut(usize) -> f64 {
    let names = self::columns();
    let column = |name: &str| &columns[names.iter().position(|n| *n == name).expect("one of the columns")];
    // the feature by which the nominal run is known
    let tells = |raw| move |f: &Feature| [Form::Ratio(raw), Form::Loss(raw)].contains(&f.form());
    let one = |raw: Raw| {
        let over = Feature::ALL.into_iter().find(tells(raw));
        let over = over.map(|f| (f.form(), column(f.key())));
        (raw, column(raw.column()), column(raw.deviation()), over)
    };
    let formed_from: Vec<_> = feature.form().raws().map(one).collect();
    let [mut raw, mut sd, mut nominal] = [RawFeatures::default(); 3];
    move |i| {
        for &(r, values, deviations, over) in &formed_from {
            (raw[r], sd[r]) = (Some(values[i]), Some(deviations[i]));
            nominal[r] = over.and_then(|(form, x)| form.nominal(values[i], x[i]));
        }
        feature.deviation(&raw, &sd, &nominal)
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

fn cells(fleet: &Fleet, place: usize, steps: &[Step], actuators: &Groups) -> Cells {
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
    let mut deviation = deviation(Feature::ALL[place], &fleet.values);
    for (i, &p) in fleet.point.iter().enumerate() {
        let sd = deviation(i);
        if let (Some(cell), false) = (home[p as usize], sd.is_nan()) {
            out.squares[cell].0 += sd * sd;
            out.squares[cell].1 += 1;
        }
    }
    let values = actuators.gather(&fleet.values[place]);
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
    let all: Vec<Cells> = (0..Feature::ALL.len())
        .into_par_iter()
        .map(|k| cells(&fleet, k, &steps, &actuators))
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
