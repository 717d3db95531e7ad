//! Tests of actuators with a defect that the maps know nothing of.

use super::{Case, FSJ, ZETA, judge};
use anyhow::{Context, Result};
use diagnoser::diagnosis::Diagnoser;
use pipeline::calibrate::{draw_units, simulate_features};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use sim_worker::parameters::ActuatorParameters;
use sim_worker::setup::TestSetup;
use sim_worker::spread::Spread;
use sim_worker::test_bench::Lane;
use std::f64::consts::TAU;
use std::sync::Arc;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Defect {
    Backlash,
    ShortedTurn,
    Inertia,
    CurrentBias,
    Cogging,
}

impl Defect {
    pub const ALL: [Defect; 5] = [
        Defect::Backlash,
        Defect::ShortedTurn,
        Defect::Inertia,
        Defect::CurrentBias,
        Defect::Cogging,
    ];

    pub fn title(self) -> &'static str {
        match self {
            Defect::Backlash => "backlash doubled",
            Defect::ShortedTurn => "2 to 15 % of one phase's turns shorted",
            Defect::Inertia => "inertia 20 % up or down",
            Defect::CurrentBias => "current sensors biased by 0.05 to 0.5 A",
            Defect::Cogging => "cogging of 3 to 20 mN m, order 6, 12 or 18",
        }
    }

    /// The actuator with this defect; severity and phase by `rng`.
    fn hidden_in(self, a: &ActuatorParameters, rng: &mut ChaCha8Rng) -> Result<ActuatorParameters> {
        let mut a = a.clone();
        let effect = |text: String| -> Result<_> {
            let file = format!("{}\n[[effect]]\n{text}\n", ActuatorParameters::reference_text());
            Ok(ActuatorParameters::parse("defect", &file)?.effects)
        };
        match self {
            Defect::Backlash => a.backlash_half_width_rad *= 2.0,
            Defect::Inertia => a.inertia_kg_m2 *= if rng.random::<bool>() { 1.2 } else { 0.8 },
            Defect::ShortedTurn => {
                let (fraction, phase) = (rng.random_range(0.02..0.15), rng.random_range(0..3));
                let text = format!("name = \"turn_short\"\nfraction = {fraction}\nphase = {phase}.0");
                a.effects = effect(text)?;
            }
            Defect::CurrentBias => {
                let size = rng.random_range(0.05..0.5) * if rng.random::<bool>() { 1.0 } else { -1.0 };
                a.effects = effect(format!("name = \"current_offset\"\ncurrent = {size}"))?;
            }
            Defect::Cogging => {
                let (size, phase) = (rng.random_range(0.003..0.02), rng.random_range(0.0..TAU));
                let order = [6.0, 12.0, 18.0][rng.random_range(0..3)];
                let text = format!("name = \"cogging\"\namplitude = {size}\nphase = {phase}\norder = {order:.1}");
                a.effects = effect(text)?;
            }
        }
        Ok(a)
    }
}

/// Tests of `n` random units with a defect, at random faults.
pub fn tests(
    diagnoser: &Diagnoser,
    setup: &TestSetup,
    spread: &Spread,
    defect: Defect,
    n: usize,
    seed: u64,
) -> Result<Vec<Case>> {
    let seed = 0xDEFE_C700_0000_0000 ^ seed.wrapping_mul(16) ^ defect as u64;
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let units = draw_units(FSJ, ZETA, spread, n, seed);
    let mut lanes = Vec::new();
    for u in &units {
        let (unit, rest_angle_rad) = spread.unit(&setup.actuator, setup.rest_angle_rad, &u.draw);
        let actuator = Arc::new(defect.hidden_in(&unit, &mut rng)?);
        let lane = Lane {
            actuator,
            fault: u.fault,
            rest_angle_rad,
            load_n_m: setup.load_n_m,
        };
        lanes.push((lane, u.seed));
    }
    let measured = simulate_features(setup, lanes, defect.title())?.context("interrupted")?;
    Ok(judge(diagnoser, &units, &measured))
}
