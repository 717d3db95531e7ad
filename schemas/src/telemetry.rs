//! Telemetry as borrowed columns: one view, whatever the medium.

use crate::channel::{Channel, ChannelSet};
use crate::fault::FaultState;

/// What holds for every sample of one run.
#[derive(Clone, Debug, PartialEq)]
pub struct TelemetryHeader {
    /// number of the run in its plan, or 0
    pub run: u64,
    /// actuator name
    pub actuator: String,
    /// fingerprint of the actuator's parameters, empty where unknown
    pub parameters: String,
    /// fingerprint of the sensor model, `"none"` without sensors, empty where unknown
    pub sensors: String,
    /// name of the sequence
    pub sequence: String,
    /// samples a second [Hz]
    pub rate_hz: f64,
    /// channels that every block has columns of
    pub channels: ChannelSet,
    /// faults of a simulated run
    pub fault: Option<FaultState>,
    /// rotor angle at rest [rad], of a simulated run
    pub rest_angle_rad: Option<f64>,
}

/// A block of consecutive samples. Sample `n` (counted from 1) is of the interval that ends at
/// `n / rate`.
#[derive(Clone, Copy, Debug)]
pub struct TelemetryView<'a> {
    /// number of the first sample
    pub first: u64,
    /// samples of the block
    pub rows: usize,
    columns: [Option<&'a [f64]>; Channel::COUNT],
}

impl<'a> TelemetryView<'a> {
    /// A block without columns.
    ///
    /// * `first` number of the first sample, from 1 on
    pub fn new(first: u64, rows: usize) -> Self {
        Self {
            first,
            rows,
            columns: [None; Channel::COUNT],
        }
    }

    /// Adds a column of `rows` values, in the channel's unit.
    ///
    /// # Panics
    /// If the column's length is not `rows`: a bug of the caller.
    pub fn with(mut self, channel: Channel, values: &'a [f64]) -> Self {
        assert_eq!(values.len(), self.rows, "column {} of another length", channel.name());
        self.columns[channel as usize] = Some(values);
        self
    }

    /// A column of `rows` values in the channel's unit; none where the block has no such channel.
    pub fn column(&self, channel: Channel) -> Option<&'a [f64]> {
        self.columns[channel as usize]
    }

    /// Rows `from..to` of the view.
    pub fn slice(&self, from: usize, to: usize) -> TelemetryView<'a> {
        let mut v = TelemetryView::new(self.first + from as u64, to - from);
        for (to_col, col) in v.columns.iter_mut().zip(&self.columns) {
            *to_col = col.map(|c| &c[from..to]);
        }
        v
    }
}

/// Columns of a block of samples that a producer fills in place, whatever memory they lie in.
#[derive(Debug)]
pub struct TelemetryViewMut<'a> {
    /// number of the first sample
    pub first: u64,
    /// samples of the block
    pub rows: usize,
    columns: [Option<&'a mut [f64]>; Channel::COUNT],
}

impl<'a> TelemetryViewMut<'a> {
    /// A block without columns.
    ///
    /// * `first` number of the first sample, from 1 on
    pub fn new(first: u64, rows: usize) -> Self {
        Self {
            first,
            rows,
            columns: std::array::from_fn(|_| None),
        }
    }

    /// Adds a column of `rows` values.
    ///
    /// # Panics
    /// If the column's length is not `rows`: a bug of the caller.
    pub fn with(mut self, channel: Channel, values: &'a mut [f64]) -> Self {
        assert_eq!(values.len(), self.rows, "column {} of another length", channel.name());
        self.columns[channel as usize] = Some(values);
        self
    }

    /// A column of `rows` values in the channel's unit; none where the block has none, or it is taken out.
    pub fn column(&self, channel: Channel) -> Option<&[f64]> {
        self.columns[channel as usize].as_deref()
    }

    /// As [`TelemetryViewMut::column`], to be written.
    pub fn column_mut(&mut self, channel: Channel) -> Option<&mut [f64]> {
        self.columns[channel as usize].as_deref_mut()
    }

    /// Takes a column out, so that it can be written while others are read.
    pub fn take(&mut self, channel: Channel) -> Option<&'a mut [f64]> {
        self.columns[channel as usize].take()
    }

    /// Puts a column back that was taken out.
    pub fn put(&mut self, channel: Channel, values: Option<&'a mut [f64]>) {
        self.columns[channel as usize] = values;
    }

    /// Copies the columns that both have; the others become NaN.
    pub fn copy_from(&mut self, view: &TelemetryView<'_>) {
        self.first = view.first;
        for (to, from) in self.columns.iter_mut().zip(&view.columns) {
            match (to, from) {
                (Some(to), Some(from)) => to.copy_from_slice(from),
                (Some(to), None) => to.fill(f64::NAN),
                _ => {}
            }
        }
    }
}

