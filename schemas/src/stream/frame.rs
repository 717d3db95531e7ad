//! Telemetry frames: a header and columns of f64, one after the other, each from a 64 byte
//! boundary on.

use super::wire::{from_number, from_text, to_number, to_text, wire};
use crate::channel::{Channel, ChannelSet};
use crate::foreign;
use crate::telemetry::{TelemetryView, TelemetryViewMut};
use crate::test_kind::TestKind;

/// First frame of a run: no samples, says what comes.
pub const BEGIN: u32 = 1;
/// Samples.
pub const SAMPLES: u32 = 2;
/// Last frame of a run: no samples; `frame` counts what was sent.
pub const END: u32 = 3;

/// Rows to which a column is padded: 64 bytes.
pub const STRIDE_ROWS: usize = 8;

/// Element of a frame's payload: 64 bytes, at 64 byte boundaries. (With single values at that
/// alignment, iceoryx2 would reserve 64 bytes for each of them.)
pub type Block = [f64; STRIDE_ROWS];

/// The channel table as text: its numbering is part of the frame's layout.
fn channel_table() -> String {
    let rows = Channel::ALL.iter().map(|c| format!("{} {}", c.name(), c.unit()));
    rows.collect::<Vec<_>>().join(";")
}

wire! {
    /// Header of a telemetry frame. Every frame says all about its run, so that a subscriber may
    /// join at any time.
    FrameHeader (&channel_table()) {
        /// [`crate::SCHEMA_VERSION`] of the sender
        schema_version: u32,
        /// [`BEGIN`], [`SAMPLES`] or [`END`]
        kind: u32,
        /// which actuator, UTF-8 padded with zeros
        actuator: [u8; 32],
        /// fingerprint of the actuator's parameters
        parameters: u64,
        /// fingerprint of the sensor model; 0 without sensors
        sensors: u64,
        /// fingerprint of the sequence
        sequence: u64,
        /// number of the run, chosen by the sender
        run: u64,
        /// this pass of the run: another number whenever a run starts or is sent again
        stream: u64,
        /// number of the frame in its stream, from 0 (BEGIN) on, without gaps
        frame: u64,
        /// number of the first sample, from 1 on
        first: u64,
        /// time of the first sample after the start of the sequence [ns]
        first_ns: i64,
        /// samples of the whole run, 0 where unknown
        total_rows: u64,
        /// when the frame was published (CLOCK_MONOTONIC) [ns]
        publish_ns: u64,
        /// samples a second [Hz]
        rate_hz: f64,
        /// constant load torque, NaN where unknown [N m, motor side]
        load_n_m: f64,
        /// samples in this frame
        rows: u32,
        /// f64 values from the start of one column to the start of the next
        stride: u32,
        /// channels, bit `n` for channel number `n` of the channel table, columns in that order
        channels: u32,
        /// process number of the sender
        process: u32,
    }
}

/// What a frame cannot be: the finding names what is there and what is allowed.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum FrameFault {
    /// the sender's schema version is another
    #[error("schema version {0}; allowed: {version}", version = crate::SCHEMA_VERSION)]
    SchemaVersion(u32),
    /// neither BEGIN nor SAMPLES nor END
    #[error("kind {0}; allowed: 1 begin, 2 samples, 3 end")]
    Kind(u32),
    /// bits beyond the channel table
    #[error("channel bits {0:#x}; allowed: channels of the table")]
    Channels(u32),
    #[error("{rows} rows at a stride of {stride}; allowed: 1 to stride rows, stride a multiple of 8")]
    /// no rows, more rows than a column has room for, or columns off the 64 byte boundaries
    Rows {
        /// samples that the header says
        rows: u32,
        /// f64 values from column to column that the header says
        stride: u32,
    },
    #[error("truncated: {found} values; needed: {needed}")]
    /// the payload is shorter than its columns
    Truncated {
        /// f64 values of the payload
        found: usize,
        /// f64 values that the columns take
        needed: usize,
    },
    /// number of the first sample
    #[error("first sample {0}; allowed: 1 to 2^53")]
    First(u64),
    /// rate [Hz]
    #[error("rate {0} Hz; allowed: a finite rate above 0")]
    Rate(f64),
    /// a name that would do something to the terminal that it is printed on, or that is no text
    #[error("actuator name `{}`; allowed: {NAMES}, padded with zeros", foreign::value(&from_text(_0)))]
    Actuator([u8; 32]),
}

/// What names of actuators are made of, in words.
pub const NAMES: &str = "up to 32 bytes of UTF-8 without control and format characters";

/// The name in a fixed field, if it is one that may be printed.
fn name(field: &[u8]) -> Option<&str> {
    let end = field.iter().position(|&b| b == 0).unwrap_or(field.len());
    let (text, padding) = field.split_at(end);
    let text = std::str::from_utf8(text).ok()?;
    // one name, one field: streams are told apart by its bytes
    let is_name = text.chars().all(foreign::is_plain) && padding.iter().all(|&b| b == 0);
    is_name.then_some(text)
}

/// What a sender says of a run.
#[derive(Clone, Debug, PartialEq)]
pub struct RunDescription {
    /// which actuator, at most 32 bytes of UTF-8
    pub actuator: String,
    /// fingerprint of the parameters
    pub parameters: String,
    /// fingerprint of the sensor model, `none`, or empty where unknown
    pub sensors: String,
    /// fingerprint of the sequence
    pub sequence: String,
    /// number of the run, chosen by the sender
    pub run: u64,
    /// samples a second [Hz]
    pub rate_hz: f64,
    /// channels that the frames have columns of
    pub channels: ChannelSet,
    /// samples of the whole run, 0 where unknown
    pub total_rows: u64,
    /// constant load torque [N m, motor side], NaN where unknown
    pub load_n_m: f64,
}

