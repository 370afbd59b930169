//! The kinematic chain: exact poses of both branches, and the exact inverse for the linear axes.

use nalgebra::{Matrix3, Point3, Rotation3, Vector3};

use super::KinematicsError;
use super::error_parameter::{ErrorParameter, ErrorTerm};
use super::joint::Joint;
use super::topology::Topology;
use crate::frame::{Point, Pose, SpindleFrame, TableFrame};
use crate::record::machine::Machine;
use crate::{Axis, Position};

/// Kinematics of one machine: each joint and each error is its own one-parameter motion.
///
/// All frames coincide when every axis is at zero and there are no errors. Axes that a [`Position`] does not
/// contain are at zero.
#[derive(Debug, Clone)]
pub struct KinematicChain {
    topology: Topology,
    /// Joints from the bed to the workpiece, beginning at the bed.
    pub(super) workpiece_joints: Vec<Joint>,
    /// Joints from the bed to the tool, beginning at the bed.
    pub(super) tool_joints: Vec<Joint>,
}

impl KinematicChain {
    /// # Errors
    /// The topology cannot be parsed; an axis is in the topology but not in `axes`, or the other way round (`S` may
    /// be absent from `axes`: a spindle that cannot be oriented); a direction is not finite; the linear axes do not
    /// span space.
    pub fn new(machine: &Machine) -> Result<Self, KinematicsError> {
        let topology: Topology = machine.topology.parse()?;
        if let Some(axis) = machine.axes.keys().find(|axis| !topology.contains(**axis)) {
            let topology = machine.topology.clone();
            return Err(KinematicsError::NotInTopology { axis: *axis, topology });
        }
        let branch = |axes: &[Axis], side: f64| -> Result<Vec<Joint>, KinematicsError> {
            axes.iter().map(|axis| Joint::new(*axis, side, machine)).collect()
        };
        // ISO 841: a positive command moves the tool relative to the workpiece, so a joint in the workpiece branch
        // moves by minus the command.
        let workpiece = branch(topology.workpiece_branch(), -1.0)?;
        let tool = branch(topology.tool_branch(), 1.0)?;
        let chain = Self { topology, workpiece_joints: workpiece, tool_joints: tool };
        chain.inverse_linear_axes_jacobian(&Position::new(), &[])?;
        Ok(chain)
    }

    pub fn topology(&self) -> &Topology {
        &self.topology
    }

    /// Parses the names of error parameters of this machine.
    ///
    /// # Errors
    /// A name is invalid, belongs to an axis that the machine does not have, or occurs twice.
    pub fn parse_parameters(&self, names: &[String]) -> Result<Vec<ErrorParameter>, KinematicsError> {
        let mut parameters = Vec::new();
        for name in names {
            let parameter: ErrorParameter = name.parse()?;
            self.check_parameter_axis(parameter)?;
            if parameters.contains(&parameter) {
                return Err(KinematicsError::DuplicateParameter { name: name.clone() });
            }
            parameters.push(parameter);
        }
        Ok(parameters)
    }

    /// Checks that this machine has the axis of `parameter`; errors of other axes have no effect.
    pub fn check_parameter_axis(&self, parameter: ErrorParameter) -> Result<(), KinematicsError> {
        if self.topology.contains(parameter.axis()) {
            Ok(())
        } else {
            let topology = self.topology.to_string();
            Err(KinematicsError::NoSuchAxis { parameter, axis: parameter.axis(), topology })
        }
    }

    /// Pose of the table in the machine frame.
    pub fn machine_from_table(&self, position: &Position, errors: &[ErrorTerm]) -> Pose {
        branch_pose(&self.workpiece_joints, position, errors)
    }

    /// Pose of the spindle in the machine frame.
    pub fn machine_from_spindle(&self, position: &Position, errors: &[ErrorTerm]) -> Pose {
        branch_pose(&self.tool_joints, position, errors)
    }

    /// Position of the tool point `tip` in the table frame: p_w = T_w⁻¹ T_t tip.
    pub fn tip_in_table(
        &self,
        position: &Position,
        tip: Point<SpindleFrame>,
        errors: &[ErrorTerm],
    ) -> Point<TableFrame> {
        let in_machine = self.machine_from_spindle(position, errors) * Point3::from(tip.mm);
        let table = self.machine_from_table(position, errors);
        Point::from_vec(table.inverse_transform_point(&in_machine).coords)
    }

    /// X, Y, Z that bring `tip` to `target` with all other axes as in `others`, whose X, Y, Z are ignored. The
    /// result contains X, Y, Z only. Exact: without angular error motions of linear axes, p_w is affine in X, Y, Z.
    ///
    /// # Errors
    /// The errors are so large that X, Y, Z no longer span space.
    pub fn solve_linear_axes(
        &self,
        target: Point<TableFrame>,
        tip: Point<SpindleFrame>,
        others: &Position,
        errors: &[ErrorTerm],
    ) -> Result<Position, KinematicsError> {
        let inverse = self.inverse_linear_axes_jacobian(others, errors)?;
        let at = |xyz: Vector3<f64>| others.updated_by(&Position::from_xyz(xyz));
        let missing_motion = |xyz: Vector3<f64>| target.mm - self.tip_in_table(&at(xyz), tip, errors).mm;
        // The second solve removes the rounding error of the first.
        let first = inverse * missing_motion(Vector3::zeros());
        Ok(Position::from_xyz(first + inverse * missing_motion(first)))
    }

    /// ∂(X, Y, Z)/∂p_w, the inverse of [`KinematicChain::linear_axes_jacobian`].
    ///
    /// # Errors
    /// The errors are so large that X, Y, Z no longer span space.
    pub fn inverse_linear_axes_jacobian(
        &self,
        position: &Position,
        errors: &[ErrorTerm],
    ) -> Result<Matrix3<f64>, KinematicsError> {
        let columns = self.linear_axes_jacobian(position, errors);
        let spans_space = columns.determinant().abs() > 1e-3;
        columns.try_inverse().filter(|_| spans_space).ok_or(KinematicsError::DependentLinearAxes)
    }

    /// ∂p_w/∂(X, Y, Z), constant over X, Y, Z.
    pub fn linear_axes_jacobian(&self, position: &Position, errors: &[ErrorTerm]) -> Matrix3<f64> {
        let mut columns_in_machine = Matrix3::zeros();
        let mut pass_branch = |branch: &[Joint], side: f64| {
            branch.iter().fold(Rotation3::identity(), |carrier, joint| {
                let with_errors = carrier * joint.error_pose(position, errors).rotation;
                if joint.axis.is_linear() {
                    let travel = with_errors * joint.travel_per_command(errors) * side;
                    columns_in_machine.set_column(joint.axis as usize, &travel);
                    return with_errors;
                }
                with_errors * joint.pose_with_gains(position, errors).rotation
            })
        };
        pass_branch(&self.tool_joints, 1.0);
        let table_rotation = pass_branch(&self.workpiece_joints, -1.0);
        table_rotation.inverse() * columns_in_machine
    }
}

/// Pose of the end of the branch in the machine frame.
pub(super) fn branch_pose(branch: &[Joint], position: &Position, errors: &[ErrorTerm]) -> Pose {
    branch.iter().fold(Pose::identity(), |outer, joint| outer * joint.pose_with_errors(position, errors))
}
