//! The measured points, and their positions on the table for given machine errors.

use nalgebra::{Matrix3, Vector3};

use crate::ball_measurement::{ObservedBalls, stylus_derivative};
use machine::Position;
use machine::frame::Point;
use machine::kinematics::{ErrorParameter, ErrorTerm, KinematicChain};
use machine::record::artefact::Balls;

/// The measured points, one per measurement of a ball, in the order of the observations.
pub struct MeasuredPoints {
    chain: KinematicChain,
    /// Stated stylus from the spindle datum, mm.
    pub stylus: Vector3<f64>,
    /// Axis positions with the stylus at the centre of the ball.
    positions: Vec<Position>,
    /// Index of the ball of each point.
    pub ball_indices: Vec<usize>,
    /// Certified position of the ball of each point at the temperature of the artefact, artefact frame, mm.
    pub certified_mm: Vec<Vector3<f64>>,
    /// Matrix of each point from a change of X, Y, Z to the change in the table frame, for the nominal
    /// machine.
    pub table_from_axes: Vec<Matrix3<f64>>,
}

impl MeasuredPoints {
    pub fn new(chain: KinematicChain, stylus: Vector3<f64>, observed: &ObservedBalls, balls: &Balls) -> Self {
        let centres = &observed.centres;
        let at: Vec<Position> = centres.iter().map(|centre| observed.position_of(centre)).collect();
        let longer = 1.0 + balls.relative_expansion()[0];
        let certified = |ball: usize| longer * Vector3::from(balls.balls[ball].centre_mm);
        Self {
            stylus,
            ball_indices: centres.iter().map(|centre| centre.ball).collect(),
            certified_mm: centres.iter().map(|centre| certified(centre.ball)).collect(),
            table_from_axes: at.iter().map(|at| chain.linear_jacobian(at, &[])).collect(),
            positions: at,
            chain,
        }
    }

    pub fn point_count(&self) -> usize {
        self.positions.len()
    }

    pub fn chain(&self) -> &KinematicChain {
        &self.chain
    }

    /// Position of each point for a machine with these errors and this stylus, table frame, mm.
    pub fn table_positions_mm(&self, errors: &[ErrorTerm], stylus: Vector3<f64>) -> Vec<Vector3<f64>> {
        let tip = Point::from_vec(stylus);
        self.positions.iter().map(|at| self.chain.tip_in_table(at, tip, errors).mm).collect()
    }

    /// Derivative of each point by each error: points × errors.
    pub fn error_derivatives(
        &self,
        errors: &[ErrorTerm],
        stylus: Vector3<f64>,
        parameters: &[ErrorParameter],
    ) -> Vec<Vec<Vector3<f64>>> {
        let tip = Point::from_vec(stylus);
        self.positions.iter().map(|at| self.chain.jacobian(at, tip, errors, parameters)).collect()
    }

    /// Derivative of each point by the stylus; the point is an affine function of it.
    pub fn stylus_derivatives(&self, errors: &[ErrorTerm]) -> Vec<Matrix3<f64>> {
        self.positions.iter().map(|at| stylus_derivative(&self.chain, at, errors)).collect()
    }
}
