//! Independent referees of the filter, from the equations of the model alone.
//!
//! One combination of the linear law: damage `x` grows by `s = exp(rho) dt` between two tests, plus wear of variance
//! `kappa s`; `rho` walks by a normal step of variance `volatility^2 s`; a test reads `x` with normal noise. Two solutions
//! of it share no code with the filter, nor with each other: particles that carry `rho` alone, with an exact Kalman filter
//! for `x` given the path of `rho`; and densities on a grid of `rho` and `x`, moved along `x` by spectral shifts. A third
//! referee is calibration: data of the gamma and of the jump model themselves, and whether the true rate lies within the
//! intervals that the filter states.

use super::filter::{Filter, Reading};
use super::law::Family;
use super::prior::{Model, Prior, Wear};
use super::special::{normal_cdf, normal_quantile};
use std::f64::consts::{PI, TAU};
use std::sync::Arc;

/// What the model sets aside for a wrong diagnosis, and for rare jumps a life. On clean data neither ever explains
/// anything better: both are a constant factor of the evidence here.
const WRONG: f64 = 0.004;
const RARE_JUMPS: f64 = 0.3;

/// Distance of the grid's nodes of `x` [least standard deviations of damage after a test].
const FINE: f64 = 0.4;

/// SplitMix64.
struct Random {
    state: u64,
    spare: Option<f64>,
}

impl Random {
    fn new(seed: u64) -> Self {
        Self {
            state: seed.wrapping_mul(0xd134_2543_de82_ef95),
            spare: None,
        }
    }

