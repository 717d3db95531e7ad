use super::{near, number, row, truth, word, write};
use crate::{Question, output};
use polars::prelude::*;
use std::path::Path;
use tempfile::tempdir;

const STEPS: std::ops::RangeInclusive<i32> = -4..=4;

fn name(k: i32) -> String {
    format!("T-{}.left", k + 4)
}

/// Nine actuators k = -4 to 4 on a grid of 3 x 3 points, and a test run each that is no part of the maps.
/// Actuator 2 has a P2 that is 1 A too high everywhere, actuator 3 a P3 that is 5 too high off the healthy point.
/// `change` of (k, fsj, zeta) is added to P1; None leaves the run out.
fn fleet(dir: &Path, change: impl Fn(i32, f64, f64) -> Option<f64>) {
    let mut rows: Vec<(i32, &str, f64, f64, f64)> = Vec::new();
    for k in STEPS {
        for zeta in [0.0, 0.1, 0.2] {
            for fsj in [1.0, 2.0, 3.0] {
                if let Some(more) = change(k, fsj, zeta) {
                    rows.push((k, "map", fsj, zeta, more));
                }
            }
        }
        rows.push((k, "test", 2.0, 0.1, 1e6));
    }
    let n = rows.len();
    let of = |f: &dyn Fn(f64, f64, f64) -> f64| -> Vec<f64> {
        rows.iter()
            .map(|r| f(r.0 as f64, r.2, r.3) + if r.1 == "test" { 1e6 } else { 0.0 })
            .collect()
    };
    let p3 = of(&|k, f, _| if k == 3.0 && f > 1.0 { f + 5.0 } else { f });
    let p3_rad: Vec<f64> = p3.iter().map(|p| 1e-5 * p).collect();
    let mut columns = vec![
        Column::new("run".into(), (0..n as u64).collect::<Vec<_>>()),
        Column::new("actuator".into(), rows.iter().map(|r| name(r.0)).collect::<Vec<_>>()),
        Column::new(
            "tail".into(),
            rows.iter().map(|r| format!("T-{}", r.0 + 4)).collect::<Vec<_>>(),
        ),
        Column::new("position".into(), vec!["left"; n]),
        Column::new("sequence".into(), vec!["preflight"; n]),
        Column::new("kind".into(), rows.iter().map(|r| r.1).collect::<Vec<_>>()),
        Column::new("fsj".into(), rows.iter().map(|r| r.2).collect::<Vec<_>>()),
        Column::new("zeta".into(), rows.iter().map(|r| r.3).collect::<Vec<_>>()),
        Column::new("rest_angle_rad".into(), vec![0.0; n]),
        Column::new(
            "p1_rad_per_s".into(),
            rows.iter()
                .map(|r| 0.1 + 0.01 * r.0 as f64 + 0.2 * (r.2 - 1.0) + r.3 + r.4)
                .collect::<Vec<_>>(),
        ),
    ];
    for (column, values) in [
        ("p3", p3),
        ("p3_rad", p3_rad),
        ("speed_loss_rad_per_s", of(&|k, f, z| 0.01 * k + f * z)),
        ("mean_speed_rad_per_s", of(&|k, _, _| 1.2 - 0.01 * k)),
        ("ripple_rad_per_s", of(&|k, _, z| 0.001 + 1e-4 * k + z)),
        (
            "p2_a",
            of(&|k, f, z| 0.5 * f + 2.0 * z + 0.01 * k + if k == 2.0 { 1.0 } else { 0.0 }),
        ),
        ("rise_s", of(&|k, _, _| 2.0 * 1e-3 * (10.0 + k))),
        ("current_rms_a", of(&|k, _, _| 1.0 + 0.01 * k * k)),
    ] {
        columns.push(Column::new(column.into(), values));
    }
    for sd in [
        "mean_speed_sd_rad_per_s",
        "ripple_sd_rad_per_s",
        "p2_sd_a",
        "p3_sd_rad",
        "rise_sd_s",
    ] {
        columns.push(Column::new(sd.into(), vec![0.01; n]));
    }
    columns.push(Column::new("current_rms_sd_a".into(), vec![Option::<f64>::None; n]));
    write(
        &dir.join("features/part-0000.parquet"),
        DataFrame::new(n, columns).unwrap(),
    );
    let actuators: Vec<i32> = STEPS.collect();
    let drawn = df!(
        "actuator" => actuators.iter().map(|&k| name(k)).collect::<Vec<_>>(),
        "tail" => actuators.iter().map(|k| format!("T-{}", k + 4)).collect::<Vec<_>>(),
        "position" => vec!["left"; 9],
        "inertia_kg_m2" => actuators.iter().map(|&k| 1e-3 * (10.0 + k as f64)).collect::<Vec<_>>(),
        "gear_ratio" => vec![500.0; 9],
    );
    write(&dir.join("actuators/part-0000.parquet"), drawn.unwrap());
}

