//! What one run of a fleet leaves: its features and, if they are kept, its encoded samples.

use super::parts::{Kind, Part};
use super::plan::{DatasetPlan, KeptTelemetry};
use crate::extractor::FeaturePlan;
use crate::noise::{FeatureSink, FeatureValues, Noise};
use crate::simulate::Run;
use schemas::channel::{Channel, ChannelSet, Sampling};
use schemas::error::Result;
use schemas::run_encoder::{RunChunk, RunEncoder, TelemetryLayout};
use schemas::telemetry::{TelemetryBuffer, TelemetryHeader, TelemetrySink, TelemetryView};
use std::sync::Arc;

/// What the sinks of all runs through one sequence share.
pub struct Shared {
    /// noise that the grid points have in common
    pub noise: Option<Arc<Noise>>,
    /// how telemetry is encoded; none where it is not kept
    pub layout: Option<TelemetryLayout>,
}

impl Shared {
    ///
    /// * `sequence` its place in [`DatasetPlan::sequences`]
    ///
    /// # Errors
    /// As [`TelemetryLayout::new`].
    pub fn new(plan: &DatasetPlan, sequence: usize) -> Result<Self> {
        let rows = plan.rows(sequence);
        let layout = |t: &KeptTelemetry| TelemetryLayout::new(t.stored, plan.sensors.is_some(), t.rate_hz);
        Ok(Self {
            noise: plan
                .sensors
                .as_ref()
                .map(|model| Arc::new(Noise::common(model, plan.feature_seeds, rows))),
            layout: plan.telemetry.as_ref().map(layout).transpose()?,
        })
    }
}

/// Channels that a stored channel is formed from by the sensors.
pub fn with_sources(stored: ChannelSet, measured: bool) -> ChannelSet {
    let mut set = stored;
    if measured && stored.contains(Channel::IEq) {
        set = set.with(Channel::IA).with(Channel::IB).with(Channel::IC);
    }
    if measured && stored.contains(Channel::ThetaU) {
        set = set.with(Channel::ThetaM);
    }
    set
}

/// Makes samples of a lower rate: the last value of an interval, or the mean over it.
struct Decimator {
    every: u64,
    channels: Vec<(Channel, f64)>,
    out: TelemetryBuffer,
}

impl Decimator {
    fn new(channels: ChannelSet, every: u64) -> Self {
        Self {
            every,
            channels: channels.iter().map(|c| (c, 0.0)).collect(),
            out: TelemetryBuffer::new(channels, 128),
        }
    }

