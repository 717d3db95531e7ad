//! Datasets that were damaged, disks that are full: what is wrong is found and named, and can be made good to
//! the same bytes.

use ema_tests::fleet::{Files, Fleet, VARIED, copy, files, same};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use sim_worker::dataset::merge::merge;
use sim_worker::dataset::plan::DatasetPlan;
use sim_worker::dataset::storage::Storage;
use sim_worker::dataset::verify::{Report, discard, verify};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::OnceLock;

const PROGRAM: &str = env!("CARGO_BIN_EXE_sim-worker-under-test");

/// [`VARIED`], finished as `single` and staged as `staged`.
fn made() -> &'static (Fleet, Files) {
    static MADE: OnceLock<(Fleet, Files)> = OnceLock::new();
    MADE.get_or_init(|| {
        let fleet = Fleet::new(PROGRAM, VARIED);
        let whole = fleet.single();
        fleet.run(&["--out", "staged"]).done();
        (fleet, whole)
    })
}

/// A dataset of its own for one damage.
struct Bed {
    out: String,
    root: PathBuf,
    storage: Storage,
}

impl Bed {
    /// * `from` `single` or `staged`
    fn new(from: &str, name: &str) -> Self {
        let fleet = &made().0;
        let root = fleet.path(name);
        copy(&fleet.path(from), &root);
        let storage = Storage::open(root.to_str().unwrap()).unwrap();
        Self {
            out: name.into(),
            root,
            storage,
        }
    }

    fn verify(&self) -> Report {
        verify(&self.storage, |_, _| ()).unwrap()
    }

    fn change(&self, name: &str, f: impl Fn(&mut Vec<u8>)) {
        let path = self.root.join(name);
        let mut bytes = fs::read(&path).unwrap();
        f(&mut bytes);
        fs::write(path, bytes).unwrap();
    }

    /// Discards what is damaged, makes what is missing as the merge says, and must end with the same bytes.
    fn heal(&self) -> usize {
        discard(&self.storage, &self.verify()).unwrap();
        let shards = made().0.complete(&self.out);
        same(&files(&self.root), &made().1);
        let again = self.verify();
        assert!(again.finished && again.findings.is_empty(), "{again:?}");
        shards
    }
}

/// The telemetry of part `number`, and its staged features.
fn names(number: usize) -> (String, String) {
    let plan = DatasetPlan::read(&made().0.path("plan.toml")).unwrap();
    let part = &plan.parts()[number];
    (
        plan.telemetry_path(part),
        format!("_staging/parts/part-{number:06}.parquet"),
    )
}

const FEATURES: &str = "features/part-0000.parquet";
const ACTUATORS: &str = "actuators/part-0000.parquet";
const MANIFEST: &str = "manifest.json";

