use super::*;
use crate::lanes::InstructionSet;
use crate::monitor::MonitorModel;
use crate::parameters::ActuatorParameters;
use crate::test_bench::{Built, Kernel, Lane, NumericalTestBench};
use schemas::channel::{Channel, ChannelSet};
use schemas::fault::FaultState;
use std::f64::consts::TAU;
use std::sync::Arc;

const REFERENCE: &str = include_str!("../../../datasets/parameters/reference.toml");

/// A visible effect of each kind.
pub(super) fn visible(kind: EffectKind) -> Effect {
    use EffectKind::*;
    let values: &[f64] = match kind {
        Stribeck => &[0.008, 20.0, 1.3],
        LubricatedRise => &[0.01, 15.0],
        QuadraticDrag => &[4e-6],
        ViscousAsymmetry => &[1e-4],
        BiasTorque => &[0.01],
        LoadDependentFriction => &[0.1],
        TemperatureDependentFriction => &[-0.01],
        PeriodicFriction => &[0.006, 0.4, 1.0],
        TightSpot => &[0.02, 0.35, 0.1],
        Presliding => &[8.0, 1e-3],
        Cogging => &[0.008, 0.7, 12.0],
        TorqueRipple => &[0.1, -0.5, 6.0],
        Eccentricity => &[0.2, 1.0],
        TorqueSaturation => &[0.02],
        SpringLoad => &[0.02],
        Compliance => &[40.0, 1e-4, 6e-6],
        Backlash => &[0.02],
        WindingHeating => &[80.0],
        SupplySag => &[0.8],
        DeadTime => &[1.2],
        TurnShort => &[0.2, 1.0],
        CommutationOffset => &[0.3],
        EncoderEccentricity => &[0.02, 0.3],
        CurrentOffset => &[0.3],
        CurrentGain => &[0.1],
        ControlDelay => &[4e-4],
    };
    Effect::new(kind, values)
}

/// A visible effect of each kind by each of its laws.
fn every() -> Vec<Effect> {
    let of = |&kind: &EffectKind| {
        let others = kind.law_key().into_iter().flat_map(LawKey::laws);
        let all = std::iter::once(Law::First).chain(others.filter(|l| *l != Law::First));
        all.map(move |law| visible(kind).by(law))
    };
    EffectKind::ALL.iter().flat_map(of).collect()
}

pub(super) fn with(effects: &[Effect]) -> Arc<ActuatorParameters> {
    let mut p = ActuatorParameters::reference();
    p.effects = effects.to_vec();
    p.temperature_degc = -10.0;
    Arc::new(p)
}

fn lane(p: &Arc<ActuatorParameters>, fsj: f64) -> Lane {
    Lane {
        actuator: p.clone(),
        fault: FaultState { fsj, zeta: 0.1 },
        rest_angle_rad: 0.3,
        load_n_m: 0.02,
    }
}

fn all() -> ChannelSet {
    ChannelSet::of(Channel::ALL.iter().copied().filter(|c| *c != Channel::Temperature))
}

/// A sine of 1 mrad user at 20 Hz, step by step.
pub(super) fn sine(steps: usize, dt: f64) -> Vec<f64> {
    (0..steps).map(|k| 0.001 * (TAU * 20.0 * k as f64 * dt).sin()).collect()
}

const TOLD: [Channel; 7] = [
    Channel::ThetaM,
    Channel::ThetaU,
    Channel::OmegaM,
    Channel::IA,
    Channel::IEq,
    Channel::TorqueM,
    Channel::IQ,
];

/// Bits of the samples of all lanes, every 100 steps.
fn bits<const N: usize>(lanes: &[Lane], steps: usize, set: InstructionSet) -> Vec<Vec<u64>>
where
    Kernel: Built<N>,
{
    let mut b = NumericalTestBench::<N>::with_instruction_set(lanes, all(), set);
    let mut out = vec![Vec::new(); lanes.len()];
    for com in sine(steps, 1e-6).chunks(100) {
        b.advance(com);
        for c in TOLD {
            let v = b.samples(c);
            (0..lanes.len()).for_each(|l| out[l].push(v[l].to_bits()));
        }
        b.next_interval();
    }
    out
}

