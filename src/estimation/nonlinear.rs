//! Nonlinear least squares: Gauss–Newton on the linear solver, with Levenberg–Marquardt damping on
//! request (Marquardt 1963: the damping stands on the scaled unknowns).

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
    pub max_steps: usize,
    /// Done when no unknown would move by more than this part of its standard uncertainty.
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
    mut model: impl FnMut(&[f64]) -> Linearised,
) -> Result<NonlinearSolution, NonlinearError> {
    let threshold = settings.rank_threshold;
    let mut x = start.to_vec();
    let mut point = model(&x);
    let mut damping = settings.damping;
    for evaluations in 1..=settings.max_steps {
        let newton = match step(&point, sigma, constraints, threshold) {
            Ok(found) if size(&found, &x) <= settings.tolerance => {
                return Ok(finish(found, x, &point, sigma, evaluations));
            }
            Err(LinearError::Malformed(why)) => return Err(LinearError::Malformed(why).into()),
            found => found,
        };
        let Some(lambda) = damping else {
            x = moved(&x, &newton?.x);
            point = model(&x);
            continue;
        };
        let (damped, ones) = augmented(&point, sigma, lambda);
        let trial = moved(&x, &step(&damped, &ones, constraints, 0.0)?.x);
        let next = model(&trial);
        // Written so that a NaN is refused.
        if chi2(&next.residuals, sigma) <= chi2(&point.residuals, sigma) {
            (x, point) = (trial, next);
            damping = Some(lambda / 3.0);
        } else {
            damping = Some(lambda.max(1e-12) * 2.0);
        }
    }
    let pending = size(&step(&point, sigma, constraints, threshold)?, &x);
    Err(NonlinearError::NotConverged { evaluations: settings.max_steps, step: pending })
}

fn step(
    point: &Linearised,
    sigma: &[f64],
    constraints: Option<MatRef<'_, f64>>,
    rank_threshold: f64,
) -> Result<LinearSolution, LinearError> {
    let a = point.jacobian.as_ref();
    solve(&LinearProblem { a, y: &point.residuals, sigma, constraints, rank_threshold })
}

/// The rows with √λ·(weighted column norm) added below for each unknown, value 0; and their sigmas.
fn augmented(point: &Linearised, sigma: &[f64], lambda: f64) -> (Linearised, Vec<f64>) {
    let a = &point.jacobian;
    let (rows, unknowns) = (a.nrows(), a.ncols());
    let norm = |j: usize| -> f64 {
        let sum: f64 = sigma.iter().enumerate().map(|(i, s)| (a[(i, j)] / s).powi(2)).sum();
        if sum > 0.0 { sum.sqrt() } else { 1.0 }
    };
    let weights: Vec<f64> = (0..unknowns).map(|j| lambda.sqrt() * norm(j)).collect();
    let jacobian = Mat::from_fn(rows + unknowns, unknowns, |i, j| match i {
        i if i < rows => a[(i, j)],
        i if i - rows == j => weights[j],
        _ => 0.0,
    });
    let extended = |values: &[f64], by: f64| -> Vec<f64> {
        values.iter().copied().chain(std::iter::repeat_n(by, unknowns)).collect()
    };
    let residuals = extended(&point.residuals, 0.0);
    (Linearised { residuals, jacobian }, extended(sigma, 1.0))
}

/// The largest move in standard uncertainties, less what rounding of `x` can cause.
fn size(step: &LinearSolution, x: &[f64]) -> f64 {
    let relative = step.x.iter().zip(x).enumerate().map(|(j, (dx, x))| {
        let u = step.covariance[(j, j)].sqrt();
        let beyond = (dx.abs() - 1e-14 * x.abs()).max(0.0);
        if beyond > 0.0 { beyond / u } else { 0.0 }
    });
    relative.fold(0.0, f64::max)
}

fn moved(x: &[f64], dx: &[f64]) -> Vec<f64> {
    x.iter().zip(dx).map(|(x, dx)| x + dx).collect()
}

fn chi2(residuals: &[f64], sigma: &[f64]) -> f64 {
    residuals.iter().zip(sigma).map(|(r, s)| (r / s).powi(2)).sum()
}

