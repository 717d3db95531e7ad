//! What one reading makes of one component of the filter: growth, and branches (regular, jump, wrong diagnosis) matched by
//! their moments.

use super::filter::{Component, Reading, matched};
use super::law::{Law, MOST};
use super::prior::{Jumps, Wear};
use super::special::{erfc, ln_gamma, log_normal, normal_cdf};

/// Share of diagnoses that are wrong, and the standard deviation of those [share of U] (assumed).
const WRONG: f64 = 0.004;
const WRONG_SD: f64 = 0.35;

/// Jumps a life beside other wear, and their size [share of U] (assumed).
const RARE_JUMPS: f64 = 0.3;
const RARE_SIZE: f64 = 0.08;

/// Growth and one reading: the likelihood, the probability of a wrong diagnosis, the innovation [standard deviations].
pub(super) fn read(
    c: &mut Component,
    law: &Law,
    s: f64,
    dt: f64,
    interval: f64,
    reading: Option<Reading>,
) -> (f64, f64, f64) {
    let (grown, a, b) = law.grow(c.x, s);
    let rise = (grown - c.x).max(0.0);
    let prr = c.prr + c.model.volatility().powi(2) * s;
    let wear = c.model.wear();
    let variance = match wear {
        Wear::Smooth(kappa) => kappa * rise,
        Wear::Gamma(cv) => cv * cv * rise * rise * (interval / dt.max(1e-12)),
        Wear::Jumps(of) => (1.0 + 1.0 / f64::from(of.shape)) * of.mean(c.jumps, c.jumped) * rise,
    };
    match reading {
        None => {
            propagate(c, grown, a, b, variance, prr);
            (1.0, 0.0, 0.0)
        }
        Some(Reading::Above(bound)) => {
            propagate(c, grown, a, b, variance, prr);
            (censored(c, bound), 0.0, 0.0)
        }
        Some(Reading::Damage { y, sd, level }) => {
            let noise = c.model.noise();
            let r = (noise.of_stated * sd).powi(2) + (noise.of_level * level).powi(2);
            match wear {
                Wear::Jumps(of) if c.pxx + r < of.mean(c.jumps, c.jumped).powi(2) => {
                    c.prr = prr;
                    jumping(c, y, r, rise, of)
                }
                Wear::Gamma(_) if c.pxx + r < 0.25 * variance && dt > 0.0 => {
                    c.prr = prr;
                    gamma(c, y, r, rise, variance)
                }
                _ => {
                    propagate(c, grown, a, b, variance, prr);
                    gaussian(c, y, r, RARE_JUMPS * s)
                }
            }
        }
    }
}

fn propagate(c: &mut Component, grown: f64, a: f64, b: f64, variance: f64, prr: f64) {
    c.pxx = a * a * c.pxx + 2.0 * a * b * c.pxr + b * b * c.prr + variance;
    c.pxr = a * c.pxr + b * c.prr;
    (c.x, c.prr) = (grown, prr);
}

/// Branches, whose weights are their likelihoods, as one; and the whole likelihood.
fn joined<const N: usize>(c: &mut Component, parts: [Component; N]) -> f64 {
    let total: f64 = parts.iter().map(|p| p.weight).sum();
    if !(total > 1e-290 && total.is_finite()) {
        return 0.0;
    }
    let mut parts = parts.iter().filter(|p| p.weight > 1e-9 * total);
    if let Some(first) = parts.next() {
        let all = parts.fold(*first, |m, p| matched(&m, p));
        *c = Component {
            weight: c.weight,
            ..all
        };
    }
    total
}

