//! Local response surfaces of the features over a box of fault pairs, and what measured features then say
//! about the faults: the numbers behind [`crate::refine`], without any simulation.

use nalgebra::{DMatrix, DVector};

/// Fault ranges of the paper (FSJ, zeta; 2.1, 2.2, 4): no box is wider.
pub const RANGE: [(f64, f64); 2] = [(1.0, 5.0), (0.0, 0.5)];

/// What physics allows, a little inside of it: FSJ > 0, 0 <= zeta < 1.
pub const PHYSICAL: [(f64, f64); 2] = [(0.05, 100.0), (0.0, 0.95)];

/// Radius of the box in standard deviations of the posterior: so wide that the slopes stand out of the
/// scatter, so narrow that a quadratic fits.
const REACH: f64 = 3.0;

/// Factor on the variance of a test about the fit, for what a Gaussian leaves out: break-away comes in jumps (assumed; 28 units of
/// seeds that no record reports had errors of 0.9, FSJ, and 1.3, zeta, of what they should be without).
const MARGIN: f64 = 1.2;

/// Quickest shrinking from one step to the next: a fit over a wide box is not trusted farther than that.
const SHRINK: f64 = 0.15;

/// Share of the radius from which on the mean counts as being at the box's edge, and by how much the box
/// then grows.
const EDGE: (f64, f64) = (0.8, 2.0);

/// How far beyond the box, in radii, the fit is used.
const BEYOND: f64 = 1.25;

/// Cells of the posterior's grid along each axis.
const CELLS: usize = 81;

/// A simulated test.
pub struct Point {
    /// FSJ, zeta
    pub fault: [f64; 2],
    /// free causes, -1 to 1
    pub causes: Vec<f64>,
    pub features: Vec<f64>,
}

/// Features over faults and causes around a pair.
pub struct Surrogate {
    /// coefficients of [`terms`] by row, a column a feature
    faults: DMatrix<f64>,
    /// slopes for a half-width of each cause by row
    causes: DMatrix<f64>,
    /// covariance of a measured test about the fit
    scatter: DMatrix<f64>,
}

/// What the features say.
#[derive(Clone, Debug)]
pub struct Posterior {
    /// mean, standard deviations and correlation of FSJ and zeta
    pub mean: [f64; 2],
    pub sigma: [f64; 2],
    pub correlation: f64,
    /// smallest squared residual in standard uncertainties, the causes' priors included
    pub misfit: f64,
    /// mean of the free causes as shares of their half-widths
    pub causes: DVector<f64>,
    /// and their covariance
    pub covariance: DMatrix<f64>,
}

/// Terms of a quadratic of the faults, scaled to -1 to 1 over the box.
const TERMS: usize = 6;

fn terms([u, v]: [f64; 2]) -> [f64; TERMS] {
    [1.0, u, v, u * u, u * v, v * v]
}

impl Surrogate {
    /// Least squares over points of a region; `None` where they are too few to tell the scatter.
    ///
    /// * `least` smallest variance of each feature: where nothing scatters, rounding and stairs do
    pub fn fit(region: &Region, points: &[&Point], least: &[f64]) -> Option<Self> {
        let (n, k) = (points.len(), least.len());
        let m = points.first().map_or(0, |p| p.causes.len());
        let p = TERMS + m;
        // so many degrees of freedom the covariance of k features needs to be inverted
        if n < p + k + 3 {
            return None;
        }
        let design = DMatrix::from_fn(n, p, |i, j| {
            if j < TERMS {
                terms(region.scaled(points[i].fault))[j]
            } else {
                points[i].causes[j - TERMS]
            }
        });
        let y = DMatrix::from_fn(n, k, |i, j| points[i].features[j]);
        let b = (design.transpose() * &design)
            .cholesky()?
            .solve(&(design.transpose() * &y));
        let left = &y - &design * &b;
        let free = (n - p) as f64;
        // the inverse of a sample covariance is too great on average by free / (free - k - 1) (inverse
        // Wishart); a new test differs from the fit by the error of the fit too, p / n on average
        let factor = MARGIN * free / (free - k as f64 - 1.0) * (1.0 + p as f64 / n as f64);
        let mut scatter = left.transpose() * &left / free * factor;
        (0..k).for_each(|i| scatter[(i, i)] = scatter[(i, i)].max(least[i]));
        Some(Self {
            faults: b.rows(0, TERMS).into_owned(),
            causes: b.rows(TERMS, m).into_owned(),
            scatter,
        })
    }

