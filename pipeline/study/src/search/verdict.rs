//! How a study ended, from what its models leave of the held-out data.

use crate::equations::problem::Problem;
use crate::measured::bench::Noise;
use crate::search::beside::Beside;
use crate::search::fit::{Fit, WORTH};
use crate::search::select::Material;
use sim_worker::effect::{EffectKind, Equation};

/// An effect is named when it and those before it explain this share of the excess energy.
pub const NAMED_SHARE: f64 = 0.70;
/// Energy over that of the sensors' noise from which more than the rest that a name may leave is another law (assumed): the names
/// that left more in recordings of other hands were relatives of laws that the list does not have.
const REMAINS: f64 = 1.3;
/// Where every equation has this share of its excess explained, nothing remains to be named.
pub const CLEAN_SHARE: f64 = 0.85;
/// Gap over the noise in the transmission beyond which a slow one is no spring and no play (assumed).
const FAR: f64 = 3.5;
/// Energy over that of the noise that cannot be the noise's, with nothing found (assumed).
pub const BEYOND: f64 = 1.35;
/// Same of the torque, whatever its form is, where the drive is measured as means (assumed; plain rigs of another hand: up to 7).
const GROSS: f64 = 30.0;
/// Time over which a torque or voltage that is missing keeps its sign at least (assumed) [s].
pub const SLOW_S: f64 = 0.02;
/// Energy over that of the noise of means over this time that is no noise, with nothing found (assumed); of two
/// sensors of one motion, whose own errors are many, more.
pub const SLOWLY: f64 = 2.0;
const SENSORS_APART: f64 = 12.0;
/// Energy over that of the noise, and of slow means over what is no noise any more, from which nothing is known of a noise that could be it
/// (assumed: rigs of other hands in which nothing is hidden left up to 3.9 and, beside that, 2).
const PLAIN: f64 = 2.0;
const PLAINLY: f64 = 5.0;
/// Share of the phases' voltages, rms, below which what is left of them says nothing (assumed): their equation takes each commutation
/// to last whole samples, and sensors of voltage are hardly more linear.
const FINE: f64 = 1e-3;
/// A table that takes more than this share of an equation's energy has found something (assumed).
pub const UNKNOWN_SHARE: f64 = 0.10;
/// Most that the noise seen from row to row may be over that of the sensors (assumed).
const ROUGH: f64 = 2.0;

/// How a study ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Verdict {
    None,
    Retune,
    Named,
    NamedWithRemainder,
    Ambiguous,
    Unknown,
    /// effects were found, and no data are left to prove them
    Candidate,
}

impl Verdict {
    pub fn name(self) -> &'static str {
        match self {
            Self::None => "none",
            Self::Retune => "retune",
            Self::Named => "named",
            Self::NamedWithRemainder => "named_with_remainder",
            Self::Ambiguous => "ambiguous",
            Self::Unknown => "unknown",
            Self::Candidate => "candidate",
        }
    }

    /// With what was found beside the equations, each proven by itself.
    pub fn beside(self, found: &[Beside]) -> Self {
        let apart = found.iter().all(|b| b.ambiguous.is_empty());
        match self {
            _ if found.is_empty() => self,
            Self::None | Self::Retune if apart => Self::Named,
            Self::None | Self::Retune => Self::Ambiguous,
            Self::Named if !apart => Self::Ambiguous,
            other => other,
        }
    }
}

/// By equation: share of the held-out excess over the noise that was explained; `None` where there
/// was none worth the name.
pub fn shares(p: &Problem, before: &[f64; 5], after: &[f64; 5], residual: Option<&[f64]>) -> [Option<f64>; 5] {
    let noise: [f64; 5] = std::array::from_fn(|e| residual.map_or(0.0, |r| rough_energy(p, r, e)));
    std::array::from_fn(|e| {
        // the controller's own equation has no floor that is known
        let floor = if Equation::ALL[e] == Equation::Controller {
            after[e].min(before[e])
        } else {
            p.sensor_energy(e).max(noise[e])
        };
        (p.rows_of(Equation::ALL[e]) > 0 && before[e] > WORTH * floor)
            .then(|| 1.0 - (after[e] - floor).max(0.0) / (before[e] - floor))
    })
}

