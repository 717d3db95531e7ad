//! Effects that three measured phases tell apart: what each would add to the torque and to the equations of the phases.

use crate::equations::pieces::{Column, Piece, RigConstants};
use crate::equations::signals::{Phases, SUPPLY, Signals};
use sim_worker::effect::{self, Draw, EffectKind, Equation};
use std::f64::consts::TAU;

/// What the phases make of an effect that changes their constants: amplitudes' columns of torque and phase voltages.
///
/// * `share` of phase `q` at an angle, of its torque and back-EMF constant
fn phased(s: &Signals, p: &Phases, c: &RigConstants, share: impl Fn(usize, f64) -> f64) -> Column {
    let ke = 0.5 * c.effect.torque_constant;
    let mut torque = vec![0.0; s.n];
    let mut column = Vec::new();
    for q in 0..3 {
        let shape = p.mean_over_support(s, q, |theta, trap| trap * share(q, theta));
        for k in 0..s.n {
            // what the phase gives is not asked of the drive
            torque[k] -= ke * p.current[q][k] * shape[k];
        }
        if p.voltage.is_some() {
            let whole = p.swept(s, |theta| {
                effect::shape(c.effect.pole_pairs * theta - TAU / 3.0 * q as f64) * share(q, theta)
            });
            let signal = whole.iter().map(|x| ke * x).collect();
            column.push(Piece {
                equation: Equation::Electrical,
                order: 0,
                signal,
                phase: Some(q),
            });
        }
    }
    column.push(Piece {
        equation: Equation::Torque,
        order: 0,
        signal: torque,
        phase: None,
    });
    column
}

/// What a source's voltage goes by, from the shape of its term: 1 by the size of the legs' current, else by power.
pub fn draw(shape: &[f64]) -> Draw {
    match shape.first() {
        Some(s) if (0.5..1.5).contains(s) => Draw::Legs,
        _ => Draw::Power,
    }
}

/// As [`super::columns::contribution`], of effects that the phases tell apart; `None` for all others.
pub fn of_phases(kind: EffectKind, shape: &[f64], s: &Signals, c: &RigConstants) -> Option<Vec<Column>> {
    let p = s.phases.as_ref()?;
    let voltages = |f: &dyn Fn(usize, usize) -> f64| -> Column {
        (0..3)
            .map(|q| Piece {
                equation: Equation::Electrical,
                order: 0,
                signal: (0..s.n).map(|k| f(q, k)).collect(),
                phase: Some(q),
            })
            .collect()
    };
    let (r, l, ke) = (
        0.5 * c.effect.resistance,
        0.5 * c.effect.inductance,
        0.5 * c.effect.torque_constant,
    );
    Some(match kind {
        // the second column is the first a quarter of a turn later, as [`super::columns::effect`] takes it
        EffectKind::Eccentricity => {
            let at = |q: usize, theta: f64| theta + TAU / 3.0 * q as f64;
            vec![
                phased(s, p, c, |q, t| at(q, t).cos()),
                phased(s, p, c, |q, t| at(q, t).sin()),
            ]
        }
        EffectKind::TorqueRipple => vec![
            phased(s, p, c, |_, t| (shape[0] * t).cos()),
            phased(s, p, c, |_, t| (shape[0] * t).sin()),
        ],
        EffectKind::TurnShort => {
            let short = shape[0] as usize;
            let mut column = phased(s, p, c, |q, _| if q == short { -1.0 } else { 0.0 });
            if p.voltage.is_some() {
                for (order, factor) in [(0, -r), (1, -l)] {
                    column.push(Piece {
                        equation: Equation::Electrical,
                        order,
                        signal: p.current[short].iter().map(|i| factor * i).collect(),
                        phase: Some(short),
                    });
                }
            }
            vec![column]
        }
        EffectKind::DeadTime if p.voltage.is_some() => {
            // Half of it in each leg, for the part of a sample in which the leg conducts: what is recorded of the
            // current of a leg that does not is the noise of its sensor. What two legs carry is the same current,
            // so its size is taken from all three sensors, and its sign from the leg's.
            let width = shape.first().copied().unwrap_or(0.05);
            let share: [Vec<f64>; 3] = std::array::from_fn(|q| {
                let on = |theta: f64| effect::conducting(theta, c.effect.pole_pairs)[q];
                (0..s.n).map(|k| p.mean(s, k, on)).collect()
            });
            // whichever way the drive pushes: the current along the signs of the legs that conduct
            let along = |k: usize| {
                0.5 * (0..3)
                    .map(|q| share[q][k].signum() * p.current[q][k] * f64::from(u8::from(share[q][k] != 0.0)))
                    .sum::<f64>()
            };
            let drop: Vec<f64> = (0..s.n).map(|k| 0.5 * (along(k) / width).tanh()).collect();
            vec![voltages(&|q, k| share[q][k] * drop[k])]
        }
        EffectKind::SupplySag if p.supply.is_some() && p.voltage.is_some() => {
            let (v, dc) = (p.voltage.as_ref()?, p.supply.as_ref()?);
            // what a link with a capacitor draws by its power, or what the legs carry where nothing levels it
            let draw = |k: usize| {
                if draw(shape) == Draw::Legs {
                    return p.size(k);
                }
                (0..3).map(|q| v[q][k] * p.current[q][k]).sum::<f64>() / dc[k].max(1.0)
            };
            vec![vec![Piece {
                equation: Equation::Electrical,
                order: 0,
                signal: (0..s.n).map(|k| -draw(k)).collect(),
                phase: Some(SUPPLY),
            }]]
        }
        EffectKind::WindingHeating if p.voltage.is_some() && s.temperature.is_none() => {
            // a winding that is warm from the beginning on
            vec![voltages(&|q, k| r * effect::COPPER_PER_K * p.current[q][k])]
        }
        EffectKind::CurrentOffset => {
            let q = shape[0] as usize;
            let mut column: Column = vec![Piece {
                equation: Equation::Torque,
                order: 0,
                signal: p.mean_over_support(s, q, |_, trap| ke * trap),
                phase: None,
            }];
            if p.voltage.is_some() {
                column.push(Piece {
                    equation: Equation::Electrical,
                    order: 0,
                    signal: vec![-r; s.n],
                    phase: Some(q),
                });
            }
            vec![column]
        }
        // linear in g/(1+g)
        EffectKind::CurrentGain if !shape.is_empty() => {
            let q = shape[0] as usize;
            let along = p.mean_over_support(s, q, |_, trap| ke * trap);
            let mut column: Column = vec![Piece {
                equation: Equation::Torque,
                order: 0,
                signal: (0..s.n).map(|k| along[k] * p.current[q][k]).collect(),
                phase: None,
            }];
            if p.voltage.is_some() {
                for (order, factor) in [(0, -r), (1, -l)] {
                    column.push(Piece {
                        equation: Equation::Electrical,
                        order,
                        signal: p.current[q].iter().map(|i| factor * i).collect(),
                        phase: Some(q),
                    });
                }
            }
            vec![column]
        }
        // all constants together stand for a gain of all, which is judged by what is believed of them
        EffectKind::SupplySag | EffectKind::DeadTime | EffectKind::WindingHeating | EffectKind::CurrentGain => {
            Vec::new()
        }
        // in currents that are measured there is nothing of the angle that they were commutated by
        EffectKind::CommutationOffset => Vec::new(),
        _ => return None,
    })
}
