//! Whether what effects leave has a form of its own: a law of a signal that the list does not have.

use crate::candidates::shapes::has_order;
use crate::equations::pieces::Piece;
use crate::equations::problem::{Block, Problem};
use crate::equations::signals::Signals;
use crate::measured::recording::extent;
use crate::measured::sums::dot;
use crate::search::fit::{self, Fit, Term};
use crate::search::remainder::{Regressor, edges};
use crate::search::select::Material;
use crate::search::unlisted::Unlisted;
use crate::search::verdict::BEYOND;
use nalgebra::{DMatrix, DVector};
use sim_worker::effect::{EffectKind, Equation};

/// Pieces of a form, as many samples in each.
const PIECES: usize = 12;
/// Share of what the effects explain that a form may take beside them (assumed: laws of the list left up to 0.004, a spring with a
/// cubic part 0.14, what is none of them up to 2).
pub(super) const MOST: f64 = 0.2;
/// Energy that a form takes, over that of a row, from which it is one (assumed).
const CLEAR: f64 = 100.0;
/// Keeps columns that are sums of others apart.
const RIDGE: f64 = 1e-7;

/// Why what was found is not what is there.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Strange {
    /// held-out data have a form beside the effects
    Form {
        /// of which signal
        of: Regressor,
        /// it turns over with the motion, as friction does
        signed: bool,
        /// energy that it takes, over that which the effects explain
        share: f64,
    },
    /// a law of a constant or of the time
    Unlisted(Unlisted),
    /// several effects stand for one law: of the same order of the rotor's turn, or frictions of the place
    Composed,
}

/// Torque by a signal, straight from knot to knot.
struct Hats {
    of: Regressor,
    signed: bool,
    knots: Vec<f64>,
}

impl Hats {
    fn new(p: &Problem, of: Regressor, signed: bool) -> Option<Self> {
        let samples = |b: &Block| -> Vec<f64> { b.samples.iter().map(|&k| of.value(&p.signals[b.run], k)).collect() };
        let torque = p.blocks.iter().filter(|b| b.equation == Equation::Torque);
        let (low, high) = extent(torque.flat_map(samples));
        let mut knots = vec![low];
        knots.extend(edges(p, Equation::Torque, of, PIECES));
        knots.push(high);
        knots.dedup();
        (knots.len() > 3).then_some(Self { of, signed, knots })
    }

    /// Share of knot `i` in a value.
    fn hat(&self, i: usize, x: f64) -> f64 {
        let (at, last) = (self.knots[i], self.knots.len() - 1);
        let towards = |from: f64| ((x - from) / (at - from)).max(0.0);
        match x.total_cmp(&at) {
            std::cmp::Ordering::Less if i > 0 => towards(self.knots[i - 1]),
            std::cmp::Ordering::Greater if i < last => towards(self.knots[i + 1]),
            _ => 1.0,
        }
    }

    fn columns(&self, p: &Problem) -> Vec<Vec<f64>> {
        let of_knot = |i: usize| {
            let of_run = |s: &Signals| {
                let torque = |k: usize| self.hat(i, self.of.value(s, k)) * if self.signed { s.sign[k] } else { 1.0 };
                vec![Piece::of(Equation::Torque, 0, (0..s.n).map(torque).collect())]
            };
            p.column(&p.signals.iter().map(of_run).collect::<Vec<_>>())
        };
        (0..self.knots.len()).map(of_knot).collect()
    }
}

/// The rows of one problem that are judged, what a model leaves of them, and its columns.
pub(super) struct Side<'a> {
    pub p: &'a Problem,
    pub residual: Vec<f64>,
    pub rows: Vec<usize>,
    columns: Vec<Vec<f64>>,
}

impl<'a> Side<'a> {
    /// * `judged` whether a row is
    pub fn new(p: &'a Problem, m: &Material, model: &Fit, residual: Vec<f64>, judged: impl Fn(usize) -> bool) -> Self {
        let torque = p.blocks.iter().filter(|b| b.equation == Equation::Torque);
        let regressors = fit::regressors(p, &model.terms, &m.constants);
        let amplitudes = regressors.into_iter().flat_map(|r| r.linear);
        Self {
            rows: torque.flat_map(|b| b.rows.clone()).filter(|r| judged(*r)).collect(),
            columns: p.base.iter().cloned().chain(amplitudes).collect(),
            residual,
            p,
        }
    }

