//! Generalized least squares of the parameters of several runs.

use nalgebra::{DMatrix, DVector};

use super::joint_results::JointResults;

/// Solution for the unknowns that the selected runs contain.
pub struct JointSolution {
    /// Indices of the unknowns, ascending.
    pub unknown_indices: Vec<usize>,
    /// Values of the unknowns in the order of `unknown_indices`, each divided by its scale.
    pub values: DVector<f64>,
    /// Derivatives of `values` by all rows; zero for rows of other runs.
    pub gain: DMatrix<f64>,
    /// χ² of the residuals with the joint covariance.
    pub chi2: f64,
    /// Degrees of freedom of `chi2`: rows minus unknowns.
    pub dof: usize,
}

impl JointSolution {
    /// Position of an unknown in `values`.
    pub fn position(&self, unknown_index: usize) -> Option<usize> {
        self.unknown_indices.iter().position(|own| *own == unknown_index)
    }
}

/// Solves y = A·x with the covariance V of y over the rows of the selected runs: x = (AᵀV⁻¹A)⁻¹AᵀV⁻¹·y.
/// `None`: V is singular.
pub fn solve_selected_runs(joint: &JointResults, is_selected: &[bool]) -> Option<JointSolution> {
    let rows: Vec<usize> = (0..joint.rows.count()).filter(|row| is_selected[joint.rows.rows[*row].run_index]).collect();
    let mut unknown_indices: Vec<usize> = rows.iter().map(|row| joint.rows.rows[*row].unknown_index).collect();
    unknown_indices.sort_unstable();
    unknown_indices.dedup();
    let covariance = DMatrix::from_fn(rows.len(), rows.len(), |i, j| joint.covariance[(rows[i], rows[j])]);
    let y = DVector::from_fn(rows.len(), |i, _| joint.rows.values[rows[i]]);
    let is_of_unknown = |i: usize, j: usize| joint.rows.rows[rows[i]].unknown_index == unknown_indices[j];
    let design = DMatrix::from_fn(rows.len(), unknown_indices.len(), |i, j| f64::from(u8::from(is_of_unknown(i, j))));
    let root = covariance.cholesky()?;
    let weighted_design = root.solve(&design);
    let normal = design.tr_mul(&weighted_design).cholesky()?;
    let gain = normal.solve(&weighted_design.transpose());
    let values = &gain * &y;
    let residuals = &y - &design * &values;
    let mut gain_by_all_rows = DMatrix::zeros(unknown_indices.len(), joint.rows.count());
    for (i, row) in rows.iter().enumerate() {
        gain_by_all_rows.set_column(*row, &gain.column(i));
    }
    Some(JointSolution {
        chi2: residuals.dot(&root.solve(&residuals)),
        dof: rows.len() - unknown_indices.len(),
        unknown_indices,
        values,
        gain: gain_by_all_rows,
    })
}
