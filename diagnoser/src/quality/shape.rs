//! One map by itself: its shape, its slopes, its grid.

use super::{MOST_INTERPOLATION, median};
use crate::diagnosis::Diagnoser;
use crate::failure_map::{FailureMap, root_mean_square, smoothness};
use schemas::feature::Feature;

/// Something for each of the two faults.
#[derive(Clone, Debug, PartialEq)]
pub struct PerFault<T> {
    /// along FSJ
    pub fsj: T,
    /// along zeta
    pub zeta: T,
}

/// Where a simulated map goes the wrong way between two grid points on one line of the grid.
#[derive(Clone, Debug, PartialEq)]
pub struct Break {
    /// in the feature's unit
    pub value: f64,
    /// of the map's range
    pub share: f64,
    /// (FSJ, zeta)
    pub from: (f64, f64),
    /// the next grid point on the line (FSJ, zeta)
    pub to: (f64, f64),
}

/// Where two neighbouring curves lie in the wrong order deepest.
#[derive(Clone, Debug, PartialEq)]
pub struct Crossing {
    /// in the feature's unit
    pub depth: f64,
    /// place of the greatest depth
    pub fsj: f64,
    /// of both curves
    pub zeta: (f64, f64),
}

/// Crossings of simulated curves of neighbouring zeta over FSJ.
#[derive(Clone, Debug, PartialEq)]
pub struct Crossings {
    /// pairs of curve segments that cross
    pub count: usize,
    /// none where no curves cross
    pub deepest: Option<Crossing>,
}

/// The shape of a map.
#[derive(Clone, Debug, PartialEq)]
pub struct MapShape {
    /// whose map it is
    pub feature: Feature,
    /// of the monotone surface
    pub range: (f64, f64),
    /// standard uncertainty of the measurement: sensors and one sample
    pub measurement: f64,
    /// greatest breaks of monotony of the simulated values; none if they are monotone
    pub broken: PerFault<Option<Break>>,
    /// share of grid cells that change by no more than one standard uncertainty of the measurement
    pub plateau: PerFault<f64>,
    /// of its curves
    pub crossings: Crossings,
}

/// Mean change of a feature over each grid cell, from one side to the other: along FSJ, along zeta.
fn changes(map: &FailureMap) -> impl Iterator<Item = (f64, f64)> {
    let n = map.fsj.len();
    (0..map.zeta.len() - 1).flat_map(move |r| {
        (0..n - 1).map(move |c| {
            let [a, b, d, e] = [0, 1, n, n + 1].map(|k| map.value[r * n + c + k]);
            (0.5 * (b - a + e - d), 0.5 * (d - a + e - b))
        })
    })
}

/// Centres of the grid cells, in the same order.
pub(super) fn centres(map: &FailureMap) -> impl Iterator<Item = (f64, f64)> {
    let middle = |w: &[f64]| 0.5 * (w[0] + w[1]);
    let rows = map.zeta.windows(2).map(middle);
    rows.flat_map(move |z| map.fsj.windows(2).map(move |w| (middle(w), z)))
}

impl MapShape {
    /// Judges the simulated values and the monotone surface made of them.
    pub fn of(map: &FailureMap) -> Self {
        let (lo, hi) = map.range();
        let (rows, columns) = (map.zeta.len(), map.fsj.len());
        let place = |i: usize| (map.fsj[i % columns], map.zeta[i / columns]);
        // the greatest fall, in the map's direction, from any point of a line to any later one
        let broken = |direction: f64, lines: usize, n: usize, at: &dyn Fn(usize, usize) -> usize| {
            let mut worst: Option<Break> = None;
            for line in 0..lines {
                let mut top = at(line, 0);
                for k in 1..n {
                    let i = at(line, k);
                    let fall = direction * (map.raw[top] - map.raw[i]);
                    if fall <= 0.0 {
                        top = i;
                    } else if worst.as_ref().is_none_or(|w| w.value < fall) {
                        worst = Some(Break {
                            value: fall,
                            share: fall / (hi - lo),
                            from: place(top),
                            to: place(i),
                        });
                    }
                }
            }
            worst
        };
        let measurement = map.budget.measurement();
        let cells = ((rows - 1) * (columns - 1)) as f64;
        let flat =
            |of: fn((f64, f64)) -> f64| changes(map).filter(|&c| of(c).abs() <= measurement).count() as f64 / cells;
        Self {
            feature: map.feature,
            range: (lo, hi),
            measurement,
            broken: PerFault {
                fsj: broken(map.direction.0, rows, columns, &|r, c| r * columns + c),
                zeta: broken(map.direction.1, columns, rows, &|c, r| r * columns + c),
            },
            plateau: PerFault {
                fsj: flat(|c| c.0),
                zeta: flat(|c| c.1),
            },
            crossings: Crossings::of(map),
        }
    }
}