/// Regular, jump or wrong, by normal distributions.
fn gaussian(c: &mut Component, y: f64, r: f64, jump: f64) -> (f64, f64, f64) {
    let e = y - c.x;
    let s = c.pxx + r;
    let z = e / s.sqrt();
    let regular = (1.0 - WRONG - jump) * log_normal(e, s).exp();
    let (kx, kr) = (c.pxx / s, c.pxr / s);
    let followed = Component {
        weight: regular,
        x: c.x + kx * e,
        rho: c.rho + kr * e,
        pxx: c.pxx - kx * c.pxx,
        pxr: c.pxr - kx * c.pxr,
        prr: c.prr - kr * c.pxr,
        ..*c
    };
    if z.abs() < 2.5 {
        *c = Component {
            weight: c.weight,
            ..followed
        };
        return (regular, 0.0, z);
    }
    let wrong = WRONG * log_normal(e, s + WRONG_SD * WRONG_SD).exp();
    let broad = s + RARE_SIZE * RARE_SIZE;
    let pxx = c.pxx + RARE_SIZE * RARE_SIZE;
    let k = pxx / broad;
    let jumped = Component {
        weight: if e > 0.0 {
            jump * log_normal(e - RARE_SIZE, broad).exp()
        } else {
            0.0
        },
        x: c.x + RARE_SIZE + k * (e - RARE_SIZE),
        pxx: pxx - k * pxx,
        pxr: 0.0,
        ..*c
    };
    let total = joined(c, [followed, Component { weight: wrong, ..*c }, jumped]);
    (total, if total > 0.0 { wrong / total } else { 0.0 }, z)
}

/// Gamma increments that are seen much more finely than they scatter, or a wrong diagnosis. The rate is learned as the
/// scale of a gamma variable, whose score is linear in the increment: increments more regular than the model's mislead
/// not. Mode and curvature of the posterior of rho (Laplace).
fn gamma(c: &mut Component, y: f64, r: f64, rise: f64, variance: f64) -> (f64, f64, f64) {
    let e = y - c.x;
    let s = c.pxx + r;
    let sd = s.sqrt();
    let shape = (rise * rise / variance).max(1e-3);
    // an increment within the noise is taken for one of the noise's size
    let d = e.max(0.5 * sd);
    let reading = shape * d / rise;
    // prior variance prr, ln likelihood -shape delta - reading exp(-delta)
    let mut delta = 0.0;
    for _ in 0..3 {
        let fall = reading * f64::exp(-delta);
        let slope = -delta / c.prr - shape + fall;
        delta += (slope / (1.0 / c.prr + fall.max(0.3 * shape))).clamp(-1.5, 1.5);
    }
    let fall = reading * f64::exp(-delta);
    let prr = 1.0 / (1.0 / c.prr + fall.max(0.3 * shape));
    let laplace = 0.5 * (prr / c.prr).ln() - 0.5 * delta * delta / c.prr;
    let log = shape * (shape / rise).ln() + (shape - 1.0) * d.ln() - ln_gamma(shape) - shape * delta - fall + laplace;
    let within = (e - 0.5 * sd).min(0.0) / sd;
    let some = (1.0 - WRONG) * (log - 0.5 * within * within).exp();
    let wrong = WRONG * log_normal(e, s + WRONG_SD * WRONG_SD).exp();
    let z = (e - rise) / (variance + s).sqrt();
    let moved = Component {
        weight: some,
        x: y,
        pxx: r,
        pxr: 0.0,
        rho: c.rho + delta,
        prr,
        ..*c
    };
    let stayed = Component {
        weight: wrong,
        x: c.x + rise,
        pxx: c.pxx + variance,
        pxr: 0.0,
        ..*c
    };
    let total = joined(c, [moved, stayed]);
    (total, if total > 0.0 { wrong / total } else { 0.0 }, z)
}

