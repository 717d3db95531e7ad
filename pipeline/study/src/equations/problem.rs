//! The equations of a bench as rows of a least-squares problem: filtered, thinned out, masked where
//! they do not hold, and divided by what the sensors' noise leaves in them.

mod fill;

use crate::equations::clock::{self, Clock, NoiseTable};
use crate::equations::floors::floors;
use crate::equations::mechanics::{Mechanics, mechanics};
use crate::equations::nuisances::Nuisance;
use crate::equations::phases::{self, SUPPLY};
use crate::equations::pieces::{Column, Piece};
use crate::equations::signals::{self, Signals};
use crate::measured::bench::{Bench, BenchChannel};
use crate::measured::filter::FilterBank;
use crate::measured::recording::{Run, extent};
use crate::measured::samples;
use sim_worker::effect::Equation;
use std::ops::Range;

/// Mains frequencies looked for [Hz].
pub const MAINS_HZ: [f64; 3] = [50.0, 60.0, 400.0];

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
    /// hash of the file of each run
    pub files: Vec<String>,
    pub blocks: Vec<Block>,
    pub rows: usize,
    /// left-hand side less the nominal model, SI
    pub y: Vec<f64>,
    /// drive torque in the rows of the torque equation, 0 elsewhere
    pub drive: Vec<f64>,
    /// columns of the nuisance parameters
    pub base: Vec<Vec<f64>>,
    /// which of them is dry friction's
    pub dry_friction: Option<usize>,
    /// and which is the inertia's, where the motion changes
    pub inertia: Option<usize>,
    /// columns of single runs: offsets of position and phase currents, mains hum; what each is believed to be at most,
    /// one sigma in its own unit
    pub local: Vec<Vec<f64>>,
    pub local_trust: Vec<Option<f64>>,
    /// rms of the sensors' noise by equation, in the order of [`Equation::ALL`]
    pub floor: [f64; 5],
    /// same without what the model is known not to have: the sensors' alone
    pub sensor_floor: [f64; 5],
    /// noise of the torque in the filter, rms [N m], and its share of the variance of a row
    pub(super) torque_noise: (f64, f64),
    /// torque that the model is known not to have, rms [N m]
    pub(super) excess: f64,
    /// rows that would be as good if their noise were independent, as a share, by equation
    pub independent: [f64; 5],
    /// share of a row's variance that the noise of the drive's sensor makes: it stands in regressors too
    pub regressor_noise: [f64; 5],
    /// variances of a row of the electrical equation that the current's noise makes, by resistance and inductance
    current_noise: (f64, f64),
    pub clock: Clock,
    bank: FilterBank,
    mechanics: Mechanics,
    /// of the supply's rows, so that their noise is that of the phases'
    supply_scale: f64,
    /// samples of a row of the electrical equation
    pub(super) window: usize,
}

/// What a supply's voltage does by itself over a row [V], at least and at most (assumed); between them, what it does from
/// row to row says it.
const SUPPLY_NOISE_V: (f64, f64) = (0.005, 0.02);
/// Same of a rig, over its nominal voltage, beside what its sensor does (assumed).
const SUPPLY_NOISE: (f64, f64) = (1e-4, 5e-3);
/// Share of its neighbour that a sample at either end of a window has in the mean over it.
///
/// The change over a window is known between means of two samples, so that what happens in a sample at its end counts in part.
/// With this share the mean takes as much of a current that steps at any moment within a sample, as at each commutation;
/// with none the inductance of such currents came out 1.5 % high, with a quarter, which suits what changes slowly, 0.7 % low.
const AT_ENDS: f64 = 1.0 / 6.0;

/// Mean of a signal over the `window` samples that end at `k` (0), or its change over them a second (1).
fn over(x: &[f64], order: usize, k: usize, window: usize, rate_hz: f64) -> f64 {
    let (before, first, after) = (x[k - window], x[k - window + 1], x[(k + 1).min(x.len() - 1)]);
    if order == 0 {
        let within = x[k - window + 1..=k].iter().sum::<f64>();
        return (within + AT_ENDS * (before - first + after - x[k])) / window as f64;
    }
    0.5 * (x[k] + after - before - first) * rate_hz / window as f64
}

