//! The equations of a bench as rows of a least-squares problem: filtered, thinned out, masked where
//! they do not hold, and divided by what the sensors' noise leaves in them.

use super::bench::{Bench, BenchChannel, Known};
use super::columns::{Column, RigConstants};
use super::filter::FilterBank;
use super::recording::Run;
use super::signals::{Clock, NoiseTable, Signals};
use sim_worker::effect::{Constants, Equation, Play};
use std::ops::Range;

/// Uncertainty of what is never perfect in sensors, one sigma (assumed): gain, offset over noise,
/// clock between channels over the sample.
const SENSOR_GAIN: f64 = 0.006;
const SENSOR_OFFSET: f64 = 0.1;
const SENSOR_CLOCK: f64 = 0.15;
/// Offset of a voltage over its noise, one sigma (assumed): amplifiers drift more than current sensors.
const VOLTAGE_OFFSET: f64 = 0.4;
/// Mains frequencies looked for [Hz].
pub const MAINS_HZ: [f64; 2] = [50.0, 60.0];

/// A nuisance parameter of the whole study.
#[derive(Clone, Debug, PartialEq)]
pub struct Nuisance {
    pub name: &'static str,
    /// one sigma of its relative deviation; `None` = free
    pub trust: Option<f64>,
    /// where the prior has its middle: 0, or elsewhere once the equations stand around a better value
    pub centre: f64,
    /// value that the deviation is relative to, SI at the motor
    pub nominal: f64,
    pub unit: &'static str,
    /// a property of the machine rather than of its sensors
    pub of_machine: bool,
}

/// Rows of one equation of one run.
#[derive(Clone, Debug)]
pub struct Block {
    pub run: usize,
    pub equation: Equation,
    /// where its rows stand in the columns
    pub rows: Range<usize>,
    /// samples of the run they belong to
    pub samples: Vec<usize>,
    /// samples beyond `samples` that count as masked
    pub masked: usize,
}

/// A set of runs as equations.
pub struct Problem {
    pub signals: Vec<Signals>,
    pub names: Vec<String>,
    pub blocks: Vec<Block>,
    pub rows: usize,
    /// left-hand side less the nominal model, SI
    pub y: Vec<f64>,
    /// drive torque in the rows of the torque equation, 0 elsewhere
    pub drive: Vec<f64>,
    /// columns of the nuisance parameters
    pub base: Vec<Vec<f64>>,
    /// columns of single runs: offsets of position, mains hum
    pub local: Vec<Vec<f64>>,
    /// rms of the sensors' noise by equation, in the order of [`Equation::ALL`]
    pub floor: [f64; 5],
    /// rows that would be as good if their noise were independent, as a share
    pub independent: f64,
    pub clock: Clock,
    bank: FilterBank,
}

/// The rig's constants as the equations use them.
pub fn constants(bench: &Bench, clock: &Clock) -> RigConstants {
    let rig = &bench.rig;
    RigConstants {
        effect: Constants {
            torque_constant: rig.drive_constant.value,
            coulomb: rig.coulomb.value,
            viscous: rig.viscous.value,
            resistance: rig.resistance.value,
            inductance: rig.inductance.value,
            pole_pairs: rig.pole_pairs,
        },
        inertia: rig.inertia.value,
        back_emf: rig.back_emf.value,
        supply_voltage: rig.supply_voltage,
        measured_current: rig.drive == BenchChannel::Current,
        motor: matches!(rig.drive, BenchChannel::Current | BenchChannel::Voltage),
        from_position: clock.from_position,
        encoder: (0.0, 0.0),
        speed_gain: rig.controller.as_ref().map_or(0.0, |l| l.speed_gain),
    }
}

