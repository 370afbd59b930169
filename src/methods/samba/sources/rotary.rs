//! Declared error motions of rotary axes.

use crate::ball_measurement::{Observed, nonzero_columns, shifts};
use crate::identification::Effect;
use crate::identification::declared::{RotaryMotion, rotary_motions};
use crate::samba::model::{Indexed, Model};
use machine::kinematics::Chain;
use machine::record::plan::Plan;
use nalgebra::{Matrix3, Vector3};

/// They displace all touches of a measurement alike.
pub fn error_motions(plan: &Plan, chain: &Chain, observed: &Observed) -> Effect {
    let mut motions = rotary_motions(plan);
    motions.retain(|motion| chain.check(motion.error).is_ok());
    let errors: Vec<_> = motions.iter().map(|motion| motion.error).collect();
    let zero = vec![0.0; errors.len()];
    let model = Model::of(chain.clone(), errors, Vec::new(), Vec::new());
    let stylus = Vector3::from(plan.machine.tool_mm);
    // Of each rotary position: from the table frame to axis positions, and the derivatives.
    let of_place = |place| {
        let back = model.tips(place, &zero, stylus).inverse();
        (back, model.indexed(place, &zero, stylus))
    };
    let places: Vec<(Matrix3<f64>, Indexed)> = observed.places.iter().map(of_place).collect();
    let column = |(index, motion): (usize, &RotaryMotion)| {
        shifts(&observed.centres, |centre| {
            let (back, indexed) = &places[centre.place];
            *back * indexed.machine(index, centre.xyz) * motion.size_mm
        })
    };
    nonzero_columns(motions.iter().enumerate().map(column))
}
