//! Weighted linear least squares with explicit constraints, and the analysis of which unknowns a design determines.
//!
//! The unknowns are scaled first (each weighted column to norm 1). The constraints are then eliminated with an
//! orthonormal basis of their null space (the null-space method: Golub & Van Loan, Matrix Computations, section
//! 6.2). In this order the singular values do not depend on the choice of the basis, and a constraint `x_j = 0`
//! gives exactly the condition of the matrix without column j.

use faer::{Mat, MatRef};

use crate::thin_svd::ThinSvd;

/// Threshold of singular values, relative to the largest, below which a direction counts as not determined.
pub const RANK_THRESHOLD: f64 = 1e-10;
/// Threshold of the singular values of the constraints, relative to the largest; the constraints are exact.
const CONSTRAINT_RANK_THRESHOLD: f64 = 1e-12;

/// Least-squares problem: minimise Σ((y − A x)/σ)² under C x = 0.
#[derive(Debug, Clone, Copy)]
pub struct LinearProblem<'a> {
    /// Design matrix A, rows × unknowns.
    pub a: MatRef<'a, f64>,
    /// Measured values, one per row.
    pub y: &'a [f64],
    /// Standard uncertainty of each row, in the unit of `y`.
    pub sigma: &'a [f64],
    /// Explicit gauge, constraints × unknowns: C x = 0. Redundant rows are allowed.
    pub constraints: Option<MatRef<'a, f64>>,
    /// Threshold of singular values, relative to the largest; usually [`RANK_THRESHOLD`].
    pub rank_threshold: f64,
}

/// Solution of a [`LinearProblem`] whose rows determine all directions that the constraints leave free.
#[derive(Debug, Clone)]
pub struct LinearSolution {
    pub x: Vec<f64>,
    /// Covariance of `x`, unknowns × unknowns, for the given sigma (not scaled by the residuals).
    pub covariance: Mat<f64>,
    /// Derivatives of `x` by `y`, unknowns × rows: x = gain·y.
    pub gain: Mat<f64>,
    /// Residuals y − A x, unweighted.
    pub residuals: Vec<f64>,
    /// Weighted sum of squares Σ(residual/σ)².
    pub chi2: f64,
    /// Number of rows less rank. Rows of zeros are counted, so the caller omits them.
    pub dof: usize,
    /// Number of directions that the constraints leave free; the rows determine all of them.
    pub rank: usize,
    /// Condition number: column-scaled σmax/σmin.
    pub condition: f64,
}

/// Which unknowns a design matrix determines under its constraints.
#[derive(Debug, Clone)]
pub struct RankAnalysis {
    /// Number of determined directions among those that the constraints leave free.
    pub rank: usize,
    /// Number of undetermined directions: unknowns less independent constraints less rank.
    pub nullity: usize,
    /// Column-scaled σmax/σmin over the determined directions; infinite if there are none.
    pub condition: f64,
    /// σmax/σmin without column scaling (of A·Z, Z an orthonormal basis of the constraints' null space). The
    /// number is meaningful only if all unknowns have the same unit.
    pub condition_unscaled: f64,
    /// Singular values of the column-scaled matrix on the directions that the constraints leave free, descending.
    pub singular_values: Vec<f64>,
    /// Undetermined directions, unknowns × nullity: they satisfy the constraints and change no row. Each column has
    /// norm 1 in the unknowns' own units.
    pub null_space: Mat<f64>,
}

#[derive(Debug, Clone, thiserror::Error)]
pub enum LinearError {
    /// The rows do not determine all unknowns. The null space of the analysis contains the undetermined
    /// directions.
    #[error(
        "rank {} of {}: the measurements do not determine all unknowns; add measurements, or fix the \
         undetermined combinations by constraints",
        .0.rank, .0.rank + .0.nullity
    )]
    RankDeficient(Box<RankAnalysis>),
    #[error("the least-squares problem is malformed: {0}; correct the input")]
    Malformed(&'static str),
}

