//! The motion of a run as the equations need it: smoothed angle and speed on one clock, the sign of
//! the motion averaged over each sample, and the other channels brought to the same moment.

use crate::equations::clock::{Clock, NoiseTable};
use crate::equations::phases::Phases;
use crate::equations::pieces::true_angle;
use crate::measured::bench::{Bench, BenchChannel, ControllerLaw};
use crate::measured::filter::FilterBank;
use crate::measured::noise;
use crate::measured::recording::{self, Run};
use crate::measured::samples::{sharp, shifted};
use sim_worker::effect::Play;

/// A sample is at rest below so many standard deviations of the smoothed speed.
const AT_REST: f64 = 4.0;
/// Samples over which the narrowest smoother of the motion smears where the friction turns over, and how long a sample is from which
/// that is more than the noise of rows so short [s] (assumed).
const REACH: usize = 3;
const LONG_SAMPLE_S: f64 = 0.0015;
/// Rests that are interrupted for less than this are one [s] (assumed).
const PAUSE_S: f64 = 0.006;
/// A step of the drive signal over its usual one from which the mean over a sample is not known well enough
/// (assumed), and the share of all samples that may be left out for it.
const TRANSIENT: f64 = 12.0;
const MOST_TRANSIENT: f64 = 0.08;

/// Share of the supply voltage that the back-EMF may take before the current is no longer held (assumed).
const SUPPLY_SHARE: f64 = 0.85;

/// Current of three phases over that which nine samples in ten stay below, from which they are in a transient (assumed).
const STRONG: f64 = 2.5;

/// Samples around a gap of the clock that are left out.
const AROUND_GAP: usize = 40;

/// One run on the common clock, at the rate of the measurement.
#[derive(Clone, Debug)]
pub struct Signals {
    pub n: usize,
    pub rate_hz: f64,
    pub start_s: f64,
    /// standard deviation of the smoother [samples], 0 without
    pub smooth: f64,
    /// smoothed angle [rad], speed [rad/s], acceleration [rad/s2]
    pub theta: Vec<f64>,
    pub omega: Vec<f64>,
    pub accel: Vec<f64>,
    /// speed over a sample [rad/s], not smoothed: a smoother takes from a speed what its current then seems to have given an inductance;
    /// where the voltage of one winding is measured
    pub within: Option<Vec<f64>>,
    /// mean over the sample of the sign of the motion
    pub sign: Vec<f64>,
    /// at rest, or turning round: the dry friction is not known
    pub resting: Vec<bool>,
    /// in a gap of the clock; empty where there is none
    pub lost: Vec<bool>,
    /// the drive signal steps here
    pub stepping: Vec<bool>,
    /// the drive channel as measured, on the common clock
    pub drive: Vec<f64>,
    /// its derivative, smoothed
    pub drive_rate: Vec<f64>,
    /// torque [N m], 0 where it is not measured
    pub load: Vec<f64>,
    /// smooth enough that its magnitude is not that of its noise
    pub load_level: Vec<f64>,
    pub has_load: bool,
    /// smoothed [degC]
    pub temperature: Option<Vec<f64>>,
    pub voltage: Option<Vec<f64>>,
    pub supply: Option<Vec<f64>>,
    /// three phases, where they are measured
    pub phases: Option<Phases>,
    /// position as measured, and the user's times the gear ratio
    pub position: Vec<f64>,
    pub user: Option<Vec<f64>>,
    pub velocity: Option<Vec<f64>>,
    pub command: Option<Vec<f64>>,
    /// the controller's law on the measured signals [drive unit], and where it is limited
    pub law: Option<(Vec<f64>, Vec<bool>)>,
    /// angle that angles are counted from [rad]
    pub rest: f64,
    /// angle as measured in the pieces of the same recording that end where this one begins [rad]
    pub before: Vec<f64>,
}

impl Signals {
    /// Of the rows of an electrical equation with one voltage, those of the winding; what follows is the supply's.
    pub fn of_winding(&self, rows: usize) -> usize {
        if self.supply.is_some() { rows / 2 } else { rows }
    }

    /// Whether the torque is on time, as a mean over each sample: by the phases of the motor, where these are means.
    pub fn on_time(&self) -> bool {
        self.phases.as_ref().is_some_and(|p| p.means)
    }

