//! What the tests of a unit report: when, with which outcome, and how far off.

use super::random::{Random, heavy_from_normal, heavy_sum_median};

/// Stated coverage of every interval.
pub const COVERAGE: f64 = 0.95;

/// Start of every unit's history: 2025-01-01T06:00:00Z (seconds since 1970).
pub const FIRST_TEST: i64 = 1_735_711_200;

/// Parts of the tests that are missing, unexplained and wrong.
const MISSING: f64 = 0.10;
const UNEXPLAINED: f64 = 0.02;
const WRONG: f64 = 0.003;

/// Standard deviation of the logarithm of the widths.
const WIDTH_SCATTER: f64 = 0.25;

/// Standard deviation of the interval's centre about the estimate (part of the
/// width).
const OFF_CENTRE: f64 = 0.03;

/// How far a wrong estimate is off (part of the value, or of the threshold for
/// a fault that starts at zero).
const WRONG_BY: f64 = 0.30;

/// How good the diagnoses are.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Noise {
    /// Width 0.36 %, error 0.055 % (medians), 30 % of the variance common.
    Bench,
    /// Width 4.9 %, error 0.62 % (medians), 85 % of the variance common.
    Fleet,
}

impl Noise {
    /// Name of the noise in the key.
    pub fn name(self) -> &'static str {
        match self {
            Noise::Bench => "bench",
            Noise::Fleet => "fleet",
        }
    }

    /// Median width of the interval (part of the value).
    pub fn width(self) -> f64 {
        match self {
            Noise::Bench => 0.0036,
            Noise::Fleet => 0.049,
        }
    }

    /// Median magnitude of the estimate's error (part of the value).
    pub fn error(self) -> f64 {
        match self {
            Noise::Bench => 0.000_55,
            Noise::Fleet => 0.0062,
        }
    }

    /// Part of the error variance that is common to all tests of a unit.
    pub fn common(self) -> f64 {
        match self {
            Noise::Bench => 0.30,
            Noise::Fleet => 0.85,
        }
    }
}

/// What a test concluded.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Outcome {
    /// The fault was located: every fault has a reading.
    Located,
    /// Nothing explained the measurement: no readings.
    Unexplained,
}

impl Outcome {
    /// Name of the outcome in the history.
    pub fn name(self) -> &'static str {
        match self {
            Outcome::Located => "located",
            Outcome::Unexplained => "unexplained",
        }
    }
}

/// One fault's reading in one test, in the fault's own unit.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Reading {
    /// Lower end of the interval.
    pub low: f64,
    /// Upper end of the interval.
    pub high: f64,
    /// The estimate.
    pub estimate: f64,
}

/// One test.
#[derive(Debug, Clone, PartialEq)]
pub struct Test {
    /// Flight number, from 1 at the start of the unit's history.
    pub flight: u32,
    /// When the test was made (seconds since 1970, UTC).
    pub time: i64,
    /// What it concluded.
    pub outcome: Outcome,
    /// Whether the located reading is a wrong one.
    pub wrong: bool,
    /// Readings in the order of the unit's faults; empty when unexplained.
    pub readings: Vec<Reading>,
}

/// What happens to the test of a flight.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Fate {
    /// It is not made.
    Missing,
    /// It is made and explains nothing.
    Unexplained,
    /// It is made and wrong.
    Wrong,
    /// It is made and right.
    Right,
}

/// The fate of one test.
pub fn draw_fate(random: &mut Random) -> Fate {
    let x = random.unit();
    if x < MISSING {
        Fate::Missing
    } else if x < MISSING + UNEXPLAINED {
        Fate::Unexplained
    } else if x < MISSING + UNEXPLAINED + WRONG {
        Fate::Wrong
    } else {
        Fate::Right
    }
}

/// Times of flights 1, 2, ... `flights` (seconds since 1970): from one to six
/// flights a day, spread from six in the morning on.
pub fn draw_times(flights: u32, random: &mut Random) -> Vec<i64> {
    const DAY: i64 = 86_400;
    let mut times = Vec::new();
    let mut day = 0;
    while times.len() < flights as usize {
        let today = random.whole(1, 6);
        for flight in 0..today {
            let late = if times.is_empty() {
                0
            } else {
                i64::from(random.whole(0, 2400))
            };
            let spread = i64::from(flight) * 15 * 3600 / i64::from(today);
            times.push(FIRST_TEST + day * DAY + spread + late);
        }
        day += 1;
    }
    times.truncate(flights as usize);
    times
}

/// How errors and widths scale with the value read.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Scale {
    /// In proportion to the value.
    Relative,
    /// The same at all values: those of a relative reading of this value.
    Absolute(f64),
}

/// The instrument that reads one fault of one unit.
#[derive(Debug, Clone)]
pub struct Reader {
    noise: Noise,
    scale: Scale,
    threshold: f64,
    /// Standard deviation of the error (part of the scale).
    sd: f64,
    /// Constant error of the unit (part of the scale).
    pub bias: f64,
    ar1: f64,
    state: f64,
    random: Random,
}

impl Reader {
    /// A reader with a bias of its own. Its other errors are correlated from
    /// flight to flight by `ar1` (0 for white). `threshold` is the fault's
    /// threshold in its own unit.
    pub fn new(noise: Noise, scale: Scale, threshold: f64, ar1: f64, mut random: Random) -> Self {
        let sd = noise.error() / heavy_sum_median(noise.common());
        let bias = sd * noise.common().sqrt() * heavy_from_normal(random.normal());
        let state = random.normal();
        Self {
            noise,
            scale,
            threshold,
            sd,
            bias,
            ar1,
            state,
            random,
        }
    }

    /// The reading of `value` in the next flight; to be called for every
    /// flight in turn, also when the test is missing, so that the errors keep
    /// their correlation in flights. The errors are correlated as a normal
    /// AR(1) process and then given the tails of a t distribution.
    pub fn read(&mut self, value: f64, wrong: bool) -> Reading {
        let kick = (1.0 - self.ar1 * self.ar1).sqrt();
        self.state = self.ar1 * self.state + kick * self.random.normal();
        let own = self.sd * (1.0 - self.noise.common()).sqrt() * heavy_from_normal(self.state);
        let error = self.bias + own;
        let stretch = (WIDTH_SCATTER * self.random.normal()).exp();
        let off = OFF_CENTRE * self.random.normal();
        let upwards = self.random.chance(0.5);

        let (estimate, unit) = match self.scale {
            Scale::Relative => {
                let sign = if upwards { 1.0 } else { -1.0 };
                let astray = if wrong { 1.0 + sign * WRONG_BY } else { 1.0 };
                let estimate = value * astray * (1.0 + error);
                (estimate, estimate)
            }
            Scale::Absolute(unit) => {
                let by = WRONG_BY * self.threshold;
                let sign = if upwards || value < by { 1.0 } else { -1.0 };
                let astray = if wrong { sign * by } else { 0.0 };
                (value + astray + error * unit, unit)
            }
        };
        let width = self.noise.width() * stretch * unit;
        let centre = estimate + off * width;
        Reading {
            low: centre - 0.5 * width,
            high: centre + 0.5 * width,
            estimate,
        }
    }
}
