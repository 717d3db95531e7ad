//! A motor that is fed by a voltage at its terminals.

use crate::measured::bench::{Bench, BenchChannel, Known, Noise};
use crate::measured::noise::noise;
use crate::measured::recording::Run;
use crate::measured::samples::rate_of;

/// A winding that is fed by a voltage of which no current is recorded; SI, motor side.
///
/// `R i + L i' = u - ke w` and the torque `kt i` make, with `f(x)` for `x` through the lag `L/R`, the torque
/// `kt/R (f(u) + ke (w - f(w))) - kt ke/R w`: a gain, a drive signal and a viscous friction.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Winding {
    /// kt [N m/A]
    pub torque_constant: Known,
    /// ke [V s/rad]
    pub back_emf: f64,
    /// R [ohm]
    pub resistance: Known,
    /// L [H]
    pub inductance: f64,
}

impl Winding {
    /// * `back_emf` the torque constant where nothing is said of it
    pub fn new(torque_constant: Known, back_emf: Known, resistance: Known, inductance: f64) -> Self {
        let back_emf = if back_emf.value > 0.0 {
            back_emf.value
        } else {
            torque_constant.value
        };
        Self {
            torque_constant,
            back_emf,
            resistance,
            inductance,
        }
    }

    /// kt/R, as uncertain as both [N m/V].
    pub fn gain(&self) -> Known {
        let trusts = self.torque_constant.trust.zip(self.resistance.trust);
        Known {
            value: self.torque_constant.value / self.resistance.value,
            trust: trusts.map(|(k, r)| k.hypot(r)),
        }
    }

    /// kt ke/R [N m s/rad]
    pub fn braking(&self) -> f64 {
        self.gain().value * self.back_emf
    }

    /// Viscous friction with what the back-EMF brakes; as uncertain as both.
    pub fn braked(&self, viscous: Known) -> Known {
        let braking = self.braking();
        let value = viscous.value + braking;
        // kt = ke: twice as uncertain as the constant
        let trusts = self.torque_constant.trust.zip(self.resistance.trust).zip(viscous.trust);
        let trust = trusts.map(|((k, r), v)| (braking * (2.0 * k).hypot(r)).hypot(viscous.value * v) / value);
        Known { value, trust }
    }

    /// The way back: torque constant, resistance, inductance and viscous friction that make a gain and a viscous friction with what
    /// the back-EMF brakes. Neither tells the constant apart from the resistance: it is what was said, by the gain, unless the back-EMF
    /// would brake more than all.
    ///
    /// * `gain` [N m/V], `viscous` [N m s/rad]
    pub fn behind(&self, gain: Known, viscous: Known) -> [Known; 4] {
        const MOST: f64 = 0.98;
        let by_gain = self.torque_constant.value * gain.value / self.gain().value;
        let constant = by_gain.min(MOST * viscous.value / gain.value);
        let resistance = constant / gain.value;
        let (braking, certain) = (gain.value * constant, Some(0.0));
        let own = viscous.value - braking;
        let own_trust = viscous.trust.zip(gain.trust).map(|(v, k)| {
            let left = (v * viscous.value).powi(2) - (2.0 * k * braking).powi(2);
            left.max(0.0).sqrt() / own
        });
        let known = |value, trust| Known { value, trust };
        [
            known(constant, gain.trust),
            known(resistance, certain),
            known(self.lag_s() * resistance, certain),
            known(own, own_trust.map(|t| t.min(10.0))),
        ]
    }

    /// L/R [s]
    pub fn lag_s(&self) -> f64 {
        self.inductance / self.resistance.value
    }
}

/// A signal through a lag `tau`, sample by sample.
///
/// * `mean` samples are means over the time since the one before, and so is what comes out; else points, straight between
fn lagged(x: &[f64], tau_s: f64, step_s: f64, mean: bool) -> Vec<f64> {
    let kept = (-step_s / tau_s).exp();
    let share = (1.0 - kept) * tau_s / step_s;
    let first = x.first().copied().unwrap_or(0.0);
    let (mut state, mut before) = (first, first);
    x.iter()
        .map(|&u| {
            let was = state;
            state = if mean {
                kept * was + (1.0 - kept) * u
            } else {
                kept * was + (share - kept) * before + (1.0 - share) * u
            };
            before = u;
            if mean { share * was + (1.0 - share) * u } else { state }
        })
        .collect()
}

