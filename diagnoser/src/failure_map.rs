//! Failure maps (paper 4.1, 4.2): a feature over the fault grid as monotone curves.

mod band_ends;
mod set;

use crate::isotonic::monotone_surface;
use crate::monotone;
use band_ends::BandEnds;
use schemas::error::{Error, Result};
use schemas::feature::Feature;
use serde::{Deserialize, Serialize};
pub use set::{FailureMapSet, MapSetHeader};

/// Largest break of monotony that is projected away, as a share of the map's range (assumed). P3
/// comes in whole samples; its limit is one sample if that is more.
const BREAK_LIMIT: f64 = 0.03;

/// Sensor noise enters the half-width with this many standard deviations: a band then misses with
/// 0.27 %, and four independent ones hold together in 98.9 %.
const SIGMAS: f64 = 3.0;

/// Leave-one-out doubles the spacing. What is left of its error at the grid's own spacing is
/// judged by doubling once more: the error of a smooth feature falls to a quarter (second order)
/// or less, that of a feature in steps not at all. No more than a quarter is believed.
const SMOOTH_SHARE: f64 = 0.25;

/// A leave-one-out error this many times the 95 % quantile is no interpolation error but a step
/// of the feature; twice the error then goes into the band around that grid point.
const STEP_RATIO: f64 = 3.0;

/// What the bands of a map are made of, each part of the half-width in the feature's unit.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct BandBudget {
    /// standard deviation of the feature from sensor noise and offsets
    pub noise: f64,
    /// typical interpolation error between grid points, from leave-one-out
    pub interpolation: f64,
    /// one sample of the command, where the feature is a command at a sample
    pub sample: f64,
}

/// Quantile of the leave-one-out errors that goes into the band everywhere.
const USUAL: f64 = 0.8;

/// Grid points around a leave-one-out error, each way, that it is believed for: a single small one
/// may be small by chance.
const NEIGHBOURS: usize = 2;

/// One feature over the fault grid.
#[derive(Clone, Debug, PartialEq)]
pub struct FailureMap {
    pub feature: Feature,
    /// direction along (FSJ, zeta): +1 rising, -1 falling
    pub direction: (f64, f64),
    pub fsj: Vec<f64>,
    pub zeta: Vec<f64>,
    /// simulated values, zeta outer, FSJ inner
    pub raw: Vec<f64>,
    /// the nearest monotone surface
    pub value: Vec<f64>,
    pub budget: BandBudget,
    /// |raw - value| at each grid point
    pub residual: Vec<f64>,
    /// what is added to the band at each grid point: the residual, interpolation errors beyond the
    /// typical one, and steps between grid points
    margin: Vec<f64>,
    /// slopes of `value` across zeta
    slope: Vec<f64>,
    /// whether the limits of the bands need no mending, between each two rows
    plain: Vec<bool>,
    /// ends of the band on the grid's lines and between them
    ends: Vec<BandEnds>,
}

/// A curve of a map at one zeta, made to rise along FSJ (multiplied by the map's direction).
#[derive(Clone, Debug)]
pub struct Curve {
    pub y: Vec<f64>,
    pub d: Vec<f64>,
}

/// A curve with its band, rising: the feature of a run with these faults lies between `low` and
/// `high`, both monotone.
#[derive(Clone, Debug)]
pub struct BandCurve {
    pub low: Curve,
    pub high: Curve,
}

/// The limits of a band at the FSJ grid points of one line of constant zeta, rising. Kept to be
/// filled again: a diagnosis takes hundreds of lines.
#[derive(Clone, Debug, Default)]
pub struct BandKnots {
    pub low: Vec<f64>,
    pub high: Vec<f64>,
}

/// The band on one line of constant zeta, its limits at the FSJ grid points worked out only where
/// they are asked for: inverting a map takes a few points of each of hundreds of lines.
pub struct BandLine<'a> {
    map: &'a FailureMap,
    place: Place,
    /// weights of the values of both rows and of their slopes in the curve
    weights: [f64; 4],
    /// half-width that holds everywhere
    base: f64,
    /// the limits where they need mending, and then all are known
    mended: Option<&'a BandKnots>,
}

