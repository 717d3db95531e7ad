//! Fleet plans: which actuators, how they differ, which tests they run, and what is kept.

mod actuators;

use super::wear::{Wear, WearPlan, WornActuator};
use crate::catalogue;
use crate::parameters::{ActuatorParameters, PARAMETERS};
use crate::sensor::SensorModel;
use crate::setup::TestSetup;
use schemas::channel::{Channel, ChannelSet};
use schemas::error::{Error, Result};
use schemas::fault::FaultGrid;
use schemas::fingerprint::{exact, fingerprint};
use schemas::sequence::TestSequence;
use schemas::toml_section::{self, Section, quoted};
use std::collections::BTreeMap;
use std::f64::consts::TAU;
use std::path::Path;
use std::sync::Arc;

/// Hash of the sources that results depend on: results of other sources are never mixed with those of
/// this program.
pub const SOURCE: &str = env!("EMA_WORKER_SOURCE");

/// Noise seeds of a fleet's grid points unless the plan says otherwise: the offset that they leave is half a
/// standard deviation, the same for all points of a map; sixteen would cost two fifths of the engine's time.
const SEEDS: u64 = 4;

/// Most actuators of a plan.
const MOST_ACTUATORS: usize = 100_000;

/// Most runs of an actuator: the results of a part are held together.
const MOST_RUNS: u64 = 1_000_000;

/// Most bytes of telemetry of a run.
const MOST_RUN_BYTES: u64 = 1 << 30;

/// Most parts of a plan.
const MOST_PARTS: u64 = 1_000_000;

/// Most bytes of sensor noise that all runs share.
const MOST_NOISE_BYTES: u64 = 1 << 28;

/// One actuator of the fleet.
#[derive(Clone, Debug)]
pub struct PlannedActuator {
    /// `<tail>.<position>`, or the tail alone
    pub id: String,
    /// tail number of the aircraft; of a single actuator its name
    pub tail: String,
    /// where it sits; empty where there is one place only
    pub position: String,
    /// drawn, or as the plan states them
    pub parameters: Arc<ActuatorParameters>,
}

/// Telemetry that is kept.
#[derive(Clone, Debug)]
pub struct KeptTelemetry {
    /// samples of the feature extraction for one that is kept
    pub every: u64,
    /// rate of the kept samples [Hz]
    pub rate_hz: f64,
    /// asked for
    pub wanted: ChannelSet,
    /// stored: what is wanted and cannot be derived
    pub stored: ChannelSet,
    /// of grid points, of tests
    pub of: (bool, bool),
}

/// A fleet plan, checked.
#[derive(Clone, Debug)]
pub struct DatasetPlan {
    /// letters, digits, - and _
    pub name: String,
    /// the file's text with the files that it names
    pub text: String,
    /// of all draws
    pub seed: u64,
    /// file and text of the actuator that all are variations of
    base: (String, String),
    /// tails by positions, then the single ones
    pub actuators: Vec<PlannedActuator>,
    /// at least one
    pub sequences: Vec<TestSequence>,
    /// fault pairs of the map runs
    pub grid: FaultGrid,
    /// rotor angles at rest, at least one [rad]
    pub rest_angles_rad: Vec<f64>,
    /// constant load torque [N m, motor side]
    pub load_n_m: f64,
    /// P2 from i_eq instead of the phase currents
    pub equivalent_current: bool,
    /// none: true values
    pub sensors: Option<SensorModel>,
    /// rate at which features are taken [Hz]
    pub rate_hz: f64,
    /// noise seeds over which features of grid points are averaged
    pub feature_seeds: u64,
    /// tests of each actuator, to check diagnoses by: random fault pairs, or those of its wear
    pub tests_per_actuator: usize,
    /// none: tests are of random pairs
    wear: Option<Wear>,
    /// none: features only
    pub telemetry: Option<KeptTelemetry>,
    /// where the dataset goes if nothing else is said
    pub out: String,
    /// spreads whose values are assumed rather than sourced
    pub assumed: Vec<String>,
}

/// The files that a plan names, beside it or (in a dataset) within it.
struct Files<'a> {
    file: &'a str,
    dir: &'a Path,
    inside: BTreeMap<String, String>,
    used: BTreeMap<String, String>,
}

