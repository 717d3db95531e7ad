//! Runs of a bench: columns of files brought to SI at the motor, on an even clock, and looked at
//! for the usual mistakes before anything is fitted.

use super::bench::{Bench, BenchChannel, ChannelSpec, Noise, Role, RunSpec};
use super::table::Table;
use schemas::error::{Error, Result};
use std::collections::BTreeMap;
use std::path::PathBuf;

/// Fewest samples of a run.
const FEWEST: usize = 64;
/// Largest step of the clock over its median that is not a jump (assumed).
const JUMP: f64 = 1.5;

/// One run, SI at the motor.
#[derive(Clone, Debug)]
pub struct Run {
    /// file and what of it
    pub(crate) name: String,
    pub(crate) role: Role,
    pub(crate) rate_hz: f64,
    /// time of the first sample [s]
    pub(crate) start_s: f64,
    pub(crate) samples: usize,
    channels: BTreeMap<BenchChannel, Vec<f64>>,
    /// hash of the file
    pub(crate) hash: String,
    /// the columns of `split` and `where`, with their values
    pub(crate) labels: Vec<(String, String)>,
    /// a friction map: samples are means at one speed each
    pub(crate) steady: bool,
    /// scatter of the means at one speed
    pub(crate) spread: BTreeMap<BenchChannel, f64>,
}

impl Run {
    pub(crate) fn channel(&self, c: BenchChannel) -> Option<&[f64]> {
        self.channels.get(&c).map(Vec::as_slice)
    }

    pub(crate) fn duration_s(&self) -> f64 {
        self.samples as f64 / self.rate_hz
    }
}

/// Reads all runs of a bench; a file is read once.
///
/// # Errors
/// Refuses files that cannot be read, columns that are missing, values that are not finite, and clocks that
/// jump.
pub fn read_runs(bench: &Bench) -> Result<Vec<Run>> {
    let mut tables: BTreeMap<PathBuf, Table> = BTreeMap::new();
    let mut runs = Vec::new();
    for spec in &bench.runs {
        if !tables.contains_key(&spec.file) {
            tables.insert(spec.file.clone(), Table::read(&spec.file)?.with_q_current());
        }
        let table = &tables[&spec.file];
        if spec.steady {
            runs.push(friction_map(bench, spec, table)?);
            continue;
        }
        for (labels, rows) in split(table, spec)? {
            runs.push(run(bench, spec, table, labels, &rows)?);
        }
    }
    Ok(runs)
}

/// Pieces of a run at one speed.
pub(crate) const PIECES: usize = 10;

/// Runs at one speed each as one: the means of ten pieces of each, in the order of the speed.
fn friction_map(bench: &Bench, spec: &RunSpec, table: &Table) -> Result<Run> {
    let mut parts: Vec<(f64, Run)> = Vec::new();
    let velocity = |r: &Run| -> Option<f64> {
        let w = r.channel(BenchChannel::Velocity)?;
        Some(w.iter().sum::<f64>() / w.len() as f64)
    };
    for (labels, rows) in split(table, spec)? {
        let r = run(bench, spec, table, labels, &rows)?;
        let allowed = "a channel `velocity` in runs that stand at one speed";
        let w = velocity(&r).ok_or_else(|| Error::bad(&r.name, "channels", "no velocity", allowed))?;
        parts.push((w, r));
    }
    parts.sort_by(|a, b| a.0.total_cmp(&b.0));
    let Some((_, first)) = parts.first() else {
        return Err(Error::bad(&table.file, "run", "no rows", "at least one speed"));
    };
    let mut map = Run {
        name: format!(
            "{} ({} speeds)",
            spec.file.file_name().unwrap_or_default().to_string_lossy(),
            parts.len()
        ),
        rate_hz: 1.0,
        start_s: 0.0,
        samples: parts.len() * PIECES,
        channels: BTreeMap::new(),
        spread: BTreeMap::new(),
        steady: true,
        ..first.clone()
    };
    for c in first.channels.keys() {
        let mut means = Vec::new();
        let mut within = 0.0;
        for (_, r) in &parts {
            let x = &r.channels[c];
            let each: Vec<f64> = (0..PIECES)
                .map(|i| {
                    let piece = &x[i * x.len() / PIECES..(i + 1) * x.len() / PIECES];
                    piece.iter().sum::<f64>() / piece.len() as f64
                })
                .collect();
            let mean = each.iter().sum::<f64>() / PIECES as f64;
            within += each.iter().map(|m| (m - mean).powi(2)).sum::<f64>();
            means.extend(each);
        }
        map.spread
            .insert(*c, (within / (parts.len() * (PIECES - 1)) as f64).sqrt());
        map.channels.insert(*c, means);
    }
    Ok(map)
}

