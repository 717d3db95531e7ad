//! The live diagnoser as a process: frames from shared memory, diagnoses to a second service, to
//! a log and to a screen.

pub mod foresight;
pub mod maps;
mod observer;
pub mod words;

use crate::live::{Known, Live, Status};
use crate::log::Log;
use crate::record::{Recording, record};
use crate::report::{Logged, to_message, versioned};
use crate::view::View;
use foresight::Foresight;
use maps::{MapSource, MapThreads};
use observer::{Observer, State};
use schemas::error::{Error, Result};
use schemas::stream::diagnosis::DiagnosisPublisher;
use schemas::stream::subscriber::Subscriber;
use schemas::stream::{Domain, now_ns};
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::channel;
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};
use words::{Complain, Counts};

/// Between two looks at who is alive.
const TICK: Duration = Duration::from_millis(250);
/// Longest sleep without a frame, and while maps are being fetched.
const SLEEP: Duration = Duration::from_millis(100);
const SLEEP_FOR_MAPS: Duration = Duration::from_millis(2);
/// How long the last frames of streams are waited for when enough has been diagnosed.
const FAREWELL: Duration = Duration::from_secs(2);
/// Between two pictures of the screen.
const PICTURE: Duration = Duration::from_millis(100);

/// What becomes visible of the diagnoses.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Show {
    /// a table on the terminal, drawn anew
    Screen,
    /// a line a diagnosis
    Lines,
    /// a JSON object a diagnosis
    Json,
    /// nothing; they are published and logged all the same
    Nothing,
}

/// How to run.
pub struct Options {
    /// shared memory that streams are looked for in
    pub domain: Domain,
    /// what frames may name
    pub known: Known,
    /// file that final diagnoses are appended to, `.jsonl` or `.parquet`
    pub log: Option<PathBuf>,
    /// folder of recordings
    pub record: Option<PathBuf>,
    /// poll instead of sleeping: the processor core is busy all the time
    pub busy: bool,
    /// what people see
    pub show: Show,
    /// end after so many final diagnoses
    pub exit_after: Option<u64>,
    /// a stream without a frame for so long is over
    pub timeout: Duration,
    /// file that numbers for monitoring are written to, again and again
    pub metrics: Option<PathBuf>,
    /// what is foretold of actuators with a history
    pub foresight: Option<Foresight>,
}

struct Receiving {
    show: Show,
    complain: Complain,
    live: Live,
    counts: Counts,
    diagnoses: DiagnosisPublisher,
    log: Option<Log>,
    foresight: Option<Foresight>,
    last_stray: String,
    /// why nothing can be said on standard output any more
    unsaid: Option<std::io::Error>,
}

impl Receiving {
    /// For monitoring.
    fn state(&self) -> State {
        let (log_kept, log_dropped) = self.log.as_ref().map_or((0, 0), Log::backlog);
        State {
            counts: self.counts,
            open_streams: self.live.open_streams() as u64,
            lost_samples: self.live.lost_samples(),
            ready_maps: self.live.ready_maps() as u64,
            making: self.live.making() as u64,
            log_kept: log_kept as u64,
            log_dropped,
        }
    }

    /// How often something else was foretold.
    fn foretellings(&self) -> u64 {
        self.foresight.as_ref().map_or(0, Foresight::changes)
    }

    /// What is known of the actuators that have been tested, and foretold of them.
    fn statuses(&self) -> Vec<Status> {
        let mut all = self.live.statuses();
        if let Some(f) = &self.foresight {
            all.iter_mut().for_each(|s| s.foretold = f.of(&s.actuator));
        }
        all
    }

    /// Logs, then publishes and shows, what has been found.
    fn hand_out(&mut self) -> Result<()> {
        for report in self.live.reports() {
            let mut message = to_message(&report);
            let time = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
            let mut logged = Logged {
                report,
                time_ns: time.as_nanos() as i64,
                publish_ns: now_ns(),
            };
            // in the log before anybody hears of it: a kill loses nothing that was reported, and whoever goes on
            // from the log says nothing twice
            if let (Some(log), true) = (&self.log, logged.report.is_final) {
                log.append(logged.clone());
            }
            self.diagnoses.send(&mut message)?;
            logged.publish_ns = message.publish_ns;
            if logged.report.is_final {
                self.counts.concluded(&logged.report.diagnosis.outcome);
                if let Some(foresight) = &self.foresight {
                    foresight.hear(&logged);
                }
            }
            let said = match self.show {
                // of what is known so far only an area says anything to a person
                Show::Lines if logged.report.is_final || logged.report.diagnosis.outcome.area().is_some() => {
                    say(&logged.to_line())
                }
                Show::Json => say(&versioned(logged.to_json()).to_string()),
                _ => Ok(()),
            };
            if let Err(e) = said {
                self.show = Show::Nothing;
                self.unsaid = Some(e);
            }
        }
        let (strays, last) = self.live.strays();
        if strays > self.counts.strays {
            self.counts.strays = strays;
            if last != self.last_stray {
                self.last_stray = last.into();
                (self.complain)(&format!("frame refused: {}", self.last_stray));
            }
        }
        Ok(())
    }
}

fn say(text: &str) -> std::io::Result<()> {
    use std::io::Write;
    let mut out = std::io::stdout().lock();
    writeln!(out, "{text}")?;
    out.flush()
}

