//! The laws by which damage grows.
//!
//! Damage here is a fraction of the threshold damage: a life starts near 0 and
//! ends where the fraction first reaches 1. Time is the flight count, a real
//! number that starts at 0; flight n ends at time n.

use std::f64::consts::PI;

use super::random::Random;

/// Shortest and longest life a fleet may hold (flights).
pub const LIFE_RANGE: (f64, f64) = (60.0, 400.0);

/// Step of the simulation (flights).
const STEP: f64 = 0.1;

/// A path that has not ended by this time is given up (flights).
const TOO_LONG: f64 = 1000.0;

/// Standard deviation of the logarithm of a wandering rate.
const RATE_SD: f64 = 0.25;

/// A law of growth with the parameters that give it its form; the rate is set
/// by the life aimed at, see [`Law::simulate`].
#[derive(Debug, Clone, PartialEq)]
pub enum Law {
    /// No growth at first, then gamma increments of a constant mean rate.
    Linear {
        /// Part of the life aimed at without growth.
        incubation: f64,
        /// Coefficient of variation of the growth in one flight.
        cv: f64,
    },
    /// du/dt = r(t) (u + offset), the logarithm of r an Ornstein-Uhlenbeck
    /// process.
    Exponential {
        /// Offset of the damage (part of the threshold damage).
        offset: f64,
        /// Correlation time of the log rate (part of the life aimed at).
        correlation: f64,
    },
    /// u proportional to t^exponent, its rate wavering smoothly.
    Power {
        /// Exponent of time.
        exponent: f64,
        /// Standard deviation of the log rate.
        noise_sd: f64,
        /// Correlation length of the log rate (part of the life aimed at).
        noise_length: f64,
    },
    /// A compound Poisson process: jumps and nothing in between.
    Stepwise {
        /// Mean number of jumps in the life aimed at.
        jumps: f64,
        /// Shape of the gamma distribution of the sizes; 1 is exponential.
        size_shape: f64,
    },
    /// Linear growth by gamma increments whose rate multiplies once.
    Regime {
        /// Coefficient of variation of the growth in one flight.
        cv: f64,
        /// What the rate multiplies by.
        factor: f64,
        /// When the rate multiplies (part of the life aimed at).
        change: f64,
    },
    /// du/dt = r(t) (u + offset)^exponent, log r as in `Exponential`.
    Paris {
        /// Offset of the damage (part of the threshold damage).
        offset: f64,
        /// Exponent of the damage.
        exponent: f64,
        /// Correlation time of the log rate (part of the life aimed at).
        correlation: f64,
    },
    /// Mildly noisy linear growth whose rate triples once.
    Triple {
        /// When the rate triples (part of the life aimed at).
        change: f64,
    },
}

impl Law {
    /// One of the six laws of the ordinary fleet, evenly, with its parameters.
    pub fn draw(random: &mut Random) -> Self {
        match random.whole(0, 5) {
            0 => Law::Linear {
                incubation: random.uniform(0.0, 0.35),
                cv: random.uniform(0.2, 1.5),
            },
            1 => Law::Exponential {
                offset: random.uniform(0.02, 0.06),
                correlation: random.uniform(0.2, 0.5),
            },
            2 => Law::Power {
                exponent: random.log_uniform(0.5, 3.0),
                noise_sd: random.uniform(0.05, 0.15),
                noise_length: random.uniform(0.1, 0.3),
            },
            3 => Law::Stepwise {
                jumps: random.uniform(12.0, 40.0),
                size_shape: if random.chance(0.5) {
                    1.0
                } else {
                    random.uniform(1.5, 5.0)
                },
            },
            4 => Law::Regime {
                cv: random.uniform(0.2, 0.5),
                factor: random.uniform(3.0, 8.0),
                change: random.uniform(0.25, 0.70),
            },
            _ => Law::Paris {
                offset: random.uniform(0.02, 0.06),
                exponent: random.uniform(1.2, 1.9),
                correlation: random.uniform(0.2, 0.5),
            },
        }
    }

