//! Parameters of all runs with their joint covariance.

use nalgebra::{DMatrix, DVector};

use super::MeasuredRun;
use super::joint_sources::{JointSource, joint_sources};
use super::parameter_rows::{ParameterRow, ParameterRows};

/// Minimum share of the standard uncertainty of a sum for a parameter to count in the degrees of freedom.
const MIN_DOF_CONTRIBUTION_SHARE: f64 = 0.01;

/// The parameters of all runs and their joint covariance, in the scales of the unknowns.
pub struct JointResults {
    /// Numbers of the runs, ascending.
    pub runs: Vec<i64>,
    pub rows: ParameterRows,
    /// All sources with known effects by draw, also those that only one run contains.
    pub sources: Vec<JointSource>,
    /// Covariance from all sources that are independent in each run.
    run_specific_covariance: DMatrix<f64>,
    /// Degrees of freedom of the parameter of each row; infinite if its run states none.
    dofs: Vec<f64>,
    /// Joint covariance of the rows: run-specific covariance plus that by `sources`, which correlates the runs.
    pub covariance: DMatrix<f64>,
}

impl JointResults {
    /// `runs`: checked, ascending.
    pub fn new(runs: &[MeasuredRun<'_>]) -> Self {
        let rows = ParameterRows::new(runs);
        let separate = rows.covariance_without_correlation(runs);
        let mut own_covariance = separate.clone();
        for (run_index, run) in runs.iter().enumerate() {
            for effect in run.source_effects {
                if let Some(changes) = rows.changes_by_source(run, run_index, &effect.source) {
                    own_covariance -= &changes * changes.transpose();
                }
            }
        }
        let sources = joint_sources(&rows, runs);
        let covariance = sources.iter().fold(own_covariance.clone(), |sum, source| {
            let changes = &source.changes;
            sum + changes * changes.transpose()
        });
        let dofs = rows.rows.iter().map(|row| dof_of_row(&rows, runs[row.run_index], row)).collect();
        let runs = runs.iter().map(|run| run.number).collect();
        Self { runs, rows, sources, run_specific_covariance: own_covariance, dofs, covariance }
    }

    /// Variance and degrees of freedom of the sum `coefficients`·values. The degrees of freedom are the smallest of the
    /// parameters that contribute: those of a sum of independent parts are not smaller (JCGM 100, G.4.1).
    pub fn variance_and_dof(&self, coefficients: &DVector<f64>) -> VarianceAndDof {
        let own = coefficients.dot(&(&self.run_specific_covariance * coefficients)).max(0.0);
        let shared: f64 = self.sources.iter().map(|source| source.changes.tr_mul(coefficients).norm_squared()).sum();
        let variance = own + shared;
        let contributes = |row: &usize| {
            let part = coefficients[*row].powi(2) * self.covariance[(*row, *row)];
            part > MIN_DOF_CONTRIBUTION_SHARE.powi(2) * variance
        };
        let rows = (0..self.dofs.len()).filter(contributes);
        VarianceAndDof {
            run_specific_variance: own,
            variance,
            dof: rows.map(|row| self.dofs[row]).fold(f64::INFINITY, f64::min),
        }
    }
}

fn dof_of_row(rows: &ParameterRows, run: MeasuredRun<'_>, row: &ParameterRow) -> f64 {
    let symbol = &rows.unknowns[row.unknown_index].symbol;
    let parameter = run.estimate.parameters.iter().find(|own| own.symbol == *symbol);
    parameter.and_then(|own| own.dof).unwrap_or(f64::INFINITY)
}

/// Variance of a sum of parameters.
pub struct VarianceAndDof {
    /// Part from the sources that are independent in each run.
    pub run_specific_variance: f64,
    pub variance: f64,
    /// Smallest degrees of freedom of the parameters that contribute.
    pub dof: f64,
}
