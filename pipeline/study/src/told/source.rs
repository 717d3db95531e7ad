//! What the voltage of an actuator's source goes by, and its resistance, by the simulated loop. What the legs draw between two
//! changes of a relay is in no recording; the relays of the numerical test bench under the recorded command know it.

use crate::equations::phases::size_of;
use crate::measured::bench::{Bench, BenchChannel, Role};
use crate::measured::sums::scatter;
use crate::search::study::Source;
use crate::told::verify::{self, AT_ONCE, Recorded};
use schemas::error::Result;
use sim_worker::effect::{Effect, EffectKind, Law, SOURCES};
use sim_worker::parameters::ActuatorParameters;

/// Place of a law in [`SOURCES`].
fn place(draw: Law) -> usize {
    SOURCES.iter().position(|d| *d == draw).unwrap_or(0)
}

/// Time over which currents and voltages are averaged [s] (assumed): the chatter of recorded and simulated relays is not the same.
const MEAN_S: f64 = 0.02;

/// Share of what the study's law leaves below which another law's must be, to be the source's (assumed).
const BETTER: f64 = 0.8;

/// Of a piece of a recording, mean by mean.
struct Piece {
    /// what the measured voltage is below the supply's [V]
    measured: Vec<f64>,
    /// what the recordings say that is drawn [A]: by the power of the windings, by the size of the legs' current
    instruments: [Vec<f64>; 2],
    /// what the voltage drops by each law with the resistance assumed [V]
    simulated: [Vec<f64>; SOURCES.len()],
}

/// The source of an actuator whose study found one that gives way. Each law is simulated with the resistance assumed; measured over
/// simulated drop, with what the recordings say that is drawn as the instrument, which knows nothing of the simulated relays'
/// chatter, says what to multiply it with. There are two instruments: by the right law they say the same, and little is left
/// by either. `None` where there is no such source, where nothing is measured of it, or where a capacitor levels it, as the study
/// found: its equations then hold as they are.
///
/// * `child` the actuator with what was found
///
/// # Errors
/// Refuses files that cannot be read.
pub fn by_loop(bench: &Bench, child: &ActuatorParameters) -> Result<Option<Source>> {
    let of_source = |e: &&Effect| e.kind == EffectKind::SupplySag;
    let Some((assumed, found)) = child.effects.iter().find(of_source).map(|e| (e.values[0], e.law)) else {
        return Ok(None);
    };
    let pieces = pieces(bench, child)?;
    if pieces.len() < 3 {
        return Ok(None);
    }
    let left = |draw: Law| -> f64 {
        [0, 1]
            .map(|i| left(&pieces, draw, ratio(&pieces, draw, i, None)))
            .iter()
            .sum()
    };
    let least = SOURCES.into_iter().min_by(|a, b| left(*a).total_cmp(&left(*b)));
    let draw = least.filter(|d| left(*d) < BETTER * left(found)).unwrap_or(found);
    // what two legs that are up together do not draw, the size knows nothing of; of the power it is a part
    let (own, other) = match draw {
        Law::First if found == Law::First => return Ok(None),
        Law::Legs => (1, None),
        _ => (0, Some(1)),
    };
    let by = |instrument: usize, without: Option<usize>| assumed * ratio(&pieces, draw, instrument, without);
    let ohm = by(own, None);
    if !(ohm.is_finite() && ohm > 0.0) {
        return Ok(None);
    }
    let apart = other.map_or(0.0, |i| by(i, None) - ohm);
    let sd = scatter((0..pieces.len()).map(|p| by(own, Some(p))), ohm).hypot(apart);
    Ok(Some(Source { draw, ohm, sd }))
}

/// The pieces that find, each law simulated.
fn pieces(bench: &Bench, child: &ActuatorParameters) -> Result<Vec<Piece>> {
    let laws = SOURCES.map(|draw| {
        let mut p = child.clone();
        let sources = p.effects.iter_mut().filter(|e| e.kind == EffectKind::SupplySag);
        sources.for_each(|e| e.law = draw);
        p
    });
    let (all, _) = verify::recordings(bench, &[Role::Fit, Role::Select])?;
    let mut pieces = Vec::new();
    for (runs, recorded) in &all {
        let Some(drawn) = Drawn::of(recorded) else { continue };
        let simulated = verify::driven::<AT_ONCE>(bench, recorded, &laws);
        for run in runs.iter().filter(|r| r.role != Role::HeldOut) {
            let of = recorded.samples_of(run);
            let dropped = |x: &[f64]| means(recorded, &of, |k| child.supply_voltage_v - x[k]);
            pieces.push(Piece {
                measured: dropped(drawn.supply),
                instruments: [
                    means(recorded, &of, |k| drawn.by_power(k)),
                    means(recorded, &of, |k| size_of(&drawn.currents, k)),
                ],
                simulated: std::array::from_fn(|l| dropped(&simulated[l][&BenchChannel::VDc])),
            });
        }
    }
    Ok(pieces)
}

