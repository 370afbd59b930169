//! Nonlinear least squares: Gauss–Newton where the linearised model predicts χ² well, damped after Levenberg and
//! Marquardt elsewhere. Dense and block problems use the same iteration: a dense problem is one block of [`BlockRows`]
//! without own unknowns.

mod damping;

#[cfg(test)]
mod tests;

use damping::Damping;

use super::linear_least_squares::LinearError;
use super::schur::{BlockFactorisation, BlockRows, factorise_and_project_right_side};

/// Maximum number of Jacobian evaluations.
const MAX_JACOBIAN_COUNT: usize = 1000;
/// The iteration ends if the distance that remains after the next step is smaller than this, in standard
/// uncertainties of all unknowns together. The smaller of two standard uncertainties counts: from the given
/// uncertainties of the rows, or from the residuals.
const STEP_TOLERANCE: f64 = 1e-7;
/// Rounding errors of each term of the model in a residual, in units of `f64::EPSILON`.
const RESIDUAL_ROUNDING_EPSILONS: f64 = 8.0;
/// The undamped step is taken if χ² decreases by at least this fraction of the predicted decrease.
const MIN_UNDAMPED_DECREASE_RATIO: f64 = 0.9;
/// If the predicted relative decrease of √χ² is below about the square of this value, the undamped step is taken as
/// long as steps become shorter. The difference of two rounded sums is less reliable there than the step.
const NEAR_MINIMUM_DECREASE_RATIO: f64 = 1e-5;
/// Near the minimum a step counts as shorter if it is below this fraction of the step before it.
const MAX_NEAR_MINIMUM_STEP_RATIO: f64 = 0.98;

/// A nonlinear problem at its solution.
#[derive(Debug, Clone)]
pub struct NonlinearSolution {
    pub x: Vec<f64>,
    /// Factorisation of the model linearised before the last step, which is negligible.
    pub factorisation: BlockFactorisation,
    /// Weighted residuals: measured less model.
    pub residuals: Vec<f64>,
    /// Number of Jacobian evaluations.
    pub jacobian_evaluation_count: usize,
}

#[derive(Debug, Clone, thiserror::Error)]
pub enum NonlinearError {
    #[error(
        "no convergence after {jacobian_count} Jacobian evaluations: the next step is {next_step_in_standard_uncertainties:.1e} standard \
         uncertainties; start nearer to the solution"
    )]
    NotConverged { jacobian_count: usize, next_step_in_standard_uncertainties: f64 },
    #[error(transparent)]
    Linear(#[from] LinearError),
}

/// Minimises the weighted sum of squares from the initial unknowns `start`. `rows` returns residuals and
/// derivatives of the model at a point. `residuals` returns the residuals alone, weighted and in the same order. A
/// model returns NaN where it cannot be evaluated.
///
/// # Errors
/// The rows do not determine the unknowns at the solution, or the iteration does not converge.
pub fn minimise_squares(
    start: Vec<f64>,
    rows: impl Fn(&[f64]) -> Vec<BlockRows>,
    residuals: impl Fn(&[f64]) -> Vec<f64>,
) -> Result<NonlinearSolution, NonlinearError> {
    let model = LeastSquaresModel { rows_at: rows, residuals_at: residuals };
    let mut point = model.evaluate(start);
    let (mut damping, mut last, mut size) = (Damping::new(), f64::INFINITY, f64::NAN);
    for jacobian_count in 1..=MAX_JACOBIAN_COUNT {
        let (factored, coordinates) = factorise_and_project_right_side((model.rows_at)(&point.x));
        size = square_sum(&coordinates).sqrt();
        if factored.is_full_rank() {
            let next = model.evaluate_after_step(&point, &factored.unknowns_from_coordinates(&coordinates));
            if is_converged(size, last, &point, &factored) {
                return next.into_solution(factored, jacobian_count);
            }
            if accepts_undamped_step(size, last, &point, &next) {
                (last, point) = (size, next);
                continue;
            }
        }
        match damping.damped_step(&model, &point, &factored) {
            Some(next) => (last, point) = (f64::INFINITY, next),
            // No step decreases χ²: accept the point if the remaining step is negligible against the rows'
            // uncertainties.
            None if size <= STEP_TOLERANCE => return point.into_solution(factored, jacobian_count),
            None => {
                factored.require_full_rank()?;
                return Err(NonlinearError::NotConverged { jacobian_count, next_step_in_standard_uncertainties: size });
            }
        }
    }
    Err(NonlinearError::NotConverged { jacobian_count: MAX_JACOBIAN_COUNT, next_step_in_standard_uncertainties: size })
}

