//! Monotone cubic interpolation (Fritsch and Carlson 1980; slopes by Butland's weighted harmonic
//! mean, as in PCHIP).

/// Newton's steps on a piece end when this share of its width is left, by the last slope.
const CLOSE_ENOUGH: f64 = 1e-12;
const MOST_STEPS: usize = 60;

/// Slopes at the knots of a monotone (or any) sequence; between two knots the interpolant is
/// monotone, and it has no extremum that the data do not have.
///
/// * `x` strictly rising knots, at least two
/// * `y` values, same length
/// * `d` slopes, written
pub fn slopes(x: &[f64], y: &[f64], d: &mut [f64]) {
    let n = x.len();
    debug_assert!(n >= 2 && y.len() == n && d.len() == n);
    // width and secant of each piece
    let piece = |i: usize| (x[i + 1] - x[i], (y[i + 1] - y[i]) / (x[i + 1] - x[i]));
    if n == 2 {
        d.fill(piece(0).1);
        return;
    }
    for i in 1..n - 1 {
        d[i] = inner_slope(piece(i - 1), piece(i));
    }
    d[0] = end_slope(piece(0), piece(1));
    d[n - 1] = end_slope(piece(n - 2), piece(n - 3));
}

/// Slope at a knot between two pieces (width and secant of each).
fn inner_slope((h0, s0): (f64, f64), (h1, s1): (f64, f64)) -> f64 {
    if s0 * s1 <= 0.0 {
        return 0.0;
    }
    let (w0, w1) = (2.0 * h1 + h0, h1 + 2.0 * h0);
    (w0 + w1) / (w0 / s0 + w1 / s1)
}

/// Slope at an end from the outermost piece and the next (width and secant of each): one-sided
/// through three points, limited so that monotony holds.
fn end_slope((h0, s0): (f64, f64), (h1, s1): (f64, f64)) -> f64 {
    let d = ((2.0 * h0 + h1) * s0 - h0 * s1) / (h0 + h1);
    if d * s0 <= 0.0 {
        0.0
    } else if s0 * s1 <= 0.0 && d.abs() > 3.0 * s0.abs() {
        3.0 * s0
    } else {
        d
    }
}

/// Index `i` of the piece `x[i]..x[i+1]` that holds `t`, the outermost ones beyond the ends.
pub fn piece(x: &[f64], t: f64) -> usize {
    x[1..x.len() - 1].partition_point(|&k| k <= t)
}

/// Cubic Hermite value at `t` in the piece `i`.
pub fn value(x: &[f64], y: &[f64], d: &[f64], i: usize, t: f64) -> f64 {
    let h = x[i + 1] - x[i];
    let s = (t - x[i]) / h;
    let (a, b) = (y[i], y[i + 1]);
    let (da, db) = (d[i] * h, d[i + 1] * h);
    let s1 = 1.0 - s;
    a * s1 * s1 * (1.0 + 2.0 * s) + b * s * s * (3.0 - 2.0 * s) + s * s1 * (da * s1 - db * s)
}

/// Interpolated value; beyond the ends the end value.
pub fn at(x: &[f64], y: &[f64], d: &[f64], t: f64) -> f64 {
    let t = t.clamp(x[0], x[x.len() - 1]);
    value(x, y, d, piece(x, t), t)
}

/// The first place from `from` on at which a rising interpolant has reached `level`, `None` if it
/// stays below: on a plateau at the level, the plateau's beginning.
///
/// * `x` strictly rising knots, at least two
/// * `y` value at a knot, rising; asked for only around the place
/// * `near` knot to look around first, and then the first at the level or above
pub fn rises_to(x: &[f64], y: impl Fn(usize) -> f64, level: f64, from: f64, near: &mut usize) -> Option<f64> {
    let end = first_after(x.len(), *near, |k| y(k) < level);
    *near = end;
    if end == x.len() {
        return None;
    }
    if end == 0 || x[end] <= from {
        return Some(from.max(x[0]));
    }
    let (i, h) = (end - 1, x[end] - x[end - 1]);
    let start = ((from - x[i]) / h).max(0.0);
    let s = Piece::of(x, y, i).crossing(level, start, 1.0);
    Some(from.max(x[i] + s * h))
}

/// The last place up to `to` at which a rising interpolant is still at `level` or below, `None` if
/// it is above everywhere. For the rest see [`rises_to`].
pub fn rises_from(x: &[f64], y: impl Fn(usize) -> f64, level: f64, to: f64, near: &mut usize) -> Option<f64> {
    let end = first_after(x.len(), *near, |k| y(k) <= level);
    *near = end;
    if end == 0 {
        return None;
    }
    if end == x.len() || x[end - 1] >= to {
        return Some(to.min(x[x.len() - 1]));
    }
    let (i, h) = (end - 1, x[end] - x[end - 1]);
    let stop = ((to - x[i]) / h).min(1.0);
    let s = Piece::of(x, y, i).crossing(level, 0.0, stop);
    Some(to.min(x[i] + s * h))
}

/// The first of `0..n` after those that are `before`, `n` if all are; looked for from `near` on.
fn first_after(n: usize, near: usize, before: impl Fn(usize) -> bool) -> usize {
    let mut k = near.min(n);
    while k < n && before(k) {
        k += 1;
    }
    while k > 0 && !before(k - 1) {
        k -= 1;
    }
    k
}

