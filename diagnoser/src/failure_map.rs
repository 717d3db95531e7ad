//! Failure maps (paper 4.1, 4.2): a feature over the fault grid as monotone curves.

mod set;

use crate::isotonic::monotone_surface;
use crate::monotone;
use crate::smooth::{Smoothed, smoothed};
use schemas::error::{Error, Result};
use schemas::feature::Feature;
use serde::{Deserialize, Serialize};
pub use set::{FailureMapSet, MapSetHeader};
use sim_worker::spread::of_uniform;

/// Largest break of monotony that is projected away, as a share of the map's range (assumed). P3
/// comes in whole samples; its limit is one sample if that is more.
const BREAK_LIMIT: f64 = 0.03;

/// Range of a map, over what sensors and one sample make of one value, up to which it is flat (assumed).
const FLAT: f64 = 3.0;

/// Half-width of the relative error of a measured supply voltage (assumed).
const SUPPLY_ACCURACY: f64 = 1e-3;

/// Leave-one-out doubles the spacing. What is left of its error at the grid's own spacing is
/// judged by doubling once more: the error of a smooth feature falls to a quarter (second order)
/// or less, that of a feature in steps not at all. No more than a quarter is believed.
const SMOOTH_SHARE: f64 = 0.25;

/// What a map is uncertain by, whatever the unit: standard uncertainties in the feature's unit.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct MapBudget {
    /// of the feature, from sensor noise, offsets and resolution
    pub noise: f64,
    /// of the map between its grid points, from leave-one-out: root mean square over the grid
    pub interpolation: f64,
    /// of the projection onto the monotone surface: root mean square over the grid
    #[serde(default)]
    pub projection: f64,
    /// one sample of the command, where the feature is a command at a sample: the whole step, not yet
    /// divided by sqrt(3)
    pub sample: f64,
}

impl MapBudget {
    /// Standard uncertainty of one measurement of the feature: sensors and, where it comes in whole samples, one
    /// sample (uniform). P3 has the latter only.
    pub fn measurement(&self) -> f64 {
        self.noise.hypot(of_uniform(self.sample))
    }
}

/// One feature over the fault grid.
#[derive(Clone, Debug, PartialEq)]
pub struct FailureMap {
    /// what it is of
    pub feature: Feature,
    /// direction along (FSJ, zeta): +1 rising, -1 falling
    pub direction: (f64, f64),
    /// lines of the grid, rising, at least two
    pub fsj: Vec<f64>,
    /// lines of the grid, rising, at least two
    pub zeta: Vec<f64>,
    /// simulated values, zeta outer, FSJ inner
    pub raw: Vec<f64>,
    /// the nearest monotone surface to what is left of them without scatter
    pub value: Vec<f64>,
    /// what it is uncertain by on the whole
    pub budget: MapBudget,
    /// what the projection changed at each grid point
    pub residual: Vec<f64>,
    /// standard uncertainty of the map at each grid point: interpolation around it and projection
    pub error: Vec<f64>,
    /// slopes of `value` across zeta
    slope: Vec<f64>,
}

/// A curve of a map at one zeta, made to rise along FSJ (multiplied by the map's direction).
#[derive(Clone, Debug)]
pub struct Curve {
    /// values at the FSJ grid points, rising
    pub y: Vec<f64>,
    /// slopes there: with the values a monotone cubic (PCHIP)
    pub d: Vec<f64>,
}

/// A curve with its band, rising: the feature of a run with these faults lies between `low` and
/// `high`, both monotone.
#[derive(Clone, Debug)]
pub struct BandCurve {
    /// lower end of the band
    pub low: Curve,
    /// upper end
    pub high: Curve,
}

/// A zeta between two grid rows.
struct Place {
    /// the row below
    row: usize,
    /// distance of the rows
    h: f64,
    /// share of it that is passed
    share: f64,
}

