//! The study on a motor of its own equations whose current and voltage are both recorded: what smoothing, sampling and delays may
//! not make of its winding; a load on a spring and an angle sensor out of centre that no second sensor sees.

use ema_study::told::findings::Findings;
use pipeline::discrepancy::{Request, study_file};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use sim_worker::effect::COPPER_PER_K;
use std::f64::consts::TAU;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

/// Constants of the motor [SI], and what is hidden [V].
struct Motor {
    resistance: f64,
    inductance: f64,
    torque_constant: f64,
    inertia: f64,
    coulomb: f64,
    viscous: f64,
    dead_time: f64,
    /// how much warmer than the bench says the winding is [K]
    warmer: f64,
    /// what the current's sensor shows too much [A]
    offset: f64,
    /// of the encoder, a turn, and how far it is out of centre [rad]
    counts: f64,
    out_of_centre: f64,
    /// stiffness [N m/rad] and damping [N m s/rad] of the spring before the load, and what of the inertia is the load's [kg m2]
    spring: Option<(f64, f64, f64)>,
}

/// Steps of the integration in a sample, and samples a second.
const STEPS: usize = 50;
const RATE_HZ: f64 = 1000.0;
/// Counts of the second encoder, a turn.
const GEAR_COUNTS: f64 = 4096.0;
const VOLTAGE: &str = "voltage = { column = \"voltage\", unit = \"V\", sampling = \"mean\", noise = 0.01 }\n";

/// Noise of rms 1, even.
fn noise(rng: &mut ChaCha8Rng) -> f64 {
    3f64.sqrt() * rng.random_range(-1.0..1.0)
}

impl Motor {
    fn new(dead_time: f64) -> Self {
        Self {
            resistance: 0.8,
            inductance: 2.4e-3,
            torque_constant: 0.08,
            inertia: 5e-5,
            coulomb: 0.03,
            viscous: 1e-4,
            dead_time,
            warmer: 0.0,
            offset: 0.0,
            counts: 8192.0,
            out_of_centre: 0.0,
            spring: None,
        }
    }

    /// A run under a voltage of some sines and steps, recorded as means over the samples and an encoder's counts.
    ///
    /// * `seed` of phases and noise
    fn recorded(&self, seed: u64, duration_s: f64) -> String {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let sines: Vec<(f64, f64, f64)> = [0.3, 0.7, 1.9, 4.3, 11.0, 23.0]
            .into_iter()
            .map(|hz| (hz, 1.2, rng.random_range(0.0..TAU)))
            .collect();
        let h = 1.0 / (RATE_HZ * STEPS as f64);
        let (mut i, mut w, mut theta) = (0.0_f64, 0.0_f64, 0.0_f64);
        let mut csv = String::from("t,angle,current,voltage,gear\n");
        let mut step = 0.0;
        let (mut load_theta, mut load_w) = (0.0_f64, 0.0_f64);
        let resistance = self.resistance * (1.0 + COPPER_PER_K * self.warmer);
        for k in 0..(duration_s * RATE_HZ) as usize {
            if k % 37 == 0 {
                step = rng.random_range(-1.5..1.5);
            }
            let (mut mean_i, mut mean_v) = (0.0, 0.0);
            for s in 0..STEPS {
                let t = k as f64 / RATE_HZ + s as f64 * h;
                let v = step + sines.iter().map(|(hz, a, p)| a * (TAU * hz * t + p).sin()).sum::<f64>();
                let lost = self.dead_time * (i / 0.02).tanh();
                i += h * (v - lost - resistance * i - self.torque_constant * w) / self.inductance;
                let mut push = self.torque_constant * i - self.viscous * w;
                let mut inertia = self.inertia;
                if let Some((stiffness, damping, load)) = self.spring {
                    let bent = stiffness * (theta - load_theta) + damping * (w - load_w);
                    (push, inertia) = (push - bent, inertia - load);
                    load_w += h * bent / load;
                    load_theta += h * load_w;
                }
                let moved = w + h * (push - self.coulomb * w.signum()) / inertia;
                // dry friction stops what it would turn over
                w = if w * moved < 0.0 && push.abs() < self.coulomb {
                    0.0
                } else {
                    moved
                };
                theta += h * w;
                mean_i += i / STEPS as f64;
                mean_v += v / STEPS as f64;
            }
            let seen = theta + self.out_of_centre * (theta + 0.7).sin();
            let angle = (seen / TAU * self.counts).floor() / self.counts * 360.0;
            let (a, b) = (0.01 * noise(&mut rng), 0.01 * noise(&mut rng));
            let t = (k + 1) as f64 / RATE_HZ;
            // a second encoder, on the motor's side of the spring
            let gear = (theta / TAU * GEAR_COUNTS).floor() / GEAR_COUNTS * 360.0;
            writeln!(csv, "{t:.4},{angle},{},{},{gear}", mean_i + self.offset + a, mean_v + b).unwrap();
        }
        csv
    }