fn plain(_: i32, _: f64, _: f64) -> Option<f64> {
    Some(0.0)
}

#[test]
fn levels_of_a_feature_are_those_worked_out_by_hand() {
    let dir = tempdir().unwrap();
    fleet(dir.path(), plain);
    let frame = Question::FaultLevels.ask(dir.path(), None).unwrap().frame;
    assert_eq!(frame.height(), 4 * 9);
    let i = row(&frame, &[("feature", "p1")], &[("fsj", 2.0), ("zeta", 0.1)]);
    assert_eq!(number(&frame, "n", i), 9.0);
    near(number(&frame, "mean", i), 0.4);
    near(number(&frame, "median", i), 0.4);
    // k = -4..4: variance 60 / 8; the 5th percentile lies 0.4 steps above the least
    near(number(&frame, "sd", i), 0.01 * 7.5f64.sqrt());
    near(number(&frame, "p05", i), 0.4 - 0.036);
    near(number(&frame, "p95", i), 0.4 + 0.036);
    assert_eq!(word(&frame, "unit", i), "rad/s");
}

#[test]
fn the_planted_actuator_is_first_out_of_family() {
    let dir = tempdir().unwrap();
    fleet(dir.path(), plain);
    let answer = Question::OutOfFamily.ask(dir.path(), None).unwrap();
    let frame = &answer.frame;
    assert_eq!(word(frame, "actuator", 0), name(2));
    assert_eq!(
        (word(frame, "tail", 0).as_str(), word(frame, "position", 0).as_str()),
        ("T-6", "left")
    );
    assert_eq!(word(frame, "feature", 0), "p2");
    // k = -4..4 without 2, and 102: median 0, deviations 0 1 1 2 3 3 4 4 102, their median 3
    near(number(frame, "median_abs_z", 0), 1.02 / (1.4826 * 0.03));
    near(number(frame, "share_beyond", 0), 1.0);
    assert_eq!(
        (truth(frame, "flagged", 0), truth(frame, "flagged_in_fleet", 0)),
        (Some(true), Some(true))
    );
    assert_eq!(number(frame, "points", 0), 9.0);
    let flagged = (0..frame.height())
        .filter(|&i| truth(frame, "flagged", i) == Some(true))
        .count();
    // 9, -16 .. in steps of k^2: nobody else
    assert_eq!(flagged, 1);
    let all: Vec<f64> = (0..frame.height()).map(|i| number(frame, "median_abs_z", i)).collect();
    assert!(all.windows(2).all(|w| w[0] >= w[1]), "{all:?}");
    // more than half of the actuators agree in P3 to the last digit: no scale, no flag, and it says so
    assert!((0..frame.height()).all(|i| word(frame, "feature", i) != "p3"));
    assert!(
        answer
            .notes
            .iter()
            .any(|n| n.starts_with("p3: 9 of 9 grid points left out")),
        "{:?}",
        answer.notes
    );
}

#[test]
fn a_map_that_is_aside_at_one_point_only_is_seen_but_not_flagged() {
    let dir = tempdir().unwrap();
    let aside = |k, f, z| Some(if (k, f, z) == (-1, 3.0, 0.2) { 2.0 } else { 0.0 });
    fleet(dir.path(), aside);
    let frame = Question::OutOfFamily.ask(dir.path(), None).unwrap().frame;
    let i = row(&frame, &[("actuator", &name(-1)), ("feature", "p1")], &[]);
    assert_eq!(truth(&frame, "flagged", i), Some(false));
    assert_eq!(
        (number(&frame, "worst_fsj", i), number(&frame, "worst_zeta", i)),
        (3.0, 0.2)
    );
    near(number(&frame, "share_beyond", i), 1.0 / 9.0);
    near(number(&frame, "value_there", i), 0.1 - 0.01 + 0.4 + 0.2 + 2.0);
    assert!(number(&frame, "worst_abs_z", i) > 40.0);
}

