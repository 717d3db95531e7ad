//! What no equation says of an actuator of ours whose voltages are not recorded: the current tells torques by the torque constant alone,
//! and nothing tells it. But a motor that runs as fast as its supply lets it does, and the simulated loop under the recorded
//! command runs into the same limits.

use crate::measured::bench::{Bench, BenchChannel, Role};
use crate::measured::sums::scatter;
use crate::search::study::OfLoop;
use crate::told::knobs::{self, KNOBS, Knob, PIECE_S, STEP};
use crate::told::verify::{self, AT_ONCE, OfRuns, Simulated};
use nalgebra::{DMatrix, DVector};
use schemas::error::Result;
use sim_worker::parameters::ActuatorParameters;

/// Longest step of a round, relative, and rounds.
const LONGEST: f64 = 0.04;
const ROUNDS: usize = 7;
/// Gap over the least before it from which a step went too far (assumed: gaps are weighted, this is not).
const WORSE: f64 = 1.1;
/// Time over which a gap of the angle is one and the same [s] (assumed).
const ONE_S: f64 = 0.05;
/// Share of the angle's gap on held-out runs, rms, that must be gone for the loop to be believed, unless it follows the motion as loops
/// of known constants do (assumed) [rad]: what was right before says how right it is.
const LEAST_SHARE: f64 = 0.2;
const FOLLOWED_RAD: f64 = 0.03;

/// What the loop tells is no better than this, one sigma relative, and of the windings: what the model's step, its relays and another
/// source make of it (assumed; of 20 plain benches of another hand resistance was off by 1.7 % rms, inductance by 3 %).
const LEAST_SD: f64 = 1e-3;
pub const WINDINGS: [(&str, f64); 2] = [("resistance", 1.5e-2), ("inductance", 2.5e-2)];
/// Samples further apart than this say less, and by how much (assumed: at 1 kHz resistance was off by 3 % rms).
const COARSE_S: f64 = 7.5e-4;
const COARSER: f64 = 2.0;

/// A piece of a recording: normal equations of its angle's gap, and the gap itself.
struct Piece {
    proves: bool,
    gram: DMatrix<f64>,
    right: DVector<f64>,
    squared: f64,
    /// squares by what each counts
    counted: f64,
    samples: usize,
    /// samples that say one and the same
    alike: f64,
}

/// Constants that came nearest, logarithms of factors, the gap there on what finds and on what proves, rms [rad], and what the next step
/// says: variances, and where each but one of the pieces would go.
struct Nearest {
    x: DVector<f64>,
    found: f64,
    proven: f64,
    variance: DVector<f64>,
    without: Vec<DVector<f64>>,
}

impl Piece {
    fn empty(proves: bool, knobs: usize, samples: usize) -> Self {
        Self {
            proves,
            gram: DMatrix::zeros(knobs, knobs),
            right: DVector::zeros(knobs),
            squared: 0.0,
            counted: 0.0,
            samples,
            alike: (ONE_S * samples as f64 / PIECE_S).max(1.0),
        }
    }

    /// One more sample.
    fn add(&mut self, gap: f64, slopes: DVector<f64>, usual: f64) {
        let weight = knobs::weight(gap, usual);
        self.gram += weight * &slopes * slopes.transpose();
        self.right += weight * gap * slopes;
        self.squared += gap * gap;
        self.counted += weight * gap * gap;
    }
}

/// Whether the equations of recorded voltages tell a bench's constants.
pub fn told_by_voltages(bench: &Bench) -> bool {
    BenchChannel::VOLTAGES.iter().all(|c| bench.channel(*c).is_some())
}

