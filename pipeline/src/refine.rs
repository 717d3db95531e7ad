//! The slow reference estimator: fits faults and the unit's unknown causes to one recording by running the
//! numerical test bench, not the maps. It is the yardstick that the maps' quick diagnosis is held against.
//!
//! Relay decisions make the features rough functions of the parameters, so that differences over small steps
//! say nothing. Local regressions take the place of derivatives (response surfaces in a trust region; Box and
//! Wilson 1951; Conn, Scheinberg and Vicente 2009): random units in a box around the estimate, each with
//! sensor noise of its own, are simulated; every feature is fitted by a quadratic of the faults and a plane
//! of the causes. What the fit leaves is sensor noise, chatter of the relays and lack of fit together: just
//! what one measured test differs from the fit by. Its covariance therefore weighs the measured features, and
//! no separate runs are spent on the noise; the bias that noise gives to a feature (P2 is a mean of absolute
//! values) is in the fit too. The posterior of faults and causes, uniform within the spread and straight, is drawn from by a
//! random walk, where zeta cannot pass 0. The box moves to its mean and shrinks to a few of its standard
//! deviations, and so do the causes, which shrink together, along what the recording leaves open of them: over the whole
//! spread the break-away of a relay's current does not follow a plane. Runs that lie in later boxes are used again, so that
//! the fit becomes better with each step.

mod response;
#[cfg(test)]
mod tests;
mod walk;

use crate::calibrate::simulate_features;
use crate::case::{Case, Settings};
use anyhow::Result;
use diagnoser::diagnosis::{Area, Known, parse_known};
use diagnoser::map_library::checked_coverage;
use rand::seq::SliceRandom;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;
use response::{Point, RANGE, Region, Surrogate};
use schemas::error::Error;
use schemas::fault::{FaultState, Interval};
use schemas::feature::{Feature, Features, Raw, RawFeatures};
use schemas::sequence::Command;
use sim_worker::setup::TestSetup;
use sim_worker::spread::{Cause, Spread};
use sim_worker::test_bench::Lane;
use std::sync::Arc;
use walk::{Cloud, Walk};

/// Features that are fitted: what others make up is left out. Of those that maps do not locate by, kinetic friction and the current
/// of the run-up say what a unit's flux and inertia are.
fn fitted() -> impl Iterator<Item = Feature> {
    let others = [Feature::Kinetic, Feature::RunUpCurrent];
    Feature::located_by().chain(others).filter(|f| f.parts().is_none())
}

/// Smallest first radii, FSJ as a share of itself: an area that is wrong must not hold the search.
const FIRST: (f64, f64) = (0.05, 0.02);

/// Runs of one step; twice as many once the box has its last size.
const RUNS: usize = 128;

const MOST_STEPS: usize = 8;

/// Share by which radii may still differ from what they should be, once the box has its last size.
const SAME: (f64, f64) = (0.35, 1.6);

/// Step, in standard deviations, below which the search has converged.
const SMALL: f64 = 0.1;

/// Fewest steps of P3 (one sample each) on either side that the box must span, so that its staircase has a
/// slope.
const STAIRS: f64 = 2.0;

/// One recording and what is known about it.
#[derive(Clone, Copy, Debug)]
pub struct Test<'a> {
    /// the test bench, its test and its sensors
    pub setup: &'a TestSetup,
    /// nominal run of the maps, which `features` are over
    pub nominal: &'a RawFeatures,
    /// measured
    pub features: &'a Features,
    /// how units differ: a cause's uniform distribution counts as a Gaussian of the same variance h^2/3
    pub spread: &'a Spread,
    /// causes that are held at a deviation instead of being fitted
    pub known: &'a Known,
}

/// Where a search begins.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Start {
    /// middle of the first box
    pub fsj: f64,
    /// middle of the first box
    pub zeta: f64,
    /// half-widths of the first box (FSJ, zeta)
    pub radius: (f64, f64),
}