type Labels = Vec<(String, String)>;

/// Rows of each run that a `[[run]]` makes of its file.
fn split(table: &Table, spec: &RunSpec) -> Result<Vec<(Labels, Vec<usize>)>> {
    let mut rows: Vec<usize> = (0..table.rows).collect();
    for (column, values) in &spec.filter {
        let texts = table.texts(column)?;
        rows.retain(|&r| values.contains(&texts[r]));
        if rows.is_empty() {
            let found = format!("no row with {column} = {}", values.join(" or "));
            return Err(Error::bad(&table.file, "where", found, "a value that is there"));
        }
    }
    let single = |f: &&(String, Vec<String>)| f.1.len() == 1;
    let fixed: Labels = spec
        .filter
        .iter()
        .filter(single)
        .map(|(c, v)| (c.clone(), v[0].clone()))
        .collect();
    if spec.split.is_empty() {
        return Ok(vec![(fixed, rows)]);
    }
    let keys = spec.split.iter().map(|c| table.texts(c));
    let keys = keys.collect::<Result<Vec<_>>>()?;
    let mut groups: Vec<(Labels, Vec<usize>)> = Vec::new();
    for r in rows {
        let values = spec.split.iter().zip(&keys).map(|(c, k)| (c.clone(), k[r].clone()));
        let labels: Labels = fixed.iter().cloned().chain(values).collect();
        match groups.iter_mut().find(|(l, _)| *l == labels) {
            Some((_, rows)) => rows.push(r),
            None => groups.push((labels, vec![r])),
        }
    }
    Ok(groups)
}

