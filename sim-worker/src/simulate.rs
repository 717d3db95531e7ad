//! Runs the numerical test bench through a sequence and pushes telemetry into sinks.

use crate::command::CommandTrack;
use crate::sensor::{CurrentSampling, Sampling, SensorModel, SensorNoise, Sensors};
use crate::test_bench::{Built, Kernel, Lane, NumericalTestBench};
use schemas::channel::{Channel, ChannelSet};
use schemas::error::{Error, Result};
use schemas::sequence::TestSequence;
use schemas::telemetry::{TelemetryBuffer, TelemetryHeader, TelemetrySink, TelemetryView, TelemetryViewMut};
use std::sync::OnceLock;

/// Runs that go side by side.
pub const LANES: usize = 16;

/// Samples handed to a sink at once.
const BLOCK_ROWS: usize = 128;

/// What all runs of a call have in common.
#[derive(Clone, Debug)]
pub struct Experiment {
    /// what all runs are told to do
    pub sequence: TestSequence,
    /// telemetry rate [Hz]
    pub rate_hz: f64,
    /// what is recorded
    pub channels: ChannelSet,
    /// none: true values
    pub sensors: Option<SensorModel>,
    /// what samples are, with sensors or without
    pub sampling: Sampling,
    /// step and the commands of all steps, worked out once for all runs of that step
    commands: OnceLock<(f64, Vec<f64>)>,
}

/// Longest sequence whose commands are kept [steps]: 32 MB.
const KEPT_COMMANDS: u64 = 4_000_000;

impl Experiment {
    /// Refuses a rate that no step or sensor can serve.
    ///
    /// * `step_s` step of the actuators [s]
    ///
    /// # Errors
    /// A rate below 1 Hz, or above one sample a step.
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
            sampling: SensorModel::sampling_of(sensors.as_ref()),
            sensors,
            commands: OnceLock::new(),
        })
    }

    /// The same of samples of another sort.
    pub fn sampled(self, sampling: Sampling) -> Self {
        Self { sampling, ..self }
    }

    /// The same without sensors, with other channels; samples are of the same sort.
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
        SensorModel::fingerprint_of(self.sensors.as_ref())
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
    /// number of the run in its plan, or 0
    pub number: u64,
    /// actuator, faults, rest angle and load
    pub lane: Lane,
    /// seed of the sensor noise
    pub seed: u64,
}

/// Simulates up to [`LANES`] runs side by side; `sinks[i]` gets the telemetry of `runs[i]`.
/// Returns the steps made, or stops early where `go_on` says so.
///
/// * `go_on` asked once a block; `Ok(None)` where it said no
///
/// # Errors
/// What a sink refuses.
///
/// # Panics
/// With more than [`LANES`] runs, or with more or fewer sinks than runs.
pub fn simulate<S: TelemetrySink>(
    experiment: &Experiment,
    runs: &[Run],
    sinks: &mut [S],
    go_on: impl Fn() -> bool,
) -> Result<Option<u64>> {
    let mut sinks: Vec<&mut dyn TelemetrySink> = sinks.iter_mut().map(|s| s as _).collect();
    simulate_into(experiment, runs, &mut sinks, &go_on)
}

/// [`simulate`], compiled once.
fn simulate_into(
    experiment: &Experiment,
    runs: &[Run],
    sinks: &mut [&mut dyn TelemetrySink],
    go_on: &dyn Fn() -> bool,
) -> Result<Option<u64>> {
    assert!(runs.len() <= LANES && runs.len() == sinks.len());
    // two single runs take less time than more lanes of which two are used
    let together = if runs.len() <= 2 { 1 } else { LANES };
    let mut steps = 0;
    for (runs, sinks) in runs.chunks(together).zip(sinks.chunks_mut(together)) {
        let headers: Vec<TelemetryHeader> = runs.iter().map(|r| experiment.header(r)).collect();
        let mut simulation = Simulation::new(experiment, runs);
        let mut buffer = TelemetryBuffer::new(experiment.channels, BLOCK_ROWS);
        loop {
            let rows = simulation.advance(BLOCK_ROWS);
            if rows == 0 {
                break;
            }
            if !go_on() {
                return Ok(None);
            }
            for l in 0..runs.len() {
                simulation.write(l, &mut buffer.view_mut(simulation.first(), rows));
                check_finite(&runs[l], experiment, &buffer.view())?;
                sinks[l].accept(&headers[l], &buffer.view())?;
            }
        }
        steps += simulation.steps() * runs.len() as u64;
    }
    Ok(Some(steps))
}