impl Start {
    /// The middle of the paper's range, and all of it.
    pub const ANYWHERE: Self = Self {
        fsj: 0.5 * (RANGE[0].0 + RANGE[0].1),
        zeta: 0.5 * (RANGE[1].0 + RANGE[1].1),
        radius: (0.5 * (RANGE[0].1 - RANGE[0].0), 0.5 * (RANGE[1].1 - RANGE[1].0)),
    };

    /// Centroid and half of the hull of what the maps allow.
    pub fn of(area: &Area) -> Self {
        let (fsj, zeta) = area.centroid;
        Self {
            fsj,
            zeta,
            radius: (
                (0.5 * area.fsj.width()).max(FIRST.0 * fsj),
                (0.5 * area.zeta.width()).max(FIRST.1),
            ),
        }
    }
}

/// A cause that was fitted.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FittedCause {
    /// which one
    pub cause: Cause,
    /// mean and standard deviation of the posterior, as shares of the spread's half-width; 0 and 0.577 where
    /// the recording says nothing about it
    pub share: f64,
    /// standard deviation, as `share`
    pub sigma: f64,
}

/// One step of a search.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Step {
    /// half-widths of the box that was simulated (FSJ, zeta)
    pub radius: (f64, f64),
    /// runs that the fit stands on, those of earlier steps included
    pub runs: usize,
    /// posterior mean and standard deviations (FSJ, zeta)
    pub estimate: (f64, f64),
    /// standard deviations (FSJ, zeta)
    pub sigma: (f64, f64),
    /// smallest squared residual in standard uncertainties
    pub misfit: f64,
}

/// Faults of one recording, fitted by simulation.
#[derive(Clone, Debug, PartialEq)]
pub struct Refined {
    /// the shortest interval; both together hold the true pair with the coverage asked for, or more
    pub fsj: Interval,
    /// the same along zeta
    pub zeta: Interval,
    /// posterior mean (FSJ, zeta)
    pub estimate: (f64, f64),
    /// posterior standard deviations (FSJ, zeta) and correlation
    pub sigma: (f64, f64),
    /// of FSJ and zeta, -1 to 1
    pub correlation: f64,
    /// features that were fitted
    pub features: Vec<Feature>,
    /// smallest squared residual in standard uncertainties, the causes' priors included: chi-square with
    /// (features - 2) degrees of freedom where the model holds
    pub misfit: f64,
    /// those of the spread that are not known
    pub causes: Vec<FittedCause>,
    /// of the test bench, in all steps
    pub runs: usize,
    /// whether the last step was a small share of the standard deviations
    pub converged: bool,
    /// step by step
    pub trace: Vec<Step>,
}

impl Refined {
    /// Misfit below which 999 of 1000 tests lie that the model holds for: of a chi-square (Wilson and Hilferty 1931).
    pub fn greatest_misfit(&self) -> f64 {
        let k = self.features.len().saturating_sub(2).max(1) as f64;
        k * (1.0 - 2.0 / (9.0 * k) + 3.09 * (2.0 / (9.0 * k)).sqrt()).powi(3)
    }

    /// Whether a unit of the spread may have made the recording.
    pub fn fits(&self) -> bool {
        self.misfit <= self.greatest_misfit()
    }

    /// Posterior covariance of (FSJ, zeta), row by row.
    pub fn covariance(&self) -> [[f64; 2]; 2] {
        let (f, z) = self.sigma;
        let fz = self.correlation * f * z;
        [[f * f, fz], [fz, z * z]]
    }
}

/// Fits a diagnosed recording by running the test bench, from the area that the maps allow.
///
/// # Errors
/// As [`refine`]; interrupted ([`crate::Interrupted`]).
pub fn of_case(case: &Case, settings: &Settings) -> Result<Refined> {
    let header = &case.diagnoser.maps.header;
    let known = parse_known(&settings.known, &case.setup.actuator, header.kind.rest_angle_rad)?;
    let test = Test {
        setup: &case.setup,
        nominal: &case.diagnoser.maps.nominal,
        features: &case.diagnosis.features,
        spread: &settings.choice.spread,
        known: &known,
    };
    let start = case.diagnosis.outcome.area().map(Start::of);
    let refined = refine(&test, start, settings.choice.coverage, 0)?;
    refined.ok_or(crate::Interrupted.into())
}

