//! What a master may do when, and what it gets.

use super::*;
use schemas::telemetry::Collector;
use sim_worker::effect::{Effect, EffectKind};
use sim_worker::setup::TestSetup;
use sim_worker::simulate::{Run, simulate};

fn actuator() -> ActuatorParameters {
    let mut a = ActuatorParameters::reference();
    a.effects = vec![
        Effect::new(EffectKind::Cogging, &[0.001, 0.3, 12.0]),
        Effect::new(EffectKind::LoadDependentFriction, &[0.1]),
        Effect::new(EffectKind::Presliding, &[200.0, 0.001]),
    ];
    a
}

fn new(a: &ActuatorParameters) -> Instance {
    Instance::new(a.clone(), &guid(a)).unwrap()
}

fn reference(i: &Instance, name: &str) -> u32 {
    i.variables.iter().position(|v| v.name == name).unwrap() as u32
}

fn set(i: &mut Instance, name: &str, x: f64) -> Result<()> {
    let r = reference(i, name);
    i.set_reals(&[r], &[x])
}

fn get(i: &Instance, name: &str) -> f64 {
    i.real(reference(i, name)).unwrap()
}

fn start(i: &mut Instance) {
    i.enter_initialization().unwrap();
    i.exit_initialization().unwrap();
}

fn outputs(i: &Instance) -> Vec<u64> {
    DrivenBench::channels().map(|c| get(i, c.name()).to_bits()).collect()
}

fn refused<T>(r: Result<T>, words: &[&str]) {
    let text = r.err().expect("a refusal").to_string();
    for w in words {
        assert!(text.contains(w), "no `{w}` in: {text}");
    }
}

#[test]
fn prop_a_sequence_gives_the_samples_of_the_program() {
    for a in [ActuatorParameters::reference(), actuator()] {
        let sequence = sim_worker::catalogue::sequence("sine").unwrap();
        let setup = TestSetup::new(a.clone().into(), sequence, 10_000.0);
        let lane = Lane {
            actuator: setup.actuator.clone(),
            fault: FaultState { fsj: 3.0, zeta: 0.3 },
            rest_angle_rad: 0.4,
            load_n_m: 0.02,
        };
        let run = Run {
            number: 0,
            lane,
            seed: 0,
        };
        let all = schemas::ChannelSet::of(DrivenBench::channels());
        let mut sinks = [Collector::default()];
        simulate(&setup.experiment(all).unwrap(), &[run], &mut sinks, || true).unwrap();

        let mut i = new(&a);
        i.setup(7.0, None).unwrap();
        for (name, x) in [("fsj", 3.0), ("zeta", 0.3), ("rest_angle", 0.4), ("load_torque", 0.02)] {
            set(&mut i, name, x).unwrap();
        }
        let r = reference(&i, "sequence");
        i.set_integers(&[r], &[4]).unwrap();
        start(&mut i);
        for k in 0..3000 {
            assert!(!i.step(7.0 + k as f64 * 1e-4, 1e-4).unwrap());
            for c in DrivenBench::channels() {
                let x = sinks[0].column(c).unwrap()[k];
                assert_eq!(get(&i, c.name()).to_bits(), x.to_bits(), "{} {k}", c.name());
            }
        }
    }
}

#[test]
fn prop_a_moment_comes_back_to_the_bit_in_memory_and_in_bytes() {
    let mut i = new(&actuator());
    set(&mut i, "command", 0.3).unwrap();
    set(&mut i, "cogging.amplitude", 0.002).unwrap();
    set(&mut i, "motor.inertia_kg_m2", 3e-5).unwrap();
    start(&mut i);
    let go = |i: &mut Instance| -> Vec<Vec<u64>> {
        (0..100)
            .map(|_| {
                set(i, "load_torque", 0.01).unwrap();
                i.set_derivatives(&[0, 1], &[1, 1], &[2.0, -30.0]).unwrap();
                i.step(i.time_s(), 3.33e-4).unwrap();
                outputs(i)
            })
            .collect()
    };
    go(&mut i);
    set(&mut i, "fsj", 2.5).unwrap();
    let kept = i.moment().clone();
    let bytes = i.bytes(&kept);
    let first = go(&mut i);
    i.go_to(&kept);
    assert_eq!(first, go(&mut i));
    let mut other = new(&actuator());
    other.go_to(&other.moment_of(&bytes).unwrap());
    assert_eq!(first, go(&mut other));
    other.reset();
    assert_eq!(
        other.bytes(other.moment()),
        new(&actuator()).bytes(new(&actuator()).moment())
    );

    for wrong in [&bytes[..10], &bytes[..bytes.len() - 1], &bytes[..bytes.len() - 8], &[]] {
        refused(other.moment_of(wrong), &["state"]);
    }
    let mut nan = bytes.clone();
    nan[46 + 5 * 8..46 + 6 * 8].copy_from_slice(&f64::NAN.to_le_bytes());
    refused(other.moment_of(&nan), &["not allowed"]);
    refused(new(&ActuatorParameters::reference()).moment_of(&bytes), &["guid"]);
}