fn monitor_bits(p: &ActuatorParameters) -> Vec<u64> {
    let mut m = MonitorModel::new(p, 1e-4).at_rest_angle(0.3);
    let mut out = Vec::new();
    for c in sine(1000, 1e-4) {
        m.step(c);
        let v = [m.i, m.w, m.motor_angle_rad(), m.user_angle_rad(), m.torque];
        assert!(v.iter().all(|x| x.is_finite()));
        out.extend(v.map(f64::to_bits));
    }
    out
}

fn parse(more: &str) -> schemas::error::Result<ActuatorParameters> {
    ActuatorParameters::parse("a.toml", &format!("{REFERENCE}\n{more}"))
}

/// The key of a law in files: not there for the first law, so that files of before stay as they are; another law is another actuator;
/// a name that is none, and the key at an effect of another kind, are refused in one line that has the words of `refused`.
fn says_its_law(first: &Effect, other: &Effect, key: &str, refused: [(&Effect, &str, &str); 2]) {
    assert!(!first.to_toml().contains(key), "{}", first.to_toml());
    assert!(other.to_toml().contains(&format!("{key} = \"")), "{}", other.to_toml());
    for e in [first, other] {
        assert_eq!(parse(&e.to_toml()).unwrap().effects, std::slice::from_ref(e));
    }
    let fingerprint = |e: &Effect| parse(&e.to_toml()).unwrap().fingerprint();
    assert_ne!(fingerprint(first), fingerprint(other));
    for (of, wrong, allowed) in refused {
        let text = format!("{}{key} = \"{wrong}\"\n", of.to_toml());
        let e = parse(&text).unwrap_err().to_string();
        assert!(e.contains(allowed) && e.contains(wrong) && !e.contains('\n'), "{e}");
    }
}

#[test]
fn prop_an_angle_sensor_says_whether_the_speed_is_its_own_and_nothing_else_does() {
    let angle = visible(EffectKind::EncoderEccentricity);
    let refused = [
        (&angle, "speed", "angle or angle_and_speed"),
        (&visible(EffectKind::Cogging), "angle", "in no sensor of the angle"),
    ];
    says_its_law(&angle, &angle.clone().by(Law::AngleAndSpeed), "reads", refused);
}

#[test]
fn prop_a_source_says_what_its_voltage_goes_by_and_nothing_else_does() {
    let power = visible(EffectKind::SupplySag);
    let legs = power.clone().by(Law::Legs);
    let refused = [
        (&power, "both", "power, bridge or legs"),
        (&visible(EffectKind::DeadTime), "legs", "in no source"),
    ];
    says_its_law(&power, &legs, "draw", refused);
    let said = format!("{}draw = \"power\"\n", power.to_toml());
    assert_eq!(parse(&said).unwrap().effects, std::slice::from_ref(&power));
    // in what the bench does, too
    let [power, legs] = [power, legs].map(|e| with(&[e]));
    assert_ne!(power.fingerprint(), legs.fingerprint());
    let told = |p: &Arc<ActuatorParameters>| bits::<1>(&[lane(p, 1.0)], 3000, InstructionSet::detect());
    assert!(told(&power) != told(&legs));
}

#[test]
fn prop_short_turns_say_what_has_become_of_them_and_nothing_else_does() {
    let lost = visible(EffectKind::TurnShort);
    let refused = [
        (&lost, "open", "lost or bridged"),
        (&visible(EffectKind::DeadTime), "bridged", "in no winding"),
    ];
    says_its_law(&lost, &lost.clone().by(Law::Bridged), "turns", refused);
}

#[test]
fn prop_bristles_say_what_they_break_away_at_and_nothing_else_does() {
    let dynamic = visible(EffectKind::Presliding);
    let refused = [
        (&dynamic, "never", "dynamic or static"),
        (&visible(EffectKind::DeadTime), "static", "in no bristles"),
    ];
    says_its_law(&dynamic, &dynamic.clone().by(Law::BreakAway), "breaks_away", refused);
}

