//! Which effects are missing: the candidates are ranked, taken one after another, and kept only
//! while data that were not used to find them get better.

use super::bench::{Bench, BenchChannel, Role};
use super::columns::{self, RigConstants};
use super::fit::{self, Fit, Regressor, Scan, Score, Term};
use super::problem::{self, Nuisance, Problem};
use super::recording::Run;
use super::signals::{self, Clock};
use rayon::prelude::*;
use sim_worker::effect::{Effect, EffectKind, Equation};

/// Standard deviations from which a belief about friction is given up (assumed).
const STRANGE: f64 = 2.5;

/// All that a study works on.
pub struct Material {
    pub(crate) bench: Bench,
    pub(crate) runs: Vec<Run>,
    pub(crate) clock: Clock,
    pub(crate) equations: Vec<Equation>,
    pub(crate) nuisances: Vec<Nuisance>,
    pub(crate) constants: RigConstants,
    pub(crate) fit: Problem,
    pub(crate) held: Option<Problem>,
    /// effects that the model has already
    known: Vec<Effect>,
}

/// A candidate after its shape was refined.
#[derive(Clone, Debug)]
pub struct Ranked {
    /// with its best shape and amplitudes
    pub term: Term,
    pub(crate) score: Score,
    /// gain in log-likelihood over the model without it
    pub(crate) gain: f64,
}

impl Material {
    /// * `known` effects that the model has already
    pub fn new(bench: Bench, runs: Vec<Run>, known: &[Effect]) -> Self {
        let noise = signals::noise_table(&bench, &runs);
        let equations = problem::equations(&bench, &runs);
        let nuisances = problem::nuisances(&bench, &noise, &equations);
        Self::set_up(bench, runs, nuisances, known.to_vec(), (0.0, 0.0))
    }

