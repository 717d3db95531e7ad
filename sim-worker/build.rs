//! A hash of the sources that the runs of a fleet depend on.
use std::path::Path;

include!("source_hash.rs");

fn main() {
    let mut hash = 0xcbf2_9ce4_8422_2325;
    for part in ["../schemas/src", "src", "../Cargo.lock"] {
        fold(Path::new(part), &mut hash);
    }
    println!("cargo:rustc-env=EMA_WORKER_SOURCE={hash:016x}");
}
