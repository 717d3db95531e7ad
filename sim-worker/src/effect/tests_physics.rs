//! The effect that acts in the simulators is the equation driven by the recorded signals.

use super::tests::{sine, visible, with};
use super::*;
use crate::monitor::MonitorModel;
use crate::parameters::ActuatorParameters;
use crate::test_bench::{Lane, NumericalTestBench};
use schemas::channel::{Channel, ChannelSet};
use schemas::fault::FaultState;
use std::f64::consts::{E, TAU};
use std::sync::Arc;

const DT: f64 = 1e-6;
const REST: f64 = 0.3;
const LOAD: f64 = 0.02;

/// What the test bench did, step by step.
#[derive(Default)]
struct Record {
    theta: Vec<f64>,
    user: Vec<f64>,
    omega: Vec<f64>,
    torque: Vec<f64>,
    iq: Vec<f64>,
    i: [Vec<f64>; 3],
    v: [Vec<f64>; 3],
}

fn record(p: &Arc<ActuatorParameters>, com: &[f64]) -> Record {
    let lane = Lane {
        actuator: p.clone(),
        fault: FaultState { fsj: 1.0, zeta: 0.0 },
        rest_angle_rad: REST,
        load_n_m: LOAD,
    };
    let mut b = NumericalTestBench::<1>::new(&[lane], ChannelSet::of([Channel::TorqueM]));
    let mut r = Record::default();
    for c in com.chunks(1) {
        b.advance(c);
        let put = |to: &mut Vec<f64>, c: Channel| to.push(b.samples(c)[0]);
        put(&mut r.theta, Channel::ThetaM);
        put(&mut r.user, Channel::ThetaU);
        put(&mut r.omega, Channel::OmegaM);
        put(&mut r.torque, Channel::TorqueM);
        put(&mut r.iq, Channel::IQ);
        for (q, (i, v)) in [
            (Channel::IA, Channel::VA),
            (Channel::IB, Channel::VB),
            (Channel::IC, Channel::VC),
        ]
        .into_iter()
        .enumerate()
        {
            put(&mut r.i[q], i);
            put(&mut r.v[q], v);
        }
        b.next_interval();
    }
    r
}

/// Signals at the start of step `k`, load and temperature those of the tests.
fn signals(r: &Record, k: usize) -> Signals {
    Signals {
        theta: r.theta[k - 1],
        rest: REST,
        omega: r.omega[k - 1],
        sign: r.omega[k - 1].signum(),
        current: r.iq[k],
        load: LOAD,
        temperature: -10.0,
        ..Signals::default()
    }
}

/// What the motor gives beyond inertia, viscous and dry friction and load, in step `k`; None where
/// the rotor stands or stops.
fn torque_gap(p: &ActuatorParameters, r: &Record, k: usize, dry: f64) -> Option<f64> {
    let (w, next) = (r.omega[k - 1], r.omega[k]);
    let known = p.inertia_kg_m2 * (next - w) / DT + p.viscous_n_m_s_per_rad * w + dry * w.signum() + LOAD;
    (w * next > 0.0).then_some(r.torque[k] - known)
}

fn rms(x: &[f64]) -> f64 {
    (x.iter().map(|x| x * x).sum::<f64>() / x.len() as f64).sqrt()
}

fn difference(a: &[f64], b: &[f64]) -> f64 {
    let d: Vec<f64> = a.iter().zip(b).map(|(a, b)| a - b).collect();
    rms(&d)
}

/// Means of 100 steps each.
fn means(x: &[f64]) -> Vec<f64> {
    x.chunks(100).map(|c| c.iter().sum::<f64>() / c.len() as f64).collect()
}

