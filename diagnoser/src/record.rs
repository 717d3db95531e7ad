//! Recording while diagnosing: a second subscriber of the same stream, in a thread of its own. The
//! values of a file are those of the frames, bit for bit.

use schemas::error::{Result, write_whole};
use schemas::recording::{Provenance, Recorder};
use schemas::stream::Domain;
use schemas::stream::frame::{BEGIN, END, FrameHeader};
use schemas::stream::subscriber::Subscriber;
use schemas::telemetry::{TelemetryHeader, TelemetrySink, TelemetryView};
use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, Sender};
use std::time::{Duration, Instant};

/// A stream that is being recorded.
struct Tape {
    header: TelemetryHeader,
    provenance: Provenance,
    name: String,
    recorder: Option<Recorder>,
    publisher: u64,
    /// files of this stream so far; a gap begins another one
    parts: u32,
    next_sample: u64,
    next_frame: u64,
    whole_frames: u64,
    last: Instant,
}

/// Records all streams of a domain into a folder, one file a stream
/// (`ACTUATOR-runRUN-STREAM.parquet`), a further part (`.part2`) after a gap.
pub struct Recording {
    dir: PathBuf,
    tapes: HashMap<u64, Tape>,
    /// names of the sequences by fingerprint
    sequences: Vec<(String, String)>,
    timeout: Duration,
    /// files that are complete
    pub files: u64,
}

impl Recording {
    /// Makes the folder and removes what a dead process left half-written in it.
    ///
    /// # Errors
    /// Refuses a folder that cannot be made or written.
    pub fn new(dir: &Path, sequences: Vec<(String, String)>, timeout: Duration) -> Result<Self> {
        let cannot = |e| schemas::error::Error::io(dir, "cannot be made", e);
        std::fs::create_dir_all(dir).map_err(cannot)?;
        for e in std::fs::read_dir(dir).map_err(cannot)?.flatten() {
            let name = e.file_name().to_string_lossy().into_owned();
            let process = name.rsplit_once(".tmp-").and_then(|(_, p)| p.parse::<u32>().ok());
            if name.starts_with('.') && process.is_some_and(|p| !Path::new(&format!("/proc/{p}")).exists()) {
                let _ = std::fs::remove_file(e.path());
            }
        }
        // say now, not after a test, that the folder cannot be written
        let probe = dir.join(".probe");
        write_whole(&probe, b"")?;
        let _ = std::fs::remove_file(probe);
        Ok(Self {
            dir: dir.into(),
            tapes: HashMap::new(),
            sequences,
            timeout,
            files: 0,
        })
    }

    fn open(&mut self, h: &FrameHeader, publisher: u64) {
        let run = h.description();
        let known = self.sequences.iter().find(|(f, _)| *f == run.sequence);
        let sequence = known.map(|(_, n)| n.clone()).unwrap_or_default();
        let safe = |c: char| if c.is_ascii_alphanumeric() || c == '-' { c } else { '_' };
        let actuator: String = run.actuator.chars().map(safe).collect();
        let provenance = Provenance {
            actuator: run.actuator.clone(),
            parameters: run.parameters.clone(),
            sequence: sequence.clone(),
            sequence_fingerprint: if sequence.is_empty() {
                String::new()
            } else {
                run.sequence.clone()
            },
            sensors: run.sensors.clone(),
            rate_hz: run.rate_hz,
            load_n_m: if run.load_n_m.is_nan() { 0.0 } else { run.load_n_m },
            model: if run.load_n_m.is_nan() { "measured" } else { "stream" }.into(),
            ..Provenance::default()
        };
        let tape = Tape {
            name: format!("{actuator}-run{}-{:016x}", run.run, h.stream),
            header: TelemetryHeader {
                run: run.run,
                actuator: run.actuator,
                parameters: run.parameters,
                sensors: run.sensors,
                sequence,
                rate_hz: run.rate_hz,
                channels: run.channels,
                fault: None,
                rest_angle_rad: None,
            },
            provenance,
            recorder: None,
            publisher,
            parts: 0,
            next_sample: 0,
            next_frame: 0,
            whole_frames: 0,
            last: Instant::now(),
        };
        self.tapes.insert(h.stream, tape);
    }

