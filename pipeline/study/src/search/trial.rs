//! Columns beside a model: learnt on the fit runs, tried on the held-out ones.

use crate::equations::pieces::{Column, Piece};
use crate::equations::problem::Problem;
use crate::equations::signals::Signals;
use crate::measured::sums::{add, dot};
use crate::search::fit::{self, Fit};
use crate::search::select::Material;
use nalgebra::{DMatrix, DVector};
use sim_worker::effect::Equation;
use std::borrow::Cow;
use std::cell::OnceCell;

/// Share of what effects explain that something beside them may take (assumed: laws of the list left up to 0.004, a spring with a cubic
/// part 0.14, what is none of them up to 2).
pub const MOST: f64 = 0.2;
/// Energy that something takes, over that of a row, from which it is there (assumed).
pub const CLEAR: f64 = 100.0;
/// Keeps columns that are sums of others apart.
const RIDGE: f64 = 1e-7;

/// Columns of a form, or of a law, over the rows of a problem.
pub type Columns<'a> = dyn Fn(&Problem) -> Vec<Vec<f64>> + 'a;

/// Column of a torque at each sample of each run.
pub fn torque_column(p: &Problem, torque: impl Fn(&Signals, usize) -> f64) -> Vec<f64> {
    torque_columns(p, |s| vec![(0..s.n).map(|k| torque(s, k)).collect()]).remove(0)
}

/// Columns of several torques, each at every sample of a run; as many in each run.
pub fn torque_columns(p: &Problem, torques: impl Fn(&Signals) -> Vec<Vec<f64>>) -> Vec<Vec<f64>> {
    let mut all: Vec<Vec<Column>> = Vec::new();
    for s in &p.signals {
        let each = torques(s);
        all.resize_with(each.len(), Vec::new);
        for (pieces, torque) in all.iter_mut().zip(each) {
            pieces.push(vec![Piece::of(Equation::Torque, 0, torque)]);
        }
    }
    p.columns(&all)
}

/// Share of knot `i` in a value: straight from knot to knot, and beyond the ends as there.
pub fn hat(knots: &[f64], i: usize, x: f64) -> f64 {
    let (at, last) = (knots[i], knots.len() - 1);
    let towards = |from: f64| ((x - from) / (at - from)).max(0.0);
    match x.total_cmp(&at) {
        std::cmp::Ordering::Less if i > 0 => towards(knots[i - 1]),
        std::cmp::Ordering::Greater if i < last => towards(knots[i + 1]),
        _ => 1.0,
    }
}

/// The rows of the torque that are judged, and what a model leaves of all rows.
pub struct Side<'a> {
    pub p: &'a Problem,
    pub residual: Vec<f64>,
    pub rows: Vec<usize>,
}

impl Side<'_> {
    fn judged(&self, column: &[f64]) -> Vec<f64> {
        self.rows.iter().map(|r| column[*r]).collect()
    }

    pub fn energy(&self, residual: &[f64]) -> f64 {
        self.rows.iter().map(|r| residual[*r].powi(2)).sum()
    }
}

/// A model's own columns.
struct Own {
    /// constants, amplitudes, and what is of single runs: judged rows of the fit runs
    find: Vec<Vec<f64>>,
    /// how many are not of single runs
    of_model: usize,
    /// products of each with those before it and itself
    lower: Vec<Vec<f64>>,
    /// those that are not of single runs: the held-out runs
    prove: Vec<Vec<f64>>,
}

/// Products of columns with each other and those before them, from column `first` on.
fn products(columns: &[Vec<f64>], first: usize) -> Vec<Vec<f64>> {
    let of = |i: usize| columns[..=i].iter().map(|c| dot(&columns[i], c)).collect();
    (first..columns.len()).map(of).collect()
}

/// A model, and the rows that find and prove what is beside it.
pub struct Trial<'a> {
    pub m: &'a Material,
    pub model: &'a Fit,
    pub find: Side<'a>,
    pub prove: Side<'a>,
    own: OnceCell<Own>,
}

impl<'a> Trial<'a> {
    /// On the held-out rows that are judged; `None` where no data are held out.
    pub fn new(m: &'a Material, model: &'a Fit) -> Option<Self> {
        let held = m.held.as_ref()?;
        let judged = m.judged_residual(model);
        let rows = held.blocks_of(Equation::Torque).flat_map(|b| b.rows.clone());
        Some(Self::on(m, held, model, rows.filter(|r| judged[*r] != 0.0).collect()))
    }

