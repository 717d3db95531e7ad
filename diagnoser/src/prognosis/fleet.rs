//! What a fleet teaches: a prior, lives to compare with, shares of the forecasts, and where past truths lay within them.

use super::filter::Filter;
use super::forecast::{Changes, Horizon, forecast, quantile};
use super::past::{self, FORECASTS, Look, Past, alike, distances, places, rounded, weights};
use super::prior::{MODELS, Model, Prior};
use super::similar::{Kernel, Life, Likeness, similar};
use super::special::evenly;
use super::track::Track;
use serde::{Deserialize, Serialize};

/// Bands of the damage seen [share of U]: what is known at the time, so that what is learned by them may be promised.
const BANDS: [f64; 2] = [0.15, 0.45];
const N_BANDS: usize = 3;

/// Finished lives from which intervals are calibrated.
pub const CALIBRATED: usize = 20;
/// Finished lives from which lives are compared with.
pub const COMPARED: usize = 10;
/// Share of lives that may be longer than any that ended: beyond it those that ended are the short ones, and a fleet teaches its prior
/// alone (assumed; two thirds unseen cost a quarter of the coverage).
pub const MOST_UNSEEN: f64 = 0.1;

/// Whether so many finished lives, with such a share unseen, may be compared with: those that ended say nothing of lives that are longer
/// than all of them.
pub fn is_compared(lives: usize, unseen: f64) -> bool {
    lives >= COMPARED && unseen <= MOST_UNSEEN
}

/// Changes of regime in a usual life that forecasts reckon with: of the three forecasts that a fleet weighs (assumed).
const SELDOM: Changes = Changes::even(0.5);
const OFTEN: Changes = Changes::even(2.5);
const SOON: Changes = Changes::even(8.0);

/// Worn units lived on for longer than was foretold of them without a fleet: the share p of a forecast is told as p to this
/// power (by simulated lives; assumed for others).
const CALMER: f64 = 0.85;

/// Samples of a forecast.
const SAMPLES: usize = 400;

/// A forecast looks so many usual lives ahead; later is never.
const LIVES_AHEAD: f64 = 10.0;

/// Masses that may lie below the lower and below the upper end of an interval.
const TAILS: [f64; 5] = [0.05, 0.04, 0.03, 0.02, 0.01];
const UPPERS: [f64; 16] = [
    0.8, 0.82, 0.84, 0.86, 0.88, 0.9, 0.91, 0.92, 0.93, 0.94, 0.95, 0.96, 0.97, 0.98, 0.99, 1.0,
];

/// Coverage of intervals of the time left.
pub const COVERAGE: f64 = 0.9;

/// What choosing shares and ends on the same lives costs: an interval is taken for so much more, over the number of lives, and
/// for so much at most (assumed).
const CHOSEN: f64 = 1.0;
const MOST_CHOSEN: f64 = 0.03;

/// Ends of the interval where nothing was learned; units of jumps that those of even wear are shrunk to, and the other way round
/// (assumed).
const USUAL_ENDS: (f64, f64) = (0.05, 0.95);
const UNITS_OF_OTHERS: f64 = 15.0;

/// Shares of the forecasts where nothing was learned of them: without lives to compare with, and with them (assumed).
const USUAL: [f64; FORECASTS] = [0.3, 0.6, 0.1, 0.0, 0.0];
const USUAL_COMPARED: [f64; FORECASTS] = [0.2, 0.5, 0.0, 0.1, 0.2];

/// What was learned of one fault of a fleet.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Fleet {
    /// fault or column
    pub fault: String,
    /// level of healthy units, where it is the same for all
    pub healthy: Option<f64>,
    /// level that ended lives
    pub threshold: f64,
    /// clock of all times
    pub clock: String,
    /// prior of the next unit
    pub prior: Prior,
    /// finished lives
    pub lives: Vec<Life>,
    /// how many units had not reached the threshold
    pub censored: usize,
    /// share of lives that is longer than any that ended (Kaplan and Meier 1958)
    #[serde(default)]
    pub unseen: f64,
    /// past forecasts, and what came of them; those of one unit stand together
    pub pasts: Vec<Past>,
    /// mass below the lower and below the upper end of the interval, by band; of even wear, then of wear by jumps
    pub ends: Vec<[(f64, f64); 2]>,
}

