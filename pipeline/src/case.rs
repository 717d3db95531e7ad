//! Diagnosis of one recording, offline: the same extractor, maps and inversion that fly.

use crate::digits;
use crate::input::{self, How, Measured};
use crate::maps::{self, MapRequest};
use crate::refine::{self, Refined};
use anyhow::Result;
use diagnoser::diagnosis::{Diagnoser, Diagnosis, Known, Outcome, parse_known};
use diagnoser::failure_map::FailureMapSet;
use diagnoser::live::{HIGHEST_RATE_HZ, LOWEST_RATE_HZ};
use diagnoser::map_library::{self, Choice};
use diagnoser::unit::{BASELINES, UnitFile};
use ema_tables::ChannelMap;
use schemas::channel::Channel;
use schemas::error::Error;
use schemas::fault::{FaultGrid, Interval};
use schemas::feature::{Feature, Features, RawFeatures};
use schemas::test_kind::TestKind;
use serde_json::Value;
use sim_worker::extractor::{FeatureExtractor, FeaturePlan};
use sim_worker::parameters::ActuatorParameters;
use sim_worker::sensor::SensorModel;
use sim_worker::setup::TestSetup;
use sim_worker::spread::{Cause, Spread};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// How to diagnose.
#[derive(Clone, Debug)]
pub struct Settings {
    /// the one that the recording brings, else the reference, if `None`
    pub actuator: Option<Arc<ActuatorParameters>>,
    /// folder with `maps.parquet`; the cache if `None`
    pub maps: Option<PathBuf>,
    /// number of the run, where the recording holds several
    pub run: Option<u64>,
    /// name or file; recognised from the command if `None`
    pub sequence: Option<String>,
    /// columns of the recording that are not called as ours
    pub channels: Option<Arc<ChannelMap>>,
    /// `auto`, `none`, or a sensor model by name or file
    pub sensors: String,
    /// fault pairs of maps that are made on first use
    pub grid: FaultGrid,
    /// what intervals are to be made for
    pub choice: Choice,
    /// what is known of the unit: KEY=NUMBER
    pub known: Vec<String>,
    /// the unit that was tested; one of its type, of which nothing more is known, if `None`
    pub unit: Option<Arc<UnitFile>>,
}

/// As well as an actuator's file says that it was identified by a study; nothing differs where it says nothing.
pub fn own_spread(actuator: Option<&ActuatorParameters>) -> Spread {
    actuator.and_then(Spread::identified).unwrap_or_else(Spread::none)
}

impl Settings {
    /// For a recording of an actuator, with all that can be recognised left to be.
    ///
    /// # Errors
    /// Where the catalogue does not know the usual grid.
    pub fn of_actuator(actuator: Arc<ActuatorParameters>) -> Result<Self> {
        Ok(Self {
            choice: Choice {
                spread: own_spread(Some(&actuator)),
                coverage: diagnoser::calibration::COVERAGE,
            },
            actuator: Some(actuator),
            maps: None,
            run: None,
            sequence: None,
            channels: None,
            sensors: "auto".into(),
            grid: sim_worker::catalogue::grid("fine")?,
            known: Vec::new(),
            unit: None,
        })
    }

    /// How to read the recording.
    pub fn how(&self) -> How<'_> {
        How {
            run: self.run,
            channels: self.channels.as_deref(),
            sequence: self.sequence.as_deref(),
        }
    }

    /// The actuator that a recording is taken for.
    pub fn actuator_of(&self, m: &Measured) -> Arc<ActuatorParameters> {
        let own = || m.setup.as_ref().map(|s| s.actuator.clone());
        let of_unit = || self.unit.as_ref().map(|u| Arc::new(u.actuator.clone()));
        let named = of_unit().or_else(|| self.actuator.clone()).or_else(own);
        named.unwrap_or_else(|| Arc::new(ActuatorParameters::reference()))
    }
}

