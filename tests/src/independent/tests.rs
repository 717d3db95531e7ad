//! Checks against the numbers printed at the end of the model's page, and of the generator itself.

use super::*;

/// User speeds of a step run in the window of the test functions.
fn step_speeds(faults: (f64, f64)) -> Vec<f64> {
    let run = nominal(&Command::Step, 0.65, 1e4, faults);
    run.t
        .iter()
        .zip(&run.omega_m)
        .filter(|(t, _)| **t > 0.2)
        .map(|(_, w)| w / 500.0)
        .collect()
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}

fn nominal(command: &Command, seconds: f64, rate: f64, faults: (f64, f64)) -> Telemetry {
    record(&Unit::default(), command, seconds, rate, faults, false, 0)
}

fn rms(values: impl Iterator<Item = f64>) -> f64 {
    let (sum, n) = values.fold((0.0, 0), |(s, n), x| (s + x * x, n + 1));
    (sum / f64::from(n)).sqrt()
}

/// Printed and simulated value agree within `tolerance` (relative).
fn agrees(what: &str, got: f64, printed: f64, tolerance: f64) {
    eprintln!(
        "{what}: {got:.7e} printed {printed:.7e} off {:.1e}",
        got / printed - 1.0
    );
    assert!(
        (got - printed).abs() <= tolerance * printed.abs(),
        "{what}: {got} instead of {printed}"
    );
}

#[test]
fn table_of_the_model_page() {
    let table = [
        (1.0, 0.0, 0.00022778, 0.00022778, 0.0, 4.079e-6),
        (3.0, 0.0, 0.03686, 0.00022497, 0.55957, 15.19e-6),
        (5.0, 0.0, 0.07415, 0.00041981, 1.1061, 24.78e-6),
        (1.0, 0.3, 0.018782, 0.005007, 0.047767, 4.689e-6),
        (3.0, 0.3, 0.053016, 0.0048019, 0.60846, 17.62e-6),
        (5.0, 0.3, 0.087145, 0.0046011, 1.1879, 29.03e-6),
        (1.0, 0.5, 0.050979, 0.0085198, 0.072774, 5.619e-6),
        (5.0, 0.5, 0.11493, 0.007893, 1.2748, 32.58e-6),
    ];
    let healthy = nominal(&Command::Sine, 1.0, 1e4, (1.0, 0.0)).i_eq;
    let nominal_mean = mean(&step_speeds((1.0, 0.0)));
    agrees("mean", nominal_mean, 1.23872, 4.1e-6);
    for (fsj, zeta, p1, ripple, p2, p3) in table {
        let speed = step_speeds((fsj, zeta));
        let own = mean(&speed);
        let p1_got = rms(speed.iter().map(|w| nominal_mean - w));
        let ripple_got = rms(speed.iter().map(|w| own - w));
        let current = nominal(&Command::Sine, 1.0, 1e4, (fsj, zeta)).i_eq;
        let p2_got = rms(current.iter().zip(&healthy).map(|(a, b)| a - b));
        let ramp = nominal(&Command::Ramp, 0.05, 1e5, (fsj, zeta));
        let first = ramp.omega_m.iter().position(|w| *w != 0.0).expect("breaks away");
        let case = format!("({fsj}, {zeta})");
        agrees(&format!("P1* {case}"), p1_got, p1, 1e-4);
        agrees(&format!("ripple* {case}"), ripple_got, ripple, 1e-4);
        agrees(&format!("P2* {case}"), p2_got, p2, 1e-4);
        agrees(&format!("P3* {case}"), ramp.com[first], p3, 2e-4);
    }
}

#[test]
fn same_seed_same_bytes() {
    let bytes = |seed: u64, noise: u64| {
        let unit = Unit::drawn(seed, Some("cogging"), 1.0).expect("known effect");
        let command = Command::drawn_sines(&mut draw::stream(seed, 3));
        let mut text = Vec::new();
        record(&unit, &command, 0.3, 2e3, (1.0, 0.0), true, noise)
            .write(&mut text)
            .expect("memory");
        text
    };
    assert_eq!(bytes(5, 1), bytes(5, 1));
    assert_ne!(bytes(5, 1), bytes(5, 2));
    assert_ne!(bytes(5, 1), bytes(6, 1));
    let text = String::from_utf8(bytes(5, 1)).expect("text");
    assert_eq!(text.lines().count(), 601);
    let header = "t,com,theta_u,theta_m,omega_m,i_eq,i_a,i_b,i_c,v_a,v_b,v_c,v_dc";
    assert_eq!(text.lines().next(), Some(header));
}