/// Keys of the interface.
pub fn to_json(r: &Refined) -> serde_json::Value {
    let interval =
        |i: Interval, e: f64, sigma: f64| serde_json::json!({"lo": i.lo, "hi": i.hi, "estimate": e, "sigma": sigma});
    let cause =
        |c: &FittedCause| serde_json::json!({"cause": c.cause.key(), "share_of_half_width": c.share, "sigma": c.sigma});
    serde_json::json!({
        "fsj": interval(r.fsj, r.estimate.0, r.sigma.0),
        "zeta": interval(r.zeta, r.estimate.1, r.sigma.1),
        "correlation": r.correlation,
        "misfit": r.misfit,
        "fits": r.fits(),
        "runs": r.runs,
        "converged": r.converged,
        "causes": r.causes.iter().map(cause).collect::<Vec<_>>(),
    })
}

/// Fits one recording. `Ok(None)` where it was interrupted.
///
/// * `start` of the search; none: anywhere in the paper's range
/// * `coverage` of the box of both faults. Each interval is the shortest that holds its fault with probability
///   sqrt(coverage): the box of two independent faults then has the coverage, and that of two correlated Gaussian ones has no
///   less (Sidak 1967)
/// * `seed` of the simulated units and their noise: the same one gives the same result
///
/// # Errors
/// Refuses a coverage outside 0 to 1, fewer than two features, and a test whose simulations give no fit.
pub fn refine(test: &Test<'_>, start: Option<Start>, coverage: f64, seed: u64) -> Result<Option<Refined>> {
    checked_coverage(coverage)?;
    let problem = Problem::new(test)?;
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let start = start.unwrap_or(Start::ANYWHERE);
    let mut region = Region::new([start.fsj, start.zeta], [start.radius.0, start.radius.1]);
    let mut cloud: Option<Cloud> = None;
    let mut points: Vec<Point> = Vec::new();
    let mut trace: Vec<Step> = Vec::new();
    let (mut runs, mut settled, mut stairs) = (0, false, 0.0);
    loop {
        let n = if settled { 2 * RUNS } else { RUNS };
        let Some(new) = problem.simulate(&region, cloud.as_ref(), (trace.len() + 1, n), &mut rng)? else {
            return Ok(None);
        };
        runs += n;
        points.extend(new);
        let near: Vec<&Point> = points
            .iter()
            .filter(|p| region.holds(p.fault) && cloud.as_ref().is_none_or(|c| c.holds(&p.causes)))
            .collect();
        let surrogate = problem.fit(&region, &near)?;
        let gaussian = surrogate.posterior(&region, &problem.measured);
        let walk = Walk::through(&surrogate, &region, &problem.measured, &gaussian, &mut rng);
        let posterior = &walk.posterior;
        let moved = trace.last().map_or(f64::INFINITY, |last: &Step| {
            let by = |a: f64, b: f64, sigma: f64| ((a - b) / sigma).abs();
            let f = by(posterior.mean[0], last.estimate.0, posterior.sigma[0]);
            f.max(by(posterior.mean[1], last.estimate.1, posterior.sigma[1]))
        });
        trace.push(Step {
            radius: (region.radius[0], region.radius[1]),
            runs: near.len(),
            estimate: (posterior.mean[0], posterior.mean[1]),
            sigma: (posterior.sigma[0], posterior.sigma[1]),
            misfit: posterior.misfit,
        });
        // a box of a few stairs says little of how long they are: what a wider one said holds
        if let Some(now) = problem
            .stairs(&surrogate, &region)
            .filter(|now| stairs == 0.0 || 2.0 * now < region.radius[0])
        {
            stairs = now;
        }
        cloud = Cloud::of(posterior);
        let mut next = region.next(posterior, [stairs, 0.0]);
        let converged = settled && moved <= SMALL;
        if converged || trace.len() == MOST_STEPS {
            return Ok(Some(problem.refined(&walk, coverage, runs, converged, trace)));
        }
        let ratios = [0, 1].map(|a| next.radius[a] / region.radius[a]);
        settled = !region.at_edge(posterior) && ratios.iter().all(|r| (SAME.0..=SAME.1).contains(r));
        if settled {
            // a box of one size has more runs to use again
            next.radius = region.radius;
        }
        region = next;
    }
}

