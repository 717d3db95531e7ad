//! Past forecasts of a fleet, and those that were made where a unit stands now.
//!
//! What a unit looks like (damage, how it grows, by what wear, how old it is) is a point; past forecasts near it say which
//! kind of forecast was best there, where truths lay within it, and how much longer than foretold such units lived.

use super::forecast::quantile;
use super::special::{evenly, normal_quantile};
use super::track::Track;
use serde::{Deserialize, Serialize};

/// Forecasts that are weighed: reckoning with few changes ahead, with many, with one soon; lives that were very much alike;
/// units that stood where this one stands.
pub const FORECASTS: usize = 5;
const PAIRS: usize = FORECASTS * (FORECASTS + 1) / 2;

/// What a unit looks like, in numbers without units.
const LOOKS: usize = 9;
/// Widths by which units look alike (assumed).
const WIDTHS: [f64; LOOKS] = [0.36, 0.22, 0.7, 0.27, 0.36, 0.36, 0.36, 0.54, 0.27];

/// Damage and its growth are told apart down to here [share of U].
const FINE: f64 = 0.01;
const LEAST: f64 = 0.003;

/// Units of the whole fleet that those near a unit are shrunk to: for shares, and for places (assumed).
const UNITS_OF_ALL: [f64; 2] = [1.0, 30.0];
/// Units of a uniform distribution that places are shrunk to (assumed).
const UNITS_UNIFORM: f64 = 60.0;
/// Units by which shares are drawn to the usual ones (assumed).
const UNITS_USUAL: f64 = 1.0;

/// Steps of the shares that are tried.
const STEPS: usize = 10;

/// Smoothing of the logarithm of the time left of units that stood where this one stands (assumed).
const SMOOTH: f64 = 0.1;

/// Samples by which two forecasts are compared.
const COMPARED_BY: usize = 64;

/// A unit at one moment, as others are compared with it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Look([f32; LOOKS]);

impl Look {
    /// Of a unit after its last test.
    pub fn of(track: &Track) -> Self {
        let f = &track.filter;
        let x = f.damage().0.max(LEAST);
        let age = age(track);
        let (wears, laws) = (f.groups(), f.families());
        let usual = f.prior().usual_life().ln();
        let changed: f64 = f.components.iter().filter(|c| c.born > 0).map(|c| c.weight).sum();
        let steep = (f.log_rate().0 + (age / x).ln()).clamp(-2.0, 2.5);
        let rough = wears[1] + 2.0 * wears[2] + 3.0 * wears[3];
        let look = [
            (x + FINE).ln(),
            steep,
            rough,
            wears[3],
            laws[3],
            laws[4],
            laws[0] + laws[1],
            age.ln() - usual,
            changed,
        ];
        Self(look.map(|v| v as f32))
    }

    /// How near two are: 1 where they look the same.
    fn near(&self, other: &Self) -> f64 {
        let parts = self.0.iter().zip(&other.0).zip(WIDTHS);
        let d: f64 = parts.map(|((a, b), w)| (f64::from(a - b) / w).powi(2)).sum();
        (-0.5 * d).exp()
    }

    fn is_sound(&self) -> bool {
        self.0.iter().all(|v| v.is_finite())
    }
}

/// Age of a unit's present life [units of the clock], above 0.
pub fn age(track: &Track) -> f64 {
    (track.at - track.begun()).max(track.filter.prior().interval)
}

/// A past forecast of a unit whose life has ended since, and how good it was.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Past {
    /// unit
    pub unit: u32,
    /// what it looked like
    pub look: Look,
    /// logarithm of the time that was left over the geometric mean of its age and of what was foretold
    pub longer: f32,
    /// share of the weighed forecast below the truth
    pub below: f32,
    /// mean distance of each forecast from the truth [truths]
    pub off: [f32; FORECASTS],
    /// mean distance of samples of each two forecasts [truths]
    pub apart: [f32; PAIRS],
}