impl Problem {
    /// * `runs` those of one role
    /// * `all` those that decide how samples are taken together and what noise there is
    /// * `excess` torque that the model is known not to have, and what the drive does between samples, rms [N m]
    #[allow(clippy::too_many_arguments)]
    pub fn new(
        bench: &Bench,
        runs: &[&Run],
        all: &[&Run],
        clock: &Clock,
        noise: &NoiseTable,
        equations: &[Equation],
        nuisances: &[Nuisance],
        excess: (f64, f64),
    ) -> Self {
        let mut signals: Vec<Signals> = runs
            .iter()
            .map(|r| Signals {
                before: signals::before(r, all),
                ..Signals::new(bench, r, clock)
            })
            .collect();
        phases::find_star(&mut signals, 0.5 * bench.rig.back_emf.value);
        let bank = clock.common();
        let reach = bank.half();
        // the kernel has given up all weight that matters within half its reach
        let close = reach / 2;
        let window = clock::window(clock.rate_hz);
        let (mechanics, sensed) = mechanics(bench, all, clock, noise, excess);
        let mut blocks = Vec::new();
        let mut rows = 0;
        for (r, s) in signals.iter().enumerate() {
            for &equation in equations {
                let moving = matches!(equation, Equation::Torque | Equation::Kinematic);
                let every: Vec<usize> = if moving {
                    Vec::new()
                } else if equation == Equation::Electrical {
                    (window..s.n.saturating_sub(1)).step_by(window).collect()
                } else {
                    (reach..s.n.saturating_sub(reach)).step_by(clock.stride).collect()
                };
                let bad = match equation {
                    Equation::Controller => s.law.as_ref().map(|l| &l.1[..]),
                    _ => None,
                };
                let away = |b: &[bool], k: usize| !b[k - close..=k + close].iter().any(|b| *b);
                let clean = |k: &usize| {
                    if equation == Equation::Electrical {
                        let of = |b: &[bool]| b.iter().skip(*k - window).take(window + 2).any(|b| *b);
                        return !of(&s.lost) && !of(&s.stepping);
                    }
                    bad.is_none_or(|b| away(b, *k)) && (s.lost.is_empty() || away(&s.lost, *k))
                };
                let (samples, possible) = if moving {
                    (mechanics.samples(s), s.n / mechanics.group())
                } else {
                    (every.iter().copied().filter(clean).collect::<Vec<_>>(), every.len())
                };
                // three phases and the supply: rows of one window follow each other; one voltage: all of the supply come after it
                let samples = match (&s.phases, equation) {
                    (Some(p), Equation::Electrical) => {
                        let each = p.rows();
                        samples.iter().flat_map(|&k| std::iter::repeat_n(k, each)).collect()
                    }
                    (None, Equation::Electrical) if s.supply.is_some() => samples.repeat(2),
                    _ => samples,
                };
                let n = samples.len();
                blocks.push(Block {
                    run: r,
                    equation,
                    rows: rows..rows + n,
                    masked: possible.saturating_sub(n),
                    samples,
                });
                rows += n;
            }
        }
        let rho: Vec<f64> = (1..12).map(|j| autocorrelation(&bank, j * clock.stride)).collect();
        let filtered = 1.0 / (1.0 + 2.0 * rho.iter().map(|r| r * r).sum::<f64>());
        let mut floor = floors(bench, clock, noise, &bank, window);
        let mut sensor_floor = floor;
        let mut torque_noise = (0.0, 0.0);
        let mut independent = [filtered; 5];
        independent[Equation::Electrical.index()] = 1.0;
        let mut regressor_noise = [0.0; 5];
        if let Mechanics::Moving(w) = &mechanics {
            for (e, i) in [(Equation::Torque, 0), (Equation::Kinematic, 1)] {
                floor[e.index()] = w.floor();
                let share = w.torque_share()[i];
                let of_excess = share * (excess.0 / w.torque_noise()).powi(2);
                sensor_floor[e.index()] = w.floor() * (1.0 - of_excess).max(1e-6).sqrt();
                if i == 0 {
                    torque_noise = (w.torque_noise(), share);
                }
                independent[e.index()] = 1.0;
                regressor_noise[e.index()] = sensed * w.torque_share()[i];
            }
        }
        let mut p = Self {
            names: runs.iter().map(|r| r.name.clone()).collect(),
            files: runs.iter().map(|r| r.hash.clone()).collect(),
            blocks,
            rows,
            y: vec![0.0; rows],
            drive: vec![0.0; rows],
            base: Vec::new(),
            dry_friction: None,
            inertia: None,
            local: Vec::new(),
            local_trust: Vec::new(),
            floor,
            sensor_floor,
            torque_noise,
            excess: excess.0,
            independent,
            regressor_noise,
            current_noise: {
                let rms = noise.get(&bench.rig.drive).map_or(0.0, |n| n.rms);
                let (samples, seconds) = (window as f64, window as f64 / clock.rate_hz);
                // of one phase, or of two in series
                let of = if bench.has_phases() { 0.5 } else { 1.0 };
                let rms = if bench.has_phases() { 2f64.sqrt() * rms } else { rms };
                let (r, l) = (of * bench.rig.resistance.value, of * bench.rig.inductance.value);
                ((r * rms).powi(2) / samples, (l * rms / seconds).powi(2))
            },
            clock: clock.clone(),
            bank,
            mechanics,
            window,
            supply_scale: floor[Equation::Electrical.index()] / supply_noise(bench, all, noise, window),
            signals,
        };
        p.fill(bench, runs, nuisances);
        p
    }

