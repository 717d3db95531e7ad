//! Prognoses on fleets that wear by laws of another hand (`ema_tests::lives`): coverage, scores, alarms.
//!
//! The generator was written from the words of the interface alone; its laws are not the filter's equations. Limits stand
//! beside what is seen with a margin for other machines' rounding, not at the bars.

use diagnoser::prognosis::Track;
use diagnoser::prognosis::track::Kind;
use ema_tests::lives::{Bed, Options, Unit as Wearing, files, generate};
use pipeline::prognosis::learn::{Unit, learn, units_of};
use pipeline::prognosis::score::{Scored, score};
use pipeline::prognosis::{Clock, Threshold, read};
use rayon::prelude::*;
use std::collections::BTreeMap;
use std::sync::Arc;

const HORIZONS: [f64; 1] = [20.0];

fn fsj() -> Threshold {
    Threshold::new("fsj", 4.0, None)
}

/// A bed by way of its files, as a user's would come.
fn bed(options: &Options) -> (Vec<Wearing>, Vec<Unit>) {
    let dir = tempfile::tempdir().unwrap();
    let made = generate(options);
    files::write(dir.path(), options, &made).unwrap();
    let file = |name: &str| dir.path().join(name);
    let all: Vec<_> = read::history(&file("history.csv"), &["fsj".into()])
        .unwrap()
        .into_iter()
        .collect();
    let events = read::events(&file("events.csv")).unwrap();
    let truths = match made.iter().any(|u| u.faults[0].growth.is_some()) {
        true => read::truths(&file("truth.csv")).unwrap(),
        false => BTreeMap::new(),
    };
    let units = units_of(&all, &events, &truths, (&fsj(), 0), Clock::Cycle);
    assert_eq!(units.len(), made.len());
    (made, units)
}

fn tracks(units: &[Unit]) -> Vec<Track> {
    let of = |u: &Unit| {
        let prior = diagnoser::prognosis::Prior::shipped(1.0);
        let mut t = Track::new(Arc::new(prior), u.scale);
        t.read_all(&u.history);
        t
    };
    units.par_iter().map(of).collect()
}

fn brier(s: &Scored) -> f64 {
    s.brier[0].1
}

#[test]
fn val_fleets_of_another_hand_are_foretold() {
    let (_, teachers) = bed(&Options {
        units: 100,
        seed: 11,
        ..Options::default()
    });
    let (_, units) = bed(&Options {
        units: 100,
        seed: 12,
        ..Options::default()
    });
    let (fleet, ends) = learn(&teachers, &fsj(), Clock::Cycle).unwrap();
    assert_eq!(ends.told, 100);
    assert!(fleet.is_calibrated() && fleet.is_sound());
    let with = score(&units, Some(&fleet), &HORIZONS).unwrap();
    let without = score(&units, None, &HORIZONS).unwrap();
    for (name, s, limits, most_brier) in [
        ("with a fleet", &with, [0.45, 0.45, 0.3], 0.035),
        ("without", &without, [0.65, 0.55, 0.35], 0.045),
    ] {
        for (a, most) in s.at.iter().zip(limits) {
            println!("{name}: {a:?}");
            assert!((0.78..=1.0).contains(&a.coverage), "{name}: {a:?}");
            assert!(a.crps.0 < most && a.units >= 95, "{name}: {a:?}");
        }
        println!("{name}: coverage {:.3}, Brier {:.4}", s.coverage, brier(s));
        assert!((0.82..=0.99).contains(&s.coverage), "{name}: {}", s.coverage);
        assert!(brier(s) < most_brier, "{name}: {}", brier(s));
    }
    // a fleet teaches: narrower and nearer at the beginning of lives
    assert!(with.at[0].crps.0 < without.at[0].crps.0 && with.at[0].width.0 < without.at[0].width.0);
    // what is said to be improbable hardly happens
    let (_, happened, n) = with.brier[0].2[0];
    assert!(happened < 0.006 && n > 1000, "{happened} of {n}");
}

#[test]
fn val_the_same_bits_over_threads() {
    let (_, teachers) = bed(&Options {
        units: 24,
        seed: 13,
        ..Options::default()
    });
    let of = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| serde_json::to_string(&learn(&teachers, &fsj(), Clock::Cycle).unwrap().0).unwrap())
    };
    assert_eq!(of(1), of(3));
}

