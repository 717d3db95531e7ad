//! The extractor gives the same bits whatever the chunks, and the same through every medium.

use ema_tests::reference_run;
use proptest::prelude::*;
use schemas::channel::Channel;
use schemas::feature::{Raw, RawFeatures};
use schemas::recording::{Provenance, Recorder, Recording};
use schemas::telemetry::{Collector, TelemetrySink};
use sim_worker::extractor::{FeatureExtractor, FeaturePlan};
use sim_worker::parameters::ActuatorParameters;
use std::sync::{Arc, LazyLock};

/// Sine and step are in the same place of both.
const SEQUENCES: [&str; 2] = ["preflight", "preflight2"];

static RUNS: LazyLock<[Collector; 2]> = LazyLock::new(|| SEQUENCES.map(|s| reference_run(2.3, 0.21, s, 1000.0)));

fn plan(test: usize) -> Arc<FeaturePlan> {
    let s = sim_worker::catalogue::sequence(SEQUENCES[test]).unwrap();
    Arc::new(FeaturePlan::new(
        &ActuatorParameters::reference(),
        &s,
        1000.0,
        false,
        Default::default(),
    ))
}

fn whole(test: usize) -> [Option<u64>; RawFeatures::COUNT + 1] {
    let mut x = FeatureExtractor::new(plan(test));
    x.push(&RUNS[test].view());
    assert!(x.missing().is_empty(), "{:?}", x.missing());
    let bits = x.features().bits();
    for raw in Raw::ALL {
        // those in between are of the second test alone
        let of_both = (raw as usize) < Raw::SlowBreakAway as usize || (raw as usize) > Raw::Supply as usize;
        let here = test == 1 || of_both;
        assert_eq!(bits[raw as usize].is_some(), here, "{raw:?}");
    }
    assert!(bits[RawFeatures::COUNT].is_some());
    bits
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 64, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn prop_any_chunking_gives_the_same_bits(sizes in prop::collection::vec(1usize..700, 1..200), test in 0usize..2) {
        let mut x = FeatureExtractor::new(plan(test));
        let view = RUNS[test].view();
        let mut from = 0;
        for size in sizes.iter().cycle() {
            let to = (from + size).min(view.rows);
            x.push(&view.slice(from, to));
            from = to;
            if from == view.rows {
                break;
            }
        }
        prop_assert_eq!(x.features().bits(), whole(test));
    }

    #[test]
    fn prop_a_gap_leaves_its_feature_out(at in 0usize..2990, len in 1usize..8, test in 0usize..2) {
        let mut x = FeatureExtractor::new(plan(test));
        let view = RUNS[test].view();
        x.push(&view.slice(0, at));
        x.push(&view.slice(at + len, view.rows));
        let (f, full) = (x.features().bits(), whole(test));
        for k in 0..RawFeatures::COUNT {
            // present and exact, or absent and named
            prop_assert!(f[k] == full[k] || f[k].is_none());
        }
        let hit = |a: usize, b: usize| at < b && at + len > a;
        let (regime, sine) = (hit(2400, 2850), hit(850, 1850));
        // of the first test none of these windows is there
        let no = test == 0;
        let slow = no || hit(100, 850);
        let legs = no || hit(1903, 1997) || hit(2053, 2147);
        for (raw, lost) in [
            (Raw::MeanSpeed, regime),
            (Raw::Ripple, regime),
            (Raw::CurrentRms, regime),
            (Raw::CurrentImbalance, regime),
            (Raw::P2, sine),
            (Raw::SineTravel, sine),
            (Raw::CurrentSum, sine),
            (Raw::EvenCurrent, sine),
            (Raw::BiasCurrent, sine),
            (Raw::SlowBreakAway, slow),
            (Raw::SlowKinetic, slow),
            (Raw::SlowLag, slow),
            (Raw::LegCurrent, legs),
            (Raw::Supply, no || regime),
            (Raw::ThirdCosine, regime),
            (Raw::OtherOrders, regime),
            (Raw::CurrentTrend, regime),
            (Raw::KineticTilt, sine),
            (Raw::KineticBend, sine),
        ] {
            prop_assert_eq!(f[raw as usize].is_none(), lost, "{:?}", raw);
        }
        if regime || sine || (!no && (slow || legs)) {
            prop_assert!(!x.missing().is_empty());
        }
    }
}

/// Where the samples around break-away are lost, the first one off rest that is seen is not P3.
#[test]
fn prop_a_gap_before_breakaway_leaves_p3_out() {
    let full = whole(0)[Raw::P3 as usize].expect("the rotor leaves rest");
    let view = RUNS[0].view();
    let com = RUNS[0].column(Channel::Com).unwrap();
    let breakaway = com.iter().position(|c| c.to_bits() == full).unwrap();
    for (from, to, known) in [
        (breakaway, breakaway + 1, false),
        (breakaway - 1, breakaway + 3, false),
        (1, 2, false),
        // the next sample confirms it
        (breakaway + 1, breakaway + 9, false),
        (breakaway + 2, breakaway + 10, true),
    ] {
        let mut x = FeatureExtractor::new(plan(0));
        x.push(&view.slice(0, from));
        x.push(&view.slice(to, view.rows));
        let p3 = x.features()[Raw::P3].map(f64::to_bits);
        assert_eq!(p3, known.then_some(full), "gap {from}..{to}");
        assert!(x.missing().iter().any(|m| m.contains("P3")));
    }
}

#[test]
fn prop_a_parquet_file_gives_back_the_same_bits() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("run.parquet");
    let header = RUNS[1].header.clone().unwrap();
    let provenance = Provenance {
        rate_hz: 1000.0,
        sequence: "preflight2".into(),
        ..Default::default()
    };
    let mut r = Recorder::create(&path, &provenance, header.channels, false).unwrap();
    r.accept(&header, &RUNS[1].view()).unwrap();
    r.finish().unwrap();
    let mut x = FeatureExtractor::new(plan(1));
    Recording::open(&path).unwrap().replay(333, &mut x).unwrap();
    assert_eq!(x.features().bits(), whole(1));
    assert_eq!(
        std::fs::read_dir(dir.path()).unwrap().count(),
        1,
        "no temporary file is left"
    );
}