    /// A column of an effect over all rows: its pieces for each run.
    pub fn column(&self, pieces: &[Column]) -> Vec<f64> {
        self.columns(&[pieces]).remove(0)
    }

    /// Columns, each from its pieces for each run.
    pub fn columns<P: AsRef<[Column]>>(&self, all: &[P]) -> Vec<Vec<f64>> {
        let mut out = vec![vec![0.0; self.rows]; all.len()];
        for (r, s) in self.signals.iter().enumerate() {
            let block = |e: Equation| self.blocks.iter().find(|b| b.run == r && b.equation == e);
            let blocks = [block(Equation::Torque), block(Equation::Kinematic)];
            let moving: Vec<_> = all.iter().map(|pieces| self.moving(&pieces.as_ref()[r], s)).collect();
            let there: Vec<usize> = (0..all.len())
                .filter(|i| moving[*i].iter().any(Option::is_some))
                .collect();
            let signals: Vec<_> = there
                .iter()
                .map(|i| moving[*i].each_ref().map(Option::as_deref))
                .collect();
            for (i, rows) in there.iter().zip(self.mechanics.rows(&signals, s)) {
                for (b, values) in blocks.iter().zip(rows) {
                    if let Some(b) = b {
                        out[*i][b.rows.clone()].copy_from_slice(&values);
                    }
                }
            }
        }
        for (column, pieces) in out.iter_mut().zip(all) {
            self.still(column, pieces.as_ref());
        }
        out
    }

    /// What pieces are to the mechanics of a run: torque [N m], angle [rad] and speed [rad/s], each at its sensor's moment.
    fn moving(&self, pieces: &[Piece], s: &Signals) -> [Option<Vec<f64>>; 3] {
        let rate = self.clock.rate_hz;
        let sum = |equation: Equation, order: usize| -> Option<Vec<f64>> {
            let mut all = pieces.iter().filter(|p| p.equation == equation && p.order == order);
            let mut sum = all.next()?.signal.clone();
            all.for_each(|p| sum.iter_mut().zip(&p.signal).for_each(|(s, x)| *s += x));
            Some(sum)
        };
        let mut torque = sum(Equation::Torque, 0);
        if let Some(x) = sum(Equation::Torque, 1) {
            // the mean of a derivative is the difference of the ends
            let t = torque.get_or_insert_with(|| vec![0.0; s.n]);
            t.iter_mut().zip(samples::rate_of(&x, rate)).for_each(|(t, r)| *t += r);
        }
        // what stands in a measured angle or speed stands there at that sensor's moment
        let ahead = self.mechanics.ahead();
        let at_sensor = |order: usize| Some(samples::later(&sum(Equation::Kinematic, order)?, ahead[order]));
        [torque, at_sensor(0), at_sensor(1)]
    }

    /// Puts into a column what its pieces are to the other equations.
    fn still(&self, out: &mut [f64], pieces: &[Column]) {
        let rate = self.clock.rate_hz;
        for block in &self.blocks {
            if matches!(block.equation, Equation::Torque | Equation::Kinematic) {
                continue;
            }
            for piece in pieces[block.run].iter().filter(|p| p.equation == block.equation) {
                if let (Equation::Electrical, Some(p)) = (block.equation, &self.signals[block.run].phases) {
                    let Some(q) = piece.phase else { continue };
                    let scale = if q == SUPPLY { self.supply_scale } else { 1.0 };
                    for (at, part) in p.taken(q) {
                        for (row, &k) in block.rows.clone().zip(&block.samples).skip(at).step_by(p.rows()) {
                            out[row] += part * scale * over(&piece.signal, piece.order, k, self.window, rate);
                        }
                    }
                    continue;
                }
                if block.equation == Equation::Electrical {
                    let of_winding = self.signals[block.run].of_winding(block.samples.len());
                    let (range, scale) = match piece.phase {
                        Some(SUPPLY) => (of_winding..block.samples.len(), self.supply_scale),
                        _ => (0..of_winding, 1.0),
                    };
                    for i in range {
                        let seen = over(&piece.signal, piece.order, block.samples[i], self.window, rate);
                        out[block.rows.start + i] += scale * seen;
                    }
                    continue;
                }
                let kernel = &self.bank.order[piece.order];
                for (row, &k) in block.rows.clone().zip(&block.samples) {
                    out[row] += kernel.at(&piece.signal, k);
                }
            }
        }
    }

