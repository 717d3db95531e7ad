//! The actuator itself under the command that was recorded: the numerical test bench and the simplified model, with the
//! parameters as they were (parent) and with what a study found (child), beside what was measured.

use crate::measured::bench::{Bench, BenchChannel, ChannelSpec, Role, RunSpec};
use crate::measured::jumps::Jumps;
use crate::measured::own::with_q_current;
use crate::measured::rows::{in_si, split};
use crate::told::command::{self, CommandBetween};
use ema_tables::Table;
use schemas::channel::{Channel, ChannelSet};
use schemas::error::Result;
use schemas::fault::FaultState;
use sim_worker::monitor::{MonitorModel, STEP_S};
use sim_worker::parameters::ActuatorParameters;
use sim_worker::simulate::LANES;
use sim_worker::test_bench::{Built, Kernel, Lane, NumericalTestBench};
use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::Arc;

/// Models that are simulated side by side.
pub(super) const AT_ONCE: usize = LANES / 2;
/// Time of all recordings together that is simulated at most [s] (assumed: a study is waited for).
const LONGEST_S: f64 = 30.0;
/// Greatest angle of the user from zero [rad], and speed of the motor at the first sample over its greatest, of a recording
/// that begins at rest (assumed).
const AT_REST_USER_RAD: f64 = 2e-3;
const AT_REST: f64 = 0.1;
/// Greatest scatter of a load that counts as constant, relative (assumed).
const CONSTANT_LOAD: f64 = 0.02;
/// Length of what is shown [s] (assumed).
const SHOWN_S: f64 = 0.4;

/// The gap of one channel, root mean square.
#[derive(Clone, Debug, PartialEq)]
pub struct VerifiedChannel {
    /// name of the bench's channel
    pub channel: String,
    /// SI at the motor
    pub unit: String,
    /// samples that were compared
    pub samples: usize,
    /// of the test bench with the parameters as they were
    pub parent: f64,
    /// of the test bench with what was found
    pub child: f64,
    /// of the simplified model with both, where it has the channel
    pub simplified: Option<(f64, f64)>,
}

/// A stretch of a channel under the recorded command.
#[derive(Clone, Debug, PartialEq)]
pub struct DrivenTrace {
    /// name of the bench's channel
    pub channel: String,
    /// SI at the motor
    pub unit: String,
    /// file of the recording
    pub run: String,
    /// of the samples
    pub time_s: Vec<f64>,
    /// by the sensor
    pub measured: Vec<f64>,
    /// by the test bench with the parameters as they were
    pub parent: Vec<f64>,
    /// by the test bench with what was found
    pub child: Vec<f64>,
}

/// What the simulator says under the recorded command.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Verification {
    /// whether the gaps are of runs that proved and did not find
    pub heldout: bool,
    /// by channel, where there is a recording that could be simulated
    pub channels: Vec<VerifiedChannel>,
    /// of the two channels that tell most
    pub traces: Vec<DrivenTrace>,
    /// what was not simulated, and why
    pub left_out: Vec<String>,
}

/// Places the jumps of all recordings' commands between their samples, as the motion shows them.
///
/// * `child` the actuator with what was found
///
/// # Errors
/// Refuses files that cannot be read.
pub fn place_jumps(bench: &mut Bench, child: &ActuatorParameters) -> Result<()> {
    let (all, _) = recordings(bench, &[Role::Fit, Role::Select, Role::HeldOut])?;
    let place = |(runs, recorded): OfRuns<'_>| {
        let mut jumps = recorded.jumps.clone();
        if !jumps.is_empty() {
            let (early, late) = either::<1>(bench, &recorded, std::slice::from_ref(child));
            jumps.set(&command::shares(&recorded, &early[0], &late[0]));
        }
        (runs[0].file.clone(), runs[0].filter.clone(), jumps)
    };
    bench.jumps = all.into_iter().map(place).collect();
    Ok(())
}

/// The test bench where each jump of the command comes as early as it may, and as late.
pub(super) fn either<const N: usize>(
    bench: &Bench,
    r: &Recorded,
    actuators: &[ActuatorParameters],
) -> (Vec<Simulated>, Vec<Simulated>)
where
    Kernel: Built<N>,
{
    let at = |share: f64| simulated::<N>(bench, r, &r.jumps.all_at(share), actuators, false).0;
    rayon::join(|| at(0.0), || at(1.0))
}

