//! Columns of the features of a fleet, each row with the number of its actuator and of its grid point.

use super::tables::Table;
use anyhow::Result;
use polars::prelude::*;
use rayon::prelude::*;
use schemas::error::Error;
use std::borrow::Cow;
use std::collections::HashMap;
use std::ops::Range;
use std::path::Path;

/// A grid point of a test.
#[derive(Clone, Debug, PartialEq)]
pub struct Point {
    /// Name of the sequence.
    pub sequence: String,
    /// Rotor angle at rest [rad].
    pub rest_angle_rad: f64,
    /// Friction factor.
    pub fsj: f64,
    /// Static eccentricity over air gap.
    pub zeta: f64,
}

/// Map runs of a fleet in columns.
pub struct Fleet {
    /// Names, in order of appearance; empty if not asked for.
    pub actuators: Vec<String>,
    /// Distinct points, sorted by sequence, rest angle, FSJ, zeta.
    pub points: Vec<Point>,
    /// Ranges of `points` with one sequence and rest angle.
    pub planes: Vec<Range<usize>>,
    /// Per row: its actuator; empty if not asked for.
    pub actuator: Vec<u32>,
    /// Per row: its point.
    pub point: Vec<u32>,
    /// The columns asked for, NaN for null.
    pub values: Vec<Vec<f64>>,
}

const KEYS: [&str; 4] = ["sequence", "rest_angle_rad", "fsj", "zeta"];

/// What is read of the features: the map runs, with keys and the named columns.
///
/// * `actuators` whether the actuators are wanted
/// * `healthy` only the point FSJ 1, zeta 0
///
/// # Errors
/// No features, or those of something else.
pub fn read(dir: &Path, columns: &[&str], actuators: bool, healthy: bool) -> Result<LazyFrame> {
    let mut frame = Table::Features.scan(dir)?;
    let schema = super::guarded(|| frame.collect_schema()).map_err(|e| Error::torn(dir, e))?;
    let wanted: Vec<&str> = KEYS
        .into_iter()
        .chain(actuators.then_some("actuator"))
        .chain(columns.iter().copied())
        .collect();
    for &name in wanted.iter().chain(&["kind"]) {
        if schema.get(name).is_none() {
            let allowed = "the features of a dataset (ema simulate, ema dataset make)";
            let place = "table `features`";
            let found = format!("no column `{name}`");
            return Err(Error::bad(dir.display().to_string(), place, found, allowed).into());
        }
    }
    let mut which = col("kind").eq(lit("map"));
    if healthy {
        which = which.and(col("fsj").eq(lit(1.0))).and(col("zeta").eq(lit(0.0)));
    }
    Ok(frame
        .filter(which)
        .select(wanted.into_iter().map(col).collect::<Vec<_>>()))
}

/// A column of numbers, NaN for null.
///
/// # Errors
/// The column is not there or holds no Float64.
pub fn floats(frame: &DataFrame, name: &str, dir: &Path) -> Result<Vec<f64>> {
    let bad = |e: PolarsError| Error::torn(dir, format!("column `{name}`: {}", super::one_line(&e)));
    let column = frame.column(name).map_err(bad)?;
    let mut out = Vec::with_capacity(frame.height());
    for chunk in column.as_materialized_series().f64().map_err(bad)?.downcast_iter() {
        match chunk.validity() {
            None => out.extend_from_slice(chunk.values()),
            Some(_) => out.extend(chunk.iter().map(|v| v.copied().unwrap_or(f64::NAN))),
        }
    }
    Ok(out)
}

/// Texts of a column as numbers of the distinct texts, which are in order of appearance. Null is "".
///
/// # Errors
/// The column is not there or holds no text.
pub fn texts(frame: &DataFrame, name: &str, dir: &Path) -> Result<(Vec<String>, Vec<u32>)> {
    let bad = |e: PolarsError| Error::torn(dir, format!("column `{name}`: {}", super::one_line(&e)));
    let column = frame.column(name).map_err(bad)?;
    let mut out = Vec::with_capacity(frame.height());
    let mut known: HashMap<String, u32> = HashMap::new();
    let mut distinct: Vec<String> = Vec::new();
    let mut last: Option<u32> = None;
    for chunk in column.as_materialized_series().str().map_err(bad)?.downcast_iter() {
        for text in chunk.iter() {
            let text = text.unwrap_or("");
            // rows of one actuator follow each other
            let number = match last {
                Some(n) if distinct[n as usize] == text => n,
                _ => *known.entry(text.to_string()).or_insert_with(|| {
                    distinct.push(text.to_string());
                    distinct.len() as u32 - 1
                }),
            };
            last = Some(number);
            out.push(number);
        }
    }
    Ok((distinct, out))
}

