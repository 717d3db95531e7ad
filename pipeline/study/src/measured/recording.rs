//! Runs of a bench: columns of files brought to SI at the motor, on an even clock, and looked at
//! for the usual mistakes before anything is fitted.

use crate::measured::bench::{Bench, BenchChannel, Noise, Role, RunSpec};
use crate::measured::own::with_q_current;
use crate::measured::rows::{Labels, column, in_si, split};
use ema_tables::Table;
use schemas::error::{Error, Result};
use std::collections::BTreeMap;
use std::ops::{Add, Div, Mul};
use std::path::PathBuf;

/// Fewest samples of a run.
const FEWEST: usize = 64;
/// Largest step of the clock over its median that is not a gap (assumed).
const JUMP: f64 = 4.0;
/// Relative difference of two clocks that are brought to one.
const SAME_CLOCK: f64 = 0.02;
/// Largest share of a run that may lie in gaps of its clock (assumed).
const MOST_MISSING: f64 = 0.5;

/// Samples of all runs together beyond which neighbours are taken together, and the least rate that leaves [Hz]
/// (assumed: what is looked for is slower).
const MOST_SAMPLES: f64 = 60_000.0;
const LEAST_RATE_HZ: f64 = 1_000.0;
/// Rate that is never needed [Hz] (assumed).
const ENOUGH_HZ: f64 = 2_600.0;

/// Means of so many samples for one, in all channels of all runs; the bench is told that they are means, of less
/// noise.
pub fn taken_together(bench: &mut Bench, runs: &mut [Run]) {
    let moving = || runs.iter().filter(|r| !r.steady);
    let (samples, rate) = (
        moving().map(|r| r.samples).sum::<usize>(),
        moving().map(|r| r.rate_hz).fold(0.0, f64::max),
    );
    let by_count = (samples as f64 / MOST_SAMPLES).min(rate / LEAST_RATE_HZ);
    let m = by_count.max(rate / ENOUGH_HZ).floor() as usize;
    if m < 2 || bench.is_comparison() {
        return;
    }
    for r in runs.iter_mut().filter(|r| !r.steady) {
        r.samples /= m;
        for x in r.channels.values_mut().chain(&mut r.law_speed) {
            *x = x.chunks_exact(m).map(|c| c.iter().sum::<f64>() / m as f64).collect();
        }
        r.lost = r.lost.chunks_exact(m).map(|c| c.iter().any(|l| *l)).collect();
        r.start_s += (m - 1) as f64 / r.rate_hz;
        r.rate_hz /= m as f64;
    }
    let channels = bench.channels.iter_mut().chain(&mut bench.law_speed);
    for c in channels.filter(|c| c.channel != BenchChannel::Time) {
        if !c.mean {
            // the mean of points that end at the stamp, as a mean over the sample: half a point early
            c.delay_s -= 0.5 / rate;
        }
        c.mean = true;
        let share = 1.0 / (m as f64).sqrt();
        c.resolution *= share;
        if let Noise::Known(x) = &mut c.noise {
            *x *= share;
        }
    }
}

/// One run, SI at the motor.
#[derive(Clone, Debug)]
pub struct Run {
    /// file and what of it
    pub name: String,
    pub role: Role,
    pub rate_hz: f64,
    /// time of the first sample [s]
    pub start_s: f64,
    pub samples: usize,
    pub(super) channels: BTreeMap<BenchChannel, Vec<f64>>,
    /// hash of the file
    pub hash: String,
    /// of the file, from 0, rising
    pub rows: Vec<usize>,
    /// the columns of `split` and `where`, with their values
    pub labels: Vec<(String, String)>,
    /// samples that lie in a gap of the clock; empty where there is none
    pub lost: Vec<bool>,
    /// of an uneven clock, whose channels were brought to even times: least and greatest step [s], gaps
    pub clock: Option<(f64, f64, usize)>,
    /// the author says that the machine was healthy
    pub healthy: bool,
    /// a friction map: samples are means at one speed each
    pub steady: bool,
    /// scatter of the means at one speed
    pub spread: BTreeMap<BenchChannel, f64>,
    /// the speed that a known controller acts on, where it is no sensor's
    pub law_speed: Option<Vec<f64>>,
}

