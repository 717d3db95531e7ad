//! Guaranteed two-dimensional set inversion of a joint of monotone feature surfaces.
//!
//! The set S = { (FSJ, zeta) : Q <= T and every band holds } is enclosed between boxes proved inside and boxes not
//! proved outside, after L. Jaulin, E. Walter: Set inversion via interval analysis for nonlinear bounded-error
//! estimation, Automatica 29(4), 1993. FSJ [-] and zeta [-] throughout; areas are in FSJ times zeta [-].
//!
//! Three facts make it quick. (1) A monotone surface takes its extremes over a lattice block at the block's corners, so
//! blocks out of band go at once. (2) In a lattice cell the whitened residuals are bilinear, so Q is a biquadratic
//! polynomial: nine Bernstein coefficients, whose least bounds Q from below. (3) Along an axis Q is a convex
//! parabola, so a cell is cut into strips, not bisected into squares: where both edges of a strip satisfy Q <= T the
//! strip is inside, and where the edges' parabolas and their blossom all exceed T it is outside; both ends are square
//! roots. Q does not change if the residuals are rotated, so no alignment is needed.

mod parts;
mod strip;
mod surface;
#[cfg(test)]
mod tests;

use crate::uncertainty::{MOST, Row};
use parts::Tally;
use schemas::fault::Interval;
use strip::{Bands, Cell, Strip};
use surface::Inverse;
pub use surface::{Joint, Lattice};

type Span = (f64, f64);

const EMPTY: Span = (f64::INFINITY, f64::NEG_INFINITY);
/// Most strips that one strip is cut into in one pass.
const MOST_CUTS: f64 = 6.0;
/// Share of the tolerated undecided area aimed at, so that one pass too many is rare.
const EAGER: f64 = 0.95;
/// Strips below this share of a lattice cell are not cut further.
const THINNEST: f64 = 1e-9;

fn meet(a: Span, b: Span) -> Span {
    (if a.0 > b.0 { a.0 } else { b.0 }, if a.1 < b.1 { a.1 } else { b.1 })
}

fn join(a: Span, b: Span) -> Span {
    (if a.0 < b.0 { a.0 } else { b.0 }, if a.1 > b.1 { a.1 } else { b.1 })
}

/// Exact at both ends, so that neighbouring cells share their edges to the last bit.
fn lerp(span: Span, t: f64) -> f64 {
    span.0 * (1.0 - t) + span.1 * t
}

fn dot(a: &Row, b: &Row) -> f64 {
    const { assert!(MOST == 12, "four sums of three, and a bit of `live` for each") };
    let p: [f64; 4] = std::array::from_fn(|k| a[k] * b[k] + a[k + 4] * b[k + 4] + a[k + 8] * b[k + 8]);
    (p[0] + p[1]) + (p[2] + p[3])
}

/// An axis-aligned box, FSJ [-] by zeta [-].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Limits {
    /// Lower and upper FSJ [-].
    pub f: (f64, f64),
    /// Lower and upper zeta [-].
    pub z: (f64, f64),
}

impl Limits {
    const NONE: Self = Self { f: EMPTY, z: EMPTY };

    fn join(&mut self, other: &Self) {
        (self.f, self.z) = (join(self.f, other.f), join(self.z, other.z));
    }

    fn holds(&self, other: &Self) -> bool {
        (self.f.0 <= other.f.0) & (other.f.1 <= self.f.1) & (self.z.0 <= other.z.0) & (other.z.1 <= self.z.1)
    }

    /// How far `other` reaches beyond this box, the worst side, in shares of `width` = (FSJ, zeta).
    fn excess(&self, other: &Self, width: (f64, f64)) -> f64 {
        let f = (self.f.0 - other.f.0).max(other.f.1 - self.f.1) / width.0;
        f.max((self.z.0 - other.z.0).max(other.z.1 - self.z.1) / width.1)
    }
}

/// When to stop.
#[derive(Clone, Copy, Debug)]
pub struct Goal {
    /// Largest (outer - inner) / outer area [-].
    pub area_tolerance: f64,
    /// Furthest the outer hull may reach beyond the inner hull, each side, in shares of the outer hull's width [-].
    pub hull_tolerance: f64,
    /// Most boxes.
    pub box_budget: usize,
}

impl Default for Goal {
    fn default() -> Self {
        Self {
            area_tolerance: 0.05,
            hull_tolerance: 0.005,
            box_budget: 20_000,
        }
    }
}

/// One box of a paving: all of it in S (`inside`) or undecided.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PavedBox {
    /// along FSJ
    pub fsj: Interval,
    /// along zeta
    pub zeta: Interval,
    /// proved to lie in S; else undecided
    pub inside: bool,
}

