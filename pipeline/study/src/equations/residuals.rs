//! What a residual's rows come to: energies, beside those of the noise, from row to row and in means over some time.

use crate::equations::problem::Problem;
use crate::equations::signals::Signals;
use sim_worker::effect::Equation;

/// Length of the pieces whose quieter half says what the noise is [s], their least rows and number, and what the mean of all may be over
/// it (all assumed).
const PIECE_S: f64 = 0.05;
const LEAST_ROWS: f64 = 10.0;
const LEAST_PIECES: usize = 20;
const QUIETLY: f64 = 1.06;

impl Problem {
    /// Noise of an equation's rows by the differences of those that follow each other.
    pub fn by_differences(&self, residual: &[f64], e: Equation) -> f64 {
        self.between(residual, e, 0.0).map_or(0.0, f64::sqrt)
    }

    /// Rows in a second of an equation.
    pub fn row_rate_hz(&self, e: Equation) -> f64 {
        match e {
            Equation::Torque | Equation::Kinematic => self.clock.rate_hz / self.group() as f64,
            Equation::Electrical => self.clock.rate_hz / self.window as f64,
            _ => self.clock.rate_hz / self.clock.stride as f64,
        }
    }

    /// Means of the residual over `seconds`, block after block, times the root of their rows: of white noise as great as
    /// a row.
    fn block_means(&self, residual: &[f64], e: Equation, seconds: f64) -> impl Iterator<Item = Vec<f64>> {
        let m = ((seconds * self.row_rate_hz(e)) as usize).max(1);
        let mean = move |rows: &[f64]| rows.iter().sum::<f64>() / (m as f64).sqrt();
        self.blocks_of(e)
            .map(move |b| residual[b.rows.clone()].chunks_exact(m).map(mean).collect())
    }

    /// Energy over that of the sensors' noise, a row, of what is left in means over `seconds`: slow torques stay,
    /// what a sensor's grain makes at a steady speed does not.
    pub fn slow_energy(&self, residual: &[f64], e: Equation, seconds: f64) -> f64 {
        let (mut sum, mut count) = (0.0, 0.0);
        for means in self.block_means(residual, e, seconds) {
            sum += means.iter().map(|x| x * x).sum::<f64>();
            count += means.len() as f64;
        }
        let floor = self.sensor_floor[e.index()].powi(2);
        if count > 0.0 { sum / count / floor } else { 0.0 }
    }

    /// As [`Problem::slow_energy`], of half the squared difference of neighbouring means, but not below the sensors': what
    /// noise of any colour makes that is shorter than `seconds`, and of slow torques next to nothing.
    pub fn unrest(&self, residual: &[f64], e: Equation, seconds: f64) -> f64 {
        let floor = self.sensor_floor[e.index()].powi(2);
        self.between(residual, e, seconds).map_or(1.0, |x| (x / floor).max(1.0))
    }

    /// Mean of half the squared difference of neighbouring means over `seconds`; of rows for 0. `None` without any.
    fn between(&self, residual: &[f64], e: Equation, seconds: f64) -> Option<f64> {
        let (mut sum, mut count) = (0.0, 0.0);
        for means in self.block_means(residual, e, seconds) {
            for w in means.windows(2) {
                sum += 0.5 * (w[1] - w[0]).powi(2);
                count += 1.0;
            }
        }
        (count > 0.0).then(|| sum / count)
    }

    /// Noise of the torque beyond what the sensors are said to have, rms [N m], by the differences of rows.
    pub fn unresolved(&self, residual: &[f64]) -> f64 {
        let (noise, share) = self.torque_noise;
        let seen = self.by_differences(residual, Equation::Torque) / self.floor[Equation::Torque.index()].max(1e-300);
        if share > 0.0 && seen * seen > 1.05 {
            ((seen * seen - 1.0) / share).sqrt() * noise
        } else {
            0.0
        }
    }

    /// rms of the rows of an equation whose energy is given.
    pub fn rms(&self, e: Equation, energy: &[f64; 5]) -> f64 {
        (energy[e.index()] / self.rows_of(e).max(1) as f64).sqrt()
    }

    /// Energy of the sensors' noise in the rows of an equation.
    pub fn sensor_energy(&self, e: usize) -> f64 {
        self.rows_of(Equation::ALL[e]) as f64 * self.sensor_floor[e].powi(2)
    }

    /// Whether the torque is on time in all runs.
    pub fn on_time(&self) -> bool {
        self.signals.iter().all(Signals::on_time)
    }

    /// The piece of time, the equation and the number of each row: a piece is of one run.
    pub fn in_pieces(&self, seconds: f64) -> impl Iterator<Item = ((usize, usize), usize, usize)> {
        let length = self.clock.block(seconds);
        self.blocks.iter().flat_map(move |b| {
            let rows = b.rows.clone().zip(&b.samples);
            rows.map(move |(row, k)| ((b.run, k / length), b.equation.index(), row))
        })
    }

    /// Energy of the noise in the rows of an equation as the quieter half of short pieces has it, but not above that of the sensors':
    /// where these are better than they are said to be, what only few moments show stands out of it. Where the torque is not on time
    /// it is that of the sensors: there a channel that is a little late stands out of the quieter half as well.
    pub fn quiet_energy(&self, residual: &[f64], e: Equation) -> f64 {
        let most = self.sensor_energy(e.index());
        if !self.on_time() {
            return most;
        }
        let mut pieces: std::collections::BTreeMap<(usize, usize), (f64, f64)> = Default::default();
        for (piece, _, row) in self.in_pieces(PIECE_S).filter(|x| x.1 == e.index()) {
            let sum = pieces.entry(piece).or_default();
            *sum = (sum.0 + residual[row].powi(2), sum.1 + 1.0);
        }
        let mut each: Vec<f64> = pieces
            .values()
            .filter(|s| s.1 >= LEAST_ROWS)
            .map(|s| s.0 / s.1)
            .collect();
        if each.len() < LEAST_PIECES {
            return most;
        }
        let middle = each.len() / 2;
        let quiet = *each.select_nth_unstable_by(middle, f64::total_cmp).1;
        most.min(QUIETLY * quiet * self.rows_of(e) as f64)
    }

    /// Torque that the model does not have, rms [N m], by the energy that it leaves: with it, the rows are as
    /// large as the filter expects.
    pub fn excess_left(&self, energy: &[f64; 5]) -> f64 {
        let n = self.rows_of(Equation::Torque) as f64;
        let (noise, share) = self.torque_noise;
        if n == 0.0 || share <= 0.0 {
            return 0.0;
        }
        let over = energy[Equation::Torque.index()] / (n * self.floor[Equation::Torque.index()].powi(2)) - 1.0;
        let left = self.excess.powi(2) + over / share * noise * noise;
        // what is within the statistics of the noise is none
        if left < 0.1 * noise * noise && over < 0.05 {
            0.0
        } else {
            left.max(0.0).sqrt()
        }
    }

    /// rms of the voltages of three phases [V]; `None` where none is recorded.
    pub fn phase_volts(&self) -> Option<f64> {
        let voltages = self.signals.iter().filter_map(|s| s.phases.as_ref()?.voltage.as_ref());
        let (mut squares, mut count) = (0.0, 0);
        for v in voltages.flatten() {
            squares += v.iter().map(|x| x * x).sum::<f64>();
            count += v.len();
        }
        (count > 0).then(|| (squares / count as f64).sqrt())
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
