//! For the provenance of files: the source revision, and a hash of the sources that results depend on.
use std::path::Path;
use std::process::Command;

include!("../sim-worker/source_hash.rs");

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
        "pipeline/src/dataset/maps.rs",
        "pipeline/src/maps.rs",
        "pipeline/src/unit.rs",
    ] {
        fold(&Path::new("..").join(part), &mut hash);
    }
    println!("cargo:rustc-env=EMA_SOURCE={hash:016x}");
}