impl Run {
    pub fn channel(&self, c: BenchChannel) -> Option<&[f64]> {
        self.channels.get(&c).map(Vec::as_slice)
    }

    pub(super) fn leave_out(&mut self, c: BenchChannel) -> Option<Vec<f64>> {
        self.channels.remove(&c)
    }

    pub(super) fn put(&mut self, c: BenchChannel, x: Vec<f64>) {
        self.channels.insert(c, x);
    }

    pub fn duration_s(&self) -> f64 {
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
            tables.insert(spec.file.clone(), with_q_current(Table::filled(&spec.file)?));
        }
        let table = &tables[&spec.file];
        if spec.steady {
            runs.push(friction_map(bench, spec, table)?);
            continue;
        }
        for (labels, rows) in split(table, spec)? {
            let step = runs.first().map(|r: &Run| 1.0 / r.rate_hz);
            runs.push(run(bench, spec, table, labels, &rows, step)?);
        }
    }
    Ok(without_offsets(runs))
}

/// Takes what the sensors of current and voltage show while the drive is disabled out of all runs, which then do
/// without the run that says so.
fn without_offsets(mut runs: Vec<Run>) -> Vec<Run> {
    use BenchChannel as C;
    let channels = [C::Current, C::Voltage, C::Torque, C::Force];
    for c in channels.into_iter().chain(C::CURRENTS).chain(C::VOLTAGES) {
        let off: Vec<f64> = runs
            .iter()
            .filter(|r| r.role == Role::Off)
            .filter_map(|r| r.channel(c))
            .flatten()
            .copied()
            .collect();
        if off.is_empty() {
            continue;
        }
        let mean = off.iter().sum::<f64>() / off.len() as f64;
        for r in runs.iter_mut().filter(|r| r.role != Role::Off) {
            if let Some(x) = r.channels.get_mut(&c) {
                x.iter_mut().for_each(|x| *x -= mean);
            }
        }
    }
    runs.retain(|r| r.role != Role::Off);
    runs
}

/// Pieces of a run at one speed.
pub const PIECES: usize = 10;

