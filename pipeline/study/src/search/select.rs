//! Which effects are missing: the candidates are ranked, taken one after another, and kept only
//! while data that were not used to find them get better.

use crate::candidates::columns;
use crate::candidates::shapes;
use crate::equations::clock::{Clock, NoiseTable};
use crate::equations::nuisances::{self, Nuisance};
use crate::equations::pieces::RigConstants;
use crate::equations::problem::{self, Problem};
use crate::equations::signals;
use crate::measured::bench::{Bench, BenchChannel, Known, Noise, Role};
use crate::measured::check;
use crate::measured::filtered;
use crate::measured::recording::{self, Run};
use crate::measured::sums::add;
use crate::measured::winding;
use crate::search::excitation;
use crate::search::fit::{self, Fit, Regressor, Score, Term};
use crate::search::scan::Scan;
use crate::search::supply;
use rayon::prelude::*;
use sim_worker::effect::{Effect, EffectKind, Equation};
use std::sync::Arc;

/// Log-likelihood by which another shape of an effect that is in the model must be better (assumed).
const ANEW: f64 = 5.0;
/// Standard deviations from which a belief about friction is given up (assumed).
const STRANGE: f64 = 2.5;

/// All that a study works on.
pub struct Material {
    pub bench: Bench,
    pub runs: Arc<Vec<Run>>,
    /// of every channel; it does not change while a study goes on
    pub noise: NoiseTable,
    pub clock: Clock,
    pub equations: Vec<Equation>,
    pub nuisances: Vec<Nuisance>,
    pub constants: RigConstants,
    pub fit: Problem,
    pub held: Option<Problem>,
    /// effects that the model has already
    known: Vec<Effect>,
    /// torque that the model under study does not have, and what the drive does between its samples, rms [N m]
    pub(super) excess: (f64, f64),
    /// delays of the channels as the bench says them [s]
    pub(super) said: Vec<(BenchChannel, f64)>,
}

/// A candidate after its shape was refined.
#[derive(Clone, Debug)]
pub struct Ranked {
    /// with its best shape and amplitudes
    pub term: Term,
    pub score: Score,
    /// gain in log-likelihood over the model without it
    pub gain: f64,
}

/// Least reciprocal of an inertia over the one before, of one round (assumed).
const LEAST_RECIPROCAL: f64 = 0.3;

/// Rounds in which constants are carried into equations that are set up afresh.
const ROUNDS_AFRESH: usize = 3;

impl Material {
    /// * `known` effects that the model has already
    pub fn new(mut bench: Bench, mut runs: Vec<Run>, known: &[Effect]) -> Self {
        winding::feed(&mut bench, &mut runs);
        filtered::leave_out(&mut bench, &mut runs);
        recording::taken_together(&mut bench, &mut runs);
        begin(&mut bench, &runs);
        let noise = signals::noise_table(&bench, &runs);
        let equations = nuisances::equations(&bench, &runs.iter().collect::<Vec<_>>());
        let nuisances = nuisances::nuisances(&bench, &runs, &noise, &equations);
        let swing = signals::swing(&bench, &runs);
        let runs = Arc::new(runs);
        let m = Self::set_up(bench, runs, noise, nuisances, known.to_vec(), (0.0, 0.0));
        let mut m = m.on_time(&[]);
        // the mean over a sample of a drive that is read at points is as uncertain as it swings between them, but
        // it may be held between them: the data say
        if swing > 0.0 {
            let base = m.solve(&[], m.first_sigma());
            let between = m.fit.unresolved(&base.residual).min(swing);
            if between > 0.0 {
                m = m
                    .again(m.bench.clone(), m.nuisances.clone(), (0.0, between))
                    .on_time(&[]);
            }
        }
        m
    }

