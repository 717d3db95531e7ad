//! Which samples of a test carry which feature, and what they are compared with.

use crate::monitor::MonitorTrack;
use crate::onset::OnsetPlan;
use crate::parameters::ActuatorParameters;
use crate::reversal::ReversalPlan;
use crate::sensor::{Sampling, SpeedOfAngle, SpeedSource};
use crate::witness::SineShape;
use schemas::channel::{Channel, ChannelSet};
use schemas::sequence::{Command, Segment, TestSequence};
use schemas::telemetry::TelemetryView;

/// Start and end of P1's window after the step [s] (paper 4.2.1 "regime"; the figures are those
/// of the reference actuator's specification).
pub const REGIME_S: (f64, f64) = (0.20, 0.65);

/// Share of the no-load speed Vs/(2 ke) that ends the rise time: half of it is reached far from where
/// the controller takes the speed back, and where the current is still high (assumed).
const RISE_SHARE: f64 = 0.5;

/// Resolver resolution that break-away is counted in [bits a turn] (assumed).
pub(super) const RESOLVER_BITS: u32 = 16;

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
    pub(super) fn of(start_s: f64, end_s: f64, rate_hz: f64) -> Self {
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
    pub(super) fn rows(self, view: &TelemetryView<'_>) -> std::ops::Range<usize> {
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
    pub(super) rise_rad_per_s: f64,
    pub(super) sine_shape: SineShape,
    /// height of the step: its sign is the direction of motion [rad]
    pub step_rad: f64,
    pub(super) onset: Option<OnsetPlan>,
    /// the whole slow cosine; none without one
    pub slow: Option<ReversalPlan>,
    /// the steady parts of the first line and of the one back that follows it; none without both
    pub legs: Option<[Window; 2]>,
    /// direction of the first of them
    pub(super) leg_sign: f64,
    /// |Im| of the simplified model over `sine` [A]
    pub(super) monitor_a: Vec<f64>,
    pub(super) equivalent_current: bool,
    pub(super) sampling: Sampling,
}

impl FeaturePlan {
    /// Runs the simplified model through `sequence` at `rate_hz` for P2. `equivalent_current`: P2
    /// from i_eq, for telemetry without phase currents. `sampling`: what samples are.
    pub fn new(
        actuator: &ActuatorParameters,
        sequence: &TestSequence,
        rate_hz: f64,
        equivalent_current: bool,
        sampling: Sampling,
    ) -> Self {
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
            .and_then(|height| OnsetPlan::new(actuator, height, rate_hz, sampling, no_load_rad_per_s));
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
            sampling,
        }
    }

    /// The same for runs whose channels are known to be in time: at the points of a map whatever a rotor looks like, its currents
    /// are no later than its speed, and a map needs all of them.
    pub fn in_time(self) -> Self {
        Self { onset: None, ..self }
    }

    pub(super) fn pole_pairs(&self) -> f64 {
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
        let before = match self.sampling.speed {
            SpeedSource::Sensor => 0,
            SpeedSource::Angle => SpeedOfAngle::samples(self.rate_hz) as u64,
        };
        first == 1 || self.windows().any(|w| w.from <= last + before && first <= w.to)
    }
}
