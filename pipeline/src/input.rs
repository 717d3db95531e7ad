//! Telemetry from outside: the project's Parquet, plain tables in CSV or Parquet, a run of a dataset, checked row by row.

mod plain;

use crate::dataset::Dataset;
use crate::dataset::export::KeptRun;
use anyhow::{Result, bail};
use ema_study::measured::check::cause;
use ema_tables::{ChannelMap, Table};
use schemas::channel::Channel;
use schemas::error::Error;
use schemas::recording::Provenance;
use schemas::sequence::TestSequence;
use schemas::telemetry::{Collector, TelemetryHeader, TelemetrySink};
use sim_worker::command::CommandTrack;
use sim_worker::sensor::SensorModel;
use sim_worker::setup::TestSetup;
use std::io::Read;
use std::ops::RangeInclusive;
use std::path::Path;

/// One recorded run in memory, and what the file says of itself.
pub struct Measured {
    /// its samples, channels in SI units
    pub telemetry: Collector,
    /// of the samples
    pub rate_hz: f64,
    /// empty where the file does not say
    pub parameters: String,
    /// name; empty where the file does not say
    pub sequence: String,
    /// empty where the file does not say
    pub sequence_fingerprint: String,
    /// fingerprint of the sensor model, or `none`; empty where the file does not say
    pub sensors: String,
    /// constant load of a simulated run [N m, motor side]
    pub load_n_m: Option<f64>,
    /// all of the test, where the recording is a run of a dataset
    pub setup: Option<TestSetup>,
    /// what was brought to our names and units, derived or aligned, in words
    pub said: Vec<String>,
}

/// How to read a recording.
#[derive(Clone, Copy, Debug, Default)]
pub struct How<'a> {
    /// one of several runs
    pub run: Option<u64>,
    /// columns that are not called as ours
    pub channels: Option<&'a ChannelMap>,
    /// name or file of the sequence that was commanded; all that are built in where it is not said
    pub sequence: Option<&'a str>,
}

impl How<'_> {
    fn sequences(&self) -> Result<Vec<TestSequence>> {
        let all = || {
            sim_worker::catalogue::sequence_names()
                .map(sim_worker::catalogue::sequence)
                .collect()
        };
        let sequences: schemas::error::Result<_> = self
            .sequence
            .map_or_else(all, |name| sim_worker::catalogue::sequence(name).map(|s| vec![s]));
        Ok(sequences?)
    }
}

/// A dataset, rather than a file: a folder, or a URL.
pub(crate) fn is_dataset(path: &Path) -> bool {
    path.is_dir() || path.to_str().is_some_and(|t| t.contains("://"))
}

/// The runs of a file: their numbers, or `None` for the one of a table without a column `run`.
pub(crate) fn runs(path: &Path) -> Result<Vec<Option<u64>>> {
    #[derive(Default)]
    struct Numbers(Vec<Option<u64>>);
    impl TelemetrySink for Numbers {
        fn accept(
            &mut self,
            header: &TelemetryHeader,
            _: &schemas::telemetry::TelemetryView<'_>,
        ) -> schemas::error::Result<()> {
            if self.0.last() != Some(&Some(header.run)) {
                self.0.push(Some(header.run));
            }
            Ok(())
        }
    }
    if is_dataset(path) {
        let d = Dataset::open(&path.display().to_string())?;
        let kept = d
            .plan
            .parts()
            .into_iter()
            .filter(|p| p.telemetry)
            .flat_map(|p| p.runs.clone());
        return Ok(kept.map(Some).collect());
    }
    if !is_ours(path)? {
        let runs = Table::read(path)?.runs()?;
        return Ok(runs.map_or(vec![None], |r| r.into_iter().map(Some).collect()));
    }
    let mut numbers = Numbers::default();
    schemas::recording::Recording::open(path)?.replay(65_536, &mut numbers)?;
    if numbers.0.is_empty() {
        return Err(Error::bad(path.display().to_string(), "file", "no rows", "at least one run").into());
    }
    Ok(numbers.0)
}