impl PavedBox {
    fn new(f: Span, z: Span, inside: bool) -> Self {
        let (fsj, zeta) = (interval(f), interval(z));
        Self { fsj, zeta, inside }
    }
}

fn interval((lo, hi): Span) -> Interval {
    Interval { lo, hi }
}

/// A connected part of a paving; one without inner area may hold no solution.
#[derive(Clone, Debug, PartialEq)]
pub struct Part {
    /// Hull, encloses the part.
    pub fsj: Interval,
    /// The same along zeta.
    pub zeta: Interval,
    /// Hull of the boxes inside, if any.
    pub inner_hull: Option<Limits>,
    /// Area in FSJ times zeta, enclosed from within and from without.
    pub inner: f64,
    /// From without.
    pub outer: f64,
    /// (FSJ, zeta) [-]; undecided boxes count half, the hull's centre if there is no area.
    pub centroid: (f64, f64),
}

/// The boxes enclose S and those inside are enclosed by S.
#[derive(Clone, Debug)]
pub struct Paving {
    /// they cover S
    pub boxes: Vec<PavedBox>,
    /// all parts together
    pub whole: Part,
    /// Separated parts, the largest outer area first.
    pub parts: Vec<Part>,
    /// Area tolerance reached [-].
    pub area_gap: f64,
    /// Hull tolerance reached [-], infinite without a box inside.
    pub hull_gap: f64,
}

/// Paves; keeps its working memory from one call to the next.
#[derive(Default)]
pub struct Paver {
    inverse: Option<Inverse>,
    blocks: Vec<[u32; 4]>,
    cells: Vec<Cell>,
    strips: Vec<Strip>,
    /// Strips with undecided area.
    open: Vec<u32>,
    before: Vec<u32>,
    /// How many strips each open one is cut into.
    cuts: Vec<u32>,
    /// Parents of the strips, for the parts.
    parents: Vec<u32>,
    rim: Vec<u32>,
    rim_ends: Vec<u32>,
    grid: Vec<u32>,
    part_of: Vec<u32>,
}

impl Paver {
    /// A paver without working memory yet.
    pub fn new() -> Self {
        Self::default()
    }

    /// Encloses the set of (FSJ, zeta) in `domain` where Q <= T and each feature lies in its band (lower, upper; use
    /// infinities for none). `None` proves the set empty. Panics if W or the offset is not finite.
    pub fn pave(
        &mut self,
        lattice: &Lattice,
        joint: &Joint,
        bands: &[(f64, f64); MOST],
        domain: &Limits,
        goal: &Goal,
    ) -> Option<Paving> {
        self.cells.clear();
        self.strips.clear();
        self.open.clear();
        // Rounding of a feature, and from it of a band.
        let widen = |i: usize, sign: f64| {
            let slack = sign * 1e-12 * lattice.peak[i];
            (bands[i].0 - slack, bands[i].1 + slack)
        };
        let bands = Bands {
            inner: std::array::from_fn(|i| widen(i, -1.0)),
            outer: std::array::from_fn(|i| widen(i, 1.0)),
        };
        let settled = self.search(lattice, joint, &bands, domain);
        let (whole, area_gap, hull_gap) = self.refine(settled, &bands, goal);
        if whole.hull.f.0 > whole.hull.f.1 {
            return None;
        }
        let boxes = self.boxes();
        Some(Paving {
            boxes,
            whole: whole.part(),
            parts: self.parts(&whole),
            area_gap,
            hull_gap,
        })
    }

