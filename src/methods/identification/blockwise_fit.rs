//! Least squares of independent blocks of unknowns, such as the harmonics of periodic functions. In each
//! block only the directions that the rows determine are solved.

use estimation::linear_least_squares::{
    self, LinearProblem, LinearSolution, RANK_THRESHOLD, RankAnalysis, cholesky_lower,
};
use estimation::null_space_names::name_null_space;
use estimation::thin_svd::ThinSvd;
use faer::{Mat, MatRef};

use super::harmonics::function_over_harmonic_orders;
use super::observation_model::{FitQuality, LinearResponse, ObservationModel, SolvedModel, multiply_vector, rms};
use super::outputs::slope_of_unknown;
use super::uncertainty_source::{ObservationEffect, ObservationSpanChange, ResidualTreatment, UncertaintySource};
use crate::IdentifyError;
use machine::record::estimate::{EstimatedFunction, Unit};

/// Maximum relative component of an identifiable output along an undetermined direction.
const MAX_UNDETERMINED_SHARE: f64 = 1e-7;

/// Equations of one independent block of unknowns, e.g. of one harmonic.
pub struct BlockEquations {
    /// Design matrix, observations × unknowns.
    pub design_matrix: Mat<f64>,
    /// Names of the unknowns, in the order of the columns of the design matrix.
    pub unknown_names: Vec<String>,
    pub observations_mm: Vec<f64>,
    /// Standard uncertainty of each observation, mm.
    pub sigma_mm: Vec<f64>,
    /// Group index of each observation, from 0. The observations of each group are reduced separately from the other
    /// groups.
    pub reduction_group_indices: Vec<usize>,
}

/// Solution of one block of unknowns. Before the fit the observations of each group are reduced to the components that
/// the unknowns can explain. No unknown affects the other components of the residuals.
pub struct BlockFit {
    /// Reduction matrix, reduced observations (of standard uncertainty 1) × observations, 1/mm.
    pub reduction_matrix: Mat<f64>,
    /// Design matrix, reduced observations × unknowns.
    pub reduced_design_matrix: Mat<f64>,
    /// Solution for the reduced observations, also its residuals and gain.
    pub solution: LinearSolution,
    /// Unknowns × nullity: the directions that the rows do not determine. The solution has no component along
    /// them.
    pub null_space: Mat<f64>,
    /// Names of the undetermined directions.
    pub undetermined_names: Vec<String>,
    /// Residuals of all observations, measured minus model, mm.
    residuals_mm: Vec<f64>,
    /// Σ(residual/σ)² of all observations, before the reduction.
    pub chi2: f64,
    /// Degrees of freedom of `chi2`: number of observations minus rank.
    pub dof: usize,
}

impl BlockFit {
    fn new(equations: &BlockEquations) -> Result<Self, IdentifyError> {
        let BlockEquations {
            design_matrix: full, unknown_names: names, observations_mm: observed_mm, sigma_mm, ..
        } = equations;
        let survey =
            linear_least_squares::analyse_rank(full.as_ref(), None, RANK_THRESHOLD).map_err(numerical_error)?;
        let RankAnalysis { null_space, rank, .. } = survey;
        let constraints = null_space.transpose().to_owned();
        let reduction = reduction_matrix(equations);
        let design = &reduction * full;
        let problem = LinearProblem {
            a: design.as_ref(),
            y: &multiply_vector(&reduction, observed_mm),
            sigma: &vec![1.0; design.nrows()],
            constraints: (constraints.nrows() > 0).then_some(constraints.as_ref()),
            rank_threshold: RANK_THRESHOLD,
        };
        let solution = linear_least_squares::solve_least_squares(&problem).map_err(numerical_error)?;
        let explained = multiply_vector(full, &solution.x);
        let residuals_mm: Vec<f64> = observed_mm.iter().zip(explained).map(|(o, e)| o - e).collect();
        Ok(Self {
            undetermined_names: name_null_space(null_space.as_ref(), names),
            chi2: residuals_mm.iter().zip(sigma_mm).map(|(r, sigma)| (r / sigma).powi(2)).sum(),
            dof: observed_mm.len() - rank,
            residuals_mm,
            reduction_matrix: reduction,
            reduced_design_matrix: design,
            solution,
            null_space,
        })
    }

