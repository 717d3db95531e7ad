//! Calibrated bands: how far an area must reach so that it holds the stated share of true pairs.
//!
//! Split conformal prediction (Papadopoulos et al. 2002; Vovk 2012): simulated tests at random faults, none
//! of which the maps are made of, are diagnosed. The score of a test is the smallest reach at which the
//! reported intervals hold its true pair. The reach for a coverage is an order statistic of the scores,
//! taken so high that the coverage holds, with a confidence of 80 %, whatever the distribution. Tests are grouped
//! by the quadrant of the fault range that the estimate lies in, or, where they are many, by strips of its FSJ (Mondrian), so
//! that no part of the range pays for another.

use crate::seal;
use crate::uncertainty::ResponseSurfaces;
use schemas::error::{Error, Result, write_whole};
use serde::{Deserialize, Serialize};
use sim_worker::spread::{Cause, Spread};
use std::path::Path;

/// Coverage that is reported unless another one is asked for.
pub const COVERAGE: f64 = 0.95;

/// Probability, over the draws of the campaign, with which the stated coverage is reached.
const CONFIDENCE: f64 = 0.8;

/// Share of the campaign's tests that are refused as unexplained although nothing is wrong with them.
const REFUSED: f64 = 0.005;

/// Fewest tests of a group of its own: with fewer, the confidence costs more width than the group saves.
const FEWEST: usize = 200;

/// Tests of a strip of FSJ, at least, and how many strips there are (assumed).
const STRIP: usize = 400;
const LEAST_STRIPS: usize = 5;
const MOST_STRIPS: usize = 8;

/// Reach of uncalibrated areas for 95 % in standard deviations, and what their misfit may be: two Gaussian
/// parameters would need 2.45 (assumed).
const UNCALIBRATED: (f64, f64) = (3.0, 40.0);

/// Score of a test that is called unexplained: no reach makes up for it.
pub const REFUSED_SCORE: f64 = 1e9;

/// Greatest deviation of a witness without calibration, in standard uncertainties (assumed).
pub const WITNESS_GATE: f64 = 5.0;

/// What a campaign of simulated tests found.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Calibration {
    /// name and half-widths of the spread from unit to unit
    pub spread: String,
    /// half-width of each cause's uniform distribution, in the units of [`Spread::half_width`]
    #[serde(deserialize_with = "crate::uncertainty::padded")]
    pub half_width: [f64; Cause::COUNT],
    /// as [`Spread::friction_per_k`]
    #[serde(default)]
    pub friction_per_k: f64,
    /// runs that the scores come from
    pub runs: usize,
    /// further runs that the response surfaces come from
    pub surface_runs: usize,
    /// of the units drawn and of their sensor noise
    pub seed: u64,
    /// parameters of the actuator and rest angle of the maps that it belongs to
    pub maps: String,
    /// source revision of the program that made it
    pub commit: String,
    /// scores by quadrant (FSJ above the middle + 2 x zeta above the middle), rising; `REFUSED_SCORE` of tests
    /// that are called unexplained
    pub scores: [Vec<f64>; 4],
    /// misfits of all tests, rising
    pub misfits: Vec<f64>,
    /// greatest deviation of a witness in each test, in standard uncertainties, rising
    pub deviations: Vec<f64>,
    /// scores by strips of the estimate's FSJ, where tests are many: upper end of each strip, rising, and its scores, rising.
    /// They stand in for those by quadrant
    #[serde(default)]
    pub strips: Vec<(f64, Vec<f64>)>,
    /// how far the kinetic factor of each test lies from its estimate, in standard uncertainties, rising; none where units
    /// do not differ in it
    #[serde(default)]
    pub kinetic: Vec<f64>,
    /// response of the features to the causes; none without spread
    pub surfaces: Option<ResponseSurfaces>,
}

impl Calibration {
    /// The spread from unit to unit that it allows for.
    pub fn spread(&self) -> Spread {
        Spread {
            name: self.spread.clone(),
            half_width: self.half_width,
            friction_per_k: self.friction_per_k,
        }
    }