    /// Slope of a feature along FSJ for a radius of the box.
    pub fn slope(&self, feature: usize) -> f64 {
        self.faults[(1, feature)]
    }

    /// Surfaces and measured features in units of a covariance.
    fn whitened(&self, covariance: DMatrix<f64>, measured: &[f64]) -> Whitened {
        let cholesky = covariance.cholesky().expect("positive definite by the scatter");
        let whiten = |x: &DMatrix<f64>| cholesky.l().solve_lower_triangular(x).expect("of full rank");
        let measured = DMatrix::from_column_slice(measured.len(), 1, measured);
        Whitened {
            faults: whiten(&self.faults.transpose()),
            causes: whiten(&self.causes.transpose()),
            measured: whiten(&measured).column(0).into_owned(),
        }
    }

    /// The same by what a test scatters about the fit alone.
    pub fn by_scatter(&self, measured: &[f64]) -> Whitened {
        self.whitened(self.scatter.clone(), measured)
    }

    /// Posterior of the faults under a flat prior in the region, summed over a grid; the causes, Gaussian and
    /// straight, are eliminated for every cell.
    ///
    /// * `measured` features, in the order of the points'
    pub fn posterior(&self, region: &Region, measured: &[f64]) -> Posterior {
        let m = self.causes.nrows();
        let all = &self.scatter + self.causes.transpose() * &self.causes / 3.0;
        let white = self.whitened(all, measured);
        let causes = &white.causes;
        let mut window = [region.beyond(0), region.beyond(1)];
        let mut out;
        let mut zooms = 0;
        loop {
            let width = window.map(|(lo, hi)| (hi - lo) / CELLS as f64);
            let at = |i: usize, j: usize| {
                let middle = |a: usize, k: usize| window[a].0 + width[a] * (k as f64 + 0.5);
                [middle(0, i), middle(1, j)]
            };
            let cells: Vec<([f64; 2], DVector<f64>)> = (0..CELLS * CELLS)
                .map(|c| at(c % CELLS, c / CELLS))
                .map(|fault| (fault, white.residual(region, fault)))
                .collect();
            let misfit = cells
                .iter()
                .map(|(_, r)| r.norm_squared())
                .fold(f64::INFINITY, f64::min);
            let mut sums = Sums::new(m);
            for (fault, r) in &cells {
                let weight = (-0.5 * (r.norm_squared() - misfit)).exp();
                // cells that weigh nothing are most of them
                if weight > 1e-9 {
                    sums.add(weight, *fault, &(causes.tr_mul(r) / 3.0));
                }
            }
            out = sums.posterior(misfit);
            let coarse = (0..2).any(|a| out.sigma[a] < 4.0 * width[a]);
            if !coarse || zooms == 6 {
                break;
            }
            zooms += 1;
            for a in 0..2 {
                let reach = 6.0 * out.sigma[a].max(0.5 * width[a]);
                let (lo, hi) = (out.mean[a] - reach, out.mean[a] + reach);
                window[a] = (lo.max(window[a].0), hi.min(window[a].1));
            }
        }
        out.covariance += DMatrix::identity(m, m) / 3.0 - causes.tr_mul(causes) / 9.0;
        out
    }
}

/// Features in units of a covariance, so that squares add.
pub struct Whitened {
    /// coefficients of [`terms`], a column each
    faults: DMatrix<f64>,
    /// slopes for a half-width of each cause, a column each
    pub causes: DMatrix<f64>,
    measured: DVector<f64>,
}

impl Whitened {
    /// What is measured less what a pair makes with every cause in its middle.
    pub fn residual(&self, region: &Region, fault: [f64; 2]) -> DVector<f64> {
        let mut r = self.measured.clone();
        let columns = terms(region.scaled(fault)).into_iter().zip(self.faults.column_iter());
        columns.for_each(|(t, column)| r.axpy(-t, &column, 1.0));
        r
    }
}