    /// The user's angle behind a play of half-width `half` that follows `theta`; it starts where the user's sensor says.
    pub fn played(&self, theta: &[f64], half: f64) -> Vec<f64> {
        let ahead = theta[0] - self.theta[0];
        let lag = self.user.as_ref().map_or(0.0, |u| u[0] - self.position[0] - ahead);
        let start = theta[0] + if lag.abs() <= 1.05 * half { lag } else { 0.0 };
        let mut play = Play::new(2.0 * half, start);
        theta.iter().map(|t| play.step(*t)).collect()
    }

    /// A friction map.
    fn steady(bench: &Bench, run: &Run) -> Self {
        let n = run.samples;
        let get = |c: BenchChannel| run.channel(c).map(<[f64]>::to_vec);
        let omega = get(BenchChannel::Velocity).unwrap_or_else(|| vec![0.0; n]);
        let load = get(BenchChannel::Load).unwrap_or_else(|| vec![0.0; n]);
        Self {
            n,
            rate_hz: run.rate_hz,
            start_s: 0.0,
            smooth: 0.0,
            theta: vec![0.0; n],
            accel: vec![0.0; n],
            within: None,
            sign: omega.iter().map(|w| w.signum()).collect(),
            resting: vec![false; n],
            lost: Vec::new(),
            stepping: Vec::new(),
            drive: get(bench.rig.drive).expect("checked when read"),
            drive_rate: vec![0.0; n],
            has_load: run.channel(BenchChannel::Load).is_some(),
            load_level: load.clone(),
            load,
            temperature: get(BenchChannel::Temperature),
            voltage: None,
            supply: None,
            phases: None,
            position: vec![0.0; n],
            user: None,
            velocity: None,
            command: None,
            law: None,
            rest: 0.0,
            before: Vec::new(),
            omega,
        }
    }
}

/// Most pieces before one that are looked back at (assumed).
const LOOKED_BACK: usize = 3;

/// The angle in the pieces of the same recording that end where a run begins, the oldest first [rad].
///
/// * `all` runs of all roles
pub fn before(run: &Run, all: &[&Run]) -> Vec<f64> {
    let mut out = Vec::new();
    let mut first = run;
    for _ in 0..LOOKED_BACK {
        let ends = |r: &&&Run| {
            let (last, next) = (r.rows.last(), first.rows.first());
            r.hash == run.hash && r.labels == run.labels && last.zip(next).is_some_and(|(l, n)| l + 1 == *n)
        };
        let Some(earlier) = all.iter().find(ends) else { break };
        let Some(x) = earlier.channel(BenchChannel::Position) else {
            break;
        };
        out.splice(0..0, x.iter().copied());
        first = earlier;
    }
    out
}

