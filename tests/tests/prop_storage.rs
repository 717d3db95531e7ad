//! The storage layer on folders and against an S3 server.
use ema_tests::s3::{self, S3Server, environment};
use sim_worker::dataset::storage::{Put, Storage};
use std::collections::HashSet;
use std::path::Path;
use std::process::{Command, Stdio};
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

fn folder() -> (tempfile::TempDir, Storage) {
    let tmp = tempfile::tempdir().unwrap();
    let storage = Storage::open(tmp.path().join("data").to_str().unwrap()).unwrap();
    (tmp, storage)
}

fn server() -> (S3Server, Storage) {
    let server = S3Server::start();
    let storage = Storage::open_with(&server.url("runs/a"), server.env()).unwrap();
    (server, storage)
}

fn with(mut env: Vec<(String, String)>, name: &str, value: &str) -> Vec<(String, String)> {
    env.retain(|(n, _)| n != name);
    env.push((name.into(), value.into()));
    env
}

/// The line of an error; it must be one line and hold no secret.
fn line(error: schemas::error::Error) -> (String, u8) {
    let line = error.to_string();
    println!("[exit {}] {line}", error.exit_code());
    assert!(!line.contains('\n') && line.len() < 400, "{line}");
    for secret in [s3::SECRET, "wrong-secret", "AWS4-HMAC", "Signature="] {
        assert!(!line.contains(secret), "{line}");
    }
    (line, error.exit_code())
}

fn keeps_objects(storage: &Storage) {
    assert_eq!(storage.get("a/x").unwrap(), None);
    assert_eq!(storage.head("a/x").unwrap(), None);
    assert_eq!(storage.get_range("a/x", 0..1).unwrap(), None);
    assert_eq!(storage.list("").unwrap(), []);
    storage.delete("a/x").unwrap();
    assert_eq!(storage.put_new("a/x", "first").unwrap(), Put::Made);
    assert_eq!(storage.put_new("a/x", "second").unwrap(), Put::Existed);
    assert_eq!(storage.put_new("a/x", "first").unwrap(), Put::Existed);
    assert_eq!(storage.get("a/x").unwrap().unwrap(), "first");
    storage.replace("a/x", "third").unwrap();
    storage.replace("b=1/y.parquet", "yy").unwrap();
    storage.replace("ab", "").unwrap();
    assert_eq!(storage.get("a/x").unwrap().unwrap(), "third");
    assert_eq!(storage.get_range("a/x", 1..3).unwrap().unwrap(), "hi");
    assert_eq!(storage.get_range("a/x", 2..2).unwrap().unwrap(), "");
    assert_eq!(storage.head("b=1/y.parquet").unwrap(), Some(2));
    let all = [("a/x", 5), ("ab", 0), ("b=1/y.parquet", 2)].map(|(p, n)| (p.to_owned(), n));
    assert_eq!(storage.list("").unwrap(), all);
    assert_eq!(storage.list("a").unwrap(), all[..1]);
    assert_eq!(storage.list("none").unwrap(), []);
    storage.try_write().unwrap();
    for i in 0..5 {
        storage
            .put_new(&format!("_staging/{i}/p.parquet"), vec![i; 10])
            .unwrap();
    }
    assert_eq!(storage.list("_staging").unwrap().len(), 5);
    assert_eq!(storage.delete_prefix("_staging").unwrap(), 5);
    assert_eq!(storage.delete_prefix("_staging").unwrap(), 0);
    storage.delete("ab").unwrap();
    assert_eq!(storage.list("").unwrap(), [all[0].clone(), all[2].clone()]);
    for range in [3..6, 5..6, 100..200] {
        let (short, exit) = line(storage.get_range("a/x", range).unwrap_err());
        assert!(short.contains("ends before byte") && exit == 4);
    }
    for name in ["", "/a", "a/", "a//b", "../a", "a/../b", "./a", "a\\b"] {
        assert_eq!(line(storage.put_new(name, "").unwrap_err()).1, 4);
        assert!(storage.get(name).is_err(), "{name}");
    }
    assert!(storage.put_new("a#1", "").is_err());
    assert!(storage.delete_prefix("").is_err());
}

