//! Feature surfaces on a lattice and the joint test on them.
use super::{MOST, Row, dot, lerp};

/// One node on one cache line.
#[derive(Clone, Copy, Debug)]
#[repr(align(64))]
struct Node(Row);

/// Feature surfaces on a rectangular lattice, bilinear inside a cell and monotone along both axes.
#[derive(Clone, Debug)]
pub struct Lattice {
    /// FSJ of the columns [-], strictly rising.
    pub fsj: Vec<f64>,
    /// zeta of the rows [-], strictly rising.
    pub zeta: Vec<f64>,
    nodes: Vec<Node>,
    directions: [(f64, f64); MOST],
    /// Largest magnitude of each surface, the scale of its rounding.
    pub(super) peak: Row,
}

impl Lattice {
    /// `nodes[zeta_index * fsj.len() + fsj_index]`; `directions` are +1 or -1 along (FSJ, zeta) for each feature.
    /// A node that breaks its direction is lifted to the running maximum.
    ///
    /// # Errors
    /// Refuses axes that do not rise, a wrong number of nodes and numbers that are not finite.
    pub fn new(
        fsj: Vec<f64>,
        zeta: Vec<f64>,
        nodes: Vec<Row>,
        directions: [(f64, f64); MOST],
    ) -> Result<Self, &'static str> {
        let rising = |axis: &[f64]| axis.len() > 1 && axis.windows(2).all(|p| p[0] < p[1]);
        if !rising(&fsj) || !rising(&zeta) {
            return Err("lattice axes must rise strictly and hold two nodes at least");
        }
        if nodes.len() != fsj.len() * zeta.len() {
            return Err("lattice needs one node for each pair of FSJ and zeta");
        }
        if !nodes.iter().flatten().chain(&fsj).chain(&zeta).all(|x| x.is_finite()) {
            return Err("lattice values must be finite");
        }
        let mut nodes: Vec<Node> = nodes.into_iter().map(Node).collect();
        let (n, rows) = (fsj.len(), zeta.len());
        let mut peak = [0.0; MOST];
        for (i, &(df, dz)) in directions.iter().enumerate() {
            let index = |col: usize, row: usize| {
                (if dz < 0.0 { rows - 1 - row } else { row }) * n + if df < 0.0 { n - 1 - col } else { col }
            };
            for row in 0..rows {
                for col in 0..n {
                    let mut value = nodes[index(col, row)].0[i];
                    if col > 0 {
                        value = value.max(nodes[index(col - 1, row)].0[i]);
                    }
                    if row > 0 {
                        value = value.max(nodes[index(col, row - 1)].0[i]);
                    }
                    nodes[index(col, row)].0[i] = value;
                    peak[i] = value.abs().max(peak[i]);
                }
            }
        }
        Ok(Self {
            fsj,
            zeta,
            nodes,
            directions,
            peak,
        })
    }

    /// Direction of each surface along (FSJ, zeta), +1 or -1.
    pub fn directions(&self) -> &[(f64, f64); MOST] {
        &self.directions
    }

    /// Row at FSJ `f` [-] and zeta `z` [-], held constant beyond the lattice.
    pub fn at(&self, f: f64, z: f64) -> Row {
        let cell = |axis: &[f64], x: f64| axis.partition_point(|&a| a <= x).clamp(1, axis.len() - 1) - 1;
        self.in_cell(cell(&self.fsj, f), cell(&self.zeta, z), f, z)
    }

    /// Row and their slopes along FSJ and zeta at a pair, straight beyond the lattice.
    pub fn with_slopes(&self, f: f64, z: f64) -> (Row, Row, Row) {
        let (i, j) = self.cell_of(f, z);
        let (wide, high) = (self.fsj[i + 1] - self.fsj[i], self.zeta[j + 1] - self.zeta[j]);
        let (u, v) = ((f - self.fsj[i]) / wide, (z - self.zeta[j]) / high);
        let [a, b, c, d] = self.corners(i, i + 1, j, j + 1);
        let value = std::array::from_fn(|k| lerp((lerp((a[k], b[k]), u), lerp((c[k], d[k]), u)), v));
        let along_f = std::array::from_fn(|k| lerp((b[k] - a[k], d[k] - c[k]), v) / wide);
        let along_z = std::array::from_fn(|k| lerp((c[k] - a[k], d[k] - b[k]), u) / high);
        (value, along_f, along_z)
    }

    /// What another table over the same nodes holds at a pair, bilinear.
    pub fn blend(&self, table: &[Row], f: f64, z: f64) -> Row {
        let (i, j) = self.cell_of(f, z);
        let n = self.fsj.len();
        let share = |axis: &[f64], k: usize, x: f64| ((x - axis[k]) / (axis[k + 1] - axis[k])).clamp(0.0, 1.0);
        let (u, v) = (share(&self.fsj, i, f), share(&self.zeta, j, z));
        let [a, b, c, d] = [0, 1, n, n + 1].map(|k| &table[i + j * n + k]);
        std::array::from_fn(|k| lerp((lerp((a[k], b[k]), u), lerp((c[k], d[k]), u)), v))
    }

    fn cell_of(&self, f: f64, z: f64) -> (usize, usize) {
        let cell = |axis: &[f64], x: f64| axis.partition_point(|&a| a <= x).clamp(1, axis.len() - 1) - 1;
        (cell(&self.fsj, f), cell(&self.zeta, z))
    }

    /// First and last FSJ, first and last zeta.
    pub fn range(&self) -> ((f64, f64), (f64, f64)) {
        let ends = |axis: &[f64]| (axis[0], axis[axis.len() - 1]);
        (ends(&self.fsj), ends(&self.zeta))
    }

    pub(super) fn in_cell(&self, i: usize, j: usize, f: f64, z: f64) -> Row {
        let share = |axis: &[f64], k: usize, x: f64| ((x - axis[k]) / (axis[k + 1] - axis[k])).clamp(0.0, 1.0);
        let (u, v) = (share(&self.fsj, i, f), share(&self.zeta, j, z));
        let [a, b, c, d] = self.corners(i, i + 1, j, j + 1);
        std::array::from_fn(|k| lerp((lerp((a[k], b[k]), u), lerp((c[k], d[k]), u)), v))
    }

    /// Corner nodes of a block: FSJ varies first.
    pub(super) fn corners(&self, i0: usize, i1: usize, j0: usize, j1: usize) -> [&Row; 4] {
        let n = self.fsj.len();
        [i0 + j0 * n, i1 + j0 * n, i0 + j1 * n, i1 + j1 * n].map(|k| &self.nodes[k].0)
    }
}