struct LeastSquaresModel<R, S> {
    rows_at: R,
    residuals_at: S,
}

/// A model evaluated at `x`.
struct ModelPoint {
    x: Vec<f64>,
    /// Weighted residuals: measured less model.
    residuals: Vec<f64>,
    /// Sum of squares of `residuals`.
    residual_square_sum: f64,
}

impl<R, S: Fn(&[f64]) -> Vec<f64>> LeastSquaresModel<R, S> {
    fn evaluate(&self, x: Vec<f64>) -> ModelPoint {
        let residuals = (self.residuals_at)(&x);
        ModelPoint { x, residual_square_sum: square_sum(&residuals), residuals }
    }

    fn evaluate_after_step(&self, point: &ModelPoint, step: &[f64]) -> ModelPoint {
        self.evaluate(point.x.iter().zip(step).map(|(x, dx)| x + dx).collect())
    }
}

impl ModelPoint {
    /// The solution at this point; an error if the rows do not determine all unknowns.
    fn into_solution(
        self,
        factored: BlockFactorisation,
        jacobian_evaluation_count: usize,
    ) -> Result<NonlinearSolution, NonlinearError> {
        let factorisation = factored.require_full_rank()?;
        let Self { x, residuals, .. } = self;
        Ok(NonlinearSolution { x, factorisation, residuals, jacobian_evaluation_count })
    }
}

/// Whether the undamped step from `point` to `next` is accepted; the step sizes are in standard uncertainties. The
/// comparisons reject NaN.
fn accepts_undamped_step(step_size: f64, last_step_size: f64, point: &ModelPoint, next: &ModelPoint) -> bool {
    let predicted_decrease = step_size * step_size;
    let near = predicted_decrease
        <= NEAR_MINIMUM_DECREASE_RATIO * NEAR_MINIMUM_DECREASE_RATIO * point.residual_square_sum
        && step_size < MAX_NEAR_MINIMUM_STEP_RATIO * last_step_size;
    point.residual_square_sum - next.residual_square_sum >= MIN_UNDAMPED_DECREASE_RATIO * predicted_decrease
        || (near && next.residual_square_sum.is_finite())
}

/// Whether the error after a step of `step_size`, in standard uncertainties, from `point` is negligible, or the step
/// is only rounding. It is assumed that later steps shrink at least by the ratio of `step_size` to `last_step_size`.
fn is_converged(step_size: f64, last_step_size: f64, point: &ModelPoint, factored: &BlockFactorisation) -> bool {
    let dof = point.residuals.len().saturating_sub(point.x.len());
    let residual_sd = if dof > 0 { (point.residual_square_sum / dof as f64).sqrt() } else { 1.0 };
    let remaining = if last_step_size < f64::INFINITY {
        step_size * step_size / (last_step_size - step_size).max(0.0)
    } else {
        step_size
    };
    let rounding = || {
        let terms = factored.column_norms().into_iter().zip(&point.x);
        RESIDUAL_ROUNDING_EPSILONS * f64::EPSILON * terms.map(|(norm, x)| (norm * x).powi(2)).sum::<f64>().sqrt()
    };
    remaining <= STEP_TOLERANCE * residual_sd.min(1.0) || (step_size <= STEP_TOLERANCE && step_size <= rounding())
}

fn square_sum(values: &[f64]) -> f64 {
    values.iter().map(|value| value * value).sum()
}