/// Runs at one speed each as one: the means of ten pieces of each, in the order of the speed.
fn friction_map(bench: &Bench, spec: &RunSpec, table: &Table) -> Result<Run> {
    let mut parts: Vec<(f64, Run)> = Vec::new();
    let velocity = |r: &Run| -> Option<f64> {
        let w = r.channel(BenchChannel::Velocity)?;
        Some(w.iter().sum::<f64>() / w.len() as f64)
    };
    for (labels, rows) in split(table, spec)? {
        let r = run(bench, spec, table, labels, &rows, None)?;
        let allowed = "a channel `velocity` in runs that stand at one speed";
        let w = velocity(&r).ok_or_else(|| Error::bad(&r.name, "channels", "no velocity", allowed))?;
        parts.push((w, r));
    }
    parts.sort_by(|a, b| a.0.total_cmp(&b.0));
    let Some((_, first)) = parts.first() else {
        return Err(Error::bad(&table.file, "run", "no rows", "at least one speed"));
    };
    let mut rows: Vec<usize> = parts.iter().flat_map(|p| p.1.rows.iter().copied()).collect();
    rows.sort_unstable();
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
        law_speed: None,
        steady: true,
        rows,
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

/// * `usual` step of the runs before, which this one shares if it is nearly so [s]
fn run(
    bench: &Bench,
    spec: &RunSpec,
    table: &Table,
    labels: Labels,
    rows: &[usize],
    usual: Option<f64>,
) -> Result<Run> {
    let bad = |place: String, found: String, allowed: &str| Error::bad(&table.file, place, found, allowed);
    let time_spec = bench.channel(BenchChannel::Time);
    let time_spec = time_spec.ok_or_else(|| bad("channels".into(), "no time".into(), "a channel `time`"))?;
    let (column, to_s) = column(table, time_spec, &time_spec.column)?;
    let mut rows = rows.to_vec();
    rows.retain(|&r| spec.has(column[r] * to_s));
    let fewest = if bench.is_comparison() { 8 } else { FEWEST };
    if rows.len() < fewest {
        let found = format!("{} rows", rows.len());
        return Err(bad(
            "run".into(),
            found,
            &format!("at least {fewest} rows in the window"),
        ));
    }
    let time: Vec<f64> = rows.iter().map(|&r| column[r] * to_s).collect();
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
    let jumps: Vec<usize> = (1..n)
        .filter(|&k| !spec.steady && time[k] - time[k - 1] > JUMP * median)
        .collect();
    let missing: f64 = jumps.iter().map(|&k| time[k] - time[k - 1] - median).sum();
    let span = time[n - 1] - time[0];
    if missing > MOST_MISSING * span {
        let found = format!(
            "gaps that add up to {missing:.3} s of {span:.3} s, the first of {:.6} s where {median:.6} s is usual",
            time[jumps[0]] - time[jumps[0] - 1]
        );
        let allowed = "a clock that runs most of the time (cut the run with `window_s`)";
        return Err(bad(clock(jumps[0]), found, allowed));
    }
    // a clock that never stops gives the mean, one with gaps the usual step
    let step = if jumps.is_empty() {
        span / (n - 1) as f64
    } else {
        median
    };
    // filters are made for one clock
    let step = usual.filter(|u| (step / u - 1.0).abs() < SAME_CLOCK).unwrap_or(step);
    let even = jumps.is_empty()
        && time
            .iter()
            .enumerate()
            .all(|(k, t)| (t - time[0] - k as f64 * step).abs() < 0.02 * step);
    let count = if even { n } else { (span / step).floor() as usize + 1 };
    let at = |k: usize| time[0] + k as f64 * step;
    let mut lost = Vec::new();
    if !jumps.is_empty() {
        lost = vec![false; count];
        for &k in &jumps {
            let index = |t: f64| (t - time[0]) / step;
            let (from, to) = (index(time[k - 1]).floor() as usize, index(time[k]).ceil() as usize + 1);
            lost[from.min(count)..to.min(count)].fill(true);
        }
    }
    let mut channels = BTreeMap::new();
    for c in &bench.channels {
        let made = c.channel == BenchChannel::Current && bench.has_phases();
        if c.channel == BenchChannel::Time || made {
            continue;
        }
        let x = in_si(table, c, &rows)?;
        if let Some(k) = x.iter().position(|x| !x.is_finite()) {
            let place = format!("column `{}`, row {}", c.column, rows[k] + 1);
            let found = table.numbers(&c.column)?[rows[k]];
            return Err(bad(place, found.to_string(), "a finite number"));
        }
        let x = match (even, c.mean) {
            (true, _) => x,
            (false, false) => resampled(&time, &x, count, at),
            // the sum over time is smooth; its differences are means again
            (false, true) => {
                let mut sum = 0.0;
                let sums: Vec<f64> = (0..n)
                    .map(|k| {
                        sum += x[k]
                            * if k == 0 {
                                step
                            } else {
                                (time[k] - time[k - 1]).min(JUMP * median)
                            };
                        sum
                    })
                    .collect();
                let sums = resampled(&time, &sums, count, at);
                (0..count)
                    .map(|k| if k == 0 { x[0] } else { (sums[k] - sums[k - 1]) / step })
                    .collect()
            }
        };
        channels.insert(c.channel, x);
    }
    if bench.has_phases() && bench.rig.drive == BenchChannel::Current {
        let Some(theta) = channels.get(&BenchChannel::Position) else {
            let allowed = "a channel `position`, the angle that the phases are fed by";
            return Err(bad(
                "channels".into(),
                "phase currents without an angle".into(),
                allowed,
            ));
        };
        let ends = |k: usize| (theta[k.saturating_sub(1)], theta[k]);
        let mut iq = vec![0.0; count];
        for (q, c) in BenchChannel::CURRENTS.iter().enumerate() {
            let i = &channels[c];
            for k in 0..count {
                iq[k] += 0.5 * i[k] * over_support(bench.rig.pole_pairs, q, ends(k), |_, trap| trap);
            }
        }
        channels.insert(BenchChannel::Current, iq);
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
        samples: count,
        lost,
        clock: (!even).then(|| {
            let longest = time.windows(2).map(|w| w[1] - w[0]).fold(0.0, f64::max);
            let shortest = time.windows(2).map(|w| w[1] - w[0]).fold(f64::MAX, f64::min);
            (shortest, longest, jumps.len())
        }),
        healthy: spec.healthy,
        channels,
        hash: table.hash.clone(),
        rows,
        labels,
        steady: false,
        spread: BTreeMap::new(),
        law_speed: None,
    })
}