impl Signals {
    pub fn new(bench: &Bench, run: &Run, clock: &Clock) -> Self {
        let rate_hz = clock.rate_hz;
        if clock.steady {
            return Self::steady(bench, run);
        }
        let at = |c: BenchChannel| -> Option<Vec<f64>> {
            run.channel(c).map(|x| shifted(x, clock.shift(bench, c) * rate_hz))
        };
        let smoother = |c: BenchChannel| FilterBank::smoother(clock.smooth, rate_hz, clock.shift(bench, c));
        let (theta, omega, accel);
        if let (Some(x), true) = (run.channel(BenchChannel::Position), clock.from_position) {
            let s = smoother(BenchChannel::Position);
            (theta, omega, accel) = (s.whole(0, x), s.whole(1, x), s.whole(2, x));
        } else if let Some(w) = run.channel(BenchChannel::Velocity) {
            let s = smoother(BenchChannel::Velocity);
            (omega, accel) = (s.whole(0, w), s.whole(1, w));
            theta = match run.channel(BenchChannel::Position) {
                Some(x) => smoother(BenchChannel::Position).whole(0, x),
                None => integral(&omega, rate_hz),
            };
        } else {
            unreachable!("checked: position or velocity")
        }
        let position = at(BenchChannel::Position).unwrap_or_else(|| theta.clone());
        let command = at(BenchChannel::Command);
        let user = at(BenchChannel::UserPosition);
        // the law acts on what is measured
        let law = command
            .as_ref()
            .zip(bench.rig.controller.as_ref())
            .map(|(command, law)| {
                let position = user.as_ref().filter(|_| law.on_user).unwrap_or(&position);
                // as it is recorded, whether by a sensor or not: a speed that is smoothed turns no corner as sharply as the drive does
                let recorded = run.law_speed.as_ref().zip(bench.law_speed.as_ref());
                let measured = || (!law.differenced).then(|| at(BenchChannel::Velocity)).flatten();
                let speed = recorded
                    .map(|(x, spec)| shifted(x, clock.shift_of(spec) * rate_hz))
                    .or_else(measured);
                demanded(law, command, position, speed.as_ref().unwrap_or(&omega), rate_hz)
            });
        let (mut theta, mut omega, mut accel) = (theta, omega, accel);
        if bench.rig.encoder != (0.0, 0.0) && !bench.has_phases() {
            let of_angle = clock.from_position || bench.rig.encoder_speed;
            straighten(bench.rig.encoder, of_angle, &mut theta, &mut omega, &mut accel);
        }
        let one_winding = run.channel(BenchChannel::Voltage).is_some() && !bench.has_phases();
        let within = one_winding.then(|| within(bench, run, clock, &theta));
        let (sign, mut resting) = directions(&omega, AT_REST * clock.speed_noise, (PAUSE_S * rate_hz) as usize);
        // as far as the narrowest smoother takes motion into a rest, or across a reversal; a wider one takes less than the noise
        if rate_hz * LONG_SAMPLE_S < 1.0 {
            let was = std::mem::replace(&mut resting, vec![false; run.samples]);
            for k in (0..was.len()).filter(|&k| was[k]) {
                resting[k.saturating_sub(REACH)..(k + REACH + 1).min(run.samples)].fill(true);
            }
        }
        // what lies in a gap of the clock is nothing that was measured; its neighbours are left out too, as far as the smoother reaches and until the filter has found the motion again
        for k in (0..run.lost.len()).filter(|&k| run.lost[k]) {
            resting[k.saturating_sub(AROUND_GAP)..(k + AROUND_GAP).min(run.samples)].fill(true);
        }
        let (first, last) = clock.ends(bench, run);
        let mut lost = run.lost.clone();
        if first.max(last) > 0 {
            lost.resize(run.samples, false);
        }
        for marks in [&mut resting, &mut lost].into_iter().filter(|m| !m.is_empty()) {
            marks[..first].fill(true);
            marks[run.samples - last..].fill(true);
        }
        let rig = &bench.rig;
        if rig.drive == BenchChannel::Current {
            // near the supply's limit the phases no longer carry what the commutation asks for
            let fastest = SUPPLY_SHARE * rig.supply_voltage / rig.back_emf.value.max(1e-12);
            resting
                .iter_mut()
                .zip(&omega)
                .for_each(|(r, w)| *r |= w.abs() > fastest);
        }
        let drive_channel = bench.rig.drive;
        let raw = run.channel(drive_channel).expect("checked when read");
        let mut stepping = vec![false; run.samples];
        for k in transients(raw) {
            stepping[k.saturating_sub(1)..(k + 2).min(run.samples)].fill(true);
        }
        if bench.has_phases() {
            // in a transient the phases do not carry what two of them carry at rest
            for k in strong(raw) {
                stepping[k.saturating_sub(1)..(k + 3).min(run.samples)].fill(true);
            }
        }
        resting.iter_mut().zip(&stepping).for_each(|(r, s)| *r |= s);
        let s = smoother(drive_channel);
        let temperature = run.channel(BenchChannel::Temperature);
        let temperature = temperature.map(|x| FilterBank::new(0.002 * rate_hz, rate_hz, 0.0).whole(0, x));
        let mut out = Self {
            n: run.samples,
            rate_hz,
            start_s: run.start_s,
            smooth: clock.smooth,
            // of the sensor, in all runs the same
            rest: if run.channel(BenchChannel::Position).is_some() {
                0.0
            } else {
                theta[0]
            },
            theta,
            omega,
            accel,
            within,
            sign,
            resting,
            lost,
            stepping,
            drive: at(drive_channel).expect("checked when read"),
            drive_rate: s.whole(1, raw),
            has_load: run.channel(BenchChannel::Load).is_some(),
            load: at(BenchChannel::Load).unwrap_or_else(|| vec![0.0; run.samples]),
            load_level: match run.channel(BenchChannel::Load) {
                Some(x) => FilterBank::smoother(3.0 * clock.smooth, rate_hz, clock.shift(bench, BenchChannel::Load))
                    .whole(0, x),
                None => vec![0.0; run.samples],
            },
            temperature,
            voltage: at(BenchChannel::Voltage),
            supply: at(BenchChannel::VDc),
            phases: Phases::new(bench, run, clock),
            position,
            user,
            velocity: at(BenchChannel::Velocity),
            command,
            law,
            before: Vec::new(),
        };
        if let Some(p) = out.phases.take_if(|p| p.encoder != (0.0, 0.0)) {
            out.drive = p.drive(&out);
            out.phases = Some(p);
        }
        out
    }
}