impl FailureMap {
    /// Checks, projects and interpolates a simulated surface.
    ///
    /// * `raw` values, zeta outer, FSJ inner
    /// * `noise` standard deviation from the sensors
    /// * `sample` the feature's step where it comes in whole samples, else 0
    /// * `direction` along (FSJ, zeta)
    ///
    /// # Errors
    /// Refuses fewer than 2 x 2 points, values that are not numbers, and breaks of monotony beyond 3 % of the range
    /// and one sample, naming the grid points.
    #[allow(clippy::too_many_arguments)] // what a map is made of
    pub fn build(
        file: &str,
        feature: Feature,
        direction: (f64, f64),
        fsj: &[f64],
        zeta: &[f64],
        raw: Vec<f64>,
        noise: f64,
        sample: f64,
    ) -> Result<Self> {
        let columns = fsj.len();
        let point = |i: usize| {
            format!(
                "{} at (FSJ {}, zeta {})",
                feature.name(),
                fsj[i % columns],
                zeta[i / columns]
            )
        };
        if columns < 2 || zeta.len() < 2 {
            let found = format!("{} x {} points", columns, zeta.len());
            return Err(Error::bad(file, "grid", found, "at least 2 x 2 points"));
        }
        if let Some(i) = raw.iter().position(|v| !v.is_finite()) {
            return Err(Error::bad(
                file,
                point(i),
                raw[i],
                "a finite number at every grid point",
            ));
        }
        let value = monotone_surface(&raw, zeta.len(), columns, direction);
        let (lo, hi) = raw.iter().fold((f64::MAX, f64::MIN), |(a, b), &v| (a.min(v), b.max(v)));
        let flat = FLAT * noise.max(sample);
        if hi - lo <= flat {
            let (place, found) = (
                format!("range of {}", feature.name()),
                format!("{:.3e} {}", hi - lo, feature.unit()),
            );
            let allowed = format!(
                "more than {flat:.3e} {}: a feature that changes with the faults (ema check)",
                feature.unit()
            );
            return Err(Error::bad(file, place, found, allowed));
        }
        let limit = (BREAK_LIMIT * (hi - lo)).max(sample);
        let broken: Vec<String> = (0..raw.len())
            .filter(|&i| (raw[i] - value[i]).abs() > limit)
            .map(|i| format!("{} off by {:.3e}", point(i), raw[i] - value[i]))
            .collect();
        if !broken.is_empty() {
            let (n, shown) = (broken.len(), broken[..broken.len().min(4)].join("; "));
            let allowed = format!("a monotone surface within {limit:.3e} {}", feature.unit());
            return Err(Error::bad(
                file,
                if n == 1 {
                    "1 grid point".to_string()
                } else {
                    format!("{n} grid points")
                },
                shown,
                allowed,
            ));
        }
        let smooth = smooth(fsj, zeta, &raw);
        let values: Vec<f64> = smooth.iter().map(|s| s.value).collect();
        let value = monotone_surface(&values, zeta.len(), columns, direction);
        let residual: Vec<f64> = values.iter().zip(&value).map(|(a, b)| (a - b).abs()).collect();
        let error = smooth.iter().zip(&residual).map(|(s, r)| s.error.hypot(*r)).collect();
        let mut map = Self {
            feature,
            direction,
            fsj: fsj.into(),
            zeta: zeta.into(),
            raw,
            value,
            budget: MapBudget {
                noise,
                interpolation: root_mean_square(smooth.iter().map(|s| s.error)),
                projection: root_mean_square(residual.iter().copied()),
                sample,
            },
            error,
            residual,
            slope: Vec::new(),
        };
        map.slope = map.slopes_across();
        Ok(map)
    }

    /// A surface that need not be monotone: what a witness should be. Faults are not located by it.
    pub fn of_witness(feature: Feature, fsj: &[f64], zeta: &[f64], raw: Vec<f64>, noise: f64) -> Option<Self> {
        if !raw.iter().all(|v| v.is_finite()) || fsj.len() < 2 || zeta.len() < 2 {
            return None;
        }
        let smooth = smooth(fsj, zeta, &raw);
        let mut map = Self {
            feature,
            direction: (1.0, 1.0),
            fsj: fsj.into(),
            zeta: zeta.into(),
            value: smooth.iter().map(|s| s.value).collect(),
            budget: MapBudget {
                noise,
                interpolation: root_mean_square(smooth.iter().map(|s| s.error)),
                projection: 0.0,
                sample: 0.0,
            },
            error: smooth.iter().map(|s| s.error).collect(),
            residual: vec![0.0; raw.len()],
            slope: Vec::new(),
            raw,
        };
        map.slope = map.slopes_across();
        Some(map)
    }

