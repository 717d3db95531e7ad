//! Simulated fleets of wearing electromechanical actuators.
//!
//! Every unit wears by a law of its own until the damage reaches its threshold;
//! a test after every flight reads the fault with an interval and an estimate.
//! [`generate`] makes the units, [`files::write`] puts them into files.

pub mod diagnosis;
pub mod files;
pub mod random;
pub mod wear;

use diagnosis::{Fate, Noise, Outcome, Reader, Scale, Test, draw_fate, draw_times};
use random::Random;
use wear::{Law, Wear};

/// What kind of units a bed holds.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Bed {
    /// Six laws of wear, one unit in five repaired before.
    Fleet,
    /// Units without wear, each with this many flights.
    Healthy {
        /// Flights of each unit.
        tests: u32,
    },
    /// Linear wear whose rate triples once; no repairs.
    Triple,
    /// Six laws of wear, every unit repaired once without a record.
    RepairsUnrecorded,
}

/// What to generate.
#[derive(Debug, Clone, PartialEq)]
pub struct Options {
    /// Number of units.
    pub units: u32,
    /// Seed of all random numbers.
    pub seed: u64,
    /// What kind of units.
    pub bed: Bed,
    /// How good the diagnoses are.
    pub noise: Noise,
    /// Correlation of the errors from flight to flight, 0 .. 1 (one excluded).
    pub ar1: f64,
    /// Whether zeta wears too.
    pub two_faults: bool,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            units: 200,
            seed: 1,
            bed: Bed::Fleet,
            noise: Noise::Bench,
            ar1: 0.0,
            two_faults: false,
        }
    }
}

/// A fault that wears.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FaultKind {
    /// Friction factor, 1 when new.
    Fsj,
    /// Second fault, 0 when new.
    Zeta,
}

impl FaultKind {
    /// Name in the files.
    pub fn name(self) -> &'static str {
        match self {
            FaultKind::Fsj => "fsj",
            FaultKind::Zeta => "zeta",
        }
    }

    /// Name of the end of life in the files.
    pub fn event(self) -> &'static str {
        match self {
            FaultKind::Fsj => "fsj>4",
            FaultKind::Zeta => "zeta>0.4",
        }
    }

    /// Value without damage.
    pub fn baseline(self) -> f64 {
        match self {
            FaultKind::Fsj => 1.0,
            FaultKind::Zeta => 0.0,
        }
    }

    /// Damage at the threshold (value at the threshold less the baseline).
    pub fn threshold_damage(self) -> f64 {
        match self {
            FaultKind::Fsj => 3.0,
            FaultKind::Zeta => 0.4,
        }
    }
}

/// The wear of one fault of one unit.
#[derive(Debug, Clone)]
pub struct Growth {
    /// The law.
    pub law: Law,
    /// The wear before the repair, on the unit's clock.
    pub before: Option<Wear>,
    /// The wear that counts: its clock starts at the repair, if there was one
    /// of this fault.
    pub wear: Wear,
    /// True end of life on the unit's clock (flights).
    pub end: f64,
}

/// One fault of one unit.
#[derive(Debug, Clone)]
pub struct Fault {
    /// Which fault.
    pub kind: FaultKind,
    /// Value without damage, in the fault's own unit.
    pub baseline: f64,
    /// How it wears; none for a healthy unit.
    pub growth: Option<Growth>,
    /// True damage at flights 1, 2, ... (value less the baseline, in the
    /// fault's own unit), whether or not the flight's test was made.
    pub damage: Vec<f64>,
    /// Constant error of the unit's estimates (part of the value; for zeta part
    /// of the value at which a relative reading would be as wide).
    pub bias: f64,
}

/// A repair of FSJ.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Repair {
    /// The repair came after this flight and before the next one; the test of
    /// this flight was not made.
    pub flight: u32,
    /// Whether the events tell of it.
    pub recorded: bool,
}

/// One unit.
#[derive(Debug, Clone)]
pub struct Unit {
    /// Name in the files.
    pub name: String,
    /// Flights in the history, missing tests included.
    pub flights: u32,
    /// The faults: FSJ, then zeta if asked for.
    pub faults: Vec<Fault>,
    /// The repair, if there was one.
    pub repair: Option<Repair>,
    /// The tests that were made.
    pub tests: Vec<Test>,
}

/// Part of the units that were repaired before.
const REPAIRED: f64 = 0.20;

/// Part of the repairs that are recorded.
const RECORDED: f64 = 0.70;

/// Fewest and most flights before a repair.
const FLIGHTS_BEFORE_REPAIR: (u32, u32) = (20, 80);

/// Largest damage left by a repair (part of the threshold damage).
const LEFT_BY_REPAIR: f64 = 0.03;

/// Fewest flights from a repair of FSJ to the end of zeta's life.
const ZETA_AFTER_REPAIR: f64 = 30.0;

/// Value of FSJ whose relative widths are the absolute widths of zeta: 0.004
/// over 0.36 %.
const ZETA_SCALE: f64 = 0.004 / 0.0036;

/// The units of a bed.
pub fn generate(options: &Options) -> Vec<Unit> {
    (1..=options.units)
        .map(|number| generate_unit(options, number))
        .collect()
}