#[test]
fn prop_inputs_follow_their_derivatives_for_one_step() {
    let mut i = new(&ActuatorParameters::reference());
    start(&mut i);
    i.set_derivatives(&[0, 0, 1], &[1, 2, 1], &[2.0, 100.0, 3.0]).unwrap();
    i.step(0.0, 1e-2).unwrap();
    assert!((get(&i, "command") - 0.025).abs() < 1e-12);
    // of the last step's begin
    assert!((get(&i, "com") - 0.025).abs() < 4e-6 && get(&i, "com") < 0.025);
    assert!((get(&i, "load_torque") - 0.03).abs() < 1e-12);
    i.step(0.01, 1e-2).unwrap();
    assert!((get(&i, "com") - 0.025).abs() < 1e-12);
}

#[test]
fn prop_steps_of_any_length_end_on_the_nearest_step() {
    let mut i = new(&ActuatorParameters::reference());
    i.setup(0.0, Some(1e-3)).unwrap();
    start(&mut i);
    assert!(!i.step(0.0, 2e-6).unwrap());
    assert!(i.step(2e-6, 2.4e-6).unwrap());
    assert!(!i.step(4.4e-6, 2.4e-6).unwrap());
    assert_eq!(i.now.bench.as_ref().unwrap().steps(), 7);
    let t = i.time_s();
    refused(i.step(t, 1e-9), &["communicationStepSize", "1e-6 s"]);
    refused(i.step(t, f64::NAN), &["communicationStepSize"]);
    refused(i.step(t, -1.0), &["communicationStepSize"]);
    refused(i.step(t, 1e300), &["communicationStepSize"]);
    refused(i.step(0.1, 1e-4), &["currentCommunicationPoint", "0.1"]);
    refused(i.step(f64::NAN, 1e-4), &["currentCommunicationPoint"]);
    refused(i.step(t, 0.1), &["stopTime"]);
    assert!(!i.step(t, 1e-3 - t).unwrap());
}

#[test]
fn refuse_what_is_not_allowed() {
    let mut i = new(&actuator());
    refused(Instance::new(actuator(), "{x}").map(|_| ()), &["guid", "{x}"]);
    refused(set(&mut i, "fsj", 9.0), &["fsj", "found 9", "1 to 5"]);
    refused(set(&mut i, "zeta", 0.6), &["zeta", "0 to 0.5"]);
    refused(set(&mut i, "command", f64::NAN), &["command", "NaN", "finite"]);
    refused(set(&mut i, "theta_m", 0.0), &["theta_m", "output"]);
    refused(
        set(&mut i, "cogging.amplitude", -1.0),
        &["cogging.amplitude", "at least 0 N.m"],
    );
    refused(i.real(999), &["value reference", "999"]);
    refused(i.real(2), &["instantiated"]);
    let r = reference(&i, "sequence");
    refused(i.real(r), &["sequence", "fmi2GetInteger"]);
    refused(i.set_integers(&[r], &[9]), &["found 9", "1 external, 2 preflight"]);
    refused(i.set_integers(&[0], &[1]), &["command", "fmi2GetReal"]);
    refused(i.step(0.0, 1e-4), &["fmi2DoStep", "instantiated", "step mode"]);
    refused(i.setup(f64::INFINITY, None), &["startTime"]);
    refused(i.setup(1.0, Some(0.0)), &["stopTime"]);
    // what goes together is known at the end of initialization
    set(&mut i, "motor.phase_resistance_ohm", 1e4).unwrap();
    i.enter_initialization().unwrap();
    refused(i.exit_initialization(), &["step_s", "a tenth of L/R"]);
    set(&mut i, "motor.phase_resistance_ohm", 1.0).unwrap();
    i.exit_initialization().unwrap();
    refused(set(&mut i, "rest_angle", 0.1), &["rest_angle", "step mode"]);
    refused(i.set_derivatives(&[2], &[1], &[0.0]), &["no input"]);
    refused(i.set_derivatives(&[0], &[3], &[0.0]), &["order", "1 or 2"]);
    refused(i.set_derivatives(&[0], &[1], &[f64::NAN]), &["finite"]);
    set(&mut i, "command", 1.7e308).unwrap();
    i.set_derivatives(&[0], &[1], &[1.7e308]).unwrap();
    refused(i.step(0.0, 2.0), &["com at step", "inf"]);
    assert_eq!(i.phase(), Phase::Failed);
    refused(i.step(2.0, 1e-4), &["failed"]);
    i.terminate().unwrap();
    assert_eq!(i.real(reference(&i, "v_dc")).unwrap(), 48.0);
}
