//! Failure maps (paper 4.1, 4.2): a feature over the fault grid as monotone curves.

use crate::isotonic::monotone_surface;
use crate::monotone;
use arrow::array::{ArrayRef, AsArray, Float64Array, RecordBatch, StringArray};
use arrow::datatypes::{DataType, Field, Float64Type, Schema};
use parquet::arrow::arrow_reader::ParquetRecordBatchReaderBuilder;
use schemas::error::{Error, Result};
use schemas::feature::{Feature, Features, RawFeatures};
use schemas::recording::{Provenance, write_table};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;

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

    /// The curve over FSJ at `zeta` (clamped to the map), rising.
    pub fn curve(&self, zeta: f64) -> Curve {
        let columns = self.fsj.len();
        let zeta = zeta.clamp(self.zeta[0], self.zeta[self.zeta.len() - 1]);
        let r = monotone::piece(&self.zeta, zeta);
        let (z0, z1) = (self.zeta[r], self.zeta[r + 1]);
        let h = z1 - z0;
        let s = (zeta - z0) / h;
        let s1 = 1.0 - s;
        let (wa, wb) = (s1 * s1 * (1.0 + 2.0 * s), s * s * (3.0 - 2.0 * s));
        let (da, db) = (s * s1 * s1 * h, -s * s1 * s * h);
        let rise = self.direction.0;
        let row = |v: &[f64], r: usize, c: usize| v[r * columns + c];
        let mut y: Vec<f64> = (0..columns)
            .map(|c| {
                rise * (wa * row(&self.value, r, c)
                    + wb * row(&self.value, r + 1, c)
                    + da * row(&self.slope, r, c)
                    + db * row(&self.slope, r + 1, c))
            })
            .collect();
        // two monotone columns may still cross by a rounding between the rows
        for c in 1..columns {
            y[c] = y[c].max(y[c - 1]);
        }
        let mut d = vec![0.0; columns];
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

    /// Margins of the FSJ grid points at `zeta`: straight between the rows, whose margins already
    /// reach over their neighbours.
    fn margins(&self, zeta: f64) -> Vec<f64> {
        let n = self.fsj.len();
        let zeta = zeta.clamp(self.zeta[0], self.zeta[self.zeta.len() - 1]);
        let r = monotone::piece(&self.zeta, zeta);
        let s = (zeta - self.zeta[r]) / (self.zeta[r + 1] - self.zeta[r]);
        (r * n..(r + 1) * n)
            .map(|i| (1.0 - s) * self.margin[i] + s * self.margin[i + n])
            .collect()
    }

    /// Half-width of the band at a fault pair, in the feature's unit.
    pub fn half_width(&self, fsj: f64, zeta: f64) -> f64 {
        let c = monotone::piece(&self.fsj, fsj);
        let m = self.margins(zeta);
        self.base() + m[c].max(m[c + 1])
    }

    /// The curve at `zeta` with its band.
    pub fn band(&self, zeta: f64) -> BandCurve {
        let c = self.curve(zeta);
        let n = self.fsj.len();
        let base = self.base();
        let h: Vec<f64> = self.margins(zeta).iter().map(|m| base + m).collect();
        let mut low: Vec<f64> = (0..n).map(|k| c.y[k] - h[k]).collect();
        let mut high: Vec<f64> = (0..n).map(|k| c.y[k] + h[k]).collect();
        // made monotone by giving way outwards
        for k in (0..n - 1).rev() {
            low[k] = low[k].min(low[k + 1]);
        }
        for k in 1..n {
            high[k] = high[k].max(high[k - 1]);
        }
        let curve = |y: Vec<f64>| {
            let mut d = vec![0.0; n];
            monotone::slopes(&self.fsj, &y, &mut d);
            Curve { y, d }
        };
        BandCurve {
            low: curve(low),
            high: curve(high),
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
            budget: self.budget.clone(),
            ..*self
        };
        map.slope = map.slopes_across();
        map
    }
}

