//! One joint and its errors.

use std::f64::consts::PI;

use nalgebra::{Rotation3, Translation3, Unit, Vector3};

use super::KinematicsError;
use super::error_parameter::{ErrorShape, ErrorTerm};
use crate::frame::{Pose, unit_vector};
use crate::record::machine::{Machine, StatedAxis};
use crate::{Axis, Position};

/// Order in which the error components of one joint act.
pub(super) const ERROR_COMPONENT_ORDER: [Axis; 6] = [Axis::X, Axis::Y, Axis::Z, Axis::A, Axis::B, Axis::C];

#[derive(Debug, Clone)]
pub(super) struct Joint {
    pub(super) axis: Axis,
    /// Sign of the branch times sense of the axis: the joint moves by `sign · command`.
    pub(super) command_sign: f64,
    /// Unit vector of the travel or of the rotary axis, machine frame, all axes at zero; without `command_sign`.
    pub(super) direction: Vector3<f64>,
    /// A point on a rotary axis; zero for a linear axis. Angular errors rotate about it.
    pub(super) point: Vector3<f64>,
}

impl Joint {
    /// `branch_sign`: −1 in the workpiece branch, +1 in the tool branch.
    pub(super) fn new(axis: Axis, branch_sign: f64, machine: &Machine) -> Result<Self, KinematicsError> {
        match machine.axes.get(&axis) {
            Some(spec) => Self::from_stated_axis(axis, branch_sign, spec),
            None if axis == Axis::S => {
                let (direction, point) = (axis.nominal_direction(), Vector3::zeros());
                Ok(Self { axis, command_sign: branch_sign, direction, point })
            }
            None => Err(KinematicsError::NotInAxes { axis, topology: machine.topology.clone() }),
        }
    }

    fn from_stated_axis(axis: Axis, branch_sign: f64, spec: &StatedAxis) -> Result<Self, KinematicsError> {
        let axis_direction = Vector3::from(spec.direction);
        let direction = if axis_direction == Vector3::zeros() {
            axis.nominal_direction()
        } else {
            unit_vector(axis_direction).unwrap_or_default()
        };
        let point = if axis.is_linear() { Vector3::zeros() } else { Vector3::from(spec.point_mm) };
        if direction == Vector3::zeros() || !is_finite(direction) || !is_finite(point) {
            return Err(KinematicsError::InvalidDirectionOrPoint { axis });
        }
        Ok(Self { axis, command_sign: branch_sign * spec.positive.direction_sign(), direction, point })
    }

    /// The joint's motion without errors.
    pub(super) fn nominal_pose(&self, command: f64) -> Pose {
        axis_motion(self.axis, self.direction, self.point, self.command_sign * command)
    }

    /// Distance of `point` (frame of the joint before its motion) from the axis of rotation; 0 for a linear joint.
    pub(super) fn distance_from_axis(&self, point: Vector3<f64>) -> f64 {
        if self.axis.is_linear() {
            return 0.0;
        }
        self.direction.cross(&(point - self.point)).norm()
    }

    /// Maximum distance between two positions of a point at distance `axis_distance` from the axis of rotation, while
    /// the command changes by `command_change` at most.
    pub(super) fn max_displacement(&self, command_change: f64, axis_distance: f64) -> f64 {
        if self.axis.is_linear() { command_change } else { 2.0 * (command_change.min(PI) / 2.0).sin() * axis_distance }
    }

    /// Motion of the joint with all its errors: location errors and error motions, then the nominal motion, then
    /// gains.
    pub(super) fn pose_with_errors(&self, position: &Position, errors: &[ErrorTerm]) -> Pose {
        self.error_pose(position, errors) * self.pose_with_gains(position, errors)
    }

    /// Motion of the joint with its gains, without location errors and error motions.
    pub(super) fn pose_with_gains(&self, position: &Position, errors: &[ErrorTerm]) -> Pose {
        let amount = self.command_sign * position.get_or_zero(self.axis);
        axis_motion(self.axis, self.direction_with_gains(errors), self.point, amount)
    }

    /// Location errors and error motions: one motion per component, in the order of [`ERROR_COMPONENT_ORDER`]. The
    /// translations come first and commute, and all rotations are about the same point.
    pub(super) fn error_pose(&self, position: &Position, errors: &[ErrorTerm]) -> Pose {
        let mut amounts = [0.0; Axis::ALL.len()];
        let command = position.get_or_zero(self.axis);
        for error in self.errors_without_gains(errors) {
            amounts[error.parameter.component() as usize] += error.value * error.parameter.shape_factor(command);
        }
        let [x, y, z, a, b, c, _] = amounts;
        let rotation = [(Vector3::x_axis(), a), (Vector3::y_axis(), b), (Vector3::z_axis(), c)]
            .into_iter()
            .filter(|(_, angle)| *angle != 0.0)
            .fold(Rotation3::identity(), |outer, (axis, angle)| outer * Rotation3::from_axis_angle(&axis, angle));
        Translation3::new(x, y, z) * Pose::rotation_wrt_point(rotation, self.point.into())
    }

    /// Motion by the sum of the joint's errors of one component; the errors share one generator, so they add up.
    pub(super) fn component_error_pose(&self, component: Axis, position: &Position, errors: &[ErrorTerm]) -> Pose {
        let command = position.get_or_zero(self.axis);
        let own = self.errors_without_gains(errors).filter(|e| e.parameter.component() == component);
        let amount: f64 = own.map(|e| e.value * e.parameter.shape_factor(command)).sum();
        axis_motion(component, component.nominal_direction(), self.point, amount)
    }

    /// ∂(motion)/∂(command) of a linear joint, in the frame after its location errors.
    pub(super) fn travel_per_command(&self, errors: &[ErrorTerm]) -> Vector3<f64> {
        self.command_sign * self.direction_with_gains(errors)
    }

    /// Travel per unit of command: the direction and the gains.
    fn direction_with_gains(&self, errors: &[ErrorTerm]) -> Vector3<f64> {
        self.errors_of_axis(errors)
            .filter(|e| e.parameter.shape() == ErrorShape::Gain)
            .fold(self.direction, |sum, e| sum + e.parameter.component().nominal_direction() * e.value)
    }

    /// Location errors and error motions.
    fn errors_without_gains<'a>(&self, errors: &'a [ErrorTerm]) -> impl Iterator<Item = &'a ErrorTerm> {
        self.errors_of_axis(errors).filter(|e| e.parameter.shape() != ErrorShape::Gain)
    }

    fn errors_of_axis<'a>(&self, errors: &'a [ErrorTerm]) -> impl Iterator<Item = &'a ErrorTerm> {
        let axis = self.axis;
        errors.iter().filter(move |e| e.parameter.axis() == axis)
    }
}

fn is_finite(vector: Vector3<f64>) -> bool {
    vector.iter().all(|value| value.is_finite())
}

/// Translation by `amount` along `direction`; for a rotary axis, rotation about the line through `point` along the
/// unit vector `direction`.
fn axis_motion(axis: Axis, direction: Vector3<f64>, point: Vector3<f64>, amount: f64) -> Pose {
    if axis.is_linear() {
        return Pose::from(Translation3::from(amount * direction));
    }
    let rotation = Rotation3::from_axis_angle(&Unit::new_unchecked(direction), amount);
    Pose::rotation_wrt_point(rotation, point.into())
}
