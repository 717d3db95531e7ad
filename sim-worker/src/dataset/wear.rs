//! Fleets that wear: how the faults of each actuator grow from test to test, in a plan's section `[wear]`.
//!
//! The damage u of a fault is 0 in a new actuator and 1 at the level that ends its life. Flight by flight it grows as a [`WearLaw`]
//! says, with scatter, so that one law gives every actuator another path. Levels, lives and laws are of the plan; how laws run is
//! assumed. A prognosis that is tested on such fleets is tested on growth that is not its own equation in four of seven laws.

use super::draw::random;
use crate::parameters::ActuatorParameters;
use crate::spread::{Cause, Spread};
use arrow::compute::kernels::cast_utils::string_to_timestamp_nanos;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, Gamma, Poisson, StandardNormal};
use schemas::error::Result;
use schemas::fault::FaultState;
use schemas::fingerprint::exact;
use schemas::toml_section::Section;
use std::f64::consts::TAU;
use std::sync::{Arc, OnceLock};

/// Most flights of a plan.
const MOST_FLIGHTS: f64 = 20_000.0;

/// An actuator is followed for so many times the flights of the plan: ends of lives are true also where no test saw them.
const BEYOND: u64 = 4;

/// Days of a year.
const YEAR_DAYS: f64 = 365.25;

/// The day on which seasons are coldest: the middle of January.
const COLDEST_DAY: f64 = 15.0;

/// Jumps of a life by the law of jumps.
const JUMPS: f64 = 12.0;

/// How damage grows over the share x of the life, from 0 at x = 0 to 1 at x = 1 in the mean.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum WearLaw {
    /// u = x
    Linear,
    /// u = (e^(3 x) - 1) / (e^3 - 1)
    Exponential,
    /// u = x^p, p drawn from 0.6 to 2.5
    Power,
    /// running in, steady wear, wearing out: u = 0.15 (1 - e^(-20 x)) + 0.5 x + 0.35 (e^(6 x) - 1) / (e^6 - 1)
    ThreeStage,
    /// four times as fast from a moment on that is drawn from 0.4 to 0.8 of the life
    TwoPhase,
    /// slow, fast, slow: a logistic curve around 0.6 of the life
    Logistic,
    /// jumps of random sizes at random flights, twelve a life, and nothing between
    Stepwise,
}

impl WearLaw {
    /// All, in the order of the help.
    pub const ALL: [Self; 7] = [
        Self::Linear,
        Self::Exponential,
        Self::Power,
        Self::ThreeStage,
        Self::TwoPhase,
        Self::Logistic,
        Self::Stepwise,
    ];

    /// In plans.
    pub fn name(self) -> &'static str {
        match self {
            Self::Linear => "linear",
            Self::Exponential => "exponential",
            Self::Power => "power",
            Self::ThreeStage => "three-stage",
            Self::TwoPhase => "two-phase",
            Self::Logistic => "logistic",
            Self::Stepwise => "stepwise",
        }
    }

    /// Mean damage at the share `x` of the life, 0 and above.
    ///
    /// * `shape` of the actuator, 0 to 1: power, or moment of the change
    fn mean(self, x: f64, shape: f64) -> f64 {
        match self {
            Self::Linear | Self::Stepwise => x,
            Self::Exponential => (3.0 * x).exp_m1() / 3f64.exp_m1(),
            Self::Power => x.powf(0.6 + 1.9 * shape),
            Self::ThreeStage => 0.15 * -(-20.0 * x).exp_m1() + 0.5 * x + 0.35 * (6.0 * x).exp_m1() / 6f64.exp_m1(),
            Self::TwoPhase => {
                let change = 0.4 + 0.4 * shape;
                (x + 3.0 * (x - change).max(0.0)) / (change + 4.0 * (1.0 - change))
            }
            Self::Logistic => {
                let s = |x: f64| 1.0 / (1.0 + (-(x - 0.6) / 0.12).exp());
                (s(x) - s(0.0)) / (s(1.0) - s(0.0))
            }
        }
    }
}

/// From one number to another, drawn alike.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Between(f64, f64);

impl Between {
    fn draw(self, rng: &mut ChaCha8Rng) -> f64 {
        if self.0 < self.1 {
            rng.random_range(self.0..self.1)
        } else {
            self.0
        }
    }

