//! Sums of products, and estimates that leave out one of their parts.

/// Inner product.
pub fn dot(a: &[f64], b: &[f64]) -> f64 {
    let mut sum = [0.0; 8];
    let (x, y) = (a.chunks_exact(8), b.chunks_exact(8));
    let rest: f64 = x.remainder().iter().zip(y.remainder()).map(|(x, y)| x * y).sum();
    for (x, y) in x.zip(y) {
        for l in 0..8 {
            sum[l] += x[l] * y[l];
        }
    }
    rest + sum.iter().sum::<f64>()
}

/// Adds a column, times a factor.
pub fn add(to: &mut [f64], factor: f64, column: &[f64]) {
    to.iter_mut().zip(column).for_each(|(t, c)| *t += factor * c);
}

/// One part of an estimate: the least-squares sums of a run or a piece.
#[derive(Clone, Copy, Debug, Default)]
pub struct Sums {
    /// of `x x`
    pub xx: f64,
    /// of `x y`
    pub xy: f64,
    /// of `y y`
    pub yy: f64,
    /// how many they are
    pub rows: f64,
}

impl Sums {
    /// With another part.
    pub fn plus(self, o: &Self) -> Self {
        Self {
            xx: self.xx + o.xx,
            xy: self.xy + o.xy,
            yy: self.yy + o.yy,
            rows: self.rows + o.rows,
        }
    }

    /// Of all parts together.
    pub fn all<'a>(parts: impl IntoIterator<Item = &'a Self>) -> Self {
        parts.into_iter().fold(Self::default(), Self::plus)
    }

    /// rms of what is left with a value.
    pub fn rms(&self, value: f64) -> f64 {
        ((self.yy - 2.0 * value * self.xy + value * value * self.xx).max(0.0) / self.rows.max(1.0)).sqrt()
    }
}

/// Value and standard deviation (jackknife over the parts); `None` of fewer than three that say something of `y = value x`.
pub fn jackknife(parts: &[Sums]) -> Option<(f64, f64)> {
    let all = Sums::all(parts);
    let used: Vec<&Sums> = parts.iter().filter(|p| p.xx > 1e-4 * all.xx).collect();
    if used.len() < 3 || all.xx <= 0.0 {
        return None;
    }
    let value = all.xy / all.xx;
    let of = |p: &&Sums| (all.xy - p.xy) / (all.xx - p.xx).max(1e-300);
    Some((value, scatter(used.iter().map(of), value)))
}

/// Standard deviation by estimates that each leave one part out.
pub fn scatter(without: impl ExactSizeIterator<Item = f64>, value: f64) -> f64 {
    let n = without.len() as f64;
    ((n - 1.0) / n * without.map(|x| (x - value).powi(2)).sum::<f64>()).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_jackknife_knows_the_scatter_of_its_parts() {
        let part = |x: f64, y: f64| Sums {
            xx: x * x,
            xy: x * y,
            yy: y * y,
            rows: 1.0,
        };
        let parts = [part(1.0, 2.1), part(2.0, 4.0), part(1.0, 1.9), part(2.0, 4.0)];
        let (value, sd) = jackknife(&parts).unwrap();
        assert!((value - 2.0).abs() < 1e-12 && sd > 0.005 && sd < 0.05, "{value} {sd}");
        assert!(jackknife(&parts[..2]).is_none());
        let all = Sums::all(&parts);
        assert!(all.rms(2.0) < 0.08 && all.rms(0.0) > 3.0);
    }
}
