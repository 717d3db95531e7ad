//! Works through a share of a plan. A part appears whole or not at all, whoever makes it and however often;
//! a second start does what is missing.

use super::layout::{MANIFEST, PLAN, STAGED, features, staged, staged_part};
use super::parts::{Kind, Part};
use super::plan::DatasetPlan;
use super::shard::Shard;
use super::sink::{RunResult, RunSink, Shared, with_sources};
use super::storage::{Put, Storage};
use super::tables::{Receipt, Staged, Table, telemetry_pairs};
use crate::extractor::FeaturePlan;
use crate::progress::Progress;
use crate::sensor::SensorModel;
use crate::simulate::{Experiment, Run, simulate};
use rayon::prelude::*;
use schemas::error::{Error, Result};
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex};

/// What a worker has done.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Done {
    /// parts of the share
    pub parts: usize,
    /// of these, there before
    pub before: usize,
    /// of these, made by another worker at the same time
    pub twice: usize,
    /// runs of the share
    pub runs: u64,
    /// steps simulated by this start
    pub steps: u64,
    /// stored
    pub bytes: u64,
}

/// The dataset of a plan: makes it, or finds that it is there and of the same plan.
///
/// # Errors
/// A dataset of another plan, with what differs; a folder with something else in it.
pub fn enter(plan: &DatasetPlan, storage: &Storage) -> Result<()> {
    let first = format!("# plan {}", plan.fingerprint());
    let text = format!("{first}\n{}", plan.text);
    if storage.put_new(PLAN, text)? == Put::Made {
        if let Some(path) = stranger(plan, storage)? {
            storage.delete(PLAN)?;
            refuse_old(storage)?;
            return Err(Error::bad(
                storage.describe(),
                "dataset",
                format!("{path} and no {PLAN}"),
                "nothing, or a dataset of this plan",
            ));
        }
        return Ok(());
    }
    let found = storage.get(PLAN)?.unwrap_or_default();
    let found = String::from_utf8_lossy(&found);
    let (line, rest) = found.split_once('\n').unwrap_or((&found, ""));
    if line == first {
        return Ok(());
    }
    Err(Error::bad(
        format!("{}/{PLAN}", storage.describe()),
        "fingerprint of the plan",
        format!("{}; {}", line.trim_start_matches("# plan "), differs(rest, &plan.text)),
        format!("{}, or another place for the dataset (--out)", plan.fingerprint()),
    ))
}

/// Refuses a folder that `ema simulate` made when datasets of one actuator had a layout of their own.
fn refuse_old(storage: &Storage) -> Result<()> {
    const OLD: &str = "plan.txt";
    if storage.head(OLD)?.is_none() {
        return Ok(());
    }
    let found = format!("{OLD}, a dataset of version 0.1");
    let allowed =
        format!("a dataset with {PLAN}; `ema simulate --out NEW` makes one, its telemetry files stay recordings");
    Err(Error::bad(storage.describe(), "dataset", found, allowed))
}

/// An object that is not of a dataset of `plan`. Those of this plan may be there although its text was not:
/// other workers are quick, and a plan may get lost.
fn stranger(plan: &DatasetPlan, storage: &Storage) -> Result<Option<String>> {
    let mut tables = Vec::new();
    for (path, size) in storage.list("")? {
        let ours = [
            "telemetry/",
            "features/",
            "actuators/",
            "maps/",
            "maps.parquet",
            "calibration-",
            "diagnoses/",
            "wear/",
            "_staging/",
        ];
        if path != PLAN && path != MANIFEST && !ours.iter().any(|p| path.starts_with(p)) {
            return Ok(Some(path));
        }
        let table = ["telemetry/", "features/", STAGED].iter().any(|p| path.starts_with(p));
        if table && path.ends_with(".parquet") {
            tables.push((size, path));
        }
    }
    // the smallest stands for all: they came by one plan
    let Some((_, path)) = tables.into_iter().min() else {
        return Ok(None);
    };
    let Some(bytes) = storage.get(&path)? else {
        return Ok(None);
    };
    let of = Table::pair_of(&path, bytes, "ema.plan").ok().flatten();
    Ok((of != Some(plan.fingerprint())).then_some(path))
}