    /// Set up again with another bench, other nuisances, other torque noise.
    pub(super) fn again(&self, bench: Bench, nuisances: Vec<Nuisance>, excess: (f64, f64)) -> Self {
        let (runs, noise, known) = (self.runs.clone(), self.noise.clone(), self.known.clone());
        let next = Self::set_up(bench, runs, noise, nuisances, known, excess);
        Self {
            said: self.said.clone(),
            ..next
        }
    }

    fn set_up(
        bench: Bench,
        runs: Arc<Vec<Run>>,
        noise: NoiseTable,
        nuisances: Vec<Nuisance>,
        known: Vec<Effect>,
        excess: (f64, f64),
    ) -> Self {
        let of = |role: &[Role]| -> Vec<&Run> { runs.iter().filter(|r| role.contains(&r.role)).collect() };
        let used = of(&[Role::Fit, Role::Select, Role::HeldOut]);
        let clock = Clock::new(&bench, &used, &noise);
        let equations = nuisances::equations(&bench, &used);
        let constants = nuisances::constants(&bench, &clock);
        let build = |runs: &[&Run]| Problem::new(&bench, runs, &used, &clock, &noise, &equations, &nuisances, excess);
        let mut fit = build(&of(&[Role::Fit, Role::Select]));
        let held = of(&[Role::HeldOut]);
        let mut held = (!held.is_empty()).then(|| build(&held));
        for p in [Some(&mut fit), held.as_mut()].into_iter().flatten() {
            let hottest = fit::hottest(p);
            for e in &known {
                let (shape, amplitudes) = columns::parts(e, constants.effect.coulomb, hottest);
                let r = Regressor::new(p, e.kind, &shape, &constants);
                let linear = amplitudes.iter().zip(&r.linear);
                for (a, column) in r.fixed.iter().map(|f| (1.0, f)).chain(linear.map(|(a, c)| (*a, c))) {
                    add(&mut p.y, -a, column);
                }
            }
        }
        // means between point samples of a current that swings are not known as well as its samples
        let spec = bench.channel(bench.rig.drive);
        if equations.contains(&Equation::Electrical)
            && spec.is_some_and(|d| !d.mean || !matches!(d.noise, Noise::Known(_)))
        {
            let base = fit::solve(&fit, &constants, &nuisances, &[], fit.floor.map(|f| f.max(1e-300)));
            let rms = fit.by_differences(&base.residual, Equation::Electrical);
            for p in [Some(&mut fit), held.as_mut()].into_iter().flatten() {
                p.raise_floor(Equation::Electrical, rms);
            }
        }
        let found = mains(&fit, &constants, &nuisances);
        for f in &found {
            for p in [Some(&mut fit), held.as_mut()].into_iter().flatten() {
                for b in 0..p.blocks.len() {
                    if p.blocks[b].equation == f.0 {
                        p.add_hum(b, f.1);
                    }
                }
            }
        }
        let said = bench.channels.iter().map(|c| (c.channel, c.delay_s)).collect();
        Self {
            said,
            bench,
            runs,
            noise,
            clock,
            equations,
            nuisances,
            constants,
            fit,
            held,
            known,
            excess,
        }
    }

    /// The same runs with the equations set up around the constants of a fit, so that what is left
    /// of the deviations is small; the priors stay where they were.
    pub fn around(&self, fit: &Fit) -> Self {
        self.around_with(fit, self.fit.excess_left(&fit.score.energy))
    }

