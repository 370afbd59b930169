//! Nonlinear least squares: Gauss–Newton on the linear solver, with Levenberg–Marquardt damping on
//! request.

mod damping;

#[cfg(test)]
mod tests;

use damping::Damping;
use faer::{Mat, MatRef};

use super::linear::{LinearError, LinearProblem, LinearSolution, RANK_THRESHOLD, solve};

/// A model at one point of its unknowns. A model that cannot be evaluated there returns NaN.
#[derive(Debug, Clone)]
pub struct Linearised {
    /// Measured less model, one per row.
    pub residuals: Vec<f64>,
    /// ∂model/∂unknowns, rows × unknowns.
    pub jacobian: Mat<f64>,
}

#[derive(Debug, Clone, Copy)]
pub struct Settings {
    /// Evaluations of the model at most.
    pub max_steps: usize,
    /// Done when no unknown would move by more than this part of its standard uncertainty: the one
    /// from the given sigma or the one that the residuals show, whichever is smaller.
    pub tolerance: f64,
    /// Initial Levenberg–Marquardt damping (1e-3 is usual); `None`: pure Gauss–Newton.
    pub damping: Option<f64>,
    pub rank_threshold: f64,
}

impl Default for Settings {
    fn default() -> Self {
        Self { max_steps: 100, tolerance: 1e-8, damping: None, rank_threshold: RANK_THRESHOLD }
    }
}

#[derive(Debug, Clone)]
pub struct NonlinearSolution {
    /// `x`, `residuals` and `chi2` at the solution; `covariance`, `gain`, `rank` and `condition`
    /// of the model linearised there (gain: ∂x/∂measured).
    pub at: LinearSolution,
    /// Evaluations of the model.
    pub evaluations: usize,
}

#[derive(Debug, Clone, thiserror::Error)]
pub enum NonlinearError {
    #[error(
        "no convergence after {evaluations} evaluations: the next step is {step:.1e} standard \
         uncertainties; start nearer to the solution or use damping"
    )]
    NotConverged { evaluations: usize, step: f64 },
    #[error(transparent)]
    Linear(#[from] LinearError),
}

/// Where the undamped step promises to lessen √χ² by less than about the square of this, it is taken
/// unasked: the difference of two rounded sums says less than the step does.
const NEAR: f64 = 1e-5;
/// A step at least this large against the smallest so far shrinks no more.
const SHRINKS: f64 = 0.98;

/// Minimise Σ(residual/σ)² from `start`, moving only in directions with C·dx = 0: the gauge
/// C x = C·start is kept. `model` gives residuals and Jacobian.
///
/// # Errors
/// [`LinearError::RankDeficient`] when the linearised problem leaves a direction open (with damping:
/// at the solution; without: at any step), [`NonlinearError::NotConverged`].
pub fn minimise(
    start: &[f64],
    sigma: &[f64],
    constraints: Option<MatRef<'_, f64>>,
    settings: &Settings,
    model: impl FnMut(&[f64]) -> Linearised,
) -> Result<NonlinearSolution, NonlinearError> {
    let mut problem = Problem { sigma, constraints, model, evaluations: 0 };
    let mut damping = settings.damping.map(Damping::new);
    let mut at = problem.place(start.to_vec());
    let mut smallest = f64::INFINITY;
    loop {
        let found = problem.step(&at.point, settings.rank_threshold);
        let newton = match found {
            Ok(step) if is_done(&step, &at, smallest, settings.tolerance) => {
                return Ok(finish(step, at, problem.evaluations));
            }
            Err(LinearError::Malformed(why)) => return Err(LinearError::Malformed(why).into()),
            found => found,
        };
        if problem.evaluations >= settings.max_steps {
            return Err(problem.not_converged(&newton?, &at));
        }
        let Some(damping) = &mut damping else {
            let step = newton?;
            smallest = smallest.min(size(&step, &at));
            at = problem.place(moved(&at.x, &step.x));
            continue;
        };
        if let Ok(step) = &newton
            && let Some(next) = problem.near(step, &at, smallest)
        {
            (smallest, at) = (size(step, &at), next);
            continue;
        }
        at = match damping.descend(&mut problem, &at, settings.max_steps)? {
            Some(next) => next,
            None => return problem.stuck(newton?, at, settings),
        };
        smallest = f64::INFINITY;
    }
}

