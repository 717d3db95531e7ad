//! What a fleet teaches: a prior, lives to compare with, shares of the forecasts, and where past truths lay within them.

use super::filter::Filter;
use super::forecast::{Horizon, crps, forecast, quantile};
use super::prior::{MODELS, Model, Prior};
use super::similar::{Kernel, Life, Likeness, similar};
use super::special::evenly;
use super::track::Track;
use serde::{Deserialize, Serialize};
use std::sync::OnceLock;

/// Bands of the damage seen [share of U]: what is known at the time, so that what is learned by them may be promised.
const BANDS: [f64; 2] = [0.15, 0.45];
const N_BANDS: usize = 3;
const N_GROUPS: usize = Model::GROUPS.len();

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

/// Changes of regime in a usual life that forecasts reckon with: where no fleet is known, and of the two forecasts that a
/// fleet weighs (assumed).
const AHEAD: f64 = 1.0;
const AHEAD_OFTEN: f64 = 2.5;
const AHEAD_SELDOM: f64 = 0.5;

/// Samples of a forecast.
const SAMPLES: usize = 400;

/// A forecast looks so many usual lives ahead; later is never.
const LIVES_AHEAD: f64 = 10.0;

/// Steps of the shares that are tried; units of the whole band that a group's own are shrunk to, of scores and of places;
/// units of a uniform distribution that places are shrunk to (assumed).
const STEPS: usize = 5;
const UNITS_OF_BAND: f64 = 10.0;
const UNITS_UNIFORM: f64 = 5.0;

/// Shares of the interval's missing mass that may lie below it.
const TAILS: [f64; 5] = [0.05, 0.04, 0.03, 0.02, 0.01];

/// Coverage of intervals of the time left.
pub const COVERAGE: f64 = 0.9;

/// What choosing shares and tails on the same lives costs: an interval is taken for so much more, over the number of lives
/// (assumed).
const CHOSEN: f64 = 1.0;

/// Forecasts that are weighed: reckoning with many changes, with few, lives that were alike, and very much so.
const FORECASTS: usize = 4;

/// Where a past truth lay.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Place {
    /// band of the damage seen
    pub band: u8,
    /// group of wears
    pub group: u8,
    /// share of the forecast below the truth
    pub below: f64,
    /// weight: the places of a unit in a band together have 1
    pub weight: f64,
}

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
    /// shares of the forecasts by band and group
    pub shares: Vec<Vec<[f64; FORECASTS]>>,
    /// where past truths lay
    pub places: Vec<Place>,
    /// mass below the interval by band
    pub tails: Vec<f64>,
    /// quantiles of the places by band and group, worked out when they are first asked for
    #[serde(skip)]
    quantiles: OnceLock<Vec<Vec<Vec<f64>>>>,
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
    group: usize,
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
    let n = prior.rho_mean.len() as f64;
    LIVES_AHEAD * (-prior.rho_mean.iter().sum::<f64>() / n).exp()
}

/// Forecast of a unit's filter alone.
fn of_filter(track: &Track, ahead: f64) -> Vec<f64> {
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
    Left::of(of_filter(track, AHEAD), None, horizon(track.filter.prior()))
}

/// Mixture of sets of ascending samples by their shares, as ascending samples. An empty set leaves its share to others.
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
    let x = track.filter.damage().0;
    Shot {
        unit,
        band: band(x),
        group: track.group(),
        sets: sets(track, lives),
        truth,
    }
}

