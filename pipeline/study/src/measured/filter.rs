//! Matched linear-phase filters. All signals of an equation go through the same low-pass, the
//! derivatives through the derivative of that low-pass, so that a balance that holds for the signals
//! holds for what is left of them.
//!
//! `h0` is a Gaussian, `h1` its derivative. `h0*h0`, `h0*h1` and `h1*h1` give value, first and second
//! derivative: `h1` has no gain at zero frequency, so a second derivative cannot leak a constant.

/// Reach of the Gaussian [standard deviations].
const REACH: f64 = 5.0;

/// A symmetric or antisymmetric kernel, applied as `y[k] = sum_j h[j] x[k + half - j]`.
#[derive(Clone, Debug)]
pub struct Kernel {
    h: Vec<f64>,
}

impl Kernel {
    /// Samples before and after the one in question that the kernel reaches.
    pub fn half(&self) -> usize {
        self.h.len() / 2
    }

    /// Standard deviation of the output for white noise of 1.
    pub fn noise_gain(&self) -> f64 {
        self.h.iter().map(|h| h * h).sum::<f64>().sqrt()
    }

    /// As [`Kernel::noise_gain`] for noise of the same rms whose correlation falls by `colour` from
    /// sample to sample (0 = white).
    pub fn noise_gain_of(&self, colour: f64) -> f64 {
        if colour == 0.0 {
            return self.noise_gain();
        }
        // sum over j, k of h[j] h[k] colour^|j - k|, by running sums
        let (mut before, mut sum) = (0.0, 0.0);
        for h in &self.h {
            sum += h * h + 2.0 * h * before;
            before = colour * (before + h);
        }
        sum.max(0.0).sqrt()
    }

    /// The value at sample `k`, which must be at least [`Kernel::half`] away from both ends.
    #[inline]
    pub fn at(&self, x: &[f64], k: usize) -> f64 {
        let half = self.half();
        let window = &x[k - half..=k + half];
        // four sums, so that the compiler may use vectors
        let mut sum = [0.0; 8];
        let (a, b) = (window.chunks_exact(8), self.h.chunks_exact(8));
        let rest: f64 = a.remainder().iter().zip(b.remainder()).map(|(x, h)| x * h).sum();
        for (x, h) in a.zip(b) {
            for l in 0..8 {
                sum[l] += x[l] * h[l];
            }
        }
        rest + sum.iter().sum::<f64>()
    }

    /// What passes this kernel but not a shorter one.
    pub fn beyond(&self, shorter: &Self) -> Self {
        let mut h = self.h.clone();
        let from = self.half() - shorter.half();
        for (h, s) in h[from..].iter_mut().zip(&shorter.h) {
            *h -= s;
        }
        Self { h }
    }

    fn convolved(&self, other: &Self) -> Self {
        let mut h = vec![0.0; self.h.len() + other.h.len() - 1];
        for (i, a) in self.h.iter().enumerate() {
            for (j, b) in other.h.iter().enumerate() {
                h[i + j] += a * b;
            }
        }
        Self { h }
    }
}

/// Value, first and second derivative of one low-pass.
#[derive(Clone, Debug)]
pub struct FilterBank {
    /// value, first derivative [1/s], second derivative [1/s2]
    pub order: [Kernel; 3],
}

impl FilterBank {
    /// * `corner_hz` where `h0*h0` has lost 3 dB
    /// * `shift_s` the signal is late by this: the kernels look ahead
    pub fn new(corner_hz: f64, rate_hz: f64, shift_s: f64) -> Self {
        // |H0|^2 = exp(-(sigma w)^2)
        let sigma = (0.5 * std::f64::consts::LN_2).sqrt() / (std::f64::consts::TAU * corner_hz) * rate_hz;
        Self::of_sigma(sigma, rate_hz, shift_s)
    }

    fn of_sigma(sigma: f64, rate_hz: f64, shift_s: f64) -> Self {
        let shift = shift_s * rate_hz;
        let whole = (REACH * sigma + shift.abs()).ceil() as i64;
        let gaussian = |shift: f64, reach: i64| -> (Vec<f64>, Vec<f64>) {
            // window position j is sample k + reach - j ... stored in the order of the window
            let t: Vec<f64> = (-reach..=reach).map(|j| (j as f64 - shift) / sigma).collect();
            let mut h0: Vec<f64> = t.iter().map(|t| (-0.5 * t * t).exp()).collect();
            let sum: f64 = h0.iter().sum();
            h0.iter_mut().for_each(|h| *h /= sum);
            // correlation with the derivative: d/dt of the smoothed signal
            let mut h1: Vec<f64> = h0.iter().zip(&t).map(|(h, t)| h * t / sigma * rate_hz).collect();
            let mean = h1.iter().sum::<f64>();
            h1.iter_mut().zip(&h0).for_each(|(h, g)| *h -= mean * g);
            let gain: f64 = h1.iter().zip(&t).map(|(h, t)| h * t * sigma / rate_hz).sum();
            h1.iter_mut().for_each(|h| *h /= gain);
            (h0, h1)
        };
        let (a0, a1) = gaussian(shift, whole);
        let (b0, b1) = gaussian(0.0, whole);
        let kernel = |h: &Vec<f64>| Kernel { h: h.clone() };
        let h0h0 = kernel(&a0).convolved(&kernel(&b0));
        let h0h1 = kernel(&a0).convolved(&kernel(&b1));
        let h1h1 = kernel(&a1).convolved(&kernel(&b1));
        Self {
            order: [h0h0, h0h1, h1h1],
        }
    }

