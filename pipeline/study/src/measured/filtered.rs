//! A speed that is made of the angle: a drive differentiates its resolver's angle and smooths that by low passes of the first order. Such
//! a channel says nothing that the angle does not, later, and with less of what is fast: no sensor of its own.

use crate::measured::bench::{Bench, BenchChannel};
use crate::measured::recording::Run;

/// Time over which speeds are compared [s] (assumed): the grain of an angle is then small beside what a low pass takes.
const MEAN_S: f64 = 2e-3;
/// Time constants of a low pass and delays that are tried: shortest and longest [s], and how many.
const FROM_S: f64 = 5e-5;
const TO_S: f64 = 6e-3;
const TRIED: usize = 28;
/// What is not compared at the beginning of a run [s]: a low pass knows nothing yet of what was before.
const SETTLED_S: f64 = 3.0 * TO_S;
/// Rate at which low passes are reckoned at least [Hz].
const STEPS_HZ: f64 = 2e4;
/// Share of what the best delay leaves, rms, below which a low pass must leave it (assumed: of twelve benches of another hand the seven
/// whose speed was the angle's left 0.1 to 0.6 of it, the others at least 6 times as much), and the least lag that counts [s].
const SHARE: f64 = 0.8;
const LEAST_LAG_S: f64 = 3e-4;
/// Over what the best delay leaves, squared, what none leaves at least (assumed: of 120 rigs of another hand the speeds that a drive makes
/// of its angle came to 17 and more, those of a sensor of their own that is not late to 1): a low pass takes the grain of a coarse angle
/// too, and is then nearer to a speed that is not late at all.
const LATE: f64 = 3.0;
/// Gain in log-likelihood over the best delay from which a low pass is one all the same, on a rig (assumed): a drive that differentiates
/// a coarse angle leaves noise that either model leaves. Of an actuator of ours the simulated loop says more, and it is told what
/// its speed's sensor is.
const CERTAIN: f64 = 30.0;

/// How a speed is made of the angle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LowPass {
    /// low passes of the first order, one after the other
    pub order: usize,
    /// corner of each [Hz]
    pub corner_hz: f64,
    /// what it leaves of the recorded speed, rms [rad/s]
    pub left_rad_per_s: f64,
}

impl LowPass {
    /// The speed that it makes of an angle, sample by sample [rad/s].
    pub fn speed_of(&self, angle_rad: &[f64], rate_hz: f64) -> Vec<f64> {
        let slope = slope(angle_rad, rate_hz);
        if slope.is_empty() {
            return vec![0.0; angle_rad.len()];
        }
        let tau = 1.0 / (std::f64::consts::TAU * self.corner_hz);
        let mut out = passed(&slope, rate_hz, tau, self.order);
        // of the first sample nothing is known but its neighbour
        out.insert(0, slope[0]);
        out
    }
}

fn slope(angle: &[f64], rate_hz: f64) -> Vec<f64> {
    angle.windows(2).map(|w| (w[1] - w[0]) * rate_hz).collect()
}

/// Low passes of the first order, one after the other, as they go.
pub struct Passes {
    state: [f64; 2],
    share: f64,
    order: usize,
}

impl Passes {
    /// * `start` what they hold
    /// * `step` over their time constant
    pub fn new(start: f64, step: f64, order: usize) -> Self {
        Self {
            state: [start; 2],
            share: 1.0 - (-step).exp(),
            order,
        }
    }

    pub fn step(&mut self, x: f64) {
        self.state[0] += self.share * (x - self.state[0]);
        self.state[1] += self.share * (self.state[0] - self.state[1]);
    }

    pub fn value(&self) -> f64 {
        self.state[self.order - 1]
    }
}

/// A slope through low passes, at each sample's end.
fn passed(slope: &[f64], rate_hz: f64, tau: f64, order: usize) -> Vec<f64> {
    let steps = (STEPS_HZ / rate_hz).ceil().max(1.0);
    let mut passes = Passes::new(slope[0], 1.0 / (rate_hz * steps * tau.max(1e-9)), order);
    let through = |x: &f64| {
        (0..steps as usize).for_each(|_| passes.step(*x));
        passes.value()
    };
    slope.iter().map(through).collect()
}

/// Takes a speed that is made of the angle out of the bench and its runs; a controller that is known acts on it all the same.
pub fn leave_out(bench: &mut Bench, runs: &mut [Run]) {
    let delay = |c: BenchChannel| bench.channel(c).map_or(0.0, |s| s.delay_s);
    let said = delay(BenchChannel::Velocity) - delay(BenchChannel::Position);
    let Some(made) = made_of_angle(runs, bench.own, said) else {
        return;
    };
    bench.made_of_angle = Some(made);
    let at = bench.channels.iter().position(|c| c.channel == BenchChannel::Velocity);
    let spec = at.map(|i| bench.channels.remove(i));
    let known = bench.rig.controller.is_some();
    bench.law_speed = spec.filter(|_| known);
    for r in runs {
        r.law_speed = r.leave_out(BenchChannel::Velocity).filter(|_| known);
    }
}

