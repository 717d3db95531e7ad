//! Laws that the numerical test bench must obey, whatever the parameters.

use ema_tests::relative_rms;
use proptest::prelude::*;
use schemas::channel::{Channel, ChannelSet};
use schemas::fault::FaultState;
use schemas::sequence::{Command, Segment, TestSequence};
use schemas::telemetry::Collector;
use sim_worker::command::CommandTrack;
use sim_worker::lanes::InstructionSet;
use sim_worker::parameters::ActuatorParameters;
use sim_worker::plant::{friction, mechanics, windings};
use sim_worker::simulate::{Experiment, Run, simulate};
use sim_worker::test_bench::{Built, Kernel, Lane, NumericalTestBench};
use std::sync::Arc;

fn all_channels() -> ChannelSet {
    ChannelSet::of(Channel::ALL.iter().copied().filter(|c| *c != Channel::Temperature))
}

fn sine(amplitude_rad: f64, frequency_hz: f64, duration_s: f64) -> TestSequence {
    let command = Command::Sine {
        amplitude_rad,
        frequency_hz,
    };
    TestSequence {
        name: "sine".into(),
        segments: vec![Segment {
            command,
            start_s: 0.0,
            duration_s,
        }],
    }
}

fn lane(p: &Arc<ActuatorParameters>, fsj: f64, zeta: f64, rest: f64, load: f64) -> Lane {
    Lane {
        actuator: p.clone(),
        fault: FaultState { fsj, zeta },
        rest_angle_rad: rest,
        load_n_m: load,
    }
}

fn run_one(l: Lane, s: &TestSequence, rate: f64, channels: ChannelSet) -> Collector {
    let e = Experiment::new(s.clone(), rate, channels, None, l.actuator.step_s).unwrap();
    let mut out = [Collector::default()];
    let run = Run {
        number: 0,
        lane: l,
        seed: 0,
    };
    simulate(&e, &[run], &mut out, || true).unwrap();
    let [c] = out;
    c
}

/// All lanes' state in bits after a sequence.
fn bits<const N: usize>(lanes: &[Lane], s: &TestSequence, set: InstructionSet, channels: ChannelSet) -> Vec<[u64; 4]>
where
    Kernel: Built<N>,
{
    let dt = lanes[0].actuator.step_s;
    let mut com = vec![0.0; (s.duration_s() / dt).round() as usize];
    CommandTrack::new(s, dt).fill(0, &mut com);
    let mut b = NumericalTestBench::<N>::with_instruction_set(lanes, channels, set);
    b.advance(&com);
    let v = [Channel::ThetaM, Channel::OmegaM, Channel::IA, Channel::IEq].map(|c| b.samples(c));
    (0..lanes.len())
        .map(|l| [0, 1, 2, 3].map(|c| v[c][l].to_bits()))
        .collect()
}

#[test]
fn prop_lane_count_and_instruction_set_change_no_bit() {
    let p = Arc::new(ActuatorParameters::reference());
    // steps against the end stop, so that every kernel is used
    let command = |value_rad, start_s, duration_s| Segment {
        command: Command::Hold { value_rad },
        start_s,
        duration_s,
    };
    let s = TestSequence {
        name: "x".into(),
        segments: vec![command(0.03, 0.0, 0.03), command(-0.002, 0.03, 0.02)],
    };
    let mut stop = (*p).clone();
    stop.end_stop_rad = 0.02;
    let stop = Arc::new(stop);
    for q in [&p, &stop] {
        let lanes: Vec<Lane> = (0..13)
            .map(|i| lane(q, 1.0 + 0.3 * i as f64, 0.04 * (i % 11) as f64, 0.37 * i as f64, 0.0))
            .collect();
        let truth: Vec<[u64; 4]> = lanes
            .iter()
            .map(|l| {
                bits::<1>(
                    std::slice::from_ref(l),
                    &s,
                    InstructionSet::BASELINE,
                    ChannelSet::basic(),
                )[0]
            })
            .collect();
        for set in InstructionSet::available() {
            let basic = ChannelSet::basic();
            assert_eq!(bits::<16>(&lanes, &s, set, basic), truth, "16 lanes {}", set.name());
            assert_eq!(
                bits::<8>(&lanes[..7], &s, set, basic),
                truth[..7],
                "8 lanes {}",
                set.name()
            );
            assert_eq!(
                bits::<16>(&lanes, &s, set, all_channels()),
                truth,
                "all terms {}",
                set.name()
            );
            assert_eq!(
                bits::<1>(&lanes[3..4], &s, set, all_channels())[0],
                truth[3],
                "one lane {}",
                set.name()
            );
        }
    }
    // different actuators side by side
    let mixed: Vec<Lane> = (0..5)
        .map(|i| lane(if i % 2 == 0 { &p } else { &stop }, 2.0, 0.1, i as f64, 0.0))
        .collect();
    for (i, l) in mixed.iter().enumerate() {
        let one = bits::<1>(
            std::slice::from_ref(l),
            &s,
            InstructionSet::detect(),
            ChannelSet::basic(),
        );
        assert_eq!(
            bits::<16>(&mixed, &s, InstructionSet::detect(), ChannelSet::basic())[i],
            one[0]
        );
    }
}