/// No jump, jumps, or a wrong diagnosis: compound Poisson wear that is seen much more finely than a jump. Number and size are
/// learned apart: `rho` is that of the growth with the sizes known so far, and follows where they become known better.
/// * `rise` growth that is expected since the last reading
fn jumping(c: &mut Component, y: f64, r: f64, rise: f64, of: Jumps) -> (f64, f64, f64) {
    let size = of.mean(c.jumps, c.jumped);
    let count = rise / size;
    let e = y - c.x;
    let s = c.pxx + r;
    let sd = s.sqrt();
    let z = e / sd;
    let none = (1.0 - WRONG) * (-count + log_normal(e, s)).exp();
    // density of at least one jump, and how many there were
    let (density, n) = if e > 3.0 * sd {
        sum_of_jumps(e, count, of, c)
    } else {
        // one exponential under the noise
        let tail = (0.5 * s / (size * size) - e / size).exp() / size;
        let rare = (3.0 * sd / size).min(1.0).powi(i32::from(of.shape) - 1);
        (
            rare * count * (-count).exp() * tail * 0.5 * erfc((sd / size - z) / std::f64::consts::SQRT_2),
            1.0,
        )
    };
    let some = (1.0 - WRONG) * density;
    let wrong = WRONG * log_normal(e, s + WRONG_SD * WRONG_SD).exp();
    // their number is what is learned of the rate
    let information = count * (1.0 - 0.5 * count / (1.0 + count));
    let prr = 1.0 / (1.0 / c.prr + information);
    let most = 1.5 * c.prr.sqrt();
    let learned = |n: f64| c.rho + (prr * (n - count)).clamp(-most, most);
    let k = c.pxx / s;
    let rested = Component {
        weight: none,
        x: c.x + k * e,
        pxx: c.pxx - k * c.pxx,
        pxr: 0.0,
        rho: learned(0.0),
        prr,
        ..*c
    };
    let (jumps, jumped) = (c.jumps + n, c.jumped + e.max(0.0));
    let moved = Component {
        weight: some,
        x: y,
        pxx: r,
        pxr: 0.0,
        rho: learned(n) + (of.mean(jumps, jumped) / size).ln(),
        prr,
        jumps,
        jumped,
        ..*c
    };
    let stayed = Component {
        weight: wrong,
        pxx: c.pxx + 2.0 * size * size * count,
        ..*c
    };
    let total = joined(c, [rested, moved, stayed]);
    (total, if total > 0.0 { wrong / total } else { 0.0 }, z)
}

/// Jumps that are summed up at most.
const MOST_JUMPS: usize = 12;

/// Density of the sum `e` of at least one jump of a scale that is known as an inverse gamma variable (beta prime
/// distributions), and the mean number of jumps in it.
fn sum_of_jumps(e: f64, count: f64, of: Jumps, c: &Component) -> (f64, f64) {
    let (a, b) = of.scale(c.jumps, c.jumped);
    let k = f64::from(of.shape);
    let part = e / (b + e);
    // one jump
    let mut term = (ln_gamma(a + k) - ln_gamma(a) - ln_gamma(k) + k * part.ln() + a * (b / (b + e)).ln() - count).exp()
        * count
        / e;
    let (mut sum, mut first) = (0.0, 0.0);
    for m in 1..=MOST_JUMPS {
        let n = m as f64;
        sum += term;
        first += n * term;
        let ratio: f64 = (0..of.shape)
            .map(|j| (a + n * k + f64::from(j)) / (n * k + f64::from(j)))
            .product();
        term *= count / (n + 1.0) * part.powi(i32::from(of.shape)) * ratio;
        if term < 1e-4 * sum {
            break;
        }
    }
    if sum > 0.0 { (sum, first / sum) } else { (0.0, 1.0) }
}

/// Damage is above `bound`: the likelihood. The component becomes the normal of the same moments.
fn censored(c: &mut Component, bound: f64) -> f64 {
    let sd = c.pxx.sqrt().max(1e-9);
    let a = (bound - c.x) / sd;
    let above = normal_cdf(-a).max(1e-12);
    let ratio = (-0.5 * a * a).exp() / (2.0 * std::f64::consts::PI).sqrt() / above;
    let (dx, left) = (sd * ratio, (1.0 - ratio * (ratio - a)).clamp(0.02, 1.0));
    let k = c.pxr / c.pxx.max(1e-18);
    c.rho += k * dx;
    c.prr -= k * c.pxr * (1.0 - left);
    c.x = (c.x + dx).min(MOST);
    c.pxr *= left;
    c.pxx *= left;
    above
}
