//! The file of a unit: the model, every test that went in, and the posterior of the constants.

use super::constants::Constants;
use super::repair::{Repair, RepairedPart};
use crate::seal;
use crate::uncertainty::Discrepancy;
use schemas::error::{Error, Result, write_whole};
use schemas::feature::{Feature, Features};
use schemas::fingerprint::fingerprint;
use schemas::sequence::TestSequence;
use schemas::toml_section;
use serde::{Deserialize, Serialize};
use sim_worker::parameters::ActuatorParameters;
use sim_worker::sensor::SensorModel;
use sim_worker::setup::TestSetup;
use sim_worker::spread::{Cause, Spread};
use std::path::Path;
use std::sync::Arc;

/// First key of every unit file.
const FORMAT: &str = "ema unit 2";

/// Of files whose means are relative deviations, not yet counted ([`Cause::counted`]).
const FIRST_FORMAT: &str = "ema unit 1";

/// A kind of test that a unit was shown: what maps are made for.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct KindEntry {
    /// fingerprint of the kind
    pub kind: String,
    /// the sequence, as a TOML file has it
    sequence: String,
    /// the sensors, as a TOML file has them; empty for true values
    sensors: String,
    rate_hz: f64,
    rest_angle_rad: f64,
    equivalent_current: bool,
}

impl KindEntry {
    /// The kind of a test.
    pub fn of(setup: &TestSetup) -> Self {
        Self {
            kind: Self::fingerprint_of(setup),
            sequence: setup.sequence.to_toml(),
            sensors: setup.sensors.as_ref().map_or_else(String::new, |s| s.to_toml()),
            rate_hz: setup.rate_hz,
            rest_angle_rad: setup.rest_angle_rad,
            equivalent_current: setup.equivalent_current,
        }
    }

    /// Whether another kind differs in the rest angle alone, if in anything.
    fn but_for_angle(&self, other: &Self) -> bool {
        let turned = Self {
            kind: self.kind.clone(),
            rest_angle_rad: self.rest_angle_rad,
            ..other.clone()
        };
        turned == *self
    }

    /// Of all that maps depend on.
    pub fn fingerprint_of(setup: &TestSetup) -> String {
        fingerprint(&format!("{:?}", setup.kind()))
    }

    /// The test again.
    ///
    /// # Errors
    /// Refuses a file that was changed by hand into none.
    pub fn setup(&self, file: &str, actuator: Arc<ActuatorParameters>) -> Result<TestSetup> {
        let sensors = sensors_in(file, &self.sensors)?;
        let section = toml_section::parse(&format!("{file}: sequence"), &self.sequence)?;
        let sequence = TestSequence::from_section(section)?;
        Ok(TestSetup {
            sensors,
            rest_angle_rad: self.rest_angle_rad,
            equivalent_current: self.equivalent_current,
            ..TestSetup::new(actuator, sequence, self.rate_hz)
        })
    }
}

/// The sensors that a part of a file describes; none where it is empty.
fn sensors_in(file: &str, text: &str) -> Result<Option<SensorModel>> {
    if text.is_empty() {
        return Ok(None);
    }
    let section = toml_section::parse(&format!("{file}: sensors"), text)?;
    SensorModel::from_section(section).map(Some)
}

/// A test that was shown to a unit.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TestEntry {
    /// name of the recording
    pub file: String,
    /// of its bytes: the same recording is taken once
    pub checksum: String,
    /// whether the unit was healthy in it
    pub healthy: bool,
    /// what came out: `baseline`, or the outcome of its diagnosis
    pub outcome: String,
    /// why it was not taken, where it was not; empty otherwise
    pub reason: String,
    /// fingerprint of the kind of test: its maps
    pub kind: String,
    /// intervals (lo, estimate, hi) of FSJ and zeta as they were diagnosed, where they were
    pub fsj: Option<(f64, f64, f64)>,
    /// as `fsj`
    pub zeta: Option<(f64, f64, f64)>,
    /// features by name, over the nominal run of the maps
    pub features: Vec<(String, f64)>,
    /// revision of the program
    pub commit: String,
    /// repairs of the unit before it
    #[serde(default, skip_serializing_if = "is_zero")]
    pub repairs: usize,
}

fn is_zero(n: &usize) -> bool {
    *n == 0
}

impl TestEntry {
    /// Whether the unit's constants know of it.
    pub fn is_taken(&self) -> bool {
        self.reason.is_empty()
    }