/// Owned columns that a producer fills and lends as a view.
#[derive(Clone, Debug, Default)]
pub struct TelemetryBuffer {
    /// number of the first sample
    pub first: u64,
    /// samples
    pub rows: usize,
    columns: Vec<(Channel, Vec<f64>)>,
}

impl TelemetryBuffer {
    /// No samples yet, room for `capacity` of each channel.
    pub fn new(channels: ChannelSet, capacity: usize) -> Self {
        Self {
            first: 1,
            rows: 0,
            columns: channels.iter().map(|c| (c, Vec::with_capacity(capacity))).collect(),
        }
    }
    /// The samples, borrowed.
    pub fn view(&self) -> TelemetryView<'_> {
        let mut v = TelemetryView::new(self.first, self.rows);
        for (c, values) in &self.columns {
            v = v.with(*c, values);
        }
        v
    }
    /// Room for `rows` samples from number `first` on, to be filled.
    pub fn view_mut(&mut self, first: u64, rows: usize) -> TelemetryViewMut<'_> {
        self.first = first;
        self.rows = rows;
        let mut v = TelemetryViewMut::new(first, rows);
        for (c, values) in &mut self.columns {
            values.resize(rows, 0.0);
            v = v.with(*c, values);
        }
        v
    }
    /// Channels that it has columns of.
    pub fn channels(&self) -> ChannelSet {
        ChannelSet::of(self.columns.iter().map(|(c, _)| *c))
    }
    /// A column to be filled by hand; [`TelemetryBuffer::set_rows`] follows.
    pub fn column_mut(&mut self, channel: Channel) -> Option<&mut Vec<f64>> {
        self.columns.iter_mut().find(|(c, _)| *c == channel).map(|(_, v)| v)
    }
    /// A column of `rows` values in the channel's unit; none where the buffer has no such channel.
    pub fn column(&self, channel: Channel) -> Option<&[f64]> {
        self.columns
            .iter()
            .find(|(c, _)| *c == channel)
            .map(|(_, v)| v.as_slice())
    }
    /// Copies a view.
    pub fn copy_from(&mut self, view: &TelemetryView<'_>) {
        self.first = view.first;
        self.rows = view.rows;
        for (c, v) in &mut self.columns {
            v.clear();
            if let Some(col) = view.column(*c) {
                v.extend_from_slice(col);
            } else {
                v.resize(view.rows, f64::NAN);
            }
        }
    }
    /// Sets the number of rows after columns were filled by hand.
    pub fn set_rows(&mut self, rows: usize) {
        debug_assert!(self.columns.iter().all(|(_, v)| v.len() == rows));
        self.rows = rows;
    }
}

/// Producers push, sinks accept: recorder, publisher, extractor and a test's buffer are sinks.
pub trait TelemetrySink {
    /// Takes the next block of a run.
    ///
    /// * `header` the same for all blocks of a run
    ///
    /// # Errors
    /// What the sink refuses; who pushes passes it on and stops.
    fn accept(&mut self, header: &TelemetryHeader, view: &TelemetryView<'_>) -> crate::error::Result<()>;
}

/// Keeps everything, for plots and tests.
#[derive(Clone, Debug, Default)]
pub struct Collector {
    /// of the run; none before the first block
    pub header: Option<TelemetryHeader>,
    columns: Vec<(Channel, Vec<f64>)>,
    /// number of the first sample
    pub first: u64,
}

impl Collector {
    /// Samples kept.
    pub fn rows(&self) -> usize {
        self.columns.first().map_or(0, |(_, v)| v.len())
    }
    /// All samples of a channel, in the channel's unit; none where the run has no such channel.
    pub fn column(&self, channel: Channel) -> Option<&[f64]> {
        self.columns
            .iter()
            .find(|(c, _)| *c == channel)
            .map(|(_, v)| v.as_slice())
    }
    /// All samples as one block.
    pub fn view(&self) -> TelemetryView<'_> {
        let mut v = TelemetryView::new(self.first, self.rows());
        for (c, values) in &self.columns {
            v = v.with(*c, values);
        }
        v
    }
}

impl TelemetrySink for Collector {
    fn accept(&mut self, header: &TelemetryHeader, view: &TelemetryView<'_>) -> crate::error::Result<()> {
        if self.header.is_none() {
            self.header = Some(header.clone());
            self.first = view.first;
            self.columns = header.channels.iter().map(|c| (c, Vec::new())).collect();
        }
        for (c, v) in &mut self.columns {
            v.extend_from_slice(view.column(*c).expect("a header names the columns of its views"));
        }
        Ok(())
    }
}