/// A diagnosed recording.
pub struct Case {
    /// the recording
    pub measured: Measured,
    /// before anything nominal is subtracted
    pub raw: RawFeatures,
    /// the test that it is
    pub setup: TestSetup,
    /// what was found
    pub diagnosis: Diagnosis,
    /// the maps that it was found by
    pub diagnoser: Diagnoser,
    /// what the telemetry lacks, in words
    pub missing: Vec<String>,
    /// the paper's own method in place of the joint inversion
    by_paper: bool,
}

impl Case {
    /// Takes the paper's own method in place of the joint inversion.
    pub fn by_paper(&mut self) {
        self.by_paper = true;
        self.diagnosis = diagnoser::paper::diagnose(&self.diagnoser, &self.diagnosis.features, &self.missing);
    }
}

/// Features of a recording.
pub fn extract(m: &Measured, plan: Arc<FeaturePlan>) -> FeatureExtractor {
    let mut x = FeatureExtractor::new(plan);
    x.push(&m.telemetry.view());
    x
}

/// The sensor model of a recording: named, said by the file, those that the study of its unit saw, or recognised from its values.
///
/// # Errors
/// Refuses sensors that are not known.
pub fn sensors_of(path: &Path, m: &Measured, settings: &Settings) -> Result<Option<SensorModel>> {
    if settings.sensors != "auto" {
        return Ok(sim_worker::catalogue::sensors(&settings.sensors)?);
    }
    if let Some(setup) = &m.setup {
        return Ok(setup.sensors.clone());
    }
    let of_unit = settings.unit.as_ref().and_then(|u| u.sensors.clone());
    if m.sensors.is_empty() && of_unit.is_some() {
        return Ok(of_unit);
    }
    let reference = sim_worker::catalogue::sensors("reference")?;
    if m.sensors == "none" {
        return Ok(None);
    }
    if !m.sensors.is_empty() && reference.as_ref().is_none_or(|r| r.fingerprint() != m.sensors) {
        let allowed = "none or those of the reference; name others with --sensors FILE.toml";
        return Err(Error::bad(
            path.display().to_string(),
            "fingerprint of the sensors",
            &m.sensors,
            allowed,
        )
        .into());
    }
    Ok(reference.filter(|r| !m.sensors.is_empty() || input::is_quantised(m, r)))
}

/// Temperatures of an actuator at a test [deg C] (assumed).
const TEMPERATURES_DEGC: (f64, f64) = (-100.0, 300.0);

/// Mean temperature of a recording; none where it has none.
///
/// # Errors
/// Refuses one that no actuator has.
fn temperature_degc(path: &Path, m: &Measured) -> Result<Option<f64>> {
    let Some(column) = m.telemetry.column(Channel::Temperature).filter(|c| !c.is_empty()) else {
        return Ok(None);
    };
    let mean = column.iter().sum::<f64>() / column.len() as f64;
    let (lo, hi) = TEMPERATURES_DEGC;
    if !(lo..=hi).contains(&mean) {
        let place = format!("column `{}`", Channel::Temperature.name());
        let allowed =
            format!("a mean of {lo} to {hi} degC; --known temperature_degc=VALUE says it where the sensor does not");
        return Err(Error::bad(path.display().to_string(), place, mean, allowed).into());
    }
    Ok(Some(mean))
}

