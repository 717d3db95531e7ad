//! Runs of a bench: columns of files brought to SI at the motor, on an even clock, and looked at
//! for the usual mistakes before anything is fitted.

use crate::measured::bench::{Bench, BenchChannel, ChannelSpec, Noise, Role, RunSpec};
use crate::measured::own::with_q_current;
use crate::measured::rows::{Labels, column, in_si, split};
use ema_tables::Table;
use schemas::error::{Error, Result};
use std::collections::BTreeMap;
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

/// Steps of a signal that tell its grain: most grains of one, most of the least one, how far off a whole number, fewest (assumed).
const MOST_GRAINS: f64 = 64.0;
const MOST_PARTS: usize = 32;
const OFF_GRAIN: f64 = 0.05;
const FEWEST_STEPS: usize = 60;
/// Noise by the fourth differences, whose median is whole grains, over that of the grain alone up to which there is no other (assumed).
const GRAIN_ALONE: f64 = 2.0;

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
        for x in r.channels.values_mut() {
            *x = x.chunks_exact(m).map(|c| c.iter().sum::<f64>() / m as f64).collect();
        }
        r.lost = r.lost.chunks_exact(m).map(|c| c.iter().any(|l| *l)).collect();
        r.start_s += (m - 1) as f64 / r.rate_hz;
        r.rate_hz /= m as f64;
    }
    for c in bench.channels.iter_mut().filter(|c| c.channel != BenchChannel::Time) {
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
    channels: BTreeMap<BenchChannel, Vec<f64>>,
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
}

impl Run {
    pub fn channel(&self, c: BenchChannel) -> Option<&[f64]> {
        self.channels.get(&c).map(Vec::as_slice)
    }

    pub(super) fn leave_out(&mut self, c: BenchChannel) {
        self.channels.remove(&c);
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
                let (from, to) = ends(k);
                iq[k] += 0.5 * i[k] * over_support(bench.rig.pole_pairs, q, from, to, |_, trap| trap);
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
    })
}

/// Points of an angle's way over a sample.
const WAY: usize = 12;

/// Mean of `f(angle, shape of the back-EMF)` of a phase over that part of the way from one angle to the other in which
/// the phase conducts, over all of it if it does nowhere: a current is where it conducts.
pub fn over_support(pole_pairs: f64, q: usize, from: f64, to: f64, f: impl Fn(f64, f64) -> f64) -> f64 {
    let (mut on, mut all, mut count) = (0.0, 0.0, 0.0);
    for j in 0..WAY {
        let theta = from + (to - from) * (j as f64 + 0.5) / WAY as f64;
        let electrical = pole_pairs * theta - std::f64::consts::TAU / 3.0 * q as f64;
        let trap = sim_worker::effect::shape(electrical);
        let x = f(theta, trap);
        all += x;
        // +-1 from 30 to 150 degrees: there the phase conducts
        if trap.abs() > 1.0 - 1e-12 {
            on += x;
            count += 1.0;
        }
    }
    if count > 0.0 { on / count } else { all / WAY as f64 }
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

/// Least and greatest of values; the wrong way round where there are none.
pub fn extent(values: impl Iterator<Item = f64>) -> (f64, f64) {
    values.fold((f64::MAX, f64::MIN), |(a, b), x| (a.min(x), b.max(x)))
}

/// From the least to the greatest value of a channel.
pub fn range(runs: &[&Run], c: BenchChannel) -> f64 {
    let (low, high) = extent(runs.iter().filter_map(|r| r.channel(c)).flatten().copied());
    (high - low).max(0.0)
}

/// Noise of a channel.
#[derive(Clone, Copy, Debug, Default)]
pub struct ChannelNoise {
    /// of one sample, SI at the motor
    pub rms: f64,
    /// correlation from sample to sample (first-order, 0 = white)
    pub colour: f64,
}

impl ChannelNoise {
    /// rms of white noise that is as strong at low frequencies
    pub fn slow_rms(&self) -> f64 {
        let c = self.colour.clamp(0.0, 0.9);
        self.rms * ((1.0 + c) / (1.0 - c)).sqrt()
    }
}

/// Noise of a channel, resolution included; SI at the motor.
pub fn noise(spec: &ChannelSpec, runs: &[Run]) -> ChannelNoise {
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
        Noise::Repeats => from_repeats(spec.channel, runs).unwrap_or_else(|| without_grain(spec.channel, runs)),
        Noise::Estimated => {
            let of_grain = grain_of(spec.channel, runs) / 12f64.sqrt();
            let all = estimated(spec.channel, runs);
            let rms = match (of_grain > 0.0, all) {
                (true, Some(all)) if all >= GRAIN_ALONE * of_grain => all,
                (true, _) => of_grain,
                (false, _) => without_grain(spec.channel, runs),
            };
            return ChannelNoise { rms, colour: 0.0 };
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
        let d: Vec<f64> = fourth_differences(x).collect();
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

/// The grain of a channel whose values stand on a grid; 0 where they do not.
fn grain_of(channel: BenchChannel, runs: &[Run]) -> f64 {
    grain(runs.iter().filter_map(|r| r.channel(channel)))
}

/// As [`grain_of`], of signals. Where they run fast few steps are of one grain: the grain is the greatest part of a small step that
/// small steps are whole numbers of.
pub fn grain<'a>(signals: impl Iterator<Item = &'a [f64]>) -> f64 {
    let mut steps: Vec<f64> = signals
        .flat_map(|x| x.windows(2).take(20_000).map(|w| (w[1] - w[0]).abs()))
        .collect();
    let most = steps.iter().fold(0.0, |a: f64, b| a.max(*b));
    steps.retain(|s| *s > 1e-7 * most);
    steps.sort_by(f64::total_cmp);
    // the least step that is not a freak
    let Some(&least) = steps.get(steps.len() / 200) else {
        return 0.0;
    };
    let of = |parts: usize| {
        let mut grain = least / parts as f64;
        for few in [true, false] {
            // the smallest ones, and with what they say of it those again: a step is written with few digits
            let mut count = steps.partition_point(|s| *s < MOST_GRAINS * grain);
            if few {
                count = count.min(steps.len() / 200 + 2 * FEWEST_STEPS);
            }
            let small = &steps[..count];
            let on: Vec<(f64, f64)> = small
                .iter()
                .map(|s| (*s, (s / grain).round()))
                .filter(|(s, n)| *n > 0.0 && (s / grain - n).abs() < OFF_GRAIN)
                .collect();
            let is_grain = small.len() >= FEWEST_STEPS && on.len() * 20 > 19 * small.len();
            if !is_grain {
                return None;
            }
            let (sn, nn) = on.iter().fold((0.0, 0.0), |(a, b), (s, n)| (a + s * n, b + n * n));
            grain = sn / nn;
        }
        Some(grain)
    };
    let found = (1..=MOST_PARTS).find_map(of).unwrap_or(0.0);
    if most > 1.5 * found { found } else { 0.0 }
}

/// Fourth differences of neighbours, in which a smooth signal leaves little.
pub fn fourth_differences(x: &[f64]) -> impl Iterator<Item = f64> + '_ {
    x.windows(5).map(|w| w[0] - 4.0 * w[1] + 6.0 * w[2] - 4.0 * w[3] + w[4])
}

/// rms of white noise whose fourth differences have the median that those of the signals have; `None` where there are
/// none.
pub fn roughness<'a>(signals: impl Iterator<Item = &'a [f64]>) -> Option<f64> {
    let mut all: Vec<f64> = signals.flat_map(|x| fourth_differences(x).map(f64::abs)).collect();
    if all.is_empty() {
        return None;
    }
    let middle = all.len() / 2;
    let median = *all.select_nth_unstable_by(middle, f64::total_cmp).1;
    Some(median / 0.6745 / 70f64.sqrt())
}

