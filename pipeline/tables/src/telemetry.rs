//! One run of telemetry out of a table.

use crate::channel_map::ChannelMap;
use crate::dialect::EMPTY;
pub use crate::header::quantity;
use crate::table::{Table, listed};
use schemas::channel::Channel;
use schemas::error::{Error, Result};

/// Channels without which a recording is none, whatever else it has.
pub const NEEDED: [Channel; 4] = [Channel::Com, Channel::ThetaM, Channel::OmegaM, Channel::IEq];

/// Currents of the three phases.
const PHASES: [Channel; 3] = [Channel::IA, Channel::IB, Channel::IC];

/// One run, in SI units.
#[derive(Clone, Debug)]
pub struct Telemetry {
    /// number of the run; `None` in a table without
    pub run: Option<u64>,
    /// ends of the samples' intervals [s], rising
    pub t_s: Vec<f64>,
    /// the clock is one of a calendar or of a day: it does not say when the test began
    pub is_clock: bool,
    /// header of the time
    pub time: String,
    /// as long as the times
    pub channels: Vec<(Channel, Vec<f64>)>,
    /// what was brought to our names and units, and what was derived, in words
    pub said: Vec<String>,
    /// rows in the table
    rows: Vec<usize>,
}

impl Telemetry {
    /// Where sample `i` stands in the file, in words.
    pub fn place(&self, table: &Table, i: usize) -> String {
        table.place(self.rows[i], &self.time)
    }
}

impl Table {
    /// Numbers of the runs, one after the other; `None` in a table without a column `run`.
    ///
    /// # Errors
    /// Numbers of runs that are no whole numbers.
    pub fn runs(&self) -> Result<Option<Vec<u64>>> {
        if !self.names.iter().any(|n| n == "run") {
            return Ok(None);
        }
        let mut runs: Vec<u64> = Vec::new();
        for (row, &x) in self.numbers("run")?.iter().enumerate() {
            if !(x.fract() == 0.0 && (0.0..9e15).contains(&x)) {
                return Err(Error::bad(
                    &self.file,
                    self.place(row, "run"),
                    x,
                    "a whole number from 0",
                ));
            }
            if runs.last() != Some(&(x as u64)) {
                runs.push(x as u64);
            }
        }
        Ok(Some(runs))
    }

    /// One run: the one that is asked for, or the only one.
    ///
    /// * `map` columns that are not called as ours
    ///
    /// # Errors
    /// Columns that are missing, several runs without a choice or none of that number, values that are not finite, times
    /// that do not rise; with file and place.
    pub fn telemetry(&self, run: Option<u64>, map: Option<&ChannelMap>) -> Result<Telemetry> {
        let time = map.and_then(ChannelMap::time).map_or("t", |s| s.column.as_str());
        let mapped = |c: Channel| map.and_then(|m| m.of_channel(c));
        let is_there = |c: &Channel| mapped(*c).is_some() || self.names.iter().any(|n| n == c.name());
        let has_phases = PHASES.iter().all(is_there);
        let derives = !is_there(&Channel::IEq) && has_phases;
        let mut absent: Vec<&str> = NEEDED.iter().filter(|c| !is_there(c)).map(|c| c.name()).collect();
        absent.retain(|c| !(derives && *c == Channel::IEq.name()));
        if !self.has(time) {
            absent.insert(0, time);
        }
        if !absent.is_empty() {
            let allowed = format!(
                "columns t, com, theta_m, omega_m, i_eq or i_a, i_b, i_c (missing: {}); --channels FILE says which column is what",
                absent.join(", ")
            );
            let place = if self.is_text() { "header" } else { "columns" };
            return Err(Error::bad(&self.file, place, listed(&self.names), allowed));
        }
        let (run, rows) = self.rows_of(run)?;
        let cells = |column: &str| -> Result<Vec<f64>> {
            let all = self.numbers(column)?;
            let mut values = Vec::with_capacity(rows.len());
            for &row in &rows {
                if !all[row].is_finite() {
                    let is_empty = all[row].is_nan() && all[row].is_sign_negative() == EMPTY.is_sign_negative();
                    let found = if is_empty && self.is_text() {
                        "nothing".into()
                    } else {
                        all[row].to_string()
                    };
                    return Err(Error::bad(
                        &self.file,
                        self.place(row, column),
                        found,
                        "a finite number",
                    ));
                }
                values.push(all[row]);
            }
            Ok(values)
        };
        let mut said = self.said();
        let mut t_s = cells(time)?;
        if let Some(spec) = map.and_then(ChannelMap::time)
            && !self.is_moments(time)
        {
            let (factor, words) = spec.factor(self, "t")?;
            said.push(words);
            t_s.iter_mut().for_each(|t| *t *= factor);
        }
        if let Some(i) = (1..t_s.len()).find(|&i| t_s[i] <= t_s[i - 1]) {
            let (place, allowed) = (self.place(rows[i], time), format!("a time after {}", t_s[i - 1]));
            return Err(Error::bad(&self.file, place, t_s[i], allowed));
        }
        let mut channels: Vec<(Channel, Vec<f64>)> = Vec::new();
        for &c in Channel::ALL.iter().filter(|c| is_there(c)) {
            let values = match mapped(c) {
                None => cells(c.name())?,
                Some(spec) => {
                    let (factor, words) = spec.factor(self, c.name())?;
                    said.push(words);
                    let minus = spec.minus.as_deref().map(cells).transpose()?;
                    let less = |i: usize| minus.as_ref().map_or(0.0, |m| m[i]);
                    let values = cells(&spec.column)?.into_iter().enumerate();
                    values.map(|(i, x)| (x - less(i)) * factor).collect()
                }
            };
            channels.push((c, values));
        }
        if derives {
            let phase = |c: Channel| {
                channels
                    .iter()
                    .find(|(d, _)| *d == c)
                    .map(|(_, v)| v.clone())
                    .expect("there")
            };
            let [a, b, c] = PHASES.map(phase);
            let sum = |i: usize| 0.5 * (a[i].abs() + b[i].abs() + c[i].abs());
            channels.push((Channel::IEq, (0..a.len()).map(sum).collect()));
            said.push("i_eq is half the sum of |i_a|, |i_b|, |i_c| (Eq. 4)".into());
        }
        Ok(Telemetry {
            run,
            is_clock: self.is_moments(time),
            time: time.into(),
            t_s,
            channels,
            said,
            rows,
        })
    }

    fn is_text(&self) -> bool {
        matches!(self.places, crate::table::Places::Lines(_))
    }

    fn rows_of(&self, wanted: Option<u64>) -> Result<(Option<u64>, Vec<usize>)> {
        let Some(runs) = self.runs()? else {
            return Ok((None, (0..self.rows).collect()));
        };
        let run = match wanted {
            None if runs.len() > 1 => {
                let found = format!("{} runs", runs.len());
                return Err(Error::bad(
                    &self.file,
                    "file",
                    found,
                    "one run, or --run NUMBER to choose one",
                ));
            }
            Some(run) if !runs.contains(&run) => {
                let allowed = format!("one of the runs {runs:?}");
                return Err(Error::bad(&self.file, "file", format!("no run {run}"), allowed));
            }
            wanted => wanted.unwrap_or(runs[0]),
        };
        let numbers = self.numbers("run")?;
        let rows = (0..self.rows).filter(|&i| numbers[i] as u64 == run).collect();
        Ok((Some(run), rows))
    }
}
