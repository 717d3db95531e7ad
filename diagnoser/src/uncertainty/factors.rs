//! What is known of a unit's causes.

use super::{MOST, Row};
use schemas::feature::Feature;
use sim_worker::spread::{Cause, Spread, of_uniform};

/// Deviations of a unit by what acts by itself ([`Cause::acts_through`]), as they are counted ([`Cause::counted`]).
pub type Deviations = [f64; Cause::COUNT];

/// What causes deviate by together, by what they act through.
///
/// * `spread` of which only [`Spread::friction_at`] is taken
/// * `each` causes and their deviations, relative where they are
fn together(spread: &Spread, each: &[(Cause, f64)]) -> Deviations {
    let mut x = [0.0; Cause::COUNT];
    for &(cause, amount) in each {
        // friction by temperature stands below
        for (through, per_unit) in cause.acts_through(0.0) {
            x[through as usize] += through.counted(amount * per_unit);
        }
    }
    let of = |c: Cause| each.iter().filter(|e| e.0 == c).map(|e| e.1).sum::<f64>();
    let friction = spread.friction_at(of(Cause::TestTemperature), of(Cause::FrictionSlope));
    for c in FRICTION {
        x[c as usize] += friction.ln();
    }
    x
}

/// What temperature changes of friction.
pub(crate) const FRICTION: [Cause; 2] = [Cause::HealthyFriction, Cause::Viscous];

/// What the causes of a spread deviate by together, where each lies at `draw` (-1 to 1) of its half-width.
pub fn deviations(spread: &Spread, draw: &[f64; Cause::COUNT]) -> Deviations {
    let each: Vec<(Cause, f64)> = spread.causes().map(|(c, h)| (c, draw[c as usize] * h)).collect();
    together(spread, &each)
}

/// Dynamic friction of a unit over the model's at the same FSJ: logarithm of the factor.
pub fn log_kinetic(x: &Deviations) -> f64 {
    x[Cause::DynamicRatio as usize] + x[Cause::HealthyFriction as usize]
}

/// What is known of causes: their deviations are `middle + sum over k of t_k each_k`, `t_k` independent with mean 0
/// and standard deviation 1.
#[derive(Clone, Debug, PartialEq)]
pub struct Factors {
    /// most probable, by what acts by itself, as counted ([`Cause::counted`])
    pub middle: Deviations,
    /// one standard deviation of each factor, at most [`Cause::COUNT`], and the cause that it is called after
    pub each: Vec<(Cause, Deviations)>,
    /// by how much the unit differs from its model beyond any cause
    pub discrepancy: Vec<Discrepancy>,
}

/// What a unit's healthy tests show that no constant of its model explains.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Discrepancy {
    /// of which feature
    pub feature: Feature,
    /// measured less model [unit of the feature]
    pub shift: f64,
    /// standard uncertainty of that at other faults
    pub uncertainty: f64,
}

impl Factors {
    /// What is known of a unit of a spread.
    ///
    /// * `known` causes and their deviations, relative where they are
    pub fn of(spread: &Spread, known: &[(Cause, f64)]) -> Self {
        let free = |c: &Cause| !known.iter().any(|(k, _)| k == c);
        let unknown: Vec<_> = spread.causes().filter(|(c, _)| free(c)).collect();
        let unknown: Vec<_> = unknown.into_iter().map(|(c, h)| (c, of_uniform(h))).collect();
        Self::independent(spread, &unknown, known)
    }