    /// * `excess` torque that the model does not have, rms [N m]
    fn around_with(&self, fit: &Fit, excess: f64) -> Self {
        let mut bench = self.bench.clone();
        let mut moved = Vec::new();
        for (n, x) in self.nuisances.iter().zip(&fit.nuisance) {
            let rig = &mut bench.rig;
            let value = match n.name {
                "inertia" => &mut rig.inertia.value,
                "viscous" => &mut rig.viscous.value,
                "coulomb" => &mut rig.coulomb.value,
                "resistance" => &mut rig.resistance.value,
                "inductance" => &mut rig.inductance.value,
                "torque_constant" => &mut rig.drive_constant.value,
                "offset" => &mut rig.offset,
                _ => continue,
            };
            let factor = match n.name {
                // the rows have the torque over it: a change is of its reciprocal
                "inertia" if self.fit.inertia.is_some() => 1.0 / (1.0 - x).max(LEAST_RECIPROCAL),
                _ => (1.0 + x).max(0.05),
            };
            if *value <= 0.0 && n.name != "offset" {
                continue;
            }
            *value *= factor;
            moved.push((n.name, factor));
            if n.name == "torque_constant" {
                rig.back_emf.value *= factor;
            }
        }
        let off = |name: &str| fit::deviation(&self.nuisances, fit, name).map_or(0.0, |(n, x)| n.nominal * x);
        let offset = fit.terms.iter().find(|t| t.kind == EffectKind::CurrentOffset);
        let found = offset.filter(|_| !bench.has_phases()).map_or(0.0, |t| t.amplitudes[0]);
        bench.rig.drive_error = (off("drive_offset") + found, off("drive_clock"));
        let mut nuisances = self.nuisances.clone();
        for n in &mut nuisances {
            if let ("between_samples", Some((_, factor))) = (n.name, moved.iter().find(|m| m.0 == "inductance")) {
                n.trust = n.trust.map(|t| t / factor);
            }
            if let Some((_, factor)) = moved.iter().find(|m| m.0 == n.name) {
                // 1 + x_old = factor (1 + x_new)
                n.centre = (1.0 + n.centre) / factor - 1.0;
                n.trust = n.trust.map(|t| t / factor);
                n.nominal *= factor;
                // friction that is far from what was believed is another friction: what was believed
                // of it says nothing about the scale of the rest
                let friction = matches!(n.name, "coulomb" | "viscous");
                if friction && n.trust.is_some_and(|t| n.centre.abs() > STRANGE * t) {
                    n.trust = None;
                    n.centre = 0.0;
                }
            }
        }
        let sensor = fit.terms.iter().find(|t| t.kind == EffectKind::EncoderEccentricity);
        if let Some(t) = sensor {
            bench.rig.encoder = (t.amplitudes[0], t.amplitudes[1]);
            bench.rig.encoder_speed = t.shape.first().is_some_and(|x| *x > 0.5);
        }
        self.again(bench, nuisances, (excess, self.excess.1))
    }

    /// The equations and a fit as they are where nothing else was ever in its place: what was left beside an effect that is none says
    /// nothing of the noise.
    pub(super) fn afresh(&self, fit: &Fit) -> (Self, Fit) {
        let mut m = self.again(self.bench.clone(), self.nuisances.clone(), (0.0, self.excess.1));
        let mut model = m.polish(&m.solve(&fit.terms, m.first_sigma()), 1);
        for _ in 0..ROUNDS_AFRESH {
            (m, model) = m.refitted(&model);
        }
        (m, model)
    }

    /// The same around a fit, and its terms there: a load on its spring is a share of the inertia.
    pub fn carried(&self, fit: &Fit) -> (Self, Vec<Term>) {
        self.carried_with(fit, self.fit.excess_left(&fit.score.energy))
    }

    /// * `excess` torque that the model does not have, rms [N m]
    fn carried_with(&self, fit: &Fit, excess: f64) -> (Self, Vec<Term>) {
        let around = self.around_with(fit, excess);
        let factor = around.constants.inertia / self.constants.inertia.max(1e-300);
        let mut terms = fit.terms.clone();
        for t in terms.iter_mut().filter(|t| t.kind == EffectKind::Compliance) {
            t.shape.iter_mut().take(3).for_each(|x| *x *= factor);
        }
        (around, terms)
    }

    /// The same, fitted there.
    pub(super) fn refitted(&self, fit: &Fit) -> (Self, Fit) {
        fitted_there(self.carried(fit), fit)
    }

    /// The same, fitted there by no other noise, so that what two models leave compares.
    pub(super) fn refitted_alike(&self, fit: &Fit) -> (Self, Fit) {
        fitted_there(self.carried_with(fit, self.excess.0), fit)
    }

