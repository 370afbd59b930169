//! Declared error motions that act through the kinematics: those of the rotary axes, and the rotations of the
//! linear axes.

use nalgebra::{Matrix3, Vector3};

use super::observation_effects::{effect_of_nonzero_columns, shift_column};
use super::observe::{BallCentre, ObservedBalls};
use crate::identification::declared_sources::{
    DEFAULT_ROTARY_MOTION_ORDERS, angular_motion_patterns, rotary_error_motions,
};
use crate::identification::{ObservationEffect, UncertaintySource};
use machine::Position;
use machine::frame::Point;
use machine::kinematics::{ErrorParameter, ErrorTerm, KinematicChain};
use machine::record::plan::Plan;

/// Sources of the rotations of X, Y and Z, and of the rotary error motions. Both displace all touches of a
/// measurement alike. A source that is zero has an empty effect.
pub fn angular_and_rotary_motion_sources(
    plan: &Plan,
    chain: &KinematicChain,
    observed: &ObservedBalls,
) -> [UncertaintySource; 2] {
    let points: Vec<Vector3<f64>> = observed.centres.iter().map(|centre| centre.centre_axis_positions_mm).collect();
    let angular = angular_motion_patterns(plan, &points);
    let mut rotary = rotary_error_motions(plan, &DEFAULT_ROTARY_MOTION_ORDERS);
    rotary.retain(|motion| chain.check_parameter_axis(motion.error).is_ok());
    let rotary = rotary.iter().map(|motion| (motion.error, vec![motion.coefficient_sd_mm; points.len()]));
    let effect = |motions: &[(ErrorParameter, Vec<f64>)]| error_motion_effect(plan, chain, observed, motions);
    [
        UncertaintySource::new("angular error motions of X, Y and Z", effect(&angular)),
        UncertaintySource::new("error motions of rotary axes", effect(&rotary.collect::<Vec<_>>())),
    ]
}

/// Effect of error motions. `motions`: for each draw of unit variance, the error and its size at each measurement, mm
/// or rad.
fn error_motion_effect(
    plan: &Plan,
    chain: &KinematicChain,
    observed: &ObservedBalls,
    motions: &[(ErrorParameter, Vec<f64>)],
) -> ObservationEffect {
    let errors: Vec<ErrorParameter> = motions.iter().map(|(error, _)| *error).collect();
    let stylus = Point::from_vec(Vector3::from(plan.machine.tool_mm));
    // Matrix from the table frame to axis positions.
    let back = |place: &Position| {
        let forth = chain.linear_axes_jacobian(place, &[]);
        forth.try_inverse().unwrap_or(Matrix3::repeat(f64::NAN))
    };
    let back: Vec<Matrix3<f64>> = observed.measured_rotary_positions.iter().map(back).collect();
    // Displacement of each measurement, in axis positions, per unit of each error.
    let by_error = |centre: &BallCentre| -> Vec<Vector3<f64>> {
        let columns = chain.error_jacobian(&observed.axis_position_at_centre(centre), stylus, &[], &errors).into_iter();
        columns.map(|along| back[centre.measured_rotary_position_index] * along).collect()
    };
    let by_error: Vec<Vec<Vector3<f64>>> = observed.centres.iter().map(by_error).collect();
    let column = |(index, (_, sizes)): (usize, &(ErrorParameter, Vec<f64>))| {
        shift_column(by_error.iter().zip(sizes).map(|(centre, size)| centre[index] * *size))
    };
    effect_of_nonzero_columns(motions.iter().enumerate().map(column))
}

/// Derivative of the tip in the table frame by the stylus vector: R_wᵀ·R_t.
pub fn tip_derivative_by_stylus(chain: &KinematicChain, position: &Position, errors: &[ErrorTerm]) -> Matrix3<f64> {
    let table = chain.machine_from_table(position, errors).rotation;
    let spindle = chain.machine_from_spindle(position, errors).rotation;
    (table.inverse() * spindle).into_inner()
}