#[test]
fn slopes_and_shares_are_those_of_a_plane() {
    let dir = tempdir().unwrap();
    fleet(dir.path(), plain);
    let frame = Question::Sensitivity.ask(dir.path(), None).unwrap().frame;
    let at = [("fsj_from", 1.0), ("zeta_from", 0.0)];
    let i = row(&frame, &[("feature", "p2")], &at);
    near(number(&frame, "per_fsj", i), 0.5);
    near(number(&frame, "per_zeta", i), 2.0);
    near(number(&frame, "per_fsj_sd", i), 0.0);
    near(number(&frame, "noise", i), 0.01);
    near(number(&frame, "per_fsj_in_noise", i), 50.0);
    near(number(&frame, "per_zeta_in_noise", i), 200.0);
    near(number(&frame, "fsj_share", i), 2.0 / 3.0);
    assert_eq!(number(&frame, "actuators", i), 9.0);
    // P3 of actuator 3 rises by 6 from FSJ 1 to 2, that of the others by 1
    let i = row(&frame, &[("feature", "p3")], &at);
    near(number(&frame, "per_fsj", i), (8.0 + 6.0) / 9.0);
    near(number(&frame, "per_fsj_sd", i), (25.0 / 9.0f64).sqrt());
    near(number(&frame, "per_zeta", i), 0.0);
    // no measured standard deviation, nothing in its units
    let i = row(&frame, &[("feature", "current_rms")], &at);
    assert!(number(&frame, "noise", i).is_nan() && number(&frame, "per_fsj_in_noise", i).is_nan());
}

#[test]
fn a_feature_follows_the_parameter_that_it_is_made_of() {
    let dir = tempdir().unwrap();
    fleet(dir.path(), plain);
    let answer = Question::ParameterSensitivity.ask(dir.path(), None).unwrap();
    let frame = &answer.frame;
    let i = row(frame, &[("feature", "rise_s"), ("parameter", "inertia_kg_m2")], &[]);
    near(number(frame, "correlation", i), 1.0);
    near(number(frame, "slope", i), 2.0);
    near(number(frame, "elasticity", i), 1.0);
    assert_eq!(number(frame, "n", i), 9.0);
    // k^2 does not go with k
    let i = row(
        frame,
        &[("feature", "current_rms_a"), ("parameter", "inertia_kg_m2")],
        &[],
    );
    near(number(frame, "correlation", i), 0.0);
    assert!((0..frame.height()).all(|i| word(frame, "parameter", i) != "gear_ratio"));
    assert!(
        answer
            .notes
            .contains(&"the same in all actuators: gear_ratio".to_string()),
        "{:?}",
        answer.notes
    );
}

#[test]
fn the_planted_drift_is_first_and_nobody_is_dropped() {
    let (first, second) = (tempdir().unwrap(), tempdir().unwrap());
    fleet(first.path(), |k, _, _| (k != -4).then_some(0.0));
    fleet(second.path(), |k, f, z| match (k, f, z) {
        (4, ..) => None,
        (1, 3.0, 0.2) => Some(-0.3),
        (1, ..) => Some(0.06),
        _ => Some(0.0),
    });
    let answer = Question::MapDrift.ask(first.path(), Some(second.path())).unwrap();
    let frame = &answer.frame;
    assert_eq!(
        (word(frame, "actuator", 0), word(frame, "feature", 0).as_str()),
        (name(1), "p1")
    );
    assert_eq!(
        (number(frame, "greatest_fsj", 0), number(frame, "greatest_zeta", 0)),
        (3.0, 0.2)
    );
    // P1 of one actuator reaches from 0 to 0.2 x 2 + 0.2
    near(number(frame, "range", 0), 0.6);
    near(number(frame, "greatest_drift", 0), 0.5);
    near(number(frame, "median_drift", 0), 0.1);
    near(number(frame, "difference_there", 0), -0.3);
    assert_eq!(number(frame, "points", 0), 9.0);
    assert_eq!(number(frame, "greatest_drift", 1), 0.0);
    row(frame, &[("actuator", &name(4)), ("datasets", "first only")], &[]);
    row(frame, &[("actuator", &name(-4)), ("datasets", "second only")], &[]);
    let right = "7 actuators in both datasets, 1 only in the first, 1 only in the second";
    assert_eq!(answer.notes, [right]);
}

