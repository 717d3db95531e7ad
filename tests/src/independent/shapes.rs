//! Back-EMF and reference shapes over the electrical turn, piecewise linear.

/// Back-EMF shape over an electrical turn, the angle in twelfths of a turn, 0 <= x < 12.
#[inline]
pub(super) fn trap(x: f64) -> f64 {
    if x < 1.0 {
        x
    } else if x < 5.0 {
        1.0
    } else if x < 7.0 {
        6.0 - x
    } else if x < 11.0 {
        -1.0
    } else {
        x - 12.0
    }
}

/// Share of the current demand that a phase gets, the angle as in [`trap`].
#[inline]
pub(super) fn rect(x: f64) -> f64 {
    if (1.0..5.0).contains(&x) {
        1.0
    } else if (7.0..11.0).contains(&x) {
        -1.0
    } else {
        0.0
    }
}

/// The three phases' angles in twelfths of an electrical turn, each in 0..12.
#[inline]
pub(super) fn twelfths(electrical: f64) -> [f64; 3] {
    let turns = electrical * (1.0 / std::f64::consts::TAU);
    let mut fraction = turns - (turns as i64) as f64;
    if fraction < 0.0 {
        fraction += 1.0;
    }
    let a = fraction * 12.0;
    let a = if a >= 12.0 { a - 12.0 } else { a };
    let b = if a < 4.0 { a + 8.0 } else { a - 4.0 };
    let c = if a < 8.0 { a + 4.0 } else { a - 8.0 };
    [a, b, c]
}
