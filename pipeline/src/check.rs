//! Whether an actuator can be diagnosed by a test at all: what it does in it, and what its maps show.
//!
//! The test is simulated at the corners of the fault range; a feature that says nothing there would say nothing in a
//! diagnosis. All limits are assumed.

use crate::maps::{self, MapRequest};
use anyhow::Result;
use schemas::channel::{Channel, ChannelSet};
use schemas::error::Error;
use schemas::fault::{FaultGrid, FaultState};
use schemas::sequence::{Command, Segment, TestSequence};
use schemas::telemetry::Collector;
use sim_worker::extractor::{FeaturePlan, REGIME_S};
use sim_worker::sensor::SensorModel;
use sim_worker::setup::TestSetup;
use sim_worker::simulate::{Run, simulate};
use sim_worker::test_bench::Lane;
use std::ops::Range;
use std::sync::Arc;

/// Telemetry rate of the simulated tests [Hz].
const RATE_HZ: f64 = 10_000.0;

/// Least share of the ramp's end that must be reached: less has not broken away.
const MOVED: f64 = 0.3;

/// Least share of the sine's travel that must be followed.
const FOLLOWED: f64 = 0.8;

/// Greatest share of the mean speed by which the halves of P1's window may differ.
const STEADY: f64 = 0.005;

/// Greatest share of the sine's samples at the limit of the current.
const SATURATED: f64 = 0.05;

/// Least range of a map, in its own standard uncertainties.
const RANGE: f64 = 10.0;

/// One thing that was looked at.
#[derive(Clone, Debug, PartialEq)]
pub struct Finding {
    /// moves, follows, regime, stops, saturates, map NAME
    pub check: String,
    /// whether it is as it should be
    pub ok: bool,
    /// what was seen, in words with units
    pub found: String,
    /// what is allowed
    pub allowed: String,
    /// what would serve, where it is not
    pub advice: String,
}

/// What was found of an actuator and a test.
#[derive(Clone, Debug, PartialEq)]
pub struct Checked {
    /// in the order in which they were looked at
    pub findings: Vec<Finding>,
    /// height of a step, and its length, at which P1's window is at steady speed with both faults at their greatest
    /// [rad, s]; none where the actuator does not turn
    pub step: Option<(f64, f64)>,
}

impl Checked {
    /// Whether nothing stands against a diagnosis.
    pub fn ok(&self) -> bool {
        self.findings.iter().all(|f| f.ok)
    }
}

/// The segment of a sequence that is of a kind, as samples of a run.
fn rows(sequence: &TestSequence, is: impl Fn(&Command) -> bool) -> Option<(&Segment, Range<usize>)> {
    let s = sequence.segment(is)?;
    let at = |t: f64| (t * RATE_HZ).round() as usize;
    Some((s, at(s.start_s)..at(s.start_s + s.duration_s)))
}

/// Samples of a channel of a run.
fn within<'a>(run: &'a Collector, channel: Channel, r: &Range<usize>) -> &'a [f64] {
    let x = run.column(channel).unwrap_or_default();
    &x[r.start.min(x.len())..r.end.min(x.len())]
}

/// Greatest less smallest.
fn travel(x: &[f64]) -> f64 {
    let (lo, hi) = x.iter().fold((f64::MAX, f64::MIN), |(a, b), &v| (a.min(v), b.max(v)));
    if x.is_empty() { 0.0 } else { hi - lo }
}

fn mean(x: &[f64]) -> f64 {
    x.iter().sum::<f64>() / x.len().max(1) as f64
}