/// Parameters may each be allowed and together be more than the step can follow: such a run ends at its first value
/// that is no number.
fn check_finite(run: &Run, experiment: &Experiment, view: &TelemetryView<'_>) -> Result<()> {
    // no simulator gives the winding temperature
    let given = experiment.channels.iter().filter(|c| *c != Channel::Temperature);
    for (channel, values) in given.filter_map(|c| Some((c, view.column(c)?))) {
        if let Some(i) = values.iter().position(|x| !x.is_finite()) {
            let time_s = (view.first + i as u64) as f64 / experiment.rate_hz;
            let place = format!(
                "{} at {time_s} s, FSJ {}, zeta {}",
                channel.name(),
                run.lane.fault.fsj,
                run.lane.fault.zeta
            );
            let allowed = "finite values: parameters too extreme for the model, or a step_s too long for them";
            return Err(Error::bad(
                format!("actuator `{}`", run.lane.actuator.name),
                place,
                values[i],
                allowed,
            ));
        }
    }
    Ok(())
}

/// Up to [`LANES`] runs that are simulated block by block; whoever asks for a block says where its
/// columns lie.
pub struct Simulation<'a> {
    runs: usize,
    lanes: Box<dyn Blocks + Send + 'a>,
}

impl<'a> Simulation<'a> {
    /// All runs at rest, on the fewest lanes that hold them.
    ///
    /// # Panics
    /// If there are none, more than [`LANES`], or they have different steps.
    pub fn new(experiment: &'a Experiment, runs: &[Run]) -> Self {
        let lanes: Box<dyn Blocks + Send + 'a> = match runs.len() {
            1 => Box::new(SideBySide::<1>::new(experiment, runs)),
            // the last block of a plan is seldom full
            n if n <= LANES / 2 => Box::new(SideBySide::<{ LANES / 2 }>::new(experiment, runs)),
            n => {
                assert!(n <= LANES, "{n} runs side by side");
                Box::new(SideBySide::<LANES>::new(experiment, runs))
            }
        };
        Self {
            runs: runs.len(),
            lanes,
        }
    }

    /// Runs side by side.
    pub fn runs(&self) -> usize {
        self.runs
    }

    /// Simulates the next samples, at most `rows`; returns how many, 0 at the end of the sequence.
    pub fn advance(&mut self, rows: usize) -> usize {
        self.lanes.advance(rows)
    }

    /// Number of the first sample of the block that was simulated last.
    pub fn first(&self) -> u64 {
        self.lanes.first()
    }

    /// Steps done by each run.
    pub fn steps(&self) -> u64 {
        self.lanes.steps()
    }

    /// Writes the last block of run `run`, as its sensors see it, into `out`.
    pub fn write(&self, run: usize, out: &mut TelemetryViewMut<'_>) {
        self.lanes.write(run, out);
    }
}

/// [`SideBySide`] of any number of lanes; asked once a block, so that the choice costs nothing.
trait Blocks {
    fn advance(&mut self, rows: usize) -> usize;
    fn first(&self) -> u64;
    fn steps(&self) -> u64;
    fn write(&self, lane: usize, out: &mut TelemetryViewMut<'_>);
}

/// A simulation on N lanes.
struct SideBySide<'a, const N: usize> {
    experiment: &'a Experiment,
    lanes: Vec<Lane>,
    bench: NumericalTestBench<N>,
    track: CommandTrack<'a>,
    noise: Option<Vec<SensorNoise>>,
    channels: Vec<Channel>,
    /// samples of a block by channel, row and lane: turned into columns of a run by `write`
    block: Vec<Vec<[f64; N]>>,
    own: Vec<f64>,
    dt: f64,
    rows: u64,
    row: u64,
}