/// Whether a file is telemetry of this project: Parquet that says what made it.
fn is_ours(path: &Path) -> Result<bool> {
    let mut magic = [0; 4];
    let mut file = std::fs::File::open(path).map_err(|e| Error::io(path, "cannot be read", e))?;
    let n = file
        .read(&mut magic)
        .map_err(|e| Error::io(path, "cannot be read", e))?;
    if n == 0 {
        return Err(Error::torn(path, "empty file (0 bytes); allowed: a Parquet or CSV telemetry file").into());
    }
    let is_parquet = &magic == b"PAR1" || path.extension().is_some_and(|e| e == "parquet");
    // another program's says nothing of the kind
    Ok(is_parquet && schemas::table::metadata(path)?.contains_key("ema.schema_version"))
}

/// Opens a file, a measured table in any dialect, or a run of a dataset.
///
/// # Errors
/// Refuses a file or dataset that cannot be read, several runs without a choice, missing columns, an unsteady
/// time base and numbers that are not finite.
pub fn open(path: &Path, how: How<'_>) -> Result<Measured> {
    let m = if is_dataset(path) {
        open_dataset(path, how.run)?
    } else if is_ours(path)? {
        open_parquet(path, how.run)?
    } else {
        let table = Table::read(path)?;
        plain::measured(&table, table.telemetry(how.run, how.channels)?, &how.sequences()?)?
    };
    check(path, &m)?;
    if let Some(map) = how.channels {
        check_motion(path, &m, map)?;
    }
    Ok(m)
}

/// Ratios of the speed to the change of the angle that pass: sensors differ by a per cent, units and pole pairs by a
/// factor (assumed).
const SAME_MOTION: RangeInclusive<f64> = 0.8..=1.25;
/// Travel over what the noise of the speed adds up to, and least travel [rad], that are enough to tell (assumed).
const TRAVEL_OVER_NOISE: f64 = 20.0;
const LEAST_TRAVEL_RAD: f64 = 0.5;

/// Whether the speed is that of the angle. Compared as angles: what is added up has little noise.
fn check_motion(path: &Path, m: &Measured, map: &ChannelMap) -> Result<()> {
    let column = |c| m.telemetry.column(c).expect("checked when opened");
    let (angle, speed) = (column(Channel::ThetaM), column(Channel::OmegaM));
    let n = angle.len() as f64;
    let mut sum = 0.0;
    let mut added = vec![0.0; angle.len()];
    let mut noise = 0.0;
    for k in 1..angle.len() {
        sum += 0.5 * (speed[k - 1] + speed[k]) / m.rate_hz;
        added[k] = sum;
        noise += 0.5 * (speed[k] - speed[k - 1]).powi(2);
    }
    let mean = |x: &[f64]| x.iter().sum::<f64>() / n;
    let (of_angle, of_sum) = (mean(angle), mean(&added));
    let (mut xx, mut xy) = (0.0, 0.0);
    for (x, y) in angle.iter().zip(&added) {
        xx += (x - of_angle).powi(2);
        xy += (x - of_angle) * (y - of_sum);
    }
    // the noise of n samples adds up to sqrt(n) times that of one
    let (travel, walk) = ((xx / n).sqrt(), noise.sqrt() / m.rate_hz);
    let ratio = xy / xx;
    if travel < LEAST_TRAVEL_RAD.max(TRAVEL_OVER_NOISE * walk) || SAME_MOTION.contains(&ratio) {
        return Ok(());
    }
    let of = |c: Channel| map.column(c).unwrap_or(c.name()).to_string();
    let place = format!("columns `{}`, `{}`", of(Channel::OmegaM), of(Channel::ThetaM));
    let size = ratio.abs();
    let pairs = (2..=8)
        .map(f64::from)
        .find(|p| [size, 1.0 / size].iter().any(|x| (x / p - 1.0).abs() < 0.03));
    let cause = match pairs {
        _ if ratio < 0.0 && SAME_MOTION.contains(&size) => "reversed sign".to_string(),
        Some(p) => format!("a factor of {p}: pole pairs, electrical for mechanical"),
        None => cause(size, 1.0),
    };
    let found = format!("{ratio:.4} times the speed of the angle (likely cause: {cause}; unit or scale in --channels)");
    let allowed = format!("{} to {} times", SAME_MOTION.start(), SAME_MOTION.end());
    Err(Error::bad(path.display().to_string(), place, found, allowed).into())
}