    /// The samples whose intervals end in `view`.
    fn push(&mut self, view: &TelemetryView<'_>) -> TelemetryView<'_> {
        let first = (view.first - 1) / self.every + 1;
        let rows = ((view.first - 1 + view.rows as u64) / self.every + 1 - first) as usize;
        let mut out = self.out.view_mut(first, rows);
        for (c, sum) in &mut self.channels {
            let (Some(values), Some(column)) = (view.column(*c), out.column_mut(*c)) else {
                continue;
            };
            let mut next = 0;
            for (n, x) in (view.first..).zip(values) {
                *sum = if c.sampling() == Sampling::Mean { *sum + x } else { *x };
                if n.is_multiple_of(self.every) {
                    column[next] = if c.sampling() == Sampling::Mean {
                        *sum / self.every as f64
                    } else {
                        *sum
                    };
                    next += 1;
                    *sum = 0.0;
                }
            }
        }
        self.out.view()
    }
}

/// Keeps the samples of one run.
struct Keeper {
    encoder: RunEncoder,
    decimator: Option<Decimator>,
    noise: Option<Arc<Noise>>,
    measured: TelemetryBuffer,
    gear_ratio: f64,
}

impl Keeper {
    fn push(&mut self, header: &TelemetryHeader, view: &TelemetryView<'_>) -> Result<()> {
        let view = match &mut self.decimator {
            Some(d) => d.push(view),
            None => *view,
        };
        if view.rows == 0 {
            return Ok(());
        }
        let Some(noise) = &self.noise else {
            return self.encoder.push(&view);
        };
        noise.measure(header, self.gear_ratio, &view, &mut self.measured);
        self.encoder.push(&self.measured.view())
    }
}

/// Sink of one run.
pub struct RunSink {
    features: FeatureSink,
    keeper: Option<Keeper>,
}

/// What is left of one run.
pub struct RunResult {
    /// number of the run in the dataset
    pub run: u64,
    /// raw features and their standard deviations over the noise seeds
    pub features: FeatureValues,
    /// encoded samples; none where they are not kept
    pub telemetry: Option<RunChunk>,
}

impl RunSink {
    /// A sink for a run of a part.
    ///
    /// * `features` made for its actuator and sequence
    ///
    /// # Errors
    /// As [`TelemetryLayout::encoder`].
    pub fn new(
        plan: &DatasetPlan,
        part: &Part,
        shared: &Shared,
        features: &Arc<FeaturePlan>,
        run: &Run,
    ) -> Result<Self> {
        let own = |rows: u64| {
            let model = plan.sensors.as_ref()?;
            Some(Arc::new(Noise::of_run(model, run.seed, rows)))
        };
        let rows = plan.rows(part.sequence);
        let noise = match part.kind {
            Kind::Map => shared.noise.clone(),
            Kind::Test => own(rows),
        };
        let keeper = match (&plan.telemetry, &shared.layout) {
            (Some(t), Some(layout)) if part.telemetry => {
                let f = run.lane.fault;
                let channels = with_sources(t.stored, plan.sensors.is_some());
                Some(Keeper {
                    encoder: layout.encoder(run.number, [f.fsj, f.zeta, run.lane.rest_angle_rad])?,
                    decimator: (t.every > 1).then(|| Decimator::new(channels, t.every)),
                    // the samples of a test are those that its features are taken from
                    noise: match part.kind {
                        Kind::Test if t.every == 1 => noise.clone(),
                        _ => own(rows / t.every),
                    },
                    measured: TelemetryBuffer::new(channels, 128),
                    gear_ratio: run.lane.actuator.gear_ratio,
                })
            }
            _ => None,
        };
        Ok(Self {
            features: FeatureSink::new(features.clone(), noise),
            keeper,
        })
    }

    /// What is left of run number `run`.
    ///
    /// # Errors
    /// As [`RunEncoder::finish`].
    pub fn finish(self, run: u64) -> Result<RunResult> {
        let telemetry = self.keeper.map(|k| k.encoder.finish()).transpose()?;
        Ok(RunResult {
            run,
            features: self.features.result(),
            telemetry,
        })
    }
}

impl TelemetrySink for RunSink {
    fn accept(&mut self, header: &TelemetryHeader, view: &TelemetryView<'_>) -> Result<()> {
        self.features.push(header, view);
        match &mut self.keeper {
            Some(k) => k.push(header, view),
            None => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn prop_lower_rates_take_means_and_ends_whatever_the_blocks() {
        let set = ChannelSet::of([Channel::OmegaM, Channel::IA]);
        let values: Vec<f64> = (1..=23).map(f64::from).collect();
        for block in [1, 3, 10, 23] {
            let mut d = Decimator::new(set, 5);
            let (mut omega, mut current, mut numbers) = (Vec::new(), Vec::new(), Vec::new());
            for (k, chunk) in values.chunks(block).enumerate() {
                let first = (k * block) as u64 + 1;
                let view = TelemetryView::new(first, chunk.len())
                    .with(Channel::OmegaM, chunk)
                    .with(Channel::IA, chunk);
                let out = d.push(&view);
                numbers.extend((0..out.rows as u64).map(|i| out.first + i));
                omega.extend_from_slice(out.column(Channel::OmegaM).unwrap());
                current.extend_from_slice(out.column(Channel::IA).unwrap());
            }
            assert_eq!(numbers, [1, 2, 3, 4], "{block}");
            assert_eq!(omega, [5.0, 10.0, 15.0, 20.0]);
            assert_eq!(current, [3.0, 8.0, 13.0, 18.0]);
        }
    }
}