    /// Lets values pass as they are and knows no derivatives: for samples that do not follow each other.
    pub fn identity() -> Self {
        let kernel = |h: f64| Kernel { h: vec![h] };
        Self {
            order: [kernel(1.0), kernel(0.0), kernel(0.0)],
        }
    }

    /// A light smoother: `h0*h0` with a standard deviation of `sigma` samples in all.
    pub fn smoother(sigma: f64, rate_hz: f64, shift_s: f64) -> Self {
        let each = sigma / std::f64::consts::SQRT_2;
        Self::of_sigma(each, rate_hz, shift_s)
    }

    pub fn half(&self) -> usize {
        self.order[0].half()
    }

    /// Filtered signal at every sample; the ends are held.
    pub fn whole(&self, order: usize, x: &[f64]) -> Vec<f64> {
        let half = self.half();
        let n = x.len();
        if n == 0 {
            return Vec::new();
        }
        // a straight line beyond the ends, so that derivatives stay what they are
        let reach = half.min(n - 1).max(1);
        let slope_a = (x[reach.min(n - 1)] - x[0]) / reach as f64;
        let slope_b = (x[n - 1] - x[n - 1 - reach.min(n - 1)]) / reach as f64;
        let mut wide = Vec::with_capacity(n + 2 * half);
        wide.extend((1..=half).rev().map(|j| x[0] - slope_a * j as f64));
        wide.extend_from_slice(x);
        wide.extend((1..=half).map(|j| x[n - 1] + slope_b * j as f64));
        (0..n).map(|k| self.order[order].at(&wide, k + half)).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_second_derivative_leaks_no_constant_and_no_slope() {
        let bank = FilterBank::new(50.0, 1000.0, 0.0);
        let x: Vec<f64> = (0..200).map(|k| 7.0 + 3.0 * k as f64 / 1000.0).collect();
        let k = 100;
        assert!((bank.order[0].at(&x, k) - x[k]).abs() < 1e-12);
        assert!((bank.order[1].at(&x, k) - 3.0).abs() < 1e-9);
        assert!(bank.order[2].at(&x, k).abs() < 1e-7);
    }

    #[test]
    fn derivatives_are_those_of_the_filtered_signal() {
        let (rate, f) = (1000.0, 30.0);
        let w = std::f64::consts::TAU * f;
        let x: Vec<f64> = (0..400).map(|k| (w * k as f64 / rate).sin()).collect();
        let bank = FilterBank::new(50.0, rate, 0.0);
        let gain = (-(f / 50.0_f64).powi(2) * 0.5 * std::f64::consts::LN_2).exp();
        for k in [150, 163, 200] {
            let p = w * k as f64 / rate;
            assert!((bank.order[0].at(&x, k) - gain * p.sin()).abs() < 1e-6);
            assert!((bank.order[1].at(&x, k) - gain * w * p.cos()).abs() < 1e-4 * w);
            assert!((bank.order[2].at(&x, k) + gain * w * w * p.sin()).abs() < 1e-4 * w * w);
        }
    }

    #[test]
    fn coloured_noise_passes_as_its_spectrum_says() {
        let kernel = &FilterBank::new(50.0, 1000.0, 0.0).order[0];
        let r: f64 = 0.6;
        let direct: f64 = (0..kernel.h.len())
            .flat_map(|j| (0..kernel.h.len()).map(move |k| (j, k)))
            .map(|(j, k)| kernel.h[j] * kernel.h[k] * r.powi(j.abs_diff(k) as i32))
            .sum();
        assert!((kernel.noise_gain_of(r) - direct.sqrt()).abs() < 1e-12);
        // slow noise of the same rms leaves twice as much and more
        assert!(kernel.noise_gain_of(r) > 1.8 * kernel.noise_gain());
    }

    #[test]
    fn a_late_signal_is_brought_back() {
        let rate = 1000.0;
        let at = |t: f64| (120.0 * t).sin();
        let late: Vec<f64> = (0..300).map(|k| at(k as f64 / rate - 0.0005)).collect();
        let prompt: Vec<f64> = (0..300).map(|k| at(k as f64 / rate)).collect();
        let a = FilterBank::new(60.0, rate, 0.0005);
        let b = FilterBank::new(60.0, rate, 0.0);
        for order in 0..3 {
            let (x, y) = (a.order[order].at(&late, 150), b.order[order].at(&prompt, 150));
            assert!((x - y).abs() < 1e-3 * (1.0 + y.abs()), "{order}: {x} {y}");
        }
    }
}