/// Maps for a recording: from the cache, or those of `--maps`.
fn chosen_maps(path: &Path, m: &Measured, s: &Settings, setup: &TestSetup) -> Result<Diagnoser> {
    // the resolver knows the angle: where it is a cause of spread it is a known one
    let known = |maps_rest_rad: f64| -> Result<Known> {
        let mut known = parse_known(&s.known, &setup.actuator, maps_rest_rad)?;
        let cause = Cause::RestAngle;
        if s.choice.spread.half_width[cause as usize] > 0.0 && !known.iter().any(|(c, _)| *c == cause) {
            known.push((
                cause,
                cause.deviation(&setup.actuator, maps_rest_rad, setup.rest_angle_rad),
            ));
        }
        let cause = Cause::TestTemperature;
        let spread = s.unit.as_ref().map_or(&s.choice.spread, |u| &u.spread);
        if spread.half_width[cause as usize] > 0.0 && !known.iter().any(|(c, _)| *c == cause) {
            let recorded = temperature_degc(path, m)?;
            known.extend(recorded.map(|t| (cause, cause.deviation(&setup.actuator, maps_rest_rad, t))));
        }
        Ok(known)
    };
    // what the file says of itself
    let recorded = TestKind {
        // a unit is not the model, whatever its recorder took it for
        parameters: if s.unit.is_some() {
            setup.kind().parameters
        } else {
            m.parameters.clone()
        },
        load_n_m: m.load_n_m,
        ..setup.kind()
    };
    let bad =
        |place: &str, found: String, allowed: String| Error::bad(path.display().to_string(), place, found, allowed);
    let Some(dir) = &s.maps else {
        let setup = TestSetup {
            rest_angle_rad: map_library::rounded_rest_angle(setup.rest_angle_rad),
            load_n_m: 0.0,
            ..setup.clone()
        };
        if let Some(d) = recorded.difference(&setup.kind()) {
            let more = if d.place == "parameter fingerprint" {
                format!("(actuator `{}`; choose with --actuator)", setup.actuator.name)
            } else {
                "(of maps made on first use; --maps chooses others)".into()
            };
            return Err(bad(d.place, d.found, format!("{} {more}", d.allowed)).into());
        }
        let known = known(setup.rest_angle_rad)?;
        if let Some(unit) = &s.unit {
            return crate::unit::diagnoser(&setup, s, unit, &known);
        }
        let grid = s.grid.clone();
        return maps::cached(&MapRequest { setup, grid }, &s.choice, &known);
    };
    let file = map_library::file_in(dir);
    let set = FailureMapSet::load(&file)?;
    let maps = &set.header.kind;
    let of_maps = |allowed: String| format!("{allowed} (of {})", file.display());
    if let Some(d) = recorded.difference(maps) {
        return Err(bad(d.place, d.found, of_maps(d.allowed)).into());
    }
    let own = setup.actuator.fingerprint();
    if own != maps.parameters {
        let place = format!("parameters of actuator `{}`", setup.actuator.name);
        return Err(bad(&place, own, of_maps(maps.parameters.clone())).into());
    }
    let known = known(maps.rest_angle_rad)?;
    Ok(s.choice.ready(&file, set, &known)?)
}

/// A recording as the test that it is.
pub struct TestOf {
    /// at the rest angle that was measured
    pub setup: TestSetup,
    /// whether its first sample is that of the test
    pub begins: bool,
    /// before anything nominal is subtracted
    pub raw: RawFeatures,
    /// what the telemetry lacks, in words
    pub missing: Vec<String>,
}

/// The test that a recording is of, and its features.
///
/// # Errors
/// Refuses a rate below 1 kHz or above 1 MHz, and what cannot be recognised.
pub fn test_of(path: &Path, measured: &Measured, settings: &Settings) -> Result<TestOf> {
    if !(LOWEST_RATE_HZ * (1.0 - 1e-6)..=HIGHEST_RATE_HZ * (1.0 + 1e-6)).contains(&measured.rate_hz) {
        let allowed = format!("a steady rate of at least {LOWEST_RATE_HZ} Hz, at most {HIGHEST_RATE_HZ} Hz");
        return Err(Error::bad(path.display().to_string(), "rate [Hz]", measured.rate_hz, allowed).into());
    }
    let actuator = settings.actuator_of(measured);
    let sequence = match &measured.setup {
        Some(s) if settings.sequence.is_none() => s.sequence.clone(),
        _ => input::recognise(path, measured, settings.sequence.as_deref(), actuator.step_s)?,
    };
    // the rotor angle at rest is that of the first sample of the test, if it is there
    let begins = measured.telemetry.first == 1;
    let angles = measured.telemetry.column(Channel::ThetaM).filter(|_| begins);
    let setup = TestSetup {
        actuator,
        sequence,
        sensors: sensors_of(path, measured, settings)?,
        rate_hz: measured.rate_hz,
        rest_angle_rad: angles.map_or(0.0, |t| t[0]).rem_euclid(std::f64::consts::TAU),
        load_n_m: 0.0,
        equivalent_current: FeaturePlan::lacks_phases(|c| measured.telemetry.column(c).is_some()),
    };
    let x = extract(measured, Arc::new(setup.feature_plan()));
    Ok(TestOf {
        begins,
        raw: x.features(),
        missing: x.missing(),
        setup,
    })
}

