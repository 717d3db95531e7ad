//! Ranges that values of a whole dataset lie in: wide enough for any fault of the grid, narrow enough for bits
//! that have fallen over. The factors are assumed.

use super::parts::Part;
use super::plan::DatasetPlan;
use crate::noise::FeatureValues;
use crate::parameters::ActuatorParameters;
use schemas::channel::Channel;
use schemas::feature::{Raw, RawFeatures};
use schemas::sequence::TestSequence;

/// Values may be this many times what parameters and commands allow.
const MARGIN: f64 = 3.0;

fn no_load_rad_per_s(a: &ActuatorParameters) -> f64 {
    a.supply_voltage_v / (2.0 * a.back_emf_v_s_per_rad)
}

/// Least and greatest value of each stored channel.
pub fn telemetry_ranges(plan: &DatasetPlan, part: &Part) -> Vec<(Channel, (f64, f64))> {
    let a = &plan.actuators[part.actuator].parameters;
    let Some(t) = &plan.telemetry else { return Vec::new() };
    let turn = std::f64::consts::TAU;
    let current = MARGIN * a.current_limit_a.max(a.supply_voltage_v / a.phase_resistance_ohm);
    let range = |c: Channel| match c {
        Channel::Com | Channel::ThetaU => MARGIN * a.end_stop_rad,
        Channel::ThetaM => MARGIN * a.end_stop_rad * a.gear_ratio + turn,
        Channel::OmegaM => MARGIN * no_load_rad_per_s(a).max(a.speed_reference_limit_rad_per_s),
        Channel::IEq | Channel::IA | Channel::IB | Channel::IC | Channel::IQ | Channel::ISupply => current,
        Channel::VA | Channel::VB | Channel::VC | Channel::VDc => MARGIN * a.supply_voltage_v,
        Channel::TorqueM => current * MARGIN * a.torque_constant_n_m_per_a(),
        Channel::Temperature => f64::INFINITY,
    };
    t.stored.iter().map(|c| (c, (-range(c), range(c)))).collect()
}

/// Ranges of the raw features.
pub struct FeatureRanges<'a> {
    plan: &'a DatasetPlan,
}

impl<'a> FeatureRanges<'a> {
    /// Ranges for the actuators and sequences of a plan.
    pub fn of(plan: &'a DatasetPlan) -> Self {
        Self { plan }
    }

    /// The greatest sizes of a part's raw features, in the order of [`RawFeatures::COLUMNS`].
    fn most(&self, part: &Part) -> [f64; RawFeatures::COUNT] {
        let a = &self.plan.actuators[part.actuator].parameters;
        let sequence: &TestSequence = &self.plan.sequences[part.sequence];
        let user = MARGIN * no_load_rad_per_s(a).max(a.speed_reference_limit_rad_per_s) / a.gear_ratio;
        let current = MARGIN * a.current_limit_a.max(a.supply_voltage_v / a.phase_resistance_ohm);
        let travel = MARGIN * a.end_stop_rad;
        let motor = travel * a.gear_ratio;
        Raw::ALL.map(|raw| match raw {
            Raw::MeanSpeed | Raw::Ripple => user,
            Raw::ThirdCosine | Raw::ThirdSine | Raw::OtherOrders => user * a.gear_ratio,
            Raw::P2
            | Raw::CurrentRms
            | Raw::CurrentSum
            | Raw::EvenCurrent
            | Raw::BiasCurrent
            | Raw::KineticCurrent
            | Raw::SlowBreakAway
            | Raw::SlowKinetic
            | Raw::LegCurrent
            | Raw::CurrentTrend
            | Raw::RunUpCurrent => current,
            // slopes and bends over places within a fraction of an amplitude
            Raw::KineticTilt | Raw::KineticBend => 10.0 * current,
            Raw::Supply => MARGIN * a.supply_voltage_v,
            Raw::P3 => travel,
            Raw::Rise | Raw::SlowLag => sequence.duration_s(),
            Raw::SineTravel => 2.0 * motor,
            Raw::CurrentImbalance => MARGIN,
        })
    }

    /// What is wrong with a row, if anything.
    pub fn wrong(&self, part: &Part, row: &FeatureValues) -> Option<String> {
        let most = self.most(part);
        let names = RawFeatures::COLUMNS.iter().zip(RawFeatures::DEVIATIONS);
        for ((&(value, sd), most), (name, sd_name)) in row.iter().zip(most).zip(names) {
            let Some(x) = value else { continue };
            let inside = x.abs() <= most;
            if !inside {
                return Some(format!("`{name}` is {x}, allowed -{most:.3e} to {most:.3e}"));
            }
            let inside = (0.0..=most).contains(&sd);
            if !inside {
                return Some(format!("`{sd_name}` is {sd}, allowed 0 to {most:.3e}"));
            }
        }
        None
    }
}
