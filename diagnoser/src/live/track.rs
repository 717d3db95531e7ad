//! One stream of the live diagnosis.

use super::{Report, Status};
use crate::diagnosis::{Diagnosis, Outcome};
use crate::map_library::MapKey;
use schemas::channel::ChannelSet;
use schemas::feature::Features;
use schemas::sequence::TestSequence;
use schemas::stream::frame::{BEGIN, END, FrameHeader, RunDescription};
use schemas::telemetry::TelemetryView;
use schemas::test_kind::TestKind;
use sim_worker::extractor::{FeatureExtractor, FeaturePlan};
use std::sync::Arc;

/// Faults of a stream that are named one by one; the others are counted.
const NAMED: usize = 4;

/// Gaps remembered one by one, to tell a late frame from a repeated one.
const REMEMBERED_GAPS: usize = 1024;

/// A range of samples that did not come.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Gap {
    from: u64,
    to: u64,
}

/// How far the diagnosis of a stream has come; it never goes back.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Stage {
    /// samples are expected
    Open,
    /// nothing more is expected of the samples: a final diagnosis is due, and may wait for maps
    Due,
    /// the final diagnosis has been given
    Final,
}

/// What a frame means to its stream.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Arrival {
    /// a beginning, or an end that has come before: says nothing new, but wants an answer
    Greeting,
    /// samples whose number was passed: says nothing new
    Late,
    Samples,
    End,
}

