//! Profile likelihood of candidates on top of a model: every kind with its best shape.

use crate::candidates::columns::{self, Form};
use crate::candidates::shapes;
use crate::candidates::springs::{is_seen, is_slow, resonance};
use crate::equations::nuisances::Nuisance;
use crate::equations::pieces::RigConstants;
use crate::equations::problem::Problem;
use crate::measured::sums::{add, dot};
use crate::search::fit::{Assembled, Regressor, Score, Term, WORTH, log_likelihood};
use crate::search::shadow::{Cast, Shadow};
use crate::search::spectrum;
use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;
use sim_worker::effect::{EffectKind, Equation};

fn weighted(column: &[f64], weights: &[f64]) -> Vec<f64> {
    column.iter().zip(weights).map(|(x, w)| x * w).collect()
}

/// Orthonormal basis of what is fitted already, weighted, with the priors as further rows.
struct Basis {
    q: Vec<Vec<f64>>,
    weights: Vec<f64>,
    extra: usize,
}

impl Basis {
    fn new(p: &Problem, weights: &[f64], nuisances: &[Nuisance], fitted: &Assembled<'_>) -> Self {
        let extra = nuisances.len() + p.local.len();
        let mut basis = Self {
            q: Vec::new(),
            weights: weights.to_vec(),
            extra,
        };
        for (j, (column, n)) in fitted.base.iter().zip(nuisances).enumerate() {
            let mut c = basis.extended(column);
            if let Some(sigma) = n.trust {
                c[p.rows + j] = 1.0 / sigma.max(1e-9);
            }
            basis.push(c);
        }
        for (j, (column, trust)) in p.local.iter().zip(&p.local_trust).enumerate() {
            let mut c = basis.extended(column);
            if let Some(sigma) = trust {
                c[p.rows + nuisances.len() + j] = 1.0 / sigma.max(1e-12);
            }
            basis.push(c);
        }
        for column in &fitted.further {
            let c = basis.extended(column);
            basis.push(c);
        }
        basis
    }

    /// A column, weighted, with zeros where the priors stand.
    fn extended(&self, column: &[f64]) -> Vec<f64> {
        let mut c = weighted(column, &self.weights);
        c.resize(column.len() + self.extra, 0.0);
        c
    }

    fn push(&mut self, mut c: Vec<f64>) {
        let before = dot(&c, &c).sqrt();
        self.project(&mut c);
        self.project(&mut c);
        let norm = dot(&c, &c).sqrt();
        if norm > 1e-7 * before && norm > 0.0 {
            c.iter_mut().for_each(|x| *x /= norm);
            self.q.push(c);
        }
    }

    /// Takes the basis out of a weighted column.
    fn project(&self, c: &mut [f64]) {
        for q in &self.q {
            let s = dot(q, c);
            add(c, -s, q);
        }
    }
}

/// Widths of a tight spot that are one side of it, and those of the other from which on it is seen to fall again (assumed).
const WHOLE_SIDE: f64 = 2.0;
const FALLS_AGAIN: f64 = 0.4;
/// Of the steps of Gauss and Newton: damping of the first, share of a simplex's step over which a derivative is taken, how often a step is
/// damped further, and the log-likelihood below which nothing is gained.
const FIRST_DAMPING: f64 = 1e-3;
const DIFFERENCE: f64 = 0.02;
const MOST_DAMPED_STEPS: usize = 4;
const CONVERGED: f64 = 1e-3;
/// Springs of the grid that are refined.
const SPRINGS: usize = 4;

/// What candidates are measured against.
pub struct Scan<'a> {
    pub problem: &'a Problem,
    pub constants: &'a RigConstants,
    weights: Vec<f64>,
    /// basis of everything fitted, and the weighted left-hand side less it
    shadow: Shadow,
    /// weighted drive torque
    drive: Vec<f64>,
    /// standard deviation used for each equation
    sigma: [f64; 5],
    count: [f64; 5],
    /// without a further effect
    pub none: Score,
    /// orders of the rotor turn that stand out of the residual, by the kind that would make them
    orders: std::collections::BTreeMap<EffectKind, Vec<f64>>,
}

