//! Puts the parts of all shards together: compacts their features, and commits the manifest last. Started
//! twice, killed or late, it comes to the same dataset.

use super::compacted::Compacted;
use super::layout::{ACTUATORS, MANIFEST, features, staged};
use super::manifest::{File, Manifest};
use super::parts::Part;
use super::plan::{DatasetPlan, SOURCE};
use super::storage::Storage;
use super::tables::{Receipt, Staged, Table, actuators_file};
use super::work::{Made, enter};
use rayon::prelude::*;
use schemas::SCHEMA_VERSION;
use schemas::error::{Error, Result};
use schemas::fingerprint::checksum;
use std::collections::BTreeMap;
use std::path::Path;

/// How a merge ended.
#[derive(Clone, Debug, PartialEq)]
pub enum Merged {
    /// the dataset is finished, now or before; its manifest
    Whole(Manifest),
    /// these parts are missing; nothing was changed
    Missing(Vec<usize>),
}

/// Prefix of everything before the merge.
const STAGING: &str = "_staging";

fn receipt_of(storage: &Storage, path: &str) -> Result<Receipt> {
    let bytes = storage.get(path)?;
    let bytes = bytes.ok_or_else(|| Error::torn(Path::new(path), "vanished while the parts were put together"))?;
    Ok(Receipt {
        bytes: bytes.len() as u64,
        blake3: checksum(&bytes),
        rows: Table::rows_of(path, bytes)?,
    })
}

fn of_table(path: &str, receipt: Receipt, runs: Option<std::ops::Range<u64>>) -> File {
    File {
        path: path.into(),
        bytes: receipt.bytes,
        blake3: receipt.blake3,
        rows: receipt.rows,
        first_run: runs.as_ref().map(|r| r.start),
        runs: runs.map(|r| r.end - r.start),
    }
}

/// One file of features, and the entries of it and of the telemetry of its parts.
fn compact(
    plan: &DatasetPlan,
    fingerprint: &str,
    storage: &Storage,
    number: usize,
    parts: &[Part],
    there: bool,
) -> Result<Vec<File>> {
    let path = features(number);
    let read = |part: &Part| -> Result<Staged> {
        let name = staged(part.number);
        let bytes = storage.get(&name)?;
        let bytes = bytes.ok_or_else(|| Error::torn(Path::new(&name), "vanished while the parts were put together"))?;
        Staged::from_bytes(&name, bytes, fingerprint, part, true)
    };
    let numbered: Vec<&Part> = parts.iter().collect();
    let receipts: Vec<Option<Receipt>> = if !there {
        let list: Vec<Staged> = parts.par_iter().map(read).collect::<Result<_>>()?;
        let (rows, telemetry) = list.into_iter().map(|s| (s.rows, s.telemetry)).unzip();
        let compacted = Compacted { rows, telemetry };
        storage.put_new(&path, compacted.to_bytes(plan, &numbered)?)?;
        compacted.telemetry
    } else {
        let bytes = storage.get(&path)?.unwrap_or_default();
        let of = Table::pair_of(&path, bytes.clone(), "ema.plan")?.unwrap_or_else(|| "nothing".into());
        if of != fingerprint {
            let file = format!("{}/{path}", storage.describe());
            let allowed = format!("{fingerprint}; ema dataset verify --discard removes what is not of this dataset");
            return Err(Error::bad(file, "metadata `ema.plan`", of, allowed));
        }
        let merged = Compacted::from_bytes(plan, &path, bytes, &numbered, true)?;
        let before = merged.map_or(vec![None; parts.len()], |m| m.telemetry);
        // merged before; what was staged since is what verification had discarded
        let again = |(p, before): (&Part, Option<Receipt>)| {
            let staged = part_staged(storage, p)?.then(|| read(p)).transpose()?;
            Ok(staged.and_then(|s| s.telemetry).or(before))
        };
        parts.par_iter().zip(before).map(again).collect::<Result<_>>()?
    };
    let runs = parts[0].runs.start..parts[parts.len() - 1].runs.end;
    let mut files = vec![of_table(&path, receipt_of(storage, &path)?, Some(runs))];
    for (part, receipt) in parts.iter().zip(receipts) {
        if part.telemetry {
            let path = plan.telemetry_path(part);
            let receipt = match receipt {
                Some(r) => r,
                None => receipt_of(storage, &path)?,
            };
            files.push(of_table(&path, receipt, Some(part.runs.clone())));
        }
    }
    Ok(files)
}

