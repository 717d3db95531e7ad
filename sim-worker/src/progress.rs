//! Progress bars and Ctrl-C.

use indicatif::{ProgressBar, ProgressStyle};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, LazyLock, Mutex};
use std::time::Duration;

/// What has been done so far, for a progress display in another thread.
#[derive(Debug, Default)]
pub struct Progress {
    /// runs done, earlier starts included
    pub runs: AtomicU64,
    /// steps made by this start
    pub steps: AtomicU64,
    /// set it to stop
    pub stop: AtomicBool,
}

static INTERRUPTED: LazyLock<Arc<AtomicBool>> = LazyLock::new(Arc::default);
static QUIET: AtomicBool = AtomicBool::new(false);
static SHOWN: Mutex<Option<Shown>> = Mutex::new(None);

/// What the bar of the work in progress shows, for hosts that have a display of their own.
#[derive(Clone, Debug, PartialEq)]
pub struct Shown {
    /// what is being done
    pub title: String,
    /// runs done
    pub runs: u64,
    /// runs of all
    pub total: u64,
}

/// What the latest bar shows; none where no work has one.
pub fn shown() -> Option<Shown> {
    SHOWN.lock().map_or(None, |s| s.clone())
}

fn show(what: Option<Shown>) {
    if let Ok(mut s) = SHOWN.lock() {
        *s = what;
    }
}

/// No bars and notes on standard error from now on: the terminal is used otherwise.
pub fn be_quiet() {
    QUIET.store(true, Ordering::Relaxed);
}

/// A line on standard error, unless quiet.
pub fn note(text: &str) {
    if !QUIET.load(Ordering::Relaxed) {
        eprintln!("{text}");
    }
}

/// Set when Ctrl-C was pressed.
pub fn interrupt_flag() -> Arc<AtomicBool> {
    INTERRUPTED.clone()
}

/// From now on Ctrl-C (and SIGTERM) asks long work to stop at the next chance; another one a second
/// later ends the process at once.
pub fn catch_interrupts() {
    crate::interrupt::catch(INTERRUPTED.clone());
}

/// Whether Ctrl-C was pressed.
pub fn interrupted() -> bool {
    INTERRUPTED.load(Ordering::SeqCst)
}

/// Runs `work` with a bar of `total` runs on standard error (none where that is no terminal),
/// showing rate and time left, and passes Ctrl-C on to it.
pub fn with_bar<T>(title: &str, total: u64, progress: &Arc<Progress>, work: impl FnOnce() -> T) -> T {
    let bar = if QUIET.load(Ordering::Relaxed) {
        ProgressBar::hidden()
    } else {
        ProgressBar::new(total)
    };
    let style = "{msg} [{bar:30}] {pos}/{len} runs, {per_sec}, {eta} left";
    bar.set_style(
        ProgressStyle::with_template(style)
            .expect("a valid template")
            .progress_chars("=> "),
    );
    bar.set_message(title.to_string());
    let done = Arc::new(AtomicBool::new(false));
    let watcher = {
        let (bar, done, progress) = (bar.clone(), done.clone(), progress.clone());
        let title = title.to_string();
        std::thread::spawn(move || {
            while !done.load(Ordering::Relaxed) {
                let runs = progress.runs.load(Ordering::Relaxed);
                bar.set_position(runs);
                let title = title.clone();
                show(Some(Shown { title, runs, total }));
                if interrupted() {
                    progress.stop.store(true, Ordering::Relaxed);
                }
                std::thread::park_timeout(Duration::from_millis(50));
            }
        })
    };
    let result = work();
    done.store(true, Ordering::Relaxed);
    watcher.thread().unpark();
    let _ = watcher.join();
    show(None);
    bar.finish_and_clear();
    result
}

/// A line on standard error that says what is being done and for how long (none where that is no terminal).
pub fn spinner() -> ProgressBar {
    if QUIET.load(Ordering::Relaxed) {
        return ProgressBar::hidden();
    }
    let bar = ProgressBar::new_spinner();
    bar.set_style(ProgressStyle::with_template("{spinner} {msg} ({elapsed})").expect("a valid template"));
    bar.enable_steady_tick(Duration::from_millis(100));
    bar
}
