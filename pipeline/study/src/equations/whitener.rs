//! The mechanics of a run as a Kalman filter: the measured torque drives angle and speed, the sensors correct
//! them, and what they had not foreseen, the innovations, is white with a variance that the noise of the sensors
//! gives. An equation whose signals are all noisy thereby becomes a regression with independent rows: no
//! differentiated noise stands among the regressors, where it would shrink their coefficients (errors in
//! variables; prediction error method, Ljung, System Identification, 2nd ed., ch. 7 and 13).

/// What the filter is made of; SI at the motor.
#[derive(Clone, Copy, Debug)]
pub struct Design {
    /// sampling interval [s]
    pub dt: f64,
    /// J [kg m2]
    pub inertia: f64,
    /// noise of the torque, mean over a sample, rms [N m]
    pub torque_noise: f64,
    /// torque of masked samples, of which nothing is known, rms [N m]
    pub lost_torque: f64,
    /// noise of a sample of the angle, rms [rad], and how long before its time stamp it was true [s]
    pub position: Option<(f64, f64)>,
    /// same of the speed [rad/s]
    pub velocity: Option<(f64, f64)>,
    /// samples in a row
    pub group: usize,
}

/// Gains of one sample: first the angle is taken in, then the speed.
#[derive(Clone, Copy, Debug, Default)]
struct Step {
    /// gains of angle, speed, acceleration for the angle's innovation; one over its deviation
    position: [f64; 4],
    velocity: [f64; 4],
}

/// Samples at the start in which the filter only finds out where the machine is.
const START: usize = 40;
/// Relative change of the variances at which they count as steady.
const STEADY: f64 = 1e-7;
/// Most samples until then.
const LONGEST: usize = 4000;

/// Gains in the order of the samples since motion began; the first is that of masked samples.
#[derive(Clone, Debug)]
pub struct Whitener {
    design: Design,
    steps: Vec<Step>,
    /// unit vector of the steady response to a torque
    direction: [f64; 2],
    /// from whitened innovations to [N m] of a slow torque
    scale: f64,
    /// variance of a row that the torque's noise makes, over its whole variance
    torque_share: [f64; 2],
}

/// Torque, angle and speed.
pub type Set<'a> = [Option<&'a [f64]>; 3];

/// Rows of a signal: along the response to a slow torque, and across it.
pub type Rows = [Vec<f64>; 2];

impl Whitener {
    /// The filter of a design.
    pub fn new(design: Design) -> Self {
        let q = (design.torque_noise / design.inertia).powi(2);
        let mut p = [[0.0; 2]; 2];
        // long at rest: nothing is known but what the sensors say
        let mut masked = Step::default();
        let lost = (design.lost_torque / design.inertia).powi(2);
        for _ in 0..LONGEST {
            masked = step(&design, &mut p, q + lost);
        }
        let mut steps = vec![masked];
        while steps.len() < LONGEST {
            let before = p;
            let s = step(&design, &mut p, q);
            steps.push(s);
            // the covariance, not the gains: those stand still for a while where nearly nothing is known
            let far = |a: f64, b: f64| (a - b).abs() > STEADY * a.abs();
            if steps.len() > 3 && !(far(p[0][0], before[0][0]) || far(p[1][1], before[1][1])) {
                break;
            }
        }
        let mut w = Self {
            design,
            steps,
            direction: [1.0, 0.0],
            scale: 1.0,
            torque_share: [0.0; 2],
        };
        w.orient();
        w
    }