fn run(bench: &Bench, spec: &RunSpec, table: &Table, labels: Labels, rows: &[usize]) -> Result<Run> {
    let bad = |place: String, found: String, allowed: &str| Error::bad(&table.file, place, found, allowed);
    let time_spec = bench.channel(BenchChannel::Time);
    let time_spec = time_spec.ok_or_else(|| bad("channels".into(), "no time".into(), "a channel `time`"))?;
    let column = table.numbers(&time_spec.column)?;
    let mut rows = rows.to_vec();
    if let Some((from, to)) = spec.window_s {
        rows.retain(|&r| {
            let t = column[r] * time_spec.factor;
            t >= from && t <= to
        });
    }
    let fewest = if bench.is_comparison() { 8 } else { FEWEST };
    if rows.len() < fewest {
        let found = format!("{} rows", rows.len());
        return Err(bad(
            "run".into(),
            found,
            &format!("at least {fewest} rows in the window"),
        ));
    }
    let time: Vec<f64> = rows.iter().map(|&r| column[r] * time_spec.factor).collect();
    let n = time.len();
    let clock = |k: usize| format!("column `{}`, row {}", time_spec.column, rows[k] + 1);
    if let Some(k) = time.iter().position(|t| !t.is_finite()) {
        return Err(bad(clock(k), time[k].to_string(), "a finite time"));
    }
    if let Some(k) = (1..n).find(|&k| time[k] <= time[k - 1]) {
        let found = format!("{} s after {} s", time[k], time[k - 1]);
        return Err(bad(
            clock(k),
            found,
            "rising times (the clock went back; several runs in one file? use `split`)",
        ));
    }
    let mut steps: Vec<f64> = time.windows(2).map(|w| w[1] - w[0]).collect();
    let order = n.saturating_sub(1) / 2;
    let median = *steps.select_nth_unstable_by(order, f64::total_cmp).1;
    if let Some(k) = (1..n).find(|&k| !spec.steady && time[k] - time[k - 1] > JUMP * median) {
        let found = format!(
            "a step of {:.6} s where {:.6} s is usual",
            time[k] - time[k - 1],
            median
        );
        return Err(bad(
            clock(k),
            found,
            "a steady clock (it jumped; cut the run with `window_s`)",
        ));
    }
    let step = (time[n - 1] - time[0]) / (n - 1) as f64;
    let even = time
        .iter()
        .enumerate()
        .all(|(k, t)| (t - time[0] - k as f64 * step).abs() < 0.02 * step);
    let mut channels = BTreeMap::new();
    for c in &bench.channels {
        if c.channel == BenchChannel::Time {
            continue;
        }
        let column = table.numbers(&c.column)?;
        let minus = c.minus.as_ref().map(|m| table.numbers(m)).transpose()?;
        let value = |r: usize| column[r] - minus.map_or(0.0, |m| m[r]);
        let x: Vec<f64> = rows.iter().map(|&r| value(r) * c.factor).collect();
        if let Some(k) = x.iter().position(|x| !x.is_finite()) {
            let place = format!("column `{}`, row {}", c.column, rows[k] + 1);
            return Err(bad(place, column[rows[k]].to_string(), "a finite number"));
        }
        let x = if even { x } else { evened(&time, &x, step) };
        channels.insert(c.channel, x);
    }
    let label: Vec<String> = labels.iter().map(|(k, v)| format!("{k} {v}")).collect();
    let stem = spec
        .file
        .file_name()
        .map(|f| f.to_string_lossy().into_owned())
        .unwrap_or_default();
    let mut name = stem;
    if !label.is_empty() {
        name = format!("{name} ({})", label.join(", "));
    }
    if let Some((from, to)) = spec.window_s {
        name = format!("{name} [{from} to {to} s]");
    }
    Ok(Run {
        name,
        role: spec.role,
        rate_hz: 1.0 / step,
        start_s: time[0],
        samples: n,
        channels,
        hash: table.hash.clone(),
        labels,
        steady: false,
        spread: BTreeMap::new(),
    })
}

/// Values at even times, straight between the samples.
fn evened(time: &[f64], x: &[f64], step: f64) -> Vec<f64> {
    let mut at = 0;
    (0..time.len())
        .map(|k| {
            let t = time[0] + k as f64 * step;
            while at + 2 < time.len() && time[at + 1] < t {
                at += 1;
            }
            let share = ((t - time[at]) / (time[at + 1] - time[at])).clamp(0.0, 1.0);
            x[at] + share * (x[at + 1] - x[at])
        })
        .collect()
}

/// Noise of a channel.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct ChannelNoise {
    /// of one sample, SI at the motor
    pub rms: f64,
    /// correlation from sample to sample (first-order, 0 = white)
    pub colour: f64,
}

/// Noise of a channel, resolution included; SI at the motor.
pub(crate) fn noise(spec: &ChannelSpec, runs: &[Run]) -> ChannelNoise {
    let spreads: Vec<f64> = runs
        .iter()
        .filter_map(|r| r.spread.get(&spec.channel))
        .copied()
        .collect();
    if !spreads.is_empty() {
        let mean = spreads.iter().map(|s| s * s).sum::<f64>() / spreads.len() as f64;
        return ChannelNoise {
            rms: mean.sqrt(),
            colour: 0.0,
        };
    }
    let grain = spec.resolution / 12f64.sqrt();
    let white = match spec.noise {
        Noise::Known(x) => x,
        Noise::Repeats => from_repeats(spec.channel, runs).unwrap_or_else(|| estimated(spec.channel, runs)),
        Noise::Estimated => {
            return ChannelNoise {
                rms: estimated(spec.channel, runs),
                colour: 0.0,
            };
        }
    };
    let colour = if white > 2.0 * grain {
        colour(spec.channel, white, runs)
    } else {
        0.0
    };
    ChannelNoise {
        rms: white.hypot(grain),
        colour,
    }
}