/// Speed over each sample [rad/s], from what the angle is at its two ends, or as it is measured.
///
/// * `theta` angle at the common moments [rad]
fn within(bench: &Bench, run: &Run, clock: &Clock, theta: &[f64]) -> Vec<f64> {
    let (rate_hz, error) = (clock.rate_hz, bench.rig.encoder);
    if let (Some(x), true) = (run.channel(BenchChannel::Position), clock.from_position) {
        let ends = sharp(x, clock.shift(bench, BenchChannel::Position) * rate_hz + 0.5);
        let angle: Vec<f64> = ends.iter().map(|t| true_angle(error, *t)).collect();
        return (0..angle.len())
            .map(|k| (angle[k] - angle[k.saturating_sub(1)]) * rate_hz)
            .collect();
    }
    let speed = run
        .channel(BenchChannel::Velocity)
        .expect("checked: position or velocity");
    let speed = sharp(speed, clock.shift(bench, BenchChannel::Velocity) * rate_hz);
    let error = if bench.rig.encoder_speed { error } else { (0.0, 0.0) };
    speed.iter().zip(theta).map(|(w, t)| w / slope(error, *t)).collect()
}

/// What an angle sensor that is out of centre makes of a speed, at a true angle.
fn slope((a, b): (f64, f64), theta: f64) -> f64 {
    // measured = t + a sin t + b cos t
    1.0 + a * theta.cos() - b * theta.sin()
}

/// Takes the error of an angle sensor that is out of centre out of an angle and, where they are `of_angle`, its derivatives.
fn straighten(error: (f64, f64), of_angle: bool, theta: &mut [f64], omega: &mut [f64], accel: &mut [f64]) {
    for k in 0..theta.len() {
        let t = true_angle(error, theta[k]);
        let (a, b) = error;
        let slope = slope(error, t);
        theta[k] = t;
        if of_angle {
            omega[k] /= slope;
            accel[k] = (accel[k] + (a * t.sin() + b * t.cos()) * omega[k] * omega[k]) / slope;
        }
    }
}

/// The law's output, and where a limit acts on it.
fn demanded(
    law: &ControllerLaw,
    command: &[f64],
    position: &[f64],
    omega: &[f64],
    rate_hz: f64,
) -> (Vec<f64>, Vec<bool>) {
    let mut sum = 0.0;
    let mut out = Vec::with_capacity(omega.len());
    let mut limited = Vec::with_capacity(omega.len());
    for k in 0..omega.len() {
        let reference = law.position_gain * (command[k] - position[k]);
        let reference = reference.clamp(-law.speed_limit, law.speed_limit);
        let error = reference - omega[k];
        let u = law.speed_gain * error + sum;
        let over = u.abs() > 0.99 * law.drive_limit;
        if !over {
            sum += law.integral_gain * error / rate_hz;
        }
        out.push(u.clamp(-law.drive_limit, law.drive_limit));
        limited.push(over);
    }
    (shifted(&out, -law.lag_s * rate_hz), limited)
}

fn integral(w: &[f64], rate_hz: f64) -> Vec<f64> {
    let mut x = 0.0;
    w.iter()
        .map(|w| {
            x += w / rate_hz;
            x
        })
        .collect()
}

/// Mean sign of the motion over each sample, and where it rests. A passage through zero is placed
/// between samples by a straight line.
fn directions(omega: &[f64], threshold: f64, pause: usize) -> (Vec<f64>, Vec<bool>) {
    let n = omega.len();
    let mut sign = vec![0.0; n];
    for k in 0..n {
        let before = 0.5 * (omega[k] + omega[k.saturating_sub(1)]);
        let after = 0.5 * (omega[k] + omega[(k + 1).min(n - 1)]);
        sign[k] = if before * after < 0.0 {
            (before.abs() * before.signum() + after.abs() * after.signum()) / (before.abs() + after.abs())
        } else {
            omega[k].signum()
        };
    }
    // at rest: slower than the threshold for four samples or more
    let mut resting = vec![false; n];
    let mut k = 0;
    let mut last: Option<usize> = None;
    while k < n {
        let from = k;
        while k < n && omega[k].abs() < threshold {
            k += 1;
        }
        if k - from >= 4 {
            // noise that looks like motion for a moment does not end a rest
            let from = last.filter(|l| from - l <= pause).unwrap_or(from);
            resting[from..k].fill(true);
            last = Some(k);
        }
        k = k.max(from) + 1;
    }
    // friction turns over somewhere within the sample of a reversal, and may hold for a while
    for k in 1..n {
        if omega[k] * omega[k - 1] <= 0.0 {
            resting[k - 1] = true;
            resting[k] = true;
        }
    }
    (sign, resting)
}

