//! A study from files to files.

mod judge;

use crate::case::{self, Case, Settings, quoted};
use crate::check::setup_of;
use crate::interruptible::interruptible;
use crate::report_pages::discrepancy as page;
use anyhow::Result;
use ema_study::measured::bench::{Bench, BenchChannel, is_recording};
use ema_study::measured::{check, recording};
use ema_study::search::select::Material;
use ema_study::search::study::Outcome;
use ema_study::search::verdict::Verdict;
use ema_study::told::compare;
use ema_study::told::findings::{Findings, FoundEffect};
use ema_study::told::{next, persist, sensors, tell, verify};
use judge::Judge;
use schemas::error::{Error, write_whole};
use serde_json::Value;
use sim_worker::effect::{Effect, Note};
use sim_worker::parameters::ActuatorParameters;
use sim_worker::sensor::SensorModel;
use std::path::{Path, PathBuf};
use std::sync::Arc;

pub use ema_study::REFERENCE;

/// What stands above the sensors that a study saw.
const SEEN_BY: &str = "# Sensors as a study saw them in its recordings: of pre-flight tests of the same unit too, where they do not say theirs.\n";

/// What a study has written, and what it found.
pub struct Written {
    /// as in `report.json`
    pub findings: Findings,
    /// the actuator's file with what was found, where something was
    pub model: Option<PathBuf>,
    /// file of the rig with what was found, where something was and no actuator was given
    pub rig: Option<PathBuf>,
    /// the page `report.html`
    pub report: Option<PathBuf>,
}

/// What is studied.
#[derive(Clone, Debug, Default)]
pub struct Request {
    /// the actuator's file, or [`REFERENCE`]; without one, a bench file speaks for itself, and recordings of our own
    /// telemetry are taken for the reference actuator's
    pub model: Option<PathBuf>,
    /// one bench file, or recordings of telemetry
    pub bench: Vec<PathBuf>,
    /// all that is recorded is of a healthy machine
    pub healthy: bool,
    /// run the simulators under the recorded command of a bench file too; recordings of telemetry always are
    pub verify: bool,
    /// file whose section `[channels]` says which column of the recordings is what
    pub channels: Option<PathBuf>,
}

impl Request {
    /// A bench file or a recording, against an actuator's file or [`REFERENCE`].
    pub fn of(model: &Path, bench: &Path) -> Self {
        Self {
            model: Some(model.to_path_buf()),
            bench: vec![bench.to_path_buf()],
            ..Self::default()
        }
    }

    /// As a shell takes it, but for the folder.
    ///
    /// * `model` the actuator that was studied; empty where there was none
    fn command(&self, model: &str) -> String {
        let mut out = "ema discrepancy".to_string();
        if !model.is_empty() {
            out += &format!(" --actuator {}", quoted(Path::new(model)));
        }
        let bench: Vec<String> = self.bench.iter().map(|b| quoted(b)).collect();
        out += &format!(" --bench {}", bench.join(" "));
        if let Some(channels) = &self.channels {
            out += &format!(" --channels {}", quoted(channels));
        }
        for (is_set, word) in [(self.healthy, " --healthy"), (self.verify, " --verify")] {
            out += if is_set { word } else { "" };
        }
        out
    }
}

/// Studies the runs of a bench against an actuator's file.
///
/// # Errors
/// Refuses files that cannot be read and measurements that no study can be made of, with file, place and what
/// is allowed.
pub fn study_file(request: &Request, tell: &dyn Fn(&str)) -> Result<Findings> {
    Ok(study(request, None, tell)?.findings)
}

/// As [`study_file`]; writes `report.json`, `report.html`, and where something was found on healthy machines and
/// proven `actuator.toml`, or without an actuator `model.toml`, into `out`.
///
/// # Errors
/// As [`study_file`]; fails where `out` cannot be written.
pub fn study_into(request: &Request, out: &Path, tell: &dyn Fn(&str)) -> Result<Written> {
    study(request, Some(out), tell)
}