/// The distribution of the time left, as it is promised.
#[derive(Clone, Debug)]
pub struct Left {
    /// ascending samples [units of the clock]; infinite: not within the horizon
    pub times: Vec<f64>,
    /// interval of [`COVERAGE`]: the shortest of those that are promised
    pub interval: (f64, f64),
    /// whether finished lives stand behind it, and how many
    pub calibrated: Option<usize>,
    /// how far ahead was looked
    pub horizon: f64,
}

/// A past forecast of a unit whose life has ended since.
#[derive(Clone, Debug)]
pub struct Shot {
    /// unit
    pub unit: usize,
    band: usize,
    by_jumps: bool,
    look: Look,
    middle: f64,
    sets: [Vec<f64>; FORECASTS],
    /// what was left in truth
    pub truth: f64,
}

impl Left {
    /// Of ascending times: the shortest interval.
    pub fn of(times: Vec<f64>, calibrated: Option<usize>, horizon: f64) -> Self {
        let width = |a: f64| quantile(&times, a + COVERAGE) - quantile(&times, a);
        let narrower = |a: f64, b: f64| if width(b) < width(a) { b } else { a };
        let tail = TAILS.iter().copied().fold(TAILS[0], narrower);
        let interval = (quantile(&times, tail), quantile(&times, tail + COVERAGE));
        Self {
            times,
            interval,
            calibrated,
            horizon,
        }
    }

    /// Probability that the threshold is passed within a time.
    pub fn within(&self, t: f64) -> f64 {
        self.times.partition_point(|v| *v <= t) as f64 / self.times.len().max(1) as f64
    }
}

fn band(x: f64) -> usize {
    BANDS.iter().filter(|b| x >= **b).count()
}

/// How far a forecast looks [units of the clock].
fn horizon(prior: &Prior) -> f64 {
    LIVES_AHEAD * prior.usual_life()
}

/// Forecast of a unit's filter alone.
fn of_filter(track: &Track, ahead: Changes) -> Vec<f64> {
    // what of the stated uncertainty does not scatter is the unit's own, and the same at the threshold
    let common = track.stated * (1.0 - track.filter.scatter_share()).max(0.0).sqrt();
    let most = horizon(track.filter.prior());
    forecast(
        &track.filter,
        &Horizon {
            samples: SAMPLES,
            most,
            common,
            ahead,
            seed: 1,
        },
    )
}

/// The time left where no fleet is known: the shortest interval, not calibrated.
pub fn without_fleet(track: &Track) -> Left {
    let times = of_filter(track, Changes::UNKNOWN);
    let late = band(track.filter.damage().0) + 1 == N_BANDS;
    let n = times.len() as f64;
    let place = |i: usize| ((i as f64 + 0.5) / n).powf(if late { CALMER } else { 1.0 });
    let times = (0..times.len()).map(|i| quantile(&times, place(i))).collect();
    Left::of(times, None, horizon(track.filter.prior()))
}

/// Mixture of sets of ascending samples by their shares, as ascending samples.
fn mixture(sets: &[Vec<f64>; FORECASTS], shares: &[f64; FORECASTS], samples: usize) -> Vec<f64> {
    let present = || sets.iter().zip(shares).filter(|(s, w)| !s.is_empty() && **w > 0.0);
    let total: f64 = present().map(|(_, w)| w).sum();
    let mut points: Vec<(f64, f64)> = Vec::new();
    for (s, w) in present() {
        points.extend(s.iter().map(|t| (*t, w / total / s.len() as f64)));
    }
    if points.is_empty() {
        return sets[0].clone();
    }
    points.sort_by(|a, b| a.0.total_cmp(&b.0));
    let chosen = evenly(points.iter().map(|p| p.1), samples);
    chosen.iter().map(|i| points[*i].0).collect()
}

