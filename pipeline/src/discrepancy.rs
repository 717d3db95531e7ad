//! A study from files to files.

use crate::case::{self, Case, Settings, quoted};
use crate::check::setup_of;
use crate::interruptible::interruptible;
use crate::report_pages::discrepancy as page;
use anyhow::Result;
use ema_study::measured::bench::{Bench, BenchChannel, is_recording};
use ema_study::measured::{check, recording};
use ema_study::search::beside::Beside;
use ema_study::search::select::Material;
use ema_study::search::study::Outcome;
use ema_study::search::verdict::Verdict;
use ema_study::told::compare;
use ema_study::told::findings::{Findings, FoundEffect};
use ema_study::told::{in_loop, loop_effects, next, persist, scale, sensors, source, tell, verify};
use schemas::error::{Error, write_whole};
use serde_json::Value;
use sim_worker::effect::{Effect, EffectKind, Note};
use sim_worker::parameters::ActuatorParameters;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Gap of the simulated motion over that without what was found, from which on it is no model of the actuator (assumed).
const FURTHER: f64 = 2.0;

/// Gap of the simulated speed over the noise of its sensor from which on the loop moves otherwise (assumed: with a torque that does
/// saturate it was 1.0, with a mass behind a spring in its place 3.8).
const SHAKEN: f64 = 2.0;

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
    let mut seen_by = None;
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
        let (mut as_read, of_study) = (bench.clone(), known.clone());
        let search =
            move |tell: &dyn Fn(&str)| ema_study::search::study::study(Material::new(bench, runs, &of_study), tell);
        let mut outcome = interruptible(tell_user, search)?;
        tell_user("intervals and report");
        let told = |outcome: &Outcome| {
            let mut f = tell::findings(outcome, &name);
            if telemetry && request.model.is_none() {
                let text = "no --actuator: the recordings are taken for the reference actuator's";
                f.assumptions.push(text.to_string());
            }
            f
        };
        findings = told(&outcome);
        let mut new = None;
        if let Some(actuator) = actuator.as_ref() {
            let model =
                |f: &Findings| with_what_was_found(f, actuator, (&name, &text), with_current, &bench_file, &hashes);
            let mut made = model(&findings);
            if telemetry || request.verify {
                let verified = |bench: &mut Bench, new: &schemas::error::Result<String>, verdict| -> Result<_> {
                    let child = match new {
                        Ok(text) if verdict != Verdict::None => ActuatorParameters::parse(&name, text)?,
                        _ => actuator.clone(),
                    };
                    let (mut placed, parent, of) = (bench.clone(), actuator.clone(), child.clone());
                    tell_user("the simulators under the recorded command");
                    let (placed, verified) = interruptible(tell_user, move |_| -> schemas::error::Result<_> {
                        verify::place_jumps(&mut placed, &of)?;
                        let verified = verify::verify(&placed, &parent, &of)?;
                        Ok((placed, verified))
                    })??;
                    *bench = placed;
                    Ok((child, verified))
                };
                // told, made and simulated anew
                let again = |bench: &mut Bench, outcome: &Outcome| -> Result<_> {
                    let findings = told(outcome);
                    let made = model(&findings);
                    let (child, verification) = verified(bench, &made, outcome.verdict)?;
                    Ok((findings, made, child, verification))
                };
                let (mut child, mut verification) = verified(&mut as_read, &made, outcome.verdict)?;
                if outcome.verdict != Verdict::None {
                    let (bench, of) = (as_read.clone(), child.clone());
                    outcome.by_loop =
                        interruptible(tell_user, move |_| scale::by_loop(&bench, &of))??.unwrap_or_default();
                }
                if !outcome.by_loop.is_empty() {
                    (findings, made, child, verification) = again(&mut as_read, &outcome)?;
                }
                let (bench, of) = (as_read.clone(), child.clone());
                outcome.source = interruptible(tell_user, move |_| source::by_loop(&bench, &of))??;
                if outcome.source.is_some() {
                    (findings, made, child, verification) = again(&mut as_read, &outcome)?;
                }
                let late = late_control(&as_read, child.clone(), &verification, &outcome, tell_user)?;
                let found = match late {
                    Some(late) => Some(late),
                    None => of_loop(&as_read, child, &outcome, tell_user)?,
                };
                if let Some(found) = found {
                    if outcome.verdict == Verdict::Unknown {
                        outcome.verdict = Verdict::Retune;
                    }
                    outcome.verdict = outcome.verdict.beside(std::slice::from_ref(&found));
                    outcome.beside.push(found);
                    (findings, made, _, verification) = again(&mut as_read, &outcome)?;
                }
                // what strong currents say of their torque, they say of a mass behind a spring too: the loop moves as was measured, or
                // it is something else
                if is_shaken(&verification, &outcome)
                    && let Some(at) = outcome
                        .beside
                        .iter()
                        .position(|b| b.kind == EffectKind::TorqueSaturation)
                {
                    outcome.beside.remove(at);
                    outcome.verdict = Verdict::Unknown;
                    (findings, made, _, verification) = again(&mut as_read, &outcome)?;
                    let text = "strong currents give less torque than their flux makes, but the simulated loop with a torque that \
                                saturates moves otherwise than was measured: something that springs or comes loose, say";
                    findings.assumptions.push(text.to_string());
                }
                // what is to be missing brings the simulated actuator nearer to what was measured, or it is not that
                let away = further_away(&verification);
                if let Some(text) = away.filter(|_| outcome.verdict != Verdict::None) {
                    outcome.verdict = Verdict::Unknown;
                    findings = told(&outcome);
                    findings.assumptions.push(text);
                }
                let driven = verification
                    .channels
                    .iter()
                    .any(|c| c.channel == BenchChannel::Velocity.name());
                if driven {
                    // the simulated loop shows it
                    findings
                        .not_excited
                        .retain(|(n, _)| n != EffectKind::ControlDelay.name());
                }
                let named: Vec<String> = findings.effects.iter().map(|e| e.name.clone()).collect();
                findings.not_excited.retain(|(n, _)| !named.contains(n));
                findings.verification = Some(verification);
                if out.is_some() {
                    let of_angle = outcome.material.bench.made_of_angle.is_some();
                    let child = match &made {
                        Ok(text) if outcome.verdict != Verdict::None => ActuatorParameters::parse(&name, text)?,
                        _ => actuator.clone(),
                    };
                    let bench = as_read.clone();
                    seen_by = interruptible(tell_user, move |_| sensors::seen(&bench, &child, of_angle))??;
                }
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
            let path = dir.join(crate::unit::SENSORS);
            match &seen_by {
                Some(s) => write_whole(&path, format!("{SEEN_BY}{}", s.to_toml()).as_bytes())?,
                // of an earlier study
                None if path.exists() => {
                    std::fs::remove_file(&path).map_err(|e| Error::io(&path, "cannot be removed", e))?;
                }
                None => {}
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

/// In words, where the test bench with what was found goes further away from the held-out recordings than it did without.
fn further_away(v: &verify::Verification) -> Option<String> {
    let motion = [BenchChannel::Velocity, BenchChannel::Current].map(BenchChannel::name);
    let worst = v
        .channels
        .iter()
        .filter(|c| v.heldout && motion.contains(&c.channel.as_str()) && c.child > FURTHER * c.parent)
        .max_by(|a, b| (a.child / a.parent).total_cmp(&(b.child / b.parent)))?;
    Some(format!(
        "the test bench with what was found goes further away from the held-out recordings than without: {} off by {:.3e} {}, {:.3e} before",
        worst.channel, worst.child, worst.unit, worst.parent
    ))
}

/// Whether the simulated loop with what was found moves otherwise than was measured, by the speed's own sensor.
fn is_shaken(v: &verify::Verification, outcome: &Outcome) -> bool {
    let noise = outcome
        .material
        .noise
        .get(&BenchChannel::Velocity)
        .map_or(0.0, |n| n.rms);
    let speed = v.channels.iter().find(|c| c.channel == BenchChannel::Velocity.name());
    noise > 0.0 && speed.is_some_and(|c| c.child > SHAKEN * noise)
}

/// Whether the simulated loop shows the controller's output to be late; nothing where effects are left that have no name.
///
/// # Errors
/// Recordings that cannot be read; where it was interrupted.
fn late_control(
    bench: &Bench,
    child: ActuatorParameters,
    verification: &verify::Verification,
    outcome: &Outcome,
    tell_user: &dyn Fn(&str),
) -> Result<Option<Beside>> {
    if !matches!(outcome.verdict, Verdict::None | Verdict::Retune | Verdict::Named) {
        return Ok(None);
    }
    let noise = outcome
        .material
        .noise
        .get(&BenchChannel::Velocity)
        .map_or(0.0, |n| n.rms);
    let (bench, verification) = (bench.clone(), verification.clone());
    let look = move |_: &dyn Fn(&str)| in_loop::late_control(&bench, &child, &verification, noise);
    Ok(interruptible(tell_user, look)??)
}

/// What only the simulated loop shows to be missing, where the equations show nothing.
///
/// # Errors
/// Recordings that cannot be read; where it was interrupted.
fn of_loop(
    bench: &Bench,
    child: ActuatorParameters,
    outcome: &Outcome,
    tell_user: &dyn Fn(&str),
) -> Result<Option<Beside>> {
    let nothing_named = outcome.model.terms.is_empty() && outcome.beside.is_empty();
    if !matches!(outcome.verdict, Verdict::None | Verdict::Retune | Verdict::Unknown) || !nothing_named {
        return Ok(None);
    }
    let bench = bench.clone();
    let look = move |_: &dyn Fn(&str)| loop_effects::scan(&bench, &child);
    let found = interruptible(tell_user, look)??;
    // where the equations see something that they have no name for, it is that effect if the loop then moves as it was measured
    let is_all = |f: &loop_effects::OfMotion| f.settles || outcome.verdict != Verdict::Unknown;
    Ok(found.filter(is_all).map(|f| f.beside))
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn prop_only_a_motion_twice_as_far_away_in_held_out_data_stands_against_what_was_found() {
        let of = |channel: BenchChannel, parent: f64, child: f64, heldout: bool| {
            let other = verify::VerifiedChannel {
                channel: BenchChannel::Position.name().into(),
                unit: "rad".into(),
                samples: 1,
                parent: 1.0,
                child: 100.0,
                simplified: None,
            };
            let one = verify::VerifiedChannel {
                channel: channel.name().into(),
                unit: "rad/s".into(),
                parent,
                child,
                ..other.clone()
            };
            further_away(&verify::Verification {
                heldout,
                channels: vec![other, one],
                ..Default::default()
            })
        };
        let said = of(BenchChannel::Velocity, 2.5, 190.0, true).expect("it runs away");
        assert!(
            said.contains("velocity") && said.contains("1.900e2") && said.contains("2.500e0"),
            "{said}"
        );
        assert!(of(BenchChannel::Current, 0.5, 14.0, true).is_some());
        assert_eq!(of(BenchChannel::Velocity, 0.2, 0.39, true), None);
        assert_eq!(of(BenchChannel::Velocity, 2.5, 0.2, true), None);
        assert_eq!(of(BenchChannel::Velocity, 2.5, 190.0, false), None);
    }
}