    /// The features of a test, by name.
    pub fn named(features: &Features) -> Vec<(String, f64)> {
        let value = |f: Feature| Some((f.name().to_string(), features.get(f).filter(|x| x.is_finite())?));
        Feature::every().filter_map(value).collect()
    }

    /// The features as they were.
    pub fn features(&self) -> Features {
        let mut features = Features::default();
        for (name, value) in &self.features {
            if let Some(f) = Feature::from_name(name) {
                features = features.with(f, Some(*value));
            }
        }
        features
    }
}

#[derive(Serialize, Deserialize)]
struct Posterior {
    /// keys of the causes
    causes: Vec<String>,
    mean: Vec<f64>,
    covariance: Vec<f64>,
    of_test: Vec<(String, f64)>,
    /// feature, measured less model, uncertainty of that
    discrepancy: Vec<(String, f64, f64)>,
}

#[derive(Serialize, Deserialize)]
struct Stored {
    format: String,
    name: String,
    source: String,
    actuator: String,
    /// as a TOML file has them; empty where no study saw them
    #[serde(default, skip_serializing_if = "String::is_empty")]
    sensors: String,
    spread: Vec<(String, f64)>,
    spread_name: String,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    friction_per_k: Option<f64>,
    kinds: Vec<KindEntry>,
    tests: Vec<TestEntry>,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    repairs: Vec<Repair>,
    posterior: Posterior,
}

/// One unit with its history.
#[derive(Clone, Debug, PartialEq)]
pub struct UnitFile {
    /// what it is called
    pub name: String,
    /// where the model came from, in words
    pub source: String,
    /// the model: constants deviate from it
    pub actuator: ActuatorParameters,
    /// as its study saw them, for recordings that do not say what sensors they are by
    pub sensors: Option<SensorModel>,
    /// how units of the type differ, and tests
    pub spread: Spread,
    /// kinds of tests that it was shown
    pub kinds: Vec<KindEntry>,
    /// every test that it was shown, in order
    pub tests: Vec<TestEntry>,
    /// what was renewed, in order: tests before the last repair no longer count
    pub repairs: Vec<Repair>,
    /// what is known now
    pub constants: Constants,
}

impl UnitFile {
    /// A unit of which no test is known. Its drive reckons with the torque constant of the type, whatever the unit's
    /// flux.
    pub fn new(name: String, source: String, mut actuator: ActuatorParameters, spread: Spread) -> Self {
        actuator.drive_constant_n_m_per_a = actuator.drive_constant();
        // whether they follow the friction fault only a worn unit knows: in between
        for e in actuator
            .effects
            .iter_mut()
            .filter(|e| e.is_present() && e.kind.is_friction() && e.grows == 0.0)
        {
            e.grows = 0.5;
        }
        let constants = Constants::prior(&actuator, &spread);
        Self {
            name,
            source,
            actuator,
            sensors: None,
            spread,
            kinds: Vec::new(),
            tests: Vec::new(),
            repairs: Vec::new(),
            constants,
        }
    }

    /// What is known of the constants before any test that counts: of renewed parts no more than the type says.
    pub fn prior(&self) -> Constants {
        let own = Constants::prior(&self.actuator, &self.spread);
        if self.repairs.is_empty() {
            return own;
        }
        let mut of_type = self.actuator.clone();
        of_type.uncertainty = Default::default();
        let of_type = Constants::prior(&of_type, &self.spread);
        self.repairs.iter().fold(own, |c, r| c.renewed(&of_type, r.part))
    }

    /// The kinds of its tests that differ from one of them in the rest angle alone, itself included.
    pub fn alike(&self, kind: &str) -> Vec<String> {
        let own = self.kinds.iter().find(|e| e.kind == kind);
        let alike = self.kinds.iter().filter(|e| own.is_some_and(|o| o.but_for_angle(e)));
        alike.map(|e| e.kind.clone()).collect()
    }

    /// Records a repair: faults, and what the tests so far said of the constants, are forgotten; the tests stay in the
    /// history.
    pub fn repair(&mut self, part: RepairedPart, note: String) {
        self.repairs.push(Repair { part, note });
        self.constants = self.prior();
    }

    /// Tests since the last repair that went in, in order.
    fn counted(&self) -> impl Iterator<Item = &TestEntry> {
        self.tests.iter().filter(|t| t.is_taken() && self.is_present(t))
    }

    /// Whether a test is of the unit as it is now: since the last repair.
    pub fn is_present(&self, t: &TestEntry) -> bool {
        t.repairs == self.repairs.len()
    }