/// Energy of the noise in the rows of an equation: that of the sensors, or what is left from row to row where that is
/// more, but not much.
pub fn rough_energy(p: &Problem, residual: &[f64], e: usize) -> f64 {
    let rough = p.by_differences(residual, Equation::ALL[e]);
    let sensors = p.sensor_floor[e];
    p.rows_of(Equation::ALL[e]) as f64 * sensors.max(rough.min(ROUGH * sensors)).powi(2)
}

/// Whether what is left of the transmission's gap is slow: user and motor part company, which no
/// spring and no play does.
fn drifting(p: &Problem, residual: &[f64], gap: f64) -> bool {
    let length = p.clock.block(1.0);
    let (mut slow, mut all) = (0.0, 0.0);
    for b in p.blocks_of(Equation::Transmission) {
        let mut seconds = std::collections::BTreeMap::<usize, (f64, f64)>::new();
        for (row, &k) in b.rows.clone().zip(&b.samples) {
            let s = seconds.entry(k / length).or_default();
            *s = (s.0 + 1.0, s.1 + residual[row]);
            all += residual[row].powi(2);
        }
        slow += seconds.values().map(|s| s.1 * s.1 / s.0).sum::<f64>();
    }
    gap > FAR * FAR && slow > 0.5 * all
}

