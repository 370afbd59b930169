//! Declared error motions that act through the kinematics: those of the rotary axes, and the rotations of the
//! linear axes.

use nalgebra::{Matrix3, Vector3};

use super::effects::{nonzero_columns, shift_column};
use super::observe::{BallCentre, ObservedBalls};
use crate::identification::UncertaintySource;
use crate::identification::declared::{ROTARY_MOTION_ORDERS, angular_motion_patterns, rotary_error_motions};
use machine::Position;
use machine::frame::Point;
use machine::kinematics::{ErrorParameter, KinematicChain};
use machine::record::plan::Plan;

/// Source of the rotary error motions, which displace all touches of a measurement alike. It may have no
/// draw.
pub fn rotary_source(plan: &Plan, chain: &KinematicChain, observed: &ObservedBalls) -> UncertaintySource {
    let mut motions = rotary_error_motions(plan, &ROTARY_MOTION_ORDERS);
    motions.retain(|motion| chain.check_parameter(motion.error).is_ok());
    let errors: Vec<ErrorParameter> = motions.iter().map(|motion| motion.error).collect();
    let by_error = displacements_by_error(plan, chain, observed, &errors);
    let column = |index: usize| {
        let mut of_centres = by_error.iter();
        shift_column(&observed.centres, |_| {
            let of_centre = of_centres.next().map_or(Vector3::zeros(), |centre| centre[index]);
            of_centre * motions[index].size_mm
        })
    };
    let effect = nonzero_columns((0..motions.len()).map(column));
    UncertaintySource::new("error motions of rotary axes", effect)
}

/// Source of the rotations of X, Y and Z, each the same for all touches of a measurement. It may have no
/// draw.
pub fn angular_source(plan: &Plan, chain: &KinematicChain, observed: &ObservedBalls) -> UncertaintySource {
    let points: Vec<Vector3<f64>> = observed.centres.iter().map(|centre| centre.axes_mm).collect();
    let patterns = angular_motion_patterns(plan, &points);
    let errors: Vec<ErrorParameter> = patterns.iter().map(|(error, _)| *error).collect();
    let by_error = displacements_by_error(plan, chain, observed, &errors);
    let column = |index: usize| {
        let mut of_centres = by_error.iter().zip(&patterns[index].1);
        shift_column(&observed.centres, |_| {
            of_centres.next().map_or(Vector3::zeros(), |(centre, angle)| centre[index] * *angle)
        })
    };
    let effect = nonzero_columns((0..patterns.len()).map(column));
    UncertaintySource::new("angular error motions of X, Y and Z", effect)
}

/// Displacement of each measurement, in axis positions, per unit of each error.
fn displacements_by_error(
    plan: &Plan,
    chain: &KinematicChain,
    observed: &ObservedBalls,
    errors: &[ErrorParameter],
) -> Vec<Vec<Vector3<f64>>> {
    let stylus = Point::from_vec(Vector3::from(plan.machine.tool_mm));
    // Matrix from the table frame to axis positions.
    let back = |place: &Position| {
        let forth = chain.linear_jacobian(place, &[]);
        forth.try_inverse().unwrap_or(Matrix3::repeat(f64::NAN))
    };
    let back: Vec<Matrix3<f64>> = observed.rotary_positions.iter().map(back).collect();
    let of_centre = |centre: &BallCentre| {
        let at = observed.rotary_positions[centre.rotary_index].updated_by(&Position::from_xyz(centre.axes_mm));
        let columns = chain.jacobian(&at, stylus, &[], errors).into_iter();
        columns.map(|along| back[centre.rotary_index] * along).collect()
    };
    observed.centres.iter().map(of_centre).collect()
}
