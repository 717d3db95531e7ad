//! Regions of the fault plane: quarters of FSJ 1 to 5 by quarters of zeta 0 to 0.5.

use super::numbers;
use polars::prelude::Column;

const FSJ: [f64; 5] = [1.0, 2.0, 3.0, 4.0, 5.0];
const ZETA: [f64; 5] = [0.0, 0.125, 0.25, 0.375, 0.5];

/// Number of regions.
pub const COUNT: usize = 16;

/// Region of a pair; the outermost ones go on without end. `None` without numbers.
pub fn of(fsj: f64, zeta: f64) -> Option<usize> {
    let place = |x: f64, edges: &[f64; 5]| edges[1..4].iter().filter(|e| x >= **e).count();
    (!fsj.is_nan() && !zeta.is_nan()).then(|| 4 * place(zeta, &ZETA) + place(fsj, &FSJ))
}

/// The columns `fsj_from`, `fsj_to`, `zeta_from`, `zeta_to` of the regions of the rows.
pub fn columns(regions: &[usize]) -> [Column; 4] {
    let column = |name, edge: fn(usize) -> f64| numbers(name, regions.iter().map(|&r| edge(r)));
    [
        column("fsj_from", |r| FSJ[r % 4]),
        column("fsj_to", |r| FSJ[r % 4 + 1]),
        column("zeta_from", |r| ZETA[r / 4]),
        column("zeta_to", |r| ZETA[r / 4 + 1]),
    ]
}