#[test]
fn prop_folder_keeps_objects() {
    let (tmp, storage) = folder();
    keeps_objects(&storage);
    let root = tmp.path().join("data");
    assert_eq!(storage.local_path(), Some(root.clone()));
    // nothing of the puts is left
    assert!(!root.join("_staging").exists());
    let file_url = format!("file://{}", root.display().to_string().replace('t', "%74"));
    assert_eq!(Storage::open(&file_url).unwrap().head("a/x").unwrap(), Some(5));
}

#[test]
fn prop_bucket_keeps_objects() {
    let (server, storage) = server();
    keeps_objects(&storage);
    assert_eq!(storage.describe(), format!("s3://fleet/runs/a at {}", server.endpoint));
    assert_eq!(storage.url("a/x"), "s3://fleet/runs/a/a/x");
    // another prefix sees nothing of it, no prefix sees it whole
    let open = |prefix: &str| Storage::open_with(&server.url(prefix), server.env()).unwrap();
    assert_eq!(open("runs/ab").list("").unwrap(), []);
    assert_eq!(open("").list("").unwrap()[0].0, "runs/a/a/x");
}

#[test]
fn prop_large_objects_round_trip() {
    let (_server, bucket) = server();
    let (_tmp, folder) = folder();
    let bytes: Vec<u8> = (0..40_000_000u32)
        .map(|i| (i.wrapping_mul(2_654_435_761) >> 24) as u8)
        .collect();
    for storage in [&bucket, &folder] {
        let start = Instant::now();
        assert_eq!(storage.put_new("big", bytes.clone()).unwrap(), Put::Made);
        let put = start.elapsed();
        assert!(storage.get("big").unwrap().unwrap() == bytes);
        println!("40 MB: put {put:?}, put and get {:?}", start.elapsed());
        let end = storage.get_range("big", 39_999_990..40_000_000).unwrap().unwrap();
        assert_eq!(end, bytes[39_999_990..]);
    }
}

/// Threads put the same names at the same time; every name is made by one of them and keeps its bytes.
fn makes_each_once(storage: &Storage, names: usize) {
    let made: Vec<Vec<usize>> = std::thread::scope(|s| {
        let threads: Vec<_> = (0..4u8)
            .map(|id| {
                s.spawn(move || {
                    let put = |i: &usize| storage.put_new(&format!("race/{i}.parquet"), vec![id; 1000]).unwrap();
                    (0..names).filter(|i| put(i) == Put::Made).collect()
                })
            })
            .collect();
        threads.into_iter().map(|t| t.join().unwrap()).collect()
    });
    assert_eq!(made.iter().map(Vec::len).sum::<usize>(), names);
    assert_eq!(made.iter().flatten().collect::<HashSet<_>>().len(), names);
    for (id, own) in made.iter().enumerate() {
        for i in own {
            let bytes = storage.get(&format!("race/{i}.parquet")).unwrap().unwrap();
            assert!(bytes == vec![id as u8; 1000]);
        }
    }
}

#[test]
fn prop_racing_puts_make_each_once() {
    makes_each_once(&folder().1, 200);
    let (_server, storage) = server();
    makes_each_once(&storage, 200);
}

#[test]
fn prop_calls_inside_another_runtime_work() {
    let (_server, storage) = server();
    let runtime = tokio::runtime::Builder::new_multi_thread().build().unwrap();
    let put = runtime.block_on(async { storage.put_new("x", "y") });
    assert_eq!(put.unwrap(), Put::Made);
}