impl Past {
    /// Whether its numbers may be reckoned with.
    pub fn is_sound(&self) -> bool {
        let good = |v: &[f32]| v.iter().all(|x| x.is_finite() && *x >= 0.0);
        self.look.is_sound()
            && self.longer.is_finite()
            && (0.0..=1.0).contains(&self.below)
            && good(&self.off)
            && good(&self.apart)
    }
}

/// Mean distance of two of ascending samples.
fn spread(times: &[f64]) -> f64 {
    let n = times.len() as f64;
    let of = |(i, t): (usize, &f64)| t * (2.0 * i as f64 + 1.0 - n);
    2.0 * times.iter().enumerate().map(of).sum::<f64>() / (n * n)
}

/// Distances of forecasts from the truth and from each other, over the truth: of them follows the score of every mixture.
pub fn distances(sets: &[Vec<f64>; FORECASTS], truth: f64, most: f64) -> ([f32; FORECASTS], [f32; PAIRS]) {
    let at = |k: usize| (k as f64 + 0.5) / COMPARED_BY as f64;
    let few = |s: &Vec<f64>| -> Vec<f64> { (0..COMPARED_BY).map(|k| quantile(s, at(k)).min(most)).collect() };
    let sets: Vec<Vec<f64>> = sets.iter().map(few).collect();
    let over = truth.max(1e-9);
    let mut off = [0.0; FORECASTS];
    for (o, s) in off.iter_mut().zip(&sets) {
        *o = rounded(s.iter().map(|t| (t - truth).abs()).sum::<f64>() / COMPARED_BY as f64 / over);
    }
    let own: Vec<f64> = sets.iter().map(|s| spread(s)).collect();
    let mut apart = [0.0; PAIRS];
    for ((i, j), a) in pairs().zip(&mut apart) {
        *a = rounded(if i == j {
            own[i] / over
        } else {
            let mut both: Vec<f64> = sets[i].iter().chain(&sets[j]).copied().collect();
            both.sort_by(f64::total_cmp);
            (2.0 * spread(&both) - 0.5 * (own[i] + own[j])).max(0.0) / over
        });
    }
    (off, apart)
}

/// Four digits are enough, and make a fleet's file half as long.
pub fn rounded(v: f64) -> f32 {
    if v == 0.0 || !v.is_finite() {
        return 0.0;
    }
    let unit = 10f64.powf(3.0 - v.abs().log10().floor());
    ((v * unit).round() / unit) as f32
}

fn pairs() -> impl Iterator<Item = (usize, usize)> {
    (0..FORECASTS).flat_map(|i| (i..FORECASTS).map(move |j| (i, j)))
}

/// Weights of past forecasts where a unit stands: each unit's together at most 1. Those of one unit may be left out.
pub fn weights(pasts: &[Past], look: &Look, without: Option<u32>) -> Vec<f64> {
    let mut out: Vec<f64> = pasts
        .iter()
        .map(|p| {
            if Some(p.unit) == without {
                0.0
            } else {
                p.look.near(look)
            }
        })
        .collect();
    for_units(pasts, |range| {
        let sum: f64 = out[range.clone()].iter().sum();
        if sum > 1.0 {
            out[range].iter_mut().for_each(|w| *w /= sum);
        }
    });
    out
}

/// Past forecasts of one unit stand together.
fn for_units(pasts: &[Past], mut f: impl FnMut(std::ops::Range<usize>)) {
    let mut from = 0;
    for to in 1..=pasts.len() {
        if to == pasts.len() || pasts[to].unit != pasts[from].unit {
            f(from..to);
            from = to;
        }
    }
}

/// Weights that give every unit 1.
fn even(pasts: &[Past], without: Option<u32>) -> Vec<f64> {
    let mut out = vec![0.0; pasts.len()];
    for_units(pasts, |range| {
        if Some(pasts[range.start].unit) != without {
            let n = range.len() as f64;
            out[range].iter_mut().for_each(|w| *w = 1.0 / n);
        }
    });
    out
}