#[test]
fn prop_torques_are_the_equations_of_the_recorded_signals() {
    use EffectKind::*;
    let com = sine(40_000, DT);
    for kind in [
        Stribeck,
        LubricatedRise,
        QuadraticDrag,
        ViscousAsymmetry,
        BiasTorque,
        LoadDependentFriction,
        TemperatureDependentFriction,
        PeriodicFriction,
        TightSpot,
        Cogging,
        SpringLoad,
    ] {
        let e = visible(kind);
        let p = with(std::slice::from_ref(&e));
        let c = Constants::of(&p, 1.0);
        let r = record(&p, &com);
        let (mut got, mut wanted) = (Vec::new(), Vec::new());
        for k in 1..com.len() {
            if let Some(gap) = torque_gap(&p, &r, k, c.coulomb) {
                got.push(gap);
                wanted.push(e.torque(&signals(&r, k), &c));
            }
        }
        let (size, error) = (rms(&wanted), difference(&got, &wanted));
        println!(
            "{}: {size:.2e} N m, error {error:.1e} in {} steps",
            kind.name(),
            got.len()
        );
        assert!(got.len() > 30_000 && size > 3e-4 && error < 1e-9, "{}", kind.name());
    }
}

#[test]
fn prop_bridged_turns_brake_by_the_heat_of_their_current() {
    let com = sine(40_000, DT);
    for q in 0..3 {
        let e = Effect::new(EffectKind::TurnShort, &[0.2, q as f64]).by(Law::Bridged);
        let p = with(std::slice::from_ref(&e));
        let c = Constants::of(&p, 1.0);
        let r = record(&p, &com);
        let (mut got, mut wanted) = (Vec::new(), Vec::new());
        for k in 1..com.len() {
            if let Some(gap) = torque_gap(&p, &r, k, c.coulomb) {
                let s = signals(&r, k);
                let emf =
                    0.2 * 0.5 * c.torque_constant * s.omega * shape(c.pole_pairs * s.theta - TAU / 3.0 * q as f64);
                got.push(gap * s.omega);
                wanted.push(emf * emf / (0.2 * 0.5 * c.resistance));
            }
        }
        assert!(got.len() > 30_000 && rms(&wanted) > 1e-3);
        assert!(difference(&got, &wanted) < 1e-6 * rms(&wanted), "{q}");
        // the equivalent phase of the simplified model brakes as much
        let s = Signals {
            theta: 0.7,
            omega: 300.0,
            ..Signals::default()
        };
        let all = Injection::new(&p, 1.0, 0.0, 0.0, DT).unwrap();
        assert_eq!(all.torque(&s), e.brake_torque(&s, &c));
    }
}

#[test]
fn prop_shares_of_the_torque_constant_are_the_equations_of_the_recorded_signals() {
    use EffectKind::*;
    let com = sine(40_000, DT);
    let one = |q: usize| visible(CurrentOffset).by(Law::Phase(q));
    for (e, tolerance) in [
        (TorqueRipple, 1e-9),
        (CurrentOffset, 1e-9),
        (CurrentGain, 1e-9),
        (Eccentricity, 0.1),
        (TurnShort, 0.1),
        (CommutationOffset, 0.1),
        (TorqueSaturation, 0.1),
    ]
    .map(|(kind, tolerance)| (visible(kind), tolerance))
    .into_iter()
    .chain([0, 1, 2].map(|q| (one(q), 1e-9)))
    .chain([Law::Flux, Law::Square].map(|law| (visible(TorqueSaturation).by(law), 0.1)))
    {
        let kind = e.kind;
        let p = with(std::slice::from_ref(&e));
        let c = Constants::of(&p, 1.0);
        let r = record(&p, &com);
        let steps = 1..com.len();
        let got: Vec<f64> = steps
            .clone()
            .map(|k| c.torque_constant * r.iq[k] - r.torque[k])
            .collect();
        let wanted: Vec<f64> = steps.map(|k| e.torque(&signals(&r, k), &c)).collect();
        // phase currents of a pair differ by what the third carries, the more so within a switching period
        let (got, wanted) = if tolerance < 1e-3 {
            (got, wanted)
        } else {
            (means(&got), means(&wanted))
        };
        let (size, error) = (rms(&wanted), difference(&got, &wanted));
        println!("{}: {size:.2e} N m, error {:.1e} of it", kind.name(), error / size);
        assert!(size > 1e-4 && error < tolerance * size, "{}", kind.name());
    }
}

