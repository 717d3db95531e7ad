//! How good failure maps are, and what would make them better.
//!
//! Five questions: does each map have the shape that inverting it needs (monotone, no plateaus, no
//! crossing curves); how much does it tell of each fault; can the maps together tell the faults apart;
//! is the grid fine enough; and which map, and which improvement, is worth most. Everything is computed
//! from the maps and their budgets, nothing is simulated anew.

mod isolability;
mod shape;
mod text;

#[cfg(test)]
mod tests;

use crate::diagnosis::Diagnoser;
use crate::failure_map::FailureMap;
use isolability::{Change, Local};
use schemas::feature::Feature;
use serde_json::{Value, json};

pub use isolability::{Cell, Ellipse, Remedy};
pub use shape::{Break, Convergence, Crossing, Crossings, MapShape, PerFault, Sensitivity, Steepness};

/// |correlation| of FSJ and zeta above which a cell does not tell them apart (assumed): the longer axis of
/// the scaled ellipse is then above six times the shorter one.
pub const MOST_CORRELATION: f64 = 0.95;

/// Share of the 95 % area by which an improvement must shrink it to be called a gain (assumed).
pub const LEAST_GAIN: f64 = 0.05;

/// Greatest interpolation error of a grid that is fine enough, in standard uncertainties of the
/// measurement (assumed): what limits is then the measurement.
pub const MOST_INTERPOLATION: f64 = 1.0;

/// Share of cells on a plateau, or share of the range of a break of monotony, from which on the text
/// points a map out (assumed).
pub const WORTH_NAMING: f64 = 0.01;

/// What one map is worth to all of them.
#[derive(Clone, Debug, PartialEq)]
pub struct Worth {
    /// whose map it is
    pub feature: Feature,
    /// median, over cells, of the 95 % area without it over that with it; infinite where the others cannot
    /// tell the faults apart; `None` for a map that is not inverted
    pub without: Option<f64>,
}

/// A possible improvement and what it would bring.
#[derive(Clone, Debug, PartialEq)]
pub struct Candidate {
    /// what is done
    pub remedy: Remedy,
    /// medians, over cells, of what is after it over what is now: 95 % area, sigma FSJ, sigma zeta
    pub area: f64,
    /// standard deviation of FSJ
    pub sigma_fsj: f64,
    /// standard deviation of zeta
    pub sigma_zeta: f64,
}

/// A report of map quality.
#[derive(Clone, Debug, PartialEq)]
pub struct MapQuality {
    /// of what: actuator, grid, spread
    pub title: String,
    /// how far the areas of the diagnosis reach in standard uncertainties, by quadrant
    pub reach: [f64; 4],
    /// one for each map
    pub shapes: Vec<MapShape>,
    /// one for each map
    pub sensitivity: Vec<Sensitivity>,
    /// features that are inverted together
    pub joint: Vec<Feature>,
    /// of the grid, zeta outer, FSJ inner
    cells: Vec<Cell>,
    columns: usize,
    /// one for each map
    pub convergence: Vec<Convergence>,
    /// one for each map
    pub worth: Vec<Worth>,
    /// best first
    pub candidates: Vec<Candidate>,
}

