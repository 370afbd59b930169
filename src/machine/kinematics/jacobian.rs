//! Analytic Jacobian of the tip on the table with respect to the error parameters.

use nalgebra::Vector3;

use super::error_parameter::{ErrorParameter, ErrorShape, ErrorTerm};
use super::joint::{ERROR_COMPONENT_ORDER, Joint};
use super::kinematic_chain::KinematicChain;
use crate::Position;
use crate::frame::{Point, Pose, SpindleFrame};

impl KinematicChain {
    /// Derivative ∂p_w/∂θ of the tip for each of `parameters`, in their order, exact at `errors`: mm per mm, per rad
    /// or per mm/mm, in the table frame. The derivative is zero if the machine does not have the axis of the parameter.
    ///
    /// ∂p_w/∂θ_k = ±φ·R_wᵀ·(Ad_prefix e_k)(p_F): + in the tool branch, − in the workpiece branch;
    /// p_F is the tip in the machine frame, R_w the table's rotation.
    pub fn error_jacobian(
        &self,
        position: &Position,
        tip: Point<SpindleFrame>,
        errors: &[ErrorTerm],
        parameters: &[ErrorParameter],
    ) -> Vec<Vector3<f64>> {
        let workpiece = joint_poses_and_branch_pose(&self.workpiece_joints, position, errors);
        let tool = joint_poses_and_branch_pose(&self.tool_joints, position, errors);
        let tip = tool.1.transform_point(&tip.mm.into()).coords;
        let into_table = workpiece.1.rotation.inverse();
        let mut columns = vec![Vector3::zeros(); parameters.len()];
        for (branch, side) in [(&workpiece.0, -1.0), (&tool.0, 1.0)] {
            for joint_poses in branch {
                for (column, parameter) in columns.iter_mut().zip(parameters) {
                    if parameter.axis() == joint_poses.joint.axis {
                        let velocity = tip_derivative_by_parameter(joint_poses, *parameter, position, errors, tip);
                        *column = into_table * velocity * side;
                    }
                }
            }
        }
        columns
    }
}

/// A joint: the pose of its carrier, and this pose followed by the joint's location errors and error motions.
struct JointPoses<'a> {
    joint: &'a Joint,
    carrier_pose: Pose,
    pose_before_joint_motion: Pose,
}

/// All joints of a branch, and the pose of its end.
fn joint_poses_and_branch_pose<'a>(
    branch: &'a [Joint],
    position: &Position,
    errors: &[ErrorTerm],
) -> (Vec<JointPoses<'a>>, Pose) {
    let mut carrier_pose = Pose::identity();
    let poses_of_joint = |joint: &'a Joint| {
        let pose_with_location_errors = carrier_pose * joint.error_pose(position, errors);
        let joint_poses = JointPoses { joint, carrier_pose, pose_before_joint_motion: pose_with_location_errors };
        carrier_pose = pose_with_location_errors * joint.pose_with_gains(position, errors);
        joint_poses
    };
    (branch.iter().map(poses_of_joint).collect(), carrier_pose)
}

/// Derivative of the point `tip`, which moves with the joint, by `parameter` of the joint; machine frame.
fn tip_derivative_by_parameter(
    JointPoses { joint, carrier_pose, pose_before_joint_motion: pose_with_location_errors }: &JointPoses<'_>,
    parameter: ErrorParameter,
    position: &Position,
    errors: &[ErrorTerm],
    tip: Vector3<f64>,
) -> Vector3<f64> {
    let factor = parameter.shape_factor(position.get_or_zero(joint.axis));
    let generator = parameter.component().nominal_direction();
    if parameter.shape() == ErrorShape::Gain {
        return pose_with_location_errors.transform_vector(&generator) * joint.command_sign * factor;
    }
    let component_pose = ERROR_COMPONENT_ORDER
        .into_iter()
        .take_while(|component| *component != parameter.component())
        .fold(*carrier_pose, |outer, component| outer * joint.component_error_pose(component, position, errors));
    let direction = component_pose.transform_vector(&generator);
    if parameter.component().is_linear() {
        direction * factor
    } else {
        direction.cross(&(tip - component_pose.transform_point(&joint.point.into()).coords)) * factor
    }
}
