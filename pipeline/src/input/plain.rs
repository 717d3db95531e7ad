//! Tables of others: a time and channels, and nothing said of what made them. How their clock stands to the test.

use super::{Measured, follows};
use anyhow::Result;
use ema_tables::{Table, Telemetry};
use schemas::channel::{Channel, ChannelSet};
use schemas::error::Error;
use schemas::sequence::TestSequence;
use schemas::telemetry::{Collector, TelemetryBuffer, TelemetryHeader, TelemetrySink};
use sim_worker::command::CommandTrack;

/// Largest deviation of a time stamp from a steady rate, as a share of the period.
const JITTER: f64 = 0.05;

/// One run of a table as a recording: samples at a steady rate, numbered from the start of the test on.
///
/// * `sequences` that the command may follow, where the clock does not say when the test began
///
/// # Errors
/// Fewer than two rows, times off a steady rate, a clock from which nobody knows when the test began.
pub(super) fn measured(table: &Table, t: Telemetry, sequences: &[TestSequence]) -> Result<Measured> {
    let rate_hz = rate_hz(table, &t)?;
    let mut said = t.said.clone();
    let stated = (t.t_s[0] * rate_hz).round();
    // whoever asks later what sequence it is says that none is followed
    let is_possible = !t.is_clock && stated >= 0.0;
    let as_stated = is_possible.then(|| of(samples(&t, rate_hz, stated as i64, usize::MAX), rate_hz));
    let is_followed = as_stated
        .as_ref()
        .is_some_and(|m| sequences.iter().any(|s| follows(m, s)));
    let by_command = if is_followed {
        None
    } else {
        aligned(&t, rate_hz, sequences)
    };
    let at = if t.is_clock {
        "a time of day".to_string()
    } else {
        format!("{} s", t.t_s[0])
    };
    let m = match (by_command, as_stated) {
        (Some(found), _) => {
            said.push(format!(
                "the first row, at {at}, is sample {} of the test, as the command of `{}` says",
                found.first, found.sequence
            ));
            found.measured
        }
        (None, Some(m)) => m,
        (None, None) => {
            let allowed = "times from 0, the start of the sequence, on, or a command that a known sequence follows \
                           (--sequence names another)";
            return Err(Error::bad(&table.file, t.place(table, 0), at, allowed).into());
        }
    };
    Ok(Measured { said, ..m })
}

fn of(telemetry: Collector, rate_hz: f64) -> Measured {
    Measured {
        telemetry,
        rate_hz,
        parameters: String::new(),
        sequence: String::new(),
        sequence_fingerprint: String::new(),
        sensors: String::new(),
        load_n_m: None,
        setup: None,
        said: Vec::new(),
    }
}

/// The rate of the times, a whole number if they are near one.
fn rate_hz(table: &Table, run: &Telemetry) -> Result<f64> {
    let (t, n) = (&run.t_s, run.t_s.len());
    if n < 2 {
        let (found, allowed) = (format!("{n} rows"), "at least 2 rows after the header");
        return Err(Error::bad(&table.file, "file", found, allowed).into());
    }
    let rate = (n - 1) as f64 / (t[n - 1] - t[0]);
    let round = rate.round();
    let near = (rate - round).abs() < 1e-3 * rate;
    let rate_hz = if near { round } else { rate };
    for (i, &x) in t.iter().enumerate() {
        let steady = t[0] + i as f64 / rate_hz;
        if (x - steady).abs() * rate_hz > JITTER {
            let allowed = format!("{steady:.6} +- {JITTER} of a period (steady {rate_hz} Hz)");
            return Err(Error::bad(&table.file, run.place(table, i), x, allowed).into());
        }
    }
    Ok(rate_hz)
}

