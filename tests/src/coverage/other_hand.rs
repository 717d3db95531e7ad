//! Units that differ, simulated by another hand ([`crate::independent`]): what is measured there says whether intervals hold
//! where nobody who made them wrote the simulator.

use crate::independent::{self, Command, Effect, Telemetry, record};
use diagnoser::uncertainty::deviations;
use pipeline::calibrate::Unit;
use rayon::prelude::*;
use schemas::channel::Channel;
use schemas::feature::RawFeatures;
use schemas::telemetry::TelemetryView;
use sim_worker::extractor::FeatureExtractor;
use sim_worker::setup::TestSetup;
use sim_worker::spread::{Cause, Spread};
use std::sync::Arc;

/// The other simulator's unit for a draw of ours.
pub fn of(spread: &Spread, unit: &Unit) -> independent::Unit {
    let x = deviations(spread, &unit.draw);
    let mut u = independent::Unit::default();
    for (value, cause) in [
        (&mut u.r, Cause::Resistance),
        (&mut u.ke, Cause::BackEmf),
        (&mut u.j, Cause::Inertia),
        (&mut u.fd_ratio, Cause::DynamicRatio),
        (&mut u.vs, Cause::Supply),
        (&mut u.c, Cause::Viscous),
        (&mut u.fs0, Cause::HealthyFriction),
    ] {
        *value *= 1.0 + cause.of_counted(x[cause as usize]);
    }
    let drop = Cause::BridgeDrop.of_counted(x[Cause::BridgeDrop as usize]);
    if drop != 0.0 {
        u.effects.extend(Effect::new("dead_time", &[("voltage", drop)]));
    }
    u
}

/// Features of each unit's test, by the other simulator and its sensors.
///
/// * `command` the test of `setup`, as the other simulator has it
pub fn measure(setup: &TestSetup, spread: &Spread, units: &[Unit], command: &Command) -> Vec<RawFeatures> {
    let as_drawn = |u: &Unit| (of(spread, u), ());
    measure_odd(setup, units, command, as_drawn, |(), _| {})
}

/// The same of units that something is wrong with.
///
/// * `odd` the unit, and what its sensors need to know
/// * `told` what becomes of a recording before it is written
pub fn measure_odd<T>(
    setup: &TestSetup,
    units: &[Unit],
    command: &Command,
    odd: impl Fn(&Unit) -> (independent::Unit, T) + Sync,
    told: impl Fn(T, &mut Telemetry) + Sync,
) -> Vec<RawFeatures> {
    let plan = Arc::new(setup.feature_plan());
    let seconds = setup.sequence.duration_s();
    let one = |u: &Unit| {
        let faults = (u.fault.fsj, u.fault.zeta);
        let (unit, sensing) = odd(u);
        let mut t = record(&unit, command, seconds, setup.rate_hz, faults, true, u.seed);
        told(sensing, &mut t);
        // as files have them
        let file = |v: &[f64]| v.iter().map(|x| *x as f32 as f64).collect::<Vec<f64>>();
        let columns = [
            (Channel::ThetaM, file(&t.theta_m)),
            (Channel::OmegaM, file(&t.omega_m)),
            (Channel::IA, file(&t.i[0])),
            (Channel::IB, file(&t.i[1])),
            (Channel::IC, file(&t.i[2])),
            (Channel::VDc, file(&t.v_dc)),
        ];
        let mut view = TelemetryView::new(1, t.t.len()).with(Channel::Com, &t.com);
        for (channel, column) in &columns {
            view = view.with(*channel, column);
        }
        let mut x = FeatureExtractor::new(plan.clone());
        x.push(&view);
        x.features()
    };
    units.par_iter().map(one).collect()
}