    /// Takes a frame; returns what it is to be answered with, where it wants an answer.
    ///
    /// # Errors
    /// Fails where the file cannot be written.
    pub fn frame(&mut self, h: &FrameHeader, payload: &[f64], publisher: u64) -> Result<Option<u64>> {
        let Ok(view) = h.view(payload) else {
            return Ok(None);
        };
        if !self.tapes.contains_key(&h.stream) {
            if h.kind == END {
                return Ok(None);
            }
            self.open(h, publisher);
        }
        let tape = self.tapes.get_mut(&h.stream).expect("just opened");
        tape.last = Instant::now();
        if h.kind == BEGIN {
            tape.next_frame = tape.next_frame.max(1);
            return Ok(Some(0));
        }
        if h.kind == END {
            let whole = tape.whole_frames;
            self.finish(h.stream)?;
            return Ok(Some(whole));
        }
        let odd = h.channels != tape.header.channels.0 || h.rate_hz != tape.header.rate_hz;
        if odd || h.frame < tape.next_frame || view.first < tape.next_sample {
            return Ok(None);
        }
        tape.whole_frames += u64::from(h.frame == tape.next_frame && tape.whole_frames + 1 == h.frame);
        tape.next_frame = h.frame + 1;
        let dir = self.dir.clone();
        self.files += u64::from(tape.write(&dir, &view)?);
        Ok(None)
    }

    fn finish(&mut self, stream: u64) -> Result<()> {
        if let Some(mut tape) = self.tapes.remove(&stream)
            && let Some(r) = tape.recorder.take()
        {
            r.finish()?;
            self.files += 1;
        }
        Ok(())
    }

    /// Ends the files of streams whose publisher is gone or silent.
    ///
    /// # Errors
    /// Fails where a file cannot be finished.
    pub fn tick(&mut self, alive: &[u64]) -> Result<()> {
        let over = |t: &Tape| !alive.contains(&t.publisher) || t.last.elapsed() > self.timeout;
        let streams: Vec<u64> = self.tapes.iter().filter(|(_, t)| over(t)).map(|(s, _)| *s).collect();
        streams.into_iter().try_for_each(|s| self.finish(s))
    }

    /// Ends all files.
    ///
    /// # Errors
    /// Fails where a file cannot be finished.
    pub fn close(&mut self) -> Result<()> {
        let streams: Vec<u64> = self.tapes.keys().copied().collect();
        streams.into_iter().try_for_each(|s| self.finish(s))
    }
}

impl Tape {
    /// Appends a block; after a gap to another file. Returns whether a file became complete.
    fn write(&mut self, dir: &Path, view: &TelemetryView<'_>) -> Result<bool> {
        let mut ended = false;
        if view.first != self.next_sample
            && let Some(r) = self.recorder.take()
        {
            r.finish()?;
            ended = true;
        }
        if self.recorder.is_none() {
            self.parts += 1;
            let part = if self.parts > 1 {
                format!(".part{}", self.parts)
            } else {
                String::new()
            };
            let path = dir.join(format!("{}{part}.parquet", self.name));
            self.recorder = Some(Recorder::create(&path, &self.provenance, self.header.channels, false)?);
        }
        let recorder = self.recorder.as_mut().expect("just made");
        recorder.accept(&self.header, view)?;
        self.next_sample = view.first + view.rows as u64;
        Ok(ended)
    }
}

/// Records until `stop`; returns how many files were written.
///
/// * `ready` is told when frames wait for the recorder; they are taken, and answered, when `go` is
///   told, so that a stream begins for recorder and diagnoser alike
///
/// # Errors
/// Fails where the shared memory cannot be read or a file cannot be written.
pub fn record(
    domain: &Domain,
    mut recording: Recording,
    stop: &AtomicBool,
    ready: &Sender<()>,
    go: &Receiver<()>,
) -> Result<u64> {
    let subscriber = Subscriber::open(domain)?;
    let _ = ready.send(());
    let _ = go.recv();
    let mut looked = Instant::now();
    loop {
        let stopping = stop.load(Ordering::Relaxed);
        while let Some(frame) = subscriber.receive()? {
            let h = frame.header();
            if let Some(n) = recording.frame(h, frame.payload(), frame.publisher())? {
                subscriber.answer(h, n)?;
            }
        }
        if stopping {
            recording.close()?;
            return Ok(recording.files);
        }
        if looked.elapsed() > Duration::from_millis(500) {
            looked = Instant::now();
            recording.tick(&subscriber.publishers())?;
        }
        subscriber.wait(Duration::from_millis(100))?;
    }
}
