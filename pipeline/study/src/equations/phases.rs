//! Currents and voltages of three phases, and the flux of each.

use crate::equations::clock::Clock;
use crate::equations::pieces::true_angle;
use crate::equations::signals::Signals;
use crate::measured::bench::{Bench, BenchChannel};
use crate::measured::recording::{Mean, Run, on_way, over_support};
use crate::measured::samples::shifted;
use nalgebra::{SMatrix, Vector3};
use sim_worker::effect;

/// Functions of the angle, of each of three phases.
pub type Of<const N: usize> = SMatrix<f64, 3, N>;

/// Place of the supply among the phases' equations.
pub const SUPPLY: usize = 3;

/// Currents and voltages of three phases; means over the samples.
#[derive(Clone, Debug)]
pub struct Phases {
    pub current: [Vec<f64>; 3],
    /// whether the currents are known to be means over their samples, which beside voltages shows: from points nobody knows what a
    /// torque that steps is in between
    pub means: bool,
    /// against the star point, or, by [`Phases::mix`], against anything else that is the same for all three
    pub voltage: Option<[Vec<f64>; 3]>,
    /// rows of the electrical equation in a window, each by what it takes of the phases' equations
    mix: &'static [[f64; 3]],
    /// of the supply
    pub supply: Option<Vec<f64>>,
    pub pole_pairs: f64,
    /// angle where each sample begins and where the last one ends [rad], half a step of the test bench earlier: it steps explicitly, by the back-EMF
    /// of a step's beginning. Half a microsecond looks like 2 % of the inductance: what current and back-EMF change by is seen
    /// where phases commutate, both at once
    edges: Option<Vec<f64>>,
    /// error of the angle sensor, and whether the speed is that of the measured angle
    pub(super) encoder: (f64, f64),
    from_position: bool,
}