    /// The law of a unit whose rate triples at a drawn time.
    pub fn draw_triple(random: &mut Random) -> Self {
        Law::Triple {
            change: random.uniform(0.30, 0.60),
        }
    }

    /// The law's name in the key.
    pub fn name(&self) -> &'static str {
        match self {
            Law::Linear { .. } => "linear",
            Law::Exponential { .. } => "exponential",
            Law::Power { .. } => "power",
            Law::Stepwise { .. } => "stepwise",
            Law::Regime { .. } => "regime",
            Law::Paris { .. } => "paris",
            Law::Triple { .. } => "triple",
        }
    }

    /// The law's parameters by name; offsets are parts of the threshold damage,
    /// times are parts of the life aimed at.
    pub fn parameters(&self) -> Vec<(&'static str, f64)> {
        match *self {
            Law::Linear { incubation, cv } => vec![("incubation", incubation), ("cv", cv)],
            Law::Exponential { offset, correlation } => {
                vec![("offset", offset), ("rate_sd", RATE_SD), ("correlation", correlation)]
            }
            Law::Power {
                exponent,
                noise_sd,
                noise_length,
            } => vec![
                ("exponent", exponent),
                ("noise_sd", noise_sd),
                ("noise_length", noise_length),
            ],
            Law::Stepwise { jumps, size_shape } => {
                vec![("jumps", jumps), ("size_shape", size_shape)]
            }
            Law::Regime { cv, factor, change } => {
                vec![("cv", cv), ("factor", factor), ("change", change)]
            }
            Law::Paris {
                offset,
                exponent,
                correlation,
            } => vec![
                ("offset", offset),
                ("exponent", exponent),
                ("rate_sd", RATE_SD),
                ("correlation", correlation),
            ],
            Law::Triple { change } => vec![("cv", 0.3), ("factor", 3.0), ("change", change)],
        }
    }

    /// Time at which the growth changes its rate, for a life aimed at of
    /// `target` flights: the change of a regime or the end of an incubation.
    pub fn change_time(&self, target: f64) -> Option<f64> {
        match *self {
            Law::Linear { incubation, .. } => Some(incubation * target),
            Law::Regime { change, .. } | Law::Triple { change } => Some(change * target),
            _ => None,
        }
    }

    /// Whether the change of rate falls in the part of the true life it should
    /// fall in, when a life aimed at of `target` flights came out as `life`.
    fn well_placed(&self, target: f64, life: f64) -> bool {
        let (low, high) = match self {
            Law::Linear { .. } => (0.0, 0.35),
            Law::Regime { .. } => (0.25, 0.70),
            Law::Triple { .. } => (0.30, 0.60),
            _ => return true,
        };
        self.change_time(target)
            .is_some_and(|t| (low..=high).contains(&(t / life)))
    }

    /// One path of damage from `start` (part of the threshold damage) until it
    /// reaches 1, at rates that aim at a life of `target` flights.
    pub fn simulate(&self, start: f64, target: f64, random: &mut Random) -> Path {
        let span = 1.0 - start;
        match *self {
            Law::Linear { incubation, cv } => {
                let from = incubation * target;
                let rate = span / (target - from);
                gamma_path(start, cv, from, 0.0, rate, random)
            }
            Law::Exponential { offset, correlation } => {
                let rate = ((1.0 + offset) / (start + offset)).ln() / target;
                let wander = correlation * target;
                feedback_path(start, offset, 1.0, rate, wander, random)
            }
            Law::Power {
                exponent,
                noise_sd,
                noise_length,
            } => {
                let waver = Waver::draw(noise_sd, noise_length * target, random);
                power_path(start, target, exponent, &waver)
            }
            Law::Stepwise { jumps, size_shape } => {
                let mut path = Path::new(start, true);
                let (mut t, mut u) = (0.0, start);
                while path.open() {
                    t += random.exponential(target / jumps);
                    u += random.gamma(size_shape, span / jumps / size_shape);
                    path.push(t, u);
                }
                path
            }
            Law::Regime { cv, factor, change } => changing_path(start, target, cv, factor, change, random),
            Law::Paris {
                offset,
                exponent,
                correlation,
            } => {
                let power = 1.0 - exponent;
                let reach = (start + offset).powf(power) - (1.0 + offset).powf(power);
                let rate = reach / (exponent - 1.0) / target;
                let wander = correlation * target;
                feedback_path(start, offset, exponent, rate, wander, random)
            }
            Law::Triple { change } => changing_path(start, target, 0.3, 3.0, change, random),
        }
    }
}