fn sets<'a>(track: &Track, lives: impl Iterator<Item = &'a Life>) -> [Vec<f64>; FORECASTS] {
    let alike = match track.is_from_new() {
        true => Likeness::of(&track.life, lives),
        false => Vec::new(),
    };
    [
        of_filter(track, AHEAD_OFTEN),
        of_filter(track, AHEAD_SELDOM),
        similar(&alike, Kernel::BROAD, SAMPLES),
        similar(&alike, Kernel::NARROW, SAMPLES),
    ]
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
        let compared = is_compared(lives.len(), unseen);
        let usual = if compared {
            [0.6, 0.2, 0.2, 0.0]
        } else {
            [0.7, 0.3, 0.0, 0.0]
        };
        let mut f = Self {
            fault: fault.into(),
            healthy,
            threshold,
            clock: clock.into(),
            prior,
            lives,
            censored,
            unseen,
            shares: vec![vec![usual; N_GROUPS]; N_BANDS],
            places: Vec::new(),
            tails: vec![TAILS[0]; N_BANDS],
            quantiles: OnceLock::new(),
        };
        if !compared || shots.is_empty() {
            return f;
        }
        f.shares = best_shares(shots, horizon(&f.prior));
        f.places = f.places_of(shots);
        f.tails = f.narrowest(shots);
        f
    }

    /// Whether intervals are calibrated: lives enough stand behind them.
    pub fn is_calibrated(&self) -> bool {
        self.lives.len() >= CALIBRATED && !self.places.is_empty()
    }

    /// Whether a file holds what a fleet must: masses, lives and shares of this program's axes.
    pub fn is_sound(&self) -> bool {
        let share = |s: &[f64; FORECASTS]| s.iter().all(|w| (0.0..=1.0).contains(w)) && s.iter().sum::<f64>() > 0.5;
        let place = |p: &Place| {
            (p.band as usize) < N_BANDS
                && (p.group as usize) < N_GROUPS
                && (0.0..=1.0).contains(&p.below)
                && (0.0..=1.0).contains(&p.weight)
        };
        self.prior.is_sound()
            && self.threshold.is_finite()
            && (0.0..=1.0).contains(&self.unseen)
            && self.lives.iter().all(Life::is_sound)
            && self.shares.len() == N_BANDS
            && self.shares.iter().all(|b| b.len() == N_GROUPS && b.iter().all(share))
            && self.places.iter().all(place)
            && self.tails.len() == N_BANDS
            && self.tails.iter().all(|t| (0.0..=0.1).contains(t))
    }

    /// The time left of a unit.
    pub fn left(&self, track: &Track) -> Left {
        let compared = is_compared(self.lives.len(), self.unseen);
        let lives = self.lives.iter().filter(|_| compared);
        let (b, g) = (band(track.filter.damage().0), track.group());
        let mixed = mixture(&sets(track, lives), &self.shares[b][g], SAMPLES);
        let horizon = horizon(&self.prior);
        if self.places.is_empty() {
            return Left::of(mixed, None, horizon);
        }
        let times = self.placed(b, g, &mixed);
        let more = (CHOSEN / self.lives.len() as f64).min(0.05);
        let tail = self.tails[b] * (1.0 - more / (1.0 - COVERAGE));
        let interval = (quantile(&times, tail), quantile(&times, tail + COVERAGE + more));
        Left {
            times,
            interval,
            calibrated: self.is_calibrated().then_some(self.lives.len()),
            horizon,
        }
    }

    /// Samples as the places of past truths have them.
    fn placed(&self, b: usize, g: usize, mixed: &[f64]) -> Vec<f64> {
        let all = || (0..N_BANDS).map(|b| (0..N_GROUPS).map(|g| self.quantiles(b, g)).collect());
        let places = &self.quantiles.get_or_init(|| all().collect())[b][g];
        places.iter().map(|p| quantile(mixed, *p)).collect()
    }

    /// Quantiles of the places of past truths in a band, those of a group first of all: distributional conformal prediction
    /// (Chernozhukov, Wuthrich and Zhu 2021), over units.
    fn quantiles(&self, b: usize, g: usize) -> Vec<f64> {
        let mut of: Vec<&Place> = self.places.iter().filter(|p| p.band as usize == b).collect();
        of.sort_by(|a, b| a.below.total_cmp(&b.below));
        let total: f64 = of.iter().map(|p| p.weight).sum();
        let own: f64 = of.iter().filter(|p| p.group as usize == g).map(|p| p.weight).sum();
        let mut out = Vec::with_capacity(SAMPLES);
        let (mut i, mut all, mut group) = (0, 0.0, 0.0);
        const FINE: usize = 4000;
        for k in 0..=FINE {
            let p = k as f64 / FINE as f64;
            while i < of.len() && of[i].below <= p {
                all += of[i].weight;
                group += if of[i].group as usize == g { of[i].weight } else { 0.0 };
                i += 1;
            }
            let whole = (all + UNITS_UNIFORM * p) / (total + UNITS_UNIFORM);
            let f = (group + UNITS_OF_BAND * whole) / (own + UNITS_OF_BAND);
            while out.len() < SAMPLES && (out.len() as f64 + 0.5) / SAMPLES as f64 <= f {
                out.push(p);
            }
        }
        out.resize(SAMPLES, 1.0);
        out
    }

    fn mixed(&self, s: &Shot) -> Vec<f64> {
        mixture(&s.sets, &self.shares[s.band][s.group], SAMPLES)
    }

    fn places_of(&self, shots: &[Shot]) -> Vec<Place> {
        let count = |s: &Shot| shots.iter().filter(|o| o.unit == s.unit && o.band == s.band).count() as f64;
        let place = |s: &Shot| {
            let m = self.mixed(s);
            let below = m.iter().filter(|t| **t < s.truth).count() as f64 / m.len().max(1) as f64;
            Place {
                band: s.band as u8,
                group: s.group as u8,
                below,
                weight: 1.0 / count(s),
            }
        };
        shots.iter().map(place).collect()
    }

    /// The mass below the interval, by band, that makes it narrowest.
    fn narrowest(&self, shots: &[Shot]) -> Vec<f64> {
        let most = horizon(&self.prior);
        let mut widths = [[0.0; TAILS.len()]; N_BANDS];
        for s in shots {
            let times = self.placed(s.band, s.group, &self.mixed(s));
            for (w, tail) in widths[s.band].iter_mut().zip(TAILS) {
                *w += (quantile(&times, tail + COVERAGE).min(most) - quantile(&times, tail)) / s.truth.max(1e-9);
            }
        }
        let best = |w: &[f64; TAILS.len()]| {
            let i = (0..TAILS.len()).min_by(|a, b| w[*a].total_cmp(&w[*b])).unwrap_or(0);
            TAILS[i]
        };
        widths.iter().map(best).collect()
    }
}