struct OneRun {
    wanted: Option<u64>,
    seen: Vec<u64>,
    collector: Collector,
}

impl TelemetrySink for OneRun {
    fn accept(
        &mut self,
        header: &TelemetryHeader,
        view: &schemas::telemetry::TelemetryView<'_>,
    ) -> schemas::error::Result<()> {
        if self.seen.last() != Some(&header.run) {
            self.seen.push(header.run);
        }
        if self.wanted.is_none_or(|w| w == header.run) && (self.wanted.is_some() || self.seen.len() == 1) {
            self.collector.accept(header, view)?;
        }
        Ok(())
    }
}

fn open_dataset(path: &Path, run: Option<u64>) -> Result<Measured> {
    let d = Dataset::open(&path.display().to_string())?;
    let kept = KeptRun::open(&d, run)?;
    let mut telemetry = Collector::default();
    kept.replay(&mut telemetry)?;
    Ok(Measured::of(telemetry, kept.provenance.clone(), Some(kept.setup())))
}

impl Measured {
    /// Whether it is of a machine, as far as the file says: not of this project's simulation.
    pub fn is_foreign(&self) -> bool {
        self.setup.is_none() && self.load_n_m.is_none()
    }

    /// What a file says of itself, and its samples.
    fn of(telemetry: Collector, p: Provenance, setup: Option<TestSetup>) -> Self {
        Self {
            telemetry,
            rate_hz: p.rate_hz,
            parameters: p.parameters,
            sequence: p.sequence,
            sequence_fingerprint: p.sequence_fingerprint,
            sensors: p.sensors,
            load_n_m: (p.model != "measured").then_some(p.load_n_m),
            setup,
            said: Vec::new(),
        }
    }
}

fn open_parquet(path: &Path, run: Option<u64>) -> Result<Measured> {
    let r = schemas::recording::Recording::open(path)?;
    let mut one = OneRun {
        wanted: run,
        seen: Vec::new(),
        collector: Collector::default(),
    };
    r.replay(8192, &mut one)?;
    let file = path.display().to_string();
    if run.is_none() && one.seen.len() > 1 {
        let found = format!("{} runs", one.seen.len());
        return Err(Error::bad(file, "file", found, "one run, or --run NUMBER to choose one").into());
    }
    if one.collector.rows() == 0 {
        let found = run.map_or("no rows".to_string(), |r| format!("no run {r}"));
        return Err(Error::bad(file, "file", found, format!("one of the runs {:?}", one.seen)).into());
    }
    Ok(Measured::of(one.collector, r.provenance, None))
}

fn check(path: &Path, m: &Measured) -> Result<()> {
    let file = path.display().to_string();
    let needed = [Channel::Com, Channel::ThetaM, Channel::OmegaM, Channel::IEq];
    if let Some(c) = needed.iter().find(|c| m.telemetry.column(**c).is_none()) {
        let allowed = format!("a column `{}`", c.name());
        return Err(Error::bad(file, "columns", "nothing", allowed).into());
    }
    // one rule for all that is there
    for &c in Channel::ALL {
        let values = m.telemetry.column(c).unwrap_or_default();
        if let Some(i) = values.iter().position(|v| !v.is_finite()) {
            let place = format!("row {}, column `{}`", i + 1, c.name());
            return Err(Error::bad(file, place, values[i], "a finite number").into());
        }
    }
    Ok(())
}