#[test]
fn prop_every_kind_reads_back_as_it_was_written() {
    for mut e in every() {
        let kind = e.kind;
        assert_eq!(parse(&e.to_toml()).unwrap().effects, [e.clone()], "{}", kind.name());
        let mut intervals = [(0.0, 0.0); 3];
        for (i, _) in kind.keys().iter().enumerate() {
            intervals[i] = (e.values[i] - 1e-3 / 3.0, e.values[i] + 0.1 + 1e-17);
        }
        e.intervals = Some(intervals);
        e.correlation = match kind.keys().len() {
            1 => None,
            2 => Some([-0.1 / 3.0, 0.0, 0.0]),
            _ => Some([0.99, 1.0 / 3.0, -1.0]),
        };
        e.source = "two \"runs\", \\ and\nmore: \u{7} \u{e9}".into();
        e.parent = Some("0123abcd".into());
        e.provenance = vec![
            ("a key".into(), Note::Number(0.1 + 0.2)),
            ("data".into(), Note::Text("b\tc".into())),
            ("score".into(), Note::Number(-3.0)),
        ];
        let two = e.to_toml() + &visible(EffectKind::Cogging).to_toml();
        let read = parse(&two).unwrap().effects;
        assert_eq!(read, [e, visible(EffectKind::Cogging)], "{two}");
    }
    let offset = visible(EffectKind::CurrentOffset).by(Law::Phase(2));
    assert!(offset.to_toml().contains("sensor = \"c\""));
    assert_eq!(parse(&offset.to_toml()).unwrap().effects, std::slice::from_ref(&offset));
    let of = |e: &Effect| with(std::slice::from_ref(e)).fingerprint();
    assert_ne!(of(&offset), of(&visible(EffectKind::CurrentOffset)));
    let short = "[[effect]]\nname = \"presliding\"\nstiffness = 3\n";
    let e = &parse(short).unwrap().effects[0];
    assert_eq!((e.values, e.intervals), ([3.0, 0.0, 0.0], None));
    let warm = parse("[environment]\ntemperature_degc = { value = -40, unit = \"degC\" }\n").unwrap();
    assert_eq!(warm.temperature_degc, -40.0);
}

#[test]
fn prop_values_that_were_found_together_deviate_together() {
    let mut e = Effect::new(EffectKind::Compliance, &[10.0, 0.01, 1e-5]);
    e.intervals = Some([(8.04, 11.96), (0.00804, 0.01196), (0.804e-5, 1.196e-5)]);
    let moved = |e: &Effect, amplitude| -> [f64; 3] {
        let mut m = e.clone();
        m.deviate(amplitude, 1.0);
        std::array::from_fn(|i| m.values[i] / e.values[i] - 1.0)
    };
    let near = |a: [f64; 3], b: [f64; 3]| assert!(a.iter().zip(b).all(|(a, b)| (a - b).abs() < 2e-3), "{a:?} {b:?}");
    near(moved(&e, true), [0.1, 0.0, 0.0]);
    near(moved(&e, false), [0.0, 0.1, 0.1]);
    // all one: a standard deviation of each, and nothing across
    e.correlation = Some([1.0; 3]);
    near(moved(&e, true), [0.1; 3]);
    near(moved(&e, false), [0.0; 3]);
    // the squares of both directions are the variances, as far as two directions have them
    e.correlation = Some([0.0, 0.9, 0.0]);
    let (a, b) = (moved(&e, true), moved(&e, false));
    near(a, [0.0975, 0.0, 0.0975]);
    near(b, [0.0, 0.1, 0.0]);
}