/// One unit of a bed, the same whatever the number of units.
pub fn generate_unit(options: &Options, number: u32) -> Unit {
    let stream = |n| Random::new(options.seed, u64::from(number), n);
    let mut wear_random = stream(0);
    let mut zeta_random = stream(1);

    let mut repair = None;
    let mut baseline = FaultKind::Fsj.baseline();
    let mut growths = Vec::new();
    match options.bed {
        Bed::Healthy { .. } => {
            baseline = wear_random.uniform(1.0, 1.05);
            growths.push(None);
        }
        bed => {
            let (growth, repaired) = draw_fsj(bed, &mut wear_random);
            repair = repaired;
            growths.push(Some(growth));
        }
    }
    if options.two_faults {
        growths.push(match options.bed {
            Bed::Healthy { .. } => None,
            _ => Some(draw_zeta(repair, &mut zeta_random)),
        });
    }

    let first_end = growths.iter().flatten().map(|g| g.end).reduce(f64::min);
    let flights = match (options.bed, first_end) {
        (Bed::Healthy { tests }, _) => tests,
        (_, Some(end)) => end.ceil() as u32 - 1,
        (_, None) => 0,
    };

    let mut faults = Vec::new();
    let mut readers = Vec::new();
    for (index, growth) in growths.into_iter().enumerate() {
        let (kind, baseline, scale) = match index {
            0 => (FaultKind::Fsj, baseline, Scale::Relative),
            _ => (FaultKind::Zeta, FaultKind::Zeta.baseline(), Scale::Absolute(ZETA_SCALE)),
        };
        let threshold = kind.baseline() + kind.threshold_damage();
        let random = stream(10 + index as u64);
        let reader = Reader::new(options.noise, scale, threshold, options.ar1, random);
        faults.push(Fault {
            kind,
            baseline,
            damage: damage(kind, growth.as_ref(), repair, flights),
            growth,
            bias: reader.bias,
        });
        readers.push(reader);
    }

    let times = draw_times(flights, &mut stream(2));
    let mut fates = stream(3);
    let mut tests = Vec::new();
    for flight in 1..=flights {
        let fate = draw_fate(&mut fates);
        let place = (flight - 1) as usize;
        let wrong = fate == Fate::Wrong;
        let readings = faults
            .iter()
            .zip(&mut readers)
            .map(|(fault, reader)| reader.read(fault.baseline + fault.damage[place], wrong))
            .collect();
        let at_repair = repair.is_some_and(|r| r.flight == flight);
        if fate == Fate::Missing || at_repair {
            continue;
        }
        let unexplained = fate == Fate::Unexplained;
        tests.push(Test {
            flight,
            time: times[place],
            outcome: if unexplained {
                Outcome::Unexplained
            } else {
                Outcome::Located
            },
            wrong,
            readings: if unexplained { Vec::new() } else { readings },
        });
    }

    Unit {
        name: format!("U{number:04}"),
        flights,
        faults,
        repair,
        tests,
    }
}

/// The wear of FSJ and the repair that cut an earlier life of it short.
fn draw_fsj(bed: Bed, random: &mut Random) -> (Growth, Option<Repair>) {
    let (law, chance) = match bed {
        Bed::Triple => (Law::draw_triple(random), 0.0),
        Bed::RepairsUnrecorded => (Law::draw(random), 1.0),
        _ => (Law::draw(random), REPAIRED),
    };
    let repaired = random.chance(chance);
    let recorded = random.chance(RECORDED) && bed != Bed::RepairsUnrecorded;
    if !repaired {
        let wear = Wear::draw(&law, 0.0, 0.0, random);
        let end = wear.life;
        let growth = Growth {
            law,
            before: None,
            wear,
            end,
        };
        return (growth, None);
    }
    let flight = random.whole(FLIGHTS_BEFORE_REPAIR.0, FLIGHTS_BEFORE_REPAIR.1);
    let before = Wear::draw_repaired(&law, flight, random);
    let left = random.uniform(0.0, LEFT_BY_REPAIR);
    let wear = Wear::draw(&law, left, 0.0, random);
    let growth = Growth {
        law,
        before: Some(before),
        end: f64::from(flight) + wear.life,
        wear,
    };
    (growth, Some(Repair { flight, recorded }))
}

/// The wear of zeta, which a repair of FSJ leaves as it is.
fn draw_zeta(repair: Option<Repair>, random: &mut Random) -> Growth {
    let least = repair.map_or(0.0, |r| f64::from(r.flight) + ZETA_AFTER_REPAIR);
    let law = Law::draw(random);
    let wear = Wear::draw(&law, 0.0, least, random);
    Growth {
        law,
        before: None,
        end: wear.life,
        wear,
    }
}

/// Damage at flights 1 .. `flights`, in the fault's own unit.
fn damage(kind: FaultKind, growth: Option<&Growth>, repair: Option<Repair>, flights: u32) -> Vec<f64> {
    let Some(growth) = growth else {
        return vec![0.0; flights as usize];
    };
    (1..=flights)
        .map(|flight| {
            let part = match (&growth.before, repair) {
                (Some(before), Some(r)) if flight <= r.flight => before.path.at(f64::from(flight)),
                (Some(_), Some(r)) => growth.wear.path.at(f64::from(flight - r.flight)),
                _ => growth.wear.path.at(f64::from(flight)),
            };
            part * kind.threshold_damage()
        })
        .collect()
}
