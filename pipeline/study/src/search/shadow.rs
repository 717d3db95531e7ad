//! What candidates leave of a residual, by inner products alone. A candidate stands in one or two of the equations; what it loses to
//! the basis of what is fitted already stands in all of them, and is never written down.

use crate::equations::problem::Problem;
use crate::measured::sums::{add, dot};
use nalgebra::{DMatrix, DVector};
use std::ops::Range;

/// Products of an orthonormal basis and a residual, equation by equation.
pub struct Shadow {
    /// rows of each run's equations, with the equation's number
    blocks: Vec<(usize, Range<usize>)>,
    /// basis and residual, weighted; beyond the blocks' rows the priors
    q: Vec<Vec<f64>>,
    pub residual: Vec<f64>,
    /// of the basis with itself
    gram: [DMatrix<f64>; 5],
    /// of the basis with the residual
    facing: [DVector<f64>; 5],
    energy: [f64; 5],
    /// of the priors: the basis, and the residual
    priors: (DMatrix<f64>, DVector<f64>),
}

/// A weighted column, and where it falls on the basis.
pub struct Cast {
    column: Vec<f64>,
    /// equations in which it is something
    somewhere: [bool; 5],
    /// products with the basis in each of them
    along: [DVector<f64>; 5],
    /// the sum of them
    whole: DVector<f64>,
}

/// Inner product in one equation.
fn product_in(blocks: &[(usize, Range<usize>)], e: usize, a: &[f64], b: &[f64]) -> f64 {
    let rows = blocks.iter().filter(|x| x.0 == e);
    rows.map(|(_, r)| dot(&a[r.clone()], &b[r.clone()])).sum()
}

impl Shadow {
    /// * `q` orthonormal and weighted, as the residual is, of which nothing lies along it
    pub fn new(p: &Problem, q: Vec<Vec<f64>>, residual: Vec<f64>) -> Self {
        let blocks = p.blocks.iter().map(|b| (b.equation.index(), b.rows.clone())).collect();
        Self::of_blocks(blocks, q, residual, p.rows)
    }

    /// * `rows` from which on the priors stand
    fn of_blocks(blocks: Vec<(usize, Range<usize>)>, q: Vec<Vec<f64>>, residual: Vec<f64>, rows: usize) -> Self {
        let n = q.len();
        let product = |a: &[f64], b: &[f64], e: usize| product_in(&blocks, e, a, b);
        let gram = std::array::from_fn(|e| {
            let mut of = DMatrix::zeros(n, n);
            for i in 0..n {
                for j in 0..=i {
                    of[(i, j)] = product(&q[i], &q[j], e);
                    of[(j, i)] = of[(i, j)];
                }
            }
            of
        });
        Self {
            gram,
            facing: std::array::from_fn(|e| DVector::from_fn(n, |i, _| product(&q[i], &residual, e))),
            energy: std::array::from_fn(|e| product(&residual, &residual, e)),
            priors: (
                DMatrix::from_fn(residual.len() - rows, n, |r, i| q[i][rows + r]),
                DVector::from_column_slice(&residual[rows..]),
            ),
            residual,
            blocks,
            q,
        }
    }

    /// * `column` weighted; 0 where the priors stand, which may be left out
    pub fn of(&self, column: Vec<f64>) -> Cast {
        let mut somewhere = [false; 5];
        let mut along = [(); 5].map(|()| DVector::zeros(self.q.len()));
        for (e, rows) in &self.blocks {
            let of = &column[rows.clone()];
            if of.iter().all(|x| *x == 0.0) {
                continue;
            }
            somewhere[*e] = true;
            for (i, q) in self.q.iter().enumerate() {
                along[*e][i] += dot(of, &q[rows.clone()]);
            }
        }
        let whole = along.iter().fold(DVector::zeros(self.q.len()), |sum, x| sum + x);
        Cast {
            column,
            somewhere,
            along,
            whole,
        }
    }

    /// Inner product of two columns.
    pub fn product(&self, a: &Cast, b: &Cast) -> f64 {
        let both = (0..5).filter(|e| a.somewhere[*e] && b.somewhere[*e]);
        both.map(|e| product_in(&self.blocks, e, &a.column, &b.column)).sum()
    }

    /// Inner product of what two columns are beyond the basis.
    pub fn beyond(&self, a: &Cast, b: &Cast) -> f64 {
        self.product(a, b) - a.whole.dot(&b.whole)
    }

