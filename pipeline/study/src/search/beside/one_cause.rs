//! Constants that are off together, and the one cause that they have.

use super::found;
use crate::equations::nuisances::Nuisance;
use crate::search::beside::Beside;
use crate::search::fit::{self, Fit, Term};
use crate::search::intervals::intervals;
use crate::search::select::Material;
use sim_worker::effect::{COPPER_PER_K, EffectKind, NORMAL_95};

/// How far constants of units of one type differ, one sigma relative: resistance at 20 degC, inductance, inertia
/// (assumed); and squared standard deviations that an explanation must take.
const OF_UNITS: [(&str, f64); 3] = [("resistance", 0.04), ("inductance", 0.03), ("inertia", 0.08)];
const TOGETHER: f64 = 9.0;
/// Same of a rig, whose constants are trusted as its bench says: it knows no other unit of its type (assumed).
const TOGETHER_OF_RIG: f64 = 16.0;
/// Constants that a rig's gain of the current changes; its inductance is known too roughly.
const OF_RIG: [&str; 4] = ["resistance", "inertia", "coulomb", "viscous"];
/// Squared standard deviations by which another explanation must be worse.
const APART: f64 = 4.0;

/// What stands behind constants that are off together.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Behind {
    /// logarithm of the factor of the resistance
    Warm(f64),
    /// logarithm of the factor of the measured current
    Gain(f64),
}

/// A constant over what was believed of it, logarithm, and how far it may be off, one sigma.
#[derive(Clone, Copy, Debug)]
struct Off {
    name: &'static str,
    x: f64,
    sd: f64,
}

impl Off {
    /// Power of a current's gain that the constant shows: what is divided by a current that is too great is too small.
    fn by(&self) -> f64 {
        if matches!(self.name, "resistance" | "inductance") {
            -1.0
        } else {
            1.0
        }
    }
}

/// A warm winding raises the resistance alone; a sensor that shows too much current lowers resistance and inductance and
/// raises what has to be moved, all by one factor. What explains them with its standard deviation, whether the other does as
/// well, and squared standard deviations from what was believed without it and with it.
///
/// * `least` squared standard deviations that an explanation must take
fn explained(all: &[Off], least: f64) -> Option<(Behind, f64, bool, f64, f64)> {
    let of = |left: &dyn Fn(&Off) -> f64| -> f64 { all.iter().map(|o| (left(o) / o.sd).powi(2)).sum() };
    let weight = |o: &Off| o.sd.powi(-2);
    let weights = all.iter().map(weight).sum::<f64>();
    let g = all.iter().map(|o| weight(o) * o.by() * o.x).sum::<f64>() / weights;
    let resistance = all.iter().find(|o| o.name == "resistance")?;
    let left = |o: &Off| o.x - o.by() * g;
    let (plain, gain) = (of(&|o| o.x), of(&left));
    let warm = of(&|o| if o.name == "resistance" { 0.0 } else { o.x });
    let is_warm = resistance.x > 0.0 && plain - warm > least;
    let is_gain = plain - gain > least && all.iter().all(|o| left(o).abs() <= o.x.abs().max(2.0 * o.sd));
    let (behind, sd, after, other, is_other) = if is_gain && (!is_warm || gain < warm) {
        (Behind::Gain(g), weights.sqrt().recip(), gain, warm, is_warm)
    } else if is_warm {
        (Behind::Warm(resistance.x), resistance.sd, warm, gain, is_gain)
    } else {
        return None;
    };
    Some((behind, sd, is_other && other - after < APART, plain, after))
}

