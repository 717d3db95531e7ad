//! Fleet datasets by real processes: however they are shared out, killed, stopped and started twice, the same
//! files come of it, byte for byte.

use ema_tests::fleet::{BARE, Files, Fleet, VARIED, copy, files, same, until};
use rand::seq::SliceRandom;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use schemas::error::EXIT_INTERRUPTED;
use sim_worker::dataset::plan::DatasetPlan;
use sim_worker::dataset::storage::Storage;
use sim_worker::dataset::tables::Table;
use sim_worker::dataset::verify::verify;
use std::collections::BTreeSet;
use std::sync::OnceLock;
use std::time::Duration;

const PROGRAM: &str = env!("CARGO_BIN_EXE_sim-worker-under-test");
const VARIED_PARTS: usize = 15;

/// The undisturbed dataset of [`VARIED`].
fn varied() -> &'static Files {
    static MADE: OnceLock<Files> = OnceLock::new();
    MADE.get_or_init(|| Fleet::new(PROGRAM, VARIED).single())
}

/// Everything staged, nothing merged.
fn staged() -> Fleet {
    let fleet = Fleet::new(PROGRAM, VARIED);
    fleet.run(&["--out", "staged"]).done();
    fleet
}

fn pause(rng: &mut ChaCha8Rng, most_ms: u64) {
    std::thread::sleep(Duration::from_micros(rng.random_range(0..most_ms * 1000)));
}

/// Verification finds nothing, every run is there once, nothing else lies there.
fn sound(fleet: &Fleet, out: &str) {
    let storage = Storage::open(fleet.path(out).to_str().unwrap()).unwrap();
    let report = verify(&storage, |_, _| ()).unwrap();
    assert!(report.finished && report.findings.is_empty(), "{report:?}");
    let plan = DatasetPlan::read(&fleet.path("plan.toml")).unwrap();
    let parts = plan.parts();
    let runs: Vec<u64> = parts.iter().flat_map(|p| p.runs.clone()).collect();
    assert_eq!(runs, (0..plan.runs()).collect::<Vec<_>>());
    let mut wanted: BTreeSet<String> = parts
        .iter()
        .filter(|p| p.telemetry)
        .map(|p| plan.telemetry_path(p))
        .collect();
    wanted.extend(
        [
            "plan.toml",
            "manifest.json",
            "actuators/part-0000.parquet",
            "features/part-0000.parquet",
        ]
        .map(String::from),
    );
    assert_eq!(fleet.files(out).into_keys().collect::<BTreeSet<_>>(), wanted);
}

#[test]
fn e2e_any_number_of_shards_in_any_order_makes_the_same_bytes() {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let fleet = Fleet::new(PROGRAM, VARIED);
    assert!(varied().len() > 10, "{:?}", varied().keys());
    for (count, jobs) in [(1, "2"), (3, "1"), (3, "2"), (8, "2"), (40, "1")] {
        let out = format!("shards-{count}-{jobs}");
        let mut order: Vec<usize> = (0..count).collect();
        order.shuffle(&mut rng);
        for i in order {
            let shard = format!("{i}/{count}");
            let said = fleet.run(&["--out", &out, "--shard", &shard, "--jobs", jobs]).done();
            assert!(said.starts_with(&format!("shard {shard} of ")), "{said}");
        }
        fleet.run(&["--out", &out, "--merge"]).done();
        same(&fleet.files(&out), varied());
        sound(&fleet, &out);
    }
}

#[test]
fn e2e_features_of_the_preflight_test_do_not_depend_on_shards() {
    let plan = VARIED.replace("\"short.toml\"", "\"preflight\"");
    let plan = plan.replace("[0.0, 12.5]", "[0.0]").replace("count = 3", "count = 2");
    let plan = plan.replace("rate_hz = 2500.0", "rate_hz = 1000.0\nof = \"test\"");
    let fleet = Fleet::new(PROGRAM, &plan);
    let whole = fleet.single();
    for shard in ["4/5", "0/5", "3/5", "1/5", "2/5"] {
        fleet.run(&["--out", "a", "--shard", shard, "--jobs", "1"]).done();
    }
    fleet.run(&["--out", "a", "--merge"]).done();
    same(&fleet.files("a"), &whole);
    sound(&fleet, "a");
    let path = "features/part-0000.parquet";
    let table = Table::read(path, whole[path].clone().into()).unwrap();
    let sequences = table.texts("sequence").unwrap();
    for column in [
        "p1_rad_per_s",
        "p2_a",
        "p3",
        "p2_sd_a",
        "rise_s",
        "speed_loss_rad_per_s",
    ] {
        let values = table.values(column).unwrap();
        let of = |name: &str| values.iter().zip(&sequences).filter(|(_, s)| *s == name).count();
        assert_eq!((of("preflight"), of("brief")), (8, 14));
        let there = |(v, s): (&Option<f64>, &String)| s != "preflight" || v.is_some_and(f64::is_finite);
        assert!(values.iter().zip(&sequences).all(there), "{column}: {values:?}");
    }
    // friction is seen
    let (fsj, p1) = (table.values("fsj").unwrap(), table.values("p1_rad_per_s").unwrap());
    let first = sequences.iter().position(|s| s == "preflight").unwrap();
    assert!(fsj[first] < fsj[first + 1] && p1[first] < p1[first + 1], "{p1:?}");
}

