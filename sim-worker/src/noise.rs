//! Features of a run as its sensors give them, averaged over seeds of their noise.

use crate::extractor::{FeatureExtractor, FeaturePlan};
use crate::sensor::{SensorModel, SensorNoise, Sensors};
use schemas::feature::RawFeatures;
use schemas::telemetry::{TelemetryBuffer, TelemetryHeader, TelemetryView};
use std::sync::Arc;

/// Seeds over which the features of a run are averaged when there is a sensor model. The same
/// seeds serve every run, so that the maps stay smooth.
pub const FEATURE_SEEDS: u64 = 16;

/// Sensor model and noise that runs share.
#[derive(Debug)]
pub struct Noise {
    model: SensorModel,
    seeds: Vec<SensorNoise>,
}

impl Noise {
    /// The noise that all runs of a grid have in common.
    ///
    /// * `seeds` how many
    /// * `rows` samples of a run
    pub fn common(model: &SensorModel, seeds: u64, rows: u64) -> Self {
        let noise = |s| SensorNoise::new(u64::MAX - s, rows as usize);
        Self {
            model: model.clone(),
            seeds: (0..seeds).map(noise).collect(),
        }
    }

    /// The noise of one test.
    pub fn of_run(model: &SensorModel, seed: u64, rows: u64) -> Self {
        Self {
            model: model.clone(),
            seeds: vec![SensorNoise::new(seed, rows as usize)],
        }
    }

    /// The sensors of the run that `header` describes, with the noise of each seed.
    fn sensors(&self, header: &TelemetryHeader, gear_ratio: f64) -> impl Iterator<Item = Sensors<'_>> {
        let rest_angle_rad = header.rest_angle_rad.unwrap_or(0.0);
        self.seeds.iter().map(move |noise| Sensors {
            model: &self.model,
            noise,
            gear_ratio,
            rest_angle_rad,
        })
    }

    /// Measures with the first seed.
    pub fn measure(
        &self,
        header: &TelemetryHeader,
        gear_ratio: f64,
        view: &TelemetryView<'_>,
        out: &mut TelemetryBuffer,
    ) {
        if let Some(s) = self.sensors(header, gear_ratio).next() {
            s.measure(view, out);
        }
    }
}

/// Mean and standard deviation of each of [`RawFeatures::COLUMNS`]; no mean where a seed has no value.
pub type FeatureValues = [(Option<f64>, f64); RawFeatures::COUNT];

/// Takes the features of one run.
#[derive(Debug)]
pub struct FeatureSink {
    plan: Arc<FeaturePlan>,
    noise: Option<Arc<Noise>>,
    extractors: Vec<FeatureExtractor>,
    measured: TelemetryBuffer,
}

impl FeatureSink {
    /// * `noise` of the sensors; true values are taken where there is none
    pub fn new(plan: Arc<FeaturePlan>, noise: Option<Arc<Noise>>) -> Self {
        let n = noise.as_ref().map_or(1, |n| n.seeds.len());
        Self {
            extractors: vec![FeatureExtractor::new(plan.clone()); n],
            measured: TelemetryBuffer::new(plan.wanted(), 512),
            plan,
            noise,
        }
    }

    /// Takes the next true samples of the run.
    pub fn push(&mut self, header: &TelemetryHeader, view: &TelemetryView<'_>) {
        let Some(noise) = &self.noise else {
            return self.extractors[0].push(view);
        };
        if !self.plan.needs(view.first, view.rows) {
            return;
        }
        for (sensors, x) in noise.sensors(header, self.plan.gear_ratio).zip(&mut self.extractors) {
            sensors.measure(view, &mut self.measured);
            x.push(&self.measured.view());
        }
    }

    /// Mean and standard deviation over the seeds.
    pub fn result(&self) -> FeatureValues {
        let all: Vec<[Option<f64>; RawFeatures::COUNT]> =
            self.extractors.iter().map(|x| x.features().values()).collect();
        std::array::from_fn(|k| {
            let values: Option<Vec<f64>> = all.iter().map(|v| v[k]).collect();
            let Some(v) = values else { return (None, 0.0) };
            let mean = v.iter().sum::<f64>() / v.len() as f64;
            let var = v.iter().map(|x| (x - mean) * (x - mean)).sum::<f64>() / (v.len().max(2) - 1) as f64;
            (Some(mean), var.sqrt())
        })
    }
}
