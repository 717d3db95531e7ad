//! Checks a dataset: every run once, counts, checksums, fingerprints, schema, value ranges; and says which
//! parts to make again.

use super::compacted::Compacted;
use super::layout::{ACTUATORS, MANIFEST, PLAN, features, staged};
use super::manifest::{File, Manifest};
use super::parts::Part;
use super::plan::{DatasetPlan, SOURCE};
use super::ranges::{FeatureRanges, telemetry_ranges};
use super::storage::Storage;
use super::tables::{Receipt, Staged, Table, actuators_file, features_schema, opened};
use super::work::{Made, plan_of};
use bytes::Bytes;
use parquet::file::statistics::Statistics;
use rayon::prelude::*;
use schemas::error::{Error, Result};
use schemas::fingerprint::checksum;
use std::collections::{BTreeMap, BTreeSet};

/// Something that is not as it should be.
#[derive(Clone, Debug, PartialEq)]
pub struct Finding {
    /// object that it is about
    pub path: String,
    /// what is wrong with it, in words
    pub what: String,
    /// parts that must be made again; none where the object is only in the way
    pub parts: Vec<usize>,
    /// the object is there and damaged: it must go before its parts can be made again
    pub damaged: bool,
}

/// What a check found.
#[derive(Clone, Debug, PartialEq)]
pub struct Report {
    /// what the dataset should be
    pub plan: FleetSummary,
    /// the manifest is there
    pub finished: bool,
    /// bytes that were read
    pub bytes: u64,
    /// files that were read
    pub files: usize,
    /// by object; empty where the dataset is as it should be
    pub findings: Vec<Finding>,
    /// worth knowing, no fault
    pub notes: Vec<String>,
}

/// Numbers of the plan that a dataset is of.
#[derive(Clone, Debug, PartialEq)]
pub struct FleetSummary {
    /// name of the plan
    pub name: String,
    /// actuators of the plan
    pub actuators: usize,
    /// runs of all actuators
    pub runs: u64,
    /// parts of the plan
    pub parts: usize,
}

impl FleetSummary {
    fn of(plan: &DatasetPlan) -> Self {
        Self {
            name: plan.name.clone(),
            actuators: plan.actuators.len(),
            runs: plan.runs(),
            parts: plan.parts().len(),
        }
    }
}

/// The first thing in which a manifest is not that of the plan.
fn wrong_in(m: &Manifest, plan: &DatasetPlan, fingerprint: &str) -> Option<String> {
    let parts = plan.parts();
    let actuators = plan.actuators.len() as u64;
    let mut wanted: BTreeMap<String, (u64, Option<u64>, Option<u64>)> = BTreeMap::new();
    wanted.insert(ACTUATORS.into(), (actuators, None, None));
    for p in &parts {
        let runs = p.runs.end - p.runs.start;
        let file = wanted
            .entry(features(plan.features_file(p.actuator)))
            .or_insert((0, Some(p.runs.start), Some(0)));
        *file = (file.0 + runs, file.1, file.2.map(|n| n + runs));
        if let (true, Some(t)) = (p.telemetry, &plan.telemetry) {
            let rows = plan.rows(p.sequence) / t.every * runs;
            wanted.insert(plan.telemetry_path(p), (rows, Some(p.runs.start), Some(runs)));
        }
    }
    let head = |name: &str, plan: &str, runs: u64, actuators: u64, parts: u64| {
        format!("{runs} runs of {actuators} actuators in {parts} parts of {name} by plan {plan}")
    };
    let found = head(&m.name, &m.plan, m.runs, m.actuators, m.parts);
    let planned = head(&plan.name, fingerprint, plan.runs(), actuators, parts.len() as u64);
    if found != planned {
        return Some(format!("{found}, planned {planned}"));
    }
    if fingerprint == plan.fingerprint() && m.source != SOURCE {
        return Some(format!("sources {}, planned {SOURCE}", m.source));
    }
    for f in &m.files {
        match wanted.remove(&f.path) {
            None => {
                return Some(format!(
                    "names {}, which the plan does not have, or names it twice",
                    f.path
                ));
            }
            Some(w) if w != (f.rows, f.first_run, f.runs) => {
                return Some(format!("{}: {} rows, planned {}, or other runs", f.path, f.rows, w.0));
            }
            Some(_) => {}
        }
    }
    wanted.keys().next().map(|path| format!("does not name {path}"))
}