    /// The surface of what says a cause: flat, or following the faults where they load the supply.
    pub fn of_cause(feature: Feature, fsj: &[f64], zeta: &[f64], raw: Vec<f64>, noise: f64) -> Option<Self> {
        let (rows, columns) = (zeta.len(), fsj.len());
        let mut map = Self::of_witness(feature, fsj, zeta, raw, noise)?;
        map.direction = feature.direction();
        let value = monotone_surface(&map.value, rows, columns, map.direction);
        map.residual = map.value.iter().zip(&value).map(|(a, b)| (a - b).abs()).collect();
        map.error
            .iter_mut()
            .zip(&map.residual)
            .for_each(|(e, r)| *e = e.hypot(*r));
        let mean = value.iter().sum::<f64>() / value.len() as f64;
        map.budget.noise = noise.max(of_uniform(SUPPLY_ACCURACY * mean.abs()));
        map.budget.projection = root_mean_square(map.residual.iter().copied());
        map.value = value;
        map.slope = map.slopes_across();
        Some(map)
    }

    /// Value of a witness's surface at a fault pair, bilinear.
    pub fn witness_at(&self, fsj: f64, zeta: f64) -> f64 {
        self.table_at(&self.value, fsj, zeta)
    }

    /// PCHIP slopes across zeta for each FSJ column.
    fn slopes_across(&self) -> Vec<f64> {
        let (rows, columns) = (self.zeta.len(), self.fsj.len());
        let mut all = vec![0.0; self.value.len()];
        let mut y = vec![0.0; rows];
        let mut d = vec![0.0; rows];
        for c in 0..columns {
            for r in 0..rows {
                y[r] = self.value[r * columns + c];
            }
            monotone::slopes(&self.zeta, &y, &mut d);
            for r in 0..rows {
                all[r * columns + c] = d[r];
            }
        }
        all
    }

    /// Errors of the raw values when each grid point is left out in turn, see [`leave_one_out`].
    pub(crate) fn leave_one_out(&self, stride: usize) -> Vec<f64> {
        leave_one_out(&self.fsj, &self.zeta, &self.raw, stride)
    }

    /// The place of `zeta` (clamped to the map) between two rows.
    fn place(&self, zeta: f64) -> Place {
        let zeta = zeta.clamp(self.zeta[0], self.zeta[self.zeta.len() - 1]);
        let row = monotone::piece(&self.zeta, zeta);
        let h = self.zeta[row + 1] - self.zeta[row];
        let share = (zeta - self.zeta[row]) / h;
        Place { row, h, share }
    }

