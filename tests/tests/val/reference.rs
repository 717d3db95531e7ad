//! The numerical test bench against an independent program of the same equations.

use ema_tests::{CSV_CHANNELS, folder, read_csv, reference_run, relative_rms};

fn agree(file: &str, fsj: f64, zeta: f64, sequence: &str, rate_hz: f64) {
    let Some(dir) = folder("EMA_REFERENCE_DIR") else { return };
    let truth = read_csv(&dir.join(file));
    let ours = reference_run(fsj, zeta, sequence, rate_hz);
    for (i, c) in CSV_CHANNELS.iter().enumerate() {
        let e = relative_rms(&truth[i + 1], ours.column(*c).unwrap());
        println!("{file} {}: relative rms {e:.2e}", c.name());
        assert!(e <= 1e-6, "{file} {}: {e:e}", c.name());
    }
}

#[test]
fn val_preflight_healthy() {
    agree("preflight_fsj1_zeta0.csv", 1.0, 0.0, "preflight", 1000.0);
}

#[test]
fn val_preflight_faulty() {
    agree("preflight_fsj3_zeta0.3.csv", 3.0, 0.3, "preflight", 1000.0);
}

#[test]
fn val_preflight_faulty_10_khz() {
    agree("preflight_fsj3_zeta0.3_10kHz.csv", 3.0, 0.3, "preflight", 10_000.0);
}

#[test]
fn val_sine_faulty() {
    agree("sine_fsj2_zeta0.2.csv", 2.0, 0.2, "sine", 1000.0);
}