/// What the constants say together.
pub fn together(m: &Material, model: &Fit, first: &[Nuisance]) -> Option<Beside> {
    // effects that a resistance or an inertia gives way to
    let disturbing = |t: &Term| {
        matches!(
            t.kind,
            EffectKind::DeadTime | EffectKind::TurnShort | EffectKind::Compliance | EffectKind::Backlash
        )
    };
    if m.held.is_none() || model.terms.iter().any(disturbing) {
        return None;
    }
    let off = |name: &'static str, sd: Option<f64>| -> Option<Off> {
        let believed = first.iter().find(|n| n.name == name)?;
        let sd = sd.or(believed.trust).filter(|t| *t > 0.0)?;
        let x = (fit::constant(&m.nuisances, model, name) / believed.nominal).ln();
        x.is_finite().then_some(Off { name, x, sd })
    };
    let (all, least, seen) = if m.bench.has_phases() {
        let all: Option<Vec<Off>> = OF_UNITS.iter().map(|c| off(c.0, Some(c.1))).collect();
        (
            all?,
            TOGETHER,
            "constants against those of the type, in their standard deviations",
        )
    } else {
        // what is fixed or free says nothing
        let all = OF_RIG.iter().filter_map(|name| off(name, None)).collect();
        (
            all,
            TOGETHER_OF_RIG,
            "constants against what they were trusted, in standard deviations",
        )
    };
    explained(&all, least)?;
    // what they are known to by themselves counts too; it takes longer to work out than to see that nothing is to be explained
    let known = intervals(m, model).nuisance;
    let of = |o: Off| {
        let k = m.nuisances.iter().position(|n| n.name == o.name);
        let own = k.map_or(0.0, |k| known[k] / NORMAL_95);
        Off {
            sd: o.sd.hypot(own),
            ..o
        }
    };
    let all: Vec<Off> = all.into_iter().map(of).collect();
    let (behind, sd, either, before, after) = explained(&all, least)?;
    let rms = (before.sqrt(), after.sqrt());
    let (kind, other, value, sd, factors) = match behind {
        Behind::Gain(g) => (
            EffectKind::CurrentGain,
            EffectKind::WindingHeating,
            g.exp_m1(),
            g.exp() * sd,
            [
                ("resistance", g),
                ("inductance", g),
                ("inertia", -g),
                ("coulomb", -g),
                ("viscous", -g),
            ]
            .map(|(name, g)| (name, g.exp()))
            .to_vec(),
        ),
        Behind::Warm(x) => (
            EffectKind::WindingHeating,
            EffectKind::CurrentGain,
            x.exp_m1() / COPPER_PER_K,
            sd * x.exp() / COPPER_PER_K,
            vec![("resistance", (-x).exp())],
        ),
    };
    Some(Beside {
        ambiguous: if either { vec![other] } else { Vec::new() },
        factors,
        ..found(kind, (value, sd), (seen, "-"), rms)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn constants_that_are_off_together_have_one_cause() {
        let explained = |x: [f64; 3]| {
            let of = |(c, x): (&(&'static str, f64), f64)| Off { name: c.0, x, sd: c.1 };
            super::explained(&OF_UNITS.iter().zip(x).map(of).collect::<Vec<_>>(), TOGETHER)
        };
        assert!(explained([0.0, 0.0, 0.0]).is_none());
        // within what units of a type differ
        assert!(explained([0.04, -0.02, 0.08]).is_none());
        // a winding 50 K warmer
        let warm = (50.0 * COPPER_PER_K).ln_1p();
        let (behind, _, either, _, after) = explained([warm, 0.01, -0.03]).unwrap();
        assert_eq!((behind, either), (Behind::Warm(warm), false));
        assert!(after < 0.5);
        // currents 12 % too great
        let g = 0.12_f64.ln_1p();
        let (behind, _, _, before, after) = explained([-g, -g, g]).unwrap();
        assert!(matches!(behind, Behind::Gain(x) if (x - g).abs() < 1e-12), "{behind:?}");
        assert!(before > 20.0 && after < 1e-9);
        // 10 % too small looks like a warm winding with another inductance
        let (behind, ..) = explained([-(0.9_f64.ln()), -(0.9_f64.ln()), 0.9_f64.ln()]).unwrap();
        assert!(matches!(behind, Behind::Gain(x) if x < 0.0), "{behind:?}");
    }
}
