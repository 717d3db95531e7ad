//! The candidate effects driven by measured signals: for given shape parameters, what each would
//! add to the equations. The equations themselves stand in `sim_worker::effect`.

use crate::candidates::bristles::{STATIC, breaks_away, dahl};
use crate::candidates::loads::loose;
use crate::candidates::phases::{BRIDGED, LEGS, WARM, of_phases};
use crate::candidates::shapes::{SQUARE, STOPS_AT_ONCE};
use crate::candidates::springs;
use crate::equations::phases::SUPPLY;
use crate::equations::pieces::{Column, Piece, RigConstants};
use crate::equations::signals::Signals;
use crate::measured::samples::{rate_of, shifted};
use sim_worker::effect::{self, Effect, EffectKind, Equation, Law};
use sim_worker::trig::sin_cos;
use std::f64::consts::{FRAC_PI_2, TAU};

/// An effect's contribution: a part that has no amplitude, and the columns of its amplitudes.
#[derive(Default)]
pub struct Contribution {
    pub fixed: Column,
    pub linear: Vec<Column>,
}

/// An amplitude at which saturation is linear in it [1/A].
const SMALL: f64 = 1e-6;

/// Which parameters of an effect are linear amplitudes, which are shape.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Form {
    /// the first parameter is an amplitude, the others shape
    Amplitude,
    /// amplitude and phase are two linear amplitudes, the order is shape
    Periodic,
    /// all parameters are shape
    Shape,
    /// stiffness from the dry friction and a distance, which is shape; damping is an amplitude
    Presliding,
    /// a temperature rise from the share of the measured one
    Heating,
}

pub fn form(kind: EffectKind) -> Form {
    match kind {
        EffectKind::PeriodicFriction
        | EffectKind::Cogging
        | EffectKind::TorqueRipple
        | EffectKind::Eccentricity
        | EffectKind::EncoderEccentricity => Form::Periodic,
        EffectKind::Compliance | EffectKind::Backlash | EffectKind::CommutationOffset | EffectKind::ControlDelay => {
            Form::Shape
        }
        EffectKind::Presliding => Form::Presliding,
        EffectKind::WindingHeating => Form::Heating,
        _ => Form::Amplitude,
    }
}

/// The drive's signal without what its sensor adds: a ripple of it would be a torque that goes with the angle alone.
pub(super) fn drive(s: &Signals, c: &RigConstants, k: usize) -> f64 {
    let (offset, late) = c.drive_error;
    s.drive[k] - offset - late / s.rate_hz * s.drive_rate[k]
}

pub(super) fn moments<'a>(s: &'a Signals, c: &'a RigConstants) -> impl Iterator<Item = effect::Signals> + 'a {
    (0..s.n).map(move |k| effect::Signals {
        theta: s.theta[k],
        rest: s.rest,
        omega: s.omega[k],
        sign: s.sign[k],
        current: drive(s, c, k),
        current_rate: s.drive_rate[k],
        load: s.load_level[k],
        temperature: s
            .temperature
            .as_ref()
            .map_or(effect::REFERENCE_TEMPERATURE_DEGC, |t| t[k]),
        // what is asked for is the duty of the supply at rest
        duty: s.voltage.as_ref().map_or(0.0, |v| v[k]) / c.supply_voltage.max(1e-3),
    })
}

/// Points of a rotor turn at which steps of an effect are resolved.
const POINTS: usize = 4096;

/// Mean over each sample, in which the rotor turns on at its speed, of a share that depends on the
/// angle alone: from the share's integral over a turn.
fn mean_share(e: &Effect, s: &Signals, c: &RigConstants) -> Vec<f64> {
    let step = TAU / POINTS as f64;
    let mut sum = 0.0;
    let mut integral = Vec::with_capacity(POINTS + 1);
    integral.push(0.0);
    for i in 0..POINTS {
        let theta = (i as f64 + 0.5) * step;
        let moment = effect::Signals {
            theta,
            ..Default::default()
        };
        sum += e.constant_share(&moment, &c.effect) * step;
        integral.push(sum);
    }
    let until = |theta: f64| -> f64 {
        let turns = (theta / TAU).floor();
        let at = (theta / TAU - turns) * POINTS as f64;
        let i = (at as usize).min(POINTS - 1);
        turns * sum + integral[i] + (at - i as f64) * (integral[i + 1] - integral[i])
    };
    let half = 0.5 / s.rate_hz;
    (0..s.n)
        .map(|k| {
            // never narrower than a point of the table
            let reach = (s.omega[k] * half).abs().max(0.5 * step);
            (until(s.theta[k] + reach) - until(s.theta[k] - reach)) / (2.0 * reach)
        })
        .collect()
}

