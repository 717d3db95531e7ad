//! Physical effects that an actuator may have beyond the paper's: one name, its parameters, one
//! equation each. The same equation is driven by measured signals in the discrepancy study and
//! injected into the test bench and the simplified model.

mod equations;
mod kind;

pub use equations::{COPPER_PER_K, Constants, REFERENCE_TEMPERATURE_DEGC, Signals, conducting, shape};
pub use kind::{EffectKind, Equation, ParameterKey};

/// An effect with its parameters; SI units, motor side.
#[derive(Clone, Debug, PartialEq)]
pub struct Effect {
    pub kind: EffectKind,
    /// values of [`EffectKind::keys`], in their order
    pub values: [f64; 3],
    /// 95 % intervals of the values, where they were identified
    pub intervals: Option<[(f64, f64); 3]>,
    /// where the values come from, in words ("assumed", a data hash, a source)
    pub source: String,
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
            source: "assumed".into(),
        }
    }

    /// Name and value of each parameter.
    pub fn parameters(&self) -> impl Iterator<Item = (&'static ParameterKey, f64)> + '_ {
        self.kind.keys().iter().zip(self.values)
    }
}