/// Share of the recording's samples whose command is that of `sequence`, and how many lie within it.
fn agreement(m: &Measured, sequence: &TestSequence, step_s: f64) -> (f64, usize) {
    let com = m.telemetry.column(Channel::Com).expect("checked when opened");
    let rows = (sequence.duration_s() * m.rate_hz + 1e-6).floor() as usize;
    let first = m.telemetry.first as usize;
    let n = com.len().min((rows + 1).saturating_sub(first));
    let track = CommandTrack::new(sequence, step_s);
    let steps = |row: usize| (row as f64 / (m.rate_hz * step_s)).round() as u64;
    let at = |row: usize| {
        let mut c = [0.0];
        track.fill(steps(row).saturating_sub(1), &mut c);
        c[0]
    };
    let mut good = 0;
    for (i, &c) in com[..n].iter().enumerate() {
        let row = first + i;
        let (before, now, after) = (at(row.saturating_sub(1).max(1)), at(row), at(row + 1));
        // a sample early or late, and a part in a thousand
        let slack = 1e-3 * now.abs() + 1e-9;
        if c >= before.min(now).min(after) - slack && c <= before.max(now).max(after) + slack {
            good += 1;
        }
    }
    (good as f64 / com.len() as f64, n)
}

/// Share of a recording's samples whose command is the sequence's, of one that follows it.
const ENOUGH: f64 = 0.98;

/// Whether the recording's command is that of the sequence.
fn follows(m: &Measured, sequence: &TestSequence) -> bool {
    agreement(m, sequence, 1.0 / m.rate_hz).0 >= ENOUGH
}

/// The sequence that the recording's command follows.
///
/// # Errors
/// Refuses a command that the sequence wanted, or any known one, does not follow in 98 % of the samples.
pub fn recognise(path: &Path, m: &Measured, wanted: Option<&str>, step_s: f64) -> Result<TestSequence> {
    let by_name = wanted.or((!m.sequence.is_empty()).then_some(m.sequence.as_str()));
    if let Some(name) = by_name {
        if let Ok(s) = sim_worker::catalogue::sequence(name) {
            if wanted.is_none() && m.sequence_fingerprint != s.fingerprint() {
                let (found, allowed) = (&m.sequence_fingerprint, s.fingerprint());
                let place = format!("fingerprint of sequence `{name}`");
                let allowed = format!("{allowed}, or --sequence FILE.toml of the recording");
                return Err(Error::bad(path.display().to_string(), place, found, allowed).into());
            }
            let (share, _) = agreement(m, &s, step_s);
            if share < ENOUGH {
                let found = format!("a command of which {:.0} % follow `{name}`", 100.0 * share);
                let allowed = format!("sequence `{name}` in at least {:.0} % of the samples", 100.0 * ENOUGH);
                return Err(Error::bad(path.display().to_string(), "column `com`", found, allowed).into());
            }
            return Ok(s);
        }
        if wanted.is_some() {
            sim_worker::catalogue::sequence(name)?;
        }
    }
    let mut best: Option<(f64, TestSequence)> = None;
    for name in sim_worker::catalogue::sequence_names() {
        let s = sim_worker::catalogue::sequence(name)?;
        let (share, _) = agreement(m, &s, step_s);
        if best.as_ref().is_none_or(|(b, _)| share > *b) {
            best = Some((share, s));
        }
    }
    match best {
        Some((share, s)) if share >= ENOUGH => Ok(s),
        Some((share, s)) => {
            let found = format!(
                "a command that no known sequence follows (nearest `{}`, {:.0} %)",
                s.name,
                100.0 * share
            );
            let names: Vec<&str> = sim_worker::catalogue::sequence_names().collect();
            let allowed = format!("{} or --sequence FILE.toml", names.join(", "));
            Err(Error::bad(path.display().to_string(), "column `com`", found, allowed).into())
        }
        None => bail!("no sequences are built in"),
    }
}

/// Whether the recording looks quantised as `model` would have it: motor positions on the
/// resolver's counts.
pub(crate) fn is_quantised(m: &Measured, model: &SensorModel) -> bool {
    let theta = m.telemetry.column(Channel::ThetaM).expect("checked when opened");
    let lsb = model.resolver_count_rad();
    // beyond 20 rad a single-precision file no longer resolves a twentieth of a count
    let near: Vec<f64> = theta.iter().copied().filter(|x| *x != 0.0 && x.abs() < 20.0).collect();
    let on = near
        .iter()
        .filter(|x| ((*x / lsb) - (*x / lsb).round()).abs() < 0.05)
        .count();
    !near.is_empty() && on as f64 >= 0.99 * near.len() as f64
}