    /// Finds the lattice cells that may hold part of S; returns those wholly inside.
    fn search(&mut self, lattice: &Lattice, joint: &Joint, bands: &Bands, domain: &Limits) -> Tally {
        let mut settled = Tally::NONE;
        let ends = |axis: &[f64], span: Span| {
            let last = axis.len() - 1;
            let span = (span.0.max(axis[0]), span.1.min(axis[last]));
            let low = axis.partition_point(|&x| x <= span.0).clamp(1, last) - 1;
            let high = axis.partition_point(|&x| x < span.1).clamp(low + 1, last);
            (span, low as u32, high as u32)
        };
        let (f, i0, i1) = ends(&lattice.fsj, domain.f);
        let (z, j0, j1) = ends(&lattice.zeta, domain.z);
        assert!(!joint.threshold.is_nan(), "threshold must be a number");
        if !(f.0 < f.1 && z.0 < z.1 && joint.threshold >= 0.0) {
            return settled;
        }
        let threshold = joint.threshold.min(1e300);
        let (low, high) = self.reach(joint, threshold, bands);
        // z is a difference of terms of this size; its rounding times twice z is that of Q.
        let scale: Row = std::array::from_fn(|k| {
            (0..MOST).map(|i| (joint.w[k][i] * lattice.peak[i]).abs()).sum::<f64>() + joint.offset[k].abs()
        });
        let scale = 1e-14 * dot(&scale, &scale).sqrt();
        assert!(scale.is_finite(), "whitening and offset must be finite");
        let columns: [Row; MOST] = std::array::from_fn(|i| std::array::from_fn(|k| joint.w[k][i]));
        let used: [bool; MOST] = columns.map(|c| c.iter().any(|&x| x != 0.0));

        self.blocks.clear();
        self.blocks.push([i0, i1, j0, j1]);
        while let Some([i0, i1, j0, j1]) = self.blocks.pop() {
            let corners = lattice.corners(i0 as usize, i1 as usize, j0 as usize, j1 as usize);
            if misses(corners, &low, &high) {
                continue;
            }
            if i1 - i0 > 1 && i1 - i0 >= j1 - j0 {
                let mid = (i0 + i1) / 2;
                self.blocks.extend([[i0, mid, j0, j1], [mid, i1, j0, j1]]);
                continue;
            } else if j1 - j0 > 1 {
                let mid = (j0 + j1) / 2;
                self.blocks.extend([[i0, i1, j0, mid], [i0, i1, mid, j1]]);
                continue;
            }
            let (i, j) = (i0 as usize, j0 as usize);
            let whole = Limits {
                f: (lattice.fsj[i], lattice.fsj[i + 1]),
                z: (lattice.zeta[j], lattice.zeta[j + 1]),
            };
            let span = Limits {
                f: meet(whole.f, f),
                z: meet(whole.z, z),
            };
            let m = if span == whole {
                corners.map(|m| *m)
            } else {
                let ((a, b), (c, d)) = (span.f, span.z);
                [(a, c), (b, c), (a, d), (b, d)].map(|(f, z)| lattice.in_cell(i, j, f, z))
            };
            let mut r = [joint.offset; 4];
            for (i, column) in columns.iter().enumerate().filter(|c| used[c.0]) {
                for (r, m) in r.iter_mut().zip(&m) {
                    for (r, w) in r.iter_mut().zip(column) {
                        *r -= w * m[i];
                    }
                }
            }
            let index = self.cells.len() as u32;
            let Some(cell) = Cell::new(span, (i0, j0), m, &r, threshold, scale, bands) else {
                continue;
            };
            let strip = cell.whole(index, bands);
            if !strip.is_empty() {
                self.cells.push(cell);
                self.strips.push(strip);
                settle(&strip, index, &mut self.open, &mut settled);
            }
        }
        settled
    }

    /// Row that S may have: the bands, narrowed to where the joint can hold at all.
    fn reach(&mut self, joint: &Joint, threshold: f64, bands: &Bands) -> (Row, Row) {
        if self.inverse.as_ref().is_none_or(|known| known.w != joint.w) {
            self.inverse = Some(Inverse::new(&joint.w));
        }
        let (mut low, mut high) = (bands.outer.map(|b| b.0), bands.outer.map(|b| b.1));
        if let Some(rows) = self.inverse.as_ref().and_then(|known| known.rows.as_ref()) {
            for (i, row) in rows.iter().enumerate() {
                let length = dot(row, row).sqrt();
                if length > 0.0 {
                    let (centre, size) = (dot(row, &joint.offset), dot(&joint.offset, &joint.offset).sqrt());
                    let half = length * (threshold.sqrt() * (1.0 + 1e-9) + 1e-9 * size);
                    (low[i], high[i]) = meet((low[i], high[i]), (centre - half, centre + half));
                }
            }
        }
        (low, high)
    }