    /// Two runs and their bench, whose constants are a little off.
    fn bench(&self, dir: &Path) -> PathBuf {
        self.bench_with(dir, VOLTAGE)
    }

    /// * `more` lines of further channels
    fn bench_with(&self, dir: &Path, more: &str) -> PathBuf {
        for (name, seed) in [("fit", 1), ("proof", 2)] {
            std::fs::write(dir.join(format!("{name}.csv")), self.recorded(seed, 20.0)).unwrap();
        }
        // a winding that is warmer than it is said to be is one whose resistance is known
        let (of_resistance, trust) = if self.warmer > 0.0 { (1.003, 0.005) } else { (1.05, 0.1) };
        let text = format!(
            "[rig]\nkind = \"rotary\"\ndrive = \"current\"\n\
             drive_constant = {{ value = {}, unit = \"N m/A\", trust = 0.02 }}\n\
             inertia = {{ value = {}, unit = \"kg m2\", trust = 0.2 }}\n\
             resistance = {{ value = {}, unit = \"ohm\", trust = {trust} }}\n\
             inductance = {{ value = {}, unit = \"H\", trust = 0.2 }}\n\
             [channels]\n\
             time = {{ column = \"t\", unit = \"s\" }}\n\
             position = {{ column = \"angle\", unit = \"deg\", resolution = {} }}\n\
             current = {{ column = \"current\", unit = \"A\", sampling = \"mean\", noise = 0.01 }}\n\
             {more}\
             [[run]]\nfile = \"fit.csv\"\nrole = \"fit\"\nhealth = \"healthy\"\n\
             [[run]]\nfile = \"proof.csv\"\nrole = \"heldout\"\nhealth = \"healthy\"\n",
            1.01 * self.torque_constant,
            0.92 * self.inertia,
            of_resistance * self.resistance,
            0.9 * self.inductance,
            360.0 / self.counts,
        );
        let path = dir.join("bench.toml");
        std::fs::write(&path, text).unwrap();
        path
    }
}

fn studied(write: impl Fn(&Path) -> PathBuf) -> Findings {
    let dir = tempfile::tempdir().unwrap();
    let bench = vec![write(dir.path())];
    let request = Request {
        bench,
        ..Request::default()
    };
    study_file(&request, &|_| {}).unwrap()
}

fn holds(f: &Findings, name: &str, truth: f64, within: f64) {
    let c = f.retuned.iter().find(|c| c.name == name).unwrap();
    assert!(c.lo <= truth && truth <= c.hi, "{name} {truth}: {c:?}");
    assert!((c.value / truth - 1.0).abs() < within, "{name} {truth}: {c:?}");
}