/// As [`study_into`], or with nothing written as [`study_file`].
///
/// # Errors
/// As [`study_into`].
pub fn study(request: &Request, out: Option<&Path>, tell_user: &dyn Fn(&str)) -> Result<Written> {
    tell_user("reading");
    let telemetry = request.bench.iter().all(|b| is_recording(b));
    let model = match &request.model {
        None if telemetry => Some(PathBuf::from(REFERENCE)),
        m => m.clone(),
    };
    if request.verify && model.is_none() {
        let allowed = "--actuator: the actuator whose simulator is to run the recorded command";
        return Err(Error::bad("command line", "--verify", "no --actuator", allowed).into());
    }
    let read = |model: &PathBuf| -> Result<(String, String)> {
        let text = if model == Path::new(REFERENCE) {
            ActuatorParameters::reference_text().to_string()
        } else {
            std::fs::read_to_string(model).map_err(|e| Error::io(model, "cannot be read", e))?
        };
        Ok((model.display().to_string(), text))
    };
    let (name, text) = model.as_ref().map(read).transpose()?.unwrap_or_default();
    let actuator = model
        .as_ref()
        .map(|_| ActuatorParameters::parse(&name, &text))
        .transpose()?;
    let bench = Bench::open(
        &request.bench,
        actuator.as_ref(),
        request.channels.as_deref(),
        request.healthy,
    )?;
    let names: Vec<String> = request.bench.iter().map(|b| b.display().to_string()).collect();
    let bench_file = names.join(" ");
    // of a recording that was cut into pieces by us, one may stand still
    let (moving, still): (Vec<_>, Vec<_>) = recording::read_runs(&bench)?
        .into_iter()
        .partition(|r| !bench.own || check::moves(&bench, r));
    let runs = if moving.is_empty() { still } else { moving };
    if let Some(dir) = out {
        // say now, not after the study, that the folder cannot be written
        std::fs::create_dir_all(dir).map_err(|e| Error::io(dir, "cannot be made", e))?;
    }
    let mut findings;
    let mut new_text = None;
    let mut rig_text = None;
    let mut against = None;
    let mut placed = None;
    if bench.is_comparison() {
        findings = compare::compare(&bench, &runs);
        findings.model = name.clone();
        findings.verification = request.verify.then(|| verify::Verification {
            left_out: vec!["states are compared by an unsigned current: there is no model to simulate".into()],
            ..Default::default()
        });
    } else {
        check::check(&bench, &runs)?;
        let hashes: Vec<String> = {
            let mut all: Vec<String> = runs.iter().map(|r| r.hash.clone()).collect();
            all.dedup();
            all
        };
        let with_current = bench.rig.drive == BenchChannel::Current;
        let known = actuator
            .as_ref()
            .map_or_else(|| bench.effects.clone(), |a| a.effects.clone());
        let (as_read, of_study) = (bench.clone(), known.clone());
        let search =
            move |tell: &dyn Fn(&str)| ema_study::search::study::study(Material::new(bench, runs, &of_study), tell);
        let mut outcome = interruptible(tell_user, search)?;
        tell_user("intervals and report");
        let is_assumed = telemetry && request.model.is_none();
        findings = told(&outcome, &name, is_assumed);
        let mut new = None;
        if let Some(actuator) = actuator.as_ref() {
            let model =
                |f: &Findings| with_what_was_found(f, actuator, (&name, &text), with_current, &bench_file, &hashes);
            let mut made = model(&findings);
            if telemetry || request.verify {
                let judge = Judge {
                    actuator,
                    told: &|outcome| told(outcome, &name, is_assumed),
                    made: &model,
                    tell_user,
                };
                let judged = judge.judged(as_read.clone(), &mut outcome, findings, made)?;
                (findings, made) = (judged.findings, judged.made);
                placed = Some(judged.bench);
            }
            new = Some(made);
        }
        // only what is proven on machines that somebody calls healthy may change what healthy means
        let proven = outcome.material.held.is_some() && findings.health == "healthy";
        let settled = !matches!(outcome.verdict, Verdict::None | Verdict::Unknown | Verdict::Candidate);
        if outcome.material.held.is_none() {
            against = Some("a run with the role heldout, or another recording, is to prove it".to_string());
        }
        if actuator.is_none() && proven && settled {
            let source = source_of(&bench_file, &hashes);
            let found = effects(&findings, None, &source, &hashes);
            let all: Vec<Effect> = known.iter().cloned().chain(found).collect();
            rig_text = Some(persist::rig(&as_read, &findings.retuned, &all, &source));
        }
        if let Some(new) = new {
            match new {
                Ok(new) if proven && settled => {
                    findings.diff = persist::diff(&text, &new);
                    if out.is_some() {
                        tell_user("whether it can be diagnosed");
                        against = stands_against(ActuatorParameters::parse(&name, &new)?)?;
                    }
                    new_text = Some(new);
                }
                // an actuator may not take all of a rig: a load heavier than its rotor, a delay beside another
                Err(e) if proven && settled => {
                    findings.assumptions.push(format!("not written into the model: {e}"));
                    against = Some(e.to_string());
                }
                _ => {}
            }
        }
    }
    let written_model = out.zip(new_text.as_ref()).map(|(dir, _)| dir.join("actuator.toml"));
    let seen_by = match (&written_model, &new_text, placed) {
        (Some(_), Some(text), Some(bench)) => {
            let child = ActuatorParameters::parse(&name, text)?;
            Some(interruptible(tell_user, move |_| sensors::seen(&bench, &child))??)
        }
        _ => None,
    };
    let written_rig = out.zip(rig_text.as_ref()).map(|(dir, _)| dir.join("model.toml"));
    let around = next::Around {
        command: &request.command(&name),
        out,
        model: written_model.as_deref(),
        rig: written_rig.as_deref(),
        against: against.as_deref(),
    };
    let sequence = next::next(&mut findings, &around);
    let mut report = None;
    if let Some(dir) = out {
        if let (Some(path), Some(text)) = (&written_model, &new_text) {
            write_whole(path, text.as_bytes())?;
            if let Some(seen) = seen_by {
                write_sensors(&dir.join(crate::unit::SENSORS), seen)?;
            }
        }
        if let (Some(path), Some(text)) = (&written_rig, &rig_text) {
            write_whole(path, text.as_bytes())?;
        }
        if let Some((path, text)) = sequence {
            write_whole(&path, text.as_bytes())?;
        }
        let json = serde_json::to_string_pretty(&diagnoser::report::versioned(findings.to_json()))?;
        write_whole(&dir.join("report.json"), format!("{json}\n").as_bytes())?;
        report = Some(page::write(&findings, dir)?);
    }
    Ok(Written {
        findings,
        model: written_model,
        rig: written_rig,
        report,
    })
}

