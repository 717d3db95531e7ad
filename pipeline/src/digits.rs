//! How many digits of a number are told: those that its uncertainty leaves.

/// Most decimal places that are told of anything.
const MOST: usize = 9;

/// Decimal places of two significant digits of an interval's half-width.
pub fn places(half_width: f64) -> usize {
    let half_width = half_width.abs();
    if !half_width.is_finite() {
        return 2;
    }
    // a hundred-thousandth more, so that 0.1 is not told apart from 0.0999999
    let decade = (half_width.max(1e-12) * 1.00001).log10().floor();
    (1.0 - decade).clamp(0.0, MOST as f64) as usize
}

/// A number to as many decimal places as an interval of this half-width leaves.
pub fn fixed(x: f64, half_width: f64) -> String {
    format!("{x:.*}", places(half_width))
}

/// The same with an exponent; seven digits at most, and where there is no half-width.
pub fn scientific(x: f64, half_width: f64) -> String {
    let decade = |v: f64| (v.abs() * 1.00001).log10().floor();
    let digits = decade(x) - decade(half_width) + 1.0;
    let digits = if digits.is_finite() {
        digits.clamp(0.0, 6.0)
    } else {
        6.0
    };
    format!("{x:.*e}", digits as usize)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn two_digits_of_the_half_width_are_told() {
        assert_eq!(fixed(2.998_123, 0.00505), "2.9981");
        assert_eq!(fixed(0.300_041_7, 0.000_545), "0.30004");
        assert_eq!(fixed(2.998_123, 0.073), "2.998");
        assert_eq!(fixed(2.998_123, 0.1), "3.00");
        assert_eq!(fixed(2.998_123, 25.0), "3");
        assert_eq!(fixed(1.0, f64::NAN), "1.00");
        assert_eq!(fixed(1.0, 0.0), "1.000000000");
    }

    #[test]
    fn exponents_keep_to_it_too() {
        assert_eq!(scientific(5.306_955e-2, 2.6e-4), "5.307e-2");
        assert_eq!(scientific(2.920_940, 5.1e-2), "2.921e0");
        assert_eq!(scientific(2.920_940, 25.0), "3e0");
        assert_eq!(scientific(5.306_955e-2, f64::NAN), "5.306955e-2");
        assert_eq!(scientific(0.0, 1e-3), "0.000000e0");
    }
}