/// Torque and voltage of an effect over a run, means over each sample.
fn driven(e: &Effect, s: &Signals, c: &RigConstants) -> Column {
    let electrical = s.voltage.is_some() && c.measured_current;
    let (torque, voltage): (Vec<f64>, Option<Vec<f64>>) = match e.kind {
        EffectKind::Eccentricity | EffectKind::TurnShort | EffectKind::CommutationOffset => {
            let share = mean_share(e, s, c);
            let (t, v) = moments(s, c)
                .zip(share)
                .map(|(m, share)| e.shared(&m, &c.effect, share))
                .unzip();
            (t, electrical.then_some(v))
        }
        _ => {
            let torque = moments(s, c).map(|m| e.torque(&m, &c.effect)).collect();
            let other = matches!(
                e.kind,
                EffectKind::CurrentOffset | EffectKind::CurrentGain | EffectKind::DeadTime | EffectKind::SupplySag
            );
            let voltage = (electrical && other).then(|| moments(s, c).map(|m| e.voltage(&m, &c.effect)).collect());
            (torque, voltage)
        }
    };
    of_both(torque, voltage)
}

fn of_both(torque: Vec<f64>, voltage: Option<Vec<f64>>) -> Column {
    let mut column = Vec::new();
    if torque.iter().any(|x| *x != 0.0) {
        column.push(Piece::of(Equation::Torque, 0, torque));
    }
    if let Some(signal) = voltage {
        column.push(Piece::of(Equation::Electrical, 0, signal));
    }
    column
}

/// Cosine and sine of an order of the turn, each with what the effect makes of a wave of 1, means over each sample at a steady speed. An
/// order that is no whole number has no table over one turn.
fn waves(kind: EffectKind, order: f64, s: &Signals, c: &RigConstants) -> Vec<Column> {
    let ripple = kind == EffectKind::TorqueRipple;
    let electrical = ripple && s.voltage.is_some() && c.measured_current;
    // of order 0 the wave is its amplitude
    let one = Effect::new(kind, &[1.0, 0.0, 0.0]);
    let mut torques = [Vec::with_capacity(s.n), Vec::with_capacity(s.n)];
    let mut voltages = [Vec::new(), Vec::new()];
    for m in moments(s, c) {
        let (torque, voltage) = if ripple {
            one.shared(&m, &c.effect, 1.0)
        } else {
            (one.torque(&m, &c.effect), 0.0)
        };
        let x = 0.5 * order * m.omega / s.rate_hz;
        let blur = if x.abs() > 1e-6 { sin_cos(x).0 / x } else { 1.0 };
        let (sin, cos) = sin_cos(order * m.theta);
        for (i, wave) in [cos, sin].into_iter().enumerate() {
            torques[i].push(torque * (wave * blur));
            if electrical {
                voltages[i].push(voltage * (wave * blur));
            }
        }
    }
    let each = torques.into_iter().zip(voltages);
    each.map(|(t, v)| of_both(t, electrical.then_some(v))).collect()
}