    /// Another model on the same rows.
    pub fn of<'b>(&self, model: &'b Fit) -> Trial<'b>
    where
        'a: 'b,
    {
        Trial::on(self.m, self.prove.p, model, self.prove.rows.clone())
    }

    fn on(m: &'a Material, held: &'a Problem, model: &'a Fit, rows: Vec<usize>) -> Self {
        let find = Side {
            p: &m.fit,
            residual: model.residual.clone(),
            rows: m.fit.blocks_of(Equation::Torque).flat_map(|b| b.rows.clone()).collect(),
        };
        let prove = Side {
            p: held,
            residual: m.held_residual(model),
            rows,
        };
        Self {
            m,
            model,
            find,
            prove,
            own: OnceCell::new(),
        }
    }

    /// Energy that the model leaves of the held-out rows.
    pub fn left(&self) -> f64 {
        self.prove.energy(&self.prove.residual)
    }

    /// Energy of the sensors' noise in them.
    pub fn noise(&self) -> f64 {
        self.prove.rows.len() as f64 * self.prove.p.sensor_floor[Equation::Torque.index()].powi(2)
    }

    fn own(&self) -> &Own {
        self.own.get_or_init(|| {
            let of = |p: &Problem| -> Vec<Vec<f64>> {
                let (terms, constants) = (&self.model.terms, &self.m.constants);
                let regressors = fit::regressors(p, terms, constants);
                let base = fit::base(p, constants, terms, &regressors)
                    .into_iter()
                    .map(Cow::into_owned);
                base.chain(regressors.into_iter().flat_map(|r| r.linear)).collect()
            };
            let of_model = of(self.find.p);
            let all = of_model.iter().chain(&self.find.p.local);
            let find: Vec<Vec<f64>> = all.map(|c| self.find.judged(c)).collect();
            Own {
                lower: products(&find, 0),
                find,
                of_model: of_model.len(),
                prove: of(self.prove.p),
            }
        })
    }

    /// Energy that is left of the held-out rows with columns learnt on the fit runs, constants and amplitudes learnt once more beside them.
    pub fn left_with(&self, columns: &Columns<'_>) -> Option<f64> {
        let (find, own) = (&self.find, self.own());
        let (mut all, mut lower) = (own.find.clone(), own.lower.clone());
        all.extend(columns(find.p).iter().map(|c| find.judged(c)));
        lower.extend(products(&all, lower.len()));
        let y = find.judged(&find.residual);
        let n = all.len();
        let norms: Vec<f64> = (0..n).map(|i| lower[i][i].sqrt().max(1e-150)).collect();
        let mut gram = DMatrix::from_fn(n, n, |i, j| lower[i.max(j)][i.min(j)] / (norms[i] * norms[j]));
        let sigma = &self.model.sigma;
        let believed = self.model.believed.iter().enumerate();
        for (j, trust) in believed.filter_map(|(j, b)| Some((j, b.trust?))) {
            gram[(j, j)] += (sigma[Equation::Torque.index()] / trust.max(1e-9) / norms[j]).powi(2);
        }
        for i in 0..n {
            gram[(i, i)] += RIDGE;
        }
        let x = gram
            .cholesky()?
            .solve(&DVector::from_fn(n, |i, _| dot(&all[i], &y) / norms[i]));
        let mut r = self.prove.residual.clone();
        let learnt = (0..own.of_model).chain(own.find.len()..n);
        for (i, column) in learnt.zip(own.prove.iter().chain(&columns(self.prove.p))) {
            let size = x[i] / norms[i];
            add(&mut r, -size, column);
        }
        Some(self.prove.energy(&fit::without_local(self.prove.p, r, sigma)))
    }

    /// The same without any.
    pub fn left_alone(&self) -> Option<f64> {
        self.left_with(&|_| Vec::new())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn hats_add_up_to_one_and_reach_from_knot_to_knot() {
        let knots = [-1.0, 0.0, 0.5, 2.0];
        for x in [-3.0, -1.0, -0.3, 0.0, 0.2, 0.5, 1.9, 2.0, 7.0] {
            let sum: f64 = (0..4).map(|i| hat(&knots, i, x)).sum();
            assert!((sum - 1.0).abs() < 1e-15, "{x}: {sum}");
        }
        assert_eq!(
            [hat(&knots, 1, -0.25), hat(&knots, 2, -0.25), hat(&knots, 0, -0.25)],
            [0.75, 0.0, 0.25]
        );
    }
}
