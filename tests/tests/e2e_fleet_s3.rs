//! Fleet datasets in an S3 bucket: the same bytes as in a folder, whatever the store or the network does.

use ema_tests::fleet::{Ended, Files, Fleet, VARIED, files, same};
use ema_tests::s3::{BUCKET, S3Server, SECRET, environment};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use sim_worker::dataset::storage::Storage;
use sim_worker::dataset::verify::{discard, verify};
use std::sync::OnceLock;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

const PROGRAM: &str = env!("CARGO_BIN_EXE_sim-worker-under-test");

/// The dataset of [`VARIED`] in a folder.
fn varied() -> &'static Files {
    static MADE: OnceLock<Files> = OnceLock::new();
    MADE.get_or_init(|| Fleet::new(PROGRAM, VARIED).single())
}

fn bed() -> (S3Server, Fleet) {
    let server = S3Server::start();
    let mut fleet = Fleet::new(PROGRAM, VARIED);
    fleet.env = server.env();
    (server, fleet)
}

fn objects(server: &S3Server, prefix: &str) -> Files {
    files(&server.files().join(prefix))
}

/// Without a secret.
fn checked(ended: Ended) -> Ended {
    for text in [&ended.out, &ended.err] {
        for secret in [SECRET, "wrong-secret", "AWS4-HMAC", "Signature="] {
            assert!(!text.contains(secret), "{text}");
        }
    }
    ended
}

#[test]
fn e2e_a_bucket_gets_the_same_bytes_as_a_folder() {
    let (server, fleet) = bed();
    let url = server.url("runs/a");
    for i in ["2/3", "0/3", "1/3"] {
        let said = checked(fleet.run(&["--out", &url, "--shard", i])).done();
        assert!(said.contains(&url), "{said}");
    }
    checked(fleet.run(&["--out", &url, "--merge"])).done();
    same(&objects(&server, "runs/a"), varied());
    let storage = Storage::open_with(&url, server.env()).unwrap();
    let report = verify(&storage, |_, _| ()).unwrap();
    assert!(report.finished && report.findings.is_empty(), "{report:?}");
    // again, and late: nothing changes
    for args in [&["--out", &url, "--merge"][..], &["--out", &url, "--shard", "1/3"]] {
        checked(fleet.run(args)).done();
        same(&objects(&server, "runs/a"), varied());
    }
    // damage is found and made good
    let telemetry = report_path(varied());
    let path = server.files().join("runs/a").join(telemetry);
    let bytes = std::fs::read(&path).unwrap();
    std::fs::write(&path, &bytes[..bytes.len() / 2]).unwrap();
    let report = verify(&storage, |_, _| ()).unwrap();
    assert_eq!(report.findings.len(), 1, "{report:?}");
    assert_eq!(report.findings[0].path, telemetry);
    discard(&storage, &report).unwrap();
    assert_eq!(fleet.complete(&url), 1);
    same(&objects(&server, "runs/a"), varied());
}

fn report_path(whole: &Files) -> &str {
    whole.keys().find(|k| k.starts_with("telemetry/")).expect("telemetry")
}

#[test]
fn e2e_another_plan_is_refused_in_a_bucket_too() {
    let (server, fleet) = bed();
    let url = server.url("a");
    fleet.run(&["--out", &url, "--shard", "0/15"]).done();
    let before = objects(&server, "a");
    fleet.write("plan.toml", &VARIED.replace("seed = 7", "seed = 8"));
    let ended = checked(fleet.run(&["--out", &url]));
    let line = ended.line(4);
    assert!(line.contains("seed = 7") && line.contains("seed = 8"), "{line}");
    same(&objects(&server, "a"), &before);
}

#[test]
fn e2e_workers_killed_on_a_bucket_leave_no_trace() {
    let mut rng = ChaCha8Rng::seed_from_u64(21);
    let (server, fleet) = bed();
    let url = server.url("a");
    let (mut kills, mut open, mut patience_ms) = (0, vec!["0/3", "1/3", "2/3"], 20);
    while !open.is_empty() {
        let k = rng.random_range(0..open.len());
        let mut worker = fleet.start(&["--out", &url, "--shard", open[k]]);
        std::thread::sleep(Duration::from_millis(rng.random_range(0..patience_ms)));
        if worker.ended() {
            worker.wait().done();
            open.remove(k);
        } else {
            worker.signal("KILL");
            match worker.wait().code() {
                -9 => kills += 1,
                code => assert_eq!(code, 0),
            }
            patience_ms += 10;
        }
    }
    for _ in 0..10 {
        let merge = fleet.start(&["--out", &url, "--merge"]);
        std::thread::sleep(Duration::from_millis(rng.random_range(0..60)));
        merge.signal("KILL");
        merge.wait();
        kills += 1;
    }
    checked(fleet.run(&["--out", &url, "--merge"])).done();
    // what the server itself had begun to write for a client that died is not an object
    let storage = Storage::open_with(&url, server.env()).unwrap();
    let listed: Vec<String> = storage.list("").unwrap().into_iter().map(|(path, _)| path).collect();
    let mut found = objects(&server, "a");
    found.retain(|k, _| listed.contains(k));
    same(&found, varied());
    assert_eq!(listed.len(), varied().len(), "{listed:?}");
    println!("{kills} kills");
}