#[test]
fn prop_terms_at_zero_are_absent_and_otherwise_felt() {
    let p = Arc::new(ActuatorParameters::reference());
    let s = sine(0.001, 20.0, 0.06);
    let plain = run_one(lane(&p, 2.0, 0.2, 0.4, 0.0), &s, 1e4, ChannelSet::basic());
    // efficiencies without load: the kernel with all terms
    let mut lossy = (*p).clone();
    lossy.opposing_efficiency = 0.8;
    lossy.aiding_efficiency = 0.7;
    let lossy = Arc::new(lossy);
    let unloaded = run_one(lane(&lossy, 2.0, 0.2, 0.4, 0.0), &s, 1e4, all_channels());
    for c in ChannelSet::basic().iter() {
        let (a, b) = (plain.column(c).unwrap(), unloaded.column(c).unwrap());
        assert!(a.iter().zip(b).all(|(a, b)| a.to_bits() == b.to_bits()), "{}", c.name());
    }
    let loaded = run_one(lane(&p, 2.0, 0.2, 0.4, 0.05), &s, 1e4, all_channels());
    let both = run_one(lane(&lossy, 2.0, 0.2, 0.4, 0.05), &s, 1e4, all_channels());
    let i = |c: &Collector| c.column(Channel::IEq).unwrap().to_vec();
    assert!(relative_rms(&i(&plain), &i(&loaded)) > 0.05);
    assert!(relative_rms(&i(&loaded), &i(&both)) > 0.005);
}

#[test]
fn prop_sampling_changes_no_bit_of_the_physics() {
    let p = Arc::new(ActuatorParameters::reference());
    let s = sine(0.001, 20.0, 0.05);
    let slow = run_one(lane(&p, 1.5, 0.3, 0.0, 0.0), &s, 1000.0, ChannelSet::basic());
    let fast = run_one(lane(&p, 1.5, 0.3, 0.0, 0.0), &s, 10_000.0, ChannelSet::basic());
    let (a, b) = (
        slow.column(Channel::ThetaM).unwrap(),
        fast.column(Channel::ThetaM).unwrap(),
    );
    assert!(
        a.iter()
            .enumerate()
            .all(|(i, x)| x.to_bits() == b[10 * i + 9].to_bits())
    );
}

