//! A plain rig for tests of the study: checks of the code, no judge of it.

use crate::measured::bench::Bench;
use crate::measured::recording::{Run, read_runs};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use std::f64::consts::TAU;
use std::fmt::Write;

/// Nominal inertia [kg m2]; it is 5 % more.
pub const INERTIA: f64 = 1e-3;

/// Bench and recordings of a rig whose motion is prescribed, and whose torque has something besides.
///
/// * `besides` by run, time, angle, speed, acceleration and the torque without it [s, rad, rad/s, rad/s2, N m]; in N m
pub fn rig(besides: impl Fn(usize, [f64; 5]) -> f64) -> (Bench, Vec<Run>) {
    let dir = tempfile::tempdir().unwrap();
    let mut bench = format!(
        "[rig]\nkind = \"rotary\"\ndrive = \"torque\"\ninertia = {{ value = {INERTIA}, unit = \"kg m2\", trust = 0.2 }}\n\
         viscous = {{ value = 4e-3, unit = \"N m s/rad\", trust = 0.3 }}\ncoulomb = {{ value = 0.2, unit = \"N m\", trust = 0.3 }}\n\
         [channels]\ntime = {{ column = \"t\", unit = \"s\" }}\nposition = {{ column = \"x\", unit = \"rad\" }}\n\
         torque = {{ column = \"torque\", unit = \"N m\" }}\n"
    );
    let mut noise = ChaCha8Rng::seed_from_u64(5);
    let mut white = |size: f64| size * ((0..12).map(|_| noise.random::<f64>()).sum::<f64>() - 6.0);
    for run in 0..3 {
        let lines: Vec<[f64; 3]> = (0..4)
            .map(|i| {
                let hz = 0.31 + 0.57 * f64::from(i) + 0.13 * run as f64;
                [1.5 / (1.0 + f64::from(i)), TAU * hz, 0.7 * run as f64 + f64::from(i)]
            })
            .collect();
        let mut csv = "t,x,torque\n".to_string();
        for k in 0..8000 {
            let t = f64::from(k) * 1e-3;
            let (mut x, mut w, mut a) = (0.0, 0.0, 0.0);
            for [size, rate, phase] in &lines {
                let (sin, cos) = (rate * t + phase).sin_cos();
                (x, w, a) = (x + size * sin, w + size * rate * cos, a - size * rate * rate * sin);
            }
            let torque = 1.05 * INERTIA * a + 5e-3 * w + 0.22 * w.signum();
            let torque = torque + besides(run, [t, x, w, a, torque]) + white(0.01);
            writeln!(csv, "{t:.4},{:.8},{torque:.6}", x + white(2e-5)).unwrap();
        }
        std::fs::write(dir.path().join(format!("run{run}.csv")), csv).unwrap();
        let role = if run == 2 { "heldout" } else { "fit" };
        write!(
            bench,
            "[[run]]\nfile = \"run{run}.csv\"\nrole = \"{role}\"\nhealth = \"healthy\"\n"
        )
        .unwrap();
    }
    let file = dir.path().join("bench.toml");
    std::fs::write(&file, bench).unwrap();
    let bench = Bench::read(&file, None).unwrap();
    let runs = read_runs(&bench).unwrap();
    (bench, runs)
}
