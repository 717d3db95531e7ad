//! When current and speed begin to rise after the step: the current drives the speed, so that a channel that comes
//! late shows, whatever the faults.

use crate::parameters::ActuatorParameters;
use crate::sensor::{Sampling, SpeedOfAngle, SpeedSource};
use crate::simulate::{Experiment, Run, simulate};
use crate::test_bench::Lane;
use schemas::channel::{Channel, ChannelSet};
use schemas::error::Result;
use schemas::fault::FaultState;
use schemas::sequence::{Command, Segment, TestSequence};
use schemas::telemetry::{TelemetryHeader, TelemetrySink, TelemetryView};
use std::sync::Arc;

/// Shares of the no-load speed between which the speed is taken to rise straight (assumed).
const SPEED_SHARES: (f64, f64) = (0.05, 0.15);

/// Share of the greatest current of the healthy actuator's step at which the current counts as risen (assumed).
const CURRENT_SHARE: f64 = 0.5;

/// Step that is simulated to know what to expect [s].
const SIMULATED_S: f64 = 0.02;

/// Lateness of a channel that is borne, and its share of a sample (assumed; simulated tests of units of spread `fleet`
/// at any fault stay within half of it at 10 kHz). A current that rises within a sample crosses a level within it somewhere: at
/// 2.5 kHz some faults and rest angles look 0.17 ms late.
const MOST_LATE: (f64, f64) = (0.15e-3, 0.3);

/// Levels that are looked for, and how much later the current should reach its own than the speed leaves rest.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OnsetPlan {
    /// of the motor speed in the step's direction [rad/s]
    speed_rad_per_s: (f64, f64),
    /// of the equivalent current [A]
    current_a: f64,
    /// [s]
    lag_s: f64,
    rate_hz: f64,
}

impl OnsetPlan {
    /// From a step of the healthy actuator; none where it is too short, too small or too slow to tell.
    ///
    /// * `height_rad` of the step [rad, user side]
    /// * `sampling` what samples are
    /// * `no_load_rad_per_s` of the motor
    pub fn new(
        actuator: &ActuatorParameters,
        height_rad: f64,
        rate_hz: f64,
        sampling: Sampling,
        no_load_rad_per_s: f64,
    ) -> Option<Self> {
        let step = simulated(actuator, height_rad, rate_hz, sampling).ok()?;
        let greatest = step.rows.iter().fold(0.0, |most: f64, r| most.max(r.1));
        let (slow, fast) = SPEED_SHARES;
        let mut plan = Self {
            speed_rad_per_s: (slow * no_load_rad_per_s, fast * no_load_rad_per_s),
            current_a: CURRENT_SHARE * greatest,
            lag_s: 0.0,
            rate_hz,
        };
        let mut onset = Onset::default();
        for (speed, current) in step.rows {
            onset.push(&plan, speed, current);
        }
        plan.lag_s = onset.lag_s(&plan)?;
        Some(plan)
    }
}

/// The first crossing of a level, straight between two samples [intervals after the step].
#[derive(Clone, Copy, Debug, Default)]
struct Crossing {
    before: f64,
    at: Option<f64>,
}

impl Crossing {
    fn push(&mut self, seen: u64, x: f64, level: f64) {
        if self.at.is_none() && x >= level {
            self.at = Some(seen as f64 + (level - self.before) / (x - self.before));
        }
        self.before = x;
    }
}

/// Follows a step from its first sample.
#[derive(Clone, Copy, Debug, Default)]
pub struct Onset {
    seen: u64,
    current: Crossing,
    speed: [Crossing; 2],
}

impl Onset {
    /// Takes the next sample; the first is the one that ends an interval after the step.
    ///
    /// * `speed` of the motor in the step's direction [rad/s]
    /// * `current` equivalent one [A]
    pub fn push(&mut self, plan: &OnsetPlan, speed: f64, current: f64) {
        self.current.push(self.seen, current, plan.current_a);
        let (slow, fast) = plan.speed_rad_per_s;
        for (crossing, level) in self.speed.iter_mut().zip([slow, fast]) {
            crossing.push(self.seen, speed, level);
        }
        self.seen += 1;
    }

    /// Whether all levels have been reached: what comes says no more.
    pub fn is_known(&self) -> bool {
        self.current.at.is_some() && self.speed.iter().all(|c| c.at.is_some())
    }

    /// Samples taken.
    pub fn seen(&self) -> u64 {
        self.seen
    }

    /// How much later the current has risen than the speed leaves rest, extrapolated [s].
    fn lag_s(&self, plan: &OnsetPlan) -> Option<f64> {
        let [slow, fast] = self.speed.map(|c| c.at);
        let (w1, w2) = plan.speed_rad_per_s;
        let (slow, fast) = (slow?, fast?);
        let rest = slow - w1 * (fast - slow) / (w2 - w1);
        Some((self.current.at? - rest) / plan.rate_hz)
    }

