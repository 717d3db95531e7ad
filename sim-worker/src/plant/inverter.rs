//! Three-phase bridge (paper 3.1.2, "inverter block"): each leg is at plus or minus half the supply.

/// Leg voltage of one phase from its relay's state: `s Vs/2` in the unit of `half`.
///
/// * `h` state of the relay, whose sign is the output s
/// * `half` half the supply voltage, here times dt/L [A]
#[inline(always)]
pub fn leg_voltage(h: f64, half: f64) -> f64 {
    half.copysign(h)
}

/// Supply current `sum (s_q/2) i_q` [A]: the bridge has no losses and no dead time.
#[inline(always)]
pub fn supply_current(h: [f64; 3], i: [f64; 3]) -> f64 {
    0.5f64.copysign(h[0]) * i[0] + 0.5f64.copysign(h[1]) * i[1] + 0.5f64.copysign(h[2]) * i[2]
}
