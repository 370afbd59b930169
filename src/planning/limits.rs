//! First check of travel: every position named in a block lies within the limits of its axis.

use super::{PlanningError, target};
use crate::record::machine::Machine;
use crate::record::motion::Block;

/// Rounding of a limit in degrees must not refuse a move to that very limit.
const SLACK: f64 = 1e-9;

/// # Errors
/// An axis that the machine lacks; a position outside its limits or not finite.
pub(super) fn check(block: &Block, machine: &Machine) -> Result<(), PlanningError> {
    let step = block.step;
    for to in block.motions.iter().filter_map(target) {
        for (axis, value) in to.iter() {
            let spec = machine.axes.get(&axis).ok_or(PlanningError::NoAxis { step, axis })?;
            let (min, max) = (spec.min, spec.max);
            let value = axis.to_edge(value);
            if !(min - SLACK..=max + SLACK).contains(&value) {
                return Err(PlanningError::OutOfTravel { step, axis, value, min, max });
            }
        }
    }
    Ok(())
}
