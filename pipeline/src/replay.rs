//! Recordings played back into shared memory: lossless, at the test's own speed or faster; and what diagnosers
//! say of them.

mod verdict;

use crate::case::{Settings, sensors_of};
use crate::input::{self, Measured};
use anyhow::Result;
use schemas::channel::ChannelSet;
use schemas::error::Error;
use schemas::stream::frame::RunDescription;
use schemas::stream::publisher::{Delivery, Publisher};
use schemas::stream::wire::to_text;
use schemas::stream::{Domain, now_ns};
use std::path::{Path, PathBuf};
use std::sync::atomic::Ordering;
use std::time::Duration;
use verdict::Jury;
pub use verdict::{Await, Verdict};

/// How often a run is sent again that no subscriber has received whole.
const ATTEMPTS: u32 = 10;

/// Most rows of a frame that is replayed.
pub const MOST_ROWS: usize = 8192;

/// How to replay.
pub struct Replay {
    pub domain: Domain,
    /// actuator, sequence and sensors where a file does not say
    pub settings: Settings,
    /// name of the actuator in the frames, instead of the file's
    pub id: Option<String>,
    /// number of the first run in the frames, instead of the file's
    pub first_run: Option<u64>,
    /// times real time; `None` as fast as it is received
    pub speed: Option<f64>,
    pub frame_s: f64,
    /// how long to wait for a subscriber
    pub patience: Duration,
    /// whether to wait for the final diagnosis of a run that has been received
    pub diagnosis: Await,
    /// and how long
    pub diagnosis_patience: Duration,
}

/// What became of a run.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Delivered {
    pub actuator: String,
    pub run: u64,
    pub samples: u64,
    pub frames: u64,
    /// subscribers that have received all of it; 0: none
    pub whole: usize,
    pub attempts: u32,
    /// of a run that has been received
    pub verdict: Verdict,
}

impl Delivered {
    /// Received whole by a subscriber, or diagnosed all the same; and diagnosed where that was asked for.
    pub fn is_good(&self) -> bool {
        match self.verdict {
            Verdict::Diagnosed(_) => true,
            _ => self.whole > 0 && self.verdict.is_good(),
        }
    }
}

/// One run of a file, ready to be sent.
struct Take {
    measured: Measured,
    about: RunDescription,
}

impl Replay {
    fn take(&self, path: &Path, run: Option<u64>, number: Option<u64>) -> Result<Take> {
        let how = input::How {
            run,
            ..self.settings.how()
        };
        let measured = input::open(path, how)?;
        let actuator = self.settings.actuator_of(&measured);
        let sequence = match &measured.setup {
            Some(s) if self.settings.sequence.is_none() => s.sequence.clone(),
            _ => input::recognise(path, &measured, self.settings.sequence.as_deref(), actuator.step_s)?,
        };
        let sensors = sensors_of(path, &measured, &self.settings)?;
        let header = measured.telemetry.header.as_ref().expect("a measured run has rows");
        let own = (!header.actuator.is_empty()).then(|| header.actuator.clone());
        let about = RunDescription {
            actuator: self.id.clone().or(own).unwrap_or_else(|| actuator.name.clone()),
            parameters: if measured.parameters.is_empty() {
                actuator.fingerprint()
            } else {
                measured.parameters.clone()
            },
            sensors: sensors.map_or("none".into(), |s| s.fingerprint()),
            sequence: sequence.fingerprint(),
            run: number.unwrap_or(header.run),
            rate_hz: measured.rate_hz,
            channels: ChannelSet::of(header.channels.iter()),
            total_rows: (sequence.duration_s() * measured.rate_hz + 1e-6).floor() as u64,
            load_n_m: measured.load_n_m.unwrap_or(f64::NAN),
        };
        Ok(Take { measured, about })
    }