/// Shape of the back-EMF above which a phase conducts: it is +-1 from 30 to 150 degrees.
const CONDUCTS: f64 = 1.0 - 1e-12;

/// Points of an angle's way over a sample.
const WAY: usize = 12;

/// What a mean is taken of.
pub trait Mean: Copy + Add<Output = Self> + Mul<f64, Output = Self> + Div<f64, Output = Self> {}
impl<T: Copy + Add<Output = T> + Mul<f64, Output = T> + Div<f64, Output = T>> Mean for T {}

/// Angles on the way from one to another, those of [`over_support`].
pub fn on_way((from, to): (f64, f64)) -> [f64; WAY] {
    std::array::from_fn(|j| from + (to - from) * (j as f64 + 0.5) / WAY as f64)
}

/// Mean of `f(number of the angle on its way, shape of the back-EMF)` of a phase over that part of the way from one angle to the
/// other in which the phase conducts, over all of it if it does nowhere: a current is where it conducts.
pub fn over_support<T: Mean>(pole_pairs: f64, q: usize, way: (f64, f64), f: impl Fn(usize, f64) -> T) -> T {
    let trap = |theta: f64| sim_worker::effect::shape(pole_pairs * theta - std::f64::consts::TAU / 3.0 * q as f64);
    let traps = on_way(way).map(trap);
    let mean = |of: &dyn Fn(f64) -> bool| {
        let there = (0..WAY).filter(|j| of(traps[*j]));
        let count = there.clone().count() as f64;
        Some(there.map(|j| f(j, traps[j])).reduce(T::add)? / count)
    };
    let conducts = |trap: f64| trap.abs() > CONDUCTS;
    mean(&conducts).or_else(|| mean(&|_| true)).expect("a way has points")
}

/// Values at other times: a cubic through four samples (Lagrange), straight where a gap is near.
fn resampled(time: &[f64], x: &[f64], count: usize, at: impl Fn(usize) -> f64) -> Vec<f64> {
    let n = time.len();
    let mut i = 0;
    (0..count)
        .map(|k| {
            let t = at(k);
            while i + 2 < n && time[i + 1] < t {
                i += 1;
            }
            let share = ((t - time[i]) / (time[i + 1] - time[i])).clamp(0.0, 1.0);
            let straight = x[i] + share * (x[i + 1] - x[i]);
            if i == 0 || i + 2 >= n || time[i + 2] - time[i - 1] > 12.0 * (time[i + 1] - time[i]) {
                return straight;
            }
            let (ts, xs) = (&time[i - 1..i + 3], &x[i - 1..i + 3]);
            if ts.windows(2).any(|w| w[1] - w[0] > 0.6 * (ts[3] - ts[0])) {
                return straight;
            }
            (0..4)
                .map(|a| {
                    let others = (0..4).filter(|b| *b != a);
                    xs[a] * others.map(|b| (t - ts[b]) / (ts[a] - ts[b])).product::<f64>()
                })
                .sum()
        })
        .collect()
}

/// Files that runs are from, by their hashes.
pub fn files<'a>(runs: impl Iterator<Item = &'a Run>) -> Vec<&'a str> {
    let mut all: Vec<&str> = runs.map(|r| r.hash.as_str()).collect();
    all.sort_unstable();
    all.dedup();
    all
}

/// Least and greatest of values; the wrong way round where there are none.
pub fn extent(values: impl Iterator<Item = f64>) -> (f64, f64) {
    values.fold((f64::MAX, f64::MIN), |(a, b), x| (a.min(x), b.max(x)))
}

/// From the least to the greatest value of a channel.
pub fn range(runs: &[&Run], c: BenchChannel) -> f64 {
    let (low, high) = extent(runs.iter().filter_map(|r| r.channel(c)).flatten().copied());
    (high - low).max(0.0)
}
