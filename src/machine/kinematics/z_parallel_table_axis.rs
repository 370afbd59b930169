//! The rotary axis that turns the workpiece about Z.

use super::KinematicChain;
use crate::record::machine::Machine;
use crate::{Axis, Position};

/// Minimum cosine of the angle between an axis and Z, in either sense.
const MIN_COSINE_TO_Z: f64 = 0.999;

/// The rotary axis nearest to the workpiece, of those on the workpiece side that are parallel to Z with all other axes
/// at zero.
#[derive(Debug, Clone, PartialEq)]
pub struct ZParallelTableAxis {
    pub axis: Axis,
    /// Position of all declared rotary axes, `S` included, each at zero.
    pub position_with_rotary_axes_at_zero: Position,
    /// Sense in which an increasing command turns the table about +Z: +1 right-handed, −1 as in ISO 841.
    pub turn_sign: f64,
}

impl ZParallelTableAxis {
    /// Finds the axis. `None`: the machine has no such axis.
    pub fn of_machine(machine: &Machine, chain: &KinematicChain) -> Option<Self> {
        let rotary = machine.axes.keys().filter(|axis| !axis.is_linear());
        let zero_position: Position = rotary.map(|axis| (*axis, 0.0)).collect();
        let direction_z = |axis: Axis| Some(chain.axis_line(axis, &zero_position)?.direction.z);
        let is_parallel_to_z = |axis: &&Axis| direction_z(**axis).is_some_and(|z| z.abs() >= MIN_COSINE_TO_Z);
        let axis = *chain.topology().workpiece_branch().iter().rev().find(is_parallel_to_z)?;
        // A joint that carries the workpiece turns against the sign of the command (ISO 841).
        let turn_sign = -machine.axes.get(&axis)?.positive.direction_sign() * direction_z(axis)?.signum();
        Some(Self { axis, position_with_rotary_axes_at_zero: zero_position, turn_sign })
    }
}