#[test]
fn e2e_a_store_that_is_busy_or_loses_answers_is_asked_again() {
    let (server, fleet) = bed();
    let stop = AtomicBool::new(false);
    std::thread::scope(|s| {
        s.spawn(|| {
            let mut rng = ChaCha8Rng::seed_from_u64(22);
            let faults = &server.faults;
            let mut next = 0;
            while !stop.load(Ordering::SeqCst) {
                let seen = faults.seen.load(Ordering::SeqCst);
                if seen >= next {
                    let kind = [&faults.busy, &faults.lost, &faults.conflict];
                    kind[rng.random_range(0..3)].store(1, Ordering::SeqCst);
                    next = seen + rng.random_range(3..10);
                }
                std::thread::sleep(Duration::from_millis(1));
            }
        });
        let ended = |url: &str| {
            let workers = ["0/2", "1/2", "1/2"].map(|i| fleet.start(&["--out", url, "--shard", i]));
            let mut all: Vec<Ended> = workers.into_iter().map(|w| checked(w.wait())).collect();
            all.push(checked(fleet.run(&["--out", url, "--merge"])));
            all
        };
        let all: Vec<Ended> = ["a", "b"].into_iter().flat_map(|p| ended(&server.url(p))).collect();
        stop.store(true, Ordering::SeqCst);
        all.into_iter().for_each(|e| drop(e.done()));
    });
    println!("{} requests", server.faults.seen.load(Ordering::SeqCst));
    for prefix in ["a", "b"] {
        same(&objects(&server, prefix), varied());
    }
}

#[test]
fn e2e_sigterm_ends_a_worker_whose_store_does_not_answer() {
    let (server, fleet) = bed();
    for args in [&["--out", "s3://fleet/a"][..], &["--out", "s3://fleet/a", "--merge"]] {
        server.faults.busy.store(usize::MAX, Ordering::SeqCst);
        let before = server.faults.seen.load(Ordering::SeqCst);
        let worker = fleet.start(args);
        ema_tests::fleet::until("a request", || server.faults.seen.load(Ordering::SeqCst) > before + 2);
        worker.signal("TERM");
        let ended = checked(worker.wait());
        assert_eq!(ended.code(), 130, "{ended:?}");
        server.faults.busy.store(0, Ordering::SeqCst);
    }
    fleet.run(&["--out", "s3://fleet/a"]).done();
    fleet.run(&["--out", "s3://fleet/a", "--merge"]).done();
    same(&objects(&server, "a"), varied());
}

#[test]
fn refuse_stores_in_one_line_without_secrets() {
    let server = S3Server::start();
    let closed = {
        let l = std::net::TcpListener::bind(("127.0.0.1", 0)).unwrap();
        format!("http://{}", l.local_addr().unwrap())
    };
    let with = |name: &str, value: &str| {
        let mut env = server.env();
        env.retain(|(n, _)| n != name);
        env.push((name.into(), value.into()));
        env
    };
    let good = format!("s3://{BUCKET}/a");
    for (url, env, code, named) in [
        (
            good.as_str(),
            with("AWS_SECRET_ACCESS_KEY", "wrong-secret"),
            4,
            "AWS_SECRET_ACCESS_KEY",
        ),
        (&good, with("AWS_ACCESS_KEY_ID", "nobody"), 4, "AWS_ACCESS_KEY_ID"),
        (&good, environment(&closed), 1, closed.as_str()),
        (
            &good,
            environment("http://no-such-host.invalid"),
            1,
            "no-such-host.invalid",
        ),
        (&good, with("AWS_ALLOW_HTTP", "false"), 4, "AWS_ALLOW_HTTP"),
        (&good, with("AWS_ENDPOINT_URL", "localhost:9000"), 4, "http://host:port"),
        ("s3://missing/a", server.env(), 4, "no bucket missing"),
    ] {
        let mut fleet = Fleet::new(PROGRAM, VARIED);
        fleet.env = env;
        for args in [&["--out", url, "--shard", "0/2"][..], &["--out", url, "--merge"]] {
            let ended = checked(fleet.run(args));
            let line = ended.line(code);
            println!("{line}");
            assert!(line.contains(named), "{line}");
        }
    }
    assert!(objects(&server, "a").is_empty());
}
