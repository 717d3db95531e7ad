//! What a test says of the causes in which units differ, beside its faults.

use super::{Estimate, Estimator, apply};
use crate::uncertainty::{MOST, Row};
use nalgebra::{DMatrix, DVector};

impl Estimator {
    /// What the features of a test say of the unknown causes, whatever the faults are: mean and covariance of the
    /// factors, which had mean 0 and standard deviation 1 before.
    ///
    /// * `wider` factor on the variances that features share with no other
    pub fn factors_given(&self, values: &Row, best: &Estimate, wider: f64) -> (DVector<f64>, DMatrix<f64>) {
        let n = self.features.len();
        let causes = self.unknown.len();
        let Some(s) = self.straight(best.fsj, best.zeta, &best.guess) else {
            return (DVector::zeros(causes), DMatrix::identity(causes, causes));
        };
        let (maps, by_f, by_z) = self.lattice.with_slopes(best.fsj, best.zeta);
        let own = self.variance(best.fsj, best.zeta);
        // what a test lacks says nothing
        let here = |i: usize| values[i].is_finite();
        // faults that nobody knows: a variance far beyond any other
        let faults = [(by_f, self.limits.f), (by_z, self.limits.z)];
        let c = DMatrix::from_fn(n, n, |i, j| {
            let far = |(by, (lo, hi)): &(Row, (f64, f64))| 1e2 * by[i] * by[j] * (hi - lo) * (hi - lo);
            if !(here(i) && here(j)) {
                return if i == j { own[i] } else { 0.0 };
            }
            let scatter = self.correlation[i][j] * (own[i] * own[j]).sqrt();
            wider * scatter + faults.iter().map(far).sum::<f64>()
        });
        let slopes = DMatrix::from_fn(n, causes, |i, k| if here(i) { s.slopes[k][i] } else { 0.0 });
        let left = DVector::from_fn(n, |i, _| if here(i) { values[i] - s.shift[i] - maps[i] } else { 0.0 });
        // by the size of each feature, so that the matrix can be inverted
        let size = DVector::from_fn(n, |i, _| own[i].sqrt().max(1e-300));
        let c = DMatrix::from_fn(n, n, |i, j| c[(i, j)] / (size[i] * size[j]));
        let slopes = DMatrix::from_fn(n, causes, |i, k| slopes[(i, k)] / size[i]);
        let left = left.component_div(&size);
        let Some(c) = c.cholesky() else {
            return (DVector::zeros(causes), DMatrix::identity(causes, causes));
        };
        let weighed = c.solve(&slopes);
        let information = DMatrix::identity(causes, causes) + slopes.transpose() * &weighed;
        let Some(covariance) = information.try_inverse() else {
            return (DVector::zeros(causes), DMatrix::identity(causes, causes));
        };
        let mean = &covariance * weighed.transpose() * left;
        (mean, covariance)
    }

    /// The kinetic factor of a test: dynamic friction over that of the healthy model, FSJ times what the unit's own
    /// dynamic friction differs by; its most probable value and standard uncertainty. `None` where nothing makes it differ
    /// from FSJ.
    ///
    /// Linear about the best pair (Gauss-Markov), causes with their standard deviations before the test.
    pub fn kinetic(&self, values: &Row, best: &Estimate) -> Option<(f64, f64)> {
        if self.kinetic.1.iter().all(|x| *x == 0.0) {
            return None;
        }
        let s = self.straight(best.fsj, best.zeta, &best.guess)?;
        let (maps, by_f, by_z) = self.lattice.with_slopes(best.fsj, best.zeta);
        let whitening = self.whitening(values, best.fsj, best.zeta, &None);
        let columns = [by_f, by_z].into_iter().chain(s.slopes[..s.causes].iter().copied());
        let columns: Vec<Row> = columns.map(|c| apply(&whitening, &c)).collect();
        let mut left = [0.0; MOST];
        for k in (0..self.features.len()).filter(|&k| values[k].is_finite()) {
            left[k] = values[k] - s.shift[k] - maps[k];
        }
        let left = apply(&whitening, &left);
        let dot = |a: &Row, b: &Row| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
        let n = columns.len();
        // steps of FSJ and zeta by their range, so that the matrix can be inverted
        let ranges = [self.limits.f.1 - self.limits.f.0, self.limits.z.1 - self.limits.z.0];
        let size = |i: usize| ranges.get(i).copied().unwrap_or(1.0);
        let information = DMatrix::from_fn(n, n, |i, j| {
            let prior = if i == j && i >= 2 { 1.0 } else { 0.0 };
            prior + size(i) * size(j) * dot(&columns[i], &columns[j])
        });
        let right = DVector::from_fn(n, |i, _| size(i) * dot(&columns[i], &left));
        let solver = information.cholesky()?;
        let found = solver.solve(&right);
        let fsj = best.fsj + size(0) * found[0];
        let own = (self.kinetic.0 + (0..n - 2).map(|k| self.kinetic.1[k] * found[k + 2]).sum::<f64>()).exp();
        let gradient = DVector::from_fn(n, |i, _| match i {
            0 => own * size(0),
            1 => 0.0,
            _ => fsj * own * self.kinetic.1[i - 2],
        });
        let variance = gradient.dot(&solver.solve(&gradient));
        Some((fsj * own, variance.sqrt()))
    }
}