/// What simulators give for a channel of a bench.
const CHANNELS: [(BenchChannel, Channel); 8] = [
    (BenchChannel::Position, Channel::ThetaM),
    (BenchChannel::Velocity, Channel::OmegaM),
    (BenchChannel::Current, Channel::IQ),
    (BenchChannel::UserPosition, Channel::ThetaU),
    (BenchChannel::CurrentA, Channel::IA),
    (BenchChannel::CurrentB, Channel::IB),
    (BenchChannel::CurrentC, Channel::IC),
    (BenchChannel::VDc, Channel::VDc),
];

/// One recording, from its start.
pub(super) struct Recorded {
    file: String,
    pub(super) time_s: Vec<f64>,
    /// user side [rad]
    command: Vec<f64>,
    pub(super) measured: BTreeMap<BenchChannel, Vec<f64>>,
    load_n_m: f64,
    /// samples by which the gap is judged
    counted: Vec<bool>,
    /// where the command jumps between samples
    pub(super) jumps: Jumps,
}

impl Recorded {
    /// Samples of one of its runs.
    pub(super) fn samples_of(&self, run: &RunSpec) -> Vec<usize> {
        (0..self.time_s.len()).filter(|k| run.has(self.time_s[*k])).collect()
    }

    /// Samples in pieces of a length [s].
    pub(super) fn parts<'a>(&'a self, samples: &'a [usize], length_s: f64) -> impl Iterator<Item = &'a [usize]> {
        let place = move |k: usize| ((self.time_s[k] - self.time_s[samples[0]]) / length_s) as usize;
        samples.chunk_by(move |a, b| place(*a) == place(*b))
    }
}

/// Simulated channels of a recording, sample by sample.
pub(super) type Simulated = BTreeMap<BenchChannel, Vec<f64>>;

/// Runs the test bench and the simplified model under the commands of all recordings of a bench.
///
/// * `parent`, `child` parameters without and with what was found
///
/// # Errors
/// Refuses files that cannot be read.
pub fn verify(bench: &Bench, parent: &ActuatorParameters, child: &ActuatorParameters) -> Result<Verification> {
    let mut out = Verification {
        heldout: bench.runs.iter().any(|r| r.role == Role::HeldOut),
        ..Verification::default()
    };
    let judged = if out.heldout { Role::HeldOut } else { Role::Fit };
    let (all, left_out) = recordings(bench, &[judged])?;
    out.left_out = left_out;
    let mut sums: BTreeMap<BenchChannel, Sums> = BTreeMap::new();
    let mut stretches: Vec<(BenchChannel, f64, DrivenTrace)> = Vec::new();
    for (_, recorded) in all {
        let of = |p: &ActuatorParameters| {
            let mut by_bench = driven::<1>(bench, &recorded, std::slice::from_ref(p));
            (by_bench.swap_remove(0), simplified(bench, &recorded, p))
        };
        let ((before, simple_before), (after, simple_after)) = rayon::join(|| of(parent), || of(child));
        for (channel, _) in CHANNELS {
            let (Some(x), Some(a), Some(b)) = (
                recorded.measured.get(&channel),
                before.get(&channel),
                after.get(&channel),
            ) else {
                continue;
            };
            let sum = sums.entry(channel).or_default();
            let simple = simple_before.get(&channel).zip(simple_after.get(&channel));
            for k in (0..x.len()).filter(|&k| recorded.counted[k]) {
                sum.samples += 1;
                sum.parent += (x[k] - a[k]).powi(2);
                sum.child += (x[k] - b[k]).powi(2);
                if let Some((a, b)) = simple {
                    let both = sum.simplified.get_or_insert_default();
                    both.0 += (x[k] - a[k]).powi(2);
                    both.1 += (x[k] - b[k]).powi(2);
                }
            }
            if matches!(channel, BenchChannel::Current | BenchChannel::Velocity) {
                stretches.extend(stretch(&recorded, channel, x, a, b));
            }
        }
    }
    if sums.is_empty() && out.left_out.is_empty() {
        let why = format!("{}: no moving run with the role {}", bench.file, judged.name());
        out.left_out.push(why);
    }
    let root = |sum: f64, n: usize| (sum / n.max(1) as f64).sqrt();
    out.channels = sums
        .iter()
        .map(|(c, s)| VerifiedChannel {
            channel: c.name().to_string(),
            unit: c.quantity().si().to_string(),
            samples: s.samples,
            parent: root(s.parent, s.samples),
            child: root(s.child, s.samples),
            simplified: s.simplified.map(|(a, b)| (root(a, s.samples), root(b, s.samples))),
        })
        .collect();
    // of each channel the stretch in which the parent is furthest off
    stretches.sort_by(|a, b| (a.0, b.1).partial_cmp(&(b.0, a.1)).expect("finite"));
    stretches.dedup_by_key(|s| s.0);
    out.traces = stretches.into_iter().map(|s| s.2).collect();
    Ok(out)
}