#[test]
fn val_repairs_changes_and_healthy_units_are_told_apart() {
    let (made, units) = bed(&Options {
        units: 60,
        seed: 14,
        bed: Bed::RepairsUnrecorded,
        ..Options::default()
    });
    let (mut found, mut wrong) = (0, 0);
    for ((w, u), t) in made.iter().zip(&units).zip(tracks(&units)) {
        let repair = f64::from(w.repair.as_ref().unwrap().flight);
        let after = u
            .history
            .rows
            .iter()
            .filter(|r| r.at > repair && r.lo.is_some())
            .map(|r| r.at)
            .take(3)
            .last()
            .unwrap();
        let mut told = t.alarms.iter().filter(|a| a.kind == Kind::UnrecordedRepair).peekable();
        wrong += told
            .clone()
            .filter(|a| !(repair..=repair + 10.0).contains(&a.at))
            .count();
        found += usize::from(told.next_if(|a| a.at > repair && a.at <= after).is_some());
    }
    println!("repairs: {found} of 60 within three tests, {wrong} false");
    assert!(found >= 57 && wrong == 0);

    let (made, units) = bed(&Options {
        units: 60,
        seed: 15,
        bed: Bed::Triple,
        ..Options::default()
    });
    let told = |(w, t): (&Wearing, &Track)| {
        let growth = w.faults[0].growth.as_ref().unwrap();
        let change = growth.wear.change.unwrap();
        let in_time = |a: &&diagnoser::prognosis::track::Alarm| {
            a.kind == Kind::RateChange && a.at > change && a.at <= change + 0.1 * growth.end
        };
        t.alarms.iter().any(|a| in_time(&a))
    };
    let tracked = tracks(&units);
    let found = made.iter().zip(&tracked).filter(|(w, t)| told((w, t))).count();
    println!("changes: {found} of 60 within a tenth of the life");
    assert!(found >= 50);

    for (seed, ar1) in [(16, 0.0), (17, 0.7)] {
        let (_, units) = bed(&Options {
            units: 60,
            seed,
            bed: Bed::Healthy { tests: 300 },
            ar1,
            ..Options::default()
        });
        let alarmed = tracks(&units).iter().filter(|t| !t.alarms.is_empty()).count();
        println!("healthy, correlation {ar1}: {alarmed} of 60 alarmed");
        // asked: one of a hundred
        assert!(alarmed <= 3);
    }
}

#[test]
fn val_cracks_of_real_lives_are_foretold() {
    let Some(dir) = std::env::var_os("EMA_BENCH_DIR") else {
        return;
    };
    let text = std::fs::read_to_string(std::path::Path::new(&dir).join("virkler/lives_1_to_34.csv")).unwrap();
    let rows: Vec<Vec<f64>> = text
        .lines()
        .skip(1)
        .map(|l| l.split(',').map(|c| c.parse().unwrap()).collect())
        .collect();
    let threshold = Threshold::new("crack_mm", 49.8, Some(9.0));
    // a test every 4000 cycles, 0.1 mm of noise, which is made of the cycles' own digits
    let unit = |k: usize| {
        let end = rows.last().unwrap()[k];
        let mut tests = Vec::new();
        let mut at: f64 = 0.0;
        while at < end {
            let i = rows.partition_point(|r| r[k] <= at).min(rows.len() - 1);
            let (a, b) = (&rows[i - 1], &rows[i]);
            let x = a[0] + (b[0] - a[0]) * (at - a[k]) / (b[k] - a[k]);
            let u = (((at + 7919.0 * k as f64) * 12.9898).sin() * 43_758.545_3)
                .rem_euclid(1.0)
                .clamp(0.001, 0.999);
            let y = x + 0.1 * diagnoser::prognosis::special::normal_quantile(u);
            let level = read::Level {
                lo: Some(y - 0.196),
                hi: Some(y + 0.196),
                estimate: Some(y),
            };
            let moment = read::Moment {
                day: None,
                cycle: Some(at),
            };
            let ended = diagnoser::prognosis::Ended::Located;
            tests.push(read::Test {
                moment,
                ended,
                coverage: 0.95,
                levels: vec![level],
            });
            at += 4000.0;
        }
        let truth = read::End {
            moment: read::Moment {
                day: None,
                cycle: Some(end),
            },
            event: String::new(),
        };
        (format!("specimen {k:02}"), tests, truth)
    };
    let all: Vec<_> = (1..=34).map(unit).collect();
    let truths: BTreeMap<_, _> = all.iter().map(|u| (u.0.clone(), vec![u.2.clone()])).collect();
    let part = |keep: &dyn Fn(usize) -> bool| {
        let tests: Vec<_> = all
            .iter()
            .enumerate()
            .filter(|(i, _)| keep(*i))
            .map(|(_, u)| (u.0.clone(), u.1.clone()))
            .collect();
        units_of(&tests, &BTreeMap::new(), &truths, (&threshold, 0), Clock::Cycle)
    };
    // five folds
    let mut at = vec![(0.0, 0.0, 0.0); 3];
    for fold in 0..5 {
        let (fleet, _) = learn(&part(&|i| i % 5 != fold), &threshold, Clock::Cycle).unwrap();
        let s = score(&part(&|i| i % 5 == fold), Some(&fleet), &[20_000.0]).unwrap();
        for (sum, a) in at.iter_mut().zip(&s.at) {
            let n = a.units as f64;
            *sum = (sum.0 + n * a.coverage, sum.1 + n * a.crps.0, sum.2 + n);
        }
    }
    for (covered, crps, n) in at {
        println!("coverage {:.3}, CRPS over RUL {:.3}, {n} lives", covered / n, crps / n);
        assert!(covered / n > 0.8 && crps / n < 0.08);
    }
}
