//! Nonlinear least squares: Gauss–Newton where the linearised model predicts χ² well, damped after Levenberg and
//! Marquardt elsewhere. Dense and block problems use the same iteration: a dense problem is one block of [`Rows`]
//! without own unknowns.

mod damping;

#[cfg(test)]
mod tests;

use damping::Damping;

use super::linear::LinearError;
use super::schur::{Factored, Rows, factor};

/// Maximum number of Jacobian evaluations.
const MOST_FACTORS: usize = 1000;
/// The iteration ends if the distance that remains after the next step is smaller than this, in standard
/// uncertainties of all unknowns together. The smaller of two standard uncertainties counts: from the given
/// uncertainties of the rows, or from the residuals.
const TOLERANCE: f64 = 1e-7;
/// Rounding errors of each term of the model in a residual, in units of `f64::EPSILON`.
const ROUNDINGS: f64 = 8.0;
/// The undamped step is taken if χ² decreases by at least this fraction of the predicted decrease.
const KEPT: f64 = 0.9;
/// If the predicted relative decrease of √χ² is below about the square of this value, the undamped step is taken as
/// long as steps become shorter. The difference of two rounded sums is less reliable there than the step.
const NEAR: f64 = 1e-5;
const SHRINKS: f64 = 0.98;

/// A nonlinear problem at its solution.
#[derive(Debug, Clone)]
pub struct Minimum {
    pub x: Vec<f64>,
    /// Factorisation of the linearised model. The last step, which is negligible, is not included.
    pub factored: Factored,
    /// Weighted residuals: measured less model.
    pub residuals: Vec<f64>,
    /// Number of Jacobian evaluations.
    pub factors: usize,
}

#[derive(Debug, Clone, thiserror::Error)]
pub enum NonlinearError {
    #[error(
        "no convergence with {factors} Jacobians: the next step is {step:.1e} standard \
         uncertainties; start nearer to the solution"
    )]
    NotConverged { factors: usize, step: f64 },
    #[error(transparent)]
    Linear(#[from] LinearError),
}

/// Minimises the weighted sum of squares from the initial unknowns `start`. `rows` returns residuals and
/// derivatives of the model at a point. `residuals` returns the residuals alone, weighted and in the same order. A
/// model returns NaN where it cannot be evaluated.
///
/// # Errors
/// The rows do not determine the unknowns at the solution, or the iteration does not converge.
pub fn minimise(
    start: Vec<f64>,
    rows: impl Fn(&[f64]) -> Vec<Rows>,
    residuals: impl Fn(&[f64]) -> Vec<f64>,
) -> Result<Minimum, NonlinearError> {
    let model = Model { rows, residuals };
    let mut at = model.place(start);
    let (mut damping, mut last, mut size) = (Damping::new(), f64::INFINITY, f64::NAN);
    for factors in 1..=MOST_FACTORS {
        let (factored, coordinates) = factor((model.rows)(&at.x));
        size = square_sum(&coordinates).sqrt();
        if factored.is_sound() {
            let next = model.moved(&at, &factored.unknowns_at(&coordinates));
            if is_done(size, last, &at, &factored) {
                return next.minimum(factored, factors);
            }
            if is_kept(size, last, &at, &next) {
                (last, at) = (size, next);
                continue;
            }
        }
        match damping.descend(&model, &at, &factored) {
            Some(next) => (last, at) = (f64::INFINITY, next),
            // No step decreases χ²: accept the point if the remaining step is negligible against the rows'
            // uncertainties.
            None if size <= TOLERANCE => return at.minimum(factored, factors),
            None => {
                factored.checked()?;
                return Err(NonlinearError::NotConverged { factors, step: size });
            }
        }
    }
    Err(NonlinearError::NotConverged { factors: MOST_FACTORS, step: size })
}

struct Model<R, S> {
    rows: R,
    residuals: S,
}

/// A model evaluated at `x`.
struct Place {
    x: Vec<f64>,
    residuals: Vec<f64>,
    chi2: f64,
}

impl<R, S: Fn(&[f64]) -> Vec<f64>> Model<R, S> {
    fn place(&self, x: Vec<f64>) -> Place {
        let residuals = (self.residuals)(&x);
        let chi2 = square_sum(&residuals);
        Place { x, residuals, chi2 }
    }

    fn moved(&self, at: &Place, step: &[f64]) -> Place {
        self.place(at.x.iter().zip(step).map(|(x, dx)| x + dx).collect())
    }
}

impl Place {
    fn minimum(self, factored: Factored, factors: usize) -> Result<Minimum, NonlinearError> {
        let factored = factored.checked()?;
        Ok(Minimum { x: self.x, factored, residuals: self.residuals, factors })
    }
}

/// Whether the undamped step is accepted. The comparisons reject NaN.
fn is_kept(size: f64, last: f64, at: &Place, next: &Place) -> bool {
    let promise = size * size;
    let near = promise <= NEAR * NEAR * at.chi2 && size < SHRINKS * last;
    at.chi2 - next.chi2 >= KEPT * promise || (near && next.chi2.is_finite())
}

/// Whether the error that remains after a step of this size from `at` is negligible, assuming that steps continue
/// to shrink at least as they did from the `last` step to this one; or whether the step is only rounding.
fn is_done(size: f64, last: f64, at: &Place, factored: &Factored) -> bool {
    let dof = at.residuals.len().saturating_sub(at.x.len());
    let shown = if dof > 0 { (at.chi2 / dof as f64).sqrt() } else { 1.0 };
    let left = if last < f64::INFINITY { size * size / (last - size).max(0.0) } else { size };
    let rounding = || {
        let terms = factored.column_norms().into_iter().zip(&at.x);
        ROUNDINGS * f64::EPSILON * terms.map(|(norm, x)| (norm * x).powi(2)).sum::<f64>().sqrt()
    };
    left <= TOLERANCE * shown.min(1.0) || (size <= TOLERANCE && size <= rounding())
}

fn square_sum(values: &[f64]) -> f64 {
    values.iter().map(|value| value * value).sum()
}