/// A recording and the runs of a bench that are pieces of it.
pub(super) type OfRuns<'a> = (Vec<&'a RunSpec>, Recorded);

/// Recordings with a run of one of these roles, as far as they can be simulated, and what is left out and why.
///
/// # Errors
/// Refuses files that cannot be read.
pub(super) fn recordings<'a>(bench: &'a Bench, roles: &[Role]) -> Result<(Vec<OfRuns<'a>>, Vec<String>)> {
    let mut groups: Vec<Vec<&RunSpec>> = Vec::new();
    let moving = |r: &&RunSpec| !r.steady && matches!(r.role, Role::Fit | Role::Select | Role::HeldOut);
    for r in bench.runs.iter().filter(moving) {
        match groups
            .iter_mut()
            .find(|g| g[0].file == r.file && g[0].filter == r.filter)
        {
            Some(g) => g.push(r),
            None => groups.push(vec![r]),
        }
    }
    let mut tables: BTreeMap<&PathBuf, Table> = BTreeMap::new();
    let (mut out, mut left_out) = (Vec::new(), Vec::new());
    let mut simulated_s = 0.0;
    for group in groups {
        if !group.iter().any(|r| roles.contains(&r.role)) {
            continue;
        }
        let file = &group[0].file;
        if !tables.contains_key(file) {
            tables.insert(file, with_q_current(Table::filled(file)?));
        }
        let recorded = match recorded(bench, &group, roles, &tables[file])? {
            Ok(r) => r,
            Err(why) => {
                left_out.push(format!("{}: {why}", file.display()));
                continue;
            }
        };
        let length = recorded.time_s.last().expect("samples") - recorded.time_s[0];
        if simulated_s + length > LONGEST_S {
            let why = format!("beyond the {LONGEST_S} s that are simulated");
            left_out.push(format!("{}: {why}", file.display()));
            continue;
        }
        simulated_s += length;
        out.push((group, recorded));
    }
    Ok((out, left_out))
}

/// Sums of squares of a channel.
#[derive(Default)]
struct Sums {
    samples: usize,
    parent: f64,
    child: f64,
    /// of models that have the channel
    simplified: Option<(f64, f64)>,
}

/// A recording that begins at rest under a command; else why it cannot be simulated.
fn recorded(
    bench: &Bench,
    group: &[&RunSpec],
    roles: &[Role],
    table: &Table,
) -> Result<std::result::Result<Recorded, String>> {
    let spec = group[0];
    let Some(command) = bench.channel(BenchChannel::Command) else {
        let why = "no channel `command` in [channels]: nothing says what the simulators are to follow";
        return Ok(Err(why.into()));
    };
    if !spec.split.is_empty() {
        return Ok(Err("several runs in one file".into()));
    }
    let rows = split(table, spec)?.swap_remove(0).1;
    let column = |c: &ChannelSpec| in_si(table, c, &rows);
    let time = bench.channel(BenchChannel::Time);
    let time_s = time.map(column).transpose()?.unwrap_or_default();
    if time_s.len() < 64 {
        return Ok(Err(format!("{} samples", time_s.len())));
    }
    let mut measured = BTreeMap::new();
    // voltages are not simulated: they say what the windings take
    for c in CHANNELS.map(|(c, _)| c).into_iter().chain(BenchChannel::VOLTAGES) {
        if let Some(spec) = bench.channel(c).filter(|s| table.numbers(&s.column).is_ok()) {
            measured.insert(c, late(&time_s, column(spec)?, spec.delay_s));
        }
    }
    // the file's own where phases make it
    if bench.has_phases()
        && let Ok(x) = table.numbers("i_q")
    {
        measured.insert(BenchChannel::Current, rows.iter().map(|&r| x[r]).collect());
    }
    let Some(angle) = measured.get(&BenchChannel::Position) else {
        return Ok(Err("no channel `position`".into()));
    };
    let step = |k: usize| (angle[k + 1] - angle[k]).abs() / (time_s[k + 1] - time_s[k]).max(1e-9);
    let fastest = (0..angle.len() - 1).map(step).fold(0.0, f64::max);
    let first = measured
        .get(&BenchChannel::Velocity)
        .map_or_else(|| step(0), |w| w[0].abs());
    let user = measured
        .get(&BenchChannel::UserPosition)
        .map_or(0.0, |u| u[0] / bench.rig.gear_ratio);
    if first > AT_REST * fastest || user.abs() > AT_REST_USER_RAD {
        let why = format!("does not begin at rest at zero (user at {user:.4} rad, motor at {first:.1} rad/s)");
        return Ok(Err(why));
    }
    let mut load_n_m = 0.0;
    if let Some(load) = bench.channel(BenchChannel::Load) {
        let x = column(load)?;
        load_n_m = x.iter().sum::<f64>() / x.len() as f64;
        if x.iter().any(|x| (x - load_n_m).abs() > CONSTANT_LOAD * load_n_m.abs()) {
            return Ok(Err("its load changes".into()));
        }
    }
    let counted = |t: &f64| {
        let of = |r: &&&RunSpec| roles.contains(&r.role);
        group.iter().filter(of).any(|r| r.has(*t))
    };
    let command: Vec<f64> = column(command)?.iter().map(|c| c / bench.rig.gear_ratio).collect();
    let jumps = match bench.jumps.iter().find(|j| j.0 == spec.file && j.1 == spec.filter) {
        Some((_, _, jumps)) => jumps.clone(),
        None => Jumps::of(&command),
    };
    Ok(Ok(Recorded {
        jumps,
        file: spec
            .file
            .file_name()
            .map_or_else(String::new, |f| f.to_string_lossy().into_owned()),
        counted: time_s.iter().map(counted).collect(),
        command,
        time_s,
        measured,
        load_n_m,
    }))
}

