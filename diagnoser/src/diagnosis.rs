//! From features to fault intervals (paper 5.1): the band around each P* cuts each curve into an
//! interval of FSJ; intersected over the maps, the cuts of all curves make up the area of
//! possible faults.

use crate::failure_map::{FailureMap, FailureMapSet};
use crate::monotone;
use schemas::fault::Interval;
use schemas::feature::{Feature, Features};

/// Coverage that the bands are made for: the share of tests whose true pair lies in the hull.
pub const COVERAGE: f64 = 0.95;

/// Lines of constant zeta on which the area is looked for, and on which it is then measured.
const SEARCH_LINES: usize = 64;
/// Lines of each grid row on which a band is looked for.
const LINES_A_ROW: usize = 4;
const AREA_LINES: usize = 100;

/// FSJ interval on one curve.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Strip {
    pub zeta: f64,
    pub fsj: Interval,
}

/// The area that all bands have in common.
#[derive(Clone, Debug, PartialEq)]
pub struct Area {
    pub strips: Vec<Strip>,
    /// hull
    pub fsj: Interval,
    pub zeta: Interval,
    /// centroid (FSJ, zeta)
    pub centroid: (f64, f64),
    /// area in FSJ times zeta
    pub size: f64,
}

/// Result of a diagnosis. Not being able to locate a fault is a finding, not an error.
#[derive(Clone, Debug, PartialEq)]
pub enum Outcome {
    Located(Area),
    /// The bands have no pair in common; these maps contradict each other.
    Unexplained {
        contradicting: Vec<Feature>,
        reason: String,
    },
    /// The faults lie beyond the maps; the reason says on which side.
    OutOfRange {
        reason: String,
    },
    /// Something is missing; the area that the rest allows, if there is one.
    Incomplete {
        reason: String,
        area: Option<Area>,
    },
}

/// A diagnosis: outcome and the features it stands on.
#[derive(Clone, Debug, PartialEq)]
pub struct Diagnosis {
    pub outcome: Outcome,
    pub features: Features,
}

impl Outcome {
    /// Key of `interfaces`: located, unexplained, out_of_range, incomplete.
    pub fn name(&self) -> &'static str {
        match self {
            Outcome::Located(_) => "located",
            Outcome::Unexplained { .. } => "unexplained",
            Outcome::OutOfRange { .. } => "out_of_range",
            Outcome::Incomplete { .. } => "incomplete",
        }
    }

    pub fn area(&self) -> Option<&Area> {
        match self {
            Outcome::Located(a) => Some(a),
            Outcome::Incomplete { area, .. } => area.as_ref(),
            _ => None,
        }
    }

    pub fn reason(&self) -> &str {
        match self {
            Outcome::Located(_) => "",
            Outcome::Unexplained { reason, .. }
            | Outcome::OutOfRange { reason }
            | Outcome::Incomplete { reason, .. } => reason,
        }
    }
}

/// A map and the value measured for it.
struct Cut<'a> {
    map: &'a FailureMap,
    value: f64,
}

