//! What sampling leaves open of an inductance: between its samples a current moves as nobody saw.

use crate::equations::clock::{NoiseTable, window};
use crate::measured::bench::{Bench, BenchChannel, Noise};
use crate::measured::noise::fourth_differences;
use crate::measured::recording::Run;

/// Time at the ends of a row by which the current's change over it is not known, over the sample, one sigma (assumed; on plain rigs of
/// another hand whose voltages are means, 0.04).
const ENDS: f64 = 0.05;
/// Share of the correction for the current's noise that is not known where the noise is taken from the data (assumed).
const NOISE: f64 = 0.5;

/// Share of an inductance that means of points leave open, one sigma (assumed): what a relay makes of a current between them is as much as
/// what they change by.
const OF_POINTS: f64 = 0.5;

/// Standard deviation of the inductance that more rows do not lessen [H]; 0 without its voltage. Of three phases only where their
/// points tell it already.
pub fn of_inductance(bench: &Bench, runs: &[&Run], noise: &NoiseTable) -> f64 {
    use BenchChannel as C;
    if let Some(told) = bench.rig.inductance_by_points {
        return OF_POINTS * told.value;
    }
    let (Some(current), Some(voltage)) = (bench.channel(C::Current), bench.channel(C::Voltage)) else {
        return 0.0;
    };
    if bench.has_phases() {
        return 0.0;
    }
    let rate_hz = runs[0].rate_hz;
    let window = window(rate_hz);
    let seconds = window as f64 / rate_hz;
    let changes = runs.iter().filter_map(|r| r.channel(C::Current)).flat_map(|x| {
        let rows = x.windows(window + 1).step_by(window);
        rows.map(move |w| (w[window] - w[0]) / seconds)
    });
    let change = rms(changes).max(1e-300);
    // a voltage that is read at points is not its mean where it moves between them, as a current's controller makes it
    let unseen = if voltage.of_points {
        let all = runs.iter().filter_map(|r| r.channel(C::Voltage));
        let rough = rms(all.flat_map(fourth_differences)) / 70f64.sqrt();
        let of_sensor = match voltage.noise {
            Noise::Estimated => 0.0,
            _ => noise.get(&C::Voltage).map_or(0.0, |n| n.rms),
        };
        (rough * rough - of_sensor * of_sensor).max(0.0).sqrt() / (window as f64).sqrt() / change
    } else {
        0.0
    };
    let corrected = match current.noise {
        Noise::Estimated => {
            let of_noise = noise.get(&C::Current).map_or(0.0, |n| n.rms) / seconds;
            NOISE * bench.rig.inductance.value * (of_noise / change).powi(2).min(1.0)
        }
        _ => 0.0,
    };
    let ends = ENDS * bench.rig.resistance.value / rate_hz;
    unseen.hypot(corrected).hypot(ends)
}

/// Root of the mean square; 0 of nothing.
fn rms(x: impl Iterator<Item = f64>) -> f64 {
    let (n, sum) = x.fold((0.0, 0.0), |(n, sum), x| (n + 1.0, sum + x * x));
    (sum / f64::max(n, 1.0)).sqrt()
}