/// What is said of an outcome.
///
/// * `is_assumed` nobody said which actuator it is
fn told(outcome: &Outcome, model: &str, is_assumed: bool) -> Findings {
    let mut f = tell::findings(outcome, model);
    if is_assumed {
        let text = "no --actuator: the recordings are taken for the reference actuator's";
        f.assumptions.push(text.to_string());
    }
    f
}

/// Writes the sensors that recordings are by; where they are the reference's, those of an earlier study go.
fn write_sensors(path: &Path, seen: Option<SensorModel>) -> schemas::error::Result<()> {
    match seen {
        Some(s) => write_whole(path, format!("{SEEN_BY}{}", s.to_toml()).as_bytes()),
        None if path.exists() => std::fs::remove_file(path).map_err(|e| Error::io(path, "cannot be removed", e)),
        None => Ok(()),
    }
}

/// The actuator's file with the constants and effects that were found.
///
/// * `file` name and text of the actuator's file
fn with_what_was_found(
    f: &Findings,
    actuator: &ActuatorParameters,
    file: (&str, &str),
    with_current: bool,
    bench_file: &str,
    hashes: &[String],
) -> schemas::error::Result<String> {
    let source = source_of(bench_file, hashes);
    let effects = effects(f, Some(&actuator.fingerprint()), &source, hashes);
    let constants = persist::replaced(&f.retuned, actuator, with_current);
    persist::written(file.0, file.1, &constants, &f.correlation, &effects, &source)
}

