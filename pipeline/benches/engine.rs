//! Time per step of the engine beside a control in the same run: the plainest scalar loop of the
//! same step. The control also checks the engine's answer.

use pipeline::speed;
use schemas::channel::{Channel, ChannelSet};
use schemas::fault::FaultState;
use sim_worker::command::CommandTrack;
use sim_worker::lanes::InstructionSet;
use sim_worker::parameters::ActuatorParameters;
use sim_worker::simulate::LANES;
use sim_worker::test_bench::{Lane, NumericalTestBench};
use std::f64::consts::TAU;
use std::sync::Arc;
use std::time::Instant;

/// One step after the other as the specification writes them; returns the last motor angle.
fn plain(p: &ActuatorParameters, f: FaultState, com: &[f64]) -> f64 {
    let (dt, kt, r, l) = (
        p.step_s,
        2.0 * p.back_emf_v_s_per_rad,
        p.phase_resistance_ohm,
        p.phase_inductance_h,
    );
    let (fs, fd) = (
        f.fsj * p.static_friction_n_m,
        f.fsj * p.static_friction_n_m * p.dynamic_friction_ratio,
    );
    let trap = |x: f64| {
        let d = x.rem_euclid(TAU).to_degrees();
        match d {
            d if d < 30.0 => d / 30.0,
            d if d < 150.0 => 1.0,
            d if d < 210.0 => (180.0 - d) / 30.0,
            d if d < 330.0 => -1.0,
            d => (d - 360.0) / 30.0,
        }
    };
    let rect = |x: f64| {
        let d = x.rem_euclid(TAU).to_degrees();
        if (30.0..150.0).contains(&d) {
            1.0
        } else if (210.0..330.0).contains(&d) {
            -1.0
        } else {
            0.0
        }
    };
    let (mut i, mut s) = ([0.0; 3], [1.0; 3]);
    let (mut w, mut th, mut integral, mut thu) = (0.0, 0.0, 0.0, 0.0_f64);
    let mut sums = [0.0; 4];
    for &com in com {
        let w_ref = (p.position_gain_per_s * (com - thu))
            .clamp(-p.speed_reference_limit_rad_per_s, p.speed_reference_limit_rad_per_s);
        let e = w_ref - w;
        let t = p.speed_proportional_n_m_s_per_rad * e + integral;
        let i_ref = (t / kt).clamp(-p.current_limit_a, p.current_limit_a);
        if !((t / kt).abs() > p.current_limit_a && t * e >= 0.0) {
            integral = (integral + p.speed_integral_n_m_per_rad * e * dt)
                .clamp(-p.integrator_limit_n_m, p.integrator_limit_n_m);
        }
        let mut k = [0.0; 3];
        let mut v = [0.0; 3];
        for q in 0..3 {
            let x = p.pole_pairs as f64 * th - TAU * q as f64 / 3.0;
            k[q] = p.back_emf_v_s_per_rad * trap(x) * (1.0 + f.zeta * (th + TAU * q as f64 / 3.0).cos());
            let error = rect(x) * i_ref - i[q];
            if error > p.hysteresis_half_band_a {
                s[q] = 1.0;
            } else if error < -p.hysteresis_half_band_a {
                s[q] = -1.0;
            }
            v[q] = s[q] * p.supply_voltage_v / 2.0;
        }
        let vn = (0..3).map(|q| v[q] - k[q] * w - r * i[q]).sum::<f64>() / 3.0;
        let old = i;
        for q in 0..3 {
            i[q] += dt / l * (v[q] - vn - k[q] * w - r * old[q]);
        }
        let tm = (0..3)
            .map(|q| k[q] * i[q])
            .sum::<f64>()
            .clamp(-p.torque_limit_n_m, p.torque_limit_n_m);
        let a: f64 = tm - p.viscous_n_m_s_per_rad * w;
        let ff = if w == 0.0 {
            if a.abs() <= fs { a } else { fd * a.signum() }
        } else {
            fd * w.signum()
        };
        let mut wn = w + dt / p.inertia_kg_m2 * (a - ff);
        if w * wn < 0.0 {
            wn = 0.0;
        }
        w = wn;
        th += w * dt;
        let mut u = th / p.gear_ratio;
        if u.abs() > p.end_stop_rad {
            u = p.end_stop_rad.copysign(u);
            th = u * p.gear_ratio;
            if w * u > 0.0 {
                w = 0.0;
            }
        }
        thu = thu.clamp(u - p.backlash_half_width_rad, u + p.backlash_half_width_rad);
        for q in 0..3 {
            sums[q] += i[q];
        }
        sums[3] += 0.5 * (i[0].abs() + i[1].abs() + i[2].abs());
    }
    std::hint::black_box(sums);
    th
}

fn main() {
    let p = Arc::new(ActuatorParameters::reference());
    let preflight = sim_worker::catalogue::sequence("preflight").expect("built in");
    let mut com = vec![0.0; 3_000_000];
    CommandTrack::new(&preflight, p.step_s).fill(0, &mut com);
    let fault = FaultState { fsj: 3.0, zeta: 0.3 };

    let time = |f: &dyn Fn() -> f64| {
        let mut best = f64::INFINITY;
        let mut answer = 0.0;
        for _ in 0..3 {
            let start = Instant::now();
            answer = f();
            best = best.min(start.elapsed().as_secs_f64());
        }
        (best * 1e9 / com.len() as f64, answer)
    };
    let still = vec![0.0; com.len()];
    let (control, truth) = time(&|| plain(&p, fault, &com));
    let (control_still, _) = time(&|| plain(&p, fault, &still));

    // the engine gives the control's answer
    let lane = Lane {
        actuator: p.clone(),
        fault,
        rest_angle_rad: 0.0,
        load_n_m: 0.0,
    };
    let mut bench = NumericalTestBench::<1>::new(&[lane], ChannelSet::basic());
    bench.advance(&com);
    let ours = bench.samples(Channel::ThetaM)[0];
    assert!((ours / truth - 1.0).abs() < 1e-9, "engine {ours}, control {truth}");

    println!("control: plainest scalar loop   {control:6.2} ns/step moving, {control_still:6.2} standing still");
    println!(
        "{:10} {:>6} {:>22} {:>22}",
        "", "lanes", "moving ns/step (ratio)", "still ns/step (ratio)"
    );
    let rest = speed::standstill();
    for set in InstructionSet::available() {
        let row = |lanes: usize, moving: f64, still: f64| {
            println!(
                "{:10} {lanes:>6} {moving:>14.2} ({:5.3}) {still:>14.2} ({:5.3})",
                set.name(),
                moving / control,
                still / control_still
            );
        };
        row(
            1,
            speed::engine::<1>(&preflight, set, 3),
            speed::engine::<1>(&rest, set, 3),
        );
        row(
            LANES,
            speed::engine::<LANES>(&preflight, set, 3),
            speed::engine::<LANES>(&rest, set, 3),
        );
    }
    let sm = speed::monitor(5);
    let scalar = speed::engine::<1>(&preflight, InstructionSet::detect(), 3);
    println!(
        "simplified model: {sm:.3} ns per simulated us, 1/{:.0} of one run, 1/{:.0} of the control",
        scalar / sm,
        control / sm
    );
}