impl BandLine<'_> {
    /// Lower limit at FSJ grid point `k`.
    #[inline]
    pub fn low(&self, k: usize) -> f64 {
        match self.mended {
            Some(knots) => knots.low[k],
            None => self.curve(k) - self.half_width(k),
        }
    }

    /// Upper limit at FSJ grid point `k`.
    #[inline]
    pub fn high(&self, k: usize) -> f64 {
        match self.mended {
            Some(knots) => knots.high[k],
            None => self.curve(k) + self.half_width(k),
        }
    }

    #[inline]
    fn curve(&self, k: usize) -> f64 {
        let [wa, wb, da, db] = self.weights;
        let ((v0, v1), (d0, d1)) = (self.rows(&self.map.value, k), self.rows(&self.map.slope, k));
        wa * v0 + wb * v1 + da * d0 + db * d1
    }

    #[inline]
    fn half_width(&self, k: usize) -> f64 {
        let s = self.place.share;
        let (below, above) = self.rows(&self.map.margin, k);
        self.base + ((1.0 - s) * below + s * above)
    }

    /// What a table holds at a FSJ grid point in the rows around the line.
    fn rows(&self, table: &[f64], k: usize) -> (f64, f64) {
        let n = self.map.fsj.len();
        let i = self.place.row * n + k;
        (table[i], table[i + n])
    }
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
    ///
    /// Refuses breaks of monotony beyond [`BREAK_LIMIT`] and values that are not numbers, naming
    /// the grid points.
    pub fn build(
        file: &str,
        feature: Feature,
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
        let direction = feature.direction();
        let value = monotone_surface(&raw, zeta.len(), columns, direction);
        let (lo, hi) = raw.iter().fold((f64::MAX, f64::MIN), |(a, b), &v| (a.min(v), b.max(v)));
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
        let residual: Vec<f64> = raw.iter().zip(&value).map(|(a, b)| (a - b).abs()).collect();
        let mut map = Self {
            feature,
            direction,
            fsj: fsj.into(),
            zeta: zeta.into(),
            raw,
            value,
            budget: BandBudget {
                noise,
                interpolation: 0.0,
                sample,
            },
            margin: residual.clone(),
            residual,
            slope: Vec::new(),
            plain: Vec::new(),
            ends: Vec::new(),
        };
        map.slope = map.slopes_across();
        let left_out = map.leave_one_out(1);
        let quantile = |v: &[f64], q: f64| {
            let mut v: Vec<f64> = v.iter().copied().filter(|e| *e > 0.0).collect();
            v.sort_by(f64::total_cmp);
            if v.is_empty() {
                0.0
            } else {
                v[((v.len() - 1) as f64 * q).round() as usize]
            }
        };
        let coarse = map.leave_one_out(2);
        // the greatest errors may be curvature, which falls with the spacing, and the usual ones
        // scatter of the switching, which does not: the worse of both is believed
        let ratio = |q: f64| {
            let (fine, coarse) = (quantile(&left_out, q), quantile(&coarse, q));
            if coarse > 0.0 {
                (fine / coarse).clamp(SMOOTH_SHARE, 1.0)
            } else {
                1.0
            }
        };
        let typical = quantile(&left_out, 0.95);
        let share = ratio(0.95).max(ratio(0.5));
        map.budget.interpolation = share * quantile(&left_out, USUAL);
        // where the error is greater than that, the rest goes into the band of the grid points around
        let rows = map.zeta.len();
        let mut local = vec![0.0_f64; left_out.len()];
        for (i, &e) in left_out.iter().enumerate() {
            let (r, c) = (i / columns, i % columns);
            let step = e > STEP_RATIO * typical && e > sample;
            let (error, reach) = if step { (2.0 * e, 1) } else { (share * e, NEIGHBOURS) };
            for r in r.saturating_sub(reach)..=(r + reach).min(rows - 1) {
                for c in c.saturating_sub(reach)..=(c + reach).min(columns - 1) {
                    let m = &mut local[r * columns + c];
                    *m = m.max(error - map.budget.interpolation);
                }
            }
        }
        map.margin = map.residual.iter().zip(&local).map(|(a, b)| a + b).collect();
        map.plain = map.plain_rows();
        map.ends = map.ends_of_lines();
        Ok(map)
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

    /// Errors at the grid points when each is left out in turn, along FSJ and along zeta, the larger
    /// of the two; 0 at the rim. `stride` 2 uses every second line and point.
    fn leave_one_out(&self, stride: usize) -> Vec<f64> {
        let (rows, columns) = (self.zeta.len(), self.fsj.len());
        let mut out = vec![0.0_f64; self.value.len()];
        let mut line = |x: &[f64], index: &dyn Fn(usize) -> usize| {
            let kept: Vec<usize> = (0..x.len()).step_by(stride).collect();
            for at in 1..kept.len().max(1) - 1 {
                let others: Vec<usize> = kept.iter().copied().filter(|&k| k != kept[at]).collect();
                if others.len() < 2 {
                    continue;
                }
                let xs: Vec<f64> = others.iter().map(|&k| x[k]).collect();
                let ys: Vec<f64> = others.iter().map(|&k| self.value[index(k)]).collect();
                let mut d = vec![0.0; xs.len()];
                monotone::slopes(&xs, &ys, &mut d);
                let i = index(kept[at]);
                out[i] = out[i].max((monotone::at(&xs, &ys, &d, x[kept[at]]) - self.value[i]).abs());
            }
        };
        for r in (0..rows).step_by(stride) {
            line(&self.fsj, &|k| r * columns + k);
        }
        for c in (0..columns).step_by(stride) {
            line(&self.zeta, &|k| k * columns + c);
        }
        out
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

    /// The feature at a fault pair, clamped to the map.
    pub fn at(&self, fsj: f64, zeta: f64) -> f64 {
        let c = self.curve(zeta);
        self.direction.0 * monotone::at(&self.fsj, &c.y, &c.d, fsj)
    }

    /// Half-width of the band that holds everywhere, in the feature's unit.
    fn base(&self) -> f64 {
        let b = &self.budget;
        SIGMAS * b.noise + b.interpolation + b.sample
    }

    /// Margins at the FSJ grid points: straight between the rows, whose margins already reach over
    /// their neighbours.
    fn margins(&self, place: &Place) -> impl Iterator<Item = f64> {
        let s = place.share;
        let (below, above) = self.rows(&self.margin, place);
        below.iter().zip(above).map(move |(a, b)| (1.0 - s) * a + s * b)
    }

    /// Half-width of the band at a fault pair, in the feature's unit.
    pub fn half_width(&self, fsj: f64, zeta: f64) -> f64 {
        let c = monotone::piece(&self.fsj, fsj);
        let place = self.place(zeta);
        self.base() + self.margins(&place).skip(c).take(2).fold(0.0, f64::max)
    }

    /// The band on the line at `zeta`; `knots` are filled if its limits need mending.
    pub fn band_line<'a>(&'a self, zeta: f64, knots: &'a mut BandKnots) -> BandLine<'a> {
        let place = self.place(zeta);
        let plain = self.plain[place.row];
        if !plain {
            self.band_knots(zeta, knots);
        }
        BandLine {
            map: self,
            weights: self.weights(&place),
            place,
            base: self.base(),
            mended: (!plain).then_some(knots),
        }
    }

    /// Whether between each two rows the curves and both limits rise along FSJ by themselves: all
    /// their Bezier ordinates across zeta do.
    fn plain_rows(&self) -> Vec<bool> {
        let (n, rise) = (self.fsj.len(), self.direction.0);
        let ordinates = |r: usize, c: usize| {
            let (a, b) = (r * n + c, (r + 1) * n + c);
            let third = (self.zeta[r + 1] - self.zeta[r]) / 3.0;
            let (v0, v1) = (self.value[a], self.value[b]);
            let curve = [v0, v0 + third * self.slope[a], v1 - third * self.slope[b], v1];
            let (m0, m1) = (self.margin[a], self.margin[b]);
            let margin = [m0, (2.0 * m0 + m1) / 3.0, (m0 + 2.0 * m1) / 3.0, m1];
            [0, 1, 2, 3].map(|q| (rise * curve[q], margin[q]))
        };
        let rises = |((v0, m0), (v1, m1)): ((f64, f64), (f64, f64))| v1 - v0 >= (m1 - m0).abs();
        let plain = |r: usize| {
            (1..n).all(|c| {
                let pairs = ordinates(r, c - 1).into_iter().zip(ordinates(r, c));
                pairs.into_iter().all(rises)
            })
        };
        (0..self.zeta.len() - 1).map(plain).collect()
    }

    /// The limits of the band at `zeta` at the FSJ grid points, without slopes.
    pub fn band_knots(&self, zeta: f64, knots: &mut BandKnots) {
        let (place, base) = (self.place(zeta), self.base());
        let BandKnots { low, high } = knots;
        self.curve_knots(&place, low);
        high.clear();
        high.extend(low.iter().zip(self.margins(&place)).map(|(y, m)| y + (base + m)));
        low.iter_mut()
            .zip(self.margins(&place))
            .for_each(|(y, m)| *y -= base + m);
        // made monotone by giving way outwards
        make_rising_from_end(low);
        make_rising(high);
    }

    /// The curve at `zeta` with its band.
    pub fn band(&self, zeta: f64) -> BandCurve {
        let mut knots = BandKnots::default();
        self.band_knots(zeta, &mut knots);
        BandCurve {
            low: self.through(knots.low),
            high: self.through(knots.high),
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
            margin: wider(&self.margin),
            slope: Vec::new(),
            plain: Vec::new(),
            ends: Vec::new(),
            budget: self.budget.clone(),
            ..*self
        };
        map.slope = map.slopes_across();
        map.plain = map.plain_rows();
        map.ends = map.ends_of_lines();
        map
    }
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

#[cfg(test)]
mod tests {
    use super::*;

    const FSJ: [f64; 7] = [1.0, 1.5, 2.0, 2.5, 3.5, 4.0, 5.0];
    const ZETA: [f64; 5] = [0.0, 0.1, 0.2, 0.35, 0.5];

    fn map(feature: Feature, value: impl Fn(f64, f64) -> f64) -> FailureMap {
        let (along, across) = feature.direction();
        let raw = ZETA.iter().flat_map(|&z| FSJ.map(|f| value(along * f, across * z)));
        FailureMap::build("test", feature, &FSJ, &ZETA, raw.collect(), 0.01, 0.25).unwrap()
    }

    /// Maps that need no mending, and maps in steps and with plateaus, whose margins stand out.
    fn maps() -> [FailureMap; 4] {
        let smooth = |f: f64, z: f64| f + z;
        let stepped = |f: f64, z: f64| (f + 6.0 * z * z.abs()).floor() + 0.05 * z;
        let (p1, ripple) = (Feature::P1, Feature::Ripple);
        [
            map(p1, smooth),
            map(ripple, smooth),
            map(p1, stepped),
            map(ripple, stepped),
        ]
    }

    #[test]
    fn prop_band_line_has_the_limits_of_the_band() {
        let maps = maps();
        let plain = maps.each_ref().map(|m| m.plain.iter().all(|p| *p));
        assert_eq!(plain, [true, true, false, false]);
        for map in maps {
            let mut knots = BandKnots::default();
            for zeta in (0..=200).map(|k| k as f64 * 2.5e-3) {
                let (line, band) = (map.band_line(zeta, &mut knots), map.band(zeta));
                for k in 0..FSJ.len() {
                    assert!((line.low(k) - band.low.y[k]).abs() < 1e-12, "{zeta} {k}");
                    assert!((line.high(k) - band.high.y[k]).abs() < 1e-12, "{zeta} {k}");
                }
            }
        }
    }

    #[test]
    fn prop_zetas_are_those_whose_band_holds_the_value() {
        for map in maps() {
            let (lo, hi) = map.range();
            for value in (0..=60).map(|k| lo - 0.503 + (hi - lo + 1.0) * k as f64 / 60.0) {
                let zetas = map.zetas(value, &mut BandKnots::default());
                for zeta in (0..=200).map(|k| k as f64 * 2.5e-3) {
                    let (band, v) = (map.band(zeta), map.direction.0 * value);
                    let holds = band.low.y[0] <= v && v <= band.high.y[FSJ.len() - 1];
                    assert_eq!(zetas.is_some_and(|r| r.contains(zeta)), holds, "{value} {zeta}");
                }
            }
        }
    }
}
