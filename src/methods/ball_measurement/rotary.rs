//! Declared error motions of rotary axes.

use nalgebra::{Matrix3, Vector3};

use super::effects::{nonzero_columns, shifts};
use super::observe::{BallCentre, Observed};
use crate::identification::UncertaintySource;
use crate::identification::declared::{MOTION_ORDERS, rotary_motions};
use machine::Position;
use machine::frame::Point;
use machine::kinematics::{Chain, ErrorParameter};
use machine::record::plan::Plan;

/// They displace all touches of a measurement alike. It may have no draw.
pub fn rotary_source(plan: &Plan, chain: &Chain, observed: &Observed) -> UncertaintySource {
    let mut motions = rotary_motions(plan, &MOTION_ORDERS);
    motions.retain(|motion| chain.check(motion.error).is_ok());
    let errors: Vec<ErrorParameter> = motions.iter().map(|motion| motion.error).collect();
    let stylus = Point::from_vec(Vector3::from(plan.machine.tool_mm));
    // From the table frame to axis positions.
    let back = |place: &Position| {
        let forth = chain.linear_jacobian(place, &[]);
        forth.try_inverse().unwrap_or(Matrix3::repeat(f64::NAN))
    };
    let back: Vec<Matrix3<f64>> = observed.places.iter().map(back).collect();
    let of_centre = |centre: &BallCentre| {
        let at = observed.places[centre.place].updated_by(&Position::from_xyz(centre.xyz));
        chain.jacobian(&at, stylus, &[], &errors)
    };
    let derivatives: Vec<Vec<Vector3<f64>>> = observed.centres.iter().map(of_centre).collect();
    let column = |index: usize| {
        let mut derivatives = derivatives.iter();
        shifts(&observed.centres, |centre| {
            let along = derivatives.next().map_or(Vector3::zeros(), |of_centre| of_centre[index]);
            back[centre.place] * along * motions[index].size_mm
        })
    };
    let effect = nonzero_columns((0..motions.len()).map(column));
    UncertaintySource::new("error motions of rotary axes", effect)
}
