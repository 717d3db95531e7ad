use super::check::{Sight, extra, moments, visible};
use super::draw::Case;
use super::rig::{Drive, Mode};
use super::*;

fn rms(x: &[f64]) -> f64 {
    (x.iter().map(|v| v * v).sum::<f64>() / x.len().max(1) as f64).sqrt()
}

/// With nothing hidden the noise-free signals obey the nominal torque and voltage balance.
#[test]
fn nominal_balance() {
    let mut modes = [0; 3];
    for seed in 0..24 {
        let case = Case::new(&[], 1.0, seed);
        modes[match case.rig.mode {
            Mode::Ideal => 0,
            Mode::Loop => 1,
            Mode::Spin => 2,
        }] += 1;
        let t = sim::run(&case.rig, &case.laws, &case.runs[0].scene);
        let m = moments(&case.rig, &t);
        assert!(m.len() > 1000, "seed {seed}: hardly moves");
        let rest: Vec<f64> = m.iter().map(|m| extra(&case.laws, m)).collect();
        let whole = case.rig.t_ref;
        assert!(
            rms(&rest) < 3e-3 * whole,
            "seed {seed} {:?}: {} of {whole}",
            case.rig.mode,
            rms(&rest)
        );
        if case.rig.volt {
            assert_eq!(case.rig.drive, Drive::Current);
            let e: Vec<f64> = (1..t.i.len() - 1)
                .map(|k| {
                    let di = (t.i[k + 1] - t.i[k - 1]) / (2.0 * t.dt);
                    t.v[k] - case.rig.r * t.i[k] - case.rig.l * di - case.rig.kt * t.w[k]
                })
                .collect();
            assert!(rms(&e) < 1e-6 * case.rig.v0);
        }
    }
    assert!(modes.iter().all(|m| *m > 0), "{modes:?}");
}

/// The key's parameters reproduce the hidden torque by the table's equation, written here once more.
#[test]
fn keys_reproduce_the_torque() {
    let names = [
        "stribeck",
        "lubricated_rise",
        "quadratic_drag",
        "viscous_asymmetry",
        "bias_torque",
        "load_dependent_friction",
        "temperature_dependent_friction",
        "periodic_friction",
        "tight_spot",
        "cogging",
        "torque_ripple",
        "torque_saturation",
        "spring_load",
    ];
    for name in names {
        let mut done = 0;
        for seed in 0..40 {
            let case = Case::new(&[name], 1.0, seed);
            if case.rig.other {
                continue;
            }
            done += 1;
            let p: std::collections::HashMap<&str, f64> =
                case.hidden[0].1.iter().map(|(k, v)| (k.as_str(), *v)).collect();
            let t = sim::run(&case.rig, &case.laws, &case.runs[0].scene);
            let (mut sum, mut all, mut n) = (0.0, 0.0, 0);
            let h = (case.rig.fine / 2).max(1);
            for k in (4 * case.rig.fine..t.w.len() - 2 * h).step_by(case.rig.fine) {
                let (w, th, i, load) = (t.w[k], t.th[k], t.i[k], t.load[k]);
                if t.w[k - h] * t.w[k + h] <= 0.0 || w == 0.0 {
                    continue;
                }
                let s = w.signum();
                let law = match name {
                    "stribeck" => p["torque"] * (-(w.abs() / p["speed"]).powf(p["exponent"])).exp() * s,
                    "lubricated_rise" => p["torque"] * (1.0 - (-w.abs() / p["speed"]).exp()) * s,
                    "quadratic_drag" => p["coefficient"] * w * w.abs(),
                    "viscous_asymmetry" => p["coefficient"] * w.abs(),
                    "bias_torque" => p["torque"],
                    "load_dependent_friction" => p["coefficient"] * load.abs() * s,
                    "temperature_dependent_friction" => {
                        p["coefficient"] * (t.temp[k] - 20.0) * (case.rig.tc * s + case.rig.c * w)
                    }
                    "periodic_friction" => s * p["amplitude"] * (p["order"] * th + p["phase"]).cos(),
                    "tight_spot" => p["torque"] * (-((th - p["centre"]) / p["width"]).powi(2)).exp() * s,
                    "cogging" => {
                        let two = p
                            .get("order_2")
                            .map_or(0.0, |n| p["amplitude_2"] * (n * th + p["phase_2"]).cos());
                        p["amplitude"] * (p["order"] * th + p["phase"]).cos() + two
                    }
                    "torque_ripple" => -case.rig.kt * i * p["fraction"] * (p["order"] * th + p["phase"]).cos(),
                    "torque_saturation" => case.rig.kt * i * p["coefficient"] * i.abs(),
                    "spring_load" => p["stiffness"] * th,
                    _ => unreachable!(),
                };
                let m = [
                    // mean drive over the step over which the speed is differenced
                    (t.i[k - h..=k + h].iter().sum::<f64>() - 0.5 * (t.i[k - h] + t.i[k + h])) / (2 * h) as f64,
                    (t.w[k + h] - t.w[k - h]) / (2.0 * h as f64 * t.dt),
                    w,
                    s,
                    load,
                ];
                sum += (extra(&case.laws, &m) - law).powi(2);
                all += law * law;
                n += 1;
            }
            let (rest, size) = ((sum / n as f64).sqrt(), (all / n as f64).sqrt());
            let allowed = 0.06 * size + 4e-3 * case.rig.t_ref;
            assert!(
                rest < allowed,
                "{name} seed {seed} {:?}: {rest:.2e} of {size:.2e}",
                case.rig.mode
            );
            if done >= 6 {
                break;
            }
        }
    }
}

