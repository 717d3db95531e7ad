//! The filter: a Gaussian sum over damage and the logarithm of its rate.
//!
//! Each component belongs to one [`Model`] (law, wear, volatility, scatter) and is a 2 x 2 extended Kalman filter over
//! damage `x` [share of U] and `rho`; nodes of rho make it exact enough where the rate is still broad. In each update
//! branches (regular, jump, wrong diagnosis) are matched by their moments. Where damage is seen much more finely than it
//! scatters, gamma increments and jumps are taken as what they are, since a normal of their variance learns the rate
//! wrongly of them.

use super::law::Family;
use super::prior::{Laws, MODELS, Model, Prior, Wear};
use super::special::normal_cdf;
use super::update::read;
use std::sync::Arc;

/// Share of units whose wear has not begun; its logarithm of the rate beside the prior's, and the spread of that
/// (assumed).
const DORMANT: (f64, f64, f64) = (0.1, -6.0, 1.0);

/// Changes to a slower rate, as a share of those to a faster one (assumed).
const SLOWER: f64 = 0.2;

/// Components below this share of the best are dropped; so many are kept at most once the first tests have been read.
const LEAST: f64 = 1e-6;
const MOST_KEPT: usize = 150;
/// Components that are kept after the first test; over the tests that follow they go down to those.
const MOST_AT_FIRST: usize = 3000;

/// Nodes of rho at the beginning, at a change of regime, and where a combination that was dropped is tried again.
const NODES: usize = 31;
const NODES_REBORN: usize = 4;
const NODES_AGAIN: usize = 3;

/// Tests between two sweeps of merging and rebirth; sweeps in which every combination that was dropped is tried again
/// once; the share of a rebirth that they get, and the mass below which they count as dropped (assumed).
const SWEEP: u32 = 4;
const ROUND: usize = 8;
const AGAIN: f64 = 0.2;
const DROPPED: f64 = 1e-3;

/// How a regime begins anew.
struct Anew {
    /// mean of the logarithm of its rate over that of the prior
    faster: f64,
    /// spread of it [that of the prior]
    wider: f64,
    /// nodes of it
    nodes: usize,
    /// shift of the level: standard deviation [share of U]
    shift: f64,
    /// whether later changes, and those to a slower rate, are rarer
    rarer: bool,
}

/// Of itself.
const UNTOLD: Anew = Anew {
    faster: 0.0,
    wider: 1.0,
    nodes: NODES_REBORN,
    shift: 0.0,
    rarer: true,
};

/// Because something was done, and the mass of it (assumed).
const TOLD: (f64, Anew) = (
    0.6,
    Anew {
        faster: 0.0,
        wider: 2.5,
        nodes: 13,
        shift: 0.1,
        rarer: false,
    },
);

/// The same where a lubricant was lost, or something as bad: ten times as fast, or as much again (assumed).
const LOST: (f64, Anew) = (
    0.9,
    Anew {
        faster: 2.3,
        wider: 1.5,
        ..TOLD.1
    },
);

/// Mass that a combination needs to be born anew itself.
const REBORN: f64 = 0.01;

/// Dynamic model averaging: what a test leaves of the logarithm of a model's odds. Without it a law is certain after a
/// hundred tests that are exact to 0.1 %, and wrong (assumed).
const FORGETTING: f64 = 0.98;

/// Age [tests] from which a regime is old.
pub const OLD: u32 = 60;

/// One normal distribution of the sum.
#[derive(Clone, Copy, Debug)]
pub struct Component {
    /// combination it belongs to
    pub model: Model,
    /// its mass
    pub weight: f64,
    /// damage [share of U]
    pub x: f64,
    /// logarithm of the rate
    pub rho: f64,
    /// covariance: of damage
    pub pxx: f64,
    /// of damage with the rate
    pub pxr: f64,
    /// of the rate
    pub prr: f64,
    /// update at which its regime began; 0 from the start
    pub born: u32,
    /// jumps that it has seen
    pub jumps: f64,
    /// damage that they were together [share of U]
    pub jumped: f64,
}