impl<'a> Scan<'a> {
    /// * `fitted` the model's equations
    pub fn new(
        p: &'a Problem,
        constants: &'a RigConstants,
        nuisances: &[Nuisance],
        fitted: &Assembled<'_>,
        sigma: [f64; 5],
    ) -> Self {
        let basis = Basis::new(p, &p.weights(&sigma), nuisances, fitted);
        let mut residual = basis.extended(&fitted.y);
        for (j, n) in nuisances.iter().enumerate() {
            if let Some(sigma) = n.trust {
                residual[p.rows + j] = n.centre / sigma.max(1e-9);
            }
        }
        basis.project(&mut residual);
        let drive = weighted(&p.drive, &basis.weights);
        let mut scan = Self {
            problem: p,
            constants,
            shadow: Shadow::new(p, basis.q, residual),
            weights: basis.weights,
            drive,
            sigma,
            count: Equation::ALL.map(|e| p.rows_of(e) as f64),
            none: Score {
                log_likelihood: 0.0,
                energy: [0.0; 5],
                amplitudes: Vec::new(),
            },
            orders: Default::default(),
        };
        scan.none = scan.scored(scan.shadow.left(&scan.shadow.sum([].into_iter())), Vec::new());
        scan
    }

    /// Looks for orders that are no whole numbers, too: the spectrum of the residual torque over the angle, as it
    /// is, with the sign of the motion, and with the drive.
    pub fn with_orders(mut self) -> Self {
        let p = self.problem;
        let unweighted: Vec<f64> = self.shadow.residual[..p.rows]
            .iter()
            .zip(&self.weights)
            .map(|(r, w)| r / w)
            .collect();
        let kinds: [(EffectKind, spectrum::Factor); 3] = [
            (EffectKind::Cogging, |_, _| 1.0),
            (EffectKind::PeriodicFriction, |s, k| s.sign[k]),
            (EffectKind::TorqueRipple, |s, k| s.drive[k]),
        ];
        for (kind, factor) in kinds {
            self.orders.insert(kind, spectrum::orders(p, &unweighted, factor));
        }
        self
    }

    /// * `weighted` what is left of each equation and, last, of the priors, squared
    fn scored(&self, weighted: ([f64; 5], f64), amplitudes: Vec<f64>) -> Score {
        let (mut energy, prior) = weighted;
        for e in 0..5 {
            energy[e] *= self.sigma[e].powi(2);
        }
        Score {
            log_likelihood: log_likelihood(self.problem, &energy, &self.count, prior),
            energy,
            amplitudes,
        }
    }

    /// Score with one more effect of this shape, or `None` where it cannot act or its sign is not physical.
    pub fn score(&self, kind: EffectKind, shape: &[f64]) -> Option<Score> {
        self.tried(kind, shape).map(|x| x.0)
    }

    /// The same, with what the effect adds.
    fn tried(&self, kind: EffectKind, shape: &[f64]) -> Option<(Score, Cast)> {
        let r = Regressor::new(self.problem, kind, shape, self.constants);
        if r.is_empty() {
            return None;
        }
        let shadow = &self.shadow;
        let fixed = r.fixed.as_ref().map(|f| shadow.of(weighted(f, &self.weights)));
        let mut free: Vec<Cast> = Vec::new();
        for c in &r.linear {
            let c = weighted(c, &self.weights);
            if !self.constants.measured_current && self.is_regressand(kind, &c, dot(&c, &c)) {
                return None;
            }
            let c = shadow.of(c);
            let (before, after) = (shadow.product(&c, &c), shadow.beyond(&c, &c));
            // hardly anything of its own: not excited, or the regressand in disguise
            if !(after > 1e-6 * before && after > 1e-12) {
                return None;
            }
            free.push(c);
        }
        let m = free.len();
        let mut amplitudes = Vec::new();
        let mut belief = 0.0;
        if m > 0 {
            belief = columns::trust(kind).map_or(0.0, |t| t.powi(-2));
            let own = |i: usize, j: usize| shadow.beyond(&free[i], &free[j]);
            let gram = DMatrix::from_fn(m, m, |i, j| own(i, j) + if i == j { belief } else { 0.0 });
            let right = DVector::from_fn(m, |i, _| {
                shadow.facing(&free[i]) - fixed.as_ref().map_or(0.0, |f| shadow.beyond(&free[i], f))
            });
            amplitudes = gram.cholesky()?.solve(&right).iter().copied().collect();
            // a phase that makes less torque than its current says has lost turns, for all that the torque shows
            let shorted = kind == EffectKind::CurrentGain && amplitudes.first().is_some_and(|a| *a > 0.0);
            if shorted && self.problem.rows_of(Equation::Electrical) == 0 {
                return None;
            }
            if !admissible(kind, &amplitudes) {
                return None;
            }
        }
        let taken = free.iter().zip(amplitudes.iter().copied());
        let added = shadow.sum(taken.chain(fixed.iter().map(|f| (f, 1.0))));
        let (energy, prior) = shadow.left(&added);
        let own = belief * amplitudes.iter().map(|a| a * a).sum::<f64>();
        Some((self.scored((energy, prior + own), amplitudes), added))
    }