/// A recording made ready to be fitted.
struct Problem<'a> {
    test: &'a Test<'a>,
    features: Vec<Feature>,
    measured: Vec<f64>,
    /// causes to be fitted
    free: Vec<Cause>,
    /// half-widths of the free causes; 1 for those that are known, whose draw is their deviation
    units: Spread,
    known: [f64; Cause::COUNT],
    /// change of P3 from one sample to the next
    stair: f64,
}

impl<'a> Problem<'a> {
    fn new(test: &'a Test<'a>) -> Result<Self> {
        let nominal_p3 = test.nominal[Raw::P3];
        let value = |f: Feature| test.features.get(f).filter(|x| x.is_finite());
        let here: Vec<(Feature, f64)> = fitted().filter_map(|f| Some((f, value(f)?))).collect();
        if here.len() < 2 {
            let names: Vec<&str> = here.iter().map(|(f, _)| f.name()).collect();
            let found = if names.is_empty() {
                "none".into()
            } else {
                names.join(", ")
            };
            let all: Vec<&str> = fitted().map(Feature::name).collect();
            let allowed = format!("at least two of {}", all.join(", "));
            return Err(Error::bad("recording", "features", found, allowed).into());
        }
        let mut units = test.spread.clone();
        let mut known = [0.0; Cause::COUNT];
        for &(cause, deviation) in test.known {
            units.half_width[cause as usize] = 1.0;
            known[cause as usize] = deviation;
        }
        let is_known = |c: Cause| test.known.iter().any(|(k, _)| *k == c);
        let free = test.spread.causes().map(|(c, _)| c).filter(|&c| !is_known(c)).collect();
        let slope = test.setup.sequence.segments.iter().find_map(|s| match s.command {
            Command::Ramp { slope_rad_per_s } => Some(slope_rad_per_s.abs()),
            _ => None,
        });
        let stair = match (slope, nominal_p3) {
            (Some(slope), Some(p3)) => slope / test.setup.rate_hz / p3.abs(),
            _ => 0.0,
        };
        Ok(Self {
            test,
            features: here.iter().map(|h| h.0).collect(),
            measured: here.iter().map(|h| h.1).collect(),
            free,
            units,
            known,
            stair,
        })
    }

    fn place_of_p3(&self) -> Option<usize> {
        self.features.iter().position(|&f| f == Feature::P3)
    }