impl Component {
    /// Variance of rho with what is not known of the size of jumps.
    pub fn rho_variance(&self) -> f64 {
        match self.model.wear() {
            Wear::Jumps(of) => self.prr + of.log_variance(self.jumps, self.jumped),
            _ => self.prr,
        }
    }
}

/// What one test says of damage [share of U].
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Reading {
    /// damage, its stated standard uncertainty, and the level that scatter in proportion goes by
    Damage {
        /// damage
        y: f64,
        /// stated standard uncertainty
        sd: f64,
        /// level
        level: f64,
    },
    /// damage is above a bound
    Above(f64),
}

/// The Gaussian sum of one unit and fault.
#[derive(Clone, Debug)]
pub struct Filter {
    prior: Arc<Prior>,
    laws: Laws,
    /// its components; weights add up to 1
    pub components: Vec<Component>,
    /// natural logarithm of the probability density of all readings so far
    pub evidence: f64,
    /// readings so far
    pub updates: u32,
    /// innovation of the last reading [standard deviations]
    pub innovation: f64,
    /// probability that the last reading was a wrong diagnosis
    pub wrong: f64,
    sweeps: usize,
    hazard: f64,
    forgetting: f64,
}

impl Filter {
    /// A unit whose damage is `x` with standard deviation `sd` [share of U], and of whose rate the prior alone is known.
    pub fn new(prior: Arc<Prior>, x: f64, sd: f64) -> Self {
        let mut components = Vec::new();
        for model in Model::all() {
            let mass = prior.mass(model);
            let (mean, spread) = prior.rho(model);
            let (share, below, sd_rho) = DORMANT;
            let awake = nodes(mean, spread, NODES).map(|(w, r, p)| (w * (1.0 - share), r, p));
            for (w, rho, prr) in awake.chain([(share, mean + below, sd_rho * sd_rho)]) {
                let weight = w * mass;
                components.push(Component {
                    model,
                    weight,
                    x,
                    rho,
                    pxx: sd * sd,
                    pxr: 0.0,
                    prr,
                    born: 0,
                    jumps: 0.0,
                    jumped: 0.0,
                });
            }
        }
        Self {
            prior,
            laws: Laws::new(),
            components,
            evidence: 0.0,
            updates: 0,
            innovation: 0.0,
            wrong: 0.0,
            sweeps: 0,
            hazard: 0.0,
            forgetting: FORGETTING,
        }
    }

    /// One combination alone, with nothing forgotten and no change of regime: what referees can follow.
    #[cfg(test)]
    pub fn of_one(prior: Arc<Prior>, model: Model, x: f64, sd: f64) -> Self {
        let mut f = Self::new(
            Arc::new(Prior {
                hazard: 0.0,
                ..prior.as_ref().clone()
            }),
            x,
            sd,
        );
        let mean = prior.rho(model).0;
        f.components
            .retain(|c| c.model == model && c.rho > mean + 0.9 * DORMANT.1);
        f.forgetting = 1.0;
        f.normalise();
        f
    }

    /// The prior that it began with.
    pub fn prior(&self) -> &Prior {
        &self.prior
    }

    /// The laws that it averages over.
    pub fn laws(&self) -> &Laws {
        &self.laws
    }