    /// A number, or `{ from, to }`.
    fn from_plan(s: &mut Section, key: &str, default: Option<f64>, (least, most): (f64, f64)) -> Result<Self> {
        let allowed = format!("{least} to {most}");
        let ok = |x: f64| (least..=most).contains(&x);
        if s.may_have(key) && s.is_section(key) {
            let mut t = s.section(key)?;
            let from = t.number("from", ok, &allowed)?;
            let to = t.number("to", |x| ok(x) && x >= from, &format!("{from} to {most}"))?;
            t.finish()?;
            return Ok(Self(from, to));
        }
        let one = match default {
            Some(d) => s.number_or(key, d, ok, &allowed)?,
            None => s.number(key, ok, &allowed)?,
        };
        Ok(Self(one, one))
    }
}

/// How one fault grows.
#[derive(Clone, Debug, PartialEq)]
struct FaultWear {
    laws: Vec<WearLaw>,
    /// level that ends a life
    threshold: f64,
    /// flights from the onset to the threshold in the mean
    life_flights: Between,
    /// flights before anything grows
    onset_flights: Between,
    /// standard deviation of the growth over a tenth of the life, over its mean
    scatter: f64,
}

/// Seasons, which warm windings and lubricant [K over the temperature of the actuator's file].
#[derive(Clone, Copy, Debug, PartialEq)]
struct Seasons {
    mean_k: f64,
    /// half of the difference between summer and winter
    yearly_k: f64,
    /// standard deviation from day to day
    daily_k: f64,
}

/// The section `[wear]` of a plan.
#[derive(Clone, Debug, PartialEq)]
pub struct WearPlan {
    /// days since 1970 of the first flight
    from_day: f64,
    /// over which the tests lie
    flights: u64,
    flights_per_day: Between,
    /// share of planned tests that nobody does
    missed: f64,
    /// share of the actuators that are replaced once, and share of those of which it is recorded
    replaced: f64,
    recorded: f64,
    seasons: Option<Seasons>,
    /// FSJ, zeta
    faults: [Option<FaultWear>; 2],
}

/// How the actuators of a plan wear; each life is worked out when it is first asked for.
#[derive(Clone, Debug)]
pub(super) struct Wear {
    pub plan: WearPlan,
    lives: Arc<[OnceLock<WornActuator>]>,
}

impl Wear {
    pub fn new(plan: WearPlan, actuators: usize) -> Self {
        let lives = (0..actuators).map(|_| OnceLock::new()).collect();
        Self { plan, lives }
    }

    /// The life of an actuator by its place, as `life` works it out.
    pub fn life(&self, actuator: usize, life: impl FnOnce(&WearPlan) -> WornActuator) -> &WornActuator {
        self.lives[actuator].get_or_init(|| life(&self.plan))
    }
}

/// A fault of [`WearPlan`]: name in tables, level in a healthy actuator.
const FAULTS: [(&str, f64); 2] = [("fsj", 1.0), ("zeta", 0.0)];

/// One test of an actuator that wears.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WornTest {
    /// flights that the actuator has made, replacements not counted
    pub flight: u64,
    /// days since 1970
    pub day: f64,
    /// how warm the windings are over the actuator's own temperature [K]
    pub warmer_k: f64,
    /// both faults; beyond the grid of the plan they stay at its end
    pub fault: FaultState,
}

/// What happened to an actuator.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Replaced {
    /// the first flight of the new one
    pub flight: u64,
    /// days since 1970
    pub day: f64,
    /// whether anybody wrote it down
    pub is_recorded: bool,
}

/// When a fault passed the level that ends a life, and by which law it grew.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ended {
    /// `fsj` or `zeta`
    pub fault: &'static str,
    /// level
    pub threshold: f64,
    /// law of the last life
    pub law: WearLaw,
    /// flight and day; none where it lives on
    pub at: Option<(f64, f64)>,
}

/// The life of one actuator.
#[derive(Clone, Debug, PartialEq)]
pub struct WornActuator {
    /// in order
    pub tests: Vec<WornTest>,
    /// at most one
    pub replaced: Option<Replaced>,
    /// by fault that wears
    pub ends: Vec<Ended>,
}

/// One fault of one actuator, from its onset on.
struct Growth<'a> {
    of: &'a FaultWear,
    healthy: f64,
    law: WearLaw,
    shape: f64,
    life: f64,
    onset: f64,
    /// flights since it was new
    age: f64,
    damage: f64,
}