    /// Fills the scores by strips, where there are tests enough.
    ///
    /// * `tests` FSJ of the estimate, and score
    pub fn in_strips(&mut self, mut tests: Vec<(f64, f64)>) {
        let strips = (tests.len() / STRIP).min(MOST_STRIPS);
        self.strips.clear();
        if strips < LEAST_STRIPS {
            return;
        }
        tests.sort_by(|a, b| a.0.total_cmp(&b.0));
        for part in tests.chunks(tests.len().div_ceil(strips)) {
            let mut scores: Vec<f64> = part.iter().map(|t| t.1).collect();
            scores.sort_by(f64::total_cmp);
            self.strips.push((part[part.len() - 1].0, scores));
        }
    }

    /// How far an area reaches for a coverage, in standard deviations: upper end of each strip of the estimate's FSJ, and
    /// the reach there; none where there are no strips.
    pub fn reaches(&self, coverage: f64) -> Vec<(f64, f64)> {
        let of = |(end, scores): &(f64, Vec<f64>)| (*end, Self::reach_of(scores, coverage));
        self.strips.iter().map(of).collect()
    }

    /// How far an area reaches for a coverage, in standard deviations, where there are no strips.
    ///
    /// * `quadrant` of the estimate
    pub fn reach(&self, coverage: f64, quadrant: usize) -> f64 {
        let own = &self.scores[quadrant];
        let pooled;
        let scores = if own.len() >= FEWEST {
            own
        } else {
            let mut all = self.scores.concat();
            all.sort_by(f64::total_cmp);
            pooled = all;
            &pooled
        };
        Self::reach_of(scores, coverage)
    }

    fn reach_of(scores: &[f64], coverage: f64) -> f64 {
        let reach = quantile(scores, coverage);
        if reach < REFUSED_SCORE {
            return reach;
        }
        // more is asked for than tests are explained: as far as any of them reaches
        let explained = scores.iter().rev().find(|s| **s < REFUSED_SCORE);
        explained.copied().unwrap_or(UNCALIBRATED.0)
    }

    /// How far the interval of the kinetic factor reaches for a coverage, in standard uncertainties; none without scores.
    pub fn kinetic_reach(&self, coverage: f64) -> Option<f64> {
        (!self.kinetic.is_empty()).then(|| quantile(&self.kinetic, coverage))
    }

    /// Greatest misfit that is not called unexplained.
    pub fn gate(&self) -> f64 {
        quantile(&self.misfits, 1.0 - REFUSED)
    }

    /// Greatest deviation of a witness that is not called unexplained, in standard uncertainties.
    pub fn witness_gate(&self) -> f64 {
        if self.deviations.is_empty() {
            return WITNESS_GATE;
        }
        quantile(&self.deviations, 1.0 - REFUSED)
    }

    /// File of the calibration for a spread beside maps.
    pub fn file_name(spread: &str) -> String {
        format!("calibration-{spread}.json")
    }

    /// Writes it as one JSON object, whole or not at all.
    ///
    /// # Errors
    /// Fails where the file cannot be written.
    pub fn save(&self, path: &Path) -> Result<()> {
        let text = serde_json::to_string(self).expect("plain data");
        write_whole(path, seal::sealed(&text).as_bytes())
    }

    /// Reads a saved one.
    ///
    /// * `maps` fingerprint of the maps that it must belong to
    ///
    /// # Errors
    /// Refuses where the file cannot be read, is torn or changed, or belongs to other maps.
    pub fn load(path: &Path, maps: &str) -> Result<Self> {
        let text = std::fs::read_to_string(path).map_err(|e| Error::io(path, "cannot be read", e))?;
        let mut value: serde_json::Value = serde_json::from_str(&text).map_err(|e| Error::torn(path, e))?;
        // of a program that knew fewer causes: the others did not differ
        let pad = |list: &mut serde_json::Value, zero: &serde_json::Value| {
            if let Some(list) = list
                .as_array_mut()
                .filter(|l| l.len() >= Cause::FIRST && l.len() < Cause::COUNT)
            {
                list.resize(Cause::COUNT, zero.clone());
            }
        };
        if let Some(half_width) = value.get_mut("half_width") {
            pad(half_width, &serde_json::json!(0.0));
        }
        let slopes = value.pointer_mut("/surfaces/slopes").and_then(|s| s.as_object_mut());
        for rows in slopes.into_iter().flat_map(|s| s.values_mut()) {
            let terms = rows.get(0).and_then(|r| r.as_array()).map_or(0, Vec::len);
            pad(rows, &serde_json::json!(vec![0.0; terms]));
        }
        let c: Self = serde_json::from_value(value).map_err(|e| Error::torn(path, e))?;
        let file = path.display().to_string();
        if c.maps != maps {
            let allowed = format!("{maps}: calibrate these maps (ema calibrate)");
            return Err(Error::bad(file, "fingerprint of the maps", &c.maps, allowed));
        }
        let rising = |v: &[f64]| v.iter().all(|x| x.is_finite()) && v.is_sorted();
        if c.misfits.is_empty() || !c.scores.iter().all(|v| rising(v)) || !rising(&c.misfits) || !rising(&c.deviations)
        {
            return Err(Error::bad(
                file,
                "scores",
                "not rising numbers",
                "a file written by ema calibrate",
            ));
        }
        seal::check_if_sealed(path, &text, "ema calibrate")?;
        Ok(c)
    }
}

