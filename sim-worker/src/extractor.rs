//! Features from telemetry, streaming: no I/O, all state inside, and the same bits whatever the
//! size of the chunks (every sum runs sample by sample).

use crate::monitor::MonitorTrack;
use crate::onset::{Onset, OnsetPlan};
use crate::parameters::ActuatorParameters;
use crate::reversal::{ReversalPlan, ReversalTrack};
use crate::step_witness::{Sample, StepWitness};
use crate::suspect::{Jumps, Outlier, PhaseSum};
use crate::witness::{SineShape, SineWitness, imbalance, torque_current};
use schemas::channel::{Channel, ChannelSet};
use schemas::error::{Error, Result};
use schemas::feature::{Raw, RawFeatures};
use schemas::sequence::{Command, Segment, TestSequence};
use schemas::telemetry::{TelemetryHeader, TelemetrySink, TelemetryView};
use std::sync::Arc;

/// Start and end of P1's window after the step [s] (paper 4.2.1 "regime"; the figures are those
/// of the reference actuator's specification).
pub const REGIME_S: (f64, f64) = (0.20, 0.65);

/// Share of the no-load speed Vs/(2 ke) that ends the rise time: half of it is reached far from where
/// the controller takes the speed back, and where the current is still high (assumed).
const RISE_SHARE: f64 = 0.5;

/// Resolver counts that a motor position must leave rest by to count as moving.
const BREAKAWAY_COUNTS: f64 = 1.5;

/// Resolver resolution that break-away is counted in [bits a turn] (assumed).
const RESOLVER_BITS: u32 = 16;

/// Part of each line there and back over which the current is taken: between the transients of its ends (assumed).
const LEG_SHARES: (f64, f64) = (0.35, 0.98);

/// Sample numbers `from..=to`, counted from 1.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Window {
    /// first sample of the window
    pub from: u64,
    /// last sample of the window, included
    pub to: u64,
}

impl Window {
    /// Samples whose intervals lie in `start..end` [s].
    fn of(start_s: f64, end_s: f64, rate_hz: f64) -> Self {
        let from = (start_s * rate_hz - 1e-6).ceil() as u64 + 1;
        Self {
            from,
            to: (end_s * rate_hz + 1e-6).floor() as u64,
        }
    }

    /// Samples in the window.
    pub fn len(self) -> u64 {
        (self.to + 1).saturating_sub(self.from)
    }

    /// Whether it has no sample.
    pub fn is_empty(self) -> bool {
        self.len() == 0
    }

    /// Rows of a view that lie in the window.
    fn rows(self, view: &TelemetryView<'_>) -> std::ops::Range<usize> {
        let end = view.first + view.rows as u64;
        let from = self.from.clamp(view.first, end);
        let to = (self.to + 1).clamp(from, end);
        (from - view.first) as usize..(to - view.first) as usize
    }
}

/// Which samples of a sequence carry which feature, and what they are compared with: made once
/// per actuator, sequence and rate, shared by all extractors.
#[derive(Clone, Debug, PartialEq)]
pub struct FeaturePlan {
    /// telemetry rate [Hz]
    pub rate_hz: f64,
    /// N, motor to user
    pub gear_ratio: f64,
    /// name of the sequence
    pub sequence: String,
    /// samples of the whole sequence
    pub rows: u64,
    /// P1's window; none without a step long enough
    pub regime: Option<Window>,
    /// the whole sine, for P2; none without one
    pub sine: Option<Window>,
    /// the whole ramp, for P3; none without one
    pub ramp: Option<Window>,
    /// from the step to the end of the regime window
    pub step: Option<Window>,
    /// motor speed that ends the rise time [rad/s]
    rise_rad_per_s: f64,
    sine_shape: SineShape,
    /// height of the step: its sign is the direction of motion [rad]
    pub step_rad: f64,
    onset: Option<OnsetPlan>,
    /// the whole slow cosine; none without one
    pub slow: Option<ReversalPlan>,
    /// the steady parts of the first line and of the one back that follows it; none without both
    pub legs: Option<[Window; 2]>,
    /// direction of the first of them
    leg_sign: f64,
    /// |Im| of the simplified model over `sine` [A]
    monitor_a: Vec<f64>,
    equivalent_current: bool,
}

