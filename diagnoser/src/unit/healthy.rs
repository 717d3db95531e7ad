//! What healthy tests of a unit say of its constants, tests from several rest angles together.

use super::baseline::{Baseline, Expected};
use super::constants::{Constants, add, symmetric};
use crate::uncertainty::Deviations;
use nalgebra::{DMatrix, DVector};
use schemas::feature::{Feature, Features};
use sim_worker::spread::{Cause, of_uniform};

/// Gauss-Newton steps: responses are nearly straight.
const STEPS: usize = 4;

/// Healthy tests of one unit from one rest angle, and what is expected of them there.
#[derive(Clone, Debug)]
pub struct HealthyTests<'a> {
    /// of the maps of that angle
    pub baseline: &'a Baseline,
    /// one a test
    pub features: &'a [Features],
}

/// Constants after tests.
#[derive(Clone, Debug, PartialEq)]
pub struct Learnt {
    /// the posterior
    pub constants: Constants,
    /// squared residual in standard deviations, priors included, over the number of features: about 1
    pub misfit: f64,
    /// what is the same in all tests and no constant explains: feature, value in its unit, in standard deviations of what
    /// the response surface leaves
    pub left: Vec<(Feature, f64, f64)>,
}

/// A feature of a test, if it has it.
fn measured(test: &Features, feature: Feature) -> Option<f64> {
    test.get(feature).filter(|y| y.is_finite())
}

/// Features that are expected anywhere, in the order in which they come.
fn features_of(groups: &[HealthyTests]) -> Vec<Feature> {
    let mut all = Vec::new();
    for e in groups.iter().flat_map(|g| g.baseline.at(&Deviations::default())) {
        if !all.contains(&e.feature) {
            all.push(e.feature);
        }
    }
    all
}

/// By feature, what tests give over what is expected at given deviations, and the expectation: one a test.
fn over(groups: &[HealthyTests], at: &Deviations, feature: Feature) -> Vec<(f64, Expected)> {
    let mut all = Vec::new();
    for g in groups {
        let Some(e) = g.baseline.at(at).into_iter().find(|e| e.feature == feature) else {
            continue;
        };
        let each = g.features.iter().filter_map(|t| measured(t, feature));
        all.extend(each.map(|y| (y - e.value, e.clone())));
    }
    all
}

/// How much healthy tests differ among each other: mean square over the features, in what scatters from test to test, and from
/// rest angle to rest angle where there are several; about 1 for tests of one unit.
pub fn disagreement(groups: &[HealthyTests]) -> f64 {
    let several = groups.len() > 1;
    let (mut sum, mut free) = (0.0, 0.0);
    for feature in features_of(groups) {
        let mut all = over(groups, &Deviations::default(), feature);
        all.retain(|(_, e)| e.noise > 0.0);
        if all.len() < 2 {
            continue;
        }
        let mean = all.iter().map(|(x, _)| x).sum::<f64>() / all.len() as f64;
        let sd = |e: &Expected| if several { e.noise.hypot(e.systematic) } else { e.noise };
        sum += all.iter().map(|(x, e)| ((x - mean) / sd(e)).powi(2)).sum::<f64>();
        free += all.len() as f64 - 1.0;
    }
    if free > 0.0 { sum / free } else { f64::INFINITY }
}

