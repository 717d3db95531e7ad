//! Surfaces freed of scatter: where the values at neighbouring grid points scatter (the relays' chatter, whole
//! samples), a local regression predicts a new test better than the point itself does.
//!
//! At each point quadratics are fitted to windows of several sizes (local regression; Cleveland and Devlin
//! 1988); which of them is taken, or the point itself, is decided by leave-one-out errors around it.

use nalgebra::{Matrix6, Vector6};

/// Half-widths of the windows, in grid points.
const WINDOWS: [usize; 3] = [2, 3, 4];

/// Fewest points that a quadratic is fitted to: three more than it has coefficients.
const FEWEST: usize = 9;

/// Grid points around an error, each way, over which it is averaged: a single one may be small by chance.
const NEIGHBOURS: usize = 2;

/// A window is taken only where its error is below this share of the error of the point itself (assumed).
const BETTER: f64 = 0.95;

/// What a grid point becomes, and the standard uncertainty with which it predicts a test.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Smoothed {
    /// of the fit that predicts best, or of the point itself
    pub value: f64,
    /// root mean square of leave-one-out errors around the point, in the feature's unit
    pub error: f64,
}

/// One window's fit at a grid point.
#[derive(Clone, Copy)]
struct Fit {
    value: f64,
    /// error at the point when it is left out
    left_out: f64,
}

/// * `fsj`, `zeta` lines of the grid
/// * `raw` values, zeta outer, FSJ inner
/// * `own` leave-one-out errors of the interpolation between the points themselves, brought to the grid's own
///   spacing; 0 where there is none
pub fn smoothed(fsj: &[f64], zeta: &[f64], raw: &[f64], own: &[f64]) -> Vec<Smoothed> {
    let (rows, columns) = (zeta.len(), fsj.len());
    let around = |i: usize| {
        let (r, c) = (i / columns, i % columns);
        let span = |k: usize, n: usize| k.saturating_sub(NEIGHBOURS)..=(k + NEIGHBOURS).min(n - 1);
        span(r, rows).flat_map(move |r| span(c, columns).map(move |c| r * columns + c))
    };
    let mean_square = |values: &mut dyn Iterator<Item = f64>| {
        let (sum, n) = values.fold((0.0, 0), |(s, n), x| (s + x * x, n + 1));
        if n == 0 { None } else { Some(sum / f64::from(n)) }
    };
    let fits: Vec<Vec<Option<Fit>>> = WINDOWS
        .iter()
        .map(|&w| (0..raw.len()).map(|i| fit(fsj, zeta, raw, i, w)).collect())
        .collect();
    let at = |i: usize| {
        let itself = mean_square(&mut around(i).map(|k| own[k]).filter(|e| *e > 0.0)).unwrap_or(0.0);
        let mut best = Smoothed {
            value: raw[i],
            error: itself.sqrt(),
        };
        let mut least = BETTER * BETTER * itself;
        for window in &fits {
            let Some(here) = window[i] else { continue };
            let errors = mean_square(&mut around(i).filter_map(|k| window[k].map(|f| f.left_out)));
            if let Some(error) = errors.filter(|e| *e < least) {
                least = error;
                best = Smoothed {
                    value: here.value,
                    error: error.sqrt(),
                };
            }
        }
        best
    };
    (0..raw.len()).map(at).collect()
}