#[test]
fn prop_an_offset_of_one_sensor_is_what_the_phases_add_up_to_and_hardly_felt() {
    let e = visible(EffectKind::CurrentOffset).by(Law::Phase(1));
    let com = sine(40_000, DT);
    let [r, plain] = [with(std::slice::from_ref(&e)), with(&[])].map(|p| record(&p, &com));
    for k in 0..com.len() {
        assert!((r.i[0][k] + r.i[1][k] + r.i[2][k] - e.values[0]).abs() < 1e-9);
    }
    // the relays of the other two hold the current
    let mean = |x: &[f64]| x.iter().sum::<f64>() / x.len() as f64;
    let shown: [f64; 3] = std::array::from_fn(|q| (mean(&r.i[q]) - mean(&plain.i[q])) / e.values[0]);
    assert!(shown[0].abs() < 0.15 && (shown[1] - 1.0).abs() < 0.15, "{shown:?}");
    let felt = difference(&means(&r.torque), &means(&plain.torque));
    assert!(felt < 0.15 * 0.0752 * e.values[0].abs(), "{felt}");
}

#[test]
fn prop_a_gain_of_one_sensor_is_what_the_phases_add_up_to() {
    // a current that lasts: full speed and a stop
    let com: Vec<f64> = (0..30_000).map(|k| if k < 20_000 { 0.05 } else { 0.04 }).collect();
    let plain = record(&with(&[]), &com);
    for q in 0..3 {
        for gain in [0.1, -0.1] {
            let e = Effect::new(EffectKind::CurrentGain, &[gain]).by(Law::Phase(q));
            let r = record(&with(&[e]), &com);
            for k in 0..com.len() {
                let true_current = r.i[q][k] / (1.0 + gain);
                let others = r.i[(q + 1) % 3][k] + r.i[(q + 2) % 3][k];
                assert!((true_current + others).abs() < 1e-9, "{q} {gain} at {k}");
            }
            // the relays act on what they see, so the motion is another, and not by much
            assert!(r.omega != plain.omega);
            assert!(difference(&r.omega, &plain.omega) < 0.1 * rms(&plain.omega));
        }
    }
    // all three alike are what a gain of all is
    let each: Vec<Effect> = (0..3)
        .map(|q| Effect::new(EffectKind::CurrentGain, &[0.1]).by(Law::Phase(q)))
        .collect();
    let [one, all] = [each, vec![Effect::new(EffectKind::CurrentGain, &[0.1])]].map(|e| record(&with(&e), &com));
    assert!(one.omega == all.omega && one.i == all.i);
}

#[test]
fn prop_the_flux_is_what_the_shape_is_the_slope_of() {
    for k in 0..1000 {
        let (x, step) = (-7.0 + 0.014 * f64::from(k), 1e-6);
        let slope = (flux(x + step) - flux(x - step)) / (2.0 * step);
        assert!((slope - shape(x)).abs() < 1e-5, "{x}: {slope} {}", shape(x));
    }
}