impl Constants {
    /// The posterior after healthy tests, all at once: the faults are 1 and 0 by definition, the supply another one in
    /// each test, and what the response surface of a rest angle leaves is the same in all tests from it.
    ///
    /// * `wider` standard deviations of what else is the same in all tests, by feature: of the model itself
    pub fn after_healthy(&self, groups: &[HealthyTests], wider: &[(Feature, f64)]) -> Learnt {
        let n = self.causes.len();
        let m = self.of_test.len();
        let tests: usize = groups.iter().map(|g| g.features.len()).sum();
        // constants, what each test has of its own, systematic errors of each angle and of all: in standard deviations but
        // for the constants
        let first_angle = n + m * tests;
        let mut places = vec![first_angle];
        for g in groups {
            places.push(places[places.len() - 1] + g.baseline.at(&Deviations::default()).len());
        }
        let first_wider = places[groups.len()];
        let all = first_wider + wider.len();
        let prior = self
            .matrix()
            .try_inverse()
            .unwrap_or_else(|| DMatrix::from_diagonal(&self.matrix().diagonal().map(|x| 1.0 / x.max(1e-18))));
        let mut x = DVector::<f64>::zeros(all);
        (0..n).for_each(|i| x[i] = self.mean[i]);
        let mut information = DMatrix::<f64>::zeros(all, all);
        let mut cost = 0.0;
        let mut rows = 0;
        for step in 0..=STEPS {
            information.fill(0.0);
            let mut pull = DVector::<f64>::zeros(all);
            let off = DVector::from_fn(n, |i, _| x[i] - self.mean[i]);
            information.view_mut((0, 0), (n, n)).copy_from(&prior);
            let back = &prior * &off;
            cost = off.dot(&back);
            (0..n).for_each(|i| pull[i] -= back[i]);
            for i in n..all {
                information[(i, i)] += 1.0;
                pull[i] -= x[i];
                cost += x[i] * x[i];
            }
            rows = 0;
            let each = groups.iter().zip(&places);
            let each = each.flat_map(|(g, place)| g.features.iter().map(move |f| (g.baseline, *place, f)));
            for (j, (baseline, place, features)) in each.enumerate() {
                let mut deviations = self.at_constants(x.as_slice());
                for (k, (c, h)) in self.of_test.iter().enumerate() {
                    add(
                        &mut deviations,
                        self.friction_per_k,
                        *c,
                        x[n + j * m + k] * of_uniform(*h),
                    );
                }
                for (k, e) in baseline.at(&deviations).iter().enumerate() {
                    let Some(y) = measured(features, e.feature) else {
                        continue;
                    };
                    let mut slope = DVector::<f64>::zeros(all);
                    for (i, c) in self.causes.iter().enumerate() {
                        slope[i] = self.along(e, *c);
                    }
                    for (i, (c, h)) in self.of_test.iter().enumerate() {
                        slope[n + j * m + i] = self.along(e, *c) * of_uniform(*h);
                    }
                    slope[place + k] = e.systematic;
                    let mut left = y - e.value - e.systematic * x[place + k];
                    for (i, (_, sd)) in wider.iter().enumerate().filter(|(_, w)| w.0 == e.feature) {
                        slope[first_wider + i] = *sd;
                        left -= sd * x[first_wider + i];
                    }
                    let least = 1e-3 * e.systematic + 1e-12 * (1.0 + e.value.abs());
                    let variance = e.noise * e.noise + least * least;
                    cost += left * left / variance;
                    rows += 1;
                    pull.axpy(left / variance, &slope, 1.0);
                    information.ger(1.0 / variance, &slope, &slope, 1.0);
                }
            }
            if step == STEPS {
                break;
            }
            let Some(solver) = information.clone().cholesky() else {
                break;
            };
            x += solver.solve(&pull);
        }
        let covariance = information.try_inverse().map(|c| c.view((0, 0), (n, n)).into_owned());
        let covariance = covariance.unwrap_or_else(|| self.matrix());
        let left = features_of(groups).into_iter().map(|feature| {
            let mut of_angles = Vec::new();
            for (g, place) in groups.iter().zip(&places) {
                let expected = g.baseline.at(&Deviations::default());
                let own = expected.iter().enumerate().find(|(_, e)| e.feature == feature);
                of_angles.extend(own.map(|(k, e)| (e.systematic * x[place + k], e.systematic)));
            }
            let mean = |f: fn(&(f64, f64)) -> f64| of_angles.iter().map(f).sum::<f64>() / of_angles.len() as f64;
            let of_all = wider.iter().enumerate().filter(|(_, w)| w.0 == feature);
            let value = mean(|o| o.0) + of_all.map(|(i, w)| w.1 * x[first_wider + i]).sum::<f64>();
            (feature, value, value / mean(|o| o.1).max(1e-300))
        });
        Learnt {
            left: left.collect(),
            constants: Self {
                mean: x.iter().take(n).copied().collect(),
                covariance: symmetric(&covariance),
                ..self.clone()
            },
            misfit: cost / f64::from(rows.max(1)),
        }
    }