impl MapQuality {
    /// Judges the maps of a diagnoser, with its calibration and what it knows of the unit.
    pub fn of(diagnoser: &Diagnoser) -> Self {
        let maps: Vec<&FailureMap> = diagnoser.shown_maps().collect();
        let joint = diagnoser.joint_features().to_vec();
        let locals = Local::all(diagnoser);
        let now: Vec<Cell> = locals.iter().map(|l| l.cell(Change::Nothing)).collect();
        let worth = |f: Feature| Worth {
            feature: f,
            without: joint.iter().position(|j| *j == f).map(|k| {
                let changed = locals.iter().map(|l| l.cell(Change::Without(k)).ellipse);
                ratio(&now, changed, |e| e.area)
            }),
        };
        let mut candidates: Vec<Candidate> = Remedy::all(&joint, &locals)
            .into_iter()
            .map(|remedy| {
                let after: Vec<Option<Ellipse>> = locals.iter().map(|l| l.cell(Change::Made(remedy)).ellipse).collect();
                let of = |part: fn(&Ellipse) -> f64| ratio(&now, after.iter().copied(), part);
                Candidate {
                    remedy,
                    area: of(|e| e.area),
                    sigma_fsj: of(|e| e.sigma_fsj),
                    sigma_zeta: of(|e| e.sigma_zeta),
                }
            })
            .collect();
        // of equal ones the sooner named
        candidates.sort_by(|a, b| a.area.total_cmp(&b.area));
        let worth = maps.iter().map(|m| worth(m.feature)).collect();
        let h = &diagnoser.maps.header;
        let spread = match &diagnoser.calibration {
            Some(c) => format!("calibrated for spread `{}`", c.spread),
            None => "not calibrated".into(),
        };
        let first = maps
            .iter()
            .find(|m| m.feature == joint[0])
            .expect("a joint feature has a map");
        let (points, ends) = ((first.fsj.len(), first.zeta.len()), |x: &[f64]| (x[0], x[x.len() - 1]));
        let ((f0, f1), (z0, z1)) = (ends(&first.fsj), ends(&first.zeta));
        let grid = format!(
            "{} x {} points of FSJ {f0} to {f1} and zeta {z0} to {z1}",
            points.0, points.1
        );
        Self {
            title: format!(
                "{}, {} at {} Hz, {grid}, {spread}",
                h.actuator, h.sequence, h.kind.rate_hz
            ),
            reach: std::array::from_fn(|q| diagnoser.reach(q)),
            shapes: maps.iter().map(|m| MapShape::of(m)).collect(),
            sensitivity: maps.iter().map(|m| Sensitivity::of(diagnoser, m)).collect(),
            columns: points.0 - 1,
            joint,
            cells: now,
            convergence: maps.iter().map(|m| Convergence::of(diagnoser, m)).collect(),
            worth,
            candidates,
        }
    }

    /// Cells of the grid, zeta outer, FSJ inner: a heat map of [`Cell::sigma_fsj_percent`] or
    /// [`Cell::sigma_zeta`].
    pub fn cells(&self) -> &[Cell] {
        &self.cells
    }

    /// Cells along FSJ.
    pub fn columns(&self) -> usize {
        self.columns
    }

    /// Cells by the area of their ellipse, the smallest first; those without one last.
    pub fn by_area(&self) -> Vec<&Cell> {
        let mut sorted: Vec<&Cell> = self.cells.iter().collect();
        sorted.sort_by(|a, b| a.area().total_cmp(&b.area()));
        sorted
    }

    /// Cells that do not tell the faults apart.
    pub fn blind(&self) -> Vec<&Cell> {
        self.cells.iter().filter(|c| !c.isolates()).collect()
    }

    /// The improvement that would bring most, if any brings [`LEAST_GAIN`].
    pub fn best(&self) -> Option<&Candidate> {
        self.candidates.first().filter(|c| c.area <= 1.0 - LEAST_GAIN)
    }

    /// For a person, at most 110 columns.
    pub fn to_text(&self) -> String {
        text::text(self)
    }