impl Cut<'_> {
    /// FSJ interval of the band on the curve at `zeta`.
    fn interval(&self, zeta: f64) -> Option<Interval> {
        let b = self.map.band(zeta);
        let v = self.map.direction.0 * self.value;
        monotone::between(&self.map.fsj, (&b.low.y, &b.low.d), (&b.high.y, &b.high.d), v)
            .map(|(lo, hi)| Interval { lo, hi })
    }

    /// Side on which the value lies of the band of the curve at `zeta`, in the direction in which
    /// the map rises with zeta: 1 above, -1 below, 0 where they meet.
    fn side(&self, zeta: f64) -> i32 {
        let b = self.map.band(zeta);
        let v = self.map.direction.0 * self.value;
        let turn = (self.map.direction.0 * self.map.direction.1) as i32;
        if v > b.high.y[b.high.y.len() - 1] {
            turn
        } else if v < b.low.y[0] {
            -turn
        } else {
            0
        }
    }

    /// The zetas whose curves the band meets at all; `None` if there are none. Looked for on
    /// the grid's lines and between them.
    fn zetas(&self) -> Option<Interval> {
        let m = self.map;
        let mut lines: Vec<(f64, i32)> = Vec::new();
        for w in m.zeta.windows(2) {
            for k in 0..LINES_A_ROW {
                let z = w[0] + (w[1] - w[0]) * k as f64 / LINES_A_ROW as f64;
                lines.push((z, self.side(z)));
            }
        }
        let last = m.zeta[m.zeta.len() - 1];
        lines.push((last, self.side(last)));
        let meets = |&(_, s): &(f64, i32)| s == 0;
        let (lo, hi) = match (lines.iter().position(meets), lines.iter().rposition(meets)) {
            (Some(a), Some(b)) => (a, b),
            // the band may lie between two lines: above the one and below the other
            _ => {
                let k = lines.windows(2).position(|w| w[0].1 > 0 && w[1].1 < 0)?;
                (k + 1, k)
            }
        };
        // bisection towards the neighbouring lines; both limits end on the outside
        let bisect = |mut a: f64, mut b: f64, left: &dyn Fn(i32) -> bool| {
            for _ in 0..40 {
                let t = 0.5 * (a + b);
                if left(self.side(t)) { a = t } else { b = t }
            }
            (a, b)
        };
        let low = if lo == 0 {
            lines[0].0
        } else {
            bisect(lines[lo - 1].0, lines[lo].0, &|s| s > 0).0
        };
        let high = if hi + 1 >= lines.len() {
            last
        } else {
            bisect(lines[hi].0, lines[hi + 1].0, &|s| s >= 0).1
        };
        (low <= high).then_some(Interval { lo: low, hi: high })
    }
}