/// Diagnoses what comes until `stop`, or until enough has come.
///
/// # Errors
/// Refuses shared memory, log, folder or terminal that cannot be used; fails where standard output cannot be
/// written (a closed pipe is no failure).
pub fn receive(options: Options, maps: MapSource, stop: &Arc<AtomicBool>) -> Result<Counts> {
    let view = (options.show == Show::Screen)
        .then(|| View::open(stop.clone()))
        .transpose()?;
    let complain: Complain = match &view {
        Some(view) => view.complain(),
        None => Arc::new(|text: &str| eprintln!("{text}")),
    };
    let over = Arc::new(AtomicBool::new(false));
    let (go, when_to_go) = channel();
    let recorder = options.record.as_ref().map(|dir| -> Result<_> {
        let names = options.known.sequences.iter();
        let names = names.map(|s| (s.fingerprint(), s.name.clone())).collect();
        let recording = Recording::new(dir, names, options.timeout)?;
        let (domain, over, complain) = (options.domain.clone(), over.clone(), complain.clone());
        let (ready, is_ready) = channel();
        let thread = std::thread::spawn(move || {
            let result = record(&domain, recording, &over, &ready, &when_to_go);
            if let Err(e) = &result {
                complain(&format!("recording has ended: {e}"));
            }
            result
        });
        // an error instead of a word ends the wait too
        let _ = is_ready.recv();
        Ok(thread)
    });
    let recorder = recorder.transpose()?;
    let subscriber = Subscriber::open(&options.domain)?;
    let _ = go.send(());
    let mut r = Receiving {
        show: options.show,
        complain: complain.clone(),
        counts: Counts::default(),
        diagnoses: DiagnosisPublisher::open(&options.domain, subscriber.node())?,
        log: options.log.as_deref().map(|p| Log::open(p, complain)).transpose()?,
        foresight: options.foresight,
        last_stray: String::new(),
        unsaid: None,
        live: Live::new(options.known.clone()),
    };
    if matches!(options.show, Show::Lines | Show::Json) {
        sim_worker::quiet::note(&format!("waiting for telemetry (domain `{}`)", options.domain.prefix()));
    }
    if let Some(log) = &r.log {
        r.live.already_concluded(log.concluded());
    }
    let mut maps = MapThreads::start(maps);
    let timeout_ns = options.timeout.as_nanos() as u64;
    let mut ticked = Instant::now();
    let mut drawn = Instant::now();
    // nothing moves without a frame or a diagnosis
    let mut shown = None;
    let mut observer = Observer::new(options.metrics.clone(), r.complain.clone());
    observer.ready();
    // enough diagnoses, and the publishers have been told that all has arrived
    let mut enough_since: Option<Instant> = None;
    let mut enough = |r: &Receiving| {
        let is_enough = options.exit_after.is_some_and(|n| r.counts.diagnoses >= n);
        let since = is_enough.then(|| *enough_since.get_or_insert_with(Instant::now));
        since.is_some_and(|t| !r.live.is_streaming() || t.elapsed() > FAREWELL)
    };
    let mut complaint = String::new();
    let mut result = Ok(());
    let alive = |p: u64| subscriber.publishers().contains(&p);
    // who reads only the first lines (a closed pipe) wants no more
    let closed = |r: &Receiving| {
        r.unsaid
            .as_ref()
            .is_some_and(|e| e.kind() == std::io::ErrorKind::BrokenPipe)
    };
    while !stop.load(Ordering::Relaxed) && !enough(&r) && !closed(&r) && result.is_ok() {
        result = (|| {
            loop {
                let frame = match subscriber.receive() {
                    Ok(Some(frame)) => frame,
                    Ok(None) => break,
                    Err(e) => {
                        // a publisher that died while it connected, for example
                        r.counts.failures = r.counts.failures.saturating_add(1);
                        if e.to_string() != complaint {
                            complaint = e.to_string();
                            (r.complain)(&complaint);
                        }
                        subscriber.publishers();
                        break;
                    }
                };
                r.counts.frames = r.counts.frames.saturating_add(1);
                let h = frame.header();
                let answer = r.live.frame(h, frame.payload(), frame.publisher(), &alive, now_ns());
                r.hand_out()?;
                if let Some(n) = answer {
                    subscriber.answer(h, n)?;
                }
                maps.ask(&mut r.live);
            }
            while maps.tell(&mut r.live) {
                maps.ask(&mut r.live);
                r.hand_out()?;
            }
            if r.live.work() {
                r.hand_out()?;
                // frames that have come meanwhile go first
                return Ok(());
            }
            if ticked.elapsed() > TICK {
                ticked = Instant::now();
                r.diagnoses.welcome();
                observer.tick(&r.state());
                if r.live.is_waiting(now_ns(), TICK.as_nanos() as u64) {
                    let alive = subscriber.publishers();
                    r.live.tick(now_ns(), timeout_ns, &|p| alive.contains(&p));
                    r.hand_out()?;
                }
            }
            if let Some(view) = &view
                && drawn.elapsed() > PICTURE
                && shown != Some((r.counts, r.foretellings()))
            {
                drawn = Instant::now();
                shown = Some((r.counts, r.foretellings()));
                view.show(r.statuses(), r.counts);
            }
            if !options.busy {
                subscriber.wait(if maps.looking > 0 { SLEEP_FOR_MAPS } else { SLEEP })?;
            }
            Ok(())
        })();
    }
    r.live.stop();
    result = result.and_then(|()| r.hand_out());
    if let Some(view) = view {
        view.show(r.statuses(), r.counts);
        view.close();
    }
    over.store(true, Ordering::Relaxed);
    let recorded = recorder.map_or(Ok(0), |t| t.join().expect("the recorder does not panic"));
    let logged = r.log.take().map_or(Ok(()), Log::close);
    result?;
    recorded?;
    logged?;
    match r.unsaid {
        Some(e) if e.kind() != std::io::ErrorKind::BrokenPipe => Err(Error::io(
            std::path::Path::new("standard output"),
            "cannot be written",
            e,
        )),
        _ => Ok(r.counts),
    }
}
