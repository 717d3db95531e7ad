//! Exponential and logarithm by polynomial: the same bits on every machine and instruction set, and straight-line code that
//! the compiler can run over lanes, as [`crate::trig`].
//!
//! Reductions and coefficients of fdlibm (`e_exp.c`, `e_log.c`, Sun Microsystems 1993).

// the digits are those of fdlibm
#![allow(clippy::excessive_precision)]

use crate::trig::ROUND;

const LN2_HI: f64 = 6.931_471_803_691_238_164_90e-01;
const LN2_LO: f64 = 1.908_214_929_270_587_700_02e-10;
/// Bits of 1, and of one over the root of 2.
const ONE: u64 = 0x3ff0_0000_0000_0000;
const ROOT_HALF: u64 = 0x3fe6_a09e_667f_3bcd;

/// `e^x`; beyond -700 and 700 as there.
#[inline(always)]
pub fn exp(x: f64) -> f64 {
    let x = if x < -700.0 { -700.0 } else { x };
    let x = if x > 700.0 { 700.0 } else { x };
    let whole = x * std::f64::consts::LOG2_E + ROUND;
    let k = whole - ROUND;
    let (hi, lo) = (x - k * LN2_HI, k * LN2_LO);
    let r = hi - lo;
    let t = r * r;
    let c = r - t
        * (1.666_666_666_666_660_190_37e-01
            + t * (-2.777_777_777_701_559_338_42e-03
                + t * (6.613_756_321_437_934_361_17e-05
                    + t * (-1.653_390_220_546_525_153_90e-06 + t * 4.138_136_797_057_238_460_39e-08))));
    let y = 1.0 - ((lo - (r * c) / (2.0 - c)) - hi);
    // 2^k: adding 1.5 times 2^52 leaves k in the low bits of `whole`, and an exponent of k is a sum of bits
    y * f64::from_bits((whole.to_bits() << 52).wrapping_add(ONE))
}

/// Natural logarithm of a number above 1e-300; of a smaller one as of that.
#[inline(always)]
pub fn ln(x: f64) -> f64 {
    let x = if x > 1e-300 { x } else { 1e-300 };
    let bits = x.to_bits().wrapping_add(ONE - ROOT_HALF);
    let k = f64::from_bits((bits >> 52).wrapping_add(ROUND.to_bits())) - ROUND - 1023.0;
    let f = f64::from_bits((bits & 0x000f_ffff_ffff_ffff) + ROOT_HALF) - 1.0;
    let s = f / (2.0 + f);
    let z = s * s;
    let w = z * z;
    let even =
        w * (3.999_999_999_940_941_908e-01 + w * (2.222_219_843_214_978_396e-01 + w * 1.531_383_769_920_937_332e-01));
    let odd = z
        * (6.666_666_666_666_735_130e-01
            + w * (2.857_142_874_366_239_149e-01
                + w * (1.818_357_216_161_805_012e-01 + w * 1.479_819_860_511_658_591e-01)));
    let half = 0.5 * f * f;
    k * LN2_HI - ((half - (s * (half + odd + even) + k * LN2_LO)) - f)
}

/// `x^d` of a number of at least 0.
#[inline(always)]
pub fn power(x: f64, d: f64) -> f64 {
    exp(d * ln(x))
}

/// Hyperbolic tangent.
#[inline(always)]
pub fn tanh(x: f64) -> f64 {
    let e = exp(-2.0 * x.abs());
    ((1.0 - e) / (1.0 + e)).copysign(x)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn val_against_the_standard_library() {
        let near = |a: f64, b: f64| (a - b).abs() <= 4e-16 * b.abs().max(f64::MIN_POSITIVE);
        for k in 0..200_000 {
            let x = (k as f64 - 100_000.0) * 0.006_9;
            assert!(near(exp(x), x.exp()), "exp {x}");
            let y = x.exp();
            if y > 1e-299 {
                assert!((ln(y) - y.ln()).abs() <= 4e-16 * y.ln().abs().max(1.0), "ln {y}");
            }
            let z = x * 0.01;
            assert!((tanh(z) - z.tanh()).abs() < 4e-16, "tanh {z}");
        }
        for (x, d) in [(0.3, 2.0), (7.0, 0.5), (1.0, 3.0), (12.5, 1.247)] {
            assert!((power(x, d) / x.powf(d) - 1.0).abs() < 4e-15, "{x}^{d}");
        }
        // what stands still
        assert_eq!(exp(-power(0.0, 1.3)), 1.0);
        assert_eq!((exp(0.0), ln(1.0), tanh(0.0)), (1.0, 0.0, 0.0));
    }
}