fn mean(x: &[f64]) -> f64 {
    x.iter().sum::<f64>() / x.len().max(1) as f64
}

/// Measured over simulated drop by an instrument, of all pieces but one.
fn ratio(pieces: &[Piece], draw: Law, instrument: usize, without: Option<usize>) -> f64 {
    let (mut measured, mut simulated) = (0.0, 0.0);
    for (_, p) in pieces.iter().enumerate().filter(|(k, _)| Some(*k) != without) {
        let z = &p.instruments[instrument];
        let middle = mean(z);
        let with = |x: &[f64]| z.iter().zip(x).map(|(z, x)| (z - middle) * x).sum::<f64>();
        measured += with(&p.measured);
        simulated += with(&p.simulated[place(draw)]);
    }
    measured / simulated
}

/// What a law leaves of the measured drops, beside a constant of each piece, squared [V2].
fn left(pieces: &[Piece], draw: Law, ratio: f64) -> f64 {
    let of = |p: &Piece| {
        let both = p.measured.iter().zip(&p.simulated[place(draw)]);
        let gap: Vec<f64> = both.map(|(m, s)| m - ratio * s).collect();
        let middle = mean(&gap);
        gap.iter().map(|g| (g - middle).powi(2)).sum::<f64>()
    };
    pieces.iter().map(of).sum()
}

/// What is recorded of the source and of what it feeds.
struct Drawn<'a> {
    supply: &'a Vec<f64>,
    currents: Vec<&'a Vec<f64>>,
    voltages: Vec<&'a Vec<f64>>,
}

impl<'a> Drawn<'a> {
    fn of(r: &'a Recorded) -> Option<Self> {
        let measured = |c: &BenchChannel| r.measured.get(c);
        let all = |of: [BenchChannel; 3]| of.iter().map(measured).collect::<Option<Vec<_>>>();
        Some(Self {
            supply: measured(&BenchChannel::VDc)?,
            currents: all(BenchChannel::CURRENTS)?,
            voltages: all(BenchChannel::VOLTAGES)?,
        })
    }

    /// What the windings take over the voltage of the source [A].
    fn by_power(&self, k: usize) -> f64 {
        let power = self.voltages.iter().zip(&self.currents).map(|(v, i)| v[k] * i[k]);
        power.sum::<f64>() / self.supply[k].max(1.0)
    }
}

/// Means over [`MEAN_S`] of the samples that are given.
fn means(r: &Recorded, of: &[usize], x: impl Fn(usize) -> f64) -> Vec<f64> {
    let mean = |k: &[usize]| k.iter().map(|k| x(*k)).sum::<f64>() / k.len() as f64;
    r.parts(of, MEAN_S).map(mean).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Drops of a source of 0.3 ohm by a law, simulated with 0.2 ohm.
    fn made(law: Law) -> Vec<Piece> {
        let one = |piece: usize| {
            let at = |k: usize| 0.37 * (k + 50 * piece) as f64;
            let power: Vec<f64> = (0..50).map(|k| 1.0 + at(k).sin()).collect();
            let size: Vec<f64> = (0..50).map(|k| 2.0 + (1.7 * at(k)).cos()).collect();
            let drawn = |d: Law, k: usize| match d {
                Law::Bridge => power[k] + 0.1 * size[k].powi(2),
                Law::Legs => size[k],
                _ => power[k],
            };
            let of = |d: Law, ohm: f64| -> Vec<f64> { (0..50).map(|k| ohm * drawn(d, k)).collect() };
            Piece {
                measured: of(law, 0.3).iter().map(|x| x + 0.7).collect(),
                simulated: SOURCES.map(|d| of(d, 0.2)),
                instruments: [power.clone(), size.clone()],
            }
        };
        (0..4).map(one).collect()
    }

    #[test]
    fn prop_by_the_right_law_both_instruments_say_the_same_and_nothing_is_left() {
        for law in SOURCES {
            let pieces = made(law);
            for draw in SOURCES {
                let both = [0, 1].map(|i| ratio(&pieces, draw, i, None));
                let rest = [0, 1].map(|i| left(&pieces, draw, both[i]));
                let same = both.iter().all(|r| (r - 1.5).abs() < 1e-9) && rest.iter().all(|x| *x < 1e-12);
                assert_eq!(same, draw == law, "{law:?} as {draw:?}: {both:?} {rest:?}");
            }
        }
    }
}