    /// By how much the current comes later than the speed says, negative where the speed is late [s]; none where
    /// that is within what is borne, or not known.
    pub fn late_s(&self, plan: &OnsetPlan) -> Option<f64> {
        let late = self.lag_s(plan)? - plan.lag_s;
        (late.abs() > MOST_LATE.0 + MOST_LATE.1 / plan.rate_hz).then_some(late)
    }
}

/// Speed in the step's direction and equivalent current, row by row.
#[derive(Default)]
struct Rows {
    sign: f64,
    rows: Vec<(f64, f64)>,
    /// where the speed is that of the angle
    of_angle: Option<SpeedOfAngle>,
}

impl TelemetrySink for Rows {
    fn accept(&mut self, _: &TelemetryHeader, view: &TelemetryView<'_>) -> Result<()> {
        let columns = [Channel::OmegaM, Channel::IEq, Channel::ThetaM].map(|c| view.column(c));
        if let [Some(w), Some(i), Some(theta)] = columns {
            for (((w, i), theta), n) in w.iter().zip(i).zip(theta).zip(view.first..) {
                let speed = self.of_angle.as_mut().map_or(*w, |s| s.next(n, *theta));
                self.rows.push((self.sign * speed, *i));
            }
        }
        Ok(())
    }
}

fn simulated(actuator: &ActuatorParameters, height_rad: f64, rate_hz: f64, sampling: Sampling) -> Result<Rows> {
    let step = Segment {
        command: Command::Step { height_rad },
        start_s: 0.0,
        duration_s: SIMULATED_S,
    };
    let sequence = TestSequence {
        name: "step".into(),
        segments: vec![step],
    };
    let channels = ChannelSet::of([Channel::OmegaM, Channel::IEq, Channel::ThetaM]);
    let experiment = Experiment::new(sequence, rate_hz, channels, None, actuator.step_s)?.sampled(sampling);
    let lane = Lane {
        actuator: Arc::new(actuator.clone()),
        fault: FaultState::NOMINAL,
        rest_angle_rad: 0.0,
        load_n_m: 0.0,
    };
    let run = Run {
        number: 0,
        lane,
        seed: 0,
    };
    let mut rows = [Rows {
        sign: 1f64.copysign(height_rad),
        rows: Vec::new(),
        of_angle: (sampling.speed == SpeedSource::Angle).then(|| SpeedOfAngle::at_rest(rate_hz, 0.0)),
    }];
    simulate(&experiment, &[run], &mut rows, || true)?;
    let [rows] = rows;
    Ok(rows)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::catalogue;
    use crate::extractor::{FeatureExtractor, FeaturePlan};
    use schemas::feature::Raw;
    use schemas::telemetry::Collector;

    /// Telemetry of the built-in test with reference sensors.
    fn test(actuator: &Arc<ActuatorParameters>, fault: FaultState, rest_angle_rad: f64, rate_hz: f64) -> Collector {
        let sequence = catalogue::sequence("preflight").unwrap();
        let sensors = catalogue::sensors("reference").unwrap();
        let channels = FeaturePlan::channels_of(false);
        let experiment = Experiment::new(sequence, rate_hz, channels, sensors, actuator.step_s).unwrap();
        let lane = Lane {
            actuator: actuator.clone(),
            fault,
            rest_angle_rad,
            load_n_m: 0.0,
        };
        let run = Run {
            number: 0,
            lane,
            seed: 3,
        };
        let mut sinks = [Collector::default()];
        simulate(&experiment, &[run], &mut sinks, || true).unwrap();
        let [collected] = sinks;
        collected
    }

    fn missing(
        actuator: &ActuatorParameters,
        view: &TelemetryView<'_>,
        rate_hz: f64,
    ) -> (Vec<String>, FeatureExtractor) {
        let sequence = catalogue::sequence("preflight").unwrap();
        let mut x = FeatureExtractor::new(Arc::new(FeaturePlan::new(
            actuator,
            &sequence,
            rate_hz,
            false,
            Sampling::default(),
        )));
        x.push(view);
        (x.missing(), x)
    }

    #[test]
    fn val_currents_in_time_pass_at_any_fault_rate_and_unit() {
        let reference = Arc::new(ActuatorParameters::reference());
        let fleet = catalogue::spread("fleet").unwrap();
        let end = |x: f64| Arc::new(fleet.unit(&reference, 0.0, &[x; crate::spread::Cause::COUNT]).0);
        for (unit, (fsj, zeta)) in [
            (reference.clone(), (1.0, 0.0)),
            (end(1.0), (5.0, 0.5)),
            (end(-1.0), (3.0, 0.5)),
        ] {
            for (rate_hz, angle) in [(1000.0, 0.3), (10_000.0, 1.1)] {
                let run = test(&unit, FaultState { fsj, zeta }, angle, rate_hz);
                let found = missing(&reference, &run.view(), rate_hz).0;
                assert!(found.is_empty(), "{found:?} at FSJ {fsj}, zeta {zeta}, {rate_hz} Hz");
            }
        }
    }

    #[test]
    fn prop_no_rest_angle_looks_late() {
        let reference = Arc::new(ActuatorParameters::reference());
        for rate_hz in [10_000.0, 2500.0, 1000.0] {
            for angle in (0..24).map(|k| 0.27 * f64::from(k)) {
                for (fsj, zeta) in [(1.0, 0.0), (3.0, 0.5), (5.0, 0.5), (1.0, 0.35)] {
                    let run = test(&reference, FaultState { fsj, zeta }, angle, rate_hz);
                    let found = missing(&reference, &run.view(), rate_hz).0;
                    let said = format!("FSJ {fsj}, zeta {zeta}, {angle} rad, {rate_hz} Hz");
                    assert!(!found.iter().any(|w| w.contains(" later than ")), "{found:?} at {said}");
                }
            }
        }
    }

    #[test]
    fn prop_no_test_looks_late_whatever_its_samples_are() {
        let reference = Arc::new(ActuatorParameters::reference());
        let sequence = catalogue::sequence("preflight").unwrap();
        let sampling = Sampling {
            currents: crate::sensor::CurrentSampling::Point,
            speed: SpeedSource::Angle,
            ..Sampling::default()
        };
        for rate_hz in [10_000.0, 2500.0, 2000.0, 1000.0] {
            let plan = FeaturePlan::new(&reference, &sequence, rate_hz, false, sampling);
            let plan = Arc::new(plan);
            for (angle, fsj, zeta) in [(0.0, 1.0, 0.0), (0.9, 3.0, 0.2), (2.5, 4.5, 0.1)] {
                let mut sensors = catalogue::sensors("reference").unwrap();
                sensors.as_mut().unwrap().sampling = sampling;
                let channels = FeaturePlan::channels_of(false);
                let experiment =
                    Experiment::new(sequence.clone(), rate_hz, channels, sensors, reference.step_s).unwrap();
                let lane = Lane {
                    actuator: reference.clone(),
                    fault: FaultState { fsj, zeta },
                    rest_angle_rad: angle,
                    load_n_m: 0.0,
                };
                let run = Run {
                    number: 0,
                    lane,
                    seed: 5,
                };
                let mut x = [FeatureExtractor::new(plan.clone())];
                simulate(&experiment, &[run], &mut x, || true).unwrap();
                let found = x[0].missing();
                assert!(
                    found.is_empty(),
                    "{found:?} at {rate_hz} Hz, {angle} rad, FSJ {fsj}, zeta {zeta}"
                );
            }
        }
    }

    #[test]
    fn val_late_currents_are_named_and_their_features_left_out() {
        let reference = Arc::new(ActuatorParameters::reference());
        let rate_hz = 10_000.0;
        let run = test(&reference, FaultState { fsj: 3.0, zeta: 0.3 }, 0.0, rate_hz);
        for late in [5usize, 10] {
            let delayed = [Channel::IA, Channel::IB, Channel::IC].map(|c| {
                let x = run.column(c).unwrap();
                let first = std::iter::repeat_n(x[0], late);
                first.chain(x[..x.len() - late].iter().copied()).collect::<Vec<f64>>()
            });
            let view = run.view();
            let mut changed = TelemetryView::new(1, view.rows);
            for c in [Channel::Com, Channel::ThetaM, Channel::OmegaM] {
                changed = changed.with(c, view.column(c).unwrap());
            }
            for (c, x) in [Channel::IA, Channel::IB, Channel::IC].into_iter().zip(&delayed) {
                changed = changed.with(c, x);
            }
            let (words, x) = missing(&reference, &changed, rate_hz);
            let said = words.iter().find_map(|w| w.strip_prefix("step: the current comes "));
            let found: f64 = said
                .and_then(|w| w.split(' ').next()?.parse().ok())
                .expect("a lateness");
            assert!((found - late as f64 / 10.0).abs() < 0.05, "{words:?}");
            let features = x.features();
            assert!(features[Raw::P2].is_none() && features[Raw::CurrentRms].is_none());
            assert!(features[Raw::MeanSpeed].is_some() && features[Raw::P3].is_some());
        }
    }
}