/// Constants by the simulated loop, each over that of `child`. `None` where the loop does not come nearer to what was measured on
/// runs that prove.
///
/// * `said` constants of the windings as equations told them, and their standard deviations, relative: they may be further off
///   than in units of one type
///
/// # Errors
/// Refuses files that cannot be read.
pub fn by_loop(bench: &Bench, child: &ActuatorParameters, said: &[(String, f64)]) -> Result<Option<Vec<OfLoop>>> {
    let has = |c: &BenchChannel| bench.channel(*c).is_some();
    if !bench.own {
        return Ok(None);
    }
    // a measured supply is known already
    let knobs: Vec<&Knob> = KNOBS
        .iter()
        .filter(|k| k.name != "supply_voltage" || !has(&BenchChannel::VDc))
        .collect();
    let believed: Vec<f64> = knobs
        .iter()
        .map(|k| said.iter().filter(|s| s.0 == k.name).map(|s| s.1).fold(k.sd, f64::max))
        .collect();
    let (all, _) = verify::recordings(bench, &[Role::Fit, Role::Select, Role::HeldOut])?;
    let mut at: DVector<f64> = DVector::zeros(knobs.len());
    let mut usual = f64::INFINITY;
    let mut before = None;
    let mut best: Option<Nearest> = None;
    for _ in 0..ROUNDS {
        let (pieces, scale) = pieces(bench, &all, child, &knobs, &at, usual);
        let (found, proven) = (rms(&pieces, false), held(&pieces));
        before.get_or_insert(proven);
        // a step that leads away went too far
        if let Some(b) = best.as_ref().filter(|b| found > b.found * WORSE) {
            at = 0.5 * (&at + &b.x);
            continue;
        }
        usual = scale;
        let finds: Vec<&Piece> = pieces.iter().filter(|p| !p.proves).collect();
        let step = |out: Option<usize>| stepped(&finds, out, &believed, &at);
        if finds.len() < 3 {
            return Ok(None);
        }
        let Some((now, variance)) = step(None) else {
            return Ok(None);
        };
        let without = (0..finds.len()).filter_map(|k| Some(&at + step(Some(k))?.0)).collect();
        let further = &at + now.map(|d| d.clamp(-LONGEST, LONGEST));
        best = Some(Nearest {
            x: at,
            found,
            proven,
            variance,
            without,
        });
        at = further;
    }
    let Some(best) = best else { return Ok(None) };
    let Nearest {
        x, variance, without, ..
    } = &best;
    let before = before.unwrap_or(0.0);
    let follows = best.proven < before.min(FOLLOWED_RAD);
    if best.proven.is_nan() || !follows && best.proven > (1.0 - LEAST_SHARE) * before {
        return Ok(None);
    }
    // torques, voltages, resistance and inductance that are all greater by the same make the same motion: without a measured supply
    // only what is believed of them says how great they are
    let common: f64 = believed.iter().map(|sd| sd.powi(-2)).sum();
    let common = if has(&BenchChannel::VDc) {
        0.0
    } else {
        common.sqrt().recip()
    };
    let coarse = all.iter().any(|(_, r)| r.time_s[1] - r.time_s[0] > COARSE_S);
    let least = |k: &Knob| {
        let of = WINDINGS.iter().find(|w| w.0 == k.name).map_or(LEAST_SD, |w| w.1);
        of * if coarse { COARSER } else { 1.0 }
    };
    let told = knobs.iter().enumerate().map(|(i, k)| OfLoop {
        name: k.name,
        factor: x[i].exp(),
        sd: scatter(without.iter().map(|w: &DVector<f64>| w[i]), x[i])
            .hypot(variance[i].sqrt())
            .hypot(common)
            .min(believed[i])
            .hypot(least(k)),
    });
    Ok(Some(told.collect()))
}

