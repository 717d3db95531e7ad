//! This machine's speed: time per step of the engine, one run and full lanes, moving and standing.

use schemas::channel::ChannelSet;
use schemas::fault::FaultState;
use schemas::sequence::{Command, Segment, TestSequence};
use sim_worker::command::CommandTrack;
use sim_worker::lanes::InstructionSet;
use sim_worker::monitor::MonitorTrack;
use sim_worker::parameters::ActuatorParameters;
use sim_worker::simulate::LANES;
use sim_worker::test_bench::{Built, Kernel, Lane, NumericalTestBench};
use std::sync::Arc;
use std::time::Instant;

/// Times of one measurement, each the best of a few repetitions.
#[derive(Clone, Copy, Debug)]
pub struct Speed {
    /// one run by itself [ns per step of 1 microsecond]
    pub scalar_ns_per_step: f64,
    /// full lanes, of one run [ns per step]
    pub lanes_ns_per_step_per_run: f64,
    /// runs side by side
    pub lanes: usize,
    /// full lanes at rest, of one run [ns per step]
    pub standstill_lanes_ns_per_step_per_run: f64,
    /// simplified model [ns per simulated microsecond]
    pub sm_ns_per_simulated_us: f64,
    /// as [`InstructionSet::name`] has it
    pub instruction_set: &'static str,
}

/// Nanoseconds per step and run of `N` lanes through `sequence`, the fault pairs spread over the
/// grid; best of `repeat`.
pub fn engine<const N: usize>(sequence: &TestSequence, set: InstructionSet, repeat: usize) -> f64
where
    Kernel: Built<N>,
{
    let actuator = Arc::new(ActuatorParameters::reference());
    let lanes: Vec<Lane> = (0..N)
        .map(|l| Lane {
            actuator: actuator.clone(),
            fault: FaultState {
                fsj: 3.0 + 2.0 * (l as f64 / N as f64 - 0.5),
                zeta: 0.3 - 0.2 * (l as f64 / N as f64),
            },
            rest_angle_rad: 0.0,
            load_n_m: 0.0,
        })
        .collect();
    let steps = (sequence.duration_s() / actuator.step_s).round() as usize;
    let mut com = vec![0.0; steps];
    CommandTrack::new(sequence, actuator.step_s).fill(0, &mut com);
    let mut best = f64::INFINITY;
    for _ in 0..repeat {
        let mut bench = NumericalTestBench::<N>::with_instruction_set(&lanes, ChannelSet::basic(), set);
        let start = Instant::now();
        // as a simulation does: an interval of 10 kHz at a time
        for c in com.chunks(100) {
            bench.advance(c);
            bench.next_interval();
        }
        best = best.min(start.elapsed().as_secs_f64());
        std::hint::black_box(bench.samples(schemas::channel::Channel::ThetaM));
    }
    best * 1e9 / (steps * N) as f64
}

/// One second at rest.
pub fn standstill() -> TestSequence {
    let command = Command::Hold { value_rad: 0.0 };
    TestSequence {
        name: "standstill".into(),
        segments: vec![Segment {
            command,
            start_s: 0.0,
            duration_s: 1.0,
        }],
    }
}

/// Nanoseconds that the simplified model takes for a microsecond of the pre-flight test.
pub fn monitor(repeat: usize) -> f64 {
    let actuator = ActuatorParameters::reference();
    let sequence = sim_worker::catalogue::sequence("preflight").expect("built in");
    let mut best = f64::INFINITY;
    for _ in 0..repeat {
        let start = Instant::now();
        std::hint::black_box(MonitorTrack::run(&actuator, &sequence, 10_000.0));
        best = best.min(start.elapsed().as_secs_f64());
    }
    best * 1e9 / (sequence.duration_s() * 1e6)
}

/// Measures everything, in a few seconds.
pub fn measure() -> Speed {
    let set = InstructionSet::detect();
    let preflight = sim_worker::catalogue::sequence("preflight").expect("built in");
    Speed {
        scalar_ns_per_step: engine::<1>(&preflight, set, 3),
        lanes_ns_per_step_per_run: engine::<LANES>(&preflight, set, 3),
        lanes: LANES,
        standstill_lanes_ns_per_step_per_run: engine::<LANES>(&standstill(), set, 3),
        sm_ns_per_simulated_us: monitor(5),
        instruction_set: set.name(),
    }
}
