//! Samples that cannot be true: what a test must not be diagnosed from in silence.
//!
//! Streaming as the features are: the same verdicts whatever the size of the chunks. Limits are shares of what the
//! same window usually shows, so that they hold for any sensor.

/// How often the mean of its window a value must reach to be none of it (assumed; simulated tests at any fault, from
/// 1 to 10 kHz, come to 7).
const MOST_OVER_MEAN: f64 = 12.0;

/// Share of the mean size of the phase currents below which their sum is never suspect (assumed): resolution.
const LEAST_SUM: f64 = 0.1;

/// Share of the mean speed below which a jump of it is never suspect (assumed): resolution.
const LEAST_JUMP: f64 = 0.01;

/// A value that stands out of its window.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Outlier {
    /// sample, counted from 1
    pub sample: u64,
    /// its size, in the unit of the channel
    pub size: f64,
}

/// The greatest of many sizes beside their mean.
#[derive(Clone, Copy, Debug, Default)]
struct Greatest {
    seen: u64,
    sum: f64,
    worst: Option<Outlier>,
}

impl Greatest {
    fn push(&mut self, sample: u64, size: f64) {
        self.seen += 1;
        self.sum += size;
        if self.worst.is_none_or(|w| size > w.size) {
            self.worst = Some(Outlier { sample, size });
        }
    }

    /// The greatest, where it is beyond the others and `least`.
    fn outlier(&self, least: f64) -> Option<Outlier> {
        let limit = (MOST_OVER_MEAN * self.sum / self.seen as f64).max(least);
        self.worst.filter(|w| w.size > limit)
    }
}

/// The sum of the phase currents over a window: the star point has no way out, so that a spike or a dropout of one
/// phase stands out of it.
#[derive(Clone, Copy, Debug, Default)]
pub struct PhaseSum {
    sums: Greatest,
    size: f64,
}

impl PhaseSum {
    /// Takes the phase currents of a sample [A].
    pub fn push(&mut self, sample: u64, [a, b, c]: [f64; 3]) {
        self.sums.push(sample, (a + b + c).abs());
        self.size += a.abs() + b.abs() + c.abs();
    }

    /// A sample whose sum is not that of the others.
    pub fn outlier(&self) -> Option<Outlier> {
        let n = self.sums.seen as f64;
        self.sums.outlier(LEAST_SUM * self.size / n)
    }
}

/// Second differences of a signal over a window without commanded changes: a single sample that is off stands out.
#[derive(Clone, Copy, Debug, Default)]
pub struct Jumps {
    last: [f64; 2],
    seen: u64,
    size: f64,
    jumps: Greatest,
}

impl Jumps {
    /// Takes the next value.
    pub fn push(&mut self, sample: u64, x: f64) {
        if self.seen >= 2 {
            let jump = 0.5 * (self.last[0] - 2.0 * self.last[1] + x).abs();
            self.jumps.push(sample - 1, jump);
        }
        self.last = [self.last[1], x];
        self.seen += 1;
        self.size += x.abs();
    }

    /// A sample that jumps as no other does.
    pub fn outlier(&self) -> Option<Outlier> {
        self.jumps.outlier(LEAST_JUMP * self.size / self.seen as f64)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Three phase currents of amplitude 1 A with sensor noise of 0.02 A, 1000 samples.
    fn phases() -> Vec<[f64; 3]> {
        let mut state = 7u64;
        let mut noise = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
            ((state >> 11) as f64 / (1u64 << 53) as f64 - 0.5) * 0.07
        };
        let phase = |i: usize, k: usize| (i as f64 * 0.05 + k as f64 * std::f64::consts::TAU / 3.0).sin();
        (0..1000)
            .map(|i| std::array::from_fn(|k| phase(i, k) + noise()))
            .collect()
    }

    fn sum_of(rows: &[[f64; 3]]) -> PhaseSum {
        let mut sum = PhaseSum::default();
        for (x, sample) in rows.iter().zip(1..) {
            sum.push(sample, *x);
        }
        sum
    }

    #[test]
    fn val_one_spike_or_dropout_of_a_phase_stands_out_of_the_sum() {
        let rows = phases();
        assert_eq!(sum_of(&rows).outlier(), None);
        let mut spike = rows.clone();
        spike[416][1] += 5.0;
        let found = sum_of(&spike).outlier().unwrap();
        assert_eq!(found.sample, 417);
        assert!((found.size - 5.0).abs() < 0.2, "{found:?}");
        let mut dropout = rows.clone();
        dropout[31][0] = 0.0;
        assert_eq!(sum_of(&dropout).outlier().unwrap().sample, 32);
    }

    #[test]
    fn val_one_sample_off_stands_out_of_a_rippled_speed_and_resolution_does_not() {
        let speed = |i: usize| 300.0 + 5.0 * (i as f64 * 0.3).sin();
        let jumps = |off: f64, round: f64| {
            let mut j = Jumps::default();
            for i in 0..500 {
                let x = speed(i) + if i == 250 { off } else { 0.0 };
                j.push(i as u64 + 1, (x / round).round() * round);
            }
            j.outlier()
        };
        assert_eq!(jumps(0.0, 1e-3), None);
        assert_eq!(jumps(0.0, 3.0), None);
        let found = jumps(20.0, 1e-3).unwrap();
        assert_eq!(found.sample, 251);
        assert!((found.size - 20.0).abs() < 1.0, "{found:?}");
    }
}
