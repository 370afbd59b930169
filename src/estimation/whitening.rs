//! Weighting of three correlated coordinates.

use nalgebra::{Cholesky, Matrix3, U3};

/// W with Wᵀ·W = Σ⁻¹: the inverse of the lower root L of `covariance` = L·Lᵀ, so W·x has unit covariance. NaN if
/// `covariance` is not positive definite.
pub fn whitening_matrix(covariance: Matrix3<f64>) -> Matrix3<f64> {
    let inverse = |root: Cholesky<f64, U3>| root.l().try_inverse();
    covariance.cholesky().and_then(inverse).unwrap_or(Matrix3::repeat(f64::NAN))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn whitened_coordinates_have_unit_covariance() {
        let rows = [[4.0, 1.2, -0.6], [1.2, 2.5, 0.3], [-0.6, 0.3, 9.0]];
        let covariance = Matrix3::from(rows);
        let w = whitening_matrix(covariance);
        let unit = w * covariance * w.transpose();
        assert!((unit - Matrix3::identity()).abs().max() < 1e-12, "{unit}");
    }
}
