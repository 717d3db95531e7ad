//! Diagnosis of one recording, offline: the same extractor, maps and inversion that fly.

use crate::calibrate::TestKind;
use crate::input::{self, Measured};
use crate::maps::{self, MapRequest};
use anyhow::Result;
use diagnoser::diagnosis::{Diagnoser, Diagnosis, Known, Outcome, parse_known};
use diagnoser::failure_map::FailureMapSet;
use diagnoser::live::LOWEST_RATE_HZ;
use diagnoser::map_library::{self, Choice};
use schemas::channel::Channel;
use schemas::error::Error;
use schemas::fault::FaultGrid;
use schemas::feature::{Feature, Features, RawFeatures};
use schemas::sequence::TestSequence;
use sim_worker::extractor::{FeatureExtractor, FeaturePlan};
use sim_worker::parameters::ActuatorParameters;
use sim_worker::sensor::SensorModel;
use sim_worker::spread::Cause;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// How to diagnose.
#[derive(Clone, Debug)]
pub struct Settings {
    pub actuator: Arc<ActuatorParameters>,
    /// folder with `maps.parquet`; the cache if `None`
    pub maps: Option<PathBuf>,
    pub run: Option<u64>,
    /// name or file; recognised from the command if `None`
    pub sequence: Option<String>,
    /// `auto`, `none`, or a sensor model by name or file
    pub sensors: String,
    pub grid: FaultGrid,
    /// what intervals are to be made for
    pub choice: Choice,
    /// what is known of the unit: KEY=NUMBER
    pub known: Vec<String>,
}

/// A diagnosed recording.
pub struct Case {
    pub measured: Measured,
    pub raw: RawFeatures,
    /// the kind of test that it is
    pub kind: TestKind,
    pub diagnosis: Diagnosis,
    pub diagnoser: Diagnoser,
}

/// Features of a recording.
pub fn extract(m: &Measured, plan: Arc<FeaturePlan>) -> FeatureExtractor {
    let mut x = FeatureExtractor::new(plan);
    x.push(&m.telemetry.view());
    x
}

