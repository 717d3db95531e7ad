//! Ctrl-C and SIGTERM.

use schemas::error::EXIT_INTERRUPTED;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// From now on Ctrl-C (and SIGTERM) sets `stop`; another one a second later ends the process at
/// once. (Some programs that stop others signal twice.)
pub fn catch(stop: Arc<AtomicBool>) {
    let mut first: Option<Instant> = None;
    let _ = ctrlc::set_handler(move || {
        stop.store(true, Ordering::SeqCst);
        if first.get_or_insert_with(Instant::now).elapsed() > Duration::from_secs(1) {
            std::process::exit(i32::from(EXIT_INTERRUPTED));
        }
    });
}