impl FeaturePlan {
    /// Runs the simplified model through `sequence` at `rate_hz` for P2. `equivalent_current`: P2
    /// from i_eq, for telemetry without phase currents.
    pub fn new(actuator: &ActuatorParameters, sequence: &TestSequence, rate_hz: f64, equivalent_current: bool) -> Self {
        let window = |is: fn(&Command) -> bool, from: f64, to: f64| {
            let s = sequence.segment(is)?;
            let w = Window::of(s.start_s + from, s.start_s + s.duration_s.min(to), rate_hz);
            (!w.is_empty()).then_some(w)
        };
        let regime = window(|c| matches!(c, Command::Step { .. }), REGIME_S.0, REGIME_S.1);
        let sine = window(|c| matches!(c, Command::Sine { .. }), 0.0, f64::INFINITY);
        let ramp = window(|c| matches!(c, Command::Ramp { .. }), 0.0, f64::INFINITY);
        let step = window(|c| matches!(c, Command::Step { .. }), 0.0, REGIME_S.1);
        let no_load_rad_per_s = actuator.supply_voltage_v / (2.0 * actuator.back_emf_v_s_per_rad);
        // a sequence without sine has no samples to look at
        let (amplitude_rad, frequency_hz) = sequence
            .segments
            .iter()
            .find_map(|s| match s.command {
                Command::Sine {
                    amplitude_rad,
                    frequency_hz,
                } => Some((amplitude_rad, frequency_hz)),
                _ => None,
            })
            .unwrap_or((1.0, 1.0));
        let amplitude_rad = amplitude_rad.abs() * actuator.gear_ratio;
        let sine_shape = SineShape {
            pole_pairs: f64::from(actuator.pole_pairs),
            amplitude_rad,
            speed_rad_per_s: std::f64::consts::TAU * frequency_hz * amplitude_rad,
        };
        let step_rad = sequence.segments.iter().find_map(|s| {
            if let Command::Step { height_rad } = s.command {
                Some(height_rad)
            } else {
                None
            }
        });
        let monitor_a = sine.map_or(Vec::new(), |w| {
            let track = MonitorTrack::run(actuator, sequence, rate_hz);
            track.abs_current_a[w.from as usize - 1..w.to as usize].to_vec()
        });
        let onset = step_rad
            .filter(|_| step.is_some())
            .and_then(|height| OnsetPlan::new(actuator, height, rate_hz, no_load_rad_per_s));
        let slow = sequence.segments.iter().find_map(|s| match s.command {
            Command::Cosine {
                amplitude_rad,
                frequency_hz,
            } => Some(ReversalPlan {
                window: Window::of(s.start_s, s.start_s + s.duration_s, rate_hz),
                frequency_hz,
                rate_hz,
                sign: 1f64.copysign(amplitude_rad),
                count_rad: std::f64::consts::TAU / (1u64 << RESOLVER_BITS) as f64,
            }),
            _ => None,
        });
        let slow = slow.filter(ReversalPlan::serves);
        let slope = |s: &Segment| match s.command {
            Command::Line { slope_rad_per_s, .. } => slope_rad_per_s,
            _ => 0.0,
        };
        let legs = sequence.segments.windows(2).find(|w| slope(&w[0]) * slope(&w[1]) < 0.0);
        let leg_sign = legs.map_or(1.0, |w| 1f64.copysign(slope(&w[0])));
        let legs = legs.map(|w| {
            [0, 1].map(|k| {
                let at = |share: f64| w[k].start_s + share * w[k].duration_s;
                Window::of(at(LEG_SHARES.0), at(LEG_SHARES.1), rate_hz)
            })
        });
        Self {
            slow,
            legs: legs.filter(|l| !l[0].is_empty() && !l[1].is_empty()),
            leg_sign,
            onset,
            rate_hz,
            gear_ratio: actuator.gear_ratio,
            sequence: sequence.name.clone(),
            rows: (sequence.duration_s() * rate_hz + 1e-6).floor() as u64,
            regime,
            sine,
            ramp,
            step,
            sine_shape,
            rise_rad_per_s: RISE_SHARE * no_load_rad_per_s,
            step_rad: step_rad.unwrap_or(0.0),
            monitor_a,
            equivalent_current,
        }
    }