impl Files<'_> {
    /// The text of a `.toml` file; `None` for a name without that ending.
    fn text(&mut self, name: &str) -> Result<Option<(String, String)>> {
        if !name.ends_with(".toml") {
            return Ok(None);
        }
        let (place, text) = match self.inside.get(name) {
            Some(text) => (format!("{}: {name}", self.file), text.clone()),
            None => {
                let path = self.dir.join(name);
                let text = std::fs::read_to_string(&path).map_err(|e| Error::io(&path, "cannot be read", e))?;
                (path.display().to_string(), text)
            }
        };
        self.used.insert(name.into(), text.clone());
        Ok(Some((place, text)))
    }

    /// A section of a file, or nothing where the name is that of something built in.
    fn section(&mut self, name: &str) -> Result<Option<Section>> {
        let text = self.text(name)?;
        text.map(|(place, text)| toml_section::parse(&place, &text)).transpose()
    }
}

const PLAIN: &str = "letters, digits, - and _";

fn plain(text: &str) -> bool {
    !text.is_empty() && text.chars().all(|c| c.is_ascii_alphanumeric() || c == '-' || c == '_')
}

const NAME: &str = "letters, digits, - and _, a letter first, and no word for a number or truth";

/// Folders are called by it (hive layout): readers guess types, and must not take it for a number.
pub(super) fn plain_name(text: &str) -> bool {
    let word = text.to_ascii_lowercase();
    let guessed = ["nan", "inf", "infinity", "true", "false", "epoch", "null"].contains(&word.as_str());
    plain(text) && text.starts_with(|c: char| c.is_ascii_alphabetic()) && !guessed
}

/// A name that nothing built in has: where it stands in the plan.
fn at(s: &Section, key: &str, e: Error) -> Error {
    match e {
        Error::Bad { found, allowed, .. } => s.bad(key, found, allowed),
        e => e,
    }
}

fn whole(s: &mut Section, key: &str, default: u64, most: u64) -> Result<u64> {
    let ok = |x: f64| x.fract() == 0.0 && x >= 0.0 && x <= most as f64;
    let allowed = format!("a whole number from 0 to {most}");
    s.number_or(key, default as f64, ok, &allowed).map(|x| x as u64)
}

impl DatasetPlan {
    /// Reads a plan's file.
    ///
    /// # Errors
    /// A file that cannot be read; else as [`DatasetPlan::parse`].
    pub fn read(path: &Path) -> Result<Self> {
        let text = std::fs::read_to_string(path).map_err(|e| Error::io(path, "cannot be read", e))?;
        let dir = path.parent().unwrap_or(Path::new(""));
        Self::parse(&path.display().to_string(), &text, dir)
    }

