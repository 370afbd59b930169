//! Nonlinear least squares: Gauss–Newton where the model keeps what its tangent promises, held back
//! after Levenberg and Marquardt where it does not. One iteration for all: a dense problem is one
//! block of [`Rows`] without unknowns of its own.

mod damping;

#[cfg(test)]
mod tests;

use damping::Damping;

use super::linear::LinearError;
use super::schur::{Factored, Rows, factor};

/// Jacobians at most.
const MOST_FACTORS: usize = 1000;
/// Done when what is left after the next step is smaller than this, in standard uncertainties of all
/// unknowns together: those from the given ones of the rows or those that the residuals show, whichever
/// are smaller.
const TOLERANCE: f64 = 1e-7;
/// Of each term of a model, on its way to a residual.
const ROUNDINGS: f64 = 8.0;
/// The undamped step is taken when it takes away this part of what it promises.
const KEPT: f64 = 0.9;
/// Where it promises to lessen √χ² by less than about the square of this, it is taken unasked as long
/// as steps shrink: the difference of two rounded sums says less than the step does.
const NEAR: f64 = 1e-5;
const SHRINKS: f64 = 0.98;

/// A nonlinear problem at its solution.
#[derive(Debug, Clone)]
pub struct Minimum {
    pub x: Vec<f64>,
    /// Of the model linearised there, but for the last step, which was too short to matter.
    pub factored: Factored,
    /// Weighted: measured less model.
    pub residuals: Vec<f64>,
    /// How often a Jacobian was needed.
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

/// The unknowns from `start` on at which the weighted squares are least. `rows` gives residuals and
/// derivatives (of the model) at a point, `residuals` the residuals alone, weighted and in the same
/// order. A model that cannot be evaluated there returns NaN.
///
/// # Errors
/// Rows that do not separate the unknowns at the solution; no convergence.
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
            // Nothing lessens χ² any more: good enough if the rows' uncertainties would not show it.
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

/// Written so that a NaN is refused.
fn is_kept(size: f64, last: f64, at: &Place, next: &Place) -> bool {
    let promise = size * size;
    let near = promise <= NEAR * NEAR * at.chi2 && size < SHRINKS * last;
    at.chi2 - next.chi2 >= KEPT * promise || (near && next.chi2.is_finite())
}

/// Whether what is left after a step of this size from `at` is too small to be seen: steps shrink at
/// least as they did from the `last` one to this. Or whether the step is rounding.
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