impl Fleet {
    /// Takes the columns of `frame`, which is what [`read`] reads.
    ///
    /// # Errors
    /// Columns of other types, or no rows.
    pub fn new(frame: &DataFrame, columns: &[&str], dir: &Path) -> Result<Self> {
        if frame.height() == 0 {
            let place = "table `features`";
            let found = "no rows of kind `map`";
            return Err(Error::bad(dir.display().to_string(), place, found, "runs on a grid of faults").into());
        }
        let named = frame.column("actuator").is_ok();
        let ((actuators, sequences), numbers) = rayon::join(
            || {
                let actuators = || named.then(|| texts(frame, "actuator", dir)).transpose();
                rayon::join(actuators, || texts(frame, "sequence", dir))
            },
            || -> Result<Vec<Vec<f64>>> {
                let names: Vec<&str> = KEYS[1..].iter().chain(columns).copied().collect();
                names.par_iter().map(|c| floats(frame, c, dir)).collect()
            },
        );
        let (actuators, actuator) = actuators?.unwrap_or_default();
        let (sequences, sequence) = sequences?;
        let mut numbers = numbers?.into_iter();
        let [rest, fsj, zeta] = std::array::from_fn(|_| numbers.next().unwrap_or_default());
        // -0 and 0 are one point
        let key = |i: usize| (sequence[i], [rest[i], fsj[i], zeta[i]].map(|x| (x + 0.0).to_bits()));
        let mut known = HashMap::new();
        let mut firsts: Vec<usize> = Vec::new();
        let mut keys: Vec<(u32, [u64; 3])> = Vec::new();
        let mut after: Vec<u32> = Vec::new();
        let mut point = Vec::with_capacity(fsj.len());
        let mut last = usize::MAX;
        for i in 0..fsj.len() {
            let k = key(i);
            // actuators go through the same points in the same order
            let guess = after.get(last).map_or(u32::MAX, |&n| n);
            let number = if keys.get(guess as usize) == Some(&k) {
                guess
            } else {
                *known.entry(k).or_insert_with(|| {
                    firsts.push(i);
                    keys.push(k);
                    after.push(u32::MAX);
                    keys.len() as u32 - 1
                })
            };
            if let Some(n) = after.get_mut(last) {
                *n = number;
            }
            last = number as usize;
            point.push(number);
        }
        let at = |i: usize| Point {
            sequence: sequences[sequence[i] as usize].clone(),
            rest_angle_rad: rest[i] + 0.0,
            fsj: fsj[i],
            zeta: zeta[i] + 0.0,
        };
        let unsorted: Vec<Point> = firsts.into_iter().map(at).collect();
        let mut order: Vec<usize> = (0..unsorted.len()).collect();
        order.sort_by(|&a, &b| {
            let (a, b) = (&unsorted[a], &unsorted[b]);
            let rest = a.rest_angle_rad.total_cmp(&b.rest_angle_rad);
            let pair = a.fsj.total_cmp(&b.fsj).then(a.zeta.total_cmp(&b.zeta));
            a.sequence.cmp(&b.sequence).then(rest).then(pair)
        });
        let mut place = vec![0; order.len()];
        order.iter().enumerate().for_each(|(to, &from)| place[from] = to as u32);
        point.iter_mut().for_each(|p| *p = place[*p as usize]);
        let points: Vec<Point> = order.iter().map(|&i| unsorted[i].clone()).collect();
        let one_plane = |a: &Point, b: &Point| a.sequence == b.sequence && a.rest_angle_rad == b.rest_angle_rad;
        let mut planes = Vec::new();
        let mut start = 0;
        for plane in points.chunk_by(one_plane) {
            planes.push(start..start + plane.len());
            start += plane.len();
        }
        Ok(Self {
            actuators,
            points,
            planes,
            actuator,
            point,
            values: numbers.collect(),
        })
    }

    /// Reads the map runs with the named columns and the actuators.
    ///
    /// # Errors
    /// As [`read`] and [`Fleet::new`].
    pub fn load(dir: &Path, columns: &[&str], actuators: bool) -> Result<Self> {
        let frame = super::run(read(dir, columns, actuators, false)?).map_err(|e| Error::torn(dir, e))?;
        Self::new(&frame, columns, dir)
    }

    /// The rows of each actuator.
    pub fn by_actuator(&self) -> Groups {
        Groups::new(&self.actuator, self.actuators.len())
    }

    /// The rows of each point.
    pub fn by_point(&self) -> Groups {
        Groups::new(&self.point, self.points.len())
    }
}

/// Rows by group.
pub struct Groups {
    /// First place of each group, and the end.
    start: Vec<usize>,
    /// Place of each row; empty where the rows are in the order of the groups.
    place: Vec<u32>,
}

impl Groups {
    /// * `group` number of the group of each row, below `count`
    pub fn new(group: &[u32], count: usize) -> Self {
        let mut start = vec![0; count + 1];
        group.iter().for_each(|&g| start[g as usize + 1] += 1);
        for g in 0..count {
            start[g + 1] += start[g];
        }
        if group.is_sorted() {
            return Self {
                start,
                place: Vec::new(),
            };
        }
        let mut next = start.clone();
        let mut take = |g: &u32| {
            next[*g as usize] += 1;
            next[*g as usize] as u32 - 1
        };
        let place = group.iter().map(&mut take).collect();
        Self { start, place }
    }

    /// The values of all rows, group after group, in the order of rows within a group.
    pub fn gather<'a, T: Copy + Default>(&self, values: &'a [T]) -> Cow<'a, [T]> {
        if self.place.is_empty() {
            return Cow::Borrowed(values);
        }
        let mut out = vec![T::default(); values.len()];
        for (v, &p) in values.iter().zip(&self.place) {
            out[p as usize] = *v;
        }
        Cow::Owned(out)
    }

    /// Number of groups.
    pub fn count(&self) -> usize {
        self.start.len() - 1
    }

    /// Places of a group in what [`Groups::gather`] returns.
    pub fn of(&self, group: usize) -> Range<usize> {
        self.start[group]..self.start[group + 1]
    }
}