    fn set_up(bench: Bench, runs: Vec<Run>, nuisances: Vec<Nuisance>, known: Vec<Effect>, encoder: (f64, f64)) -> Self {
        let noise = signals::noise_table(&bench, &runs);
        let of = |role: &[Role]| -> Vec<&Run> { runs.iter().filter(|r| role.contains(&r.role)).collect() };
        let used = of(&[Role::Fit, Role::HeldOut]);
        let used: Vec<Run> = used.into_iter().cloned().collect();
        let clock = Clock::new(&bench, &used, &noise);
        let equations = problem::equations(&bench, &used);
        let mut constants = problem::constants(&bench, &clock);
        constants.encoder = encoder;
        let build = |runs: &[&Run]| Problem::new(&bench, runs, &clock, &noise, &equations, &nuisances);
        let mut fit = build(&of(&[Role::Fit]));
        let held = of(&[Role::HeldOut]);
        let mut held = (!held.is_empty()).then(|| build(&held));
        drop(used);
        for p in [Some(&mut fit), held.as_mut()].into_iter().flatten() {
            let hottest = fit::hottest(p);
            for e in &known {
                let (shape, amplitudes) = columns::parts(e, constants.effect.coulomb, hottest);
                let r = Regressor::new(p, e.kind, &shape, &constants);
                let linear = amplitudes.iter().zip(&r.linear);
                for (a, column) in r.fixed.iter().map(|f| (1.0, f)).chain(linear.map(|(a, c)| (*a, c))) {
                    p.y.iter_mut().zip(column).for_each(|(y, c)| *y -= a * c);
                }
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
        Self {
            bench,
            runs,
            clock,
            equations,
            nuisances,
            constants,
            fit,
            held,
            known,
        }
    }

    /// The same runs with the equations set up around the constants of a fit, so that what is left
    /// of the deviations is small; the priors stay where they were.
    pub(crate) fn around(&self, fit: &Fit) -> Self {
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
            let factor = (1.0 + x).max(0.05);
            if *value <= 0.0 && n.name != "offset" {
                continue;
            }
            *value *= factor;
            moved.push((n.name, factor));
            if n.name == "torque_constant" {
                rig.back_emf.value *= factor;
            }
        }
        let mut nuisances = self.nuisances.clone();
        for n in &mut nuisances {
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
        let encoder = sensor.map_or(self.constants.encoder, |t| (t.amplitudes[0], t.amplitudes[1]));
        Self::set_up(bench, self.runs.clone(), nuisances, self.known.clone(), encoder)
    }

    /// Standard deviations to begin with: what is left when only constants are re-tuned.
    pub(crate) fn first_sigma(&self) -> [f64; 5] {
        self.fit.floor.map(|f| f.max(1e-300))
    }

    pub(crate) fn solve(&self, terms: &[Term], sigma: [f64; 5]) -> Fit {
        fit::solve(&self.fit, &self.constants, &self.nuisances, terms, sigma)
    }

    /// All candidates on top of a model, best first.
    pub(crate) fn scan(&self, model: &Fit, kinds: &[EffectKind]) -> Vec<Ranked> {
        let regs = fit::regressors(&self.fit, &model.terms, &self.constants);
        let (y, further) = fit::assembled(&self.fit, &regs);
        let scan = Scan::new(&self.fit, &self.constants, &self.nuisances, &y, &further, model.sigma);
        let silent = super::tell::not_excited(self);
        let mut all: Vec<Ranked> = kinds
            .par_iter()
            .filter(|k| !silent.iter().any(|s| s.0 == k.name()))
            .filter(|k| takes_several(**k) || !model.terms.iter().any(|t| t.kind == **k))
            .filter_map(|&k| {
                let (term, score) = scan.best(k)?;
                let gain = score.log_likelihood - scan.none.log_likelihood;
                Some(Ranked { term, score, gain })
            })
            .collect();
        all.sort_by(|a, b| b.gain.total_cmp(&a.gain));
        all
    }

    /// Refines the shapes of all terms in turn, then solves.
    pub(crate) fn polish(&self, model: &Fit, rounds: usize) -> Fit {
        let mut terms = model.terms.clone();
        let mut sigma = model.sigma;
        for _ in 0..rounds {
            for i in 0..terms.len() {
                let others: Vec<Term> = terms
                    .iter()
                    .enumerate()
                    .filter(|(j, _)| *j != i)
                    .map(|(_, t)| t.clone())
                    .collect();
                let regs: Vec<Regressor> = fit::regressors(&self.fit, &others, &self.constants);
                let (y, further) = fit::assembled(&self.fit, &regs);
                let scan = Scan::new(&self.fit, &self.constants, &self.nuisances, &y, &further, sigma);
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

    /// Share of the rows' greatest possible gap: rms by equation over the floor.
    pub(crate) fn over_floor(&self, p: &Problem, energy: &[f64; 5]) -> [f64; 5] {
        std::array::from_fn(|e| {
            let n = p.rows_of(Equation::ALL[e]) as f64;
            if n > 0.0 {
                (energy[e] / n).sqrt() / p.floor[e]
            } else {
                f64::NAN
            }
        })
    }

    pub(crate) fn has(&self, c: BenchChannel) -> bool {
        self.runs.iter().all(|r| r.channel(c).is_some())
    }
}

/// An order within a fiftieth of a whole one is that: teeth, slots and poles come in whole numbers.
fn whole(mut t: Term) -> Term {
    let periodic = matches!(
        t.kind,
        EffectKind::Cogging | EffectKind::PeriodicFriction | EffectKind::TorqueRipple
    );
    if periodic && t.shape[0] >= 1.0 && (t.shape[0] - t.shape[0].round()).abs() < 0.02 {
        t.shape[0] = t.shape[0].round();
    }
    t
}

/// Kinds that an actuator may have more than once: several orders, several places.
fn takes_several(kind: EffectKind) -> bool {
    matches!(
        kind,
        EffectKind::Cogging | EffectKind::PeriodicFriction | EffectKind::TorqueRipple | EffectKind::TightSpot
    )
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
        for f in problem::MAINS_HZ.into_iter().filter(|f| *f < 2.0 * p.clock.corner_hz) {
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