    /// Takes the noise of an equation from the data where it is more than the sensors are said to have: half the
    /// energy of the differences of rows that follow each other, in which slow gaps leave little.
    pub fn raise_floor(&mut self, e: Equation, rms: f64) {
        let i = e.index();
        self.floor[i] = self.floor[i].max(rms);
        self.sensor_floor[i] = self.sensor_floor[i].max(rms);
    }

    /// Covariance of a nuisance's column with the left-hand side that noise alone makes, a row of an equation, in parts by the
    /// constant in whose column the noise stands. Columns that hold the same signal share its noise: were one corrected without
    /// the other, they would part along the direction that no data fix.
    pub fn shared_noise(&self, name: &str, e: usize) -> [(&'static str, f64); 2] {
        let torque = self.regressor_noise[e] * self.floor[e].powi(2);
        let (r, l) = (
            ("resistance", -self.current_noise.0),
            ("inductance", -self.current_noise.1),
        );
        const NONE: (&str, f64) = ("", 0.0);
        match (name, Equation::ALL[e]) {
            ("inertia", Equation::Torque | Equation::Kinematic) => [("inertia", torque), NONE],
            ("torque_constant" | "drive_gain", Equation::Torque | Equation::Kinematic) => [("inertia", -torque), NONE],
            ("resistance" | "drive_gain", Equation::Electrical) => [r, NONE],
            ("inductance" | "between_samples", Equation::Electrical) => [l, NONE],
            ("voltage_gain", Equation::Electrical) => [r, l],
            _ => [NONE; 2],
        }
    }

    /// Sine and cosine of a frequency in the rows of a block, as local columns.
    pub fn add_hum(&mut self, block: usize, f_hz: f64) {
        let b = self.blocks[block].clone();
        let w = std::f64::consts::TAU * f_hz / self.clock.rate_hz;
        for f in [f64::sin, f64::cos] {
            let mut c = vec![0.0; self.rows];
            for (row, &k) in b.rows.clone().zip(&b.samples) {
                c[row] = f(w * k as f64);
            }
            self.add_local(c, None);
        }
    }

    /// Least and greatest angle of all runs [rad].
    pub fn travel(&self) -> (f64, f64) {
        extent(self.signals.iter().flat_map(|s| &s.theta).copied())
    }

    /// Rows of an equation, run by run.
    pub fn blocks_of(&self, e: Equation) -> impl Iterator<Item = &Block> {
        self.blocks.iter().filter(move |b| b.equation == e)
    }

    /// How many rows an equation has.
    pub fn rows_of(&self, e: Equation) -> usize {
        self.blocks_of(e).map(|b| b.rows.len()).sum()
    }

    /// Samples in a row of the torque equation.
    pub fn group(&self) -> usize {
        self.mechanics.group()
    }

    /// rms of the sensors' noise in the rows of an equation.
    pub fn floor_of(&self, e: Equation) -> f64 {
        self.sensor_floor[e.index()]
    }

    /// One over the floor of each row's equation.
    pub fn weights(&self, sigma: &[f64; 5]) -> Vec<f64> {
        let mut w = vec![0.0; self.rows];
        for b in &self.blocks {
            w[b.rows.clone()].fill(1.0 / sigma[b.equation.index()]);
        }
        w
    }
}

/// What the supply's voltage does from one row to the next, by the middle of its differences [V].
fn supply_noise(bench: &Bench, runs: &[&Run], noise: &NoiseTable, window: usize) -> f64 {
    let (least, most) = if bench.has_phases() {
        SUPPLY_NOISE_V
    } else {
        let sensor = noise.get(&BenchChannel::VDc).map_or(0.0, |n| n.slow_rms()) / (window as f64).sqrt();
        let of = |share: f64| (share * bench.rig.supply_voltage).hypot(sensor).max(1e-9);
        (of(SUPPLY_NOISE.0), of(SUPPLY_NOISE.1))
    };
    let means = |x: &[f64]| -> Vec<f64> {
        let mean = |rows: &[f64]| rows.iter().sum::<f64>() / rows.len() as f64;
        x.chunks_exact(window).map(mean).collect()
    };
    let all = runs.iter().filter_map(|r| r.channel(BenchChannel::VDc));
    let mut steps: Vec<f64> = all
        .flat_map(|x| means(x).windows(2).map(|w| (w[1] - w[0]).abs()).collect::<Vec<_>>())
        .collect();
    steps.sort_by(f64::total_cmp);
    let middle = steps.get(steps.len() / 2).copied().unwrap_or(most);
    (middle / 0.6745 / 2f64.sqrt()).clamp(least, most)
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
