//! What the sensors' noise leaves in the rows of each equation.

use crate::equations::clock::{Clock, NoiseTable};
use crate::measured::bench::{Bench, BenchChannel};
use crate::measured::filter::FilterBank;
use sim_worker::effect::Equation;

/// Share of an angle sensor's grain that is left of it where it stands, rms: anywhere within a count, one over the root of 12.
const STANDING_GRAIN: f64 = 0.289;
/// rms that the sensors' noise leaves in each equation.
pub fn floors(bench: &Bench, clock: &Clock, noise: &NoiseTable, bank: &FilterBank, window: usize) -> [f64; 5] {
    use BenchChannel as C;
    let rig = &bench.rig;
    // rms that a channel's noise leaves behind a filter
    let left = |c: C, order: usize| -> f64 {
        noise
            .get(&c)
            .map_or(0.0, |n| n.rms * bank.order[order].noise_gain_of(n.colour))
    };
    let (speed, accel) = if clock.from_position {
        (left(C::Position, 1), left(C::Position, 2))
    } else {
        (left(C::Velocity, 0), left(C::Velocity, 1))
    };
    let grain = |c: C| noise.get(&c).map_or(0.0, |n| n.grain);
    let norm = |v: &[f64]| v.iter().map(|x| x * x).sum::<f64>().sqrt().max(1e-300);
    let kt = rig.drive_constant.value;
    let law = rig.controller.as_ref().map_or(0.0, |l| l.speed_gain);
    Equation::ALL.map(|e| match e {
        Equation::Torque => norm(&[
            kt * left(rig.drive, 0),
            rig.inertia.value * accel,
            rig.viscous.value * speed,
            left(C::Load, 0),
        ]),
        Equation::Electrical => {
            let rms = |c: C| noise.get(&c).map_or(0.0, |n| n.slow_rms());
            let (share, seconds) = (1.0 / (window as f64).sqrt(), window as f64 / clock.rate_hz);
            let speed = if clock.from_position {
                2f64.sqrt() * rms(C::Position) / seconds
            } else {
                rms(C::Velocity) * share
            };
            if bench.has_phases() {
                let (i, v) = (rms(C::CurrentA), rms(C::VoltageA));
                let (r, l, ke) = (
                    0.5 * rig.resistance.value,
                    0.5 * rig.inductance.value,
                    0.5 * rig.back_emf.value,
                );
                return norm(&[v * share, r * i * share, l * i / seconds, ke * speed]);
            }
            norm(&[
                rms(C::Voltage) * share,
                rig.resistance.value * rms(rig.drive) * share,
                // the mean of two samples at each end
                rig.inductance.value * rms(rig.drive) / seconds,
                rig.back_emf.value * speed,
            ])
        }
        // the grain of an angle sensor does not average out where it stands
        Equation::Transmission => norm(&[
            left(C::UserPosition, 0).max(STANDING_GRAIN * grain(C::UserPosition)),
            left(C::Position, 0).max(STANDING_GRAIN * grain(C::Position)),
        ]),
        Equation::Kinematic => norm(&[left(C::Velocity, 0), left(C::Position, 1)]),
        Equation::Controller => norm(&[left(rig.drive, 1), law * clock.speed_noise * bank.order[1].noise_gain()]),
    })
}
