//! Calibrated intervals hold what they promise, on tests that neither maps nor calibration have seen.

use diagnoser::calibration::COVERAGE;
use diagnoser::curves::common;
use diagnoser::diagnosis::{Diagnoser, Outcome};
use ema_tests::coverage::defects::{self, Defect};
use ema_tests::coverage::{Case, FSJ, ZETA, calibrated, fresh, judge, quadrant, quantile, reference_maps};
use ema_tests::independent::Command;
use pipeline::calibrate::{Campaign, Effort, draw_units};
use schemas::feature::{Feature, Features};
use sim_worker::setup::TestSetup;
use sim_worker::spread::{Cause, Spread};
use std::sync::LazyLock;

struct Ready {
    setup: TestSetup,
    none: Diagnoser,
    fleet: Diagnoser,
}

/// Maps of the reference actuator, calibrated for one unit and for a fleet; made once for all tests here.
static READY: LazyLock<Ready> = LazyLock::new(|| {
    let cache = tempfile::tempdir().unwrap();
    let (set, setup) = reference_maps(&cache.path().join("maps"), "fine", 0.0).unwrap();
    let diagnoser = |spread: &str| {
        let spread = sim_worker::catalogue::spread(spread).unwrap();
        let effort = Effort {
            runs: 1024,
            ..Effort::QUICK
        };
        let campaign = Campaign::run(&setup, &spread, effort, FSJ, ZETA).unwrap().unwrap();
        calibrated(&set, &campaign).unwrap()
    };
    Ready {
        none: diagnoser("none"),
        fleet: diagnoser("fleet"),
        setup,
    }
});

fn fresh_cases(name: &str, n: usize) -> Vec<Case> {
    let spread = sim_worker::catalogue::spread(name).unwrap();
    let diagnoser = if name == "none" { &READY.none } else { &READY.fleet };
    let (units, measured) = fresh(&READY.setup, &spread, n, 9).unwrap();
    judge(diagnoser, &units, &measured)
}

fn share(cases: &[&Case]) -> f64 {
    cases.iter().filter(|c| c.inside).count() as f64 / cases.len() as f64
}

#[test]
fn val_intervals_hold_what_they_promise() {
    for name in ["none", "fleet"] {
        let cases = fresh_cases(name, 800);
        let all: Vec<&Case> = cases.iter().collect();
        let quadrants = [0, 1, 2, 3].map(|q| share(&cases.iter().filter(|c| quadrant(c) == q).collect::<Vec<_>>()));
        let located = cases.iter().filter(|c| c.outcome == "located").count();
        println!(
            "{name}: inside {:.3}, by quadrant {quadrants:.3?}, located {located}",
            share(&all)
        );
        // 800 tests: 0.95 has a standard deviation of 0.008; in a quadrant 0.015
        assert!((0.925..0.99).contains(&share(&all)), "{name}: {}", share(&all));
        assert!(quadrants.iter().all(|q| *q > 0.89), "{name}: {quadrants:?}");
        assert!(located >= 780, "{name}: {located}");
    }
}

#[test]
fn val_one_known_unit_is_located_closely() {
    let cases = fresh_cases("none", 800);
    let found = || {
        cases
            .iter()
            .filter(|c| c.zeta > 0.03)
            .filter_map(|c| Some((c, c.found?)))
    };
    let fsj = |q| quantile(found().map(|(c, (_, e))| 100.0 * (e.0 / c.fsj).abs()), q);
    let zeta = |q| quantile(found().map(|(_, (_, e))| e.1.abs()), q);
    println!(
        "FSJ {:.3} % {:.3} %, zeta {:.5} {:.5}",
        fsj(0.5),
        fsj(0.95),
        zeta(0.5),
        zeta(0.95)
    );
    assert!(fsj(0.5) <= 0.15 && fsj(0.95) <= 0.8);
    assert!(zeta(0.5) <= 0.0015 && zeta(0.95) <= 0.006);
}

