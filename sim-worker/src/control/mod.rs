//! The sampled controller (paper 3.1.1 and the controller half of 3.1.2).
use std::hint::cold_path;

pub mod commutation;
pub mod hysteresis;
pub mod position;
pub mod speed;

/// `a` where `c`, else `b`: always a selection, never a branch (the relays decide unpredictably)
/// nor a choice between two addresses (which would become a gather over lanes).
#[inline(always)]
pub fn pick(c: bool, a: f64, b: f64) -> f64 {
    std::hint::select_unpredictable(c, a, b)
}

/// `x` limited to `low..high`. Over lanes (`ONE` false) one minimum and one maximum instruction;
/// for a single run branches, which the processor predicts, so that nothing waits for them.
#[inline(always)]
pub fn limit<const ONE: bool>(x: f64, low: f64, high: f64) -> f64 {
    if ONE {
        if x > high {
            cold_path();
            return high;
        }
        if x < low {
            cold_path();
            return low;
        }
        return x;
    }
    let y = if high < x { high } else { x };
    if low > y { low } else { y }
}
