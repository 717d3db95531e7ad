//! Phase currents that are read at points, beside voltages that are means over the samples: whether they are, and the inductance that
//! they tell from point to point.

use crate::measured::sums::{Sums, dot, jackknife};

/// Share of the voltages' changes that the changes of points of the currents explain, and how much more of it than those of means, from
/// which the currents are points (assumed: 0.1 at 2 kHz to 0.96 at 10 kHz and at least six times as much with points, up to 0.24 and twice as
/// much with means).
const OF_POINTS: f64 = 0.09;
const OVER_MEANS: f64 = 4.0;
/// Most that the inductance differs from that of the type, as a factor (assumed): what slow means show now and then is several times it.
const OF_TYPE: f64 = 1.5;
/// Samples of a piece, of which each in turn is left out, and fewest pieces (assumed).
const PIECE: usize = 2000;
const FEWEST: usize = 4;
/// Most that a step of the clock differs from the others, relative (assumed).
const UNEVEN: f64 = 0.05;
/// What the sensors' gains leave of the inductance, one sigma relative (assumed).
const BY_GAINS: f64 = 0.01;

/// What points of the phase currents tell.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Points {
    /// inductance of two phases in series [H]
    pub inductance: f64,
    /// its standard deviation, relative
    pub trust: f64,
}

/// Changes of one phase from sample to sample: of the voltage that is not the neutral's, of its current by its own sensor, and by those
/// of the other two.
struct Phase {
    voltage: Vec<f64>,
    own: Vec<f64>,
    others: Vec<f64>,
}

/// Phase currents that are points: from point to point an inductance takes exactly the mean voltage, from mean to mean half of two.
/// `None` where they are means, where voltages are not measured, and where a relay switches so often between two samples that nothing is
/// seen.
///
/// * `of_type` inductance of two phases of the type, in series [H]
/// * `column` of time [s], currents [A] and voltages [V], by the names of telemetry
pub fn of_phases<'a>(of_type: f64, column: impl Fn(&str) -> Option<&'a [f64]>) -> Option<Points> {
    let three = |names: [&str; 3]| -> Option<[&[f64]; 3]> {
        let [a, b, c] = names.map(&column);
        Some([a?, b?, c?])
    };
    let (i, v) = (three(["i_a", "i_b", "i_c"])?, three(["v_a", "v_b", "v_c"])?);
    let time = column("t")?;
    let n = time.len();
    let step_s = (n > FEWEST * PIECE).then(|| (time[n - 1] - time[0]) / (n - 1) as f64)?;
    let even = |w: &[f64]| ((w[1] - w[0]) / step_s - 1.0).abs() < UNEVEN;
    if !time.windows(2).all(even) {
        return None;
    }
    let phases = [0, 1, 2].map(|q| phase(&i, &v, q));
    let mean = |of: &dyn Fn(&Phase) -> f64| phases.iter().map(of).sum::<f64>() / 3.0;
    let points = mean(&|p| explained(&p.own, &p.voltage));
    // of a mean in the middle of its sample: what the two about it differ by
    let means = mean(&|p| {
        let about: Vec<f64> = p.own.windows(2).map(|w| w[0] + w[1]).collect();
        explained(&about, &p.voltage[..about.len()])
    });
    if !(points > OF_POINTS && points > OVER_MEANS * means) {
        return None;
    }
    // the noise of a sensor is not in the other two: they are its instrument (Durbin 1954)
    let pieces: Vec<Sums> = (0..phases[0].own.len() / PIECE)
        .map(|k| {
            let part = k * PIECE..(k + 1) * PIECE;
            let of = |p: &Phase| {
                let z = &p.others[part.clone()];
                Sums {
                    xx: dot(z, &p.own[part.clone()]),
                    xy: dot(z, &p.voltage[part.clone()]),
                    ..Sums::default()
                }
            };
            Sums::all(&phases.each_ref().map(of))
        })
        .collect();
    let (volts_per_ampere, sd) = jackknife(&pieces)?;
    let inductance = 2.0 * volts_per_ampere * step_s;
    let known = (of_type / OF_TYPE..of_type * OF_TYPE).contains(&inductance) && sd.is_finite();
    known.then(|| Points {
        inductance,
        trust: (sd / volts_per_ampere).hypot(BY_GAINS),
    })
}