type Damage = (&'static str, fn(&mut Vec<u8>));

const DAMAGES: [Damage; 6] = [
    ("cut", |b| b.truncate(b.len() / 2)),
    ("empty", Vec::clear),
    ("short", |b| b.truncate(b.len() - 1)),
    ("longer", |b| b.push(0)),
    ("head", |b| b[0] ^= 1),
    ("middle", |b| {
        let middle = b.len() / 2;
        b[middle] ^= 0x10;
    }),
];

#[test]
fn prop_an_untouched_dataset_has_no_findings() {
    let (_, whole) = made();
    for from in ["single", "staged"] {
        let bed = Bed::new(from, &format!("untouched-{from}"));
        let before = files(&bed.root);
        let report = bed.verify();
        assert_eq!(report.findings, []);
        assert_eq!(report.notes, [] as [String; 0]);
        assert_eq!(report.finished, from == "single");
        discard(&bed.storage, &report).unwrap();
        same(&files(&bed.root), &before);
    }
    assert!(whole.contains_key(MANIFEST));
}

#[test]
fn prop_damaged_files_of_a_finished_dataset_are_found_and_made_again() {
    let all: Vec<usize> = (0..15).collect();
    for (kind, damage) in DAMAGES {
        for (file, parts) in [
            (names(7).0, vec![7]),
            (FEATURES.to_string(), all.clone()),
            (ACTUATORS.to_string(), vec![]),
        ] {
            let bed = Bed::new("single", &format!("{kind}-{}", file.replace('/', "-")));
            bed.change(&file, damage);
            let report = bed.verify();
            assert_eq!(report.findings.len(), 1, "{kind} {file}: {report:?}");
            let found = &report.findings[0];
            assert!(found.path == file && found.damaged && found.parts == parts, "{found:?}");
            assert!(!found.what.contains('\n'), "{found:?}");
            assert_eq!(bed.heal(), parts.len());
        }
    }
}

#[test]
fn prop_missing_files_are_found_and_made_again() {
    let all: Vec<usize> = (0..15).collect();
    for (file, parts) in [
        (names(3).0, vec![3]),
        (FEATURES.to_string(), all),
        (ACTUATORS.to_string(), vec![]),
    ] {
        let bed = Bed::new("single", &format!("missing-{}", file.replace('/', "-")));
        fs::remove_file(bed.root.join(&file)).unwrap();
        let report = bed.verify();
        let found = report.findings.iter().find(|f| f.path == file).expect("found");
        assert!(found.parts == parts && !found.damaged, "{found:?}");
        assert_eq!(report.parts(), parts);
        assert_eq!(bed.heal(), parts.len());
    }
    // several at once
    let bed = Bed::new("single", "several");
    bed.change(&names(2).0, |b| b.truncate(100));
    fs::remove_file(bed.root.join(names(11).0)).unwrap();
    bed.change(ACTUATORS, |b| b[10] ^= 1);
    assert_eq!(bed.verify().parts(), [2, 11]);
    assert_eq!(bed.heal(), 2);
    // without its manifest a dataset is not finished, and nothing has to be made again
    let bed = Bed::new("single", "no-manifest");
    fs::remove_file(bed.root.join(MANIFEST)).unwrap();
    let report = bed.verify();
    assert!(!report.finished && report.findings.is_empty(), "{report:?}");
    assert_eq!(bed.heal(), 0);
}

#[test]
fn prop_a_damaged_manifest_is_found_and_made_again() {
    for (kind, damage) in DAMAGES {
        let bed = Bed::new("single", &format!("manifest-{kind}"));
        bed.change(MANIFEST, damage);
        let report = bed.verify();
        assert!(!report.findings.is_empty(), "{kind}: {report:?}");
        bed.heal();
    }
    let bed = Bed::new("single", "manifest-bits");
    let bytes = made().1[MANIFEST].clone();
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    for _ in 0..150 {
        let (at, bit) = (rng.random_range(0..bytes.len()), rng.random_range(0..8));
        let mut flipped = bytes.clone();
        flipped[at] ^= 1 << bit;
        fs::write(bed.root.join(MANIFEST), &flipped).unwrap();
        let text = String::from_utf8_lossy(&flipped);
        match verify(&bed.storage, |_, _| ()) {
            Ok(report) => assert!(!report.findings.is_empty(), "bit {bit} of byte {at}: {text}"),
            // as if it were of a program to come
            Err(e) => assert!(e.to_string().contains("schema_version"), "{e}"),
        }
    }
    fs::write(bed.root.join(MANIFEST), &bytes[..100]).unwrap();
    assert_eq!(bed.heal(), 0);
}

#[test]
fn prop_single_bits_of_a_finished_dataset_are_found() {
    let bed = Bed::new("single", "bits");
    let (_, whole) = made();
    let mut rng = ChaCha8Rng::seed_from_u64(6);
    let names: Vec<&String> = whole.keys().filter(|k| k.ends_with(".parquet")).collect();
    for _ in 0..60 {
        let name = names[rng.random_range(0..names.len())];
        let mut bytes = whole[name].clone();
        let at = rng.random_range(0..bytes.len());
        bytes[at] ^= 1 << rng.random_range(0..8);
        fs::write(bed.root.join(name), &bytes).unwrap();
        let report = bed.verify();
        assert!(
            report.findings.len() == 1 && report.findings[0].path == *name,
            "byte {at} of {name}: {report:?}"
        );
        fs::write(bed.root.join(name), &whole[name]).unwrap();
    }
    assert_eq!(bed.verify().findings, []);
}

#[test]
fn prop_without_the_manifest_flipped_bits_are_still_found() {
    let bed = Bed::new("single", "bits-no-manifest");
    let plan = DatasetPlan::read(&made().0.path("plan.toml")).unwrap();
    let mut rng = ChaCha8Rng::seed_from_u64(16);
    for file in [names(4).0, FEATURES.to_string(), ACTUATORS.to_string()] {
        let bytes = made().1[&file].clone();
        for _ in 0..12 {
            fs::remove_file(bed.root.join(MANIFEST)).ok();
            let (at, bit) = (rng.random_range(0..bytes.len()), rng.random_range(0..8));
            bed.change(&file, |b| b[at] ^= 1 << bit);
            let named = |r: &Report| r.findings.iter().any(|f| f.path == file && f.damaged);
            assert!(named(&bed.verify()), "bit {bit} of byte {at} of {file}");
            // what a merge makes of it does not pass for whole
            let merged = merge(&plan, &bed.storage, |_, _| ());
            assert!(
                merged.is_err() || named(&bed.verify()),
                "bit {bit} of byte {at} of {file}"
            );
            fs::write(bed.root.join(&file), &bytes).unwrap();
        }
    }
    fs::remove_file(bed.root.join(MANIFEST)).ok();
    bed.change(&names(4).0, |b| b[1000] ^= 4);
    assert_eq!(bed.heal(), 1);
}

#[test]
fn prop_a_merge_of_a_finished_dataset_makes_the_actuators_again_and_names_what_it_cannot() {
    let plan = DatasetPlan::read(&made().0.path("plan.toml")).unwrap();
    let bed = Bed::new("single", "merge-again");
    fs::remove_file(bed.root.join(ACTUATORS)).unwrap();
    let found = bed.verify();
    assert!(found.findings[0].what.contains("ema dataset merge"), "{found:?}");
    merge(&plan, &bed.storage, |_, _| ()).unwrap();
    same(&files(&bed.root), &made().1);
    fs::remove_file(bed.root.join(names(3).0)).unwrap();
    let e = merge(&plan, &bed.storage, |_, _| ()).unwrap_err().to_string();
    assert!(
        e.contains(&names(3).0) && e.contains("ema dataset verify --discard"),
        "{e}"
    );
}

#[test]
fn prop_damaged_staged_files_are_found_and_made_again() {
    for (kind, damage) in DAMAGES {
        for (part, staged) in [(4, true), (9, false)] {
            let (telemetry, features) = names(part);
            let file = if staged { features } else { telemetry };
            let bed = Bed::new("staged", &format!("staged-{kind}-{part}"));
            bed.change(&file, damage);
            let report = bed.verify();
            assert!(!report.finished);
            assert_eq!(report.parts(), [part], "{kind} {file}: {report:?}");
            assert!(
                report.findings[0].damaged && report.findings[0].path == file,
                "{report:?}"
            );
            assert_eq!(bed.heal(), 1, "{kind} {file}");
        }
    }
    for part in [0, 14] {
        let (telemetry, features) = names(part);
        for (file, gone) in [(telemetry, "telemetry"), (features, "features")] {
            let bed = Bed::new("staged", &format!("unstaged-{gone}-{part}"));
            fs::remove_file(bed.root.join(&file)).unwrap();
            assert_eq!(bed.verify().parts(), [part]);
            assert_eq!(bed.heal(), 1);
        }
    }
}

#[test]
fn prop_single_bits_of_staged_files_are_found_or_do_nothing() {
    let name_of_bed = "staged-bits";
    let mut bed = Bed::new("staged", name_of_bed);
    let plan = DatasetPlan::read(&made().0.path("plan.toml")).unwrap();
    let mut rng = ChaCha8Rng::seed_from_u64(7);
    let whole = files(&bed.root);
    let (telemetry, staged): (Vec<&String>, Vec<&String>) = whole
        .keys()
        .filter(|k| k.ends_with(".parquet"))
        .partition(|k| k.starts_with("telemetry/"));
    let mut found = 0;
    for k in 0..100 {
        let names = if k % 4 == 0 { &telemetry } else { &staged };
        let name = names[rng.random_range(0..names.len())];
        let mut bytes = whole[name].clone();
        let at = rng.random_range(0..bytes.len());
        bytes[at] ^= 1 << rng.random_range(0..8);
        fs::write(bed.root.join(name), &bytes).unwrap();
        let report = bed.verify();
        if !report.findings.is_empty() {
            assert!(
                report.findings.iter().all(|f| f.path == *name && f.parts.len() == 1),
                "byte {at} of {name}: {report:?}"
            );
            found += 1;
            fs::write(bed.root.join(name), &whole[name]).unwrap();
            continue;
        }
        // bits that nobody reads again
        assert!(name.starts_with("_staging/"), "byte {at} of {name}");
        merge(&plan, &bed.storage, |_, _| ()).unwrap();
        same(&files(&bed.root), &made().1);
        fs::remove_dir_all(&bed.root).unwrap();
        bed = Bed::new("staged", name_of_bed);
    }
    println!("{found} of 100 found");
    assert!(found >= 25);
}

#[test]
fn e2e_a_damaged_staged_part_stops_the_merge_and_is_named() {
    let bed = Bed::new("staged", "merge-stopped");
    let (_, staged) = names(5);
    bed.change(&staged, |b| b.truncate(b.len() / 2));
    let ended = made().0.run(&["--out", &bed.out, "--merge"]);
    let line = ended.line(4);
    assert!(line.contains(&staged), "{line}");
    assert!(!bed.root.join(MANIFEST).exists() && !bed.root.join(FEATURES).exists());
    assert_eq!(bed.heal(), 1);
    // another part under its name
    let bed = Bed::new("staged", "merge-swapped");
    fs::copy(bed.root.join(names(6).1), bed.root.join(&staged)).unwrap();
    assert!(
        made()
            .0
            .run(&["--out", &bed.out, "--merge"])
            .line(4)
            .contains("ema.part")
    );
    assert_eq!(bed.verify().parts(), [5]);
    assert_eq!(bed.heal(), 1);
    // telemetry of another size than that of the part: a worker says so too
    let bed = Bed::new("staged", "worker-stopped");
    let (telemetry, staged) = names(5);
    fs::remove_file(bed.root.join(staged)).unwrap();
    bed.change(&telemetry, |b| b.truncate(b.len() - 7));
    let ended = made().0.run(&["--out", &bed.out, "--shard", "5/15"]);
    let line = ended.line(4);
    assert!(line.contains(&telemetry) && line.contains("verify --discard"), "{line}");
    assert_eq!(bed.heal(), 1);
}

#[test]
fn prop_foreign_files_are_found_and_only_those_of_tables_removed() {
    for (file, removed) in [
        ("features/part-0001.parquet", true),
        ("features/notes.txt", true),
        ("telemetry/sequence=brief/actuator=T1.rudder/part-0009.parquet", true),
        ("telemetry/sequence=brief/actuator=T9.rudder/part-0000.parquet", true),
        ("notes.txt", false),
        ("actuators/more.txt", false),
    ] {
        let bed = Bed::new("single", &format!("foreign-{}", file.replace('/', "-")));
        let path = bed.root.join(file);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(&path, b"foreign").unwrap();
        let report = bed.verify();
        assert_eq!(report.findings.len(), 1, "{report:?}");
        assert!(report.findings[0].path == file && report.findings[0].parts.is_empty());
        discard(&bed.storage, &report).unwrap();
        assert_eq!(path.exists(), !removed, "{file}");
        let _ = fs::remove_file(&path);
        assert_eq!(bed.verify().findings, []);
    }
    // below _staging they are in nobody's way
    let bed = Bed::new("staged", "foreign-staged");
    fs::write(bed.root.join("_staging/parts/part-000099.parquet"), b"foreign").unwrap();
    fs::write(bed.root.join("_staging/parts/notes.txt"), b"foreign").unwrap();
    assert_eq!(bed.heal(), 0);
}

#[test]
fn prop_a_damaged_plan_is_found() {
    // the plan as it stands in the dataset, with another seed
    let bed = Bed::new("single", "plan-seed");
    bed.change("plan.toml", |b| {
        let text = String::from_utf8(b.clone()).unwrap();
        *b = text.replace("seed = 7", "seed = 8").into_bytes();
    });
    let report = bed.verify();
    assert!(!report.findings.is_empty(), "{report:?}");
    // none at all: there is nothing to check by
    let bed = Bed::new("single", "plan-none");
    fs::remove_file(bed.root.join("plan.toml")).unwrap();
    let e = verify(&bed.storage, |_, _| ()).unwrap_err();
    assert!(e.exit_code() == 4 && e.to_string().contains("plan.toml"), "{e}");
    // the same plan again is the way back
    assert_eq!(made().0.complete(&bed.out), 0);
    same(&files(&bed.root), &made().1);
}

#[test]
fn refuse_tables_of_another_plan() {
    // what an earlier plan has left, without its plan.toml
    let (fleet, _) = made();
    let bed = Bed::new("single", "strange");
    fs::remove_file(bed.root.join("plan.toml")).unwrap();
    fs::remove_file(bed.root.join(MANIFEST)).unwrap();
    fleet.write("other.toml", &VARIED.replace("seed = 7", "seed = 8"));
    for args in [&["--out", "strange"][..], &["--out", "strange", "--merge"]] {
        let ended = Fleet::started(fleet.command_of("other.toml", args)).wait();
        assert_ne!(ended.code(), 0, "{ended:?}");
    }
    assert!(!bed.root.join(MANIFEST).exists());
}

/// A small file system in memory; none where that is not allowed.
struct Mounted<'a>(&'a Path);

