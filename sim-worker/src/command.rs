//! The commanded position, step by step.

use crate::lanes::{self, InstructionSet};
use crate::trig::sin_cos;
use schemas::sequence::{Command, TestSequence};
use std::f64::consts::TAU;

/// A sequence on the grid of steps: segment `i` owns the steps from `starts[i]` to the next start.
#[derive(Clone, Debug)]
pub struct CommandTrack<'a> {
    sequence: &'a TestSequence,
    starts: Vec<u64>,
    dt: f64,
    set: InstructionSet,
}

impl<'a> CommandTrack<'a> {
    /// * `dt` step [s]
    pub fn new(sequence: &'a TestSequence, dt: f64) -> Self {
        let starts = sequence
            .segments
            .iter()
            .map(|s| (s.start_s / dt).round() as u64)
            .collect();
        Self {
            sequence,
            starts,
            dt,
            set: InstructionSet::detect(),
        }
    }

    /// Commands of the steps `from..from + out.len()` [rad]; the last segment goes on for ever.
    pub fn fill(&self, from: u64, out: &mut [f64]) {
        let mut done = 0;
        while done < out.len() {
            let k = from + done as u64;
            let i = self.starts.iter().rposition(|&s| s <= k).unwrap_or(0);
            let end = self.starts.get(i + 1).copied().unwrap_or(u64::MAX);
            let n = (out.len() - done).min((end - k) as usize);
            let segment = &self.sequence.segments[i];
            let part = &mut out[done..done + n];
            let t = |j: usize| (k + j as u64) as f64 * self.dt - segment.start_s;
            match segment.command {
                Command::Ramp { slope_rad_per_s: a } => part.iter_mut().enumerate().for_each(|(j, o)| *o = a * t(j)),
                Command::Line {
                    from_rad: a,
                    slope_rad_per_s: b,
                } => part.iter_mut().enumerate().for_each(|(j, o)| *o = a + b * t(j)),
                Command::Hold { value_rad: a } | Command::Step { height_rad: a } => part.fill(a),
                Command::Sine {
                    amplitude_rad: a,
                    frequency_hz: f,
                } => {
                    part.iter_mut().enumerate().for_each(|(j, o)| *o = TAU * f * t(j));
                    lanes::sines(self.set, a, part);
                }
                Command::Cosine {
                    amplitude_rad: a,
                    frequency_hz: f,
                } => {
                    part.iter_mut()
                        .enumerate()
                        .for_each(|(j, o)| *o = a * sin_cos(TAU * f * t(j)).1);
                }
                Command::Chirp {
                    amplitude_rad: a,
                    from_hz,
                    to_hz,
                } => {
                    let rate = (to_hz - from_hz) / (2.0 * segment.duration_s);
                    part.iter_mut().enumerate().for_each(|(j, o)| {
                        let t = t(j);
                        *o = a * sin_cos(TAU * (from_hz * t + rate * t * t)).0;
                    });
                }
                Command::Multisine {
                    amplitude_rad: a,
                    frequency_hz: f,
                } => {
                    part.iter_mut().enumerate().for_each(|(j, o)| {
                        let t = t(j);
                        *o = (1..=5)
                            .map(|n| n as f64)
                            .map(|n| a / n * sin_cos(TAU * f * n * t + n * n).0)
                            .sum();
                    });
                }
            }
            done += n;
        }
    }
}
