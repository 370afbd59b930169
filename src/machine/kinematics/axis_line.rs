//! Position and direction of a rotary axis. Nominal: without error parameters.

use nalgebra::Vector3;

use super::joint::Joint;
use super::kinematic_chain::KinematicChain;
use crate::frame::Pose;
use crate::{Axis, Position};

/// An axis of rotation, machine frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AxisLine {
    /// The stated point on the axis, mm.
    pub point: Vector3<f64>,
    /// Unit vector along the axis.
    pub direction: Vector3<f64>,
    /// Pose of the carrier of the axis: it transforms the stated point and direction to those above.
    pub carrier_pose: Pose,
}

impl KinematicChain {
    /// Axis of rotation of `axis` while the axes that carry it are at `position`. `None` for a linear axis, and for
    /// an axis that the machine does not have.
    pub fn axis_line(&self, axis: Axis, position: &Position) -> Option<AxisLine> {
        let is_requested = |joint: &Joint| joint.axis == axis && !axis.is_linear();
        let (branch, index) = [&self.workpiece_joints, &self.tool_joints]
            .into_iter()
            .find_map(|branch| Some((branch, branch.iter().position(is_requested)?)))?;
        let carriers = branch.iter().take(index);
        let carrier_pose = carriers
            .fold(Pose::identity(), |outer, joint| outer * joint.nominal_pose(position.get_or_zero(joint.axis)));
        let joint = branch.get(index)?;
        Some(AxisLine {
            point: carrier_pose.transform_point(&joint.point.into()).coords,
            direction: carrier_pose.rotation * joint.direction,
            carrier_pose,
        })
    }
}