/// A coarse encoder makes a wide smoother; what it takes from the speed is not the winding's.
#[test]
fn prop_an_inductance_is_not_what_the_smoother_takes_from_the_speed() {
    let motor = Motor::new(0.0);
    let f = studied(|dir| motor.bench(dir));
    assert!(["none", "retune"].contains(&f.verdict.as_str()), "{}", f.sentence);
    holds(&f, "inductance", motor.inductance, 0.06);
    holds(&f, "resistance", motor.resistance, 0.03);
}

#[test]
fn prop_the_voltage_that_a_bridge_loses_is_not_the_windings() {
    let motor = Motor::new(0.4);
    let f = studied(|dir| motor.bench(dir));
    assert_eq!(f.names(), ["dead_time"], "{}", f.sentence);
    // of the channel in which the effect lives
    assert!(f.sentence.contains("the gap in voltage"), "{}", f.sentence);
    let voltage = &f.effects[0].parameters[0];
    assert!(voltage.lo <= 0.4 && 0.4 <= voltage.hi, "{voltage:?}");
    holds(&f, "inductance", motor.inductance, 0.06);
}

/// A winding that is warm from the beginning to the end is another resistance than is known.
#[test]
fn prop_a_winding_that_is_warm_all_the_time_is_no_bridge() {
    let motor = Motor {
        warmer: 60.0,
        ..Motor::new(0.0)
    };
    let f = studied(|dir| motor.bench(dir));
    assert_eq!(f.names(), ["winding_heating"], "{}", f.sentence);
    let warmer = &f.effects[0].parameters[0];
    assert!(warmer.lo <= 60.0 && 60.0 <= warmer.hi, "{warmer:?}");
    assert!((warmer.value / 60.0 - 1.0).abs() < 0.1, "{warmer:?}");
}

/// What a bridge loses goes by the current that flows, not by the one that is shown.
#[test]
fn prop_a_bridge_beside_an_offset_of_the_current() {
    let motor = Motor {
        offset: 0.4,
        ..Motor::new(0.4)
    };
    let f = studied(|dir| motor.bench(dir));
    let mut names = f.names();
    names.sort_unstable();
    assert_eq!(names, ["current_offset", "dead_time"], "{}", f.sentence);
    for (name, truth) in [("current_offset", 0.4), ("dead_time", 0.4)] {
        let effect = f.effects.iter().find(|e| e.name == name).unwrap();
        let p = &effect.parameters[0];
        assert!((p.value / truth - 1.0).abs() < 0.05, "{name} {p:?}");
    }
}

/// Nothing but the torque shows it: the recording has no second angle, or one on the motor's side of the spring.
#[test]
fn prop_a_load_on_its_spring_is_heard_in_the_torque() {
    let (stiffness, damping, load) = (0.7, 4e-4, 2e-5);
    let motor = Motor {
        counts: 65536.0,
        spring: Some((stiffness, damping, load)),
        ..Motor::new(0.0)
    };
    // a second angle before the spring turns with the motor, and is told as such
    let gear = format!(
        "user_position = {{ column = \"gear\", unit = \"deg\", resolution = {} }}\n",
        360.0 / GEAR_COUNTS
    );
    for (more, before) in [("", false), (gear.as_str(), true)] {
        let f = studied(|dir| motor.bench_with(dir, &format!("{VOLTAGE}{more}")));
        assert_eq!(f.names(), ["compliance"], "{}", f.sentence);
        for (p, truth) in f.effects[0].parameters.iter().zip([stiffness, damping, load]) {
            assert!((p.value / truth - 1.0).abs() < 0.1, "{truth}: {p:?}");
        }
        holds(&f, "inertia", motor.inertia, 0.05);
        let told = f.assumptions.iter().any(|a| a.contains("beyond the user's sensor"));
        assert_eq!(told, before, "{:?}", f.assumptions);
    }
}