/// Five diagnoses of tail A, one of B.
pub fn diagnoses(dir: &Path) {
    let located = [true, true, true, false, true, true];
    let some = |v: [f64; 6]| -> Vec<Option<f64>> { v.iter().zip(located).map(|(v, l)| l.then_some(*v)).collect() };
    let frame = df!(
        "run" => [10u64, 11, 12, 13, 14, 15],
        "actuator" => ["A.l", "A.l", "A.l", "A.l", "A.l", "B.l"],
        "tail" => ["A", "A", "A", "A", "A", "B"],
        "position" => ["l"; 6],
        "sequence" => ["preflight"; 6],
        "fsj" => [1.5, 1.5, 2.5, 2.5, 9.0, 1.5],
        "zeta" => [0.1, 0.1, 0.2, 0.2, 0.1, 0.1],
        "outcome" => ["located", "located", "located", "unexplained", "out_of_range", "located"],
        "fsj_lo" => some([1.4, 1.45, 2.4, 0.0, 4.0, 1.4]),
        "fsj_hi" => some([1.6, 1.75, 2.7, 0.0, 5.0, 1.6]),
        "fsj_estimate" => some([1.5, 1.6, 2.55, 0.0, 4.5, 1.5]),
        "zeta_lo" => some([0.09, 0.09, 0.21, 0.0, 0.09, 0.09]),
        "zeta_hi" => some([0.11, 0.13, 0.22, 0.0, 0.11, 0.11]),
        "zeta_estimate" => some([0.1, 0.11, 0.215, 0.0, 0.1, 0.1]),
        "coverage" => [0.95; 6],
        "maps" => ["own"; 6],
    );
    write(&dir.join("diagnoses/part-0000.parquet"), frame.unwrap());
}

#[test]
fn coverage_counts_by_tail_and_in_all() {
    let dir = tempdir().unwrap();
    diagnoses(dir.path());
    let frame = Question::Coverage.ask(dir.path(), None).unwrap().frame;
    assert_eq!(frame.height(), 3);
    assert_eq!([0, 1, 2].map(|i| word(&frame, "tail", i)), ["A", "B", "total"]);
    let all = |c: &str| [0, 1, 2].map(|i| number(&frame, c, i));
    assert_eq!(all("tests"), [5.0, 1.0, 6.0]);
    assert_eq!(all("located"), [3.0, 1.0, 4.0]);
    assert_eq!(all("unexplained"), [1.0, 0.0, 1.0]);
    assert_eq!(all("out_of_range"), [1.0, 0.0, 1.0]);
    assert_eq!(all("incomplete"), [0.0; 3]);
    // run 12 has zeta outside, run 14 FSJ
    assert_eq!(all("inside"), [2.0, 1.0, 3.0]);
    near(number(&frame, "inside_share", 2), 0.5);
    near(number(&frame, "inside_share_of_located", 2), 0.75);
    // Wilson for 3 of 6: 0.5 -+ 1.96 sqrt(0.25 / 6 + 1.96^2 / 144) / (1 + 1.96^2 / 6), 0.1876 to 0.8124
    assert!((number(&frame, "inside_share_lo", 2) - 0.1876).abs() < 5e-5);
    assert!((number(&frame, "inside_share_hi", 2) - 0.8124).abs() < 5e-5);
    // FSJ widths of A: 0.2 0.3 0.3 1.0
    near(number(&frame, "median_width_fsj", 0), 0.3);
    near(number(&frame, "median_width_zeta", 1), 0.02);
}

