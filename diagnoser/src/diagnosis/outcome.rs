//! What a diagnosis says.

use crate::calibration::COVERAGE;
use crate::paving::{Part, PavedBox, Paving};
use schemas::fault::Interval;
use schemas::feature::{Feature, Features};

/// The fault pairs that all maps agree on.
#[derive(Clone, Debug, PartialEq)]
pub struct Area {
    /// separated parts, the greatest first
    pub parts: Vec<Part>,
    /// boxes that cover the area
    pub boxes: Vec<PavedBox>,
    /// hull of all parts, guaranteed to hold the area
    pub fsj: Interval,
    /// the same along zeta
    pub zeta: Interval,
    /// centroid (FSJ, zeta)
    pub centroid: (f64, f64),
    /// area in FSJ times zeta: the mean of both enclosures
    pub size: f64,
    /// enclosed from within and from without
    pub inner: f64,
    /// the same from without
    pub outer: f64,
    /// half-width of the bands in standard uncertainties
    pub band: f64,
}

impl Area {
    /// * `band` half-width of the bands in standard uncertainties
    pub(super) fn of(p: Paving, band: f64) -> Self {
        Self {
            parts: p.parts,
            boxes: p.boxes,
            fsj: p.whole.fsj,
            zeta: p.whole.zeta,
            centroid: p.whole.centroid,
            size: 0.5 * (p.whole.inner + p.whole.outer),
            inner: p.whole.inner,
            outer: p.whole.outer,
            band,
        }
    }

    /// Share of the area's size that is not decided.
    pub fn tolerance(&self) -> f64 {
        if self.outer > 0.0 {
            (self.outer - self.inner) / self.outer
        } else {
            0.0
        }
    }
}

/// Result of a diagnosis. Not being able to locate a fault is a finding, not an error.
#[derive(Clone, Debug, PartialEq)]
pub enum Outcome {
    /// These pairs fit all maps, and no witness speaks against them.
    Located(Area),
    /// No fault pair explains the features; these maps contradict each other.
    Unexplained {
        /// maps that the others agree without, or witnesses
        contradicting: Vec<Feature>,
        /// in words, for people
        reason: String,
    },
    /// The faults lie beyond the maps; the reason says on which side.
    OutOfRange {
        /// which fault lies beyond which end, in words
        reason: String,
    },
    /// Something is missing; the area that the rest allows, if there is one.
    Incomplete {
        /// what is missing, in words
        reason: String,
        /// more features could make it smaller
        area: Option<Area>,
    },
}

/// A diagnosis: outcome and the features it stands on.
#[derive(Clone, Debug, PartialEq)]
pub struct Diagnosis {
    /// what was found
    pub outcome: Outcome,
    /// measured, over the maps' nominal run
    pub features: Features,
    /// share of tests whose true pair lies in the intervals, as calibrated or designed
    pub coverage: f64,
    /// whether the reach comes from a calibration; else it is assumed
    pub calibrated: bool,
    /// misfit of the best fault pair, and from which on a test is unexplained
    pub misfit: Option<(f64, f64)>,
    /// of a located test, where units differ in it: dynamic friction over that of the healthy model
    pub kinetic: Option<Kinetic>,
}

/// The kinetic factor of a test: FSJ times by how much the unit's own dynamic friction differs from the model's. A single
/// test knows it better than FSJ.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Kinetic {
    /// with the coverage of the diagnosis
    pub interval: Interval,
    /// most probable value
    pub estimate: f64,
}

impl Diagnosis {
    /// A diagnosis that maps had no part in.
    pub fn without_maps(outcome: Outcome, features: Features) -> Self {
        Self {
            outcome,
            features,
            coverage: COVERAGE,
            calibrated: false,
            misfit: None,
            kinetic: None,
        }
    }
}

impl Outcome {
    /// As in files and messages (schemas/README.md): located, unexplained, out_of_range, incomplete.
    pub fn name(&self) -> &'static str {
        match self {
            Outcome::Located(_) => "located",
            Outcome::Unexplained { .. } => "unexplained",
            Outcome::OutOfRange { .. } => "out_of_range",
            Outcome::Incomplete { .. } => "incomplete",
        }
    }

    /// The area of possible pairs, where there is one.
    pub fn area(&self) -> Option<&Area> {
        match self {
            Outcome::Located(a) => Some(a),
            Outcome::Incomplete { area, .. } => area.as_ref(),
            _ => None,
        }
    }

    /// Why there is no located area, in words; empty where there is one.
    pub fn reason(&self) -> &str {
        match self {
            Outcome::Located(_) => "",
            Outcome::Unexplained { reason, .. }
            | Outcome::OutOfRange { reason }
            | Outcome::Incomplete { reason, .. } => reason,
        }
    }
}
