//! Hysteresis current control: a relay with memory (paper 3.1.2, "PWM block").

/// New state of the relay: `+HB` for output +1, `-HB` for output -1.
///
/// * `reference` phase current reference [A]
/// * `margin` relay state minus measured phase current, `h - i` [A]
/// * `hb` half-band HB [A]
///
/// Output +1 falls to -1 where `reference - i < -HB`, -1 rises to +1 where `reference - i > HB`;
/// both are the sign of `reference - i + h`. (The paper says both "off inside the band" and "six
/// gates from three Booleans and their negations"; the relay with memory satisfies the second.)
#[inline(always)]
pub fn relay(reference: f64, margin: f64, hb: f64) -> f64 {
    hb.copysign(reference + margin)
}
