//! For the provenance of files: the source revision, and a hash of the sources that results depend on.
use std::path::Path;
use std::process::Command;

/// Folds the names and contents of all files below `path` into `hash` (FNV-1a), in order.
fn fold(path: &Path, hash: &mut u64) {
    println!("cargo:rerun-if-changed={}", path.display());
    let mut add = |bytes: &[u8]| {
        bytes
            .iter()
            .for_each(|b| *hash = (*hash ^ *b as u64).wrapping_mul(0x0100_0000_01b3))
    };
    if path.is_dir() {
        let mut entries: Vec<_> = std::fs::read_dir(path)
            .into_iter()
            .flatten()
            .flatten()
            .map(|e| e.path())
            .collect();
        entries.sort();
        entries.iter().for_each(|p| fold(p, hash));
    } else {
        add(path.file_name().map(|n| n.as_encoded_bytes()).unwrap_or_default());
        add(&std::fs::read(path).unwrap_or_default());
    }
}

fn main() {
    let git = |args: &[&str]| {
        let out = Command::new("git")
            .args(args)
            .output()
            .ok()
            .filter(|o| o.status.success())?;
        Some(String::from_utf8_lossy(&out.stdout).trim().to_string())
    };
    let commit = git(&["describe", "--always", "--dirty", "--abbrev=12"]).unwrap_or_else(|| "unversioned".into());
    println!("cargo:rustc-env=EMA_COMMIT={commit}");
    if let Some(head) = git(&["rev-parse", "--git-path", "logs/HEAD"]) {
        println!("cargo:rerun-if-changed={head}");
    }
    let mut hash = 0xcbf2_9ce4_8422_2325;
    for part in [
        "schemas/src",
        "sim-worker/src",
        "diagnoser/src",
        "pipeline/src/generate.rs",
        "pipeline/src/maps.rs",
    ] {
        fold(&Path::new("..").join(part), &mut hash);
    }
    println!("cargo:rustc-env=EMA_SOURCE={hash:016x}");
}