#[test]
fn prop_busy_and_dropping_server_is_asked_again() {
    let (server, storage) = server();
    server.faults.busy.store(3, Ordering::SeqCst);
    assert_eq!(storage.put_new("busy", "1").unwrap(), Put::Made);
    assert_eq!(server.faults.busy.load(Ordering::SeqCst), 0);
    server.faults.busy.store(3, Ordering::SeqCst);
    Storage::open_with(&server.url(""), server.env()).unwrap();
    assert_eq!(server.faults.busy.load(Ordering::SeqCst), 0);
    // the answer is lost, the object is there: it is still ours
    server.faults.lost.store(2, Ordering::SeqCst);
    assert_eq!(storage.put_new("lost", "1").unwrap(), Put::Made);
    assert_eq!(server.faults.lost.load(Ordering::SeqCst), 0);
    // and another's is still another's
    server.faults.lost.store(2, Ordering::SeqCst);
    assert_eq!(storage.put_new("lost", "1").unwrap(), Put::Existed);
    // busy with the name is not the same as there
    server.faults.conflict.store(2, Ordering::SeqCst);
    assert_eq!(storage.put_new("conflict", "1").unwrap(), Put::Made);
    assert_eq!(storage.get("conflict").unwrap().unwrap(), "1");
}

#[test]
fn refuse_wrong_settings() {
    let server = S3Server::start();
    let open = |url: &str, env| line(Storage::open_with(url, env).unwrap_err());
    let data = server.url("runs");
    let (text, exit) = open(&data, with(server.env(), "AWS_SECRET_ACCESS_KEY", "wrong-secret"));
    assert!(text.contains("AWS_SECRET_ACCESS_KEY") && text.contains("SignatureDoesNotMatch") && exit == 4);
    let (text, exit) = open(&data, with(server.env(), "AWS_ACCESS_KEY_ID", "nobody"));
    assert!(text.contains("AWS_ACCESS_KEY_ID") && exit == 4);
    let (text, exit) = open("s3://missing/runs", server.env());
    assert!(text.contains("no bucket missing") && text.contains("404 NoSuchBucket") && exit == 4);
    let (text, exit) = open(&data, with(server.env(), "AWS_ALLOW_HTTP", "false"));
    assert!(text.contains("AWS_ALLOW_HTTP=true") && exit == 4);
    for endpoint in [
        "localhost:9000",
        "http://",
        "http://a b",
        "http://host:99999",
        "http://u:wrong-secret@h",
        "ftp://h",
    ] {
        assert_eq!(open(&data, with(server.env(), "AWS_ENDPOINT_URL", endpoint)).1, 4);
    }
    assert_eq!(open(&data, with(server.env(), "AWS_REGION", "no where")).1, 4);
    assert_eq!(
        open(&data, with(server.env(), "AWS_SECRET_ACCESS_KEY", "wrong-secret\n")).1,
        4
    );
    assert_eq!(open(&data, with(server.env(), "AWS_SECRET_ACCESS_KEY", "")).1, 4);
    for url in [
        "gs://b/p",
        "s3://",
        "s3://u:wrong-secret@b/p",
        "s3:/b",
        "s3://b/a b",
        "https://h/b",
        "file://host/a",
        "file:/a",
        "",
    ] {
        assert_eq!(open(url, server.env()).1, 4);
    }
}

#[test]
fn refuse_no_credentials() {
    let server = S3Server::start();
    let env = vec![
        ("AWS_ENDPOINT_URL".into(), server.endpoint.clone()),
        ("AWS_ALLOW_HTTP".into(), "true".into()),
        // where no machine answers for its role
        ("AWS_METADATA_ENDPOINT".into(), "http://127.0.0.1:9".into()),
    ];
    let (text, exit) = line(Storage::open_with(&server.url(""), env).unwrap_err());
    assert!(text.contains("AWS_ACCESS_KEY_ID") && exit == 4);
}

