//! A hash of the sources that the runs of a fleet depend on.
use std::path::Path;

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
    let mut hash = 0xcbf2_9ce4_8422_2325;
    for part in ["../schemas/src", "src", "../Cargo.lock"] {
        fold(Path::new(part), &mut hash);
    }
    println!("cargo:rustc-env=EMA_WORKER_SOURCE={hash:016x}");
}