    /// Whether the rows determine an output with the derivative `slope` by the unknowns of the block.
    pub fn determines_output(&self, slope: &[f64]) -> bool {
        let largest = slope.iter().fold(0.0, |largest: f64, s| largest.max(s.abs()));
        self.null_space.col_iter().all(|direction| {
            let along: f64 = direction.iter().zip(slope).map(|(d, s)| d * s).sum();
            along.abs() <= MAX_UNDETERMINED_SHARE * largest
        })
    }

    /// Derivatives by the unknowns of the cosine and sine part of a harmonic, without their components along the
    /// orthogonal `removed_directions`. The two parts are the unknowns 2·`pair_index` and 2·`pair_index` + 1. `None`:
    /// the rows do not determine both parts.
    pub fn identifiable_harmonic_slopes(
        &self,
        pair_index: usize,
        removed_directions: &[Vec<f64>],
    ) -> Option<[Vec<f64>; 2]> {
        let part = |offset: usize| {
            let mut slope = slope_of_unknown(2 * pair_index + offset, self.reduced_design_matrix.ncols());
            removed_directions.iter().for_each(|direction| remove_component(&mut slope, direction));
            self.determines_output(&slope).then_some(slope)
        };
        Some([part(0)?, part(1)?])
    }
}

/// Removes the component along `direction`.
fn remove_component(slope: &mut [f64], direction: &[f64]) {
    let square: f64 = direction.iter().map(|d| d * d).sum();
    let along: f64 = slope.iter().zip(direction).map(|(s, d)| s * d).sum::<f64>() / square;
    slope.iter_mut().zip(direction).for_each(|(s, d)| *s -= along * d);
}

fn numerical_error(error: linear_least_squares::LinearError) -> IdentifyError {
    IdentifyError::IdentificationFailed(error.to_string())
}

/// Rows that reduce the observations, mm: for each group an orthonormal basis of the column space of its weighted
/// design, divided by the standard uncertainties.
fn reduction_matrix(equations: &BlockEquations) -> Mat<f64> {
    let BlockEquations { design_matrix: design, sigma_mm, reduction_group_indices: groups, .. } = equations;
    let count = groups.iter().map(|group| group + 1).max().unwrap_or(0);
    let mut basis: Vec<Vec<f64>> = Vec::new();
    for group in 0..count {
        let own: Vec<usize> = (0..design.nrows()).filter(|i| groups[*i] == group).collect();
        let entry = |i: usize, j: usize| design[(own[i], j)] / sigma_mm[own[i]];
        let ThinSvd { u, s, .. } = ThinSvd::decompose(&Mat::from_fn(own.len(), design.ncols(), entry));
        let is_kept = |j: &usize| s[*j] > RANK_THRESHOLD * s[0];
        for j in (0..s.len()).filter(is_kept) {
            let mut row = vec![0.0; design.nrows()];
            own.iter().enumerate().for_each(|(i, at)| row[*at] = u[(i, j)] / sigma_mm[*at]);
            basis.push(row);
        }
    }
    Mat::from_fn(basis.len(), design.nrows(), |i, j| basis[i][j])
}

/// The solutions of all blocks. Each block has the same number of unknowns. Unknowns and reduced observations
/// are concatenated block by block.
pub struct BlockwiseFit {
    pub blocks: Vec<BlockFit>,
    /// Unknowns of all blocks.
    pub x: Vec<f64>,
    /// Weighted residuals of the reduced observations.
    weighted_residuals: Vec<f64>,
    /// Number of unknowns of one block.
    unknowns_per_block: usize,
}

impl BlockwiseFit {
    /// # Errors
    /// A value is not finite.
    pub fn new(equations: impl Iterator<Item = BlockEquations>) -> Result<Self, IdentifyError> {
        let blocks = equations.map(|block| BlockFit::new(&block));
        let blocks: Vec<BlockFit> = blocks.collect::<Result<_, _>>()?;
        Ok(Self {
            x: blocks.iter().flat_map(|fit| fit.solution.x.clone()).collect(),
            weighted_residuals: blocks.iter().flat_map(|fit| fit.solution.residuals.clone()).collect(),
            unknowns_per_block: blocks.first().map_or(0, |fit| fit.solution.x.len()),
            blocks,
        })
    }