    /// Replays the files one after the other; `each` hears of every run. Returns whether all went well.
    ///
    /// # Errors
    /// Refuses a file that cannot be read or interpreted, and shared memory that refuses.
    pub fn files(
        &self,
        files: &[PathBuf],
        go_on: &(dyn Fn() -> bool + Sync),
        mut each: impl FnMut(&Delivered),
    ) -> Result<bool> {
        let mut all = true;
        let mut publisher: Option<(Publisher, usize, usize)> = None;
        let mut jury = Jury::open(&self.domain, self.diagnosis)?;
        let mut number = self.first_run;
        for path in files {
            for run in input::runs(path)? {
                let take = self.take(path, run, number)?;
                number = number.map(|n| n + 1);
                let rows = frame_rows(self.frame_s, take.about.rate_hz)?;
                let channels = take.about.channels.iter().count();
                let fits = |p: &(Publisher, usize, usize)| p.1 >= rows && p.2 >= channels;
                if !publisher.as_ref().is_some_and(fits) {
                    drop(publisher.take());
                    let p = Publisher::open(&self.domain, Delivery::Lossless, rows, channels)?;
                    publisher = Some((p, rows, channels));
                }
                let (p, _, _) = publisher.as_mut().expect("just opened");
                let delivered = self.deliver(p, &mut jury, &take, rows, go_on)?;
                each(&delivered);
                all &= delivered.is_good();
                if !go_on() {
                    return Err(crate::Interrupted.into());
                }
            }
        }
        Ok(all)
    }

    /// Sends a run until a subscriber has received all of it.
    fn deliver(
        &self,
        publisher: &mut Publisher,
        jury: &mut Option<Jury>,
        take: &Take,
        rows: usize,
        go_on: &(dyn Fn() -> bool + Sync),
    ) -> Result<Delivered> {
        let view = take.measured.telemetry.view();
        let mut delivered = Delivered {
            actuator: take.about.actuator.clone(),
            run: take.about.run,
            samples: view.rows as u64,
            frames: view.rows.div_ceil(rows) as u64,
            whole: 0,
            attempts: 0,
            verdict: Verdict::NotAwaited,
        };
        let stop = publisher.stop_flag();
        while delivered.attempts < ATTEMPTS && go_on() {
            delivered.attempts += 1;
            let Some(mut pass) = publisher.begin(&take.about, self.patience, go_on)? else {
                return Ok(delivered);
            };
            if let Some(jury) = jury {
                jury.begin(to_text(&take.about.actuator), pass.stream())?;
            }
            let start = now_ns();
            let mut heard = true;
            let mut from = 0;
            while from < view.rows && heard {
                if !go_on() {
                    stop.store(true, Ordering::Relaxed);
                    return Ok(delivered);
                }
                let to = (from + rows).min(view.rows);
                let block = view.slice(from, to);
                let mut frame = publisher.loan(&pass, block.first, block.rows)?;
                frame.view_mut().copy_from(&block);
                if let Some(speed) = self.speed {
                    let end_s = (block.first + block.rows as u64 - 1) as f64 / take.about.rate_hz;
                    sleep_until(start.saturating_add((end_s / speed * 1e9) as u64), go_on);
                }
                heard = publisher.publish(&mut pass, frame)?;
                if let Some(jury) = jury {
                    jury.listen(Duration::ZERO)?;
                }
                from = to;
            }
            if heard {
                let ending = publisher.end(&pass, self.patience, go_on)?;
                delivered.whole = ending.whole;
            }
            if let Some(jury) = jury
                && (delivered.whole > 0 || jury.is_diagnosed()?)
            {
                delivered.verdict = jury.verdict(self.diagnosis_patience, go_on)?;
                return Ok(delivered);
            }
            if delivered.whole > 0 {
                return Ok(delivered);
            }
        }
        Ok(delivered)
    }
}

/// Samples of a frame.
///
/// # Errors
/// Refuses a frame of more samples than one may have.
pub fn frame_rows(frame_s: f64, rate_hz: f64) -> Result<usize> {
    let rows = (frame_s * rate_hz).round().max(1.0);
    if rows <= MOST_ROWS as f64 {
        return Ok(rows as usize);
    }
    let (ms, most_ms) = (frame_s * 1e3, MOST_ROWS as f64 / rate_hz * 1e3);
    let allowed = format!("at most {most_ms} ms at {rate_hz} Hz ({MOST_ROWS} samples)");
    Err(Error::bad("command line", "--frame-ms", ms, allowed).into())
}

/// Sleeps until a time of CLOCK_MONOTONIC [ns], in short naps so that Ctrl-C is heard.
pub fn sleep_until(time_ns: u64, go_on: &(dyn Fn() -> bool + Sync)) {
    const NAP_NS: u64 = 50_000_000;
    while go_on() {
        let now = now_ns();
        if now >= time_ns {
            return;
        }
        std::thread::sleep(Duration::from_nanos((time_ns - now).min(NAP_NS)));
    }
}