impl<'a> Growth<'a> {
    fn new(of: &'a FaultWear, healthy: f64, rng: &mut ChaCha8Rng) -> Self {
        Self {
            of,
            healthy,
            law: of.laws[rng.random_range(0..of.laws.len())],
            shape: rng.random(),
            life: of.life_flights.draw(rng),
            onset: of.onset_flights.draw(rng),
            age: 0.0,
            damage: 0.0,
        }
    }

    /// One more flight.
    fn fly(&mut self, rng: &mut ChaCha8Rng) {
        let share = |age: f64| ((age - self.onset) / self.life).max(0.0);
        let (from, to) = (share(self.age), share(self.age + 1.0));
        self.age += 1.0;
        if to <= 0.0 {
            return;
        }
        if self.law == WearLaw::Stepwise {
            // Gamma(2, 1/2): mean 1
            let jumps = Poisson::new(JUMPS * (to - from)).map_or(0.0, |p| p.sample(rng));
            if jumps > 0.0 {
                let size = Gamma::new(2.0 * jumps, 0.5).map_or(jumps, |g| g.sample(rng));
                self.damage += size / JUMPS;
            }
            return;
        }
        let mean = self.law.mean(to, self.shape) - self.law.mean(from, self.shape);
        // over a tenth of the life: sd = scatter x mean
        let shape = 10.0 * (to - from) / (self.of.scatter * self.of.scatter);
        let factor = if self.of.scatter > 0.0 {
            Gamma::new(shape, 1.0 / shape).map_or(1.0, |g| g.sample(rng))
        } else {
            1.0
        };
        self.damage += mean * factor;
    }

    fn level(&self) -> f64 {
        self.healthy + self.damage * (self.of.threshold - self.healthy)
    }
}

impl WearPlan {
    /// From the section of a plan.
    ///
    /// # Errors
    /// A key or value that it may not have.
    pub fn from_section(mut s: Section) -> Result<Self> {
        const DATE: &str = "a date such as 2025-01-01";
        let from = s.text_or("from", "2025-01-01")?;
        let nanoseconds = string_to_timestamp_nanos(&from).map_err(|_| s.bad("from", &from, DATE))?;
        let flights = s.number(
            "flights",
            |x| x.fract() == 0.0 && (1.0..=MOST_FLIGHTS).contains(&x),
            &format!("a whole number from 1 to {MOST_FLIGHTS}"),
        )?;
        let flights_per_day = Between::from_plan(&mut s, "flights_per_day", Some(4.0), (0.01, 1000.0))?;
        let share = |x: f64| (0.0..=1.0).contains(&x);
        let missed = s.number_or("missed", 0.0, |x| (0.0..=0.9).contains(&x), "0 to 0.9")?;
        let (mut replaced, mut recorded) = (0.0, 1.0);
        if s.may_have("replaced") {
            let mut t = s.section("replaced")?;
            replaced = t.number("share", share, "0 to 1")?;
            recorded = t.number_or("recorded", 1.0, share, "0 to 1")?;
            t.finish()?;
        }
        let mut seasons = None;
        if s.may_have("temperature") {
            let mut t = s.section("temperature")?;
            let span = |x: f64| (0.0..=60.0).contains(&x);
            seasons = Some(Seasons {
                mean_k: t.number_or("mean_k", 0.0, |x| x.abs() <= 60.0, "-60 to 60 K")?,
                yearly_k: t.number_or("yearly_k", 0.0, span, "0 to 60 K")?,
                daily_k: t.number_or("daily_k", 0.0, |x| (0.0..=20.0).contains(&x), "0 to 20 K")?,
            });
            t.finish()?;
        }
        let mut faults = [None, None];
        for (to, (name, healthy)) in faults.iter_mut().zip(FAULTS) {
            if s.may_have(name) {
                *to = Some(FaultWear::from_section(s.section(name)?, name, healthy)?);
            }
        }
        if faults.iter().all(Option::is_none) {
            return Err(s.bad("fsj", "nothing that wears", "[wear.fsj], [wear.zeta] or both"));
        }
        s.finish()?;
        Ok(Self {
            from_day: nanoseconds as f64 / 86_400e9,
            flights: flights as u64,
            flights_per_day,
            missed,
            replaced,
            recorded,
            seasons,
            faults,
        })
    }