    /// Direction and scale of the rows, from the steady response to a torque of 1 N m; then what its noise makes.
    fn orient(&mut self) {
        let n = START + self.steps.len() + LONGEST;
        let ones = vec![1.0; n];
        let still = vec![false; n];
        let mut last = [0.0; 2];
        self.pass(Some([&ones]), None, None, &still, |_, [[p], [v]]| last = [p, v]);
        let size = last[0].hypot(last[1]).max(1e-300);
        self.direction = [last[0] / size, last[1] / size];
        self.scale = 1.0 / size;
        // white noise of the torque through the steady filter
        let mut impulse = vec![0.0; n];
        impulse[START + self.steps.len()] = 1.0;
        let mut sums = [0.0; 2];
        let mut group = [0.0; 2];
        let m = self.design.group as f64;
        let mut window: std::collections::VecDeque<[f64; 2]> = Default::default();
        let (d, g) = (self.direction, self.design.group);
        self.pass(Some([&impulse]), None, None, &still, |_, [[p], [v]]| {
            let e = [p, v];
            let r = [d[0] * e[0] + d[1] * e[1], -d[1] * e[0] + d[0] * e[1]];
            window.push_back(r);
            (0..2).for_each(|i| group[i] += r[i]);
            if window.len() > g {
                let old = window.pop_front().expect("not empty");
                (0..2).for_each(|i| group[i] -= old[i]);
            }
            (0..2).for_each(|i| sums[i] += group[i] * group[i]);
        });
        // a group's sum has the variance m; each impulse is seen by m groups that overlap
        self.torque_share = sums.map(|s| s * self.design.torque_noise.powi(2) / m);
    }

    /// rms of a row's noise [N m], along and across.
    pub fn floor(&self) -> f64 {
        self.scale / (self.design.group as f64).sqrt()
    }

    /// Share of a row's variance that the noise of the torque makes.
    pub fn torque_share(&self) -> [f64; 2] {
        self.torque_share
    }

    /// Noise of the torque that the filter reckons with, rms [N m].
    pub fn torque_noise(&self) -> f64 {
        self.design.torque_noise
    }

    /// By how many samples angle and speed are later than the middle of the sample whose torque is a mean.
    pub fn ahead(&self) -> [f64; 2] {
        let d = &self.design;
        [d.position, d.velocity].map(|c| (0.5 - c.map_or(0.0, |c| c.1) / d.dt).clamp(0.0, 1.0))
    }

    /// Samples in a row.
    pub fn group(&self) -> usize {
        self.design.group
    }

    /// Samples of the rows of a run: the last of each group of unmasked samples that follow each other.
    pub fn samples(&self, masked: &[bool]) -> Vec<usize> {
        let g = self.design.group;
        let mut out = Vec::new();
        let mut run = 0;
        for k in START..masked.len() {
            if masked[k] {
                run = 0;
                continue;
            }
            run += 1;
            if run == g {
                out.push(k);
                run = 0;
            }
        }
        out
    }

    /// What the filter makes of several sets of signals: torque against positive motion, which counts as missing torque [N m], angle
    /// [rad] and speed [rad/s] as measured, where there are any. Rows in N m of a slow torque. Sets of the same signals go side by side,
    /// as many as a step of the filter waits for itself.
    pub fn rows(&self, all: &[Set], masked: &[bool]) -> Vec<Rows> {
        let mut out = vec![Rows::default(); all.len()];
        let mut left: Vec<usize> = (0..all.len()).collect();
        while let Some(first) = left.first() {
            let has = all[*first].map(|s| s.is_some());
            let alike: Vec<usize> = left.extract_if(.., |i| all[*i].map(|s| s.is_some()) == has).collect();
            let (four, rest) = alike.as_chunks::<4>();
            let (two, one) = rest.as_chunks::<2>();
            four.iter().for_each(|at| self.side_by_side(all, *at, masked, &mut out));
            two.iter().for_each(|at| self.side_by_side(all, *at, masked, &mut out));
            one.iter()
                .for_each(|at| self.side_by_side(all, [*at], masked, &mut out));
        }
        out
    }

