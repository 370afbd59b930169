//! Poses of the table and of the part that carries the tool or a sensor, at one moment, with all errors.

use nalgebra::{Point3, Vector3};

use machine::frame::Pose;

/// Poses in the machine frame, mm.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct MachinePose {
    pub table_pose: Pose,
    /// Pose of the part that carries the tool or the sensor: spindle, bed or table.
    pub carrier_pose: Pose,
    /// Displacement of the carrier against the table, machine frame: errors of the linear axes (spindle only), less
    /// the drift of the table; zero for a carrier on the table.
    pub carrier_shift: Vector3<f64>,
}

impl MachinePose {
    /// Transforms a point of the carrier's frame into the table frame.
    pub fn carrier_to_table_point(self, point: Vector3<f64>) -> Vector3<f64> {
        let in_machine = self.carrier_pose * Point3::from(point) + self.carrier_shift;
        self.table_pose.inverse_transform_point(&in_machine).coords
    }

    /// Transforms a direction of the carrier's frame into the table frame.
    pub fn carrier_to_table_direction(self, direction: Vector3<f64>) -> Vector3<f64> {
        self.table_pose.inverse_transform_vector(&(self.carrier_pose * direction))
    }

    /// Transforms a direction of the table frame into the carrier's frame.
    pub fn table_to_carrier_direction(self, direction: Vector3<f64>) -> Vector3<f64> {
        self.carrier_pose.inverse_transform_vector(&(self.table_pose * direction))
    }
}