/// Second differences leave out what is slow, back-EMF and resistance, and what the points do not say of it is even about each change.
fn phase(i: &[&[f64]; 3], v: &[&[f64]; 3], q: usize) -> Phase {
    let n = i[0].len();
    // from the first sample on that has a change two samples before it
    let rough =
        |of: &dyn Fn(usize) -> f64| -> Vec<f64> { (3..n).map(|k| of(k - 2) - 2.0 * of(k - 1) + of(k)).collect() };
    let (r, s) = ((q + 1) % 3, (q + 2) % 3);
    let mean = |k: usize| (v[0][k] + v[1][k] + v[2][k]) / 3.0;
    Phase {
        voltage: rough(&|k| v[q][k] - mean(k)),
        own: rough(&|k| i[q][k] - i[q][k - 1]),
        others: rough(&|k| (i[r][k - 1] - i[r][k]) + (i[s][k - 1] - i[s][k])),
    }
}

/// Share of `y` that is along `x`, and not against it.
fn explained(x: &[f64], y: &[f64]) -> f64 {
    let along = dot(x, y).max(0.0);
    along * along / (dot(x, x) * dot(y, y)).max(1e-300)
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;
    use std::collections::BTreeMap;

    const RESISTANCE: f64 = 1.0;
    const INDUCTANCE: f64 = 0.36e-3;

    /// Three windings in star whose currents relays hold near references: voltages as means over a sample, currents as points or as
    /// means, with noise.
    fn recorded(rate_hz: f64, points: bool) -> BTreeMap<&'static str, Vec<f64>> {
        let fine = 50;
        let dt = 1.0 / rate_hz / f64::from(fine);
        let mut rng = ChaCha8Rng::seed_from_u64(5);
        let mut noise = || 8e-3 * (rng.random::<f64>() - 0.5) * 12f64.sqrt();
        let (mut i, mut up) = ([0.0; 3], [1.0; 3]);
        let mut columns = vec![Vec::new(); 7];
        for k in 0..20_000 {
            let (mut volts, mut means) = ([0.0; 3], [0.0; 3]);
            for f in 0..fine {
                let t = (f64::from(k) * f64::from(fine) + f64::from(f)) * dt;
                for q in 0..3 {
                    let asked = 3.0 * (40.0 * t - 2.1 * q as f64).sin();
                    if (asked - i[q]) * up[q] < -0.1 {
                        up[q] = -up[q];
                    }
                }
                let neutral = 24.0 * (up[0] + up[1] + up[2]) / 3.0;
                for q in 0..3 {
                    let v = 24.0 * up[q] - neutral;
                    i[q] += dt / INDUCTANCE * (v - RESISTANCE * i[q]);
                    volts[q] += v / f64::from(fine);
                    means[q] += i[q] / f64::from(fine);
                }
            }
            columns[0].push(f64::from(k + 1) / rate_hz);
            for q in 0..3 {
                columns[1 + q].push(if points { i[q] } else { means[q] } + noise());
                columns[4 + q].push(volts[q]);
            }
        }
        let names = ["t", "i_a", "i_b", "i_c", "v_a", "v_b", "v_c"];
        names.into_iter().zip(columns).collect()
    }

    fn told(columns: &BTreeMap<&str, Vec<f64>>) -> Option<Points> {
        of_phases(1.1 * 2.0 * INDUCTANCE, |name| columns.get(name).map(Vec::as_slice))
    }

    #[test]
    fn points_are_told_from_means_and_tell_the_inductance() {
        for rate_hz in [2500.0, 5000.0, 10_000.0] {
            assert_eq!(told(&recorded(rate_hz, false)), None, "{rate_hz}");
            let told = told(&recorded(rate_hz, true)).expect("points");
            let off = told.inductance / (2.0 * INDUCTANCE) - 1.0;
            assert!(off.abs() < 0.02 && told.trust < 0.02, "{rate_hz}: {off} {told:?}");
        }
    }

    #[test]
    fn without_voltages_or_on_an_uneven_clock_points_tell_nothing() {
        let mut columns = recorded(5000.0, true);
        columns.get_mut("t").unwrap()[9000..].iter_mut().for_each(|t| *t += 1.0);
        assert_eq!(told(&columns), None);
        let mut columns = recorded(5000.0, true);
        columns.remove("v_b");
        assert_eq!(told(&columns), None);
    }
}
