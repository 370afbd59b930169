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

/// One harmonic, solved in the directions that the rows determine.
pub struct HarmonicFit {
    pub order: usize,
    pub design: Mat<f64>,
    pub sigma_mm: Vec<f64>,
    pub solution: LinearSolution,
    /// Unknowns × nullity: the directions that the rows do not determine. The solution has no part in
    /// them.
    pub null_space: Mat<f64>,
    /// The same in words.
    pub lost: Vec<String>,
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

impl HarmonicFit {
    fn new(layout: &ProbeLayout, data: &HarmonicData, order: usize) -> Result<Self, IdentifyError> {
        let design = layout.design(&data.rows, order);
        let null_space = survey(layout, &data.rows, order)?.null_space;
        let constraints = null_space.transpose().to_owned();
        let sigma_mm = data.sigma_mm(order);
        let problem = LinearProblem {
            a: design.as_ref(),
            y: &data.observations(order),
            sigma: &sigma_mm,
            constraints: (constraints.nrows() > 0).then_some(constraints.as_ref()),
            rank_threshold: RANK_THRESHOLD,
        };
        let solution = linear::solve(&problem).map_err(numerical)?;
        let lost = name_null_space(null_space.as_ref(), &layout.unknown_names(order));
        Ok(Self { order, design, sigma_mm, solution, null_space, lost })
    }

    fn weighted_residuals(&self, residuals: &[f64]) -> Vec<f64> {
        residuals.iter().zip(&self.sigma_mm).map(|(r, sigma)| r / sigma).collect()
    }
}

/// All harmonics from 1 on. Unknowns and observations: harmonic after harmonic.
pub struct SeparationFit {
    pub harmonics: Vec<HarmonicFit>,
    /// Of all harmonics.
    pub x: Vec<f64>,
    pub weighted_residuals: Vec<f64>,
    /// Observations of one harmonic.
    rows: usize,
    /// Unknowns of one harmonic.
    columns: usize,
}

impl SeparationFit {
    /// # Errors
    /// Values that are not finite.
    pub fn new(layout: &ProbeLayout, data: &HarmonicData) -> Result<Self, IdentifyError> {
        let harmonics = (1..=data.orders()).map(|order| HarmonicFit::new(layout, data, order));
        let harmonics: Vec<HarmonicFit> = harmonics.collect::<Result<_, _>>()?;
        let weighted = |fit: &HarmonicFit| fit.weighted_residuals(&fit.solution.residuals);
        Ok(Self {
            x: harmonics.iter().flat_map(|fit| fit.solution.x.clone()).collect(),
            weighted_residuals: harmonics.iter().flat_map(weighted).collect(),
            rows: 2 * data.rows.len(),
            columns: 2 * layout.components().len(),
            harmonics,
        })
    }

    pub fn solution(&self) -> Solution<'_> {
        let solutions = || self.harmonics.iter().map(|fit| &fit.solution);
        let residuals: Vec<f64> = solutions().flat_map(|s| s.residuals.clone()).collect();
        let figures = FitFigures {
            rank: solutions().map(|solution| solution.rank).sum(),
            unknowns: self.x.len(),
            condition: solutions().map(|solution| solution.condition).fold(1.0, f64::max),
            dof: solutions().map(|solution| solution.dof).sum(),
            residual_rms_mm: rms(&residuals),
        };
        Solution { model: self, residuals: &self.weighted_residuals, is_declared: true, figures }
    }

    /// Index of the first unknown of the harmonic `order`.
    pub fn first_unknown(&self, order: usize) -> usize {
        (order - 1) * self.columns
    }

    /// Observations that the solution gives with another layout: the effect of an error of it.
    pub fn predicted(&self, layout: &ProbeLayout, rows: &[Row]) -> Vec<f64> {
        let of = |fit: &HarmonicFit| multiply(&layout.design(rows, fit.order), &fit.solution.x);
        self.harmonics.iter().flat_map(of).collect()
    }
}

impl ObservationModel for SeparationFit {
    fn observations(&self) -> usize {
        self.rows * self.harmonics.len()
    }

    fn unknowns(&self) -> usize {
        self.x.len()
    }

    fn respond(&self, change: &[f64]) -> Response {
        let (mut unknowns, mut residuals) = (Vec::new(), Vec::new());
        for (fit, change) in self.harmonics.iter().zip(change.chunks(self.rows)) {
            let own = multiply(&fit.solution.gain, change);
            let explained = multiply(&fit.design, &own);
            let rest: Vec<f64> = change.iter().zip(explained).map(|(c, e)| c - e).collect();
            residuals.extend(fit.weighted_residuals(&rest));
            unknowns.extend(own);
        }
        Response { unknowns, residuals }
    }

    fn solve_near(&self, changes: MatRef<'_, f64>) -> Mat<f64> {
        let mut x = Mat::from_fn(changes.nrows(), self.x.len(), |_, j| self.x[j]);
        for (i, fit) in self.harmonics.iter().enumerate() {
            let own = changes.subcols(i * self.rows, self.rows) * fit.solution.gain.transpose();
            let mut part = x.subcols_mut(i * self.columns, self.columns);
            part += own;
        }
        x
    }
}
