//! The equations of one sphere on a rotary table (paper 2, Eqs. 1 to 4, 16), with the exact chain.
//!
//! The five parameters of the paper's machine, a B table that carries C, are errors "relative to the previous
//! axis", as are the errors of a chain: α_BY = EA0B, β_BY = EB0B, γ_BY = EC0B, δx_CB = EX0C and α_CB = EA0C. In the
//! machine's own coordinates ISO 230-1 would call the last two E_X0C − E_X0B and E_A0C − E_A0B. The paper's δx_BY,
//! δy_BY, δz_BY are not separable from the position of the sensor's zero point in the spindle and are part of it.

use nalgebra::{Matrix3, Vector3};

use estimation::linear_least_squares::RankAnalysis;
use estimation::nonlinear_least_squares::{NonlinearError, NonlinearSolution, minimise_squares};
use estimation::schur::{BlockRows, factorise_and_project_right_side};
use machine::kinematics::{ErrorParameter, ErrorTerm, KinematicChain};
use machine::{Position, frame::Point};

use crate::identification::ObservationEquation;

/// Number of unknowns in addition to the machine's errors: the zero point (spindle frame), then the sphere's centre
/// (table frame), both mm.
pub const POSITION_UNKNOWN_COUNT: usize = 6;

/// The machine with its unknown errors.
#[derive(Debug, Clone)]
pub struct SphereModel {
    pub chain: KinematicChain,
    pub parameters: Vec<ErrorParameter>,
}

impl SphereModel {
    pub fn unknown_count(&self) -> usize {
        self.parameters.len() + POSITION_UNKNOWN_COUNT
    }

    fn error_terms(&self, x: &[f64]) -> Vec<ErrorTerm> {
        let pairs = self.parameters.iter().zip(x);
        pairs.map(|(parameter, value)| ErrorTerm { parameter: *parameter, value: *value }).collect()
    }

    /// Zero point in `x`, spindle frame, mm.
    pub fn zero_point(&self, x: &[f64]) -> Vector3<f64> {
        let first = self.parameters.len();
        Vector3::from_column_slice(&x[first..first + 3])
    }

    /// Centre of the sphere in `x`, table frame, mm.
    pub fn ball_centre(&self, x: &[f64]) -> Vector3<f64> {
        let first = self.parameters.len() + 3;
        Vector3::from_column_slice(&x[first..first + 3])
    }

    /// Zero point at the axis positions `at`, minus the sphere's centre: table frame, mm.
    pub fn misclosure(&self, at: &Position, x: &[f64]) -> Vector3<f64> {
        let tip = Point::from_vec(self.zero_point(x));
        self.chain.tip_in_table(at, tip, &self.error_terms(x)).mm - self.ball_centre(x)
    }

    /// Derivatives of the misclosure, in the order of the unknowns.
    pub fn misclosure_derivatives(&self, at: &Position, x: &[f64]) -> Vec<Vector3<f64>> {
        let terms = self.error_terms(x);
        let tip = Point::from_vec(self.zero_point(x));
        let mut columns = self.chain.error_jacobian(at, tip, &terms, &self.parameters);
        let table = self.chain.machine_from_table(at, &terms).rotation;
        let turn = table.inverse() * self.chain.machine_from_spindle(at, &terms).rotation;
        let axes = [Vector3::x(), Vector3::y(), Vector3::z()];
        columns.extend(axes.map(|axis| turn * axis));
        columns.extend(axes.map(|axis| -axis));
        columns
    }
}

/// Axis positions with the zero point at the sphere's centre, and their weight.
#[derive(Debug, Clone)]
pub struct CentreObservation {
    /// Positions of all axes.
    pub axis_positions: Position,
    /// Matrix from the table frame to weighted rows.
    pub whitening_matrix: Matrix3<f64>,
}

/// The sphere's centres as one least-squares problem.
#[derive(Debug, Clone)]
pub struct MachineEquations {
    pub model: SphereModel,
    pub centre_observations: Vec<CentreObservation>,
    /// Prior value of the zero point and its standard uncertainty, mm. It is used before all poses are measured.
    pub zero_point_prior: Option<(Vector3<f64>, f64)>,
}

impl MachineEquations {
    fn residuals_without_change(&self, x: &[f64]) -> Vec<f64> {
        self.weighted_residuals(x, &vec![0.0; self.observation_count()])
    }

    fn row_blocks(&self, x: &[f64]) -> Vec<BlockRows> {
        let residuals = self.residuals_without_change(x);
        let mut rows = BlockRows::zeros(residuals.len(), 0, self.model.unknown_count());
        residuals.into_iter().enumerate().for_each(|(row, value)| rows.set_right_side(row, value));
        for (i, observation) in self.centre_observations.iter().enumerate() {
            for (j, column) in self.model.misclosure_derivatives(&observation.axis_positions, x).into_iter().enumerate()
            {
                let weighted = observation.whitening_matrix * column;
                (0..3).for_each(|k| rows.set_common_coefficient(3 * i + k, j, weighted[k]));
            }
        }
        if let Some((_, sigma)) = self.zero_point_prior {
            let (first, zero) = (3 * self.centre_observations.len(), self.model.parameters.len());
            (0..3).for_each(|k| rows.set_common_coefficient(first + k, zero + k, 1.0 / sigma));
        }
        vec![rows]
    }

    /// Analyses which unknowns the observations determine near `x`.
    pub fn analyse_rank(&self, x: &[f64]) -> Result<RankAnalysis, NonlinearError> {
        Ok(factorise_and_project_right_side(self.row_blocks(x)).0.analyse_rank()?)
    }

    pub fn solve(&self, start: Vec<f64>) -> Result<NonlinearSolution, NonlinearError> {
        minimise_squares(start, |x| self.row_blocks(x), |x| self.residuals_without_change(x))
    }
}

/// Observations: the sphere's centre at each pose, three coordinates in the table frame.
impl ObservationEquation for MachineEquations {
    fn observation_count(&self) -> usize {
        3 * self.centre_observations.len()
    }

    fn weighted_residuals(&self, x: &[f64], change: &[f64]) -> Vec<f64> {
        let misclosures = self
            .centre_observations
            .iter()
            .flat_map(|observation| -> [f64; 3] { self.model.misclosure(&observation.axis_positions, x).into() });
        let misclosures: Vec<f64> = misclosures.zip(change).map(|(m, change)| m + change).collect();
        let mut rows = self.weighted_residual_change(&misclosures);
        if let Some((zero, sigma)) = self.zero_point_prior {
            let held = (zero - self.model.zero_point(x)) / sigma;
            rows[self.observation_count()..].copy_from_slice(held.as_slice());
        }
        rows
    }

    fn weighted_residual_change(&self, change: &[f64]) -> Vec<f64> {
        let changes = change.chunks_exact(3).map(Vector3::from_column_slice);
        let rows = self
            .centre_observations
            .iter()
            .zip(changes)
            .flat_map(|(observation, change)| -> [f64; 3] { (observation.whitening_matrix * -change).into() });
        rows.chain(self.zero_point_prior.iter().flat_map(|_| [0.0; 3])).collect()
    }
}

/// Position `rotary` with X, Y, Z added.
pub fn with_linear_axes(rotary: &Position, xyz: Vector3<f64>) -> Position {
    rotary.updated_by(&Position::from_xyz(xyz))
}