    /// Parses a plan.
    ///
    /// * `file` for messages
    /// * `dir` where the files lie that it names, unless they are part of the text
    ///
    /// # Errors
    /// File, key, value and what is allowed.
    pub fn parse(file: &str, text: &str, dir: &Path) -> Result<Self> {
        let mut s = toml_section::parse(file, text)?;
        let mut inside = BTreeMap::new();
        if s.may_have("files") {
            let mut t = s.section("files")?;
            for key in t.keys() {
                let text = t.text(&key, "a text")?;
                inside.insert(key, text);
            }
        }
        let whole_text = inside.is_empty();
        let mut files = Files {
            file,
            dir,
            inside,
            used: BTreeMap::new(),
        };
        let name = s.text("name", PLAIN)?;
        if !plain(&name) {
            return Err(s.bad("name", name, PLAIN));
        }
        let seed = whole(&mut s, "seed", 0, 1 << 52)?;
        let out = s.text_or("out", &name)?;

        let base = s.text_or("actuator", "reference")?;
        let base = match files.text(&base)? {
            Some(found) => found,
            None if base == "reference" => (
                "datasets/parameters/reference.toml".into(),
                ActuatorParameters::reference_text().into(),
            ),
            None => return Err(s.bad("actuator", base, "reference, or a .toml file")),
        };
        let mut names = vec!["preflight".to_string()];
        if s.may_have("sequences") {
            names = s.texts("sequences", "a list of names of sequences or .toml files")?;
        }
        let mut sequences: Vec<TestSequence> = Vec::new();
        for n in &names {
            let sequence = match files.section(n)? {
                Some(section) => TestSequence::from_section(section)?,
                None => catalogue::sequence(n).map_err(|e| at(&s, "sequences", e))?,
            };
            if !plain_name(&sequence.name) {
                return Err(s.bad("sequences", sequence.name, NAME));
            }
            if sequences.iter().any(|q| q.name == sequence.name) {
                return Err(s.bad("sequences", sequence.name, "sequences of different names"));
            }
            sequences.push(sequence);
        }
        if sequences.is_empty() {
            return Err(s.bad("sequences", "an empty list", "at least one sequence"));
        }
        let grid = s.text_or("grid", "standard")?;
        let grid = match files.section(&grid)? {
            Some(section) => catalogue::grid_from(section)?,
            None => catalogue::grid(&grid).map_err(|e| at(&s, "grid", e))?,
        };
        let rest_angles_rad = if s.may_have("rest_angle_deg") {
            let turn = |x: f64| (-360.0..=360.0).contains(&x);
            let list = s.axis("rest_angle_deg", turn, "strictly rising angles from -360 to 360")?;
            list.iter().map(|x| x.to_radians()).collect()
        } else if s.may_have("rest_angle_rad") {
            let turn = |x: f64| (-TAU..=TAU).contains(&x);
            s.axis("rest_angle_rad", turn, "strictly rising angles from -2 pi to 2 pi")?
        } else {
            vec![0.0]
        };
        let currents = s.text_or("currents", "phases")?;
        let equivalent_current = match currents.as_str() {
            "phases" => false,
            "i_eq" => true,
            _ => return Err(s.bad("currents", currents, "phases, or i_eq: what P2 is taken from")),
        };
        let load_n_m = s.number_or("load_n_m", 0.0, |_| true, "a finite number")?;
        let sensors = s.text_or("sensors", "none")?;
        let sensors = match files.section(&sensors)? {
            Some(section) => Some(SensorModel::from_section(section)?),
            None => catalogue::sensors(&sensors).map_err(|e| match at(&s, "sensors", e) {
                Error::Bad { found, allowed, .. } => s.bad("sensors", found, format!("none, {allowed}")),
                e => e,
            })?,
        };
        let rate_hz = s.number_or(
            "rate_hz",
            10_000.0,
            |x| (1000.0..=1e6).contains(&x),
            "1000 to 1000000 Hz",
        )?;
        let feature_seeds = whole(&mut s, "feature_seeds", SEEDS, 64)?.max(1);
        let longest = sequences.iter().map(TestSequence::duration_s).fold(0.0, f64::max);
        let noise = (longest * rate_hz) as u64 * 16 * feature_seeds;
        if sensors.is_some() && noise > MOST_NOISE_BYTES {
            let allowed =
                format!("{feature_seeds} seeds of {longest} s of noise within 256 MB: a lower rate or fewer seeds");
            return Err(s.bad("rate_hz", rate_hz, allowed));
        }
        let mut tests_per_actuator = 0;
        if s.may_have("tests") {
            let mut t = s.section("tests")?;
            tests_per_actuator = whole(&mut t, "per_actuator", 0, 100_000)? as usize;
            t.finish()?;
        }
        let mut wear = None;
        if s.may_have("wear") {
            wear = Some(WearPlan::from_section(s.section("wear")?)?);
            if tests_per_actuator == 0 {
                let allowed = "at least 1 with [wear]: the tests of its life";
                return Err(s.bad("tests.per_actuator", 0, allowed));
            }
        }
        let telemetry = if s.may_have("telemetry") {
            let t = s.section("telemetry")?;
            Some(KeptTelemetry::from_section(t, rate_hz, sensors.is_some())?)
        } else {
            None
        };
        let mut assumed = Vec::new();
        let spread = actuators::spread(&mut s, &mut assumed)?;
        let actuators = actuators::actuators(&mut s, seed, &base, &spread)?;
        s.finish()?;
        let wear = wear.map(|plan| Wear::new(plan, actuators.len()));
        let mut text = text.trim_end().to_string() + "\n";
        if whole_text && !files.used.is_empty() {
            text += "\n# the files that the plan names\n[files]\n";
            for (name, content) in &files.used {
                text += &format!("{} = {}\n", quoted(name), several_lines(content));
            }
        }
        let plan = Self {
            name,
            text,
            seed,
            base,
            actuators,
            sequences,
            grid,
            rest_angles_rad,
            load_n_m,
            equivalent_current,
            sensors,
            rate_hz,
            feature_seeds,
            tests_per_actuator,
            wear,
            telemetry,
            out,
            assumed,
        };
        plan.within_bounds(file)?;
        Ok(plan)
    }

