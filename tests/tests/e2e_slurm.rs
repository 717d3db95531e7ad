//! A fleet dataset on Slurm, through the ready scripts, while tasks are cancelled, killed and requeued.

use ema_tests::fleet::{Files, Fleet, VARIED, same};
use ema_tests::slurm::{Slurm, Task};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::fs;
use std::path::Path;
use std::time::{Duration, Instant, SystemTime};

const PROGRAM: &str = env!("CARGO_BIN_EXE_sim-worker-under-test");
const SHARDS: u32 = 8;
/// Beyond it something hangs.
const LIMIT: Duration = Duration::from_secs(300);

fn pick<T>(rng: &mut ChaCha8Rng, from: &mut Vec<T>) -> T {
    from.swap_remove(rng.random_range(0..from.len()))
}

/// `fleet.sh`; gives the numbers of the array job and the merge.
fn submit(slurm: &Slurm, dir: &Path, options: &[&str]) -> (u32, u32) {
    let scripts = Path::new(env!("CARGO_MANIFEST_DIR")).join("../sim-worker/deploy/slurm");
    let output = slurm
        .command(scripts.join("fleet.sh").to_str().unwrap())
        .current_dir(dir)
        .env("SIM_WORKER", PROGRAM)
        .args(["--cpus", "1", "--mem", "100M", "--logs", "logs"])
        .args(options)
        .args(["plan.toml", "dataset", &SHARDS.to_string(), "--nice=1"])
        .output()
        .unwrap();
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{text}{said}");
    let number = |name: &str| {
        let line = text.lines().find(|line| line.starts_with(name)).unwrap();
        let word = line.split_whitespace().nth(2).unwrap();
        word.trim_end_matches(',').parse().unwrap()
    };
    (number("shards"), number("merge"))
}

/// Parts that are staged.
fn staged(files: &Files) -> usize {
    files.keys().filter(|k| k.starts_with("_staging/parts/")).count()
}

#[test]
fn e2e_slurm_a_dataset_survives_cancelled_killed_and_requeued_tasks() {
    let temp = tempfile::tempdir().unwrap();
    let begin = Instant::now();
    let Some(slurm) = Slurm::start(temp.path()) else { return };
    let at = |what: &str| println!("{:5.1} s: {what}", begin.elapsed().as_secs_f64());
    at("Slurm runs");
    let now = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).unwrap();
    let seed = now.as_nanos() as u64;
    println!("seed {seed}");
    let mut rng = ChaCha8Rng::seed_from_u64(seed);

    // a shard is some seconds of one processor
    let fleet = Fleet::new(PROGRAM, &VARIED.replace("count = 3", "count = 160"));
    let work = fleet.path("work dir");
    fs::create_dir(&work).unwrap();
    for name in ["plan.toml", "brief.toml", "short.toml", "grid.toml"] {
        fs::copy(fleet.path(name), work.join(name)).unwrap();
    }
    let whole = fleet.single();
    at("the dataset by one process");

    let (shards, first) = submit(&slurm, &work, &[]);
    let program = Path::new(PROGRAM).file_name().unwrap().to_str().unwrap();
    // some at once, each with a worker at work
    let mut running: Vec<u32> = Vec::new();
    let found = slurm.wait_until(LIMIT, || {
        running = (0..SHARDS)
            .filter(|&i| !slurm.processes(shards, i, program).is_empty())
            .collect();
        running.len() >= 4 && staged(&ema_tests::fleet::files(&work.join("dataset"))) > 0
    });
    assert!(found, "{}", slurm.log());
    at(&format!("{running:?} run"));
    std::thread::sleep(Duration::from_millis(rng.random_range(0..300)));

    let (cancelled, killed, requeued) = (
        pick(&mut rng, &mut running),
        pick(&mut rng, &mut running),
        pick(&mut rng, &mut running),
    );
    slurm.run("scancel", &[&format!("{shards}_{cancelled}")]);
    for process in slurm.processes(shards, killed, program) {
        slurm.kill(process);
    }
    slurm.requeue(shards, requeued);
    at(&format!("cancelled {cancelled}, killed {killed}, requeued {requeued}"));

    // the cancelled shard again, while the others still run: a new merge takes the place of the first
    let (again, second) = submit(&slurm, &work, &["--array", &cancelled.to_string()]);
    assert_eq!(slurm.wait(first, LIMIT)[0].state, "CANCELLED");

    let tasks = slurm.wait(shards, LIMIT);
    at("shards are over");
    let log = || {
        let mut text = slurm.log();
        for entry in fs::read_dir(work.join("logs")).unwrap().flatten() {
            let said = fs::read_to_string(entry.path()).unwrap();
            text += &format!("== {:?}\n{said}", entry.file_name());
        }
        text
    };
    assert_eq!(tasks.len() as u32, SHARDS);
    for task in &tasks {
        println!("{task}");
        let index = task.index.unwrap();
        let expected = match index {
            i if i == cancelled => "CANCELLED",
            i if i == killed => "FAILED",
            _ => "COMPLETED",
        };
        assert_eq!(task.state, expected, "{task}\n{}", log());
        assert_eq!(task.restarts, u32::from(index == requeued), "{task}\n{}", log());
    }
    assert!(slurm.wait(again, LIMIT).iter().all(Task::completed), "{}", log());

    // the killed shard is missing: the merge says so, and leaves the rest alone
    let merged = slurm.wait(second, LIMIT);
    at(&format!("second merge: {}", merged[0]));
    assert_eq!(merged[0].exit(), Some(3), "{}", log());
    let said = fs::read_to_string(work.join(format!("logs/merge-{second}.log"))).unwrap();
    assert!(
        said.trim_end()
            .ends_with(&format!("run sim-worker with --shard {killed}/{SHARDS}")),
        "{said}"
    );
    let dataset = work.join("dataset");
    assert!(!dataset.join("features").exists() && !dataset.join("manifest.json").exists());

    let (again, third) = submit(&slurm, &work, &["--array", &killed.to_string()]);
    assert!(slurm.wait(again, LIMIT).iter().all(Task::completed), "{}", log());
    let merged = slurm.wait(third, LIMIT);
    at(&format!("third merge: {}", merged[0]));
    assert_eq!(merged[0].exit(), Some(0), "{}", log());

    same(&ema_tests::fleet::files(&dataset), &whole);
    drop(slurm);
    at("done");
}