impl Report {
    /// Parts to make again, each once.
    pub fn parts(&self) -> Vec<usize> {
        let all: BTreeSet<usize> = self.findings.iter().flat_map(|f| f.parts.iter().copied()).collect();
        all.into_iter().collect()
    }
}

struct Check<'a> {
    /// by part, of files of features that were put together before the manifest was lost
    merged: BTreeMap<usize, Receipt>,
    plan: &'a DatasetPlan,
    fingerprint: String,
    same_program: bool,
    storage: &'a Storage,
}

impl Check<'_> {
    /// What is wrong with a file of features. Each entry is a message.
    fn features(&self, path: &str, bytes: Bytes, parts: &[&Part]) -> Vec<String> {
        let mut wrong = Vec::new();
        let table = match Table::read(path, bytes.clone()) {
            Ok(t) => t,
            Err(e) => return vec![e.to_string()],
        };
        if table.pair("ema.plan") != self.fingerprint {
            wrong.push(format!("of plan {}, not {}", table.pair("ema.plan"), self.fingerprint));
        }
        let wanted = features_schema();
        let same = table.schema().is_some_and(|s| {
            let pairs = s.fields().iter().zip(wanted.fields());
            s.fields().len() == wanted.fields().len()
                && pairs
                    .into_iter()
                    .all(|(a, b)| a.name() == b.name() && a.data_type() == b.data_type())
        });
        if !same {
            wrong.push("columns other than those of schemas/README.md".into());
            return wrong;
        }
        if let Err(e) = self.rows(&table, parts, &mut wrong) {
            wrong.push(e.to_string());
        }
        if wrong.is_empty() {
            let read = Compacted::from_bytes(self.plan, path, bytes, parts, self.same_program);
            wrong.extend(read.err().map(|e| e.to_string()));
        }
        wrong
    }

    /// Every run of `parts` once, with its own actuator and faults, values within their ranges.
    fn rows(&self, table: &Table, parts: &[&Part], wrong: &mut Vec<String>) -> Result<()> {
        let runs = table.numbers("run")?;
        let (ids, kinds) = (table.texts("actuator")?, table.texts("kind")?);
        let (fsj, zeta, rest) = (
            table.values("fsj")?,
            table.values("zeta")?,
            table.values("rest_angle_rad")?,
        );
        let mut seen: BTreeMap<u64, usize> = BTreeMap::new();
        for (row, run) in runs.iter().enumerate() {
            if seen.insert(*run, row).is_some() {
                wrong.push(format!("run {run} twice"));
            }
        }
        let ranges = FeatureRanges::of(self.plan);
        let features = table.features()?;
        let mut missing = 0;
        for part in parts {
            let id = &self.plan.actuators[part.actuator].id;
            for run in part.runs.clone() {
                let Some(row) = seen.remove(&run) else {
                    missing += 1;
                    continue;
                };
                let fault = self.plan.fault(part, run);
                let angle = self.plan.rest_angles_rad[part.rest];
                let keys = (Some(fault.fsj), Some(fault.zeta), Some(angle));
                if ids[row] != *id || kinds[row] != part.kind.name() || (fsj[row], zeta[row], rest[row]) != keys {
                    wrong.push(format!(
                        "run {run}: {} {} FSJ {:?} zeta {:?}, planned {id} {} FSJ {} zeta {}",
                        ids[row],
                        kinds[row],
                        fsj[row],
                        zeta[row],
                        part.kind.name(),
                        fault.fsj,
                        fault.zeta
                    ));
                }
                if let Some(text) = ranges.wrong(part, &features[row]) {
                    wrong.push(format!("run {run}: {text}"));
                }
            }
        }
        if missing > 0 {
            wrong.push(format!("{missing} runs missing"));
        }
        if let Some(run) = seen.keys().next() {
            wrong.push(format!(
                "{} runs that the plan has elsewhere or not at all, the first {run}",
                seen.len()
            ));
        }
        Ok(())
    }

    /// What is wrong with a telemetry file, by its footer: a row group for each run, its samples, faults and
    /// time, and the least and greatest value of each channel.
    fn telemetry(&self, bytes: Bytes, part: &Part) -> Vec<String> {
        let size = bytes.len();
        let builder = match opened(bytes) {
            Ok(b) => b,
            Err(e) => return vec![format!("not a whole Parquet file of {size} bytes ({e})")],
        };
        let mut wrong = Vec::new();
        let meta = builder.metadata();
        let pairs = meta.file_metadata().key_value_metadata();
        let pair = |key: &str| {
            let found = pairs.into_iter().flatten().find(|kv| kv.key == key);
            found.and_then(|kv| kv.value.clone()).unwrap_or_default()
        };
        let actuator = &self.plan.actuators[part.actuator];
        for (key, wanted) in [
            ("ema.plan", self.fingerprint.clone()),
            ("ema.parameters", actuator.parameters.fingerprint()),
            ("ema.sensors", self.plan.sensor_fingerprint()),
        ] {
            if pair(key) != wanted {
                wrong.push(format!("`{key}` is `{}`, planned `{wanted}`", pair(key)));
            }
        }
        let Some(t) = &self.plan.telemetry else { return wrong };
        let rows = (self.plan.rows(part.sequence) / t.every) as i64;
        let runs = (part.runs.end - part.runs.start) as usize;
        if meta.num_row_groups() != runs {
            wrong.push(format!("{} row groups for {runs} runs", meta.num_row_groups()));
            return wrong;
        }
        let ranges = telemetry_ranges(self.plan, part);
        for (group, run) in meta.row_groups().iter().zip(part.runs.clone()) {
            if group.num_rows() != rows {
                wrong.push(format!("run {run}: {} samples, planned {rows}", group.num_rows()));
            }
            let fault = self.plan.fault(part, run);
            let ends_ns = (1e9 / t.rate_hz, rows as f64 / t.rate_hz * 1e9);
            let run_number = (run as f64, run as f64);
            let mut wanted = vec![
                ("run", run_number, 0.0),
                ("fsj", (fault.fsj, fault.fsj), 0.0),
                ("zeta", (fault.zeta, fault.zeta), 0.0),
                ("t_ns", ends_ns, 1.0),
            ];
            wanted.extend(ranges.iter().map(|(c, r)| (c.name(), *r, f64::INFINITY)));
            for (name, (low, high), exact_to) in wanted {
                let column = group.columns().iter().find(|c| c.column_path().string() == name);
                let Some((least, most)) = column.and_then(|c| c.statistics()).and_then(least_and_most) else {
                    wrong.push(format!("run {run}: no column `{name}` with statistics"));
                    continue;
                };
                let off = if exact_to.is_finite() {
                    (least - low).abs() > exact_to || (most - high).abs() > exact_to
                } else {
                    !(least >= low && most <= high)
                };
                if off {
                    wrong.push(format!(
                        "run {run}: `{name}` from {least} to {most}, allowed {low} to {high}"
                    ));
                }
            }
        }
        wrong
    }

    fn finding(&self, path: &str, wrong: Vec<String>, parts: Vec<usize>) -> Option<Finding> {
        let more = match wrong.len() {
            0 => return None,
            1 => String::new(),
            n => format!(" (and {} more)", n - 1),
        };
        Some(Finding {
            path: path.into(),
            what: format!("{}{more}", wrong[0]),
            parts,
            damaged: true,
        })
    }

    /// A file of the manifest.
    fn file(&self, entry: Option<&File>, path: &str, parts: &[&Part]) -> Result<(u64, Option<Finding>)> {
        let numbers: Vec<usize> = parts.iter().map(|p| p.number).collect();
        let Some(bytes) = self.storage.get(path)? else {
            let what = if path == ACTUATORS {
                "missing: ema dataset merge makes it again"
            } else {
                "missing"
            };
            let missing = Finding {
                path: path.into(),
                what: what.into(),
                parts: numbers,
                damaged: false,
            };
            return Ok((0, Some(missing)));
        };
        let size = bytes.len() as u64;
        let mut wrong = Vec::new();
        if entry.is_none() && path == ACTUATORS && self.fingerprint == self.plan.fingerprint() {
            let same = bytes == actuators_file(self.plan, path)?;
            wrong.extend((!same).then(|| "changed: not that of the plan".to_string()));
        }
        if let (None, Some(part)) = (entry, parts.first().filter(|_| path.starts_with("telemetry/"))) {
            let name = staged(part.number);
            let read = |b| Staged::from_bytes(&name, b, &self.fingerprint, part, self.same_program).ok();
            // damage of the staged file is found there
            let staged = self.storage.get(&name)?.and_then(read).and_then(|s| s.telemetry);
            let receipt = staged.or_else(|| self.merged.get(&part.number).cloned());
            if receipt.is_some_and(|r| (r.bytes, r.blake3) != (size, checksum(&bytes))) {
                wrong.push(format!(
                    "changed: {size} bytes, not those that the part was staged with"
                ));
            }
        }
        if let Some(e) = entry {
            if size != e.bytes {
                wrong.push(format!("torn: {size} bytes, the manifest says {}", e.bytes));
            } else if checksum(&bytes) != e.blake3 {
                wrong.push("changed: another checksum than in the manifest".into());
            }
        }
        match parts.first() {
            None => {}
            // what is in damaged bytes says nothing more
            Some(_) if !wrong.is_empty() => {}
            Some(part) if path.starts_with("telemetry/") => wrong.extend(self.telemetry(bytes, part)),
            Some(part) if path.starts_with("_staging/") => {
                let read = Staged::from_bytes(path, bytes, &self.fingerprint, part, self.same_program);
                wrong.extend(read.err().map(|e| e.to_string()));
            }
            Some(_) => wrong.extend(self.features(path, bytes, parts)),
        }
        Ok((size, self.finding(path, wrong, numbers)))
    }
}