    /// Refuses what no machine holds, before it is tried.
    fn within_bounds(&self, file: &str) -> Result<()> {
        for (k, q) in self.sequences.iter().enumerate() {
            let every = self.telemetry.as_ref().map_or(1, |t| t.every);
            if self.rows(k) < every {
                let found = format!("{}, which is over before its first sample", q.name);
                return Err(Error::bad(
                    file,
                    "key `sequences`",
                    found,
                    "longer ones, or a higher rate",
                ));
            }
        }
        let each = self.runs_per_actuator();
        if each > MOST_RUNS {
            let found = format!("{each} runs of each actuator");
            let allowed = format!("at most {MOST_RUNS}: fewer points, rest angles, sequences or tests");
            return Err(Error::bad(file, "key `grid`", found, allowed));
        }
        let bytes = (0..self.sequences.len()).map(|q| self.run_bytes(q)).max().unwrap_or(0);
        if bytes > MOST_RUN_BYTES {
            let found = format!("{} MB for each run", bytes / 1_000_000);
            let allowed = format!(
                "at most {} MB: a lower rate, fewer channels or a shorter sequence",
                MOST_RUN_BYTES / 1_000_000
            );
            return Err(Error::bad(file, "key `telemetry`", found, allowed));
        }
        let parts = self.parts_per_actuator() * self.actuators.len() as u64;
        if parts > MOST_PARTS {
            let found = format!("{parts} parts");
            let allowed = format!("at most {MOST_PARTS}: fewer actuators, rest angles or sequences, less telemetry");
            return Err(Error::bad(file, "plan", found, allowed));
        }
        Ok(())
    }

    /// Of everything that results and metadata depend on, the program's sources included; not of comments.
    pub fn fingerprint(&self) -> String {
        let list = |v: &[f64]| v.iter().map(|&x| exact(x)).collect::<Vec<_>>().join(",");
        let actuator = |a: &PlannedActuator| format!("{}={}", a.id, a.parameters.fingerprint());
        let sequence = |q: &TestSequence| format!("{}={}", q.name, q.fingerprint());
        let telemetry = self.telemetry.as_ref().map_or("none".into(), |t| {
            format!("{},{},{},{:?}", t.every, t.wanted.0, t.stored.0, t.of)
        });
        let wear = self.wear.as_ref().map(|w| w.plan.fingerprint()).unwrap_or_default();
        fingerprint(&format!(
            "fleet;{SOURCE};{};{};{};{};{};{};{};{};{};{};{};{};{telemetry};{}{wear}",
            self.name,
            self.seed,
            self.actuators.iter().map(actuator).collect::<Vec<_>>().join(","),
            self.sequences.iter().map(sequence).collect::<Vec<_>>().join(","),
            list(&self.grid.fsj),
            list(&self.grid.zeta),
            list(&self.rest_angles_rad),
            exact(self.load_n_m),
            self.sensor_fingerprint(),
            exact(self.rate_hz),
            self.feature_seeds,
            self.tests_per_actuator,
            self.equivalent_current,
        ))
    }

    /// The life of an actuator, by its place in the plan; none where tests are of random pairs.
    pub fn life(&self, actuator: usize) -> Option<&WornActuator> {
        let wear = self.wear.as_ref()?;
        let most = [&self.grid.fsj, &self.grid.zeta].map(|axis| axis[axis.len() - 1]);
        let id = &self.actuators[actuator].id;
        Some(wear.life(actuator, |plan| plan.life(self.seed, id, self.tests_per_actuator, most)))
    }

    /// The parameters of one actuator as a TOML file.
    ///
    /// * `actuator` its place in [`DatasetPlan::actuators`]
    ///
    /// # Errors
    /// A text of the actuator that is not allowed; a plan that was parsed has none such.
    pub fn actuator_toml(&self, actuator: usize) -> Result<String> {
        let (file, text) = &self.base;
        let nominal = ActuatorParameters::parse(file, text)?.values();
        let a = &self.actuators[actuator];
        let mut s = toml_section::parse(file, text)?;
        s.put_text("name", &a.id);
        let values = a.parameters.values().into_iter().zip(nominal).zip(PARAMETERS);
        for ((value, nominal), (_, table, key)) in values {
            if value != nominal {
                s.put(table, key, value)?;
            }
        }
        Ok(s.to_toml())
    }