impl RunDescription {
    /// Header of the run's frames, nothing of a single frame yet.
    pub fn header(&self) -> FrameHeader {
        FrameHeader {
            schema_version: crate::SCHEMA_VERSION,
            actuator: to_text(&self.actuator),
            parameters: to_number(&self.parameters),
            sensors: to_number(&self.sensors),
            sequence: to_number(&self.sequence),
            run: self.run,
            total_rows: self.total_rows,
            rate_hz: self.rate_hz,
            load_n_m: self.load_n_m,
            channels: self.channels.0,
            process: std::process::id(),
            ..FrameHeader::default()
        }
    }

    /// Constant load torque [N m, motor side], where it is known.
    pub fn load(&self) -> Option<f64> {
        Some(self.load_n_m).filter(|x| !x.is_nan())
    }

    /// The kind of test that the run is.
    ///
    /// * `rest_angle_rad` motor angle at sample 1 [rad]
    /// * `equivalent_current` P2 from i_eq
    pub fn kind(&self, rest_angle_rad: f64, equivalent_current: bool) -> TestKind {
        TestKind {
            parameters: self.parameters.clone(),
            sequence: self.sequence.clone(),
            sensors: self.sensors.clone(),
            rate_hz: self.rate_hz,
            rest_angle_rad,
            load_n_m: self.load(),
            equivalent_current,
        }
    }
}

impl FrameHeader {
    /// The actuator as text.
    pub fn actuator_text(&self) -> String {
        from_text(&self.actuator)
    }

    /// The channels as a set.
    pub fn channel_set(&self) -> ChannelSet {
        ChannelSet(self.channels)
    }

    /// What the header says of its run.
    pub fn description(&self) -> RunDescription {
        RunDescription {
            actuator: self.actuator_text(),
            parameters: from_number(self.parameters),
            sensors: from_number(self.sensors),
            sequence: from_number(self.sequence),
            run: self.run,
            rate_hz: self.rate_hz,
            channels: self.channel_set(),
            total_rows: self.total_rows,
            load_n_m: self.load_n_m,
        }
    }

    /// f64 values that the columns of this header take.
    pub fn values(&self) -> usize {
        self.stride as usize * self.channels.count_ones() as usize
    }

    /// Payload elements that the columns of this header take.
    pub fn blocks(&self) -> usize {
        self.values() / STRIDE_ROWS
    }

    /// Sets the samples of a frame: number of the first one, and how many.
    pub fn set_rows(&mut self, first: u64, rows: usize) {
        self.first = first;
        self.first_ns = (first as f64 / self.rate_hz * 1e9).round() as i64;
        self.rows = rows as u32;
        self.stride = rows.next_multiple_of(STRIDE_ROWS) as u32;
    }

    /// Checks the header against the payload's length.
    ///
    /// * `payload` f64 values that are there
    ///
    /// # Errors
    /// The first thing that a frame cannot be.
    pub fn check(&self, payload: usize) -> Result<(), FrameFault> {
        if self.schema_version != crate::SCHEMA_VERSION {
            return Err(FrameFault::SchemaVersion(self.schema_version));
        }
        if name(&self.actuator).is_none() {
            return Err(FrameFault::Actuator(self.actuator));
        }
        if !(self.rate_hz.is_finite() && self.rate_hz > 0.0) {
            return Err(FrameFault::Rate(self.rate_hz));
        }
        if self.channels >> Channel::COUNT != 0 {
            return Err(FrameFault::Channels(self.channels));
        }
        match self.kind {
            BEGIN | END => Ok(()),
            SAMPLES => {
                let (rows, stride) = (self.rows, self.stride);
                if rows == 0 || rows > stride || !(stride as usize).is_multiple_of(STRIDE_ROWS) {
                    return Err(FrameFault::Rows { rows, stride });
                }
                if self.first == 0 || self.first > 1 << 53 {
                    return Err(FrameFault::First(self.first));
                }
                let needed = self.values();
                if payload < needed {
                    return Err(FrameFault::Truncated { found: payload, needed });
                }
                Ok(())
            }
            kind => Err(FrameFault::Kind(kind)),
        }
    }

    /// The columns of a checked frame, in place.
    ///
    /// # Errors
    /// As [`FrameHeader::check`].
    pub fn view<'a>(&self, payload: &'a [f64]) -> Result<TelemetryView<'a>, FrameFault> {
        self.check(payload.len())?;
        let rows = if self.kind == SAMPLES { self.rows as usize } else { 0 };
        let mut view = TelemetryView::new(self.first, rows);
        if rows > 0 {
            let columns = payload.chunks_exact(self.stride as usize);
            for (c, column) in self.channel_set().iter().zip(columns) {
                view = view.with(c, &column[..rows]);
            }
        }
        Ok(view)
    }

    /// The columns of a frame to be filled, in place.
    pub fn view_mut<'a>(&self, payload: &'a mut [f64]) -> TelemetryViewMut<'a> {
        let rows = self.rows as usize;
        let mut view = TelemetryViewMut::new(self.first, rows);
        for (c, column) in self
            .channel_set()
            .iter()
            .zip(payload.chunks_exact_mut(self.stride as usize))
        {
            view = view.with(c, &mut column[..rows]);
        }
        view
    }
}

wire! {
    /// A subscriber's answer to the first or the last frame of a stream.
    Acknowledgement ("") {
        /// the stream
        stream: u64,
        /// which subscriber
        subscriber: u64,
        /// [`BEGIN`] or [`END`]
        kind: u32,
        /// process number of the subscriber
        process: u32,
        /// sample frames of the stream that came before the first gap in their numbers
        frames: u64,
    }
}
