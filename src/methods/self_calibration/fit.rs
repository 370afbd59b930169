//! Fit of the unknowns to the radii: weighted least squares with explicit gauge, and the second-order correction.

use faer::{Mat, MatRef, Scale};

use super::model::{RadiusObservation, UnknownsLayout};
use super::second_order_correction::SecondOrderCorrection;
use crate::identification::{FitQuality, LinearResponse, ObservationModel, SolvedLinearFit, multiply_vector, rms};
use estimation::linear_least_squares::{self, LinearError, LinearProblem, LinearSolution};

/// Relative threshold of rank decisions for paper 1 (METHODS, conventions).
pub const SELF_CALIBRATION_RANK_THRESHOLD: f64 = 1e-9;
/// Maximum number of iterations of the second-order correction. An error of E changes the correction by about 20 µm
/// times this error divided by the radius, so each iteration reduces the error by a factor of about 1e-3.
const MAX_CORRECTION_ITERATIONS: usize = 8;
/// Largest change of an unknown by the last correction, mm.
const CONVERGENCE_TOLERANCE_MM: f64 = 1e-10;
/// Half width of the numerical derivative by a radius, mm.
const DERIVATIVE_STEP_MM: f64 = 1e-3;

/// The fit of one set of observations.
pub struct SelfCalibrationFit {
    pub layout: UnknownsLayout,
    /// Observations in the order of the rows.
    pub observations: Vec<RadiusObservation>,
    /// Standard uncertainty of each radius, mm.
    pub sigma: Vec<f64>,
    pub design_matrix: Mat<f64>,
    /// Solution without second-order correction.
    pub solution: LinearSolution,
    /// `None`: the correction is switched off.
    pub second_order: Option<SecondOrderCorrection>,
    /// The unknowns, including the second-order correction.
    pub x: Vec<f64>,
}

impl SelfCalibrationFit {
    /// # Errors
    /// The observations do not separate the unknowns. The error contains the inseparable combinations.
    pub fn new(
        layout: UnknownsLayout,
        observations: Vec<RadiusObservation>,
        sigma: Vec<f64>,
        with_second_order: bool,
    ) -> Result<Self, LinearError> {
        let a = layout.design_matrix(&observations);
        let radii: Vec<f64> = observations.iter().map(|observation| observation.along_ray_mm).collect();
        let gauge = layout.gauge_matrix();
        let solution = linear_least_squares::solve_least_squares(&LinearProblem {
            a: a.as_ref(),
            y: &radii,
            sigma: &sigma,
            constraints: Some(gauge.as_ref()),
            rank_threshold: SELF_CALIBRATION_RANK_THRESHOLD,
        })?;
        let bend = with_second_order.then(|| SecondOrderCorrection::new(&layout, &observations));
        let mut fit =
            Self { layout, observations, sigma, design_matrix: a, solution, second_order: bend, x: Vec::new() };
        let x = fit.unknowns_for_each_perturbation(Mat::zeros(1, radii.len()).as_ref());
        fit.x = x.row(0).iter().copied().collect();
        Ok(fit)
    }

    /// Unknowns (trials × unknowns) for changes of the radii (trials × observations, mm). The gain multiplies only
    /// the changes. With whole radii the numerical derivative would amplify their rounding.
    pub fn unknowns_for_each_perturbation(&self, changes: MatRef<'_, f64>) -> Mat<f64> {
        let LinearSolution { x: linear, gain, .. } = &self.solution;
        let mut x = add_to_columns(changes * gain.transpose(), linear);
        let Some(bend) = &self.second_order else { return x };
        let mut unsettled: Vec<usize> = (0..x.nrows()).collect();
        for _ in 0..MAX_CORRECTION_ITERATIONS {
            let mut corrected = changes.to_owned();
            bend.add_second_order_terms(&x, &mut corrected);
            let next = add_to_columns(corrected * gain.transpose(), linear);
            // The result of a converged trial must not depend on the other trials.
            unsettled.retain(|trial| {
                let change = (next.row(*trial) - x.row(*trial)).norm_max();
                x.row_mut(*trial).copy_from(next.row(*trial));
                change >= CONVERGENCE_TOLERANCE_MM
            });
            if unsettled.is_empty() {
                break;
            }
        }
        x
    }