    /// Time `dt` goes by [units of the clock], and a test is read, if there is one.
    pub fn step(&mut self, dt: f64, reading: Option<Reading>) {
        let (mut sum, mut wrong, mut innovation, mut usual) = (0.0, 0.0, 0.0, 0.0);
        let interval = self.prior.interval;
        for c in &mut self.components {
            let s = (c.rho.min(20.0).exp() * dt).min(1.0);
            usual += c.weight * (c.rho.max(self.prior.rho_mean[c.model.law()]).min(20.0).exp() * dt).min(1.0);
            let (like, w, z) = read(c, self.laws.of(c.model), s, dt, interval, reading);
            if reading.is_some() {
                c.weight *= like;
                sum += c.weight;
                wrong += c.weight * w;
                innovation += c.weight * z;
            }
        }
        self.hazard += self.prior.hazard * usual;
        if reading.is_none() {
            return;
        }
        if !(sum > 0.0 && sum.is_finite()) {
            // nothing explains it: as if it had not been read
            for c in &mut self.components {
                c.weight = if c.weight.is_finite() {
                    c.weight.max(1e-12)
                } else {
                    1e-12
                };
            }
            sum = self.components.iter().map(|c| c.weight).sum();
            (wrong, innovation) = (sum, 0.0);
        }
        self.evidence += sum.ln();
        (self.wrong, self.innovation) = (wrong / sum, innovation / sum);
        self.updates += 1;
        self.normalise();
        self.forget();
        self.prune();
        if self.updates.is_multiple_of(SWEEP) {
            self.merge();
            let share = (1.0 - (-self.hazard).exp()).min(0.5);
            self.hazard = 0.0;
            if share > 0.0 {
                self.rebirth(share);
            }
        }
    }

    fn normalise(&mut self) {
        let sum: f64 = self.components.iter().map(|c| c.weight).sum();
        for c in &mut self.components {
            c.weight /= sum;
        }
    }

    /// What has been sinking sinks in towards the prior.
    fn forget(&mut self) {
        if self.forgetting >= 1.0 {
            return;
        }
        let mut factors = [0.0; MODELS];
        for c in &self.components {
            factors[c.model.index()] += c.weight;
        }
        for (f, prior) in factors.iter_mut().zip(&self.prior.joint) {
            if *f > 0.0 {
                // mass^phi prior^(1 - phi), over the mass
                *f = (prior.max(1e-9) / *f).powf(1.0 - self.forgetting);
            }
        }
        for c in &mut self.components {
            c.weight *= factors[c.model.index()];
        }
        self.normalise();
    }

    fn prune(&mut self) {
        let best = self.components.iter().fold(0.0, |m: f64, c| m.max(c.weight));
        self.components.retain(|c| c.weight >= LEAST * best);
        let most = (MOST_AT_FIRST / self.updates.max(1) as usize).max(MOST_KEPT);
        if self.components.len() > most {
            self.components
                .select_nth_unstable_by(most, |a, b| b.weight.total_cmp(&a.weight));
            self.components.truncate(most);
        }
        self.normalise();
    }

    /// Components of one combination and regime that say the same become one.
    fn merge(&mut self) {
        let now = self.updates;
        let key = |c: &Component| (c.model, if now.saturating_sub(c.born) > OLD { 0 } else { c.born });
        self.components.sort_unstable_by(|a, b| {
            let by = key(a).cmp(&key(b)).then(a.rho.total_cmp(&b.rho));
            by.then(a.x.total_cmp(&b.x)).then(a.weight.total_cmp(&b.weight))
        });
        let mut kept: Vec<Component> = Vec::with_capacity(self.components.len());
        for c in &self.components {
            match kept.last_mut() {
                Some(k)
                    if key(k) == key(c)
                        && (k.rho - c.rho).powi(2) < 0.6 * k.prr.min(c.prr)
                        && (k.x - c.x).powi(2) < 0.6 * k.pxx.min(c.pxx) + 1e-12 =>
                {
                    *k = matched(k, c);
                }
                _ => kept.push(*c),
            }
        }
        self.components = kept;
    }

    /// A share of the mass begins anew with a rate of the prior; law, wear and scatter as learned, or nearly so.
    pub fn rebirth(&mut self, share: f64) {
        self.begin_anew(share, &UNTOLD);
    }

    /// Something was done to the unit: a rate that the prior would hardly have, faster or slower, and a level that may have
    /// shifted.
    pub fn told(&mut self) {
        self.begin_anew(TOLD.0, &TOLD.1);
    }

