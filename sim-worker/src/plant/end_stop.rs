//! Physical end stops (paper 3.1.3).

/// `(position, speed)` after the stops: past `±stop` the position is set back to it and the
/// outward speed to 0. Position and stop in the same unit.
#[inline(always)]
pub fn stop(x: f64, w: f64, stop: f64) -> (f64, f64) {
    let (x1, w1) = if x > stop {
        (stop, if w > 0.0 { 0.0 } else { w })
    } else {
        (x, w)
    };
    if x1 < -stop {
        (-stop, if w1 < 0.0 { 0.0 } else { w1 })
    } else {
        (x1, w1)
    }
}