/// Simulates the test at the corners of the fault range and makes its maps.
///
/// * `sensors` of the maps
///
/// # Errors
/// As the simulation; it may be interrupted ([`crate::Interrupted`]).
pub fn check(setup: &TestSetup, sensors: Option<SensorModel>, grid: &FaultGrid) -> Result<Checked> {
    let ends = |x: &[f64]| [x[0], x[x.len() - 1]];
    let corners: Vec<FaultState> = ends(&grid.zeta)
        .into_iter()
        .flat_map(|zeta| ends(&grid.fsj).map(|fsj| FaultState { fsj, zeta }))
        .collect();
    let channels = ChannelSet::basic();
    let setup = TestSetup {
        rate_hz: RATE_HZ,
        sensors: None,
        ..setup.clone()
    };
    let runs: Vec<Run> = corners
        .iter()
        .zip(0..)
        .map(|(&fault, number)| Run {
            number,
            lane: Lane {
                actuator: setup.actuator.clone(),
                fault,
                rest_angle_rad: setup.rest_angle_rad,
                load_n_m: setup.load_n_m,
            },
            seed: number,
        })
        .collect();
    let mut seen = vec![Collector::default(); runs.len()];
    let go_on = || !crate::progress::interrupted();
    simulate(&setup.experiment(channels)?, &runs, &mut seen, go_on)?.ok_or(crate::Interrupted)?;

    let mut findings = Vec::new();
    motion(&setup, &corners, &seen, &mut findings);
    let step = advised(&setup, &seen);
    if let Some(regime) = findings.iter_mut().find(|f| f.check == "regime" && !f.ok) {
        regime.advice = step.map_or("the motor does not come up to a speed".into(), |(height, time)| {
            format!("a step of at least {height:.3} rad that lasts {time:.2} s")
        });
    }
    let request = MapRequest {
        setup: TestSetup { sensors, ..setup },
        grid: grid.clone(),
    };
    of_maps(&request, &mut findings)?;
    Ok(Checked { findings, step })
}

fn words(f: &FaultState) -> String {
    format!("FSJ {}, zeta {}", f.fsj, f.zeta)
}

/// What the actuator does in the test, the worst corner of each.
fn motion(setup: &TestSetup, corners: &[FaultState], seen: &[Collector], findings: &mut Vec<Finding>) {
    let a = &setup.actuator;
    let sequence = &setup.sequence;
    // the corner where a share is smallest
    let least = |of: &dyn Fn(&Collector) -> f64| {
        let all = seen.iter().zip(corners).map(|(r, f)| (of(r), f));
        all.min_by(|a, b| a.0.total_cmp(&b.0)).expect("four corners")
    };
    let most = |of: &dyn Fn(&Collector) -> f64| {
        let (x, f) = least(&|r| -of(r));
        (-x, f)
    };
    let mut add = |check: &str, ok: bool, found: String, allowed: String, advice: String| {
        let advice = if ok { String::new() } else { advice };
        findings.push(Finding {
            check: check.into(),
            ok,
            found,
            allowed,
            advice,
        });
    };

    // travel over what is commanded
    let moved = |run: &Collector, r: &Range<usize>| {
        travel(within(run, Channel::ThetaU, r)) / travel(within(run, Channel::Com, r)).max(1e-300)
    };
    if let Some((s, r)) = rows(sequence, |c| matches!(c, Command::Ramp { .. })) {
        let (x, at) = least(&|run| moved(run, &r));
        let stall = a.static_friction_n_m * at.fsj;
        add(
            "moves",
            x >= MOVED,
            format!("{:.0} % of the ramp at {}", 100.0 * x, words(at)),
            format!("at least {:.0} %", 100.0 * MOVED),
            format!(
                "break-away takes {stall:.3} N m, the motor gives at most {:.3} N m; if it is not that, see stops, or take a ramp longer than {} s or steeper",
                a.torque_limit_n_m, s.duration_s
            ),
        );
    }
    if let Some((_, r)) = rows(sequence, |c| matches!(c, Command::Sine { .. })) {
        let (x, at) = least(&|run| moved(run, &r));
        add(
            "follows",
            (FOLLOWED..=2.0 - FOLLOWED).contains(&x),
            format!("{:.0} % of the sine's travel at {}", 100.0 * x, words(at)),
            format!("{:.0} to {:.0} %", 100.0 * FOLLOWED, 100.0 * (2.0 - FOLLOWED)),
            format!(
                "a sine of more than the play of {:.2e} rad, slow enough for the torque limit of {} N m",
                2.0 * a.backlash_half_width_rad,
                a.torque_limit_n_m
            ),
        );
        let limit = 0.98 * a.current_limit_a;
        let share = |run: &Collector| {
            let i = within(run, Channel::IEq, &r);
            i.iter().filter(|i| i.abs() >= limit).count() as f64 / i.len().max(1) as f64
        };
        let (x, at) = most(&share);
        add(
            "saturates",
            x <= SATURATED,
            format!(
                "{:.0} % of the sine at the current limit of {} A, at {}",
                100.0 * x,
                a.current_limit_a,
                words(at)
            ),
            format!("at most {:.0} %", 100.0 * SATURATED),
            "a slower or smaller sine: at the limit the current says nothing of friction".into(),
        );
    }
    let plan = FeaturePlan::new(a, sequence, RATE_HZ, false, Default::default());
    if let Some(w) = plan.regime {
        let r = w.from as usize - 1..w.to as usize;
        let drift = |run: &Collector| {
            let x = within(run, Channel::OmegaM, &r);
            let (early, late) = x.split_at(x.len() / 2);
            (mean(late) - mean(early)).abs() / mean(x).abs().max(1e-3)
        };
        let (x, at) = most(&drift);
        add(
            "regime",
            x <= STEADY,
            format!(
                "the speed in P1's window changes by {:.2} % at {}",
                100.0 * x,
                words(at)
            ),
            format!("at most {:.1} %", 100.0 * STEADY),
            String::new(),
        );
    } else {
        let found = "the sequence has no step as long as P1's window".into();
        add(
            "regime",
            false,
            found,
            format!("a step of at least {} s", REGIME_S.1),
            String::new(),
        );
    }
    let furthest = |run: &Collector| {
        let off = |channel, from: f64| {
            let all = run.column(channel).unwrap_or_default();
            all.iter().fold(0.0f64, |a, x| a.max((x - from).abs()))
        };
        off(Channel::ThetaU, 0.0).max(off(Channel::ThetaM, setup.rest_angle_rad) / a.gear_ratio)
    };
    let (x, at) = most(&furthest);
    add(
        "stops",
        x < 0.999 * a.end_stop_rad,
        format!("{x:.4e} rad at {}", words(at)),
        format!("less than the end stop at {} rad", a.end_stop_rad),
        format!("a step of less than {:.3} rad", 0.95 * a.end_stop_rad),
    );
}

