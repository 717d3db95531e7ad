//! Monotone cubic interpolation (Fritsch and Carlson 1980; slopes by Butland's weighted harmonic
//! mean, as in PCHIP).

/// Slopes at the knots of a monotone (or any) sequence; between two knots the interpolant is
/// monotone, and it has no extremum that the data do not have.
///
/// * `x` strictly rising knots, at least two
/// * `y` values, same length
/// * `d` slopes, written
pub fn slopes(x: &[f64], y: &[f64], d: &mut [f64]) {
    let n = x.len();
    debug_assert!(n >= 2 && y.len() == n && d.len() == n);
    let secant = |i: usize| (y[i + 1] - y[i]) / (x[i + 1] - x[i]);
    if n == 2 {
        d.fill(secant(0));
        return;
    }
    for i in 1..n - 1 {
        let (h0, h1) = (x[i] - x[i - 1], x[i + 1] - x[i]);
        let (s0, s1) = (secant(i - 1), secant(i));
        d[i] = if s0 * s1 <= 0.0 {
            0.0
        } else {
            let (w0, w1) = (2.0 * h1 + h0, h1 + 2.0 * h0);
            (w0 + w1) / (w0 / s0 + w1 / s1)
        };
    }
    // one-sided three-point slopes, limited so that monotony holds
    let end = |h0: f64, h1: f64, s0: f64, s1: f64| {
        let d = ((2.0 * h0 + h1) * s0 - h0 * s1) / (h0 + h1);
        if d * s0 <= 0.0 {
            0.0
        } else if s0 * s1 <= 0.0 && d.abs() > 3.0 * s0.abs() {
            3.0 * s0
        } else {
            d
        }
    };
    d[0] = end(x[1] - x[0], x[2] - x[1], secant(0), secant(1));
    d[n - 1] = end(x[n - 1] - x[n - 2], x[n - 2] - x[n - 3], secant(n - 2), secant(n - 3));
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

/// The part of `x[0]..x[n-1]` where `v` lies between two rising interpolants, `low` below `high`
/// (values and slopes of each); `None` where it lies between them nowhere. Bounds are good to
/// 1e-12 of the range.
pub fn between(x: &[f64], low: (&[f64], &[f64]), high: (&[f64], &[f64]), v: f64) -> Option<(f64, f64)> {
    let n = x.len();
    if low.0[0] > v || high.0[n - 1] < v {
        return None;
    }
    // from where the upper one reaches v to where the lower one leaves it
    let from = if high.0[0] >= v {
        x[0]
    } else {
        crossing(x, high.0, high.1, v, false)
    };
    let to = if low.0[n - 1] <= v {
        x[n - 1]
    } else {
        crossing(x, low.0, low.1, v, true)
    };
    (from <= to).then_some((from, to))
}

/// Where a rising interpolant crosses `level`, `y[0] <= level <= y[n-1]`; on a plateau at the
/// level its end (`last`) or its beginning.
fn crossing(x: &[f64], y: &[f64], d: &[f64], level: f64, last: bool) -> f64 {
    let n = x.len();
    let i = if last {
        y.partition_point(|&v| v <= level).clamp(1, n - 1) - 1
    } else {
        y.partition_point(|&v| v < level).clamp(1, n - 1) - 1
    };
    // bisection with secant steps (Illinois) on a monotone piece
    let (mut a, mut b) = (x[i], x[i + 1]);
    let (mut fa, mut fb) = (y[i] - level, y[i + 1] - level);
    if fa == 0.0 && !last || fa == fb {
        return a;
    }
    let tolerance = 1e-13 * (x[n - 1] - x[0]);
    for _ in 0..100 {
        if b - a <= tolerance {
            break;
        }
        let t = a + (b - a) * (fa / (fa - fb)).clamp(0.02, 0.98);
        let f = value(x, y, d, i, t) - level;
        if f < 0.0 || last && f == 0.0 {
            a = t;
            fa = f;
            fb *= 0.5;
        } else {
            b = t;
            fb = f;
            fa *= 0.5;
        }
        if fa == fb {
            break;
        }
    }
    0.5 * (a + b)
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
        let shifted = |h: f64| y.map(|v| v + h);
        for level in [0.05, 0.3, 0.305, 1.0, 2.4] {
            // slopes do not change with a shift
            let (a, b) = between(&x, (&shifted(-0.01), &d), (&shifted(0.01), &d), level).unwrap();
            assert!(
                (at(&x, &y, &d, a) - level + 0.01).abs() < 1e-9 || at(&x, &y, &d, a) >= level - 0.01,
                "{level}"
            );
            assert!((at(&x, &y, &d, b) - level - 0.01).abs() < 1e-9, "{level}");
        }
        let (a, b) = between(&x, (&y, &d), (&y, &d), 0.0).unwrap();
        assert!(a == 1.0 && (b - 1.5).abs() < 1e-9, "{b}");
        assert_eq!(between(&x, (&y, &d), (&y, &d), 2.6), None);
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