#[test]
fn e2e_a_merge_names_the_shards_that_are_missing_and_changes_nothing() {
    let fleet = Fleet::new(PROGRAM, VARIED);
    for i in [0, 1, 3] {
        fleet.run(&["--out", "a", "--shard", &format!("{i}/5")]).done();
    }
    let before = fleet.files("a");
    let mut merge = fleet.command(&["--out", "a", "--merge"]);
    merge.env("EMA_SHARDS", "5");
    let ended = Fleet::started(merge).wait();
    assert!(ended.line(3).contains("6 of 15 parts are missing"), "{ended:?}");
    assert!(ended.line(3).ends_with("--shard 2/5, 4/5"), "{ended:?}");
    same(&fleet.files("a"), &before);
    assert_eq!(fleet.complete("a"), 6);
    same(&fleet.files("a"), varied());
    // nothing there at all
    let ended = fleet.run(&["--out", "b", "--merge"]);
    assert!(ended.line(3).contains("15 of 15 parts are missing"));
}

#[test]
fn e2e_killed_workers_and_merges_leave_no_trace() {
    let mut rng = ChaCha8Rng::seed_from_u64(2);
    let (mut kills, mut at_work, mut merges_killed, mut rounds) = (0, 0, 0, 0);
    while kills < 40 || at_work < 10 || merges_killed < 10 {
        let fleet = Fleet::new(PROGRAM, VARIED);
        let mut open = vec!["0/3", "1/3", "2/3"];
        // rarely in time at first, always in the end
        let mut patience_ms = 10;
        while !open.is_empty() {
            let k = rng.random_range(0..open.len());
            let before = fleet.files("a").len();
            let worker = fleet.start(&["--out", "a", "--shard", open[k]]);
            pause(&mut rng, patience_ms);
            worker.signal("KILL");
            let code = worker.wait().code();
            let seen = fleet.files("a");
            if code == -9 {
                kills += 1;
                at_work += usize::from(seen.len() > before + 1);
                patience_ms += 3;
            } else {
                // just in time
                assert_eq!(code, 0);
                open.remove(k);
            }
            assert!(!seen.contains_key("manifest.json"));
            // what a reader's glob finds is whole
            let telemetry = |k: &&String| k.starts_with("telemetry/");
            for k in seen.keys().filter(telemetry) {
                assert!(seen[k] == varied()[k], "{k}");
            }
        }
        for _ in 0..20 {
            let mut merge = fleet.start(&["--out", "a", "--merge"]);
            pause(&mut rng, 30);
            if merge.ended() {
                merge.wait().done();
                break;
            }
            merge.signal("KILL");
            merges_killed += usize::from(merge.wait().code() == -9);
            let seen = fleet.files("a");
            if seen.contains_key("manifest.json") {
                // readers see a whole dataset, whatever is still below _staging
                let visible = seen.into_iter().filter(|(k, _)| !k.starts_with("_staging/"));
                same(&visible.collect(), varied());
            }
        }
        fleet.run(&["--out", "a", "--merge"]).done();
        same(&fleet.files("a"), varied());
        sound(&fleet, "a");
        rounds += 1;
    }
    println!("{kills} workers ({at_work} after their first part) and {merges_killed} merges killed, {rounds} datasets");
}

#[test]
fn e2e_two_workers_on_the_same_shard_agree() {
    let fleet = Fleet::new(PROGRAM, VARIED);
    for _ in 0..3 {
        let _ = std::fs::remove_dir_all(fleet.path("a"));
        let workers: Vec<_> = (0..3).map(|_| fleet.start(&["--out", "a", "--jobs", "1"])).collect();
        for w in workers {
            w.wait().done();
        }
        fleet.run(&["--out", "a", "--merge"]).done();
        same(&fleet.files("a"), varied());
    }
}

