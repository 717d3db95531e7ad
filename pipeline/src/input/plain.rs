//! A table of others: a time and channels by name, and nothing said of what made them.

use super::Measured;
use anyhow::Result;
use schemas::channel::{Channel, ChannelSet};
use schemas::error::{self, Error};
use schemas::telemetry::{Collector, TelemetryBuffer, TelemetryHeader, TelemetrySink};
use std::path::Path;

/// Largest deviation of a time stamp from a steady rate, as a share of the period.
const JITTER: f64 = 0.05;

/// Channels that a table has columns of, whatever else it has.
pub(super) const NEEDED: [&str; 4] = ["com", "theta_m", "omega_m", "i_eq"];

/// Where row `i` of a file is, in words.
pub(super) type Place = fn(usize) -> String;

/// One run of a table, as it is read.
pub(super) struct Plain {
    file: String,
    place: Place,
    run: u64,
    t_s: Vec<f64>,
    channels: ChannelSet,
    samples: TelemetryBuffer,
}

impl Plain {
    pub(super) fn new(path: &Path, place: Place, channels: ChannelSet) -> Self {
        Self {
            file: path.display().to_string(),
            place,
            run: 0,
            t_s: Vec::new(),
            channels,
            samples: TelemetryBuffer::new(channels, 4096),
        }
    }

    /// Says which run it is; without, it is 0.
    pub(super) fn set_run(&mut self, run: u64) {
        self.run = run;
    }

    /// Adds the end of a sample's interval.
    ///
    /// # Errors
    /// A time that is not finite, or not after the last.
    pub(super) fn push_time(&mut self, now_s: f64, place: impl Fn() -> String) -> error::Result<()> {
        if !now_s.is_finite() {
            return Err(Error::bad(&self.file, place(), now_s, "a finite number"));
        }
        if let Some(&last) = self.t_s.last()
            && now_s <= last
        {
            let allowed = format!("a time after {last}");
            return Err(Error::bad(&self.file, place(), now_s, allowed));
        }
        self.t_s.push(now_s);
        Ok(())
    }

    /// Adds the value of a channel at the time that was added last.
    pub(super) fn push(&mut self, channel: Channel, value: f64) {
        self.samples
            .column_mut(channel)
            .expect("made with these channels")
            .push(value);
    }

    /// The run, of samples at a steady rate from the start of the sequence on.
    ///
    /// # Errors
    /// Fewer than two rows, times off a steady rate or before 0.
    pub(super) fn measured(mut self) -> Result<Measured> {
        let rate_hz = self.rate_hz()?;
        let rows = self.align(rate_hz)?;
        self.samples.set_rows(rows);
        let header = TelemetryHeader {
            run: self.run,
            actuator: String::new(),
            parameters: String::new(),
            sensors: String::new(),
            sequence: String::new(),
            rate_hz,
            channels: self.channels,
            fault: None,
            rest_angle_rad: None,
        };
        let mut telemetry = Collector::default();
        telemetry.accept(&header, &self.samples.view())?;
        Ok(Measured {
            telemetry,
            rate_hz,
            parameters: String::new(),
            sequence: String::new(),
            sequence_fingerprint: String::new(),
            sensors: String::new(),
            load_n_m: None,
            setup: None,
        })
    }

    /// The rate of the times, a whole number if they are near one.
    fn rate_hz(&self) -> Result<f64> {
        let (t, n) = (&self.t_s, self.t_s.len());
        if n < 2 {
            let (found, allowed) = (format!("{n} rows"), "at least 2 rows after the header");
            return Err(Error::bad(&self.file, "file", found, allowed).into());
        }
        let rate = (n - 1) as f64 / (t[n - 1] - t[0]);
        let round = rate.round();
        let near = (rate - round).abs() < 1e-3 * rate;
        let rate_hz = if near { round } else { rate };
        for (i, &x) in t.iter().enumerate() {
            let steady = t[0] + i as f64 / rate_hz;
            if (x - steady).abs() * rate_hz > JITTER {
                let allowed = format!("{steady:.6} +- {JITTER} of a period (steady {rate_hz} Hz)");
                return Err(Error::bad(&self.file, (self.place)(i), x, allowed).into());
            }
        }
        Ok(rate_hz)
    }

    /// Numbers the samples: sample n is of the interval that ends at n / rate. Gives the rows that stay.
    fn align(&mut self, rate_hz: f64) -> Result<usize> {
        let start_s = self.t_s[0];
        if start_s * rate_hz < -0.5 {
            let allowed = "times from 0, the start of the sequence, on";
            return Err(Error::bad(&self.file, (self.place)(0), start_s, allowed).into());
        }
        self.samples.first = (start_s * rate_hz).round() as u64;
        let mut rows = self.t_s.len();
        if self.samples.first == 0 {
            // a value at t = 0 belongs to no interval
            for c in self.channels.iter() {
                self.samples.column_mut(c).expect("made with these channels").remove(0);
            }
            self.samples.first = 1;
            rows -= 1;
        }
        Ok(rows)
    }
}

/// Names of columns for an error: at most twenty.
pub(super) fn listed(names: &[&str]) -> String {
    const MOST: usize = 20;
    match names.get(..MOST) {
        Some(first) if names.len() > MOST => format!("{} ... ({} columns)", first.join(","), names.len()),
        _ => names.join(","),
    }
}