/// Checks the dataset in `storage` against its own plan and manifest, reading all of it.
///
/// * `said` is told how many files are done, of how many
///
/// # Errors
/// No dataset; storage that refuses.
pub fn verify(storage: &Storage, said: impl Fn(usize, usize) + Sync) -> Result<Report> {
    let (plan, fingerprint) = plan_of(storage)?;
    let parts = plan.parts();
    let mut findings = Vec::new();
    let of_manifest = |what: String| Finding {
        path: MANIFEST.into(),
        what,
        parts: Vec::new(),
        damaged: true,
    };
    let manifest = match Manifest::read(storage) {
        Err(e @ Error::Torn { .. }) => {
            findings.push(of_manifest(e.to_string()));
            None
        }
        read => read?,
    };
    let mut notes = Vec::new();
    if fingerprint != plan.fingerprint() {
        if manifest.as_ref().is_some_and(|m| m.source == SOURCE) {
            // nothing can be checked by it
            let what = format!(
                "changed: it gives fingerprint {}, not the {fingerprint} of its first line",
                plan.fingerprint()
            );
            findings = vec![Finding {
                path: PLAN.into(),
                what,
                parts: Vec::new(),
                damaged: true,
            }];
            return Ok(Report {
                plan: FleetSummary::of(&plan),
                finished: true,
                bytes: 0,
                files: 0,
                findings,
                notes,
            });
        }
        notes.push("made by another version of the program: it is checked, but cannot be completed by this one".into());
    }
    let mut jobs: Vec<(Option<&File>, String, Vec<&Part>)> = Vec::new();
    let list = storage.list("")?;
    if let Some(m) = &manifest {
        let whole = m.source != SOURCE || storage.get(MANIFEST)?.is_some_and(|b| b == m.to_bytes());
        let wrong = wrong_in(m, &plan, &fingerprint);
        let other = (!whole).then(|| "changed: not as the merge writes it".to_string());
        findings.extend(wrong.or(other).map(of_manifest));
        let entry = |path: &str| m.files.iter().find(|f| f.path == path);
        jobs.push((entry(ACTUATORS), ACTUATORS.into(), Vec::new()));
        let mut by_file: BTreeMap<String, Vec<&Part>> = BTreeMap::new();
        for p in &parts {
            by_file
                .entry(features(plan.features_file(p.actuator)))
                .or_default()
                .push(p);
            if p.telemetry {
                by_file.insert(plan.telemetry_path(p), vec![p]);
            }
        }
        jobs.extend(by_file.into_iter().map(|(path, parts)| (entry(&path), path, parts)));
    } else {
        let made = Made::find(&plan, storage)?;
        for p in &parts {
            if made.has(&plan, p) {
                if made.staged(p) {
                    jobs.push((None, staged(p.number), vec![p]));
                }
                if p.telemetry {
                    jobs.push((None, plan.telemetry_path(p), vec![p]));
                }
            } else {
                findings.push(Finding {
                    path: format!("part {}", p.number),
                    what: format!("not made: {}", plan.describe_part(p)),
                    parts: vec![p.number],
                    damaged: false,
                });
            }
        }
        if list.iter().any(|(p, _)| p == ACTUATORS) {
            jobs.push((None, ACTUATORS.into(), Vec::new()));
        }
        for (path, _) in list.iter().filter(|(p, _)| p.starts_with("features/")) {
            let of = |p: &&Part| features(plan.features_file(p.actuator)) == *path;
            jobs.push((None, path.clone(), parts.iter().filter(of).collect()));
        }
    }
    let known: BTreeSet<&str> = jobs.iter().map(|j| j.1.as_str()).collect();
    let ours = ["plan.toml", MANIFEST, ACTUATORS];
    for (path, _) in &list {
        let made_later = ["maps/", "diagnoses/", "wear/"].iter().any(|p| path.starts_with(p));
        if known.contains(path.as_str()) || ours.contains(&path.as_str()) || made_later {
            continue;
        }
        if path.starts_with("_staging/") {
            if manifest.is_some() {
                notes.push(format!("{path}: left by a late worker; the next merge removes it"));
            }
            continue;
        }
        findings.push(Finding {
            path: path.clone(),
            what: "no file of this dataset".into(),
            parts: Vec::new(),
            damaged: path.starts_with("telemetry/") || path.starts_with("features/"),
        });
    }
    let total = jobs.len();
    let mut merged = BTreeMap::new();
    if manifest.is_none() {
        for (_, path, parts) in jobs.iter().filter(|j| j.1.starts_with("features/")) {
            let bytes = storage.get(path)?.unwrap_or_default();
            // damage of the file itself is found when it is checked
            if let Ok(Some(c)) = Compacted::from_bytes(&plan, path, bytes, parts, false) {
                let numbered = parts.iter().map(|p| p.number).zip(c.telemetry);
                merged.extend(numbered.filter_map(|(n, receipt)| Some((n, receipt?))));
            }
        }
    }
    let check = Check {
        merged,
        plan: &plan,
        same_program: fingerprint == plan.fingerprint(),
        fingerprint,
        storage,
    };
    let done = std::sync::atomic::AtomicUsize::new(0);
    let results: Vec<(u64, Option<Finding>)> = jobs
        .par_iter()
        .map(|(entry, path, parts)| {
            let result = check.file(*entry, path, parts);
            said(done.fetch_add(1, std::sync::atomic::Ordering::Relaxed) + 1, total);
            result
        })
        .collect::<Result<_>>()?;
    let bytes = results.iter().map(|r| r.0).sum();
    findings.extend(results.into_iter().filter_map(|r| r.1));
    Ok(Report {
        plan: FleetSummary::of(&plan),
        finished: manifest.is_some(),
        bytes,
        files: total,
        findings,
        notes,
    })
}

