//! Residuals against what is declared: χ² with the mean and the variance that the sources make.

use faer::Mat;

use super::coverage;

/// Probability that χ² stays within its bounds where all is as declared.
const CREDIBLE: f64 = 0.998;

#[derive(Debug, Clone, Copy)]
pub struct Misfit {
    /// Weighted sum of squares.
    pub chi2: f64,
    /// What it is on average where all is as declared: the degrees of freedom, less where sources
    /// that move many measurements together are declared.
    pub expected: f64,
    /// Effective degrees of freedom of χ².
    pub dof: f64,
    /// Factor on the standard uncertainties of the sources that the residuals show.
    pub factor: f64,
    /// Beyond its bounds: above, below.
    pub above: bool,
    pub below: bool,
}

impl Misfit {
    /// `left`: what is left in the residuals of each independent draw of size one standard uncertainty,
    /// a vector as long as `residuals` each. χ² is that of a sum of squares with the mean and the
    /// variance that they make (Satterthwaite). Declared sizes stand unless the residuals contradict
    /// them; where nothing is `declared` the residuals judge.
    pub fn judge(residuals: &[f64], left: &[Vec<f64>], declared: bool) -> Self {
        let rows = residuals.len();
        let left = Mat::from_fn(rows, left.len(), |i, j| left[j][i]);
        let expected: f64 = left.col_iter().map(|column| column.squared_norm_l2()).sum();
        let joint =
            if rows < left.ncols() { &left * left.transpose() } else { left.transpose() * &left };
        let dof = expected * expected / joint.squared_norm_l2();
        let chi2: f64 = residuals.iter().map(|r| r * r).sum();
        let bounds = coverage::chi_square_bounds(dof, CREDIBLE);
        let ratio = chi2 / expected;
        let beyond = |is: &dyn Fn((f64, f64)) -> bool| bounds.is_some_and(is);
        let above = declared && beyond(&|(_, upper)| ratio * dof > upper);
        let below = declared && beyond(&|(lower, _)| ratio * dof < lower);
        let judged = above || (!declared && bounds.is_some());
        let factor = if judged { ratio.sqrt() } else { 1.0 };
        Self { chi2, expected, dof, factor, above, below }
    }
}