    /// Everything that the lives depend on.
    pub(super) fn fingerprint(&self) -> String {
        let number = |x: f64| exact(x);
        let between = |b: Between| format!("{}-{}", exact(b.0), exact(b.1));
        let mut text = format!(
            "wear;{};{};{};{};{};{}",
            number(self.from_day),
            self.flights,
            between(self.flights_per_day),
            number(self.missed),
            number(self.replaced),
            number(self.recorded)
        );
        if let Some(s) = self.seasons {
            text += &format!(";{};{};{}", number(s.mean_k), number(s.yearly_k), number(s.daily_k));
        }
        for (f, (name, _)) in self.faults.iter().zip(FAULTS) {
            let Some(f) = f else { continue };
            let laws: Vec<&str> = f.laws.iter().map(|l| l.name()).collect();
            text += &format!(
                ";{name};{};{};{};{};{}",
                laws.join(","),
                number(f.threshold),
                between(f.life_flights),
                between(f.onset_flights),
                number(f.scatter)
            );
        }
        text
    }

    /// The life of an actuator: the same, whatever else the fleet has.
    ///
    /// * `tests` that are done
    /// * `most` levels of FSJ and zeta at which a test can be simulated
    pub fn life(&self, seed: u64, actuator: &str, tests: usize, most: [f64; 2]) -> WornActuator {
        let mut rng = random(seed, "wear", actuator);
        let rng = &mut rng;
        let per_day = self.flights_per_day.draw(rng);
        let replaced = (rng.random::<f64>() < self.replaced).then(|| {
            let flight = (self.flights as f64 * rng.random_range(0.2..0.8)).ceil() as u64;
            (flight, rng.random::<f64>() < self.recorded)
        });
        let day = |flight: f64| self.from_day + flight / per_day;
        let mut planned = self.planned(tests, rng).into_iter().peekable();
        let grown = |rng: &mut ChaCha8Rng| -> [Option<Growth<'_>>; 2] {
            std::array::from_fn(|k| self.faults[k].as_ref().map(|f| Growth::new(f, FAULTS[k].1, rng)))
        };
        let mut growth = grown(rng);
        let mut out = Vec::with_capacity(tests);
        let mut passed = [None; 2];
        for flight in 0..=BEYOND * self.flights {
            if replaced.is_some_and(|(at, _)| at == flight) {
                growth = grown(rng);
                passed = [None; 2];
            }
            while planned.next_if_eq(&flight).is_some() {
                let level = |k: usize| growth[k].as_ref().map_or(FAULTS[k].1, |g| g.level().min(most[k]));
                let today = day(flight as f64);
                out.push(WornTest {
                    flight,
                    day: today,
                    warmer_k: self.seasons.map_or(0.0, |s| s.warmer_k(today, rng)),
                    fault: FaultState {
                        fsj: level(0),
                        zeta: level(1),
                    },
                });
            }
            for (g, passed) in growth.iter_mut().zip(&mut passed) {
                let Some(g) = g else { continue };
                let before = g.damage;
                g.fly(rng);
                if passed.is_none() && g.damage >= 1.0 {
                    *passed = Some(flight as f64 + (1.0 - before) / (g.damage - before));
                }
            }
            if planned.peek().is_none() && growth.iter().zip(&passed).all(|(g, p)| g.is_none() || p.is_some()) {
                break;
            }
        }
        let ends = growth
            .iter()
            .zip(passed)
            .zip(FAULTS)
            .filter_map(|((g, at), (fault, _))| {
                let g = g.as_ref()?;
                Some(Ended {
                    fault,
                    threshold: g.of.threshold,
                    law: g.law,
                    at: at.map(|flight| (flight, day(flight))),
                })
            });
        WornActuator {
            tests: out,
            replaced: replaced.map(|(flight, is_recorded)| Replaced {
                flight,
                day: day(flight as f64),
                is_recorded,
            }),
            ends: ends.collect(),
        }
    }

    /// Flights before which tests are done: evenly planned, some of them missed.
    fn planned(&self, tests: usize, rng: &mut ChaCha8Rng) -> Vec<u64> {
        let slots = (tests as f64 / (1.0 - self.missed)).round() as usize;
        let mut missed = rand::seq::index::sample(rng, slots, slots - tests).into_vec();
        missed.sort_unstable();
        let done = (0..slots).filter(|k| missed.binary_search(k).is_err());
        done.map(|k| k as u64 * self.flights / slots as u64).collect()
    }
}