    fn pole_pairs(&self) -> f64 {
        self.sine_shape.pole_pairs
    }

    /// Whether P2 must come from i_eq, because phase currents are missing.
    ///
    /// * `has` whether a channel is there
    pub fn lacks_phases(has: impl Fn(Channel) -> bool) -> bool {
        ![Channel::IA, Channel::IB, Channel::IC].into_iter().all(has)
    }

    /// P2 from i_eq, for telemetry without phase currents.
    pub fn equivalent_current(&self) -> bool {
        self.equivalent_current
    }

    /// The channels that the features are made from.
    pub fn channels(&self) -> ChannelSet {
        Self::channels_of(self.equivalent_current)
    }

    /// The same, and those that say more where a test has them.
    pub fn wanted(&self) -> ChannelSet {
        match self.slow {
            Some(_) => self.channels().with(Channel::VDc),
            None => self.channels(),
        }
    }

    /// As [`FeaturePlan::wanted`] of a test of `sequence`, without a plan.
    pub fn wanted_of(sequence: &TestSequence, equivalent_current: bool) -> ChannelSet {
        let channels = Self::channels_of(equivalent_current);
        match sequence.segment(|c| matches!(c, Command::Cosine { .. })) {
            Some(_) => channels.with(Channel::VDc),
            None => channels,
        }
    }

    /// As [`FeaturePlan::channels`], without a plan.
    pub fn channels_of(equivalent_current: bool) -> ChannelSet {
        use Channel::{Com, IA, IB, IC, IEq, OmegaM, ThetaM};
        let phases = ChannelSet::of([Com, ThetaM, OmegaM, IA, IB, IC]);
        if equivalent_current { phases.with(IEq) } else { phases }
    }

    fn windows(&self) -> impl Iterator<Item = Window> {
        let of_all = [
            self.regime,
            self.sine,
            self.ramp,
            self.step,
            self.slow.map(|s| s.window),
        ];
        of_all.into_iter().flatten().chain(self.legs.into_iter().flatten())
    }

    /// Whether any of the samples `first..first + rows` matters to a feature.
    pub fn needs(&self, first: u64, rows: usize) -> bool {
        let last = first + rows as u64 - 1;
        first == 1 || self.windows().any(|w| w.from <= last && first <= w.to)
    }
}

/// A feature's number of samples, seen and wanted.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Progress {
    /// samples of the window that have come
    pub seen: u64,
    /// samples of the whole window
    pub wanted: u64,
}

/// Whether a window is complete.
fn whole(window: Option<Window>, seen: u64) -> bool {
    window.is_some_and(|w| w.len() == seen)
}

/// What was measured and cannot be true.
struct Suspects {
    /// of the speed in the regime window [rad/s]
    jump: Option<Outlier>,
    /// of the sum of the phase currents [A]
    regime_sum: Option<Outlier>,
    sine_sum: Option<Outlier>,
    /// by how much the currents are late, negative where the speed is [s]
    late_s: Option<f64>,
}