/// Removes what is damaged, and the manifest, so that the parts concerned can be made again.
///
/// # Errors
/// Storage that refuses.
pub fn discard(storage: &Storage, report: &Report) -> Result<()> {
    let damaged = report.findings.iter().filter(|f| f.damaged);
    let paths: BTreeSet<&str> = damaged.map(|f| f.path.as_str()).collect();
    if report
        .findings
        .iter()
        .any(|f| !f.parts.is_empty() || f.path == MANIFEST || f.path == ACTUATORS)
    {
        // first: from here on the dataset is not finished
        storage.delete(MANIFEST)?;
    }
    for path in paths.into_iter().filter(|p| *p != MANIFEST) {
        storage.delete(path)?;
    }
    // what was staged with damaged telemetry remembers its checksum, right or not
    let telemetry = |f: &&Finding| f.damaged && f.path.starts_with("telemetry/");
    for part in report.findings.iter().filter(telemetry).flat_map(|f| &f.parts) {
        storage.delete(&staged(*part))?;
    }
    Ok(())
}

fn least_and_most(s: &Statistics) -> Option<(f64, f64)> {
    match s {
        Statistics::Int32(v) => Some((f64::from(*v.min_opt()?), f64::from(*v.max_opt()?))),
        Statistics::Int64(v) => Some((*v.min_opt()? as f64, *v.max_opt()? as f64)),
        Statistics::Float(v) => Some((f64::from(*v.min_opt()?), f64::from(*v.max_opt()?))),
        Statistics::Double(v) => Some((*v.min_opt()?, *v.max_opt()?)),
        _ => None,
    }
}