/// Solves the problem, or reports why it cannot be solved.
///
/// # Errors
/// [`LinearError::RankDeficient`] if the rows do not determine a direction. No minimum norm solution is returned in
/// that case. `LinearError::Malformed` also if the constraints leave no unknown free.
pub fn solve_least_squares(problem: &LinearProblem<'_>) -> Result<LinearSolution, LinearError> {
    let LinearProblem { a, y, sigma, constraints, rank_threshold } = *problem;
    check_row_counts_values_and_sigmas(problem)?;
    let weighted = Mat::from_fn(a.nrows(), a.ncols(), |i, j| a[(i, j)] / sigma[i]);
    let scale = column_scale_factors(weighted.as_ref());
    let reduced = ReducedProblem::new(weighted.as_ref(), &scale, constraints, rank_threshold)?;
    if reduced.rank < reduced.free_direction_count() {
        let found = analyse_rank(weighted.as_ref(), constraints, rank_threshold)?;
        return Err(LinearError::RankDeficient(Box::new(found)));
    }
    let root = reduced.covariance_root();
    let u = &reduced.svd.u;
    let weighted_u = Mat::from_fn(a.nrows(), root.ncols(), |i, j| u[(i, j)] / sigma[i]);
    let gain = &root * weighted_u.transpose();
    let x = matrix_vector_product(gain.as_ref(), y);
    let residuals: Vec<f64> =
        matrix_vector_product(a, &x).iter().zip(y).map(|(fitted, measured)| measured - fitted).collect();
    Ok(LinearSolution {
        covariance: &root * root.transpose(),
        gain,
        chi2: residuals.iter().zip(sigma).map(|(r, s)| (r / s).powi(2)).sum(),
        dof: a.nrows().saturating_sub(reduced.rank),
        rank: reduced.rank,
        condition: reduced.condition(),
        residuals,
        x,
    })
}

/// Computes rank, condition and null space of `a` (rows × unknowns, already weighted if weights matter) under
/// `constraints` (C x = 0).
///
/// # Errors
/// Malformed input. A deficient rank is not an error but part of the result.
pub fn analyse_rank(
    a: MatRef<'_, f64>,
    constraints: Option<MatRef<'_, f64>>,
    threshold: f64,
) -> Result<RankAnalysis, LinearError> {
    let scaled = ReducedProblem::new(a, &column_scale_factors(a), constraints, threshold)?;
    let unscaled = ReducedProblem::new(a, &vec![1.0; a.ncols()], constraints, threshold)?;
    Ok(RankAnalysis {
        rank: scaled.rank,
        nullity: scaled.free_direction_count() - scaled.rank,
        condition: scaled.condition(),
        condition_unscaled: unscaled.condition(),
        null_space: scaled.null_space(),
        singular_values: scaled.svd.s,
    })
}

/// Ratio to the largest column norm below which a column consists of rounding errors and is not scaled.
const ZERO_COLUMN_RATIO: f64 = 1e-13;

/// The weighted matrix on the directions that the constraints leave free: A·basis = U S Vᵀ.
struct ReducedProblem {
    /// Unknowns × free directions: x = basis·v. Contains the scaling and the constraints.
    basis: Mat<f64>,
    svd: ThinSvd,
    rank: usize,
}

impl ReducedProblem {
    fn new(
        a: MatRef<'_, f64>,
        scale: &[f64],
        constraints: Option<MatRef<'_, f64>>,
        threshold: f64,
    ) -> Result<Self, LinearError> {
        if !a.is_all_finite() || constraints.is_some_and(|c| !c.is_all_finite()) {
            return Err(LinearError::Malformed("a coefficient is not a finite number"));
        }
        if constraints.is_some_and(|c| c.ncols() != a.ncols()) {
            return Err(LinearError::Malformed("constraints and matrix differ in their unknowns"));
        }
        let basis = free_basis(scale, constraints);
        if basis.ncols() == 0 {
            return Err(LinearError::Malformed("no unknown is free"));
        }
        let svd = ThinSvd::decompose(&(a * &basis));
        let rank = rank_of(&svd.s, threshold);
        Ok(Self { basis, svd, rank })
    }

    fn free_direction_count(&self) -> usize {
        self.basis.ncols()
    }

    fn condition(&self) -> f64 {
        let values = &self.svd.s;
        match self.rank {
            0 => f64::INFINITY,
            rank => values[0] / values[rank - 1],
        }
    }

    /// T with covariance T·Tᵀ: basis·V·S⁻¹ over the determined directions.
    fn covariance_root(&self) -> Mat<f64> {
        let ThinSvd { s, v, .. } = &self.svd;
        let scaled = Mat::from_fn(self.free_direction_count(), self.rank, |i, j| v[(i, j)] / s[j]);
        &self.basis * scaled
    }

    /// Undetermined directions, unknowns × nullity, each of norm 1.
    fn null_space(&self) -> Mat<f64> {
        let mut directions = &self.basis * self.svd.v.get(.., self.rank..);
        for j in 0..directions.ncols() {
            let scale = factor_to_unit_norm(directions.col(j).norm_l2());
            directions.col_mut(j).iter_mut().for_each(|entry| *entry *= scale);
        }
        directions
    }
}