/// Streaming extractor of one run.
#[derive(Clone, Debug)]
pub struct FeatureExtractor {
    plan: Arc<FeaturePlan>,
    rest_rad: Option<f64>,
    // regime: sums of the user speed less its first value there
    regime_seen: u64,
    shift: f64,
    sum: f64,
    sum2: f64,
    current_seen: u64,
    /// by phase
    current_sum2: [f64; 3],
    // step: samples seen without a gap, speed of the last of them
    step_seen: u64,
    step_speed: f64,
    /// reached by one sample; the next one confirms it, since one sample may be off
    rise_pending_s: Option<f64>,
    rise_s: Option<f64>,
    onset: Onset,
    step_witness: StepWitness,
    // what cannot be true
    regime_sum: PhaseSum,
    regime_jumps: Jumps,
    sine_phase_sum: PhaseSum,
    // sine
    sine_seen: u64,
    sine_sum2: f64,
    witness: SineWitness,
    // ramp
    ramp_seen: u64,
    /// off rest for one sample; the next one confirms it
    breakaway_pending_rad: Option<f64>,
    breakaway_rad: Option<f64>,
    // slow cosine, lines, supply
    reversals: Option<ReversalTrack>,
    /// sums of the torque-giving current and samples, there and back
    legs: [(f64, u64); 2],
    supply: (f64, u64),
}

impl FeatureExtractor {
    /// Nothing seen yet.
    pub fn new(plan: Arc<FeaturePlan>) -> Self {
        Self {
            reversals: plan.slow.map(ReversalTrack::new),
            legs: Default::default(),
            supply: Default::default(),
            plan,
            rest_rad: None,
            regime_seen: 0,
            shift: 0.0,
            sum: 0.0,
            sum2: 0.0,
            current_seen: 0,
            current_sum2: [0.0; 3],
            step_seen: 0,
            step_speed: 0.0,
            rise_pending_s: None,
            rise_s: None,
            onset: Onset::default(),
            step_witness: StepWitness::default(),
            regime_sum: PhaseSum::default(),
            regime_jumps: Jumps::default(),
            sine_phase_sum: PhaseSum::default(),
            sine_seen: 0,
            sine_sum2: 0.0,
            witness: SineWitness::default(),
            ramp_seen: 0,
            breakaway_pending_rad: None,
            breakaway_rad: None,
        }
    }

    /// What it extracts.
    pub fn plan(&self) -> &FeaturePlan {
        &self.plan
    }

