//! One run out of a fleet's telemetry as a recording, with the channels that were not stored.

use super::Dataset;
use crate::output::Writer;
use anyhow::Result;
use schemas::channel::{Channel, ChannelSet};
use schemas::error::Error;
use schemas::feature::RawFeatures;
use schemas::recording::{Provenance, Recording};
use schemas::telemetry::{TelemetryBuffer, TelemetryHeader, TelemetrySink, TelemetryView};
use sim_worker::command::CommandTrack;
use sim_worker::dataset::parts::Part;
use sim_worker::dataset::plan::KeptTelemetry;
use sim_worker::extractor::{FeatureExtractor, FeaturePlan};
use sim_worker::setup::TestSetup;
use std::path::Path;
use std::sync::Arc;

/// Works out the channels that are not stored, and passes one run on, or all.
struct Derive<'a> {
    run: Option<u64>,
    wanted: ChannelSet,
    command: CommandTrack<'a>,
    steps_per_sample: f64,
    /// rounded as the sensors' samples are
    single: bool,
    count_rad: Option<f64>,
    gear_ratio: f64,
    buffer: TelemetryBuffer,
    to: &'a mut dyn TelemetrySink,
    rows: u64,
}

impl TelemetrySink for Derive<'_> {
    fn accept(&mut self, header: &TelemetryHeader, view: &TelemetryView<'_>) -> schemas::error::Result<()> {
        if self.run.is_some_and(|run| run != header.run) {
            return Ok(());
        }
        let round = |x: f64| if self.single { f64::from(x as f32) } else { x };
        self.buffer.copy_from(view);
        let mut header = header.clone();
        header.channels = self.wanted;
        if view.column(Channel::Com).is_none()
            && let Some(com) = self.buffer.column_mut(Channel::Com)
        {
            for (k, x) in com.iter_mut().enumerate() {
                // the command of the sample's last step
                let step = ((view.first + k as u64) as f64 * self.steps_per_sample).round() as u64 - 1;
                let mut one = [0.0];
                self.command.fill(step, &mut one);
                *x = round(one[0]);
            }
        }
        if let (None, Some(count), Some(theta)) = (
            view.column(Channel::ThetaU),
            self.count_rad,
            view.column(Channel::ThetaM),
        ) {
            let rest = (header.rest_angle_rad.unwrap_or(0.0) / count).round();
            if let Some(user) = self.buffer.column_mut(Channel::ThetaU) {
                for (o, &x) in user.iter_mut().zip(theta) {
                    *o = round(((x / count).round() - rest) * count / self.gear_ratio);
                }
            }
        }
        let phases = [Channel::IA, Channel::IB, Channel::IC].map(|c| view.column(c));
        if let (None, [Some(a), Some(b), Some(c)]) = (view.column(Channel::IEq), phases)
            && let Some(eq) = self.buffer.column_mut(Channel::IEq)
        {
            for (i, o) in eq.iter_mut().enumerate() {
                *o = round(0.5 * (a[i].abs() + b[i].abs() + c[i].abs()));
            }
        }
        self.rows += view.rows as u64;
        self.to.accept(&header, &self.buffer.view())
    }
}

/// A run of a dataset whose telemetry was kept.
pub struct KeptRun<'a> {
    d: &'a Dataset,
    part: &'a Part,
    run: u64,
    kept: &'a KeptTelemetry,
    /// of the run alone
    pub provenance: Provenance,
    recording: Recording,
    /// the channels that were asked for
    pub channels: ChannelSet,
    _scratch: Option<Scratch>,
}

impl<'a> KeptRun<'a> {
    /// Finds run number `run`; the only one if `None`.
    ///
    /// # Errors
    /// A run that the dataset does not have, or has no telemetry of.
    pub fn open(d: &'a Dataset, run: Option<u64>) -> Result<Self> {
        let bad = |found: String, allowed: String| Error::bad(d.storage.describe(), "run", found, allowed);
        let last = d.plan.runs() - 1;
        if run.is_none() && last > 0 {
            return Err(bad(format!("{} runs", last + 1), "--run NUMBER to choose one".into()).into());
        }
        let run = run.unwrap_or(0);
        let part = d
            .part_of(run)
            .ok_or_else(|| bad(run.to_string(), format!("0 to {last}")))?;
        let kept = d.plan.telemetry.as_ref().filter(|_| part.telemetry).ok_or_else(|| {
            let allowed =
                "a run whose telemetry was kept ([telemetry] of the plan, ema simulate --keep both)".to_string();
            bad(format!("{run}: features only"), allowed)
        })?;
        let path = d.plan.telemetry_path(part);
        // the reader wants a file
        let mut scratch = None;
        let file = match d.storage.local_path() {
            Some(root) => root.join(&path),
            None => {
                let bytes = d.storage.get(&path)?;
                let bytes =
                    bytes.ok_or_else(|| Error::bad(d.storage.url(&path), "file", "nothing", "that of the manifest"))?;
                let folder = scratch.insert(Scratch::new()?);
                let file = folder.0.join("part.parquet");
                std::fs::write(&file, &bytes).map_err(|e| Error::io(&file, "cannot be written", e))?;
                file
            }
        };
        let recording = Recording::open(&file)?;
        let provenance = Provenance {
            grid: String::new(),
            seed: d.plan.run(part, run).seed,
            ..recording.provenance.clone()
        };
        Ok(Self {
            d,
            part,
            run,
            kept,
            provenance,
            recording,
            channels: kept.wanted,
            _scratch: scratch,
        })
    }