/// The sensor model of a recording: named, said by the file, or recognised from its values.
pub fn sensors_of(path: &Path, m: &Measured, settings: &Settings) -> Result<Option<SensorModel>> {
    if settings.sensors != "auto" {
        return Ok(sim_worker::catalogue::sensors(&settings.sensors)?);
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

fn chosen_maps(path: &Path, m: &Measured, s: &Settings, sequence: &TestSequence, rest: f64) -> Result<Diagnoser> {
    let equivalent_current = [Channel::IA, Channel::IB, Channel::IC]
        .iter()
        .any(|c| m.telemetry.column(*c).is_none());
    // the resolver knows the angle: where it is a cause of spread it is a known one
    let known = |maps_rest_rad: f64| -> Result<Known> {
        let mut known = parse_known(&s.known, &s.actuator, maps_rest_rad)?;
        let cause = Cause::RestAngle;
        if s.choice.spread.half_width[cause as usize] > 0.0 && !known.iter().any(|(c, _)| *c == cause) {
            known.push((cause, cause.deviation(&s.actuator, maps_rest_rad, rest)));
        }
        Ok(known)
    };
    let Some(dir) = &s.maps else {
        let request = MapRequest {
            actuator: s.actuator.clone(),
            sequence: sequence.clone(),
            rate_hz: m.rate_hz,
            sensors: sensors_of(path, m, s)?,
            rest_angle_rad: map_library::rounded_rest_angle(rest),
            equivalent_current,
            grid: s.grid.clone(),
        };
        return maps::cached(&request, &s.choice, &known(request.rest_angle_rad)?);
    };
    let file = if dir.is_dir() {
        dir.join("maps.parquet")
    } else {
        dir.clone()
    };
    let set = FailureMapSet::load(&file)?;
    let h = &set.header;
    let bad = |place: &str, found: String, allowed: String| -> anyhow::Error {
        Error::bad(
            path.display().to_string(),
            place,
            found,
            format!("{allowed} (of {})", file.display()),
        )
        .into()
    };
    if !m.parameters.is_empty() && m.parameters != h.parameters {
        return Err(bad("parameter fingerprint", m.parameters.clone(), h.parameters.clone()));
    }
    if s.actuator.fingerprint() != h.parameters {
        let place = format!("parameters of actuator `{}`", s.actuator.name);
        return Err(bad(&place, s.actuator.fingerprint(), h.parameters.clone()));
    }
    if sequence.fingerprint() != h.sequence_fingerprint {
        return Err(bad("sequence", sequence.name.clone(), h.sequence.clone()));
    }
    if (m.rate_hz - h.rate_hz).abs() > 1e-6 * h.rate_hz {
        return Err(bad("rate [Hz]", m.rate_hz.to_string(), h.rate_hz.to_string()));
    }
    let d = (rest - h.rest_angle_rad + std::f64::consts::PI).rem_euclid(std::f64::consts::TAU) - std::f64::consts::PI;
    if d.abs() > map_library::REST_ANGLE_TOLERANCE_RAD {
        let deg = |a: f64| format!("{:.2}", a.to_degrees());
        return Err(bad(
            "rotor angle at rest [deg]",
            deg(rest),
            format!("{} +- 0.1", deg(h.rest_angle_rad)),
        ));
    }
    if equivalent_current != h.equivalent_current {
        let what = |e: bool| {
            if e {
                "i_eq only".to_string()
            } else {
                "phase currents".to_string()
            }
        };
        return Err(bad("currents", what(equivalent_current), what(h.equivalent_current)));
    }
    let sensors = sensors_of(path, m, s)?.map_or("none".to_string(), |x| x.fingerprint());
    if sensors != h.sensors {
        return Err(bad("sensors", sensors, h.sensors.clone()));
    }
    let known = known(h.rest_angle_rad)?;
    Ok(s.choice.ready(&file, set, &known)?)
}

/// Diagnoses a telemetry file.
pub fn run(path: &Path, settings: &Settings) -> Result<Case> {
    let measured = input::open(path, settings.run)?;
    if measured.rate_hz < LOWEST_RATE_HZ * (1.0 - 1e-6) {
        let allowed = format!("a steady rate of at least {} Hz", LOWEST_RATE_HZ);
        return Err(Error::bad(path.display().to_string(), "rate [Hz]", measured.rate_hz, allowed).into());
    }
    let a = &settings.actuator;
    if settings.maps.is_none() && !measured.parameters.is_empty() && measured.parameters != a.fingerprint() {
        let allowed = format!("{} (actuator `{}`; choose with --actuator)", a.fingerprint(), a.name);
        let file = path.display().to_string();
        return Err(Error::bad(file, "parameter fingerprint", &measured.parameters, allowed).into());
    }
    let sequence = input::recognise(path, &measured, settings.sequence.as_deref(), a.step_s)?;
    // the rotor angle at rest is that of the first sample of the test, if it is there
    let begins = measured.telemetry.first == 1;
    let first = measured
        .telemetry
        .column(Channel::ThetaM)
        .filter(|_| begins)
        .map_or(0.0, |t| t[0]);
    let diagnoser = chosen_maps(
        path,
        &measured,
        settings,
        &sequence,
        first.rem_euclid(std::f64::consts::TAU),
    )?;
    let maps = &diagnoser.maps;
    let load = measured.load_n_m.unwrap_or(maps.header.load_n_m);
    if load != maps.header.load_n_m {
        let allowed = format!("{} (of the maps; --maps chooses others)", maps.header.load_n_m);
        return Err(Error::bad(path.display().to_string(), "load torque [N m]", load, allowed).into());
    }
    let plan = FeaturePlan::new(a, &sequence, measured.rate_hz, maps.header.equivalent_current);
    let x = extract(&measured, Arc::new(plan));
    let raw = x.features();
    let mut diagnosis = diagnoser.diagnose(&maps.features(&raw), &x.missing());
    if !begins {
        let n = measured.telemetry.first;
        let mut reason = format!("the recording starts at sample {n}: the rotor angle at rest is unknown");
        for m in x.missing() {
            reason += &format!("; {m}");
        }
        diagnosis.outcome = Outcome::Incomplete { reason, area: None };
        // nothing nominal is known at an unknown angle
        diagnosis.features = Features::over(&raw, &RawFeatures::default());
    }
    let header = &diagnoser.maps.header;
    let kind = TestKind {
        actuator: a.clone(),
        sensors: sensors_of(path, &measured, settings)?,
        rate_hz: measured.rate_hz,
        rest_angle_rad: header.rest_angle_rad,
        load_n_m: header.load_n_m,
        equivalent_current: header.equivalent_current,
        sequence,
    };
    Ok(Case {
        measured,
        raw,
        kind,
        diagnosis,
        diagnoser,
    })
}

/// What the intervals promise, and on what grounds.
fn coverage(case: &Case) -> String {
    let percent = 100.0 * case.diagnosis.coverage;
    match &case.diagnoser.calibration {
        Some(c) => {
            let of = if c.spread().is_none() {
                "of this very actuator (no spread from unit to unit)".to_string()
            } else {
                format!("of units of spread `{}`", c.spread)
            };
            format!(
                "coverage  {percent:.1} %, calibrated on {} simulated tests {of}",
                c.runs
            )
        }
        None => format!("coverage  {percent:.1} % by design, not calibrated (ema calibrate)"),
    }
}

/// The diagnosis for a person.
pub fn to_text(case: &Case) -> String {
    let d = &case.diagnosis;
    let mut out = String::new();
    let mut line = |s: String| {
        out += &s;
        out.push('\n');
    };
    match &d.outcome {
        Outcome::Located(a) | Outcome::Incomplete { area: Some(a), .. } => {
            line(format!("outcome   {}", d.outcome.name().replace('_', " ")));
            line(format!(
                "FSJ       {:.4}   in {:.4} .. {:.4}",
                a.centroid.0, a.fsj.lo, a.fsj.hi
            ));
            line(format!(
                "zeta      {:.5}  in {:.5} .. {:.5}",
                a.centroid.1, a.zeta.lo, a.zeta.hi
            ));
            if a.parts.len() > 1 {
                for (k, p) in a.parts.iter().enumerate() {
                    line(format!(
                        "area {:2}   FSJ {:.4} in {:.4} .. {:.4}, zeta {:.5} in {:.5} .. {:.5}",
                        k + 1,
                        p.centroid.0,
                        p.fsj.lo,
                        p.fsj.hi,
                        p.centroid.1,
                        p.zeta.lo,
                        p.zeta.hi
                    ));
                }
            }
            line(coverage(case));
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
    for f in Feature::ALL {
        if let (Some(v), Some(m)) = (d.features.get(f), case.diagnoser.maps.map(f)) {
            let (lo, hi) = m.range();
            let (f0, z0) = d.outcome.area().map_or((m.fsj[0], m.zeta[0]), |a| a.centroid);
            let h = band * case.diagnoser.uncertainty(f, f0, z0).unwrap_or(f64::NAN);
            line(format!(
                "{:11} {v:.6e} {:5} +- {h:.1e}   map {lo:.3e} .. {hi:.3e}",
                f.name(),
                f.unit()
            ));
        }
    }
    let h = &case.diagnoser.maps.header;
    let sensors = if h.sensors == "none" {
        "noise free"
    } else {
        "with sensor model (assumed)"
    };
    line(format!(
        "maps      actuator {}, {} at {} Hz, rest angle {:.1} deg, {sensors}",
        h.actuator,
        h.sequence,
        h.rate_hz,
        h.rest_angle_rad.to_degrees()
    ));
    for l in &h.left_out {
        out += &format!("left out  {l}\n");
    }
    out
}