    /// Takes the next samples. Gaps are allowed: features whose window has one stay incomplete.
    pub fn push(&mut self, view: &TelemetryView<'_>) {
        if view.rows == 0 {
            return;
        }
        let theta = view.column(Channel::ThetaM);
        if self.rest_rad.is_none() && view.first == 1 {
            self.rest_rad = theta.map(|t| t[0]);
        }
        if let (Some(w), Some(omega)) = (self.plan.regime, view.column(Channel::OmegaM)) {
            let inv_n = 1.0 / self.plan.gear_ratio;
            let rows = w.rows(view);
            let first = view.first + rows.start as u64;
            for (&x, sample) in omega[rows].iter().zip(first..) {
                self.regime_jumps.push(sample, x);
                let u = x * inv_n;
                if self.regime_seen == 0 {
                    self.shift = u;
                }
                let d = u - self.shift;
                self.sum += d;
                self.sum2 += d * d;
                self.regime_seen += 1;
            }
        }
        let phases = [Channel::IA, Channel::IB, Channel::IC].map(|c| view.column(c));
        if let (Some(w), [Some(a), Some(b), Some(c)]) = (self.plan.regime, phases) {
            let rows = w.rows(view);
            for i in rows.clone() {
                self.regime_sum.push(view.first + i as u64, [a[i], b[i], c[i]]);
                for (sum, x) in self.current_sum2.iter_mut().zip([a[i], b[i], c[i]]) {
                    *sum += x * x;
                }
            }
            self.current_seen += rows.len() as u64;
        }
        if let (Some(w), Some(omega), None) = (self.plan.step, view.column(Channel::OmegaM), self.rise_s) {
            self.rise(w, view.first, &omega[w.rows(view)]);
        }
        self.begin(view, phases);
        self.watch_step(view, phases);
        if let Some(w) = self.plan.sine {
            let rows = w.rows(view);
            self.witness.push(&self.plan.sine_shape, view, rows.clone());
            let from = (view.first + rows.start as u64 - w.from.min(view.first + rows.start as u64)) as usize;
            let monitor = &self.plan.monitor_a[from.min(self.plan.monitor_a.len())..];
            if let ([Some(a), Some(b), Some(c)], false) = (phases, self.plan.equivalent_current) {
                for (i, m) in rows.clone().zip(monitor) {
                    let phases = [a[i], b[i], c[i]];
                    let d = 0.5 * (phases[0].abs() + phases[1].abs() + phases[2].abs()) - m;
                    self.sine_sum2 += d * d;
                    self.sine_phase_sum.push(view.first + i as u64, phases);
                }
                self.sine_seen += rows.len() as u64;
            } else if let Some(i) = view.column(Channel::IEq) {
                for (i, m) in i[rows.clone()].iter().zip(monitor) {
                    let d = i - m;
                    self.sine_sum2 += d * d;
                }
                self.sine_seen += rows.len() as u64;
            }
        }
        if let (Some(theta), [Some(a), Some(b), Some(c)], false) = (theta, phases, self.plan.equivalent_current) {
            let current = |i: usize| torque_current(self.plan.pole_pairs(), theta[i], [a[i], b[i], c[i]]);
            if let Some(r) = &mut self.reversals {
                let w = r.window();
                let rows = w.rows(view);
                // what comes after a gap is not taken
                if view.first + rows.start as u64 == w.from + r.seen() {
                    rows.for_each(|i| r.push(theta[i], current(i)));
                }
            }
            for (w, (sum, seen)) in self.plan.legs.iter().flatten().zip(&mut self.legs) {
                let rows = w.rows(view);
                *seen += rows.len() as u64;
                rows.for_each(|i| *sum += current(i));
            }
        }
        if let (Some(w), Some(v), Some(_)) = (self.plan.regime, view.column(Channel::VDc), self.plan.slow) {
            let rows = w.rows(view);
            self.supply.1 += rows.len() as u64;
            v[rows].iter().for_each(|v| self.supply.0 += v);
        }
        if let (Some(w), Some(theta), Some(com)) = (self.plan.ramp, theta, view.column(Channel::Com)) {
            let rows = w.rows(view);
            // after a gap the first sample off rest is not the break-away
            let unbroken = view.first + rows.start as u64 == w.from + self.ramp_seen;
            self.ramp_seen += rows.len() as u64;
            if let (None, Some(rest), true) = (self.breakaway_rad, self.rest_rad, unbroken) {
                let limit = BREAKAWAY_COUNTS * std::f64::consts::TAU / (1u64 << RESOLVER_BITS) as f64;
                for i in rows {
                    let off = (theta[i] - rest).abs() > limit;
                    if off && self.breakaway_pending_rad.is_some() {
                        self.breakaway_rad = self.breakaway_pending_rad;
                        break;
                    }
                    self.breakaway_pending_rad = off.then_some(com[i]);
                }
            }
        }
    }

    /// Looks for the first sample of the step's window `w` whose speed has reached the end of the rise,
    /// straight between it and the sample before. After a gap the first is not the one that comes first.
    fn rise(&mut self, w: Window, first: u64, omega: &[f64]) {
        let begin = first.max(w.from);
        if omega.is_empty() || begin != w.from + self.step_seen {
            return;
        }
        let (limit, sign) = (self.plan.rise_rad_per_s, 1f64.copysign(self.plan.step_rad));
        for &omega in omega {
            let (before, now) = (self.step_speed, sign * omega);
            // sample n of the window is the value at its end, n intervals after the step
            if now >= limit && self.rise_pending_s.is_some() {
                self.rise_s = self.rise_pending_s;
                return;
            }
            let share = (limit - before) / (now - before);
            self.rise_pending_s = (now >= limit).then(|| (self.step_seen as f64 + share) / self.plan.rate_hz);
            self.step_speed = now;
            self.step_seen += 1;
        }
    }