/// Sums of what units say: the fleet's prior is made of them, the units that still live included.
#[derive(Clone, Debug)]
pub struct Gathered {
    joint: Vec<f64>,
    /// by law: mass, and sums of rho and of its square
    rho: Vec<[f64; 3]>,
    units: f64,
}

impl Gathered {
    /// Of no unit yet.
    pub fn new(shipped: &Prior) -> Self {
        Self {
            joint: vec![0.0; MODELS],
            rho: vec![[0.0; 3]; shipped.rho_mean.len()],
            units: 0.0,
        }
    }

    /// One more unit, by its filter after the last test.
    pub fn add(&mut self, filter: &Filter) {
        self.units += 1.0;
        for c in &filter.components {
            self.joint[c.model.index()] += c.weight;
            let r = &mut self.rho[c.model.law()];
            r[0] += c.weight;
            r[1] += c.weight * c.rho;
            r[2] += c.weight * (c.rho * c.rho + c.prr);
        }
    }

    /// The prior of the next unit (empirical Bayes, one step): the mean over units, shrunk to what `shipped` says by five
    /// units; a tenth of that always stays, so that a unit unlike the fleet is followed.
    pub fn prior(&self, shipped: &Prior) -> Prior {
        const SHRUNK: f64 = 5.0;
        const KEPT: f64 = 0.1;
        let mut p = shipped.clone();
        let mean = |i: usize| (self.joint[i] + SHRUNK * shipped.joint[i]) / (self.units + SHRUNK);
        p.joint = (0..MODELS)
            .map(|i| (1.0 - KEPT) * mean(i) + KEPT * shipped.joint[i])
            .collect();
        let all = self
            .rho
            .iter()
            .fold([0.0; 3], |a, b| [a[0] + b[0], a[1] + b[1], a[2] + b[2]]);
        if all[0] > 0.0 {
            for (l, r) in self.rho.iter().enumerate() {
                // a law's own units, and five of the whole fleet's
                let n = r[0] + SHRUNK;
                let m = (r[1] + SHRUNK * all[1] / all[0]) / n;
                let square = (r[2] + SHRUNK * all[2] / all[0]) / n;
                p.rho_mean[l] = m;
                p.rho_sd[l] = (1.15 * (square - m * m).max(0.04).sqrt()).min(shipped.rho_sd[l]);
            }
        }
        p
    }
}

/// A past forecast: `track` up to some test, with the lives of others.
/// * `truth` what was left in truth [units of the clock]
pub fn shot<'a>(unit: usize, track: &Track, lives: impl Iterator<Item = &'a Life>, truth: f64) -> Shot {
    let sets = sets(track, lives);
    Shot {
        unit,
        band: band(track.filter.damage().0),
        by_jumps: by_jumps(track),
        look: Look::of(track),
        middle: middle(track, &sets),
        sets,
        truth,
    }
}

/// Whether a unit wears by jumps, most probably.
fn by_jumps(track: &Track) -> bool {
    track.group() + 1 == Model::GROUPS.len()
}

/// Geometric mean of a unit's age and of what is foretold [units of the clock].
fn middle(track: &Track, sets: &[Vec<f64>; FORECASTS]) -> f64 {
    let median = quantile(&sets[1], 0.5).min(horizon(track.filter.prior()));
    (past::age(track) * median.max(1e-9)).sqrt()
}

/// All forecasts but that of units that stood where this one stands. Where no lives can be compared with, their place is
/// taken by the second one.
fn sets<'a>(track: &Track, lives: impl Iterator<Item = &'a Life>) -> [Vec<f64>; FORECASTS] {
    let alike = match track.is_from_new() {
        true => Likeness::of(&track.life, lives),
        false => Vec::new(),
    };
    let mut out = [
        of_filter(track, SELDOM),
        of_filter(track, OFTEN),
        of_filter(track, SOON),
        similar(&alike, Kernel::NARROW, SAMPLES),
        Vec::new(),
    ];
    out[4] = out[1].clone();
    if out[3].is_empty() {
        out[3] = out[1].clone();
    }
    out
}

