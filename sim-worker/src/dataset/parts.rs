//! A plan cut into parts: what one worker does at a time, the same whatever the number of shards.

use super::draw::{random, seed};
use super::plan::DatasetPlan;
use super::wear::{WornTest, warmed};
use crate::simulate::{LANES, Run};
use crate::test_bench::Lane;
use rand::RngExt;
use schemas::fault::FaultState;
use std::ops::Range;

/// Bytes of telemetry of a part before it is encoded, at most, unless a single run has more.
const PART_BYTES: u64 = 256 << 20;

/// Runs of a part of a single actuator, at most: the grid of one would otherwise be one part, lost as a whole when
/// work is interrupted. Fleets are cut by their actuators.
const PART_RUNS: usize = 4 * LANES;

/// What a run is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// a point of the fault grid
    Map,
    /// a random fault pair or a test of a life, to check diagnoses by
    Test,
}

impl Kind {
    /// In tables.
    pub fn name(self) -> &'static str {
        match self {
            Kind::Map => "map",
            Kind::Test => "test",
        }
    }
}

/// Consecutive runs of one actuator through one sequence from one rest angle, of one kind.
#[derive(Clone, Debug, PartialEq)]
pub struct Part {
    /// place of the part in [`DatasetPlan::parts`]
    pub number: usize,
    /// its place in [`DatasetPlan::actuators`]
    pub actuator: usize,
    /// its place in [`DatasetPlan::sequences`]
    pub sequence: usize,
    /// its place in [`DatasetPlan::rest_angles_rad`]
    pub rest: usize,
    /// points of the grid, or tests
    pub kind: Kind,
    /// numbers in the whole dataset
    pub runs: Range<u64>,
    /// number of the first run of the same kind
    first: u64,
    /// whether its telemetry is kept
    pub telemetry: bool,
    /// which of the telemetry files of its actuator and sequence
    pub file: usize,
}

impl DatasetPlan {
    /// Runs of each actuator.
    pub fn runs_per_actuator(&self) -> u64 {
        self.groups().map(|g| g.3 as u64).sum()
    }

    /// Runs of all actuators.
    pub fn runs(&self) -> u64 {
        self.runs_per_actuator() * self.actuators.len() as u64
    }

    /// Samples of a run through a sequence, at the rate of the features.
    pub fn rows(&self, sequence: usize) -> u64 {
        (self.sequences[sequence].duration_s() * self.rate_hz + 1e-6).floor() as u64
    }

    /// Bytes that a run with telemetry holds while it is simulated, its noise included.
    pub(super) fn run_bytes(&self, sequence: usize) -> u64 {
        let Some(t) = &self.telemetry else { return 0 };
        let value = if self.sensors.is_some() { 4 } else { 8 };
        let noise = if self.sensors.is_some() { 16 } else { 0 };
        self.rows(sequence) / t.every * (t.stored.iter().count() as u64 * value + noise)
    }

    /// Sequence, rest angle, kind and number of runs of the groups that every actuator has.
    fn groups(&self) -> impl Iterator<Item = (usize, usize, Kind, usize)> {
        let points = self.grid.fsj.len() * self.grid.zeta.len();
        let angles = self.rest_angles_rad.len();
        let map = (0..self.sequences.len()).flat_map(move |s| (0..angles).map(move |r| (s, r, Kind::Map, points)));
        // tests are of the first sequence, from the first rest angle
        map.chain((self.tests_per_actuator > 0).then_some((0, 0, Kind::Test, self.tests_per_actuator)))
    }

    /// Runs that are simulated side by side.
    pub fn lanes(&self, part: &Part) -> usize {
        let bytes = if part.telemetry {
            self.run_bytes(part.sequence)
        } else {
            0
        };
        (PART_BYTES / bytes.max(1)).clamp(1, LANES as u64) as usize
    }

    fn keeps(&self, kind: Kind) -> bool {
        let kept = |of: (bool, bool)| if kind == Kind::Map { of.0 } else { of.1 };
        self.telemetry.as_ref().is_some_and(|t| kept(t.of))
    }