/// A model evaluated at `x`.
struct Place {
    x: Vec<f64>,
    point: Linearised,
    chi2: f64,
}

struct Problem<'a, M> {
    sigma: &'a [f64],
    constraints: Option<MatRef<'a, f64>>,
    model: M,
    evaluations: usize,
}

impl<M: FnMut(&[f64]) -> Linearised> Problem<'_, M> {
    fn place(&mut self, x: Vec<f64>) -> Place {
        self.evaluations += 1;
        let point = (self.model)(&x);
        let chi2 = chi2(&point.residuals, self.sigma);
        Place { x, point, chi2 }
    }

    fn step(&self, point: &Linearised, threshold: f64) -> Result<LinearSolution, LinearError> {
        solve(&LinearProblem {
            a: point.jacobian.as_ref(),
            y: &point.residuals,
            sigma: self.sigma,
            constraints: self.constraints,
            rank_threshold: threshold,
        })
    }

    /// The undamped step near the solution, while it shrinks.
    fn near(&mut self, step: &LinearSolution, at: &Place, smallest: f64) -> Option<Place> {
        let seen = product(&at.point.jacobian, &step.x);
        let promise = chi2(&seen, self.sigma) / at.chi2;
        let take = promise <= NEAR * NEAR && size(step, at) < SHRINKS * smallest;
        take.then(|| self.place(moved(&at.x, &step.x))).filter(|next| next.chi2.is_finite())
    }

    /// Nothing lessens χ² any more: good enough if that is less than `sigma` would show.
    fn stuck(
        &self,
        step: LinearSolution,
        at: Place,
        settings: &Settings,
    ) -> Result<NonlinearSolution, NonlinearError> {
        let in_time = self.evaluations < settings.max_steps;
        if in_time && size(&step, &at) <= settings.tolerance {
            return Ok(finish(step, at, self.evaluations));
        }
        Err(self.not_converged(&step, &at))
    }

    fn not_converged(&self, step: &LinearSolution, at: &Place) -> NonlinearError {
        NonlinearError::NotConverged { evaluations: self.evaluations, step: size(step, at) }
    }
}

fn is_done(step: &LinearSolution, at: &Place, smallest: f64, tolerance: f64) -> bool {
    let size = size(step, at);
    let shown = if step.dof > 0 { (at.chi2 / step.dof as f64).sqrt() } else { 1.0 };
    size <= tolerance * shown.min(1.0) || (size <= tolerance && size >= SHRINKS * smallest)
}

/// The largest move in standard uncertainties, less what rounding can cause: of `x`, and of the
/// rows, taken as one rounding of Σ|∂model/∂x·x|.
fn size(step: &LinearSolution, at: &Place) -> f64 {
    let jacobian = &at.point.jacobian;
    let rounding: Vec<f64> = (0..jacobian.nrows())
        .map(|i| at.x.iter().enumerate().map(|(j, x)| (jacobian[(i, j)] * x).abs()).sum::<f64>())
        .collect();
    let relative = step.x.iter().zip(&at.x).enumerate().map(|(j, (dx, x))| {
        let rows: f64 =
            rounding.iter().enumerate().map(|(i, r)| (step.gain[(j, i)] * r).abs()).sum();
        let beyond = dx.abs() - f64::EPSILON * (rows + x.abs());
        if beyond > 0.0 { beyond / step.covariance[(j, j)].sqrt() } else { 0.0 }
    });
    relative.fold(0.0, f64::max)
}

fn moved(x: &[f64], dx: &[f64]) -> Vec<f64> {
    x.iter().zip(dx).map(|(x, dx)| x + dx).collect()
}

fn product(a: &Mat<f64>, x: &[f64]) -> Vec<f64> {
    (0..a.nrows()).map(|i| x.iter().enumerate().map(|(j, x)| a[(i, j)] * x).sum()).collect()
}

fn chi2(residuals: &[f64], sigma: &[f64]) -> f64 {
    residuals.iter().zip(sigma).map(|(r, s)| (r / s).powi(2)).sum()
}

fn finish(linear: LinearSolution, at: Place, evaluations: usize) -> NonlinearSolution {
    let Place { x, point, chi2 } = at;
    let at = LinearSolution { x, residuals: point.residuals, chi2, ..linear };
    NonlinearSolution { at, evaluations }
}
