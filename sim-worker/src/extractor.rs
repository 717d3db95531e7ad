//! Features from telemetry, streaming: no I/O, all state inside, and the same bits whatever the
//! size of the chunks (every sum runs sample by sample).

mod plan;

pub use plan::{FeaturePlan, REGIME_S, Window};

use crate::onset::Onset;
use crate::reversal::ReversalTrack;
use crate::sensor::{SpeedOfAngle, SpeedSource};
use crate::step_witness::{Sample, StepWitness};
use crate::suspect::{Jumps, Outlier, PhaseSum};
use crate::witness::{SineWitness, imbalance, torque_current};
use plan::RESOLVER_BITS;
use schemas::channel::Channel;
use schemas::error::{Error, Result};
use schemas::feature::{Raw, RawFeatures};
use schemas::telemetry::{TelemetryBuffer, TelemetryHeader, TelemetrySink, TelemetryView};
use std::sync::Arc;

/// Resolver counts that a motor position must leave rest by to count as moving.
const BREAKAWAY_COUNTS: f64 = 1.5;

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
    of_angle: Option<OfAngle>,
}

/// Telemetry whose speed is the mean one of the angle over a moment.
#[derive(Clone, Debug)]
struct OfAngle {
    samples: TelemetryBuffer,
    speed: SpeedOfAngle,
}

impl OfAngle {
    /// Takes the next samples, with that speed.
    fn take(&mut self, view: &TelemetryView<'_>) {
        self.samples.copy_from(view);
        let Some(theta) = view.column(Channel::ThetaM) else {
            return;
        };
        let speeds = self.samples.column_mut(Channel::OmegaM);
        for ((o, &x), n) in speeds.into_iter().flatten().zip(theta).zip(view.first..) {
            *o = self.speed.next(n, x);
        }
    }
}

impl FeatureExtractor {
    /// Nothing seen yet.
    pub fn new(plan: Arc<FeaturePlan>) -> Self {
        Self {
            reversals: plan.slow.map(ReversalTrack::new),
            legs: Default::default(),
            supply: Default::default(),
            of_angle: (plan.sampling.speed == SpeedSource::Angle).then(|| OfAngle {
                samples: TelemetryBuffer::new(plan.wanted(), 128),
                speed: SpeedOfAngle::new(plan.rate_hz),
            }),
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
        if let Some(mut of_angle) = self.of_angle.take() {
            of_angle.take(view);
            self.take(&of_angle.samples.view());
            self.of_angle = Some(of_angle);
        } else {
            self.take(view);
        }
    }

    /// As [`FeatureExtractor::push`], of samples whose speed is what it is to be.
    fn take(&mut self, view: &TelemetryView<'_>) {
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