    /// Whether a column of an effect in the drive signal is the drive signal itself, which would explain
    /// itself: more than 98 % of it.
    fn is_regressand(&self, kind: EffectKind, column: &[f64], energy: f64) -> bool {
        let of_drive = matches!(
            kind,
            EffectKind::TorqueSaturation | EffectKind::DeadTime | EffectKind::CurrentGain
        );
        let s = dot(column, &self.drive);
        of_drive && s * s > 0.9 * energy * dot(&self.drive, &self.drive)
    }

    /// The best shape of a kind: over its grid, then refined.
    pub fn best(&self, kind: EffectKind) -> Option<(Term, Score)> {
        let unseen = kind == EffectKind::Compliance && !self.bends();
        if unseen && !self.heard() {
            return None;
        }
        let mut shapes = if unseen {
            shapes::unseen_springs(&self.problem.signals, self.constants)
        } else {
            shapes::grid(kind, &self.problem.signals, self.constants)
        };
        if let Some(orders) = &self.orders.get(&kind) {
            shapes.extend(orders.iter().map(|n| vec![*n]));
            shapes.extend(self.few_periods());
        }
        let mut scored: Vec<(Vec<f64>, Score)> = shapes
            .into_par_iter()
            .filter(|s| self.inside(kind, s))
            .filter_map(|s| self.score(kind, &s).map(|x| (s, x)))
            .filter(|(shape, score)| !unseen || self.shown(shape, score))
            .collect();
        scored.sort_by(|a, b| a.1.log_likelihood.total_cmp(&b.1.log_likelihood));
        // of a spring the nearest start leads to the nearest resonance
        let (starts, steps) = match kind {
            EffectKind::Compliance if unseen => (UNSEEN_SPRINGS, 40),
            EffectKind::Compliance => (SPRINGS, 60),
            _ => (1, 40),
        };
        // a resonance that is there shows from far away
        if unseen
            && !scored
                .last()
                .is_some_and(|x| self.none.log_likelihood + LEAST_SHOWN < x.1.log_likelihood)
        {
            return None;
        }
        let best = scored.par_iter().rev().take(starts);
        best.map(|(shape, score)| self.refined(kind, shape, score, steps))
            .filter(|(term, score)| !unseen || self.shown(&term.shape, score))
            .max_by(|a, b| a.1.log_likelihood.total_cmp(&b.1.log_likelihood))
    }