    fn next(&mut self) -> u64 {
        self.state = self.state.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let z = (self.state ^ (self.state >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    /// Uniform, within 0 and 1, both excluded.
    fn uniform(&mut self) -> f64 {
        ((self.next() >> 12) as f64 + 0.5) / (1u64 << 52) as f64
    }

    fn between(&mut self, lo: f64, hi: f64) -> f64 {
        lo + (hi - lo) * self.uniform()
    }

    /// Uniform in the logarithm.
    fn log_between(&mut self, lo: f64, hi: f64) -> f64 {
        self.between(lo.ln(), hi.ln()).exp()
    }

    /// Standard normal (Box and Muller).
    fn normal(&mut self) -> f64 {
        if let Some(z) = self.spare.take() {
            return z;
        }
        let r = (-2.0 * self.uniform().ln()).sqrt();
        let (sin, cos) = (TAU * self.uniform()).sin_cos();
        self.spare = Some(r * sin);
        r * cos
    }

    fn exponential(&mut self) -> f64 {
        -self.uniform().ln()
    }

    fn poisson(&mut self, mean: f64) -> u32 {
        let mut at = self.exponential();
        let mut n = 0;
        while at < mean {
            at += self.exponential();
            n += 1;
        }
        n
    }

    /// Gamma variable of unit scale (Marsaglia and Tsang).
    fn gamma(&mut self, shape: f64) -> f64 {
        if shape < 1.0 {
            let below = self.uniform().powf(1.0 / shape);
            return below * self.gamma(shape + 1.0);
        }
        let d = shape - 1.0 / 3.0;
        let c = 1.0 / (9.0 * d).sqrt();
        loop {
            let z = self.normal();
            let v = (1.0 + c * z).powi(3);
            if v > 0.0 && self.uniform().ln() < 0.5 * z * z + d - d * v + d * v.ln() {
                return d * v;
            }
        }
    }
}

/// What a solution says after the last test.
#[derive(Clone, Copy, Debug)]
struct Verdict {
    /// mean of rho
    mean: f64,
    /// its standard deviation
    sd: f64,
    /// logarithm of the density of all readings
    evidence: f64,
}

/// One unit that was tested.
struct Case {
    model: Model,
    prior: Arc<Prior>,
    /// wear: variance over growth
    kappa: f64,
    /// standard deviation of damage before the first test; its mean is 0
    start: f64,
    /// standard deviation of the readings
    sd: f64,
    /// life from new [units of the clock] that the truth began with
    life: f64,
    /// time since the test before, and reading
    tests: Vec<(f64, f64)>,
}

/// Combinations of the linear law that scatter as they state.
fn linear(with: impl Fn(Wear) -> bool) -> Vec<Model> {
    let filter = Filter::new(Arc::new(Prior::shipped(1.0)), 0.0, 0.01);
    let chosen = |m: &Model| filter.laws().of(*m).family() == Family::Linear && with(m.wear());
    Model::all().filter(chosen).collect()
}

impl Case {
    /// Linear growth with smooth wear and a walk of the rate, as the model has them.
    fn new(seed: u64) -> Self {
        let models: Vec<Model> = linear(|w| matches!(w, Wear::Smooth(_)))
            .into_iter()
            .filter(|m| m.noise().of_stated == 1.0 && m.noise().of_level == 0.0)
            .collect();
        let model = models[seed as usize % models.len()];
        let Wear::Smooth(kappa) = model.wear() else {
            unreachable!()
        };
        let mut random = Random::new(1000 + seed);
        let life = random.log_between(60.0, 400.0);
        let sd = random.log_between(0.0005, 0.01);
        let start = random.log_between(0.0005, 0.02);
        let count = random.between(40.0, 150.0) as usize;
        // a third of the long lives has gaps
        let gaps = life > 250.0 && seed.is_multiple_of(3);
        let mut rho = -life.ln();
        let mut x = start * random.normal();
        let mut tests = Vec::new();
        while tests.len() < count && (tests.len() < 40 || x < 1.0) {
            let dt = if gaps { (1 + random.next() % 3) as f64 } else { 1.0 };
            let s = rho.exp() * dt;
            x += s + (kappa * s).sqrt() * random.normal();
            rho += model.volatility() * s.sqrt() * random.normal();
            tests.push((dt, x + sd * random.normal()));
        }
        Self {
            model,
            prior: Arc::new(Prior::shipped(1.0)),
            kappa,
            start,
            sd,
            life,
            tests,
        }
    }

    fn filter(&self) -> Verdict {
        let mut filter = Filter::of_one(self.prior.clone(), self.model, 0.0, self.start);
        for &(dt, y) in &self.tests {
            let (sd, level) = (self.sd, y.abs());
            filter.step(dt, Some(Reading::Damage { y, sd, level }));
        }
        let (mean, sd) = filter.rho();
        Verdict {
            mean,
            sd,
            evidence: filter.evidence,
        }
    }

    /// Particles of `rho`; given its path `x` is normal, and a Kalman filter is exact.
    fn particles(&self, count: usize, seed: u64) -> Verdict {
        #[derive(Clone, Copy)]
        struct Particle {
            rho: f64,
            x: f64,
            p: f64,
            weight: f64,
        }
        let mut random = Random::new(seed);
        let (mean, spread) = self.prior.rho(self.model);
        let (r, volatility, even) = (self.sd * self.sd, self.model.volatility(), 1.0 / count as f64);
        // stratified: quantiles of the prior
        let mut all: Vec<Particle> = (0..count)
            .map(|i| Particle {
                rho: mean + spread * normal_quantile((i as f64 + 0.5) * even),
                x: 0.0,
                p: self.start * self.start,
                weight: even,
            })
            .collect();
        let mut evidence = 0.0;
        for &(dt, y) in &self.tests {
            for a in &mut all {
                let s = a.rho.exp() * dt;
                a.rho += volatility * s.sqrt() * random.normal();
                a.x += s;
                a.p += self.kappa * s;
                let (e, v) = (y - a.x, a.p + r);
                let k = a.p / v;
                a.x += k * e;
                a.p -= k * a.p;
                let usual = (1.0 - WRONG - RARE_JUMPS * s).max(0.0);
                a.weight *= usual * (-0.5 * e * e / v).exp() / (TAU * v).sqrt();
            }
            let sum: f64 = all.iter().map(|a| a.weight).sum();
            evidence += sum.ln();
            let mut squares = 0.0;
            for a in &mut all {
                a.weight /= sum;
                squares += a.weight * a.weight;
            }
            if squares * count as f64 > 2.0 {
                // systematic resampling
                let (mut at, mut below) = (random.uniform() * even, 0.0);
                let mut next = Vec::with_capacity(count);
                for a in &all {
                    below += a.weight;
                    while at < below && next.len() < count {
                        next.push(Particle { weight: even, ..*a });
                        at += even;
                    }
                }
                let last = all[count - 1];
                next.resize(count, Particle { weight: even, ..last });
                all = next;
            }
        }
        let mean: f64 = all.iter().map(|a| a.weight * a.rho).sum();
        let variance: f64 = all.iter().map(|a| a.weight * (a.rho - mean).powi(2)).sum();
        Verdict {
            mean,
            sd: variance.sqrt(),
            evidence,
        }
    }

    /// Densities of `x` in rows of `rho`.
    /// * `fine` distance of the nodes of `x` [least standard deviations of damage after a test]
    fn grid(&self, shift: Shift, fine: f64) -> Verdict {
        const ROWS: usize = 401;
        const N: usize = 256;
        let fourier = Fourier::new(N);
        let (mean, spread) = self.prior.rho(self.model);
        let h = 8.0 * spread / (ROWS - 1) as f64;
        let rho = |j: usize| mean - 4.0 * spread + j as f64 * h;
        let (r, volatility) = (self.sd * self.sd, self.model.volatility());
        // nodes of x as fine as damage is known at best: the steady Kalman filter at half the rate
        let q = self.kappa * 0.5 / self.life;
        let dx = fine * (0.5 * ((q * q + 4.0 * q * r).sqrt() - q)).sqrt();
        // density over rho and x; the window's first node
        let mut rows = vec![vec![0.0; N]; ROWS];
        let mut masses = vec![0.0; ROWS];
        let mut origin = 0.0;
        let mut evidence = 0.0;
        for (n, &(dt, y)) in self.tests.iter().enumerate() {
            // the window goes with the readings
            let to = y - 0.5 * N as f64 * dx;
            let mut next = vec![vec![0.0; N]; ROWS];
            for j in 0..ROWS {
                let s = rho(j).exp() * dt;
                let grown = if n == 0 {
                    // from the prior: growth has a closed form
                    let mass = h / (TAU.sqrt() * spread) * (-0.5 * ((rho(j) - mean) / spread).powi(2)).exp();
                    let v = self.start * self.start + self.kappa * s;
                    let density = |i: usize| (-0.5 * (to + i as f64 * dx - s).powi(2) / v).exp() / (TAU * v).sqrt();
                    (0..N).map(|i| mass * density(i)).collect()
                } else if masses[j] > 1e-15 {
                    let by = (s + origin - to) / dx;
                    fourier.moved(&rows[j], by, self.kappa * s / (dx * dx), shift)
                } else {
                    continue;
                };
                // the walk of rho: to the rows around, each by its own variance; that of the kernel is exact
                let v = volatility * volatility * s / (h * h);
                let reach = if v < 0.64 { 1 } else { (6.0 * v.sqrt()).ceil() as usize };
                let weight = |d: f64| match v < 0.64 {
                    true if d == 0.0 => 1.0 - v,
                    true => 0.5 * v,
                    false => (-0.5 * d * d / v).exp() / (TAU * v).sqrt(),
                };
                for i in j.saturating_sub(reach)..(j + reach + 1).min(ROWS) {
                    // what the model sets aside goes by the growth that was, as with the row
                    let w = weight(i as f64 - j as f64) * (1.0 - WRONG - RARE_JUMPS * s).max(0.0);
                    for (to, from) in next[i].iter_mut().zip(&grown) {
                        *to += w * from;
                    }
                }
            }
            let likelihood: Vec<f64> = (0..N)
                .map(|i| (-0.5 * (to + i as f64 * dx - y).powi(2) / r).exp() / (TAU * r).sqrt())
                .collect();
            for (row, mass) in next.iter_mut().zip(&mut masses) {
                for (a, l) in row.iter_mut().zip(&likelihood) {
                    *a = a.max(0.0) * l;
                }
                *mass = row.iter().sum::<f64>() * dx;
            }
            let sum: f64 = masses.iter().sum();
            evidence += sum.ln();
            masses.iter_mut().for_each(|m| *m /= sum);
            next.iter_mut().flatten().for_each(|a| *a /= sum);
            (rows, origin) = (next, to);
        }
        let mean: f64 = (0..ROWS).map(|j| masses[j] * rho(j)).sum();
        let variance: f64 = (0..ROWS).map(|j| masses[j] * (rho(j) - mean).powi(2)).sum();
        Verdict {
            mean,
            sd: variance.sqrt(),
            evidence,
        }
    }
}

/// How a row is moved by a part of a node.
#[derive(Clone, Copy, PartialEq)]
enum Shift {
    /// by its Fourier series: exact for what the nodes resolve
    Spectral,
    /// between two nodes by a straight line: each shift adds a variance of up to a quarter of a node squared
    Straight,
}

/// A discrete Fourier transform of one length, a power of two.
struct Fourier {
    /// `exp(-2 pi i k / n)`
    roots: Vec<(f64, f64)>,
}

impl Fourier {
    fn new(n: usize) -> Self {
        let root = |k: usize| (-TAU * k as f64 / n as f64).sin_cos();
        Self {
            roots: (0..n).map(root).map(|(sin, cos)| (cos, sin)).collect(),
        }
    }

    /// In place, radix 2; not scaled.
    fn transform(&self, a: &mut [(f64, f64)]) {
        let n = a.len();
        let bits = n.trailing_zeros();
        for i in 0..n {
            let j = i.reverse_bits() >> (usize::BITS - bits);
            if i < j {
                a.swap(i, j);
            }
        }
        let mut half = 1;
        while half < n {
            for begin in (0..n).step_by(2 * half) {
                for k in 0..half {
                    let (u, v) = (a[begin + k], a[begin + k + half]);
                    let v = product(v, self.roots[k * (n / (2 * half))]);
                    a[begin + k] = (u.0 + v.0, u.1 + v.1);
                    a[begin + k + half] = (u.0 - v.0, u.1 - v.1);
                }
            }
            half *= 2;
        }
    }

    /// A row moved `by` nodes and spread by a normal of `variance` [nodes^2]. The row is next to nothing at both ends; what
    /// leaves it on one side does not come back on the other.
    fn moved(&self, row: &[f64], by: f64, variance: f64, shift: Shift) -> Vec<f64> {
        let n = row.len();
        let whole = match shift {
            Shift::Spectral => by.round(),
            Shift::Straight => by.floor(),
        };
        let part = by - whole;
        let mut a: Vec<(f64, f64)> = row.iter().map(|x| (*x, 0.0)).collect();
        self.transform(&mut a);
        for (k, a) in a.iter_mut().enumerate() {
            let at = if k <= n / 2 { k as f64 } else { k as f64 - n as f64 };
            let wave = TAU * at / n as f64;
            let (sin, cos) = (-wave * part).sin_cos();
            let phase = match shift {
                Shift::Spectral if k == n / 2 => (cos, 0.0),
                Shift::Spectral => (cos, sin),
                Shift::Straight => (1.0 - part + part * wave.cos(), -part * wave.sin()),
            };
            let damped = (-0.5 * wave * wave * variance).exp() / n as f64;
            *a = product(*a, (phase.0 * damped, phase.1 * damped));
            // the transform of the conjugate is the conjugate of the inverse
            a.1 = -a.1;
        }
        self.transform(&mut a);
        let from = |i: usize| i as f64 - whole;
        (0..n)
            .map(from)
            .map(|i| {
                if (0.0..n as f64).contains(&i) {
                    a[i as usize].0
                } else {
                    0.0
                }
            })
            .collect()
    }
}

fn product(a: (f64, f64), b: (f64, f64)) -> (f64, f64) {
    (a.0 * b.0 - a.1 * b.1, a.0 * b.1 + a.1 * b.0)
}

/// Differences of a solution from another: of the mean and of the standard deviation of rho [standard deviations], of the
/// evidence [nat].
fn apart(a: Verdict, b: Verdict) -> [f64; 3] {
    [(a.mean - b.mean) / b.sd, a.sd / b.sd - 1.0, a.evidence - b.evidence]
}

#[test]
fn a_spectral_shift_moves_a_normal_and_no_more() {
    let fourier = Fourier::new(128);
    let normal = |at: f64, v: f64| -> Vec<f64> {
        (0..128)
            .map(|i| (-0.5 * (i as f64 - at).powi(2) / v).exp() / (2.0 * PI * v).sqrt())
            .collect()
    };
    let mut row = normal(60.0, 4.0);
    for by in [0.3, -0.45, 7.77, -12.5, 0.0] {
        row = fourier.moved(&row, by, 0.5, Shift::Spectral);
    }
    let far = normal(60.0 + 0.3 - 0.45 + 7.77 - 12.5, 6.5);
    assert!(row.iter().zip(&far).all(|(a, b)| (a - b).abs() < 1e-12));
}

/// Straight lines between nodes of 0.8 standard deviations of damage add wear of their own: a standard deviation of rho that
/// is 12 % too large in this case, where spectral shifts are right to 0.01 %.
#[test]
fn straight_lines_between_nodes_are_diffusive() {
    let case = Case::new(8);
    let fine = case.grid(Shift::Spectral, FINE);
    let spectral = apart(case.grid(Shift::Spectral, 2.0 * FINE), fine);
    let straight = apart(case.grid(Shift::Straight, 2.0 * FINE), fine);
    println!("spectral {spectral:.5?}, straight {straight:.5?}");
    assert!(spectral.iter().all(|d| d.abs() < 1e-3), "{spectral:?}");
    assert!(straight[1] > 0.08, "{straight:?}");
}

/// Two runs of the particles differ by up to 0.03 of a standard deviation, 1.5 % and 0.06 nat.
#[test]
fn referees_agree_with_each_other() {
    for seed in [0, 3, 4, 5, 6] {
        let case = Case::new(seed);
        let grid = case.grid(Shift::Spectral, FINE);
        for run in 0..2 {
            let off = apart(case.particles(20_000, 70 + run), grid);
            println!("case {seed}, {} tests: {off:.4?}", case.tests.len());
            for (d, bar) in off.into_iter().zip([0.06, 0.03, 0.15]) {
                assert!(d.abs() < bar, "case {seed}: {off:?}");
            }
        }
    }
}

/// The bars that a filter should hold are 0.1 standard deviations, 5 % and 0.2 nat. Of the 50 cases 47, 50 and 46 hold
/// them; the worst are 0.20, 2.9 % and 0.24 nat. With 13 nodes of rho at the beginning in place of 31 the evidence of 33 holds,
/// and it goes astray by up to 0.65 nat in the first 20 tests or so, where nodes are broader than the growth is linear in them.
#[test]
fn the_filter_agrees_with_particles() {
    let mut held = [0; 3];
    let mut worst = [0.0f64; 3];
    for seed in 0..50 {
        let case = Case::new(seed);
        let off = apart(case.filter(), case.particles(20_000, seed));
        println!("case {seed}, {} tests: {off:.4?}", case.tests.len());
        for (i, bar) in [0.1, 0.05, 0.2].into_iter().enumerate() {
            held[i] += u32::from(off[i].abs() < bar);
            worst[i] = worst[i].max(off[i].abs());
        }
    }
    println!("rate, its sd, evidence: {held:?} of 50 hold, worst {worst:.4?}");
    assert!(held[0] >= 44 && worst[0] < 0.25, "rate: {held:?}, {worst:?}");
    assert!(held[1] == 50, "its sd: {held:?}, {worst:?}");
    assert!(held[2] >= 44 && worst[2] < 0.4, "evidence: {held:?}, {worst:?}");
}

/// Of so many units the true rho lies within the central 90 %; and mean and variance of the standardised error.
fn covered(models: &[Model], cases: u64, seed: u64) -> (u32, f64, f64) {
    let prior = Arc::new(Prior::shipped(1.0));
    let total: f64 = models.iter().map(|m| prior.mass(*m)).sum();
    let (mut inside, mut first, mut second) = (0, 0.0, 0.0);
    for case in 0..cases {
        let mut random = Random::new(seed + case);
        let mut left = total * random.uniform();
        let model = *models
            .iter()
            .find(|m| {
                left -= prior.mass(**m);
                left < 0.0
            })
            .unwrap_or(&models[0]);
        let (mean, spread) = prior.rho(model);
        let noise = model.noise();
        let stated = random.log_between(0.0005, 0.01);
        let start = random.log_between(0.0005, 0.02);
        let count = random.between(40.0, 150.0) as usize;
        // scatter in proportion goes by a level that does not change
        let level = 1.0;
        let sd = ((noise.of_stated * stated).powi(2) + (noise.of_level * level).powi(2)).sqrt();
        let mut rho = mean + spread * random.normal();
        let mut x = start * random.normal();
        let mut filter = Filter::of_one(prior.clone(), model, 0.0, start);
        for _ in 0..count {
            let s = rho.exp();
            x += match model.wear() {
                Wear::Smooth(kappa) => s + (kappa * s).sqrt() * random.normal(),
                Wear::Gamma(cv) => s * cv * cv * random.gamma(1.0 / (cv * cv)),
                Wear::Jumps(of) => {
                    let (size, shape) = (of.size, f64::from(of.shape));
                    (0..random.poisson(s / size))
                        .map(|_| size / shape * random.gamma(shape))
                        .sum()
                }
            };
            rho += model.volatility() * s.sqrt() * random.normal();
            let y = x + sd * random.normal();
            let reading = Reading::Damage { y, sd: stated, level };
            filter.step(1.0, Some(reading));
            // what has been read alone ends a life
            if y > 1.0 {
                break;
            }
        }
        let below: f64 = filter
            .components
            .iter()
            .map(|c| c.weight * normal_cdf((rho - c.rho) / c.rho_variance().sqrt()))
            .sum();
        inside += u32::from((0.05..=0.95).contains(&below));
        let (mean, sd) = filter.rho();
        first += (rho - mean) / sd / cases as f64;
        second += ((rho - mean) / sd).powi(2) / cases as f64;
    }
    (inside, first, second)
}

#[test]
fn intervals_cover_rates_of_gamma_wear_and_of_jumps() {
    let gamma = linear(|w| matches!(w, Wear::Gamma(_)));
    let jumps = linear(|w| matches!(w, Wear::Jumps(_)));
    for (name, models, seed) in [("gamma", gamma, 5000), ("jumps", jumps, 9000)] {
        for cases in [300, 2000] {
            let (inside, first, second) = covered(&models, cases, seed);
            let share = f64::from(inside) / cases as f64;
            println!("{name}: {share:.4} of {cases} within; standardised error {first:.3}, its square {second:.3}");
            assert!((0.85..=0.95).contains(&share), "{name}: {share}");
        }
    }
}
