//! The nearest monotone surface: isotonic regression along both axes (pool adjacent violators
//! along each, alternated after Dykstra 1983).

/// Least-squares nearest rising sequence (pool adjacent violators), in place.
fn rising(v: &mut [f64]) {
    let mut blocks: Vec<(f64, usize)> = Vec::with_capacity(v.len());
    for &x in v.iter() {
        let mut block = (x, 1);
        while let Some(&(m, n)) = blocks.last() {
            if m <= block.0 {
                break;
            }
            blocks.pop();
            block = (
                (m * n as f64 + block.0 * block.1 as f64) / (n + block.1) as f64,
                n + block.1,
            );
        }
        blocks.push(block);
    }
    let mut i = 0;
    for (m, n) in blocks {
        v[i..i + n].fill(m);
        i += n;
    }
}

/// One half of the alternation: projects every line `at(line, 0..n)` of `x` plus its correction onto
/// the sequences that rise (`direction` 1) or fall (-1), and keeps what was taken off.
fn project(
    x: &mut [f64],
    correction: &mut [f64],
    direction: f64,
    lines: usize,
    n: usize,
    at: impl Fn(usize, usize) -> usize,
) {
    let mut values = Vec::with_capacity(n);
    for line in 0..lines {
        values.clear();
        values.extend((0..n).map(|k| direction * (x[at(line, k)] + correction[at(line, k)])));
        rising(&mut values);
        for (k, v) in values.iter().enumerate() {
            let i = at(line, k);
            let y = direction * v;
            correction[i] += x[i] - y;
            x[i] = y;
        }
    }
}

/// The nearest surface that rises (`+1`) or falls (`-1`) along each axis.
///
/// * `z` row-major values, `rows` rows (zeta) of `columns` (FSJ)
/// * `direction` along (columns, rows)
pub fn monotone_surface(z: &[f64], rows: usize, columns: usize, direction: (f64, f64)) -> Vec<f64> {
    let (dc, dr) = direction;
    let mut x = z.to_vec();
    let mut p = vec![0.0; z.len()];
    let mut q = vec![0.0; z.len()];
    let scale = z.iter().fold(0.0_f64, |m, v| m.max(v.abs()));
    for _ in 0..500 {
        let before = x.clone();
        project(&mut x, &mut p, dc, rows, columns, |r, c| r * columns + c);
        project(&mut x, &mut q, dr, columns, rows, |c, r| r * columns + c);
        let change = x.iter().zip(&before).fold(0.0_f64, |m, (a, b)| m.max((a - b).abs()));
        if change <= 1e-15 * scale {
            break;
        }
    }
    // what the alternation leaves along FSJ is far below any band: take the running maximum
    for r in 0..rows {
        for c in 1..columns {
            let (a, b) = (x[r * columns + c - 1], x[r * columns + c]);
            if dc * b < dc * a {
                x[r * columns + c] = a;
            }
        }
    }
    x
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn prop_surface_is_monotone_and_nearest_on_monotone_data() {
        let (rows, columns) = (4, 5);
        let z: Vec<f64> = (0..20)
            .map(|i| (i % columns) as f64 + 2.0 * (i / columns) as f64)
            .collect();
        assert_eq!(monotone_surface(&z, rows, columns, (1.0, 1.0)), z);
        let mut bad = z.clone();
        bad[7] -= 1.5;
        let m = monotone_surface(&bad, rows, columns, (1.0, 1.0));
        for r in 0..rows {
            for c in 0..columns {
                assert!(c == 0 || m[r * columns + c] >= m[r * columns + c - 1]);
                assert!(r == 0 || m[r * columns + c] >= m[(r - 1) * columns + c] - 1e-12);
            }
        }
        let worst = m.iter().zip(&bad).fold(0.0_f64, |w, (a, b)| w.max((a - b).abs()));
        assert!(worst <= 0.75, "{worst}");
    }
}