    /// Cuts undecided strips until the goal is met: the many for the area, those that reach out for the hull.
    fn refine(&mut self, mut settled: Tally, bands: &Bands, goal: &Goal) -> (Tally, f64, f64) {
        loop {
            let (mut sum, mut roots) = (settled, 0.0);
            for &at in &self.open {
                let strip = &self.strips[at as usize];
                sum.add(strip);
                roots += strip.root;
            }
            let (area_gap, hull_gap) = sum.gaps();
            let (area_met, hull_met) = (area_gap <= goal.area_tolerance, hull_gap <= goal.hull_tolerance);
            // A strip cut in n leaves about 1/n of its undecided area, so the fewest strips leave the tolerated area
            // when each is cut in proportion to the root of its own.
            let share = if area_met {
                0.0
            } else {
                roots / (goal.area_tolerance * sum.outer)
            };
            let (inner, width) = (sum.inner_hull, sum.width());
            // A little less than tolerated, so that rounding leaves none between.
            let reach = (
                0.99 * goal.hull_tolerance * width.0,
                0.99 * goal.hull_tolerance * width.1,
            );
            let near = Limits {
                f: (inner.f.0 - reach.0, inner.f.1 + reach.0),
                z: (inner.z.0 - reach.1, inner.z.1 + reach.1),
            };
            // A strip makes three boxes at most.
            let room = (goal.box_budget / 3).saturating_sub(self.strips.len());
            let mut planned = 0;
            for share in [share, 0.5 * share, 0.0] {
                self.cuts.clear();
                planned = 0;
                let mut excess = sum.outer - sum.inner - EAGER * goal.area_tolerance * sum.outer;
                for &at in &self.open {
                    let strip = &self.strips[at as usize];
                    let mut cuts = if excess > 0.0 {
                        (strip.root * share).min(MOST_CUTS)
                    } else {
                        1.0
                    };
                    if !hull_met && !near.holds(&strip.outer) {
                        cuts =
                            cuts.max((inner.excess(&strip.outer, width) / goal.hull_tolerance).clamp(2.0, MOST_CUTS));
                    }
                    let floor = cuts as u32;
                    let ceil = floor + u32::from(cuts > f64::from(floor));
                    let cuts = if strip.v.1 - strip.v.0 > THINNEST {
                        ceil.max(1)
                    } else {
                        1
                    };
                    excess -= strip.root * strip.root * (1.0 - 1.0 / f64::from(cuts));
                    planned += cuts as usize - 1;
                    self.cuts.push(cuts);
                }
                if (1..=room).contains(&planned) {
                    break;
                }
            }
            if !(1..=room).contains(&planned) || (area_met && hull_met) {
                return (sum, area_gap, hull_gap);
            }
            std::mem::swap(&mut self.open, &mut self.before);
            self.open.clear();
            for k in 0..self.before.len() {
                let (at, n) = (self.before[k], self.cuts[k]);
                if n > 1 {
                    self.cut(at, n, bands, &mut settled)
                } else {
                    self.open.push(at)
                }
            }
        }
    }

    /// Cuts a strip in `n`, the lowest of them in its place.
    fn cut(&mut self, at: u32, n: u32, bands: &Bands, settled: &mut Tally) {
        let old = self.strips[at as usize];
        let cell = &self.cells[old.cell as usize];
        let (mut low, mut edge) = (old.v.0, old.edges.0);
        for k in 1..=n {
            let v = if k == n {
                old.v.1
            } else {
                lerp(old.v, f64::from(k) / f64::from(n))
            };
            let upper = if k == n { old.edges.1 } else { cell.edge(v) };
            let mut strip = cell.strip(old.cell, (low, v), (edge, upper), bands);
            let end = self.strips.len() as u32;
            let index = if k == 1 { at } else { end };
            strip.next = match k {
                _ if k == n => old.next,
                1 => end,
                _ => end + 1,
            };
            if k == 1 {
                self.strips[at as usize] = strip;
            } else {
                self.strips.push(strip);
            }
            settle(&strip, index, &mut self.open, settled);
            (low, edge) = (v, upper);
        }
    }

    fn boxes(&self) -> Vec<PavedBox> {
        let mut boxes = Vec::with_capacity(2 * self.open.len() + self.strips.len());
        for strip in self.strips.iter().filter(|s| !s.is_empty()) {
            let (o, i, turned) = (strip.outer, strip.inner, self.cells[strip.cell as usize].turned);
            if i.f.0 > i.f.1 {
                boxes.push(PavedBox::new(o.f, o.z, false));
                continue;
            }
            boxes.push(PavedBox::new(i.f, i.z, true));
            let (outer, inner) = if turned { (o.z, i.z) } else { (o.f, i.f) };
            for side in [(outer.0, inner.0), (inner.1, outer.1)]
                .into_iter()
                .filter(|s| s.0 < s.1)
            {
                let (f, z) = if turned { (o.f, side) } else { (side, o.z) };
                boxes.push(PavedBox::new(f, z, false));
            }
        }
        boxes
    }
}

/// Files a strip that holds part of S: closed if it is all inside, open otherwise.
fn settle(strip: &Strip, index: u32, open: &mut Vec<u32>, settled: &mut Tally) {
    if !strip.is_empty() {
        if strip.outer == strip.inner {
            settled.add(strip)
        } else {
            open.push(index)
        }
    }
}

/// Whether a block's features stay beyond `low`..`high`: monotone surfaces take their extremes at its corners.
fn misses(corners: [&Row; 4], low: &Row, high: &Row) -> bool {
    let [a, b, c, d] = corners;
    let mut miss = false;
    for k in 0..MOST {
        let (least, most) = join(join((a[k], a[k]), (b[k], b[k])), join((c[k], c[k]), (d[k], d[k])));
        miss |= (most < low[k]) | (least > high[k]);
    }
    miss
}