#[test]
fn val_defects_of_another_hand_do_not_pass_for_these_faults() {
    let defects = [
        "backlash",
        "turn_short",
        "current_offset",
        "cogging",
        "spring_load",
        "periodic_friction",
    ];
    for (name, diagnoser) in [("none", &READY.none), ("fleet", &READY.fleet)] {
        let spread = sim_worker::catalogue::spread(name).unwrap();
        let mut all = Vec::new();
        for (k, defect) in defects.into_iter().enumerate() {
            let seed = 0xDEFE + k as u64;
            let units = draw_units(FSJ, ZETA, &spread, 12, seed);
            let hidden = (Defect::Effect(defect), 1.0 / 3.0);
            let h = defects::hide(&READY.setup, &spread, &Command::Preflight, hidden, units, seed);
            let cases = judge(diagnoser, &h.units, &h.measured);
            let refused = cases.iter().filter(|c| c.outcome == "unexplained").count();
            println!("{name}, {defect}: {refused} of {} unexplained", cases.len());
            let spoken = cases
                .iter()
                .filter(|c| c.outcome == "unexplained")
                .all(|c| !c.contradicting.is_empty());
            assert!(spoken, "an unexplained test names the maps that disagree");
            all.extend(cases);
        }
        // moved by more than their intervals are wide without a word
        let count = defects::Count::of(&all);
        assert!(20 * count.off() <= all.len(), "{name}: {count:?}");
        assert!(2 * count.unexplained() > all.len(), "{name}: {count:?}");
    }
}

#[test]
fn prop_a_known_cause_narrows_the_intervals_and_keeps_the_truth() {
    let spread = sim_worker::catalogue::spread("fleet").unwrap();
    let (units, measured) = fresh(&READY.setup, &spread, 64, 4).unwrap();
    let (mut known_inside, mut width, mut known_width) = (0, vec![], vec![]);
    for (u, raw) in units.iter().zip(&measured) {
        let ratio = u.draw[Cause::DynamicRatio as usize] * spread.half_width[Cause::DynamicRatio as usize];
        let calibration = READY.fleet.calibration.clone();
        let known = vec![(Cause::DynamicRatio, ratio)];
        let knowing = Diagnoser::new(READY.fleet.maps.clone(), calibration, COVERAGE, &known).unwrap();
        let features = knowing.maps.features(raw);
        let area = |d: &Diagnoser| d.diagnose(&features, &[]).outcome.area().cloned();
        if let (Some(a), Some(b)) = (area(&READY.fleet), area(&knowing)) {
            width.push(a.fsj.width());
            known_width.push(b.fsj.width());
            known_inside += usize::from(b.fsj.contains(u.fault.fsj) && b.zeta.contains(u.fault.zeta));
        }
    }
    let (a, b) = (quantile(width.clone(), 0.5), quantile(known_width, 0.5));
    println!(
        "FSJ width {a:.4}, with the friction ratio known {b:.4}; inside {known_inside} of {}",
        width.len()
    );
    assert!(b < 0.7 * a && known_inside * 10 >= width.len() * 8);
    // what no calibration has a response to is refused
    let plain = Diagnoser::new(READY.none.maps.clone(), None, COVERAGE, &vec![(Cause::Supply, 0.01)]);
    assert!(plain.is_err());
}

