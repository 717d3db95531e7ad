//! What the sensor noise alone allows at a fault pair: the linearised maps inverted.

use crate::failure_map::FailureMapSet;
use nalgebra::{Matrix2, Vector2};

/// Standard deviations of (FSJ, zeta) at a fault pair when every map is weighted with its sensor
/// noise: the square roots of the diagonal of `(J^T W J)^-1`, J the slopes of the maps. `None`
/// where the maps cannot tell the two faults apart or carry no noise.
pub fn noise_sigma(set: &FailureMapSet, fsj: f64, zeta: f64) -> Option<(f64, f64)> {
    let mut information = Matrix2::zeros();
    for m in set.joint() {
        let (nf, nz) = (m.fsj.len(), m.zeta.len());
        let df = 1e-3 * (m.fsj[nf - 1] - m.fsj[0]);
        let dz = 1e-3 * (m.zeta[nz - 1] - m.zeta[0]);
        // both ends inside the map
        let f = fsj.clamp(m.fsj[0] + df, m.fsj[nf - 1] - df);
        let z = zeta.clamp(m.zeta[0] + dz, m.zeta[nz - 1] - dz);
        let slope = Vector2::new(
            (m.at(f + df, z) - m.at(f - df, z)) / (2.0 * df),
            (m.at(f, z + dz) - m.at(f, z - dz)) / (2.0 * dz),
        );
        let sigma = m.budget.noise;
        if sigma > 0.0 {
            information += slope * slope.transpose() / (sigma * sigma);
        }
    }
    let covariance = information.try_inverse()?;
    let (f, z) = (covariance[(0, 0)], covariance[(1, 1)]);
    (f.is_finite() && z.is_finite() && f > 0.0 && z > 0.0).then(|| (f.sqrt(), z.sqrt()))
}
