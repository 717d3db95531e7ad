//! From features to fault intervals (paper 5.1): the band around each P* cuts each curve into an
//! interval of FSJ; intersected over the maps, the cuts of all curves make up the area of
//! possible faults.

use crate::failure_map::{BandKnots, FailureMap, FailureMapSet};
use crate::monotone;
use schemas::fault::Interval;
use schemas::feature::{Feature, Features};

/// Coverage that the bands are made for: the share of tests whose true pair lies in the hull.
pub const COVERAGE: f64 = 0.95;

/// Lines of constant zeta on which an area is looked for: first every [`COARSE`]th, then the others
/// where they may meet one.
const SEARCH_LINES: usize = 64;
const COARSE: usize = 4;
/// Lines on which the area is then measured.
const AREA_LINES: usize = 100;
/// Accuracy of the zetas at which an area ends.
const END_TOLERANCE: f64 = 1e-11;
/// Accuracy of the zeta at which an area thinner than the spacing of the lines is looked for.
const SEED_TOLERANCE: f64 = 1e-10;

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

/// A line of constant zeta and how far the cuts on it are from having a point in common: 0 or less
/// if they have, infinite if one of them holds no point at all.
#[derive(Clone, Copy)]
struct Line {
    zeta: f64,
    gap: f64,
}

impl Line {
    fn meets(&self) -> bool {
        self.gap <= 0.0
    }
}

/// Line `k` of `0..=n` spread evenly over a range.
fn spread(range: Interval, k: usize, n: usize) -> f64 {
    (range.lo + range.width() * k as f64 / n as f64).min(range.hi)
}

/// Looks for what cuts have in common.
struct Search<'a> {
    cuts: &'a [Cut<'a>],
    /// FSJ grid points at which the last line of each cut met its value: upper and lower limit
    near: Vec<(usize, usize)>,
    /// limits of the cut at hand
    knots: BandKnots,
}

impl<'a> Search<'a> {
    fn of(cuts: &'a [Cut<'a>]) -> Self {
        Self {
            cuts,
            near: vec![(0, 0); cuts.len()],
            knots: BandKnots::default(),
        }
    }

    /// Intersection of all cuts at one zeta, possibly less than nothing (`lo` above `hi`); `None`
    /// if one of them holds no point.
    fn common(&mut self, zeta: f64) -> Option<Interval> {
        let (mut lo, mut hi) = (f64::NEG_INFINITY, f64::INFINITY);
        for (Cut { map, value }, near) in self.cuts.iter().zip(&mut self.near) {
            let band = map.band_line(zeta, &mut self.knots);
            let v = map.direction.0 * value;
            // from where the upper limit reaches the value to where the lower one leaves it
            lo = monotone::rises_to(&map.fsj, |k| band.high(k), v, lo, &mut near.0)?;
            hi = monotone::rises_from(&map.fsj, |k| band.low(k), v, hi, &mut near.1)?;
        }
        Some(Interval { lo, hi })
    }

    /// Intersection of all cuts at one zeta, if they have a point in common.
    fn strip(&mut self, zeta: f64) -> Option<Strip> {
        let fsj = self.common(zeta).filter(|i| i.lo <= i.hi)?;
        Some(Strip { zeta, fsj })
    }

    fn line(&mut self, zeta: f64) -> Line {
        let gap = self.common(zeta).map_or(f64::INFINITY, |i| i.lo - i.hi);
        Line { zeta, gap }
    }

    /// The zetas over which the area reaches that the cuts have in common, if any.
    fn extent(&mut self) -> Option<Interval> {
        let mut range = Interval {
            lo: f64::NEG_INFINITY,
            hi: f64::INFINITY,
        };
        for c in self.cuts {
            range = range.meet(c.map.zetas(c.value, &mut self.knots)?)?;
        }
        let mut lines = self.search_lines(range);
        if !lines.iter().any(Line::meets) {
            let zetas = (0..=SEARCH_LINES).map(|k| spread(range, k, SEARCH_LINES));
            lines = zetas.map(|zeta| self.line(zeta)).collect();
        }
        let hits = (lines.iter().position(Line::meets), lines.iter().rposition(Line::meets));
        if let (Some(first), Some(last)) = hits {
            return Some(Interval {
                lo: self.end(lines[first], lines[first.saturating_sub(1)]),
                hi: self.end(lines[last], lines[(last + 1).min(lines.len() - 1)]),
            });
        }
        // an area thinner than the spacing of the lines: look where the gap is smallest
        let best = lines.iter().min_by(|a, b| a.gap.total_cmp(&b.gap))?;
        let step = range.width() / SEARCH_LINES as f64;
        let (below, above) = ((best.zeta - step).max(range.lo), (best.zeta + step).min(range.hi));
        let seed = self.smallest_gap(below, above);
        if !seed.meets() {
            return None;
        }
        let below = self.line((seed.zeta - step).max(range.lo));
        let above = self.line((seed.zeta + step).min(range.hi));
        Some(Interval {
            lo: self.end(seed, below),
            hi: self.end(seed, above),
        })
    }

    /// The coarse lines over a range of zeta, and between two of them the others where the gap is so
    /// small against its changes around that it may vanish in between: an area may have parts.
    fn search_lines(&mut self, range: Interval) -> Vec<Line> {
        let zeta = |k: usize| spread(range, k, SEARCH_LINES);
        let coarse: Vec<Line> = (0..=SEARCH_LINES).step_by(COARSE).map(|k| self.line(zeta(k))).collect();
        let mut lines = Vec::with_capacity(SEARCH_LINES + 1);
        for (i, line) in coarse.iter().enumerate() {
            lines.push(*line);
            let around = &coarse[i.saturating_sub(1)..(i + 3).min(coarse.len())];
            let change = around
                .windows(2)
                .map(|w| (w[1].gap - w[0].gap).abs())
                .fold(0.0, f64::max);
            let Some(next) = coarse.get(i + 1) else { break };
            let apart = line.gap.min(next.gap);
            let (both, none) = (line.gap.max(next.gap) <= 0.0, apart > change);
            if !both && !none {
                lines.extend((1..COARSE).map(|j| self.line(zeta(COARSE * i + j))));
            }
        }
        lines
    }

    /// The end of an area between a line that meets it and one that need not.
    fn end(&mut self, within: Line, beyond: Line) -> f64 {
        if beyond.meets() {
            return beyond.zeta;
        }
        let gap = |zeta: f64| self.line(zeta).gap;
        monotone::last_within(gap, (within.zeta, within.gap), (beyond.zeta, beyond.gap), END_TOLERANCE)
    }

    /// A line between two zetas that meets an area, or else the one with the smallest gap (golden section).
    fn smallest_gap(&mut self, mut a: f64, mut b: f64) -> Line {
        const GOLDEN: f64 = 0.618_033_988_749_894_9;
        let inner = |a: f64, b: f64| b - GOLDEN * (b - a);
        let outer = |a: f64, b: f64| a + GOLDEN * (b - a);
        let (mut c, mut d) = (self.line(inner(a, b)), self.line(outer(a, b)));
        while !c.meets() && !d.meets() && b - a > SEED_TOLERANCE {
            if c.gap < d.gap {
                b = d.zeta;
                d = c;
                c = self.line(inner(a, b));
            } else {
                a = c.zeta;
                c = d;
                d = self.line(outer(a, b));
            }
        }
        if c.gap < d.gap { c } else { d }
    }

    /// The area that the cuts have in common, if any.
    fn area(&mut self) -> Option<Area> {
        let zeta = self.extent()?;
        let strips: Vec<Strip> = (0..=AREA_LINES)
            .filter_map(|k| self.strip(spread(zeta, k, AREA_LINES)))
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
}

