//! The measured points, and their positions on the table for given machine errors.

use nalgebra::{Matrix3, Vector3};

use crate::ball_measurement::{ObservedBalls, tip_derivative_by_stylus};
use machine::Position;
use machine::frame::Point;
use machine::kinematics::{ErrorParameter, ErrorTerm, KinematicChain};
use machine::record::artefact::Balls;

/// The measured points, one per measurement of a ball, in the order of the observations.
pub struct MeasuredPoints {
    chain: KinematicChain,
    /// Stated stylus from the spindle datum, mm.
    pub stated_stylus: Vector3<f64>,
    /// Axis positions with the stylus at the centre of the ball.
    axis_positions: Vec<Position>,
    /// Index of the ball of each point.
    pub ball_indices: Vec<usize>,
    /// Certified position of the ball of each point at the temperature of the artefact, artefact frame, mm.
    pub certified_positions_mm: Vec<Vector3<f64>>,
    /// Matrix of each point from a change of X, Y, Z to the change in the table frame, for the nominal
    /// machine.
    pub table_from_axes: Vec<Matrix3<f64>>,
}

impl MeasuredPoints {
    pub fn new(chain: KinematicChain, stylus: Vector3<f64>, observed: &ObservedBalls, balls: &Balls) -> Self {
        let centres = &observed.centres;
        let at: Vec<Position> = centres.iter().map(|centre| observed.axis_position_at_centre(centre)).collect();
        let longer = 1.0 + balls.relative_expansion_and_u()[0];
        let certified = |ball: usize| longer * Vector3::from(balls.balls[ball].centre_mm);
        Self {
            stated_stylus: stylus,
            ball_indices: centres.iter().map(|centre| centre.ball_index).collect(),
            certified_positions_mm: centres.iter().map(|centre| certified(centre.ball_index)).collect(),
            table_from_axes: at.iter().map(|at| chain.linear_axes_jacobian(at, &[])).collect(),
            axis_positions: at,
            chain,
        }
    }

    pub fn point_count(&self) -> usize {
        self.axis_positions.len()
    }

    pub fn chain(&self) -> &KinematicChain {
        &self.chain
    }

    /// Position of the tip on the table at the axis positions of each point, if the machine has these errors and this
    /// stylus; table frame, mm.
    pub fn table_positions_mm(&self, errors: &[ErrorTerm], stylus: Vector3<f64>) -> Vec<Vector3<f64>> {
        let tip = Point::from_vec(stylus);
        self.axis_positions.iter().map(|at| self.chain.tip_in_table(at, tip, errors).mm).collect()
    }

    /// Derivative of each point by each error, table frame: points × errors.
    pub fn point_derivatives_by_errors(
        &self,
        errors: &[ErrorTerm],
        stylus: Vector3<f64>,
        parameters: &[ErrorParameter],
    ) -> Vec<Vec<Vector3<f64>>> {
        let tip = Point::from_vec(stylus);
        self.axis_positions.iter().map(|at| self.chain.error_jacobian(at, tip, errors, parameters)).collect()
    }

    /// Derivative of each point by the stylus, of which the point is an affine function; table frame.
    pub fn point_derivatives_by_stylus(&self, errors: &[ErrorTerm]) -> Vec<Matrix3<f64>> {
        self.axis_positions.iter().map(|at| tip_derivative_by_stylus(&self.chain, at, errors)).collect()
    }
}