    fn judged(&self, column: &[f64]) -> Vec<f64> {
        self.rows.iter().map(|r| column[*r]).collect()
    }

    pub fn energy(&self, residual: &[f64]) -> f64 {
        self.rows.iter().map(|r| residual[*r].powi(2)).sum()
    }
}

/// Judged columns of a model and of single runs on the fit runs, and their products.
pub(super) type Own = (Vec<Vec<f64>>, Vec<Vec<f64>>);

/// Products of columns with each other and those before them, from column `first` on.
fn products(columns: &[Vec<f64>], first: usize) -> Vec<Vec<f64>> {
    let of = |i: usize| columns[..=i].iter().map(|c| dot(&columns[i], c)).collect();
    (first..columns.len()).map(of).collect()
}

/// Columns of a form, or of a law, over the rows of a problem.
pub(super) type Columns<'a> = dyn Fn(&Problem) -> Vec<Vec<f64>> + 'a;

/// Energy that is left of the held-out rows with a form learnt on the fit runs, constants and amplitudes learnt once more beside it.
pub(super) fn left((find, own): (&Side, &Own), prove: &Side, model: &Fit, form: Option<&Columns<'_>>) -> Option<f64> {
    let hats = |p: &Problem| form.map_or_else(Vec::new, |f| f(p));
    let of_model = find.columns.len();
    let (mut columns, mut lower) = own.clone();
    columns.extend(hats(find.p).iter().map(|c| find.judged(c)));
    lower.extend(products(&columns, lower.len()));
    let y = find.judged(&find.residual);
    let n = columns.len();
    let norms: Vec<f64> = (0..n).map(|i| lower[i][i].sqrt().max(1e-150)).collect();
    let mut gram = DMatrix::from_fn(n, n, |i, j| lower[i.max(j)][i.min(j)] / (norms[i] * norms[j]));
    for (j, trust) in model
        .believed
        .iter()
        .enumerate()
        .filter_map(|(j, b)| Some((j, b.trust?)))
    {
        gram[(j, j)] += (model.sigma[Equation::Torque.index()] / trust.max(1e-9) / norms[j]).powi(2);
    }
    for i in 0..n {
        gram[(i, i)] += RIDGE;
    }
    let x = gram
        .cholesky()?
        .solve(&DVector::from_fn(n, |i, _| dot(&columns[i], &y) / norms[i]));
    let mut r = prove.residual.clone();
    let learnt = (0..of_model).chain(of_model + find.p.local.len()..n);
    for (i, column) in learnt.zip(prove.columns.iter().chain(&hats(prove.p))) {
        let size = x[i] / norms[i];
        r.iter_mut().zip(column).for_each(|(r, c)| *r -= size * c);
    }
    Some(prove.energy(&fit::without_local(prove.p, r, &model.sigma)))
}

/// Of the fit runs.
pub(super) fn own_of(find: &Side, m: &Material) -> Own {
    let all = find.columns.iter().chain(&m.fit.local);
    let columns: Vec<Vec<f64>> = all.map(|c| find.judged(c)).collect();
    let lower = products(&columns, 0);
    (columns, lower)
}