    /// The same with what was believed of friction before that was given up; `None` where nothing was.
    ///
    /// * `first` beliefs around the model's own constants
    pub(super) fn believing(&self, first: &[Nuisance]) -> Option<Self> {
        let mut nuisances = self.nuisances.clone();
        let mut any = false;
        let friction = |n: &&mut Nuisance| matches!(n.name, "coulomb" | "viscous") && n.trust.is_none();
        for n in nuisances.iter_mut().filter(friction) {
            let Some(was) = first.iter().find(|f| f.name == n.name && f.nominal * n.nominal > 0.0) else {
                continue;
            };
            let factor = was.nominal / n.nominal;
            if let Some(trust) = was.trust {
                (n.trust, n.centre) = (Some(trust * factor), (1.0 + was.centre) * factor - 1.0);
                any = true;
            }
        }
        any.then(|| self.again(self.bench.clone(), nuisances, self.excess))
    }

    /// The same without what is believed of constants that a fit holds at the end of their belief, though a voltage shows them;
    /// `None` where there are none.
    ///
    /// * `names` of those that may be let go
    pub(super) fn let_go(&self, fit: &Fit, names: &[&str]) -> Option<Self> {
        if !self.equations.contains(&Equation::Electrical) || self.bench.has_phases() {
            return None;
        }
        let mut free = self.nuisances.clone();
        let mut any = false;
        for (n, held) in free.iter_mut().zip(&fit.believed) {
            if names.contains(&n.name) && n.trust != held.trust {
                (n.trust, n.centre) = (None, 0.0);
                any = true;
            }
        }
        any.then(|| self.again(self.bench.clone(), free, self.excess))
    }

    /// Standard deviations to begin with: what is left when only constants are re-tuned.
    pub fn first_sigma(&self) -> [f64; 5] {
        self.fit.floor.map(|f| f.max(1e-300))
    }

    pub fn solve(&self, terms: &[Term], sigma: [f64; 5]) -> Fit {
        fit::solve(&self.fit, &self.constants, &self.nuisances, terms, sigma)
    }

    /// All candidates on top of a model, best first.
    pub fn scan(&self, model: &Fit, kinds: &[EffectKind]) -> Vec<Ranked> {
        let regs = fit::regressors(&self.fit, &model.terms, &self.constants);
        let fitted = fit::assembled(&self.fit, &self.constants, &model.terms, &regs);
        // a sensor that the model holds at the end of its belief is held: what runs beyond it is what candidates are to explain
        let pairs = self.nuisances.iter().zip(&model.believed);
        let nuisances: Vec<Nuisance> = pairs
            .map(|(n, held)| if n.of_machine { n } else { held }.clone())
            .collect();
        let of = |n: &[Nuisance]| Scan::new(&self.fit, &self.constants, n, &fitted, model.sigma);
        let scan = of(&nuisances).with_orders();
        let silent = excitation::not_excited(self);
        let open = |k: &EffectKind| !silent.iter().any(|s| s.0 == k.name()) && (takes_several(*k) || !model.has(*k));
        let kinds: Vec<EffectKind> = kinds.iter().copied().filter(open).collect();
        // a load on its spring, beside an inertia that may be anything
        let spring = kinds.contains(&EffectKind::Compliance);
        let freed = fit::beside(&nuisances, spring.then_some(EffectKind::Compliance));
        let freed = freed.map(|n| of(&n));
        let mut all: Vec<Ranked> = kinds
            .par_iter()
            .filter_map(|&k| {
                let scan = freed.as_ref().filter(|_| k == EffectKind::Compliance).unwrap_or(&scan);
                let (term, score) = scan.best(k)?;
                let gain = score.log_likelihood - scan.none.log_likelihood;
                Some(Ranked { term, score, gain })
            })
            .collect();
        all.sort_by(|a, b| b.gain.total_cmp(&a.gain));
        all
    }

