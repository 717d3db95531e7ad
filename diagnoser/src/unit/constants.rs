//! The constants of a unit as its tests know them: a Gaussian, updated test by test.

use super::baseline::Baseline;
use crate::diagnosis::{Diagnoser, Known};
use crate::uncertainty::{Deviations, Discrepancy, FRICTION, Factors};
use nalgebra::{DMatrix, DVector};
use schemas::feature::{Feature, Features};
use schemas::fingerprint::{exact, fingerprint};
use sim_worker::parameters::ActuatorParameters;
use sim_worker::spread::{Cause, Spread, of_uniform};

/// Standard deviations of a study, by this factor, are those that a unit begins with (assumed): what is identified in
/// motion over seconds and what a short test shows are not quite the same.
const STUDIED: f64 = 2.0;

/// Greatest half-width of a spread, relative.
const WIDEST: f64 = 0.5;

/// Step by which the response to the slope of friction over temperature is found, relative.
const SLOPE_STEP: f64 = 1e-3;

/// Gauss-Newton steps: responses are nearly straight.
const STEPS: usize = 4;

/// What is known of a unit's constants.
#[derive(Clone, Debug, PartialEq)]
pub struct Constants {
    /// what is constant in a unit and not known exactly
    pub causes: Vec<Cause>,
    /// deviations from the actuator of the maps as they are counted ([`Cause::counted`])
    pub mean: Vec<f64>,
    /// row by row
    pub covariance: Vec<f64>,
    /// what is another one in each test: half-widths
    pub of_test: Vec<(Cause, f64)>,
    /// as [`Spread::friction_per_k`]
    pub friction_per_k: f64,
    /// what healthy tests show that no constant explains
    pub discrepancy: Vec<Discrepancy>,
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

/// Whether it is another one in each test of a unit.
fn is_of_test(cause: Cause) -> bool {
    matches!(
        cause,
        Cause::Supply | Cause::Temperature | Cause::RestAngle | Cause::TestTemperature
    )
}

impl Constants {
    /// What is known before any test: what the study of the actuator says, with its correlations, and how units of the
    /// type differ where no study says it.
    ///
    /// * `spread` from unit to unit and test to test
    pub fn prior(actuator: &ActuatorParameters, spread: &Spread) -> Self {
        let own = Spread::identified(actuator);
        let mut causes: Vec<(Cause, f64, Option<usize>)> = Vec::new();
        let of_test = spread.causes().filter(|(c, _)| is_of_test(*c)).collect();
        match &own {
            Some(own) => {
                let u = &actuator.uncertainty;
                let keys = [
                    (Cause::Resistance, "motor.phase_resistance_ohm"),
                    (Cause::BackEmf, "motor.back_emf_v_s_per_rad"),
                    (Cause::Inertia, "motor.inertia_kg_m2"),
                    (Cause::Inductance, "motor.phase_inductance_h"),
                    (Cause::Viscous, "motor.viscous_n_m_s_per_rad"),
                    (Cause::HealthyFriction, "friction.static_n_m"),
                ];
                for (cause, key) in keys {
                    let place = u.parameters.iter().position(|p| p == key);
                    match place {
                        Some(i) => causes.push((cause, STUDIED * u.deviation[i], place)),
                        // what the study did not touch, as the type has it
                        None => causes.push((cause, of_uniform(spread.half_width[cause as usize]), None)),
                    }
                }
                for cause in [Cause::BreakAway, Cause::EffectAmplitude, Cause::EffectShape] {
                    causes.push((cause, of_uniform(own.half_width[cause as usize]), None));
                }
            }
            None => {
                let constant = spread.causes().filter(|(c, _)| !is_of_test(*c));
                causes.extend(constant.map(|(c, h)| (c, of_uniform(h), None)));
            }
        }
        if actuator.effects.iter().any(|e| e.is_present() && e.grows != 0.0) {
            causes.push((Cause::EffectGrowth, of_uniform(0.5), None));
        }
        causes.retain(|(_, s, _)| *s > 0.0);
        for (c, sd, _) in &mut causes {
            *sd = sd.min(of_uniform(widest(*c)));
        }
        let n = causes.len();
        let all = actuator.uncertainty.parameters.len();
        let correlation = |a: usize, b: usize| match (causes[a].2, causes[b].2) {
            _ if a == b => 1.0,
            (Some(i), Some(j)) => actuator
                .uncertainty
                .correlation
                .get(i * all + j)
                .copied()
                .unwrap_or(0.0),
            _ => 0.0,
        };
        let mut covariance: Vec<f64> = (0..n * n)
            .map(|k| correlation(k / n, k % n) * causes[k / n].1 * causes[k % n].1)
            .collect();
        if DMatrix::from_row_slice(n, n, &covariance).cholesky().is_none() {
            // correlations that cannot be are none
            (0..n * n).filter(|k| k / n != k % n).for_each(|k| covariance[k] = 0.0);
        }
        Self {
            causes: causes.iter().map(|c| c.0).collect(),
            mean: vec![0.0; n],
            covariance,
            of_test,
            friction_per_k: spread.friction_per_k,
            discrepancy: Vec::new(),
        }
    }