#[test]
fn prop_voltages_are_the_equations_of_the_recorded_signals() {
    use EffectKind::*;
    // full speed and a stop
    let com: Vec<f64> = (0..60_000).map(|k| if k < 40_000 { 0.05 } else { 0.04 }).collect();
    for (kind, law, tolerance) in [
        (WindingHeating, Law::First, 1e-6),
        (DeadTime, Law::First, 0.1),
        (SupplySag, Law::First, 0.15),
        // between two changes of a relay legs may be up together, which draw nothing
        (SupplySag, Law::Bridge, 0.4),
        (SupplySag, Law::Legs, 0.15),
        (TurnShort, Law::First, 0.15),
        (TorqueRipple, Law::First, 0.1),
        // the current of a leg that has just been left saturates too
        (TorqueSaturation, Law::Flux, 0.2),
        (Eccentricity, Law::First, 0.1),
    ] {
        let e = visible(kind).by(law);
        let p = with(std::slice::from_ref(&e));
        let c = Constants::of(&p, 1.0);
        let r = record(&p, &com);
        let (mut got, mut wanted) = (Vec::new(), Vec::new());
        // intervals of 100 steps with one pair of phases
        for from in (1..com.len() - 100).step_by(100) {
            let on = conducting(r.theta[from - 1], c.pole_pairs);
            if on != conducting(r.theta[from + 98], c.pole_pairs) {
                continue;
            }
            let pair = |x: &[Vec<f64>; 3], k: usize| on[0] * x[0][k] + on[1] * x[1][k] + on[2] * x[2][k];
            let (mut sum, mut equation, mut duty, mut current) = (0.0, 0.0, 0.0, 0.0);
            for k in from..from + 100 {
                let (i, before) = (0.5 * pair(&r.i, k), 0.5 * pair(&r.i, k - 1));
                let v = pair(&r.v, k);
                let rate = (i - before) / DT;
                let s = Signals {
                    current: before,
                    current_rate: rate,
                    ..signals(&r, k)
                };
                sum += v - c.resistance * before - c.inductance * rate - c.torque_constant * s.omega;
                equation += e.voltage(&s, &c);
                duty += v / p.supply_voltage_v;
                current += i;
            }
            if kind == SupplySag {
                let s = Signals {
                    duty: 0.01 * duty,
                    current: 0.01 * current,
                    ..Signals::default()
                };
                equation = 100.0 * e.voltage(&s, &c);
            }
            got.push(0.01 * sum);
            wanted.push(0.01 * equation);
        }
        let (size, error) = (rms(&wanted), difference(&got, &wanted));
        println!(
            "{}: {size:.2e} V, error {:.1e} of it in {} samples",
            kind.name(),
            error / size,
            got.len()
        );
        assert!(
            got.len() > 100 && size > 0.05 && error < tolerance * size,
            "{}",
            kind.name()
        );
    }
}

#[test]
fn prop_effects_with_a_state_are_their_machines_driven_by_the_recorded_motion() {
    let com = sine(40_000, DT);
    let reference = ActuatorParameters::reference();
    let c = Constants::of(&reference, 1.0);
    let n = reference.gear_ratio;
    let play = 2.0 * reference.backlash_half_width_rad * n;

    // bristles in place of dry friction
    for law in [Law::First, Law::BreakAway] {
        let e = visible(EffectKind::Presliding).by(law);
        let p = with(std::slice::from_ref(&e));
        let r = record(&p, &com);
        let mut bristles = e.bristles(&c);
        bristles.step(0.0, DT);
        for k in 1..com.len() {
            bristles.slide_at(c.coulomb, 0.0, r.omega[k - 1]);
            let friction = bristles.step(r.omega[k - 1], DT);
            if let Some(gap) = torque_gap(&p, &r, k, 0.0) {
                assert!((gap - friction).abs() < 1e-9, "{law:?} {k}: {gap} {friction}");
            }
        }
    }

    // a mass behind a spring
    let e = visible(EffectKind::Compliance);
    let p = with(std::slice::from_ref(&e));
    let r = record(&p, &com);
    let mut mass = TwoMass::new(e.values[0], e.values[1], e.values[2], 0.0);
    let mut user = Play::new(play, 0.0);
    let mut worst = 0.0_f64;
    for k in 0..com.len() {
        let th = if k == 0 { 0.0 } else { r.theta[k - 1] - REST };
        let (torque, angle, _) = mass.step(th, r.omega[k], DT);
        worst = worst.max((user.step(angle) / n - r.user[k]).abs());
        if k > 0
            && let Some(gap) = torque_gap(&p, &r, k, c.coulomb)
        {
            let behind = e.values[2] * (r.omega[k] - r.omega[k - 1]) / DT;
            assert!((gap + behind - torque).abs() < 1e-8, "{k}: {gap} {torque}");
        }
    }
    assert!(worst < 1e-12, "{worst:e}");
    let stiff: Vec<f64> = r.theta.iter().map(|t| (t - REST) / n).collect();
    assert!(difference(&stiff, &r.user) > 1e-5 / n);

    // play
    let e = visible(EffectKind::Backlash);
    let r = record(&with(std::slice::from_ref(&e)), &com);
    let mut user = Play::new(play + e.values[0], 0.0);
    for k in 0..com.len() {
        assert!((user.step(r.theta[k] - REST) / n - r.user[k]).abs() < 1e-12);
    }

    // the sensor tells another angle than the one that the speed adds up to
    let e = visible(EffectKind::EncoderEccentricity);
    let r = record(&with(std::slice::from_ref(&e)), &com);
    let mut theta = REST;
    for k in 0..com.len() {
        theta += r.omega[k] * DT;
        assert!((theta + e.angle_error(theta) - r.theta[k]).abs() < 1e-9);
    }
    // where the speed is that sensor's too, the two agree, and the loop acts on it
    let both = e.clone().by(Law::AngleAndSpeed);
    let seen = record(&with(std::slice::from_ref(&both)), &com);
    let mut theta = seen.theta[0];
    for k in 1..com.len() {
        theta += 0.5 * (seen.omega[k - 1] + seen.omega[k]) * DT;
        assert!((theta - seen.theta[k]).abs() < 1e-4, "{k}: {theta} {}", seen.theta[k]);
    }
    assert!(difference(&seen.omega, &r.omega) > 0.0);
}