    /// Random tests in a region, one in each layer along every axis (Latin hypercube; McKay et al. 1979). Before the recording has
    /// said anything of the causes, they fill the whole spread likewise. Tests that lack a feature are left out.
    fn simulate(
        &self,
        region: &Region,
        cloud: Option<&Cloud>,
        (step, n): (usize, usize),
        rng: &mut ChaCha8Rng,
    ) -> Result<Option<Vec<Point>>> {
        let mut layers = |(lo, hi): (f64, f64)| {
            let at = |k: usize, rng: &mut ChaCha8Rng| (k as f64 + rng.random_range(0.0..1.0)) / n as f64;
            let mut x: Vec<f64> = (0..n).map(|k| lo + (hi - lo) * at(k, rng)).collect();
            x.shuffle(rng);
            x
        };
        let faults = [layers(region.ends(0)), layers(region.ends(1))];
        let units: Vec<Vec<f64>> = match cloud {
            Some(cloud) => (0..n).map(|_| cloud.draw(|| rng.sample(StandardNormal))).collect(),
            None => {
                let axes: Vec<Vec<f64>> = self.free.iter().map(|_| layers((-1.0, 1.0))).collect();
                (0..n).map(|i| axes.iter().map(|x| x[i]).collect()).collect()
            }
        };
        let setup = self.test.setup;
        let mut points = Vec::with_capacity(n);
        let mut lanes = Vec::with_capacity(n);
        for (i, causes) in units.into_iter().enumerate() {
            let fault = [faults[0][i], faults[1][i]];
            let mut draw = self.known;
            self.free.iter().zip(&causes).for_each(|(c, x)| draw[*c as usize] = *x);
            let (actuator, rest_angle_rad) = self.units.unit(&setup.actuator, setup.rest_angle_rad, &draw);
            let lane = Lane {
                actuator: Arc::new(actuator),
                fault: FaultState {
                    fsj: fault[0],
                    zeta: fault[1],
                },
                rest_angle_rad,
                load_n_m: setup.load_n_m,
            };
            // noise of its own for every run: seeds that are shared would leave one and the same error in all
            lanes.push((lane, rng.random()));
            points.push((fault, causes));
        }
        let Some(raw) = simulate_features(setup, lanes, &format!("refining, step {step}"))? else {
            return Ok(None);
        };
        let whole = |((fault, causes), raw): (_, &RawFeatures)| {
            let features = Features::over(raw, self.test.nominal);
            let features = self.features.iter().map(|&f| features.get(f).filter(|x| x.is_finite()));
            Some(Point {
                fault,
                causes,
                features: features.collect::<Option<Vec<f64>>>()?,
            })
        };
        Ok(Some(points.into_iter().zip(&raw).filter_map(whole).collect()))
    }

    /// Response surface over the points of a region.
    fn fit(&self, region: &Region, points: &[&Point]) -> Result<Surrogate> {
        let variance = |(f, x): (&Feature, &f64)| {
            // a box on one stair would call P3 exact: it never is by more than the stair is wide
            let stair = if *f == Feature::P3 { self.stair } else { 0.0 };
            stair * stair / 12.0 + (1e-7 * x).powi(2) + 1e-24
        };
        let least: Vec<f64> = self.features.iter().zip(&self.measured).map(variance).collect();
        let fit = Surrogate::fit(region, points, &least).ok_or_else(|| {
            let names: Vec<&str> = self.features.iter().map(|f| f.name()).collect();
            let found = format!("only {} simulated tests with {}", points.len(), names.join(", "));
            Error::bad(
                "recording",
                "features",
                found,
                "features that the actuator has near the estimate",
            )
        })?;
        Ok(fit)
    }

    /// Half-width along FSJ that a box needs so that P3 has a slope, if it is fitted.
    fn stairs(&self, s: &Surrogate, region: &Region) -> Option<f64> {
        let slope = s.slope(self.place_of_p3()?).abs() / region.radius[0];
        let longest = FIRST.0 * region.centre[0];
        Some(if slope > 0.0 {
            (STAIRS * self.stair / slope).min(longest)
        } else {
            longest
        })
    }

    fn refined(&self, walk: &Walk, coverage: f64, runs: usize, converged: bool, trace: Vec<Step>) -> Refined {
        let p = &walk.posterior;
        let interval = |a: usize| walk.shortest(a, coverage.sqrt());
        let fitted = |(i, &cause): (usize, &Cause)| FittedCause {
            cause,
            share: p.causes[i],
            sigma: p.covariance[(i, i)].sqrt(),
        };
        Refined {
            fsj: interval(0),
            zeta: interval(1),
            estimate: (p.mean[0], p.mean[1]),
            sigma: (p.sigma[0], p.sigma[1]),
            correlation: p.correlation,
            features: self.features.clone(),
            misfit: p.misfit,
            causes: self.free.iter().enumerate().map(fitted).collect(),
            runs,
            converged,
            trace,
        }
    }
}
