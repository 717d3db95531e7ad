//! The numerical test bench in real time, as the device under test: paced by the clock, it waits
//! for nobody.

use crate::replay::sleep_until;
use anyhow::Result;
use schemas::stream::frame::RunDescription;
use schemas::stream::publisher::{Delivery, Pass, Publisher};
use schemas::stream::{Domain, now_ns};
use sim_worker::simulate::{Experiment, LANES, Run, Simulation};
use std::time::Duration;

/// How long the end of a test waits for answers before the frames are given up.
const FAREWELL: Duration = Duration::from_secs(2);

/// What became of one test of all actuators.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Outcome {
    pub frames: u64,
    /// frames that did not reach every subscriber: (actuator, frames)
    pub lost: Vec<(String, u64)>,
    /// frames that nobody was there to receive
    pub unheard: u64,
    /// actuators whose last frame was answered
    pub answered: usize,
    /// frames published more than one frame's duration late, and the worst delay [s]
    pub late: u64,
    pub worst_delay_s: f64,
}

/// Runs one test of several actuators in real time.
///
/// * `names` actuator names, one a run
/// * `rows` samples of a frame
pub fn test(
    publisher: &mut Publisher,
    experiment: &Experiment,
    runs: &[Run],
    names: &[String],
    rows: usize,
    go_on: &(dyn Fn() -> bool + Sync),
) -> Result<Option<Outcome>> {
    let mut groups: Vec<Simulation<'_>> = runs.chunks(LANES).map(|r| Simulation::new(experiment, r)).collect();
    let mut passes: Vec<Pass> = Vec::new();
    for (run, name) in runs.iter().zip(names) {
        let about = RunDescription {
            actuator: name.clone(),
            parameters: run.lane.actuator.fingerprint(),
            sensors: experiment.sensor_fingerprint(),
            sequence: experiment.sequence.fingerprint(),
            run: run.number,
            rate_hz: experiment.rate_hz,
            channels: experiment.channels,
            total_rows: experiment.rows(),
            load_n_m: run.lane.load_n_m,
        };
        let pass = publisher.begin(&about, Duration::ZERO, go_on)?;
        passes.push(pass.expect("a real-time stream begins at once"));
    }
    let period_ns = (rows as f64 / experiment.rate_hz * 1e9) as u64;
    let mut outcome = Outcome::default();
    let start = now_ns();
    let mut done = 0_u64;
    loop {
        let mut n = 0;
        for g in &mut groups {
            n = g.advance(rows);
        }
        if n == 0 {
            break;
        }
        done += n as u64;
        // the last sample of the frame is taken when its interval ends
        let due = start + (done as f64 / experiment.rate_hz * 1e9) as u64;
        sleep_until(due, go_on);
        if !go_on() {
            return Ok(None);
        }
        let mut actuator = 0;
        for g in &groups {
            for lane in 0..g.runs() {
                let pass = &mut passes[actuator];
                let mut frame = publisher.loan(pass, g.first(), n)?;
                g.write(lane, &mut frame.view_mut());
                publisher.publish(pass, frame)?;
                actuator += 1;
                outcome.frames += 1;
            }
        }
        let delay = now_ns().saturating_sub(due);
        outcome.late += u64::from(delay > period_ns);
        outcome.worst_delay_s = outcome.worst_delay_s.max(delay as f64 * 1e-9);
    }
    let farewell = now_ns() + FAREWELL.as_nanos() as u64;
    for (pass, name) in passes.iter().zip(names) {
        let left = Duration::from_nanos(farewell.saturating_sub(now_ns()));
        let ending = publisher.end(pass, left, go_on)?;
        outcome.answered += usize::from(ending.answered > 0);
        outcome.unheard += pass.unheard_frames;
        if pass.lost_frames > 0 {
            outcome.lost.push((name.clone(), pass.lost_frames));
        }
    }
    Ok(Some(outcome))
}

/// Opens the publisher of [`test`]: frames that a late subscriber misses are lost, and counted.
pub fn publisher(domain: &Domain, experiment: &Experiment, rows: usize) -> Result<Publisher> {
    let channels = experiment.channels.iter().count();
    Ok(Publisher::open(domain, Delivery::RealTime, rows, channels)?)
}