    /// All of it; numbers that are infinite are null.
    pub fn to_json(&self) -> Value {
        let pair = |(a, b): (f64, f64)| json!([a, b]);
        let broken = |b: &Option<Break>| {
            b.as_ref()
                .map(|b| json!({"value": b.value, "share_of_range": b.share, "from": pair(b.from), "to": pair(b.to)}))
        };
        let shape = |s: &MapShape| {
            json!({
                "feature": s.feature.name(), "unit": s.feature.unit(), "range": pair(s.range),
                "measurement": s.measurement,
                "break": {"fsj": broken(&s.broken.fsj), "zeta": broken(&s.broken.zeta)},
                "plateau": {"fsj": s.plateau.fsj, "zeta": s.plateau.zeta},
                "crossings": s.crossings.count,
                "deepest_crossing": s.crossings.deepest.as_ref().map(|c| json!({
                    "depth": c.depth, "fsj": c.fsj, "zeta": pair(c.zeta)
                })),
            })
        };
        let steep = |s: &Steepness| {
            let at = |(place, own, u): &((f64, f64), f64, f64)| json!({"at": pair(*place), "own": own, "sigmas": u});
            json!({"middles": s.middles.iter().map(at).collect::<Vec<_>>(),
                "own_min_median_max": s.own, "sigmas_min_median_max": s.sigmas})
        };
        let sensitivity = |s: &Sensitivity| {
            json!({"feature": s.feature.name(), "unit": s.feature.unit(),
                "per_percent_fsj": steep(&s.steepness.fsj), "per_hundredth_zeta": steep(&s.steepness.zeta)})
        };
        let cell = |c: &Cell| {
            json!({"fsj": pair(c.fsj), "zeta": pair(c.zeta),
                "sigma_fsj_percent": c.sigma_fsj_percent(), "sigma_zeta": c.sigma_zeta(),
                "correlation": c.ellipse.map(|e| e.correlation), "area_95": c.area(), "isolates": c.isolates()})
        };
        let convergence = |c: &Convergence| {
            json!({"feature": c.feature.name(), "unit": c.feature.unit(), "measurement": c.measurement,
                "leave_one_out": c.fine, "leave_one_out_every_second": c.coarse, "ratio": c.ratio(),
                "interpolation": c.interpolation, "interpolation_twice_as_fine": c.finer,
                "of_whole": c.of_whole, "fine_enough": c.fine_enough(), "twice_as_fine_enough": c.finer_enough()})
        };
        let candidate = |c: &Candidate| {
            let what = c.remedy.title();
            json!({"what": what, "area": c.area, "sigma_fsj": c.sigma_fsj, "sigma_zeta": c.sigma_zeta})
        };
        let worth = |w: &Worth| json!({"feature": w.feature.name(), "area_without": w.without});
        json!({
            "title": self.title,
            "limits": {"correlation": MOST_CORRELATION, "interpolation": MOST_INTERPOLATION, "gain": LEAST_GAIN},
            "reach": self.reach,
            "maps": self.shapes.iter().map(shape).collect::<Vec<_>>(),
            "sensitivity": self.sensitivity.iter().map(sensitivity).collect::<Vec<_>>(),
            "joint_features": self.joint.iter().map(|f| f.name()).collect::<Vec<_>>(),
            "columns": self.columns,
            "cells": self.cells.iter().map(cell).collect::<Vec<_>>(),
            "convergence": self.convergence.iter().map(convergence).collect::<Vec<_>>(),
            "worth": self.worth.iter().map(worth).collect::<Vec<_>>(),
            "candidates": self.candidates.iter().map(candidate).collect::<Vec<_>>(),
        })
    }
}

/// Median, over the cells that have an ellipse now, of a part of the changed ellipse over that of today's.
fn ratio(now: &[Cell], changed: impl Iterator<Item = Option<Ellipse>>, part: fn(&Ellipse) -> f64) -> f64 {
    let ratios = now.iter().zip(changed).filter_map(|(n, c)| {
        let before = part(n.ellipse.as_ref()?);
        Some(c.map_or(f64::INFINITY, |c| part(&c) / before))
    });
    median(ratios.collect())
}

/// Not a number of nothing.
fn median(mut v: Vec<f64>) -> f64 {
    v.sort_by(f64::total_cmp);
    match v.len() {
        0 => f64::NAN,
        n if n % 2 == 1 => v[n / 2],
        n => 0.5 * (v[n / 2 - 1] + v[n / 2]),
    }
}