#[test]
fn prop_bad_effects_are_refused_in_one_line() {
    let stribeck = "name = \"stribeck\"\ntorque = 0.01\nspeed = 20.0\n";
    for (text, found) in [
        ("name = \"friction\"".to_string(), "allowed: stribeck, lubricated_rise"),
        (
            format!("{stribeck}exponent = 1\ncorrelation = [0.5, 2, 0]"),
            "correlation`: found [0.5, 2, 0]; allowed: 3 numbers from -1 to 1",
        ),
        (
            "name = \"current_offset\"\ncurrent = 0.1\nsensor = \"d\"".into(),
            "key `effect[0].sensor`: found d; allowed: a, b or c",
        ),
        (
            "name = \"bias_torque\"\ntorque = 0.1\nsensor = \"a\"".into(),
            "key `effect[0].sensor`: found a; allowed: nothing: it is in no sensor of a phase",
        ),
        ("torque = 1".into(), "found nothing; allowed: the name of an effect"),
        (
            stribeck.into(),
            "key `effect[0].exponent`: found nothing; allowed: 0.5 to 3 -",
        ),
        (format!("{stribeck}exponent = 4"), "found 4; allowed: 0.5 to 3 -"),
        (
            format!("{stribeck}exponent = 1\nslope = 2"),
            "key `effect[0].slope`: found an unknown key; allowed: name, torque",
        ),
        (
            "name = \"bias_torque\"\ntorque = { value = 1, unit = \"N\" }".into(),
            "key `effect[0].torque.unit`: found N; allowed: N m",
        ),
        (
            "name = \"bias_torque\"\ntorque = { value = 1, lo = 2, hi = 3 }".into(),
            "key `effect[0].torque.lo`: found 2; allowed: a finite number of at most the value 1",
        ),
        (
            "name = \"bias_torque\"\ntorque = { value = 1, lo = 0 }".into(),
            "key `effect[0].torque.hi`: found nothing",
        ),
        (
            "name = \"bias_torque\"\ntorque = { value = 1, high = 0 }".into(),
            "key `effect[0].torque.high`: found an unknown key; allowed: value, lo, hi, unit, source",
        ),
        ("name = \"bias_torque\"\ntorque = inf".into(), "a finite number in N m"),
        (
            "name = \"turn_short\"\nfraction = 0.1\nphase = 0.5".into(),
            "found 0.5; allowed: 0, 1 or 2",
        ),
        (
            "name = \"compliance\"\nstiffness = 10\ninertia = 2.5e-5".into(),
            "allowed: 0 to less than motor.inertia_kg_m2 = 0.000025",
        ),
        (
            "name = \"cogging\"\namplitude = -1\nphase = 0\norder = 1".into(),
            "found -1; allowed: a finite number of at least 0 N m",
        ),
        (
            "name = \"bias_torque\"\ntorque = 1\nprovenance = { a = [1] }".into(),
            "key `effect[0].provenance.a`",
        ),
    ] {
        let e = parse(&format!("[[effect]]\n{text}\n")).unwrap_err().to_string();
        assert!(e.contains(found) && !e.contains('\n'), "{text}\n{e}");
    }
    let many = "[[effect]]\nname = \"bias_torque\"\ntorque = 0\n".repeat(17);
    assert!(parse(&many).unwrap_err().to_string().contains("at most 16 effects"));
    assert_eq!(parse(&many[..many.len() / 17 * 16]).unwrap().effects.len(), 16);
    let twice = visible(EffectKind::Presliding).to_toml().repeat(2);
    assert!(parse(&twice).unwrap_err().to_string().contains("presliding once"));
}

#[test]
fn prop_effects_enter_the_fingerprint_by_their_values() {
    let plain = ActuatorParameters::reference();
    // the fingerprint before effects were known
    assert_eq!(plain.fingerprint(), "fd2267d8e432540d");
    let warm = parse("[environment]\ntemperature_degc = 50\n").unwrap();
    assert_eq!(warm.fingerprint(), plain.fingerprint());
    let mut seen = vec![plain.fingerprint()];
    for mut e in every() {
        let first = with(&[e.clone()]).fingerprint();
        e.source = "elsewhere".into();
        assert_eq!(with(&[e.clone()]).fingerprint(), first);
        e.values[0] *= 1.0 + 1e-15;
        assert_ne!(with(&[e]).fingerprint(), first);
        assert!(!seen.contains(&first));
        seen.push(first);
    }
}