    /// Something was lost that kept the unit from wearing.
    pub fn lost(&mut self) {
        self.begin_anew(LOST.0, &LOST.1);
    }

    fn begin_anew(&mut self, share: f64, how: &Anew) {
        #[derive(Clone, Copy, Default)]
        struct Sums {
            mass: f64,
            first: f64,
            x: f64,
            xx: f64,
            pxx: f64,
            rho: f64,
            jumps: f64,
            jumped: f64,
        }
        let mut sums = [Sums::default(); MODELS];
        for c in &self.components {
            let s = &mut sums[c.model.index()];
            s.mass += c.weight;
            s.first += if c.born == 0 { c.weight } else { 0.0 };
            s.x += c.weight * c.x;
            s.xx += c.weight * c.x * c.x;
            s.pxx += c.weight * c.pxx;
            s.rho += c.weight * c.rho;
            s.jumps += c.weight * c.jumps;
            s.jumped += c.weight * c.jumped;
        }
        let (later, born) = (self.prior.later, self.updates);
        let (x_all, sx_all) = self.damage();
        self.sweeps += 1;
        let mut young = Vec::new();
        for model in Model::all() {
            let s = sums[model.index()];
            let (mean, sd) = self.prior.rho(model);
            let (mean, sd) = (mean + how.faster, sd * how.wider);
            if s.mass >= REBORN {
                // later changes are rarer, and so are those to a slower rate
                let rare = if how.rarer {
                    (s.first + later * (s.mass - s.first)) / s.mass
                } else {
                    1.0
                };
                let share = share * rare;
                let (x, now) = (s.x / s.mass, s.rho / s.mass);
                let pxx = (s.xx / s.mass - x * x).max(0.0) + s.pxx / s.mass + how.shift * how.shift;
                let rarer = |rho: f64| if how.rarer && rho < now { SLOWER } else { 1.0 };
                let total: f64 = nodes(mean, sd, how.nodes).map(|(w, rho, _)| w * rarer(rho)).sum();
                for (w, rho, prr) in nodes(mean, sd, how.nodes) {
                    let weight = w * rarer(rho) / total.max(0.3) * s.mass * share;
                    young.push(Component {
                        model,
                        weight,
                        x,
                        rho,
                        pxx,
                        pxr: 0.0,
                        prr,
                        born,
                        jumps: s.jumps / s.mass,
                        jumped: s.jumped / s.mass,
                    });
                }
            } else if s.mass < DROPPED && model.index() % ROUND == self.sweeps % ROUND {
                let weight = share * AGAIN * ROUND as f64 * self.prior.mass(model);
                for (w, rho, prr) in nodes(mean, sd, NODES_AGAIN) {
                    let (weight, pxx) = (w * weight, sx_all * sx_all);
                    young.push(Component {
                        model,
                        weight,
                        x: x_all,
                        rho,
                        pxx,
                        pxr: 0.0,
                        prr,
                        born,
                        jumps: 0.0,
                        jumped: 0.0,
                    });
                }
            }
        }
        let later = if how.rarer { later } else { 1.0 };
        for c in &mut self.components {
            if sums[c.model.index()].mass >= REBORN {
                c.weight *= 1.0 - if c.born == 0 { share } else { share * later };
            }
        }
        self.components.extend(young);
        self.normalise();
    }

    /// A repair to damage `x` with standard deviation `sd`: law, wear and scatter are kept, the rate nearly.
    pub fn repaired(&mut self, x: f64, sd: f64) {
        const WIDER: f64 = 0.3;
        for c in &mut self.components {
            (c.x, c.pxx, c.pxr) = (x, sd * sd, 0.0);
            c.prr += WIDER * WIDER;
            c.born = 0;
        }
        self.merge();
    }

    /// Mean and standard deviation of damage [share of U].
    pub fn damage(&self) -> (f64, f64) {
        self.moments_of(|c| (c.x, c.pxx))
    }