    fn matrix(&self) -> DMatrix<f64> {
        DMatrix::from_row_slice(self.causes.len(), self.causes.len(), &self.covariance)
    }

    /// Lower triangle: a unit's deviations are the mean and this times independent numbers of standard deviation 1.
    pub fn root(&self) -> DMatrix<f64> {
        let mut c = self.matrix();
        // what is known exactly has no root of its own
        for i in 0..c.nrows() {
            c[(i, i)] = c[(i, i)] * (1.0 + 1e-9) + 1e-18;
        }
        match c.clone().cholesky() {
            Some(c) => c.l(),
            None => DMatrix::from_diagonal(&c.diagonal().map(|x| x.max(0.0).sqrt())),
        }
    }

    /// Standard deviation of a constant, and its mean.
    pub fn of(&self, cause: Cause) -> Option<(f64, f64)> {
        let i = self.causes.iter().position(|c| *c == cause)?;
        Some((self.mean[i], self.covariance[i * self.causes.len() + i].max(0.0).sqrt()))
    }

    /// A spread that simulated units may be drawn from: `sqrt(3)` standard deviations either way.
    pub fn spread(&self) -> Spread {
        let mut s = Spread::none();
        s.name = "unit".into();
        s.friction_per_k = self.friction_per_k;
        for (i, c) in self.causes.iter().enumerate() {
            let sd = self.covariance[i * self.causes.len() + i].max(0.0).sqrt();
            s.half_width[*c as usize] = (3f64.sqrt() * sd).min(widest(*c));
        }
        for (c, h) in &self.of_test {
            s.half_width[*c as usize] = *h;
        }
        s
    }

    /// For a diagnosis.
    ///
    /// * `known` of the test or the unit: taken as exact
    pub fn factors(&self, known: &Known) -> Factors {
        let is_known = |c: Cause| known.iter().any(|(k, _)| *k == c);
        let free = self.of_test.iter().filter(|(c, _)| !is_known(*c));
        let free: Vec<(Cause, f64)> = free.map(|&(c, h)| (c, of_uniform(h))).collect();
        let slope_of_test = Spread {
            friction_per_k: self.friction_per_k,
            ..Spread::none()
        };
        let of_test = Factors::independent(&slope_of_test, &free, known);
        let mut factors = Factors {
            each: Vec::new(),
            ..of_test
        };
        let n = self.causes.len();
        let root = self.root();
        for (c, x) in self.causes.iter().zip(&self.mean).filter(|(c, _)| !is_known(**c)) {
            factors.middle[*c as usize] += x;
        }
        // the unit's own slope of friction acts where the test's temperature is known to be another one
        let of = |c: Cause| known.iter().filter(|k| k.0 == c).map(|k| k.1).sum::<f64>();
        let kelvin = of(Cause::TestTemperature);
        let at = |slope: f64| slope_of_test.friction_at(kelvin, slope).ln();
        let own_slope = factors.middle[Cause::FrictionSlope as usize];
        let by_slope = (at(own_slope + SLOPE_STEP) - at(own_slope - SLOPE_STEP)) / (2.0 * SLOPE_STEP);
        for c in FRICTION {
            factors.middle[c as usize] += at(own_slope) - at(of(Cause::FrictionSlope));
        }
        for k in 0..n {
            let mut row = Deviations::default();
            for (i, c) in self.causes.iter().enumerate().filter(|(_, c)| !is_known(**c)) {
                row[*c as usize] = root[(i, k)];
            }
            for c in FRICTION {
                row[c as usize] += by_slope * row[Cause::FrictionSlope as usize];
            }
            if row.iter().any(|x| *x != 0.0) {
                factors.each.push((self.causes[k], row));
            }
        }
        factors.each.extend(of_test.each);
        factors.discrepancy.clone_from(&self.discrepancy);
        factors
    }