/// Near weights with so many units of all.
fn shrunk(pasts: &[Past], near: &[f64], units: f64, without: Option<u32>) -> Vec<f64> {
    let all = even(pasts, without);
    let total: f64 = all.iter().sum::<f64>().max(1e-300);
    near.iter().zip(&all).map(|(n, a)| n + units * a / total).collect()
}

/// Shares of the forecasts that were best where a unit stands, by their score over the truth.
pub fn shares(pasts: &[Past], near: &[f64], usual: &[f64; FORECASTS], without: Option<u32>) -> [f64; FORECASTS] {
    let weights = shrunk(pasts, near, UNITS_OF_ALL[0], without);
    let total: f64 = weights.iter().sum();
    if total.is_nan() || total <= 0.0 {
        return *usual;
    }
    let (mut off, mut apart) = ([0.0; FORECASTS], [0.0; PAIRS]);
    for (p, w) in pasts.iter().zip(&weights) {
        for (a, b) in off.iter_mut().zip(&p.off) {
            *a += w * f64::from(*b) / total;
        }
        for (a, b) in apart.iter_mut().zip(&p.apart) {
            *a += w * f64::from(*b) / total;
        }
    }
    let scale = off.iter().sum::<f64>() / FORECASTS as f64;
    let drawn = scale * UNITS_USUAL / (UNITS_USUAL + total);
    let cost = |s: &[f64; FORECASTS]| {
        let mean: f64 = s.iter().zip(&off).map(|(s, o)| s * o).sum();
        let double = |i: usize, j: usize| if i == j { 0.5 } else { 1.0 };
        let own: f64 = pairs()
            .zip(&apart)
            .map(|((i, j), a)| double(i, j) * s[i] * s[j] * a)
            .sum();
        let usual: f64 = s.iter().zip(usual).map(|(a, b)| (a - b).powi(2)).sum();
        mean - own + drawn * usual
    };
    let (mut best, mut least) = (*usual, cost(usual));
    let mut s = [0usize; FORECASTS];
    each_share(&mut s, 0, STEPS, &mut |s| {
        let tried = s.map(|k| k as f64 / STEPS as f64);
        let c = cost(&tried);
        if c < least {
            (best, least) = (tried, c);
        }
    });
    best
}

/// All ways to deal out `left` steps from place `at` on.
fn each_share(s: &mut [usize; FORECASTS], at: usize, left: usize, f: &mut impl FnMut(&[usize; FORECASTS])) {
    if at + 1 == FORECASTS {
        s[at] = left;
        return f(s);
    }
    for k in 0..=left {
        s[at] = k;
        each_share(s, at + 1, left - k, f);
    }
}

/// Quantiles of the places of past truths where a unit stands: distributional conformal prediction (Chernozhukov, Wuthrich and
/// Zhu 2021) over units, localised (Guan 2023).
pub fn places(pasts: &[Past], near: &[f64], without: Option<u32>, samples: usize) -> Vec<f64> {
    let all = even(pasts, without);
    let (total, own): (f64, f64) = (all.iter().sum(), near.iter().sum());
    let mut order: Vec<usize> = (0..pasts.len()).collect();
    order.sort_by(|a, b| pasts[*a].below.total_cmp(&pasts[*b].below).then(a.cmp(b)));
    let mut out = Vec::with_capacity(samples);
    let (mut i, mut whole, mut here) = (0, 0.0, 0.0);
    const STEPS: usize = 4000;
    for k in 0..=STEPS {
        let p = k as f64 / STEPS as f64;
        while i < order.len() && f64::from(pasts[order[i]].below) <= p {
            whole += all[order[i]];
            here += near[order[i]];
            i += 1;
        }
        let g = (whole + UNITS_UNIFORM * p) / (total + UNITS_UNIFORM);
        let f = (here + UNITS_OF_ALL[1] * g) / (own + UNITS_OF_ALL[1]);
        while out.len() < samples && (out.len() as f64 + 0.5) / samples as f64 <= f {
            out.push(p);
        }
    }
    out.resize(samples, 1.0);
    out
}