/// Weighted sums of faults and causes.
pub struct Sums {
    weight: f64,
    /// first and second moments of FSJ and zeta less those of the first cell, and of their product
    origin: Option<[f64; 2]>,
    first: [f64; 2],
    second: [f64; 2],
    product: f64,
    causes: DVector<f64>,
    squares: DMatrix<f64>,
}

impl Sums {
    pub fn new(causes: usize) -> Self {
        Self {
            weight: 0.0,
            origin: None,
            first: [0.0; 2],
            second: [0.0; 2],
            product: 0.0,
            causes: DVector::zeros(causes),
            squares: DMatrix::zeros(causes, causes),
        }
    }

    pub fn add(&mut self, weight: f64, fault: [f64; 2], causes: &DVector<f64>) {
        let origin = *self.origin.get_or_insert(fault);
        let d = [fault[0] - origin[0], fault[1] - origin[1]];
        self.weight += weight;
        for a in 0..2 {
            self.first[a] += weight * d[a];
            self.second[a] += weight * d[a] * d[a];
        }
        self.product += weight * d[0] * d[1];
        self.causes.axpy(weight, causes, 1.0);
        self.squares.ger(weight, causes, causes, 1.0);
    }

    pub fn posterior(&self, misfit: f64) -> Posterior {
        let w = self.weight;
        let origin = self.origin.expect("the best cell weighs 1");
        let mean = [self.first[0] / w, self.first[1] / w];
        let variance = |a: usize| (self.second[a] / w - mean[a] * mean[a]).max(1e-24);
        let sigma = [variance(0).sqrt(), variance(1).sqrt()];
        let common = self.product / w - mean[0] * mean[1];
        let causes = &self.causes / w;
        Posterior {
            mean: [origin[0] + mean[0], origin[1] + mean[1]],
            sigma,
            correlation: (common / (sigma[0] * sigma[1])).clamp(-1.0, 1.0),
            misfit,
            covariance: &self.squares / w - &causes * causes.transpose(),
            causes,
        }
    }
}

/// A box of fault pairs (FSJ, zeta).
#[derive(Clone, Copy, Debug)]
pub struct Region {
    pub centre: [f64; 2],
    pub radius: [f64; 2],
}

impl Region {
    /// Kept to what physics allows.
    pub fn new(centre: [f64; 2], radius: [f64; 2]) -> Self {
        Self {
            centre: std::array::from_fn(|a| centre[a].clamp(PHYSICAL[a].0, PHYSICAL[a].1)),
            radius: radius.map(|r| r.max(1e-6)),
        }
    }

    /// Ends of `reach` radii to either side, pushed inwards at a physical limit: there the box lies on one
    /// side of the estimate.
    fn span(&self, a: usize, reach: f64) -> (f64, f64) {
        let (least, most) = PHYSICAL[a];
        let (c, r) = (self.centre[a], reach * self.radius[a]);
        let push = (least - (c - r)).max(0.0) - ((c + r) - most).max(0.0);
        ((c - r + push).max(least), (c + r + push).min(most))
    }

    /// Ends along an axis.
    pub fn ends(&self, a: usize) -> (f64, f64) {
        self.span(a, 1.0)
    }

    /// Ends within which the fit is used.
    pub fn beyond(&self, a: usize) -> (f64, f64) {
        self.span(a, BEYOND)
    }

    /// Whether a pair lies in it.
    pub fn holds(&self, fault: [f64; 2]) -> bool {
        (0..2).all(|a| {
            let (lo, hi) = self.ends(a);
            (lo..=hi).contains(&fault[a])
        })
    }

    /// Faults scaled to -1 to 1 over the box.
    fn scaled(&self, fault: [f64; 2]) -> [f64; 2] {
        std::array::from_fn(|a| {
            let (lo, hi) = self.ends(a);
            (2.0 * fault[a] - lo - hi) / (hi - lo)
        })
    }

    fn edge(&self, p: &Posterior, a: usize) -> bool {
        let x = self.scaled(p.mean)[a];
        let (lo, hi) = self.ends(a);
        let limit = if x < 0.0 {
            lo <= PHYSICAL[a].0
        } else {
            hi >= PHYSICAL[a].1
        };
        x.abs() > EDGE.0 && !limit
    }

    /// Whether the mean lies so near an edge that the faults may lie beyond it.
    pub fn at_edge(&self, p: &Posterior) -> bool {
        (0..2).any(|a| self.edge(p, a))
    }

