//! Interface of a solved observation model for the propagation of uncertainty.

use estimation::linear_least_squares::{LinearSolution, RankAnalysis};
use estimation::nonlinear_least_squares::NonlinearSolution;
use faer::{Mat, MatRef};
use nalgebra::Vector3;

use super::checked_measurement::MeasurementToCheck;

/// Figures of a solved problem that the estimate reports.
#[derive(Debug, Clone, Copy)]
pub struct FitQuality {
    pub rank: usize,
    /// Number of free unknowns, without those that the gauge fixes.
    pub unknown_count: usize,
    /// Condition number σmax/σmin of the column-scaled design.
    pub condition_number: f64,
    /// Degrees of freedom of the fit: rows minus rank.
    pub dof: usize,
    /// Root mean square of the unweighted residuals of all observations (for points: of all coordinates), mm.
    pub residual_rms_mm: f64,
}

impl FitQuality {
    /// Figures of a linear fit without gauge.
    pub fn from_linear(solution: &LinearSolution) -> Self {
        Self {
            rank: solution.rank,
            unknown_count: solution.x.len(),
            condition_number: solution.condition,
            dof: solution.dof,
            residual_rms_mm: rms(&solution.residuals),
        }
    }

    /// Figures of a nonlinear fit of points, of full rank. `point_residuals_mm`: residual of each point, mm.
    pub fn from_nonlinear_fit(
        survey: &RankAnalysis,
        minimum: &NonlinearSolution,
        point_residuals_mm: &[Vector3<f64>],
    ) -> Self {
        let unknowns = minimum.x.len();
        let coordinates: Vec<f64> = point_residuals_mm.iter().flatten().copied().collect();
        Self {
            rank: survey.rank,
            unknown_count: unknowns,
            condition_number: survey.condition,
            dof: minimum.residuals.len().saturating_sub(unknowns),
            residual_rms_mm: rms(&coordinates),
        }
    }
}

/// Root mean square of the values.
pub fn rms(values: &[f64]) -> f64 {
    let squares: f64 = values.iter().map(|value| value * value).sum();
    (squares / values.len().max(1) as f64).sqrt()
}

/// A solved observation model with its residuals.
pub struct SolvedModel<'a> {
    pub model: &'a dyn ObservationModel,
    /// Weighted residuals (divided by the standard uncertainties), measured minus model.
    pub weighted_residuals: &'a [f64],
    /// Whether the sizes of the sources that the residuals scale are declared; otherwise they are assumed.
    pub has_declared_source_sizes: bool,
    pub fit_quality: FitQuality,
    /// Measurements that are checked for outliers; observations outside of them are not checked.
    pub measurements: &'a [MeasurementToCheck],
}

/// First-order effect of a change of the observations.
#[derive(Debug, Clone)]
pub struct LinearResponse {
    /// Change of the unknowns, in their units.
    pub unknown_changes: Vec<f64>,
    /// Change of the weighted residuals, one entry per residual of the [`SolvedModel`].
    pub residual_changes: Vec<f64>,
}

/// The unknowns as a function of the observations near the readings. The unknowns include those that a source
/// changes directly.
pub trait ObservationModel: Sync {
    /// Number of observations.
    fn observation_count(&self) -> usize;

    /// Number of unknowns.
    fn unknown_count(&self) -> usize;

    /// First-order effect of a change of the observations, mm, one entry for each of all observations.
    fn linear_response(&self, change: &[f64]) -> LinearResponse;

    /// Leverage of each weighted residual, 0 to 1: the share of a deviation that its own row absorbs. Empty:
    /// negligible.
    fn leverage(&self) -> Vec<f64> {
        Vec::new()
    }

    /// Unknowns (trials × unknowns), not their changes, for changes of the observations (trials × observations, mm). A
    /// nonlinear model solves each trial nonlinearly.
    fn unknowns_for_each_perturbation(&self, changes: MatRef<'_, f64>) -> Mat<f64>;

    /// Linear functions of the unknowns of [`Self::unknowns_for_each_perturbation`]: trials × functions. `slopes`:
    /// functions × unknowns.
    fn evaluate_each_perturbation(&self, changes: MatRef<'_, f64>, slopes: MatRef<'_, f64>) -> Mat<f64> {
        self.unknowns_for_each_perturbation(changes) * slopes.transpose()
    }
}

/// Weighted residuals of a nonlinear least-squares problem as a function of its unknowns and observations.
pub trait ObservationEquation: Sync {
    /// Number of observations.
    fn observation_count(&self) -> usize;

    /// Weighted residuals, measured minus model, at the unknowns `x` for observations changed by `change`
    /// (mm, one entry for each of all observations).
    fn weighted_residuals(&self, x: &[f64], change: &[f64]) -> Vec<f64>;