    /// Refines the shape parameters on the profile likelihood: where the effect is smooth in them by Gauss and Newton's steps, else, or
    /// where those lead nowhere, by a simplex.
    pub fn refined(&self, kind: EffectKind, shape: &[f64], score: &Score, steps: usize) -> (Term, Score) {
        let scales = shapes::scales(kind, shape.len());
        let free: Vec<usize> = (0..scales.len()).filter(|i| scales[*i].is_some()).collect();
        let limits = shapes::limits(kind, &self.problem.signals);
        // stiffness and damping over the inertia behind them: those are known far better than the inertia
        let over = kind == EffectKind::Compliance;
        let plain = |x: &[f64]| -> Vec<f64> {
            let mut s = shape.to_vec();
            let mut x = x.to_vec();
            if over {
                (x[0], x[1]) = (x[0] + x[2], x[1] + x[2]);
            }
            for (j, &i) in free.iter().enumerate() {
                s[i] = if scales[i] == Some(true) { x[j].exp() } else { x[j] };
                s[i] = s[i].clamp(limits[i].0, limits[i].1);
            }
            s
        };
        let mut best = (shape.to_vec(), score.clone());
        if !free.is_empty() {
            let mut start: Vec<f64> = free
                .iter()
                .map(|&i| {
                    if scales[i] == Some(true) {
                        shape[i].ln()
                    } else {
                        shape[i]
                    }
                })
                .collect();
            if over {
                (start[0], start[1]) = (start[0] - start[2], start[1] - start[2]);
            }
            let step: Vec<f64> = free
                .iter()
                .map(|&i| match (kind, scales[i]) {
                    (EffectKind::TightSpot, Some(false)) => 0.5 * shape[1],
                    (k, _) if shapes::has_order(k) => self.order_step(),
                    (EffectKind::Stribeck, Some(false)) => 0.3,
                    (EffectKind::Backlash, Some(false)) if i == 2 => 0.3 * shape[i].max(1e3),
                    (_, Some(true)) => 0.35,
                    _ => 0.08,
                })
                .collect();
            let mut tried = |x: &[f64]| {
                let s = plain(x);
                let (score, added) = self.tried(kind, &s).filter(|_| self.inside(kind, &s))?;
                let value = -score.log_likelihood;
                if score.log_likelihood > best.1.log_likelihood {
                    best = (s, score);
                }
                Some((value, added))
            };
            let smooth = over || shapes::has_order(kind);
            if !(smooth && self.descended(&start, &step, steps, &mut tried)) {
                simplex(&start, &step, steps, |x| tried(x).map_or(f64::MAX, |t| t.0));
            }
        }
        let term = Term {
            kind,
            shape: best.0,
            amplitudes: best.1.amplitudes.clone(),
        };
        (term, best.1)
    }

    /// Gauss and Newton's steps in the residual of the profile, damped (Levenberg and Marquardt; Golub and Pereyra's variable projection,
    /// with differences for derivatives). `false` where a descent is foreseen and the first step finds none.
    ///
    /// * `step` as wide as a likelihood changes, twice of which no step is wider
    /// * `tried` what is minimised at a point, and what the effect adds there
    fn descended(
        &self,
        start: &[f64],
        step: &[f64],
        calls: usize,
        tried: &mut impl FnMut(&[f64]) -> Option<(f64, Cast)>,
    ) -> bool {
        let n = start.len();
        let Some((mut value, mut added)) = tried(start) else {
            return false;
        };
        let (mut x, mut used, mut damping) = (start.to_vec(), 1, FIRST_DAMPING);
        while used + n < calls {
            let mut slopes = Vec::new();
            for j in 0..n {
                let beside = [DIFFERENCE * step[j], -DIFFERENCE * step[j]].into_iter().find_map(|h| {
                    let mut there = x.clone();
                    there[j] += h;
                    used += 1;
                    Some((tried(&there)?.1, h))
                });
                let Some((there, h)) = beside else { return false };
                slopes.push(self.shadow.sum([(&there, 1.0 / h), (&added, -1.0 / h)].into_iter()));
            }
            let gram = DMatrix::from_fn(n, n, |i, j| self.shadow.beyond(&slopes[i], &slopes[j]));
            let right = DVector::from_fn(n, |j, _| {
                self.shadow.facing(&slopes[j]) - self.shadow.beyond(&added, &slopes[j])
            });
            let mut next = None;
            for _ in 0..MOST_DAMPED_STEPS {
                let mut damped = gram.clone();
                for j in 0..n {
                    damped[(j, j)] += damping * gram[(j, j)] + 1e-12 / step[j].powi(2);
                }
                let Some(mut by) = damped.cholesky().map(|c| c.solve(&right)) else {
                    break;
                };
                let widest = (0..n).map(|j| by[j].abs() / (2.0 * step[j])).fold(1.0, f64::max);
                by /= widest;
                if by.dot(&right) < CONVERGED {
                    // nothing is to be had any more
                    return true;
                }
                let there: Vec<f64> = (0..n).map(|j| x[j] + by[j]).collect();
                used += 1;
                next = tried(&there).filter(|t| t.0 < value).map(|t| (there, t));
                if next.is_some() {
                    damping *= 0.1;
                    break;
                }
                damping *= 10.0;
            }
            let Some((there, (less, with))) = next else {
                return x != start;
            };
            let gain = value - less;
            (x, value, added) = (there, less, with);
            if gain < CONVERGED {
                break;
            }
        }
        true
    }