#[test]
fn prop_a_late_controller_is_late() {
    let late = visible(EffectKind::ControlDelay);
    let com = sine(4_000, DT);
    let first = |p: &Arc<ActuatorParameters>| {
        let r = record(p, &com);
        (0..com.len()).find(|&k| r.iq[k].abs() > 0.3).unwrap() as f64 * DT
    };
    let delay = first(&with(std::slice::from_ref(&late))) - first(&with(&[]));
    println!("{delay:e}");
    assert!((delay - late.values[0]).abs() < 1e-4, "{delay}");
    let mut line = DelayLine::new(2.5e-3, 1e-3);
    let out: Vec<f64> = (1..=6).map(|x| line.step(x as f64)).collect();
    assert_eq!(out, [0.0, 0.0, 0.5, 1.5, 2.5, 3.5]);
    assert_eq!(DelayLine::new(0.0, 1e-3).step(7.0), 7.0);
    let mut line = DelayLine::new(3e-6, 1e-6);
    let out: Vec<f64> = (1..=5).map(|x| line.step(x as f64)).collect();
    assert_eq!(out, [0.0, 0.0, 0.0, 1.0, 2.0]);
}

#[test]
fn prop_machines_keep_to_their_laws() {
    // bristles: exact for a constant speed, whatever the step, and without damping within the level
    let (mut fine, mut coarse) = (Dahl::new(10.0, 0.0, 0.02), Dahl::new(10.0, 0.0, 0.02));
    for _ in 0..1000 {
        fine.step(0.3, 1e-5);
    }
    coarse.step(0.3, 1e-2);
    assert!((fine.z - coarse.z).abs() < 1e-12 && fine.z > 0.0 && fine.z < 0.002);
    assert!((coarse.z - 0.002 * (1.0 - (-0.3_f64 * 1e-2 * 500.0).exp())).abs() < 1e-15);
    assert!((coarse.step(1e9, 1.0) - 0.02).abs() < 1e-12 && (coarse.step(-1e9, 1.0) + 0.02).abs() < 1e-12);
    assert_eq!(Dahl::new(10.0, 1.0, 0.0).step(3.0, 1e-3), 0.0);
    // soft bristles that are bent back: the damping of twice the speed comes on top of the level
    let mut soft = Dahl {
        z: -0.4,
        ..Dahl::new(0.05, 1e-3, 0.02)
    };
    assert!((soft.step(30.0, 1e-9) - (-0.02 + 1e-3 * 60.0)).abs() < 1e-8);
    // at rest they hold the static friction, in fast motion the dynamic one; by the first law this one always
    let c = Constants::of(&ActuatorParameters::reference(), 2.0);
    for (law, still) in [(Law::First, 0.042), (Law::BreakAway, 0.06)] {
        let mut b = visible(EffectKind::Presliding).by(law).bristles(&c);
        for (omega, level) in [(0.0, still), (2.0, 0.042 + (still - 0.042) / E), (30.0, 0.042)] {
            b.slide_at(c.coulomb, 0.001, omega);
            assert!((b.level - 0.001 - level).abs() < 1e-12, "{law:?} {omega}: {}", b.level);
        }
    }
    // a spring without damper keeps its energy for any step, and what the shaft gives is what the mass gains
    for dt in [1e-6, 1e-4, 3e-3] {
        let mut m = TwoMass::new(50.0, 0.0, 1e-5, 0.01);
        let energy = |m: &TwoMass| 0.5 * m.stiffness * m.angle.powi(2) + 0.5 * m.inertia * m.speed.powi(2);
        let (start, mut given) = (energy(&m), 0.0);
        for _ in 0..1000 {
            given += m.step(0.0, 0.0, dt).0 * dt;
        }
        assert!((energy(&m) / start - 1.0).abs() < 1e-9, "{dt}");
        assert!((given - m.inertia * m.speed).abs() < 1e-12, "{dt}");
        let slope = (m.torque(0.1, 2.0, dt) - m.torque(0.1, 1.0, dt)) / m.slope(dt);
        assert!((slope - 1.0).abs() < 1e-9);
    }
}

