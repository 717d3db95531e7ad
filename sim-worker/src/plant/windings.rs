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

/// As [`step`] with phases of different numbers of turns, whose resistance and inductance go
/// together (part of the turns is shorted): the star point weighs them.
///
/// * `k` back-EMF coefficients of the turns that are left
/// * `more` nominal turns over those left, of each phase; `even` one over their sum
#[inline(always)]
pub fn uneven_step(i: [f64; 2], v: [f64; 3], k: [f64; 3], w: f64, decay: f64, more: [f64; 3], even: f64) -> [f64; 2] {
    let u = [v[0] - k[0] * w, v[1] - k[1] * w, v[2] - k[2] * w];
    let n = (more[0] * u[0] + more[1] * u[1] + more[2] * u[2]) * even;
    [decay * i[0] + more[0] * (u[0] - n), decay * i[1] + more[1] * (u[1] - n)]
}
