//! Checks of the effects against their equations, one step at a time from a chosen state.

use super::effects::EFFECTS;
use super::*;

/// A state with all terms at work: currents [A], speed [rad/s], angle [rad].
const CURRENTS: [f64; 3] = [2.0, -3.5, 1.5];
const ANGLE: f64 = 3.7;

fn with(name: &str, parameters: &[(&'static str, f64)]) -> Unit {
    Unit {
        effects: vec![Effect::new(name, parameters).expect("known")],
        ..Unit::default()
    }
}

/// The torque that an effect takes from the motor at `w` and [`ANGLE`], from one step with and one without it.
fn taken(unit: &Unit, w: f64) -> f64 {
    let after = |unit: &Unit| {
        let mut plant = Plant::new(unit, (1.0, 0.0));
        plant.set(CURRENTS, w, ANGLE);
        plant.step(0.0);
        plant.w
    };
    (after(&Unit::default()) - after(unit)) * unit.j / DT
}

fn close(what: &str, got: f64, expected: f64) {
    assert!(
        (got - expected).abs() < 1e-8 + 1e-9 * expected.abs(),
        "{what}: {got} instead of {expected}"
    );
}

#[test]
#[allow(clippy::type_complexity)]
fn mechanical_effects_obey_their_equations() {
    for w in [40.0f64, -40.0, 3.0, -3.0] {
        let sign = w.signum();
        let speed = w.abs();
        let wave = |a: f64, n: f64, p: f64| a * (n * ANGLE + p).cos();
        let cases: [(&str, &[(&'static str, f64)], f64); 9] = [
            (
                "stribeck",
                &[("torque", 0.012), ("speed", 15.0), ("exponent", 1.6)],
                sign * 0.012 * (-(speed / 15.0).powf(1.6)).exp(),
            ),
            (
                "lubricated_rise",
                &[("torque", 0.01), ("speed", 30.0)],
                sign * 0.01 * (1.0 - (-speed / 30.0).exp()),
            ),
            ("quadratic_drag", &[("coefficient", 4e-7)], 4e-7 * w * speed),
            ("viscous_asymmetry", &[("coefficient", -5e-5)], -5e-5 * speed),
            ("bias_torque", &[("torque", 0.007)], 0.007),
            (
                "periodic_friction",
                &[("amplitude", 0.009), ("phase", 1.0), ("order", 2.0)],
                sign * wave(0.009, 2.0, 1.0),
            ),
            (
                "tight_spot",
                &[("torque", 0.03), ("centre", 2.0), ("width", 3.0)],
                sign * 0.03 * (-((ANGLE - 2.0) / 3.0f64).powi(2)).exp(),
            ),
            (
                "cogging",
                &[("amplitude", 0.01), ("phase", 0.4), ("order", 12.0)],
                wave(0.01, 12.0, 0.4),
            ),
            ("spring_load", &[("stiffness", 3e-4)], 3e-4 * ANGLE),
        ];
        for (name, parameters, expected) in cases {
            close(name, taken(&with(name, parameters), w), expected);
        }
    }
}

#[test]
fn saturation_and_bristle() {
    // Saturation: the torque of the new currents, phase by phase.
    let unit = with("torque_saturation", &[("coefficient", 0.02)]);
    let mut plant = Plant::new(&unit, (1.0, 0.0));
    plant.set(CURRENTS, 40.0, ANGLE);
    let (_, _, k) = plant.winding();
    plant.step(0.0);
    let expected: f64 = (0..3)
        .map(|q| k[q] * plant.i[q] * (1.0 - 0.02 * plant.i[q].abs()))
        .sum();
    close("saturation", plant.torque, expected);
    // The bristle's torque tends to the dynamic level, against the motion, and grows with the way at first.
    let unit = with("presliding", &[("stiffness", 0.05), ("damping", 0.0)]);
    let mut plant = Plant::new(&unit, (1.0, 0.0));
    let mut way = 0.0;
    while way < 20.0 {
        plant.set([0.0; 3], 100.0, way);
        plant.step(0.0);
        way += 100.0 * DT;
        let level = 0.021;
        let dahl = level * (1.0 - (-0.05 * way / level).exp());
        assert!((plant.friction - dahl).abs() < 1e-5, "{} {dahl}", plant.friction);
    }
}

#[test]
fn static_level_is_not_below_the_dynamic_one() {
    let unit = with("stribeck", &[("torque", 0.02), ("speed", 10.0), ("exponent", 1.0)]);
    let mut plant = Plant::new(&unit, (1.0, 0.0));
    // Nominal static level 0.030, dynamic level at standstill 0.041 N m: 0.037 must not move it.
    let k = plant.winding().2;
    let i = 0.037 / (k[2] - k[1]);
    plant.set([0.0, -i, i], 0.0, 0.0);
    plant.step(0.0);
    assert!(
        plant.w == 0.0 && plant.torque > 0.031 && plant.torque < 0.041,
        "{} {}",
        plant.w,
        plant.torque
    );
}

/// `L di/dt = v - R i - k w - lost` in each phase, the currents' sum zero; returns the plant after the step.
fn balanced(unit: &Unit, faults: (f64, f64), lost: impl Fn(f64) -> f64) -> Plant {
    let mut plant = Plant::new(unit, faults);
    plant.set(CURRENTS, 55.0, ANGLE);
    let (r, l, k) = plant.winding();
    plant.step(0.001);
    for q in 0..3 {
        let rate = (plant.i[q] - CURRENTS[q]) / DT;
        close(
            "phase voltage",
            plant.v[q],
            l[q] * rate + r[q] * CURRENTS[q] + k[q] * 55.0 + lost(CURRENTS[q]),
        );
    }
    assert!(plant.i.iter().sum::<f64>().abs() < 1e-12);
    plant
}

#[test]
fn electrical_effects_obey_their_equations() {
    let none = |_: f64| 0.0;
    balanced(&Unit::default(), (1.0, 0.3), none);
    let hot = with("winding_heating", &[("delta_t", 50.0)]);
    balanced(&hot, (1.0, 0.0), none);
    close(
        "heat",
        Plant::new(&hot, (1.0, 0.0)).winding().0[1],
        1.065 * (1.0 + 0.00393 * 50.0),
    );
    let short = with("turn_short", &[("fraction", 0.2), ("phase", 1.0)]);
    balanced(&short, (1.0, 0.0), none);
    let (r, l, _) = Plant::new(&short, (1.0, 0.0)).winding();
    close("short", r[1] / r[0] + 10.0 * l[1] / l[2], 0.8 + 8.0);
    balanced(&with("dead_time", &[("voltage", 0.9)]), (1.0, 0.0), |i| {
        0.9 * i.signum()
    });
    let plant = balanced(&with("supply_sag", &[("resistance", 0.6)]), (1.0, 0.0), none);
    let drawn: f64 = (0..3).filter(|q| plant.s[*q] > 0.0).map(|q| CURRENTS[q]).sum();
    close("sag", plant.v_dc, 48.0 - 0.6 * drawn.abs());
}

#[test]
fn flux_effects_act_on_torque_and_back_emf() {
    let state = |unit: &Unit, faults| {
        let mut plant = Plant::new(unit, faults);
        plant.set(CURRENTS, 55.0, ANGLE);
        let k = plant.winding().2;
        plant.step(0.001);
        close("torque", plant.torque, (0..3).map(|q| k[q] * plant.i[q]).sum());
        k
    };
    let k = state(&Unit::default(), (1.0, 0.0));
    let faulty = state(&Unit::default(), (1.0, 0.4));
    let hidden = state(&with("eccentricity", &[("zeta", 0.2), ("phase", 0.8)]), (1.0, 0.4));
    let ripple = state(
        &with("torque_ripple", &[("fraction", 0.15), ("phase", 2.0), ("order", 6.0)]),
        (1.0, 0.0),
    );
    for q in 0..3 {
        let angle = ANGLE + std::f64::consts::TAU / 3.0 * q as f64;
        let fault = 1.0 + 0.4 * angle.cos();
        close("Eq. 5", faulty[q], k[q] * fault);
        close("Eq. 5 with both", hidden[q], k[q] * (fault + 0.2 * (angle + 0.8).cos()));
        close("ripple", ripple[q], k[q] * (1.0 + 0.15 * (6.0 * ANGLE + 2.0).cos()));
    }
}

#[test]
fn compliance_keeps_momentum_and_backlash_lags() {
    let spring = [("stiffness", 20.0), ("damping", 0.01), ("inertia", 2e-5)];
    let unit = with("compliance", &spring);
    let mut plant = Plant::new(&unit, (1.0, 0.0));
    for k in 0..20_000 {
        let (w, wl) = (plant.w, plant.load.0);
        plant.step(1e-3);
        let gained = (unit.j * (plant.w - w) + 2e-5 * (plant.load.0 - wl)) / DT;
        // A step that friction ends at standstill takes less than the full friction torque.
        if w != 0.0 && plant.w != 0.0 && k > 10 {
            close("momentum", gained, plant.torque - unit.c * w - plant.friction);
        }
    }
    assert!(plant.load.1 > 0.1 && (plant.thu * 500.0 - plant.load.1).abs() < 0.0101);
    let mut plant = Plant::new(&with("backlash", &[("gap", 0.3)]), (1.0, 0.0));
    (0..20_000).for_each(|_| plant.step(0.01));
    close("lag", plant.th - plant.thu * 500.0, 0.15);
}

#[test]
fn drive_and_sensor_effects() {
    // Delay: no current beyond the relays' band before the demand arrives.
    let mut plant = Plant::new(&with("control_delay", &[("delay", 3e-4)]), (1.0, 0.0));
    let mut largest = [0.0f64; 2];
    for k in 0..600 {
        plant.step(0.01);
        let now = &mut largest[k / 300];
        *now = plant.i.iter().fold(*now, |m, i| m.max(i.abs()));
    }
    assert!(largest[0] < 0.3 && largest[1] > 3.0, "{largest:?}");
    // Current sensors.
    let mut plant = Plant::new(&with("current_gain", &[("gain", 1.2)]), (1.0, 0.0));
    plant.step(0.01);
    close("gain", plant.i_measured[1], 1.2 * plant.i[1]);
    let mut plant = Plant::new(&with("current_offset", &[("current", -0.3)]), (1.0, 0.0));
    plant.step(0.01);
    close(
        "offset",
        plant.i_measured[0] - plant.i[0] + 2.0 * (plant.i_measured[1] - plant.i[1]),
        -0.3,
    );
    // Angles: the resolver's error, and the commutation's, which turns the switching but not the flux. At 27 degrees
    // electrical phase a is not yet fed; 6 degrees of lead feed it.
    let mut plant = Plant::new(
        &with("encoder_eccentricity", &[("amplitude", 0.03), ("phase", 0.5)]),
        (1.0, 0.0),
    );
    plant.set([0.0; 3], 0.0, ANGLE);
    close("resolver", plant.measured_angle(), ANGLE + 0.03 * (ANGLE + 0.5).sin());
    for (lead, fed) in [(0.0, false), (6.0f64, true)] {
        let mut plant = Plant::new(&with("commutation_offset", &[("angle", lead.to_radians())]), (1.0, 0.0));
        for _ in 0..30 {
            plant.set(plant.i, 0.0, 13.5f64.to_radians());
            plant.step(0.001);
        }
        assert_eq!(plant.i[0] > 0.5, fed, "{:?}", plant.i);
    }
}

#[test]
fn every_effect_acts_and_stays_bounded() {
    let command = Command::drawn_staircase(&mut super::draw::stream(3, 4), 1.0);
    let run = |unit: &Unit| record(unit, &command, 0.6, 2e3, (1.0, 0.0), false, 0);
    let plain = run(&Unit::drawn(3, None, 1.0).expect("drawn"));
    for name in EFFECTS {
        let unit = Unit::drawn(3, Some(name), 1.0).expect("drawn");
        assert_eq!(unit.effects[0].name, *name);
        let with = run(&unit);
        assert_ne!(plain, with, "{name} does nothing");
        let fastest = with.omega_m.iter().fold(0.0f64, |m, w| m.max(w.abs()));
        assert!(fastest > 5.0 && fastest < 450.0, "{name}: {fastest} rad/s");
    }
    assert!(Unit::drawn(3, Some("nothing"), 1.0).is_err());
}
