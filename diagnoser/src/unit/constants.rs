//! The constants of a unit as its tests know them: a Gaussian, updated test by test.

use crate::diagnosis::{Diagnoser, Known};
use crate::uncertainty::{Deviations, Discrepancy, FRICTION, Factors};
use nalgebra::DMatrix;
use schemas::feature::Features;
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

/// Whether it is another one in each test of a unit.
fn is_of_test(cause: Cause) -> bool {
    matches!(
        cause,
        Cause::Supply | Cause::Temperature | Cause::RestAngle | Cause::TestTemperature
    )
}

/// Whether it is a constant of a part, which another part has another value of: effects of a model are the study's.
pub(super) fn renewable(cause: Cause) -> bool {
    let of_effects = matches!(cause, Cause::EffectAmplitude | Cause::EffectShape | Cause::EffectGrowth);
    !is_of_test(cause) && !of_effects
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

    pub(super) fn matrix(&self) -> DMatrix<f64> {
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

    /// Of every number, and of what is made of them: calibrations by an older one hold for other responses.
    pub fn fingerprint(&self) -> String {
        let mut text = String::from("constants 2");
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

pub(super) fn add(to: &mut Deviations, friction_per_k: f64, cause: Cause, x: f64) {
    for (through, per_unit) in cause.acts_through(friction_per_k) {
        to[through as usize] += per_unit * x;
    }
}

/// Row by row, what rounding left of asymmetry taken out.
pub(super) fn symmetric(c: &DMatrix<f64>) -> Vec<f64> {
    let n = c.nrows();
    (0..n * n)
        .map(|k| 0.5 * (c[(k / n, k % n)] + c[(k % n, k / n)]))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

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
