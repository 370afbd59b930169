//! Motions of one scan. A scan touches nothing, so its moves are not guarded; the proof checks that all of it keeps
//! its distance.

use super::motion_sequence::{MotionSequence, z_position};
use super::safe_heights::PLANNED_GUARDED_CLEARANCE_MM;
use super::surroundings::TooNearPair;
use super::unverified_position_approach::{
    UnverifiedPositionApproach, are_step_sensors_on_table, max_nest_feed_mm_min, near_part_feed_mm_min,
};
use super::{BlockStart, PlanningError, SafeHeights, TouchedDirections, touch_block, travel_limits, turn_feeds};
use machine::record::motion::{Motion, MotionBlock};
use machine::record::plan::{Plan, Sampling, Scan, Step};
use machine::{Axis, Position};

/// Height above the first point at which the descent becomes a feed move, mm.
const SLOW_DESCENT_HEIGHT_MM: f64 = 10.0;
/// Maximum distance of each linear axis from the first point of a scan at which the ball stays in a nest of sensors on
/// the table, mm; at a larger distance, the ball leaves the nest before it moves to the first point.
const MAX_OFFSET_TO_STAY_IN_NEST_MM: f64 = 1.0;

/// Blocks of one step. A touch is one block. A scan with dwell points is one block for each part of the path
/// after which samples are taken, the first with the path to the first point. A continuous scan is the path to its
/// first point and the scan, without a rest.
///
/// # Errors
/// The errors of [`touch_block`]; or the points of a scan do not contain all axes, or its sampling is impossible.
pub fn step_blocks(
    plan: &Plan,
    step: &Step,
    repeat: u32,
    start: BlockStart<'_>,
    safe_heights: &SafeHeights,
) -> Result<Vec<MotionBlock>, PlanningError> {
    match &step.scan {
        None => touch_block(plan, step, repeat, start, safe_heights).map(|block| vec![block]),
        Some(scan) => scan_blocks(plan, step, scan, repeat, start, safe_heights),
    }
}

/// Plans the approach and the scan. If rotary axes or the spindle turn, Z first moves to its upper end; otherwise it is
/// only as high as start and first point require. After turns and moves of X and Y, Z moves down, at last slowly. Until
/// a scan has verified the position of the machine, the approach is careful ([`super::unverified_position_approach`]),
/// and the descent to where the sensor may reach a body is in separate blocks ([`out_of_range_block_count`]). The
/// approach of the ball to a nest of sensors on the table is always careful; between scans, the ball stays in the nest.
fn scan_blocks(
    plan: &Plan,
    step: &Step,
    scan: &Scan,
    repeat: u32,
    start: BlockStart<'_>,
    safe_heights: &SafeHeights,
) -> Result<Vec<MotionBlock>, PlanningError> {
    check_scan_step_is_plannable(plan, step, scan)?;
    let in_nest = are_step_sensors_on_table(plan, step);
    let approach_feed =
        if in_nest { max_nest_feed_mm_min(plan) } else { near_part_feed_mm_min(plan, start.touched_directions) };
    let mut path = MotionSequence::starting_at(start.position, approach_feed);
    let top_z = safe_heights.top_z;
    let mut blocks = Vec::new();
    let begins_in_place = scan.is_rotary_only() && are_unmoved_axes_at_start(&path, scan);
    if begins_in_place || (in_nest && can_ball_stay_in_nest(&path, &step.from, start.touched_directions)) {
        turn_to_first_point(&mut path, plan, &step.from, safe_heights);
    } else if start.touched_directions.has_three_independent_directions() && !in_nest {
        plan_scan_approach(&mut path, &step.from, top_z);
    } else {
        let low_z = lowest_out_of_range_z(step, &path, safe_heights)?;
        let careful = match in_nest {
            true => UnverifiedPositionApproach::to_nest(plan, safe_heights, low_z),
            false => UnverifiedPositionApproach::new(plan, safe_heights, low_z, start.touched_directions),
        };
        careful.move_up(&mut path, &step.from);
        blocks.push(std::mem::take(&mut path.motions));
        careful.move_across_and_down(&mut path, &step.from);
        blocks.push(std::mem::take(&mut path.motions));
    }
    for (number, point) in scan.path.iter().enumerate() {
        let feed_mm_min = if number == 0 { approach_feed } else { step.feed_mm_min };
        path.add_motion(&point.filter_axes(|axis| axis != Axis::S), |to| Motion::Feed { to, feed_mm_min });
        match scan.sampling {
            Sampling::Dwell { dwell_s, .. } => path.motions.push(Motion::Dwell { seconds: dwell_s }),
            Sampling::Continuous { .. } if number > 0 => continue,
            Sampling::Continuous { .. } => {}
        }
        blocks.push(std::mem::take(&mut path.motions));
    }
    blocks.push(path.motions);
    blocks.retain(|motions| !motions.is_empty());
    let block = |motions| MotionBlock { step: step.id, repeat, motions };
    let blocks: Vec<MotionBlock> = blocks.into_iter().map(block).collect();
    blocks.iter().try_for_each(|block| travel_limits::check_block_within_limits(block, &plan.machine))?;
    Ok(blocks)
}