/// Each phase against the star point.
const TO_STAR: &[[f64; 3]] = &[[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
/// What is left of three phases where nobody knows against what their voltages stand: nothing that is the same for all. Clarke's
/// transform, which leaves noise that is alike in all phases as it is.
const BETWEEN: &[[f64; 3]] = &[
    [0.816_496_580_927_726, -0.408_248_290_463_863, -0.408_248_290_463_863],
    [0.0, std::f64::consts::FRAC_1_SQRT_2, -std::f64::consts::FRAC_1_SQRT_2],
];
/// Share of the sum of the back-EMFs, rms, that the sum of voltages against the star point may be off by (assumed: that of voltages
/// against anything else is off by all of it).
const OFF_STAR: f64 = 0.5;

/// Electrical angle that a run may sweep in a sample for its back-EMF to be taken by the flux [rad] (assumed).
const MOST_FLUX_SWEEP: f64 = 0.4;

impl Phases {
    pub(super) fn new(bench: &Bench, run: &Run, clock: &Clock) -> Option<Self> {
        let three = |c: [BenchChannel; 3]| -> Option<[Vec<f64>; 3]> {
            Some([
                run.channel(c[0])?.to_vec(),
                run.channel(c[1])?.to_vec(),
                run.channel(c[2])?.to_vec(),
            ])
        };
        let current = three(BenchChannel::CURRENTS)?;
        // beyond, an eccentricity of 0.3 comes out 3 % low by it: not understood
        let slow = |x: &&[f64]| {
            x.windows(2)
                .all(|w| bench.rig.pole_pairs * (w[1] - w[0]).abs() < MOST_FLUX_SWEEP)
        };
        let edges = run.channel(BenchChannel::Position).filter(slow).map(|x| {
            let late = clock.shift(bench, BenchChannel::Position) - clock.shift(bench, BenchChannel::CurrentA);
            let ends = shifted(x, (late - 0.5 * bench.rig.step_s) * clock.rate_hz + 0.5);
            let ends: Vec<f64> = ends.iter().map(|x| true_angle(bench.rig.encoder, *x)).collect();
            // before the first, the same way again
            let begins = 2.0 * ends[0] - ends[1.min(ends.len() - 1)];
            std::iter::once(begins).chain(ends).collect()
        });
        let voltage = three(BenchChannel::VOLTAGES);
        Some(Self {
            current,
            means: voltage.is_some() && bench.channel(BenchChannel::CurrentA).is_none_or(|c| !c.of_points),
            voltage,
            mix: TO_STAR,
            supply: run.channel(BenchChannel::VDc).map(<[f64]>::to_vec),
            pole_pairs: bench.rig.pole_pairs,
            edges,
            encoder: bench.rig.encoder,
            from_position: clock.from_position,
        })
    }

    /// Rows of a window in the electrical equation: those of the phases, and the supply where it is measured.
    pub fn rows(&self) -> usize {
        self.mix.len() + usize::from(self.supply.is_some())
    }

    /// Row of the supply in a window, where it is measured.
    pub fn supply_row(&self) -> Option<usize> {
        self.supply.as_ref().map(|_| self.mix.len())
    }

    /// What each row of a window takes of the equation of a phase, or of the supply's; nothing is left out.
    pub fn taken(&self, phase: usize) -> impl Iterator<Item = (usize, f64)> + '_ {
        let supply = self.supply_row().filter(|_| phase == SUPPLY).map(|row| (row, 1.0));
        let of = self.mix.iter().enumerate().filter(move |_| phase < 3);
        of.map(move |(row, m)| (row, m[phase]))
            .filter(|(_, m)| *m != 0.0)
            .chain(supply)
    }

    /// Squares of what the sum of the voltages is off the sum of the back-EMFs, and of the latter [V2].
    ///
    /// * `ke` back-EMF coefficient of a phase [V s/rad]
    fn off_star(&self, s: &Signals, ke: f64) -> (f64, f64) {
        let Some(v) = &self.voltage else { return (0.0, 0.0) };
        let flux: [Vec<f64>; 3] = std::array::from_fn(|q| self.back_emf(s, q));
        (0..s.n).fold((0.0, 0.0), |(off, all), k| {
            let emf = ke * flux.iter().map(|f| f[k]).sum::<f64>();
            let sum = v.iter().map(|v| v[k]).sum::<f64>();
            (off + (sum - emf).powi(2), all + emf * emf)
        })
    }

    fn way(&self, s: &Signals, k: usize) -> (f64, f64) {
        let half = 0.5 * s.omega[k] / s.rate_hz;
        let at = |theta| true_angle(self.encoder, theta);
        (at(s.theta[k] - half), at(s.theta[k] + half))
    }

    /// Speed of the rotor itself [rad/s].
    fn speed(&self, s: &Signals, k: usize) -> f64 {
        if !self.from_position || self.encoder == (0.0, 0.0) {
            return s.omega[k];
        }
        const NEAR: f64 = 1e-4;
        let at = |theta| true_angle(self.encoder, theta);
        s.omega[k] * (at(s.theta[k] + NEAR) - at(s.theta[k] - NEAR)) / (2.0 * NEAR)
    }

    /// Mean over each sample of a phase's back-EMF over `ke` [rad/s]: what its flux changes by, a second. Whatever the speed does
    /// within a sample, its ends say it all.
    pub fn back_emf(&self, s: &Signals, q: usize) -> Vec<f64> {
        let turn = std::f64::consts::TAU / 3.0 * q as f64;
        let flux = |theta: f64| effect::flux(self.pole_pairs * theta - turn) / self.pole_pairs;
        match &self.edges {
            Some(edges) => {
                let mut at: Vec<f64> = edges.iter().map(|x| flux(*x)).collect();
                if let [first, second, third, ..] = &mut at[..] {
                    // where the first sample begins nothing is measured: its change is taken for that of the second
                    *first = 2.0 * *second - *third;
                }
                at.windows(2).map(|w| (w[1] - w[0]) * s.rate_hz).collect()
            }
            None => self.swept(s, |theta| effect::shape(self.pole_pairs * theta - turn)),
        }
    }

    /// Mean over each sample of a function of the angle times the speed [rad/s].
    pub fn swept<T: Mean>(&self, s: &Signals, f: impl Fn(f64) -> T) -> Vec<T> {
        match &self.edges {
            Some(edges) => edges
                .windows(2)
                .map(|w| along((w[0], w[1]), &f) * (w[1] - w[0]) * s.rate_hz)
                .collect(),
            None => (0..s.n).map(|k| along(self.way(s, k), &f) * self.speed(s, k)).collect(),
        }
    }

    /// Part of a sample in which each phase conducts, by its sign.
    pub fn conducting(&self, s: &Signals, k: usize) -> [f64; 3] {
        let way = self.way(s, k);
        along(way, |theta| Vector3::from(effect::conducting(theta, self.pole_pairs))).into()
    }

    /// Size of the current that two phases carry, whatever its sign [A].
    pub fn size(&self, k: usize) -> f64 {
        size_of(&self.current, k)
    }

    /// Current that acts on the torque, by the true angle.
    pub(super) fn drive(&self, s: &Signals) -> Vec<f64> {
        let mut out = vec![0.0; s.n];
        for q in 0..3 {
            let shape = self.mean_over_support(s, q, |trap| trap);
            for k in 0..s.n {
                out[k] += 0.5 * self.current[q][k] * shape[k];
            }
        }
        out
    }

    /// Mean over each sample, as far as phase `q` conducts, of a function of its back-EMF shape.
    pub fn mean_over_support(&self, s: &Signals, q: usize, f: impl Fn(f64) -> f64) -> Vec<f64> {
        let mean = |k: usize| over_support(self.pole_pairs, q, self.way(s, k), |_, trap| f(trap));
        (0..s.n).map(mean).collect()
    }

    /// Mean over each sample, of each phase as far as it conducts, of its back-EMF shape times functions of the angle.
    ///
    /// * `f` a row for each phase, a column for each function
    pub fn shaped<const N: usize>(&self, s: &Signals, f: impl Fn(f64) -> Of<N>) -> Vec<Of<N>> {
        let mean = |k: usize| {
            let way = self.way(s, k);
            let at = on_way(way).map(&f);
            Of::from_rows(&[0, 1, 2].map(|q| over_support(self.pole_pairs, q, way, |j, trap| at[j].row(q) * trap)))
        };
        (0..s.n).map(mean).collect()
    }
}

/// Finds out whether the voltages of a bench's runs stand against the star point: their sum is then that of the back-EMFs. Against
/// the mean of the legs it is nothing, against the middle of the supply what the bridge makes of it; only what differs between
/// phases counts then.
///
/// * `ke` back-EMF coefficient of a phase [V s/rad]
pub fn find_star(runs: &mut [Signals], ke: f64) {
    let of = |s: &Signals| s.phases.as_ref().map_or((0.0, 0.0), |p| p.off_star(s, ke));
    let (off, all) = runs.iter().map(of).fold((0.0, 0.0), |a, b| (a.0 + b.0, a.1 + b.1));
    if off > OFF_STAR.powi(2) * all {
        runs.iter_mut()
            .filter_map(|s| s.phases.as_mut())
            .for_each(|p| p.mix = BETWEEN);
    }
}

/// Size of the current that two of three phases carry, whatever its sign [A].
pub fn size_of(currents: &[impl AsRef<[f64]>], k: usize) -> f64 {
    0.5 * currents.iter().map(|i| i.as_ref()[k].abs()).sum::<f64>()
}

/// Mean of a function over the way from one angle to another.
fn along<T: Mean>((from, to): (f64, f64), f: impl Fn(f64) -> T) -> T {
    let at = |j: usize| f(from + (to - from) * (j as f64 + 0.5) / 6.0);
    (1..6).map(at).fold(at(0), |sum, x| sum + x) / 6.0
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn prop_what_is_the_same_for_all_phases_is_left_out_and_noise_stays_as_it_is() {
        for (a, row) in BETWEEN.iter().enumerate() {
            assert!(row.iter().sum::<f64>().abs() < 1e-15);
            for (b, other) in BETWEEN.iter().enumerate() {
                let dot: f64 = row.iter().zip(other).map(|(x, y)| x * y).sum();
                assert!((dot - f64::from(u8::from(a == b))).abs() < 1e-15, "{a} {b} {dot}");
            }
        }
    }
}