/// What the speed of the runs is made by, where a low pass of the angle's slope leaves far less of it than a delay does.
///
/// * `own`, `said` as in [`low_pass`]
fn made_of_angle(runs: &[Run], own: bool, said: f64) -> Option<LowPass> {
    let both = |r: &Run| -> Option<Pair> {
        let x = r.channel(BenchChannel::Position)?;
        Some(Pair {
            rate_hz: r.rate_hz,
            slope: slope(x, r.rate_hz),
            speed: r.channel(BenchChannel::Velocity)?[1..].to_vec(),
        })
    };
    let pairs: Option<Vec<Pair>> = runs
        .iter()
        .filter(|r| !r.steady && r.duration_s() > 4.0 * SETTLED_S)
        .map(both)
        .collect();
    let pairs = pairs.filter(|p| !p.is_empty())?;
    let (order, tau) = low_pass(&pairs, own, said)?;
    let gaps = pairs.iter().flat_map(|p| {
        let from = p.settled();
        let made = p.passed(tau, order);
        (from..p.speed.len()).map(move |k| p.speed[k] - made[k])
    });
    let (squares, samples) = gaps.fold((0.0, 0), |(e, n), gap| (e + gap * gap, n + 1));
    Some(LowPass {
        order,
        corner_hz: 1.0 / (std::f64::consts::TAU * tau),
        left_rad_per_s: (squares / f64::from(samples.max(1))).sqrt(),
    })
}

/// Order and time constant of the low pass that makes the speeds of the angles' slopes.
///
/// * `own` of an actuator of ours: only a share of what a delay leaves tells
/// * `said` delay of the speed behind the angle that the bench says [s]: of a sensor that is late, and no more than that
fn low_pass(pairs: &[Pair], own: bool, said: f64) -> Option<(usize, f64)> {
    let left = |of: &dyn Fn(&Pair) -> Vec<f64>| pairs.iter().map(|p| p.left(&of(p))).sum::<f64>();
    let (_, delayed) = least(&|t| left(&|p| p.delayed(t)));
    let passes = [1, 2].map(|order| {
        let (tau, rest) = least(&|tau| left(&|p| p.passed(tau, order)));
        (order, tau, rest)
    });
    let (order, tau, rest) = passes.into_iter().min_by(|a, b| a.2.total_cmp(&b.2))?;
    let means: usize = pairs.iter().map(Pair::means).sum();
    let gain = 0.5 * means as f64 * (delayed / rest.max(1e-300)).ln();
    let is_late = left(&|p| p.delayed(said.max(0.0))) > LATE * delayed;
    let is_clear = is_late && (rest < SHARE * SHARE * delayed || !own && gain > CERTAIN);
    if !is_clear || order as f64 * tau <= LEAST_LAG_S {
        return None;
    }
    Some((order, tau))
}

/// Time of the least cost, and that cost.
fn least(cost: &dyn Fn(f64) -> f64) -> (f64, f64) {
    let ratio = (TO_S / FROM_S).powf(1.0 / (TRIED - 1) as f64);
    let all = (0..TRIED).map(|k| FROM_S * ratio.powi(k as i32)).map(|t| (t, cost(t)));
    let best = |a: (f64, f64), b: (f64, f64)| if b.1 < a.1 { b } else { a };
    let coarse = all.fold((0.0, cost(0.0)), best);
    let around = (-4..=4).map(|k| coarse.0 * ratio.powf(0.2 * f64::from(k)));
    around.map(|t| (t, cost(t))).fold(coarse, best)
}

/// The angle's slope over each sample, and the speed at its end.
struct Pair {
    rate_hz: f64,
    slope: Vec<f64>,
    speed: Vec<f64>,
}

impl Pair {
    /// The slope some time ago; of its sample's middle.
    fn delayed(&self, t: f64) -> Vec<f64> {
        let last = self.slope.len() - 1;
        let at = |k: usize| {
            let x = (k as f64 + 0.5 - t * self.rate_hz).clamp(0.0, last as f64);
            let j = (x as usize).min(last.saturating_sub(1));
            self.slope[j] + (x - j as f64) * (self.slope[(j + 1).min(last)] - self.slope[j])
        };
        (0..self.slope.len()).map(at).collect()
    }

    /// The slope through low passes, at each sample's end.
    fn passed(&self, tau: f64, order: usize) -> Vec<f64> {
        passed(&self.slope, self.rate_hz, tau, order)
    }

    /// The first sample that is compared.
    fn settled(&self) -> usize {
        (SETTLED_S * self.rate_hz) as usize
    }

    /// Samples of a mean.
    fn samples(&self) -> usize {
        ((MEAN_S * self.rate_hz) as usize).max(3)
    }

    /// Means that are compared.
    fn means(&self) -> usize {
        let m = self.samples();
        (self.speed.len() / m).saturating_sub(self.settled().div_ceil(m))
    }

