//! Thin singular value decomposition that returns a result for every finite matrix.

use faer::Mat;

/// Cosine of the angle between two columns below which they count as orthogonal.
const MAX_ORTHOGONAL_COSINE: f64 = 1e-15;
/// Maximum number of sweeps over all pairs of columns. Rotations converge quadratically after a few sweeps, down to
/// rounding.
const MAX_JACOBI_SWEEP_COUNT: usize = 60;

/// A = U·diag(s)·Vᵀ with s descending and a square V. If A has fewer rows than columns, rows of zeros are added.
#[derive(Debug, Clone)]
pub struct ThinSvd {
    /// Rows × columns. In the Jacobi method the columns of singular values 0 are zero.
    pub u: Mat<f64>,
    pub s: Vec<f64>,
    pub v: Mat<f64>,
}

impl ThinSvd {
    /// Decomposes `a`, which must be finite.
    pub fn decompose(a: &Mat<f64>) -> Self {
        let rows = a.nrows().max(a.ncols());
        let padded = Mat::from_fn(rows, a.ncols(), |i, j| if i < a.nrows() { a[(i, j)] } else { 0.0 });
        match padded.thin_svd() {
            Ok(svd) => Self {
                u: svd.U().to_owned(),
                s: svd.S().column_vector().iter().copied().collect(),
                v: svd.V().to_owned(),
            },
            // faer's iteration does not converge for some matrices with entries of rounding errors.
            Err(_) => Self::decompose_by_jacobi_rotations(padded),
        }
    }

    /// One-sided Jacobi method: rotates pairs of columns until all columns are orthogonal.
    fn decompose_by_jacobi_rotations(mut a: Mat<f64>) -> Self {
        let count = a.ncols();
        let mut v = Mat::identity(count, count);
        for _ in 0..MAX_JACOBI_SWEEP_COUNT {
            let mut is_orthogonal = true;
            for q in 1..count {
                for p in 0..q {
                    if let Some(turn) = orthogonalising_rotation(&a, p, q) {
                        is_orthogonal = false;
                        rotate_columns(&mut a, p, q, turn);
                        rotate_columns(&mut v, p, q, turn);
                    }
                }
            }
            if is_orthogonal {
                break;
            }
        }
        let sizes: Vec<f64> = a.col_iter().map(|column| column.norm_l2()).collect();
        let mut order: Vec<usize> = (0..count).collect();
        order.sort_by(|i, j| sizes[*j].total_cmp(&sizes[*i]));
        let unit = |size: f64| if size > 0.0 { 1.0 / size } else { 0.0 };
        Self {
            u: Mat::from_fn(a.nrows(), count, |i, j| a[(i, order[j])] * unit(sizes[order[j]])),
            s: order.iter().map(|j| sizes[*j]).collect(),
            v: Mat::from_fn(count, count, |i, j| v[(i, order[j])]),
        }
    }
}

/// Cosine and sine of the rotation that makes two columns orthogonal. `None`: they are orthogonal already.
fn orthogonalising_rotation(a: &Mat<f64>, p: usize, q: usize) -> Option<[f64; 2]> {
    let dot = |i: usize, j: usize| a.col(i).transpose() * a.col(j);
    let (own, other, both) = (dot(p, p), dot(q, q), dot(p, q));
    if both.abs() <= MAX_ORTHOGONAL_COSINE * (own * other).sqrt() {
        return None;
    }
    let ratio = (other - own) / (2.0 * both);
    let tangent = ratio.signum() / (ratio.abs() + ratio.hypot(1.0));
    let cosine = 1.0 / tangent.hypot(1.0);
    Some([cosine, cosine * tangent])
}

/// Turns the columns `p` and `q`: p becomes cosine·p − sine·q, q becomes sine·p + cosine·q.
fn rotate_columns(a: &mut Mat<f64>, p: usize, q: usize, [cosine, sine]: [f64; 2]) {
    for i in 0..a.nrows() {
        let (one, other) = (a[(i, p)], a[(i, q)]);
        a[(i, p)] = cosine * one - sine * other;
        a[(i, q)] = sine * one + cosine * other;
    }
}

#[cfg(test)]
mod tests {
    use rand_distr::{Distribution, StandardNormal};

    use super::*;
    use crate::random::seeded_stream;

    /// Largest entry of U·diag(s)·Vᵀ − `a`, and of VᵀV − 1.
    fn max_decomposition_errors(a: &Mat<f64>, svd: &ThinSvd) -> [f64; 2] {
        let ThinSvd { u, s, v } = svd;
        let scaled = Mat::from_fn(u.nrows(), s.len(), |i, j| u[(i, j)] * s[j]);
        let left = &scaled * v.transpose() - a;
        let square = v.transpose() * v - Mat::<f64>::identity(s.len(), s.len());
        [left.norm_max(), square.norm_max()]
    }

    /// Weighted equations of multiprobe (28 rows, 16 unknowns, groups of equal singular values) for which the
    /// decomposition of faer 0.24 does not converge. The file holds the bits of the entries, row by row.
    #[test]
    fn matrix_without_faer_convergence_is_decomposed() {
        let rows: Vec<Vec<f64>> = include_str!("without_convergence.txt")
            .lines()
            .skip(1)
            .map(|line| {
                let bits = line.split_whitespace().map(|bits| u64::from_str_radix(bits, 16));
                bits.map(|bits| f64::from_bits(bits.unwrap())).collect()
            })
            .collect();
        let a = Mat::from_fn(28, 16, |i, j| rows[i][j]);
        let svd = ThinSvd::decompose(&a);
        assert!(
            max_decomposition_errors(&a, &svd).into_iter().all(|off| off < 1e-14),
            "{:?}",
            max_decomposition_errors(&a, &svd)
        );
        assert!(svd.s.is_sorted_by(|one, other| one >= other));
    }

    /// Matrices of all ranks with columns of very different sizes, compared with faer.
    #[test]
    fn jacobi_rotations_agree_with_faer_decomposition() {
        let mut random = seeded_stream(7, &[]);
        for rank in 1..=6 {
            let mut draw =
                |rows, columns| Mat::from_fn(rows, columns, |_, _| -> f64 { StandardNormal.sample(&mut random) });
            let low = &draw(9, rank) * &draw(rank, 6);
            let a = Mat::from_fn(9, 6, |i, j| low[(i, j)] * 10f64.powi(j as i32));
            let size = a.norm_max();
            let (own, other) = (ThinSvd::decompose_by_jacobi_rotations(a.clone()), ThinSvd::decompose(&a));
            for svd in [&own, &other] {
                let [left, square] = max_decomposition_errors(&a, svd);
                assert!(left < 1e-14 * size && square < 1e-14, "{rank}: {left} {square}");
            }
            for (one, other) in own.s.iter().zip(&other.s) {
                assert!((one - other).abs() < 1e-14 * size, "{rank}: {one} {other}");
            }
        }
    }
}
