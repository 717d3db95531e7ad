//! Faults, their grid, and intervals of them.

use crate::fingerprint::{exact, fingerprint};
use crate::toml_section::quoted;

/// A pair of faults: friction multiplier FSJ and static eccentricity zeta (paper 2.1, 2.2, 4).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FaultState {
    /// Factor on the nominal dry friction [-], 1 to 5 in the paper.
    pub fsj: f64,
    /// Static eccentricity over air gap (Eq. 3) [-], 0 to 0.5 in the paper.
    pub zeta: f64,
}

impl FaultState {
    /// The healthy actuator.
    pub const NOMINAL: Self = Self { fsj: 1.0, zeta: 0.0 };

    /// The pair, or the place, value and allowed range of the first value that physics forbids.
    ///
    /// # Errors
    /// A friction factor that is negative or not finite, an eccentricity outside `0 <= zeta < 1`.
    pub fn new(fsj: f64, zeta: f64) -> Result<Self, (&'static str, f64, &'static str)> {
        if !(fsj.is_finite() && fsj >= 0.0) {
            return Err((
                "fsj",
                fsj,
                "a finite friction factor of at least 0 (the paper uses 1 to 5)",
            ));
        }
        if !(0.0..1.0).contains(&zeta) {
            return Err(("zeta", zeta, "0 <= zeta < 1 (the paper uses 0 to 0.5)"));
        }
        Ok(Self { fsj, zeta })
    }
}

/// Grid of fault pairs: every FSJ with every zeta.
#[derive(Clone, Debug, PartialEq)]
pub struct FaultGrid {
    /// for messages and tables; does not enter the fingerprint
    pub name: String,
    /// strictly rising [-]
    pub fsj: Vec<f64>,
    /// strictly rising [-]
    pub zeta: Vec<f64>,
}

impl FaultGrid {
    /// `points` equally spaced values from `from` to `to`.
    pub fn axis(from: f64, to: f64, points: usize) -> Vec<f64> {
        let step = (to - from) / (points.max(2) - 1) as f64;
        // rounded to 1e-12 so that 1.2 is 1.2 and not 1.2000000000000002
        (0..points)
            .map(|i| ((from + i as f64 * step) * 1e12).round() / 1e12)
            .collect()
    }

    /// Of the values, not of the name.
    pub fn fingerprint(&self) -> String {
        let list = |v: &[f64]| v.iter().map(|&x| exact(x)).collect::<Vec<_>>().join(",");
        fingerprint(&format!("grid;{};{}", list(&self.fsj), list(&self.zeta)))
    }

    /// A file that reads back as this grid, bit for bit.
    pub fn to_toml(&self) -> String {
        format!(
            "name = {}\nfsj = {:?}\nzeta = {:?}\n",
            quoted(&self.name),
            self.fsj,
            self.zeta
        )
    }

    /// Points in storage order: zeta outer, FSJ inner.
    pub fn points(&self) -> Vec<FaultState> {
        self.zeta
            .iter()
            .flat_map(|&zeta| self.fsj.iter().map(move |&fsj| FaultState { fsj, zeta }))
            .collect()
    }
}

/// Closed interval, in the unit of what it is of.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Interval {
    /// lower bound, included
    pub lo: f64,
    /// upper bound, included
    pub hi: f64,
}

impl Interval {
    /// `hi - lo`, in the unit of the bounds.
    pub fn width(self) -> f64 {
        self.hi - self.lo
    }
    /// Whether `lo <= x <= hi`; no interval holds NaN.
    pub fn contains(self, x: f64) -> bool {
        self.lo <= x && x <= self.hi
    }
    /// The common part, if any.
    pub fn meet(self, other: Self) -> Option<Self> {
        let r = Self {
            lo: self.lo.max(other.lo),
            hi: self.hi.min(other.hi),
        };
        (r.lo <= r.hi).then_some(r)
    }
    /// The smallest interval around both.
    pub fn join(self, other: Self) -> Self {
        Self {
            lo: self.lo.min(other.lo),
            hi: self.hi.max(other.hi),
        }
    }
}