impl<'a> Mounted<'a> {
    fn new(at: &'a Path, options: &str) -> Option<Self> {
        fs::create_dir_all(at).unwrap();
        let mount = Command::new("mount")
            .args(["-t", "tmpfs", "-o", options, "tmpfs"])
            .arg(at)
            .stderr(std::process::Stdio::null())
            .status();
        let done = mount.is_ok_and(|s| s.success());
        if !done {
            println!("skipped: no file system can be mounted here");
        }
        done.then_some(Self(at))
    }

    fn grow(&self) {
        let size = ["-o", "remount,size=64m"];
        assert!(Command::new("mount").args(size).arg(self.0).status().unwrap().success());
    }
}

impl Drop for Mounted<'_> {
    fn drop(&mut self) {
        let _ = Command::new("umount").arg("-l").arg(self.0).status();
    }
}

#[test]
fn e2e_a_full_disk_loses_nothing() {
    let (fleet, whole) = made();
    let bytes: usize = whole.values().map(Vec::len).sum();
    for share in [0.02, 0.3, 0.6, 0.9, 1.02] {
        let name = format!("full-{share}");
        let root = fleet.path(&name);
        let size = format!("size={}k", ((bytes as f64 * share) as usize / 1024).max(4));
        let Some(disk) = Mounted::new(&root, &size) else { return };
        let worker = fleet.run(&["--out", &name]);
        // where all parts have found room, the merge does not
        let ended = match worker.code() {
            0 => fleet.run(&["--out", &name, "--merge"]),
            _ => worker,
        };
        let line = ended.line(1);
        assert!(line.contains("No space left on device"), "{share}: {line}");
        let left = files(&root);
        assert!(!left.contains_key(MANIFEST));
        for (k, v) in left.iter().filter(|(k, _)| !k.starts_with("_staging/")) {
            assert!(v == &whole[k], "{share}: {k}");
        }
        assert!(!left.keys().any(|k| k.starts_with("_staging/tmp")), "{:?}", left.keys());
        disk.grow();
        fleet.run(&["--out", &name]).done();
        fleet.run(&["--out", &name, "--merge"]).done();
        same(&files(&root), whole);
    }
}