/// The joint test Q = sum of z_k^2 <= T with z = offset - W M, where M are the features.
#[derive(Clone, Debug)]
pub struct Joint {
    /// Whitening matrix, one row for each residual and one column for each feature; unused ones are zero.
    pub w: [[f64; MOST]; MOST],
    /// Whitened measurement [-].
    pub offset: Row,
    /// Largest admitted Q [-]; may be infinite.
    pub threshold: f64,
}

impl Joint {
    /// Q of the features `m` [-].
    pub fn misfit(&self, m: &Row) -> f64 {
        (0..MOST).map(|k| (self.offset[k] - dot(&self.w[k], m)).powi(2)).sum()
    }
}

/// Least-squares inverse of a whitening matrix.
pub(super) struct Inverse {
    pub w: [[f64; MOST]; MOST],
    /// One row for each feature; none if the features in use are not all determined.
    pub rows: Option<[Row; MOST]>,
}

impl Inverse {
    pub fn new(w: &[[f64; MOST]; MOST]) -> Self {
        Self {
            w: *w,
            rows: Self::rows(w),
        }
    }

    /// Modified Gram-Schmidt W = Q R, then R^-1 Q^T by back substitution.
    fn rows(w: &[[f64; MOST]; MOST]) -> Option<[Row; MOST]> {
        let (mut q, mut r) = ([[0.0; MOST]; MOST], [[0.0; MOST]; MOST]);
        for i in 0..MOST {
            let column: Row = std::array::from_fn(|k| w[k][i]);
            let (mut rest, length) = (column, dot(&column, &column).sqrt());
            if length == 0.0 {
                continue;
            }
            for j in 0..i {
                r[j][i] = dot(&q[j], &rest);
                rest = std::array::from_fn(|k| rest[k] - r[j][i] * q[j][k]);
            }
            r[i][i] = dot(&rest, &rest).sqrt();
            if r[i][i] < 1e-7 * length {
                return None;
            }
            q[i] = rest.map(|x| x / r[i][i]);
        }
        for i in (0..MOST).rev().filter(|&i| r[i][i] > 0.0) {
            for j in i + 1..MOST {
                q[i] = std::array::from_fn(|k| q[i][k] - r[i][j] * q[j][k]);
            }
            q[i] = q[i].map(|x| x / r[i][i]);
        }
        Some(q)
    }
}