/// The first thing by which two plans differ, comments, empty lines and order aside.
fn differs(there: &str, here: &str) -> String {
    fn lines(text: &str) -> Vec<&str> {
        let code = |l: &&str| !l.is_empty() && !l.starts_with('#');
        text.lines().map(str::trim).filter(code).collect()
    }
    let (there, here) = (lines(there), lines(here));
    let only = |a: &[&str], b: &[&str]| a.iter().find(|l| !b.contains(l)).map(|l| clip(l));
    match (only(&there, &here), only(&here, &there)) {
        (Some(a), Some(b)) => format!("there it says `{a}`, here `{b}`"),
        (Some(a), None) => format!("there it says `{a}`, here nothing of it"),
        (None, Some(b)) => format!("here it says `{b}`, there nothing of it"),
        (None, None) => "the same text in another order, or another version of the program".into(),
    }
}

fn clip(line: &str) -> String {
    line.chars().filter(|c| !c.is_control()).take(100).collect()
}

/// Which parts need not be made.
pub struct Made {
    staged: BTreeSet<usize>,
    features: BTreeSet<String>,
    telemetry: BTreeSet<String>,
}

impl Made {
    /// Looks what is there.
    ///
    /// # Errors
    /// Storage that refuses.
    pub fn find(plan: &DatasetPlan, storage: &Storage) -> Result<Self> {
        let names = |prefix: &str| -> Result<BTreeSet<String>> {
            Ok(storage.list(prefix)?.into_iter().map(|(path, _)| path).collect())
        };
        let telemetry = plan.telemetry.as_ref().map(|_| names("telemetry"));
        Ok(Self {
            staged: names(STAGED)?.iter().filter_map(|p| staged_part(p)).collect(),
            features: names("features")?,
            telemetry: telemetry.transpose()?.unwrap_or_default(),
        })
    }

    /// Whether a part is staged.
    pub fn staged(&self, part: &Part) -> bool {
        self.staged.contains(&part.number)
    }

    /// Whether a file of features has been put together.
    pub fn merged(&self, file: usize) -> bool {
        self.features.contains(&features(file))
    }

    /// Whether a part is staged or merged, its telemetry included.
    pub fn has(&self, plan: &DatasetPlan, part: &Part) -> bool {
        let merged = self.merged(plan.features_file(part.actuator));
        let samples = !part.telemetry || self.telemetry.contains(&plan.telemetry_path(part));
        samples && (merged || self.staged.contains(&part.number))
    }
}

/// Feature plans of actuators that have parts to do: the simplified model runs once for each actuator and
/// sequence.
#[derive(Default)]
struct FeaturePlans {
    plans: Mutex<BTreeMap<(usize, usize, bool), Arc<FeaturePlan>>>,
}

impl FeaturePlans {
    fn get(&self, plan: &DatasetPlan, part: &Part) -> Arc<FeaturePlan> {
        let of_map = part.kind == Kind::Map;
        let key = (part.actuator, part.sequence, of_map);
        let find = || self.plans.lock().expect("no panics").get(&key).cloned();
        if let Some(found) = find() {
            return found;
        }
        let actuator = &plan.actuators[part.actuator].parameters;
        let made = FeaturePlan::new(
            actuator,
            &plan.sequences[part.sequence],
            plan.rate_hz,
            plan.equivalent_current,
            SensorModel::sampling_of(plan.sensors.as_ref()),
        );
        let made = if of_map { made.in_time() } else { made };
        let mut plans = self.plans.lock().expect("no panics");
        // the latest are enough: parts come in the order of actuators
        while plans.len() > 64 {
            plans.pop_first();
        }
        plans.entry(key).or_insert(Arc::new(made)).clone()
    }
}

/// A part whose blocks are being simulated.
struct Assembly<'a> {
    part: &'a Part,
    results: Mutex<Vec<RunResult>>,
}

/// Simulates blocks and stores parts.
pub struct Bench<'a> {
    plan: &'a DatasetPlan,
    fingerprint: String,
    shared: Vec<Shared>,
    /// by sequence: without telemetry, with it
    experiments: Vec<[Experiment; 2]>,
    features: FeaturePlans,
}