fn part_staged(storage: &Storage, part: &Part) -> Result<bool> {
    Ok(storage.head(&staged(part.number))?.is_some())
}

/// Puts a dataset together.
///
/// # Errors
/// A dataset of another plan; a staged part that is damaged (it is named); storage that refuses.
///
/// * `said` is told how many files of features are there, of how many
pub fn merge(plan: &DatasetPlan, storage: &Storage, said: impl Fn(usize, usize)) -> Result<Merged> {
    match put_together(plan, storage, said) {
        // another merge was quicker, and has cleared the staging folder
        Err(e) => match Manifest::read(storage) {
            Ok(Some(manifest)) if manifest.plan == plan.fingerprint() => {
                complete(plan, storage, &manifest)?;
                Ok(Merged::Whole(manifest))
            }
            _ => Err(e),
        },
        done => done,
    }
}

/// Makes the table of actuators again where it is gone, which the plan says whole.
///
/// # Errors
/// Names a file of the manifest that is not there, or not as long as it was, and what helps.
fn complete(plan: &DatasetPlan, storage: &Storage, manifest: &Manifest) -> Result<()> {
    let there: BTreeMap<String, u64> = storage.list("")?.into_iter().collect();
    for file in manifest.files.iter().filter(|f| there.get(&f.path) != Some(&f.bytes)) {
        if file.path == ACTUATORS && !there.contains_key(ACTUATORS) {
            let bytes = actuators_file(plan, ACTUATORS)?;
            if checksum(&bytes) == file.blake3 {
                storage.put_new(ACTUATORS, bytes)?;
                continue;
            }
        }
        let found = there.get(&file.path).map_or("nothing".into(), |n| format!("{n} bytes"));
        let allowed = format!(
            "{} bytes; ema dataset verify --discard says which parts to make again",
            file.bytes
        );
        let path = format!("{}/{}", storage.describe(), file.path);
        return Err(Error::bad(path, "file of the manifest", found, allowed));
    }
    Ok(())
}

fn put_together(plan: &DatasetPlan, storage: &Storage, said: impl Fn(usize, usize)) -> Result<Merged> {
    enter(plan, storage)?;
    if let Some(manifest) = Manifest::read(storage)? {
        complete(plan, storage, &manifest)?;
        // what a worker left that came late
        storage.delete_prefix(STAGING)?;
        return Ok(Merged::Whole(manifest));
    }
    let parts = plan.parts();
    let made = Made::find(plan, storage)?;
    let missing: Vec<usize> = parts.iter().filter(|p| !made.has(plan, p)).map(|p| p.number).collect();
    if !missing.is_empty() {
        return Ok(Merged::Missing(missing));
    }
    let fingerprint = plan.fingerprint();
    let mut files = Vec::new();
    let bytes = actuators_file(plan, ACTUATORS)?;
    let receipt = Receipt {
        bytes: bytes.len() as u64,
        blake3: checksum(&bytes),
        rows: plan.actuators.len() as u64,
    };
    storage.put_new(ACTUATORS, bytes)?;
    files.push(of_table(ACTUATORS, receipt, None));
    let groups: Vec<&[Part]> = parts
        .chunk_by(|a, b| plan.features_file(a.actuator) == plan.features_file(b.actuator))
        .collect();
    for (number, group) in groups.iter().enumerate() {
        let there = made.merged(number);
        files.extend(compact(plan, &fingerprint, storage, number, group, there)?);
        said(number + 1, groups.len());
    }
    files.sort_by(|a, b| a.path.cmp(&b.path));
    let manifest = Manifest {
        schema_version: SCHEMA_VERSION,
        name: plan.name.clone(),
        plan: fingerprint,
        source: SOURCE.into(),
        actuators: plan.actuators.len() as u64,
        runs: plan.runs(),
        parts: parts.len() as u64,
        files,
    };
    storage.put_new(MANIFEST, manifest.to_bytes())?;
    storage.delete_prefix(STAGING)?;
    Ok(Merged::Whole(manifest))
}