/// Diagnoses a telemetry file.
///
/// # Errors
/// Refuses what [`input::open`] and [`test_of`] refuse, and a test of another kind than the maps'. Making
/// maps may be interrupted ([`crate::Interrupted`]).
pub fn run(path: &Path, settings: &Settings) -> Result<Case> {
    let measured = input::open(path, settings.how())?;
    let test = test_of(path, &measured, settings)?;
    let TestOf {
        mut setup,
        raw,
        begins,
        mut missing,
    } = test;
    let diagnoser = chosen_maps(path, &measured, settings, &setup)?;
    let maps = &diagnoser.maps;
    let mut diagnosis = diagnoser.diagnose(&maps.features(&raw), &missing);
    if !begins {
        let n = measured.telemetry.first;
        missing.insert(
            0,
            format!("the recording starts at sample {n}: the rotor angle at rest is unknown"),
        );
        let reason = missing.join("; ");
        diagnosis.outcome = Outcome::Incomplete { reason, area: None };
        // nothing nominal is known at an unknown angle
        diagnosis.features = Features::over(&raw, &RawFeatures::default());
    }
    setup.rest_angle_rad = maps.header.kind.rest_angle_rad;
    setup.load_n_m = maps.header.kind.load_n_m.unwrap_or(0.0);
    Ok(Case {
        measured,
        raw,
        setup,
        diagnosis,
        diagnoser,
        missing,
        by_paper: false,
    })
}

/// A path as a shell takes it.
pub(crate) fn quoted(path: &Path) -> String {
    let text = path.display().to_string();
    let plain = |c: char| c.is_ascii_alphanumeric() || "/._-+=:,".contains(c);
    if text.chars().all(plain) {
        text
    } else {
        format!("'{}'", text.replace('\'', "'\\''"))
    }
}

/// The command that makes more of a recording that nothing explains, and what for.
///
/// * `file` the recording
/// * `unit` that was tested, and its file
/// * `actuator` file of the one that it was taken for; the reference if `None`
/// * `channels` file that says which column is what
pub fn next_command(
    file: &Path,
    case: &Case,
    unit: Option<(&UnitFile, &Path)>,
    actuator: Option<&Path>,
    channels: Option<&Path>,
) -> (Option<String>, &'static str) {
    let of_unit = unit.map(|(u, _)| Path::new(&u.source)).filter(|p| p.exists());
    let model = of_unit.or(actuator);
    let model = model.map_or(crate::discrepancy::REFERENCE.into(), quoted);
    if unit.is_some_and(|(u, _)| u.contradicted().is_some()) {
        return (
            Some(format!(
                "ema discrepancy --actuator {model} --bench RECORDING... --healthy --out study"
            )),
            "looks in recordings of the healthy unit for what its model misses",
        );
    }
    if let Some((unit, path)) = unit.filter(|(u, _)| u.healthy() < BASELINES) {
        let more = match unit.healthy() {
            0 => "takes in healthy tests of this very unit: what its model is off by is then known",
            _ => "takes in more healthy tests of this very unit: three or more also show what its model is off by",
        };
        return (
            Some(format!("ema unit update {} RECORDING... --healthy", quoted(path))),
            more,
        );
    }
    // what a study cannot be made of
    let has = |c: Channel| case.measured.telemetry.column(c).is_some();
    if !has(Channel::IQ) && ![Channel::IA, Channel::IB, Channel::IC].into_iter().all(has) {
        let more =
            "a recording with the signed current (i_q, or i_a, i_b, i_c) would show what is missing from the model";
        return (None, more);
    }
    if input::is_dataset(file) {
        return (
            None,
            "a file of this run alone (ema dataset export) would show what is missing from the model",
        );
    }
    let mapped = channels.map_or(String::new(), |c| format!(" --channels {}", quoted(c)));
    let study = format!(
        "ema discrepancy --actuator {model} --bench {}{mapped} --out study",
        quoted(file)
    );
    (Some(study), "looks for what is missing from the model")
}

