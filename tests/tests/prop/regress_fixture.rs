//! The numerical test bench against its own past: every 40th sample of three runs at 1 kHz, made by
//! the revision that agreed with the independent reference to 1e-11.

use ema_tests::{CSV_CHANNELS, read_csv, reference_runs, relative_rms};

#[test]
fn regress_preflight_fixture() {
    let dir = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("fixtures");
    let cases = [("1", "0", 1.0, 0.0), ("3", "0.3", 3.0, 0.3), ("4.3", "0.12", 4.3, 0.12)];
    let runs = reference_runs(&cases.map(|c| (c.2, c.3)), "preflight", 1000.0);
    for ((f, z, _, _), run) in cases.iter().zip(&runs) {
        let truth = read_csv(&dir.join(format!("preflight_fsj{f}_zeta{z}.csv")));
        assert_eq!(truth[0].len(), 75);
        for (i, c) in CSV_CHANNELS.iter().enumerate() {
            let ours: Vec<f64> = run.column(*c).unwrap().iter().copied().skip(39).step_by(40).collect();
            let e = relative_rms(&truth[i + 1], &ours);
            assert!(e <= 1e-6, "FSJ {f} zeta {z} {}: {e:e}", c.name());
        }
    }
}
