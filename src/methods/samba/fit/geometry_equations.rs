//! The least-squares problem as a function of its observations.

use nalgebra::Vector3;

use super::{GeometryProblem, ObservedValues, set_vector};
use crate::identification::ObservationEquation;

/// Observations: X, Y, Z of each measurement (machine frame, mm), then each certified length (mm).
pub struct GeometryEquations<'a> {
    pub problem: &'a GeometryProblem,
    pub measured: &'a ObservedValues,
}

impl ObservationEquation for GeometryEquations<'_> {
    fn observation_count(&self) -> usize {
        self.problem.row_count()
    }

    fn weighted_residuals(&self, x: &[f64], change: &[f64]) -> Vec<f64> {
        let mut measured = self.measured.clone();
        let (of_centres, of_lengths) = change.split_at(3 * measured.centre_axes_mm.len());
        for (xyz, by) in measured.centre_axes_mm.iter_mut().zip(of_centres.chunks_exact(3)) {
            *xyz += Vector3::from_column_slice(by);
        }
        measured.lengths_mm.iter_mut().zip(of_lengths).for_each(|(length, by)| *length += by);
        self.problem.weighted_residuals(x, &measured)
    }

    /// The weighted change. The weights are those of the machine without errors.
    fn weighted_residual_change(&self, change: &[f64]) -> Vec<f64> {
        let problem = self.problem;
        let mut rows = vec![0.0; problem.row_count()];
        let (of_centres, of_lengths) = change.split_at(3 * problem.measurements.len());
        for (i, by) in of_centres.chunks_exact(3).enumerate() {
            let weighted = problem.measurements[i].whitening * Vector3::from_column_slice(by);
            set_vector(&mut rows, problem.first_row_of_measurement(i), -weighted);
        }
        for (i, by) in of_lengths.iter().enumerate() {
            rows[problem.row_of_length(i)] = by / problem.certified_lengths[i].u_mm;
        }
        rows
    }
}
