//! A study from files to files.

use super::bench::Bench;
use super::findings::{Findings, FoundEffect};
use super::select::Material;
use super::study::{self, Verdict};
use super::{check, compare, html, next, persist, recording, tell};
use anyhow::Result;
use schemas::error::{Error, write_whole};
use sim_worker::effect::{Effect, Note};
use sim_worker::parameters::ActuatorParameters;
use std::path::{Path, PathBuf};

/// Stands for the reference actuator in place of a file.
pub const REFERENCE: &str = "reference";

/// What a study has written, and what it found.
pub struct Written {
    /// as in `report.json`
    pub findings: Findings,
    /// the actuator's file with what was found, where something was
    pub model: Option<PathBuf>,
    /// the page `report.html`
    pub report: Option<PathBuf>,
}

/// Studies the runs of a bench against an actuator's file.
///
/// # Errors
/// Refuses files that cannot be read and measurements that no study can be made of, with file, place and what
/// is allowed.
pub fn study_file(model: &Path, bench: &Path, tell: &dyn Fn(&str)) -> Result<Findings> {
    Ok(studied(model, bench, None, tell)?.findings)
}

/// As [`study_file`]; writes `report.json`, `report.html`, and where something was found
/// `actuator.toml`, into `out`.
///
/// # Errors
/// As [`study_file`]; fails where `out` cannot be written.
pub fn study_into(model: &Path, bench: &Path, out: &Path, tell: &dyn Fn(&str)) -> Result<Written> {
    studied(model, bench, Some(out), tell)
}

fn studied(model: &Path, bench_file: &Path, out: Option<&Path>, tell_user: &dyn Fn(&str)) -> Result<Written> {
    tell_user("reading");
    let text = if model == Path::new(REFERENCE) {
        ActuatorParameters::reference_text().to_string()
    } else {
        std::fs::read_to_string(model).map_err(|e| Error::io(model, "cannot be read", e))?
    };
    let name = model.display().to_string();
    let actuator = ActuatorParameters::parse(&name, &text)?;
    let bench = Bench::open(bench_file, &actuator)?;
    let runs = recording::read_runs(&bench)?;
    if let Some(dir) = out {
        // say now, not after the study, that the folder cannot be written
        std::fs::create_dir_all(dir).map_err(|e| Error::io(dir, "cannot be made", e))?;
    }
    let mut findings;
    let mut new_text = None;
    if bench.is_comparison() {
        findings = compare::compare(&bench, &runs);
        findings.model = name.clone();
    } else {
        check::check(&bench, &runs)?;
        let hashes: Vec<String> = {
            let mut all: Vec<String> = runs.iter().map(|r| r.hash.clone()).collect();
            all.dedup();
            all
        };
        let with_current = bench.rig.drive == super::bench::BenchChannel::Current;
        let outcome = study::study(Material::new(bench, runs, &actuator.effects), tell_user);
        tell_user("intervals and report");
        findings = tell::findings(&outcome, &name);
        if !matches!(outcome.verdict, Verdict::None | Verdict::Unknown) {
            let source = format!("{}, data {}", bench_file.display(), hashes.join(" ")).replace('"', "'");
            let source = source.chars().take(200).collect::<String>();
            let parent = actuator.fingerprint();
            let effects: Vec<Effect> = findings
                .effects
                .iter()
                .filter_map(|e| persist::effect(e, &parent, &source, notes(e, &findings, &hashes)))
                .collect();
            let constants = persist::replaced(&findings.retuned, &actuator, with_current);
            // an actuator may not take all of a rig: a load heavier than its rotor, a delay beside another
            match persist::written(&name, &text, &constants, &effects, &source) {
                Ok(new) => {
                    findings.diff = persist::diff(&text, &new);
                    new_text = Some(new);
                }
                Err(e) => findings.assumptions.push(format!("not written into the model: {e}")),
            }
        }
    }
    let written_model = out.zip(new_text.as_ref()).map(|(dir, _)| dir.join("actuator.toml"));
    let sequence = next::next(&mut findings, out, written_model.as_deref(), bench_file);
    let mut report = None;
    if let Some(dir) = out {
        if let (Some(path), Some(text)) = (&written_model, &new_text) {
            write_whole(path, text.as_bytes())?;
        }
        if let Some((path, text)) = sequence {
            write_whole(&path, text.as_bytes())?;
        }
        let json = serde_json::to_string_pretty(&findings.to_json())?;
        write_whole(&dir.join("report.json"), format!("{json}\n").as_bytes())?;
        report = Some(html::write(&findings, dir)?);
    }
    Ok(Written {
        findings,
        model: written_model,
        report,
    })
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
    if let Some(g) = f.gap.as_ref().map(|g| g.heldout.unwrap_or(g.fit)) {
        notes.push(("heldout_before".to_string(), Note::Number(g.retuned)));
        notes.push(("heldout_after".to_string(), Note::Number(g.last)));
        notes.push(("floor".to_string(), Note::Number(g.floor)));
    }
    notes.retain(|(_, n)| !matches!(n, Note::Number(x) if !x.is_finite()));
    notes
}