/// Region of one map alone on `lines` lines of zeta, for drawings.
pub fn region(map: &FailureMap, value: f64, zetas: impl Iterator<Item = f64>) -> Vec<Strip> {
    let cut = [Cut { map, value }];
    let mut search = Search::of(&cut);
    zetas.filter_map(|zeta| search.strip(zeta)).collect()
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
        let area = if cuts.len() >= 2 {
            Search::of(&cuts).area()
        } else {
            None
        };
        return done(Outcome::Incomplete {
            reason: lacking.join("; "),
            area,
        });
    }
    if cuts.len() < 2 {
        let reason = format!("{} map(s); a diagnosis needs at least two", cuts.len());
        return done(Outcome::Incomplete { reason, area: None });
    }
    if let Some(area) = Search::of(&cuts).area() {
        return done(Outcome::Located(area));
    }
    // would the maps meet if they went on?
    let wide: Vec<FailureMap> = cuts.iter().map(|c| c.map.extended(0.25)).collect();
    let wide_cuts: Vec<Cut<'_>> = wide
        .iter()
        .zip(&cuts)
        .map(|(map, c)| Cut { map, value: c.value })
        .collect();
    if let Some(area) = Search::of(&wide_cuts).area() {
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
    let beyond: Vec<String> = cuts.iter().filter_map(beyond).collect();
    if !beyond.is_empty() {
        return done(Outcome::OutOfRange {
            reason: beyond.join("; "),
        });
    }
    let (contradicting, reason) = contradiction(cuts);
    done(Outcome::Unexplained { contradicting, reason })
}

/// On which side a value lies beyond every curve of its map, if it does.
fn beyond(cut: &Cut<'_>) -> Option<String> {
    let m = cut.map;
    let (lo, hi) = m.range();
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
            m.feature.name(),
            cut.value,
            m.feature.unit()
        )
    };
    if cut.value - h > hi {
        Some(text("above", hi))
    } else if cut.value + h < lo {
        Some(text("below", lo))
    } else {
        None
    }
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
            .filter(|&i| Search::of(&without(i)).extent().is_some())
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
            if Search::of(&pair).extent().is_none() {
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