    /// The posterior after healthy tests, all at once: the faults are 1 and 0 by definition, the supply another one in
    /// each test, and what the response surface leaves is the same in all tests of the unit.
    ///
    /// * `wider` standard deviations of what else is the same in all tests, by feature: of the model itself
    pub fn after_healthy(&self, baseline: &Baseline, tests: &[Features], wider: &[(Feature, f64)]) -> Learnt {
        let expected = |x: &Deviations| {
            let mut all = baseline.at(x);
            for e in &mut all {
                let more = wider.iter().filter(|w| w.0 == e.feature);
                e.systematic = more.fold(e.systematic, |s, w| s.hypot(w.1));
            }
            all
        };
        let n = self.causes.len();
        let m = self.of_test.len();
        let kinds = baseline.at(&Deviations::default()).len();
        // constants, what each test has of its own, systematic errors: in standard deviations but for the constants
        let all = n + m * tests.len() + kinds;
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
            for (j, features) in tests.iter().enumerate() {
                let mut deviations = Deviations::default();
                for (c, x) in self.causes.iter().zip(x.iter()) {
                    add(&mut deviations, self.friction_per_k, *c, *x);
                }
                for (k, (c, h)) in self.of_test.iter().enumerate() {
                    add(
                        &mut deviations,
                        self.friction_per_k,
                        *c,
                        x[n + j * m + k] * of_uniform(*h),
                    );
                }
                for (k, e) in expected(&deviations).iter().enumerate() {
                    let Some(y) = features.get(e.feature).filter(|y| y.is_finite()) else {
                        continue;
                    };
                    let mut slope = DVector::<f64>::zeros(all);
                    let along = |c: Cause| {
                        c.acts_through(self.friction_per_k)
                            .into_iter()
                            .map(|(c, u)| u * e.slopes[c as usize])
                            .sum::<f64>()
                    };
                    for (i, c) in self.causes.iter().enumerate() {
                        slope[i] = along(*c);
                    }
                    for (i, (c, h)) in self.of_test.iter().enumerate() {
                        slope[n + j * m + i] = along(*c) * of_uniform(*h);
                    }
                    slope[n + m * tests.len() + k] = e.systematic;
                    let least = 1e-3 * e.systematic + 1e-12 * (1.0 + e.value.abs());
                    let variance = e.noise * e.noise + least * least;
                    let left = y - e.value - e.systematic * x[n + m * tests.len() + k];
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
        let of_surface = baseline.at(&Deviations::default());
        let widened = expected(&Deviations::default());
        let left = widened.iter().zip(&of_surface).enumerate();
        let left = left.map(|(k, (e, own))| {
            let value = e.systematic * x[n + m * tests.len() + k];
            (e.feature, value, value / own.systematic.max(1e-300))
        });
        Learnt {
            left: left.collect(),
            constants: Self {
                causes: self.causes.clone(),
                mean: x.iter().take(n).copied().collect(),
                covariance: symmetric(&covariance),
                of_test: self.of_test.clone(),
                friction_per_k: self.friction_per_k,
                discrepancy: self.discrepancy.clone(),
            },
            misfit: cost / f64::from(rows.max(1)),
        }
    }

    /// Features of healthy tests, their mean, that lie beyond what constants, tests and sensors explain by so many standard
    /// deviations, and by how much.
    pub fn beyond(&self, baseline: &Baseline, tests: &[Features], sigmas: f64) -> Vec<(Feature, f64)> {
        let mut middle = Deviations::default();
        for (c, x) in self.causes.iter().zip(&self.mean) {
            add(&mut middle, self.friction_per_k, *c, *x);
        }
        let covariance = self.matrix();
        let one = |e: &super::Expected| {
            let values: Vec<f64> = tests
                .iter()
                .filter_map(|t| t.get(e.feature))
                .filter(|x| x.is_finite())
                .collect();
            let mean = values.iter().sum::<f64>() / values.len().max(1) as f64;
            let along = |c: Cause| {
                c.acts_through(self.friction_per_k)
                    .into_iter()
                    .map(|(c, u)| u * e.slopes[c as usize])
                    .sum::<f64>()
            };
            let slopes = DVector::from_iterator(self.causes.len(), self.causes.iter().map(|c| along(*c)));
            let of_constants = slopes.dot(&(&covariance * &slopes));
            let of_tests: f64 = self
                .of_test
                .iter()
                .map(|(c, h)| (along(*c) * of_uniform(*h)).powi(2))
                .sum();
            let sd = (of_constants + of_tests + e.systematic * e.systematic + e.noise * e.noise).sqrt();
            let off = (mean - e.value).abs();
            (!values.is_empty() && off > sigmas * sd).then_some((e.feature, off))
        };
        baseline.at(&middle).iter().filter_map(one).collect()
    }

    /// Whether tests at faults that nobody knows say more of the constants than is known: before any healthy test, or where
    /// only worn units show whether an effect grows with the fault. Beside a healthy test they say nothing (measured:
    /// errors of FSJ stayed as they were after 10 and 30, and what maps and responses err by, which is the same in all tests
    /// of a unit, was taken for knowledge: of 95 % of true pairs the intervals held 85 to 91).
    ///
    /// * `healthy` tests that are known
    pub fn learn_when_worn(&self, healthy: usize) -> bool {
        healthy == 0 || self.causes.contains(&Cause::EffectGrowth)
    }

    /// The posterior after a test at faults that nobody knows. `None` where the test lacks features.
    ///
    /// * `diagnoser` made ready with these constants and nothing known of the test
    /// * `again` how many tests at unknown faults have been learnt from, this one included: what maps and responses err by
    ///   is much the same in all of them, so that they weigh as `1/again^2` (assumed)
    pub fn after_test(&self, diagnoser: &Diagnoser, features: &Features, again: usize) -> Option<Self> {
        let (mean, covariance) = diagnoser.factors_given(features, (again * again) as f64)?;
        let n = self.causes.len();
        let root = self.root();
        // factors of the constants come first
        let moved = &root * mean.rows(0, n);
        let covariance = &root * covariance.view((0, 0), (n, n)) * root.transpose();
        Some(Self {
            causes: self.causes.clone(),
            mean: self.mean.iter().zip(moved.iter()).map(|(m, x)| m + x).collect(),
            covariance: symmetric(&covariance),
            of_test: self.of_test.clone(),
            friction_per_k: self.friction_per_k,
            discrepancy: self.discrepancy.clone(),
        })
    }

    /// Of every number.
    pub fn fingerprint(&self) -> String {
        let mut text = String::from("constants");
        for (c, x) in self.causes.iter().zip(&self.mean) {
            text += &format!(";{},{}", c.key(), exact(*x));
        }
        self.covariance.iter().for_each(|x| text += &format!(",{}", exact(*x)));
        for (c, h) in &self.of_test {
            text += &format!(";{},{}", c.key(), exact(*h));
        }
        if self.friction_per_k != 0.0 {
            text += &format!(";friction_per_k,{}", exact(self.friction_per_k));
        }
        fingerprint(&text)
    }
}

/// Greatest half-width of the spread of a cause.
fn widest(c: Cause) -> f64 {
    if matches!(c, Cause::EffectAmplitude | Cause::EffectShape) {
        5.0
    } else {
        WIDEST
    }
}

fn add(to: &mut Deviations, friction_per_k: f64, cause: Cause, x: f64) {
    for (through, per_unit) in cause.acts_through(friction_per_k) {
        to[through as usize] += per_unit * x;
    }
}

/// Row by row, what rounding left of asymmetry taken out.
fn symmetric(c: &DMatrix<f64>) -> Vec<f64> {
    let n = c.nrows();
    (0..n * n)
        .map(|k| 0.5 * (c[(k / n, k % n)] + c[(k % n, k / n)]))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two features that read resistance and healthy friction.
    fn baseline(noise: f64) -> Baseline {
        let samples: Vec<(Deviations, Vec<f64>)> = (0..300)
            .map(|i| {
                let mut x = Deviations::default();
                x[Cause::Resistance as usize] = 0.05 * ((i * 37 % 300) as f64 / 150.0 - 1.0);
                x[Cause::HealthyFriction as usize] = 0.2 * ((i * 91 % 300) as f64 / 150.0 - 1.0);
                let (r, f) = (x[Cause::Resistance as usize], x[Cause::HealthyFriction as usize]);
                (x, vec![1.0 + 0.8 * f, 2.0 - r + 0.1 * f])
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

    #[test]
    fn prop_healthy_tests_find_the_constants_and_contradictions_are_seen() {
        let (r, f) = (-0.03, 0.15);
        let test = |d: f64| {
            Features::default()
                .with(Feature::P2, Some(1.0 + 0.8 * f + d))
                .with(Feature::P3, Some(2.0 - r + 0.1 * f - d))
        };
        let b = baseline(1e-3);
        let one = prior().after_healthy(&b, &[test(0.0)], &[]);
        let (mean, sd) = one.constants.of(Cause::HealthyFriction).unwrap();
        assert!((mean - f).abs() < 1e-3 && (1e-3..1.6e-3).contains(&sd), "{mean} {sd}");
        let (mean, _) = one.constants.of(Cause::Resistance).unwrap();
        assert!((mean - r).abs() < 1e-3, "{mean}");
        // four say it twice as well
        let four = prior().after_healthy(&b, &[0.0; 4].map(test), &[]);
        let of = |l: &Learnt| l.constants.of(Cause::HealthyFriction).unwrap().1;
        assert!((of(&one) / of(&four) - 2.0).abs() < 0.05, "{} {}", of(&one), of(&four));
        assert!(four.misfit < 2.0, "{}", four.misfit);
        assert!(prior().beyond(&b, &[test(0.0)], 3.0).is_empty());
        let off = test(0.0).with(Feature::P3, Some(2.5));
        assert!(matches!(prior().beyond(&b, &[off], 3.0)[..], [(Feature::P3, x)] if (x - 0.5).abs() < 1e-3));
        // two that are not of one unit
        let odd = prior().after_healthy(&b, &[test(0.0), test(0.1)], &[]);
        assert!(odd.misfit > 100.0, "{}", odd.misfit);
    }

    #[test]
    fn prop_a_study_is_a_prior_with_its_correlations() {
        let mut a = ActuatorParameters::reference();
        a.uncertainty.parameters = vec!["motor.inertia_kg_m2".into(), "friction.static_n_m".into()];
        a.uncertainty.deviation = vec![0.01, 0.002];
        a.uncertainty.correlation = vec![1.0, -0.5, -0.5, 1.0];
        let spread = sim_worker::catalogue::spread("unit").unwrap();
        let c = Constants::prior(&a, &spread);
        let (_, j) = c.of(Cause::Inertia).unwrap();
        assert!((j - 0.02).abs() < 1e-12);
        let n = c.causes.len();
        let place = |x: Cause| c.causes.iter().position(|c| *c == x).unwrap();
        let (j, f) = (place(Cause::Inertia), place(Cause::HealthyFriction));
        assert!((c.covariance[j * n + f] + 0.5 * 0.02 * 0.004).abs() < 1e-12);
        assert_eq!(c.of_test, [(Cause::Supply, 0.02)]);
        // what the study did not touch is the type's
        assert!((c.of(Cause::BackEmf).unwrap().1 - 0.02 / 3f64.sqrt()).abs() < 1e-12);
        // the root gives the covariance back
        let back = c.root() * c.root().transpose();
        assert!((back[(j, f)] - c.covariance[j * n + f]).abs() < 1e-12);
    }
}