/// Every law is visible at strength 1 and is no larger than what drives the rig.
#[test]
fn visible_and_bounded() {
    for name in EFFECTS.iter().chain(OUTSIDE) {
        let mut lines = String::new();
        for seed in 100..112 {
            let case = Case::new(&[name], 1.0, seed);
            let t = sim::run(&case.rig, &case.laws, &case.runs[0].scene);
            let s: Sight = visible(&case.rig, &case.laws, &t, name);
            lines += &format!(
                " {:.0}/{:.0}/{:.2}",
                s.signal / s.noise,
                s.residual / s.noise,
                s.signal / s.whole
            );
            assert!(
                t.w.iter().chain(&t.i).chain(&t.user).all(|x| x.is_finite()),
                "{name} seed {seed}"
            );
            assert!(s.signal > 5.0 * s.noise, "{name} seed {seed}: {s:?} {}", case.key().rig);
            assert!(s.signal < s.whole, "{name} seed {seed}: {s:?} {}", case.key().rig);
        }
        println!("{name}: signal/noise, residual/noise, signal/whole:{lines}");
    }
}

/// A tenth of the strength leaves rig, motion and constants alone and scales the parameters.
#[test]
fn strength_scales_the_effect_only() {
    for name in ["stribeck", "cogging", "bias_torque", "winding_heating"] {
        let (a, b) = (Case::new(&[name], 1.0, 5), Case::new(&[name], 0.1, 5));
        assert_eq!(a.key().constants, b.key().constants);
        assert_eq!(a.key().rig, b.key().rig);
        let ratio = b.hidden[0].1[0].1 / a.hidden[0].1[0].1;
        assert!((ratio - 0.1).abs() < 1e-9, "{name} {ratio}");
    }
}

/// The same seed gives the same bytes; every pair that is allowed can be made.
#[test]
fn reproducible_and_complete() {
    let base = std::env::temp_dir().join(format!("second_bed_{}", std::process::id()));
    let class = Class::Two("cogging", "stribeck");
    let read = |f: &str| {
        let key = make(&base.join(f), &class, 1.0, 11).unwrap();
        (key, std::fs::read(base.join(f).join("bench.toml")).unwrap())
    };
    assert_eq!(read("a"), read("b"));
    for entry in std::fs::read_dir(base.join("a")).unwrap() {
        let name = entry.unwrap().file_name();
        assert_eq!(
            std::fs::read(base.join("a").join(&name)).unwrap(),
            std::fs::read(base.join("b").join(&name)).unwrap()
        );
    }
    assert!(make(&base, &Class::One("no such effect"), 1.0, 1).is_err());
    std::fs::remove_dir_all(&base).unwrap();
}

/// Rigs move: neither stuck nor at the drive's limit for most of the time, and not beyond twice the drawn speed.
#[test]
fn rigs_move() {
    for name in EFFECTS.iter().chain(OUTSIDE) {
        let mut bad = vec![];
        for seed in 205..212 {
            let case = Case::new(&[name], 1.0, seed);
            for run in &case.runs {
                let t = sim::run(&case.rig, &case.laws, &run.scene);
                let n = t.w.len() as f64;
                let stuck = t.w.iter().filter(|w| w.abs() < 1e-6 * case.rig.w_max).count() as f64 / n;
                let limit = case.rig.control.limit;
                let limited = t.i.iter().filter(|i| limit > 0.0 && i.abs() > 0.98 * limit).count() as f64 / n;
                let fast = t.w.iter().fold(0.0, |m: f64, w| m.max(w.abs())) / case.rig.w_max;
                let most = if matches!(run.scene.command, motion::Command::Jumps(_)) {
                    0.9
                } else {
                    0.3
                };
                if stuck > most || limited > 0.3 || !(0.3..2.0).contains(&fast) {
                    let how = format!("{:?} {}", case.rig.mode, run.scene.command.name());
                    bad.push(format!(
                        "seed {seed} {how}: stuck {stuck:.2} limited {limited:.2} speed {fast:.2}"
                    ));
                }
            }
        }
        assert!(bad.is_empty(), "{name}: {bad:#?}");
    }
}

/// All pairs that are allowed make rigs that move within bounds.
#[test]
fn pairs_stay_bounded() {
    for (k, a) in EFFECTS.iter().enumerate() {
        for (l, b) in EFFECTS
            .iter()
            .enumerate()
            .skip(k + 1)
            .filter(|(_, b)| needs::compatible(a, b))
        {
            let case = Case::new(&[a, b], 1.0, (100 * k + l) as u64);
            let t = sim::run(&case.rig, &case.laws, &case.runs[0].scene);
            let fast = t.w.iter().fold(0.0, |m: f64, w| m.max(w.abs())) / case.rig.w_max;
            let sound = t.i.iter().chain(&t.user).chain(&t.v).all(|x| x.is_finite());
            assert!(
                sound && fast > 0.2 && fast < 2.0,
                "{a} {b}: speed {fast:.2} {}",
                case.key().rig
            );
            assert_eq!(case.hidden.len(), 2);
        }
    }
}