/// Brings the voltage of a bench that has a [`Winding`] to the drive signal that makes the torque.
pub fn feed(bench: &mut Bench, runs: &mut [Run]) {
    use BenchChannel as C;
    let Some(winding) = bench.rig.winding else { return };
    let tau = winding.lag_s();
    let Some(spec) = bench.channels.iter_mut().find(|c| c.channel == C::Voltage) else {
        return;
    };
    if tau <= 0.0 {
        return;
    }
    // as white as it was measured; what the lag makes of it has the colour of the lag
    let white = noise(spec, runs).rms;
    for run in runs.iter_mut().filter(|r| !r.steady) {
        let step = 1.0 / run.rate_hz;
        let Some(mut drive) = run.channel(C::Voltage).map(|u| lagged(u, tau, step, spec.mean)) else {
            continue;
        };
        let slope = |x: &[f64]| rate_of(x, run.rate_hz).collect();
        let speed = run.channel(C::Velocity).map(<[f64]>::to_vec);
        if let Some(mut w) = speed.or_else(|| run.channel(C::Position).map(slope)) {
            if spec.mean {
                let before = w.clone();
                w.iter_mut().skip(1).zip(&before).for_each(|(w, b)| *w = 0.5 * (*w + b));
            }
            let late = lagged(&w, tau, step, spec.mean);
            let back = w.iter().zip(late).map(|(w, l)| winding.back_emf * (w - l));
            drive.iter_mut().zip(back).for_each(|(u, b)| *u += b);
        }
        run.put(C::Voltage, drive);
    }
    let kept = runs.first().map_or(0.0, |r| (-1.0 / (tau * r.rate_hz)).exp());
    spec.noise = Noise::Known(white * ((1.0 - kept) / (1.0 + kept)).sqrt());
    spec.resolution = 0.0;
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_winding_is_a_gain_a_brake_and_a_lag() {
        let known = |value, trust| Known { value, trust };
        let winding = Winding::new(known(0.1, Some(0.03)), known(0.0, None), known(5.0, Some(0.04)), 0.002);
        let gain = winding.gain();
        assert!((gain.value - 0.02).abs() < 1e-15 && (gain.trust.unwrap() - 0.05).abs() < 1e-12);
        let viscous = winding.braked(known(1e-3, Some(0.1)));
        assert!((viscous.value - 3e-3).abs() < 1e-15);
        let sd = (2e-3f64 * 0.06f64.hypot(0.04)).hypot(1e-4);
        assert!((viscous.trust.unwrap() * 3e-3 - sd).abs() < 1e-12);
        assert!((winding.lag_s() - 4e-4).abs() < 1e-15);
        let [constant, resistance, inductance, own] =
            winding.behind(known(0.021, Some(0.01)), known(3.5e-3, Some(0.1)));
        let again = Winding::new(constant, known(0.0, None), resistance, inductance.value);
        let back = again.braked(own);
        assert!((again.gain().value - 0.021).abs() < 1e-15 && again.gain().trust == Some(0.01));
        assert!((back.value - 3.5e-3).abs() < 1e-15 && (back.trust.unwrap() - 0.1).abs() < 1e-9);
        assert!((again.lag_s() - winding.lag_s()).abs() < 1e-15);
        // what is free stays free
        assert_eq!(winding.braked(known(0.0, None)).trust, None);
        assert_eq!(
            Winding::new(known(0.1, None), known(0.09, None), known(5.0, Some(0.04)), 0.0)
                .gain()
                .trust,
            None
        );
    }

    #[test]
    fn a_lag_is_exact_for_what_is_straight_between_samples() {
        let (tau, step) = (5e-4, 2e-4);
        let u: Vec<f64> = (0..400).map(|k| 3.0 * k as f64 * step).collect();
        // of a ramp: late by tau
        let points = lagged(&u, tau, step, false);
        assert!((points[399] - (u[399] - 3.0 * tau)).abs() < 1e-12);
        let held = lagged(&vec![2.0; 50], tau, step, true);
        assert!(held.iter().all(|x| (x - 2.0).abs() < 1e-12));
        // a step, as means: the mean of 1 - exp(-t/tau) over the second sample
        let mut step_up = vec![1.0; 3];
        step_up[0] = 0.0;
        let mean = lagged(&step_up, tau, step, true)[2];
        let e = |t: f64| (-t / tau).exp();
        let exact = 1.0 - tau / step * (e(step) - e(2.0 * step));
        assert!((mean - exact).abs() < 1e-12, "{mean} {exact}");
    }
}
