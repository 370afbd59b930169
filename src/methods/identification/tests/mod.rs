//! Tests of the core against hand calculation, closed forms and published examples.

mod declared_sources;
mod estimates;
mod known_motions;
mod monte_carlo_trials;
mod outliers;
mod propagation;
mod spectrum;
mod uncertainty_sources;

use faer::Mat;

use super::{FitQuality, ObservationModel, SolvedLinearFit, SolvedModel};

/// The mean of observations of one quantity: x = Σy/n; each observation has standard uncertainty 1.
pub struct MeanModel {
    x: Vec<f64>,
    design_matrix: Mat<f64>,
    sigma: Vec<f64>,
    gain: Mat<f64>,
    pub residuals: Vec<f64>,
}

impl MeanModel {
    pub fn from_readings(readings: &[f64]) -> Self {
        let count = readings.len();
        let mean = readings.iter().sum::<f64>() / count as f64;
        Self {
            x: vec![mean],
            design_matrix: Mat::from_fn(count, 1, |_, _| 1.0),
            sigma: vec![1.0; count],
            gain: Mat::from_fn(1, count, |_, _| 1.0 / count as f64),
            residuals: readings.iter().map(|reading| reading - mean).collect(),
        }
    }

    pub fn solved_linear_fit(&self) -> SolvedLinearFit<'_> {
        let Self { x, design_matrix: a, sigma, gain, .. } = self;
        SolvedLinearFit { x, design_matrix: a, sigma, gain }
    }

    pub fn solved_model_of_full_rank<'a>(
        &'a self,
        fit: &'a SolvedLinearFit<'a>,
        has_declared_sizes: bool,
    ) -> SolvedModel<'a> {
        solved_model_of_full_rank(fit, &self.residuals, has_declared_sizes)
    }
}

/// A solution of full rank.
pub fn solved_model_of_full_rank<'a>(
    model: &'a dyn ObservationModel,
    residuals: &'a [f64],
    has_declared_sizes: bool,
) -> SolvedModel<'a> {
    let rank = model.unknown_count();
    let dof = residuals.len().saturating_sub(rank);
    let figures = FitQuality { rank, unknown_count: rank, condition_number: 1.0, dof, residual_rms_mm: 0.0 };
    SolvedModel {
        model,
        weighted_residuals: residuals,
        has_declared_source_sizes: has_declared_sizes,
        fit_quality: figures,
        measurements: &[],
    }
}

pub fn assert_near(found: f64, expected: f64, tolerance: f64) {
    assert!((found - expected).abs() <= tolerance, "{found} instead of {expected}");
}
