//! Units that fit a recording, drawn: their faults' intervals, and where the next units are simulated.

use super::response::{PHYSICAL, Posterior, Region, Sums, Surrogate};
use nalgebra::{DMatrix, DVector};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;
use schemas::fault::Interval;

/// Radius of the causes' cloud in standard deviations of the posterior: about as wide as the
/// box of faults beside it.
const CLOUD: f64 = 2.0;

/// Draws of a walk, after a tenth as many that are not counted.
const DRAWS: usize = 60_000;

/// Length of a walk's steps in standard deviations, over the root of the number of unknowns.
const STEP: f64 = 2.4;

/// Lengths of intervals that 60 000 draws do not tell apart, as a ratio.
const ALIKE: f64 = 1.02;

/// Units that fit a recording, drawn by a random walk.
pub struct Walk {
    /// moments of faults and causes
    pub posterior: Posterior,
    /// FSJ and zeta by draw
    faults: [Vec<f64>; 2],
    /// within which they were drawn
    ends: [(f64, f64); 2],
}

impl Walk {
    /// The shortest interval of a fault that holds a share of the draws; from a physical limit on where that is hardly longer.
    pub fn shortest(&self, fault: usize, share: f64) -> Interval {
        let mut x = self.faults[fault].clone();
        x.sort_by(f64::total_cmp);
        let inside = ((share * x.len() as f64).ceil() as usize).clamp(1, x.len());
        let width = |i: usize| x[i + inside - 1] - x[i];
        let first = (0..=x.len() - inside)
            .min_by(|&a, &b| width(a).total_cmp(&width(b)))
            .expect("at least one");
        // draws do not tell which of many intervals, all about as short, begins where the density does
        let end = self.ends[fault].0;
        let limited = end <= PHYSICAL[fault].0 && width(0) <= ALIKE * width(first);
        let (lo, hi) = if limited {
            (end, x[inside - 1])
        } else {
            (x[first], x[first + inside - 1])
        };
        Interval { lo, hi }
    }

    /// Draws from the posterior with the causes' own prior, uniform within the spread (random walk of Metropolis et al. 1953; steps
    /// after Roberts, Gelman and Gilks 1997). The recording says little of most causes, so that their ends count.
    ///
    /// * `gaussian` where the walk begins
    pub fn through(
        fit: &Surrogate,
        region: &Region,
        measured: &[f64],
        gaussian: &Posterior,
        rng: &mut ChaCha8Rng,
    ) -> Self {
        let m = gaussian.causes.len();
        let d = 2 + m;
        let white = fit.by_scatter(measured);
        let ends = [region.beyond(0), region.beyond(1)];
        let allowed = |x: &DVector<f64>| {
            let fault = (0..2).all(|a| (ends[a].0..=ends[a].1).contains(&x[a]));
            fault && x.iter().skip(2).all(|c| c.abs() <= 1.0)
        };
        let left = |x: &DVector<f64>| white.residual(region, [x[0], x[1]]) - &white.causes * x.rows(2, m);
        let square = |x: &DVector<f64>| left(x).norm_squared();
        let mut x = DVector::from_fn(d, |i, _| match i {
            0 | 1 => gaussian.mean[i],
            _ => gaussian.causes[i - 2].clamp(-1.0, 1.0),
        });
        // steps along what the features leave open, straight about the middle
        let here = left(&x);
        let slope = |j: usize| {
            let mut further = x.clone();
            let by = if j < 2 { 0.1 * (ends[j].1 - ends[j].0) } else { 0.1 };
            further[j] += by;
            (left(&further) - &here) / by
        };
        let slopes = DMatrix::from_columns(&(0..d).map(slope).collect::<Vec<_>>());
        let prior = DVector::from_fn(d, |i, _| match i {
            0 | 1 => 12.0 / (ends[i].1 - ends[i].0).powi(2),
            _ => 3.0,
        });
        let open = (slopes.tr_mul(&slopes) + DMatrix::from_diagonal(&prior)).try_inverse();
        let root = open.and_then(|c| c.cholesky()).map_or_else(
            || DMatrix::from_diagonal(&prior.map(|p| p.sqrt().recip())),
            |c| c.unpack(),
        ) * (STEP / (d as f64).sqrt());
        let mut now = square(&x);
        let mut sums = Sums::new(m);
        let mut draws = [Vec::with_capacity(DRAWS), Vec::with_capacity(DRAWS)];
        for i in 0..DRAWS + DRAWS / 10 {
            let z = DVector::from_fn(d, |_, _| rng.sample::<f64, _>(StandardNormal));
            let next = &x + &root * z;
            if allowed(&next) {
                let then = square(&next);
                if rng.random_range(0.0..1.0f64).ln() < 0.5 * (now - then) {
                    (x, now) = (next, then);
                }
            }
            // the first tenth finds its way
            if i >= DRAWS / 10 {
                sums.add(1.0, [x[0], x[1]], &x.rows(2, m).into_owned());
                (0..2).for_each(|a| draws[a].push(x[a]));
            }
        }
        Self {
            posterior: sums.posterior(gaussian.misfit),
            faults: draws,
            ends,
        }
    }
}

/// Where the free causes of the next units are drawn: about what the recording says of them together. Far from there a plane does
/// not tell what they change here (the break-away of a relay's current does not follow one over the whole spread).
pub struct Cloud {
    mean: DVector<f64>,
    /// lower triangle, the covariance's root
    root: DMatrix<f64>,
}

impl Cloud {
    /// Around a posterior; `None` where its covariance has no root.
    pub fn of(p: &Posterior) -> Option<Self> {
        let covariance = &p.covariance * (CLOUD * CLOUD) + DMatrix::identity(p.causes.len(), p.causes.len()) * 1e-9;
        Some(Self {
            mean: p.causes.map(|x| x.clamp(-1.0, 1.0)),
            root: covariance.cholesky()?.unpack(),
        })
    }

    /// A unit within the spread, by standard Gaussian numbers.
    pub fn draw(&self, mut gaussian: impl FnMut() -> f64) -> Vec<f64> {
        let mut x = self.mean.clone();
        for _ in 0..100 {
            let z = DVector::from_fn(self.mean.len(), |_, _| gaussian());
            x = &self.mean + &self.root * z;
            if x.iter().all(|x| x.abs() <= 1.0) {
                break;
            }
        }
        x.iter().map(|x| x.clamp(-1.0, 1.0)).collect()
    }

    /// Whether units like this are drawn from it.
    pub fn holds(&self, causes: &[f64]) -> bool {
        let d = DVector::from_column_slice(causes) - &self.mean;
        let m = causes.len() as f64;
        let square = self
            .root
            .solve_lower_triangular(&d)
            .map_or(f64::INFINITY, |z| z.norm_squared());
        // all but about one in a hundred of a chi-square's
        square <= m + 3.0 * (2.0 * m).sqrt()
    }
}