    /// The box of the next step: around the mean, with a few standard deviations to either side.
    ///
    /// * `least` radii
    pub fn next(&self, p: &Posterior, least: [f64; 2]) -> Self {
        let edge = self.at_edge(p);
        let radius = |a: usize| {
            let old = self.radius[a];
            let wanted = (REACH * p.sigma[a]).max(least[a]);
            if self.edge(p, a) {
                (EDGE.1 * old).min(0.5 * (RANGE[a].1 - RANGE[a].0))
            } else if edge {
                // the other fault is still on its way
                old.max(wanted.min(EDGE.1 * old))
            } else {
                wanted.clamp(SHRINK * old, EDGE.1 * old)
            }
        };
        Self {
            centre: p.mean,
            radius: [radius(0), radius(1)],
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::refine::walk::Walk;
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;

    /// Even numbers from 0 to 1 (Weyl's sequence of a square root).
    fn even(i: usize, root: f64) -> f64 {
        ((i + 1) as f64 * root.sqrt()).fract()
    }

    /// About a Gaussian with deviation 1.
    fn noise(i: usize) -> f64 {
        [2.0, 3.0, 5.0, 7.0, 11.0, 13.0]
            .map(|r| even(i * 7 + 1, r))
            .iter()
            .sum::<f64>()
            * 2f64.sqrt()
            - 18f64.sqrt()
    }

    /// Points of two straight features: FSJ + 0.1 x, zeta + 0.02 x, x the only cause, and their noise.
    fn points(region: &Region, n: usize, sigma: [f64; 2]) -> Vec<Point> {
        let ends = [region.ends(0), region.ends(1)];
        let along = |a: usize, share: f64| ends[a].0 + (ends[a].1 - ends[a].0) * share;
        let one = |i: usize| {
            let (fault, x) = (
                [along(0, even(i, 17.0)), along(1, even(i, 19.0))],
                2.0 * even(i, 23.0) - 1.0,
            );
            let f = fault[0] + 0.1 * x + sigma[0] * noise(2 * i);
            let z = fault[1] + 0.02 * x + sigma[1] * noise(2 * i + 1);
            Point {
                fault,
                causes: vec![x],
                features: vec![f, z],
            }
        };
        (0..n).map(one).collect()
    }

    #[test]
    fn val_posterior_of_a_straight_model_is_the_textbook_one() {
        let region = Region::new([3.0, 0.2], [0.5, 0.1]);
        let (sigma, n) = ([0.03, 0.01], 4000);
        let all = points(&region, n, sigma);
        let fit = Surrogate::fit(&region, &all.iter().collect::<Vec<_>>(), &[0.0; 2]).unwrap();
        let p = fit.posterior(&region, &[3.1, 0.22]);
        // covariance: noise and a third of the product of the cause's slopes
        let (ff, zz, fz) = (
            sigma[0].powi(2) + 0.01 / 3.0,
            sigma[1].powi(2) + 0.0004 / 3.0,
            0.002 / 3.0,
        );
        assert!(
            (p.mean[0] - 3.1).abs() < 0.005 && (p.mean[1] - 0.22).abs() < 0.002,
            "{p:?}"
        );
        assert!((p.sigma[0] / ff.sqrt() - 1.0).abs() < 0.05, "{p:?}");
        assert!((p.sigma[1] / zz.sqrt() - 1.0).abs() < 0.05, "{p:?}");
        assert!((p.correlation - fz / (ff * zz).sqrt()).abs() < 0.05, "{p:?}");
        // two features for two faults say nothing about the cause
        assert!(
            p.causes[0].abs() < 0.1 && (p.covariance[(0, 0)].sqrt() - 1.0 / 3f64.sqrt()).abs() < 0.03,
            "{p:?}"
        );
        // no residual, but for half a cell of the grid
        assert!(p.misfit < 0.1, "{p:?}");
    }

    /// Units drawn by what straight features say, their noise as of [`points`].
    fn walk(region: &Region, sigma: [f64; 2], measured: [f64; 2], seed: u64) -> Walk {
        let all = points(region, 400, sigma);
        let fit = Surrogate::fit(region, &all.iter().collect::<Vec<_>>(), &[0.0; 2]).unwrap();
        let gaussian = fit.posterior(region, &measured);
        Walk::through(&fit, region, &measured, &gaussian, &mut ChaCha8Rng::seed_from_u64(seed))
    }

    #[test]
    fn val_a_cause_of_which_nothing_is_known_is_uniform() {
        let region = Region::new([3.0, 0.2], [0.5, 0.1]);
        let exact = |measured, seed| walk(&region, [1e-4; 2], measured, seed);
        let w = exact([3.1, 0.22], 1);
        // FSJ = 3.1 - 0.1 x, zeta = 0.22 - 0.02 x, x from -1 to 1
        let (f, z) = (w.shortest(0, 0.95), w.shortest(1, 0.95));
        assert!(
            (f.width() / 0.19 - 1.0).abs() < 0.02 && (z.width() / 0.038 - 1.0).abs() < 0.02,
            "{f:?} {z:?}"
        );
        assert!((w.posterior.mean[0] - 3.1).abs() < 0.005 && w.posterior.correlation > 0.99);
        assert!(
            (w.posterior.sigma[0] - 0.1 / 3f64.sqrt()).abs() < 0.003,
            "{:?}",
            w.posterior
        );
        let again = exact([3.1, 0.22], 1).shortest(0, 0.95);
        assert_eq!(again, f, "the seed decides everything");
        // beyond what the cause can be: its end, and no farther
        assert!(exact([3.1, 0.15], 1).posterior.causes[0].abs() <= 1.0);
    }

    #[test]
    fn prop_an_interval_begins_at_the_physical_limit_whatever_the_seed_and_at_no_other_end() {
        let region = Region::new([3.0, 0.0], [0.5, 0.05]);
        for seed in 0..10 {
            let w = walk(&region, [0.03, 0.01], [3.0, 0.0], seed);
            let (f, z) = (w.shortest(0, 0.975), w.shortest(1, 0.975));
            assert!(z.lo == 0.0 && z.hi > 0.015 && f.lo > 2.5, "seed {seed}: {f:?} {z:?}");
        }
        // away from it
        let z = walk(&region, [0.03, 0.01], [3.0, 0.06], 1).shortest(1, 0.975);
        assert!(z.lo > 0.02 && z.hi < 0.1, "{z:?}");
    }

    #[test]
    fn prop_zeta_never_passes_zero() {
        let region = Region::new([3.0, 0.0], [0.5, 0.05]);
        assert_eq!(region.ends(1), (0.0, 0.1));
        let all = points(&region, 400, [0.03, 0.01]);
        let fit = Surrogate::fit(&region, &all.iter().collect::<Vec<_>>(), &[0.0; 2]).unwrap();
        let (inner, outer) = (
            fit.posterior(&region, &[3.0, 0.0]),
            fit.posterior(&region, &[3.0, -0.03]),
        );
        assert!(inner.mean[1] > 0.0 && outer.mean[1] > 0.0 && outer.mean[1] < inner.mean[1]);
        assert!(outer.misfit > inner.misfit + 1.0);
        assert!(!region.at_edge(&outer), "the physical limit is no edge of the box");
    }

    #[test]
    fn prop_boxes_follow_the_mean_and_shrink_no_faster_than_allowed() {
        let region = Region::new([3.0, 0.2], [0.5, 0.05]);
        let at = |mean: [f64; 2], sigma: f64| Posterior {
            mean,
            sigma: [sigma; 2],
            correlation: 0.0,
            misfit: 0.0,
            causes: DVector::zeros(0),
            covariance: DMatrix::zeros(0, 0),
        };
        let inside = region.next(&at([3.1, 0.2], 1e-9), [0.0; 2]);
        assert_eq!(inside.centre, [3.1, 0.2]);
        assert!((inside.radius[0] - SHRINK * 0.5).abs() < 1e-12 && inside.radius[1] < 0.05);
        let held = region.next(&at([3.1, 0.2], 1e-9), [0.2, 0.0]);
        assert!((held.radius[0] - 0.2).abs() < 1e-12);
        // a mean at the edge: the box grows there and does not shrink elsewhere
        let edge = region.next(&at([3.48, 0.2], 1e-9), [0.0; 2]);
        assert_eq!(edge.radius, [1.0, 0.05]);
        assert!(Surrogate::fit(&region, &[], &[0.0]).is_none());
    }
}