#[test]
fn outcomes_are_counted_where_the_true_pair_lies() {
    let dir = tempdir().unwrap();
    diagnoses(dir.path());
    let frame = Question::Outcomes.ask(dir.path(), None).unwrap().frame;
    assert_eq!(frame.height(), 3);
    let i = row(&frame, &[("maps", "own")], &[("fsj_from", 2.0), ("zeta_from", 0.125)]);
    assert_eq!(
        (number(&frame, "tests", i), number(&frame, "unexplained", i)),
        (2.0, 1.0)
    );
    // beyond the plane: counted in its outermost region
    let i = row(&frame, &[], &[("fsj_from", 4.0), ("zeta_from", 0.0)]);
    assert_eq!(number(&frame, "out_of_range", i), 1.0);
}

#[test]
fn what_is_missing_is_said_in_one_line() {
    let dir = tempdir().unwrap();
    diagnoses(dir.path());
    let why = |q: Question, with: Option<&Path>| format!("{:#}", q.ask(dir.path(), with).unwrap_err());
    let e = why(Question::OutOfFamily, None);
    assert!(
        e.contains("table `features`") && e.contains("ema dataset make") && !e.contains('\n'),
        "{e}"
    );
    // a table of something else
    let one = df!("run" => [0u64], "fsj" => [1.0], "zeta" => [0.0], "rest_angle_rad" => [0.0],
        "mean_speed_rad_per_s" => [1.0], "ripple_rad_per_s" => [0.1], "p3_rad" => [1e-5]);
    write(&dir.path().join("features/block-0000.parquet"), one.unwrap());
    let e = why(Question::FaultLevels, None);
    assert!(e.contains("no column") && e.contains("features of a dataset"), "{e}");
    assert!(why(Question::MapDrift, None).contains("--with"));
    assert!(why(Question::Coverage, Some(dir.path())).contains("--with"));
    assert!(why(Question::MapDrift, Some(Path::new("nowhere"))).contains("nowhere"));
}

#[test]
fn a_single_word_is_a_question_or_an_error_that_names_all() {
    for q in Question::ALL {
        assert_eq!(Question::from_text(q.name()).unwrap(), Some(q));
    }
    assert_eq!(Question::from_text("SELECT 1").unwrap(), None);
    let e = Question::from_text("covrage").unwrap_err().to_string();
    assert!(
        Question::ALL.iter().all(|q| e.contains(q.name())) && e.contains("covrage"),
        "{e}"
    );
}

#[test]
fn a_table_for_reading_is_rounded_and_says_what_it_does_not_show() {
    let frame =
        df!("name" => ["a", "bc", "d"], "x" => [Some(0.1 + 0.2), Some(-1.234_567e-7), None], "n" => [1u64, 20, 3]);
    let frame = frame.unwrap();
    let right = "name           x   n\na            0.3   1\nbc    -1.2346e-7  20\nd              -   3\n";
    assert_eq!(output::to_table(&frame, 0), right);
    assert_eq!(output::to_table(&df!("x" => [-0.0]).unwrap(), 0), "x\n0\n");
    let short = output::to_table(&frame, 1);
    assert!(short.starts_with("name    x  n\na     0.3  1\n2 more rows"), "{short}");
    assert_eq!(
        output::to_csv(&frame).unwrap().lines().nth(1),
        Some("a,0.30000000000000004,1")
    );
    let json: serde_json::Value = serde_json::from_str(&output::to_json(&frame).unwrap()).unwrap();
    assert_eq!(json[2]["x"], serde_json::Value::Null);
    assert_eq!(json[1]["n"], 20);
    let dir = tempdir().unwrap();
    let file = dir.path().join("t.parquet");
    output::write_parquet(&mut frame.clone(), &file).unwrap();
    let back = ParquetReader::new(std::fs::File::open(file).unwrap()).finish().unwrap();
    assert!(back.equals_missing(&frame));
}

#[test]
fn the_normal_tail_is_that_of_tables() {
    use crate::stats::normal_beyond;
    for (p, x) in [(0.025, 1.959964), (1.349898e-3, 3.0), (2.866516e-7, 5.0)] {
        assert!((normal_beyond(p) - x).abs() < 1e-5, "{p}: {}", normal_beyond(p));
    }
}