    /// * `at` places of some that have the same signals
    fn side_by_side<const L: usize>(&self, all: &[Set], at: [usize; L], masked: &[bool], out: &mut [Rows]) {
        let [torque, position, velocity] = [0, 1, 2].map(|i| {
            let signals = at.map(|c| all[c][i].unwrap_or_default());
            all[at[0]][i].is_some().then_some(signals)
        });
        let rows = self.lanes(torque, position, velocity, masked);
        at.into_iter().zip(rows).for_each(|(c, rows)| out[c] = rows);
    }

    fn lanes<const L: usize>(
        &self,
        torque: Option<[&[f64]; L]>,
        position: Option<[&[f64]; L]>,
        velocity: Option<[&[f64]; L]>,
        masked: &[bool],
    ) -> [Rows; L] {
        let (d, g) = (self.direction, self.design.group);
        let factor = self.scale / g as f64;
        let mut out: [Rows; L] = std::array::from_fn(|_| [Vec::new(), Vec::new()]);
        let (mut sum, mut run) = ([[0.0; L]; 2], 0);
        self.pass(torque, position, velocity, masked, |k, e| {
            if k < START || masked[k] {
                (sum, run) = ([[0.0; L]; 2], 0);
                return;
            }
            for l in 0..L {
                sum[0][l] += d[0] * e[0][l] + d[1] * e[1][l];
                sum[1][l] += -d[1] * e[0][l] + d[0] * e[1][l];
            }
            run += 1;
            if run == g {
                // more torque than was foreseen is less than nothing missing
                for (l, rows) in out.iter_mut().enumerate() {
                    rows[0].push(factor * sum[0][l]);
                    rows[1].push(factor * sum[1][l]);
                }
                (sum, run) = ([[0.0; L]; 2], 0);
            }
        });
        out
    }

    /// Runs the filter over as many sets of signals as there are lanes; `each` hears the whitened innovations of angle and speed of every
    /// sample.
    fn pass<const L: usize>(
        &self,
        torque: Option<[&[f64]; L]>,
        position: Option<[&[f64]; L]>,
        velocity: Option<[&[f64]; L]>,
        masked: &[bool],
        mut each: impl FnMut(usize, [[f64; L]; 2]),
    ) {
        let d = &self.design;
        let dt = d.dt;
        // where it is and how fast it goes when the run begins, so that nothing is left to swing out
        let late = d.position.map_or(0.0, |x| x.1);
        let begins = |l: usize| match (position.map(|p| p[l]), velocity.map(|v| v[l])) {
            (Some(p), _) if p.len() > 2 => {
                let omega = (4.0 * p[1] - 3.0 * p[0] - p[2]) / (2.0 * dt);
                [p[0] + (late - dt) * omega, omega]
            }
            (_, Some(v)) => [0.0, v.first().copied().unwrap_or(0.0)],
            _ => [0.0, 0.0],
        };
        let mut theta: [f64; L] = std::array::from_fn(|l| begins(l)[0]);
        let mut omega: [f64; L] = std::array::from_fn(|l| begins(l)[1]);
        let (has_p, has_v) = (d.position.is_some(), d.velocity.is_some());
        let (late_p, late_v) = (d.position.map_or(0.0, |x| x.1), d.velocity.map_or(0.0, |x| x.1));
        let mut since = 0;
        for k in 0..masked.len() {
            let lost = masked[k] || k < START;
            since = if lost { 0 } else { since + 1 };
            let s = &self.steps[since.min(self.steps.len() - 1)];
            let mut e = [[0.0; L]; 2];
            for l in 0..L {
                // a torque at a masked sample is not known: its regressor is nothing
                let a = if lost {
                    0.0
                } else {
                    torque.map_or(0.0, |t| t[l][k]) / d.inertia
                };
                theta[l] += dt * (omega[l] + 0.5 * dt * a);
                omega[l] += dt * a;
                let mut acc = a;
                if has_p {
                    let z = position.map_or(0.0, |p| p[l][k]);
                    let x = z - (theta[l] - late_p * (omega[l] - 0.5 * late_p * acc));
                    let g = &s.position;
                    theta[l] += g[0] * x;
                    omega[l] += g[1] * x;
                    acc += g[2] * x;
                    e[0][l] = g[3] * x;
                }
                if has_v {
                    let z = velocity.map_or(0.0, |v| v[l][k]);
                    let x = z - (omega[l] - late_v * acc);
                    let g = &s.velocity;
                    theta[l] += g[0] * x;
                    omega[l] += g[1] * x;
                    e[1][l] = g[3] * x;
                }
            }
            each(k, e);
        }
    }
}