/// |current| and user angle of the test bench and of the simplified model, means and values of
/// each millisecond.
fn both(p: &Arc<ActuatorParameters>, com: &[f64]) -> [[Vec<f64>; 2]; 2] {
    let lane = Lane {
        actuator: p.clone(),
        fault: FaultState { fsj: 1.0, zeta: 0.0 },
        rest_angle_rad: REST,
        load_n_m: 0.0,
    };
    let mut b = NumericalTestBench::<1>::new(&[lane], ChannelSet::basic());
    let mut bench = [Vec::new(), Vec::new()];
    let mut m = MonitorModel::new(p, 1e-4).at_rest_angle(REST);
    let mut model = [Vec::new(), Vec::new()];
    for com in com.chunks(1000) {
        b.advance(com);
        bench[0].push(b.samples(Channel::IEq)[0]);
        bench[1].push(b.samples(Channel::ThetaU)[0]);
        b.next_interval();
        let mut abs = 0.0;
        for k in 0..10 {
            m.step(com[100 * k + 99]);
            abs += 0.1 * m.i.abs();
        }
        model[0].push(abs);
        model[1].push(m.user_angle_rad());
    }
    [bench, model]
}

/// What an effect changes in the one is what it changes in the other; in brackets the share that differs.
#[test]
fn prop_the_simplified_model_follows_the_bench_with_every_effect() {
    let step = vec![0.3; 150_000];
    let sine = sine(150_000, DT);
    let plain = [&step, &sine].map(|com| both(&with(&[]), com));
    for &kind in EffectKind::ALL {
        // by current control the motion of a sine hides what only the voltage feels
        let com = match kind.equation() {
            Equation::Electrical => 0,
            _ => 1,
        };
        let [bench0, model0] = &plain[com];
        let [bench, model] = both(&with(&[visible(kind)]), [&step, &sine][com]);
        let (mut told, mut best) = (String::new(), f64::INFINITY);
        for c in 0..2 {
            let of = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a - b).collect::<Vec<f64>>();
            let (by_bench, by_model) = (of(&bench[c], &bench0[c]), of(&model[c], &model0[c]));
            let (size, apart) = (rms(&by_bench), difference(&by_bench, &by_model));
            told += &format!(" {size:.1e} ({:.3})", apart / size);
            best = best.min(apart / size);
        }
        println!("{:32}{told}", kind.name());
        match kind {
            // no load
            EffectKind::LoadDependentFriction => assert_eq!((bench, model), (bench0.clone(), model0.clone())),
            // what the user sees of it is a slightly worse commutation
            EffectKind::EncoderEccentricity => {}
            _ => assert!(best < 0.45, "{}{told}", kind.name()),
        }
    }
}