    /// Radii with the second-order terms of the solution, minus model, mm.
    pub fn residuals(&self) -> Vec<f64> {
        let x = Mat::from_fn(1, self.x.len(), |_, j| self.x[j]);
        let mut radii = Mat::from_fn(1, self.observations.len(), |_, i| self.observations[i].along_ray_mm);
        if let Some(bend) = &self.second_order {
            bend.add_second_order_terms(&x, &mut radii);
        }
        let model = multiply_vector(&self.design_matrix, &self.x);
        radii.row(0).iter().zip(model).map(|(radius, model)| radius - model).collect()
    }

    /// Quality of the fit without second-order correction, except the RMS, which is that of `residuals`. The gauge
    /// constraints reduce the number of unknowns.
    pub fn quality_of_fit(&self, residuals: &[f64]) -> FitQuality {
        let unknowns = self.layout.unknown_count() - self.layout.gauge_matrix().nrows();
        FitQuality {
            unknown_count: unknowns,
            residual_rms_mm: rms(residuals),
            ..FitQuality::from_linear(&self.solution)
        }
    }

    /// Unknowns × observations: the derivative of the complete solution by each radius, including second order. For an
    /// eccentric part this derivative differs from the linear gain by about W′/L, 2 % per mm of eccentricity.
    fn sensitivity(&self) -> Mat<f64> {
        if self.second_order.is_none() {
            return self.solution.gain.clone();
        }
        let rows = self.observations.len();
        let moved =
            |by: f64| self.unknowns_for_each_perturbation((Scale(by) * Mat::<f64>::identity(rows, rows)).as_ref());
        let (up, down) = (moved(DERIVATIVE_STEP_MM), moved(-DERIVATIVE_STEP_MM));
        (up - down).transpose() * Scale(0.5 / DERIVATIVE_STEP_MM)
    }
}

/// A fit with the derivative of its solution.
pub struct FitWithSensitivity<'a> {
    fit: &'a SelfCalibrationFit,
    /// Derivative of the unknowns by the radii, unknowns × observations.
    pub sensitivity: Mat<f64>,
}

impl<'a> FitWithSensitivity<'a> {
    pub fn new(fit: &'a SelfCalibrationFit) -> Self {
        Self { fit, sensitivity: fit.sensitivity() }
    }

    /// The fit for leverage and changes of residuals: at the corrected solution, but with the gain of the solution
    /// without second-order correction.
    fn solved_linear_fit(&self) -> SolvedLinearFit<'_> {
        let SelfCalibrationFit { x, design_matrix, sigma, solution, .. } = self.fit;
        SolvedLinearFit { x, design_matrix, sigma, gain: &solution.gain }
    }
}

impl ObservationModel for FitWithSensitivity<'_> {
    fn observation_count(&self) -> usize {
        self.fit.design_matrix.nrows()
    }

    fn unknown_count(&self) -> usize {
        self.fit.design_matrix.ncols()
    }

    fn linear_response(&self, change: &[f64]) -> LinearResponse {
        let residuals = self.solved_linear_fit().residual_change(change);
        LinearResponse { unknown_changes: multiply_vector(&self.sensitivity, change), residual_changes: residuals }
    }

    fn leverage(&self) -> Vec<f64> {
        self.solved_linear_fit().leverage()
    }

    fn unknowns_for_each_perturbation(&self, changes: MatRef<'_, f64>) -> Mat<f64> {
        let unknowns = self.unknown_count();
        self.evaluate_each_perturbation(changes, Mat::<f64>::identity(unknowns, unknowns).as_ref())
    }

    /// First-order solution, then one second-order correction at this solution. The correction reduces the remaining
    /// error of about 1e-8 mm to 2 % or less.
    fn evaluate_each_perturbation(&self, changes: MatRef<'_, f64>, slopes: MatRef<'_, f64>) -> Mat<f64> {
        let SelfCalibrationFit { x, second_order: bend, solution, .. } = self.fit;
        let mut radii = changes.to_owned();
        if let Some(bend) = bend {
            let near = add_to_columns(changes * self.sensitivity.transpose(), x);
            bend.add_second_order_terms(&near, &mut radii);
        }
        let gain = slopes * &solution.gain;
        let at_readings = slopes * MatRef::from_column_major_slice(&solution.x, slopes.ncols(), 1);
        add_to_columns(radii * gain.transpose(), at_readings.col_as_slice(0))
    }
}

/// `columns` (trials × n) plus one number per column.
fn add_to_columns(mut columns: Mat<f64>, by: &[f64]) -> Mat<f64> {
    for (j, by) in by.iter().enumerate() {
        columns.col_as_slice_mut(j).iter_mut().for_each(|value| *value += by);
    }
    columns
}
