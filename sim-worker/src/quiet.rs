//! What is said on standard error beside errors: by all programs, in one way.

use std::sync::atomic::{AtomicBool, Ordering};

static QUIET: AtomicBool = AtomicBool::new(false);

/// `--quiet`: no progress and no notes from now on. Errors and results stay.
pub fn be_quiet() {
    QUIET.store(true, Ordering::Relaxed);
}

/// Whether [`be_quiet`] was asked for.
pub fn is_quiet() -> bool {
    QUIET.load(Ordering::Relaxed)
}

/// A line on standard error, unless quiet.
pub fn note(text: &str) {
    if !is_quiet() {
        eprintln!("{text}");
    }
}
