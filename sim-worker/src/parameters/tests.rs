//! Parameters as files have them, changed by name, and their fingerprint.

use super::*;
use crate::effect::{EffectKind, Note};

fn written_and_read(a: &ActuatorParameters) -> ActuatorParameters {
    ActuatorParameters::parse("a.toml", &a.to_toml()).unwrap()
}

#[test]
fn prop_an_actuator_written_and_read_is_the_same() {
    let mut a = ActuatorParameters::reference();
    assert_eq!(written_and_read(&a), a);
    assert_eq!(a.assumed.len(), 20);
    assert!(a.identified.is_empty());
    // numbers without a short decimal form, other marks, values that files leave out
    a.name = "A \"b\" \\ c".into();
    a.inertia_kg_m2 = 2.5e-5 / 3.0;
    a.viscous_n_m_s_per_rad = -0.0;
    a.position_gain_per_s = 1e17;
    a.opposing_efficiency = 0.9 - 0.2;
    a.temperature_degc = -40.0 / 3.0;
    a.step_s = 1e-6 / 3.0;
    a.pole_pairs = 7;
    a.assumed.retain(|k| !k.starts_with("motor."));
    a.identified = vec!["motor.pole_pairs".into(), "motor.torque_limit_n_m".into()];
    let b = written_and_read(&a);
    assert_eq!(b, a);
    assert_eq!(b.all().map(f64::to_bits), a.all().map(f64::to_bits));
}

#[test]
fn prop_an_actuator_with_any_effect_written_and_read_is_the_same() {
    for (n, &kind) in EffectKind::ALL.iter().enumerate() {
        let values: Vec<f64> = kind
            .keys()
            .iter()
            .map(|k| match (kind, k.name) {
                (EffectKind::TurnShort, "phase") => 1.0,
                (EffectKind::Compliance, "inertia") => 1e-5 / 3.0,
                _ => k.low.max(-1.0 / 3.0) + (k.high.min(1.0) - k.low.max(-1.0 / 3.0)) / 3.0,
            })
            .collect();
        let mut e = Effect::new(kind, &values);
        if n % 2 == 0 {
            let mut intervals = [(0.0, 0.0); 3];
            for (i, x) in intervals.iter_mut().zip(&values) {
                *i = (x - 0.1 / 3.0, x + 1e-9);
            }
            e.intervals = Some(intervals);
            e.grows = if kind.is_friction() { 1.0 / 3.0 } else { 0.0 };
            e.parent = Some("fd2267d8e432540d".into());
            e.source = "a \"run\"".into();
            e.provenance = vec![
                ("data".into(), Note::Text("x\ny".into())),
                ("score".into(), Note::Number(1.0 / 3.0)),
            ];
        }
        let mut a = ActuatorParameters::reference();
        // after another that any number may be of
        a.effects = vec![Effect::new(EffectKind::Cogging, &[0.001, -0.3, 12.0]), e];
        assert_eq!(written_and_read(&a), a, "{}", kind.name());
    }
}

#[test]
fn prop_a_parameter_that_is_changed_by_name_is_the_only_one_and_is_checked() {
    let a = ActuatorParameters::reference();
    assert_eq!(a.with(&[]).unwrap(), a);
    for (k, (name, _, x)) in a.parameters().enumerate() {
        let y = match name {
            "pole_pairs" => 3.0,
            "drive_constant_n_m_per_a" => 0.08,
            "opposing_efficiency" | "aiding_efficiency" | "step_s" => 0.5 * x,
            _ => 0.9 * x,
        };
        let b = a.with(&[(name, y)]).unwrap();
        let changed: Vec<usize> = (0..ALL.len()).filter(|&i| a.all()[i] != b.all()[i]).collect();
        assert_eq!((changed, b.all()[k]), (vec![k], y), "{name}");
    }
    assert!(a.with(&[("gear_ratio", 0.0)]).is_err());
    let said = a.with(&[("gear", 1.0)]).unwrap_err().to_string();
    assert!(said.contains("found gear; allowed: supply_voltage_v"), "{said}");
}

#[test]
fn prop_the_fingerprint_has_not_changed() {
    let mut a = ActuatorParameters::reference();
    assert_eq!(a.fingerprint(), "fd2267d8e432540d");
    a.temperature_degc = 35.0;
    assert_eq!(a.fingerprint(), "fd2267d8e432540d");
    // word by word
    a.effects = vec![Effect::new(EffectKind::Cogging, &[0.001, -0.3, 12.0])];
    let motor = [48.0, 1.065, 0.00036, 0.0376, 2.0, 2.5e-5, 3e-5, 1.7, 0.03, 0.7];
    let transmission = [500.0, 2e-5, 1.2, 1.0, 1.0];
    let controller = [100000.0, 838.0, 0.05, 0.5, 1.7, 22.5, 0.1];
    let values = [&motor[..], &transmission, &controller, &[1e-6]].concat();
    let list = |v: &[f64]| v.iter().map(|&x| exact(x)).collect::<Vec<_>>().join(",");
    let text = format!(
        "actuator;{};temperature,{};cogging,{}",
        list(&values),
        exact(35.0),
        list(&[0.001, -0.3, 12.0])
    );
    assert_eq!(a.fingerprint(), fingerprint(&text));
}

#[test]
fn prop_places_and_values_belong_together() {
    let a = ActuatorParameters::reference();
    for (k, (name, table, key)) in PARAMETERS.into_iter().enumerate() {
        let half = 0.5 * a.values()[k];
        let b = ActuatorParameters::parse_with("a.toml", REFERENCE, &[(k, half)]).unwrap();
        assert_eq!(b.values()[k], half, "{name}");
        assert_eq!(
            a.values().iter().zip(b.values()).filter(|(a, b)| **a != *b).count(),
            usize::from(half != a.values()[k])
        );
        assert!(name == key || !table.is_empty());
    }
    let ending: Vec<&str> = (0..PARAMETERS.len())
        .filter(|&k| most(k) == 1.0)
        .map(|k| PARAMETERS[k].0)
        .collect();
    assert_eq!(
        ending,
        ["dynamic_friction_ratio", "opposing_efficiency", "aiding_efficiency"]
    );
}
