//! Kept-out boxes against the way of the stylus ball. Only the ball is looked at, on straight
//! chords between the ends of each motion; stylus, spindle and fixtures are not.

use glam::DVec3;

use super::{PlanningError, target};
use crate::base::{Axis, Point, Position, Spindle};
use crate::kinematics::Chain;
use crate::record::machine::Keepout;
use crate::record::motion::Block;
use crate::record::plan::Plan;

/// Motions before X, Y and Z are all known are not looked at.
///
/// # Errors
/// The first box that the ball would enter.
pub(super) fn check(block: &Block, begins: &Position, plan: &Plan) -> Result<(), PlanningError> {
    if plan.keepout.is_empty() {
        return Ok(());
    }
    let chain = Chain::new(&plan.machine)?;
    let tip: Point<Spindle> = Point::from_vec(DVec3::from_array(plan.machine.tool_mm));
    let ball = |position: &Position| -> Option<DVec3> {
        let known = Axis::LINEAR.into_iter().all(|axis| position.get(axis).is_some());
        known.then(|| chain.machine_from_spindle(position, &[]).transform_point3(tip.mm))
    };
    let mut stands = begins.clone();
    for to in block.motions.iter().filter_map(target) {
        let next = stands.updated_by(&to);
        if let (Some(one), Some(other)) = (ball(&stands), ball(&next)) {
            let radius = plan.probe.ball_radius_mm;
            let entered = plan.keepout.iter().find(|keepout| enters(keepout, radius, one, other));
            if let Some(keepout) = entered {
                let name = keepout.name.clone();
                return Err(PlanningError::Keepout { step: block.step, name });
            }
        }
        stands = next;
    }
    Ok(())
}

/// Whether the straight way from `one` to `other` enters the box grown by `radius` on all sides.
fn enters(keepout: &Keepout, radius: f64, one: DVec3, other: DVec3) -> bool {
    let low = DVec3::from_array(keepout.min_mm) - radius;
    let high = DVec3::from_array(keepout.max_mm) + radius;
    // The share of the way that lies between each pair of faces; what all three have in common.
    let (mut enter, mut leave) = (0.0_f64, 1.0_f64);
    for i in 0..3 {
        let way = other[i] - one[i];
        if way == 0.0 {
            if one[i] <= low[i] || one[i] >= high[i] {
                return false;
            }
            continue;
        }
        let (a, b) = ((low[i] - one[i]) / way, (high[i] - one[i]) / way);
        enter = enter.max(a.min(b));
        leave = leave.min(a.max(b));
    }
    enter < leave
}
