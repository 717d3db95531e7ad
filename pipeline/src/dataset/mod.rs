//! Datasets on the ground: what a plan will cost, maps and diagnoses of every actuator, single runs.

pub(crate) mod diagnose;
pub(crate) mod estimate;
pub(crate) mod export;
pub mod maps;
pub mod wear;

use anyhow::Result;
use schemas::error::Error;
use sim_worker::dataset::layout::features;
use sim_worker::dataset::manifest::Manifest;
use sim_worker::dataset::merge::{Merged, merge};
use sim_worker::dataset::parts::{Kind, Part};
use sim_worker::dataset::plan::DatasetPlan;
use sim_worker::dataset::program::work_shown;
use sim_worker::dataset::shard::Shard;
use sim_worker::dataset::storage::Storage;
use sim_worker::dataset::tables::Table;
use sim_worker::dataset::work::{Done, plan_of};
use sim_worker::noise::FeatureValues;
use std::collections::BTreeMap;
use std::path::Path;

/// Simulates what is missing of a plan's dataset and puts it together. `Ok(None)` where it was interrupted.
///
/// * `title` of the progress bar
///
/// # Errors
/// A dataset of another plan; storage that refuses. What is stored stays.
pub fn make(plan: &DatasetPlan, storage: &Storage, title: &str) -> Result<Option<(Done, Manifest)>> {
    let Some(done) = work_shown(plan, storage, Shard::WHOLE, title)? else {
        return Ok(None);
    };
    match merge(plan, storage, |_, _| ())? {
        Merged::Whole(manifest) => Ok(Some((done, manifest))),
        Merged::Missing(parts) => Err(Error::torn(
            Path::new(&storage.describe()),
            format!("{} parts vanished while others were made", parts.len()),
        )
        .into()),
    }
}

/// A finished dataset.
pub struct Dataset {
    /// folder or bucket
    pub storage: Storage,
    /// what it was made from
    pub plan: DatasetPlan,
    /// what belongs to it
    pub manifest: Manifest,
    parts: Vec<Part>,
}

/// The features of some runs of one part.
pub(crate) struct Rows<'a> {
    pub part: &'a Part,
    pub values: Vec<FeatureValues>,
}

impl Dataset {
    /// Opens a dataset that is put together.
    ///
    /// # Errors
    /// Refuses a place that is no finished dataset.
    pub fn open(url: &str) -> Result<Self> {
        Self::of(Storage::open(url)?)
    }

    /// As [`Dataset::open`], where it is stored.
    ///
    /// # Errors
    /// Refuses a dataset without plan, of another layout, or that is not put together yet.
    pub fn of(storage: Storage) -> Result<Self> {
        let (plan, _) = plan_of(&storage)?;
        let allowed = "a finished dataset; start ema simulate again, or run the missing shards and ema dataset merge";
        let manifest = Manifest::read(&storage)?
            .ok_or_else(|| Error::bad(storage.describe(), "manifest.json", "nothing", allowed))?;
        Ok(Self {
            parts: plan.parts(),
            storage,
            plan,
            manifest,
        })
    }

    /// Hands out the features of one actuator after another.
    ///
    /// # Errors
    /// Features that are not those of the plan (ema dataset verify says more), and those of `take`.
    pub(crate) fn each_actuator(&self, mut take: impl FnMut(usize, &[Rows<'_>]) -> Result<()>) -> Result<()> {
        let by_file = |a: &Part, b: &Part| self.plan.features_file(a.actuator) == self.plan.features_file(b.actuator);
        for group in self.parts.chunk_by(by_file) {
            let path = features(self.plan.features_file(group[0].actuator));
            let missing = || Error::bad(self.storage.url(&path), "file", "nothing", "that of the manifest");
            let bytes = self.storage.get(&path)?.ok_or_else(missing)?;
            let table = Table::read(&path, bytes)?;
            let (runs, values) = (table.numbers("run")?, table.features()?);
            let rows: BTreeMap<u64, usize> = runs.iter().copied().zip(0..).collect();
            for parts in group.chunk_by(|a, b| a.actuator == b.actuator) {
                let of = |part| -> Result<Rows<'_>> {
                    let one = |run: u64| {
                        let allowed = "every run once (ema dataset verify)";
                        let lost = || Error::bad(self.storage.url(&path), format!("run {run}"), "nothing", allowed);
                        rows.get(&run).map(|&i| values[i]).ok_or_else(lost)
                    };
                    let part: &Part = part;
                    let values = part.runs.clone().map(one).collect::<Result<_, _>>()?;
                    Ok(Rows { part, values })
                };
                let list: Vec<Rows<'_>> = parts.iter().map(of).collect::<Result<_>>()?;
                take(parts[0].actuator, &list)?;
            }
        }
        Ok(())
    }

    /// The part that a run is of.
    pub(crate) fn part_of(&self, run: u64) -> Option<&Part> {
        self.parts.iter().find(|p| p.runs.contains(&run))
    }
}

/// Points of the grid, by sequence and rest angle.
pub(crate) fn grids<'a>(rows: &'a [Rows<'a>]) -> Vec<(usize, usize, Vec<FeatureValues>)> {
    let mut list: Vec<(usize, usize, Vec<FeatureValues>)> = Vec::new();
    for r in rows.iter().filter(|r| r.part.kind == Kind::Map) {
        match list.last_mut() {
            Some(l) if (l.0, l.1) == (r.part.sequence, r.part.rest) => l.2.extend(&r.values),
            _ => list.push((r.part.sequence, r.part.rest, r.values.clone())),
        }
    }
    list
}
