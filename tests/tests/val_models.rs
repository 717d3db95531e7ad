//! The simplified model beside the numerical test bench, and the paper's four cases.

use diagnoser::diagnosis::{Diagnosis, diagnose};
use diagnoser::extractor::{FeatureExtractor, FeaturePlan};
use diagnoser::failure_map::FailureMapSet;
use ema_tests::{reference_run, reference_runs, relative_rms};
use pipeline::demo::{TABLE_I, quantile, statistics};
use pipeline::maps::{MapRequest, made};
use schemas::channel::{Channel, ChannelSet};
use schemas::fault::FaultState;
use schemas::sequence::TestSequence;
use schemas::telemetry::{Collector, TelemetryBuffer};
use sim_worker::monitor::MonitorTrack;
use sim_worker::parameters::ActuatorParameters;
use sim_worker::sensor::{SensorModel, SensorNoise, Sensors};
use std::sync::Arc;

fn rms(v: &[f64]) -> f64 {
    (v.iter().map(|x| x * x).sum::<f64>() / v.len() as f64).sqrt()
}

#[test]
fn val_simplified_model_follows_the_bench() {
    let p = ActuatorParameters::reference();
    for (name, size, bound) in [("ramp", 1e-3, 0.005), ("sine", 1e-3, 0.005), ("step", 1.0, 0.01)] {
        let s = sim_worker::datasets::sequence(name).unwrap();
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

type ReferenceMaps = (
    Arc<ActuatorParameters>,
    TestSequence,
    SensorModel,
    FailureMapSet,
    Arc<FeaturePlan>,
);

/// Maps of the reference actuator on the fine grid, through the reference sensors.
fn reference_maps(dir: &std::path::Path) -> ReferenceMaps {
    let actuator = Arc::new(ActuatorParameters::reference());
    let sequence = sim_worker::datasets::sequence("preflight").unwrap();
    let sensors = sim_worker::datasets::sensors("reference").unwrap().unwrap();
    let request = MapRequest {
        actuator: actuator.clone(),
        sequence: sequence.clone(),
        rate_hz: 1e4,
        sensors: Some(sensors.clone()),
        rest_angle_rad: 0.0,
        equivalent_current: false,
        grid: sim_worker::datasets::grid("fine").unwrap(),
    };
    let set = made(dir, &request).unwrap();
    let plan = Arc::new(FeaturePlan::new(&actuator, &sequence, 1e4, false));
    (actuator, sequence, sensors, set, plan)
}

/// A simulated run through the sensors and the maps.
fn one_diagnosis(
    run: &Collector,
    set: &FailureMapSet,
    plan: &Arc<FeaturePlan>,
    sensors: &SensorModel,
    actuator: &ActuatorParameters,
    seed: u64,
) -> Diagnosis {
    let noise = SensorNoise::new(seed, run.rows());
    let s = Sensors {
        model: sensors,
        noise: &noise,
        gear_ratio: actuator.gear_ratio,
        rest_angle_rad: 0.0,
    };
    let mut out = TelemetryBuffer::new(ChannelSet::basic(), run.rows());
    s.measure(&run.view(), &mut out);
    let mut x = FeatureExtractor::new(plan.clone());
    x.push(&out.view());
    diagnose(set, &set.features(&x.features()), &x.missing())
}

#[test]
fn val_table_one() {
    let cache = tempfile::tempdir().unwrap();
    let (_, _, sensors, set, plan) = reference_maps(&cache.path().join("maps"));
    let faults: Vec<(f64, f64)> = TABLE_I.iter().map(|&(z, f, _, _)| (f, z)).collect();
    let runs = reference_runs(&faults, "preflight", 1e4);
    for (&(zeta, fsj, paper_zeta, paper_fsj), run) in TABLE_I.iter().zip(&runs) {
        let s = statistics(run, FaultState { fsj, zeta }, &set, &plan, &sensors, 100);
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
        assert!(s.inside >= 0.95);
    }
}

#[test]
fn val_off_grid_pairs_lie_inside() {
    // pairs that no map was made from, spread over the whole range, one noise seed each
    let cache = tempfile::tempdir().unwrap();
    let (actuator, sequence, sensors, set, plan) = reference_maps(&cache.path().join("maps"));
    let n = 320;
    // Kronecker sequence of the plastic number: even over the square, the same every time
    let part = |k: usize, a: f64| (0.5 + a * (k + 1) as f64).fract();
    let faults: Vec<(f64, f64)> = (0..n)
        .map(|k| {
            (
                1.0 + 4.0 * part(k, 0.754_877_666_246_692_7),
                0.5 * part(k, 0.569_840_290_998_053_2),
            )
        })
        .collect();
    let runs = reference_runs(&faults, &sequence.name, 1e4);
    let (mut inside, mut quadrants) = (0, [[0; 2]; 4]);
    let (mut fsj_width, mut zeta_width, mut fsj_error, mut zeta_error) = (vec![], vec![], vec![], vec![]);
    for (k, (&(fsj, zeta), run)) in faults.iter().zip(&runs).enumerate() {
        let truth = FaultState { fsj, zeta };
        let d = one_diagnosis(run, &set, &plan, &sensors, &actuator, 5000 + k as u64);
        let q = (fsj > 3.0) as usize + 2 * (zeta > 0.25) as usize;
        quadrants[q][1] += 1;
        let Some(a) = d.outcome.area() else {
            println!(
                "FSJ {fsj:.4} zeta {zeta:.4}: {} {}",
                d.outcome.name(),
                d.outcome.reason()
            );
            continue;
        };
        fsj_width.push(a.fsj.width());
        zeta_width.push(a.zeta.width());
        fsj_error.push(100.0 * (a.centroid.0 / fsj - 1.0).abs());
        zeta_error.push((a.centroid.1 - zeta).abs());
        if a.fsj.contains(truth.fsj) && a.zeta.contains(truth.zeta) {
            inside += 1;
            quadrants[q][0] += 1;
        } else {
            println!("FSJ {fsj:.4} zeta {zeta:.4}: outside {:?} {:?}", a.fsj, a.zeta);
        }
    }
    for v in [&mut fsj_width, &mut zeta_width, &mut fsj_error, &mut zeta_error] {
        v.sort_by(f64::total_cmp);
    }
    println!(
        "inside {inside} of {n}, by quadrant {quadrants:?}; median widths FSJ {:.4}, zeta {:.5}; errors FSJ median {:.3} % 95th {:.3} %, zeta median {:.5} 95th {:.5}",
        quantile(&fsj_width, 0.5),
        quantile(&zeta_width, 0.5),
        quantile(&fsj_error, 0.5),
        quantile(&fsj_error, 0.95),
        quantile(&zeta_error, 0.5),
        quantile(&zeta_error, 0.95),
    );
    assert!(inside as f64 >= 0.95 * n as f64);
}
