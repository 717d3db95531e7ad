//! Sums over strips and the connected parts they form.
use super::strip::{Cell, Strip};
use super::{Limits, Part, Paver, Span, interval};

/// Areas, hulls and moments of some strips.
#[derive(Clone, Copy)]
pub(super) struct Tally {
    pub hull: Limits,
    pub inner_hull: Limits,
    pub inner: f64,
    pub outer: f64,
    moment: (f64, f64),
}

impl Tally {
    pub const NONE: Self = Self {
        hull: Limits::NONE,
        inner_hull: Limits::NONE,
        inner: 0.0,
        outer: 0.0,
        moment: (0.0, 0.0),
    };

    pub fn add(&mut self, strip: &Strip) {
        let (i, o) = strip.areas;
        self.hull.join(&strip.outer);
        self.outer += o;
        let centre = |a: Span, b: Span| o * (a.0 + a.1) + if i > 0.0 { i * (b.0 + b.1) } else { 0.0 };
        // Half the outer and half the inner box: the inner part counts in full and the rest half.
        self.moment.0 += centre(strip.outer.f, strip.inner.f);
        self.moment.1 += centre(strip.outer.z, strip.inner.z);
        if i > 0.0 {
            self.inner_hull.join(&strip.inner);
            self.inner += i;
        }
    }

    pub fn part(&self) -> Part {
        let weight = 2.0 * (self.outer + self.inner);
        let mean = |m: f64, h: Span| {
            if weight > 0.0 {
                (m / weight).clamp(h.0, h.1)
            } else {
                0.5 * (h.0 + h.1)
            }
        };
        Part {
            fsj: interval(self.hull.f),
            zeta: interval(self.hull.z),
            inner_hull: (self.inner > 0.0).then_some(self.inner_hull),
            inner: self.inner,
            outer: self.outer,
            centroid: (mean(self.moment.0, self.hull.f), mean(self.moment.1, self.hull.z)),
        }
    }

    pub fn gaps(&self) -> (f64, f64) {
        let hull_gap = self.inner_hull.excess(&self.hull, self.width());
        (
            if self.outer > 0.0 {
                (self.outer - self.inner) / self.outer
            } else {
                1.0
            },
            hull_gap,
        )
    }

    pub fn width(&self) -> (f64, f64) {
        (self.hull.f.1 - self.hull.f.0, self.hull.z.1 - self.hull.z.0)
    }
}

impl Paver {
    /// Joins strips that touch: along the cells first, then those on the rims of neighbouring cells.
    pub(super) fn parts(&mut self, whole: &Tally) -> Vec<Part> {
        let slack = (1e-12 * whole.width().0, 1e-12 * whole.width().1);
        let meets = |a: Span, b: Span, slack: f64| a.0 <= b.1 + slack && b.0 <= a.1 + slack;
        let touch = |a: &Limits, b: &Limits| meets(a.f, b.f, slack.0) && meets(a.z, b.z, slack.1);
        self.parents.clear();
        self.rim.clear();
        self.rim_ends.clear();
        self.parents.extend(0..self.strips.len() as u32);
        let mut count = 0;
        for (first, cell) in self.cells.iter().enumerate() {
            let (mut at, c) = (first as u32, &cell.span);
            while at != u32::MAX {
                let strip = &self.strips[at as usize];
                let (o, next) = (&strip.outer, strip.next);
                if !strip.is_empty() {
                    count += 1;
                    if next != u32::MAX && touch(o, &self.strips[next as usize].outer) {
                        count -= usize::from(unite(&mut self.parents, at, next));
                    }
                    if o.f.0 <= c.f.0 || o.f.1 >= c.f.1 || o.z.0 <= c.z.0 || o.z.1 >= c.z.1 {
                        self.rim.push(at);
                    }
                }
                at = next;
            }
            self.rim_ends.push(self.rim.len() as u32);
        }
        if count > 1 && self.cells.len() > 1 {
            count = self.join_cells(count, touch);
        }
        if count == 1 {
            return vec![whole.part()];
        }
        let mut tallies: Vec<Tally> = Vec::with_capacity(count);
        self.part_of.clear();
        self.part_of.resize(self.strips.len(), u32::MAX);
        for at in 0..self.strips.len() {
            if !self.strips[at].is_empty() {
                let root = root(&mut self.parents, at as u32) as usize;
                if self.part_of[root] == u32::MAX {
                    self.part_of[root] = tallies.len() as u32;
                    tallies.push(Tally::NONE);
                }
                tallies[self.part_of[root] as usize].add(&self.strips[at]);
            }
        }
        tallies.sort_by(|a, b| b.outer.total_cmp(&a.outer));
        tallies.iter().map(Tally::part).collect()
    }

    /// Joins strips that touch across the rims of cells; returns how many of `count` parts are left.
    fn join_cells(&mut self, mut count: usize, touch: impl Fn(&Limits, &Limits) -> bool) -> usize {
        let (mut low, mut high) = ((u32::MAX, u32::MAX), (0, 0));
        for Cell { at, .. } in &self.cells {
            low = (low.0.min(at.0), low.1.min(at.1));
            high = (high.0.max(at.0), high.1.max(at.1));
        }
        // A border of one around the cells, so that each has all its neighbours.
        let columns = (high.0 - low.0) as usize + 3;
        let place = |at: (u32, u32)| (at.1 - low.1 + 1) as usize * columns + (at.0 - low.0 + 1) as usize;
        self.grid.clear();
        self.grid.resize(columns * ((high.1 - low.1) as usize + 3), u32::MAX);
        for (k, cell) in self.cells.iter().enumerate() {
            self.grid[place(cell.at)] = k as u32;
        }
        let rim = |k: usize| {
            let start = if k == 0 { 0 } else { self.rim_ends[k - 1] };
            &self.rim[start as usize..self.rim_ends[k] as usize]
        };
        for (k, cell) in self.cells.iter().enumerate() {
            let here = place(cell.at);
            for there in [here + 1, here + columns - 1, here + columns, here + columns + 1] {
                let there = self.grid[there];
                if there == u32::MAX {
                    continue;
                }
                let there = there as usize;
                let beside = |a: &&u32| touch(&self.strips[**a as usize].outer, &self.cells[there].span);
                for &a in rim(k).iter().filter(beside) {
                    for &b in rim(there) {
                        if touch(&self.strips[a as usize].outer, &self.strips[b as usize].outer) {
                            count -= usize::from(unite(&mut self.parents, a, b));
                        }
                    }
                }
                if count == 1 {
                    return count;
                }
            }
        }
        count
    }
}

fn root(parents: &mut [u32], mut at: u32) -> u32 {
    while parents[at as usize] != at {
        let up = parents[parents[at as usize] as usize];
        parents[at as usize] = up;
        at = up;
    }
    at
}

/// Whether the two were apart.
fn unite(parents: &mut [u32], a: u32, b: u32) -> bool {
    let (a, b) = (root(parents, a), root(parents, b));
    parents[a as usize] = b;
    a != b
}