/// What an effect adds to the friction of bristles is not multiplied by their break-away, in either model; and no dynamic friction is no number of times the static one.
#[test]
fn prop_bristles_break_away_at_the_dry_friction_alone() {
    let bristles = visible(EffectKind::Presliding).by(Law::BreakAway);
    let more = Effect::new(EffectKind::TightSpot, &[0.2, 0.0, 1e6]);
    // half a radian a second of the motor
    let slow: Vec<f64> = (0..300_000).map(|k| 1e-3 * DT * k as f64).collect();
    let [bench, model] = both(&with(&[bristles.clone(), more]), &slow);
    let apart = difference(&bench[0], &model[0]) / rms(&bench[0]);
    assert!(apart < 0.1, "{apart}");
    let mut p = (*with(&[bristles])).clone();
    p.dynamic_friction_ratio = 0.0;
    let [bench, model] = both(&Arc::new(p), &sine(30_000, DT));
    for x in bench.iter().chain(&model) {
        assert!(x.iter().all(|x| x.is_finite()), "{x:?}");
    }
}

#[test]
fn prop_extreme_effects_stay_finite() {
    use EffectKind::*;
    let com: Vec<f64> = (0..30_000).map(|k| if k < 15_000 { 0.1 } else { -0.001 }).collect();
    for (kind, values) in [
        (Stribeck, &[10.0, 1e-9, 3.0][..]),
        (LubricatedRise, &[10.0, 1e-9]),
        (TemperatureDependentFriction, &[-10.0]),
        (PeriodicFriction, &[1.0, 6.0, 1000.0]),
        (TightSpot, &[10.0, 0.3, 1e-9]),
        (Presliding, &[1e-9, 0.0]),
        (Presliding, &[1e12, 1e3]),
        (Presliding, &[1e-3, 1e3]),
        (Cogging, &[3.0, -6.0, 1000.0]),
        (TorqueRipple, &[1.0, 0.0, 1000.0]),
        (Eccentricity, &[1.0, 6.0]),
        (TorqueSaturation, &[1.0]),
        (SpringLoad, &[1e3]),
        (Compliance, &[1e9, 0.0, 2.49e-5]),
        (Compliance, &[1e-9, 1e3, 1e-15]),
        (Backlash, &[100.0]),
        (WindingHeating, &[300.0]),
        (SupplySag, &[1e6]),
        (DeadTime, &[1e3]),
        (TurnShort, &[1.0, 2.0]),
        (CommutationOffset, &[1.6]),
        (EncoderEccentricity, &[1.0, 6.0]),
        (CurrentOffset, &[-100.0]),
        (CurrentGain, &[-0.9]),
        (CurrentGain, &[9.0]),
        (ControlDelay, &[1.0]),
    ] {
        let p = with(&[Effect::new(kind, values)]);
        let r = record(&p, &com);
        let worst = |x: &[f64]| {
            x.iter()
                .fold(0.0_f64, |m, x| if x.is_finite() { m.max(x.abs()) } else { f64::NAN })
        };
        let (w, i, user) = (worst(&r.omega), worst(&r.iq), worst(&r.user));
        let mut m = MonitorModel::new(&p, 1e-4).at_rest_angle(REST);
        let (mut fastest, mut most) = (0.0_f64, 0.0_f64);
        for c in com.chunks(100).chain(com.chunks(100)) {
            m.step(c[0]);
            assert!(
                m.w.is_finite() && m.i.is_finite() && m.user_angle_rad().is_finite(),
                "{}",
                kind.name()
            );
            (fastest, most) = (fastest.max(m.w.abs()), most.max(m.i.abs()));
        }
        println!(
            "{:32}{values:?} bench {w:.1} rad/s {i:.1} A {user:.2} rad, model {fastest:.1} rad/s {most:.1} A",
            kind.name()
        );
        assert!(
            w.is_finite() && i.is_finite() && user <= 1.2001,
            "{} {w} {i} {user}",
            kind.name()
        );
    }
}