impl Crossings {
    fn of(map: &FailureMap) -> Self {
        let n = map.fsj.len();
        let (mut count, mut deepest) = (0, None::<Crossing>);
        for (r, z) in map.zeta.windows(2).enumerate() {
            let ahead: Vec<f64> = (0..n)
                .map(|c| map.direction.1 * (map.raw[(r + 1) * n + c] - map.raw[r * n + c]))
                .collect();
            // touching is not crossing
            let signs: Vec<bool> = ahead.iter().filter(|d| **d != 0.0).map(|d| *d > 0.0).collect();
            let here = signs.windows(2).filter(|w| w[0] != w[1]).count();
            count += here;
            // a pair in the wrong order all along does not cross: that is a break along zeta
            for (c, d) in ahead.iter().enumerate().filter(|_| here > 0) {
                if -d > deepest.as_ref().map_or(0.0, |x| x.depth) {
                    deepest = Some(Crossing {
                        depth: -d,
                        fsj: map.fsj[c],
                        zeta: (z[0], z[1]),
                    });
                }
            }
        }
        Self { count, deepest }
    }
}

/// Slopes of a map towards one fault.
#[derive(Clone, Debug, PartialEq)]
pub struct Steepness {
    /// at the middles of the quadrants: (FSJ, zeta), change in the feature's unit and in its standard
    /// uncertainties
    pub middles: [((f64, f64), f64, f64); 4],
    /// least, median and greatest size over the grid's cells, in the feature's unit
    pub own: [f64; 3],
    /// and in standard uncertainties
    pub sigmas: [f64; 3],
}

/// How much a feature tells of each fault: its change for 1 % of FSJ and for 0.01 of zeta.
#[derive(Clone, Debug, PartialEq)]
pub struct Sensitivity {
    /// whose map it is
    pub feature: Feature,
    /// for 1 % of FSJ, for 0.01 of zeta
    pub steepness: PerFault<Steepness>,
}

/// Steps that slopes are stated for.
const PERCENT: f64 = 0.01;
const HUNDREDTH: f64 = 0.01;

impl Sensitivity {
    /// Slopes of a map by central differences, against the diagnosis' uncertainty of the feature.
    pub fn of(diagnoser: &Diagnoser, map: &FailureMap) -> Self {
        let (nf, nz) = (map.fsj.len(), map.zeta.len());
        let uncertainty = |(f, z): (f64, f64)| diagnoser.uncertainty(map.feature, f, z).unwrap_or(f64::NAN);
        let along = |x: &[f64], quarters: f64| x[0] + 0.25 * quarters * (x[x.len() - 1] - x[0]);
        let middles: [(f64, f64); 4] = std::array::from_fn(|q| {
            let quarters = |upper: usize| if upper == 0 { 1.0 } else { 3.0 };
            (along(&map.fsj, quarters(q % 2)), along(&map.zeta, quarters(q / 2)))
        });
        // differences over the width of one cell, as elsewhere
        let (df, dz) = (
            0.5 * (map.fsj[nf - 1] - map.fsj[0]) / (nf - 1) as f64,
            0.5 * (map.zeta[nz - 1] - map.zeta[0]) / (nz - 1) as f64,
        );
        let by_fsj = |(f, z): (f64, f64)| (map.at(f + df, z) - map.at(f - df, z)) / (2.0 * df) * PERCENT * f;
        let by_zeta = |(f, z): (f64, f64)| (map.at(f, z + dz) - map.at(f, z - dz)) / (2.0 * dz) * HUNDREDTH;
        let sizes = map
            .zeta
            .windows(2)
            .flat_map(|z| map.fsj.windows(2).map(move |f| (f[1] - f[0], z[1] - z[0])));
        let cells: Vec<((f64, f64), (f64, f64))> = changes(map)
            .zip(sizes)
            .zip(centres(map))
            .map(|(((a, b), (df, dz)), at)| (at, (a / df * PERCENT * at.0, b / dz * HUNDREDTH)))
            .collect();
        let steep = |at: &dyn Fn((f64, f64)) -> f64, of: fn(&(f64, f64)) -> f64| {
            let own = cells.iter().map(|(_, c)| of(c).abs()).collect();
            let sigmas = cells.iter().map(|(p, c)| of(c).abs() / uncertainty(*p)).collect();
            Steepness {
                middles: middles.map(|p| (p, at(p), at(p) / uncertainty(p))),
                own: ends_and_median(own),
                sigmas: ends_and_median(sigmas),
            }
        };
        Self {
            feature: map.feature,
            steepness: PerFault {
                fsj: steep(&by_fsj, |c| c.0),
                zeta: steep(&by_zeta, |c| c.1),
            },
        }
    }
}