/// The diagnosis for programs: the keys of `ema diagnose --json`.
///
/// * `unit` that was tested, where one is known
/// * `refined` by running the test bench, where that was done
/// * `next` the command that makes more of a recording that nothing explains
pub fn to_json(case: &Case, unit: Option<&UnitFile>, refined: Option<&Refined>, next: Option<&str>) -> Value {
    let mut json = diagnoser::report::to_json(&case.diagnosis);
    if case.by_paper {
        json["method"] = "paper".into();
    }
    if let Some(r) = refined {
        json["refined"] = refine::to_json(r);
    }
    if let Some(unit) = unit {
        json["unit"] = serde_json::json!({
            "name": unit.name, "tests": unit.taken(), "healthy_tests": unit.healthy(), "reference": unit.reference(),
        });
    }
    let alike = alike(case, unit);
    if !alike.is_empty() {
        json["reads_as_fsj"] = alike.iter().map(|a| a.0).collect::<Vec<_>>().into();
    }
    if !case.measured.said.is_empty() {
        json["read"] = case.measured.said.clone().into();
    }
    if let Some(next) = next {
        json["next_command"] = next.into();
    }
    json
}

/// What would read as the friction fault in a located test, in proportion, and no interval allows for: key and words.
///
/// * `unit` that was tested, where one is known
pub fn alike(case: &Case, unit: Option<&UnitFile>) -> Vec<(&'static str, &'static str)> {
    if !matches!(case.diagnosis.outcome, Outcome::Located(_)) {
        return Vec::new();
    }
    let spread = case
        .diagnoser
        .calibration
        .as_ref()
        .map_or_else(Spread::none, |c| c.spread());
    let allows = |c: Cause| spread.half_width[c as usize] > 0.0;
    // a healthy test shows what friction the unit has and what its sensors make of the run-up
    let healthy = unit.is_some_and(|u| u.reference() == "unit");
    let mut alike = Vec::new();
    if !healthy && !allows(Cause::HealthyFriction) {
        alike.push(("healthy_friction", "another healthy friction"));
    }
    if !allows(Cause::TestTemperature) {
        alike.push(("friction_temperature", "another temperature"));
    }
    if !healthy {
        alike.push(("current_gain", "a gain of the current sensors"));
    }
    alike
}

/// The same in one sentence; none where there is nothing.
pub fn alike_text(case: &Case, unit: Option<&UnitFile>) -> Option<String> {
    let words: Vec<&str> = alike(case, unit).into_iter().map(|a| a.1).collect();
    let (last, first) = words.split_last()?;
    let list = if first.is_empty() {
        last.to_string()
    } else {
        format!("{} or {last}", first.join(", "))
    };
    Some(format!("{list} would read as FSJ; the interval does not allow for it"))
}

/// The tests that the intervals are calibrated on, in words; none where they are not.
pub(crate) fn grounds(case: &Case) -> Option<String> {
    let c = case.diagnoser.calibration.as_ref()?;
    Some(if crate::map_table::is_of_table(&case.diagnoser.maps.header) {
        format!("{} rows of the table that made the maps", c.runs)
    } else if c.spread().is_none() {
        let of = "this very actuator (no spread from unit to unit)";
        format!("{} simulated tests of {of}", c.runs)
    } else {
        format!(
            "{} simulated tests of units that differ from each other (spread {})",
            c.runs, c.spread
        )
    })
}