#[test]
fn prop_an_effect_of_amplitude_zero_changes_no_bit() {
    let set = InstructionSet::detect();
    let plain = lane(&with(&[]), 2.0);
    let truth = bits::<1>(std::slice::from_ref(&plain), 6000, set);
    let monitor = monitor_bits(&with(&[]));
    for e in every() {
        let kind = e.kind;
        let felt = lane(&with(std::slice::from_ref(&e)), 2.0);
        let mut none = e.clone();
        match kind {
            // no stiffness is no effect
            EffectKind::Presliding => continue,
            EffectKind::Compliance => none.values[2] = 0.0,
            _ => none.values[0] = 0.0,
        }
        let none = lane(&with(&[none]), 2.0);
        assert_eq!(
            bits::<1>(std::slice::from_ref(&none), 6000, set),
            truth,
            "{}",
            kind.name()
        );
        assert_eq!(monitor_bits(&none.actuator), monitor, "{}", kind.name());
        // beside a lane with the effect
        let side = bits::<8>(&[felt, none, plain.clone()], 6000, set);
        assert!(side[1] == truth[0] && side[2] == truth[0], "{e:?}");
        assert!(side[0] != truth[0], "{e:?}");
    }
}

#[test]
fn prop_lane_count_and_instruction_set_change_no_bit_with_effects() {
    let mut lanes: Vec<Lane> = every()
        .iter()
        .enumerate()
        .map(|(i, e)| lane(&with(std::slice::from_ref(e)), 1.0 + 0.1 * i as f64))
        .collect();
    let many: Vec<Effect> = EffectKind::ALL.iter().step_by(2).map(|&k| visible(k)).collect();
    lanes.push(lane(&with(&many), 1.5));
    lanes.push(lane(&with(&[]), 1.5));
    let same = with(&many);
    let alike: Vec<Lane> = (0..5).map(|i| lane(&same, 1.0 + i as f64)).collect();
    lanes.extend(alike);
    let base = InstructionSet::BASELINE;
    let truth: Vec<Vec<u64>> = lanes
        .iter()
        .map(|l| bits::<1>(std::slice::from_ref(l), 4000, base).remove(0))
        .collect();
    let differs = |got: &[Vec<u64>], truth: &[Vec<u64>]| -> Vec<usize> {
        let each = got.iter().zip(truth).enumerate();
        each.filter(|(_, (a, b))| a != b).map(|(i, _)| i).collect()
    };
    for set in InstructionSet::available() {
        for (lanes, truth) in lanes.chunks(16).zip(truth.chunks(16)) {
            let odd = differs(&bits::<16>(lanes, 4000, set), truth);
            let of: Vec<_> = odd.iter().map(|i| &lanes[*i].actuator.effects).collect();
            assert!(odd.is_empty(), "{}: {odd:?} {of:?}", set.name());
        }
        let (some, truth) = (lanes.len() - 5, &truth[lanes.len() - 5..]);
        assert_eq!(bits::<8>(&lanes[some..], 4000, set), truth, "{}", set.name());
        assert_eq!(
            bits::<1>(&lanes[some..some + 1], 4000, set),
            truth[..1],
            "{}",
            set.name()
        );
    }
}

#[test]
fn prop_an_angle_within_a_turn_has_the_bits_of_the_remainder() {
    use rand::{RngExt, SeedableRng};
    let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(1);
    let same = |x: f64| {
        let (of, wanted) = (equations::within_a_turn(x), x.rem_euclid(TAU));
        assert_eq!(of.to_bits(), wanted.to_bits(), "{x:?}: {of:?} {wanted:?}");
    };
    for x in [0.0, -0.0, TAU, -TAU, f64::MIN_POSITIVE, 1e300, -1e300, 6.6e6, -6.6e6] {
        same(x);
    }
    for _ in 0..200_000 {
        same(rng.random_range(-50.0..50.0));
        same(rng.random_range(-1e7..1e7));
        // beside whole turns
        let turns = f64::from(rng.random_range(-1_100_000..1_100_000)) * TAU;
        (-3..=3).for_each(|k| same(f64::from_bits(turns.to_bits().wrapping_add_signed(k))));
    }
    assert!(
        [f64::NAN, f64::INFINITY]
            .iter()
            .all(|x| equations::within_a_turn(*x).is_nan())
    );
}