    /// The test that the run is.
    pub fn setup(&self) -> TestSetup {
        self.d
            .plan
            .setup(self.part.actuator, self.part.sequence, self.part.rest)
    }

    /// Whether samples are of single precision: those of sensors are.
    pub fn is_single(&self) -> bool {
        self.d.plan.sensors.is_some()
    }

    /// Passes the run's samples on, with the channels that were not stored.
    pub fn replay(&self, to: &mut dyn TelemetrySink) -> Result<()> {
        self.replay_of(Some(self.run), to)
    }

    /// The same of one run, or of all of its part.
    fn replay_of(&self, run: Option<u64>, to: &mut dyn TelemetrySink) -> Result<()> {
        let plan = &self.d.plan;
        let actuator = &plan.actuators[self.part.actuator].parameters;
        let mut derive = Derive {
            run,
            wanted: self.channels,
            command: CommandTrack::new(&plan.sequences[self.part.sequence], actuator.step_s),
            steps_per_sample: 1.0 / (self.kept.rate_hz * actuator.step_s),
            single: self.is_single(),
            count_rad: plan.sensors.as_ref().map(|s| s.resolver_count_rad()),
            gear_ratio: actuator.gear_ratio,
            buffer: TelemetryBuffer::new(self.channels, 4096),
            to,
            rows: 0,
        };
        self.recording.replay(4096, &mut derive)?;
        if derive.rows == 0 {
            let (place, found) = (
                self.d.storage.url(&plan.telemetry_path(self.part)),
                format!("no run {}", self.run),
            );
            return Err(Error::bad(place, "runs", found, "ema dataset verify").into());
        }
        Ok(())
    }
}

/// An extractor for each run of a part, in their order.
struct Each {
    first: u64,
    extractors: Vec<FeatureExtractor>,
}

impl TelemetrySink for Each {
    fn accept(&mut self, header: &TelemetryHeader, view: &TelemetryView<'_>) -> schemas::error::Result<()> {
        let place = header.run.checked_sub(self.first).map(|k| k as usize);
        match place.and_then(|k| self.extractors.get_mut(k)) {
            Some(x) => x.accept(header, view),
            None => Ok(()),
        }
    }
}

/// Features of a part's runs from their telemetry, in their order: those of the dataset were formed with the constants of its
/// own actuators.
///
/// * `plan` with other constants
///
/// # Errors
/// Refuses a part whose telemetry was not kept, and one that cannot be read.
pub(super) fn features(d: &Dataset, part: &Part, plan: &Arc<FeaturePlan>) -> Result<Vec<RawFeatures>> {
    let kept = KeptRun::open(d, Some(part.runs.start))?;
    let extractors = part.runs.clone().map(|_| FeatureExtractor::new(plan.clone())).collect();
    let mut each = Each {
        first: part.runs.start,
        extractors,
    };
    kept.replay_of(None, &mut each)?;
    Ok(each.extractors.iter().map(FeatureExtractor::features).collect())
}

/// Writes the telemetry of run number `run` to `out`, Parquet or CSV by its ending.
///
/// # Errors
/// Those of [`KeptRun::open`]; a file that cannot be written.
pub fn export(d: &Dataset, run: u64, out: &Path) -> Result<()> {
    let kept = KeptRun::open(d, Some(run))?;
    let mut sink = Writer::create(out, &kept.provenance, kept.channels, kept.is_single())?;
    kept.replay(&mut sink)?;
    sink.finish()?;
    Ok(())
}

/// A folder that goes away.
struct Scratch(std::path::PathBuf);

impl Scratch {
    fn new() -> Result<Self> {
        let dir = std::env::temp_dir().join(format!("ema-export-{}", std::process::id()));
        std::fs::create_dir_all(&dir).map_err(|e| Error::io(&dir, "cannot be made", e))?;
        Ok(Self(dir))
    }
}

impl Drop for Scratch {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}