#[test]
fn prop_energy_balance() {
    // what the bridge delivers = copper loss + friction and viscous loss + stored energy, to the
    // order of the step
    let p = Arc::new(ActuatorParameters::reference());
    let s = TestSequence {
        name: "step".into(),
        segments: vec![Segment {
            command: Command::Step { height_rad: 1.0 },
            start_s: 0.0,
            duration_s: 0.05,
        }],
    };
    for (fsj, zeta) in [(1.0, 0.0), (3.0, 0.3)] {
        let c = run_one(lane(&p, fsj, zeta, 0.2, 0.0), &s, 1e6, all_channels());
        let dt = 1e-6;
        let get = |ch| c.column(ch).unwrap();
        let (w, tm) = (get(Channel::OmegaM), get(Channel::TorqueM));
        let (ia, ib, ic) = (get(Channel::IA), get(Channel::IB), get(Channel::IC));
        let (va, vb, vc) = (get(Channel::VA), get(Channel::VB), get(Channel::VC));
        let supply = get(Channel::ISupply);
        let n = w.len();
        let (mut e_in, mut e_bus, mut copper, mut shaft, mut viscous, mut dry) = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0);
        for k in 1..n {
            // currents in the middle of the step, speed at its ends
            let i = [
                0.5 * (ia[k] + ia[k - 1]),
                0.5 * (ib[k] + ib[k - 1]),
                0.5 * (ic[k] + ic[k - 1]),
            ];
            e_in += dt * (va[k] * i[0] + vb[k] * i[1] + vc[k] * i[2]);
            e_bus += dt * 48.0 * supply[k];
            copper += dt * 1.065 * i.iter().map(|x| x * x).sum::<f64>();
            let wm = 0.5 * (w[k] + w[k - 1]);
            shaft += dt * tm[k] * wm;
            viscous += dt * 3e-5 * w[k - 1] * wm;
            if w[k] != 0.0 {
                dry += dt * 0.021 * fsj * wm.abs();
            }
        }
        let kinetic = 0.5 * 2.5e-5 * w[n - 1] * w[n - 1];
        let magnetic = 0.5 * 360e-6 * (ia[n - 1].powi(2) + ib[n - 1].powi(2) + ic[n - 1].powi(2));
        let electrical = (e_in - copper - shaft - magnetic) / e_in;
        let mechanical = (shaft - viscous - dry - kinetic) / shaft;
        println!("FSJ {fsj}, zeta {zeta}: electrical residual {electrical:.1e}, mechanical {mechanical:.1e}");
        assert!(electrical.abs() < 5e-3, "{electrical}");
        assert!(mechanical.abs() < 1e-3, "{mechanical}");
        assert!((e_bus / e_in - 1.0).abs() < 5e-3, "{e_bus} {e_in}");
    }
}

#[test]
fn prop_phase_symmetry() {
    // a rest angle of 120 degrees permutes the phases and changes nothing else, eccentricity included
    let p = Arc::new(ActuatorParameters::reference());
    let s = sine(0.001, 20.0, 0.05);
    let third = std::f64::consts::TAU / 3.0;
    let a = run_one(lane(&p, 2.0, 0.3, 0.1, 0.0), &s, 1e4, ChannelSet::basic());
    let b = run_one(lane(&p, 2.0, 0.3, 0.1 + third, 0.0), &s, 1e4, ChannelSet::basic());
    // relays start at +1 in all phases, so the symmetry is exact but for rounding
    for (x, y) in [
        (Channel::OmegaM, Channel::OmegaM),
        (Channel::IEq, Channel::IEq),
        (Channel::IB, Channel::IA),
        (Channel::IC, Channel::IB),
        (Channel::IA, Channel::IC),
    ] {
        let e = relative_rms(a.column(x).unwrap(), b.column(y).unwrap());
        assert!(e < 1e-6, "{} {} {e:e}", x.name(), y.name());
    }
}

#[test]
fn prop_mirror_symmetry_of_direction() {
    // the mirrored rotor (theta -> -theta, phases 1 and 2 swapped) under the mirrored command:
    // speeds and currents change sign. The relays all start at +1, which is not symmetric: the
    // runs agree as trajectories, not step by step.
    let p = Arc::new(ActuatorParameters::reference());
    let up = run_one(
        lane(&p, 2.0, 0.2, 0.0, 0.0),
        &sine(0.001, 10.0, 0.1),
        1000.0,
        ChannelSet::basic(),
    );
    let down = run_one(
        lane(&p, 2.0, 0.2, 0.0, 0.0),
        &sine(-0.001, 10.0, 0.1),
        1000.0,
        ChannelSet::basic(),
    );
    let minus = |c: &Collector, ch| c.column(ch).unwrap().iter().map(|x| -x).collect::<Vec<f64>>();
    let speed = relative_rms(up.column(Channel::OmegaM).unwrap(), &minus(&down, Channel::OmegaM));
    let position = relative_rms(up.column(Channel::ThetaU).unwrap(), &minus(&down, Channel::ThetaU));
    let current = relative_rms(up.column(Channel::IEq).unwrap(), down.column(Channel::IEq).unwrap());
    println!("mirror: speed {speed:.1e}, position {position:.1e}, current {current:.1e}");
    assert!(
        speed < 0.01 && position < 0.003 && current < 0.03,
        "{speed} {position} {current}"
    );
}