/// What the list does not have, though effects of it were found. Nothing where no data are held out.
///
/// * `retuned` the model without effects
pub fn strange(m: &Material, retuned: &Fit, model: &Fit) -> Option<Strange> {
    m.held.as_ref()?;
    if composed(&model.terms) {
        return Some(Strange::Composed);
    }
    let judged = m.judged_residual(model);
    let prove = Side::new(m.held_problem(), m, model, m.held_residual(model), |row| {
        judged[row] != 0.0
    });
    let left_of = prove.energy(&prove.residual);
    let explained = prove.energy(&m.held_residual(retuned)) - left_of;
    let clear = CLEAR * left_of / prove.rows.len().max(1) as f64;
    // what is within the noise has no form but that of a noise that stands in the regressors too
    let noise = prove.rows.len() as f64 * prove.p.sensor_floor[Equation::Torque.index()].powi(2);
    if explained < clear || left_of < BEYOND * noise {
        return None;
    }
    let find = Side::new(&m.fit, m, model, model.residual.clone(), |_| true);
    let own = own_of(&find, m);
    let alone = left((&find, &own), &prove, model, None)?;
    let laws = [
        (Regressor::Speed, false),
        (Regressor::Position, false),
        (Regressor::Position, true),
        (Regressor::Drive, false),
    ];
    // the chatter of phases stands in their current and in what is left alike
    let told = |of: Regressor| of != Regressor::Drive || !m.bench.has_phases();
    let forms = laws.into_iter().filter(|l| told(l.0)).filter_map(|(of, signed)| {
        let hats = Hats::new(&m.fit, of, signed)?;
        let taken = alone - left((&find, &own), &prove, model, Some(&|p| hats.columns(p)))?;
        let share = taken / explained;
        (taken > clear && share > MOST).then_some((share, Strange::Form { of, signed, share }))
    });
    forms.max_by(|a, b| a.0.total_cmp(&b.0)).map(|f| f.1)
}

/// Orders that are one (assumed).
const SAME_ORDER: f64 = 0.02;
/// So many effects are one law that the list does not have (assumed).
const COMPOSED: usize = 3;

fn composed(terms: &[Term]) -> bool {
    let of_place = |t: &&Term| matches!(t.kind, EffectKind::PeriodicFriction | EffectKind::TightSpot);
    let of_order = terms.iter().filter(|t| has_order(t.kind));
    let orders: Vec<f64> = of_order.map(|t| t.shape[0]).collect();
    let alike = |a: f64| orders.iter().filter(|b| (a - **b).abs() < SAME_ORDER * a).count();
    orders.iter().any(|a| alike(*a) >= COMPOSED) || terms.iter().filter(of_place).count() >= COMPOSED
}

#[cfg(test)]
mod tests {
    use super::*;
    use sim_worker::effect::EffectKind::*;

    #[test]
    fn hats_add_up_to_one_and_reach_from_knot_to_knot() {
        let knots = vec![-1.0, 0.0, 0.5, 2.0];
        let hats = Hats {
            of: Regressor::Speed,
            signed: false,
            knots,
        };
        for x in [-3.0, -1.0, -0.3, 0.0, 0.2, 0.5, 1.9, 2.0, 7.0] {
            let sum: f64 = (0..4).map(|i| hats.hat(i, x)).sum();
            assert!((sum - 1.0).abs() < 1e-15, "{x}: {sum}");
        }
        assert_eq!(
            [hats.hat(1, -0.25), hats.hat(2, -0.25), hats.hat(0, -0.25)],
            [0.75, 0.0, 0.25]
        );
    }

    #[test]
    fn three_of_one_order_or_of_the_place_stand_for_one_law() {
        let terms = |all: &[(EffectKind, f64)]| -> Vec<Term> {
            let term = |&(kind, first): &(EffectKind, f64)| Term {
                kind,
                shape: vec![first],
                amplitudes: vec![1.0],
            };
            all.iter().map(term).collect()
        };
        assert!(composed(&terms(&[
            (Cogging, 3.0),
            (TorqueRipple, 3.01),
            (PeriodicFriction, 2.99)
        ])));
        assert!(composed(&terms(&[
            (TightSpot, 1.0),
            (PeriodicFriction, 0.4),
            (TightSpot, 9.0)
        ])));
        // magnets have several orders, and an offset of a current makes a cogging of its ripple
        assert!(!composed(&terms(&[(Cogging, 6.0), (Cogging, 12.0), (Cogging, 18.0)])));
        assert!(!composed(&terms(&[
            (Cogging, 4.0),
            (TorqueRipple, 4.0),
            (TightSpot, 4.0)
        ])));
        assert!(!composed(&[]));
    }
}