    /// The two rows of a table around a place.
    fn rows<'a>(&self, table: &'a [f64], place: &Place) -> (&'a [f64], &'a [f64]) {
        let n = self.fsj.len();
        table[place.row * n..(place.row + 2) * n].split_at(n)
    }

    /// Weights of the values of both rows and of their slopes in the curve, rising.
    fn weights(&self, place: &Place) -> [f64; 4] {
        let (h, s) = (place.h, place.share);
        let s1 = 1.0 - s;
        let weights = [
            s1 * s1 * (1.0 + 2.0 * s),
            s * s * (3.0 - 2.0 * s),
            s * s1 * s1 * h,
            -s * s1 * s * h,
        ];
        weights.map(|w| self.direction.0 * w)
    }

    /// Values of the curve at the FSJ grid points, rising, written to `y`.
    fn curve_knots(&self, place: &Place, y: &mut Vec<f64>) {
        let [wa, wb, da, db] = self.weights(place);
        let ((v0, v1), (d0, d1)) = (self.rows(&self.value, place), self.rows(&self.slope, place));
        let grid = v0.iter().zip(v1).zip(d0).zip(d1);
        y.clear();
        y.extend(grid.map(|(((v0, v1), d0), d1)| wa * v0 + wb * v1 + da * d0 + db * d1));
        // two monotone columns may still cross between the rows
        make_rising(y);
    }

    /// The curve over FSJ at `zeta` (clamped to the map), rising.
    pub fn curve(&self, zeta: f64) -> Curve {
        let mut y = Vec::new();
        self.curve_knots(&self.place(zeta), &mut y);
        self.through(y)
    }

    fn through(&self, y: Vec<f64>) -> Curve {
        let mut d = vec![0.0; y.len()];
        monotone::slopes(&self.fsj, &y, &mut d);
        Curve { y, d }
    }

    /// The feature on one of its curves.
    pub fn on_curve(&self, curve: &Curve, fsj: f64) -> f64 {
        self.direction.0 * monotone::at(&self.fsj, &curve.y, &curve.d, fsj)
    }

    /// The feature at a fault pair, clamped to the map.
    pub fn at(&self, fsj: f64, zeta: f64) -> f64 {
        self.on_curve(&self.curve(zeta), fsj)
    }

    /// Standard uncertainty of the feature against the map at a grid point, the unit's own spread left
    /// out: sensors, one sample, interpolation, projection.
    pub fn node_uncertainty(&self, node: usize) -> f64 {
        self.with_noise(self.error[node])
    }

    /// The same at a fault pair, bilinear between the grid points.
    pub fn uncertainty(&self, fsj: f64, zeta: f64) -> f64 {
        self.with_noise(self.table_at(&self.error, fsj, zeta))
    }

    /// Standard uncertainty of the map alone at a fault pair: interpolation and projection.
    pub fn error_at(&self, fsj: f64, zeta: f64) -> f64 {
        self.table_at(&self.error, fsj, zeta)
    }

    /// What the projection changed at a fault pair, bilinear between the grid points.
    pub fn residual_at(&self, fsj: f64, zeta: f64) -> f64 {
        self.table_at(&self.residual, fsj, zeta)
    }

    fn with_noise(&self, error: f64) -> f64 {
        let b = &self.budget;
        (error * error + b.noise * b.noise + b.sample * b.sample / 3.0).sqrt()
    }

    /// What a table over the grid holds at a fault pair, bilinear.
    fn table_at(&self, table: &[f64], fsj: f64, zeta: f64) -> f64 {
        let place = self.place(zeta);
        let c = monotone::piece(&self.fsj, fsj);
        let t = ((fsj - self.fsj[c]) / (self.fsj[c + 1] - self.fsj[c])).clamp(0.0, 1.0);
        let (below, above) = self.rows(table, &place);
        let along = |row: &[f64]| (1.0 - t) * row[c] + t * row[c + 1];
        (1.0 - place.share) * along(below) + place.share * along(above)
    }

    /// The curve at `zeta` with its band.
    ///
    /// * `half_width` of the band at each grid point, in the feature's unit
    pub fn band(&self, zeta: f64, half_width: &[f64]) -> BandCurve {
        let place = self.place(zeta);
        let mut low = Vec::new();
        self.curve_knots(&place, &mut low);
        let (below, above) = self.rows(half_width, &place);
        let half: Vec<f64> = below
            .iter()
            .zip(above)
            .map(|(a, b)| (1.0 - place.share) * a + place.share * b)
            .collect();
        let mut high: Vec<f64> = low.iter().zip(&half).map(|(y, h)| y + h).collect();
        low.iter_mut().zip(&half).for_each(|(y, h)| *y -= h);
        // made monotone by giving way outwards
        make_rising_from_end(&mut low);
        make_rising(&mut high);
        BandCurve {
            low: self.through(low),
            high: self.through(high),
        }
    }

    /// Smallest and largest value.
    pub fn range(&self) -> (f64, f64) {
        self.value
            .iter()
            .fold((f64::MAX, f64::MIN), |(a, b), &v| (a.min(v), b.max(v)))
    }

    /// A map that goes on straight beyond both ends of FSJ and the upper end of zeta by the share
    /// `by` of the range: to see on which side a measured pair lies.
    pub fn extended(&self, by: f64) -> Self {
        let (mut fsj, mut zeta) = (self.fsj.clone(), self.zeta.clone());
        let (nf, nz) = (fsj.len(), zeta.len());
        let (df, dz) = (by * (fsj[nf - 1] - fsj[0]), by * (zeta[nz - 1] - zeta[0]));
        let line = |x0: f64, y0: f64, x1: f64, y1: f64, x: f64| y1 + (y1 - y0) / (x1 - x0) * (x - x1);
        let low = (fsj[0] - df).max(0.0);
        let mut value = Vec::new();
        for row in self.value.chunks(nf) {
            value.push(line(fsj[1], row[1], fsj[0], row[0], low));
            value.extend_from_slice(row);
            value.push(line(
                fsj[nf - 2],
                row[nf - 2],
                fsj[nf - 1],
                row[nf - 1],
                fsj[nf - 1] + df,
            ));
        }
        let high = fsj[nf - 1] + df;
        fsj.insert(0, low);
        fsj.push(high);
        let n = fsj.len();
        let above: Vec<f64> = (0..n)
            .map(|c| {
                let (a, b) = (value[(nz - 2) * n + c], value[(nz - 1) * n + c]);
                line(zeta[nz - 2], a, zeta[nz - 1], b, zeta[nz - 1] + dz)
            })
            .collect();
        value.extend(above);
        zeta.push(zeta[nz - 1] + dz);
        let wider = |v: &[f64]| -> Vec<f64> {
            let mut w: Vec<f64> = v
                .chunks(nf)
                .flat_map(|row| [&row[..1], row, &row[nf - 1..]].concat())
                .collect();
            let last = w[(nz - 1) * n..].to_vec();
            w.extend(last);
            w
        };
        let mut map = Self {
            fsj,
            zeta,
            raw: value.clone(),
            value,
            residual: wider(&self.residual),
            error: wider(&self.error),
            slope: Vec::new(),
            budget: self.budget.clone(),
            ..*self
        };
        map.slope = map.slopes_across();
        map
    }
}

