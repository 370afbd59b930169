//! Tests of the core against hand calculation, closed forms and published examples.

mod declared;
mod estimates;
mod known_motions;
mod outliers;
mod propagation;
mod sources;
mod spectrum;
mod trials;

use faer::Mat;

use super::{FitQuality, LinearFit, ObservationModel, SolvedModel};

/// The mean of observations of one quantity: x = Σy/n; each observation has standard uncertainty 1.
pub struct Mean {
    x: Vec<f64>,
    a: Mat<f64>,
    sigma: Vec<f64>,
    gain: Mat<f64>,
    pub residuals: Vec<f64>,
}

impl Mean {
    pub fn of(readings: &[f64]) -> Self {
        let count = readings.len();
        let mean = readings.iter().sum::<f64>() / count as f64;
        Self {
            x: vec![mean],
            a: Mat::from_fn(count, 1, |_, _| 1.0),
            sigma: vec![1.0; count],
            gain: Mat::from_fn(1, count, |_, _| 1.0 / count as f64),
            residuals: readings.iter().map(|reading| reading - mean).collect(),
        }
    }

    pub fn fit(&self) -> LinearFit<'_> {
        let Self { x, a, sigma, gain, .. } = self;
        LinearFit { x, design_matrix: a, sigma, gain }
    }

    pub fn solution<'a>(&'a self, fit: &'a LinearFit<'a>, has_declared_sizes: bool) -> SolvedModel<'a> {
        solution(fit, &self.residuals, has_declared_sizes)
    }
}

/// A solution of full rank.
pub fn solution<'a>(
    model: &'a dyn ObservationModel,
    residuals: &'a [f64],
    has_declared_sizes: bool,
) -> SolvedModel<'a> {
    let rank = model.unknown_count();
    let dof = residuals.len().saturating_sub(rank);
    let figures = FitQuality { rank, unknowns: rank, condition: 1.0, dof, residual_rms_mm: 0.0 };
    SolvedModel { model, weighted_residuals: residuals, has_declared_sizes, fit_quality: figures, measurements: &[] }
}

pub fn assert_near(found: f64, expected: f64, tolerance: f64) {
    assert!((found - expected).abs() <= tolerance, "{found} instead of {expected}");
}
