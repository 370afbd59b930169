//! Detection of columns of a design matrix that are linear combinations of other columns.

use faer::Mat;
use faer::linalg::solvers::SolveLstsq;
use nalgebra::{DVector, DVectorView};

/// A known column is a linear combination of the columns before it if less than this fraction of its length is
/// independent of them.
const MIN_INDEPENDENT_SHARE_OF_KNOWN: f64 = 1e-6;

/// Indices of the `candidates` that are independent, tested in their order: more than the fraction
/// `min_share(index)` of the column's length is independent of the `known` columns and of the candidates already
/// chosen. All columns have the same number of rows. The caller scales the rows to one unit first.
pub fn independent_candidate_indices(
    known: &[Vec<f64>],
    candidates: &[Vec<f64>],
    min_share: impl Fn(usize) -> f64,
) -> Vec<usize> {
    let mut basis = Vec::new();
    for column in known {
        extend_basis_if_independent(&mut basis, column, MIN_INDEPENDENT_SHARE_OF_KNOWN);
    }
    let all = candidates.iter().enumerate();
    all.filter(|(i, column)| extend_basis_if_independent(&mut basis, column, min_share(*i))).map(|(i, _)| i).collect()
}

/// Coefficients, one for each `known` column, of the linear combination that equals `column` except for at most the
/// fraction `max_rest_share` of its length. `None`: `column` is independent, or there are more known columns than rows.
pub fn find_linear_combination(known: &[Vec<f64>], column: &[f64], max_rest_share: f64) -> Option<Vec<f64>> {
    let (rows, count) = (column.len(), known.len());
    if count == 0 {
        return column.iter().all(|x| *x == 0.0).then(Vec::new);
    }
    if rows < count {
        return None;
    }
    let matrix = Mat::from_fn(rows, count, |i, j| known[j][i]);
    let right = Mat::from_fn(rows, 1, |i, _| column[i]);
    let solved = matrix.col_piv_qr().solve_lstsq(&right);
    let coefficients = solved.get(..count, ..);
    let remainder = &right - &matrix * coefficients;
    let is_combination = remainder.norm_l2() <= max_rest_share * right.norm_l2();
    is_combination.then(|| (0..count).map(|j| coefficients[(j, 0)]).collect())
}

/// Returns whether more than the fraction `min_share` of the length of `column` is independent of the orthonormal
/// `basis`. If so, extends the basis by it (Gram–Schmidt, twice: Giraud et al., Numer. Math. 101, 2005).
fn extend_basis_if_independent(basis: &mut Vec<DVector<f64>>, column: &[f64], min_share: f64) -> bool {
    let mut remainder = DVector::from_column_slice(column);
    for _ in 0..2 {
        for unit in basis.iter() {
            remainder.axpy(-unit.dot(&remainder), unit, 1.0);
        }
    }
    let rest = remainder.norm();
    let is_independent = rest > min_share * DVectorView::from_slice(column, column.len()).norm();
    if is_independent {
        basis.push(remainder / rest);
    }
    is_independent
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Candidates: one in the plane of two known columns, one out of this plane by 3 %, and one that is far out of this
    /// plane but depends on the known columns and the second candidate together.
    #[test]
    fn columns_out_of_the_known_plane_are_independent() {
        let known = [vec![1.0, 0.0, 0.0], vec![1.0, 1.0, 0.0]];
        let slanted = vec![1.0, 0.0, 0.03];
        let candidates = [vec![2.0, -1.0, 0.0], slanted.clone(), vec![0.0, 5.0, 7.0]];
        assert_eq!(independent_candidate_indices(&known, &candidates, |_| 1e-6), [1]);
        assert_eq!(independent_candidate_indices(&known, &candidates, |_| 0.1), [2]);
        assert_eq!(independent_candidate_indices(&[], &known, |_| 1e-6), [0, 1]);
        assert_eq!(independent_candidate_indices(&[], &[vec![0.0; 3]], |_| 1e-6), [0_usize; 0]);
        let found = find_linear_combination(&known, &candidates[0], 1e-6).unwrap();
        assert!((found[0] - 3.0).abs() < 1e-14 && (found[1] + 1.0).abs() < 1e-14, "{found:?}");
        assert_eq!(find_linear_combination(&known, &slanted, 1e-6), None);
        assert!(find_linear_combination(&known, &slanted, 0.1).is_some());
        assert_eq!(find_linear_combination(&[], &[0.0], 1e-6), Some(Vec::new()));
        assert_eq!(find_linear_combination(&known, &[1.0], 1e-6), None);
    }
}