    /// What one of some terms is measured against: all the others.
    fn beside_others(&self, terms: &[Term], one: usize, sigma: [f64; 5]) -> Scan<'_> {
        let mut others = terms.to_vec();
        others.remove(one);
        let regs = fit::regressors(&self.fit, &others, &self.constants);
        let fitted = fit::assembled(&self.fit, &self.constants, &others, &regs);
        let tied = fit::beside(&self.nuisances, terms.iter().map(|t| t.kind));
        let nuisances = tied.as_ref().unwrap_or(&self.nuisances);
        Scan::new(&self.fit, &self.constants, nuisances, &fitted, sigma)
    }

    /// Refines the shapes of all terms in turn, then solves.
    pub fn polish(&self, model: &Fit, rounds: usize) -> Fit {
        let mut terms = model.terms.clone();
        let mut sigma = model.sigma;
        for _ in 0..rounds {
            for i in 0..terms.len() {
                let scan = self.beside_others(&terms, i, sigma);
                if let Some(score) = scan.score(terms[i].kind, &terms[i].shape) {
                    terms[i] = whole(scan.refined(terms[i].kind, &terms[i].shape, &score, 60).0);
                }
            }
            let fit = self.solve(&terms, sigma);
            terms = fit.terms.clone();
            sigma = fit.sigma;
        }
        self.solve(&terms, sigma)
    }

    /// A model whose shapes, but for orders and the last one's, are looked for once more over their grids: where they were found other
    /// effects were missing.
    pub(super) fn anew(&self, model: Fit) -> Fit {
        let mut terms = model.terms.clone();
        let older = 0..terms.len().saturating_sub(1);
        for i in older.filter(|i| !shapes::has_order(model.terms[*i].kind) && !model.terms[*i].shape.is_empty()) {
            let scan = self.beside_others(&terms, i, model.sigma);
            let now = scan.score(terms[i].kind, &terms[i].shape);
            if let Some((term, score)) = scan.best(terms[i].kind)
                && now.is_none_or(|now| score.log_likelihood > now.log_likelihood + ANEW)
            {
                terms[i] = term;
            }
        }
        if terms.iter().zip(&model.terms).all(|(a, b)| a.shape == b.shape) {
            return model;
        }
        let other = self.polish(&self.solve(&terms, model.sigma), 1);
        if other.score.log_likelihood > model.score.log_likelihood {
            other
        } else {
            model
        }
    }

    /// Share of the rows' greatest possible gap: rms by equation over the floor.
    pub fn over_floor(&self, p: &Problem, energy: &[f64; 5]) -> [f64; 5] {
        std::array::from_fn(|e| {
            let n = p.rows_of(Equation::ALL[e]) as f64;
            if n > 0.0 {
                (energy[e] / n).sqrt() / p.sensor_floor[e]
            } else {
                f64::NAN
            }
        })
    }

    /// The equation in which an effect is seen here: its own, or that of the torque.
    pub fn seen_in(&self, term: &Term) -> Equation {
        let e = term.equation();
        if self.fit.rows_of(e) > 0 { e } else { Equation::Torque }
    }

    pub fn has(&self, c: BenchChannel) -> bool {
        self.runs.iter().all(|r| r.channel(c).is_some())
    }
}

/// * `terms` of a fit in the equations where they are fitted
fn fitted_there((m, terms): (Material, Vec<Term>), fit: &Fit) -> (Material, Fit) {
    let model = m.polish(&m.solve(&terms, fit.sigma), 1);
    (m, model)
}

