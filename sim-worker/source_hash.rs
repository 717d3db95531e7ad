// Shared by the build scripts of this crate and of `pipeline`.

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