/// One step of the covariance: `p` of angle and speed after the sample.
fn step(d: &Design, p: &mut [[f64; 2]; 2], q: f64) -> Step {
    let dt = d.dt;
    let g = [0.5 * dt * dt, dt];
    // before the sample: angle, speed, acceleration's noise
    let a00 = p[0][0] + dt * (p[0][1] + p[1][0]) + dt * dt * p[1][1];
    let a01 = p[0][1] + dt * p[1][1];
    let mut c = [
        [a00 + g[0] * g[0] * q, a01 + g[0] * g[1] * q, g[0] * q],
        [a01 + g[0] * g[1] * q, p[1][1] + g[1] * g[1] * q, g[1] * q],
        [g[0] * q, g[1] * q, q],
    ];
    let mut out = Step::default();
    let take = |h: [f64; 3], r: f64, c: &mut [[f64; 3]; 3]| -> [f64; 4] {
        let ch: [f64; 3] = std::array::from_fn(|i| (0..3).map(|j| c[i][j] * h[j]).sum());
        let s = (0..3).map(|i| h[i] * ch[i]).sum::<f64>() + r * r;
        let k = ch.map(|x| x / s);
        for i in 0..3 {
            for j in 0..3 {
                c[i][j] -= k[i] * ch[j];
            }
        }
        [k[0], k[1], k[2], 1.0 / s.sqrt()]
    };
    if let Some((r, late)) = d.position {
        out.position = take([1.0, -late, 0.5 * late * late], r, &mut c);
    }
    if let Some((r, late)) = d.velocity {
        out.velocity = take([0.0, 1.0, -late], r, &mut c);
    }
    // symmetric, so that rounding does not grow
    let off = 0.5 * (c[0][1] + c[1][0]);
    *p = [[c[0][0].max(0.0), off], [off, c[1][1].max(0.0)]];
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    fn gauss(rng: &mut ChaCha8Rng) -> f64 {
        let (a, b): (f64, f64) = (rng.random(), rng.random());
        (-2.0 * (1.0 - a).ln()).sqrt() * (std::f64::consts::TAU * b).cos()
    }

    fn design(group: usize) -> Design {
        Design {
            dt: 1e-3,
            inertia: 2e-5,
            torque_noise: 1e-3,
            lost_torque: 0.02,
            position: Some((1e-4, 0.0)),
            velocity: Some((0.2, 0.0)),
            group,
        }
    }

    /// A free rotor under a known torque with noisy sensors.
    fn simulated(n: usize, d: &Design, missing: f64) -> (Vec<f64>, Vec<f64>, Vec<f64>) {
        let mut rng = ChaCha8Rng::seed_from_u64(7);
        let (mut theta, mut omega) = (0.0, 0.0);
        let (mut t, mut p, mut v) = (Vec::new(), Vec::new(), Vec::new());
        for k in 0..n {
            let torque = 0.01 * (0.02 * k as f64).sin();
            let a = (torque - missing) / d.inertia;
            theta += d.dt * (omega + 0.5 * d.dt * a);
            omega += d.dt * a;
            t.push(torque + d.torque_noise * gauss(&mut rng));
            p.push(theta + 1e-4 * gauss(&mut rng));
            v.push(omega + 0.2 * gauss(&mut rng));
        }
        (t, p, v)
    }

    #[test]
    fn innovations_are_white_with_the_variance_that_the_noise_gives() {
        for group in [1, 4] {
            let d = design(group);
            let w = Whitener::new(d);
            let (t, p, v) = simulated(60_000, &d, 0.0);
            let masked = vec![false; t.len()];
            let [along, across] = w.rows(&[[Some(&t), Some(&p), Some(&v)]], &masked).remove(0);
            assert_eq!(along.len(), w.samples(&masked).len());
            for r in [&along, &across] {
                let r = &r[200..];
                let var = r.iter().map(|x| x * x).sum::<f64>() / r.len() as f64 / w.floor().powi(2);
                let next = r.windows(2).map(|x| x[0] * x[1]).sum::<f64>() / r.len() as f64 / w.floor().powi(2);
                assert!((var - 1.0).abs() < 0.05, "{group}: {var}");
                assert!(next.abs() < 0.03, "{group}: {next}");
            }
        }
    }

    #[test]
    fn a_torque_that_is_missing_stands_in_the_rows_as_it_is() {
        let d = design(1);
        let w = Whitener::new(d);
        let (t, p, v) = simulated(20_000, &d, 3e-3);
        let [along, across] = w
            .rows(&[[Some(&t), Some(&p), Some(&v)]], &vec![false; t.len()])
            .remove(0);
        let mean = |x: &[f64]| x[500..].iter().sum::<f64>() / (x.len() - 500) as f64;
        assert!((mean(&along) - 3e-3).abs() < 1e-4, "{}", mean(&along));
        assert!(mean(&across).abs() < 1e-4);
    }

    #[test]
    fn the_share_of_the_torques_noise_is_what_it_leaves_in_the_rows() {
        for group in [1, 3] {
            let d = design(group);
            let w = Whitener::new(d);
            let mut rng = ChaCha8Rng::seed_from_u64(3);
            let mut noise = |s: f64| -> Vec<f64> { (0..60_000).map(|_| s * gauss(&mut rng)).collect() };
            let (t, p, v) = (noise(d.torque_noise), noise(1e-4), noise(0.2));
            let masked = vec![false; t.len()];
            let variance = |r: &Vec<f64>| r.iter().map(|x| x * x).sum::<f64>() / r.len() as f64 / w.floor().powi(2);
            let of_torque = w
                .rows(&[[Some(&t), None, None]], &masked)
                .remove(0)
                .map(|r| variance(&r));
            let of_sensors = w
                .rows(&[[None, Some(&p), Some(&v)]], &masked)
                .remove(0)
                .map(|r| variance(&r));
            for i in 0..2 {
                let share = w.torque_share()[i];
                assert!(
                    (of_torque[i] - share).abs() < 0.03 * share + 0.003,
                    "{group} {i}: {} {share}",
                    of_torque[i]
                );
                assert!(
                    (of_sensors[i] - (1.0 - share)).abs() < 0.03,
                    "{group} {i}: {} {share}",
                    of_sensors[i]
                );
            }
        }
    }

    #[test]
    fn a_machine_that_moves_when_the_run_begins_is_found() {
        let velocity = Some((1.3, 1.96e-3));
        let d = Design {
            dt: 2e-3,
            inertia: 4e-5,
            torque_noise: 3e-4,
            lost_torque: 0.5,
            position: Some((7e-6, 0.0)),
            velocity,
            group: 1,
        };
        let w = Whitener::new(d);
        let at = |late: f64| (0..300).map(move |k| k as f64 * d.dt - late);
        let theta: Vec<f64> = at(0.0).map(|t| 500.0 * t - 40.0 * t * t).collect();
        let omega: Vec<f64> = at(1.96e-3).map(|t| 500.0 - 80.0 * t).collect();
        let torque = vec![-80.0 * d.inertia; 300];
        let rows = w
            .rows(&[[Some(&torque), Some(&theta), Some(&omega)]], &[false; 300])
            .remove(0);
        assert!(rows.iter().flatten().all(|r| r.abs() < 0.1 * w.floor()), "{rows:?}");
    }
}