/// What the intervals promise, and on what grounds.
fn coverage(case: &Case) -> String {
    let percent = 100.0 * case.diagnosis.coverage;
    if percent.is_nan() {
        return "coverage  none: the paper's method states none (its bands are the maps', assumed)".into();
    }
    match grounds(case) {
        Some(tests) => format!("coverage  {percent:.1} %, calibrated on {tests}"),
        None => format!("coverage  {percent:.1} % by design, not calibrated (ema calibrate)"),
    }
}

/// An estimate and the ends of its interval, to two digits of the interval's half-width.
pub(crate) fn three(estimate: f64, i: Interval) -> [String; 3] {
    [estimate, i.lo, i.hi].map(|x| digits::fixed(x, 0.5 * i.width()))
}

/// The diagnosis for a person, each number to as many digits as its uncertainty leaves; JSON has them all.
///
/// * `unit` that was tested, where one is known
pub fn to_text(case: &Case, unit: Option<&UnitFile>) -> String {
    let d = &case.diagnosis;
    let mut out = String::new();
    let mut line = |s: String| {
        out += &s;
        out.push('\n');
    };
    match &d.outcome {
        Outcome::Located(a) | Outcome::Incomplete { area: Some(a), .. } => {
            line(format!("outcome   {}", d.outcome.name().replace('_', " ")));
            let [e, lo, hi] = three(a.centroid.0, a.fsj);
            line(format!("FSJ       {e:<8} in {lo} .. {hi}"));
            let [e, lo, hi] = three(a.centroid.1, a.zeta);
            line(format!("zeta      {e:<8} in {lo} .. {hi}"));
            if let Some(k) = &d.kinetic {
                let [e, lo, hi] = three(k.estimate, k.interval);
                line(format!(
                    "kinetic   {e:<8} in {lo} .. {hi} (dynamic friction over the healthy model's: FSJ times the unit's own ratio)"
                ));
            }
            if a.parts.len() > 1 {
                for (k, p) in a.parts.iter().enumerate() {
                    let [f, f0, f1] = three(p.centroid.0, p.fsj);
                    let [z, z0, z1] = three(p.centroid.1, p.zeta);
                    line(format!(
                        "area {:2}   FSJ {f} in {f0} .. {f1}, zeta {z} in {z0} .. {z1}",
                        k + 1
                    ));
                }
            }
            line(coverage(case));
            if let Some(alike) = alike_text(case, unit) {
                line(format!("alike     {alike}"));
            }
            line(format!(
                "area      {:.3e} .. {:.3e} (FSJ x zeta, enclosed from within and without)",
                a.inner, a.outer
            ));
        }
        o => line(format!("outcome   {}", o.name().replace('_', " "))),
    }
    if !d.outcome.reason().is_empty() {
        line(format!("reason    {}", d.outcome.reason()));
    }
    let band = d.outcome.area().map_or(case.diagnoser.usual_band(), |a| a.band);
    let shown: Vec<Feature> = Feature::located_by().filter(|f| d.features.get(*f).is_some()).collect();
    let width = shown.iter().map(|f| f.name().len()).fold(11, usize::max);
    for f in shown {
        if let (Some(v), Some(m)) = (d.features.get(f), case.diagnoser.maps.map(f)) {
            let (lo, hi) = m.range();
            let (f0, z0) = d.outcome.area().map_or((m.fsj[0], m.zeta[0]), |a| a.centroid);
            let h = band * case.diagnoser.uncertainty(f, f0, z0).unwrap_or(f64::NAN);
            line(format!(
                "{:width$} {:11} {:5} +- {h:.1e}   map {lo:.3e} .. {hi:.3e}",
                f.name(),
                digits::scientific(v, h),
                f.unit()
            ));
        }
    }
    let h = &case.diagnoser.maps.header;
    let sensors = if h.kind.sensors == "none" {
        "noise free"
    } else {
        "with sensor model (assumed)"
    };
    line(format!(
        "maps      actuator {}, {} at {} Hz, rest angle {:.1} deg, {sensors}",
        h.actuator,
        h.sequence,
        h.kind.rate_hz,
        h.kind.rest_angle_rad.to_degrees()
    ));
    for l in &h.left_out {
        out += &format!("left out  {l}\n");
    }
    out
}