    /// The test of an actuator through a sequence from a rest angle, by their places in the plan.
    pub fn setup(&self, actuator: usize, sequence: usize, rest: usize) -> TestSetup {
        TestSetup {
            actuator: self.actuators[actuator].parameters.clone(),
            sequence: self.sequences[sequence].clone(),
            sensors: self.sensors.clone(),
            rate_hz: self.rate_hz,
            rest_angle_rad: self.rest_angles_rad[rest],
            load_n_m: self.load_n_m,
            equivalent_current: self.equivalent_current,
        }
    }

    /// Fingerprint of the sensors, or `none`.
    pub fn sensor_fingerprint(&self) -> String {
        SensorModel::fingerprint_of(self.sensors.as_ref())
    }
}

/// The keys of a plan that say how one actuator's tests are done, as [`DatasetPlan::parse`] reads them.
pub(super) fn conditions_toml(s: &TestSetup, rest_angles_rad: &[f64]) -> String {
    let sensors = if s.sensors.is_some() { "sensors.toml" } else { "none" };
    let currents = if s.equivalent_current { "i_eq" } else { "phases" };
    let (rate, load) = (s.rate_hz, s.load_n_m);
    format!(
        "sensors = \"{sensors}\"\nrate_hz = {rate:?}\nrest_angle_rad = {rest_angles_rad:?}\nload_n_m = {load:?}\ncurrents = \"{currents}\"\n"
    )
}

/// A text as TOML writes it, over several lines.
pub(super) fn several_lines(text: &str) -> String {
    let escaped = text.replace('\\', "\\\\").replace('"', "\\\"").replace('\r', "\\r");
    format!("\"\"\"\n{escaped}\"\"\"")
}

impl KeptTelemetry {
    /// * `rate_hz` at which features are taken
    /// * `measured` whether there is a sensor model: then what it forms from other channels need not be stored
    fn from_section(mut t: Section, rate_hz: f64, measured: bool) -> Result<Self> {
        let divides = |x: f64| x > 0.0 && x <= rate_hz && ((rate_hz / x).round() * x - rate_hz).abs() < 1e-6 * rate_hz;
        let allowed = format!("a rate that goes into {rate_hz} Hz a whole number of times");
        let kept = t.number_or("rate_hz", rate_hz, divides, &allowed)?;
        let mut wanted = ChannelSet::basic();
        if t.may_have("channels") {
            let names: Vec<&str> = Channel::ALL.iter().map(|c| c.name()).collect();
            let allowed = format!("a list of {}", names.join(", "));
            let list = t.texts("channels", &allowed)?;
            let mut set = ChannelSet::default();
            for n in &list {
                let simulated = Channel::from_name(n).filter(|&c| c != Channel::Temperature);
                set = set.with(simulated.ok_or_else(|| t.bad("channels", n, allowed.clone()))?);
            }
            wanted = set;
        }
        let of = t.text_or("of", "all")?;
        let of = match of.as_str() {
            "all" => (true, true),
            "map" => (true, false),
            "test" => (false, true),
            _ => return Err(t.bad("of", of, "all, map or test")),
        };
        let store = t.text_or("store", "underived")?;
        let all = match store.as_str() {
            "underived" => false,
            "all" => true,
            _ => return Err(t.bad("store", store, "underived (what others give back is left out), or all")),
        };
        let has = |list: &[Channel]| list.iter().all(|&c| wanted.contains(c));
        let derived = |c: Channel| match c {
            _ if all => false,
            Channel::Com => true,
            Channel::ThetaU => measured && has(&[Channel::ThetaM]),
            Channel::IEq => measured && has(&[Channel::IA, Channel::IB, Channel::IC]),
            _ => false,
        };
        let stored = ChannelSet::of(wanted.iter().filter(|&c| !derived(c)));
        if stored == ChannelSet::default() {
            let names: Vec<&str> = wanted.iter().map(Channel::name).collect();
            let allowed = "at least one channel that cannot be derived from the sequence or from others";
            return Err(t.bad("channels", format!("[{}]", names.join(", ")), allowed));
        }
        t.finish()?;
        Ok(Self {
            every: (rate_hz / kept).round() as u64,
            rate_hz: kept,
            wanted,
            stored,
            of,
        })
    }
}