/// From the fourth differences, in which a smooth signal leaves little: their median, so that jumps do not count; `None` where
/// there are none.
fn estimated(channel: BenchChannel, runs: &[Run]) -> Option<f64> {
    roughness(runs.iter().filter_map(|r| r.channel(channel)))
}

/// As [`estimated`], but no better than a millionth of its range: only a sensor that counts over many turns is.
fn without_grain(channel: BenchChannel, runs: &[Run]) -> f64 {
    let all: Vec<&Run> = runs.iter().collect();
    estimated(channel, runs).map_or(0.0, |usual| usual.max(1e-6 * range(&all, channel)))
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

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::TAU;

    /// A motor that swings over many turns, at no moment slow for long, in counts, written with six decimals.
    fn angle(counts: f64) -> Vec<f64> {
        let count = TAU / counts;
        let at = |k: usize| 300.0 * (3e-4 * k as f64).sin() + 20.0 * (5e-3 * k as f64).sin();
        let written = |x: f64| ((x / count).round() * count * 1e6).round() / 1e6;
        (0..8000).map(|k| written(at(k))).collect()
    }

    fn run(x: Vec<f64>) -> Run {
        Run {
            name: "swing".into(),
            role: Role::Fit,
            rate_hz: 2000.0,
            start_s: 0.0,
            samples: x.len(),
            channels: BTreeMap::from([(BenchChannel::Position, x)]),
            hash: String::new(),
            rows: Vec::new(),
            labels: Vec::new(),
            lost: Vec::new(),
            clock: None,
            healthy: true,
            steady: false,
            spread: BTreeMap::new(),
        }
    }

    #[test]
    fn prop_a_grain_is_found_where_a_signal_runs_fast() {
        for counts in [16384.0, 65536.0] {
            let x = angle(counts);
            let found = grain(std::iter::once(&x[..]));
            assert!(
                (found * counts / TAU - 1.0).abs() < 1e-3,
                "{counts}: {}",
                found * counts / TAU
            );
        }
        let smooth: Vec<f64> = (0..8000).map(|k| (1e-3 * f64::from(k)).sin()).collect();
        assert_eq!(grain(std::iter::once(&smooth[..])), 0.0);
    }

    #[test]
    fn an_angle_over_many_turns_is_known_to_its_count() {
        let spec = ChannelSpec {
            channel: BenchChannel::Position,
            column: "theta".into(),
            minus: None,
            factor: 1.0,
            unit_factor: 1.0,
            unit: None,
            lead: None,
            mean: false,
            delay_s: 0.0,
            resolution: 0.0,
            noise: Noise::Estimated,
            offset: None,
        };
        for counts in [16384.0, 65536.0] {
            let found = noise(&spec, &[run(angle(counts))]);
            let of_count = TAU / counts / 12f64.sqrt();
            assert!(
                (found.rms / of_count - 1.0).abs() < 1e-3,
                "{counts}: {} {of_count}",
                found.rms
            );
        }
    }
}