/// The nuisance parameters of a bench: the machine's, then the sensors'.
pub fn nuisances(bench: &Bench, noise: &NoiseTable, equations: &[Equation]) -> Vec<Nuisance> {
    let rig = &bench.rig;
    let machine = |name, k: &Known, unit| Nuisance {
        name,
        trust: k.trust,
        centre: 0.0,
        nominal: k.value,
        unit,
        of_machine: true,
    };
    let sensor = |name, sigma: f64, unit| Nuisance {
        name,
        trust: Some(sigma),
        centre: 0.0,
        nominal: 1.0,
        unit,
        of_machine: false,
    };
    let noise_of = |c: BenchChannel| noise.get(&c).map_or(0.0, |n| n.rms);
    let has = |e: Equation| equations.contains(&e);
    let mut out = vec![
        machine("inertia", &rig.inertia, "kg m2"),
        machine("viscous", &rig.viscous, "N m s/rad"),
        machine("coulomb", &rig.coulomb, "N m"),
        machine("torque_constant", &rig.drive_constant, "N m/A"),
    ];
    if rig.offset != 0.0 {
        let offset = Known {
            value: rig.offset,
            trust: None,
        };
        out.push(machine("offset", &offset, "N m"));
    }
    if rig.drive == BenchChannel::Current {
        out.push(sensor("drive_offset", SENSOR_OFFSET * noise_of(rig.drive), "A"));
        out.push(sensor("drive_clock", SENSOR_CLOCK, "sample"));
    }
    if has(Equation::Electrical) {
        out.push(machine("resistance", &rig.resistance, "ohm"));
        out.push(machine("inductance", &rig.inductance, "H"));
        out.push(sensor("drive_gain", SENSOR_GAIN, "-"));
        out.push(sensor(
            "voltage_offset",
            VOLTAGE_OFFSET * noise_of(BenchChannel::Voltage),
            "V",
        ));
        out.push(sensor("voltage_gain", SENSOR_GAIN, "-"));
        out.push(sensor("voltage_clock", SENSOR_CLOCK, "sample"));
    }
    if has(Equation::Transmission) && rig.play > 0.0 {
        let play = Known {
            value: rig.play,
            trust: Some(1.0),
        };
        out.push(machine("play", &play, "rad"));
    }
    if has(Equation::Kinematic) {
        out.push(sensor("velocity_gain", SENSOR_GAIN, "-"));
        out.push(sensor("velocity_offset", noise_of(BenchChannel::Velocity), "rad/s"));
        out.push(sensor("velocity_clock", SENSOR_CLOCK, "sample"));
    }
    if has(Equation::Controller) {
        out.push(sensor("law_gain", 0.05, "-"));
        out.push(sensor("law_clock", 0.1, "sample"));
    }
    out
}

/// Which equations the channels of all runs open.
pub fn equations(bench: &Bench, runs: &[Run]) -> Vec<Equation> {
    let has = |c: BenchChannel| runs.iter().all(|r| r.channel(c).is_some());
    let current = bench.rig.drive == BenchChannel::Current;
    let mut out = vec![Equation::Torque];
    if current && has(BenchChannel::Voltage) {
        out.push(Equation::Electrical);
    }
    if has(BenchChannel::Position) && has(BenchChannel::UserPosition) {
        out.push(Equation::Transmission);
    }
    if has(BenchChannel::Position) && has(BenchChannel::Velocity) {
        out.push(Equation::Kinematic);
    }
    if bench.rig.controller.is_some() && has(BenchChannel::Command) && current {
        out.push(Equation::Controller);
    }
    out
}