/// One piece of an interpolant over the share of its width: coefficients of 1, s, s^2, s^3.
struct Piece([f64; 4]);

impl Piece {
    /// The piece `i` from the knots around it.
    fn of(x: &[f64], y: impl Fn(usize) -> f64, i: usize) -> Self {
        let (y0, y1) = (y(i), y(i + 1));
        // width and secant of the pieces
        let part = |k: usize, rise: f64| (x[k + 1] - x[k], rise / (x[k + 1] - x[k]));
        let this = part(i, y1 - y0);
        let before = (i > 0).then(|| part(i - 1, y0 - y(i - 1)));
        let after = (i + 2 < x.len()).then(|| part(i + 1, y(i + 2) - y1));
        let (d0, d1) = match (before, after) {
            (Some(before), Some(after)) => (inner_slope(before, this), inner_slope(this, after)),
            (None, Some(after)) => (end_slope(this, after), inner_slope(this, after)),
            (Some(before), None) => (inner_slope(before, this), end_slope(this, before)),
            (None, None) => (this.1, this.1),
        };
        let (a, b, rise) = (d0 * this.0, d1 * this.0, y1 - y0);
        Self([y0, a, 3.0 * rise - 2.0 * a - b, a + b - 2.0 * rise])
    }

    /// Where the rising piece crosses `level` in `low..high`, else the nearer of the two: Newton's
    /// steps, halving the bracket where they leave it.
    fn crossing(&self, level: f64, mut low: f64, mut high: f64) -> f64 {
        let [y, b, c, d] = self.0;
        let a = y - level;
        let value = |s: f64| a + s * (b + s * (c + s * d));
        let (at_low, at_high) = (value(low), value(high));
        if at_low >= 0.0 {
            return low;
        }
        if at_high <= 0.0 {
            return high;
        }
        let mut s = low + (high - low) * at_low / (at_low - at_high);
        for _ in 0..MOST_STEPS {
            let f = value(s);
            if f < 0.0 {
                low = s
            } else {
                high = s
            }
            let slope = b + s * (2.0 * c + s * (3.0 * d));
            let newton = s - f / slope;
            let inside = low <= newton && newton <= high;
            let next = if inside { newton } else { 0.5 * (low + high) };
            // what the step leaves of the value, from the cubic's Taylor series
            let step = next - s;
            let left = step * step * (c + d * (3.0 * s + step)).abs();
            s = next;
            if inside && left <= CLOSE_ENOUGH * slope {
                break;
            }
        }
        s
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn prop_pchip_is_monotone_and_inverts() {
        let x = [1.0, 1.5, 2.0, 3.0, 4.5, 5.0];
        let y = [0.0, 0.0, 0.3, 0.31, 2.0, 2.5];
        let mut d = [0.0; 6];
        slopes(&x, &y, &mut d);
        let mut last = f64::NEG_INFINITY;
        for k in 0..=4000 {
            let v = at(&x, &y, &d, 1.0 + k as f64 * 1e-3);
            assert!(v >= last - 1e-15);
            last = v;
        }
        let (start, end) = (f64::NEG_INFINITY, f64::INFINITY);
        // from any knot the same place is found
        let near = || (0..=6).collect::<Vec<usize>>();
        let to = |level: f64, from: f64| {
            let found = near()
                .into_iter()
                .map(|mut k| rises_to(&x, |k| y[k], level, from, &mut k));
            found
                .reduce(|a, b| if a == b { a } else { panic!("{a:?} {b:?}") })
                .unwrap()
        };
        let from = |level: f64, to: f64| {
            let found = near()
                .into_iter()
                .map(|mut k| rises_from(&x, |k| y[k], level, to, &mut k));
            found
                .reduce(|a, b| if a == b { a } else { panic!("{a:?} {b:?}") })
                .unwrap()
        };
        for level in [0.05, 0.3, 0.305, 1.0, 2.4] {
            let t = to(level, start).unwrap();
            assert!((at(&x, &y, &d, t) - level).abs() < 1e-12, "{level}");
            assert!((from(level, end).unwrap() - t).abs() < 1e-9, "{level}");
            // a crossing that lies beyond the limit given does not count
            for h in [0.01, 1.0] {
                assert_eq!(to(level, t + h), Some(t + h));
                assert_eq!(from(level, t - h), Some(t - h));
                assert!((to(level, t - h).unwrap() - t).abs() < 1e-9);
                assert!((from(level, t + h).unwrap() - t).abs() < 1e-9);
            }
        }
        assert_eq!(to(0.0, start), Some(1.0));
        assert!((from(0.0, end).unwrap() - 1.5).abs() < 1e-9);
        assert_eq!((to(-1.0, start), from(-1.0, end)), (Some(1.0), None));
        assert_eq!((to(2.6, start), from(2.6, end)), (None, Some(5.0)));
    }

    #[test]
    fn val_pchip_reproduces_lines() {
        let x = [0.0, 0.1, 0.7, 2.0];
        let y = x.map(|x| 3.0 * x - 1.0);
        let mut d = [0.0; 4];
        slopes(&x, &y, &mut d);
        assert!((at(&x, &y, &d, 1.234) - (3.0 * 1.234 - 1.0)).abs() < 1e-14);
    }
}
