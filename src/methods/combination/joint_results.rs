//! Parameters of all runs with their joint covariance.

use nalgebra::{DMatrix, DVector};

use super::MeasuredRun;
use super::joint_sources::{JointSource, joint_sources};
use super::result_rows::ResultRows;
use estimation::coverage::effective_dof;

/// The parameters of all runs and their joint covariance, in the scales of the unknowns.
pub struct JointResults {
    /// Numbers of the runs, ascending.
    pub runs: Vec<i64>,
    pub rows: ResultRows,
    pub sources: Vec<JointSource>,
    /// Covariance from all sources that are independent in each run.
    own_covariance: DMatrix<f64>,
    /// Degrees of freedom of the own part of each run.
    own_dofs: Vec<f64>,
    /// Joint covariance.
    pub covariance: DMatrix<f64>,
}

impl JointResults {
    /// `runs`: checked, ascending.
    pub fn new(runs: &[MeasuredRun<'_>]) -> Self {
        let rows = ResultRows::new(runs);
        let separate = rows.covariance_without_correlation(runs);
        let mut own_covariance = separate.clone();
        for (run_index, run) in runs.iter().enumerate() {
            for effect in run.source_effects {
                if let Some(changes) = rows.changes_by_source(run, run_index, &effect.source) {
                    own_covariance -= &changes * changes.transpose();
                }
            }
        }
        let own_share = own_covariance.diagonal().component_div(&separate.diagonal());
        let own_dofs =
            runs.iter().enumerate().map(|(run_index, run)| own_dof(&rows, run, run_index, &own_share)).collect();
        let sources = joint_sources(&rows, runs);
        let covariance = sources.iter().fold(own_covariance.clone(), |sum, source| {
            let changes = &source.changes;
            sum + changes * changes.transpose()
        });
        let runs = runs.iter().map(|run| run.number).collect();
        Self { runs, rows, sources, own_covariance, own_dofs, covariance }
    }

    /// Variance and degrees of freedom of the sum `coefficients`·values (JCGM 100, G.4). The own part of each run is
    /// one component with the smallest degrees of freedom of its parameters; shareable sources have infinitely many.
    pub fn variance_and_dof(&self, coefficients: &DVector<f64>) -> VarianceAndDof {
        let mut components = Vec::new();
        for (run_index, dof) in self.own_dofs.iter().enumerate() {
            let is_of_run = |row: usize| f64::from(u8::from(self.rows.rows[row].run_index == run_index));
            let of_run = DVector::from_fn(self.rows.count(), |row, _| is_of_run(row) * coefficients[row]);
            components.push((of_run.dot(&(&self.own_covariance * &of_run)).max(0.0), *dof));
        }
        let own: f64 = components.iter().map(|(variance, _)| variance).sum();
        let shared: f64 = self.sources.iter().map(|source| source.changes.tr_mul(coefficients).norm_squared()).sum();
        components.push((shared, f64::INFINITY));
        VarianceAndDof { own, variance: own + shared, dof: effective_dof(&components) }
    }
}

/// Smallest degrees of freedom of the own part of a run over its parameters. The shareable sources have infinitely
/// many: by the Welch–Satterthwaite equation (JCGM 100, G.4) a share s of the variance with degrees of freedom ν gives
/// the parameter ν/s². `own_share`: s of each row.
fn own_dof(rows: &ResultRows, run: &MeasuredRun<'_>, run_index: usize, own_share: &DVector<f64>) -> f64 {
    let own_rows = rows.rows.iter().zip(own_share).filter(|(row, _)| row.run_index == run_index);
    let dofs = own_rows.filter_map(|(row, share)| {
        let symbol = &rows.unknowns[row.unknown_index].symbol;
        let parameter = run.estimate.parameters.iter().find(|own| own.symbol == *symbol)?;
        Some(parameter.dof? * share.powi(2))
    });
    dofs.fold(f64::INFINITY, f64::min)
}

/// Variance of a sum of parameters.
pub struct VarianceAndDof {
    /// Part from the sources that are independent in each run.
    pub own: f64,
    pub variance: f64,
    /// Effective degrees of freedom.
    pub dof: f64,
}