fn finish(
    linear: LinearSolution,
    x: Vec<f64>,
    point: &Linearised,
    sigma: &[f64],
    evaluations: usize,
) -> NonlinearSolution {
    let residuals = point.residuals.clone();
    let chi2 = chi2(&residuals, sigma);
    NonlinearSolution { at: LinearSolution { x, residuals, chi2, ..linear }, evaluations }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// y = b1·(1 − exp(−b2·x)): NIST StRD "Misra1a", data and certified values from its file.
    const MISRA1A: [(f64, f64); 14] = [
        (10.07, 77.6),
        (14.73, 114.9),
        (17.94, 141.1),
        (23.93, 190.8),
        (29.61, 239.9),
        (35.18, 289.0),
        (40.02, 332.8),
        (44.82, 378.4),
        (50.76, 434.8),
        (55.05, 477.3),
        (61.01, 536.8),
        (66.40, 593.1),
        (75.47, 689.1),
        (81.78, 760.0),
    ];

    fn misra(b: &[f64]) -> Linearised {
        let model = |x: f64| b[0] * (1.0 - (-b[1] * x).exp());
        Linearised {
            residuals: MISRA1A.iter().map(|(y, x)| y - model(*x)).collect(),
            jacobian: Mat::from_fn(14, 2, |i, j| {
                let x = MISRA1A[i].1;
                if j == 0 { 1.0 - (-b[1] * x).exp() } else { b[0] * x * (-b[1] * x).exp() }
            }),
        }
    }

    #[test]
    fn paper_nist_misra1a_certified_values() {
        let settings = Settings { damping: Some(1e-3), ..Settings::default() };
        let found = minimise(&[500.0, 1e-4], &[1.0; 14], None, &settings, misra).unwrap().at;
        assert!((found.x[0] / 2.389_421_291_8e2 - 1.0).abs() < 1e-9, "{:?}", found.x);
        assert!((found.x[1] / 5.501_564_318_1e-4 - 1.0).abs() < 1e-9, "{:?}", found.x);
        assert!((found.chi2 / 1.245_513_889_4e-1 - 1.0).abs() < 1e-9);
        let scale = (found.chi2 / found.dof as f64).sqrt();
        let deviation = [0, 1].map(|j| scale * found.covariance[(j, j)].sqrt());
        assert!((deviation[0] / 2.707_007_524_1 - 1.0).abs() < 1e-6, "{deviation:?}");
        assert!((deviation[1] / 7.266_868_806_0e-6 - 1.0).abs() < 1e-6, "{deviation:?}");
        // From near, pure Gauss–Newton ends at the same place.
        let near = minimise(&[250.0, 5e-4], &[1.0; 14], None, &Settings::default(), misra).unwrap();
        assert!((near.at.x[0] / found.x[0] - 1.0).abs() < 1e-9);
    }

    #[test]
    fn regress_failures_are_typed() {
        let few = Settings { max_steps: 2, ..Settings::default() };
        let stopped = minimise(&[500.0, 1e-4], &[1.0; 14], None, &few, misra);
        assert!(matches!(stopped, Err(NonlinearError::NotConverged { evaluations: 2, .. })));
        // Only the sum of two unknowns is seen: refused without, solved with the gauge.
        let twice = |x: &[f64]| Linearised {
            residuals: vec![4.0 - (x[0] + x[1]).powi(2); 2],
            jacobian: Mat::from_fn(2, 2, |_, _| 2.0 * (x[0] + x[1])),
        };
        for damping in [None, Some(1e-3)] {
            let settings = Settings { damping, ..Settings::default() };
            let open = minimise(&[1.5, 0.0], &[1.0; 2], None, &settings, twice);
            assert!(matches!(open, Err(NonlinearError::Linear(LinearError::RankDeficient(_)))));
            let gauge = Mat::from_fn(1, 2, |_, j| [1.0, -1.0][j]);
            let fixed =
                minimise(&[1.5, 0.0], &[1.0; 2], Some(gauge.as_ref()), &settings, twice).unwrap();
            assert!((fixed.at.x[0] - 1.75).abs() < 1e-9 && (fixed.at.x[1] - 0.25).abs() < 1e-9);
        }
    }
}