    /// Most runs of a part of a group of `runs`.
    fn most(&self, sequence: usize, kind: Kind, runs: usize) -> usize {
        let bytes = if self.keeps(kind) { self.run_bytes(sequence) } else { 0 };
        let runs = if self.actuators.len() == 1 {
            runs.min(PART_RUNS)
        } else {
            runs
        };
        match (PART_BYTES / bytes.max(1)) as usize {
            n if n >= runs => runs.max(1),
            n if n > LANES => n / LANES * LANES,
            n => n.max(1),
        }
    }

    /// Parts of each actuator.
    pub(super) fn parts_per_actuator(&self) -> u64 {
        let of = |(sequence, _, kind, runs): (usize, usize, Kind, usize)| {
            runs.div_ceil(self.most(sequence, kind, runs)) as u64
        };
        self.groups().map(of).sum()
    }

    /// All parts in order: actuator, then sequence, rest angle and kind.
    pub fn parts(&self) -> Vec<Part> {
        let mut parts = Vec::new();
        let mut next = 0;
        for actuator in 0..self.actuators.len() {
            let mut files = vec![0; self.sequences.len()];
            for (sequence, rest, kind, runs) in self.groups() {
                let telemetry = self.keeps(kind);
                let most = self.most(sequence, kind, runs);
                let first = next;
                for from in (0..runs).step_by(most) {
                    let to = (from + most).min(runs);
                    parts.push(Part {
                        number: parts.len(),
                        actuator,
                        sequence,
                        rest,
                        kind,
                        runs: first + from as u64..first + to as u64,
                        first,
                        telemetry,
                        file: files[sequence],
                    });
                    files[sequence] += usize::from(telemetry);
                }
                next += runs as u64;
            }
        }
        parts
    }

    /// A part in words.
    pub fn describe_part(&self, part: &Part) -> String {
        let angle = self.rest_angles_rad[part.rest].to_degrees();
        format!(
            "runs {} to {} of actuator {}, {} from {angle:.1} deg, kind {}",
            part.runs.start,
            part.runs.end - 1,
            self.actuators[part.actuator].id,
            self.sequences[part.sequence].name,
            part.kind.name()
        )
    }

    /// The fault pair of a run of a part.
    pub fn fault(&self, part: &Part, run: u64) -> FaultState {
        let k = (run - part.first) as usize;
        let n = self.grid.fsj.len();
        match part.kind {
            Kind::Map => FaultState {
                fsj: self.grid.fsj[k % n],
                zeta: self.grid.zeta[k / n],
            },
            Kind::Test => {
                if let Some(t) = self.worn(part, run) {
                    return t.fault;
                }
                let id = &self.actuators[part.actuator].id;
                let mut rng = random(self.seed, "test", &format!("{id};{k}"));
                let mut within = |axis: &[f64]| match (axis[0], axis[axis.len() - 1]) {
                    (a, b) if a < b => rng.random_range(a..b),
                    (a, _) => a,
                };
                FaultState {
                    fsj: within(&self.grid.fsj),
                    zeta: within(&self.grid.zeta),
                }
            }
        }
    }

    /// The test of a life that a run of a part is.
    pub fn worn(&self, part: &Part, run: u64) -> Option<&WornTest> {
        let life = self.life(part.actuator).filter(|_| part.kind == Kind::Test)?;
        life.tests.get((run - part.first) as usize)
    }

    /// A run of a part, ready to simulate. Its seed does not depend on what else the fleet has.
    pub fn run(&self, part: &Part, run: u64) -> Run {
        let actuator = &self.actuators[part.actuator];
        let of = format!(
            "{};{};{};{};{}",
            actuator.id,
            self.sequences[part.sequence].name,
            part.rest,
            part.kind.name(),
            run - part.first
        );
        Run {
            number: run,
            lane: Lane {
                actuator: warmed(&actuator.parameters, self.worn(part, run).map_or(0.0, |t| t.warmer_k)),
                fault: self.fault(part, run),
                rest_angle_rad: self.rest_angles_rad[part.rest],
                load_n_m: self.load_n_m,
            },
            seed: seed(self.seed, "noise", &of),
        }
    }
}