impl Fleet {
    /// Shares and places of past forecasts.
    /// * `shots` past forecasts of units whose lives have ended, made with `prior` and the lives of the others
    pub fn learned(
        fault: &str,
        healthy: Option<f64>,
        threshold: f64,
        clock: &str,
        prior: Prior,
        (lives, censored, unseen): (Vec<Life>, usize, f64),
        shots: &[Shot],
    ) -> Self {
        let mut f = Self {
            fault: fault.into(),
            healthy,
            threshold,
            clock: clock.into(),
            prior,
            lives,
            censored,
            unseen,
            pasts: Vec::new(),
            ends: vec![[USUAL_ENDS; 2]; N_BANDS],
        };
        if is_compared(f.lives.len(), unseen) && !shots.is_empty() {
            f.replay(shots);
        }
        f
    }

    fn usual(&self) -> &'static [f64; FORECASTS] {
        match is_compared(self.lives.len(), self.unseen) {
            true => &USUAL_COMPARED,
            false => &USUAL,
        }
    }

    /// Learns of past forecasts, each by those of the other units.
    fn replay(&mut self, shots: &[Shot]) {
        let most = horizon(&self.prior);
        let bare = |s: &Shot| Past {
            unit: s.unit as u32,
            look: s.look,
            longer: rounded((s.truth.max(1e-9) / s.middle).ln()),
            below: 0.5,
            off: Default::default(),
            apart: Default::default(),
        };
        let mut pasts: Vec<Past> = shots.iter().map(bare).collect();
        let near: Vec<Vec<f64>> = pasts.iter().map(|p| weights(&pasts, &p.look, Some(p.unit))).collect();
        let sets = |s: &Shot, near: &[f64]| {
            let mut sets = s.sets.clone();
            sets[4] = alike(&pasts, near, s.middle, Some(s.unit as u32), SAMPLES);
            if sets[4].is_empty() {
                sets[4] = sets[1].clone();
            }
            sets
        };
        let sets: Vec<[Vec<f64>; FORECASTS]> = shots.iter().zip(&near).map(|(s, n)| sets(s, n)).collect();
        for ((p, s), shot) in pasts.iter_mut().zip(&sets).zip(shots) {
            (p.off, p.apart) = distances(s, shot.truth, most);
        }
        let mixed: Vec<Vec<f64>> = shots
            .iter()
            .zip(&near)
            .zip(&sets)
            .map(|((s, n), sets)| {
                let shares = past::shares(&pasts, n, self.usual(), Some(s.unit as u32));
                mixture(sets, &shares, SAMPLES)
            })
            .collect();
        for ((p, m), s) in pasts.iter_mut().zip(&mixed).zip(shots) {
            p.below = rounded(m.iter().filter(|t| **t < s.truth).count() as f64 / m.len().max(1) as f64);
        }
        self.pasts = pasts;
        let placed = shots.iter().zip(&near).zip(&mixed);
        let placed = placed.map(|((s, n), m)| (s, self.placed(n, m, Some(s.unit as u32))));
        let placed: Vec<(&Shot, Vec<f64>)> = placed.collect();
        let ends = |b: usize| [false, true].map(|jumps| narrowest(&placed, b, jumps, most));
        self.ends = (0..N_BANDS).map(ends).collect();
    }

    /// Whether intervals are calibrated: lives enough stand behind them.
    pub fn is_calibrated(&self) -> bool {
        self.lives.len() >= CALIBRATED && !self.pasts.is_empty()
    }

    /// Whether a file holds what a fleet must: masses, lives and shares of this program's axes.
    pub fn is_sound(&self) -> bool {
        self.prior.is_sound()
            && self.threshold.is_finite()
            && (0.0..=1.0).contains(&self.unseen)
            && self.lives.iter().all(Life::is_sound)
            && self.pasts.iter().all(Past::is_sound)
            && self.ends.len() == N_BANDS
            && self.ends.iter().flatten().all(|(a, b)| 0.0 <= *a && a < b && *b <= 1.0)
    }

    /// The time left of a unit.
    pub fn left(&self, track: &Track) -> Left {
        let compared = is_compared(self.lives.len(), self.unseen);
        let lives = self.lives.iter().filter(|_| compared);
        let b = band(track.filter.damage().0);
        let mut sets = sets(track, lives);
        let horizon = horizon(&self.prior);
        if self.pasts.is_empty() {
            return Left::of(mixture(&sets, self.usual(), SAMPLES), None, horizon);
        }
        let near = weights(&self.pasts, &Look::of(track), None);
        sets[4] = alike(&self.pasts, &near, middle(track, &sets), None, SAMPLES);
        let shares = past::shares(&self.pasts, &near, self.usual(), None);
        let times = self.placed(&near, &mixture(&sets, &shares, SAMPLES), None);
        let (lower, upper) = self.ends[b][usize::from(by_jumps(track))];
        let interval = (quantile(&times, lower), quantile(&times, upper));
        Left {
            times,
            interval,
            calibrated: self.is_calibrated().then_some(self.lives.len()),
            horizon,
        }
    }

    /// Samples as the places of past truths have them.
    fn placed(&self, near: &[f64], mixed: &[f64], without: Option<u32>) -> Vec<f64> {
        let places = places(&self.pasts, near, without, SAMPLES);
        places.iter().map(|p| quantile(mixed, *p)).collect()
    }
}

