//! Effects that three measured phases tell apart: what each would add to the torque and to the equations of the phases.

use crate::candidates::columns::drive;
use crate::equations::phases::{Of, Phases, SUPPLY};
use crate::equations::pieces::{Column, Piece, RigConstants};
use crate::equations::signals::Signals;
use sim_worker::effect::{self, EffectKind, Equation};
use std::f64::consts::TAU;

/// Shape of a phase's back-EMF at an angle.
fn trap(c: &RigConstants, q: usize, theta: f64) -> f64 {
    effect::shape(c.effect.pole_pairs * theta - TAU / 3.0 * q as f64)
}

/// What the phases make of effects that change their constants: of each, its columns of torque and phase voltages.
///
/// * `share` of each phase at an angle, of its torque and back-EMF constant; a column for each effect
fn phased<const N: usize>(s: &Signals, p: &Phases, c: &RigConstants, share: impl Fn(f64) -> Of<N>) -> Vec<Column> {
    let ke = 0.5 * c.effect.torque_constant;
    let means = p.shaped(s, &share);
    let whole = p.voltage.as_ref().map(|_| {
        p.swept(s, |theta| {
            let mut of = share(theta);
            (0..3).for_each(|q| of.row_mut(q).scale_mut(trap(c, q, theta)));
            of
        })
    });
    let of = |i: usize| -> Column {
        let volts = |q: usize| {
            let whole = whole.as_ref()?;
            Some(Piece {
                equation: Equation::Electrical,
                order: 0,
                signal: whole.iter().map(|x| ke * x[(q, i)]).collect(),
                phase: Some(q),
            })
        };
        // what the phases give is not asked of the drive
        let given = |k: usize| (0..3).fold(0.0, |t, q| t - ke * p.current[q][k] * means[k][(q, i)]);
        let torque = Piece::of(Equation::Torque, 0, (0..s.n).map(given).collect());
        (0..3).filter_map(volts).chain([torque]).collect()
    };
    (0..N).map(of).collect()
}

/// Shape of a source whose voltage goes by the size of the legs' current; what is less goes by power.
pub const LEGS: f64 = 3.0;

/// Second shape of a phase whose short turns a contact bridges.
pub const BRIDGED: f64 = 1.0;
/// Shape of a winding that is as warm from the beginning to the end.
pub const WARM: f64 = 3.0;

/// Share of the flux that an iron loses which saturates about the current `at` [A].
pub fn flux_lost(at: f64, i: f64) -> f64 {
    1.0 - effect::flux_left(at.recip(), i)
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
    // what a phase's own current takes of its voltage, the other way
    let less = |q: usize| -> Column {
        let of = |(order, factor): (usize, f64)| Piece {
            equation: Equation::Electrical,
            order,
            signal: p.current[q].iter().map(|i| factor * i).collect(),
            phase: Some(q),
        };
        let orders = [(0, -r), (1, -l)].into_iter();
        orders.filter(|_| p.voltage.is_some()).map(of).collect()
    };
    Some(match kind {
        // the second column is the first a quarter of a turn later, as [`super::columns::effect`] takes it
        EffectKind::Eccentricity => {
            let of = |theta: f64, q: usize, i: usize| {
                let at = theta + TAU / 3.0 * q as f64;
                if i == 0 { at.cos() } else { at.sin() }
            };
            phased(s, p, c, |theta| Of::<2>::from_fn(|q, i| of(theta, q, i)))
        }
        EffectKind::TorqueRipple => phased(s, p, c, |theta| {
            let (sin, cos) = (shape[0] * theta).sin_cos();
            Of::<2>::from_fn(|_, i| if i == 0 { cos } else { sin })
        }),
        EffectKind::TurnShort => {
            let short = shape[0] as usize;
            let mut columns = phased(s, p, c, |_| {
                Of::<1>::from_fn(|q, _| if q == short { -1.0 } else { 0.0 })
            });
            let column = &mut columns[0];
            column.extend(less(short));
            if shape.get(1) == Some(&BRIDGED) {
                // by the back-EMF of the bridged turns, whose current is as large as theirs over their resistance
                let squared = p.swept(s, |theta| trap(c, short, theta).powi(2));
                let signal = squared.iter().map(|x| ke * ke / r * x).collect();
                column.push(Piece::of(Equation::Torque, 0, signal));
            }
            columns
        }
        // amplitude 1: what an iron takes that saturates about this current; a weak saturation is a part of that
        EffectKind::TorqueSaturation if !shape.is_empty() => {
            let lost: Vec<f64> = (0..s.n).map(|k| flux_lost(shape[0], p.size(k))).collect();
            let torque = (0..s.n).map(|k| c.effect.torque_constant * drive(s, c, k) * lost[k]);
            let mut column = vec![Piece::of(Equation::Torque, 0, torque.collect())];
            for q in (0..3).filter(|_| p.voltage.is_some()) {
                let whole = p.swept(s, |theta| trap(c, q, theta));
                column.push(Piece {
                    equation: Equation::Electrical,
                    order: 0,
                    signal: (0..s.n).map(|k| -ke * whole[k] * lost[k]).collect(),
                    phase: Some(q),
                });
            }
            vec![column]
        }
        EffectKind::DeadTime if p.voltage.is_some() => {
            // Half of it in each leg, for the part of a sample in which the leg conducts: what is recorded of the
            // current of a leg that does not is the noise of its sensor. What two legs carry is the same current,
            // so it is taken from all three sensors, along the signs of the legs that conduct, whichever way the drive
            // pushes.
            let width = shape.first().copied().unwrap_or(0.05);
            let drop: Vec<[f64; 3]> = (0..s.n)
                .map(|k| {
                    let share = p.conducting(s, k);
                    let along = |q: usize| match share[q] {
                        0.0 => 0.0,
                        on => on.signum() * p.current[q][k],
                    };
                    let current = 0.5 * (along(0) + along(1) + along(2));
                    share.map(|on| on * 0.5 * (current / width).tanh())
                })
                .collect();
            vec![voltages(&|q, k| drop[k][q])]
        }
        EffectKind::SupplySag if p.supply.is_some() && p.voltage.is_some() => {
            let (v, dc) = (p.voltage.as_ref()?, p.supply.as_ref()?);
            // what a link with a capacitor draws by its power, or what the legs carry where nothing levels it
            let draw = |k: usize| {
                if shape.first() == Some(&LEGS) {
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
        EffectKind::WindingHeating if p.voltage.is_some() && shape == [WARM] => {
            vec![voltages(&|q, k| r * effect::COPPER_PER_K * p.current[q][k])]
        }
        EffectKind::CurrentOffset => {
            let q = shape[0] as usize;
            let mut column: Column = vec![Piece {
                equation: Equation::Torque,
                order: 0,
                signal: p.mean_over_support(s, q, |trap| ke * trap),
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
            let along = p.mean_over_support(s, q, |trap| ke * trap);
            let mut column: Column = vec![Piece {
                equation: Equation::Torque,
                order: 0,
                signal: (0..s.n).map(|k| along[k] * p.current[q][k]).collect(),
                phase: None,
            }];
            column.extend(less(q));
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
