//! A motor that is fed by a voltage at its terminals, simulated here: with and without its current beside it.

use ema_study::measured::bench::Bench;
use pipeline::discrepancy::{Request, study_file, study_into};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::fmt::Write;
use std::path::{Path, PathBuf};

/// Torque constant [N m/A], resistance [ohm], inductance [H], inertia [kg m2], viscous [N m s/rad] and dry friction [N m].
const MOTOR: [f64; 6] = [0.1, 4.0, 0.008, 3e-4, 4e-4, 0.02];
const RATE_HZ: f64 = 2000.0;

/// What the bench file does not say.
#[derive(Clone, Copy, Default)]
struct Hidden {
    /// amplitude of order 6 [N m]
    cogging: f64,
    /// stiffness [N m/rad] and damping [N m s/rad] of bristles in place of the dry friction
    bristles: Option<[f64; 2]>,
}

/// Twelve seconds under three sines of voltage, held over a sample; noise on current and speed, counts of the angle.
fn recording(run: u64, hidden: Hidden) -> String {
    let [kt, r, l, j, c, f] = MOTOR;
    let (mut i, mut w, mut x, mut z) = (0.0f64, 0.0f64, 0.0f64, 0.0f64);
    let mut rng = ChaCha8Rng::seed_from_u64(77 + run);
    let mut drawn = || rng.random_range(-1.0..1.0);
    let mut text = String::from("t,theta,omega,i,u\n");
    const PARTS: usize = 50;
    let h = 1.0 / RATE_HZ / PARTS as f64;
    for k in 0..(12.0 * RATE_HZ) as usize {
        let t = k as f64 / RATE_HZ;
        let sine = |hz: f64, phase: f64| (std::f64::consts::TAU * hz * t + phase + run as f64).sin();
        let u = 5.0 * sine(0.31, 0.0) + 4.0 * sine(1.7, 1.0) + 3.0 * sine(23.0, 2.0);
        let mut mean = 0.0;
        for _ in 0..PARTS {
            i += h / l * (u - kt * w - r * i);
            let free = w + h / j * (kt * i - c * w - hidden.cogging * (6.0 * x).cos());
            let stop = h / j * f;
            w = match hidden.bristles {
                Some([stiffness, damping]) => {
                    let rate = w - stiffness / f * w.abs() * z;
                    z += h * rate;
                    free - h / j * (stiffness * z + damping * rate)
                }
                None if free.abs() <= stop => 0.0,
                None => free - stop * free.signum(),
            };
            x += h * w;
            mean += i / PARTS as f64;
        }
        let count = std::f64::consts::TAU / 65536.0;
        let (angle, speed) = ((x / count).round() * count, w + 0.02 * drawn());
        let (current, voltage) = (mean + 0.005 * drawn(), u + 0.01 * drawn());
        let at = (k + 1) as f64 / RATE_HZ;
        writeln!(text, "{at},{angle},{speed},{current},{voltage}").unwrap();
    }
    text
}

/// A bench of three such recordings, two to fit and one held out.
fn bench(dir: &Path, hidden: Hidden, with_current: bool, rig: &str) -> PathBuf {
    let mut text = format!(
        "[rig]\nkind = \"rotary\"\ndrive = \"voltage\"\n{rig}\n[channels]\n\
         time = {{ column = \"t\", unit = \"s\" }}\n\
         position = {{ column = \"theta\", unit = \"rad\", resolution = 9.5874e-5 }}\n\
         velocity = {{ column = \"omega\", unit = \"rad/s\" }}\n\
         voltage = {{ column = \"u\", unit = \"V\", sampling = \"mean\" }}\n"
    );
    if with_current {
        text += "current = { column = \"i\", unit = \"A\", sampling = \"mean\" }\n";
    }
    for (run, role) in ["fit", "fit", "heldout"].iter().enumerate() {
        std::fs::write(dir.join(format!("{run}.csv")), recording(run as u64, hidden)).unwrap();
        text += &format!("[[run]]\nfile = \"{run}.csv\"\nrole = \"{role}\"\nhealth = \"healthy\"\n");
    }
    let file = dir.join("BENCH.toml");
    std::fs::write(&file, text).unwrap();
    file
}

/// Constants some per cent off.
const SAID: &str = "drive_constant = { value = 0.102, unit = \"N m/A\", trust = 0.03 }\n\
    resistance = { value = 4.1, unit = \"ohm\", trust = 0.03 }\ninductance = { value = 0.0078, unit = \"H\", trust = 0.05 }\n\
    inertia = { value = 3.2e-4, unit = \"kg m2\", trust = 0.1 }\nviscous = { value = 5e-4, unit = \"N m s/rad\", trust = 0.3 }\n\
    coulomb = { value = 0.022, unit = \"N m\", trust = 0.3 }";

fn request(bench: &Path) -> Request {
    Request {
        bench: vec![bench.to_path_buf()],
        healthy: true,
        ..Request::default()
    }
}

