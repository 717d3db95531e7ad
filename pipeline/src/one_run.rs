//! One run of one actuator, for `ema run` and for Python.

use crate::{COMMIT, Interrupted};
use anyhow::Result;
use clap::ValueEnum;
use schemas::channel::{Channel, ChannelSet};
use schemas::error::Error;
use schemas::fault::FaultState;
use schemas::recording::Provenance;
use schemas::telemetry::{TelemetryHeader, TelemetrySink, TelemetryView};
use sim_worker::monitor::MonitorTrack;
use sim_worker::setup::TestSetup;
use sim_worker::simulate::{Experiment, Run, simulate};
use sim_worker::test_bench::Lane;

/// What is run.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Model {
    /// numerical test bench
    Ntb,
    /// simplified model, healthy actuator only
    Sm,
}

impl Model {
    /// The name in files and on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Ntb => "ntb",
            Self::Sm => "sm",
        }
    }

    /// The model of a name.
    ///
    /// # Errors
    /// Another name.
    pub fn named(name: &str) -> Result<Self> {
        let found = [Self::Ntb, Self::Sm].into_iter().find(|m| m.name() == name);
        Ok(found.ok_or_else(|| Error::bad("arguments", "model", name, "ntb or sm"))?)
    }
}

/// A run that can be made.
pub struct OneRun {
    setup: TestSetup,
    fault: FaultState,
    model: Model,
    seed: u64,
    experiment: Experiment,
    /// what the samples hold
    pub channels: ChannelSet,
}

impl OneRun {
    /// * `seed` of the sensor noise
    /// * `channels` beside the basic ones, by name
    ///
    /// # Errors
    /// A channel that is not known; of the simplified model a fault, a load or sensors; else as [`TestSetup::experiment`].
    pub fn new(setup: TestSetup, fault: FaultState, model: Model, seed: u64, channels: &[String]) -> Result<Self> {
        let mut channels = sim_worker::catalogue::channels(channels)?;
        let experiment = setup.experiment(channels)?;
        if model == Model::Sm {
            if fault != FaultState::NOMINAL || setup.load_n_m != 0.0 || experiment.sensors.is_some() {
                let sensors = setup.sensors.as_ref().map_or("none", |s| s.name.as_str());
                let found = format!(
                    "fsj {}, zeta {}, load {}, sensors {sensors}",
                    fault.fsj, fault.zeta, setup.load_n_m
                );
                let allowed =
                    "fsj 1, zeta 0, load 0, sensors none: the simplified model knows the healthy actuator only";
                return Err(Error::bad("arguments", "model sm", found, allowed).into());
            }
            use Channel::*;
            channels = ChannelSet::of([Com, ThetaU, ThetaM, OmegaM, IEq, TorqueM]);
        }
        Ok(Self {
            setup,
            fault,
            model,
            seed,
            experiment,
            channels,
        })
    }

    /// Whether values are those of sensors, and so in single precision.
    pub fn is_sensed(&self) -> bool {
        self.experiment.sensors.is_some()
    }

    /// What made the samples.
    pub fn provenance(&self) -> Provenance {
        Provenance {
            model: self.model.name().into(),
            ..self.setup.provenance(self.seed, COMMIT)
        }
    }

    /// Makes the run.
    ///
    /// * `go_on` asked again and again; false ends it
    ///
    /// # Errors
    /// [`Interrupted`]; what `sink` refuses.
    pub fn simulate_into<S: TelemetrySink + Send>(&self, sink: &mut S, go_on: impl Fn() -> bool + Sync) -> Result<()> {
        let setup = &self.setup;
        if self.model == Model::Ntb {
            let lane = Lane {
                actuator: setup.actuator.clone(),
                fault: self.fault,
                rest_angle_rad: setup.rest_angle_rad,
                load_n_m: setup.load_n_m,
            };
            let run = Run {
                number: 0,
                lane,
                seed: self.seed,
            };
            let done = simulate(&self.experiment, &[run], std::slice::from_mut(sink), go_on)?;
            return done.map(drop).ok_or_else(|| Interrupted.into());
        }
        let e = &self.experiment;
        let track = MonitorTrack::run(&setup.actuator, &e.sequence, e.rate_hz);
        let theta_m: Vec<f64> = track.theta_m_rad.iter().map(|x| x + setup.rest_angle_rad).collect();
        let view = TelemetryView::new(1, track.com_rad.len())
            .with(Channel::Com, &track.com_rad)
            .with(Channel::ThetaU, &track.theta_u_rad)
            .with(Channel::ThetaM, &theta_m)
            .with(Channel::OmegaM, &track.omega_rad_per_s)
            .with(Channel::IEq, &track.abs_current_a)
            .with(Channel::TorqueM, &track.torque_n_m);
        let provenance = self.provenance();
        let header = TelemetryHeader {
            run: 0,
            actuator: provenance.actuator,
            parameters: provenance.parameters,
            sensors: "none".into(),
            sequence: provenance.sequence,
            rate_hz: e.rate_hz,
            channels: self.channels,
            fault: Some(self.fault),
            rest_angle_rad: Some(setup.rest_angle_rad),
        };
        Ok(sink.accept(&header, &view)?)
    }
}