#[test]
fn constants_do_not_depend_on_the_effect_and_keep_their_ranges() {
    for seed in 0..200 {
        let plain = Unit::drawn(seed, None, 1.0).expect("nothing hidden");
        let other = Unit::drawn(seed, Some("supply_sag"), 0.1).expect("known effect");
        assert_eq!(
            Unit {
                effects: Vec::new(),
                ..other
            },
            plain
        );
        let off = |a: f64, b: f64, share: f64| assert!((a / b - 1.0).abs() <= share, "{a} {b}");
        let n = Unit::default();
        off(plain.j, n.j, 0.1);
        off(plain.c, n.c, 0.2);
        off(plain.fs0, n.fs0, 0.1);
        off(plain.ke, n.ke, 0.015);
        off(plain.r, n.r, 0.04);
        assert_eq!(plain.ktc, n.ktc);
    }
}

#[test]
fn strength_scales_the_effect() {
    let value = |name: &str, key: &str, strength: f64| {
        Unit::drawn(9, Some(name), strength).expect("known effect").effects[0].get(key)
    };
    for (name, key) in [
        ("stribeck", "torque"),
        ("bias_torque", "torque"),
        ("compliance", "inertia"),
    ] {
        agrees(name, value(name, key, 0.1), 0.1 * value(name, key, 1.0), 1e-12);
    }
    agrees(
        "gain",
        value("current_gain", "gain", 0.1) - 1.0,
        0.1 * (value("current_gain", "gain", 1.0) - 1.0),
        1e-9,
    );
}

#[test]
fn drawn_commands_stay_in_range() {
    for seed in 0..6 {
        let draws: [fn(&mut rand_chacha::ChaCha8Rng) -> Command; 3] = [
            Command::drawn_sines,
            |rng| Command::drawn_staircase(rng, 8.0),
            |rng| Command::drawn_mixture(rng, 8.0),
        ];
        for (n, draw) in (0..).zip(draws) {
            let command = draw(&mut draw::stream(seed, n));
            assert_ne!(command, draw(&mut draw::stream(seed + 1, n)));
            let mut steps = command.steps();
            let (mut last, mut up, mut down) = (0.0, 0.0f64, 0.0f64);
            for k in 0..8_000 {
                let value = steps.next_value();
                (1..1000).for_each(|_| _ = steps.next_value());
                assert!(value.abs() < 1.15 && (k > 0 || value.abs() < 1e-6), "{value}");
                (up, down) = (up.max(value - last), down.min(value - last));
                last = value;
            }
            // Motor speed from the differences over 1 ms.
            let (up, down) = (up * 5e5, down * -5e5);
            assert!(
                up > 10.0 && up < 360.0 && down > 10.0 && down < 360.0,
                "{command:?}: {up} {down}"
            );
        }
    }
}

#[test]
fn sensors_have_the_stated_noise() {
    let (unit, command) = (Unit::default(), Command::Step);
    let exact = record(&unit, &command, 0.5, 1e4, (1.0, 0.0), false, 4);
    let seen = record(&unit, &command, 0.5, 1e4, (1.0, 0.0), true, 4);
    let difference = |a: &[f64], b: &[f64]| -> Vec<f64> { a.iter().zip(b).map(|(a, b)| a - b).collect() };
    agrees(
        "speed",
        rms(difference(&seen.omega_m, &exact.omega_m).into_iter()),
        0.2,
        0.04,
    );
    for q in 0..3 {
        let d = difference(&seen.i[q], &exact.i[q]);
        let offset = mean(&d);
        assert!(offset.abs() < 0.021);
        let count = 50.0f64 / 4096.0;
        let spread = (0.02f64.powi(2) + count * count / 12.0).sqrt();
        agrees("current", rms(d.iter().map(|x| x - offset)), spread, 0.05);
        assert!(seen.i[q].iter().all(|i| ((i / count).round() - i / count).abs() < 1e-6));
    }
    let resolution = std::f64::consts::TAU / 65536.0;
    assert!(
        difference(&seen.theta_m, &exact.theta_m)
            .iter()
            .all(|d| d.abs() < 0.51 * resolution)
    );
    let n = seen.len() - 1;
    agrees("user position", seen.theta_u[n], seen.theta_m[n] / 500.0, 1e-9);
    agrees(
        "i_eq",
        seen.i_eq[n],
        0.5 * (0..3).map(|q| seen.i[q][n].abs()).sum::<f64>(),
        1e-6,
    );
}