impl<'a> Bench<'a> {
    /// Experiments of all sequences, and the noise that runs share.
    ///
    /// # Errors
    /// A rate that no step can serve.
    pub fn new(plan: &'a DatasetPlan) -> Result<Self> {
        let step = plan.actuators[0].parameters.step_s;
        let mut experiments = Vec::new();
        let mut shared = Vec::new();
        for (k, sequence) in plan.sequences.iter().enumerate() {
            let bare = FeaturePlan::wanted_of(sequence, plan.equivalent_current);
            let stored = plan
                .telemetry
                .as_ref()
                .map_or(bare, |t| with_sources(t.stored, plan.sensors.is_some()));
            let all = schemas::channel::ChannelSet(bare.0 | stored.0);
            let sampling = SensorModel::sampling_of(plan.sensors.as_ref());
            let experiment = |channels| {
                Experiment::new(sequence.clone(), plan.rate_hz, channels, None, step).map(|e| e.sampled(sampling))
            };
            experiments.push([experiment(bare)?, experiment(all)?]);
            shared.push(Shared::new(plan, k)?);
        }
        Ok(Self {
            plan,
            fingerprint: plan.fingerprint(),
            shared,
            experiments,
            features: FeaturePlans::default(),
        })
    }

    /// Simulates some runs of a part; `None` where it was stopped.
    ///
    /// # Errors
    /// As [`simulate`].
    pub fn block(&self, part: &Part, runs: &[u64], progress: &Progress) -> Result<Option<Vec<RunResult>>> {
        let features = self.features.get(self.plan, part);
        let shared = &self.shared[part.sequence];
        let list: Vec<Run> = runs.iter().map(|&r| self.plan.run(part, r)).collect();
        let sink = |run: &Run| RunSink::new(self.plan, part, shared, &features, run);
        let mut sinks = list.iter().map(sink).collect::<Result<Vec<_>>>()?;
        let experiment = &self.experiments[part.sequence][usize::from(part.telemetry)];
        let go_on = || !progress.stop.load(Ordering::Relaxed);
        let Some(steps) = simulate(experiment, &list, &mut sinks, go_on)? else {
            return Ok(None);
        };
        let results = runs
            .iter()
            .zip(sinks)
            .map(|(&r, s)| s.finish(r))
            .collect::<Result<_>>()?;
        progress.steps.fetch_add(steps, Ordering::Relaxed);
        progress.runs.fetch_add(runs.len() as u64, Ordering::Relaxed);
        Ok(Some(results))
    }

    /// The telemetry file of some runs of a part, and its samples; none where telemetry is not kept.
    fn telemetry_file(&self, part: &Part, results: Vec<RunResult>) -> Result<Option<(Vec<u8>, u64)>> {
        let (true, Some(layout)) = (part.telemetry, &self.shared[part.sequence].layout) else {
            return Ok(None);
        };
        let chunks: Vec<_> = results.into_iter().filter_map(|r| r.telemetry).collect();
        let samples = chunks.iter().map(|c| c.rows).sum();
        let bytes = layout.file(chunks, telemetry_pairs(self.plan, part, &self.fingerprint))?;
        Ok(Some((bytes, samples)))
    }

    /// Bytes that the telemetry of some runs of a part takes.
    ///
    /// # Errors
    /// As [`TelemetryLayout::file`].
    pub fn telemetry_bytes(&self, part: &Part, results: Vec<RunResult>) -> Result<usize> {
        Ok(self.telemetry_file(part, results)?.map_or(0, |f| f.0.len()))
    }

    /// The telemetry file of a part, and its staged features.
    fn encode(&self, part: &Part, mut results: Vec<RunResult>) -> Result<(Option<Vec<u8>>, Vec<u8>)> {
        results.sort_by_key(|r| r.run);
        let rows = results.iter().map(|r| r.features).collect();
        let file = self.telemetry_file(part, results)?;
        let receipt = file.as_ref().map(|(bytes, samples)| Receipt {
            bytes: bytes.len() as u64,
            blake3: schemas::fingerprint::checksum(bytes),
            rows: *samples,
        });
        let features = Staged {
            rows,
            telemetry: receipt,
        };
        let staged = features.to_bytes(&staged(part.number), &self.fingerprint, part)?;
        Ok((file.map(|f| f.0), staged))
    }

    /// Stores a part, its staged features last. Returns whether all of it was new, and the bytes.
    fn store(&self, storage: &Storage, part: &Part, results: Vec<RunResult>) -> Result<(bool, u64)> {
        let (telemetry, features) = self.encode(part, results)?;
        let mut bytes = features.len() as u64;
        if let Some(t) = telemetry {
            let (path, size) = (self.plan.telemetry_path(part), t.len() as u64);
            bytes += size;
            if storage.put_new(&path, t)? == Put::Existed {
                let found = storage.head(&path)?.unwrap_or(0);
                if found != size {
                    let place = format!("{}/{path}", storage.describe());
                    let allowed = format!("{size} bytes; ema dataset verify --discard removes what is damaged");
                    return Err(Error::bad(place, "size", format!("{found} bytes"), allowed));
                }
            }
        }
        let put = storage.put_new(&staged(part.number), features)?;
        Ok((put == Put::Made, bytes))
    }
}

