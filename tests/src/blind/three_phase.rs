//! Rig 2: the three-phase actuator (star, trapezoidal back-EMF, six-step references, hysteresis relays).
//! Two rates: mechanics by leapfrog every 10 us with the mean currents of the step, windings by the midpoint rule in
//! between, with the shapes held at the step's middle angle. The current demand is the servo's law at 10 kHz.

use super::commands::{Command, RATE};
use super::effects::{Effect, Kind, Seen, conduction, trapezoid};
use super::servo::proximal;
use super::{Laws, Quantity, Row, Run, Sums, Truth};

/// Mechanical steps per controller sample.
const STEPS: usize = 10;
/// Half-band of the relays, A (datasets/parameters/reference.toml).
const BAND: f64 = 0.1;

/// Runs the actuator on a command with `sub` steps of the windings per mechanical step.
pub(super) fn run(t: &Truth, laws: &Laws, effects: &[Effect], command: &Command, sub: usize) -> Run {
    let p = &t.nominal;
    let dt = 1.0 / RATE / STEPS as f64;
    let de = dt / sub as f64;
    let eccentric = effects.iter().position(|e| e.kind == Kind::Eccentricity);
    let short = effects.iter().position(|e| e.kind == Kind::TurnShort);
    // turns lost of each phase; the voltage equation sees half of the line values per phase
    let mut kept = [1.0f64; 3];
    let mut kept_l = [1.0f64; 3];
    if let Some(e) = short.map(|n| &effects[n]) {
        let phase = (e.shape[0] as usize).min(2);
        kept[phase] = 1.0 - e.amp;
        kept_l[phase] = if e.other { (1.0 - e.amp).powi(2) } else { 1.0 - e.amp };
    }
    let r: [f64; 3] = std::array::from_fn(|q| 0.5 * p.resistance * kept[q]);
    let l: [f64; 3] = std::array::from_fn(|q| 0.5 * p.inductance * kept_l[q]);
    let weight = 1.0 / l.iter().map(|l| 1.0 / l).sum::<f64>();

    let (mut th, mut w, mut integral, mut warm) = (0.0f64, 0.0f64, 0.0f64, 0.0f64);
    let (mut acc, mut acc_slow, mut since, mut last_sign, mut i_slow) = (0.0f64, 0.0f64, 1.0f64, 0.0f64, 0.0f64);
    let mut i = [0.0f64; 3];
    let mut gate = [1.0f64; 3];
    let mut sums = Sums::new(effects.len());
    let mut own = vec![0.0f64; effects.len()];
    let mut rows = Vec::with_capacity(command.com.len() / 10);
    let mut row: Row = [0.0; 8];
    let per_row = (RATE / 1000.0) as usize;
    let share = 1.0 / (per_row * STEPS) as f64;

    for (k, (&com, &load)) in command.com.iter().zip(&command.load).enumerate() {
        let e = (laws.position_gain * (com - th)).clamp(-laws.speed_limit, laws.speed_limit) - w;
        let u = laws.speed_gain * e + laws.integral_gain * integral;
        if u.abs() < laws.drive_limit || u * e < 0.0 {
            integral += e / RATE;
        }
        let demand = u.clamp(-laws.drive_limit, laws.drive_limit);

        let next = command.com.get(k + 1).copied().unwrap_or(com);
        for step in 0..STEPS {
            let th_half = th + 0.5 * dt * w;
            let wm = w + 0.5 * dt * acc;
            let sgn = if w == 0.0 { 0.0 } else { w.signum() };
            let seen = Seen {
                th: th_half,
                w: wm,
                sgn,
                i: i_slow,
                load,
                warm,
                acc: acc_slow,
                since,
            };
            let (mut dry, mut extra, mut kf, mut volt) = (p.coulomb, 0.0, 1.0, 0.0);
            for (n, e) in effects.iter().enumerate() {
                let a = e.adds(&seen, p, false);
                dry += a.dry;
                extra += a.torque;
                kf *= a.k;
                volt += a.volt;
                own[n] += match e.kind.quantity() {
                    Quantity::Torque => a.dry * sgn + a.torque + p.kt * i_slow * (1.0 - a.k),
                    Quantity::Voltage => a.volt,
                    _ => 0.0,
                };
            }
            let shape: [f64; 3] = std::array::from_fn(|q| trapezoid(th_half, p.pairs, q, 0.0));
            let on: [f64; 3] = std::array::from_fn(|q| conduction(th_half, p.pairs, q));
            let c: [f64; 3] = std::array::from_fn(|q| {
                let off = eccentric.map_or(0.0, |n| effects[n].eccentric(th_half, q));
                0.5 * p.kt * kf * kept[q] * (1.0 + off) * shape[q]
            });
            let quadrature = |i: &[f64; 3]| 0.5 * (i[0] * shape[0] + i[1] * shape[1] + i[2] * shape[2]);

            let start = i;
            let mut mean = [0.0f64; 3];
            for _ in 0..sub {
                let mut drive = [0.0f64; 3];
                for q in 0..3 {
                    let error = on[q] * demand - i[q];
                    if error.abs() > BAND {
                        gate[q] = error.signum();
                    }
                    drive[q] = 0.5 * laws.supply * gate[q] - c[q] * wm;
                }
                let slope = |i: &[f64; 3]| -> [f64; 3] {
                    let star: f64 = (0..3).map(|q| (drive[q] - r[q] * i[q]) / l[q]).sum::<f64>() * weight;
                    std::array::from_fn(|q| (drive[q] - r[q] * i[q] - star) / l[q])
                };
                let s = slope(&i);
                let middle: [f64; 3] = std::array::from_fn(|q| i[q] + 0.5 * de * s[q]);
                let s = slope(&middle);
                for q in 0..3 {
                    i[q] += de * s[q];
                    mean[q] += middle[q] / sub as f64;
                }
            }
            let iq = quadrature(&mean);
            i_slow += (iq - i_slow) * dt / 3e-4;
            let torque = c[0] * mean[0] + c[1] * mean[1] + c[2] * mean[2];
            if let Some(n) = eccentric.or(short) {
                own[n] += p.kt * kf * iq - torque;
            }

            let half = 0.5 * dt * p.viscous / p.inertia;
            let free = (w * (1.0 - half) + dt / p.inertia * (torque - extra - load)) / (1.0 + half);
            let w_new = proximal(free, dt / p.inertia * dry.max(0.0));
            acc = (w_new - w) / dt;
            acc_slow += (acc - acc_slow) * dt / 2e-3;
            let w_mid = 0.5 * (w + w_new);

            // terminal voltage of the two conducting phases, the kick of commutation taken out: it follows i_q
            let carried = (0..3).map(|q| on[q] * (r[q] * mean[q] + c[q] * w_mid)).sum::<f64>();
            let induced = p.inductance * (quadrature(&i) - quadrature(&start)) / dt;
            let v = carried + induced + volt;
            since += dt;
            if w_new != 0.0 && w_new.signum() != last_sign {
                (since, last_sign) = (0.0, w_new.signum());
            }
            th = th_half + 0.5 * dt * w_new;
            w = w_new;
            warm += dt / t.thermal_time * (t.thermal_rise * p.resistance * i_slow * i_slow - warm);
            sums.warmest = sums.warmest.max(warm);
            sums.torque += (p.kt * i_slow).powi(2);
            sums.voltage += (p.resistance * i_slow).powi(2);
            sums.current += i_slow * i_slow;
            sums.steps += 1;
            let asked = com + (next - com) * (step as f64 + 0.5) / STEPS as f64;
            for (sum, x) in row.iter_mut().zip([asked, th_half, w_mid, iq, v, th, warm, load]) {
                *sum += x * share;
            }
        }
        if (k + 1) % per_row == 0 {
            row[0] /= p.gear;
            row[5] = row[1] / p.gear;
            row[6] += 20.0;
            rows.push(row);
            row = [0.0; 8];
            sums.close(&mut own, per_row * STEPS);
        }
    }
    Run { rows, sums }
}