/// Gamma increments whose mean rate (per flight) is `before` until time `from`
/// and `after` from then on; `cv` is that of the growth in one flight.
fn gamma_path(start: f64, cv: f64, from: f64, before: f64, after: f64, random: &mut Random) -> Path {
    let mut path = Path::new(start, false);
    let (mut t, mut u) = (0.0, start);
    let mut grid = 0u32;
    while path.open() {
        let next = f64::from(grid + 1) * STEP;
        let end = if t < from && from < next { from } else { next };
        let rate = if t < from { before } else { after };
        if rate > 0.0 && end > t {
            u += random.gamma((end - t) / (cv * cv), rate * cv * cv);
        }
        path.push(end, u);
        t = end;
        if end == next {
            grid += 1;
        }
    }
    path
}

/// Linear growth whose rate multiplies by `factor` at `change` (part of the
/// life aimed at).
fn changing_path(start: f64, target: f64, cv: f64, factor: f64, change: f64, random: &mut Random) -> Path {
    let before = (1.0 - start) / (target * (change + factor * (1.0 - change)));
    gamma_path(start, cv, change * target, before, before * factor, random)
}

/// du/dt = r(t) (u + offset)^exponent with log r an Ornstein-Uhlenbeck process
/// about log `rate` of correlation time `wander` (flights).
fn feedback_path(start: f64, offset: f64, exponent: f64, rate: f64, wander: f64, random: &mut Random) -> Path {
    let mut path = Path::new(start, false);
    let keep = (-STEP / wander).exp();
    let kick = RATE_SD * (1.0 - keep * keep).sqrt();
    let mut log_rate = RATE_SD * random.normal();
    let mut u = start;
    let mut step = 0u32;
    while path.open() {
        let r = rate * log_rate.exp();
        let slope = |u: f64| r * (u + offset).powf(exponent);
        let middle = u + 0.5 * STEP * slope(u);
        u += STEP * slope(middle);
        step += 1;
        path.push(f64::from(step) * STEP, u);
        log_rate = keep * log_rate + kick * random.normal();
    }
    path
}

/// Growth in proportion to t^exponent, each step of it stretched by the waver.
fn power_path(start: f64, target: f64, exponent: f64, waver: &Waver) -> Path {
    let mut path = Path::new(start, false);
    let mut u = start;
    let mut step = 0u32;
    while path.open() {
        let (from, to) = (f64::from(step) * STEP, f64::from(step + 1) * STEP);
        let growth = (to / target).powf(exponent) - (from / target).powf(exponent);
        u += (1.0 - start) * growth * waver.at(0.5 * (from + to)).exp();
        path.push(to, u);
        step += 1;
    }
    path
}

/// A smooth random function of time: a sum of waves of random frequencies.
struct Waver {
    waves: Vec<(f64, f64)>,
    height: f64,
}

impl Waver {
    const WAVES: usize = 12;

    fn draw(sd: f64, length: f64, random: &mut Random) -> Self {
        let waves = (0..Self::WAVES)
            .map(|_| (random.normal() / length, random.uniform(0.0, 2.0 * PI)))
            .collect();
        let height = sd * (2.0 / Self::WAVES as f64).sqrt();
        Self { waves, height }
    }