    /// Follows current and speed from the step on, until both have risen; after a gap no more.
    fn begin(&mut self, view: &TelemetryView<'_>, phases: [Option<&[f64]>; 3]) {
        let (Some(w), Some(plan), Some(omega)) = (self.plan.step, self.plan.onset, view.column(Channel::OmegaM)) else {
            return;
        };
        let rows = w.rows(view);
        let first = view.first + rows.start as u64;
        if rows.is_empty() || self.onset.is_known() || first != w.from + self.onset.seen() {
            return;
        }
        let sign = 1f64.copysign(self.plan.step_rad);
        let single = view.column(Channel::IEq);
        for i in rows {
            let current = match (phases, single) {
                ([Some(a), Some(b), Some(c)], _) => 0.5 * (a[i].abs() + b[i].abs() + c[i].abs()),
                (_, Some(eq)) => eq[i],
                _ => return,
            };
            self.onset.push(&plan, sign * omega[i], current);
        }
    }

    /// Follows the step for its witnesses; the run-up not after a gap.
    fn watch_step(&mut self, view: &TelemetryView<'_>, phases: [Option<&[f64]>; 3]) {
        let motion = (view.column(Channel::ThetaM), view.column(Channel::OmegaM));
        let ((Some(theta), Some(omega)), [Some(a), Some(b), Some(c)], false) =
            (motion, phases, self.plan.equivalent_current)
        else {
            return;
        };
        let (pole_pairs, sign) = (self.plan.pole_pairs(), 1f64.copysign(self.plan.step_rad));
        let sample = |i: usize| Sample {
            theta_rad: theta[i],
            omega_rad_per_s: omega[i],
            phases_a: [a[i], b[i], c[i]],
        };
        if let (Some(w), false) = (self.plan.step, self.step_witness.has_run_up()) {
            let rows = w.rows(view);
            if view.first + rows.start as u64 == w.from + self.step_witness.run_up_seen() {
                let end = self.plan.rise_rad_per_s;
                rows.for_each(|i| self.step_witness.push_run_up(sample(i), pole_pairs, sign, end));
            }
        }
        if let Some(w) = self.plan.regime {
            let middle = w.from + w.len() / 2;
            for i in w.rows(view) {
                let second = view.first + i as u64 >= middle;
                self.step_witness.push_regime(sample(i), pole_pairs, sign, second);
            }
        }
    }

    /// What cannot be true, in windows that are complete.
    fn suspects(&self) -> Suspects {
        let (regime, sine) = (self.plan.regime, self.plan.sine);
        let within = |w, seen, found: Option<Outlier>| found.filter(|_| whole(w, seen));
        Suspects {
            jump: within(regime, self.regime_seen, self.regime_jumps.outlier()),
            regime_sum: within(regime, self.current_seen, self.regime_sum.outlier()),
            sine_sum: within(sine, self.sine_seen, self.sine_phase_sum.outlier()),
            late_s: self.plan.onset.and_then(|plan| self.onset.late_s(&plan)),
        }
    }

    /// Motor angle at sample 1, once it has come [rad].
    pub fn rest_angle_rad(&self) -> Option<f64> {
        self.rest_rad
    }

    /// Whether nothing that comes can add to the features.
    pub fn is_complete(&self) -> bool {
        let legs = self.plan.legs.iter().flatten().zip(self.legs);
        let slow = self.reversals.as_ref().is_none_or(|r| r.seen() >= r.window().len());
        let finer = self.plan.equivalent_current || slow && legs.into_iter().all(|(w, (_, seen))| seen >= w.len());
        finer && self.progress().iter().flatten().all(|p| p.seen >= p.wanted)
    }

