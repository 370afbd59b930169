//! Position and direction of a rotary axis: nominal, and displaced by errors relative to the tip.

use nalgebra::{Point3, Vector3};

use super::KinematicsError;
use super::error_parameter::{ErrorParameter, ErrorTerm};
use super::joint::Joint;
use super::kinematic_chain::{KinematicChain, branch_pose};
use crate::frame::{Point, Pose, SpindleFrame};
use crate::{Axis, Position};

/// Parameter step of a numerical derivative, rad or mm: so small that the displacement is linear in the parameter.
const DERIVATIVE_STEP: f64 = 1e-5;

/// An axis of rotation, machine frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AxisLine {
    /// The stated point on the axis, mm.
    pub point: Vector3<f64>,
    /// Unit vector along the axis.
    pub direction: Vector3<f64>,
    /// Pose of the carrier of the axis. It transforms the stated point and direction to `point` and `direction`.
    pub carrier_pose: Pose,
}

impl AxisLine {
    /// The point on the axis that is nearest to `at`, mm.
    pub fn point_nearest_to(&self, at: Vector3<f64>) -> Vector3<f64> {
        self.point + self.direction * self.direction.dot(&(at - self.point))
    }
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

    /// Displacement of a rotary axis of the table relative to the tip, caused by `errors`, mm, machine frame: that of
    /// the point on the axis nearest to `at`, while the nominal tip is at `at` and all rotary axes are at zero.
    /// X, Y and Z that bring the tip onto the axis change by this displacement. `at`: machine frame with all axes at
    /// zero, mm.
    ///
    /// # Errors
    /// The table has no such rotary axis.
    pub fn axis_displacement_relative_to_tip(
        &self,
        axis: Axis,
        at: Vector3<f64>,
        tip: Point<SpindleFrame>,
        errors: &[ErrorTerm],
    ) -> Result<Vector3<f64>, KinematicsError> {
        let index = self.workpiece_joints.iter().position(|joint| joint.axis == axis && !axis.is_linear());
        let joints = &self.workpiece_joints[..=index.ok_or(KinematicsError::NoTableAxis { axis })?];
        let line = self.axis_line(axis, &Position::new()).ok_or(KinematicsError::NoTableAxis { axis })?;
        let on_axis = line.point_nearest_to(at);
        let position = self.solve_linear_axes(Point::from_vec(at), tip, &Position::new(), &[])?;
        let carried = |errors: &[ErrorTerm]| branch_pose(joints, &position, errors) * Point3::from(on_axis);
        let tip_at = |errors: &[ErrorTerm]| self.machine_from_spindle(&position, errors) * Point3::from(tip.mm);
        Ok((carried(errors) - carried(&[])) - (tip_at(errors) - tip_at(&[])))
    }

    /// Derivative of [`Self::axis_displacement_relative_to_tip`] by `parameter`, without other errors.
    ///
    /// # Errors
    /// The table has no such rotary axis.
    pub fn axis_displacement_derivative(
        &self,
        axis: Axis,
        at: Vector3<f64>,
        tip: Point<SpindleFrame>,
        parameter: ErrorParameter,
    ) -> Result<Vector3<f64>, KinematicsError> {
        let step = [ErrorTerm { parameter, value: DERIVATIVE_STEP }];
        Ok(self.axis_displacement_relative_to_tip(axis, at, tip, &step)? / DERIVATIVE_STEP)
    }
}