/// What a map set was made for; a diagnosis must match it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct MapSetHeader {
    pub actuator: String,
    pub parameters: String,
    pub sequence: String,
    pub sequence_fingerprint: String,
    pub rate_hz: f64,
    /// fingerprint of the sensor model, or `none`
    pub sensors: String,
    pub rest_angle_rad: f64,
    /// P2 from i_eq because the telemetry has no phase currents
    pub equivalent_current: bool,
    pub grid: String,
    /// constant load torque of the runs [N m, motor side]
    pub load_n_m: f64,
    pub step_s: f64,
    pub seed: u64,
    pub commit: String,
    /// features whose surface is not monotone enough for a map, and why
    #[serde(default)]
    pub left_out: Vec<String>,
}

/// The maps of one actuator, sequence, rate, sensor model and rest angle.
#[derive(Clone, Debug, PartialEq)]
pub struct FailureMapSet {
    pub header: MapSetHeader,
    /// the nominal run through the same sensors
    pub nominal: RawFeatures,
    pub maps: Vec<FailureMap>,
}

#[derive(Serialize, Deserialize)]
struct Stored {
    header: MapSetHeader,
    nominal: [Option<f64>; 4],
    budgets: BTreeMap<String, BandBudget>,
}

impl FailureMapSet {
    /// Features of a run over this set's nominal run.
    pub fn features(&self, raw: &RawFeatures) -> Features {
        Features::over(raw, &self.nominal)
    }

    pub fn map(&self, feature: Feature) -> Option<&FailureMap> {
        self.maps.iter().find(|m| m.feature == feature)
    }

    /// Saves the maps as one Parquet table: feature, fsj, zeta, value, raw_value.
    pub fn save(&self, path: &Path) -> Result<()> {
        let column = |f: fn(&FailureMap, usize) -> f64| -> ArrayRef {
            let v = self.maps.iter().flat_map(|m| (0..m.value.len()).map(move |i| f(m, i)));
            Arc::new(Float64Array::from_iter_values(v))
        };
        let names = self.maps.iter().flat_map(|m| m.value.iter().map(|_| m.feature.name()));
        let field = |n: &str, t: DataType| Field::new(n, t, false);
        let schema = Arc::new(Schema::new(vec![
            field("feature", DataType::Utf8),
            field("fsj", DataType::Float64),
            field("zeta", DataType::Float64),
            field("value", DataType::Float64),
            field("raw_value", DataType::Float64),
        ]));
        let columns: Vec<ArrayRef> = vec![
            Arc::new(StringArray::from_iter_values(names)),
            column(|m, i| m.fsj[i % m.fsj.len()]),
            column(|m, i| m.zeta[i / m.fsj.len()]),
            column(|m, i| m.value[i]),
            column(|m, i| m.raw[i]),
        ];
        let h = &self.header;
        let provenance = Provenance {
            actuator: h.actuator.clone(),
            parameters: h.parameters.clone(),
            sequence: h.sequence.clone(),
            sequence_fingerprint: h.sequence_fingerprint.clone(),
            grid: h.grid.clone(),
            sensors: h.sensors.clone(),
            rate_hz: h.rate_hz,
            step_s: h.step_s,
            seed: h.seed,
            load_n_m: h.load_n_m,
            effects: String::new(),
            commit: h.commit.clone(),
            model: "ntb".into(),
        };
        let n = &self.nominal;
        let stored = Stored {
            header: h.clone(),
            nominal: [n.mean_speed_rad_per_s, n.ripple_rad_per_s, n.p2_a, n.p3_rad],
            budgets: self
                .maps
                .iter()
                .map(|m| (m.feature.name().to_string(), m.budget.clone()))
                .collect(),
        };
        let mut pairs = provenance.pairs();
        pairs.push(("ema.maps".into(), serde_json::to_string(&stored).expect("plain data")));
        let batch = RecordBatch::try_new(schema, columns).map_err(|e| Error::torn(path, e))?;
        write_table(path, &batch, pairs)
    }

