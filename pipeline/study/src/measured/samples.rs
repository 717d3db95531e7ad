//! What a signal does between its samples.

/// Derivative of a signal by its neighbours [1/s], one-sided at the ends.
pub fn rate_of(x: &[f64], rate_hz: f64) -> impl Iterator<Item = f64> {
    (0..x.len()).map(move |k| {
        let (a, b) = (k.saturating_sub(1), (k + 1).min(x.len() - 1));
        (x[b] - x[a]) * rate_hz / (b - a).max(1) as f64
    })
}

/// A signal between the samples `k` and `k + 1`: the cubic with the slopes of the central differences (Catmull and Rom, 1974).
/// A straight line loses `(w T)^2 / 12` of a sine.
pub fn between(x: &[f64], k: usize, share: f64) -> f64 {
    let Some((&a, &b)) = x.get(k).zip(x.get(k + 1)) else {
        return x[k];
    };
    // at the ends a parabola through the three nearest, or the line through two
    let (before, after) = match (k.checked_sub(1).map(|i| x[i]), x.get(k + 2)) {
        (Some(before), Some(&after)) => (before, after),
        (Some(before), None) => (before, 3.0 * (b - a) + before),
        (None, Some(&after)) => (3.0 * (a - b) + after, after),
        (None, None) => (2.0 * a - b, 2.0 * b - a),
    };
    let (u, v) = (share, 1.0 - share);
    a + u * (b - a) + 0.5 * u * v * (v * (2.0 * a - b - before) - u * (a - 2.0 * b + after))
}

/// The same, `shift` samples later at every sample, from 0 to 1.
pub fn later(x: &[f64], shift: f64) -> Vec<f64> {
    if shift == 0.0 {
        return x.to_vec();
    }
    (0..x.len()).map(|k| between(x, k, shift)).collect()
}

/// A signal that many whole samples later; the ends are held.
pub fn moved(x: &[f64], samples: i64) -> Vec<f64> {
    let last = x.len() as i64 - 1;
    (0..x.len() as i64)
        .map(|k| x[(k + samples).clamp(0, last) as usize])
        .collect()
}

/// As [`later`], of any sign and length.
pub fn sharp(x: &[f64], shift: f64) -> Vec<f64> {
    let whole = (shift + 1e-9).floor();
    let share = shift - whole;
    later(&moved(x, whole as i64), if share < 1e-9 { 0.0 } else { share })
}

/// A smoothed signal with what the smoother takes from it given back, up to the fourth power of the frequency: of a sine that was
/// left three quarters, 99 %.
///
/// * `deviation` of the smoother [samples]
pub fn sharpened(x: &[f64], deviation: f64) -> Vec<f64> {
    let n = x.len();
    if deviation == 0.0 || n < 3 {
        return x.to_vec();
    }
    let bend = |x: &[f64]| -> Vec<f64> {
        let at = |k: usize| x[k - 1] - 2.0 * x[k] + x[k + 1];
        (0..n).map(|k| if k == 0 || k + 1 == n { 0.0 } else { at(k) }).collect()
    };
    let half = 0.5 * deviation * deviation;
    let (second, fourth) = (bend(x), bend(&bend(x)));
    let given = second.iter().zip(&fourth).map(|(d2, d4)| half * (0.5 * half * d4 - d2));
    x.iter().zip(given).map(|(x, g)| x + g).collect()
}

/// Straight interpolation of `x` at `shift` samples later.
pub fn shifted(x: &[f64], shift: f64) -> Vec<f64> {
    if shift.abs() < 1e-9 {
        return x.to_vec();
    }
    let last = x.len() - 1;
    (0..x.len())
        .map(|k| {
            let at = (k as f64 + shift).clamp(0.0, last as f64);
            let i = (at as usize).min(last - 1);
            x[i] + (at - i as f64) * (x[i + 1] - x[i])
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::measured::filter::FilterBank;

    #[test]
    fn a_sine_that_was_smoothed_comes_back() {
        // 150 Hz at 2 kHz, as far as springs of small drives swing
        let step = std::f64::consts::TAU * 150.0 / 2000.0;
        let sine: Vec<f64> = (0..400).map(|k| (step * f64::from(k)).sin()).collect();
        let smooth = FilterBank::smoother(1.5, 2000.0, 0.0).whole(0, &sine);
        let back = sharpened(&smooth, 1.5);
        let far = |x: &[f64]| (100..300).map(|k| (x[k] - sine[k]).abs()).fold(0.0, f64::max);
        assert!(
            far(&smooth) > 0.2 && far(&back) < 0.012,
            "{} {}",
            far(&smooth),
            far(&back)
        );
        assert_eq!(sharpened(&sine, 0.0), sine);
    }

    #[test]
    fn a_parabola_is_met_between_its_samples() {
        let of = |t: f64| 3.0 - 2.0 * t + 0.5 * t * t;
        let x: Vec<f64> = (0..6).map(|k| of(f64::from(k))).collect();
        for k in 0..5 {
            for share in [0.0, 0.25, 0.5, 1.0] {
                let off = between(&x, k, share) - of(k as f64 + share);
                assert!(off.abs() < 1e-12, "{k} {share}: {off}");
            }
        }
        assert_eq!(between(&x, 5, 0.5), x[5]);
        assert_eq!(between(&[1.0, 3.0], 0, 0.5), 2.0);
    }
}