    /// Mean and standard deviation of rho.
    pub fn rho(&self) -> (f64, f64) {
        self.moments_of(|c| (c.rho, c.rho_variance()))
    }

    /// Mean and standard deviation of something that a component has with a mean and a variance.
    pub fn moments_of(&self, f: impl Fn(&Component) -> (f64, f64)) -> (f64, f64) {
        let mean: f64 = self.components.iter().map(|c| c.weight * f(c).0).sum();
        let variance = |c: &Component| {
            let (a, p) = f(c);
            c.weight * ((a - mean).powi(2) + p)
        };
        (mean, self.components.iter().map(variance).sum::<f64>().max(0.0).sqrt())
    }

    /// Mean and standard deviation of the logarithm of the growth of damage [1 / unit of the clock].
    pub fn log_rate(&self) -> (f64, f64) {
        self.moments_of(|c| {
            let log = c.rho + self.laws.of(c.model).rate(c.x).max(1e-300).ln();
            (log, c.rho_variance())
        })
    }

    /// Probability that the logarithm of the growth of damage is above a bound [1 / unit of the clock].
    pub fn above_log_rate(&self, bound: f64) -> f64 {
        let above = |c: &Component| {
            let log = c.rho + self.laws.of(c.model).rate(c.x).max(1e-300).ln();
            c.weight * normal_cdf((log - bound) / c.rho_variance().sqrt())
        };
        self.components.iter().map(above).sum()
    }

    /// Mass by family of laws.
    pub fn families(&self) -> [f64; Family::ALL.len()] {
        let mut out = [0.0; Family::ALL.len()];
        for c in &self.components {
            out[self.laws.of(c.model).family() as usize] += c.weight;
        }
        out
    }

    /// Mass by group of wears.
    pub fn groups(&self) -> [f64; Model::GROUPS.len()] {
        let mut out = [0.0; Model::GROUPS.len()];
        for c in &self.components {
            out[c.model.group()] += c.weight;
        }
        out
    }

    /// Share of the stated variance that scatters from test to test; what is left is common to the unit's tests.
    pub fn scatter_share(&self) -> f64 {
        self.components
            .iter()
            .map(|c| c.weight * c.model.noise().of_stated.powi(2))
            .sum()
    }
}

/// A normal distribution as a sum of `n` narrower ones: weights, means, variances.
fn nodes(mean: f64, sd: f64, n: usize) -> impl Iterator<Item = (f64, f64, f64)> {
    // over +- 2.4 sd; as broad as makes them overlap, and the sum's variance right
    let h = 4.8 * sd / n as f64;
    let at = move |i: usize| mean + (i as f64 - 0.5 * (n as f64 - 1.0)) * h;
    let width = (0.8 * h).min(0.9 * sd);
    let rest = sd * sd - width * width;
    let density = move |i: usize| (-0.5 * (at(i) - mean).powi(2) / rest).exp();
    let total: f64 = (0..n).map(density).sum();
    (0..n).map(move |i| (density(i) / total, at(i), width * width))
}

/// Two components as one of the same mean and covariance.
pub(super) fn matched(k: &Component, c: &Component) -> Component {
    let w = k.weight + c.weight;
    let (f, g) = (k.weight / w, c.weight / w);
    let (dx, dr) = (c.x - k.x, c.rho - k.rho);
    Component {
        model: k.model,
        weight: w,
        x: k.x + g * dx,
        rho: k.rho + g * dr,
        pxx: f * k.pxx + g * c.pxx + f * g * dx * dx,
        pxr: f * k.pxr + g * c.pxr + f * g * dx * dr,
        prr: f * k.prr + g * c.prr + f * g * dr * dr,
        born: if c.weight > k.weight { c.born } else { k.born },
        jumps: f * k.jumps + g * c.jumps,
        jumped: f * k.jumped + g * c.jumped,
    }
}