/// One angle and one current: the torque that the motion takes shows what the angle has too much.
#[test]
fn prop_an_angle_sensor_out_of_centre_is_heard_in_the_torque() {
    let motor = Motor {
        counts: 65536.0,
        out_of_centre: 0.05,
        ..Motor::new(0.0)
    };
    let f = studied(|dir| motor.bench_with(dir, ""));
    assert_eq!(f.names(), ["encoder_eccentricity"], "{}", f.sentence);
    let amplitude = &f.effects[0].parameters[0];
    assert!((amplitude.value / 0.05 - 1.0).abs() < 0.1, "{amplitude:?}");
}

/// A servo that follows a speed of some sines, with a cogging; its current is read at points.
fn servo(seed: u64, references: [(f64, f64); 3]) -> String {
    let (kt, inertia, viscous, coulomb) = (0.11, 8.3e-5, 2e-4, 0.02);
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let h = 1e-3 / 20.0;
    let (mut theta, mut w, mut sum) = (0.0_f64, 0.0_f64, 0.0_f64);
    let mut csv = String::from("time_s,pos_deg,speed_rpm,current_A\n");
    for k in 0..12_000 {
        let t = k as f64 * 1e-3;
        let wanted = references.iter().map(|(a, hz)| a * (TAU * hz * t).sin()).sum::<f64>();
        sum += 1e-3 * (wanted - w);
        let i = (0.02 * (wanted - w) + 0.6 * sum).clamp(-5.0, 5.0);
        let counts = (theta.to_degrees() / 0.005).round() * 0.005;
        let (rpm, amps) = (w * 60.0 / TAU + noise(&mut rng), i + 0.01 * noise(&mut rng));
        writeln!(csv, "{t:.3},{counts:.3},{rpm:.6},{amps:.6}").unwrap();
        for _ in 0..20 {
            let cogging = 0.006 * (8.0 * theta + 0.4).sin();
            w += h * (kt * i - viscous * w - coulomb * (w / 0.02).tanh() - cogging) / inertia;
            theta += h * w;
        }
    }
    csv
}

/// What a cogging makes of a reversal had looked like a current that is early.
#[test]
fn prop_a_delay_that_an_effect_explains_is_none() {
    let f = studied(|dir| {
        let runs = [
            ("monday", 1, [(12.0, 0.25), (8.0, 0.7), (5.0, 1.7)]),
            ("tuesday", 2, [(15.0, 0.2), (6.0, 0.9), (4.0, 2.1)]),
        ];
        for (name, seed, references) in runs {
            std::fs::write(dir.join(format!("{name}.csv")), servo(seed, references)).unwrap();
        }
        let text = "[rig]\nkind = \"rotary\"\ndrive = \"current\"\n\
             drive_constant = { value = 0.11, unit = \"N m/A\", trust = 0.01 }\n\
             inertia = { value = 8e-5, unit = \"kg m2\", trust = 0.3 }\n\
             [channels]\n\
             time = { column = \"time_s\", unit = \"s\" }\n\
             position = { column = \"pos_deg\", unit = \"deg\" }\n\
             velocity = { column = \"speed_rpm\", unit = \"rpm\" }\n\
             current = { column = \"current_A\", unit = \"A\", sampling = \"point\" }\n\
             [[run]]\nfile = \"monday.csv\"\nrole = \"fit\"\nhealth = \"healthy\"\n\
             [[run]]\nfile = \"tuesday.csv\"\nrole = \"heldout\"\nhealth = \"healthy\"\n";
        let bench = dir.join("rig.toml");
        std::fs::write(&bench, text).unwrap();
        bench
    });
    assert_eq!(f.names(), ["cogging"], "{}", f.sentence);
    let late = f.assumptions.iter().find(|a| a.contains("later than the bench says"));
    assert_eq!(late, None);
    let amplitude = f.effects[0].parameters.iter().find(|p| p.name == "amplitude").unwrap();
    assert!((amplitude.value / 0.006 - 1.0).abs() < 0.02, "{amplitude:?}");
}