/// The quadratic through a window about point `i`, by least squares with tricube weights.
fn fit(fsj: &[f64], zeta: &[f64], raw: &[f64], i: usize, window: usize) -> Option<Fit> {
    let (rows, columns) = (zeta.len(), fsj.len());
    let (r, c) = (i / columns, i % columns);
    let span = |k: usize, n: usize| k.saturating_sub(window)..(k + window + 1).min(n);
    let (near_r, near_c) = (span(r, rows), span(c, columns));
    if near_r.len() < 3 || near_c.len() < 3 || near_r.len() * near_c.len() < FEWEST {
        return None;
    }
    // distances in units of the window, so that they are alike along both axes
    let reach = |x: &[f64], k: usize, near: &std::ops::Range<usize>| {
        let (a, b) = (x[k] - x[near.start], x[near.end - 1] - x[k]);
        a.max(b)
    };
    let (df, dz) = (reach(fsj, c, &near_c), reach(zeta, r, &near_r));
    let mut normal = Matrix6::<f64>::zeros();
    let mut right = Vector6::<f64>::zeros();
    for row in near_r {
        let v = (zeta[row] - zeta[r]) / dz;
        for column in near_c.clone() {
            let u = (fsj[column] - fsj[c]) / df;
            // a little beyond the window, so that its rim still counts
            let tricube = |x: f64| (1.0 - (x.abs() / 1.25).powi(3)).max(0.0).powi(3);
            let weight = tricube(u) * tricube(v);
            let terms = Vector6::new(1.0, u, v, u * u, u * v, v * v);
            normal += weight * terms * terms.transpose();
            right += weight * raw[row * columns + column] * terms;
        }
    }
    let inverse = normal.try_inverse()?;
    let value = (inverse * right)[0];
    // share of the point itself in its own fit: its weight is 1
    let leverage = inverse[(0, 0)];
    if !(leverage < 0.95 && value.is_finite()) {
        return None;
    }
    Some(Fit {
        value,
        left_out: (raw[i] - value) / (1.0 - leverage),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// -1 to 1 (Steele et al. 2014, SplitMix).
    fn number(i: usize) -> f64 {
        let mut x = (i as u64 + 1).wrapping_mul(0x9E37_79B9_7F4A_7C15);
        x = (x ^ (x >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        x = (x ^ (x >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        2.0 * ((x ^ (x >> 31)) >> 11) as f64 / (1u64 << 53) as f64 - 1.0
    }

    fn axes() -> (Vec<f64>, Vec<f64>) {
        let axis = |n: usize, to: f64| (0..n).map(|k| to * k as f64 / (n - 1) as f64).collect();
        (axis(33, 4.0), axis(21, 0.5))
    }

    fn surface(f: &[f64], z: &[f64], of: impl Fn(f64, f64, usize) -> f64) -> Vec<f64> {
        let points = z.iter().flat_map(|&z| f.iter().map(move |&f| (f, z)));
        points.enumerate().map(|(i, (f, z))| of(f, z, i)).collect()
    }

    #[test]
    fn prop_scatter_is_averaged_out_and_stated() {
        let (f, z) = axes();
        let truth = |f: f64, z: f64| 1.0 + 0.3 * f + z + 0.1 * f * z;
        let scatter = 0.02;
        let raw = surface(&f, &z, |f, z, i| truth(f, z) + scatter * number(i));
        // linear interpolation of scatter left out: 1.22 times its standard deviation
        let own = vec![1.22 * scatter / 3f64.sqrt(); raw.len()];
        let s = smoothed(&f, &z, &raw, &own);
        let clean = surface(&f, &z, |f, z, _| truth(f, z));
        let rms = |v: &[f64]| (v.iter().map(|x| x * x).sum::<f64>() / v.len() as f64).sqrt();
        let left = rms(&s.iter().zip(&clean).map(|(s, c)| s.value - c).collect::<Vec<_>>());
        let before = rms(&raw.iter().zip(&clean).map(|(r, c)| r - c).collect::<Vec<_>>());
        assert!(left < 0.6 * before, "{left} {before}");
        // what is stated is what a new test with scatter of its own will differ by
        let stated = rms(&s.iter().map(|s| s.error).collect::<Vec<_>>());
        let expected = before.hypot(left);
        assert!((stated / expected - 1.0).abs() < 0.12, "{stated} {expected}");
    }

    #[test]
    fn prop_what_does_not_scatter_is_left_alone() {
        let (f, z) = axes();
        // sharply bent at low zeta, and its interpolation is good: a window would flatten it
        let raw = surface(&f, &z, |f, z, _| (0.02 + (4.0 * z).powi(2)).sqrt() + 0.1 * f);
        let s = smoothed(&f, &z, &raw, &vec![1e-5; raw.len()]);
        let bent = 33 * 4;
        assert!((0..bent).all(|i| s[i].value == raw[i] && (s[i].error - 1e-5).abs() < 1e-12));
        // where it is nearly straight a window may do as well
        assert!(s.iter().zip(&raw).all(|(s, r)| (s.value - r).abs() < 1e-5));
        // too few points for any window
        let raw = [1.0, 2.0, 3.0, 4.0];
        let s = smoothed(&f[..2], &z[..2], &raw, &[0.1; 4]);
        assert!(s.iter().zip(&raw).all(|(s, r)| s.value == *r));
    }
}
