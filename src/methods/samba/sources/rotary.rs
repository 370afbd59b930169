//! Declared error motions of rotary axes.

use super::{Draw, Shape, UncertaintySource, spread};
use crate::samba::model::{Indexed, Model};
use crate::samba::observe::Observed;
use machine::Axis;
use machine::kinematics::{self, Chain, ErrorParameter};
use machine::record::plan::Plan;
use nalgebra::{Matrix3, Vector3};

/// Harmonics of the angle; each takes an equal share of the declared variance. The mean is the axis'
/// place, and the first goes with what turns on it.
const ORDERS: std::ops::RangeInclusive<u32> = 2..=5;

/// Along X, Y and Z, each a few harmonics of the angle (ISO 230-7): they displace all touches of a
/// measurement alike.
pub fn error_motions(plan: &Plan, chain: &Chain, observed: &Observed) -> UncertaintySource {
    let turning = plan.machine.axes.iter().filter(|(axis, _)| !axis.is_linear());
    let declared = turning.filter(|(_, spec)| spec.error_motion_um > 0.0);
    let draws = declared.flat_map(|(axis, spec)| {
        let share = spec.error_motion_um * 1e-3 / (ORDERS.count() as f64).sqrt();
        of_axis(plan, chain, observed, *axis, share)
    });
    let name = "error motions of rotary axes";
    UncertaintySource { name, shape: Shape::Normal, draws: draws.collect(), shown: true }
}

fn of_axis(plan: &Plan, chain: &Chain, observed: &Observed, axis: Axis, share: f64) -> Vec<Draw> {
    let harmonics = ORDERS.flat_map(|n| [kinematics::Shape::Cos(n), kinematics::Shape::Sin(n)]);
    let motions = harmonics
        .flat_map(|harmonic| Axis::LINEAR.map(|along| ErrorParameter::new(along, axis, harmonic)));
    let motions: Vec<ErrorParameter> =
        motions.filter_map(Result::ok).filter(|motion| chain.check(*motion).is_ok()).collect();
    let (count, zero) = (motions.len(), vec![0.0; motions.len()]);
    let (model, stylus) = (
        Model::of(chain.clone(), motions, Vec::new(), Vec::new()),
        Vector3::from(plan.machine.tool_mm),
    );
    // Of each rotary position: from the table frame to axis positions, and the derivatives.
    let places: Vec<(Matrix3<f64>, Indexed)> = observed
        .places
        .iter()
        .map(|place| {
            let back = model.tips(place, &zero, stylus).inverse();
            (back, model.indexed(place, &zero, stylus))
        })
        .collect();
    let draw = |motion: usize| {
        spread(&observed.sights, |sight| {
            let (back, indexed) = &places[sight.place];
            *back * indexed.machine(motion, sight.xyz) * share
        })
    };
    (0..count).map(draw).collect()
}