/// A channel that says what was `delay_s` ago, at its own time.
fn late(time_s: &[f64], x: Vec<f64>, delay_s: f64) -> Vec<f64> {
    if delay_s == 0.0 {
        return x;
    }
    let mut j = 0;
    let at = |t: f64| {
        while j + 2 < x.len() && time_s[j + 1] < t {
            j += 1;
        }
        let share = ((t - time_s[j]) / (time_s[j + 1] - time_s[j])).clamp(0.0, 1.0);
        x[j] + share * (x[j + 1] - x[j])
    };
    time_s.iter().map(|t| t + delay_s).map(at).collect()
}

impl Recorded {
    /// Number of the step at which each sample is taken, from where the recording begins.
    fn steps(&self, dt: f64) -> (u64, Vec<u64>) {
        let first = self.time_s[0];
        let step = self.time_s[1] - first;
        // telemetry begins one interval after the start
        let start = if first > 0.0 && first < 1.5 * step { 0.0 } else { first };
        let at = |t: f64| (t / dt).round() as u64;
        (at(start.max(0.0)), self.time_s.iter().map(|t| at(t.max(0.0))).collect())
    }
}

/// The numerical test bench under the recorded command, with parameters that have one step, at most as many as it has lanes.
pub(super) fn driven<const N: usize>(bench: &Bench, r: &Recorded, actuators: &[ActuatorParameters]) -> Vec<Simulated>
where
    Kernel: Built<N>,
{
    simulated::<N>(bench, r, &r.jumps, actuators, false).0
}

/// As [`driven`], of one actuator; and the same with currents at points.
pub(super) fn means_and_points(bench: &Bench, r: &Recorded, p: &ActuatorParameters) -> (Simulated, Simulated) {
    let (mut means, mut points) = simulated::<1>(bench, r, &r.jumps, std::slice::from_ref(p), true);
    (means.swap_remove(0), points.swap_remove(0))
}

/// As [`driven`], with jumps at these places.
///
/// * `points` whether currents are wanted at points too: they come second, nothing where they are not
fn simulated<const N: usize>(
    bench: &Bench,
    r: &Recorded,
    jumps: &Jumps,
    actuators: &[ActuatorParameters],
    points: bool,
) -> (Vec<Simulated>, Vec<Simulated>)
where
    Kernel: Built<N>,
{
    let dt = actuators[0].step_s;
    let (mut done, ends) = r.steps(dt);
    let asked: Vec<(BenchChannel, Channel)> = CHANNELS
        .into_iter()
        .filter(|(c, _)| r.measured.contains_key(c))
        .collect();
    let rest = r.measured.get(&BenchChannel::Position).map_or(0.0, |x| x[0]);
    let lane = |p: &ActuatorParameters| Lane {
        actuator: Arc::new(p.clone()),
        fault: FaultState::NOMINAL,
        rest_angle_rad: rest,
        load_n_m: r.load_n_m,
    };
    let lanes: Vec<Lane> = actuators.iter().map(lane).collect();
    let channels = ChannelSet::of(asked.iter().map(|(_, c)| *c));
    let mut ntb = NumericalTestBench::<N>::new(&lanes, channels);
    let command = CommandBetween {
        time_s: &r.time_s,
        value: &r.command,
        jumps,
    };
    let mut means = vec![Simulated::new(); actuators.len()];
    let mut at_points = if points { means.clone() } else { Vec::new() };
    let mut com = Vec::new();
    for (k, &end) in ends.iter().enumerate() {
        com.resize(end.saturating_sub(done) as usize, 0.0);
        command.fill(k, done, dt, &mut com);
        ntb.next_interval();
        if points {
            ntb.advance_to_points(&com);
        } else {
            ntb.advance(&com);
        }
        done = done.max(end);
        for (c, channel) in &asked {
            let gear = if *c == BenchChannel::UserPosition {
                bench.rig.gear_ratio
            } else {
                1.0
            };
            let put = |out: &mut [Simulated], samples: [f64; N]| {
                for (out, x) in out.iter_mut().zip(samples) {
                    let column = out.entry(*c).or_default();
                    // a mean over nothing is the last one
                    let last = column.last().copied().unwrap_or(0.0);
                    column.push(if x.is_finite() { x * gear } else { last });
                }
            };
            put(&mut means, ntb.samples(*channel));
            if points {
                put(&mut at_points, ntb.points(*channel));
            }
        }
    }
    for s in means.iter_mut().chain(&mut at_points) {
        as_recorded(bench, &r.time_s, s);
    }
    (means, at_points)
}