#[test]
fn refuse_places_where_nothing_can_be_written() {
    let (fleet, _) = made();
    let root = fleet.path("read-only");
    if let Some(_disk) = Mounted::new(&root, "ro") {
        for args in [&["--out", "read-only"][..], &["--out", "read-only", "--merge"]] {
            let ended = fleet.run(args);
            assert!(ended.line(1).contains("Read-only file system"), "{ended:?}");
        }
    }
    fs::write(fleet.path("file"), "").unwrap();
    for out in ["file", "file/below"] {
        let ended = fleet.run(&["--out", out]);
        let code = ended.code();
        assert!(ended.line(code).contains(out) && code == 4, "{ended:?}");
    }
    fs::create_dir_all(fleet.path("photos/2025")).unwrap();
    fs::write(fleet.path("photos/2025/a.jpg"), "a").unwrap();
    for args in [&["--out", "photos"][..], &["--out", "photos", "--merge"]] {
        let ended = fleet.run(args);
        assert!(ended.line(4).contains("photos/2025/a.jpg") || ended.line(4).contains("2025/a.jpg"));
        assert_eq!(fleet.files("photos").len(), 1);
    }
    for out in ["", "s3://", "gs://b/p", "s3://b/a b"] {
        assert!(!fleet.run(&["--out", out]).line(4).is_empty(), "{out}");
    }
}
