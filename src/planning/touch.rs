//! One touch as a safe sequence of motions.

use super::motion_sequence::{EQUAL_POSITION_TOLERANCE_MM_OR_RAD, MotionSequence, z_position};
use super::touched_directions::BlockStart;
use super::unverified_position_approach::{UnverifiedPositionApproach, near_part_feed_mm_min};
use super::{PlanningError, SafeHeights, ball_approach_path, travel_limits};
use machine::record::motion::{Motion, MotionBlock};
use machine::record::plan::{Plan, Step, StepKind};
use machine::{Axis, Position};

/// The motions of one touch: up to a safe height, turn the rotary axes and the spindle, move above the start,
/// guarded down to `from`, dwell if the probe requires it, touch towards `to`, back off to `from`, guarded up
/// again. A move to the present position is omitted. Near the artefact, all moves but the back-off are guarded.
/// Until touches have verified the position of the machine, all moves are careful
/// ([`super::unverified_position_approach`]), and near the artefact they use the search feed.
///
/// Between two touches of a round part, the path leads over its top. Between two touches of a ball, it leads
/// around the ball, or otherwise as high as necessary ([`super::ball_approach_path`]); the block ends beside the ball,
/// or above all near obstacles.
///
/// The back-off ends at `from`, the only point that is certainly out of contact. So that the back-off is never
/// longer than the probe's overtravel, the touch must not be longer either.
///
/// # Errors
/// The step is not a complete touch; the touch or the braking distance of guarded moves is longer than the overtravel;
/// a position is out of travel; for balls, the spindle does not point along +Z.
pub fn touch_block(
    plan: &Plan,
    step: &Step,
    repeat: u32,
    start: BlockStart<'_>,
    safe_heights: &SafeHeights,
) -> Result<MotionBlock, PlanningError> {
    check_touch_step_is_plannable(plan, step)?;
    check_guarded_feed(plan)?;
    let (near_part_feed_mm_min, back_feed) =
        (near_part_feed_mm_min(plan, start.touched_directions), plan.probe.search_feed_mm_min);
    let (from, to) = (&step.from, &step.to);
    let mut path = MotionSequence::starting_at(start.position, near_part_feed_mm_min);
    let end = match safe_heights.part_clearance_z {
        Some(safe_z) => plan_part_approach_and_block_end(&mut path, plan, step, start, safe_heights, safe_z),
        None => ball_approach_path::plan_ball_approach_and_block_end(&mut path, plan, step, start, safe_heights)?,
    };
    path.add_guarded_move(&z_position(from.get_or_zero(Axis::Z)));
    if plan.probe.settle_s > 0.0 {
        path.motions.push(Motion::Dwell { seconds: plan.probe.settle_s });
    }
    path.add_motion(&to.filter_axes(Axis::is_linear), |to| Motion::Probe { to, feed_mm_min: step.feed_mm_min });
    path.add_motion(&from.filter_axes(Axis::is_linear), |to| Motion::BackOff { to, feed_mm_min: back_feed });
    path.add_guarded_move(&end);

    let block = MotionBlock { step: step.id, repeat, motions: path.motions };
    travel_limits::check_block_within_limits(&block, &plan.machine)?;
    Ok(block)
}

/// Plans the path to a point above the start of the touch. Returns the position at which the block ends.
fn plan_part_approach_and_block_end(
    path: &mut MotionSequence,
    plan: &Plan,
    step: &Step,
    start: BlockStart<'_>,
    safe_heights: &SafeHeights,
    safe_z: f64,
) -> Position {
    let (from, to) = (&step.from, &step.to);
    let safe_z = safe_z.max(from.get_or_zero(Axis::Z)).max(to.get_or_zero(Axis::Z));
    if !start.touched_directions.has_three_independent_directions() {
        UnverifiedPositionApproach::new(plan, safe_heights, safe_z, start.touched_directions).move_above(path, from);
        return z_position(safe_z);
    }
    match path.end_position.get(Axis::Z) {
        Some(z) if z >= safe_z => {}
        Some(_) => path.add_guarded_move(&z_position(safe_z)),
        None => path.add_rapid(&z_position(safe_heights.top_z.max(safe_z))),
    }
    path.add_rapids_across_and_down(from, safe_z);
    z_position(safe_z)
}

/// Checks that the step is a touch with all axes, without rotary motion, and not longer than the probe's overtravel.
fn check_touch_step_is_plannable(plan: &Plan, step: &Step) -> Result<(), PlanningError> {
    let id = step.id;
    if !matches!(step.kind, StepKind::Touch | StepKind::Reference) {
        return Err(PlanningError::NotATouch { step: id });
    }
    let named = |position: &Position, axis: Axis| {
        position.get(axis).ok_or(PlanningError::MissingAxisPosition { step: id, axis })
    };
    let mut square = 0.0;
    for axis in Axis::LINEAR {
        square += (named(&step.to, axis)? - named(&step.from, axis)?).powi(2);
    }
    for axis in plan.machine.axes.keys().filter(|axis| !axis.is_linear() && **axis != Axis::S) {
        named(&step.from, *axis)?;
    }
    let turned = step.to.iter().find(|(axis, value)| {
        !axis.is_linear()
            && step.from.get(*axis).is_none_or(|from| (from - value).abs() > EQUAL_POSITION_TOLERANCE_MM_OR_RAD)
    });
    if let Some((axis, _)) = turned {
        return Err(PlanningError::RotaryMotionInTouch { step: id, axis });
    }
    let (length, overtravel) = (square.sqrt(), plan.probe.overtravel_mm);
    if length > overtravel + EQUAL_POSITION_TOLERANCE_MM_OR_RAD {
        return Err(PlanningError::TouchTooLong { step: id, length, overtravel });
    }
    if length > EQUAL_POSITION_TOLERANCE_MM_OR_RAD { Ok(()) } else { Err(PlanningError::ZeroLengthTouch { step: id }) }
}

/// A guarded move that meets an obstacle must stop within the probe's overtravel, for every linear axis.
fn check_guarded_feed(plan: &Plan) -> Result<(), PlanningError> {
    let (feed, overtravel) = (plan.probe.guarded_feed_mm_min, plan.probe.overtravel_mm);
    let distance_mm = (feed / 60.0).powi(2) / (2.0 * plan.machine.min_linear_acceleration_mm_s2());
    if distance_mm <= overtravel {
        Ok(())
    } else {
        Err(PlanningError::GuardedFeedTooFast { feed, distance_mm, overtravel })
    }
}
