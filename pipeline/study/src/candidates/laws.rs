//! Other laws of the same effects. A law of friction or of iron is a fit to what others measured: what constants and parameters would
//! be by another that is as usual says how far they may be off for the law's sake.

use crate::candidates::columns::moments;
use crate::candidates::phases::flux_lost;
use crate::equations::pieces::{Column, Piece, RigConstants};
use crate::equations::signals::Signals;
use sim_worker::effect::{self, EffectKind, Equation};

/// Argument of the tangent that is nearest to an exponential rise (least squares over three to five of its speeds).
const AS_STEEP: f64 = 0.72;
/// Exponent of a power's fall over that of the exponential that it is nearest to (least squares: 1.8 to 1.6 for exponents of 0.8 to
/// 2), and its factor, by which both are alike at the exponential's speed.
const AS_SHARP: f64 = 5.0 / 3.0;
const AT_SPEED: f64 = std::f64::consts::E - 1.0;
/// Least share of the torque that is left at the strongest current for the other law of saturation to be asked for.
const LEAST_LEFT: f64 = 0.1;

/// `tanh` less the exponential rise `1 - exp(-x)` of lubricated friction over the speed over its own (Gecim and Winer's limiting
/// shear).
fn rise(x: f64) -> f64 {
    (AS_STEEP * x).tanh() + (-x).exp_m1()
}

/// A power's fall less the exponential one of Stribeck's part, `exp(-x^d)`, over the speed over its own (Hess and Soom 1990).
fn fall(x: f64, exponent: f64) -> f64 {
    (1.0 + AT_SPEED * x.powf(AS_SHARP * exponent)).recip() - (-x.powf(exponent)).exp()
}

/// Share of the torque at a current [A] that a saturating iron takes by its flux, less `coefficient |i|`; both take the same at the
/// strongest current [A]. None where that is nothing or nearly all.
fn saturating(coefficient: f64, strongest: f64) -> Option<impl Fn(f64) -> f64> {
    let left = 1.0 - coefficient * strongest;
    let at = (left > LEAST_LEFT && left < 1.0).then(|| strongest * left / (1.0 - left * left).sqrt())?;
    Some(move |i: f64| flux_lost(at, i) - coefficient * i.abs())
}

/// Currents that give torque [A].
fn currents<'a>(s: &'a Signals, c: &'a RigConstants) -> impl Iterator<Item = f64> + 'a {
    moments(s, c).map(|m| m.current)
}

/// What another law of the effect would add to the torque of each run beyond its own, at the same size. None for effects of one
/// law.
///
/// * `shape`, `amplitudes` as fitted
pub fn otherwise(
    kind: EffectKind,
    shape: &[f64],
    amplitudes: &[f64],
    runs: &[Signals],
    c: &RigConstants,
) -> Option<Vec<Column>> {
    let size = *amplitudes.first()?;
    let each = |signal: &dyn Fn(&Signals) -> Vec<f64>| -> Vec<Column> {
        let column = |s| vec![Piece::of(Equation::Torque, 0, signal(s))];
        runs.iter().map(column).collect()
    };
    let of_speed = |law: &dyn Fn(f64) -> f64| {
        each(&|s| {
            let of = |k: usize| size * s.sign[k] * law(s.omega[k].abs() / shape[0]);
            (0..s.n).map(of).collect()
        })
    };
    Some(match kind {
        EffectKind::LubricatedRise => of_speed(&rise),
        EffectKind::Stribeck => of_speed(&|x| fall(x, shape[1])),
        // what warms up may be a preload or a seal, and then it is the dry friction alone
        EffectKind::TemperatureDependentFriction => each(&|s| {
            let viscous = |m: effect::Signals| {
                let warm = m.temperature - effect::REFERENCE_TEMPERATURE_DEGC;
                -size * warm * c.effect.viscous * m.omega
            };
            moments(s, c).map(viscous).collect()
        }),
        // a flux is one of two laws that were tried, and a size of its own
        EffectKind::TorqueSaturation if shape.is_empty() => {
            let all = runs.iter().flat_map(|s| currents(s, c));
            let strongest = all.fold(0.0, |a: f64, i| a.max(i.abs()));
            let more = saturating(size, strongest)?;
            let taken = |i: f64| c.effect.torque_constant * i * more(i);
            each(&|s| currents(s, c).map(taken).collect())
        }
        _ => return None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn greatest(law: impl Fn(f64) -> f64) -> f64 {
        (0..1000).map(|k| law(0.01 * f64::from(k)).abs()).fold(0.0, f64::max)
    }

    #[test]
    fn other_laws_are_near_and_meet_where_they_say() {
        assert!(rise(0.0) == 0.0 && rise(30.0).abs() < 1e-12);
        assert!((0.02..0.1).contains(&greatest(rise)), "{}", greatest(rise));
        for exponent in [0.8, 1.0, 1.5, 2.0] {
            assert!(fall(0.0, exponent) == 0.0 && fall(1.0, exponent).abs() < 1e-12);
            let most = greatest(|x| fall(x, exponent));
            assert!((0.02..0.1).contains(&most), "{exponent}: {most}");
        }
        for (coefficient, strongest) in [(0.01, 20.0), (0.015, 12.0), (0.02, 20.0)] {
            let more = saturating(coefficient, strongest).unwrap();
            assert!(more(0.0) == 0.0 && more(strongest).abs() < 1e-12 && more(-strongest).abs() < 1e-12);
            // where half is left, weak currents lose less by it
            let middle = more(0.5 * strongest);
            assert!(
                middle < 0.0 && middle > -0.5 * coefficient * strongest,
                "{coefficient}: {middle}"
            );
        }
        assert!(saturating(0.0, 20.0).is_none() && saturating(0.046, 20.0).is_none());
    }
}
