use super::*;

#[test]
fn a_case_is_deterministic() {
    let spec = Spec {
        class: Class::Two,
        setting: Setting::Other,
        ..Spec::default()
    };
    let (a, b) = (case(5, &spec), case(5, &spec));
    assert!(a.recordings == b.recordings);
    assert_eq!(a.key(), b.key());
    assert!(a.recordings != case(6, &spec).recordings);
}

#[test]
fn severities_are_reached() {
    for kind in Kind::LIST.into_iter().chain(Kind::OUTSIDE) {
        for severity in [0.1, 1.0] {
            let forced = vec![Forced::new(kind.name(), &[]).expect("known")];
            let c = case(
                3,
                &Spec {
                    severity,
                    forced,
                    ..Spec::default()
                },
            );
            let got = c.reached[0] / severity;
            assert!((got - 1.0).abs() < 0.15, "{} at {severity}: {got}", kind.name());
        }
    }
}

/// Means of the residuals of voltage and torque equation over all samples, with the true parameters.
#[test]
fn equations_close_when_nothing_is_hidden() {
    let of = |rig| {
        case(
            11,
            &Spec {
                class: Class::Nothing,
                rig,
                ..Spec::default()
            },
        )
    };
    let cases = [of(Rig::Servo), of(Rig::ThreePhase)];
    for (c, r) in cases.iter().flat_map(|c| c.recordings.iter().map(move |r| (c, r))) {
        let p = c.truth.nominal;
        let n = r.rows.len() - 40;
        let (mut volts, mut torques) = (0.0, 0.0);
        for k in 20..20 + n {
            let mean = |col: usize, at: usize| (at - 10..at + 10).map(|j| r.rows[j][col]).sum::<f64>() / 20.0;
            let rate = |col: usize| (mean(col, k + 10) - mean(col, k - 10)) / 0.02;
            volts += (mean(4, k) - p.resistance * mean(3, k) - p.inductance * rate(3) - p.ke * mean(2, k)).powi(2);
            if (k - 10..k + 10).all(|j| r.rows[j][2] > 8.0) && r.rows[k - 10][7] - r.rows[k + 10][7] < 0.004 {
                let torque = p.kt * mean(3, k) - p.viscous * mean(2, k) - p.coulomb - mean(7, k);
                torques += (torque - p.inertia * rate(2)).powi(2);
            }
        }
        assert!(
            (volts / n as f64).sqrt() < 0.03,
            "{}: {} V",
            r.file,
            (volts / n as f64).sqrt()
        );
        assert!(
            (torques / n as f64).sqrt() < 0.003,
            "{}: {} N m",
            r.file,
            (torques / n as f64).sqrt()
        );
    }
}

#[test]
fn unknown_names_are_refused() {
    assert!(Forced::new("no_such", &[]).is_err());
    assert!(Forced::new("backlash", &[("stiffness", 1.0)]).is_err());
}

/// Half the step changes the sample means by less than a fifth of the noise.
#[test]
fn the_step_is_fine_enough() {
    for name in ["stribeck", "presliding", "compliance", "backlash", "eccentricity"] {
        let forced = vec![Forced::new(name, &[]).expect("known")];
        let c = case(
            2,
            &Spec {
                forced,
                ..Spec::default()
            },
        );
        let mut rng = ChaCha8Rng::seed_from_u64(9);
        let command = commands::sines(&mut rng);
        let sub = if name == "eccentricity" { 10 } else { 4 };
        let [a, b] = [sub, 2 * sub].map(|sub| servo::run(&c.truth, &LAWS, &c.effects, &command, sub).rows);
        for (column, noise) in [(2, 0.2), (3, 0.02), (4, 0.05)] {
            let sum: f64 = a.iter().zip(&b).map(|(a, b)| (a[column] - b[column]).powi(2)).sum();
            let rms = (sum / a.len() as f64).sqrt();
            assert!(rms < 0.2 * noise, "{name}, column {column}: {rms}");
        }
    }
}

#[test]
fn two_effects_are_never_aliases() {
    for seed in 0..500 {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let kinds = drawn(
            &Spec {
                class: Class::Two,
                ..Spec::default()
            },
            &mut rng,
        );
        assert_eq!(kinds.len(), 2);
        assert!(kinds[0].compatible(kinds[1]));
    }
}