/// Correlation from sample to sample of the noise of a channel whose rms is known: from the energy
/// of its fourth differences, in which a smooth signal leaves little. Stretches in which they are
/// large hold signal, so the quieter ones count.
fn colour(channel: BenchChannel, rms: f64, runs: &[Run]) -> f64 {
    let mut blocks: Vec<f64> = Vec::new();
    for x in runs.iter().filter_map(|r| r.channel(channel)) {
        let d: Vec<f64> = x
            .windows(5)
            .map(|w| w[0] - 4.0 * w[1] + 6.0 * w[2] - 4.0 * w[3] + w[4])
            .collect();
        blocks.extend(
            d.chunks_exact(128)
                .map(|b| b.iter().map(|x| x * x).sum::<f64>() / 128.0),
        );
    }
    if blocks.is_empty() {
        return 0.0;
    }
    blocks.sort_by(f64::total_cmp);
    let energy = blocks[blocks.len() / 3] / (rms * rms);
    // of noise of rms 1: 70 + 2 (-56 r + 28 r^2 - 8 r^3 + r^4)
    let expected = |r: f64| 70.0 + 2.0 * (-56.0 * r + 28.0 * r * r - 8.0 * r.powi(3) + r.powi(4));
    if energy > 0.9 * expected(0.0) {
        return 0.0;
    }
    let (mut low, mut high) = (0.0, 0.99);
    for _ in 0..40 {
        let middle = 0.5 * (low + high);
        if expected(middle) > energy {
            low = middle
        } else {
            high = middle
        }
    }
    0.5 * (low + high)
}

/// From the fourth differences, in which a smooth signal leaves little: their median square, so that
/// jumps do not count.
fn estimated(channel: BenchChannel, runs: &[Run]) -> f64 {
    let mut all: Vec<f64> = Vec::new();
    for x in runs.iter().filter_map(|r| r.channel(channel)) {
        all.extend(
            x.windows(5)
                .map(|w| (w[0] - 4.0 * w[1] + 6.0 * w[2] - 4.0 * w[3] + w[4]).abs()),
        );
    }
    if all.is_empty() {
        return 0.0;
    }
    let middle = all.len() / 2;
    let median = *all.select_nth_unstable_by(middle, f64::total_cmp).1;
    let values = runs.iter().filter_map(|r| r.channel(channel)).flatten();
    let (low, high) = values.fold((f64::MAX, f64::MIN), |(a, b), x| (a.min(*x), b.max(*x)));
    // no sensor is better than a millionth of its range
    (median / 0.6745 / 70f64.sqrt()).max(1e-6 * (high - low))
}

/// Half the variance of the difference of runs that were meant to be alike.
fn from_repeats(channel: BenchChannel, runs: &[Run]) -> Option<f64> {
    let repeats: Vec<&[f64]> = runs
        .iter()
        .filter(|r| r.role == Role::Repeat)
        .filter_map(|r| r.channel(channel))
        .collect();
    let (first, others) = repeats.split_first()?;
    let mut sum = 0.0;
    let mut count = 0;
    for other in others {
        let n = first.len().min(other.len());
        let mean = (0..n).map(|k| first[k] - other[k]).sum::<f64>() / n as f64;
        sum += (0..n).map(|k| (first[k] - other[k] - mean).powi(2)).sum::<f64>();
        count += n;
    }
    (count > 0).then(|| (0.5 * sum / count as f64).sqrt())
}