/// One stream, frame by frame: what has come, what is lost, what is wrong.
pub(super) struct Track {
    run: RunDescription,
    header: FrameHeader,
    publisher: u64,
    sequence: Option<TestSequence>,
    channels: ChannelSet,
    extractor: Option<FeatureExtractor>,
    /// the unit that is tested, where it is known: fingerprint of its model
    unit: Option<String>,
    maps: Option<MapKey>,
    stage: Stage,
    /// the publisher will send no more
    has_ended: bool,
    next_frame: u64,
    next_sample: u64,
    received: u64,
    /// sample frames that came before the first gap in the frames' numbers
    whole_frames: u64,
    /// no frame number has been left out
    is_unbroken: bool,
    lost: Vec<Gap>,
    lost_samples: u64,
    faults: Vec<String>,
    fault_count: u64,
    counted: usize,
    last_ns: u64,
    telemetry_ns: u64,
    outcome: Option<Outcome>,
    features: Features,
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
            unit: None,
            maps: None,
            stage: Stage::Open,
            has_ended: false,
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
            run: header.description(),
        }
    }

    /// The stream can be interpreted: these channels give these features.
    ///
    /// * `unit` fingerprint of the model of the unit that is tested, where it is known
    pub fn interpret(&mut self, plan: Arc<FeaturePlan>, channels: ChannelSet, unit: Option<String>) {
        self.channels = channels;
        self.unit = unit;
        if self.run.total_rows == 0 {
            self.run.total_rows = plan.rows;
        }
        self.extractor = Some(FeatureExtractor::new(plan));
    }

    pub fn run(&self) -> &RunDescription {
        &self.run
    }

    pub fn header(&self) -> &FrameHeader {
        &self.header
    }

    pub fn publisher(&self) -> u64 {
        self.publisher
    }

    pub fn extractor(&self) -> Option<&FeatureExtractor> {
        self.extractor.as_ref()
    }

    /// The maps that it needs, once that is known.
    pub fn maps(&self) -> Option<&MapKey> {
        self.maps.as_ref()
    }

    /// The number of frames that a publisher is answered with.
    pub fn whole_frames(&self) -> u64 {
        self.whole_frames
    }

    /// When the last frame came [ns, CLOCK_MONOTONIC].
    pub fn last_ns(&self) -> u64 {
        self.last_ns
    }

    /// The last sample that came or was passed over.
    pub fn sample(&self) -> u64 {
        self.next_sample - 1
    }

    /// More samples are expected.
    pub fn is_open(&self) -> bool {
        self.stage == Stage::Open
    }

    pub fn is_due(&self) -> bool {
        self.stage == Stage::Due
    }

    pub fn is_final(&self) -> bool {
        self.stage == Stage::Final
    }

    /// The publisher may send more, whatever has become of the diagnosis.
    pub fn is_streaming(&self) -> bool {
        !self.has_ended
    }

    /// Nothing more is expected of the samples. Returns whether that is news.
    pub fn make_due(&mut self) -> bool {
        let is_news = self.is_open();
        if is_news {
            self.stage = Stage::Due;
        }
        is_news
    }

    /// It has had its final diagnosis before, from another process.
    pub fn stay_silent(&mut self) {
        self.stage = Stage::Final;
    }

    /// Samples taken, and what makes a whole test of its sequence at its rate.
    pub fn progress(&self) -> (u64, u64) {
        let whole = self.extractor.as_ref().map_or(0, |x| x.plan().rows);
        (self.received, whole)
    }

    pub fn lost_samples(&self) -> u64 {
        self.lost_samples
    }

    /// It cannot be diagnosed, or not to its end: why.
    pub fn give_up(&mut self, why: String) {
        self.fault(why);
        self.make_due();
    }

    /// Its publisher will send no more: why.
    pub fn break_off(&mut self, why: String) {
        self.give_up(why);
        self.has_ended = true;
    }

    /// A frame that cannot be read.
    pub fn damaged(&mut self, frame: u64, what: String) {
        self.next_frame = self.next_frame.max(frame.saturating_add(1));
        self.fault(what);
    }

    /// A readable frame has come: what it is, by its number.
    pub fn arrive(&mut self, header: &FrameHeader, now_ns: u64) -> Arrival {
        self.last_ns = now_ns;
        if header.kind == BEGIN {
            self.next_frame = self.next_frame.max(1);
            return Arrival::Greeting;
        }
        let is_end = header.kind == END;
        if header.frame < self.next_frame {
            if is_end {
                return Arrival::Greeting;
            }
            if self.lost.iter().any(|g| (g.from..=g.to).contains(&header.first)) {
                self.fault(format!("frame {} out of order", header.frame));
            }
            return Arrival::Late;
        }
        if header.frame > self.next_frame && is_end && self.next_frame > 0 {
            let n = header.frame - self.next_frame;
            self.fault(format!("{n} frames lost before the last one"));
        }
        self.is_unbroken &= header.frame == self.next_frame;
        self.next_frame = header.frame.saturating_add(1);
        if !is_end {
            self.whole_frames += u64::from(self.is_unbroken);
            return Arrival::Samples;
        }
        self.has_ended = true;
        if !self.is_final() {
            self.telemetry_ns = header.publish_ns;
            if !self.is_unbroken {
                self.skip_to(self.run.total_rows.saturating_add(1));
            }
            self.make_due();
        }
        Arrival::End
    }

    /// The maps to be asked for, when the rest angle has just become known.
    pub fn wish(&mut self) -> Option<MapKey> {
        let x = self.extractor.as_ref().filter(|_| self.maps.is_none())?;
        let rest = x.rest_angle_rad()?;
        let kind = self.run.kind(rest, x.plan().equivalent_current());
        self.maps = Some(match &self.unit {
            // a unit is not the model, whatever its sender took it for
            Some(parameters) => {
                let parameters = parameters.clone();
                MapKey::of_unit(TestKind { parameters, ..kind }, &self.run.actuator)
            }
            None => MapKey::new(kind),
        });
        self.maps.clone()
    }

    /// Whether there are more features than at the last call.
    pub fn has_more(&mut self) -> bool {
        let count = self.extractor.as_ref().map_or(0, FeatureExtractor::count);
        let is_more = count > self.counted;
        self.counted = count.max(self.counted);
        is_more
    }

    /// What is known so far.
    pub fn so_far(&mut self, diagnosis: Diagnosis) -> Report {
        self.features = diagnosis.features;
        self.outcome = Some(diagnosis.outcome.clone());
        Report {
            run: self.run.clone(),
            stream: self.header.stream,
            is_final: self.is_final(),
            diagnosis,
            samples_received: self.received,
            samples_lost: self.lost_samples,
            telemetry_ns: self.telemetry_ns,
        }
    }

    /// The last word.
    pub fn finish(&mut self, diagnosis: Diagnosis) -> Report {
        self.stage = Stage::Final;
        self.so_far(diagnosis)
    }

    fn fault(&mut self, what: String) {
        self.fault_count = self.fault_count.saturating_add(1);
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
    fn skip_to(&mut self, first: u64) {
        if first > self.next_sample {
            if self.lost.len() < REMEMBERED_GAPS {
                self.lost.push(Gap {
                    from: self.next_sample,
                    to: first - 1,
                });
            }
            self.lost_samples = self.lost_samples.saturating_add(first - self.next_sample);
            self.next_sample = first;
        }
    }

    /// Sample 1 is not among the lost ones.
    pub fn begins(&self) -> bool {
        self.lost.first().is_none_or(|g| g.from > 1)
    }

    pub fn status(&self) -> Status {
        let sample = self.sample();
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
            is_final: self.is_final(),
            foretold: None,
        }
    }

    fn phase(&self, sample: u64) -> String {
        if self.has_ended {
            return "ended".into();
        }
        let t = sample as f64 / self.run.rate_hz;
        let segment = self
            .sequence
            .iter()
            .flat_map(|s| &s.segments)
            .rev()
            .find(|s| s.start_s <= t);
        segment.map_or("-", |s| s.command.name()).into()
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
}