impl<'a, const N: usize> SideBySide<'a, N>
where
    Kernel: Built<N>,
{
    fn new(experiment: &'a Experiment, runs: &[Run]) -> Self {
        let lanes: Vec<Lane> = runs.iter().map(|r| r.lane.clone()).collect();
        let dt = lanes[0].actuator.step_s;
        let rows = experiment.rows();
        let noise = |_: &SensorModel| runs.iter().map(|r| SensorNoise::new(r.seed, rows as usize)).collect();
        let channels: Vec<Channel> = experiment.channels.iter().collect();
        let simulation = Self {
            bench: NumericalTestBench::new(&lanes, experiment.channels),
            track: CommandTrack::new(&experiment.sequence, dt),
            noise: experiment.sensors.as_ref().map(noise),
            block: vec![Vec::with_capacity(BLOCK_ROWS); channels.len()],
            own: Vec::new(),
            row: 0,
            experiment,
            lanes,
            channels,
            dt,
            rows,
        };
        simulation.keep_commands();
        simulation
    }

    /// Steps from the start to the end of sample `row`.
    fn steps_to(&self, row: u64) -> u64 {
        (row as f64 / (self.experiment.rate_hz * self.dt)).round() as u64
    }

    fn keep_commands(&self) {
        let steps = self.steps_to(self.rows);
        if steps <= KEPT_COMMANDS {
            self.experiment.commands.get_or_init(|| {
                let mut all = vec![0.0; steps as usize];
                self.track.fill(0, &mut all);
                (self.dt, all)
            });
        }
    }
}

impl<const N: usize> Blocks for SideBySide<'_, N>
where
    Kernel: Built<N>,
{
    fn advance(&mut self, rows: usize) -> usize {
        self.block.iter_mut().for_each(Vec::clear);
        let rows = (rows as u64).min(self.rows - self.row) as usize;
        let kept = self.experiment.commands.get().filter(|(step, _)| *step == self.dt);
        for row in self.row + 1..=self.row + rows as u64 {
            // sample `row` is of the interval that ends at row / rate
            let (from, to) = (self.bench.step(), self.steps_to(row));
            let com = match kept {
                Some((_, all)) => &all[from as usize..to as usize],
                None => {
                    self.own.resize((to - from) as usize, 0.0);
                    self.track.fill(from, &mut self.own);
                    &self.own
                }
            };
            let last = com[com.len() - 1];
            let points = self.experiment.sampling.currents == CurrentSampling::Point;
            if points {
                self.bench.advance_to_points(com);
            } else {
                self.bench.advance(com);
            }
            for (c, rows) in self.channels.iter().zip(&mut self.block) {
                rows.push(match *c {
                    Channel::Com => [last; N],
                    c if points => self.bench.points(c),
                    c => self.bench.samples(c),
                });
            }
            self.bench.next_interval();
        }
        self.row += rows as u64;
        rows
    }

    fn first(&self) -> u64 {
        self.row + 1 - self.block.first().map_or(0, Vec::len) as u64
    }

    fn steps(&self) -> u64 {
        self.bench.step()
    }

    fn write(&self, lane: usize, out: &mut TelemetryViewMut<'_>) {
        for (c, rows) in self.channels.iter().zip(&self.block) {
            if let Some(column) = out.column_mut(*c) {
                for (o, r) in column.iter_mut().zip(rows) {
                    *o = r[lane];
                }
            }
        }
        if let (Some(model), Some(noise)) = (&self.experiment.sensors, &self.noise) {
            let sensors = Sensors {
                model,
                noise: &noise[lane],
                gear_ratio: self.lanes[lane].actuator.gear_ratio,
                rest_angle_rad: self.lanes[lane].rest_angle_rad,
            };
            sensors.apply(out);
        }
    }
}