    /// Number of raw features measured so far: it grows where a window ends, at break-away and at the end of the
    /// rise, since each of these lets the maps say more.
    pub fn count(&self) -> usize {
        self.features().values().iter().flatten().count()
    }

    /// Samples seen and wanted for each window: step, sine, ramp.
    pub fn progress(&self) -> [Option<Progress>; 3] {
        let p = |w: Option<Window>, seen| w.map(|w| Progress { seen, wanted: w.len() });
        [
            p(self.plan.regime, self.regime_seen),
            p(self.plan.sine, self.sine_seen),
            p(self.plan.ramp, self.ramp_seen),
        ]
    }

    /// What has been measured; a feature whose window is not complete is `None`.
    pub fn features(&self) -> RawFeatures {
        let n = self.regime_seen as f64;
        let regime = whole(self.plan.regime, self.regime_seen);
        let mean = self.sum / n;
        let phases = whole(self.plan.regime, self.current_seen) && !self.plan.equivalent_current;
        let sine = whole(self.plan.sine, self.sine_seen);
        let suspect = self.suspects();
        let speed_holds = regime && suspect.jump.is_none();
        let regime_holds = phases && suspect.regime_sum.is_none() && suspect.late_s.is_none();
        let sine_holds = sine && suspect.sine_sum.is_none() && suspect.late_s.is_none();
        let even = self.witness.even_current_a().filter(|_| sine_holds);
        let shape = sine_holds.then(|| self.witness.kinetic_shape_a()).flatten();
        let turning = (regime_holds && speed_holds)
            .then(|| self.step_witness.turning())
            .flatten();
        let reversals = self.reversals.as_ref().and_then(ReversalTrack::found);
        let reversals = reversals.filter(|_| suspect.late_s.is_none());
        let value = |raw| match raw {
            // a step down runs with negative speed: the mean is counted in the step's direction
            Raw::MeanSpeed => speed_holds.then(|| (self.shift + mean) * 1f64.copysign(self.plan.step_rad)),
            Raw::Ripple => speed_holds.then(|| (self.sum2 / n - mean * mean).max(0.0).sqrt()),
            Raw::P2 => sine_holds.then(|| (self.sine_sum2 / self.sine_seen as f64).sqrt()),
            Raw::P3 => self.breakaway_rad,
            Raw::Rise => self.rise_s,
            Raw::CurrentRms => {
                regime_holds.then(|| (self.current_sum2.iter().sum::<f64>() / (3.0 * self.current_seen as f64)).sqrt())
            }
            Raw::SineTravel => self.witness.travel_rad().filter(|_| sine),
            Raw::CurrentSum => self.witness.current_sum_a().filter(|_| sine_holds),
            Raw::CurrentImbalance => imbalance(self.current_sum2).filter(|_| regime_holds),
            Raw::EvenCurrent => even.map(|e| e.1),
            Raw::BiasCurrent => even.map(|e| e.0),
            Raw::KineticCurrent => self.witness.kinetic_current_a().filter(|_| sine_holds),
            Raw::SlowBreakAway => reversals.map(|r| r.break_away_a),
            Raw::SlowKinetic => reversals.map(|r| r.kinetic_a),
            Raw::SlowLag => reversals.map(|r| r.lag_s),
            Raw::LegCurrent => self.leg_current_a().filter(|_| suspect.late_s.is_none()),
            Raw::Supply => whole(self.plan.regime, self.supply.1)
                .then(|| self.supply.0 / self.supply.1 as f64)
                .filter(|v| v.is_finite()),
            Raw::ThirdCosine => turning.map(|t| t.third_cosine),
            Raw::ThirdSine => turning.map(|t| t.third_sine),
            Raw::OtherOrders => turning.map(|t| t.others),
            Raw::CurrentTrend => self.step_witness.current_trend_a().filter(|_| regime_holds),
            Raw::RunUpCurrent => self
                .step_witness
                .run_up_current_a()
                .filter(|_| suspect.late_s.is_none()),
            Raw::KineticTilt => shape.map(|s| s.0),
            Raw::KineticBend => shape.map(|s| s.1),
        };
        let rest = self.rest_rad.map(|r| r.rem_euclid(std::f64::consts::TAU));
        RawFeatures::from_values(Raw::ALL.map(value), rest)
    }

