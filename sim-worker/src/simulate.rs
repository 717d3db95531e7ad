//! Runs the numerical test bench through a sequence and pushes telemetry into sinks.

use crate::command::CommandTrack;
use crate::sensor::{SensorModel, SensorNoise, Sensors};
use crate::test_bench::{Lane, NumericalTestBench};
use schemas::channel::{Channel, ChannelSet};
use schemas::error::{Error, Result};
use schemas::sequence::TestSequence;
use schemas::telemetry::{TelemetryBuffer, TelemetryHeader, TelemetrySink};
use std::sync::OnceLock;

/// Runs that go side by side.
pub const LANES: usize = 16;

/// Samples handed to a sink at once.
const BLOCK_ROWS: usize = 128;

/// What all runs of a call have in common.
#[derive(Clone, Debug)]
pub struct Experiment {
    pub sequence: TestSequence,
    /// telemetry rate [Hz]
    pub rate_hz: f64,
    pub channels: ChannelSet,
    pub sensors: Option<SensorModel>,
    /// step and the commands of all steps, worked out once for all runs of that step
    commands: OnceLock<(f64, Vec<f64>)>,
}

/// Longest sequence whose commands are kept [steps]: 32 MB.
const KEPT_COMMANDS: u64 = 4_000_000;

impl Experiment {
    /// Refuses a rate that no step or sensor can serve.
    pub fn new(
        sequence: TestSequence,
        rate_hz: f64,
        channels: ChannelSet,
        sensors: Option<SensorModel>,
        step_s: f64,
    ) -> Result<Self> {
        let max = 1.0 / step_s;
        if !(rate_hz.is_finite() && rate_hz >= 1.0 && rate_hz <= max * (1.0 + 1e-9)) {
            let allowed = format!("1 to {max} Hz, one sample a step");
            return Err(Error::bad("command line", "rate", rate_hz, allowed));
        }
        Ok(Self {
            sequence,
            rate_hz,
            channels,
            sensors,
            commands: OnceLock::new(),
        })
    }

    /// The same without sensors, with other channels.
    pub fn bare(&self, channels: ChannelSet) -> Self {
        Self {
            sensors: None,
            channels,
            ..self.clone()
        }
    }

    /// Samples of a whole run.
    pub fn rows(&self) -> u64 {
        (self.sequence.duration_s() * self.rate_hz + 1e-6).floor() as u64
    }

    /// Fingerprint of the sensors, or `none`.
    pub fn sensor_fingerprint(&self) -> String {
        self.sensors.as_ref().map_or("none".into(), SensorModel::fingerprint)
    }

    fn header(&self, run: &Run) -> TelemetryHeader {
        TelemetryHeader {
            run: run.number,
            actuator: run.lane.actuator.name.clone(),
            parameters: run.lane.actuator.fingerprint(),
            sensors: self.sensor_fingerprint(),
            sequence: self.sequence.name.clone(),
            rate_hz: self.rate_hz,
            channels: self.channels,
            fault: Some(run.lane.fault),
            rest_angle_rad: Some(run.lane.rest_angle_rad),
        }
    }
}

/// One run.
#[derive(Clone, Debug)]
pub struct Run {
    pub number: u64,
    pub lane: Lane,
    /// seed of the sensor noise
    pub seed: u64,
}

/// Simulates up to [`LANES`] runs side by side; `sinks[i]` gets the telemetry of `runs[i]`.
/// Returns the steps made, or stops early where `go_on` says so.
pub fn simulate<S: TelemetrySink>(
    experiment: &Experiment,
    runs: &[Run],
    sinks: &mut [S],
    go_on: impl Fn() -> bool,
) -> Result<Option<u64>> {
    assert!(runs.len() <= LANES && runs.len() == sinks.len());
    // two single runs take less time than sixteen lanes of which two are used
    if runs.len() <= 2 {
        let mut steps = 0;
        for (run, sink) in runs.iter().zip(sinks) {
            let Some(n) = simulate_lanes::<1, S>(
                experiment,
                std::slice::from_ref(run),
                std::slice::from_mut(sink),
                &go_on,
            )?
            else {
                return Ok(None);
            };
            steps += n;
        }
        return Ok(Some(steps));
    }
    // the last block of a plan is seldom full
    if runs.len() <= LANES / 2 {
        return simulate_lanes::<{ LANES / 2 }, S>(experiment, runs, sinks, &go_on);
    }
    simulate_lanes::<LANES, S>(experiment, runs, sinks, &go_on)
}