impl Seasons {
    fn warmer_k(self, day: f64, rng: &mut ChaCha8Rng) -> f64 {
        let year = ((day - COLDEST_DAY) / YEAR_DAYS).fract();
        let today: f64 = rng.sample(StandardNormal);
        self.mean_k - self.yearly_k * (TAU * year).cos() + self.daily_k * today
    }
}

impl FaultWear {
    fn from_section(mut s: Section, name: &str, healthy: f64) -> Result<Self> {
        let all = || WearLaw::ALL.map(WearLaw::name);
        let mut laws = WearLaw::ALL.to_vec();
        if s.may_have("laws") {
            let allowed = format!("a list of {}", all().join(", "));
            let names = s.texts("laws", &allowed)?;
            let found = names.iter().map(|n| {
                let law = WearLaw::ALL.into_iter().find(|l| l.name() == n);
                law.ok_or_else(|| s.bad("laws", n, &allowed))
            });
            laws = found.collect::<Result<_>>()?;
            if laws.is_empty() {
                return Err(s.bad("laws", "an empty list", &allowed));
            }
        }
        let (usual, most) = if name == "fsj" { (4.0, 5.0) } else { (0.4, 0.5) };
        let flights = (1.0, 1e6);
        let out = Self {
            laws,
            threshold: s.number_or(
                "threshold",
                usual,
                |x| x > healthy && x <= most,
                &format!("above {healthy}, at most {most}"),
            )?,
            life_flights: Between::from_plan(&mut s, "life_flights", None, flights)?,
            onset_flights: Between::from_plan(&mut s, "onset_flights", Some(0.0), (0.0, 1e6))?,
            scatter: s.number_or("scatter", 0.2, |x| (0.0..=2.0).contains(&x), "0 to 2")?,
        };
        s.finish()?;
        Ok(out)
    }
}

/// An actuator as warm as at a test: resistance, magnets, and what depends on its temperature.
pub(super) fn warmed(actuator: &Arc<ActuatorParameters>, warmer_k: f64) -> Arc<ActuatorParameters> {
    if warmer_k == 0.0 {
        return actuator.clone();
    }
    let mut one_kelvin = Spread::none();
    one_kelvin.half_width[Cause::Temperature as usize] = 1.0;
    let mut by = [0.0; Cause::COUNT];
    by[Cause::Temperature as usize] = warmer_k;
    let (mut warm, _) = one_kelvin.unit(actuator, 0.0, &by);
    warm.temperature_degc += warmer_k;
    Arc::new(warm)
}

#[cfg(test)]
mod tests {
    use super::*;
    use schemas::toml_section;

    fn plan(text: &str) -> Result<WearPlan> {
        WearPlan::from_section(toml_section::parse("wear.toml", text)?)
    }

    const PLAIN: &str = "flights = 300\nmissed = 0.2\n[fsj]\nlife_flights = { from = 100, to = 250 }\n[zeta]\nlaws = [\"linear\"]\nlife_flights = 200\nscatter = 0\n";

    #[test]
    fn prop_laws_rise_from_0_to_1() {
        for law in WearLaw::ALL {
            for shape in [0.0, 0.3, 1.0] {
                let u: Vec<f64> = (0..=120).map(|k| law.mean(f64::from(k) / 100.0, shape)).collect();
                assert!(u[0].abs() < 1e-12 && (u[100] - 1.0).abs() < 1e-6, "{law:?} {u:?}");
                assert!(u.windows(2).all(|w| w[1] >= w[0]), "{law:?}");
            }
        }
    }

    #[test]
    fn prop_lives_end_where_they_were_drawn_to_in_the_mean() {
        // mean of the lives that end, and how many do
        let of = |law: WearLaw| {
            let name = law.name();
            let text = format!("flights = 100\n[fsj]\nlaws = [\"{name}\"]\nlife_flights = 100\nonset_flights = 20\n");
            let p = plan(&text).unwrap();
            let ends = (0..400).filter_map(|k| p.life(3, &format!("a{k}"), 5, [5.0, 0.5]).ends[0].at);
            let ends: Vec<f64> = ends.map(|(flight, _)| flight).collect();
            (ends.iter().sum::<f64>() / ends.len() as f64, ends.len())
        };
        for law in WearLaw::ALL {
            let (mean, ended) = of(law);
            assert!((108.0..136.0).contains(&mean), "{law:?}: {mean} of {ended}");
            // a logistic curve levels off 4 % beyond the threshold, and by its scatter often before
            let least = if law == WearLaw::Logistic { 200 } else { 400 };
            assert!(ended >= least, "{law:?}: {ended} of 400 end");
        }
    }