/// `sin` and `cos` of the angle, times what an angle error does to each equation.
///
/// * `both` the speed is that of the same sensor and has the error's derivative in it
fn encoder(s: &Signals, c: &RigConstants, both: bool, f: fn(f64) -> f64) -> Column {
    // without phases the angle of the signals is the true one already
    let at = |t: &f64| if s.phases.is_some() { c.true_angle(*t) } else { *t };
    let error: Vec<f64> = s.theta.iter().map(|t| f(at(t))).collect();
    let times = |g: f64| -> Vec<f64> { error.iter().map(|e| g * e).collect() };
    let mut column = Vec::new();
    let mut add = |equation, order, signal| column.push(Piece::of(equation, order, signal));
    add(Equation::Kinematic, 0, times(1.0));
    if both {
        add(Equation::Kinematic, 1, rate_of(&error, s.rate_hz).collect());
    }
    if (c.from_position || both) && s.voltage.is_some() {
        add(Equation::Electrical, 1, times(-c.back_emf));
    }
    if s.user.is_some() {
        add(Equation::Transmission, 0, times(-1.0));
    }
    if s.velocity.is_some() && c.speed_gain > 0.0 {
        // the law acts on the true speed, ours on that of the position
        add(Equation::Controller, 2, times(c.speed_gain));
    }
    column
}