#[test]
fn prop_windings_and_mechanics_converge_with_prescribed_switching() {
    // both halves of the plant with switching and torque prescribed in time: first order in the step
    let run = |dt: f64| {
        let (r, l, j, c) = (1.065, 360e-6, 2.5e-5, 3e-5);
        let steps = (2e-3 / dt).round() as usize;
        let (mut i, mut w) = ([0.0, 0.0], 0.0);
        for k in 0..steps {
            let t = k as f64 * dt;
            // switching instants on every grid of steps
            let s = |f: f64| {
                if ((t * f + 1e-6) as u64).is_multiple_of(2) {
                    24.0
                } else {
                    -24.0
                }
            };
            let v = [s(2500.0), s(1250.0), s(625.0)].map(|v| v * dt / l);
            i = windings::step(
                i,
                v,
                [0.03 * dt / l, -0.01 * dt / l, -0.02 * dt / l],
                w,
                1.0 - r * dt / l,
            );
            let drive = 0.05 * i[0] - 0.03 * i[1];
            w = mechanics::speed::<false>(w, dt / j * friction::net_torque::<false>(drive, c * w, w, 0.03, 0.021));
        }
        (i[0], w)
    };
    let truth = run(1e-8);
    let error = |dt| {
        let (i, w) = run(dt);
        ((i - truth.0).abs() / truth.0.abs(), (w - truth.1).abs() / truth.1.abs())
    };
    let (coarse, fine) = (error(4e-6), error(1e-6));
    println!("errors at 4 us {coarse:?}, at 1 us {fine:?}");
    assert!(fine.0 < coarse.0 / 2.5 && fine.1 < coarse.1 / 2.5);
}

#[test]
fn prop_a_standing_rotor_has_no_subnormal_state() {
    let p = Arc::new(ActuatorParameters::reference());
    let mut b = NumericalTestBench::<1>::new(&[lane(&p, 1.0, 0.0, 0.0, 0.0)], ChannelSet::basic());
    let com = vec![0.0; 10_000];
    for _ in 0..60 {
        b.next_interval();
        b.advance(&com);
        for c in [Channel::IA, Channel::IB, Channel::IC, Channel::OmegaM] {
            let x = b.samples(c)[0];
            assert!(x == 0.0 || x.abs() > 1e-120, "{} {x:e}", c.name());
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 24, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn prop_states_stay_finite_and_within_limits(
        fsj in 0.0..6.0f64, zeta in 0.0..0.9f64, rest in -10.0..10.0f64, load in -0.3..0.3f64,
        amplitude in -1.5..1.5f64,
    ) {
        let p = Arc::new(ActuatorParameters::reference());
        let command = Command::Step { height_rad: amplitude };
        let s = TestSequence { name: "s".into(), segments: vec![Segment { command, start_s: 0.0, duration_s: 0.02 }] };
        let c = run_one(lane(&p, fsj, zeta, rest, load), &s, 1e4, all_channels());
        for ch in all_channels().iter() {
            prop_assert!(c.column(ch).unwrap().iter().all(|x| x.is_finite()), "{}", ch.name());
        }
        prop_assert!(c.column(Channel::ThetaU).unwrap().iter().all(|x| x.abs() <= 1.2 + 1e-4));
        prop_assert!(c.column(Channel::TorqueM).unwrap().iter().all(|x| x.abs() <= 1.7 + 1e-9));
        let sum = |i: usize| [Channel::IA, Channel::IB, Channel::IC].iter().map(|c2| c.column(*c2).unwrap()[i]).sum::<f64>();
        prop_assert!((0..c.rows()).all(|i| sum(i).abs() < 1e-9));
    }
}