/// How far constants at `x` are from the best of pieces, all but `out`, and the variances there.
///
/// * `believed` how far they may be off, one sigma
fn stepped(
    finds: &[&Piece],
    out: Option<usize>,
    believed: &[f64],
    x: &DVector<f64>,
) -> Option<(DVector<f64>, DVector<f64>)> {
    let kept = || {
        finds
            .iter()
            .enumerate()
            .filter(|(k, _)| Some(*k) != out)
            .map(|(_, p)| p)
    };
    let samples = kept().map(|p| p.samples).sum::<usize>().max(1) as f64;
    let left = kept().map(|p| p.counted).sum::<f64>() / samples;
    let mut gram: DMatrix<f64> = kept().map(|p| &p.gram / p.alike).sum::<DMatrix<f64>>() / left;
    let mut right: DVector<f64> = kept().map(|p| &p.right / p.alike).sum::<DVector<f64>>() / left;
    for (i, sd) in believed.iter().enumerate() {
        gram[(i, i)] += sd.powi(-2);
        right[i] -= x[i] * sd.powi(-2);
    }
    let gram = gram.cholesky()?;
    Some((gram.solve(&right), gram.inverse().diagonal()))
}

/// Gap of the angle on what proves, or, where nothing does, on all, rms [rad].
fn held(pieces: &[Piece]) -> f64 {
    rms(pieces, pieces.iter().any(|p| p.proves))
}

/// Gap of the angle on what proves, or on what finds, rms [rad].
fn rms(pieces: &[Piece], proves: bool) -> f64 {
    let of = || pieces.iter().filter(|p| p.proves == proves);
    let samples = of().map(|p| p.samples).sum::<usize>().max(1);
    (of().map(|p| p.squared).sum::<f64>() / samples as f64).sqrt()
}

/// The recordings piece by piece at `x`, logarithms of the constants over the child's; and the usual size of a gap there [rad].
fn pieces(
    bench: &Bench,
    all: &[OfRuns<'_>],
    child: &ActuatorParameters,
    knobs: &[&Knob],
    x: &DVector<f64>,
    usual: f64,
) -> (Vec<Piece>, f64) {
    let models = knobs::about(child, knobs, x);
    let (mut out, mut sizes) = (Vec::new(), Vec::new());
    for (runs, recorded) in all {
        let simulated: Vec<Simulated> = verify::driven::<AT_ONCE>(bench, recorded, &models);
        let angles: Vec<&Vec<f64>> = simulated.iter().map(|s| &s[&BenchChannel::Position]).collect();
        let (measured, base, moved) = (&recorded.measured[&BenchChannel::Position], angles[0], &angles[1..]);
        for run in runs {
            for part in recorded.parts(&recorded.samples_of(run), PIECE_S) {
                let mut piece = Piece::empty(run.role == Role::HeldOut, knobs.len(), part.len());
                for &k in part {
                    let gap = measured[k] - base[k];
                    let slopes = DVector::from_iterator(knobs.len(), moved.iter().map(|m| (m[k] - base[k]) / STEP));
                    piece.add(gap, slopes, usual);
                    sizes.push(gap.abs());
                }
                out.push(piece);
            }
        }
    }
    let usual = knobs::usual(sizes);
    (out, usual)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A motor that runs into its limit for a fiftieth of the time and follows its command otherwise: what is off by 5 % shows in those
    /// few samples, and all of it counts against a belief of 2 %.
    #[test]
    fn prop_few_samples_that_tell_are_not_drowned_by_their_own_size() {
        let knobs = [&KNOBS[0]];
        let piece = |x: f64, usual: f64| {
            let mut p = Piece::empty(false, 1, 1000);
            for k in 0..1000 {
                let slope = if k % 50 == 0 { 10.0 } else { 0.0 };
                let noise = 1e-4 * (f64::from(k) * 12.9898).sin();
                p.add(slope * (0.05 - x) + noise, DVector::from_element(1, slope), usual);
            }
            p
        };
        let mut x = DVector::zeros(1);
        let mut usual = f64::INFINITY;
        for _ in 0..ROUNDS {
            let pieces: Vec<Piece> = (0..5).map(|_| piece(x[0], usual)).collect();
            usual = 1e-4;
            let finds: Vec<&Piece> = pieces.iter().collect();
            x += stepped(&finds, None, &[knobs[0].sd], &x)
                .expect("it can be solved")
                .0
                .map(|d| d.clamp(-LONGEST, LONGEST));
        }
        assert!((x[0] - 0.05).abs() < 1e-3, "{x}");
    }
}