/// Least, median, greatest.
fn ends_and_median(v: Vec<f64>) -> [f64; 3] {
    let least = v.iter().copied().fold(f64::INFINITY, f64::min);
    let most = v.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    [least, median(v), most]
}

/// Whether the grid of a map is fine enough. Root mean squares over the grid, in the feature's unit.
#[derive(Clone, Debug, PartialEq)]
pub struct Convergence {
    /// whose map it is
    pub feature: Feature,
    /// standard uncertainty of the measurement: sensors and one sample
    pub measurement: f64,
    /// leave-one-out errors on the grid and on every second line of it
    pub fine: f64,
    /// on every second line
    pub coarse: f64,
    /// estimated interpolation error of this grid, and of one twice as fine
    pub interpolation: f64,
    /// of a grid twice as fine
    pub finer: f64,
    /// median over cells of the interpolation error's share of the feature's standard uncertainty, the
    /// unit's spread included
    pub of_whole: f64,
}

/// Variance of the interpolation at a grid point: what of the map's error is not projection.
pub(super) fn interpolation_variance(error: f64, residual: f64) -> f64 {
    (error * error - residual * residual).max(0.0)
}

impl Convergence {
    /// Judges the grid by leave-one-out errors, on it and on every second line of it.
    pub fn of(diagnoser: &Diagnoser, map: &FailureMap) -> Self {
        let (fine, coarse) = (map.leave_one_out(1), map.leave_one_out(2));
        let mean = |v: &[f64]| root_mean_square(v.iter().copied().filter(|e| *e > 0.0));
        let points = map.error.iter().zip(&map.residual);
        let interpolation = root_mean_square(points.map(|(e, r)| interpolation_variance(*e, *r).sqrt()));
        let share = |(f, z): (f64, f64)| {
            let u = diagnoser.uncertainty(map.feature, f, z).unwrap_or(f64::NAN);
            map.error_at(f, z).min(u) / u
        };
        Self {
            feature: map.feature,
            measurement: map.budget.measurement(),
            interpolation,
            finer: smoothness(&fine, &coarse) * interpolation,
            fine: mean(&fine),
            coarse: mean(&coarse),
            of_whole: median(centres(map).map(share).collect()),
        }
    }

    /// Error on the grid over that on every second line: about 1/4 or less where the map is smooth against
    /// the grid, about 1 where its values scatter.
    pub fn ratio(&self) -> f64 {
        self.fine / self.coarse
    }

    /// The error of interpolation is below [`MOST_INTERPOLATION`] of the measurement's.
    pub fn fine_enough(&self) -> bool {
        self.interpolation <= MOST_INTERPOLATION * self.measurement
    }

    /// The same of a grid twice as fine.
    pub fn finer_enough(&self) -> bool {
        self.finer <= MOST_INTERPOLATION * self.measurement
    }
}