#[test]
fn val_the_papers_curves_enclose_the_area() {
    // every band holds every pair of the area, and the curves meet where the area is
    let spread = Spread::none();
    let (units, measured) = fresh(&READY.setup, &spread, 40, 5).unwrap();
    let d = &READY.none;
    let mut seen = 0;
    for (u, raw) in units.iter().zip(&measured) {
        let features = d.maps.features(raw);
        let Outcome::Located(area) = d.diagnose(&features, &[]).outcome else {
            continue;
        };
        let cuts: Vec<_> = d
            .shown_maps()
            // bands are drawn with the half-width of each place, the area with that of the estimate
            .map(|m| d.cut(m, features.get(m.feature).unwrap(), 1.15 * area.band))
            .collect();
        let lines = (0..=40).map(|k| area.zeta.lo + area.zeta.width() * k as f64 / 40.0);
        let strips = common(&cuts, lines);
        assert_eq!(strips.len(), 41, "FSJ {} zeta {}", u.fault.fsj, u.fault.zeta);
        for b in area.boxes.iter().filter(|b| b.inside) {
            let zeta = 0.5 * (b.zeta.lo + b.zeta.hi);
            let strip = common(&cuts, std::iter::once(zeta));
            let slack = 1e-3 * area.fsj.width();
            let holds = strip
                .first()
                .is_some_and(|s| s.fsj.lo <= b.fsj.lo + slack && b.fsj.hi - slack <= s.fsj.hi);
            assert!(holds, "FSJ {:?} zeta {zeta}: {strip:?}", b.fsj);
        }
        seen += 1;
    }
    assert!(seen >= 36, "{seen}");
}

#[test]
fn prop_outcomes_say_what_is_wrong_and_make_nothing_up() {
    let d = &READY.none;
    let (_, measured) = fresh(&READY.setup, &Spread::none(), 1, 6).unwrap();
    let good = d.maps.features(&measured[0]);
    assert_eq!(d.diagnose(&good, &[]).outcome.name(), "located");

    // one map's value missing: incomplete, and what the rest allows
    let without = good.with(Feature::P2, None);
    let o = d.diagnose(&without, &[]).outcome;
    assert_eq!((o.name(), o.reason()), ("incomplete", "no value of p2"));
    assert!(o.area().is_some());

    // not a number: incomplete, named
    let odd = good.with(Feature::Rise, Some(f64::NAN));
    let o = d.diagnose(&odd, &[]).outcome;
    assert_eq!(o.name(), "incomplete");
    assert!(o.reason().contains("rise is NaN"), "{}", o.reason());

    // nothing but one value: no area
    let one = Features::default().with(Feature::P2, good.get(Feature::P2));
    let o = d.diagnose(&one, &[]).outcome;
    assert!(o.name() == "incomplete" && o.area().is_none());

    // one value far beyond its map: nothing is located, and it is said
    let beyond = good.with(Feature::P2, Some(50.0));
    let o = d.diagnose(&beyond, &[]).outcome;
    assert!(
        o.area().is_none() && o.reason().contains("p2 = 5.00000e1 A is above the map's end"),
        "{o:?}"
    );

    // contradicting values: nothing is located, and the odd map is named
    let contradicting = good.with(Feature::Ripple, good.get(Feature::Ripple).map(|r| 0.5 * r));
    let Outcome::Unexplained { contradicting, reason } = d.diagnose(&contradicting, &[]).outcome else {
        panic!("unexplained")
    };
    assert_eq!(contradicting, [Feature::Ripple], "{reason}");

    // a witness alone overrules
    let travel = good.with(Feature::SineTravel, good.get(Feature::SineTravel).map(|x| x + 0.02));
    let Outcome::Unexplained { contradicting, reason } = d.diagnose(&travel, &[]).outcome else {
        panic!("unexplained")
    };
    assert_eq!(contradicting, [Feature::SineTravel], "{reason}");
}

#[test]
fn prop_coverage_that_is_asked_for_is_reported() {
    let spread = Spread::none();
    let (units, measured) = fresh(&READY.setup, &spread, 200, 7).unwrap();
    let of = |coverage: f64| {
        let d = Diagnoser::new(
            READY.none.maps.clone(),
            READY.none.calibration.clone(),
            coverage,
            &Vec::new(),
        )
        .unwrap();
        let cases = judge(&d, &units, &measured);
        share(&cases.iter().collect::<Vec<_>>())
    };
    let (half, most) = (of(0.5), of(0.9));
    println!("{half} {most}");
    assert!((0.4..0.68).contains(&half) && (0.82..0.99).contains(&most));
    assert!(Diagnoser::new(READY.none.maps.clone(), None, 1.0, &Vec::new()).is_err());
}