    fn at(&self, t: f64) -> f64 {
        let sum: f64 = self.waves.iter().map(|(w, p)| (w * t + p).cos()).sum();
        self.height * sum
    }
}

/// A path of damage: knots in time, joined by straight lines or by steps.
#[derive(Debug, Clone)]
pub struct Path {
    times: Vec<f64>,
    damages: Vec<f64>,
    stepped: bool,
}

impl Path {
    fn new(start: f64, stepped: bool) -> Self {
        Self {
            times: vec![0.0],
            damages: vec![start],
            stepped,
        }
    }

    fn push(&mut self, time: f64, damage: f64) {
        self.times.push(time);
        self.damages.push(damage);
    }

    /// Whether the path still has to go on.
    fn open(&self) -> bool {
        let last = self.times.len() - 1;
        self.damages[last] < 1.0 && self.times[last] < TOO_LONG
    }

    /// Damage at time `t` (flights), as a part of the threshold damage; past
    /// the end of the path, the damage at its end.
    pub fn at(&self, t: f64) -> f64 {
        let after = self.times.partition_point(|&knot| knot <= t);
        let last = after.saturating_sub(1);
        if self.stepped || after == self.times.len() {
            return self.damages[last];
        }
        let part = (t - self.times[last]) / (self.times[after] - self.times[last]);
        self.damages[last] + part * (self.damages[after] - self.damages[last])
    }

    /// Time at which the damage first reaches the threshold (flights), if it
    /// does.
    pub fn life(&self) -> Option<f64> {
        let end = self.times.len() - 1;
        if self.damages[end] < 1.0 {
            return None;
        }
        if self.stepped || end == 0 {
            return Some(self.times[end]);
        }
        let (from, to) = (self.damages[end - 1], self.damages[end]);
        let part = (1.0 - from) / (to - from);
        Some(self.times[end - 1] + part * (self.times[end] - self.times[end - 1]))
    }
}

/// One stretch of wear, from new (or repaired) to the threshold.
#[derive(Debug, Clone)]
pub struct Wear {
    /// Damage at the start (part of the threshold damage).
    pub start: f64,
    /// The life aimed at (flights from the start of this wear).
    pub target: f64,
    /// The true life (flights from the start of this wear).
    pub life: f64,
    /// Time of the change of rate, if the law has one (flights from the start
    /// of this wear).
    pub change: Option<f64>,
    /// The path of the damage.
    pub path: Path,
}

impl Wear {
    /// A whole life by `law` that starts at damage `start` (part of the
    /// threshold damage). The life aimed at is log-uniform over
    /// [`LIFE_RANGE`]; it is drawn again, with the noise, when the true life
    /// leaves that range, is under `least` flights, or puts the change of rate
    /// outside its part of the life.
    pub fn draw(law: &Law, start: f64, least: f64, random: &mut Random) -> Self {
        loop {
            let target = random.log_uniform(LIFE_RANGE.0, LIFE_RANGE.1);
            let path = law.simulate(start, target, random);
            let Some(life) = path.life() else { continue };
            let fits = (LIFE_RANGE.0.max(least)..=LIFE_RANGE.1).contains(&life);
            if fits && law.well_placed(target, life) {
                return Self {
                    start,
                    target,
                    life,
                    change: law.change_time(target),
                    path,
                };
            }
        }
    }

    /// A life by `law` that was cut short by a repair after `flights` flights,
    /// at a damage of 15 to 90 % of the threshold damage.
    pub fn draw_repaired(law: &Law, flights: u32, random: &mut Random) -> Self {
        let flights = f64::from(flights);
        loop {
            let target = random.log_uniform(flights, 3.0 * flights);
            let path = law.simulate(0.0, target, random);
            let Some(life) = path.life() else { continue };
            if life > flights && (0.15..=0.90).contains(&path.at(flights)) {
                return Self {
                    start: 0.0,
                    target,
                    life,
                    change: law.change_time(target).filter(|&t| t < flights),
                    path,
                };
            }
        }
    }
}
