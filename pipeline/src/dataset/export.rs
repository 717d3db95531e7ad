//! One run out of a fleet's telemetry as a recording, with the channels that were not stored.

use super::Dataset;
use crate::output::Writer;
use anyhow::Result;
use schemas::channel::{Channel, ChannelSet};
use schemas::error::Error;
use schemas::recording::{Provenance, Recording};
use schemas::telemetry::{TelemetryBuffer, TelemetryHeader, TelemetrySink, TelemetryView};
use sim_worker::command::CommandTrack;
use std::path::Path;

/// Works out the channels that are not stored, and passes one run on.
struct Derive<'a> {
    run: u64,
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
        if header.run != self.run {
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

/// Writes the telemetry of run number `run` to `out`, Parquet or CSV by its ending.
///
/// # Errors
/// A run that the dataset does not have, or has no telemetry of.
pub fn export(d: &Dataset, run: u64, out: &Path) -> Result<()> {
    let bad = |found: String, allowed: String| Error::bad(d.storage.describe(), "run", found, allowed);
    let part = d
        .part_of(run)
        .ok_or_else(|| bad(run.to_string(), format!("0 to {}", d.plan.runs() - 1)))?;
    let kept = d.plan.telemetry.as_ref().filter(|_| part.telemetry).ok_or_else(|| {
        let allowed = "a run whose telemetry was kept ([telemetry] of the plan)".to_string();
        bad(format!("{run}: features only"), allowed)
    })?;
    let path = d.plan.telemetry_path(part);
    // the reader wants a file
    let folder;
    let file = match d.storage.local_path() {
        Some(root) => root.join(&path),
        None => {
            let bytes = d.storage.get(&path)?;
            let bytes =
                bytes.ok_or_else(|| Error::bad(d.storage.url(&path), "file", "nothing", "that of the manifest"))?;
            folder = Scratch::new()?;
            let file = folder.0.join("part.parquet");
            std::fs::write(&file, &bytes).map_err(|e| Error::io(&file, "cannot be written", e))?;
            file
        }
    };
    let recording = Recording::open(&file)?;
    let actuator = &d.plan.actuators[part.actuator];
    let sequence = &d.plan.sequences[part.sequence];
    let step_s = actuator.parameters.step_s;
    let provenance = Provenance {
        grid: String::new(),
        seed: d.plan.run(part, run).seed,
        ..recording.provenance.clone()
    };
    let single = d.plan.sensors.is_some();
    let mut sink = Writer::create(out, &provenance, kept.wanted, single)?;
    let mut derive = Derive {
        run,
        wanted: kept.wanted,
        command: CommandTrack::new(sequence, step_s),
        steps_per_sample: 1.0 / (kept.rate_hz * step_s),
        single,
        count_rad: d.plan.sensors.as_ref().map(|s| s.resolver_count_rad()),
        gear_ratio: actuator.parameters.gear_ratio,
        buffer: TelemetryBuffer::new(kept.wanted, 4096),
        to: &mut sink,
        rows: 0,
    };
    recording.replay(4096, &mut derive)?;
    if derive.rows == 0 {
        return Err(Error::bad(
            d.storage.url(&path),
            "runs",
            format!("no run {run}"),
            "ema dataset verify",
        )
        .into());
    }
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