/// Whether the axes that a scan does not move are at its start.
fn are_unmoved_axes_at_start(path: &MotionSequence, scan: &Scan) -> bool {
    let Some(first) = scan.path.first() else { return false };
    let is_still = |axis: Axis, at: f64| scan.path.iter().all(|point| point.get_or_zero(axis) == at);
    let mut still = first.iter().filter(|(axis, at)| is_still(*axis, *at));
    still.all(|(axis, at)| path.is_at(axis, at))
}

/// Whether the ball is near enough to the first point of a scan to stay in the nest. Rotary axes may differ from the
/// first point only if the position of the machine is verified.
fn can_ball_stay_in_nest(path: &MotionSequence, from: &Position, touched: TouchedDirections) -> bool {
    let is_in_place = |(axis, at): (Axis, f64)| match path.end_position.get(axis) {
        Some(position) if axis.is_linear() => (position - at).abs() <= MAX_OFFSET_TO_STAY_IN_NEST_MM,
        Some(_) if axis != Axis::S && touched.has_three_independent_directions() => true,
        _ => path.is_at(axis, at),
    };
    from.iter().all(is_in_place)
}

/// Turns the rotary axes, but not the spindle, to the first point one after the other, at the feed that is allowed
/// until the position is verified.
fn turn_to_first_point(path: &mut MotionSequence, plan: &Plan, from: &Position, safe_heights: &SafeHeights) {
    for (axis, at) in from.iter().filter(|(axis, _)| !axis.is_linear() && *axis != Axis::S) {
        let chain = &safe_heights.surroundings.chain;
        let feed_mm_min = turn_feeds::max_turn_feed_deg_min(plan, chain, axis, &path.end_position);
        path.add_motion(&Position::new().with(axis, at), |to| Motion::Feed { to, feed_mm_min });
    }
}

/// Number of blocks, of the `block_count` blocks of a scan, that lead to a point where no declared body is within the
/// range of the sensor: straight up, then across and down. 0 once the position is verified; with sensors on the table,
/// 0 if the ball is already between them.
pub fn out_of_range_block_count(scan: &Scan, block_count: usize) -> usize {
    // The other blocks are one for each dwell point, or two for a continuous scan. The first of these also contains
    // the last part of the path to the first point.
    let remaining_block_count = match scan.sampling {
        Sampling::Dwell { .. } => scan.path.len(),
        Sampling::Continuous { .. } => 2,
    };
    block_count.saturating_sub(remaining_block_count)
}

