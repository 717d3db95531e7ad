//! Cases on disk: recordings of one unit, and the key that says what is true.

use std::fmt::Write as _;
use std::fs;
use std::io;
use std::path::Path;

use super::draw::stream;
use super::{Command, Effect, Unit, record};
use rand::RngExt;

/// Rate of the recordings [Hz].
const RATE: f64 = 2000.0;
/// Length of a drawn excitation [s].
const LONG: f64 = 8.0;
/// Length of the pre-flight test [s].
const PREFLIGHT: f64 = 3.0;

/// What is true of one case of recordings.
#[derive(Clone, Debug, PartialEq)]
pub struct Key {
    /// Seed of the case.
    pub seed: u64,
    /// Strength asked for.
    pub strength: f64,
    /// The hidden effect, `None` for a unit that is off nominal only.
    pub effect: Option<Effect>,
    /// True constants by name, SI: `inertia`, `viscous`, `coulomb` (dynamic friction level), `static_friction`,
    /// `back_emf` (phase), `torque_constant` (twice `back_emf`), `drive_constant`, `resistance` and `inductance` (phase).
    pub constants: Vec<(&'static str, f64)>,
    /// Whether the recordings carry a column `temperature`.
    pub thermometer: bool,
}

/// What is true of one case of a unit.
#[derive(Clone, Debug, PartialEq)]
pub struct UnitKey {
    /// The unit.
    pub key: Key,
    /// Friction multiplier and static eccentricity of `faulty_0..2`; the first also holds for `faulty_long`.
    pub faults: [(f64, f64); 3],
}

impl Key {
    fn of(unit: &Unit, strength: f64, seed: u64) -> Key {
        let constants = vec![
            ("inertia", unit.j),
            ("viscous", unit.c),
            ("coulomb", unit.fd_ratio * unit.fs0),
            ("static_friction", unit.fs0),
            ("back_emf", unit.ke),
            ("torque_constant", 2.0 * unit.ke),
            ("drive_constant", unit.ktc),
            ("resistance", unit.r),
            ("inductance", unit.l),
        ];
        Key {
            seed,
            strength,
            effect: unit.effects.first().cloned(),
            constants,
            thermometer: unit.thermometer,
        }
    }

    /// The key's members as JSON text, without the braces.
    fn members(&self) -> String {
        let name = self.effect.as_ref().map_or("none", |e| e.name);
        let parameters = self.effect.as_ref().map_or(&[][..], |e| &e.parameters);
        let mut text = format!(
            "\"seed\":{},\"strength\":{},\"effect\":\"{name}\"",
            self.seed, self.strength
        );
        let _ = write!(text, ",\"parameters\":{{{}}}", numbers(parameters));
        let _ = write!(text, ",\"constants\":{{{}}}", numbers(&self.constants));
        let _ = write!(text, ",\"thermometer\":{}", self.thermometer);
        text
    }

    /// The key as a JSON object.
    pub fn to_json(&self) -> String {
        format!("{{{}}}", self.members())
    }
}

impl UnitKey {
    /// The key as a JSON object.
    pub fn to_json(&self) -> String {
        let faults = self
            .faults
            .map(|(fsj, zeta)| format!("{{\"fsj\":{fsj},\"zeta\":{zeta}}}"))
            .join(",");
        format!("{{{},\"faults\":[{faults}]}}", self.key.members())
    }
}

fn numbers(pairs: &[(&'static str, f64)]) -> String {
    pairs
        .iter()
        .map(|(k, v)| format!("\"{k}\":{v}"))
        .collect::<Vec<_>>()
        .join(",")
}

/// All keys of a set as JSON: an object with one member a folder.
pub fn keys_json(cases: &[(String, String)]) -> String {
    let lines: Vec<String> = cases
        .iter()
        .map(|(folder, json)| format!("  \"{folder}\": {json}"))
        .collect();
    format!("{{\n{}\n}}\n", lines.join(",\n"))
}

fn unit_of(effect: Option<&'static str>, strength: f64, seed: u64) -> io::Result<Unit> {
    Unit::drawn(seed, effect, strength).map_err(|e| io::Error::new(io::ErrorKind::InvalidInput, e))
}

/// The excitations of a case: sines first, then a staircase, then a mixture of both; different from seed to seed.
fn excitations(seed: u64) -> [Command; 3] {
    [
        Command::drawn_sines(&mut stream(seed, 3)),
        Command::drawn_staircase(&mut stream(seed, 4), LONG),
        Command::drawn_mixture(&mut stream(seed, 5), LONG),
    ]
}

/// A seed for the sensors of the `n`-th file of a case.
fn sensor_seed(seed: u64, n: u64) -> u64 {
    seed.wrapping_mul(0x9E37_79B9_7F4A_7C15).wrapping_add(n)
}

/// Writes `a.csv` (sum of sines) and `b.csv` (staircase, or in every other case a mixture), 8 s at 2 kHz each, of a
/// healthy unit with one hidden effect or none.
///
/// # Errors
/// What the file system says, or `InvalidInput` for an unknown effect.
pub fn make(folder: &Path, effect: Option<&'static str>, strength: f64, seed: u64) -> io::Result<Key> {
    let unit = unit_of(effect, strength, seed)?;
    fs::create_dir_all(folder)?;
    let [sines, staircase, mixture] = excitations(seed);
    let second = if stream(seed, 6).random::<bool>() {
        staircase
    } else {
        mixture
    };
    for (n, (name, command)) in (0..).zip([("a.csv", sines), ("b.csv", second)]) {
        record(&unit, &command, LONG, RATE, (1.0, 0.0), true, sensor_seed(seed, n)).write_csv(&folder.join(name))?;
    }
    Ok(Key::of(&unit, strength, seed))
}

/// Writes a unit's recordings: `healthy_long_1.csv` (sines), `healthy_long_2.csv` (staircase), `healthy_0..2.csv`
/// (pre-flight), `faulty_0..2.csv` (pre-flight, three drawn faults), `faulty_long.csv` (mixture, the first fault).
///
/// # Errors
/// What the file system says, or `InvalidInput` for an unknown effect.
pub fn make_unit(folder: &Path, effect: Option<&'static str>, strength: f64, seed: u64) -> io::Result<UnitKey> {
    let unit = unit_of(effect, strength, seed)?;
    fs::create_dir_all(folder)?;
    let mut rng = stream(seed, 8);
    let faults = [0; 3].map(|_| (rng.random_range(1.5..4.7), rng.random_range(0.05..0.48)));
    let healthy = (1.0, 0.0);
    let [sines, staircase, mixture] = excitations(seed);
    let test = Command::Preflight;
    let files = [
        ("healthy_long_1.csv", &sines, LONG, healthy),
        ("healthy_long_2.csv", &staircase, LONG, healthy),
        ("healthy_0.csv", &test, PREFLIGHT, healthy),
        ("healthy_1.csv", &test, PREFLIGHT, healthy),
        ("healthy_2.csv", &test, PREFLIGHT, healthy),
        ("faulty_0.csv", &test, PREFLIGHT, faults[0]),
        ("faulty_1.csv", &test, PREFLIGHT, faults[1]),
        ("faulty_2.csv", &test, PREFLIGHT, faults[2]),
        ("faulty_long.csv", &mixture, LONG, faults[0]),
    ];
    for (n, (name, command, seconds, faults)) in (0..).zip(files) {
        record(&unit, command, seconds, RATE, faults, true, sensor_seed(seed, n)).write_csv(&folder.join(name))?;
    }
    Ok(UnitKey {
        key: Key::of(&unit, strength, seed),
        faults,
    })
}