    /// Whether a tight spot lies within the travel, so far that friction is seen to fall again on both sides: else it
    /// may as well be the end of the stroke. And whether what repeats with the angle is seen to repeat: less than a
    /// period is any smooth curve.
    fn inside(&self, kind: EffectKind, shape: &[f64]) -> bool {
        let (low, high) = self.problem.travel();
        match kind {
            // one side as a whole, and of the other so much that it is seen to fall again
            EffectKind::TightSpot => {
                let sides = [shape[0] - low, high - shape[0]].map(|side| side / shape[1]);
                sides.iter().all(|s| *s > FALLS_AGAIN) && sides.iter().any(|s| *s > WHOLE_SIDE)
            }
            k if shapes::has_order(k) => shape[0] * (high - low) > LEAST_PERIODS * std::f64::consts::TAU,
            EffectKind::Compliance if !is_seen(self.problem, shape) => self.resounds(shape),
            _ => true,
        }
    }

    /// Whether a second sensor sees the load elsewhere than the motor: else it turns with the motor, and a spring is beyond it.
    fn bends(&self) -> bool {
        let e = Equation::Transmission;
        self.problem.rows_of(e) > 0 && self.none.energy[e.index()] >= WORTH * self.problem.sensor_energy(e.index())
    }

    /// Whether more is left of the torque than its noise, so that a spring can be heard in it.
    fn heard(&self) -> bool {
        let (p, e) = (self.problem, Equation::Torque);
        let noise = if p.on_time() {
            let unweighted = self.shadow.residual[..p.rows].iter().map(|r| r * self.sigma[e.index()]);
            p.quiet_energy(&unweighted.collect::<Vec<_>>(), e)
        } else {
            LEAST_NOISE * p.sensor_energy(e.index())
        };
        self.none.energy[e.index()] > noise
    }

    /// Whether the torque is told better by a load that the motion drives: of two motions that agree better, sensors are the usual reason.
    fn shown(&self, shape: &[f64], score: &Score) -> bool {
        let torque = Equation::Torque.index();
        !is_slow(shape) || score.energy[torque] < (1.0 - LEAST_HEARD) * self.none.energy[torque]
    }

    /// Whether a load on its spring swings so that the torque alone shows it: what is faster than the samples follow is a torque that is
    /// late, or is not even between them; what is damped out at once is a drag; what weighs next to nothing is noise.
    fn resounds(&self, shape: &[f64]) -> bool {
        let (swing, damped) = resonance(shape, self.constants.inertia);
        let lighter = shape[2].min(self.constants.inertia - shape[2]);
        let (most_damped, most_swing) = match (self.problem.on_time(), is_slow(shape)) {
            (_, true) => (MOST_DAMPED, MOST_SWING_SLOW),
            (true, false) => (MOST_DAMPED_ON_TIME, MOST_SWING_ON_TIME),
            (false, false) => (MOST_DAMPED, MOST_SWING),
        };
        lighter > LEAST_SIDE * self.constants.inertia
            && damped < most_damped
            && swing < most_swing * std::f64::consts::TAU * self.problem.clock.rate_hz
    }

    /// Orders of a few periods over the stroke, which no spectrum shows where some of the stroke is seen more often than the rest.
    fn few_periods(&self) -> impl Iterator<Item = Vec<f64>> {
        let (low, high) = self.problem.travel();
        let turns = ((high - low) / std::f64::consts::TAU).max(1e-9);
        let periods = (1..).map(|i| LEAST_PERIODS + PERIOD_STEP * f64::from(i));
        periods.take_while(|p| *p <= FEW_PERIODS).map(move |p| vec![p / turns])
    }