#[test]
fn refuse_unreachable_endpoint() {
    // nobody listens; somebody listens and never answers
    let listen = || std::net::TcpListener::bind(("127.0.0.1", 0)).unwrap();
    let url = |l: &std::net::TcpListener| format!("http://{}", l.local_addr().unwrap());
    let closed = url(&listen());
    let mute = listen();
    for endpoint in [closed, url(&mute), "http://no-such-host.invalid".into()] {
        let start = Instant::now();
        let (text, exit) = line(Storage::open_with("s3://fleet/a", environment(&endpoint)).unwrap_err());
        println!("after {:?}", start.elapsed());
        assert!(text.contains(&endpoint) && exit == 1);
        assert!(start.elapsed() < Duration::from_secs(120), "hangs");
    }
}

#[test]
fn refuse_a_bucket_that_went_away() {
    let (server, storage) = server();
    std::fs::remove_dir_all(server.files()).unwrap();
    let (text, exit) = line(storage.list("").unwrap_err());
    assert!(text.contains("NoSuchBucket") && exit == 4);
}

#[test]
fn refuse_files_in_the_way() {
    let tmp = tempfile::tempdir().unwrap();
    let file = tmp.path().join("file");
    std::fs::write(&file, "").unwrap();
    let (text, exit) = line(Storage::open(file.to_str().unwrap()).unwrap_err());
    assert!(text.contains("found a file") && exit == 4);
    let storage = Storage::open(tmp.path().to_str().unwrap()).unwrap();
    line(storage.put_new("file/x", "").unwrap_err());
    assert_eq!(storage.get("file/x").unwrap(), None);
    std::fs::create_dir(tmp.path().join("folder")).unwrap();
    line(storage.put_new("folder", "").unwrap_err());
    line(storage.replace("folder", "").unwrap_err());
    line(storage.get("folder").unwrap_err());
    assert_eq!(storage.head("folder").unwrap(), None);
    assert_eq!(storage.list("").unwrap(), [("file".to_owned(), 0)]);
}

/// Mounts a small file system; nothing where that is not allowed.
fn mounted(at: &Path, options: &str) -> bool {
    let mount = Command::new("mount")
        .args(["-t", "tmpfs", "-o", options, "tmpfs"])
        .arg(at)
        .status();
    let done = mount.is_ok_and(|s| s.success());
    if !done {
        println!("skipped: no file system can be mounted here");
    }
    done
}

struct Unmount<'a>(&'a Path);
impl Drop for Unmount<'_> {
    fn drop(&mut self) {
        let _ = Command::new("umount").arg("-l").arg(self.0).status();
    }
}

#[test]
fn refuse_full_disk_and_leave_nothing() {
    let tmp = tempfile::tempdir().unwrap();
    if !mounted(tmp.path(), "size=1m") {
        return;
    }
    let _unmount = Unmount(tmp.path());
    let storage = Storage::open(tmp.path().to_str().unwrap()).unwrap();
    storage.put_new("fits.parquet", vec![1; 300_000]).unwrap();
    let (text, exit) = line(storage.put_new("large.parquet", vec![1; 2_000_000]).unwrap_err());
    assert!(text.contains("No space left on device") && exit == 1);
    assert!(storage.replace("fits.parquet", vec![1; 2_000_000]).is_err());
    assert_eq!(storage.list("").unwrap(), [("fits.parquet".to_owned(), 300_000)]);
    assert!(!tmp.path().join("_staging").exists());
    storage.put_new("small.parquet", vec![1; 300_000]).unwrap();
}

#[test]
fn refuse_read_only_folder() {
    let tmp = tempfile::tempdir().unwrap();
    if !mounted(tmp.path(), "ro") {
        return;
    }
    let _unmount = Unmount(tmp.path());
    let storage = Storage::open(tmp.path().to_str().unwrap()).unwrap();
    let (text, exit) = line(storage.put_new("a", "").unwrap_err());
    assert!(text.contains("Read-only file system") && exit == 1);
    line(storage.try_write().unwrap_err());
}

