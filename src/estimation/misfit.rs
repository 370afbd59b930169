//! Test of the residuals against the declared sources: χ² with the mean and the variance that the sources cause.

use faer::Mat;

use super::coverage;

/// Probability that χ² is within its bounds, with equal tails, if all sources are as declared.
const CHI2_BOUND_PROBABILITY: f64 = 0.998;

/// χ² of residuals, compared with the χ² that the declared sources predict.
#[derive(Debug, Clone, Copy)]
pub struct Misfit {
    /// χ²: the sum of squares of the weighted residuals, not scaled.
    pub chi2: f64,
    /// Expectation of χ² if all sources are as declared: the degrees of freedom, or less if declared sources change
    /// many measurements together.
    pub expected_chi2: f64,
    /// Effective degrees of freedom of χ².
    pub effective_dof: f64,
    /// Factor by which the standard uncertainties of the sources in the residuals are multiplied: √(χ²/expected χ²) if
    /// χ² is above its bound or the sources are not declared, otherwise 1; always 1 without degrees of freedom.
    pub uncertainty_factor: f64,
    /// Whether χ² is above its upper bound; `false` if the sources are not declared or there are no degrees of freedom.
    pub is_above_bound: bool,
    /// Whether χ² is below its lower bound; `false` if the sources are not declared or there are no degrees of freedom.
    pub is_below_bound: bool,
}

impl Misfit {
    /// Compares `residuals` with what the sources predict. `residuals_of_unit_draws`: for each independent draw of one
    /// standard uncertainty, the part that remains in the residuals (a vector of the same length as `residuals`). The
    /// bounds are those of a scaled χ² distribution with the mean and the variance that the draws cause
    /// (Satterthwaite). If `is_declared`, the uncertainty factor is 1 unless χ² is above its upper bound; otherwise the
    /// factor follows from the residuals. `dof`: rows less rank. If `dof` is 0, the expectation is only rounding error:
    /// the factor is 1 and no bound is exceeded.
    pub fn from_residuals(
        residuals: &[f64],
        residuals_of_unit_draws: &[Vec<f64>],
        dof: usize,
        is_declared: bool,
    ) -> Self {
        let rows = residuals.len();
        let left = Mat::from_fn(rows, residuals_of_unit_draws.len(), |i, j| residuals_of_unit_draws[j][i]);
        let expected_chi2: f64 = left.col_iter().map(|column| column.squared_norm_l2()).sum();
        let joint = if rows < left.ncols() { &left * left.transpose() } else { left.transpose() * &left };
        let effective_dof = expected_chi2 * expected_chi2 / joint.squared_norm_l2();
        let chi2: f64 = residuals.iter().map(|r| r * r).sum();
        let bounds = (dof > 0).then(|| coverage::chi_square_bounds(effective_dof, CHI2_BOUND_PROBABILITY)).flatten();
        let ratio = chi2 / expected_chi2;
        let is_above_bound = is_declared && bounds.is_some_and(|(_, upper)| ratio * effective_dof > upper);
        let is_below_bound = is_declared && bounds.is_some_and(|(lower, _)| ratio * effective_dof < lower);
        let has_factor = is_above_bound || (!is_declared && bounds.is_some());
        let uncertainty_factor = if has_factor { ratio.sqrt() } else { 1.0 };
        Self { chi2, expected_chi2, effective_dof, uncertainty_factor, is_above_bound, is_below_bound }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Unit draws of six rows after subtraction of their mean: the columns of I − 1/6.
    fn unit_draws_less_their_mean() -> Vec<Vec<f64>> {
        let entry = |i: usize, j: usize| f64::from(u8::from(i == j)) - 1.0 / 6.0;
        (0..6).map(|j| (0..6).map(|i| entry(i, j)).collect()).collect()
    }

    /// Residuals of six readings from their mean: χ² has five degrees of freedom, and without a declaration the factor
    /// is the sample standard deviation of the readings (GUM 4.2.2), here √(70/5).
    #[test]
    fn misfit_of_six_readings_from_their_mean() {
        let residuals = [-5.0, -3.0, -1.0, 1.0, 3.0, 5.0];
        let misfit = Misfit::from_residuals(&residuals, &unit_draws_less_their_mean(), 5, false);
        assert!((misfit.expected_chi2 - 5.0).abs() < 1e-12 && (misfit.effective_dof - 5.0).abs() < 1e-12);
        assert!(
            (misfit.uncertainty_factor - 14f64.sqrt()).abs() < 1e-12
                && !misfit.is_above_bound
                && !misfit.is_below_bound
        );
        let declared = Misfit::from_residuals(&residuals, &unit_draws_less_their_mean(), 5, true);
        assert!(declared.is_above_bound && (declared.uncertainty_factor - 14f64.sqrt()).abs() < 1e-12);
        let plausible = residuals.map(|residual| 0.3 * residual);
        let declared = Misfit::from_residuals(&plausible, &unit_draws_less_their_mean(), 5, true);
        assert!(!declared.is_above_bound && declared.uncertainty_factor == 1.0);
    }

    /// As many rows as unknowns: residuals and expectation are rounding errors, so their ratio is arbitrary.
    #[test]
    fn no_bound_is_exceeded_without_degrees_of_freedom() {
        let left = [vec![1e-16, 0.0], vec![0.0, -2e-16]];
        for declared in [false, true] {
            let misfit = Misfit::from_residuals(&[3e-13, -1e-13], &left, 0, declared);
            assert_eq!((misfit.uncertainty_factor, misfit.is_above_bound, misfit.is_below_bound), (1.0, false, false));
        }
    }
}
