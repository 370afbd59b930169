//! First check of travel: every position in a block is within the limits of its axis.

use super::{PlanningError, motion_target};
use machine::Position;
use machine::record::machine::{Machine, StatedAxis};
use machine::record::motion::MotionBlock;

/// Tolerance of travel limits, mm or degrees: rounding must not cause the refusal of a move exactly to the limit.
const LIMIT_TOLERANCE_MM_OR_DEG: f64 = 1e-9;

/// Whether the machine has all axes of a position, and the position is within their limits.
pub(super) fn is_position_within_limits(position: &Position, machine: &Machine) -> bool {
    position.iter().all(|(axis, value)| {
        let spec = machine.axes.get(&axis);
        spec.is_some_and(|spec| is_axis_value_within_limits(axis.to_mm_or_deg(value), spec))
    })
}

fn is_axis_value_within_limits(value: f64, spec: &StatedAxis) -> bool {
    (spec.min - LIMIT_TOLERANCE_MM_OR_DEG..=spec.max + LIMIT_TOLERANCE_MM_OR_DEG).contains(&value)
}

/// Checks that every target in `block` is within the limits of its axes.
///
/// # Errors
/// The machine lacks an axis; a position is outside its limits or not finite.
pub(super) fn check_block_within_limits(block: &MotionBlock, machine: &Machine) -> Result<(), PlanningError> {
    let step = block.step;
    for to in block.motions.iter().filter_map(motion_target) {
        for (axis, value) in to.iter() {
            let spec = machine.axes.get(&axis).ok_or(PlanningError::UnknownAxis { step, axis })?;
            let value = axis.to_mm_or_deg(value);
            if !is_axis_value_within_limits(value, spec) {
                let (min, max) = (spec.min, spec.max);
                return Err(PlanningError::OutOfTravel { step, axis, value, min, max });
            }
        }
    }
    Ok(())
}
