//! A plain rig for tests of the study: checks of the code, no judge of it.

use crate::measured::bench::Bench;
use crate::measured::recording::{Run, read_runs};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use std::f64::consts::TAU;
use std::fmt::Write;
use tempfile::TempDir;

/// Nominal inertia [kg m2]; it is 5 % more.
pub const INERTIA: f64 = 1e-3;

/// Bench and recordings of a rig whose motion is prescribed, and whose torque has something besides.
///
/// * `besides` by run, time, angle, speed, acceleration and the torque without it [s, rad, rad/s, rad/s2, N m]; in N m
pub fn rig(besides: impl Fn(usize, [f64; 5]) -> f64) -> (Bench, Vec<Run>) {
    under_load(besides, None)
}

/// The same under a load that acts on the motor and is recorded.
///
/// * `load` against the motion, by time [s]; in N m
pub fn under_load(besides: impl Fn(usize, [f64; 5]) -> f64, load: Option<&dyn Fn(f64) -> f64>) -> (Bench, Vec<Run>) {
    let dir = tempfile::tempdir().unwrap();
    let mut bench = format!(
        "[rig]\nkind = \"rotary\"\ndrive = \"torque\"\ninertia = {{ value = {INERTIA}, unit = \"kg m2\", trust = 0.2 }}\n\
         viscous = {{ value = 4e-3, unit = \"N m s/rad\", trust = 0.3 }}\ncoulomb = {{ value = 0.2, unit = \"N m\", trust = 0.3 }}\n\
         [channels]\ntime = {{ column = \"t\", unit = \"s\" }}\nposition = {{ column = \"x\", unit = \"rad\" }}\n\
         torque = {{ column = \"torque\", unit = \"N m\" }}\n"
    );
    if load.is_some() {
        bench += "load = { column = \"load\", unit = \"N m\" }\n";
    }
    let mut white = noise();
    for run in 0..3 {
        let lines: Vec<[f64; 3]> = (0..4)
            .map(|i| {
                let hz = 0.31 + 0.57 * f64::from(i) + 0.13 * run as f64;
                [1.5 / (1.0 + f64::from(i)), TAU * hz, 0.7 * run as f64 + f64::from(i)]
            })
            .collect();
        let mut csv = if load.is_some() {
            "t,x,torque,load\n"
        } else {
            "t,x,torque\n"
        }
        .to_string();
        for k in 0..8000 {
            let t = f64::from(k) * 1e-3;
            let (mut x, mut w, mut a) = (0.0, 0.0, 0.0);
            for [size, rate, phase] in &lines {
                let (sin, cos) = (rate * t + phase).sin_cos();
                (x, w, a) = (x + size * sin, w + size * rate * cos, a - size * rate * rate * sin);
            }
            let torque = 1.05 * INERTIA * a + 5e-3 * w + 0.22 * w.signum();
            let torque = torque + besides(run, [t, x, w, a, torque]) + white(0.01);
            write!(csv, "{t:.4},{:.8}", x + white(2e-5)).unwrap();
            match load.map(|of| of(t)) {
                Some(load) => writeln!(csv, ",{:.6},{load:.6}", torque + load).unwrap(),
                None => writeln!(csv, ",{torque:.6}").unwrap(),
            }
        }
        put(&dir, run, csv, &mut bench);
    }
    read(&dir, bench)
}

/// What the motion of [`axis`] is measured with.
#[derive(Clone, Copy)]
pub enum Sensor {
    /// by the rms of its noise [rad/s]
    Speed(f64),
    /// by its step [rad]
    Angle(f64),
}

