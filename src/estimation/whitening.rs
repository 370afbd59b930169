//! Weights of three coordinates that are known together.

use glam::{DMat3, DVec3};

/// W with Wᵀ·W = Σ⁻¹: the inverse of the lower root L of `covariance` = L·Lᵀ, so that W·x has unit
/// covariance. `covariance` is positive definite.
pub fn whitening(covariance: DMat3) -> DMat3 {
    let c = |i: usize, j: usize| covariance.col(j)[i];
    let l00 = c(0, 0).sqrt();
    let (l10, l20) = (c(1, 0) / l00, c(2, 0) / l00);
    let l11 = (c(1, 1) - l10 * l10).sqrt();
    let l21 = (c(2, 1) - l20 * l10) / l11;
    let l22 = (c(2, 2) - l20 * l20 - l21 * l21).sqrt();
    let columns = [DVec3::new(l00, l10, l20), DVec3::new(0.0, l11, l21), DVec3::Z * l22];
    DMat3::from_cols(columns[0], columns[1], columns[2]).inverse()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_weighted_has_unit_covariance() {
        let rows = [[4.0, 1.2, -0.6], [1.2, 2.5, 0.3], [-0.6, 0.3, 9.0]];
        let covariance = DMat3::from_cols_array_2d(&rows);
        let w = whitening(covariance);
        let unit = w * covariance * w.transpose();
        assert!((unit - DMat3::IDENTITY).abs_diff_eq(DMat3::ZERO, 1e-12), "{unit}");
    }
}