    /// Loads a saved set; refuses another schema version, torn files and incomplete grids.
    pub fn load(path: &Path) -> Result<Self> {
        let pairs = schemas::recording::metadata(path)?;
        Provenance::from_pairs(path, &pairs)?;
        let file = path.display().to_string();
        let text = pairs
            .get("ema.maps")
            .ok_or_else(|| Error::bad(&file, "metadata `ema.maps`", "nothing", "a file written by `ema maps`"))?;
        let stored: Stored = serde_json::from_str(text).map_err(|e| Error::torn(path, e))?;
        let torn = |e: &dyn std::fmt::Display| Error::torn(path, e);
        let input = std::fs::File::open(path).map_err(|e| Error::io(path, "cannot be read", e))?;
        let reader = ParquetRecordBatchReaderBuilder::try_new(input)
            .map_err(|e| torn(&e))?
            .build()
            .map_err(|e| torn(&e))?;
        let mut rows: BTreeMap<Feature, Vec<[f64; 4]>> = BTreeMap::new();
        for batch in reader {
            let batch = batch.map_err(|e| torn(&e))?;
            let missing = |n: &str| {
                Error::bad(
                    &file,
                    "columns",
                    format!("no `{n}` of its type"),
                    "those of schemas/README.md",
                )
            };
            let numbers = |n: &str| {
                batch
                    .column_by_name(n)
                    .and_then(|c| c.as_primitive_opt::<Float64Type>())
                    .ok_or_else(|| missing(n))
            };
            let names = batch.column_by_name("feature").and_then(|c| c.as_string_opt::<i32>());
            let names = names.ok_or_else(|| missing("feature"))?;
            let (f, z, v, r) = (
                numbers("fsj")?,
                numbers("zeta")?,
                numbers("value")?,
                numbers("raw_value")?,
            );
            for i in 0..batch.num_rows() {
                let feature = Feature::from_name(names.value(i))
                    .ok_or_else(|| Error::bad(&file, format!("row {i}"), names.value(i), "p1, p2, p3, ripple"))?;
                rows.entry(feature)
                    .or_default()
                    .push([f.value(i), z.value(i), v.value(i), r.value(i)]);
            }
        }
        let mut maps = Vec::new();
        for (feature, rows) in rows {
            let axis = |k: usize| {
                let mut v: Vec<f64> = rows.iter().map(|r| r[k]).collect();
                v.sort_by(f64::total_cmp);
                v.dedup();
                v
            };
            let (fsj, zeta) = (axis(0), axis(1));
            let whole = rows.len() == fsj.len() * zeta.len()
                && fsj.len() >= 2
                && zeta.len() >= 2
                && rows
                    .iter()
                    .enumerate()
                    .all(|(i, r)| r[0] == fsj[i % fsj.len()] && r[1] == zeta[i / fsj.len()]);
            if !whole {
                let found = format!("{} rows", rows.len());
                let allowed = format!("every point of the {} x {} grid once, in order", fsj.len(), zeta.len());
                return Err(Error::bad(&file, format!("map {}", feature.name()), found, allowed));
            }
            let budget = stored.budgets.get(feature.name()).cloned();
            let budget = budget.ok_or_else(|| Error::bad(&file, "budgets", "nothing", feature.name()))?;
            let raw = rows.iter().map(|r| r[3]).collect();
            let mut map = FailureMap::build(&file, feature, &fsj, &zeta, raw, budget.noise, budget.sample)?;
            map.budget = budget;
            maps.push(map);
        }
        if maps.len() < 2 {
            return Err(Error::bad(&file, "maps", maps.len(), "at least two maps"));
        }
        let [mean_speed_rad_per_s, ripple_rad_per_s, p2_a, p3_rad] = stored.nominal;
        let rest_angle_rad = Some(stored.header.rest_angle_rad);
        let nominal = RawFeatures {
            mean_speed_rad_per_s,
            ripple_rad_per_s,
            p2_a,
            p3_rad,
            rest_angle_rad,
        };
        Ok(Self {
            header: stored.header,
            nominal,
            maps,
        })
    }
}