/// Intersection of all cuts at one zeta, and how far the cuts are from having a point in common
/// (0 or less: they have).
fn common(cuts: &[Cut<'_>], zeta: f64) -> (f64, Option<Interval>) {
    let (mut lo, mut hi) = (f64::NEG_INFINITY, f64::INFINITY);
    for c in cuts {
        match c.interval(zeta) {
            Some(i) => {
                lo = lo.max(i.lo);
                hi = hi.min(i.hi);
            }
            None => return (f64::INFINITY, None),
        }
    }
    (lo - hi, (lo <= hi).then_some(Interval { lo, hi }))
}

/// The area that the cuts have in common, if any.
fn intersect(cuts: &[Cut<'_>]) -> Option<Area> {
    let mut range = Interval {
        lo: f64::NEG_INFINITY,
        hi: f64::INFINITY,
    };
    for c in cuts {
        range = range.meet(c.zetas()?)?;
    }
    let at = |k: usize, n: usize, r: Interval| {
        if n == 0 {
            r.lo
        } else {
            r.lo + r.width() * k as f64 / n as f64
        }
    };
    let gaps: Vec<f64> = (0..=SEARCH_LINES)
        .map(|k| common(cuts, at(k, SEARCH_LINES, range)).0)
        .collect();
    let best = (0..gaps.len()).min_by(|&a, &b| gaps[a].total_cmp(&gaps[b]))?;
    let step = range.width() / SEARCH_LINES as f64;
    let inside = |z: f64| common(cuts, z).0 <= 0.0;
    let mut seed = at(best, SEARCH_LINES, range);
    if gaps[best] > 0.0 {
        // an area thinner than the spacing of the lines: look where the gap is smallest
        let (mut a, mut b) = ((seed - step).max(range.lo), (seed + step).min(range.hi));
        const GOLDEN: f64 = 0.618_033_988_749_894_9;
        for _ in 0..60 {
            let (c, d) = (b - GOLDEN * (b - a), a + GOLDEN * (b - a));
            if common(cuts, c).0 < common(cuts, d).0 {
                b = d
            } else {
                a = c
            }
        }
        seed = 0.5 * (a + b);
        if !inside(seed) {
            return None;
        }
    }
    // ends of the area: the outermost lines inside, then bisection towards the next ones
    let hit: Vec<f64> = (0..gaps.len())
        .filter(|&k| gaps[k] <= 0.0)
        .map(|k| at(k, SEARCH_LINES, range))
        .chain([seed])
        .collect();
    let (first, last) = hit.iter().fold((f64::MAX, f64::MIN), |(a, b), &z| (a.min(z), b.max(z)));
    let end = |from: f64, to: f64| {
        let (mut a, mut b) = (from, to);
        if inside(b) {
            return b;
        }
        for _ in 0..40 {
            let t = 0.5 * (a + b);
            if inside(t) { a = t } else { b = t }
        }
        a
    };
    let zeta = Interval {
        lo: end(first, (first - step).max(range.lo)),
        hi: end(last, (last + step).min(range.hi)),
    };
    let strips: Vec<Strip> = (0..=AREA_LINES)
        .map(|k| at(k, AREA_LINES, zeta))
        .filter_map(|zeta| common(cuts, zeta).1.map(|fsj| Strip { zeta, fsj }))
        .collect();
    let fsj = strips.iter().map(|s| s.fsj).reduce(Interval::join)?;
    // trapezoidal rule over the lines
    let dz = zeta.width() / AREA_LINES as f64;
    let (mut size, mut mf, mut mz) = (0.0, 0.0, 0.0);
    for (k, s) in strips.iter().enumerate() {
        let weight = if k == 0 || k + 1 == strips.len() { 0.5 } else { 1.0 };
        let w = weight * s.fsj.width();
        size += w * dz;
        mf += w * 0.5 * (s.fsj.lo + s.fsj.hi);
        mz += w * s.zeta;
    }
    let total: f64 = if dz > 0.0 { size / dz } else { 0.0 };
    let centroid = if total > 0.0 {
        (mf / total, mz / total)
    } else {
        (0.5 * (fsj.lo + fsj.hi), 0.5 * (zeta.lo + zeta.hi))
    };
    Some(Area {
        strips,
        fsj,
        zeta,
        centroid,
        size,
    })
}

/// Region of one map alone on `lines` lines of zeta, for drawings.
pub fn region(map: &FailureMap, value: f64, zetas: impl Iterator<Item = f64>) -> Vec<Strip> {
    let cut = Cut { map, value };
    zetas
        .filter_map(|zeta| cut.interval(zeta).map(|fsj| Strip { zeta, fsj }))
        .collect()
}

/// The paper's algorithm on all maps of a set.
///
/// * `features` measured, over the set's nominal run
/// * `missing` what the telemetry lacks, in words; empty if nothing
pub fn diagnose(set: &FailureMapSet, features: &Features, missing: &[String]) -> Diagnosis {
    let measured = |m: &FailureMap| features.get(m.feature).filter(|v| v.is_finite());
    let cuts: Vec<Cut<'_>> = set
        .maps
        .iter()
        .filter_map(|map| measured(map).map(|value| Cut { map, value }))
        .collect();
    let done = |outcome| Diagnosis {
        outcome,
        features: *features,
    };
    let mut lacking: Vec<String> = missing.to_vec();
    for m in &set.maps {
        if let Some(v) = features.get(m.feature).filter(|v| !v.is_finite()) {
            lacking.push(format!("{} is {v}", m.feature.name()));
        }
    }
    if cuts.len() < set.maps.len() || !lacking.is_empty() {
        if lacking.is_empty() {
            let absent = set
                .maps
                .iter()
                .filter(|m| measured(m).is_none())
                .map(|m| m.feature.name());
            lacking.push(format!("no value of {}", absent.collect::<Vec<_>>().join(", ")));
        }
        let area = if cuts.len() >= 2 { intersect(&cuts) } else { None };
        return done(Outcome::Incomplete {
            reason: lacking.join("; "),
            area,
        });
    }
    if cuts.len() < 2 {
        let reason = format!("{} map(s); a diagnosis needs at least two", cuts.len());
        return done(Outcome::Incomplete { reason, area: None });
    }
    // beyond every curve of a map
    let beyond: Vec<String> = cuts
        .iter()
        .filter_map(|c| {
            let (lo, hi) = c.map.range();
            let m = c.map;
            let (f, z) = (
                [m.fsj[0], m.fsj[m.fsj.len() - 1]],
                [m.zeta[0], m.zeta[m.zeta.len() - 1]],
            );
            let h = f
                .iter()
                .flat_map(|f| z.iter().map(|z| m.half_width(*f, *z)))
                .fold(0.0_f64, f64::max);
            let text = |side: &str, end: f64| {
                format!(
                    "{} = {:.5e} {} is {side} the map's end {end:.5e}",
                    c.map.feature.name(),
                    c.value,
                    c.map.feature.unit()
                )
            };
            if c.value - h > hi {
                Some(text("above", hi))
            } else if c.value + h < lo {
                Some(text("below", lo))
            } else {
                None
            }
        })
        .collect();
    if let Some(area) = intersect(&cuts) {
        return done(Outcome::Located(area));
    }
    // would the maps meet if they went on?
    let wide: Vec<FailureMap> = cuts.iter().map(|c| c.map.extended(0.25)).collect();
    let wide_cuts: Vec<Cut<'_>> = wide
        .iter()
        .zip(&cuts)
        .map(|(map, c)| Cut { map, value: c.value })
        .collect();
    if let Some(area) = intersect(&wide_cuts) {
        let map = cuts[0].map;
        let mut sides = Vec::new();
        let (f0, f1) = (map.fsj[0], map.fsj[map.fsj.len() - 1]);
        let z1 = map.zeta[map.zeta.len() - 1];
        if area.fsj.lo > f1 || area.centroid.0 > f1 {
            sides.push(format!("FSJ above {f1} (about {:.2})", area.centroid.0));
        }
        if area.fsj.hi < f0 || area.centroid.0 < f0 {
            sides.push(format!("FSJ below {f0} (about {:.2})", area.centroid.0));
        }
        if area.centroid.1 > z1 {
            sides.push(format!("zeta above {z1} (about {:.3})", area.centroid.1));
        }
        if !sides.is_empty() {
            return done(Outcome::OutOfRange {
                reason: sides.join(", "),
            });
        }
    }
    if !beyond.is_empty() {
        return done(Outcome::OutOfRange {
            reason: beyond.join("; "),
        });
    }
    let (contradicting, reason) = contradiction(cuts);
    done(Outcome::Unexplained { contradicting, reason })
}

/// Which maps contradict each other: the one without which the rest agree, or the pairs that have
/// nothing in common.
fn contradiction(cuts: Vec<Cut<'_>>) -> (Vec<Feature>, String) {
    let name = |f: Feature| f.name();
    let without = |skip: usize| -> Vec<Cut<'_>> {
        let rest = cuts.iter().enumerate().filter(|&(i, _)| i != skip);
        rest.map(|(_, c)| Cut {
            map: c.map,
            value: c.value,
        })
        .collect()
    };
    if cuts.len() > 2 {
        let odd: Vec<Feature> = (0..cuts.len())
            .filter(|&i| intersect(&without(i)).is_some())
            .map(|i| cuts[i].map.feature)
            .collect();
        if !odd.is_empty() {
            let names: Vec<&str> = odd.iter().map(|&f| name(f)).collect();
            let reason = format!(
                "no fault pair fits all maps; without {} the others agree",
                names.join(" or without ")
            );
            return (odd, reason);
        }
    }
    let mut involved = Vec::new();
    let mut pairs = Vec::new();
    for i in 0..cuts.len() {
        for j in i + 1..cuts.len() {
            let pair = [i, j].map(|k| Cut {
                map: cuts[k].map,
                value: cuts[k].value,
            });
            if intersect(&pair).is_none() {
                let (a, b) = (cuts[i].map.feature, cuts[j].map.feature);
                pairs.push(format!("{} and {}", name(a), name(b)));
                involved.extend([a, b]);
            }
        }
    }
    involved.sort();
    involved.dedup();
    if involved.is_empty() {
        involved = cuts.iter().map(|c| c.map.feature).collect();
        pairs.push("any three of them".into());
    }
    (
        involved,
        format!(
            "no fault pair fits all maps; nothing in common have {}",
            pairs.join("; ")
        ),
    )
}