    /// First-order change of the weighted residuals by `change` at fixed unknowns, with the sign of measured
    /// minus model.
    fn weighted_residual_change(&self, change: &[f64]) -> Vec<f64>;
}

/// Number of Gauss–Newton steps to a nearby solution with one Jacobian. After the second step the error is of third
/// order in a change that the model explains. For a change that the model does not explain, an error of curvature times
/// residuals remains.
const GAUSS_NEWTON_STEPS: usize = 2;

/// A problem solved by [`estimation::nonlinear_least_squares::minimise_squares`].
pub struct NonlinearFit<'a, E> {
    pub equation: &'a E,
    pub minimum: &'a NonlinearSolution,
}

impl<E: ObservationEquation> NonlinearFit<'_, E> {
    /// All unknowns, not their changes, of the fit to observations that are each changed by `change` (mm).
    pub fn unknowns_for_changed_observations(&self, change: &[f64]) -> Vec<f64> {
        let mut x = self.minimum.x.clone();
        for _ in 0..GAUSS_NEWTON_STEPS {
            let step = self.minimum.factorisation.solve(&self.equation.weighted_residuals(&x, change));
            x.iter_mut().zip(step).for_each(|(x, step)| *x += step);
        }
        x
    }
}

impl<E: ObservationEquation> ObservationModel for NonlinearFit<'_, E> {
    fn observation_count(&self) -> usize {
        self.equation.observation_count()
    }

    fn unknown_count(&self) -> usize {
        self.minimum.x.len()
    }

    fn linear_response(&self, change: &[f64]) -> LinearResponse {
        let rows = self.equation.weighted_residual_change(change);
        let (unknowns, residuals) = self.minimum.factorisation.solution_and_residuals(rows);
        LinearResponse { unknown_changes: unknowns, residual_changes: residuals }
    }

    fn leverage(&self) -> Vec<f64> {
        self.minimum.factorisation.leverage()
    }

    fn unknowns_for_each_perturbation(&self, changes: MatRef<'_, f64>) -> Mat<f64> {
        solve_each_trial(changes, self.unknown_count(), |change| self.unknowns_for_changed_observations(change))
    }
}

/// Solves trial by trial: `solve` gives `unknowns` numbers for a row of `changes`. The result is trials ×
/// unknowns.
pub fn solve_each_trial(changes: MatRef<'_, f64>, unknowns: usize, solve: impl Fn(&[f64]) -> Vec<f64>) -> Mat<f64> {
    let mut all = Mat::zeros(changes.nrows(), unknowns);
    for trial in 0..changes.nrows() {
        let change: Vec<f64> = changes.row(trial).iter().copied().collect();
        solve(&change).into_iter().enumerate().for_each(|(j, value)| all[(trial, j)] = value);
    }
    all
}

/// The solution x = gain·y of a linear fit y = a·x, with or without constraints.
pub struct SolvedLinearFit<'a> {
    pub x: &'a [f64],
    /// Design matrix, observations × unknowns.
    pub design_matrix: &'a Mat<f64>,
    /// Standard uncertainty of each observation, mm.
    pub sigma: &'a [f64],
    /// Gain matrix, unknowns × observations.
    pub gain: &'a Mat<f64>,
}

impl SolvedLinearFit<'_> {
    /// Change of the weighted residuals if the unknowns follow the gain.
    pub fn residual_change(&self, change: &[f64]) -> Vec<f64> {
        let explained = multiply_vector(self.design_matrix, &multiply_vector(self.gain, change));
        let rows = change.iter().zip(explained).zip(self.sigma);
        rows.map(|((change, explained), sigma)| (change - explained) / sigma).collect()
    }
}

impl ObservationModel for SolvedLinearFit<'_> {
    fn observation_count(&self) -> usize {
        self.design_matrix.nrows()
    }

    fn unknown_count(&self) -> usize {
        self.design_matrix.ncols()
    }

    fn linear_response(&self, change: &[f64]) -> LinearResponse {
        let residuals = self.residual_change(change);
        LinearResponse { unknown_changes: multiply_vector(self.gain, change), residual_changes: residuals }
    }

    fn leverage(&self) -> Vec<f64> {
        let own = |i: usize| (0..self.unknown_count()).map(|j| self.design_matrix[(i, j)] * self.gain[(j, i)]).sum();
        (0..self.observation_count()).map(own).collect()
    }

    fn unknowns_for_each_perturbation(&self, changes: MatRef<'_, f64>) -> Mat<f64> {
        let mut x = changes * self.gain.transpose();
        for (j, solved) in self.x.iter().enumerate() {
            x.col_as_slice_mut(j).iter_mut().for_each(|x| *x += solved);
        }
        x
    }
}

/// Matrix × vector.
pub fn multiply_vector(matrix: &Mat<f64>, vector: &[f64]) -> Vec<f64> {
    let mut product = vec![0.0; matrix.nrows()];
    for (j, value) in vector.iter().enumerate().filter(|(_, value)| **value != 0.0) {
        product.iter_mut().zip(matrix.col_as_slice(j)).for_each(|(sum, m)| *sum += m * value);
    }
    product
}
