//! The table of test functions that an independent program of the same equations gives: own runs,
//! noise free; speeds and break-away at 100 kHz, P2* at 10 kHz.

use ema_tests::reference_runs;
use schemas::channel::Channel;

/// FSJ, zeta, P1*, ripple*, P2*, P3* [urad].
const TABLE: [[f64; 6]; 8] = [
    [1.0, 0.0, 0.00022778, 0.00022778, 0.0, 4.079],
    [3.0, 0.0, 0.03686, 0.00022497, 0.55957, 15.19],
    [5.0, 0.0, 0.07415, 0.00041981, 1.1061, 24.78],
    [1.0, 0.3, 0.018782, 0.005007, 0.047767, 4.689],
    [3.0, 0.3, 0.053016, 0.0048019, 0.60846, 17.62],
    [5.0, 0.3, 0.087145, 0.0046011, 1.1879, 29.03],
    [1.0, 0.5, 0.050979, 0.0085198, 0.072774, 5.619],
    [5.0, 0.5, 0.11493, 0.007893, 1.2748, 32.58],
];

const NOMINAL_MEAN_RAD_PER_S: f64 = 1.23872;

fn rms(v: impl Iterator<Item = f64>) -> f64 {
    let (mut s, mut n): (f64, f64) = (0.0, 0.0);
    for x in v {
        s += x * x;
        n += 1.0;
    }
    (s / n).sqrt()
}

#[test]
fn val_test_functions() {
    let faults: Vec<(f64, f64)> = TABLE.iter().map(|r| (r[0], r[1])).collect();
    let rate = 100_000.0;
    let step = reference_runs(&faults, "step", rate);
    let sine = reference_runs(&faults, "sine", 10_000.0);
    let ramp = reference_runs(&faults, "ramp", rate);
    let mut worst = [0.0_f64; 4];
    for (i, row) in TABLE.iter().enumerate() {
        let w = &step[i].column(Channel::OmegaM).unwrap()[20_000..65_000];
        let u: Vec<f64> = w.iter().map(|w| w / 500.0).collect();
        let mean = u.iter().sum::<f64>() / u.len() as f64;
        let p1 = rms(u.iter().map(|u| u - NOMINAL_MEAN_RAD_PER_S));
        let ripple = rms(u.iter().map(|u| u - mean));
        let (i0, i1) = (
            sine[0].column(Channel::IEq).unwrap(),
            sine[i].column(Channel::IEq).unwrap(),
        );
        let p2 = rms(i0.iter().zip(i1).map(|(a, b)| a - b));
        let w = ramp[i].column(Channel::OmegaM).unwrap();
        let k = w.iter().position(|w| *w != 0.0).unwrap();
        let p3 = 1e6 * ramp[i].column(Channel::Com).unwrap()[k];
        println!(
            "{:?}: P1* {p1:.6} ripple* {ripple:.7} P2* {p2:.6} P3* {p3:.3}",
            (row[0], row[1])
        );
        for (j, (ours, truth)) in [(p1, row[2]), (ripple, row[3]), (p2, row[4])].into_iter().enumerate() {
            let e = if truth == 0.0 { ours } else { (ours / truth - 1.0).abs() };
            worst[j] = worst[j].max(e);
        }
        worst[3] = worst[3].max((p3 - row[5]).abs());
    }
    println!(
        "largest errors: P1* {:.2e}, ripple* {:.2e}, P2* {:.2e}, P3* {:.3} urad",
        worst[0], worst[1], worst[2], worst[3]
    );
    assert!(worst[0] <= 1e-3 && worst[1] <= 1e-3 && worst[2] <= 1e-3, "{worst:?}");
    // sampling at 100 kHz: 0.01 urad
    assert!(worst[3] <= 0.0105, "{worst:?}");
}