/// Where values come from, in words.
fn source_of(bench_file: &str, hashes: &[String]) -> String {
    let source = format!("{bench_file}, data {}", hashes.join(" ")).replace('"', "'");
    source.chars().take(200).collect()
}

/// What was found, as a file has it.
///
/// * `parent` fingerprint of the actuator that it is added to, if it is one
fn effects(f: &Findings, parent: Option<&str>, source: &str, hashes: &[String]) -> Vec<Effect> {
    let one = |e: &FoundEffect| persist::effect(e, parent, source, notes(e, f, hashes));
    f.effects.iter().filter_map(one).collect()
}

/// What stands against a diagnosis of an actuator by the pre-flight test, as `ema check` says; nothing if `None`.
///
/// # Errors
/// Where it was interrupted.
fn stands_against(actuator: ActuatorParameters) -> Result<Option<String>> {
    let setup = setup_of(Arc::new(actuator), sim_worker::catalogue::sequence("preflight")?);
    let sensors = sim_worker::catalogue::sensors("reference")?;
    match crate::check::check(&setup, sensors, &sim_worker::catalogue::grid("coarse")?) {
        Ok(checked) => Ok(checked.findings.into_iter().find(|f| !f.ok).map(|f| f.found)),
        Err(e) if e.is::<crate::Interrupted>() => Err(e),
        Err(e) => Ok(Some(format!("{e:#}"))),
    }
}

/// The last stretch of the circle: a recorded test against maps of the model that was written, or of the actuator as it
/// was where none was. `Ok(None)` where the study had no actuator.
///
/// # Errors
/// As [`case::run`].
pub fn diagnose(written: &Written, test: &Path) -> Result<Option<Case>> {
    let actuator = match &written.model {
        Some(model) => ActuatorParameters::read(model)?,
        None if written.findings.model.is_empty() => return Ok(None),
        None if written.findings.model == REFERENCE => ActuatorParameters::reference(),
        None => ActuatorParameters::read(Path::new(&written.findings.model))?,
    };
    Ok(Some(case::run(test, &Settings::of_actuator(actuator.into())?)?))
}

/// The keys of `ema discrepancy --json`.
///
/// * `cases` recordings that were then diagnosed; no key where none were to be
pub fn to_json(findings: &Findings, cases: Option<&[(&Path, Case)]>) -> Value {
    let mut json = findings.to_json();
    if let Some(cases) = cases {
        let all = cases.iter().map(|(test, c)| {
            let mut d = diagnoser::report::to_json(&c.diagnosis);
            d["recording"] = test.display().to_string().into();
            d
        });
        json["diagnoses"] = all.collect();
    }
    json
}

/// How an effect was identified, for its provenance.
fn notes(e: &FoundEffect, f: &Findings, hashes: &[String]) -> Vec<(String, Note)> {
    let mut notes = vec![
        ("data".to_string(), Note::Text(hashes.join(" "))),
        ("explained_share".to_string(), Note::Number(e.explained_share)),
        (
            "runner_up".to_string(),
            Note::Text(e.runner_up.clone().unwrap_or_default()),
        ),
    ];
    let score = f.leaders.iter().find(|l| l.name == e.name).map(|l| l.gain);
    notes.extend(score.map(|s| ("score".to_string(), Note::Number(s))));
    // what was found beside the equations has a gap of its own
    let beside = f.by_channel.iter().all(|c| c.channel != e.channel);
    if let Some((before, after)) = e.heldout.filter(|_| beside) {
        notes.push(("heldout_before".to_string(), Note::Number(before)));
        notes.push(("heldout_after".to_string(), Note::Number(after)));
    } else if let Some(g) = f.gap.as_ref().map(|g| g.heldout.unwrap_or(g.fit)) {
        notes.push(("heldout_before".to_string(), Note::Number(g.retuned)));
        notes.push(("heldout_after".to_string(), Note::Number(g.last)));
        notes.push(("floor".to_string(), Note::Number(g.floor)));
    }
    notes.retain(|(_, n)| !matches!(n, Note::Number(x) if !x.is_finite()));
    notes
}