/// A speed that the drive makes of the angle: the simulated one is made likewise.
fn as_recorded(bench: &Bench, time_s: &[f64], s: &mut Simulated) {
    let Some(made) = bench.made_of_angle.filter(|_| s.contains_key(&BenchChannel::Velocity)) else {
        return;
    };
    let rate_hz = (time_s.len() - 1) as f64 / (time_s[time_s.len() - 1] - time_s[0]);
    s.insert(
        BenchChannel::Velocity,
        made.speed_of(&s[&BenchChannel::Position], rate_hz),
    );
}

/// The simplified model under the recorded command.
fn simplified(bench: &Bench, r: &Recorded, p: &ActuatorParameters) -> Simulated {
    let (mut done, ends) = r.steps(STEP_S);
    let rest = r.measured.get(&BenchChannel::Position).map_or(0.0, |x| x[0]);
    let mut m = MonitorModel::new(p, STEP_S).at_rest_angle(rest);
    let command = CommandBetween {
        time_s: &r.time_s,
        value: &r.command,
        jumps: &r.jumps,
    };
    let mut out = Simulated::new();
    let mut com = Vec::new();
    let mut mean = 0.0;
    for (k, &end) in ends.iter().enumerate() {
        com.resize(end.saturating_sub(done) as usize, 0.0);
        command.fill(k, done, STEP_S, &mut com);
        done = done.max(end);
        let mut sum = 0.0;
        for c in &com {
            m.step(*c);
            sum += m.i;
        }
        if !com.is_empty() {
            mean = sum / com.len() as f64;
        }
        let values = [
            (BenchChannel::Position, rest + m.motor_angle_rad()),
            (BenchChannel::Velocity, m.w),
            (BenchChannel::Current, mean),
            (BenchChannel::UserPosition, m.user_angle_rad() * p.gear_ratio),
        ];
        for (c, x) in values {
            out.entry(c).or_default().push(x);
        }
    }
    as_recorded(bench, &r.time_s, &mut out);
    out
}

/// The stretch of a recording in which the parent is furthest from what was measured, of the samples that count.
fn stretch(
    r: &Recorded,
    channel: BenchChannel,
    x: &[f64],
    parent: &[f64],
    child: &[f64],
) -> Option<(BenchChannel, f64, DrivenTrace)> {
    let n = x.len();
    let wide = r.time_s.partition_point(|t| *t < r.time_s[0] + SHOWN_S).clamp(2, n);
    let energy = |from: usize| -> f64 {
        (from..(from + wide).min(n))
            .filter(|&k| r.counted[k])
            .map(|k| (x[k] - parent[k]).powi(2))
            .sum()
    };
    let starts = (0..n).step_by((wide / 2).max(1)).filter(|&k| r.counted[k]);
    let (from, e) = starts.map(|k| (k, energy(k))).max_by(|a, b| a.1.total_cmp(&b.1))?;
    let part = from..(from + wide).min(n);
    let trace = DrivenTrace {
        channel: channel.name().to_string(),
        unit: channel.quantity().si().to_string(),
        run: r.file.clone(),
        time_s: r.time_s[part.clone()].to_vec(),
        measured: x[part.clone()].to_vec(),
        parent: parent[part.clone()].to_vec(),
        child: child[part].to_vec(),
    };
    Some((channel, e, trace))
}