/// What `kind` with the shape parameters `shape` would add; empty where the channels it needs are not there.
pub fn contribution(kind: EffectKind, shape: &[f64], s: &Signals, c: &RigConstants) -> Contribution {
    let mut out = Contribution::default();
    if let Some(linear) = of_phases(kind, shape, s, c) {
        out.linear = linear;
        return out;
    }
    let amplitude = |values: &[f64]| driven(&Effect::new(kind, values), s, c);
    match kind {
        EffectKind::TorqueSaturation
        | EffectKind::TorqueRipple
        | EffectKind::Eccentricity
        | EffectKind::CommutationOffset
        | EffectKind::TurnShort
        | EffectKind::CurrentOffset
        | EffectKind::CurrentGain
            if !c.motor => {}
        EffectKind::LoadDependentFriction if !s.has_load => {}
        EffectKind::TemperatureDependentFriction if s.temperature.is_none() => {}
        EffectKind::WindingHeating if s.temperature.is_none() || shape == [WARM] => {
            // amplitude 1: a kelvin at the warmest of a run, by time or by the losses, or all the time
            if s.voltage.is_some() && c.measured_current {
                let warmth = match shape {
                    [WARM] => vec![1.0; s.n],
                    _ => warmth(s, shape[0] > 1.5, shape.get(1).copied().unwrap_or(1e3)),
                };
                let signal = (0..s.n).map(|k| c.effect.resistance * effect::COPPER_PER_K * warmth[k] * s.drive[k]);
                out.linear
                    .push(vec![Piece::of(Equation::Electrical, 0, signal.collect())]);
            }
        }
        EffectKind::WindingHeating => {
            // amplitude 1: the winding is as much warmer than 20 degC as the sensor says
            if s.voltage.is_some() {
                let t = s.temperature.as_ref().expect("checked");
                let signal = (0..s.n).map(|k| {
                    let rise = t[k] - effect::REFERENCE_TEMPERATURE_DEGC;
                    c.effect.resistance * effect::COPPER_PER_K * rise * s.drive[k]
                });
                out.linear
                    .push(vec![Piece::of(Equation::Electrical, 0, signal.collect())]);
            }
        }
        EffectKind::DeadTime => {
            if s.voltage.is_some() && c.measured_current {
                // how sharply it turns over with the current depends on the bridge and the ripple
                let offset = c.drive_error.0;
                let signal = s.drive.iter().map(|i| ((i - offset) / shape[0]).tanh()).collect();
                out.linear.push(vec![Piece::of(Equation::Electrical, 0, signal)]);
            }
        }
        EffectKind::SupplySag => {
            // the voltage as it was asked for, of a supply that gives way
            let mut column = Column::new();
            if shape[0] > 0.5 {
                column.extend(amplitude(&[1.0]));
            }
            if let (true, Some(dc), Some(v)) = (shape[0] < 1.5, &s.supply, &s.voltage) {
                // drawn by the duty; what was asked for is the duty of the supply at rest
                let asked = shape[0] > 0.5;
                let draw = |k: usize| {
                    let whole = if asked { c.supply_voltage } else { dc[k] };
                    v[k] / whole.max(1e-3) * s.drive[k]
                };
                column.push(Piece {
                    equation: Equation::Electrical,
                    order: 0,
                    signal: (0..s.n).map(|k| -draw(k)).collect(),
                    phase: Some(SUPPLY),
                });
            }
            if !column.is_empty() {
                out.linear.push(column);
            }
        }
        EffectKind::EncoderEccentricity => {
            // an angle sensor that is out of centre is seldom round either: twice a turn comes along
            let forms: [fn(f64) -> f64; 4] = [f64::sin, f64::cos, |t| (2.0 * t).sin(), |t| (2.0 * t).cos()];
            let both = shape.first().is_some_and(|x| *x > 0.5);
            out.linear = forms.map(|f| encoder(s, c, both, f)).into();
            if s.phases.is_none() {
                // what was found before is out of the signals' speed already
                for (found, column) in [c.encoder.0, c.encoder.1].into_iter().zip(&out.linear) {
                    let volts = column
                        .iter()
                        .filter(|p| p.equation == Equation::Electrical && found != 0.0);
                    out.fixed.extend(volts.map(|p| {
                        let signal = p.signal.iter().map(|x| -found * x).collect();
                        Piece::of(p.equation, p.order, signal)
                    }));
                }
            }
        }
        EffectKind::PeriodicFriction | EffectKind::Cogging | EffectKind::TorqueRipple => {
            out.linear = waves(kind, shape[0], s, c);
        }
        EffectKind::Eccentricity => {
            out.linear = vec![amplitude(&[1.0, 0.0]), amplitude(&[1.0, -FRAC_PI_2])];
        }
        EffectKind::CommutationOffset => {
            // the angle that is measured is the one commutated by (0), or the true one (1)
            let turned = Signals {
                theta: s
                    .theta
                    .iter()
                    .map(|t| t - (1.0 - shape[1]) * shape[0] / c.effect.pole_pairs)
                    .collect(),
                ..s.clone()
            };
            out.fixed = driven(&Effect::new(kind, &shape[..1]), &turned, c);
        }
        EffectKind::CurrentGain => {
            // linear in g/(1+g); in the torque that the model expects the motion's noise would stand as it does in the rows
            if s.voltage.is_some() && c.measured_current {
                let current: Vec<f64> = (0..s.n).map(|k| drive(s, c, k)).collect();
                let times = |by: f64| current.iter().map(|i| by * i).collect();
                out.linear.push(vec![
                    Piece::of(Equation::Torque, 0, times(c.effect.torque_constant)),
                    Piece::of(Equation::Electrical, 0, times(-c.effect.resistance)),
                    Piece::of(Equation::Electrical, 1, times(-c.effect.inductance)),
                ]);
            }
        }
        EffectKind::Presliding => {
            let break_away = if breaks_away(shape) { c.effect.break_away } else { 1.0 };
            let sliding = dahl(s, shape[0], break_away);
            let signal = sliding
                .iter()
                .zip(&s.sign)
                .map(|(z, sign)| c.effect.coulomb * (z - sign));
            // all of the dry friction is theirs: a share of it left free stands for another way of turning round
            out.fixed.push(Piece::of(Equation::Torque, 0, signal.collect()));
            // damping of the bristles, whose deflection is `distance` at most
            out.linear.push(vec![Piece::of(
                Equation::Torque,
                1,
                sliding.iter().map(|z| shape[0] * z).collect(),
            )]);
        }
        EffectKind::Backlash => {
            if s.user.is_some() {
                // the gap alone, or a load that runs on by itself: slowed down, pushed by what loads it, bouncing
                let further = |i: usize, alone: f64| shape.get(i).copied().unwrap_or(alone);
                let (slowing, pushed, bounce) = (further(1, STOPS_AT_ONCE), further(2, 0.0), further(3, 0.0));
                let (followed, speed) = loose(s, 0.5 * shape[0], slowing, pushed, bounce);
                let signal = followed.iter().zip(&s.theta).map(|(u, t)| u - t);
                out.fixed.push(Piece::of(Equation::Transmission, 0, signal.collect()));
                // what the motor feels of the load beyond a rigid shaft: its friction, its inertia
                let turned = speed
                    .iter()
                    .zip(&s.sign)
                    .map(|(w, sign)| if *w == 0.0 { -sign } else { w.signum() - sign });
                let slower = speed.iter().zip(&s.omega).map(|(w, m)| w - m);
                for (order, signal) in [(0, turned.collect()), (1, slower.collect())] {
                    out.linear.push(vec![Piece::of(Equation::Torque, order, signal)]);
                }
            }
        }
        EffectKind::Compliance => return springs::contribution(shape, s, c),
        EffectKind::TorqueSaturation => {
            // linear while the torque still rises with the current
            let mut column = if shape == SQUARE {
                driven(&Effect::new(kind, &[SMALL.sqrt()]).by(Law::Square), s, c)
            } else {
                amplitude(&[SMALL])
            };
            column
                .iter_mut()
                .for_each(|p| p.signal.iter_mut().for_each(|x| *x /= SMALL));
            out.linear.push(column);
        }
        EffectKind::SpringLoad => {
            out.linear.push(amplitude(&[1.0]));
            // where the spring is at ease is not known; a constant torque that is among the constants says it already
            if !c.offset {
                out.linear.push(vec![Piece::of(Equation::Torque, 0, vec![1.0; s.n])]);
            }
        }
        EffectKind::ControlDelay => {
            let late = |x: &[f64]| shifted(x, -shape[0] * s.rate_hz);
            if let Some((law, _)) = &s.law {
                let signal = late(law).into_iter().zip(law).map(|(l, p)| l - p).collect();
                out.fixed.push(Piece::of(Equation::Controller, 1, signal));
            }
            if !c.measured_current {
                // what was demanded drives the motor later
                let kt = c.effect.torque_constant;
                let signal = late(&s.drive).into_iter().zip(&s.drive).map(|(l, p)| kt * (p - l));
                out.fixed.push(Piece::of(Equation::Torque, 0, signal.collect()));
            }
        }
        _ => {
            let mut values = vec![1.0];
            // the shapes of some are only for phases
            values.extend(shape.iter().take(kind.keys().len() - 1));
            let column = amplitude(&values);
            if !column.is_empty() {
                out.linear.push(column);
            }
        }
    }
    out.linear.retain(|c| !c.is_empty());
    out
}

