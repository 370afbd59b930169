//! Weighted least squares, harmonic by harmonic, and the whole as an [`ObservationModel`].

use estimation::linear::{self, LinearProblem, LinearSolution, RANK_THRESHOLD, Survey};
use estimation::null_names::name_null_space;
use faer::{Mat, MatRef};

use super::harmonics::HarmonicData;
use super::model::{ProbeLayout, Row};
use crate::IdentifyError;
use crate::identification::{FitFigures, ObservationModel, Response, Solution, multiply, rms};

/// An output that contains more than this part of a lost direction is not identifiable.
const MAX_LOST_SHARE: f64 = 1e-7;

/// One harmonic, solved in the directions that the rows determine. The observations are reduced before:
/// of each channel, the parts over the indexes that a motion or a form can take. What remains of the
/// residuals is no effect of any unknown.
pub struct HarmonicFit {
    pub order: usize,
    /// Reduced observations (of standard uncertainty 1) × observations, 1/mm.
    pub reduction: Mat<f64>,
    /// Reduced observations × unknowns.
    pub design: Mat<f64>,
    pub solution: LinearSolution,
    /// Unknowns × nullity: the directions that the rows do not determine. The solution has no part in
    /// them.
    pub null_space: Mat<f64>,
    /// The same in words.
    pub lost: Vec<String>,
    /// Of all observations, measured less model, mm.
    pub residuals_mm: Vec<f64>,
    /// Σ(residual/σ)² of all observations, and their degrees of freedom.
    pub chi2: f64,
    pub dof: usize,
}

/// Rank, condition and null space of the harmonic `order` with equal weights.
///
/// # Errors
/// A coefficient that is not finite.
pub fn survey(layout: &ProbeLayout, rows: &[Row], order: usize) -> Result<Survey, IdentifyError> {
    linear::survey(layout.design(rows, order).as_ref(), None, RANK_THRESHOLD).map_err(numerical)
}

/// Whether an output with the derivative `slope` by the unknowns of one harmonic is determined.
pub fn is_identifiable(slope: &[f64], null_space: &Mat<f64>) -> bool {
    let largest = slope.iter().fold(0.0, |largest: f64, s| largest.max(s.abs()));
    null_space.col_iter().all(|direction| {
        let along: f64 = direction.iter().zip(slope).map(|(d, s)| d * s).sum();
        along.abs() <= MAX_LOST_SHARE * largest
    })
}

fn numerical(error: linear::LinearError) -> IdentifyError {
    IdentifyError::Numerical(error.to_string())
}

/// Of each channel, an orthonormal basis of its weighted rows of the design.
fn reduction(design: &Mat<f64>, rows: &[Row], sigma_mm: &[f64]) -> Result<Mat<f64>, IdentifyError> {
    let channels = rows.iter().map(|row| row.channel + 1).max().unwrap_or(0);
    let mut basis: Vec<Vec<f64>> = Vec::new();
    for channel in 0..channels {
        let is_own = |i: &usize| rows[i % rows.len()].channel == channel;
        let own: Vec<usize> = (0..design.nrows()).filter(is_own).collect();
        let entry = |i: usize, j: usize| design[(own[i], j)] / sigma_mm[own[i]];
        let svd = Mat::from_fn(own.len(), design.ncols(), entry)
            .thin_svd()
            .map_err(|_| numerical(linear::LinearError::NoConvergence))?;
        let values: Vec<f64> = svd.S().column_vector().iter().copied().collect();
        let is_kept = |j: &usize| values[*j] > RANK_THRESHOLD * values[0];
        for j in (0..values.len()).filter(is_kept) {
            let mut row = vec![0.0; design.nrows()];
            own.iter().enumerate().for_each(|(i, at)| row[*at] = svd.U()[(i, j)] / sigma_mm[*at]);
            basis.push(row);
        }
    }
    Ok(Mat::from_fn(basis.len(), design.nrows(), |i, j| basis[i][j]))
}

impl HarmonicFit {
    fn new(layout: &ProbeLayout, data: &HarmonicData, order: usize) -> Result<Self, IdentifyError> {
        let (full, sigma_mm) = (layout.design(&data.rows, order), data.sigma_mm(order));
        let Survey { null_space, rank, .. } = survey(layout, &data.rows, order)?;
        let constraints = null_space.transpose().to_owned();
        let reduction = reduction(&full, &data.rows, &sigma_mm)?;
        let design = &reduction * &full;
        let observed = data.observations(order);
        let problem = LinearProblem {
            a: design.as_ref(),
            y: &multiply(&reduction, &observed),
            sigma: &vec![1.0; design.nrows()],
            constraints: (constraints.nrows() > 0).then_some(constraints.as_ref()),
            rank_threshold: RANK_THRESHOLD,
        };
        let solution = linear::solve(&problem).map_err(numerical)?;
        let explained = multiply(&full, &solution.x);
        let residuals_mm: Vec<f64> = observed.iter().zip(explained).map(|(o, e)| o - e).collect();
        Ok(Self {
            order,
            lost: name_null_space(null_space.as_ref(), &layout.unknown_names(order)),
            chi2: residuals_mm.iter().zip(&sigma_mm).map(|(r, sigma)| (r / sigma).powi(2)).sum(),
            dof: observed.len() - rank,
            residuals_mm,
            reduction,
            design,
            solution,
            null_space,
        })
    }
}