    #[test]
    fn prop_the_same_life_again_and_tests_as_asked() {
        let p = plan(PLAIN).unwrap();
        let life = p.life(1, "tail", 40, [5.0, 0.5]);
        assert_eq!(life, p.life(1, "tail", 40, [5.0, 0.5]));
        assert_ne!(life, p.life(2, "tail", 40, [5.0, 0.5]));
        assert_eq!(life.tests.len(), 40);
        assert!(
            life.tests
                .windows(2)
                .all(|w| w[0].flight < w[1].flight && w[0].day < w[1].day)
        );
        assert!(life.tests.windows(2).all(|w| w[0].fault.fsj <= w[1].fault.fsj));
        // linear without scatter: to the digit
        for t in &life.tests {
            let exact = (t.flight as f64 / 200.0 * 0.4).min(0.5);
            assert!((t.fault.zeta - exact).abs() < 1e-9, "{t:?}");
        }
        let zeta = life.ends[1];
        assert!((zeta.at.unwrap().0 - 200.0).abs() < 1e-6, "{zeta:?}");
        // fsj ends where its tests pass
        let (end, _) = life.ends[0].at.unwrap();
        for t in &life.tests {
            assert_eq!(t.fault.fsj >= 4.0, t.flight as f64 >= end, "{t:?} {end}");
        }
    }

    #[test]
    fn prop_replaced_ones_begin_anew() {
        let text = "flights = 300\n[replaced]\nshare = 1\nrecorded = 0.5\n[temperature]\nyearly_k = 20\ndaily_k = 3\n[fsj]\nlife_flights = 400\n";
        let p = plan(text).unwrap();
        let lives: Vec<WornActuator> = (0..100).map(|k| p.life(9, &format!("b{k}"), 60, [5.0, 0.5])).collect();
        for l in &lives {
            let r = l.replaced.unwrap();
            let after = l.tests.iter().find(|t| t.flight >= r.flight).unwrap();
            let before = l.tests.iter().rfind(|t| t.flight < r.flight).unwrap();
            assert!(
                after.fault.fsj <= before.fault.fsj || before.fault.fsj < 1.1,
                "{before:?} {after:?}"
            );
            assert!(l.ends[0].at.is_none_or(|(f, _)| f > r.flight as f64));
        }
        let recorded = lives.iter().filter(|l| l.replaced.unwrap().is_recorded).count();
        assert!((30..70).contains(&recorded), "{recorded}");
        let warm: Vec<f64> = lives.iter().flat_map(|l| l.tests.iter().map(|t| t.warmer_k)).collect();
        assert!(warm.iter().all(|k| k.abs() < 40.0) && warm.iter().any(|k| *k < -15.0));
        let hot = warmed(&Arc::new(ActuatorParameters::reference()), 50.0);
        let cold = ActuatorParameters::reference();
        assert!((hot.phase_resistance_ohm / cold.phase_resistance_ohm - 1.196).abs() < 0.01);
        assert_eq!(hot.temperature_degc, cold.temperature_degc + 50.0);
    }

    #[test]
    fn refuse_what_no_wear_has() {
        for (text, words) in [
            ("flights = 10\n", "wear.fsj"),
            ("flights = 0\n[fsj]\nlife_flights = 9\n", "1 to 20000"),
            ("flights = 10\n[fsj]\n", "life_flights"),
            ("flights = 10\n[fsj]\nlife_flights = 9\nlaws = [\"cubic\"]\n", "cubic"),
            ("flights = 10\nfrom = \"spring\"\n[fsj]\nlife_flights = 9\n", "spring"),
            ("flights = 10\n[fsj]\nlife_flights = { from = 9, to = 3 }\n", "9 to"),
            ("flights = 10\n[zeta]\nlife_flights = 9\nthreshold = 0.6\n", "0.6"),
        ] {
            let e = plan(text).unwrap_err().to_string();
            assert!(e.contains(words), "{e}");
        }
    }
}