    /// Squares of the means of what is left of the speed.
    fn left(&self, of: &[f64]) -> f64 {
        let m = self.samples();
        let settled = self.settled().div_ceil(m);
        let mean = |k: usize| (k..k + m).map(|k| self.speed[k] - of[k]).sum::<f64>() / m as f64;
        (settled..self.speed.len() / m).map(|k| mean(k * m).powi(2)).sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Jumps of a motor's speed, its angle in counts of 16 bit, and what a sensor says of the speed.
    fn jumps(rate_hz: f64, speed: impl Fn(&[f64]) -> Vec<f64>) -> Pair {
        counted(rate_hz, 65536.0, speed)
    }

    /// The same of any counts a turn.
    fn counted(rate_hz: f64, counts: f64, speed: impl Fn(&[f64]) -> Vec<f64>) -> Pair {
        let fine = 2e4;
        let n = 40_000;
        let w: Vec<f64> = (0..n)
            .map(|k| {
                let t = f64::from(k) / fine;
                300.0 * (3.0 * t).sin() + 200.0 * (1.0 - (-((t * 5.0).fract() / 0.02)).exp())
            })
            .collect();
        let count = std::f64::consts::TAU / counts;
        let mut angle = 0.0;
        let theta: Vec<f64> = w
            .iter()
            .map(|w| {
                angle += w / fine;
                (angle / count).round() * count
            })
            .collect();
        let every = (fine / rate_hz) as usize;
        let seen = speed(&w);
        let at = |x: &[f64]| -> Vec<f64> { x.iter().skip(every - 1).step_by(every).copied().collect() };
        let theta = at(&theta);
        Pair {
            rate_hz,
            slope: theta.windows(2).map(|w| (w[1] - w[0]) * rate_hz).collect(),
            speed: at(&seen)[1..].to_vec(),
        }
    }

    fn rests(p: &Pair) -> [f64; 3] {
        let delay = least(&|t| p.left(&p.delayed(t))).1;
        let pass = |order: usize| least(&|t| p.left(&p.passed(t, order))).1;
        [delay, pass(1), pass(2)]
    }

    #[test]
    fn prop_a_low_pass_that_began_before_the_run_is_told_from_a_delay() {
        let tau = 1.0 / (std::f64::consts::TAU * 210.0);
        let p = jumps(2000.0, |w| passed(w, 2e4, tau, 2));
        let piece = |from: usize| Pair {
            rate_hz: p.rate_hz,
            slope: p.slope[from..from + 200].to_vec(),
            speed: p.speed[from..from + 200].to_vec(),
        };
        let pieces: Vec<Pair> = (0..19).map(|k| piece(200 * k)).collect();
        let rest = |of: &dyn Fn(&Pair, f64) -> Vec<f64>| least(&|t| pieces.iter().map(|p| p.left(&of(p, t))).sum()).1;
        let [delay, two] = [rest(&|p, t| p.delayed(t)), rest(&|p, t| p.passed(t, 2))];
        assert!(two < 0.5 * SHARE * SHARE * delay, "{delay} {two}");
    }

    #[test]
    fn prop_a_low_pass_is_told_from_a_delay() {
        for rate_hz in [1000.0, 2000.0, 10_000.0] {
            for order in [1, 2] {
                let p = jumps(rate_hz, |w| {
                    passed(w, 2e4, 1.0 / (std::f64::consts::TAU * 150.0), order)
                });
                let [delay, one, two] = rests(&p);
                let (right, wrong) = if order == 1 { (one, two) } else { (two, one) };
                assert!(
                    right < SHARE * SHARE * delay && right < wrong,
                    "{rate_hz} {order}: {delay} {one} {two}"
                );
            }
            let late = jumps(rate_hz, |w| (0..w.len()).map(|k| w[k.saturating_sub(30)]).collect());
            let [delay, one, two] = rests(&late);
            assert!(one.min(two) > SHARE * SHARE * delay, "{rate_hz}: {delay} {one} {two}");
        }
    }

    #[test]
    fn prop_a_coarse_angle_makes_no_low_pass_of_a_sensor_of_its_own() {
        for rate_hz in [2000.0, 5000.0] {
            // a low pass takes the grain of 60 counts a turn: nearer than any delay, and still not what the sensor is
            let own = counted(rate_hz, 60.0, <[f64]>::to_vec);
            let [delay, one, two] = rests(&own);
            assert!(one.min(two) < SHARE * SHARE * delay, "{rate_hz}: {delay} {one} {two}");
            assert_eq!(low_pass(std::slice::from_ref(&own), false, 0.0), None, "{rate_hz}");
            assert_eq!(low_pass(&[own], true, 0.0), None, "{rate_hz}");
            // late by what the bench says of it
            let late = counted(rate_hz, 60.0, |w| {
                (0..w.len()).map(|k| w[k.saturating_sub(30)]).collect()
            });
            assert_eq!(low_pass(&[late], false, 1.5e-3), None, "{rate_hz}");
            let tau = 1.0 / (std::f64::consts::TAU * 150.0);
            let made = counted(rate_hz, 65536.0, |w| passed(w, 2e4, tau, 1));
            assert!(low_pass(&[made], true, 0.0).is_some_and(|m| m.0 == 1), "{rate_hz}");
        }
    }
}
