//! How well diagnoses hold what they promise: fresh simulated tests, none of which maps or calibration
//! have seen.

pub mod circle;
pub mod defects;
pub mod other_hand;
pub mod record;
pub mod temperature;
pub mod units;
pub mod yardstick;

use anyhow::{Context, Result};
use diagnoser::diagnosis::{COVERAGE, Diagnoser, Diagnosis, Outcome};
use diagnoser::failure_map::FailureMapSet;
use pipeline::calibrate::{Campaign, Unit, draw_units, kinetic_factor, measure};
use pipeline::maps::{MapRequest, made};
use schemas::feature::{Feature, RawFeatures};
use sim_worker::catalogue;
use sim_worker::parameters::ActuatorParameters;
use sim_worker::setup::TestSetup;
use sim_worker::spread::Spread;
use std::path::Path;
use std::sync::Arc;

/// Fault range of the paper.
pub const FSJ: (f64, f64) = (1.0, 5.0);
pub const ZETA: (f64, f64) = (0.0, 0.5);

/// Maps of the reference actuator through the reference sensors, at a rest angle.
pub fn reference_maps(dir: &Path, grid: &str, rest_angle_rad: f64) -> Result<(FailureMapSet, TestSetup)> {
    maps_of(dir, "preflight", grid, rest_angle_rad)
}

/// The same of another sequence.
pub fn maps_of(dir: &Path, sequence: &str, grid: &str, rest_angle_rad: f64) -> Result<(FailureMapSet, TestSetup)> {
    let actuator = Arc::new(ActuatorParameters::reference());
    let setup = TestSetup {
        sensors: catalogue::sensors("reference")?,
        rest_angle_rad,
        ..TestSetup::new(actuator, catalogue::sequence(sequence)?, 1e4)
    };
    let grid = catalogue::grid(grid)?;
    let request = MapRequest { setup, grid };
    Ok((made(dir, &request)?, request.setup))
}

/// The same maps without those of some features.
pub fn only(set: &FailureMapSet, features: &[Feature]) -> FailureMapSet {
    let mut set = set.clone();
    set.maps.retain(|m| features.contains(&m.feature));
    set
}

/// What became of one test.
#[derive(Clone, Debug)]
pub struct Case {
    pub fsj: f64,
    pub zeta: f64,
    pub outcome: &'static str,
    /// the true pair lies in both intervals
    pub inside: bool,
    /// widths and errors (FSJ, zeta) where it was located
    pub found: Option<((f64, f64), (f64, f64))>,
    pub parts: usize,
    /// relative width of the kinetic factor's interval, and whether it holds the true one
    pub kinetic: Option<(f64, bool)>,
    pub contradicting: Vec<Feature>,
}

impl Case {
    /// A diagnosis beside the truth.
    ///
    /// * `spread` that the unit was drawn from
    fn of(spread: &Spread, u: &Unit, d: Diagnosis) -> Self {
        let (fsj, zeta) = (u.fault.fsj, u.fault.zeta);
        let area = d.outcome.area();
        Self {
            fsj,
            zeta,
            outcome: d.outcome.name(),
            inside: area.is_some_and(|a| a.fsj.contains(fsj) && a.zeta.contains(zeta)),
            found: area.map(|a| {
                let width = (a.fsj.width(), a.zeta.width());
                (width, (a.centroid.0 - fsj, a.centroid.1 - zeta))
            }),
            kinetic: d.kinetic.map(|k| {
                let truth = kinetic_factor(spread, u);
                (k.interval.width() / truth, k.interval.contains(truth))
            }),
            parts: area.map_or(0, |a| a.parts.len()),
            contradicting: match d.outcome {
                Outcome::Unexplained { contradicting, .. } => contradicting,
                _ => Vec::new(),
            },
        }
    }
}

/// Diagnoses measured tests.
pub fn judge(diagnoser: &Diagnoser, units: &[Unit], measured: &[RawFeatures]) -> Vec<Case> {
    let spread = diagnoser.calibration.as_ref().map_or_else(Spread::none, |c| c.spread());
    let one =
        |(u, raw): (&Unit, &RawFeatures)| Case::of(&spread, u, diagnoser.diagnose(&diagnoser.maps.features(raw), &[]));
    units.iter().zip(measured).map(one).collect()
}

/// Fresh tests of random units.
pub fn fresh(setup: &TestSetup, spread: &Spread, n: usize, seed: u64) -> Result<(Vec<Unit>, Vec<RawFeatures>)> {
    // far from every seed that a calibration draws from
    let units = draw_units(FSJ, ZETA, spread, n, 0xF4E5_8000_0000_0000 ^ seed);
    let measured = measure(setup, spread, &units, "fresh tests")?.context("interrupted")?;
    Ok((units, measured))
}

/// Maps with the calibration of a campaign.
pub fn calibrated(set: &FailureMapSet, campaign: &Campaign) -> Result<Diagnoser> {
    let calibration = campaign.calibrate(set)?;
    Ok(Diagnoser::new(set.clone(), Some(calibration), COVERAGE, &Vec::new())?)
}

/// Share of cases in percent, with its 95 % Wilson bounds.
pub fn percent(k: usize, n: usize) -> String {
    if n == 0 {
        return "-".into();
    }
    let (p, n, z) = (k as f64 / n as f64, n as f64, 1.96_f64);
    let middle = (p + z * z / (2.0 * n)) / (1.0 + z * z / n);
    let half = z / (1.0 + z * z / n) * (p * (1.0 - p) / n + z * z / (4.0 * n * n)).sqrt();
    format!(
        "{:.1} [{:.1}, {:.1}]",
        100.0 * p,
        100.0 * (middle - half).max(0.0),
        100.0 * (middle + half)
    )
}

/// Quantile of unsorted numbers, NaN of none.
pub fn quantile(values: impl IntoIterator<Item = f64>, q: f64) -> f64 {
    let mut v: Vec<f64> = values.into_iter().collect();
    v.sort_by(f64::total_cmp);
    let k = (v.len().saturating_sub(1) as f64 * q).round() as usize;
    v.get(k).copied().unwrap_or(f64::NAN)
}

/// Quadrant of the fault range: FSJ above the middle + 2 x zeta above the middle.
pub fn quadrant(c: &Case) -> usize {
    usize::from(c.fsj > 3.0) + 2 * usize::from(c.zeta > 0.25)
}
