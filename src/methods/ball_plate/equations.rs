//! The observation equations (paper 5, Eq. (1), with all measuring positions unknown) and their solution by
//! least squares over all visits.

use faer::Mat;
use nalgebra::{Matrix3, Vector3};

use super::unknowns_layout::{MOTION_COMPONENTS, TableStop, UnknownsLayout};
use estimation::linear_least_squares::{
    self, LinearError, LinearProblem, LinearSolution, RANK_THRESHOLD, RankAnalysis,
};
use machine::Axis;

/// One measurement of a ball at one stop.
#[derive(Debug, Clone)]
pub struct BallObservation {
    pub stop_index: usize,
    pub ball_index: usize,
    /// Index of the measuring position: the step of the circle (360°/M) in the machine at which the ball was measured.
    pub measuring_position_index: usize,
    /// Time from the middle of the run, divided by half its duration: −1 to 1.
    pub relative_time: f64,
    /// Number of interruptions between the first measurement of the run and this one; several without a measurement
    /// between them count as one.
    pub preceding_interruption_count: usize,
    /// Axis positions X, Y, Z at which the stylus ball coincides with the ball, minus those of the nominal
    /// machine for the expected position of the ball, mm.
    pub axis_position_deviation_mm: Vector3<f64>,
    /// Derivative of `axis_position_deviation_mm` by each error motion of the rotary axis, in the order of
    /// `MOTION_COMPONENTS`, mm per mm or rad.
    pub derivatives_by_error_motion: [Vector3<f64>; MOTION_COMPONENTS.len()],
    /// Derivative of `axis_position_deviation_mm` by the position of the ball in the table frame.
    pub derivative_by_ball_position: Matrix3<f64>,
}

/// Design matrix: deviations of all observations as linear functions of the unknowns, three rows per observation.
pub fn design_matrix(layout: &UnknownsLayout, stops: &[TableStop], observations: &[BallObservation]) -> Mat<f64> {
    let mut a = Mat::zeros(3 * observations.len(), layout.unknown_count());
    for (i, observation) in observations.iter().enumerate() {
        let mut set = |j: usize, column: Vector3<f64>| {
            (0..3).for_each(|axis| a[(3 * i + axis, j)] = column[axis]);
        };
        let Some(stop) = stops.get(observation.stop_index) else { continue };
        let functions = layout.angle_basis.function_values(stop.angle, observation.stop_index);
        for (component, by) in observation.derivatives_by_error_motion.iter().enumerate() {
            for (function, value) in functions.iter().enumerate() {
                set(layout.motion_unknown_index(component, function), by * *value);
            }
            if layout.has_reversal {
                // The reversal value is the full difference between both directions.
                set(layout.reversal_unknown_index(component), by * (0.5 * stop.approach_sign));
            }
        }
        for (axis, along) in Axis::LINEAR.map(Axis::nominal_direction).into_iter().enumerate() {
            for order in 1..=layout.drift_order {
                set(layout.drift_unknown_index(order, axis), along * observation.relative_time.powi(order as i32));
            }
            for interruption in 0..observation.preceding_interruption_count.min(layout.interruption_count) {
                set(layout.interruption_step_unknown_index(interruption, axis), along);
            }
            // If the true position of a linear axis is too large, its displayed position at a ball is too
            // small.
            set(layout.measuring_position_unknown_index(observation.measuring_position_index, axis), -along);
            set(
                layout.ball_unknown_index(observation.ball_index, axis),
                observation.derivative_by_ball_position.column(axis).into_owned(),
            );
        }
    }
    a
}

/// Design matrix and least-squares solution under the gauge. `sigma`: standard uncertainty of each coordinate of each
/// observation, mm.
///
/// # Errors
/// The visits do not separate the unknowns.
pub fn solve_equations(
    layout: &UnknownsLayout,
    stops: &[TableStop],
    observations: &[BallObservation],
    sigma: &[f64],
) -> Result<(Mat<f64>, LinearSolution), LinearError> {
    let a = design_matrix(layout, stops, observations);
    let deviations: Vec<f64> = observations.iter().flat_map(|s| s.axis_position_deviation_mm.iter().copied()).collect();
    let solution = linear_least_squares::solve_least_squares(&LinearProblem {
        a: a.as_ref(),
        y: &deviations,
        sigma,
        constraints: Some(layout.gauge_rows(stops).as_ref()),
        rank_threshold: RANK_THRESHOLD,
    })?;
    Ok((a, solution))
}

/// Null space of the equations of the visits, with or without the gauge.
///
/// # Errors
/// The errors of [`linear_least_squares::analyse_rank`].
pub fn analyse_equation_rank(
    layout: &UnknownsLayout,
    stops: &[TableStop],
    observations: &[BallObservation],
    with_gauge: bool,
) -> Result<RankAnalysis, LinearError> {
    let a = design_matrix(layout, stops, observations);
    let gauge = layout.gauge_rows(stops);
    linear_least_squares::analyse_rank(a.as_ref(), with_gauge.then_some(gauge.as_ref()), RANK_THRESHOLD)
}
