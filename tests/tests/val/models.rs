//! The simplified model beside the numerical test bench, and the paper's four cases.

use diagnoser::diagnosis::{COVERAGE, Diagnoser};
use ema_tests::{reference_run, reference_runs, relative_rms};
use pipeline::calibrate::{Effort, calibrate};
use pipeline::demo::{TABLE_I, quantile, statistics};
use schemas::channel::Channel;
use schemas::fault::FaultState;
use sim_worker::extractor::FeaturePlan;
use sim_worker::monitor::MonitorTrack;
use sim_worker::parameters::ActuatorParameters;
use sim_worker::sensor::SensorModel;
use sim_worker::spread::Spread;
use std::sync::Arc;

fn rms(v: &[f64]) -> f64 {
    (v.iter().map(|x| x * x).sum::<f64>() / v.len() as f64).sqrt()
}

#[test]
fn val_simplified_model_follows_the_bench() {
    let p = ActuatorParameters::reference();
    for (name, size, bound) in [("ramp", 1e-3, 0.005), ("sine", 1e-3, 0.005), ("step", 1.0, 0.01)] {
        let s = sim_worker::catalogue::sequence(name).unwrap();
        let ntb = reference_run(1.0, 0.0, name, 1e4);
        let sm = MonitorTrack::run(&p, &s, 1e4);
        let theta = ntb.column(Channel::ThetaU).unwrap();
        let d: Vec<f64> = theta.iter().zip(&sm.theta_u_rad).map(|(a, b)| a - b).collect();
        let worst = d.iter().fold(0.0_f64, |m, x| m.max(x.abs())) / size;
        let speed = relative_rms(ntb.column(Channel::OmegaM).unwrap(), &sm.omega_rad_per_s);
        let current = relative_rms(ntb.column(Channel::IEq).unwrap(), &sm.abs_current_a);
        println!(
            "{name}: position {:.2} % at most, {:.2} % rms; speed {:.2} % rms; |current| {:.1} % rms",
            100.0 * worst,
            100.0 * rms(&d) / size,
            100.0 * speed,
            100.0 * current
        );
        assert!(worst <= bound, "{name}: {worst}");
        // the ramp runs at half a rad/s: there the bench's switching ripple alone is 1.5 %
        assert!(speed <= if name == "ramp" { 0.025 } else { 0.01 }, "{name}: {speed}");
    }
}

type ReferenceMaps = (SensorModel, Diagnoser, Arc<FeaturePlan>);

/// Maps of the reference actuator on the fine grid, through the reference sensors, calibrated.
fn reference_maps(dir: &std::path::Path) -> ReferenceMaps {
    let (set, setup) = ema_tests::coverage::reference_maps(dir, "fine", 0.0).unwrap();
    let made = calibrate(&set, &setup, &Spread::none(), Effort::QUICK)
        .unwrap()
        .unwrap();
    let diagnoser = Diagnoser::new(set, Some(made), COVERAGE, &Vec::new()).unwrap();
    let plan = Arc::new(setup.feature_plan());
    (setup.sensors.unwrap(), diagnoser, plan)
}

#[test]
fn val_table_one() {
    let cache = tempfile::tempdir().unwrap();
    let (sensors, diagnoser, plan) = reference_maps(&cache.path().join("maps"));
    let faults: Vec<(f64, f64)> = TABLE_I.iter().map(|&(z, f, _, _)| (f, z)).collect();
    let runs = reference_runs(&faults, "preflight", 1e4);
    for (&(zeta, fsj, paper_zeta, paper_fsj), run) in TABLE_I.iter().zip(&runs) {
        let s = statistics(run, FaultState { fsj, zeta }, &diagnoser, &plan, &sensors, 100);
        // where the paper prints 0 its grid held the value: within 1 % then
        let bar = |p: f64| if p == 0.0 { 1.0 } else { p };
        let (z50, z95) = (quantile(&s.zeta_error, 0.5), quantile(&s.zeta_error, 0.95));
        let (f50, f95) = (quantile(&s.fsj_error, 0.5), quantile(&s.fsj_error, 0.95));
        println!(
            "zeta {zeta}, FSJ {fsj}: median {z50:.2} % {f50:.2} %, 95th {z95:.2} % {f95:.2} %, inside {:.0} %, widths {:.4} {:.3}",
            100.0 * s.inside,
            s.zeta_width,
            s.fsj_width
        );
        assert!(z50 <= bar(paper_zeta) && f50 <= bar(paper_fsj));
        assert!(z95 <= 2.0 * bar(paper_zeta) && f95 <= 2.0 * bar(paper_fsj));
        // at one pair the map's own error is always the same, so that the coverage there may be any
        println!("    inside {:.0} %", 100.0 * s.inside);
    }
}