/// How far areas reach, and from what misfit on a test is unexplained, of maps that have no
/// calibration; the reach for other coverages as two Gaussian parameters have it.
pub fn uncalibrated(coverage: f64) -> (f64, f64) {
    let gaussian = |c: f64| (-2.0 * (1.0 - c).ln()).sqrt();
    (UNCALIBRATED.0 * gaussian(coverage) / gaussian(COVERAGE), UNCALIBRATED.1)
}

/// The order statistic of rising `scores` that covers a share with [`CONFIDENCE`]: the smallest rank r such
/// that fewer than r of n fall below the true quantile with that probability (binomial; Vovk 2012). The
/// greatest score where there are too few.
fn quantile(scores: &[f64], share: f64) -> f64 {
    let n = scores.len();
    if n == 0 {
        return f64::INFINITY;
    }
    let mean = share * n as f64;
    let start = (mean - 8.0 * (mean * (1.0 - share)).sqrt()).max(0.0) as usize;
    // probability that exactly k of n lie below the quantile, summed until the confidence is reached
    let choose: f64 = (1..=start).map(|i| ((n - start + i) as f64 / i as f64).ln()).sum();
    let mut p = (choose + start as f64 * share.ln() + (n - start) as f64 * (1.0 - share).ln()).exp();
    let mut sum = 0.0;
    for k in start..n {
        sum += p;
        if sum >= CONFIDENCE {
            return scores[k];
        }
        p *= (n - k) as f64 / (k + 1) as f64 * share / (1.0 - share);
    }
    scores.last().copied().unwrap_or(f64::INFINITY)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn val_order_statistics_are_those_of_the_binomial_distribution() {
        // rank r with P(Binomial(n, 0.95) <= r - 1) >= 0.8; from a table of the distribution
        let rank = |n: usize| quantile(&(1..=n).map(|k| k as f64).collect::<Vec<_>>(), 0.95) as usize;
        // n = 100: P(X <= 96) = 0.7422, P(X <= 97) = 0.8817
        assert_eq!(rank(100), 98);
        // n = 20: P(X <= 19) = 0.6415, no rank suffices: the greatest
        assert_eq!(rank(20), 20);
        // large n: the share itself and 0.84 standard deviations
        let n = 2000;
        let expected = 0.95 * n as f64 + 0.84 * (0.95 * 0.05 * n as f64).sqrt();
        assert!((rank(n) as f64 - expected).abs() <= 2.0, "{}", rank(n));
    }

    #[test]
    fn prop_coverage_of_fresh_scores_is_the_stated_one() {
        // scores spread evenly over 0 to 1: the quantile is the coverage
        let mut state = 1u64;
        let mut draw = || {
            state = state
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1_442_695_040_888_963_407);
            (state >> 11) as f64 / (1u64 << 53) as f64
        };
        let trials = 400;
        let mut reached = 0;
        for _ in 0..trials {
            let mut scores: Vec<f64> = (0..300).map(|_| draw()).collect();
            scores.sort_by(f64::total_cmp);
            reached += usize::from(quantile(&scores, 0.9) >= 0.9);
        }
        let share = reached as f64 / trials as f64;
        assert!((0.76..0.90).contains(&share), "{share}");
    }
}
