//! Physical effects that an actuator may have beyond the paper's: one name, its parameters, one
//! equation each. The same equation is driven by measured signals in the discrepancy study and
//! injected into the test bench and the simplified model.

mod equations;
mod file;
mod inject;
mod kind;
mod law;
mod over_lanes;
mod state;
#[cfg(test)]
mod tests;
#[cfg(test)]
mod tests_physics;

use nalgebra::DMatrix;

pub use equations::{
    COPPER_PER_K, Constants, REFERENCE_TEMPERATURE_DEGC, Signals, commutation_share, conducting, flux, flux_left, shape,
};
pub use file::{MOST, read};
pub use inject::Injection;
pub use kind::{EffectKind, Equation, ParameterKey};
pub use law::{Law, LawKey, PHASES, SOURCES};
pub use over_lanes::{Felt, LaneEffects};
pub use state::{Dahl, DelayLine, Play, TwoMass};

/// Standard deviations from the middle to either end of the intervals of identified values: 95 % of a normal distribution.
pub const NORMAL_95: f64 = 1.96;

/// An entry of an effect's provenance.
#[derive(Clone, Debug, PartialEq)]
pub enum Note {
    /// a text, for example a data hash
    Text(String),
    /// a number, for example a score
    Number(f64),
}

/// An effect with its parameters; SI units, motor side.
#[derive(Clone, Debug, PartialEq)]
pub struct Effect {
    /// which equation
    pub kind: EffectKind,
    /// values of [`EffectKind::keys`], in their order
    pub values: [f64; 3],
    /// 95 % intervals of the values, where they were identified; (0, 0) beyond the last key
    pub intervals: Option<[(f64, f64); 3]>,
    /// correlations of the values with each other: first and second, first and third, second and third
    pub correlation: Option<[f64; 3]>,
    /// where the values come from, in words ("assumed", a data hash, a source)
    pub source: String,
    /// share of the amplitude that grows with the friction fault: times `1 + grows (FSJ - 1)`. 0 but for levels of
    /// friction ([`EffectKind::is_friction`]), of which nobody knows without a worn unit
    pub grows: f64,
    /// which law of its kind it follows
    pub law: Law,
    /// fingerprint of the actuator to which the effect was added
    pub parent: Option<String>,
    /// how it was identified: data, runs, score, runner-up ...; keys in the order of the alphabet
    pub provenance: Vec<(String, Note)>,
}

impl Effect {
    /// * `values` in the order of [`EffectKind::keys`]
    pub fn new(kind: EffectKind, values: &[f64]) -> Self {
        let mut all = [0.0; 3];
        all[..values.len()].copy_from_slice(values);
        Self {
            kind,
            values: all,
            intervals: None,
            correlation: None,
            source: "assumed".into(),
            grows: 0.0,
            law: Law::First,
            parent: None,
            provenance: Vec::new(),
        }
    }

    /// By another law of its kind.
    #[must_use]
    pub fn by(mut self, law: Law) -> Self {
        self.law = law;
        self
    }

    /// Key and name of its law, where it is not the first of the kind.
    pub fn said_law(&self) -> Option<(&'static str, &'static str)> {
        let key = self.kind.law_key().filter(|_| self.law != Law::First)?;
        Some((key.name, key.of(self.law)?))
    }

    /// The phase whose sensor has it, where somebody says (0, 1, 2).
    pub fn sensor(&self) -> Option<usize> {
        match self.law {
            Law::Phase(q) => Some(q),
            _ => None,
        }
    }

    /// Name and value of each parameter.
    pub fn parameters(&self) -> impl Iterator<Item = (&'static ParameterKey, f64)> + '_ {
        self.kind.keys().iter().zip(self.values)
    }

    /// Moves its amplitude, or all its other values, by so many standard deviations of what identified it, within the
    /// bounds of the kind; nothing where it was not identified. Where the correlations of the values are known it is the
    /// first of their principal components that moves as the amplitude, the second as the others.
    pub fn deviate(&mut self, amplitude: bool, sigmas: f64) {
        let Some(intervals) = self.intervals else { return };
        let directions = self.directions();
        for (i, key) in self.kind.keys().iter().enumerate() {
            let sd = (intervals[i].1 - intervals[i].0) / (2.0 * NORMAL_95);
            let share = directions[usize::from(!amplitude)][i];
            if sd.is_finite() && share != 0.0 {
                self.values[i] = (self.values[i] + sigmas * share * sd).clamp(key.low, key.high);
            }
        }
    }

    /// How far a standard deviation along each of the two directions of [`Effect::deviate`] moves the values, in their
    /// standard deviations.
    fn directions(&self) -> [[f64; 3]; 2] {
        let apart = [[1.0, 0.0, 0.0], [0.0, 1.0, 1.0]];
        let n = self.kind.keys().len();
        let Some(r) = self.correlation.filter(|_| n > 1) else {
            return apart;
        };
        let at = |i: usize, k: usize| if i == k { 1.0 } else { r[i + k - 1] };
        let eigen = DMatrix::from_fn(n, n, at).symmetric_eigen();
        let mut order: Vec<usize> = (0..n).collect();
        order.sort_by(|a, b| eigen.eigenvalues[*b].total_cmp(&eigen.eigenvalues[*a]));
        let direction = |k: usize| -> [f64; 3] {
            let v = eigen.eigenvectors.column(order[k]);
            let sign = if v[v.iamax()] < 0.0 { -1.0 } else { 1.0 };
            let length = sign * eigen.eigenvalues[order[k]].max(0.0).sqrt();
            std::array::from_fn(|i| if i < n { length * v[i] } else { 0.0 })
        };
        [direction(0), direction(1)]
    }

    /// The effect at a friction fault.
    #[must_use]
    pub fn worn(&self, fsj: f64) -> Self {
        let mut e = self.clone();
        if self.grows != 0.0 {
            e.values[0] *= 1.0 + self.grows * (fsj - 1.0);
        }
        e
    }

    /// Whether it changes anything.
    pub fn is_present(&self) -> bool {
        match self.kind {
            EffectKind::Presliding => true,
            EffectKind::Compliance => self.values[2] != 0.0,
            _ => self.values[0] != 0.0,
        }
    }
}