/// A step that serves: at the greatest speed that the actuator comes to, its position loop takes the speed back
/// `Wmax / GAP` before the end.
fn advised(setup: &TestSetup, seen: &[Collector]) -> Option<(f64, f64)> {
    let a = &setup.actuator;
    let speed = seen
        .iter()
        .filter_map(|r| r.column(Channel::OmegaM))
        .flat_map(|w| w.iter())
        .fold(0.0f64, |a, x| a.max(x.abs()));
    let step = setup.sequence.segment(|c| matches!(c, Command::Step { .. }));
    let end = step.map_or(REGIME_S.1, |s| s.duration_s.min(REGIME_S.1));
    let height = speed / a.gear_ratio * end + 1.1 * speed / a.position_gain_per_s;
    (speed > 1.0).then_some((1.02 * height, end.max(REGIME_S.1)))
}

/// What the maps show.
fn of_maps(request: &MapRequest, findings: &mut Vec<Finding>) -> Result<()> {
    let set = match maps::cached_in(request).and_then(|dir| maps::made(&dir, request)) {
        Ok(set) => set,
        Err(e) => {
            let Some(refused) = e.downcast_ref::<Error>() else {
                return Err(e);
            };
            findings.push(Finding {
                check: "maps".into(),
                ok: false,
                found: refused.to_string(),
                allowed: "maps that rise or fall with the faults".into(),
                advice: "first mend what stands above".into(),
            });
            return Ok(());
        }
    };
    for m in &set.maps {
        let (lo, hi) = m.range();
        let (f, z) = (m.fsj[m.fsj.len() / 2], m.zeta[m.zeta.len() / 2]);
        let x = (hi - lo) / m.uncertainty(f, z).max(1e-300);
        findings.push(Finding {
            check: format!("map {}", m.feature.name()),
            ok: x >= RANGE,
            found: format!(
                "from {lo:.3e} to {hi:.3e} {}, {x:.0} standard uncertainties",
                m.feature.unit()
            ),
            allowed: format!("a range of at least {RANGE:.0} standard uncertainties"),
            advice: if x >= RANGE {
                String::new()
            } else {
                "this feature says little of the faults of this actuator".into()
            },
        });
    }
    for left in &set.header.left_out {
        let (found, allowed) = said(left);
        findings.push(Finding {
            check: format!("map {}", left.split(':').next().unwrap_or_default()),
            ok: false,
            found,
            allowed,
            advice: "it is left out of diagnoses".into(),
        });
    }
    Ok(())
}

/// What a map that was left out says of itself: found, and allowed.
fn said(left: &str) -> (String, String) {
    let words = left.split_once(": ").map_or(left, |l| l.1);
    let (found, allowed) = words
        .split_once("; allowed: ")
        .unwrap_or((words, "one direction along each fault"));
    (found.into(), allowed.into())
}

/// The test of an actuator by which it is checked.
pub fn setup_of(actuator: Arc<sim_worker::parameters::ActuatorParameters>, sequence: TestSequence) -> TestSetup {
    TestSetup::new(actuator, sequence, RATE_HZ)
}