impl Problem {
    /// * `runs` those of one role
    pub fn new(
        bench: &Bench,
        runs: &[&Run],
        clock: &Clock,
        noise: &NoiseTable,
        equations: &[Equation],
        nuisances: &[Nuisance],
    ) -> Self {
        let signals: Vec<Signals> = runs.iter().map(|r| Signals::new(bench, r, clock)).collect();
        let bank = clock.common();
        let reach = bank.half();
        // the kernel has given up all weight that matters within half its reach
        let close = reach / 2;
        let mut blocks = Vec::new();
        let mut rows = 0;
        for (r, s) in signals.iter().enumerate() {
            for &equation in equations {
                let all: Vec<usize> = (reach..s.n.saturating_sub(reach)).step_by(clock.stride).collect();
                let bad: Option<&[bool]> = match equation {
                    Equation::Torque => Some(&s.resting),
                    Equation::Controller => s.law.as_ref().map(|l| &l.1[..]),
                    _ => None,
                };
                let clean = |k: &usize| bad.is_none_or(|b| !b[k - close..=k + close].iter().any(|b| *b));
                let samples: Vec<usize> = all.iter().copied().filter(clean).collect();
                let n = samples.len();
                blocks.push(Block {
                    run: r,
                    equation,
                    rows: rows..rows + n,
                    masked: all.len() - n,
                    samples,
                });
                rows += n;
            }
        }
        let rho: Vec<f64> = (1..12).map(|j| autocorrelation(&bank, j * clock.stride)).collect();
        let mut p = Self {
            names: runs.iter().map(|r| r.name.clone()).collect(),
            blocks,
            rows,
            y: vec![0.0; rows],
            drive: vec![0.0; rows],
            base: Vec::new(),
            local: Vec::new(),
            floor: floors(bench, clock, noise, &bank),
            independent: 1.0 / (1.0 + 2.0 * rho.iter().map(|r| r * r).sum::<f64>()),
            clock: clock.clone(),
            bank,
            signals,
        };
        p.fill(bench, runs, nuisances);
        p
    }