    /// The solution for the propagation of uncertainty. Its degrees of freedom are those of the reduced
    /// observations.
    pub fn solved_model(&self) -> SolvedModel<'_> {
        let solutions = || self.blocks.iter().map(|fit| &fit.solution);
        let residuals = self.blocks.iter().flat_map(|fit| fit.residuals_mm.clone());
        let figures = FitQuality {
            rank: solutions().map(|solution| solution.rank).sum(),
            unknown_count: self.x.len(),
            condition_number: solutions().map(|solution| solution.condition).fold(1.0, f64::max),
            dof: solutions().map(|solution| solution.dof).sum(),
            residual_rms_mm: rms(&residuals.collect::<Vec<f64>>()),
        };
        let residuals = &self.weighted_residuals;
        SolvedModel {
            model: self,
            weighted_residuals: residuals,
            has_declared_source_sizes: true,
            fit_quality: figures,
            measurements: &[],
        }
    }

    /// Extends a derivative by the unknowns of one block to all unknowns.
    pub fn extend_slope_to_all_unknowns(&self, block: usize, slope: &[f64]) -> Vec<f64> {
        let mut all = vec![0.0; self.x.len()];
        all[block * self.unknowns_per_block..][..slope.len()].copy_from_slice(slope);
        all
    }

    /// Converts a change of all observations, mm, to a change of the reduced observations.
    fn reduce_change(&self, change_mm: &[f64]) -> Vec<f64> {
        let parts = change_mm.chunks(change_mm.len() / self.blocks.len().max(1));
        let of = |(fit, part): (&BlockFit, &[f64])| multiply_vector(&fit.reduction_matrix, part);
        self.blocks.iter().zip(parts).flat_map(of).collect()
    }

    /// Effect of observations that have the given covariance, mm², by index of the block, within each block.
    pub fn block_covariance_effect(&self, covariance: impl Fn(usize) -> Mat<f64>) -> ObservationEffect {
        let (mut spans, mut first) = (Vec::new(), 0);
        for (block, fit) in self.blocks.iter().enumerate() {
            let reduced = &fit.reduction_matrix * covariance(block) * fit.reduction_matrix.transpose();
            let root = cholesky_lower(&reduced);
            let columns = (0..root.ncols()).map(|j| root.col_as_slice(j).to_vec());
            spans.extend(columns.map(|values| ObservationSpanChange { first_index: first, changes_mm: values }));
            first += root.nrows();
        }
        ObservationEffect::Spans(spans)
    }

    /// A source that changes many observations together. `columns`: change of all observations by each draw, mm. The
    /// source does not enter the weights; its size stays as declared.
    pub fn unweighted_source(&self, name: &str, columns: Vec<Vec<f64>>) -> UncertaintySource {
        let columns = columns.iter().map(|column| self.reduce_change(column)).collect();
        UncertaintySource::new_unweighted(name, columns, ResidualTreatment::InExpectedChi2)
    }

    /// Root mean square residual of each block. Block n holds harmonic n, from 1.
    pub fn residual_rms_by_order(&self) -> EstimatedFunction {
        let of = |(order, block): (f64, &BlockFit)| (order, rms(&block.residuals_mm) * 1e3);
        function_over_harmonic_orders("residual_rms", Unit::Um, (1..).map(f64::from).zip(&self.blocks).map(of))
    }
}

impl ObservationModel for BlockwiseFit {
    fn observation_count(&self) -> usize {
        self.weighted_residuals.len()
    }

    fn unknown_count(&self) -> usize {
        self.x.len()
    }

    fn linear_response(&self, change: &[f64]) -> LinearResponse {
        let (mut unknowns, mut residuals, mut rest) = (Vec::new(), Vec::new(), change);
        for fit in &self.blocks {
            let (change, after) = rest.split_at(fit.reduced_design_matrix.nrows());
            let own = multiply_vector(&fit.solution.gain, change);
            let explained = multiply_vector(&fit.reduced_design_matrix, &own);
            residuals.extend(change.iter().zip(explained).map(|(c, e)| c - e));
            unknowns.extend(own);
            rest = after;
        }
        LinearResponse { unknown_changes: unknowns, residual_changes: residuals }
    }

    fn unknowns_for_each_perturbation(&self, changes: MatRef<'_, f64>) -> Mat<f64> {
        let mut x = Mat::from_fn(changes.nrows(), self.x.len(), |_, j| self.x[j]);
        let mut first = 0;
        for (i, fit) in self.blocks.iter().enumerate() {
            let change = changes.subcols(first, fit.reduced_design_matrix.nrows());
            let mut part = x.subcols_mut(i * self.unknowns_per_block, self.unknowns_per_block);
            part += change * fit.solution.gain.transpose();
            first += fit.reduced_design_matrix.nrows();
        }
        x
    }
}