    /// Inner product of what a column is beyond the basis with the residual, of which nothing lies along the basis.
    pub fn facing(&self, a: &Cast) -> f64 {
        let there = (0..5).filter(|e| a.somewhere[*e]);
        there
            .map(|e| product_in(&self.blocks, e, &a.column, &self.residual))
            .sum()
    }

    /// So much of each of some columns.
    pub fn sum<'a>(&self, columns: impl Iterator<Item = (&'a Cast, f64)>) -> Cast {
        let n = self.q.len();
        let mut sum = Cast {
            column: vec![0.0; self.blocks.iter().map(|b| b.1.end).max().unwrap_or(0)],
            somewhere: [false; 5],
            along: [(); 5].map(|()| DVector::zeros(n)),
            whole: DVector::zeros(n),
        };
        for (c, amplitude) in columns {
            add(&mut sum.column, amplitude, &c.column);
            sum.whole.axpy(amplitude, &c.whole, 1.0);
            for e in (0..5).filter(|e| c.somewhere[*e]) {
                sum.somewhere[e] = true;
                sum.along[e].axpy(amplitude, &c.along[e], 1.0);
            }
        }
        sum
    }

    /// What is left of each equation and of the priors, squared, without what a column is beyond the basis.
    pub fn left(&self, sum: &Cast) -> ([f64; 5], f64) {
        let energy = std::array::from_fn(|e| {
            // (residual - column + basis x whole)^2
            let mut of = self.energy[e] + 2.0 * self.facing[e].dot(&sum.whole);
            of += (&self.gram[e] * &sum.whole).dot(&sum.whole);
            if sum.somewhere[e] {
                of += product_in(&self.blocks, e, &sum.column, &sum.column);
                of -= 2.0 * (product_in(&self.blocks, e, &sum.column, &self.residual) + sum.along[e].dot(&sum.whole));
            }
            of.max(0.0)
        });
        let (basis, residual) = &self.priors;
        (energy, (residual + basis * &sum.whole).norm_squared())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn prop_what_is_left_is_what_subtraction_leaves() {
        let wave = |n: usize, k: f64| -> Vec<f64> { (0..n).map(|i| (k * i as f64 + k * k).sin()).collect() };
        // two equations in two runs each, and two priors
        let blocks: Vec<(usize, Range<usize>)> = vec![(0, 0..40), (3, 40..90), (0, 90..110), (3, 110..137)];
        let n = 137 + 2;
        let mut q: Vec<Vec<f64>> = Vec::new();
        let beyond = |q: &[Vec<f64>], mut c: Vec<f64>| {
            for q in q.iter().chain(q) {
                let s = dot(q, &c);
                add(&mut c, -s, q);
            }
            c
        };
        for k in [0.3, 0.7, 1.9] {
            let c = beyond(&q, wave(n, k));
            let norm = dot(&c, &c).sqrt();
            q.push(c.iter().map(|x| x / norm).collect());
        }
        let residual = beyond(&q, wave(n, 2.3));
        let shadow = Shadow::of_blocks(blocks.clone(), q.clone(), residual.clone(), 137);
        let mut column = wave(137, 1.1);
        // nothing in the other equation
        for r in blocks.iter().filter(|b| b.0 == 3) {
            column[r.1.clone()].fill(0.0);
        }
        let whole = |c: &[f64]| beyond(&q, c.iter().copied().chain([0.0, 0.0]).collect());
        let (one, two) = (shadow.of(column.clone()), shadow.of(wave(137, 0.2)));
        let (a, b) = (whole(&column), whole(&wave(137, 0.2)));
        let near = |x: f64, y: f64| assert!((x - y).abs() < 1e-10, "{x} {y}");
        near(shadow.beyond(&one, &two), dot(&a, &b));
        near(shadow.facing(&one), dot(&a, &residual));
        let rest: Vec<f64> = (0..n).map(|i| residual[i] - 0.4 * a[i] + 1.7 * b[i]).collect();
        let (energy, prior) = shadow.left(&shadow.sum([(&one, 0.4), (&two, -1.7)].into_iter()));
        for e in 0..5 {
            let rows = blocks.iter().filter(|x| x.0 == e);
            near(
                energy[e],
                rows.map(|(_, r)| dot(&rest[r.clone()], &rest[r.clone()])).sum(),
            );
        }
        near(prior, dot(&rest[137..], &rest[137..]));
    }
}