    /// What the features respond to, at given constants.
    fn at_constants(&self, constants: &[f64]) -> Deviations {
        let mut deviations = Deviations::default();
        for (c, x) in self.causes.iter().zip(constants) {
            add(&mut deviations, self.friction_per_k, *c, *x);
        }
        deviations
    }

    /// Slope of a feature along a cause.
    fn along(&self, e: &Expected, c: Cause) -> f64 {
        let through = c.acts_through(self.friction_per_k).into_iter();
        through.map(|(c, u)| u * e.slopes[c as usize]).sum()
    }

    /// Features of healthy tests, their mean, that lie beyond what constants, tests and sensors explain by so many standard
    /// deviations, and by how much.
    pub fn beyond(&self, groups: &[HealthyTests], sigmas: f64) -> Vec<(Feature, f64)> {
        let middle = self.at_constants(&self.mean);
        let covariance = self.matrix();
        let variance = |e: &Expected| {
            let slopes = DVector::from_iterator(self.causes.len(), self.causes.iter().map(|c| self.along(e, *c)));
            let of_constants = slopes.dot(&(&covariance * &slopes));
            let of_test = |(c, h): &(Cause, f64)| (self.along(e, *c) * of_uniform(*h)).powi(2);
            let of_tests: f64 = self.of_test.iter().map(of_test).sum();
            of_constants + of_tests + e.systematic * e.systematic + e.noise * e.noise
        };
        let one = |feature: Feature| {
            let all = over(groups, &middle, feature);
            let mean = |x: f64| x / all.len().max(1) as f64;
            let off = mean(all.iter().map(|(x, _)| x).sum::<f64>()).abs();
            let sd = mean(all.iter().map(|(_, e)| variance(e)).sum::<f64>()).sqrt();
            (!all.is_empty() && off > sigmas * sd).then_some((feature, off))
        };
        features_of(groups).into_iter().filter_map(one).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use sim_worker::parameters::ActuatorParameters;
    use sim_worker::spread::Spread;

    /// Two features that read resistance and healthy friction.
    fn baseline(noise: f64) -> Baseline {
        baseline_above(noise, 0.0)
    }

    /// The same, the second feature higher.
    fn baseline_above(noise: f64, up: f64) -> Baseline {
        let samples: Vec<(Deviations, Vec<f64>)> = (0..300)
            .map(|i| {
                let mut x = Deviations::default();
                x[Cause::Resistance as usize] = 0.05 * ((i * 37 % 300) as f64 / 150.0 - 1.0);
                x[Cause::HealthyFriction as usize] = 0.2 * ((i * 91 % 300) as f64 / 150.0 - 1.0);
                let (r, f) = (x[Cause::Resistance as usize], x[Cause::HealthyFriction as usize]);
                (x, vec![1.0 + 0.8 * f, 2.0 + up - r + 0.1 * f])
            })
            .collect();
        Baseline::fit(&[(Feature::P2, noise), (Feature::P3, noise)], &samples)
    }

    fn prior() -> Constants {
        let mut spread = Spread::none();
        spread.half_width[Cause::Resistance as usize] = 0.05;
        spread.half_width[Cause::HealthyFriction as usize] = 0.2;
        Constants::prior(&ActuatorParameters::reference(), &spread)
    }

    fn tests<'a>(baseline: &'a Baseline, features: &'a [Features]) -> HealthyTests<'a> {
        HealthyTests { baseline, features }
    }

    #[test]
    fn prop_healthy_tests_find_the_constants_and_contradictions_are_seen() {
        let (r, f) = (-0.03, 0.15);
        let test = |d: f64| {
            Features::default()
                .with(Feature::P2, Some(1.0 + 0.8 * f + d))
                .with(Feature::P3, Some(2.0 - r + 0.1 * f - d))
        };
        let b = baseline(1e-3);
        let one = prior().after_healthy(&[tests(&b, &[test(0.0)])], &[]);
        let (mean, sd) = one.constants.of(Cause::HealthyFriction).unwrap();
        assert!((mean - f).abs() < 1e-3 && (1e-3..1.6e-3).contains(&sd), "{mean} {sd}");
        let (mean, _) = one.constants.of(Cause::Resistance).unwrap();
        assert!((mean - r).abs() < 1e-3, "{mean}");
        // four say it twice as well, but for what a model is off by in all of them
        let four = prior().after_healthy(&[tests(&b, &[0.0; 4].map(test))], &[]);
        let of = |l: &Learnt| l.constants.of(Cause::HealthyFriction).unwrap().1;
        let e = &b.at(&Deviations::default())[0];
        let left = |tests: f64| (e.noise * e.noise / tests + e.systematic * e.systematic).sqrt();
        let better = left(1.0) / left(4.0);
        assert!(
            (of(&one) / of(&four) - better).abs() < 0.05 && better > 1.9,
            "{} {} {better}",
            of(&one),
            of(&four)
        );
        assert!(four.misfit < 2.0, "{}", four.misfit);
        assert!(prior().beyond(&[tests(&b, &[test(0.0)])], 3.0).is_empty());
        let off = test(0.0).with(Feature::P3, Some(2.5));
        assert!(matches!(prior().beyond(&[tests(&b, &[off])], 3.0)[..], [(Feature::P3, x)] if (x - 0.5).abs() < 1e-3));
        // two that are not of one unit
        let odd = prior().after_healthy(&[tests(&b, &[test(0.0), test(0.1)])], &[]);
        assert!(odd.misfit > 100.0, "{}", odd.misfit);
    }

    #[test]
    fn prop_healthy_tests_of_several_rest_angles_show_together_what_the_model_is_off_by() {
        let (r, f) = (-0.03, 0.15);
        // each angle has its own nominal break-away
        let angles = [0.0, 0.7, -0.4].map(|up| baseline_above(1e-3, up));
        let test = |up: f64, d: f64| {
            Features::default()
                .with(Feature::P2, Some(1.0 + 0.8 * f))
                .with(Feature::P3, Some(2.0 + up - r + 0.1 * f + d))
        };
        let measured = |off: [f64; 3]| [[test(0.0, off[0])], [test(0.7, off[1])], [test(-0.4, off[2])]];
        let all = [[0.0; 3], [0.5; 3], [0.5, -0.5, 0.1]].map(measured);
        let [plain, off, other] = all.each_ref().map(|m| {
            let each = angles.iter().zip(m);
            each.map(|(b, features)| tests(b, features)).collect::<Vec<_>>()
        });
        let learnt = prior().after_healthy(&plain, &[]);
        let (mean, sd) = learnt.constants.of(Cause::HealthyFriction).unwrap();
        assert!(
            (mean - f).abs() < 1e-3 && sd < 1.6e-3 / 3f64.sqrt() + 1e-4,
            "{mean} {sd}"
        );
        assert!(learnt.misfit < 2.0 && disagreement(&plain) < 1e-3);
        // the same shift at all angles: the model is off by it, whatever constants may be
        assert!(disagreement(&off) < 1e-3, "{}", disagreement(&off));
        let beyond = prior().beyond(&off, 3.0);
        assert!(
            matches!(beyond[..], [(Feature::P3, x)] if (x - 0.545).abs() < 1e-3),
            "{beyond:?}"
        );
        let learnt = prior().after_healthy(&off, &beyond);
        let left = learnt.left.iter().find(|l| l.0 == Feature::P3).unwrap().1;
        assert!(
            learnt.misfit < 3.0 && (left - 0.5).abs() < 0.06,
            "{left} {}",
            learnt.misfit
        );
        assert!((learnt.constants.of(Cause::HealthyFriction).unwrap().0 - f).abs() < 2e-3);
        // another one at each: they are not of one unit
        assert!(disagreement(&other) > 100.0);
    }
}