/// Works through a share of a plan. `Ok(None)` where it was stopped.
///
/// # Errors
/// A dataset of another plan; storage that refuses. What is stored stays.
pub fn work(plan: &DatasetPlan, storage: &Storage, shard: Shard, progress: &Progress) -> Result<Option<Done>> {
    enter(plan, storage)?;
    let parts = plan.parts();
    let share = &parts[shard.range(parts.len())];
    let mut done = Done {
        parts: share.len(),
        runs: share.iter().map(|p| p.runs.end - p.runs.start).sum(),
        ..Done::default()
    };
    if storage.head(MANIFEST)?.is_some() {
        done.before = share.len();
        progress.runs.fetch_add(done.runs, Ordering::Relaxed);
        return Ok(Some(done));
    }
    let made = Made::find(plan, storage)?;
    let (there, missing): (Vec<&Part>, Vec<&Part>) = share.iter().partition(|p| made.has(plan, p));
    done.before = there.len();
    let before: u64 = there.iter().map(|p| p.runs.end - p.runs.start).sum();
    progress.runs.fetch_add(before, Ordering::Relaxed);

    let bench = Bench::new(plan)?;
    let assemblies: Vec<Assembly<'_>> = missing
        .iter()
        .map(|&part| Assembly {
            part,
            results: Mutex::default(),
        })
        .collect();
    let mut blocks: Vec<(&Assembly<'_>, Vec<u64>)> = Vec::new();
    for a in &assemblies {
        let runs: Vec<u64> = a.part.runs.clone().collect();
        blocks.extend(runs.chunks(plan.lanes(a.part)).map(|c| (a, c.to_vec())));
    }
    let (bytes, twice) = (AtomicU64::new(0), AtomicU64::new(0));
    blocks.par_iter().try_for_each(|(assembly, runs)| -> Result<()> {
        if progress.stop.load(Ordering::Relaxed) {
            return Ok(());
        }
        let part = assembly.part;
        let Some(list) = bench.block(part, runs, progress)? else {
            return Ok(());
        };
        let whole = {
            let mut results = assembly.results.lock().expect("no panics");
            results.extend(list);
            (results.len() as u64 == part.runs.end - part.runs.start).then(|| std::mem::take(&mut *results))
        };
        if let Some(results) = whole {
            let (new, size) = match bench.store(storage, part, results) {
                // a late worker: meanwhile the dataset was finished, and the staging folder is gone
                Err(_) if matches!(storage.head(MANIFEST), Ok(Some(_))) => (false, 0),
                stored => stored?,
            };
            bytes.fetch_add(size, Ordering::Relaxed);
            twice.fetch_add(u64::from(!new), Ordering::Relaxed);
        }
        Ok(())
    })?;
    if progress.stop.load(Ordering::Relaxed) {
        return Ok(None);
    }
    done.twice = twice.into_inner() as usize;
    done.bytes = bytes.into_inner();
    done.steps = progress.steps.load(Ordering::Relaxed);
    Ok(Some(done))
}

/// A dataset's own plan, and its fingerprint when the dataset was made (another version of the program may
/// give it another one).
///
/// # Errors
/// No dataset there, or one of version 0.1; a plan that is torn or not allowed.
pub fn plan_of(storage: &Storage) -> Result<(DatasetPlan, String)> {
    let file = format!("{}/{PLAN}", storage.describe());
    let allowed = "a dataset (ema simulate, ema dataset make, sim-worker)";
    let Some(bytes) = storage.get(PLAN)? else {
        refuse_old(storage)?;
        return Err(Error::bad(&file, "file", "nothing", allowed));
    };
    let text = String::from_utf8(bytes.to_vec()).map_err(|e| Error::torn(Path::new(&file), e))?;
    let (first, rest) = text.split_once('\n').unwrap_or((&text, ""));
    let fingerprint = first
        .strip_prefix("# plan ")
        .ok_or_else(|| Error::bad(&file, "line 1", first, "`# plan` and a fingerprint"))?;
    Ok((DatasetPlan::parse(&file, rest, Path::new(""))?, fingerprint.into()))
}
