//! Lattice cells cut into strips: the local algebra of the set inversion.
use super::{EMPTY, Limits, MOST, Row, Span, join, lerp, meet};

/// Where Q <= T along one edge of a strip, a span of the cell's u, with T lessened and raised by the rounding.
#[derive(Clone, Copy)]
pub(super) struct Edge {
    inner: Span,
    outer: Span,
}

/// The cell between two of its v: nothing of S in it lies beyond `outer`, all of `inner` is in S.
#[derive(Clone, Copy)]
pub(super) struct Strip {
    pub cell: u32,
    /// Next strip up the same cell; a cell's strips follow each other without a gap, its first one has its index.
    pub next: u32,
    pub v: Span,
    pub edges: (Edge, Edge),
    pub outer: Limits,
    pub inner: Limits,
    /// Areas of `inner` and `outer`.
    pub areas: (f64, f64),
    /// Square root of the undecided area.
    pub root: f64,
}

impl Strip {
    pub fn is_empty(&self) -> bool {
        self.outer.f.0 > self.outer.f.1
    }
}

/// A lattice cell within the domain, in its own u and v, each 0..1.
pub(super) struct Cell {
    pub span: Limits,
    /// Indices of its lower node along (FSJ, zeta).
    pub at: (u32, u32),
    /// Whether u runs along zeta: strips lie across the boundary of S, not along it.
    pub turned: bool,
    /// Bernstein coefficients of Q, v first.
    q: [[f64; 3]; 3],
    /// T less and T plus the rounding.
    threshold: Span,
    /// Row at the corners, u first, for the bands that matter here (`live`, a bit for each).
    m: [Row; 4],
    live: u16,
    /// Whether all of the cell has Q <= T.
    full: bool,
}

/// Admitted features, narrowed and widened by the rounding.
pub(super) struct Bands {
    pub inner: [Span; MOST],
    pub outer: [Span; MOST],
}

/// Hull of { u in 0..1 : parabola <= t } from its Bernstein coefficients.
#[inline]
fn below(q: [f64; 3], t: f64) -> Span {
    let (c, m, e) = (q[0] - t, q[1] - t, q[2] - t);
    if c <= 0.0 && e <= 0.0 {
        return (0.0, 1.0);
    }
    let (bend, square) = (c - 2.0 * m + e, m * m - c * e);
    let valley = bend > 0.0 && m < c && m < e && square >= 0.0;
    if c > 0.0 && e > 0.0 && !valley {
        return EMPTY;
    }
    // Where the parabola from c to e rises through zero, reckoned from the end that does not cancel.
    let s = square.max(0.0).sqrt();
    let rise = |c: f64, e: f64| {
        if bend >= 0.0 {
            1.0 - e / (s + (e - m))
        } else {
            -c / (s + (m - c))
        }
    };
    let low = if c <= 0.0 {
        0.0
    } else {
        (1.0 - rise(e, c)).clamp(0.0, 1.0)
    };
    let high = if e <= 0.0 { 1.0 } else { rise(c, e).clamp(0.0, 1.0) };
    (low, high)
}

/// { u in 0..1 : the line from `a` to `b` >= t }.
fn above(a: f64, b: f64, t: f64) -> Span {
    match (a >= t, b >= t) {
        (true, true) => (0.0, 1.0),
        (false, false) => EMPTY,
        (from_start, _) => {
            let u = ((t - a) / (b - a)).clamp(0.0, 1.0);
            if from_start { (0.0, u) } else { (u, 1.0) }
        }
    }
}

impl Cell {
    /// The cell over `span` with features `m` at its corners (FSJ first) and residuals `r` there; `None` if Q > T all
    /// over. `scale` times the size of a residual is the rounding of Q.
    pub fn new(
        span: Limits,
        at: (u32, u32),
        mut m: [Row; 4],
        r: &[Row; 4],
        threshold: f64,
        scale: f64,
        bands: &Bands,
    ) -> Option<Self> {
        let pair = |a: usize, b: usize| super::dot(&r[a], &r[b]);
        let mut q = [
            [pair(0, 0), pair(0, 1), pair(1, 1)],
            [pair(0, 2), 0.5 * (pair(0, 3) + pair(1, 2)), pair(1, 3)],
            [pair(2, 2), pair(2, 3), pair(3, 3)],
        ];
        let top = q[0][0].max(q[0][2]).max(q[2][0].max(q[2][2]));
        let slack = 1e-12 * threshold + scale * top.sqrt();
        let least = q
            .iter()
            .flatten()
            .fold(f64::INFINITY, |a, &b| if b < a { b } else { a });
        if least > threshold + slack {
            return None;
        }
        let (mut live, mut lean) = (0, 0.0);
        for (k, band) in bands.inner.iter().enumerate() {
            let [a, b, c, d] = [m[0][k], m[1][k], m[2][k], m[3][k]];
            let (low, high) = join(join((a, a), (b, b)), join((c, c), (d, d)));
            if !(band.0 <= low && high <= band.1) {
                live |= 1 << k;
                // How much more the surface changes along v than along u, whatever its unit.
                let change = (c - a).abs() + (d - b).abs() - (b - a).abs() - (d - c).abs();
                lean += change / (high - low).max(f64::MIN_POSITIVE);
            }
        }
        let full = top <= threshold - slack;
        let slope = |a: f64, b: f64, c: f64| (b - a).abs() + (c - b).abs();
        let along_u = slope(q[0][0], q[0][1], q[0][2]) + slope(q[2][0], q[2][1], q[2][2]);
        let along_v = slope(q[0][0], q[1][0], q[2][0]) + slope(q[0][2], q[1][2], q[2][2]);
        let turned = if full { lean > 0.0 } else { along_v > along_u };
        if turned {
            m.swap(1, 2);
            q = std::array::from_fn(|a| std::array::from_fn(|b| q[b][a]));
        }
        Some(Self {
            span,
            at,
            turned,
            q,
            threshold: (threshold - slack, threshold + slack),
            m,
            live,
            full,
        })
    }