/// Rise of a winding over its greatest in a run, by the time or by the losses, that comes to rest with a time constant of
/// `share` of the run.
fn warmth(s: &Signals, by_losses: bool, share: f64) -> Vec<f64> {
    let step = 1.0 / (share * s.n as f64).max(1.0);
    let mut rise = 0.0;
    let mut all: Vec<f64> = s
        .drive
        .iter()
        .map(|i| {
            rise += step * (if by_losses { i * i } else { 1.0 } - rise);
            rise
        })
        .collect();
    let most = all.iter().fold(1e-300, |a: f64, x| a.max(*x));
    all.iter_mut().for_each(|x| *x /= most);
    all
}

/// What is believed of the amplitudes of an effect before the fit: their standard deviation around 0, none where they may be
/// anything. Friction behind a spring is a share of the friction that there is; left free it runs away along with the clocks of
/// the sensors, and takes the spring's damping with it.
pub fn trust(kind: EffectKind) -> Option<f64> {
    (kind == EffectKind::Compliance).then_some(1.0)
}

/// The effect from shape parameters and fitted amplitudes.
///
/// * `coulomb`, `hottest` nominal dry friction [N m] and greatest measured rise over 20 degC [K]
pub fn effect(kind: EffectKind, shape: &[f64], amplitudes: &[f64], coulomb: f64, hottest: f64) -> Effect {
    let a = |i: usize| amplitudes.get(i).copied().unwrap_or(0.0);
    let law = match kind {
        EffectKind::SupplySag if shape.first() == Some(&LEGS) => Law::Legs,
        EffectKind::TurnShort if shape.get(1) == Some(&BRIDGED) => Law::Bridged,
        EffectKind::EncoderEccentricity if shape.first().is_some_and(|x| *x > 0.5) => Law::AngleAndSpeed,
        EffectKind::TorqueSaturation if shape == SQUARE => Law::Square,
        EffectKind::TorqueSaturation if !shape.is_empty() => Law::Flux,
        EffectKind::Presliding if breaks_away(shape) => Law::BreakAway,
        EffectKind::CurrentGain => shape.first().map_or(Law::First, |q| Law::Phase(*q as usize)),
        _ => Law::First,
    };
    let values: Vec<f64> = match form(kind) {
        Form::Amplitude if kind == EffectKind::CurrentGain => vec![a(0) / (1.0 - a(0))],
        Form::Amplitude if law == Law::Flux => vec![a(0).max(0.0).sqrt() / shape[0]],
        Form::Amplitude if law == Law::Square => vec![a(0).max(0.0).sqrt()],
        Form::Amplitude if kind.keys().len() == 1 => vec![a(0)],
        Form::Amplitude if kind == EffectKind::TurnShort => vec![a(0), shape[0]],
        Form::Amplitude => [&[a(0)], shape].concat(),
        Form::Periodic if kind == EffectKind::EncoderEccentricity => vec![a(0).hypot(a(1)), a(1).atan2(a(0))],
        Form::Periodic => [&[a(0).hypot(a(1)), (-a(1)).atan2(a(0))], shape].concat(),
        Form::Shape => shape[..kind.keys().len()].to_vec(),
        Form::Presliding => vec![coulomb / shape[0], a(0).max(0.0)],
        Form::Heating if shape.first().is_some_and(|s| *s > 0.5) => vec![a(0)],
        Form::Heating => vec![a(0) * hottest],
    };
    Effect::new(kind, &values).wrapped().by(law)
}