/// Constants that nobody knows begin where a straight fit of the smoothed signals puts them.
fn begin(bench: &mut Bench, runs: &[Run]) {
    let free = |k: &Known| k.value <= 0.0 && k.trust != Some(0.0);
    let used: Vec<&Run> = runs
        .iter()
        .filter(|r| matches!(r.role, Role::Fit | Role::Select) && !r.steady)
        .collect();
    if let Some((volts, sd)) = supply::at_rest(bench, &used) {
        let rig = &mut bench.rig;
        rig.supply_of_file = Some((rig.supply_voltage, sd));
        rig.supply_voltage = volts;
    }
    let rig = &mut bench.rig;
    if !rig.supply_voltage.is_finite() {
        // as high as it hardly ever is: hardly loaded
        let mut volts: Vec<f64> = used
            .iter()
            .filter_map(|r| r.channel(BenchChannel::VDc))
            .flatten()
            .copied()
            .collect();
        if !volts.is_empty() {
            let order = volts.len() * 19 / 20;
            rig.supply_voltage = *volts.select_nth_unstable_by(order, f64::total_cmp).1;
        }
    }
    if !(free(&rig.inertia) || free(&rig.coulomb) || free(&rig.viscous) || free(&rig.resistance)) {
        return;
    }
    let rough = check::rough(bench, &used);
    let rig = &mut bench.rig;
    if let Some([j, b, c]) = rough {
        for (k, x) in [(&mut rig.inertia, j), (&mut rig.viscous, b), (&mut rig.coulomb, c)] {
            if free(k) {
                (k.value, k.trust) = (x.max(0.0), None);
            }
        }
    }
    if rig.resistance.value <= 0.0 {
        let rms = |c: BenchChannel| {
            let all = used.iter().filter_map(|r| r.channel(c)).flatten();
            let (s, n) = all.fold((0.0, 0.0), |(s, n), x| (s + x * x, n + 1.0));
            (s / f64::max(n, 1.0)).sqrt()
        };
        // only a place to begin: the equation says the rest
        let (v, i) = (rms(BenchChannel::Voltage), rms(rig.drive));
        (rig.resistance.value, rig.resistance.trust) = (0.3 * v / i.max(1e-12), None);
    }
}

/// An order within a fiftieth of a whole one is that: teeth, slots and poles come in whole numbers.
fn whole(mut t: Term) -> Term {
    if shapes::has_order(t.kind) && t.shape[0] >= 1.0 && (t.shape[0] - t.shape[0].round()).abs() < 0.02 {
        t.shape[0] = t.shape[0].round();
    }
    t
}

/// Kinds that an actuator may have more than once: several orders, several places.
fn takes_several(kind: EffectKind) -> bool {
    shapes::has_order(kind) || kind == EffectKind::TightSpot
}

/// Mains hum that stands out of the residual of an equation.
fn mains(p: &Problem, c: &RigConstants, nuisances: &[Nuisance]) -> Vec<(Equation, f64)> {
    let base = fit::solve(p, c, nuisances, &[], p.floor.map(|f| f.max(1e-300)));
    let mut found = Vec::new();
    let power = |block: &problem::Block, f: f64| -> f64 {
        let w = std::f64::consts::TAU * f / p.clock.rate_hz;
        let (mut s, mut co) = (0.0, 0.0);
        for (row, &k) in block.rows.clone().zip(&block.samples) {
            let (sin, cos) = (w * k as f64).sin_cos();
            s += base.residual[row] * sin;
            co += base.residual[row] * cos;
        }
        s * s + co * co
    };
    for e in [Equation::Torque, Equation::Electrical] {
        for f in problem::MAINS_HZ.into_iter().filter(|f| *f < 0.45 * p.row_rate_hz(e)) {
            let stands_out = p
                .blocks
                .iter()
                .filter(|b| b.equation == e && b.rows.len() > 100)
                .any(|b| {
                    let mut around: Vec<f64> = (2..14)
                        .flat_map(|j| [-0.4, 0.4].map(|d| power(b, f + d * j as f64)))
                        .collect();
                    around.sort_by(f64::total_cmp);
                    power(b, f) > 25.0 * around[around.len() / 2].max(1e-300)
                });
            if stands_out {
                found.push((e, f));
            }
        }
    }
    found
}