    /// Left-hand sides and nuisance columns.
    fn fill(&mut self, bench: &Bench, runs: &[&Run], nuisances: &[Nuisance]) {
        use BenchChannel as C;
        let rig = &bench.rig;
        let (kt, j0, b0, tc) = (
            rig.drive_constant.value,
            rig.inertia.value,
            rig.viscous.value,
            rig.coulomb.value,
        );
        let (r0, l0, ke) = (rig.resistance.value, rig.inductance.value, rig.back_emf.value);
        let dt = 1.0 / self.clock.rate_hz;
        let mut base = vec![vec![0.0; self.rows]; nuisances.len()];
        let mut y = vec![0.0; self.rows];
        let mut offsets = Vec::new();
        let mut drive = vec![0.0; self.rows];
        let wide = |x: f64| if x > 0.0 { x } else { 1.0 };
        for block in &self.blocks {
            let (s, run) = (&self.signals[block.run], runs[block.run]);
            let bank = |c: C| self.clock.bank(bench, c);
            let raw = |c: C, order: usize| -> Vec<f64> {
                match run.channel(c) {
                    Some(x) => {
                        let b = bank(c);
                        block.samples.iter().map(|&k| within(&b, order, x, k)).collect()
                    }
                    None => vec![0.0; block.samples.len()],
                }
            };
            let common = |order: usize, x: &[f64]| -> Vec<f64> {
                block.samples.iter().map(|&k| self.bank.order[order].at(x, k)).collect()
            };
            // matched kinematics
            let speed = || {
                if self.clock.from_position {
                    raw(C::Position, 1)
                } else {
                    raw(C::Velocity, 0)
                }
            };
            let accel = || {
                if self.clock.from_position {
                    raw(C::Position, 2)
                } else {
                    raw(C::Velocity, 1)
                }
            };
            let mut column = |name: &str, values: &dyn Fn(usize) -> f64| {
                if let Some(c) = nuisances.iter().position(|n| n.name == name) {
                    for (i, row) in block.rows.clone().enumerate() {
                        base[c][row] = values(i);
                    }
                }
            };
            let y = &mut y[block.rows.clone()];
            match block.equation {
                Equation::Torque => {
                    let (u, a, w) = (raw(rig.drive, 0), accel(), speed());
                    let du = raw(rig.drive, 1);
                    let (sign, load) = (common(0, &s.sign), common(0, &s.load));
                    for (i, row) in block.rows.clone().enumerate() {
                        drive[row] = kt * u[i];
                    }
                    for i in 0..y.len() {
                        y[i] = kt * u[i] - load[i] - (j0 * a[i] + b0 * w[i] + tc * sign[i] + rig.offset);
                    }
                    column("inertia", &|i| wide(j0) * a[i]);
                    column("viscous", &|i| wide(b0) * w[i]);
                    column("coulomb", &|i| wide(tc) * sign[i]);
                    // the expected torque stands for kt u: a regressand that explains itself shrinks
                    let expected = |i: usize| j0 * a[i] + b0 * w[i] + tc * sign[i] + rig.offset + load[i];
                    column("torque_constant", &|i| -expected(i));
                    column("offset", &|_| rig.offset);
                    column("drive_offset", &|_| kt);
                    column("drive_gain", &|i| -expected(i));
                    column("drive_clock", &|i| kt * du[i] * dt);
                }
                Equation::Electrical => {
                    let (v, i_, di, w) = (raw(C::Voltage, 0), raw(rig.drive, 0), raw(rig.drive, 1), speed());
                    let dv = raw(C::Voltage, 1);
                    for i in 0..y.len() {
                        y[i] = v[i] - (r0 * i_[i] + l0 * di[i] + ke * w[i]);
                    }
                    column("resistance", &|i| r0 * i_[i]);
                    column("inductance", &|i| wide(l0) * di[i]);
                    column("torque_constant", &|i| ke * w[i]);
                    column("voltage_offset", &|_| 1.0);
                    column("voltage_gain", &|i| r0 * i_[i] + l0 * di[i] + ke * w[i]);
                    column("voltage_clock", &|i| dv[i] * dt);
                    column("drive_offset", &|_| -r0);
                    column("drive_gain", &|i| r0 * i_[i]);
                }
                Equation::Transmission => {
                    let (u, t) = (raw(C::UserPosition, 0), raw(C::Position, 0));
                    let followed = played(s, rig.play);
                    let lag: Vec<f64> = followed.iter().zip(&s.theta).map(|(f, t)| f - t).collect();
                    let lag = common(0, &lag);
                    for i in 0..y.len() {
                        y[i] = u[i] - t[i] - lag[i];
                    }
                    column("play", &|i| lag[i]);
                    offsets.push(block.rows.clone());
                }
                Equation::Kinematic => {
                    let (w, dw, d) = (raw(C::Velocity, 0), raw(C::Velocity, 1), raw(C::Position, 1));
                    for i in 0..y.len() {
                        y[i] = w[i] - d[i];
                    }
                    column("velocity_gain", &|i| d[i]);
                    column("velocity_offset", &|_| 1.0);
                    column("velocity_clock", &|i| dw[i] * dt);
                }
                Equation::Controller => {
                    let law = &s.law.as_ref().expect("the equation is open").0;
                    let (u, l) = (raw(rig.drive, 1), common(1, law));
                    // of the law, not of the drive: see above
                    let ll = common(2, law);
                    for i in 0..y.len() {
                        y[i] = u[i] - l[i];
                    }
                    column("law_gain", &|i| l[i]);
                    column("law_clock", &|i| ll[i] * dt);
                }
            }
        }
        self.y = y;
        self.drive = drive;
        self.base = base;
        for rows in offsets {
            let mut c = vec![0.0; self.rows];
            c[rows].fill(1.0);
            self.local.push(c);
        }
    }

    /// A column of an effect over all rows; `at` gives its pieces for a run.
    pub fn column(&self, pieces: &[Column]) -> Vec<f64> {
        let mut out = vec![0.0; self.rows];
        for block in &self.blocks {
            for piece in pieces[block.run].iter().filter(|p| p.equation == block.equation) {
                let kernel = &self.bank.order[piece.order];
                for (row, &k) in block.rows.clone().zip(&block.samples) {
                    out[row] += kernel.at(&piece.signal, k);
                }
            }
        }
        out
    }

