use super::*;
use schemas::feature::Role;
use sim_worker::catalogue;
use sim_worker::parameters::ActuatorParameters;

fn setup() -> TestSetup {
    TestSetup {
        sensors: catalogue::sensors("reference").unwrap(),
        ..TestSetup::new(
            Arc::new(ActuatorParameters::reference()),
            catalogue::sequence("preflight").unwrap(),
            1e4,
        )
    }
}

/// Fits a recording where no cause is known, with one seed.
///
/// * `recording` nominal run, and features
fn fit(setup: &TestSetup, spread: &Spread, recording: &(RawFeatures, Features), start: Option<Start>) -> Refined {
    fit_knowing(setup, spread, recording, &Vec::new(), start, 0.95).unwrap()
}

fn fit_knowing(
    setup: &TestSetup,
    spread: &Spread,
    (nominal, features): &(RawFeatures, Features),
    known: &Known,
    start: Option<Start>,
    coverage: f64,
) -> Result<Refined> {
    let test = Test {
        setup,
        nominal,
        features,
        spread,
        known,
    };
    refine(&test, start, coverage, 1).map(|r| r.unwrap())
}

/// Whether both faults lie within four standard deviations.
fn assert_near(r: &Refined, truth: (f64, f64)) {
    let (f, z) = (r.estimate.0 - truth.0, r.estimate.1 - truth.1);
    assert!(f.abs() < 4.0 * r.sigma.0 && z.abs() < 4.0 * r.sigma.1, "{r:?}");
}

/// Nominal run, and the features of one unit's test.
fn recording(
    setup: &TestSetup,
    spread: &Spread,
    draw: [f64; Cause::COUNT],
    fault: (f64, f64),
) -> (RawFeatures, Features) {
    let (actuator, rest_angle_rad) = spread.unit(&setup.actuator, setup.rest_angle_rad, &draw);
    let lane = |actuator, fault, rest_angle_rad| Lane {
        actuator,
        fault,
        rest_angle_rad,
        load_n_m: 0.0,
    };
    let fault = FaultState {
        fsj: fault.0,
        zeta: fault.1,
    };
    let lanes = vec![
        (lane(setup.actuator.clone(), FaultState::NOMINAL, 0.0), 11),
        (lane(Arc::new(actuator), fault, rest_angle_rad), 12),
    ];
    let raw = simulate_features(setup, lanes, "test").unwrap().unwrap();
    (raw[0], Features::over(&raw[1], &raw[0]))
}

#[test]
fn val_a_pair_is_found_from_a_start_that_is_off_by_a_fifth() {
    let (setup, spread) = (setup(), Spread::none());
    let truth = (2.6, 0.17);
    let recording = recording(&setup, &spread, [0.0; Cause::COUNT], truth);
    let start = Start {
        fsj: 1.2 * truth.0,
        zeta: truth.1 + 0.05,
        radius: (0.13, 0.02),
    };
    let r = fit(&setup, &spread, &recording, Some(start));
    assert_near(&r, truth);
    // sensors and chatter allow about 0.1 % of FSJ and 0.0002 of zeta
    assert!(r.sigma.0 < 0.005 && r.sigma.1 < 0.001, "{r:?}");
    assert!(r.fits() && r.causes.is_empty(), "{r:?}");
    // the paper's test has no slow turning points, and the supply is not in it
    let of_the_test = fitted().filter(|f| !matches!(f.role(), Role::Finer | Role::Cause));
    assert!(of_the_test.eq(r.features.iter().copied()), "{r:?}");
    // the seed decides everything
    assert_eq!(fit(&setup, &spread, &recording, Some(start)), r);
}

#[test]
fn val_a_healthy_actuator_is_found_from_anywhere() {
    let (setup, spread) = (setup(), Spread::none());
    let recording = recording(&setup, &spread, [0.0; Cause::COUNT], (1.003, 0.0));
    let r = fit(&setup, &spread, &recording, None);
    assert!((r.estimate.0 - 1.003).abs() < 0.015 && r.zeta.contains(0.0), "{r:?}");
    assert!(r.zeta.lo == 0.0 && r.zeta.hi < 0.02, "{r:?}");
}

#[test]
fn prop_a_known_cause_narrows_the_box_and_a_missing_feature_widens_it() {
    let (setup, spread) = (setup(), catalogue::spread("fleet").unwrap());
    let mut draw = [0.0; Cause::COUNT];
    draw[..5].copy_from_slice(&[0.5, -0.6, 0.4, -0.7, 0.3]);
    let truth = (3.1, 0.21);
    let (nominal, features) = recording(&setup, &spread, draw, truth);
    let run = |features: Features, known: &Known| {
        let r = fit_knowing(&setup, &spread, &(nominal, features), known, None, 0.95).unwrap();
        assert_near(&r, truth);
        r
    };
    let unknown = run(features, &Vec::new());
    let of = |c: Cause| (c, draw[c as usize] * spread.half_width[c as usize]);
    let causes = [Cause::Resistance, Cause::BackEmf, Cause::DynamicRatio, Cause::Supply].map(of);
    let known = run(features, &causes.to_vec());
    assert!(
        known.sigma.0 < 0.7 * unknown.sigma.0 && known.sigma.1 < unknown.sigma.1,
        "{known:?}"
    );
    assert_eq!((unknown.causes.len(), known.causes.len()), (5, 1));
    let fewer = features.with(Feature::P3, None).with(Feature::Rise, Some(f64::NAN));
    let fewer = run(fewer, &Vec::new());
    assert_eq!(fewer.features.len(), unknown.features.len() - 2);
    assert!(fewer.sigma.0 > unknown.sigma.0, "{fewer:?}");
}

#[test]
fn val_a_recorded_supply_narrows_the_finer_test_and_holds() {
    let setup = TestSetup {
        sequence: catalogue::sequence("preflight2").unwrap(),
        ..setup()
    };
    let spread = catalogue::spread("field").unwrap();
    let mut draw = [0.0; Cause::COUNT];
    draw[..5].copy_from_slice(&[-0.4, 0.7, 0.2, 0.6, -0.5]);
    let truth = (2.9, 0.24);
    let (nominal, recorded) = recording(&setup, &spread, draw, truth);
    let start = Start {
        fsj: 2.8,
        zeta: 0.25,
        radius: (0.2, 0.03),
    };
    let [with, without] = [recorded, recorded.with(Feature::Supply, None)].map(|features| {
        let r = fit(&setup, &spread, &(nominal, features), Some(start));
        assert_near(&r, truth);
        r
    });
    assert!(with.features.contains(&Feature::SlowBreakAway) && with.features.contains(&Feature::Supply));
    assert_eq!(without.features.len() + 1, with.features.len());
    // the maps' intervals are 3.8 and 5.3 % wide (medians)
    assert!(
        with.fsj.width() < 0.025 * truth.0 && without.fsj.width() < 0.06 * truth.0,
        "{with:?} {without:?}"
    );
}

#[test]
fn prop_fewer_than_two_features_or_no_coverage_are_refused() {
    let (setup, spread) = (setup(), Spread::none());
    let (nominal, features) = (RawFeatures::default(), Features::default());
    let one = features.with(Feature::P2, Some(0.5)).with(Feature::P1, Some(0.1));
    let both = one.with(Feature::Ripple, Some(0.003));
    for (features, coverage, place) in [(one, 0.95, "features"), (both, 1.0, "coverage")] {
        let refused = fit_knowing(&setup, &spread, &(nominal, features), &Vec::new(), None, coverage);
        let e = refused.unwrap_err().to_string();
        assert!(e.contains(place) && e.lines().count() == 1, "{e}");
    }
}