    /// Half the difference of the mean currents there and back, once both have come [A].
    fn leg_current_a(&self) -> Option<f64> {
        let [there, back] = self.plan.legs?;
        let all = whole(Some(there), self.legs[0].1) && whole(Some(back), self.legs[1].1);
        let mean = |k: usize| self.legs[k].0 / self.legs[k].1 as f64;
        all.then(|| 0.5 * (mean(0) - mean(1)) * self.plan.leg_sign)
    }

    /// What is missing, in words; empty when every feature of the sequence is there.
    pub fn missing(&self) -> Vec<String> {
        let mut v = Vec::new();
        let names = ["step window (P1, ripple)", "sine (P2)", "ramp (P3)"];
        for (name, p) in names.iter().zip(self.progress()) {
            match p {
                None => v.push(format!("{name}: not in sequence `{}`", self.plan.sequence)),
                Some(p) if p.seen < p.wanted => v.push(format!("{name}: {} of {} samples", p.seen, p.wanted)),
                _ => {}
            }
        }
        if let (Some(slow), Some(r), false) = (self.plan.slow, &self.reversals, self.plan.equivalent_current) {
            let wanted = slow.window.len();
            if r.seen() < wanted {
                v.push(format!("slow cosine: {} of {wanted} samples without a gap", r.seen()));
            } else if r.found().is_none() {
                v.push("slow cosine: the motor does not come to rest and leave it again in both directions".into());
            }
        }
        for (w, (_, seen)) in self.plan.legs.iter().flatten().zip(self.legs) {
            if seen < w.len() && !self.plan.equivalent_current {
                v.push(format!("lines there and back: {seen} of {} samples", w.len()));
            }
        }
        if self.plan.ramp.is_some() && self.breakaway_rad.is_none() && self.rest_rad.is_none() {
            v.push("rest position: sample 1 is missing".into());
        } else if whole(self.plan.ramp, self.ramp_seen) && self.breakaway_rad.is_none() {
            v.push("P3: the motor does not leave rest in the ramp".into());
        }
        v.extend(self.untrue());
        v
    }

    /// What was measured and cannot be true, in words; the features that it enters are left out.
    fn untrue(&self) -> Vec<String> {
        let Suspects {
            jump,
            regime_sum,
            sine_sum,
            late_s,
        } = self.suspects();
        let outlier = |window: &str, o: Outlier, what: String| {
            let time_s = o.sample as f64 / self.plan.rate_hz;
            format!(
                "{window}: sample {} ({time_s:.4} s) is no measurement: {what}, far beyond all others",
                o.sample
            )
        };
        let mut v = Vec::new();
        for (window, found) in [("step", regime_sum), ("sine", sine_sum)] {
            v.extend(found.map(|o| outlier(window, o, format!("the phase currents sum to {:.2} A", o.size))));
        }
        v.extend(jump.map(|o| outlier("step", o, format!("the speed jumps by {:.1} rad/s and back", o.size))));
        v.extend(late_s.map(|late| {
            let (one, other) = if late > 0.0 {
                ("current", "speed")
            } else {
                ("speed", "current")
            };
            format!(
                "step: the {one} comes {:.2} ms later than the {other} says",
                1e3 * late.abs()
            )
        }));
        v
    }
}

impl TelemetrySink for FeatureExtractor {
    fn accept(&mut self, header: &TelemetryHeader, view: &TelemetryView<'_>) -> Result<()> {
        if header.sequence != self.plan.sequence {
            return Err(Error::bad(
                "telemetry",
                "sequence",
                &header.sequence,
                &self.plan.sequence,
            ));
        }
        self.push(view);
        Ok(())
    }
}