/// Samples at which a signal steps by far more than it usually does.
fn transients(x: &[f64]) -> Vec<usize> {
    let mut steps: Vec<f64> = x.windows(2).map(|w| (w[1] - w[0]).abs()).collect();
    if steps.len() < 16 {
        return Vec::new();
    }
    let middle = steps.len() / 2;
    let usual = *steps.select_nth_unstable_by(middle, f64::total_cmp).1 / 0.6745;
    let (low, high) = recording::extent(x.iter().copied());
    let most = (TRANSIENT * usual).max(0.02 * (high - low));
    let found: Vec<usize> = (1..x.len()).filter(|&k| (x[k] - x[k - 1]).abs() > most).collect();
    if found.len() as f64 > MOST_TRANSIENT * x.len() as f64 {
        Vec::new()
    } else {
        found
    }
}

/// Samples at which a signal is far stronger than it usually is.
fn strong(x: &[f64]) -> Vec<usize> {
    let mut sizes: Vec<f64> = x.iter().map(|x| x.abs()).collect();
    let order = sizes.len() * 9 / 10;
    let usual = *sizes.select_nth_unstable_by(order, f64::total_cmp).1;
    (0..x.len()).filter(|&k| x[k].abs() > STRONG * usual).collect()
}

/// What a drive that is read at points does from sample to sample beyond a smooth course, rms of its torque [N m],
/// by its fourth differences; 0 where it is a mean.
pub fn swing(bench: &Bench, runs: &[Run]) -> f64 {
    let c = bench.rig.drive;
    if bench.channel(c).is_none_or(|s| s.mean) {
        return 0.0;
    }
    let moving = runs.iter().filter(|r| !r.steady);
    let usual = noise::roughness(moving.filter_map(|r| r.channel(c))).unwrap_or(0.0);
    bench.rig.drive_constant.value.abs() * usual
}

/// The noise of every channel of a bench.
pub fn noise_table(bench: &Bench, runs: &[Run]) -> NoiseTable {
    let specs = bench.channels.iter().filter(|c| c.channel != BenchChannel::Time);
    specs.map(|c| (c.channel, noise::noise(c, runs))).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_angle_sensor_out_of_centre_is_straightened() {
        let error = (0.04, -0.02);
        let (w, a) = (30.0, 200.0);
        let truth: Vec<f64> = (0..50).map(|k| 0.3 * k as f64).collect();
        let off = |t: f64| error.0 * t.sin() + error.1 * t.cos();
        let slope = |t: f64| 1.0 + error.0 * t.cos() - error.1 * t.sin();
        let measured = |of_angle: bool| {
            let theta: Vec<f64> = truth.iter().map(|t| t + off(*t)).collect();
            let speed = |t: &f64| if of_angle { w * slope(*t) } else { w };
            let accel = |t: &f64| if of_angle { a * slope(*t) - off(*t) * w * w } else { a };
            (
                theta,
                truth.iter().map(speed).collect(),
                truth.iter().map(accel).collect(),
            )
        };
        for of_angle in [true, false] {
            let (mut theta, mut omega, mut accel): (Vec<f64>, Vec<f64>, Vec<f64>) = measured(of_angle);
            straighten(error, of_angle, &mut theta, &mut omega, &mut accel);
            for k in 0..truth.len() {
                assert!((theta[k] - truth[k]).abs() < 1e-6, "{} {}", theta[k], truth[k]);
                assert!(
                    (omega[k] - w).abs() < 1e-4 && (accel[k] - a).abs() < 1e-2,
                    "{} {}",
                    omega[k],
                    accel[k]
                );
            }
        }
    }

    #[test]
    fn a_passage_through_zero_is_placed_between_samples() {
        let omega: Vec<f64> = (0..20).map(|k| k as f64 - 9.75).collect();
        let (sign, resting) = directions(&omega, 0.1, 0);
        assert_eq!(sign[8], -1.0);
        assert_eq!(sign[11], 1.0);
        // zero at 9.75: the sample around 10 (9.5..10.5) is a quarter negative
        assert!((sign[10] - 0.5).abs() < 1e-12, "{}", sign[10]);
        let held: Vec<usize> = (0..20).filter(|&k| resting[k]).collect();
        assert_eq!(held, [9, 10]);
    }
}
