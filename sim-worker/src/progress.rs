//! Progress, and Ctrl-C. Where standard error is a terminal, progress is a bar; elsewhere (a log, a service, a job of a
//! cluster) it is a plain line now and then.

use crate::quiet::{self, is_quiet};
use indicatif::{ProgressBar, ProgressStyle};
use schemas::foreign;
use std::io::IsTerminal;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, LazyLock, Mutex};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// Between two lines, and before the first one: what is done sooner needs none.
const EVERY: Duration = Duration::from_secs(10);

/// Between two looks at what has been done.
const LOOK: Duration = Duration::from_millis(50);

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
static SHOWN: Mutex<Option<Shown>> = Mutex::new(None);
static TERMINAL_IS_TAKEN: AtomicBool = AtomicBool::new(false);

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

/// No progress and no notes of work from now on: the terminal is used otherwise.
pub fn leave_terminal() {
    TERMINAL_IS_TAKEN.store(true, Ordering::Relaxed);
}

/// Whether nothing is to be said of work.
fn is_silent() -> bool {
    is_quiet() || TERMINAL_IS_TAKEN.load(Ordering::Relaxed)
}

/// A line on standard error about work, unless quiet, or where the terminal is used otherwise.
pub fn note(text: &str) {
    if !is_silent() {
        quiet::note(text);
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

/// A time in words: two figures are enough.
fn time(seconds: f64) -> String {
    match seconds.round() as u64 {
        s @ 0..120 => format!("{s} s"),
        s @ 120..7200 => format!("{} min", (s + 30) / 60),
        s => format!("{} h", (s + 1800) / 3600),
    }
}

/// Lines for a reader who sees no bar.
struct Lines {
    title: String,
    total: u64,
    said: Instant,
    /// the first runs, and when: often those of an earlier start, which tell nothing of the speed
    first: Option<(u64, Instant)>,
}

impl Lines {
    fn new(title: &str, total: u64, start: Instant) -> Lines {
        let (title, said) = (title.to_string(), start);
        Lines {
            title,
            total,
            said,
            first: None,
        }
    }

    /// The line that is due, if one is. To be asked often.
    fn line(&mut self, runs: u64, now: Instant) -> Option<String> {
        if runs > 0 {
            self.first.get_or_insert((runs, now));
        }
        if now.duration_since(self.said) < EVERY {
            return None;
        }
        self.said = now;
        let mut line = format!("{}: {runs} of {} runs", self.title, self.total);
        if let Some((before, since)) = self.first.filter(|f| runs > f.0) {
            let runs_per_s = (runs - before) as f64 / now.duration_since(since).as_secs_f64();
            let left = self.total.saturating_sub(runs) as f64 / runs_per_s;
            line += &format!(", {} left", time(left));
        }
        Some(line)
    }
}

/// Runs `work` with a display of `total` runs on standard error, and passes Ctrl-C on to it: a bar with rate and time
/// left on a terminal, else a line every ten seconds.
pub fn with_bar<T>(title: &str, total: u64, progress: &Arc<Progress>, work: impl FnOnce() -> T) -> T {
    // hidden where standard error is no terminal
    let bar = if is_silent() {
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
    let has_lines = !is_silent() && !std::io::stderr().is_terminal();
    let mut lines = has_lines.then(|| Lines::new(title, total, Instant::now()));
    let watcher = {
        let (bar, progress) = (bar.clone(), progress.clone());
        let title = title.to_string();
        Watcher::start(LOOK, move || {
            let runs = progress.runs.load(Ordering::Relaxed);
            bar.set_position(runs);
            let title = title.clone();
            show(Some(Shown { title, runs, total }));
            if let Some(lines) = &mut lines {
                lines.line(runs, Instant::now()).iter().for_each(|l| eprintln!("{l}"));
            }
            if interrupted() {
                progress.stop.store(true, Ordering::Relaxed);
            }
        })
    };
    let result = work();
    watcher.end();
    show(None);
    bar.finish_and_clear();
    result
}

/// A thread that looks at something now and then.
struct Watcher {
    over: Arc<AtomicBool>,
    thread: JoinHandle<()>,
}

impl Watcher {
    fn start(every: Duration, mut look: impl FnMut() + Send + 'static) -> Watcher {
        let over = Arc::new(AtomicBool::new(false));
        let is_over = over.clone();
        let thread = std::thread::spawn(move || {
            while !is_over.load(Ordering::Relaxed) {
                look();
                std::thread::park_timeout(every);
            }
        });
        Watcher { over, thread }
    }

    fn end(self) {
        self.over.store(true, Ordering::Relaxed);
        self.thread.thread().unpark();
        let _ = self.thread.join();
    }
}

/// Says what is being done and for how long, where nobody knows how much there is to do: one changing line on a
/// terminal, else a line every ten seconds.
pub struct Spinner {
    bar: ProgressBar,
    message: Arc<Mutex<String>>,
    watcher: Option<Watcher>,
}

impl Spinner {
    /// What is being done now.
    pub fn set_message(&self, text: &str) {
        self.bar.set_message(text.to_string());
        if let Ok(mut m) = self.message.lock() {
            *m = text.into();
        }
    }
}

impl Drop for Spinner {
    /// An error on the way ends it too, before it is told.
    fn drop(&mut self) {
        if let Some(watcher) = self.watcher.take() {
            watcher.end();
        }
        self.bar.finish_and_clear();
    }
}

/// A display of work without a number, until it is dropped.
///
/// * `title` of the lines
pub fn spinner(title: &str) -> Spinner {
    let message = Arc::new(Mutex::new(String::new()));
    let mut spinner = Spinner {
        bar: ProgressBar::hidden(),
        message: message.clone(),
        watcher: None,
    };
    if is_silent() {
        return spinner;
    }
    if std::io::stderr().is_terminal() {
        let bar = ProgressBar::new_spinner();
        bar.set_style(ProgressStyle::with_template("{spinner} {msg} ({elapsed})").expect("a valid template"));
        bar.enable_steady_tick(Duration::from_millis(100));
        spinner.bar = bar;
        return spinner;
    }
    let (title, start) = (title.to_string(), Instant::now());
    let mut said = start;
    spinner.watcher = Some(Watcher::start(LOOK, move || {
        if said.elapsed() < EVERY {
            return;
        }
        said = Instant::now();
        let now = message.lock().map_or_else(|_| String::new(), |m| m.clone());
        eprintln!(
            "{title}: {} ({} so far)",
            foreign::line(&now),
            time(start.elapsed().as_secs_f64())
        );
    }));
    spinner
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_come_every_ten_seconds_and_say_what_is_left() {
        let start = Instant::now();
        let mut lines = Lines::new("maps", 600, start);
        let mut at = |seconds: u64, runs| lines.line(runs, start + Duration::from_secs(seconds));
        // of an earlier start
        assert_eq!(at(0, 100), None);
        assert_eq!(at(9, 150), None);
        assert_eq!(at(10, 100).unwrap(), "maps: 100 of 600 runs");
        assert_eq!(at(19, 200), None);
        // 100 runs in 20 s
        assert_eq!(at(20, 200).unwrap(), "maps: 200 of 600 runs, 80 s left");
        assert_eq!(at(30, 110).unwrap(), "maps: 110 of 600 runs, 25 min left");
        assert_eq!(at(40, 600).unwrap(), "maps: 600 of 600 runs, 0 s left");
    }

    #[test]
    fn times_have_a_unit_that_fits() {
        assert_eq!(
            [0.4, 119.0, 120.0, 7199.0, 7200.0, 86_400.0].map(time),
            ["0 s", "119 s", "2 min", "120 min", "2 h", "24 h"]
        );
    }
}
