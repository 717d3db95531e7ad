//! What a test is made of: actuator, sequence, sensors and how they are put together.

use crate::extractor::FeaturePlan;
use crate::parameters::ActuatorParameters;
use crate::sensor::SensorModel;
use crate::simulate::Experiment;
use schemas::channel::ChannelSet;
use schemas::error::Result;
use schemas::recording::Provenance;
use schemas::sequence::TestSequence;
use schemas::test_kind::TestKind;
use std::sync::Arc;

/// A test, ready to be simulated or diagnosed; [`TestSetup::kind`] is the same by fingerprints.
#[derive(Clone, Debug)]
pub struct TestSetup {
    /// parameters, with effects
    pub actuator: Arc<ActuatorParameters>,
    /// what it is told to do
    pub sequence: TestSequence,
    /// none: true values
    pub sensors: Option<SensorModel>,
    /// telemetry rate [Hz]
    pub rate_hz: f64,
    /// rotor angle at rest [rad]
    pub rest_angle_rad: f64,
    /// constant load torque [N m, motor side]
    pub load_n_m: f64,
    /// P2 from i_eq, for telemetry without phase currents
    pub equivalent_current: bool,
}

impl TestSetup {
    /// A plain test: no sensors, no load, at rest at 0.
    ///
    /// * `rate_hz` telemetry rate [Hz]
    pub fn new(actuator: Arc<ActuatorParameters>, sequence: TestSequence, rate_hz: f64) -> Self {
        Self {
            actuator,
            sequence,
            sensors: None,
            rate_hz,
            rest_angle_rad: 0.0,
            load_n_m: 0.0,
            equivalent_current: false,
        }
    }

    /// A test of a kind, of these objects; without a load where none is named.
    pub fn of(
        kind: &TestKind,
        actuator: Arc<ActuatorParameters>,
        sequence: TestSequence,
        sensors: Option<SensorModel>,
    ) -> Self {
        Self {
            actuator,
            sequence,
            sensors,
            rate_hz: kind.rate_hz,
            rest_angle_rad: kind.rest_angle_rad,
            load_n_m: kind.load_n_m.unwrap_or(0.0),
            equivalent_current: kind.equivalent_current,
        }
    }

    /// All that maps depend on.
    pub fn kind(&self) -> TestKind {
        TestKind {
            parameters: self.actuator.fingerprint(),
            sequence: self.sequence.fingerprint(),
            sensors: SensorModel::fingerprint_of(self.sensors.as_ref()),
            rate_hz: self.rate_hz,
            rest_angle_rad: self.rest_angle_rad,
            load_n_m: Some(self.load_n_m),
            equivalent_current: self.equivalent_current,
        }
    }

    /// What a file of one simulated run says of itself.
    ///
    /// * `seed` of the sensor noise
    /// * `commit` source revision of the program
    pub fn provenance(&self, seed: u64, commit: &str) -> Provenance {
        let kind = self.kind();
        Provenance {
            actuator: self.actuator.name.clone(),
            parameters: kind.parameters,
            sequence: self.sequence.name.clone(),
            sequence_fingerprint: kind.sequence,
            grid: String::new(),
            sensors: kind.sensors,
            effects: String::new(),
            rate_hz: self.rate_hz,
            step_s: self.actuator.step_s,
            load_n_m: self.load_n_m,
            seed,
            commit: commit.into(),
            model: "ntb".into(),
        }
    }

    /// What features are taken from; runs the simplified model.
    pub fn feature_plan(&self) -> FeaturePlan {
        let sampling = SensorModel::sampling_of(self.sensors.as_ref());
        FeaturePlan::new(
            &self.actuator,
            &self.sequence,
            self.rate_hz,
            self.equivalent_current,
            sampling,
        )
    }

    /// The experiment that simulates it.
    ///
    /// # Errors
    /// A rate that no step can serve.
    pub fn experiment(&self, channels: ChannelSet) -> Result<Experiment> {
        let (sequence, sensors) = (self.sequence.clone(), self.sensors.clone());
        Experiment::new(sequence, self.rate_hz, channels, sensors, self.actuator.step_s)
    }
}