/// Factors that scale each column to norm 1; 1 for a column of zeros or of rounding errors.
fn column_scale_factors(a: MatRef<'_, f64>) -> Vec<f64> {
    let norms: Vec<f64> = (0..a.ncols()).map(|j| a.col(j).norm_l2()).collect();
    let largest = norms.iter().copied().fold(0.0, f64::max);
    // A column of rounding errors, such as sin π, holds no information and must not be scaled to norm 1.
    norms.into_iter().map(|n| factor_to_unit_norm(if n > ZERO_COLUMN_RATIO * largest { n } else { 0.0 })).collect()
}

/// Unknowns × free directions: diag(scale)·Z, Z an orthonormal basis of the null space of C·diag(scale).
fn free_basis(scale: &[f64], constraints: Option<MatRef<'_, f64>>) -> Mat<f64> {
    let n = scale.len();
    let Some(c) = constraints.filter(|c| c.nrows() > 0) else {
        return Mat::from_fn(n, n, |i, j| if i == j { scale[i] } else { 0.0 });
    };
    let mut scaled = Mat::from_fn(c.nrows(), n, |i, j| c[(i, j)] * scale[j]);
    for i in 0..scaled.nrows() {
        let row_scale = factor_to_unit_norm(scaled.row(i).norm_l2());
        scaled.row_mut(i).iter_mut().for_each(|entry| *entry *= row_scale);
    }
    let ThinSvd { s, v, .. } = ThinSvd::decompose(&scaled);
    let fixed = rank_of(&s, CONSTRAINT_RANK_THRESHOLD);
    Mat::from_fn(n, n - fixed, |i, j| scale[i] * v[(i, fixed + j)])
}

/// Number of values above `threshold` times the first one.
fn rank_of(descending_values: &[f64], threshold: f64) -> usize {
    let largest = descending_values.first().copied().unwrap_or(0.0);
    descending_values.iter().filter(|value| **value > threshold * largest).count()
}

/// Factor that scales `norm` to 1, or 1 for a vector of zeros.
fn factor_to_unit_norm(norm: f64) -> f64 {
    if norm > 0.0 { 1.0 / norm } else { 1.0 }
}

fn matrix_vector_product(a: MatRef<'_, f64>, x: &[f64]) -> Vec<f64> {
    (0..a.nrows()).map(|i| x.iter().enumerate().map(|(j, x)| a[(i, j)] * x).sum()).collect()
}

fn check_row_counts_values_and_sigmas(problem: &LinearProblem<'_>) -> Result<(), LinearError> {
    let rows = problem.a.nrows();
    if problem.y.len() != rows || problem.sigma.len() != rows {
        return Err(LinearError::Malformed("matrix, values and sigmas differ in their rows"));
    }
    if problem.y.iter().any(|value| !value.is_finite()) {
        return Err(LinearError::Malformed("a value is not a finite number"));
    }
    if problem.sigma.iter().any(|sigma| !(sigma.is_finite() && *sigma > 0.0)) {
        return Err(LinearError::Malformed("a standard uncertainty is not a positive number"));
    }
    Ok(())
}

/// Lower triangle L with L·Lᵀ = `a`, both n × n (Cholesky; Golub & Van Loan, Matrix Computations, section 4.2). `a`
/// must be symmetric and positive semidefinite. A pivot that is not positive, because of linear dependence or
/// rounding, gives a column of zeros.
pub fn cholesky_lower(a: &Mat<f64>) -> Mat<f64> {
    let mut root = Mat::zeros(a.nrows(), a.nrows());
    for i in 0..a.nrows() {
        for j in 0..=i {
            let before: f64 = (0..j).map(|k| root[(i, k)] * root[(j, k)]).sum();
            let rest: f64 = a[(i, j)] - before;
            root[(i, j)] = if i == j {
                rest.max(0.0).sqrt()
            } else if root[(j, j)] > 0.0 {
                rest / root[(j, j)]
            } else {
                0.0
            };
        }
    }
    root
}

#[cfg(test)]
mod tests {
    use super::*;

    /// L = [[2, 0], [-1, 3]], computed by hand. For a matrix of rank 1 the second column is zero.
    #[test]
    fn cholesky_factors_agree_with_hand_computation() {
        let of = |rows: [[f64; 2]; 2]| cholesky_lower(&Mat::from_fn(2, 2, |i, j| rows[i][j]));
        let expected = [[2.0, 0.0], [-1.0, 3.0]];
        assert_eq!(of([[4.0, -2.0], [-2.0, 10.0]]), Mat::from_fn(2, 2, |i, j| expected[i][j]));
        let expected = [[3.0, 0.0], [2.0, 0.0]];
        assert_eq!(of([[9.0, 6.0], [6.0, 4.0]]), Mat::from_fn(2, 2, |i, j| expected[i][j]));
    }
}