#[test]
fn e2e_a_late_worker_changes_nothing() {
    let fleet = Fleet::new(PROGRAM, VARIED);
    // stopped in the middle, as on a machine that was cut off
    let late = fleet.start(&["--out", "a", "--jobs", "1"]);
    until("a part", || {
        fleet.files("a").keys().any(|k| k.starts_with("_staging/parts/"))
    });
    late.signal("STOP");
    fleet.run(&["--out", "a"]).done();
    fleet.run(&["--out", "a", "--merge"]).done();
    let visible = |f: Files| f.into_iter().filter(|(k, _)| !k.starts_with("_staging/")).collect();
    same(&visible(fleet.files("a")), varied());
    late.signal("CONT");
    late.wait().done();
    same(&visible(fleet.files("a")), varied());
    // the next merge takes away what it left
    fleet.run(&["--out", "a", "--merge"]).done();
    same(&fleet.files("a"), varied());
    // one that starts after the merge has nothing to do
    let said = fleet.run(&["--out", "a", "--shard", "1/3"]).done();
    assert!(said.contains("5 parts were there before"), "{said}");
    same(&fleet.files("a"), varied());
}

#[test]
fn e2e_merges_and_workers_at_once_make_the_same_dataset() {
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    let fleet = staged();
    for round in 0..12 {
        let out = format!("race-{round}");
        copy(&fleet.path("staged"), &fleet.path(&out));
        // each stops somewhere for a while
        let all: Vec<_> = [true, true, false, false]
            .map(|merge| {
                let mut args = vec!["--out", out.as_str()];
                args.extend(merge.then_some("--merge"));
                let p = fleet.start(&args);
                pause(&mut rng, 10);
                p.signal("STOP");
                p
            })
            .into();
        for p in &all {
            p.signal("CONT");
            pause(&mut rng, 10);
        }
        for p in all {
            p.wait().done();
        }
        fleet.run(&["--out", &out, "--merge"]).done();
        same(&fleet.files(&out), varied());
    }
}

#[test]
fn e2e_sigterm_stops_a_worker_which_goes_on_later() {
    let long = VARIED.replace("count = 3", "count = 60");
    let fleet = Fleet::new(PROGRAM, &long);
    for signal in ["TERM", "INT"] {
        let worker = fleet.start(&["--out", "a"]);
        let before = fleet.files("a").len();
        until("a part", || fleet.files("a").len() > before + 3);
        worker.signal(signal);
        let ended = worker.wait();
        let line = ended.line(EXIT_INTERRUPTED.into());
        assert!(line.contains("what is done is kept"), "{line}");
        let left = fleet.files("a");
        assert!(left.keys().all(|k| !k.starts_with("_staging/tmp")), "{:?}", left.keys());
        let done = left.keys().filter(|k| k.starts_with("_staging/parts/")).count();
        assert!(done > 0 && done < 300, "{done} parts");
    }
    // the shares of the first three actuators are complete, whatever was done before
    for i in 0..3 {
        fleet.run(&["--out", "a", "--shard", &format!("{i}/60")]).done();
    }
    let (made, telemetry) = (fleet.files("a"), |k: &&String| k.starts_with("telemetry/"));
    assert!(made.keys().filter(telemetry).count() >= VARIED_PARTS);
}

#[test]
fn e2e_sigterm_to_a_merge_does_no_harm() {
    let mut rng = ChaCha8Rng::seed_from_u64(4);
    let fleet = staged();
    let mut stopped = 0;
    for round in 0..8 {
        let out = format!("merge-{round}");
        copy(&fleet.path("staged"), &fleet.path(&out));
        let merge = fleet.start(&["--out", &out, "--merge"]);
        pause(&mut rng, 20);
        merge.signal("TERM");
        let code = merge.wait().code();
        // before the program listens, the signal itself ends it
        assert!([0, 130, -15].contains(&code), "{code}");
        stopped += usize::from(code != 0);
        fleet.run(&["--out", &out, "--merge"]).done();
        same(&fleet.files(&out), varied());
    }
    println!("{stopped} of 8 merges stopped");
}

/// The worker with these variables and a dataset `out`.
fn with(fleet: &Fleet, out: &str, variables: &[(&str, &str)]) -> ema_tests::fleet::Ended {
    let mut c = fleet.command(&["--out", out]);
    c.envs(variables.iter().copied());
    Fleet::started(c).wait()
}

fn staged_parts(fleet: &Fleet, out: &str) -> Vec<String> {
    let name = |k: &String| k.strip_prefix("_staging/parts/part-").map(|k| k[..6].to_string());
    fleet.files(out).keys().filter_map(name).collect()
}

