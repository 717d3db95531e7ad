//! Long work: without the interpreter's lock, to be stopped by Ctrl-C, telling how far it is.

use crate::error::to_py;
use anyhow::Result;
use pyo3::exceptions::PyRuntimeError;
use pyo3::prelude::*;
use rayon::{ThreadPool, ThreadPoolBuilder};
use sim_worker::progress::{self, Progress};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, channel};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

/// Between two looks at signals and progress.
const LOOK: Duration = Duration::from_millis(50);

/// How long work that was asked to stop is waited for, before it is left alone.
const GRACE: Duration = Duration::from_secs(2);

/// How long new work waits for work that was left alone.
const PATIENCE: Duration = Duration::from_secs(10);

/// Works of this process that have not ended.
static RUNNING: AtomicUsize = AtomicUsize::new(0);

/// The threads of a process: a child that was forked has none of its parent's, and gets its own.
static POOL: Mutex<Option<(u32, &'static ThreadPool)>> = Mutex::new(None);

fn pool() -> Result<&'static ThreadPool> {
    let mut kept = POOL.lock().unwrap_or_else(|e| e.into_inner());
    let process = std::process::id();
    match *kept {
        Some((of, pool)) if of == process => Ok(pool),
        _ => {
            // never taken down: in a child, to end threads that are not there would be to wait for ever
            let pool: &'static ThreadPool = Box::leak(Box::new(ThreadPoolBuilder::new().build()?));
            *kept = Some((process, pool));
            Ok(pool)
        }
    }
}

/// What becomes of work.
type Ended<T> = std::thread::Result<Result<T>>;

/// Waits a little, without the interpreter's lock.
fn wait<T: Send>(
    py: Python<'_>,
    ended: Receiver<Ended<T>>,
    time: Duration,
) -> (Receiver<Ended<T>>, Result<Ended<T>, RecvTimeoutError>) {
    py.detach(move || {
        let got = ended.recv_timeout(time);
        (ended, got)
    })
}

/// Lets work that was left alone end, so that what stops it does not stop what comes now.
fn settle(py: Python<'_>) -> PyResult<()> {
    let stop = progress::interrupt_flag();
    let from = Instant::now();
    while stop.load(Ordering::SeqCst) && RUNNING.load(Ordering::SeqCst) > 0 && from.elapsed() < PATIENCE {
        py.detach(|| std::thread::sleep(LOOK));
        py.check_signals()?;
    }
    stop.store(false, Ordering::SeqCst);
    Ok(())
}

/// Tells a callback how far work is, where it is further than when it was told last.
struct Teller {
    callback: Option<Py<PyAny>>,
    total: Option<u64>,
    told: Option<(u64, u64)>,
}

impl Teller {
    fn tell(&mut self, py: Python<'_>, state: &Progress) -> PyResult<()> {
        let Some(callback) = &self.callback else {
            return Ok(());
        };
        // its own, or that of the bar which the program would show
        let now = match self.total {
            Some(total) => Some((state.runs.load(Ordering::Relaxed), total)),
            None => progress::shown().map(|s| (s.runs, s.total)),
        };
        if let Some(now) = now.filter(|n| self.told != Some(*n)) {
            self.told = Some(now);
            callback.call1(py, now)?;
        }
        Ok(())
    }
}

/// Does `work` on a thread of its own while this one looks after signals; Ctrl-C sets `stop` of what the work is given, and
/// the flag that the work of other crates looks at.
///
/// * `callback` is told runs done and runs of all
/// * `total` runs of all that the work counts; that of the bars of other crates if `None`
pub fn long<T: Send + 'static>(
    py: Python<'_>,
    callback: Option<Py<PyAny>>,
    total: Option<u64>,
    work: impl FnOnce(&Arc<Progress>) -> Result<T> + Send + 'static,
) -> PyResult<T> {
    settle(py)?;
    let state = Arc::new(Progress::default());
    let (done, mut ended) = channel::<Ended<T>>();
    let given = state.clone();
    RUNNING.fetch_add(1, Ordering::SeqCst);
    let started = std::thread::Builder::new().name("ema".into()).spawn(move || {
        let result = catch_unwind(AssertUnwindSafe(|| pool()?.install(|| work(&given))));
        RUNNING.fetch_sub(1, Ordering::SeqCst);
        // nobody waits for work that was left alone
        let _ = done.send(result);
    });
    if let Err(e) = started {
        RUNNING.fetch_sub(1, Ordering::SeqCst);
        return Err(PyRuntimeError::new_err(format!("no thread can be started: {e}")));
    }
    let mut teller = Teller {
        callback,
        total,
        told: None,
    };
    loop {
        let (back, got) = wait(py, ended, LOOK);
        ended = back;
        let looked = match got {
            Ok(result) => {
                let value = finished(py, result)?;
                teller.tell(py, &state)?;
                return Ok(value);
            }
            Err(RecvTimeoutError::Disconnected) => return Err(PyRuntimeError::new_err("the work vanished")),
            Err(RecvTimeoutError::Timeout) => py.check_signals().and_then(|()| teller.tell(py, &state)),
        };
        if let Err(e) = looked {
            state.stop.store(true, Ordering::SeqCst);
            progress::interrupt_flag().store(true, Ordering::SeqCst);
            let _ = wait(py, ended, GRACE);
            if RUNNING.load(Ordering::SeqCst) == 0 {
                progress::interrupt_flag().store(false, Ordering::SeqCst);
            }
            return Err(e);
        }
    }
}

/// The value of work that has ended, or the exception that stands for how it did.
fn finished<T>(py: Python<'_>, result: Ended<T>) -> PyResult<T> {
    match result {
        Ok(result) => result.map_err(|e| to_py(py, e)),
        Err(panic) => {
            let text = schemas::guard::words(&*panic);
            Err(PyRuntimeError::new_err(format!("a bug of ema: {text}")))
        }
    }
}