/// The samples, the first of which has this number: sample n is of the interval that ends at n / rate. What is before 1
/// belongs to no interval of the test, nor does what is behind `last`.
fn samples(t: &Telemetry, rate_hz: f64, first: i64, last: usize) -> Collector {
    let channels = ChannelSet::of(t.channels.iter().map(|(c, _)| *c));
    let skipped = usize::try_from(1 - first).unwrap_or(0).min(t.t_s.len());
    let room = usize::try_from(last as i64 + 1 - first.max(1)).unwrap_or(0);
    let rows = (t.t_s.len() - skipped).min(if last == usize::MAX { usize::MAX } else { room });
    let mut buffer = TelemetryBuffer::new(channels, rows.max(1));
    for (c, values) in &t.channels {
        let column = buffer.column_mut(*c).expect("made with these channels");
        column.extend_from_slice(&values[skipped..skipped + rows]);
    }
    buffer.first = first.max(1) as u64;
    buffer.set_rows(rows);
    let header = TelemetryHeader {
        run: t.run.unwrap_or_default(),
        actuator: String::new(),
        parameters: String::new(),
        sensors: String::new(),
        sequence: String::new(),
        rate_hz,
        channels,
        fault: None,
        rest_angle_rad: None,
    };
    let mut telemetry = Collector::default();
    // a collector takes all
    telemetry
        .accept(&header, &buffer.view())
        .expect("a collector in memory");
    telemetry
}

/// A table of which the command says how its clock stands.
struct Aligned {
    /// number of the first row
    first: i64,
    sequence: String,
    measured: Measured,
}

/// Step of the simulated controllers [s] (of the reference actuator, `ntb.md`): the command of a sample is that of the
/// last step of its interval.
const STEP_S: f64 = 1e-6;

/// Where the command's greatest change, or its first one, is that of a sequence, and the rest follows it too: where it
/// follows best.
fn aligned(t: &Telemetry, rate_hz: f64, sequences: &[TestSequence]) -> Option<Aligned> {
    let com = &t.channels.iter().find(|(c, _)| *c == Channel::Com)?.1;
    let recorded = marks(com)?;
    let mut found: Option<(f64, Aligned)> = None;
    for sequence in sequences {
        let rows = (sequence.duration_s() * rate_hz + 1e-6).floor() as usize;
        let track = CommandTrack::new(sequence, STEP_S);
        let mut command = vec![0.0; rows];
        for (i, c) in command.iter_mut().enumerate() {
            let steps = ((i + 1) as f64 / (rate_hz * STEP_S)).round() as u64;
            track.fill(steps.saturating_sub(1), std::slice::from_mut(c));
        }
        let Some(known) = marks(&command) else { continue };
        for (mark, here) in known.iter().zip(recorded) {
            for late in -2..=2 {
                // element i of the command is sample i + 1
                let first = *mark as i64 + 1 - here as i64 + late;
                let m = of(samples(t, rate_hz, first, rows), rate_hz);
                let n = m.telemetry.rows();
                if 2 * n < rows || !follows(&m, sequence) {
                    continue;
                }
                let com = m.telemetry.column(Channel::Com).expect("one of those needed");
                let of_sequence = &command[m.telemetry.first as usize - 1..];
                let apart = com.iter().zip(of_sequence).map(|(a, b)| (a - b).abs()).sum::<f64>() / n as f64;
                if found.as_ref().is_none_or(|(least, _)| apart < *least) {
                    let sequence = sequence.name.clone();
                    let aligned = Aligned {
                        first,
                        sequence,
                        measured: m,
                    };
                    found = Some((apart, aligned));
                }
            }
        }
    }
    found.map(|(_, aligned)| aligned)
}

/// Samples at which a command changes most, and at which it begins to change. `None` of one that does not.
fn marks(com: &[f64]) -> Option<[usize; 2]> {
    let change = |i: usize| (com[i] - com[i - 1]).abs();
    let steepest = (1..com.len()).max_by(|&a, &b| change(a).total_cmp(&change(b)).then(b.cmp(&a)))?;
    let least = 1e-9 * com.iter().fold(0.0, |m: f64, x| m.max(x.abs()));
    let begins = (0..com.len()).find(|&i| (com[i] - com[0]).abs() > least)?;
    Some([steepest, begins])
}
