//! What a lookup table would still gain: structure that a model has left in its residual, judged on
//! data that the table has not seen.

use crate::equations::problem::{Block, Problem};
use crate::equations::signals::Signals;
use nalgebra::{DMatrix, DVector};
use sim_worker::effect::Equation;

/// Bins along one signal.
const BINS: usize = 14;
/// Prior rows for each column of the table: so many samples say "nothing".
const PRIOR_ROWS: f64 = 4.0;

/// Signals that a gap may depend on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Regressor {
    Speed,
    Position,
    Turn,
    Drive,
    Acceleration,
    Load,
    Temperature,
    Time,
}

impl Regressor {
    pub const ALL: [Self; 8] = [
        Self::Speed,
        Self::Position,
        Self::Turn,
        Self::Drive,
        Self::Acceleration,
        Self::Load,
        Self::Temperature,
        Self::Time,
    ];

    pub fn name(self) -> &'static str {
        match self {
            Self::Speed => "speed",
            Self::Position => "position",
            Self::Turn => "rotor angle within a turn",
            Self::Drive => "drive",
            Self::Acceleration => "acceleration",
            Self::Load => "load",
            Self::Temperature => "temperature",
            Self::Time => "time",
        }
    }

    pub fn unit(self) -> &'static str {
        match self {
            Self::Speed => "rad/s",
            Self::Position | Self::Turn => "rad",
            Self::Drive => "A",
            Self::Acceleration => "rad/s2",
            Self::Load => "N m",
            Self::Temperature => "degC",
            Self::Time => "s",
        }
    }

    pub fn value(self, s: &Signals, k: usize) -> f64 {
        match self {
            Self::Speed => s.omega[k],
            Self::Position => s.theta[k],
            Self::Turn => s.theta[k].rem_euclid(std::f64::consts::TAU),
            Self::Drive => s.drive[k],
            Self::Acceleration => s.accel[k],
            Self::Load => s.load[k],
            Self::Temperature => s.temperature.as_ref().map_or(0.0, |t| t[k]),
            Self::Time => k as f64 / s.rate_hz,
        }
    }
}

/// Bin edges of a regressor over the rows of an equation: equal counts.
pub fn edges(p: &Problem, e: Equation, r: Regressor, bins: usize) -> Vec<f64> {
    let mut all: Vec<f64> = p
        .blocks_of(e)
        .flat_map(|b| b.samples.iter().map(|&k| r.value(&p.signals[b.run], k)))
        .collect();
    all.sort_by(f64::total_cmp);
    let mut edges: Vec<f64> = (1..bins)
        .filter_map(|i| all.get(i * all.len() / bins).copied())
        .collect();
    edges.dedup();
    edges
}

pub fn bin(edges: &[f64], x: f64) -> usize {
    edges.partition_point(|e| *e <= x)
}

/// The table: additive in several signals, and in harmonics of the rotor angle with and without the
/// sign of the motion.
struct Table {
    edges: Vec<(Regressor, Vec<f64>, usize)>,
    columns: usize,
}

impl Table {
    /// * `with_drive` the drive channel is a signal of its own, not the left-hand side itself
    fn new(p: &Problem, e: Equation, with_drive: bool) -> Self {
        let mut columns = 0;
        let mut all = Vec::new();
        let signals = [
            Regressor::Speed,
            Regressor::Position,
            Regressor::Drive,
            Regressor::Acceleration,
            Regressor::Load,
            Regressor::Temperature,
        ];
        for r in signals.into_iter().filter(|r| with_drive || *r != Regressor::Drive) {
            let edges = edges(p, e, r, BINS);
            if edges.len() > 1 {
                let n = edges.len() + 1;
                all.push((r, edges, columns));
                columns += n;
            }
        }
        Self {
            edges: all,
            columns: columns + 24,
        }
    }

    /// The entries of one sample: column and value.
    fn entries(&self, s: &Signals, k: usize, out: &mut Vec<(usize, f64)>) {
        out.clear();
        for (r, edges, at) in &self.edges {
            out.push((at + bin(edges, r.value(s, k)), 1.0));
        }
        let at = self.columns - 24;
        for n in 1..=6 {
            let (sin, cos) = (n as f64 * s.theta[k]).sin_cos();
            let j = at + 4 * (n - 1);
            out.extend([
                (j, sin),
                (j + 1, cos),
                (j + 2, sin * s.sign[k]),
                (j + 3, cos * s.sign[k]),
            ]);
        }
    }
}

/// Energy that a table takes out of the residual of an equation on `held` after learning on `fit`
/// (negative where it only learns noise), in the unit of the equation squared times rows.
pub fn gained(
    fit: &Problem,
    residual: &[f64],
    held: &Problem,
    held_residual: &[f64],
    e: Equation,
    with_drive: bool,
) -> f64 {
    let table = Table::new(fit, e, with_drive);
    let n = table.columns;
    let mut gram = vec![0.0; n * n];
    let mut right = vec![0.0; n];
    let mut entries = Vec::new();
    let blocks = |p: &Problem| -> Vec<Block> { p.blocks_of(e).cloned().collect() };
    for b in blocks(fit) {
        for (row, &k) in b.rows.clone().zip(&b.samples) {
            table.entries(&fit.signals[b.run], k, &mut entries);
            for &(i, x) in &entries {
                right[i] += x * residual[row];
                for &(j, y) in &entries {
                    gram[i * n + j] += x * y;
                }
            }
        }
    }
    let mut gram = DMatrix::from_row_slice(n, n, &gram);
    for i in 0..n {
        gram[(i, i)] += PRIOR_ROWS / fit.independent[e.index()];
    }
    let Some(cholesky) = gram.cholesky() else { return 0.0 };
    let x = cholesky.solve(&DVector::from_vec(right));
    let mut gained = 0.0;
    for b in blocks(held) {
        for (row, &k) in b.rows.clone().zip(&b.samples) {
            table.entries(&held.signals[b.run], k, &mut entries);
            let told: f64 = entries.iter().map(|(i, v)| v * x[*i]).sum();
            let r = held_residual[row];
            gained += r * r - (r - told).powi(2);
        }
    }
    gained
}