/// Masses below the ends of the interval that would have held [`COVERAGE`] of a band's past truths, a unit's together as one, and
/// would have been the narrowest over the truth: of those of one kind of wear, with so many units of the other.
fn narrowest(placed: &[(&Shot, Vec<f64>)], band: usize, by_jumps: bool, most: f64) -> (f64, f64) {
    let of: Vec<&(&Shot, Vec<f64>)> = placed.iter().filter(|p| p.0.band == band).collect();
    let count = |unit: usize| of.iter().filter(|p| p.0.unit == unit).count() as f64;
    let mut weights: Vec<f64> = of.iter().map(|p| 1.0 / count(p.0.unit)).collect();
    let is_other = |i: usize| of[i].0.by_jumps != by_jumps;
    let others: f64 = (0..of.len()).filter(|i| is_other(*i)).map(|i| weights[i]).sum();
    for (i, w) in weights.iter_mut().enumerate() {
        *w *= if is_other(i) {
            (UNITS_OF_OTHERS / others).min(1.0)
        } else {
            1.0
        };
    }
    let total: f64 = weights.iter().sum();
    let asked = COVERAGE + (CHOSEN / total.max(1.0)).min(MOST_CHOSEN);
    let mut best: Option<((f64, f64), f64)> = None;
    for lower in TAILS {
        for upper in UPPERS {
            let (mut held, mut width) = (0.0, 0.0);
            for ((s, times), w) in of.iter().zip(&weights) {
                let (lo, hi) = (quantile(times, lower), quantile(times, upper));
                held += if (lo..=hi).contains(&s.truth) { *w } else { 0.0 };
                width += w * (hi.min(most) - lo) / s.truth.max(1e-9);
            }
            if held >= asked * total && best.is_none_or(|b| width < b.1) {
                best = Some(((lower, upper), width));
            }
        }
    }
    best.map_or(USUAL_ENDS, |b| b.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn mixtures_keep_their_order() {
        let sets = [vec![1.0, 2.0, 3.0], vec![10.0], vec![], vec![], vec![]];
        let m = mixture(&sets, &[0.5, 0.5, 0.0, 0.0, 0.0], 10);
        assert!(m.windows(2).all(|w| w[0] <= w[1]) && m[0] == 1.0 && m[9] == 10.0);
        let f = Fleet::learned(
            "fsj",
            Some(1.0),
            4.0,
            "cycle",
            Prior::shipped(1.0),
            (vec![], 3, 1.0),
            &[],
        );
        assert!(f.is_sound() && !f.is_calibrated());
    }
}