/// All harmonics from 1 on. Unknowns and reduced observations: harmonic after harmonic.
pub struct SeparationFit {
    pub harmonics: Vec<HarmonicFit>,
    /// Of all harmonics.
    pub x: Vec<f64>,
    /// Of the reduced observations.
    pub weighted_residuals: Vec<f64>,
    /// Unknowns of one harmonic.
    columns: usize,
}

impl SeparationFit {
    /// # Errors
    /// Values that are not finite.
    pub fn new(layout: &ProbeLayout, data: &HarmonicData) -> Result<Self, IdentifyError> {
        let harmonics = (1..=data.orders()).map(|order| HarmonicFit::new(layout, data, order));
        let harmonics: Vec<HarmonicFit> = harmonics.collect::<Result<_, _>>()?;
        Ok(Self {
            x: harmonics.iter().flat_map(|fit| fit.solution.x.clone()).collect(),
            weighted_residuals: harmonics
                .iter()
                .flat_map(|fit| fit.solution.residuals.clone())
                .collect(),
            columns: 2 * layout.components().len(),
            harmonics,
        })
    }

    /// Degrees of freedom are those of the reduced observations.
    pub fn solution(&self) -> Solution<'_> {
        let solutions = || self.harmonics.iter().map(|fit| &fit.solution);
        let residuals = self.harmonics.iter().flat_map(|fit| fit.residuals_mm.clone());
        let figures = FitFigures {
            rank: solutions().map(|solution| solution.rank).sum(),
            unknowns: self.x.len(),
            condition: solutions().map(|solution| solution.condition).fold(1.0, f64::max),
            dof: solutions().map(|solution| solution.dof).sum(),
            residual_rms_mm: rms(&residuals.collect::<Vec<f64>>()),
        };
        Solution { model: self, residuals: &self.weighted_residuals, is_declared: true, figures }
    }

    /// Σ(residual/σ)² of all observations and their degrees of freedom, without the first harmonic: it holds the
    /// eccentricity of each mounting, which the model does not.
    pub fn chi2(&self) -> (f64, usize) {
        let of = |fit: &HarmonicFit| (fit.chi2, fit.dof);
        self.harmonics
            .iter()
            .filter(|fit| fit.order > 1)
            .map(of)
            .fold((0.0, 0), |sum, own| (sum.0 + own.0, sum.1 + own.1))
    }

    /// Index of the first unknown of the harmonic `order`.
    pub fn first_unknown(&self, order: usize) -> usize {
        (order - 1) * self.columns
    }

    /// A change of all observations, mm, as change of the reduced observations.
    pub fn reduce(&self, change_mm: &[f64]) -> Vec<f64> {
        let parts = change_mm.chunks(change_mm.len() / self.harmonics.len().max(1));
        let of = |(fit, part): (&HarmonicFit, &[f64])| multiply(&fit.reduction, part);
        self.harmonics.iter().zip(parts).flat_map(of).collect()
    }

    /// Observations that the solution gives with another layout: the effect of an error of it.
    pub fn predicted(&self, layout: &ProbeLayout, rows: &[Row]) -> Vec<f64> {
        let of = |fit: &HarmonicFit| multiply(&layout.design(rows, fit.order), &fit.solution.x);
        self.harmonics.iter().flat_map(of).collect()
    }
}

impl ObservationModel for SeparationFit {
    fn observations(&self) -> usize {
        self.weighted_residuals.len()
    }

    fn unknowns(&self) -> usize {
        self.x.len()
    }

    fn respond(&self, change: &[f64]) -> Response {
        let (mut unknowns, mut residuals, mut rest) = (Vec::new(), Vec::new(), change);
        for fit in &self.harmonics {
            let (change, after) = rest.split_at(fit.design.nrows());
            let own = multiply(&fit.solution.gain, change);
            let explained = multiply(&fit.design, &own);
            residuals.extend(change.iter().zip(explained).map(|(c, e)| c - e));
            unknowns.extend(own);
            rest = after;
        }
        Response { unknowns, residuals }
    }

    fn solve_near(&self, changes: MatRef<'_, f64>) -> Mat<f64> {
        let mut x = Mat::from_fn(changes.nrows(), self.x.len(), |_, j| self.x[j]);
        let mut first = 0;
        for (i, fit) in self.harmonics.iter().enumerate() {
            let change = changes.subcols(first, fit.design.nrows());
            let mut part = x.subcols_mut(i * self.columns, self.columns);
            part += change * fit.solution.gain.transpose();
            first += fit.design.nrows();
        }
        x
    }
}
