//! The least-squares problem as a function of its observations.

use nalgebra::Vector3;

use super::{Measured, Problem, put};
use crate::identification::ObservationEquation;

/// Observations: X, Y, Z of each measurement (machine frame, mm), then each certified length (mm).
pub struct Measurement<'a> {
    pub problem: &'a Problem,
    pub measured: &'a Measured,
}

impl ObservationEquation for Measurement<'_> {
    fn observations(&self) -> usize {
        self.problem.rows_count()
    }

    fn residuals(&self, x: &[f64], change: &[f64]) -> Vec<f64> {
        let mut measured = self.measured.clone();
        let (of_centres, of_lengths) = change.split_at(3 * measured.xyz.len());
        for (xyz, by) in measured.xyz.iter_mut().zip(of_centres.chunks_exact(3)) {
            *xyz += Vector3::from_column_slice(by);
        }
        measured.lengths.iter_mut().zip(of_lengths).for_each(|(length, by)| *length += by);
        self.problem.residuals(x, &measured)
    }

    /// The change with the weights, which are those of the machine without errors.
    fn weighted_change(&self, change: &[f64]) -> Vec<f64> {
        let problem = self.problem;
        let mut rows = vec![0.0; problem.rows_count()];
        let (of_centres, of_lengths) = change.split_at(3 * problem.seen.len());
        for (i, by) in of_centres.chunks_exact(3).enumerate() {
            let weighted = problem.seen[i].whitening * Vector3::from_column_slice(by);
            put(&mut rows, problem.row_of(i), -weighted);
        }
        for (i, by) in of_lengths.iter().enumerate() {
            rows[problem.row_of_bar(i)] = by / problem.bars[i].u_mm;
        }
        rows
    }
}