/// What halving the spacing leaves of an interpolation error, judged by leave-one-out errors on the grid
/// and on every second line of it: [`SMOOTH_SHARE`] (smooth) to 1 (scatter).
pub(crate) fn smoothness(fine: &[f64], coarse: &[f64]) -> f64 {
    let quantile = |v: &[f64], q: f64| {
        let mut v: Vec<f64> = v.iter().copied().filter(|e| *e > 0.0).collect();
        v.sort_by(f64::total_cmp);
        v.get((v.len().saturating_sub(1) as f64 * q).round() as usize)
            .copied()
            .unwrap_or(0.0)
    };
    // the greatest errors may be curvature, which falls with the spacing, and the usual ones
    // scatter of the switching, which does not: the worse of both is believed
    let ratio = |q: f64| {
        let (fine, coarse) = (quantile(fine, q), quantile(coarse, q));
        if coarse > 0.0 {
            (fine / coarse).clamp(SMOOTH_SHARE, 1.0)
        } else {
            1.0
        }
    };
    ratio(0.95).max(ratio(0.5))
}

/// What the grid points become, and how well they predict a test between them.
fn smooth(fsj: &[f64], zeta: &[f64], raw: &[f64]) -> Vec<Smoothed> {
    let (fine, coarse) = (leave_one_out(fsj, zeta, raw, 1), leave_one_out(fsj, zeta, raw, 2));
    // brought to the grid's own spacing
    let share = smoothness(&fine, &coarse);
    let own: Vec<f64> = fine.iter().map(|e| share * e).collect();
    smoothed(fsj, zeta, raw, &own)
}

/// Errors at the grid points when each is left out in turn, along FSJ and along zeta, the larger
/// of the two; 0 at the rim. `stride` 2 uses every second line and point.
fn leave_one_out(fsj: &[f64], zeta: &[f64], raw: &[f64], stride: usize) -> Vec<f64> {
    let (rows, columns) = (zeta.len(), fsj.len());
    let mut out = vec![0.0_f64; raw.len()];
    let mut line = |x: &[f64], index: &dyn Fn(usize) -> usize| {
        let kept: Vec<usize> = (0..x.len()).step_by(stride).collect();
        for at in 1..kept.len().max(1) - 1 {
            let others: Vec<usize> = kept.iter().copied().filter(|&k| k != kept[at]).collect();
            if others.len() < 2 {
                continue;
            }
            let xs: Vec<f64> = others.iter().map(|&k| x[k]).collect();
            let ys: Vec<f64> = others.iter().map(|&k| raw[index(k)]).collect();
            let mut d = vec![0.0; xs.len()];
            monotone::slopes(&xs, &ys, &mut d);
            let i = index(kept[at]);
            out[i] = out[i].max((monotone::at(&xs, &ys, &d, x[kept[at]]) - raw[i]).abs());
        }
    };
    for r in (0..rows).step_by(stride) {
        line(fsj, &|k| r * columns + k);
    }
    for c in (0..columns).step_by(stride) {
        line(zeta, &|k| k * columns + c);
    }
    out
}

/// 0 of nothing.
pub(crate) fn root_mean_square(values: impl Iterator<Item = f64>) -> f64 {
    let (sum, n) = values.fold((0.0, 0), |(s, n), x| (s + x * x, n + 1));
    if n == 0 { 0.0 } else { (sum / f64::from(n)).sqrt() }
}

/// Whether a sequence nowhere falls. Most do not, and seeing that is quicker than mending.
fn rises(y: &[f64]) -> bool {
    let falls = y.iter().zip(&y[1..]).fold(false, |falls, (a, b)| falls | (b < a));
    !falls
}

/// Lifts each value to the greatest before it.
fn make_rising(y: &mut [f64]) {
    if rises(y) {
        return;
    }
    let mut most = f64::NEG_INFINITY;
    for v in y {
        most = if *v > most { *v } else { most };
        *v = most;
    }
}

/// Lowers each value to the least after it.
fn make_rising_from_end(y: &mut [f64]) {
    if rises(y) {
        return;
    }
    let mut least = f64::INFINITY;
    for v in y.iter_mut().rev() {
        least = if *v < least { *v } else { least };
        *v = least;
    }
}
