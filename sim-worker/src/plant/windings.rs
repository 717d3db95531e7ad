//! Three RL phases with a floating star point (paper 3.1.2, "phase currents calculation block").

/// One explicit Euler step of `L di_q/dt = v_q - v_n - k_q w - R i_q` with the star point
/// `v_n = mean(v - k w - R i)`. Returns the new currents of phases 0 and 1; the third is minus
/// their sum.
///
/// * `i` currents of phases 0 and 1
/// * `v` leg voltages times dt/L, in the unit of the currents
/// * `k` back-EMF coefficients, `w` motor speed: their product is a voltage times dt/L
/// * `decay` `1 - R dt/L`
///
/// The currents of a floating star add to zero, so `mean(R i)` is left out of the star point.
#[inline(always)]
pub fn step(i: [f64; 2], v: [f64; 3], k: [f64; 3], w: f64, decay: f64) -> [f64; 2] {
    let e = [k[0] * w, k[1] * w, k[2] * w];
    let n = ((v[0] + v[1]) + (v[2] - (e[0] + e[1] + e[2]))) * (1.0 / 3.0);
    [(decay * i[0] - e[0] + v[0]) - n, (decay * i[1] - e[1] + v[1]) - n]
}