#[test]
fn e2e_jobs_of_clusters_say_their_shard() {
    let fleet = Fleet::new(PROGRAM, BARE);
    let whole = fleet.single();
    for i in 0..4 {
        let i = i.to_string();
        with(&fleet, "pods", &[("JOB_COMPLETION_INDEX", &i), ("EMA_SHARDS", "4")]).done();
        let array = [
            ("SLURM_ARRAY_TASK_ID", i.as_str()),
            ("SLURM_ARRAY_TASK_MIN", "0"),
            ("SLURM_ARRAY_TASK_MAX", "3"),
            ("SLURM_ARRAY_TASK_STEP", "1"),
            ("SLURM_ARRAY_TASK_COUNT", "4"),
            ("SLURM_CPUS_PER_TASK", "1"),
        ];
        let said = with(&fleet, "array", &array).done();
        assert!(said.starts_with(&format!("shard {i}/4 of ")), "{said}");
        if i == "0" {
            assert_eq!(staged_parts(&fleet, "pods"), ["000000", "000001", "000002"]);
        }
    }
    for out in ["pods", "array"] {
        fleet.run(&["--out", out, "--merge"]).done();
        same(&fleet.files(out), &whole);
    }
    // a single task again, by the number of all shards
    let array = [
        ("SLURM_ARRAY_TASK_ID", "3"),
        ("SLURM_ARRAY_TASK_MIN", "1"),
        ("SLURM_ARRAY_TASK_MAX", "3"),
        ("SLURM_ARRAY_TASK_STEP", "2"),
        ("SLURM_ARRAY_TASK_COUNT", "2"),
        ("EMA_SHARDS", "4"),
    ];
    with(&fleet, "again", &array).done();
    assert_eq!(staged_parts(&fleet, "again"), ["000009", "000010", "000011"]);
    // the dataset by its variable; a shard that is told wins
    let mut c = fleet.command(&["--shard", "1/12"]);
    c.envs([
        ("EMA_DATASET", "named"),
        ("JOB_COMPLETION_INDEX", "3"),
        ("EMA_SHARDS", "4"),
    ]);
    Fleet::started(c).wait().done();
    assert_eq!(staged_parts(&fleet, "named"), ["000001"]);
}

#[test]
fn refuse_jobs_that_do_not_say_their_shard() {
    let fleet = Fleet::new(PROGRAM, BARE);
    let task = |id, min, max, count| {
        vec![
            ("SLURM_ARRAY_TASK_ID", id),
            ("SLURM_ARRAY_TASK_MIN", min),
            ("SLURM_ARRAY_TASK_MAX", max),
            ("SLURM_ARRAY_TASK_COUNT", count),
        ]
    };
    for (variables, named) in [
        (vec![("JOB_COMPLETION_INDEX", "3")], "EMA_SHARDS"),
        (
            vec![("JOB_COMPLETION_INDEX", "4"), ("EMA_SHARDS", "4")],
            "JOB_COMPLETION_INDEX",
        ),
        (
            vec![("JOB_COMPLETION_INDEX", "-1"), ("EMA_SHARDS", "4")],
            "JOB_COMPLETION_INDEX",
        ),
        (
            vec![("JOB_COMPLETION_INDEX", "0"), ("EMA_SHARDS", "four")],
            "EMA_SHARDS",
        ),
        (vec![("JOB_COMPLETION_INDEX", "0"), ("EMA_SHARDS", "0")], "EMA_SHARDS"),
        (
            vec![("SLURM_ARRAY_TASK_ID", "7"), ("EMA_SHARDS", "4")],
            "SLURM_ARRAY_TASK_ID",
        ),
        (vec![("SLURM_ARRAY_TASK_ID", "7")], "SLURM_ARRAY_TASK_MIN"),
        (task("7", "3", "7", "2"), "EMA_SHARDS"),
        (task("9", "0", "7", "8"), "EMA_SHARDS"),
        (task("1", "0", "1e3", "8"), "SLURM_ARRAY_TASK_MAX"),
        (task("1", "0", "99999999999999999999", "8"), "SLURM_ARRAY_TASK_MAX"),
    ] {
        let ended = with(&fleet, "a", &variables);
        let line = ended.line(4);
        assert!(line.contains(named), "{variables:?}: {line}");
    }
    for shard in ["4", "4/4", "-1/4", "a/b", "1/0", "1.0/4", "/", "18446744073709551616/4"] {
        let ended = fleet.run(&["--out", "a", &format!("--shard={shard}")]);
        let line = ended.line(4);
        assert!(line.contains("--shard") && line.contains("I/N"), "{line}");
    }
    // the command line itself
    for args in [
        &["--shard", "0/2", "--merge"][..],
        &["--jobs", "two"],
        &["--jobs", "0"],
        &["--jobs", "100000"],
        &["--unknown"],
        &["--plan", "again.toml"],
    ] {
        assert_eq!(fleet.run(args).code(), 2, "{args:?}");
    }
    assert!(fleet.files("a").is_empty());
    assert!(files(&fleet.path("bare")).is_empty());
}