    /// A tenth of the order that a whole turn more over the stroke makes.
    fn order_step(&self) -> f64 {
        let (low, high) = self.problem.travel();
        0.1 * std::f64::consts::TAU / (high - low).max(1e-9)
    }
}

/// Periods over the travel from which something is seen to repeat (assumed).
const LEAST_PERIODS: f64 = 1.5;
/// Of a spring that only the torque shows (assumed): most frequency of the free resonance over that of the samples, most of its
/// damping ratio, least share of the inertia on either side. Further where the torque is on time.
const MOST_SWING: f64 = 0.08;
const MOST_DAMPED: f64 = 0.25;
const MOST_SWING_ON_TIME: f64 = 0.2;
const MOST_DAMPED_ON_TIME: f64 = 0.5;
const LEAST_SIDE: f64 = 0.05;
/// Most frequency of one that the measured motion drives (assumed): faster ones swallow the motion's noise.
const MOST_SWING_SLOW: f64 = 0.03;
/// Share of the torque's gap that a spring takes which only the torque shows, of a rig (assumed).
pub(super) const LEAST_HEARD: f64 = 0.2;
/// Of one of these (assumed): energy of the torque's gap over that of its noise from which it is looked for, gain in log-likelihood of
/// the best of the grid from which that is refined, and how many of the grid are.
const LEAST_NOISE: f64 = 1.2;
const LEAST_SHOWN: f64 = 5.0;
const UNSEEN_SPRINGS: usize = 2;
/// From there so many more a step, up to which all are tried (assumed).
const PERIOD_STEP: f64 = 0.25;
const FEW_PERIODS: f64 = 5.0;

/// Whether amplitudes have the sign that physics allows.
pub fn admissible(kind: EffectKind, amplitudes: &[f64]) -> bool {
    match columns::form(kind) {
        Form::Amplitude => {
            let key = &kind.keys()[0];
            amplitudes[0] >= key.low.min(0.0) && amplitudes[0] <= key.high.max(0.0) && amplitudes[0] != 0.0
        }
        Form::Heating => amplitudes[0] > 0.0,
        _ => true,
    }
}

/// Nelder and Mead's simplex; `f` keeps its best itself.
pub fn simplex(start: &[f64], step: &[f64], calls: usize, mut f: impl FnMut(&[f64]) -> f64) {
    let n = start.len();
    let mut points: Vec<(Vec<f64>, f64)> = vec![(start.to_vec(), f(start))];
    for i in 0..n {
        let mut x = start.to_vec();
        x[i] += step[i];
        let y = f(&x);
        points.push((x, y));
    }
    let mut used = n + 1;
    while used < calls {
        points.sort_by(|a, b| a.1.total_cmp(&b.1));
        let spread = points[n].1 - points[0].1;
        if spread.abs() < 1e-3 {
            break;
        }
        let centre: Vec<f64> = (0..n)
            .map(|i| points[..n].iter().map(|p| p.0[i]).sum::<f64>() / n as f64)
            .collect();
        let at = |t: f64| -> Vec<f64> { (0..n).map(|i| centre[i] + t * (points[n].0[i] - centre[i])).collect() };
        let mut call = |x: Vec<f64>| {
            used += 1;
            let y = f(&x);
            (x, y)
        };
        let reflected = call(at(-1.0));
        if reflected.1 < points[0].1 {
            let expanded = call(at(-2.0));
            points[n] = if expanded.1 < reflected.1 { expanded } else { reflected };
        } else if reflected.1 < points[n - 1].1 {
            points[n] = reflected;
        } else {
            let contracted = if reflected.1 < points[n].1 {
                call(at(-0.5))
            } else {
                call(at(0.5))
            };
            if contracted.1 < points[n].1.min(reflected.1) {
                points[n] = contracted;
            } else {
                for i in 1..=n {
                    let x: Vec<f64> = (0..n).map(|j| 0.5 * (points[0].0[j] + points[i].0[j])).collect();
                    points[i] = call(x);
                }
            }
        }
    }
}
