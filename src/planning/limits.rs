//! First check of travel: every position in a block is within the limits of its axis.

use super::{PlanningError, target};
use machine::Position;
use machine::record::machine::{AxisSpec, Machine};
use machine::record::motion::Block;

/// Tolerance for limits in degrees, so that rounding does not refuse a move exactly to the limit.
const SLACK: f64 = 1e-9;

/// Whether the machine has all axes of a position, and the position is within their limits.
pub(super) fn within(position: &Position, machine: &Machine) -> bool {
    position.iter().all(|(axis, value)| {
        let spec = machine.axes.get(&axis);
        spec.is_some_and(|spec| inside(axis.to_edge(value), spec))
    })
}

fn inside(value: f64, spec: &AxisSpec) -> bool {
    (spec.min - SLACK..=spec.max + SLACK).contains(&value)
}

/// # Errors
/// The machine lacks an axis; a position is outside its limits or not finite.
pub(super) fn check(block: &Block, machine: &Machine) -> Result<(), PlanningError> {
    let step = block.step;
    for to in block.motions.iter().filter_map(target) {
        for (axis, value) in to.iter() {
            let spec = machine.axes.get(&axis).ok_or(PlanningError::NoAxis { step, axis })?;
            let value = axis.to_edge(value);
            if !inside(value, spec) {
                let (min, max) = (spec.min, spec.max);
                return Err(PlanningError::OutOfTravel { step, axis, value, min, max });
            }
        }
    }
    Ok(())
}
