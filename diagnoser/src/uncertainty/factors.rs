//! What is known of a unit's causes.

use super::{MOST, Row};
use schemas::feature::Feature;
use sim_worker::spread::{Cause, Spread};

/// Deviations of a unit by what acts by itself ([`Cause::acts_through`]), as they are counted ([`Cause::counted`]).
pub type Deviations = [f64; Cause::COUNT];

/// What causes deviate by together, by what they act through.
///
/// * `each` causes and their deviations, relative where they are
fn together(each: impl IntoIterator<Item = (Cause, f64)>) -> Deviations {
    let mut x = [0.0; Cause::COUNT];
    for (cause, amount) in each {
        for (through, per_unit) in cause.acts_through() {
            x[through as usize] += through.counted(amount * per_unit);
        }
    }
    x
}

/// What the causes of a spread deviate by together, where each lies at `draw` (-1 to 1) of its half-width.
pub fn deviations(spread: &Spread, draw: &[f64; Cause::COUNT]) -> Deviations {
    together(spread.causes().map(|(c, h)| (c, draw[c as usize] * h)))
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
    /// Causes that have nothing to do with each other.
    ///
    /// * `unknown` causes and their standard deviations
    /// * `known` causes and their deviations, relative where they are
    pub fn independent(unknown: &[(Cause, f64)], known: &[(Cause, f64)]) -> Self {
        let one = |&(cause, amount): &(Cause, f64)| {
            let mut row = [0.0; Cause::COUNT];
            for (through, per_unit) in cause.acts_through() {
                row[through as usize] += amount * per_unit;
            }
            (cause, row)
        };
        Self {
            middle: together(known.iter().copied()),
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
        assert_eq!(Factors::independent(&[], &known).middle, x);
        for c in Cause::ALL {
            assert!((c.of_counted(c.counted(0.07)) - 0.07).abs() < 1e-12);
        }
    }
}