/// Time left as of the units that stood where this one stands, as ascending samples.
/// * `middle` geometric mean of the unit's age and of what is foretold
pub fn alike(pasts: &[Past], near: &[f64], middle: f64, without: Option<u32>, samples: usize) -> Vec<f64> {
    let weights = shrunk(pasts, near, 0.1, without);
    let total: f64 = weights.iter().sum();
    if total.is_nan() || total <= 0.0 {
        return Vec::new();
    }
    let mut points: Vec<(f64, f64)> = pasts
        .iter()
        .zip(&weights)
        .map(|(p, w)| (f64::from(p.longer), w / total))
        .collect();
    points.sort_by(|a, b| a.0.total_cmp(&b.0));
    let z = |k: usize| normal_quantile((k as f64 * 0.618_033_988_749_895).fract().clamp(0.001, 0.999));
    let chosen = evenly(points.iter().map(|p| p.1), samples).into_iter().enumerate();
    let mut out: Vec<f64> = chosen
        .map(|(k, i)| middle * (points[i].0 + SMOOTH * z(k)).exp())
        .collect();
    out.sort_by(f64::total_cmp);
    out
}

#[cfg(test)]
mod tests {
    use super::super::forecast::crps;
    use super::*;

    fn past(unit: u32, x: f32, off: [f32; FORECASTS]) -> Past {
        let mut look = [0.0; LOOKS];
        look[0] = x;
        Past {
            unit,
            look: Look(look),
            longer: 0.0,
            below: 0.5,
            off,
            apart: [0.0; PAIRS],
        }
    }

    #[test]
    fn scores_of_mixtures_follow_from_distances() {
        let line = |a: f64, b: f64| -> Vec<f64> { (0..COMPARED_BY).map(|i| a + b * i as f64).collect() };
        let sets = [
            line(1.0, 0.1),
            line(5.0, 0.02),
            line(3.0, 0.2),
            line(2.0, 0.0),
            line(4.0, 0.05),
        ];
        let (off, apart) = distances(&sets, 4.0, 100.0);
        let mut both: Vec<f64> = sets[0].iter().chain(&sets[2]).copied().collect();
        both.sort_by(f64::total_cmp);
        let at = |i, j| f64::from(apart[pairs().position(|p| p == (i, j)).unwrap()]);
        let score = 0.5 * f64::from(off[0] + off[2]) - 0.125 * (at(0, 0) + at(2, 2)) - 0.25 * at(0, 2);
        assert!((4.0 * score - crps(&both, 4.0, 100.0)).abs() < 3e-3, "{score}");
    }

    #[test]
    fn those_near_decide_and_a_unit_counts_once() {
        let good = |k: usize| std::array::from_fn(|i| if i == k { 0.1 } else { 1.0 });
        let mut pasts: Vec<Past> = (0..20).map(|u| past(u, 0.0, good(3))).collect();
        pasts.extend((20..40).map(|u| past(u, 3.0, good(0))));
        // one unit that stands there a hundred times
        pasts.extend((0..100).map(|_| past(40, 0.0, good(1))));
        let near = weights(&pasts, &pasts[0].look, Some(0));
        assert!((near.iter().sum::<f64>() - 20.0).abs() < 1e-9 && near[0] == 0.0);
        let s = shares(&pasts, &near, &[0.2; FORECASTS], None);
        assert!(s[3] > 0.8, "{s:?}");
        // places in the middle draw there
        let q = places(&pasts, &near, None, 100);
        assert!(q.windows(2).all(|w| w[0] <= w[1]) && q[25] > 0.26 && q[75] < 0.74);
        assert!(alike(&[], &[], 1.0, None, 10).is_empty());
    }
}