/// Verdict, share of the excess that is explained, and share of what is left that a table would still take.
///
/// * `beside` whether something was found beside the equations
pub fn conclude(
    m: &Material,
    nominal: &Fit,
    retuned: &Fit,
    model: &Fit,
    ambiguous: &[(EffectKind, Vec<EffectKind>)],
    beside: bool,
) -> (Verdict, f64, f64) {
    let unnamed = m.unnamed(model);
    let held = m.held_problem();
    let judged = m.judged_residual(model);
    let (before, after) = (held.energy(&m.judged_residual(retuned)), held.energy(&judged));
    let by_equation = shares(held, &before, &after, Some(&judged));
    // only what the sensors are known to add can be held against a name
    let drive = m.bench.channel(m.bench.rig.drive);
    let stated = drive.is_some_and(|d| matches!(d.noise, Noise::Known(_)));
    let slow = Equation::ALL.map(|e| held.slow_energy(&judged, e, SLOW_S));
    // greatest share of an equation's energy that a table still takes
    let remainder = (0..5)
        .filter(|e| after[*e] > 0.0)
        .map(|e| unnamed[e] / after[e])
        .fold(0.0, f64::max);
    // what a table finds, or what is far beyond the noise, is an effect that the list does not have
    let slowly = |e: usize| match Equation::ALL[e] {
        Equation::Kinematic => SENSORS_APART,
        _ => SLOWLY,
    };
    // noise of a colour of its own is as strong from one mean to the next
    let lasting = |e: usize| {
        [SLOW_S, 2.0 * SLOW_S].iter().all(|s| {
            let e = Equation::ALL[e];
            held.slow_energy(&judged, e, *s) > SLOWLY * held.unrest(&judged, e, *s)
        })
    };
    let beyond = |e: usize| slow[e] > slowly(e) && lasting(e) && after[e] > BEYOND * held.sensor_energy(e);
    let most = if stated { UNKNOWN_SHARE } else { 2.5 * UNKNOWN_SHARE };
    let fine = |e: usize| {
        let volts = held.phase_volts().filter(|_| Equation::ALL[e] == Equation::Electrical);
        volts.is_some_and(|v| after[e] < held.rows_of(Equation::ALL[e]) as f64 * (FINE * v).powi(2))
    };
    let odd = |e: usize| by_equation[e].is_some() && (remainder > most || stated && beyond(e)) && !fine(e);
    if model.terms.is_empty() {
        // whatever is said of the noise, and whatever its colour: on the runs that find and on those that prove
        let plain = |e: usize| {
            let over =
                |p: &Problem, energy: f64, slow: f64| energy > PLAIN * p.sensor_energy(e) && slow > PLAINLY * slowly(e);
            let slow_of_fit = || m.fit.slow_energy(&model.residual, Equation::ALL[e], SLOW_S);
            over(held, after[e], slow[e]) && over(&m.fit, model.score.energy[e], slow_of_fit())
        };
        // of a drive that is measured as means nothing is lost between samples
        let torque = Equation::Torque.index();
        let over = |p: &Problem, energy: f64| energy > GROSS * p.sensor_energy(torque);
        let means = drive.is_some_and(|d| d.mean);
        let gross = stated && means && over(&m.fit, model.score.energy[torque]) && over(held, after[torque]);
        if gross || (0..4).any(odd) {
            return (Verdict::Unknown, 0.0, remainder);
        }
        if (0..4).any(|e| plain(e) && !fine(e)) {
            let told = if beside {
                Verdict::NamedWithRemainder
            } else {
                Verdict::Unknown
            };
            return (told, 0.0, remainder);
        }
        let worse = (0..5).any(|e| nominal.score.energy[e] > 1.1 * retuned.score.energy[e])
            || m.bench.rig.supply_of_file.is_some();
        let verdict = if worse { Verdict::Retune } else { Verdict::None };
        return (verdict, 0.0, remainder);
    }
    // an effect is not that which leaves its own equation unexplained, neither on the runs that prove nor on those that find
    let touched = |e: usize| model.terms.iter().any(|t| t.equation().index() == e);
    let own: Vec<f64> = (0..5).filter(|e| touched(*e)).filter_map(|e| by_equation[e]).collect();
    let by_fit = shares(
        &m.fit,
        &retuned.score.energy,
        &model.score.energy,
        Some(&model.residual),
    );
    let little = |e: usize, share: Option<f64>, left: f64, p: &Problem| {
        share.is_some_and(|s| s < NAMED_SHARE || s < CLEAN_SHARE && left > REMAINS * p.sensor_energy(e))
    };
    let leaves =
        |e: usize| little(e, by_equation[e], after[e], held) || little(e, by_fit[e], model.score.energy[e], &m.fit);
    let stranger = (0..5).any(|e| touched(e) && leaves(e));
    // each effect has proven itself; where its equation as a whole was within the noise, nothing is left to explain
    let explained = if own.is_empty() {
        1.0
    } else {
        own.iter().sum::<f64>() / own.len() as f64
    };
    let far = drifting(held, &m.held_residual(model), m.over_floor(held, &after)[2]);
    // an equation that an effect has touched, or that was off before as none is in which nothing is missing
    let changed = |e: usize| (before[e] - after[e]).abs() > 0.05 * before[e];
    let off = |e: usize, energy: &[f64; 5]| energy[e] > BEYOND * held.sensor_energy(e);
    let counts = |e: usize| match touched(e) || odd(e) {
        true => changed(e) || off(e, &before),
        // what is left of an equation that others only follow in is held against a name as it is where nothing was found
        false => changed(e) && off(e, &after),
    };
    let counted = (0..5).filter(|e| counts(*e)).filter_map(|e| by_equation[e]);
    let worst = counted.fold(1.0, |a: f64, b| a.min(b));
    let verdict = if stranger || far {
        Verdict::Unknown
    } else if worst < CLEAN_SHARE {
        Verdict::NamedWithRemainder
    } else if ambiguous.iter().any(|a| !a.1.is_empty()) {
        Verdict::Ambiguous
    } else {
        Verdict::Named
    };
    (verdict, explained, remainder)
}