#[test]
fn prop_a_motor_at_its_terminals_is_plain_with_and_without_its_current() {
    for with_current in [true, false] {
        let dir = tempfile::tempdir().unwrap();
        let file = bench(dir.path(), Hidden::default(), with_current, SAID);
        let out = dir.path().join("study");
        let w = study_into(&request(&file), &out, &|_| {}).unwrap();
        let f = &w.findings;
        assert!(
            ["none", "retune"].contains(&f.verdict.as_str()) && f.effects.is_empty(),
            "{with_current}: {} {:?}",
            f.sentence,
            f.names()
        );
        if with_current {
            continue;
        }
        // a gain, a brake and what the back-EMF takes of neither
        let [kt, r, _, _, c, _] = MOTOR;
        for (name, truth) in [("torque_constant", kt / r), ("viscous", c + kt * kt / r)] {
            let found = f.retuned.iter().find(|r| r.name == name).unwrap();
            let sd = (found.hi - found.lo) / 3.92;
            assert!((found.value - truth).abs() < 3.5 * sd, "{name}: {found:?}, {truth}");
        }
        assert!(
            f.assumptions.iter().any(|a| a.contains("back-EMF brakes")),
            "{:?}",
            f.assumptions
        );
        // the written rig is the same machine
        let model = std::fs::read_to_string(w.rig.unwrap()).unwrap();
        let text = std::fs::read_to_string(&file).unwrap();
        let fresh = file.with_file_name("FRESH.toml");
        std::fs::write(&fresh, model.clone() + &text[text.find("[channels]").unwrap()..]).unwrap();
        let (read, before) = (
            Bench::read(&fresh, None).unwrap().rig,
            Bench::read(&file, None).unwrap().rig,
        );
        let value = |name: &str| f.retuned.iter().find(|r| r.name == name).unwrap().value;
        assert!(
            (read.drive_constant.value / value("torque_constant") - 1.0).abs() < 1e-9,
            "{model}"
        );
        assert!((read.viscous.value / value("viscous") - 1.0).abs() < 1e-9, "{model}");
        let lag = |w: Option<ema_study::measured::winding::Winding>| w.unwrap().lag_s();
        assert!((lag(read.winding) / lag(before.winding) - 1.0).abs() < 1e-9);
        let again = study_file(&request(&fresh), &|_| {}).unwrap();
        assert!(again.effects.is_empty(), "{}", again.sentence);
    }
}

#[test]
fn prop_what_hides_in_a_motor_at_its_terminals_is_named() {
    for with_current in [true, false] {
        let dir = tempfile::tempdir().unwrap();
        let cogging = Hidden {
            cogging: 0.004,
            ..Hidden::default()
        };
        let f = study_file(&request(&bench(dir.path(), cogging, with_current, SAID)), &|_| {}).unwrap();
        assert_eq!(f.names(), ["cogging"], "{with_current}: {}", f.sentence);
        let amplitude = &f.effects[0].parameters[0];
        assert!((amplitude.value / 0.004 - 1.0).abs() < 0.1, "{amplitude:?}");
    }
}

#[test]
fn prop_beside_bristles_the_scale_of_torques_is_what_the_back_emf_says() {
    let dir = tempfile::tempdir().unwrap();
    let [kt, _, _, j, c, coulomb] = MOTOR;
    let bristles = [0.1, 2e-3];
    let hidden = Hidden {
        bristles: Some(bristles),
        ..Hidden::default()
    };
    let f = study_file(&request(&bench(dir.path(), hidden, true, SAID)), &|_| {}).unwrap();
    assert_eq!(f.names(), ["presliding"], "{}", f.sentence);
    let constant = |name: &str| f.retuned.iter().find(|r| r.name == name).unwrap();
    let of_machine = [
        ("torque_constant", kt),
        ("inertia", j),
        ("viscous", c),
        ("coulomb", coulomb),
    ];
    let of_effect = f.effects[0].parameters.iter().zip(bristles);
    let told = of_machine.map(|(name, truth)| (constant(name), truth));
    for (found, truth) in told.into_iter().chain(of_effect) {
        let half = 0.5 * (found.hi - found.lo);
        println!("{}: {} of {truth}, within {half}", found.name, found.value);
        assert!((found.value - truth).abs() < 1.5 * half, "{found:?}, {truth}");
        assert!((found.value / truth - 1.0).abs() < 0.02, "{found:?}, {truth}");
        // the sensors' gains are not known, and with them the scale of everything
        assert!(half > 0.004 * truth, "{found:?}");
    }
}

#[test]
fn prop_a_winding_without_a_resistance_is_refused() {
    let dir = tempfile::tempdir().unwrap();
    let without: String = SAID
        .lines()
        .filter(|l| !l.starts_with("resistance"))
        .collect::<Vec<_>>()
        .join("\n");
    let file = bench(dir.path(), Hidden::default(), false, &without);
    let e = Bench::read(&file, None).unwrap_err().to_string();
    assert!(e.contains("resistance") && e.contains("a channel `current`"), "{e}");
    // with the current nobody needs it
    let file = bench(dir.path(), Hidden::default(), true, &without);
    assert!(Bench::read(&file, None).unwrap().rig.winding.is_none());
}