const RACE: &str = "EMA_TEST_STORAGE_RACE";
const TARGET: &str = "EMA_TEST_STORAGE_TARGET";

/// Not a test of its own: what the child process does that the next test kills.
#[test]
fn prop_child_writes_until_killed() {
    let Ok(url) = std::env::var(TARGET) else {
        return;
    };
    let storage = Storage::open(&url).unwrap();
    for i in 0.. {
        let path = format!("features/{}-{i}.parquet", std::process::id());
        storage.put_new(&path, whole(300_000 + i)).unwrap();
        storage.replace("features/same.parquet", whole(200_000 + i)).unwrap();
    }
}

/// Bytes that end with their own number.
fn whole(size: usize) -> Vec<u8> {
    let mut bytes = vec![7; size];
    bytes.extend((size as u64).to_le_bytes());
    bytes
}

#[test]
fn prop_killed_writers_leave_whole_objects_only() {
    let (tmp, storage) = folder();
    let root = tmp.path().join("data");
    for round in 0..30u64 {
        let mut child = Command::new(std::env::current_exe().unwrap())
            .args(["--exact", "prop_child_writes_until_killed"])
            .env(TARGET, &root)
            .stdout(Stdio::null())
            .spawn()
            .unwrap();
        let start = Instant::now();
        let before = storage.list("").unwrap().len();
        while storage.list("").unwrap().len() < before + 2 && start.elapsed() < Duration::from_secs(20) {
            std::thread::sleep(Duration::from_millis(1));
        }
        std::thread::sleep(Duration::from_micros(round * 733 % 5000));
        child.kill().unwrap();
        child.wait().unwrap();
    }
    let found = storage.list("").unwrap();
    assert!(found.len() > 30, "{}", found.len());
    for (path, size) in &found {
        assert!(path.starts_with("features/") && path.ends_with(".parquet"), "{path}");
        let bytes = storage.get(path).unwrap().unwrap();
        assert!(bytes == whole(*size as usize - 8), "{path}");
    }
    // those are not listed; a young one may be in use; an old one is not
    let tmps = std::fs::read_dir(root.join("_staging/tmp")).map_or(0, Iterator::count);
    println!("{} objects whole, {tmps} temporaries left of 30 kills", found.len());
    assert_eq!(storage.sweep(Duration::from_secs(3600)).unwrap(), 0);
    assert_eq!(storage.sweep(Duration::ZERO).unwrap(), tmps);
    assert!(!root.join("_staging").exists());
}

/// Many processes instead of threads: the same names, each made by one of them.
#[test]
fn prop_racing_processes_make_each_once() {
    if let Ok(url) = std::env::var(RACE) {
        let storage = Storage::open(&url).unwrap();
        let made = (0..200).filter(|i| storage.put_new(&format!("r/{i}"), vec![1; 5000]).unwrap() == Put::Made);
        println!("made={}", made.count());
        return;
    }
    let (server, _) = server();
    let (tmp, _storage) = folder();
    let data = tmp.path().join("data").display().to_string();
    for url in [data, server.url("race")] {
        let children: Vec<_> = (0..2)
            .map(|_| {
                Command::new(std::env::current_exe().unwrap())
                    .args(["--exact", "prop_racing_processes_make_each_once", "--nocapture"])
                    .env(RACE, &url)
                    .envs(server.env())
                    .stdout(Stdio::piped())
                    .spawn()
                    .unwrap()
            })
            .collect();
        let counts = children.into_iter().map(|c| {
            let text = String::from_utf8(c.wait_with_output().unwrap().stdout).unwrap();
            let count = text.split("made=").nth(1).and_then(|t| t.lines().next());
            count.unwrap().parse::<usize>().unwrap()
        });
        let counts: Vec<_> = counts.collect();
        println!("{counts:?}");
        assert_eq!(counts.iter().sum::<usize>(), 200);
    }
}