/// Lowest Z above the first point at which no declared body is within the range of a sensor; at least
/// [`SLOW_DESCENT_HEIGHT_MM`] above the point, at most the upper end of Z. Also checks that no body is within range
/// on the path to this point at the upper end of Z.
fn lowest_out_of_range_z(step: &Step, path: &MotionSequence, safe_heights: &SafeHeights) -> Result<f64, PlanningError> {
    let from = &step.from;
    let position = path.end_position.filter_axes(|axis| matches!(axis, Axis::X | Axis::Y));
    let begins = from.updated_by(&position);
    let out_of_range = |begins: &Position| {
        let near = |near: TooNearPair| PlanningError::BodyInSensorRangeAtTopOfZ {
            step: step.id,
            sensor: near.tool_or_sensor_name,
            body: near.obstacle_name,
        };
        safe_heights.surroundings.out_of_range_z(begins, from, PLANNED_GUARDED_CLEARANCE_MM).map_err(near)
    };
    out_of_range(&begins)?;
    Ok(out_of_range(from)?.max(from.get_or_zero(Axis::Z) + SLOW_DESCENT_HEIGHT_MM).min(safe_heights.top_z))
}

/// Adds the rapids of an approach at a verified position, down to [`SLOW_DESCENT_HEIGHT_MM`] above the first point.
fn plan_scan_approach(path: &mut MotionSequence, from: &Position, top_z: f64) {
    let z = from.get_or_zero(Axis::Z);
    let still = |(axis, value): (Axis, f64)| axis.is_linear() || path.is_at(axis, value);
    let level = match path.end_position.get(Axis::Z) {
        Some(position) if from.iter().all(still) => position.max(z + SLOW_DESCENT_HEIGHT_MM),
        _ => top_z,
    };
    path.add_rapid(&z_position(level.min(top_z)));
    path.add_rapids_across_and_down(from, (z + SLOW_DESCENT_HEIGHT_MM).min(top_z));
}

/// Checks that the scan has a path from `from` to `to` with all axes, a feed, known sensors and a possible sampling.
fn check_scan_step_is_plannable(plan: &Plan, step: &Step, scan: &Scan) -> Result<(), PlanningError> {
    let id = step.id;
    let invalid = |reason| Err(PlanningError::InvalidScan { step: id, reason });
    let required_axes = plan.machine.axes.keys().copied().filter(|axis| *axis != Axis::S);
    for axis in required_axes {
        if scan.path.iter().any(|point| point.get(axis).is_none()) {
            return Err(PlanningError::MissingAxisPosition { step: id, axis });
        }
    }
    let (Some(first), Some(last)) = (scan.path.first(), scan.path.last()) else {
        return invalid("the path has no points");
    };
    let differs = |one: &Position, other: &Position| {
        let same = |(axis, value)| other.get(axis).is_none_or(|other| other == value);
        !one.iter().all(same)
    };
    if differs(first, &step.from) || differs(last, &step.to) {
        return invalid("the path does not begin at `from` and end at `to`");
    }
    if !(step.feed_mm_min.is_finite() && step.feed_mm_min > 0.0) {
        return invalid("the feed is not a positive number");
    }
    let is_planned = |name: &String| plan.sensors.iter().any(|sensor| sensor.name == *name);
    if step.sensors.is_empty() || !step.sensors.iter().all(is_planned) {
        return invalid("`sensors` is empty or contains a name that no sensor of the plan has");
    }
    match scan.sampling {
        Sampling::Dwell { dwell_s, samples } if dwell_s >= 0.0 && samples > 0 => Ok(()),
        Sampling::Dwell { .. } => invalid("`dwell_s` is negative or `samples` is 0"),
        Sampling::Continuous { .. } if scan.path.windows(2).all(|way| way.first() == way.last()) => {
            invalid("a continuous scan requires a path with a length above 0")
        }
        Sampling::Continuous { rate_hz, .. } if !(rate_hz.is_finite() && rate_hz > 0.0) => {
            invalid("`rate_hz` is not a positive number")
        }
        Sampling::Continuous { per_revolution: Some(count), .. }
            if count == 0 || scan.single_rotary_axis().is_none() =>
        {
            invalid("`per_revolution` must be 1 or more, and the path must turn exactly one rotary axis")
        }
        Sampling::Continuous { .. } => Ok(()),
    }
}