/// Bench and recordings of a servo axis that moves, stops and rests, its winding warmer by 51 K where it is `warm`: a current drive
/// with voltages, whose resistance is known well and whose inertia is a third more than it is said to be.
pub fn axis(rate_hz: f64, sensor: Sensor, warm: bool) -> (Bench, Vec<Run>) {
    const KT: f64 = 0.25;
    let dir = tempfile::tempdir().unwrap();
    let motion = match sensor {
        Sensor::Speed(_) => "velocity = { column = \"motion\", unit = \"rad/s\" }".to_string(),
        Sensor::Angle(step) => format!("position = {{ column = \"motion\", unit = \"rad\", resolution = {step:?} }}"),
    };
    let mut bench = format!(
        "[rig]\nkind = \"rotary\"\ndrive = \"current\"\ndrive_constant = {{ value = {KT}, unit = \"N m/A\", trust = 0.02 }}\n\
         inertia = {{ value = 1.5e-4, unit = \"kg m2\", trust = 0.15 }}\nresistance = {{ value = 2, unit = \"ohm\", trust = 0.005 }}\n\
         inductance = {{ value = 1e-5, unit = \"H\", trust = 0.1 }}\n\
         back_emf_constant = {{ value = {KT}, unit = \"V s/rad\", trust = 0.02 }}\nsupply_voltage = 200\n\
         [channels]\ntime = {{ column = \"t\", unit = \"s\" }}\n{motion}\n\
         current = {{ column = \"i\", unit = \"A\" }}\nvoltage = {{ column = \"v\", unit = \"V\" }}\n"
    );
    let resistance = if warm { 2.4 } else { 2.0 };
    // a second of its way up or down in half a cosine
    let (up, rate_of_up) = (
        |u: f64| 0.5 - 0.5 * (TAU / 2.0 * u.clamp(0.0, 1.0)).cos(),
        |u: f64| {
            if (0.0..1.0).contains(&u) {
                TAU / 4.0 * (TAU / 2.0 * u).sin()
            } else {
                0.0
            }
        },
    );
    let mut white = noise();
    for run in 0..3 {
        let (mut csv, mut x, mut before) = ("t,motion,i,v\n".to_string(), 0.0, 0.0);
        for k in 0..(12.0 * rate_hz) as usize {
            let t = k as f64 / rate_hz;
            let moment = t + 0.07 * run as f64;
            let (cycle, within) = ((moment / 0.5).floor(), moment % 0.5);
            let most =
                (40.0 + 25.0 * ((7.0 * cycle + 3.0 * run as f64) % 5.0)) * if cycle % 2.0 == 0.0 { 1.0 } else { -1.0 };
            let of = |f: &dyn Fn(f64) -> f64| most * (f(within / 0.1) - f((within - 0.25) / 0.1));
            let (w, a) = (of(&up), of(&rate_of_up) / 0.1);
            let friction = if within > 0.0 && within < 0.35 {
                0.13 * w.signum()
            } else {
                0.0
            };
            let i = (2e-4 * a + 5e-4 * w + friction) / KT;
            let v = resistance * i + 1e-5 * (i - before) * rate_hz + KT * w;
            (x, before) = (x + w / rate_hz, i);
            let seen = match sensor {
                Sensor::Speed(rms) => w + white(rms),
                Sensor::Angle(step) => (x / step).round() * step,
            };
            writeln!(csv, "{t:.5},{seen:.9},{:.5},{:.5}", i + white(0.02), v + white(0.05)).unwrap();
        }
        put(&dir, run, csv, &mut bench);
    }
    read(&dir, bench)
}

/// White noise of a given rms.
fn noise() -> impl FnMut(f64) -> f64 {
    let mut noise = ChaCha8Rng::seed_from_u64(5);
    move |size: f64| size * ((0..12).map(|_| noise.random::<f64>()).sum::<f64>() - 6.0)
}

/// A run's file, and its lines in the bench; the last of three is held out.
fn put(dir: &TempDir, run: usize, csv: String, bench: &mut String) {
    std::fs::write(dir.path().join(format!("run{run}.csv")), csv).unwrap();
    let role = if run == 2 { "heldout" } else { "fit" };
    write!(
        bench,
        "[[run]]\nfile = \"run{run}.csv\"\nrole = \"{role}\"\nhealth = \"healthy\"\n"
    )
    .unwrap();
}

fn read(dir: &TempDir, bench: String) -> (Bench, Vec<Run>) {
    let file = dir.path().join("bench.toml");
    std::fs::write(&file, bench).unwrap();
    let bench = Bench::read(&file, None).unwrap();
    let runs = read_runs(&bench).unwrap();
    (bench, runs)
}