/// Shares by band and group that made the past forecasts best, by their scores over the truth.
fn best_shares(shots: &[Shot], most: f64) -> Vec<Vec<[f64; FORECASTS]>> {
    let step = |k: usize| k as f64 / STEPS as f64;
    let mut tried: Vec<[f64; FORECASTS]> = Vec::new();
    for a in 0..=STEPS {
        for b in 0..=STEPS - a {
            for c in 0..=STEPS - a - b {
                tried.push([step(a), step(b), step(c), step(STEPS - a - b - c)]);
            }
        }
    }
    let score = |s: &Shot, w: &[f64; FORECASTS]| crps(&mixture(&s.sets, w, 100), s.truth, most) / s.truth.max(1e-9);
    let scores: Vec<Vec<f64>> = shots
        .iter()
        .map(|s| tried.iter().map(|w| score(s, w)).collect())
        .collect();
    let of = |b: usize, g: Option<usize>, k: usize| -> (f64, f64) {
        let mine = shots
            .iter()
            .zip(&scores)
            .filter(|(s, _)| s.band == b && g.is_none_or(|g| s.group == g));
        mine.fold((0.0, 0.0), |(sum, n), (_, v)| (sum + v[k], n + 1.0))
    };
    let units = shots.iter().map(|s| s.unit).max().map_or(1.0, |u| u as f64 + 1.0);
    let per_unit = shots.len() as f64 / units / N_BANDS as f64;
    let best = |b: usize, g: usize| {
        let cost = |k: usize| {
            let (all, n) = of(b, None, k);
            of(b, Some(g), k).0 + UNITS_OF_BAND * per_unit * all / f64::max(n, 1.0)
        };
        let k = (0..tried.len())
            .min_by(|a, c| cost(*a).total_cmp(&cost(*c)))
            .unwrap_or(0);
        tried[k]
    };
    (0..N_BANDS)
        .map(|b| (0..N_GROUPS).map(|g| best(b, g)).collect())
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn mixtures_and_places_keep_their_order() {
        let sets = [vec![1.0, 2.0, 3.0], vec![10.0], vec![], vec![]];
        let m = mixture(&sets, &[0.5, 0.5, 0.0, 0.0], 10);
        assert!(m.windows(2).all(|w| w[0] <= w[1]) && m[0] == 1.0 && m[9] == 10.0);
        let place = |below: f64| Place {
            band: 0,
            group: 1,
            below,
            weight: 1.0,
        };
        let mut f = Fleet::learned(
            "fsj",
            Some(1.0),
            4.0,
            "cycle",
            Prior::shipped(1.0),
            (vec![], 3, 1.0),
            &[],
        );
        assert!(f.is_sound() && !f.is_calibrated());
        f.places = (0..100).map(|i| place(0.5 + 0.005 * f64::from(i))).collect();
        let q = f.quantiles(0, 1);
        assert!(q.windows(2).all(|w| w[0] <= w[1]) && q[200] > 0.7 && q.len() == SAMPLES);
    }
}
