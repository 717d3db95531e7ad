//! Sine and cosine by polynomial: the same bits on every machine and instruction set, and
//! straight-line code that the compiler can run over lanes.
//!
//! Reduction after Cody and Waite (three parts of pi/2), kernels with the coefficients of
//! fdlibm (`k_sin.c`, `k_cos.c`, Sun Microsystems 1993). Error below 1e-15 for |x| < 1e5 rad.

// the digits are those of fdlibm
#![allow(clippy::excessive_precision)]

/// Adding and subtracting it rounds a value below 2^51 to the nearest integer.
pub(crate) const ROUND: f64 = 6_755_399_441_055_744.0;

/// Nearest integer (ties to even) for |x| < 2^51, without a library call.
#[inline(always)]
pub fn nearest(x: f64) -> f64 {
    (x + ROUND) - ROUND
}

/// `(sin x, cos x)` for `x` in rad.
#[inline(always)]
pub fn sin_cos(x: f64) -> (f64, f64) {
    const PIO2_1: f64 = 1.570_796_326_734_125_614_17;
    const PIO2_2: f64 = 6.077_100_506_303_965_976_60e-11;
    const PIO2_3: f64 = 2.022_266_248_795_950_631_54e-21;
    let n = nearest(x * std::f64::consts::FRAC_2_PI);
    let r = ((x - n * PIO2_1) - n * PIO2_2) - n * PIO2_3;
    let z = r * r;
    let s = r + r
        * z
        * (-1.666_666_666_666_663_243_48e-01
            + z * (8.333_333_333_322_489_461_24e-03
                + z * (-1.984_126_982_985_794_931_34e-04
                    + z * (2.755_731_370_707_006_767_89e-06
                        + z * (-2.505_076_025_340_686_341_95e-08 + z * 1.589_690_995_211_550_102_21e-10)))));
    let c = (1.0 - 0.5 * z)
        + z * z
            * (4.166_666_666_666_660_190_37e-02
                + z * (-1.388_888_888_887_410_957_49e-03
                    + z * (2.480_158_728_947_672_941_78e-05
                        + z * (-2.755_731_435_139_066_330_35e-07
                            + z * (2.087_572_321_298_174_827_90e-09 + z * -1.135_964_755_778_819_482_65e-11)))));
    // quadrant n mod 4, by arithmetic on the integer-valued n
    let half = nearest(n * 0.5 - 0.25); // floor(n/2) for integer n
    let odd = n - 2.0 * half;
    let quarter = nearest(half * 0.5 - 0.25);
    let upper = half - 2.0 * quarter;
    let (a, b) = if odd == 0.0 { (s, c) } else { (c, -s) };
    if upper == 0.0 { (a, b) } else { (-a, -b) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn val_sin_cos_against_the_standard_library() {
        let mut worst = 0.0_f64;
        for k in 0..400_000 {
            let x = (k as f64 - 200_000.0) * 0.004_37;
            let (s, c) = sin_cos(x);
            worst = worst.max((s - x.sin()).abs()).max((c - x.cos()).abs());
        }
        assert!(worst < 1e-15, "{worst:e}");
    }
}