    /// Sine and cosine of a frequency in the rows of a block, as local columns.
    pub fn add_hum(&mut self, block: usize, f_hz: f64) {
        let b = &self.blocks[block];
        let w = std::f64::consts::TAU * f_hz / self.clock.rate_hz;
        for f in [f64::sin, f64::cos] {
            let mut c = vec![0.0; self.rows];
            for (row, &k) in b.rows.clone().zip(&b.samples) {
                c[row] = f(w * k as f64);
            }
            self.local.push(c);
        }
    }

    /// Rows of an equation.
    pub fn rows_of(&self, e: Equation) -> usize {
        self.blocks
            .iter()
            .filter(|b| b.equation == e)
            .map(|b| b.rows.len())
            .sum()
    }

    pub fn floor_of(&self, e: Equation) -> f64 {
        self.floor[e.index()]
    }

    /// One over the floor of each row's equation.
    pub fn weights(&self, sigma: &[f64; 5]) -> Vec<f64> {
        let mut w = vec![0.0; self.rows];
        for b in &self.blocks {
            w[b.rows.clone()].fill(1.0 / sigma[b.equation.index()]);
        }
        w
    }

    /// Sum of squares of a vector of rows, by equation.
    pub fn energy(&self, r: &[f64]) -> [f64; 5] {
        let mut out = [0.0; 5];
        for b in &self.blocks {
            out[b.equation.index()] += r[b.rows.clone()].iter().map(|x| x * x).sum::<f64>();
        }
        out
    }
}

/// A channel's own kernels may reach a little further than the common ones: the ends are held.
fn within(bank: &FilterBank, order: usize, x: &[f64], k: usize) -> f64 {
    let half = bank.half();
    bank.order[order].at(x, k.clamp(half, x.len() - 1 - half))
}

/// The user's angle behind the known play, which starts where the user's sensor says.
fn played(s: &Signals, half: f64) -> Vec<f64> {
    let theta = &s.theta;
    let lag = s.user.as_ref().map_or(0.0, |u| u[0] - s.position[0]);
    let start = theta[0] + if lag.abs() <= 1.05 * half { lag } else { 0.0 };
    let mut play = Play::new(2.0 * half, start);
    theta.iter().map(|t| play.step(*t)).collect()
}

/// Correlation of filtered white noise over `lag` samples.
fn autocorrelation(bank: &FilterBank, lag: usize) -> f64 {
    let n = 2 * bank.half() + 1;
    let mut impulse = vec![0.0; 2 * n + 2 * lag + 1];
    let middle = impulse.len() / 2;
    impulse[middle] = 1.0;
    let half = bank.half();
    let h: Vec<f64> = (half..impulse.len() - half)
        .map(|k| bank.order[0].at(&impulse, k))
        .collect();
    let sum = |d: usize| -> f64 { h.iter().zip(&h[d.min(h.len())..]).map(|(a, b)| a * b).sum() };
    sum(lag) / sum(0)
}

/// rms that the sensors' noise leaves in each equation.
fn floors(bench: &Bench, clock: &Clock, noise: &NoiseTable, bank: &FilterBank) -> [f64; 5] {
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
        Equation::Electrical => norm(&[
            left(C::Voltage, 0),
            rig.resistance.value * left(rig.drive, 0),
            rig.inductance.value * left(rig.drive, 1),
            rig.back_emf.value * speed,
        ]),
        Equation::Transmission => norm(&[left(C::UserPosition, 0), left(C::Position, 0)]),
        Equation::Kinematic => norm(&[left(C::Velocity, 0), left(C::Position, 1)]),
        Equation::Controller => norm(&[left(rig.drive, 1), law * clock.speed_noise * bank.order[1].noise_gain()]),
    })
}