    /// Causes that have nothing to do with each other.
    ///
    /// * `spread` of which only the slope of friction over temperature is taken
    /// * `unknown` causes and their standard deviations
    /// * `known` causes and their deviations, relative where they are
    pub fn independent(spread: &Spread, unknown: &[(Cause, f64)], known: &[(Cause, f64)]) -> Self {
        let kelvin = known.iter().filter(|k| k.0 == Cause::TestTemperature);
        let kelvin: f64 = kelvin.map(|k| k.1).sum();
        let one = |&(cause, amount): &(Cause, f64)| {
            let mut row = [0.0; Cause::COUNT];
            for (through, per_unit) in cause.acts_through(spread.friction_per_k) {
                row[through as usize] += amount * per_unit;
            }
            if cause == Cause::FrictionSlope {
                let ends = [1.0, -1.0].map(|sign| spread.friction_at(kelvin, sign * amount).ln());
                for c in FRICTION {
                    row[c as usize] = 0.5 * (ends[0] - ends[1]);
                }
            }
            (cause, row)
        };
        Self {
            middle: together(spread, known),
            each: unknown.iter().map(one).collect(),
            discrepancy: Vec::new(),
        }
    }

    /// Shifts and variances of features by the discrepancy.
    pub fn discrepancies(&self, features: &[Feature]) -> (Row, Row) {
        let (mut shift, mut variance) = ([0.0; MOST], [0.0; MOST]);
        for (k, f) in features.iter().enumerate().take(MOST) {
            for d in self.discrepancy.iter().filter(|d| d.feature == *f) {
                shift[k] += d.shift;
                variance[k] += d.uncertainty * d.uncertainty;
            }
        }
        (shift, variance)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn prop_causes_that_multiply_are_counted_so_that_products_are_straight() {
        let mut spread = Spread::none();
        spread.half_width[Cause::DynamicRatio as usize] = 0.1;
        spread.half_width[Cause::HealthyFriction as usize] = 0.2;
        spread.half_width[Cause::RestAngle as usize] = 0.1;
        let mut draw = [0.0; Cause::COUNT];
        draw[Cause::DynamicRatio as usize] = -1.0;
        draw[Cause::HealthyFriction as usize] = 0.5;
        draw[Cause::RestAngle as usize] = 0.5;
        let x = deviations(&spread, &draw);
        let product = x[Cause::DynamicRatio as usize] + x[Cause::HealthyFriction as usize];
        assert!((product.exp() - 0.9 * 1.1).abs() < 1e-12);
        assert_eq!(x[Cause::RestAngle as usize], 0.05);
        let known = [
            (Cause::DynamicRatio, -0.1),
            (Cause::HealthyFriction, 0.1),
            (Cause::RestAngle, 0.05),
        ];
        assert_eq!(Factors::independent(&spread, &[], &known).middle, x);
        for c in Cause::ALL {
            assert!((c.of_counted(c.counted(0.07)) - 0.07).abs() < 1e-12);
        }
    }

    #[test]
    fn prop_a_known_temperature_leaves_the_slope_of_friction() {
        let mut spread = Spread::none();
        spread.half_width[Cause::TestTemperature as usize] = 60.0;
        spread.half_width[Cause::FrictionSlope as usize] = 0.2;
        spread.friction_per_k = -0.004;
        let friction = |f: &Factors, c: Cause| {
            let of = f.each.iter().find(|e| e.0 == c).map(|e| e.1);
            of.map(|x| FRICTION.map(|c| x[c as usize]))
        };
        let unknown = Factors::of(&spread, &[]);
        assert_eq!(unknown.middle, [0.0; Cause::COUNT]);
        let sd = -0.004 * 60.0 / 3f64.sqrt();
        let of_both = friction(&unknown, Cause::TestTemperature).unwrap();
        assert!(of_both.iter().all(|x| (x - sd).abs() < 1e-12), "{of_both:?}");
        assert_eq!(friction(&unknown, Cause::FrictionSlope), Some([0.0; 2]));
        let cold = Factors::of(&spread, &[(Cause::TestTemperature, -60.0)]);
        for c in FRICTION {
            assert!((cold.middle[c as usize] - 1.24f64.ln()).abs() < 1e-12);
        }
        assert_eq!(friction(&cold, Cause::TestTemperature), None);
        let left = friction(&cold, Cause::FrictionSlope).unwrap()[0];
        // a fifth of 24 % of 124 %, over sqrt(3)
        assert!((left - 0.2 * 0.24 / 1.24 / 3f64.sqrt()).abs() < 1e-4, "{left}");
    }
}
