//! Statistics of plain slices. NaN stands for a missing value and is never counted.

/// Normal quantile of a two-sided 95 % interval.
pub const NORMAL_95: f64 = 1.959_963_984_540_054;

/// Scale that makes the median absolute deviation of normal values their standard deviation.
pub const MAD_TO_SIGMA: f64 = 1.4826;

/// Moves the numbers to the front and returns them.
pub fn numbers(values: &mut [f64]) -> &mut [f64] {
    let mut n = 0;
    for i in 0..values.len() {
        if !values[i].is_nan() {
            values.swap(n, i);
            n += 1;
        }
    }
    &mut values[..n]
}

/// Quantile `q` (0 to 1) of sorted numbers, straight between neighbours; NaN of nothing.
pub fn quantile(sorted: &[f64], q: f64) -> f64 {
    let Some(last) = sorted.len().checked_sub(1) else {
        return f64::NAN;
    };
    let x = q * last as f64;
    let i = (x as usize).min(last);
    let (a, b) = (sorted[i], sorted[(i + 1).min(last)]);
    a + (b - a) * (x - i as f64)
}

/// Median of numbers in any order, which it changes; NaN of nothing.
pub fn median(values: &mut [f64]) -> f64 {
    let n = values.len();
    if n == 0 {
        return f64::NAN;
    }
    let (below, &mut upper, _) = values.select_nth_unstable_by(n / 2, f64::total_cmp);
    if n % 2 == 1 {
        return upper;
    }
    let lower = below.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    0.5 * (lower + upper)
}

/// Mean and standard deviation (n - 1) of numbers; NaN where there are too few.
pub fn mean_sd(values: &[f64]) -> (f64, f64) {
    let n = values.len() as f64;
    if values.is_empty() {
        return (f64::NAN, f64::NAN);
    }
    let mean = values.iter().sum::<f64>() / n;
    let squares: f64 = values.iter().map(|x| (x - mean) * (x - mean)).sum();
    (
        mean,
        if n > 1.0 {
            (squares / (n - 1.0)).sqrt()
        } else {
            f64::NAN
        },
    )
}

/// Pearson's correlation of `x` and `y` and the slope of y over x, from pairs without NaN; NaN where either
/// does not vary.
pub fn correlation(x: &[f64], y: &[f64]) -> (usize, f64, f64) {
    let pairs = || x.iter().zip(y).filter(|(a, b)| !a.is_nan() && !b.is_nan());
    let n = pairs().count();
    let mean = |f: fn((&f64, &f64)) -> f64| pairs().map(f).sum::<f64>() / n as f64;
    let (mx, my) = (mean(|p| *p.0), mean(|p| *p.1));
    let (mut xx, mut yy, mut xy) = (0.0, 0.0, 0.0);
    for (a, b) in pairs() {
        xx += (a - mx) * (a - mx);
        yy += (b - my) * (b - my);
        xy += (a - mx) * (b - my);
    }
    let still = |squares: f64, mean: f64| squares <= n as f64 * (1e-12 * mean).powi(2);
    if n < 3 || still(xx, mx) || still(yy, my) {
        return (n, f64::NAN, f64::NAN);
    }
    (n, xy / (xx * yy).sqrt(), xy / xx)
}

/// Wilson's 95 % interval of a share of `k` in `n`; all of 0 to 1 where there is nothing.
pub fn wilson(k: usize, n: usize) -> (f64, f64) {
    if n == 0 {
        return (0.0, 1.0);
    }
    let (k, n, z2) = (k as f64, n as f64, NORMAL_95 * NORMAL_95);
    let p = k / n;
    let middle = p + z2 / (2.0 * n);
    let half = NORMAL_95 * (p * (1.0 - p) / n + z2 / (4.0 * n * n)).sqrt();
    let whole = 1.0 + z2 / n;
    // rounding must not take the share itself out
    (
        ((middle - half) / whole).clamp(0.0, p),
        ((middle + half) / whole).clamp(p, 1.0),
    )
}

/// Number beyond which a standard normal value lies with probability `p` (upper tail, 1e-15 to 0.5).
///
/// Bisection on the continued fraction of the tail (Abramowitz and Stegun 26.2.14), good to 1e-6.
pub fn normal_beyond(p: f64) -> f64 {
    let tail = |x: f64| {
        let density = (-0.5 * x * x).exp() / std::f64::consts::TAU.sqrt();
        let mut f = x;
        for k in (1..200).rev() {
            f = x + k as f64 / f;
        }
        density / f
    };
    let (mut lo, mut hi) = (0.5, 9.0);
    for _ in 0..60 {
        let x = 0.5 * (lo + hi);
        if tail(x) > p { lo = x } else { hi = x }
    }
    0.5 * (lo + hi)
}
