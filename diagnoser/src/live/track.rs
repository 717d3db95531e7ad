//! One stream of the live diagnosis.

use super::{Report, Status};
use crate::diagnosis::{Diagnosis, Outcome};
use crate::map_library::MapKey;
use schemas::channel::ChannelSet;
use schemas::feature::Features;
use schemas::sequence::{Command, TestSequence};
use schemas::stream::frame::{FrameHeader, RunDescription};
use schemas::telemetry::TelemetryView;
use sim_worker::extractor::FeatureExtractor;

/// Faults of a stream that are named one by one; the others are counted.
const NAMED: usize = 4;

/// Gaps remembered one by one, to tell a late frame from a repeated one.
const REMEMBERED_GAPS: usize = 1024;

/// A range of samples or frames that did not come.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Gap {
    pub from: u64,
    pub to: u64,
}

/// One stream, frame by frame: what has come, what is lost, what is wrong.
pub(super) struct Track {
    pub run: RunDescription,
    pub header: FrameHeader,
    pub publisher: u64,
    pub sequence: Option<TestSequence>,
    pub channels: ChannelSet,
    pub extractor: Option<FeatureExtractor>,
    pub key: Option<MapKey>,
    pub next_frame: u64,
    pub next_sample: u64,
    pub received: u64,
    /// sample frames that came before the first gap in the frames' numbers
    pub whole_frames: u64,
    /// no frame number has been left out
    pub is_unbroken: bool,
    pub lost: Vec<Gap>,
    pub lost_samples: u64,
    pub faults: Vec<String>,
    pub fault_count: u64,
    pub counted: usize,
    pub last_ns: u64,
    pub telemetry_ns: u64,
    pub outcome: Option<Outcome>,
    pub features: Features,
    /// nothing more is to be expected of the samples: a final diagnosis is due
    pub due: bool,
    pub is_final: bool,
    pub ended: bool,
}

impl Track {
    /// A stream of which nothing has come yet.
    pub fn new(header: &FrameHeader, sequence: Option<TestSequence>, publisher: u64, now_ns: u64) -> Self {
        Self {
            header: *header,
            publisher,
            sequence,
            channels: ChannelSet::default(),
            extractor: None,
            key: None,
            next_frame: 0,
            next_sample: 1,
            received: 0,
            whole_frames: 0,
            is_unbroken: true,
            lost: Vec::with_capacity(16),
            lost_samples: 0,
            faults: Vec::new(),
            fault_count: 0,
            counted: 0,
            last_ns: now_ns,
            telemetry_ns: header.publish_ns,
            outcome: None,
            features: Features::default(),
            due: false,
            is_final: false,
            ended: false,
            run: header.description(),
        }
    }

    pub fn fault(&mut self, what: String) {
        self.fault_count += 1;
        if self.faults.len() < NAMED {
            self.faults.push(what);
        }
    }

    /// What is wrong with the stream, in words.
    pub fn notes(&self) -> Vec<String> {
        let mut v = self.faults.clone();
        if self.fault_count > self.faults.len() as u64 {
            v.push(format!("and {} more", self.fault_count - self.faults.len() as u64));
        }
        if self.lost_samples > 0 {
            let named = self.lost.iter().take(NAMED);
            let list: Vec<String> = named
                .map(|g| {
                    if g.from == g.to {
                        g.from.to_string()
                    } else {
                        format!("{}..{}", g.from, g.to)
                    }
                })
                .collect();
            let more = if self.lost.len() > NAMED { ", ..." } else { "" };
            v.push(format!(
                "{} samples lost ({}{more})",
                self.lost_samples,
                list.join(", ")
            ));
        }
        v
    }

    /// Samples from the expected one up to the one before `first` did not come.
    pub fn skip_to(&mut self, first: u64) {
        if first > self.next_sample {
            if self.lost.len() < REMEMBERED_GAPS {
                self.lost.push(Gap {
                    from: self.next_sample,
                    to: first - 1,
                });
            }
            self.lost_samples += first - self.next_sample;
            self.next_sample = first;
        }
    }

    pub fn begins(&self) -> bool {
        self.lost.first().is_none_or(|g| g.from > 1)
    }

    pub fn status(&self) -> Status {
        let sample = self.next_sample - 1;
        Status {
            actuator: self.run.actuator.clone(),
            run: self.run.run,
            process: self.header.process,
            phase: self.phase(sample),
            sample,
            samples: self.run.total_rows,
            lost: self.lost_samples,
            raw: self.extractor.as_ref().map(|x| x.features()).unwrap_or_default(),
            features: self.features,
            outcome: self.outcome.clone(),
            is_final: self.is_final,
        }
    }

    fn phase(&self, sample: u64) -> String {
        if self.ended {
            return "ended".into();
        }
        let t = sample as f64 / self.run.rate_hz;
        let segment = self
            .sequence
            .iter()
            .flat_map(|s| &s.segments)
            .rev()
            .find(|s| s.start_s <= t);
        let name = segment.map_or("-", |s| match s.command {
            Command::Ramp { .. } => "ramp",
            Command::Hold { .. } => "hold",
            Command::Sine { .. } => "sine",
            Command::Step { .. } => "step",
            Command::Chirp { .. } => "chirp",
            Command::Multisine { .. } => "multisine",
        });
        name.into()
    }
}

impl Track {
    /// Samples of a frame that is not older than the expected one.
    pub fn samples(&mut self, header: &FrameHeader, view: &TelemetryView<'_>) {
        if header.rate_hz != self.run.rate_hz || header.channels != self.header.channels {
            let n = header.frame;
            self.fault(format!(
                "frame {n}: rate or channels are not those of the stream's start"
            ));
            return;
        }
        if view.first < self.next_sample {
            self.fault(format!(
                "frame {}: samples from {} on came before",
                header.frame, view.first
            ));
            return;
        }
        for c in self.channels.iter() {
            let column = view.column(c).expect("checked when the stream was opened");
            if let Some(i) = column.iter().position(|v| !v.is_finite()) {
                let n = view.first + i as u64;
                self.fault(format!("`{}` is {} at sample {n}", c.name(), column[i]));
                return;
            }
        }
        self.skip_to(view.first);
        self.next_sample += view.rows as u64;
        self.received += view.rows as u64;
        self.telemetry_ns = header.publish_ns;
        if let Some(x) = &mut self.extractor {
            x.push(view);
        }
    }

    pub fn report(&self, diagnosis: Diagnosis, is_final: bool) -> Report {
        Report {
            run: self.run.clone(),
            stream: self.header.stream,
            is_final,
            diagnosis,
            samples_received: self.received,
            samples_lost: self.lost_samples,
            telemetry_ns: self.telemetry_ns,
        }
    }
}