/// As [`simulate`], with a given number of lanes.
pub fn simulate_lanes<const N: usize, S: TelemetrySink>(
    experiment: &Experiment,
    runs: &[Run],
    sinks: &mut [S],
    go_on: &impl Fn() -> bool,
) -> Result<Option<u64>> {
    let lanes: Vec<Lane> = runs.iter().map(|r| r.lane.clone()).collect();
    let mut bench = NumericalTestBench::<N>::new(&lanes, experiment.channels);
    let dt = lanes[0].actuator.step_s;
    let track = CommandTrack::new(&experiment.sequence, dt);
    let rows = experiment.rows();
    let headers: Vec<TelemetryHeader> = runs.iter().map(|r| experiment.header(r)).collect();
    let noise: Option<Vec<SensorNoise>> = experiment
        .sensors
        .as_ref()
        .map(|_| runs.iter().map(|r| SensorNoise::new(r.seed, rows as usize)).collect());
    // samples of a block by channel, row and lane: turned into columns of a run when it is full
    let channels: Vec<Channel> = experiment.channels.iter().collect();
    let mut block = vec![Vec::<[f64; N]>::with_capacity(BLOCK_ROWS); channels.len()];
    let mut buffer = TelemetryBuffer::new(experiment.channels, BLOCK_ROWS);
    let mut measured = TelemetryBuffer::new(experiment.channels, BLOCK_ROWS);
    let mut own = Vec::new();
    let steps = (rows as f64 / (experiment.rate_hz * dt)).round() as u64;
    let keep = || {
        let mut all = vec![0.0; steps as usize];
        track.fill(0, &mut all);
        (dt, all)
    };
    let kept = (steps <= KEPT_COMMANDS)
        .then(|| experiment.commands.get_or_init(keep))
        .filter(|(step, _)| *step == dt);
    for row in 1..=rows {
        // sample `row` is of the interval that ends at row / rate
        let end = (row as f64 / (experiment.rate_hz * dt)).round() as u64;
        let com = match kept {
            Some((_, all)) => &all[bench.step() as usize..end as usize],
            None => {
                own.resize((end - bench.step()) as usize, 0.0);
                track.fill(bench.step(), &mut own);
                &own
            }
        };
        bench.advance(com);
        let last = com[com.len() - 1];
        for (c, rows) in channels.iter().zip(&mut block) {
            rows.push(if *c == Channel::Com {
                [last; N]
            } else {
                bench.samples(*c)
            });
        }
        bench.next_interval();
        if block[0].len() == BLOCK_ROWS || row == rows {
            if !go_on() {
                return Ok(None);
            }
            let n = block[0].len();
            for l in 0..runs.len() {
                for (c, rows) in channels.iter().zip(&block) {
                    let column = buffer.column_mut(*c).expect("made with these channels");
                    column.clear();
                    column.extend(rows.iter().map(|r| r[l]));
                }
                buffer.first = row + 1 - n as u64;
                buffer.set_rows(n);
                let view = buffer.view();
                if let (Some(model), Some(noise)) = (&experiment.sensors, &noise) {
                    let lane = &lanes[l];
                    let sensors = Sensors {
                        model,
                        noise: &noise[l],
                        gear_ratio: lane.actuator.gear_ratio,
                        rest_angle_rad: lane.rest_angle_rad,
                    };
                    sensors.measure(&view, &mut measured);
                    sinks[l].accept(&headers[l], &measured.view())?;
                } else {
                    sinks[l].accept(&headers[l], &view)?;
                }
            }
            block.iter_mut().for_each(Vec::clear);
        }
    }
    Ok(Some(bench.step() * runs.len() as u64))
}