    /// Healthy tests that went in.
    pub fn healthy(&self) -> usize {
        self.counted().filter(|t| t.healthy).count()
    }

    /// Tests at faults that nobody knew that went in, in order.
    pub fn worn(&self) -> impl Iterator<Item = &TestEntry> {
        self.counted().filter(|t| !t.healthy)
    }

    /// All tests that went in.
    pub fn taken(&self) -> usize {
        self.counted().count()
    }

    /// Why nothing is to be located with it, where more of its healthy tests were refused than taken: what its model misses would be
    /// taken for a fault.
    pub fn contradicted(&self) -> Option<String> {
        let refused = |t: &&TestEntry| t.healthy && !t.is_taken() && self.is_present(t);
        let (refused, taken) = (self.tests.iter().filter(refused).count(), self.healthy());
        (refused > taken).then(|| {
            format!(
                "{refused} of the unit's {} healthy tests contradict its model, which misses something of it that would be taken for \
                 a fault: study it again (ema discrepancy), or show it healthy tests that agree with each other",
                refused + taken
            )
        })
    }

    /// What faults are relative to: `unit` with a healthy test, else `type`.
    pub fn reference(&self) -> &'static str {
        if self.healthy() > 0 { "unit" } else { "type" }
    }

    /// Writes it as one JSON object, whole or not at all.
    ///
    /// # Errors
    /// Fails where the file cannot be written.
    pub fn save(&self, path: &Path) -> Result<()> {
        let pairs = |of: &[(Cause, f64)]| of.iter().map(|(c, h)| (c.key().to_string(), *h)).collect::<Vec<_>>();
        let spread: Vec<(Cause, f64)> = self.spread.causes().collect();
        let c = &self.constants;
        let stored = Stored {
            format: FORMAT.into(),
            name: self.name.clone(),
            source: self.source.clone(),
            actuator: self.actuator.to_toml(),
            sensors: self.sensors.as_ref().map_or_else(String::new, SensorModel::to_toml),
            spread: pairs(&spread),
            spread_name: self.spread.name.clone(),
            friction_per_k: Some(self.spread.friction_per_k).filter(|x| *x != 0.0),
            kinds: self.kinds.clone(),
            tests: self.tests.clone(),
            repairs: self.repairs.clone(),
            posterior: Posterior {
                causes: c.causes.iter().map(|c| c.key().to_string()).collect(),
                mean: c.mean.clone(),
                covariance: c.covariance.clone(),
                of_test: pairs(&c.of_test),
                discrepancy: c
                    .discrepancy
                    .iter()
                    .map(|d| (d.feature.name().to_string(), d.shift, d.uncertainty))
                    .collect(),
            },
        };
        let text = serde_json::to_string_pretty(&stored).expect("plain data");
        write_whole(path, seal::sealed(&text).as_bytes())
    }

    /// Reads a unit file.
    ///
    /// # Errors
    /// Refuses what cannot be read, is no unit file, holds numbers that cannot be, or was changed by other hands.
    pub fn load(path: &Path) -> Result<Self> {
        let text = std::fs::read_to_string(path).map_err(|e| Error::io(path, "cannot be read", e))?;
        let file = path.display().to_string();
        let allowed = "a unit file (ema unit new)";
        let s: Stored = serde_json::from_str(&text).map_err(|e| {
            let place = format!("line {}, column {}", e.line(), e.column());
            let found = e.to_string().split(" at line").next().unwrap_or_default().to_string();
            Error::bad(&file, place, found, allowed)
        })?;
        if s.format != FORMAT && s.format != FIRST_FORMAT {
            return Err(Error::bad(&file, "format", s.format, FORMAT));
        }
        let cause = |key: &String| {
            let found = Cause::ALL.into_iter().find(|c| c.key() == key);
            found.ok_or_else(|| Error::bad(&file, "posterior", key, Cause::ALL.map(Cause::key).join(", ")))
        };
        let pairs = |of: &[(String, f64)]| of.iter().map(|(k, h)| Ok((cause(k)?, *h))).collect::<Result<Vec<_>>>();
        let discrepancy = |(name, shift, uncertainty): &(String, f64, f64)| {
            let feature = Feature::from_name(name);
            let feature = feature.filter(|_| shift.is_finite() && uncertainty.is_finite() && *uncertainty >= 0.0);
            let allowed = "a feature and two finite numbers, the uncertainty not below 0";
            let feature = feature.ok_or_else(|| Error::bad(&file, "discrepancy", name, allowed))?;
            Ok(Discrepancy {
                feature,
                shift: *shift,
                uncertainty: *uncertainty,
            })
        };
        let mut spread = Spread::none();
        spread.name = s.spread_name;
        spread.friction_per_k = s.friction_per_k.unwrap_or(0.0);
        for (c, h) in pairs(&s.spread)? {
            spread.half_width[c as usize] = h;
        }
        let causes = s.posterior.causes.iter().map(cause).collect::<Result<Vec<_>>>()?;
        let mut mean = s.posterior.mean;
        if s.format == FIRST_FORMAT {
            mean.iter_mut().zip(&causes).for_each(|(x, c)| *x = c.counted(*x));
        }
        let constants = Constants {
            causes,
            mean,
            covariance: s.posterior.covariance,
            of_test: pairs(&s.posterior.of_test)?,
            friction_per_k: spread.friction_per_k,
            discrepancy: s
                .posterior
                .discrepancy
                .iter()
                .map(discrepancy)
                .collect::<Result<Vec<_>>>()?,
        };
        let n = constants.causes.len();
        let numbers = constants
            .mean
            .iter()
            .chain(&constants.covariance)
            .chain(&spread.half_width);
        let finite = numbers.into_iter().all(|x| x.is_finite());
        let positive = (0..n).all(|i| constants.covariance.get(i * n + i).is_some_and(|x| *x >= 0.0));
        if !finite || !positive || constants.mean.len() != n || constants.covariance.len() != n * n || n > Cause::COUNT
        {
            let found = format!(
                "{n} causes, {} means, {} covariances",
                constants.mean.len(),
                constants.covariance.len()
            );
            return Err(Error::bad(
                &file,
                "posterior",
                found,
                "finite numbers: n, n and n^2 of them, variances not below 0",
            ));
        }
        let unit = Self {
            name: s.name,
            source: s.source,
            actuator: ActuatorParameters::parse(&format!("{file}: actuator"), &s.actuator)?,
            sensors: sensors_in(&file, &s.sensors)?,
            spread,
            kinds: s.kinds,
            tests: s.tests,
            repairs: s.repairs,
            constants,
        };
        let prior = unit.prior();
        if prior.causes != unit.constants.causes || prior.of_test != unit.constants.of_test {
            let names = |c: &[Cause]| c.iter().map(|c| c.key()).collect::<Vec<_>>().join(", ");
            let (found, allowed) = (names(&unit.constants.causes), names(&prior.causes));
            return Err(Error::bad(
                &file,
                "posterior",
                found,
                format!("{allowed}: those of its actuator and spread"),
            ));
        }
        seal::check(path, &text, "ema unit")?;
        Ok(unit)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use schemas::feature::RawFeatures;

    fn unit() -> UnitFile {
        let spread = sim_worker::catalogue::spread("unit").unwrap();
        let mut u = UnitFile::new(
            "tail 7".into(),
            "reference".into(),
            ActuatorParameters::reference(),
            spread,
        );
        let sequence = sim_worker::catalogue::sequence("preflight").unwrap();
        let mut setup = TestSetup::new(Arc::new(u.actuator.clone()), sequence, 2000.0);
        setup.sensors = sim_worker::catalogue::sensors("reference").unwrap();
        setup.rest_angle_rad = 0.1 / 3.0;
        u.kinds.push(KindEntry::of(&setup));
        let features =
            Features::over(&RawFeatures::default(), &RawFeatures::default()).with(Feature::P2, Some(1.0 / 3.0));
        u.tests.push(TestEntry {
            file: "a \"b\".csv".into(),
            checksum: "00".into(),
            healthy: false,
            outcome: "located".into(),
            reason: String::new(),
            kind: u.kinds[0].kind.clone(),
            fsj: Some((1.0, 1.1, 1.2)),
            zeta: None,
            features: TestEntry::named(&features),
            commit: "none".into(),
            repairs: 0,
        });
        u.constants.mean[0] = 0.01 / 3.0;
        u
    }

    #[test]
    fn prop_a_unit_is_doubted_while_more_healthy_tests_contradict_it_than_agree() {
        let mut u = unit();
        let healthy = |reason: &str| TestEntry {
            healthy: true,
            reason: reason.into(),
            ..u.tests[0].clone()
        };
        let (good, refused) = (healthy(""), healthy("it contradicts the unit"));
        assert_eq!(u.contradicted(), None);
        u.tests.push(refused.clone());
        assert!(
            u.contradicted()
                .is_some_and(|why| why.starts_with("1 of the unit's 1 "))
        );
        u.tests.push(good);
        assert_eq!(u.contradicted(), None);
        u.tests.push(refused);
        assert!(
            u.contradicted()
                .is_some_and(|why| why.starts_with("2 of the unit's 3 "))
        );
        // what was renewed is another unit
        u.repair(RepairedPart::Transmission, String::new());
        assert_eq!(u.contradicted(), None);
    }

    #[test]
    fn prop_a_unit_written_and_read_is_the_same() {
        let dir = std::env::temp_dir().join(format!("ema-unit-{}", std::process::id()));
        std::fs::create_dir_all(&dir).unwrap();
        let (u, file) = (unit(), dir.join("u.json"));
        u.save(&file).unwrap();
        let read = UnitFile::load(&file).unwrap();
        assert_eq!(read, u);
        assert_eq!(read.tests[0].features().get(Feature::P2), Some(1.0 / 3.0));
        assert_eq!((read.taken(), read.healthy(), read.reference()), (1, 0, "type"));
        let setup = read.kinds[0].setup("u", Arc::new(read.actuator.clone())).unwrap();
        assert_eq!(KindEntry::of(&setup), u.kinds[0]);
        // the drive keeps to the type's torque constant
        assert_eq!(read.actuator.drive_constant_n_m_per_a, 0.0752);

        let good = std::fs::read_to_string(&file).unwrap();
        let refused = |text: String, words: &[&str]| {
            std::fs::write(&file, text).unwrap();
            let e = UnitFile::load(&file).unwrap_err().to_string();
            assert!(e.contains("u.json") && !e.contains('\n'), "{e}");
            words.iter().for_each(|w| assert!(e.contains(w), "no `{w}` in {e}"));
        };
        refused(good[..good.len() / 2].into(), &["line", "a unit file (ema unit new)"]);
        refused(good.replace("ema unit 2", "ema unit 9"), &["format", "ema unit 9"]);
        refused(
            good.replace("\"inertia_relative\"", "\"inertia\""),
            &["inertia", "inertia_relative"],
        );
        refused(good.replacen("0.0033333333333333335,", "", 1), &["posterior", "n^2"]);
        refused("{}".into(), &["format"]);
        // of an earlier version: means were relative
        let mut old: serde_json::Value = serde_json::from_str(&good).unwrap();
        old["format"] = FIRST_FORMAT.into();
        let object = old.as_object_mut().unwrap();
        for key in ["sealed", "checksum"] {
            object.remove(key);
        }
        std::fs::write(&file, seal::sealed(&old.to_string())).unwrap();
        let read = UnitFile::load(&file).unwrap();
        assert_eq!(read.constants.mean[0], (0.01_f64 / 3.0).ln_1p());
        std::fs::remove_dir_all(&dir).unwrap();
    }

    #[test]
    fn prop_a_repair_forgets_what_tests_said_and_keeps_their_history() {
        let mut u = unit();
        u.tests[0].healthy = true;
        assert_eq!((u.taken(), u.healthy(), u.reference()), (1, 1, "unit"));
        let before = u.prior();
        u.repair(RepairedPart::Transmission, "new ball screw".into());
        assert_eq!(
            (u.taken(), u.healthy(), u.reference(), u.tests.len()),
            (0, 0, "type", 1)
        );
        assert_eq!(u.constants, u.prior());
        // nothing was studied: the type is what was known before
        assert_eq!(u.prior(), before);
        let path = std::env::temp_dir().join(format!("ema-unit-repair-{}.json", std::process::id()));
        u.save(&path).unwrap();
        let read = UnitFile::load(&path);
        std::fs::remove_file(&path).unwrap();
        assert_eq!(read.unwrap(), u);
    }

    #[test]
    fn prop_a_unit_keeps_its_slope_of_friction_and_is_told_from_others_by_it() {
        let mut spread = sim_worker::catalogue::spread("service").unwrap();
        let of = |s: &Spread| UnitFile::new("t".into(), "-".into(), ActuatorParameters::reference(), s.clone());
        let a = of(&spread);
        let path = std::env::temp_dir().join(format!("ema-unit-slope-{}.json", std::process::id()));
        a.save(&path).unwrap();
        let read = UnitFile::load(&path);
        std::fs::remove_file(&path).unwrap();
        assert_eq!(read.unwrap(), a);
        spread.friction_per_k *= 2.0;
        assert_ne!(a.prior().fingerprint(), of(&spread).prior().fingerprint());
    }
}