    /// Blossom of Q in v: a parabola in u; with `a` = `b` it is Q itself along the line v = `a`. For a <= v <= b, Q is
    /// a convex combination of the parabolas (a, a), (a, b) and (b, b).
    #[inline]
    fn blossom(&self, a: f64, b: f64) -> [f64; 3] {
        let (x, y, z) = ((1.0 - a) * (1.0 - b), a * (1.0 - b) + b * (1.0 - a), a * b);
        std::array::from_fn(|k| x * self.q[0][k] + y * self.q[1][k] + z * self.q[2][k])
    }

    #[inline]
    pub fn edge(&self, v: f64) -> Edge {
        let q = self.blossom(v, v);
        Edge {
            inner: below(q, self.threshold.0),
            outer: below(q, self.threshold.1),
        }
    }

    /// All of the cell as one strip.
    pub fn whole(&self, cell: u32, bands: &Bands) -> Strip {
        const FULL: Edge = Edge {
            inner: (0.0, 1.0),
            outer: (0.0, 1.0),
        };
        let edges = if self.full {
            (FULL, FULL)
        } else {
            (self.edge(0.0), self.edge(1.0))
        };
        self.strip(cell, (0.0, 1.0), edges, bands)
    }

    #[inline]
    pub fn strip(&self, cell: u32, v: Span, edges: (Edge, Edge), bands: &Bands) -> Strip {
        let mut inner = meet(edges.0.inner, edges.1.inner);
        let mut outer = join(edges.0.outer, edges.1.outer);
        if !self.full {
            outer = join(outer, below(self.blossom(v.0, v.1), self.threshold.1));
        }
        if self.live != 0 {
            (inner, outer) = self.banded(inner, outer, v, bands);
        }
        let (mut areas, mut spans) = ((0.0, 0.0), (Limits::NONE, Limits::NONE));
        if outer.0 <= outer.1 {
            let (base, rise) = if self.turned {
                (self.span.z, self.span.f)
            } else {
                (self.span.f, self.span.z)
            };
            let across = (lerp(rise, v.0), lerp(rise, v.1));
            let place = |u: Span| {
                let along = (lerp(base, u.0), lerp(base, u.1));
                let (f, z) = if self.turned { (across, along) } else { (along, across) };
                ((along.1 - along.0) * (across.1 - across.0), Limits { f, z })
            };
            (areas.1, spans.1) = place(outer);
            inner = meet(inner, outer);
            if inner.0 < inner.1 {
                (areas.0, spans.0) = place(inner);
            }
        }
        let root = (areas.1 - areas.0).max(0.0).sqrt();
        Strip {
            cell,
            next: u32::MAX,
            v,
            edges,
            inner: spans.0,
            outer: spans.1,
            areas,
            root,
        }
    }

    /// Narrows the spans of a strip by the bands.
    #[cold]
    fn banded(&self, mut inner: Span, mut outer: Span, v: Span, bands: &Bands) -> (Span, Span) {
        for i in (0..MOST).filter(|i| self.live >> i & 1 == 1) {
            let ends = |v| {
                (
                    lerp((self.m[0][i], self.m[2][i]), v),
                    lerp((self.m[1][i], self.m[3][i]), v),
                )
            };
            let (a, b) = (ends(v.0), ends(v.1));
            let floor = |t: f64| (above(a.0, a.1, t), above(b.0, b.1, t));
            let roof = |t: f64| (above(-a.0, -a.1, -t), above(-b.0, -b.1, -t));
            for (x, y) in [floor(bands.inner[i].0), roof(bands.inner[i].1)] {
                inner = meet(inner, meet(x, y));
            }
            for (x, y) in [floor(bands.outer[i].0), roof(bands.outer[i].1)] {
                outer = meet(outer, join(x, y));
            }
        }
        (inner, outer)
    }
}