/// Shape parameters and amplitudes of an effect: the way back.
pub fn parts(e: &Effect, coulomb: f64, hottest: f64) -> (Vec<f64>, Vec<f64>) {
    let v = &e.values[..e.kind.keys().len()];
    match form(e.kind) {
        Form::Amplitude if e.kind == EffectKind::CurrentGain => {
            let of = e.sensor().map(|q| q as f64);
            (of.into_iter().collect(), vec![v[0] / (1.0 + v[0])])
        }
        Form::Amplitude if e.law == Law::Flux => (vec![1.0 / v[0]], vec![1.0]),
        Form::Amplitude if e.law == Law::Square => (SQUARE.to_vec(), vec![v[0] * v[0]]),
        Form::Amplitude if e.kind == EffectKind::CurrentOffset => (vec![0.0], vec![v[0]]),
        Form::Amplitude if e.kind == EffectKind::SpringLoad => (vec![], vec![v[0], 0.0]),
        Form::Amplitude if e.kind == EffectKind::SupplySag => {
            (vec![if e.law == Law::Legs { LEGS } else { 2.0 }], vec![v[0]])
        }
        Form::Amplitude if e.law == Law::Bridged => (vec![v[1], BRIDGED], vec![v[0]]),
        Form::Amplitude if e.kind == EffectKind::DeadTime => (vec![0.05], vec![v[0]]),
        Form::Amplitude => (v[1..].to_vec(), vec![v[0]]),
        Form::Periodic if e.kind == EffectKind::EncoderEccentricity => {
            let of_speed = f64::from(u8::from(e.law == Law::AngleAndSpeed));
            (vec![of_speed], vec![v[0] * v[1].cos(), v[0] * v[1].sin(), 0.0, 0.0])
        }
        Form::Periodic => (v[2..].to_vec(), vec![v[0] * v[1].cos(), -v[0] * v[1].sin()]),
        Form::Shape if e.kind == EffectKind::Backlash => (vec![v[0]], vec![0.0, 0.0]),
        Form::Shape if e.kind == EffectKind::CommutationOffset => (vec![v[0], 1.0], vec![]),
        Form::Shape => (v.to_vec(), vec![]),
        Form::Presliding => {
            let law = (e.law == Law::BreakAway).then_some(STATIC);
            let shape = std::iter::once(coulomb / v[0]).chain(law);
            (shape.collect(), vec![v[1]])
        }
        Form::Heating if hottest <= 0.0 => (vec![WARM], vec![v[0]]),
        Form::Heating => (vec![0.0], vec![v[0] / hottest.max(1e-9)]),
    }
}
